//! Sketches of `pulsetrain bake --sketch`, compiled with Debian's Arduino core, on the virtual Uno. The pins are
//! judged. `cargo xtask test` installs what they need.
#![cfg(target_os = "linux")]

use pulsetrain::load;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

use pulsetrain_bake::{BakeError, Sketch};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Port, hex, stk500};
use pulsetrain_core::Segment;
use pulsetrain_motion::file;
use pulsetrain_motion::program::{Motor, Program, Wiring};
use pulsetrain_plan::{Ensemble, Move};
use pulsetrain_testkit::folder::Folder;
use pulsetrain_trace::verdict::{EdgeJudge, Options, Report};
use pulsetrain_trace::{Edge, Line, Trace};

const CORE: &str = "/usr/share/arduino/hardware/arduino/avr";

fn example(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file)
}

/// The flash of an Uno with the sketch of a motion. The sketch is compiled much as the Arduino IDE does it, with the
/// same language and optimisation of the whole program; but with Debian's compiler, and without the declarations that
/// the IDE adds.
fn compiled(program: &Program) -> Vec<u8> {
    // Tests of a process run at once, so each has a folder of its own.
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let folder = Folder::new(&format!("sketch-{}", NUMBER.fetch_add(1, Ordering::Relaxed)));
    let [sketch, elf, image] = ["motion.ino", "motion.elf", "motion.hex"].map(|file| folder.0.join(file));
    fs::write(&sketch, Sketch::new(program, "motion").unwrap().text).unwrap();
    let mut compiler = Command::new("avr-g++");
    compiler
        .args("-mmcu=atmega328p -DF_CPU=16000000L -DARDUINO=10819 -DARDUINO_AVR_UNO -DARDUINO_ARCH_AVR -Os".split(' '));
    compiler.args("-std=gnu++11 -flto -Wall -Wextra -Werror=narrowing".split(' '));
    compiler.args("-ffunction-sections -fdata-sections -fno-exceptions -Wl,--gc-sections".split(' '));
    compiler.args([format!("-I{CORE}/cores/arduino"), format!("-I{CORE}/variants/standard")]);
    compiler.args(["-x", "c++"]).arg(sketch);
    compiler.arg(format!("{CORE}/cores/arduino/main.cpp")).args(["-x", "c"]);
    compiler.args(["hooks.c", "wiring.c", "wiring_digital.c"].map(|file| format!("{CORE}/cores/arduino/{file}")));
    run(compiler.arg("-o").arg(&elf));
    run(Command::new("avr-objcopy").args(["-O", "ihex", "-j", ".text", "-j", ".data"]).arg(&elf).arg(&image));
    hex::parse(&fs::read_to_string(image).unwrap(), stk500::FLASH_BYTES).unwrap()
}

fn run(command: &mut Command) {
    let output = command.output().expect("Debian's gcc-avr is installed");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Every edge of the pins within a time.
fn trace(image: &[u8], seconds: f64) -> Trace {
    let mut uno = VirtualUno::with_image(image).unwrap();
    let end = uno.now() + Duration::from_secs_f64(seconds);
    let (mut edges, mut all) = (Vec::new(), Vec::new());
    while uno.now() < end {
        let until = end.min(uno.now() + Duration::from_millis(50));
        uno.receive(until, &mut Vec::new()).unwrap();
        uno.edges(&mut edges);
        all.extend(edges.drain(..).map(|edge| Edge { tick: edge.tick, line: edge.line, level: edge.level }));
    }
    let lines = (0..20).map(|pin| Line::named(format!("pin{pin}"))).collect();
    Trace { tick_hz: 16_000_000, lines, edges: all }
}

/// A motion on the board, compared edge by edge with the law.
struct Laid {
    report: Report,
    /// The least and the greatest delay of a step after the law's crossing, ticks.
    late: (f64, f64),
}

/// From the start of the counter to a motion's zero on port B: the player's LEAD, and the time of its interrupt.
const ZERO: u64 = 16_000 + 91;

/// `late_ticks`: how much later than scheduled a step may be; one that is put off for a shared DIR line is a matter of the plan.
fn laid(program: &Program, image: &[u8], seconds: f64, late_ticks: f64) -> Laid {
    let trace = trace(image, seconds);
    if program.motors.iter().all(|motor| motor.law.end().is_some()) {
        never_early(program, &trace, late_ticks as u64);
    }
    let (tick, pin) = first_step(program);
    let is_first = |edge: &&Edge| usize::from(edge.line) == usize::from(pin) && edge.level;
    let zero = trace.edges.iter().find(is_first).expect("it moves").tick - tick;
    let endless = program.motors.iter().any(|motor| motor.law.end().is_none());
    let options = Options {
        bound_ticks: Some(program.tolerance.ticks(program.board.tick_hz) + late_ticks),
        constant_ticks: ZERO as i64,
        until_s: endless.then_some(seconds - 0.1),
        ..Options::default()
    };
    let mut judge = EdgeJudge::new(trace.tick_hz, &trace.lines, program, &options).unwrap().keeping_errors();
    for edge in &trace.edges {
        judge.push(*edge).unwrap();
    }
    let mut late = (f64::INFINITY, f64::NEG_INFINITY);
    let report = judge.finish_with(&mut |_, _, ticks| late = (late.0.min(ticks), late.1.max(ticks))).unwrap();
    // Edges of port D come a cycle after those of port B.
    assert!((ZERO..=ZERO + 1).contains(&zero), "{zero}");
    Laid { report, late }
}

/// The ticks of a motor's planned steps.
fn planned<'a>(ensemble: &'a mut Ensemble, motor: usize) -> impl Iterator<Item = u64> + 'a {
    let mut at = 1i128 << 15;
    let moves = std::iter::from_fn(move || ensemble.next_move(motor).unwrap());
    moves.flat_map(move |next| {
        let (begin, segment) = match next {
            Move::Dwell { ticks } => {
                at += i128::from(ticks) << 16;
                (at, Segment { count: 0, ..Segment::single(0) })
            }
            Move::Run { segment, .. } => {
                let begin = at;
                at += segment.span(segment.count);
                (begin, segment)
            }
        };
        (1..=segment.count).map(move |k| (begin + segment.span(k)) as u64 >> 16)
    })
}

const fn step_pin(motor: &Motor) -> u8 {
    let Wiring::StepDir { step, .. } = motor.wiring else { panic!("it has no STEP") };
    step
}

/// The tick of the plan's first step, and its pin.
fn first_step(program: &Program) -> (u64, u8) {
    let mut ensemble = Ensemble::new(program).unwrap();
    let firsts = program.motors.iter().enumerate();
    let firsts = firsts.map(|(motor, of)| (planned(&mut ensemble, motor).next().expect("it moves"), step_pin(of)));
    firsts.min().unwrap()
}

/// Checks that no step of a motion that ends is made before its scheduled tick, nor so much later.
fn never_early(program: &Program, trace: &Trace, late_ticks: u64) {
    let mut ensemble = Ensemble::new(program).unwrap();
    for (motor, of) in program.motors.iter().enumerate() {
        let pin = step_pin(of);
        let on_port_d = u64::from(pin < 8);
        let made = trace.edges.iter().filter(|edge| usize::from(edge.line) == usize::from(pin) && edge.level);
        for (edge, due) in made.zip(planned(&mut ensemble, motor)) {
            let due = ZERO + on_port_d + due;
            assert!((due..=due + late_ticks).contains(&edge.tick), "{}: {} is due at {due}", of.name, edge.tick);
        }
    }
}

/// Checks that each step is there, with its driver's times, and no later than that.
fn keeps(what: &str, program: &Program, seconds: f64, late_ticks: f64) -> Laid {
    let laid = laid(program, &compiled(program), seconds, late_ticks);
    println!("{what}: late {:?}", laid.late);
    assert!(laid.report.ok, "{what}: {:?}", laid.report);
    assert!(laid.report.motors.iter().all(|motor| motor.steps_got > 0), "{what}: {:?}", laid.report);
    laid
}

fn example_keeps(file: &str, seconds: f64, late_ticks: f64) -> Laid {
    let program = load::endless(&example(file), None).unwrap().program;
    keeps(file, &program, seconds, late_ticks)
}

/// One motor: a tick.
const ONE_MOTOR: f64 = 1.0;
/// Four motors: edges that lie close together wait for one another and for a reversal of DIR.
const FOUR_MOTORS: f64 = 383.0;

#[test]
fn sketches_keep_to_the_law() {
    let tutorial = example_keeps("tutorial.toml", 1.5, ONE_MOTOR);
    assert_eq!(tutorial.report.motors[0].steps_got, 8000);
    example_keeps("sweep.toml", 20.0, FOUR_MOTORS);
    example_keeps("max-speed.toml", 20.0, ONE_MOTOR);
}

/// STEP and DIR of up to four motors. Of two of them DIR is not on STEP's port.
const PINS: [(u8, u8); 4] = [(8, 5), (2, 9), (3, 6), (10, 11)];

/// A program of motors; each with its pins, the lines of its driver, and its motion's.
fn motors<'a>(all: impl IntoIterator<Item = ((u8, u8), &'a str, String)>) -> Program {
    let mut text = String::from("board = \"uno\"\ntolerance = \"1 us\"\n");
    for (motor, ((step, dir), driver, motion)) in all.into_iter().enumerate() {
        text += &format!(
            "[motor.m{motor}]\nsteps_per_rev = 200\n{driver}\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n\
             [[motion]]\nmotor = \"m{motor}\"\n{motion}\n"
        );
    }
    file::read(&text, "m.toml", &|_| Err(std::io::ErrorKind::NotFound.into())).unwrap()
}

/// Drivers with short and with long times, and the greatest delay of an edge where several motors reverse together,
/// ticks.
const DRIVERS: [(&str, f64); 4] = [
    ("driver = \"A4988\"", 755.0),
    ("driver = \"DQ542MA\"\nmicrosteps = 2", 950.0),
    ("pulse_high = \"2 us\"\ndir_setup = \"5 us\"\ndir_hold = \"5 us\"", 1225.0),
    ("pulse_high = \"10 us\"", 2090.0),
];

/// Three or four motors reverse within microseconds: a step that waits for its DIR still comes before the next motor's.
#[test]
fn motors_that_turn_together_lose_no_step() {
    for (driver, late_ticks) in DRIVERS {
        for apart_us in [0.0625, 3.0] {
            for order in [&[2, 0, 1][..], &[3, 1, 0, 2]] {
                let program = motors(order.iter().zip(PINS).map(|(place, pins)| {
                    let start = 1000.0 + apart_us * f64::from(*place);
                    let sine = "law.sine = { amplitude = \"5.3 step\", period = \"20 ms\", cycles = \"forever\" }";
                    (pins, driver, format!("start = \"{start} us\"\n{sine}"))
                }));
                keeps(&format!("{driver}, {order:?}, {apart_us} us"), &program, 0.3, late_ticks);
            }
        }
    }
}

/// Steps of one motor at all distances before and after reversals of another: setup and hold are kept, whatever lies in
/// between.
#[test]
fn a_turn_has_its_setup_among_steps_of_others() {
    for (driver, late_ticks) in DRIVERS {
        let program = motors(PINS.iter().enumerate().map(|(motor, pins)| {
            let period = 11.0 + 1.000_37 * motor as f64;
            let sine =
                format!("law.sine = {{ amplitude = \"4.7 step\", period = \"{period} ms\", cycles = \"forever\" }}");
            (*pins, driver, sine)
        }));
        keeps(driver, &program, 20.0, late_ticks);
    }
}

/// Motors at the highest rate that is accepted, for longer than the player's look-ahead: none falls behind.
#[test]
fn the_greatest_rate_can_be_kept() {
    // The lowest and the highest rate at which the limit may lie, of all motors together, steps/s; and the greatest
    // delay of an edge there, ticks.
    for (motors_there, pulse, least_hz, late_ticks) in [
        (1, "1 us", 13_600.0, ONE_MOTOR),
        (1, "10 us", 13_200.0, ONE_MOTOR),
        (1, "30 us", 10_400.0, ONE_MOTOR),
        (2, "1 us", 13_600.0, 140.0),
        (3, "5 us", 13_000.0, 375.0),
        (4, "2 us", 13_000.0, 400.0),
        (4, "10 us", 11_700.0, 790.0),
    ] {
        let driver = format!("driver = \"A4988\"\npulse_high = \"{pulse}\"");
        let at = |rate_hz: f64| {
            motors((0..motors_there).map(|motor| {
                // The ramps are curved, with short rows. The plateau is as fast as possible, and all motors are on it
                // together.
                let speed = rate_hz / motors_there as f64 * (1.0 - 0.003 * motor as f64);
                let law = format!(
                    "law.trapezoid = {{ distance = \"{} step\", speed = \"{speed} step/s\", acceleration = \"40000 step/s^2\" }}",
                    0.8 * speed
                );
                (PINS[motor], driver.as_str(), law)
            }))
        };
        // The highest rate that is accepted, to one percent.
        let mut rate_hz = 17_000.0;
        let program = loop {
            let program = at(rate_hz);
            match Sketch::new(&program, "fast") {
                Ok(_) => break program,
                Err(BakeError::TooFast { .. } | BakeError::TooClose { .. }) => rate_hz *= 0.99,
                Err(error) => panic!("{error}"),
            }
        };
        assert!(rate_hz > least_hz, "{motors_there} motors, pulses of {pulse}: {rate_hz} steps/s");
        keeps(&format!("{motors_there} motors, pulses of {pulse}, {rate_hz} steps/s"), &program, 2.5, late_ticks);
    }
}

/// Motors that share a DIR line repeat together, from the beginning of the last of them on. Motors that end have ended.
#[test]
fn motors_that_share_a_dir_line_may_begin_late() {
    let sine = "law.sine = { amplitude = \"12.3 step\", period = \"0.5 s\", cycles = \"forever\" }";
    let ends = "law.sine = { amplitude = \"9.1 step\", period = \"0.4 s\", cycles = 3 }";
    let program = motors([
        ((8, 5), DRIVERS[1].0, sine.to_owned()),
        ((9, 5), DRIVERS[1].0, format!("start = \"4.1003 s\"\n{sine}")),
        ((10, 5), DRIVERS[1].0, format!("start = \"2.9 s\"\n{ends}")),
    ]);
    keeps("shared line", &program, 20.0, 140.0);
}

/// 100 000 turns in five minutes, past the wrap of the player's 32 bits of ticks (268 s): no error grows.
#[test]
fn turns_keep_their_phase_across_the_wrap_of_the_ticks() {
    let sine = "law.sine = { amplitude = \"1.2 step\", period = \"2.99999983 ms\", cycles = \"forever\" }";
    let program = motors([(PINS[0], DRIVERS[0].0, sine.to_owned())]);
    let Laid { report, .. } = keeps("300 s", &program, 300.0, ONE_MOTOR);
    assert!(report.motors[0].drift_ppm.abs() < 1e-4, "{report:?}");
}
