//! Runs a short motion on a virtual board as `pulsetrain run` does, while something goes wrong, and describes the
//! result.

use super::line::{Fault, Line};
use pulsetrain::console::access;
use pulsetrain::load;
use pulsetrain::report::record::{Files, Recorder, Unwritten};
use pulsetrain_board::skewed::Skewed;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::{self, VirtualUno};
use pulsetrain_board::{Edge, Port, Remote, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_plot::machine::Drawn;
use pulsetrain_session::control::{Knowledge, Positions};
use pulsetrain_session::drive::{DriveError, Driven, connect_as};
use pulsetrain_session::lateness::Edges;
use pulsetrain_session::prepare::Prepared;
use std::cell::Cell;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// Two motors; on an Uno, STEP is on the pins that the compare hardware times.
const MOTORS: &str = r#"
board = "BOARD"
tolerance = "1 tick"

[motor.a]
steps_per_rev = 200
driver = "A4988"
pins = { step = STEP0, dir = DIR0 }
forward = "high"
max_acceleration = "10000 step/s^2"
pull_in = "100 step/s"

[motor.b]
steps_per_rev = 200
driver = "A4988"
pins = { step = STEP1, dir = DIR1 }
forward = "high"
max_acceleration = "10000 step/s^2"
pull_in = "100 step/s"
"#;

/// A motion forward and back for 1.4 s. The motors come to rest within 0.1 s, and their queues last some 0.5 s.
const MOTION: &str = r#"
[[motion]]
motor = "a"
law.trapezoid = { distance = "500 step", speed = "800 step/s", acceleration = "9000 step/s^2" }
[[motion]]
motor = "a"
law.trapezoid = { distance = "-400 step", speed = "800 step/s", acceleration = "9000 step/s^2" }

[[motion]]
motor = "b"
start = "0.1 s"
law.trapezoid = { distance = "-600 step", speed = "600 step/s", acceleration = "5000 step/s^2" }
"#;

/// The motors' positions at its end.
const END: [i64; 2] = [100, -600];

/// A motion of the same motors for 0.1 s: each of its bytes is tried with each fault.
const SHORT_MOTION: &str = r#"
[[motion]]
motor = "a"
law.trapezoid = { distance = "12 step", speed = "400 step/s", acceleration = "9000 step/s^2" }
[[motion]]
motor = "a"
law.trapezoid = { distance = "-8 step", speed = "400 step/s", acceleration = "9000 step/s^2" }

[[motion]]
motor = "b"
law.trapezoid = { distance = "-20 step", speed = "600 step/s", acceleration = "9000 step/s^2" }
"#;

/// The motors' positions at its end.
const SHORT_END: [i64; 2] = [4, -20];

const MAX_ACCELERATION: f64 = 10_000.0;
const PULL_IN: f64 = 100.0;

/// A host gives a board up after 1.9 s, a board a host after 2 s. This is somewhat longer.
const GIVEN_UP: Duration = Duration::from_millis(2500);

/// A virtual board with a firmware.
pub(crate) trait Chip: VirtualBoard + Clone {
    /// Ticks of its clock in a second.
    const CYCLES_PER_S: u64;
    /// Its name in motion files.
    const NAME: &str;
    /// STEP and DIR of each motor.
    const PINS: [(u8, u8); 2];
    /// Makes its main loop hang for ever. Interrupts go on.
    fn hang(&mut self);
}

impl Chip for VirtualUno {
    const CYCLES_PER_S: u64 = pulsetrain_board::virtual_uno::CYCLES_PER_S;
    const NAME: &str = "uno";
    const PINS: [(u8, u8); 2] = [(9, 8), (10, 7)];

    fn hang(&mut self) {
        // RJMP to itself (DS40002061B, 31). The firmware has one, for panics.
        let forever = virtual_uno::image().chunks_exact(2).position(|word| word == 0xcfff_u16.to_le_bytes());
        while !self.chip().is_asleep() {
            self.chip_mut().step(&mut ());
        }
        self.chip_mut().set_pc(forever.expect("a loop to itself") as u16);
    }
}

impl Chip for VirtualPico {
    const CYCLES_PER_S: u64 = pulsetrain_board::virtual_pico::CYCLES_PER_S;
    const NAME: &str = "pico";
    const PINS: [(u8, u8); 2] = [(2, 3), (4, 5)];

    fn hang(&mut self) {
        // A branch to itself at the end of RAM, which is free.
        const FOREVER: u32 = 0x2003_c000;
        let run_on = |pico: &mut VirtualPico| {
            let soon = pico.now() + Duration::from_nanos(8);
            pico.receive(soon, &mut Vec::new()).expect("a virtual port is always there");
        };
        // Only the main loop sleeps. In its mode, when no interrupt is served, it can be made to jump there.
        while !self.chip().cpu().is_asleep() {
            run_on(self);
        }
        let main = self.chip().cpu().mode();
        while self.chip().cpu().is_asleep() || self.chip().cpu().mode() != main || self.chip().cpu().primask() {
            run_on(self);
        }
        let at = (FOREVER - 0x2000_0000) as usize;
        self.chip_mut().ram_mut()[at..at + 2].copy_from_slice(&0xe7fe_u16.to_le_bytes());
        self.chip_mut().cpu_mut().set_register(15, FOREVER);
    }
}

/// A board whose clock is off.
impl<P: Chip> Chip for Skewed<P> {
    const CYCLES_PER_S: u64 = P::CYCLES_PER_S;
    const NAME: &str = P::NAME;
    const PINS: [(u8, u8); 2] = P::PINS;

    fn hang(&mut self) {
        unreachable!("a board whose clock is off has no other fault here");
    }
}

/// A step as its driver sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Step {
    pub(crate) tick: u64,
    pub(crate) sign: i64,
}

/// The steps of each motor on the pins.
pub(crate) type Steps = [Vec<Step>; 2];

fn steps_of<P: Chip>(edges: &[Edge]) -> Steps {
    let mut forward = [false; 2];
    let mut steps = Steps::default();
    for edge in edges {
        for (motor, (step, dir)) in P::PINS.into_iter().enumerate() {
            if edge.line == dir {
                forward[motor] = edge.level;
            } else if edge.line == step && edge.level {
                steps[motor].push(Step { tick: edge.tick, sign: if forward[motor] { 1 } else { -1 } });
            }
        }
    }
    steps
}

/// Steps forward minus steps backward.
pub(crate) fn counts(steps: &Steps) -> Vec<i64> {
    steps.iter().map(|steps| steps.iter().map(|step| step.sign).sum()).collect()
}

/// How the motors moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Moved {
    /// Each step came in its tick of the clean run, and no other step came.
    AsPlanned,
    /// As planned up to a step, then a stop within the limits.
    Tail,
    /// As planned up to a step, then no further step.
    Halted,
    /// No step came.
    NotAtAll,
    /// As planned if enough was queued, else as planned up to a step and then a stop within the limits.
    AsQueued,
    /// By the lines that arrived whole.
    ByWholeLines,
}

impl Moved {
    pub(crate) const fn in_words(self) -> &'static str {
        match self {
            Moved::AsPlanned => "as planned, each step in its tick",
            Moved::Tail => "as planned, then a stop within the limits",
            Moved::Halted => "as planned, then they stop at once",
            Moved::NotAtAll => "nothing moved",
            Moved::AsQueued => "as planned if the queue lasts that long; else a stop within the limits, and 1",
            Moved::ByWholeLines => "obey the lines that arrive undamaged; for the others, `err`",
        }
    }
}

/// The result of a run.
#[derive(Debug)]
pub(crate) struct Seen {
    moved: Moved,
    /// The error for the user, if there was one.
    pub(crate) error: Option<DriveError>,
    pub(crate) steps: Steps,
    /// Only planned steps came, from the first one on.
    is_part: bool,
}

/// Number of benches that were made: each has a file of its own.
static BENCHES: AtomicU32 = AtomicU32::new(0);

/// A board, and its run without a fault.
pub(crate) struct Bench<P> {
    fresh: P,
    file: PathBuf,
    prepared: Prepared,
    clean: Steps,
    /// When the first and the last step came, ticks.
    pub(crate) first: u64,
    pub(crate) last: u64,
    /// The line of that run, which knows its number of bytes.
    pub(crate) line: Line<P>,
}

impl<P: Chip> Bench<P> {
    /// A bench for a board that is plugged in, with its port open.
    pub(crate) fn new(fresh: P) -> Bench<P> {
        Bench::of(fresh, "long", MOTION, END)
    }

    /// A bench with a motion whose session is so short that each of its bytes can be tried.
    pub(crate) fn short(fresh: P) -> Bench<P> {
        Bench::of(fresh, "short", SHORT_MOTION, SHORT_END)
    }

    fn of(fresh: P, name: &str, motion: &str, end: [i64; 2]) -> Bench<P> {
        let [(step0, dir0), (step1, dir1)] = P::PINS;
        let pins = [("STEP0", step0), ("DIR0", dir0), ("STEP1", step1), ("DIR1", dir1)];
        let text = pins.iter().fold(format!("{MOTORS}{motion}").replace("BOARD", P::NAME), |text, (name, pin)| {
            text.replace(name, &pin.to_string())
        });
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!(
            "faults-{name}-{}-{}-{}.toml",
            P::NAME,
            std::process::id(),
            BENCHES.fetch_add(1, Ordering::Relaxed)
        ));
        std::fs::write(&file, &text).expect("a folder for tests");
        let prepared = load::load(&file, None, None).expect("it is a motion file");
        let line = Line::new(fresh.clone(), Fault::Nothing);
        let error = drive(&prepared, &line, 1);
        assert!(error.is_none(), "{}: {error:?}", P::NAME);
        let clean = steps_of::<P>(&line.all_edges());
        assert_eq!(counts(&clean), end, "{}", P::NAME);
        let ticks = || clean.iter().flatten().map(|step| step.tick);
        let (first, last) = (ticks().min().expect("steps"), ticks().max().expect("steps"));
        Bench { fresh, file, prepared, clean, first, last, line }
    }

    /// All steps of the clean run, ticks.
    pub(crate) fn ticks(&self) -> Vec<u64> {
        self.clean.iter().flatten().map(|step| step.tick).collect()
    }

    /// From the first step to the last, ms.
    pub(crate) fn length_ms(&self) -> u64 {
        (self.last - self.first) * 1000 / P::CYCLES_PER_S
    }

    pub(crate) fn ticks_of(&self, ms: u64) -> u64 {
        ms * P::CYCLES_PER_S / 1000
    }

    /// Runs the motion with a fault.
    pub(crate) fn run(&self, fault: Fault) -> (Seen, Line<P>) {
        let line = Line::new(self.fresh.clone(), fault);
        let error = drive(&self.prepared, &line, 1);
        if error.is_some() {
            line.leave_alone(GIVEN_UP);
        }
        (self.judge(error, &line.all_edges()), line)
    }

    /// The board, with a clock that is fast by some ppm.
    pub(crate) fn skewed(&self, ppm: i32) -> Skewed<P> {
        Skewed::new(self.fresh.clone(), ppm)
    }

    /// Runs the motion on another board of the kind.
    pub(crate) fn run_on<Q: Chip>(&self, board: Q) -> Seen {
        let line = Line::new(board, Fault::Nothing);
        let error = drive(&self.prepared, &line, 1);
        self.judge(error, &line.all_edges())
    }

    /// Runs the motion while its file is overwritten, and removed.
    pub(crate) fn run_without_file(&self) -> Seen {
        let line = Line::new(self.fresh.clone(), Fault::Nothing);
        let prepared = load::load(&self.file, None, None).expect("it is a motion file");
        let mut driven =
            Driven::with(&prepared, |program| connect_as(line.clone(), program, Baud::B1M, 1)).expect("it begins");
        let mut looks = 0;
        let ended = driven.run(&mut |_: Edge| {}, |_| {
            looks += 1;
            match looks {
                3 => std::fs::write(&self.file, "board = 1").expect("it is ours"),
                5 => std::fs::remove_file(&self.file).expect("it is ours"),
                _ => {}
            }
        });
        assert!(looks > 5 && !self.file.exists(), "too late: {looks}");
        self.judge(ended.err(), &line.all_edges())
    }

    /// Runs the motion while its edges are written to a disk that gets full after some bytes. Also gives the error for
    /// the user.
    pub(crate) fn run_on_full_disk(&self, bytes: usize) -> (Seen, String) {
        let line = Line::new(self.fresh.clone(), Fault::Nothing);
        let planned = self.prepared.plan(|_| {}).expect("it is planned");
        let mut driven =
            Driven::with(&self.prepared, |program| connect_as(line.clone(), program, Baud::B1M, 1)).expect("it begins");
        let disk = || Disk { room: bytes };
        let program = &self.prepared.program;
        let files = Files::new(program, &driven.lines, |_| Some(Ok(disk())));
        let drawn = Drawn::of(program);
        let until = Cell::new(None);
        let edges = Edges::of(program);
        let recorder = Recorder::new(program, &drawn, &driven.lines, String::new(), files.ok(), &edges, &until);
        let mut recorder = recorder.expect("it begins");
        let ended = driven.run(&mut recorder, |_| {});
        // The verdict is there all the same.
        let recorded = recorder.finish(&planned, driven.lateness().unwrap()).expect("a verdict");
        assert!(recorded.verdict.ok, "{}", recorded.verdict);
        let Unwritten { file, error } = recorded.unwritten.expect("the disk is full");
        let error = access("write", &Path::new("out").join(file.name()), error);
        (self.judge(ended.err(), &line.all_edges()), error.to_string())
    }

    /// Compares the pins with the clean run.
    fn judge(&self, error: Option<DriveError>, edges: &[Edge]) -> Seen {
        let steps = steps_of::<P>(edges);
        let first = steps.iter().filter_map(|steps| steps.first()).map(|step| step.tick).min();
        let Some(first) = first else { return Seen { moved: Moved::NotAtAll, error, steps, is_part: true } };
        let (mut moved, mut is_part) = (Moved::AsPlanned, true);
        for (steps, clean) in steps.iter().zip(&self.clean) {
            let same = steps.iter().zip(clean).take_while(|(step, clean)| {
                step.tick.wrapping_sub(first) == clean.tick - self.first && step.sign == clean.sign
            });
            let same = same.count();
            is_part &= steps.len() == same;
            moved = moved.max(if (steps.len(), clean.len()) == (same, same) {
                Moved::AsPlanned
            } else if stops::<P>(&steps[same.saturating_sub(LOOK_BACK)..]) {
                Moved::Tail
            } else {
                assert_eq!(steps.len(), same, "{}: steps of nobody's", P::NAME);
                Moved::Halted
            });
        }
        let seen = Seen { moved, error, steps, is_part };
        seen.check();
        seen
    }

    /// The next host finds the board at rest, with counts that agree with the pins unless it was reset. Nothing moves
    /// until that host says so, and then all goes as planned.
    pub(crate) fn check_next(&self, seen: &Seen, line: &Line<P>, again: bool) {
        line.set(Fault::Nothing);
        line.clone().set_baud(Baud::B115200).expect("it can");
        let mut next = Remote::open(line.clone(), 2).expect("the host before was silent for too long");
        let status = next.status().expect("it answers");
        assert!(status.is_idle(), "{}", P::NAME);
        let said: Vec<i64> = status.motors.as_slice().iter().map(|motor| i64::from(motor.position)).collect();
        if seen.was_reset() {
            assert!(said.iter().all(|count| *count == 0), "{}: {said:?}", P::NAME);
        } else {
            assert_eq!(said, counts(&seen.steps), "{}: counted steps are pulses", P::NAME);
        }
        let (step_pins, dirs) = (P::PINS.map(|pins| pins.0), P::PINS.map(|pins| pins.1));
        line.forget_edges(&dirs);
        line.leave_alone(Duration::from_millis(100));
        let moved = line.all_edges().iter().any(|edge| step_pins.contains(&edge.line) && edge.level);
        assert!(!moved, "{}: it moves, and nobody said so", P::NAME);
        drop(next.close());
        if again {
            let error = drive(&self.prepared, line, 3);
            assert!(error.is_none(), "{}: {error:?}", P::NAME);
            let seen = self.judge(None, &line.all_edges());
            assert_eq!(seen.moved, Moved::AsPlanned, "{}: from there on", P::NAME);
        }
    }
}

impl Seen {
    fn positions(&self) -> Option<&Positions> {
        match &self.error {
            Some(DriveError::Halted { positions, .. }) => Some(positions),
            _ => None,
        }
    }

    /// How the motors moved. If the caller expects [`Moved::Halted`], a halt also counts where the motors were by
    /// chance as slow as in a stop.
    pub(crate) fn moved(&self, wanted: Moved) -> Moved {
        match (wanted, self.moved) {
            (Moved::Halted, Moved::Tail) if self.is_part => wanted,
            (Moved::AsQueued, Moved::AsPlanned | Moved::Tail) => wanted,
            _ => self.moved,
        }
    }

    /// Whether the host reports that the board was reset.
    fn was_reset(&self) -> bool {
        self.positions().is_some_and(|positions| matches!(positions.by, Knowledge::LastReport { .. }))
    }

    /// The motors are where the host reports them.
    fn check(&self) {
        let Some(Positions { motors, by }) = self.positions() else { return };
        let said: Vec<i64> = motors.iter().map(|(_, steps)| *steps).collect();
        let made = counts(&self.steps);
        match by {
            Knowledge::Counted | Knowledge::StoppedAtOnce => assert_eq!(said, made),
            Knowledge::Replayed { or } => {
                assert!(said == made || or.contains(&made), "{said:?} or {or:?}, but {made:?}")
            }
            Knowledge::LastReport { .. } | Knowledge::StopUnanswered => {
                // The motors were there on the way.
                for (said, steps) in said.iter().zip(&self.steps) {
                    let mut count = 0;
                    let mut passed = steps.iter().map(|step| {
                        count += step.sign;
                        count
                    });
                    assert!(*said == 0 || passed.any(|count| count == *said), "{said} was never counted");
                }
            }
        }
    }

    /// The user's message. Empty if nothing is wrong.
    pub(crate) fn said(&self) -> String {
        let Some(error) = &self.error else { return String::new() };
        let help = error.advice().map_or_else(String::new, |help| format!("\nhelp: {help}"));
        format!("{error}{help}")
    }
}

/// A disk with some bytes of room.
struct Disk {
    room: usize,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self.room.min(bytes.len()) {
            0 => Err(io::ErrorKind::StorageFull.into()),
            written => {
                self.room -= written;
                Ok(written)
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// This many steps before the first different one belong to the stop.
const LOOK_BACK: usize = 3;

/// Whether the steps slow down within the limits until less than a step before rest. (There a motor that brakes with
/// acceleration a runs at √(4a) or less.)
fn stops<P: Chip>(steps: &[Step]) -> bool {
    let hz = P::CYCLES_PER_S as f64;
    let speeds = |pair: &[Step]| pair[0].sign as f64 * hz / (pair[1].tick - pair[0].tick) as f64;
    let slow = PULL_IN + 1.05 * (4.0 * MAX_ACCELERATION).sqrt();
    if let [.., before, last] = steps
        && before.sign == last.sign
        && speeds(&[*before, *last]).abs() > slow
    {
        return false;
    }
    // Measured over some steps, so that a tick more or less does not matter.
    steps.windows(2 * LOOK_BACK + 1).filter(|steps| steps.iter().all(|step| step.sign == steps[0].sign)).all(|steps| {
        let mean = |from: &Step, to: &Step| LOOK_BACK as f64 * hz / (to.tick - from.tick) as f64;
        let [first, middle, last] = [0, LOOK_BACK, 2 * LOOK_BACK].map(|k| &steps[k]);
        let seconds = (last.tick - first.tick) as f64 / 2.0 / hz;
        ((mean(middle, last) - mean(first, middle)) / seconds).abs() <= 1.02 * MAX_ACCELERATION
    })
}

/// Runs a motion on a board at the end of a line, as a session of that number. Gives why it did not come to its end.
fn drive<P: Chip>(prepared: &Prepared, line: &Line<P>, number: u32) -> Option<DriveError> {
    let connect = |program: &_| connect_as(line.clone(), program, Baud::B1M, number);
    Driven::with(prepared, connect).and_then(|mut driven| driven.run(&mut |_: Edge| {}, |_| {})).err()
}
