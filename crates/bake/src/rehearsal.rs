//! What `bake` makes for an Uno, played on the virtual one before it is written: the firmware's own image, each edge of its pins against
//! the law, and its lamp, which is all that such a board says.
//!
//! The planner's limits are of a firmware that has its segments in time. Whether the main loop brings them in time, for these motors at
//! these moments, nobody adds up: it is tried.

use std::time::Duration;

use pulsetrain_board::Port;
use pulsetrain_board::virtual_uno::{CYCLES_PER_S, VirtualUno};
use pulsetrain_core::baked::avr::ZERO;
use pulsetrain_motion::pins::PinKind;
use pulsetrain_motion::program::{Motor, Program, Wiring};
use pulsetrain_trace::verdict::{EdgeJudge, Failure, Fault, JudgeError, Options};
use pulsetrain_trace::{Edge, Line};

use pulsetrain_session::lateness::Edges;
use pulsetrain_session::rehearsal::{Length, Rehearsed, STRIDE_S, rates, slower};

use crate::image;

/// The clock begins within so long after a reset, or never: a bootloader waits, then the flash is looked at.
const START: Duration = Duration::from_secs(3);

/// An Uno's pins, as the board numbers them.
const PINS: u8 = 20;

/// A motion that was not.
#[derive(Debug, thiserror::Error)]
#[error("rehearsed on the virtual Uno, {what}")]
pub struct Failed {
    /// In which way.
    pub what: What,
    /// How fast each motor is then, by the law, steps/s.
    pub rates: Vec<(String, f64)>,
    /// Whether the pins are timed by the Uno's hardware.
    by_hardware: bool,
}

/// What went wrong, at which of the laws' times.
#[derive(Debug, thiserror::Error)]
pub enum What {
    /// No clock was begun.
    #[error("the board does not begin the motion")]
    NoStart,
    /// The watchdog, or a fault.
    #[error("the board restarted at t = {at_s:.3} s or shortly before")]
    Reset {
        /// When it was seen.
        at_s: f64,
    },
    /// A motor stands, and so do all others then.
    #[error("{}", stopped(.motor, *.step, *.at_s, *.dry))]
    Stopped {
        /// Whose step is the first that was not made.
        motor: String,
        /// Which, from 1.
        step: u64,
        /// When it was due.
        at_s: f64,
        /// It had no steps left to make: others went on, until the board saw it.
        dry: bool,
    },
    /// A step is not as it should be.
    #[error("{first}{}", if *.stopped { "; then the board stopped all motors" } else { "" })]
    Edge {
        /// The first.
        first: Failure,
        /// All motors stand, and the lamp shines.
        stopped: bool,
    },
    /// The board's own word: the lamp shines, though each edge is where it should be.
    #[error(
        "the board says that an edge was late by more than is promised, at t = {at_s:.3} s or shortly before: its lamp shines"
    )]
    Lamp {
        /// When it was seen.
        at_s: f64,
    },
    /// The law breaks, or pins that cannot be judged.
    #[error(transparent)]
    Judge(#[from] JudgeError),
}

impl What {
    /// The laws' time.
    #[must_use]
    pub const fn at_s(&self) -> Option<f64> {
        match self {
            What::NoStart | What::Judge(_) => None,
            What::Reset { at_s } | What::Stopped { at_s, .. } | What::Lamp { at_s } => Some(*at_s),
            What::Edge { first, .. } => Some(first.at_s),
        }
    }
}

fn stopped(motor: &str, step: u64, at_s: f64, dry: bool) -> String {
    if dry {
        format!(
            "motor {motor} ran dry at t = {at_s:.6} s: its step {step} did not come, and the board stopped all motors"
        )
    } else {
        format!("all motors stand from t = {at_s:.6} s on: step {step} of motor {motor} is the first that did not come")
    }
}

impl Failed {
    fn new(program: &Program, what: What) -> Failed {
        let by_hardware = matches!(PinKind::of(&program.motors), Ok(PinKind::Compare));
        Failed { rates: what.at_s().map(|at_s| rates(program, at_s)).unwrap_or_default(), what, by_hardware }
    }

    /// What would do.
    #[must_use]
    pub fn advice(&self) -> String {
        if self.what.at_s().is_none() {
            return "nothing was written; please tell the project, with the motion file".to_owned();
        }
        let pins =
            if self.by_hardware { "" } else { "; STEP of one motor or two on pins 9 and 10, which the hardware times" };
        format!(
            "nothing was written: the board cannot read on as fast as they turn. What may do: {}{pins}. --no-rehearsal writes it all \
             the same",
            slower(&self.rates)
        )
    }
}

/// Plays an image of a program's motion, and holds its pins against the law. `watch` hears how far it is, s.
///
/// # Errors
/// [`Failed`]: the first thing that went wrong; what comes behind it is not played.
pub fn rehearse(
    uno: &mut VirtualUno,
    program: &Program,
    length: Length,
    mut watch: impl FnMut(f64),
) -> Result<Rehearsed, Failed> {
    let failed = |what| Failed::new(program, what);
    let options = options(program, length.until_s());
    let hz = program.board.tick_hz;
    let judge = EdgeJudge::new(hz, &lines(), program, &options);
    let mut judge = judge.map_err(|error| failed(error.into()))?;
    let (lead_s, second) = (f64::from(ZERO) / CYCLES_PER_S as f64, hz as f64 / CYCLES_PER_S as f64);
    let (mut zero, mut at_s, mut shines) = (None, 0.0, false);
    let mut last_steps = [0; PINS as usize];
    // A little longer than is looked at, so that an edge that is late is seen.
    while at_s < length.seconds + STRIDE_S && !shines && !judge.has_failed() {
        at_s += STRIDE_S;
        let mut orderly = true;
        let runs = play(uno, lead_s + at_s * second, &mut |edge| {
            orderly &= judge.push(edge).is_ok();
            if let Some(last) = last_steps.get_mut(usize::from(edge.line)).filter(|_| edge.level) {
                *last = edge.tick;
            }
        });
        if !runs && zero.is_none() {
            return Err(failed(What::NoStart));
        }
        zero = zero.or(uno.zero());
        if !runs || !orderly || uno.zero() != zero {
            return Err(failed(What::Reset { at_s }));
        }
        shines = image::has_lamp(program) && lamp(uno);
        watch(at_s.min(length.seconds));
    }
    let report = judge.finish().map_err(|error| failed(error.into()))?;
    let first = report.failures.iter().min_by(|one, other| one.at_s.total_cmp(&other.at_s));
    let Some(first) = first.cloned() else {
        let bound_ticks = options.bound_ticks.unwrap_or_default();
        return if shines { Err(failed(What::Lamp { at_s })) } else { Ok(Rehearsed { length, bound_ticks, report }) };
    };
    // Of a motor that stands all steps from there on are missing.
    let stands = report.motors.iter().find(|motor| motor.motor == first.motor);
    let stands = stands.is_some_and(|motor| motor.steps_got < first.step);
    Err(failed(match first {
        Failure { motor, step, at_s, fault: Fault::Missing { .. } } if stands => {
            let due = u64::from(ZERO) + (at_s * hz as f64) as u64;
            let others = program.motors.iter().filter(|other| other.name != motor);
            let dry = others.filter_map(step_pin).any(|pin| last_steps.get(pin).is_some_and(|last| *last > due));
            What::Stopped { motor, step, at_s, dry }
        }
        first => What::Edge { first, stopped: shines },
    }))
}

fn step_pin(motor: &Motor) -> Option<usize> {
    match motor.wiring {
        Wiring::StepDir { step, .. } => Some(step.into()),
        Wiring::Coils { .. } => None,
    }
}

/// How a baked motion is judged: each edge within its certificate, a tick, and what the firmware is known to be late; times count from
/// the board's clock.
#[must_use]
pub fn options(program: &Program, until_s: Option<f64>) -> Options {
    let edges = Edges::of(program);
    let bound = program.tolerance.ticks(program.board.tick_hz) + 1.0 + f64::from(edges.late_ticks);
    Options {
        bound_ticks: Some(bound),
        constant_ticks: i64::from(ZERO) + i64::from(edges.constant_ticks),
        until_s,
        ..Options::default()
    }
}

/// The lines of an Uno's pins.
#[must_use]
pub fn lines() -> Vec<Line> {
    (0..PINS).map(|pin| Line::named(format!("pin{pin}"))).collect()
}

/// Hands over all edges of the pins that were not yet, until so long after the clock's tick 0. `false`: the clock does not run.
#[must_use]
pub fn play(uno: &mut VirtualUno, until_s: f64, each: &mut dyn FnMut(Edge)) -> bool {
    let latest = uno.now() + START;
    // A virtual Uno is always there.
    let run = |uno: &mut VirtualUno, until| uno.receive(until, &mut Vec::new()).is_ok();
    while uno.zero().is_none() {
        if !run(uno, uno.now() + Duration::from_millis(1)) || uno.now() >= latest {
            return false;
        }
    }
    let zero = Duration::from_secs_f64(uno.zero().unwrap_or(0) as f64 / CYCLES_PER_S as f64);
    let end = zero + Duration::from_secs_f64(until_s);
    let mut edges = Vec::new();
    while uno.now() < end {
        if !run(uno, end.min(uno.now() + Duration::from_secs_f64(STRIDE_S))) {
            return false;
        }
        uno.edges(&mut edges);
        edges.drain(..).for_each(|edge| each(Edge { tick: edge.tick, line: edge.line, level: edge.level }));
    }
    uno.zero().is_some()
}

/// Whether the lamp shines, if no motor has its pin.
pub fn lamp(uno: &mut VirtualUno) -> bool {
    // DDRB and PORTB (DS40002061B, 31), bit 5.
    [0x24, 0x25].iter().all(|register| uno.chip_mut().read_data(*register, &mut ()) & 1 << 5 != 0)
}
