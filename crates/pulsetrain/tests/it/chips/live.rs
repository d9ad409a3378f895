//! Live motions on the virtual Uno: the real firmware.

use crate::live::{Stage, TEXT, one_change, staged, together};
use pulsetrain::live::{LiveEvent, Show};
use pulsetrain_board::registry::Role;
use pulsetrain_board::{BoardKind, Edge, Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use pulsetrain_session::drive::{Driven, connect_as};
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn kind() -> BoardKind {
    BoardKind::named("uno").unwrap()
}

/// The same lines at the same ticks make the same edges; a limit is found on the way, and a cue follows another.
#[test]
fn the_same_lines_make_the_same_edges() {
    let edges = |speed: &str| {
        let (desk, mut prepared) = staged(TEXT);
        prepared.over_line(None);
        let driven = Driven::on_virtual(kind(), &prepared, Baud::B1M).unwrap();
        let mut stage = Stage::new(Show::new(driven, desk, true));
        stage.run(0.4);
        assert!(stage.line(speed));
        stage.run(0.05);
        assert!(stage.line("b.frequency 50 Hz"));
        stage.run(0.6);
        assert!(stage.line("go"));
        stage.run(2.5);
        stage.stop();
        let live = stage.happened.iter().filter(|happened| matches!(happened, pulsetrain::live::Happened::Live(_)));
        (stage.edges.clone(), live.count())
    };
    let (first, answers) = edges("speed 2 Hz");
    assert!(first.len() > 400 && answers >= 3, "{} edges, {answers} answers", first.len());
    let (second, _) = edges("speed 2 Hz");
    assert!(first == second);
    assert!(first != edges("speed 1.5 Hz").0, "they can differ");
}

/// What comes together begins at its tick on the board, too, and makes the same edges again.
#[test]
fn a_group_for_a_time_begins_at_its_tick() {
    let edges = || {
        let (desk, mut prepared) = staged(TEXT);
        prepared.over_line(None);
        let driven = Driven::on_virtual(kind(), &prepared, Baud::B1M).unwrap();
        let mut stage = Stage::new(Show::new(driven, desk, true));
        stage.run(0.4);
        stage.ask(together(&["a.swing 20 step", "b.frequency 1.5 Hz", "tempo 0.8"], Some(0.7)));
        let (from_s, ..) = one_change(&mut stage, 2);
        assert!((from_s - 0.7).abs() < 2.0 / 16e6, "{from_s}");
        stage.run(1.0);
        stage.stop();
        stage.edges
    };
    let first = edges();
    assert!(first.len() > 100 && first == edges(), "{} edges", first.len());
}

/// A port whose host sleeps when it is told to.
struct Sleepy {
    board: Box<dyn VirtualBoard>,
    asleep: Arc<Mutex<Duration>>,
}

impl Port for Sleepy {
    fn now(&self) -> Duration {
        self.board.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.board.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let asleep = std::mem::take(&mut *self.asleep.lock().unwrap());
        let woken = self.board.now() + asleep;
        while self.board.now() < woken {
            self.board.receive(woken, into)?;
        }
        if asleep > Duration::ZERO { Ok(()) } else { self.board.receive(until, into) }
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.board.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.board.edges(into);
    }
}

/// A host that was too slow: the motors brake, join the motion again, and no step is lost. Twice.
#[test]
fn motors_join_the_motion_again_after_the_host_was_too_slow() {
    let asleep = Arc::new(Mutex::new(Duration::ZERO));
    let (desk, mut prepared) = staged(TEXT);
    prepared.over_line(None);
    let port = Sleepy { board: kind().virtual_board(Role::Plans), asleep: Arc::clone(&asleep) };
    let driven = Driven::with(&prepared, |program| connect_as(port, program, Baud::B1M, 1)).unwrap();
    let mut stage = Stage::new(Show::new(driven, desk, true));
    for times in 1..=2 {
        stage.run(1.3);
        *asleep.lock().unwrap() = Duration::from_millis(900);
        match stage.answer() {
            LiveEvent::Rejoined { from_s, until_s, times: told } => {
                assert!(told == times && from_s < until_s, "{told}: {from_s} to {until_s}");
            }
            other => panic!("{other:?}"),
        }
        assert!(stage.line("a.swing 30 step"));
        assert!(matches!(stage.answer(), LiveEvent::Set { .. }));
    }
    stage.run(2.0);
    // The board's counts are those of the host, or this is an error.
    assert!(stage.stop().stopped);
}
