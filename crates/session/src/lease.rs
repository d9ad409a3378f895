//! How far a lease may reach, how hard the motors may brake, and what they do when their lease ends.

use crate::SessionError;
use crate::stream::Stream;
use crate::timeline::{Step, Timeline};
use pulsetrain_board::lease::Lease;
use pulsetrain_board::replay::{Replay, Sent, Start};
use pulsetrain_core::Item;
use pulsetrain_core::braking::Limit;
use pulsetrain_motion::program::{Program, Wiring};
use pulsetrain_plan::{Refused, Stopping, stopping};

/// How hard each motor of a plan may brake.
///
/// # Errors
/// When a motor's limits and its plan leave no way to brake that the board can do.
pub(crate) fn brakings(stream: &Stream) -> Result<Vec<Stopping>, SessionError> {
    let program = stream.program();
    let of = |(motor, m): (usize, &pulsetrain_motion::program::Motor)| {
        let stopping = stopping(&stream.certificate(motor), &m.limits, &program.board);
        stopping.map_err(|error| Refused { motor, error }.into())
    };
    program.motors.iter().enumerate().map(of).collect()
}

/// The harder limit of each motor.
pub(crate) fn harder(one: &[Limit], other: &[Limit]) -> Vec<Limit> {
    one.iter().zip(other).map(|(one, other)| one.harder(*other)).collect()
}

/// The longest lease for what the board has, after tick `earliest` and up to `latest`. `None` if there is none yet.
///
/// A lease must not end after the last step that the board has of any motor that goes on: the board would run out of plan.
pub(crate) fn longest(stream: &Stream, timelines: &[Timeline], earliest: u64, latest: u64) -> Option<Lease> {
    let least_handed_over = stream.least_handed_over();
    let is_over = || timelines.iter().filter_map(Timeline::last_tick).all(|last| last < latest);
    if least_handed_over.is_none() && is_over() {
        return Some(Lease::Last);
    }
    let until = least_handed_over.map_or(latest, |(tick, _)| tick.min(latest));
    (until > earliest).then_some(Lease::Until(until))
}

/// The first tick, from `from` on, at which all motors can brake, for a plan that takes over from another at `from`.
///
/// A motor brakes from its last interval, and a new plan has none before its first step: a lease that ended there would stop a fast motor at once.
/// So the motors that are fast and go on in their direction have to make one step first. Slow ones, and those that turn or rest, may stop at
/// once.
pub(crate) fn brakeable_from(timelines: &[Timeline], brakings: &[Stopping], program: &Program, from: u64) -> u64 {
    let joins = joining(timelines, brakings, program, from);
    joins.filter_map(|first| Some(first?.0 + 1)).fold(from, u64::max)
}

/// Whether the first steps of all motors are known that must make one before they can brake.
pub(crate) fn is_joined(timelines: &[Timeline], brakings: &[Stopping], program: &Program, from: u64) -> bool {
    joining(timelines, brakings, program, from).all(|first| first.is_some())
}

/// The first steps, from tick `from` on, of the motors that are fast and go on in their direction, as far as they are known.
fn joining(
    timelines: &[Timeline],
    brakings: &[Stopping],
    program: &Program,
    from: u64,
) -> impl Iterator<Item = Option<Step>> {
    timelines.iter().zip(brakings).filter_map(move |(timeline, braking)| {
        let [Some((last, direction)), Some((before, way))] = timeline.last_before(from) else { return None };
        let interval = (last - before).max(from - last);
        let is_slow = way != direction || interval as f64 * braking.slow >= program.board.tick_hz as f64;
        let first = timeline.first_from(from);
        (!is_slow && first.is_none_or(|(_, way)| way == direction)).then_some(first)
    })
}

/// Each motor's timeline if the lease ends at `until`: its plan before that tick, then the steps of its stop.
pub(crate) fn braked_from(timelines: &[Timeline], limits: &[Limit], program: &Program, until: u64) -> Vec<Timeline> {
    let hz = program.board.tick_hz;
    let rests: Vec<(Start, Vec<Item>)> = timelines.iter().map(|timeline| timeline.from(until)).collect();
    let lines = Lines::of(program);
    let sent = rests.iter().zip(limits).enumerate().map(|(motor, ((start, items), limit))| Sent {
        start: *start,
        items,
        limit: *limit,
        gap_ticks: program.timing(&program.motors[motor]).ticks(hz).pulse_high.max(1) + 1,
        line: lines.of_motors[motor],
    });
    let mut after = timelines.to_vec();
    after.iter_mut().for_each(|timeline| timeline.cut(until));
    let replay = Replay::new(sent, &lines.apart_ticks, program.board.registers.fraction_bits, Some(until));
    replay.for_each(|step| after[step.motor].push_step(step.tick, step.direction));
    after
}

/// The DIR lines that motors share.
struct Lines {
    /// For each motor that shares a DIR line: the index of that line, and whether it is high for forward.
    of_motors: Vec<Option<(usize, bool)>>,
    /// For each line: ticks between two steps that need it at different levels. The longest pulse, DIR hold and DIR setup of its motors.
    apart_ticks: Vec<u64>,
}

impl Lines {
    fn of(program: &Program) -> Lines {
        let mut lines: Vec<(u8, u64)> = Vec::new();
        let mut of_motors = Vec::with_capacity(program.motors.len());
        for motor in &program.motors {
            let shares = program.motors.iter().any(|other| other.shares_dir_with(motor));
            let Wiring::StepDir { dir, forward_high, .. } = motor.wiring else {
                of_motors.push(None);
                continue;
            };
            let place = lines.iter().position(|(line, _)| *line == dir).unwrap_or_else(|| {
                let members =
                    program.motors.iter().filter(|other| std::ptr::eq(*other, motor) || other.shares_dir_with(motor));
                let timing = members.map(|member| program.timing(member).ticks(program.board.tick_hz));
                let longest = timing.fold([0; 3], |[pulse, hold, setup], own| {
                    [pulse.max(own.pulse_high), hold.max(own.dir_hold), setup.max(own.dir_setup)]
                });
                lines.push((dir, longest.iter().sum()));
                lines.len() - 1
            });
            of_motors.push(shares.then_some((place, forward_high)));
        }
        Lines { of_motors, apart_ticks: lines.into_iter().map(|(_, ticks)| ticks).collect() }
    }
}
