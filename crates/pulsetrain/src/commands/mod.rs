//! The commands, one file each.

pub(crate) mod boards;
pub(crate) mod drivers;
pub(crate) mod explain;
pub(crate) mod motor;
pub(crate) mod new;
pub(crate) mod plan;
pub(crate) mod plot;
pub(crate) mod run;
pub(crate) mod verify;
