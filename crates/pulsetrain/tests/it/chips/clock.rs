//! A board whose clock is off by half a percent, in simulated time: `run --clock-ppm` corrects it, by the host's clock.

use pulsetrain::load;
use std::path::Path;

use pulsetrain_board::skewed::Skewed;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, RemoteError};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards;
use pulsetrain_motion::boards::uno::PinKind;
use pulsetrain_session::drive::Driven;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_trace::verdict::{self, Align, Options, Report};
use pulsetrain_trace::{Edge as Traced, Trace};

fn prepared() -> Prepared {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/tutorial-3s.toml");
    load::load(&file, Some("uno"), None).unwrap()
}

/// A run on a board whose clock is `off` ppm fast, planned for a clock that is `planned` ppm fast, with times by the
/// host's clock.
fn judged(off: i32, planned: f64) -> Report {
    let law = prepared();
    let mut prepared = prepared();
    prepared.calibrate(planned);
    let port = Skewed::new(VirtualUno::new(), off);
    let mut driven = Driven::at(&prepared, port, Baud::B1M).unwrap();
    let lines = driven.lines.clone();
    let mut edges = Vec::new();
    driven
        .run(&mut |edge: Edge| edges.push(Traced { tick: edge.tick, line: edge.line, level: edge.level }), |_| {})
        .unwrap();
    // A tick of that board is shorter than its nominal length.
    let tick_hz = (16_000_000.0 * (1.0 + f64::from(off) * 1e-6)).round() as u64;
    let late = boards::find("uno").unwrap().lateness_ticks;
    let options = Options {
        align: Align::Start,
        bound_ticks: Some(law.program.tolerance.ticks(16_000_000) + f64::from(late)),
        constant_ticks: PinKind::of(&law.program.motors).unwrap().constant_ticks().into(),
        ..Options::default()
    };
    verdict::judge(&Trace { tick_hz, lines, edges }, &law.program, &options).unwrap()
}

#[test]
fn a_clock_that_is_known_is_corrected_for() {
    for off in [5000, -5000] {
        let verdict = judged(off, f64::from(off));
        assert!(verdict.ok, "{off}: {verdict:?}");
        assert_eq!(verdict.motors[0].steps_got, 8000);
    }
    let verdict = judged(5000, 0.0);
    assert!(!verdict.ok, "without it every step is early");
}

#[test]
fn a_board_of_another_kind_is_not_a_clock_that_is_off() {
    let mut prepared = prepared();
    prepared.program.board.tick_hz = 20_000_000;
    let error = Driven::at(&prepared, VirtualUno::new(), Baud::B1M).err().expect("refused");
    assert!(
        matches!(
            error,
            pulsetrain_session::drive::DriveError::Remote(RemoteError::OtherBoard { wanted_hz: 20_000_000, .. })
        ),
        "{error}"
    );
}
