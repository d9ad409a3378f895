//! Motions that are changed while they run. Shows on the native board in virtual time, and processes; nothing depends on how long something takes.

use proptest::prelude::*;
use pulsetrain::live::{Batch, KnobValue, LiveRun, LiveSetpoints, NamedFiles, RunCommand, RunEvent, TypedLine};
use pulsetrain_board::{Edge, Leased, Native};
use pulsetrain_motion::file::{MOST_OF_A_NAMED_FILE, read_named_text};
use pulsetrain_motion::program::Program;
use pulsetrain_session::control::{Ended, Status};
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_testkit::limits::{check_acceleration, check_speed};
use std::path::Path;
use std::sync::Arc;

/// Two motors, knobs and cues.
pub(crate) const TEXT: &str = r#"
board = "uno"
[motor.a]
steps_per_rev = 200
driver = "A4988"
pulse_high = "2 us"
pins = { step = 8, dir = 9 }
forward = "high"
max_speed = "4 rev/s"
max_acceleration = "30 rev/s^2"
[motor.b]
steps_per_rev = 200
driver = "A4988"
pulse_high = "2 us"
pins = { step = 10, dir = 11 }
forward = "high"
max_speed = "4 rev/s"
max_acceleration = "30 rev/s^2"
[[motion]]
motors = ["a", "b"]
law.sweep = { frequency = "1 Hz", swing = "40 step" }
[live.knobs]
speed = { target = "a.frequency", least = "0.1 Hz", greatest = "3 Hz", smoothing = "0.5 s" }
[[cue]]
name = "wide"
set = { "b.swing" = "80 step" }
follow = "1 s"
[[cue]]
name = "turn"
[[cue.motion]]
motor = "b"
law.trapezoid = { distance = "0.5 rev", speed = "1 rev/s", acceleration = "10 rev/s^2" }
[[cue]]
name = "the last"
set = { "a.frequency" = "0.5 Hz" }
fade = "1 s"
"#;

/// A show and what happened to it.
pub(crate) struct Stage<B> {
    pub(crate) show: LiveRun<B>,
    pub(crate) happened: Vec<RunEvent>,
    pub(crate) edges: Vec<Edge>,
    pub(crate) ended: Option<Ended>,
}

pub(crate) fn staged(text: &str) -> (LiveSetpoints, Prepared) {
    let opened = LiveSetpoints::of(text, "m.toml", None, NamedFiles::none());
    let (mut setpoints, contents) = opened.map_err(|error| error.plain()).unwrap();
    let mut prepared = Prepared::new("m.toml".to_owned(), contents, None).unwrap();
    prepared.prove_first(|_| {}).unwrap();
    setpoints.set_up(&prepared.program);
    (setpoints, prepared)
}

fn native(text: &str) -> Stage<Native> {
    let (setpoints, prepared) = staged(text);
    Stage::new(LiveRun::new(Driven::native(&prepared).unwrap(), setpoints, true))
}

impl<B: Leased> Stage<B> {
    pub(crate) fn new(show: LiveRun<B>) -> Stage<B> {
        Stage { show, happened: Vec::new(), edges: Vec::new(), ended: None }
    }

    /// A line, as it is typed. Gives whether it was one.
    pub(crate) fn line(&mut self, line: &str) -> bool {
        match TypedLine::read(line) {
            Ok(TypedLine::Command(request)) => self.ask(request),
            Ok(_) => {}
            Err(_) => return false,
        }
        true
    }

    pub(crate) fn ask(&mut self, batch: impl Into<Batch>) {
        let Stage { show, happened, edges, ended } = self;
        if ended.is_none() {
            *ended = show.handle(batch, &mut |edge: Edge| edges.push(edge), &mut |event| happened.push(event)).unwrap();
        }
    }

    pub(crate) fn step(&mut self) {
        let Stage { show, happened, edges, ended } = self;
        if ended.is_none() {
            *ended = show.step(&mut |edge: Edge| edges.push(edge), &mut |event| happened.push(event)).unwrap();
        }
    }

    pub(crate) fn run(&mut self, seconds: f64) {
        for _ in 0..(100.0 * seconds) as u32 {
            self.step();
        }
    }

    /// The next answer of a live motion that has not been looked at.
    #[track_caller]
    pub(crate) fn answer(&mut self) -> RunEvent {
        for _ in 0..1000 {
            // The motion's end is no answer.
            let is_answer = |event: &RunEvent| !event.is_of_session() && !matches!(event, RunEvent::MotionEnded { .. });
            if let Some(place) = self.happened.iter().position(is_answer) {
                return self.happened.remove(place);
            }
            self.step();
        }
        panic!("no answer within 10 s");
    }

    /// The motion's time now, s.
    fn now_s(&self) -> f64 {
        let progress = self.happened.iter().rev().find_map(|happened| match happened {
            RunEvent::Progress { at_s } => Some(*at_s),
            _ => None,
        });
        progress.unwrap_or(0.0)
    }

    /// The refusal of a line.
    #[track_caller]
    fn refused(&mut self, line: &str) -> String {
        assert!(self.line(line), "{line}");
        match self.answer() {
            RunEvent::Refused { why, .. } => why,
            other => panic!("{line}: {other:?}"),
        }
    }

    /// The last status.
    #[track_caller]
    fn status(&mut self) -> Status {
        self.happened.retain(|event| !event.is_of_session());
        for _ in 0..100 {
            self.step();
            let statuses = self.happened.iter().rev();
            let status = statuses.filter_map(|happened| match happened {
                RunEvent::Status(status) => Some(status.clone()),
                _ => None,
            });
            if let Some(status) = { status }.next() {
                return status;
            }
        }
        panic!("no status");
    }

    /// Stops, and waits for the end: the board counted what the host sent, or this is an error.
    #[track_caller]
    pub(crate) fn stop(&mut self) -> Ended {
        self.ask(RunCommand::Stop);
        self.run(10.0);
        self.ended.clone().expect("it stops")
    }
}

#[track_caller]
fn set(event: RunEvent) -> (String, f64, Option<String>, f64, f64) {
    match event {
        RunEvent::Set { knob, value, ceiling, from_s, until_s, .. } => (knob, value, ceiling, from_s, until_s),
        other => panic!("{other:?}"),
    }
}

/// Half the swing, seen from its middle, of a motor over the next seconds.
fn swing<B: Leased>(stage: &mut Stage<B>, motor: usize, seconds: f64) -> (i64, i64) {
    let (mut low, mut high) = (i64::MAX, i64::MIN);
    for _ in 0..(20.0 * seconds) as u32 {
        let position = stage.status().motors[motor].position;
        (low, high) = (low.min(position), high.max(position));
        stage.run(0.01);
    }
    (low, high)
}

#[test]
fn knobs_are_turned_to_what_the_motors_follow() {
    let mut stage = native(TEXT);
    stage.run(1.3);
    stage.line("speed 2 Hz");
    let (knob, value, ceiling, from_s, until_s) = set(stage.answer());
    assert_eq!((knob.as_str(), value, ceiling), ("speed", 2.0, None));
    assert!(from_s >= 1.2 && until_s - from_s >= 0.5 - 1e-6, "smoothing: {from_s} to {until_s}");
    // The knob's own range; and the motor's limit, which is named.
    stage.run(1.0);
    stage.line("speed 9");
    let (_, value, ceiling, ..) = set(stage.answer());
    assert!(value <= 3.0 && ceiling.is_some(), "{value}: {ceiling:?}");
    stage.run(3.0);
    stage.line("b.frequency = 50 Hz");
    let (_, value, ceiling, ..) = set(stage.answer());
    // The acceleration of a sweep is swing/2 (2 pi f)^2, and its limit 6000 step/s^2.
    let limit = (6000.0_f64 / 20.0).sqrt() / std::f64::consts::TAU;
    assert!((0.99 * limit..=limit * 1.001).contains(&value), "{value} Hz, not {limit}");
    assert_eq!(ceiling.as_deref(), Some("b: max_acceleration"));
    // A unit of the same kind, and the other motor of a shared motion is left alone.
    stage.run(3.0);
    stage.line("b.swing 36 deg");
    assert_eq!(set(stage.answer()).1, 20.0);
    stage.run(2.0);
    assert_eq!((swing(&mut stage, 1, 2.0), swing(&mut stage, 0, 2.0)), ((0, 20), (0, 40)));
    stage.stop();
}

/// Values far beyond what a motor can do become the nearest one that it can. The board's time that this takes is short: nothing else is obeyed meanwhile.
#[test]
fn a_value_of_any_size_becomes_the_nearest_that_the_motors_follow() {
    let mut stage = native(TEXT);
    stage.run(1.3);
    // A swing of 254.6 steps at 1 Hz has 4 rev/s, and one at 6.2 Hz of 40 steps has 30 rev/s^2 at 2.76 Hz.
    for (line, least, most, limit) in [
        ("b.swing 1e6 step", 252.0, 255.0, "b: max_speed"),
        ("b.swing 1e6 step", 252.0, 255.0, "b: max_speed"),
        ("b.swing 1e15 step", 252.0, 255.0, "b: max_speed"),
        ("b.swing 1e300 deg", 252.0 * 1.8, 255.0 * 1.8, "b: max_speed"),
        ("a.frequency 1e9 Hz", 2.7, 2.77, "a: max_acceleration"),
        ("a.frequency 1e30 Hz", 2.7, 2.77, "a: max_acceleration"),
    ] {
        stage.run(2.0);
        let asked_s = stage.now_s();
        stage.line(line);
        let searched_s = stage.now_s() - asked_s;
        assert!(searched_s <= 0.24, "{line}: {searched_s} s");
        let (_, value, ceiling, ..) = set(stage.answer());
        let value = if line.ends_with("deg") { value * 1.8 } else { value };
        assert!((least..=most).contains(&value), "{line}: {value}");
        assert_eq!(ceiling.as_deref(), Some(limit), "{line}");
    }
    assert!(stage.refused("b.swing -1e6 step").contains("more than 0"));
    stage.stop();
}

#[test]
fn what_is_no_value_is_refused_and_the_motion_goes_on() {
    let mut stage = native(TEXT);
    let mut check = |line: &str, part: &str| {
        let why = stage.refused(line);
        assert!(why.contains(part), "{line}: {why}");
    };
    check("a.frequnecy 1 Hz", "no knob `a.frequnecy`; did you mean `a.frequency`?");
    check("sped 1 Hz", "did you mean `speed`?");
    check("speed 1 s", "it must be a frequency, but this is a time");
    check("speed nan", "NaN is no number");
    check("speed inf", "inf is no number");
    check("speed fast", "does not begin with a number");
    check("speed 1 hz", "did you mean \"1 Hz\"?");
    check("b.swing 0 step", "more than 0");
    check("b.frequency -1 Hz", "must be more than 0 Hz");
    check("b.swing 10.5 step", "whole steps");
    check("cue wid", "did you mean \"wide\"?");
    check("back", "no cue before");
    check("goto 1 s", "it is a time");
    check("goto far", "is no position of motor a");
    stage.run(1.0);
    assert_eq!(swing(&mut stage, 0, 2.0), (0, 40));
    stage.stop();
}

#[test]
fn cues_follow_one_another_and_a_motion_that_ends_leaves_the_motor_at_rest() {
    let mut stage = native(TEXT);
    stage.run(0.7);
    stage.line("go");
    let cue = |event: RunEvent| match event {
        RunEvent::Cue { name, from_s, .. } => (name, from_s),
        other => panic!("{other:?}"),
    };
    let (name, wide_s) = cue(stage.answer());
    assert_eq!(name, "wide");
    let (name, turn_s) = cue(stage.answer());
    assert!(name == "turn" && (0.9..1.2).contains(&(turn_s - wide_s)), "{name} at {turn_s}");
    stage.run(5.0);
    assert_eq!(swing(&mut stage, 1, 2.0), (100, 100), "half a turn, and at rest");
    assert_eq!(swing(&mut stage, 0, 2.0), (0, 40), "the other one goes on");
    stage.line("cue the last");
    assert_eq!(cue(stage.answer()).0, "the last");
    let why = stage.refused("go");
    assert!(why.contains("the last cue"), "{why}");
    stage.line("back");
    assert_eq!(cue(stage.answer()).0, "turn");
    stage.stop();
}

#[test]
fn motors_rest_at_a_position_until_the_motion_is_wanted_again() {
    let mut stage = native(TEXT);
    stage.run(1.3);
    stage.line("goto 0");
    let RunEvent::Goto { until_s, from_s, .. } = stage.answer() else { panic!("no goto") };
    stage.run(until_s - from_s + 0.5);
    assert_eq!((swing(&mut stage, 0, 1.0), swing(&mut stage, 1, 1.0)), ((0, 0), (0, 0)));
    // A knob that is turned does not move motors that were sent home.
    stage.line("a.swing 20 step");
    assert_eq!(set(stage.answer()).1, 20.0);
    stage.run(0.5);
    assert_eq!(swing(&mut stage, 0, 1.0), (0, 0));
    stage.line("resume");
    assert!(matches!(stage.answer(), RunEvent::Returned { .. }));
    stage.run(3.0);
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 20), (0, 40)));
    stage.stop();
}

#[test]
fn arms_are_not_sent_beyond_the_angles_of_their_machine() {
    let delta = include_str!("../../../../examples/delta.toml");
    let mut stage = native(delta);
    stage.run(0.5);
    let why = stage.refused("goto 90 rev");
    let range = "motor a cannot go to 32400 deg: `angles` of machine robot allow -40 deg to 80 deg";
    assert!(why.contains(range) && why.contains("write a position from -40 deg to 80 deg"), "{why}");
    assert!(stage.refused("goto 80.1 deg").contains("allow -40 deg to 80 deg"));
    // What is written as an example is in the range.
    let why = stage.refused("goto 10 mm");
    assert!(why.contains("has no `lead`") && why.contains("write it like \"20 deg\""), "{why}");
    for line in ["goto 20 deg", "goto 80 deg", "goto -40 deg", "goto 0"] {
        stage.line(line);
        let RunEvent::Goto { from_s, until_s, .. } = stage.answer() else { panic!("{line}") };
        stage.run(until_s - from_s + 0.1);
    }
    // A changed file has other angles.
    let text = delta.replace("[\"-40 deg\", \"80 deg\"]", "[\"-50 deg\", \"85 deg\"]");
    stage.ask(RunCommand::Motion { text, files: Default::default() });
    assert!(matches!(stage.answer(), RunEvent::Motion { .. }));
    assert!(stage.refused("goto 85.1 deg").contains("allow -50 deg to 85 deg"));
    stage.line("goto 85 deg");
    assert!(matches!(stage.answer(), RunEvent::Goto { .. }));
    stage.stop();
}

#[test]
fn a_changed_file_is_taken_over_or_refused_with_its_place() {
    let mut stage = native(TEXT);
    stage.run(1.3);
    let file = |stage: &mut Stage<Native>, text: &str| {
        stage.ask(RunCommand::Motion { text: text.to_owned(), files: Default::default() });
        stage.answer()
    };
    stage.line("a.swing 20 step");
    set(stage.answer());
    // The frequency is the file's; the swing stays as the knob was turned.
    let text = TEXT.replace("frequency = \"1 Hz\"", "frequency = \"0.5 Hz\"");
    assert!(matches!(file(&mut stage, &text), RunEvent::Motion { .. }));
    stage.run(3.0);
    assert_eq!((swing(&mut stage, 0, 3.0), swing(&mut stage, 1, 3.0)), ((0, 20), (0, 40)));
    // A new value in the file goes before that of the knob.
    assert!(matches!(file(&mut stage, &text.replace("40 step", "60 step")), RunEvent::Motion { .. }));
    stage.run(3.0);
    assert_eq!(swing(&mut stage, 0, 3.0), (0, 60));
    let refused = |event: RunEvent| match event {
        RunEvent::MotionRefused { error, line, column } => (error, line.zip(column)),
        other => panic!("{other:?}"),
    };
    let (error, place) = refused(file(&mut stage, &text.replace("0.5 Hz", "0.5 s")));
    assert!(error.starts_with("`frequency` must be a frequency") && place == Some((21, 27)), "{error} at {place:?}");
    let (error, place) = refused(file(&mut stage, &text[..text.len() / 2]));
    assert!(place.is_some(), "a half file: {error}");
    let (error, _) = refused(file(&mut stage, &text.replace("step = 8", "step = 12")));
    assert!(error.starts_with("the pins of motor a changed. That is set up when a motion begins"), "{error}");
    let (error, _) = refused(file(&mut stage, &text.replace("board = \"uno\"", "board = \"pico\"")));
    assert!(error.contains("the board was \"uno\", and is \"pico\" now"), "{error}");
    let (error, _) = refused(file(&mut stage, &text.replace("frequency = \"0.5 Hz\"", "frequency = \"90 Hz\"")));
    assert!(error.contains("limit"), "{error}");
    stage.run(1.0);
    assert_eq!(swing(&mut stage, 0, 3.0), (0, 60), "the old motion goes on");
    stage.stop();
}

/// Lines that act together.
pub(crate) fn together(lines: &[&str], at_s: Option<f64>) -> Batch {
    let command = |line: &&str| match TypedLine::read(line) {
        Ok(TypedLine::Command(request)) => request,
        other => panic!("{line}: {other:?}"),
    };
    Batch { commands: lines.iter().map(command).collect(), at_s }
}

/// A knob, its value, and the limit that keeps it from the wanted one.
type Turned = (String, f64, Option<String>);

/// The times of the next change, all of whose answers have the same ones, and what was answered.
#[track_caller]
pub(crate) fn one_change<B: Leased>(stage: &mut Stage<B>, answers: usize) -> (f64, f64, Vec<Turned>) {
    let all: Vec<_> = (0..answers).map(|_| set(stage.answer())).collect();
    let (from_s, until_s) = (all[0].3, all[0].4);
    assert!(until_s > from_s, "{all:?}");
    assert!(all.iter().all(|set| (set.3, set.4) == (from_s, until_s)), "{all:?}");
    (from_s, until_s, all.into_iter().map(|(knob, value, ceiling, ..)| (knob, value, ceiling)).collect())
}

/// The tempo's changes, and when the motion had the new tempo.
fn tempos<B>(stage: &Stage<B>) -> Vec<(f64, f64)> {
    let tempo = |happened: &RunEvent| match happened {
        RunEvent::Tempo { rate, from_s, .. } => Some((*rate, *from_s)),
        _ => None,
    };
    stage.happened.iter().filter_map(tempo).collect()
}

/// A fader sends many values: those that the motors never followed are not reported.
#[test]
fn of_many_values_of_a_knob_the_last_one_is_answered() {
    let mut stage = native(TEXT);
    stage.run(0.4);
    stage.ask(together(&["a.swing 10 step", "b.swing 30 step", "a.swing 20 step"], None));
    let (_, _, values) = one_change(&mut stage, 2);
    assert_eq!(values, [("b.swing".to_owned(), 30.0, None), ("a.swing".to_owned(), 20.0, None)]);
    // While two changes are under way, the others wait.
    stage.happened.clear();
    for step in 21..=30 {
        stage.line(&format!("a.swing {step} step"));
        stage.run(0.01);
    }
    stage.run(3.0);
    let answered = stage.happened.iter().filter_map(|happened| match happened {
        RunEvent::Set { value, .. } => Some(*value),
        _ => None,
    });
    let answered: Vec<f64> = answered.collect();
    assert!(answered.len() < 6 && answered.last() == Some(&30.0), "{answered:?}");
    stage.stop();
}

#[test]
fn a_motion_that_has_ended_begins_again() {
    let (motors, _) = TEXT.split_once("law.sweep").unwrap();
    let mut stage = native(&format!("{motors}law.sine = {{ amplitude = \"40 step\", period = \"1 s\", cycles = 2 }}"));
    stage.run(1.0);
    stage.line("begin");
    assert_eq!(stage.answer(), RunEvent::AlreadyRuns);
    stage.run(6.0);
    assert_eq!((swing(&mut stage, 0, 1.0), swing(&mut stage, 1, 1.0)), ((0, 0), (0, 0)), "it has ended");
    stage.line("begin");
    assert!(matches!(stage.answer(), RunEvent::Began { .. }));
    assert_ne!(swing(&mut stage, 0, 2.0), (0, 0));
    stage.stop();
}

#[test]
fn what_comes_together_is_one_change() {
    let mut stage = native(TEXT);
    stage.run(0.4);
    stage.ask(together(&["a.frequency 2 Hz", "b.swing 20 step", "tempo 0.5", "a.swing 20 step"], None));
    let (from_s, _, _) = one_change(&mut stage, 3);
    assert!((0.4..0.42).contains(&from_s), "{from_s}");
    let [(rate, full_s)] = tempos(&stage)[..] else { panic!("{:?}", tempos(&stage)) };
    assert!(rate == 0.5 && full_s > from_s && full_s < from_s + 1.0, "{rate} from {full_s} s");
    stage.run(3.0);
    assert_eq!((swing(&mut stage, 0, 3.0), swing(&mut stage, 1, 3.0)), ((0, 20), (0, 20)));
    // A cue with a knob and a tempo: the cue's numbers, but for the knob.
    stage.happened.clear();
    stage.ask(together(&["cue wide", "a.swing 60 step", "tempo 1"], None));
    let RunEvent::Cue { from_s, until_s, .. } = stage.answer() else { panic!("no cue") };
    let (_, value, _, set_from_s, set_until_s) = set(stage.answer());
    assert_eq!((value, set_from_s, set_until_s), (60.0, from_s, until_s));
    assert_eq!(tempos(&stage)[0].0, 1.0);
    stage.stop();
}

#[test]
fn values_that_hold_together_are_taken_and_others_are_limited_one_by_one() {
    let mut stage = native(TEXT);
    stage.run(0.4);
    // 40 steps at 3.5 Hz are too much; half of them are not.
    stage.ask(together(&["b.frequency 3.5 Hz", "b.swing 20 step"], None));
    let (_, _, answers) = one_change(&mut stage, 2);
    assert!(answers.iter().all(|(.., ceiling)| ceiling.is_none()), "{answers:?}");
    stage.run(2.0);
    stage.ask(together(&["b.frequency 50 Hz", "a.swing 20 step", "c.swing 1 step"], None));
    let RunEvent::Refused { why, .. } = stage.answer() else { panic!("there is no c") };
    assert!(why.starts_with("there is no knob `c.swing`"), "{why}");
    let (_, _, answers) = one_change(&mut stage, 2);
    assert!(answers[0].1 < 50.0 && answers[0].2.as_deref() == Some("b: max_acceleration"), "{answers:?}");
    assert_eq!(answers[1], ("a.swing".to_owned(), 20.0, None));
    stage.stop();
}

#[test]
fn a_change_for_a_time_begins_at_its_tick() {
    // Within two ticks of an Uno: the time is a number of seconds.
    let near = |at_s: f64, from_s: f64| assert!((from_s - at_s).abs() < 2.0 / 16e6, "{from_s} s, for {at_s} s");
    let mut stage = native(TEXT);
    stage.run(0.4);
    stage.ask(together(&["a.swing 20 step", "b.frequency 0.5 Hz"], Some(0.7)));
    near(0.7, one_change(&mut stage, 2).0);
    // One that is late, one whose value has to be looked for, one that only has the tempo; and another one meanwhile.
    stage.run(1.0);
    let late_s = stage.status().at_s - 0.1;
    stage.ask(together(&["a.swing 22 step"], Some(late_s)));
    let (from_s, ..) = one_change(&mut stage, 1);
    assert!((late_s..late_s + 0.15).contains(&from_s), "{from_s} s, for {late_s} s");
    let late = |event: RunEvent| match event {
        RunEvent::Late { wanted_s, by_s } => (wanted_s, by_s),
        other => panic!("{other:?}"),
    };
    let (wanted_s, by_s) = late(stage.answer());
    near(late_s, wanted_s);
    near(from_s - late_s, by_s);
    // A late pause is reported, too. One that comes in time is not late.
    let late_s = stage.status().at_s - 0.1;
    stage.ask(together(&["pause"], Some(late_s)));
    let (wanted_s, by_s) = late(stage.answer());
    near(late_s, wanted_s);
    assert!((0.1..0.15).contains(&by_s), "{by_s}");
    stage.run(1.0);
    stage.line("resume");
    stage.run(1.0);
    let now_s = stage.status().at_s;
    let (third_s, fourth_s) = (now_s + 0.5, now_s + 3.0);
    stage.ask(together(&["tempo 0.5"], Some(fourth_s)));
    stage.ask(together(&["b.frequency 50 Hz"], Some(third_s)));
    assert!(stage.line("a.swing 30 step"));
    let (from_s, ..) = one_change(&mut stage, 1);
    assert!(from_s < now_s + 0.1, "{from_s}");
    let (from_s, _, answers) = one_change(&mut stage, 1);
    near(third_s, from_s);
    assert!(answers[0].2.is_some(), "{answers:?}");
    stage.run(3.0);
    assert!(tempos(&stage)[0].1 > fourth_s && tempos(&stage)[0].1 < fourth_s + 0.5, "{:?}", tempos(&stage));
    // A stop is given in the step before its tick.
    let stop_s = stage.status().at_s + 1.0;
    stage.ask(together(&["stop"], Some(stop_s)));
    stage.run(5.0);
    let stopping = stage.happened.iter().find_map(|happened| match happened {
        RunEvent::Stopping { at_s } => Some(*at_s),
        _ => None,
    });
    assert!(stopping.is_some_and(|at_s| (at_s - stop_s).abs() < 0.015), "{stopping:?}, for {stop_s} s");
    assert!(stage.ended.is_some_and(|ended| ended.stopped));
}

#[test]
fn targets_are_those_of_the_laws_that_the_motors_follow() {
    let mut stage = native(TEXT);
    stage.run(0.4);
    // A status comes between the request for each of these changes and its tick.
    for number in 0..10 {
        let at_s = stage.now_s() + 0.3 + 0.005 * f64::from(number);
        stage.ask(together(&[if number % 2 == 0 { "b.frequency 1.5 Hz" } else { "b.frequency 1 Hz" }], Some(at_s)));
        stage.run(1.0);
    }
    let errors: Vec<f64> = stage
        .happened
        .iter()
        .filter_map(|happened| match happened {
            RunEvent::Status(status) => Some(&status.motors[1]),
            _ => None,
        })
        .map(|motor| (motor.position as f64 - motor.target.unwrap()).abs())
        .collect();
    let worst = errors.iter().copied().fold(0.0, f64::max);
    assert!(errors.len() > 150 && worst < 1.0, "{worst} steps, of {} statuses", errors.len());
    stage.stop();
}

#[test]
fn too_many_and_too_far_are_refused() {
    let mut stage = native(TEXT);
    stage.run(0.1);
    stage.ask(together(&["a.swing 20 step", "tempo 2"], Some(61.0)));
    let RunEvent::Refused { why, .. } = stage.answer() else { panic!("it is too far ahead") };
    assert_eq!(why, "it is for 60.9 s from now; 60 s are the most");
    (0..1024).for_each(|_| stage.ask(together(&["a.swing 20 step"], Some(30.0))));
    stage.ask(together(&["a.swing 20 step"], Some(30.0)));
    let RunEvent::Refused { why, .. } = stage.answer() else { panic!("there are too many") };
    assert_eq!(why, "1024 changes wait for their time already");
    stage.stop();
}

/// What the schedule asks for.
#[test]
fn motors_rest_until_the_motion_is_to_begin_from_its_start() {
    let (mut setpoints, mut prepared) = staged(TEXT);
    prepared.program = setpoints.resting_at(&[0.0, 0.0]).unwrap();
    setpoints.set_up(&prepared.program);
    let mut stage = Stage::new(LiveRun::at_rest(Driven::native(&prepared).unwrap(), setpoints, true));
    let rest = |in_place, until: &str| RunCommand::Rest { in_place, until: until.to_owned() };
    stage.ask(rest(false, "Mon"));
    assert!(matches!(stage.answer(), RunEvent::Resting { until } if until == "Mon"));
    stage.run(1.0);
    assert!(stage.show.is_resting());
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 0), (0, 0)));
    // A cue at the same time comes after the beginning.
    stage.ask(RunCommand::Begin);
    stage.line("cue wide");
    let RunEvent::Began { from_s, .. } = stage.answer() else { panic!("no beginning") };
    assert!((4.9..5.3).contains(&from_s), "{from_s}");
    assert!(matches!(stage.answer(), RunEvent::Cue { .. }));
    stage.run(0.8);
    assert!(!stage.show.is_resting());
    assert_eq!(swing(&mut stage, 0, 2.0), (0, 40));
    // The next cue has followed meanwhile.
    stage.happened.clear();
    stage.line("begin");
    assert_eq!(stage.answer(), RunEvent::AlreadyRuns);
    stage.ask(rest(false, "Tue"));
    while !matches!(stage.answer(), RunEvent::Resting { .. }) {}
    stage.run(3.0);
    assert!(stage.show.is_resting());
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 0), (0, 0)));
    stage.ask(RunCommand::Begin);
    assert!(matches!(stage.answer(), RunEvent::Began { .. }));
    assert!(stage.show.law_time() < pulsetrain_motion::Time::from_seconds(0.5), "from its beginning");
    stage.run(2.0);
    // Without the cue of the day before.
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 40), (0, 40)));
    // In place: it goes on where it was.
    stage.ask(rest(true, ""));
    stage.run(2.0);
    assert!(stage.show.is_resting());
    stage.line("resume");
    stage.run(2.0);
    assert_eq!(swing(&mut stage, 0, 2.0), (0, 40));
    stage.stop();
}

/// The board is lost, and counts from elsewhere when it is there again.
#[test]
fn a_motion_goes_on_with_another_session_from_where_the_motors_stand() {
    for parked in [false, true] {
        let mut stage = native(TEXT);
        stage.run(1.3);
        stage.line("tempo 0.5");
        stage.run(1.0);
        if parked {
            stage.line("goto 20 step");
            stage.run(2.0);
        }
        let law_time = stage.show.law_time();
        let (_, mut suspended) = stage.show.suspend();
        let mut heard = Vec::new();
        suspended.handle(RunCommand::Pause, &mut |event| heard.push(event));
        let wider = TEXT.replace("40 step", "60 step");
        let motion = RunCommand::Motion { text: wider, files: Default::default() };
        suspended.handle(motion, &mut |event| heard.push(event));
        assert!(matches!(heard[..], [RunEvent::Refused { .. }, RunEvent::Motion { .. }]), "{heard:?}");
        let (_, mut prepared) = staged(TEXT);
        prepared.program = suspended.setpoints().resting_at(&[13.0, -7.0]).unwrap();
        let driven = Driven::native(&prepared).unwrap();
        let mut stage = Stage::new(suspended.rejoin_on(driven, &prepared.program, 10.0));
        if parked {
            stage.run(1.0);
            assert_eq!((swing(&mut stage, 0, 1.0), stage.show.is_resting()), ((0, 0), true));
        } else {
            assert!(matches!(stage.answer(), RunEvent::Rejoined { times: 1, .. }));
            let went_on = stage.show.law_time().seconds() - law_time.seconds();
            assert!((5.0..5.5).contains(&went_on), "at tempo 0.5: {went_on}");
            stage.run(4.0);
            // The board counts from 13 and -7.
            assert_eq!((swing(&mut stage, 0, 4.0), swing(&mut stage, 1, 4.0)), ((-13, 47), (7, 67)));
        }
        stage.line("goto 0");
        while !matches!(stage.answer(), RunEvent::Goto { .. }) {}
        stage.run(4.0);
        assert_eq!(stage.stop().counted, [-13, 7], "where the motion begins");
    }
}

/// Both motors at a constant speed.
fn turning() -> String {
    let law = "law.speed = { speed = \"1 rev/s\" }\nbegin = \"ramp\"";
    let text = TEXT.replace("law.sweep = { frequency = \"1 Hz\", swing = \"40 step\" }", law);
    text.split("[live.knobs]").next().unwrap().to_owned()
}

/// A knob on a constant speed changes it from where the motor is: as quickly after minutes as at first, to 0 and to the other direction.
#[test]
fn a_speed_changes_from_where_the_motor_is() {
    let mut stage = native(&turning());
    stage.run(200.0);
    let mut speed_is = |line: &str, steps_per_s: f64| {
        let before = stage.status().motors[0].position;
        assert!(stage.line(line), "{line}");
        let (_, _, ceiling, from_s, until_s) = set(stage.answer());
        assert!(ceiling.is_none() && until_s - from_s < 0.3, "{line}: {ceiling:?}, {from_s} to {until_s}");
        stage.run(0.5);
        let (then, at_s) = (stage.status().motors[0].position, stage.now_s());
        assert!((then - before).abs() < 400, "{line}: from {before} to {then}");
        stage.run(2.0);
        let (now, now_s) = (stage.status().motors[0].position, stage.now_s());
        let made = (now - then) as f64 / (now_s - at_s);
        assert!((made - steps_per_s).abs() < 4.0, "{line}: {made} steps/s");
    };
    speed_is("a.speed 2 rev/s", 400.0);
    speed_is("a.speed -2 rev/s", -400.0);
    speed_is("a.speed 0 rev/s", 0.0);
    speed_is("a.speed 1 rev/s", 200.0);
    // A position is reached from afar; from there a speed begins.
    stage.line("goto 90 deg");
    let RunEvent::Goto { until_s, .. } = stage.answer() else { panic!("it goes there") };
    stage.run(until_s - stage.now_s() + 60.0);
    assert_eq!(stage.status().motors.iter().map(|motor| motor.position).collect::<Vec<_>>(), [50, 50]);
    stage.line("resume");
    let RunEvent::Returned { from_s, until_s } = stage.answer() else { panic!("it returns") };
    assert!(until_s - from_s < 0.5, "{from_s} to {until_s}");
    stage.run(2.0);
    stage.stop();
    stage.check_limits();
}

/// The board is lost after a speed was changed: with another session the motor joins its way where that would be by now.
#[test]
fn a_changed_speed_goes_on_with_another_session() {
    let mut stage = native(&turning());
    stage.run(100.0);
    assert!(stage.line("a.speed -0.5 rev/s"));
    stage.run(2.0);
    let stood: Vec<f64> = stage.status().motors.iter().map(|motor| motor.position as f64).collect();
    let (_, suspended) = stage.show.suspend();
    let (_, mut prepared) = staged(&turning());
    prepared.program = suspended.setpoints().resting_at(&stood).unwrap();
    let driven = Driven::native(&prepared).unwrap();
    let mut stage = Stage::new(suspended.rejoin_on(driven, &prepared.program, 3.0));
    let RunEvent::Rejoined { from_s, until_s, .. } = stage.answer() else { panic!("it joins again") };
    assert!(until_s - from_s < 10.0, "{from_s} to {until_s}");
    stage.run(until_s - stage.now_s() + 1.0);
    let status = stage.status();
    let [a, b] = [0, 1].map(|motor| status.motors[motor].position as f64);
    // 3 s without a board, and the time since then.
    let passed_s = 3.0 + status.at_s;
    assert!((a + 100.0 * passed_s).abs() < 20.0 && (b - 200.0 * passed_s).abs() < 20.0, "{a} and {b} in {passed_s} s");
    stage.stop();
    stage.check_limits();
}

/// The board is lost again before its motors have begun to join the motion: they join it when it is back.
#[test]
fn motors_join_the_motion_though_their_board_was_lost_twice() {
    let mut stage = native(TEXT);
    stage.run(1.3);
    let (_, suspended) = stage.show.suspend();
    let (_, mut prepared) = staged(TEXT);
    prepared.program = suspended.setpoints().resting_at(&[20.0, 20.0]).unwrap();
    let again = suspended.rejoin_on(Driven::native(&prepared).unwrap(), &prepared.program, 1.0);
    let (_, suspended) = again.suspend();
    let driven = Driven::native(&prepared).unwrap();
    let mut stage = Stage::new(suspended.rejoin_on(driven, &prepared.program, 1.0));
    let RunEvent::Rejoined { times, until_s, .. } = stage.answer() else { panic!("it joins again") };
    assert_eq!(times, 2);
    stage.run(until_s - stage.now_s() + 0.1);
    assert_ne!(swing(&mut stage, 0, 1.0), (0, 0));
    stage.stop();
}

#[test]
fn somebody_says_where_motors_stand() {
    let setpoints = staged(TEXT).0;
    let places =
        |motor, position| setpoints.places(motor, position, Some(&[1.0, 2.0])).map_err(|error| error.to_string());
    assert_eq!(places(None, "0"), Ok(vec![(0, 0.0), (1, 0.0)]));
    assert_eq!(places(None, "last"), Ok(vec![(0, 1.0), (1, 2.0)]));
    assert_eq!(places(Some("b"), "90 deg"), Ok(vec![(1, 50.0)]));
    assert!(places(Some("c"), "0").unwrap_err().contains("no motor `c`"));
    assert!(places(None, "1 s").unwrap_err().contains("it is a time"));
    let unknown = setpoints.places(None, "last", None).unwrap_err().to_string();
    assert!(unknown.contains("the last position at rest is not known"), "{unknown}");
}

/// A swing of `a` that grows for 50 s where `growth` is more than 0, and a swing of `b` that is left alone.
fn growing(growth: &str) -> String {
    let laws = format!(
        r#"[[motion]]
motor = "a"
[motion.law.formula]
theta = "20*sin(2*pi*t)^2 + if(t > 40, growth*(t - 40)^4, 0)"
unit = "step"
where = {{ growth = {growth} }}
[[motion]]
motor = "b"
law.sweep = {{ frequency = "1 Hz", swing = "40 step" }}
"#
    );
    let (motors, rest) = TEXT.split_once("[[motion]]").unwrap();
    let (_, rest) = rest.split_once("[live.knobs]").unwrap();
    let cues = &rest[rest.find("[[cue]]").unwrap()..rest.find("[[cue]]\nname = \"the last").unwrap()];
    format!("{motors}{laws}{cues}")
}

impl<B: Leased> Stage<B> {
    /// The next change that is taken back: why, whether the motors rest, and when they follow the earlier motion.
    #[track_caller]
    fn taken_back(&mut self) -> (String, bool, f64) {
        for _ in 0..6000 {
            if let Some(place) = self.happened.iter().position(|event| !event.is_of_session()) {
                let event = self.happened.remove(place);
                let RunEvent::TakenBack { why, rests, until_s, .. } = event else { panic!("{event:?}") };
                return (why, rests, until_s);
            }
            self.step();
        }
        panic!("nothing was taken back within a minute");
    }

    /// The present value of a knob.
    fn knob(&self, name: &str) -> f64 {
        self.show.setpoints().knobs().iter().find(|knob| knob.name == name).unwrap().value
    }

    /// Holds every step of all motors against their limits.
    #[track_caller]
    fn check_limits(&self) {
        check_limits(&self.edges, self.show.setpoints().setup()).unwrap();
    }
}

/// Holds the steps of all motors against their max_speed and max_acceleration. Motors with a pull-in rate may jump to a speed: their acceleration is
/// not looked at.
///
/// # Errors
/// The motor, the limit, and the place.
pub(crate) fn check_limits(edges: &[Edge], program: &Program) -> Result<(), String> {
    let (lines, hz) = (pulsetrain_trace::lines::of(program), program.board.tick_hz);
    for motor in &program.motors {
        let line = |what: &str| {
            let name = format!("{}.{what}", motor.name);
            lines.iter().position(|line| line.names.contains(&name))
        };
        let (step_line, dir_line) = (line("step"), line("dir"));
        let (mut steps, mut way) = (Vec::new(), 1);
        for edge in edges {
            let line = Some(usize::from(edge.line));
            if line == dir_line {
                way = if edge.level { 1 } else { -1 };
            } else if edge.level && line == step_line {
                steps.push((edge.tick, way));
            }
        }
        let names = dir_line.map_or(&[][..], |line| &lines[line].names);
        let shares_dir = names.iter().filter(|name| name.ends_with(".dir")).count() > 1;
        // A step may be off by the tolerance. One that waits for a shared DIR line comes later, and so may the one before it.
        let off = program.tolerance.ticks(hz) + 0.5;
        let reversal = program.timing(motor).ticks(hz).reversal() as f64;
        let doubt = if shares_dir { off + 4.0 * reversal * program.motors.len() as f64 } else { off };
        if let Some(max_speed) = motor.limits.max_speed {
            check_speed(&steps, hz, max_speed, doubt).map_err(|error| format!("{}: {error}", motor.name))?;
        }
        if let Some(limit) = motor.limits.max_acceleration.filter(|_| motor.limits.pull_in == 0.0) {
            check_acceleration(&steps, hz, limit, doubt).map_err(|error| format!("{}: {error}", motor.name))?;
        }
    }
    Ok(())
}

/// A formula that breaks a limit long after the change to it was accepted: the motors brake, and join the motion before that change.
#[test]
fn a_change_that_is_refused_later_is_taken_back() {
    let mut stage = native(&growing("0"));
    stage.run(2.0);
    stage.line("a.growth 20");
    let (_, value, ceiling, ..) = set(stage.answer());
    assert_eq!((value, ceiling, stage.knob("a.growth")), (20.0, None, 20.0), "half a minute of it keeps to the limits");
    let (why, rests, until_s) = stage.taken_back();
    assert!(why.contains("motor a") && why.contains("limit is 800.0 steps/s") && !rests, "{why}");
    assert!((38.0..60.0).contains(&until_s), "{until_s}");
    assert_eq!(stage.knob("a.growth"), 0.0);
    let is_rejoined = |event: &RunEvent| !event.is_of_session() || matches!(event, RunEvent::Failed { .. });
    assert!(!stage.happened.iter().any(is_rejoined), "it is reported once");
    // Both follow the earlier laws again, at their own time.
    stage.run(until_s - stage.now_s() + 2.0);
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 20), (0, 40)));
    let status = stage.status();
    let [a, b] = [&status.motors[0], &status.motors[1]].map(|motor| motor.target.unwrap());
    let turn = std::f64::consts::TAU * status.at_s;
    assert!((a - 20.0 * turn.sin().powi(2)).abs() < 0.1, "{a} at {}", status.at_s);
    assert!((b - 20.0 * (1.0 - turn.cos())).abs() < 0.1, "{b} at {}", status.at_s);
    // A knob is turned as ever.
    stage.line("b.swing 20 step");
    assert_eq!(set(stage.answer()).1, 20.0);
    stage.run(3.0);
    stage.stop();
    stage.check_limits();
}

/// Of several changes the one that cannot go on is found: those after it go with it.
#[test]
fn what_is_taken_back_is_followed_only_if_it_is_sound() {
    let mut stage = native(&growing("0"));
    stage.run(1.0);
    for line in ["b.swing 20 step", "a.growth 20", "b.swing 30 step", "b.frequency 1.2 Hz"] {
        stage.line(line);
        assert_eq!(set(stage.answer()).2, None, "{line}");
        stage.run(2.0);
    }
    let (why, rests, until_s) = stage.taken_back();
    assert!(why.contains("motor a") && !rests, "{why}");
    assert_eq!([stage.knob("a.growth"), stage.knob("b.swing"), stage.knob("b.frequency")], [0.0, 20.0, 1.0]);
    stage.run(until_s - stage.now_s() + 1.0);
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 20), (0, 20)));
    stage.stop();
    stage.check_limits();
}

/// The file's own motion cannot go on: there is nothing to join. The motors rest until a request starts the motion.
#[test]
fn motors_rest_where_no_earlier_motion_can_be_followed() {
    let mut stage = native(&growing("20"));
    stage.run(2.0);
    stage.line("b.swing 20 step");
    set(stage.answer());
    let (why, rests, _) = stage.taken_back();
    assert!(why.contains("motor a") && rests, "{why}");
    stage.run(1.0);
    let place = [0, 1].map(|motor| swing(&mut stage, motor, 1.0));
    assert!(place.iter().all(|(low, high)| low == high), "at rest: {place:?}");
    assert!(stage.show.is_resting());
    // From here on its laws break the limits, so a return to them is refused.
    let why = stage.refused("go");
    assert!(why.contains("max_"), "{why}");
    // From its beginning the motion keeps the limits for its first 45 s again.
    stage.line("begin");
    let began = stage.answer();
    let RunEvent::Began { until_s, .. } = began else { panic!("{began:?}") };
    stage.run(until_s - stage.now_s() + 1.0);
    assert_eq!((swing(&mut stage, 0, 2.0), swing(&mut stage, 1, 2.0)), ((0, 20), (0, 40)));
    stage.stop();
    stage.check_limits();
}

/// A motor that turns at up to 350 steps/s from 45 s on: 2.5 times that is too fast. A swing of `b` that is left alone.
fn turning_later() -> String {
    let from = "20*sin(2*pi*t)^2 + if(t > 40, growth*(t - 40)^4, 0)";
    let text = growing("350").replace(from, "growth*(sqrt((t - 45)^2 + 4) + (t - 45))/2");
    assert!(!text.contains(from));
    text
}

/// A tempo is taken back as a change is, and so are the changes after it.
#[test]
fn a_tempo_that_is_refused_later_is_taken_back() {
    for is_first in [true, false] {
        let mut stage = native(&turning_later());
        stage.run(2.0);
        if !is_first {
            stage.line("b.swing 20 step");
            assert_eq!(set(stage.answer()).1, 20.0);
            stage.run(2.0);
        }
        stage.line("tempo 2.5");
        stage.run(1.0);
        assert_eq!(tempos(&stage)[0].0, 2.5, "half a minute of it keeps to the limits");
        stage.line("b.frequency 0.8 Hz");
        assert_eq!(set(stage.answer()).2, None);
        stage.happened.clear();
        let (why, rests, until_s) = stage.taken_back();
        assert!(why.contains("motor a") && !rests, "{why}");
        assert_eq!(tempos(&stage).iter().map(|tempo| tempo.0).collect::<Vec<_>>(), [1.0]);
        let swing_b = if is_first { 40 } else { 20 };
        assert_eq!([stage.knob("b.swing"), stage.knob("b.frequency")], [f64::from(swing_b), 1.0]);
        let at_s = until_s + 2.0;
        stage.run(at_s - stage.now_s());
        assert_eq!(swing(&mut stage, 1, 2.0), (0, i64::from(swing_b)));
        stage.run(30.0);
        let speed = stage.status().motors[0].speed.unwrap();
        assert!((340.0..=350.1).contains(&speed), "at the file's tempo: {speed}");
        stage.stop();
        stage.check_limits();
    }
}

/// Motors that leave the motion for a position and come back follow no other motion: those before it are still known.
#[test]
fn a_return_to_the_motion_pushes_out_no_earlier_one() {
    let mut stage = native(&growing("0"));
    stage.run(0.5);
    for line in ["b.swing 20 step", "a.growth 20"] {
        stage.line(line);
        assert_eq!(set(stage.answer()).2, None, "{line}");
    }
    for _ in 0..8 {
        stage.line("goto 0");
        assert!(matches!(stage.answer(), RunEvent::Goto { .. }));
        stage.line("resume");
        assert!(matches!(stage.answer(), RunEvent::Returned { .. }));
    }
    assert!(stage.now_s() < 40.0);
    let (_, rests, _) = stage.taken_back();
    assert!(!rests);
    assert_eq!([stage.knob("a.growth"), stage.knob("b.swing")], [0.0, 20.0]);
    stage.stop();
    stage.check_limits();
}

/// A start of the schedule is no error if a client began the motion before.
#[test]
fn a_start_changes_nothing_while_the_motion_runs() {
    for start in ["begin", "resume"] {
        let mut stage = native(TEXT);
        stage.run(1.0);
        if start == "resume" {
            for line in ["pause", "resume"] {
                stage.line(line);
                stage.run(2.0);
            }
        }
        stage.happened.clear();
        stage.line(start);
        assert_eq!(stage.answer(), RunEvent::AlreadyRuns, "{start}");
        assert_ne!(swing(&mut stage, 0, 2.0).1, 0);
        let is_refused = |it: &RunEvent| it.is_of_session() && matches!(it, RunEvent::Refused { .. });
        assert!(!stage.happened.iter().any(is_refused));
        // While it is paused the start is refused, and says what goes on.
        stage.line("pause");
        stage.run(2.0);
        assert!(stage.refused("begin").contains("`resume` goes on"));
        stage.stop();
    }
}

/// A motion of one motor that ends after 2 s.
const TO_AND_FRO: &str = "board = \"uno\"\n[motor.a]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"A4988\"\npins = { step = 4, dir = 5 }\n\
     forward = \"high\"\nmax_speed = \"4 rev/s\"\nmax_acceleration = \"30 rev/s^2\"\n[[motion]]\nmotor = \"a\"\n\
     law.sine = { amplitude = \"0.25 rev\", period = \"1 s\", cycles = 2 }\n";

/// The times of the events that say that the motion has ended, s.
fn ends<B: Leased>(stage: &Stage<B>) -> Vec<f64> {
    let ends = stage.happened.iter().filter_map(|happened| match happened {
        RunEvent::MotionEnded { at_s } => Some(*at_s),
        _ => None,
    });
    ends.collect()
}

#[test]
fn a_motion_says_once_that_it_has_ended() {
    let mut stage = native(TO_AND_FRO);
    stage.run(1.9);
    assert!(ends(&stage).is_empty());
    stage.run(3.0);
    let [at_s] = ends(&stage)[..] else { panic!("{:?}", ends(&stage)) };
    assert!((2.0..2.1).contains(&at_s), "{at_s}");
    // What changes its end is no new end; a longer motion has one.
    stage.happened.clear();
    stage.line("a.amplitude 0.2 rev");
    stage.run(1.0);
    assert!(ends(&stage).is_empty());
    stage.line("a.cycles 8");
    stage.run(6.0);
    let [at_s] = ends(&stage)[..] else { panic!("{:?}", ends(&stage)) };
    assert!((8.0..8.2).contains(&at_s), "{at_s}");
    // So has one that begins again, and not one that motors leave for a position.
    stage.happened.clear();
    stage.line("begin");
    stage.run(1.0);
    assert!(ends(&stage).is_empty());
    stage.run(2.0);
    assert_eq!(ends(&stage).len(), 1);
    stage.happened.clear();
    stage.line("begin");
    stage.run(0.5);
    stage.line("goto 0");
    stage.run(4.0);
    assert!(ends(&stage).is_empty());
    stage.stop();
}

#[test]
fn a_motion_that_stops_or_has_ended_does_not_run_already() {
    let mut stage = native(TO_AND_FRO);
    stage.run(3.0);
    assert_eq!(ends(&stage).len(), 1);
    let refusals = |stage: &Stage<Native>| {
        let is_refused = |it: &&RunEvent| matches!(it, RunEvent::Refused { command: RunCommand::Resume, .. });
        let says_it_runs = |it: &RunEvent| *it == RunEvent::AlreadyRuns;
        assert!(!stage.happened.iter().any(says_it_runs));
        stage.happened.iter().filter(is_refused).count()
    };
    stage.line("resume");
    stage.run(0.1);
    assert_eq!(refusals(&stage), 1);
    stage.line("begin");
    stage.run(0.3);
    stage.ask(RunCommand::Stop);
    stage.happened.clear();
    assert!(stage.refused("begin").contains("the session ends"));
    stage.step();
    stage.line("resume");
    stage.step();
    assert!(stage.refused("begin").contains("the session ends"));
    assert_eq!(refusals(&stage), 1);
    stage.run(2.0);
    assert!(stage.ended.is_some_and(|ended| ended.stopped));
}

/// Whatever comes with it. A run whose board is lost then ends: it does not wait for the board.
#[test]
fn a_stop_is_obeyed_before_what_comes_with_it() {
    let mut stage = native(TEXT);
    stage.run(1.3);
    assert!(stage.show.rejoins());
    let asked_s = stage.now_s();
    // The nearest value that holds would take steps to find.
    stage.ask(together(&["b.frequency 50 Hz", "stop", "a.swing 20 step"], None));
    assert!(!stage.show.rejoins());
    assert_eq!(stage.now_s(), asked_s);
    for knob in ["b.frequency", "a.swing"] {
        let RunEvent::Refused { command: RunCommand::Set { knob: refused, .. }, why } = stage.answer() else {
            panic!("{knob} is not refused")
        };
        assert_eq!((refused.as_str(), why.as_str()), (knob, "a stop came with it"));
    }
    stage.run(10.0);
    assert!(stage.ended.as_ref().is_some_and(|ended| ended.stopped));
    // One for a time waits for it.
    let mut stage = native(TEXT);
    stage.run(1.0);
    stage.ask(together(&["a.swing 20 step", "stop"], Some(2.0)));
    assert!(!stage.show.rejoins() && stage.ended.is_none());
    assert_eq!(set(stage.answer()).0, "a.swing");
    stage.run(10.0);
    assert!(stage.ended.is_some());
}

/// The search for the nearest value takes many steps. A stop that comes during the search does not wait for its end.
#[test]
fn a_stop_ends_the_search_for_the_nearest_value() {
    let (passes, stopped_after) = (std::cell::Cell::new(0), 3);
    for at_s in [None, Some(1.7)] {
        let mut stage = native(TEXT);
        stage.run(1.3);
        let Stage { show, happened, edges, ended } = &mut stage;
        passes.set(0);
        let hertz = u64::from(16_000_000_u32);
        let until = std::cell::Cell::new(u64::MAX);
        let mut stop_waits = |now: u64| {
            passes.set(passes.get() + 1);
            if passes.get() == stopped_after {
                until.set(now);
            }
            passes.get() >= stopped_after
        };
        let request = together(&["b.frequency 50 Hz", "a.swing 20 step"], at_s);
        let mut observer = |edge: Edge| edges.push(edge);
        let mut tell = |event| happened.push(event);
        *ended = show.handle_until(request, &mut stop_waits, &mut observer, &mut tell).unwrap();
        for _ in 0..100 {
            if until.get() == u64::MAX {
                *ended = show.step_until(&mut stop_waits, &mut observer, &mut tell).unwrap();
            }
        }
        // No time has passed since the stop was seen, and the search was not long before that.
        assert_eq!((show.now(), passes.get()), (until.get(), stopped_after));
        assert!(until.get() < show.zero() + 2 * hertz);
        for knob in ["b.frequency", "a.swing"] {
            let RunEvent::Refused { command: RunCommand::Set { knob: refused, .. }, why } = stage.answer() else {
                panic!("{knob} is not refused")
            };
            assert_eq!((refused.as_str(), why.as_str()), (knob, "a stop came meanwhile"));
        }
        assert!(stage.stop().stopped);
    }
}

#[test]
fn tempo_and_pause_go_with_knobs() {
    let mut stage = native(TEXT);
    stage.run(0.6);
    stage.line("pause");
    stage.run(1.0);
    stage.line("a.swing 20 step");
    set(stage.answer());
    stage.run(0.2);
    stage.line("resume");
    stage.run(2.0);
    stage.line("tempo 0.5");
    stage.run(2.0);
    stage.line("b.swing 20 step");
    set(stage.answer());
    stage.run(3.0);
    assert_eq!((swing(&mut stage, 0, 3.0), swing(&mut stage, 1, 3.0)), ((0, 20), (0, 20)));
    stage.stop();
}

#[test]
fn knobs_and_cues_that_are_wrong_are_errors_of_the_file() {
    let check = |from: &str, to: &str, part: &str| {
        let text = TEXT.replace(from, to);
        assert_ne!(text, TEXT, "{from}");
        let error = LiveSetpoints::of(&text, "m.toml", None, NamedFiles::none()).unwrap_err().plain();
        assert!(error.contains(part), "{to}: {error}");
    };
    check("target = \"a.frequency\"", "target = \"a.freqency\"", "did you mean \"a.frequency\"?");
    check("least = \"0.1 Hz\"", "least = \"0.1 s\"", "`least` must be in a unit of `a.frequency`");
    check("least = \"0.1 Hz\"", "least = \"5 Hz\"", "`least` is more than `greatest`");
    check("speed = { target", "stop = { target", "a knob cannot be called `stop`");
    check("smoothing", "smothing", "did you mean `smoothing`?");
    check("set = { \"b.swing\" = \"80 step\" }", "set = { \"b.swing\" = \"80 s\" }", "must be an angle");
    check("set = { \"b.swing\" = \"80 step\" }", "set = { \"b.swng\" = \"80 step\" }", "did you mean \"b.swing\"?");
    check("set = { \"b.swing\" = \"80 step\" }", "fade = \"1 s\"", "cue \"wide\" changes nothing");
    check("name = \"turn\"", "name = \"wide\"", "two cues are called \"wide\"");
    check("motor = \"b\"\nlaw.trap", "motor = \"c\"\nlaw.trap", "unknown motor \"c\"");
    check("distance = \"0.5 rev\"", "distance = \"0.5 s\"", "`distance` must be");
    check("[live.knobs]", "[live.knob]", "did you mean `knobs`?");
    let midi = |line: &str, part: &str| {
        check("[[cue]]\nname = \"wide\"", &format!("[live.midi]\n{line}\n[[cue]]\nname = \"wide\""), part)
    };
    midi("knobs = { cc128 = \"speed\" }", "`cc128` turns no knob");
    midi("knobs = { cc7-38 = \"speed\" }", "`cc7-38` turns no knob");
    midi("knobs = { cc1 = \"sped\" }", "did you mean \"speed\"?");
    midi("cues = { note60 = \"wid\" }", "did you mean \"wide\"?");
    midi("cues = { bend = \"wide\" }", "`bend` is nothing that is pressed");
    midi("orders = { note60 = \"fly\" }", "\"go\"");
    midi("channel = 17", "17 is no MIDI channel");
    midi("bpm = 0", "0 is no tempo of a MIDI clock");
    midi("knob = {}", "did you mean `knobs`?");
    check(
        ", greatest = \"3 Hz\", smoothing = \"0.5 s\" }",
        " }\n[live.midi]\nknobs = { cc1 = \"speed\" }",
        "knob `speed` has no `least` and `greatest`",
    );
}

/// A cue sets a knob by its name, in the knob's unit; what is wrong with a value is wrong in the cue, and not in the law that it would change.
#[test]
fn a_cue_sets_knobs_by_their_names() {
    let with_set = |set: &str| {
        let text = TEXT.replace("set = { \"b.swing\" = \"80 step\" }", set);
        assert_ne!(text, TEXT);
        text
    };
    for (set, hz) in [("set = { speed = 2 }", 2.0), ("set = { speed = \"1500 mHz\" }", 1.5)] {
        let mut stage = native(&with_set(set).replace("least = \"0.1 Hz\", ", "").replace("follow = \"1 s\"\n", ""));
        stage.run(0.5);
        stage.line("cue wide");
        let RunEvent::Cue { from_s, until_s, .. } = stage.answer() else { panic!("no cue") };
        stage.run(until_s - from_s + 0.2);
        let knobs = stage.show.setpoints().knobs();
        assert_eq!((knobs[0].name.as_str(), knobs[0].value), ("speed", hz));
        stage.stop();
    }
    let check = |set: &str, at: &str, message: &str| {
        let text = with_set(set);
        let error = LiveSetpoints::of(&text, "m.toml", None, NamedFiles::none()).unwrap_err();
        let start = text.find(set).unwrap() + set.find(at).unwrap();
        let line = text[..start].matches('\n').count() + 1;
        let column = start - text[..start].rfind('\n').unwrap();
        let (said, place) = (error.plain(), error.problems()[0].place());
        assert!(place == (line, column) && said.contains(message), "{set}: {line}:{column} is meant: {said}");
        assert_eq!(error.problems().len(), 1, "{said}");
    };
    check("set = { sped = \"1 Hz\" }", "\"1 Hz", "did you mean \"speed\"?");
    check("set = { nothing = \"1 Hz\" }", "\"1 Hz", "a cue can set speed, a.frequency");
    check("set = { speed = \"1 s\" }", "\"1 s", "`speed` must be in a unit of `a.frequency`");
    check("set = { speed = 3.5 }", "3.5", "the greatest value of knob `speed` is 3 Hz");
    check("set = { speed = \"0.05 Hz\" }", "\"0.05", "the least value of knob `speed` is 0.1 Hz");
    check("set = { \"b.swing\" = \"80 step\", \"a.frequency\" = \"-1 Hz\" }", "\"-1 Hz", "more than 0 Hz");
    check("set = { \"b.swing\" = \"80.5 step\" }", "\"80.5", "whole steps");
    check("set = { \"b.swing\" = \"80 s\" }", "\"80 s", "must be an angle");
    check("set.b.swing = \"80.5 step\"", "\"80.5", "whole steps");
}

/// The example of docs/midi.md is right, on the motors of these tests.
#[test]
fn the_example_of_midi_is_right() {
    let page = std::fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/midi.md")).unwrap();
    let example = page.split("```toml").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
    let motors = TEXT.split("[live.knobs]").next().unwrap();
    let opened = LiveSetpoints::of(&format!("{motors}{example}"), "m.toml", None, NamedFiles::none());
    let (_, contents) = opened.map_err(|error| error.plain()).unwrap();
    let midi = contents.live.midi.expect("[live.midi]");
    assert_eq!(
        (midi.channel, midi.bpm, midi.knobs.len(), midi.cues.len(), midi.orders.len()),
        (Some(1), Some(120.0), 3, 2, 5)
    );
}

/// A build without MIDI says how to have it.
#[cfg(not(feature = "midi"))]
#[test]
fn without_midi_it_says_how_to_build_it() {
    for arguments in [&["ports", "--midi"][..], &["live", "m.toml", "--midi", "nano"]] {
        let folder = pulsetrain_testkit::folder::Folder::new("live-midi");
        std::fs::write(folder.0.join("m.toml"), TEXT).unwrap();
        let mut program = std::process::Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
        let done = program.args(arguments).current_dir(&folder.0).output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(!done.status.success() && said.contains("built without MIDI"), "{said}");
        assert!(said.contains("--features midi") && said.contains("libasound2-dev"), "{said}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever comes together, for whatever time: no panic, no lost step, and it stops.
    #[test]
    fn any_groups_leave_a_motion_that_can_be_stopped(
        groups in prop::collection::vec((prop::collection::vec(prop_oneof![
            "(a|b)\\.(frequency|swing) [1-9][0-9]{0,2}(\\.[0-9])? (Hz|step)",
            "speed [0-9](\\.[0-9])?( Hz)?",
            "tempo [0-9]\\.[0-9]",
            "(pause|resume|go|back|goto 0|goto 20 step|cue turn|cue wide)",
        ], 1..5), prop::option::of(0.0..0.8_f64), 0..60_u32), 1..10)
    ) {
        let mut stage = native(TEXT);
        for (lines, in_s, steps) in &groups {
            let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
            let at_s = in_s.map(|in_s| stage.now_s() + in_s);
            stage.ask(together(&lines, at_s));
            (0..*steps).for_each(|_| stage.step());
        }
        let ended = stage.stop();
        prop_assert!(ended.stopped);
    }

    /// Whatever is written at whatever time: no panic, no lost step, and it stops.
    #[test]
    fn any_lines_leave_a_motion_that_can_be_stopped(
        lines in prop::collection::vec((prop_oneof![
            "\\PC{0,20}",
            "(a|b)\\.(frequency|swing) [0-9]{1,3}(\\.[0-9])? (Hz|step|deg|s)",
            "speed -?[0-9]{1,2}(\\.[0-9])?( Hz)?",
            "tempo [0-9]\\.[0-9]",
            "(pause|resume|go|back|goto 0|goto 20 step|cue turn|cue wide)",
        ], 0..60_u32), 1..12)
    ) {
        let mut stage = native(TEXT);
        for (line, steps) in &lines {
            if TypedLine::read(line) != Ok(TypedLine::Command(RunCommand::Stop)) {
                stage.line(line);
            }
            (0..*steps).for_each(|_| stage.step());
        }
        let ended = stage.stop();
        prop_assert!(ended.stopped);
    }
}

/// Processes, which read lines and write logs.
#[cfg(unix)]
pub(crate) mod processes {
    use super::TEXT;
    use pulsetrain_testkit::folder::Folder;
    use std::io::{BufRead, BufReader, Write};
    use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

    pub(crate) struct Live {
        child: Child,
        input: ChildStdin,
        output: BufReader<ChildStdout>,
    }

    impl Live {
        pub(crate) fn begin(folder: &Folder, arguments: &[&str]) -> Live {
            std::fs::write(folder.0.join("m.toml"), TEXT).unwrap();
            Live::again(folder, arguments)
        }

        /// With the motion file that is there.
        pub(crate) fn again(folder: &Folder, arguments: &[&str]) -> Live {
            let mut command = Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
            command.args(["live", "m"]).args(arguments).env("XDG_RUNTIME_DIR", &folder.0);
            command.env("XDG_STATE_HOME", folder.0.join("state")).current_dir(&folder.0);
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::inherit());
            let mut child = command.spawn().unwrap();
            let (input, output) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
            let mut live = Live { child, input, output };
            live.until("runs");
            live
        }

        pub(crate) fn say(&mut self, line: &str) {
            writeln!(self.input, "{line}").unwrap();
        }

        /// Reads up to a line with that part.
        #[track_caller]
        pub(crate) fn until(&mut self, part: &str) -> String {
            let mut all = String::new();
            loop {
                let mut line = String::new();
                assert_ne!(self.output.read_line(&mut line).unwrap(), 0, "no {part:?} in {all}");
                all += &line;
                if line.contains(part) {
                    return line;
                }
            }
        }

        /// Waits for the end.
        pub(crate) fn end(mut self) -> Option<i32> {
            self.child.wait().unwrap().code()
        }

        pub(crate) fn stop(mut self) -> Option<i32> {
            self.say("stop");
            self.until("stopped: a at");
            self.child.wait().unwrap().code()
        }
    }

    #[test]
    fn lines_are_obeyed_and_the_log_makes_the_same_edges() {
        let folder = Folder::new("live-lines");
        std::fs::create_dir(folder.0.join("out")).unwrap();
        let mut live = Live::begin(&folder, &["--native", "--log", "out/l.jsonl", "--trace", "out/l.vcd"]);
        live.say("knobs");
        live.until("b.swing");
        live.say("speed 2 Hz");
        live.until("speed is 2 Hz from");
        live.say("b.frequency 40 Hz");
        live.until("the nearest value that the motors follow: b: max_acceleration");
        live.say("sped 1 Hz");
        live.until("refused: sped 1 Hz: there is no knob `sped`; did you mean `speed`?");
        live.say("nonsense");
        live.until("`nonsense` is no command");
        live.say("b.frequency 1 Hz");
        live.until("b.frequency is 1 Hz from");
        live.say("go");
        live.until("cue wide from");
        live.until("cue turn from");
        live.say("tempo 0.5");
        live.until("tempo 0.5 from");
        live.say("goto 0");
        live.until("goto 0 from");
        assert_eq!(live.stop(), Some(0));
        let replay = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
            .args(["replay", "out/l.jsonl", "--trace", "out/r.vcd", "--plot", "out/r.svg"])
            .current_dir(&folder.0)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&replay.stdout);
        assert!(replay.status.success() && said.contains("PASS: "), "{said}");
        let [live, again] = ["out/l.vcd", "out/r.vcd"].map(|name| std::fs::read(folder.0.join(name)).unwrap());
        assert!(live.len() > 2000 && live == again, "{} and {} bytes", live.len(), again.len());
        let picture = std::fs::read_to_string(folder.0.join("out/r.svg")).unwrap();
        assert!(
            picture.contains("m.toml, changed while it ran") && picture.contains("a change begins"),
            "{picture:.2000}"
        );
        // Another request makes other edges: the comparison can fail.
        let log = std::fs::read_to_string(folder.0.join("out/l.jsonl")).unwrap();
        std::fs::write(folder.0.join("out/x.jsonl"), log.replace("\"2 Hz\"", "\"1.5 Hz\"")).unwrap();
        let other = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
            .args(["replay", "out/x.jsonl"])
            .current_dir(&folder.0)
            .output()
            .unwrap();
        assert_eq!(other.status.code(), Some(1), "{}", String::from_utf8_lossy(&other.stdout));
    }

    /// The command `motion` has a whole motion file in its line; any other line is short.
    #[test]
    fn a_large_motion_file_comes_by_the_control_socket() {
        let folder = Folder::new("live-large");
        let mut live = Live::begin(&folder, &["--native", "--no-watch"]);
        let sockets = std::fs::read_dir(folder.0.join("pulsetrain")).unwrap();
        let socket =
            sockets.map(|entry| entry.unwrap().path()).find(|path| path.extension().is_some_and(|end| end == "sock"));
        let connect = || {
            let stream = std::os::unix::net::UnixStream::connect(socket.as_ref().unwrap()).unwrap();
            BufReader::new(stream)
        };
        let answer = |client: &mut BufReader<_>, part: &str| {
            let mut line = String::new();
            while !line.contains(part) {
                line.clear();
                assert_ne!(client.read_line(&mut line).unwrap(), 0, "no {part:?}");
            }
        };
        let comment = "# A \"comment\".\n".repeat(100_000);
        let motion = |text: String| serde_json::json!({ "command": "motion", "text": text }).to_string();
        let mut client = connect();
        let long = motion(TEXT.replace("40 step", "30 step") + &comment);
        assert!(long.len() > 1_500_000);
        // Before it and after it, other lines in the same write. They may be one change, in any order.
        let go = |rate: f64| serde_json::json!({ "command": "tempo", "rate": rate });
        client.get_mut().write_all(format!("{}\n{long}\n{}\n", go(0.5), go(0.25)).as_bytes()).unwrap();
        let mut missing = vec!["the changed motion file from", "tempo 0.25 from"];
        while !missing.is_empty() {
            let line = live.until(" from");
            missing.retain(|part| !line.contains(part));
        }
        // One that is too large for a motion file, and lines that have no motion file in them.
        let mut other = connect();
        let knob = serde_json::json!({ "command": "set", "knob": "x".repeat(5000), "value": 1 }).to_string();
        other.get_mut().write_all(format!("{knob}\n{}\n", motion("#".repeat(16_000_001))).as_bytes()).unwrap();
        answer(&mut other, "4096 bytes at most, except one with the command `motion`");
        answer(&mut other, "16 MB is the most");
        other.get_mut().write_all(format!("[{}\n", "1,".repeat(5000)).as_bytes()).unwrap();
        answer(&mut other, "no line of JSON");
        // One without an end is left where it is too long.
        other.get_mut().write_all(&vec![b' '; 96_004_096]).unwrap();
        answer(&mut other, "96004096 bytes at most");
        live.say("speed 2 Hz");
        live.until("speed is 2 Hz from");
        assert_eq!(live.stop(), Some(0));
    }

    #[test]
    fn files_that_the_motion_file_names_are_watched() {
        let folder = Folder::new("live-named");
        let text = TEXT.replace(
            "motors = [\"a\", \"b\"]\nlaw.sweep = { frequency = \"1 Hz\", swing = \"40 step\" }",
            "motor = \"a\"\nlaw.table = { file = \"t.csv\", unit = \"step\", time = \"s\" }\n[[motion]]\nmotor = \"b\"\n\
             law.sweep = { frequency = \"1 Hz\", swing = \"40 step\" }",
        );
        let text = text.replace("speed = { target = \"a.frequency\"", "speed = { target = \"b.frequency\"");
        let text = text.replace("set = { \"a.frequency\"", "set = { \"b.frequency\"");
        std::fs::write(folder.0.join("m.toml"), text).unwrap();
        let write = |text: &str| std::fs::write(folder.0.join("t.csv"), text).unwrap();
        write("0,0\n10,20\n20,0\n");
        let mut live = Live::again(&folder, &["--native", "--log", "l.jsonl"]);
        write("0,0\n10,30\n20,0\n");
        live.until("the changed motion file from");
        write("0,0\n10,x\n");
        live.until("the changed motion file was refused");
        std::fs::remove_file(folder.0.join("t.csv")).unwrap();
        live.say("speed 2 Hz");
        live.until("speed is 2 Hz from");
        write("0,0\n10,25\n20,0\n");
        live.until("the changed motion file from");
        assert_eq!(live.stop(), Some(0));
        let replay = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
            .args(["replay", "l.jsonl"])
            .current_dir(&folder.0)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&replay.stdout);
        assert!(replay.status.success() && said.contains("PASS: "), "{said}");
    }

    #[test]
    fn the_file_is_watched() {
        let folder = Folder::new("live-watch");
        let mut live = Live::begin(&folder, &["--native"]);
        let write = |text: &str| std::fs::write(folder.0.join("m.toml"), text).unwrap();
        write(&TEXT.replace("40 step", "20 step"));
        live.until("the changed motion file from");
        write(&TEXT.replace("\"1 Hz\"", "\"1 s\""));
        live.until("was refused at line 21, column 27: `frequency` must be a frequency");
        std::fs::remove_file(folder.0.join("m.toml")).unwrap();
        live.say("speed 2 Hz");
        live.until("speed is 2 Hz from");
        // An editor that puts a new file in the old one's place.
        std::fs::write(folder.0.join("new"), TEXT).unwrap();
        std::fs::rename(folder.0.join("new"), folder.0.join("m.toml")).unwrap();
        live.until("the changed motion file from");
        assert_eq!(live.stop(), Some(0));
    }
}

/// A live motion with a page and OSC: the page opens, and a knob that is turned by OSC turns.
#[test]
fn a_page_opens_and_osc_turns_a_knob() {
    use std::io::{BufRead, BufReader, Read, Write};
    use std::net::{TcpStream, UdpSocket};
    use std::process::Stdio;

    let folder = pulsetrain_testkit::folder::Folder::new("live-page");
    std::fs::create_dir(folder.0.join("run")).unwrap();
    std::fs::write(folder.0.join("m.toml"), TEXT).unwrap();
    // A port that is free now: OSC prints none.
    let port = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port().to_string();
    let mut live = std::process::Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
    live.args(["live", "m.toml", "--native", "--quiet", "--page", "127.0.0.1:0", "--osc", &port]);
    live.env("XDG_RUNTIME_DIR", folder.0.join("run")).current_dir(&folder.0);
    let mut live = live.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(live.stdout.take().unwrap()).lines().map_while(Result::ok);
    let page = lines.find_map(|line| line.strip_prefix("the page: http://").map(str::to_owned)).expect("its link");
    let host = page.split('/').next().unwrap();
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET / HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n").unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("<title>"), "{answer}");
    // `/speed 0.5`, by the bytes of OSC 1.0.
    let packet = [&b"/speed\0\0,f\0\0"[..], &0.5f32.to_be_bytes()].concat();
    let client = UdpSocket::bind("127.0.0.1:0").unwrap();
    client.send_to(&packet, format!("127.0.0.1:{port}")).unwrap();
    let turned = lines.find(|line| line.contains("speed") && line.contains("0.5")).expect("the knob turns");
    assert!(turned.contains("Hz"), "{turned}");
    writeln!(live.stdin.take().unwrap(), "stop").unwrap();
    assert!(lines.any(|line| line.starts_with("stopped: ")));
    assert_eq!(live.wait().unwrap().code(), Some(0));
}

/// A plotter whose path goes to and fro on the line y = 2x, with more lines for its machine.
fn plotter(limits: &str) -> String {
    let motor = |name: &str, step: u8| {
        format!(
            "[motor.{name}]\nsteps_per_rev = 200\nlead = \"8 mm\"\ndriver = \"A4988\"\npulse_high = \"2 us\"\npins = {{ step = {step}, dir = {} }}\n\
             forward = \"high\"\nmax_speed = \"10 rev/s\"\nmax_acceleration = \"200 rev/s^2\"\n",
            step + 1
        )
    };
    format!(
        "board = \"uno\"\n{}{}[machine.table]\nkind = \"xy\"\nmotors = [\"x\", \"y\"]\n{limits}[[motion]]\nmachine = \"table\"\nrepeat = \"forever\"\n\
         path.formula = {{ x = \"a*sin(2*pi*t/T)^2\", y = \"2*a*sin(2*pi*t/T)^2\", where = {{ a = \"5 mm\", T = \"2 s\" }}, unit = \"mm\", duration = \"2 s\" }}\n",
        motor("x", 8),
        motor("y", 10)
    )
}

/// The tip makes 35.1 mm/s and 221 mm/s², and the motors could do more.
#[test]
fn a_tempo_keeps_to_the_limits_of_the_tip() {
    for (limits, highest, limit) in [
        ("max_speed = \"60 mm/s\"\nmax_acceleration = \"1000 mm/s^2\"\n", 0.97 * 60.0 / 35.124, "max_speed"),
        ("max_acceleration = \"500 mm/s^2\"\n", (0.97_f64 * 500.0 / 220.69).sqrt(), "max_acceleration"),
    ] {
        let mut stage = native(&plotter(limits));
        stage.run(1.3);
        stage.line("tempo 3");
        stage.run(0.5);
        let told = stage.happened.iter().find_map(|happened| match happened {
            RunEvent::Tempo { rate, ceiling, .. } => Some((*rate, ceiling.clone())),
            _ => None,
        });
        let (rate, ceiling) = told.expect("a tempo");
        assert!((rate - highest).abs() < 1e-3, "{rate}, not {highest}");
        assert_eq!(ceiling, Some(format!("table: {limit}")));
        // The file's reader would allow it, but not at this tempo.
        stage.line("table.a 7 mm");
        let (_, value, ceiling, _, _) = set(stage.answer());
        assert!((5.0..5.2).contains(&value), "{value} mm");
        assert_eq!(ceiling, Some(format!("table: {limit}")));
        stage.line("tempo 1");
        stage.run(0.5);
        stage.line("table.a 7 mm");
        let (_, value, ceiling, _, _) = set(stage.answer());
        assert_eq!((value, ceiling), (7.0, None));
        // With the change, too.
        stage.run(1.0);
        stage.ask(together(&["table.a 5 mm", "tempo 3"], None));
        assert_eq!(set(stage.answer()).1, 5.0);
        let (rate, ceiling) = tempos(&stage).last().map(|tempo| tempo.0).zip(Some(limit)).expect("a tempo");
        assert!((rate - highest).abs() < 1e-3, "{rate}, not {highest}, {ceiling}");
        stage.stop();
    }
}

/// A path on a straight line, y = 2x, is on that line while it changes, too.
#[test]
fn an_xy_machine_changes_over_along_its_path() {
    let text = plotter("");
    let mut stage = native(&text);
    stage.run(1.3);
    stage.line("table.a 9 mm");
    let (_, value, ceiling, from_s, until_s) = set(stage.answer());
    assert_eq!((value, ceiling), (9.0, None));
    let mut within = 0;
    for _ in 0..40 {
        let status = stage.status();
        let place = |motor: usize| status.motors[motor].target.unwrap();
        assert!((place(1) - 2.0 * place(0)).abs() < 1e-6, "{} and {} at {} s", place(0), place(1), status.at_s);
        within += u32::from((from_s..until_s).contains(&status.at_s));
    }
    assert!(within > 0, "no status from {from_s} to {until_s} s");
    assert_eq!(swing(&mut stage, 0, 2.5), (0, 225));
    stage.stop();
}

/// A motor whose motion has ended rests; all changes still work, and statuses have its place.
#[test]
fn a_motion_may_be_changed_after_a_motor_has_ended() {
    let motor = |name: &str, step: u8| {
        format!(
            "[motor.{name}]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"A4988\"\npins = {{ step = {step}, dir = {} }}\nforward = \"high\"\n\
             max_speed = \"4 rev/s\"\nmax_acceleration = \"30 rev/s^2\"\n",
            step + 1
        )
    };
    let text = format!(
        "board = \"uno\"\n{}{}[[motion]]\nmotor = \"a\"\nlaw.sine = {{ amplitude = \"0.25 rev\", period = \"2 s\", cycles = \"forever\" }}\n\
         [[motion]]\nmotor = \"b\"\nlaw.formula = {{ theta = \"50*cos(2*pi*t/T)\", where = {{ T = \"1 s\" }}, unit = \"step\", duration = \"2 s\" }}\n",
        motor("a", 4),
        motor("b", 6)
    );
    let mut stage = native(&text);
    for k in 1..=4 {
        stage.run(1.5);
        stage.line(&format!("a.amplitude {} rev", 0.25 + 0.01 * f64::from(k)));
        assert_eq!(set(stage.answer()).1, 0.25 + 0.01 * f64::from(k), "at {} s", stage.now_s());
        let motor = stage.status().motors[1];
        assert!((motor.position as f64 - motor.target.unwrap()).abs() <= 1.0, "{motor:?}");
    }
    for line in ["pause", "resume", "tempo 0.5", "goto 0"] {
        stage.line(line);
        stage.run(1.0);
        let refused = stage.happened.iter().find(|it| matches!(it, RunEvent::Refused { .. }));
        assert_eq!(refused, None, "{line}");
    }
    stage.stop();
}

/// A setpoints that did not change gives the program that it made before, and every change is a program of its own.
#[test]
fn a_desk_reads_each_of_its_motions_once() {
    let (setpoints, _) = staged(TEXT);
    let law = |setpoints: &LiveSetpoints| setpoints.program().unwrap().motors[0].law.clone();
    let begun = setpoints.program().unwrap();
    assert!(Arc::ptr_eq(&begun, &setpoints.clone().program().unwrap()));
    let knob_move = setpoints.knob_move("speed", &KnobValue::Number(2.0)).unwrap();
    let turned = setpoints.with_knob(&knob_move, 2.0);
    assert_ne!(law(&turned), begun.motors[0].law);
    assert!(Arc::ptr_eq(&turned.program().unwrap(), &turned.program().unwrap()));
    assert_ne!(law(&setpoints.with_knob(&knob_move, 1.5)), law(&turned));
    assert_eq!(law(&setpoints), begun.motors[0].law);
    let (other, _) = staged(&TEXT.replace("40 step", "30 step"));
    assert_ne!(law(&other), law(&setpoints));
}

/// A text that comes over a socket names no other file of this computer than the motion did when it began.
#[test]
fn a_motion_that_is_sent_reads_no_file() {
    let folder = pulsetrain_testkit::folder::Folder::new("sent");
    folder.write("secret", "root:x\n");
    let text = TEXT.replace(
        "law.sweep = { frequency = \"1 Hz\", swing = \"40 step\" }",
        "law.table = { file = \"secret\", unit = \"step\" }",
    );
    let of_disk = folder.0.clone();
    let loader = move |named: &Path| read_named_text(&of_disk.join(named), MOST_OF_A_NAMED_FILE);
    let files = NamedFiles::LoadedBy(Arc::new(loader));
    let opened = LiveSetpoints::of(TEXT, "m.toml", None, files).map_err(|error| error.plain()).unwrap();
    for name in ["secret".to_owned(), folder.path("secret"), "../secret".to_owned(), "/etc/passwd".to_owned()] {
        let refused = opened.0.with_file(&text.replace("secret", &name), &Default::default()).unwrap_err().to_string();
        assert!(
            refused.contains("names only files that the motion named before") && !refused.contains("root"),
            "{refused}"
        );
    }
}
