//! What would fit: how much slower a motion that is refused would have to be, and which boards do it as it is.

use pulsetrain_motion::law::Law;
use pulsetrain_motion::machine::Machine;
use pulsetrain_motion::program::Motor;
use pulsetrain_motion::{Time, boards};
use pulsetrain_plan::error::Limit;
use pulsetrain_plan::{PlanError, Settings};

use crate::human;
use crate::prepare::{self, Prepared};

/// A motion slower than this is another motion.
const SLOWEST: f64 = 1e4;
/// The factor is found to this precision, as a ratio.
const PRECISION: f64 = 1.002;

/// What the plan of a law that is `factor` times slower must keep to, said of the law itself.
///
/// θ(t/s) on ticks of f Hz has its steps at the very ticks that θ(t) has at s·f Hz; its speeds are s times, its
/// accelerations s² times smaller, and so are the limits that they meet.
fn slowed(settings: &Settings, factor: f64) -> Settings {
    let mut slowed = settings.clone();
    slowed.tick_hz = (settings.tick_hz as f64 * factor) as u64;
    let limits = &mut slowed.limits;
    limits.max_speed = limits.max_speed.map(|speed| speed * factor);
    limits.max_acceleration = limits.max_acceleration.map(|acceleration| acceleration * factor * factor);
    limits.pull_in *= factor;
    slowed
}

/// The least factor by which a motor's law must be slowed down to fit, to three digits, rounded up; `None` if no factor
/// helps.
#[must_use]
pub fn least_slowdown(prepared: &Prepared, motor: &Motor) -> Option<f64> {
    let settings = Settings::of(&prepared.program, motor);
    least(|factor| prepare::fits(&motor.law, &slowed(&settings, factor)))
}

/// What a motor with slack wants whose plan does not fit: a longer time to take it up, s, if that is all; else how much slower its law has
/// to be, and the time that goes with that.
fn least_over(prepared: &Prepared, motor: &Motor) -> Option<(Option<f64>, f64)> {
    let settings = Settings::of(&prepared.program, motor);
    let over_s = motor.law.slack_over()?.seconds();
    let longer = |factor: f64| motor.law.with_slack_over(Time::from_seconds(over_s * factor));
    if let Some(factor) = least(|factor| longer(factor).is_some_and(|law| prepare::fits(&law, &settings))) {
        return Some((None, over_s * factor));
    }
    least_slowdown(prepared, motor).map(|factor| (Some(factor), over_s * factor))
}

/// The least factor above 1 that fits, to three digits, rounded up.
fn least(fits: impl Fn(f64) -> bool) -> Option<f64> {
    let mut below = 1.0;
    let mut above = 1.25;
    while !fits(above) {
        below = above;
        above *= 2.0;
        if above > SLOWEST {
            return None;
        }
    }
    while above / below > PRECISION {
        let middle = (above * below).sqrt();
        if fits(middle) { above = middle } else { below = middle }
    }
    // Rounded up, and a little more where a limit is met in jumps.
    let rounded = rounded_up(above);
    fits(rounded).then_some(rounded).or(Some(rounded_up(rounded * 1.001)).filter(|factor| fits(*factor)))
}

/// To three digits, not less.
pub(crate) fn rounded_up(value: f64) -> f64 {
    let unit = 10f64.powf(value.log10().floor() - 2.0);
    (value / unit).ceil() * unit
}

/// What a motor's law breaks by itself, each limit once: where one is broken it is lifted, to see the next.
#[must_use]
pub fn broken(law: &Law, settings: &Settings) -> Vec<PlanError> {
    let mut settings = settings.clone();
    let mut broken: Vec<PlanError> = Vec::new();
    while let Err(error) = prepare::walk(law, &settings) {
        let limit = error.limit();
        if broken.iter().any(|known| known.limit() == limit) {
            break;
        }
        broken.push(error);
        match limit {
            Some(Limit::Board) => (settings.min_interval_ticks, settings.load) = (1, None),
            Some(Limit::MotorSpeed) => settings.limits.max_speed = None,
            Some(Limit::MotorAcceleration) => settings.limits.max_acceleration = None,
            Some(Limit::PullIn) => settings.limits.pull_in = f64::INFINITY,
            None => break,
        }
    }
    broken
}

/// The boards that do the whole motion as it is.
#[must_use]
pub fn other_boards(prepared: &Prepared) -> Vec<String> {
    let others = boards::table().into_iter().filter(|row| row.board.name != prepared.program.board.name);
    let able = others.filter_map(|row| {
        let name = row.board.name.clone();
        let program = prepared.program.clone().with_board(row.board).ok()?;
        let fits = |motor: &Motor| prepare::fits(&motor.law, &Settings::of(&program, motor));
        program.motors.iter().all(fits).then_some(name)
    });
    able.collect()
}

/// What to do about a plan's error, in a few lines.
#[must_use]
pub fn advice(prepared: &Prepared, motor: &Motor, error: &PlanError) -> String {
    let mut lines = Vec::new();
    if let PlanError::ToleranceTooTight { least_ticks, .. } = error {
        let least = human::seconds(least_ticks / prepared.program.board.tick_hz as f64);
        return format!("tolerance = \"{least_ticks} ticks\" is the least: {least} on this board");
    }
    if let PlanError::NotProvable { bound_ticks, .. } = error {
        return format!("tolerance = \"{} ticks\" can be proven", human::significant(bound_ticks * 1.01, 3));
    }
    if let PlanError::SpeedJump { from, to, at_s, .. } = error {
        let is_of = |machine: &&Machine| machine.motors.iter().any(|k| prepared.program.motors[*k].name == motor.name);
        let machine = prepared.program.machines.iter().find(is_of);
        // Not where the motor's motions begin or end, but on the way.
        let is_between = *at_s > 0.0 && motor.law.end().is_some_and(|end| *at_s < end.seconds());
        lines.push(match (*from, *to, machine) {
            (_, _, Some(_)) if is_between => {
                "the path does not go on as it came there: one that is repeated has to end in the direction, and as fast, as it begins; \
                 paths that follow one another can have an `ease` each"
                    .to_owned()
            }
            (0.0, _, Some(_)) | (_, 0.0, Some(_)) => {
                "give the path an `ease`, which begins and ends at rest and keeps to it: ease = \"0.5 s\"".to_owned()
            }
            (0.0, ..) => "say how it begins: begin = \"ramp\" or \"delay\"; or \"jump\", if the motor can".to_owned(),
            (_, 0.0, _) => "say how it ends: end = \"ramp\"; or \"jump\", if the motor can".to_owned(),
            _ => "smooth the law there, or give the motor the pull_in that it has".to_owned(),
        });
    }
    if error.limit().is_some() && motor.law.slack_over().is_some() {
        lines.extend(least_over(prepared, motor).map(|(slower, over_s)| {
            let over = human::seconds(rounded_up(over_s));
            match slower {
                None => format!("`backlash` takes up its slack too fast: over = \"{over}\" fits"),
                Some(factor) => {
                    let times = human::significant(factor, 4);
                    format!("{times} times slower it fits, with over = \"{over}\" in `backlash`")
                }
            }
        }));
    } else if error.limit().is_some()
        && let Some(factor) = least_slowdown(prepared, motor)
    {
        let times = human::significant(factor, 4);
        // What was cut lasts as long as somebody wants it to.
        let whole = motor.law.end().filter(|end| prepared.cut.is_none_or(|cut| *end < cut.at));
        let fits = whole.map(|end| {
            let (now, then) = (human::seconds_to(end.seconds(), 4), human::seconds_to(end.seconds() * factor, 4));
            format!(": {then} instead of {now}")
        });
        lines.push(format!("{times} times slower it fits{}", fits.unwrap_or_default()));
    }
    if error.limit() == Some(Limit::Board) {
        let settings = Settings::of(&prepared.program, motor);
        let pulse = motor.timing.ticks(settings.tick_hz);
        if settings.min_interval_ticks == pulse.pulse_high + pulse.pulse_low {
            let (high, low) =
                (f64::from(motor.timing.pulse_high_ns) * 1e-9, f64::from(motor.timing.pulse_low_ns) * 1e-9);
            lines.push(format!(
                "the limit is the driver's: a pulse takes {} HIGH and {} LOW",
                human::seconds(high),
                human::seconds(low)
            ));
        }
        match other_boards(prepared) {
            boards if boards.is_empty() => lines.push("no board in the table does it as it is".to_owned()),
            boards => lines.push(format!("as it is, it fits: {}", boards.join(", "))),
        }
    }
    if error.at_s().is_some() {
        lines.push(format!("`pulsetrain explain {}` shows the place", prepared.file));
    }
    lines.join("\n")
}
