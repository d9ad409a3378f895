//! Motions on the native board, on virtual boards and on real ones: a session, in bounded memory.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};

use pulsetrain_board::native::{ConfigError, Faults};
use pulsetrain_board::registry::Role;
use pulsetrain_board::remote::{image_name, in_words, name_of};
use pulsetrain_board::{
    AtRest, BoardKind, Config, Edge, Leased, LinkError, MotorConfig, Native, Observer, Port, Remote, RemoteError,
    ScheduledStep, Setup, VirtualBoard, Wiring, WithReference,
};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::message::{Cause, MotorSetup, image};
use pulsetrain_core::wire::{Baud, Reason};
use pulsetrain_motion::boards;
use pulsetrain_motion::program::{self, CoilSequence, DriverTiming, Motor, Program};
use pulsetrain_plan::Settings;
use pulsetrain_trace::{Line, lines};

use crate::control::{Command, Event, Status};
use crate::lateness::{Edges, Lateness, Meter};
use crate::prepare::{Prepared, WORST_CLOCK_PPM};
use crate::{Report, Session, SessionError};

/// Why a run did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The session could not begin or go on.
    #[error(transparent)]
    Session(SessionError),
    /// The native board cannot be wired so.
    #[error("the native board cannot run this motion: {0}")]
    Config(#[from] ConfigError),
    /// The board at the other end of the line.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// The host stood still: what comes next was not sent in time.
    #[error(
        "This computer was too slow: at {at_s:.3} s the board had no more plan for motor {motor}, and stopped the motors gently. More came \
         {:.1} ms too late.", 1e3 * .late_s
    )]
    TooLate {
        /// The motor that had least.
        motor: String,
        /// From when on the motors brake, s of the laws.
        at_s: f64,
        /// How much later the host looked after the board again, s.
        late_s: f64,
    },
    /// A queue of the board ran short, or does not hold what a plan begins with.
    #[error(
        "at {at_s:.3} s the board's queue for motor {motor}, which takes {capacity} bytes, was used up before more of the plan could be there"
    )]
    QueueTooShort {
        /// Whose.
        motor: String,
        /// When, s of the laws.
        at_s: f64,
        /// Of the empty queue.
        capacity: usize,
        /// Of each motor's queue with 1, 2, … motors, by the table of boards.
        queue_bytes: Vec<u32>,
    },
    /// The board dropped steps: a fault of the planner or the board, not of the motion.
    #[error("motor {motor} missed steps on the board `{board}`; please report this motion file")]
    Missed {
        /// Where.
        board: String,
        /// Whose.
        motor: String,
    },
    /// The reference beside the board is not what the board was told: a fault of ours, not of the motion.
    #[error(
        "The simulated copy of board `{board}` lost data that the board took, so this run cannot be judged. This is our fault; please report \
         this motion file."
    )]
    Reference {
        /// Which board.
        board: String,
    },
    /// The motors were on their way.
    #[error("{why}\n{positions}")]
    Halted {
        /// Why they did not come to the motion's end.
        why: Box<DriveError>,
        /// When that was seen, s of the laws.
        seen_s: f64,
        /// Where they are.
        positions: Positions,
        /// What to do.
        advice: &'static str,
    },
}

impl DriveError {
    /// What to do, where that is known.
    #[must_use]
    pub const fn advice(&self) -> Option<&'static str> {
        match self {
            DriveError::Halted { advice, .. } => Some(advice),
            _ => None,
        }
    }

    /// The same with where the motors are.
    pub(crate) fn halted(self, seen_s: f64, positions: Positions) -> DriveError {
        DriveError::Halted { why: Box::new(self), seen_s, advice: positions.advice(), positions }
    }

    /// From when on the motors brake, if that is known, s of the laws.
    #[must_use]
    pub const fn at_s(&self) -> Option<f64> {
        match self {
            DriveError::TooLate { at_s, .. }
            | DriveError::QueueTooShort { at_s, .. }
            | DriveError::Session(SessionError::Fault { at_s, .. } | SessionError::Restless { at_s }) => Some(*at_s),
            DriveError::Halted { why, .. } => why.at_s(),
            _ => None,
        }
    }

    /// With the motor's name, and without what is only a session's view of it.
    fn of(program: &Program, error: SessionError) -> DriveError {
        let name = |motor: usize| program.motors.get(motor).map_or_else(String::new, |motor| motor.name.clone());
        match error {
            SessionError::Lost(error) => DriveError::Remote(error),
            SessionError::Stopped { motor, at_s, late_s } => DriveError::TooLate { motor: name(motor), at_s, late_s },
            SessionError::QueueTooShort { motor, at_s, capacity } => {
                let queue_bytes = boards::find(&program.board.name).map_or_else(Vec::new, |row| row.queue_bytes);
                DriveError::QueueTooShort { motor: name(motor), at_s, capacity, queue_bytes }
            }
            error => DriveError::Session(error),
        }
    }
}

/// Where the motors are after a run that did not come to its end, and how sure that is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Positions {
    /// Each motor's name and its steps forward minus backward since the board was set up.
    pub motors: Vec<(String, i64)>,
    /// How that is known.
    pub by: Knowledge,
}

/// How it is known where motors are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Knowledge {
    /// The board counted them; they came to rest within their limits.
    Counted,
    /// The board counted them, and stopped them at once; one that was faster than its pull-in rate may have gone on.
    StoppedAtOnce,
    /// It is what the board was told; it cannot be asked.
    Replayed {
        /// Other places where the motors may be: one for each message that the board may not have received. Empty if no answer was missing.
        or: Vec<Vec<i64>>,
    },
    /// The line broke before the board answered an order to brake. The counts are the last that the board reported.
    StopUnanswered,
    /// The board restarted and has lost its count: they were there when it was heard last.
    LastReport {
        /// Why it restarted.
        reset: Cause,
    },
}

impl Positions {
    /// What to do before the next run.
    const fn advice(&self) -> &'static str {
        match self.by {
            Knowledge::Counted => "the next run counts from here: move the motors to their start position first",
            Knowledge::StoppedAtOnce => {
                "nothing moves until the next run. Look where the motors are: one that was stopped at speed may have gone further than it \
                 counted; `pulsetrain info --port PORT` tells how the board fared"
            }
            Knowledge::Replayed { .. } | Knowledge::StopUnanswered => {
                "look at the cable and at the board's supply. The motors brake within half a second, and nothing moves until the \
                 next run. An Uno that lost its supply, or whose port was opened again, was reset: look where the motors are"
            }
            Knowledge::LastReport { .. } => {
                "nothing moves until the next run. Bring the motors to where it is to begin: nobody knows where they are. Look for what \
                 reset the board: its supply, or another program that opened its port"
            }
        }
    }
}

impl std::fmt::Display for Positions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let list = |counts: &[i64]| {
            let each = self.motors.iter().zip(counts).map(|((name, _), steps)| format!("{name} at {steps} steps"));
            each.collect::<Vec<_>>().join(", ")
        };
        let counts: Vec<i64> = self.motors.iter().map(|(_, steps)| *steps).collect();
        let motors = list(&counts);
        match &self.by {
            Knowledge::Counted => write!(f, "the motors braked and rest: {motors}. The board counted that"),
            Knowledge::StoppedAtOnce => write!(f, "the motors were stopped at once: {motors}. The board counted that"),
            Knowledge::Replayed { or } => {
                write!(
                    f,
                    "by what the board was told the motors brake, and come to rest: {motors}. The board cannot be asked"
                )?;
                if or.is_empty() {
                    return Ok(());
                }
                let each: Vec<String> = or.iter().map(|counts| list(counts)).collect();
                write!(f, "; if it did not take all that it was sent: {}", each.join(", or "))
            }
            Knowledge::StopUnanswered => write!(
                f,
                "the board was told to stop, and did not answer. When it was heard last: {motors}; the motors have come to rest since, within \
                 their limits, but nobody knows where"
            ),
            Knowledge::LastReport { reset } => write!(
                f,
                "the board restarted on the way ({}) and has lost its count. When it was heard last: {motors}; the motors stopped at \
                 once, soon after that",
                in_words(*reset)
            ),
        }
    }
}

/// A prepared motion on a board, just before its laws begin.
pub struct Driven<B> {
    session: Session<B>,
    program: Arc<Program>,
    /// The lines of its traces, as they stand when the laws begin.
    pub lines: Vec<Line>,
    /// By the number that the board has for a line: which of `lines` it is.
    places: Vec<Option<u8>>,
    /// By line: the motor whose STEP it is.
    steppers: Vec<Option<usize>>,
    meter: Meter,
}

impl Driven<Native> {
    /// Sends the beginning of the motion to the native board, and lets it come to the tick at which the laws begin.
    ///
    /// # Errors
    /// When the board cannot be wired so, or the plan is refused, which [`Prepared::plan`] would have said before.
    pub fn native(prepared: &Prepared) -> Result<Driven<Native>, DriveError> {
        let program = &prepared.program;
        let lines = lines::of(program);
        let places = (0..).map(Some).take(lines.len()).collect();
        Driven::begin(native(program, Native::new)?, program, lines, places, Edges::default())
    }
}

impl Driven<WithReference<Remote<Box<dyn VirtualBoard>>>> {
    /// The same on a virtual board, at `baud`; a Pico by its USB, where `baud` is the rate that the host reckons with.
    ///
    /// # Errors
    /// As [`Driven::native`], and when the firmware refuses the configuration.
    pub fn on_virtual(kind: BoardKind, prepared: &Prepared, baud: Baud) -> Result<Self, DriveError> {
        // A board that was made just now has known nobody: the same session each time, to the cycle.
        Driven::with(prepared, |program| connect_as(kind.virtual_board(Role::Plans), program, baud, 1))
    }
}

impl<P: Port> Driven<WithReference<Remote<P>>> {
    /// The same on the board at the other end of a port, at `baud`.
    ///
    /// # Errors
    /// As [`Driven::native`], and when nobody answers or the firmware refuses the configuration.
    pub fn at(prepared: &Prepared, port: P, baud: Baud) -> Result<Driven<WithReference<Remote<P>>>, DriveError> {
        Driven::with(prepared, |program| connect(port, program, baud))
    }

    /// The same on a board that `connect` takes and sets up: [`connect`], or [`connect_as`].
    ///
    /// # Errors
    /// As [`Driven::at`].
    pub fn with(
        prepared: &Prepared,
        connect: impl FnOnce(&Program) -> Result<Remote<P>, RemoteError>,
    ) -> Result<Driven<WithReference<Remote<P>>>, DriveError> {
        let program = &prepared.program;
        let remote = connect(program)?;
        let lines = lines::of(program);
        let place = |pin: u8| place_of(&lines, pin);
        let places = (0..=LAST_PIN).map(place).collect();
        let board = WithReference::new(remote, native(program, Native::unbounded)?);
        Driven::begin(board, program, lines, places, Edges::of(program))
    }

    /// The board's own measurements, and what is true of its firmware.
    pub fn board_mut(&mut self) -> &mut Remote<P> {
        self.session.board_mut().board_mut()
    }

    /// Gives the board up: what it was told goes on to its stop, and the next host need not wait until this one was silent for too long.
    /// Gives the port back.
    pub fn close(self) -> P {
        self.session.into_board().into_board().close()
    }
}

/// The highest pin of any board with a firmware; an Uno's last is 19 (A5), a Pico's 28.
const LAST_PIN: u8 = 28;

/// Takes the board at the other end of a port and sets it up for a program.
///
/// # Errors
/// When nobody answers, or the board refuses.
pub fn connect<P: Port>(port: P, program: &Program, baud: Baud) -> Result<Remote<P>, RemoteError> {
    connect_while(port, program, baud, || true)
}

/// The same; while the board still moves motors for a host before this one, `goes_on` is asked again and again whether to wait for them.
///
/// # Errors
/// As [`connect`], and [`RemoteError::StillMoving`] if it says no. The board is left as it was then, as after any other refusal.
pub fn connect_while<P: Port>(
    port: P,
    program: &Program,
    baud: Baud,
    goes_on: impl FnMut() -> bool,
) -> Result<Remote<P>, RemoteError> {
    set_up_board(port, program, baud, session_number(), goes_on)
}

/// The same as [`connect`] with a session's number, which is to be another one than that of the session before it on the same board.
///
/// # Errors
/// As [`connect`].
pub fn connect_as<P: Port>(port: P, program: &Program, baud: Baud, number: u32) -> Result<Remote<P>, RemoteError> {
    set_up_board(port, program, baud, number, || true)
}

fn set_up_board<P: Port>(
    port: P,
    program: &Program,
    baud: Baud,
    number: u32,
    goes_on: impl FnMut() -> bool,
) -> Result<Remote<P>, RemoteError> {
    let mut remote = Remote::open(port, number)?;
    if let Err(error) = check_board(&mut remote, program) {
        remote.close();
        return Err(error);
    }
    set_up(remote, &setup(program), baud, number, goes_on)
}

/// Brings the line to its rate, waits for motors that the board still moves for a host before this one, as [`connect_while`] does, and has it
/// set up its pins. A board that refuses is left with Bye.
pub fn set_up<P: Port>(
    remote: Remote<P>,
    setup: &Setup,
    baud: Baud,
    number: u32,
    goes_on: impl FnMut() -> bool,
) -> Result<Remote<P>, RemoteError> {
    let mut remote = at_rate(remote, baud, number)?;
    match remote.wait_for_rest(goes_on).and_then(|()| remote.configure(setup)) {
        Ok(()) => Ok(remote),
        Err(error) => {
            // A host that just falls silent would have what still moves stopped at once, and the board would not answer until then.
            remote.close();
            Err(error)
        }
    }
}

/// Whether it is the board that the program is planned for.
fn check_board<P: Port>(remote: &mut Remote<P>, program: &Program) -> Result<(), RemoteError> {
    let (board, info) = (&program.board, remote.info());
    // The plan's rate is the board's by the host's clock, if that was measured.
    let off_hz = u64::from(info.tick_hz).abs_diff(board.tick_hz) as f64;
    if off_hz > board.tick_hz as f64 * WORST_CLOCK_PPM * 1e-6 || u32::from(info.fraction_bits) != board.fraction_bits {
        return Err(RemoteError::OtherBoard {
            is: name_of(info),
            wanted: board.name.clone(),
            wanted_hz: board.tick_hz,
            wanted_bits: board.fraction_bits,
        });
    }
    match info.image {
        0 | image::PLANS => Ok(()),
        other => Err(RemoteError::OtherImage { is: image_name(other), wanted: image_name(image::PLANS) }),
    }
}

/// Brings the line to its rate.
fn at_rate<P: Port>(mut remote: Remote<P>, baud: Baud, number: u32) -> Result<Remote<P>, RemoteError> {
    if baud == remote.link().baud() {
        return Ok(remote);
    }
    match remote.set_baud(baud) {
        Ok(_) => Ok(remote),
        // Neither heard the other any more: both begin again at the first rate, and stay there.
        Err(RemoteError::Link(LinkError::Lost)) => {
            let mut port = remote.close();
            port.set_baud(Baud::B115200)?;
            Remote::open(port, !number)
        }
        Err(error) => {
            remote.close();
            Err(error)
        }
    }
}

/// A number that tells a session from those before it on the same board.
#[must_use]
pub fn session_number() -> u32 {
    static SESSIONS: AtomicU32 = AtomicU32::new(0);
    let own = SESSIONS.fetch_add(1, Ordering::Relaxed);
    std::process::id().wrapping_mul(0x9e37_79b1).wrapping_add(own)
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    /// Steps of each motor, forward minus backward, as the board counted them.
    pub counted: Vec<i64>,
    /// It was stopped on the way, as planned for a stop.
    pub stopped: bool,
    /// It was stopped at once: motors that were too fast for that may stand elsewhere than they count.
    pub uncertain: Option<Vec<bool>>,
}

impl<B: Leased> Driven<B> {
    fn begin(
        board: B,
        program: &Program,
        mut lines: Vec<Line>,
        places: Vec<Option<u8>>,
        edges: Edges,
    ) -> Result<Driven<B>, DriveError> {
        let program = Arc::new(program.clone());
        let of = |error| DriveError::of(&program, error);
        let stepper = |line: &Line| {
            let is_step = |motor: &Motor| line.names.contains(&format!("{}.step", motor.name));
            program.motors.iter().position(is_step)
        };
        let steppers = lines.iter().map(stepper).collect();
        let meter = Meter::new(program.motors.len(), edges.constant_ticks.into());
        let mut session = Session::new(board, Arc::clone(&program)).map_err(of)?;
        // A first step soon after the start has its DIR set before: in a trace that is where the line begins.
        let mut level = |edge: Edge| {
            if let Some(Some(place)) = places.get(usize::from(edge.line)) {
                lines[usize::from(*place)].initial = edge.level;
            }
        };
        session.advance(session.zero() - 1, &mut level).map_err(of)?;
        Ok(Driven { session, program, lines, places, steppers, meter })
    }

    /// Runs it to its end. What is observed has the laws' time; `events` gets a status some 20 times a second.
    ///
    /// # Errors
    /// When the motion stopped before its end, or the board and the host count differently: faults of ours.
    pub fn run(&mut self, observer: &mut impl Observer, events: impl FnMut(Event)) -> Result<Ended, DriveError> {
        let (_, none) = channel();
        self.run_with(&none, observer, events)
    }

    /// The same, and obeys commands on the way. A paused motion ends if nobody is left who could send a command.
    ///
    /// # Errors
    /// As [`Driven::run`].
    pub fn run_with(
        &mut self,
        commands: &Receiver<Command>,
        observer: &mut impl Observer,
        mut events: impl FnMut(Event),
    ) -> Result<Ended, DriveError> {
        let (zero, tick_hz) = (self.session.zero(), self.program.board.tick_hz);
        let seconds = |tick: u64| tick.saturating_sub(zero) as f64 / tick_hz as f64;
        let Driven { session, steppers, meter, places, .. } = self;
        let mut since = Since { zero, places, steppers, meter, observer };
        let (mut ordered, mut stopped) = (false, false);
        while session.is_paused() || !(session.is_complete() && is_past(session)) {
            let now = session.board().now();
            let command = match commands.try_recv() {
                Ok(command) => Some(command),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) if session.is_paused() && is_past(session) => {
                    stopped = true;
                    break;
                }
                Err(TryRecvError::Disconnected) => None,
            };
            let obeyed = match command {
                Some(Command::Stop) if !ordered => {
                    ordered = true;
                    let last = session.last_step().filter(|_| session.is_complete());
                    session.stop().map(|at| {
                        // If the whole plan was sent, the last step may have been made before the board got the order.
                        stopped = last.is_none_or(|last| at <= last);
                        events(Event::Stopping { at_s: seconds(at) });
                    })
                }
                Some(Command::StopNow) => {
                    let stop = session.board_mut().stop_now(now, &mut since);
                    if let Some(error) = session.board().lost().cloned() {
                        let mut report =
                            session.run(&mut since, |tick| events(Event::Progress { at_s: seconds(tick) }));
                        report.stop_unanswered = true;
                        return Err(DriveError::from(error).halted(seconds(now), self.positions(&report).0));
                    }
                    let (positions, uncertain) = (stop.positions.clone(), stop.uncertain.clone());
                    events(Event::StoppedAtOnce { positions, uncertain });
                    return Ok(Ended { counted: stop.positions, stopped: true, uncertain: Some(stop.uncertain) });
                }
                Some(command @ (Command::Pause | Command::Resume)) => {
                    let done = match command {
                        Command::Pause => session.pause().map(|rests| Event::Pausing { rests_s: seconds(rests) }),
                        _ => session.resume().map(|tick| Event::Resuming { full_speed_s: seconds(tick) }),
                    };
                    // The motion goes on if it was refused.
                    events(done.unwrap_or_else(|error| Event::Refused { command, why: error.to_string() }));
                    Ok(())
                }
                Some(Command::Stop) | None => Ok(()),
            };
            let soon = now + tick_hz / LOOKS_PER_S;
            let last = session.last_step().filter(|last| session.is_complete() && *last >= now);
            let until = last.map_or(soon, |last| soon.min(last));
            if let Err(failure) = obeyed.and_then(|()| session.advance(until, &mut since)) {
                let seen_s = seconds(session.board().now());
                // The motors brake: that is waited for.
                let report = session.run(&mut since, |tick| events(Event::Progress { at_s: seconds(tick) }));
                let (positions, stop) = self.positions(&report);
                // The board's refusal follows from why it stopped, which is what helps.
                let failure = match (DriveError::of(&self.program, failure), stop) {
                    (DriveError::Remote(RemoteError::Refused { reason: Reason::NotArmed, .. }), Some(cause)) => {
                        RemoteError::Stopped { cause }.into()
                    }
                    (failure, _) => failure,
                };
                return Err(failure.halted(seen_s, positions));
            }
            events(Event::Progress { at_s: seconds(session.board().now()) });
            let status = session.status(zero);
            events(Event::Status(Status { lateness: Some(since.meter.so_far()), ..status }));
        }
        let progress = |tick| events(Event::Progress { at_s: seconds(tick) });
        let report = self.session.run(&mut since, progress);
        let seen_s = seconds(self.session.board().now());
        if let Some(error) = self.session.board().lost().cloned() {
            return Err(DriveError::from(error).halted(seen_s, self.positions(&report).0));
        }
        if let Some(failure) = report.failure.clone() {
            return Err(DriveError::of(&self.program, failure).halted(seen_s, self.positions(&report).0));
        }
        let counts = report.counted.iter().zip(&report.replayed).zip(&report.faults);
        let program = Arc::clone(&self.program);
        let mut motors = program.motors.iter().zip(counts);
        let missed =
            motors.find(|(_, ((counted, replayed), faults))| counted != replayed || **faults != Faults::default());
        if let Some((motor, _)) = missed {
            // A board that stopped when all was told has refused nothing: only its count shows it.
            let (positions, stop) = self.positions(&report);
            let why = match stop {
                Some(cause) => RemoteError::Stopped { cause }.into(),
                None => DriveError::Missed { motor: motor.name.clone(), board: self.program.board.name.clone() },
            };
            return Err(why.halted(seen_s, positions));
        }
        // Last: what the board did is told first.
        if !self.session.board().agrees() {
            return Err(DriveError::Reference { board: self.program.board.name.clone() });
        }
        Ok(Ended { counted: report.counted, stopped, uncertain: None })
    }

    /// Where the motors are after a run that failed, and the stop at once if there was one.
    fn positions(&mut self, report: &Report) -> (Positions, Option<Cause>) {
        let heard = self.session.board().positions();
        let mut stop = None;
        let (counts, by) = match self.session.board_mut().settle() {
            Ok(AtRest { reset: Some(reset), .. }) => (heard, Knowledge::LastReport { reset }),
            Ok(AtRest { positions, last_stop, .. }) => match last_stop {
                Cause::None | Cause::Finished | Cause::HostLost | Cause::Lapsed | Cause::Braked => {
                    (positions, Knowledge::Counted)
                }
                cause => {
                    stop = Some(cause);
                    let brakes =
                        matches!(cause, Cause::RanDry | Cause::BadItem | Cause::CheckFailed | Cause::StepMissed);
                    (positions, if brakes { Knowledge::Counted } else { Knowledge::StoppedAtOnce })
                }
            },
            Err(_) if report.stop_unanswered => (heard, Knowledge::StopUnanswered),
            Err(_) => {
                let mut told = report.replayed_otherwise.iter().chain([&report.replayed]).cloned();
                (told.next().unwrap_or_default(), Knowledge::Replayed { or: told.collect() })
            }
        };
        let names = self.program.motors.iter().map(|motor| motor.name.clone());
        (Positions { motors: names.zip(counts).collect(), by }, stop)
    }

    /// How late pulses were, against the ticks that they were scheduled for: once the run is over.
    pub fn lateness(&mut self) -> Lateness {
        let constant_ticks = self.meter.so_far().constant_ticks;
        std::mem::replace(&mut self.meter, Meter::new(0, constant_ticks)).finish()
    }
}

/// Whether the last step is past.
fn is_past<B: Leased>(session: &Session<B>) -> bool {
    session.last_step().is_none_or(|last| last < session.board().now())
}

/// So often a run looks for commands, and tells where it is, in a second of the board.
const LOOKS_PER_S: u64 = 20;

/// Counts an observer's ticks from the laws' beginning, and lines as traces have them; measures lateness.
struct Since<'o, O> {
    zero: u64,
    places: &'o [Option<u8>],
    steppers: &'o [Option<usize>],
    meter: &'o mut Meter,
    observer: &'o mut O,
}

impl<O: Observer> Observer for Since<'_, O> {
    fn edge(&mut self, edge: Edge) {
        if let Some(Some(line)) = self.places.get(usize::from(edge.line)).copied() {
            let tick = edge.tick.saturating_sub(self.zero);
            if edge.level
                && let Some(motor) = self.steppers[usize::from(line)]
            {
                self.meter.edge(motor, tick);
            }
            self.observer.edge(Edge { tick, line, level: edge.level });
        }
    }

    fn step(&mut self, step: ScheduledStep) {
        let step = ScheduledStep { tick: step.tick - self.zero, ..step };
        // No single edge of coils is a step's.
        if self.steppers.contains(&Some(step.motor)) {
            self.meter.scheduled(step.motor, step.tick);
        }
        self.observer.step(step);
    }
}

/// What a board on a line is to be configured for.
#[must_use]
pub fn setup(program: &Program) -> Setup {
    let hz = program.board.tick_hz;
    let ticks = |ticks: u64| u16::try_from(ticks).unwrap_or(u16::MAX);
    // What `Program::timing` has for each motor of such a board.
    let timing = DriverTiming::longest(&program.motors).ticks(hz);
    let mut setup = Setup {
        idle_ms: program.idle_ms,
        pulse_ticks: ticks(timing.pulse_high),
        setup_ticks: ticks(timing.dir_setup),
        hold_ticks: ticks(timing.dir_hold),
        ..Setup::default()
    };
    for (index, motor) in program.motors.iter().enumerate() {
        let mut wired = MotorSetup {
            queue_parts: program.queue_parts.get(index).copied().unwrap_or(0),
            gain: Settings::of(program, motor).gain().unwrap_or(0),
            pull_in_ticks: u32::try_from(pull_in_ticks(motor, hz)).unwrap_or(u32::MAX),
            ..MotorSetup::default()
        };
        match motor.wiring {
            program::Wiring::StepDir { step, dir, forward_high, enable } => {
                (wired.step_pin, wired.dir_pin, wired.forward_high) = (step, dir, forward_high);
                setup.enable = setup.enable.or(enable);
            }
            // Boards with coils have them on pins one after the other: that was checked when the file was read.
            program::Wiring::Coils { pins, sequence } => {
                let coils = MotorSetup::coils_on(pins[0], sequence_of(sequence));
                (wired.step_pin, wired.dir_pin) = (coils.step_pin, coils.dir_pin);
            }
        }
        setup.motors.push(wired);
    }
    setup
}

fn pull_in_ticks(motor: &Motor, hz: u64) -> u64 {
    if motor.limits.pull_in > 0.0 { (hz as f64 / motor.limits.pull_in) as u64 } else { u64::MAX }
}

/// Which line a pin is.
fn place_of(lines: &[Line], pin: u8) -> Option<u8> {
    let name = format!("pin{pin}");
    lines.iter().position(|line| line.names.contains(&name)).map(|line| line as u8)
}

/// The native board for a program.
fn native(program: &Program, new: fn(&Config) -> Result<Native, ConfigError>) -> Result<Native, ConfigError> {
    let hold = DriverTiming::longest(&program.motors).ticks(program.board.tick_hz).dir_hold;
    Ok(new(&config(program))?.with_dir_hold(u32::try_from(hold).unwrap_or(u32::MAX)))
}

/// Its lines are in the order of the program's traces.
fn config(program: &Program) -> Config {
    let lines = lines::of(program);
    let hz = program.board.tick_hz;
    let motors = program
        .motors
        .iter()
        .map(|motor| MotorConfig { wiring: wiring(motor, &lines, program), pull_in_ticks: pull_in_ticks(motor, hz) });
    Config { fraction_bits: program.board.fraction_bits, motors: motors.collect() }
}

fn wiring(motor: &Motor, lines: &[Line], program: &Program) -> Wiring {
    let tick_hz = program.board.tick_hz;
    // Every pin of a program has a line; a board refuses the number that stands for none.
    let line = |pin: u8| place_of(lines, pin).unwrap_or(u8::MAX);
    match motor.wiring {
        program::Wiring::StepDir { step, dir, forward_high, .. } => {
            let timing = motor.timing.ticks(tick_hz);
            Wiring::StepDir {
                step: line(step),
                dir: line(dir),
                forward_high,
                pulse_ticks: timing.pulse_high.max(1) as u32,
                setup_ticks: timing.dir_setup as u32,
            }
        }
        program::Wiring::Coils { pins, sequence } => {
            // Within 2^31 on every board: `LONGEST_IDLE_MS`.
            let release_ticks = program.idle_ms.map(|ms| (u64::from(ms) * tick_hz / 1000) as u32);
            Wiring::Coils { lines: pins.map(line), sequence: sequence_of(sequence), release_ticks }
        }
    }
}

const fn sequence_of(sequence: CoilSequence) -> Sequence {
    match sequence {
        CoilSequence::Wave => Sequence::Wave,
        CoilSequence::Full => Sequence::Full,
        CoilSequence::Half => Sequence::Half,
    }
}
