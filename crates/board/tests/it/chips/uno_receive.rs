//! The firmware's decoder of frames, in assembly, against `Decoder`: random and damaged lines, on the emulated chip.

use pulsetrain_board::virtual_uno;
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::{Decoder, Encoder, MAX_BODY, MAX_FRAME};
use pulsetrain_emulator::Atmega328p;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::lab::{SYMBOLS, address};

const PAGE: u16 = 0x100;
const PAGE_LEN: u16 = 128;
/// firmware/uno/src/engine/link/receive.rs has these.
const RECEIVER: u16 = 0x500;
const LONGEST_BODY: usize = 57;
const LEN: u16 = 6;
const BODY: u16 = 10;
const MORE: u8 = 0x40;
const DAMAGED: u8 = 0x80;
const STACK: u16 = 0x8f0;
const RETURN: u16 = 0x3ff0;

/// The chip, and what is in its receive page.
struct Chip {
    chip: Atmega328p,
    entry: u16,
    head: u16,
    unread: u16,
}

impl Chip {
    fn new() -> Chip {
        let chip = Atmega328p::new(&virtual_uno::image()).unwrap();
        Chip { chip, entry: address(SYMBOLS, "receive_frame"), head: 0, unread: 0 }
    }

    fn ram(&self, address: u16) -> u8 {
        self.chip.ram()[usize::from(address - 0x100)]
    }

    /// What the interrupt does.
    fn write(&mut self, byte: u8) {
        self.chip.write_data(PAGE + self.head, byte, &mut ());
        self.head = (self.head + 1) % PAGE_LEN;
        self.unread += 1;
        assert!(self.unread < PAGE_LEN);
    }

    /// Calls the function; gives what it says, how many bytes it took, and the cycles from the call to the return.
    fn take(&mut self, count: u8) -> (u8, u16, u64) {
        let chip = &mut self.chip;
        for (address, byte) in [(0x5d, STACK), (0x5e, STACK >> 8), (STACK + 1, RETURN >> 8), (STACK + 2, RETURN)] {
            chip.write_data(address, byte.to_le_bytes()[0], &mut ());
        }
        let [low, high] = RECEIVER.to_le_bytes();
        for (register, value) in [(24, low), (25, high), (22, count), (1, 0), (28, 0xa5), (29, 0x5a)] {
            chip.set_register(register, value);
        }
        chip.set_pc(self.entry);
        let begin = chip.cycle();
        while chip.pc() != RETURN {
            chip.step(&mut ());
            assert!(chip.cycle() - begin < 100_000, "it does not return");
        }
        let cycles = chip.cycle() - begin;
        assert_eq!([1, 28, 29].map(|register| chip.register(register)), [0, 0xa5, 0x5a]);
        let result = chip.register(24);
        let tail = u16::from(self.ram(RECEIVER));
        assert!(tail < PAGE_LEN, "tail {tail}");
        let taken = self.unread - (self.head + PAGE_LEN - tail) % PAGE_LEN;
        self.unread -= taken;
        (result, taken, cycles)
    }

    fn body(&self) -> Vec<u8> {
        (0..u16::from(self.ram(RECEIVER + LEN))).map(|at| self.ram(RECEIVER + BODY + at)).collect()
    }
}

fn framed(body: &[u8], tag: u8) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let mut frame = Encoder::new(&mut out);
    frame.bytes(body);
    let len = frame.finish(Tag(tag)).unwrap();
    out[..len].to_vec()
}

fn below(random: &mut Random, end: usize) -> usize {
    random.below(end as u64) as usize
}

/// Something that may come over a line: a frame, mostly, or one that was changed, or noise.
fn piece(random: &mut Random) -> Vec<u8> {
    let zeros = [1, 2, 5, 50, 1000][below(random, 5)];
    let longest = if below(random, 16) == 0 { MAX_BODY } else { LONGEST_BODY };
    let len = 1 + below(random, longest);
    let byte = |random: &mut Random| if below(random, zeros) == 0 { 0 } else { random.next() as u8 };
    let body: Vec<_> = (0..len).map(|_| byte(random)).collect();
    let mut frame = framed(&body, random.next() as u8 & 31);
    let at = below(random, frame.len());
    match below(random, 24) {
        // Bits that are wrong, bytes that are: zeros made and broken, the length and its parity, the trailer.
        0 => (0..=below(random, 3)).for_each(|_| frame[at] ^= 1 << below(random, 8)),
        1 => frame[at] = random.next() as u8,
        2 => frame[at] = 0,
        3 => frame[0] = (frame[0] ^ 2).wrapping_add(4 * below(random, 2) as u8),
        4 => frame[len + 2 + below(random, 3)] ^= 1 << below(random, 8),
        // Bytes that are missing, or too many.
        5 => drop(frame.remove(at)),
        6 => frame.insert(at, random.next() as u8),
        7 => frame.truncate(at),
        // Noise, lone zeros.
        8 => frame = (0..below(random, 200)).map(|_| byte(random)).collect(),
        9 => frame.insert(0, 0),
        _ => {}
    }
    frame
}

#[test]
fn frames_are_those_of_the_decoder() {
    let (mut random, mut chip) = (Random::new(144), Chip::new());
    let mut decoder = Decoder::<LONGEST_BODY>::new();
    let (mut frames, mut damaged) = (0, 0);
    for _ in 0..8000 {
        let line = piece(&mut random);
        let mut line = &line[..];
        // In portions of all sizes, so that each byte is the last of one.
        while !line.is_empty() || chip.unread != 0 {
            let (portion, rest) =
                line.split_at(line.len().min(below(&mut random, 40)).min(usize::from(PAGE_LEN - 1 - chip.unread)));
            line = rest;
            portion.iter().for_each(|byte| chip.write(*byte));
            let count = chip.unread.min(1 + below(&mut random, 60) as u16);
            if count == 0 {
                continue;
            }
            let first = (chip.head + PAGE_LEN - chip.unread) % PAGE_LEN;
            let (result, taken, _) = chip.take(count as u8);
            assert!(taken <= count);
            let bytes: Vec<_> = (0..count).map(|at| chip.ram(PAGE + (first + at) % PAGE_LEN)).collect();
            let (fed, received) = decoder.feed(&bytes);
            assert_eq!(fed, usize::from(taken));
            match received {
                Received::More => assert_eq!(result, MORE),
                Received::Damaged => {
                    assert_eq!(result, DAMAGED);
                    damaged += 1;
                }
                Received::Frame(tag) => {
                    assert_eq!((result, chip.body()), (tag.0, decoder.body().to_vec()));
                    frames += 1;
                }
            }
        }
    }
    println!("{frames} frames, {damaged} pieces damaged");
    assert!(frames > 3000 && damaged > 1000);
}

/// What a frame costs, all of it there at once.
fn cycles(body: &[u8]) -> u64 {
    let mut chip = Chip::new();
    let frame = framed(body, 3);
    frame.iter().for_each(|byte| chip.write(*byte));
    let (result, taken, cycles) = chip.take(chip.unread as u8);
    assert_eq!((result, usize::from(taken), chip.body()), (3, frame.len(), body.to_vec()));
    cycles
}

/// At 1 Mbaud a byte comes every 160 cycles, and steps take most of them.
#[test]
fn a_byte_costs_at_most_28_cycles_and_a_zero_7_more() {
    let (short, long, zeros) = (cycles(&[7; 17]), cycles(&[7; 57]), cycles(&[0; 57]));
    println!("17 bytes {short} cycles, 57 bytes {long}, 57 zeros {zeros}");
    println!("{} cycles a byte on the line, of the longest frame", long as f64 / (LONGEST_BODY + 6) as f64);
    assert!(long <= 30 * (LONGEST_BODY as u64 + 6));
    assert!(long - short <= 40 * 28 && zeros - long <= 57 * 7);
}
