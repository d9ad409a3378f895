//! The Uno's firmware as clients of the winch see it, on the virtual Uno: what it says, and its pins against core's paths.

use pulsetrain_board::{LinkError, Remote, RemoteError};
use pulsetrain_core::wire::Reason;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::seed::{rounds, seed};
use pulsetrain_testkit::winch::{ENABLE, SLICE, SentLine, Uno, follow};

/// Levels of the enable line, with their ticks.
fn enable(uno: &Uno) -> Vec<(u64, bool)> {
    uno.edges.iter().filter(|edge| edge.line == ENABLE).map(|edge| (edge.tick, edge.level)).collect()
}

/// Sends lines, each so long after the one before, ms.
fn script(uno: &mut Uno, lines: &[(u64, &str)]) -> Vec<SentLine> {
    lines
        .iter()
        .map(|(wait, line)| {
            uno.run_ms(*wait);
            uno.say(line)
        })
        .collect()
}

#[test]
fn statuses_are_on_time_while_four_axes_run() {
    for (speed, most_us) in [(4000, 1300), (9000, 1500), (10_000, 1500)] {
        let mut uno = Uno::new();
        uno.send("l xyza 10000 100000\ng xyza 2 1\nsrate 40\n");
        uno.send(format!("v xyza {} {} {} {}\n", speed, speed - 31, -speed, 17 - speed));
        uno.run_ms(800);
        let had = uno.statuses().len();
        uno.run_ms(4000);
        let statuses = &uno.statuses()[had..];
        assert!(statuses.len() >= 98, "{}", statuses.len());
        let late: Vec<i32> = statuses
            .iter()
            .enumerate()
            .map(|(at, status)| status.usec - statuses[0].usec - 40_000 * at as i32)
            .collect();
        let apart = late.iter().max().unwrap() - late.iter().min().unwrap();
        println!("at {speed} steps/s statuses are within {apart} us of one time in 40 ms");
        assert!(apart <= most_us, "{speed} steps/s: {apart} us");
        uno.check_positions();
    }
}

#[test]
fn it_answers() {
    let mut uno = Uno::new();
    let mut check =
        |line: &str, answer: &[&str]| assert_eq!(uno.ask(line, 12 + line.len() as u64 / 10), answer, "{line:?}");
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
    uno.run_ms(1000);
    assert!(uno.edges.iter().all(|edge| edge.line == 1), "but for the line's own pin");
    let statuses = uno.statuses();
    assert!(statuses.iter().all(|status| status.positions == [0; 4]));
    // Each at the first look behind its time, which is 200 ms after that of the one before: nothing adds up.
    assert!(statuses.len() >= 5);
    for (at, status) in statuses.iter().enumerate() {
        let late = status.usec - statuses[0].usec - 200_000 * at as i32;
        assert!((-1100..1100).contains(&late), "{late} us");
    }
    // So often that a line takes longer, and back: no more than there is time for, and none is made up for.
    uno.send("srate 1\n");
    uno.run_ms(500);
    let had = uno.statuses().len();
    assert!(had > 100, "{had}");
    uno.send("srate 200\n");
    uno.run_ms(1000);
    assert!((4..=6).contains(&(uno.statuses().len() - had)), "{:?}", &uno.statuses()[had..]);
    // What comes all at once is answered in order, and nothing is lost.
    let had = uno.lines.len();
    uno.send("ping\nversion\njump\nping\n");
    uno.run_ms(60);
    let said: Vec<_> =
        uno.lines[had..].iter().map(|line| &line.text[..]).filter(|text| !text.starts_with("txyza")).collect();
    assert_eq!(said, ["awake", "id StepperWinch Nov 21 2026", "err command 1", "awake"]);
}

#[test]
fn steps_are_those_of_the_paths() {
    for lines in [
        // As clients set out: it rings.
        &[(5, "a xyza 400 -300 25 7"), (900, "d xy 10 -10"), (700, "a z 0")][..],
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
    ] {
        let mut uno = Uno::new();
        let said = script(&mut uno, lines);
        uno.run_ms(1500);
        let (late, longest) = follow(&uno, &said).unwrap_or_else(|why| panic!("{lines:?}: {why}"));
        let steps = late.iter().map(Vec::len).sum::<usize>();
        let (least, most) = (late.iter().flatten().min().unwrap(), late.iter().flatten().max().unwrap());
        println!("{steps} steps, {least} to {most} ticks late; {} us to a line's slice", longest / 16);
        assert!(steps > 500 && *least >= -38 && *most <= 64, "{lines:?}: {steps} {least} {most}");
        uno.check_positions();
    }
}

#[test]
fn four_axes_at_full_speed() {
    let mut uno = Uno::new();
    let mut said = script(&mut uno, &[(5, "l xyza 10000 100000"), (5, "g xyza 2 1")]);
    said.extend(script(&mut uno, &[(5, "v xyza 9999 -9935 9971 -9935")]));
    uno.run_ms(1200);
    let (late, longest) = follow(&uno, &said).unwrap();
    // Once at speed: more than 38 steps a millisecond.
    let mut late: Vec<i64> = late.iter().flat_map(|late| &late[late.len() - 9000..]).copied().collect();
    late.sort_unstable();
    let (least, most, p99) = (late[0], late[late.len() - 1], late[late.len() * 99 / 100]);
    println!("{} steps: {least} to {most} ticks late, 99 % at most {p99}; {} us", late.len(), longest / 16);
    assert!(least >= -38 && p99 <= 64 && most <= 100, "{least} {p99} {most}");
    // And meanwhile the line is full of lines, both ways.

    uno.send("d y 10\n".repeat(100));
    uno.send("a x 7000000000\n".repeat(20));
    uno.run_ms(200);
    uno.send("v xyza 0 0 0 0\nsrate 200\n");
    uno.run_ms(1800);
    uno.check_positions();
    let [_, y, _, a] = uno.statuses().last().unwrap().positions;
    assert_eq!(y - a, 1000, "of two that drift alike, one has moved by so much");
    assert!(uno.lines.iter().any(|line| line.text == "err range 3"));
    assert!(uno.lines.iter().skip(1).all(|line| line.text != "awake"));
}

#[test]
fn bursts_are_obeyed() {
    for others in ["", "v xza 9999 -9990 9971\n"] {
        let mut uno = Uno::new();
        uno.send(format!("l xyza 10000 100000\ng xyza 5 1\n{others}"));
        uno.run_ms(800);
        uno.send("d y 10\n".repeat(100));
        uno.run_ms(1500);
        assert_eq!(uno.statuses().last().unwrap().positions[1], 1000);
        assert!(
            uno.lines.iter().all(|line| line.text == "awake" || line.text.starts_with("txyza")),
            "nothing was lost"
        );
        uno.check_positions();
    }
}

#[test]
fn a_refusal_among_many_answers_is_told() {
    for (before, after) in [(0, 200), (10, 40), (40, 10), (100, 0), (100, 1), (100, 100)] {
        let mut uno = Uno::new();
        uno.send(format!("{}a x nan\n{}", "version\n".repeat(before), "version\n".repeat(after)));
        uno.run_ms(1500);
        let refusals = uno.lines.iter().filter(|line| line.text == "err number 3").count();
        assert_eq!(refusals, 1, "{before} lines before it, {after} after: {:?}", uno.lines);
    }
}

#[test]
fn enable_0_stops_and_releases() {
    let mut uno = Uno::new();
    script(&mut uno, &[(5, "g xyza 2 1"), (5, "v xyza 3000 -3000 100 1")]);
    uno.run_ms(700);
    let stopped = uno.say("enable 0").tick;
    uno.run_ms(300);
    // At first high, then on with the first command that moves; off again when all is still: docs/winch.md says 3000 / 35 000 s,
    // and 20 ms at most.
    let levels = enable(&uno);
    assert_eq!(levels.iter().map(|(_, level)| *level).collect::<Vec<_>>(), [true, false, true]);
    let released = levels[2].0;
    let took = released - stopped;
    println!("released after {} us", took / 16);
    assert!(took < (86 + 20) * SLICE, "{took} ticks");
    let last = (0..4).filter_map(|axis| uno.steps(axis).last().copied()).map(|step| step.tick).max().unwrap();
    assert!(last < released && last + 10 * SLICE > released, "{last} {levels:?}");
    uno.check_positions();
    // Where it stands it goes on from; a command meanwhile keeps the drivers on.
    let stands = uno.statuses().last().unwrap().positions;
    uno.send("a xyza 100 100 100 100\n");
    uno.run_ms(1500);
    uno.send("enable 0\nd x 1\n");
    uno.run_ms(2000);
    assert_eq!(uno.statuses().last().unwrap().positions, [101, 100, 100, 100]);
    assert_eq!(uno.counted(uno.now()), [101, 100, 100, 100], "from {stands:?}");
    assert_eq!(enable(&uno).len(), 4);
}

#[test]
fn a_deadman_stops_it() {
    let mut uno = Uno::new();
    script(&mut uno, &[(5, "deadman 300"), (5, "g xyza 2 1"), (5, "v xy 1000 -500")]);
    uno.run_ms(280);
    uno.send("ping\n");
    uno.run_ms(290);
    let steps = uno.steps(0).len();
    uno.run_ms(400);
    let stood = uno.steps(0).len();
    assert!(steps < stood, "a line keeps it going");
    uno.run_ms(300);
    assert_eq!(uno.steps(0).len(), stood, "it stands");
    assert_eq!(enable(&uno).last().map(|(_, level)| *level), Some(false), "and holds");
    uno.send("d x 10\n");
    uno.run_ms(280);
    assert!(uno.steps(0).len() > stood, "until it is told to go on");
    uno.check_positions();
}

#[test]
fn text_and_frames_exclude_each_other() {
    let mut uno = Uno::new();
    uno.send("a x 100\n");
    uno.run_ms(500);
    // Text has it.
    assert!(matches!(Remote::open(uno.port.clone(), 9), Err(RemoteError::Link(LinkError::Taken))));
    uno.send("enable 0\n");
    uno.run_ms(300);
    // Frames have it.
    let mut board = Remote::open(uno.port.clone(), 9).expect("it is free");
    // They move nothing: this image takes no plans.
    let refused = board.configure(&pulsetrain_testkit::uno_setup(&[(2, 5)], 16));
    assert!(matches!(refused, Err(RemoteError::Refused { reason: Reason::UnknownKind, .. })), "{refused:?}");
    let mut taken = Uno { port: board.port().clone(), ..uno.clone() };
    taken.run_ms(150);
    assert_eq!(taken.ask("a x 5", 100), ["err taken"]);
    assert!(taken.steps(0).len() == uno.steps(0).len(), "and nothing moves");
    // Nobody has it; text begins anew, and says nothing until it is asked.
    let mut uno = Uno { port: board.close(), ..taken };
    let had = uno.lines.len();
    uno.run_ms(500);
    assert_eq!(uno.lines.len(), had, "{:?}", &uno.lines[had..]);
    assert_eq!(uno.ask("nonsense", 50), [""; 0]);
    uno.edges.clear();
    uno.lines.clear();
    uno.send("a x 5\n");
    uno.run_ms(1000);
    assert_eq!(uno.lines.last().unwrap().text.split(' ').count(), 6);
    uno.check_positions();
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

#[test]
fn any_commands_lose_no_step() {
    let first = seed(1);
    for seed in (0..4 * rounds()).map(|more| first.wrapping_add(more)) {
        println!("seed {seed}");
        let (mut uno, mut random) = (Uno::new(), Random::new(seed));
        let mut said = Vec::new();
        for _ in 0..25 {
            let line = any_line(&mut random);
            said.push(uno.say(&line));
            uno.run_ms(random.below(150));
        }
        uno.check_positions();
        let last = ["l xyza 9000 200000", "g xyza 3 0.9", "s xyza 0 0 0 0", "v xyza 0 0 0 0", "a xyza 11 -22 33 -44"];
        for line in last {
            uno.say(line);
        }
        uno.run_ms(4000);
        let statuses = uno.statuses();
        assert_eq!(statuses.last().unwrap().positions, [11, -22, 33, -44], "seed {seed}: {said:?}");
        assert_eq!(uno.counted(uno.now()), [11, -22, 33, -44], "seed {seed}");
        uno.check_positions();
        assert!(uno.lines.iter().skip(1).all(|line| line.text != "awake"), "seed {seed}: the rings ran dry");
        // No faster than the fastest: 1600 ticks apart, but for what edges may be moved.
        for axis in 0..4 {
            for pair in uno.steps(axis).windows(2) {
                let apart = pair[1].tick - pair[0].tick;
                assert!(apart >= 1600 - 2 * 64, "seed {seed}, axis {axis}: {pair:?}");
            }
        }
    }
}
