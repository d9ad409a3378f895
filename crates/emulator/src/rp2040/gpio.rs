//! GPIO bank 0 (RP2040 datasheet §2.19): which peripheral drives a pin, its pad, and its interrupts.
//!
//! The cycle of an edge is the first one in which the pin has its new level; it follows the cycle in which a register
//! or a state machine changed the pin. A level passes two flip-flops before it can be read (§3.5.6.3).

use crate::{GpioEdge, Level, Observer};

/// GPIO 0 to 29.
pub(super) const PINS: u32 = 0x3fff_ffff;

/// The levels of the pins as inputs, with those of the last cycles, because the synchronisers delay them.
#[derive(Clone, Default)]
pub(super) struct Inputs {
    /// Levels and the first cycle of each, latest first. Four are enough: there is one entry for a cycle at most, and a
    /// read looks back two cycles at most.
    past: [(u64, u32); 4],
}

impl Inputs {
    /// Cycles from a pin to its reader.
    pub(super) const SYNCHRONISER: u64 = 2;

    /// The levels at the pins in a cycle: the present one or one of the two before it.
    pub(super) fn at(&self, cycle: u64) -> u32 {
        self.past.iter().find(|(from, _)| *from <= cycle).unwrap_or(&self.past[3]).1
    }

    /// The levels that a read returns in a cycle. Pins in `bypass` have their synchroniser bypassed.
    pub(super) fn seen(&self, cycle: u64, bypass: u32) -> u32 {
        let through = self.at(cycle.saturating_sub(Inputs::SYNCHRONISER));
        if bypass == 0 { through } else { through & !bypass | self.at(cycle) & bypass }
    }

    /// Whether a level changed after a cycle.
    pub(super) fn changed_since(&self, cycle: u64) -> bool {
        self.past[0].0 > cycle
    }

    fn present(&self) -> u32 {
        self.past[0].1
    }

    fn change(&mut self, levels: u32, cycle: u64) {
        if self.past[0].0 == cycle {
            self.past[0].1 = levels;
        } else {
            self.past.rotate_right(1);
            self.past[0] = (cycle, levels);
        }
    }
}

/// Function numbers of the peripherals that can drive pins (§2.19.2).
pub(super) mod function {
    pub(in super::super) const UART: u32 = 2;
    pub(in super::super) const SIO: u32 = 5;
    pub(in super::super) const PIO0: u32 = 6;
    pub(in super::super) const PIO1: u32 = 7;
    /// No function: nothing drives the pin.
    pub(super) const NULL: u32 = 31;
}

// Pads (§2.19.6.3).
const PAD_OD: u8 = 1 << 7;
const PAD_IE: u8 = 1 << 6;
const PAD_PUE: u8 = 1 << 3;
/// A pad after a reset: Schmitt trigger, pull-down, 4 mA, input enabled.
const PAD_RESET: u8 = 0x56;

/// The outputs of a peripheral: levels and directions.
#[derive(Clone, Copy, Default)]
pub(super) struct Driven {
    pub(super) levels: u32,
    pub(super) directions: u32,
}

#[derive(Clone)]
pub(super) struct Gpio {
    control: [u32; 30],
    pads: [u8; 30],
    voltage: u32,
    /// For each function, the pins that select it.
    functions: [u32; 32],
    /// OUTOVER, OEOVER and INOVER as masks: invert, low, high.
    out_over: Over,
    direction_over: Over,
    in_over: Over,
    input_enable: u32,
    output_disable: u32,
    pull_up: u32,
    /// The outputs of SIO, PIO0, PIO1 and the UARTs.
    pub(super) sio: Driven,
    pub(super) pio: [Driven; 2],
    pub(super) uart: Driven,
    /// Pins that are driven from outside, and the levels there.
    outside_mask: u32,
    outside: u32,
    /// The levels of the pads, and which of them are outputs.
    levels: u32,
    directions: u32,
    pub(super) inputs: Inputs,
    /// Edges that were seen (INTR bits 2 and 3 of each pin), then enables and forces for processor 0, processor 1 and
    /// waking.
    edges: [u32; 4],
    enables: [[u32; 4]; 3],
    forces: [[u32; 4]; 3],
    /// Whether any interrupt is enabled.
    watches: bool,
}

#[derive(Clone, Copy, Default)]
struct Over {
    invert: u32,
    low: u32,
    high: u32,
}

impl Over {
    fn set(&mut self, pin: u32, mode: u32) {
        let bit = 1 << pin;
        let put = |mask: &mut u32, on: bool| *mask = if on { *mask | bit } else { *mask & !bit };
        put(&mut self.invert, mode & 3 == 1);
        put(&mut self.low, mode & 3 == 2);
        put(&mut self.high, mode & 3 == 3);
    }

    fn apply(&self, value: u32) -> u32 {
        (value ^ self.invert) & !self.low | self.high
    }
}

impl Gpio {
    pub(super) fn new() -> Gpio {
        let mut gpio = Gpio {
            control: [function::NULL; 30],
            pads: [PAD_RESET; 30],
            voltage: 0,
            functions: [0; 32],
            out_over: Over::default(),
            direction_over: Over::default(),
            in_over: Over::default(),
            input_enable: PINS,
            output_disable: 0,
            pull_up: 0,
            sio: Driven::default(),
            pio: [Driven::default(); 2],
            uart: Driven::default(),
            outside_mask: 0,
            outside: 0,
            levels: 0,
            directions: 0,
            inputs: Inputs::default(),
            edges: [0; 4],
            enables: [[0; 4]; 3],
            forces: [[0; 4]; 3],
            watches: false,
        };
        gpio.functions[function::NULL as usize] = PINS;
        gpio
    }

    /// Resets the bank. Pins that are driven from outside stay driven.
    pub(super) fn reset_bank(&mut self) {
        for pin in 0..30 {
            self.set_control(pin, function::NULL);
        }
        (self.edges, self.enables, self.forces) = ([0; 4], [[0; 4]; 3], [[0; 4]; 3]);
        self.watches = false;
    }

    pub(super) fn reset_pads(&mut self) {
        for pin in 0..30 {
            self.set_pad(pin, PAD_RESET);
        }
        self.voltage = 0;
    }

    fn set_control(&mut self, pin: u32, value: u32) {
        let before = self.control[pin as usize] & 31;
        self.functions[before as usize] &= !(1 << pin);
        self.functions[(value & 31) as usize] |= 1 << pin;
        self.out_over.set(pin, value >> 8);
        self.direction_over.set(pin, value >> 12);
        self.in_over.set(pin, value >> 16);
        self.control[pin as usize] = value & 0x3003_331f;
    }

    fn set_pad(&mut self, pin: u32, value: u8) {
        let bit = 1 << pin;
        let put = |mask: &mut u32, on: bool| *mask = if on { *mask | bit } else { *mask & !bit };
        put(&mut self.output_disable, value & PAD_OD != 0);
        put(&mut self.input_enable, value & PAD_IE != 0);
        // A pin without a pull-up that nothing drives reads low, with or without its pull-down.
        put(&mut self.pull_up, value & PAD_PUE != 0);
        self.pads[pin as usize] = value;
    }

    /// The pins that select a function.
    pub(super) fn pins_of(&self, function: u32) -> u32 {
        self.functions[function as usize]
    }

    /// The levels of the pins as seen from outside.
    pub(super) fn levels(&self) -> u32 {
        self.levels
    }

    /// The pins that the chip drives.
    pub(super) fn directions(&self) -> u32 {
        self.directions
    }

    /// Drives a pin from outside, or no longer (`None`). Returns the inputs that changed.
    pub(super) fn set_outside(&mut self, pin: u32, level: Option<Level>, cycle: u64) -> u32 {
        let bit = 1 << pin & PINS;
        self.outside_mask = if level.is_some() { self.outside_mask | bit } else { self.outside_mask & !bit };
        self.outside = if level == Some(Level::High) { self.outside | bit } else { self.outside & !bit };
        let before = self.levels;
        self.resolve();
        self.settle(before, cycle)
    }

    fn resolve(&mut self) {
        let [uart, sio, pio0, pio1] = [function::UART, function::SIO, function::PIO0, function::PIO1]
            .map(|function| self.functions[function as usize]);
        let pick = |value: fn(&Driven) -> u32| {
            value(&self.uart) & uart | value(&self.sio) & sio | value(&self.pio[0]) & pio0 | value(&self.pio[1]) & pio1
        };
        let out = self.out_over.apply(pick(|driven| driven.levels));
        let directions = self.direction_over.apply(pick(|driven| driven.directions)) & !self.output_disable & PINS;
        let read = self.outside & self.outside_mask | self.pull_up & !self.outside_mask;
        self.levels = out & directions | read & !directions;
        self.directions = directions;
    }

    /// Computes the levels from `cycle` on, and reports those that the chip changed to the observer. Returns the inputs
    /// that changed.
    pub(super) fn update(&mut self, cycle: u64, observer: &mut impl Observer) -> u32 {
        let before = self.levels;
        self.resolve();
        let mut changed = before ^ self.levels;
        if changed == 0 {
            return self.settle(before, cycle);
        }
        while changed != 0 {
            let gpio = changed.trailing_zeros() as u8;
            changed &= changed - 1;
            observer.gpio(GpioEdge { cycle, gpio, level: Level::from(self.levels >> gpio & 1 != 0) });
        }
        self.settle(before, cycle)
    }

    fn settle(&mut self, before: u32, cycle: u64) -> u32 {
        let inputs = self.in_over.apply(self.levels & self.input_enable) & PINS;
        let changed = inputs ^ self.inputs.present();
        if changed != 0 {
            self.inputs.change(inputs, cycle);
        }
        if self.levels != before {
            self.note_edges(self.levels & !before, before & !self.levels);
        }
        changed
    }

    fn note_edges(&mut self, rising: u32, falling: u32) {
        let mut bits = rising | falling;
        while bits != 0 {
            let pin = bits.trailing_zeros();
            bits &= bits - 1;
            let kind = if rising >> pin & 1 != 0 { 8 } else { 4 };
            self.edges[(pin / 8) as usize] |= kind << (pin % 8 * 4);
        }
    }

    // Interrupts (§2.19.4): four bits a pin: level low, level high, edge low, edge high.

    fn intr(&self, group: usize) -> u32 {
        let mut bits = self.edges[group];
        for pin in 0..8 {
            let high = self.inputs.present() >> (group * 8 + pin) & 1;
            bits |= (1 + high) << (pin * 4);
        }
        bits
    }

    fn ints(&self, who: usize, group: usize) -> u32 {
        self.intr(group) & self.enables[who][group] | self.forces[who][group]
    }

    /// Whether some interrupt is enabled.
    pub(super) fn interrupts(&self) -> bool {
        self.watches
    }

    /// The level of a processor's interrupt line.
    pub(super) fn line(&self, processor: usize) -> bool {
        self.watches && (0..4).any(|group| self.ints(processor, group) != 0)
    }

    // Registers: IO_BANK0 (§2.19.6.1).

    pub(super) fn read(&self, offset: u32) -> u32 {
        match offset {
            0x000..=0x0ec if offset & 4 == 0 => self.status(offset / 8),
            0x000..=0x0ec => self.control[(offset / 8) as usize],
            0x0f0..=0x0fc => self.intr((offset as usize - 0xf0) / 4),
            0x100..=0x18c => {
                let (who, kind, group) = interrupt_register(offset);
                match kind {
                    0 => self.enables[who][group],
                    1 => self.forces[who][group],
                    _ => self.ints(who, group),
                }
            }
            _ => 0,
        }
    }

    fn status(&self, pin: u32) -> u32 {
        let bit = |mask: u32| mask >> pin & 1;
        // OUTTOPAD, OETOPAD, INFROMPAD, INTOPERI.
        bit(self.levels & self.directions) << 9
            | bit(self.directions) << 13
            | bit(self.levels & self.input_enable) << 17
            | bit(self.inputs.present()) << 19
    }

    /// Writes a register. The pins follow at the next [`update`](Gpio::update).
    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32) {
        match offset {
            0x000..=0x0ec if offset & 4 != 0 => {
                let pin = offset / 8;
                self.set_control(pin, merge(self.control[pin as usize]));
            }
            // Writing ones clears the edges.
            0x0f0..=0x0fc => self.edges[(offset as usize - 0xf0) / 4] &= !value,
            0x100..=0x18c => {
                let (who, kind, group) = interrupt_register(offset);
                match kind {
                    0 => self.enables[who][group] = merge(self.enables[who][group]),
                    1 => self.forces[who][group] = merge(self.forces[who][group]),
                    _ => {}
                }
                self.watches = self.enables[..2].iter().chain(&self.forces[..2]).flatten().any(|bits| *bits != 0);
            }
            _ => {}
        }
    }

    // Registers: PADS_BANK0 (§2.19.6.3).

    pub(super) fn read_pad(&self, offset: u32) -> u32 {
        match offset {
            0 => self.voltage,
            4..=0x78 => u32::from(self.pads[(offset / 4 - 1) as usize]),
            // SWCLK and SWD.
            0x7c => 0xda,
            0x80 => 0x5a,
            _ => 0,
        }
    }

    pub(super) fn write_pad(&mut self, offset: u32, merge: impl Fn(u32) -> u32) {
        match offset {
            0 => self.voltage = merge(self.voltage) & 1,
            4..=0x78 => {
                let pin = offset / 4 - 1;
                let value = merge(u32::from(self.pads[pin as usize])) as u8;
                self.set_pad(pin, value);
            }
            _ => {}
        }
    }
}

/// Which interrupt register an offset is: processor 0, 1 or waking; enable, force or status; which eight pins.
fn interrupt_register(offset: u32) -> (usize, usize, usize) {
    let index = (offset as usize - 0x100) / 4;
    (index / 12, index % 12 / 4, index % 4)
}
