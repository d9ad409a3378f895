//! Runs the examples of the Pico's library on the emulated chip, without a host: how exactly they draw, and their processor load.

use pulsetrain_board::virtual_pico::{CYCLES_PER_S, VirtualPico};
use pulsetrain_board::{Edge, Port};
use pulsetrain_core::output::HALF_STEPS;
use std::time::Duration;

const DDS_CIRCLE: &[u8] = include_bytes!("../../board/images/dds_circle.uf2");
const LORENZ: &[u8] = include_bytes!("../../board/images/lorenz.uf2");
const DELTA: &[u8] = include_bytes!("../../board/images/delta.uf2");

/// An example that ran for some seconds. The coils of its motors are on pins 2 to 5, 6 to 9 and 10 to 13.
pub struct Ran {
    pub pico: VirtualPico,
    /// Each half step: its tick, and the positions of all motors then.
    pub steps: Vec<(u64, [i32; 3])>,
    /// The part of the processor's time that it was awake, 0 to 1, without the first 0.1 s.
    pub load: f64,
    /// The largest distance from what it should draw, half steps.
    pub error: f64,
}

fn run(image: &[u8], seconds: u64) -> Ran {
    let mut pico = VirtualPico::with_image(image).expect("it runs");
    let pass = |pico: &mut VirtualPico, ms: u64| {
        let until = pico.now() + Duration::from_millis(ms);
        while pico.now() < until {
            pico.receive(until, &mut Vec::new()).expect("a virtual port");
        }
    };
    pass(&mut pico, 100);
    let asleep = pico.chip().asleep_cycles();
    pass(&mut pico, seconds * 1000 - 100);
    let slept = (pico.chip().asleep_cycles() - asleep) as f64;
    let load = 1.0 - slept / (CYCLES_PER_S as f64 * (seconds as f64 - 0.1));
    let mut edges = Vec::new();
    pico.edges(&mut edges);
    assert_eq!(pico.chip().fault(), None);
    Ran { steps: steps(&edges), pico, load, error: 0.0 }
}

/// The half steps of coils, from their patterns: each pattern is one half step from the one before.
fn steps(edges: &[Edge]) -> Vec<(u64, [i32; 3])> {
    let (mut steps, mut levels, mut positions) = (Vec::new(), [0_u8; 3], [0_i32; 3]);
    for together in edges.chunk_by(|a, b| a.tick == b.tick) {
        let mut moved = false;
        for motor in 0..3_u8 {
            let index = usize::from(motor);
            let before = levels[index];
            for edge in together {
                let line = edge.line.wrapping_sub(2 + 4 * motor);
                if line < 4 {
                    levels[index] = levels[index] & !(1 << line) | u8::from(edge.level) << line;
                }
            }
            if levels[index] == before {
                continue;
            }
            let phase = HALF_STEPS.iter().position(|pattern| *pattern == levels[index]).expect("a pattern") as i32;
            let by = (phase - positions[index]).rem_euclid(8);
            assert!(matches!(by, 1 | 7), "a half step forward or backward at tick {}", together[0].tick);
            positions[index] += if by == 1 { 1 } else { -1 };
            moved = true;
        }
        if moved {
            steps.push((together[0].tick, positions));
        }
    }
    steps
}

/// Runs the circles: a radius of 400 half steps, and 8 s for each circle.
pub fn dds_circle(seconds: u64) -> Ran {
    let mut ran = run(DDS_CIRCLE, seconds);
    let radius = 400.0;
    for (_, [x, y, _]) in &ran.steps {
        // The drawing begins at the left of the circle.
        let off = (f64::from(*x) - radius).hypot(f64::from(*y)) - radius;
        ran.error = ran.error.max(off.abs());
    }
    ran
}

/// The positions after `count` integration steps of the example, with the example's own arithmetic.
fn lorenz(count: u32) -> [f64; 2] {
    let [mut x, mut y, mut z] = [-1.0_f32, 0.1, 25.0];
    let step = 0.25 / 50.0_f32;
    for _ in 0..count {
        let rates = [10.0 * (y - x), x * (28.0 - z) - y, x * y - 8.0 / 3.0 * z];
        [x, y, z] = [x + step * rates[0], y + step * rates[1], z + step * rates[2]];
    }
    [12.0 * f64::from(x + 1.0), 12.0 * f64::from(z - 25.0)]
}

/// Runs the Lorenz attractor, and compares it with the example's own arithmetic.
pub fn lorenz_attractor(seconds: u64) -> Ran {
    let mut ran = run(LORENZ, seconds);
    for tick in 1..50 * (seconds as u32 - 1) {
        let at = u64::from(tick) * CYCLES_PER_S / 50 + 300_000;
        let last = ran.steps.partition_point(|(step, _)| *step <= at);
        let Some((_, [x, z, _])) = last.checked_sub(1).map(|last| ran.steps[last]) else { continue };
        for (is, ought) in [x, z].into_iter().zip(lorenz(tick)) {
            ran.error = ran.error.max((f64::from(is) - ought).abs());
        }
    }
    ran
}

/// The arms of the example's robot for a point, half steps. They are found by bisection, to check the example's formula.
fn arms([x, y, z]: [f64; 3]) -> [i32; 3] {
    [0, 1, 2].map(|arm| {
        let (sine, cosine) = (f64::from(arm) * std::f64::consts::TAU / 3.0).sin_cos();
        let (x, y) = (x * cosine + y * sine, y * cosine - x * sine);
        // By how much the distance from the arm's end to the effector's joint exceeds the rod's length.
        let excess = |angle: f64| {
            let end = [40.0 + 70.0 * angle.cos(), -70.0 * angle.sin()];
            ((x + 20.0 - end[0]).powi(2) + y * y + (z - end[1]).powi(2)).sqrt() - 160.0
        };
        // The arm points outward: searched from as far up as the rod reaches, down to where the arm hangs.
        let (mut up, mut down) = (-1.5, 1.5);
        assert!(excess(up) > 0.0 && excess(down) < 0.0, "{} {}", excess(up), excess(down));
        for _ in 0..60 {
            let middle = (up + down) / 2.0;
            if excess(middle) > 0.0 { up = middle } else { down = middle }
        }
        (up / std::f64::consts::TAU * 4096.0).round() as i32
    })
}

/// The points that the robot moves to, mm.
const WAY: [[f64; 3]; 6] = [
    [40.0, 0.0, -150.0],
    [40.0, 0.0, -170.0],
    [40.0, 0.0, -150.0],
    [-30.0, 30.0, -150.0],
    [-30.0, 30.0, -170.0],
    [-30.0, 30.0, -150.0],
];

/// Runs the robot. Returns also how many of its points it reached, in order.
pub fn delta(seconds: u64) -> (Ran, usize) {
    let ran = run(DELTA, seconds);
    let mut visited = 0;
    let mut steps = ran.steps.iter().peekable();
    for point in WAY.iter().cycle() {
        let wanted = arms(*point);
        // All arms arrive at the same time.
        let Some((tick, _)) = steps.by_ref().find(|(_, at)| *at == wanted) else { break };
        visited += 1;
        if let Some((next, _)) = steps.peek() {
            let rest = next - tick;
            assert!(rest >= CYCLES_PER_S / 800, "the next way begins after the last step's period: {rest}");
        }
    }
    (ran, visited)
}
