//! USB: the chip's device controller and a PC at the other end of the cable (RP2040 datasheet §4.1; USB 2.0).
//!
//! - [`controller`]: registers, DPRAM, the device's answers to tokens
//! - [`bus`]: frames, and the time that a transaction takes
//! - [`host`]: the PC: detects, enumerates, opens the serial port, moves bytes
//! - [`control`]: control transfers, and the PC's requests
//!
//! A transaction is one event, at its end: then the buffer is done and flags are set. Polls that the device refuses are
//! not simulated one by one, but they take their time on the bus.

mod bus;
mod control;
mod controller;
mod host;

use crate::Observer;
use crate::arm::Size;
use controller::Controller;
use host::Host;

pub use host::UsbState;

const NEVER: u64 = u64::MAX;

#[derive(Clone)]
pub(super) struct Usb {
    controller: Controller,
    host: Host,
    /// Frequency of clk_sys, Hz.
    sys_hz: u64,
    /// The cycle of the last event here.
    now: u64,
    /// The cycle of the next event.
    pub(super) next: u64,
}

impl Usb {
    pub(super) fn new() -> Usb {
        Usb { controller: Controller::new(), host: Host::new(), sys_hz: 0, now: 0, next: NEVER }
    }

    /// Resets the controller. The PC sees that the device has gone.
    pub(super) fn reset(&mut self, cycle: u64) {
        self.controller.reset();
        self.plan(cycle);
    }

    /// Sets the frequency of clk_sys from a cycle on, Hz.
    pub(super) fn set_clock(&mut self, sys_hz: u64, cycle: u64) {
        if sys_hz != self.sys_hz {
            self.sys_hz = sys_hz;
            self.host.bus.set_clock(sys_hz, cycle);
            self.plan(cycle);
        }
    }

    /// Handles the events that are due up to a cycle. Returns whether there were any.
    pub(super) fn run(&mut self, cycle: u64, observer: &mut impl Observer) -> bool {
        let due = self.next <= cycle;
        while self.next <= cycle {
            let now = self.next;
            self.host.run(now, &mut self.controller, observer);
            self.plan(now);
        }
        due
    }

    fn plan(&mut self, cycle: u64) {
        self.now = cycle;
        self.host.plan(cycle, &mut self.controller);
        // The start of a frame, if the program has enabled its interrupt.
        let frame = self.frame().is_some_and(|frame| self.controller.wants_frames(frame));
        self.next = self.host.next.min(if frame { self.host.bus.next_frame(cycle) } else { NEVER });
    }

    /// The number of the present frame, if the bus has frames.
    fn frame(&self) -> Option<u32> {
        self.host.makes_frames().then(|| self.host.bus.frame(self.now))
    }

    /// Whether the interrupt line (USBCTRL_IRQ) is high.
    pub(super) fn line_asserted(&self) -> bool {
        self.controller.interrupts(self.frame()) != 0
    }

    pub(super) fn read(&mut self, offset: u32, cycle: u64) -> u32 {
        self.now = cycle;
        let value = self.controller.read(offset, self.frame());
        if offset == controller::at::SOF_RD {
            self.plan(cycle);
        }
        value
    }

    /// `value` is the written word, for bits that ones clear. `merge` makes the new value of the other registers.
    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        self.controller.write(offset, value, merge);
        self.plan(cycle + 1);
    }

    pub(super) fn read_memory(&self, offset: u32, size: Size) -> u32 {
        self.controller.memory.read(offset, size)
    }

    pub(super) fn write_memory(&mut self, offset: u32, size: Size, value: u32, cycle: u64) {
        self.controller.memory.write(offset, size, value);
        if self.controller.memory_written(offset) {
            self.plan(cycle + 1);
        }
    }

    // The cable and the PC's programs.

    pub(super) fn plug(&mut self, plugged: bool, cycle: u64) {
        self.host.plug(plugged);
        self.plan(cycle);
    }

    pub(super) fn open(&mut self, open: bool, cycle: u64) {
        self.host.open(open);
        self.plan(cycle);
    }

    pub(super) fn fill(&mut self, is_full: bool, cycle: u64) {
        self.host.fill(is_full);
        self.plan(cycle);
    }

    pub(super) fn clear_halt(&mut self, endpoint: u8, cycle: u64) {
        self.host.ask(control::Request::ClearHalt(endpoint));
        self.plan(cycle);
    }

    pub(super) fn halt(&mut self, endpoint: u8, cycle: u64) {
        self.host.ask(control::Request::SetHalt(endpoint));
        self.plan(cycle);
    }

    pub(super) fn text(&self, index: u8) -> Option<String> {
        self.host.text(index)
    }

    pub(super) fn try_configuration(&mut self, value: u8, cycle: u64) {
        self.host.ask(control::Request::TryConfiguration(value));
        self.plan(cycle);
    }

    pub(super) fn send(&mut self, bytes: &[u8], cycle: u64) {
        self.host.send(bytes);
        self.plan(cycle);
    }

    pub(super) fn backlog(&self) -> usize {
        self.host.backlog()
    }

    pub(super) fn state(&self) -> UsbState {
        self.host.state()
    }
}
