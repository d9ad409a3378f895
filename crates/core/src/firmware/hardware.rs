//! What a firmware writes: its motors, its clock, its pins, its line, its memory.

use crate::lease::{Lapse, Lease};
use crate::verbs::{MotorTiming, Verbs};
use crate::wire::message::{Configuration, Info, Measures};
use crate::wire::settings::SETTINGS_LEN;
use crate::wire::{Baud, MAX_MOTORS, Refusal};
use crate::{Epoch, Tick32};
use core::ops::DerefMut;

/// How all motors were stopped at once.
#[derive(Clone, Copy, Debug)]
pub struct Halt {
    /// No step was begun after it.
    pub tick: u64,
    /// Motors that were faster than they can stop at once, bit by motor.
    pub uncertain: u8,
    /// Up to when each motor followed its plan: `tick`, or the end of its words if it ran dry.
    pub reached: [u64; MAX_MOTORS],
}

/// The lease of all motors, as their channels have it.
#[derive(Clone, Copy, Debug)]
pub struct LeaseReport {
    /// The lease that was given last.
    pub lease: Lease,
    /// Its end, if it is over; [`LapseCause::is_fault`](crate::lease::LapseCause::is_fault) comes before others.
    pub lapse: Option<Lapse>,
    /// Whether a motor was in motion then.
    pub was_moving: bool,
    /// The motor that could not follow its plan, if that is the cause; [`ALL_MOTORS`](crate::wire::message::ALL_MOTORS) if that is not known.
    pub at_fault: u8,
}

/// The hardware of a board, for [`FirmwareBoard`](super::FirmwareBoard). It does what it is asked; whether it may be asked was checked before.
/// No method may wait for something.
///
/// Motors are numbered from 0, those of the last [`configure`](Hardware::configure). A method that is called for another motor does nothing.
pub trait Hardware {
    /// What a checked configuration comes to: which pin is which.
    type Layout;

    /// Where the motors' orders are kept: they are large, and a firmware may have no room on its stack.
    type Orders: DerefMut<Target = Verbs>;

    /// What the board is: numbers that never change.
    fn info(&self) -> Info;

    /// The board's clock now, ticks.
    fn now(&mut self) -> u64;

    /// Checks a configuration.
    ///
    /// # Errors
    /// What this board cannot do.
    fn check(&self, configuration: &Configuration<'_>) -> Result<Self::Layout, Refusal>;

    /// Sets up pins and queues, while nothing runs. Positions begin at 0. The enable pin has [its level](Hardware::set_enable) already, and
    /// becomes an output here.
    fn configure(&mut self, layout: &Self::Layout, configuration: &Configuration<'_>);

    /// Sets the level of the enable pin.
    fn set_enable(&mut self, pin: u8, high: bool);

    /// Switches off the current of coils that are driven directly, while nothing runs.
    fn release_coils(&mut self) {}

    /// The number of configured motors.
    fn motors(&self) -> u8;

    /// Starts all motors, at rest, with empty queues and no faults.
    fn start(&mut self);

    /// Stops all motors at once, and empties their queues. Does no harm if they are not started.
    fn stop(&mut self) -> Halt;

    /// Whether at tick `now` no step is left to do, and no end of a pulse. Called every millisecond or so: it also notes the time.
    fn is_idle(&mut self, now: u64) -> bool;

    /// Whether steps came too late to be made, so that all motors must stop at once.
    fn has_underrun(&self) -> bool {
        false
    }

    /// Free bytes in a motor's queue.
    fn free(&self, motor: u8) -> u16;

    /// Appends packed items to a motor's queue: all of them or, with `None`, none as there is no room. Items of an epoch whose lease has
    /// lapsed are dropped.
    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Option<()>;

    /// Removes the items of `epoch` from the ends of all queues.
    fn discard(&mut self, epoch: Epoch);

    /// Begins `epoch` at `tick`, which is not before the horizon and less than 2^30 ahead. `false`, and no motor switches, if one cannot.
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> bool;

    /// Whether [`extend`](Hardware::extend) would be accepted.
    fn can_extend(&self, lease: Lease) -> bool;

    /// Moves the end of the lease, and sets braking limits. It was [asked](Hardware::can_extend) just before.
    fn extend(&mut self, lease: Lease, limits: &[u8]);

    /// Drops bytes from the end of each motor's queue; `bytes` has two for each motor: how many.
    ///
    /// # Errors
    /// The first motor that has fewer. Then nothing is dropped.
    fn take_back(&mut self, bytes: &[u8]) -> Result<(), u8>;

    /// Has all motors brake from the lapse's tick on, if they do not already.
    fn lapse_at(&mut self, lapse: Lapse);

    /// The lease of all motors.
    fn lease(&self) -> LeaseReport;

    /// The first tick that no motor is committed to, not before now.
    fn horizon(&mut self) -> u64;

    /// The epoch being run, or that was run last.
    fn epoch(&self) -> Epoch;

    /// A motor's steps forward minus steps backward, pulses begun, modulo 2^32.
    fn position(&mut self, motor: u8) -> i32;

    /// [`flags`](crate::wire::message::flags) of a motor's queue, since it was started.
    fn faults(&self, motor: u8) -> u8;

    /// What orders may ask of each motor, and its position, at rest.
    fn timings(&self) -> impl Iterator<Item = (MotorTiming, i32)>;

    /// How far ahead of the horizon orders begin, ticks.
    fn foresight(&self) -> u32;

    /// Motors follow orders from now on, until they are stopped. No step of theirs comes before tick `known`.
    fn begin_orders(&mut self, known: u64);

    /// Works out the steps of orders as far as they are needed by now, and puts them into the motors' queues.
    fn plan_orders(&mut self, orders: &mut Verbs);

    /// Fills in what the hardware measures.
    fn measure(&mut self, measures: &mut Measures);

    /// Begins to measure again.
    fn reset_measures(&mut self);

    /// Whether the line can do `baud`.
    fn can_baud(&self, baud: Baud) -> bool {
        let _ = baud;
        true
    }

    /// Changes the rate of the line as soon as all bytes that were handed over are out.
    fn set_baud(&mut self, baud: Baud);

    /// Stores settings, while no motor is powered.
    fn store(&mut self, settings: &[u8; SETTINGS_LEN]);

    /// The stored settings; `None` if there are none, or if they are damaged.
    fn stored(&self) -> Option<[u8; SETTINGS_LEN]>;

    /// Whether the stored settings are damaged.
    fn store_is_damaged(&self) -> bool {
        false
    }

    /// A tick within 2^31 of now, in 64 bits.
    fn widen(&mut self, tick: Tick32) -> u64 {
        let now = self.now();
        now.wrapping_add_signed(tick.since(Tick32::of(now)).cast_signed().into())
    }
}
