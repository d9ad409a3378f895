//! Pause and resume: the program is changed to its own laws with their time slowed down or sped up.

use crate::pause;
use crate::{Session, SessionError};
use pulsetrain_board::{Leased, SwitchRefused};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Ensemble, Move, Refused, Start};
use std::sync::Arc;

/// The program that is followed, and what its laws' time does.
#[derive(Clone, Debug)]
pub(crate) struct Playback {
    program: Arc<Program>,
    law_time: LawTime,
}

/// What the laws' time does.
#[derive(Clone, Copy, Debug)]
enum LawTime {
    /// It runs. At the session's zero it was `from`; it came up to full speed within `over`.
    Going { from: Time, over: Time },
    /// It halts at `at`, and all motors rest from tick `rests` on.
    Halted { at: Time, rests: u64 },
    /// The motors were stopped, and left their laws.
    Stopped,
}

impl Playback {
    pub(crate) fn begun(program: Arc<Program>) -> Playback {
        Playback { program, law_time: LawTime::Going { from: Time::ZERO, over: Time::ZERO } }
    }

    pub(crate) const fn is_paused(&self) -> bool {
        matches!(self.law_time, LawTime::Halted { .. })
    }

    pub(crate) fn stopped(&mut self) {
        self.law_time = LawTime::Stopped;
    }
}

/// Fractions of the motors' limits that a pause or resumption may use, tried in this order: if the planner refuses one, the next is gentler.
const CAUTION: [f64; 3] = [1.0, 0.8, 0.5];

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
    /// # let board = Native::new(&Config { fraction_bits: program.board.fraction_bits, motors }).unwrap();
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
        let hz = self.pace.tick_hz;
        let (from, eased) = match self.playback.law_time {
            LawTime::Going { from, over } => (from, over),
            LawTime::Halted { rests, .. } => return Ok(rests),
            LawTime::Stopped => return Err(SessionError::Late { at: self.earliest(), latest: self.committed_until() }),
        };
        let at_speed = self.stream.zero() + ticks(eased, hz);
        let program = Arc::clone(&self.playback.program);
        self.attempt(|session, caution, delay| {
            let at = (session.earliest() + delay).max(at_speed);
            // After its last step a motion is over, even if its laws still move by less than a step.
            if let Some(latest) = session.last_step().filter(|last| session.is_complete() && at > *last) {
                return Err(SessionError::Late { at, latest });
            }
            // The motion has its full speed only after what was sent: the state there is not known yet.
            if at == at_speed && at > session.committed_until() {
                return Err(SessionError::Waiting {
                    at,
                    until: session.board.now() + (at - session.committed_until()),
                });
            }
            // Ticks of a session stay far below 2^62.
            let since = Time::from_ratio(at.wrapping_sub(session.stream.zero()).cast_signed(), hz);
            let time = from + since - eased.divided_by(2);
            let easing = pause::quickest_halt(&program, time, caution)?;
            let takes = ticks(easing.after + easing.over, hz);
            session.change_proven(at, Arc::new(pause::halting(&program, time, easing)?), takes)?;
            let rests = at + takes;
            let at = time + easing.after + easing.over.divided_by(2);
            session.playback = Playback { program: Arc::clone(&program), law_time: LawTime::Halted { at, rests } };
            Ok(rests)
        })
    }

    /// Goes on after a pause, from where the laws' time halted. Returns the tick from which that time has its full speed.
    ///
    /// # Errors
    /// [`SessionError::NotPaused`]; [`SessionError::Early`] while the motors still move; [`SessionError::Pause`] where the laws themselves take
    /// all that the motors can do; else as [`Session::change`]. The motors stay at rest after an error.
    pub fn resume(&mut self) -> Result<u64, SessionError> {
        let hz = self.pace.tick_hz;
        let LawTime::Halted { at: from, rests } = self.playback.law_time else { return Err(SessionError::NotPaused) };
        if !self.is_complete() || self.earliest() < rests {
            return Err(SessionError::Early { at: self.earliest(), earliest: rests });
        }
        let program = Arc::clone(&self.playback.program);
        self.attempt(|session, caution, delay| {
            let at = session.earliest() + delay;
            let over = pause::quickest_start(&program, from, caution)?;
            let takes = ticks(over, hz);
            session.change_proven(at, Arc::new(pause::starting(&program, from, over)?), takes)?;
            session.playback = Playback { program: Arc::clone(&program), law_time: LawTime::Going { from, over } };
            Ok(at + takes)
        })
    }

    /// Tries a change again if it was refused: more gently if the planner refused it, later if it came too late.
    fn attempt(
        &mut self,
        mut change: impl FnMut(&mut Session<B>, f64, u64) -> Result<u64, SessionError>,
    ) -> Result<u64, SessionError> {
        let (mut cautions, mut delay) = (CAUTION.into_iter().peekable(), 0);
        loop {
            let caution = cautions.peek().copied().unwrap_or(1.0);
            match change(self, caution, delay) {
                Err(SessionError::Plan(_)) if cautions.len() > 1 => drop(cautions.next()),
                // Planning took too long: a real board's time went on meanwhile.
                Err(SessionError::Early { .. } | SessionError::Switch(SwitchRefused::Late { .. }))
                    if delay < self.pace.most_delay =>
                {
                    delay += self.pace.most_delay / 3;
                }
                done => return done,
            }
        }
    }
}

/// A time in ticks, rounded down, plus one.
fn ticks(time: Time, hz: u64) -> u64 {
    // Not negative, and an hour at most.
    time.ticks(hz).0.unsigned_abs() + 1
}

/// Plans the first `ticks` of a program.
///
/// # Errors
/// If that part is refused.
pub(crate) fn prove(program: &Program, starts: &[Start], ticks: u64) -> Result<(), Refused> {
    if ticks == 0 {
        return Ok(());
    }
    let fraction_bits = program.board.fraction_bits;
    let mut ensemble = Ensemble::from(program, starts)?;
    for motor in 0..program.motors.len() {
        let mut at = 0_i128;
        while at >> fraction_bits <= i128::from(ticks) {
            match ensemble.next_move(motor)? {
                Some(Move::Dwell { ticks }) => at += i128::from(ticks) << fraction_bits,
                Some(Move::Run { segment, .. }) => at += segment.span(segment.count),
                None => break,
            }
        }
    }
    Ok(())
}
