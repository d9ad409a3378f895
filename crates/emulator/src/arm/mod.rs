//! The processors by themselves, without a chip: the Cortex-M0+ (ARMv6-M ARM DDI 0419E; TRM DDI 0484C, r0p1) and the
//! Cortex-M3 (ARMv7-M ARM DDI 0403E; TRM DDI 0337, r2p0).
//!
//! # What is here
//! - [`Cpu`], [`CortexM3`]: registers, all instructions with their cycles, exceptions, NVIC, SysTick, sleep. Both are
//!   [`Core`], which has what they share; [`Variant`] is what they do not
//! - [`Bus`]: the interface that a chip implements; [`Size`], [`BusFault`]
//! - [`Fault`], [`FaultCause`]: why the processor took a fault exception
//!
//! # What is not
//! Memory and peripherals: they belong to the chip. The MPU: its registers read 0, which means that there is none.
//! Debugging: `bkpt` is a HardFault, as on a chip without a debugger. A check that the vector table has an entry for
//! every exception.
//!
//! # Cycles of the Cortex-M0+
//! Those of TRM table 3-1, with the single-cycle multiplier. Those of the Cortex-M3: [`CortexM3`].
//!
//! The counts are those of memory without wait states; the wait cycles of the [`Bus`] are added.
//!
//! TRM §3.6.1 gives 15 cycles from the interrupt to its handler's first instruction, and nothing for the return. Here
//! the 15 are 12 for saving the registers, during which a more urgent interrupt may still arrive, and 3 for the vector.
//! The return takes 11 cycles, as a `pop` of eight registers with the program counter, after the `bx` or `pop` that
//! started it. A tail-chained handler begins 3 cycles after that instruction.
//!
//! An interrupt that comes during `ldm`, `stm`, `push` or `pop` waits for the end of the instruction. A real processor
//! abandons the instruction and executes it again after the handler.

mod bus;
mod cpu;
mod decode;
mod exception;
mod execute;
mod fault;
mod m0plus;
mod m3;
mod nvic;
mod system;
mod systick;
mod variant;

pub use bus::{Bus, BusFault, Size};
pub use cpu::{Config, Core, Cpu, Mode};
pub use fault::{Fault, FaultCause};
pub use m0plus::M0Plus;
pub use m3::{CortexM3, M3, M3Options};
pub use variant::Variant;
