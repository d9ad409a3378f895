//! What `pulsetrain bake` makes on the virtual Uno, judged on its pins: images, and sketches, compiled with Debian's Arduino core.
//! `cargo xtask test` installs what sketches need.

#[path = "../../board/tests/common/seed.rs"]
mod seed;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use pulsetrain::bake::Image;
use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain::prepare::Prepared;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Port, hex, stk500};
use pulsetrain_motion::file;
use pulsetrain_trace::verdict::{self, Align, Options, Report};
use pulsetrain_trace::{Edge, Line, Trace};

const CORE: &str = "/usr/share/arduino/hardware/arduino/avr";

/// Where a test's files are; gone with it.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// How a motion comes to an Uno.
#[derive(Clone, Copy, Debug)]
enum Way {
    Sketch,
    Image,
}

fn example(file: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file)
}

fn bake(file: &str, option: &str, to: &Path) {
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let args = ["pulsetrain", "bake", example(file).to_str().unwrap(), option, to.to_str().unwrap()].map(str::to_owned);
    assert_eq!(cli::run(args, &mut out, &mut err), Exit::Success, "{}", String::from_utf8_lossy(&err));
}

/// The flash of an Uno that has it.
fn baked(file: &str, way: Way) -> Vec<u8> {
    let name = format!("pulsetrain-baked-{way:?}-{}-{}", file.replace('.', "-"), std::process::id());
    let folder = Folder(std::env::temp_dir().join(name));
    let image = folder.0.join("motion.hex");
    match way {
        Way::Image => bake(file, "--output", &image),
        Way::Sketch => compile(file, &folder.0, &image),
    }
    hex::parse(&fs::read_to_string(image).unwrap(), stk500::FLASH_BYTES).unwrap()
}

/// The sketch of a motion file, compiled as the Arduino IDE does.
fn compile(file: &str, folder: &Path, image: &Path) {
    let sketch = folder.join("motion");
    bake(file, "--sketch", &sketch);
    let elf = folder.join("motion.elf");
    let mut compiler = Command::new("avr-g++");
    compiler
        .args("-mmcu=atmega328p -DF_CPU=16000000L -DARDUINO=10819 -DARDUINO_AVR_UNO -DARDUINO_ARCH_AVR -Os".split(' '));
    compiler.args("-w -ffunction-sections -fdata-sections -fno-exceptions -Wl,--gc-sections".split(' '));
    compiler.args([format!("-I{CORE}/cores/arduino"), format!("-I{CORE}/variants/standard")]);
    compiler.args(["-x", "c++"]).arg(sketch.join("motion.ino"));
    compiler.arg(format!("{CORE}/cores/arduino/main.cpp")).args(["-x", "c"]);
    compiler.args(["hooks.c", "wiring.c", "wiring_digital.c"].map(|file| format!("{CORE}/cores/arduino/{file}")));
    run(compiler.arg("-o").arg(&elf));
    run(Command::new("avr-objcopy").args(["-O", "ihex", "-j", ".text", "-j", ".data"]).arg(&elf).arg(image));
}

fn run(command: &mut Command) {
    let output = command.output().expect("Debian's gcc-avr is installed");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Every edge of the pins in so long.
fn trace(image: &[u8], seconds: f64) -> Trace {
    watched(&mut VirtualUno::with_image(image).unwrap(), seconds)
}

fn watched(uno: &mut VirtualUno, seconds: f64) -> Trace {
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

/// A motion judged for so long; edges may be later than scheduled by `late_ticks` more than the first of them.
fn judged(file: &str, way: Way, seconds: f64, late_ticks: f64) -> Report {
    let program = Prepared::endless(&example(file), None).unwrap().program;
    let endless = program.motors.iter().any(|motor| motor.law.end().is_none());
    let options = Options {
        align: Align::Start,
        bound_ticks: Some(program.tolerance.ticks(program.board.tick_hz) + late_ticks),
        until_s: endless.then_some(seconds - 0.5),
        ..Options::default()
    };
    let report = verdict::judge(&trace(&baked(file, way), seconds), &program, &options).unwrap();
    assert!(report.ok, "{file}, {way:?}: {report:?}");
    report
}

/// One motor: nothing but the instruction that is under way delays an edge.
const ONE_MOTOR: f64 = 4.0;
/// Four motors: edges that lie close together wait for one another, and a turn of DIR for both.
const FOUR_MOTORS: f64 = 400.0;

#[test]
fn images_keep_to_the_law() {
    let report = judged("tutorial.toml", Way::Image, 1.5, ONE_MOTOR);
    assert_eq!(report.motors[0].steps_got, 8000);
    judged("sweep.toml", Way::Image, 20.0, FOUR_MOTORS);
    judged("max-speed.toml", Way::Image, 20.0, ONE_MOTOR);
}

#[test]
#[cfg(target_os = "linux")]
fn sketches_keep_to_the_law() {
    let report = judged("tutorial.toml", Way::Sketch, 1.5, ONE_MOTOR);
    assert_eq!(report.motors[0].steps_got, 8000);
    judged("sweep.toml", Way::Sketch, 20.0, FOUR_MOTORS);
    judged("max-speed.toml", Way::Sketch, 20.0, ONE_MOTOR);
}

/// Motors at the greatest rate that is taken, all turning and at speeds that change all the time: none falls behind.
#[test]
fn the_greatest_rate_can_be_kept() {
    const PINS: [(u8, u8); 4] = [(8, 9), (2, 5), (3, 6), (10, 11)];
    for (motors, pulse) in [(1, "1 us"), (1, "10 us"), (2, "1 us"), (3, "5 us"), (4, "2 us")] {
        let mut text = String::from("board = \"uno\"\ntolerance = \"1 us\"\n");
        for (motor, (step, dir)) in PINS.iter().enumerate().take(motors) {
            // Peaks of 2 pi A / T that come to 13 900 steps/s together, at periods that are no multiples of one another.
            let period = 0.4 + 0.0371 * motor as f64;
            let amplitude = 13_900.0 / motors as f64 * period / std::f64::consts::TAU;
            text += &format!(
                "[motor.m{motor}]\nsteps_per_rev = 200\ndriver = \"A4988\"\npulse_high = \"{pulse}\"\n\
                 pins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n\
                 [[motion]]\nmotor = \"m{motor}\"\n\
                 law.sine = {{ amplitude = \"{amplitude:.3} step\", period = \"{period} s\", cycles = 3 }}\n"
            );
        }
        let program = file::read(&text, "m.toml", &|_| Err(std::io::ErrorKind::NotFound.into())).unwrap();
        let image = Image::new(&program).unwrap();
        let bound_ticks = Some(16.0 + FOUR_MOTORS);
        let options = Options { align: Align::Start, bound_ticks, ..Options::default() };
        let report = verdict::judge(&trace(&image.flash, 2.0), &program, &options).unwrap();
        assert!(report.ok, "{motors} motors, pulses of {pulse}: {report:?}");
        assert_eq!(report.motors[0].steps_got, report.motors[0].steps_wanted);
    }
}

/// From its box to a motion: the bootloader takes the image, and starts it at each power-up.
#[test]
#[cfg(target_os = "linux")]
fn a_bootloader_takes_an_image_and_starts_it() {
    let optiboot =
        std::env::var("PULSETRAIN_OPTIBOOT").expect("run `cargo xtask test`: it builds Optiboot, and says where");
    let optiboot = hex::parse(&fs::read_to_string(optiboot).unwrap(), stk500::FLASH_BYTES).unwrap();
    let uno = VirtualUno::with_bootloader(&[], &optiboot).unwrap();
    let image = baked("tutorial.toml", Way::Image);
    let mut uno = stk500::Bootloader::find(uno, stk500::RATES[0]).unwrap().program(&image, |_| {}).unwrap();
    for _ in 0..2 {
        let program = Prepared::endless(&example("tutorial.toml"), None).unwrap().program;
        let options = Options { align: Align::Start, bound_ticks: Some(1.0 + ONE_MOTOR), ..Options::default() };
        let report = verdict::judge(&watched(&mut uno, 3.0), &program, &options).unwrap();
        assert!(report.ok, "{report:?}");
        uno.reset();
    }
}

/// Past the wrap of the player's ticks, 268 s; with PULSETRAIN_ROUNDS=12 an hour.
#[test]
fn phases_are_kept() {
    let report = judged("sweep.toml", Way::Image, 300.0 * seed::rounds() as f64, FOUR_MOTORS);
    for motor in &report.motors {
        println!("{}: {} steps, drift {} ppm", motor.motor, motor.steps_got, motor.drift_ppm);
        assert!(motor.drift_ppm.abs() < 1e-4, "{motor:?}");
    }
}
