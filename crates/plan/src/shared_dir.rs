//! Motors that share a DIR line. If they need opposite levels of it, their steps are separated by pulse, hold and setup
//! times. Where a board makes the steps of all motors one after the other ([`SharedSteps`]), the steps of all motors
//! are separated as the board needs.
//!
//! Steps are taken in the order in which they can be made. A step that needs the line at the opposite level waits for
//! the pulse and hold of the last step and the setup of the line. The step after it comes at its planned tick. Segments
//! are cut around a delayed step; the integers of the parts stay what they were.

use crate::Move;
use crate::certificate::Certificate;
use crate::error::{PlanError, Refused};
use crate::planner::Planner;
use crate::settings::Settings;
use pulsetrain_core::{Direction, Segment};
use pulsetrain_motion::program::{DriverTicks, SharedSteps, Wiring};
use std::collections::VecDeque;

/// A group of motors whose steps must be separated: those of one DIR line, or all if the board makes steps one after
/// the other.
pub(crate) struct SharedDir {
    members: Vec<Member>,
    lines: Vec<DirLine>,
    fraction_bits: u32,
    /// The separation that the board needs between steps of any two members.
    steps: Option<SharedSteps>,
    /// Tick of the last step; of steps at one time, the first.
    made: Option<i64>,
}

/// A DIR line.
struct DirLine {
    /// `None` for coils.
    pin: Option<u8>,
    /// Longest pulse and hold of its motors, ticks.
    keep_ticks: i64,
    /// Longest setup of its motors, ticks.
    setup_ticks: i64,
    /// Tick of the last step made, and the level that it wanted.
    last: Option<(i64, bool)>,
}

struct Member {
    motor: usize,
    /// Index of its DIR line.
    line: usize,
    planner: Planner,
    /// The level of the line for a step forward.
    forward_high: bool,
    min_interval_ticks: i64,
    tick_hz: f64,
    /// Tick of the last step made.
    last: Option<i64>,
    /// Accumulator of the plan after the last step that was taken, ticks · 2^F.
    accumulator: i128,
    /// The part of the present segment that has not been taken.
    segment: Option<(Segment, Direction)>,
    /// The steps of it that need no change.
    unchanged: u32,
    /// The delay of the last step, ticks.
    late: i64,
    /// Moves that are ready, each with its delay in ticks.
    out: VecDeque<(Move, u64)>,
    /// The delay of the last move that was returned, ticks.
    given_late: u64,
    put_off: u64,
    longest_put_off: i64,
    /// Its last move is a wait, and the next one was not looked at. A motor may rest for ever.
    waits: bool,
    /// Shortest interval before or after a delayed step, ticks.
    shortest_moved: Option<u64>,
    ended: bool,
}

impl SharedDir {
    pub(crate) fn new(fraction_bits: u32, steps: Option<SharedSteps>) -> SharedDir {
        SharedDir { members: Vec::new(), lines: Vec::new(), fraction_bits, steps, made: None }
    }

    /// Adds a motor, with its last step before tick 0. Returns its place in the group.
    pub(crate) fn join(
        &mut self,
        motor: usize,
        planner: Planner,
        settings: &Settings,
        timing: &DriverTicks,
        wiring: &Wiring,
        last_step: Option<(i64, Direction)>,
    ) -> usize {
        let (pin, forward_high) = match *wiring {
            Wiring::StepDir { dir, forward_high, .. } => (Some(dir), forward_high),
            Wiring::Coils { .. } => (None, false),
        };
        let known = self.lines.iter().position(|line| pin.is_some() && line.pin == pin);
        let index = known.unwrap_or_else(|| {
            self.lines.push(DirLine { pin, keep_ticks: 0, setup_ticks: 0, last: None });
            self.lines.len() - 1
        });
        let line = &mut self.lines[index];
        let last_level = last_step.map(|(tick, direction)| (tick, level(direction, forward_high)));
        line.last = line.last.into_iter().chain(last_level).max_by_key(|(tick, _)| *tick);
        line.keep_ticks = line.keep_ticks.max((timing.pulse_high + timing.dir_hold) as i64);
        let turn = settings.reversal_ticks - (timing.pulse_high + timing.dir_hold).min(settings.reversal_ticks);
        line.setup_ticks = line.setup_ticks.max(turn as i64);
        self.made = self.made.max(last_step.map(|(tick, _)| tick));
        self.members.push(Member {
            motor,
            line: index,
            planner,
            forward_high,
            min_interval_ticks: settings.min_interval_ticks as i64,
            tick_hz: settings.tick_hz as f64,
            last: last_step.map(|(tick, _)| tick),
            accumulator: 1 << (settings.registers.fraction_bits - 1),
            segment: None,
            unchanged: 0,
            late: 0,
            out: VecDeque::new(),
            given_late: 0,
            put_off: 0,
            longest_put_off: 0,
            shortest_moved: None,
            waits: false,
            ended: false,
        });
        self.members.len() - 1
    }

    pub(crate) fn certificate(&self, place: usize) -> Certificate {
        let member = &self.members[place];
        let certificate = member.planner.certificate().clone();
        Certificate {
            bound_ticks: certificate.bound_ticks + member.longest_put_off as f64,
            shortest_interval_ticks: certificate.shortest_interval_ticks.into_iter().chain(member.shortest_moved).min(),
            steps_put_off: member.put_off,
            longest_put_off_ticks: member.longest_put_off as u64,
            ..certificate
        }
    }

    /// The delay of the last move of a motor that was returned, ticks.
    pub(crate) fn put_off_ticks(&self, place: usize) -> u64 {
        self.members[place].given_late
    }

    pub(crate) fn next_move(&mut self, place: usize) -> Result<Option<Move>, Refused> {
        loop {
            if let Some(next) = self.members[place].next_ready() {
                return Ok(Some(next));
            }
            // Other motors of the line may have an endless plan.
            let member = &self.members[place];
            if member.ended && member.segment.is_none() {
                return Ok(None);
            }
            // Its next move may be asked for long before others have made the steps up to then.
            if std::mem::take(&mut self.members[place].waits) {
                self.members[place].due(self.fraction_bits)?;
                continue;
            }
            if !self.take_step()? {
                return Ok(self.members[place].next_ready());
            }
        }
    }

    /// Takes the step that can be made first, or looks further at a motor that waits longer than any other step. Returns `false` when no motor has
    /// one.
    fn take_step(&mut self) -> Result<bool, Refused> {
        let mut first: Option<Candidate> = None;
        for place in 0..self.members.len() {
            let Some((due, direction)) = self.members[place].due(self.fraction_bits)? else { continue };
            let member = &self.members[place];
            let level = level(direction, member.forward_high);
            let line = &self.lines[member.line];
            let turns = line.last.is_some_and(|(_, now)| now != level);
            let possible = match line.last {
                // The line must change: the last step needs its time after it, and this step its setup before it.
                Some((last, _)) if turns => due.max(last + line.keep_ticks + line.setup_ticks),
                Some((last, _)) => due.max(last),
                None => due,
            };
            let possible = match (self.made, self.steps) {
                (Some(made), Some(steps)) => {
                    let (together, apart) =
                        (made + i64::from(steps.together_ticks), made + i64::from(steps.apart_ticks));
                    // The board changes a DIR line only when the pulses on all STEP lines are over.
                    if turns {
                        possible.max(apart + line.setup_ticks)
                    } else if possible > together {
                        possible.max(apart)
                    } else {
                        possible.max(made)
                    }
                }
                _ => possible,
            };
            // A plan separates its own steps, but it does not know the motor's last step before the plan.
            let spaced = member.last.filter(|last| *last < 0).map(|last| last + member.min_interval_ticks);
            let possible = spaced.map_or(possible, |spaced| possible.max(spaced));
            let candidate = Candidate { possible, turns, place, late: possible - due, level };
            // Of steps at the same tick, those come first for which the line already has the right level.
            if first.as_ref().is_none_or(|f| (possible, turns) < (f.possible, f.turns)) {
                first = Some(candidate);
            }
        }
        let waiting = self.members.iter_mut().filter(|member| member.waits);
        if let Some(waiting) = waiting.min_by_key(|member| member.accumulator)
            && first
                .as_ref()
                .is_none_or(|first| i128::from(first.possible) >= waiting.accumulator >> self.fraction_bits)
        {
            waiting.waits = false;
            waiting.due(self.fraction_bits)?;
            return Ok(true);
        }
        let Some(step) = first else { return Ok(false) };
        let line = self.members[step.place].line;
        self.members[step.place].take(step.late, self.fraction_bits)?;
        self.lines[line].last = Some((step.possible, step.level));
        let together = self.steps.map_or(0, |steps| i64::from(steps.together_ticks));
        if self.made.is_none_or(|made| step.possible > made + together) {
            self.made = Some(step.possible);
        }
        Ok(true)
    }
}

/// The next step of a motor.
struct Candidate {
    /// The tick at which it can be made.
    possible: i64,
    /// Whether the line must change before it.
    turns: bool,
    place: usize,
    /// Its delay, ticks.
    late: i64,
    /// The level of the line that it needs.
    level: bool,
}

/// The level of a DIR line for a step.
fn level(direction: Direction, forward_high: bool) -> bool {
    (direction == Direction::Forward) == forward_high
}

impl Member {
    fn refused(&self, error: PlanError) -> Refused {
        Refused { motor: self.motor, error }
    }

    /// The planned tick of the next step, and its direction; `None` at the end of the plan, and while the motor waits.
    fn due(&mut self, fraction_bits: u32) -> Result<Option<(i64, Direction)>, Refused> {
        while self.segment.is_none() {
            if self.ended || self.waits {
                return Ok(None);
            }
            match self.planner.next_move().map_err(|error| self.refused(error))? {
                Some(Move::Run { segment, direction }) => self.segment = Some((segment, direction)),
                Some(Move::Dwell { ticks }) => {
                    self.accumulator += i128::from(ticks) << fraction_bits;
                    self.out.push_back((Move::Dwell { ticks }, 0));
                    self.waits = true;
                }
                None => self.ended = true,
            }
        }
        Ok(self.segment.map(|(segment, direction)| {
            let next = segment.after(self.unchanged);
            (((self.accumulator + i128::from(next.interval)) >> fraction_bits) as i64, direction)
        }))
    }

    /// Takes the next step with a delay of `late` ticks.
    fn take(&mut self, late: i64, fraction_bits: u32) -> Result<(), Refused> {
        let Some((segment, direction)) = self.segment else { return Ok(()) };
        let step = segment.after(self.unchanged);
        self.accumulator += i128::from(step.interval);
        let tick = (self.accumulator >> fraction_bits) as i64 + late;
        let spacing = self.last.replace(tick).map_or(i64::MAX, |last| tick - last);
        if late == 0 && self.late == 0 {
            self.unchanged += 1;
            if self.unchanged == segment.count {
                self.flush();
                self.segment = None;
            }
            return Ok(());
        }
        // This step, or the one before it, was delayed, so that it is a move of its own.
        let taken = self.unchanged;
        self.flush();
        let interval = step.interval + ((late - self.late) << fraction_bits);
        if spacing < self.min_interval_ticks {
            let (at_s, limit_ticks) = (tick as f64 / self.tick_hz, self.min_interval_ticks);
            return Err(self.refused(PlanError::LineTooBusy { at_s, interval_ticks: spacing, limit_ticks }));
        }
        if spacing < i64::MAX {
            self.shortest_moved = self.shortest_moved.into_iter().chain([spacing.unsigned_abs()]).min();
        }
        let alone = Move::Run { segment: Segment { interval, ..step.truncated(1) }, direction };
        self.out.push_back((alone, late.max(0).unsigned_abs()));
        if late > 0 {
            self.put_off += 1;
            self.longest_put_off = self.longest_put_off.max(late);
        }
        self.late = late;
        self.segment = (segment.count > taken + 1).then(|| (segment.after(taken + 1), direction));
        Ok(())
    }

    /// Returns the next move that is ready.
    fn next_ready(&mut self) -> Option<Move> {
        let (next, late) = self.out.pop_front()?;
        self.given_late = late;
        Some(next)
    }

    /// Makes a move of the steps that need no change.
    fn flush(&mut self) {
        if let Some((segment, direction)) = self.segment.filter(|_| self.unchanged > 0) {
            self.out.push_back((Move::Run { segment: segment.truncated(self.unchanged), direction }, 0));
        }
        self.unchanged = 0;
    }
}
