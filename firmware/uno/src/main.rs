//! The firmware of the Arduino Uno.
//!
//! # What is here, top down
//! - [`host`]: start-up and the main loop; in the image that plays what lies behind it, [`baked`]
//! - [`machine`]: what the link asks of a board, done on this one
//! - [`steps`]: from events to edges on the pins
//! - [`link`]: the serial line
//! - [`winch`]: text on it instead of frames, and motors that follow paths
//! - [`verbs`]: motors told directly, in the image that has no text
//! - [`clock`]: Timer1, extended to 64 bits
//! - [`vectors`]: the interrupt vectors, and what comes before main
//! - [`reset`]: the watchdog, and why the program began
//! - [`store`]: settings in the EEPROM
//! - [`memory`]: what the 2048 bytes of RAM are for
//! - [`regs`]: the registers, and instructions that Rust has no words for
//!
//! # Who interrupts whom
//! Step interrupts play what is in the rings and let nobody in, but for one: in the image for the highest rates that of a ring beside a merge lets
//! the merge's in, if that waits ([`steps::ring`]). The receive interrupt takes bytes from the line; the task
//! ([`steps::task`]) keeps the rings filled; both let steps in, and the task lets bytes in. The main loop does all else. What
//! keeps a step waiting, from the match of another interrupt or the first instruction with interrupts off to the first that
//! may be interrupted again (crates/board/tests/it/uno_masked.rs measures it, while motors move):
//!
//! | where | cycles |
//! |---|---|
//! | the task, until it lets others in | 13 |
//! | receive interrupt, until it lets others in | 11; in the image for the highest rates 14 |
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
//! has them; when their steps are due is the recurrence of `pulsetrain_core::narrow::Registers`.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch, optimize_attribute)]

#[cfg(feature = "baked")]
mod baked;
mod clock;
#[cfg(not(feature = "baked"))]
mod host;
#[cfg(not(feature = "baked"))]
mod link;
mod machine;
mod memory;
#[cfg(feature = "baked")]
mod no_host;
mod regs;
mod reset;
mod steps;
#[cfg(text)]
mod store;
mod vectors;
#[cfg(not(feature = "verbs"))]
#[path = "no_verbs.rs"]
mod verbs;
#[cfg(feature = "verbs")]
mod verbs;
#[cfg(text)]
mod winch;
#[cfg(any(feature = "verbs", feature = "stream"))]
#[path = "no_winch.rs"]
mod winch;

use core::panic::PanicInfo;
use machine::Board;
use memory::Once;
#[cfg(feature = "baked")]
use no_host::{link, winch};
use pulsetrain_core::Moment;
use pulsetrain_core::wire::Millis;

/// The image is the one for the highest rates: frames alone, and the longer code that is faster.
pub(crate) const STREAM: bool = cfg!(feature = "stream");

static BOARD: Once<Board> = Once::new(Board::new());

/// Ticks / 2^14: 1.024 ms each.
#[inline(always)]
fn millis(now: Moment) -> Millis {
    let [_, b1, b2, b3] = now.0.to_le_bytes();
    // Shifted by bytes first: an AVR shifts by one bit at a time.
    Millis((u32::from_le_bytes([b1, b2, b3, 0]) >> 6) as u16)
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    reset::end()
}
