//! What a processor does at an exception: entry, return, faults, sleep (ARMv6-M ARM DDI 0419E §B1.5, whose sections are
//! named; ARMv7-M ARM DDI 0403E §B1.5 says the same where nothing else is said). Which exception is due is decided in
//! `nvic`.

use super::bus::{Bus, Size};
use super::cpu::{Core, LR, SP};
use super::fault::{Fault, FaultCause};
use super::nvic::{HARD_FAULT, IRQ, Leaving, NMI, SVCALL, SYSTICK, Sleep, bit};
use super::variant::Variant;

const FRAME_BYTES: u32 = 32;

impl<V: Variant> Core<V> {
    /// Sets the levels of the interrupt lines.
    #[inline]
    pub(super) fn set_lines(&mut self, levels: u64) {
        if levels != self.exceptions.lines {
            let rising = levels & !self.exceptions.lines;
            self.exceptions.lines = levels;
            self.exceptions.pend(rising << IRQ);
            self.refresh();
        }
    }

    /// Sets the level of the NMI line. A rising line makes the NMI pending.
    pub fn set_nmi_line(&mut self, level: bool) {
        if level && !self.exceptions.nmi_line {
            self.exceptions.pend(bit(NMI));
        }
        self.exceptions.nmi_line = level;
        self.refresh();
    }

    /// An event from outside (RXEV), such as `sev` of another processor. It ends `wfe`.
    pub fn event(&mut self) {
        self.exceptions.event = true;
        self.refresh();
    }

    /// Decides which exception is due, and up to which cycle instructions can be executed without another look.
    pub(super) fn refresh(&mut self) {
        let exceptions = &mut self.exceptions;
        exceptions.refresh();
        let now = exceptions.due.is_some()
            || exceptions.sleep != Sleep::Awake
            || exceptions.entering.is_some()
            || exceptions.leaving.is_some()
            || exceptions.locked_up
            || !self.thumb;
        self.attention = if now { 0 } else { self.systick.next().unwrap_or(u64::MAX) };
    }

    #[inline]
    pub(super) fn wakes(&self) -> bool {
        match self.exceptions.sleep {
            Sleep::Awake => true,
            Sleep::Interrupt => self.exceptions.wakes,
            Sleep::Event => self.exceptions.event || self.exceptions.due.is_some(),
        }
    }

    /// Counts SysTick up to a cycle, and makes its exception pending where the counter asks for it.
    pub(super) fn count_systick(&mut self, cycle: u64) {
        if self.systick.advance(cycle) {
            self.exceptions.pend(bit(SYSTICK));
        }
    }

    /// Makes the step that comes before the next instruction, if there is one: entry, sleep, lock-up. Returns whether
    /// there was.
    #[cold]
    #[inline(never)]
    pub(super) fn attend(&mut self, bus: &mut impl Bus) -> bool {
        self.count_systick(self.cycle);
        self.refresh();
        if self.exceptions.locked_up && self.exceptions.due.is_none() {
            self.cycle += 1;
            return true;
        }
        if self.exceptions.sleep != Sleep::Awake {
            if !self.wakes() {
                self.cycle += 1;
                return true;
            }
            if self.exceptions.sleep == Sleep::Event {
                self.exceptions.event = false;
            }
            self.exceptions.sleep = Sleep::Awake;
            self.refresh();
        }
        if let Some(leaving) = self.exceptions.leaving {
            self.leave(leaving, bus);
        } else if let Some(exception) = self.exceptions.entering.take() {
            // An exception that became due during stacking and is more urgent is entered instead (late arrival).
            self.take_vector(self.exceptions.due.unwrap_or(exception), bus);
        } else if let Some(exception) = self.exceptions.due {
            self.exceptions.locked_up = false;
            self.exceptions.chained = false;
            self.exceptions.entering = Some(exception);
            self.stack(bus);
        } else if !self.thumb {
            self.cycle += 1;
            self.take_fault(FaultCause::NotThumb);
        } else {
            return false;
        }
        true
    }

    /// Saves the registers on the stack (§B1.5.6, PushStack).
    fn stack(&mut self, bus: &mut impl Bus) {
        V::settle(self);
        let began = self.cycle;
        let sp = self.registers[SP];
        let padding = if V::aligns_stack(self) { sp >> 2 & 1 } else { 0 };
        let aligned = sp.wrapping_sub(FRAME_BYTES + 4 * padding);
        let xpsr = self.xpsr() | padding << 9;
        let [r0, r1, r2, r3, .., r12, _, lr, _] = self.registers;
        let frame = [r0, r1, r2, r3, r12, lr, self.pc, xpsr];
        self.registers[LR] = match (self.exceptions.current, self.process_stack) {
            (0, false) => 0xffff_fff9,
            (0, true) => 0xffff_fffd,
            _ => 0xffff_fff1,
        };
        self.registers[SP] = aligned;
        self.thumb = true;
        let mut waits = 0;
        self.cycle += 2;
        for (address, word) in (aligned..).step_by(4).zip(frame) {
            let before = self.cycle;
            if self.store_next(bus, address, Size::Word, word).is_err() {
                self.derived_fault(FaultCause::Frame { address });
                break;
            }
            waits += self.cycle - before - 1;
        }
        self.cycle = began + V::STACKING + waits;
        self.refresh();
    }

    /// Reads the vector and goes to the handler (§B1.5.6, ExceptionTaken).
    fn take_vector(&mut self, exception: u32, bus: &mut impl Bus) {
        let began = self.cycle;
        self.exceptions.pending &= !bit(exception);
        self.exceptions.active |= bit(exception);
        self.exceptions.current = exception;
        self.use_process_stack(false);
        self.exceptions.event = true;
        V::enter_handler(self);
        let chained = self.exceptions.chained;
        let cycles = if chained { V::TAIL_CHAIN } else { V::VECTOR };
        let address = self.exceptions.vector_table.wrapping_add(4 * exception);
        match bus.read_vector(address, began) {
            Ok(vector) => {
                self.pc = vector & !1;
                self.thumb = vector & 1 != 0;
                let waits = u64::from(bus.wait_cycles());
                let hidden = if V::READS_VECTOR_EARLY && !chained { V::STACKING } else { 0 };
                self.cycle = began + cycles + waits.saturating_sub(hidden);
                self.refresh();
            }
            Err(_) => {
                self.cycle = began + cycles;
                self.take_fault(FaultCause::Vector { address });
            }
        }
    }

    /// Ends a handler: `bx` or `pop` has loaded an EXC_RETURN value in handler mode (§B1.5.8).
    pub(super) fn exception_return(&mut self, value: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        let returning = self.exceptions.current;
        let nested = self.exceptions.active & !bit(returning) != 0;
        let valid = match value {
            0xffff_fff1 => nested,
            0xffff_fff9 | 0xffff_fffd => !nested || V::may_return_early(self),
            _ => false,
        };
        if !valid || self.exceptions.active & bit(returning) == 0 {
            return Err(FaultCause::Return { value });
        }
        self.exceptions.active &= !bit(returning);
        if returning != NMI {
            self.exceptions.faultmask = false;
        }
        self.exceptions.sample_lines();
        self.exceptions.event = true;
        self.count_systick(self.cycle);
        self.refresh();
        if let Some(exception) = self.exceptions.due {
            // Tail-chaining: the saved registers stay on the stack for the next handler.
            self.chain(exception, value);
        } else if let Some(cycles) = V::interruptible_return(self) {
            V::settle(self);
            self.exceptions.leaving = Some(Leaving { value, ends: self.cycle + cycles });
        } else {
            self.unstack(value, bus);
            self.end_return(value);
        }
        self.refresh();
        Ok(())
    }

    /// Enters an exception without restoring and saving the registers.
    fn chain(&mut self, exception: u32, value: u32) {
        self.registers[LR] = value;
        self.exceptions.chained = true;
        self.exceptions.entering = Some(exception);
    }

    fn end_return(&mut self, value: u32) {
        if value & 8 != 0 && self.exceptions.sleep_on_exit {
            self.exceptions.sleep = Sleep::Interrupt;
        }
    }

    /// Makes one cycle of restoring the registers. An exception that is due now ends that; the registers are still
    /// saved, and its handler begins as by tail-chaining (ARMv7-M ARM §B1.5.12, exceptions on exception exit).
    fn leave(&mut self, leaving: Leaving, bus: &mut impl Bus) {
        if let Some(exception) = self.exceptions.due {
            self.exceptions.leaving = None;
            self.chain(exception, leaving.value);
            self.cycle += 1;
        } else if self.cycle + 1 < leaving.ends {
            self.cycle += 1;
        } else {
            self.exceptions.leaving = None;
            self.unstack(leaving.value, bus);
            self.cycle = self.cycle.max(leaving.ends);
            self.end_return(leaving.value);
        }
        self.refresh();
    }

    /// Restores the registers from the stack (§B1.5.8, PopStack).
    fn unstack(&mut self, value: u32, bus: &mut impl Bus) {
        let began = self.cycle;
        let mut waits = 0;
        self.use_process_stack(value == 0xffff_fffd);
        let sp = self.registers[SP];
        let mut frame = [0; 8];
        self.cycle += 1;
        for (address, word) in (sp..).step_by(4).zip(&mut frame) {
            let before = self.cycle;
            match self.load_next(bus, address, Size::Word) {
                Ok(value) => *word = value,
                Err(_) => {
                    self.cycle = began + V::UNSTACKING;
                    self.take_fault(FaultCause::Frame { address });
                    return;
                }
            }
            waits += self.cycle - before - 1;
        }
        let [r0, r1, r2, r3, r12, lr, pc, xpsr] = frame;
        self.registers[..4].copy_from_slice(&[r0, r1, r2, r3]);
        (self.registers[12], self.registers[LR]) = (r12, lr);
        self.pc = pc & !1;
        self.registers[SP] = sp.wrapping_add(FRAME_BYTES) | (xpsr >> 9 & 1) << 2;
        self.set_flags(xpsr);
        V::set_more_xpsr(self, xpsr);
        self.thumb = xpsr >> 24 & 1 != 0;
        self.exceptions.current = if value & 8 != 0 { 0 } else { xpsr & V::EXCEPTION_BITS };
        self.cycle = began + V::UNSTACKING + waits;
    }

    /// Executes `svc`: makes SVCall pending, or faults where it cannot be entered (§B1.5.4).
    pub(super) fn supervisor_call(&mut self) -> Result<(), FaultCause> {
        if self.exceptions.group_priority(SVCALL) >= self.exceptions.execution_priority() {
            return Err(FaultCause::Supervisor);
        }
        self.exceptions.pend(bit(SVCALL));
        self.refresh();
        Ok(())
    }

    /// Executes `wfi`.
    pub(super) fn wait_for_interrupt(&mut self) {
        self.exceptions.sleep = Sleep::Interrupt;
        self.refresh();
    }

    /// Executes `wfe`. It does not wait if an event has come since the last `wfe`.
    pub(super) fn wait_for_event(&mut self) {
        if !std::mem::take(&mut self.exceptions.event) {
            self.exceptions.sleep = Sleep::Event;
            self.refresh();
        }
    }

    /// An instruction at `pc` faults. A fault whose own exception is disabled or cannot be entered now becomes a
    /// HardFault; the processor locks up if not even that can be entered (§B1.5.9, §B1.5.10).
    #[cold]
    pub(super) fn take_fault(&mut self, cause: FaultCause) {
        if self.exceptions.execution_priority() < 0 {
            self.lock_up(cause);
            return;
        }
        self.remember(cause);
        self.pend_fault(cause);
        self.refresh();
    }

    fn pend_fault(&mut self, cause: FaultCause) {
        let exception = V::fault_exception(self, cause);
        self.exceptions.pend(bit(exception));
    }

    /// A fault while the registers are being saved: it is entered instead of the first exception if it is more urgent
    /// (§B1.5.9).
    fn derived_fault(&mut self, cause: FaultCause) {
        if self.exceptions.due.is_some_and(|exception| exception <= HARD_FAULT)
            || self.exceptions.execution_priority() < 0
        {
            self.exceptions.entering = None;
            self.lock_up(cause);
            return;
        }
        self.remember(cause);
        self.pend_fault(cause);
    }

    pub(super) fn lock_up(&mut self, cause: FaultCause) {
        self.remember(cause);
        self.exceptions.locked_up = true;
        self.refresh();
    }

    fn remember(&mut self, cause: FaultCause) {
        self.exceptions.fault = Some(Fault { cause, pc: self.pc, cycle: self.cycle });
    }
}
