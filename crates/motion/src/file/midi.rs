//! `[live.midi]`: what the controllers, notes and the clock of a MIDI device do to a live motion.

use super::live::{Cue, Knob};
use super::reader::{Node, Read};
use crate::quantity::nearest;

/// What MIDI does to a live motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Midi {
    /// The channel that is heard, 1 to 16; `None`: all.
    pub channel: Option<u8>,
    /// The tempo of the MIDI clock, quarter notes in a minute, at which the motion runs at the file's tempo. `None`: the clock does nothing.
    pub bpm: Option<f64>,
    /// What turns knobs, from `least` to `greatest`.
    pub knobs: Vec<(MidiDial, String)>,
    /// What begins cues.
    pub cues: Vec<(MidiKey, String)>,
    /// What gives orders.
    pub orders: Vec<(MidiKey, MidiOrder)>,
}

/// What turns a knob.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MidiDial {
    /// A controller of 7 bits, `cc7`.
    Controller(u8),
    /// A controller of 14 bits, `cc7-39`: this one and the one 32 above it.
    Fine(u8),
    /// The pitch bend, of 14 bits: `bend`.
    Bend,
}

/// What is pressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MidiKey {
    /// A note, `note60`.
    Note(u8),
    /// A program, `program3`.
    Program(u8),
    /// A controller, `cc64`, that becomes 64 or more.
    Controller(u8),
}

/// An order by MIDI.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MidiOrder {
    /// The next cue.
    Go,
    /// The cue before.
    Back,
    /// A halt on the path.
    Pause,
    /// On after a pause.
    Resume,
    /// Brake; the motion is over.
    Stop,
}

/// MIDI's highest number.
const HIGHEST: u8 = 127;
/// From a controller's first 7 bits to the other ones. Source: MIDI 1.0, table III.
const FINE: u8 = 32;
/// What an order can be.
const ORDERS: [(&str, MidiOrder); 5] = [
    ("go", MidiOrder::Go),
    ("back", MidiOrder::Back),
    ("pause", MidiOrder::Pause),
    ("resume", MidiOrder::Resume),
    ("stop", MidiOrder::Stop),
];

/// Reads `[live.midi]`.
pub(super) fn read(node: &Node, knobs: &[Knob], cues: &[Cue]) -> Read<Midi> {
    const EXAMPLE: &str = "[live.midi] with knobs = { cc1 = \"speed\" }";
    let section = node.section("`live.midi`".to_owned(), &["channel", "bpm", "knobs", "cues", "orders"], EXAMPLE)?;
    let channel = section.get("channel").map(|node| channel(&node)).transpose();
    let bpm = section.get("bpm").map(|node| bpm(&node)).transpose();
    let dials = section
        .get("knobs")
        .map(|node| each(&node, "knobs = { cc1 = \"speed\" }", |node| Ok((dial(node)?, knob(node, knobs)?))));
    let keys = section
        .get("cues")
        .map(|node| each(&node, "cues = { note60 = \"calm\" }", |node| Ok((key(node)?, cue(node, cues)?))));
    let orders = section
        .get("orders")
        .map(|node| each(&node, "orders = { note36 = \"go\" }", |node| Ok((key(node)?, node.word(&ORDERS)?))));
    let (knobs, cues, orders) = (dials.transpose(), keys.transpose(), orders.transpose());
    Ok(Midi {
        channel: channel?,
        bpm: bpm?,
        knobs: knobs?.unwrap_or_default(),
        cues: cues?.unwrap_or_default(),
        orders: orders?.unwrap_or_default(),
    })
}

/// Reads each line of a table, so that every bad one is noted.
fn each<T>(node: &Node, example: &str, read: impl Fn(&Node) -> Read<T>) -> Read<Vec<T>> {
    let section = node.any_section(format!("`{}`", node.key), example)?;
    let all: Vec<Read<T>> = section.nodes().iter().map(read).collect();
    all.into_iter().collect()
}

fn channel(node: &Node) -> Read<u8> {
    let number = node.number("1")?;
    if number.fract() == 0.0 && (1.0..=16.0).contains(&number) {
        return Ok(number as u8);
    }
    Err(node.note("1 to 16", format!("{number} is no MIDI channel"), "leave it out to hear all of them"))
}

fn bpm(node: &Node) -> Read<f64> {
    let number = node.number("120")?;
    if (1.0..=1000.0).contains(&number) {
        return Ok(number);
    }
    let help = "write the quarter notes in a minute at which the motion is as fast as the file has it";
    Err(node.note("1 to 1000", format!("{number} is no tempo of a MIDI clock"), help))
}

/// The number behind a word: 60 of `note60`.
fn numbered(key: &str, word: &str) -> Option<u8> {
    key.strip_prefix(word)?.parse().ok().filter(|number| *number <= HIGHEST)
}

fn dial(node: &Node) -> Read<MidiDial> {
    let fine = || {
        let (first, second) = node.key.split_once('-')?;
        let first = numbered(first, "cc").filter(|first| *first < FINE)?;
        (second.parse() == Ok(first + FINE)).then_some(MidiDial::Fine(first))
    };
    let plain = || numbered(node.key, "cc").map(MidiDial::Controller);
    let bend = || (node.key == "bend").then_some(MidiDial::Bend);
    plain().or_else(fine).or_else(bend).ok_or_else(|| {
        let message = format!("`{}` turns no knob", node.key);
        let help = "write cc1 for controller 1 (0 to 127), cc1-33 for one of 14 bits (controllers 0 to 31 with the one 32 above), or bend";
        node.note("no controller", message, help)
    })
}

fn key(node: &Node) -> Read<MidiKey> {
    let note = || numbered(node.key, "note").map(MidiKey::Note);
    let program = || numbered(node.key, "program").map(MidiKey::Program);
    let controller = || numbered(node.key, "cc").map(MidiKey::Controller);
    note().or_else(program).or_else(controller).ok_or_else(|| {
        let message = format!("`{}` is nothing that is pressed", node.key);
        node.note("no key", message, "write note60, program3 or cc64, with a number from 0 to 127")
    })
}

fn knob(node: &Node, knobs: &[Knob]) -> Read<String> {
    let name = node.text("\"speed\"")?;
    let Some(knob) = knobs.iter().find(|knob| knob.name == name) else {
        let help = match nearest(name, knobs.iter().map(|knob| knob.name.as_str())) {
            Some(near) => format!("did you mean \"{near}\"?"),
            None => "MIDI turns the knobs of [live.knobs]: add one, with `least` and `greatest`".to_owned(),
        };
        return Err(node.note("no knob", format!("[live.knobs] has no `{name}`"), help));
    };
    if knob.least.is_none() || knob.greatest.is_none() {
        let help = "add both to the knob: a controller goes from one to the other";
        return Err(node.note("no range", format!("knob `{name}` has no `least` and `greatest`"), help));
    }
    Ok(name.to_owned())
}

fn cue(node: &Node, cues: &[Cue]) -> Read<String> {
    let name = node.text("\"calm\"")?;
    if cues.iter().any(|cue| cue.name == name) {
        return Ok(name.to_owned());
    }
    let help = match nearest(name, cues.iter().map(|cue| cue.name.as_str())) {
        Some(near) => format!("did you mean \"{near}\"?"),
        None => "add a [[cue]] with that name".to_owned(),
    };
    Err(node.note("no cue", format!("no cue is called \"{name}\""), help))
}
