//! Live motions on the virtual Uno and Pico: the real firmware.

use crate::live::{Stage, TEXT, one_change, staged, together};
use pulsetrain::live::{LiveRun, RunEvent};
use pulsetrain_board::profiles::Role;
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
        let (setpoints, mut prepared) = staged(TEXT);
        prepared.over_line(None);
        let driven = Driven::on_virtual(kind(), &prepared, Baud::B1M).unwrap();
        let mut stage = Stage::new(LiveRun::new(driven, setpoints, true));
        stage.run(0.4);
        assert!(stage.line(speed));
        stage.run(0.05);
        assert!(stage.line("b.frequency 50 Hz"));
        stage.run(0.6);
        assert!(stage.line("go"));
        stage.run(2.5);
        stage.stop();
        let live = stage.happened.iter().filter(|event| !event.is_of_session());
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
        let (setpoints, mut prepared) = staged(TEXT);
        prepared.over_line(None);
        let driven = Driven::on_virtual(kind(), &prepared, Baud::B1M).unwrap();
        let mut stage = Stage::new(LiveRun::new(driven, setpoints, true));
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
    let (setpoints, mut prepared) = staged(TEXT);
    prepared.over_line(None);
    let port = Sleepy { board: kind().virtual_board(Role::Plans).unwrap(), asleep: Arc::clone(&asleep) };
    let driven = Driven::with(&prepared, |program| connect_as(port, program, Baud::B1M, 1)).unwrap();
    let mut stage = Stage::new(LiveRun::new(driven, setpoints, true));
    for times in 1..=2 {
        stage.run(1.3);
        *asleep.lock().unwrap() = Duration::from_millis(900);
        match stage.answer() {
            RunEvent::Rejoined { from_s, until_s, times: told } => {
                assert!(told == times && from_s < until_s, "{told}: {from_s} to {until_s}");
            }
            other => panic!("{other:?}"),
        }
        assert!(stage.line("a.swing 30 step"));
        assert!(matches!(stage.answer(), RunEvent::Set { .. }));
    }
    stage.run(2.0);
    // The board's counts are those of the host, or this is an error.
    assert!(stage.stop().stopped);
}

/// The host was too slow just as it was asked to stop: the motors have braked, and do not join the motion again.
#[test]
fn a_stop_ends_the_motion_although_the_host_was_too_slow() {
    let asleep = Arc::new(Mutex::new(Duration::ZERO));
    let (setpoints, mut prepared) = staged(TEXT);
    prepared.over_line(None);
    let port = Sleepy { board: kind().virtual_board(Role::Plans).unwrap(), asleep: Arc::clone(&asleep) };
    let driven = Driven::with(&prepared, |program| connect_as(port, program, Baud::B1M, 1)).unwrap();
    let mut stage = Stage::new(LiveRun::new(driven, setpoints, true));
    stage.run(1.3);
    *asleep.lock().unwrap() = Duration::from_millis(900);
    stage.ask(together(&["a.swing 20 step", "stop"], None));
    assert!(matches!(stage.answer(), RunEvent::Refused { .. }));
    stage.run(10.0);
    let joined = |happened: &RunEvent| matches!(happened, RunEvent::Rejoined { .. });
    assert!(stage.ended.is_some() && !stage.happened.iter().any(joined));
}

/// Processes: a live motion at a cable that is pulled and plugged in again. Nothing depends on how long something takes.
#[cfg(unix)]
mod cable {
    use crate::live::TEXT;
    use crate::live::processes::Live;
    use pulsetrain_testkit::folder::Folder;
    use serialport::{SerialPort, TTYPort};
    use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
    use std::os::unix::fs::symlink;
    use std::path::{Path, PathBuf};
    use std::process::{Child, Command, Stdio};
    use std::sync::mpsc::{Receiver, Sender, channel};
    use std::thread;
    use std::time::Duration;

    /// A virtual board in another process, which does not restart when its port is opened at the other end of the cable.
    struct Board(Child);

    impl Board {
        fn new(name: &str, link: &Path) -> Board {
            let _ = std::fs::remove_file(link);
            let mut command = Command::new(env!("CARGO_BIN_EXE_pulsetrain"));
            command.args(["board", name, "--pty"]).arg(link).stdout(Stdio::piped());
            let mut child = command.spawn().unwrap();
            let mut line = String::new();
            BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
            assert!(line.starts_with("a virtual ") && line.contains(" is at"), "{line}");
            Board(child)
        }
    }

    impl Drop for Board {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    /// A cable from a board's port to a link, which goes when it is pulled.
    struct Cable {
        orders: Sender<bool>,
        done: Receiver<()>,
        link: PathBuf,
    }

    impl Cable {
        fn new(board: &Path, link: &Path) -> Cable {
            let port = serialport::new(board.display().to_string(), 115_200).timeout(Duration::from_millis(1));
            let board = TTYPort::open(&port).unwrap();
            let (orders, ordered) = channel();
            let (says, done) = channel();
            let cable = Cable { orders, done, link: link.to_owned() };
            let link = link.to_owned();
            thread::spawn(move || {
                // The test may be over.
                drop(carry(board, &link, &ordered, &says));
            });
            cable.plug();
            cable
        }

        fn plug(&self) {
            self.orders.send(true).unwrap();
            self.done.recv().unwrap();
            assert!(self.link.is_symlink());
        }

        fn pull(&self) {
            self.orders.send(false).unwrap();
            self.done.recv().unwrap();
        }
    }

    /// Carries bytes both ways, and the rate to the board. The waits of the reads set its pace.
    fn carry(
        mut board: TTYPort,
        link: &Path,
        ordered: &Receiver<bool>,
        says: &Sender<()>,
    ) -> Result<(), Box<dyn std::error::Error>> {
        let mut host: Option<TTYPort> = None;
        let mut rate = 0;
        let mut buffer = [0; 4096];
        loop {
            match ordered.try_recv() {
                Ok(true) => {
                    let (mut master, client) = TTYPort::pair()?;
                    master.set_timeout(Duration::from_millis(1))?;
                    symlink(client.name().ok_or("no name")?, link)?;
                    host = Some(master);
                    says.send(())?;
                }
                Ok(false) => {
                    std::fs::remove_file(link)?;
                    drop(host.take());
                    says.send(())?;
                }
                Err(std::sync::mpsc::TryRecvError::Disconnected) => return Ok(()),
                Err(std::sync::mpsc::TryRecvError::Empty) => {}
            }
            if let Ok(len) = board.read(&mut buffer)
                && let Some(host) = &mut host
            {
                // The port must be closed.
                let _ = host.write_all(&buffer[..len]);
            }
            let Some(host) = &mut host else { continue };
            if let Ok(wanted) = host.baud_rate()
                && wanted != rate
            {
                board.set_baud_rate(wanted)?;
                rate = wanted;
            }
            if let Ok(len) = host.read(&mut buffer) {
                let mut rest = &buffer[..len];
                while !rest.is_empty() {
                    // On a busy computer the board's process may not read for a while.
                    match board.write(rest) {
                        Ok(len) => rest = &rest[len..],
                        Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => {}
                        Err(error) => return Err(error.into()),
                    }
                }
            }
        }
    }

    #[test]
    fn motors_join_the_motion_again_after_the_cable_was_pulled_and_nobody_guesses_after_a_reset() {
        let folder = Folder::new("live-cable");
        let (board_link, link) = (folder.0.join("board"), folder.0.join("port"));
        let mut board = Board::new("uno", &board_link);
        let cable = Cable::new(&board_link, &link);
        let arguments = ["--port", "port", "--quiet", "--no-rehearsal"];
        let mut live = Live::begin(&folder, &arguments);
        live.say("a.swing 20 step");
        live.until("a.swing is 20 step");
        cable.pull();
        live.until("the board cannot be reached");
        live.say("pause");
        live.until("the board cannot be reached, or the positions of the motors are not known");
        cable.plug();
        live.until("join the motion again from");
        live.say("a.swing 30 step");
        live.until("a.swing is 30 step");
        live.say("goto 0");
        live.until("goto 0 from");
        assert_eq!(live.stop(), Some(0));
        // The board goes on counting: another process knows where the motors stand.
        let mut live = Live::again(&folder, &[&arguments[..], &["--resume"]].concat());
        live.until("join the motion again from");
        live.say("a.swing 30 step");
        live.until("a.swing is 30 step");
        // The power fails. What is at the port then has counted nothing.
        cable.pull();
        live.until("the board cannot be reached");
        drop(cable);
        drop(board);
        board = Board::new("uno", &board_link);
        let cable = Cable::new(&board_link, &link);
        live.until("the position of a, b is not known");
        live.say("a.swing 20 step");
        live.until("refused: a.swing 20 step");
        live.say("here c 0 deg");
        live.until("there is no motor `c`");
        live.say("here a 9 deg");
        live.until("a at 9 deg: noted");
        live.say("here b 0 deg");
        live.until("join the motion again from");
        live.say("here 0 deg");
        live.until("the motors' positions are known");
        assert_eq!(live.stop(), Some(0));
        let mut live = Live::again(&folder, &[&arguments[..], &["--no-rejoin"]].concat());
        live.say("a.swing 20 step");
        live.until("a.swing is 20 step");
        cable.pull();
        assert_eq!(live.end(), Some(3));
        drop(board);
    }

    /// A Pico goes on counting without a host, too: the motors brake, and join the motion again from where they stand.
    #[test]
    fn motors_on_a_pico_join_the_motion_again_after_the_cable_was_pulled() {
        let folder = Folder::new("live-pico-cable");
        let (board_link, link) = (folder.0.join("board"), folder.0.join("port"));
        let board = Board::new("pico", &board_link);
        let cable = Cable::new(&board_link, &link);
        std::fs::write(folder.0.join("m.toml"), TEXT.replace("board = \"uno\"", "board = \"pico\"")).unwrap();
        let arguments = ["--port", "port", "--quiet"];
        let mut live = Live::again(&folder, &arguments);
        for times in 1..=2 {
            live.say("a.swing 20 step");
            live.until("a.swing is 20 step");
            cable.pull();
            live.until("the board cannot be reached");
            cable.plug();
            let rejoined = live.until("join the motion again from");
            assert!(rejoined.contains(&format!("({times} so far)")), "{rejoined}");
            live.say("a.swing 30 step");
            live.until("a.swing is 30 step");
        }
        live.say("goto 0");
        live.until("goto 0 from");
        assert_eq!(live.stop(), Some(0));
        // Its counts are those of the board: another process knows where the motors stand.
        let mut live = Live::again(&folder, &[&arguments[..], &["--resume"]].concat());
        live.until("join the motion again from");
        assert_eq!(live.stop(), Some(0));
        drop(board);
    }
}
