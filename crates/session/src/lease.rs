//! How long a plan is said to hold, how hard the motors brake, and what they do if it ends.

use crate::SessionError;
use crate::stream::Stream;
use crate::timeline::Timeline;
use pulsetrain_board::lease::Lease;
use pulsetrain_board::replay::{Replay, Sent, Start};
use pulsetrain_core::Item;
use pulsetrain_core::braking::Limit;
use pulsetrain_motion::program::{Program, Wiring};
use pulsetrain_plan::{Refused, Stopping, stopping};

/// How the motors of a plan brake.
pub(crate) fn brakings(stream: &Stream) -> Result<Vec<Stopping>, SessionError> {
    let program = stream.program();
    let of = |(motor, m): (usize, &pulsetrain_motion::program::Motor)| {
        let stopping = stopping(&stream.certificate(motor), &m.limits, &program.board);
        stopping.map_err(|error| Refused { motor, error }.into())
    };
    program.motors.iter().enumerate().map(of).collect()
}

/// The longest lease for what was handed over, after tick `least` and up to `reach`. `None` if there is none yet.
pub(crate) fn longest(stream: &Stream, timelines: &[Timeline], least: u64, reach: u64) -> Option<Lease> {
    let known = stream.known();
    let is_over = || timelines.iter().filter_map(Timeline::last_tick).all(|last| last < reach);
    if known.is_none() && is_over() {
        return Some(Lease::Last);
    }
    let until = known.map_or(reach, |(tick, _)| tick.min(reach));
    (until > least).then_some(Lease::Until(until))
}

/// From the first tick of a plan that takes over from another, up to which tick a motor that is in motion would have to rest at once: until it has
/// made its first step. Where a law itself turns or rests, its motor has come to rest within less than a step. The first tick itself if
/// there is no such motor.
pub(crate) fn joined(timelines: &[Timeline], brakings: &[Stopping], program: &Program, from: u64) -> u64 {
    let joins = timelines.iter().zip(brakings).filter_map(|(timeline, braking)| {
        let [Some((last, direction)), Some((before, way))] = timeline.last_before(from) else { return None };
        let interval = (last - before).max(from - last);
        let is_slow = way != direction || interval as f64 * braking.slow >= program.board.tick_hz as f64;
        timeline.first_from(from).filter(|(_, way)| !is_slow && *way == direction).map(|(first, _)| first + 1)
    });
    joins.fold(from, u64::max)
}

/// What the motors have done, and will do, if their lease ends at `until`.
pub(crate) fn ended(timelines: &[Timeline], limits: &[Limit], program: &Program, until: u64) -> Vec<Timeline> {
    let hz = program.board.tick_hz;
    let told: Vec<(Start, Vec<Item>)> = timelines.iter().map(|timeline| timeline.from(until)).collect();
    let lines = Lines::of(program);
    let sent = told.iter().zip(limits).enumerate().map(|(motor, ((start, items), limit))| Sent {
        start: *start,
        items,
        limit: *limit,
        gap_ticks: program.timing(&program.motors[motor]).ticks(hz).pulse_high.max(1) + 1,
        line: lines.of_motors[motor],
    });
    let mut after = timelines.to_vec();
    after.iter_mut().for_each(|timeline| timeline.cut(until));
    let replay = Replay::new(sent, &lines.apart_ticks, program.board.fraction_bits, Some(until));
    replay.for_each(|step| after[step.motor].push_step(step.tick, step.direction));
    after
}

/// The DIR lines that motors share.
struct Lines {
    /// By motor: its line, if it shares one, and whether that is high for forward.
    of_motors: Vec<Option<(usize, bool)>>,
    /// Pulse, hold and setup of each line's motors.
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
