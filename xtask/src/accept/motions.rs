//! Random motion files like those of users: a law or a path for each motor, on a board, with drivers, pins and limits.
//!
//! A motion depends only on its seed, its number and its board.

use crate::random::Random;
use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

/// Boards that run motions, in the order in which they take turns.
pub(crate) const BOARDS: [&str; 3] = ["native", "uno", "pico"];

/// Length of motions, s.
const SPAN_S: f64 = 2.0;
/// A motion is shorter if all motors together would make more steps than this, since each step takes time and a line in
/// two files.
const MOST_STEPS: f64 = 1_500_000.0;
/// Rate of a motion's fastest motor, as a share of the board's limit.
const SLOWEST_SHARE: f64 = 0.02;

/// A motion file with its data.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Motion {
    /// Names and texts of its files. The first is the motion file.
    pub(crate) files: Vec<(String, String)>,
    /// Number of motors.
    pub(crate) motors: usize,
    /// Whether it never ends: then the commands need `--for`.
    pub(crate) endless: bool,
    /// The fastest rate that a motor should have, steps/s.
    pub(crate) rate: f64,
    /// The largest acceleration ÷ (2π · fastest rate) of all motors, Hz: of a sinusoid that is its frequency. `None` if
    /// it is unknown for one of the laws.
    pub(crate) turns_hz: Option<f64>,
}

/// The motors of a motion and their wiring, on which a board's limit depends.
pub(crate) struct Rig {
    board: &'static str,
    seed: u64,
    number: u64,
    random: Random,
    motors: Vec<Motor>,
    shares_dir: bool,
    /// Whether all motors are of one make and move alike at the same time, which is hardest for a board.
    alike: bool,
}

/// One motor.
#[derive(Clone, Debug)]
struct Motor {
    name: &'static str,
    /// The lines of its table, up to its limits.
    text: String,
    /// The unit of its amounts, and the steps in one unit.
    unit: &'static str,
    per_unit: f64,
    per_rev: f64,
    /// Steps in a mm of travel.
    per_mm: f64,
}

/// Motors' names in order. The first four are the axes of StepperWinch's text.
const NAMES: [&str; 8] = ["x", "y", "z", "a", "b", "c", "d", "e"];

/// Drivers with STEP and DIR, and their microsteps.
const DRIVERS: [(&str, &[u16]); 6] = [
    ("A4988", &[1, 2, 4, 8, 16]),
    ("DRV8825", &[1, 2, 4, 8, 16, 32]),
    ("A3967", &[1, 2, 4, 8]),
    ("TMC2209", &[8, 16, 32]),
    ("DQ542MA", &[2, 4, 8, 16, 32]),
    ("TB6600", &[1, 2, 4, 8, 16, 32]),
];

/// STEP and DIR pins of an Uno's motors.
type UnoPins = &'static [(u8, u8)];

/// Pins that work together on an Uno. A motion takes the first motors of a row that has enough.
const UNO_PINS: [UnoPins; 7] = [
    // Pins of the compare hardware.
    &[(9, 8), (10, 11)],
    &[(9, 7), (10, 6)],
    // Pins on ports D and B.
    &[(2, 5), (3, 6), (4, 7)],
    &[(8, 11), (9, 12), (10, 13)],
    // The CNC shield's pins.
    &[(2, 5), (3, 6), (4, 7), (12, 13)],
    // One DIR line for all motors.
    &[(9, 8), (10, 8), (11, 8), (12, 8)],
    &[(2, 5), (3, 5), (4, 5)],
];

/// STEP and DIR, or the four coils, of one motor.
enum Pins {
    StepDir(u8, u8),
    Coils([u8; 4]),
}

impl Rig {
    /// The motors of motion `number` of a seed.
    pub(crate) fn new(seed: u64, number: u64, board: &'static str) -> Rig {
        let mut random = Random::new(Random::new(seed).next().wrapping_add(number));
        let pins = match board {
            "native" => native_pins(&mut random),
            "pico" => pico_pins(&mut random),
            _ => uno_pins(&mut random),
        };
        let dirs: Vec<u8> =
            pins.iter().filter_map(|pins| if let Pins::StepDir(_, dir) = pins { Some(*dir) } else { None }).collect();
        let shares_dir = dirs.iter().enumerate().any(|(index, dir)| dirs[..index].contains(dir));
        let alike = random.once_in(4);
        let make = random.next();
        let motors = NAMES
            .into_iter()
            .zip(&pins)
            .map(|(name, pins)| Motor::new(&mut Random::new(if alike { make } else { random.next() }), name, pins))
            .collect();
        Rig { board, seed, number, random, motors, shares_dir, alike }
    }

    /// A motion of these motors that no board can follow: the refusal then contains the board's limit.
    pub(crate) fn too_fast(&self) -> String {
        let mut text = format!("board = \"{}\"\n", self.board);
        if self.board == "pico" {
            // With a wide tolerance the rate is the first limit that is met, and not the segments.
            text.push_str("tolerance = \"100 us\"\n");
        }
        for (index, motor) in self.motors.iter().enumerate() {
            let Motor { name, text: table, .. } = motor;
            // The other motors rest: else steps of motors that share a DIR line would come too close before the rate is
            // met.
            let amplitude = if index == 0 { 1_000_000_000.0 } else { 0.001 };
            let law = format!("law.sine = {{ amplitude = \"{amplitude} step\", frequency = \"1 Hz\" }}");
            let _ = write!(text, "\n[motor.{name}]\n{table}\n[[motion]]\nmotor = \"{name}\"\n{law}\n");
        }
        text
    }

    /// A motion of these motors on a board that allows `limit_hz` steps/s of each of them.
    pub(crate) fn motion(mut self, limit_hz: f64) -> Motion {
        let rate = limit_hz * self.random.decades(SLOWEST_SHARE.log10(), 0.0);
        let steps = rate * 0.6 * SPAN_S * self.motors.len() as f64;
        let mut part = Part {
            rate,
            span_s: (SPAN_S * (MOST_STEPS / steps).min(1.0) * 20.0).ceil() / 20.0,
            random: self.random,
            tables: Vec::new(),
            endless: false,
        };
        let mut motions = String::new();
        let mut kinds = Vec::new();
        let mut limits = vec![String::new(); self.motors.len()];
        let machine = if self.shares_dir { None } else { part.machine(&self.motors) };
        let mut free = 0;
        if let Some((kind, motors, text)) = machine {
            kinds.push(kind);
            motions.push_str(&text);
            free = motors;
        }
        let mut turns_hz = (free == 0).then_some(0.0_f64);
        let first = self.motors.get(free).filter(|_| self.alike);
        let together = first.map(|motor| {
            let kind = part.law_kind(self.shares_dir);
            (kind, part.law(kind, motor))
        });
        for (motor, limits) in self.motors.iter().zip(&mut limits).skip(free) {
            let own_share = if part.random.once_in(2) { 1.0 } else { part.random.decades(-1.0, 0.0) };
            let (kind, law) = match &together {
                Some((kind, law)) => (*kind, law.clone()),
                None => {
                    let kind = part.law_kind(self.shares_dir);
                    part.rate = rate * own_share;
                    (kind, part.law(kind, motor))
                }
            };
            kinds.push(kind);
            let turns = law.acceleration.map(|acceleration| acceleration / (TAU * law.rate));
            turns_hz = turns_hz.zip(turns).map(|(most, hz)| most.max(hz));
            *limits = part.limits(motor, &law);
            let _ = write!(motions, "\n[[motion]]\nmotor = \"{}\"\n", motor.name);
            if together.is_none() && part.random.once_in(4) {
                let _ = writeln!(motions, "start = \"{} ms\"", part.random.between(1, 300));
            }
            motions.push_str(&law.text);
        }
        kinds.dedup();
        let Rig { board, seed, number, .. } = self;
        let mut text = format!("# {}\n# {}\n\n", reproduce(seed, number, board), kinds.join(", "));
        let _ = writeln!(text, "board = \"{board}\"");
        text.push_str(part.random.pick(&["", "", "", "grid = \"reach\"\n", "grid = { hysteresis = \"0.1 step\" }\n"]));
        text.push_str(part.random.pick(&[
            "",
            "",
            "tolerance = \"1 tick\"\n",
            "tolerance = \"1 us\"\n",
            "tolerance = \"10 us\"\n",
        ]));
        text.push_str(part.random.pick(&["", "", "", "", "", "idle = \"500 ms\"\n"]));
        for (motor, limits) in self.motors.iter().zip(limits) {
            let _ = write!(text, "\n[motor.{}]\n{}{limits}", motor.name, motor.text);
        }
        text.push_str(&motions);
        let mut files = vec![("motion.toml".to_owned(), text)];
        files.append(&mut part.tables);
        Motion { files, motors: self.motors.len(), endless: part.endless, rate, turns_hz }
    }
}

/// Sinusoids in phase with a peak of `rate` steps/s.
pub(crate) fn in_phase(board: &str, motors: usize, rate: f64, frequency: u32) -> Motion {
    let pins = if board == "uno" { [(2, 5), (3, 6), (4, 7), (12, 13)] } else { [(2, 3), (4, 5), (6, 7), (8, 9)] };
    let mut text = format!("board = \"{board}\"\n");
    for (name, (step, dir)) in NAMES.into_iter().zip(pins).take(motors) {
        let _ = write!(
            text,
            "\n[motor.{name}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {dir} }}\n\
             forward = \"high\"\n\n[[motion]]\nmotor = \"{name}\"\nlaw.sine = {{ amplitude = \"{} step\", frequency = \"{frequency} Hz\", \
             cycles = {} }}\n",
            number(rate / (TAU * f64::from(frequency))),
            SPAN_S * f64::from(frequency),
        );
    }
    let files = vec![("motion.toml".to_owned(), text)];
    Motion { files, motors, endless: false, rate, turns_hz: Some(f64::from(frequency)) }
}

/// The command that makes a motion again.
pub(crate) fn reproduce(seed: u64, number: u64, board: &str) -> String {
    format!("cargo xtask accept --seed {seed} --only {number} --board {board}")
}

fn uno_pins(random: &mut Random) -> Vec<Pins> {
    let count = usize::from(random.between(1, 4));
    let fitting: Vec<UnoPins> = UNO_PINS.into_iter().filter(|pins| pins.len() >= count).collect();
    random.pick(&fitting)[..count].iter().map(|&(step, dir)| Pins::StepDir(step, dir)).collect()
}

fn native_pins(random: &mut Random) -> Vec<Pins> {
    let count = random.between(1, 8) as u8;
    let shares_dir = random.once_in(5);
    let own = |motor: u8| Pins::StepDir(2 * motor, 2 * motor + 1);
    let coils = random.once_in(5);
    (0..count)
        .map(|motor| match motor {
            _ if shares_dir => Pins::StepDir(motor, 31),
            _ if coils => Pins::Coils([0, 1, 2, 3].map(|line| 4 * motor + line)),
            _ => own(motor),
        })
        .collect()
}

/// STEP and DIR are neighbouring pins. A ULN2003's four lines follow one another.
fn pico_pins(random: &mut Random) -> Vec<Pins> {
    const LAST_COILS: [u8; 4] = [22, 26, 27, 28];
    let coils = match random.below(3) {
        0 => random.between(1, 6) as u8,
        1 => random.between(0, 3) as u8,
        _ => 0,
    };
    let room = 8.min(coils + (20 - 4 * coils.min(5)) / 2);
    let count = random.between(u16::from(coils.max(1)), u16::from(room.max(coils))) as u8;
    let mut pin = 2;
    (0..count)
        .map(|motor| {
            let first = pin;
            if motor < coils {
                pin += 4;
                Pins::Coils(if motor == 5 { LAST_COILS } else { [first, first + 1, first + 2, first + 3] })
            } else {
                pin += 2;
                Pins::StepDir(first, first + 1)
            }
        })
        .collect()
}

impl Motor {
    fn new(random: &mut Random, name: &'static str, pins: &Pins) -> Motor {
        let driver = random.pick(&DRIVERS);
        let mut text = String::new();
        let (steps_per_rev, microsteps, gear);
        match pins {
            Pins::StepDir(step, dir) => {
                steps_per_rev = f64::from(random.pick(&[200, 200, 200, 400, 48]));
                microsteps = random.pick(driver.1);
                gear = random.pick(&[("", 1.0), ("", 1.0), ("", 1.0), ("3", 3.0), ("\"16:60\"", 60.0 / 16.0)]);
                let forward = random.pick(&["high", "low"]);
                let _ = write!(
                    text,
                    "steps_per_rev = {steps_per_rev}\nmicrosteps = {microsteps}\ndriver = \"{}\"\n\
                     pins = {{ step = {step}, dir = {dir} }}\nforward = \"{forward}\"\n",
                    driver.0
                );
            }
            Pins::Coils([in1, in2, in3, in4]) => {
                steps_per_rev = 32.0;
                microsteps = random.pick(&[1, 2]);
                gear = random.pick(&[("63.68395", 63.68395), ("", 1.0)]);
                let _ = write!(
                    text,
                    "steps_per_rev = {steps_per_rev}\nmicrosteps = {microsteps}\ndriver = \"ULN2003\"\n\
                     pins = {{ in = [{in1}, {in2}, {in3}, {in4}] }}\n"
                );
            }
        }
        if !gear.0.is_empty() {
            let _ = writeln!(text, "gear = {}", gear.0);
        }
        let lead = random.pick(&[8.0, 40.0, 2.0]);
        let _ = writeln!(text, "lead = \"{lead} mm\"");
        text.push_str(random.pick(&["", "", "", "pull_in = \"300 step/s\"\n", "pull_in = \"100 full-step/s\"\n"]));
        let per_rev = steps_per_rev * f64::from(microsteps) * gear.1;
        let per_mm = per_rev / lead;
        let (unit, per_unit) = random.pick(&[
            ("rev", per_rev),
            ("deg", per_rev / 360.0),
            ("rad", per_rev / TAU),
            ("mm", per_mm),
            ("step", 1.0),
        ]);
        Motor { name, text, unit, per_unit, per_rev, per_mm }
    }

    /// An amount as a user writes it: four digits and the unit.
    fn amount(&self, steps: f64, per: &str) -> String {
        format!("\"{} {}{per}\"", number(steps / self.per_unit), self.unit)
    }
}

/// Four digits without an exponent.
fn number(value: f64) -> String {
    digits(value, 4)
}

fn digits(value: f64, digits: i32) -> String {
    if value == 0.0 || !value.is_finite() {
        return "0".to_owned();
    }
    let decimals = (digits - 1 - value.abs().log10().floor() as i32).max(0);
    let text = format!("{value:.*}", decimals as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// The motion of one motor.
#[derive(Clone)]
struct Law {
    /// The lines after `motor`.
    text: String,
    /// The largest acceleration, steps/s², if it is known.
    acceleration: Option<f64>,
    /// Whether it begins or ends with ramps, which need the motor's limits.
    has_ramps: bool,
    /// Its peak rate, steps/s.
    rate: f64,
}

/// A motion while it is built.
struct Part {
    random: Random,
    /// Peak rate of the motor that is being built, steps/s.
    rate: f64,
    span_s: f64,
    /// Further files of the motion.
    tables: Vec<(String, String)>,
    endless: bool,
}

/// The laws of a motor that moves by itself.
const LAWS: [&str; 13] = [
    "sine",
    "sine with a phase",
    "trapezoid",
    "s-curve",
    "to and fro",
    "table",
    "sum of sines",
    "sum",
    "chirp",
    "sweep",
    "swing",
    "speed",
    "winch",
];

impl Part {
    fn law_kind(&mut self, shares_dir: bool) -> &'static str {
        // With one DIR line it is a sweep.
        if shares_dir && self.random.once_in(3) { "sweep" } else { self.random.pick(&LAWS) }
    }

    /// A frequency, Hz; sometimes as fast as 60 Hz. A whole cycle fits into the motion.
    fn frequency(&mut self) -> f64 {
        let fastest: f64 = if self.random.once_in(6) { 60.0 } else { 10.0 };
        self.random.decades(-0.3, fastest.log10()).max(1.0 / self.span_s)
    }

    /// A share of the span, s.
    fn time(&mut self, low: f64, high: f64) -> f64 {
        self.span_s * (low + (high - low) * self.random.unit())
    }

    fn law(&mut self, kind: &'static str, motor: &Motor) -> Law {
        let rate = self.rate;
        let span = number(self.span_s);
        let mut law = Law { text: String::new(), acceleration: None, has_ramps: false, rate };
        law.text = match kind {
            "sine" => {
                let frequency = self.frequency();
                law.acceleration = Some(rate * TAU * frequency);
                format!("law.sine = {}\n", self.sine(motor, rate, frequency))
            }
            "sine with a phase" => {
                let frequency = self.frequency();
                let manner = self.manner(&mut law);
                law.acceleration = law.acceleration.map(|more| more + self.rate * TAU * frequency);
                format!(
                    "{manner}law.formula = {{ theta = \"a*sin(2*pi*f*t + p)\", unit = \"{}\", duration = \"{span} s\", \
                     where = {{ a = {}, f = \"{} Hz\", p = {} }} }}\n",
                    motor.unit,
                    motor.amount(self.rate / (TAU * frequency), ""),
                    number(frequency),
                    number(TAU * self.random.unit()),
                )
            }
            "trapezoid" => {
                let ramp_s = self.time(0.02, 0.4);
                let distance = rate * (ramp_s + self.time(0.0, 0.2));
                law.acceleration = Some(rate / ramp_s);
                format!("law.trapezoid = {}\n", trapezoid(motor, distance, rate, ramp_s))
            }
            "s-curve" => {
                let ramp_s = self.time(0.02, 0.3);
                let distance = rate * (2.0 * ramp_s + self.time(0.0, 0.2));
                law.acceleration = Some(rate / ramp_s);
                format!("law.s_curve = {}\n", self.s_curve(motor, distance, rate, ramp_s))
            }
            "to and fro" => {
                // Sometimes with frequent reversals.
                let times = self.random.decades(0.0, 1.6).round().min(self.span_s * 20.0).max(1.0);
                let way_s = self.span_s / (2.0 * times);
                let ramp_s = way_s * (0.1 + 0.4 * self.random.unit());
                let distance = rate * (way_s - ramp_s);
                law.acceleration = Some(rate / ramp_s);
                let [there, back] = [distance, -distance].map(|distance| trapezoid(motor, distance, rate, ramp_s));
                format!("repeat = {times}\nlaw.then = [{{ trapezoid = {there} }}, {{ trapezoid = {back} }}]\n")
            }
            "table" => self.table(motor),
            "sum of sines" => {
                let share = self.random.unit();
                let frequencies = [self.frequency(), self.frequency()];
                law.acceleration = Some(rate * TAU * (share * frequencies[0] + (1.0 - share) * frequencies[1]));
                let first = self.sine(motor, rate * share, frequencies[0]);
                let second = self.sine(motor, rate * (1.0 - share), frequencies[1]);
                format!("law.sum = [{{ sine = {first} }}, {{ sine = {second} }}]\n")
            }
            "sum" => {
                let (frequency, ramp_s) = (self.frequency(), self.time(0.05, 0.3));
                law.acceleration = Some(0.5 * rate * (TAU * frequency + 1.0 / ramp_s));
                let distance = 0.5 * rate * (2.0 * ramp_s + self.time(0.0, 0.2));
                let curve = self.s_curve(motor, distance, 0.5 * rate, ramp_s);
                let sine = self.sine(motor, 0.5 * rate, frequency);
                let delay = self.random.between(1, 300);
                format!(
                    "law.sum = [{{ delay = {{ by = \"{delay} ms\", law = {{ s_curve = {curve} }} }} }}, {{ sine = {sine} }}]\n"
                )
            }
            "chirp" => {
                let (from, to) = (self.frequency(), self.frequency());
                law.acceleration = Some(1.5 * rate * TAU * from.max(to));
                format!(
                    "law.formula = {{ theta = \"a*sin(pi*t/T)^2*sin(2*pi*(f*t + (g - f)*t*t/(2*T)))\", unit = \"{}\", \
                     duration = \"{span} s\", where = {{ a = {}, f = \"{} Hz\", g = \"{} Hz\", T = \"{span} s\" }} }}\n",
                    motor.unit,
                    motor.amount(rate / (TAU * from.max(to)), ""),
                    number(from),
                    number(to),
                )
            }
            "sweep" => {
                self.endless = true;
                let frequency = self.frequency();
                law.acceleration = Some(rate * TAU * frequency);
                let swing = (rate / (PI * frequency)).round().max(1.0);
                let phase = self.random.between(0, 300);
                format!(
                    "law.sweep = {{ frequency = \"{} Hz\", swing = \"{swing} step\", phase = \"{phase} ms\" }}\n",
                    number(frequency)
                )
            }
            "swing" => {
                // Whole half swings, so that it ends at rest.
                let swings = (2.0 * self.frequency() * self.span_s).round().max(1.0);
                let frequency = swings / (2.0 * self.span_s);
                let (theta, more) = self.random.pick(&[
                    ("a*exp(-t/tau)*sin(2*pi*f*t)^2", ", tau = \"0.8 s\""),
                    ("a*sin(2*pi*f*t)^3", ""),
                    ("a*sin(2*pi*f*t)^2 + a*t^2*(3 - 2*t/T)/(10*T*T)", "T"),
                ]);
                let more = if more == "T" { format!(", T = \"{span} s\"") } else { more.to_owned() };
                // The acceleration of a·sin³ is 3aω², and its peak rate 1.155aω.
                law.acceleration = Some(2.7 * rate * TAU * frequency);
                format!(
                    "law.formula = {{ theta = \"{theta}\", unit = \"{}\", duration = \"{span} s\", \
                     where = {{ a = {}, f = \"{} Hz\"{more} }} }}\n",
                    motor.unit,
                    motor.amount(rate / (1.16 * TAU * frequency), ""),
                    digits(frequency, 6),
                )
            }
            "speed" => {
                let manner = self.manner(&mut law);
                let backwards = if self.random.once_in(2) { -1.0 } else { 1.0 };
                let speed = motor.amount(backwards * self.rate, "/s");
                format!("{manner}law.speed = {{ speed = {speed}, duration = \"{span} s\" }}\n")
            }
            _ => {
                // A motor named as an axis has commands of its own; others use x's.
                let axis = if NAMES[..4].contains(&motor.name) { motor.name } else { "x" };
                let cutoff = self.random.pick(&[2.0, 4.0, 8.0]);
                // A critically damped step of 1 has a speed of ω/e at most.
                let target = (rate * std::f64::consts::E / (TAU * cutoff)).round();
                let back_s = number(self.span_s / 2.0);
                format!(
                    "law.winch = {{ axis = \"{axis}\", duration = \"{span} s\", commands = [\n    \"0 s: g {axis} {cutoff} 1.0\",\n    \
                     \"0 s: l {axis} {} {}\",\n    \"0 s: a {axis} {target}\",\n    \"{back_s} s: a {axis} 0\",\n] }}\n",
                    number(rate),
                    number(rate * TAU * cutoff * 2.0),
                )
            }
        };
        law
    }

    /// How a law that does not begin at rest is reached: by the motor's ramps, or within a time.
    fn manner(&mut self, law: &mut Law) -> String {
        if self.random.once_in(3) {
            // These ramps make up for the distance that they lose.
            self.rate /= 1.5;
            law.has_ramps = true;
            law.acceleration = Some(self.rate / (0.1 * self.span_s));
            return "begin = \"ramp\"\nend = \"ramp\"\n".to_owned();
        }
        let ease_s = self.time(0.05, 0.5);
        law.acceleration = Some(1.5 * self.rate / ease_s);
        format!("ease = \"{} s\"\n", number(ease_s))
    }

    /// max_speed and max_acceleration: both, one or none, and sometimes hardly more than the law needs.
    fn limits(&mut self, motor: &Motor, law: &Law) -> String {
        let more = if law.has_ramps { 1.6 } else { 1.05 };
        let slack = if self.random.once_in(3) { 1.0 } else { 1.5 };
        let speed = format!("max_speed = {}\n", motor.amount(law.rate * more * slack, "/s"));
        let acceleration = law.acceleration.map_or_else(String::new, |acceleration| {
            format!("max_acceleration = {}\n", motor.amount(acceleration * more * slack, "/s^2"))
        });
        match self.random.below(4) {
            _ if law.has_ramps => speed + &acceleration,
            0 => speed,
            1 => acceleration,
            2 => speed + &acceleration,
            _ => String::new(),
        }
    }

    fn sine(&mut self, motor: &Motor, rate: f64, frequency: f64) -> String {
        let amplitude = motor.amount(rate / (TAU * frequency), "");
        let cycles = (self.span_s * frequency).floor().max(1.0);
        if self.random.once_in(2) {
            format!("{{ amplitude = {amplitude}, frequency = \"{} Hz\", cycles = {cycles} }}", number(frequency))
        } else {
            format!("{{ amplitude = {amplitude}, period = \"{} s\", cycles = {cycles} }}", number(1.0 / frequency))
        }
    }

    fn s_curve(&mut self, motor: &Motor, distance: f64, rate: f64, ramp_s: f64) -> String {
        let acceleration = rate / ramp_s;
        let jerk = acceleration / (ramp_s * (0.1 + 0.8 * self.random.unit()));
        format!(
            "{{ distance = {}, speed = {}, acceleration = {}, jerk = {} }}",
            motor.amount(distance, ""),
            motor.amount(rate, "/s"),
            motor.amount(acceleration, "/s^2"),
            motor.amount(jerk, "/s^3"),
        )
    }

    /// A table of two sinusoids that grow and fade, sampled at a round rate and written with few decimals.
    fn table(&mut self, motor: &Motor) -> String {
        let rows_per_s = self.random.pick(&[20.0, 50.0, 100.0, 200.0]);
        let step_s = 1.0 / rows_per_s;
        let frequencies = [self.frequency().min(rows_per_s / 10.0), self.frequency().min(rows_per_s / 10.0)];
        let amplitude = self.rate / (TAU * frequencies[0].max(frequencies[1])) / motor.per_unit;
        // Some thousand different values, or fewer.
        let decimals = (self.random.between(1, 4) as i32 - amplitude.log10().floor() as i32).max(0) as usize;
        let share = self.random.unit();
        let mut text = "time,position\n".to_owned();
        let rows = (self.span_s * rows_per_s).round() as u32;
        for row in 0..=rows {
            let t = f64::from(row) * step_s;
            let swell = (PI * t / self.span_s).sin().powi(2);
            let [first, second] = frequencies.map(|frequency| (TAU * frequency * t).sin());
            let value = amplitude * swell * (share * first + (1.0 - share) * second);
            // No recorder writes -0.00.
            let value = format!("{value:.decimals$}");
            let is_zero = value.parse() == Ok(0.0);
            let _ = writeln!(text, "{t:.3},{}", if is_zero { "0" } else { &value });
        }
        let file = format!("{}.csv", motor.name);
        let columns = self.random.pick(&["", ", columns = [\"time\", \"position\"]"]);
        let law = format!("law.table = {{ file = \"{file}\", time = \"s\", unit = \"{}\"{columns} }}\n", motor.unit);
        self.tables.push((file, text));
        law
    }

    /// Sometimes a machine of the first motors: its kind, its number of motors, and its text.
    fn machine(&mut self, motors: &[Motor]) -> Option<(&'static str, usize, String)> {
        match (motors, self.random.below(12)) {
            ([x, y, z, ..], 0) => Some(("delta", 3, self.delta([x, y, z]))),
            ([x, y, ..], 1..=3) => {
                let (kind, path) = self.path(x, y);
                let machine = format!("\n[machine.table]\nkind = \"xy\"\nmotors = [\"{}\", \"{}\"]\n", x.name, y.name);
                Some((kind, 2, format!("{machine}\n[[motion]]\nmachine = \"table\"\n{path}")))
            }
            _ => None,
        }
    }

    fn path(&mut self, x: &Motor, y: &Motor) -> (&'static str, String) {
        // The motor with more steps in a mm sets the limit.
        let speed = self.rate / x.per_mm.max(y.per_mm);
        let span = number(self.span_s);
        match self.random.below(4) {
            0 => {
                let frequency = self.frequency();
                let (radius, cycles) = (speed / (TAU * frequency), (self.span_s * frequency).floor().max(1.0));
                let (radius, frequency, ease) = (number(radius), number(frequency), number(self.time(0.05, 0.3)));
                let circle =
                    format!("{{ radius = \"{radius} mm\", frequency = \"{frequency} Hz\", cycles = {cycles} }}");
                ("circle", format!("ease = \"{ease} s\"\npath.circle = {circle}\n"))
            }
            1 => {
                // The speed of the figure is at most some 200 of its units a second.
                let figure_speed = self.random.decades(-0.5, 0.5);
                let (scale, figure_speed) = (number(speed / 200.0 / figure_speed), number(figure_speed));
                let ease = number(self.time(0.05, 0.3));
                let lorenz = format!("{{ scale = \"{scale} mm\", speed = {figure_speed}, duration = \"{span} s\" }}");
                ("lorenz", format!("ease = \"{ease} s\"\npath.lorenz = {lorenz}\n"))
            }
            2 => {
                let points = self.random.between(2, 8);
                let ramp_s = self.time(0.01, 0.1);
                let size = speed * self.span_s / f64::from(points);
                let mut list = "[0, 0]".to_owned();
                for _ in 0..points {
                    let [to_x, to_y] = [(); 2].map(|()| digits(size * (2.0 * self.random.unit() - 1.0), 3));
                    let _ = write!(list, ", [{to_x}, {to_y}]");
                }
                let (speed, acceleration) = (number(speed), number(speed / ramp_s));
                let lines = format!(
                    "{{ points = [{list}], unit = \"mm\", speed = \"{speed} mm/s\", acceleration = \"{acceleration} mm/s^2\" }}"
                );
                ("lines", format!("path.lines = {lines}\n"))
            }
            _ => {
                let frequencies = [self.frequency(), self.frequency()];
                let radius = number(speed / (TAU * frequencies[0].max(frequencies[1])));
                let [f, g] = frequencies.map(number);
                let formula = format!(
                    "{{ x = \"r*sin(pi*t/T)^2*sin(2*pi*f*t)\", y = \"r*sin(pi*t/T)^2*cos(2*pi*g*t)\", unit = \"mm\", \
                     duration = \"{span} s\", where = {{ r = \"{radius} mm\", f = \"{f} Hz\", g = \"{g} Hz\", T = \"{span} s\" }} }}"
                );
                ("path by formula", format!("path.formula = {formula}\n"))
            }
        }
    }

    fn delta(&mut self, motors: [&Motor; 3]) -> String {
        let per_rev = motors.map(|motor| motor.per_rev).into_iter().fold(1.0, f64::max);
        // Speed of a joint of a 70 mm arm. Straight lines need up to some twice that.
        let speed = (self.rate / per_rev * TAU * 35.0).min(1500.0);
        let names = motors.map(|motor| format!("\"{}\"", motor.name)).join(", ");
        let mut text = format!(
            "\n[machine.robot]\nkind = \"delta\"\nmotors = [{names}]\nbase = \"60 mm\"\nupper_arm = \"70 mm\"\n\
             forearm = \"150 mm\"\neffector = \"25 mm\"\n\n[[motion]]\nmachine = \"robot\"\n"
        );
        if self.random.once_in(2) {
            let size = (speed * self.span_s / 8.0).min(35.0);
            let mut list = "[0, 0, -140]".to_owned();
            for _ in 0..self.random.between(2, 6) {
                let [x, y, z] = [(); 3].map(|()| size * (2.0 * self.random.unit() - 1.0));
                let _ = write!(list, ", [{}, {}, {}]", digits(x, 3), digits(y, 3), digits(0.5 * z - 140.0, 4));
            }
            let (speed, acceleration) = (number(speed), number(speed / self.time(0.01, 0.1)));
            let _ = writeln!(
                text,
                "path.lines = {{ points = [{list}], unit = \"mm\", speed = \"{speed} mm/s\", acceleration = \"{acceleration} mm/s^2\" }}"
            );
        } else {
            let frequency = self.frequency();
            let radius = number((speed / (TAU * frequency)).min(35.0));
            let (frequency, span) = (number(frequency), number(self.span_s));
            let _ = writeln!(
                text,
                "path.formula = {{ x = \"r*sin(pi*t/T)^2*cos(2*pi*f*t)\", y = \"r*sin(pi*t/T)^2*sin(2*pi*f*t)\", \
                 z = \"z0 - 0.3*r*sin(pi*t/T)^2\", unit = \"mm\", duration = \"{span} s\", \
                 where = {{ r = \"{radius} mm\", T = \"{span} s\", f = \"{frequency} Hz\", z0 = \"-140 mm\" }} }}"
            );
        }
        text
    }
}

fn trapezoid(motor: &Motor, distance: f64, rate: f64, ramp_s: f64) -> String {
    format!(
        "{{ distance = {}, speed = {}, acceleration = {} }}",
        motor.amount(distance, ""),
        motor.amount(rate, "/s"),
        motor.amount(rate / ramp_s, "/s^2"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use std::io::ErrorKind;
    use std::path::Path;

    /// The approximate limit of each board for this many motors.
    const LIMIT_HZ: f64 = 20_000.0;

    fn each(count: u64, mut look: impl FnMut(u64, &'static str, Motion)) {
        for number in 0..count {
            for board in BOARDS {
                look(number, board, Rig::new(5, number, board).motion(LIMIT_HZ));
            }
        }
    }

    #[test]
    fn a_motion_is_its_seeds_and_its_numbers_alone() {
        let mut texts = BTreeSet::new();
        each(50, |number, board, motion| {
            assert_eq!(Rig::new(5, number, board).motion(LIMIT_HZ), motion);
            assert!(motion.files[0].1.starts_with(&format!("# {}\n", reproduce(5, number, board))));
            texts.insert(motion.files[0].1.clone());
        });
        assert_eq!(texts.len(), 50 * BOARDS.len(), "no two are alike");
        assert_ne!(Rig::new(6, 0, "uno").motion(LIMIT_HZ), Rig::new(5, 0, "uno").motion(LIMIT_HZ));
    }

    /// The reader of motion files accepts all of them: this is a test of the planner and the boards, not of the reader.
    #[test]
    fn all_motions_are_read() {
        each(100, |number, board, motion| {
            let table = |path: &Path| {
                let found = motion.files.iter().find(|(name, _)| Path::new(name) == path);
                found.map(|(_, text)| text.clone()).ok_or(ErrorKind::NotFound.into())
            };
            let text = &motion.files[0].1;
            for text in [text, &Rig::new(5, number, board).too_fast(), &in_phase(board, 4, LIMIT_HZ, 30).files[0].1] {
                if let Err(error) = pulsetrain_motion::file::read(text, "motion.toml", &table) {
                    panic!("{text}\n{}", error.plain());
                }
            }
        });
    }

    #[test]
    fn every_kind_of_law_and_any_number_of_motors_comes() {
        let mut kinds = BTreeSet::new();
        let mut motors = BTreeSet::new();
        each(100, |_, board, motion| {
            motors.insert((board, motion.motors));
            let second = motion.files[0].1.lines().nth(1).unwrap_or_default().to_owned();
            kinds.extend(second.trim_start_matches("# ").split(", ").map(str::to_owned));
        });
        let machines = ["circle", "lorenz", "lines", "path by formula", "delta"];
        let missing: Vec<_> = LAWS.iter().chain(&machines).filter(|kind| !kinds.contains(**kind)).collect();
        assert!(missing.is_empty(), "{missing:?}");
        assert_eq!(motors.len(), 4 + 8 + 8, "{motors:?}");
    }

    #[test]
    fn amounts_have_four_digits() {
        assert_eq!([0.000_123_456, 1.0, 12.3456, 123_456.7].map(number), ["0.0001235", "1", "12.35", "123457"]);
    }
}
