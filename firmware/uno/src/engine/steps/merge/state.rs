//! The state of the merge, where the assembly finds it.

use super::{LANES, LIST};
use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::steps::register;
use crate::engine::steps::ring::{END_A, END_B, Group, RingName, SHORT_RING_START};
use crate::engine::tuning::merge::{LIST_LOW_OF_MORE, LIST_LOW_OF_SHIELD, LIST_LOW_OF_TWO, MAX_DELAY_SHIELD};
use core::mem::offset_of;

/// One motor's list.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(super) struct Lane {
    /// What the ticks in the list toggle.
    pub(super) masks: Group,
    /// The list's first tick, which has been taken out of it.
    pub(super) head: u16,
    /// Low byte of the address of its second tick.
    pub(super) next: u8,
}

/// State of the merge; the assembly knows its layout.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct Merge {
    pub(super) lanes: [Lane; LANES],
    /// The tick of the pending group + W.
    pub(super) deadline: u16,
    /// What the pending group toggles.
    pub(super) pending: Group,
    /// Low byte of the address of the pending group.
    pub(super) at: u8,
    /// The ring's END bit.
    pub(super) end: u8,
    /// How far a tick is put off at most: W/2, or less with ring B of the shield; and W.
    pub(super) half: u8,
    pub(super) spacing: u8,
    /// Data address of the ring's tail.
    pub(super) tail: u8,
    /// How often the merge may still look for more room before it returns.
    pub(super) passes: u8,
    /// How many lists it may still fill before it returns; the line waits meanwhile.
    pub(super) lists_left: u8,
    /// A list with fewer bytes is topped up.
    pub(super) list_low: u8,
    /// The lane without a head, or [`NONE`].
    pub(super) empty_lane: u8,
    /// How many motors are merged.
    pub(super) motors: u8,
    /// Where the third list ends: low byte of the address after it. Bit 5 says that the list is [short](SHORT_LIST).
    pub(super) third_end: u8,
}

pub(super) const LANE_SIZE: usize = size_of::<Lane>();
/// Where the number of motors is, for assembly.
pub(super) const MOTORS: usize = offset_of!(Merge, motors);

/// [`Merge::empty_lane`]: all lanes have heads.
pub(super) const NONE: u8 = 255;

/// The merge, which the assembly knows by this name. Zeros, which take no flash. Call [`Merge::begin`] before its use.
#[unsafe(export_name = "steps_merge")]
static mut MERGE: Merge = Merge {
    lanes: [Lane { masks: Group::NOTHING, head: 0, next: 0 }; LANES],
    deadline: 0,
    pending: Group::NOTHING,
    at: 0,
    end: 0,
    half: 0,
    spacing: 0,
    tail: 0,
    passes: 0,
    lists_left: 0,
    list_low: 0,
    empty_lane: 0,
    motors: 0,
    third_end: 0,
};

/// The lane whose list is shorter while three lanes are merged in a known order, and the ticks that the list holds then.
pub(super) const SHORT_LANE: u8 = 2;
pub(super) const SHORT_LIST: u8 = (SHORT_RING_START - SHORT_LANE * 2 * LIST) / 2;

impl Merge {
    /// The merge.
    ///
    /// # Safety
    /// To be called once.
    pub(crate) unsafe fn take() -> &'static mut Merge {
        let merge = &raw mut MERGE;
        // SAFETY: the caller's promise: no other reference exists.
        unsafe { &mut *merge }
    }

    /// Where the list of `lane` ends: low byte of the address after it.
    fn end_of(&self, lane: u8) -> u8 {
        if lane == SHORT_LANE {
            return self.third_end;
        }
        (lane + 1).wrapping_mul(2 * LIST)
    }

    /// What `lane` has that is in no group yet: how many ticks, and what each of them toggles.
    pub(crate) fn listed(&self, lane: u8) -> (u8, Group) {
        let entry = &self.lanes[usize::from(lane) % LANES];
        let head = u8::from(self.empty_lane != lane);
        (self.end_of(lane).wrapping_sub(entry.next) / 2 + head, entry.masks)
    }

    /// Starts: every lane has a filler at `first` (the low 16 bits of a tick). `shield_b`: ring B of the shield is behind the lists. `plain`: pulses are
    /// of one tick.
    ///
    /// Groups will be at least `spacing` ticks apart (W).
    pub(crate) fn begin(&mut self, name: RingName, motors: u8, (shield_b, plain): (bool, bool), spacing: u8, first: u16) {
        let (end, tail) = match name {
            RingName::A => (END_A, register::OCR0A),
            RingName::B => (END_B, register::OCR0B),
        };
        self.spacing = spacing;
        self.motors = motors;
        let in_order = ThisProgram::THREE_LANES && motors < 4 && plain;
        self.third_end = if in_order { SHORT_RING_START } else { 2 * LIST * (SHORT_LANE + 1) };
        self.half = if shield_b { MAX_DELAY_SHIELD } else { spacing / 2 };
        self.end = end;
        self.tail = tail + 0x20;
        (self.at, self.pending) = (0, Group::NOTHING);
        self.list_low = 2 * if motors == 2 {
            LIST_LOW_OF_TWO
        } else if shield_b {
            LIST_LOW_OF_SHIELD
        } else {
            LIST_LOW_OF_MORE
        } + 1;
        self.clear(first);
    }

    /// Lists are not topped up any more: what they leave of their page is for other data. No motor waits for a switch then.
    pub(crate) fn share_page(&mut self) {
        self.list_low = 0;
    }

    /// Whether lists have nothing but fillers.
    pub(crate) fn is_idle(&self) -> bool {
        self.lanes.iter().all(|lane| lane.masks == Group::NOTHING)
    }

    /// Drops all lists but for a filler in each, at `first`.
    #[inline(never)]
    pub(crate) fn clear(&mut self, first: u16) {
        self.empty_lane = NONE;
        let mut next = 0u8;
        for lane in &mut self.lanes {
            next = next.wrapping_add(2 * LIST);
            *lane = Lane { masks: Group::NOTHING, head: first, next };
        }
        self.lanes[usize::from(SHORT_LANE)].next = self.third_end;
    }
}
