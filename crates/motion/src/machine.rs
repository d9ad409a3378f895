//! Machines: several motors that draw one figure, and where their tip is.
//!
//! # What is here
//! - [`Machine`]: its motors, how they move the tip, their positions at time zero, and where they may be
//! - [`Delta`]: a delta robot's arms: angles for a point, the point for angles
//!
//! # What is not
//! Paths, which are laws, one for each motor; and the limits of motors, which the planner checks.

use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt;

/// Several motors that draw one figure.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Its name in the file.
    pub name: String,
    /// Its motors, as indices into the program's motors: x and y, or the three arms.
    pub motors: Vec<usize>,
    /// From motors to the tip.
    pub kinematics: Kinematics,
    /// Each motor's position at time zero, steps in the machine's coordinates. The motor's own steps count from there.
    pub home: Vec<f64>,
    /// Each motor's backlash, steps.
    pub slack: Vec<f64>,
    /// The unit of the tip's coordinates: "mm", or the motors' unit.
    pub unit: String,
    /// The most that the tip may do, mm/s and mm/s², where the file says so.
    pub tip_limits: [Option<f64>; 2],
}

/// How motors move the tip.
#[derive(Clone, Debug, PartialEq)]
pub enum Kinematics {
    /// Each motor moves along its own axis.
    Xy {
        /// Steps in one unit of the machine, for x and for y.
        steps_per_unit: [f64; 2],
    },
    /// Three arms; units are mm.
    Delta {
        /// Its lengths.
        arms: Delta,
        /// Steps in a radian, of each arm.
        steps_per_rad: [f64; 3],
        /// Least and largest angle of an arm, rad, if the file gives them.
        angles: Option<(f64, f64)>,
    },
}

impl Machine {
    /// The tip's position when the motors have made `steps` since time zero, in the machine's unit. An xy machine has z = 0.
    ///
    /// `None` if the arms cannot have these angles.
    #[must_use]
    pub fn tip(&self, steps: &[f64]) -> Option<[f64; 3]> {
        let at = |motor: usize| Some(self.home.get(motor)? + steps.get(motor)?);
        match &self.kinematics {
            Kinematics::Xy { steps_per_unit } => Some([at(0)? / steps_per_unit[0], at(1)? / steps_per_unit[1], 0.0]),
            Kinematics::Delta { arms, steps_per_rad, .. } => {
                let angles = [at(0)? / steps_per_rad[0], at(1)? / steps_per_rad[1], at(2)? / steps_per_rad[2]];
                arms.point(angles)
            }
        }
    }

    /// The angles that the file allows to one of its motors; `None` if it sets no such limits.
    #[must_use]
    pub fn range(&self, motor: usize) -> Option<MotorRange> {
        let Kinematics::Delta { steps_per_rad, angles: Some((least, most)), .. } = &self.kinematics else {
            return None;
        };
        let (per_rad, home) = (steps_per_rad.get(motor)?, self.home.get(motor)?);
        let (least, most) = (least * per_rad - home, most * per_rad - home);
        Some(MotorRange { least, most, steps_per_deg: per_rad.to_radians() })
    }
}

/// Where a motor of a machine may be, steps since time zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorRange {
    /// The least position.
    pub least: f64,
    /// The largest one.
    pub most: f64,
    /// Steps in a degree of its arm.
    pub steps_per_deg: f64,
}

/// A delta robot with turning arms: three motors at 0°, 120° and 240° around a base, each with an upper arm; forearms
/// join those to the effector, which stays level.
///
/// x points from the robot's axis to the first motor, z up; z is 0 at the motors' shafts and less than 0 below them. An arm's
/// angle is 0 when it is level and points outwards, more when it points down. Source of the equations: the distance from
/// elbow to effector is the forearm's length, in the plane of each arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delta {
    /// From the robot's axis to a motor's shaft, mm.
    pub base_mm: f64,
    /// From a motor's shaft to the elbow, mm.
    pub upper_arm_mm: f64,
    /// From the elbow to the effector's joint, mm.
    pub forearm_mm: f64,
    /// From the effector's middle to its joints, mm.
    pub effector_mm: f64,
}

/// Why an arm cannot hold the effector somewhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum OutOfReach {
    /// The point is level with the shafts or above them.
    Above,
    /// The effector's joint is out of the arm's plane by more than the forearm.
    Aside {
        /// Which arm, from 0.
        arm: usize,
        /// mm.
        by_mm: f64,
        /// mm.
        limit_mm: f64,
    },
    /// The effector's joint is too far from the shaft, or too near.
    Distance {
        /// Which arm, from 0.
        arm: usize,
        /// In the arm's plane, mm.
        distance_mm: f64,
        /// mm.
        least_mm: f64,
        /// mm.
        most_mm: f64,
    },
}

impl OutOfReach {
    /// The arm, from 0; `None` if all are concerned.
    #[must_use]
    pub fn arm(&self) -> Option<usize> {
        match self {
            OutOfReach::Above => None,
            OutOfReach::Aside { arm, .. } | OutOfReach::Distance { arm, .. } => Some(*arm),
        }
    }
}

impl fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            OutOfReach::Above => f.write_str("z must be less than 0: below the motors' shafts"),
            OutOfReach::Aside { by_mm, limit_mm, .. } => {
                write!(f, "its joint is {by_mm:.1} mm aside of the arm, limit {limit_mm:.1} mm (the forearm)")
            }
            OutOfReach::Distance { distance_mm, least_mm, most_mm, .. } => {
                write!(f, "its joint is {distance_mm:.1} mm from the shaft, limits {least_mm:.1} to {most_mm:.1} mm")
            }
        }
    }
}

impl Delta {
    /// This robot with its lengths in units of `mm` millimetres.
    pub(crate) fn in_unit(&self, mm: f64) -> Delta {
        Delta {
            base_mm: self.base_mm / mm,
            upper_arm_mm: self.upper_arm_mm / mm,
            forearm_mm: self.forearm_mm / mm,
            effector_mm: self.effector_mm / mm,
        }
    }

    /// cos and sin of the direction in which an arm points.
    pub(crate) fn direction(arm: usize) -> (f64, f64) {
        match arm {
            0 => (1.0, 0.0),
            _ => {
                let (sin, cos) = libm::sincos(arm as f64 * TAU / 3.0);
                (cos, sin)
            }
        }
    }

    /// The angle of each arm that holds the effector at a point (mm), elbows outwards, rad.
    ///
    /// ```
    /// use pulsetrain_motion::machine::Delta;
    /// let robot = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
    /// let angles = robot.angles([20.0, -10.0, -140.0])?;
    /// let back = robot.point(angles).unwrap();
    /// assert!((back[0] - 20.0).abs() < 1e-9 && (back[2] + 140.0).abs() < 1e-9);
    /// let error = robot.angles([0.0, 0.0, -300.0]).unwrap_err();
    /// assert_eq!(error.to_string(), "its joint is 302.0 mm from the shaft, limits 80.0 to 220.0 mm");
    /// # Ok::<(), pulsetrain_motion::machine::OutOfReach>(())
    /// ```
    ///
    /// # Errors
    /// [`OutOfReach`] for the first arm that does not reach the point.
    pub fn angles(&self, [x, y, z]: [f64; 3]) -> Result<[f64; 3], OutOfReach> {
        if z.is_nan() || z >= 0.0 {
            return Err(OutOfReach::Above);
        }
        let mut angles = [0.0; 3];
        for (arm, angle) in angles.iter_mut().enumerate() {
            let (cos, sin) = Delta::direction(arm);
            let out = cos * x + sin * y + (self.effector_mm - self.base_mm);
            let aside = cos * y - sin * x;
            let forearm = self.forearm_mm * self.forearm_mm - aside * aside;
            if forearm.is_nan() || forearm <= 0.0 {
                return Err(OutOfReach::Aside { arm, by_mm: aside.abs(), limit_mm: self.forearm_mm });
            }
            let (forearm_mm, distance_mm) = (forearm.sqrt(), libm::hypot(out, z));
            let (least_mm, most_mm) = ((self.upper_arm_mm - forearm_mm).abs(), self.upper_arm_mm + forearm_mm);
            // Exactly at a limit the arm is stretched or folded, and its speed would be infinite. So the limits are excluded.
            if !(least_mm < distance_mm && distance_mm < most_mm) {
                return Err(OutOfReach::Distance { arm, distance_mm, least_mm, most_mm });
            }
            let square = distance_mm * distance_mm + self.upper_arm_mm * self.upper_arm_mm - forearm;
            *angle = FRAC_PI_2 + libm::atan(out / z) - libm::acos(square / (2.0 * self.upper_arm_mm * distance_mm));
        }
        Ok(angles)
    }

    /// The effector's position for these angles (rad), below the elbows, mm; `None` if there is none.
    #[must_use]
    pub fn point(&self, angles: [f64; 3]) -> Option<[f64; 3]> {
        // Each forearm's end lies on a sphere about its elbow, moved by the effector's radius. The point is where the three spheres meet.
        let centre = |arm: usize| {
            let (cos, sin) = Delta::direction(arm);
            let out = self.base_mm - self.effector_mm + self.upper_arm_mm * libm::cos(angles[arm]);
            [cos * out, sin * out, -self.upper_arm_mm * libm::sin(angles[arm])]
        };
        let (a, b, c) = (centre(0), centre(1), centre(2));
        let (ab, ac) = (minus(b, a), minus(c, a));
        let across = norm(ab);
        let e1 = times(ab, 1.0 / across);
        let along = dot(e1, ac);
        let rest = minus(ac, times(e1, along));
        let up = norm(rest);
        let e2 = times(rest, 1.0 / up);
        let e3 = [e1[1] * e2[2] - e1[2] * e2[1], e1[2] * e2[0] - e1[0] * e2[2], e1[0] * e2[1] - e1[1] * e2[0]];
        let u = across / 2.0;
        let v = (along * along + up * up - 2.0 * along * u) / (2.0 * up);
        let square = self.forearm_mm * self.forearm_mm - u * u - v * v;
        if square.is_nan() || square < 0.0 {
            return None;
        }
        let down = if e3[2] < 0.0 { square.sqrt() } else { -square.sqrt() };
        Some([0, 1, 2].map(|k| a[k] + u * e1[k] + v * e2[k] + down * e3[k]))
    }

    /// The angle of an arm, rad, as the text of a formula, from those of x, y and z in mm; see [`Delta::angles`].
    #[must_use]
    pub fn formula(&self, arm: usize, [x, y, z]: [&str; 3]) -> String {
        let (cos, sin) = Delta::direction(arm);
        let Delta { base_mm, upper_arm_mm: upper, forearm_mm: forearm, effector_mm } = *self;
        let out = format!("(({cos:?})*({x}) + ({sin:?})*({y}) + ({:?}))", effector_mm - base_mm);
        let aside = format!("(({cos:?})*({y}) - ({sin:?})*({x}))");
        let distance = format!("({out}^2 + ({z})^2)");
        let square = format!("({distance} + {aside}^2 + ({:?}))", upper * upper - forearm * forearm);
        format!("pi/2 + atan({out}/({z})) - acos({square}/({:?}*sqrt({distance})))", 2.0 * upper)
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn norm(a: [f64; 3]) -> f64 {
    dot(a, a).sqrt()
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn times(a: [f64; 3], by: f64) -> [f64; 3] {
    a.map(|a| a * by)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::law::Cursor;
    use crate::{Law, Time};
    use proptest::prelude::*;

    const ROBOT: Delta = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };

    /// Level arms, forearms straight down but for what base and effector differ: by Pythagoras.
    #[test]
    fn level_arms_hold_the_effector_where_pythagoras_says() {
        let z = -(150.0_f64 * 150.0 - (60.0 + 70.0 - 25.0) * (60.0 + 70.0 - 25.0)).sqrt();
        let angles = ROBOT.angles([0.0, 0.0, z]).unwrap();
        assert!(angles.iter().all(|angle| angle.abs() < 1e-12), "{angles:?}");
    }

    #[test]
    fn what_is_out_of_reach_is_told_with_its_limit() {
        let say = |point| ROBOT.angles(point).unwrap_err().to_string();
        assert_eq!(say([0.0, 0.0, 1.0]), "z must be less than 0: below the motors' shafts");
        assert_eq!(say([0.0, 200.0, -50.0]), "its joint is 200.0 mm aside of the arm, limit 150.0 mm (the forearm)");
        assert_eq!(say([0.0, 0.0, -40.0]), "its joint is 53.2 mm from the shaft, limits 80.0 to 220.0 mm");
        assert_eq!(ROBOT.angles([0.0, 0.0, f64::NAN]), Err(OutOfReach::Above));
    }

    proptest! {
        #[test]
        fn forward_undoes_inverse(x in -60.0_f64..60.0, y in -60.0_f64..60.0, z in -190.0_f64..-90.0) {
            let Ok(angles) = ROBOT.angles([x, y, z]) else { return Ok(()) };
            let back = ROBOT.point(angles).unwrap();
            for (got, wanted) in back.into_iter().zip([x, y, z]) {
                // Near a stretched arm angles say little of the point.
                prop_assert!((got - wanted).abs() < 1e-6, "{back:?}");
            }
            // Each forearm is as long as it is, whatever the equations: elbow to joint.
            for (arm, angle) in angles.into_iter().enumerate() {
                let (cos, sin) = Delta::direction(arm);
                let out = 60.0 + 70.0 * angle.cos();
                let elbow = [cos * out, sin * out, -70.0 * angle.sin()];
                let joint = [x + 25.0 * cos, y + 25.0 * sin, z];
                prop_assert!((norm(minus(elbow, joint)) - 150.0).abs() < 1e-9);
            }
        }

        #[test]
        fn the_formula_says_the_same(x in -40.0_f64..40.0, y in -40.0_f64..40.0, z in -160.0_f64..-120.0) {
            let angles = ROBOT.angles([x, y, z]).unwrap();
            for (arm, angle) in angles.into_iter().enumerate() {
                let texts = [format!("{x:?} + 0*t"), format!("{y:?}"), format!("{z:?}")];
                let text = ROBOT.formula(arm, [&texts[0], &texts[1], &texts[2]]);
                let law = Law::formula(&text, &[], 1.0, Some(Time::SECOND)).unwrap();
                let got = Cursor::new(&law).at(Time::ZERO).unwrap().position;
                prop_assert!((got - angle).abs() < 1e-12, "arm {arm}: {got} and {angle}");
            }
        }
    }
}
