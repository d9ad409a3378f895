//! Why a capture fails that is right: it begins elsewhere, ends early, shows pins, has STEP and DIR swapped, or a DIR that is
//! reversed.

use pulsetrain_motion::human;
use pulsetrain_motion::program::{Motor, Program, Wiring};
use pulsetrain_session::lateness::Edges;
use pulsetrain_trace::capture::Capture;
use pulsetrain_trace::verdict::{self, Align, Options, Report};
use pulsetrain_trace::{Trace, lines};

/// The options for a capture of a board's pins: edges come its constant delay after their scheduled ticks, and may be late in addition.
pub(super) fn of_pins(options: &Options, program: &Program) -> Options {
    let edges = Edges::of(program);
    let tolerance = program.tolerance.ticks(program.board.tick_hz);
    Options {
        constant_ticks: edges.constant_ticks.into(),
        bound_ticks: Some(tolerance + f64::from(edges.late_ticks)),
        ..*options
    }
}

/// What would make a failed capture pass, or why it cannot. Each answer was tried. `pins`: the options are those of pins already.
pub(super) fn hints(
    capture: &Capture,
    program: &Program,
    options: &Options,
    report: &Report,
    pins: bool,
) -> Vec<String> {
    if let Capture::Edges(trace) = capture {
        let swapped: Vec<String> = program.motors.iter().filter_map(|motor| swapped(trace, motor)).collect();
        if !swapped.is_empty() {
            return swapped;
        }
    }
    let judge_as = |program: &Program, options: &Options| match capture {
        Capture::Edges(trace) => verdict::judge(trace, program, options).ok(),
        Capture::Steps(steps) => verdict::judge_steps(steps, program, options).ok(),
        Capture::Film(_) => None,
    };
    let judge = |options: &Options| judge_as(program, options);
    let is_delayed = Edges::of(program) != Edges::default();
    let mut tried = Vec::new();
    for with_pins in [false, true].into_iter().filter(|with_pins| !with_pins || (is_delayed && !pins)) {
        for aligned in [false, true].into_iter().filter(|aligned| !aligned || options.align == Align::None) {
            let mut other = if with_pins { of_pins(options, program) } else { *options };
            let mut flags = Vec::new();
            if with_pins {
                flags.push("--pins".to_owned());
            }
            if aligned {
                other.align = Align::StartAndRate;
                flags.push("--align start+rate".to_owned());
            }
            let seen = if flags.is_empty() { Some(report.clone()) } else { judge(&other) };
            tried.extend(seen.map(|seen| (flags, other, seen)));
        }
    }
    if let Some((flags, _, seen)) = tried.iter().find(|(_, _, seen)| seen.ok) {
        let shift_s = seen.alignment.shift_s;
        let begins = if flags.iter().any(|flag| flag.starts_with("--align")) {
            format!(": the motion begins at {} of the capture", human::seconds_to(shift_s, 6))
        } else {
            String::new()
        };
        return vec![format!("With {} it passes{begins}.", flags.join(" "))];
    }
    if let Capture::Edges(_) = capture {
        let reversed = reversed(program, report, &tried, judge_as);
        if !reversed.is_empty() {
            return reversed;
        }
    }
    // A run that was stopped, or a capture that ended early: all is right up to some time.
    let until = tried.iter().find_map(|(flags, other, seen)| {
        let lacks = seen.motors.iter().any(|motor| motor.missing > 0);
        let first_s = seen.failures.iter().map(|failure| failure.at_s).reduce(f64::min).filter(|_| lacks && other.until_s.is_none())?;
        // Rounded down, so that it can be typed.
        let until_s = (first_s * 1000.0).floor() / 1000.0;
        let right = judge(&Options { until_s: Some(until_s), ..*other })?;
        (until_s > 0.0 && right.ok && right.motors.iter().any(|motor| motor.steps_got > 0)).then(|| {
            let flags: String = flags.iter().map(|flag| format!("{flag} ")).collect();
            format!("Up to {until_s} s every step is right. Was the run stopped there, or the capture? Then say {flags}--until \"{until_s} s\"")
        })
    });
    until.into_iter().collect()
}

/// The motors of which each step is right with the other level of DIR, and what to write for each. `tried` has options, and their flags.
fn reversed(
    program: &Program,
    report: &Report,
    tried: &[(Vec<String>, Options, Report)],
    judge: impl Fn(&Program, &Options) -> Option<Report>,
) -> Vec<String> {
    let mut other = program.clone();
    let mut turned = vec![false; other.motors.len()];
    for ((motor, turned), seen) in other.motors.iter_mut().zip(&mut turned).zip(&report.motors) {
        if let Wiring::StepDir { forward_high, .. } = &mut motor.wiring
            && seen.faults > 0
            && seen.steps_got > 0
        {
            (*forward_high, *turned) = (!*forward_high, true);
        }
    }
    if !turned.contains(&true) {
        return Vec::new();
    }
    let found = tried.iter().find_map(|(flags, options, _)| {
        let seen = judge(&other, options)?;
        let is_right = |(turned, seen): (&bool, &verdict::MotorReport)| *turned && seen.faults == 0;
        let right: Vec<bool> = turned.iter().zip(&seen.motors).map(is_right).collect();
        right.contains(&true).then_some((flags, right))
    });
    let Some((flags, right)) = found else { return Vec::new() };
    let with = if flags.is_empty() { String::new() } else { format!(", judged with {}", flags.join(" ")) };
    let of = |(motor, _): (&Motor, bool)| {
        let Wiring::StepDir { forward_high, .. } = motor.wiring else { return String::new() };
        let [now, then] = if forward_high { ["low", "high"] } else { ["high", "low"] };
        let name = &motor.name;
        format!(
            "DIR of {name} is reversed: the file says forward = \"{now}\", and each step is right with \"{then}\"{with}. Write forward = \
             \"{then}\" in [motor.{name}], or take out what inverts its DIR line"
        )
    };
    other.motors.iter().zip(right).filter(|(_, right)| *right).map(of).collect()
}

/// Whether a motor's STEP and DIR are swapped: the line that is taken for DIR pulses, the other one changes as DIR does.
fn swapped(trace: &Trace, motor: &Motor) -> Option<String> {
    let Wiring::StepDir { step, dir, .. } = motor.wiring else { return None };
    let [step, dir] =
        [("step", step), ("dir", dir)].map(|(role, pin)| lines::find(&trace.lines, &motor.name, role, pin).ok());
    let edges_of = |line: usize| trace.edges.iter().filter(|edge| usize::from(edge.line) == line).count();
    let (step, dir) = (step?, dir?);
    let [as_step, as_dir] = [step, dir].map(edges_of);
    // A motor makes at least two edges of STEP for each of DIR, as a reversal without a step between would be none.
    (as_dir > 2 * as_step.max(1)).then(|| {
        let name = |line: usize| trace.lines[line].names.first().map_or("?", String::as_str);
        let motor = &motor.name;
        format!(
            "STEP and DIR of {motor} are swapped: {} changes {} times and is taken for DIR, {} {} times and is taken for STEP. Swap the \
             probes, or say --line \"{}={motor}.step\" --line \"{}={motor}.dir\"",
            name(dir),
            human::count(as_dir as i128),
            name(step),
            human::count(as_step as i128),
            name(dir),
            name(step),
        )
    })
}
