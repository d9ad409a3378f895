//! The step engine of the Arduino Uno, and what its four programs have in common.
//!
//! # Programs
//! | program | what it is for | what it adds to the engine |
//! |---|---|---|
//! | `src/bin/uno` | plans that a host sends in frames | [`host`], records of packed segments |
//! | `src/bin/uno-winch` | StepperWinch's text | [`host`], a reader of lines, paths |
//! | `src/bin/uno-verbs` | orders to motors, in frames | [`host`], evenly spaced steps |
//! | `src/bin/uno-baked` | a motion that is stored behind it in the flash | records of packed segments, a player |
//!
//! Each `main.rs` says what its program uses: a [`Program`](program::Program), and the routines that [`program`] lists.
//!
//! # What is here, top down
//! - [`host`]: the main loop of a board that has a host
//! - [`machine`]: the board's side of the wire protocol
//! - [`steps`]: from records to edges on the pins
//! - [`link`]: the serial line
//! - [`clock`]: Timer1, extended to 64 bits
//! - [`vectors`]: the interrupt vectors, and what runs before main
//! - [`reset`]: the watchdog, and why the program began
//! - [`store`]: settings in the EEPROM
//! - [`memory`]: what the 2048 bytes of RAM are for
//! - [`regs`]: the registers, and instructions that Rust has no names for
//!
//! # Who interrupts whom
//! - Step interrupts (TIMER1_COMPA, TIMER1_COMPB) play the rings and let nobody in. There is one exception: on the shield the interrupt of
//!   ring B lets that of ring A in if it waits ([`steps::ring`]).
//! - The receive interrupt (USART_RX) takes bytes from the line. It lets step interrupts in.
//! - The refill interrupt (TIMER0_OVF, [`steps::refill`]) keeps the rings filled. It lets step interrupts and the receive interrupt in.
//! - The main loop does all else.
//!
//! This keeps a step interrupt waiting, counted from the match of another interrupt, or the first instruction with interrupts off, to the first
//! instruction that may be interrupted again. crates/board/tests/it/chips/uno_masked.rs measures it while motors move:
//!
//! | where | cycles |
//! |---|---|
//! | refill interrupt, until it lets others in | 13 |
//! | receive interrupt, until it lets others in | 14 |
//! | receive interrupt, its end | 8, and the next instruction |
//! | receive interrupt while it does not nest ([`link`]) | 30; at the end of its page 41; after lost bytes 14 more; and the next instruction |
//! | a step interrupt that has let another in, its end | 28 |
//! | reading Timer1, setting its registers | up to 8 |
//! | falling asleep | 5; only while nothing moves, and 4 more to wake up |
//! | moving the stack pointer (the compiler does) | 3 |
//!
//! Two of them may follow each other. While motors rest, setting pins and baud rates takes up to 16, and reading settings up to 20.
//!
//! # What is not here
//! Motion, except the winch's paths. Segments come from the host or the flash, in the format of `pulsetrain_core::packing`. The recurrence that gives
//! the tick of each step is that of `pulsetrain_core::avr::Registers`.
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
use memory::Singleton;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::Millis;

pub(crate) static BOARD: Singleton<Board> = Singleton::new(Board::new());

/// The clock in units of 2^14 ticks: 1.024 ms each.
#[inline(always)]
pub(crate) fn millis(now: Tick32) -> Millis {
    let [_, b1, b2, b3] = now.0.to_le_bytes();
    // By whole bytes first: an AVR shifts by one bit at a time.
    Millis((u32::from_le_bytes([b1, b2, b3, 0]) >> 6) as u16)
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    reset::end()
}
