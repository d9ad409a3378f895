//! The private registers that all processors have: SysTick, NVIC, system control (ARMv6-M ARM DDI 0419E §B3.2 to §B3.4;
//! ARMv7-M ARM DDI 0403E §B3.2 to §B3.4). This file is about addresses and bits; the state is in `nvic` and `systick`.

use super::bus::{Bus, Size};
use super::cpu::Core;
use super::fault::FaultCause;
use super::nvic::{IRQ, NMI, PENDSV, SVCALL, SYSTICK};
use super::variant::Variant;

/// Addresses of the registers.
mod at {
    pub(super) const SYST_CSR: u32 = 0xe000_e010;
    pub(super) const SYST_RVR: u32 = 0xe000_e014;
    pub(super) const SYST_CVR: u32 = 0xe000_e018;
    pub(super) const SYST_CALIB: u32 = 0xe000_e01c;
    pub(super) const NVIC_ISER: u32 = 0xe000_e100;
    pub(super) const NVIC_ISER_1: u32 = 0xe000_e104;
    pub(super) const NVIC_ICER: u32 = 0xe000_e180;
    pub(super) const NVIC_ICER_1: u32 = 0xe000_e184;
    pub(super) const NVIC_ISPR: u32 = 0xe000_e200;
    pub(super) const NVIC_ISPR_1: u32 = 0xe000_e204;
    pub(super) const NVIC_ICPR: u32 = 0xe000_e280;
    pub(super) const NVIC_ICPR_1: u32 = 0xe000_e284;
    pub(super) const NVIC_IPR0: u32 = 0xe000_e400;
    pub(super) const NVIC_IPR_LAST: u32 = 0xe000_e42c;
    pub(super) const CPUID: u32 = 0xe000_ed00;
    pub(super) const ICSR: u32 = 0xe000_ed04;
    pub(super) const VTOR: u32 = 0xe000_ed08;
    pub(super) const AIRCR: u32 = 0xe000_ed0c;
    pub(super) const SCR: u32 = 0xe000_ed10;
    pub(super) const CCR: u32 = 0xe000_ed14;
    pub(super) const SHPR2: u32 = 0xe000_ed1c;
    pub(super) const SHPR3: u32 = 0xe000_ed20;
    pub(super) const SHCSR: u32 = 0xe000_ed24;
}

/// ICSR.
mod icsr {
    pub(super) const NMI_SET: u32 = 1 << 31;
    pub(super) const PENDSV_SET: u32 = 1 << 28;
    pub(super) const PENDSV_CLEAR: u32 = 1 << 27;
    pub(super) const SYSTICK_SET: u32 = 1 << 26;
    pub(super) const SYSTICK_CLEAR: u32 = 1 << 25;
    pub(super) const INTERRUPT_PENDING: u32 = 1 << 22;
    pub(super) const PENDING_AT: u32 = 12;
}

/// AIRCR: what must be written to its upper half, and what is read there.
const KEY: u32 = 0x05fa;
const KEY_READ: u32 = 0xfa05;
const RESET_REQUEST: u32 = 1 << 2;

/// SCR.
const SLEEP_ON_EXIT: u32 = 1 << 1;
const SLEEP_DEEP: u32 = 1 << 2;
const EVENT_ON_PENDING: u32 = 1 << 4;

/// CCR: STKALIGN and UNALIGN_TRP, always.
const CCR: u32 = 1 << 9 | 1 << 3;
/// SHCSR.SVCALLPENDED.
const SVCALL_PENDED: u32 = 1 << 15;

impl<V: Variant> Core<V> {
    /// Reads a private register in the present cycle. An access that the processor does not allow faults.
    #[cold]
    pub(super) fn read_private(&mut self, address: u32, size: Size) -> Result<u32, FaultCause> {
        self.check_private(address, size)?;
        self.count_systick(self.cycle);
        let word = self.private_word(address & !3);
        Ok(match size {
            Size::Word => word,
            Size::Half => word >> (8 * (address & 2)) & 0xffff,
            Size::Byte => word >> (8 * (address & 3)) & 0xff,
        })
    }

    pub(super) fn private_word(&mut self, address: u32) -> u32 {
        if let Some(value) = V::read_own_register(self, address) {
            return value;
        }
        let exceptions = &self.exceptions;
        let interrupts = |set: u64| ((set & exceptions.interrupts) >> IRQ >> (8 * (address & 4))) as u32;
        match address {
            at::SYST_CSR => self.systick.read_control(),
            at::SYST_RVR => self.systick.reload(),
            at::SYST_CVR => self.systick.value(),
            at::SYST_CALIB => self.systick.calibration(),
            at::NVIC_ISER | at::NVIC_ISER_1 | at::NVIC_ICER | at::NVIC_ICER_1 => interrupts(exceptions.enabled),
            at::NVIC_ISPR | at::NVIC_ISPR_1 | at::NVIC_ICPR | at::NVIC_ICPR_1 => interrupts(exceptions.pending),
            at::NVIC_IPR0..=at::NVIC_IPR_LAST => self.priorities(IRQ + (address - at::NVIC_IPR0)),
            at::CPUID => self.config.cpuid,
            at::ICSR => self.interrupt_state(),
            at::VTOR => exceptions.vector_table,
            at::AIRCR => KEY_READ << 16,
            at::SCR => {
                let bit = |set, bit| if set { bit } else { 0 };
                bit(exceptions.sleep_on_exit, SLEEP_ON_EXIT)
                    | bit(exceptions.sleep_deep, SLEEP_DEEP)
                    | bit(exceptions.event_on_pending, EVENT_ON_PENDING)
            }
            at::CCR => CCR,
            // Its lower three bytes belong to exceptions that ARMv6-M does not have.
            at::SHPR2 => self.priorities(SVCALL) << 24,
            at::SHPR3 => self.priorities(PENDSV) << 16,
            at::SHCSR if exceptions.pending >> SVCALL & 1 != 0 => SVCALL_PENDED,
            _ => 0,
        }
    }

    /// Writes a private register in the present cycle.
    #[cold]
    pub(super) fn write_private(
        &mut self,
        bus: &mut impl Bus,
        address: u32,
        size: Size,
        value: u32,
    ) -> Result<(), FaultCause> {
        self.check_private(address, size)?;
        self.count_systick(self.cycle + 1);
        let value = if size == Size::Word { value } else { V::widened(self, address, size, value) };
        let address = address & !3;
        if V::write_own_register(self, bus, address, value) {
            self.refresh();
            return Ok(());
        }
        let interrupts = u64::from(value) << IRQ << (8 * (address & 4)) & self.exceptions.interrupts;
        match address {
            at::SYST_CSR => self.systick.write_control(value),
            at::SYST_RVR => self.systick.write_reload(value),
            at::SYST_CVR => self.systick.clear(),
            at::NVIC_ISER | at::NVIC_ISER_1 => self.exceptions.enabled |= interrupts,
            at::NVIC_ICER | at::NVIC_ICER_1 => self.exceptions.enabled &= !interrupts,
            at::NVIC_ISPR | at::NVIC_ISPR_1 => self.exceptions.pend(interrupts),
            at::NVIC_ICPR | at::NVIC_ICPR_1 => {
                self.exceptions.pending &= !interrupts;
                self.exceptions.sample_lines();
            }
            at::NVIC_IPR0..=at::NVIC_IPR_LAST => self.set_priorities(IRQ + (address - at::NVIC_IPR0), 4, value),
            at::ICSR => self.set_interrupt_state(value),
            at::VTOR => self.exceptions.vector_table = value & V::VECTOR_TABLE_BITS,
            at::AIRCR if value >> 16 == KEY && value & RESET_REQUEST != 0 => bus.request_reset(),
            at::SCR => {
                self.exceptions.sleep_on_exit = value & SLEEP_ON_EXIT != 0;
                self.exceptions.sleep_deep = value & SLEEP_DEEP != 0;
                self.exceptions.event_on_pending = value & EVENT_ON_PENDING != 0;
            }
            at::SHPR2 => self.set_priorities(SVCALL, 1, value >> 24),
            at::SHPR3 => self.set_priorities(PENDSV, 2, value >> 16),
            _ => {}
        }
        self.refresh();
        Ok(())
    }

    fn check_private(&self, address: u32, size: Size) -> Result<(), FaultCause> {
        if V::may_access(self, address, size) { Ok(()) } else { Err(FaultCause::Bus { address }) }
    }

    pub(super) fn interrupt_state(&self) -> u32 {
        let exceptions = &self.exceptions;
        let pending = |exception: u32, bit| if exceptions.pending >> exception & 1 != 0 { bit } else { 0 };
        let interrupt = if exceptions.pending >> IRQ != 0 { icsr::INTERRUPT_PENDING } else { 0 };
        pending(NMI, icsr::NMI_SET)
            | pending(PENDSV, icsr::PENDSV_SET)
            | pending(SYSTICK, icsr::SYSTICK_SET)
            | interrupt
            | exceptions.most_urgent_pending().unwrap_or(0) << icsr::PENDING_AT
            | exceptions.current()
    }

    fn set_interrupt_state(&mut self, value: u32) {
        let exceptions = &mut self.exceptions;
        let chosen = |bit: u32, exception: u32| if value & bit != 0 { 1 << exception } else { 0 };
        exceptions.pend(chosen(icsr::NMI_SET, NMI));
        exceptions.pending &= !(chosen(icsr::PENDSV_CLEAR, PENDSV) | chosen(icsr::SYSTICK_CLEAR, SYSTICK));
        exceptions.pend(chosen(icsr::PENDSV_SET, PENDSV) | chosen(icsr::SYSTICK_SET, SYSTICK));
    }

    /// The priorities of up to four exceptions from `first` on, one byte each.
    pub(super) fn priorities(&self, first: u32) -> u32 {
        let bits = self.exceptions.priority_bits;
        let bytes = (first..first + 4).enumerate().filter(|(_, exception)| self.has_priority(*exception));
        bytes.fold(0, |all, (at, exception)| {
            let priority = self.exceptions.priority[exception as usize] as u32;
            all | (priority & u32::from(bits)) << (8 * at)
        })
    }

    /// Sets the priorities of up to four exceptions. Only the implemented bits, at the top of a byte, are stored.
    pub(super) fn set_priorities(&mut self, first: u32, count: usize, value: u32) {
        let implemented = self.exceptions.priority_bits;
        for (exception, byte) in (first..).zip(value.to_le_bytes()).take(count) {
            if self.has_priority(exception) {
                self.exceptions.priority[exception as usize] = i16::from(byte & implemented);
            }
        }
    }

    /// Whether there is such an exception. The priorities of system exceptions are at addresses of their own.
    fn has_priority(&self, exception: u32) -> bool {
        exception < IRQ || self.exceptions.interrupts.checked_shr(exception).is_some_and(|above| above & 1 != 0)
    }
}
