//! A program that drives a board through the library: it follows a law for a while, asks for the motor's position, and
//! stops it.
//!
//! ```console
//! $ cargo run --release --example embed                    # the virtual Uno: the firmware's bytes on an emulated chip
//! $ cargo run --release --example embed -- /dev/ttyACM0    # a real one
//! ```

use std::error::Error;

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Edge, Port, Serial};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::file;
use pulsetrain_session::Session;
use pulsetrain_session::drive::connect;

/// The motion as a file. A program may also build it from `pulsetrain_motion`'s types.
const MOTION: &str = r#"
board = "uno"
tolerance = "1 us"

[motor.pendulum]
steps_per_rev = 200
microsteps = 8
driver = "A4988"
pins = { step = 8, dir = 9 }
forward = "high"
max_acceleration = "20 rev/s^2"

[[motion]]
motor = "pendulum"
law.sine = { amplitude = "45 deg", period = "2 s" }
"#;

/// The result of the swing.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Outcome {
    /// Where the motor should be when the stop is sent, steps.
    pub(crate) when_told: i64,
    /// Where the motor came to rest by the board's report, steps.
    pub(crate) at_rest: i64,
    /// Rising edges of STEP. None are known of a real board.
    pub(crate) pulses: u64,
}

/// Lets a pendulum swing for 1.3 s, and stops it within its limits.
///
/// # Errors
/// If the board is not there, refuses, or is lost. Each error says what to do.
pub(crate) fn swing<P: Port>(port: P) -> Result<Outcome, Box<dyn Error>> {
    let no_other_file = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let program = file::read(MOTION, "pendulum", &no_other_file)?;
    let board = connect(port, &program, Baud::B1M)?;
    println!("firmware {:?}, {} ticks a second", board.info().firmware, board.info().tick_hz);

    // From here on the motors move under a lease: if the cable is pulled, they brake within their limits from its end.
    let mut session = Session::new(board, program.clone())?;
    let mut pulses = 0;
    let mut on_pins = |edge: Edge| pulses += u64::from(edge.line == 8 && edge.level);
    let told = session.zero() + program.board.tick_hz * 13 / 10;
    session.advance(told, &mut on_pins)?;
    let when_told = session.count_at(0, told).unwrap_or_default();
    let theta = session.state(0, session.earliest())?.theta;
    println!("at 1.3 s: {when_told} steps; where it can be told first the law says {theta:.1}");

    session.stop()?;
    let report = session.run(&mut on_pins, |_| {});
    if let Some(failure) = report.failure {
        return Err(failure.into());
    }
    println!("at rest at {} steps", report.counted[0]);
    session.into_board().close();
    Ok(Outcome { when_told, at_rest: report.counted[0], pulses })
}

fn main() -> Result<(), Box<dyn Error>> {
    match std::env::args().nth(1) {
        Some(port) => swing(Serial::open(&port, false)?)?,
        None => swing(VirtualUno::new())?,
    };
    Ok(())
}
