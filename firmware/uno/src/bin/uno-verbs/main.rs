//! The program for motors that get orders in frames: a speed, a move, a direction.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch, optimize_attribute)]

#[path = "../../engine/mod.rs"]
mod engine;

mod verbs;

use core::arch::global_asm;
use engine::host;
use engine::memory::Singleton;
/// Verbs, and nothing else.
pub(crate) use verbs::VerbsProgram as ThisProgram;

// Steps come from orders.
global_asm!(
    ".global source_limit, source_load, source_due",
    ".set source_limit, verbs_limit",
    ".set source_load, verbs_load",
    ".set source_due, verbs_due_soon",
    // How rings are filled: by one motor. Shared DIR lines and ring B of the shield are not supported here.
    ".global ring_fill_one, ring_fill_shared, ring_fill_shield, ring_fill_shield_b, ring_merge_three",
    ".set ring_fill_one, one_motor_fill",
    ".set ring_fill_shared, steps_absent",
    ".set ring_fill_shield, steps_absent",
    ".set ring_fill_shield_b, steps_absent",
    ".set ring_merge_three, steps_absent",
);

static PROGRAM: Singleton<ThisProgram> = Singleton::new(ThisProgram);

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    // SAFETY: the start-up code calls main once.
    unsafe { host::main(&PROGRAM) }
}
