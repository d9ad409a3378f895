//! The commands, one file each, and what several of them need: `rehearsal`, `other_image` and, below all others, `problems`.

pub(crate) mod bake;
pub(crate) mod bench;
pub(crate) mod board;
pub(crate) mod boards;
pub(crate) mod calibrate;
pub(crate) mod drivers;
pub(crate) mod explain;
pub(crate) mod flash;
mod hints;
pub(crate) mod info;
pub(crate) mod motor;
pub(crate) mod new;
pub(crate) mod on_port;
pub(crate) mod other_image;
pub(crate) mod plan;
pub(crate) mod plot;
pub(crate) mod ports;
pub(crate) mod problems;
mod rehearsal;
pub(crate) mod run;
pub(crate) mod stop;
pub(crate) mod store;
pub(crate) mod verbs;
pub(crate) mod verify;
pub(crate) mod winch;
