//! The program for plans that a host sends in frames.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch, optimize_attribute)]

#[path = "../../engine/mod.rs"]
mod engine;

use core::arch::global_asm;
use engine::host;
use engine::memory::Once;
use engine::program::Program;
use pulsetrain_core::wire::message::image;

/// Plans, and nothing else.
pub(crate) struct Uses;

impl Program for Uses {
    const IMAGE: u8 = image::PLANS;
    const PLANS: bool = true;
    const LEASES: bool = true;
    const POOL: usize = 376;
}

// Steps come from records in the queues, and from braking.
global_asm!(
    ".global source_limit, source_load, source_due",
    ".set source_limit, steps_limit_leased",
    ".set source_load, steps_load_leased",
    ".set source_due, steps_due",
    // How rings are filled: of one motor each, of motors that share DIR lines, and of one motor beside a merge.
    ".global ring_apiece, ring_shared, ring_beside, ring_beside_soon, ring_beside_merge",
    ".set ring_apiece, steps_fill",
    ".set ring_shared, steps_fill_shared",
    ".set ring_beside, steps_beside_turns",
    ".set ring_beside_soon, beside_fill",
    ".set ring_beside_merge, merge_beside",
);

static USES: Once<Uses> = Once::new(Uses);

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    // SAFETY: the start-up code calls main once.
    unsafe { host::main(&USES) }
}
