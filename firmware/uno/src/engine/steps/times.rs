//! The times of a configuration, where the assembly finds them.

use core::cell::UnsafeCell;
use core::mem::offset_of;
use pulsetrain_core::Moment;

/// Ticks. The assembly knows the layout.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(crate) struct Times {
    /// Nothing is planned beyond this.
    pub(crate) limit: Moment,
    /// From a step to the next, at least.
    pub(crate) step_gap: u16,
    /// From a step until DIR may be turned.
    pub(crate) dir_hold: u16,
    /// From a turn of DIR to the step that it is for, at least.
    pub(crate) dir_setup: u16,
    /// The same, if there is time.
    pub(crate) dir_early: u16,
    /// Between steps that are made without being looked at, at least.
    pub(crate) min_interval: u16,
    /// From a step's tick to the group that ends its pulse; 0: the pulse is a short one, and of the same group.
    pub(crate) pulse: u16,
    /// Steps planned at once, at max_steps.
    pub(crate) max_steps: u8,
    /// Motors share DIR lines: each step is looked at by itself.
    pub(crate) shared: bool,
    /// Not 0 while a motor is asked for steps alone; with the bit [`PREFETCH`] only to see to records and switches: what it answers is not to be used.
    pub(crate) only_steps: u8,
}

impl Times {
    /// Before the first configuration. Zeros take no flash.
    const NONE: Times = Times {
        limit: Moment(0),
        step_gap: 0,
        dir_hold: 0,
        dir_setup: 0,
        dir_early: 0,
        min_interval: 0,
        pulse: 0,
        max_steps: 0,
        shared: false,
        only_steps: 0,
    };
}

/// At an address that the assembly knows.
pub(crate) struct TimesCell(UnsafeCell<Times>);

// SAFETY: it belongs to whoever has the stepper: main under a guard, or the task.
unsafe impl Sync for TimesCell {}

/// The one.
#[unsafe(export_name = "steps_times")]
pub(crate) static TIMES: TimesCell = TimesCell(UnsafeCell::new(Times::NONE));

impl TimesCell {
    #[inline(always)]
    pub(crate) fn get(&self) -> Times {
        // SAFETY: a copy, made by who has the stepper, who alone writes it.
        unsafe { *self.0.get() }
    }

    /// What main may ask at any time: it alone changes that, at rest.
    #[inline(always)]
    pub(crate) fn is_shared(&self) -> bool {
        // SAFETY: a byte, which nobody writes meanwhile.
        unsafe { (&raw const (*self.0.get()).shared).read_volatile() }
    }

    #[inline(always)]
    pub(crate) fn set(&self, times: Times) {
        // SAFETY: who has the stepper alone uses it, and holds no reference.
        unsafe { *self.0.get() = times }
    }
}

/// Offsets for the assembly.
pub(crate) const LIMIT: usize = offset_of!(Times, limit);
pub(crate) const STEP_GAP: usize = offset_of!(Times, step_gap);
pub(crate) const DIR_HOLD: usize = offset_of!(Times, dir_hold);
pub(crate) const DIR_SETUP: usize = offset_of!(Times, dir_setup);
pub(crate) const DIR_EARLY: usize = offset_of!(Times, dir_early);
pub(crate) const MIN_INTERVAL: usize = offset_of!(Times, min_interval);
pub(crate) const PULSE: usize = offset_of!(Times, pulse);
pub(crate) const MAX_STEPS: usize = offset_of!(Times, max_steps);
pub(crate) const SHARED: usize = offset_of!(Times, shared);
pub(crate) const ONLY_STEPS: usize = offset_of!(Times, only_steps);

/// A bit of [`Times::only_steps`], by number.
pub(crate) const PREFETCH: u8 = 7;
