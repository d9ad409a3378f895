//! Boards: what takes queue items and makes edges.
//!
//! # What is here, top down
//! - [`Board`]: what a session needs of any board
//! - [`Leased`]: what it needs of one whose plans hold by lease
//! - [`Sizer`]: what items take in its queues
//! - [`native`]: the project's own stepgen on the PC, in virtual time
//! - [`replay`]: what motors do whose lease ends, worked out by the host
//! - [`native_verbs`]: the same with motors that are told directly
//! - [`remote`]: a board at the other end of a [`Port`], through `link`, the host's side of docs/protocol.md
//! - `serial`: a real serial port, in real time (behind the feature of that name); [`stk500`]: an Uno's bootloader, at any port
//! - [`WithReference`] (`reference`): any board, and a native board that receives the same: what was scheduled, and what came of it
//! - [`virtual_uno`], [`virtual_pico`]: the Uno's and the Pico's firmware on an emulated chip, as such a port; `bridge`: the Uno's
//!   USB, as far as time goes
//! - [`native_winch`]: StepperWinch's text with core's own code instead of a firmware, as such a port
//! - [`BoardKind`], [`registry`]: the boards that have a firmware: names, rates, images, virtual boards
//! - [`VirtualBoard`]: what all of them can do; [`skewed`]: one whose clock is off; [`shared`]: a port for several hosts
//! - [`BoardClock`]: such a board's clock, as the host sees it
//!
//! # What is not
//! Motion: a board does what was planned. The one motion that it makes by itself is the stop at a lease's end, which [`replay`] works out
//! beforehand. Planning is `pulsetrain-plan`'s, keeping a queue filled the
//! session's in `pulsetrain`.
#![forbid(unsafe_code)]

mod bridge;
mod clock;
pub mod lease;
pub mod link;
pub mod native;
pub mod native_verbs;
pub mod native_winch;
mod packer;
pub mod reference;
pub mod registry;
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

use pulsetrain_core::wire::message::Cause;
use pulsetrain_core::{Entry, Epoch};

/// What a session needs of a board.
///
/// A board at the end of a cable needs time to be told: whatever has `&mut self` may let time pass, so that
/// [`now`](Board::now) and [`horizon`](Board::horizon) are later after it than before.
pub trait Board {
    /// Puts an item last in a motor's queue.
    ///
    /// # Errors
    /// A full queue hands it back, and so does a motor that is not there.
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry>;

    /// Takes back the items of `epoch` that were pushed last, of all motors.
    fn discard(&mut self, epoch: Epoch);

    /// Free room in a motor's queue, in the unit of [`sizer`](Board::sizer); 0 for a motor that is not there.
    ///
    /// [`push`](Board::push) takes items as long as their sizes fit in it.
    fn room(&self, motor: usize) -> usize;

    /// Measures the items of one epoch, the first one first, in the unit that a motor's queue is measured in.
    fn sizer(&self, motor: usize) -> Sizer;

    /// How long it may take to tell the board a thing and to hear that it was accepted, ticks; 0 if no time passes.
    fn lead(&self) -> u64;

    /// The first tick that is open on all motors: a switch is accepted from there on.
    fn horizon(&self) -> u64;

    /// The first tick that has not been passed.
    fn now(&self) -> u64;

    /// The epoch that is being run, or that was run last.
    fn epoch(&self) -> Epoch;

    /// Lets time pass, up to and with tick `until`.
    fn advance(&mut self, until: u64, observer: &mut impl Observer);

    /// The immediate, unplanned stop: no step begins after `tick`.
    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport;

    /// Steps forward minus steps backward of each motor: pulses begun so far.
    fn positions(&self) -> Vec<i64>;

    /// Whether nothing is left to do: no step, no end of a pulse.
    fn is_idle(&self) -> bool;

    /// What went wrong on a motor.
    fn faults(&self, motor: usize) -> Faults;

    /// Why the board cannot be told anything any more, if it cannot.
    fn lost(&self) -> Option<&RemoteError> {
        None
    }

    /// Whether its record of scheduled steps is complete. `false` is a fault of this program: that record then proves nothing.
    fn agrees(&self) -> bool {
        true
    }

    /// Lets the motors come to rest, and says what the board counted: also one that was lost, if it can be found again. Nothing is
    /// to be told to it afterwards.
    ///
    /// # Errors
    /// When it cannot be asked.
    fn settle(&mut self) -> Result<AtRest, RemoteError> {
        Ok(AtRest { positions: self.positions(), last_stop: Cause::Finished, reset: None })
    }
}

/// How a board fared, by its own word.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AtRest {
    /// Steps forward minus steps backward of each motor; from 0 on, if it was reset.
    pub positions: Vec<i64>,
    /// Why its motors stopped last.
    pub last_stop: Cause,
    /// Why it restarted, if it did since it was taken.
    pub reset: Option<Cause>,
}

/// A board in virtual time: time passes only while someone receives, and every edge of a pin is known.
pub trait VirtualBoard: Port {
    /// Ticks of [`Port::now`] in a second.
    fn cycles_per_s(&self) -> u64 {
        virtual_uno::CYCLES_PER_S
    }

    /// The first and the last pin whose edges are worth a trace; an Uno's serial line is 0 and 1, its last pin A5.
    fn traced(&self) -> std::ops::RangeInclusive<u8> {
        2..=19
    }

    /// What DTR does as a program opens the port: the board starts again, if it is wired so. Bytes under way are lost.
    fn reset(&mut self);

    /// Tick 0 of the board's own clock, in ticks of [`Port::now`]'s; `None` until it runs.
    fn zero(&self) -> Option<u64>;

    /// The rate of the line.
    fn baud(&self) -> pulsetrain_core::wire::Baud;

    /// Takes on the rate that a client set, bits a second, if the board's end can.
    ///
    /// # Errors
    /// As [`Port::set_baud`].
    fn follow(&mut self, rate: u32) -> Result<(), PortError> {
        let baud = pulsetrain_core::wire::Baud::ALL.into_iter().find(|baud| baud.rate() == rate);
        baud.filter(|baud| *baud != self.baud()).map_or(Ok(()), |baud| self.set_baud(baud))
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

    fn follow(&mut self, rate: u32) -> Result<(), PortError> {
        (**self).follow(rate)
    }
}

pub use clock::BoardClock;
pub use lease::{Lease, LeaseState, Leased};
pub use link::{Link, LinkError};
pub use native::{
    Config, Edge, Faults, MotorConfig, Native, Observer, ScheduledStep, StopReport, SwitchRefused, Wiring,
};
pub use pulsetrain_emulator::{hex, image};
pub use reference::WithReference;
pub use registry::BoardKind;
pub use remote::{Port, PortError, Remote, RemoteError, Setup};
#[cfg(feature = "serial")]
pub use serial::Serial;
pub use sizer::Sizer;
