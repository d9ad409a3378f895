//! The nine instructions of the state machines (RP2040 datasheet §3.4), with side-set (§3.5.1), autopush and autopull
//! (§3.5.4), and pin mapping (§3.5.6).

use super::super::gpio::Inputs;
use super::machine::{
    Countdown, IN_RIGHT, INLINE_OUT_EN, Machine, NEVER, OUT_RIGHT, OUT_STICKY, SIDE_EN, SIDE_PINDIR, STATUS_SEL, Stall,
    count, ones, pin_mask,
};
use super::{Pio, RXSTALL, TXSTALL};

/// How an instruction ended.
#[derive(Clone, Copy, PartialEq, Eq)]
enum End {
    /// It is complete, and the program counter goes on.
    Done,
    /// It is complete, and the program counter goes to this address.
    Jump(u8),
    /// OUT EXEC or MOV EXEC: this instruction is executed next, and the delay is ignored.
    Exec(u16),
    /// The machine stalls, and tries again when the condition may have changed.
    Wait(Stall),
    /// The instruction is executed again at the next tick.
    Again,
    /// A countdown, `jmp x--` to its own address: all executions are done at once.
    Counted { executions: u64 },
}

impl Pio {
    /// Executes one instruction of a machine in `cycle`.
    pub(super) fn execute(&mut self, number: usize, cycle: u64, inputs: &Inputs) {
        let machine = &mut self.machines[number];
        let forced = machine.forced;
        if !forced {
            machine.enter_tick(cycle);
        }
        machine.countdown = None;
        if machine.refill_at == cycle {
            machine.refill_at = NEVER;
        }
        if machine.stall == Stall::Pin {
            machine.stall = Stall::No;
            self.note_waits();
        }
        let machine = &self.machines[number];
        let latched = machine.latched;
        let instruction = latched.unwrap_or(self.memory[usize::from(machine.pc)]);
        let side_bits = machine.side_bits();
        let field = u32::from(instruction) >> 8 & 31;
        let delay = u64::from(field & ones(5 - side_bits));
        let side = self.side(number, field >> (5 - side_bits));
        let end = self.operate(number, instruction, cycle, inputs);
        // Side-set comes after OUT and SET, because it wins where both write a pin.
        if let Some((mask, value)) = side {
            if self.machines[number].execctrl & SIDE_PINDIR != 0 {
                self.write_directions(mask, value);
            } else {
                self.write_levels(mask, value);
            }
        }
        let end = self.count_down(number, latched, end, delay, side.map_or(0, |(mask, _)| mask));
        let machine = &mut self.machines[number];
        if end != End::Again && machine.wants_refill() {
            self.refill(number, cycle);
        }
        // Side-set is asserted in every tick of a stall. This matters only where another machine writes the same pin.
        let polls =
            matches!(end, End::Wait(_)) && side.is_some_and(|(mask, _)| mask & self.driven_by_others(number) != 0);
        let machine = &mut self.machines[number];
        match end {
            End::Wait(stall) => {
                machine.stall = stall;
                // A pin change that is still in the synchroniser will not wake the machine: look again.
                let soon = stall == Stall::Pin && inputs.changed_since(cycle - Inputs::SYNCHRONISER.min(cycle));
                machine.at = match () {
                    () if !(polls || soon) => NEVER,
                    () if forced => cycle + 1,
                    () => machine.ticks_later(1),
                };
                match stall {
                    Stall::Tx => self.fdebug |= TXSTALL << number,
                    Stall::Rx => self.fdebug |= RXSTALL << number,
                    Stall::Pin => self.waits_for_pins = true,
                    _ => {}
                }
                return;
            }
            End::Again => {
                machine.stall = Stall::No;
                machine.at = if forced { cycle + 1 } else { machine.ticks_later(1) };
                return;
            }
            _ => {}
        }
        machine.stall = Stall::No;
        machine.latched = None;
        let ticks = match end {
            End::Exec(next) => {
                machine.latched = Some(next);
                1
            }
            End::Counted { executions } => executions * (1 + delay),
            _ => 1 + delay,
        };
        match end {
            End::Jump(target) => machine.pc = target,
            _ if latched.is_none() => {
                machine.pc =
                    if machine.pc == machine.wrap_top() { machine.wrap_bottom() } else { (machine.pc + 1) & 31 };
            }
            _ => {}
        }
        if !forced {
            machine.at = machine.ticks_later(ticks);
        } else if machine.latched.is_some() {
            machine.at = cycle + 1;
        } else {
            machine.forced = false;
            machine.at = NEVER;
            if machine.enabled {
                machine.enter_tick(cycle + 1);
                machine.at = machine.ticks_later(ticks - 1).max(machine.tick_from(machine.resume_at));
            }
        }
    }

    /// The pins that side-set writes, and their levels or directions (§3.5.1).
    fn side(&self, number: usize, bits: u32) -> Option<(u32, u32)> {
        let machine = &self.machines[number];
        let (base, pins) = machine.side_pins();
        if machine.side_bits() == 0 {
            return None;
        }
        if machine.execctrl & SIDE_EN != 0 && bits >> pins & 1 == 0 {
            return None;
        }
        Some((pin_mask((base, pins)), bits.rotate_left(base)))
    }

    /// Does all executions of a `jmp x--` to its own address at once. It must not where another machine writes a
    /// side-set pin, because side-set is asserted in each execution.
    fn count_down(&mut self, number: usize, latched: Option<u16>, end: End, delay: u64, side: u32) -> End {
        let instruction = self.memory[usize::from(self.machines[number].pc)];
        let End::Jump(target) = end else { return end };
        let condition = instruction >> 5 & 7;
        let itself = latched.is_none() && instruction >> 13 == 0 && target == self.machines[number].pc;
        if !itself || !matches!(condition, 2 | 4) || side & self.driven_by_others(number) != 0 {
            return end;
        }
        let machine = &mut self.machines[number];
        let start_256 = machine.enter_tick(machine.at);
        let register = if condition == 2 { &mut machine.x } else { &mut machine.y };
        // The register has already been decremented once.
        let from = register.wrapping_add(1);
        *register = u32::MAX;
        machine.countdown = Some(Countdown {
            y: condition == 4,
            from,
            start_256,
            period_256: (1 + delay) * machine.period_256(),
            pc: target,
        });
        End::Counted { executions: u64::from(from) + 1 }
    }

    fn operate(&mut self, number: usize, instruction: u16, cycle: u64, inputs: &Inputs) -> End {
        let argument = u32::from(instruction) & 31;
        let kind = instruction >> 5 & 7;
        match instruction >> 13 {
            0 => self.jmp(number, kind, argument as u8, cycle, inputs),
            1 => self.wait(number, instruction, argument, cycle, inputs),
            2 => self.r#in(number, kind, count(argument), cycle, inputs),
            3 => self.out(number, kind, count(argument), cycle),
            4 if instruction & 0x80 == 0 => self.push(number, kind, cycle),
            4 => self.pull(number, kind, cycle),
            5 => self.mov(number, kind, instruction, cycle, inputs),
            6 => self.irq(number, instruction, argument),
            _ => self.set(number, kind, argument),
        }
    }

    /// JMP (§3.4.2).
    fn jmp(&mut self, number: usize, condition: u16, target: u8, cycle: u64, inputs: &Inputs) -> End {
        let bypass = self.input_sync_bypass;
        let machine = &mut self.machines[number];
        let taken = match condition {
            0 => true,
            1 => machine.x == 0,
            2 => decrement(&mut machine.x),
            3 => machine.y == 0,
            4 => decrement(&mut machine.y),
            5 => machine.x != machine.y,
            6 => inputs.seen(cycle, bypass) >> machine.jmp_pin() & 1 != 0,
            _ => machine.osr_count < machine.pull_threshold(),
        };
        if taken { End::Jump(target) } else { End::Done }
    }

    /// WAIT (§3.4.3).
    fn wait(&mut self, number: usize, instruction: u16, index: u32, cycle: u64, inputs: &Inputs) -> End {
        let wanted = u32::from(instruction >> 7 & 1);
        let pins = || inputs.seen(cycle, self.input_sync_bypass);
        match instruction >> 5 & 3 {
            0 if pins() >> index & 1 == wanted => End::Done,
            1 if pins() >> ((index + self.machines[number].in_base()) & 31) & 1 == wanted => End::Done,
            2 => {
                let flag = irq_flag(number, index);
                if u32::from(self.irq & flag != 0) != wanted {
                    return End::Wait(Stall::Irq);
                }
                if wanted == 1 {
                    self.irq_clear |= flag;
                }
                End::Done
            }
            0 | 1 => End::Wait(Stall::Pin),
            // A reserved source: the condition is never met.
            _ => End::Wait(Stall::Irq),
        }
    }

    /// IN (§3.4.4), with autopush (§3.5.4.1).
    fn r#in(&mut self, number: usize, source: u16, bits: u8, cycle: u64, inputs: &Inputs) -> End {
        let bypass = self.input_sync_bypass;
        let machine = &mut self.machines[number];
        let value = match source {
            0 => inputs.seen(cycle, bypass).rotate_right(machine.in_base()),
            1 => machine.x,
            2 => machine.y,
            6 => machine.isr,
            7 => machine.osr,
            _ => 0,
        };
        let shifted = (machine.isr_count + bits).min(32);
        let full = machine.autopush() && shifted >= machine.push_threshold();
        if full && machine.rx.is_full() {
            return End::Wait(Stall::Rx);
        }
        let value = value & ones(bits.into());
        machine.isr = if bits == 32 {
            value
        } else if machine.shiftctrl & IN_RIGHT != 0 {
            machine.isr >> bits | value << (32 - bits)
        } else {
            machine.isr << bits | value
        };
        machine.isr_count = shifted;
        if full {
            self.push_isr(number, cycle);
        }
        End::Done
    }

    fn push_isr(&mut self, number: usize, cycle: u64) {
        let machine = &mut self.machines[number];
        machine.rx.push(machine.isr, cycle);
        (machine.isr, machine.isr_count) = (0, 0);
        self.effects.requests |= 1 << (number + 4);
    }

    /// OUT (§3.4.5), with autopull (§3.5.4.2): an empty OSR is filled in one tick and shifted in the next.
    fn out(&mut self, number: usize, destination: u16, bits: u8, cycle: u64) -> End {
        let machine = &mut self.machines[number];
        if machine.wants_refill() {
            let Some(word) = machine.tx.pop(cycle) else { return End::Wait(Stall::Tx) };
            (machine.osr, machine.osr_count) = (word, 0);
            self.effects.requests |= 1 << number;
            return End::Again;
        }
        let value = if bits == 32 {
            std::mem::take(&mut machine.osr)
        } else if machine.shiftctrl & OUT_RIGHT != 0 {
            let value = machine.osr & ones(bits.into());
            machine.osr >>= bits;
            value
        } else {
            let value = machine.osr >> (32 - bits);
            machine.osr <<= bits;
            value
        };
        machine.osr_count = (machine.osr_count + bits).min(32);
        match destination {
            0 => self.out_pins(number, value, false),
            1 => machine.x = value,
            2 => machine.y = value,
            4 => self.out_pins(number, value, true),
            5 => return End::Jump((value & 31) as u8),
            6 => (machine.isr, machine.isr_count) = (value, bits),
            7 => return End::Exec(value as u16),
            // NULL: discarded.
            _ => {}
        }
        End::Done
    }

    /// Writes pins or directions for OUT and MOV, with inline enable and OUT_STICKY (§3.5.6).
    fn out_pins(&mut self, number: usize, value: u32, directions: bool) {
        let machine = &self.machines[number];
        let (base, pins) = machine.out_pins();
        let enable = machine.execctrl >> 19 & 31;
        let enabled = machine.execctrl & INLINE_OUT_EN == 0 || value >> enable & 1 != 0;
        let mask = if enabled { pin_mask((base, pins)) } else { 0 };
        self.drive(number, mask, value.rotate_left(base), directions);
    }

    fn drive(&mut self, number: usize, mask: u32, value: u32, directions: bool) {
        let machine = &mut self.machines[number];
        if machine.execctrl & OUT_STICKY != 0 {
            machine.sticky[usize::from(directions)] = (mask, value);
        }
        if directions {
            self.write_directions(mask, value);
        } else {
            self.write_levels(mask, value);
        }
    }

    /// PUSH (§3.4.6).
    fn push(&mut self, number: usize, flags: u16, cycle: u64) -> End {
        let (if_full, block) = (flags & 2 != 0, flags & 1 != 0);
        let machine = &mut self.machines[number];
        if if_full && machine.isr_count < machine.push_threshold() {
            return End::Done;
        }
        if machine.rx.is_full() {
            if block {
                return End::Wait(Stall::Rx);
            }
            // The word is lost, and the ISR is cleared all the same.
            (machine.isr, machine.isr_count) = (0, 0);
            self.fdebug |= RXSTALL << number;
            return End::Done;
        }
        self.push_isr(number, cycle);
        End::Done
    }

    /// PULL (§3.4.7).
    fn pull(&mut self, number: usize, flags: u16, cycle: u64) -> End {
        let (if_empty, block) = (flags & 2 != 0, flags & 1 != 0);
        let machine = &mut self.machines[number];
        if if_empty && machine.osr_count < machine.pull_threshold() || machine.autopull() && machine.osr_count == 0 {
            return End::Done;
        }
        match machine.tx.pop(cycle) {
            Some(word) => {
                machine.osr = word;
                self.effects.requests |= 1 << number;
            }
            None if block => return End::Wait(Stall::Tx),
            None => machine.osr = machine.x,
        }
        self.machines[number].osr_count = 0;
        End::Done
    }

    /// MOV (§3.4.8).
    fn mov(&mut self, number: usize, destination: u16, instruction: u16, cycle: u64, inputs: &Inputs) -> End {
        let bypass = self.input_sync_bypass;
        let machine = &mut self.machines[number];
        let value = match instruction & 7 {
            0 => inputs.seen(cycle, bypass).rotate_right(machine.in_base()),
            1 => machine.x,
            2 => machine.y,
            5 => status(machine),
            6 => machine.isr,
            7 => machine.osr,
            _ => 0,
        };
        let value = match instruction >> 3 & 3 {
            1 => !value,
            2 => value.reverse_bits(),
            _ => value,
        };
        match destination {
            0 => self.out_pins(number, value, false),
            1 => machine.x = value,
            2 => machine.y = value,
            4 => return End::Exec(value as u16),
            5 => return End::Jump((value & 31) as u8),
            6 => (machine.isr, machine.isr_count) = (value, 0),
            7 => (machine.osr, machine.osr_count) = (value, 0),
            _ => {}
        }
        End::Done
    }

    /// IRQ (§3.4.9).
    fn irq(&mut self, number: usize, instruction: u16, index: u32) -> End {
        let flag = irq_flag(number, index);
        let (clear, wait) = (instruction & 0x40 != 0, instruction & 0x20 != 0);
        if clear {
            self.irq_clear |= flag;
            return End::Done;
        }
        let machine = &mut self.machines[number];
        if !machine.irq_raised {
            self.irq_set |= flag;
            machine.irq_raised = wait;
            return if wait { End::Wait(Stall::Irq) } else { End::Done };
        }
        if self.irq & flag != 0 {
            return End::Wait(Stall::Irq);
        }
        machine.irq_raised = false;
        End::Done
    }

    /// SET (§3.4.10).
    fn set(&mut self, number: usize, destination: u16, value: u32) -> End {
        let machine = &mut self.machines[number];
        let (base, pins) = machine.set_pins();
        match destination {
            0 | 4 => self.drive(number, pin_mask((base, pins)), value.rotate_left(base), destination == 4),
            1 => machine.x = value,
            2 => machine.y = value,
            _ => {}
        }
        End::Done
    }
}

/// Decrements X or Y for `jmp x--`, in any case. Returns whether it was not zero before.
fn decrement(register: &mut u32) -> bool {
    let taken = *register != 0;
    *register = register.wrapping_sub(1);
    taken
}

/// MOV from STATUS: all ones while the selected FIFO has less than STATUS_N words (§3.7, EXECCTRL).
fn status(machine: &Machine) -> u32 {
    let fifo = if machine.execctrl & STATUS_SEL == 0 { &machine.tx } else { &machine.rx };
    if u32::from(fifo.level()) < machine.execctrl & 15 { u32::MAX } else { 0 }
}

/// The IRQ flag that an index selects. With `rel`, its highest bit, the machine's number is added to its two lowest
/// bits.
fn irq_flag(number: usize, index: u32) -> u8 {
    let index = index as usize;
    1 << if index & 0x10 != 0 { index & 4 | (index + number) & 3 } else { index & 7 }
}
