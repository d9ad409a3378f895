//! The firmware as clients of the winch see it, on each virtual board that takes its text, by each of its lines: what it says, and
//! its pins against core's paths.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, LinkError, Remote, RemoteError, Setup};
use pulsetrain_core::wire::Reason;
use pulsetrain_emulator::UsbState;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::pico::step_dir;
use pulsetrain_testkit::seed::seeds;
use pulsetrain_testkit::winch::{SLICES, SentLine, WinchLab, Wired, follow};
use std::ops::RangeInclusive;

/// A board, with what is particular to it.
pub(super) trait Winch: Wired {
    /// How late its edges may be against the ticks of core's paths.
    const LATE: RangeInclusive<i64>;
    /// The shortest time between two steps of an axis, ticks: 10 000 steps/s, less what its edges may be moved.
    const MIN_APART: u64;

    /// A line acts sooner than so many slices after it came.
    const MAX_SLICES: u64;

    /// A board at each of its lines.
    fn labs() -> Vec<WinchLab<Self>>;

    /// Whether a line of text takes no time on its way.
    fn is_quick(&self) -> bool;

    /// What frames may do with a board that has just been text's.
    fn check_frames(board: &mut Remote<Self>);
}

impl Winch for VirtualUno {
    const LATE: RangeInclusive<i64> = -38..=64;
    const MIN_APART: u64 = 1600 - 2 * 64;
    const MAX_SLICES: u64 = SLICES + 1;

    fn labs() -> Vec<WinchLab<VirtualUno>> {
        vec![WinchLab::new()]
    }

    fn is_quick(&self) -> bool {
        false
    }

    /// This image takes no plans.
    fn check_frames(board: &mut Remote<VirtualUno>) {
        let refused = board.configure(&pulsetrain_testkit::uno_setup(&[(2, 5)], 16));
        assert!(matches!(refused, Err(RemoteError::Refused { reason: Reason::UnknownKind, .. })), "{refused:?}");
    }
}

impl Winch for VirtualPico {
    // The state machines make the edges at their ticks.
    const LATE: RangeInclusive<i64> = 0..=0;
    const MIN_APART: u64 = 12_499;
    const MAX_SLICES: u64 = 6;

    fn labs() -> Vec<WinchLab<VirtualPico>> {
        vec![WinchLab::new(), on_usb()]
    }

    fn is_quick(&self) -> bool {
        self.chip().usb_state() == UsbState::Open
    }

    fn check_frames(board: &mut Remote<VirtualPico>) {
        let setup = Setup { pulse_ticks: 125, motors: vec![step_dir(10)], ..Setup::default() };
        board.configure(&setup).expect("it takes it");
        assert!(board.events().is_empty(), "what text did is not told");
    }
}

/// A Pico by its own USB port, which has just been opened.
pub(super) fn on_usb() -> WinchLab<VirtualPico> {
    let mut pico = WinchLab::around(VirtualPico::on_usb());
    pico.run_ms(5);
    assert_eq!(pico.lines[0].text, "awake");
    pico
}

/// Levels of the enable line, with their ticks.
pub(super) fn enable<B: Winch>(lab: &WinchLab<B>) -> Vec<(u64, bool)> {
    lab.edges.iter().filter(|edge| edge.line == B::ENABLE).map(|edge| (edge.tick, edge.level)).collect()
}

/// Sends lines, each so long after the one before, ms.
pub(super) fn script<B: Winch>(lab: &mut WinchLab<B>, lines: &[(u64, &str)]) -> Vec<SentLine> {
    let mut say = |(wait, line): &(u64, &str)| {
        lab.run_ms(*wait);
        let sent = lab.now();
        let said = lab.say(line);
        if lab.port.is_quick() { SentLine { tick: sent, ..said } } else { said }
    };
    lines.iter().map(&mut say).collect()
}

fn answers<B: Winch>() {
    for mut lab in B::labs() {
        let mut check =
            |line: &str, answer: &[&str]| assert_eq!(lab.ask(line, 12 + line.len() as u64 / 10), answer, "{line:?}");
        check("version", &["id StepperWinch Nov 21 2026"]);
        check("ping", &["awake"]);
        check("", &[]);
        check("jump 3", &["err command 1"]);
        check("a x nan", &["err number 3"]);
        check("a x 99999999999", &["err range 3"]);
        check("a 5", &["err flags 2"]);
        check("v 100", &["err flags 2"]);
        check("a x", &["err missing 3"]);
        check("enable", &["err missing 2"]);
        check("g x 1", &["err missing 4"]);
        check("l x 100", &["err missing 4"]);
        check("g x 30 1", &["err range 3 0.01..20 Hz"]);
        check("a x 1*00", &["err checksum 3"]);
        check("srate 0", &["dbg invalid srate value"]);
        check("a x 1 2 3 4 5 6 7 8 9", &["dbg excessive input error"]);
        check(&"x".repeat(200), &["err long 1"]);
        check("strict 1", &[]);
        check("a xq 1", &["err flags 2"]);
        check("strict 0", &[]);
        // Nothing of it has moved anything, and no driver was ever on.
        lab.run_ms(1000);
        let edges: Vec<_> = lab.edges.iter().filter(|edge| edge.line > 1).collect();
        assert!(edges.is_empty(), "but for the line's own pins: {edges:?}");
        let statuses = lab.statuses();
        assert!(statuses.len() >= 4 && statuses.iter().all(|status| status.positions == [0; 4]));
        for pair in statuses.windows(2) {
            let apart = pair[1].usec - pair[0].usec;
            assert!((198_000..202_000).contains(&apart), "{apart} us");
        }
        // What comes all at once is answered in order, and nothing is lost.
        let had = lab.lines.len();
        lab.send("ping\nversion\njump\nping\n");
        lab.run_ms(60);
        let said: Vec<_> =
            lab.lines[had..].iter().map(|line| &line.text[..]).filter(|text| !text.starts_with("txyza")).collect();
        assert_eq!(said, ["awake", "id StepperWinch Nov 21 2026", "err command 1", "awake"]);
    }
}

#[test]
fn it_answers() {
    answers::<VirtualUno>();
    answers::<VirtualPico>();
}

/// Scripts whose every step is compared: each of a line of its own with the time before it, ms.
const SCRIPTS: [&[(u64, &str)]; 4] = [
    // As clients set out: it rings.
    &[(5, "a xyza 400 -300 25 7"), (900, "d xy 10 -10"), (700, "a z 0")],
    // Slow, and through zero; with the shared gains of all axes.
    &[(5, "g xyza 2 1"), (5, "v xyza 1 -37 450 -1234"), (1500, "v xz 30 -450"), (900, "v xyza 0 0 0 0")],
    // Fast, from the first command on.
    &[(5, "l xyza 10000 250000"), (5, "g xyza 20 0.1"), (3, "a xyza 900 901 -902 903"), (300, "a xyza 0 0 0 0")],
    // Ramps, impulses, targets anew in mid-move, limits that come down.
    &[
        (5, "g xyza 3 0.7"),
        (5, "s xyza 300 500 800 0"),
        (5, "a xyza 500 -500 400 300"),
        (400, "r xa 20 -20"),
        (200, "d z -100"),
        (300, "l xyza 500 5000"),
        (200, "a xyza 0 0 0 0"),
        (500, "s xyza 0 0 0 0"),
    ],
];

/// Plays scripts on a board, one after the other on each of its lines in turn.
pub(super) fn follows_paths<B: Winch>(scripts: &[&[(u64, &str)]]) {
    let labs = B::labs();
    for (lines, lab) in scripts.iter().zip(labs.iter().cycle()) {
        let mut lab = lab.clone();
        let said = script(&mut lab, lines);
        lab.run_ms(1500);
        let (late, longest) = follow(&lab, &said).unwrap_or_else(|why| panic!("{lines:?}: {why}"));
        let steps = late.iter().map(Vec::len).sum::<usize>();
        let (least, most) = (late.iter().flatten().min().unwrap(), late.iter().flatten().max().unwrap());
        let slices = longest / WinchLab::<B>::SLICE;
        println!("{steps} steps, {least} to {most} ticks late; {slices} slices from a line to its slice");
        assert!(steps > 500, "{lines:?}: {steps}");
        assert!(B::LATE.contains(least) && B::LATE.contains(most), "{lines:?}: {least} to {most} ticks late");
        assert!(slices < B::MAX_SLICES, "{lines:?}: {slices} slices");
        lab.check_positions();
    }
}

#[test]
fn steps_are_those_of_the_paths() {
    follows_paths::<VirtualUno>(&SCRIPTS);
    follows_paths::<VirtualPico>(&SCRIPTS);
}

/// A burst of lines, while the other axes stand and while they run at full speed.
fn obeys_bursts<B: Winch>() {
    for (others, lab) in ["", "v xza 9999 -9990 9971\n"].iter().zip(B::labs().iter().cycle()) {
        let mut lab = lab.clone();
        lab.send(format!("l xyza 10000 100000\ng xyza 5 1\n{others}"));
        lab.run_ms(800);
        lab.send("d y 10\n".repeat(100));
        lab.run_ms(1500);
        assert_eq!(lab.statuses().last().unwrap().positions[1], 1000);
        let said = |text: &str| text == "awake" || text.starts_with("txyza");
        assert!(lab.lines.iter().all(|line| said(&line.text)), "nothing was lost");
        lab.check_positions();
    }
}

#[test]
fn bursts_are_obeyed() {
    obeys_bursts::<VirtualUno>();
    obeys_bursts::<VirtualPico>();
}

fn releases<B: Winch>() {
    let mut lab = WinchLab::<B>::new();
    script(&mut lab, &[(5, "g xyza 2 1"), (5, "v xyza 3000 -3000 100 1")]);
    lab.run_ms(700);
    let stopped = lab.say("enable 0").tick;
    lab.run_ms(300);
    let slice = WinchLab::<B>::SLICE;
    // At first high, then on with the first command that moves; off again when all is still: docs/winch.md says 3000 / 35 000 s,
    // and 20 ms at most.
    let levels = enable(&lab);
    assert_eq!(levels.iter().map(|(_, level)| *level).collect::<Vec<_>>(), [true, false, true]);
    let released = levels[2].0;
    let took = released - stopped;
    assert!(took < (86 + 20) * slice, "released after {took} ticks");
    let last = (0..4).filter_map(|axis| lab.steps(axis).last().copied()).map(|step| step.tick).max().unwrap();
    assert!(last < released && last + 10 * slice > released, "{last} {levels:?}");
    lab.check_positions();
    // Where it stands it goes on from; a command meanwhile keeps the drivers on.
    let stands = lab.statuses().last().unwrap().positions;
    lab.send("a xyza 100 100 100 100\n");
    lab.run_ms(1500);
    lab.send("enable 0\nd x 1\n");
    lab.run_ms(2000);
    assert_eq!(lab.statuses().last().unwrap().positions, [101, 100, 100, 100]);
    assert_eq!(lab.counted(lab.now()), [101, 100, 100, 100], "from {stands:?}");
    assert_eq!(enable(&lab).len(), 4);
}

#[test]
fn enable_0_stops_and_releases() {
    releases::<VirtualUno>();
    releases::<VirtualPico>();
}

fn stops_by_deadman<B: Winch>() {
    let mut lab = WinchLab::<B>::new();
    script(&mut lab, &[(5, "deadman 300"), (5, "g xyza 2 1"), (5, "v xy 1000 -500")]);
    lab.run_ms(280);
    lab.send("ping\n");
    lab.run_ms(290);
    let steps = lab.steps(0).len();
    lab.run_ms(400);
    let stood = lab.steps(0).len();
    assert!(steps < stood, "a line keeps it going");
    lab.run_ms(300);
    assert_eq!(lab.steps(0).len(), stood, "it stands");
    assert_eq!(enable(&lab).last().map(|(_, level)| *level), Some(false), "and holds");
    lab.send("d x 10\n");
    lab.run_ms(280);
    assert!(lab.steps(0).len() > stood, "until it is told to go on");
    lab.check_positions();
}

#[test]
fn a_deadman_stops_it() {
    stops_by_deadman::<VirtualUno>();
    stops_by_deadman::<VirtualPico>();
}

fn excludes_frames<B: Winch>() {
    for mut lab in B::labs() {
        lab.send("g x 5 1\na x 100\n");
        lab.run_ms(900);
        // Text has it, from the very moment of its command.
        assert!(matches!(Remote::open(lab.port.clone(), 9), Err(RemoteError::Link(LinkError::Taken))));
        lab.send("enable 0\n");
        lab.run_ms(300);
        // Frames have it.
        let mut board = Remote::open(lab.port.clone(), 9).expect("it is free");
        B::check_frames(&mut board);
        let mut taken = WinchLab { port: board.port().clone(), ..lab.clone() };
        taken.run_ms(150);
        taken.partial.clear();
        assert_eq!(taken.ask("a x 5", 100), ["err taken"]);
        assert_eq!(taken.steps(0).len(), lab.steps(0).len(), "and nothing moves");
        // Nobody has it; text begins anew, and says nothing until it is asked.
        let mut lab = WinchLab { port: board.close(), ..taken };
        let had = lab.lines.len();
        lab.run_ms(500);
        assert_eq!(lab.lines.len(), had, "{:?}", &lab.lines[had..]);
        assert_eq!(lab.ask("nonsense", 50), [""; 0]);
        lab.edges.clear();
        lab.lines.clear();
        lab.send("a x 5\n");
        lab.run_ms(1000);
        assert_eq!(lab.lines.last().unwrap().text.split(' ').count(), 6);
        lab.check_positions();
    }
}

#[test]
fn text_and_frames_exclude_each_other() {
    excludes_frames::<VirtualUno>();
    excludes_frames::<VirtualPico>();
}

/// Lines that move axes about, within gains and limits that change too.
fn any_line(random: &mut Random) -> String {
    let axes = ["x", "y", "z", "a", "xy", "za", "xyza"][random.below(7) as usize];
    let values = |random: &mut Random, range: i64| -> String {
        axes.bytes().map(|_| format!(" {}", random.below(2 * range as u64) as i64 - range)).collect()
    };
    match random.below(12) {
        0..=2 => format!("a {axes}{}", values(random, 2000)),
        3..=4 => format!("d {axes}{}", values(random, 500)),
        5..=6 => format!("v {axes}{}", values(random, 12_000)),
        7 => format!("r {axes}{}", values(random, 100)),
        8 => format!("s {axes}{}", values(random, 3000)),
        9 => format!("g {axes} {}.{:02} 0.{}", random.below(8), 1 + random.below(99), 1 + random.below(9)),
        10 => format!("l {axes} {} {}", 100 + random.below(12_000), 1000 + random.below(300_000)),
        _ => "enable 0".to_owned(),
    }
}

/// Random commands, by each of its lines in turn.
fn loses_no_step<B: Winch>() {
    for (seed, lab) in seeds(1, 2).zip(B::labs().iter().cycle()) {
        println!("seed {seed}");
        let (mut lab, mut random) = (lab.clone(), Random::new(seed));
        let mut said = Vec::new();
        for _ in 0..25 {
            let line = any_line(&mut random);
            said.push(lab.say(&line));
            lab.run_ms(random.below(150));
        }
        lab.check_positions();
        let last = ["l xyza 9000 200000", "g xyza 3 0.9", "s xyza 0 0 0 0", "v xyza 0 0 0 0", "a xyza 11 -22 33 -44"];
        for line in last {
            lab.say(line);
        }
        lab.run_ms(3000);
        let statuses = lab.statuses();
        assert_eq!(statuses.last().unwrap().positions, [11, -22, 33, -44], "seed {seed}: {said:?}");
        assert_eq!(lab.counted(lab.now()), [11, -22, 33, -44], "seed {seed}");
        lab.check_positions();
        assert!(lab.lines.iter().skip(1).all(|line| line.text != "awake"), "seed {seed}: it ran dry");
        for axis in 0..4 {
            for pair in lab.steps(axis).windows(2) {
                let apart = pair[1].tick - pair[0].tick;
                assert!(apart >= B::MIN_APART, "seed {seed}, axis {axis}: {pair:?}");
            }
        }
    }
}

#[test]
fn any_commands_lose_no_step() {
    loses_no_step::<VirtualUno>();
    loses_no_step::<VirtualPico>();
}
