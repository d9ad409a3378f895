//! The private registers that the Cortex-M0+ does not have, or has differently (ARMv7-M ARM DDI 0403E §B3.2, §B3.4,
//! §C1.8).
//!
//! Not emulated: the MPU (its registers read 0: there is none), the debug monitor, tracing but for the cycle counter, and
//! writing the active bits of SHCSR.

use super::{CortexM3, M3};
use crate::arm::bus::{Bus, Size};
use crate::arm::cpu::Core;
use crate::arm::fault::FaultCause;
use crate::arm::nvic::{BUS_FAULT, HARD_FAULT, IRQ, MEMORY_FAULT, PENDSV, SVCALL, SYSTICK, USAGE_FAULT, bit};
use crate::arm::variant::Variant;

/// Addresses of the registers.
mod at {
    pub(super) const DWT_CTRL: u32 = 0xe000_1000;
    pub(super) const DWT_CYCCNT: u32 = 0xe000_1004;
    pub(super) const ICTR: u32 = 0xe000_e004;
    pub(super) const NVIC_IABR: u32 = 0xe000_e300;
    pub(super) const NVIC_IABR_1: u32 = 0xe000_e304;
    pub(super) const NVIC_IPR0: u32 = 0xe000_e400;
    pub(super) const NVIC_IPR_END: u32 = 0xe000_e430;
    pub(super) const ICSR: u32 = 0xe000_ed04;
    pub(super) const AIRCR: u32 = 0xe000_ed0c;
    pub(super) const CCR: u32 = 0xe000_ed14;
    pub(super) const SHPR1: u32 = 0xe000_ed18;
    pub(super) const SHPR_END: u32 = 0xe000_ed24;
    pub(super) const SHCSR: u32 = 0xe000_ed24;
    pub(super) const CFSR: u32 = 0xe000_ed28;
    pub(super) const HFSR: u32 = 0xe000_ed2c;
    pub(super) const MMFAR: u32 = 0xe000_ed34;
    pub(super) const BFAR: u32 = 0xe000_ed38;
    pub(super) const DEMCR: u32 = 0xe000_edfc;
    pub(super) const STIR: u32 = 0xe000_ef00;
}

/// ICSR.RETTOBASE: no other handler is active.
const RETURNS_TO_BASE: u32 = 1 << 11;

/// CCR.
mod ccr {
    pub(super) const NON_BASE_THREAD: u32 = 1;
    pub(super) const USER_TRIGGER: u32 = 1 << 1;
    pub(super) const TRAP_UNALIGNED: u32 = 1 << 3;
    pub(super) const TRAP_DIVISION: u32 = 1 << 4;
    pub(super) const ALIGN_STACK: u32 = 1 << 9;
    /// BFHFNMIGN is stored alone.
    pub(super) const ALL: u32 = NON_BASE_THREAD | USER_TRIGGER | TRAP_UNALIGNED | TRAP_DIVISION | 1 << 8 | ALIGN_STACK;
}

/// CFSR.
mod cfsr {
    pub(super) const FETCH: u32 = 1 << 8;
    pub(super) const PRECISE: u32 = 1 << 9;
    pub(super) const STACKING: u32 = 1 << 12;
    pub(super) const ADDRESS_VALID: u32 = 1 << 15;
    pub(super) const UNDEFINED: u32 = 1 << 16;
    pub(super) const STATE: u32 = 1 << 17;
    pub(super) const RETURN: u32 = 1 << 18;
    pub(super) const COPROCESSOR: u32 = 1 << 19;
    pub(super) const UNALIGNED: u32 = 1 << 24;
    pub(super) const DIVISION: u32 = 1 << 25;
}

/// HFSR.
mod hfsr {
    pub(super) const VECTOR: u32 = 1 << 1;
    pub(super) const FORCED: u32 = 1 << 30;
    pub(super) const DEBUG: u32 = 1 << 31;
}

/// SHCSR: the bits of pending, active and enabled system exceptions.
const PENDED: [(u32, u32); 4] = [(USAGE_FAULT, 12), (MEMORY_FAULT, 13), (BUS_FAULT, 14), (SVCALL, 15)];
const ACTIVE: [(u32, u32); 6] =
    [(MEMORY_FAULT, 0), (BUS_FAULT, 1), (USAGE_FAULT, 3), (SVCALL, 7), (PENDSV, 10), (SYSTICK, 11)];
const ENABLED: [(u32, u32); 3] = [(MEMORY_FAULT, 16), (BUS_FAULT, 17), (USAGE_FAULT, 18)];

/// AIRCR: what must be written to its upper half, what is read there, and its other bits.
const KEY: u32 = 0x05fa;
const KEY_READ: u32 = 0xfa05;
const RESET_REQUEST: u32 = 1 << 2;

/// DEMCR.TRCENA; DWT_CTRL.CYCCNTENA, and its number of comparators.
const TRACE: u32 = 1 << 24;
const COUNTS: u32 = 1;
const COMPARATORS: u32 = 4 << 28;

#[derive(Clone, Debug)]
pub(super) struct Registers {
    ccr: u32,
    cfsr: u32,
    hfsr: u32,
    fault_address: u32,
    priority_group: u32,
    demcr: u32,
    counts: bool,
    /// The cycle counter's value in cycle `counted_from`.
    count: u32,
    counted_from: u64,
}

impl Registers {
    pub(super) fn new() -> Registers {
        Registers {
            ccr: ccr::ALIGN_STACK,
            cfsr: 0,
            hfsr: 0,
            fault_address: 0,
            priority_group: 0,
            demcr: 0,
            counts: false,
            count: 0,
            counted_from: 0,
        }
    }

    fn has(&self, bit: u32) -> bool {
        self.ccr & bit != 0
    }

    pub(super) fn aligns_stack(&self) -> bool {
        self.has(ccr::ALIGN_STACK)
    }

    pub(super) fn returns_early(&self) -> bool {
        self.has(ccr::NON_BASE_THREAD)
    }

    pub(super) fn traps_unaligned(&self) -> bool {
        self.has(ccr::TRAP_UNALIGNED)
    }

    pub(super) fn traps_division(&self) -> bool {
        self.has(ccr::TRAP_DIVISION)
    }

    /// Whether a program without privileges may trigger interrupts with STIR.
    pub(super) fn lets_program_trigger(&self, address: u32) -> bool {
        address == at::STIR && self.has(ccr::USER_TRIGGER)
    }

    /// Notes a fault's cause. Returns its exception.
    pub(super) fn note(&mut self, cause: FaultCause) -> u32 {
        let (bits, exception) = match cause {
            FaultCause::Undefined => (cfsr::UNDEFINED, USAGE_FAULT),
            FaultCause::NotThumb => (cfsr::STATE, USAGE_FAULT),
            FaultCause::Return { .. } => (cfsr::RETURN, USAGE_FAULT),
            FaultCause::NoCoprocessor => (cfsr::COPROCESSOR, USAGE_FAULT),
            FaultCause::Unaligned { .. } => (cfsr::UNALIGNED, USAGE_FAULT),
            FaultCause::DivideByZero => (cfsr::DIVISION, USAGE_FAULT),
            FaultCause::Fetch { .. } => (cfsr::FETCH, BUS_FAULT),
            FaultCause::Frame { .. } => (cfsr::STACKING, BUS_FAULT),
            FaultCause::Bus { address } => {
                self.fault_address = address;
                (cfsr::PRECISE | cfsr::ADDRESS_VALID, BUS_FAULT)
            }
            FaultCause::Vector { .. } => {
                self.hfsr |= hfsr::VECTOR;
                (0, HARD_FAULT)
            }
            FaultCause::Breakpoint => {
                self.hfsr |= hfsr::DEBUG;
                (0, HARD_FAULT)
            }
            FaultCause::Supervisor => {
                self.hfsr |= hfsr::FORCED;
                (0, HARD_FAULT)
            }
        };
        self.cfsr |= bits;
        exception
    }

    /// A fault's own exception cannot be entered, and it becomes a HardFault.
    pub(super) fn note_escalation(&mut self) {
        self.hfsr |= hfsr::FORCED;
    }

    fn counter(&self, cycle: u64) -> u32 {
        let passed = if self.counts && self.demcr & TRACE != 0 { cycle - self.counted_from } else { 0 };
        self.count.wrapping_add(passed as u32)
    }

    fn set_counter(&mut self, cycle: u64, count: u32) {
        (self.count, self.counted_from) = (count, cycle);
    }
}

/// Whether a private register can be accessed by bytes and half-words.
pub(super) fn allows_narrow(address: u32) -> bool {
    matches!(address, at::NVIC_IPR0..at::NVIC_IPR_END | at::SHPR1..at::SHPR_END | at::CFSR..at::HFSR)
}

/// The word that a narrow write makes of a register. Of CFSR, bits that are written 0 stay.
pub(super) fn widened(core: &mut Core<M3>, address: u32, size: Size, value: u32) -> u32 {
    let place = 8 * (address & 3);
    let mask = super::memory::mask(size) << place;
    let kept = if address & !3 == at::CFSR { 0 } else { core.private_word(address & !3) };
    kept & !mask | value << place & mask
}

impl CortexM3 {
    /// Sets which bits of a priority decide about preemption (AIRCR.PRIGROUP, §B1.5.4).
    pub(super) fn set_priority_group(&mut self, group: u32) {
        self.variant.registers.priority_group = group;
        self.exceptions.group_bits = i16::from(self.exceptions.priority_bits) & (0xfe << group) as i16 & 0xff;
    }

    fn gathered(&self, set: u64, places: &[(u32, u32)]) -> u32 {
        places.iter().filter(|(exception, _)| set & bit(*exception) != 0).map(|(_, place)| 1 << place).sum()
    }

    fn spread(set: u64, value: u32, places: &[(u32, u32)]) -> u64 {
        places.iter().fold(
            set,
            |set, (exception, place)| {
                if value >> place & 1 != 0 { set | bit(*exception) } else { set & !bit(*exception) }
            },
        )
    }

    pub(super) fn read_m3_register(&mut self, address: u32) -> Option<u32> {
        let (exceptions, registers) = (&self.exceptions, &self.variant.registers);
        Some(match address {
            at::DWT_CTRL => COMPARATORS | if registers.counts { COUNTS } else { 0 },
            at::DWT_CYCCNT => registers.counter(self.cycle),
            at::ICTR => self.variant.options.interrupts.saturating_sub(1) / 32,
            at::NVIC_IABR | at::NVIC_IABR_1 => {
                ((exceptions.active & exceptions.interrupts) >> IRQ >> (8 * (address & 4))) as u32
            }
            at::ICSR => {
                let others = exceptions.active & !bit(exceptions.current());
                self.interrupt_state() | if others == 0 { RETURNS_TO_BASE } else { 0 }
            }
            at::AIRCR => KEY_READ << 16 | registers.priority_group << 8,
            at::CCR => registers.ccr,
            at::SHPR1 => self.priorities(MEMORY_FAULT) & 0x00ff_ffff,
            at::SHCSR => {
                self.gathered(exceptions.pending, &PENDED)
                    | self.gathered(exceptions.active, &ACTIVE)
                    | self.gathered(exceptions.enabled, &ENABLED)
            }
            at::CFSR => registers.cfsr,
            at::HFSR => registers.hfsr,
            at::MMFAR | at::BFAR => registers.fault_address,
            at::DEMCR => registers.demcr,
            _ => return None,
        })
    }

    pub(super) fn write_m3_register(&mut self, bus: &mut impl Bus, address: u32, value: u32) -> bool {
        let now = self.cycle + 1;
        let registers = &mut self.variant.registers;
        match address {
            at::DWT_CTRL | at::DEMCR => {
                registers.set_counter(now, registers.counter(now));
                match address {
                    at::DEMCR => registers.demcr = value & TRACE,
                    _ => registers.counts = value & COUNTS != 0,
                }
            }
            at::DWT_CYCCNT => registers.set_counter(now, value),
            at::AIRCR => {
                if value >> 16 == KEY {
                    self.set_priority_group(value >> 8 & 7);
                    if value & RESET_REQUEST != 0 {
                        bus.request_reset();
                    }
                }
            }
            at::CCR => registers.ccr = value & ccr::ALL,
            at::SHPR1 => self.set_priorities(MEMORY_FAULT, 3, value),
            at::SHCSR => {
                self.exceptions.pending = Self::spread(self.exceptions.pending, value, &PENDED);
                self.exceptions.enabled = Self::spread(self.exceptions.enabled, value, &ENABLED);
            }
            at::CFSR => registers.cfsr &= !value,
            at::HFSR => registers.hfsr &= !value,
            at::MMFAR | at::BFAR => registers.fault_address = value,
            at::STIR => {
                let interrupt = 1u64.checked_shl(IRQ + (value & 0x1ff)).unwrap_or(0);
                self.exceptions.pend(interrupt & self.exceptions.interrupts);
            }
            _ => return false,
        }
        true
    }
}

const _: () = assert!(M3::PRIORITY_BITS == u8::MAX, "a chip has some of them");
