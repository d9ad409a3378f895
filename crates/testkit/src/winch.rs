//! A virtual board that gets StepperWinch's text, and core's paths to compare its steps with.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, VirtualBoard};
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::{Path, Slice};
use pulsetrain_core::winch::text::{Heard, LineReader};
use std::time::Duration;

/// STEP and DIR of the axes x, y, z and a on a CNC shield.
pub const PINS: [(u8, u8); 4] = [(2, 5), (3, 6), (4, 7), (12, 13)];
/// The drivers' common enable input on a CNC shield.
pub const ENABLE: u8 = 8;
/// Ticks of a slice of a path on an Uno: 1 ms.
pub const SLICE: u64 = Uno::SLICE;

/// A virtual board that obeys text, with the pins and timing of its axes.
pub trait Wired: VirtualBoard + Clone {
    /// Ticks of its clock per second.
    const CYCLES_PER_S: u64;
    /// STEP and DIR of each axis.
    const PINS: [(u8, u8); 4];
    /// The common enable pin of the drivers; low is on.
    const ENABLE: u8;
    /// By axis: ticks from a step's scheduled tick to its edge, without delays.
    const CONSTANT: [i64; 4];
    /// The shortest pulse, and the shortest DIR setup before it, ticks.
    const SHORTEST: [u64; 2];
    /// A board that has just started.
    fn start() -> Self;
    /// The ticks of a slice's steps, from the beginning of the slice.
    fn due(slice: Slice) -> Vec<u64>;
}

impl Wired for VirtualUno {
    const CYCLES_PER_S: u64 = pulsetrain_board::virtual_uno::CYCLES_PER_S;
    const PINS: [(u8, u8); 4] = PINS;
    const ENABLE: u8 = ENABLE;
    // STEP of x, y and z is on port D, that of a on port B.
    const CONSTANT: [i64; 4] = [17, 17, 17, 26];
    const SHORTEST: [u64; 2] = [30, 16];

    fn start() -> VirtualUno {
        VirtualUno::with_winch()
    }

    fn due(slice: Slice) -> Vec<u64> {
        let Some(train) = slice.train() else { return Vec::new() };
        let fraction = |step: u64| u64::from(train.first) + step * u64::from(train.interval);
        (0..train.count.into()).map(|step| fraction(step) >> 16).collect()
    }
}

impl Wired for VirtualPico {
    const CYCLES_PER_S: u64 = pulsetrain_board::virtual_pico::CYCLES_PER_S;
    const PINS: [(u8, u8); 4] = [(2, 3), (4, 5), (6, 7), (8, 9)];
    const ENABLE: u8 = 22;
    // The state machines make the edges at their ticks.
    const CONSTANT: [i64; 4] = [0; 4];
    const SHORTEST: [u64; 2] = [250, 625];

    fn start() -> VirtualPico {
        VirtualPico::new()
    }

    fn due(slice: Slice) -> Vec<u64> {
        slice.steps(Pico::SLICE as u32).into_iter().flat_map(|steps| steps.ticks()).map(u64::from).collect()
    }
}

/// A step, by the pins or by a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinStep {
    pub tick: u64,
    pub forward: bool,
}

/// A line of text from the board, and the tick at which it was complete.
#[derive(Clone, Debug)]
pub struct Line {
    pub tick: u64,
    pub text: String,
}

/// The content of a status line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    pub usec: i32,
    pub positions: [i32; 4],
}

/// A board, with the lines that it sent and the edges of its pins.
#[derive(Clone)]
pub struct WinchLab<B> {
    pub port: B,
    pub edges: Vec<Edge>,
    pub lines: Vec<Line>,
    pub partial: Vec<u8>,
}

pub type Uno = WinchLab<VirtualUno>;
pub type Pico = WinchLab<VirtualPico>;

impl<B: Wired> WinchLab<B> {
    /// Ticks of a slice.
    pub const SLICE: u64 = B::CYCLES_PER_S / 1000;

    /// A board that has sent `awake`.
    pub fn new() -> WinchLab<B> {
        let mut lab = WinchLab::around(B::start());
        lab.run_ms(80);
        assert_eq!(lab.lines[0].text, "awake");
        lab
    }

    /// A lab for a board from which no byte was read yet.
    pub fn around(port: B) -> WinchLab<B> {
        WinchLab { port, edges: Vec::new(), lines: Vec::new(), partial: Vec::new() }
    }

    /// The board's clock, ticks.
    pub fn now(&self) -> u64 {
        let cycle = (self.port.now().as_nanos() * u128::from(B::CYCLES_PER_S)).div_ceil(1_000_000_000);
        cycle as u64 - self.port.zero().unwrap_or(0)
    }

    /// Sends a line, and waits until the board has received it.
    pub fn say(&mut self, line: &str) -> SentLine {
        self.send(format!("{line}\n"));
        // One USB frame, and 87 µs for each byte.
        self.run_ms(2 + line.len() as u64 / 11);
        SentLine { tick: self.now() - Self::SLICE, line: line.to_owned() }
    }

    /// Sends bytes without waiting.
    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.port.send(bytes.as_ref()).expect("it is virtual");
    }

    pub fn run_ms(&mut self, ms: u64) {
        let until = self.port.now() + Duration::from_millis(ms);
        while self.port.now() < until {
            let mut bytes = Vec::new();
            self.port.receive(until, &mut bytes).expect("it is virtual");
            self.port.edges(&mut self.edges);
            for byte in bytes {
                // Hosts that send frames have zeros between them.
                if byte == 0 {
                    self.partial.clear();
                } else if byte != b'\n' {
                    self.partial.push(byte);
                }
                if byte != b'\n' {
                    continue;
                }
                let line = String::from_utf8(std::mem::take(&mut self.partial)).expect("text");
                let text = line.strip_suffix('\r').expect("CR LF").to_owned();
                self.lines.push(Line { tick: self.now(), text });
            }
        }
    }

    /// Sends a line, and returns the lines that the board sent within `ms` milliseconds, without status lines.
    pub fn ask(&mut self, line: &str, ms: u64) -> Vec<String> {
        let had = self.lines.len();
        self.send(format!("{line}\n"));
        self.run_ms(ms);
        self.lines[had..].iter().map(|line| line.text.clone()).filter(|text| !text.starts_with("txyza")).collect()
    }

    pub fn statuses(&self) -> Vec<Status> {
        let numbers = |line: &Line| {
            let words: Vec<i32> =
                line.text.strip_prefix("txyza ")?.split(' ').map(|word| word.parse().expect("a number")).collect();
            let [usec, positions @ ..] = words[..].first_chunk::<5>().expect("six words");
            assert_eq!(words.len(), 5, "{line:?}");
            Some(Status { usec: *usec, positions: *positions })
        };
        self.lines.iter().filter_map(numbers).collect()
    }

    /// The steps of an axis by its pins. Checks the length of each pulse, and the DIR setup.
    pub fn steps(&self, axis: usize) -> Vec<PinStep> {
        let ((step, dir), [pulse, setup]) = (B::PINS[axis], B::SHORTEST);
        let (mut forward, mut turned, mut begun, mut ended) = (false, 0, None, 0);
        let mut steps = Vec::new();
        for edge in self.edges.iter().filter(|edge| edge.line == step || edge.line == dir) {
            if edge.line == dir {
                assert!(begun.is_none() && edge.tick >= ended + pulse / 2, "axis {axis}: DIR turns at {}", edge.tick);
                (forward, turned) = (edge.level, edge.tick);
            } else if edge.level {
                assert!(edge.tick >= turned + setup, "axis {axis}: DIR has turned {} ticks before", edge.tick - turned);
                steps.push(PinStep { tick: edge.tick, forward });
                begun = Some(edge.tick);
            } else if let Some(begun) = begun.take() {
                assert!(edge.tick - begun >= pulse, "axis {axis}: a pulse of {} ticks", edge.tick - begun);
                ended = edge.tick;
            }
        }
        steps
    }

    /// The count of each axis before a tick, by its pins.
    pub fn counted(&self, tick: u64) -> [i32; 4] {
        std::array::from_fn(|axis| {
            self.steps(axis)
                .iter()
                .take_while(|step| step.tick < tick)
                .map(|step| if step.forward { 1 } else { -1 })
                .sum()
        })
    }

    /// Checks that the positions of every status line are those of the pins, at some tick within the microsecond of the line.
    pub fn check_positions(&self) {
        let steps: Vec<_> = (0..4).map(|axis| self.steps(axis)).collect();
        for status in self.statuses() {
            let us = B::CYCLES_PER_S / 1_000_000;
            let tick = u64::from(status.usec.cast_unsigned()) * us;
            for (axis, steps) in steps.iter().enumerate() {
                let count = |tick: u64| -> i32 {
                    steps.iter().take_while(|step| step.tick < tick).map(|step| if step.forward { 1 } else { -1 }).sum()
                };
                let possible: Vec<_> = (0..6).map(|more| count(tick + more * 5 * us)).collect();
                assert!(possible.contains(&status.positions[axis]), "{status:?}: axis {axis} had {possible:?}");
            }
        }
    }
}

/// Core's paths of four axes, and their steps, slice by slice.
#[derive(Clone)]
pub struct PathModel<B> {
    reader: LineReader,
    paths: [Path; 4],
    pub steps: [Vec<PinStep>; 4],
    /// The next slice.
    pub slice: u64,
    board: std::marker::PhantomData<B>,
}

impl<B: Wired> PathModel<B> {
    pub fn new() -> PathModel<B> {
        let (reader, paths) = (LineReader::new(), [const { Path::new() }; 4]);
        PathModel { reader, paths, steps: Default::default(), slice: 0, board: std::marker::PhantomData }
    }

    /// Computes the paths up to a slice.
    pub fn run_to(&mut self, slice: u64) {
        while self.slice < slice {
            for (path, steps) in self.paths.iter_mut().zip(&mut self.steps) {
                let slice = path.tick();
                let begin = self.slice * WinchLab::<B>::SLICE;
                let step = |tick: u64| PinStep { tick: begin + tick, forward: !slice.backward };
                steps.extend(B::due(slice).into_iter().map(step));
            }
            self.slice += 1;
        }
    }

    pub fn obey(&mut self, line: &str) {
        for byte in format!("{line}\n").bytes() {
            if let Heard::Command(_) = self.reader.push::<InMemory>(byte) {
                self.reader.obey(&mut self.paths);
            }
        }
    }
}

/// A line acts on one of this many slices from the one in which it arrived.
pub const SLICES: u64 = 8;

/// A line that was sent, and the tick at which the board had it.
#[derive(Clone, Debug)]
pub struct SentLine {
    pub tick: u64,
    pub line: String,
}

/// Finds for each line the slice at which the board obeyed it, on all axes at the same time, such that core's paths have the steps that were made.
/// Returns how late the edges were, ticks, by axis, and the longest time from a line to its slice.
///
/// # Errors
/// When there are no such slices.
pub fn follow<B: Wired>(lab: &WinchLab<B>, said: &[SentLine]) -> Result<([Vec<i64>; 4], u64), String> {
    let made: [Vec<PinStep>; 4] = std::array::from_fn(|axis| lab.steps(axis));
    let (mut model, mut longest) = (PathModel::<B>::new(), 0);
    for (at, SentLine { tick, line }) in said.iter().enumerate() {
        let first = tick.div_ceil(WinchLab::<B>::SLICE);
        // Compare up to where the next line may act.
        let until =
            said.get(at + 1).map_or(lab.now() / WinchLab::<B>::SLICE - 2, |next| next.tick / WinchLab::<B>::SLICE);
        let mut why = String::new();
        let found = (first..=first + SLICES).find_map(|slice| {
            let mut model = model.clone();
            if at == 0 {
                model.slice = slice;
            }
            model.run_to(slice);
            model.obey(line);
            let obeyed = model.clone();
            model.run_to(until);
            match compare(&made, &model, until * WinchLab::<B>::SLICE) {
                Ok(_) => Some((obeyed, slice)),
                Err(error) => {
                    why = error;
                    None
                }
            }
        });
        let Some((obeyed, slice)) = found else { return Err(format!("{line:?} at {tick}: {why}")) };
        longest = longest.max(slice * WinchLab::<B>::SLICE - tick);
        model = obeyed;
    }
    let end = lab.now() / WinchLab::<B>::SLICE - 2;
    model.run_to(end);
    compare(&made, &model, end * WinchLab::<B>::SLICE).map(|late| (late, longest))
}

/// Compares all steps before a tick with those of the model. Returns how late they were, ticks, by axis.
///
/// # Errors
/// The first difference.
fn compare<B: Wired>(made: &[Vec<PinStep>; 4], model: &PathModel<B>, until: u64) -> Result<[Vec<i64>; 4], String> {
    let mut all: [Vec<i64>; 4] = Default::default();
    for (axis, late) in all.iter_mut().enumerate() {
        // A step just at the end may come before or after it.
        let (soon, sure) = (until + 200, until.saturating_sub(200));
        let (made, wanted) = (&made[axis], &model.steps[axis]);
        let counts = |steps: &[PinStep], tick| steps.partition_point(|step| step.tick < tick);
        if counts(made, sure) > counts(wanted, soon) || counts(wanted, sure) > counts(made, soon) {
            return Err(format!("axis {axis}: {} steps, not {}", counts(made, sure), counts(wanted, sure)));
        }
        for (at, (made, wanted)) in made.iter().zip(&wanted[..counts(wanted, sure)]).enumerate() {
            let ticks = made.tick as i64 - wanted.tick as i64 - B::CONSTANT[axis];
            if made.forward != wanted.forward || ticks.abs() > 400 {
                return Err(format!("axis {axis}, step {at}: {made:?}, not {wanted:?}: {ticks} ticks late"));
            }
            late.push(ticks);
        }
    }
    Ok(all)
}
