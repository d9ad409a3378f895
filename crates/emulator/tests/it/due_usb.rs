//! The Due's native USB: the controller (Atmel-11057C §39) with a PC at the other end, and a serial port as a firmware
//! implements it on the bare registers, by polling.

use crate::usb_device::{CONFIGURATION, DEVICE, LANGUAGES, MAKER};
use pulsetrain_emulator::arm::Size;
use pulsetrain_emulator::{Observer, Sam3x8e, Sam3x8eTiming, UsbState};
use std::collections::VecDeque;

const PMC: u32 = 0x400e_0600;
const UOTGHS: u32 = 0x400a_c000;
const DEVCTRL: u32 = UOTGHS;
const DEVISR: u32 = UOTGHS + 0x04;
const DEVICR: u32 = UOTGHS + 0x08;
const DEVIER: u32 = UOTGHS + 0x18;
const DEVEPT: u32 = UOTGHS + 0x1c;
const DEVFNUM: u32 = UOTGHS + 0x20;
const CTRL: u32 = UOTGHS + 0x800;
const SR: u32 = UOTGHS + 0x804;
const BANKS: u32 = 0x2018_0000;

/// Registers of an endpoint.
const fn config(endpoint: u32) -> u32 {
    UOTGHS + 0x100 + 4 * endpoint
}
const fn status(endpoint: u32) -> u32 {
    UOTGHS + 0x130 + 4 * endpoint
}
const fn clear(endpoint: u32) -> u32 {
    UOTGHS + 0x160 + 4 * endpoint
}
const fn enable(endpoint: u32) -> u32 {
    UOTGHS + 0x1f0 + 4 * endpoint
}
const fn disable(endpoint: u32) -> u32 {
    UOTGHS + 0x220 + 4 * endpoint
}

const TXINI: u32 = 1;
const RXOUTI: u32 = 1 << 1;
const RXSTPI: u32 = 1 << 2;
const FIFOCON: u32 = 1 << 14;
const STALLRQ: u32 = 1 << 19;
const RSTDT: u32 = 1 << 18;

/// Endpoints: notifications, data from the PC, data to it.
const NOTIFY: u32 = 1;
const OUT: u32 = 2;
const IN: u32 = 3;
const PACKET: usize = 64;

/// Cycles of a millisecond at 84 MHz, and how often the firmware looks.
const MS: u64 = 84_000;
const LOOK: u64 = 200;

#[derive(Default)]
struct Seen(Vec<u8>);

impl Observer for Seen {
    fn usb(&mut self, _: u64, data: &[u8]) {
        self.0.extend(data);
    }
}

/// A chip at 84 MHz with its firmware.
struct Desk {
    chip: Sam3x8e,
    seen: Seen,
    configuration: Vec<u8>,
    /// What is to be sent on endpoint 0, and the address that holds after it.
    answer: Option<Vec<u8>>,
    address: Option<u32>,
    line_state: u32,
    received: Vec<u8>,
    outgoing: VecDeque<u8>,
    requests: Vec<u32>,
}

impl Desk {
    fn new() -> Desk {
        // wfi; b to it.
        let mut image: Vec<u8> = [0x2008_8000u32, 0x0008_0009, 0xe7fd_bf30].map(u32::to_le_bytes).concat();
        image.resize(64, 0);
        let chip = Sam3x8e::new(&image, Sam3x8eTiming::LIKELY).expect("it fits");
        let mut configuration = CONFIGURATION.to_vec();
        // An endpoint of this controller has one direction.
        let last = configuration.len() - 5;
        configuration[last] = 0x80 | IN as u8;
        let mut desk = Desk {
            chip,
            seen: Seen::default(),
            configuration,
            answer: None,
            address: None,
            line_state: 0,
            received: Vec::new(),
            outgoing: VecDeque::new(),
            requests: Vec::new(),
        };
        desk.set(0x400e_1a54, 1 << 15); // the watchdog
        desk.set(PMC + 0x20, 0x0137_0809);
        desk.wait(PMC + 0x68, 0);
        desk.set(PMC + 0x28, 0x200d_3f01);
        desk.wait(PMC + 0x68, 1);
        desk.set(PMC + 0x30, 0x12);
        desk.run(10);
        assert_eq!(desk.chip.clock_hz(), 84_000_000);
        desk.chip.usb_plug(true);
        desk
    }

    fn set(&mut self, address: u32, value: u32) {
        self.chip.write(address, value, &mut self.seen);
    }

    fn get(&mut self, address: u32) -> u32 {
        self.chip.read(address, &mut self.seen)
    }

    fn run(&mut self, cycles: u64) {
        self.chip.run(self.chip.cycle() + cycles, &mut self.seen);
    }

    fn wait(&mut self, address: u32, bit: u32) {
        let end = self.chip.cycle() + 10_000_000;
        while self.get(address) >> bit & 1 == 0 {
            assert!(self.chip.cycle() < end, "{address:#x}");
            self.run(10);
        }
    }

    /// Switches the controller and its clocks on, and attaches.
    fn start(&mut self) {
        self.set(PMC + 0x1c, 1 << 16 | 3 << 20);
        self.wait(PMC + 0x68, 6);
        self.set(PMC + 0x100, 1 << 8);
        self.set(CTRL, 1 << 25 | 1 << 15 | 1 << 12);
        self.wait(SR, 14);
        self.set(DEVCTRL, 3 << 10);
    }

    fn begin_endpoint(&mut self, endpoint: u32, value: u32) {
        self.set(config(endpoint), value | 1 << 1);
        let enabled = self.get(DEVEPT);
        self.set(DEVEPT, enabled | 1 << endpoint);
        assert_eq!(self.get(status(endpoint)) >> 18 & 1, 1, "CFGOK");
    }

    /// Whole words by words, and what is left by bytes; the address within a window does not matter.
    fn write_bank(&mut self, endpoint: u32, bytes: &[u8]) {
        let window = BANKS + 0x8000 * endpoint;
        for part in bytes.chunks(4) {
            match *part {
                [a, b, c, d] => self.set(window, u32::from_le_bytes([a, b, c, d])),
                _ => part.iter().for_each(|byte| {
                    self.chip.write_part(window + 1, Size::Byte, (*byte).into(), &mut self.seen);
                }),
            }
        }
    }

    fn read_bank(&mut self, endpoint: u32) -> Vec<u8> {
        let count = (self.get(status(endpoint)) >> 20 & 0x7ff) as usize;
        let words = (0..count.div_ceil(4)).map(|_| self.get(BANKS + 0x8000 * endpoint)).collect::<Vec<_>>();
        words.into_iter().flat_map(u32::to_le_bytes).take(count).collect()
    }

    /// What the firmware does again and again.
    fn poll(&mut self) {
        let flags = self.get(DEVISR);
        if flags & 1 << 3 != 0 {
            self.set(DEVICR, 1 << 3);
            // Endpoint 0: control, 64 bytes, one bank.
            self.begin_endpoint(0, 3 << 4);
            self.set(enable(0), RXSTPI | RXOUTI);
            self.set(DEVIER, 1 << 12);
            (self.answer, self.address) = (None, None);
        }
        let state = self.get(status(0));
        if state & RXSTPI != 0 {
            self.setup();
        } else if state & RXOUTI != 0 {
            // The PC's data, or its empty packet.
            let data = self.read_bank(0);
            self.set(clear(0), RXOUTI);
            if !data.is_empty() {
                self.set(clear(0), TXINI);
            }
        } else if state & TXINI != 0 {
            if let Some(rest) = self.answer.take() {
                let (packet, rest) = rest.split_at(rest.len().min(PACKET));
                self.write_bank(0, packet);
                self.set(clear(0), TXINI);
                self.answer = (!rest.is_empty()).then(|| rest.to_vec());
            } else if let Some(address) = self.address.take() {
                let kept = self.get(DEVCTRL) & !0xff;
                self.set(DEVCTRL, kept | address | 1 << 7);
            }
        }
        if self.get(DEVEPT) >> OUT & 1 == 0 {
            return;
        }
        if self.get(status(OUT)) & RXOUTI != 0 {
            self.set(clear(OUT), RXOUTI);
            let data = self.read_bank(OUT);
            self.received.extend(data);
            self.set(disable(OUT), FIFOCON);
        }
        if !self.outgoing.is_empty() && self.get(status(IN)) & TXINI != 0 {
            self.set(clear(IN), TXINI);
            let count = self.outgoing.len().min(PACKET);
            let packet: Vec<u8> = self.outgoing.drain(..count).collect();
            self.write_bank(IN, &packet);
            self.set(disable(IN), FIFOCON);
        }
    }

    fn setup(&mut self) {
        let packet = self.read_bank(0);
        assert_eq!(packet.len(), 8);
        let word = |at: usize| u16::from_le_bytes([packet[at], packet[at + 1]]);
        let (request, value, length) = (word(0), word(2), usize::from(word(6)));
        self.requests.push(u32::from(value) << 16 | u32::from(request));
        self.set(clear(0), RXSTPI);
        let descriptor: Option<Vec<u8>> = match (request, value) {
            (0x0680, 0x0100) => Some(DEVICE.to_vec()),
            (0x0680, 0x0200) => Some(self.configuration.clone()),
            (0x0680, 0x0300) => Some(LANGUAGES.to_vec()),
            (0x0680, 0x0301) => Some(MAKER.to_vec()),
            _ => None,
        };
        match (request, descriptor) {
            (_, Some(mut descriptor)) => {
                descriptor.truncate(length);
                self.answer = Some(descriptor);
            }
            (0x0500, _) => {
                self.address = Some(value.into());
                self.set(clear(0), TXINI);
            }
            (0x0900, _) => {
                self.begin_endpoint(NOTIFY, 3 << 11 | 1 << 8);
                self.begin_endpoint(OUT, 2 << 11 | 3 << 4 | 1 << 2);
                self.begin_endpoint(IN, 2 << 11 | 3 << 4 | 1 << 2 | 1 << 8);
                self.set(clear(0), TXINI);
            }
            // Data follow.
            (0x2021, _) => {}
            (0x2221, _) => {
                self.line_state = value.into();
                self.set(clear(0), TXINI);
            }
            // Halts.
            (0x0302 | 0x0102, _) => {
                let endpoint = u32::from(packet[4] & 15);
                let (register, bits) =
                    if request == 0x0302 { (enable(endpoint), STALLRQ) } else { (disable(endpoint), STALLRQ) };
                self.set(register, bits);
                if request == 0x0102 {
                    self.set(enable(endpoint), RSTDT);
                }
                self.set(clear(0), TXINI);
            }
            _ => self.set(enable(0), STALLRQ),
        }
    }

    fn until(&mut self, most: u64, so: impl Fn(&Desk) -> bool) {
        let end = self.chip.cycle() + most;
        while !so(self) {
            assert!(self.chip.cycle() < end, "{:?} {:x?}", self.chip.usb_state(), self.requests);
            self.run(LOOK);
            self.poll();
        }
    }

    /// With the port open.
    fn open() -> Desk {
        let mut desk = Desk::new();
        desk.chip.usb_open(true);
        desk.start();
        desk.until(300 * MS, |desk| desk.chip.usb_state() == UsbState::Open);
        desk
    }
}

/// The same PC as the Pico's: the times of USB 2.0, the order of Linux.
#[test]
fn enumeration() {
    let mut desk = Desk::new();
    desk.run(50 * MS);
    assert_eq!(desk.chip.usb_state(), UsbState::Detached);
    desk.start();
    let start = desk.chip.cycle();
    assert_eq!(desk.chip.usb_state(), UsbState::Enumerating);
    desk.until(300 * MS, |desk| desk.chip.usb_state() == UsbState::Configured);
    let took = desk.chip.cycle() - start;
    assert!((222 * MS..226 * MS).contains(&took), "{took}");
    assert_eq!(desk.requests.first(), Some(&0x0100_0680));
    assert_eq!(desk.get(DEVCTRL) & 0xff, 0x81);
    assert_eq!(desk.chip.usb_text(1), Some("PT".into()));
    desk.chip.usb_open(true);
    desk.until(5 * MS, |desk| desk.chip.usb_state() == UsbState::Open);
    assert_eq!(desk.line_state, 3);
    desk.chip.usb_open(false);
    desk.until(5 * MS, |desk| desk.chip.usb_state() == UsbState::Configured);

    // Detached by the program; and without its PLL.
    desk.set(DEVCTRL, 3 << 10 | 1 << 8);
    desk.run(10);
    assert_eq!(desk.chip.usb_state(), UsbState::Detached);
    desk.set(DEVCTRL, 3 << 10);
    desk.run(10);
    assert_eq!(desk.chip.usb_state(), UsbState::Enumerating);
    desk.set(PMC + 0x1c, 0);
    desk.run(10);
    assert_eq!(desk.chip.usb_state(), UsbState::Detached);
}

/// Bytes both ways at once come as they were sent; both banks of an endpoint are used.
#[test]
fn bytes_both_ways() {
    let mut desk = Desk::open();
    let to_device: Vec<u8> = (0..5000_u32).map(|at| (at.wrapping_mul(0x9e37_79b1) >> 24) as u8).collect();
    let to_pc: Vec<u8> = to_device.iter().map(|byte| byte ^ 0x5a).collect();
    desk.chip.usb_send(&to_device);
    desk.outgoing = to_pc.clone().into();
    let began = desk.chip.cycle();
    desk.until(100 * MS, |desk| desk.received.len() == 5000 && desk.seen.0.len() == 5000);
    assert!(desk.received == to_device && desk.seen.0 == to_pc);
    // 10 000 bytes at about 17 packets of 64 in a frame.
    let frames = (desk.chip.cycle() - began) / MS;
    assert!((8..14).contains(&frames), "{frames} ms");
    assert!(desk.get(DEVFNUM) >> 3 > 200);
}

/// A PC that does not read: the banks stay full, and nothing is lost. A program that does not read: the PC waits.
#[test]
fn back_pressure() {
    let mut desk = Desk::open();
    desk.chip.usb_fill(true);
    desk.outgoing = vec![7; 1000].into();
    let end = desk.chip.cycle() + 10 * MS;
    desk.until(20 * MS, |desk| desk.chip.cycle() > end);
    assert_eq!((desk.seen.0.len(), desk.outgoing.len()), (0, 1000 - 128), "two banks");
    assert_eq!(desk.get(status(IN)) >> 12 & 3, 2, "both are busy");
    desk.chip.usb_fill(false);
    desk.until(10 * MS, |desk| desk.seen.0.len() == 1000);

    desk.chip.usb_send(&[9; 1000]);
    desk.run(10 * MS);
    assert_eq!(desk.chip.usb_backlog(), 1000 - 128);
    desk.until(10 * MS, |desk| desk.received.len() == 1000);
}

/// Halted endpoints move nothing, and begin with DATA0 when they are cleared; a bus reset forgets the address.
#[test]
fn halts_and_resets() {
    let mut desk = Desk::open();
    desk.chip.usb_send(&[1; 64]);
    desk.until(5 * MS, |desk| desk.received.len() == 64);
    desk.chip.usb_halt(OUT as u8);
    let requests = desk.requests.len();
    desk.until(5 * MS, |desk| desk.requests.len() > requests);
    desk.chip.usb_send(&[2; 64]);
    let end = desk.chip.cycle() + 5 * MS;
    desk.until(10 * MS, |desk| desk.chip.cycle() > end);
    assert_eq!(desk.received.len(), 64);
    assert_ne!(desk.get(status(OUT)) & 1 << 6, 0, "STALLEDI");
    desk.chip.usb_clear_halt(OUT as u8);
    desk.until(5 * MS, |desk| desk.received.len() == 128);

    desk.chip.usb_plug(false);
    desk.run(5 * MS);
    assert_eq!((desk.chip.usb_state(), desk.get(DEVISR) & 1), (UsbState::Detached, 1), "suspended");
    desk.chip.usb_plug(true);
    desk.run(101 * MS);
    assert_eq!(desk.get(DEVCTRL) & 0xff, 0, "the reset of the bus");
    assert_eq!(desk.get(DEVISR) & 1 << 3, 0);
    desk.run(50 * MS);
    assert_eq!(desk.get(DEVISR) & 1 << 3, 1 << 3, "EORST at its end");
    desk.until(300 * MS, |desk| desk.chip.usb_state() == UsbState::Open);

    // A reset of the chip detaches.
    desk.set(0x400e_1a00, 0xa500_0005);
    desk.run(100);
    assert_eq!(desk.chip.usb_state(), UsbState::Detached);
}
