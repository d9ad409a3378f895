//! Verbs as lines of text, to the virtual Pico: answers, done lines, pins, and how they keep apart from paths and frames.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Edge, Port, Remote};
use std::time::Duration;

/// STEP and DIR of x and y, and the drivers' enable input.
const STEP: [u8; 2] = [2, 4];
const DIR: [u8; 2] = [3, 5];
const ENABLE: u8 = 22;

struct Talk {
    pico: VirtualPico,
    heard: Vec<u8>,
    edges: Vec<Edge>,
}

impl Talk {
    fn new() -> Talk {
        Talk::over(VirtualPico::new())
    }

    fn over(pico: VirtualPico) -> Talk {
        let mut talk = Talk { pico, heard: Vec::new(), edges: Vec::new() };
        talk.say("srate 60000");
        talk.pass(5);
        talk.lines();
        talk
    }

    fn say(&mut self, line: &str) {
        self.pico.send(format!("{line}\n").as_bytes()).expect("a virtual port");
    }

    fn pass(&mut self, ms: u64) {
        let until = self.pico.now() + Duration::from_millis(ms);
        while self.pico.now() < until {
            self.pico.receive(until, &mut self.heard).expect("a virtual port");
        }
        self.pico.edges(&mut self.edges);
    }

    /// What was heard since the last call, status lines left out.
    fn lines(&mut self) -> Vec<String> {
        let text = String::from_utf8(std::mem::take(&mut self.heard)).expect("text");
        text.lines().filter(|line| !line.starts_with("txyza")).map(str::to_owned).collect()
    }

    /// Says a line and gives what is answered within 30 ms.
    fn ask(&mut self, line: &str) -> Vec<String> {
        self.say(line);
        self.pass(30);
        self.lines()
    }

    fn rises(&self, pin: u8) -> Vec<u64> {
        self.edges.iter().filter(|edge| edge.line == pin && edge.level).map(|edge| edge.tick).collect()
    }
}

/// The numbers in a line.
fn numbers(line: &str) -> Vec<u64> {
    line.split(' ').filter_map(|word| word.parse().ok()).collect()
}

#[test]
fn lines_move_motors_and_say_when_they_are_done() {
    let mut talk = Talk::new();
    let answer = talk.ask("speed xy 62500 31250");
    let [at] = &answer[..] else { panic!("{answer:?}") };
    assert!(at.starts_with("at ") && at.ends_with(" x 0 - y 0 -"), "{at}");
    talk.say("move xy 3 100");
    talk.pass(100);
    let lines = talk.lines();
    let [at, x, y] = &lines[..] else { panic!("{lines:?}") };
    let at = numbers(at)[0];
    let ticks = |count: u64, period: u64| (0..count).map(|step| at + step * period).collect::<Vec<_>>();
    assert_eq!([talk.rises(STEP[0]), talk.rises(STEP[1])], [ticks(3, 62_500), ticks(100, 31_250)]);
    assert_eq!(
        [x.as_str(), y.as_str()],
        [format!("done x {} 1", at + 3 * 62_500), format!("done y {} 1", at + 100 * 31_250)]
    );

    // Backward, in mid-run, with DIR before the step.
    talk.ask("run x");
    let answer = talk.ask("dir x -1");
    let turned = numbers(&answer[0])[0];
    talk.ask("dir x 0");
    let down = talk.edges.iter().rfind(|edge| edge.line == DIR[0] && !edge.level).expect("it turned").tick;
    let first = talk.rises(STEP[0]).into_iter().find(|tick| *tick >= turned).expect("it goes on");
    assert_eq!(first - down, 625);
    let stood = talk.rises(STEP[0]).len();
    talk.pass(50);
    assert_eq!(talk.rises(STEP[0]).len(), stood);

    // Off, and text begins anew.
    let driven = |talk: &Talk| talk.edges.iter().rfind(|edge| edge.line == ENABLE).map(|edge| !edge.level);
    assert_eq!(driven(&talk), Some(true));
    assert_eq!(talk.ask("enable 0"), ["awake"]);
    assert_eq!(driven(&talk), Some(false));
    talk.say("srate 20");
    talk.pass(60);
    let text = String::from_utf8(talk.heard.clone()).expect("text");
    assert!(text.lines().last().is_some_and(|line| line.ends_with(" 0 0 0 0")), "{text}");
}

#[test]
fn what_cannot_be_is_told_and_changes_nothing() {
    let mut talk = Talk::new();
    for (line, answer) in [
        ("move b 1", "err flags 2"),
        ("move x", "err missing 3"),
        ("move x 4294967296", "err range 3"),
        ("speed x 12.5", "err number 3"),
        ("run x 1", "err extra 3"),
        ("speed x 499", "err period 500"),
        ("speed x 4611686018427387905", "err period 500"),
        ("moves x 1", "err command 1"),
    ] {
        assert_eq!(talk.ask(line), [answer], "{line}");
    }
    assert!(!talk.edges.iter().any(|edge| edge.line == ENABLE && !edge.level), "no refused line enables the drivers");
    // With checksums, when strict: that of the line, or nothing is done.
    let summed = |line: &str| format!("{line}*{:02x}", line.bytes().fold(0, |sum, byte| sum ^ byte));
    assert_eq!(talk.ask(&summed("strict 1")).len(), 0);
    assert_eq!(talk.ask("move x 2"), ["err checksum 3"]);
    assert_eq!(talk.ask("move x 2*00"), ["err checksum 3"]);
    talk.say(&summed("move x 2"));
    talk.pass(50);
    assert_eq!(talk.lines().len(), 2, "at, done");
    assert_eq!(talk.rises(STEP[0]).len(), 2);
}

#[test]
fn verbs_paths_and_frames_keep_apart() {
    let mut talk = Talk::new();
    // A path has the axes.
    talk.ask("g x 5 1");
    talk.ask("d x 40");
    assert_eq!(talk.ask("move x 5"), ["err path"]);
    talk.pass(3000);
    assert_eq!(talk.rises(STEP[0]).len(), 40);
    talk.ask("enable 0");
    // Verbs have them, where the path left them.
    let answer = talk.ask("move x 5");
    assert!(answer[0].contains(" x 40 0"), "{answer:?}");
    assert_eq!(talk.ask("a x 7"), ["err verbs"]);
    assert_eq!(talk.ask("move x 1000000").len(), 1);
    assert_eq!(talk.ask("move x 1").len(), 1);
    assert_eq!(talk.ask("move x 1"), ["err busy x"]);
    // A host of frames is refused, until the axes are released; deadman ends a run.
    let mut said = talk.ask("deadman 40");
    talk.pass(100);
    said.extend(talk.lines());
    assert_eq!(said, ["uncertain x"], "it was stopped between two steps");
    let stood = talk.rises(STEP[0]).len();
    talk.pass(100);
    assert_eq!(talk.rises(STEP[0]).len(), stood, "the deadman's time is over");
    let before = talk.pico.clone();
    let refused = Remote::open(before, 3).map(drop).expect_err("text has the board").to_string();
    assert!(refused.contains("another"), "{refused}");
    talk.ask("enable 0");
    talk.pass(20);
    let remote = Remote::open(talk.pico, 4).expect("nobody has it");
    assert!(remote.info().board == 2);
}

/// What `enable 0` stops stays stopped, also if more comes in the same packet; and nothing of that goes by in silence.
#[test]
fn enable_0_stops_whatever_comes_with_it() {
    for (behind, answers) in [
        ("speed x 25000", vec!["err moving", "awake"]),
        ("run x", vec!["err moving", "awake"]),
        ("enable 1", vec!["err moving", "awake"]),
        ("enable 0", vec!["awake"]),
        ("a x 5", vec!["err verbs", "awake"]),
    ] {
        let mut talk = Talk::new();
        assert_eq!(talk.ask("speed x 12500").len(), 1);
        assert_eq!(talk.ask("run x").len(), 1);
        assert_eq!(talk.ask(&format!("enable 0\n{behind}")), answers, "{behind}");
        let off = talk.edges.iter().rfind(|edge| edge.line == ENABLE).map(|edge| edge.level);
        let stood = talk.rises(STEP[0]).len();
        talk.pass(100);
        assert_eq!((off, talk.rises(STEP[0]).len()), (Some(true), stood), "{behind}");
        // Then all begins anew.
        assert_eq!(talk.ask("move x 1").len(), 2, "{behind}");
    }
}

/// Paths' commands are not obeyed while verbs have the axes, and that is told.
#[test]
fn paths_commands_are_refused_while_verbs_have_the_axes() {
    let mut talk = Talk::new();
    assert_eq!(talk.ask("run x").len(), 1);
    for line in ["a x 7", "d x 7", "v x 7", "r x 7", "s x 7", "g x 5 1", "l x 100 100"] {
        assert_eq!(talk.ask(line), ["err verbs"], "{line}");
    }
}

/// A line that is refused does not put the deadman off.
#[test]
fn the_deadman_hears_no_refused_line() {
    let mut talk = Talk::new();
    for line in ["speed x 12500", "move x 1000000", "move x 5"] {
        assert_eq!(talk.ask(line).len(), 1, "{line}");
    }
    talk.ask("deadman 200");
    let mut said = Vec::new();
    for line in ["move x 5", "a x 5", "speed x 1", "move x 5", "r x 5", "move x 5"] {
        said.extend(talk.ask(line));
    }
    talk.pass(50);
    said.extend(talk.lines());
    let (told, refused): (Vec<_>, Vec<_>) = said.iter().map(String::as_str).partition(|line| !line.starts_with("err "));
    assert_eq!((told, refused.len()), (vec!["uncertain x"], 6), "the deadman has struck");
    let stood = talk.rises(STEP[0]).len();
    talk.pass(100);
    assert_eq!(talk.rises(STEP[0]).len(), stood, "the deadman's time is over");
}

/// A host that speaks faster than it can be answered hears of every move that is done, though not every answer.
#[test]
fn every_done_is_told_to_a_host_that_floods_the_line() {
    let mut talk = Talk::new();
    talk.ask("speed xyza 1000");
    for _ in 0..400 {
        talk.say("move xyza 1");
    }
    talk.pass(3000);
    let lines = talk.lines();
    let answered = lines.iter().filter(|line| line.starts_with("at ")).count();
    for (axis, name) in ["x", "y", "z", "a"].into_iter().enumerate() {
        let done = lines.iter().filter(|line| line.starts_with(&format!("done {name} ")));
        let told: Vec<u64> = done.map(|line| numbers(line)[1]).collect();
        let steps = talk.rises(2 + 2 * axis as u8).len() as u64;
        assert!(told.iter().copied().eq(1..=steps), "{name}: {steps} steps, {told:?}");
        assert!(steps > 20, "{steps}");
    }
    assert!(answered > 20, "{answered}");
    assert!(lines.iter().any(|line| line.starts_with("err busy ")), "more than could be told");
}

/// Packets full of lines over USB, while four axes run as fast as they can: no word is late, and no line is lost.
#[test]
fn packets_of_lines_leave_time_for_steps() {
    let mut talk = Talk::over(VirtualPico::on_usb());
    talk.ask("speed xyza 500");
    let begun = numbers(&talk.ask("run xyza")[0])[0];
    for _ in 0..100 {
        talk.say("run xyza\nrun xyza\nrun xyza\nrun xyza\nrun xyza\nrun xyza\nrun xyza");
        talk.pass(3);
    }
    talk.pass(100);
    let lines = talk.lines();
    assert!(lines.len() == 700 && lines.iter().all(|line| line.starts_with("at ")), "{lines:?}");
    let rises = talk.rises(STEP[1]);
    assert!(rises.len() > 80_000, "{}", rises.len());
    assert!(rises.iter().enumerate().all(|(step, tick)| *tick == begun + 500 * step as u64));
}

/// Status lines go on while verbs have the axes, and count their steps.
#[test]
fn status_lines_go_on() {
    let mut talk = Talk::new();
    talk.ask("srate 5");
    talk.ask("speed x 125000");
    talk.heard.clear();
    talk.say("move x 400");
    talk.pass(600);
    let text = String::from_utf8(std::mem::take(&mut talk.heard)).expect("text");
    let status: Vec<u64> =
        text.lines().filter(|line| line.starts_with("txyza ")).map(|line| numbers(line)[1]).collect();
    assert!(status.len() > 50 && status.is_sorted() && status.last() == Some(&400), "{status:?}");
    let under_way = status.iter().filter(|steps| (1..400).contains(*steps)).count();
    assert!(under_way > 30, "{status:?}");
}

/// What docs/verbs.md says of the tick from which on a line holds: 1.5 ms after its end, and one that enables the drivers 2.3.
#[test]
fn a_line_holds_soon() {
    let mut talk = Talk::new();
    // The adapter hands bytes over with the next millisecond; each has ten bits.
    let hear = |talk: &mut Talk, line: &str| {
        let now = talk.pico.chip().cycle() - talk.pico.zero();
        let end = (now / 125_000 + 1) * 125_000 + (line.len() as u64 + 1) * 10 * 125_000_000 / 115_200;
        let answer = talk.ask(line);
        let at = numbers(&answer[0])[0];
        at.saturating_sub(end) as f64 / 125.0
    };
    let first = hear(&mut talk, "run x");
    assert!(first <= 2300.0, "{first} µs");
    let mut latest = 0_f64;
    for time in 0..40 {
        latest = latest.max(hear(&mut talk, &format!("speed xy {}", 125_000 + 997 * time)));
    }
    println!("first {first} µs, others at most {latest} µs");
    assert!(latest <= 1500.0, "{latest} µs");
}
