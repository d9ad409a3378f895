//! The program without a host: it plays the motion that is stored behind it in the flash.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch, optimize_attribute)]

#[path = "../../engine/mod.rs"]
mod engine;

mod baked;

use core::arch::global_asm;
use engine::program::Program;

/// Plans, and no line to a host.
pub(crate) struct ThisProgram;

impl Program for ThisProgram {
    const IMAGE: u8 = 0;
    const PLANS: bool = true;
    const SHIELD_B: bool = false;
    const THREE_LANES: bool = true;
}

// Steps come from records in the queues.
global_asm!(
    ".global source_limit, source_load, source_due",
    ".set source_limit, steps_limit",
    ".set source_load, steps_load_record",
    ".set source_due, steps_due",
    // How rings are filled: by one motor, and by motors that share DIR lines. Ring B of the shield is not supported here.
    ".global ring_fill_one, ring_fill_shared, ring_fill_shield, ring_fill_shield_b, ring_merge_three",
    ".set ring_fill_one, one_motor_fill",
    ".set ring_fill_shared, shared_fill",
    ".set ring_fill_shield, steps_absent",
    ".set ring_fill_shield_b, steps_absent",
    ".set ring_merge_three, merge_three",
);

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    // SAFETY: the start-up code calls main once.
    unsafe { baked::main() }
}
