//! The times of a configuration, where the assembly finds them.

use core::cell::UnsafeCell;
use core::mem::offset_of;
use pulsetrain_core::Tick32;

/// Ticks. The assembly knows the layout.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(crate) struct Times {
    /// Nothing is planned beyond this.
    pub(crate) limit: Tick32,
    /// From a step to the next, at least.
    pub(crate) gap: u16,
    /// From a step until DIR may be turned.
    pub(crate) keep: u16,
    /// From a turn of DIR to the step that it is for, at least.
    pub(crate) lead: u16,
    /// The same, if there is time.
    pub(crate) early: u16,
    /// Between steps that are made without being looked at, at least.
    pub(crate) fastest: u16,
    /// From a step's tick to the group that ends its pulse; 0: the pulse is a short one, and of the same group.
    pub(crate) pulse: u16,
    /// Steps planned at once, at most.
    pub(crate) most: u8,
    /// Motors share DIR lines: each step is looked at by itself.
    pub(crate) shared: bool,
    /// Not 0 while a motor is asked for steps alone; with the bit [`AHEAD`] only to see to records and switches: what it answers is not to be used.
    pub(crate) only_steps: u8,
}

impl Times {
    /// Before the first configuration. Zeros take no flash.
    const NONE: Times = Times {
        limit: Tick32(0),
        gap: 0,
        keep: 0,
        lead: 0,
        early: 0,
        fastest: 0,
        pulse: 0,
        most: 0,
        shared: false,
        only_steps: 0,
    };
}

/// At an address that the assembly knows.
pub(crate) struct Cell(UnsafeCell<Times>);

// SAFETY: it belongs to whoever has the stepper: main under a guard, or the task.
unsafe impl Sync for Cell {}

/// The one.
#[unsafe(export_name = "steps_times")]
pub(crate) static TIMES: Cell = Cell(UnsafeCell::new(Times::NONE));

impl Cell {
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
pub(crate) const GAP: usize = offset_of!(Times, gap);
pub(crate) const KEEP: usize = offset_of!(Times, keep);
pub(crate) const LEAD: usize = offset_of!(Times, lead);
pub(crate) const EARLY: usize = offset_of!(Times, early);
pub(crate) const FASTEST: usize = offset_of!(Times, fastest);
pub(crate) const PULSE: usize = offset_of!(Times, pulse);
pub(crate) const MOST: usize = offset_of!(Times, most);
pub(crate) const SHARED: usize = offset_of!(Times, shared);
pub(crate) const ONLY_STEPS: usize = offset_of!(Times, only_steps);

/// A bit of [`Times::only_steps`], by number.
pub(crate) const AHEAD: u8 = 7;
