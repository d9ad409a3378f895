//! Draws circles with two ULN2003 motors, on GPIO 2 to 5 and 6 to 9, without a host: direct digital synthesis of their speeds, as
//! the Pico plotter (002) has it.
//!
//! 100 times a second a phase accumulator of 32 bits is incremented. A table of sines has the speeds for its upper bits, a quarter
//! of a turn apart for the two motors, and [`convert`] makes periods of the speeds.
#![no_std]
#![no_main]

use pulsetrain_pico::motors::{Heading, MotorSetup, Motors, Sequence, TICKS_PER_S, Times, Verb};

/// How often speeds are set, Hz.
const RATE_HZ: u32 = 100;

/// The time for a circle, s.
const PERIOD_S: u32 = 8;

/// Its radius, half steps.
const RADIUS: f32 = 400.0;

/// The increment of the accumulator: 2^32 in [`PERIOD_S`].
const INCREMENT: u32 = ((1 << 32) / (RATE_HZ * PERIOD_S) as u64) as u32;

/// The largest speed, half steps/s.
const FASTEST: f32 = RADIUS * 2.0 * core::f32::consts::PI / PERIOD_S as f32;

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let wiring = [2, 6].map(|pin| MotorSetup::coils_on(pin, Sequence::Half));
    // SAFETY: once, and nothing else is set up.
    let Ok(motors) = (unsafe { Motors::begin(&wiring, Times::default()) }) else { panic!() };
    let mut sines = [0.0; 256];
    for (at, sine) in (0..).zip(&mut sines) {
        // The sine in the middle of the phases that share these upper bits.
        *sine = FASTEST * libm::sinf((at as f32 + 0.5) * 2.0 * core::f32::consts::PI / 256.0);
    }
    let speed = |phase: u32| sines[(phase >> 24) as usize];
    // A speed holds until the next one: it is the speed in the middle of that time.
    let (mut phase, mut next) = (INCREMENT / 2, motors.now());
    let _ = motors.tell(&[(0, Verb::Run), (1, Verb::Run)]);
    loop {
        let speeds = [speed(phase), speed(phase.wrapping_add(1 << 30))];
        let [x, y] = speeds.map(|speed| (heading(speed), Verb::Speed { ticks: convert(speed) }));
        // These periods are never too short. So the motors have stopped, and the drawing is wrong.
        if motors.tell(&[(0, x.0), (0, x.1), (1, y.0), (1, y.1)]).is_err() {
            panic!();
        }
        phase = phase.wrapping_add(INCREMENT);
        next += u64::from(TICKS_PER_S / RATE_HZ);
        motors.sleep_until(next);
    }
}

fn heading(speed: f32) -> Verb {
    Verb::Heading(if speed > 0.0 {
        Heading::Forward
    } else if speed < 0.0 {
        Heading::Backward
    } else {
        Heading::Stationary
    })
}

/// The period from step to step at a speed in half steps/s, ticks. It is the inverse: twice the period is half the speed.
fn convert(speed: f32) -> u64 {
    // Speeds below a step in ten seconds are taken for that.
    (TICKS_PER_S as f32 / speed.abs().max(0.1)) as u64
}
