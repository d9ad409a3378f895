//! Exceptions and interrupts: which are enabled, pending and active, and which one is due (ARMv6-M ARM DDI 0419E
//! §B1.5.4, §B3.4; ARMv7-M ARM DDI 0403E §B1.5.4, §B3.4).
//!
//! The NVIC's registers are in `system`; entry and return are in `exception`.

use super::fault::Fault;

pub(super) const NMI: u32 = 2;
pub(super) const HARD_FAULT: u32 = 3;
pub(super) const MEMORY_FAULT: u32 = 4;
pub(super) const BUS_FAULT: u32 = 5;
pub(super) const USAGE_FAULT: u32 = 6;
pub(super) const SVCALL: u32 = 11;
pub(super) const PENDSV: u32 = 14;
pub(super) const SYSTICK: u32 = 15;
/// Exception number of interrupt line 0.
pub(super) const IRQ: u32 = 16;
/// Exceptions that a set can have: interrupt lines 0 to 47.
const EXCEPTIONS: usize = u64::BITS as usize;

/// Execution priority when no exception is active: less urgent than every exception.
const LOWEST: i16 = i16::MAX;

/// Whether the processor sleeps, and what wakes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sleep {
    Awake,
    /// After `wfi`, or by sleep on exit.
    Interrupt,
    /// After `wfe`.
    Event,
}

/// A return from a handler: the value of EXC_RETURN, and the cycle in which the next instruction begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaving {
    pub(super) value: u32,
    pub(super) ends: u64,
}

/// The state of all exceptions. Sets of exceptions have one bit for each exception number.
#[derive(Clone, Debug)]
pub(super) struct Exceptions {
    pub(super) pending: u64,
    pub(super) active: u64,
    pub(super) enabled: u64,
    /// Levels of the interrupt lines.
    pub(super) lines: u64,
    pub(super) nmi_line: bool,
    /// Priority by exception number; a lower value is more urgent.
    pub(super) priority: [i16; EXCEPTIONS],
    pub(super) primask: bool,
    /// FAULTMASK, of ARMv7-M: keeps out all but the NMI.
    pub(super) faultmask: bool,
    /// BASEPRI, of ARMv7-M: keeps out what is not more urgent than this, unless it is 0.
    pub(super) basepri: u8,
    /// The implemented bits of a priority.
    pub(super) priority_bits: u8,
    /// The bits of a priority that decide about preemption (AIRCR.PRIGROUP of ARMv7-M).
    pub(super) group_bits: i16,
    /// The interrupts that there are, as exceptions.
    pub(super) interrupts: u64,
    /// The exception whose handler runs (IPSR); 0: none.
    pub(super) current: u32,
    /// The pending exception that is urgent enough to be entered now.
    pub(super) due: Option<u32>,
    /// Whether a pending exception ends `wfi`: as `due`, but whatever PRIMASK is.
    pub(super) wakes: bool,
    /// The exception for which the registers have been saved, and whose vector has not been read yet.
    pub(super) entering: Option<u32>,
    /// Whether that exception follows another's return without restoring the registers.
    pub(super) chained: bool,
    /// The return from a handler that is under way.
    pub(super) leaving: Option<Leaving>,
    /// The event register of `wfe`.
    pub(super) event: bool,
    pub(super) sleep: Sleep,
    pub(super) sleep_on_exit: bool,
    pub(super) sleep_deep: bool,
    pub(super) event_on_pending: bool,
    pub(super) locked_up: bool,
    pub(super) vector_table: u32,
    pub(super) fault: Option<Fault>,
}

pub(super) const fn bit(exception: u32) -> u64 {
    1 << exception
}

/// Exceptions that cannot be disabled.
const ALWAYS_ENABLED: u64 = bit(NMI) | bit(HARD_FAULT) | bit(SVCALL) | bit(PENDSV) | bit(SYSTICK);

impl Exceptions {
    pub(super) fn new(vector_table: u32, priority_bits: u8) -> Exceptions {
        let mut priority = [0; EXCEPTIONS];
        (priority[NMI as usize], priority[HARD_FAULT as usize]) = (-2, -1);
        Exceptions {
            pending: 0,
            active: 0,
            enabled: ALWAYS_ENABLED,
            lines: 0,
            nmi_line: false,
            priority,
            primask: false,
            faultmask: false,
            basepri: 0,
            priority_bits,
            group_bits: priority_bits.into(),
            interrupts: u64::from(u32::MAX) << IRQ,
            current: 0,
            due: None,
            wakes: false,
            entering: None,
            chained: false,
            leaving: None,
            event: false,
            sleep: Sleep::Awake,
            sleep_on_exit: false,
            sleep_deep: false,
            event_on_pending: false,
            locked_up: false,
            vector_table,
            fault: None,
        }
    }

    pub(super) fn reset(&mut self, vector_table: u32) {
        let Exceptions { lines, nmi_line, interrupts, priority_bits, .. } = *self;
        *self = Exceptions { lines, nmi_line, interrupts, ..Exceptions::new(vector_table, priority_bits) };
        self.sample_lines();
    }

    pub(super) fn current(&self) -> u32 {
        self.current
    }

    /// Makes exceptions pending.
    pub(super) fn pend(&mut self, exceptions: u64) {
        let new = exceptions & !self.pending;
        self.pending |= exceptions;
        if new != 0 && self.event_on_pending {
            self.event = true;
        }
    }

    /// Makes the interrupts whose line is high pending, except those whose handler runs (§B3.4.1).
    pub(super) fn sample_lines(&mut self) {
        self.pend(self.lines << IRQ & !self.active);
    }

    /// The most urgent exception of a set; of equals the one with the lowest number (§B1.5.4).
    fn most_urgent(&self, set: u64) -> Option<(u32, i16)> {
        members(set)
            .map(|exception| (exception, self.priority[exception as usize]))
            .min_by_key(|(_, priority)| *priority)
    }

    /// The most urgent exception that is pending and enabled.
    pub(super) fn most_urgent_pending(&self) -> Option<u32> {
        self.most_urgent(self.pending & self.enabled).map(|(exception, _)| exception)
    }

    /// The part of a priority that decides about preemption. The fixed priorities, which are negative, have no other.
    fn group(&self, priority: i16) -> i16 {
        if priority < 0 || priority == LOWEST { priority } else { priority & self.group_bits }
    }

    /// The part of an exception's priority that decides about preemption.
    pub(super) fn group_priority(&self, exception: u32) -> i16 {
        self.group(self.priority[exception as usize])
    }

    /// The priority of the running handler, without masks.
    pub(super) fn active_priority(&self) -> i16 {
        self.most_urgent(self.active).map_or(LOWEST, |(_, priority)| self.group(priority))
    }

    /// The priority of what runs, with BASEPRI and FAULTMASK, without PRIMASK.
    fn unmasked_priority(&self) -> i16 {
        let base = if self.basepri == 0 { LOWEST } else { self.group(self.basepri.into()) };
        self.active_priority().min(base).min(if self.faultmask { -1 } else { LOWEST })
    }

    pub(super) fn execution_priority(&self) -> i16 {
        self.unmasked_priority().min(if self.primask { 0 } else { LOWEST })
    }

    pub(super) fn refresh(&mut self) {
        let candidate = self.most_urgent(self.pending & self.enabled);
        let candidate = candidate.map(|(exception, priority)| (exception, self.group(priority)));
        let unmasked = self.unmasked_priority();
        self.wakes = candidate.is_some_and(|(_, priority)| priority < unmasked);
        let threshold = unmasked.min(if self.primask { 0 } else { LOWEST });
        self.due = candidate.filter(|(_, priority)| *priority < threshold).map(|(exception, _)| exception);
    }
}

/// The exceptions of a set, lowest number first.
fn members(mut set: u64) -> impl Iterator<Item = u32> {
    std::iter::from_fn(move || {
        let exception = set.trailing_zeros();
        set &= set.wrapping_sub(1);
        (exception < u64::BITS).then_some(exception)
    })
}
