//! ARMv6-M in rp2040js and in ours: half-words from random states; a program, and firmware, with every instruction
//! compared; and a USB device that others wrote, enumerated by both.
//!
//! Firmware is executed here on the whole chip, with its interrupts; rp2040js then executes the same instructions, gets
//! what they load from here, and enters exceptions where they were entered: its peripherals take no part.
//!
//! Left out of the random cases:
//! - hints, `bkpt`, `udf`, `svc`: they act on what is not compared here
//! - what the manual (ARM DDI 0419E) calls UNPREDICTABLE: the program counter as operand of CMP, BX and BLX, and as a
//!   register that is added to itself; empty lists
//! - what faults here, as rp2040js knows no faults: the report counts it
//!
//! Where rp2040js is not the chip: xtask/cross-check/rp2040js.mjs lists it by name, and puts it right.

use super::{Comparison, Tools};
use crate::command::{self, Done, Failure, root};
use crate::random::Random;
use std::path::{Path, PathBuf};

const SEED: u64 = 2040;
/// Cases of each half-word, and of those half-words whose result depends on the values of two registers.
const OF_WORD: usize = 2;
const OF_ARITHMETIC: usize = 40;
/// Cases of instructions of two half-words.
const OF_WIDE: usize = 4000;
/// Addresses that cases use: words of RAM from here on, behind the code.
const LOWEST: u32 = 0x2001_0000;
const WORDS: u16 = 0x4000;

pub(super) fn instructions(tools: &Tools) -> Done<Comparison> {
    let mut random = Random::new(SEED);
    let mut cases = Vec::new();
    for word in (0..0xe800_u16).filter(|word| is_compared(*word)) {
        let arithmetic = (0x4000..0x4700).contains(&word);
        for _ in 0..if arithmetic { OF_ARITHMETIC } else { OF_WORD } {
            cases.push(case([word, random.next() as u16], &mut random));
        }
    }
    for number in 0..OF_WIDE {
        let (first, second) = (random.next() as u16, random.next() as u16);
        // R0 to R12: stack pointer and program counter are UNPREDICTABLE in `mrs` and `msr`.
        let register = random.below(13);
        let words = match number % 4 {
            // BL; MRS of APSR, IPSR, MSP, PSP, PRIMASK, CONTROL; MSR of those that are written; barriers.
            0 => [0xf000 | first & 0x7ff, 0xd000 | second & 0x2fff],
            1 => [0xf3ef, 0x8000 | register << 8 | random.pick(&[0, 5, 8, 9, 16, 20])],
            2 => [0xf380 | register, 0x8800 | random.pick(&[0, 8, 9, 16])],
            _ => [0xf3bf, random.pick(&[0x8f4f, 0x8f5f, 0x8f6f])],
        };
        cases.push(case(words, &mut random));
    }
    let ours = tools.ask("arm", tools.ours_arm().arg("instructions"), &cases.concat())?;
    let ours: Vec<_> = ours.lines().collect();
    if ours.len() != cases.len() {
        return Err(Failure::Check(format!("{} cases asked, {} answered by ours", cases.len(), ours.len())));
    }
    let asked = cases.len();
    let (cases, ours): (Vec<_>, Vec<_>) = cases.into_iter().zip(ours).filter(|(_, answer)| *answer != "fault").unzip();
    let theirs = tools.ask("arm", tools.rp2040js().arg("instructions"), &cases.concat())?;
    let (theirs, exceptions) = split(&theirs)?;
    let mut differences = Vec::new();
    if theirs.len() != cases.len() {
        differences.push(format!("{} cases asked, {} answered by rp2040js", cases.len(), theirs.len()));
    }
    for ((case, ours), theirs) in cases.iter().zip(&ours).zip(&theirs) {
        if ours != theirs {
            differences.push(format!("case {}\n  rp2040js {theirs}\n  ours     {ours}", case.trim()));
        }
    }
    let faults = asked - cases.len();
    let compared = format!("{} cases (seed {SEED}) with each register, store, cycle; {faults} fault here", cases.len());
    Ok(Comparison { what: "ARMv6-M instructions, with rp2040js", compared, differences, exceptions })
}

pub(super) fn program(tools: &Tools) -> Done<Comparison> {
    let image = tools.compile_arm("arm")?;
    let ours = command::output(tools.ours_arm().arg("program").arg(&image))?;
    let theirs = command::output(tools.rp2040js().arg("program").arg(&image))?;
    let (theirs, exceptions) = split(&theirs)?;
    let ours: Vec<_> = ours.lines().collect();
    let same = ours.iter().zip(&theirs).take_while(|(ours, theirs)| ours == theirs).count();
    let mut differences = Vec::new();
    if same < ours.len().max(theirs.len()) {
        differences.push(format!("line {same}: rp2040js {:?}, ours {:?}", theirs.get(same), ours.get(same)));
    }
    let number = |at| ours.last().and_then(|line| line.split(' ').nth(at)).unwrap_or("0");
    let compared = format!("a program, {} instructions with each register, {} cycles", number(0), number(1));
    Ok(Comparison { what: "ARMv6-M program, with rp2040js", compared, differences, exceptions })
}

/// Where rp2040js was corrected: the name of the correction, and how often.
type Met = Vec<(&'static str, usize)>;

pub(super) fn firmware(tools: &Tools) -> Done<Comparison> {
    const INSTRUCTIONS: &str = "2000000";
    // Other people's programs, and ours.
    let images = [vec![tools.compile_usb()?], committed()?].concat();
    let (mut differences, mut compared, mut met) = (Vec::new(), Vec::new(), Met::new());
    for image in images {
        let name = image.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let ours = command::output(tools.ours_arm().arg("firmware").arg(&image).arg(INSTRUCTIONS))?;
        match tools.ask("arm", tools.rp2040js().arg("firmware").arg(&image), &ours) {
            Ok(theirs) => {
                let (lines, exceptions) = split(&theirs)?;
                met = exceptions
                    .into_iter()
                    .enumerate()
                    .map(|(at, (name, times))| (name, times + earlier(&met, at)))
                    .collect();
                compared.push(format!("{name}: {}", lines.join(" ")));
            }
            // The answer says where the two differ.
            Err(failure) => differences.push(format!("{name}: {failure}")),
        }
    }
    Ok(Comparison { what: "firmware, with rp2040js", compared: compared.join("; "), differences, exceptions: met })
}

/// Every committed image of a Pico.
fn committed() -> Done<Vec<PathBuf>> {
    let folder = root().join("crates/board/images");
    let files = std::fs::read_dir(&folder).map_err(|why| Failure::File { path: folder, why })?;
    Ok(files.flatten().map(|file| file.path()).filter(|path| path.extension() == Some("uf2".as_ref())).collect())
}

fn earlier(met: &Met, at: usize) -> usize {
    met.get(at).map_or(0, |(_, times)| *times)
}

pub(super) fn usb(tools: &Tools) -> Done<Comparison> {
    const BYTES: usize = 1000;
    let ask = |image: &Path| -> Done<[(&'static str, String); 2]> {
        let ours = command::output(tools.ours_arm().arg("usb").arg(image))?;
        Ok([("ours", ours), ("rp2040js", command::output(tools.rp2040js().arg("usb").arg(image))?)])
    };
    // Both must send each byte with its bits turned.
    let back: String = (0..BYTES).map(|at| format!("{:02x}", !((at * 7 + at / 256) as u8))).collect();
    let expected = format!("Open {back}");
    let mut differences = Vec::new();
    for (side, answer) in ask(&tools.compile_usb()?)? {
        if answer.trim() != expected {
            differences.push(format!("{side}: {:.60}..., {} characters", answer.trim(), answer.trim().len()));
        }
    }
    // Our firmware does not answer such bytes, but both must see it as a serial port.
    // The library's examples have no USB.
    let images = [root().join("crates/board/images/pico.uf2")];
    for image in &images {
        for (side, answer) in ask(image)? {
            if !answer.starts_with("Open") {
                differences.push(format!("{}, {side}: {:.60}", image.display(), answer.trim()));
            }
        }
    }
    let compared = format!(
        "rp2040-hal with usbd-serial enumerated by both, {BYTES} bytes there and back; {} firmware of ours enumerated by both",
        images.len()
    );
    Ok(Comparison { what: "USB device, with rp2040js", compared, differences, exceptions: Vec::new() })
}

/// The answers, and the corrections after `met ` in the last line.
fn split(text: &str) -> Done<(Vec<&str>, Met)> {
    const NAMES: [&str; 6] = ["SHIFT", "CARRY", "STORE", "BANK", "LINK", "STACK"];
    let mut lines: Vec<_> = text.lines().collect();
    let met = lines.pop().and_then(|last| last.strip_prefix("met "));
    let times = |name: &str| -> Option<usize> {
        let (_, times) = met?.split(' ').filter_map(|field| field.split_once('=')).find(|(met, _)| *met == name)?;
        times.parse().ok()
    };
    let exceptions = NAMES.iter().map(|name| times(name).map(|times| (*name, times))).collect::<Option<_>>();
    let exceptions = exceptions.ok_or_else(|| Failure::Check("rp2040js.mjs did not say what it met".into()))?;
    Ok((lines, exceptions))
}

fn is_compared(word: u16) -> bool {
    let (d, m) = (word & 7 | word >> 4 & 8, word >> 3 & 15);
    match word >> 8 {
        // ADD: both the program counter; CMP; BX, BLX.
        0x44 => (d, m) != (15, 15),
        0x45 => d != 15 && m != 15,
        0x47 => m != 15 && word & 7 == 0,
        // PUSH, POP.
        0xb4 | 0xbc | 0xc0..=0xcf => word & 0xff != 0,
        // BKPT, hints, UDF, SVC.
        0xbe | 0xbf | 0xde | 0xdf => false,
        _ => true,
    }
}

/// A case for both sides: the half-words, flags and registers.
fn case(words: [u16; 2], random: &mut Random) -> String {
    let mut line = format!("{:x} {:x} {:x} ", words[0], words[1], random.below(16));
    for number in 0..15 {
        let any = random.next() as u32;
        let address = LOWEST + 4 * u32::from(random.below(WORDS));
        let value = match random.below(8) {
            // The stack pointer is always such an address.
            _ if number == 13 => address,
            0 => any,
            1 => random.pick(&[0, 1, 31, 32, 33, 255, 256, 0x7fff_ffff, 0x8000_0000, u32::MAX]),
            2 | 3 => 4 * u32::from(random.below(64)),
            4 => address + u32::from(random.below(4)),
            _ => address,
        };
        line += &format!("{value:08x}");
    }
    line + "\n"
}
