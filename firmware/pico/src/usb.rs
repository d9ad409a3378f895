//! The USB device: a serial port (CDC 1.2) that every computer has a driver for. Without an interrupt: the main loop polls.
//!
//! Bytes from the host lie in two buffers of a packet each, so that the host sends one while the other is being read; a
//! packet that finds no buffer free waits on the host's side. Bytes to the host go out when a packet is full, and at `flush`.
//! Sections are those of the RP2040 datasheet, tables those of USB 2.0.

use crate::clock::{Clock, TICK_HZ};
use crate::regs::{self, usb};
use crate::start::StaticCell;

/// Bytes of a packet, on each endpoint that has data.
const PACKET: usize = 64;

/// The words of one packet.
pub(crate) type Packet = [[u8; 4]; PACKET / 4];

/// Endpoints: notifications to the host, which never come, and the data in both directions.
const NOTIFY: u32 = 1;
const DATA: u32 = 2;

/// The bit in the address of an endpoint to the host.
const TO_HOST: u32 = 0x80;
const DATA_TO_HOST: u32 = TO_HOST | DATA;
const NOTIFY_TO_HOST: u32 = TO_HOST | NOTIFY;

/// Addresses of the endpoints that can be halted.
const HALT_ENDPOINTS: [u32; 3] = [DATA, DATA_TO_HOST, NOTIFY_TO_HOST];

/// Where packets are in the controller's memory (§4.1.2.4). That of endpoint 0 is fixed.
const CONTROL_BUFFER: u32 = 0x100;
const NOTIFY_BUFFER: u32 = 0x180;
const OUT_BUFFER: u32 = 0x200;
const IN_BUFFER: u32 = 0x280;

/// Erratum E15: after some errors of the bus while a packet goes to the host the controller hangs, most of all at the end of a
/// frame, where hubs cut off what is under way. So no packet is started in the last fifth of a frame, as in TinyUSB. Ticks from the
/// frame's start.
const LATEST_IN: u64 = (TICK_HZ / 1000 * 4 / 5) as u64;

/// The longest frame with the errors of both clocks, host's and board's (500 and 100 ppm, USB 2.0 §7.1.11), ticks.
const LONGEST_FRAME: u64 = (TICK_HZ / 1000 + TICK_HZ / 1000 * 6 / 10_000 + 1) as u64;
/// Frames are numbered modulo 2048.
const FRAME_MASK: u32 = 0x7ff;

/// Table 9-8. 1209:0001 is the number of pid.codes for tests: a plain serial port needs no driver that knows its number.
const fn device(serial: u8) -> [u8; 18] {
    [18, 1, 0, 2, 2, 0, 0, PACKET as u8, 0x09, 0x12, 0x01, 0x00, 0x00, 0x01, 1, PRODUCT, serial, 1]
}

static DEVICE: [u8; 18] = device(SERIAL);
static DEVICE_WITHOUT_SERIAL: [u8; 18] = device(0);

/// The numbers of the texts for the product and the serial number.
const PRODUCT: u8 = 2;
const SERIAL: u8 = 3;

/// Tables 9-10, 9-12, 9-13; CDC 1.2 §5.2.3: the port's interface, with the descriptors that drivers need, and that of its data.
#[rustfmt::skip]
const CONFIGURATION: [u8; 67] = [
    // 100 mA from the bus.
    9, 2, 67, 0, 2, 1, 0, 0x80, 50,
    9, 4, 0, 0, 1, 2, 2, 0, 0,
    5, 0x24, 0, 0x10, 0x01,
    5, 0x24, 1, 0, 1,
    4, 0x24, 2, 2,
    5, 0x24, 6, 0, 1,
    7, 5, 0x80 | NOTIFY as u8, 3, 8, 0, 255,
    9, 4, 1, 0, 2, 10, 0, 0, 0,
    7, 5, DATA as u8, 2, PACKET as u8, 0, 0,
    7, 5, 0x80 | DATA as u8, 2, PACKET as u8, 0, 0,
];

/// English; the maker; the product.
static TEXTS: [&[u8]; 3] = [&[4, 3, 0x09, 0x04], &text::<22>(b"Pulsetrain"), &text::<10>(b"Pico")];

/// The product, on a chip before revision B2. Erratum E5: a device on a hub that is busy may not see the end of the bus's reset,
/// and is never found then. What TinyUSB does against that takes GPIO 15 away for a while, and is not done here.
static OLD_PRODUCT: &[u8] = &text::<50>(b"Pico (before B2: see E5)");

/// Table 9-16: `letters` as a text of `N` bytes: two for its head, and two for each letter.
const fn text<const N: usize>(letters: &[u8]) -> [u8; N] {
    assert!(N == 2 + 2 * letters.len());
    let mut text = [0; N];
    (text[0], text[1]) = (N as u8, 3);
    let mut at = 0;
    while at < letters.len() {
        text[2 + 2 * at] = letters[at];
        at += 1;
    }
    text
}

/// The serial number as a text of USB's: 16 digits.
type SerialText = [u8; 34];

static SERIAL_TEXT: StaticCell<SerialText> = StaticCell::new([0; 34]);

/// Fills it with the unique number of the flash chip. `None` if there is none.
fn serial(text: &'static mut SerialText, id: Option<[u8; 8]>) -> Option<&'static SerialText> {
    let digits = id?.into_iter().flat_map(|byte| [byte >> 4, byte & 15]);
    (text[0], text[1]) = (text.len() as u8, 3);
    for (place, digit) in text[2..].chunks_exact_mut(2).zip(digits) {
        place[0] = if digit < 10 { b'0' + digit } else { b'A' - 10 + digit };
    }
    Some(text)
}

/// What the transfer on endpoint 0 waits for.
#[derive(Clone, Copy, PartialEq)]
enum ControlStage {
    Idle,
    /// The host takes a packet; then the rest.
    Send,
    /// The host's empty packet, or its data, which end the transfer or are followed by an empty one.
    Take {
        acknowledge: bool,
    },
    /// The host takes an empty packet.
    Acknowledge,
}

/// The device.
pub(crate) struct Usb {
    stage: ControlStage,
    /// The bytes that are still to be sent on endpoint 0, and whether the next packet is DATA1.
    rest: &'static [u8],
    data1: bool,
    /// The address that holds when the transfer is over.
    address: Option<u8>,
    /// The line coding that the host has set. It can be read back, and has no effect.
    line_coding: [u8; 7],
    configured: bool,
    /// Text 3, if there is one.
    serial: Option<&'static SerialText>,
    /// Endpoints that the host has halted, bit by [`HALT_ENDPOINTS`]; and the control of the packet that waited for the host then.
    halted: u8,
    kept: Option<u32>,
    /// A program has the port open, as far as its computer says; and whether it was opened since the last look.
    open: bool,
    opened: bool,
    /// The half that is read next.
    half: u32,
    /// The half whose packets are DATA0.
    data0_half: u32,
    /// Bytes of the packet to the host that is being filled, and whether it is DATA1.
    filled: usize,
    in_data1: bool,
    /// The last packet was full: without another the host does not know that it was the last.
    full: bool,
    /// The present frame's number, and the tick at which it began.
    frame: u32,
    frame_began: u64,
}

impl Usb {
    /// Switches the device on, so that a host finds it. clk_usb must be at 48 MHz. `id` is a number that no other board has.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn open(id: Option<[u8; 8]>) -> Usb {
        // SAFETY: the caller's promise.
        let text = unsafe { SERIAL_TEXT.take() };
        regs::RESETS_RESET.set(regs::reset::USBCTRL);
        regs::take_out_of_reset(regs::reset::USBCTRL);
        for word in 0..0x40 {
            usb::memory(4 * word).write(0);
        }
        // §4.1.4: connected to the pads; VBUS is taken as present, which nothing in this firmware reads (GPIO 24 would say it); as
        // a device.
        usb::MUXING.write(1 << 3 | 1);
        usb::PWR.write(1 << 3 | 1 << 2);
        usb::MAIN_CTRL.write(1);
        // Interrupts of frames, requests, resets and buffers: they wake the main loop, and have no handler. Then a flag for each
        // buffer of endpoint 0, and the pull-up.
        usb::INTE.write(1 << 17 | 1 << 16 | 1 << 12 | 1 << 4);
        usb::SIE_CTRL.write(1 << 29 | 1 << 16);
        Usb {
            stage: ControlStage::Idle,
            rest: &[],
            data1: false,
            address: None,
            line_coding: [0, 0xc2, 1, 0, 0, 0, 8],
            configured: false,
            serial: serial(text, id),
            halted: 0,
            kept: None,
            open: false,
            opened: false,
            half: 0,
            data0_half: 0,
            filled: 0,
            in_data1: false,
            full: false,
            frame: 0,
            frame_began: 0,
        }
    }

    /// Serves the host's requests.
    #[inline(always)]
    pub(crate) fn poll(&mut self, clock: &mut Clock) {
        if usb::INTS.read() != 0 {
            self.serve(clock.now());
        }
    }

    #[inline(never)]
    fn serve(&mut self, now: u64) {
        // Reading it clears its interrupt. A frame is noticed late, never early.
        let frame = usb::SOF_RD.read();
        let frames = frame.wrapping_sub(self.frame) & FRAME_MASK;
        if frames != 0 {
            self.frame = frame;
            self.frame_began = now.min(self.frame_began + u64::from(frames) * LONGEST_FRAME);
        }
        let status = usb::SIE_STATUS.read();
        if status & usb::BUS_RESET != 0 {
            usb::SIE_STATUS.write(usb::BUS_RESET);
            usb::BUFF_STATUS.write(u32::MAX);
            usb::ADDR_ENDP.write(0);
            (self.stage, self.address) = (ControlStage::Idle, None);
            (self.configured, self.open) = (false, false);
            // The frames that come are not related to those before.
            self.frame_began = now;
        }
        let done = usb::BUFF_STATUS.read() & 3;
        if done != 0 {
            usb::BUFF_STATUS.write(done);
            self.control_done();
        }
        if status & usb::SETUP != 0 {
            usb::SIE_STATUS.write(usb::SETUP);
            self.setup();
        }
    }

    /// Whether a program has the port open.
    pub(crate) const fn is_open(&self) -> bool {
        self.open
    }

    /// Notes that a program has it open: some do not set DTR, but send.
    pub(crate) const fn presume_open(&mut self) {
        self.open = true;
    }

    /// Whether it was opened since the last call.
    pub(crate) const fn was_opened(&mut self) -> bool {
        core::mem::replace(&mut self.opened, false)
    }

    /// The bytes of the next packet, if one came.
    ///
    /// Read word by word, as each access to the controller's memory takes the processor long.
    #[inline(always)]
    pub(crate) fn read<'a>(&mut self, into: &'a mut Packet) -> &'a [u8] {
        if !self.configured {
            return &[];
        }
        let control = usb::buffer_half(DATA, true, self.half);
        if control & usb::FULL == 0 {
            return &[];
        }
        let len = (control & usb::LEN) as usize;
        let buffer = OUT_BUFFER + PACKET as u32 * self.half;
        for (at, word) in (buffer..).step_by(4).zip(into.iter_mut()) {
            *word = usb::memory(at).read().to_le_bytes();
        }
        // Clears the flag that woke the main loop. It comes back if the other half is full, too.
        usb::BUFF_STATUS.write(1 << (2 * DATA + 1));
        self.free();
        into.as_flattened().get(..len).unwrap_or_default()
    }

    /// Gives the half that was read back to the controller; each half keeps its toggle. That of a halted endpoint waits.
    fn free(&mut self) {
        if self.is_halted(DATA) {
            usb::set_half(DATA, true, self.half, if self.half == 0 { usb::STALL } else { 0 });
        } else {
            self.arm(self.half);
        }
        self.half ^= 1;
    }

    /// Gives a half to the controller, for a packet from the host.
    fn arm(&self, half: u32) {
        let toggle = if half == self.data0_half { 0 } else { usb::DATA1 };
        usb::arm_half(DATA, true, half, PACKET as u32 | toggle);
    }

    /// Whether there is room for another byte to the host.
    #[inline(always)]
    pub(crate) fn can_send(&self) -> bool {
        self.filled < PACKET && self.is_free()
    }

    /// Whether the host has taken the last packet.
    #[inline(always)]
    fn is_free(&self) -> bool {
        self.configured && !self.is_halted(DATA_TO_HOST) && usb::buffer_half(DATA, false, 0) & usb::AVAILABLE == 0
    }

    /// Puts a byte into the packet to the host; see [`can_send`](Usb::can_send).
    #[inline(always)]
    pub(crate) fn send(&mut self, byte: u8) {
        usb::set_memory_byte(IN_BUFFER + self.filled as u32, byte);
        self.filled += 1;
    }

    /// Sends what is in the packet.
    #[inline(always)]
    pub(crate) fn flush(&mut self, clock: &mut Clock) {
        if (self.filled != 0 || self.full) && self.is_free() && clock.now() - self.frame_began < LATEST_IN {
            self.hand_over();
        }
    }

    fn hand_over(&mut self) {
        let toggle = if self.in_data1 { usb::DATA1 } else { 0 };
        self.in_data1 = !self.in_data1;
        usb::arm_half(DATA, false, 0, self.filled as u32 | toggle | usb::FULL);
        self.full = self.filled == PACKET;
        self.filled = 0;
    }

    /// Serves a request (table 9-2).
    fn setup(&mut self) {
        let (first, second) = (usb::memory(0).read(), usb::memory(4).read());
        let (value, length) = ((first >> 16) as u16, (second >> 16) as usize);
        let [index, kind] = value.to_le_bytes();
        self.data1 = true;
        // Buffers that are still armed for the request before must not be used for this one.
        usb::buffer_control(0, false).write(0);
        usb::buffer_control(0, true).write(0);
        let descriptor: Option<&'static [u8]> = match (first & 0xffff, kind) {
            (0x0680, 1) => Some(if self.serial.is_some() { &DEVICE } else { &DEVICE_WITHOUT_SERIAL }),
            (0x0680, 2) => Some(&CONFIGURATION),
            (0x0680, 3) if index == SERIAL => self.serial.map(|text| text.as_slice()),
            // §2.20.2: the revision is in the highest bits; 2 is B2.
            (0x0680, 3) if index == PRODUCT && regs::CHIP_ID.read() >> 28 < 2 => Some(OLD_PRODUCT),
            (0x0680, 3) => TEXTS.get(usize::from(index)).copied(),
            // GET_CONFIGURATION; GET_STATUS of device, interface, endpoint.
            (0x0880, _) => Some(if self.configured { &[1] } else { &[0] }),
            (0x0082, _) if self.is_halted(second & 0xffff) => Some(&[1, 0]),
            (0x0080..=0x0082, _) => Some(&[0, 0]),
            _ => None,
        };
        if let Some(descriptor) = descriptor {
            self.rest = &descriptor[..descriptor.len().min(length)];
            self.stage = ControlStage::Send;
            self.send_rest();
            return;
        }
        match first & 0xffff {
            // SET_ADDRESS.
            0x0500 => {
                self.address = Some(index);
                self.acknowledge();
            }
            // SET_CONFIGURATION: 1, or 0 for none.
            0x0900 if value <= 1 => {
                self.configure(value == 1);
                self.acknowledge();
            }
            // SET_LINE_CODING, GET_LINE_CODING, SET_CONTROL_LINE_STATE (CDC PSTN 1.2 §6.3.10 to §6.3.12).
            0x2021 if length == self.line_coding.len() => {
                self.stage = ControlStage::Take { acknowledge: true };
                usb::arm_half(0, true, 0, PACKET as u32 | usb::DATA1);
            }
            0x21a1 => {
                for (at, byte) in (0..).zip(self.line_coding) {
                    usb::set_memory_byte(CONTROL_BUFFER + at, byte);
                }
                self.rest = &[];
                self.stage = ControlStage::Send;
                usb::arm_half(0, false, 0, self.line_coding.len().min(length) as u32 | usb::DATA1 | usb::FULL);
            }
            // Bit 0 is DTR: whether a program has the port open. While it is closed bytes to the host wait.
            0x2221 => {
                let open = value & 1 != 0;
                self.opened = open && !self.open;
                self.open = open;
                self.acknowledge();
            }
            // CLEAR_FEATURE: an endpoint is not halted any more, and its toggle starts at DATA0; no other's does.
            0x0102 if value == 0 && self.clear_halt(second & 0xffff) => self.acknowledge(),
            // SET_FEATURE: an endpoint is halted.
            0x0302 if value == 0 && self.halt(second & 0xffff) => self.acknowledge(),
            // Any other request is not supported (§4.1.2.6.3): the host sees a stall and goes on.
            _ => {
                self.stage = ControlStage::Idle;
                usb::EP_STALL_ARM.write(3);
                usb::buffer_control(0, false).write(usb::STALL);
                usb::buffer_control(0, true).write(usb::STALL);
            }
        }
    }

    /// Whether the host has halted an endpoint, by its address.
    #[inline(always)]
    fn is_halted(&self, index: u32) -> bool {
        HALT_ENDPOINTS.iter().enumerate().any(|(bit, address)| *address == index && self.halted >> bit & 1 != 0)
    }

    fn set_halted(&mut self, index: u32, on: bool) {
        for (bit, _) in HALT_ENDPOINTS.iter().enumerate().filter(|(_, address)| **address == index) {
            self.halted = self.halted & !(1 << bit) | u8::from(on) << bit;
        }
    }

    /// Halts an endpoint, whose address is `index`: it stalls until it is cleared. Whether there is one. Bytes that came, or wait
    /// to be sent, are kept. Endpoint 0 is never halted, as USB 2.0 §9.4.5 allows.
    fn halt(&mut self, index: u32) -> bool {
        if !self.configured || !HALT_ENDPOINTS.contains(&index) {
            return false;
        }
        if self.is_halted(index) {
            return true;
        }
        self.set_halted(index, true);
        let out = index & TO_HOST == 0;
        let control = usb::buffer_control(index & 15, out);
        let was = control.read();
        if index == DATA_TO_HOST {
            self.kept = (was & usb::AVAILABLE != 0).then_some(was & (usb::LEN | usb::FULL));
        }
        // §4.1.2.5.3: one bit for both buffers. Packets that came and were not read yet are kept.
        let came = if out { was & !(usb::AVAILABLE | usb::AVAILABLE << 16) } else { 0 };
        control.write(came | usb::STALL);
        true
    }

    /// Has an endpoint, whose address is `index`, go on from DATA0. Whether there is one. Bytes that came, or wait to be sent, are
    /// kept; the host does not use the endpoint meanwhile.
    fn clear_halt(&mut self, index: u32) -> bool {
        let was_halted = self.is_halted(index);
        self.set_halted(index, false);
        match index {
            // The toggle of endpoint 0 starts again with each request.
            0 | TO_HOST => true,
            // Nothing is ever sent there.
            NOTIFY_TO_HOST => {
                usb::buffer_control(NOTIFY, false).write(0);
                true
            }
            DATA_TO_HOST if was_halted => {
                usb::buffer_control(DATA, false).write(0);
                let kept = self.kept.take();
                if let Some(control) = kept {
                    usb::arm_half(DATA, false, 0, control);
                }
                self.in_data1 = kept.is_some();
                true
            }
            DATA_TO_HOST if self.configured => {
                let control = usb::buffer_half(DATA, false, 0);
                let waits = control & usb::AVAILABLE != 0;
                if waits {
                    usb::buffer_control(DATA, false).write(0);
                    usb::arm_half(DATA, false, 0, control & (usb::LEN | usb::FULL));
                }
                self.in_data1 = waits;
                true
            }
            DATA if self.configured => {
                let [full, other] =
                    [self.half, self.half ^ 1].map(|half| usb::buffer_half(DATA, true, half) & usb::FULL != 0);
                // DATA0 is for the half that the host's next packet goes into.
                self.data0_half = if full && !other { self.half ^ 1 } else { self.half };
                for half in 0..2 {
                    let control = usb::buffer_half(DATA, true, half);
                    if was_halted && control & usb::STALL != 0 {
                        usb::set_half(DATA, true, half, control & !usb::STALL);
                    }
                    let is_free = if was_halted { control & usb::FULL == 0 } else { control & usb::AVAILABLE != 0 };
                    if is_free {
                        self.arm(half);
                    }
                }
                true
            }
            _ => false,
        }
    }

    fn control_done(&mut self) {
        match self.stage {
            ControlStage::Send if !self.rest.is_empty() => self.send_rest(),
            ControlStage::Send => {
                self.stage = ControlStage::Take { acknowledge: false };
                usb::arm_half(0, true, 0, PACKET as u32 | usb::DATA1);
            }
            ControlStage::Take { acknowledge: true } => {
                for (at, byte) in (0..).zip(&mut self.line_coding) {
                    *byte = usb::memory_byte(CONTROL_BUFFER + at);
                }
                self.acknowledge();
            }
            ControlStage::Acknowledge => {
                if let Some(address) = self.address.take() {
                    usb::ADDR_ENDP.write(address.into());
                }
                self.stage = ControlStage::Idle;
            }
            ControlStage::Take { .. } | ControlStage::Idle => self.stage = ControlStage::Idle,
        }
    }

    fn send_rest(&mut self) {
        let (packet, rest) = self.rest.split_at(self.rest.len().min(PACKET));
        self.rest = rest;
        for (at, byte) in (CONTROL_BUFFER..).zip(packet) {
            usb::set_memory_byte(at, *byte);
        }
        let toggle = if self.data1 { usb::DATA1 } else { 0 };
        self.data1 = !self.data1;
        usb::arm_half(0, false, 0, packet.len() as u32 | toggle | usb::FULL);
    }

    fn acknowledge(&mut self) {
        self.stage = ControlStage::Acknowledge;
        usb::arm_half(0, false, 0, usb::DATA1 | usb::FULL);
    }

    /// Sets the endpoints up as at the beginning, on or off.
    fn configure(&mut self, on: bool) {
        self.configured = on;
        (self.half, self.data0_half) = (0, 0);
        (self.halted, self.kept) = (0, None);
        (self.filled, self.in_data1, self.full) = (0, false, false);
        for (endpoint, out) in [(NOTIFY, false), (DATA, false), (DATA, true)] {
            usb::buffer_control(endpoint, out).write(usb::RESET_HALF);
        }
        // §4.1.2.5.2: enabled, interrupt or bulk, and where its buffer is; from the host with two buffers, each with its own flag.
        let enabled = if on { 1 << 31 } else { 0 };
        usb::endpoint_control(NOTIFY, false).write(enabled | 3 << 26 | NOTIFY_BUFFER);
        usb::endpoint_control(DATA, false).write(enabled | 2 << 26 | IN_BUFFER);
        usb::endpoint_control(DATA, true).write(enabled | 1 << 30 | 1 << 29 | 2 << 26 | OUT_BUFFER);
        if on {
            self.arm(0);
            self.arm(1);
        }
    }
}
