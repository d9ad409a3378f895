//! Boards take queue items and make the edges of STEP, DIR and coils: on the PC, on an emulated chip, or at the other end of a cable.
//!
//! # What is here, top down
//! - [`Board`], [`Leased`]: what a session needs of any board, and of one whose plans hold by lease; [`Sizer`]: the room that items take in a queue
//! - [`native`]: the project's stepgen on the PC, in virtual time; [`native_verbs`]: the same, with motors that obey verbs
//! - [`remote`]: a board at the other end of a [`Port`], through [`link`], the host's side of docs/protocol.md; [`BoardClock`]: its clock, as the
//!   host has read it
//! - `serial`: a serial port of this computer, in real time (the feature `serial`); [`shared`]: a port for several hosts
//! - [`WithReference`] (`reference`): any board, next to a native board that gets the same items and so knows the tick of each step
//! - [`replay`]: the steps of motors whose lease ends, computed from the items that were sent
//! - [`BoardKind`] ([`profiles`]): the boards that have a firmware, a folder each: their names, lines, images and virtual boards
//! - [`VirtualBoard`]: what virtual boards have in common. [`virtual_uno`] and [`virtual_pico`] run the firmware on an emulated chip;
//!   [`native_winch`] speaks StepperWinch's text without a firmware; [`skewed`] gives a virtual board a wrong clock; `bridge` times the Uno's USB
//! - [`stk500`]: writes an Uno's flash through its bootloader
//!
//! # What is not
//! Planning is `pulsetrain-plan`'s: a board follows the plan that it gets. Keeping its queues filled is `pulsetrain-session`'s. At the end of a
//! lease a board brakes its motors without a plan; [`replay`] computes the steps of that stop.
//!
//! # Example
//! The firmware of the Uno, on an emulated ATmega328P, says what it is:
//! ```
//! use pulsetrain_board::{BoardKind, Remote, profiles::Role};
//!
//! let kind = BoardKind::named("uno").unwrap();
//! let port = kind.virtual_board(Role::Plans).unwrap();
//! // Each session on a board has another number.
//! let uno = Remote::open(port, 1)?;
//! let info = uno.info();
//! assert_eq!((info.board, info.tick_hz), (kind.number(), 16_000_000));
//! # Ok::<(), pulsetrain_board::RemoteError>(())
//! ```
#![forbid(unsafe_code)]

pub mod bridge;
mod clock;
pub mod lease;
pub mod link;
pub mod native;
pub mod native_verbs;
pub mod native_winch;
mod packer;
pub mod profiles;
pub mod reference;
pub mod remote;
pub mod replay;
#[cfg(feature = "serial")]
pub mod serial;
pub mod shared;
mod sizer;
pub mod skewed;
pub mod stk500;
pub mod virtual_pico;
pub mod virtual_uno;

use pulsetrain_core::wire::message::{Cause, Event};
use pulsetrain_core::{Entry, Epoch};

/// What a session needs of a board. Ticks are those of the board's clock, extended to 64 bits.
///
/// Messages to a board at the end of a cable take time: every method with `&mut self` may let time pass, so that [`now`](Board::now) and
/// [`horizon`](Board::horizon) may be later after it.
pub trait Board {
    /// Appends an item to a motor's queue.
    ///
    /// # Errors
    /// Hands the item back if the queue is full or there is no such motor.
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry>;

    /// Removes the items of `epoch` from the ends of all queues. `epoch` must not have begun.
    fn discard(&mut self, epoch: Epoch);

    /// Free room in a motor's queue, in the unit of [`sizer`](Board::sizer); 0 for a motor that is not there.
    ///
    /// [`push`](Board::push) takes items as long as their sizes fit in it.
    fn room(&self, motor: usize) -> usize;

    /// Measures the items of one epoch, the first one first, in the unit that a motor's queue is measured in.
    fn sizer(&self, motor: usize) -> Sizer;

    /// How long a command and its answer may take, ticks; 0 if no time passes.
    fn round_trip(&self) -> u64;

    /// How long it takes until the board obeys a command that comes behind `bytes` bytes of a plan, if nothing is lost on the way, ticks. A command that
    /// comes later does no harm: the board refuses it.
    fn delivery(&self, bytes: usize) -> u64 {
        let _ = bytes;
        self.round_trip()
    }

    /// How much later a frame comes that was lost once, ticks.
    fn repetition(&self) -> u64 {
        0
    }

    /// The first tick to which no motor is committed yet: a switch is accepted at this tick or later.
    fn horizon(&self) -> u64;

    /// The first tick that has not been passed.
    fn now(&self) -> u64;

    /// The epoch that the motors follow, or followed last.
    fn epoch(&self) -> Epoch;

    /// Lets time pass, up to and with tick `until`.
    fn advance(&mut self, until: u64, observer: &mut impl Observer);

    /// Stops all motors at once, without braking: no step begins after `tick`.
    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport;

    /// Steps forward minus steps backward of each motor, by the pulses that have begun.
    fn positions(&self) -> Vec<i64>;

    /// Whether no step and no end of a pulse is left to do.
    fn is_idle(&self) -> bool;

    /// The faults of a motor; none for a motor that is not there.
    fn faults(&self, motor: usize) -> Faults;

    /// What the board has noticed by itself since the last call, oldest first: [moves done](Cause::MoveDone), faults, and lapses of the lease in
    /// motion with their [cause](Cause::lapse) and tick. An event may get lost with a board: [`Leased::lease`], [`faults`](Board::faults) and
    /// [`is_idle`](Board::is_idle) say what is.
    fn events(&mut self) -> Vec<Event>;

    /// Why the board can no longer be used; `None` while it can.
    fn lost(&self) -> Option<&RemoteError> {
        None
    }

    /// Whether the record of scheduled steps is complete (see [`WithReference`]). If not, that is a fault of this program, and the record proves
    /// nothing.
    fn record_is_complete(&self) -> bool {
        true
    }

    /// Waits until the motors rest, and reads the board's counts. Connects again to a board that was lost, if that is possible. The board must not be
    /// used for motions afterwards.
    ///
    /// # Errors
    /// When the board does not answer.
    fn final_report(&mut self) -> Result<AtRest, RemoteError> {
        Ok(AtRest { positions: self.positions(), last_stop: Cause::Finished, reset: None })
    }
}

/// A board's own report after its motors have come to rest.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AtRest {
    /// Steps forward minus steps backward of each motor; counted from 0 since the reset, if there was one.
    pub positions: Vec<i64>,
    /// The cause of the last stop.
    pub last_stop: Cause,
    /// The cause of a restart during the session; `None` if it did not restart.
    pub reset: Option<Cause>,
}

/// A board in virtual time: time passes only in [`Port::receive`], and every edge of a pin is known.
pub trait VirtualBoard: Port {
    /// Cycles of the board's clock in a second of [`Port::now`].
    fn cycles_per_s(&self) -> u64 {
        virtual_uno::CYCLES_PER_S
    }

    /// The pins that a trace shows, first to last. An Uno's pins 0 and 1 are its serial line, and its last one is A5 (19).
    fn traced(&self) -> std::ops::RangeInclusive<u8> {
        2..=19
    }

    /// Does what DTR does when a program opens the port: the board restarts, if it is wired so. Bytes on their way are lost.
    fn reset(&mut self);

    /// The time of tick 0 of the board's clock, in cycles since time 0 of [`Port::now`]; `None` until that clock runs.
    fn zero(&self) -> Option<u64>;

    /// The rate of the line at the host's end.
    fn baud(&self) -> pulsetrain_core::wire::Baud;

    /// Sets the rate that a client of the port has set, bits a second. Rates that the protocol does not have are ignored.
    ///
    /// # Errors
    /// As [`Port::set_baud`].
    fn set_client_rate(&mut self, rate: u32) -> Result<(), PortError> {
        let baud = pulsetrain_core::wire::Baud::ALL.into_iter().find(|baud| baud.rate() == rate);
        baud.filter(|baud| *baud != self.baud()).map_or(Ok(()), |baud| self.set_baud(baud))
    }

    /// Puts the board behind another chip between its serial line and USB. `false`: there is none, it has USB of its own.
    fn set_bridge(&mut self, _bridge: bridge::Bridge) -> bool {
        false
    }
}

impl<B: VirtualBoard + ?Sized> VirtualBoard for Box<B> {
    fn cycles_per_s(&self) -> u64 {
        (**self).cycles_per_s()
    }

    fn traced(&self) -> std::ops::RangeInclusive<u8> {
        (**self).traced()
    }

    fn reset(&mut self) {
        (**self).reset();
    }

    fn zero(&self) -> Option<u64> {
        (**self).zero()
    }

    fn baud(&self) -> pulsetrain_core::wire::Baud {
        (**self).baud()
    }

    fn set_client_rate(&mut self, rate: u32) -> Result<(), PortError> {
        (**self).set_client_rate(rate)
    }

    fn set_bridge(&mut self, bridge: bridge::Bridge) -> bool {
        (**self).set_bridge(bridge)
    }
}

pub use clock::BoardClock;
pub use lease::{Lease, LeaseState, Leased};
pub use link::{Link, LinkError};
pub use native::{
    Config, Edge, Faults, MotorConfig, Native, Observer, ScheduledStep, StopReport, SwitchRefused, Wiring,
};
pub use profiles::BoardKind;
pub use pulsetrain_emulator::{hex, image};
pub use reference::WithReference;
pub use remote::{Port, PortError, Remote, RemoteError, Setup};
#[cfg(feature = "serial")]
pub use serial::Serial;
pub use sizer::Sizer;
