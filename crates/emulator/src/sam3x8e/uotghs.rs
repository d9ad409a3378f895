//! The USB device controller at full speed (Atmel-11057C §39). The PC at the other end of the cable is [`crate::usb`].
//!
//! What the datasheet leaves open: a bank that is written or read in the cycle in which the PC takes or fills another is
//! not disturbed by it; `TXINI` of endpoint 0 is 0 from a SETUP until the program has acknowledged that.
//!
//! Not emulated: host mode, high speed (the PC has none), isochronous endpoints, the controller's own DMA, automatic
//! switching of banks, remote wake-up, test modes.

use crate::arm::Size;
use crate::usb::{Answer, Direction, UsbDevice, UsbLink};
use std::collections::VecDeque;

const ENDPOINTS: usize = 10;

/// Offsets of the registers (§39).
mod at {
    pub(super) const DEVCTRL: u32 = 0x00;
    pub(super) const DEVISR: u32 = 0x04;
    pub(super) const DEVICR: u32 = 0x08;
    pub(super) const DEVIFR: u32 = 0x0c;
    pub(super) const DEVIMR: u32 = 0x10;
    pub(super) const DEVIDR: u32 = 0x14;
    pub(super) const DEVIER: u32 = 0x18;
    pub(super) const DEVEPT: u32 = 0x1c;
    pub(super) const DEVFNUM: u32 = 0x20;
    pub(super) const EPTCFG: u32 = 0x100;
    pub(super) const EPTISR: u32 = 0x130;
    pub(super) const EPTICR: u32 = 0x160;
    pub(super) const EPTIFR: u32 = 0x190;
    pub(super) const EPTIMR: u32 = 0x1c0;
    pub(super) const EPTIER: u32 = 0x1f0;
    pub(super) const EPTIDR: u32 = 0x220;
    pub(super) const EPT_END: u32 = 0x250;
    pub(super) const CTRL: u32 = 0x800;
    pub(super) const SR: u32 = 0x804;
    pub(super) const SCR: u32 = 0x808;
    pub(super) const SFR: u32 = 0x80c;
}

/// DEVCTRL.
mod devctrl {
    pub(super) const ADDRESS: u32 = 0x7f;
    pub(super) const ADDRESS_ON: u32 = 1 << 7;
    pub(super) const DETACH: u32 = 1 << 8;
    pub(super) const STORED: u32 = 0x1fdff;
}

/// DEVISR.
mod devisr {
    pub(super) const SUSPEND: u32 = 1;
    pub(super) const FRAME: u32 = 1 << 2;
    pub(super) const RESET_ENDED: u32 = 1 << 3;
    pub(super) const WAKE_UP: u32 = 1 << 4;
    /// The flags that are cleared by DEVICR.
    pub(super) const FLAGS: u32 = 0x7f;
    pub(super) const ENDPOINTS_AT: usize = 12;
}

/// EPTCFG.
mod eptcfg {
    pub(super) const ALLOCATED: u32 = 1 << 1;
    pub(super) const IN: u32 = 1 << 8;
    pub(super) const TYPE_AT: u32 = 11;
}

/// EPTISR, and the same bits of EPTICR, EPTIMR, EPTIER.
mod eptisr {
    pub(super) const TXINI: u32 = 1;
    pub(super) const RXOUTI: u32 = 1 << 1;
    pub(super) const RXSTPI: u32 = 1 << 2;
    pub(super) const NAKOUTI: u32 = 1 << 3;
    pub(super) const NAKINI: u32 = 1 << 4;
    pub(super) const STALLEDI: u32 = 1 << 6;
    pub(super) const SHORT_PACKET: u32 = 1 << 7;
    pub(super) const FLAGS: u32 = 0xff;
    pub(super) const DATA1: u32 = 1 << 8;
    pub(super) const BUSY_BANKS_AT: u32 = 12;
    pub(super) const READ_WRITE_ALLOWED: u32 = 1 << 16;
    pub(super) const CONTROL_IN: u32 = 1 << 17;
    pub(super) const CONFIGURED: u32 = 1 << 18;
    pub(super) const BYTE_COUNT_AT: u32 = 20;
}

/// EPTIMR: what is no mask.
mod eptimr {
    pub(super) const KILL_BANK: u32 = 1 << 13;
    pub(super) const FIFO_CONTROL: u32 = 1 << 14;
    pub(super) const RESET_TOGGLE: u32 = 1 << 18;
    pub(super) const STALL_REQUEST: u32 = 1 << 19;
    pub(super) const MASKS: u32 = 0x10ff;
}

/// CTRL.
mod ctrl {
    pub(super) const VBUS_INTERRUPT: u32 = 1 << 1;
    pub(super) const PADS: u32 = 1 << 12;
    pub(super) const FROZEN: u32 = 1 << 14;
    pub(super) const ENABLE: u32 = 1 << 15;
    pub(super) const DEVICE_MODE: u32 = 1 << 25;
    pub(super) const AT_RESET: u32 = 0x0300_4000;
}

/// SR.
mod sr {
    pub(super) const VBUS_CHANGED: u32 = 1 << 1;
    pub(super) const ID: u32 = 1 << 10;
    pub(super) const VBUS: u32 = 1 << 11;
    pub(super) const CLOCK_USABLE: u32 = 1 << 14;
}

#[derive(Clone, Debug, Default)]
struct UsbEndpoint {
    config: u32,
    enabled: bool,
    /// Flags that events set: SETUP, NAKs, STALL, short packet; of endpoint 0 also TXINI and RXOUTI.
    flags: u32,
    masks: u32,
    stalls: bool,
    /// The toggle of the next packet to the PC, and of the one that is expected from it.
    in_data1: bool,
    out_data1: bool,
    control_in: bool,
    /// The bank that the program fills or empties.
    bank: VecDeque<u8>,
    /// Banks to the PC that are full, or banks from it that wait behind `bank`.
    full: VecDeque<Vec<u8>>,
    /// The program has the bank: it fills it, or has not freed it (FIFOCON).
    is_open: bool,
}

impl UsbEndpoint {
    fn is_control(&self) -> bool {
        self.config >> eptcfg::TYPE_AT & 3 == 0
    }

    fn is_in(&self) -> bool {
        self.config & eptcfg::IN != 0
    }

    fn is_configured(&self) -> bool {
        self.config & eptcfg::ALLOCATED != 0
    }

    /// Bytes of a bank.
    fn size(&self) -> usize {
        8 << (self.config >> 4 & 7)
    }

    fn banks(&self) -> usize {
        1 + (self.config >> 2 & 3) as usize
    }

    /// Empties all banks. The toggles stay.
    fn empty(&mut self) {
        self.flags = 0;
        self.bank.clear();
        self.full.clear();
        self.is_open = false;
        self.stalls = false;
        self.open_bank();
    }

    /// Gives the program the next bank if it has none: an empty one to the PC, or a full one from it.
    fn open_bank(&mut self) {
        if !self.enabled || !self.is_configured() {
            return;
        }
        if self.is_control() {
            if self.full.is_empty() && self.flags & (eptisr::RXSTPI | eptisr::RXOUTI) == 0 {
                self.flags |= eptisr::TXINI;
            }
        } else if !self.is_open && self.is_in() && self.full.len() < self.banks() {
            self.is_open = true;
            self.flags |= eptisr::TXINI;
        } else if !self.is_open
            && !self.is_in()
            && let Some(data) = self.full.pop_front()
        {
            self.is_open = true;
            self.flags |= eptisr::RXOUTI | if data.len() < self.size() { eptisr::SHORT_PACKET } else { 0 };
            self.bank = data.into();
        }
    }

    fn status(&self) -> u32 {
        let when = |condition, bit| if condition { bit } else { 0 };
        let busy = self.full.len() + usize::from(self.is_open && !self.is_in() && !self.is_control());
        let may = match (self.is_control() || self.is_open, self.is_in()) {
            (false, _) => false,
            (_, true) => self.bank.len() < self.size(),
            _ => !self.bank.is_empty(),
        };
        self.flags
            | when(if self.is_in() { self.in_data1 } else { self.out_data1 }, eptisr::DATA1)
            | (busy as u32) << eptisr::BUSY_BANKS_AT
            | when(may, eptisr::READ_WRITE_ALLOWED)
            | when(self.control_in, eptisr::CONTROL_IN)
            | when(self.is_configured(), eptisr::CONFIGURED)
            | (self.bank.len() as u32) << eptisr::BYTE_COUNT_AT
    }

    fn mask(&self) -> u32 {
        let when = |condition, bit| if condition { bit } else { 0 };
        self.masks | when(self.is_open, eptimr::FIFO_CONTROL) | when(self.stalls, eptimr::STALL_REQUEST)
    }

    fn interrupts(&self) -> bool {
        self.flags & self.masks & eptisr::FLAGS != 0
    }

    /// EPTICR: clears flags. On endpoint 0 that also sends the bank, or frees it.
    fn clear(&mut self, value: u32) {
        let cleared = value & self.flags;
        self.flags &= !value;
        if self.is_control() {
            if cleared & eptisr::TXINI != 0 {
                self.full.push_back(self.bank.drain(..).collect());
            }
            if cleared & (eptisr::RXSTPI | eptisr::RXOUTI) != 0 {
                self.bank.clear();
            }
        }
        self.open_bank();
    }

    /// EPTIER: masks, and requests.
    fn enable(&mut self, value: u32) {
        self.masks |= value & eptimr::MASKS;
        self.stalls |= value & eptimr::STALL_REQUEST != 0;
        if value & eptimr::RESET_TOGGLE != 0 {
            (self.in_data1, self.out_data1) = (false, false);
        }
        if value & eptimr::KILL_BANK != 0 && self.is_in() {
            self.full.pop_back();
            self.open_bank();
        }
    }

    /// EPTIDR: masks; FIFOCON gives the bank back.
    fn disable(&mut self, value: u32) {
        self.masks &= !value;
        self.stalls &= value & eptimr::STALL_REQUEST == 0;
        if value & eptimr::FIFO_CONTROL != 0 && self.is_open {
            self.is_open = false;
            let data: Vec<u8> = self.bank.drain(..).collect();
            if self.is_in() {
                self.full.push_back(data);
            }
            self.open_bank();
        }
    }
}

/// The controller.
#[derive(Clone)]
pub(super) struct Uotghs {
    control: u32,
    device_control: u32,
    flags: u32,
    masks: u32,
    status: u32,
    endpoints: [UsbEndpoint; ENDPOINTS],
    /// The frame whose start the program has acknowledged.
    frame_seen: u32,
    powered: bool,
    /// Whether it has its clocks: the peripheral's, and the UTMI's PLL.
    clocked: bool,
}

impl Uotghs {
    pub(super) fn new() -> Uotghs {
        Uotghs {
            control: ctrl::AT_RESET,
            device_control: devctrl::DETACH,
            flags: 0,
            masks: 0,
            status: 0,
            endpoints: Default::default(),
            frame_seen: 0,
            powered: false,
            clocked: false,
        }
    }

    fn is_on(&self) -> bool {
        self.control & (ctrl::ENABLE | ctrl::FROZEN) == ctrl::ENABLE && self.clocked
    }

    fn endpoint(&mut self, offset: u32, base: u32) -> &mut UsbEndpoint {
        &mut self.endpoints[((offset - base) as usize / 4).min(ENDPOINTS - 1)]
    }

    /// DEVISR. `frame` is the number of the present frame, if there is one.
    fn interrupt_status(&self, frame: Option<u32>) -> u32 {
        let endpoints = self.endpoints.iter().enumerate().filter(|(_, endpoint)| endpoint.interrupts());
        let begun = frame.is_some_and(|frame| frame != self.frame_seen);
        endpoints.fold(self.flags, |all, (number, _)| all | 1 << (devisr::ENDPOINTS_AT + number))
            | if begun { devisr::FRAME } else { 0 }
    }

    pub(super) fn interrupts(&self, frame: Option<u32>) -> bool {
        self.interrupt_status(frame) & self.masks != 0
            || self.status & self.control & ctrl::VBUS_INTERRUPT & sr::VBUS_CHANGED != 0
    }

    fn read(&mut self, offset: u32, frame: Option<u32>) -> u32 {
        match offset {
            at::DEVCTRL => self.device_control,
            at::DEVISR => self.interrupt_status(frame),
            at::DEVIMR => self.masks,
            at::DEVEPT => {
                let enabled = self.endpoints.iter().enumerate().filter(|(_, endpoint)| endpoint.enabled);
                enabled.fold(0, |all, (number, _)| all | 1 << number)
            }
            at::DEVFNUM => frame.unwrap_or(0) << 3,
            at::EPTCFG..at::EPTISR => self.endpoint(offset, at::EPTCFG).config,
            at::EPTISR..at::EPTICR => self.endpoint(offset, at::EPTISR).status(),
            at::EPTIMR..at::EPTIER => self.endpoint(offset, at::EPTIMR).mask(),
            at::CTRL => self.control,
            at::SR => {
                let when = |condition, bit| if condition { bit } else { 0 };
                self.status
                    | sr::ID
                    | when(self.powered, sr::VBUS)
                    | when(self.clocked && self.control & ctrl::ENABLE != 0, sr::CLOCK_USABLE)
            }
            _ => 0,
        }
    }

    fn write(&mut self, offset: u32, value: u32, frame: Option<u32>) {
        match offset {
            at::CTRL => {
                self.control = value & 0x0370_f1ff;
                if value & ctrl::ENABLE == 0 {
                    // Switched off, it is reset (§39).
                    let Uotghs { control, status, powered, clocked, .. } = *self;
                    *self = Uotghs { control, status, powered, clocked, ..Uotghs::new() };
                }
            }
            at::SCR => self.status &= !value,
            at::SFR => self.status |= value & 0xff,
            // Without its clock nothing else can be written.
            _ if !self.is_on() => {}
            at::DEVCTRL => self.device_control = value & devctrl::STORED,
            at::DEVICR => {
                self.flags &= !(value & devisr::FLAGS);
                if value & devisr::FRAME != 0 {
                    self.frame_seen = frame.unwrap_or(self.frame_seen);
                }
            }
            at::DEVIFR => self.flags |= value & devisr::FLAGS,
            at::DEVIDR => self.masks &= !value,
            at::DEVIER => self.masks |= value,
            at::DEVEPT => {
                for (number, endpoint) in self.endpoints.iter_mut().enumerate() {
                    let (enabled, resets) = (value >> number & 1 != 0, value >> (16 + number) & 1 != 0);
                    let begins = enabled && !endpoint.enabled;
                    endpoint.enabled = enabled;
                    if resets || begins || !enabled {
                        endpoint.empty();
                    }
                }
            }
            at::EPTCFG..at::EPTISR => {
                let endpoint = self.endpoint(offset, at::EPTCFG);
                endpoint.config = value & 0x7ffe;
                endpoint.empty();
            }
            at::EPTICR..at::EPTIFR => self.endpoint(offset, at::EPTICR).clear(value & eptisr::FLAGS),
            at::EPTIFR..at::EPTIMR => self.endpoint(offset, at::EPTIFR).flags |= value & eptisr::FLAGS,
            at::EPTIER..at::EPTIDR => self.endpoint(offset, at::EPTIER).enable(value),
            at::EPTIDR..at::EPT_END => self.endpoint(offset, at::EPTIDR).disable(value),
            _ => {}
        }
    }

    /// Reads the bank of an endpoint, at any address of its window: each access takes the next bytes (§39).
    fn read_fifo(&mut self, number: usize, size: Size) -> u32 {
        let Some(endpoint) = self.endpoints.get_mut(number) else { return 0 };
        (0..size.bytes()).fold(0, |value, at| value | u32::from(endpoint.bank.pop_front().unwrap_or(0)) << (8 * at))
    }

    fn write_fifo(&mut self, number: usize, size: Size, value: u32) {
        let Some(endpoint) = self.endpoints.get_mut(number) else { return };
        for byte in value.to_le_bytes().into_iter().take(size.bytes() as usize) {
            if endpoint.bank.len() < endpoint.size() {
                endpoint.bank.push_back(byte);
            }
        }
    }

    fn set_clock(&mut self, clocked: bool) {
        self.clocked = clocked;
    }

    fn of(&self, number: u8) -> Option<&UsbEndpoint> {
        self.endpoints.get(usize::from(number)).filter(|endpoint| endpoint.enabled && endpoint.is_configured())
    }
}

impl UsbDevice for Uotghs {
    fn set_power(&mut self, powered: bool) {
        if powered != self.powered {
            self.powered = powered;
            self.status |= sr::VBUS_CHANGED;
        }
    }

    fn is_attached(&self) -> bool {
        let wanted = ctrl::PADS | ctrl::DEVICE_MODE;
        self.is_on() && self.control & wanted == wanted && self.powered && self.device_control & devctrl::DETACH == 0
    }

    /// The address is gone, and all endpoints but the first are disabled (§39).
    fn bus_reset(&mut self) {
        self.device_control &= !(devctrl::ADDRESS | devctrl::ADDRESS_ON);
        self.flags |= devisr::WAKE_UP;
        self.flags &= !devisr::SUSPEND;
        for (number, endpoint) in self.endpoints.iter_mut().enumerate() {
            endpoint.enabled &= number == 0;
            (endpoint.in_data1, endpoint.out_data1) = (false, false);
            endpoint.empty();
        }
    }

    fn bus_reset_ends(&mut self) {
        self.flags |= devisr::RESET_ENDED;
    }

    fn suspend(&mut self) {
        self.flags |= devisr::SUSPEND;
        self.flags &= !devisr::WAKE_UP;
    }

    /// Until the address is switched on it is 0 (§39).
    fn has_address(&self, address: u8) -> bool {
        let own =
            if self.device_control & devctrl::ADDRESS_ON != 0 { self.device_control & devctrl::ADDRESS } else { 0 };
        self.is_attached() && own == u32::from(address)
    }

    fn answer(&self, number: u8, direction: Direction) -> Answer {
        let Some(endpoint) = self.of(number) else { return Answer::Refused };
        let is_in = direction == Direction::In;
        if !endpoint.is_control() && endpoint.is_in() != is_in {
            return Answer::Refused;
        }
        if endpoint.stalls {
            return Answer::Stall;
        }
        if is_in {
            return match endpoint.full.front() {
                Some(data) => Answer::Ready { bytes: data.len() as u32 },
                None => Answer::Refused,
            };
        }
        let has_space = if endpoint.is_control() {
            endpoint.flags & (eptisr::RXSTPI | eptisr::RXOUTI) == 0
        } else {
            endpoint.full.len() + usize::from(endpoint.is_open) < endpoint.banks()
        };
        if has_space { Answer::Ready { bytes: endpoint.size() as u32 } } else { Answer::Refused }
    }

    fn refused(&mut self, number: u8, direction: Direction, stall: bool) {
        let Some(endpoint) = self.endpoints.get_mut(usize::from(number)) else { return };
        endpoint.flags |= match (stall, direction) {
            (true, _) => eptisr::STALLEDI,
            (_, Direction::In) => eptisr::NAKINI,
            _ => eptisr::NAKOUTI,
        };
    }

    /// A SETUP ends a stall, and what was under way (§39).
    fn setup(&mut self, packet: [u8; 8]) {
        let endpoint = &mut self.endpoints[0];
        endpoint.stalls = false;
        endpoint.full.clear();
        endpoint.bank = packet.into();
        endpoint.flags = endpoint.flags & !(eptisr::TXINI | eptisr::RXOUTI) | eptisr::RXSTPI;
        (endpoint.in_data1, endpoint.out_data1) = (true, true);
        endpoint.control_in = packet[0] & 0x80 != 0;
    }

    fn take(&mut self, number: u8) -> (bool, Vec<u8>) {
        let endpoint = &mut self.endpoints[usize::from(number).min(ENDPOINTS - 1)];
        let data = endpoint.full.pop_front().unwrap_or_default();
        let data1 = endpoint.in_data1;
        endpoint.in_data1 = !data1;
        endpoint.open_bank();
        (data1, data)
    }

    fn put(&mut self, number: u8, data1: bool, data: &[u8]) {
        let endpoint = &mut self.endpoints[usize::from(number).min(ENDPOINTS - 1)];
        if data1 != endpoint.out_data1 {
            return;
        }
        endpoint.out_data1 = !data1;
        if endpoint.is_control() {
            endpoint.bank = data.to_vec().into();
            endpoint.flags = endpoint.flags & !eptisr::TXINI | eptisr::RXOUTI;
            return;
        }
        endpoint.full.push_back(data.to_vec());
        endpoint.open_bank();
    }

    fn wants_frames(&self, frame: u32) -> bool {
        self.masks & devisr::FRAME != 0 && self.frame_seen == frame
    }
}

/// The controller with its cable.
pub(super) type Usb = UsbLink<Uotghs>;

impl Usb {
    /// Resets the controller. The PC sees that the device has gone.
    pub(super) fn reset(&mut self, cycle: u64) {
        let powered = self.device.powered;
        self.device = Uotghs { powered, ..Uotghs::new() };
        self.plan(cycle);
    }

    /// Sets whether the controller has its clocks.
    pub(super) fn set_clocked(&mut self, clocked: bool, cycle: u64) {
        if clocked != self.device.clocked {
            self.device.set_clock(clocked);
            self.plan(cycle);
        }
    }

    pub(super) fn line_asserted(&self) -> bool {
        self.device.interrupts(self.frame())
    }

    pub(super) fn read(&mut self, offset: u32, cycle: u64) -> u32 {
        let frame = self.frame_in(cycle);
        self.device.read(offset, frame)
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, cycle: u64) {
        let frame = self.frame_in(cycle);
        self.device.write(offset, value, frame);
        self.plan(cycle + 1);
    }

    /// Reads the banks, at an offset from the first window; each endpoint has one of 32 KiB.
    pub(super) fn read_fifo(&mut self, offset: u32, size: Size) -> u32 {
        self.device.read_fifo((offset >> 15) as usize, size)
    }

    pub(super) fn write_fifo(&mut self, offset: u32, size: Size, value: u32) {
        self.device.write_fifo((offset >> 15) as usize, size, value);
    }
}
