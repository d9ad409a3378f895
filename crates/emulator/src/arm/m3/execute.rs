//! What each operation does, and its cycles (ARMv7-M ARM DDI 0403E, chapter A7; TRM DDI 0337, table of instructions).

use super::arithmetic::{divide, divide_cycles, long_cycles, multiply_long, reversed};
use super::memory::{Place, mask};
use super::operation::{Index, Operation};
use super::{CortexM3, NO_LOAD};
use crate::arm::bus::{Bus, Size};
use crate::arm::cpu::{LR, Mode, PC, SP};
use crate::arm::fault::FaultCause;

/// The register numbers of `mrs` and `msr` (§B5.1.1).
mod special {
    pub(super) const MSP: u8 = 8;
    pub(super) const PSP: u8 = 9;
    pub(super) const PRIMASK: u8 = 16;
    pub(super) const BASEPRI: u8 = 17;
    pub(super) const BASEPRI_MAX: u8 = 18;
    pub(super) const FAULTMASK: u8 = 19;
    pub(super) const CONTROL: u8 = 20;
}

/// The first half-word of an instruction of 32 bits, at least.
const WIDE: u16 = 0xe800;

/// ITAdvance (§A7.3.2).
fn advanced(it: u8) -> u8 {
    if it & 7 == 0 { 0 } else { it & 0xe0 | it << 1 & 0x1f }
}

impl CortexM3 {
    /// Executes the instruction at the program counter.
    #[inline(always)]
    pub(super) fn execute_next(&mut self, bus: &mut impl Bus) {
        let began = self.cycle;
        self.instructions += 1;
        self.variant.loaded = std::mem::replace(&mut self.variant.loads, NO_LOAD);
        let result = match self.fetch(bus) {
            Ok((op, next)) => self.execute_if(op, next, bus),
            Err(cause) => Err(cause),
        };
        if let Err(cause) = result {
            self.cycle = self.cycle.max(began + 1);
            self.take_fault(cause);
        }
    }

    /// Fetches and decodes an instruction. Returns it with the address of the next one.
    #[inline(always)]
    fn fetch(&mut self, bus: &mut impl Bus) -> Result<(Operation, u32), FaultCause> {
        let first = self.fetch_half(bus, self.pc)?;
        if first < WIDE {
            return Ok((self.variant.narrow[usize::from(first)], self.pc.wrapping_add(2)));
        }
        let second = self.fetch_half(bus, self.pc.wrapping_add(2))?;
        Ok((self.variant.decode(first, second), self.pc.wrapping_add(4)))
    }

    #[inline(always)]
    fn fetch_half(&mut self, bus: &mut impl Bus, address: u32) -> Result<u16, FaultCause> {
        match bus.fetch(address, self.cycle) {
            Ok(half) => {
                self.cycle += u64::from(bus.wait_cycles());
                Ok(half)
            }
            Err(fault) => Err(FaultCause::Fetch { address: fault.address }),
        }
    }

    /// Executes an operation, unless it is in an IT block and its condition is not met.
    #[inline(always)]
    fn execute_if(&mut self, op: Operation, next: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        let it = self.variant.it;
        if it == 0 {
            return self.execute(op, next, bus);
        }
        if self.passes(it >> 4) {
            self.execute(op, next, bus)?;
        } else {
            self.cycle += 1;
            self.pc = next;
        }
        self.variant.it = advanced(it);
        Ok(())
    }

    #[inline(always)]
    fn execute(&mut self, op: Operation, next: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        match op {
            Operation::Nop => {}
            Operation::Immediate { alu, flags, d, n, carry, value } => {
                let sets = self.sets(flags);
                let result = self.compute(alu, sets, self.value(n), value, carry.unwrap_or(self.c));
                self.set(d, result);
            }
            Operation::Register { alu, flags, d, n, m, shift, places } => {
                let sets = self.sets(flags);
                let (b, carry) = self.shifted(shift, self.value(m), places.into());
                let result = self.compute(alu, sets, self.value(n), b, carry);
                self.set(d, result);
            }
            Operation::ShiftBy { shift, flags, d, n, m } => {
                let sets = self.sets(flags);
                let result = self.shift_by(shift, sets, self.value(n), self.value(m));
                self.set(d, result);
            }
            Operation::MovAny { d, m } => return self.write_any(d, self.any(m), next),
            Operation::AddAny { d, m } => return self.write_any(d, self.any(d).wrapping_add(self.any(m)), next),
            Operation::Adr { d, offset } => self.set(d, self.aligned_pc().wrapping_add_signed(offset)),
            Operation::MovTop { d, value } => self.set(d, self.value(d) & 0xffff | u32::from(value) << 16),
            Operation::Saturate { signed, d, n, bits, shift, places } => {
                let (value, _) = self.shifted(shift, self.value(n), places.into());
                let result = self.saturate(signed, value, bits);
                self.set(d, result);
            }
            Operation::Extract { signed, d, n, low, width } => {
                let top = self.value(n) << (32 - low - width);
                let right = u32::from(32 - width);
                self.set(d, if signed { (top as i32 >> right) as u32 } else { top >> right });
            }
            Operation::Insert { d, n, low, width } => {
                let field = (u32::MAX >> (32 - width)) << low;
                let new = if usize::from(n) == PC { 0 } else { self.value(n) << low };
                self.set(d, self.value(d) & !field | new & field);
            }
            Operation::Extend { signed, size, d, m, rotation } => {
                let value = self.value(m).rotate_right(rotation.into());
                self.set(d, extended(value & mask(size), size, signed));
            }
            Operation::Reverse { kind, d, m } => self.set(d, reversed(kind, self.value(m))),
            Operation::Multiply { flags, d, n, m } => {
                let sets = self.sets(flags);
                let result = self.multiply(sets, self.value(n), self.value(m));
                self.set(d, result);
            }
            Operation::MultiplyAdd { subtract, d, n, m, a } => {
                let product = self.value(n).wrapping_mul(self.value(m));
                let a = self.value(a);
                self.set(d, if subtract { a.wrapping_sub(product) } else { a.wrapping_add(product) });
                self.cycle += 1;
            }
            Operation::MultiplyLong { signed, accumulate, low, high, n, m } => {
                let (a, b) = (self.value(n), self.value(m));
                let sum = u64::from(self.value(high)) << 32 | u64::from(self.value(low));
                let result = multiply_long(signed, a, b, if accumulate { sum } else { 0 });
                self.set(low, result as u32);
                self.set(high, (result >> 32) as u32);
                self.cycle += long_cycles(signed, accumulate, a, b) - 1;
            }
            Operation::Divide { signed, d, n, m } => {
                let (a, b) = (self.value(n), self.value(m));
                if b == 0 && self.variant.registers.traps_division() {
                    return Err(FaultCause::DivideByZero);
                }
                self.set(d, divide(signed, a, b));
                self.cycle += divide_cycles(signed, a, b) - 1;
            }
            Operation::Load { size, signed, t, n, index, offset } => {
                let base = self.value(n);
                let sum = base.wrapping_add_signed(offset.into());
                let address = if index == Index::After { base } else { sum };
                let value = self.load_one(bus, Place { address, registers: 1 << n }, size)?;
                if index != Index::Offset {
                    self.set(n, sum);
                }
                return self.loaded(t, extended(value, size, signed), next, bus);
            }
            Operation::LoadIndexed { size, signed, t, n, m, places } => {
                let address = self.value(n).wrapping_add(self.value(m) << places);
                let value = self.load_one(bus, Place { address, registers: 1 << n | 1 << m }, size)?;
                return self.loaded(t, extended(value, size, signed), next, bus);
            }
            Operation::LoadLiteral { size, signed, t, offset } => {
                let address = self.aligned_pc().wrapping_add_signed(offset.into());
                let value = self.load_one(bus, Place { address, registers: 0 }, size)?;
                return self.loaded(t, extended(value, size, signed), next, bus);
            }
            Operation::Store { size, t, n, index, offset } => {
                let base = self.value(n);
                let sum = base.wrapping_add_signed(offset.into());
                let address = if index == Index::After { base } else { sum };
                self.store_one(bus, address, size, self.value(t) & mask(size), false)?;
                if index != Index::Offset {
                    self.set(n, sum);
                }
                self.pc = next;
                return Ok(());
            }
            Operation::StoreIndexed { size, t, n, m, places } => {
                let address = self.value(n).wrapping_add(self.value(m) << places);
                self.store_one(bus, address, size, self.value(t) & mask(size), true)?;
                self.pc = next;
                return Ok(());
            }
            Operation::LoadDouble { t, t2, n, index, offset } => {
                let base = if usize::from(n) == PC { self.aligned_pc() } else { self.value(n) };
                let sum = base.wrapping_add_signed(offset.into());
                let address = if index == Index::After { base } else { sum };
                self.begin_many();
                let first = self.load_word(bus, address)?;
                let second = self.load_word(bus, address.wrapping_add(4))?;
                if index != Index::Offset {
                    self.set(n, sum);
                }
                self.set(t, first);
                self.set(t2, second);
                self.pc = next;
                return Ok(());
            }
            Operation::StoreDouble { t, t2, n, index, offset } => {
                let base = self.value(n);
                let sum = base.wrapping_add_signed(offset.into());
                let address = if index == Index::After { base } else { sum };
                self.begin_many();
                self.store_word(bus, address, self.value(t))?;
                self.store_word(bus, address.wrapping_add(4), self.value(t2))?;
                if index != Index::Offset {
                    self.set(n, sum);
                }
                self.pc = next;
                return Ok(());
            }
            Operation::LoadMultiple { n, list, before, write_back } => {
                return self.load_multiple(n, list, before, write_back, next, bus);
            }
            Operation::StoreMultiple { n, list, before, write_back } => {
                return self.store_multiple(n, list, before, write_back, next, bus);
            }
            Operation::LoadExclusive { size, t, n, offset } => {
                let address = self.value(n).wrapping_add_signed(offset.into());
                check_aligned(address, size)?;
                let value = self.load_one(bus, Place { address, registers: 1 << n }, size)?;
                self.variant.exclusive = Some(address);
                return self.loaded(t, value, next, bus);
            }
            Operation::StoreExclusive { size, d, t, n, offset } => {
                let address = self.value(n).wrapping_add_signed(offset.into());
                check_aligned(address, size)?;
                let is_mine = self.variant.exclusive.take() == Some(address);
                if is_mine {
                    self.begin_many();
                    self.store_data(bus, address, size, self.value(t) & mask(size))?;
                } else {
                    self.cycle += 2;
                }
                self.set(d, u32::from(!is_mine));
                self.pc = next;
                return Ok(());
            }
            Operation::ClearExclusive => self.variant.exclusive = None,
            Operation::TableBranch { n, m, half } => return self.table_branch(n, m, half, bus),
            Operation::Branch { offset } => return self.branch(offset),
            Operation::BranchIf { condition, offset } => {
                if self.passes(condition) {
                    return self.branch(offset);
                }
            }
            Operation::BranchLink { offset } => {
                self.registers[LR] = next | 1;
                return self.branch(offset);
            }
            Operation::BranchExchange { m } => {
                self.cycle += 1;
                return self.branch_exchange(self.any(m), bus);
            }
            Operation::BranchLinkExchange { m } => {
                let target = self.any(m);
                self.registers[LR] = next | 1;
                self.cycle += 1;
                self.branch_to_state(target);
                return Ok(());
            }
            Operation::CompareBranch { n, nonzero, offset } => {
                if (self.value(n) == 0) != nonzero {
                    return self.branch(offset.into());
                }
            }
            Operation::It { state } => self.variant.it = state,
            Operation::Barrier => self.cycle = self.cycle.max(self.variant.bus_free),
            Operation::InstructionBarrier => self.cycle += u64::from(self.variant.options.refill),
            Operation::ChangeMasks { set, primask, faultmask } => {
                self.change_masks(set, primask, faultmask);
                self.cycle += 1;
            }
            Operation::ReadSpecial { d, special } => {
                let value = self.read_special(special);
                self.set(d, value);
                self.cycle += 1;
            }
            Operation::WriteSpecial { n, special } => {
                self.write_special(special, self.value(n));
                self.cycle += 1;
            }
            Operation::SupervisorCall => self.supervisor_call()?,
            Operation::SendEvent => {
                self.exceptions.event = true;
                bus.send_event();
            }
            Operation::WaitForEvent => self.wait_for_event(),
            Operation::WaitForInterrupt => self.wait_for_interrupt(),
            Operation::Breakpoint => return Err(FaultCause::Breakpoint),
            Operation::Coprocessor => return Err(FaultCause::NoCoprocessor),
            Operation::Undefined => return Err(FaultCause::Undefined),
        }
        self.cycle += 1;
        self.pc = next;
        Ok(())
    }

    #[inline(always)]
    pub(super) fn in_it(&self) -> bool {
        self.variant.it != 0
    }

    /// Reads a register that is not the program counter.
    #[inline(always)]
    fn value(&self, number: u8) -> u32 {
        self.registers[usize::from(number & 15)]
    }

    /// Reads any register. The program counter reads two half-words ahead.
    #[inline(always)]
    fn any(&self, number: u8) -> u32 {
        if usize::from(number) == PC { self.pc.wrapping_add(4) } else { self.value(number) }
    }

    /// Sets a register. A destination of 15 is none: that element is not used.
    #[inline(always)]
    fn set(&mut self, number: u8, value: u32) {
        let number = usize::from(number & 15);
        self.registers[number] = if number == SP { value & !3 } else { value };
    }

    fn aligned_pc(&self) -> u32 {
        self.pc.wrapping_add(4) & !3
    }

    /// ConditionPassed (§A7.3.1).
    #[inline(always)]
    fn passes(&self, condition: u8) -> bool {
        let passes = match condition >> 1 {
            0 => self.z,
            1 => self.c,
            2 => self.n,
            3 => self.v,
            4 => self.c && !self.z,
            5 => self.n == self.v,
            6 => !self.z && self.n == self.v,
            _ => return true,
        };
        passes != (condition & 1 != 0)
    }

    /// Branches by an offset from the program counter.
    #[inline(always)]
    fn branch(&mut self, offset: i32) -> Result<(), FaultCause> {
        self.cycle += 1 + u64::from(self.variant.options.refill);
        self.pc = self.pc.wrapping_add(4).wrapping_add_signed(offset);
        Ok(())
    }

    /// BXWritePC (§A2.3.1). In a handler, the highest addresses are EXC_RETURN values and end it.
    fn branch_exchange(&mut self, target: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        if target >> 28 == 15 && self.mode() == Mode::Handler {
            return self.exception_return(target, bus);
        }
        self.branch_to_state(target);
        Ok(())
    }

    /// Branches to an address. Its lowest bit must be 1: it says that Thumb code is there.
    fn branch_to_state(&mut self, target: u32) {
        self.cycle += u64::from(self.variant.options.refill);
        self.pc = target & !1;
        if target & 1 == 0 {
            self.thumb = false;
            self.refresh();
        }
    }

    /// Writes the result of `add` or `mov` to any register. Writing the program counter is a branch.
    #[inline(always)]
    fn write_any(&mut self, d: u8, value: u32, next: u32) -> Result<(), FaultCause> {
        self.cycle += 1;
        if usize::from(d) == PC {
            self.cycle += u64::from(self.variant.options.refill);
            self.pc = value & !1;
        } else {
            self.set(d, value);
            self.pc = next;
        }
        Ok(())
    }

    /// The value of a single load goes to its register. Loading the program counter is a branch.
    #[inline(always)]
    fn loaded(&mut self, t: u8, value: u32, next: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        if usize::from(t) == PC {
            return self.branch_exchange(value, bus);
        }
        self.set(t, value);
        self.variant.loads = t;
        self.pc = next;
        Ok(())
    }

    /// 1 cycle and one for each register; a branch if the program counter is one of them.
    fn load_multiple(
        &mut self,
        n: u8,
        list: u16,
        before: bool,
        write_back: bool,
        next: u32,
        bus: &mut impl Bus,
    ) -> Result<(), FaultCause> {
        let bytes = 4 * list.count_ones();
        let base = self.value(n);
        let lowest = if before { base.wrapping_sub(bytes) } else { base };
        self.begin_many();
        let mut values = [0; 16];
        for (register, address) in members(list).zip((0..).map(|at: u32| lowest.wrapping_add(4 * at))) {
            values[register] = self.load_word(bus, address)?;
        }
        // The base register keeps its value until all loads have passed, so that the instruction can be executed again.
        if write_back {
            self.set(n, if before { lowest } else { base.wrapping_add(bytes) });
        }
        for register in members(list & 0x7fff) {
            self.set(register as u8, values[register]);
        }
        self.pc = next;
        if list >> PC != 0 {
            return self.branch_exchange(values[PC], bus);
        }
        Ok(())
    }

    /// 1 cycle and one for each register.
    fn store_multiple(
        &mut self,
        n: u8,
        list: u16,
        before: bool,
        write_back: bool,
        next: u32,
        bus: &mut impl Bus,
    ) -> Result<(), FaultCause> {
        let bytes = 4 * list.count_ones();
        let base = self.value(n);
        let lowest = if before { base.wrapping_sub(bytes) } else { base };
        self.begin_many();
        for (register, address) in members(list).zip((0..).map(|at: u32| lowest.wrapping_add(4 * at))) {
            self.store_word(bus, address, self.registers[register])?;
        }
        if write_back {
            self.set(n, if before { lowest } else { base.wrapping_add(bytes) });
        }
        self.pc = next;
        Ok(())
    }

    /// `tbb` and `tbh`: 2 cycles and a branch.
    fn table_branch(&mut self, n: u8, m: u8, half: bool, bus: &mut impl Bus) -> Result<(), FaultCause> {
        let (size, places) = if half { (Size::Half, 1) } else { (Size::Byte, 0) };
        let address = self.any(n).wrapping_add(self.value(m) << places);
        let entry = self.load_one(bus, Place { address, registers: 1 << n | 1 << m }, size)?;
        self.cycle += u64::from(self.variant.options.refill);
        self.pc = self.pc.wrapping_add(4).wrapping_add(2 * entry);
        Ok(())
    }

    /// Executes `cps`: without privileges it does nothing.
    fn change_masks(&mut self, set: bool, primask: bool, faultmask: bool) {
        if !self.is_privileged() {
            return;
        }
        if primask {
            self.exceptions.primask = set;
        }
        if faultmask {
            self.set_faultmask(set);
        }
        self.refresh();
    }

    /// FAULTMASK cannot be set in the handlers of HardFault and NMI (§B5.2.3).
    fn set_faultmask(&mut self, set: bool) {
        if !set || self.exceptions.execution_priority() > -1 {
            self.exceptions.faultmask = set;
        }
    }

    /// Executes `mrs` (§B5.2.2). Without privileges the stack pointers and masks read 0.
    fn read_special(&self, special: u8) -> u32 {
        let privileged = self.is_privileged();
        match special {
            // Bit 0 adds IPSR, bit 1 EPSR (which reads 0), and bit 2 leaves out APSR.
            0..=7 => {
                let ipsr = if special & 1 != 0 { self.exceptions.current() } else { 0 };
                let apsr = self.apsr() | u32::from(self.variant.q) << 27;
                ipsr | if special & 4 == 0 { apsr } else { 0 }
            }
            special::MSP if privileged => self.msp(),
            special::PSP if privileged => self.psp(),
            special::PRIMASK if privileged => self.exceptions.primask.into(),
            special::BASEPRI | special::BASEPRI_MAX if privileged => self.exceptions.basepri.into(),
            special::FAULTMASK if privileged => self.exceptions.faultmask.into(),
            special::CONTROL => u32::from(self.process_stack) << 1 | u32::from(self.unprivileged),
            _ => 0,
        }
    }

    /// Executes `msr` (§B5.2.3). Without privileges it can only write the flags.
    fn write_special(&mut self, special: u8, value: u32) {
        match special {
            0..=3 => {
                self.set_flags(value);
                self.variant.q = value >> 27 & 1 != 0;
            }
            _ if !self.is_privileged() => {}
            special::MSP if self.process_stack => self.other_sp = value & !3,
            special::MSP => self.registers[SP] = value & !3,
            special::PSP if self.process_stack => self.registers[SP] = value & !3,
            special::PSP => self.other_sp = value & !3,
            special::PRIMASK => self.exceptions.primask = value & 1 != 0,
            special::BASEPRI => self.exceptions.basepri = value as u8 & self.exceptions.priority_bits,
            special::BASEPRI_MAX => {
                let (new, old) = (value as u8 & self.exceptions.priority_bits, self.exceptions.basepri);
                if new != 0 && (new < old || old == 0) {
                    self.exceptions.basepri = new;
                }
            }
            special::FAULTMASK => self.set_faultmask(value & 1 != 0),
            special::CONTROL => {
                self.unprivileged = value & 1 != 0;
                if self.mode() == Mode::Thread {
                    self.use_process_stack(value & 2 != 0);
                }
            }
            _ => {}
        }
        self.refresh();
    }
}

/// A loaded value, or a part of a word, with its sign if it has one.
#[inline(always)]
fn extended(value: u32, size: Size, signed: bool) -> u32 {
    match size {
        Size::Byte if signed => i32::from(value as i8) as u32,
        Size::Half if signed => i32::from(value as i16) as u32,
        _ => value,
    }
}

/// Exclusive accesses must be aligned, whatever CCR says.
fn check_aligned(address: u32, size: Size) -> Result<(), FaultCause> {
    if address & (size.bytes() - 1) == 0 { Ok(()) } else { Err(FaultCause::Unaligned { address }) }
}

/// The registers of a list, lowest first.
fn members(mut list: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let register = list.trailing_zeros() as usize;
        list &= list.wrapping_sub(1);
        (register < 16).then_some(register)
    })
}
