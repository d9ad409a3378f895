//! Laws for changing a motion while the motor moves.

use pulsetrain_motion::{Law, Time};
use pulsetrain_session::MotorState;

/// Brakes from `state`, and then does `law`.
pub(crate) fn onward(state: MotorState, law: &Law, braking: f64) -> Law {
    let law = law.clone();
    if state.speed.abs() < 1e-3 {
        return law.shifted(state.theta).unwrap();
    }
    let seconds = state.speed.abs() / braking;
    let curve = vec![state.theta, state.speed, -0.5 * braking.copysign(state.speed)];
    let brake = Law::polynomials([(Time::from_seconds(seconds), curve)]).unwrap();
    Law::then(vec![brake, law]).unwrap()
}
