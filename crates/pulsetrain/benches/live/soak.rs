//! The sweep article's four motors with a change each second, for hours of the board's time.
//!
//! An independent count of each motor's periods goes along: a knob's change of frequency from f to g that takes d lets (f/g + 1)·g·d/2 periods pass, where f/g is a
//! whole number of 2^-16, as rates of time are. Each scheduled step is held against the sweep at that count, θ = swing/2·(1 − cos 2πφ).

use super::{Row, pins};
use pulsetrain::board::{BoardKind, Edge, Leased, Observer, ScheduledStep};
use pulsetrain::live::{KnobValue, LiveRun, LiveSetpoints, NamedFiles, RunCommand, RunEvent};
use pulsetrain::motion::time::Rate;
use pulsetrain::session::drive::Driven;
use pulsetrain::session::prepare::Prepared;
use pulsetrain::trace::Line;
use pulsetrain_core::Direction;
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Each motor's frequency, Hz, and swing, steps, at the beginning: as in the article.
const SWEEPS: [(f64, f64); 4] = [(0.5, 200.0), (1.0, 100.0), (2.0, 50.0), (4.0, 25.0)];
/// How long a change takes, s. The limits are so high that none needs longer.
const CHANGE_S: f64 = 0.25;
/// Steps are compared where a motor has this part of its highest speed: near a turn a small distance is a long time.
const COMPARED: f64 = 0.05;

/// The motion file for a board.
fn text(board: &str) -> String {
    let mut text = format!("board = \"{board}\"\ngrid = \"reach\"\n");
    for (motor, ((hz, swing), (step, dir))) in SWEEPS.into_iter().zip(pins(board)).enumerate() {
        text += &format!(
            "[motor.m{motor}]\nsteps_per_rev = 200\ndriver = \"A4988\"\npulse_high = \"2 us\"\npins = {{ step = {step}, dir = {dir} }}\n\
             forward = \"high\"\nmax_speed = \"20 rev/s\"\nmax_acceleration = \"2000 rev/s^2\"\n\
             [[motion]]\nmotor = \"m{motor}\"\nlaw.sweep = {{ frequency = \"{hz} Hz\", swing = \"{swing} step\" }}\n"
        );
    }
    text += "[live.knobs]\n";
    for motor in 0..SWEEPS.len() {
        text += &format!("f{motor} = {{ target = \"m{motor}.frequency\", smoothing = \"{CHANGE_S} s\" }}\n");
        text += &format!("s{motor} = {{ target = \"m{motor}.swing\", smoothing = \"{CHANGE_S} s\" }}\n");
    }
    text
}

/// A motor's sweep, from a time on.
#[derive(Clone, Copy, Debug)]
struct Sweep {
    /// From this time on, s; before it the motor changes.
    from_s: f64,
    /// Periods at `from_s`, less whole ones.
    periods: f64,
    hz: f64,
    swing: f64,
}

impl Sweep {
    /// Position, steps, and speed, steps/s.
    fn at(&self, at_s: f64) -> (f64, f64) {
        let phase = TAU * (self.periods + self.hz * (at_s - self.from_s)).fract();
        (0.5 * self.swing * (1.0 - phase.cos()), 0.5 * self.swing * TAU * self.hz * phase.sin())
    }
}

/// What is seen of a motor.
struct Seen {
    sweep: Sweep,
    /// When the motor leaves `sweep` for the next one, s.
    leaves: VecDeque<(f64, Sweep)>,
    /// By scheduled steps.
    position: i64,
    /// By edges of STEP, with the level that DIR has then.
    made: i64,
    is_forward: bool,
    steps: u64,
    /// The largest distance in time between a step and its sweep, s.
    worst_s: f64,
    /// Steps that are farther from their place than half a step: they are lost, or too many.
    misplaced: u64,
}

impl Seen {
    /// A motor that begins with a sweep.
    fn from_begin(hz: f64, swing: f64) -> Seen {
        Seen {
            sweep: Sweep { from_s: 0.0, periods: 0.0, hz, swing },
            leaves: VecDeque::new(),
            position: 0,
            made: 0,
            is_forward: false,
            steps: 0,
            worst_s: 0.0,
            misplaced: 0,
        }
    }

    /// A step is scheduled for this time. While the motors brake for the end, `is_over`, it is held against no sweep.
    fn scheduled(&mut self, at_s: f64, is_forward: bool, is_over: bool) {
        self.steps += 1;
        self.position += if is_forward { 1 } else { -1 };
        while self.leaves.front().is_some_and(|(_, next)| next.from_s <= at_s) {
            if let Some((_, next)) = self.leaves.pop_front() {
                self.sweep = next;
            }
        }
        if is_over || self.leaves.front().is_some_and(|(leaves_s, _)| *leaves_s <= at_s) {
            return;
        }
        let (position, speed) = self.sweep.at(at_s);
        let off = (position - self.position as f64).abs();
        self.misplaced += u64::from(off > 0.5);
        if speed.abs() > COMPARED * 0.5 * self.sweep.swing * TAU * self.sweep.hz {
            self.worst_s = self.worst_s.max(off / speed.abs());
        }
    }

    /// The sweep that it follows at last.
    fn last(&self) -> Sweep {
        self.leaves.back().map_or(self.sweep, |(_, sweep)| *sweep)
    }
}

/// Keeps what happens in a step of the motion: a change may begin within it, which is heard of only at its end.
struct Watch {
    /// The motor of each line, and whether that is its STEP.
    wires: Vec<Option<(usize, bool)>>,
    edges: Vec<Edge>,
    steps: Vec<ScheduledStep>,
}

impl Observer for Watch {
    fn edge(&mut self, edge: Edge) {
        self.edges.push(edge);
    }

    fn step(&mut self, step: ScheduledStep) {
        self.steps.push(step);
    }
}

impl Watch {
    fn of(lines: &[Line]) -> Watch {
        let wire = |line: &Line| {
            let (motor, wire) = line.names.iter().find_map(|name| name.strip_prefix('m')?.split_once('.'))?;
            Some((motor.parse().ok()?, wire == "step"))
        };
        Watch { wires: lines.iter().map(wire).collect(), edges: Vec::new(), steps: Vec::new() }
    }

    /// Hands on what was kept.
    fn pass_to(&mut self, seen: &mut [Seen], tick_s: f64, is_over: bool) {
        for step in self.steps.drain(..) {
            seen[step.motor].scheduled(step.tick as f64 * tick_s, step.direction == Direction::Forward, is_over);
        }
        for edge in self.edges.drain(..) {
            match self.wires[usize::from(edge.line)] {
                Some((motor, true)) if edge.level => seen[motor].made += if seen[motor].is_forward { 1 } else { -1 },
                Some((motor, false)) => seen[motor].is_forward = edge.level,
                _ => {}
            }
        }
    }
}

/// Runs a board for `seconds` of its time, with a change each second.
pub(crate) fn rows(board: &'static str, seconds: f64) -> Vec<Row> {
    let opened = LiveSetpoints::of(&text(board), "sweeps.toml", None, NamedFiles::none());
    let (mut setpoints, contents) = opened.map_err(|error| error.plain()).expect("it is a motion file");
    let mut prepared = Prepared::new("sweeps.toml".to_owned(), contents, None).expect("it fits");
    prepared.prove_first(|_| {}).expect("it fits");
    setpoints.set_up(&prepared.program);
    match BoardKind::named(board) {
        None => soak(Driven::native(&prepared).expect("it can be wired"), setpoints, &prepared, board, seconds),
        Some(kind) => {
            let driven = Driven::on_virtual(kind, &prepared, kind.usual_baud()).expect("it begins");
            soak(driven, setpoints, &prepared, board, seconds)
        }
    }
}

fn soak<B: Leased>(
    driven: Driven<B>,
    setpoints: LiveSetpoints,
    prepared: &Prepared,
    board: &'static str,
    seconds: f64,
) -> Vec<Row> {
    let tick_s = 1.0 / prepared.program.board.tick_hz as f64;
    let mut watch = Watch::of(&driven.lines);
    let mut seen: Vec<Seen> = SWEEPS.iter().map(|&(hz, swing)| Seen::from_begin(hz, swing)).collect();
    let zero = driven.zero();
    let mut show = LiveRun::new(driven, setpoints, true);
    let (mut random, mut changes, mut slow) = (0x5eed_u64, 0_u64, 0_u64);
    let mut draw = |least: f64, most: f64| {
        // Knuth's generator of 64 bits.
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        least + (most - least) * (random >> 40) as f64 / (1u64 << 24) as f64
    };
    let mut stops = false;
    let ended = loop {
        let now_s = show.now().saturating_sub(zero) as f64 * tick_s;
        let mut happened = Vec::new();
        let request = if now_s > seconds && !stops {
            stops = true;
            Some(RunCommand::Stop)
        } else if now_s > 1.0 + changes as f64 && !stops {
            changes += 1;
            let motor = draw(0.0, 4.0) as usize;
            let (hz, swing) = SWEEPS[motor];
            let (knob, value) = if draw(0.0, 1.0) < 0.5 {
                (format!("f{motor}"), draw(0.5, 1.5) * hz)
            } else {
                (format!("s{motor}"), (draw(0.5, 1.5) * swing).round())
            };
            Some(RunCommand::Set { knob, value: KnobValue::Number(value) })
        } else {
            None
        };
        let handled =
            request.map_or(Ok(None), |request| show.handle(request, &mut watch, &mut |event| happened.push(event)));
        let stepped = handled.and_then(|ended| match ended {
            Some(ended) => Ok(Some(ended)),
            None => show.step(&mut watch, &mut |event| happened.push(event)),
        });
        for event in happened {
            if !event.is_of_session() {
                note(&mut seen, event, tick_s, &mut slow);
            }
        }
        watch.pass_to(&mut seen, tick_s, stops);
        match stepped {
            Ok(None) => {}
            Ok(Some(ended)) => break Ok(ended),
            Err(error) => break Err(error.to_string()),
        }
    };
    let (total, worst_s) =
        (seen.iter().map(|s| s.steps).sum::<u64>(), seen.iter().map(|s| s.worst_s).fold(0.0, f64::max));
    let misplaced: u64 = seen.iter().map(|s| s.misplaced).sum();
    let (lost, why) = match &ended {
        Ok(ended) => {
            let motors = ended.counted.iter().zip(&seen);
            let lost = motors.map(|(counted, seen)| counted.abs_diff(seen.position) + counted.abs_diff(seen.made));
            (lost.sum::<u64>() + misplaced, String::new())
        }
        Err(error) => (misplaced, format!("; {error}")),
    };
    let tolerance_s = prepared.program.tolerance.ticks(prepared.program.board.tick_hz) * tick_s + 2.0 * tick_s;
    let what = format!("{seconds:.0} s of the board's time, {changes} changes of frequency and swing");
    let row = |what: String, measured, bound: String, more, holds| Row {
        figure: 2,
        what,
        board,
        measured,
        bound,
        more,
        holds,
    };
    vec![
        row(
            what.clone(),
            format!("{lost} steps lost"),
            "0".to_owned(),
            format!("{total} steps{why}; {slow} changes took longer than {CHANGE_S} s"),
            lost == 0 && ended.is_ok() && total > 0,
        ),
        row(
            "the same: largest distance of a step from its sweep".to_owned(),
            format!("{:.0} ns", worst_s * 1e9),
            format!("{:.0} ns", tolerance_s * 1e9),
            "the tolerance and two ticks".to_owned(),
            worst_s <= tolerance_s && slow == 0,
        ),
    ]
}

/// Takes a change over to the count of periods.
fn note(seen: &mut [Seen], event: RunEvent, tick_s: f64, slow: &mut u64) {
    let RunEvent::Set { knob, value, from_s, until_s, .. } = event else { return };
    let Some((kind, motor)) =
        knob.split_at_checked(1).and_then(|(kind, motor)| Some((kind, motor.parse::<usize>().ok()?)))
    else {
        return;
    };
    let last = seen[motor].last();
    // Its end is rounded up to a tick.
    *slow += u64::from(until_s - from_s - CHANGE_S > 3.0 * tick_s);
    let at = last.periods + last.hz * (from_s - last.from_s);
    let next_s = from_s + CHANGE_S;
    let next = match kind {
        "f" => {
            let rate = Rate::of(last.hz / value).map_or(f64::NAN, Rate::get);
            let periods = (at + 0.5 * (rate + 1.0) * value * CHANGE_S).fract();
            Sweep { from_s: next_s, periods, hz: value, swing: last.swing }
        }
        _ => Sweep { from_s: next_s, periods: (at + last.hz * CHANGE_S).fract(), swing: value, ..last },
    };
    seen[motor].leaves.push_back((from_s, next));
}
