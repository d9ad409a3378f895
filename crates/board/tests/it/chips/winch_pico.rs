//! The Pico's firmware as clients of the winch see it, on the virtual Pico, by its UART and its own USB: what it says, and its pins
//! against core's paths, to the tick.

use pulsetrain_board::virtual_pico::{PicoPort, VirtualPico};
use pulsetrain_board::{Link, LinkError, Port, Remote, RemoteError, Setup};
use pulsetrain_emulator::UsbState;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::held::hold_for;
use pulsetrain_testkit::pico::step_dir;
use pulsetrain_testkit::winch::{Pico, SentLine, Status, WinchLab, Wired, follow};

/// Ticks of a slice, and of a µs.
const SLICE: u64 = Pico::SLICE;
const US: u64 = 125;

/// Levels of the enable line, with their ticks.
fn enable(pico: &Pico) -> Vec<(u64, bool)> {
    pico.edges.iter().filter(|edge| edge.line == VirtualPico::ENABLE).map(|edge| (edge.tick, edge.level)).collect()
}

/// One by its own USB port, which has just been opened.
fn on_usb() -> Pico {
    let mut pico = WinchLab::around(VirtualPico::on_usb());
    pico.run_ms(5);
    assert_eq!(pico.lines[0].text, "awake");
    pico
}

/// Sends lines, each so long after the one before, ms.
fn script(pico: &mut Pico, lines: &[(u64, &str)]) -> Vec<SentLine> {
    lines
        .iter()
        .map(|(wait, line)| {
            pico.run_ms(*wait);
            pico.say(line)
        })
        .collect()
}

#[test]
fn it_answers() {
    for mut pico in [Pico::new(), on_usb()] {
        let mut check =
            |line: &str, answer: &[&str]| assert_eq!(pico.ask(line, 12 + line.len() as u64 / 10), answer, "{line:?}");
        check("version", &["id StepperWinch Nov 21 2026"]);
        check("ping", &["awake"]);
        check("", &[]);
        check("jump 3", &["err command 1"]);
        check("a x nan", &["err number 3"]);
        check("a 5", &["err flags 2"]);
        check("g x 30 1", &["err range 3 0.01..20 Hz"]);
        check("a x 1*00", &["err checksum 3"]);
        check("srate 0", &["dbg invalid srate value"]);
        check(&"x".repeat(200), &["err long 1"]);
        check("strict 1", &[]);
        check("a xq 1", &["err flags 2"]);
        check("strict 0", &[]);
        // Nothing of it has moved anything, and no driver was ever on.
        pico.run_ms(1000);
        let edges: Vec<_> = pico.edges.iter().filter(|edge| edge.line > 1).collect();
        assert!(edges.is_empty(), "but for the UART's own pins: {edges:?}");
        let statuses = pico.statuses();
        assert!(statuses.len() >= 4 && statuses.iter().all(|status| status.positions == [0; 4]));
        for pair in statuses.windows(2) {
            let apart = pair[1].usec - pair[0].usec;
            assert!((198_000..202_000).contains(&apart), "{apart} us");
        }
        // What comes all at once is answered in order, and nothing is lost.
        let had = pico.lines.len();
        pico.send("ping\n\rversion\n".repeat(100));
        pico.run_ms(500);
        let said: Vec<_> =
            pico.lines[had..].iter().map(|line| line.text.as_str()).filter(|text| !text.starts_with("txyza")).collect();
        assert_eq!(said, ["awake", "id StepperWinch Nov 21 2026"].repeat(100));
    }
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
        // As fast as all can.
        &[(5, "l xyza 10000 100000"), (5, "g xyza 2 1"), (5, "v xyza 10000 -9935 9971 -10000")],
    ] {
        for mut pico in [Pico::new(), on_usb()] {
            let by_usb = pico.port.chip().usb_state() == UsbState::Open;
            let said: Vec<_> = lines
                .iter()
                .map(|(wait, line)| {
                    pico.run_ms(*wait);
                    let sent = pico.now();
                    let said = pico.say(line);
                    // USB takes no time.
                    if by_usb { SentLine { tick: sent, ..said } } else { said }
                })
                .collect();
            pico.run_ms(1500);
            let (late, longest) = follow(&pico, &said).unwrap_or_else(|why| panic!("{lines:?}: {why}"));
            let steps = late.iter().map(Vec::len).sum::<usize>();
            println!("{steps} steps; {} us to a line's slice", longest / US);
            assert!(steps > 500, "{lines:?}: {steps}");
            assert!(late.iter().flatten().all(|late| *late == 0), "{lines:?}: every step on its tick");
            assert!(longest < 6 * SLICE, "{lines:?}: {longest}");
            pico.check_positions();
        }
    }
}

#[test]
fn bursts_are_obeyed() {
    for others in ["", "v xza 9999 -9990 9971\n"] {
        for mut pico in [Pico::new(), on_usb()] {
            pico.send(format!("l xyza 10000 100000\ng xyza 5 1\n{others}"));
            pico.run_ms(800);
            pico.send("d y 10\n".repeat(100));
            pico.run_ms(1500);
            assert_eq!(pico.statuses().last().unwrap().positions[1], 1000);
            let said = |text: &str| text == "awake" || text.starts_with("txyza");
            assert!(pico.lines.iter().all(|line| said(&line.text)), "nothing was lost");
            pico.check_positions();
        }
    }
}

/// The longest answers to the shortest lines: packet after packet, none is lost.
#[test]
fn each_line_of_a_burst_is_answered() {
    let mut pico = on_usb();
    pico.run_ms(50);
    pico.send("*\n".repeat(400));
    pico.run_ms(500);
    let answers = pico.lines.iter().filter(|line| line.text == "err checksum 0");
    assert_eq!(answers.count(), 400);
}

/// A host that does not read is obeyed all the same, and so is one on the other line; when it reads again it hears whole lines.
#[test]
fn nobody_waits_for_who_does_not_read() {
    let mut port = VirtualPico::on_usb();
    let run = |port: &mut VirtualPico, line, ms| {
        let (until, mut heard) = (port.now() + std::time::Duration::from_millis(ms), Vec::new());
        while port.now() < until {
            port.receive_on(line, until, &mut heard);
        }
        heard
    };
    port.send_on(PicoPort::Usb, b"g xyza 5 1\n");
    run(&mut port, PicoPort::Usb, 10);
    port.chip_mut().usb_fill(true);
    port.send_on(PicoPort::Usb, "nonsense\nd x 10\n".repeat(100).as_bytes());
    port.send_on(PicoPort::Uart, "d y 10\n".repeat(100).as_bytes());
    run(&mut port, PicoPort::Uart, 2500);
    port.chip_mut().usb_fill(false);
    let heard = run(&mut port, PicoPort::Usb, 300);
    let text = String::from_utf8(heard).expect("text");
    let known = |line: &str| line.starts_with("txyza ") || line == "err command 1";
    assert!(text.ends_with("\r\n") && text.lines().all(known), "{text}");
    assert!(text.trim_end().ends_with(" 1000 1000 0 0"), "{text}");
}

/// A main loop that is held up, as nothing of ours does: the axes stop, nobody knows where they stand, and text begins anew.
#[test]
fn a_machine_that_ran_dry_is_a_new_beginning() {
    let mut pico = Pico::new();
    pico.send("g xyza 5 1\nv xyza 1000 2000 3000 -3000\n");
    pico.run_ms(500);
    hold_for(&mut pico.port, 4 * SLICE);
    let held = pico.now();
    pico.run_ms(300);
    assert_eq!(pico.lines.iter().filter(|line| line.text == "awake").count(), 2);
    assert!((0..4).all(|axis| pico.steps(axis).last().is_some_and(|step| step.tick < held)), "all stand");
    assert_eq!(enable(&pico).last().map(|(_, level)| *level), Some(true), "the drivers are off");
    assert_eq!(pico.statuses().last().unwrap().positions, [0; 4]);
    pico.edges.clear();
    pico.lines.clear();
    // Its DIR is low already.
    pico.send("g a 5 1\na a 7\n");
    pico.run_ms(2000);
    assert_eq!(pico.counted(pico.now()), [0, 0, 0, 7]);
    assert_eq!(pico.statuses().last().unwrap().positions, [0, 0, 0, 7]);
}

#[test]
fn enable_0_stops_and_releases() {
    let mut pico = Pico::new();
    script(&mut pico, &[(5, "g xyza 2 1"), (5, "v xyza 3000 -3000 100 1")]);
    pico.run_ms(700);
    let stopped = pico.say("enable 0").tick;
    pico.run_ms(300);
    // At first high, then on with the first command that moves; off again when all is still: 3000 / 35 000 s after.
    let levels = enable(&pico);
    assert_eq!(levels.iter().map(|(_, level)| *level).collect::<Vec<_>>(), [true, false, true]);
    let took = levels[2].0 - stopped;
    println!("released after {} us", took / US);
    assert!(took < (86 + 20) * SLICE, "{took} ticks");
    let last = (0..4).filter_map(|axis| pico.steps(axis).last().copied()).map(|step| step.tick).max().unwrap();
    assert!(last < levels[2].0 && last + 10 * SLICE > levels[2].0, "{last} {levels:?}");
    pico.check_positions();
    // Where it stands it goes on from; a command meanwhile keeps the drivers on.
    let stands = pico.statuses().last().unwrap().positions;
    pico.send("a xyza 100 100 100 100\n");
    pico.run_ms(1500);
    pico.send("enable 0\nd x 1\n");
    pico.run_ms(2000);
    assert_eq!(pico.statuses().last().unwrap().positions, [101, 100, 100, 100]);
    assert_eq!(pico.counted(pico.now()), [101, 100, 100, 100], "from {stands:?}");
    assert_eq!(enable(&pico).len(), 4);
}

#[test]
fn a_deadman_stops_it() {
    let mut pico = Pico::new();
    script(&mut pico, &[(5, "deadman 300"), (5, "g xyza 2 1"), (5, "v xy 1000 -500")]);
    pico.run_ms(280);
    pico.send("ping\n");
    pico.run_ms(290);
    let steps = pico.steps(0).len();
    pico.run_ms(400);
    let stood = pico.steps(0).len();
    assert!(steps < stood, "a line keeps it going");
    pico.run_ms(300);
    assert_eq!(pico.steps(0).len(), stood, "it stands");
    assert_eq!(enable(&pico).last().map(|(_, level)| *level), Some(false), "and holds");
    pico.send("d x 10\n");
    pico.run_ms(280);
    assert!(pico.steps(0).len() > stood, "until it is told to go on");
    pico.check_positions();
}

#[test]
fn text_and_frames_exclude_each_other() {
    let setup = Setup { pulse_ticks: 125, motors: vec![step_dir(10)], ..Setup::default() };
    for mut pico in [Pico::new(), on_usb()] {
        pico.send("g x 5 1\na x 100\n");
        pico.run_ms(900);
        // Text has it, from the very moment of its command.
        assert!(matches!(Remote::open(pico.port.clone(), 9), Err(RemoteError::Link(LinkError::Taken))));
        pico.send("enable 0\n");
        pico.run_ms(300);
        // Frames have it.
        let mut board = Remote::open(pico.port.clone(), 9).expect("it is free");
        board.configure(&setup).expect("it takes it");
        assert!(board.events().is_empty(), "what text did is not told");
        let mut taken = Pico { port: board.port().clone(), ..pico.clone() };
        taken.run_ms(150);
        taken.partial.clear();
        assert_eq!(taken.ask("a x 5", 100), ["err taken"]);
        assert_eq!(taken.steps(0).len(), pico.steps(0).len(), "and nothing moves");
        // Nobody has it; text begins anew, and says nothing until it is asked.
        let mut pico = Pico { port: board.close(), ..taken };
        let had = pico.lines.len();
        pico.run_ms(500);
        assert_eq!(pico.lines.len(), had, "{:?}", &pico.lines[had..]);
        assert_eq!(pico.ask("nonsense", 50), [""; 0]);
        pico.edges.clear();
        pico.lines.clear();
        pico.send("a x 5\n");
        pico.run_ms(1000);
        assert_eq!(pico.lines.last().unwrap().text.split(' ').count(), 6);
        pico.check_positions();
    }
}

/// Wherever a Hello comes between the bytes of a command that enables the drivers and its effect, one of both has the board: the
/// command on the UART, Hello over USB.
#[test]
fn hello_in_the_moment_of_a_command() {
    // Who had the board: text, frames.
    let mut had = [0, 0];
    for us in (0..3000).step_by(500) {
        let mut pico = on_usb();
        pico.port.send_on(PicoPort::Uart, b"v x 1000\n");
        let until = pico.port.now() + std::time::Duration::from_micros(us);
        while pico.port.now() < until {
            pico.port.receive(until, &mut Vec::new()).unwrap();
        }
        let opened = Remote::open(pico.port.clone(), 9);
        match opened {
            Err(RemoteError::Link(LinkError::Taken)) => {
                had[0] += 1;
                let mut pico = WinchLab::around(pico.port);
                pico.run_ms(100);
                assert!(!pico.steps(0).is_empty(), "{us} us: text has it");
            }
            Ok(board) => {
                had[1] += 1;
                let mut pico = WinchLab::around(board.port().clone());
                pico.run_ms(100);
                assert_eq!(pico.steps(0).len(), 0, "{us} us: frames have it");
            }
            Err(error) => panic!("{us} us: {error}"),
        }
    }
    assert!(had[0] > 0 && had[1] > 0, "text {}, frames {}", had[0], had[1]);
}

/// What comes of a Hello on a line: why it is refused, if it is.
fn hello_on(port: &mut VirtualPico, line: PicoPort) -> Option<LinkError> {
    let mut link = Link::new(77);
    link.hello(port.now());
    let patience = port.now() + std::time::Duration::from_secs(8);
    let mut heard = Vec::new();
    while link.error().is_none() && link.info().is_none() {
        assert!(port.now() < patience, "no answer on {line:?}");
        heard.clear();
        link.output(port.now(), &mut heard);
        port.send_on(line, &heard);
        heard.clear();
        port.receive_on(line, port.now() + std::time::Duration::from_millis(1), &mut heard);
        link.input(&heard, port.now());
    }
    link.error()
}

/// Frames on one line: text on the other is told so; and while text drives, Hello is refused on both.
#[test]
fn each_line_hears_of_the_other() {
    let mut port = VirtualPico::on_usb();
    let mut lines = [Vec::new(), Vec::new()];
    let run = |port: &mut VirtualPico, lines: &mut [Vec<u8>; 2], ms| {
        let until = port.now() + std::time::Duration::from_millis(ms);
        while port.now() < until {
            let next = (port.now() + std::time::Duration::from_millis(1)).min(until);
            port.receive_on(PicoPort::Usb, next, &mut lines[1]);
            port.receive_on(PicoPort::Uart, next, &mut lines[0]);
        }
    };
    run(&mut port, &mut lines, 210);
    for heard in &lines {
        assert!(heard.starts_with(b"awake\r\ntxyza "), "{}", String::from_utf8_lossy(heard));
    }
    // Axes and settings are the same by both.
    port.send_on(PicoPort::Uart, b"g x 5 1\na x 50\n");
    port.send_on(PicoPort::Usb, b"srate 50\n");
    run(&mut port, &mut lines, 30);
    // Text drives, and what it is told on one line holds frames off on both.
    for line in [PicoPort::Usb, PicoPort::Uart] {
        assert_eq!(hello_on(&mut port.clone(), line), Some(LinkError::Taken), "{line:?}");
    }
    run(&mut port, &mut lines, 1470);
    for heard in &lines {
        let text = String::from_utf8_lossy(heard);
        assert!(text.lines().count() > 25 && text.trim_end().ends_with(" 50 0 0 0"), "{text}");
    }
    port.send_on(PicoPort::Usb, b"enable 0\n");
    run(&mut port, &mut lines, 100);
    // Frames over USB; text on the UART.
    let mut board = Remote::open(port, 9).expect("it is free");
    board.configure(&Setup { pulse_ticks: 125, motors: vec![step_dir(10)], ..Setup::default() }).expect("it takes it");
    let mut port = board.port().clone();
    lines = [Vec::new(), Vec::new()];
    port.send_on(PicoPort::Uart, b"a x 5\nnonsense\n");
    run(&mut port, &mut lines, 100);
    assert_eq!(String::from_utf8_lossy(&lines[0]), "err taken\r\nerr taken\r\n");
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
    for seed in 1..=6 {
        let (mut pico, mut random) = (if seed % 2 == 0 { on_usb() } else { Pico::new() }, Random::new(seed));
        let mut said = Vec::new();
        for _ in 0..25 {
            let line = any_line(&mut random);
            said.push(pico.say(&line));
            pico.run_ms(random.below(150));
        }
        pico.check_positions();
        let last = ["l xyza 9000 200000", "g xyza 3 0.9", "s xyza 0 0 0 0", "v xyza 0 0 0 0", "a xyza 11 -22 33 -44"];
        for line in last {
            pico.say(line);
        }
        pico.run_ms(4000);
        let statuses = pico.statuses();
        assert_eq!(statuses.last().unwrap().positions, [11, -22, 33, -44], "seed {seed}: {said:?}");
        assert_eq!(pico.counted(pico.now()), [11, -22, 33, -44], "seed {seed}");
        pico.check_positions();
        assert!(pico.lines.iter().skip(1).all(|line| line.text != "awake"), "seed {seed}: a machine ran dry");
        // No faster than the fastest.
        for axis in 0..4 {
            for pair in pico.steps(axis).windows(2) {
                let apart = pair[1].tick - pair[0].tick;
                assert!(apart >= 12_499, "seed {seed}, axis {axis}: {pair:?}");
            }
        }
    }
}

/// Ticks are 32 bits in most places and wrap after 34.36 s: motion goes on through that, and begins anew after a rest of more than
/// half of it.
#[test]
fn the_clock_wraps() {
    let mut pico = Pico::new();
    pico.send("g xyza 2 1\nsrate 50\n");
    pico.run_ms(33_500);
    pico.send("v xyza 1234 -7 0 0\n");
    pico.run_ms(1500);
    pico.send("v xyza 0 0 0 0\na xyza 2000 -10 10 0\n");
    pico.run_ms(20_000);
    pico.send("a xyza 2100 -110 110 -100\n");
    pico.run_ms(2000);
    let Status { usec, positions } = *pico.statuses().last().unwrap();
    assert!(usec > 56_000_000, "{usec}");
    assert_eq!(positions, [2100, -110, 110, -100]);
    assert_eq!(pico.counted(pico.now()), positions);
    pico.check_positions();
}
