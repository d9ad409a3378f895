//! A virtual Uno for any serial client: through memory in virtual time, and through a pseudo-terminal and a socket.

use std::io;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pulsetrain::serve::{Client, Service};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Port, PortError, Remote};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_motion::program::Program;
use pulsetrain_motion::{boards::uno::PinKind, file};
use pulsetrain_session::Session;
use pulsetrain_session::drive::connect;
use pulsetrain_trace::vcd_file;
use pulsetrain_trace::verdict::{self, Align, Options};

const MOTION: &str = r#"
board = "uno"
tolerance = "1 us"

[motor.wheel]
steps_per_rev = 200
driver = "A4988"
pins = { step = 8, dir = 9 }
forward = "high"
max_acceleration = "50 rev/s^2"

[[motion]]
motor = "wheel"
law.sine = { amplitude = "0.5 rev", period = "1 s", cycles = 1 }
"#;

fn program() -> Program {
    program_for("uno")
}

/// The motion on another board.
fn program_for(board: &str) -> Program {
    let text = MOTION.replace("uno", board);
    file::read(&text, "wheel.toml", &|_| Err(io::ErrorKind::NotFound.into())).unwrap()
}

/// The bytes between client and board.
#[derive(Default)]
struct Between {
    present: bool,
    to_board: Vec<u8>,
    to_client: Vec<u8>,
    rate: u32,
}

/// The board's end.
#[derive(Clone, Default)]
struct Pipe(Arc<Mutex<Between>>);

impl Client for Pipe {
    fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool> {
        let mut between = self.0.lock().unwrap();
        into.append(&mut between.to_board);
        Ok(between.present)
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap().to_client.extend_from_slice(bytes);
        Ok(())
    }

    fn rate(&self) -> Option<u32> {
        Some(self.0.lock().unwrap().rate)
    }
}

/// A file in memory.
#[derive(Clone, Default)]
struct Memory(Arc<Mutex<Vec<u8>>>);

impl io::Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().unwrap().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// The client's end. Time passes while the client waits, a millisecond each round.
struct Through {
    service: Service<VirtualUno, Pipe, Memory>,
    pipe: Pipe,
}

impl Through {
    fn new(trace: Option<Memory>) -> Through {
        Through::to(VirtualUno::new(), trace)
    }

    fn to(uno: VirtualUno, trace: Option<Memory>) -> Through {
        let pipe = Pipe::default();
        *pipe.0.lock().unwrap() = Between { present: true, rate: 115_200, ..Between::default() };
        Through { service: Service::new(uno, pipe.clone(), trace).unwrap(), pipe }
    }

    fn rounds(&mut self, rounds: u32) {
        for _ in 0..rounds {
            self.service.round(self.service.now() + Duration::from_millis(1)).unwrap();
        }
    }
}

impl Port for Through {
    fn now(&self) -> Duration {
        self.service.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.pipe.0.lock().unwrap().to_board.extend_from_slice(bytes);
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        while self.pipe.0.lock().unwrap().to_client.is_empty() && self.now() < until {
            let end = until.min(self.now() + Duration::from_millis(1));
            self.service.round(end).unwrap();
        }
        into.append(&mut self.pipe.0.lock().unwrap().to_client);
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.pipe.0.lock().unwrap().rate = baud.rate();
        Ok(())
    }
}

#[test]
fn a_client_runs_a_motion_and_the_trace_shows_it() {
    let program = program();
    let memory = Memory::default();
    let board = connect(Through::new(Some(memory.clone())), &program, Baud::B500k).unwrap();
    assert_eq!(board.link().baud(), Baud::B500k);
    let mut session = Session::new(board, program.clone()).unwrap();
    let report = session.run(&mut |_: Edge| {}, |_| {});
    assert_eq!((report.failure, report.counted), (None, vec![0]));
    let port = session.into_board().close();
    port.service.finish().unwrap();

    let trace = vcd_file::read(&memory.0.lock().unwrap()).unwrap();
    assert!(trace.lines.iter().any(|line| line.names.iter().any(|name| name.ends_with("pin8"))));
    let late = pulsetrain_motion::boards::find("uno").unwrap().lateness_ticks;
    let bound = program.tolerance.ticks(program.board.tick_hz) + f64::from(late);
    let constant_ticks = PinKind::of(&program.motors).unwrap().constant_ticks().into();
    let options = Options { align: Align::Start, bound_ticks: Some(bound), constant_ticks, ..Options::default() };
    let verdict = verdict::judge(&trace, &program, &options).unwrap();
    assert!(verdict.ok, "{verdict:?}");
    assert_eq!(verdict.motors[0].steps_got, 400);
}

/// A disk with some bytes of room.
struct Disk(usize);

impl io::Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 = self.0.checked_sub(bytes.len()).ok_or(io::ErrorKind::StorageFull)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_trace_that_has_no_room_is_named() {
    let pipe = Pipe::default();
    *pipe.0.lock().unwrap() =
        Between { present: true, rate: 115_200, to_board: b"a x 200\n".to_vec(), ..Between::default() };
    let ends = |room: usize| -> io::Result<()> {
        let mut service = Service::new(VirtualUno::with_winch(), pipe.clone(), Some(Disk(room)))?;
        while service.now() < Duration::from_secs(1) {
            service.round(service.now() + Duration::from_millis(10))?;
        }
        service.finish()
    };
    for room in [0, 1500] {
        let error = ends(room).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::StorageFull);
        assert!(error.to_string().contains("its trace cannot be written"), "{room}: {error}");
    }
}

#[test]
fn a_client_that_does_not_wait_is_heard() {
    let mut through = Through::to(VirtualUno::with_winch(), None);
    // The client sends when it opens the port, before the board has started: clients of StepperWinch do not wait for
    // `awake`.
    through.send(b"version\nd x 30\nd x 12\n").unwrap();
    through.rounds(1500);
    let text = String::from_utf8(through.pipe.0.lock().unwrap().to_client.clone()).unwrap();
    let lines: Vec<_> = text.lines().filter(|line| !line.starts_with("txyza")).collect();
    assert_eq!(lines, ["awake", "id StepperWinch Nov 21 2026"]);
    // It rings about 42.
    let positions = text.lines().filter_map(|line| line.strip_prefix("txyza ")?.split(' ').nth(1)?.parse().ok());
    let most: Option<i32> = positions.max();
    assert!(most.is_some_and(|most| (60..84).contains(&most)), "{text}");
}

#[test]
fn opening_again_resets_the_board() {
    let mut board = Remote::open(Through::new(None), 1).unwrap();
    let began = board.now();
    board.advance(began + 16_000_000, &mut |_: Edge| {});
    let mut port = board.close();
    assert_eq!(port.service.clients(), 1);
    port.pipe.0.lock().unwrap().present = false;
    port.rounds(5);
    *port.pipe.0.lock().unwrap() = Between { present: true, rate: 115_200, ..Between::default() };
    let board = Remote::open(port, 2).unwrap();
    assert_eq!(board.port().service.clients(), 2);
    assert_eq!(board.info().last_reset, Cause::ResetLine);
    assert!(board.now() < 16_000_000, "its clock restarted: {}", board.now());
}

/// Through the system's pseudo-terminals, but in virtual time: each end waits for the other's bytes, so the system may
/// take as long as it likes.
#[cfg(unix)]
mod pty {
    use super::{Memory, program, program_for, real::folder};
    use pulsetrain::serve::{Client, Pty, Service};
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_board::virtual_uno::VirtualUno;
    use pulsetrain_board::{Edge, Link, LinkError, Port, PortError, Remote, VirtualBoard};
    use pulsetrain_core::wire::Baud;
    use pulsetrain_core::wire::message::Cause;
    use pulsetrain_motion::program::Program;
    use pulsetrain_motion::{Law, Time};
    use pulsetrain_session::Session;
    use pulsetrain_session::drive::connect;
    use pulsetrain_trace::vcd_file;
    use serialport::{SerialPort, TTYPort};
    use std::io::{self, Read, Write};
    use std::path::{Path, PathBuf};
    use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
    use std::sync::{Arc, Mutex};
    use std::time::Duration;

    const ROUND: Duration = Duration::from_millis(1);

    /// Bytes that one end has written and the other has not read.
    #[derive(Default)]
    struct UnderWay {
        to_board: AtomicUsize,
        to_client: AtomicUsize,
    }

    /// The board's end.
    struct Counting {
        pty: Pty,
        under_way: Arc<UnderWay>,
    }

    impl Client for Counting {
        fn poll(&mut self, into: &mut Vec<u8>) -> io::Result<bool> {
            let left = &self.under_way.to_board;
            loop {
                let had = into.len();
                let present = self.pty.poll(into)?;
                left.fetch_sub(into.len() - had, Relaxed);
                if !present || left.load(Relaxed) == 0 {
                    return Ok(present);
                }
                std::thread::yield_now();
            }
        }

        fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.under_way.to_client.store(self.under_way.to_client.load(Relaxed) + bytes.len(), Relaxed);
            self.pty.send(bytes)
        }

        fn rate(&self) -> Option<u32> {
            self.pty.rate()
        }
    }

    /// A board with its client.
    struct Served<B> {
        service: Mutex<Service<B, Counting, Memory>>,
        under_way: Arc<UnderWay>,
        link: PathBuf,
        trace: Memory,
    }

    impl Served<VirtualUno> {
        fn new(link: PathBuf) -> Arc<Served<VirtualUno>> {
            Served::of(VirtualUno::new(), link)
        }
    }

    impl<B: VirtualBoard> Served<B> {
        fn of(board: B, link: PathBuf) -> Arc<Served<B>> {
            let (under_way, trace) = (Arc::new(UnderWay::default()), Memory::default());
            let client = Counting { pty: Pty::new(&link).unwrap(), under_way: Arc::clone(&under_way) };
            let service = Mutex::new(Service::new(board, client, Some(trace.clone())).unwrap());
            Arc::new(Served { service, under_way, link, trace })
        }

        fn rounds(&self, rounds: u32) {
            for _ in 0..rounds {
                self.round_until(self.now() + ROUND);
            }
        }

        fn round_until(&self, until: Duration) {
            self.service.lock().unwrap().round(until).unwrap();
        }

        fn now(&self) -> Duration {
            self.service.lock().unwrap().now()
        }

        fn clients(&self) -> u64 {
            self.service.lock().unwrap().clients()
        }

        fn leads_to(&self) -> PathBuf {
            std::fs::read_link(&self.link).unwrap()
        }

        /// Opens the link as `pulsetrain run --port LINK` does.
        fn open(self: &Arc<Served<B>>) -> Terminal<B> {
            self.open_at(&self.link)
        }

        fn open_at(self: &Arc<Served<B>>, name: &Path) -> Terminal<B> {
            let terminal = serialport::new(name.display().to_string(), 115_200).timeout(Duration::from_secs(3600));
            Terminal { terminal: terminal.open_native().unwrap(), served: Arc::clone(self) }
        }

        /// Ends it. Gives when the motion's STEP rose, s of the chip.
        fn steps(self: Arc<Served<B>>) -> Vec<f64> {
            self.rises("pin8")
        }

        /// Ends it. Gives when a pin rose, s of the chip.
        fn rises(self: Arc<Served<B>>, pin: &str) -> Vec<f64> {
            let Served { service, trace, .. } = Arc::into_inner(self).expect("no client has it");
            service.into_inner().unwrap().finish().unwrap();
            let trace = vcd_file::read(&trace.0.lock().unwrap()).unwrap();
            let is_step = |line: u8| trace.lines[usize::from(line)].names.iter().any(|name| name.ends_with(pin));
            let rises = trace.edges.iter().filter(|edge| edge.level && is_step(edge.line));
            rises.map(|edge| edge.tick as f64 / trace.tick_hz as f64).collect()
        }
    }

    /// The client's end. Time passes while the client waits.
    struct Terminal<B> {
        terminal: TTYPort,
        served: Arc<Served<B>>,
    }

    impl<B> Drop for Terminal<B> {
        fn drop(&mut self) {
            // Bytes that were not read by then are dropped.
            self.served.under_way.to_board.store(0, Relaxed);
            self.served.under_way.to_client.store(0, Relaxed);
        }
    }

    impl<B: VirtualBoard> Port for Terminal<B> {
        fn now(&self) -> Duration {
            self.served.now()
        }

        fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
            let to_board = &self.served.under_way.to_board;
            to_board.store(to_board.load(Relaxed) + bytes.len(), Relaxed);
            self.terminal.write_all(bytes).unwrap();
            Ok(())
        }

        fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
            while self.served.under_way.to_client.load(Relaxed) == 0 && self.now() < until {
                self.served.round_until(until.min(self.now() + ROUND));
            }
            let (had, came) = (into.len(), self.served.under_way.to_client.swap(0, Relaxed));
            into.resize(had + came, 0);
            self.terminal.read_exact(&mut into[had..]).unwrap();
            Ok(())
        }

        fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
            self.terminal.set_baud_rate(baud.rate()).unwrap();
            Ok(())
        }
    }

    #[test]
    fn one_client_after_the_other_runs_a_motion() {
        let folder = folder("pty-one-after-the-other");
        one_after_the_other(VirtualUno::new(), &program(), folder.join("uno"));
        one_after_the_other(VirtualPico::on_usb(), &program_for("pico"), folder.join("pico"));
    }

    fn one_after_the_other<B: VirtualBoard>(board: B, program: &Program, link: PathBuf) {
        let served = Served::of(board, link);
        for (clients, baud) in [(1, Baud::B115200), (2, Baud::B1M)] {
            let board = connect(served.open(), program, baud).unwrap();
            assert_eq!(board.link().baud(), baud);
            let mut session = Session::new(board, program.clone()).unwrap();
            let report = session.run(&mut |_: Edge| {}, |_| {});
            assert_eq!((report.failure, report.counted), (None, vec![0]));
            drop(session.into_board().close());
            assert_eq!(served.clients(), clients);
            served.rounds(1);
        }
        let link = served.link.clone();
        assert_eq!(served.steps().len(), 2 * 400);
        assert!(!link.is_symlink(), "the link is gone");
    }

    #[test]
    fn a_client_that_is_killed_leaves_the_motor_to_its_stop_and_the_board_to_the_next() {
        let mut program = program();
        // Longer than the board's queue lasts.
        program.motors[0].law = Law::sine(100.0, Time::SECOND, Some(10)).unwrap();
        let served = Served::new(folder("pty-killed").join("uno"));
        let board = connect(served.open(), &program, Baud::B1M).unwrap();
        let mut session = Session::new(board, program.clone()).unwrap();
        session.advance(session.zero() + 4_000_000, &mut |_: Edge| {}).unwrap();
        // The client closes without Bye.
        drop(session);
        served.rounds(3000);
        let ended = served.now().as_secs_f64();
        assert_eq!(Remote::open(served.open(), 2).unwrap().info().last_reset, Cause::ResetLine);
        assert_eq!(served.clients(), 2);
        let steps = served.steps();
        let [.., before, last] = steps[..] else { panic!("{} steps", steps.len()) };
        assert!((100..2000).contains(&steps.len()) && last < ended - 1.0, "{} steps, the last at {last}", steps.len());
        assert!(last - before > 0.002, "it slowed down: {} s between the last two steps", last - before);
    }

    #[test]
    fn whoever_followed_the_link_just_before_it_changed_is_served() {
        let served = Served::new(folder("pty-followed").join("uno"));
        let followed = served.leads_to();
        drop(Remote::open(served.open(), 1).unwrap());
        // Now the board's end sees that the client is gone, and gives the next client a terminal of its own.
        served.rounds(1);
        assert_ne!(served.leads_to(), followed);
        let board = Remote::open(served.open_at(&followed), 2).unwrap();
        assert_eq!((served.clients(), board.info().last_reset), (2, Cause::ResetLine));
        assert_ne!(served.leads_to(), followed, "to what is free");
        drop(board);
        served.rounds(1);
        Remote::open(served.open(), 3).unwrap().status().unwrap();
        assert_eq!(served.clients(), 3);
    }

    #[test]
    fn a_close_with_an_open_right_behind_it_is_seen() {
        let served = Served::of(VirtualUno::with_winch(), folder("pty-at-once").join("uno"));
        for clients in 1..5 {
            // The board has no round in between. An unfinished line of the client before must not become a part of this
            // client's line.
            let mut terminal = served.open();
            terminal.send(b"version\nping\na x 1").unwrap();
            served.rounds(100);
            assert_eq!(served.clients(), clients);
            let mut said = vec![0; served.under_way.to_client.swap(0, Relaxed)];
            terminal.terminal.read_exact(&mut said).unwrap();
            let said = String::from_utf8(said).unwrap();
            let lines: Vec<&str> = said.lines().filter(|line| !line.starts_with("txyza")).collect();
            assert!(matches!(lines[..], ["awake", id, "awake"] if id.starts_with("id ")), "{lines:?}");
        }
    }

    #[test]
    fn a_client_that_sets_no_rate_has_the_boards_first() {
        let link = folder("pty-rate").join("uno");
        let mut pty = Pty::new(&link).unwrap();
        for rate in [None, Some(1_000_000), None] {
            let mut plain = None;
            let mut terminal = None;
            match rate {
                Some(rate) => terminal = Some(serialport::new(link.display().to_string(), rate).open_native().unwrap()),
                None => plain = Some(std::fs::File::options().read(true).write(true).open(&link).unwrap()),
            }
            assert!(pty.poll(&mut Vec::new()).unwrap());
            assert_eq!(pty.rate(), rate.or(Some(115_200)));
            drop((plain, terminal));
            assert!(!pty.poll(&mut Vec::new()).unwrap());
        }
    }

    #[test]
    fn a_second_client_is_told_that_the_board_is_taken() {
        let served = Served::of(VirtualUno::with_winch(), folder("pty-second").join("uno"));
        let mut first = served.open();
        served.rounds(100);
        let mut second = serialport::new(served.leads_to().display().to_string(), 115_200)
            .timeout(Duration::from_secs(3600))
            .open_native()
            .unwrap();
        // The beginning of `pulsetrain info`.
        let mut link = Link::new(2);
        link.hello(served.now());
        let mut hello = Vec::new();
        link.output(served.now(), &mut hello);
        second.write_all(&hello).unwrap();
        let mut said = [0; 11];
        while second.bytes_to_read().unwrap() < 11 {
            served.rounds(1);
        }
        second.read_exact(&mut said).unwrap();
        assert_eq!(&said, b"err taken\r\n");
        link.input(&said, served.now());
        link.output(served.now() + Duration::from_secs(6), &mut hello);
        assert_eq!(link.error(), Some(LinkError::Taken));
        assert_eq!(served.clients(), 1);
        // When the first client goes, this one is served.
        first.send(b"ping\n").unwrap();
        served.rounds(20);
        drop(first);
        served.rounds(100);
        assert_eq!(served.clients(), 2);
        let mut said = vec![0; served.under_way.to_client.swap(0, Relaxed)];
        second.read_exact(&mut said).unwrap();
        assert_eq!(String::from_utf8(said).unwrap().lines().next(), Some("awake"));
        drop(second);
        assert_eq!(served.rises("pin2").len(), 0, "what it said before that is dropped");
    }

    #[test]
    fn a_link_that_leads_nowhere_is_made_anew_and_what_another_put_there_is_left() {
        let link = folder("pty-left").join("uno");
        std::os::unix::fs::symlink("/nowhere/at/all", &link).unwrap();
        let served = Served::new(link.clone());
        Remote::open(served.open(), 1).unwrap().status().unwrap();
        std::fs::remove_file(&link).unwrap();
        std::fs::write(&link, "mine").unwrap();
        drop(served);
        assert_eq!(std::fs::read_to_string(&link).unwrap(), "mine");
    }
}

/// Through the system, in real time: no test here depends on the system's speed.
#[cfg(unix)]
mod real {
    use pulsetrain::cli;
    use pulsetrain::console::Exit;
    use pulsetrain::serve::Paced;
    use pulsetrain::winch::talk::Talk;
    use pulsetrain_board::native_winch::NativeWinch;
    use pulsetrain_board::{Link, Port, Remote, Serial, Setup};
    use pulsetrain_core::verbs::Verb;
    use pulsetrain_core::wire::frame::Received;
    use pulsetrain_core::wire::message::{MotorSetup, version_of};
    use pulsetrain_core::wire::{Decoder, VERSION};
    use std::io::{BufRead, BufReader, Read, Write};
    use std::net::TcpStream;
    use std::path::{Path, PathBuf};
    use std::process::{Child, ChildStdout, Command, Stdio};
    use std::time::Duration;

    /// `pulsetrain board`, which ends with the test at the latest.
    struct Served {
        process: Child,
        out: BufReader<ChildStdout>,
    }

    impl Served {
        fn new(board: &str, arguments: &[&str]) -> (Served, String) {
            let mut process = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
                .args(["board", board])
                .args(arguments)
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            let mut out = BufReader::new(process.stdout.take().unwrap());
            let mut first = String::new();
            out.read_line(&mut first).unwrap();
            assert!(first.to_lowercase().contains(&format!("a virtual {board} is ")), "{first}");
            (Served { process, out }, first)
        }

        /// Sends Ctrl-C. Gives the last output.
        fn interrupt(mut self) -> String {
            let kill = Command::new("kill").args(["-INT", &self.process.id().to_string()]).status().unwrap();
            assert!(kill.success());
            assert_eq!(self.process.wait().unwrap().code(), Some(0));
            let mut said = String::new();
            self.out.read_to_string(&mut said).unwrap();
            said
        }
    }

    impl Drop for Served {
        fn drop(&mut self) {
            // If all went well it has ended already.
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }

    pub(super) fn folder(name: &str) -> PathBuf {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let _ = std::fs::remove_dir_all(&folder);
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn pulsetrain(arguments: &[&str]) -> (Exit, String) {
        let (mut out, mut err) = (Vec::new(), Vec::new());
        let exit = cli::run([&["pulsetrain"], arguments].concat(), &mut out, &mut err);
        (exit, String::from_utf8(out).unwrap() + &String::from_utf8(err).unwrap())
    }

    /// If the disk is full, the error comes after the report of the motors.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_run_whose_files_have_no_room_tells_where_the_motors_are() {
        let folder = folder("serve-full");
        let link = folder.join("uno").display().to_string();
        let (served, _) = Served::new("uno", &["--pty", &link]);
        let file = folder.join("short.toml");
        let text = "board = \"uno\"\n[motor.m]\nsteps_per_rev = 200\npulse_high = \"5 us\"\npins = { step = 8, dir = 9 }\n\
                    forward = \"high\"\n[[motion]]\nmotor = \"m\"\nlaw.trapezoid = { distance = \"7 step\", speed = \"40 step/s\", \
                    acceleration = \"4000 step/s^2\" }\n";
        std::fs::write(&file, text).unwrap();
        for name in ["steps.csv", "report.json"] {
            let out = folder.join(name.replace('.', "-"));
            std::fs::create_dir(&out).unwrap();
            std::os::unix::fs::symlink("/dev/full", out.join(name)).unwrap();
            let args = ["run", file.to_str().unwrap(), "--port", &link, "--out", out.to_str().unwrap()];
            let (exit, said) = pulsetrain(&args);
            assert_eq!(exit, Exit::Refused, "{said}");
            for part in ["7 steps from its start", "PASS", "cannot write", name, "the disk is full"] {
                assert!(said.contains(part), "{part} is not in {said}");
            }
            assert!(!said.contains("(as scheduled)"), "{said}");
            let (exit, said) = pulsetrain(&[&args[..], &["--json"]].concat());
            let (value, error) = said.split_at(said.rfind("}\n").map_or(0, |end| end + 2));
            let report: serde_json::Value = serde_json::from_str(value).expect("one value");
            crate::json::conforms("run", &report);
            assert_eq!((exit, &report["pass"]), (Exit::Refused, &true.into()), "{report}");
            assert!(
                error.contains(name) && report["unwritten"].as_str().is_some_and(|file| file.contains(name)),
                "{said}"
            );
        }
        served.interrupt();
    }

    #[test]
    fn a_socket_answers_hello() {
        says_hello_to("uno");
    }

    /// A program with the library and without a port: only its pins can be seen.
    #[test]
    fn a_pico_runs_the_program_that_is_given() {
        let image = concat!(env!("CARGO_MANIFEST_DIR"), "/../board/images/dds_circle.uf2");
        let trace = folder("image").join("pins.vcd");
        let arguments = ["--tcp", "127.0.0.1:0", "--image", image, "--trace", trace.to_str().unwrap()];
        let (served, first) = Served::new("pico", &arguments);
        // It sends nothing. Its coils are on from its start.
        let mut stream = connect(&first);
        stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
        assert!(stream.read(&mut [0]).is_err());
        served.interrupt();
        let pins = pulsetrain_trace::vcd_file::read(&std::fs::read(&trace).unwrap()).unwrap();
        let coils = (2..10).filter(|pin| {
            let is_coil =
                |line: u8| pins.lines[usize::from(line)].names.iter().any(|name| name.ends_with(&format!("pin{pin}")));
            pins.edges.iter().any(|edge| edge.level && is_coil(edge.line))
        });
        assert!(coils.count() >= 2);
        let (exit, said) = pulsetrain(&[
            "board",
            "pico",
            "--tcp",
            "127.0.0.1:0",
            "--image",
            concat!(env!("CARGO_MANIFEST_DIR"), "/Cargo.toml"),
        ]);
        assert!(exit != Exit::Success && said.contains("UF2"), "{said}");
    }

    /// A baked motion needs no host: only its pins can be seen.
    #[test]
    fn an_uno_runs_the_motion_that_was_baked() {
        let folder = folder("baked-uno");
        let path = |name: &str| folder.join(name).display().to_string();
        let (image, trace) = (path("motion.hex"), path("pins.vcd"));
        let motion = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
        let (exit, said) = pulsetrain(&["bake", motion, "--board", "uno", "--output", &image]);
        assert_eq!(exit, Exit::Success, "{said}");
        // The motion is over 1.4 s after power-up.
        let (exit, said) = pulsetrain(&["board", "uno", "--image", &image, "--trace", &trace, "--for", "1.7 s"]);
        assert_eq!(exit, Exit::Success, "{said}");
        assert!(said.contains("by itself") && said.contains("1.7"), "{said}");
        assert!(said.contains("clients: 0"), "{said}");
        let (exit, said) = pulsetrain(&["verify", &trace, motion, "--board", "uno", "--pins", "--align", "start"]);
        assert_eq!(exit, Exit::Success, "{said}");
        assert!(said.contains("8000"), "{said}");
    }

    /// A file that is no program for an Uno is refused, with the kinds that are.
    #[test]
    fn an_uno_is_given_no_other_files() {
        let folder = folder("no-uno");
        let refused = |args: &[&str], why: &str| {
            let (exit, said) = pulsetrain(&[&["board"], args].concat());
            // Long lines of an error are broken, at hyphens, too.
            let said = said.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
            let said = said.replace("- ", "-");
            assert!(exit == Exit::Refused && said.contains(why), "{args:?}: {said}");
        };
        let file = |name: &str, text: &str| {
            let path = folder.join(name);
            std::fs::write(&path, text).unwrap();
            path.display().to_string()
        };
        let uf2 = concat!(env!("CARGO_MANIFEST_DIR"), "/../board/images/dds_circle.uf2");
        let end = ":00000001FF\n";
        // A byte at 0x8000, and one with a wrong checksum.
        let large = file("large.hex", &format!(":018000000F70\n{end}"));
        let harmed = file("harmed.hex", &format!(":0100000000FE\n{end}"));
        for (image, why) in [
            (uf2, "is no Intel HEX"),
            (&large, "does not fit an Uno: line 1: address 0x8000 is beyond the memory of 32768 bytes"),
            (&harmed, "line 1: the checksum is wrong"),
            (&file("cut.hex", ":0100000000FF\n"), "was cut off"),
            (&file("empty.hex", end), "holds no program"),
            (&folder.join("none.hex").display().to_string(), "cannot read"),
        ] {
            refused(&["uno", "--tcp", "127.0.0.1:0", "--image", image], why);
        }
        refused(&["uno", "--image", &large], "no way to reach the board");
        refused(&["winch", "--tcp", "127.0.0.1:0", "--image", &large], "`winch` is no chip");
        refused(&["uno", "--tcp", "127.0.0.1:0", "--image", &large, "--bootloader", &large], "excludes the other");
    }

    #[test]
    fn a_picos_socket_answers_hello() {
        says_hello_to("pico");
    }

    /// Connects to the address in a board's first line.
    fn connect(first: &str) -> TcpStream {
        let address = first.split_whitespace().find(|word| word.starts_with("127.0.0.1:")).unwrap();
        TcpStream::connect(address.trim_end_matches([',', ';'])).unwrap()
    }

    fn says_hello_to(board: &str) {
        let (served, first) = Served::new(board, &["--tcp", "127.0.0.1:0"]);
        let mut stream = connect(&first);
        stream.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
        // Sent until it is answered, as the chip needs a moment to start. The third byte of the answer is the protocol.
        let mut hello = Vec::new();
        let mut link = Link::new(1);
        link.hello(Duration::ZERO);
        link.output(Duration::ZERO, &mut hello);
        let mut decoder = Decoder::<{ pulsetrain_core::wire::MAX_BODY }>::new();
        let answered = (0..200).any(|_| {
            stream.write_all(&hello).unwrap();
            let mut bytes = [0; 256];
            let count = stream.read(&mut bytes).unwrap_or(0);
            bytes[..count].iter().any(|byte| {
                matches!(decoder.push(*byte), Received::Frame(_)) && version_of(decoder.body()) == Some(VERSION)
            })
        });
        assert!(answered);
        drop(stream);
        assert!(served.interrupt().contains("clients: 1"));
    }

    #[test]
    fn a_winch_at_a_port_is_told_a_script() {
        let folder = folder("serve-winch");
        let (script, link, out) = (folder.join("script.txt"), folder.join("winch"), folder.join("out"));
        std::fs::write(&script, "0 s: g xyza 5 1\n0 s: srate 20\n0 s: a xz 100 -50\n").unwrap();
        let (served, _) = Served::new("winch", &["--pty", &link.display().to_string()]);
        let [script, link, out] = [script, link, out].map(|path| path.display().to_string());
        let (exit, said) = pulsetrain(&["winch", &script, "--port", &link, "--for", "1.5 s", "--out", &out]);
        assert_eq!(exit, Exit::Success, "{said}");
        assert!(said.contains("its pins were not measured") && said.contains("  x     100       100 "), "{said}");
        // It ignores frames: the error says so, with advice.
        let (exit, said) = pulsetrain(&["info", "--port", &link]);
        assert_eq!(exit, Exit::Refused, "{said}");
        assert!(
            said.split_whitespace().collect::<Vec<_>>().join(" ").contains("pulsetrain winch --port PORT"),
            "{said}"
        );
        // Opening its port resets it, and it moves no more.
        let (exit, said) = pulsetrain(&["stop", "--port", &link]);
        assert!(exit == Exit::Success && said.contains("has reset the board"), "{said}");
        assert!(served.interrupt().contains("clients: 4"));
    }

    /// Text has the axes, by a path and by verbs, and the program that moved them has left. Frames are refused, so
    /// `stop` uses text.
    #[test]
    fn what_text_has_left_behind_is_stopped() {
        let link = folder("serve-stop").join("pico");
        let (served, _) = Served::new("pico", &["--pty", &link.display().to_string()]);
        let link = link.display().to_string();
        let stop = || {
            let (exit, said) = pulsetrain(&["stop", "--port", &link, "--json"]);
            assert_eq!(exit, Exit::Success, "{said}");
            let stopped = serde_json::from_str::<serde_json::Value>(&said).unwrap();
            crate::json::conforms("stop", &stopped);
            stopped
        };
        for lines in [&["v x 1000"][..], &["speed y 125000", "run y"]] {
            let mut talk = Talk::new(Serial::open(&link, false).unwrap());
            assert!(talk.ask().unwrap().is_some());
            lines.iter().for_each(|line| talk.tell(line).unwrap());
            talk.wait(talk.now() + Duration::from_millis(300), |_, said| assert!(!said.is_refusal(), "{said:?}"))
                .unwrap();
            drop(talk);
            let said = stop();
            // A path may have come to rest before its first status.
            assert!(said["text"] == true && said["moved"] != false, "{said}");
            let axis = if lines.len() == 1 { 0 } else { 1 };
            assert!(said["positions"][axis].as_i64().is_some_and(|steps| steps > 100), "{said}");
            // Frames may have the board again, and there is nothing left to stop.
            let said = stop();
            assert_eq!((&said["text"], &said["moved"]), (&false.into(), &false.into()), "{said}");
        }
        served.interrupt();
    }

    /// A file with one law for some motors of an Uno.
    fn motion(file: &Path, motors: usize, law: &str) -> String {
        let mut text = "board = \"uno\"\ntolerance = \"0.05 us\"\n".to_owned();
        for (step, dir) in [(2, 5), (3, 6), (4, 7), (12, 13)].into_iter().take(motors) {
            text += &format!(
                "[motor.m{step}]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"TMC2209\"\npins = {{ step = {step}, dir = {dir} }}\n\
                 forward = \"high\"\n[[motion]]\nmotor = \"m{step}\"\n{law}\n",
            );
        }
        std::fs::write(file, text).unwrap();
        file.display().to_string()
    }

    /// If an Uno cannot follow a motion, it is refused before the port is opened. If it can, the motion is rehearsed,
    /// and the output says so.
    #[test]
    fn a_run_is_rehearsed_before_the_port_is_opened() {
        let folder = folder("serve-rehearsal");
        let path = |name: &str| folder.join(name).display().to_string();
        let (link, trace, out) = (path("uno"), path("pins.vcd"), path("out"));
        // Calm for a second; then its segments do not fit into the queues.
        let law = "law.then = [ { sine = { amplitude = \"20 step\", period = \"1 s\", cycles = 1 } }, \
                   { sine = { amplitude = \"3 step\", period = \"5 ms\", cycles = 40 } } ]";
        let hard = motion(&folder.join("hard.toml"), 4, law);
        let law = "law.sine = { amplitude = \"25 step\", period = \"1 s\", cycles = 1 }";
        let easy = motion(&folder.join("easy.toml"), 1, law);
        // Steps on pin 2, number of clients, and the output of the command that runs the board.
        let ran = |arguments: &[&str]| {
            let (served, _) = Served::new("uno", &["--pty", &link, "--trace", &trace]);
            let run = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
                .args([&["run", "--port", &link, "--out", &out], arguments].concat())
                .output()
                .unwrap();
            let clients = served.interrupt();
            let said = String::from_utf8(run.stdout).unwrap() + &String::from_utf8(run.stderr).unwrap();
            // Long lines of an error are broken, at hyphens, too.
            let said = said.split_whitespace().filter(|word| *word != "│").collect::<Vec<_>>().join(" ");
            let said = said.replace("- ", "-");
            let trace = pulsetrain_trace::vcd_file::read(&std::fs::read(&trace).unwrap()).unwrap();
            let is_step = |line: u8| trace.lines[usize::from(line)].names.iter().any(|name| name.ends_with("pin2"));
            let steps = trace.edges.iter().filter(|edge| edge.level && is_step(edge.line)).count();
            (run.status.code(), said, steps, clients.contains("clients: 0"))
        };
        let (code, said, steps, unopened) = ran(&[&hard]);
        assert_eq!((code, steps, unopened), (Some(Exit::Refused as i32), 0, true), "{said}");
        assert!(said.contains("the board's queue holds ") && said.contains("times slower it fits"), "{said}");
        assert!(!Path::new(&out).exists(), "nothing is written");
        let kept = (0..3).map(|_| ran(&[&easy])).find(|(code, ..)| *code == Some(Exit::Success as i32));
        let Some((_, said, steps, _)) = kept else { panic!("it does not come to its end") };
        assert!(steps == 100 && said.contains("Rehearsed on the virtual Uno: all 1 s: every edge within "), "{said}");
        // It ends where it began, after a hundred steps: both are said, and that the verdict is the board's own.
        for part in ["steps made", " 100 ", "is at 0 steps, 0 steps from its start", "PASS: by the board's own report"]
        {
            assert!(said.contains(part), "{part} is not in {said}");
        }
    }

    /// If the board disappears during a run, the exit code is 3. The message and report.json say why, when, and where the motors are.
    #[test]
    fn a_run_that_is_stopped_says_when_and_where() {
        let folder = folder("serve-stopped");
        let path = |name: &str| folder.join(name).display().to_string();
        let (link, out) = (path("uno"), path("out"));
        let law = "law.sine = { amplitude = \"200 step\", period = \"1 s\", cycles = 60 }";
        let file = motion(&folder.join("turn.toml"), 1, law);
        for json in [false, true] {
            let under_way = folder.join("out/steps.csv.part");
            let (served, _) = Served::new("uno", &["--pty", &link]);
            let run = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
                .args(["run", &file, "--port", &link, "--no-rehearsal", "--out", &out])
                .args(json.then_some("--json"))
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .spawn()
                .unwrap();
            // The first steps are in the file, which gets its name at the end: the motor moves.
            while std::fs::metadata(&under_way).map_or(0, |file| file.len()) == 0 {
                std::thread::yield_now();
            }
            drop(served.interrupt());
            let ended = run.wait_with_output().unwrap();
            let said = String::from_utf8(ended.stderr).unwrap();
            assert_eq!(ended.status.code(), Some(Exit::Stopped as i32), "{said}");
            assert!(said.contains("m2 at "), "{said}");
            let text = std::fs::read(folder.join("out/report.json")).unwrap();
            let report: serde_json::Value = serde_json::from_slice(if json { &ended.stdout } else { &text }).unwrap();
            crate::json::conforms("run", &report);
            let stopped = &report["stopped"];
            assert!(stopped["at_s"].as_f64().is_some_and(|at_s| (0.0..60.0).contains(&at_s)), "{report}");
            assert_eq!(stopped["motors"][0]["name"], "m2");
            assert!(stopped["message"].is_string() && stopped["help"].is_string(), "{report}");
            let steps = std::fs::read_to_string(folder.join("out/steps.csv")).unwrap();
            assert!(steps.ends_with('\n') && steps.lines().count() > 10, "steps up to there are written");
        }
    }

    /// An earlier host has left a move of a day. A run prints at once that it waits for it, stops waiting at Ctrl-C,
    /// and leaves the move as it is.
    #[test]
    fn a_run_tells_what_it_waits_for_and_leaves_it() {
        let folder = folder("serve-busy");
        let link = folder.join("pico").display().to_string();
        let (served, _) = Served::new("pico", &["--pty", &link]);
        let mut host = Remote::open(Serial::open(&link, false).unwrap(), 1).unwrap();
        let driver = MotorSetup { step_pin: 2, dir_pin: 3, pull_in_ticks: 1_250_000, ..MotorSetup::default() };
        host.configure(&Setup { pulse_ticks: 250, motors: vec![driver], ..Setup::default() }).unwrap();
        host.tell_motors(&[(0, Verb::Speed { ticks: 125_000 }), (0, Verb::Move { steps: 86_400_000 })]).unwrap();
        drop(host.close());
        let example = concat!(env!("CARGO_MANIFEST_DIR"), "/../../examples/tutorial.toml");
        let mut run = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
            .args(["run", example, "--board", "pico", "--port", &link, "--out", folder.join("out").to_str().unwrap()])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let (mut said, mut first) = (BufReader::new(run.stderr.take().unwrap()), String::new());
        said.read_line(&mut first).unwrap();
        assert!(first.contains("still moves motors") && first.contains(&format!("stop --port {link}")), "{first}");
        assert!(Command::new("kill").args(["-INT", &run.id().to_string()]).status().unwrap().success());
        assert_eq!(run.wait().unwrap().code(), Some(Exit::Refused as i32));
        let mut rest = String::new();
        said.read_to_string(&mut rest).unwrap();
        let rest = rest.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(rest.contains("pulsetrain stop --port PORT"), "{rest}");
        // No host has the board, and it moves.
        let (exit, said) = pulsetrain(&["stop", "--port", &link, "--json"]);
        assert_eq!(exit, Exit::Success, "{said}");
        let stopped: serde_json::Value = serde_json::from_str(&said).unwrap();
        crate::json::conforms("stop", &stopped);
        assert_eq!((&stopped["moved"], &stopped["text"]), (&true.into(), &false.into()), "{said}");
        served.interrupt();
    }

    /// The clock of a board that is paced by this computer's depends on how busy the computer is. A board that is 0.1 s
    /// late after 2 s seems to be 50 000 ppm slow, and one that is always late cannot be compared. So there are several
    /// tries, and the clocks differ much. Smaller differences are tested in virtual time.
    #[test]
    fn a_board_at_a_port_is_calibrated() {
        const BUSY_PPM: f64 = 50_000.0;
        const TRIES: u32 = 10;
        let link = folder("serve-calibrate").join("uno").display().to_string();
        let calibrated = |off: f64| {
            let (served, _) = Served::new("uno", &["--pty", &link, "--clock-ppm", &off.to_string()]);
            let mut said = String::new();
            for clients in 1..=TRIES {
                let (exit, told) = pulsetrain(&["calibrate", "--port", &link, "--for", "2 s", "--json"]);
                said = told;
                if exit == Exit::Refused && said.contains("too short to compare clocks") {
                    continue;
                }
                assert_eq!(exit, Exit::Success, "{said}");
                let found: serde_json::Value = serde_json::from_str(&said[..=said.rfind('}').unwrap()]).unwrap();
                crate::json::conforms("calibrate", &found);
                let [ppm, within, seconds] =
                    ["clock_ppm", "within_ppm", "watched_s"].map(|name| found[name].as_f64().unwrap());
                assert!(within > 0.0 && seconds == 2.0, "{said}");
                if (ppm - off).abs() <= within + BUSY_PPM {
                    return (served, clients);
                }
            }
            panic!("{off}: {said}");
        };
        let (served, clients) = calibrated(100_000.0);
        assert!(served.interrupt().contains(&format!("clients: {clients}")));
        let (served, clients) = calibrated(0.0);
        let (exit, said) = pulsetrain(&["stop", "--port", &link]);
        assert!(exit == Exit::Success && said.contains("has reset the Uno"), "{said}");
        // The next host finds the board free.
        let (exit, said) = pulsetrain(&["calibrate", "--port", &link, "--for", "0.1 s"]);
        assert!(exit == Exit::Refused && said.contains("too short to compare clocks"), "{said}");
        assert!(served.interrupt().contains(&format!("clients: {}", clients + 2)));
        let (exit, said) = pulsetrain(&["calibrate", "--port", &link]);
        assert!(exit == Exit::Refused && said.contains("there is no port"), "{said}");
    }

    #[test]
    fn a_pipe_s_exit_code_tells_whether_all_was_obeyed() {
        for (lines, code, expected) in [
            (&b"g x 5 1\nd x 40\n"[..], 0, " 40 0 0 0\n"),
            (b"d x 1\nd x ten\n", 1, "err number 3\n"),
            (b"g x 5 1\nd x 4\xff\nd x 40\n", 1, "err noise 3\n"),
        ] {
            let mut process = Command::new(env!("CARGO_BIN_EXE_pulsetrain"))
                .args(["winch", "--native"])
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            process.stdin.take().unwrap().write_all(lines).unwrap();
            let output = process.wait_with_output().unwrap();
            let said = String::from_utf8(output.stdout).unwrap();
            assert_eq!(output.status.code(), Some(code), "{said}");
            assert!(said.contains(expected), "{said}");
        }
    }

    #[test]
    fn a_paced_board_is_where_it_was_asked_to_come() {
        let mut winch = Paced::new(NativeWinch::new());
        winch.send(b"ping\n").unwrap();
        let (mut heard, until) = (Vec::new(), Duration::from_millis(30));
        while winch.now() < until {
            winch.receive(until, &mut heard).unwrap();
        }
        assert_eq!((winch.now(), heard.as_slice()), (until, &b"awake\r\nawake\r\n"[..]));
    }

    #[test]
    fn a_name_that_is_taken_is_refused() {
        let folder = folder("serve-taken");
        let taken = folder.join("taken");
        std::fs::write(&taken, "mine").unwrap();
        let (exit, said) = pulsetrain(&["board", "uno", "--pty", &taken.display().to_string()]);
        assert_eq!(exit, Exit::Refused);
        assert!(said.contains("a name that is free"), "{said}");
        assert_eq!(std::fs::read_to_string(&taken).unwrap(), "mine");
    }
}
