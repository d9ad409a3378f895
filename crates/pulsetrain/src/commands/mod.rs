//! The commands, one file each.

pub(crate) mod boards;
pub(crate) mod drivers;
pub(crate) mod motor;
pub(crate) mod new;
pub(crate) mod plan;
