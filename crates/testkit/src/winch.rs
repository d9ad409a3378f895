//! A virtual board that is spoken to as clients of the winch do, and core's paths beside it.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, VirtualBoard};
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::{Path, Slice};
use pulsetrain_core::winch::text::{Heard, LineReader};
use std::time::Duration;

/// STEP and DIR of the axes on a CNC shield; ENABLE.
pub const PINS: [(u8, u8); 4] = [(2, 5), (3, 6), (4, 7), (12, 13)];
pub const ENABLE: u8 = 8;
/// Ticks of an Uno's slice.
pub const SLICE: u64 = Uno::SLICE;

/// A board that speaks text, with the pins and times of its axes.
pub trait Wired: VirtualBoard + Clone {
    /// STEP and DIR.
    const PINS: [(u8, u8); 4];
    /// Of all drivers; low is on.
    const ENABLE: u8;
    /// From the tick of a step to its edge, without delays.
    const CONSTANT: [i64; 4];
    /// The shortest pulse, and set-up of DIR before it, ticks.
    const SHORTEST: [u64; 2];
    /// One that has just started.
    fn start() -> Self;
    /// When the steps of a slice are due, ticks from its beginning.
    fn due(slice: Slice) -> Vec<u64>;
}

impl Wired for VirtualUno {
    const PINS: [(u8, u8); 4] = PINS;
    const ENABLE: u8 = ENABLE;
    // Ports D and B.
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
    const PINS: [(u8, u8); 4] = [(2, 3), (4, 5), (6, 7), (8, 9)];
    const ENABLE: u8 = 22;
    // The state machines make them.
    const CONSTANT: [i64; 4] = [0; 4];
    const SHORTEST: [u64; 2] = [250, 625];

    fn start() -> VirtualPico {
        VirtualPico::new()
    }

    fn due(slice: Slice) -> Vec<u64> {
        slice.steps(Pico::SLICE as u32).into_iter().flat_map(|steps| steps.ticks()).map(u64::from).collect()
    }
}

/// A step as a pin showed it, or as a path has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    pub tick: u64,
    pub forward: bool,
}

/// A line from the board, and when it was there, ticks.
#[derive(Clone, Debug)]
pub struct Line {
    pub tick: u64,
    pub text: String,
}

/// What a status line says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    pub usec: i32,
    pub positions: [i32; 4],
}

/// A board, what it said and what its pins did.
#[derive(Clone)]
pub struct Lab<B> {
    pub port: B,
    pub edges: Vec<Edge>,
    pub lines: Vec<Line>,
    pub partial: Vec<u8>,
}

pub type Uno = Lab<VirtualUno>;
pub type Pico = Lab<VirtualPico>;

impl<B: Wired> Lab<B> {
    /// Ticks of a slice.
    pub const SLICE: u64 = B::CYCLES_PER_S / 1000;

    /// One that said `awake`.
    pub fn new() -> Lab<B> {
        let mut lab = Lab::around(B::start());
        lab.run_ms(80);
        assert_eq!(lab.lines[0].text, "awake");
        lab
    }

    /// Of a board that nobody has listened to.
    pub fn around(port: B) -> Lab<B> {
        Lab { port, edges: Vec::new(), lines: Vec::new(), partial: Vec::new() }
    }

    /// The board's clock, ticks.
    pub fn now(&self) -> u64 {
        let cycle = (self.port.now().as_nanos() * u128::from(B::CYCLES_PER_S)).div_ceil(1_000_000_000);
        cycle as u64 - self.port.zero().unwrap_or(0)
    }

    /// Sends a line, and waits until the board has it.
    pub fn say(&mut self, line: &str) -> Said {
        self.send(format!("{line}\n"));
        // USB's frame, and 87 µs a byte.
        self.run_ms(2 + line.len() as u64 / 11);
        Said { tick: self.now() - Self::SLICE, line: line.to_owned() }
    }

    /// Sends bytes, at once.
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
                // Frames' hosts have zeros between.
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

    /// Sends a line and gives what the board said within `ms`, but for status lines.
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

    /// The pulses of an axis, each of the right length and with DIR in time.
    pub fn steps(&self, axis: usize) -> Vec<Step> {
        let ((step, dir), [pulse, setup]) = (B::PINS[axis], B::SHORTEST);
        let (mut forward, mut turned, mut begun, mut ended) = (false, 0, None, 0);
        let mut steps = Vec::new();
        for edge in self.edges.iter().filter(|edge| edge.line == step || edge.line == dir) {
            if edge.line == dir {
                assert!(begun.is_none() && edge.tick >= ended + pulse / 2, "axis {axis}: DIR turns at {}", edge.tick);
                (forward, turned) = (edge.level, edge.tick);
            } else if edge.level {
                assert!(edge.tick >= turned + setup, "axis {axis}: DIR has turned {} ticks before", edge.tick - turned);
                steps.push(Step { tick: edge.tick, forward });
                begun = Some(edge.tick);
            } else if let Some(begun) = begun.take() {
                assert!(edge.tick - begun >= pulse, "axis {axis}: a pulse of {} ticks", edge.tick - begun);
                ended = edge.tick;
            }
        }
        steps
    }

    /// What the pins have counted of each axis before a tick.
    pub fn counted(&self, tick: u64) -> [i32; 4] {
        std::array::from_fn(|axis| {
            self.steps(axis)
                .iter()
                .take_while(|step| step.tick < tick)
                .map(|step| if step.forward { 1 } else { -1 })
                .sum()
        })
    }

    /// Every status line says what the pins had counted, to within the time that its clock has.
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

/// Four of core's paths and their steps, slice by slice.
#[derive(Clone)]
pub struct Model<B> {
    reader: LineReader,
    paths: [Path; 4],
    pub steps: [Vec<Step>; 4],
    /// The next slice.
    pub slice: u64,
    board: std::marker::PhantomData<B>,
}

impl<B: Wired> Model<B> {
    pub fn new() -> Model<B> {
        let (reader, paths) = (LineReader::new(), [const { Path::new() }; 4]);
        Model { reader, paths, steps: Default::default(), slice: 0, board: std::marker::PhantomData }
    }

    /// Goes on to a slice.
    pub fn run_to(&mut self, slice: u64) {
        while self.slice < slice {
            for (path, steps) in self.paths.iter_mut().zip(&mut self.steps) {
                let slice = path.tick();
                let begin = self.slice * Lab::<B>::SLICE;
                let step = |tick: u64| Step { tick: begin + tick, forward: !slice.backward };
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

/// The latest slice, counted from when a line came, that acts on it.
pub const SLICES: u64 = 8;

/// A line was sent so that the board had it at a tick.
#[derive(Clone, Debug)]
pub struct Said {
    pub tick: u64,
    pub line: String,
}

/// Finds the slices at which the board did what lines say, each on all axes at once, so that the paths have the steps that
/// were made. Gives how late the edges were, ticks, by axis, and the longest way from a line to its slice.
pub fn follow<B: Wired>(lab: &Lab<B>, said: &[Said]) -> Result<([Vec<i64>; 4], u64), String> {
    let made: [Vec<Step>; 4] = std::array::from_fn(|axis| lab.steps(axis));
    let (mut model, mut longest) = (Model::<B>::new(), 0);
    for (at, Said { tick, line }) in said.iter().enumerate() {
        let first = tick.div_ceil(Lab::<B>::SLICE);
        // Until the next line may act.
        let until = said.get(at + 1).map_or(lab.now() / Lab::<B>::SLICE - 2, |next| next.tick / Lab::<B>::SLICE);
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
            match compare(&made, &model, until * Lab::<B>::SLICE) {
                Ok(_) => Some((obeyed, slice)),
                Err(error) => {
                    why = error;
                    None
                }
            }
        });
        let Some((obeyed, slice)) = found else { return Err(format!("{line:?} at {tick}: {why}")) };
        longest = longest.max(slice * Lab::<B>::SLICE - tick);
        model = obeyed;
    }
    let end = lab.now() / Lab::<B>::SLICE - 2;
    model.run_to(end);
    compare(&made, &model, end * Lab::<B>::SLICE).map(|late| (late, longest))
}

/// Whether all steps before a tick are those of the model, and how late they were.
fn compare<B: Wired>(made: &[Vec<Step>; 4], model: &Model<B>, until: u64) -> Result<[Vec<i64>; 4], String> {
    let mut all: [Vec<i64>; 4] = Default::default();
    for (axis, late) in all.iter_mut().enumerate() {
        // A step at the end may be on either side of it.
        let (soon, sure) = (until + 200, until.saturating_sub(200));
        let (made, wanted) = (&made[axis], &model.steps[axis]);
        let counts = |steps: &[Step], tick| steps.partition_point(|step| step.tick < tick);
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
