//! StepperWinch's text: scripts that run and are judged, and the console. On the native winch, in virtual time.

use std::io;
use std::path::Path;
use std::sync::mpsc::channel;
use std::time::Duration;

use proptest::prelude::*;
use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain::winch::console::{ConsoleInput, Ended, Person, Plain, converse};
use pulsetrain::winch::run::{
    Judged, Names, Run, ScriptControl, judge, judge_by_statuses, on_port, on_virtual, positions_off_zero,
};
use pulsetrain::winch::script::{self, Script};
use pulsetrain::winch::talk::{BoardLine, Talk};
use pulsetrain_board::native_winch::NativeWinch;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_testkit::folder::Folder;
use pulsetrain_trace::winch::{WinchOptions, WinchReport};

const NAMES: Names<'_> = Names { script: "script", runner: "native winch", board: "StepperWinch" };

fn script(text: &str, end_s: f64) -> Script {
    Script { lines: script::parse(text, "script").unwrap(), end_s }
}

fn run(script: &Script) -> Run {
    run_on(NativeWinch::new(), script)
}

fn run_on(board: impl VirtualBoard, script: &Script) -> Run {
    let mut talk = Talk::new(board);
    assert_eq!(talk.ask().unwrap().as_deref(), Some("StepperWinch Nov 21 2026"));
    on_virtual(&mut talk, script, |_| ScriptControl::GoOn).unwrap()
}

fn verdict(run: &Run) -> WinchReport {
    verdict_as(run, &WinchOptions::default())
}

fn verdict_as(run: &Run, options: &WinchOptions) -> WinchReport {
    let Judged { report, .. } = judge(run, NAMES, options).unwrap();
    report.verdict.unwrap()
}

/// When an Uno makes its edges: a constant delay, and the delay of its merge.
fn of_uno() -> WinchOptions {
    let late = pulsetrain_motion::boards::find("uno").unwrap().lateness_ticks;
    WinchOptions {
        constant_ticks: PinKind::Shield.constant_ticks().into(),
        late_ticks: late.into(),
        ..WinchOptions::default()
    }
}

/// Gains, limits, new targets during a move, an impulse, a drift, a ramp, a stop.
const EVERYTHING: &str = "
0 s: srate 20
0 s: g xyz 1 0.5
0 s: l y 8000 200000
0.1 s: a xy 800 4000
0.4 s: d x 600
0.45 s: r y -100
0.5 s: g a 5 0.07
0.6 s: v z 1234
0.6 s: a a 300
1 s: l z 500 5000
1.5 s: enable 0
1.7 s: a z 0
1.8 s: s x 300
1.8 s: a x 1000
";

fn everything() -> Run {
    run(&script(EVERYTHING, 3.0))
}

#[test]
fn every_kind_of_line_is_followed() {
    let run = everything();
    let verdict = verdict(&run);
    assert!(verdict.ok, "{verdict:?}");
    assert!(run.refusals.is_empty() && run.troubles.is_empty() && verdict.statuses > 130, "{verdict:?}");
    for axis in &verdict.axes {
        assert!(axis.steps > 200 && axis.max_error_steps < 0.01, "{axis:?}");
        assert_eq!(axis.position_wanted.round() as i64, axis.position, "{axis:?}");
    }
    let (_, most) = verdict.effect_ms.unwrap();
    assert!(most < 4.0, "{most} ms");
}

/// A drift, a deadman that strikes, and lines after it.
const DEADMAN: &str = "
0 s: srate 20
0 s: g xyza 2 1
0.1 s: deadman 300
0.2 s: v xy 1500 -700
0.3 s: a z 400
0.5 s: ping
0.7 s: r z 50
1.5 s: d x 100
1.7 s: deadman 0
2.5 s: v y 0
";

#[test]
fn scripts_carry_checksums() {
    let text = "0 s: strict 1*1a\n0.1 s: g x 2 1*3c\n0.2 s: a x 100*28\n1.5 s: ping*10 ";
    let run = run(&script(text, 2.0));
    let verdict = verdict(&run);
    assert!(verdict.ok && run.refusals.is_empty() && run.troubles.is_empty(), "{verdict:?} {run:?}");
    assert_eq!(verdict.axes[0].position, 100);
}

#[test]
fn gains_at_the_edge_are_judged_by_the_steps_too() {
    // At the limits the recurrence itself is chaotic: f64 and fixed point separate, and the judge follows the board.
    let mut text = "0 s: g xyza 20 0.07\n0 s: l xyza 10000 250000\n".to_owned();
    for n in 0..160 {
        let at = f64::from(n) * 0.25 + 0.1;
        text.push_str(&format!(
            "{at} s: a xyza {} {} {} {}\n",
            n * 7919 % 6000,
            n * 104_729 % 900,
            n % 3,
            -n * 7907 % 3000
        ));
    }
    let mut run = run(&script(&text, 41.0));
    let report = verdict(&run);
    let doubt = report.axes.iter().map(|axis| axis.max_doubt_steps).fold(0.0, f64::max);
    println!("doubt {doubt}, farthest {:?}", report.axes.each_ref().map(|axis| axis.max_error_steps));
    assert!(report.ok && (0.05..0.6).contains(&doubt), "{doubt} {report:?}");
    // A missing step is seen all the same.
    let rising = pulse(&run, 20_000);
    let falling = rising + run.edges[rising..].iter().position(|edge| edge.line == 2 && !edge.level).unwrap();
    run.edges.remove(falling);
    run.edges.remove(rising);
    assert!(!verdict(&run).ok);
}

/// An error is found, and reported with its place.
#[track_caller]
fn check_mutant(mutate: impl FnOnce(&mut Run), axis: char, what: &str) {
    let mut run = everything();
    mutate(&mut run);
    let verdict = verdict(&run);
    let first = verdict.faults.first().expect("a fault");
    assert!(!verdict.ok && first.axis == axis && first.what.contains(what), "{:?}", verdict.faults);
}

/// The index of x's nth pulse among the edges.
fn pulse(run: &Run, nth: usize) -> usize {
    let rising = run.edges.iter().enumerate().filter(|(_, edge)| edge.line == 2 && edge.level);
    rising.map(|(place, _)| place).nth(nth).unwrap()
}

#[test]
fn mutants_are_caught() {
    let falls_after = |run: &Run, rising: usize| {
        rising + run.edges[rising..].iter().position(|edge| edge.line == 2 && !edge.level).unwrap()
    };
    // A step is dropped.
    check_mutant(
        |run| {
            let rising = pulse(run, 100);
            let falling = falls_after(run, rising);
            run.edges.remove(falling);
            run.edges.remove(rising);
        },
        'x',
        "it is at 100, the path at 101.",
    );
    // One is added.
    check_mutant(
        |run| {
            let (rising, next) = (pulse(run, 100), pulse(run, 101));
            let middle = u64::midpoint(run.edges[rising].tick, run.edges[next].tick);
            let mut pulse = [run.edges[rising], run.edges[falls_after(run, rising)]];
            (pulse[0].tick, pulse[1].tick) = (middle, middle + 32);
            run.edges.extend(pulse);
            run.edges.sort_by_key(|edge| edge.tick);
        },
        'x',
        "before the path",
    );
    // One is 0.11 step late.
    check_mutant(
        |run| {
            let (rising, next) = (pulse(run, 100), pulse(run, 101));
            let late = (run.edges[next].tick - run.edges[rising].tick) * 11 / 100;
            let falling = falls_after(run, rising);
            run.edges[rising].tick += late;
            run.edges[falling].tick += late;
            run.edges.sort_by_key(|edge| edge.tick);
        },
        'x',
        "the step to 101 is 0.11",
    );
    // DIR is late.
    check_mutant(
        |run| {
            let dir = run.edges.iter().position(|edge| edge.line == 5).unwrap();
            let step = pulse(run, 0);
            run.edges[dir].tick = run.edges[step].tick - 15;
            run.edges.sort_by_key(|edge| edge.tick);
        },
        'x',
        "DIR changes 15 ticks before a step",
    );
    // A pulse is short.
    check_mutant(
        |run| {
            let rising = pulse(run, 100);
            let falling = falls_after(run, rising);
            run.edges[falling].tick = run.edges[rising].tick + 15;
            run.edges.sort_by_key(|edge| edge.tick);
        },
        'x',
        "a pulse of 15 ticks",
    );
    // A status has another position.
    check_mutant(|run| run.statuses[50].positions[3] += 1, 'a', "but its pulses make");
    // The drivers were never on; and they are not switched off.
    check_mutant(|run| run.edges.retain(|edge| edge.line != 8), 'y', "a step while the drivers are off");
    check_mutant(
        |run| {
            let off = run.edges.iter().rposition(|edge| edge.line == 8 && edge.level).unwrap();
            run.edges.remove(off);
        },
        'x',
        "all drivers are still on (ENABLE is low)",
    );
    // The drivers go on 40 ms late.
    check_mutant(
        |run| {
            let on = run.edges.iter().position(|edge| edge.line == 8 && !edge.level).unwrap();
            run.edges[on].tick += 40 * 16_000;
            run.edges.sort_by_key(|edge| edge.tick);
        },
        'y',
        "a step while the drivers are off",
    );
    // All edges come 10 ms late: no line may take so long.
    check_mutant(|run| run.edges.iter_mut().for_each(|edge| edge.tick += 160_000), 'y', "it is at 0, the path at ");
}

#[test]
fn a_stop_is_a_planned_one() {
    let mut talk = Talk::new(NativeWinch::new());
    talk.ask().unwrap();
    let script = script("0 s: v x 3000\n5 s: v x -3000", 20.0);
    let wish = |at_s: f64| if at_s > 2.0 { ScriptControl::Stop } else { ScriptControl::GoOn };
    let run = on_virtual(&mut talk, &script, wish).unwrap();
    let verdict = verdict(&run);
    assert!(verdict.ok, "{verdict:?}");
    let seconds = (run.end - run.begin) as f64 / 16e6;
    assert!((3.0..3.2).contains(&seconds), "{seconds}");
    assert!(!talk.port().is_enabled(), "drivers are off");
    let report = judge(&run, NAMES, &WinchOptions::default()).unwrap().report;
    assert_eq!((report.lines, report.unsent), (1, 1), "the stop is no line of the script");
    let text = report.to_string();
    assert!(text.contains("1 line in ") && text.contains("Its last line was not sent"), "{text}");
}

#[test]
fn position_and_path_are_compared_at_the_same_moment() {
    // 0.6 ms into a millisecond, five steps later.
    let verdict = verdict(&run(&script("0 s: l x 10000 250000\n0 s: g x 5 1\n0 s: v x 9000", 1.0006)));
    let axis = &verdict.axes[0];
    assert!(verdict.ok && axis.position > 1000, "{verdict:?}");
    assert!((axis.position as f64 - axis.position_wanted).abs() < 0.62, "{axis:?}");
}

#[test]
fn a_real_board_is_known_by_its_word() {
    // The run without its edges.
    let mut talk = Talk::new(NativeWinch::new());
    talk.ask().unwrap();
    let script = script("0 s: g xyza 2 1\n0.2 s: a xy 1000 -500\n1 s: a x 200", 4.0);
    let run = on_port(&mut talk, &script, |_| ScriptControl::GoOn).unwrap();
    let Judged { report, .. } = pulsetrain::winch::run::judge_by_statuses(&run, NAMES);
    assert!(report.is_ok() && report.verdict.is_none(), "{report:?}");
    let word = report.word.clone().unwrap();
    assert_eq!(word.iter().map(|axis| axis.position).collect::<Vec<_>>(), [200, -500, 0, 0]);
    // During a move a line may act some milliseconds earlier or later than known.
    assert!(word[0].farthest > 0.0 && word[0].farthest < 40.0, "{word:?}");
    let mut elsewhere = run;
    elsewhere.statuses.last_mut().unwrap().positions[1] += 1;
    assert!(!pulsetrain::winch::run::judge_by_statuses(&elsewhere, NAMES).report.is_ok());
}

/// The report of axes by the board's own positions: whether each is judged, and whether all is ok.
fn words(run: &Run) -> ([bool; 4], bool) {
    let report = judge_by_statuses(run, NAMES).report;
    let word = report.word.as_ref().unwrap();
    (std::array::from_fn(|axis| word[axis].is_judged), report.is_ok())
}

#[test]
fn where_a_real_board_rests_after_a_drift_is_not_judged() {
    let text = "
0 s: g xyza 2 1
0.1 s: v x 1000
0.1 s: v y 1000
0.1 s: a z 300
2.1 s: v xy 0 0
2.2 s: a y 5
3 s: v a 2000
3.5 s: deadman 300
";
    let mut run = {
        let mut talk = Talk::new(NativeWinch::new());
        talk.ask().unwrap();
        on_port(&mut talk, &script(text, 6.0), |_| ScriptControl::GoOn).unwrap()
    };
    assert_eq!(words(&run), ([false, true, true, false], true));
    let report = judge_by_statuses(&run, NAMES).report.to_string();
    assert!(report.contains("not judged: it moves, or had a drift"), "{report}");
    // Some milliseconds of 1000 steps/s more or less are no fault; a missed absolute target is one.
    run.statuses.last_mut().unwrap().positions[0] += 5;
    assert!(words(&run).1);
    run.statuses.last_mut().unwrap().positions[1] += 1;
    assert_eq!(words(&run), ([false, true, true, false], false));
    // A stop during a move is as uncertain; a stop at rest changes nothing.
    let stopped = |text: &str| {
        let mut talk = Talk::new(NativeWinch::new());
        talk.ask().unwrap();
        words(&on_port(&mut talk, &script(text, 6.0), |_| ScriptControl::GoOn).unwrap())
    };
    let to_100 = "0 s: g x 2 1\n0.1 s: a x 100\n";
    assert_eq!(stopped(&format!("{to_100}0.3 s: enable 0\n")), ([false, true, true, true], true));
    assert_eq!(stopped(&format!("{to_100}4 s: enable 0\n4.5 s: d x 7\n")), ([true; 4], true));
}

#[test]
fn a_real_board_that_stands_elsewhere_is_told() {
    let mut talk = Talk::new(NativeWinch::new());
    talk.ask().unwrap();
    assert_eq!(positions_off_zero(&mut talk).unwrap(), None);
    on_port(&mut talk, &script("0 s: g xyza 2 1\n0 s: a xa 100 -7", 4.0), |_| ScriptControl::GoOn).unwrap();
    assert_eq!(positions_off_zero(&mut talk).unwrap(), Some([100, 0, 0, -7]));
    // The silence of a board that sends nothing is noticed later.
    let mut talk = Talk::new(Unwell { loses: "txyza", ..Unwell::new() });
    talk.ask().unwrap();
    assert_eq!(positions_off_zero(&mut talk).unwrap(), None);
}

#[test]
fn a_picture_of_a_real_board_shows_no_steps() {
    let mut talk = Talk::new(NativeWinch::new());
    talk.ask().unwrap();
    let run = on_port(&mut talk, &script("0 s: g x 2 1\n0 s: a x 100", 2.0), |_| ScriptControl::GoOn).unwrap();
    let of_word = judge_by_statuses(&run, NAMES).picture.svg().unwrap();
    for part in ["Position, step", "Speed, step", "x, as the board says", "the path"] {
        assert!(of_word.contains(part), "{part}");
    }
    for part in ["Interval", "step number", "behind the path", "at the start", "tick"] {
        assert!(!of_word.contains(part), "{part}");
    }
}

/// A faulty board: from a time on its lines are lost, or only those with a certain beginning; or it restarts.
struct Unwell {
    winch: NativeWinch,
    mute_from: Duration,
    loses: &'static str,
    resets_at: Option<Duration>,
    partial: Vec<u8>,
}

impl Unwell {
    fn new() -> Unwell {
        let (mute_from, resets_at) = (Duration::MAX, None);
        Unwell { winch: NativeWinch::new(), mute_from, loses: "nothing", resets_at, partial: Vec::new() }
    }
}

impl Port for Unwell {
    fn now(&self) -> Duration {
        self.winch.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.winch.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        if self.resets_at.is_some_and(|at| at <= self.now()) {
            self.resets_at = None;
            self.winch.reset();
        }
        let mut bytes = Vec::new();
        self.winch.receive(until, &mut bytes)?;
        self.partial.extend(bytes);
        while let Some(end) = self.partial.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = self.partial.drain(..=end).collect();
            if self.winch.now() < self.mute_from && !line.starts_with(self.loses.as_bytes()) {
                into.extend(line);
            }
        }
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.winch.set_baud(baud)
    }

    fn edges(&mut self, _: &mut Vec<Edge>) {}
}

#[test]
fn a_real_board_is_heard_to_the_end() {
    let check = |board: Unwell, text: &str, expected: &[(f64, &str)]| {
        let mut talk = Talk::new(board);
        talk.ask().unwrap();
        let run = on_port(&mut talk, &script(text, 5.0), |_| ScriptControl::GoOn).unwrap();
        let report = pulsetrain::winch::run::judge_by_statuses(&run, NAMES).report;
        let troubles: Vec<_> = report.troubles.iter().map(|trouble| (trouble.at_s, &trouble.what[..])).collect();
        assert_eq!(troubles.len(), expected.len(), "{troubles:?}");
        for ((at_s, what), (near_s, begins)) in troubles.iter().zip(expected) {
            assert!((at_s - near_s).abs() < 0.26 && what.starts_with(begins), "{troubles:?}");
        }
        assert_eq!(report.is_ok(), expected.is_empty(), "{report}");
        assert!(troubles.iter().all(|(_, what)| report.to_string().contains(what)));
    };
    let move_and_rest = "0 s: g xyza 2 1\n0.2 s: a xy 100 -50";
    check(Unwell::new(), move_and_rest, &[]);
    check(Unwell::new(), &format!("{move_and_rest}\n1 s: ping\n2 s: srate 1500\n3 s: srate 20"), &[]);
    let ms = Duration::from_millis;
    // Without any status nothing is ok, even if nothing was to move.
    check(Unwell { loses: "txyza", ..Unwell::new() }, "0 s: ping", &[(5.0, "no status line for 5 s")]);
    check(Unwell { loses: "txyza", ..Unwell::new() }, "0 s: srate 9000", &[(5.0, "no status line came")]);
    check(Unwell { mute_from: ms(2500), ..Unwell::new() }, move_and_rest, &[(5.0, "no status line for 2.")]);
    // It restarts, at rest at 0, or at another position.
    let reset = || Unwell { resets_at: Some(ms(3000)), ..Unwell::new() };
    let clock = "its clock went on by";
    check(reset(), "0 s: ping", &[(2.8, "it restarted (`awake`)"), (2.8, clock)]);
    check(Unwell { loses: "awake", ..reset() }, move_and_rest, &[(2.8, clock)]);
}

/// `enable 0` releases the drivers when the axes stop. A line that moves nothing, at any time around that, keeps them
/// on or comes too late.
#[test]
fn a_line_about_the_release_is_found_by_enable() {
    for ms in (440..490).step_by(2) {
        let text = format!(
            "0 s: g xyza 1 0.5\n0 s: s y 3067\n0 s: g y 2.59 0.54\n0 s: a y -1308\n377 ms: enable 0\n{ms} ms: s x 0\n"
        );
        let verdict = verdict(&run(&script(&text, 1.5)));
        assert!(verdict.ok, "{text}{verdict:?}");
    }
}

fn line() -> impl Strategy<Value = String> {
    let axes = prop::sample::select(vec!["x", "y", "xy", "za", "xyza"]);
    prop_oneof![
        (prop::sample::select(vec!["a", "d", "r"]), axes.clone(), -1500..1500_i32)
            .prop_map(|(verb, axes, steps)| format!("{verb} {axes}{}", format!(" {steps}").repeat(axes.len()))),
        (axes.clone(), -5000..5000_i32)
            .prop_map(|(axes, speed)| format!("v {axes}{}", format!(" {speed}").repeat(axes.len()))),
        (axes.clone(), 0..4000_i32)
            .prop_map(|(axes, speed)| format!("s {axes}{}", format!(" {speed}").repeat(axes.len()))),
        (axes.clone(), 1..=2000_i32, 7..=500_i32).prop_map(|(axes, f, ratio)| format!(
            "g {axes} {} {}",
            f64::from(f) / 100.0,
            f64::from(ratio) / 100.0
        )),
        (axes, 100..10_000_i32, 1000..250_000_i32).prop_map(|(axes, v, a)| format!("l {axes} {v} {a}")),
        Just("enable 0".to_owned()),
    ]
}

/// Lines with their distances in ms, and the time of the end, s.
fn random_script(lines: &[(u32, String)]) -> (String, f64) {
    let mut at_ms = 0;
    let mut text = "0 s: g xyza 1 0.5\n".to_owned();
    for (wait, line) in lines {
        at_ms += wait;
        text.push_str(&format!("{at_ms} ms: {line}\n"));
    }
    (text, f64::from(at_ms) / 1e3 + 1.0)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24 * pulsetrain_testkit::seed::rounds() as u32, ..ProptestConfig::default() })]

    /// The board's fixed point and the judge's f64 agree on any script, though they share no code.
    #[test]
    fn boards_and_judge_agree(lines in prop::collection::vec((0..500_u32, line()), 1..12)) {
        let (text, end_s) = random_script(&lines);
        let run = run(&script(&text, end_s));
        let verdict = verdict(&run);
        prop_assert!(verdict.ok && run.troubles.is_empty(), "{}{:?} {:?}", text, verdict, run.troubles);
    }
}

fn command(args: &[&str]) -> (Exit, String, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain", "winch"], args].concat(), &mut out, &mut err);
    (exit, String::from_utf8(out).unwrap(), String::from_utf8(err).unwrap())
}

#[test]
fn the_example_runs_and_leaves_its_files() {
    let folder = Folder::new("winch-example");
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/winch.toml");
    let (exit, out, err) = command(&[example.to_str().unwrap(), "--native", "--out", &folder.name()]);
    assert_eq!((exit, err.as_str()), (Exit::Success, ""), "{out}");
    assert!(out.contains("8 lines in 8 s") && out.contains("\nPASS\n"), "{out}");
    let read = |name: &str| std::fs::read_to_string(folder.path(name)).unwrap();
    assert!(read("plot.svg").contains("Steps of x behind the path"));
    assert!(read("steps.csv").lines().count() > 3000 && read("trace.vcd").contains("step"));
    assert!(read("statuses.csv").lines().count() > 30 && read("report.json").contains("\"ok\": true"));
}

#[test]
fn a_wrong_script_is_refused_before_anything_moves() {
    let folder = Folder::new("winch-wrong");
    let path = folder.write("wrong.txt", "0 s: a x 5\n1 s: g x nan 1\n");
    let out = folder.path("out");
    let (exit, _, err) = command(&[&path, "--native", "--out", &out]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("a natural frequency is 0.01 to 20 Hz") && err.contains(":2:10]"), "{err}");
    assert!(!Path::new(&out).exists());
    let (exit, _, err) = command(&[&path]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("--native") && err.contains("--port"), "{err}");
    // A folder that cannot be made is refused, too.
    folder.write("wrong.txt", "0 s: a x 5\n");
    let (exit, _, err) = command(&[&path, "--native", "--out", &path]);
    assert!(exit == Exit::Refused && err.contains("nothing was sent"), "{err}");
}

#[test]
fn a_virtual_board_without_a_way_to_it_is_refused() {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    assert_eq!(cli::run(["pulsetrain", "board", "uno"], &mut out, &mut err), Exit::Refused);
    let err = String::from_utf8(err).unwrap();
    assert!(err.contains("say --pty <LINK> or --tcp <ADDRESS>"), "{err}");
}

/// A person who does one thing at each look.
struct Actor {
    inputs: Vec<ConsoleInput>,
    heard: Vec<BoardLine>,
    told: String,
}

impl Person for Actor {
    fn inputs(&mut self) -> io::Result<Vec<ConsoleInput>> {
        Ok(if self.inputs.is_empty() { vec![ConsoleInput::End] } else { vec![self.inputs.remove(0)] })
    }

    fn show(&mut self, said: &BoardLine) -> io::Result<()> {
        self.heard.push(said.clone());
        Ok(())
    }

    fn tell(&mut self, text: &str) -> io::Result<()> {
        self.told.push_str(text);
        Ok(())
    }

    fn waits_for_rest(&self) -> bool {
        false
    }
}

#[test]
fn a_person_types_lines() {
    let line = |text: &str| ConsoleInput::Line(text.to_owned());
    let mut inputs =
        vec![line("help"), line("  "), line("srate 10"), line("v x 3000"), line("jump"), line("strict 1*1a")];
    // A second without input.
    inputs.extend([const { ConsoleInput::Line(String::new()) }; 25]);
    inputs.push(ConsoleInput::Stop);
    inputs.extend([const { ConsoleInput::Line(String::new()) }; 10]);
    inputs.extend([line("quit"), line("v x 9")]);
    let mut actor = Actor { inputs, heard: Vec::new(), told: String::new() };
    let mut talk = Talk::new(NativeWinch::new());
    assert_eq!(converse(&mut talk, &mut actor).unwrap(), Ended { refused: 1, is_settled: true });
    assert!(actor.told.contains("go to") && actor.told.contains("enable 0"));
    assert!(actor.heard.contains(&BoardLine::Line("err command 1".to_owned())));
    assert!(talk.port().positions()[0] > 500 && talk.port().is_at_rest(), "it was stopped");
    assert_eq!(actor.inputs.len(), 1, "after `quit` nobody is asked");
}

#[test]
fn a_stop_asks_for_no_checksums() {
    let mut inputs: Vec<ConsoleInput> =
        ["strict 1", "v x 800"].map(|text| ConsoleInput::Line(text.to_owned())).to_vec();
    inputs.push(ConsoleInput::Stop);
    inputs.extend(["a x 0", "strict 0", "ping"].map(|text| ConsoleInput::Line(text.to_owned())));
    inputs.extend([const { ConsoleInput::Line(String::new()) }; 3]);
    let mut actor = Actor { inputs, heard: Vec::new(), told: String::new() };
    let mut talk = Talk::new(NativeWinch::new());
    assert_eq!(converse(&mut talk, &mut actor).unwrap(), Ended { refused: 0, is_settled: true });
    assert_eq!(actor.heard.last(), Some(&BoardLine::Line("awake".to_owned())));
}

#[test]
fn a_board_that_wants_checksums_is_found() {
    let mut board = NativeWinch::new();
    board.send(b"strict 1*1a\n").unwrap();
    let mut later = Talk::new(board);
    assert_eq!(later.ask().unwrap().as_deref(), Some("StepperWinch Nov 21 2026"));
    assert_eq!(later.as_wanted("enable 0"), "enable 0*11");
    // Until the setting is sent again.
    later.tell("strict 0*1b").unwrap();
    later.tell("strict 1").unwrap();
    assert_eq!(later.as_wanted("enable 0"), "enable 0");
    later.tell("ping*99").unwrap();
    assert_eq!(later.as_wanted("enable 0"), "enable 0", "a wrong one asks for none");
}

/// The end of a console without a terminal for some lines, and its whole output.
fn piped(port: impl Port, input: impl IntoIterator<Item = &'static str>) -> (Ended, String) {
    let (lines, to_console) = channel();
    for line in input {
        lines.send(line.to_owned()).unwrap();
    }
    drop(lines);
    let mut out = Vec::new();
    let ended = converse(&mut Talk::new(port), &mut Plain::new(to_console, &mut out)).unwrap();
    (ended, String::from_utf8(out).unwrap())
}

#[test]
fn slow_axes_are_waited_for() {
    // A step a second; then none for a while, and the axis counts as resting at once.
    let (ended, said) = piped(NativeWinch::new(), ["g x 5 1", "s x 1", "a x 2"]);
    assert!(ended.is_settled && said.trim_end().ends_with(" 2 0 0 0"), "{said}");
    // The first step comes after more than a second, the last one after minutes.
    for lines in [&["g x 0.01 1", "a x 100"][..], &["v x 1"]] {
        let (ended, said) = piped(NativeWinch::new(), lines.iter().copied());
        assert!(!ended.is_settled && said.contains("the axes still move"), "{said}");
    }
    // Nothing moves while the drivers are off.
    let (ended, _) = piped(NativeWinch::new(), ["r x 100"]);
    assert!(ended.is_settled);
}

#[test]
fn lines_from_a_pipe_are_obeyed_to_their_end() {
    let (lines, to_console) = channel();
    for line in ["g xyza 2 1", "a xy 100 -200"] {
        lines.send(line.to_owned()).unwrap();
    }
    drop(lines);
    let mut out = Vec::new();
    let mut talk = Talk::new(NativeWinch::new());
    let ended = converse(&mut talk, &mut Plain::new(to_console, &mut out)).unwrap();
    assert_eq!(ended, Ended { refused: 0, is_settled: true });
    let text = String::from_utf8(out).unwrap();
    assert!(text.starts_with("awake\n") && text.trim_end().ends_with(" 100 -200 0 0"), "{text}");
    // For an axis that never rests the console waits half a minute.
    let (lines, to_console) = channel();
    lines.send("v x 100".to_owned()).unwrap();
    drop(lines);
    let mut out = Vec::new();
    let ended = converse(&mut talk, &mut Plain::new(to_console, &mut out)).unwrap();
    assert_eq!(ended, Ended { refused: 0, is_settled: false });
    assert!(String::from_utf8(out).unwrap().ends_with("the axes still move; the board goes on with its last orders\n"));
    // A board without statuses does not count as resting. A line that is not text is refused, and not ignored.
    let (lines, to_console) = channel();
    for line in ["v x 0", "srate 65535", "a x \u{fffd}5"] {
        lines.send(line.to_owned()).unwrap();
    }
    drop(lines);
    let mut out = Vec::new();
    let mut talk = Talk::new(NativeWinch::new());
    let ended = converse(&mut talk, &mut Plain::new(to_console, &mut out)).unwrap();
    assert_eq!(ended, Ended { refused: 1, is_settled: false });
    let text = String::from_utf8(out).unwrap();
    assert!(
        text.contains("err noise 3\n")
            && text.ends_with("no status tells whether the axes rest; the board goes on with its last orders\n"),
        "{text}"
    );
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 8 * pulsetrain_testkit::seed::rounds() as u32, ..ProptestConfig::default() })]

        /// The firmware's assembly and the judge agree, too.
        #[test]
        fn the_uno_and_the_judge_agree(lines in prop::collection::vec((0..300_u32, line()), 1..10)) {
            let (text, end_s) = random_script(&lines);
            let run = run_on(VirtualUno::with_winch(), &script(&text, end_s));
            let verdict = verdict_as(&run, &of_uno());
            prop_assert!(verdict.ok && run.troubles.is_empty(), "{}{:?} {:?}", text, verdict, run.troubles);
        }
    }

    #[test]
    fn a_deadman_is_part_of_the_path() {
        for verdict in [
            verdict(&run(&script(DEADMAN, 4.0))),
            verdict_as(&run_on(VirtualUno::with_winch(), &script(DEADMAN, 4.0)), &of_uno()),
        ] {
            assert!(verdict.ok, "{verdict:?}");
            // The stop is at 1 s, and x goes on with its last command.
            let [x, y, ..] = &verdict.axes;
            assert!((1000..1500).contains(&x.position) && (-800..-500).contains(&y.position), "{verdict:?}");
        }
        // A board that does not stop is found.
        let mut run = run(&script(&DEADMAN.replace("deadman 300", "deadman 0"), 1.4));
        let strikes = script(DEADMAN, 1.4);
        for (told, line) in run.told.iter_mut().zip(&strikes.lines) {
            told.command = line.command;
        }
        assert!(!verdict(&run).ok);
    }

    #[test]
    fn a_refusal_among_many_answers_is_told() {
        let burst = || std::iter::repeat_n("version", 60).chain(["a x nan"]).chain(std::iter::repeat_n("version", 40));
        for (ended, said) in [piped(VirtualUno::with_winch(), burst()), piped(NativeWinch::new(), burst())] {
            assert_eq!(ended, Ended { refused: 1, is_settled: true }, "{said}");
            assert!(said.lines().filter(|line| line.starts_with("id ")).count() == 100, "{said}");
            assert!(said.contains("err number 3\n"), "{said}");
        }
    }

    #[test]
    fn a_target_beyond_half_the_range_is_the_same_to_board_and_judge() {
        let text = "0 s: l x 10000 250000\n0 s: a x 100\n2 s: a x -2147483648\n3 s: enable 0";
        for verdict in [
            verdict(&run(&script(text, 4.0))),
            verdict_as(&run_on(VirtualUno::with_winch(), &script(text, 4.0)), &of_uno()),
        ] {
            assert!(verdict.ok && verdict.axes[0].position < -5000, "{verdict:?}");
        }
    }

    #[test]
    fn axes_that_the_board_has_stopped_or_never_moved_are_not_waited_for() {
        // A deadman that was set before this console began.
        let mut board = NativeWinch::new();
        board.send(b"deadman 300\n").unwrap();
        let (ended, said) = piped(board, ["v x 500"]);
        assert!(ended.is_settled && !said.contains("still move"), "{said}");
        assert!(said.lines().count() < 20, "{said}");
        // An axis that verbs move refuses paths.
        let (ended, said) = piped(VirtualPico::new(), ["speed x 20000", "move x 20", "v x 500"]);
        assert_eq!(ended, Ended { refused: 1, is_settled: true }, "{said}");
        assert!(said.contains("err verbs") && !said.contains("still move"), "{said}");
    }

    /// Verbs through the same console: the move is done, and reported.
    #[test]
    fn motors_are_told_directly_from_a_pipe() {
        let (lines, to_console) = channel();
        for line in ["speed x 7", "move x 20"] {
            lines.send(line.to_owned()).unwrap();
        }
        drop(lines);
        let mut out = Vec::new();
        let mut talk = Talk::new(VirtualPico::new());
        converse(&mut talk, &mut Plain::new(to_console, &mut out)).unwrap();
        let said = String::from_utf8(out).unwrap();
        for part in ["err period 500", "at ", " x 0 0", "done x "] {
            assert!(said.contains(part), "{part} is not in {said}");
        }
        assert!(said.trim_end().ends_with(" 20 0 0 0"), "{said}");
    }

    #[test]
    fn the_uno_does_the_same() {
        let run = run_on(VirtualUno::with_winch(), &script(EVERYTHING, 3.0));
        let verdict = verdict_as(&run, &of_uno());
        assert!(
            verdict.ok && run.refusals.is_empty() && run.troubles.is_empty() && verdict.statuses > 130,
            "{verdict:?}"
        );
        for axis in &verdict.axes {
            assert!(axis.steps > 200 && axis.max_error_steps < 0.03, "{axis:?}");
            assert_eq!(axis.position_wanted.round() as i64, axis.position, "{axis:?}");
        }
    }
}
