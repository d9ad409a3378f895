//! The promised rates: what `pulsetrain run` reaches on the virtual boards with the committed images.
//!
//! `cargo xtask bench promises` runs them all and writes docs/benchmarks/promises.md. A quick test compares that page,
//! and those that quote it, with [`PROMISES`] and with the images; a test on the emulated chips runs them again.

use super::uno::{COMPARE, PORT_B, Pins, SHIELD, TUTORIAL, pins_text};
use pulsetrain_core::baked::crc32;
use pulsetrain_testkit::folder::Folder;
use serde_json::Value;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A Pico's pins.
const PICO: Pins = &[(2, 3), (4, 5), (6, 7), (8, 9), (10, 11), (12, 13), (14, 15), (16, 17)];

/// The motion that all motors make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Motion {
    /// Up to the rate, some time at the rate, and down again: that time, and the time of each ramp, ms.
    Flat(u32, u32),
    /// A sinusoid of this frequency, Hz, whose fastest speed is the rate.
    Sine(u32),
}

/// A rate that `run` reaches, with motors in phase and with motors apart.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Promise {
    pub(crate) board: &'static str,
    /// A driver of the table, whose pulses are made.
    pub(crate) driver: &'static str,
    /// STEP and DIR of each motor.
    pub(crate) pins: Pins,
    pub(crate) motors: usize,
    pub(crate) motion: Motion,
    /// The rate of each motor, 1000 steps/s.
    pub(crate) rate: f64,
}

/// Times, ms. An emulated Pico takes long for each step.
const UNO_FLAT: Motion = Motion::Flat(750, 125);
const PICO_FLAT: Motion = Motion::Flat(150, 100);
/// How long sinusoids last, s.
const SINE_S: f64 = 1.0;
const PICO_SINE_S: f64 = 0.2;

const fn uno(pins: Pins, motors: usize, motion: Motion, rate: f64) -> Promise {
    Promise { board: "uno", driver: "A4988", pins, motors, motion, rate }
}

const fn pico(driver: &'static str, motors: usize, motion: Motion, rate: f64) -> Promise {
    Promise { board: "pico", driver, pins: PICO, motors, motion, rate }
}

/// All that is promised about rates.
pub(crate) const PROMISES: [Promise; 22] = [
    uno(TUTORIAL, 1, UNO_FLAT, 156.0),
    uno(COMPARE, 1, UNO_FLAT, 156.0),
    uno(SHIELD, 2, UNO_FLAT, 75.0),
    uno(COMPARE, 2, UNO_FLAT, 76.0),
    uno(SHIELD, 3, UNO_FLAT, 36.0),
    uno(PORT_B, 3, UNO_FLAT, 36.0),
    uno(SHIELD, 4, UNO_FLAT, 25.0),
    uno(TUTORIAL, 1, Motion::Sine(15), 156.0),
    uno(SHIELD, 2, Motion::Sine(15), 76.0),
    uno(SHIELD, 3, Motion::Sine(15), 36.0),
    uno(SHIELD, 4, Motion::Sine(15), 20.0),
    uno(TUTORIAL, 1, Motion::Sine(35), 156.0),
    uno(SHIELD, 2, Motion::Sine(35), 76.0),
    uno(SHIELD, 3, Motion::Sine(35), 9.5),
    uno(SHIELD, 4, Motion::Sine(35), 2.5),
    pico("TMC2209", 1, PICO_FLAT, 4440.0),
    pico("TMC2209", 4, PICO_FLAT, 1600.0),
    pico("TMC2209", 8, PICO_FLAT, 730.0),
    pico("A4988", 8, PICO_FLAT, 480.0),
    pico("TMC2209", 1, Motion::Sine(30), 4440.0),
    pico("TMC2209", 4, Motion::Sine(30), 1570.0),
    pico("TMC2209", 8, Motion::Sine(30), 250.0),
];

/// A promise that was run.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Run {
    /// Steps of all motors.
    pub(crate) steps: u64,
    /// Largest |edge − scheduled| beyond the constant, µs.
    pub(crate) late_us: f64,
    /// The fault. Empty if the promise is kept.
    pub(crate) fault: String,
}

impl Promise {
    /// The motion file, with the default tolerance. Motors that are apart begin at equal distances within a step or within
    /// half a period.
    fn file(&self, apart: bool) -> String {
        let rate = 1e3 * self.rate;
        let (law, spread_s) = match self.motion {
            Motion::Flat(flat_ms, ramp_ms) => {
                let (flat_s, ramp_s) = (f64::from(flat_ms) / 1e3, f64::from(ramp_ms) / 1e3);
                let (distance, acceleration) = ((rate * (flat_s + ramp_s)).round(), rate / ramp_s);
                let law = format!(
                    "law.trapezoid = {{ distance = \"{distance} step\", speed = \"{rate} step/s\", acceleration = \"{acceleration:.0} step/s^2\" }}"
                );
                (law, 1.0 / rate)
            }
            Motion::Sine(hz) => {
                let amplitude = rate / (TAU * f64::from(hz));
                let cycles = (f64::from(hz) * if self.board == "pico" { PICO_SINE_S } else { SINE_S }).ceil();
                let law = format!(
                    "law.sine = {{ amplitude = \"{amplitude:.6} step\", frequency = \"{hz} Hz\", cycles = {cycles} }}"
                );
                (law, 0.5 / f64::from(hz))
            }
        };
        let mut text = format!("board = \"{}\"\n", self.board);
        for (index, (step, dir)) in self.pins[..self.motors].iter().enumerate() {
            let start_ns = if apart { 1e9 * spread_s * index as f64 / self.motors as f64 } else { 0.0 };
            let _ = write!(
                text,
                "\n[motor.m{index}]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"{}\"\npins = {{ step = {step}, dir = {dir} }}\n\
                 forward = \"high\"\n\n[[motion]]\nmotor = \"m{index}\"\nstart = \"{start_ns:.0} ns\"\n{law}\n",
                self.driver
            );
        }
        text
    }

    /// Runs it with `pulsetrain run`: its motors in phase, and apart.
    pub(crate) fn run(&self, program: &Path) -> Run {
        let all: &[bool] = if self.motors == 1 { &[false] } else { &[false, true] };
        let mut run = Run { steps: 0, late_us: 0.0, fault: String::new() };
        for apart in all {
            match self.run_once(program, *apart) {
                Ok((steps, late_us)) => {
                    run.steps += steps;
                    run.late_us = run.late_us.max(late_us);
                }
                Err(fault) => {
                    run.fault = format!("FAILS{}: {fault}", if *apart { ", apart" } else { "" });
                    return run;
                }
            }
        }
        run
    }

    /// The steps of all motors, and the largest lateness, µs.
    fn run_once(&self, program: &Path, apart: bool) -> Result<(u64, f64), String> {
        let Promise { board, driver, motors, rate, .. } = self;
        let folder = Folder::new(&format!("promise-{board}-{driver}-{motors}-{}-{rate}-{apart}", self.key()));
        let file = folder.write("promise.toml", &self.file(apart));
        let out = folder.path("out");
        let mut command = Command::new(program);
        command.args(["run", &file, "--json", "--no-trace", "--no-steps", "--yes", "--out", &out]);
        let ran = command.output().map_err(|error| error.to_string())?;
        let report: Value = serde_json::from_slice(&ran.stdout)
            .map_err(|_| String::from_utf8_lossy(&ran.stderr).lines().take(3).collect::<Vec<_>>().join(" "))?;
        if ran.status.code() != Some(0) || report["pass"] != true {
            let said = [&report["message"], &report["stopped"]["message"], &report["failure"]];
            let said = said.iter().find_map(|text| text.as_str()).unwrap_or("the verdict is not PASS");
            return Err(said.lines().next().unwrap_or_default().to_owned());
        }
        let late = &report["lateness"];
        let number = |value: &Value| value.as_f64().ok_or("the report has not all numbers");
        let motors = report["motors"].as_array().ok_or("the report has no motors")?;
        for motor in motors {
            // A motion that is too short does not reach its rate.
            let peak = number(&motor["peak_speed_steps_per_s"]["value"])?;
            if (peak - 1e3 * rate).abs() > 1e-3 * peak {
                return Err(format!("the fastest speed is {peak} steps/s"));
            }
        }
        let steps = motors.iter().map(|motor| motor["steps"].as_u64()).sum::<Option<u64>>();
        let steps = steps.filter(|steps| *steps > 0).ok_or("no steps")?;
        if late["lost"] != 0 || late["extra"] != 0 || late["edges"] != steps {
            return Err(format!(
                "{} steps lost, {} added, {} of {steps} edges",
                late["lost"], late["extra"], late["edges"]
            ));
        }
        let largest = number(&late["max_ticks"])?.max(-number(&late["min_ticks"])?);
        Ok((steps, 1e6 * largest / number(&report["tick_hz"])?))
    }

    fn key(&self) -> String {
        let pins = self.pins[0].0;
        match self.motion {
            Motion::Flat(..) => format!("{pins}-flat"),
            Motion::Sine(hz) => format!("{pins}-{hz}"),
        }
    }

    /// The fields of its row up to the rate, as the page has them.
    pub(crate) fn fields(&self) -> [String; 7] {
        [
            self.board.to_owned(),
            image(self.board).0.to_owned(),
            format!("{:08x}", image_crc(self.board)),
            match self.motion {
                Motion::Flat(flat_ms, ramp_ms) => format!("{flat_ms} ms at the rate, ramps of {ramp_ms} ms"),
                Motion::Sine(hz) => format!("sinusoids of {hz} Hz"),
            },
            self.driver.to_owned(),
            pins_text(&self.pins[..self.motors]),
            self.rate.to_string(),
        ]
    }
}

/// The columns' titles. The first is the figure's number.
pub(crate) const COLUMNS: [&str; 11] = [
    "figure",
    "board",
    "image",
    "its CRC-32",
    "motion",
    "driver",
    "pins: STEP/DIR of each motor",
    "promised, 1000 steps/s of each motor",
    "steps made",
    "latest edge, µs",
    "verdict",
];

/// The name of a board's image.
fn image(board: &str) -> (&'static str, PathBuf) {
    let name = if board == "uno" { "uno.hex" } else { "pico.uf2" };
    (name, Path::new(env!("CARGO_MANIFEST_DIR")).join("../board/images").join(name))
}

/// CRC-32 of the file of a board's image.
pub(crate) fn image_crc(board: &str) -> u32 {
    crc32(&std::fs::read(image(board).1).expect("the image is committed"))
}
