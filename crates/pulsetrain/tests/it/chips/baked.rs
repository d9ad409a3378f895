//! Uno images of `pulsetrain bake` on the virtual Uno: the firmware without a host, with a motion behind it. The pins
//! are judged.
//!
//! Each edge is within its certificate, a tick, and the firmware's known lateness (`BoardProfile::lateness_ticks`, 0 with
//! the compare hardware), as in any run on an Uno. Times count from the board's clock, on which the laws' zero is tick
//! [`ZERO`].

use pulsetrain::load;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_bake::rehearsal::{self, What, lamp, options};
use pulsetrain_bake::{BakeError, Image};
use pulsetrain_board::virtual_uno::{self, VirtualUno};
use pulsetrain_board::{Port, hex, stk500};
use pulsetrain_core::baked::avr::{HEAD_LEN, ZERO};
use pulsetrain_core::baked::crc32;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{boards, file};
use pulsetrain_plan::PlanError;
use pulsetrain_session::prepare::{Prepared, Refusal};
use pulsetrain_session::rehearsal::Length;
use pulsetrain_testkit::folder::Folder;
use pulsetrain_trace::Trace;
use pulsetrain_trace::verdict::{self, Report};

/// From the clock's tick 0 to the laws' time 0, s.
const LEAD_S: f64 = ZERO as f64 / 16e6;

fn example(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file)
}

fn read_example(file: &str) -> Program {
    load::endless(&example(file), None).unwrap().program
}

/// A program as `pulsetrain bake` reads it.
fn program(head: &str, motors: &str) -> Program {
    let text = format!("board = \"uno\"\n{head}\n{motors}");
    let mut program = file::read(&text, "m.toml", &|_| Err(std::io::ErrorKind::NotFound.into())).unwrap();
    let row = boards::find("uno").unwrap();
    program.board.min_interval_ticks = row.shortest_intervals(&program.motors);
    program.board.turn_ticks = row.turn_ticks(&program.motors);
    program
}

/// A motor with its pins, the lines of its driver, and its motion's.
fn motor((step, dir): (u8, u8), driver: &str, motion: &str) -> String {
    format!(
        "[motor.m{step}]\nsteps_per_rev = 200\n{driver}\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n[[motion]]\n\
         motor = \"m{step}\"\n{motion}\n"
    )
}

/// STEP and DIR of up to four motors: all on port D, and on ports D and B as on a shield.
const PINS: [(u8, u8); 4] = [(2, 5), (3, 6), (4, 7), (12, 13)];
const A4988: &str = "driver = \"A4988\"";
const SINE: &str = "law.sine = { amplitude = \"0.1 rev\", period = \"1 s\", cycles = \"forever\" }";

fn baked(program: &Program) -> VirtualUno {
    VirtualUno::with_image(&Image::new(program).unwrap().flash).unwrap()
}

fn watched(uno: &mut VirtualUno, until_s: f64) -> Trace {
    let mut edges = Vec::new();
    assert!(rehearsal::play(uno, until_s, &mut |edge| edges.push(edge)), "the clock does not run");
    Trace { tick_hz: 16_000_000, lines: rehearsal::lines(), edges }
}

/// Checks that an image plays its motion for a time: each step comes where it should, with its driver's times.
fn keeps(what: &str, program: &Program, seconds: f64) -> Report {
    let mut uno = baked(program);
    let length = Length::exactly(program, seconds);
    let done =
        rehearsal::rehearse(&mut uno, program, length, |_| {}).unwrap_or_else(|failed| panic!("{what}: {failed}"));
    let stack = stack_left(&mut uno);
    assert!(stack > 60, "{what}: {stack} bytes of the stack are left");
    let (errors, bound) = (done.max_error_ticks(), done.bound_ticks);
    println!("{what}: at most {errors:.1} ticks off, {bound:.1} allowed; {stack} bytes of the stack are left");
    let report = done.report;
    assert!(report.motors.iter().all(|motor| motor.steps_got > 0), "{what}: {:?}", report.motors);
    report
}

/// Bytes of the stack that were never used: the longest stretch of RAM that still has its painted value.
fn stack_left(uno: &mut VirtualUno) -> usize {
    let ram = (0x400..0x900).map(|at| uno.chip_mut().read_data(at, &mut ())).collect::<Vec<_>>();
    ram.chunk_by(|a, b| a == b).filter(|bytes| bytes[0] == 0xc5).map(<[u8]>::len).max().unwrap_or(0)
}

#[test]
fn examples_keep_to_the_law() {
    let tutorial = keeps("tutorial", &read_example("tutorial.toml"), 1.5);
    assert_eq!(tutorial.motors[0].steps_got, 8000);
    keeps("sweep", &read_example("sweep.toml"), 10.0);
    keeps("max-speed", &read_example("max-speed.toml"), 8.0);
    // The maximum-speed article's own ramp, whose speed jumps from step to step.
    let ramp = |turns: i32| {
        format!(
            "{{ ramp = {{ distance = \"{turns} rev\", tick = \"8 us\", slowest = 255, fastest = 18, during = 10 }} }}"
        )
    };
    let stepper = format!(
        "[motor.stepper]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"A3967\"\npins = {{ step = 6, dir = 7 }}\nforward = \"high\"\n\
         pull_in = \"0.5 rev/s\"\n[[motion]]\nmotor = \"stepper\"\nrepeat = \"forever\"\n\
         law.then = [{{ rest = \"1 s\" }}, {}, {{ rest = \"1 s\" }}, {}]\n",
        ramp(1),
        ramp(-1)
    );
    keeps("ramp", &program("grid = \"reach\"\ntolerance = \"1 us\"", &stepper), 8.0);
}

/// Drivers with short and with long times.
const DRIVERS: [&str; 4] = [
    A4988,
    "driver = \"DQ542MA\"\nmicrosteps = 2",
    "pulse_high = \"2 us\"\ndir_setup = \"5 us\"\ndir_hold = \"5 us\"",
    "pulse_high = \"10 us\"",
];

/// Two to four motors that reverse at once, or within microseconds: none waits for another.
#[test]
fn motors_that_turn_together_keep_to_the_law() {
    for driver in DRIVERS {
        for apart_us in [0.0, 0.625, 20.0] {
            for count in 2..=4 {
                let all = PINS.iter().take(count).enumerate().map(|(place, pins)| {
                    let start = 1000.0 + apart_us * place as f64;
                    let sine = "law.sine = { amplitude = \"5.3 step\", period = \"20 ms\", cycles = \"forever\" }";
                    motor(*pins, driver, &format!("start = \"{start} us\"\n{sine}"))
                });
                let program = program("tolerance = \"1 us\"", &all.collect::<String>());
                keeps(&format!("{count} motors, {driver}, {apart_us} us"), &program, 0.3);
            }
        }
    }
}

/// All ways to make edges: the compare hardware, software on one port, two rings, and shared DIR lines.
#[test]
fn all_kinds_of_pins_keep_to_the_law() {
    for (pins, more) in [
        (&[(9, 8), (10, 11)][..], "start = \"3 ms\""),
        (&[(2, 3)], ""),
        (&[(2, 3), (4, 5)], ""),
        (&[(8, 9), (10, 11)], ""),
        (&[(8, 11), (9, 11), (10, 11)], ""),
    ] {
        let all = pins.iter().enumerate().map(|(place, pins)| {
            let period = 0.5 + 0.25 * place as f64;
            let sine = format!(
                "{more}\nlaw.sine = {{ amplitude = \"31.4 step\", period = \"{period} s\", cycles = \"forever\" }}"
            );
            motor(*pins, A4988, &sine)
        });
        keeps(&format!("{pins:?}"), &program("tolerance = \"1 us\"", &all.collect::<String>()), 4.0);
    }
}

/// Motors that change their speed all the time, near the rate that the planner allows: the reader of the flash keeps
/// up.
#[test]
fn the_greatest_rate_can_be_kept() {
    let sine = |hz: f64, period: f64| {
        let amplitude = hz * period / std::f64::consts::TAU;
        format!("law.sine = {{ amplitude = \"{amplitude} step\", period = \"{period} s\", cycles = \"forever\" }}")
    };
    let plateau = |hz: f64, period: f64| {
        let (distance, acceleration) = (hz * (0.7 + period), 10.0 * hz);
        format!(
            "law.trapezoid = {{ distance = \"{distance} step\", speed = \"{hz} step/s\", acceleration = \"{acceleration} step/s^2\" }}"
        )
    };
    let at_rate = |count: usize, hz: f64, law: &dyn Fn(f64, f64) -> String| {
        let all = PINS
            .iter()
            .take(count)
            .enumerate()
            .map(|(place, pins)| motor(*pins, "pulse_high = \"1 us\"", &law(hz, 0.2 + 0.013 * place as f64)));
        program("tolerance = \"1 us\"", &all.collect::<String>())
    };
    // The planner's limit for these pins.
    let at = |count: usize, share: f64, law: &dyn Fn(f64, f64) -> String| {
        let shortest = at_rate(count, 1000.0, law).board.min_interval_ticks[count - 1];
        let of_four = boards::find("uno").unwrap().shortest_of_four_baked().filter(|_| count == 4);
        let shortest = of_four.map_or(shortest, |ticks| ticks.max(shortest));
        at_rate(count, 16e6 / f64::from(shortest) * share, law)
    };
    for count in 1..=4 {
        keeps(&format!("{count} motors up to their greatest rate"), &at(count, 0.98, &sine), 1.0);
        keeps(&format!("{count} motors at their greatest rate"), &at(count, 0.98, &plateau), 1.2);
        let refused = Image::new(&at(count, 1.2, &sine)).map(|image| image.items).unwrap_err();
        assert!(
            matches!(&refused, BakeError::Plan(why) if matches!(why.error, PlanError::TooFastForBoard { .. })),
            "{refused}"
        );
    }
}

/// Two motors with a ring each, in step with one another, keep on where a ramp ends. There the firmware planned each of
/// the last steps by itself, and at the second and the fourth of these rates both rings ran empty.
#[test]
fn two_rings_keep_on_where_a_ramp_ends() {
    for share in [0.5, 0.635, 0.7, 0.71, 0.95] {
        let hz = 16e6 / 215.0 * share;
        let all = PINS.iter().take(2).zip([0.9, 0.913]).map(|(pins, seconds)| {
            let (distance, acceleration) = (hz * seconds, hz * 10.0);
            let law = format!(
                "law.trapezoid = {{ distance = \"{distance} step\", speed = \"{hz} step/s\", acceleration = \"{acceleration} step/s^2\" }}"
            );
            motor(*pins, "pulse_high = \"1 us\"", &law)
        });
        keeps(&format!("{hz:.0} steps/s"), &program("tolerance = \"1 us\"", &all.collect::<String>()), 1.2);
    }
}

/// How much a rehearsal plays: of motions that end, of motors that repeat together, and of motors whose phases never
/// repeat.
#[test]
fn as_much_is_rehearsed_as_there_is_to_see() {
    let once = "law.sine = { amplitude = \"0.1 rev\", period = \"0.5 s\", cycles = 150 }";
    let of = |laws: &[&str]| {
        let all = laws.iter().zip(PINS).map(|(law, pins)| motor(pins, A4988, law)).collect::<String>();
        Length::of(&program("", &all))
    };
    let every = |seconds: &str, start: &str| {
        format!(
            "start = \"{start} s\"\nlaw.sine = {{ amplitude = \"0.1 rev\", period = \"{seconds} s\", cycles = \"forever\" }}"
        )
    };
    let ends = of(&[once]);
    assert_eq!((ends.seconds, ends.all_s, ends.is_all()), (60.0, Some(75.0), false));
    // One second until both repeat, three until they meet again, and two turns of the slower motor.
    let together = of(&[&every("1.5", "0"), &every("1", "1")]);
    assert_eq!((together.seconds, together.all_s, together.is_all()), (7.0, Some(7.0), true));
    let apart = of(&[&every("0.7300011", "0"), &every("1", "0")]);
    assert_eq!((apart.seconds, apart.all_s, apart.is_all()), (60.0, None, false));
    assert!(together.endless && apart.endless && !ends.endless);
}

/// Motors that turn for ever after a ramp, fast and slow, in both directions.
#[test]
fn a_speed_goes_on_for_ever() {
    let all = [("2 rev/s", "ramp"), ("-3333.3 step/s", "ramp"), ("0.7 step/s", "jump"), ("100.001 step/s", "jump")];
    let all = all.into_iter().zip(PINS).map(|((speed, begin), pins)| {
        let limits = "max_speed = \"40 rev/s\"\nmax_acceleration = \"40 rev/s^2\"";
        let motion = format!("begin = \"{begin}\"\nlaw.speed = {{ speed = \"{speed}\" }}");
        motor(pins, &format!("{A4988}\n{limits}"), &motion)
    });
    let program = program("tolerance = \"1 us\"", &all.collect::<String>());
    let report = keeps("for ever", &program, 30.0);
    assert!(report.motors.iter().all(|motor| motor.drift_ppm.abs() < 0.05), "{report:?}");
}

/// The sweep article's motion, for a minute; with PULSETRAIN_ROUNDS=60 an hour.
#[test]
fn the_sweep_keeps_its_phase() {
    let report = keeps("sweep", &read_example("sweep.toml"), 60.0 * pulsetrain_testkit::seed::rounds() as f64);
    for motor in &report.motors {
        println!("{}: {} steps, drift {} ppm", motor.motor, motor.steps_got, motor.drift_ppm);
        assert!(motor.drift_ppm.abs() < 1e-3, "{motor:?}");
    }
}

const ONCE: &str = "law.sine = { amplitude = \"1 rev\", period = \"0.5 s\", cycles = 1 }";

/// A motion that ends stays over, and its drivers are released when they have rested for the time `idle`.
#[test]
fn a_motion_that_ends_runs_once_and_idle_is_looked_at() {
    let wired = motor((8, 9), A4988, ONCE).replace("dir = 9", "dir = 9, enable = 10");
    for (idle, released) in [("idle = \"0.2 s\"", true), ("idle = \"hold\"", false)] {
        let program = program(idle, &wired);
        let trace = watched(&mut baked(&program), LEAD_S + 1.0);
        let report = verdict::judge(&trace, &program, &options(&program, None)).unwrap();
        assert!(report.ok && report.motors[0].steps_got == 800, "{report:?}");
        let enable: Vec<_> = trace.edges.iter().filter(|edge| edge.line == 10).collect();
        // The first edge, before the motion, switches the drivers on: active low.
        let off = enable.last().filter(|edge| edge.level);
        assert_eq!(off.is_some(), released, "{enable:?}");
        if let Some(off) = off {
            let after_s = off.tick as f64 / 16e6 - LEAD_S - 0.5;
            assert!((0.19..0.23).contains(&after_s), "{after_s} s after the end");
        }
    }
}

/// A block with any wrong bit is ignored, as if the image had none: no pin is touched.
#[test]
fn what_is_damaged_does_not_move() {
    let program = program("", &motor((8, 9), A4988, SINE));
    let image = Image::new(&program).unwrap();
    let committed = virtual_uno::baked_image();
    assert_eq!(image.flash[..committed.len()], committed);
    let begin = image.flash.len() - image.block_bytes;
    let damaged = [begin, begin + 4, begin + 7, begin + 10, begin + 20, image.flash.len() - 1].map(|at| {
        let mut flash = image.flash.clone();
        flash[at] ^= 4;
        flash
    });
    for flash in damaged.iter().chain([&committed]) {
        let mut uno = VirtualUno::with_image(flash).unwrap();
        uno.receive(Duration::from_millis(600), &mut Vec::new()).unwrap();
        // DDRB, PORTB, DDRC, PORTC, DDRD, PORTD.
        for register in [0x24, 0x25, 0x27, 0x28, 0x2a, 0x2b] {
            assert_eq!(uno.chip_mut().read_data(register, &mut ()), 0, "{register:#x}");
        }
        let failed = rehearsal::rehearse(&mut uno, &program, Length::of(&program), |_| {}).unwrap_err();
        assert!(matches!(failed.what, What::NoStart) && failed.rates.is_empty(), "{failed}");
        assert!(failed.advice().contains("tell the project"), "{}", failed.advice());
    }
}

/// If a record cannot be obeyed, though the checksum is right, all motors stop and the lamp is on.
#[test]
fn what_goes_wrong_stops_all_motors() {
    let program = program("", &(motor((8, 9), A4988, SINE) + &motor((10, 11), A4988, SINE)));
    let image = Image::new(&program).unwrap();
    let (begin, mut flash) = (image.flash.len() - image.block_bytes, image.flash.clone());
    // The second motor's gaps end the block. Its first gap becomes an unknown record.
    let body = begin + usize::from(HEAD_LEN);
    let motors = body + 2 + usize::from(flash[body + 1]);
    let of_second = |field: usize| {
        let at = motors + 12 + 2 * field;
        usize::from(u16::from_le_bytes([flash[at], flash[at + 1]]))
    };
    let gap = flash.len() - of_second(2) - of_second(3);
    for at in [gap, gap + of_second(2)] {
        flash[at + 1] = 7 | 6 << 3;
        flash[at + 2] = 0;
    }
    let sum = crc32(&flash[body..]).to_le_bytes();
    flash[begin + 6..begin + 10].copy_from_slice(&sum);
    let mut uno = VirtualUno::with_image(&flash).unwrap();
    let trace = watched(&mut uno, LEAD_S + 3.0);
    assert!(lamp(&mut uno));
    let stopped = trace.edges.last().unwrap();
    // The lamp's edge comes some ms after the fault, which is behind the first turn. Nothing moves after it.
    assert!(stopped.line == 13 && stopped.level, "{stopped:?}");
    let stopped_s = stopped.tick as f64 / 16e6 - LEAD_S;
    assert!((0.9..2.0).contains(&stopped_s), "{stopped:?}");
    // The rehearsal names the motor whose step is missing first, and plays no further.
    let mut uno = VirtualUno::with_image(&flash).unwrap();
    let (length, mut heard) = (Length::exactly(&program, 30.0), 0.0);
    let failed = rehearsal::rehearse(&mut uno, &program, length, |seconds| heard = seconds).unwrap_err();
    let What::Stopped { motor, step, at_s, dry: false } = &failed.what else { panic!("{failed}") };
    // m10's next steps come after m8's next steps.
    assert!(motor == "m8" && *step > 80 && (stopped_s..stopped_s + 0.02).contains(at_s), "{failed}");
    assert!((stopped_s..stopped_s + 0.2).contains(&heard), "{heard} s of {stopped_s}");
    let [(motor, rate), _] = &failed.rates[..] else { panic!("{:?}", failed.rates) };
    assert!(motor == "m8" && (10.0..126.0).contains(rate), "{:?}", failed.rates);
    assert!(failed.advice().contains("pins 9 and 10"), "{}", failed.advice());
}

/// A rehearsal ends at the first fault, and reports it with its time.
#[test]
fn a_rehearsal_says_what_is_wrong() {
    let motion = |driver: &str, amplitude: &str| {
        let sine = SINE.replace("0.1 rev", amplitude);
        program("", &(motor((8, 9), driver, &sine) + &motor((10, 11), A4988, SINE)))
    };
    let program = motion(A4988, "0.1 rev");
    let flash = Image::new(&program).unwrap().flash;
    let rehearsed = |flash: &[u8], program: &Program| {
        let (mut uno, mut heard) = (VirtualUno::with_image(flash).unwrap(), 0.0);
        let done = rehearsal::rehearse(&mut uno, program, Length::exactly(program, 5.0), |seconds| heard = seconds);
        (done.map(|_| ()), heard)
    };
    assert!(rehearsed(&flash, &program).0.is_ok());
    // A driver for which the pulses are too short here, and a motor that should go further.
    for (other, why) in [
        (motion("pulse_high = \"10 us\"", "0.1 rev"), "motor m8: STEP HIGH for"),
        (motion(A4988, "0.2 rev"), "motor m8: step 1 (forward) missing"),
    ] {
        let (done, heard) = rehearsed(&flash, &other);
        let failed = done.unwrap_err();
        assert!(matches!(failed.what, What::Edge { stopped: false, .. }) && heard < 1.0, "{failed} {heard}");
        assert!(failed.to_string().starts_with(&format!("rehearsed on the virtual Uno, {why}")), "{failed}");
    }
    // The interrupt that fills the rings, Timer0's overflow (vector 16), hangs: cli, rjmp .-2. Or it enables interrupts
    // first, and then the watchdog resets the board.
    let mut hangs = flash;
    hangs[4 * 16..4 * 17].copy_from_slice(&[0xf8, 0x94, 0xff, 0xcf]);
    let failed = rehearsed(&hangs, &program).0.unwrap_err();
    assert!(matches!(failed.what, What::Stopped { step: 1, dry: false, .. }), "{failed}");
    assert!(failed.to_string().contains("all motors stand from t = 0.0"), "{failed}");
    hangs[4 * 16] = 0x78;
    let (done, heard) = rehearsed(&hangs, &program);
    let failed = done.unwrap_err();
    assert!(matches!(failed.what, What::Reset { .. } if heard < 2.0), "{failed} {heard}");
}

/// After a watchdog reset the positions are unknown: the motors stay there until somebody resets the board.
#[test]
fn after_the_watchdog_nothing_moves() {
    let program = program("", &motor((8, 9), A4988, SINE));
    let mut uno = baked(&program);
    let moved = watched(&mut uno, LEAD_S + 0.5).edges.len();
    assert!(moved > 20 && !lamp(&mut uno));
    // The vector of the watchdog's interrupt, as a word address.
    uno.chip_mut().set_pc(2 * 6);
    uno.receive(uno.now() + Duration::from_millis(100), &mut Vec::new()).unwrap();
    let step = |uno: &mut VirtualUno| uno.chip_mut().read_data(0x25, &mut ()) & 3;
    let before = step(&mut uno);
    for _ in 0..10 {
        uno.receive(uno.now() + Duration::from_millis(50), &mut Vec::new()).unwrap();
        assert_eq!(step(&mut uno), before);
    }
    assert!(lamp(&mut uno) && uno.zero().is_none());
    assert!(!rehearsal::play(&mut uno, LEAD_S, &mut |edge| panic!("{edge:?}")), "its clock runs");
    uno.reset();
    assert_eq!(watched(&mut uno, LEAD_S + 0.5).edges.len(), moved);
}

/// A new Uno: its bootloader accepts the image, and starts it at each power-up.
#[test]
#[cfg(target_os = "linux")]
fn a_bootloader_takes_an_image_and_starts_it() {
    let optiboot =
        std::env::var("PULSETRAIN_OPTIBOOT").expect("run `cargo xtask test`: it builds Optiboot, and says where");
    let optiboot = hex::parse(&fs::read_to_string(optiboot).unwrap(), stk500::FLASH_BYTES).unwrap();
    let uno = VirtualUno::with_bootloader(&[], &optiboot).unwrap();
    let program = read_example("tutorial.toml");
    let image = Image::new(&program).unwrap();
    let mut uno = stk500::Bootloader::find(uno, stk500::RATES[0]).unwrap().program(&image.flash, |_| {}).unwrap();
    for _ in 0..2 {
        let trace = watched(&mut uno, LEAD_S + 1.5);
        let report = verdict::judge(&trace, &program, &options(&program, None)).unwrap();
        assert!(report.ok && report.motors[0].steps_got == 8000, "{report:?}");
        uno.reset();
    }
}

/// A motion that is too fast for the board is refused as for a run, with advice.
#[test]
fn what_is_too_fast_is_refused_as_in_a_run() {
    let law = "law.sine = { amplitude = \"300 rev\", period = \"1 s\", cycles = \"forever\" }";
    let program = program("", &motor((8, 9), A4988, law));
    let Err(BakeError::Plan(refused)) = Image::new(&program) else { panic!("it is taken") };
    let prepared = Prepared {
        file: "fast".to_owned(),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    };
    match prepared.refuse(refused) {
        Refusal::Plan { error: PlanError::TooFastForBoard { .. }, advice, .. } => assert!(!advice.is_empty()),
        other => panic!("{other:?}"),
    }
}

/// The command writes the image, and prints its size.
#[test]
fn the_command_says_what_it_takes() {
    let folder = Folder::new("baked-command");
    let image = folder.path("sweep.hex");
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let sweep = example("sweep.toml");
    let args = ["pulsetrain", "bake", sweep.to_str().unwrap(), "--output", &image];
    assert_eq!(cli::run(args, &mut out, &mut err), Exit::Success, "{}", String::from_utf8_lossy(&err));
    let said = String::from_utf8(out).unwrap();
    assert!(said.contains("of 32 256; it repeats for ever") && said.contains("pulsetrain flash uno --port"), "{said}");
    assert!(
        said.contains("rehearsed on the virtual Uno: 6.1 s, each phase of what repeats: all other edges within"),
        "{said}"
    );
    // Its four motors share a DIR line.
    assert!(
        said.contains("\nput off (shared DIR): ") && said.contains(" steps waited for a shared DIR line"),
        "{said}"
    );
    let written = hex::parse(&fs::read_to_string(&image).unwrap(), stk500::FLASH_BYTES).unwrap();
    assert_eq!(written, Image::new(&read_example("sweep.toml")).unwrap().flash);
}

/// Five minutes of the board's time.
mod long {
    use super::*;

    /// An Uno's clock tells times apart within 134 s, and its 32-bit ticks wrap after 268 s. One motor rests for 140 s
    /// at a time. The others move on past the wrap, and none of them drifts.
    #[test]
    fn phases_are_kept_past_the_wraps() {
        let rests = "repeat = \"forever\"\nlaw.then = [ { sine = { amplitude = \"5 step\", period = \"0.3 s\", cycles = 1 } }, \
                     { rest = \"140.1 s\" } ]";
        let short = "repeat = \"forever\"\nlaw.then = [ { sine = { amplitude = \"5 step\", period = \"0.3 s\", cycles = 1 } }, \
                     { rest = \"7.3 s\" } ]";
        let late = format!("start = \"150 s\"\n{SINE}");
        let turns = "law.sine = { amplitude = \"1.2 step\", period = \"29.9999983 ms\", cycles = \"forever\" }";
        let all = [rests, turns, &late, short].into_iter().zip(PINS).map(|(law, pins)| motor(pins, A4988, law));
        let program = program("tolerance = \"1 us\"", &all.collect::<String>());
        let report = keeps("past the wraps", &program, 285.0);
        assert_eq!(report.motors[0].steps_got, 60, "{report:?}");
        assert!(report.motors.iter().all(|motor| motor.drift_ppm.abs() < 1e-3), "{report:?}");
    }
}
