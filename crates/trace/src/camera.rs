//! The track of a film: CSV of time and angle, such as the tutorial's with 50 frames in a second.
//!
//! The header names the columns and their units: a time (in s unless it has another unit) and an angle in deg, rad, rev
//! or steps, with the names and units of [`pulsetrain_motion::columns`]. A column `sigma` has the angle's standard
//! deviation, in the angle's unit. Other columns are ignored.
//!
//! ```
//! use pulsetrain_trace::camera::{self, AngleUnit};
//! let track = camera::read("time [ms],frame,theta [rad]\n0,1,0.00\n20,2,0.05\n".as_bytes())?;
//! assert_eq!((track.frames[1].time_s, track.frames[1].angle), (0.02, 0.05));
//! assert_eq!(track.unit, AngleUnit::Radians);
//! # Ok::<(), pulsetrain_trace::ReadError>(())
//! ```

use pulsetrain_motion::columns::{ANGLES, CsvTable, Header, Role, Stated, TIME, Title};
use pulsetrain_motion::quantity::Base;

use crate::ReadError;

/// The unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AngleUnit {
    /// Degrees of the wheel.
    Degrees,
    /// Radians of the wheel.
    Radians,
    /// Revolutions of the wheel.
    Revolutions,
    /// Steps of the motor.
    Steps,
}

impl AngleUnit {
    /// The unit by its name in motion files.
    fn named(unit: &str) -> Option<AngleUnit> {
        match unit {
            "deg" | "°" => Some(AngleUnit::Degrees),
            "rad" => Some(AngleUnit::Radians),
            "rev" | "revs" | "turn" | "turns" => Some(AngleUnit::Revolutions),
            "step" | "steps" | "microstep" | "microsteps" => Some(AngleUnit::Steps),
            _ => None,
        }
    }

    /// The size of one unit in steps.
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
    /// Angle in the track's unit. It may go on counting over full turns, or begin again at each turn.
    pub angle: f64,
    /// Standard deviation of the angle in the track's unit; `None` if the track does not state it.
    pub sigma: Option<f64>,
}

/// The angle of one wheel over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The unit of the angles.
    pub unit: AngleUnit,
    /// The frames in order of time.
    pub frames: Vec<Frame>,
}

const ANGLE: Role<'static> =
    Role { what: "the angle", own: None, names: ANGLES, is_time: false, example: "angle [deg]" };

/// Whether a header has a column with an angle. Channels of logic analysers may be called `A` or `step`, which are then
/// no angles. A column called `rev` or `home_rev` counts as an angle only if `sure` is false.
pub(crate) fn has_angle(header: &Header<'_>, sure: bool) -> bool {
    header.titles.iter().any(|title| match &title.unit {
        Stated::Unit(unit) => {
            let is_sure = title.text.contains(['[', '(']) || title.is_one_of(ANGLES);
            unit.base == Base::Turn && (is_sure || !sure) || title.is_called("position")
        }
        _ => title.is_one_of(&["angle", "theta", "θ", "position"]),
    })
}

/// Longest film, s: eleven days.
pub const LONGEST_S: f64 = 1e6;

/// Reads a track.
///
/// # Errors
/// If a column is missing or not clear, a unit is unknown, a field is no number, or time goes back.
pub fn read(bytes: &[u8]) -> Result<Track, ReadError> {
    let mut table = CsvTable::new(bytes);
    let header = table.header()?;
    if !header.is_there() {
        return Err(header.error("a header such as `time [s],angle [deg]`", "none"));
    }
    let found = header.find(&[TIME, ANGLE])?;
    let (time, angle) = (found[0], found[1]);
    let scale = match &header.titles[time].unit {
        Stated::Nothing => 1.0,
        Stated::Unit(unit) if TIME.fits(unit) => unit.value,
        _ => return Err(header.error_in(time, "a time in s, ms, us, ns, min or h")),
    };
    let unit = match &header.titles[angle].unit {
        Stated::Unit(unit) if ANGLE.fits(unit) => AngleUnit::named(unit.unit),
        _ => None,
    };
    let Some(unit) = unit else {
        return Err(header.error_in(angle, "an angle with its unit: `angle [deg]`, rad, rev or steps"));
    };
    let is_sigma =
        |title: &Title| title.is_one_of(&["sigma", "σ", "uncertainty"]) && title.unit == header.titles[angle].unit;
    let sigma = header.titles.iter().position(is_sigma);
    let mut frames: Vec<Frame> = Vec::new();
    while let Some(row) = table.next()? {
        let time_s = scale * row.number(time, "a time")?;
        if time_s.abs() > LONGEST_S {
            return Err(row.error(time, format!("a time within {LONGEST_S} s")));
        }
        if let Some(last) = frames.last().filter(|last| time_s < last.time_s) {
            return Err(row.error(time, format!("a time not before {} s", last.time_s)));
        }
        let stated = sigma.map(|column| row.number(column, "a standard deviation")).transpose()?;
        if let (Some(column), Some(_)) = (sigma, stated.filter(|sigma| *sigma < 0.0)) {
            return Err(row.error(column, "a standard deviation, 0 or more"));
        }
        frames.push(Frame { time_s, angle: row.number(angle, "an angle")?, sigma: stated });
    }
    Ok(Track { unit, frames })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn headers() {
        let check = |header: &str, scale: f64, unit: AngleUnit| {
            let track = read(format!("{header}\n2 , 3\n").as_bytes()).unwrap();
            assert_eq!(
                track,
                Track { unit, frames: vec![Frame { time_s: 2.0 * scale, angle: 3.0, sigma: None }] },
                "{header}"
            );
        };
        check("t,theta_deg", 1.0, AngleUnit::Degrees);
        check("Time [ms],Angle [rad]", 1e-3, AngleUnit::Radians);
        check("time (s),θ (rev)", 1.0, AngleUnit::Revolutions);
        check("# film 3\nt,position [steps]", 1.0, AngleUnit::Steps);
        check("Time in ms,Angle in degrees", 1e-3, AngleUnit::Degrees);
        check("milliseconds,servo rad", 1e-3, AngleUnit::Radians);
        check("t [min],a [turn]", 60.0, AngleUnit::Revolutions);
        assert_eq!(
            read(b"frame,a [rad],t [ms]\n1,2,3\n").unwrap().frames,
            [Frame { time_s: 0.003, angle: 2.0, sigma: None }]
        );
        let stated = read(b"t,angle [deg],sigma [deg]\n1,3,0.5\n").unwrap().frames;
        assert_eq!(stated, [Frame { time_s: 1.0, angle: 3.0, sigma: Some(0.5) }]);
        assert_eq!(read(b"t,angle [deg],sigma [rad]\n1,3,0.5\n").unwrap().frames[0].sigma, None);
        assert_eq!(read(b"t;n;angle [deg]\n1;2;3\n").unwrap().frames, [Frame { time_s: 1.0, angle: 3.0, sigma: None }]);
    }

    #[test]
    fn what_is_wrong_is_said_with_its_place() {
        let check = |file: &str, expected: &str| assert_eq!(read(file.as_bytes()).unwrap_err().to_string(), expected);
        check("", "line 1, column 1: expected a header such as `time [s],angle [deg]`, found none");
        check("0,1\n", "line 1, column 1: expected a header such as `time [s],angle [deg]`, found none");
        check("x,y,z\n", "line 1, column 1: expected a column `time [s]`, found `x`, `y`, `z`");
        check("t,x,y\n", "line 1, column 1: expected a column `angle [deg]`, found `t`, `x`, `y`");
        for name in ["frame_no", "Sample index", "force"] {
            let found = format!("line 1, column 1: expected a column `time [s]`, found `{name}`, `angle [deg]`");
            check(&format!("{name},angle [deg]\n0,0\n1,5\n"), &found);
        }
        check("frame,angle [deg]\n", "line 1, column 1: expected a column `time [s]`, found `frame`, `angle [deg]`");
        check(
            "t [ms],time [s],angle [deg]\n",
            "line 1, column 1: expected one column for the time, found column 1 `t [ms]` and column 2 `time [s]`",
        );
        check(
            "t,left [deg],right [deg]\n",
            "line 1, column 1: expected one column for the angle, found column 2 `left [deg]` and column 3 `right [deg]`",
        );
        check("t [moons],a [deg]\n", "line 1, column 1: expected a time in s, ms, us, ns, min or h, found `t [moons]`");
        check(
            "t,angle\n",
            "line 1, column 3: expected an angle with its unit: `angle [deg]`, rad, rev or steps, found `angle`",
        );
        check(
            "t,angle [mm]\n",
            "line 1, column 3: expected an angle with its unit: `angle [deg]`, rad, rev or steps, found `angle [mm]`",
        );
        check("t,angle [deg]\n0,1\n-1,2\n", "line 3, column 1: expected a time not before 0 s, found `-1`");
        check("t,angle [deg]\n0,nan\n", "line 2, column 3: expected an angle, found `nan`");
        check("t,angle [deg]\n1e7,0\n", "line 2, column 1: expected a time within 1000000 s, found `1e7`");
        check(
            "t,angle [deg]\n0,0\n1,5,10\n",
            "line 3, column 5: expected 2 columns as in the first row, found `10` in column 3; \
             a comma separates columns here: write decimals with a point, 0.5, or separate the columns with `;` or tabs",
        );
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
