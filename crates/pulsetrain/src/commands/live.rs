//! `pulsetrain live`: a motion that is changed while it runs.

use std::io::{self, BufRead, BufReader, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, TryRecvError, channel, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use clap::Args;
use miette::miette;
use pulsetrain_board::{BoardKind, Edge, Leased, Observer, Serial};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::file::{Contents, FileError, MOST_OF_A_NAMED_FILE, Midi, Sheet};
use pulsetrain_motion::human;
use pulsetrain_motion::program::Program;
use pulsetrain_session::Proof;
use pulsetrain_session::control::Ended;
use pulsetrain_session::drive::{DriveError, Driven, connect_while};
use pulsetrain_session::prepare::{Prepared, usual_baud};
use pulsetrain_trace::{Line as TraceLine, vcd_file};

use super::problems::{drive_problem, port_problem};
use super::rehearsal::Rehearsal;
use super::{on_port, plan, ports, steer};
use crate::clock::{self, Onward};
use crate::console::{Access, Console, Exit};
use crate::control_socket::{Control, Hub, HubSender, run_info};
use crate::diagnostic::{WrongFile, advised};
use crate::files::inputs;
use crate::files::outputs::{self, Destination, OutputError};
use crate::live::log::{LogEntry, LogHead, LogLine, VERSION};
use crate::live::schedule::Scheduler;
use crate::live::{
    Batch, ClientKind, CommandSource, Ending, FileTexts, HELP, KnobInfo, LiveBoard, LiveHost, LiveRun, LiveSetpoints,
    MAX_MERGED_COMMANDS, MAX_TYPED_LINE_BYTES, NamedFiles, NoPort, Player, PlayerOptions, RunCommand, RunEnded,
    RunEvent, RunInfo, SuspendedRun, TypedLine, Work,
};
use crate::midi::{self, MidiError};
use crate::osc::{self, listen_address, serve_osc_on};
use crate::page::{self, PageOptions};
use crate::serve::RealTime;
use crate::way_back::{quoted, way_back};
use crate::{arguments, interrupt, last_positions, load};
use port::{LiveBeginning, OnPort};
use pulsetrain_motion::file::Live;
use pulsetrain_report::positions::motor_positions;
use screen::{Key, LiveScreen};
use watch::{LOOK_MS, WatchedFiles};

mod port;
mod screen;
mod watch;

#[derive(Args, Clone, Debug)]
#[command(after_help = "\
The motion runs until it is stopped. Change the file, turn knobs, go to cues: the motors change over within their \
limits, and lose no step. docs/live.md has all of it.

Lines on standard input, or typed after a colon at a terminal:
  second.frequency 0.9 Hz     turn a knob; `knobs` lists them
  tempo 0.5, pause, resume    all motors, in phase
  go, back, cue NAME          cues
  goto 0, stop                `help` lists all of them

Examples:
  pulsetrain live examples/live.toml
  pulsetrain live examples/live.toml --port /dev/ttyACM0
  echo stop | pulsetrain live examples/live.toml --native")]
pub(crate) struct LiveArgs {
    /// Motion file (TOML)
    pub(crate) file: PathBuf,
    /// Hold the motion against this board's limits instead of the file's
    #[arg(long, value_name = "BOARD", value_parser = arguments::board)]
    pub(crate) board: Option<String>,
    /// Run it on this computer's own stepgen even if its board has a firmware
    #[arg(long, conflicts_with = "port")]
    pub(crate) native: bool,
    /// Let the board at this serial port run it
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Rate of the line to the board, once it is found [default: 1000000; 2000000 for a Pico, whose own USB has no rate]
    #[arg(long, value_name = "BAUD", value_parser = arguments::baud, conflicts_with = "native")]
    pub(crate) baud: Option<Baud>,
    /// Begin at once on an Uno at the port, without a rehearsal on the virtual one
    #[arg(long, requires = "port")]
    pub(crate) no_rehearsal: bool,
    /// Print lines of text, even at a terminal
    #[arg(short, long)]
    pub(crate) quiet: bool,
    /// If the motors braked since this computer was too slow or the cable was pulled, end; else they join the motion again
    #[arg(long)]
    pub(crate) no_rejoin: bool,
    /// Join the motion from where the motors stand, such as after a power cut. If their positions are unknown, wait for the line `here POSITION`
    #[arg(long, requires = "port")]
    pub(crate) resume: bool,
    /// Where the motors stand if the board does not know: a position for all, MOTOR=POSITION, or `last`; may be repeated
    #[arg(long, value_name = "POSITION", requires = "resume", allow_hyphen_values = true)]
    pub(crate) here: Vec<String>,
    /// Do not look at the motion file again, nor at files that it names
    #[arg(long)]
    pub(crate) no_watch: bool,
    /// Show and steer it in the browser: a page at this address and port of this computer [default: 127.0.0.1:8016]
    #[arg(long, value_name = "[ADDR:]PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8016")]
    pub(crate) page: Option<String>,
    /// Take Open Sound Control at this port, from this computer alone unless ADDR is given
    #[arg(long, value_name = "[ADDR:]PORT")]
    pub(crate) osc: Option<String>,
    /// Answer OSC clients at this port [default: the port from which they send]
    #[arg(long, value_name = "PORT", requires = "osc", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) osc_reply: Option<u16>,
    /// Take MIDI from this port, or from the one with this in its name, as [live.midi] says; `pulsetrain ports --midi` lists them
    #[arg(long, value_name = "PORT")]
    pub(crate) midi: Option<String>,
    /// Write what is asked and done to this file, for `pulsetrain replay`
    #[arg(long, value_name = "FILE")]
    pub(crate) log: Option<PathBuf>,
    /// Write every edge of a virtual board to this file (VCD)
    #[arg(long, value_name = "FILE", conflicts_with = "port")]
    pub(crate) trace: Option<PathBuf>,
}

#[derive(Args, Debug)]
#[command(after_help = "\
This is `pulsetrain live FILE --page`. The page is for this computer alone. With --listen others in the network can \
open it: by the link with a token that is printed. docs/page.md says who may do what.

Examples:
  pulsetrain serve examples/live.toml
  pulsetrain serve examples/live.toml --listen 192.168.0.7:8016")]
pub(crate) struct ServeArgs {
    #[command(flatten)]
    pub(crate) live: LiveArgs,
    /// Let others in the network open the page, with a token, at this address of this computer
    #[arg(long, value_name = "ADDR[:PORT]", conflicts_with = "page")]
    pub(crate) listen: Option<String>,
}

/// `pulsetrain serve`: a live motion with its page.
pub(crate) fn serve(args: &ServeArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let mut live = args.live.clone();
    let at = args.listen.clone().or(live.page.take());
    live.page = Some(at.unwrap_or_else(|| page::USUAL_ADDRESS.to_string()));
    run(&live, console)
}

/// A motion that is about to run.
pub(super) struct PreparedLive {
    pub(super) setpoints: LiveSetpoints,
    pub(super) prepared: Prepared,
    pub(super) proof: Proof,
    pub(super) baud: Baud,
    /// Whether the motors rest at first.
    pub(super) is_at_rest: bool,
}

impl PreparedLive {
    /// Prepares a motion, and proves its beginning.
    pub(super) fn new(
        (mut setpoints, contents): (LiveSetpoints, Contents),
        name: &str,
        board: Option<&str>,
        line: Transport<'_>,
        console: &Console<'_>,
    ) -> miette::Result<PreparedLive> {
        let mut prepared = Prepared::new(name.to_owned(), contents, board).map_err(advised)?;
        plan::check_baud(&prepared, line.baud)?;
        let baud = line.baud.unwrap_or_else(|| usual_baud(&prepared.program.board.name));
        if !line.is_native {
            let by_uart = line.port.is_some_and(|name| !ports::is_own_usb(name));
            prepared.over_line(if by_uart { Some(baud) } else { line.baud });
        }
        let proof = plan::prove_first(&mut prepared, console)?;
        setpoints.set_up(&prepared.program);
        Ok(PreparedLive { setpoints, prepared, proof, baud, is_at_rest: false })
    }

    /// Lets the motors rest at these positions at the beginning, steps.
    pub(super) fn rest_at(&mut self, positions: &[f64]) -> miette::Result<()> {
        self.prepared.program = self.setpoints.resting_at(positions).map_err(|error| miette!("{error}"))?;
        self.setpoints.set_up(&self.prepared.program);
        (self.proof.is_whole, self.is_at_rest) = (true, true);
        Ok(())
    }

    /// Its virtual board; `None`: the native one. The same each time.
    pub(super) fn virtual_kind(&self, is_native: bool) -> Option<BoardKind> {
        BoardKind::emulated(&self.prepared.program.board.name).filter(|_| !is_native)
    }
}

/// How the plan comes to the board.
#[derive(Clone, Copy, Debug)]
pub(super) struct Transport<'a> {
    pub(super) is_native: bool,
    pub(super) port: Option<&'a str>,
    pub(super) baud: Option<Baud>,
}

pub(crate) fn run(args: &LiveArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let path = load::found(&args.file).into_owned();
    let name = path.display().to_string();
    let opened = match opened(&path, args.board.as_deref()) {
        Ok(opened) => opened,
        // It gives advice about names that are not there.
        Err(error) => return load::contents(&args.file).and(Err(WrongFile::from(error).into())),
    };
    let midi = args.midi.as_deref().map(|port| midi_of(&opened.1, port, &name)).transpose()?;
    let way = Transport { is_native: args.native, port: args.port.as_deref(), baud: args.baud };
    let mut staged = PreparedLive::new(opened, &name, args.board.as_deref(), way, console)?;
    let program = Arc::new(staged.prepared.program.clone());
    let is_time = Scheduler::new(staged.setpoints.live()).is_time(&clock::now());
    if !is_time || args.resume {
        let home = staged.setpoints.home().to_vec();
        staged.rest_at(&home)?;
    }
    let osc_at = args.osc.as_deref().map(listen_address).transpose()?;
    // Ports that are not to be had are said before anything moves.
    let osc = osc_at.map(osc::listen).transpose()?;
    // If another program has the page's port, the error comes before anything moves.
    let page_at = args.page.as_deref().map(|text| page::listen(page::address(text)?)).transpose()?;
    if let Some(path) = &args.trace {
        outputs::claim(&Destination::new(path, "--trace"))?;
    }
    let log = args.log.as_deref().map(|path| Log::new(path, &staged, args)).transpose()?;
    let mut info = run_info(&name, &program, args.port.as_deref(), args.native);
    (info.is_live, info.knobs, info.cues) = (true, staged.setpoints.knobs(), staged.setpoints.cues());
    let control = Control::open(&info, console);
    let in_force = Arc::new(Mutex::new(staged.setpoints.text().to_owned()));
    let rules = Arc::new(Mutex::new(Rules::of(&staged.setpoints)));
    let thread = LiveThread {
        control,
        log,
        trace: args.trace.clone(),
        rejoins: !args.no_rejoin,
        joins: is_time,
        program: Arc::clone(&program),
        here: args.here.iter().map(|text| here(text)).collect(),
        setpoints: staged.setpoints.clone(),
        in_force: Arc::clone(&in_force),
        rules: Arc::clone(&rules),
    };
    let began = begin(staged, args, thread, console);
    let (running, stage) = began?;
    let Running { hub, heard, pending, thread } = running;
    if !args.no_watch {
        watch(&path, &stage, &hub, &rules);
    }
    keep_to_schedule(&hub, rules);
    if let Some(socket) = osc {
        let address = serve_osc_on(&hub, socket, args.osc_reply)?;
        if osc_at.is_some_and(|asked| asked.port() == 0) {
            console.print(format_args!("OSC at {address}\n"))?;
        }
    }
    let _midi = midi.map(|(port, table)| midi::serve_midi(&hub, port, table)).transpose()?;
    let page = page_at.map(|(listener, token)| {
        let options = PageOptions { token, motion: Arc::clone(&in_force), log: args.log.clone() };
        page::serve(&hub, listener, options)
    });
    let page = page.transpose()?;
    if let Some(page) = &page {
        console.print(format_args!("the page: {}\n", page.url()))?;
    }
    let talk = TerminalSide { info: hub.info(), hub: hub.clone(), heard, pending };
    let talked = talk.until_the_end(args.quiet, console);
    let ended = thread.join().map_err(|_| miette!("the motion's thread failed: please report it"))?;
    let unwritten = ended.unwritten;
    let exit = match ended.ended {
        Ok(Some(ended)) => print_end(args, &name, &program, &ended, console),
        Ok(None) => Err(miette!("stopped before it began: no motor has moved")),
        Err(error) => {
            let has_moved = matches!(error, DriveError::Halted { .. });
            let problem = drive_problem(error);
            if !has_moved {
                return Err(problem);
            }
            console.complain(&problem).map(|_| Exit::Stopped)
        }
    };
    talked?;
    match unwritten {
        Some(error) => exit.and(Err(error.into())),
        None => exit,
    }
}

/// Reads a motion file with the files that it names. `board` replaces the file's own.
fn opened(path: &Path, board: Option<&str>) -> Result<(LiveSetpoints, Contents), FileError> {
    let sheet = Sheet::open(path, &inputs::text)?;
    let (name, text) = (sheet.source().name(), sheet.source().text());
    let folder = path.parent().unwrap_or(Path::new("")).to_owned();
    let loader = move |named: &Path| inputs::text(&folder.join(named), MOST_OF_A_NAMED_FILE);
    LiveSetpoints::of(text, name, board, NamedFiles::LoadedBy(Arc::new(loader)))
}

/// The MIDI port that is asked for, and what it does. If it is not there, that is said before anything moves.
fn midi_of<'a>(contents: &Contents, port: &'a str, file: &str) -> Result<(&'a str, Midi), MidiError> {
    midi::port_named(port, &midi::ports()?)?;
    let table = contents.live.midi.clone().ok_or_else(|| MidiError::NoTable { file: file.to_owned() })?;
    Ok((port, table))
}

/// Says where the motors are, and how they get back.
fn print_end(
    args: &LiveArgs,
    name: &str,
    program: &Program,
    ended: &Ended,
    console: &mut Console<'_>,
) -> miette::Result<Exit> {
    let motors = motor_positions(program, &ended.counted, ended.uncertain.as_deref().unwrap_or_default());
    let each: Vec<String> = motors.iter().map(ToString::to_string).collect();
    console.print(format_args!("stopped: {}\n", each.join("; ")))?;
    let board = args.board.as_ref().map(|board| format!(" --board {board}"));
    let port = args.port.as_deref().map(|port| format!(" --port {}", quoted(port)));
    let options: String = board.into_iter().chain(port).chain(args.native.then(|| " --native".to_owned())).collect();
    if let Some(way_back) = way_back(name, program, &motors, &options) {
        console.print(format_args!("  back to the start: {way_back}\n"))?;
    }
    Ok(Exit::Success)
}

/// A motion that runs in its own thread.
struct Running {
    hub: Hub,
    heard: Receiver<MotionNews>,
    pending: Arc<AtomicUsize>,
    thread: thread::JoinHandle<Played>,
}

/// What the motion's thread tells the terminal.
enum MotionNews {
    Event(RunEvent),
    /// The board counts from these positions now, steps.
    Starts(Vec<f64>),
    Over,
}

/// How a motion ended, and the file that could not be written.
struct Played {
    /// With the counts from where the motion begins; `None` if no motor has moved.
    ended: Result<Option<Ended>, DriveError>,
    unwritten: Option<Access>,
}

/// Connects to the board, and lets the motion run in a thread of its own, so that clients never delay a step.
fn begin(
    staged: PreparedLive,
    args: &LiveArgs,
    thread: LiveThread,
    console: &mut Console<'_>,
) -> miette::Result<(Running, Arc<str>)> {
    let PreparedLive { setpoints, prepared, proof, baud, is_at_rest } = &staged;
    let text: Arc<str> = setpoints.text().into();
    let failed = |control: Control, error: miette::Report| {
        control.end(&RunEnded::failed(error.to_string()));
        error
    };
    let hz = prepared.program.board.tick_hz;
    let Some(port) = &args.port else {
        interrupt::watch();
        return match staged.virtual_kind(args.native) {
            Some(kind) => match Driven::on_virtual(kind, prepared, *baud) {
                Ok(driven) => {
                    let begun = LiveBeginning::of(proving(driven, prepared, proof)?, *is_at_rest);
                    Ok((thread.play(begun, Some(hz), Box::new(NoPort))?, text))
                }
                Err(error) => Err(failed(thread.control, drive_problem(error))),
            },
            None => match Driven::native(prepared) {
                Ok(driven) => {
                    let begun = LiveBeginning::of(proving(driven, prepared, proof)?, *is_at_rest);
                    Ok((thread.play(begun, Some(hz), Box::new(NoPort))?, text))
                }
                Err(error) => Err(failed(thread.control, advised(error))),
            },
        };
    };
    let Some(kind) = BoardKind::named(&prepared.program.board.name).filter(|_| !args.native) else {
        let help = "add --board uno or --board pico, or write it in the file";
        let board = &prepared.program.board.name;
        return Err(failed(
            thread.control,
            miette!(help = help, "{} is planned for the board `{board}`", prepared.file),
        ));
    };
    let connected = (|| {
        if kind.is_rehearsed() && !args.no_rehearsal {
            let put_off = proof.planned.iter().map(|planned| planned.certificate.longest_put_off_ticks).max();
            drop(Rehearsal::of_run(prepared, *baud, None, put_off.unwrap_or(0), console)?);
        }
        if thread.control.wants_stop() {
            return Err(miette!("stopped before it began: no motor has moved"));
        }
        interrupt::watch();
        if args.resume {
            return Ok(LiveBeginning::Resume);
        }
        let serial = Serial::open(port, false).map_err(port_problem)?;
        // From here on the board counts from another position.
        last_positions::forget(port);
        let mut waits = on_port::waits_with_notice(console, port);
        let goes_on = || waits() && !thread.control.wants_stop();
        let driven = Driven::with(prepared, |program| connect_while(serial, program, *baud, goes_on));
        Ok(LiveBeginning::of(proving(driven.map_err(drive_problem)?, prepared, proof)?, *is_at_rest))
    })();
    match connected {
        Ok(begun) => {
            let board = OnPort::new(port, prepared.clone(), *baud, args.resume);
            Ok((thread.play(begun, None, Box::new(board))?, text))
        }
        Err(error) => Err(failed(thread.control, error)),
    }
}

/// Lets the rest of a motion be proven while it runs.
pub(super) fn proving<B: Leased>(driven: Driven<B>, prepared: &Prepared, proof: &Proof) -> miette::Result<Driven<B>> {
    if proof.is_whole { Ok(driven) } else { driven.proving(prepared, proof.until_s).map_err(drive_problem) }
}

/// What a running motion needs besides its board.
struct LiveThread {
    control: Control,
    log: Option<Log>,
    trace: Option<PathBuf>,
    rejoins: bool,
    setpoints: LiveSetpoints,
    /// The text of the motion file that is followed, for the page.
    in_force: Arc<Mutex<String>>,
    rules: Arc<Mutex<Rules>>,
    /// The motion as it begins.
    program: Arc<Program>,
    /// Whether motors whose positions are found, with `--resume`, join the motion.
    joins: bool,
    /// Where the motors stand, by the command line.
    here: Vec<RunCommand>,
}

/// What other threads look at: what may change by the file that is followed, and the files that it names.
struct Rules {
    live: Arc<Live>,
    files: Arc<FileTexts>,
}

impl Rules {
    fn of(setpoints: &LiveSetpoints) -> Rules {
        Rules { live: Arc::new(setpoints.live().clone()), files: Arc::new(setpoints.files()) }
    }
}

/// A position for all motors, or `MOTOR=POSITION`.
fn here(text: &str) -> RunCommand {
    let (motor, position) = match text.split_once('=') {
        Some((motor, position)) => (Some(motor.trim().to_owned()), position),
        None => (None, text),
    };
    RunCommand::Here { motor, position: position.trim().to_owned() }
}

/// Statuses that wait for the terminal: more are left out.
const MAX_PENDING: usize = 64;

impl LiveThread {
    /// Lets the motion run in its own thread. With `paced_hz` the board's time keeps pace with the time of day.
    fn play<B: Leased + Send + 'static>(
        mut self,
        begun: LiveBeginning<B>,
        paced_hz: Option<u64>,
        board: Box<dyn LiveBoard<B> + Send>,
    ) -> miette::Result<Running> {
        let hub = self.control.hub().clone();
        let (news, heard) = channel();
        let pending = Arc::new(AtomicUsize::new(0));
        let of_thread = Arc::clone(&pending);
        let trace = Trace::create(self.trace.as_deref(), paced_hz.unwrap_or(1), begun.lines())?;
        self.log = self.log.take().map(Log::open).transpose()?;
        let thread = thread::spawn(move || self.played(begun, paced_hz.is_some(), board, trace, &news, &of_thread));
        Ok(Running { hub, heard, pending, thread })
    }

    fn played<B: Leased>(
        self,
        begun: LiveBeginning<B>,
        is_paced: bool,
        board: Box<dyn LiveBoard<B> + Send>,
        mut trace: Trace,
        news: &Sender<MotionNews>,
        pending: &AtomicUsize,
    ) -> Played {
        let LiveThread { control, log, rejoins, setpoints, in_force, rules, program, joins, here, .. } = self;
        let options = PlayerOptions { has_log: log.is_some(), here };
        let mut player = match begun {
            LiveBeginning::Moving(driven) => Player::new(LiveRun::new(driven, setpoints, rejoins), board, options),
            LiveBeginning::AtRest(driven) => Player::new(LiveRun::at_rest(driven, setpoints, rejoins), board, options),
            LiveBeginning::Resume => Player::waiting(SuspendedRun::new(setpoints, rejoins, joins), board, options),
        };
        let clock = Onward::from(Duration::ZERO);
        let hub = control.hub();
        let mut host = ThreadHost { hub, news, pending, log, in_force, rules, clock, is_paced, pace: None };
        let mut source = Clients { batches: control.batches(), work: None };
        let ended = loop {
            if let Some(ended) = player.step(&mut source, &mut host, &mut trace) {
                break ended;
            }
        };
        let end = match &ended {
            Ok(Some(ended)) => {
                let uncertain = ended.uncertain.as_deref().unwrap_or_default();
                let motors = motor_positions(&program, &ended.counted, uncertain);
                RunEnded { ended: Ending::Stopped, why: None, motors, way_back: None, moved: true }
            }
            Ok(None) => RunEnded::failed("stopped before it began".to_owned()),
            Err(error) => RunEnded { moved: true, ..RunEnded::failed(error.to_string()) },
        };
        let unwritten = host.log.take().and_then(Log::finish).or(trace.finish());
        let _ = news.send(MotionNews::Over);
        control.end(&end);
        Played { ended, unwritten }
    }
}

/// The commands of clients, and a thread for work that takes long.
struct Clients<'a> {
    batches: &'a Receiver<Batch>,
    work: Option<thread::JoinHandle<()>>,
}

impl CommandSource for Clients<'_> {
    fn next(&mut self, wait: Duration) -> Option<Batch> {
        match self.batches.try_recv() {
            Ok(batch) => return Some(batch),
            Err(TryRecvError::Empty) if !wait.is_zero() => {}
            Err(_) => return None,
        }
        self.batches.recv_timeout(wait).ok()
    }

    fn start(&mut self, work: Work) {
        self.work = Some(thread::spawn(work));
    }

    fn is_done(&self) -> bool {
        self.work.as_ref().is_none_or(thread::JoinHandle::is_finished)
    }
}

/// The motion's thread: it tells the hub, the terminal and the log what happens.
struct ThreadHost<'a> {
    hub: &'a Hub,
    news: &'a Sender<MotionNews>,
    pending: &'a AtomicUsize,
    log: Option<Log>,
    in_force: Arc<Mutex<String>>,
    rules: Arc<Mutex<Rules>>,
    clock: Onward,
    /// Whether the board's time keeps pace with the time of day, and how, once it has begun.
    is_paced: bool,
    pace: Option<RealTime>,
}

impl LiveHost for ThreadHost<'_> {
    fn publish(&mut self, event: &RunEvent) {
        self.hub.publish(event);
        match event {
            RunEvent::Progress { .. } => return,
            // Its sender hears it; a fader at 60 Hz would fill the screen.
            RunEvent::Late { .. } => return,
            RunEvent::Status(_) if self.pending.load(Ordering::Relaxed) >= MAX_PENDING => return,
            _ => {}
        }
        self.pending.fetch_add(1, Ordering::Relaxed);
        // The terminal listens until the end.
        let _ = self.news.send(MotionNews::Event(event.clone()));
    }

    fn change_setpoints(&mut self, setpoints: &LiveSetpoints) {
        setpoints.text().clone_into(&mut self.in_force.lock().unwrap_or_else(PoisonError::into_inner));
        *self.rules.lock().unwrap_or_else(PoisonError::into_inner) = Rules::of(setpoints);
        self.hub.change_info(|info| (info.knobs, info.cues) = (setpoints.knobs(), setpoints.cues()));
    }

    fn count_from(&mut self, positions: &[f64]) {
        let _ = self.news.send(MotionNews::Starts(positions.to_owned()));
        self.hub.change_info(|info| {
            info.motors.iter_mut().zip(positions).for_each(|(motor, start)| motor.start_steps = *start);
        });
    }

    fn looked(&mut self, clock: Option<(Duration, f64)>) {
        if let Some((board_time, motion_s)) = clock {
            // On a real board its time is that of day.
            let pace = self.pace.unwrap_or_else(|| RealTime::from(board_time));
            self.hub.set_clock(pace.moment(board_time), motion_s);
        }
        self.hub.looked();
    }

    fn ahead(&mut self, board_time: Duration) -> Duration {
        if !self.is_paced {
            return Duration::ZERO;
        }
        self.pace.get_or_insert_with(|| RealTime::from(board_time)).ahead(board_time)
    }

    fn now(&self) -> Duration {
        self.clock.now()
    }

    fn log(&mut self, tick: u64, at_s: f64, entry: LogEntry) {
        if let Some(log) = &self.log {
            log.line(tick, at_s, entry);
        }
    }
}

/// What writes the log: a thread, so that a slow disk delays no step.
enum LogWriter {
    /// The motion is not begun yet: a start that fails leaves the log that is there.
    Waits {
        path: PathBuf,
        head: String,
        to_write: Receiver<LogLine>,
    },
    Writes(thread::JoinHandle<Option<Access>>),
}

/// What is asked and done, on its way to a file.
struct Log {
    lines: Sender<LogLine>,
    writer: LogWriter,
}

impl Log {
    /// A log of this motion. It is not written before it is [opened](Log::open).
    fn new(path: &Path, staged: &PreparedLive, args: &LiveArgs) -> miette::Result<Log> {
        outputs::claim(&Destination::new(path, "--log"))?;
        let head = LogHead {
            pulsetrain_log: VERSION,
            program: env!("CARGO_PKG_VERSION").to_owned(),
            file: staged.prepared.file.clone(),
            text: staged.setpoints.text().to_owned(),
            files: staged.setpoints.files(),
            board: args.board.clone(),
            is_native: args.native,
            port: args.port.clone(),
            baud: args.baud.map(Baud::rate),
            rejoins: !args.no_rejoin,
            rests_at: staged.is_at_rest.then(|| staged.setpoints.home().to_vec()),
        };
        let head = serde_json::to_string(&head).map_err(|error| miette!("cannot write JSON: {error}"))?;
        let (lines, to_write) = channel::<LogLine>();
        let writer = LogWriter::Waits { path: path.to_owned(), head, to_write };
        Ok(Log { lines, writer })
    }

    /// Begins to write it, in a thread.
    fn open(mut self) -> Result<Log, OutputError> {
        let LogWriter::Waits { path, head, to_write } = self.writer else { return Ok(self) };
        let to = Destination::new(&path, "--log");
        let mut file = outputs::create_log(&path, "--log")?;
        let written = writeln!(file, "{head}").and_then(|()| file.flush());
        written.map_err(|error| outputs::unwritten(&to, error))?;
        self.writer = LogWriter::Writes(thread::spawn(move || {
            for line in to_write {
                let text = serde_json::to_string(&line).unwrap_or_default();
                if let Err(error) = writeln!(file, "{text}").and_then(|()| file.flush()) {
                    return Some(outputs::unwritten(&to, error));
                }
            }
            None
        }));
        Ok(self)
    }

    fn line(&self, tick: u64, at_s: f64, entry: LogEntry) {
        // If the disk is full, `finish` returns the error.
        let _ = self.lines.send(LogLine { tick, at_s, unix_s: clock::unix_s(), entry });
    }

    fn finish(self) -> Option<Access> {
        drop(self.lines);
        match self.writer {
            LogWriter::Waits { .. } => None,
            LogWriter::Writes(thread) => thread.join().ok().flatten(),
        }
    }
}

/// A file with every edge, if one is wanted.
pub(super) struct Trace(Option<TraceFile>);

struct TraceFile {
    writer: vcd_file::EdgeWriter<Box<dyn Write + Send>>,
    path: PathBuf,
    /// The tick from which on the edges until then are to be on the disk, and the ticks in a second; none for a file that is taken only when it is
    /// whole.
    flush: Option<(u64, u64)>,
    error: Option<io::Error>,
}

impl Trace {
    /// A motion's trace, which is on the disk while it goes on.
    fn create(path: Option<&Path>, tick_hz: u64, lines: &[TraceLine]) -> Result<Trace, OutputError> {
        let Some(path) = path else { return Ok(Trace::none()) };
        let mut trace = Trace::to(Box::new(outputs::create_log(path, "--trace")?), path, tick_hz, lines)?;
        trace.0.iter_mut().for_each(|file| file.flush = Some((0, tick_hz)));
        Ok(trace)
    }

    /// No file is wanted.
    pub(super) const fn none() -> Trace {
        Trace(None)
    }

    /// Edges to a file that is open.
    pub(super) fn to(
        file: Box<dyn Write + Send>,
        path: &Path,
        tick_hz: u64,
        lines: &[TraceLine],
    ) -> Result<Trace, Access> {
        let writer = vcd_file::EdgeWriter::new(file, tick_hz, lines);
        let writer = writer.map_err(|error| Access::write(path, "--trace", error))?;
        Ok(Trace(Some(TraceFile { writer, path: path.to_owned(), flush: None, error: None })))
    }

    pub(super) fn finish(self) -> Option<Access> {
        let TraceFile { writer, path, error, .. } = self.0?;
        let written = error.map_or_else(|| writer.finish(), Err);
        written.err().map(|error| Access::write(&path, "--trace", error))
    }
}

impl Observer for Trace {
    fn edge(&mut self, edge: Edge) {
        if let Some(file) = self.0.as_mut().filter(|file| file.error.is_none()) {
            let edge = pulsetrain_trace::Edge { tick: edge.tick, line: edge.line, level: edge.level };
            let mut written = file.writer.push(edge);
            if let Some((due, tick_hz)) = &mut file.flush
                && edge.tick >= *due
            {
                *due = edge.tick + *tick_hz;
                written = written.and_then(|()| file.writer.flush());
            }
            file.error = written.err();
        }
    }
}

/// Looks at the motion file and at the files that it names, in a thread of its own.
fn watch(path: &Path, known: &str, hub: &Hub, rules: &Arc<Mutex<Rules>>) {
    let Ok(client) = hub.join(ClientKind::Terminal) else { return };
    let mut files = WatchedFiles::new(path, known);
    let (hub, rules) = (hub.clone(), Arc::clone(rules));
    thread::spawn(move || {
        // It takes no lines.
        let (sender, lines) = client.split();
        drop(lines);
        while !hub.is_over_within(Duration::from_millis(LOOK_MS)) {
            let in_force = Arc::clone(&rules.lock().unwrap_or_else(PoisonError::into_inner).files);
            if let Some((text, files)) = files.look(&in_force) {
                sender.send(RunCommand::Motion { text, files });
            }
        }
    });
}

/// Lets the motion keep to its schedule, in a thread of its own.
fn keep_to_schedule(hub: &Hub, rules: Arc<Mutex<Rules>>) {
    let Ok(client) = hub.join(ClientKind::Terminal) else { return };
    let hub = hub.clone();
    thread::spawn(move || {
        // It takes no lines.
        let (sender, lines) = client.split();
        drop(lines);
        let in_force = || Arc::clone(&rules.lock().unwrap_or_else(PoisonError::into_inner).live);
        let mut known = in_force();
        let mut scheduler = Scheduler::new(&known);
        loop {
            scheduler.look(&clock::now()).into_iter().for_each(|command| sender.send(command));
            if hub.is_over_within(Duration::from_millis(LOOK_MS)) {
                return;
            }
            let live = in_force();
            if !Arc::ptr_eq(&live, &known) {
                scheduler.change(&live);
                known = live;
            }
        }
    });
}

/// The terminal's side.
struct TerminalSide {
    info: RunInfo,
    hub: Hub,
    heard: Receiver<MotionNews>,
    pending: Arc<AtomicUsize>,
}

/// How often keys are looked for.
const KEYS: Duration = Duration::from_millis(30);

impl TerminalSide {
    fn until_the_end(self, is_quiet: bool, console: &mut Console<'_>) -> miette::Result<()> {
        let client = self.hub.join(ClientKind::Terminal).map_err(|error| miette!("{error}"))?;
        let (sender, lines) = client.split();
        // What happens is heard without the hub.
        drop(lines);
        let (says, said) = sync_channel(MAX_PENDING);
        if console.err_is_terminal && io::stdin().is_terminal() && !is_quiet {
            return self.at_a_terminal(&sender, console);
        }
        let hub = self.hub.clone();
        // It reads until its input ends, or the process does.
        thread::spawn(move || read_lines(&mut BufReader::new(io::stdin()), &sender, &hub, &says));
        console.print(format_args!("{} runs; `help` lists what can be written\n", self.info.file))?;
        loop {
            match self.heard.recv_timeout(KEYS) {
                Ok(MotionNews::Over) | Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Ok(MotionNews::Event(happened)) => {
                    self.pending.fetch_sub(1, Ordering::Relaxed);
                    if let Some(text) = in_words(&happened) {
                        console.print(format_args!("{text}\n"))?;
                    }
                }
                Ok(MotionNews::Starts(_)) | Err(RecvTimeoutError::Timeout) => {}
            }
            while let Ok(text) = said.try_recv() {
                console.print(text)?;
            }
        }
    }

    fn at_a_terminal(self, sender: &HubSender, console: &mut Console<'_>) -> miette::Result<()> {
        let refuse = |error: io::Error| miette!("the terminal cannot be used: {error}; --quiet prints lines instead");
        let mut screen = LiveScreen::new(console.err.screen(), &self.info).map_err(refuse)?;
        loop {
            match self.heard.recv_timeout(KEYS) {
                Ok(MotionNews::Over) | Err(RecvTimeoutError::Disconnected) => return Ok(()),
                Ok(MotionNews::Event(happened)) => {
                    self.pending.fetch_sub(1, Ordering::Relaxed);
                    screen.hear(&happened, in_words(&happened)).map_err(refuse)?;
                }
                Ok(MotionNews::Starts(starts)) => screen.count_from(&starts),
                Err(RecvTimeoutError::Timeout) => {}
            }
            for key in screen.keys().map_err(refuse)? {
                match key {
                    Key::Command(request) => sender.send(request),
                    Key::Line(line) => {
                        if let Some(text) = take_line(&line, |request| sender.send(request), &self.hub) {
                            screen.print(&text).map_err(refuse)?;
                        }
                    }
                }
            }
        }
    }
}

/// Reads lines until the input ends: what is asked goes to the hub.
fn read_lines(input: &mut BufReader<impl Read>, sender: &HubSender, hub: &Hub, says: &SyncSender<String>) {
    let mut line = Vec::new();
    let mut together = Vec::new();
    loop {
        line.clear();
        let most = MAX_TYPED_LINE_BYTES as u64 + 2;
        let read = (&mut *input).take(most).read_until(b'\n', &mut line);
        if read.is_err() || line.is_empty() {
            return;
        }
        let is_cut = line.len() as u64 == most && line.last() != Some(&b'\n');
        if let Some(text) = take_line(&String::from_utf8_lossy(&line), |request| together.push(request), hub) {
            let _ = says.send(format!("{}\n", text.trim_end()));
        }
        // Lines of one write act together.
        if together.len() == MAX_MERGED_COMMANDS || !input.buffer().contains(&b'\n') {
            sender.send_together(std::mem::take(&mut together));
        }
        // The rest of a line that is too long is no line.
        while is_cut && line.last() != Some(&b'\n') {
            line.clear();
            if (&mut *input).take(most).read_until(b'\n', &mut line).is_err() || line.is_empty() {
                return;
            }
        }
    }
}

/// Does what a line asks for; or gives what is to be said.
fn take_line(line: &str, send: impl FnOnce(RunCommand), hub: &Hub) -> Option<String> {
    match TypedLine::read(line) {
        Ok(TypedLine::Command(request)) => {
            send(request);
            None
        }
        Ok(TypedLine::Knobs) => Some(knob_table(&hub.info().knobs)),
        Ok(TypedLine::Cues) => {
            let cues = hub.info().cues;
            Some(if cues.is_empty() { "the motion file has no cues".to_owned() } else { cues.join("\n") })
        }
        Ok(TypedLine::Help) => Some(HELP.to_owned()),
        Ok(TypedLine::Nothing) => None,
        Err(error) => Some(format!("{error}; `help` lists what can be written")),
    }
}

fn knob_table(knobs: &[KnobInfo]) -> String {
    let mut table = human::Table::new(["knob", "value", "unit", "least", "greatest"]).left(&[0, 2]);
    for knob in knobs {
        let number = |value: f64| human::significant(value, 6);
        let bound = |bound: Option<f64>| bound.map_or_else(String::new, number);
        let unit = knob.unit.clone();
        table.row([knob.name.clone(), number(knob.value), unit, bound(knob.least), bound(knob.greatest)]);
    }
    table.to_string()
}

/// An event in words; `None` for what comes all the time.
pub(super) fn in_words(event: &RunEvent) -> Option<String> {
    match event {
        RunEvent::Progress { .. } | RunEvent::Status(_) | RunEvent::Ended(_) | RunEvent::Failed { .. } => None,
        event => Some(steer::in_words(event)),
    }
}
