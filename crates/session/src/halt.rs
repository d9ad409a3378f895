//! Pause, resume and tempo: the program is changed to its own laws with another rate of their time.

use crate::fade::{Mix, Shift};
use crate::pause::{self, Ceiling, ticks};
use crate::plans::{Plans, TRIED_MOVES};
use crate::{Session, SessionError};
use pulsetrain_board::lease::{Lease, TrimRefused};
use pulsetrain_board::{Board, Leased, SwitchRefused};
use pulsetrain_core::{Item, Tick32};
use pulsetrain_motion::Time;
use pulsetrain_motion::law::Ease;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::time::Rate;
use pulsetrain_plan::line::LONGEST_DWELL_TICKS;
use pulsetrain_plan::{Ensemble, Move, Refused, Start};
use std::sync::Arc;

/// The program that is followed, and what its laws' time does.
#[derive(Clone, Debug)]
pub(crate) struct Playback {
    /// Its laws are right from the last change on.
    program: Arc<Program>,
    mix: Mix,
    law_time: LawTime,
    /// The rate of the laws' time when it does not halt.
    tempo: Rate,
    /// The highest rate at which these laws were planned or followed.
    known_rate: Rate,
}

/// What the laws' time does.
#[derive(Clone, Copy, Debug)]
enum LawTime {
    /// It runs at the tempo from the stream's time `since` on, when it is `at`.
    Going { since: Time, at: Time },
    /// It halts at `at`, and all motors rest from tick `rests` on.
    Halted { at: Time, rests: u64 },
    /// The motors were stopped, and left their laws. The laws' time goes on, as it did.
    Stopped { since: Time, at: Time },
}

/// A change of tempo that was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tempo {
    /// The rate of the laws' time from then on, or from the next resumption on.
    pub rate: Rate,
    /// The tick from which the laws' time has that rate.
    pub from: u64,
    /// The limit that keeps the rate below the wanted one.
    pub ceiling: Option<Ceiling>,
}

impl Playback {
    pub(crate) fn begun(program: Arc<Program>) -> Playback {
        let (mix, law_time) = (Mix::of(&program), LawTime::Going { since: Time::ZERO, at: Time::ZERO });
        Playback { program, mix, law_time, tempo: Rate::ONE, known_rate: Rate::ONE }
    }

    pub(crate) const fn is_paused(&self) -> bool {
        matches!(self.law_time, LawTime::Halted { .. })
    }

    pub(crate) const fn is_stopped(&self) -> bool {
        matches!(self.law_time, LawTime::Stopped { .. })
    }

    pub(crate) fn stopped(&mut self) {
        self.law_time = match self.law_time {
            LawTime::Going { since, at } | LawTime::Stopped { since, at } => LawTime::Stopped { since, at },
            LawTime::Halted { at, .. } => LawTime::Stopped { since: Time::MAX, at },
        };
    }

    pub(crate) const fn program(&self) -> &Arc<Program> {
        &self.program
    }

    pub(crate) const fn tempo(&self) -> Rate {
        self.tempo
    }

    pub(crate) const fn mix(&self) -> &Mix {
        &self.mix
    }

    /// The program with the laws that the motors follow after the changes that are under way.
    pub(crate) fn followed(&self) -> Program {
        let mut program = Program::clone(&self.program);
        for (motor, law) in program.motors.iter_mut().zip(self.mix.followed()) {
            motor.law = law.clone();
        }
        program
    }

    /// Notes that the motors follow other laws, from the laws' time `at` on.
    pub(crate) fn changed(&mut self, program: Arc<Program>, mix: Mix, at: Time) {
        (self.program, self.mix, self.known_rate) = (program, mix, self.tempo);
        if !self.is_paused() {
            self.law_time = LawTime::Going { since: Time::ZERO, at };
        }
    }

    /// Notes that the laws' time, which is `at` now, eases to another tempo.
    pub(crate) fn eases(&mut self, at: Time, ease: Ease) {
        (self.tempo, self.known_rate) = (ease.to, self.known_rate.max(ease.to));
        if !self.is_paused() {
            self.law_time = LawTime::Going { since: ease.end(), at: at + ease.of_law() };
        }
    }

    /// Forgets fades that are over at `now`.
    fn settle(&mut self, now: Time) -> Result<(), pause::PauseError> {
        if self.mix.settle(now) {
            self.program = Arc::new(self.mix.program(&self.program)?);
        }
        Ok(())
    }
}

/// Fractions of the motors' limits that a pause or resumption may use, tried in this order: if the planner refuses one, the next is gentler.
const CAUTION: [f64; 3] = [1.0, 0.8, 0.5];

/// Milliseconds of the plan that stay in the queues when they are emptied for a change, besides the time that the line needs: the change must be
/// accepted before they are over.
const STAYING_MS: u64 = 4;

/// Moves of a change that are planned before it is made, besides its beginning, of all motors: some 10 ms of work.
const PROVEN_MOVES: usize = 4000;

/// Milliseconds for which half of each queue is kept free for a change that did not fit in it.
pub(crate) const RESERVED_MS: u64 = 300;

/// A wait after a wait counts as so many moves: the planner has looked through thousands of pieces without a step, which takes milliseconds.
const IDLE_MOVES: u32 = 2000;

/// How many rates between one that is kept up with and one that is not are tried.
const TRIES: u32 = 3;

impl<B: Leased> Session<B> {
    /// Slows the laws' time to a halt as fast as the limits allow. All motors share that time, so that they stay on their paths. Returns the tick
    /// from which all of them rest; [`Session::resume`] goes on from there.
    ///
    /// While the motion still speeds up after a pause, the halt begins when it has its full speed. A motion that is paused stays paused.
    ///
    /// # Errors
    /// [`SessionError::Late`] when the motion ends before the halt could begin. [`SessionError::Waiting`] while another change waits, or while the
    /// motion speeds up after a pause beyond what was sent: try again at the tick in the error. [`SessionError::Pause`] where the laws themselves
    /// take all that the motors can do. Else as [`Session::change`]. The motion goes on after an error.
    ///
    /// ```
    /// # use pulsetrain_session::Session;
    /// # use pulsetrain_board::{Config, Edge, MotorConfig, Native, Wiring};
    /// # let text = pulsetrain_motion::template::motion_file("example");
    /// # let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    /// # let program = pulsetrain_motion::file::read(&text, "example.toml", &no_files).unwrap();
    /// # let wiring = Wiring::StepDir { step: 0, dir: 1, forward_high: true, pulse_ticks: 16, setup_ticks: 16 };
    /// # let motors = vec![MotorConfig { wiring, pull_in_ticks: 1 }];
    /// # let board = Native::new(&Config { fraction_bits: program.board.registers.fraction_bits, motors }).unwrap();
    /// # let mut nobody = |_: Edge| {};
    /// let mut session = Session::new(board, program)?;
    /// session.advance(session.zero() + 1_000_000, &mut nobody)?;
    /// let rests = session.pause()?;
    /// session.advance(rests + 5_000_000, &mut nobody)?;
    /// session.resume()?;
    /// assert_eq!(session.run(&mut nobody, |_| {}).failure, None);
    /// # Ok::<(), pulsetrain_session::SessionError>(())
    /// ```
    pub fn pause(&mut self) -> Result<u64, SessionError> {
        match self.playback.law_time {
            LawTime::Halted { rests, .. } => Ok(rests),
            _ => self.retime(Rate::ZERO),
        }
    }

    /// Goes on after a pause, from where the laws' time halted. Returns the tick from which that time has its full rate.
    ///
    /// # Errors
    /// [`SessionError::NotPaused`]; [`SessionError::Early`] while the motors still move; [`SessionError::Pause`] where the laws themselves take
    /// all that the motors can do; else as [`Session::change`]. The motors stay at rest after an error.
    pub fn resume(&mut self) -> Result<u64, SessionError> {
        let LawTime::Halted { rests, .. } = self.playback.law_time else { return Err(SessionError::NotPaused) };
        if !self.is_complete() || self.earliest() < rests {
            return Err(SessionError::Early { at: self.earliest(), earliest: rests });
        }
        self.retime(self.playback.tempo)
    }

    /// Lets the laws' time run at another rate, as soon as the limits allow. All motors keep their paths and phases. If a motor, a tip or the board cannot
    /// follow, the rate is the highest that they can. A motion that is paused goes on at that rate.
    ///
    /// # Errors
    /// As [`Session::pause`]. [`SessionError::NoTempo`] if the rate is 0. The motion goes on as it was after an error.
    pub fn set_tempo(&mut self, wanted: Rate) -> Result<Tempo, SessionError> {
        if wanted == Rate::ZERO {
            return Err(SessionError::NoTempo);
        }
        if self.playback.is_stopped() {
            return Err(SessionError::Late { at: self.earliest(), latest: self.committed_until() });
        }
        let from = self.law_time();
        self.playback.settle(from)?;
        let (highest, ceiling) = pause::highest_rate(&self.playback.program, from, self.playback.known_rate)?;
        let is_unknown = || wanted > self.playback.known_rate && pause::has_unknown_tip(&self.playback.program);
        if (wanted > highest || is_unknown())
            && let Some(until) = self.playback.mix.changes_until(from)
        {
            // A change that is under way may be what takes so much.
            let at = self.board.now();
            return Err(SessionError::Waiting {
                at,
                until: at + ticks(self.playback.tempo.to_pass(until - from), self.pace.tick_hz),
            });
        }
        let (rate, ceiling) = if wanted > highest { (highest, ceiling) } else { (wanted, None) };
        let (program, known) = (&self.playback.program, self.playback.known_rate);
        let (rate, ceiling) = self.kept_up(program, known, rate).unwrap_or((rate, ceiling));
        let from = match self.playback.law_time {
            LawTime::Halted { .. } => self.board.now(),
            _ if rate == self.playback.tempo => self.board.now(),
            _ => self.retime(rate)?,
        };
        (self.playback.tempo, self.playback.known_rate) = (rate, self.playback.known_rate.max(rate));
        Ok(Tempo { rate, from, ceiling })
    }

    /// How far the laws' time is by now, at most.
    pub(crate) fn law_time(&self) -> Time {
        self.law_time_at(self.board.now())
    }

    /// Whether all motors have come to the ends of the laws that they follow. Never while the motion is paused, or was stopped.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(self.playback.law_time, LawTime::Going { .. })
            && self.playback.mix.ends_at().is_some_and(|end| end <= self.law_time())
    }

    /// Whether a change of the laws is under way.
    #[must_use]
    pub fn is_changing(&self) -> bool {
        self.playback.mix.changes_until(self.law_time()).is_some()
    }

    /// What changes of an endless constant speed have added to each motor's way; `None` if the motors were sent to a position.
    #[must_use]
    pub fn shifts(&self) -> Option<Vec<Shift>> {
        self.playback.mix.shifts()
    }

    /// Whether the motors were stopped, and have left their laws.
    #[must_use]
    pub(crate) const fn is_stopped(&self) -> bool {
        self.playback.is_stopped()
    }

    /// Sets the laws' time while all motors rest, and stay at rest until they change to other laws: the next change joins those at the new time. An endless
    /// constant speed goes on from the way of the law in `shifts` until then, which an earlier session had by [`Session::shifts`]. A motor that is not in
    /// `shifts` joins the law's own way; without any it begins where the motor rests.
    ///
    /// # Errors
    /// [`SessionError::Waiting`] while a motor moves: try again at the tick in the error. [`SessionError::Late`] after a stop, and while the motion is paused.
    pub fn set_law_time(&mut self, time: Time, shifts: Option<&[Shift]>) -> Result<(), SessionError> {
        let now = self.board.now();
        let LawTime::Going { .. } = self.playback.law_time else {
            return Err(SessionError::Late { at: now, latest: self.committed_until() });
        };
        let waiting = SessionError::Waiting { at: now, until: now + self.pace.tick_hz / 50 };
        // Nothing that was sent makes a step, and no law moves.
        let has_steps = self.timelines.iter().any(|timeline| timeline.first_from(now).is_some());
        if has_steps || self.replaced.is_some() || self.playback.mix.changes_until(self.law_time()).is_some() {
            return Err(waiting);
        }
        for motor in 0..self.timelines.len() {
            if self.state(motor, now)?.speed != 0.0 {
                return Err(waiting);
            }
        }
        let motors = 0..self.timelines.len();
        let positions: Result<Vec<f64>, _> = motors.map(|motor| self.state(motor, now).map(|at| at.theta)).collect();
        let mix = Mix::joining(&positions?, shifts)?;
        let program = Arc::new(mix.program(&self.playback.program)?);
        self.playback.changed(program, mix, time);
        // Ticks of a session stay far below 2^62.
        let since = Time::from_ratio(now.saturating_sub(self.stream.zero()).cast_signed(), self.pace.tick_hz);
        self.playback.law_time = LawTime::Going { since, at: time };
        Ok(())
    }

    /// The laws' time at a tick.
    pub(crate) fn law_time_at(&self, tick: u64) -> Time {
        match self.playback.law_time {
            LawTime::Going { since, at } | LawTime::Stopped { since, at } => {
                // Ticks of a session stay far below 2^62.
                let now = Time::from_ratio(tick.saturating_sub(self.stream.zero()).cast_signed(), self.pace.tick_hz);
                at + self.playback.tempo.of_law((now - since).max(Time::ZERO))
            }
            LawTime::Halted { at, .. } => at,
        }
    }

    /// Changes of laws and tempo, pauses and resumptions begin at this tick; those that come too late for it begin as soon as they can. `None`: all
    /// begin as soon as they can. A tick that the board does not have in its plan yet is [`SessionError::Waiting`].
    pub fn hold_changes_until(&mut self, tick: Option<u64>) {
        self.not_before = tick;
    }

    /// The tick at which a change can be made, `delay` ticks later than at once, and the laws' time there.
    pub(crate) fn moment(&self, delay: u64) -> Result<(u64, Time), SessionError> {
        let earliest = (self.earliest() + delay).max(self.not_before.unwrap_or(0));
        let is_going = matches!(self.playback.law_time, LawTime::Going { .. });
        if is_going && self.not_before == Some(earliest) && earliest > self.committed_until() {
            let until = self.board.now() + (earliest - self.committed_until());
            return Err(SessionError::Waiting { at: earliest, until });
        }
        let at = match self.playback.law_time {
            LawTime::Going { since, .. } => {
                let at_speed = self.stream.zero() + ticks(since, self.pace.tick_hz);
                // The motion has its full rate only after what was sent: the state there is not known yet.
                if at_speed >= earliest && at_speed > self.committed_until() {
                    let until = self.board.now() + (at_speed - self.committed_until());
                    return Err(SessionError::Waiting { at: at_speed, until });
                }
                earliest.max(at_speed)
            }
            LawTime::Halted { .. } => earliest,
            // Motors that brake have to rest first.
            LawTime::Stopped { .. } => earliest.max(self.last_step().map_or(0, |last| last + 1)),
        };
        Ok((at, self.law_time_at(at)))
    }

    /// The highest rate up to `wanted` at which queues and line bring the plan of a program in time, with the limit that keeps it lower; `None` if
    /// `wanted` does. The motion is planned for that from now on. At the rate `known` it was planned before, or is followed already.
    fn kept_up(&self, program: &Arc<Program>, known: Rate, wanted: Rate) -> Option<(Rate, Option<Ceiling>)> {
        let refused = |rate: Rate, moves: u32| self.plan_refused(program, self.law_time(), rate, moves);
        let known = known.min(wanted);
        let (ceiling, mut enough) = if wanted > known { refused(wanted, TRIED_MOVES)? } else { return None };
        let (mut fits, mut too_high) = (known, wanted);
        let mut left = TRIED_MOVES - enough;
        for tries in (1..=TRIES).rev() {
            let middle = Rate::of(0.5 * (fits.get() + too_high.get()))?;
            let share = left / tries;
            // A lower rate is refused later in the motion, if at all: it is not known to fit before the moves that showed that the other does not.
            if share <= enough {
                break;
            }
            match refused(middle, share) {
                None => (fits, left) = (middle, left - share),
                Some((_, made)) => {
                    (too_high, left) = (middle, left - made);
                    enough = enough.max(made);
                }
            }
        }
        Some((fits, Some(ceiling)))
    }

    /// The limit that the plan of a program would break, at a rate of its laws' time, and after how many moves that was seen; `None` if it breaks none.
    /// The first `moves` moves from the time `from` of the laws on are planned for that. Without a line to the board it returns `None`.
    pub(crate) fn plan_refused(
        &self,
        program: &Arc<Program>,
        from: Time,
        rate: Rate,
        moves: u32,
    ) -> Option<(Ceiling, u32)> {
        let line = self.line.as_ref()?;
        let ceiling = |Refused { motor, error }: Refused| Ceiling::of_motor(motor, pause::limit_of(&error));
        let program = match pause::underway(program, from) {
            Ok(program) => Arc::new(program),
            Err((motor, _)) => return Some((Ceiling::of_motor(motor, pause::NO_LAW), 0)),
        };
        let mut plans = match Plans::slowed(program, Some(line), 1.0 / rate.get()) {
            Ok(plans) => plans,
            Err(refused) => return Some((ceiling(refused), 0)),
        };
        let mut made = 0;
        let mut waits = vec![false; self.timelines.len()];
        while made < moves {
            made += 1;
            match plans.next_move() {
                Ok(Some((motor, _, next))) => {
                    let is_wait = matches!(next, Move::Dwell { .. });
                    if std::mem::replace(&mut waits[motor], is_wait) && is_wait {
                        made += IDLE_MOVES;
                    }
                }
                Ok(None) => return None,
                Err(refused) => return Some((ceiling(refused), made)),
            }
        }
        None
    }

    /// The highest tempo up to `wanted` at which motors and line follow the laws of a program, and the limit of a higher one. They follow the present tempo.
    pub(crate) fn tempo_of(
        &self,
        program: &Arc<Program>,
        wanted: Rate,
    ) -> Result<(Rate, Option<Ceiling>), SessionError> {
        let tempo = self.playback.tempo;
        let (highest, ceiling) = pause::highest_rate(program, self.law_time(), tempo)?;
        let (rate, ceiling) = if wanted > highest { (highest, ceiling) } else { (wanted, None) };
        Ok(self.kept_up(program, tempo, rate).unwrap_or((rate, ceiling)))
    }

    /// Changes the rate of the laws' time. Returns the tick from which it has that rate.
    fn retime(&mut self, to: Rate) -> Result<u64, SessionError> {
        let hz = self.pace.tick_hz;
        let before = if self.is_paused() { Rate::ZERO } else { self.playback.tempo };
        if self.playback.is_stopped() {
            return Err(SessionError::Late { at: self.earliest(), latest: self.committed_until() });
        }
        self.attempt(|session, caution, delay| {
            let (at, time) = session.moment(delay)?;
            // After its last step a motion is over, even if its laws still move by less than a step.
            if let Some(latest) =
                session.last_step().filter(|last| !session.is_paused() && session.is_complete() && at > *last)
            {
                return Err(SessionError::Late { at, latest });
            }
            session.playback.settle(time)?;
            let program = Arc::clone(&session.playback.program);
            let ease = pause::quickest(&program, time, (before, to), caution, session.playback.known_rate)?;
            let takes = ticks(ease.end(), hz);
            session.change_proven(at, Arc::new(pause::retimed(&program, time, ease)?), takes)?;
            let (eased, law_at) = (ease.end(), time + ease.of_law());
            session.playback.law_time = match to {
                Rate::ZERO => LawTime::Halted { at: law_at, rests: at + takes },
                _ => LawTime::Going { since: eased, at: law_at },
            };
            Ok(at + takes)
        })
    }

    /// Tries a change again if it was refused: more gently if the planner refused it, later if it came too late, and after taking back what the
    /// queues hold if there was no room for its beginning.
    pub(crate) fn attempt<T>(
        &mut self,
        mut change: impl FnMut(&mut Session<B>, f64, u64) -> Result<T, SessionError>,
    ) -> Result<T, SessionError> {
        let (mut cautions, mut delay) = (CAUTION.into_iter().peekable(), 0);
        // What stays in the queues should last although a frame is lost. Short queues have no room for that.
        let mut staying = [self.pace.repetition, 0].into_iter();
        let mut has_room = false;
        self.effort.is_short = false;
        let done = loop {
            let caution = cautions.peek().copied().unwrap_or(1.0);
            self.board.await_extensions();
            self.effort.asked_at = self.board.now();
            match change(self, caution, delay) {
                Err(SessionError::Plan(_)) if cautions.len() > 1 => drop(cautions.next()),
                Err(error @ SessionError::QueueTooShort { .. }) => {
                    let mut is_made = false;
                    while !is_made && let Some(least) = staying.next() {
                        (is_made, self.effort.is_short) = (self.make_room(least)?, least == 0);
                    }
                    // Even what must be there may find room where all that should be does not.
                    if !is_made && std::mem::replace(&mut self.effort.is_short, true) {
                        break Err(self.reserve_room(error)?);
                    }
                    has_room |= is_made;
                }
                // Planning took longer than before, or there is more to send.
                Err(SessionError::Early { at, earliest }) if delay < self.pace.most_delay => {
                    delay += (earliest - at.min(earliest)).max(self.pace.most_delay / 80);
                }
                // It came later than was reckoned.
                Err(SessionError::Switch(SwitchRefused::Late { .. })) if !has_room && delay < self.pace.most_delay => {
                    delay += self.pace.most_delay / 40;
                }
                // What was taken back has to be sent again before the lease is over.
                Err(error @ (SessionError::Early { .. } | SessionError::Switch(SwitchRefused::Late { .. })))
                    if has_room =>
                {
                    break Err(self.reserve_room(error)?);
                }
                // The plan that the board has ends before a change can begin: more of it has to come first.
                Err(error @ SessionError::Late { .. }) if !self.is_complete() && !self.playback.is_stopped() => {
                    break Err(self.reserve_room(error)?);
                }
                done => {
                    if done.is_ok() {
                        self.room_reserved_at = None;
                    }
                    break done;
                }
            }
        };
        self.effort.is_short = false;
        done
    }

    /// Has the queues filled by half for a while, so that the change can be tried again. After [`RESERVED_MS`] it was in vain.
    fn reserve_room(&mut self, error: SessionError) -> Result<SessionError, SessionError> {
        // What was taken back has to be there again before the lease is over.
        self.fill()?;
        let now = self.board.now();
        let since = *self.room_reserved_at.get_or_insert(now);
        let at = self.earliest();
        if now > since + self.pace.tick_hz / 1000 * RESERVED_MS {
            self.room_reserved_at = None;
            return Ok(error);
        }
        Ok(SessionError::Waiting { at, until: now + self.pace.tick_hz / 200 })
    }
}

impl<B: Leased> Session<B> {
    /// Takes back what the queues hold of the plan beyond a change that is made at once, [`STAYING_MS`] and `staying` ticks more, so that they have room
    /// for another plan's beginning. The next [`fill`](Session::fill) sends it again. Returns false if nothing could be taken back.
    fn make_room(&mut self, staying: u64) -> Result<bool, SessionError> {
        self.board.await_extensions();
        self.check_board()?;
        // The board's answer to this comes before the change.
        let cut = self.earliest() + self.board.delivery(0) + self.pace.tick_hz * STAYING_MS / 1000 + staying;
        let is_answered = self.pending_extensions.is_empty() && self.replaced.is_none();
        if !is_answered || cut >= self.committed_until() || cut <= self.brakeable_from.max(self.stream.zero()) {
            return Ok(false);
        }
        let mut items: Vec<usize> = self.timelines.iter().map(|timeline| timeline.items_from(cut)).collect();
        loop {
            if items.iter().all(|items| *items == 0) {
                return Ok(false);
            }
            match self.board.trim(cut, &items) {
                Ok(()) => break,
                // It reads ahead while a motor waits.
                Err(TrimRefused::Read { motor }) if items[motor] > 0 => items[motor] = 0,
                Err(_) => {
                    self.check_board()?;
                    return Ok(false);
                }
            }
        }
        self.confirmed_lease = Lease::Until(cut);
        for (motor, items) in items.into_iter().enumerate() {
            let timeline = &mut self.timelines[motor];
            let taken = timeline.take_back(items);
            self.stream.take_back(&self.board, motor, &taken, timeline.ends_with_steps());
        }
        Ok(true)
    }
}

/// Plans the first `proven` ticks of a program, or [`PROVEN_MOVES`] moves. Returns the room that each motor's first `begin` ticks take in its queue.
///
/// # Errors
/// If that part is refused.
pub(crate) fn prove<B: Board>(
    program: &Program,
    starts: &[Start],
    proven: u64,
    begin: u64,
    board: &B,
) -> Result<Vec<usize>, SessionError> {
    let fraction_bits = program.board.registers.fraction_bits;
    let mut ensemble = Ensemble::from(program, starts)?;
    let motors = program.motors.len();
    let mut sizes = Vec::with_capacity(motors);
    for motor in 0..motors {
        let (mut at, mut moves) = (0_i128, 0);
        let mut sizer = board.sizer(motor);
        let mut size = sizer.size(&Item::Anchor { tick: Tick32(0) });
        let is_within = |at: i128, ticks: u64| at >> fraction_bits <= i128::from(ticks);
        while is_within(at, begin) || (is_within(at, proven) && moves < PROVEN_MOVES / motors) {
            let Some(next) = ensemble.next_move(motor)? else { break };
            let (item, takes) = match next {
                Move::Dwell { ticks } => {
                    let ticks = ticks.min(LONGEST_DWELL_TICKS);
                    (Item::Dwell { ticks: ticks as u32 }, i128::from(ticks) << fraction_bits)
                }
                Move::Run { segment, direction } => (Item::Run { segment, direction }, segment.span(segment.count)),
            };
            if is_within(at, begin) {
                size += sizer.size(&item);
            }
            (at, moves) = (at + takes, moves + 1);
        }
        sizes.push(size);
    }
    Ok(sizes)
}
