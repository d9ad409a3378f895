//! Messages to requests.

use std::time::Duration;

use pulsetrain_motion::file::{Midi, MidiDial, MidiKey, MidiOrder};
use wmidi::MidiMessage;

use super::ClockTempo;
use crate::live::{KnobInfo, KnobValue, RunCommand};

/// From a controller's first 7 bits to the other ones. Source: MIDI 1.0, table III.
const FINE: u8 = 32;
/// From this value on a controller counts as pressed. Source: MIDI 1.0, table III, "0-63 = off, 64-127 = on".
const PRESSED: u8 = 64;

/// Translates MIDI messages to requests of a live motion, by its `[live.midi]`.
///
/// ```
/// use pulsetrain::live::{KnobInfo, KnobValue, RunCommand};
/// use pulsetrain::midi::Interpreter;
/// use pulsetrain::motion::file::{Midi, MidiDial};
/// let midi = Midi { knobs: vec![(MidiDial::Controller(1), "speed".to_owned())], ..Midi::default() };
/// let (name, target, unit) = ("speed".to_owned(), "wheel.frequency".to_owned(), "Hz".to_owned());
/// let knob = KnobInfo { name, target, unit, least: Some(0.0), greatest: Some(2.0), value: 1.0 };
/// let set = RunCommand::Set { knob: "speed".to_owned(), value: KnobValue::Number(2.0) };
/// let mut interpreter = Interpreter::new(midi);
/// assert_eq!(interpreter.hear(&[0xb0, 1, 127], Default::default(), &[knob]), [set]);
/// assert_eq!(interpreter.hear(&[0xb0, 2, 127], Default::default(), &[]), []);
/// ```
#[derive(Clone, Debug)]
pub struct Interpreter {
    midi: Midi,
    clock: Option<ClockTempo>,
    /// The first 7 bits of each controller of 14, and the other 7.
    fine: [(u8, u8); FINE as usize],
    /// The controllers that are pressed.
    pressed: [bool; 128],
}

impl Interpreter {
    /// For a motion file's `[live.midi]`.
    #[must_use]
    pub fn new(midi: Midi) -> Interpreter {
        let clock = midi.bpm.map(ClockTempo::new);
        Interpreter { midi, clock, fine: [(0, 0); FINE as usize], pressed: [false; 128] }
    }

    /// What a message that came at `at` asks for. `knobs` are those of the motion, with their ranges. Bytes that are no message ask for nothing.
    pub fn hear(&mut self, bytes: &[u8], at: Duration, knobs: &[KnobInfo]) -> Vec<RunCommand> {
        let Ok(message) = MidiMessage::try_from(bytes) else { return Vec::new() };
        let channel = message.channel().map(|channel| channel.index() + 1);
        if channel.is_some() && self.midi.channel.is_some_and(|own| Some(own) != channel) {
            return Vec::new();
        }
        match message {
            MidiMessage::TimingClock => {
                let rate = self.clock.as_mut().and_then(|clock| clock.tick(at));
                rate.map(|rate| RunCommand::Tempo { rate }).into_iter().collect()
            }
            // A note with velocity 0 is released. Source: MIDI 1.0, "Note-On".
            MidiMessage::NoteOn(_, note, velocity) if u8::from(velocity) > 0 => self.press(MidiKey::Note(note.into())),
            MidiMessage::ProgramChange(_, program) => self.press(MidiKey::Program(program.into())),
            MidiMessage::PitchBendChange(_, bend) => {
                self.turn(&[(MidiDial::Bend, f64::from(u16::from(bend)) / 16_383.0)], knobs)
            }
            MidiMessage::ControlChange(_, number, value) => self.control(number.into(), value.into(), knobs),
            _ => Vec::new(),
        }
    }

    fn control(&mut self, number: u8, value: u8, knobs: &[KnobInfo]) -> Vec<RunCommand> {
        let mut turned = vec![(MidiDial::Controller(number), f64::from(value) / 127.0)];
        // The first 7 bits come first; the other 7 are 0 until they come. Source: MIDI 1.0, "Control Change".
        let first = if number < FINE { Some(number) } else { number.checked_sub(FINE).filter(|first| *first < FINE) };
        if let Some(first) = first {
            let fine = &mut self.fine[usize::from(first)];
            *fine = if number < FINE { (value, 0) } else { (fine.0, value) };
            let whole = (u16::from(fine.0) << 7) | u16::from(fine.1);
            turned.push((MidiDial::Fine(first), f64::from(whole) / 16_383.0));
        }
        let mut requests = self.turn(&turned, knobs);
        let is_pressed = value >= PRESSED;
        let was_pressed = std::mem::replace(&mut self.pressed[usize::from(number)], is_pressed);
        if is_pressed && !was_pressed {
            requests.extend(self.press(MidiKey::Controller(number)));
        }
        requests
    }

    /// Turns the knobs of a dial to a part of their range.
    fn turn(&self, turned: &[(MidiDial, f64)], knobs: &[KnobInfo]) -> Vec<RunCommand> {
        let request = |(dial, name): &(MidiDial, String)| {
            let (_, part) = turned.iter().find(|(turned, _)| turned == dial)?;
            let knob = knobs.iter().find(|knob| knob.name == *name)?;
            let (least, greatest) = (knob.least?, knob.greatest?);
            // The ends are exact.
            let value = if *part == 1.0 { greatest } else { least + (greatest - least) * part };
            Some(RunCommand::Set { knob: name.clone(), value: KnobValue::Number(value) })
        };
        self.midi.knobs.iter().filter_map(request).collect()
    }

    fn press(&self, key: MidiKey) -> Vec<RunCommand> {
        let cues = self.midi.cues.iter().filter(|(of, _)| *of == key);
        let cues = cues.map(|(_, name)| RunCommand::Cue { name: name.clone() });
        let orders = self.midi.orders.iter().filter(|(of, _)| *of == key).map(|(_, order)| match order {
            MidiOrder::Go => RunCommand::Go,
            MidiOrder::Back => RunCommand::Back,
            MidiOrder::Pause => RunCommand::Pause,
            MidiOrder::Resume => RunCommand::Resume,
            MidiOrder::Stop => RunCommand::Stop,
        });
        cues.chain(orders).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::live::{LiveSetpoints, NamedFiles};
    use proptest::prelude::*;

    const TABLE: &str = r#"
[live.knobs]
speed = { target = "wheel.frequency", least = "0.5 Hz", greatest = "2.5 Hz" }
size = { target = "wheel.amplitude", least = "0 deg", greatest = "163.83 deg" }
[live.midi]
channel = 2
bpm = 120
knobs = { cc1 = "speed", cc7-39 = "size", bend = "size" }
cues = { note60 = "calm", program3 = "calm" }
orders = { note36 = "go", cc64 = "pause", cc65 = "resume", note37 = "back", note38 = "stop" }
[[cue]]
name = "calm"
set = { "wheel.frequency" = "0.5 Hz" }
"#;

    fn text() -> String {
        "board = \"uno\"\n[motor.wheel]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = { step = 8, dir = 9 }\nforward = \"high\"\n\
         [[motion]]\nmotor = \"wheel\"\nlaw.sine = { amplitude = \"90 deg\", frequency = \"1 Hz\", cycles = \"forever\" }\n"
            .to_owned()
            + TABLE
    }

    fn heard(messages: &[&[u8]]) -> Vec<String> {
        let opened = LiveSetpoints::of(&text(), "m.toml", None, NamedFiles::none());
        let (desk, contents) = opened.map_err(|error| error.plain()).unwrap();
        let mut interpreter = Interpreter::new(contents.live.midi.unwrap());
        let requests = messages.iter().flat_map(|bytes| interpreter.hear(bytes, Duration::ZERO, &desk.knobs()));
        requests.map(|request| serde_json::to_string(&request).unwrap()).collect()
    }

    fn set(knob: &str, value: f64) -> String {
        format!(r#"{{"command":"set","knob":"{knob}","value":{value:?}}}"#)
    }

    #[test]
    fn dials_turn_knobs_from_least_to_greatest() {
        assert_eq!(heard(&[&[0xb1, 1, 0], &[0xb1, 1, 127]]), [set("speed", 0.5), set("speed", 2.5)]);
        // Of 14 bits: the first 7, and then all.
        let [coarse, fine] = &heard(&[&[0xb1, 7, 64], &[0xb1, 39, 1]])[..] else { panic!() };
        assert!(
            coarse.contains("\"value\":81.9") && fine.contains("\"value\":81.9") && coarse != fine,
            "{coarse} {fine}"
        );
        assert_eq!(heard(&[&[0xb1, 7, 127], &[0xb1, 39, 127]])[1], set("size", 163.83));
        assert_eq!(heard(&[&[0xe1, 127, 127], &[0xe1, 0, 0]]), [set("size", 163.83), set("size", 0.0)]);
    }

    #[test]
    fn keys_begin_cues_and_give_orders() {
        let cue = r#"{"command":"cue","name":"calm"}"#;
        assert_eq!(heard(&[&[0x91, 60, 100], &[0x91, 60, 0], &[0x81, 60, 64], &[0xc1, 3], &[0xc1, 4]]), [cue, cue]);
        let order = |name: &str| format!(r#"{{"command":"{name}"}}"#);
        let pedal: [&[u8]; 5] = [&[0xb1, 64, 63], &[0xb1, 64, 64], &[0xb1, 64, 127], &[0xb1, 64, 0], &[0xb1, 65, 127]];
        assert_eq!(heard(&pedal), [order("pause"), order("resume")], "a pedal acts when it is pressed");
        let keys: [&[u8]; 3] = [&[0x91, 36, 1], &[0x91, 37, 1], &[0x91, 38, 1]];
        assert_eq!(heard(&keys), ["go", "back", "stop"].map(order));
    }

    #[test]
    fn other_channels_and_other_messages_do_nothing() {
        let none: [&[u8]; 8] =
            [&[0xb0, 1, 5], &[0x90, 60, 9], &[0xfe], &[0xfa], &[0xfc], &[0xf0, 1, 0xf7], &[], &[0xb1, 1]];
        assert_eq!(heard(&none), Vec::<String>::new());
    }

    #[test]
    fn the_clock_sets_the_tempo() {
        let opened = LiveSetpoints::of(&text(), "m.toml", None, NamedFiles::none());
        let midi = opened.map_err(|error| error.plain()).unwrap().1.live.midi.unwrap();
        let mut interpreter = Interpreter::new(midi);
        let ticks = (0..200_u32).flat_map(|n| interpreter.hear(&[0xf8], Duration::from_micros(41_667) * n, &[]));
        assert_eq!(ticks.collect::<Vec<_>>(), [RunCommand::Tempo { rate: 0.5 }]);
    }

    proptest! {
        /// Whatever bytes come: no panic, and no value beyond a knob's range.
        #[test]
        fn any_bytes_are_safe(messages in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..5), 0..50)) {
            let messages: Vec<&[u8]> = messages.iter().map(Vec::as_slice).collect();
            for request in heard(&messages) {
                if let Ok(RunCommand::Set { knob, value: KnobValue::Number(value) }) = serde_json::from_str(&request) {
                    let range = if knob == "speed" { 0.5..=2.5 } else { 0.0..=163.83 };
                    prop_assert!(range.contains(&value), "{} {}", knob, value);
                }
            }
        }
    }
}
