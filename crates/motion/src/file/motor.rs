//! `[motor.NAME]`: what a motor is, what drives it, where it is wired, what it can do.

use std::cell::RefCell;
use std::ops::Range;

use super::reader::{Node, Noted, Read, Reader, Section};
use crate::Time;
use crate::boards::BoardProfile;
use crate::drivers::{self, Driver, Input};
use crate::electrical::{Winding, WindingError};
use crate::full_steps;
use crate::program::{CoilSequence, DriverTiming, Limits, PositionUnits, Scale, Wiring};
use crate::quantity::{Base, Kind, Quantity, nearest};

const KEYS: &[&str] = &[
    "steps_per_rev",
    "microsteps",
    "driver",
    "pulse_high",
    "pulse_low",
    "dir_setup",
    "dir_hold",
    "pins",
    "forward",
    "enabled",
    "sequence",
    "gear",
    "lead",
    "max_speed",
    "max_acceleration",
    "pull_in",
    "backlash",
    "film_limit",
    "inductance",
    "current",
    "voltage",
];

/// A motor as its table describes it, its motions still to come.
pub(super) struct MotorDraft {
    pub(super) name: String,
    /// Where its table begins.
    pub(super) at: Range<usize>,
    /// Laws can be read without it.
    pub(super) wiring: Read<Wiring>,
    pub(super) driver: Option<&'static str>,
    /// As `wiring`.
    pub(super) timing: Read<DriverTiming>,
    pub(super) limits: Limits,
    pub(super) winding: Option<Winding>,
    pub(super) backlash: Option<BacklashTable>,
    pub(super) gearing: Gearing,
    /// Largest |angle − law| in a film, steps.
    pub(super) film_limit: Option<f64>,
}

/// Slack behind a motor.
#[derive(Clone, Debug)]
pub(super) struct BacklashTable {
    pub(super) steps: f64,
    /// How long it takes to take it up.
    pub(super) over: Time,
    /// Where it is written.
    pub(super) at: Range<usize>,
}

/// From the user's units to steps.
pub(super) struct Gearing {
    motor: String,
    microsteps: u32,
    /// Steps in a revolution of the motor's shaft.
    steps_per_motor_turn: f64,
    /// Steps in a revolution of what the motor drives.
    steps_per_turn: f64,
    steps_per_mm: Option<f64>,
    /// Whether nothing turns: only lengths make sense.
    lengths_only: bool,
    /// How often each unit of position was used.
    units: RefCell<Vec<(&'static str, u32)>>,
}

/// Which pins are taken, by whom and for what.
#[derive(Default)]
pub(super) struct Pins(Vec<Pin>);

struct Pin {
    number: u8,
    role: PinRole,
    motor: String,
    at: Range<usize>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum PinRole {
    Step,
    Dir,
    Enable { high: bool },
    Coil,
}

impl PinRole {
    fn name(self) -> &'static str {
        match self {
            PinRole::Step => "STEP",
            PinRole::Dir => "DIR",
            PinRole::Enable { .. } => "ENABLE",
            PinRole::Coil => "a coil",
        }
    }

    /// DIR lines are shared as in the sweep article, ENABLE lines as on a CNC shield; nothing else can be.
    fn shares_with(self, other: PinRole) -> bool {
        self == other && matches!(self, PinRole::Dir | PinRole::Enable { .. })
    }
}

impl Pins {
    fn take(&mut self, node: &Node, role: PinRole, motor: &str, board: &BoardProfile) -> Read<u8> {
        let found = match (node.as_whole(), node.as_text()) {
            (Some(number), _) => board.pin(number),
            (None, Some(name)) => board.pin_named(name),
            (None, None) => return Err(node.wrong("a pin number", "step = 8")),
        };
        let number = found.map_err(|error| node.note("not this pin", error.to_string(), ""))?;
        let taken = self.0.iter().find(|pin| pin.number == number && !pin.role.shares_with(role));
        if let Some(taken) = taken {
            let labels = vec![
                (node.at.clone(), format!("{} of `{motor}`", role.name())),
                (taken.at.clone(), format!("already {} of `{}`", taken.role.name(), taken.motor)),
            ];
            let help = "only DIR lines may be shared, and ENABLE lines of one level";
            return Err(node.reader.note_all(labels, format!("pin {number} is used twice"), help));
        }
        self.0.push(Pin { number, role, motor: motor.to_owned(), at: node.at.clone() });
        Ok(number)
    }
}

impl Gearing {
    /// Of a coordinate of a machine's tip: its steps are mm.
    pub(super) fn of_mm(name: &str) -> Gearing {
        Gearing {
            motor: name.to_owned(),
            microsteps: 1,
            steps_per_motor_turn: 1.0,
            steps_per_turn: 1.0,
            steps_per_mm: Some(1.0),
            lengths_only: true,
            units: RefCell::default(),
        }
    }

    /// Steps in a turn of what the motor drives.
    pub(super) fn steps_per_turn(&self) -> f64 {
        self.steps_per_turn
    }

    /// What the motor travels in a turn, steps; `None` of a robot's effector.
    pub(super) fn steps_per_lead(&self) -> Option<f64> {
        (!self.lengths_only).then_some(self.steps_per_turn)
    }

    /// Steps in a radian of what the motor drives.
    pub(super) fn steps_per_rad(&self) -> f64 {
        self.steps_per_turn / std::f64::consts::TAU
    }

    /// Steps in a millimetre, if it has a lead.
    pub(super) fn steps_per_mm(&self) -> Option<f64> {
        self.steps_per_mm
    }

    /// An amount, speed, acceleration or jerk in steps (per s^`per_seconds`).
    pub(super) fn steps(&self, node: &Node, per_seconds: u8, example: &str) -> Read<f64> {
        let (steps, unit) = self.amount(node, per_seconds, example)?;
        if per_seconds == 0 {
            self.count(unit);
        }
        Ok(steps)
    }

    /// An amount, speed, acceleration or jerk in steps (per s^`per_seconds`), with the name of its unit.
    fn amount(&self, node: &Node, per_seconds: u8, example: &str) -> Read<(f64, &'static str)> {
        let (base, example) = match self.steps_per_mm {
            Some(_) => (Base::Length, example.replace("rev", "mm")),
            None => (Base::Turn, example.to_owned()),
        };
        let quantity = node.quantity(&example)?;
        if !quantity.base.is_position() || quantity.per_seconds != per_seconds {
            return Err(node.wrong_kind(Kind { base, per_seconds }, &quantity, &example));
        }
        let steps = quantity.value * self.steps_per(node, quantity.base)?;
        if steps.is_finite() {
            return Ok((steps, quantity.unit));
        }
        Err(node.note("out of range", format!("`{}` is out of range", node.key), ""))
    }

    /// Steps in one of a base unit of position, which is used at `node`.
    pub(super) fn steps_per(&self, node: &Node, base: Base) -> Read<f64> {
        match base {
            base if self.lengths_only && base != Base::Length => {
                let message = format!("`{}` must be a length: {} is a coordinate of the tip", node.key, self.motor);
                Err(node.note("not a length", message, "write it in mm, cm or m"))
            }
            Base::FullStep => Ok(f64::from(self.microsteps)),
            Base::Turn => Ok(self.steps_per_turn),
            Base::Length => self.steps_per_mm.ok_or_else(|| {
                let message = format!("motor `{}` turns: it has no `lead` that would make mm of its turns", self.motor);
                node.note("a distance", message, "add to the motor, for example: lead = \"8 mm\"; or give an angle")
            }),
            _ => Ok(1.0),
        }
    }

    /// Remembers that the user thinks in that unit.
    pub(super) fn count(&self, unit: &'static str) {
        let unit = match unit {
            "revs" | "turn" | "turns" => "rev",
            "°" => "deg",
            "steps" | "microstep" | "microsteps" => "step",
            "full-steps" => "full-step",
            "cm" | "m" | "in" => "mm",
            unit => unit,
        };
        let mut units = self.units.borrow_mut();
        match units.iter_mut().find(|(known, _)| *known == unit) {
            Some((_, count)) => *count += 1,
            None => units.push((unit, 1)),
        }
    }

    /// Steps in each unit of a position.
    pub(super) fn position_units(&self) -> PositionUnits {
        PositionUnits {
            steps_per_turn: self.steps_per_turn,
            steps_per_mm: self.steps_per_mm,
            steps_per_full_step: f64::from(self.microsteps),
        }
    }

    /// The unit that was used most, the first of them if several were.
    pub(super) fn scale(&self) -> Scale {
        let units = self.units.borrow();
        let most = units.iter().rev().max_by_key(|(_, count)| *count).map(|(unit, _)| *unit);
        let unit = most.unwrap_or(if self.steps_per_mm.is_some() { "mm" } else { "rev" });
        let steps_per_unit = match unit {
            "deg" => self.steps_per_turn / 360.0,
            "rad" => self.steps_per_turn / std::f64::consts::TAU,
            "mm" => self.steps_per_mm.unwrap_or(1.0),
            "step" => 1.0,
            "full-step" => f64::from(self.microsteps),
            _ => self.steps_per_turn,
        };
        Scale { unit: unit.to_owned(), steps_per_unit, steps_per_rev: self.steps_per_motor_turn }
    }
}

/// Reads one motor's table. Without a board its pins cannot be checked, and there is no wiring.
pub(super) fn read(node: &Node, board: Option<&BoardProfile>, pins: &mut Pins) -> Read<MotorDraft> {
    let name = node.key.to_owned();
    let example = "[motor.wheel] with its steps_per_rev, driver and pins";
    let section = node.section(format!("motor `{name}`"), KEYS, example)?;
    let driver = read_driver(&section);
    let microsteps = read_microsteps(&section, driver.as_ref().ok().copied().flatten());
    let gearing = microsteps.and_then(|microsteps| read_gearing(&section, &name, microsteps));
    let timing = driver.and_then(|driver| read_timing(&section, driver));
    let wiring = match (board, driver) {
        // Without microsteps there is no motor, but its pins can be wrong too.
        (Some(board), Ok(driver)) => read_wiring(&section, &name, driver, microsteps.unwrap_or(1), board, pins),
        _ => Err(Noted),
    };
    let gearing = gearing?;
    let winding = read_winding(&section, &gearing, driver.ok().flatten());
    let limits = read_limits(&section, &gearing);
    let backlash = section.get("backlash").map(|node| read_backlash(&node, &gearing)).transpose();
    let film_limit = section.get("film_limit").map(|node| read_film_limit(&node, &gearing)).transpose();
    let (winding, mut limits, backlash, film_limit) = (winding?, limits?, backlash?, film_limit?);
    if limits.max_speed.is_none() {
        limits.max_speed = winding.map(|winding| winding.max_speed());
    }
    let driver = driver.ok().flatten().map(|driver| driver.name);
    Ok(MotorDraft { name, at: node.at.clone(), wiring, driver, timing, limits, winding, backlash, gearing, film_limit })
}

fn read_driver(section: &Section) -> Read<Option<&'static Driver>> {
    let Some(node) = section.get("driver") else { return Ok(None) };
    let name = node.text("driver = \"A4988\"")?;
    let microsteps = section.get("microsteps").and_then(|node| u32::try_from(node.as_whole()?).ok());
    let found = drivers::named(name);
    if let Some(driver) = drivers::only_one(&found, microsteps.unwrap_or(1)) {
        return Ok(Some(driver));
    }
    let quoted = |names: &[&str]| names.iter().map(|name| format!("\"{name}\"")).collect::<Vec<_>>();
    if !found.is_empty() {
        let names: Vec<&str> = found.iter().map(|driver| driver.name).collect();
        let help = format!("write driver = {}", quoted(&names).join(", or "));
        return Err(node.note(
            "which of them?",
            format!("\"{name}\" are {} drivers with different settings", names.len()),
            help,
        ));
    }
    let names: Vec<&str> = drivers::table().iter().map(|row| row.name).collect();
    let help = match nearest(name, names.iter().copied()) {
        Some(near) => format!("did you mean \"{near}\"?"),
        None => format!(
            "known: {}; for others leave `driver` out and give pulse_high = \"2 us\" and so on",
            names.join(", ")
        ),
    };
    Err(node.note("not in the table", format!("unknown driver \"{name}\""), help))
}

fn read_microsteps(section: &Section, driver: Option<&Driver>) -> Read<u32> {
    let node = section.get("microsteps");
    let microsteps = match &node {
        // In 1..=1024, so it fits.
        Some(node) => node.whole(1..=1024, "microsteps = 4")? as u32,
        None => 1,
    };
    let Some(driver) = driver.filter(|driver| driver.setting(microsteps).is_none()) else { return Ok(microsteps) };
    let allowed: Vec<String> = driver.microsteps.iter().map(|m| m.count.to_string()).collect();
    let help = format!("the {} has {}", driver.name, allowed.join(", "));
    Err(match node {
        Some(node) => node.note(
            "not a setting of the driver",
            format!("the {} cannot make {microsteps} microsteps", driver.name),
            help,
        ),
        None => section.reader.note(
            section.at.clone(),
            "needs `microsteps`",
            format!("{} has no `microsteps`, and the {} cannot make full steps", section.name, driver.name),
            help,
        ),
    })
}

fn read_gearing(section: &Section, name: &str, microsteps: u32) -> Read<Gearing> {
    let steps = section.need("steps_per_rev", "steps_per_rev = 200")?;
    let full_steps = f64::from(read_full_steps(&steps)?);
    let gear = section.get("gear").map_or(Ok(1.0), |node| read_gear(&node));
    let lead = section.get("lead").map(|node| node.positive(Base::Length, 0, "8 mm")).transpose();
    let steps_per_motor_turn = full_steps * f64::from(microsteps);
    let steps_per_turn = steps_per_motor_turn * gear?;
    if !(1e-3..=1e12).contains(&steps_per_turn) {
        let message = format!("{steps_per_turn} steps in a revolution is out of range: 0.001 to 1e12");
        return Err(section.reader.note(section.at.clone(), "this motor", message, ""));
    }
    Ok(Gearing {
        motor: name.to_owned(),
        microsteps,
        steps_per_motor_turn,
        steps_per_turn,
        steps_per_mm: lead?.map(|lead_mm| steps_per_turn / lead_mm),
        lengths_only: false,
        units: RefCell::default(),
    })
}

fn read_full_steps(node: &Node) -> Read<u32> {
    const EXAMPLE: &str = "steps_per_rev = 200";
    // A step angle is written with its unit, too: "1.8 deg".
    let angle = node.as_text().and_then(|text| Quantity::parse(text).ok());
    let degrees =
        angle.filter(|angle| angle.base == Base::Turn && angle.per_seconds == 0).map(|angle| 360.0 * angle.value);
    let number = degrees.map_or_else(|| node.number(EXAMPLE), Ok)?;
    full_steps::checked(number)
        .map_err(|error| node.note(error.label(), format!("`{}` is {error}", node.key), error.advice()))
}

/// Turns of the motor for one turn of what it drives: a number, or the teeth of both wheels as "16:60".
fn read_gear(node: &Node) -> Read<f64> {
    /// No wheel has fewer teeth; so "3:1", which people also write for a reduction by 3, is never misread.
    const FEWEST_TEETH: u32 = 6;
    let Some(text) = node.as_text() else {
        let turns = node.number("gear = 3")?;
        return node.above_zero(turns);
    };
    let teeth = text
        .split_once(':')
        .and_then(|(motor, driven)| Some((motor.trim().parse::<u32>().ok()?, driven.trim().parse::<u32>().ok()?)));
    match teeth {
        Some((motor, driven)) if motor >= FEWEST_TEETH && driven >= FEWEST_TEETH => {
            Ok(f64::from(driven) / f64::from(motor))
        }
        _ => Err(node.note(
            "not two numbers of teeth",
            format!("`gear` in quotes counts teeth, motor:driven, at least {FEWEST_TEETH} each, but is \"{text}\""),
            "write gear = \"16:60\" for teeth, or gear = 3 if the motor turns three times for one turn",
        )),
    }
}

fn read_timing(section: &Section, driver: Option<&Driver>) -> Read<DriverTiming> {
    let on_coils = section.get("pins").is_some_and(|pins| pins.has("in"));
    if on_coils || driver.is_some_and(|driver| driver.input == Input::Coils) {
        return Ok(DriverTiming::default());
    }
    let nanoseconds = |key: &str, default: Option<u32>| -> Read<Option<u32>> {
        let Some(node) = section.get(key) else { return Ok(default) };
        let seconds = node.measure(Base::Time, 0, "2 us")?;
        if key == "pulse_high" {
            node.above_zero(seconds)?;
        }
        if (0.0..=1.0).contains(&seconds) {
            // At most 10^9, rounded up: a driver's times are minima.
            return Ok(Some((seconds * 1e9 - 1e-6).ceil() as u32));
        }
        Err(node.note("out of range", format!("`{key}` must be from 0 s to 1 s"), ""))
    };
    let table = driver.map(Driver::timing);
    let high = nanoseconds("pulse_high", table.map(|t| t.pulse_high_ns));
    // Without a driver's row nothing is known: as long as the pulse errs on the safe side.
    let default = high.ok().flatten();
    let low = nanoseconds("pulse_low", table.map(|t| t.pulse_low_ns).or(default));
    let setup = nanoseconds("dir_setup", table.map(|t| t.dir_setup_ns).or(default));
    let hold = nanoseconds("dir_hold", table.map(|t| t.dir_hold_ns).or(default));
    let (high, low, setup, hold) = (high?, low?, setup?, hold?);
    match (high, low, setup, hold) {
        (Some(pulse_high_ns), Some(pulse_low_ns), Some(dir_setup_ns), Some(dir_hold_ns)) => {
            Ok(DriverTiming { pulse_high_ns, pulse_low_ns, dir_setup_ns, dir_hold_ns })
        }
        _ => Err(section.reader.note(
            section.at.clone(),
            "needs `driver` or `pulse_high`",
            format!("{} says neither its driver nor how long its pulses must be", section.name),
            "add, for example: driver = \"A4988\"; or pulse_high = \"2 us\" (and pulse_low, dir_setup, dir_hold)",
        )),
    }
}

fn read_wiring(
    section: &Section,
    name: &str,
    driver: Option<&Driver>,
    microsteps: u32,
    board: &BoardProfile,
    pins: &mut Pins,
) -> Read<Wiring> {
    const STEP_DIR: &str = "pins = { step = 8, dir = 9 }";
    const COILS: &str = "pins = { in = [2, 3, 4, 5] }";
    let example = if driver.is_some_and(|driver| driver.input == Input::Coils) { COILS } else { STEP_DIR };
    let table = section.need("pins", example)?;
    let known = ["step", "dir", "enable", "in"];
    let wires = table.section(format!("the pin table of motor `{name}`"), &known, example)?;
    let enable = wires.get("enable").map(|node| {
        let level = section.get("enabled").map_or(Ok(false), |node| node.word(LEVELS));
        level.and_then(|high| Ok((pins.take(&node, PinRole::Enable { high }, name, board)?, high)))
    });
    let coils = wires.get("in");
    if let Some(coils) = coils {
        for key in ["step", "dir", "enable"] {
            if wires.get(key).is_some() {
                let at = wires.key_span(key);
                section.reader.note(at, "not with `in`", format!("a motor on four coil lines has no `{key}` pin"), "");
            }
        }
        let help = "leave it out; to turn the other way, write the pins in the other order, or for a Pico wire them so";
        refuse_keys(section, &["forward"], "four coil lines have no", help);
        let stepped = ["enabled", "pulse_high", "pulse_low", "dir_setup", "dir_hold"];
        refuse_keys(section, &stepped, "four coil lines have no", "leave it out");
        if let Some(driver) = driver.filter(|driver| driver.input != Input::Coils) {
            let message = format!("the {} takes STEP and DIR, not coil lines", driver.name);
            return Err(coils.note("coil lines", message, format!("write, for example: {STEP_DIR}")));
        }
        return read_coils(section, &coils, microsteps, name, board, pins);
    }
    refuse_keys(section, &["sequence"], "STEP and DIR lines have no", "leave it out");
    if enable.is_none() {
        refuse_keys(section, &["enabled"], "without an `enable` pin there is no", "add to the pins: enable = 7");
    }
    if let Some(driver) = driver.filter(|driver| driver.input == Input::Coils) {
        let message = format!("the {} has four coil lines, not STEP and DIR", driver.name);
        return Err(table.note("needs `in`", message, format!("write, for example: {COILS}")));
    }
    let mut pin = |key: &str, role| pins.take(&wires.need(key, STEP_DIR)?, role, name, board);
    let (step, dir) = (pin("step", PinRole::Step), pin("dir", PinRole::Dir));
    let forward = section
        .need("forward", "forward = \"high\" (the level of DIR that is forward; if it turns the wrong way, \"low\")")
        .and_then(|node| node.word(LEVELS));
    Ok(Wiring::StepDir { step: step?, dir: dir?, forward_high: forward?, enable: enable.transpose()? })
}

/// Notes each of the keys that stands: the wiring has no use for it.
fn refuse_keys(section: &Section, keys: &[&str], why: &str, help: &str) {
    for key in keys.iter().filter(|key| section.get(key).is_some()) {
        section.reader.note(section.key_span(key), "not with this wiring", format!("{why} `{key}`"), help);
    }
}

const LEVELS: &[(&str, bool)] = &[("low", false), ("high", true)];

fn read_coils(
    section: &Section,
    node: &Node,
    microsteps: u32,
    name: &str,
    board: &BoardProfile,
    pins: &mut Pins,
) -> Read<Wiring> {
    let list = node.list("in = [2, 3, 4, 5]")?;
    let taken: Vec<u8> = list.iter().filter_map(|node| pins.take(node, PinRole::Coil, name, board).ok()).collect();
    if list.len() != 4 {
        let message = format!("`in` must list four pins, IN1 to IN4, but lists {}", list.len());
        return Err(node.note("four pins", message, ""));
    }
    let numbers: [u8; 4] = taken.try_into().map_err(|_| Noted)?;
    let sequence = match (section.get("sequence"), microsteps) {
        (None, 2) => CoilSequence::Half,
        (Some(_), 2) => {
            let (at, help) = (section.key_span("sequence"), "leave it out, or write: microsteps = 1");
            let message = "half steps have one sequence alone; `sequence` is for full steps";
            return Err(section.reader.note(at, "not with half steps", message, help));
        }
        (None, 1) => CoilSequence::Full,
        (Some(node), 1) => node.word(&[("full", CoilSequence::Full), ("wave", CoilSequence::Wave)])?,
        _ => {
            let at = section.key_span("microsteps");
            let message = format!("coil lines make full steps (1) or half steps (2), not {microsteps} microsteps");
            return Err(section.reader.note(at, "1 or 2", message, ""));
        }
    };
    Ok(Wiring::Coils { pins: numbers, sequence })
}

fn read_winding(section: &Section, gearing: &Gearing, driver: Option<&Driver>) -> Read<Option<Winding>> {
    let keys = [
        ("inductance", Base::Inductance, "50 mH"),
        ("current", Base::Current, "0.135 A"),
        ("voltage", Base::Voltage, "12 V"),
    ];
    if keys.iter().all(|(key, ..)| section.get(key).is_none()) {
        return Ok(None);
    }
    let read = keys.map(|(key, base, example)| {
        section.need(key, &format!("{key} = \"{example}\"")).and_then(|node| node.positive(base, 0, example))
    });
    let [inductance_h, current_a, voltage_v] = read;
    let winding = Winding {
        inductance_h: inductance_h?,
        current_a: current_a?,
        voltage_v: voltage_v?,
        full_steps_per_rev: gearing.steps_per_motor_turn / f64::from(gearing.microsteps),
        microsteps: gearing.microsteps,
    };
    if let Some(driver) = driver {
        let limits = [
            ("current", winding.current_a, driver.max_current_a, "A"),
            ("voltage", winding.voltage_v, driver.max_voltage_v, "V"),
        ];
        for (key, value, limit, unit) in limits.into_iter().filter(|(_, value, limit, _)| value > limit) {
            let message = format!("{value} {unit} is too much for the {}: {limit} {unit} at most", driver.name);
            section.reader.note(section.get(key).map_or(section.at.clone(), |node| node.at), "too much", message, "");
        }
    }
    winding.checked().map(Some).map_err(|error| {
        let at = section.key_span("inductance");
        section.reader.note(at, "out of range", error.to_string(), WindingError::ADVICE)
    })
}

/// What any motor starts and stops at without a ramp, full steps/s: a quarter turn a second at 1.8°. Data sheets of
/// small motors give some hundreds.
const DEFAULT_PULL_IN_FULL_STEPS: f64 = 50.0;

fn read_limits(section: &Section, gearing: &Gearing) -> Read<Limits> {
    let limit = |key: &str, per_seconds, example| {
        section
            .get(key)
            .map(|node| {
                let steps = gearing.steps(&node, per_seconds, example)?;
                node.above_zero(steps)
            })
            .transpose()
    };
    let max_speed = limit("max_speed", 1, "5 rev/s");
    let max_acceleration = limit("max_acceleration", 2, "20 rev/s^2");
    let pull_in = limit("pull_in", 1, "0.5 rev/s");
    let default = DEFAULT_PULL_IN_FULL_STEPS * f64::from(gearing.microsteps);
    Ok(Limits { max_speed: max_speed?, max_acceleration: max_acceleration?, pull_in: pull_in?.unwrap_or(default) })
}

/// `backlash = { slack = "6 step", over = "20 ms" }`.
fn read_backlash(node: &Node, gearing: &Gearing) -> Read<BacklashTable> {
    const EXAMPLE: &str = "backlash = { slack = \"6 step\", over = \"20 ms\" }";
    let p = node.section("the backlash".to_owned(), &["slack", "over"], EXAMPLE)?;
    let slack = p.need("slack", EXAMPLE).and_then(|node| {
        // The unit of the slack says nothing about the unit in which the user thinks, so it is not counted.
        let (steps, _) = gearing.amount(&node, 0, "6 step")?;
        node.above_zero(steps)
    });
    let over = p.need("over", EXAMPLE).and_then(|node| node.duration("20 ms"));
    Ok(BacklashTable { steps: slack?, over: over?, at: node.at.clone() })
}

/// `film_limit = "2 deg"`.
fn read_film_limit(node: &Node, gearing: &Gearing) -> Read<f64> {
    // As with the slack, its unit is not counted.
    let (steps, _) = gearing.amount(node, 0, "2 deg")?;
    node.above_zero(steps)
}

/// `[motor]`: all motors, in the file's order.
pub(super) fn read_all(root: &Section, board: Option<&BoardProfile>) -> Vec<(String, Read<MotorDraft>)> {
    let Ok(node) = root.need("motor", "[motor.wheel] with its steps_per_rev, driver and pins") else {
        return Vec::new();
    };
    let example = "[motor.wheel] with its steps_per_rev, driver and pins";
    let Ok(motors) = node.any_section("motor".to_owned(), example) else { return Vec::new() };
    // `[motor]` with its keys right below it: the name is missing.
    if let Some(stray) = motors.nodes().into_iter().find(|node| !node.is_table()) {
        let message = format!("`{}` stands in [motor], but a motor needs a name", stray.key);
        root.reader.note(motors.key_span(stray.key), "of which motor?", message, "write [motor.wheel] above it");
        return Vec::new();
    }
    let nodes = motors.nodes();
    // What is wrong with the file as a whole comes first. Then pins that are used twice are no mistakes of their own.
    let board = match board {
        Some(row) if nodes.len() > row.max_motors => {
            let (name, most) = (row.name, row.max_motors);
            let message = format!("the board `{name}` drives {most} motors at most, but the file has {}", nodes.len());
            note_board(root.reader, root, message);
            None
        }
        board => board,
    };
    let mut pins = Pins::default();
    let drafts: Vec<_> = nodes.iter().map(|node| (node.key.to_owned(), read(node, board, &mut pins))).collect();
    if drafts.is_empty() {
        node.note("no motors", "the file has no motors", "add [motor.wheel]");
    }
    drafts
}

fn note_board(reader: &Reader, root: &Section, message: String) -> Noted {
    let at = root.get("board").map_or(root.at.clone(), |node| node.at);
    reader.note(at, "this board", message, "choose a board with more, or share the motors among boards")
}
