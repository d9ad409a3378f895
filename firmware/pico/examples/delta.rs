//! A delta robot that picks and places without a host: three ULN2003 motors, on GPIO 2 to 5, 6 to 9 and 10 to 13. It uses
//! moves only.
//!
//! Arms hang from a base, at 120° from each other, each turned by a motor; rods connect them to the effector. The position of the
//! effector determines the angles of the arms; each of its ways is three moves that begin and end together.
#![no_std]
#![no_main]

use core::sync::atomic::{AtomicU32, Ordering};
use libm::{atan2f, cosf, roundf, sinf, sqrtf};
use pulsetrain_pico::motors::{Heading, MotorSetup, Motors, Sequence, TICKS_PER_S, Times, Verb, block_on};

/// Geometry, mm: from the base's middle to the motors' axes; arms; rods; from the effector's middle to the rods.
const BASE: f32 = 40.0;
const ARM: f32 = 70.0;
const ROD: f32 = 160.0;
const EFFECTOR: f32 = 20.0;

/// Half steps of a turn of the motor.
const TURN: f32 = 4096.0;

/// The shortest period, ticks: 800 half steps/s.
const PERIOD: u32 = TICKS_PER_S / 800;

/// Where the effector goes, mm: over the part, down to it, up again, over its place, down, up.
const WAY: [[f32; 3]; 6] = [
    [40.0, 0.0, -150.0],
    [40.0, 0.0, -170.0],
    [40.0, 0.0, -150.0],
    [-30.0, 30.0, -150.0],
    [-30.0, 30.0, -170.0],
    [-30.0, 30.0, -150.0],
];

/// Moves that are done, counted in the interrupt.
static DONE: AtomicU32 = AtomicU32::new(0);

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let wiring = [2, 6, 10].map(|pin| MotorSetup::coils_on(pin, Sequence::Half));
    // SAFETY: once, and nothing else is set up.
    let Ok(motors) = (unsafe { Motors::begin(&wiring, Times::default()) }) else { panic!() };
    motors.on_done(|_, _| DONE.store(DONE.load(Ordering::Relaxed) + 1, Ordering::Relaxed));
    // The arms are level at first.
    let (mut stand, mut moves) = ([0_i32; 3], 0);
    for point in WAY.iter().cycle() {
        // Points out of reach are left out.
        let Some(target) = steps(*point) else { continue };
        let way = [0, 1, 2].map(|arm| target[arm] - stand[arm]);
        let longest = way.iter().map(|way| way.unsigned_abs()).max().unwrap_or(0);
        for (arm, way) in (0..).zip(way) {
            let heading = if way < 0 { Heading::Backward } else { Heading::Forward };
            // The shorter an arm's way, the longer its period, so that all arrive together.
            let ticks = u64::from(longest) * u64::from(PERIOD) / u64::from(way.unsigned_abs().max(1));
            // It cannot be refused: the motors rest, and the period is longer than the shortest.
            let _ = motors.tell(&[(arm, Verb::Heading(heading)), (arm, Verb::Speed { ticks })]);
        }
        let [a, b, c] = way.map(|way| Verb::Move { steps: way.unsigned_abs() });
        let _ = motors.tell(&[(0, a), (1, b), (2, c)]);
        for motor in (0..3).filter_map(|number| motors.motor(number)) {
            if block_on(motor.rests()).is_err() {
                // The motors stopped on the way: the effector is somewhere else.
                panic!();
            }
        }
        stand = target;
        moves += 3;
        // Each way is three moves, even if an arm does not turn.
        if DONE.load(Ordering::Relaxed) != moves {
            panic!();
        }
    }
    panic!()
}

/// Half steps of the arms, down from level, for the effector at a point; `None` if that is out of reach.
fn steps([x, y, z]: [f32; 3]) -> Option<[i32; 3]> {
    let mut steps = [0; 3];
    for (arm, place) in (0..).zip(&mut steps) {
        // As the first arm sees it.
        let turn = arm as f32 * core::f32::consts::TAU / 3.0;
        let (sine, cosine) = (sinf(turn), cosf(turn));
        let angle = angle([x * cosine + y * sine, y * cosine - x * sine, z])?;
        *place = roundf(angle / core::f32::consts::TAU * TURN) as i32;
    }
    Some(steps)
}

/// How far the first arm, in the plane y = 0, is turned down from level, rad: its end is on a circle around the axis, and a rod
/// away from the effector.
fn angle([x, y, z]: [f32; 3]) -> Option<f32> {
    // From the axis to the rod's lower end: to the right, and down.
    let (right, down) = (x + EFFECTOR - BASE, -z);
    // ARM (right cos α + down sin α) = half: the rod's length, seen from the axis.
    let half = (right * right + y * y + down * down + ARM * ARM - ROD * ROD) / 2.0;
    let reach = ARM * sqrtf(right * right + down * down);
    let ratio = half / reach;
    if !(-1.0..=1.0).contains(&ratio) {
        return None;
    }
    // Of the two ways the one with the arm outward.
    let spread = atan2f(sqrtf(1.0 - ratio * ratio), ratio);
    Some(atan2f(down, right) - spread)
}
