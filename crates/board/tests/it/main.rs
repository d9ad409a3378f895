//! Tests of the crate, in one binary.

mod chips;
mod lease;
mod leased_link;
mod link;
mod model_verbs;
mod native;
mod native_winch;
mod protocol;
mod serial;
mod stk500;
