//! Tests of the crate, in one binary.
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]

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
