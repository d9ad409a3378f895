//! The times of a configuration, where the assembly finds them.

use core::cell::UnsafeCell;
use core::mem::offset_of;
use pulsetrain_core::Tick32;

/// All in ticks. The assembly knows the layout.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(crate) struct Times {
    /// Nothing is planned after this tick.
    pub(crate) limit: Tick32,
    /// From a step to the next, at least. A step that would come sooner is an error.
    pub(crate) step_gap: u16,
    /// From a step until DIR may be turned: the pulse, and DIR's hold time.
    pub(crate) dir_hold: u16,
    /// From a turn of DIR to its step, at least: DIR's set-up time.
    pub(crate) dir_setup: u16,
    /// From a turn of DIR to its step, if there is time.
    pub(crate) dir_early: u16,
    /// Between steps that are made in batches, at least. A shorter interval makes single events.
    pub(crate) min_interval: u16,
    /// From a step's group to the group that ends its pulse. 0: the pulse is short, and ends within the step's group.
    pub(crate) pulse: u16,
    /// Steps that may be planned at once.
    pub(crate) max_steps: u8,
    /// Motors share DIR lines: each step is a single event.
    pub(crate) shared: bool,
    /// Not 0: a motor is asked for steps alone, not for events. With the bit [`PREFETCH`] it only loads records and makes switches, and the answer is not
    /// used.
    pub(crate) only_steps: u8,
}

impl Times {
    /// Before the first configuration. Zeros take no flash.
    const NONE: Times = Times {
        limit: Tick32(0),
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

// SAFETY: it belongs to whoever has the stepper: main under a guard, or the refill interrupt.
unsafe impl Sync for TimesCell {}

/// The times of the configuration.
#[unsafe(export_name = "steps_times")]
pub(crate) static TIMES: TimesCell = TimesCell(UnsafeCell::new(Times::NONE));

impl TimesCell {
    #[inline(always)]
    pub(crate) fn get(&self) -> Times {
        // SAFETY: a copy. Whoever has the stepper alone writes it, and that is the caller.
        unsafe { *self.0.get() }
    }

    /// Main may ask this at any time, since main alone changes it, at rest.
    #[inline(always)]
    pub(crate) fn is_shared(&self) -> bool {
        // SAFETY: one byte, which nobody writes meanwhile.
        unsafe { (&raw const (*self.0.get()).shared).read_volatile() }
    }

    #[inline(always)]
    pub(crate) fn set(&self, times: Times) {
        // SAFETY: whoever has the stepper alone uses it, and holds no reference.
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
