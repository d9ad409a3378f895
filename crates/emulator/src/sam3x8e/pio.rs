//! The pins: parallel I/O controllers A to D, and what peripherals drive (Atmel-11057C §31; multiplexing: §9).
//!
//! Pins are numbered 0 to 31 for port A, 32 to 63 for B, 64 to 95 for C, 96 to 127 for D.
//!
//! Not emulated: glitch and debouncing filters, open-drain outputs as such, write protection, and that an input is only
//! seen after it has passed the synchroniser.

use crate::{GpioEdge, Level, Observer};

/// Offsets of the registers (§31).
mod at {
    pub(super) const PER: u32 = 0x00;
    pub(super) const PDR: u32 = 0x04;
    pub(super) const PSR: u32 = 0x08;
    pub(super) const OER: u32 = 0x10;
    pub(super) const ODR: u32 = 0x14;
    pub(super) const OSR: u32 = 0x18;
    pub(super) const SODR: u32 = 0x30;
    pub(super) const CODR: u32 = 0x34;
    pub(super) const ODSR: u32 = 0x38;
    pub(super) const PDSR: u32 = 0x3c;
    pub(super) const IER: u32 = 0x40;
    pub(super) const IDR: u32 = 0x44;
    pub(super) const IMR: u32 = 0x48;
    pub(super) const ISR: u32 = 0x4c;
    pub(super) const MDER: u32 = 0x50;
    pub(super) const MDDR: u32 = 0x54;
    pub(super) const MDSR: u32 = 0x58;
    pub(super) const PUDR: u32 = 0x60;
    pub(super) const PUER: u32 = 0x64;
    pub(super) const PUSR: u32 = 0x68;
    pub(super) const ABSR: u32 = 0x70;
    pub(super) const OWER: u32 = 0xa0;
    pub(super) const OWDR: u32 = 0xa4;
    pub(super) const OWSR: u32 = 0xa8;
    pub(super) const AIMER: u32 = 0xb0;
    pub(super) const AIMDR: u32 = 0xb4;
    pub(super) const AIMMR: u32 = 0xb8;
    pub(super) const ESR: u32 = 0xc0;
    pub(super) const LSR: u32 = 0xc4;
    pub(super) const ELSR: u32 = 0xc8;
    pub(super) const FELLSR: u32 = 0xd0;
    pub(super) const REHLSR: u32 = 0xd4;
    pub(super) const FRLHSR: u32 = 0xd8;
}

/// The peripherals that can drive a pin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Output {
    /// TIOA of a timer channel.
    TioA(usize),
    /// TIOB of a timer channel.
    TioB(usize),
}

/// Pins that peripherals drive: port, bit, whether as peripheral B (§9, tables of port A to D). The channels 3 to 5
/// have their pins on port E, which the SAM3X8E does not have.
const OUTPUTS: [(usize, u32, bool, Output); 12] = [
    (0, 2, false, Output::TioA(1)),
    (0, 3, false, Output::TioB(1)),
    (0, 5, false, Output::TioA(2)),
    (0, 6, false, Output::TioB(2)),
    (1, 25, true, Output::TioA(0)),
    (1, 27, true, Output::TioB(0)),
    (2, 25, true, Output::TioA(6)),
    (2, 26, true, Output::TioB(6)),
    (2, 28, true, Output::TioA(7)),
    (2, 29, true, Output::TioB(7)),
    (3, 7, true, Output::TioA(8)),
    (3, 8, true, Output::TioB(8)),
];

#[derive(Clone, Debug)]
struct PortState {
    /// PSR: the pins that the controller drives, not a peripheral.
    enabled: u32,
    outputs: u32,
    data: u32,
    data_writable: u32,
    multi_driver: u32,
    /// Pins without a pull-up.
    no_pull_up: u32,
    peripheral_b: u32,
    mask: u32,
    status: u32,
    /// Pins with additional interrupt modes; of these, those that look at levels, and those that look at rises or highs.
    additional: u32,
    by_level: u32,
    rising: u32,
    /// What drives each pin from outside, and to which level.
    outside: u32,
    outside_levels: u32,
    /// What peripherals A and B drive, and to which levels.
    peripheral: [u32; 2],
    peripheral_levels: [u32; 2],
    /// The levels of the pins.
    levels: u32,
    clocked: bool,
    /// The levels when the controller last had its clock.
    seen: u32,
}

impl PortState {
    /// After a reset all pins are inputs with pull-ups (§31).
    fn new() -> PortState {
        PortState {
            enabled: u32::MAX,
            outputs: 0,
            data: 0,
            data_writable: 0,
            multi_driver: 0,
            no_pull_up: 0,
            peripheral_b: 0,
            mask: 0,
            status: 0,
            additional: 0,
            by_level: 0,
            rising: 0,
            outside: 0,
            outside_levels: 0,
            peripheral: [0; 2],
            peripheral_levels: [0; 2],
            levels: u32::MAX,
            clocked: false,
            seen: u32::MAX,
        }
    }

    fn chosen(&self, [a, b]: [u32; 2]) -> u32 {
        a & !self.peripheral_b | b & self.peripheral_b
    }

    /// The pins that the chip drives.
    fn driven(&self) -> u32 {
        self.enabled & self.outputs | !self.enabled & self.chosen(self.peripheral)
    }

    /// Works out the levels. Returns the pins whose level has changed.
    fn drive(&mut self) -> u32 {
        let driven = self.driven();
        let own = self.enabled & self.data | !self.enabled & self.chosen(self.peripheral_levels);
        let others = self.outside & self.outside_levels | !self.outside & !self.no_pull_up;
        let levels = driven & own | !driven & others;
        let changed = levels ^ self.levels;
        self.levels = levels;
        self.look();
        changed
    }

    /// Notices changes of inputs (§31). Without its clock the controller sees none.
    fn look(&mut self) {
        if !self.clocked {
            return;
        }
        let changed = self.levels ^ self.seen;
        self.seen = self.levels;
        let is_right = !(self.levels ^ self.rising);
        let edges = changed & (!self.additional | is_right);
        self.status |= edges & !(self.additional & self.by_level) | self.additional & self.by_level & is_right;
    }

    fn read(&mut self, offset: u32) -> u32 {
        match offset {
            at::PSR => self.enabled,
            at::OSR => self.outputs,
            at::ODSR => self.data,
            at::PDSR => self.seen,
            at::IMR => self.mask,
            at::ISR => {
                let status = std::mem::take(&mut self.status);
                self.look();
                status
            }
            at::MDSR => self.multi_driver,
            at::PUSR => self.no_pull_up,
            at::ABSR => self.peripheral_b,
            at::OWSR => self.data_writable,
            at::AIMMR => self.additional,
            at::ELSR => self.by_level,
            at::FRLHSR => self.rising,
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32) {
        match offset {
            at::PER => self.enabled |= value,
            at::PDR => self.enabled &= !value,
            at::OER => self.outputs |= value,
            at::ODR => self.outputs &= !value,
            at::SODR => self.data |= value,
            at::CODR => self.data &= !value,
            at::ODSR => self.data = self.data & !self.data_writable | value & self.data_writable,
            at::IER => self.mask |= value,
            at::IDR => self.mask &= !value,
            at::MDER => self.multi_driver |= value,
            at::MDDR => self.multi_driver &= !value,
            at::PUDR => self.no_pull_up |= value,
            at::PUER => self.no_pull_up &= !value,
            at::ABSR => self.peripheral_b = value,
            at::OWER => self.data_writable |= value,
            at::OWDR => self.data_writable &= !value,
            at::AIMER => self.additional |= value,
            at::AIMDR => self.additional &= !value,
            at::ESR => self.by_level &= !value,
            at::LSR => self.by_level |= value,
            at::FELLSR => self.rising &= !value,
            at::REHLSR => self.rising |= value,
            _ => {}
        }
    }
}

/// The four controllers.
#[derive(Clone, Debug)]
pub(super) struct Pins {
    ports: [PortState; 4],
}

impl Pins {
    pub(super) fn new() -> Pins {
        Pins { ports: std::array::from_fn(|_| PortState::new()) }
    }

    /// Resets the controllers. What drives pins from outside stays. The observer sees the pins that change.
    pub(super) fn reset(&mut self, cycle: u64, observer: &mut impl Observer) {
        for port in 0..4 {
            let PortState { outside, outside_levels, levels, .. } = self.ports[port];
            self.ports[port] = PortState { outside, outside_levels, levels, ..PortState::new() };
            self.drive(port, cycle, observer);
        }
    }

    /// Sets which controllers have their clock, bit 0 for A.
    pub(super) fn set_clocks(&mut self, enabled: u32) {
        for (at, port) in self.ports.iter_mut().enumerate() {
            port.clocked = enabled >> at & 1 != 0;
            port.look();
        }
    }

    /// Works out the levels of a port, and reports what the chip has changed, with the first cycle of the new levels.
    fn drive(&mut self, port: usize, cycle: u64, observer: &mut impl Observer) {
        let mut changed = self.ports[port].drive();
        while changed != 0 {
            let bit = changed.trailing_zeros();
            changed &= changed - 1;
            let level = Level::from(self.ports[port].levels >> bit & 1 != 0);
            observer.gpio(GpioEdge { cycle, gpio: (32 * port as u32 + bit) as u8, level });
        }
    }

    /// A peripheral drives a pin from a cycle on, or no longer (`None`).
    pub(super) fn output(&mut self, output: Output, level: Option<bool>, cycle: u64, observer: &mut impl Observer) {
        for (port, bit, is_b, source) in OUTPUTS {
            if source != output {
                continue;
            }
            let state = &mut self.ports[port];
            let (which, bit) = (usize::from(is_b), 1 << bit);
            let (driven, levels) = (state.peripheral[which], state.peripheral_levels[which]);
            state.peripheral[which] = if level.is_some() { driven | bit } else { driven & !bit };
            state.peripheral_levels[which] = if level == Some(true) { levels | bit } else { levels & !bit };
            if (state.peripheral[which], state.peripheral_levels[which]) != (driven, levels) {
                self.drive(port, cycle, observer);
            }
        }
    }

    /// Drives a pin from outside, or no longer.
    pub(super) fn set_outside(&mut self, pin: u8, level: Option<Level>) {
        let (port, bit) = (&mut self.ports[usize::from(pin / 32) & 3], 1 << (pin % 32));
        port.outside = if level.is_some() { port.outside | bit } else { port.outside & !bit };
        let is_high = level.is_some_and(Level::is_high);
        port.outside_levels = if is_high { port.outside_levels | bit } else { port.outside_levels & !bit };
        port.drive();
    }

    pub(super) fn level(&self, pin: u8) -> Level {
        Level::from(self.ports[usize::from(pin / 32) & 3].levels >> (pin % 32) & 1 != 0)
    }

    pub(super) fn is_output(&self, pin: u8) -> bool {
        self.ports[usize::from(pin / 32) & 3].driven() >> (pin % 32) & 1 != 0
    }

    /// Whether the UART's transmitter has its pin, PA9, and its receiver PA8, both as peripheral A.
    pub(super) fn connects_uart(&self) -> [bool; 2] {
        let taken = self.ports[0].enabled | self.ports[0].peripheral_b;
        [taken & 1 << 9 == 0, taken & 1 << 8 == 0]
    }

    /// The interrupt lines, bit 0 for A.
    pub(super) fn lines(&self) -> u64 {
        self.ports.iter().rev().fold(0, |lines, port| lines << 1 | u64::from(port.status & port.mask != 0))
    }

    pub(super) fn read(&mut self, port: usize, offset: u32) -> u32 {
        self.ports[port].read(offset)
    }

    /// Writes a register; the pins have their new levels in the next cycle.
    pub(super) fn write(&mut self, port: usize, offset: u32, value: u32, cycle: u64, observer: &mut impl Observer) {
        self.ports[port].write(offset, value);
        self.drive(port, cycle + 1, observer);
    }
}
