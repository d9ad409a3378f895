//! The program for StepperWinch's text: the board works out the paths itself.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch, optimize_attribute)]

#[path = "../../engine/mod.rs"]
mod engine;

mod winch;

use core::arch::global_asm;
use engine::host;
use engine::memory::Singleton;
/// Text, and nothing else.
pub(crate) use winch::Winch as ThisProgram;

// Steps come from the paths.
global_asm!(
    ".global source_limit, source_load, source_due",
    ".set source_limit, winch_limit",
    ".set source_load, winch_load",
    ".set source_due, winch_due",
    // How rings are filled: four motors are merged into one ring, always.
    ".global ring_fill_one, ring_fill_shared, ring_fill_shield, ring_fill_shield_b, ring_merge_three",
    ".set ring_fill_one, steps_absent",
    ".set ring_fill_shared, steps_absent",
    ".set ring_fill_shield, steps_absent",
    ".set ring_fill_shield_b, steps_absent",
    ".set ring_merge_three, steps_absent",
);

static PROGRAM: Singleton<ThisProgram> = Singleton::new(ThisProgram::new());

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    // SAFETY: the start-up code calls main once.
    unsafe { host::main(&PROGRAM) }
}
