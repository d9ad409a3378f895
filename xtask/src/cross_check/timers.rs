//! Random timer programs: every edge of the pins and every reading of a register, in avr8js and in ours.
//!
//! Timers 0, 1 and 2 in all waveform modes; each case draws a prescaler, compare values, what the pins do on a match,
//! and then, while the timer runs, readings of counter and flags, clearing of flags, new compare values and TOPs, forced
//! compares, new pin modes, counter writes, stops, port writes, with random waits between.
//!
//! Left out, as the datasheet (DS40002061B) leaves open what happens, or warns of it:
//! - a counter write in phase correct modes (which way it counts on), or at or above TOP, or to BOTTOM in fast PWM (16.7.3)
//! - a forced compare in PWM modes (15.9.2: the bit must be written 0)
//! - changing the waveform mode of a running timer (15.7: set up before)
//! - a pin mode back from 0: avr8js copies the port's bit into the compare register
//!
//! Where avr8js departs from the chip in what is compared: xtask/cross-check/avr8js.mjs lists it by name.

use super::{Comparison, Tools};
use crate::command::{Done, Failure};
use crate::random::Random;
use std::collections::BTreeMap;
use std::fmt::Write as _;

const SEED: u64 = 17;
/// Cases of each timer, waveform mode and prescaler.
const CASES: usize = 40;

/// A timer's registers (addresses in the data space) and modes.
struct Timer {
    control_a: u16,
    control_b: u16,
    /// FOC bits, if not in control_b.
    control_c: Option<u16>,
    counter: u16,
    compare: [u16; 2],
    /// Input capture register, TOP in some modes.
    capture: Option<u16>,
    flags: u16,
    /// Bit of the prescaler's reset in GTCCR.
    prescaler_reset: u8,
    /// (clock select, divider).
    prescalers: &'static [(u8, u16)],
    modes: &'static [Mode],
    /// Port B, port D: the output compare pins.
    pins: [u8; 2],
}

/// A row of tables 15-8, 16-4, 18-8.
struct Mode {
    wgm: u8,
    kind: Kind,
    top: Top,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Normal,
    Ctc,
    Fast,
    PhaseCorrect,
}

#[derive(Clone, Copy, PartialEq)]
enum Top {
    Fixed(u16),
    CompareA,
    Capture,
}

const fn mode(wgm: u8, kind: Kind, top: Top) -> Mode {
    Mode { wgm, kind, top }
}

/// Tables 15-8 and 18-8; 4 and 6 are reserved.
const MODES_8: [Mode; 6] = [
    mode(0, Kind::Normal, Top::Fixed(0xff)),
    mode(1, Kind::PhaseCorrect, Top::Fixed(0xff)),
    mode(2, Kind::Ctc, Top::CompareA),
    mode(3, Kind::Fast, Top::Fixed(0xff)),
    mode(5, Kind::PhaseCorrect, Top::CompareA),
    mode(7, Kind::Fast, Top::CompareA),
];

/// Table 16-4; 13 is reserved.
const MODES_16: [Mode; 15] = [
    mode(0, Kind::Normal, Top::Fixed(0xffff)),
    mode(1, Kind::PhaseCorrect, Top::Fixed(0xff)),
    mode(2, Kind::PhaseCorrect, Top::Fixed(0x1ff)),
    mode(3, Kind::PhaseCorrect, Top::Fixed(0x3ff)),
    mode(4, Kind::Ctc, Top::CompareA),
    mode(5, Kind::Fast, Top::Fixed(0xff)),
    mode(6, Kind::Fast, Top::Fixed(0x1ff)),
    mode(7, Kind::Fast, Top::Fixed(0x3ff)),
    mode(8, Kind::PhaseCorrect, Top::Capture),
    mode(9, Kind::PhaseCorrect, Top::CompareA),
    mode(10, Kind::PhaseCorrect, Top::Capture),
    mode(11, Kind::PhaseCorrect, Top::CompareA),
    mode(12, Kind::Ctc, Top::Capture),
    mode(14, Kind::Fast, Top::Capture),
    mode(15, Kind::Fast, Top::CompareA),
];

/// Tables 15-9 and 16-5.
const PRESCALERS_01: [(u8, u16); 5] = [(1, 1), (2, 8), (3, 64), (4, 256), (5, 1024)];
/// Table 18-9.
const PRESCALERS_2: [(u8, u16); 7] = [(1, 1), (2, 8), (3, 32), (4, 64), (5, 128), (6, 256), (7, 1024)];

const TIMERS: [Timer; 3] = [
    Timer {
        control_a: 0x44,
        control_b: 0x45,
        control_c: None,
        counter: 0x46,
        compare: [0x47, 0x48],
        capture: None,
        flags: 0x35,
        prescaler_reset: 0x01,
        prescalers: &PRESCALERS_01,
        modes: &MODES_8,
        pins: [0, 0x60],
    },
    Timer {
        control_a: 0x80,
        control_b: 0x81,
        control_c: Some(0x82),
        counter: 0x84,
        compare: [0x88, 0x8a],
        capture: Some(0x86),
        flags: 0x36,
        prescaler_reset: 0x01,
        prescalers: &PRESCALERS_01,
        modes: &MODES_16,
        pins: [0x06, 0],
    },
    Timer {
        control_a: 0xb0,
        control_b: 0xb1,
        control_c: None,
        counter: 0xb2,
        compare: [0xb3, 0xb4],
        capture: None,
        flags: 0x37,
        prescaler_reset: 0x02,
        prescalers: &PRESCALERS_2,
        modes: &MODES_8,
        pins: [0x08, 0x08],
    },
];

/// TOV, OCFA, OCFB.
const FLAGS: u8 = 7;
const GTCCR: u16 = 0x43;
const DDR: [u16; 2] = [0x24, 0x2a];
const PORT: [u16; 2] = [0x25, 0x2b];

pub(super) fn compare(tools: &Tools) -> Done<Comparison> {
    let mut random = Random::new(SEED);
    let mut names = Vec::new();
    let mut input = String::new();
    for (number, timer) in TIMERS.iter().enumerate() {
        for mode in timer.modes {
            for &prescaler in timer.prescalers {
                for _ in 0..CASES {
                    let words = program(timer, mode, prescaler, &mut random);
                    // Writing to a String cannot fail.
                    let _ = write!(input, "{number}");
                    for word in words {
                        let _ = write!(input, " {word:x}");
                    }
                    input.push('\n');
                    names.push(format!("timer {number}, mode {}, clk/{}", mode.wgm, prescaler.1));
                }
            }
        }
    }
    let theirs = tools.ask("timers", &mut tools.avr8js(), &input)?;
    let ours = tools.ask("timers", tools.ours().arg("timers"), &input)?;
    let (theirs, ours) = (answers(&theirs)?, answers(&ours)?);
    if theirs.len() != names.len() || ours.len() != names.len() {
        let (asked, theirs, ours) = (names.len(), theirs.len(), ours.len());
        return Err(Failure::Check(format!("{asked} timer programs asked, {theirs} and {ours} answered")));
    }

    let mut differences = Vec::new();
    let mut stops: BTreeMap<&'static str, usize> = STOPS.into_iter().map(|name| (name, 0)).collect();
    let (mut edges, mut bytes) = (0, 0);
    for (index, (theirs, ours)) in theirs.iter().zip(&ours).enumerate() {
        let until = theirs.stop.as_ref().map(|(cycle, _)| *cycle);
        if let Some((_, reason)) = &theirs.stop {
            match STOPS.iter().find(|name| *name == reason) {
                Some(name) => *stops.entry(name).or_default() += 1,
                None => differences.push(format!("avr8js stopped for `{reason}`, which has no name here")),
            }
        }
        if let Some(difference) = theirs.differs(ours, until) {
            differences.push(format!("case {index}, {}: {difference}", names[index]));
        }
        edges += theirs.edges.len();
        bytes += theirs.pushed.len() / 2;
    }
    let compared = format!("{} programs (seed {SEED}), {edges} edges, {bytes} bytes read", names.len());
    Ok(Comparison { what: "timers, with avr8js", compared, differences, exceptions: stops.into_iter().collect() })
}

/// Where avr8js is known to be wrong, so that comparing stops within a case: see avr8js.mjs.
const STOPS: [&str; 3] = ["DOWN", "TOP", "WINDOW"];

/// The output of a case.
struct Answer {
    end: String,
    /// Readings, in hexadecimal.
    pushed: String,
    /// Cycle, and pin with level.
    edges: Vec<(u64, String)>,
    /// The cycle from which on the answer is no evidence, and why.
    stop: Option<(u64, String)>,
}

impl Answer {
    fn read(line: &str) -> Option<Answer> {
        let fields: BTreeMap<_, _> = line.split(' ').filter_map(|field| field.split_once('=')).collect();
        let timed = |text: &str| -> Option<(u64, String)> {
            let (cycle, what) = text.split_once(':')?;
            Some((cycle.parse().ok()?, what.to_owned()))
        };
        Some(Answer {
            end: (*fields.get("end")?).to_owned(),
            pushed: (*fields.get("pushed")?).to_owned(),
            edges: settled(
                fields.get("edges")?.split(',').filter(|edge| !edge.is_empty()).map(timed).collect::<Option<_>>()?,
            ),
            stop: match fields.get("stop") {
                Some(text) => Some(timed(text)?),
                None => None,
            },
        })
    }

    /// The first difference before the cycle `until`, in words.
    fn differs(&self, ours: &Answer, until: Option<u64>) -> Option<String> {
        let before = |edges: &[(u64, String)]| -> Vec<(u64, String)> {
            edges.iter().filter(|(cycle, _)| until.is_none_or(|until| *cycle < until)).cloned().collect()
        };
        let (their_edges, our_edges) = (before(&self.edges), before(&ours.edges));
        let at = their_edges.iter().zip(&our_edges).take_while(|(theirs, ours)| theirs == ours).count();
        if at < their_edges.len().max(our_edges.len()) {
            return Some(format!("edge {at}: avr8js {:?}, ours {:?}", their_edges.get(at), our_edges.get(at)));
        }
        let readings = if until.is_some() { ours.pushed.starts_with(&self.pushed) } else { ours.pushed == self.pushed };
        if !readings {
            let same = self.pushed.bytes().zip(ours.pushed.bytes()).take_while(|(a, b)| a == b).count() / 2;
            let at = |text: &str| text.get(2 * same..2 * same + 2).map(str::to_owned);
            return Some(format!("reading {same}: avr8js {:?}, ours {:?}", at(&self.pushed), at(&ours.pushed)));
        }
        (until.is_none() && self.end != ours.end).then(|| format!("ends: avr8js {}, ours {}", self.end, ours.end))
    }
}

/// Sorts edges by time and pin, and removes those that nobody can see: two edges of a pin in one cycle.
fn settled(mut edges: Vec<(u64, String)>) -> Vec<(u64, String)> {
    // The sort is stable, so the last edge of a pin in a cycle is its level then.
    edges.sort_by_key(|(cycle, edge)| (*cycle, edge.get(..2).map(str::to_owned)));
    let mut levels: BTreeMap<String, String> = BTreeMap::new();
    let mut left: Vec<(u64, String)> = Vec::new();
    for (index, (cycle, edge)) in edges.iter().enumerate() {
        let Some((pin, level)) = edge.split_once('=') else { continue };
        let is_last = edges.get(index + 1).is_none_or(|next| next.0 != *cycle || !next.1.starts_with(pin));
        // Pins begin low.
        let before = levels.entry(pin.to_owned()).or_insert_with(|| "0".to_owned());
        if is_last && before != level {
            level.clone_into(before);
            left.push((*cycle, edge.clone()));
        }
    }
    left
}

fn answers(text: &str) -> Done<Vec<Answer>> {
    let read = |line| Answer::read(line).ok_or_else(|| Failure::Check(format!("not an answer: {line}")));
    text.lines().map(read).collect()
}

/// A program's machine code, and the cycle at which it will have reached its end.
struct Code {
    words: Vec<u16>,
    cycle: u32,
}

/// Encodings: DS40002198. r16 is for values, r24 for waiting.
impl Code {
    fn emit(&mut self, word: u16, cycles: u32) {
        self.words.push(word);
        self.cycle += cycles;
    }

    /// LDI, then OUT or STS.
    fn set(&mut self, address: u16, value: u8) {
        self.emit(0xe000 | u16::from(value & 0xf0) << 4 | u16::from(value & 0xf), 1);
        self.store(address);
    }

    fn store(&mut self, address: u16) {
        if address < 0x60 {
            let io = address - 0x20;
            self.emit(0xb900 | (io & 0x30) << 5 | io & 0xf, 1);
        } else {
            self.words.push(0x9300);
            self.emit(address, 2);
        }
    }

    /// High byte first: it waits in TEMP for the low one (16.3).
    fn set_wide(&mut self, address: u16, value: u16) {
        let [low, high] = value.to_le_bytes();
        self.set(address + 1, high);
        self.set(address, low);
    }

    /// IN or LDS, then PUSH.
    fn read(&mut self, address: u16) {
        self.load(address);
        self.emit(0x930f, 2);
    }

    /// With ANDI before PUSH.
    fn read_masked(&mut self, address: u16, mask: u8) {
        self.load(address);
        self.emit(0x7000 | u16::from(mask & 0xf0) << 4 | u16::from(mask & 0xf), 1);
        self.emit(0x930f, 2);
    }

    fn load(&mut self, address: u16) {
        if address < 0x60 {
            let io = address - 0x20;
            self.emit(0xb100 | (io & 0x30) << 5 | io & 0xf, 1);
        } else {
            self.words.push(0x9100);
            self.emit(address, 2);
        }
    }

    /// `cycles` cycles; in loops if it may take more than one at a time.
    fn wait(&mut self, mut cycles: u32, loops: bool) {
        while loops && cycles >= 12 {
            let turns = (cycles / 3).min(255);
            self.emit(0xe080 | (turns as u16 & 0xf0) << 4 | turns as u16 & 0xf, 1);
            // DEC r24; BRNE .-4: 3 cycles a turn, 2 the last.
            self.words.extend([0x958a, 0xf7f1]);
            self.cycle += 3 * turns - 1;
            cycles -= 3 * turns;
        }
        for _ in 0..cycles {
            self.emit(0, 1);
        }
    }
}

/// One random program for `timer` in `mode`.
fn program(timer: &Timer, mode: &Mode, (select, divider): (u8, u16), random: &mut Random) -> Vec<u16> {
    let wide = timer.capture.is_some();
    let set = |code: &mut Code, address, value: u16| {
        if wide { code.set_wide(address, value) } else { code.set(address, value as u8) }
    };
    let mut code = Code { words: Vec::new(), cycle: 0 };
    let max = if wide { 0xffff } else { 0xff };
    // Periods are short, so that a case sees several; now and then there is one whose end it does not see.
    let top = match mode.top {
        Top::Fixed(top) => top,
        _ if random.once_in(8) => random.between(3, max),
        _ => random.between(3, 40),
    };
    let begin = match mode.kind {
        Kind::Normal => random.between(max - 60, max),
        _ => random.between(1, (top - 1).min(60)),
    };
    // A value near the counter's at the end of the case.
    let value = |random: &mut Random| match mode.kind {
        Kind::Normal if random.once_in(2) => random.between(max - 50, max),
        Kind::Normal => random.between(1, 80),
        _ if random.once_in(8) => top,
        _ => random.between(1, top.min(80)),
    };
    let top_register = match mode.top {
        Top::Fixed(_) => None,
        Top::CompareA => Some(timer.compare[0]),
        Top::Capture => timer.capture,
    };

    for (ddr, pins) in DDR.into_iter().zip(timer.pins) {
        code.set(ddr, pins);
    }
    // In mode 0, the mode after reset, compare values act at once.
    for address in timer.compare {
        let value = if Some(address) == top_register { top } else { value(random) };
        set(&mut code, address, value);
    }
    set(&mut code, timer.counter, begin);
    let mut actions = [pin_action(timer, mode, 0, random, true), pin_action(timer, mode, 1, random, true)];
    let control_a = |[a, b]: [u8; 2]| a << 6 | b << 4 | mode.wgm & 3;
    let control_b = if wide { (mode.wgm & 0x0c) << 1 } else { (mode.wgm & 4) << 1 };
    code.set(timer.control_a, control_a(actions));
    code.set(timer.control_b, control_b);
    if let Some(address) = timer.capture.filter(|_| mode.top == Top::Capture) {
        // The register can be written only in such a mode (16.6.3).
        set(&mut code, address, top);
    }
    // avr8js counts its prescaler from the instruction that selects the clock: a whole number of timer clocks after the
    // prescaler's reset that is the same.
    code.set(GTCCR, timer.prescaler_reset);
    let reset_at = code.cycle;
    let starting: u32 = if timer.control_b < 0x60 { 2 } else { 3 };
    let divider_cycles = u32::from(divider);
    code.wait(divider_cycles * starting.div_ceil(divider_cycles) - starting, false);
    debug_assert_eq!((code.cycle + starting - reset_at) % divider_cycles, 0);
    code.set(timer.control_b, control_b | select);

    let mut top_changes = u16::from(random.once_in(3));
    for _ in 0..random.between(20, 60) {
        // Long waits of up to 1.5 periods, as far as time allows.
        let long = u32::from(top.min(400)) * 3 / 2;
        let long = long.min(40_000 / divider_cycles) as u16;
        let clocks = if random.once_in(10) { random.below(long) } else { random.below(6) };
        code.wait(divider_cycles * u32::from(clocks) + u32::from(random.below(divider.min(64))), divider >= 8);
        match random.below(20) {
            0..=5 => {
                code.read(timer.counter);
                if wide {
                    code.read(timer.counter + 1);
                }
            }
            6..=9 => code.read_masked(timer.flags, FLAGS),
            // avr8js clears all flags, whichever is written.
            10..=11 => code.set(timer.flags, FLAGS),
            12..=13 => {
                let address = random.pick(&timer.compare);
                if Some(address) != top_register {
                    set(&mut code, address, value(random));
                } else if mode.kind != Kind::Ctc || top_changes > 0 {
                    top_changes = top_changes.saturating_sub(1);
                    set(&mut code, address, random.between(3, top.max(20)));
                }
            }
            14 => {
                if let Some(address) = timer.capture.filter(|_| mode.top == Top::Capture && top_changes > 0) {
                    top_changes = top_changes.saturating_sub(1);
                    set(&mut code, address, random.between(top / 2 + 2, max));
                }
            }
            15 if matches!(mode.kind, Kind::Normal | Kind::Ctc) => {
                let forced = (random.between(1, 3) as u8) << 6;
                match timer.control_c {
                    Some(address) => code.set(address, forced),
                    None => code.set(timer.control_b, forced | control_b | select),
                }
            }
            16 => {
                for (pin, action) in actions.iter_mut().enumerate() {
                    if *action != 0 {
                        *action = pin_action(timer, mode, pin, random, false);
                    }
                }
                code.set(timer.control_a, control_a(actions));
            }
            17 => match mode.kind {
                Kind::Normal => set(&mut code, timer.counter, random.between(0, max)),
                Kind::Fast if mode.top == Top::Fixed(top) => {
                    set(&mut code, timer.counter, random.between(1, top - 1));
                }
                _ => {}
            },
            18 if divider == 1 => {
                code.set(timer.control_b, control_b);
                code.wait(u32::from(random.below(9)), false);
                code.read(timer.counter);
                code.set(timer.control_b, control_b | select);
            }
            _ => {
                let port = usize::from(random.below(2));
                code.set(PORT[port], random.next() as u8 & timer.pins[port]);
            }
        }
    }
    code.emit(0x9588, 1);
    code.words
}

/// What a pin does on a match (COMnx1:0): one that this mode defines; 0 (the port's own) only at the beginning.
fn pin_action(timer: &Timer, mode: &Mode, pin: usize, random: &mut Random, beginning: bool) -> u8 {
    let wide = timer.capture.is_some();
    // Tables 15-3, 15-4, 16-2, 16-3, 18-3, 18-4: toggling in PWM modes is for OCnA, and in few of them.
    let toggles = match mode.kind {
        Kind::Normal | Kind::Ctc => true,
        _ if pin == 1 => false,
        _ if wide => matches!(mode.wgm, 9 | 11 | 14 | 15),
        _ => mode.top == Top::CompareA,
    };
    match random.below(if beginning { 8 } else { 7 }) {
        0..=2 if toggles => 1,
        0 | 3 | 4 => 2,
        7 => 0,
        _ => 3,
    }
}
