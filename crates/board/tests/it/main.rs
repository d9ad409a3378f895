//! Tests of the crate, in one binary.

mod chips;
mod lease;
mod link;
mod model_verbs;
mod native;
mod native_winch;
mod protocol;
mod serial;
mod stk500;
