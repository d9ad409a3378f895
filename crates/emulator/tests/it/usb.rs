//! USB: the controller (RP2040 datasheet §4.1) with a PC at the other end (USB 2.0; CDC 1.2).

use crate::pico::{Bench, SET};
use crate::usb_device::*;
use proptest::prelude::*;
use pulsetrain_emulator::UsbState;

/// Cycles of a millisecond at 125 MHz.
const MS: u64 = 125_000;
/// How often the firmware looks.
const LOOK: u64 = 250;

impl Access for Bench {
    fn read(&mut self, address: u32) -> u32 {
        self.get(address)
    }

    fn write(&mut self, address: u32, value: u32) {
        self.set(address, value);
    }
}

/// A chip at 125 MHz with a PC plugged in, and its firmware.
struct Desk {
    bench: Bench,
    device: Device,
}

impl Desk {
    fn new() -> Desk {
        let mut bench = Bench::new();
        // Crystal; PLL 12 MHz x 125 / 6 / 2; clk_ref, clk_sys.
        bench.set(0x4002_4000, 0x00fa_baa0);
        bench.run(20_000);
        for (address, value) in [(0x4002_8000, 1), (0x4002_8008, 125), (0x4002_8004, 0), (0x4002_800c, 0x0006_2000)] {
            bench.set(address, value);
        }
        bench.run(20_000);
        for (address, value) in [(0x4000_8030, 2), (0x4000_803c, 1)] {
            bench.set(address, value);
        }
        bench.run(100);
        assert_eq!(bench.chip.clock_hz(), 125_000_000);
        bench.chip.usb_plug(true);
        Desk { bench, device: Device::new() }
    }

    /// With the port open.
    fn open() -> Desk {
        let mut desk = Desk::new();
        desk.bench.chip.usb_open(true);
        desk.device.start(&mut desk.bench);
        desk.until(300 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Open);
        desk
    }

    /// Runs the firmware until something is so.
    fn until(&mut self, most: u64, so: impl Fn(&Desk) -> bool) {
        let end = self.bench.now() + most;
        while !so(self) {
            assert!(self.bench.now() < end, "{:?} {:x?}", self.bench.chip.usb_state(), self.device.requests);
            self.bench.run(LOOK);
            self.device.poll(&mut self.bench);
        }
    }

    fn received(&self) -> Vec<u8> {
        self.bench.seen.packets.iter().flat_map(|(_, data)| data).copied().collect()
    }
}

/// The PC waits as long as USB 2.0 asks, and asks in the order of Linux (§9.1.2).
#[test]
fn enumeration() {
    let mut desk = Desk::new();
    desk.bench.run(50 * MS);
    assert_eq!(desk.bench.chip.usb_state(), UsbState::Detached);
    desk.device.start(&mut desk.bench);
    let start = desk.bench.now();
    assert_eq!(desk.bench.chip.usb_state(), UsbState::Enumerating);
    desk.bench.run(100 * MS - 1);
    assert_eq!(desk.bench.get(SIE_STATUS) & BUS_RESET, 0, "debouncing");
    desk.bench.run(3);
    assert_eq!(desk.bench.get(SIE_STATUS) & BUS_RESET, BUS_RESET);
    assert_eq!(desk.bench.get(INTS), 1 << 12);
    desk.until(300 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Configured);
    let took = desk.bench.now() - start;
    assert!((222 * MS..226 * MS).contains(&took), "100 + 50 + 10 + 50 + 10 + 2 ms and a few transfers: {took}");
    // Last first: configuration, strings 2 (refused), 1 and 0, configuration whole and in part, device, address, a look.
    let requests = [
        0x0001_0900,
        0x0302_0680,
        0x0301_0680,
        0x0300_0680,
        0x0200_0680,
        0x0200_0680,
        0x0100_0680,
        0x0001_0500,
        0x0100_0680,
        0,
    ];
    assert_eq!(desk.device.requests[..10], requests);
    assert_eq!((desk.device.configured, desk.device.line_state), (true, 0));
    assert_eq!(desk.bench.get(ADDR_ENDP), 1);

    desk.bench.chip.usb_open(true);
    desk.until(5 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Open);
    assert_eq!((desk.device.requests[1] & 0xffff, desk.device.line_state), (0x2021, 3));
    assert_eq!(desk.bench.get(DPRAM + EP0_BUFFER), 115_200, "the line coding's speed");
    desk.bench.chip.usb_open(false);
    desk.until(5 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Configured);
    assert_eq!(desk.device.line_state, 0);
}

/// Bytes both ways at once, in packets of all sizes, come as they were sent.
#[test]
fn bytes_both_ways() {
    let mut desk = Desk::open();
    let to_device: Vec<u8> = (0..5000_u32).map(|at| (at.wrapping_mul(0x9e37_79b1) >> 24) as u8).collect();
    let to_pc: Vec<u8> = to_device.iter().map(|byte| byte ^ 0x5a).collect();
    let (mut got, mut sent, mut size) = (Vec::<u8>::new(), 0, 0);
    let mut packet = [0; 64];
    let mut offered = 0;
    while got.len() < to_device.len() || desk.received().len() < to_pc.len() {
        assert!(desk.bench.now() < 2000 * MS);
        if desk.bench.chip.usb_backlog() < 100 && offered < to_device.len() {
            let end = to_device.len().min(offered + 1 + offered % 137);
            desk.bench.chip.usb_send(&to_device[offered..end]);
            offered = end;
        }
        desk.bench.run(LOOK);
        desk.device.poll(&mut desk.bench);
        if let Some(length) = desk.device.receive(&mut desk.bench, &mut packet) {
            got.extend(&packet[..length]);
        }
        let end = to_pc.len().min(sent + size % 65);
        if desk.device.send(&mut desk.bench, &to_pc[sent..end]) {
            (sent, size) = (end, size + 1);
        }
    }
    assert!(got == to_device, "to the device");
    assert!(desk.received() == to_pc, "to the PC");
}

/// Table 5-9: 19 transfers of 64 bytes in a frame, 1 216 000 bytes a second, if the device has its next packet ready.
#[test]
fn full_speed_to_the_pc() {
    let mut desk = Desk::open();
    let bench = &mut desk.bench;
    // Two buffers.
    bench.set(control(DATA, false), 1 << 31 | 1 << 30 | 1 << 29 | 2 << 26 | IN_BUFFER);
    for number in 0..32 {
        bench.set(DPRAM + IN_BUFFER + 4 * number, number);
    }
    let full = 64 | FULL | AVAILABLE;
    bench.set(buffer_control(DATA, false), (full | DATA1) << 16 | full);
    bench.run(MS);
    let start = bench.now();
    bench.seen.packets.clear();
    while bench.now() < start + 50 * MS {
        bench.run(LOOK);
        while bench.get(BUFF_STATUS) & bit(DATA, false) != 0 {
            bench.set(BUFF_STATUS, bit(DATA, false));
        }
        // What was sent is filled again; each buffer keeps its toggle.
        let done = bench.get(buffer_control(DATA, false));
        let first = if done & AVAILABLE == 0 { full } else { done & 0xffff };
        let second = if done >> 16 & AVAILABLE == 0 { full | DATA1 } else { done >> 16 };
        bench.set(buffer_control(DATA, false), second << 16 | first);
    }
    let packets = &bench.seen.packets;
    assert!((50 * 19 - 1..=50 * 19).contains(&packets.len()), "{}", packets.len());
    for (at, (_, data)) in packets.iter().enumerate() {
        let buffer = packets[0].1[0] as usize ^ (16 * (at % 2));
        assert_eq!((data.len(), data[0] as usize), (64, buffer), "packet {at}");
    }
    // 616 bit times apart, whole within a frame.
    let gaps: Vec<u64> = packets[20..].windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let within = (616 * MS).div_ceil(12_000);
    assert!(gaps.iter().filter(|gap| **gap == within).count() >= 48 * 18, "{gaps:?}");
    let sums: Vec<u64> = gaps.windows(19).map(|gaps| gaps.iter().sum()).collect();
    assert!(sums.iter().all(|sum| *sum == MS), "{sums:?}");
}

/// The PC sends 17 packets in a frame, because it also asks for data in between. A device with one buffer that polls
/// every 2 µs takes 9: a packet that the device refuses is still sent to its end.
#[test]
fn full_speed_from_the_pc() {
    let mut desk = Desk::open();
    desk.bench.chip.usb_send(&[7; 64 * 500]);
    let mut packet = [0; 64];
    let start = desk.bench.now();
    let mut taken = 0;
    while desk.bench.now() < start + 10 * MS {
        desk.bench.run(LOOK);
        desk.device.poll(&mut desk.bench);
        taken += desk.device.receive(&mut desk.bench, &mut packet).unwrap_or(0);
    }
    assert_eq!(taken / 64, 10 * 9);

    let mut desk = Desk::open();
    let bench = &mut desk.bench;
    bench.set(control(DATA, true), 1 << 31 | 1 << 30 | 1 << 29 | 2 << 26 | OUT_BUFFER);
    bench.set(buffer_control(DATA, true), (64 | AVAILABLE | DATA1) << 16 | 64 | AVAILABLE);
    bench.chip.usb_send(&[7; 64 * 1000]);
    let (start, mut taken) = (bench.now(), 0);
    while bench.now() < start + 40 * MS {
        bench.run(LOOK);
        let done = bench.get(buffer_control(DATA, true));
        let mut again = done;
        for (shift, toggle) in [(0, 0), (16, DATA1)] {
            if done >> shift & FULL != 0 {
                assert_eq!(done >> shift & 0x3ff, 64);
                again = again & !(0xffff << shift) | (64 | AVAILABLE | toggle) << shift;
                taken += 1;
            }
        }
        bench.set(buffer_control(DATA, true), again);
    }
    assert!((40 * 17 - 1..=40 * 17).contains(&taken), "{taken}");
}

/// Data toggles: the PC drops a packet that it has had; the device drops one that it has had and flags it.
#[test]
fn toggles() {
    let mut desk = Desk::open();
    assert!(desk.device.send(&mut desk.bench, b"one"));
    desk.until(2 * MS, |desk| desk.bench.seen.packets.len() == 1);
    fill(&mut desk.bench, IN_BUFFER, b"again");
    arm(&mut desk.bench, DATA, false, 5 | FULL);
    desk.bench.run(MS);
    assert_eq!(desk.bench.get(buffer_control(DATA, false)) & (AVAILABLE | FULL), 0, "it was acknowledged");
    assert_eq!(desk.bench.seen.packets.len(), 1);
    fill(&mut desk.bench, IN_BUFFER, b"two");
    arm(&mut desk.bench, DATA, false, 3 | FULL | DATA1);
    desk.bench.run(MS);
    assert_eq!(desk.received(), b"onetwo");

    arm(&mut desk.bench, DATA, true, 64 | DATA1);
    desk.bench.chip.usb_send(b"x");
    desk.bench.run(MS);
    assert_eq!(desk.bench.get(SIE_STATUS) >> 31, 1);
    assert_eq!(desk.bench.get(buffer_control(DATA, true)) & (AVAILABLE | FULL), AVAILABLE, "still armed");
    desk.bench.set(SIE_STATUS, 1 << 31);
    assert_eq!(desk.bench.get(SIE_STATUS) >> 31, 0);
}

/// A device that is not ready refuses: nothing is lost, and the PC comes back at once when it is.
#[test]
fn refusal() {
    let mut desk = Desk::open();
    let nak = 1 << 16;
    let control_in = desk.bench.get(control(DATA, false));
    desk.bench.set(control(DATA, false), control_in | nak);
    desk.bench.run(MS);
    assert_eq!(desk.bench.get(EP_STATUS_STALL_NAK), bit(DATA, false), "INTERRUPT_ON_NAK");
    desk.bench.set(EP_STATUS_STALL_NAK, bit(DATA, false));
    desk.bench.set(control(DATA, false), control_in);
    for wait in [0, 1, 777, 12_345, 125_000, 1_000_001] {
        desk.bench.run(wait);
        desk.bench.seen.packets.clear();
        let armed = desk.bench.now();
        assert!(desk.device.send(&mut desk.bench, &[1; 8]));
        desk.until(2 * MS, |desk| !desk.bench.seen.packets.is_empty());
        let late = desk.bench.seen.packets[0].0 - armed;
        // Its 21 bytes; a poll of 8 bytes that has just begun; perhaps the end and start of a frame.
        let bytes = |bytes: u64| (bytes * 8 * MS).div_ceil(12_000);
        assert!((bytes(21)..=bytes(21 + 8 + 21 + 5) + 3).contains(&late), "{late} after {wait}");
    }
}

/// A required request that is refused is the end until the cable is pulled; one that is never answered too, after 5 s.
#[test]
fn failure() {
    let mut desk = Desk::new();
    desk.device.start(&mut desk.bench);
    desk.bench.run(4000 * MS);
    assert_eq!(desk.bench.chip.usb_state(), UsbState::Enumerating, "nobody answers the first look");
    desk.bench.run(2000 * MS);
    assert_eq!(desk.bench.chip.usb_state(), UsbState::Failed);
    desk.bench.chip.usb_plug(false);
    desk.bench.chip.usb_plug(true);
    desk.until(300 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Configured);

    desk.bench.chip.usb_plug(false);
    desk.bench.chip.usb_plug(true);
    desk.bench.run(165 * MS);
    assert_eq!(desk.bench.get(SIE_STATUS) & SETUP, 0, "a reset of the bus leaves the old address to the firmware");
    desk.bench.set(ADDR_ENDP, 0);
    desk.bench.run(MS);
    assert_eq!(desk.bench.get(SIE_STATUS) & SETUP, SETUP);
    desk.bench.set(SIE_STATUS, SETUP | BUS_RESET);
    desk.bench.set(EP_STALL_ARM, 3);
    desk.bench.set(buffer_control(0, false), STALL);
    desk.bench.run(MS);
    assert_eq!(desk.bench.chip.usb_state(), UsbState::Failed);
}

/// Descriptors that cannot be: the PC gives up, and does not ask for ever; without endpoints there is no port to open.
#[test]
fn odd_descriptors() {
    let cases: [(&'static [u8], UsbState); 4] = [
        (&[9, 2, 9, 0, 0, 1, 0, 0x80, 50], UsbState::Failed),
        (&[8, 2, 75, 0, 0, 1, 0, 0x80], UsbState::Failed),
        (&[], UsbState::Failed),
        (&[9, 2, 12, 0, 0, 1, 0, 0x80, 50, 0, 4, 200], UsbState::Open),
    ];
    for (configuration, state) in cases {
        let mut desk = Desk::new();
        desk.device.configuration = configuration;
        desk.bench.chip.usb_open(true);
        desk.device.start(&mut desk.bench);
        desk.until(300 * MS, |desk| desk.bench.chip.usb_state() == state);
        desk.bench.chip.usb_send(b"to nobody");
        desk.bench.run(5 * MS);
        assert_eq!((desk.bench.chip.usb_state(), desk.bench.chip.usb_backlog()), (state, 9));
    }
}

/// §4.1.4: SOF_RD has the frame's number; its interrupt goes when that is read.
#[test]
fn frames() {
    let mut desk = Desk::open();
    let bench = &mut desk.bench;
    let first = bench.get(SOF_RD);
    for passed in 1..3000 {
        bench.run(MS);
        assert_eq!(bench.get(SOF_RD), (first + passed) & 0x7ff);
    }
    bench.set(INTE + SET, 1 << 17);
    let mut starts = Vec::new();
    for _ in 0..5000 {
        bench.run(100);
        if bench.get(INTS) & 1 << 17 != 0 {
            starts.push(bench.now());
            bench.get(SOF_RD);
            assert_eq!(bench.get(INTS) & 1 << 17, 0);
        }
    }
    assert_eq!(starts.len(), 4);
    assert!(starts.windows(2).all(|pair| pair[1].abs_diff(pair[0] + MS) <= 100), "{starts:?}");
}

/// Without a cable the bus is suspended after 3 ms (USB 2.0 §7.1.7.6). After plugging in, enumeration starts from the
/// beginning.
#[test]
fn unplugged() {
    let mut desk = Desk::open();
    desk.bench.chip.usb_send(b"lost");
    desk.bench.chip.usb_plug(false);
    assert_eq!((desk.bench.chip.usb_state(), desk.bench.chip.usb_backlog()), (UsbState::Detached, 0));
    desk.bench.run(3 * MS - 1);
    assert_eq!(desk.bench.get(INTR) & 1 << 14, 0);
    desk.bench.run(2);
    assert_eq!(desk.bench.get(INTR) & 1 << 14, 1 << 14);
    desk.bench.set(SIE_STATUS, 1 << 4);
    assert_eq!(desk.bench.get(INTR) & 1 << 14, 0);
    desk.bench.run(20 * MS);
    desk.bench.chip.usb_plug(true);
    desk.until(300 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Open);
    assert!(desk.device.send(&mut desk.bench, b"here"));
    desk.until(2 * MS, |desk| desk.received() == b"here");
}

/// An hour of an open port on which nothing is said: polls that are refused are not played.
#[test]
fn silence_costs_nothing() {
    let mut desk = Desk::open();
    for _ in 0..36 {
        desk.bench.run(100_000 * MS);
    }
    assert_eq!(desk.bench.chip.usb_state(), UsbState::Open);
    assert!(desk.device.send(&mut desk.bench, b"!"));
    desk.until(2 * MS, |desk| desk.received() == b"!");
}

/// The controller's interrupt is line 5 (§2.3.2), and its registers and memory are in reset with bit 24.
#[test]
fn interrupt_and_reset() {
    // The vector table, the program (NVIC_ISER: line 5; wfi), its handler, constants.
    let mut words = [0_u32; 64];
    words[0] = 0x2004_2000;
    words[1] = 0x1000_0181;
    words[16 + 5] = 0x1000_0189;
    words[32] = 0x2120_4803; // ldr r0, [pc, #12]; movs r1, #32
    words[33] = 0xbf30_6001; // str r1, [r0]; wfi
    words[34] = 0x3201_4a02; // ldr r2, [pc, #8]; adds r2, #1
    words[35] = 0xe7fe_4693; // mov r11, r2; b .
    words[36] = 0xe000_e100;
    words[37] = 41;
    let mut image = vec![0; 0x100];
    image.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    let mut chip = pulsetrain_emulator::Rp2040::new(&image).expect("it fits");
    chip.run(200, &mut ());
    assert!(chip.is_asleep());
    chip.write(0x4000_c000, 0, &mut ());
    chip.write(SIE_CTRL, 0x1234, &mut ());
    chip.write(DPRAM, 0x5678, &mut ());
    chip.write(REGISTERS + 0x94, 1 << 16, &mut ());
    chip.run(400, &mut ());
    assert_eq!(chip.cpu().register(11), 42, "INTF");
    assert_eq!((chip.read(SIE_CTRL, &mut ()), chip.read(DPRAM, &mut ())), (0x1234, 0x5678));
    chip.write(0x4000_c000 + SET, 1 << 24, &mut ());
    chip.run(410, &mut ());
    assert_eq!((chip.read(SIE_CTRL, &mut ()), chip.read(DPRAM, &mut ())), (0, 0));
    chip.write(0x4000_c000, 0, &mut ());
    chip.run(420, &mut ());
    assert_eq!((chip.read(SIE_CTRL, &mut ()), chip.read(DPRAM, &mut ())), (0, 0x5678), "memory stays");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever the firmware writes, the PC goes on, or gives up; and all is well after the cable was out.
    #[test]
    fn any_firmware(writes in prop::collection::vec((any::<bool>(), 0_u32..64, any::<u32>(), 0_u64..200_000), 100)) {
        let mut desk = Desk::open();
        desk.bench.chip.usb_send(&[1; 500]);
        for (memory, word, value, wait) in writes {
            desk.bench.set(if memory { DPRAM + 4 * word } else { REGISTERS + 4 * (word % 40) }, value);
            desk.bench.run(wait);
            desk.bench.get(BUFF_STATUS);
            desk.device.poll(&mut desk.bench);
        }
        desk.bench.chip.usb_plug(false);
        desk.bench.run(MS);
        // Its registers as after a reset.
        desk.bench.set(0x4000_c000 + SET, 1 << 24);
        desk.bench.run(1);
        desk.bench.set(0x4000_c000, 0);
        desk.bench.run(1);
        desk.device = Device::new();
        desk.device.start(&mut desk.bench);
        desk.bench.chip.usb_plug(true);
        desk.until(400 * MS, |desk| desk.bench.chip.usb_state() == UsbState::Open);
    }
}
