//! Changes on virtual boards: firmware on an emulated chip.

use super::*;
use pulsetrain_board::{BoardKind, Edge};
use pulsetrain_motion::file;
use pulsetrain_session::control::{Command, Event};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::Prepared;

/// Random numbers: Knuth's generator of 64 bits.
struct Random(u64);

impl Random {
    fn between(&mut self, least: f64, most: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        least + (most - least) * (self.0 >> 40) as f64 / (1u64 << 24) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        (self.between(0.0, end as f64) as usize).min(end - 1)
    }
}

/// Motors that swing, as a motion file has them: each with its swing in steps, and its frequency in Hz.
fn swings(board: &str, limits: (f64, f64), values: &[(f64, f64)]) -> Prepared {
    let mut text = format!("board = \"{board}\"\ntolerance = \"2 us\"\n");
    for (motor, (steps, hz)) in values.iter().enumerate() {
        // The Uno's four motors are those of a CNC shield, the Pico's follow one another.
        let (step, dir) =
            if board == "pico" { (2 + 2 * motor, 3 + 2 * motor) } else { [(2, 5), (3, 6), (4, 7), (12, 13)][motor] };
        text += &format!(
            "[motor.m{motor}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\nforward = \"high\"\n\
             pins = {{ step = {step}, dir = {dir} }}\nmax_speed = \"{} step/s\"\nmax_acceleration = \"{} step/s^2\"\n\
             [[motion]]\nmotor = \"m{motor}\"\nlaw.sweep = {{ frequency = \"{hz} Hz\", swing = \"{steps:.0} step\" }}\n",
            limits.0, limits.1
        );
    }
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let contents = file::read_contents(&text, "swings.toml", &no_files).expect("it is a motion file");
    Prepared::new("swings.toml".to_owned(), contents, None).expect("it fits the board")
}

fn probe(name: &str, board: &str, limits: (f64, f64), peaks: &[(f64, f64)], seed: u64, long_s: f64) {
    let mut random = Random(seed);
    let mut values = peaks.to_vec();
    let kind = BoardKind::named(board).unwrap();
    let mut first = swings(board, limits, &values);
    if let Err(e) = first.prove_first(|_| {}) { eprintln!("{name}: refused {e:?}"); return }
    let mut driven = Driven::on_virtual(kind, &first, kind.usual_baud()).unwrap().staying();
    let hz = first.program.board.tick_hz as f64;
    let (mut due_s, mut at_s) = (1.0, 0.0);
    let mut lat: Vec<(f64, f64, f64)> = vec![];
    let mut asked: Option<f64> = None;
    let mut until: Vec<f64> = vec![];
    let mut wall = 0.0_f64;
    loop {
        let stop = (at_s > long_s).then_some(Command::Stop);
        let step = driven.step(stop, &mut |_: Edge| {}, |event| {
            if let Event::Progress { at_s: now_s } = event { at_s = now_s; }
        });
        match step { Err(e) => { eprintln!("{name}: {e} at {at_s} after {} changes", lat.len()); return }, Ok(Some(_)) => break, Ok(None) => {} }
        if at_s < due_s || stop.is_some() { continue; }
        if asked.is_none() {
            let motor = random.below(values.len());
            values[motor] = (peaks[motor].0 * random.between(0.3, 1.0), peaks[motor].1);
        }
        let program = Arc::new(swings(board, limits, &values).program);
        let change = Change { program, over: None, begins: Begins::WithTheMotion };
        let before = driven.now();
        let first_s = *asked.get_or_insert(at_s);
        let t = std::time::Instant::now();
        let r = driven.change_to(&change);
        wall = wall.max(t.elapsed().as_secs_f64());
        match r {
            Ok((from_s, until_s)) => {
                lat.push((from_s - at_s, (driven.now() - before) as f64 / hz, at_s - first_s));
                asked = None;
                until.push(until_s);
                due_s = at_s + random.between(0.0, 0.8);
            }
            Err(SessionError::Waiting { at, until: u }) => {
                let under = until.iter().filter(|u| **u > at_s).count();
                eprintln!("  {name}: waiting at {at_s:.3}, {under} under way, at {} until {}", at as f64 / hz - at_s, u as f64/hz - at_s);
                if under >= 2 { asked = None; due_s = until.iter().copied().filter(|u| *u > at_s).fold(f64::MAX, f64::min); }
            }
            Err(error) => { eprintln!("{name}: change {error} at {at_s}"); asked = None; due_s = at_s + 0.1; }
        }
    }
    lat.sort_by(|a, b| a.0.total_cmp(&b.0));
    let n = lat.len();
    if n == 0 { return }
    eprintln!("{name}: n {n} median {:.4} max {:?} p90 {:?} waited {:.4} wall {wall:.4}", lat[n/2].0, lat[n-1], lat[n*9/10], lat.iter().map(|l| l.2).fold(0.0, f64::max));
}

#[test]
fn probes() {
    let which = std::env::var("WHICH").unwrap_or_default();
    let long = 6.0;
    let go = |name: &str, board: &str, limits, peaks: &[(f64, f64)]| {
        if name.starts_with(&which) { probe(name, board, limits, peaks, 1, long) }
    };
    go("uno3", "uno", (32000.0, 192000.0), &[(1600.0, 0.5), (800.0, 1.0), (320.0, 2.0)]);
    for rate in [2000.0, 5000.0, 8000.0, 12000.0, 16000.0, 20000.0] {
        for f in [1.0, 5.0, 15.0] {
            let swing = rate / (std::f64::consts::PI * f);
            go(&format!("uno4-{rate}-{f}"), "uno", (rate * 1.3, rate * 1.5 * 6.28 * f), &[(swing, f); 4]);
        }
    }
    for rate in [50000.0, 100000.0, 140000.0] {
        for f in [0.5, 2.0, 5.0] {
            let swing = rate / (std::f64::consts::PI * f);
            go(&format!("uno1-{rate}-{f}"), "uno", (rate * 1.05, rate * 1.5 * 6.28 * f), &[(swing, f); 1]);
        }
    }
    go("unoslow", "uno", (32000.0, 192000.0), &[(32.0, 0.1), (1600.0, 0.5)]);
    go("pico3", "pico", (32000.0, 192000.0), &[(1600.0, 0.5), (800.0, 1.0), (320.0, 2.0)]);
    for rate in [50000.0, 100000.0, 200000.0] {
        for f in [1.0, 5.0] {
            let swing = rate / (std::f64::consts::PI * f);
            go(&format!("pico4-{rate}-{f}"), "pico", (rate * 1.3, rate * 1.5 * 6.28 * f), &[(swing, f); 4]);
        }
    }
    go("picoslow", "pico", (32000.0, 192000.0), &[(32.0, 0.1), (1600.0, 0.5)]);
}
