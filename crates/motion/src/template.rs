//! The motion file that `pulsetrain new` writes: commented, and ready to run.

/// A motion file that begins with `name` in a comment.
///
/// ```
/// use pulsetrain_motion::{file, template};
/// let none = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
/// assert!(file::read(&template::motion_file("pendulum"), "pendulum.toml", &none).is_ok());
/// ```
#[must_use]
pub fn motion_file(name: &str) -> String {
    // A name with control characters in it would end the comment.
    let name: String = name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    TEXT.replace("NAME", &name)
}

const TEXT: &str = r#"# NAME: a motion file for Pulsetrain. Every amount carries its unit.
#
#   pulsetrain plan FILE      what it comes to: steps, speeds, proof; nothing runs
#   pulsetrain run FILE       run it on a board in virtual time, judge and draw it
#   pulsetrain explain FILE   if it is refused: why, and what would fit

# uno, due, pico, or native (this computer, in virtual time).
board = "uno"

# When a step is made: "nearest" steps half-way between two positions (with a little hysteresis),
# "reach" when the motion reaches the next position.
grid = "nearest"

# How far a step may be from its exact time: "1 tick" of the board's timer, or a time.
tolerance = "1 us"

[motor.wheel]
steps_per_rev = 200          # full steps of the motor: 1.8 degrees each
microsteps = 8               # as set on the driver: see `pulsetrain drivers`
driver = "A4988"             # or its own times: pulse_high = "2 us", pulse_low, dir_setup, dir_hold
pins = { step = 8, dir = 9 } # enable = 7 if that is wired; { in = [2, 3, 4, 5] } for a ULN2003
forward = "high"             # the level of DIR that is forward: "low" if it turns the wrong way
max_speed = "5 rev/s"
max_acceleration = "50 rev/s^2"
pull_in = "0.5 rev/s"        # what it can start and stop at without a ramp
# gear = "16:60"             # teeth on the motor : teeth on what it drives; or gear = 3
# lead = "8 mm"              # travel in a turn, for a screw or belt: then mm may be used

# Motions of one motor follow one another, each from where the one before ended.
[[motion]]
motor = "wheel"
law.sine = { amplitude = "1 rev", period = "2 s", cycles = 3 }

[[motion]]
motor = "wheel"
start = "7 s"                # on the common time zero; without it, when the motion before ends
law.trapezoid = { distance = "3 rev", speed = "2 rev/s", acceleration = "20 rev/s^2", deceleration = "10 rev/s^2" }

# Any formula does: t is in seconds, theta in the unit.
# [[motion]]
# motor = "wheel"
# law.formula = { theta = "a*sin(2*pi*f*t)^3", unit = "deg", duration = "10 s", where = { a = 90, f = "0.5 Hz" } }
"#;

#[cfg(test)]
mod tests {
    use std::io;

    use super::*;
    use crate::{Time, file};

    fn read(text: &str) -> crate::program::Program {
        file::read(text, "new.toml", &|_| Err(io::ErrorKind::NotFound.into()))
            .unwrap_or_else(|e| panic!("{}", e.plain()))
    }

    #[test]
    fn the_template_is_a_motion_file() {
        let program = read(&motion_file("my \"first\"\nmotion"));
        assert_eq!(program.motors[0].law.end().map(|end| end > Time::from_seconds(8.0)), Some(true));
    }

    #[test]
    fn what_it_has_in_comments_works_too() {
        let text = motion_file("all").replace("# [[motion]]", "[[motion]]").replace("# motor =", "motor =");
        let text = text.replace("# law.formula", "law.formula").replace("# lead", "lead");
        assert_eq!(read(&text).motors.len(), 1);
    }
}
