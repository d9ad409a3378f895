//! Pico images of `pulsetrain bake` on the virtual Pico. The pins are judged as in any run.

use std::io;
use std::time::Duration;

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain_bake::{BakeError, PicoImage};
use pulsetrain_board::virtual_pico::{self, VirtualPico};
use pulsetrain_board::{Board, Edge, Port, Remote, RemoteError, Setup, image};
use pulsetrain_core::baked::POINTER;
use pulsetrain_core::wire::message::{MotorSetup, flags};
use pulsetrain_core::wire::{Reason, Settings};
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{boards, file};
use pulsetrain_plan::PlanError;
use pulsetrain_session::prepare::{Prepared, Refusal};
use pulsetrain_trace::verdict::{self, Align, Options, Report};
use pulsetrain_trace::{Line, Trace};

/// From the clock's tick 0 to the laws' time 0, s: 0.1 s, and at most the work before it.
const LEAD_S: f64 = 0.12;

/// A program as `pulsetrain bake --board pico` reads it.
fn program(motors: &str) -> Program {
    let text = format!("board = \"pico\"\n{motors}");
    let mut program = file::read(&text, "m.toml", &|_| Err(io::ErrorKind::NotFound.into())).unwrap();
    let row = boards::find("pico").unwrap();
    program.board.min_interval_ticks = row.shortest_intervals(&program.motors);
    program.board.turn_ticks = row.turn_ticks(&program.motors);
    program
}

/// A motor with a driver, STEP on `pin` and DIR on the next pin.
fn driver(pin: u8, law: &str) -> String {
    format!(
        "[motor.m{pin}]\nsteps_per_rev = 200\ndriver = \"A4988\"\npins = {{ step = {pin}, dir = {} }}\nforward = \"high\"\n\
         [[motion]]\nmotor = \"m{pin}\"\n{law}\n",
        pin + 1
    )
}

/// The motion of `examples/sweep.toml`.
fn sweep() -> Program {
    let sweeps = [(2, "0.5 Hz", 200), (4, "1 Hz", 100), (6, "2 Hz", 50), (8, "4 Hz", 25)];
    let motor = |(pin, frequency, swing)| {
        let law = format!(
            "start = \"100 ms\"\nlaw.sweep = {{ frequency = \"{frequency}\", swing = \"{swing} step\", phase = \"0 ms\" }}"
        );
        driver(pin, &law)
    };
    program(&(String::from("grid = \"reach\"\n") + &sweeps.map(motor).concat()))
}

fn baked(program: &Program) -> VirtualPico {
    VirtualPico::with_image(&PicoImage::new(program).unwrap().uf2()).unwrap()
}

/// All edges of the pins until a time after the clock's tick 0.
fn watched(pico: &mut VirtualPico, until_s: f64) -> Trace {
    let (mut edges, mut all) = (Vec::new(), Vec::new());
    let end = Duration::from_secs_f64(until_s);
    while pico.now() < end {
        let until = end.min(pico.now() + Duration::from_millis(100));
        pico.receive(until, &mut Vec::new()).unwrap();
        pico.edges(&mut edges);
        all.extend(edges.drain(..).map(|edge| pulsetrain_trace::Edge {
            tick: edge.tick,
            line: edge.line,
            level: edge.level,
        }));
    }
    let lines = (0..29).map(|pin| Line::named(format!("pin{pin}"))).collect();
    Trace { tick_hz: 125_000_000, lines, edges: all }
}

/// Whether a trace is the motion for a time, within the certificate and a tick, with all motors against one zero.
fn judged(program: &Program, trace: &Trace, until_s: Option<f64>) -> Report {
    let options = Options {
        align: Align::Start,
        bound_ticks: Some(program.tolerance.ticks(program.board.tick_hz) + 1.0),
        until_s,
        ..Options::default()
    };
    let report = verdict::judge(trace, program, &options).unwrap();
    assert!(report.ok, "{report:?}");
    report
}

/// Four motors with different periods, past the wrap of 2^32 ticks (34.4 s).
#[test]
fn phases_are_kept_past_the_wraps() {
    let program = sweep();
    let trace = watched(&mut baked(&program), 36.0 + LEAD_S);
    let report = judged(&program, &trace, Some(35.9));
    for motor in &report.motors {
        assert!(motor.drift_ppm.abs() < 1e-4, "{motor:?}");
    }
}

#[test]
fn the_tutorials_sine_goes_on_for_ever() {
    let law = "law.sine = { amplitude = \"2.5 rev\", period = \"0.9700000007 s\", cycles = \"forever\" }";
    let program = program(&driver(2, law).replace("steps_per_rev = 200", "steps_per_rev = 200\nmicrosteps = 4"));
    let trace = watched(&mut baked(&program), 5.0 + LEAD_S);
    let report = judged(&program, &trace, Some(4.9));
    assert!(report.motors[0].steps_got > 40_000, "{report:?}");
}

/// Motors that accelerate from rest to a constant speed, together with slow ones.
#[test]
fn a_speed_goes_on_for_ever() {
    let ramp = "law.then = [ { formula = { theta = \"10000.35*t*t\", unit = \"step\", duration = \"0.5 s\" } }, \
                { speed = { speed = \"10000.35 step/s\" } } ]";
    let slow = |speed: &str| format!("begin = \"jump\"\nlaw.speed = {{ speed = \"{speed}\" }}");
    let program = program(&(driver(2, ramp) + &driver(4, &slow("-33.3 step/s")) + &driver(6, &slow("0.7 step/s"))));
    let trace = watched(&mut baked(&program), 8.0 + LEAD_S);
    let report = judged(&program, &trace, Some(7.9));
    assert!(report.motors[0].steps_got > 70_000 && report.motors[2].steps_got == 6, "{report:?}");
}

/// Two ULN2003 boards and a driver. One of the waits is longer than the clock can tell times apart (17 s).
#[test]
fn coils_and_long_waits() {
    let coils = |first: u8, law: &str| {
        let pins: Vec<u8> = (first..first + 4).collect();
        format!(
            "[motor.c{first}]\nsteps_per_rev = 32\nmicrosteps = 2\ndriver = \"ULN2003\"\npins = {{ in = {pins:?} }}\n\
             pull_in = \"300 step/s\"\n[[motion]]\nmotor = \"c{first}\"\n{law}\n"
        )
    };
    let text = coils(2, "law.sine = { amplitude = \"10 step\", period = \"0.5 s\", cycles = \"forever\" }")
        + &coils(6, "law.sine = { amplitude = \"7 step\", period = \"0.7 s\", cycles = 2 }")
        + &driver(
            10,
            "repeat = \"forever\"\nlaw.then = [ { sine = { amplitude = \"5 step\", period = \"0.3 s\", cycles = 1 } }, { rest = \"18.1 s\" } ]",
        );
    let program = program(&text);
    let trace = watched(&mut baked(&program), 20.0 + LEAD_S);
    let report = judged(&program, &trace, Some(19.9));
    assert_eq!(report.motors[2].steps_got, 40, "{report:?}");
}

/// Eight motors that reverse twice within some ms, a millisecond more from motor to motor.
fn turning(period_ms: u8) -> Program {
    let motor = |motor: u8| {
        let law = format!(
            "law.sine = {{ amplitude = \"0.03 rev\", period = \"{} ms\", cycles = \"forever\" }}",
            period_ms + motor
        );
        driver(2 + 2 * motor, &law).replace("steps_per_rev = 200", "steps_per_rev = 200\nmicrosteps = 16")
    };
    // GPIO 2 to 17.
    program(&(0..8).map(motor).collect::<String>())
}

/// More frequent reversals are refused, also of endless motions, with advice.
#[test]
fn eight_motors_beyond_the_limit_are_refused() {
    let program = turning(10);
    let Err(BakeError::Plan(refused)) = PicoImage::new(&program) else { panic!("it is taken") };
    let prepared = Prepared {
        file: "turning".to_owned(),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    };
    match prepared.refuse(refused) {
        Refusal::Plan { error: PlanError::TooManySegments { .. }, advice, .. } => {
            assert!(advice.contains("native"), "{advice}");
        }
        other => panic!("{other:?}"),
    }
}

/// Eight motors that reverse as often as the planner allows: the reader of the flash keeps up.
#[test]
fn eight_motors_at_the_limit_do_not_starve() {
    let program = turning(14);
    let mut pico = baked(&program);
    judged(&program, &watched(&mut pico, 1.0 + LEAD_S), Some(0.9));
    let mut remote = Remote::open(pico, 1).unwrap();
    assert_eq!(remote.measures(false).unwrap().starved, 0);
}

/// A motion that ends leaves the board to hosts.
#[test]
fn a_motion_that_ends_runs_once() {
    let program = program(&driver(2, "law.sine = { amplitude = \"1 rev\", period = \"0.5 s\", cycles = 1 }"));
    let mut pico = baked(&program);
    let report = judged(&program, &watched(&mut pico, 0.8), None);
    assert_eq!(report.motors[0].steps_got, 800);
    let mut remote = Remote::open(pico, 1).unwrap();
    let head = remote.status().unwrap().head;
    assert_eq!(head.flags & (flags::BAKED | flags::IDLE), flags::IDLE);
    remote.configure(&one_motor()).unwrap();
}

/// Settings stay through another image and its motion. While the motion runs nothing can be stored.
#[test]
fn settings_and_a_baked_motion_do_not_meet() {
    let settings = Settings { deadman_ms: 500, silence_ms: 700, ..Settings::default() };
    let mut remote = Remote::open(VirtualPico::new(), 1).unwrap();
    remote.store(&settings).unwrap();
    let mut flash = remote.close().chip().flash().to_vec();
    // Writes the flash as the boot ROM does with a UF2 file: only the file's sectors.
    let program = program(&driver(2, "law.sine = { amplitude = \"1 rev\", period = \"0.5 s\", cycles = 1 }"));
    let image = PicoImage::new(&program).unwrap().flash;
    flash[..image.len()].copy_from_slice(&image);
    let mut pico = VirtualPico::with_flash(&flash).unwrap();
    let mut early = Remote::open(pico.clone(), 2).unwrap();
    let refused = early.store(&Settings::default()).unwrap_err();
    assert!(matches!(refused, RemoteError::Refused { reason: Reason::Baked, .. }), "{refused:?}");
    let report = judged(&program, &watched(&mut pico, 0.8), None);
    assert_eq!(report.motors[0].steps_got, 800);
    let mut remote = Remote::open(pico, 1).unwrap();
    remote.release().unwrap();
    assert_eq!(remote.stored().unwrap().settings, Some(settings));
}

fn one_motor() -> Setup {
    let motor = MotorSetup { step_pin: 20, dir_pin: 21, pull_in_ticks: 1_000_000, ..MotorSetup::default() };
    Setup { pulse_ticks: 250, setup_ticks: 250, motors: vec![motor], ..Setup::default() }
}

/// A host may ask while the motion runs, here over USB. Only a stop changes the motion.
#[test]
fn hosts_may_ask_and_stop_it() {
    let program = sweep();
    let mut remote = Remote::open(baked(&program).opened().unwrap(), 1).unwrap();
    let mut edges = Vec::new();
    let mut watch = |remote: &mut Remote<VirtualPico>, seconds: f64| {
        let until = remote.now() + (seconds * 125e6) as u64;
        remote.advance(until, &mut |edge: Edge| {
            edges.push(pulsetrain_trace::Edge { tick: edge.tick, line: edge.line, level: edge.level });
        });
        edges.len()
    };
    watch(&mut remote, 1.0);
    let head = remote.status().unwrap().head;
    assert_eq!(head.flags & (flags::BAKED | flags::IDLE), flags::BAKED);
    let refused = remote.configure(&one_motor());
    assert!(matches!(refused, Err(RemoteError::Refused { reason: Reason::Baked, .. })), "{refused:?}");
    watch(&mut remote, 1.0);
    let now = remote.now();
    let lines = (0..29).map(|pin| Line::named(format!("pin{pin}"))).collect();
    remote.stop_now(now, &mut |_: Edge| {});
    assert_eq!(remote.status().unwrap().head.flags & (flags::BAKED | flags::ARMED), 0);
    let before = watch(&mut remote, 0.1);
    assert_eq!(watch(&mut remote, 1.0), before, "nothing moves after a stop");
    judged(&program, &Trace { tick_hz: 125_000_000, lines, edges: edges.clone() }, Some(1.5));
    remote.configure(&one_motor()).unwrap();
}

/// A block with any wrong bit is ignored, as in the committed image, which has none.
#[test]
fn what_is_damaged_does_not_move() {
    let program = sweep();
    let image = PicoImage::new(&program).unwrap();
    let committed = image::uf2(virtual_pico::IMAGE, virtual_pico::FAMILY).unwrap();
    let committed = image::flat(&committed, 0x1000_0000, PicoImage::FLASH_BYTES).unwrap();
    assert_eq!(committed[POINTER..POINTER + 4], [0; 4]);
    let begin = u32::from_le_bytes(*image.flash[POINTER..].first_chunk().unwrap()) as usize;
    assert!(image.flash[..begin].len().is_multiple_of(4096) && image.flash.len().is_multiple_of(4096));
    let differ: Vec<usize> = (0..committed.len()).filter(|at| committed[*at] != image.flash[*at]).collect();
    assert!(differ.iter().all(|at| (POINTER..POINTER + 4).contains(at)), "{differ:?}");
    // Only the serial line wakes the processor.
    let plain = watched(&mut VirtualPico::new(), 0.5).edges;
    assert!(plain.iter().all(|edge| edge.line < 2), "{plain:?}");
    for at in [begin, begin + 5, begin + 9, begin + 12, begin + 40, begin + image.block_bytes - 1] {
        let mut damaged = image.clone();
        damaged.flash[at] ^= 4;
        let mut pico = VirtualPico::with_image(&damaged.uf2()).unwrap();
        let trace = watched(&mut pico, 0.5);
        assert_eq!(trace.edges, plain, "byte {at}");
        let mut remote = Remote::open(pico, 1).unwrap();
        assert_eq!(remote.status().unwrap().head.flags & (flags::BAKED | flags::CONFIGURED), 0);
    }
}

#[test]
fn what_cannot_be_baked_is_told() {
    let endless = program(&driver(2, "law.formula = { theta = \"0.1*sin(t)\", unit = \"rev\" }"));
    assert!(matches!(PicoImage::new(&endless), Err(BakeError::Endless { motor }) if motor == "m2"));
    let mut uno = program(&driver(2, "law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1 }"));
    uno.board.name = "due".into();
    assert!(matches!(PicoImage::new(&uno), Err(BakeError::Board { .. })));
    // Pins and times that the firmware refuses.
    let mut slow = program(&driver(2, "law.sine = { amplitude = \"1 rev\", period = \"1 s\", cycles = 1 }"));
    slow.motors[0].timing.dir_setup_ns = 1_000_000;
    let error = PicoImage::new(&slow).unwrap_err();
    assert!(matches!(error, BakeError::Refused(_)) && error.to_string().contains("62500"), "{error}");
    // A smaller flash; the firmware needs some of it.
    let law = "law.formula = { theta = \"cos(2*pi*t) + 0.3*cos(6*pi*t) + 0.1*cos(20*pi*t)\", unit = \"rev\", duration = \"4 s\" }";
    let long = program(&driver(2, law).replace("steps_per_rev = 200", "steps_per_rev = 200\nmicrosteps = 16"));
    let image = PicoImage::new(&long).unwrap();
    assert!(image.block_bytes > 4096, "{}", image.block_bytes);
    assert!(PicoImage::within(&long, image.flash.len()).is_ok());
    let error = PicoImage::within(&long, image.flash.len() - 4096).unwrap_err();
    assert!(matches!(error, BakeError::TooLarge { fits_s, .. } if fits_s > 0.0 && fits_s < 4.0), "{error}");
}

/// The command with an example for a Pico and one for an Uno.
#[test]
fn the_command_says_what_it_takes() {
    let folder = std::path::PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
    let pulsetrain = |args: &[&str]| {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let exit = cli::run([&["pulsetrain"], args].concat(), &mut out, &mut err);
        (exit, String::from_utf8(out).unwrap() + &String::from_utf8(err).unwrap())
    };
    for (example, board) in [("pico.toml", &[][..]), ("tutorial.toml", &["--board", "pico"])] {
        let example = format!("../../examples/{example}");
        let image = folder.join("baked-pico.uf2").display().to_string();
        let (exit, said) = pulsetrain(&[&["bake", &example, "--output", &image], board].concat());
        assert_eq!(exit, Exit::Success, "{said}");
        assert!(said.contains("2 088 960") && said.contains("runs once after power-up"), "{said}");
        assert!(VirtualPico::with_image(&std::fs::read(&image).unwrap()).is_ok());
        let (exit, said) = pulsetrain(&[&["bake", &example, "--sketch", "baked-pico"], board].concat());
        assert!(exit != Exit::Success && said.contains("sketches are for an Uno"), "{said}");
    }
}
