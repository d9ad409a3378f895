//! USB: a chip's device controller and a PC at the other end of the cable (USB 2.0, at full speed).
//!
//! - [`bus`]: frames, and the time that a transaction takes
//! - [`host`]: the PC: detects, enumerates, opens the serial port, moves bytes
//! - [`control`]: control transfers, and the PC's requests
//! - [`UsbDevice`]: what the PC knows of a controller; each chip has its own
//!
//! A transaction is one event, at its end: then the buffer is done and flags are set. Polls that the device refuses are
//! not simulated one by one, but they take their time on the bus.

mod bus;
mod control;
mod host;

use crate::Observer;
use host::Host;

pub use host::UsbState;

const NEVER: u64 = u64::MAX;

/// The direction of data as the PC sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    In,
    Out,
}

/// The device's answer to a token.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// It has data, or room for data, of this length.
    Ready {
        bytes: u32,
    },
    /// A NAK, or no answer.
    Refused,
    Stall,
}

/// A chip's device controller, as the PC sees it through the cable.
pub(crate) trait UsbDevice {
    /// The cable supplies power, or no longer.
    fn set_power(&mut self, powered: bool);

    /// Whether the pull-up shows the PC that a device is connected.
    fn is_attached(&self) -> bool;

    /// The PC resets the bus.
    fn bus_reset(&mut self);

    /// The reset of the bus has ended.
    fn bus_reset_ends(&mut self) {}

    /// The bus has had no frame for 3 ms.
    fn suspend(&mut self);

    /// Whether the device has this address.
    fn has_address(&self, address: u8) -> bool;

    /// The device's answer to a token.
    fn answer(&self, number: u8, direction: Direction) -> Answer;

    /// The device refused or stalled a token.
    fn refused(&mut self, number: u8, direction: Direction, stall: bool);

    /// The PC begins a control transfer, which a device must always accept.
    fn setup(&mut self, packet: [u8; 8]);

    /// The PC takes the data of an endpoint that is ready. Returns whether they are DATA1, and the data.
    fn take(&mut self, number: u8) -> (bool, Vec<u8>);

    /// The PC sends data. If they are not the expected one of DATA0 and DATA1, they are a repetition: they are
    /// acknowledged and dropped.
    fn put(&mut self, number: u8, data1: bool, data: &[u8]);

    /// Whether the start of this frame raises an interrupt.
    fn wants_frames(&self, frame: u32) -> bool;
}

/// A controller, the cable, and the PC.
#[derive(Clone)]
pub(crate) struct UsbLink<D: UsbDevice> {
    pub(crate) device: D,
    host: Host,
    /// Frequency of the chip's clock, Hz.
    hz: u64,
    /// The cycle of the last event here.
    now: u64,
    /// The cycle of the next event.
    pub(crate) next: u64,
}

impl<D: UsbDevice> UsbLink<D> {
    pub(crate) fn new(device: D) -> UsbLink<D> {
        UsbLink { device, host: Host::new(), hz: 0, now: 0, next: NEVER }
    }

    /// Sets the frequency of the chip's clock from a cycle on, Hz.
    pub(crate) fn set_clock(&mut self, hz: u64, cycle: u64) {
        if hz != self.hz {
            self.hz = hz;
            self.host.bus.set_clock(hz, cycle);
            self.plan(cycle);
        }
    }

    /// Handles the events that are due up to a cycle. Returns whether there were any.
    pub(crate) fn run(&mut self, cycle: u64, observer: &mut impl Observer) -> bool {
        let due = self.next <= cycle;
        while self.next <= cycle {
            let now = self.next;
            self.host.run(now, &mut self.device, observer);
            self.plan(now);
        }
        due
    }

    /// Notices what has changed by a cycle, and works out the next event.
    pub(crate) fn plan(&mut self, cycle: u64) {
        self.now = cycle;
        self.host.plan(cycle, &mut self.device);
        // The start of a frame, if the program has enabled its interrupt.
        let frame = self.frame().is_some_and(|frame| self.device.wants_frames(frame));
        self.next = self.host.next.min(if frame { self.host.bus.next_frame(cycle) } else { NEVER });
    }

    /// The number of the present frame, if the bus has frames.
    pub(crate) fn frame(&self) -> Option<u32> {
        self.host.makes_frames().then(|| self.host.bus.frame(self.now))
    }

    /// The number of the present frame in a cycle that is not before the last event.
    pub(crate) fn frame_in(&mut self, cycle: u64) -> Option<u32> {
        self.now = cycle;
        self.frame()
    }

    // The cable and the PC's programs.

    pub(crate) fn plug(&mut self, plugged: bool, cycle: u64) {
        self.host.plug(plugged);
        self.plan(cycle);
    }

    pub(crate) fn open(&mut self, open: bool, cycle: u64) {
        self.host.open(open);
        self.plan(cycle);
    }

    pub(crate) fn fill(&mut self, is_full: bool, cycle: u64) {
        self.host.fill(is_full);
        self.plan(cycle);
    }

    pub(crate) fn clear_halt(&mut self, endpoint: u8, cycle: u64) {
        self.host.ask(control::Request::ClearHalt(endpoint));
        self.plan(cycle);
    }

    pub(crate) fn halt(&mut self, endpoint: u8, cycle: u64) {
        self.host.ask(control::Request::SetHalt(endpoint));
        self.plan(cycle);
    }

    pub(crate) fn text(&self, index: u8) -> Option<String> {
        self.host.text(index)
    }

    pub(crate) fn try_configuration(&mut self, value: u8, cycle: u64) {
        self.host.ask(control::Request::TryConfiguration(value));
        self.plan(cycle);
    }

    pub(crate) fn send(&mut self, bytes: &[u8], cycle: u64) {
        self.host.send(bytes);
        self.plan(cycle);
    }

    pub(crate) fn backlog(&self) -> usize {
        self.host.backlog()
    }

    pub(crate) fn state(&self) -> UsbState {
        self.host.state()
    }
}
