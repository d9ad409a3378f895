//! Pictures of a motion: position by the law and by the steps, intervals, speed, the error of every step, and the figures
//! that machines draw.
//!
//! [`Picture`] collects the law and the steps while they come, in bounded memory. [`Picture::svg`] and [`Picture::png`]
//! draw it.
//!
//! ```
//! use pulsetrain_motion::file;
//! use pulsetrain_plot::{Errors, MotorPicture, Picture};
//!
//! let text = r#"
//!     board = "native"
//!     tolerance = "1 us"
//!
//!     [motor.wheel]
//!     steps_per_rev = 200
//!     driver = "A4988"
//!     pins = { step = 8, dir = 9 }
//!     forward = "high"
//!     max_acceleration = "50 rev/s^2"
//!
//!     [[motion]]
//!     motor = "wheel"
//!     law.sine = { amplitude = "1 rev", period = "2 s", cycles = 1 }
//! "#;
//! let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
//! let program = file::read(text, "wheel.toml", &no_files)?;
//! let wheel = &program.motors[0];
//!
//! // A motor by its name, with the user's unit and the bound of its errors, ticks.
//! let mut motor = MotorPicture::new(wheel.name.clone(), wheel.scale.clone(), 1.0);
//! motor.want_law(&wheel.law, pulsetrain_motion::Time::MAX)?;
//! for (t, position, late_ticks) in [(0.01, 1, 0.2), (0.02, 2, -0.4), (0.03, 3, 0.1)] {
//!     motor.step(t, position);
//!     motor.error(t, late_ticks);
//! }
//! let picture = Picture {
//!     title: "wheel.toml on native".to_owned(),
//!     tick_s: 1.0 / program.board.tick_hz as f64,
//!     motors: vec![motor],
//!     errors: Errors::Ticks,
//!     figures: Vec::new(),
//!     changes: Vec::new(),
//! };
//! assert!(picture.svg()?.starts_with("<svg"));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # What is here, top down
//! - [`Picture`], [`MotorPicture`]: what is drawn
//! - [`machine`]: a machine's figure by the law and by the steps, and the distance between them
//! - [`moving`]: a picture that moves: law, STEP pulses, wheel
//! - [`FilmPicture`]: a film over the law, and their difference
//! - `draw`, `figure`, `film`, `axis`: panels, figures, films, axes
//! - `envelope`: many points in few pixels
//!
//! # What is not
//! Files (the command line writes them), the verdict (`pulsetrain-trace`).
#![cfg_attr(test, allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit"))]
#![forbid(unsafe_code)]

mod axis;
mod draw;
mod envelope;
mod figure;
mod film;
pub mod machine;
pub mod moving;

use pulsetrain_motion::law::{Cursor, Law};
use pulsetrain_motion::program::Scale;
use pulsetrain_motion::{LawError, Time};

pub use envelope::Envelope;
pub use figure::FigurePicture;
pub use film::{FilmFrame, FilmPicture};

/// A picture's content, which collects the law and the steps while a motion runs.
#[derive(Clone, Debug)]
pub struct Picture {
    /// The line above the panels.
    pub title: String,
    /// One period of the step timer, s.
    pub tick_s: f64,
    /// The motors, in the file's order.
    pub motors: Vec<MotorPicture>,
    /// How the errors of steps are measured.
    pub errors: Errors,
    /// The machines' figures, in the file's order.
    pub figures: Vec<FigurePicture>,
    /// When the motion changed, s.
    pub changes: Vec<f64>,
}

/// How the errors in a picture are measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Errors {
    /// By how many ticks steps are late. The bound is the proven one.
    #[default]
    Ticks,
    /// By how many steps the motor is behind a path. The bound is the allowed one.
    Steps,
    /// The single steps were not seen. Positions are those that a board reported now and then.
    Unknown,
    /// The law changed while it ran. The steps are drawn over it, without their errors.
    Live,
}

impl Errors {
    fn title(self, motor: &str, bound: &str, late_ticks: f64) -> String {
        match self {
            Errors::Ticks if late_ticks > 0.0 => {
                format!("Error of {motor} at its pin, ticks; plan ±{bound}, board +{late_ticks:.0}")
            }
            Errors::Ticks => format!("Error of {motor}, ticks; proven: at most {bound}"),
            Errors::Steps | Errors::Unknown | Errors::Live => {
                format!("Steps of {motor} behind the path, steps; allowed: {bound}")
            }
        }
    }

    /// The name of the thick lines in the legend.
    const fn made(self) -> &'static str {
        match self {
            Errors::Ticks | Errors::Steps | Errors::Live => "stepped",
            Errors::Unknown => "as the board says",
        }
    }

    /// The name of the thin line in the legend.
    const fn wanted(self) -> &'static str {
        match self {
            Errors::Ticks => "wanted by the law",
            Errors::Steps | Errors::Unknown => "the path",
            Errors::Live => "wanted by the law of that time; dashed: a change begins",
        }
    }
}

/// One motor's curves.
#[derive(Clone, Debug)]
pub struct MotorPicture {
    /// The motor's name in the motion file.
    pub name: String,
    /// How steps become the user's unit.
    pub scale: Scale,
    /// The bound of the errors: the certificate's, ticks; of a path the allowed one, steps.
    pub bound_ticks: f64,
    /// How much later than the plan the board's edges may come, ticks. 0 for a board whose edges are on their ticks.
    pub late_ticks: f64,
    wanted: Envelope,
    wanted_speed: Envelope,
    wanted_closely: Vec<(f64, f64)>,
    stepped: Envelope,
    stepped_speed: Envelope,
    intervals: Envelope,
    errors: Envelope,
    first_steps: Vec<(f64, i64)>,
    steps: u64,
    last: (f64, i64),
}

/// Points of the law over its whole length, at least.
const LAW_POINTS: f64 = 2000.0;
/// Points of the law in each of its pieces, at least: pieces may be many and short.
const MIN_POINTS_OF_A_PIECE: u32 = 8;
/// Points of the law in the close view.
const CLOSE_POINTS: u32 = 400;
/// Number of steps that the close view shows.
const FIRST_STEPS: usize = 16;

impl MotorPicture {
    /// A motor that has not moved yet.
    #[must_use]
    pub fn new(name: String, scale: Scale, bound_ticks: f64) -> MotorPicture {
        MotorPicture {
            name,
            scale,
            bound_ticks,
            late_ticks: 0.0,
            wanted: Envelope::default(),
            wanted_speed: Envelope::default(),
            wanted_closely: Vec::new(),
            stepped: Envelope::default(),
            stepped_speed: Envelope::default(),
            intervals: Envelope::default(),
            errors: Envelope::default(),
            first_steps: Vec::new(),
            steps: 0,
            last: (0.0, 0),
        }
    }

    /// Adds a point of the law: at `t` seconds it is at `theta` steps from its start, going at `speed` steps/s.
    pub fn want(&mut self, t: f64, theta: f64, speed: f64) {
        self.wanted.push(t, theta);
        self.wanted_speed.push(t, speed);
    }

    /// Adds points along the law up to `until`, or to its end if that comes before. No reversal is left out.
    ///
    /// # Errors
    /// If the law has no value somewhere.
    pub fn want_law(&mut self, law: &Law, until: Time) -> Result<(), LawError> {
        let end = law.end().map_or(until, |end| end.min(until)).seconds();
        let mut start = None;
        for piece in law.pieces() {
            let mut piece = piece?;
            if piece.start >= until {
                break;
            }
            piece.end = piece.end.min(until);
            let first = piece.curve.value(piece.first());
            let (origin, zero) = *start.get_or_insert((piece.origin, first));
            let part = (piece.last() - piece.first()) / end;
            let points = ((LAW_POINTS * part).ceil().min(LAW_POINTS) as u32).max(MIN_POINTS_OF_A_PIECE);
            for k in 0..=points {
                let u = piece.first() + (piece.last() - piece.first()) * f64::from(k) / f64::from(points);
                let jet = piece.curve.jet(u);
                self.want(piece.zero.seconds() + u, (piece.origin - origin) as f64 + (jet[0] - zero), jet[1]);
            }
        }
        Ok(())
    }

    /// Adds a point for the [`Picture::close_view`].
    pub fn want_close(&mut self, t: f64, theta: f64) {
        self.wanted_closely.push((t, theta));
    }

    /// Adds points of the law between two times, s, for the [`Picture::close_view`].
    ///
    /// # Errors
    /// If the law has no value somewhere.
    pub fn want_closely(&mut self, law: &Law, (from, to): (f64, f64)) -> Result<(), LawError> {
        let mut cursor = Cursor::new(law);
        let start = cursor.at(Time::ZERO)?.position;
        for k in 0..=CLOSE_POINTS {
            let t = from + (to - from) * f64::from(k) / f64::from(CLOSE_POINTS);
            self.want_close(t, cursor.at(Time::from_seconds(t))?.position - start);
        }
        Ok(())
    }

    /// Adds a step: at `t` seconds the motor went to `position`.
    pub fn step(&mut self, t: f64, position: i64) {
        let (before, from) = self.last;
        if self.stepped.span().is_none() {
            self.stepped.push(0.0, from as f64);
        }
        // While points are few the steps are drawn as a staircase, among thousands as a line.
        if self.stepped.is_exact() {
            self.stepped.push(t, from as f64);
        }
        self.stepped.push(t, position as f64);
        if self.first_steps.len() < FIRST_STEPS {
            self.first_steps.push((t, position));
        }
        self.steps += 1;
        if self.steps > 1 && t > before {
            self.intervals.push(self.steps as f64, t - before);
            // The speed is constant from step to step: a line between the middles would make a ramp of every rest.
            let speed = (position - from) as f64 / (t - before);
            self.stepped_speed.push(before, speed);
            self.stepped_speed.push(t, speed);
        }
        self.last = (t, position);
    }

    /// Adds the error of the step at `t` seconds, in the unit of [`Picture::errors`].
    pub fn error(&mut self, t: f64, late: f64) {
        self.errors.push(t, late);
    }

    /// The staircase of the first steps within `window`.
    fn stairs(&self, window: (f64, f64)) -> Vec<(f64, f64)> {
        let mut stairs = vec![(window.0, 0.0)];
        let mut position = 0.0;
        for &(t, to) in self.first_steps.iter().take_while(|(t, _)| *t <= window.1) {
            stairs.extend([(t, position), (t, to as f64)]);
            position = to as f64;
        }
        stairs.push((window.1, position));
        stairs
    }
}

impl Picture {
    /// The time range of the close view, s. It lies around the first steps of the motor that makes them soonest. `None`
    /// if no motor steps twice.
    #[must_use]
    pub fn close_view(&self) -> Option<(f64, f64)> {
        let spans = self.motors.iter().filter_map(|motor| match motor.first_steps[..] {
            [first, .., last] => Some(((first.0 - 0.3 * (last.0 - first.0)).max(0.0), last.0)),
            _ => None,
        });
        spans.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(from, to)| (from, to + 0.05 * (to - from)))
    }

    /// The picture as SVG.
    ///
    /// # Errors
    /// If the drawing library fails; the text is the library's.
    pub fn svg(&self) -> Result<String, String> {
        draw::svg(self)
    }

    /// The picture as a PNG file.
    ///
    /// # Errors
    /// If the drawing library fails; the text is the library's.
    pub fn png(&self) -> Result<Vec<u8>, String> {
        draw::png(self)
    }
}
