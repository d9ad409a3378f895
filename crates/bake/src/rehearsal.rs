//! Plays an Uno's image on the virtual Uno before anybody writes it to a real one. The image is the firmware's own;
//! each edge of its pins is compared with the law. The lamp is checked, too, since it is the only sign that such a
//! board gives.
//!
//! The planner's limits hold for a firmware that has its segments in time. Whether the main loop brings them in time
//! depends on all motors and on the instants at which they need segments. There is no formula for that, so it is tried.

use std::time::Duration;

use pulsetrain_board::Port;
use pulsetrain_board::virtual_uno::{CYCLES_PER_S, VirtualUno};
use pulsetrain_core::baked::avr::ZERO;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_motion::program::{Motor, Program, Wiring};
use pulsetrain_trace::verdict::{EdgeJudge, Failure, Fault, JudgeError, Options};
use pulsetrain_trace::{Edge, Line};

use pulsetrain_session::lateness::Edges;
use pulsetrain_session::rehearsal::{Length, Rehearsed, STRIDE_S, rates, slower};

use crate::image;

/// The motion's clock starts within this time after a reset, or never: the bootloader waits first, then the firmware
/// looks at the flash.
const START: Duration = Duration::from_secs(3);

/// An Uno's pins, as the board numbers them.
const PINS: u8 = 20;

/// Why a rehearsal failed.
#[derive(Debug, thiserror::Error)]
#[error("rehearsed on the virtual Uno, {what}")]
pub struct Failed {
    /// What went wrong.
    pub what: What,
    /// How fast each motor is then by its law, steps/s.
    pub rates: Vec<(String, f64)>,
    /// Whether the Uno's timers make the edges.
    by_hardware: bool,
}

/// What went wrong, and when by the laws' time.
#[derive(Debug, thiserror::Error)]
pub enum What {
    /// The motion's clock did not start.
    #[error("the board does not begin the motion")]
    NoStart,
    /// The watchdog reset the board, or the firmware met a fault.
    #[error("the board restarted at t = {at_s:.3} s or shortly before")]
    Reset {
        /// When that was seen.
        at_s: f64,
    },
    /// A motor stopped, and with it all others.
    #[error("{}", stopped(.motor, *.step, *.at_s, *.dry))]
    Stopped {
        /// The motor whose step is missing first.
        motor: String,
        /// The number of that step, from 1.
        step: u64,
        /// When the step was due.
        at_s: f64,
        /// The motor had no steps left to make. Other motors went on until the firmware noticed.
        dry: bool,
    },
    /// A step is too early, too late, or in the wrong direction.
    #[error("{first}{}", if *.stopped { "; then the board stopped all motors" } else { "" })]
    Edge {
        /// The first such failure.
        first: Failure,
        /// Whether all motors stopped and the lamp is on.
        stopped: bool,
    },
    /// The lamp is on, though each edge is where it should be.
    #[error(
        "the board says that an edge was late by more than is promised, at t = {at_s:.3} s or shortly before: its lamp shines"
    )]
    Lamp {
        /// When that was seen.
        at_s: f64,
    },
    /// The law has no value somewhere, or the pins cannot be judged.
    #[error(transparent)]
    Judge(#[from] JudgeError),
}

impl What {
    /// When it happened, by the laws' time.
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

    /// What the user can do.
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

/// Plays the image of a program's motion and compares its pins with the law. Calls `watch` with the laws' time that is
/// reached, s.
///
/// # Errors
/// [`Failed`]: the first thing that went wrong. Nothing behind it is played.
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
    // Play a little longer than is judged, so that a late edge is seen.
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
    // Once a motor has stopped, all its later steps are missing.
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

/// The bound on each edge of a baked motion: the certificate, a tick, and the lateness that the firmware is known to
/// have. Times count from the board's clock.
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

/// The STEP and DIR lines on an Uno's pins.
#[must_use]
pub fn lines() -> Vec<Line> {
    (0..PINS).map(|pin| Line::named(format!("pin{pin}"))).collect()
}

/// Hands over the edges that are new, until the given time after the clock's tick 0. `false`: the clock does not run.
#[must_use]
pub fn play(uno: &mut VirtualUno, until_s: f64, each: &mut dyn FnMut(Edge)) -> bool {
    let latest = uno.now() + START;
    // A virtual Uno is never unplugged.
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

/// Whether the lamp is on, if no motor has its pin.
pub fn lamp(uno: &mut VirtualUno) -> bool {
    // DDRB and PORTB (DS40002061B, 31), bit 5.
    [0x24, 0x25].iter().all(|register| uno.chip_mut().read_data(*register, &mut ()) & 1 << 5 != 0)
}
