//! A PIO block (RP2040 datasheet §3): four state machines (`machine`), their FIFOs (`fifo`), the instructions
//! (`execute`), and here the block's registers and interrupts.
//!
//! What a machine does in cycle t has its effect in t + 1: pins, IRQ flags and FIFOs are read as they were at the
//! beginning of the cycle. If several machines write one pin in one cycle, the highest number wins; within one machine,
//! side-set wins (§3.5.6).

mod execute;
mod fifo;
mod machine;

use super::gpio::Inputs;
use machine::{Machine, NEVER, OUT_STICKY, Stall};

// FDEBUG (§3.7).
const RXSTALL: u32 = 1;
const RXUNDER: u32 = 1 << 8;
const TXOVER: u32 = 1 << 16;
const TXSTALL: u32 = 1 << 24;

/// The effects of one cycle of a block on other blocks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Effects {
    /// Whether levels or directions may have changed.
    pub(super) pins: bool,
    /// New DREQs (§3.7, table of DREQs): bits 0 to 3 for TX FIFOs with room, 4 to 7 for RX FIFOs with words.
    pub(super) requests: u8,
}

#[derive(Clone)]
pub(super) struct Pio {
    machines: [Machine; 4],
    memory: [u16; 32],
    /// The eight IRQ flags, and those that the present cycle sets and clears.
    irq: u8,
    irq_set: u8,
    irq_clear: u8,
    input_sync_bypass: u32,
    fdebug: u32,
    inte: [u32; 2],
    intf: [u32; 2],
    /// Levels and directions of the block's outputs.
    levels: u32,
    directions: u32,
    effects: Effects,
    any_sticky: bool,
    /// Whether any machine waits for a pin.
    waits_for_pins: bool,
    /// The cycle of the next event.
    pub(super) next: u64,
}

impl Pio {
    pub(super) fn new() -> Pio {
        Pio {
            machines: std::array::from_fn(|_| Machine::new()),
            memory: [0; 32],
            irq: 0,
            irq_set: 0,
            irq_clear: 0,
            input_sync_bypass: 0,
            fdebug: 0,
            inte: [0; 2],
            intf: [0; 2],
            levels: 0,
            directions: 0,
            effects: Effects::default(),
            any_sticky: false,
            waits_for_pins: false,
            next: NEVER,
        }
    }

    pub(super) fn levels(&self) -> u32 {
        self.levels
    }

    pub(super) fn directions(&self) -> u32 {
        self.directions
    }

    /// Handles the events that are due in a cycle.
    pub(super) fn run(&mut self, cycle: u64, inputs: &Inputs) -> Effects {
        self.effects = Effects::default();
        let mut executed = false;
        for number in 0..4 {
            let machine = &mut self.machines[number];
            if machine.at == cycle {
                executed = true;
                self.execute(number, cycle, inputs);
            } else if machine.refill_at == cycle {
                self.refill(number, cycle);
            }
            if self.any_sticky {
                self.reassert(number);
            }
        }
        if executed {
            self.end_cycle(cycle);
        }
        self.schedule();
        self.effects
    }

    /// Applies what the machines did to the IRQ flags.
    fn end_cycle(&mut self, cycle: u64) {
        let before = self.irq;
        self.irq = before & !self.irq_clear | self.irq_set;
        (self.irq_set, self.irq_clear) = (0, 0);
        if self.irq != before {
            self.wake(Stall::Irq, cycle + 1);
        }
    }

    fn wake(&mut self, stall: Stall, from: u64) {
        for machine in &mut self.machines {
            if machine.stall == stall {
                wake(machine, from);
            }
        }
    }

    fn schedule(&mut self) {
        self.next = self.machines.iter().fold(NEVER, |next, machine| next.min(machine.at).min(machine.refill_at));
    }

    /// OUT_STICKY: the last OUT or SET of a machine is asserted again in every cycle (§3.5.6.2).
    fn reassert(&mut self, number: usize) {
        let machine = &self.machines[number];
        if machine.enabled && machine.execctrl & OUT_STICKY != 0 {
            let [(level_mask, levels), (direction_mask, directions)] = machine.sticky;
            self.write_levels(level_mask, levels);
            self.write_directions(direction_mask, directions);
        }
    }

    fn write_levels(&mut self, mask: u32, levels: u32) {
        let new = self.levels & !mask | levels & mask;
        self.effects.pins |= new != self.levels;
        self.levels = new;
    }

    fn write_directions(&mut self, mask: u32, directions: u32) {
        let new = self.directions & !mask | directions & mask;
        self.effects.pins |= new != self.directions;
        self.directions = new;
    }

    /// Autopull between two OUT instructions (§3.5.4.2).
    fn refill(&mut self, number: usize, cycle: u64) {
        let machine = &mut self.machines[number];
        machine.refill_at = NEVER;
        if machine.wants_refill()
            && let Some(word) = machine.tx.pop(cycle)
        {
            (machine.osr, machine.osr_count) = (word, 0);
            self.effects.requests |= 1 << number;
        }
    }

    /// Wakes machines that wait for pins. `cycle` is the first in which they see the change, through the synchroniser
    /// or past it.
    pub(super) fn pins_changed(&mut self, changed: u32, cycle: u64) {
        if self.waits_for_pins {
            let from = if changed & self.input_sync_bypass != 0 { cycle } else { cycle + Inputs::SYNCHRONISER };
            self.wake(Stall::Pin, from);
            self.schedule();
        }
    }

    // The FIFOs as the bus sees them. Cycles are those of the data phase; effects are there in the next cycle.

    fn write_tx(&mut self, number: usize, word: u32, cycle: u64) {
        let machine = &mut self.machines[number];
        if !machine.tx.push(word, cycle) {
            self.fdebug |= TXOVER << number;
            return;
        }
        if machine.stall == Stall::Tx {
            wake(machine, cycle + 1);
        } else if machine.enabled && machine.wants_refill() {
            machine.refill_at = machine.refill_at.min(machine.tick_from(cycle + 1));
        }
        self.schedule();
    }

    /// Whether the register is an RX FIFO, and if so, whether a word is in it.
    pub(super) fn has_word(&self, offset: u32) -> Option<bool> {
        (0x20..=0x2c).contains(&offset).then(|| !self.machines[(offset as usize - 0x20) / 4].rx.is_empty())
    }

    /// An empty RX FIFO was read: sets RXUNDER.
    pub(super) fn underflow(&mut self, offset: u32) {
        self.fdebug |= RXUNDER << ((offset - 0x20) / 4);
    }

    fn read_rx(&mut self, number: usize, cycle: u64) -> u32 {
        let machine = &mut self.machines[number];
        let Some(word) = machine.rx.pop(cycle) else {
            self.underflow(0x20 + 4 * number as u32);
            return 0;
        };
        if machine.stall == Stall::Rx {
            wake(machine, cycle + 1);
        }
        self.schedule();
        word
    }

    /// How many transfers the DMA may have under way, by DREQ number within the block: in `cycle`, and as soon as it
    /// knows of the latest changes.
    pub(super) fn credit(&self, request: usize, cycle: u64) -> (u8, u8) {
        let machine = &self.machines[request & 3];
        let fifo = if request < 4 { &machine.tx } else { &machine.rx };
        if request < 4 { fifo.room_for_dma(cycle) } else { fifo.words_for_dma(cycle) }
    }

    // Interrupts (§3.7, INTR).

    fn intr(&self) -> u32 {
        let mut bits = u32::from(self.irq & 0xf) << 8;
        for (number, machine) in self.machines.iter().enumerate() {
            bits |= u32::from(!machine.rx.is_empty()) << number;
            bits |= u32::from(!machine.tx.is_full()) << (number + 4);
        }
        bits
    }

    fn ints(&self, line: usize) -> u32 {
        self.intr() & self.inte[line] | self.intf[line]
    }

    /// Whether any interrupt is enabled or forced.
    pub(super) fn interrupts(&self) -> bool {
        self.inte[0] | self.inte[1] | self.intf[0] | self.intf[1] != 0
    }

    /// The levels of both interrupt lines, bits 0 and 1.
    pub(super) fn lines(&self) -> u32 {
        if !self.interrupts() {
            return 0;
        }
        u32::from(self.ints(0) != 0) | u32::from(self.ints(1) != 0) << 1
    }

    // Registers (§3.7).

    pub(super) fn read(&mut self, offset: u32, cycle: u64) -> u32 {
        match offset {
            0x000 => self.enables(),
            0x004 => self.fstat(),
            0x008 => self.fdebug,
            0x00c => self.machines.iter().rev().fold(0, |levels, machine| {
                levels << 8 | u32::from(machine.rx.level()) << 4 | u32::from(machine.tx.level())
            }),
            0x020..=0x02c => self.read_rx((offset as usize - 0x20) / 4, cycle),
            0x030 => u32::from(self.irq),
            0x038 => self.input_sync_bypass,
            0x03c => self.levels,
            0x040 => self.directions,
            // DBG_CFGINFO: 32 instructions, 4 machines, FIFOs of 4 words.
            0x044 => 32 << 16 | 4 << 8 | 4,
            0x0c8..=0x124 => self.read_machine((offset - 0xc8) as usize / 0x18, (offset - 0xc8) % 0x18, cycle),
            0x128 => self.intr(),
            0x12c | 0x138 => self.inte[usize::from(offset == 0x138)],
            0x130 | 0x13c => self.intf[usize::from(offset == 0x13c)],
            0x134 | 0x140 => self.ints(usize::from(offset == 0x140)),
            // TXF, IRQ_FORCE and the instruction memory cannot be read.
            _ => 0,
        }
    }

    fn enables(&self) -> u32 {
        self.machines.iter().rev().fold(0, |bits, machine| bits << 1 | u32::from(machine.enabled))
    }

    fn fstat(&self) -> u32 {
        let mut bits = 0;
        for (number, machine) in self.machines.iter().enumerate() {
            let flags = u32::from(machine.rx.is_full())
                | u32::from(machine.rx.is_empty()) << 8
                | u32::from(machine.tx.is_full()) << 16
                | u32::from(machine.tx.is_empty()) << 24;
            bits |= flags << number;
        }
        bits
    }

    fn read_machine(&mut self, number: usize, offset: u32, cycle: u64) -> u32 {
        let machine = &mut self.machines[number];
        machine.settle(cycle);
        let value = match offset {
            0x00 => machine.clkdiv,
            0x04 => machine.execctrl | u32::from(machine.forced) << 31,
            0x08 => machine.shiftctrl,
            0x0c => u32::from(machine.pc),
            0x10 => u32::from(self.memory[usize::from(machine.pc)]),
            _ => machine.pinctrl,
        };
        self.schedule();
        value
    }

    /// Writes a register. `merge` makes a readable register's new value from its old one (atomic aliases, §2.1.2). The
    /// cycle is that of the data phase.
    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) -> Effects {
        self.effects = Effects::default();
        match offset {
            0x000 => self.control(merge(self.enables()), cycle),
            0x008 => self.clear_debug(value),
            0x010..=0x01c => self.write_tx((offset as usize - 0x10) / 4, value, cycle),
            0x030 => self.change_irq(self.irq & !(value as u8), cycle),
            0x034 => self.change_irq(self.irq | value as u8, cycle),
            0x038 => self.input_sync_bypass = merge(self.input_sync_bypass),
            0x048..=0x0c4 => {
                self.settle(cycle + 1);
                self.memory[(offset as usize - 0x48) / 4] = value as u16;
            }
            0x0c8..=0x124 => {
                self.write_machine((offset - 0xc8) as usize / 0x18, (offset - 0xc8) % 0x18, value, merge, cycle);
            }
            0x12c | 0x138 => set(&mut self.inte[usize::from(offset == 0x138)], merge),
            0x130 | 0x13c => set(&mut self.intf[usize::from(offset == 0x13c)], merge),
            _ => {}
        }
        self.schedule();
        self.effects
    }

    /// Brings every register to its value at the beginning of `cycle`, before a write that may change what the machines
    /// do.
    fn settle(&mut self, cycle: u64) {
        for machine in &mut self.machines {
            machine.settle(cycle);
        }
    }

    /// Writing ones clears bits of FDEBUG. A stalled machine sets its bit again at once.
    fn clear_debug(&mut self, value: u32) {
        self.fdebug &= !value;
        for (number, machine) in self.machines.iter().enumerate() {
            match machine.stall {
                Stall::Tx => self.fdebug |= TXSTALL << number,
                Stall::Rx => self.fdebug |= RXSTALL << number,
                _ => {}
            }
        }
    }

    fn change_irq(&mut self, irq: u8, cycle: u64) {
        if irq != self.irq {
            self.irq = irq;
            self.wake(Stall::Irq, cycle + 1);
        }
    }

    /// CTRL: enables and restarts machines and dividers, all in one cycle.
    fn control(&mut self, value: u32, cycle: u64) {
        self.settle(cycle + 1);
        for (number, machine) in self.machines.iter_mut().enumerate() {
            if value >> (number + 4) & 1 != 0 {
                machine.restart();
                if machine.enabled {
                    machine.at = machine.tick_from(cycle + 1);
                }
            }
            if value >> (number + 8) & 1 != 0 {
                machine.change_clock(cycle + 1, |machine| machine.restart_clock(cycle + 1));
            }
            let enable = value >> number & 1 != 0;
            if enable != machine.enabled {
                machine.enabled = enable;
                if enable {
                    machine.resume(cycle + 1);
                } else if !machine.forced {
                    machine.pause(cycle + 1);
                }
            }
        }
        self.look_again(cycle + 1);
    }

    /// Wakes stalled machines in a cycle, because their condition, or the pins that they share, may have changed.
    fn look_again(&mut self, cycle: u64) {
        for machine in self.machines.iter_mut().filter(|machine| machine.stall != Stall::No) {
            wake(machine, cycle);
        }
        self.note_waits();
    }

    fn write_machine(&mut self, number: usize, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        self.settle(cycle + 1);
        let machine = &mut self.machines[number];
        match offset {
            0x00 => {
                let value = merge(machine.clkdiv);
                machine.change_clock(cycle + 1, |machine| machine.set_clkdiv(value, cycle + 1));
            }
            0x04 => {
                machine.execctrl = merge(machine.execctrl) & 0x7fff_ff9f;
                self.any_sticky = self.machines.iter().any(|machine| machine.execctrl & OUT_STICKY != 0);
            }
            0x08 => {
                let value = merge(machine.shiftctrl);
                machine.set_shiftctrl(value & 0xffff_0000);
                self.effects.requests |= 0x11 << number;
                if machine.enabled && machine.wants_refill() && !machine.tx.is_empty() {
                    machine.refill_at = machine.tick_from(cycle + 1);
                }
            }
            // SMx_INSTR: the instruction is executed in the next cycle, whatever the divider and SM_ENABLE are
            // (§3.5.7).
            0x10 => {
                machine.force(value as u16, cycle + 1);
            }
            0x14 => machine.pinctrl = merge(machine.pinctrl),
            _ => {}
        }
        self.look_again(cycle + 1);
    }

    fn note_waits(&mut self) {
        self.waits_for_pins = self.machines.iter().any(|machine| machine.stall == Stall::Pin);
    }

    /// The pins that another enabled machine writes too.
    fn driven_by_others(&self, number: usize) -> u32 {
        let others = self.machines.iter().enumerate().filter(|(other, machine)| *other != number && machine.enabled);
        others.fold(0, |pins, (_, machine)| pins | machine.drives())
    }
}

fn wake(machine: &mut Machine, from: u64) {
    if machine.enabled || machine.forced {
        let tick = if machine.forced { from } else { machine.tick_from(from) };
        machine.at = machine.at.min(tick);
    }
}

fn set(register: &mut u32, merge: impl Fn(u32) -> u32) {
    *register = merge(*register) & 0xfff;
}
