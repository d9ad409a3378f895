//! The program for plans that a host sends in frames.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch, optimize_attribute)]

#[path = "../../engine/mod.rs"]
mod engine;

use core::arch::global_asm;
use engine::host;
use engine::memory::Singleton;
use engine::program::Program;
use pulsetrain_core::wire::message::image;

/// Plans, and nothing else.
pub(crate) struct ThisProgram;

impl Program for ThisProgram {
    const IMAGE: u8 = image::PLANS;
    const PLANS: bool = true;
    const LEASES: bool = true;
    const THREE_LANES: bool = true;
    const POOL: usize = pulsetrain_core::boards::uno::QUEUE_BYTES;
}

// Steps come from records in the queues, and from braking.
global_asm!(
    ".global source_limit, source_load, source_due",
    ".set source_limit, limit_leased",
    ".set source_load, load_leased",
    ".set source_due, steps_due",
    // How rings are filled: by one motor, by motors that share DIR lines, and on the shield, where the motor on PORTB has a ring of its own.
    ".global ring_fill_one, ring_fill_shared, ring_fill_shield, ring_fill_shield_b, ring_merge_three",
    ".set ring_fill_one, one_motor_fill",
    ".set ring_fill_shared, shared_fill",
    ".set ring_fill_shield, shield_fill",
    ".set ring_fill_shield_b, shield_b_fill",
    ".set ring_merge_three, merge_three",
);

static PROGRAM: Singleton<ThisProgram> = Singleton::new(ThisProgram);

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    // SAFETY: the start-up code calls main once.
    unsafe { host::main(&PROGRAM) }
}
