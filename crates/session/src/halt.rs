//! Pause and resume: changes to the same laws in another time.

use crate::pause;
use crate::{Session, SessionError};
use pulsetrain_board::{Leased, SwitchRefused};
use pulsetrain_motion::Time;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Ensemble, Move, Refused, Start};
use std::sync::Arc;

/// A program, and how its laws' time goes.
#[derive(Clone, Debug)]
pub(crate) struct Playback {
    program: Arc<Program>,
    law_time: LawTime,
}

#[derive(Clone, Copy, Debug)]
enum LawTime {
    /// It began at `from` of the laws, at the session's zero, and came up to speed over a while.
    Going { from: Time, over: Time },
    /// It is at, or comes to, a halt at `at` of the laws; the motors rest from tick `rests` on.
    Halted { at: Time, rests: u64 },
    /// The motors were stopped elsewhere.
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

/// Parts of the motors' limits that are asked for, one after the other, if the planner refuses what was found.
const CAUTION: [f64; 3] = [1.0, 0.8, 0.5];

impl<B: Leased> Session<B> {
    /// Slows the laws' time to a halt, within the limits and as soon as they allow, all motors together: they stay on their
    /// paths. Gives the tick from which on all of them rest; [`Session::resume`] goes on from there.
    ///
    /// During an easing into motion it is first let come to its end. A motion that is paused already stays so.
    ///
    /// # Errors
    /// [`SessionError::Late`] when the motion ends before; [`SessionError::Waiting`] while another change waits, or the laws come up to speed
    /// after a pause for longer than the board was told of: ask again when it says; [`SessionError::Pause`] where the laws themselves take all
    /// that the motors can do; or as [`Session::change`]. The motion goes on then.
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
            LawTime::Stopped => return Err(SessionError::Late { at: self.earliest(), latest: self.told() }),
        };
        let at_speed = self.stream.zero() + ticks(eased, hz);
        let program = Arc::clone(&self.playback.program);
        self.attempt(|session, caution, spare| {
            let at = (session.earliest() + spare).max(at_speed);
            // Past its last step a motion is over, even where its laws still come to rest.
            if let Some(latest) = session.last_step().filter(|last| session.is_complete() && at > *last) {
                return Err(SessionError::Late { at, latest });
            }
            // It comes up to speed for longer than the board was told of.
            if at == at_speed && at > session.told() {
                return Err(SessionError::Waiting { at, until: session.board.now() + (at - session.told()) });
            }
            // Ticks of a session stay far below 2^62.
            let since = Time::from_ratio(at.wrapping_sub(session.stream.zero()).cast_signed(), hz);
            let time = from + since - eased.divided_by(2);
            let easing = pause::quickest_halt(&program, time, caution)?;
            let takes = ticks(easing.after + easing.over, hz);
            session.go_over(at, Arc::new(pause::halting(&program, time, easing)?), takes)?;
            let rests = at + takes;
            let at = time + easing.after + easing.over.divided_by(2);
            session.playback = Playback { program: Arc::clone(&program), law_time: LawTime::Halted { at, rests } };
            Ok(rests)
        })
    }

    /// Goes on after a pause, from where it left the laws; gives the tick from which on their time runs as ever.
    ///
    /// # Errors
    /// [`SessionError::NotPaused`]; [`SessionError::Early`] while the motors do not rest yet; [`SessionError::Pause`] where
    /// the laws themselves take all that the motors can do; or as [`Session::change`]. The motors stay at rest then.
    pub fn resume(&mut self) -> Result<u64, SessionError> {
        let hz = self.pace.tick_hz;
        let LawTime::Halted { at: from, rests } = self.playback.law_time else { return Err(SessionError::NotPaused) };
        if !self.is_complete() || self.earliest() < rests {
            return Err(SessionError::Early { at: self.earliest(), earliest: rests });
        }
        let program = Arc::clone(&self.playback.program);
        self.attempt(|session, caution, spare| {
            let at = session.earliest() + spare;
            let over = pause::quickest_start(&program, from, caution)?;
            let takes = ticks(over, hz);
            session.go_over(at, Arc::new(pause::starting(&program, from, over)?), takes)?;
            session.playback = Playback { program: Arc::clone(&program), law_time: LawTime::Going { from, over } };
            Ok(at + takes)
        })
    }

    /// Tries again what was refused by the planner, with more caution, or came too late, with more time to spare.
    fn attempt(
        &mut self,
        mut change: impl FnMut(&mut Session<B>, f64, u64) -> Result<u64, SessionError>,
    ) -> Result<u64, SessionError> {
        let (mut cautions, mut spare) = (CAUTION.into_iter().peekable(), 0);
        loop {
            let caution = cautions.peek().copied().unwrap_or(1.0);
            match change(self, caution, spare) {
                Err(SessionError::Plan(_)) if cautions.len() > 1 => drop(cautions.next()),
                // Planning takes its time, while that of a real board goes on.
                Err(SessionError::Early { .. } | SessionError::Switch(SwitchRefused::Late { .. }))
                    if spare < self.pace.spare =>
                {
                    spare += self.pace.spare / 3;
                }
                done => return done,
            }
        }
    }
}

/// Ticks within a time, or one more.
fn ticks(time: Time, hz: u64) -> u64 {
    // Not negative, and an hour at most.
    time.ticks(hz).0.unsigned_abs() + 1
}

/// Plans the first `ticks` of a program, to see whether it is refused.
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
