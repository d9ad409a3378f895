//! Boards: what takes queue items and makes edges.
//!
//! # What is here, top down
//! - [`Board`]: what a session needs of any board
//! - [`native`]: the project's own stepgen on the PC, in virtual time
//!
//! # What is not
//! Motion: a board does what was planned and invents nothing. Planning is `pulsetrain-plan`'s, keeping a queue filled the
//! session's in `pulsetrain`.
#![forbid(unsafe_code)]

pub mod native;

use pulsetrain_core::{Entry, Epoch};

/// What a session needs of a board.
pub trait Board {
    /// Puts an item last in a motor's queue.
    ///
    /// # Errors
    /// A full queue hands it back, and so does a motor that is not there.
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry>;

    /// Takes back the items of `epoch` that were pushed last, of all motors.
    fn discard(&mut self, epoch: Epoch);

    /// Free places in a motor's queue; 0 for a motor that is not there.
    fn credit(&self, motor: usize) -> usize;

    /// At `tick`, all motors drop what is left of the old epoch and begin `epoch`.
    ///
    /// # Errors
    /// All motors or none: when one refuses, the items of `epoch` are dropped, and the old plan goes on.
    fn switch(&mut self, epoch: Epoch, tick: u64) -> Result<(), SwitchRefused>;

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
}

pub use native::{
    Config, Edge, Faults, MotorConfig, Native, Observer, ScheduledStep, StopReport, SwitchRefused, Wiring,
};
