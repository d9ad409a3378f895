//! `[live.knobs]` and `[[cue]]`: what `pulsetrain live` may change while a motion runs.

use super::context::Loader;
use super::machine::{self, Home};
use super::midi::{self, Midi};
use super::motor::MotorDraft;
use super::reader::{Node, Noted, Read, Section};
use super::sheet::{self, ParameterValue, SheetParameter};
use super::{Timeline, motor_named, read_motions};
use crate::Time;
use crate::quantity::{Quantity, nearest};
use std::ops::Range;
use toml_edit::Table;

/// What may be changed while a motion runs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Live {
    /// In the file's order.
    pub knobs: Vec<Knob>,
    /// In the file's order.
    pub cues: Vec<Cue>,
    /// `None` without `[live.midi]`.
    pub midi: Option<Midi>,
    /// When the motion is to run; empty: at any time.
    pub schedule: Vec<Period>,
}

/// A part of the day in which the motion runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Period {
    /// When it begins.
    pub start: TimeOfDay,
    /// When it ends. If that is not after `start`, it is on the next day.
    pub stop: TimeOfDay,
    /// The days on which it begins, from Monday on.
    pub days: [bool; 7],
    /// Where the motors rest after it.
    pub rest: RestPlace,
}

/// Where motors rest while it is not time for the motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RestPlace {
    /// Where the motion begins. The next start begins it from its first instant.
    AtStart,
    /// Where they are on their paths. There they go on at the next start.
    InPlace,
}

/// A time of day on a clock at the wall.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TimeOfDay {
    /// 0 to 23.
    pub hour: u8,
    /// 0 to 59.
    pub minute: u8,
    /// 0 to 59.
    pub second: u8,
}

impl TimeOfDay {
    /// Reads "9:30", "09:30" or "09:30:15".
    #[must_use]
    pub fn read(text: &str) -> Option<TimeOfDay> {
        let mut parts = text.trim().split(':').map(|part| {
            let is_number = (1..=2).contains(&part.len()) && part.bytes().all(|digit| digit.is_ascii_digit());
            part.parse::<u8>().ok().filter(|_| is_number)
        });
        let (hour, minute, second) = (parts.next()??, parts.next()??, parts.next().unwrap_or(Some(0))?);
        let is_time = hour < 24 && minute < 60 && second < 60 && parts.next().is_none();
        is_time.then_some(TimeOfDay { hour, minute, second })
    }
}

/// A knob of `[live.knobs]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Knob {
    /// Its name.
    pub name: String,
    /// The [`SheetParameter`] that it sets.
    pub target: String,
    /// The unit of its range and of bare numbers; empty if the parameter is a bare number.
    pub unit: String,
    /// The least value, in its unit.
    pub least: Option<f64>,
    /// The greatest value, in its unit.
    pub greatest: Option<f64>,
    /// How long a change takes, at least.
    pub smoothing: Option<Time>,
}

/// A cue: other values, or other motions.
#[derive(Clone, Debug, PartialEq)]
pub struct Cue {
    /// Its name.
    pub name: String,
    /// Parameters, or knobs, and their new values.
    pub set: Vec<(String, ParameterValue)>,
    /// How long the change takes, at least.
    pub fade: Option<Time>,
    /// The next cue begins after this time, without an order.
    pub follow: Option<Time>,
    /// The motors with motions of its own, in the program's order.
    pub motors: Vec<usize>,
    /// Whether these motions begin at the cue; else they count from the motion's begin.
    pub begins_now: bool,
    /// The times of day at which it begins without an order.
    pub at: Vec<TimeOfDay>,
}

/// Words that `pulsetrain live` takes for orders. No knob may have such a name.
pub const ORDERS: [&str; 14] = [
    "pause", "resume", "stop", "tempo", "go", "back", "cue", "goto", "knobs", "cues", "help", "status", "here", "begin",
];

/// What a cue may set.
#[derive(Clone, Copy)]
struct Names<'a> {
    parameters: &'a [SheetParameter],
    /// `None` if they are wrong themselves.
    knobs: Option<&'a [Knob]>,
}

/// Where a cue sets something.
struct SetPlaces {
    whole: Range<usize>,
    /// Of each value.
    values: Vec<Range<usize>>,
}

/// Reads both, if they are there.
pub(super) fn read(
    root: &Section,
    table: &Table,
    drafts: &[(String, Read<MotorDraft>)],
    machines: &[(String, Read<machine::MachineDraft>)],
    load: Loader,
) -> Read<Live> {
    let parameters = sheet::parameters(table);
    let knobs = read_knobs(root, &parameters);
    let cues = match root.get("cue") {
        None => Ok(Vec::new()),
        Some(node) => {
            let names = Names { parameters: &parameters, knobs: knobs.as_deref().ok() };
            read_cues(&node, root, table, names, drafts, machines, load)
        }
    };
    let schedule = read_schedule(root);
    let (knobs, cues) = (knobs?, cues?);
    let midi = match root.get("live") {
        None => None,
        Some(node) => {
            let live = node.any_section("`live`".to_owned(), "[live.midi]")?;
            live.get("midi").map(|node| midi::read(&node, &knobs, &cues)).transpose()?
        }
    };
    Ok(Live { knobs, cues, schedule: schedule?, midi })
}

/// The keys of `[live]`.
const LIVE: [&str; 3] = ["knobs", "midi", "schedule"];

fn read_schedule(root: &Section) -> Read<Vec<Period>> {
    const EXAMPLE: &str = "[live.schedule] with start = \"10:00\" and stop = \"18:00\"";
    let Some(node) = root.get("live") else { return Ok(Vec::new()) };
    let live = node.any_section("`live`".to_owned(), EXAMPLE)?;
    let Some(node) = live.get("schedule") else { return Ok(Vec::new()) };
    let nodes = if node.is_table() { vec![node.clone()] } else { node.list(EXAMPLE)? };
    if nodes.is_empty() {
        return Err(node.note("no times", "the schedule has no times", format!("write {EXAMPLE}")));
    }
    // All of them, so that every bad one is noted.
    let periods: Vec<Read<Period>> = nodes.iter().map(period).collect();
    periods.into_iter().collect()
}

fn period(node: &Node) -> Read<Period> {
    const START: &str = "start = \"10:00\"";
    const STOP: &str = "stop = \"18:00\"";
    let section = node.section("the schedule".to_owned(), &["start", "stop", "days", "rest"], START)?;
    let start = section.need("start", START).and_then(|node| time_of_day(&node));
    let stop = section.need("stop", STOP).and_then(|node| time_of_day(&node));
    let days = section.get("days").map(|node| days(&node)).transpose();
    let places = [("at-start", RestPlace::AtStart), ("in-place", RestPlace::InPlace)];
    let rest = section.get("rest").map(|node| node.word(&places)).transpose();
    let (start, stop) = (start?, stop?);
    if start == stop {
        let help = "leave the schedule out if the motion is to run all day, or write another `stop`";
        return Err(node.note("no time is left", "the schedule stops when it starts", help));
    }
    Ok(Period { start, stop, days: days?.unwrap_or([true; 7]), rest: rest?.unwrap_or(RestPlace::AtStart) })
}

fn time_of_day(node: &Node) -> Read<TimeOfDay> {
    let text = node.text("\"10:00\"")?;
    TimeOfDay::read(text).ok_or_else(|| {
        let message = format!("{text:?} is no time of day");
        node.note("no time of day", message, "write hours and minutes, from \"00:00\" to \"23:59\"")
    })
}

/// The words for days, from Monday on, and how many letters are enough.
const DAYS: [&str; 7] = ["monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday"];

fn days(node: &Node) -> Read<[bool; 7]> {
    const EXAMPLE: &str = "days = [\"sat\", \"sun\"]";
    let mut found = [false; 7];
    for node in node.list(EXAMPLE)? {
        let text = node.text("\"mon\"")?.trim().to_lowercase();
        let day = DAYS.iter().position(|day| text.len() >= 3 && day.starts_with(&text)).ok_or_else(|| {
            let message = format!("{text:?} is no day");
            node.note("no day", message, "write \"mon\", \"tue\", \"wed\", \"thu\", \"fri\", \"sat\" or \"sun\"")
        })?;
        found[day] = true;
    }
    if found.contains(&true) {
        return Ok(found);
    }
    Err(node.note("no day", "the schedule has no day", "leave `days` out if it is for every day"))
}

/// The times of day of a cue: one, or a list.
fn times_of_day(node: &Node) -> Read<Vec<TimeOfDay>> {
    if node.as_text().is_some() {
        return Ok(vec![time_of_day(node)?]);
    }
    let times: Vec<Read<TimeOfDay>> = node.list("at = [\"12:00\", \"15:30\"]")?.iter().map(time_of_day).collect();
    times.into_iter().collect()
}

fn read_knobs(root: &Section, parameters: &[SheetParameter]) -> Read<Vec<Knob>> {
    const EXAMPLE: &str = "[live.knobs] with speed = { target = \"wheel.frequency\", greatest = \"2 Hz\" }";
    let Some(node) = root.get("live") else { return Ok(Vec::new()) };
    let live = node.section("`live`".to_owned(), &LIVE, EXAMPLE)?;
    let Some(node) = live.get("knobs") else { return Ok(Vec::new()) };
    let section = node.any_section("the knobs".to_owned(), EXAMPLE)?;
    let knobs = section.nodes().into_iter().map(|node| knob(&section, &node, parameters));
    // All of them, so that every bad one is noted.
    let knobs: Vec<Read<Knob>> = knobs.collect();
    knobs.into_iter().collect()
}

fn knob(knobs: &Section, node: &Node, parameters: &[SheetParameter]) -> Read<Knob> {
    const EXAMPLE: &str = "target = \"wheel.frequency\"";
    let name = node.key;
    if name.is_empty() || name.contains(char::is_whitespace) || ORDERS.contains(&name) {
        let message = format!("a knob cannot be called `{name}`");
        let help = "give it a name without spaces that is none of live's own words, such as `speed`";
        return Err(node.reader.note(knobs.key_span(name), "this name", message, help));
    }
    let known = ["target", "unit", "least", "greatest", "smoothing"];
    let section = node.section(format!("knob `{name}`"), &known, EXAMPLE)?;
    let target_node = section.need("target", EXAMPLE)?;
    let target = parameter_at(&target_node, target_node.text(EXAMPLE)?, parameters)?;
    let smoothing = section.get("smoothing").map(|node| node.duration("0.5 s")).transpose();
    let unit = match section.get("unit") {
        None => target.value.parts().1.to_owned(),
        Some(node) => unit_of(&node, target)?,
    };
    let bound = |key: &str| section.get(key).map(|node| in_unit(&node, &unit, target)).transpose();
    let (least, greatest) = (bound("least"), bound("greatest"));
    let (least, greatest) = (least?, greatest?);
    if let (Some(least), Some(greatest)) = (least, greatest)
        && least > greatest
    {
        let message = format!("knob `{name}`: `least` is more than `greatest`");
        return Err(node.note("no value is left", message, "exchange them"));
    }
    Ok(Knob { name: name.to_owned(), target: target.name.clone(), unit, least, greatest, smoothing: smoothing? })
}

/// The parameter of that name.
fn parameter_at<'p>(node: &Node, name: &str, parameters: &'p [SheetParameter]) -> Read<&'p SheetParameter> {
    parameters.iter().find(|parameter| parameter.name == name).ok_or_else(|| {
        let names = || parameters.iter().map(|parameter| parameter.name.as_str());
        let help = match nearest(name, names()) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => format!("the numbers of this file's laws: {}", names().collect::<Vec<_>>().join(", ")),
        };
        node.note("not a number of a law", format!("no law has `{name}`"), help)
    })
}

fn unit_of(node: &Node, target: &SheetParameter) -> Read<String> {
    let unit = node.text("unit = \"Hz\"")?.trim();
    let is_same = |a: &Quantity, b: &Quantity| a.kind() == b.kind();
    let (of_target, own) = (quantity_of(target), Quantity::parse(&format!("1 {unit}")).ok());
    match (of_target, own) {
        (Some(target), Some(own)) if is_same(&target, &own) => Ok(unit.to_owned()),
        _ => {
            let (_, written) = target.value.parts();
            let message = format!("`{}` is no unit of `{}`", unit, target.name);
            let help = match written {
                "" => "leave it out: the law has a bare number".to_owned(),
                written => format!("write unit = \"{written}\", as in the law, or another unit of the same kind"),
            };
            Err(node.note("not its unit", message, help))
        }
    }
}

fn quantity_of(parameter: &SheetParameter) -> Option<Quantity> {
    match &parameter.value {
        ParameterValue::Quantity(text) => Quantity::parse(text).ok(),
        _ => None,
    }
}

/// A bound of a knob, in the knob's unit.
fn in_unit(node: &Node, unit: &str, target: &SheetParameter) -> Read<f64> {
    if unit.is_empty() {
        return node.number("2");
    }
    let example = format!("2 {unit}");
    let quantity = node.quantity(&example)?;
    match Quantity::parse(&format!("1 {unit}")) {
        Ok(one) if one.kind() == quantity.kind() => Ok(quantity.value / one.value),
        _ => {
            let message =
                format!("`{}` must be in a unit of `{}`, but this is {}", node.key, target.name, quantity.kind());
            Err(node.note(
                quantity.kind().to_string(),
                message,
                format!("write, for example: {} = \"{example}\"", node.key),
            ))
        }
    }
}

fn read_cues(
    node: &Node,
    root: &Section,
    table: &Table,
    names: Names,
    drafts: &[(String, Read<MotorDraft>)],
    machines: &[(String, Read<machine::MachineDraft>)],
    load: Loader,
) -> Read<Vec<Cue>> {
    const EXAMPLE: &str = "[[cue]] with name = \"fast\" and set = { \"wheel.frequency\" = \"2 Hz\" }";
    let nodes = if node.is_table() { vec![node.clone()] } else { node.list(EXAMPLE)? };
    let mut cues: Vec<Read<Cue>> = Vec::new();
    for (number, node) in nodes.iter().enumerate() {
        let cue = read_cue(node, names, drafts, machines).and_then(|(cue, begins_now, places)| {
            let before = cues.iter().flatten().any(|before: &Cue| before.name == cue.name);
            if before {
                let message = format!("two cues are called \"{}\"", cue.name);
                return Err(node.note("the second one", message, "give one of them another name"));
            }
            let (motors, is_endless) = check_motions(number, &cue, &places, (root, table), drafts, machines, load)?;
            Ok(Cue { begins_now: begins_now.unwrap_or(!is_endless), motors, ..cue })
        });
        cues.push(cue);
    }
    cues.into_iter().collect()
}

fn read_cue(
    node: &Node,
    names: Names,
    drafts: &[(String, Read<MotorDraft>)],
    machines: &[(String, Read<machine::MachineDraft>)],
) -> Read<(Cue, Option<bool>, SetPlaces)> {
    const EXAMPLE: &str = "name = \"fast\"";
    let known = ["name", "set", "motion", "fade", "follow", "begins", "at"];
    let section = node.section("the cue".to_owned(), &known, EXAMPLE)?;
    let name_node = section.need("name", EXAMPLE)?;
    let name = name_node.text(EXAMPLE)?.trim();
    if name.is_empty() || name.contains(char::is_control) {
        return Err(name_node.note("no name", "a cue needs a name of one line", ""));
    }
    let time = |key: &str| section.get(key).map(|node| node.duration("2 s")).transpose();
    let (fade, follow) = (time("fade"), time("follow"));
    let at = section.get("at").map(|node| times_of_day(&node)).transpose();
    let set_node = section.get("set");
    let set = set_node.as_ref().map(|node| read_set(node, names)).transpose();
    let begins = section.get("begins").map(|node| node.word(&[("now", true), ("with-the-motion", false)])).transpose();
    let motion = section.get("motion");
    if set.as_ref().is_ok_and(Option::is_none) && motion.is_none() {
        let message = format!("cue \"{name}\" changes nothing");
        return Err(node.note("changes nothing", message, "give it `set`, or [[cue.motion]]"));
    }
    if let Some(motion) = &motion {
        let nodes = if motion.is_table() { vec![motion.clone()] } else { motion.list("[[cue.motion]]")? };
        for node in nodes {
            // Whose motion it is must be known: the motion before it goes.
            let row = node.any_section("the cue's motion".to_owned(), "motor = \"wheel\"")?;
            let is_machine = row.get("machine").map(|node| machine::named(&node, machines).map(drop)).transpose()?;
            if is_machine.is_none() && row.get("motors").is_none() {
                motor_named(&row.need("motor", "motor = \"wheel\"")?, drafts)?;
            }
        }
    }
    let (set, values) = set?.unwrap_or_default().into_iter().unzip();
    let places = SetPlaces { whole: set_node.map_or_else(|| node.at.clone(), |set| set.at), values };
    let cue = Cue {
        name: name.to_owned(),
        set,
        fade: fade?,
        follow: follow?,
        motors: Vec::new(),
        begins_now: false,
        at: at?.unwrap_or_default(),
    };
    Ok((cue, begins?, places))
}

/// A parameter, its new value, and where that is written.
type SetValue = ((String, ParameterValue), Range<usize>);

fn read_set(node: &Node, names: Names) -> Read<Vec<SetValue>> {
    const EXAMPLE: &str = "set = { \"wheel.frequency\" = \"2 Hz\" }";
    let section = node.any_section("`set`".to_owned(), EXAMPLE)?;
    let mut set = Vec::new();
    for node in section.nodes() {
        // A dotted key without quotes is a table of its motor.
        if node.is_table() {
            let inner = node.any_section(format!("`{}`", node.key), EXAMPLE)?;
            for value in inner.nodes() {
                let name = format!("{}.{}", node.key, value.key);
                set.push((set_one(&value, &name, names)?, value.at));
            }
            continue;
        }
        set.push((set_one(&node, node.key, names)?, node.at.clone()));
    }
    Ok(set)
}

/// A knob's value, or that of a parameter.
fn set_one(node: &Node, name: &str, names: Names) -> Read<(String, ParameterValue)> {
    let of_name = |name: &str| names.parameters.iter().find(|parameter| parameter.name == name);
    let knob = names.knobs.and_then(|knobs| knobs.iter().find(|knob| knob.name == name));
    if let Some((knob, target)) = knob.and_then(|knob| Some((knob, of_name(&knob.target)?))) {
        return Ok((knob.target.clone(), knob_value(node, knob, target)?));
    }
    match (of_name(name), names.knobs) {
        (Some(parameter), _) => Ok((name.to_owned(), value(node, parameter)?)),
        // It may be one of the knobs that are wrong.
        (None, None) => Err(Noted),
        (None, Some(knobs)) => {
            let knobs = knobs.iter().map(|knob| knob.name.as_str());
            let known = || knobs.clone().chain(names.parameters.iter().map(|parameter| parameter.name.as_str()));
            let help = match nearest(name, known()) {
                Some(near) => format!("did you mean \"{near}\"?"),
                None => format!("a cue can set {}", known().collect::<Vec<_>>().join(", ")),
            };
            Err(node.note("nothing to set", format!("there is no knob `{name}`, and no law has it"), help))
        }
    }
}

fn value(node: &Node, parameter: &SheetParameter) -> Read<ParameterValue> {
    match (node.as_whole(), node.as_number()) {
        (Some(whole), _) if matches!(parameter.value, ParameterValue::Whole(_)) => Ok(ParameterValue::Whole(whole)),
        (_, Some(number)) => Ok(ParameterValue::Number(number)),
        _ => {
            node.quantity("2 Hz")?;
            Ok(ParameterValue::Quantity(node.as_text().unwrap_or_default().to_owned()))
        }
    }
}

/// A value of a knob, within its range. A bare number is in the knob's unit.
fn knob_value(node: &Node, knob: &Knob, target: &SheetParameter) -> Read<ParameterValue> {
    let unit = &knob.unit;
    let (number, value) = match node.as_number().filter(|_| !unit.is_empty()) {
        Some(number) => (number, ParameterValue::Quantity(format!("{number} {unit}"))),
        None => (in_unit(node, unit, target)?, value(node, target)?),
    };
    let beyond = |bound: f64, which: &str| {
        let message = format!("the {which} value of knob `{}` is {}", knob.name, format!("{bound} {unit}").trim_end());
        node.note("beyond the knob's range", message, "write a value in the range, or change the range")
    };
    match (knob.least, knob.greatest) {
        (Some(least), _) if number < least => Err(beyond(least, "least")),
        (_, Some(greatest)) if number > greatest => Err(beyond(greatest, "greatest")),
        _ => Ok(value),
    }
}

/// Reads the file's motions with a cue in it. Gives the motors with motions of the cue's own, and whether all of those are endless.
fn check_motions(
    number: usize,
    cue: &Cue,
    places: &SetPlaces,
    (root, table): (&Section, &Table),
    drafts: &[(String, Read<MotorDraft>)],
    machines: &[(String, Read<machine::MachineDraft>)],
    load: Loader,
) -> Read<(Vec<usize>, bool)> {
    let mut table = table.clone();
    let rows = sheet::cue_motions(&table, number);
    let named: Vec<String> = rows.iter().flat_map(|row| sheet::owners(row)).collect();
    let has_motions = !rows.is_empty();
    if has_motions {
        sheet::replace_motions(&mut table, rows);
    }
    let mut moved = Vec::new();
    for ((name, value), at) in cue.set.iter().zip(&places.values) {
        moved.extend(sheet::key_span(&table, name).map(|key| (key, at.clone())));
        // A parameter of a law that the cue itself replaces may be gone.
        if let Err(unknown) = sheet::set(&mut table, name, value) {
            let message = format!("cue \"{}\" sets `{}`, which its own motions do not have", cue.name, unknown.name);
            return Err(root.reader.note(at.clone(), "this value", message, "leave it out of `set`"));
        }
    }
    let before = root.reader.problems();
    let read = read_motions_of(&table, root, &named, drafts, machines, load);
    // What is wrong with a value that the cue sets is marked in the cue. If the cue sets several values, its whole `set` is marked.
    let cause = match places.values.as_slice() {
        _ if has_motions => None,
        [one] => Some(one.clone()),
        _ => Some(places.whole.clone()),
    };
    root.reader.move_problems(before, &moved, cause);
    read
}

/// Reads the motions of a changed file. Gives the motors that are named, or whose machine is, and whether all of their motions are endless.
fn read_motions_of(
    table: &Table,
    root: &Section,
    named: &[String],
    drafts: &[(String, Read<MotorDraft>)],
    machines: &[(String, Read<machine::MachineDraft>)],
    load: Loader,
) -> Read<(Vec<usize>, bool)> {
    let changed = Section::root(root.reader, table);
    let mut homes: Vec<Option<Home>> = machines.iter().map(|_| None).collect();
    let timelines: Vec<Read<Timeline>> = read_motions(&changed, drafts, machines, &mut homes, load);
    let (mut own, mut is_endless) = (Vec::new(), true);
    for (motor, timeline) in timelines.into_iter().enumerate() {
        let timeline = timeline?;
        let is_named = named.contains(&drafts[motor].0)
            || machines.iter().any(|(name, draft)| {
                named.contains(name) && draft.as_ref().is_ok_and(|draft| draft.motors.contains(&motor))
            });
        if is_named {
            own.push(motor);
            is_endless &= timeline.is_endless();
        }
        let draft = drafts[motor].1.as_ref().map_err(|Noted| Noted)?;
        timeline.finish(root.reader, draft)?;
    }
    Ok((own, is_endless))
}
