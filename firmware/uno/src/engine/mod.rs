//! The step engine of the Arduino Uno, and what its four programs have in common.
//!
//! # Programs
//! | program | what it is for | what it has beside the engine |
//! |---|---|---|
//! | `src/bin/uno` | plans that a host sends in frames | [`host`], records of packed segments |
//! | `src/bin/uno-winch` | StepperWinch's text | [`host`], a reader of lines, paths |
//! | `src/bin/uno-verbs` | motors told directly, in frames | [`host`], verbs |
//! | `src/bin/uno-baked` | a motion that lies behind it in the flash | records of packed segments, a player |
//!
//! Each says in its `main.rs` what it uses: a [`Program`], and the symbols that [`program`] lists.
//!
//! # What is here, top down
//! - [`host`]: the main loop of a board that has a host
//! - [`machine`]: what the link asks of a board, done on this one
//! - [`steps`]: from events to edges on the pins
//! - [`link`]: the serial line
//! - [`clock`]: Timer1, extended to 64 bits
//! - [`vectors`]: the interrupt vectors, and what comes before main
//! - [`reset`]: the watchdog, and why the program began
//! - [`store`]: settings in the EEPROM
//! - [`memory`]: what the 2048 bytes of RAM are for
//! - [`regs`]: the registers, and instructions that Rust has no words for
//!
//! # Who interrupts whom
//! Step interrupts play what is in the rings and let nobody in, but for one: that of a ring beside a merge lets
//! the merge's in, if that waits ([`steps::ring`]). The receive interrupt takes bytes from the line; the task
//! ([`steps::task`]) keeps the rings filled; both let steps in, and the task lets bytes in. The main loop does all else. What
//! keeps a step waiting, from the match of another interrupt or the first instruction with interrupts off to the first that
//! may be interrupted again (crates/board/tests/it/chips/uno_masked.rs measures it, while motors move):
//!
//! | where | cycles |
//! |---|---|
//! | the task, until it lets others in | 13 |
//! | receive interrupt, until it lets others in | 14 |
//! | receive interrupt, its end | 8, and the instruction behind it |
//! | the same where it lets nobody in ([`link`]) | 30, at the end of its page 41, after bytes that were lost 14 more, and the instruction behind it |
//! | a step interrupt that has let another in, its end | 28 |
//! | reading Timer1, setting its registers | up to 8 |
//! | falling asleep | 5; only while nothing moves, and 4 more to wake up |
//! | moving the stack pointer (the compiler's) | 3 |
//!
//! Two of them may follow each other. Pins and rates are set at rest, with up to 16, and settings are read, with up to 20.
//!
//! # What is not
//! Motion, but for the winch's paths: segments come from the host, or from the flash, as `pulsetrain_core::packing`
//! has them; when their steps are due is the recurrence of `pulsetrain_core::avr::Registers`.
#![allow(dead_code, reason = "a program uses a part of it")]

pub(crate) mod clock;
pub(crate) mod host;
pub(crate) mod link;
pub(crate) mod machine;
pub(crate) mod memory;
pub(crate) mod program;
pub(crate) mod regs;
pub(crate) mod reset;
pub(crate) mod steps;
pub(crate) mod store;
pub(crate) mod tuning;
pub(crate) mod vectors;

pub(crate) use core::panic::PanicInfo;
use machine::Board;
use memory::Once;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::Millis;

pub(crate) static BOARD: Once<Board> = Once::new(Board::new());

/// Ticks / 2^14: 1.024 ms each.
#[inline(always)]
pub(crate) fn millis(now: Tick32) -> Millis {
    let [_, b1, b2, b3] = now.0.to_le_bytes();
    // Shifted by bytes first: an AVR shifts by one bit at a time.
    Millis((u32::from_le_bytes([b1, b2, b3, 0]) >> 6) as u16)
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    reset::end()
}
