//! Runs ARMv6-M code and prints what it did, for cross-checks with another emulator.
//!
//! - `cross_check_arm instructions`: reads lines of `word word flags registers` (hexadecimal; flags as bits 3 to 0 for N,
//!   Z, C, V; registers R0 to R14 as 120 digits) and prints `pc flags cycles registers primask msp psp control
//!   [address:bytes=value]...` after one instruction, or `fault`.
//! - `cross_check_arm program IMAGE`: a raw image for the beginning of RAM, with a vector table. A line `instructions
//!   cycles pc hash` after each 1000 instructions and at `wfi`, the hash being over every instruction's program counter,
//!   flags and registers.

use pulsetrain_emulator::arm::{Bus, BusFault, Config, Cpu, Size};
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
        ["program", image] => program(&std::fs::read(image)?)?,
        _ => return Err("usage: cross_check_arm instructions | program IMAGE".into()),
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
        // FNV-1a, by words.
        let registers = (0..16).map(|number| cpu.register(number));
        hash = registers.chain([cpu.xpsr() >> 28]).fold(hash, |hash, value| (hash ^ value).wrapping_mul(0x0100_0193));
    }
    Err("the program does not end".into())
}
