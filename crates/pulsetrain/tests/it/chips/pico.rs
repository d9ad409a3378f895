//! Commands with the Pico: its firmware runs the examples, its pins are checked, and its coils are released when the
//! file says so.

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain::load;
use pulsetrain_board::native::QUEUE_LEN;
use pulsetrain_board::shared::Shared;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::{Board, Edge, Lease, Leased, Observer, Port, Remote, RemoteError, ScheduledStep, Setup};
use pulsetrain_core::verbs::Verb;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Cause, MotorSetup};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_motion::{boards, file};
use pulsetrain_session::drive::{Driven, connect_while};
use pulsetrain_testkit::folder::Folder;
use std::io::ErrorKind;
use std::time::Duration;

fn pulsetrain(args: &[&str]) -> (Exit, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run([&["pulsetrain"], args].concat(), &mut out, &mut err);
    (exit, String::from_utf8(out).unwrap() + &String::from_utf8(err).unwrap())
}

/// The text of an error, without the line breaks of its layout.
fn in_a_line(said: &str) -> String {
    said.replace('│', " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// The tutorial's motion for an Uno, the same motion too fast for an Uno, and the Pico's own example: they run on the
/// Pico's firmware, and the pins pass the judge.
#[test]
fn its_firmware_runs_the_tutorial_and_its_own_example() {
    let folder = Folder::new("pico-examples");
    for name in ["tutorial.toml", "tutorial-0.01s.toml", "pico.toml"] {
        let file = format!("../../examples/{name}");
        let out = folder.path(name);
        let (exit, said) = pulsetrain(&["run", &file, "--board", "pico", "--out", &out]);
        assert_eq!(exit, Exit::Success, "{said}");
        assert!(said.contains("on the virtual Pico, firmware"), "{said}");
        let (exit, said) = pulsetrain(&["verify", &format!("{out}/trace.vcd"), &file, "--board", "pico", "--pins"]);
        assert_eq!(exit, Exit::Success, "{said}");
    }
}

/// A motor `a` that hardly moves, and a motor `b`, with their drivers.
fn beside(board: &str, a: &str, b: &str, law: &str) -> String {
    format!(
        "board = \"{board}\"\n[motor.a]\nsteps_per_rev = 200\n{a}\npins = {{ step = 2, dir = 3 }}\nforward = \"high\"\n\
         [motor.b]\nsteps_per_rev = 200\n{b}\npins = {{ step = 4, dir = 5 }}\nforward = \"high\"\npull_in = \"200000 step/s\"\n\
         [[motion]]\nmotor = \"a\"\nlaw.sine = {{ amplitude = \"2 step\", period = \"0.1 s\", cycles = 1 }}\n\
         [[motion]]\nmotor = \"b\"\n{law}\n"
    )
}

/// A board makes all pulses as long as the slowest driver needs. What is left of an interval, and of a reversal, must
/// suffice for each motor.
#[test]
fn a_long_pulse_beside_leaves_each_driver_its_times() {
    let folder = Folder::new("pico-beside");
    let file = folder.path("beside.toml");
    let run = |text: &str| {
        std::fs::write(&file, text).unwrap();
        let (exit, said) = pulsetrain(&["run", &file, "-v", "--out", &folder.name()]);
        (exit, in_a_line(&said))
    };
    let fast = |rate| {
        let law = format!("law.speed = {{ speed = \"{rate} step/s\", duration = \"0.1 s\" }}");
        run(&beside("pico", "driver = \"TB6600\"", "microsteps = 2\ndriver = \"DQ542MA\"", &law))
    };
    let (exit, said) = fast(66_000);
    assert_eq!(exit, Exit::Success, "{said}");
    let (exit, said) = fast(67_000);
    assert_eq!(exit, Exit::Refused, "{said}");
    let why = "the limit is the pulse of motor a: pico makes the pulses of all motors equally long, and the driver of a (TB6600) needs \
               10 µs HIGH; that of b needs 5.05 µs HIGH and 5.05 µs LOW, with which 98.9 k steps/s fit. A driver with a shorter pulse for \
               motor a helps, or a board of its own as it is, it fits: due (no firmware yet), native";
    assert!(said.contains(why), "{said}");
    // Reversals that each driver allows by itself, but not after the long pulse: two steps of b are dropped.
    let long = "pulse_high = \"10 us\"\ndir_setup = \"1 us\"\ndir_hold = \"1 us\"";
    let held = "pulse_high = \"1 us\"\ndir_setup = \"1 us\"\ndir_hold = \"8 us\"";
    for (board, rate, apart_us, steps) in [
        ("pico", 40_000.0, 22.0, 200),
        ("pico", 40_000.0, 28.5, 202),
        ("native", 40_000.0, 22.0, 202),
        ("uno", 20_000.0, 30.0, 200),
        ("uno", 20_000.0, 40.0, 202),
    ] {
        let ms = (100.5 + rate * apart_us * 1e-6 / 2.0) / rate * 1e3;
        let there = |sign| format!("{{ speed = {{ speed = \"{sign}{rate} step/s\", duration = \"{ms:.5} ms\" }} }}");
        let law = format!("law.then = [{}, {}]", there(""), there("-"));
        let (exit, said) = run(&beside(board, long, held, &law));
        assert_eq!(exit, Exit::Success, "{board}, {apart_us} µs: {said}");
        assert!(said.contains(&format!(" {steps} of {steps} ")), "{board}, {apart_us} µs: {said}");
    }
}

/// A motion with short segments: the Pico's queue holds more than a thousand of them. The native reference board holds
/// as many, so that no step counts as added.
#[test]
fn a_queue_of_many_short_segments_loses_and_adds_nothing() {
    let folder = Folder::new("pico-short-segments");
    let file = folder.path("short.toml");
    let text = "board = \"pico\"\ntolerance = \"1 tick\"\n[motor.wheel]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"TMC2209\"\n\
                pins = { step = 2, dir = 3 }\nforward = \"high\"\n[[motion]]\nmotor = \"wheel\"\n\
                law.sum = [{ sine = { amplitude = \"56.8 step\", period = \"0.1 s\", cycles = 10 } }, \
                { sine = { amplitude = \"140 step\", period = \"0.25 s\", cycles = 4 } }, \
                { sine = { amplitude = \"7.7 step\", period = \"0.02 s\", cycles = 50 } }]\n";
    std::fs::write(&file, text).unwrap();
    let (exit, said) = pulsetrain(&["run", &file, "-v", "--out", &folder.path("out")]);
    let segments = said.lines().find_map(|line| line.trim().strip_prefix("segments")).expect("it is told");
    let segments: usize = segments.split_whitespace().collect::<String>().parse().unwrap();
    assert!(segments > QUEUE_LEN, "{segments} segments");
    assert!(said.contains("Steps lost 0, added 0") && said.contains("\nPASS: no bound broke\n"), "{said}");
    assert_eq!(exit, Exit::Success, "{said}");
}

/// A host finds motors moving for an earlier host: its caller is asked at once whether to wait. If it gives up, for
/// whatever reason, the motors move on.
#[test]
fn a_refused_host_leaves_what_moves_to_the_next() {
    let board = Shared::new(VirtualPico::on_usb());
    let mut host = Remote::open(board.clone(), 1).unwrap();
    host.configure(&Setup { pulse_ticks: 250, motors: drivers(1), ..Setup::default() }).unwrap();
    host.tell_motors(&[(0, Verb::Move { steps: 5000 })]).unwrap();
    host.close();
    let program = |board: &str| {
        let text = format!(
            "{board}\n[motor.wheel]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = {{ step = 2, dir = 3 }}\nforward = \"high\"\n{SINE}"
        );
        file::read(&text, "wheel.toml", &|_| Err(ErrorKind::NotFound.into())).unwrap()
    };
    let mut asked = 0;
    let began = board.now();
    let refused = connect_while(board.clone(), &program("board = \"pico\""), Baud::B1M, || {
        asked += 1;
        asked < 3
    });
    assert_eq!((refused.err(), asked), (Some(RemoteError::StillMoving), 3));
    assert!(board.now() - began < Duration::from_millis(300), "{:?}", board.now() - began);
    let refused = connect_while(board.clone(), &program("board = \"uno\""), Baud::B1M, || panic!("another board"));
    assert!(matches!(refused, Err(RemoteError::OtherBoard { .. })));
    // Longer than the silence after which a host counts as lost.
    let until = board.now() + Duration::from_secs(3);
    while board.now() < until {
        board.clone().receive(until, &mut Vec::new()).unwrap();
    }
    let mut next = Remote::open(board.clone(), 2).unwrap();
    assert!(!next.status().unwrap().is_idle());
    next.close();
    // A host that waits gets the board when all steps were made.
    let mut asked = 0;
    let next = connect_while(board.clone(), &program("board = \"pico\""), Baud::B1M, || {
        asked += 1;
        true
    });
    assert!(next.is_ok() && asked > 10, "{asked}");
    assert!((4.9..6.0).contains(&(board.now() - began).as_secs_f64()), "{:?}", board.now() - began);
}

/// A board that was switched on long before: steps.csv has all steps. Its clock tells ticks apart within 2^31, and
/// accepts switches up to 2^30 ticks ahead, 8.6 s.
#[test]
fn all_steps_are_told_of_a_board_that_has_been_on_for_long() {
    struct Count(u32);
    impl Observer for Count {
        fn edge(&mut self, _: Edge) {}
        fn step(&mut self, _: ScheduledStep) {
            self.0 += 1;
        }
    }
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
    let prepared = load::load(file.as_ref(), Some("pico"), None).unwrap();
    for seconds in [0, 9, 20, 40] {
        let mut board = VirtualPico::on_usb();
        let until = Duration::from_secs(seconds);
        while board.now() < until {
            board.receive(until, &mut Vec::new()).unwrap();
        }
        let mut driven = Driven::at(&prepared, board, Baud::B1M).unwrap();
        let mut steps = Count(0);
        driven.run(&mut steps, |_| {}).unwrap();
        assert_eq!(steps.0, 8000, "on for {seconds} s");
    }
}

/// A run that is over frees its board: the next host need not wait until the silence is long enough.
#[test]
fn a_run_that_is_over_gives_its_board_away() {
    let board = Shared::new(VirtualPico::on_usb());
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
    let prepared = load::load(file.as_ref(), Some("pico"), None).unwrap();
    let mut driven = Driven::at(&prepared, board.clone(), Baud::B1M).unwrap();
    driven.run(&mut |_: Edge| {}, |_| {}).unwrap();
    driven.close();
    let asked = board.now();
    let next = Remote::open(board.clone(), 9).unwrap();
    assert!(board.now() - asked < Duration::from_millis(100), "{:?}", board.now() - asked);
    assert_eq!(next.info().last_stop, Cause::Finished);
}

const SINE: &str =
    "[[motion]]\nmotor = \"wheel\"\nlaw.sine = { amplitude = \"10 step\", period = \"1 s\", cycles = 1 }\n";

/// Motors on ULN2003 boards, each with four pins in a row; and more of the file.
fn on_coils(first: &[[u8; 4]], more: &str) -> String {
    let mut text = format!("board = \"pico\"\n{more}\n");
    for (number, pins) in first.iter().enumerate() {
        let sequence = ["microsteps = 2", "sequence = \"full\"", "sequence = \"wave\""][number % 3];
        text += &format!(
            "[motor.m{number}]\nsteps_per_rev = 32\n{sequence}\ndriver = \"ULN2003\"\npins = {{ in = {pins:?} }}\npull_in = \"300 \
             step/s\"\n[[motion]]\nmotor = \"m{number}\"\nlaw.sine = {{ amplitude = \"{} step\", period = \"0.5 s\" }}\n",
            10 + number
        );
    }
    text
}

const SIX: [[u8; 4]; 6] =
    [[2, 3, 4, 5], [6, 7, 8, 9], [10, 11, 12, 13], [14, 15, 16, 17], [18, 19, 20, 21], [22, 26, 27, 28]];

/// Six of them, in all three sequences, to the tick. If the file says so they are off at the end, on the Pico as on the
/// native board.
#[test]
fn six_motors_with_coils_hold_or_let_go() {
    let folder = Folder::new("pico-coils");
    for (idle, on) in [("", true), ("idle = \"hold\"", true), ("idle = \"100 ms\"", false)] {
        let file = folder.path("six.toml");
        std::fs::write(&file, on_coils(&SIX, idle)).unwrap();
        for board in ["pico", "native"] {
            let out = folder.path(board);
            let (exit, said) = pulsetrain(&["run", &file, "--board", board, "--out", &out]);
            assert_eq!(exit, Exit::Success, "{said}");
            let trace = format!("{out}/trace.vcd");
            let (exit, said) = pulsetrain(&["verify", &trace, &file, "--board", board, "--pins"]);
            assert_eq!(exit, Exit::Success, "{said}");
            // The levels at the end: `1` or `0`, and the line's letter.
            let vcd = std::fs::read_to_string(&trace).unwrap();
            let mut high = std::collections::BTreeSet::new();
            for change in vcd.lines().skip_while(|line| !line.contains("$enddefinitions")).filter(|line| line.len() > 1)
            {
                match change.split_at(1) {
                    ("1", line) => drop(high.insert(line.to_owned())),
                    ("0", line) => drop(high.remove(line)),
                    _ => {}
                }
            }
            assert_eq!(!high.is_empty(), on, "{idle} on {board}: {high:?}");
            if on {
                assert!(high.len() >= SIX.len(), "{idle} on {board}: {high:?}");
            }
        }
    }
}

/// State machines cannot drive these pins: refused before the planning, with advice.
#[test]
fn pins_that_do_not_fit_are_refused_with_what_would() {
    let folder = Folder::new("pico-pins");
    let drivers = |pins: &[&str]| {
        let mut text = "board = \"pico\"\n".to_owned();
        for (number, pins) in pins.iter().enumerate() {
            text += &format!(
                "[motor.m{number}]\nsteps_per_rev = 200\nmicrosteps = 16\ndriver = \"TMC2209\"\npins = {{ {pins} }}\nforward = \
                 \"high\"\n[[motion]]\nmotor = \"m{number}\"\nlaw.sine = {{ amplitude = \"1 deg\", period = \"1 s\" }}\n"
            );
        }
        text
    };
    let cases = [
        (
            drivers(&["step = 2, dir = 4"]),
            "DIR of `m0` (pin 4) is not next to its STEP (pin 2), but a Pico drives the two as neighbours",
            "wire DIR to pin 3",
        ),
        (
            drivers(&["step = 2, dir = 3", "step = 4, dir = 3"]),
            "motors `m0` and `m1` share DIR (pin 3), but a Pico needs one for each motor",
            "give each motor a DIR next to its STEP",
        ),
        (
            drivers(&["step = 2, dir = 3, enable = 6", "step = 4, dir = 5, enable = 7"]),
            "motors `m0` and `m1` have enable lines of their own",
            "wire the enable inputs to one pin",
        ),
        (
            on_coils(&[[2, 3, 4, 6]], ""),
            "the coils of `m0` are on pins 2, 3, 4 and 6, but a Pico drives four that stand one after the other",
            "wire IN1 to IN4 to 2, 3, 4 and 5, say",
        ),
        (on_coils(&[[5, 4, 3, 2]], ""), "the coils of `m0` are on pins 5, 4, 3 and 2", "to 2, 3, 4 and 5, say"),
        (on_coils(&[[21, 22, 26, 28]], ""), "are on pins 21, 22, 26 and 28", "to 21, 22, 26 and 27, say"),
        (on_coils(&[[26, 27, 28, 2]], ""), "are on pins 26, 27, 28 and 2", "to 22, 26, 27 and 28, say"),
    ];
    for (text, said, fits) in cases {
        let file = folder.path("pins.toml");
        std::fs::write(&file, &text).unwrap();
        let (exit, out) = pulsetrain(&["plan", &file]);
        let out = in_a_line(&out);
        assert_eq!(exit, Exit::Refused, "{out}");
        assert!(out.contains(said) && out.contains(fits), "{out}");
    }
    // Pins that do not exist are refused by the reader of the file.
    for (pins, why) in [
        ("step = 1, dir = 2", "serial line"),
        ("step = 24, dir = 25", "not on its header"),
        ("step = 29, dir = 28", "no pin 29"),
    ] {
        let file = folder.path("pins.toml");
        std::fs::write(&file, drivers(&[pins])).unwrap();
        let (exit, out) = pulsetrain(&["plan", &file]);
        assert_eq!(exit, Exit::Refused, "{out}");
        assert!(in_a_line(&out).contains(why), "{out}");
    }
}

#[test]
fn a_virtual_pico_tells_of_itself() {
    let (exit, said) = pulsetrain(&["info", "--board", "pico", "--json"]);
    assert_eq!(exit, Exit::Success, "{said}");
    let info: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!((&info["board"], &info["tick_hz"]), (&"Raspberry Pi Pico".into(), &125_000_000.into()));
    assert_eq!((&info["motors"], &info["fraction_bits"]), (&8.into(), &32.into()));
    assert_eq!(info["queue_bytes"], 32_768);
    let [ppm, doubt] = [0, 1].map(|index| info["clock_ppm"][index].as_f64().unwrap());
    assert!(ppm.abs() <= doubt, "{ppm} {doubt}");
    // It has no compares that could be missed.
    assert!(info["compares_missed"].is_null());
    let (_, said) = pulsetrain(&["info", "--board", "pico"]);
    assert!(said.contains("Raspberry Pi Pico") && said.contains("power came on"), "{said}");
    assert!(!said.contains("compares"), "{said}");
}

/// STEP on pin 2, 4, …, DIR on the next pin.
fn drivers(count: u8) -> Vec<MotorSetup> {
    let motor = |motor| MotorSetup {
        step_pin: 2 + 2 * motor,
        dir_pin: 3 + 2 * motor,
        forward_high: true,
        pull_in_ticks: 1_250_000,
        ..MotorSetup::default()
    };
    (0..count).map(motor).collect()
}

/// The table of boards agrees with the firmware: its queues, and how far ahead it commits itself.
#[test]
fn the_table_says_what_the_firmware_has() {
    let row = boards::find("pico").unwrap();
    for count in 1..=8 {
        let mut pico = Remote::open(VirtualPico::new(), 1).unwrap();
        pico.configure(&Setup { pulse_ticks: 13, motors: drivers(count), ..Setup::default() }).unwrap();
        for motor in 0..usize::from(count) {
            assert_eq!(pico.room(motor), row.queue_bytes[usize::from(count) - 1] as usize, "{count} motors");
        }
    }
    // Usual times, and the longest, with a reversal before each step.
    for (pulse_ticks, setup_ticks, most) in [(13, 20, 300_100), (62_500, 62_500, row.horizon_ticks)] {
        let mut pico = Remote::open(VirtualPico::new(), 1).unwrap();
        assert_eq!(pico.set_baud(Baud::B2M), Ok(Baud::B2M));
        pico.configure(&Setup { pulse_ticks, setup_ticks, hold_ticks: 5, motors: drivers(2), ..Setup::default() })
            .unwrap();
        let from = pico.now() + pico.round_trip() + 2_000_000;
        for motor in 0..2 {
            let mut items = vec![Item::Anchor { tick: Tick32::of(from) }];
            for turn in 0..300 {
                let segment =
                    Segment { count: 1, interval: (200_000 + 777 * i64::from(turn % 5)) << 32, add: 0, add2: 0 };
                let direction = if turn % 2 == 0 { Direction::Forward } else { Direction::Backward };
                items.push(Item::Run { segment, direction });
            }
            for item in items {
                pico.push(motor, Entry { epoch: Epoch(1), item }).unwrap();
            }
        }
        assert_eq!(pico.switch(Epoch(1), from, Lease::Last, &[]), Ok(()));
        let mut ahead = 0;
        while !pico.is_idle() {
            let until = pico.now() + 70_001;
            pico.advance(until, &mut |_: Edge| {});
            let status = pico.status().unwrap();
            ahead = ahead.max(status.head.horizon - status.head.tick);
        }
        assert!((250_000..=u64::from(most)).contains(&ahead), "{ahead} ticks ahead, {most} are stated");
    }
}
