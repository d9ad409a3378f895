//! Ports B, C and D (DS40002061B §14): DDRx, PORTx, PINx, pull-ups, and which peripheral drives or reads a pin.
//!
//! A write takes effect in the cycle after the instruction's last one. A pin's level passes one synchroniser stage
//! before it can be read (figure 14-4): `in` returns the level of one cycle before. So `out`, `nop`, `in` reads back
//! the value, and `out`, `in` does not.

use crate::{Level, Observer, PinEdge, Port};

/// A port's registers and pins.
#[derive(Clone, Copy, Default)]
struct PortPins {
    ddr: u8,
    port: u8,
    /// Bits that a timer's output drives instead of `port`, and the levels that it drives.
    override_mask: u8,
    override_level: u8,
    /// Bits that the USART takes whatever `ddr` says: RXD is an input, TXD an output that is high at rest.
    forced_in: u8,
    forced_high: u8,
    /// Bits that are driven from outside, and the levels there.
    outside_mask: u8,
    outside_level: u8,
    /// The present levels, and the levels before the change in cycle `changed_at`.
    level: u8,
    before: u8,
    changed_at: u64,
}

impl PortPins {
    fn direction(&self) -> u8 {
        self.ddr & !self.forced_in | self.forced_high
    }

    fn resolve(&self, pull_ups: bool) -> u8 {
        let driven = self.port & !self.override_mask | self.override_level & self.override_mask | self.forced_high;
        let pulled = if pull_ups { self.port & !self.ddr } else { 0 };
        let read = self.outside_level & self.outside_mask | pulled & !self.outside_mask;
        let direction = self.direction();
        driven & direction | read & !direction
    }
}

/// Pins that changed, for the peripherals that react to pins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Change {
    pub(super) cycle: u64,
    pub(super) port: Port,
    pub(super) bits: u8,
    pub(super) level: u8,
}

#[derive(Clone, Default)]
pub(super) struct Ports {
    pins: [PortPins; 3],
    pull_ups_off: bool,
    /// For each port, the bits whose changes go into `changes`.
    pub(super) watched: [u8; 3],
    pub(super) changes: Vec<Change>,
}

impl Ports {
    pub(super) fn reset(&mut self, cycle: u64, observer: &mut impl Observer) {
        self.pull_ups_off = false;
        self.watched = [0; 3];
        for port in Port::ALL {
            let pins = &mut self.pins[port.index()];
            (pins.ddr, pins.port, pins.override_mask, pins.forced_in, pins.forced_high) = (0, 0, 0, 0, 0);
            self.update(port, cycle, true, observer);
        }
    }

    pub(super) fn level(&self, port: Port) -> u8 {
        self.pins[port.index()].level
    }

    pub(super) fn is_output(&self, port: Port, bit: u8) -> bool {
        self.pins[port.index()].direction() >> (bit & 7) & 1 != 0
    }

    pub(super) fn ddr(&self, port: Port) -> u8 {
        self.pins[port.index()].ddr
    }

    pub(super) fn port(&self, port: Port) -> u8 {
        self.pins[port.index()].port
    }

    /// PINx as an instruction reads it in `cycle`: the levels of one cycle earlier.
    pub(super) fn pin(&self, port: Port, cycle: u64) -> u8 {
        let pins = &self.pins[port.index()];
        if pins.changed_at >= cycle { pins.before } else { pins.level }
    }

    pub(super) fn set_ddr(&mut self, port: Port, value: u8, cycle: u64, observer: &mut impl Observer) {
        self.pins[port.index()].ddr = value;
        self.update(port, cycle, true, observer);
    }

    pub(super) fn set_port(&mut self, port: Port, value: u8, cycle: u64, observer: &mut impl Observer) {
        self.pins[port.index()].port = value;
        self.update(port, cycle, true, observer);
    }

    pub(super) fn set_pull_ups_off(&mut self, off: bool, cycle: u64, observer: &mut impl Observer) {
        if self.pull_ups_off != off {
            self.pull_ups_off = off;
            for port in Port::ALL {
                self.update(port, cycle, true, observer);
            }
        }
    }

    /// Connects a timer's output to a pin with a level, or disconnects it (`None`).
    pub(super) fn set_override(
        &mut self,
        (port, bit): (Port, u8),
        driven: Option<bool>,
        cycle: u64,
        observer: &mut impl Observer,
    ) {
        let pins = &mut self.pins[port.index()];
        let mask = 1 << bit;
        pins.override_mask = if driven.is_some() { pins.override_mask | mask } else { pins.override_mask & !mask };
        pins.override_level =
            if driven == Some(true) { pins.override_level | mask } else { pins.override_level & !mask };
        self.update(port, cycle, true, observer);
    }

    /// Lets the USART take PD0 for RXD and PD1 for TXD, or frees them (§20.6, §20.7).
    pub(super) fn set_serial(&mut self, receives: bool, transmits: bool, cycle: u64, observer: &mut impl Observer) {
        let pins = &mut self.pins[Port::D.index()];
        (pins.forced_in, pins.forced_high) = (u8::from(receives), u8::from(transmits) << 1);
        self.update(Port::D, cycle, true, observer);
    }

    /// Drives a pin from outside, or no longer (`None`).
    pub(super) fn set_outside(&mut self, port: Port, bit: u8, level: Option<Level>, cycle: u64) {
        let pins = &mut self.pins[port.index()];
        let mask = 1 << (bit & 7);
        pins.outside_mask = if level.is_some() { pins.outside_mask | mask } else { pins.outside_mask & !mask };
        pins.outside_level =
            if level == Some(Level::High) { pins.outside_level | mask } else { pins.outside_level & !mask };
        self.update(port, cycle, false, &mut ());
    }

    /// Computes the levels of a port. The observer sees the pins that changed if the chip was the cause (`ours`).
    fn update(&mut self, port: Port, cycle: u64, ours: bool, observer: &mut impl Observer) {
        let pins = &mut self.pins[port.index()];
        let level = pins.resolve(!self.pull_ups_off);
        let bits = level ^ pins.level;
        if bits == 0 {
            return;
        }
        // After two changes in one cycle, a read still returns the levels before the first.
        if pins.changed_at < cycle {
            (pins.before, pins.changed_at) = (pins.level, cycle);
        }
        pins.level = level;
        if ours {
            let mut left = bits;
            while left != 0 {
                let bit = left.trailing_zeros() as u8;
                left &= left - 1;
                observer.pin(PinEdge { cycle, port, bit, level: Level::from(level >> bit & 1 != 0) });
            }
        }
        if bits & self.watched[port.index()] != 0 {
            self.changes.push(Change { cycle, port, bits, level });
        }
    }
}
