//! Sketches that `pulsetrain bake` makes, compiled with Debian's Arduino core, on the virtual Uno, and judged on its pins.
//! `cargo xtask test` installs what they need, and runs these.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

use pulsetrain::cli;
use pulsetrain::console::Exit;
use pulsetrain::prepare::Prepared;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Port, hex, stk500};
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

/// The sketch of a motion file, compiled as the Arduino IDE does: its image.
fn compiled(file: &str) -> Vec<u8> {
    let folder = Folder(std::env::temp_dir().join(format!(
        "pulsetrain-sketch-{}-{}",
        file.replace('.', "-"),
        std::process::id()
    )));
    let sketch = folder.0.join("motion");
    let motion = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file);
    let (mut out, mut err) = (Vec::new(), Vec::new());
    let args = ["pulsetrain", "bake", motion.to_str().unwrap(), "--sketch", sketch.to_str().unwrap()];
    assert_eq!(cli::run(args, &mut out, &mut err), Exit::Success, "{}", String::from_utf8_lossy(&err));

    let (elf, image) = (folder.0.join("motion.elf"), folder.0.join("motion.hex"));
    let mut compiler = Command::new("avr-g++");
    compiler
        .args("-mmcu=atmega328p -DF_CPU=16000000L -DARDUINO=10819 -DARDUINO_AVR_UNO -DARDUINO_ARCH_AVR -Os".split(' '));
    compiler.args("-w -ffunction-sections -fdata-sections -fno-exceptions -Wl,--gc-sections".split(' '));
    compiler.args([format!("-I{CORE}/cores/arduino"), format!("-I{CORE}/variants/standard")]);
    compiler
        .args(["-x", "c++"])
        .arg(sketch.join("motion.ino"))
        .arg(format!("{CORE}/cores/arduino/main.cpp"))
        .args(["-x", "c"]);
    compiler.args(["hooks.c", "wiring.c", "wiring_digital.c"].map(|file| format!("{CORE}/cores/arduino/{file}")));
    run(compiler.arg("-o").arg(&elf));
    run(Command::new("avr-objcopy").args(["-O", "ihex", "-j", ".text", "-j", ".data"]).args([&elf, &image]));
    hex::parse(&fs::read_to_string(image).unwrap(), stk500::FLASH_BYTES).unwrap()
}

fn run(command: &mut Command) {
    let output = command.output().expect("Debian's gcc-avr is installed");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Every edge of the pins in so long.
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

/// A motion judged for so long; edges may be later than scheduled by `late_ticks` more than the first of them.
fn judged(file: &str, seconds: f64, late_ticks: f64) -> Report {
    let motion = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples").join(file);
    let program = Prepared::endless(&motion, None).unwrap().program;
    let endless = program.motors.iter().any(|motor| motor.law.end().is_none());
    let options = Options {
        align: Align::Start,
        bound_ticks: Some(program.tolerance.ticks(program.board.tick_hz) + late_ticks),
        until_s: endless.then_some(seconds - 0.5),
        ..Options::default()
    };
    let verdict = verdict::judge(&trace(&compiled(file), seconds), &program, &options).unwrap();
    for motor in &verdict.motors {
        println!("{file}: {motor:?}");
    }
    verdict
}

/// One motor: nothing but the instruction that is under way delays an edge.
#[test]
#[ignore = "needs Debian's arduino-core-avr and gcc-avr; cargo xtask test runs it"]
fn the_tutorial_keeps_to_its_bound() {
    let verdict = judged("tutorial.toml", 1.5, 4.0);
    assert!(verdict.ok, "{verdict:?}");
    assert_eq!(verdict.motors[0].steps_got, 8000);
}

/// Four motors on one DIR line, for ever: edges that lie close together wait for each other.
#[test]
#[ignore = "needs Debian's arduino-core-avr and gcc-avr; cargo xtask test runs it"]
fn the_sweep_goes_on_and_on() {
    let verdict = judged("sweep.toml", 20.0, 400.0);
    assert!(verdict.ok, "{verdict:?}");
}

#[test]
#[ignore = "needs Debian's arduino-core-avr and gcc-avr; cargo xtask test runs it"]
fn an_easydriver_turns_there_and_back_for_ever() {
    let verdict = judged("max-speed.toml", 20.0, 4.0);
    assert!(verdict.ok, "{verdict:?}");
}
