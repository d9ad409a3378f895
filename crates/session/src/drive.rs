//! Runs a prepared motion on the native board, a virtual board or a real one: connects, streams it by a [`Session`], and compares the counts.
//! Nothing is collected on the way, so that a motion may last for days.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, TryRecvError, channel};

use pulsetrain_board::native::{ConfigError, Faults};
use pulsetrain_board::profiles::{Role, name_of};
use pulsetrain_board::remote::{image_name, in_words};
use pulsetrain_board::{
    AtRest, BoardKind, Config, Edge, Leased, LinkError, MotorConfig, Native, Observer, Port, Remote, RemoteError,
    ScheduledStep, Setup, VirtualBoard, Wiring, WithReference,
};
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::message::{Cause, MotorSetup, image};
use pulsetrain_core::wire::{Baud, Reason};
use pulsetrain_motion::program::{self, CoilSequence, DriverTiming, Motor, Program};
use pulsetrain_motion::time::Rate;
use pulsetrain_motion::{Time, human};
use pulsetrain_plan::{PlanError, Refused, Settings};
use pulsetrain_trace::{Line, lines};

use crate::control::{Command, Ended, Event, Knowledge, Positions, Status};
use crate::estimate;
use crate::fade::{Change, Shift, Transition};
use crate::lateness::{Edges, Lateness, Meter};
use crate::pause::{Ceiling, Limited};
use crate::plans::{Planned, Plans};
use crate::prepare::{Prepared, WORST_CLOCK_PPM};
use crate::{Report, Session, SessionError, Tempo};

/// Why a run did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The session could not begin or go on.
    #[error(transparent)]
    Session(SessionError),
    /// The planner refuses a part of the motion that was not planned before its first step.
    #[error("motor {motor}: {error}")]
    Plan {
        /// The motor's name.
        motor: String,
        /// Which limit, and where.
        error: PlanError,
    },
    /// The native board cannot be wired so.
    #[error("the native board cannot run this motion: {0}")]
    Config(#[from] ConfigError),
    /// The board has no emulated chip.
    #[error("there is no virtual {board}")]
    NoVirtualBoard {
        /// Its name in sentences.
        board: &'static str,
    },
    /// The board at the other end of the line.
    #[error(transparent)]
    Remote(#[from] RemoteError),
    /// The host was too slow: the next part of the plan was not sent in time.
    #[error(
        "This computer was too slow: at {at_s:.3} s the board had no more plan for motor {motor}, and stopped the motors gently. More came \
         {:.1} ms too late.", 1e3 * .late_s
    )]
    TooLate {
        /// The motor whose plan on the board ended soonest.
        motor: String,
        /// From when on the motors brake, s of the laws.
        at_s: f64,
        /// How long after that the host filled the queues again, s.
        late_s: f64,
    },
    /// A queue of the board is too short: it ran empty before more could be there, or it does not hold the beginning of a plan.
    #[error(
        "at {at_s:.3} s the board's queue for motor {motor}, which takes {capacity} bytes, was used up before more of the plan could be there"
    )]
    QueueTooShort {
        /// The motor of that queue.
        motor: String,
        /// When it ran empty, s of the laws.
        at_s: f64,
        /// Bytes that the empty queue takes.
        capacity: usize,
        /// Bytes of each motor's queue with 1, 2, … motors, by the table of boards.
        queue_bytes: Vec<u32>,
    },
    /// The board dropped steps: a fault of the planner or the board, not of the motion.
    #[error("motor {motor} missed steps on the board `{board}`; please report this motion file")]
    Missed {
        /// The board's name.
        board: String,
        /// The motor's name.
        motor: String,
    },
    /// The reference (a native board that gets the same data) lost some of them: a fault of this program, not of the motion.
    #[error(
        "The simulated copy of board `{board}` lost data that the board took, so this run cannot be judged. This is our fault; please report \
         this motion file."
    )]
    Reference {
        /// The board's name.
        board: String,
    },
    /// The run failed while the motors were in motion.
    #[error("{why}\n{positions}")]
    Halted {
        /// Why they did not come to the motion's end.
        why: Box<DriveError>,
        /// When the host noticed it, s of the laws.
        seen_s: f64,
        /// Where the motors are.
        positions: Positions,
        /// What the user can do.
        advice: &'static str,
    },
}

impl DriveError {
    /// What the user can do, if something is known to help.
    #[must_use]
    pub const fn advice(&self) -> Option<&'static str> {
        match self {
            DriveError::Halted { advice, .. } => Some(advice),
            _ => None,
        }
    }

    /// This error as an event.
    fn event(&self) -> Event {
        let (why, positions) = match self {
            DriveError::Halted { why, positions, .. } => (why.to_string(), Some(positions.clone())),
            other => (other.to_string(), None),
        };
        Event::Failed { why, at_s: self.at_s(), positions, advice: self.advice().map(str::to_owned) }
    }

    /// This error, with the positions of the motors.
    pub(crate) fn halted(self, seen_s: f64, positions: Positions) -> DriveError {
        DriveError::Halted { why: Box::new(self), seen_s, advice: positions.advice(), positions }
    }

    /// When the motors began to brake, s of the laws, if that is known.
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

    /// A session's error with the motor's name instead of its index.
    fn of(program: &Program, error: SessionError) -> DriveError {
        let name = |motor: usize| program.motors.get(motor).map_or_else(String::new, |motor| motor.name.clone());
        match error {
            SessionError::Lost(error) => DriveError::Remote(error),
            SessionError::Plan(Refused { motor, error }) => DriveError::Plan { motor: name(motor), error },
            SessionError::Law { motor, error } => DriveError::Plan { motor: name(motor), error: error.into() },
            SessionError::Stopped { motor, at_s, late_s } => DriveError::TooLate { motor: name(motor), at_s, late_s },
            SessionError::QueueTooShort { motor, at_s, capacity } => {
                let queue_bytes = program.board.profile.queue_bytes.to_vec();
                DriveError::QueueTooShort { motor: name(motor), at_s, capacity, queue_bytes }
            }
            error => DriveError::Session(error),
        }
    }
}

/// A prepared motion on a board, at the tick before its laws begin.
pub struct Driven<B> {
    session: Session<B>,
    program: Arc<Program>,
    /// The board's tick at which the laws begin.
    zero: u64,
    /// The lines of its traces, with their levels when the laws begin.
    pub lines: Vec<Line>,
    /// By the board's number of a line (native) or a pin: its index in `lines`; `None` for a pin that the motion does not use.
    places: Vec<Option<u8>>,
    /// By index in `lines`: the motor whose STEP it is.
    steppers: Vec<Option<usize>>,
    /// `None` of a real board: its edges are not known, and steps would wait for them for ever.
    meter: Option<Meter>,
    /// The order to brake, once there was one.
    stop: Option<StopOrder>,
    /// The tick from which the next status is due.
    status_due: u64,
    /// The proof of what comes next, while it is not complete.
    proof: Option<Plans>,
    /// How much of the motion was proven before, s.
    proven_s: f64,
    /// Moves that are proven in each step of the run.
    proof_moves: u32,
    /// Seconds of the motion that are always proven ahead of the motors.
    proof_ahead_s: f64,
    /// A change that waits for another one to begin.
    waiting: Option<Command>,
    /// What the proof found, after the motors were stopped for it.
    refused: Option<Refused>,
    /// Whether the session goes on after the motion's end.
    stays: bool,
    /// How many times in a second of the board's time a step ends; `None`: as is usual.
    looks_per_s: Option<u64>,
}

/// An order to brake.
#[derive(Clone, Copy, Debug)]
struct StopOrder {
    /// Whether it came before the last step was made.
    cuts_motion: bool,
}

impl Driven<Native> {
    /// Sends the beginning of the motion to the native board, and lets time pass to the tick before the laws begin.
    ///
    /// # Errors
    /// When the board cannot be wired so. When the plan is refused, which [`Prepared::plan`] would have found before.
    pub fn native(prepared: &Prepared) -> Result<Driven<Native>, DriveError> {
        let program = &prepared.program;
        let lines = lines::of(program);
        let places = (0..).map(Some).take(lines.len()).collect();
        Driven::begin(native(program, Native::new)?, prepared, lines, places, Some(Edges::default()), None)
    }
}

impl Driven<WithReference<Remote<Box<dyn VirtualBoard>>>> {
    /// As [`Driven::native`], on a virtual board. An Uno's line runs at `baud`. A Pico is on its own USB, where `baud` only sets how long the host
    /// expects bytes to take.
    ///
    /// # Errors
    /// As [`Driven::native`]; when the board has no emulated chip, or the firmware refuses the configuration.
    pub fn on_virtual(kind: BoardKind, prepared: &Prepared, baud: Baud) -> Result<Self, DriveError> {
        // A new board had no session before. With a constant session number all runs are equal to the cycle.
        let port = kind.virtual_board(Role::Plans).ok_or(DriveError::NoVirtualBoard { board: kind.title() })?;
        Driven::with(prepared, |program| connect_as(port, program, baud, 1))
    }
}

impl<P: Port> Driven<WithReference<Remote<P>>> {
    /// As [`Driven::native`], on the board at the other end of a port, at `baud`.
    ///
    /// # Errors
    /// As [`Driven::native`], and when nobody answers or the firmware refuses the configuration.
    pub fn at(prepared: &Prepared, port: P, baud: Baud) -> Result<Driven<WithReference<Remote<P>>>, DriveError> {
        Driven::with(prepared, |program| connect(port, program, baud))
    }

    /// As [`Driven::on_board`], on a board that the function `connect` takes and sets up: [`connect`], or [`connect_as`].
    ///
    /// # Errors
    /// As [`Driven::at`].
    pub fn with(
        prepared: &Prepared,
        connect: impl FnOnce(&Program) -> Result<Remote<P>, RemoteError>,
    ) -> Result<Driven<WithReference<Remote<P>>>, DriveError> {
        Driven::on_board(prepared, connect(&prepared.program)?, None)
    }

    /// As [`Driven::at`], on a board that [`connect`] took and set up. The laws begin at the board's tick `begin`; `None`: as soon as they can.
    ///
    /// # Errors
    /// As [`Driven::at`]; when `begin` is too soon, or more than [`FARTHEST_BEGIN_S`](crate::FARTHEST_BEGIN_S) ahead.
    pub fn on_board(
        prepared: &Prepared,
        remote: Remote<P>,
        begin: Option<u64>,
    ) -> Result<Driven<WithReference<Remote<P>>>, DriveError> {
        let program = &prepared.program;
        let edges = remote.port().has_edges().then(|| Edges::of(program));
        let lines = lines::of(program);
        let place = |pin: u8| place_of(&lines, pin);
        let places = (0..=*program.board.profile.pins.end()).map(place).collect();
        let board = WithReference::new(remote, native(program, Native::unbounded)?);
        Driven::begin(board, prepared, lines, places, edges, begin)
    }

    /// The board at the other end of the line: its measurements, and the Info of its firmware.
    pub fn board_mut(&mut self) -> &mut Remote<P> {
        self.session.board_mut().board_mut()
    }

    /// Ends the session with the board, and returns the port. Motors that move go on to their planned stop. The next host need not wait for this
    /// one's silence to time out.
    pub fn close(self) -> P {
        self.session.into_board().into_board().close()
    }
}

/// Takes the board at the other end of a port and sets it up for a program.
///
/// # Errors
/// When nobody answers, or the board refuses.
pub fn connect<P: Port>(port: P, program: &Program, baud: Baud) -> Result<Remote<P>, RemoteError> {
    connect_while(port, program, baud, || true)
}

/// As [`connect`]. While motors still move for an earlier host, this calls `goes_on` again and again, and waits as long as it returns true.
///
/// # Errors
/// As [`connect`], and [`RemoteError::StillMoving`] once `goes_on` returns false. The board is left as it was after any refusal.
pub fn connect_while<P: Port>(
    port: P,
    program: &Program,
    baud: Baud,
    goes_on: impl FnMut() -> bool,
) -> Result<Remote<P>, RemoteError> {
    set_up_board(port, program, baud, session_number(), goes_on)
}

/// As [`connect`], with a given session number. It must differ from that of the session before it on the same board.
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

/// Sets the line's rate, waits for motors that still move for an earlier host as [`connect_while`] does, and configures the board's pins.
///
/// # Errors
/// When the board is lost or refuses. The session with it is ended then (by Bye).
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
            // Without Bye the board would count this host as lost: it would stop motors that still move at once, and answer nobody until then.
            remote.close();
            Err(error)
        }
    }
}

/// Checks that the board is the one that the program is planned for, with the firmware for plans.
fn check_board<P: Port>(remote: &mut Remote<P>, program: &Program) -> Result<(), RemoteError> {
    let (board, info) = (&program.board, remote.info());
    // A calibrated plan has the board's tick rate as the host's clock measured it, not the nominal one.
    let off_hz = u64::from(info.tick_hz).abs_diff(board.tick_hz) as f64;
    if off_hz > board.tick_hz as f64 * WORST_CLOCK_PPM * 1e-6
        || u32::from(info.fraction_bits) != board.registers.fraction_bits
    {
        return Err(RemoteError::OtherBoard {
            is: name_of(info),
            wanted: board.name.clone(),
            wanted_hz: board.tick_hz,
            wanted_bits: board.registers.fraction_bits,
        });
    }
    match info.image {
        0 | image::PLANS => Ok(()),
        other => Err(RemoteError::OtherImage { is: image_name(other), wanted: image_name(image::PLANS) }),
    }
}

/// Changes the line's rate to `baud`, if it has another one.
fn at_rate<P: Port>(mut remote: Remote<P>, baud: Baud, number: u32) -> Result<Remote<P>, RemoteError> {
    if baud == remote.link().baud() {
        return Ok(remote);
    }
    match remote.set_baud(baud) {
        Ok(_) => Ok(remote),
        // Nothing came through at the new rate. Both ends fall back to the first rate, and stay there.
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

/// A session number: differs from those before it in this process, and most likely from those of other processes.
#[must_use]
pub fn session_number() -> u32 {
    static SESSIONS: AtomicU32 = AtomicU32::new(0);
    let own = SESSIONS.fetch_add(1, Ordering::Relaxed);
    // A page in a browser has no process: its sessions are told apart among themselves.
    let process = if cfg!(target_family = "wasm") { 0 } else { std::process::id() };
    process.wrapping_mul(0x9e37_79b1).wrapping_add(own)
}

impl<B: Leased> Driven<B> {
    fn begin(
        board: B,
        prepared: &Prepared,
        mut lines: Vec<Line>,
        places: Vec<Option<u8>>,
        edges: Option<Edges>,
        begin: Option<u64>,
    ) -> Result<Driven<B>, DriveError> {
        let program = Arc::new(prepared.program.clone());
        let of = |error| DriveError::of(&program, error);
        let stepper = |line: &Line| {
            let is_step = |motor: &Motor| line.names.contains(&format!("{}.step", motor.name));
            program.motors.iter().position(is_step)
        };
        let steppers = lines.iter().map(stepper).collect();
        let meter = edges.map(|edges| Meter::new(program.motors.len(), edges.constant_ticks.into()));
        let session = match begin {
            Some(tick) => Session::begin_at(board, Arc::clone(&program), tick),
            None => Session::new(board, Arc::clone(&program)),
        };
        let mut session = session.map_err(of)?;
        session.hold_to_line(prepared.line.clone());
        // If the first step comes soon after the start, its DIR edge comes before the start: it becomes the line's initial level.
        let mut level = |edge: Edge| {
            if let Some(Some(place)) = places.get(usize::from(edge.line)) {
                lines[usize::from(*place)].initial = edge.level;
            }
        };
        session.advance(session.zero() - 1, &mut level).map_err(of)?;
        let zero = session.zero();
        Ok(Driven {
            session,
            program,
            zero,
            lines,
            places,
            steppers,
            meter,
            stop: None,
            status_due: 0,
            proof: None,
            proven_s: 0.0,
            proof_moves: PROOF_MOVES,
            proof_ahead_s: PROOF_AHEAD_MIN_S,
            waiting: None,
            refused: None,
            stays: false,
            looks_per_s: None,
        })
    }

    /// Lets the session go on after the motion's end: the motors rest, and can change to other laws. Only an order to stop ends it.
    #[must_use]
    pub fn staying(mut self) -> Driven<B> {
        self.stays = true;
        self
    }

    /// Lets each [`step`](Driven::step) take a hundredth of a second of the board's time on every board: commands are obeyed sooner, and a virtual board
    /// takes more of this computer.
    #[must_use]
    pub fn looking_often(mut self) -> Driven<B> {
        self.looks_per_s = Some(LOOKS_PER_S);
        self
    }

    /// The board's time, ticks.
    pub fn now(&self) -> u64 {
        self.session.board().now()
    }

    /// How far the laws' time is, at most.
    pub fn law_time(&self) -> Time {
        self.session.law_time()
    }

    /// Whether all motors have come to the ends of the laws that they follow: [`Session::has_ended`].
    pub fn has_ended(&self) -> bool {
        self.session.has_ended()
    }

    /// Whether a change of the laws is under way.
    pub fn is_changing(&self) -> bool {
        self.session.is_changing()
    }

    /// Whether the motors braked though nobody asked for it. [`Driven::step`] may not have said so, if a change has found it first.
    #[must_use]
    pub const fn has_braked(&self) -> bool {
        self.stop.is_none() && self.session.is_stopped()
    }

    /// What changes of an endless constant speed have added to each motor's way: [`Session::shifts`].
    #[must_use]
    pub fn shifts(&self) -> Option<Vec<Shift>> {
        self.session.shifts()
    }

    /// Where each motor rests after it has braked, steps.
    ///
    /// # Errors
    /// While a motor brakes.
    pub fn resting(&mut self) -> Result<Vec<f64>, SessionError> {
        let now = self.session.board().now();
        (0..self.program.motors.len()).map(|motor| Ok(self.session.state(motor, now)?.theta)).collect()
    }

    /// Sets the laws' time while all motors rest: [`Session::set_law_time`].
    ///
    /// # Errors
    /// As [`Session::set_law_time`].
    pub fn set_law_time(&mut self, time: Time, shifts: Option<&[Shift]>) -> Result<(), SessionError> {
        self.check_not_stopped()?;
        self.session.set_law_time(time, shifts)
    }

    /// Why the session refuses something, with motors by name and times in seconds.
    #[must_use]
    pub fn why(&self, error: SessionError) -> String {
        why(&self.program, self.zero, error)
    }

    /// Lets the motors change to other laws while they move: [`Session::change_to`]. Returns when they leave the old laws and when they follow the new
    /// ones, s of the motion.
    ///
    /// # Errors
    /// As [`Session::change_to`]. The motion goes on after an error, but where [`Driven::step`] says otherwise.
    pub fn change_to(&mut self, change: &Change) -> Result<(f64, f64), SessionError> {
        self.change_with_tempo(change, None).map(|(times, _)| times)
    }

    /// As [`Driven::change_to`], with another tempo from the same tick on: [`Session::change_with_tempo`]. Returns [`Event::Tempo`] too, if there is one.
    ///
    /// # Errors
    /// As [`Driven::change_to`].
    pub fn change_with_tempo(
        &mut self,
        change: &Change,
        tempo: Option<Rate>,
    ) -> Result<((f64, f64), Option<Event>), SessionError> {
        self.check_not_stopped()?;
        let (changed, tempo) = self.session.change_with_tempo(change, tempo)?;
        // It proves laws that are no longer followed.
        self.proof = None;
        let tempo = tempo.map(|Tempo { rate, from, ceiling }| Event::Tempo {
            rate: rate.get(),
            from_s: self.seconds_at(from),
            ceiling: ceiling.map(|ceiling| named(&change.program, ceiling)),
        });
        Ok((self.seconds_of(changed), tempo))
    }

    /// Changes, commands to pause among them, begin at this tick of the board, if it is not past: [`Session::hold_changes_until`].
    pub fn hold_changes_until(&mut self, tick: Option<u64>) {
        self.session.hold_changes_until(tick);
    }

    /// The first tick at which a change can be made now.
    pub fn earliest(&self) -> u64 {
        self.session.earliest()
    }

    /// The laws' time at a tick, if the tempo stays as it is.
    pub fn law_time_at(&self, tick: u64) -> Time {
        self.session.law_time_at(tick)
    }

    /// The board's tick at a time of the motion, s.
    pub fn tick_at(&self, at_s: f64) -> u64 {
        // The cast stops at the bounds of u64.
        self.zero.saturating_add((at_s * self.program.board.tick_hz as f64) as u64)
    }

    /// The time of the motion at a tick of the board, s.
    pub fn seconds_at(&self, tick: u64) -> f64 {
        tick.saturating_sub(self.zero) as f64 / self.program.board.tick_hz as f64
    }

    /// Lets motors that braked since the host or the line was too slow join their laws again: [`Session::rejoin`]. [`Driven::step`] has returned an
    /// error then, and can be called again.
    ///
    /// # Errors
    /// As [`Session::rejoin`].
    pub fn rejoin(&mut self) -> Result<(f64, f64), SessionError> {
        self.check_not_stopped()?;
        let changed = self.session.rejoin()?;
        self.proof = None;
        Ok(self.seconds_of(changed))
    }

    /// The motor and its limit that a change would break, if there is one: [`Session::ceiling_of`].
    ///
    /// # Errors
    /// As [`Session::ceiling_of`].
    pub fn ceiling_of(&self, change: &Change) -> Result<Option<String>, SessionError> {
        Ok(self.session.ceiling_of(change)?.map(|ceiling| named(&change.program, ceiling)))
    }

    /// As [`Driven::ceiling_of`], at a tempo that comes with the change: [`Session::ceiling_at`].
    ///
    /// # Errors
    /// As [`Session::ceiling_of`].
    pub fn ceiling_at(&self, change: &Change, tempo: Rate) -> Result<Option<String>, SessionError> {
        Ok(self.session.ceiling_at(change, tempo)?.map(|ceiling| named(&change.program, ceiling)))
    }

    /// After an order to stop nothing moves again.
    fn check_not_stopped(&self) -> Result<(), SessionError> {
        let (at, latest) = (self.session.earliest(), self.session.committed_until());
        if self.stop.is_some() { Err(SessionError::Late { at, latest }) } else { Ok(()) }
    }

    /// When a transition begins and ends, s of the motion.
    fn seconds_of(&self, Transition { from, until }: Transition) -> (f64, f64) {
        (self.seconds_at(from), self.seconds_at(until))
    }

    /// The board's tick at which the laws begin.
    #[must_use]
    pub const fn zero(&self) -> u64 {
        self.zero
    }

    /// Proves the rest of a motion while it runs, after [`Prepared::prove_first`] has proven its first `proven_s` seconds. The proof is always 5 s or more ahead (1 s, if it takes long) of the
    /// motors, and soon an hour. If it finds a part that the planner refuses, the motors brake at once.
    ///
    /// # Errors
    /// When the beginning cannot be planned at all, which [`Prepared::prove_first`] would have found.
    pub fn proving(mut self, prepared: &Prepared, proven_s: f64) -> Result<Driven<B>, DriveError> {
        let refused = |refused: Refused| DriveError::of(&prepared.program, refused.into());
        self.proof = Some(prepared.plans().map_err(refused)?);
        self.proven_s = proven_s;
        self.proof_moves = estimate::moves_in(PROOF_STEP_S, prepared).clamp(1, PROOF_MOVES);
        let ahead_s = PROOF_AHEAD_WORK_S / estimate::second_s(prepared);
        self.proof_ahead_s = ahead_s.clamp(PROOF_AHEAD_HEAVY_S, PROOF_AHEAD_MIN_S);
        Ok(self)
    }

    /// What was planned so far for each motor. At the end of a motion that is all of it.
    #[must_use]
    pub fn planned(&self) -> Vec<Planned> {
        self.session.planned()
    }

    /// Runs the motion to its end. The observer's ticks count from the laws' time 0; `events` gets a status some 20 times a second.
    ///
    /// # Errors
    /// When the motion stopped before its end, or the board and the host count differently, which is a fault of this program.
    pub fn run(&mut self, observer: &mut impl Observer, events: impl FnMut(Event)) -> Result<Ended, DriveError> {
        let (_, none) = channel();
        self.run_with(&none, observer, events)
    }

    /// As [`Driven::run`], and obeys commands on the way. A paused motion ends when the sender of `commands` is dropped.
    ///
    /// # Errors
    /// As [`Driven::run`].
    pub fn run_with(
        &mut self,
        commands: &Receiver<Command>,
        observer: &mut impl Observer,
        mut events: impl FnMut(Event),
    ) -> Result<Ended, DriveError> {
        let mut inbox = Inbox { commands, waiting: VecDeque::new(), is_open: true };
        loop {
            let command = inbox.next();
            let no_resume = command.is_none() && !inbox.is_open && self.session.is_paused();
            let command = if no_resume && is_last_step_past(&self.session) { Some(Command::Stop) } else { command };
            if let Some(ended) = self.step(command, observer, &mut events)? {
                return Ok(ended);
            }
        }
    }

    /// Obeys a command, lets a twentieth of a second of the board's time pass (a hundredth on a real board), and reports the status 20 times a second.
    /// `Some` when the motion has come to its end;
    /// the caller steps no further then. A program without threads, such as a page in a browser, calls this instead of [`Driven::run_with`].
    ///
    /// The last event is [`Event::Ended`] or [`Event::Failed`].
    ///
    /// # Errors
    /// As [`Driven::run`].
    pub fn step(
        &mut self,
        command: Option<Command>,
        observer: &mut impl Observer,
        mut events: impl FnMut(Event),
    ) -> Result<Option<Ended>, DriveError> {
        let stepped = self.try_step(command, observer, &mut events);
        match &stepped {
            Ok(Some(ended)) => events(Event::Ended(ended.clone())),
            Ok(None) => {}
            Err(error) => events(error.event()),
        }
        stepped
    }

    fn try_step(
        &mut self,
        command: Option<Command>,
        observer: &mut impl Observer,
        events: &mut impl FnMut(Event),
    ) -> Result<Option<Ended>, DriveError> {
        let (zero, tick_hz) = (self.zero, self.program.board.tick_hz);
        let seconds = |tick: u64| tick.saturating_sub(zero) as f64 / tick_hz as f64;
        let is_over = match self.session.is_paused() {
            // A paused session sends nothing, and so does not notice a lost line.
            true => self.session.board().lost().is_some(),
            false if self.stays && self.stop.is_none() => self.session.board().lost().is_some(),
            false => self.session.is_complete() && is_last_step_past(&self.session),
        };
        if is_over {
            return self.finish(observer, events).map(Some);
        }
        // A change that had to wait is tried again. One that came after it takes its place.
        let command = match (command, self.waiting.take()) {
            (None, waiting) => waiting,
            (command, _) => command,
        };
        let command = match command {
            Some(Command::StopNow) => command,
            _ if self.prove_more() => command,
            _ => Some(Command::Stop),
        };
        let Driven { session, program, steppers, meter, places, stop, status_due, waiting, .. } = self;
        let mut since = Since { zero, places, steppers, meter, observer };
        let (now, was_paused, was_over) = (session.board().now(), session.is_paused(), session.is_over);
        let obeyed = match command {
            None => Ok(()),
            Some(Command::Stop) if stop.is_some() => Ok(()),
            Some(Command::Stop) => {
                let last = session.last_step().filter(|_| session.is_complete());
                session.stop().map(|at| {
                    // If the whole plan was sent, the last step may have been made before the board got the order.
                    *stop = Some(StopOrder { cuts_motion: was_paused || last.is_none_or(|last| at <= last) });
                    events(Event::Stopping { at_s: seconds(at) });
                })
            }
            Some(Command::StopNow) => {
                let stopped = session.board_mut().stop_now(now, &mut since);
                if let Some(error) = session.board().lost().cloned() {
                    let mut report = session.run(&mut since, |tick| events(Event::Progress { at_s: seconds(tick) }));
                    report.stop_unanswered = true;
                    return Err(DriveError::from(error).halted(seconds(now), self.positions(&report).0));
                }
                let (positions, uncertain) = (stopped.positions.clone(), stopped.uncertain.clone());
                events(Event::StoppedAtOnce { positions, uncertain });
                let uncertain = Some(stopped.uncertain);
                return Ok(Some(Ended { counted: stopped.positions, stopped: true, uncertain }));
            }
            Some(command @ (Command::Pause | Command::Resume | Command::Tempo { .. })) => {
                let done = match command {
                    Command::Tempo { rate } => Rate::of(rate).map_or(Err(SessionError::NoTempo), |rate| {
                        session.set_tempo(rate).map(|Tempo { rate, from, ceiling }| {
                            let ceiling = ceiling.map(|ceiling| named(session.playback.program(), ceiling));
                            Event::Tempo { rate: rate.get(), from_s: seconds(from), ceiling }
                        })
                    }),
                    Command::Resume => session.resume().map(|tick| Event::Resuming { full_speed_s: seconds(tick) }),
                    _ => session.pause().map(|rests| Event::Pausing { rests_s: seconds(rests) }),
                };
                match done {
                    Ok(event) => {
                        events(event);
                        Ok(())
                    }
                    // The change was made, and the motion cannot go on after it.
                    Err(error) if session.is_over && !was_over => Err(error),
                    // Another change has not begun yet.
                    Err(SessionError::Waiting { .. }) => {
                        *waiting = Some(command);
                        Ok(())
                    }
                    // Nothing was changed.
                    Err(error) => {
                        events(Event::Refused { command, why: why(program, zero, error) });
                        Ok(())
                    }
                }
            }
        };
        let usual = if since.meter.is_some() { STATUSES_PER_S } else { LOOKS_PER_S };
        let looks_per_s = self.looks_per_s.unwrap_or(usual);
        let soon = now + tick_hz / looks_per_s;
        let last = session.last_step().filter(|last| session.is_complete() && *last >= now);
        let until = last.map_or(soon, |last| soon.min(last));
        if let Err(failure) = obeyed.and_then(|()| session.advance(until, &mut since)) {
            let seen_s = seconds(session.board().now());
            // The motors brake: wait until they rest.
            let report = session.run(&mut since, |tick| events(Event::Progress { at_s: seconds(tick) }));
            let (positions, stop) = self.positions(&report);
            // A board that stopped by itself refuses what comes after it. The user needs the reason of the stop, not that refusal.
            let failure = match (DriveError::of(&self.program, failure), stop) {
                (DriveError::Remote(RemoteError::Refused { reason: Reason::NotArmed, .. }), Some(cause)) => {
                    RemoteError::Stopped { cause }.into()
                }
                (failure, _) => failure,
            };
            return Err(failure.halted(seen_s, positions));
        }
        let now = session.board().now();
        events(Event::Progress { at_s: seconds(now) });
        // The last one shows where the motors are at the end.
        if now < *status_due && last.is_none_or(|last| now < last) {
            return Ok(None);
        }
        *status_due = now + tick_hz / STATUSES_PER_S;
        let lateness = since.meter.as_ref().map(Meter::so_far);
        events(Event::Status(Status { lateness, ..session.status() }));
        Ok(None)
    }

    /// Goes on with the proof. Returns false when it finds that the motion cannot go on to its end.
    fn prove_more(&mut self) -> bool {
        if self.stop.is_some() {
            self.proof = None;
        }
        let Some(proof) = &mut self.proof else { return true };
        let at_s = self.session.law_time().seconds();
        let ahead_s = proof.planned_s().map_or(0.0, |planned_s| planned_s.max(self.proven_s) - at_s);
        let so_far = match ahead_s {
            _ if ahead_s < self.proof_ahead_s => proof.plan_some(at_s + self.proof_ahead_s, u32::MAX),
            ..PROOF_AHEAD_MAX_S => proof.plan_some(at_s + PROOF_AHEAD_MAX_S, self.proof_moves),
            _ => Ok(true),
        };
        let so_far = match so_far {
            Ok(false) => proof.brake().map(|()| false),
            other => other,
        };
        match so_far {
            Ok(true) => true,
            Ok(false) => {
                self.proof = None;
                true
            }
            Err(refused) => {
                (self.proof, self.refused) = (None, Some(refused));
                false
            }
        }
    }

    /// Waits until the motors rest after their last step, and compares the counts.
    fn finish(&mut self, observer: &mut impl Observer, events: &mut impl FnMut(Event)) -> Result<Ended, DriveError> {
        let (zero, tick_hz) = (self.zero, self.program.board.tick_hz);
        let seconds = |tick: u64| tick.saturating_sub(zero) as f64 / tick_hz as f64;
        let Driven { session, steppers, meter, places, stop, .. } = self;
        let stopped = stop.is_some_and(|stop| stop.cuts_motion);
        let mut since = Since { zero, places, steppers, meter, observer };
        let report = session.run(&mut since, |tick| events(Event::Progress { at_s: seconds(tick) }));
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
            // A board that stopped after the whole plan was sent had nothing to refuse: only its count shows it.
            let (positions, stop) = self.positions(&report);
            let why = match stop {
                Some(cause) => RemoteError::Stopped { cause }.into(),
                None => DriveError::Missed { motor: motor.name.clone(), board: self.program.board.name.clone() },
            };
            return Err(why.halted(seen_s, positions));
        }
        // This comes last: errors of the board are more useful than one of the reference.
        if !self.session.board().record_is_complete() {
            return Err(DriveError::Reference { board: self.program.board.name.clone() });
        }
        if let Some(refused) = self.refused.take() {
            let positions = self.positions(&report).0;
            return Err(DriveError::of(&self.program, refused.into()).halted(seen_s, positions));
        }
        Ok(Ended { counted: report.counted, stopped, uncertain: None })
    }

    /// Where the motors are after a run that failed, and the cause if the board stopped by itself.
    fn positions(&mut self, report: &Report) -> (Positions, Option<Cause>) {
        let last_reported = self.session.board().positions();
        let mut stop = None;
        let (counts, by) = match self.session.board_mut().final_report() {
            Ok(AtRest { reset: Some(reset), .. }) => {
                (last_reported, Knowledge::LastReport { reset: in_words(reset).to_owned() })
            }
            Ok(AtRest { positions, last_stop, .. }) => match last_stop {
                Cause::None | Cause::Finished | Cause::Braked => (positions, Knowledge::Counted),
                cause => {
                    stop = Some(cause);
                    let brakes = matches!(
                        cause,
                        Cause::HostLost
                            | Cause::Lapsed
                            | Cause::RanDry
                            | Cause::BadItem
                            | Cause::CheckFailed
                            | Cause::StepMissed
                    );
                    (positions, if brakes { Knowledge::Counted } else { Knowledge::StoppedAtOnce })
                }
            },
            Err(_) if report.stop_unanswered => (last_reported, Knowledge::StopUnanswered),
            Err(_) => {
                let mut possible = report.replayed_otherwise.iter().chain([&report.replayed]).cloned();
                (possible.next().unwrap_or_default(), Knowledge::Replayed { or: possible.collect() })
            }
        };
        let names = self.program.motors.iter().map(|motor| motor.name.clone());
        (Positions { motors: names.zip(counts).collect(), by }, stop)
    }

    /// How late the STEP edges of the run were, against their scheduled ticks. To be called once, after the run. `None` if the edges are not known.
    pub fn lateness(&mut self) -> Option<Lateness> {
        self.meter.take().map(Meter::finish)
    }
}

/// Why a session refuses something, with motors by name and times in seconds of a motion that began at the tick `zero`.
fn why(program: &Program, zero: u64, error: SessionError) -> String {
    let time = |tick: u64| {
        let seconds = tick.saturating_sub(zero) as f64 / program.board.tick_hz as f64;
        human::seconds_to(seconds, 4)
    };
    match error {
        SessionError::Early { earliest, .. } => format!("{error}; {} is the earliest", time(earliest)),
        SessionError::Waiting { until, .. } => format!("{error}, from {} on", time(until)),
        SessionError::Late { latest, .. } => format!("{error}; {} is the latest", time(latest)),
        error => DriveError::of(program, error).to_string(),
    }
}

/// A motor or a machine and its limit, in words.
fn named(program: &Program, Ceiling { of, limit }: Ceiling) -> String {
    let name = match of {
        Limited::Motor(motor) => &program.motors[motor].name,
        Limited::Tip(machine) => &program.machines[machine].name,
    };
    format!("{name}: {limit}")
}

/// Commands that have come and wait to be obeyed. [`Command::StopNow`] goes before all others, and then [`Command::Stop`].
struct Inbox<'c> {
    commands: &'c Receiver<Command>,
    waiting: VecDeque<Command>,
    /// Whether a sender is left.
    is_open: bool,
}

impl Inbox<'_> {
    fn next(&mut self) -> Option<Command> {
        loop {
            match self.commands.try_recv() {
                Ok(command) => self.waiting.push_back(command),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    self.is_open = false;
                    break;
                }
            }
        }
        let place = |wanted: Command| self.waiting.iter().position(|command| *command == wanted);
        let urgent = place(Command::StopNow).or_else(|| place(Command::Stop));
        self.waiting.remove(urgent.unwrap_or(0))
    }
}

/// Whether the last step that was sent is past.
fn is_last_step_past<B: Leased>(session: &Session<B>) -> bool {
    session.last_step().is_none_or(|last| last < session.board().now())
}

/// Seconds of the motion that are always proven ahead of the motors.
const PROOF_AHEAD_MIN_S: f64 = 5.0;
/// Fewer of them are, if they take longer to plan than `PROOF_AHEAD_WORK_S`; but no fewer than these.
const PROOF_AHEAD_HEAVY_S: f64 = 1.0;
const PROOF_AHEAD_WORK_S: f64 = 0.03;
/// Seconds of the motion that the proof gets ahead of the motors, if there is time for it.
const PROOF_AHEAD_MAX_S: f64 = 3600.0;
/// Moves that are proven in each step of a run: about half a millisecond of work, a twentieth of a step at most.
const PROOF_MOVES: u32 = 400;
/// Moves of formulas of thousands of terms take longer each. There are as many as take this long, s, or one.
const PROOF_STEP_S: f64 = 0.001;

/// How many times in a second of the board's time a run reports its status, and on a virtual board takes a command.
const STATUSES_PER_S: u64 = 20;
/// How many times in a second a run on a real board takes a command: motors begin to brake 100 ms after `pulsetrain stop` at most.
const LOOKS_PER_S: u64 = 100;

/// Passes edges and steps on to an observer: with ticks from the laws' time 0, and lines by their index in the traces. Measures lateness.
struct Since<'o, O> {
    zero: u64,
    places: &'o [Option<u8>],
    steppers: &'o [Option<usize>],
    meter: &'o mut Option<Meter>,
    observer: &'o mut O,
}

impl<O: Observer> Observer for Since<'_, O> {
    fn edge(&mut self, edge: Edge) {
        if let Some(Some(line)) = self.places.get(usize::from(edge.line)).copied() {
            let tick = edge.tick.saturating_sub(self.zero);
            if edge.level
                && let Some(motor) = self.steppers[usize::from(line)]
            {
                self.meter.iter_mut().for_each(|meter| meter.edge(motor, tick));
            }
            self.observer.edge(Edge { tick, line, level: edge.level });
        }
    }

    fn step(&mut self, step: ScheduledStep) {
        let step = ScheduledStep { tick: step.tick - self.zero, ..step };
        // Coils are left out: no single edge of theirs is a step.
        if self.steppers.contains(&Some(step.motor)) {
            self.meter.iter_mut().for_each(|meter| meter.scheduled(step.motor, step.tick));
        }
        self.observer.step(step);
    }
}

/// The configuration of a board with a firmware, for a program.
#[must_use]
pub fn setup(program: &Program) -> Setup {
    let hz = program.board.tick_hz;
    let ticks = |ticks: u64| u16::try_from(ticks).unwrap_or(u16::MAX);
    // One timing for all motors: these boards have only one. `Program::timing` gives the same for each of them.
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

/// The index of a pin's line; `None` for a pin that the program does not use.
fn place_of(lines: &[Line], pin: u8) -> Option<u8> {
    let name = format!("pin{pin}");
    lines.iter().position(|line| line.names.contains(&name)).map(|line| line as u8)
}

/// The native board for a program, made by `new`.
fn native(program: &Program, new: fn(&Config) -> Result<Native, ConfigError>) -> Result<Native, ConfigError> {
    let hold = DriverTiming::longest(&program.motors).ticks(program.board.tick_hz).dir_hold;
    Ok(new(&config(program))?.with_dir_hold(u32::try_from(hold).unwrap_or(u32::MAX)))
}

/// The native board's configuration. Its lines are in the order of the program's traces.
fn config(program: &Program) -> Config {
    let lines = lines::of(program);
    let hz = program.board.tick_hz;
    let motors = program
        .motors
        .iter()
        .map(|motor| MotorConfig { wiring: wiring(motor, &lines, program), pull_in_ticks: pull_in_ticks(motor, hz) });
    Config { fraction_bits: program.board.registers.fraction_bits, motors: motors.collect() }
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
