//! A film's track: CSV of time and angle, as the tutorial's 50 frames a second gave.
//!
//! The header says what the columns are, and their units in brackets, in parentheses or after an underscore:
//! `t` or `time` in s (also without a unit) or ms; `angle`, `theta`, `θ` or `position` in deg, rad, rev or steps.
//! Other columns are left out.
//!
//! ```
//! use pulsetrain_trace::camera::{self, AngleUnit};
//! let track = camera::read("time [ms],frame,theta [rad]\n0,1,0.00\n20,2,0.05\n".as_bytes())?;
//! assert_eq!((track.frames[1].time_s, track.frames[1].angle), (0.02, 0.05));
//! assert_eq!(track.unit, AngleUnit::Radians);
//! # Ok::<(), pulsetrain_trace::ReadError>(())
//! ```

use crate::table::{ReadError, Row, Table};

/// What angles are given in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleUnit {
    /// Degrees of the motor's shaft.
    Degrees,
    /// Radians of the motor's shaft.
    Radians,
    /// Revolutions of the motor's shaft.
    Revolutions,
    /// Steps of the motor.
    Steps,
}

impl AngleUnit {
    /// One of it in steps.
    #[must_use]
    pub fn steps(self, steps_per_rev: f64) -> f64 {
        match self {
            AngleUnit::Degrees => steps_per_rev / 360.0,
            AngleUnit::Radians => steps_per_rev / std::f64::consts::TAU,
            AngleUnit::Revolutions => steps_per_rev,
            AngleUnit::Steps => 1.0,
        }
    }
}

/// One frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Seconds, by the camera's clock; within ±[`LONGEST_S`].
    pub time_s: f64,
    /// Angle in the track's unit; counted on over full turns.
    pub angle: f64,
}

/// The angle of one motor's shaft over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// What angles are given in.
    pub unit: AngleUnit,
    /// In order of time.
    pub frames: Vec<Frame>,
}

/// What the angle's column is called.
const ANGLE: [&str; 4] = ["angle", "theta", "θ", "position"];

/// Whether a header has a column with an angle.
pub(crate) fn has_angle(header: &Row<'_>) -> bool {
    (0..header.len())
        .any(|i| header.text(i).is_ok_and(|title| ANGLE.contains(&title_and_unit(&title.to_lowercase()).0)))
}

/// Longest film, s: eleven days.
pub const LONGEST_S: f64 = 1e6;

/// Reads a track.
///
/// # Errors
/// If the header lacks a column or names an unknown unit, a field is no number, or time goes back.
pub fn read(bytes: &[u8]) -> Result<Track, ReadError> {
    let mut table = Table::new(bytes);
    let Some(header) = table.next()? else {
        return Err(ReadError::new(1, 1, "a header such as `time [s],angle [deg]`", "nothing"));
    };
    let mut time = None;
    let mut angle = None;
    for column in 0..header.len() {
        let title = header.text(column)?.to_lowercase();
        let (name, unit) = title_and_unit(&title);
        match name {
            "t" | "time" if time.is_none() => {
                let scale = match unit {
                    "" | "s" | "sec" => 1.0,
                    "ms" => 1e-3,
                    _ => return Err(header.error(column, "time in s or ms")),
                };
                time = Some((column, scale));
            }
            name if ANGLE.contains(&name) && angle.is_none() => {
                let unit = match unit {
                    "deg" | "°" | "degrees" => AngleUnit::Degrees,
                    "rad" | "radians" => AngleUnit::Radians,
                    "rev" | "turns" => AngleUnit::Revolutions,
                    "steps" | "step" => AngleUnit::Steps,
                    _ => return Err(header.error(column, "an angle with its unit: `angle [deg]`, rad, rev or steps")),
                };
                angle = Some((column, unit));
            }
            _ => {}
        }
    }
    let Some((time, scale)) = time else { return Err(header.error(0, "a column `time [s]`")) };
    let Some((angle, unit)) = angle else { return Err(header.error(header.len(), "a column `angle [deg]`")) };
    let mut frames: Vec<Frame> = Vec::new();
    while let Some(row) = table.next()? {
        let time_s = scale * row.number(time, "a time")?;
        if time_s.abs() > LONGEST_S {
            return Err(row.error(time, format!("a time within {LONGEST_S} s")));
        }
        if let Some(last) = frames.last().filter(|last| time_s < last.time_s) {
            return Err(row.error(time, format!("a time not before {} s", last.time_s)));
        }
        frames.push(Frame { time_s, angle: row.number(angle, "an angle")? });
    }
    Ok(Track { unit, frames })
}

/// `theta [deg]`, "theta (deg)" and "theta_deg" → "theta", "deg".
fn title_and_unit(title: &str) -> (&str, &str) {
    let (name, unit) = title.split_once(['[', '(', '_']).unwrap_or((title, ""));
    (name.trim(), unit.trim_end_matches([']', ')']).trim())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn headers() {
        let check = |header: &str, scale: f64, unit: AngleUnit| {
            let track = read(format!("{header}\n2 , 3\n").as_bytes()).unwrap();
            assert_eq!(track, Track { unit, frames: vec![Frame { time_s: 2.0 * scale, angle: 3.0 }] }, "{header}");
        };
        check("t,theta_deg", 1.0, AngleUnit::Degrees);
        check("Time [ms],Angle [rad]", 1e-3, AngleUnit::Radians);
        check("time (s),θ (rev)", 1.0, AngleUnit::Revolutions);
        check("# film 3\nt,position [steps]", 1.0, AngleUnit::Steps);
        assert_eq!(read(b"t;n;angle [deg]\n1;2;3\n").unwrap().frames, [Frame { time_s: 1.0, angle: 3.0 }]);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let check = |file: &str, expected: &str| assert_eq!(read(file.as_bytes()).unwrap_err().to_string(), expected);
        check("", "line 1, column 1: expected a header such as `time [s],angle [deg]`, found nothing");
        check("x,y\n", "line 1, column 1: expected a column `time [s]`, found `x`");
        check("t,y\n", "line 1, column 5: expected a column `angle [deg]`, found nothing");
        check("t [h],y\n", "line 1, column 1: expected time in s or ms, found `t [h]`");
        check(
            "t,angle\n",
            "line 1, column 3: expected an angle with its unit: `angle [deg]`, rad, rev or steps, found `angle`",
        );
        check("t,angle [deg]\n0,1\n-1,2\n", "line 3, column 1: expected a time not before 0 s, found `-1`");
        check("t,angle [deg]\n0,nan\n", "line 2, column 3: expected an angle, found `nan`");
        check("t,angle [deg]\n1e7,0\n", "line 2, column 1: expected a time within 1000000 s, found `1e7`");
        check("t,angle [deg]\n1\n", "line 2, column 3: expected an angle, found nothing");
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
            let _ = read(&bytes);
            let mut file = b"t,angle [deg]\n".to_vec();
            file.extend(&bytes);
            let _ = read(&file);
        }
    }
}
