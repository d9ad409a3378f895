//! Runs ARMv6-M and ARMv7-M code and prints what it did, for cross-checks with other emulators.
//!
//! - `cross_check_arm instructions`: reads lines of `word word flags registers` (hexadecimal; flags as bits 3 to 0 for N,
//!   Z, C, V; registers R0 to R14 as 120 digits) and prints `pc flags cycles registers primask msp psp control
//!   [address:bytes=value]...` after one instruction, or `fault`.
//! - `cross_check_arm m3`: reads lines of `count halfwords xpsr registers` (hexadecimal; half-words with commas between
//!   them; registers R0 to R14 as 120 digits) and prints `pc xpsr registers primask basepri faultmask msp psp control
//!   [address=byte]...` after so many instructions of a Cortex-M3, with the bytes of memory that changed, or `unaligned` or another `fault`.
//! - `cross_check_arm exceptions IMAGE`: a raw image for address 0, with a vector table, on a Cortex-M3 with 256 KiB of
//!   code and 64 KiB of RAM. Prints what the program prints by semihosting.
//! - `cross_check_arm program IMAGE`: a raw image for the beginning of RAM, with a vector table. A line `instructions
//!   cycles pc hash` after each 1000 instructions and at `wfi`, the hash being over every instruction's program counter,
//!   flags and registers.
//! - `cross_check_arm firmware IMAGE INSTRUCTIONS`: a UF2 or ELF image on an RP2040 with a PC that has its USB serial port
//!   open, and whose UART 0 gets a byte each millisecond. What is needed to execute the same again without the chip: `v VALUE` for each word loaded, `x COUNT EXCEPTION
//!   VECTOR` for an exception entered after so many instructions, `t ...` for one that follows another's return without
//!   unstacking; and `h COUNT HASH` as above.
//! - `cross_check_arm usb IMAGE`: the same, with a PC that sends 1000 bytes to its serial port; prints how far the PC came
//!   and what comes back.
#![allow(clippy::disallowed_methods, reason = "its files are named by xtask")]

use pulsetrain_emulator::arm::{Bus, BusFault, Config, CortexM3, Cpu, FaultCause, M3Options, Size};
use pulsetrain_emulator::{LineByte, Observer, Rp2040, UsbState, image};
use std::collections::BTreeSet;
use std::error::Error;
use std::fmt::Write as _;
use std::io::BufRead;

const RAM: u32 = 0x2000_0000;
const RAM_BYTES: usize = 264 * 1024;
const CODE: u32 = RAM + 0x8000;
const WFI: u16 = 0xbf30;
/// Instructions between two lines.
const LINE: u64 = 1000;
/// A program that has not ended by then never does.
const MOST_INSTRUCTIONS: u64 = 20_000_000;

/// RAM, and what was written to it.
struct Memory {
    bytes: Vec<u8>,
    written: Vec<(u32, Size, u32)>,
}

impl Memory {
    fn range(&self, address: u32, size: Size) -> Result<std::ops::Range<usize>, BusFault> {
        let (at, bytes) = (address.wrapping_sub(RAM) as usize, size.bytes() as usize);
        if at + bytes <= RAM_BYTES { Ok(at..at + bytes) } else { Err(BusFault { address }) }
    }

    fn half(&self, address: u32) -> Result<u16, BusFault> {
        let bytes = &self.bytes[self.range(address, Size::Half)?];
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }
}

impl Bus for Memory {
    fn read(&mut self, address: u32, size: Size, _: u64) -> Result<u32, BusFault> {
        let range = self.range(address, size)?;
        Ok(self.bytes[range].iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    fn write(&mut self, address: u32, size: Size, value: u32, _: u64) -> Result<(), BusFault> {
        let range = self.range(address, size)?;
        for (byte, new) in self.bytes[range].iter_mut().zip(value.to_le_bytes()) {
            *byte = new;
        }
        self.written.push((address, size, value));
        Ok(())
    }

    fn fetch(&mut self, address: u32, _: u64) -> Result<u16, BusFault> {
        self.half(address)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
    let answer = match arguments[..] {
        ["instructions"] => instructions()?,
        ["m3"] => m3()?,
        ["exceptions", image] => exceptions(&std::fs::read(image)?)?,
        ["program", image] => program(&std::fs::read(image)?)?,
        ["firmware", image, instructions] => firmware(&std::fs::read(image)?, instructions.parse()?)?,
        ["usb", image] => usb(&std::fs::read(image)?)?,
        _ => {
            return Err(
                "usage: cross_check_arm instructions | m3 | exceptions IMAGE | program IMAGE | firmware IMAGE COUNT | usb IMAGE".into()
            );
        }
    };
    print!("{answer}");
    Ok(())
}

/// The memory that every case starts from. xtask/cross-check/rp2040js.mjs has the same function.
fn pattern(address: u32) -> u8 {
    (address.wrapping_mul(0x9e37_79b1) >> 24) as u8
}

fn instructions() -> Result<String, Box<dyn Error>> {
    let fresh: Vec<u8> = (RAM..).take(RAM_BYTES).map(pattern).collect();
    let mut memory = Memory { bytes: fresh.clone(), written: Vec::new() };
    let mut text = String::new();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let [first, second, flags, registers] = line.split(' ').collect::<Vec<_>>()[..] else {
            return Err("four fields expected".into());
        };
        let hex = |field| u32::from_str_radix(field, 16);
        let code = [hex(first)? as u16, hex(second)? as u16];
        let at = (CODE - RAM) as usize;
        memory.bytes[at..at + 4].copy_from_slice(&code.map(u16::to_le_bytes).concat());
        let mut cpu = Cpu::new(Config::default());
        for number in 0..15 {
            let digits = registers.get(8 * number..8 * number + 8).ok_or("120 digits expected")?;
            cpu.set_register(number, hex(digits)?);
        }
        cpu.set_register(15, CODE);
        cpu.set_flags(hex(flags)? << 28);
        cpu.step(&mut memory);
        if cpu.fault().is_some() {
            text += "fault";
        } else {
            let control = u32::from(cpu.register(13) == cpu.psp() && cpu.psp() != cpu.msp()) << 1;
            write!(text, "{:08x} {:x} {} ", cpu.pc(), cpu.xpsr() >> 28, cpu.cycle())?;
            (0..15).try_for_each(|number| write!(text, "{:08x}", cpu.register(number)))?;
            write!(text, " {} {:08x} {:08x} {control}", u8::from(cpu.primask()), cpu.msp(), cpu.psp())?;
            for (address, size, value) in &memory.written {
                write!(text, " {address:08x}:{}={value:x}", size.bytes())?;
            }
        }
        text.push('\n');
        for (address, size, _) in std::mem::take(&mut memory.written) {
            let range = memory.range(address, size)?;
            memory.bytes[range.clone()].copy_from_slice(&fresh[range]);
        }
        memory.bytes[at..at + 4].copy_from_slice(&fresh[at..at + 4]);
    }
    Ok(text)
}

/// N, Z, C, V, Q and ITSTATE of XPSR.
const M3_FLAGS: u32 = 0xfe00_fc00;
const THUMB: u32 = 1 << 24;
/// Where branches may go. xtask/cross-check/unicorn_m3.py has the same.
const CODE_WINDOW: std::ops::Range<u32> = 0x1e00_0000..0x2200_0000;

fn m3() -> Result<String, Box<dyn Error>> {
    let fresh: Vec<u8> = (RAM..).take(RAM_BYTES).map(pattern).collect();
    let mut memory = Memory { bytes: fresh.clone(), written: Vec::new() };
    // Unicorn has all bits of a priority.
    let options = M3Options { priority_bits: 8, ..M3Options::default() };
    let mut text = String::new();
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        let [count, code, xpsr, registers] = line.split(' ').collect::<Vec<_>>()[..] else {
            return Err("four fields expected".into());
        };
        let hex = |field| u32::from_str_radix(field, 16);
        let at = (CODE - RAM) as usize;
        for (place, half) in memory.bytes[at..].chunks_mut(2).zip(code.split(',')) {
            place.copy_from_slice(&(hex(half)? as u16).to_le_bytes());
        }
        let mut cpu = CortexM3::new(Config::CORTEX_M3, options);
        for number in 0..15 {
            let digits = registers.get(8 * number..8 * number + 8).ok_or("120 digits expected")?;
            cpu.set_register(number, hex(digits)?);
        }
        cpu.set_register(15, CODE);
        cpu.set_xpsr(hex(xpsr)?);
        for _ in 0..hex(count)? {
            cpu.step(&mut memory);
            if cpu.fault().is_some() {
                break;
            }
        }
        let mut changed = BTreeSet::new();
        for (address, size, _) in std::mem::take(&mut memory.written) {
            changed.extend(address..address + size.bytes());
        }
        // What would be executed next faults if no Thumb code can be there.
        let goes_on = cpu.xpsr() & THUMB != 0 && CODE_WINDOW.contains(&cpu.pc());
        if let Some(FaultCause::Unaligned { .. }) = cpu.fault().map(|fault| fault.cause) {
            text += "unaligned";
        } else if cpu.fault().is_some() || !goes_on {
            text += "fault";
        } else {
            let control = u32::from(cpu.register(13) == cpu.psp() && cpu.psp() != cpu.msp()) << 1;
            write!(text, "{:08x} {:08x} ", cpu.pc(), cpu.xpsr() & M3_FLAGS)?;
            (0..15).try_for_each(|number| write!(text, "{:08x}", cpu.register(number)))?;
            write!(text, " {} {:x} {}", u8::from(cpu.primask()), cpu.basepri(), u8::from(cpu.faultmask()))?;
            write!(text, " {:08x} {:08x} {control}", cpu.msp(), cpu.psp())?;
            for address in &changed {
                let place = (address - RAM) as usize;
                if memory.bytes[place] != fresh[place] {
                    write!(text, " {address:x}={:x}", memory.bytes[place])?;
                }
            }
        }
        text.push('\n');
        for address in changed.into_iter().chain(CODE..CODE + 64) {
            let place = (address - RAM) as usize;
            memory.bytes[place] = fresh[place];
        }
    }
    Ok(text)
}

/// Code at 0, RAM, and nothing else.
struct CodeAndRam {
    code: Vec<u8>,
    ram: Vec<u8>,
}

impl CodeAndRam {
    fn place(&mut self, address: u32, size: Size) -> Result<&mut [u8], BusFault> {
        let (bytes, at) = if address >= RAM { (&mut self.ram, address - RAM) } else { (&mut self.code, address) };
        let at = at as usize;
        bytes.get_mut(at..at + size.bytes() as usize).ok_or(BusFault { address })
    }
}

impl Bus for CodeAndRam {
    fn read(&mut self, address: u32, size: Size, _: u64) -> Result<u32, BusFault> {
        Ok(self.place(address, size)?.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    fn write(&mut self, address: u32, size: Size, value: u32, _: u64) -> Result<(), BusFault> {
        self.place(address, size)?.copy_from_slice(&value.to_le_bytes()[..size.bytes() as usize]);
        Ok(())
    }

    fn fetch(&mut self, address: u32, cycle: u64) -> Result<u16, BusFault> {
        self.read(address, Size::Half, cycle).map(|half| half as u16)
    }
}

fn exceptions(image: &[u8]) -> Result<String, Box<dyn Error>> {
    const SEMIHOSTING: u16 = 0xbeab;
    const WRITE_CHARACTER: u32 = 3;
    let mut memory = CodeAndRam { code: image.to_vec(), ram: vec![0; 64 * 1024] };
    memory.code.resize(256 * 1024, 0);
    // QEMU's LM3S6965 has all bits of a priority.
    let options = M3Options { priority_bits: 8, ..M3Options::default() };
    let mut cpu = CortexM3::new(Config::CORTEX_M3, options);
    cpu.reset(&mut memory);
    let mut text = String::new();
    for _ in 0..MOST_INSTRUCTIONS {
        if memory.fetch(cpu.pc(), 0)? != SEMIHOSTING || cpu.is_locked_up() {
            cpu.step(&mut memory);
        } else if cpu.register(0) == WRITE_CHARACTER {
            text.push(memory.read(cpu.register(1), Size::Byte, 0)? as u8 as char);
            cpu.set_register(15, cpu.pc() + 2);
        } else {
            return Ok(text);
        }
    }
    Err(format!("the program does not end: {:?}\n{text}", cpu.fault()).into())
}

fn program(image: &[u8]) -> Result<String, Box<dyn Error>> {
    let mut memory = Memory { bytes: image.to_vec(), written: Vec::new() };
    memory.bytes.resize(RAM_BYTES, 0);
    let mut cpu = Cpu::new(Config { vector_table: RAM, ..Config::default() });
    cpu.reset(&mut memory);
    let mut text = String::new();
    let mut hash = 0x811c_9dc5_u32;
    for count in 0..MOST_INSTRUCTIONS {
        let ends = memory.half(cpu.pc())? == WFI;
        if ends || count % LINE == 0 {
            writeln!(text, "{count} {} {:x} {hash:x}", cpu.cycle(), cpu.pc())?;
        }
        if ends {
            return Ok(text);
        }
        cpu.step(&mut memory);
        memory.written.clear();
        if let Some(fault) = cpu.fault() {
            return Err(format!("{} at {:#x}", fault.cause, fault.pc).into());
        }
        hash = hashed(hash, &cpu);
    }
    Err("the program does not end".into())
}

/// FNV-1a over registers and flags, by words.
fn hashed(hash: u32, cpu: &Cpu) -> u32 {
    let registers = (0..16).map(|number| cpu.register(number));
    registers.chain([cpu.xpsr() >> 28]).fold(hash, |hash, value| (hash ^ value).wrapping_mul(0x0100_0193))
}

/// A chip with an image in its flash, ELF or UF2.
fn chip(file: &[u8]) -> Result<Rp2040, Box<dyn Error>> {
    const RP2040_FAMILY: u32 = 0xe48b_ff56;
    let is_elf = file.starts_with(b"\x7fELF");
    let pieces = if is_elf { image::elf(file) } else { image::uf2(file, RP2040_FAMILY) }?;
    Ok(Rp2040::new(&image::flat(&pieces, Rp2040::FLASH_ADDRESS, Rp2040::FLASH_BYTES)?)?)
}

fn firmware(file: &[u8], instructions: u64) -> Result<String, Box<dyn Error>> {
    const BAUD: u64 = 115_200;
    // Text and what is none.
    const LINE_BYTES: &[u8] = b"?\nG1 X9\n\x00\x80\xff";
    let mut chip = chip(file)?;
    chip.usb_plug(true);
    chip.usb_open(true);
    let mut text = String::new();
    let mut hash = 0x811c_9dc5_u32;
    let mut next_byte = 0;
    let mut stacked = false;
    while chip.cpu().instructions() < instructions {
        let now = chip.cycle();
        if now >= next_byte && chip.line_idle_from(0) <= now {
            let bit_time = (chip.clock_hz() * 256 / BAUD) as u32;
            chip.receive(0, LineByte::new(now, LINE_BYTES[(now / 999) as usize % LINE_BYTES.len()], bit_time));
            next_byte = now + chip.clock_hz() / 1000;
        }
        let before = chip.cpu().clone();
        let word = chip.peek(before.pc() & !3).ok_or("the program is in RAM or flash")? >> (before.pc() % 4 * 8);
        let popped = chip.peek(before.register(13) + 4 * (word & 0xff).count_ones());
        chip.step(&mut ());
        let after = chip.cpu();
        let vector = after.pc() | 1;
        let exception = after.xpsr() & 0x3f;
        if after.instructions() == before.instructions() {
            if after.register(13) != before.register(13) {
                stacked = true;
            } else if exception != before.xpsr() & 0x3f || after.pc() != before.pc() {
                let kind = if std::mem::take(&mut stacked) { 'x' } else { 't' };
                writeln!(text, "{kind} {} {exception} {vector:x}", after.instructions())?;
            }
            continue;
        }
        let word = word as u16;
        let (low, high) = (usize::from(word & 7), usize::from(word >> 8 & 7));
        let list = |registers: u16| (0..8).filter(move |number| registers >> number & 1 != 0);
        let mut values = Vec::new();
        match word >> 11 {
            0b01001 | 0b10011 => values.push(after.register(high)),
            0b01010 | 0b01011 if word >> 9 & 7 >= 3 => values.push(after.register(low)),
            0b01101 | 0b01111 | 0b10001 => values.push(after.register(low)),
            0b11001 => values.extend(list(word & 0xff).map(|number| after.register(number))),
            0b10111 if word >> 9 == 0b101_1110 => {
                values.extend(list(word & 0xff).map(|number| after.register(number)));
                values.extend((word & 0x100 != 0).then_some(popped.unwrap_or(0)));
            }
            _ => {}
        }
        for value in values {
            writeln!(text, "v {value:x}")?;
        }
        hash = hashed(hash, after);
        if after.instructions() % LINE == 0 {
            writeln!(text, "h {} {hash:x}", after.instructions())?;
        }
    }
    Ok(text)
}

/// What the PC has received.
#[derive(Default)]
struct Received(Vec<u8>);

impl Observer for Received {
    fn usb(&mut self, _: u64, data: &[u8]) {
        self.0.extend(data);
    }
}

fn usb(file: &[u8]) -> Result<String, Box<dyn Error>> {
    const BYTES: usize = 1000;
    const MOST_CYCLES: u64 = 125_000_000;
    let mut chip = chip(file)?;
    let mut received = Received::default();
    chip.usb_plug(true);
    chip.usb_open(true);
    while chip.usb_state() != UsbState::Open && chip.cycle() < MOST_CYCLES {
        chip.run(chip.cycle() + 10_000, &mut received);
    }
    let bytes: Vec<u8> = (0..BYTES).map(|at| (at * 7 + at / 256) as u8).collect();
    chip.usb_send(&bytes);
    while received.0.len() < BYTES && chip.cycle() < MOST_CYCLES {
        chip.run(chip.cycle() + 10_000, &mut received);
    }
    let hex: String = received.0.iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(format!("{:?} {hex}\n", chip.usb_state()))
}
