//! An ARMv6-M processor: the Cortex-M0+, apart from any chip.
//!
//! # What is here
//! - [`Cpu`]: registers, all instructions of ARMv6-M with the cycles of the Cortex-M0+ (TRM DDI 0484C, r0p1, table 3-1,
//!   with the single-cycle multiplier), exceptions, NVIC, SysTick, sleep
//! - [`Bus`]: what the chip around it answers; [`Size`], [`BusFault`]
//!
//! # What is not
//! Memory and peripherals (the chip's), the MPU (its registers read 0: none), debugging (`bkpt` is a HardFault, as
//! without a debugger), the vector table's bounds.
//!
//! # Cycles
//! The counts are those of a memory without wait states; what the [`Bus`] waits is added. TRM §3.6.1 gives 15 cycles
//! from the interrupt to its handler's first instruction, and nothing for the way back. The 15 are 12 for stacking, in
//! which a more urgent interrupt may arrive late, and 3 for the vector. The return takes the 11 cycles of a `pop` of
//! eight registers with the program counter, after the `bx` or `pop` that asked for it; a tail-chained handler begins 3
//! cycles after it. An interrupt that comes during `ldm`, `stm`, `push` or `pop` waits for its end; the chip abandons
//! the instruction and begins it anew afterwards.

mod bus;
mod cpu;
mod decode;
mod exception;
mod execute;
mod fault;
mod nvic;
mod system;
mod systick;

pub use bus::{Bus, BusFault, Size};
pub use cpu::{Config, Cpu, Mode};
pub use fault::{Fault, FaultCause};
