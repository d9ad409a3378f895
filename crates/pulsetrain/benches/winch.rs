//! The winch's figures on the virtual Uno, in cycles of the emulated chip. `cargo xtask bench winch` collects them.
//!
//! Prints a table with tabs between the fields: the quantity, its condition, the figure. A last field is `FAILS` if a
//! bound is broken.
#![allow(clippy::disallowed_methods, reason = "benches open their own files")]

use std::time::Duration;

use pulsetrain_board::virtual_uno::{CYCLES_PER_S, VirtualUno};
use pulsetrain_board::{Edge, Port};
use pulsetrain_trace::winch::{Command, SentLine, WinchOptions, WinchReport, judge};

/// STEP and DIR of x, y, z and a.
const STEP: [u8; 4] = [2, 3, 4, 12];
const DIR: [u8; 4] = [5, 6, 7, 13];
const ENABLE: u8 = 8;
const TICKS_PER_US: f64 = CYCLES_PER_S as f64 / 1e6;
const USB_FRAME: u64 = CYCLES_PER_S / 1000;
/// A byte of the bridge at 115 200 baud: 10 bits of 136 cycles.
const BYTE: u64 = 1360;

/// The stiffest and quickest gains, with which speeds are reached soon.
const QUICK: [&str; 2] = ["g xyza 5 1", "l xyza 10000 250000"];

/// Lines of 7 bytes a second that 115 200 baud carries: none may be lost.
const FULL_RATE: f64 = 115_200.0 / 70.0;

/// Share of its time that the original would need for four axes at 10 000 steps/s, of which it does not make all.
const MOST_LOAD: f64 = 0.795;

const AGAINST_PATH: &str = "steps against the path";
const TO_EFFECT: &str = "from a line's last byte to its effect";
/// The greatest delay of a line's effect, ms, that the judge and docs/winch.md allow.
const LONGEST_MS: f64 = 6.0;

fn main() {
    let uno = Uno::new();
    for speed in [0, 4000, 10_000] {
        let mut uno = uno.clone();
        uno.drift(&format!("{speed} {speed} {speed} {speed}"));
        load(&uno, &format!("{speed} steps/s each"));
    }
    // A constant speed costs the least time, since no axis accelerates.
    let mut swinging = uno.clone();
    swinging.drift("9000 9000 9000 9000");
    for line in ["g xyza 1 0.07", "d xyza 100 100 100 100"] {
        swinging.tell(line);
    }
    swinging.run(0.1);
    load(&swinging, "8400 to 9600 steps/s each, swinging");
    for speed in [100, 1234, 4000, 10_000] {
        spacing(&uno, &format!("{speed} steps/s, 4 axes"), [speed; 4]);
    }
    spacing(&uno, "10000, 9990, −9970 and 9930 steps/s", [10_000, 9990, -9970, 9930]);
    // The lines that cost the most time, at the line's full rate.
    effect(&uno, 0, None);
    effect(&uno, 0, Some("g yza 5 1"));
    for between in ["d y 0", "d yza 0 0 0", "g y 5 1", "g yza 5 1", "g yza 1.147198 0.333333"] {
        effect(&uno, 10_000, Some(between));
    }
    effect(&uno, 10_000, None);
    switching_on();
    commands(&uno);
}

fn load(uno: &Uno, at: &str) {
    let load = uno.load(0.5);
    row("load, 4 axes", at, &format!("{:.1} %", 100.0 * load), load <= MOST_LOAD);
}

fn row(what: &str, at: &str, figure: &str, holds: bool) {
    println!("{what}\t{at}\t{figure}\t{}", if holds { "" } else { "FAILS" });
}

#[derive(Clone)]
struct Uno {
    port: VirtualUno,
    edges: Vec<Edge>,
    text: Vec<u8>,
}

impl Uno {
    /// A board that has sent `awake`.
    fn start() -> Uno {
        let mut uno = Uno { port: VirtualUno::with_winch(), edges: Vec::new(), text: Vec::new() };
        uno.run(0.2);
        assert!(uno.text.starts_with(b"awake"), "it does not speak text");
        uno
    }

    /// A board that has got its first lines.
    fn new() -> Uno {
        let mut uno = Uno::start();
        for line in QUICK {
            uno.tell(line);
        }
        uno.run(0.1);
        uno
    }

    fn now(&self) -> u64 {
        self.port.chip().cycle() - self.port.zero().unwrap_or(0)
    }

    fn run(&mut self, seconds: f64) {
        let until = self.port.now() + Duration::from_secs_f64(seconds);
        while self.port.now() < until {
            self.port.receive(until, &mut self.text).expect("it is virtual");
            self.port.edges(&mut self.edges);
        }
    }

    /// Sends a line. Gives the tick at which its last byte arrives, if the line was free.
    fn tell(&mut self, line: &str) -> u64 {
        let cycle = self.port.chip().cycle();
        let there = (cycle / USB_FRAME + 1) * USB_FRAME + (line.len() as u64 + 1) * BYTE;
        self.port.send(format!("{line}\n").as_bytes()).expect("it is virtual");
        there - self.port.zero().unwrap_or(0)
    }

    /// Sends a line. Gives when it was sent.
    fn say(&mut self, line: &str) -> SentLine {
        let tick = self.tell(line);
        told_at(tick, line)
    }

    /// Number of refused lines since the text was last cleared.
    fn refused(&self) -> usize {
        self.text.windows(3).filter(|word| word == b"err").count()
    }

    /// The judge's verdict on the lines and the edges.
    fn judged(&self, told: &[SentLine]) -> WinchReport {
        let convert = |edge: &Edge| pulsetrain_trace::Edge { tick: edge.tick, line: edge.line, level: edge.level };
        let edges: Vec<_> = self.edges.iter().map(convert).collect();
        let options = WinchOptions { constant_ticks: 17.0, late_ticks: 60.0, ..WinchOptions::default() };
        judge(told, &edges, &[], self.now(), &options, &mut ()).expect("edges in order")
    }

    /// All axes at these speeds, for ever.
    fn drift(&mut self, speeds: &str) {
        self.tell(&format!("v xyza {speeds}"));
        self.run(3.0);
        self.edges.clear();
    }

    /// The share of the time that interrupts take, the paths among them. The measurement does not disturb the chip.
    fn load(&self, seconds: f64) -> f64 {
        /// Words of the table of vectors, without the reset's.
        const VECTORS: std::ops::Range<u16> = 2..52;
        let mut chip = self.port.chip().clone();
        let begin = chip.cycle();
        let end = begin + (seconds * CYCLES_PER_S as f64) as u64;
        // The stack pointer when the outermost interrupt came. The interrupt is over when the stack pointer is back
        // there.
        let (mut came_at, mut inside) = (None, 0);
        while chip.cycle() < end {
            let (before, stack) = (chip.cycle(), chip.sp());
            chip.step(&mut ());
            if came_at.is_none() && VECTORS.contains(&chip.pc()) && chip.sp() < stack {
                came_at = Some(stack);
            }
            if let Some(outside) = came_at {
                inside += chip.cycle() - before;
                came_at = Some(outside).filter(|outside| chip.sp() < *outside);
            }
        }
        inside as f64 / (chip.cycle() - begin) as f64
    }

    fn rises(&self, axis: usize) -> Vec<f64> {
        let rises = self.edges.iter().filter(|edge| edge.level && edge.line == STEP[axis]);
        rises.map(|edge| edge.tick as f64).collect()
    }

    /// Steps forward minus steps backward since the edges were last cleared.
    fn counted(&self, axis: usize) -> i64 {
        let (mut forward, mut count) = (true, 0);
        for edge in &self.edges {
            if edge.line == DIR[axis] {
                forward = edge.level;
            } else if edge.line == STEP[axis] && edge.level {
                count += if forward { 1 } else { -1 };
            }
        }
        count
    }
}

/// How far steps of constant speed are from the path, and how much their intervals differ.
fn spacing(uno: &Uno, at: &str, speeds: [i32; 4]) {
    let mut uno = uno.clone();
    // An axis that is behind its drift moves at its limit, so no axis catches up with another.
    for (axis, speed) in ["x", "y", "z", "a"].into_iter().zip(speeds) {
        uno.tell(&format!("l {axis} {} 250000", speed.abs()));
    }
    uno.drift(&speeds.map(|speed| speed.to_string()).join(" "));
    let seconds = if speeds[0] < 1000 { 10.0 } else { 2.0 };
    uno.run(seconds);
    let (mut errors, mut intervals) = (Vec::new(), Vec::new());
    for (axis, speed) in speeds.into_iter().enumerate() {
        let interval = CYCLES_PER_S as f64 / f64::from(speed.abs());
        let rises = uno.rises(axis);
        let wanted = seconds * f64::from(speed.abs());
        if (rises.len() as f64) < wanted - 2.0 {
            return row(AGAINST_PATH, at, &format!("{} steps of {wanted}", rises.len()), false);
        }
        let off: Vec<f64> = (0..).zip(&rises).map(|(n, tick)| tick - rises[0] - f64::from(n) * interval).collect();
        // The path's time up to a constant, which is the board's delay.
        let mean = off.iter().sum::<f64>() / off.len() as f64;
        errors.extend(off.iter().map(|off| (off - mean) / TICKS_PER_US));
        intervals.extend(rises.windows(2).map(|pair| (pair[1] - pair[0] - interval) / TICKS_PER_US));
    }
    let most = |values: &[f64]| values.iter().fold(0.0, |most: f64, value| most.max(value.abs()));
    let rms = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
    let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let p99 = sizes[sizes.len() * 99 / 100];
    let holds = p99 <= 4.0;
    let figure = format!("max {:.2} µs, 99 % {p99:.2} µs, rms {rms:.2} µs", most(&errors));
    row(AGAINST_PATH, at, &figure, holds);
    row("intervals against the exact one", at, &format!("max ±{:.2} µs", most(&intervals)), most(&intervals) <= 8.0);
}

/// A line and the tick at which it arrived.
fn told_at(tick: u64, line: &str) -> SentLine {
    SentLine { tick, until: tick, command: Command::parse(line).expect("a line") }
}

/// Prints a row with the times to an effect.
fn effect_row(at: &str, (least, most): (f64, f64), refused: usize, holds: bool) {
    let refused_too = if refused == 0 { String::new() } else { format!(" ({refused} refused)") };
    let holds = holds && refused == 0 && most <= LONGEST_MS;
    row(TO_EFFECT, at, &format!("{least:.2} to {most:.2} ms{refused_too}"), holds);
}

/// The time from a line's last byte to the slice of the path that obeys it, while the other axes go at `speed`.
/// `between`: a command that fills the line between these lines and changes no path.
fn effect(uno: &Uno, speed: u32, between: Option<&str>) {
    const LINES: usize = 60;
    let mut uno = uno.clone();
    let mut told: Vec<_> = QUICK.iter().map(|line| uno.say(line)).collect();
    uno.run(0.1);
    told.push(uno.say(&format!("v yza {speed} {speed} {speed}")));
    uno.run(1.0);
    let mut lines = (0..LINES).map(to_and_fro);
    if let Some(between) = between {
        // 37 ms of them come before each line, byte after byte.
        let fill = format!("{between}\n").repeat(435 / (between.len() + 1));
        let mut text = String::new();
        let cycle = uno.port.chip().cycle();
        let begin = (cycle / USB_FRAME + 1) * USB_FRAME - uno.port.zero().unwrap_or(0);
        for line in lines {
            text.push_str(&fill);
            text.push_str(&format!("{line}\n"));
            told.push(told_at(begin + text.len() as u64 * BYTE, &line));
        }
        uno.text.clear();
        uno.port.send(text.as_bytes()).expect("it is virtual");
        uno.run(text.len() as f64 * BYTE as f64 / CYCLES_PER_S as f64);
    } else {
        for line in lines.by_ref() {
            told.push(uno.say(&line));
            uno.run(0.0371);
        }
    }
    uno.run(0.05);
    let verdict = uno.judged(&told);
    let line = between.map_or("the line else free".to_owned(), |between| format!("the line full of `{between}`"));
    let at = format!("the other axes at {speed} steps/s, {line}, {LINES} lines");
    effect_row(&at, verdict.effect_ms.unwrap_or((f64::NAN, f64::NAN)), uno.refused(), verdict.ok);
}

/// The `n`th of the lines that reverse x. Spaces change when it ends, and nothing else.
fn to_and_fro(n: usize) -> String {
    let sign = if n.is_multiple_of(2) { "" } else { "-" };
    format!("v x {sign}5000{}", " ".repeat(n % 13))
}

/// The times of lines that switch the drivers on: a board's first one, and each one after an `enable 0`.
fn switching_on() {
    const LINES: usize = 60;
    let start = Uno::start();
    let first = |n| {
        let mut uno = start.clone();
        // The line's phase against the board's rounds.
        uno.run(n as f64 * 0.000_371);
        let told = uno.say(&to_and_fro(n));
        uno.run(0.3);
        (uno, vec![told])
    };
    let runs: Vec<_> = (0..LINES).map(first).collect();
    switching_on_row(&format!("the first line that a board is told, {LINES} times"), &runs);
    // No other lines: the figure is only about these.
    let (mut uno, mut told) = (start, Vec::new());
    for n in 0..LINES {
        told.push(uno.say(&to_and_fro(n)));
        uno.run(0.1371);
        told.push(uno.say("enable 0"));
        // The axis makes less than 1000 steps/s: it takes 30 ms to stop, and 20 ms at most to release.
        uno.run(0.0913);
    }
    switching_on_row(&format!("each behind `enable 0`, {LINES} lines"), &[(uno, told)]);
}

fn switching_on_row(which: &str, runs: &[(Uno, Vec<SentLine>)]) {
    let (mut span, mut refused, mut ok) = ((f64::INFINITY, f64::NEG_INFINITY), 0, true);
    for (uno, told) in runs {
        let verdict = uno.judged(told);
        // Each of them switched the drivers on, whose enable line is active low.
        let switched = uno.edges.iter().filter(|edge| edge.line == ENABLE && !edge.level).count();
        let wanted = told.iter().filter(|told| told.command.enables).count();
        ok &= verdict.ok && verdict.effect_ms.is_some() && switched == wanted;
        let (least, most) = verdict.effect_ms.unwrap_or(span);
        span = (span.0.min(least), span.1.max(most));
        refused += uno.refused();
    }
    effect_row(&format!("the drivers off until then, {which}"), span, refused, ok);
}

/// Sends lines back to back at the line's full rate, with the other axes at full speed.
fn commands(uno: &Uno) {
    const LINES: usize = 3000;
    let mut uno = uno.clone();
    uno.tell("srate 1000");
    uno.tell("v yza 10000 10000 10000");
    uno.run(1.0);
    uno.text.clear();
    uno.edges.clear();
    let line = "d x 10";
    uno.port.send(format!("{line}\n").repeat(LINES).as_bytes()).expect("it is virtual");
    let seconds = ((line.len() + 1) * LINES) as f64 * BYTE as f64 / CYCLES_PER_S as f64;
    uno.run(seconds + 6.0);
    let obeyed = uno.counted(0) as f64 / 10.0;
    let refused = uno.refused();
    let at = format!("`{line}`, {LINES} back to back, the other axes at 10000 steps/s");
    row("commands obeyed", &at, &format!("{obeyed} ({refused} refused)"), obeyed == LINES as f64);
    let rate = obeyed / seconds;
    row("commands a second at 115 200 baud", &at, &format!("{rate:.0}"), rate >= FULL_RATE);
}
