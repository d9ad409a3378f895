//! The joint of a delta robot's arm: its angle from the coordinates of the effector, as a curve.
//!
//! The coordinates may be any curves. Taylor coefficients of the angle follow from theirs by the recurrences of formulas, and enclosures of all
//! coefficients over a window of time from enclosures of theirs.

use super::Curve;
use super::curve::{Bounds, Jet};
use super::double::{Double, ULP};
use super::formula::scalar::{Enclosed, Scalar};
use super::formula::series::{self, Series};
use crate::machine::Delta;
use std::sync::Arc;

/// The joint of one arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    robot: Delta,
    arm: usize,
    steps_per_rad: f64,
    constants: Constants,
}

/// The numbers in an arm's equation, as they are in the text of its formula, so that both give the same angle.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Constants {
    /// Cosine and sine of the arm's direction.
    cos: Double,
    sin: Double,
    /// How much closer to the axis the effector's joint is than the shaft, mm; negative if the effector is smaller than the base.
    out_mm: Double,
    /// upper² − forearm², mm².
    lengths_mm2: Double,
    /// Twice the upper arm, mm.
    twice_mm: Double,
}

impl Joint {
    /// Arm 0, 1 or 2 of a robot.
    #[must_use]
    pub fn new(robot: Delta, arm: usize, steps_per_rad: f64) -> Joint {
        let decimal = |x: f64| {
            let size = Double::decimal(&format!("{:?}", x.abs())).unwrap_or(Double::from(x.abs()));
            size * Double::from(x.signum())
        };
        let (cos, sin) = Delta::direction(arm);
        let Delta { base_mm, upper_arm_mm: upper, forearm_mm: forearm, effector_mm } = robot;
        let constants = Constants {
            cos: decimal(cos),
            sin: decimal(sin),
            out_mm: decimal(effector_mm - base_mm),
            lengths_mm2: decimal(upper * upper - forearm * forearm),
            twice_mm: decimal(2.0 * upper),
        };
        Joint { robot, arm, steps_per_rad, constants }
    }

    /// Which arm of its robot it is.
    #[must_use]
    pub fn arm(&self) -> usize {
        self.arm
    }

    /// Steps of its motor in a radian.
    #[must_use]
    pub fn steps_per_rad(&self) -> f64 {
        self.steps_per_rad
    }

    /// The position of the arm's motor, its speed and its acceleration, from those of the effector's coordinates in mm.
    ///
    /// They are no numbers where the arm does not reach.
    ///
    /// ```
    /// use pulsetrain_motion::{law::Joint, machine::Delta};
    /// let robot = Delta { base_mm: 60.0, upper_arm_mm: 70.0, forearm_mm: 150.0, effector_mm: 25.0 };
    /// let [position, speed, _] = Joint::new(robot, 0, 500.0).motion([[20.0, 1.0, 0.0], [-10.0, 0.0, 0.0], [-140.0, 0.0, 0.0]]);
    /// assert!((position - 500.0 * robot.angles([20.0, -10.0, -140.0])?[0]).abs() < 1e-9);
    /// let ahead = robot.angles([20.001, -10.0, -140.0])?[0] - robot.angles([19.999, -10.0, -140.0])?[0];
    /// assert!((speed - 500.0 * ahead / 0.002).abs() < 1e-3);
    /// # Ok::<(), pulsetrain_motion::machine::OutOfReach>(())
    /// ```
    #[must_use]
    pub fn motion(&self, tip: [[f64; 3]; 3]) -> [f64; 3] {
        let [position, speed, half] =
            self.steps(&tip.map(|[position, speed, acceleration]| [position, speed, 0.5 * acceleration]));
        [position, speed, 2.0 * half]
    }

    /// The motor's position, steps, from the effector's coordinates, mm: see [`Delta::angles`].
    pub(super) fn steps<S: Scalar, const N: usize>(&self, [x, y, z]: &[Series<S, N>; 3]) -> Series<S, N> {
        let [cos, sin] = [self.constants.cos, self.constants.sin].map(S::constant);
        let plus = |a: &Series<S, N>, b: &Series<S, N>| -> Series<S, N> { std::array::from_fn(|k| a[k] + b[k]) };
        let raised = |mut a: Series<S, N>, by: Double| {
            a[0] = a[0] + S::constant(by);
            a
        };
        let out: Series<S, N> = raised(std::array::from_fn(|k| cos * x[k] + sin * y[k]), self.constants.out_mm);
        let aside: Series<S, N> = std::array::from_fn(|k| cos * y[k] - sin * x[k]);
        let distance = plus(&series::whole_power(&out, 2), &series::whole_power(z, 2));
        let square = raised(plus(&distance, &series::whole_power(&aside, 2)), self.constants.lengths_mm2);
        let twice = S::constant(self.constants.twice_mm);
        let product = series::sqrt(&distance).map(|c| twice * c);
        // π/2 + atan − acos.
        let angle = plus(&series::atan(&series::divide(&out, z)), &series::asin(&series::divide(&square, &product)));
        let scale = S::constant(Double::from(self.steps_per_rad));
        angle.map(|c| scale * c)
    }

    /// Where the effector is when the motors of a robot's three arms have these positions, mm.
    pub(super) fn point(joints: &[Joint; 3], steps: [f64; 3]) -> Option<[f64; 3]> {
        let robot = joints[0].robot;
        if joints.iter().enumerate().any(|(arm, joint)| joint.robot != robot || joint.arm != arm) {
            return None;
        }
        let point = robot.point([0, 1, 2].map(|k| steps[k] / joints[k].steps_per_rad))?;
        point.iter().all(|at| at.is_finite()).then_some(point)
    }

    /// Why the arm has no angle there.
    pub(super) fn complaint(&self, point: [f64; 3]) -> String {
        let [x, y, z] = point;
        let why = match self.robot.angles(point) {
            Err(error) => error.to_string(),
            Ok(_) => "it is at the limit of what the arms reach".to_owned(),
        };
        format!("the effector cannot be at ({x:.3}, {y:.3}, {z:.3}) mm: {why}")
    }
}

/// The position of an arm's motor in a window of time: factor·joint(u + later) + offset.
#[derive(Clone, Debug)]
pub struct JointCurve {
    shared: Arc<JointWindow>,
    factor: f64,
    offset: f64,
    later: f64,
}

impl PartialEq for JointCurve {
    /// Windows that were made apart are not compared: they count as different.
    fn eq(&self, other: &JointCurve) -> bool {
        let numbers = |curve: &JointCurve| [curve.factor, curve.offset, curve.later];
        Arc::ptr_eq(&self.shared, &other.shared) && numbers(self) == numbers(other)
    }
}

#[derive(Debug)]
struct JointWindow {
    joint: Joint,
    /// The coordinates, mm.
    tip: Arc<[Curve; 3]>,
    bounds: Bounds,
    majorant: Jet,
}

/// How much larger than what is met at three points the bounds of high derivatives may be.
const LOOSEST: f64 = 16.0;
/// What a high derivative may amount to over the window, steps, for its bound not to matter.
const NEGLIGIBLE_STEPS: f64 = 1e-9;

impl JointCurve {
    /// The joint from `a` to `b` of the time of its coordinates. `None` if the enclosures there are too wide to plan with, or if the arm does
    /// not reach.
    pub(super) fn new(joint: Joint, tip: &Arc<[Curve; 3]>, a: f64, b: f64) -> Option<JointCurve> {
        // What a sum is off that moves the window's zero.
        let off = 4.0 * ULP * a.abs().max(b.abs());
        let enclosures = tip.each_ref().map(|curve| enclosed(curve, a - off, b + off, off));
        let hull = joint.steps(&enclosures);
        if !hull.iter().all(|c| c.is_sound()) || hull[0].magnitude() > super::FARTHEST {
            return None;
        }
        let (eighth, seventh) = (hull[8].magnitude(), hull[7].magnitude());
        let met =
            [a, 0.5 * (a + b), b].into_iter().fold(0.0, |most: f64, u| most.max(joint.taylor::<8>(tip, u)[7].abs()));
        let length = b - a;
        let is_loose = |c: f64, order: i32| c * libm::pow(length, f64::from(order)) > NEGLIGIBLE_STEPS;
        // 8 times the eighth coefficient is the slope of the seventh: by that much it may change in half of the window.
        if (seventh > LOOSEST * met && is_loose(seventh, 7))
            || (4.0 * eighth * length > LOOSEST * met && is_loose(eighth, 8))
        {
            return None;
        }
        let bounds = Bounds { eighth, rounding: std::array::from_fn(|k| hull[k].error) };
        let majorant = std::array::from_fn(|k| hull[k].magnitude());
        let shared = Arc::new(JointWindow { joint, tip: Arc::clone(tip), bounds, majorant });
        Some(JointCurve { shared, factor: 1.0, offset: 0.0, later: 0.0 })
    }

    pub(super) fn value(&self, u: f64) -> f64 {
        let JointWindow { joint, tip, .. } = &*self.shared;
        let at = tip.each_ref().map(|curve| [curve.value(u + self.later)]);
        let [steps] = joint.steps(&at);
        self.factor * steps + self.offset
    }

    /// The first N Taylor coefficients.
    pub(super) fn taylor<const N: usize>(&self, u: f64) -> [f64; N] {
        let mut jet = self.shared.joint.taylor(&self.shared.tip, u + self.later);
        jet.iter_mut().for_each(|c| *c *= self.factor);
        jet[0] += self.offset;
        jet
    }

    /// What holds on the whole window.
    pub(super) fn bounds_and_majorant(&self) -> (Bounds, Jet) {
        self.shared.bounds.scaled(self.shared.majorant, self.factor, self.offset)
    }

    pub(super) fn raise(&mut self, steps: Double) {
        self.offset = (Double::from(self.offset) + steps).nearest();
    }

    pub(super) fn scale(&mut self, by: f64) {
        self.factor *= by;
        self.offset *= by;
    }

    pub(super) fn rezero(&mut self, by: Double) {
        self.later = (Double::from(self.later) + by).nearest();
    }
}

impl Joint {
    fn taylor<const N: usize>(&self, tip: &[Curve; 3], u: f64) -> [f64; N] {
        self.steps(&tip.each_ref().map(|curve| curve.taylor(u)))
    }
}

/// The Taylor coefficients of a curve anywhere in `a..=b`, the last one being that of the eighth power; each jet is taken at a time that may be
/// `off` by rounding.
fn enclosed(curve: &Curve, a: f64, b: f64, off: f64) -> Series<Enclosed, 9> {
    let (bounds, majorant) = curve.bounds_and_majorant(a, b);
    let middle = 0.5 * (a + b);
    let reach = (middle - a).max(b - middle) * (1.0 + 4.0 * ULP);
    let about = curve.jet(middle);
    let most = |k: usize| if k < 8 { majorant[k] } else { bounds.eighth };
    let is_constant = curve.is_constant();
    std::array::from_fn(|k| {
        if is_constant && k > 0 {
            return Enclosed::exact(0.0);
        }
        if k == 8 {
            return Enclosed::new(-bounds.eighth, bounds.eighth, 0.0);
        }
        // Σ C(i, k) c_i x^(i − k), by Horner's rule for its size; the eighth term is the remainder.
        let size = |i: usize| if i < 8 { about[i].abs() + bounds.rounding[i] } else { bounds.eighth };
        let (mut spread, mut choose) = (0.0, 1.0);
        let mut power = 1.0;
        for i in k + 1..=8 {
            choose *= i as f64 / (i - k) as f64;
            power *= reach;
            spread += choose * size(i) * power;
        }
        spread = (spread + bounds.rounding[k]) * (1.0 + 64.0 * ULP) + 4.0 * ULP * about[k].abs();
        if !spread.is_finite() {
            return Enclosed::new(f64::NAN, f64::NAN, f64::NAN);
        }
        let (low, high) = ((about[k] - spread).max(-most(k)), (about[k] + spread).min(most(k)));
        Enclosed::new(low, high, bounds.rounding[k] + (k + 1) as f64 * most(k + 1) * off * (1.0 + 8.0 * ULP))
    })
}
