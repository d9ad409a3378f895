//! Tables for boards without a host: their contents, and that no error grows as turns repeat.

use pulsetrain::load;
use std::path::Path;
use std::{fs, io};

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_bake::table::check_lines;
use pulsetrain_bake::table::{PERIOD_BITS, Turn};
use pulsetrain_bake::{BakeError, Image, PutOff, Room, Row, Sketch, Table, tables};
use pulsetrain_board::hex;
use pulsetrain_motion::file;
use pulsetrain_motion::program::Program;
use pulsetrain_plan::{Ensemble, Move};
use pulsetrain_testkit::folder::Folder;

const HZ: u64 = 16_000_000;

fn program(motion: &str) -> Program {
    wired("driver = \"A4988\"", "step = 8, dir = 9", motion)
}

fn wired(driver: &str, pins: &str, motion: &str) -> Program {
    read(&format!("board = \"uno\"\ntolerance = \"1 tick\"\n{}", motor("wheel", driver, pins, motion)))
}

fn motor(name: &str, driver: &str, pins: &str, motion: &str) -> String {
    format!(
        "[motor.{name:?}]\nsteps_per_rev = 200\n{driver}\npins = {{ {pins} }}\nforward = \"high\"\n[[motion]]\nmotor = {name:?}\n\
         {motion}\n"
    )
}

fn read(text: &str) -> Program {
    file::read(text, "wheel.toml", &|_| Err(io::ErrorKind::NotFound.into())).unwrap()
}

const SINE: &str = "law.sine = { amplitude = \"0.1 rev\", period = \"1 s\", cycles = \"forever\" }";

fn refused(program: &Program) -> BakeError {
    Sketch::new(program, "refused").map(|sketch| sketch.size).unwrap_err()
}

/// Steps of rows from a time on (ticks · 2^-16), as the sketch makes them: time and direction.
fn played(rows: &[Row], mut at: u128) -> Vec<(u128, bool)> {
    let mut steps = Vec::new();
    for row in rows {
        if row.count == 0 {
            at += u128::from(row.ticks) << 16;
        }
        let mut interval = i128::from(row.ticks) << 16 | i128::from(row.part);
        let mut add = i128::from(row.add);
        for _ in 0..row.count {
            at = at.checked_add_signed(interval).unwrap();
            steps.push((at, row.backward));
            interval += add;
            add += i128::from(row.add2);
        }
    }
    steps
}

/// Steps of the planner in the same form.
fn planned(program: &Program, most: usize) -> Vec<(u128, bool)> {
    let mut ensemble = Ensemble::new(program).unwrap();
    let (mut at, mut steps) = (0x8000i128, Vec::new());
    while let Some(next) = ensemble.next_move(0).unwrap() {
        match next {
            Move::Dwell { ticks } => at += i128::from(ticks) << 16,
            Move::Run { segment, direction } => {
                let backward = direction == pulsetrain_core::Direction::Backward;
                steps.extend((1..=segment.count).map(|k| ((at + segment.span(k)).cast_unsigned(), backward)));
                at += segment.span(segment.count);
            }
        }
        if steps.len() >= most {
            break;
        }
    }
    steps
}

fn table(program: &Program) -> Table {
    tables(program, Room::ANY).unwrap().remove(0)
}

#[test]
fn a_motion_that_ends_is_the_plan_bit_for_bit() {
    for motion in [
        "law.sine = { amplitude = \"2 rev\", period = \"1 s\", cycles = 2 }",
        "law.trapezoid = { distance = \"3 rev\", speed = \"2 rev/s\", acceleration = \"4 rev/s^2\" }",
        "start = \"40 s\"\nlaw.sine = { amplitude = \"0.01 rev\", period = \"90 s\", cycles = 1 }",
    ] {
        let program = program(motion);
        let table = table(&program);
        assert_eq!(table.turn, None);
        let steps = played(&table.rows, 0x8000);
        assert!(steps.len() > 3 && steps == planned(&program, usize::MAX), "{motion}");
        assert_eq!(table.steps, steps.len() as u64);
    }
}

#[test]
fn what_repeats_is_the_plan_and_a_turn_ends_where_the_next_begins() {
    for motion in [
        "law.sine = { amplitude = \"0.5 rev\", period = \"1 s\", cycles = \"forever\" }",
        "start = \"0.1 s\"\nlaw.sine = { amplitude = \"0.3 rev\", period = \"0.7300011 s\", cycles = \"forever\" }",
        "law.sweep = { frequency = \"4 Hz\", swing = \"25 step\", phase = \"0 ms\" }",
        "law.speed = { speed = \"-33.3 step/s\" }",
        "start = \"0.1 s\"\nbegin = \"jump\"\nlaw.speed = { speed = \"1234.567 step/s\" }",
        "repeat = \"forever\"\nlaw.then = [ { rest = \"0.5 s\" }, { trapezoid = { distance = \"1 rev\", speed = \"2 rev/s\", \
         acceleration = \"8 rev/s^2\" } } ]",
    ] {
        let program = program(motion);
        let table = table(&program);
        let Turn { from, base, period } = table.turn.expect("it repeats");
        let steps = played(&table.rows, 0x8000);
        let head = played(&table.rows[..from], 0x8000);
        let turn = played(&table.rows[from..], base.into());
        assert_eq!(head.last().map(|step| step.0), Some(base.into()), "{motion}: it begins with the step before");
        assert_eq!([head, turn.clone()].concat(), steps);
        let plan = planned(&program, steps.len() + turn.len());
        assert_eq!(steps, plan[..steps.len()], "{motion}");
        // The next turn has the planner's next steps, within both certificates and a tick.
        for (step, later) in turn.iter().zip(&plan[steps.len()..]) {
            let moved = step.0 + (period >> (PERIOD_BITS - 16));
            assert!(moved.abs_diff(later.0) <= 3 << 16 && step.1 == later.1, "{motion}: {moved} {later:?}");
        }
    }
}

/// Adds up a year of turns as the sketch does, and compares with the product.
#[test]
fn nothing_adds_up_in_a_year() {
    for seconds in ["0.73", "1", "0.3000000007", "2.71828182845"] {
        let program = program(&format!(
            "law.sine = {{ amplitude = \"0.2 rev\", period = \"{seconds} s\", cycles = \"forever\" }}"
        ));
        let Turn { base, period, .. } = table(&program).turn.expect("it repeats");
        // As the sketch does, but without the wrapping of ticks: 16 bits below the point, and 32 more for the rest.
        let (step, rest) = ((period >> 32) as u64, period as u32);
        let (mut at, mut carry) = (u128::from(base), 0u32);
        let turns = (365.25 * 86_400.0 / seconds.parse::<f64>().unwrap()) as u64;
        for _ in 0..turns {
            at += u128::from(step);
            let (sum, over) = carry.overflowing_add(rest);
            (carry, at) = (sum, at + u128::from(over));
        }
        // n · P is exact: P has units of 2^-64 s.
        let law = program.motors[0].law.cycle().unwrap().1.raw().cast_unsigned();
        let product = (law * u128::from(HZ) * u128::from(turns)) >> 48;
        let apart = (at - u128::from(base)).abs_diff(product);
        assert!(apart <= 2, "{seconds} s: {apart} / 65536 of a tick after {turns} turns");
    }
}

#[test]
fn what_cannot_be_baked_is_told() {
    let endless = program("law.formula = { theta = \"0.1*sin(t)\", unit = \"rev\" }");
    assert!(matches!(tables(&endless, Room::ANY), Err(BakeError::Endless { motor }) if motor == "wheel"));
    let waits = program("start = \"140 s\"\nlaw.sine = { amplitude = \"0.1 rev\", period = \"1 s\", cycles = 1 }");
    assert!(
        matches!(tables(&waits, Room::ANY), Err(BakeError::Wait { limit_s, .. }) if (134.0..135.0).contains(&limit_s))
    );
    // Each wait is short enough, but their sum is not.
    let waits = program(
        "law.then = [ { rest = \"100 s\" }, { rest = \"50 s\" }, { sine = { amplitude = \"0.1 rev\", period = \"1 s\", cycles = 1 } } ]",
    );
    assert!(
        matches!(tables(&waits, Room::ANY), Err(BakeError::Wait { wait_s, .. }) if (134.0..150.2).contains(&wait_s))
    );
    let fast = program("law.sine = { amplitude = \"20 rev\", period = \"1 s\" }");
    let error = Sketch::new(&fast, "fast").unwrap_err();
    assert!(matches!(error, BakeError::TooFast { rate_hz, .. } if rate_hz > 20_000.0), "{error}");
    // 4000 steps * 2 pi: 25 100 steps/s, where 14 000 fit.
    assert!(error.to_string().contains("the motion 1.8"), "{error}");
    let mut pico = program("law.sine = { amplitude = \"0.1 rev\", period = \"1 s\" }");
    pico.board.name = "pico".into();
    assert!(matches!(Sketch::new(&pico, "pico"), Err(BakeError::Board { .. })));
}

/// Where motors meet, some steps are late. They must still leave the next steps their time.
#[test]
fn a_motor_that_is_too_fast_beside_others_is_told() {
    let long = "pulse_high = \"30 us\"\ndir_setup = \"30 us\"";
    let fast = "law.sine = { amplitude = \"400 step\", period = \"1 s\", cycles = \"forever\" }";
    let slow: String = [("b", "2, dir = 3"), ("c", "4, dir = 5"), ("d", "6, dir = 7")]
        .map(|(name, pins)| motor(name, long, &format!("step = {pins}"), SINE))
        .concat();
    let all = format!("{}{slow}", motor("a", long, "step = 8, dir = 9", fast));
    let error = refused(&read(&format!("board = \"uno\"\ntolerance = \"1 us\"\n{all}")));
    assert!(
        matches!(&error, BakeError::TooClose { motor, rate_hz, limit_hz } if motor == "a" && rate_hz > limit_hz),
        "{error}"
    );
    assert!(Sketch::new(&wired(long, "step = 8, dir = 9", fast), "alone").is_ok(), "alone it is not");
}

/// No plan has opposite steps on one line that come too close. If a repeating table has them, they are found.
#[test]
fn opposite_steps_that_meet_on_a_line_are_found() {
    let line = ["8", "9"]
        .map(|step| motor(&format!("m{step}"), "pulse_high = \"10 us\"", &format!("step = {step}, dir = 10"), SINE));
    let program = read(&format!("board = \"uno\"\ntolerance = \"1 tick\"\n{}", line.concat()));
    let row = |backward, ticks| Row { count: 1, backward, ticks, part: 0, add: 0, add2: 0 };
    let table = |rows: Vec<Row>| {
        // The first row leads to the turn, whose period is 100 000 ticks.
        let turn = Turn { from: 1, base: u64::from(rows[0].ticks) << 16, period: 100_000 << PERIOD_BITS };
        Table { steps: rows.len() as u64, rows, turn: Some(turn), shortest: 1000, put_off: PutOff::default() }
    };
    let forward = || table(vec![row(false, 1000), row(false, 50_000), row(false, 50_000)]);
    let backward = |first| table(vec![row(true, first), row(true, 50_000), row(true, 50_000)]);
    // Pulse, hold and setup are 160 ticks each.
    for first in [20_000, 1480, 51_480] {
        assert!(check_lines(&program, &[forward(), backward(first)]).is_ok(), "{first}");
    }
    for first in [1000, 1100, 900, 1477, 51_050, 50_950, 51_477] {
        let met = check_lines(&program, &[forward(), backward(first)]);
        assert!(matches!(&met, Err(BakeError::Meet { motors, .. }) if motors == "m8, m9"), "{first}: {met:?}");
    }
}

/// A user's names cannot break the program's text.
#[test]
fn names_stay_in_their_comments() {
    let name = "a\\";
    let text = format!(
        "board = \"uno\"\ntolerance = \"1 tick\"\n{}",
        motor(name, "driver = \"A4988\"", "step = 8, dir = 9", SINE)
    );
    let sketch = Sketch::new(&read(&text), "title\\\nint x;").unwrap();
    assert!(!sketch.text.lines().any(|line| line.ends_with('\\')), "{}", &sketch.text[..400]);
    assert!(!sketch.text.lines().any(|line| line == "int x;") && sketch.text.contains("pinMode(9, OUTPUT);"));
}

const SWEEP: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/sweep.toml");

fn command(args: &[&str]) -> (Exit, String, String) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let exit = cli::run(["pulsetrain", "bake", SWEEP].iter().chain(args).copied(), &mut out, &mut err);
    (exit, String::from_utf8(out).unwrap(), String::from_utf8(err).unwrap())
}

#[test]
fn a_file_of_the_users_own_is_not_written_over() {
    let folder = Folder::new("bake-own");
    let (sketch, file) = (folder.path("wheel"), folder.path("wheel/wheel.ino"));
    for _ in 0..2 {
        assert_eq!(command(&["--sketch", &sketch]).0, Exit::Success, "its own is made anew");
    }
    let own = "void setup() {}\nvoid loop() {}\n// Made by pulsetrain bake: not this one\n";
    fs::write(&file, own).unwrap();
    let (exit, _, err) = command(&["--sketch", &sketch]);
    assert_eq!(exit, Exit::Refused);
    assert!(err.contains("wheel.ino") && err.contains("was not made by"), "{err}");
    assert_eq!(fs::read_to_string(&file).unwrap(), own);
}

/// Tests that run firmware on an emulated chip.
mod chips {
    use super::*;

    #[test]
    fn a_clock_that_is_off_is_baked_in_and_all_of_the_flash_is_told() {
        let folder = Folder::new("bake-clock");
        let file = folder.path("sweep.hex");
        let flash = |options: &[&str]| {
            let (exit, out, err) = command(&[&["--json", "--output", &file], options].concat());
            assert_eq!(exit, Exit::Success, "{err}");
            let flash = hex::parse(&fs::read_to_string(&file).unwrap(), 32 * 1024).unwrap();
            let json: serde_json::Value = serde_json::from_str(&out).unwrap();
            assert_eq!(json["flash_bytes"], flash.len());
            flash
        };
        // An equally fast plan, for a board whose clock is faster by this share.
        let mut fast = load::endless(Path::new(SWEEP), None).unwrap();
        assert_eq!(flash(&[]), Image::new(&fast.program).unwrap().flash);
        fast.calibrate(3000.0);
        let baked = flash(&["--clock-ppm=3000"]);
        assert_eq!(baked, Image::new(&fast.program).unwrap().flash);
        assert_eq!(fast.program.board.tick_hz, 16_048_000);
        let (_, out, _) = command(&["--output", &file]);
        assert!(out.contains("with the firmware, of 32 256"), "{out}");
    }

    /// The output may not be the motion file itself, and its name may not be that of another board's image.
    #[test]
    fn an_image_is_named_as_what_it_is() {
        let folder = Folder::new("bake-name");
        let tutorial = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
        for (name, board, wanted) in
            [("own.toml", "uno", "own.hex"), ("own.uf2", "uno", "own.hex"), ("own.hex", "pico", "own.uf2")]
        {
            let file = folder.path(name);
            fs::write(&file, "of the user's").unwrap();
            let (mut out, mut err) = (Vec::new(), Vec::new());
            let args = ["pulsetrain", "bake", tutorial, "--board", board, "--output", &file];
            assert_eq!(cli::run(args, &mut out, &mut err), Exit::Refused);
            let said = String::from_utf8(err).unwrap();
            assert!(said.contains("does not end in") && said.contains(wanted), "{said}");
            assert_eq!(fs::read_to_string(&file).unwrap(), "of the user's");
        }
        assert_eq!(command(&["--output", &folder.path("SWEEP.HEX")]).0, Exit::Success);
    }

    /// Two motors on one DIR line that move in opposite directions: an image, a sketch and `run` report the steps that
    /// the line delays.
    #[test]
    fn steps_that_wait_for_a_shared_dir_line_are_told() {
        let swing = |sign: &str| {
            format!("law.formula = {{ theta = \"{sign}20*(1-cos(4*pi*t))\", unit = \"deg\", duration = \"0.5 s\" }}")
        };
        let motors = [("a", 2, ""), ("b", 3, "-")].map(|(name, step, sign)| {
            motor(name, "microsteps = 8\ndriver = \"A4988\"", &format!("step = {step}, dir = 5"), &swing(sign))
        });
        let text = format!("board = \"uno\"\ntolerance = \"1 us\"\n{}", motors.concat());
        let folder = Folder::new("bake-shared");
        let (file, image, drawn) = (folder.path("two.toml"), folder.path("two.hex"), folder.path("two"));
        fs::write(&file, text).unwrap();
        let program = load::endless(Path::new(&file), None).unwrap().program;
        let mut ensemble = Ensemble::new(&program).unwrap();
        (0..2).for_each(|motor| while ensemble.next_move(motor).unwrap().is_some() {});
        let planned = [0, 1].map(|motor| ensemble.certificate(motor));
        let steps: u64 = planned.iter().map(|motor| motor.steps_put_off).sum();
        let longest = planned.iter().map(|motor| motor.longest_put_off_ticks).max().unwrap();
        assert!(steps > 20 && longest > 20, "{steps} steps by up to {longest}");
        let bake = |args: &[&str]| {
            let (mut out, mut err) = (Vec::new(), Vec::new());
            let exit = cli::run(["pulsetrain", "bake", &file].iter().chain(args).copied(), &mut out, &mut err);
            assert_eq!(exit, Exit::Success, "{}", String::from_utf8_lossy(&err));
            String::from_utf8(out).unwrap()
        };
        for to in [["--output", &image], ["--sketch", &drawn]] {
            let said = bake(&to);
            assert!(
                said.contains(&format!("put off (shared DIR): {steps} steps by up to {longest} ticks = ")),
                "{said}"
            );
            assert!(said.contains(" from where they are planned"), "{said}");
            let json: serde_json::Value = serde_json::from_str(&bake(&[to[0], to[1], "--json"])).unwrap();
            assert_eq!(
                (&json["steps_put_off"], &json["longest_put_off_ticks"]),
                (&steps.into(), &longest.into()),
                "{json}"
            );
            if to[0] == "--output" {
                // Steps whose delay is longer than the bound of other steps are reported by themselves.
                let seen = &json["rehearsed"];
                let (late, bound) =
                    (seen["longest_put_off_ticks"].as_f64().unwrap(), seen["bound_ticks"].as_f64().unwrap());
                let waited = seen["steps_put_off"].as_u64().unwrap();
                assert!(waited > 0 && waited <= steps && late > bound && late <= longest as f64 + bound, "{json}");
                assert!(seen["max_error_ticks"].as_f64().unwrap() <= bound, "{json}");
                let promised = seen["put_off_bound_ticks"].as_f64().unwrap();
                assert_eq!(promised, longest as f64 + bound, "{json}");
                let waits = format!(
                    "; {waited} steps waited for a shared DIR line and came up to {late:.1} ticks late, {promised:.1} are promised"
                );
                assert!(said.contains("all other edges within ") && said.contains(&waits), "{said}");
            }
        }
    }

    /// Of a repeating motion the steps of one turn are reported.
    #[test]
    fn steps_that_wait_in_each_turn_count_once() {
        let once = Image::new(&load::endless(Path::new(SWEEP), None).unwrap().program).unwrap().put_off;
        let cut = |seconds: f64| {
            let time = Some(pulsetrain_motion::Time::from_seconds(seconds));
            Image::new(&load::load(Path::new(SWEEP), None, time).unwrap().program).unwrap().put_off
        };
        // All four motors begin again every 2 s. A turn begins in the widest gap, so not at once.
        let [short, long] = [2.0, 3.5].map(|seconds| cut(seconds).steps);
        assert!(
            once.longest_ticks > 0 && short <= once.steps && once.steps <= long,
            "{once:?}: {short} in 2 s, {long} in 3.5 s"
        );
    }

    #[test]
    fn what_does_not_repeat_is_told() {
        // Each time half a step is left over.
        let drifts = program(
            "repeat = \"forever\"\nlaw.then = [ { rest = \"0.1 s\" }, { trapezoid = { distance = \"10.5 step\", speed = \"100 step/s\", \
             acceleration = \"8 rev/s^2\" } } ]",
        );
        let error = refused(&drifts);
        assert!(matches!(error, BakeError::NotPeriodic { step: 1.., .. }), "{error}");
        let still = program("law.sine = { amplitude = \"0.2 step\", period = \"1 s\", cycles = \"forever\" }");
        let error = refused(&still);
        assert!(matches!(error, BakeError::NoStep { period_s: 1.0, .. }), "{error}");
        assert!(error.advice().contains("half a step"), "{}", error.advice());
        let apart = |second: &str| {
            let other =
                format!("law.sine = {{ amplitude = \"0.1 rev\", period = \"{second} s\", cycles = \"forever\" }}");
            let [one, two] = [
                motor("one", "driver = \"A4988\"", "step = 8, dir = 10", SINE),
                motor("two", "driver = \"A4988\"", "step = 9, dir = 10", &other),
            ];
            read(&format!("board = \"uno\"\ntolerance = \"1 tick\"\n{one}{two}"))
        };
        assert!(matches!(refused(&apart("0.7300011")), BakeError::NoCommonPeriod { most: 64 }));
        assert!(Sketch::new(&apart("0.75"), "apart").is_ok() && Image::new(&apart("0.75")).is_ok(), "4 s and 3 s");
    }

    /// A motion that fits is baked. A motion of a day is refused as soon as its beginning does not fit, with advice.
    #[test]
    fn what_is_too_large_is_told_with_what_would_fit() {
        /// Whether it fits into the flash, or why not.
        type Way<'a> = &'a dyn Fn(&Program) -> Result<bool, BakeError>;
        let law =
            |cycles: u32| format!("law.sine = {{ amplitude = \"3 rev\", period = \"1.7 s\", cycles = {cycles} }}");
        let sketch = |program: &Program| Sketch::new(program, "large").map(|sketch| sketch.size.bytes <= 32_256);
        let image = |program: &Program| Image::new(program).map(|image| image.flash.len() <= 32_256);
        let ways: [Way<'_>; 2] = [&sketch, &image];
        for (way, limits) in ways.iter().zip([20_000..30_000, 6_500..10_000]) {
            let error = way(&program(&law(50_000))).unwrap_err();
            let BakeError::TooLarge { board: "an Uno", bytes, limit, fits_s } = error else { panic!("{error}") };
            assert!(bytes > limit && limits.contains(&limit), "{error}");
            let cycles = |seconds: f64| (seconds / 1.7) as u32;
            assert!(way(&program(&law(cycles(fits_s)))).is_ok_and(|fits| fits), "{fits_s} s");
            let more = way(&program(&law(cycles(fits_s + 3.4))));
            assert!(matches!(more, Err(BakeError::TooLarge { .. })), "{fits_s} s: {more:?}");
            // Each of two motors has half of the flash.
            let two = ["8, dir = 9", "10, dir = 11"].map(|pins| {
                let name = if pins.starts_with('8') { "one" } else { "two" };
                motor(name, "driver = \"A4988\"", &format!("step = {pins}"), &law(cycles(0.8 * fits_s)))
            });
            let error = way(&read(&format!("board = \"uno\"\ntolerance = \"1 tick\"\n{}", two.concat()))).unwrap_err();
            assert!(
                matches!(error, BakeError::TooLarge { fits_s: half, .. } if (0.4 * fits_s..0.6 * fits_s).contains(&half)),
                "{error} {fits_s}"
            );
        }
    }

    #[test]
    fn wirings_that_cannot_be_baked_are_told() {
        for (driver, pins, why) in [
            ("driver = \"A4988\"", "step = 13, dir = 9", "the bootloader flashes"),
            ("driver = \"A4988\"", "step = 14, dir = 9", "on pins 14 and 9"),
            (
                "pulse_high = \"2 us\"\ndir_setup = \"63 us\"",
                "step = 8, dir = 9",
                "dir_setup of 63 us is too long: 62.5 us",
            ),
            ("pulse_high = \"2 us\"\ndir_hold = \"5 ms\"", "step = 8, dir = 9", "dir_hold of 5000 us"),
            ("pulse_high = \"70 us\"", "step = 8, dir = 9", "pulse_high of 70 us"),
        ] {
            let error = refused(&wired(driver, pins, SINE));
            assert!(matches!(&error, BakeError::Wiring { motor, .. } if motor == "wheel"), "{error}");
            assert!(error.to_string().contains(why), "{error}");
        }
        // An image is refused with the firmware's reason for pins and times.
        for (driver, pins, why) in [
            ("driver = \"A4988\"", "step = 13, dir = 9", "the bootloader flashes"),
            ("driver = \"A4988\"", "step = 14, dir = 9", "14"),
            ("driver = \"A4988\"", "step = 2, dir = 9", "9"),
            ("pulse_high = \"2 us\"\ndir_hold = \"5 ms\"", "step = 8, dir = 9", "4096 ticks"),
        ] {
            let error = Image::new(&wired(driver, pins, SINE)).map(|image| image.items).unwrap_err();
            assert!(matches!(error, BakeError::Wiring { .. } | BakeError::Refused(_)), "{error:?}");
            assert!(error.to_string().contains(why), "{error}");
        }
        let coils = "board = \"uno\"\ntolerance = \"1 tick\"\n[motor.wheel]\nsteps_per_rev = 32\ndriver = \"ULN2003\"\npull_in = \"500 step/s\"\n\
                     pins = { in = [8, 9, 10, 11] }\n[[motion]]\nmotor = \"wheel\"\n";
        let coils = read(&format!("{coils}{SINE}\n"));
        for error in [refused(&coils), Image::new(&coils).map(|image| image.items).unwrap_err()] {
            assert!(error.to_string().contains("its coils cannot be baked"), "{error}");
        }
        // The longest times that the firmware accepts, and a use of the lamp's pin that does no harm.
        let long = wired("pulse_high = \"62.5 us\"\ndir_setup = \"62.5 us\"", "step = 8, dir = 13", SINE);
        assert!(Sketch::new(&long, "long").is_ok() && Image::new(&long).is_ok());
    }

    /// docs/first-motion.md shows what the command prints.
    #[test]
    fn the_guide_shows_what_bake_prints() {
        const PAGE: &str = include_str!("../../../../docs/first-motion.md");
        let folder = Folder::new("bake-guide");
        let (exit, said, err) = command(&["--output", &folder.path("sweep.hex")]);
        assert_eq!(exit, Exit::Success, "{err}");
        let shown: Vec<&str> =
            said.lines().filter(|line| line.starts_with("put off") || line.starts_with("rehearsed")).collect();
        assert_eq!(shown.len(), 2, "{said}");
        assert!(PAGE.contains(&shown.join("\n")), "{said}");
    }
}
