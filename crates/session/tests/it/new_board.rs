//! A board that is not among the project's: its two profiles are here, and nothing else of it. docs/adding-a-board.md describes them.
//!
//! Behind its port is the model firmware of the testkit, a board without an emulated chip.

use pulsetrain_board::profiles::{AxisWiring, DeviceProfile, Flashing};
use pulsetrain_board::{Board as _, BoardKind, Edge};
use pulsetrain_core::RegisterWidths;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards::{self, BoardProfile, LineTiming, PinRules, PinsError};
use pulsetrain_motion::file::{Contents, FileError, Sheet};
use pulsetrain_motion::program::{Motor, Wiring};
use pulsetrain_session::drive::{DriveError, Driven, connect_as};
use pulsetrain_session::prepare::{Prepared, Refusal};
use pulsetrain_testkit::model::{ModelPort, TICK_HZ};

/// What plans need to know of it.
static DUMMY: BoardProfile = BoardProfile {
    name: "dummy",
    former_names: &[],
    about: "a board of this test",
    note: "",
    source: "estimate",
    tick_hz: TICK_HZ as u64,
    registers: RegisterWidths::NARROW,
    max_motors: 3,
    min_interval_ticks: &[400, 800],
    hardware_timed: true,
    one_timing: true,
    turn_ticks: 0,
    segment_ticks: &[],
    horizon_ticks: 0,
    lateness_ticks: 0,
    ram_bytes: None,
    flash_bytes: None,
    queue_bytes: &[1024, 512, 341],
    line: Some(LineTiming {
        delay_us: 700,
        delay_byte_us: 100,
        delay_bytes: 290,
        other_bytes_per_s: 2_300,
        frame_share: 1.33,
        usb_bytes_per_s: None,
    }),
    pins: 2..=40,
    reserved: &[(13..=13, "the lamp")],
    analogue: Some((20, 4)),
    rules: &EvenSteps,
};

/// STEP lines are on even pins.
struct EvenSteps;

impl PinRules for EvenSteps {
    fn check(&self, motors: &[Motor]) -> Result<(), PinsError> {
        let is_odd = |motor: &&Motor| matches!(motor.wiring, Wiring::StepDir { step, .. } if step % 2 == 1);
        motors.iter().find(is_odd).map_or(Ok(()), |motor| {
            let problem = format!("STEP of `{}` is on an odd pin", motor.name);
            Err(PinsError::new(problem, "wire it to an even one".to_owned()))
        })
    }
}

/// What a connection needs to know of it.
static DUMMY_DEVICE: DeviceProfile = DeviceProfile {
    name: "dummy",
    title: "Dummy",
    title_with_article: "a Dummy",
    full_name: "a Test Dummy",
    chip: "none",
    other_chip_help: "",
    number: 200,
    usual_baud: Baud::B500k,
    resets_when_opened: false,
    hearing_byte_us: 100,
    flashing: Flashing::Stk500,
    has_image_for_each_role: false,
    image: |_| Vec::new(),
    emulation: None,
    is_rehearsed: false,
    counts_missed_compares: false,
    bench_steps: 100.0,
    axes: AxisWiring {
        pins: [(2, 3), (4, 5), (6, 7), (8, 9)],
        enable: 10,
        pulse_ticks: 16,
        setup_ticks: 16,
        edge_delay_ticks: 0,
    },
    first_coil_pin: None,
};

/// Two motors, the first with STEP on that pin.
fn text(step: &str) -> String {
    let motor = |name: &str, step: &str, dir: u8, amplitude: u32| {
        format!(
            "[motor.{name}]\nsteps_per_rev = 200\npulse_high = \"2 us\"\npins = {{ step = {step}, dir = {dir} }}\nforward = \"high\"\n\
             max_acceleration = \"500 rev/s^2\"\n[[motion]]\nmotor = \"{name}\"\n\
             law.sine = {{ amplitude = \"{amplitude} step\", period = \"1 s\", cycles = 2 }}\n"
        )
    };
    format!("board = \"dummy\"\n{}{}", motor("a", step, 31, 900), motor("b", "\"A2\"", 23, 400))
}

fn read(text: &str, boards: Vec<&'static BoardProfile>) -> Result<Contents, FileError> {
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    Sheet::parse(text, "dummy.toml")?.with_boards(boards).contents(&no_files)
}

/// The project's boards, and this one.
fn with_dummy() -> Vec<&'static BoardProfile> {
    let mut list = boards::BUILT_IN.to_vec();
    list.push(&DUMMY);
    list
}

fn prepared(step: &str) -> Result<Prepared, Refusal> {
    let contents = read(&text(step), with_dummy()).expect("it is a motion file");
    let mut prepared = Prepared::new("dummy.toml".to_owned(), contents, None)?;
    prepared.over_line(Some(Baud::B1M));
    Ok(prepared)
}

#[test]
fn a_board_is_known_by_the_list_that_it_is_in() {
    let unknown = read(&text("30"), boards::BUILT_IN.to_vec()).unwrap_err().plain();
    assert!(unknown.contains("unknown board \"dummy\""), "{unknown}");
    assert!(boards::find("dummy").is_none());
    assert_eq!(boards::find_in(&with_dummy(), "Dummy"), Some(&DUMMY));
    let read_at = |step: &str| read(&text(step), with_dummy()).map(|_| ()).map_err(|error| error.plain());
    assert_eq!(read_at("30"), Ok(()));
    let no_pin = read_at("41").unwrap_err();
    assert!(no_pin.contains("the board `dummy` has no pin 41: its pins are 2 to 40"), "{no_pin}");
    let lamp = read_at("13").unwrap_err();
    assert!(lamp.contains("pin 13 of the board `dummy` is taken: the lamp"), "{lamp}");
}

#[test]
fn its_limits_and_rules_are_those_of_its_profile() {
    let prepared = prepared("30").unwrap();
    let board = &prepared.program.board;
    assert_eq!(
        (board.max_motors, board.min_interval_ticks.as_slice(), board.tick_hz),
        (3, &[400, 800][..], 16_000_000)
    );
    let line = prepared.line.as_ref().expect("plans come to it over a line");
    assert_eq!((line.queue_bytes.as_slice(), line.longest_queue_bytes), (&[448, 448][..], 896));
    let refused = self::prepared("39").unwrap_err();
    assert_eq!(refused.to_string(), "dummy.toml: STEP of `a` is on an odd pin");
    assert_eq!(refused.advice(), Some("wire it to an even one"));
}

/// Each edge of the model comes on the tick of the native board that gets the same plan, and both motors make all their steps.
#[test]
fn it_is_driven_through_a_port() {
    let prepared = prepared("30").unwrap();
    let remote = connect_as(ModelPort::new(), &prepared.program, Baud::B1M, 1).unwrap();
    assert_eq!(remote.kind(), None);
    let before = remote.delivery(100);
    let remote = remote.as_board(BoardKind::of(&DUMMY_DEVICE));
    assert_eq!(remote.kind().map(BoardKind::title), Some("Dummy"));
    // Its profile says that it reads a byte of a plan in 0.1 ms.
    assert_eq!(remote.delivery(100) - before, 100 * u64::from(TICK_HZ) / 10_000);
    let mut driven = Driven::on_board(&prepared, remote, None).unwrap();
    // Pin 30 is none of the Uno's or the Pico's.
    let step = driven.lines.iter().position(|line| line.names.contains(&"a.step".to_owned())).unwrap();
    let mut rises = 0;
    driven.run(&mut |edge: Edge| rises += u64::from(edge.level && usize::from(edge.line) == step), |_| {}).unwrap();
    let lateness = driven.lateness().expect("a model's pins are seen");
    // Two cycles of amplitude A, each from 0 to 2 A and back.
    assert_eq!((lateness.edges, lateness.lost, lateness.extra), (8 * (900 + 400), 0, 0));
    assert_eq!((lateness.min_ticks, lateness.max_ticks), (0, 0));
    assert_eq!(rises, 8 * 900);
    assert_eq!(driven.board_mut().positions(), [0, 0]);
}

#[test]
fn a_board_without_an_emulated_chip_has_no_virtual_one() {
    let kind = BoardKind::of(&DUMMY_DEVICE);
    assert_eq!(BoardKind::named("dummy"), None);
    let refused = Driven::on_virtual(kind, &prepared("30").unwrap(), kind.usual_baud()).err().unwrap();
    assert!(matches!(refused, DriveError::NoVirtualBoard { board: "Dummy" }), "{refused}");
}
