//! A USB serial port as a firmware implements it, on the bare registers of the RP2040 (datasheet §4.1), without waiting
//! and without interrupts. The tests and the comparison with another emulator run this code.
#![allow(dead_code, reason = "each user takes its part")]

/// How registers and memory are reached.
pub(crate) trait Access {
    fn read(&mut self, address: u32) -> u32;
    fn write(&mut self, address: u32, value: u32);
}

pub(crate) const DPRAM: u32 = 0x5010_0000;
pub(crate) const REGISTERS: u32 = 0x5011_0000;
pub(crate) const ADDR_ENDP: u32 = REGISTERS;
pub(crate) const MAIN_CTRL: u32 = REGISTERS + 0x40;
pub(crate) const SOF_RD: u32 = REGISTERS + 0x48;
pub(crate) const SIE_CTRL: u32 = REGISTERS + 0x4c;
pub(crate) const SIE_STATUS: u32 = REGISTERS + 0x50;
pub(crate) const BUFF_STATUS: u32 = REGISTERS + 0x58;
pub(crate) const EP_STALL_ARM: u32 = REGISTERS + 0x68;
pub(crate) const EP_STATUS_STALL_NAK: u32 = REGISTERS + 0x70;
pub(crate) const USB_MUXING: u32 = REGISTERS + 0x74;
pub(crate) const USB_PWR: u32 = REGISTERS + 0x78;
pub(crate) const INTR: u32 = REGISTERS + 0x8c;
pub(crate) const INTE: u32 = REGISTERS + 0x90;
pub(crate) const INTS: u32 = REGISTERS + 0x98;

pub(crate) const BUS_RESET: u32 = 1 << 19;
pub(crate) const SETUP: u32 = 1 << 17;

/// Bits of a buffer's control.
pub(crate) const AVAILABLE: u32 = 1 << 10;
pub(crate) const STALL: u32 = 1 << 11;
pub(crate) const DATA1: u32 = 1 << 13;
pub(crate) const FULL: u32 = 1 << 15;

/// Endpoints: notifications to the PC, data to the PC, data from it.
pub(crate) const NOTIFY: u32 = 1;
pub(crate) const DATA: u32 = 2;

pub(crate) const fn control(endpoint: u32, out: bool) -> u32 {
    DPRAM + 8 * endpoint + 4 * out as u32
}

pub(crate) const fn buffer_control(endpoint: u32, out: bool) -> u32 {
    DPRAM + 0x80 + 8 * endpoint + 4 * out as u32
}

/// An endpoint's bit in BUFF_STATUS.
pub(crate) const fn bit(endpoint: u32, out: bool) -> u32 {
    1 << (2 * endpoint + out as u32)
}

/// Where buffers are in DPRAM.
pub(crate) const EP0_BUFFER: u32 = 0x100;
pub(crate) const OUT_BUFFER: u32 = 0x180;
pub(crate) const IN_BUFFER: u32 = 0x200;
const NOTIFY_BUFFER: u32 = 0x280;

const PACKET: usize = 64;
const ENABLE: u32 = 1 << 31;
const INTERRUPT_EACH: u32 = 1 << 29;

pub(crate) const DEVICE: [u8; 18] = [18, 1, 0, 2, 2, 0, 0, 64, 0x09, 0x12, 0x01, 0x00, 0x00, 0x01, 1, 2, 0, 1];

/// Communication and data interface of a modem (CDC 1.2 §5), 75 bytes: more than a packet.
#[rustfmt::skip]
pub(crate) const CONFIGURATION: [u8; 75] = [
    9, 2, 75, 0, 2, 1, 0, 0x80, 50,
    8, 11, 0, 2, 2, 2, 1, 0,
    9, 4, 0, 0, 1, 2, 2, 1, 0,
    5, 0x24, 0, 0x10, 0x01,
    5, 0x24, 1, 0, 1,
    4, 0x24, 2, 2,
    5, 0x24, 6, 0, 1,
    7, 5, 0x80 | NOTIFY as u8, 3, 8, 0, 16,
    9, 4, 1, 0, 2, 10, 0, 0, 0,
    7, 5, DATA as u8, 2, 64, 0, 0,
    7, 5, 0x80 | DATA as u8, 2, 64, 0, 0,
];
pub(crate) const LANGUAGES: [u8; 4] = [4, 3, 9, 4];
pub(crate) const MAKER: [u8; 6] = [6, 3, b'P', 0, b'T', 0];

/// What a control transfer is about to do.
#[derive(Clone, Copy, PartialEq)]
enum Stage {
    Idle,
    /// Sends the rest of `data`.
    Send,
    /// Waits for the PC's empty packet, or its data.
    Take,
    /// Sends an empty packet.
    Acknowledge,
}

pub(crate) struct Device {
    stage: Stage,
    data: &'static [u8],
    /// An address that holds from the end of the transfer on.
    address: Option<u32>,
    data1: bool,
    in_data1: bool,
    out_data1: bool,
    /// Bits of data endpoints that are done and not yet seen to.
    done: u32,
    pub(crate) configured: bool,
    pub(crate) configuration: &'static [u8],
    /// DTR and RTS.
    pub(crate) line_state: u8,
    /// The first bytes of requests, the newest first.
    pub(crate) requests: [u32; 16],
}

impl Device {
    pub(crate) const fn new() -> Device {
        Device {
            stage: Stage::Idle,
            data: &[],
            address: None,
            data1: false,
            in_data1: false,
            out_data1: false,
            done: 0,
            configured: false,
            configuration: &CONFIGURATION,
            line_state: 0,
            requests: [0; 16],
        }
    }

    /// Switches the controller on, and its pull-up.
    pub(crate) fn start(&mut self, chip: &mut impl Access) {
        for offset in (0..0x100).step_by(4) {
            chip.write(DPRAM + offset, 0);
        }
        chip.write(USB_MUXING, 1 << 3 | 1);
        chip.write(USB_PWR, 1 << 3 | 1 << 2);
        chip.write(MAIN_CTRL, 1);
        // A flag for each buffer of endpoint 0; the pull-up.
        chip.write(SIE_CTRL, 1 << 29);
        chip.write(INTE, 1 << 4 | 1 << 12 | 1 << 16);
        chip.write(SIE_CTRL, 1 << 29 | 1 << 16);
    }

    /// Does what the PC asks for. To be called again and again.
    pub(crate) fn poll(&mut self, chip: &mut impl Access) {
        if chip.read(INTS) == 0 {
            return;
        }
        let status = chip.read(SIE_STATUS);
        if status & BUS_RESET != 0 {
            chip.write(SIE_STATUS, BUS_RESET);
            chip.write(ADDR_ENDP, 0);
            self.stage = Stage::Idle;
            self.address = None;
            self.configured = false;
        }
        if status & SETUP != 0 {
            chip.write(SIE_STATUS, SETUP);
            self.setup(chip);
        }
        let done = chip.read(BUFF_STATUS);
        if done != 0 {
            chip.write(BUFF_STATUS, done);
            self.done |= done & !3;
            if done & 3 != 0 {
                self.control_done(chip);
            }
        }
    }

    fn setup(&mut self, chip: &mut impl Access) {
        let (first, second) = (chip.read(DPRAM), chip.read(DPRAM + 4));
        self.requests.rotate_right(1);
        self.requests[0] = first;
        let (request, value, length) = (first & 0xffff, first >> 16, (second >> 16) as usize);
        self.data1 = true;
        let descriptor: Option<&'static [u8]> = match (request, value) {
            (0x0680, 0x0100) => Some(&DEVICE),
            (0x0680, 0x0200) => Some(self.configuration),
            (0x0680, 0x0300) => Some(&LANGUAGES),
            (0x0680, 0x0301) => Some(&MAKER),
            _ => None,
        };
        match (request, descriptor) {
            (_, Some(descriptor)) => {
                self.data = &descriptor[..descriptor.len().min(length)];
                self.stage = Stage::Send;
                self.send_control(chip);
            }
            (0x0500, _) => {
                self.address = Some(value);
                self.acknowledge(chip);
            }
            (0x0900, _) => {
                self.configure(chip);
                self.acknowledge(chip);
            }
            (0x2021, _) => self.take_control(chip),
            (0x2221, _) => {
                self.line_state = value as u8;
                self.acknowledge(chip);
            }
            _ => {
                // Not here: both directions stall.
                chip.write(EP_STALL_ARM, 3);
                chip.write(buffer_control(0, false), STALL);
                chip.write(buffer_control(0, true), STALL);
                self.stage = Stage::Idle;
            }
        }
    }

    fn configure(&mut self, chip: &mut impl Access) {
        chip.write(control(NOTIFY, false), ENABLE | INTERRUPT_EACH | 3 << 26 | NOTIFY_BUFFER);
        chip.write(control(DATA, false), ENABLE | INTERRUPT_EACH | 2 << 26 | IN_BUFFER);
        chip.write(control(DATA, true), ENABLE | INTERRUPT_EACH | 2 << 26 | OUT_BUFFER);
        (self.in_data1, self.out_data1) = (false, false);
        // The buffer to the PC is free.
        self.done = bit(DATA, false);
        self.listen(chip);
        self.configured = true;
    }

    fn control_done(&mut self, chip: &mut impl Access) {
        match self.stage {
            Stage::Send if !self.data.is_empty() => self.send_control(chip),
            Stage::Send => self.take_control(chip),
            Stage::Take if chip.read(DPRAM) & 0xff == 0x21 => self.acknowledge(chip),
            Stage::Acknowledge => {
                if let Some(address) = self.address.take() {
                    chip.write(ADDR_ENDP, address);
                }
                self.stage = Stage::Idle;
            }
            _ => self.stage = Stage::Idle,
        }
    }

    fn send_control(&mut self, chip: &mut impl Access) {
        let (packet, rest) = self.data.split_at(self.data.len().min(PACKET));
        self.data = rest;
        fill(chip, EP0_BUFFER, packet);
        let toggle = if self.data1 { DATA1 } else { 0 };
        self.data1 = !self.data1;
        arm(chip, 0, false, packet.len() as u32 | toggle | FULL);
    }

    fn take_control(&mut self, chip: &mut impl Access) {
        self.stage = Stage::Take;
        arm(chip, 0, true, PACKET as u32 | DATA1);
    }

    fn acknowledge(&mut self, chip: &mut impl Access) {
        self.stage = Stage::Acknowledge;
        arm(chip, 0, false, DATA1 | FULL);
    }

    fn listen(&mut self, chip: &mut impl Access) {
        let toggle = if self.out_data1 { DATA1 } else { 0 };
        self.out_data1 = !self.out_data1;
        arm(chip, DATA, true, PACKET as u32 | toggle);
    }

    /// Sends up to 64 bytes, if the last ones have gone.
    pub(crate) fn send(&mut self, chip: &mut impl Access, bytes: &[u8]) -> bool {
        if self.done & bit(DATA, false) == 0 {
            return false;
        }
        self.done &= !bit(DATA, false);
        fill(chip, IN_BUFFER, bytes);
        let toggle = if self.in_data1 { DATA1 } else { 0 };
        self.in_data1 = !self.in_data1;
        arm(chip, DATA, false, bytes.len() as u32 | toggle | FULL);
        true
    }

    /// What has come, if something has; the buffer is then free again.
    pub(crate) fn receive(&mut self, chip: &mut impl Access, into: &mut [u8; PACKET]) -> Option<usize> {
        if self.done & bit(DATA, true) == 0 {
            return None;
        }
        self.done &= !bit(DATA, true);
        let length = (chip.read(buffer_control(DATA, true)) & 0x3ff) as usize;
        for (at, bytes) in (0..).step_by(4).zip(into.chunks_mut(4)) {
            bytes.copy_from_slice(&chip.read(DPRAM + OUT_BUFFER + at).to_le_bytes());
        }
        self.listen(chip);
        Some(length)
    }
}

pub(crate) fn fill(chip: &mut impl Access, buffer: u32, bytes: &[u8]) {
    for (at, bytes) in (0..).step_by(4).zip(bytes.chunks(4)) {
        let word = bytes.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
        chip.write(DPRAM + buffer + at, word);
    }
}

/// AVAILABLE comes after the other bits (§4.1.2.5.1).
pub(crate) fn arm(chip: &mut impl Access, endpoint: u32, out: bool, bits: u32) {
    chip.write(buffer_control(endpoint, out), bits);
    chip.write(buffer_control(endpoint, out), bits | AVAILABLE);
}
