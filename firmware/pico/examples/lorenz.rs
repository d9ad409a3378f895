//! Draws the Lorenz attractor, x to the right and z up, with two ULN2003 motors on GPIO 2 to 5 and 6 to 9, without a host, as the
//! Pico plotter (002) does on an Etch-a-Sketch.
//!
//! 50 times a second the equations give the next target of each motor, in floating point that this processor has no unit for. Each
//! motor gets the speed that brings it to its target from where it is. Speeds alone would not do: a motor makes whole steps, and
//! the part of one that it loses or gains with each new speed would add up. `cargo xtask bench verbs` measures the time that it
//! takes.
#![no_std]
#![no_main]

use pulsetrain_pico::motors::{Heading, MotorSetup, Motors, Sequence, TICKS_PER_S, Times, Verb};

/// How often speeds are set, Hz.
const RATE_HZ: u32 = 50;

/// The time of the equations that passes in a second, and their parameters, which Lorenz chose.
const PACE: f32 = 0.25;
const SIGMA: f32 = 10.0;
const RHO: f32 = 28.0;
const BETA: f32 = 8.0 / 3.0;

/// Half steps for a unit of the equations.
const SCALE: f32 = 12.0;

/// Where it begins: x, y, z.
const BEGIN: [f32; 3] = [-1.0, 0.1, 25.0];

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let wiring = [2, 6].map(|pin| MotorSetup::coils_on(pin, Sequence::Half));
    // SAFETY: once, and nothing else is set up.
    let Ok(motors) = (unsafe { Motors::begin(&wiring, Times::default()) }) else { panic!() };
    let [mut x, mut y, mut z] = BEGIN;
    let step = PACE / RATE_HZ as f32;
    let mut next = motors.now();
    let _ = motors.tell(&[(0, Verb::Run), (1, Verb::Run)]);
    loop {
        let rates = [SIGMA * (y - x), x * (RHO - z) - y, x * y - BETA * z];
        [x, y, z] = [x + step * rates[0], y + step * rates[1], z + step * rates[2]];
        // Without orders `tell` returns the positions at the tick from which orders would take effect.
        let Ok(obeyed) = motors.tell(&[]) else { panic!() };
        let [at_x, at_z, ..] = obeyed.motors() else { panic!() };
        let right = verbs(SCALE * (x - BEGIN[0]) - at_x.position as f32);
        let up = verbs(SCALE * (z - BEGIN[2]) - at_z.position as f32);
        // These periods are never too short. So the motors have stopped, and the drawing is wrong.
        if motors.tell(&[(0, right.0), (0, right.1), (1, up.0), (1, up.1)]).is_err() {
            panic!();
        }
        next += u64::from(TICKS_PER_S / RATE_HZ);
        motors.sleep_until(next);
    }
}

/// Direction and period for so many half steps until speeds are set again. Less than one half step waits until it is one.
fn verbs(steps: f32) -> (Verb, Verb) {
    let heading = if steps >= 1.0 {
        Heading::Forward
    } else if steps <= -1.0 {
        Heading::Backward
    } else {
        Heading::Stationary
    };
    let speed = steps.abs().max(1.0) * RATE_HZ as f32;
    (Verb::Heading(heading), Verb::Speed { ticks: (TICKS_PER_S as f32 / speed) as u64 })
}
