//! StepperWinch's path: a second-order filter that follows timed commands, stepped at exactly 1 kHz.
//!
//! Source: StepperWinch, `Path::pollForInterval`: acceleration from the old state, clamped; position with the old speed;
//! speed; the target drifts; the speed is clamped. The sketch's loop has no fixed rate; this one has 1 ms.
//!
//! The recurrence has a value each millisecond. If its speed were held in between, it would jump. Here it changes linearly from the
//! middle of one millisecond to the middle of the next. So θ is made of parabolas with a continuous speed. Speeds and accelerations
//! are those of the recurrence, within its limits. θ passes within a_max·(1 ms)²/8 of each position of the recurrence (0.0044 step at
//! 35 000 steps/s²).
//!
//! A board works out the path in fixed point, in `pulsetrain_core::winch`; a test compares the two. There, a vmax below the present
//! speed is approached within amax. Here, as in the sketch, it takes effect at once.

use super::{Curve, Double, Entry, FARTHEST, Law, LawError, Piece, checked};
use crate::Time;
use pulsetrain_core::winch::path::{FIRST_ACCELERATION, FIRST_SPEED};
use std::sync::Arc;

/// Gains and limits at the start. The default is the sketch's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WinchSettings {
    /// k, 1/s².
    pub stiffness: f64,
    /// b, 1/s.
    pub damping: f64,
    /// steps/s.
    pub max_speed: f64,
    /// steps/s².
    pub max_acceleration: f64,
}

impl Default for WinchSettings {
    /// 1 Hz, b = 1.0 (it rings), and the limits that a board begins with. Source: StepperWinch, `Path::Path`.
    fn default() -> WinchSettings {
        let omega = std::f64::consts::TAU;
        WinchSettings {
            stiffness: omega * omega,
            damping: 1.0,
            max_speed: FIRST_SPEED.into(),
            max_acceleration: FIRST_ACCELERATION.into(),
        }
    }
}

/// One command for one axis. The letters are the line protocol's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WinchCommand {
    /// `a`: the target is this position, steps.
    Target(f64),
    /// `d`: the target moves by this, steps.
    Move(f64),
    /// `v`: the target drifts at this speed, steps/s, for ever.
    Drift(f64),
    /// `g`: natural frequency, Hz, and damping ratio: k = (2πf)², b = 2ζ√k.
    Gains {
        /// Hz.
        frequency_hz: f64,
        /// ζ, 1 is critical.
        damping_ratio: f64,
    },
    /// `l`: steps/s and steps/s².
    Limits {
        /// steps/s.
        max_speed: f64,
        /// steps/s².
        max_acceleration: f64,
    },
    /// `r`: the target moves by this at once, steps, without a ramp.
    Impulse(f64),
    /// `s`: from now on a target is approached no faster than this, steps/s; 0 or less: at once, as at the start.
    RampSpeed(f64),
}

/// The path of one axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Winch {
    commands: Vec<(Time, WinchCommand)>,
    settings: WinchSettings,
    duration: Option<Time>,
}

/// The recurrence's step, s.
const DT: f64 = 1e-3;

/// Fastest that any command may ask for, steps/s.
const FASTEST: f64 = 1e9;

impl Law {
    /// The path of one axis under `commands` (in order of time; each acts from the first millisecond at or after it).
    ///
    /// # Errors
    /// [`LawError::Parameter`], with the command counted from 1, for times that go back or are negative and for values
    /// that are not finite; gains and limits must not be negative.
    pub fn winch(
        commands: &[(Time, WinchCommand)],
        settings: WinchSettings,
        duration: Option<Time>,
    ) -> Result<Law, LawError> {
        checked("stiffness", settings.stiffness, "1/s²", |k| (0.0..=1e9).contains(&k))?;
        checked("damping", settings.damping, "1/s", |b| (0.0..=1e6).contains(&b))?;
        checked("max_speed", settings.max_speed, "steps/s", |v| (0.0..=FASTEST).contains(&v))?;
        checked("max_acceleration", settings.max_acceleration, "steps/s²", |a| (0.0..=1e12).contains(&a))?;
        if duration.is_some_and(|d| d <= Time::ZERO) {
            return Err(LawError::Parameter("the duration must be positive".into()));
        }
        let mut before = Time::ZERO;
        for (row, (at, command)) in commands.iter().enumerate() {
            let row = row + 1;
            if *at < before {
                return Err(LawError::Parameter(format!(
                    "command {row}: its time {} s is before {} s, that of the one before it",
                    at.seconds(),
                    before.seconds()
                )));
            }
            before = *at;
            if !command.is_sound() {
                return Err(LawError::Parameter(format!("command {row}: {command:?} is out of range")));
            }
        }
        Ok(Law::Winch(Arc::new(Winch { commands: commands.to_vec(), settings, duration })))
    }
}

impl WinchCommand {
    fn is_sound(&self) -> bool {
        match *self {
            WinchCommand::Target(x) | WinchCommand::Move(x) | WinchCommand::Impulse(x) => x.abs() < FARTHEST,
            WinchCommand::Drift(v) | WinchCommand::RampSpeed(v) => v.abs() <= FASTEST,
            WinchCommand::Gains { frequency_hz, damping_ratio } => {
                (0.0..=5000.0).contains(&frequency_hz) && (0.0..=30.0).contains(&damping_ratio)
            }
            WinchCommand::Limits { max_speed, max_acceleration } => {
                (0.0..=FASTEST).contains(&max_speed) && (0.0..=1e12).contains(&max_acceleration)
            }
        }
    }
}

/// The filter's state, in the sketch's terms.
#[derive(Clone, Copy, Debug)]
struct Filter {
    q: f64,
    speed: f64,
    /// The input of the filter. With a ramp speed it moves to `target` at that speed.
    reference: f64,
    target: f64,
    drift: f64,
    ramp_speed: f64,
    settings: WinchSettings,
}

impl Filter {
    fn obey(&mut self, command: WinchCommand) {
        match command {
            WinchCommand::Target(x) => self.target = x,
            WinchCommand::Move(x) => self.target += x,
            WinchCommand::Impulse(x) => {
                self.target += x;
                self.reference += x;
            }
            WinchCommand::Drift(v) => self.drift = v,
            WinchCommand::Gains { frequency_hz, damping_ratio } => {
                let omega = std::f64::consts::TAU * frequency_hz;
                self.settings.stiffness = omega * omega;
                self.settings.damping = 2.0 * omega * damping_ratio;
            }
            WinchCommand::Limits { max_speed, max_acceleration } => {
                self.settings.max_speed = max_speed;
                self.settings.max_acceleration = max_acceleration;
            }
            WinchCommand::RampSpeed(v) => self.ramp_speed = v,
        }
    }

    fn step(&mut self) {
        let way = self.target - self.reference;
        self.reference +=
            if self.ramp_speed > 0.0 { way.clamp(-self.ramp_speed * DT, self.ramp_speed * DT) } else { way };
        let WinchSettings { stiffness: k, damping: b, max_speed, max_acceleration } = self.settings;
        let acceleration = k * (self.reference - self.q) + b * (self.drift - self.speed);
        let acceleration = acceleration.clamp(-max_acceleration, max_acceleration);
        self.q += self.speed * DT;
        self.speed += acceleration * DT;
        self.reference += self.drift * DT;
        self.target += self.drift * DT;
        self.speed = self.speed.clamp(-max_speed, max_speed);
    }
}

impl Winch {
    pub(super) fn duration(&self) -> Option<Time> {
        self.duration
    }

    pub(super) fn pieces(self: Arc<Winch>) -> impl Iterator<Item = Result<Piece, LawError>> {
        let settings = self.settings;
        let mut path =
            Filter { q: 0.0, speed: 0.0, reference: 0.0, target: 0.0, drift: 0.0, ramp_speed: 0.0, settings };
        let mut next = 0;
        let last = self.duration.unwrap_or(Time::MAX);
        let mut start = Time::ZERO;
        (0..i64::MAX >> 2).map_while(move |ms| {
            if start >= last {
                return None;
            }
            let now = Time::from_ratio(ms, 1000);
            // The first piece is half a millisecond of rest. Each later one lasts from the middle of a millisecond to the next middle.
            let end = Time::from_ratio(2 * ms + 1, 2000).min(last);
            let before = path;
            if ms > 0 {
                path.step();
            }
            while let Some((_, command)) = self.commands.get(next).filter(|(at, _)| *at <= now) {
                path.obey(*command);
                next += 1;
            }
            // Around `now` the speed goes from the last millisecond's to this one's.
            let change = (path.speed - before.speed) / DT;
            let c = if change == 0.0 {
                vec![0.0, path.speed]
            } else {
                vec![0.125 * DT * DT * change, 0.5 * (before.speed + path.speed), 0.5 * change]
            };
            let curve = Curve::Polynomial(if c == [0.0, 0.0] { vec![0.0] } else { c });
            let mut piece = Piece { zero: now, start, end, origin: 0, curve, entry: Entry::Continuous };
            start = end;
            Some(piece.raise(Double::from(path.q)).map(|()| piece))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Cursor;

    #[test]
    fn positions_are_the_recurrence_s() {
        let ms = |k| Time::from_ratio(k, 1000);
        let commands = [
            (ms(0), WinchCommand::Target(800.0)),
            (ms(400), WinchCommand::Gains { frequency_hz: 2.0, damping_ratio: 0.7 }),
            (ms(900), WinchCommand::Drift(500.0)),
            (ms(1500), WinchCommand::Move(-5000.0)),
            (ms(1500), WinchCommand::Limits { max_speed: 2000.0, max_acceleration: 9000.0 }),
        ];
        let law = Law::winch(&commands, WinchSettings::default(), Some(Time::from_seconds(4.0))).unwrap();
        let mut cursor = Cursor::new(&law);
        // StepperWinch's Path.cpp, in f64.
        let (mut q, mut qd, mut q_d, mut qd_d) = (0.0_f64, 0.0_f64, 0.0_f64, 0.0_f64);
        let (mut k, mut b) = (4.0 * std::f64::consts::PI.powi(2), 1.0);
        let (mut qd_max, mut qdd_max) = (3500.0, 35_000.0);
        for n in 0..4000 {
            match n {
                0 => q_d = 800.0,
                400 => {
                    k = 4.0 * 4.0 * std::f64::consts::PI.powi(2);
                    b = 2.0 * k.sqrt() * 0.7;
                }
                900 => qd_d = 500.0,
                1500 => {
                    q_d -= 5000.0;
                    (qd_max, qdd_max) = (2000.0, 9000.0);
                }
                _ => {}
            }
            let sample = cursor.at(ms(n)).unwrap();
            assert!((sample.position - q).abs() <= 35_000.0 * 1e-6 / 8.0 + 1e-7, "{n} ms: {} {q}", sample.position);
            let qdd = (k * (q_d - q) + b * (qd_d - qd)).clamp(-qdd_max, qdd_max);
            q += qd * 1e-3;
            qd += qdd * 1e-3;
            q_d += qd_d * 1e-3;
            qd = qd.clamp(-qd_max, qd_max);
            // In the middle of a millisecond speed and position are those of the straight line.
            let middle = cursor.at(ms(n) + Time::from_ratio(1, 2000)).unwrap();
            assert!(middle.acceleration.abs() <= qdd_max * (1.0 + 1e-9));
        }
        assert_eq!(law.end(), Some(Time::from_seconds(4.0)));
    }

    #[test]
    fn a_board_s_path_is_the_law_s() {
        use pulsetrain_core::winch::path::Path as Fixed;
        let ms = |k| Time::from_ratio(k, 1000);
        let commands = [
            (ms(0), WinchCommand::Target(800.0)),
            (ms(700), WinchCommand::Drift(-500.0)),
            (ms(1500), WinchCommand::RampSpeed(300.0)),
            (ms(1600), WinchCommand::Move(2000.0)),
            (ms(2500), WinchCommand::Impulse(-100.0)),
            (ms(3000), WinchCommand::Drift(0.0)),
            (ms(4000), WinchCommand::RampSpeed(0.0)),
        ];
        let law = Law::winch(&commands, WinchSettings::default(), Some(Time::from_seconds(8.0))).unwrap();
        let (mut cursor, mut path) = (Cursor::new(&law), Fixed::new());
        for now in 0..8000 {
            let position = f64::from(path.made()) + f64::from(path.offset()) / 65_536_000.0;
            let wanted = cursor.at(ms(now)).unwrap().position;
            assert!((position - wanted).abs() < 0.0045, "{now} ms: {position} {wanted}");
            for (_, command) in commands.iter().filter(|(at, _)| *at == ms(now)) {
                match *command {
                    WinchCommand::Target(x) => path.set_target(x as i32),
                    WinchCommand::Move(x) => path.move_target(x as i32),
                    WinchCommand::Drift(v) => path.set_drift(v as i16),
                    WinchCommand::Impulse(x) => path.push_reference(x as i32),
                    WinchCommand::RampSpeed(v) => path.set_ramp(v as u16),
                    WinchCommand::Gains { .. } | WinchCommand::Limits { .. } => unreachable!("not among them"),
                }
            }
            let _ = path.tick();
        }
    }
}
