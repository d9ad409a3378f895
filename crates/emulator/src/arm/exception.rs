//! What the processor does at an exception: entry, return, faults, sleep (ARMv6-M ARM DDI 0419E §B1.5). Which exception
//! is due is decided in `nvic`.

use super::bus::{Bus, Size};
use super::cpu::{Cpu, LR, SP};
use super::fault::{Fault, FaultCause};
use super::nvic::{HARD_FAULT, IRQ, NMI, SVCALL, SYSTICK, Sleep, bit};

/// Cycles of the two parts of an exception's entry: saving the registers, and reading the vector. TRM §3.6.1 gives
/// their sum, 15.
const STACKING: u64 = 12;
const VECTOR: u64 = 3;
const _: () = assert!(STACKING + VECTOR == 15);
/// Cycles of restoring the registers: as `pop` with eight registers, 3 + 8 (TRM table 3-1).
const UNSTACKING: u64 = 11;
const FRAME_BYTES: u32 = 32;

impl Cpu {
    /// Sets the levels of the 32 interrupt lines. A rising line makes its interrupt pending. A line that is still high
    /// when its handler returns makes it pending again (ARMv6-M ARM §B3.4.1).
    #[inline]
    pub fn set_irq_lines(&mut self, levels: u32) {
        if levels != self.exceptions.lines {
            let rising = levels & !self.exceptions.lines;
            self.exceptions.lines = levels;
            self.exceptions.pend(u64::from(rising) << IRQ);
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
        if let Some(exception) = self.exceptions.entering.take() {
            // An exception that became due during stacking and is more urgent is entered instead (late arrival).
            self.take_vector(self.exceptions.due.unwrap_or(exception), bus);
        } else if let Some(exception) = self.exceptions.due {
            self.exceptions.locked_up = false;
            self.exceptions.entering = Some(exception);
            self.stack(bus);
        } else if !self.thumb {
            self.cycle += 1;
            self.hard_fault(FaultCause::NotThumb);
        } else {
            return false;
        }
        true
    }

    /// Saves the registers on the stack (§B1.5.6, PushStack).
    fn stack(&mut self, bus: &mut impl Bus) {
        let began = self.cycle;
        let sp = self.registers[SP];
        let aligned = sp.wrapping_sub(FRAME_BYTES) & !4;
        let padding = sp >> 2 & 1;
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
        self.cycle = began + STACKING + waits;
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
        let address = self.exceptions.vector_table.wrapping_add(4 * exception);
        match bus.read(address, Size::Word, began) {
            Ok(vector) => {
                self.pc = vector & !1;
                self.thumb = vector & 1 != 0;
                self.cycle = began + VECTOR + u64::from(bus.wait_cycles());
                self.refresh();
            }
            Err(_) => {
                self.cycle = began + VECTOR;
                self.hard_fault(FaultCause::Vector { address });
            }
        }
    }

    /// Ends a handler: `bx` or `pop` has loaded an EXC_RETURN value in handler mode (§B1.5.8).
    pub(super) fn exception_return(&mut self, value: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        let returning = self.exceptions.current;
        let nested = self.exceptions.active & !bit(returning) != 0;
        let valid = match value {
            0xffff_fff1 => nested,
            0xffff_fff9 | 0xffff_fffd => !nested,
            _ => false,
        };
        if !valid || self.exceptions.active & bit(returning) == 0 {
            return Err(FaultCause::Return { value });
        }
        self.exceptions.active &= !bit(returning);
        self.exceptions.sample_lines();
        self.exceptions.event = true;
        self.count_systick(self.cycle);
        self.refresh();
        if let Some(exception) = self.exceptions.due {
            // Tail-chaining: the saved registers stay on the stack for the next handler.
            self.registers[LR] = value;
            self.exceptions.entering = Some(exception);
        } else {
            self.unstack(value, bus);
            if value & 8 != 0 && self.exceptions.sleep_on_exit {
                self.exceptions.sleep = Sleep::Interrupt;
            }
        }
        self.refresh();
        Ok(())
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
                    self.cycle = began + UNSTACKING;
                    self.hard_fault(FaultCause::Frame { address });
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
        self.thumb = xpsr >> 24 & 1 != 0;
        self.exceptions.current = if value & 8 != 0 { 0 } else { xpsr & 0x3f };
        self.cycle = began + UNSTACKING + waits;
    }

    /// Executes `svc`: makes SVCall pending, or faults where it cannot be entered (§B1.5.4).
    pub(super) fn supervisor_call(&mut self) -> Result<(), FaultCause> {
        if self.exceptions.priority[SVCALL as usize] >= self.exceptions.execution_priority() {
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

    /// An instruction at `pc` faults: the processor takes a HardFault, or locks up if it is already in one (§B1.5.9,
    /// §B1.5.10).
    #[cold]
    pub(super) fn hard_fault(&mut self, cause: FaultCause) {
        if self.exceptions.active_priority() < 0 {
            self.lock_up(cause);
            return;
        }
        self.remember(cause);
        self.exceptions.pend(bit(HARD_FAULT));
        self.refresh();
    }

    /// A fault while the registers are being saved: its HardFault is entered instead of the first exception (§B1.5.9).
    fn derived_fault(&mut self, cause: FaultCause) {
        if self.exceptions.due.is_some_and(|exception| exception <= HARD_FAULT) || self.exceptions.active_priority() < 0
        {
            self.exceptions.entering = None;
            self.lock_up(cause);
            return;
        }
        self.remember(cause);
        self.exceptions.pend(bit(HARD_FAULT));
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
