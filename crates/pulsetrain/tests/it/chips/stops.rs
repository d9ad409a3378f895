//! Stops at any instant of random motions, by a cut cable and by the host. Motors come to rest within their limits, and
//! their counts agree with the host's replay.
//!
//! On the virtual Uno and Pico, and, as `native`, on core's stepgen behind a modelled line. A usual run tries a few
//! instants. `PULSETRAIN_ROUNDS=n` tries n times as many; `cargo xtask soak --stops N` sets it.

use crate::common::rigs::{self, check_limits, counts};
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Port, PortError};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::boards;
use pulsetrain_plan::SOFTEST_STOP_S;
use pulsetrain_session::drive::connect_as;
use pulsetrain_session::prepare::{Prepared, usual_baud};
use pulsetrain_session::{Session, SessionError};
use pulsetrain_testkit::Random;
use pulsetrain_testkit::model::ModelPort;
use pulsetrain_testkit::seed::{rounds, seed};
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// Number of instants of a usual run, on each board.
const CUTS: u64 = 4;
const STOPS: u64 = 6;

/// Motors begin to brake within half a second of the cut. Then they brake.
const LEASE: Duration = Duration::from_millis(600);

/// A cable to a board that may be cut at an instant. Its clones share one state.
struct Cable<P>(Arc<Mutex<Ends<P>>>);

impl<P> Clone for Cable<P> {
    fn clone(&self) -> Cable<P> {
        Cable(Arc::clone(&self.0))
    }
}

struct Ends<P> {
    port: P,
    cut: Option<Duration>,
}

impl<P: Port> Ends<P> {
    fn is_cut(&self) -> bool {
        self.cut.is_some_and(|cut| self.port.now() >= cut)
    }

    /// Lets the board's time pass without a host.
    fn run(&mut self, until: Duration) {
        while self.port.now() < until {
            self.port.receive(until, &mut Vec::new()).expect("a virtual port is always there");
        }
    }
}

fn gone() -> PortError {
    PortError::Gone { name: "the port".to_owned(), why: "No such device".to_owned() }
}

impl<P: Port> Port for Cable<P> {
    fn now(&self) -> Duration {
        self.0.lock().unwrap().port.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        let mut ends = self.0.lock().unwrap();
        if ends.is_cut() { Err(gone()) } else { ends.port.send(bytes) }
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let mut ends = self.0.lock().unwrap();
        let soon = ends.cut.map_or(until, |cut| until.min(cut));
        ends.port.receive(soon, into)?;
        if ends.is_cut() {
            // The host's time passes all the same.
            ends.run(until);
            return Err(gone());
        }
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.0.lock().unwrap().port.set_baud(baud)
    }
}

/// A board for the stops.
struct Stopped<P> {
    name: &'static str,
    /// Its name in the table of boards.
    board: &'static str,
    fresh: fn() -> P,
}

const UNO: Stopped<VirtualUno> = Stopped { name: "uno", board: "uno", fresh: VirtualUno::new };
const PICO: Stopped<VirtualPico> = Stopped { name: "pico", board: "pico", fresh: VirtualPico::on_usb };
/// A board with an Uno's clock and queues.
const NATIVE: Stopped<ModelPort> = Stopped { name: "native", board: "uno", fresh: ModelPort::new };

impl<P: Port> Stopped<P> {
    /// The motions of a seed.
    fn random(&self, seed: u64) -> Random {
        Random::new(seed.wrapping_mul(1000).wrapping_add(self.name.len() as u64))
    }

    /// The greatest delay of an edge, ticks.
    fn late(&self) -> f64 {
        boards::find(self.board).map_or(0.0, |row| f64::from(row.lateness_ticks))
    }

    /// Cuts the cable at any instant of a random motion.
    fn cut(&self, seed: u64) -> Result<(), String> {
        let mut random = self.random(seed);
        let prepared = rigs::motion(self.board, &mut random);
        let program = &prepared.program;
        let cable = Cable(Arc::new(Mutex::new(Ends { port: (self.fresh)(), cut: None })));
        let board = connect_as(cable.clone(), program, usual_baud(self.board), 1).map_err(|error| error.to_string())?;
        let mut session = Session::new(board, program.clone()).map_err(|error| error.to_string())?;
        let at = Duration::from_secs_f64(prepared.end_s() * random.fraction());
        let cut = cable.now() + at;
        cable.0.lock().unwrap().cut = Some(cut);
        let report = session.run(&mut |_: Edge| {}, |_| {});
        let mut ends = cable.0.lock().unwrap();
        ends.run(cut + LEASE + longest_stop(&prepared));
        let mut edges = Vec::new();
        ends.port.edges(&mut edges);
        let steps = rigs::steps(program, &edges);
        let made = counts(&steps);
        let of = || format!("{} motors, cut {:.6} s after the start", steps.len(), at.as_secs_f64());
        match &report.failure {
            // The host had sent the whole motion.
            None => {}
            Some(SessionError::Lost(_)) => {}
            Some(error) => return Err(format!("{}: {error}", of())),
        }
        if report.replayed != made && !report.replayed_otherwise.contains(&made) {
            let (told, or) = (report.replayed, report.replayed_otherwise);
            return Err(format!("{}: the pins counted {made:?}, replayed {told:?} or {or:?}", of()));
        }
        check_limits(program, &steps, self.late()).map_err(|why| format!("{}: {why}", of()))
    }

    /// Stops the motors at any instant of a random motion. Gives how long it took from the call to the tick from which
    /// they brake, s. `None` if they had to brake there anyhow.
    fn stop(&self, seed: u64) -> Result<Option<f64>, String> {
        let mut random = self.random(seed);
        let prepared = rigs::motion(self.board, &mut random);
        let program = &prepared.program;
        let hz = program.board.tick_hz;
        let text = |error: SessionError| error.to_string();
        let board =
            connect_as((self.fresh)(), program, usual_baud(self.board), 1).map_err(|error| error.to_string())?;
        let mut session = Session::new(board, program.clone()).map_err(text)?;
        let at = (prepared.end_s() * hz as f64 * random.fraction()) as u64;
        let mut edges = Vec::new();
        let mut note = |edge: Edge| edges.push(edge);
        session.advance(session.zero() + at, &mut note).map_err(text)?;
        let called = session.board().now();
        let goes_on = session.last_step().is_some_and(|last| last > called);
        let brakes = session.stop().map_err(text)?;
        let report = session.run(&mut note, |_| {});
        let steps = rigs::steps(program, &edges);
        let of = || format!("{} motors, stopped {:.6} s after the start", steps.len(), at as f64 / hz as f64);
        if let Some(error) = &report.failure {
            return Err(format!("{}: {error}", of()));
        }
        let made = counts(&steps);
        if (&report.replayed, &report.counted) != (&made, &made) {
            let (told, said) = (report.replayed, report.counted);
            return Err(format!("{}: the pins counted {made:?}, replayed {told:?}, the board says {said:?}", of()));
        }
        check_limits(program, &steps, self.late()).map_err(|why| format!("{}: {why}", of()))?;
        Ok(goes_on.then(|| brakes.saturating_sub(called) as f64 / hz as f64))
    }
}

/// A stop takes 1.39 to 2 times the distance of an ideal stop.
fn longest_stop(prepared: &Prepared) -> Duration {
    let planned = prepared.plan(|_| {}).expect("it was accepted");
    let motors = planned.iter().zip(&prepared.program.motors);
    let seconds = motors.map(|(planned, motor)| {
        let peak = planned.certificate.peak_speed.0;
        let limit = motor.limits.max_acceleration.unwrap_or((0.8 * peak / SOFTEST_STOP_S).max(1.0));
        3.0 * peak / limit + 2.0 / limit.sqrt()
    });
    Duration::from_secs_f64(seconds.fold(0.0, f64::max))
}

fn cuts<P: Port>(board: &Stopped<P>) {
    let (first, count) = (seed(1), CUTS * rounds());
    for seed in (first..).take(count as usize) {
        board.cut(seed).unwrap_or_else(|why| panic!("{}, PULSETRAIN_SEED={seed}: {why}", board.name));
    }
    println!("{count} cuts on {}: all stopped within limits, counts as replayed", board.name);
}

/// Motors begin to brake within `within_ms` of the host's call.
fn stops<P: Port>(board: &Stopped<P>, within_ms: f64) {
    let (first, count) = (seed(1), STOPS * rounds());
    let took = (first..).take(count as usize).filter_map(|seed| {
        let took = board.stop(seed).unwrap_or_else(|why| panic!("{}, PULSETRAIN_SEED={seed}: {why}", board.name))?;
        Some((1e3 * took, seed))
    });
    let mut took: Vec<_> = took.collect();
    took.sort_by(|one, other| one.0.total_cmp(&other.0));
    let (longest, of) = took.last().copied().unwrap_or_default();
    let (tried, median) = (took.len(), took.get(took.len() / 2).map_or(0.0, |(ms, _)| *ms));
    println!(
        "{tried} stops by the host on {}: motors brake {longest:.2} ms after the call at most, median {median:.2} ms; all within limits, \
         counts as replayed",
        board.name
    );
    assert!(longest <= within_ms, "{}, PULSETRAIN_SEED={of}: {longest:.2} ms, {within_ms} allowed", board.name);
}

#[test]
fn a_cut_cable_stops_an_uno_as_replayed() {
    cuts(&UNO);
}

#[test]
fn a_cut_cable_stops_a_pico_as_replayed() {
    cuts(&PICO);
}

#[test]
fn a_cut_cable_stops_the_native_board_as_replayed() {
    cuts(&NATIVE);
}

#[test]
fn an_uno_brakes_soon_after_the_hosts_call() {
    stops(&UNO, 10.0);
}

#[test]
fn a_pico_brakes_soon_after_the_hosts_call() {
    stops(&PICO, 5.0);
}
