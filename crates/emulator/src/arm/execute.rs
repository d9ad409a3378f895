//! What each instruction does, and its cycles (ARMv6-M ARM DDI 0419E, chapter A6; TRM DDI 0484C table 3-1).

use super::bus::{Bus, Size};
use super::cpu::{Cpu, LR, Mode, PC, SP};
use super::decode::{Op, WideOp, decode_wide};
use super::fault::FaultCause;

/// Additional cycles of a branch that is taken (TRM table 3-1: 2 in all).
const BRANCH: u64 = 1;
/// Cycles of a long instruction: BL, MRS, MSR, barriers (TRM table 3-1).
const WIDE: u64 = 3;

/// The register numbers of `mrs` and `msr` (ARMv6-M ARM §B5.1.1).
mod special {
    pub(super) const MSP: u8 = 8;
    pub(super) const PSP: u8 = 9;
    pub(super) const PRIMASK: u8 = 16;
    pub(super) const CONTROL: u8 = 20;
}

impl Cpu {
    #[inline(always)]
    pub(super) fn execute(&mut self, op: Op, bus: &mut impl Bus) -> Result<(), FaultCause> {
        let next = self.pc.wrapping_add(2);
        match op {
            Op::Nop => {}
            Op::LslImmediate { d, m, shift } => {
                let value = self.low(m);
                if shift != 0 {
                    self.c = value >> (32 - shift) & 1 != 0;
                }
                self.set_nz(d, value << shift);
            }
            Op::LsrImmediate { d, m, shift } => {
                let value = self.shift_right(self.low(m), shift.into());
                self.set_nz(d, value);
            }
            Op::AsrImmediate { d, m, shift } => {
                let value = self.shift_right_signed(self.low(m), shift.into());
                self.set_nz(d, value);
            }
            Op::Add { d, n, m } => {
                let sum = self.add(self.low(n), self.low(m), false);
                self.set(d, sum);
            }
            Op::Sub { d, n, m } => {
                let difference = self.add(self.low(n), !self.low(m), true);
                self.set(d, difference);
            }
            Op::AddImmediate { d, n, value } => {
                let sum = self.add(self.low(n), value.into(), false);
                self.set(d, sum);
            }
            Op::SubImmediate { d, n, value } => {
                let difference = self.add(self.low(n), !u32::from(value), true);
                self.set(d, difference);
            }
            Op::MovImmediate { d, value } => self.set_nz(d, value.into()),
            Op::CmpImmediate { n, value } => {
                self.add(self.low(n), !u32::from(value), true);
            }
            Op::And { d, m } => self.set_nz(d, self.low(d) & self.low(m)),
            Op::Eor { d, m } => self.set_nz(d, self.low(d) ^ self.low(m)),
            Op::Orr { d, m } => self.set_nz(d, self.low(d) | self.low(m)),
            Op::Bic { d, m } => self.set_nz(d, self.low(d) & !self.low(m)),
            Op::Mvn { d, m } => self.set_nz(d, !self.low(m)),
            Op::Mul { d, m } => self.set_nz(d, self.low(d).wrapping_mul(self.low(m))),
            Op::Tst { n, m } => self.flags_nz(self.low(n) & self.low(m)),
            Op::Lsl { d, m } => {
                let value = self.shift_left(self.low(d), self.low(m) & 0xff);
                self.set_nz(d, value);
            }
            Op::Lsr { d, m } => {
                let value = self.shift_right(self.low(d), self.low(m) & 0xff);
                self.set_nz(d, value);
            }
            Op::Asr { d, m } => {
                let value = self.shift_right_signed(self.low(d), self.low(m) & 0xff);
                self.set_nz(d, value);
            }
            Op::Ror { d, m } => {
                let value = self.rotate_right(self.low(d), self.low(m) & 0xff);
                self.set_nz(d, value);
            }
            Op::Adc { d, m } => {
                let sum = self.add(self.low(d), self.low(m), self.c);
                self.set(d, sum);
            }
            Op::Sbc { d, m } => {
                let difference = self.add(self.low(d), !self.low(m), self.c);
                self.set(d, difference);
            }
            Op::Rsb { d, m } => {
                let difference = self.add(!self.low(m), 0, true);
                self.set(d, difference);
            }
            Op::Cmp { n, m } => {
                self.add(self.any(n), !self.any(m), true);
            }
            Op::Cmn { n, m } => {
                self.add(self.low(n), self.low(m), false);
            }
            Op::AddAny { d, m } => return self.write_any(d, self.any(d).wrapping_add(self.any(m)), next),
            Op::MovAny { d, m } => return self.write_any(d, self.any(m), next),
            Op::Bx { m } => {
                self.cycle += 1 + BRANCH;
                return self.branch_exchange(self.any(m), bus);
            }
            Op::Blx { m } => {
                let target = self.any(m);
                self.cycle += 1 + BRANCH;
                self.registers[LR] = next | 1;
                self.branch_to_state(target);
                return Ok(());
            }
            Op::LdrLiteral { t, offset } => {
                let address = self.aligned_pc().wrapping_add(u32::from(offset) * 4);
                return self.load_to(t, address, Size::Word, bus, next);
            }
            Op::Str { t, n, m } => return self.store_from(t, self.indexed(n, m), Size::Word, bus, next),
            Op::Strh { t, n, m } => return self.store_from(t, self.indexed(n, m), Size::Half, bus, next),
            Op::Strb { t, n, m } => return self.store_from(t, self.indexed(n, m), Size::Byte, bus, next),
            Op::Ldr { t, n, m } => return self.load_to(t, self.indexed(n, m), Size::Word, bus, next),
            Op::Ldrh { t, n, m } => return self.load_to(t, self.indexed(n, m), Size::Half, bus, next),
            Op::Ldrb { t, n, m } => return self.load_to(t, self.indexed(n, m), Size::Byte, bus, next),
            Op::Ldrsh { t, n, m } => {
                let value = self.load(bus, self.indexed(n, m), Size::Half)?;
                self.set(t, value as i16 as u32);
                self.pc = next;
                return Ok(());
            }
            Op::Ldrsb { t, n, m } => {
                let value = self.load(bus, self.indexed(n, m), Size::Byte)?;
                self.set(t, value as i8 as u32);
                self.pc = next;
                return Ok(());
            }
            Op::StrImmediate { t, n, offset } => return self.store_from(t, self.at(n, offset), Size::Word, bus, next),
            Op::LdrImmediate { t, n, offset } => return self.load_to(t, self.at(n, offset), Size::Word, bus, next),
            Op::StrhImmediate { t, n, offset } => return self.store_from(t, self.at(n, offset), Size::Half, bus, next),
            Op::LdrhImmediate { t, n, offset } => return self.load_to(t, self.at(n, offset), Size::Half, bus, next),
            Op::StrbImmediate { t, n, offset } => return self.store_from(t, self.at(n, offset), Size::Byte, bus, next),
            Op::LdrbImmediate { t, n, offset } => return self.load_to(t, self.at(n, offset), Size::Byte, bus, next),
            Op::StrSp { t, offset } => return self.store_from(t, self.sp_plus(offset), Size::Word, bus, next),
            Op::LdrSp { t, offset } => return self.load_to(t, self.sp_plus(offset), Size::Word, bus, next),
            Op::Adr { d, offset } => self.set(d, self.aligned_pc().wrapping_add(u32::from(offset) * 4)),
            Op::AddFromSp { d, offset } => self.set(d, self.sp_plus(offset)),
            Op::AddSp { words } => self.registers[SP] = self.sp_plus(words),
            Op::SubSp { words } => self.registers[SP] = self.registers[SP].wrapping_sub(u32::from(words) * 4),
            Op::Sxth { d, m } => self.set(d, self.low(m) as i16 as u32),
            Op::Sxtb { d, m } => self.set(d, self.low(m) as i8 as u32),
            Op::Uxth { d, m } => self.set(d, self.low(m) & 0xffff),
            Op::Uxtb { d, m } => self.set(d, self.low(m) & 0xff),
            Op::Rev { d, m } => self.set(d, self.low(m).swap_bytes()),
            Op::Rev16 { d, m } => self.set(d, self.low(m).swap_bytes().rotate_left(16)),
            Op::Revsh { d, m } => self.set(d, (self.low(m) as u16).swap_bytes() as i16 as u32),
            Op::Push { list, lr } => return self.push(list, lr, bus, next),
            Op::Pop { list, pc } => return self.pop(list, pc, bus, next),
            Op::Stm { n, list } => return self.store_multiple(n, list, bus, next),
            Op::Ldm { n, list } => return self.load_multiple(n, list, bus, next),
            Op::Cps { disable } => {
                if self.is_privileged() {
                    self.exceptions.primask = disable;
                    self.refresh();
                }
            }
            Op::Sev => {
                self.exceptions.event = true;
                bus.send_event();
            }
            Op::Wfe => {
                self.cycle += 1;
                self.wait_for_event();
            }
            Op::Wfi => {
                self.cycle += 1;
                self.wait_for_interrupt();
            }
            Op::BranchIf { condition, offset } => {
                if self.passes(condition) {
                    self.cycle += 1 + BRANCH;
                    self.pc = self.pc.wrapping_add(4).wrapping_add_signed(i32::from(offset) * 2);
                    return Ok(());
                }
            }
            Op::Branch { offset } => {
                self.cycle += 1 + BRANCH;
                self.pc = self.pc.wrapping_add(4).wrapping_add_signed(i32::from(offset) * 2);
                return Ok(());
            }
            Op::Svc => self.supervisor_call()?,
            Op::Bkpt => return Err(FaultCause::Breakpoint),
            Op::Undefined => return Err(FaultCause::Undefined),
            Op::Wide { first } => return self.execute_wide(first, bus),
        }
        self.cycle += 1;
        self.pc = next;
        Ok(())
    }

    fn execute_wide(&mut self, first: u16, bus: &mut impl Bus) -> Result<(), FaultCause> {
        let next = self.pc.wrapping_add(4);
        let second = bus.fetch(self.pc.wrapping_add(2), self.cycle + 1);
        let second = second.map_err(|fault| FaultCause::Fetch { address: fault.address })?;
        self.cycle += u64::from(bus.wait_cycles());
        match decode_wide(first, second) {
            WideOp::Bl { offset } => {
                self.cycle += WIDE;
                self.registers[LR] = next | 1;
                self.pc = next.wrapping_add_signed(offset);
                return Ok(());
            }
            WideOp::Mrs { d, special } => {
                let value = self.read_special(special);
                match usize::from(d) {
                    // UNPREDICTABLE (A6.7.42); here it faults.
                    PC => return Err(FaultCause::Undefined),
                    SP => self.registers[SP] = value & !3,
                    d => self.registers[d] = value,
                }
            }
            WideOp::Msr { n, special } => self.write_special(special, self.any(n)),
            WideOp::Barrier => {}
            WideOp::Undefined => return Err(FaultCause::Undefined),
        }
        self.cycle += WIDE;
        self.pc = next;
        Ok(())
    }

    #[inline(always)]
    fn low(&self, number: u8) -> u32 {
        self.registers[usize::from(number & 15)]
    }

    /// Reads any register. The program counter reads two half-words ahead.
    #[inline(always)]
    fn any(&self, number: u8) -> u32 {
        if usize::from(number) == PC { self.pc.wrapping_add(4) } else { self.low(number) }
    }

    #[inline(always)]
    fn set(&mut self, number: u8, value: u32) {
        self.registers[usize::from(number & 15)] = value;
    }

    #[inline(always)]
    fn set_nz(&mut self, number: u8, value: u32) {
        self.flags_nz(value);
        self.set(number, value);
    }

    #[inline(always)]
    fn flags_nz(&mut self, value: u32) {
        self.n = value >> 31 != 0;
        self.z = value == 0;
    }

    /// AddWithCarry (A2.2.1): adds and sets all flags.
    #[inline(always)]
    fn add(&mut self, a: u32, b: u32, carry: bool) -> u32 {
        let (sum, over) = a.carrying_add(b, carry);
        self.flags_nz(sum);
        self.c = over;
        self.v = ((a ^ sum) & (b ^ sum)) >> 31 != 0;
        sum
    }

    /// Shifts by 0 to 255 places, as the functions below do.
    #[inline]
    fn shift_left(&mut self, value: u32, places: u32) -> u32 {
        if places != 0 {
            let wide = u64::from(value).checked_shl(places).unwrap_or(0);
            self.c = wide >> 32 & 1 != 0;
        }
        value.checked_shl(places).unwrap_or(0)
    }

    #[inline]
    fn shift_right(&mut self, value: u32, places: u32) -> u32 {
        if places != 0 {
            self.c = value.checked_shr(places - 1).unwrap_or(0) & 1 != 0;
        }
        value.checked_shr(places).unwrap_or(0)
    }

    #[inline]
    fn shift_right_signed(&mut self, value: u32, places: u32) -> u32 {
        if places != 0 {
            self.c = (value as i32) >> (places - 1).min(31) & 1 != 0;
        }
        ((value as i32) >> places.min(31)) as u32
    }

    #[inline]
    fn rotate_right(&mut self, value: u32, places: u32) -> u32 {
        let rotated = value.rotate_right(places & 31);
        if places != 0 {
            self.c = rotated >> 31 != 0;
        }
        rotated
    }

    #[inline]
    fn passes(&self, condition: u8) -> bool {
        let passes = match condition >> 1 {
            0 => self.z,
            1 => self.c,
            2 => self.n,
            3 => self.v,
            4 => self.c && !self.z,
            5 => self.n == self.v,
            _ => !self.z && self.n == self.v,
        };
        passes != (condition & 1 != 0)
    }

    fn aligned_pc(&self) -> u32 {
        self.pc.wrapping_add(4) & !3
    }

    #[inline(always)]
    fn indexed(&self, n: u8, m: u8) -> u32 {
        self.low(n).wrapping_add(self.low(m))
    }

    #[inline(always)]
    fn at(&self, n: u8, offset: u8) -> u32 {
        self.low(n).wrapping_add(offset.into())
    }

    #[inline(always)]
    fn sp_plus(&self, words: u8) -> u32 {
        self.registers[SP].wrapping_add(u32::from(words) * 4)
    }

    /// Writes the result of `add` or `mov` to any register, without flags. Writing the program counter is a branch.
    #[inline]
    fn write_any(&mut self, d: u8, value: u32, next: u32) -> Result<(), FaultCause> {
        self.cycle += 1;
        self.pc = next;
        match usize::from(d) {
            PC => {
                self.cycle += BRANCH;
                self.pc = value & !1;
            }
            SP => self.registers[SP] = value & !3,
            _ => self.set(d, value),
        }
        Ok(())
    }

    /// BXWritePC (A2.3.1). In a handler, the highest addresses are EXC_RETURN values and end it.
    #[inline]
    fn branch_exchange(&mut self, target: u32, bus: &mut impl Bus) -> Result<(), FaultCause> {
        if target >> 28 == 15 && self.mode() == Mode::Handler {
            return self.exception_return(target, bus);
        }
        self.branch_to_state(target);
        Ok(())
    }

    /// Branches to an address. Its lowest bit must be 1: it says that Thumb code is there.
    #[inline]
    fn branch_to_state(&mut self, target: u32) {
        self.pc = target & !1;
        if target & 1 == 0 {
            self.thumb = false;
            self.refresh();
        }
    }

    #[inline(always)]
    fn load_to(&mut self, t: u8, address: u32, size: Size, bus: &mut impl Bus, next: u32) -> Result<(), FaultCause> {
        let value = self.load(bus, address, size)?;
        self.set(t, value);
        self.pc = next;
        Ok(())
    }

    #[inline(always)]
    fn store_from(&mut self, t: u8, address: u32, size: Size, bus: &mut impl Bus, next: u32) -> Result<(), FaultCause> {
        let mask = match size {
            Size::Byte => 0xff,
            Size::Half => 0xffff,
            Size::Word => u32::MAX,
        };
        self.store(bus, address, size, self.low(t) & mask)?;
        self.pc = next;
        Ok(())
    }

    fn push(&mut self, list: u8, lr: bool, bus: &mut impl Bus, next: u32) -> Result<(), FaultCause> {
        let count = list.count_ones() + u32::from(lr);
        let lowest = self.registers[SP].wrapping_sub(4 * count);
        let mut address = lowest;
        self.cycle += 1;
        for register in members(list).chain(lr.then_some(LR)) {
            self.store_next(bus, address, Size::Word, self.registers[register])?;
            address = address.wrapping_add(4);
        }
        self.registers[SP] = lowest;
        self.pc = next;
        Ok(())
    }

    fn pop(&mut self, list: u8, pc: bool, bus: &mut impl Bus, next: u32) -> Result<(), FaultCause> {
        let mut address = self.registers[SP];
        self.cycle += 1;
        for register in members(list) {
            self.registers[register] = self.load_next(bus, address, Size::Word)?;
            address = address.wrapping_add(4);
        }
        if !pc {
            self.registers[SP] = address;
            self.pc = next;
            return Ok(());
        }
        let target = self.load_next(bus, address, Size::Word)?;
        self.registers[SP] = address.wrapping_add(4);
        // Table 3-1: 3 + N cycles.
        self.cycle += 2;
        self.branch_exchange(target, bus)
    }

    fn store_multiple(&mut self, n: u8, list: u8, bus: &mut impl Bus, next: u32) -> Result<(), FaultCause> {
        let mut address = self.low(n);
        self.cycle += 1;
        for register in members(list) {
            self.store_next(bus, address, Size::Word, self.registers[register])?;
            address = address.wrapping_add(4);
        }
        self.set(n, address);
        self.pc = next;
        Ok(())
    }

    fn load_multiple(&mut self, n: u8, list: u8, bus: &mut impl Bus, next: u32) -> Result<(), FaultCause> {
        let base = self.low(n);
        let mut address = base;
        self.cycle += 1;
        for register in members(list) {
            match self.load_next(bus, address, Size::Word) {
                Ok(value) => self.registers[register] = value,
                Err(cause) => {
                    // The base register keeps its value, so that the instruction can be executed again after the fault.
                    self.set(n, base);
                    return Err(cause);
                }
            }
            address = address.wrapping_add(4);
        }
        if list >> n & 1 == 0 {
            self.set(n, address);
        }
        self.pc = next;
        Ok(())
    }

    /// Executes `mrs` (§B5.2.2). Without privileges the stack pointers and masks read 0.
    fn read_special(&self, special: u8) -> u32 {
        let privileged = self.is_privileged();
        match special {
            // Bit 0 adds IPSR, bit 1 EPSR (which reads 0), and bit 2 leaves out APSR.
            0..=7 => {
                let ipsr = if special & 1 != 0 { self.exceptions.current() } else { 0 };
                ipsr | if special & 4 == 0 { self.apsr() } else { 0 }
            }
            special::MSP if privileged => self.msp(),
            special::PSP if privileged => self.psp(),
            special::PRIMASK if privileged => self.exceptions.primask.into(),
            special::CONTROL => u32::from(self.process_stack) << 1 | u32::from(self.unprivileged),
            _ => 0,
        }
    }

    /// Executes `msr` (§B5.2.3). Without privileges it can only write the flags.
    fn write_special(&mut self, special: u8, value: u32) {
        match special {
            0..=3 => self.set_flags(value),
            _ if !self.is_privileged() => {}
            special::MSP if self.process_stack => self.other_sp = value & !3,
            special::MSP => self.registers[SP] = value & !3,
            special::PSP if self.process_stack => self.registers[SP] = value & !3,
            special::PSP => self.other_sp = value & !3,
            special::PRIMASK => {
                self.exceptions.primask = value & 1 != 0;
                self.refresh();
            }
            special::CONTROL => {
                self.unprivileged = value & 1 != 0;
                if self.mode() == Mode::Thread {
                    self.use_process_stack(value & 2 != 0);
                }
            }
            _ => {}
        }
    }
}

/// The registers of a list, lowest first.
fn members(list: u8) -> impl Iterator<Item = usize> {
    (0..8).filter(move |register| list >> register & 1 != 0)
}
