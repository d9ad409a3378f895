//! The planner: turns a law into a stream of moves, in constant memory.

use crate::certificate::Certificate;
use crate::error::PlanError;
use crate::expansion::{Frame, ULP, two_sum};
use crate::load::{Backlog, Excess};
use crate::packed::Meter;
use crate::peak::peak;
use crate::run::{EXACT_STEPS, Registers, Rules, Run, RunPlanner, shortest_interval};
use crate::settings::Settings;
use crate::stretch::{Stretch, stretches};
use crate::{MIN_TOLERANCE_TICKS, Move};
use pulsetrain_core::{Direction, Segment};
use pulsetrain_motion::law::{Class, Entry, Law, LawError, Piece, Pieces};
use pulsetrain_motion::{TOUCH_STEPS, Time};
use std::collections::VecDeque;

/// A touch is ignored if an even speed would make it later by less than this, ticks.
const TOUCH_TICKS: f64 = 1e-3;
/// A piece counts as straight if it bends by no more than this many roundings of θ: then rounding hides the bend.
const BEND_ROUNDINGS: f64 = 64.0;
/// Waits longer than this are dwells, ticks: 24 bits serve every board's interval.
pub const LONGEST_WAIT_TICKS: u32 = 1 << 24;
/// Largest add of a segment, ticks · 2^F, where registers have room for more.
const MAX_PLANNED_ADD: i64 = 1 << 56;
/// Loosest fit of a segment, ticks. Looser fits save few bytes, and such steps come too close to their neighbours.
const LOOSEST_FIT_TICKS: f64 = 1024.0;
/// Largest distance of a piece from its own origin, steps. Beyond it f64 has no half steps.
const FARTHEST_IN_PIECE: f64 = 4_503_599_627_370_496.0;
/// Last tick of a plan. Ticks beyond it might leave an i64.
pub const LAST_TICK: i128 = 1 << 62;
/// After this many pieces without a step the planner returns a wait, so that its caller does not wait for it.
const IDLE_PIECES: u32 = 4096;
/// Shortest time of that many pieces, ticks. If they are shorter, the law is too fine for the board.
const IDLE_PIECES_TICKS: i64 = IDLE_PIECES as i64;
/// Such a wait ends this long before the end of the known law, ticks, and is at least this long.
const IDLE_MARGIN_TICKS: i64 = 65_536;
/// Relative precision of reported peaks. Near a limit they are as precise as the limit demands.
const PEAK_PRECISION: f64 = 1e-2;
/// Relative excess over a limit that is accepted, because a trapezoid runs exactly at its limit.
const LIMIT_SLACK: f64 = 1e-6;

/// Plans a law, as one move after the other.
///
/// ```
/// use pulsetrain_motion::{Law, Time, law::Sine};
/// use pulsetrain_plan::{Planner, Settings};
///
/// let law = Law::Sine(Sine { amplitude: 2000.0, period: Time::SECOND, cycles: Some(1) });
/// let mut planner = Planner::new(&law, &Settings::new(16_000_000, 16))?;
/// while let Some(_move) = planner.next_move()? {}
/// assert_eq!(planner.certificate().steps, 8000);
/// assert!(planner.certificate().bound_ticks <= 1.0);
/// # Ok::<(), pulsetrain_plan::PlanError>(())
/// ```
pub struct Planner {
    pieces: Pieces,
    settings: Settings,
    rules: Rules,
    registers: Registers,
    certificate: Certificate,
    meter: Option<Meter>,
    /// θ at t = 0: whole steps, and a fraction that is the sum of two numbers. Steps count from there.
    start: Option<(i64, f64, f64)>,
    /// The speed of the motor at the beginning, steps/s.
    arrival: f64,
    /// Where the last piece ended.
    end: Option<End>,
    /// The tick of the end of the last piece, and of the piece before it.
    known_to: i64,
    known_before: i64,
    /// The position after all runs that have been cut from the law.
    position: i64,
    waiting: VecDeque<(Stretch, PieceFrame)>,
    /// Whether the last stretch ends with its piece. The next piece shows whether θ goes on in the same direction.
    open: bool,
    /// The run that is being planned, and the next one: the end of a run depends on the beginning of the next.
    current: Option<RunPlanner>,
    next: Option<Run>,
    moves: VecDeque<Move>,
    last_step: Option<i64>,
    backlog: Backlog,
    direction: Option<Direction>,
    finished: bool,
}

/// The state of a motor at the beginning of a plan, if that is not the law's own start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Origin {
    /// Steps made so far.
    pub position: i64,
    /// The value of the law's θ at that position, steps.
    pub theta: f64,
    /// The speed of the motor, steps/s.
    pub speed: f64,
}

/// Largest distance from a law of a motor that goes on under it, steps: half a step and h, and a dropped pair of steps.
const FARTHEST_FROM_LAW: f64 = 2.0;

/// The next part of a law.
enum Cut {
    /// A run with steps.
    Run(Box<Run>),
    /// No steps up to this tick.
    Idle(i64),
    /// No more steps.
    End,
}

/// The common properties of the stretches of one piece.
#[derive(Clone, Copy, Debug)]
struct PieceFrame {
    origin: i64,
    zero: (i64, f64),
}

/// The end of a piece.
#[derive(Clone, Copy, Debug)]
struct End {
    at_s: f64,
    origin: i64,
    value: f64,
    speed: f64,
}

impl Planner {
    /// Prepares to plan `law`.
    ///
    /// # Errors
    /// If the tolerance is below what can be proven, [`MIN_TOLERANCE_TICKS`].
    pub fn new(law: &Law, settings: &Settings) -> Result<Planner, PlanError> {
        let tolerance_ticks = settings.tolerance_ticks;
        if tolerance_ticks.is_nan() || tolerance_ticks < MIN_TOLERANCE_TICKS {
            return Err(PlanError::ToleranceTooTight { tolerance_ticks, least_ticks: MIN_TOLERANCE_TICKS });
        }
        let rules = Rules {
            fraction_bits: settings.registers.fraction_bits,
            tolerance: tolerance_ticks.min(LOOSEST_FIT_TICKS),
            gain: settings.gain(),
            largest_add: settings.registers.max_add().min(MAX_PLANNED_ADD),
            longest_wait: f64::from(LONGEST_WAIT_TICKS),
            longest: if settings.packed { u32::from(u16::MAX) } else { 1 << 24 },
            min_interval: i64::try_from(settings.min_interval_ticks).unwrap_or(i64::MAX),
        };
        Ok(Planner {
            pieces: law.pieces(),
            settings: settings.clone(),
            rules,
            registers: Registers {
                tick: 0,
                fraction: 1 << (settings.registers.fraction_bits - 1),
                predicted: Segment::default(),
                count: 4,
            },
            certificate: Certificate::new(law.class()),
            meter: settings.packed.then(|| Meter::new(settings)),
            start: None,
            arrival: 0.0,
            end: None,
            known_to: 0,
            known_before: 0,
            position: 0,
            waiting: VecDeque::new(),
            open: false,
            current: None,
            next: None,
            moves: VecDeque::new(),
            last_step: None,
            backlog: Backlog::default(),
            direction: None,
            finished: false,
        })
    }

    /// Prepares to plan `law` for a motor that has already moved: its steps go on from `origin`.
    ///
    /// If the law begins more than two steps from the motor's position, the first move is [`LawError::Jump`].
    ///
    /// # Errors
    /// As for [`Planner::new`].
    pub fn from(origin: Origin, law: &Law, settings: &Settings) -> Result<Planner, PlanError> {
        let mut planner = Planner::new(law, settings)?;
        planner.position = origin.position;
        planner.start = Some((0, origin.theta, 0.0));
        planner.arrival = origin.speed;
        Ok(planner)
    }

    /// What is proven of the moves that have been returned so far.
    #[must_use]
    pub fn certificate(&self) -> &Certificate {
        &self.certificate
    }

    /// The tick of the last step, or of the end of the last dwell, that has been returned.
    #[must_use]
    pub fn tick(&self) -> i64 {
        self.registers.tick
    }

    /// The next move; `None` at the end of the law.
    ///
    /// # Errors
    /// If the law breaks or leaves a limit. The moves before it stay valid.
    pub fn next_move(&mut self) -> Result<Option<Move>, PlanError> {
        loop {
            if let Some(next) = self.moves.pop_front() {
                return Ok(Some(next));
            }
            if self.current.as_ref().is_some_and(|run| !run.is_done()) {
                self.plan_segment()?;
            } else if !self.take_next_run()? {
                return Ok(None);
            }
        }
    }

    fn plan_segment(&mut self) -> Result<(), PlanError> {
        let Some(planner) = &mut self.current else { return Ok(()) };
        let direction = planner.run.direction;
        let turns = self.direction != Some(direction);
        if turns {
            self.registers.reset();
            self.direction = Some(direction);
        }
        let fraction_bits = self.rules.fraction_bits;
        let fit = planner.next(&self.registers, &self.rules);
        let segment = fit.segment;
        if fit.dwell > 0 {
            self.registers.tick += fit.dwell as i64;
            self.emit(Move::Dwell { ticks: fit.dwell });
        }
        let before = self.registers;
        self.registers.advance(&segment, fraction_bits);
        let at_s = self.registers.tick as f64 / self.settings.tick_hz as f64;
        let tolerance_ticks = self.settings.tolerance_ticks;
        // NaN proves nothing.
        if fit.bound.is_nan() || fit.bound > tolerance_ticks {
            return Err(PlanError::NotProvable { at_s, bound_ticks: fit.bound, tolerance_ticks });
        }
        self.check_spacing(&segment, &before)?;
        self.check_load(&segment, turns)?;
        self.certificate.add(&segment, direction, fit.bound);
        self.emit(Move::Run { segment, direction });
        Ok(())
    }

    fn emit(&mut self, next: Move) {
        if let Some(meter) = &mut self.meter {
            meter.add(&next);
            self.certificate.bytes = meter.bytes();
        }
        self.moves.push_back(next);
    }

    /// Refuses segments whose steps come closer together than the board can make them.
    fn check_spacing(&mut self, segment: &Segment, before: &Registers) -> Result<(), PlanError> {
        let fraction_bits = self.rules.fraction_bits;
        let first = before.tick + ((before.fraction + segment.interval) >> fraction_bits);
        let mut shortest = self.last_step.map(|last| (first - last, first));
        if segment.count > 1 {
            let (interval, at) = shortest_interval(segment);
            let ticks = interval >> fraction_bits;
            if shortest.is_none_or(|(s, _)| ticks < s) {
                let tick = before.tick + ((i128::from(before.fraction) + segment.span(at)) >> fraction_bits) as i64;
                shortest = Some((ticks, tick));
            }
        }
        self.last_step = Some(self.registers.tick);
        let Some((ticks, tick)) = shortest else { return Ok(()) };
        if ticks < self.settings.min_interval_ticks as i64 {
            let hz = self.settings.tick_hz as f64;
            return Err(PlanError::TooFastForBoard {
                at_s: tick as f64 / hz,
                rate_hz: hz / (ticks.max(1)) as f64,
                limit_hz: self.settings.highest_rate_hz(),
            });
        }
        let known = &mut self.certificate.shortest_interval_ticks;
        *known = Some(known.map_or(ticks as u64, |known| known.min(ticks as u64)));
        Ok(())
    }

    /// Refuses segments that are too many for the board's processor.
    fn check_load(&mut self, segment: &Segment, turns: bool) -> Result<(), PlanError> {
        let Some(load) = self.settings.load else { return Ok(()) };
        let tick = self.registers.tick;
        let hz = self.settings.tick_hz as f64;
        self.backlog.add(&load, segment, turns, tick).map_err(|Excess { asked, done }| PlanError::TooManySegments {
            at_s: tick as f64 / hz,
            rate_hz: asked * hz,
            limit_hz: done * hz,
        })
    }

    /// Makes the next run the current one, or waits for it. Returns `false` at the end of the law.
    fn take_next_run(&mut self) -> Result<bool, PlanError> {
        let mut run = match self.next.take() {
            Some(run) => run,
            None => match self.cut_run()? {
                Cut::Run(run) => *run,
                Cut::Idle(known_to) => {
                    self.wait(known_to - IDLE_MARGIN_TICKS);
                    return Ok(true);
                }
                Cut::End => return Ok(false),
            },
        };
        let known_from = self.known_to;
        let mut dropped = 0;
        loop {
            let mut after = match self.cut_run()? {
                Cut::Run(after) => *after,
                Cut::Idle(known_to) if run.count > 0 && self.turns_before(&run, known_to) => continue,
                Cut::Idle(_) | Cut::End => {
                    self.current = (run.count > 0).then(|| RunPlanner::new(run, self.current.as_ref()));
                    return Ok(self.current.is_some() || !self.finished);
                }
            };
            self.drop_close_pairs(&mut run, &mut after)?;
            if run.count == 0 {
                run = after;
                dropped += 1;
                // All pairs have been dropped for a while: treat it as a time without steps.
                if dropped >= IDLE_PIECES && run.count == 0 && self.waiting.len() <= usize::from(self.open) {
                    self.check_fineness(known_from)?;
                    self.wait(self.looked_at_to() - IDLE_MARGIN_TICKS);
                    return Ok(true);
                }
                continue;
            }
            self.next = (after.count > 0).then_some(after);
            self.current = Some(RunPlanner::new(run, self.current.as_ref()));
            return Ok(true);
        }
    }

    /// Refuses laws that go through many pieces without a step within few ticks.
    fn check_fineness(&self, known_from: i64) -> Result<(), PlanError> {
        if self.known_to - known_from >= IDLE_PIECES_TICKS {
            return Ok(());
        }
        Err(PlanError::TooFine { at_s: self.known_to as f64 / self.settings.tick_hz as f64 })
    }

    /// Adds a wait until `tick`, if it is long enough for a move.
    fn wait(&mut self, tick: i64) {
        let ticks = tick - self.registers.tick;
        if ticks >= IDLE_MARGIN_TICKS {
            self.registers.tick = tick;
            self.emit(Move::Dwell { ticks: ticks.unsigned_abs() });
        }
    }

    /// Opposite steps that are closer than this may be too close, ticks, because each may be off by the tolerance.
    fn gap(&self) -> f64 {
        self.settings.reversal_ticks.max(self.settings.min_interval_ticks) as f64 + 2.0 * self.rules.tolerance
    }

    /// Whether a step at `tick` or later may still be too close to the last one of `run`.
    fn turns_before(&self, run: &Run, tick: i64) -> bool {
        let (last, _) = run.due(run.count, run.guess(run.count));
        run.own_tick(tick) - last.tick < self.gap()
    }

    /// Drops pairs of opposite steps that are closer than the driver can reverse.
    ///
    /// This is for laws that graze a step. A law that is too fast for the board right up to its turning point is
    /// refused.
    fn drop_close_pairs(&mut self, run: &mut Run, after: &mut Run) -> Result<(), PlanError> {
        if run.direction == after.direction {
            return Ok(());
        }
        let gap = self.gap();
        let mut later: Option<f64> = None;
        while run.count > 0 && after.count > 0 {
            let (last, _) = run.due(run.count, run.guess(run.count));
            let (first, _) = after.due(1, after.guess(1));
            let apart =
                (after.origin.0 - run.origin.0) as f64 + (after.origin.1 - run.origin.1) + first.tick - last.tick;
            if apart >= gap {
                break;
            }
            let own_apart = later.replace(last.tick).map_or(f64::INFINITY, |later| later - last.tick);
            if own_apart * (1.0 + LIMIT_SLACK) < self.settings.min_interval_ticks as f64 {
                let hz = self.settings.tick_hz as f64;
                return Err(PlanError::TooFastForBoard {
                    at_s: (run.origin.0 as f64 + last.tick) / hz,
                    rate_hz: hz / own_apart.max(1.0),
                    limit_hz: self.settings.highest_rate_hz(),
                });
            }
            // θ at the turning point, relative to the position where the motor now stays.
            let turn = (run.stretch.value_to - run.frame.zero) * run.frame.sign;
            (run.count, run.touches, run.reached_by) = (run.count - 1, false, None);
            after.count -= 1;
            let (zero, lost) = two_sum(after.frame.zero, after.frame.sign);
            after.frame.zero = zero;
            after.frame.zero_low += lost;
            let hysteresis = self.settings.grid.hysteresis;
            let error = turn - run.count as f64 - 0.5 + hysteresis;
            self.certificate.pairs_dropped += 1;
            self.certificate.worst_position_error = self.certificate.worst_position_error.max(error);
        }
        Ok(())
    }

    /// The tick up to which all steps have been found.
    fn looked_at_to(&self) -> i64 {
        if self.open { self.known_before } else { self.known_to }
    }

    /// The next run that has steps.
    fn cut_run(&mut self) -> Result<Cut, PlanError> {
        let mut pieces = 0;
        let known_from = self.known_to;
        loop {
            while self.waiting.len() > usize::from(self.open) {
                let Some((stretch, piece)) = self.waiting.pop_front() else { break };
                let run = self.run(stretch, piece);
                if run.count > 0 {
                    self.position += i64::from(run.direction.sign()) * run.count as i64;
                    return Ok(Cut::Run(Box::new(run)));
                }
            }
            if self.finished && self.waiting.is_empty() {
                return Ok(Cut::End);
            }
            if pieces == IDLE_PIECES {
                self.check_fineness(known_from)?;
                return Ok(Cut::Idle(self.looked_at_to()));
            }
            pieces += 1;
            match self.pieces.next() {
                Some(piece) => self.admit(&piece?)?,
                None => {
                    (self.finished, self.open) = (true, false);
                    self.check_end()?;
                }
            }
        }
    }

    fn run(&self, stretch: Stretch, piece: PieceFrame) -> Run {
        let rising = stretch.rises();
        let (sign, direction) = if rising { (1.0, Direction::Forward) } else { (-1.0, Direction::Backward) };
        let frame = self.frame(&piece, sign);
        let (zero, tick_hz) = (frame.zero, frame.tick_hz);
        let reached = (stretch.value_to - zero) * sign;
        let touched = (reached + TOUCH_STEPS).floor();
        // A law that creeps towards a level touches it. If the law goes on beyond the level, the step belongs to the
        // next piece.
        let is_reached_later =
            stretch.onward > (touched - reached).max(0.0) + 8.0 * ULP * (zero.abs() + stretch.value_to.abs());
        let count = if is_reached_later { reached } else { touched };
        let missing = touched - reached;
        let mut run = Run {
            frame,
            direction,
            count: if count >= 1.0 { count as u64 } else { 0 },
            touches: !is_reached_later
                && missing > 0.0
                && missing * tick_hz > TOUCH_TICKS * stretch.curve.jet(stretch.to)[1].abs(),
            reached_by: None,
            origin: piece.zero,
            stretch,
        };
        if is_reached_later {
            self.settle_end(&mut run, touched);
        }
        run
    }

    /// Leaves the last step to the next stretch if this stretch provably ends before it. If this stretch's own numbers
    /// cannot decide that, those of the next one may; otherwise the step's time is enclosed from both sides.
    fn settle_end(&self, run: &mut Run, touched: f64) {
        let (to, hz) = (run.stretch.to, run.frame.tick_hz);
        let (beyond, doubt) = run.beyond(to, touched);
        let is_slow = doubt * hz > TOUCH_TICKS * run.stretch.curve.jet(to)[1].abs();
        if is_slow
            && touched >= 1.0
            && beyond.abs() <= doubt
            && doubt >= EXACT_STEPS
            && let Some((next, piece)) = self.waiting.front()
        {
            let next = Run {
                frame: self.frame(piece, run.frame.sign),
                stretch: next.clone(),
                origin: piece.zero,
                ..run.clone()
            };
            let (beyond, doubt) = next.beyond(next.stretch.from, touched);
            if beyond + doubt < 0.0 {
                run.count = touched as u64 - 1;
            } else {
                let later = (next.origin.0 - run.origin.0) as f64 + (next.origin.1 - run.origin.1);
                run.count = touched as u64;
                run.reached_by = Some(next.proven_after(touched).1 * hz + later);
            }
            return;
        }
        let (beyond, doubt) = run.beyond(to, run.count as f64);
        if run.count > 0 && beyond + doubt < 0.0 {
            run.count -= 1;
        }
    }

    /// The frame of a stretch of a piece, from the motor's position.
    fn frame(&self, piece: &PieceFrame, sign: f64) -> Frame {
        let (start_whole, start_rest, start_low) = self.start.unwrap_or((0, 0.0, 0.0));
        // Uses i128, since both may be far from zero; their difference is small.
        let position = i128::from(self.position) - i128::from(piece.origin) + i128::from(start_whole);
        // Step 1 is due at the level above (or below) the position; s = 0 is one step before it.
        let offset = sign * (self.settings.grid.hysteresis - 0.5);
        let (rest, rest_low) = two_sum(offset, start_rest);
        let (zero, zero_low) = two_sum(position as f64, rest);
        Frame { sign, zero, zero_low: zero_low + rest_low + start_low, tick_hz: self.settings.tick_hz as f64 }
    }

    /// Checks the joint between a piece and the one before it and the limits of the motor, and cuts the piece into
    /// stretches.
    fn admit(&mut self, piece: &Piece) -> Result<(), PlanError> {
        let (from, to) = (piece.first(), piece.last());
        let (first, last) = (piece.curve.jet(from), piece.curve.jet(to));
        let (at_s, end_s) = (piece.start.seconds(), piece.end.seconds());
        if let Some(k) = first.iter().chain(&last).position(|c| !c.is_finite()) {
            let at_s = if k < 8 { at_s } else { end_s };
            return Err(LawError::Undefined { at_s, why: "the law or its slope is not finite".into() }.into());
        }
        if first[0].abs().max(last[0].abs()) > FARTHEST_IN_PIECE {
            return Err(LawError::Parameter(format!("θ leaves ±2^52 steps between t = {at_s} s and {end_s} s")).into());
        }
        let limit = Time::from_raw((LAST_TICK << 64) / i128::from(self.settings.tick_hz.max(1)));
        if piece.end > limit {
            return Err(PlanError::TooLong { at_s: end_s, limit_s: limit.seconds() });
        }
        match self.end {
            None => {
                let (whole, rest, _) = *self.start.get_or_insert_with(|| {
                    let (rest, low) = piece.curve.split_value(from);
                    (piece.origin, rest, low)
                });
                let jump = steps_apart(piece.origin, whole) - self.position as f64 + (first[0] - rest);
                if jump.abs() > FARTHEST_FROM_LAW {
                    let from = self.position as f64 + rest;
                    return Err(LawError::Jump { at_s, from, to: from + jump }.into());
                }
                self.check_speed_jump(at_s, self.arrival, first[1], piece.entry)?;
            }
            Some(end) => {
                let jump = steps_apart(piece.origin, end.origin) + (first[0] - end.value);
                if jump.abs() > 1e-6 {
                    let from = end.origin as f64 + end.value;
                    return Err(LawError::Jump { at_s, from, to: from + jump }.into());
                }
                self.check_speed_jump(at_s, end.speed, first[1], piece.entry)?;
            }
        }
        self.end = Some(End { at_s: end_s, origin: piece.origin, value: last[0], speed: last[1] });
        self.check_peaks(piece, from, to)?;
        let hz = self.settings.tick_hz;
        self.known_before = std::mem::replace(&mut self.known_to, piece.end.ticks(hz).0);
        let frame = PieceFrame { origin: piece.origin, zero: piece.zero.ticks(hz) };
        let stretches = stretches(piece, hz as f64);
        // A piece at rest has no stretch.
        if let (true, Some((before, _)), Some(first)) = (self.open, self.waiting.back_mut(), stretches.first()) {
            before.onward = if first.from == from { before.onward_in(first, to) } else { 0.0 };
        }
        self.open = stretches.last().is_some_and(|last| last.to == to);
        self.waiting.extend(stretches.into_iter().map(|s| (s, frame)));
        Ok(())
    }

    fn check_end(&self) -> Result<(), PlanError> {
        match self.end {
            Some(end) => self.check_speed_jump(end.at_s, end.speed, 0.0, Entry::Continuous),
            None => Ok(()),
        }
    }

    fn check_speed_jump(&self, at_s: f64, from: f64, to: f64, entry: Entry) -> Result<(), PlanError> {
        let pull_in = self.settings.limits.pull_in;
        // A law that is exactly at rest moves by rounding errors, far less than a step.
        let slack = 1e-6 + 1e-9 * from.abs().max(to.abs());
        if entry == Entry::Continuous && (to - from).abs() > pull_in * (1.0 + LIMIT_SLACK) + slack {
            return Err(PlanError::SpeedJump { at_s, from, to, pull_in });
        }
        Ok(())
    }

    fn check_peaks(&mut self, piece: &Piece, from: f64, to: f64) -> Result<(), PlanError> {
        let limits = self.settings.limits;
        let time = |u: f64| piece.zero.seconds() + u;
        let bounds = piece.curve.bounds(from, to);
        let range = (from, to);
        let check = |order, known: (f64, f64), limit: Option<f64>| {
            let search = |known, precision| {
                peak(&piece.curve, &bounds, range, order, known, precision)
                    .map_err(|u| PlanError::TooFine { at_s: time(u) })
            };
            let (mut value, mut at) = search(known.0, PEAK_PRECISION)?;
            if let Some(limit) =
                limit.filter(|l| value * (1.0 + PEAK_PRECISION) > *l && value <= l * (1.0 + LIMIT_SLACK))
            {
                let (finer, there) = search(limit, LIMIT_SLACK)?;
                if finer > limit * (1.0 + LIMIT_SLACK) {
                    (value, at) = (finer, there);
                }
            }
            Ok::<_, PlanError>((value, at.map_or(known.1, time)))
        };
        let speed = check(1, self.certificate.peak_speed, limits.max_speed)?;
        self.certificate.peak_speed = speed;
        if let Some(limit) = limits.max_speed.filter(|l| speed.0 > l * (1.0 + LIMIT_SLACK)) {
            return Err(PlanError::TooFast { at_s: speed.1, speed: speed.0, limit });
        }
        let acceleration = check(2, self.certificate.peak_acceleration, limits.max_acceleration)?;
        // A straight line through rounded rows bends by rounding errors alone, which are no acceleration.
        let theta = [from, to].map(|u| (piece.origin as f64 + piece.curve.value(u)).abs());
        if acceleration.0 * ((to - from) * (to - from)) > BEND_ROUNDINGS * ULP * theta[0].max(theta[1]) {
            self.certificate.peak_acceleration = acceleration;
        }
        if let Some(limit) = limits.max_acceleration.filter(|l| acceleration.0 > l * (1.0 + LIMIT_SLACK)) {
            return Err(PlanError::TooMuchAcceleration { at_s: acceleration.1, acceleration: acceleration.0, limit });
        }
        Ok(())
    }
}

/// `to` − `from`, which may not fit into an i64.
fn steps_apart(to: i64, from: i64) -> f64 {
    (i128::from(to) - i128::from(from)) as f64
}

impl Certificate {
    fn new(class: Class) -> Certificate {
        Certificate {
            bound_ticks: 0.0,
            class,
            steps: 0,
            position: 0,
            segments: 0,
            bytes: 0,
            shortest_interval_ticks: None,
            peak_speed: (0.0, 0.0),
            peak_acceleration: (0.0, 0.0),
            pairs_dropped: 0,
            worst_position_error: 0.0,
            steps_put_off: 0,
            longest_put_off_ticks: 0,
        }
    }

    fn add(&mut self, segment: &Segment, direction: Direction, bound_ticks: f64) {
        self.bound_ticks = self.bound_ticks.max(bound_ticks);
        self.steps += u64::from(segment.count);
        self.position += i64::from(direction.sign()) * i64::from(segment.count);
        self.segments += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The memory of a planner does not grow with the number of steps.
    #[test]
    fn endless_laws_are_planned_in_constant_memory() {
        let seconds = Time::from_seconds;
        let sweep = Law::sweep(0.1, 400_000, seconds(0.1)).unwrap();
        let repeated = Law::trapezoid(50_000.0, 20_000.0, 80_000.0, 40_000.0).unwrap().repeated(None).unwrap();
        let formula = Law::formula("8e4*t + 6e4*sin(0.7*t) + 5e3*sin(3.1*t)", &[], 1.0, None).unwrap();
        for law in [sweep, repeated, formula] {
            let mut settings = Settings::new(125_000_000, 32);
            settings.limits.pull_in = 1e6;
            let mut planner = Planner::new(&law, &settings).unwrap();
            let mut most = (0, 0);
            while planner.certificate.steps < 10_000_000 {
                planner.next_move().unwrap().unwrap();
                most = (most.0.max(planner.waiting.len()), most.1.max(planner.moves.len()));
            }
            // The stretches of one piece; a dwell and a segment.
            assert!(most.0 <= 64 && most.1 <= 2, "{most:?} stretches and moves in memory");
        }
    }
}
