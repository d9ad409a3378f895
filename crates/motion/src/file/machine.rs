//! `[machine.NAME]`: several motors that draw one figure.

use std::ops::Range;

use super::motor;
use super::reader::{Node, Noted, Read, Section};
use super::{motor_named, refuse};
use crate::Time;
use crate::law::{Cursor, Law};
use crate::machine::{Delta, Kinematics, Machine};
use crate::program::Motor;
use crate::quantity::{Base, nearest};

const XY_KEYS: &[&str] = &["kind", "motors", "max_speed", "max_acceleration"];
const DELTA_KEYS: &[&str] =
    &["kind", "motors", "max_speed", "max_acceleration", "base", "upper_arm", "forearm", "effector", "angles"];
const EXAMPLE: &str = "[machine.table] with kind = \"xy\" and motors = [\"x\", \"y\"]";

/// A machine as its table describes it, its paths still to come.
pub(super) struct MachineDraft {
    pub(super) name: String,
    /// Where its table begins.
    pub(super) at: Range<usize>,
    /// Among the file's motors: x and y, or the arms.
    pub(super) motors: Vec<usize>,
    pub(super) kind: MachineKind,
    /// Of the tip, mm/s.
    pub(super) max_speed: Option<f64>,
    /// Of the tip, mm/s².
    pub(super) max_acceleration: Option<f64>,
}

/// What sort of machine.
pub(super) enum MachineKind {
    Xy,
    Delta {
        arms: Delta,
        /// Least and largest angle of an arm, rad.
        angles: Option<(f64, f64)>,
    },
}

/// `[machine]`: all machines, in the file's order, by name.
pub(super) fn read_all(
    root: &Section,
    motors: &[(String, Read<motor::MotorDraft>)],
) -> Vec<(String, Read<MachineDraft>)> {
    let Some(node) = root.get("machine") else { return Vec::new() };
    let Ok(machines) = node.any_section("machine".to_owned(), EXAMPLE) else { return Vec::new() };
    // `[machine]` with its keys right below it: the name is missing.
    if let Some(stray) = machines.nodes().into_iter().find(|node| !node.is_table()) {
        let message = format!("`{}` stands in [machine], but a machine needs a name", stray.key);
        root.reader.note(machines.key_span(stray.key), "of which machine?", message, "write [machine.table] above it");
        return Vec::new();
    }
    let mut taken = Vec::new();
    machines.nodes().iter().map(|node| (node.key.to_owned(), read(node, motors, &mut taken))).collect()
}

fn read(
    node: &Node,
    motors: &[(String, Read<motor::MotorDraft>)],
    taken: &mut Vec<(usize, String)>,
) -> Read<MachineDraft> {
    let name = node.key.to_owned();
    let section = node.any_section(format!("machine `{name}`"), EXAMPLE)?;
    let is_delta = section
        .need("kind", "kind = \"xy\", or \"delta\"")
        .and_then(|node| node.word(&[("xy", false), ("delta", true)]))?;
    section.check_keys(if is_delta { DELTA_KEYS } else { XY_KEYS });
    let kind = if is_delta { read_delta(&section) } else { Ok(MachineKind::Xy) };
    let example = if is_delta { "motors = [\"a\", \"b\", \"c\"]" } else { "motors = [\"x\", \"y\"]" };
    let found = section.need("motors", example).and_then(|node| {
        let wanted = if is_delta { 3 } else { 2 };
        let list = node.list(example)?;
        if list.len() != wanted {
            let message = format!("a machine of this kind has {wanted} motors, but `motors` lists {}", list.len());
            return Err(node.note("not as many", message, format!("write, for example: {example}")));
        }
        list.iter()
            .map(|node| {
                let index = motor_named(node, motors)?;
                if let Some((_, other)) = taken.iter().find(|(motor, _)| *motor == index) {
                    let message = format!("motor \"{}\" is in machine `{other}` already", motors[index].0);
                    return Err(node.note("named twice", message, "a motor is part of one machine, once"));
                }
                taken.push((index, name.clone()));
                Ok(index)
            })
            .collect::<Read<Vec<usize>>>()
    });
    let limit = |key: &str, per_seconds, example| {
        section.get(key).map(|node| node.positive(Base::Length, per_seconds, example)).transpose()
    };
    let max_speed = limit("max_speed", 1, "200 mm/s");
    let max_acceleration = limit("max_acceleration", 2, "2000 mm/s^2");
    let draft = MachineDraft {
        name,
        at: node.at.clone(),
        motors: found?,
        kind: kind?,
        max_speed: max_speed?,
        max_acceleration: max_acceleration?,
    };
    if matches!(draft.kind, MachineKind::Xy) && (draft.max_speed.is_some() || draft.max_acceleration.is_some()) {
        for (motor, gearing) in
            draft.motors.iter().filter_map(|motor| Some((motor, &motors[*motor].1.as_ref().ok()?.gearing)))
        {
            if gearing.steps_per_mm().is_none() {
                let message =
                    format!("motor `{}` has no `lead`: the tip's speed in mm/s is not known", motors[*motor].0);
                return Err(section.reader.note(
                    section.at.clone(),
                    "this machine",
                    message,
                    "give the motor a `lead`",
                ));
            }
        }
    }
    Ok(draft)
}

fn read_delta(section: &Section) -> Read<MachineKind> {
    let length = |key: &str, example: &str| {
        section.need(key, &format!("{key} = \"{example}\"")).and_then(|node| node.positive(Base::Length, 0, example))
    };
    let (base, upper) = (length("base", "60 mm"), length("upper_arm", "70 mm"));
    let (forearm, effector) = (length("forearm", "150 mm"), length("effector", "25 mm"));
    let angles = section.get("angles").map(|node| {
        const EXAMPLE: &str = "angles = [\"-30 deg\", \"85 deg\"]";
        let list = node.list(EXAMPLE)?;
        let [least, most] = list.as_slice() else {
            return Err(node.note("two angles", "`angles` must list two: the least and the largest", EXAMPLE));
        };
        let turns = |node: &Node| node.measure(Base::Turn, 0, "-30 deg");
        let (least, most) = (turns(least)?, turns(most)?);
        if least < most {
            return Ok((least * std::f64::consts::TAU, most * std::f64::consts::TAU));
        }
        Err(node.note("none is left", "the first of `angles` must be less than the second", ""))
    });
    let angles = angles.transpose();
    let arms = Delta { base_mm: base?, upper_arm_mm: upper?, forearm_mm: forearm?, effector_mm: effector? };
    Ok(MachineKind::Delta { arms, angles: angles? })
}

/// The machine that a motion is for.
pub(super) fn named<'a>(node: &Node, machines: &'a [(String, Read<MachineDraft>)]) -> Read<&'a MachineDraft> {
    let name = node.text("machine = \"table\"")?;
    match machines.iter().find(|(known, _)| known == name) {
        Some((_, draft)) => draft.as_ref().map_err(|Noted| Noted),
        None => {
            let names = || machines.iter().map(|(name, _)| name.as_str());
            let help = match (nearest(name, names()), machines.is_empty()) {
                (Some(near), _) => format!("did you mean \"{near}\"?"),
                (None, true) => format!("the file has no machines; add {EXAMPLE}"),
                (None, false) => format!("the file's machines: {}", names().collect::<Vec<_>>().join(", ")),
            };
            Err(node.note("not a machine of this file", format!("unknown machine \"{name}\""), help))
        }
    }
}

/// Where a machine's motors are set to: when, and how many steps from their zero.
pub(super) struct Home {
    pub(super) at: Time,
    pub(super) steps: Vec<f64>,
    /// The tip's path, mm, if it is a delta robot's, from a table, and neither repeated nor eased.
    pub(super) tip: Option<[Law; 3]>,
}

impl MachineDraft {
    /// The machine, its motors' laws being known.
    pub(super) fn finish(
        &self,
        root: &Section,
        motors: &[Motor],
        gearings: &[&motor::Gearing],
        slack: &[f64],
        home: Option<&Home>,
    ) -> Read<Machine> {
        let Some(home) = home else {
            let help = format!("add [[motion]] with machine = \"{}\", or take the machine out", self.name);
            return Err(root.reader.note(
                self.at.clone(),
                "never moves",
                format!("machine `{}` has no motion", self.name),
                help,
            ));
        };
        let mut steps = home.steps.clone();
        for (steps, motor) in steps.iter_mut().zip(&self.motors) {
            let law: &Law = &motors[*motor].law;
            let mut cursor = Cursor::new(law);
            let moved = cursor.at(home.at).and_then(|then| Ok(then.position - cursor.at(Time::ZERO)?.position));
            *steps -= moved.map_err(|error| {
                let node = root.get("machine");
                node.map_or(Noted, |node| refuse(&node, &error))
            })?;
        }
        let of = |k: usize| (gearings[k], &motors[self.motors[k]].scale);
        let (kinematics, unit) = match &self.kind {
            MachineKind::Delta { arms, angles } => {
                let steps_per_rad = [0, 1, 2].map(|k| of(k).0.steps_per_rad());
                (Kinematics::Delta { arms: *arms, steps_per_rad, angles: *angles }, "mm".to_owned())
            }
            MachineKind::Xy => {
                let ((x, x_scale), (y, y_scale)) = (of(0), of(1));
                let (steps_per_unit, unit) = match (x.steps_per_mm(), y.steps_per_mm()) {
                    (Some(x), Some(y)) => ([x, y], "mm"),
                    _ if x_scale.unit == y_scale.unit => {
                        ([x_scale.steps_per_unit, y_scale.steps_per_unit], x_scale.unit.as_str())
                    }
                    _ => ([1.0, 1.0], "step"),
                };
                (Kinematics::Xy { steps_per_unit }, unit.to_owned())
            }
        };
        Ok(Machine {
            name: self.name.clone(),
            motors: self.motors.clone(),
            kinematics,
            home: steps,
            slack: slack.to_vec(),
            unit,
            tip_limits: [self.max_speed, self.max_acceleration],
        })
    }
}
