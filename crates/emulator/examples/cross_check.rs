//! Runs AVR code and prints what it did, for cross-checks with other emulators.
//!
//! - `cross_check program IMAGE CYCLES`: a raw flash image. A line `CYCLE BYTE` for each byte written to UDR0 and
//!   `CYCLE mark BYTE` for each written to GPIOR0, at the cycle in which the writing instruction has ended; `CYCLE end`
//!   at `sleep`; `sent BYTE` for what has left the USART.
//! - `cross_check instructions`: reads lines of `pc sreg sp word word word registers` (hexadecimal; registers as 64
//!   digits) and prints `pc sreg sp cycles registers [address:byte]...` after one instruction.
//! - `cross_check timers`: reads lines of a timer's number (not needed here) and a program's words, runs each to its
//!   `sleep`, and prints `end=CYCLE pushed=BYTES edges=CYCLE:PIN=LEVEL,...`.
#![allow(clippy::disallowed_methods, reason = "its files are named by xtask")]

use pulsetrain_emulator::{Atmega328p, Observer, PinEdge, UartByte};
use std::error::Error;
use std::fmt::Write as _;
use std::io::BufRead;

const FLASH_BYTES: u16 = 0x8000;
const RAM: std::ops::RangeInclusive<u16> = 0x100..=0x8ff;
/// GPIOR0, GPIOR1, GPIOR2: memory, and nothing else.
const PLAIN_IO: [u16; 3] = [0x3e, 0x4a, 0x4b];
const SPL: u16 = 0x5d;
const SPH: u16 = 0x5e;
const SREG: u16 = 0x5f;
const UDR0: u16 = 0xc6;
const SLEEP: u16 = 0x9588;
/// A timer program that has not ended by then never does.
const MOST_CYCLES: u64 = 2_000_000;

/// What left the chip.
#[derive(Default)]
struct Seen {
    edges: Vec<PinEdge>,
    sent: Vec<UartByte>,
}

impl Observer for Seen {
    fn pin(&mut self, edge: PinEdge) {
        self.edges.push(edge);
    }

    fn transmit(&mut self, byte: UartByte) {
        self.sent.push(byte);
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
    let answer = match arguments[..] {
        ["program", image, cycles] => program(&std::fs::read(image)?, cycles.parse()?)?,
        ["instructions"] => each_line(instruction)?,
        ["timers"] => each_line(timer)?,
        _ => return Err("usage: cross_check program IMAGE CYCLES | instructions | timers".into()),
    };
    print!("{answer}");
    Ok(())
}

fn each_line(answer: fn(&str) -> Result<String, Box<dyn Error>>) -> Result<String, Box<dyn Error>> {
    let mut answers = String::new();
    for line in std::io::stdin().lock().lines() {
        answers += &answer(&line?)?;
        answers.push('\n');
    }
    Ok(answers)
}

/// The word of flash at a word address.
fn word(chip: &Atmega328p, at: u16) -> u16 {
    u16::from_le_bytes([chip.flash_byte(2 * at), chip.flash_byte(2 * at + 1)])
}

fn program(image: &[u8], cycles: u64) -> Result<String, Box<dyn Error>> {
    let mut chip = Atmega328p::new(image)?;
    let mut seen = Seen::default();
    let mut text = String::new();
    while chip.cycle() < cycles {
        let here = word(&chip, chip.pc());
        let byte = chip.register((here >> 4 & 31) as u8);
        // The program's own words say what is written: STS UDR0 and OUT GPIOR0.
        let to_uart = here & 0xfe0f == 0x9200 && word(&chip, chip.pc() + 1) == UDR0;
        let to_mark = here & 0xfe0f == 0xba0e;
        if here == SLEEP {
            // A byte is told of when its stop bit is over: those that were sent before.
            writeln!(text, "{} end", chip.cycle())?;
            break;
        }
        chip.step(&mut seen);
        if to_uart {
            writeln!(text, "{} {byte:02x}", chip.cycle())?;
        }
        if to_mark {
            writeln!(text, "{} mark {byte:02x}", chip.cycle())?;
        }
    }
    for byte in seen.sent {
        writeln!(text, "sent {:02x}", byte.byte())?;
    }
    Ok(text)
}

/// The memory that every case starts from. xtask/cross-check/simavr.c has the same function.
fn pattern(address: u16) -> u8 {
    (u32::from(address).wrapping_mul(0x9e37_79b1) >> 24) as u8
}

fn instruction(line: &str) -> Result<String, Box<dyn Error>> {
    let fields: Vec<_> = line.split(' ').collect();
    let [pc, sreg, sp, first, second, third, registers] = fields[..] else {
        return Err("seven fields expected".into());
    };
    let hex = |field| u16::from_str_radix(field, 16);
    let mut flash: Vec<u8> = (0..FLASH_BYTES).map(pattern).collect();
    let (pc, sreg, sp) = (hex(pc)?, hex(sreg)?, hex(sp)?);
    for (at, word) in (usize::from(pc)..).zip([first, second, third]) {
        flash[2 * at..2 * at + 2].copy_from_slice(&hex(word)?.to_le_bytes());
    }
    let mut chip = Atmega328p::new(&flash)?;
    for number in 0..32 {
        let digits = 2 * usize::from(number);
        chip.set_register(number, hex(registers.get(digits..digits + 2).ok_or("64 digits expected")?)? as u8);
    }
    for address in PLAIN_IO.into_iter().chain(RAM) {
        chip.write_data(address, pattern(address), &mut ());
    }
    for (address, value) in [(SPL, sp), (SPH, sp >> 8), (SREG, sreg)] {
        chip.write_data(address, value as u8, &mut ());
    }
    chip.set_pc(pc);
    let began = chip.cycle();
    chip.step(&mut ());

    let mut text = format!("{:04x} {:02x} {:04x} {} ", chip.pc(), chip.sreg(), chip.sp(), chip.cycle() - began);
    for number in 0..32 {
        write!(text, "{:02x}", chip.register(number))?;
    }
    for address in PLAIN_IO.into_iter().chain(RAM) {
        let byte = chip.read_data(address, &mut ());
        if byte != pattern(address) {
            write!(text, " {address:03x}:{byte:02x}")?;
        }
    }
    Ok(text)
}

fn timer(line: &str) -> Result<String, Box<dyn Error>> {
    let words = line.split(' ').skip(1).map(|word| u16::from_str_radix(word, 16).map(u16::to_le_bytes));
    let image = words.collect::<Result<Vec<_>, _>>()?.concat();
    let mut chip = Atmega328p::new(&image)?;
    let mut seen = Seen::default();
    while word(&chip, chip.pc()) != SLEEP && chip.cycle() < MOST_CYCLES {
        chip.step(&mut seen);
    }

    let mut text = if chip.cycle() < MOST_CYCLES { format!("end={}", chip.cycle()) } else { "end=never".into() };
    text += " pushed=";
    for address in (chip.sp() + 1..=*RAM.end()).rev() {
        write!(text, "{:02x}", chip.ram()[usize::from(address - RAM.start())])?;
    }
    text += " edges=";
    let edges = seen
        .edges
        .iter()
        .map(|edge| format!("{}:{:?}{}={}", edge.cycle, edge.port, edge.bit, u8::from(edge.level.is_high())));
    text += &edges.collect::<Vec<_>>().join(",");
    Ok(text)
}
