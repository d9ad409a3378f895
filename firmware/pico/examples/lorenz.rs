//! Draws the Lorenz attractor, x to the right and z up, with two ULN2003 motors on GPIO 2 to 5 and 6 to 9, without a host: as seed 002
//! does it on an Etch-a-Sketch.
//!
//! 50 times a second the equations give the speeds of x and z, in floating point that this processor has no unit for; what is drawn
//! is their integral. `cargo xtask bench verbs` says what it takes.
#![no_std]
#![no_main]

use pulsetrain_pico::motors::{Course, MotorSetup, Motors, Sequence, TICKS_PER_S, Times, Verb};

/// How often speeds are set, Hz.
const RATE_HZ: u32 = 50;

/// The equations' time in a second, and their parameters.
const PACE: f32 = 0.25;
const SIGMA: f32 = 10.0;
const RHO: f32 = 28.0;
const BETA: f32 = 8.0 / 3.0;

/// Half steps for a unit.
const SCALE: f32 = 12.0;

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let wiring = [2, 6].map(|pin| MotorSetup::coils_on(pin, Sequence::Half));
    // SAFETY: once, and nothing else is set up.
    let Ok(motors) = (unsafe { Motors::begin(&wiring, Times::default()) }) else { panic!() };
    let [mut x, mut y, mut z] = [-1.0_f32, 0.1, 25.0];
    let step = PACE / RATE_HZ as f32;
    let mut next = motors.now();
    let _ = motors.tell(&[(0, Verb::Run), (1, Verb::Run)]);
    loop {
        let rates = [SIGMA * (y - x), x * (RHO - z) - y, x * y - BETA * z];
        let (right, up) = (verbs(rates[0]), verbs(rates[2]));
        // Periods of speeds that the motors have are not refused: they stopped, and what is drawn is not what it ought to be.
        if motors.tell(&[(0, right.0), (0, right.1), (1, up.0), (1, up.1)]).is_err() {
            panic!();
        }
        [x, y, z] = [x + step * rates[0], y + step * rates[1], z + step * rates[2]];
        next += u64::from(TICKS_PER_S / RATE_HZ);
        motors.sleep_until(next);
    }
}

/// A rate of change, units in the equations' time: which way, and the wait from step to step.
fn verbs(rate: f32) -> (Verb, Verb) {
    let course = if rate < 0.0 { Course::Backward } else { Course::Forward };
    let speed = (rate * PACE * SCALE).abs();
    // From a step in ten seconds on; slower ones are as slow as that.
    (Verb::Course(course), Verb::Speed { ticks: (TICKS_PER_S as f32 / speed.max(0.1)) as u64 })
}
