//! Advice for a refused motion: how much slower it would fit, with which easing, tolerance or line, and on which other boards.

use std::borrow::Cow;
use std::cell::Cell;
use std::fmt;

use pulsetrain_board::BoardKind;
use pulsetrain_motion::law::{Begin, Cursor, End, Law, LawError, TableLaw, least_smoothing};
use pulsetrain_motion::machine::{Kinematics, Machine};
use pulsetrain_motion::program::{Limits, Motor, Program, Tolerance};
use pulsetrain_motion::quantity::{assignment, time_assignment};
use pulsetrain_motion::{Grid, Time, boards, human};
use pulsetrain_plan::error::Limit;
use pulsetrain_plan::{Line, PlanError, Settings, Way};

use crate::estimate;
use crate::plans;
use crate::prepare::{self, Prepared};

/// The largest factor by which a motion is slowed down in the search: beyond it, it would be a different motion.
const SLOWEST: f64 = 1e4;
/// The search for the factor ends when its bounds differ by less than this ratio: the factor is printed to three or four digits.
const PRECISION: f64 = 1.002;
/// Estimated time of all plans that are tried for one suggestion (an easing, a way to begin, a factor, a board), s.
const MOST_TRYING_S: f64 = 1.0;

/// A budget of planning time for the plans that are tried. Only estimates are added up: with no clock, the advice is the same on every computer.
struct Tries {
    left_s: Cell<f64>,
}

/// The budget is too small for a plan that takes about this long, s.
struct TooLong(f64);

impl Tries {
    fn new() -> Tries {
        Tries::of(MOST_TRYING_S)
    }

    fn of(most_s: f64) -> Tries {
        Tries { left_s: Cell::new(most_s) }
    }

    /// Takes the time for a plan of these laws from the budget.
    ///
    /// # Errors
    /// When not as much is left.
    fn another<'a>(&self, laws: impl IntoIterator<Item = &'a Law>) -> Result<(), TooLong> {
        let planning_s = |law: &Law| law.end().map_or(f64::INFINITY, |end| estimate::planning_s(law.workload(end)));
        self.take(laws.into_iter().map(planning_s).sum())
    }

    /// As [`Tries::another`], for the first `length` of each law.
    ///
    /// # Errors
    /// When not as much is left, or a law is shorter than `length`.
    fn beginnings(&self, laws: &[Law], length: Time) -> Result<(), TooLong> {
        let planning_s = |law: &Law| match law.end() {
            Some(end) if end > length => estimate::planning_s(law.workload(length)),
            _ => f64::INFINITY,
        };
        self.take(laws.iter().map(planning_s).sum())
    }

    fn take(&self, plan_s: f64) -> Result<(), TooLong> {
        self.left_s.set(self.left_s.get() - plan_s);
        if self.left_s.get() >= 0.0 { Ok(()) } else { Err(TooLong(plan_s)) }
    }
}

/// The remark on advice that was not tried.
impl fmt::Display for TooLong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, " (not tried: planning takes about {})", human::long_time(self.0))
    }
}

/// The least factor by which a motor's law must be slowed down to fit, to three digits, rounded up; `None` if no factor
/// helps.
#[must_use]
pub fn least_slowdown(prepared: &Prepared, motor: &Motor) -> Option<f64> {
    slowdown(prepared, motor, || true)
}

/// As [`least_slowdown`]; gives up once `another` says that there is no time for another plan.
fn slowdown(prepared: &Prepared, motor: &Motor, another: impl Fn() -> bool) -> Option<f64> {
    let settings = Settings::of(&prepared.program, motor);
    least(|factor| another().then(|| plans::fits(&motor.law, &settings.slowed(factor))))
}

/// For a motor with backlash whose plan does not fit: the time over which its slack should be taken up, s, and, if that alone does not help, the factor
/// by which its law has to be slowed down too. Gives up once `another` says that there is no time for another plan.
fn least_over(prepared: &Prepared, motor: &Motor, another: impl Fn() -> bool) -> Option<(Option<f64>, f64)> {
    let settings = Settings::of(&prepared.program, motor);
    let over_s = motor.law.backlash_over()?.seconds();
    let longer = |factor: f64| motor.law.with_backlash_over(Time::from_seconds(over_s * factor));
    let fits = |factor: f64| longer(factor).is_some_and(|law| plans::fits(&law, &settings));
    if let Some(factor) = least(|factor| another().then(|| fits(factor))) {
        return Some((None, over_s * factor));
    }
    slowdown(prepared, motor, another).map(|factor| (Some(factor), over_s * factor))
}

/// The least factor above 1 that fits, to three digits, rounded up. `fits` returns `None` if there is no time to try a factor; the search then gives up.
fn least(fits: impl Fn(f64) -> Option<bool>) -> Option<f64> {
    let mut below = 1.0;
    let mut above = 1.25;
    while !fits(above)? {
        below = above;
        above *= 2.0;
        if above > SLOWEST {
            return None;
        }
    }
    while above / below > PRECISION {
        let middle = (above * below).sqrt();
        if fits(middle)? { above = middle } else { below = middle }
    }
    // The rounded factor is tried too: a limit that changes in jumps may refuse it. Then a little more may fit.
    let rounded = rounded_up(above);
    if fits(rounded)? {
        return Some(rounded);
    }
    let rounded = rounded_up(rounded * 1.001);
    fits(rounded)?.then_some(rounded)
}

/// Rounded up to three significant digits; `value` is positive.
#[must_use]
pub fn rounded_up(value: f64) -> f64 {
    let unit = libm::exp10(libm::log10(value).floor() - 2.0);
    (value / unit).ceil() * unit
}

/// All limits that a motor's law breaks by itself, each once: a broken limit is lifted to find the next one.
#[must_use]
pub fn broken(law: &Law, settings: &Settings) -> Vec<PlanError> {
    let mut settings = settings.clone();
    let mut broken: Vec<PlanError> = Vec::new();
    while let Err(error) = plans::walk(law, &settings) {
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
            Some(Limit::Line) | None => break,
        }
    }
    broken
}

/// The names of the other boards that can run the whole motion unchanged.
#[must_use]
pub fn other_boards(prepared: &Prepared) -> Vec<String> {
    boards_that_fit(prepared, || true).unwrap_or_default()
}

/// As [`other_boards`]; `None` once `another` says that there is no time for another plan.
fn boards_that_fit(prepared: &Prepared, another: impl Fn() -> bool) -> Option<Vec<String>> {
    let mut able = Vec::new();
    for profile in boards::BUILT_IN.iter().filter(|profile| profile.name != prepared.program.board.name) {
        let Ok(mut program) = prepared.program.clone().with_board(profile.limits()) else { continue };
        if prepare::wire(&mut program).is_err() {
            continue;
        }
        if !another() {
            return None;
        }
        let line = prepared.line.as_ref().and_then(|_| prepare::usual_line(&program));
        if plans::all_fit(&program, line.as_ref(), 1.0) {
            able.push(profile.name.to_owned());
        }
    }
    Some(able)
}

/// No tolerance above this is offered, s: if it takes more, the motion itself is at fault.
const LOOSEST_S: f64 = 1e-3;
/// No tolerance above this fraction of the shortest interval between steps is offered: the intervals would be uneven.
const LOOSEST_PART: f64 = 0.05;
/// How many times a tolerance is raised, each time to what the next place that breaks it needs.
const RAISES: u32 = 8;

/// Advice where the time of a step cannot be proven: a tolerance that can be, if it is not too loose, or another grid.
fn not_provable(prepared: &Prepared, motor: &Motor, bound_ticks: f64, at_s: f64) -> String {
    let settings = Settings::of(&prepared.program, motor);
    let with = |tolerance_ticks: f64, grid: Grid| Settings { tolerance_ticks, grid, ..settings.clone() };
    let loosest = LOOSEST_S * settings.tick_hz as f64;
    let tries = Tries::new();
    let mut tolerance = rounded_up(bound_ticks * 1.01);
    for _ in 0..RAISES {
        if tolerance.is_nan() || tolerance > loosest {
            break;
        }
        if let Err(too_long) = tries.another([&motor.law]) {
            return format!("{} may do{too_long}", assignment("tolerance", tolerance, "ticks"));
        }
        match plans::planned(&motor.law, &with(tolerance, settings.grid)) {
            Ok(certificate) => {
                let shortest = certificate.shortest_interval_ticks.map_or(f64::INFINITY, |ticks| ticks as f64);
                if tolerance > LOOSEST_PART * shortest {
                    break;
                }
                return format!("{} can be proven", assignment("tolerance", tolerance, "ticks"));
            }
            Err(PlanError::NotProvable { bound_ticks, .. }) => tolerance = rounded_up(bound_ticks * 1.01),
            Err(_) => break,
        }
    }
    let mut lines = vec![format!(
        "At {} the motion almost stands still exactly at a step, so the time of that step cannot be computed.",
        human::seconds_to(at_s, 6)
    )];
    let grids = [
        ("grid = \"nearest\"", Grid::NEAREST),
        ("grid = { hysteresis = \"0.1 step\" }", Grid { hysteresis: 0.1 }),
        ("grid = { hysteresis = \"0.2 step\" }", Grid { hysteresis: 0.2 }),
    ];
    let tries = Tries::new();
    for (text, grid) in grids {
        if let Err(too_long) = tries.another([&motor.law]) {
            lines.push(format!("Steps are due elsewhere with {text}{too_long}."));
        } else if plans::fits(&motor.law, &with(settings.tolerance_ticks, grid)) {
            lines.push(format!("steps are due elsewhere with {text}: that can be proven"));
        } else {
            continue;
        }
        return lines.join("\n");
    }
    lines.push("Move that point by 0.1 step.".to_owned());
    lines.join("\n")
}

/// Easings that are tried, ms, in this order: half a second and longer ones, then shorter ones. The first that fits is offered.
const EASES_MS: [u64; 12] = [500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 200, 100, 50, 20, 10];

/// Advice on a speed that jumps from one value to another at `at_s`, by more than the motor's pull-in rate.
fn smoother(prepared: &Prepared, motor: &Motor, at_s: f64, (from, to): (f64, f64)) -> Vec<String> {
    let program = &prepared.program;
    let is_of = |machine: &&Machine| machine.motors.iter().any(|k| program.motors[*k].name == motor.name);
    if let Some(machine) = program.machines.iter().find(is_of) {
        // The jump is on the path, not at its begin or end.
        let is_between = at_s > 0.0 && motor.law.end().is_some_and(|end| at_s < end.seconds());
        if is_between {
            return vec![
                "the path does not go on as it came there: one that is repeated has to end in the direction, and as fast, as it begins; \
                 paths that follow one another can have an `ease` each"
                    .to_owned(),
            ];
        }
        let motors: Vec<&Motor> = machine.motors.iter().map(|k| &program.motors[*k]).collect();
        let ease = easing(prepared, &motors, &|law, over| law.clone().eased(over).ok());
        let ease = ease.map_or_else(String::new, |ease| format!(": {ease}"));
        return vec![format!("give the path an `ease`, which begins and ends at rest and keeps to it{ease}")];
    }
    let mut lines = Vec::new();
    let whole = easing(prepared, &[motor], &|law, over| whole_eased(prepared, motor, law, over));
    if let Some(ease) = whole {
        // Of a cut motion only the part before the cut was tried, unless that covers a whole period.
        let tried = prepared
            .cut
            .zip(motor.law.before_stop())
            .filter(|(cut, law)| law.cycle().is_none_or(|(from, period)| from + period > cut.at));
        let tried = tried.map(|(cut, _)| format!(" (tried for {})", human::seconds_to(cut.at.seconds(), 4)));
        lines.push(format!("Start and stop gently: add {ease} to its [[motion]]{}.", tried.unwrap_or_default()));
    } else if let Some(ease) = easing(prepared, &[motor], &parts_eased) {
        lines.push(format!(
            "Start and stop each of its motions gently: add {ease} to each [[motion]]. (Parts of `then` have to be motions of their own.)"
        ));
    }
    let settings = Settings::of(program, motor);
    // A cure may leave a jump at a later place: that one gets its own advice. A plan without a step is no cure.
    let tries = Tries::new();
    let cures = |law: Option<Law>| {
        law.filter(|law| tries.another([law]).is_ok()).filter(|law| match plans::planned(law, &settings) {
            Ok(plan) => plan.steps > 0,
            Err(PlanError::SpeedJump { at_s: other, .. }) => other > at_s + 1e-6,
            Err(_) => false,
        })
    };
    let limits = (motor.limits.max_speed).zip(motor.limits.max_acceleration);
    let begun = |begin: Begin| cures(with_part(&motor.law, at_s, true, &|law| law.clone().beginning(begin).ok()));
    let ended = |end: End| cures(with_part(&motor.law, at_s, false, &|law| law.clone().ending(end).ok()));
    let (how, ways) = if from == 0.0 {
        let ramp = limits.and_then(|(max_speed, max_acceleration)| begun(Begin::Ramp { max_speed, max_acceleration }));
        let behind =
            limits.and_then(|(max_speed, max_acceleration)| begun(Begin::RampBehind { max_speed, max_acceleration }));
        let stays = behind.as_ref().map(|law| {
            let ramps = law.behind();
            let steps = ramps.last().map_or(0.0, |behind| behind.steps.abs());
            format!("begin = \"ramp-behind\" (stays {} steps behind the law)", human::significant(steps, 3))
        });
        let ways = [
            ramp.map(|_| "begin = \"ramp\" (catches up with the law)".to_owned()),
            stays,
            // A law that never rests would be delayed until the cut, and makes no step: `cures` has refused it.
            begun(Begin::Delay).map(|_| "begin = \"delay\" (waits until the law comes to rest)".to_owned()),
            begun(Begin::Jump).map(|_| "begin = \"jump\" (at once, if the motor can)".to_owned()),
        ];
        ("begins", ways)
    } else if to == 0.0 {
        let ramp = limits.and_then(|(max_speed, max_acceleration)| ended(End::Ramp { max_speed, max_acceleration }));
        let behind =
            limits.and_then(|(max_speed, max_acceleration)| ended(End::RampBehind { max_speed, max_acceleration }));
        let short = behind.as_ref().map(|law| {
            let steps = law.behind().iter().rfind(|behind| behind.ends).map_or(0.0, |behind| behind.steps.abs());
            format!("end = \"ramp-behind\" (stops {} steps before the law does)", human::significant(steps, 3))
        });
        let ways = [
            ramp.map(|_| "end = \"ramp\" (makes up for the way beforehand)".to_owned()),
            short,
            ended(End::Jump).map(|_| "end = \"jump\" (at once, if the motor can)".to_owned()),
            None,
        ];
        ("ends", ways)
    } else {
        lines.push("smooth the law there, or give the motor the pull_in that it has".to_owned());
        return lines;
    };
    let ways: Vec<String> = ways.into_iter().flatten().collect();
    if !ways.is_empty() {
        let or = if lines.is_empty() { "say" } else { "or say" };
        lines.push(format!("{or} how it {how}: {}", ways.join(", ")));
    }
    if limits.is_none() {
        lines.push(format!("a motor with `max_speed` and `max_acceleration` may also have a ramp where it {how}"));
    }
    lines
}

/// Advice if a driver's pulse limits the motor's rate: whose driver it is, and which rate a shorter pulse allows.
fn pulse_limit(prepared: &Prepared, motor: &Motor, settings: &Settings) -> Option<String> {
    let program = &prepared.program;
    let (name, board) = (&motor.name, &program.board.name);
    let time = |ns: u32| human::seconds(f64::from(ns) * 1e-9);
    let timing = program.timing(motor);
    let profile = program.board.profile;
    // The rate that would fit with pulses of at most so many nanoseconds, if it is higher than now.
    let rate_with = |ns: u32| {
        let mut shorter = program.clone();
        for motor in &mut shorter.motors {
            motor.timing.pulse_high_ns = motor.timing.pulse_high_ns.min(ns);
        }
        shorter.board.min_interval_ticks = profile.shortest_intervals(&shorter.motors);
        let least = Settings::of(&shorter, motor).min_interval_ticks;
        (least < settings.min_interval_ticks).then(|| human::scaled(settings.tick_hz as f64 / least as f64, "steps/s"))
    };
    let driver = |motor: &Motor| motor.driver.map(|name| format!(" ({name})")).unwrap_or_default();
    let (high, low) = (time(timing.pulse_high_ns), time(timing.pulse_low_ns));
    let longest = program.lengthens_pulse(motor);
    if let Some(longest) = longest
        && let Some(rate) = rate_with(motor.timing.pulse_high_ns)
    {
        let (other, driver, own) = (&longest.name, driver(longest), time(motor.timing.pulse_high_ns));
        return Some(format!(
            "the limit is the pulse of motor {other}: {board} makes the pulses of all motors equally long, and the driver of {other}{driver} \
             needs {high} HIGH; that of {name} needs {own} HIGH and {low} LOW, with which {rate} fit. A driver with a shorter pulse for \
             motor {other} helps, or a board of its own"
        ));
    }
    if let Some(together) = profile.longest_pulse_together(&program.motors)
        && let Some(rate) = rate_with(together)
    {
        let whose = longest.unwrap_or(motor);
        // Rounded down to 100 ns, so that the printed pulse fits too.
        let (whose, driver, together) = (&whose.name, driver(whose), time(together - together % 100));
        return Some(format!(
            "the limit is the pulse: on these pins {board} works out each step by itself if pulses are longer than {together}, and the driver \
             of {whose}{driver} needs {high} HIGH. With {together} HIGH {rate} fit"
        ));
    }
    let pulse = timing.ticks(settings.tick_hz);
    (settings.min_interval_ticks == pulse.pulse_high + pulse.pulse_low)
        .then(|| format!("the limit is the driver's: a pulse takes {high} HIGH and {low} LOW"))
}

/// Seconds that are planned next to an easing at the begin and the end of a long motion, to try that easing without planning all of it.
const TRIED_S: f64 = 2.0;

/// Whether the begin and the end of a law that is eased over `over` fit. The middle is not planned.
fn fits_at_ends(law: &Law, settings: &Settings, over: Time) -> bool {
    let Some(end) = law.end() else { return false };
    let tried = over + over + Time::from_seconds(TRIED_S);
    // Where a law is far beyond the board's fastest step, a plan would be refused only after very many pieces.
    let fastest = settings.highest_rate_hz();
    if !Cursor::new(law).at(end - tried).is_ok_and(|sample| sample.speed.abs() <= fastest) {
        return false;
    }
    // The end is planned from a halt before it, with an easing of the same length out of that halt.
    let last = law.clone().eased_in(end - tried, over);
    plans::fits_until(law, settings, tried) && last.is_ok_and(|last| plans::fits(&last, settings))
}

/// The first easing with which the plans of all these motors fit, as a motion file has it. If there is no time for whole plans, only both ends are
/// tried, and the text says so.
fn easing(prepared: &Prepared, motors: &[&Motor], eased: &dyn Fn(&Law, Time) -> Option<Law>) -> Option<String> {
    let (tries, parts) = (Tries::new(), Tries::new());
    for over_ms in EASES_MS {
        // Exact, as the file's value would be: an easing may be just as long as the motion.
        let over = Time::from_ratio(1, 1000).times(over_ms);
        let of = |motor: &&Motor| motor.law.changed_under_backlash(|law| eased(law, over));
        let Some(laws) = motors.iter().map(of).collect::<Option<Vec<Law>>>() else { continue };
        let ease = time_assignment("ease", over.seconds());
        let all = |fits: &dyn Fn(&Law, &Settings) -> bool| {
            motors.iter().zip(&laws).all(|(motor, law)| fits(law, &Settings::of(&prepared.program, motor)))
        };
        match tries.another(&laws) {
            Ok(()) if all(&plans::fits) => return Some(ease),
            Ok(()) => {}
            Err(TooLong(whole_s)) => {
                let tried = over + over + Time::from_seconds(TRIED_S);
                // This is for long motions only: a motion no longer than its two ends is planned whole or not at all.
                if parts.beginnings(&laws, tried + tried).is_err() {
                    return None;
                }
                if all(&|law, settings| fits_at_ends(law, settings, over)) {
                    let whole = human::long_time(whole_s);
                    return Some(format!("{ease} (tried at both ends alone: planning all takes about {whole})"));
                }
            }
        }
    }
    None
}

/// The law with an easing. An easing delays the motion, so a law that was cut is cut later by as much: the same part of it has to fit.
fn whole_eased(prepared: &Prepared, motor: &Motor, law: &Law, over: Time) -> Option<Law> {
    let Some((cut, uncut)) = prepared.cut.zip(law.before_stop()) else { return law.clone().eased(over).ok() };
    let eased = uncut.clone().eased(over).ok()?;
    let at = cut.at + over;
    if eased.end().is_some_and(|end| end <= at) {
        return Some(eased);
    }
    prepare::stopped(&eased, at, motor.limits, prepared.program.grid).ok()
}

/// A law of several motions, each with an easing; `None` for a single motion.
fn parts_eased(law: &Law, over: Time) -> Option<Law> {
    let Law::Then(laws) = law else { return None };
    let eased = laws.iter().map(|law| law.clone().eased(over).unwrap_or_else(|_| law.clone()));
    Law::then(eased.collect()).ok()
}

/// Changes that one of a law's motions that begins at `at_s`, or ends there if `begins` is false; `None` if there is none.
fn with_part(law: &Law, at_s: f64, begins: bool, change: &dyn Fn(&Law) -> Option<Law>) -> Option<Law> {
    law.changed_under_backlash(|law| {
        let Law::Then(laws) = law else { return change(law) };
        let mut laws = laws.to_vec();
        let mut from = Time::ZERO;
        for part in &mut laws {
            let to = part.end().map(|end| from + end);
            let is_there = |time: Time| (time.seconds() - at_s).abs() < 1e-6;
            if if begins { is_there(from) } else { to.is_some_and(is_there) } {
                *part = change(part)?;
                return Law::then(laws).ok();
            }
            from = to?;
        }
        None
    })
}

/// Factors by which the tolerance is raised where a plan takes too many bytes for its line.
const LOOSER: [f64; 3] = [2.0, 5.0, 10.0];
/// No tolerance above this is offered for that, s: a motion that needs more has too many steps for its line.
const LOOSEST_OVER_LINE_S: f64 = 20e-6;

/// Advice where the line does not bring the plans of all motors in time.
fn over_line(prepared: &Prepared) -> Vec<String> {
    let (program, line) = (&prepared.program, prepared.line.as_ref());
    let tries = Tries::new();
    let another = || tries.another(program.motors.iter().map(|motor| &motor.law)).is_ok();
    let fits =
        |program: &Program, line: Option<&Line>, factor: f64| another().then(|| plans::all_fit(program, line, factor));
    let mut lines = Vec::new();
    let usb = Line::of(program, Way::Usb);
    let usual = prepare::usual_baud(&program.board.name).rate();
    let uart = Line::of(program, Way::Uart(usual));
    // If both lines would fit, the one that needs no other cable is offered.
    if line != usb.as_ref() && uart.as_ref() != line && fits(program, uart.as_ref(), 1.0) == Some(true) {
        lines.push(format!("as it is, it fits over a line at {usual} baud (--baud)"));
    } else if usb.is_some() && usb.as_ref() != line && fits(program, usb.as_ref(), 1.0) == Some(true) {
        lines.push("as it is, it fits over the board's own USB".to_owned());
    }
    if let Some(factor) = least(|factor| fits(program, line, factor)) {
        lines.push(format!("{} times slower it fits", human::significant(factor, 4)));
    }
    let hz = program.board.tick_hz as f64;
    let looser = LOOSER.map(|times| times * program.tolerance.ticks(program.board.tick_hz));
    let looser = looser.into_iter().filter(|ticks| ticks / hz <= LOOSEST_OVER_LINE_S);
    for ticks in looser {
        let mut other = program.clone();
        other.tolerance = Tolerance::Ticks(ticks);
        if fits(&other, line, 1.0) == Some(true) {
            lines.push(format!("with {} it fits", time_assignment("tolerance", ticks / hz)));
            break;
        }
    }
    for count in (1..program.motors.len()).rev() {
        let mut fewer = program.clone();
        fewer.motors.truncate(count);
        if program.machines.is_empty() && fits(&fewer, prepare::usual_line(&fewer).as_ref(), 1.0) == Some(true) {
            let names =
                |motors: &[Motor]| motors.iter().map(|motor| motor.name.as_str()).collect::<Vec<_>>().join(", ");
            let (these, others) = program.motors.split_at(count);
            lines.push(format!("with {} alone it fits; give {} another board", names(these), names(others)));
            break;
        }
    }
    lines
}

/// Estimated time of all plans that are tried to find a smoothing, s: for noise it is the one remedy.
const MOST_SMOOTHING_S: f64 = 20.0;

/// Whether a table by itself is clearly beyond a motor's limits.
fn passes(law: &Law, limits: &Limits) -> bool {
    let Law::Table(table) = law else { return false };
    let (speed, acceleration) = table.peaks();
    let is_beyond = |value: f64, limit: Option<f64>| limit.is_some_and(|limit| value > 1.01 * limit);
    is_beyond(speed, limits.max_speed) || is_beyond(acceleration, limits.max_acceleration)
}

/// Advice for a recorded angle that starts again after each turn.
fn starting_again(motor: &Motor) -> Option<String> {
    let per_unit = motor.scale.steps_per_unit;
    let (turn, unit) = match motor.scale.unit.as_str() {
        "rev" => (per_unit, "rev"),
        "deg" => (360.0 * per_unit, "deg"),
        "rad" => (std::f64::consts::TAU * per_unit, "rad"),
        _ => return None,
    };
    let (jump, at_s) = motor.law.tables().into_iter().find_map(TableLaw::jump)?;
    let is_turn = (jump.abs() / turn - 1.0).abs() < 0.1;
    let (jump, at) = (human::significant((jump / per_unit).abs(), 4), human::seconds_to(at_s, 4));
    is_turn.then(|| {
        format!("its position jumps by {jump} {unit} at {at}: if it starts again after each turn, write wraps = \"1 rev\" in its table")
    })
}

/// The arms' laws of a delta robot whose tip follows a path from `begin` on. `None` if it is no delta robot, or if an arm does not reach.
fn arms(machine: &Machine, begin: Time, tip: &[Law]) -> Option<Vec<Law>> {
    let Kinematics::Delta { arms, steps_per_rad, .. } = &machine.kinematics else { return None };
    let tip: [Law; 3] = tip.to_vec().try_into().ok()?;
    let law = |arm: usize| {
        let law = Law::delta_arm(arms, arm, &tip, steps_per_rad[arm])?;
        if begin == Time::ZERO { Ok(law) } else { Law::then(vec![Law::rest(begin)?, law]) }
    };
    (0..3).map(law).collect::<Result<Vec<Law>, LawError>>().ok()
}

/// Advice for a motion from a recording: the least smoothing that fits, or that none does.
fn smoothing(prepared: &Prepared, motor: &Motor, error: &PlanError) -> Option<String> {
    let program = &prepared.program;
    let is_curable = error.limit().is_some() || matches!(error, PlanError::Law(LawError::Backlash { .. }));
    // A path's motors come from one table.
    let index = |name: &str| program.motors.iter().position(|motor| motor.name == name);
    let own = index(&motor.name)?;
    let number = program.machines.iter().position(|machine| machine.motors.contains(&own));
    let machine = number.map(|number| &program.machines[number]);
    // Of a delta robot the tip is recorded, and its arms follow from it. A pause and backlash change each arm's law: they are not tried here.
    let is_plain = |machine: &&Machine| prepared.pause.is_none() && machine.slack.iter().all(|slack| *slack == 0.0);
    let recorded = || prepared.recordings.get(number?)?.as_ref();
    let recording = machine.filter(is_plain).zip(recorded());
    if !is_curable || motor.law.tables().is_empty() && recording.is_none() {
        return None;
    }
    let motors = machine.map_or_else(|| vec![own], |machine| machine.motors.clone());
    let laws: Vec<&Law> = match &recording {
        Some((_, recording)) => recording.tip.iter().collect(),
        None => motors.iter().map(|motor| &program.motors[*motor].law).collect(),
    };
    let tries = Tries::of(MOST_SMOOTHING_S);
    let fits = |laws: &[Law]| {
        let arms = match &recording {
            Some((machine, recording)) => arms(machine, recording.begin, laws).map(Cow::Owned),
            None => Some(Cow::Borrowed(laws)),
        };
        // Where an arm does not reach, the smoothed path does not fit.
        let Some(laws) = arms else { return Some(false) };
        let laws = &*laws;
        let mut smooth = program.clone();
        for (motor, law) in motors.iter().zip(laws) {
            smooth.motors[*motor].law = law.clone();
        }
        if error.limit() == Some(Limit::Line) {
            tries.another(smooth.motors.iter().map(|motor| &motor.law)).ok()?;
            return Some(plans::all_fit(&smooth, prepared.line.as_ref(), 1.0));
        }
        // What is far too fast is seen without a plan.
        let limits = motors.iter().map(|motor| &smooth.motors[*motor].limits);
        if laws.iter().zip(limits).any(|(law, limits)| passes(law, limits)) {
            return Some(false);
        }
        tries.another(laws).ok()?;
        Some(motors.iter().all(|motor| {
            let motor = &smooth.motors[*motor];
            plans::fits(&motor.law, &Settings::of(&smooth, motor))
        }))
    };
    match least_smoothing(&laws, fits) {
        Some((over, laws)) => {
            let smooth = time_assignment("smooth", over.seconds());
            // Of a machine the motor that is farthest off.
            let distances = motors.iter().zip(&laws).flat_map(|(index, law)| {
                let per_unit = if recording.is_some() { 1.0 } else { program.motors[*index].scale.steps_per_unit };
                law.tables().into_iter().map(move |table| (table.distance(), per_unit))
            });
            let [largest, rms] = distances.fold([0.0_f64; 2], |[largest, rms], (distance, per_unit)| {
                [largest.max(distance.largest / per_unit), rms.max(distance.rms / per_unit)]
            });
            let [largest, rms] = [largest, rms].map(|distance| human::significant(distance, 2));
            let unit = if recording.is_some() { "mm" } else { motor.scale.unit.as_str() };
            Some(format!(
                "write {smooth} in its table: smoothed it fits, at most {largest} {unit} from the recording (RMS {rms} {unit})"
            ))
        }
        None if tries.left_s.get() < 0.0 => None,
        None => Some("no smoothing of its table fits that leaves the motion what it is".to_owned()),
    }
}

/// What the user can do about a plan's error, in a few lines.
#[must_use]
pub fn advice(prepared: &Prepared, motor: &Motor, error: &PlanError) -> String {
    let mut lines = Vec::new();
    if let PlanError::ToleranceTooTight { least_ticks, .. } = error {
        let least = human::seconds(least_ticks / prepared.program.board.tick_hz as f64);
        return format!("{} is the least: {least} on this board", assignment("tolerance", *least_ticks, "ticks"));
    }
    if let PlanError::NotProvable { bound_ticks, at_s, .. } = error {
        return not_provable(prepared, motor, *bound_ticks, *at_s);
    }
    if let PlanError::BrakesTooHard { least, .. } = error {
        lines.push(format!(
            "a max_acceleration of {} steps/s² or more fits, or a slower motion",
            human::significant(rounded_up(*least), 3)
        ));
    }
    // No smoothing mends what is no noise.
    lines.extend(starting_again(motor).or_else(|| smoothing(prepared, motor, error)));
    if let PlanError::SpeedJump { from, to, at_s, .. } = error {
        lines.extend(smoother(prepared, motor, *at_s, (*from, *to)));
    }
    // A search takes some 20 plans. For long plans it is left to the command `explain`.
    let tries = Tries::new();
    let another = || tries.another([&motor.law]).is_ok();
    if error.limit() == Some(Limit::Line) {
        lines.extend(over_line(prepared));
    } else if error.limit().is_some() && motor.law.backlash_over().is_some() {
        lines.extend(least_over(prepared, motor, another).map(|(slower, over_s)| {
            let over = time_assignment("over", rounded_up(over_s));
            match slower {
                None => format!("`backlash` takes up its slack too fast: {over} fits"),
                Some(factor) => {
                    let times = human::significant(factor, 4);
                    format!("{times} times slower it fits, with {over} in `backlash`")
                }
            }
        }));
    } else if error.limit().is_some()
        && let Some(factor) = slowdown(prepared, motor, another)
    {
        let times = human::significant(factor, 4);
        // Only a motion that was not cut has a duration worth printing.
        let whole = motor.law.end().filter(|end| prepared.cut.is_none_or(|cut| *end < cut.at));
        let fits = whole.map(|end| {
            let (now, then) = (human::seconds_to(end.seconds(), 4), human::seconds_to(end.seconds() * factor, 4));
            format!(": {then} instead of {now}")
        });
        lines.push(format!("{times} times slower it fits{}", fits.unwrap_or_default()));
    }
    if matches!(error.limit(), Some(Limit::Board | Limit::Line)) {
        let settings = Settings::of(&prepared.program, motor);
        if error.limit() == Some(Limit::Board) {
            lines.extend(pulse_limit(prepared, motor, &settings));
        }
        let tries = Tries::new();
        let laws = || prepared.program.motors.iter().map(|motor| &motor.law);
        match boards_that_fit(prepared, || tries.another(laws()).is_ok()) {
            None => {}
            Some(boards) if boards.is_empty() => lines.push("no board in the table does it as it is".to_owned()),
            Some(boards) => {
                let has_none = |name: &str| name != "native" && BoardKind::named(name).is_none();
                let named = boards
                    .into_iter()
                    .map(|name| if has_none(&name) { format!("{name} (no firmware yet)") } else { name });
                lines.push(format!("as it is, it fits: {}", named.collect::<Vec<_>>().join(", ")));
            }
        }
    }
    if error.at_s().is_some() {
        let is_usual = prepared.line.is_none() || prepared.line == prepare::usual_line(&prepared.program);
        let with = if is_usual { "" } else { ", with the same --baud," };
        lines.push(format!("`pulsetrain explain {}`{with} shows the place", prepared.file));
    }
    lines.join("\n")
}
