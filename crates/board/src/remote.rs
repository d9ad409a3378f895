//! A board at the other end of a line.
//!
//! Items that are pushed are packed, and sent when time passes ([`Board::advance`], [`Leased::switch`]). Time is the port's: a real port waits, a
//! virtual one lets its board run. Ticks are those of the board's clock, as the host has read it.
//!
//! No call waits for a lost board: pushed items are dropped, switches are refused, time goes on, and [`Remote::error`] says why. The board follows the
//! plan that it has to the end of its lease, where the motors brake.

use crate::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use crate::link::{Answer, BITS, Link, LinkError};
use crate::packer::{MAX_LEN, Packer};
use crate::{AtRest, Board, BoardClock, BoardKind, Edge, Faults, Observer, Sizer, StopReport, SwitchRefused};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease;
use pulsetrain_core::packing::Packing;
use pulsetrain_core::verbs::Verb;
use pulsetrain_core::wire::message::{
    self, Cause, Configuration, Event, Info, Measures, MotorSetup, NO_PIN, Status, flags, image, kind, limit_bytes,
};
use pulsetrain_core::wire::orders::{MAX_ORDERS, ORDER_LEN, Obeyed, Orders, order};
use pulsetrain_core::wire::{Baud, Command, MAX_FRAME, Reason, Reply, Settings, Stopped, Stored, Switched, Trimmed};
use pulsetrain_core::{Entry, Epoch, Item, Tick32};
use std::collections::VecDeque;
use std::time::Duration;

/// How often the board is asked for its status while time passes.
const STATUS_EVERY: Duration = Duration::from_millis(50);

/// A frame that is at least half full is sent if fewer than this many wait for their confirmation; an emptier one if none waits. A board has about the
/// same work with a short frame as with a long one, so short ones are filled up first.
const FRAMES_HALF_FULL: usize = 2;
/// A frame for a queue that is less than half full is sent, full or not, if fewer than this many wait for their confirmation: a busy board takes some
/// milliseconds for one.
const FRAMES_FOR_SHORT_QUEUE: usize = 3;

/// When all queues are at least this full, %, the bytes that are sent at once are limited: each byte takes an Uno's time from its steps.
const ENOUGH_PERCENT: usize = 25;
/// When all queues are at least this full, %, the limit is half of that.
const PLENTY_PERCENT: usize = 50;
/// Items for a queue that is at least this full, %, are not sent yet: more are gathered, for longer frames.
const FULL_PERCENT: usize = 75;

/// The limit for a board with plenty in its queues: one of this many parts of its queues' bytes. For a board with enough it is twice that.
const LIMIT_PARTS: usize = 15;

/// Bytes are limited, too, if what all queues have begins so much later, ms.
const SOON_MS: u64 = 15;

/// How often bytes are sent under that limit: once in a frame of USB.
const SEND_EVERY: Duration = Duration::from_millis(1);

/// How often the board is asked for room while a queue is more than half full. Not more often, as the host can compute when items leave it, and each
/// request costs an Uno as much as a frame of data.
const FREE_BYTES_EVERY: Duration = Duration::from_millis(10);

/// The longest wait for the port before the queues are looked after again.
const LONGEST_ROUND: Duration = Duration::from_millis(3);

/// The most that a reading of the board's clock is uncertain by because USB bridges hold bytes back: up to 17 ms an FTDI's, with reserve.
const BRIDGE_DELAY: Duration = Duration::from_millis(20);

/// An item counts as gone from its queue this long after the computed tick, as a fraction of a second: 1 ms covers the error of the host's clock
/// reading.
const TAKEN_MARGIN_PER_S: u64 = 1000;

/// From a frame's last byte on the line to the board's having obeyed it: USB holds bytes back for 1 ms, and a board that makes steps reads them late.
const HEARING: Duration = Duration::from_millis(2);
/// One in this many bytes on the line belongs to a frame and not to the plan in it.
const FRAME_SHARE: usize = 5;

/// The shortest wait for the port, so that a loop that waits for an estimated time always ends.
const SHORTEST_ROUND: Duration = Duration::from_micros(10);

/// How many times the clock is read before the first motion: the quickest of several answers is the most certain.
const FIRST_READINGS: usize = 8;

/// The most that a board's clock can be off, as one part in this many: 1 %, twice the tolerance of a ceramic resonator.
const CLOCK_ERROR_PART: u64 = 100;

/// How long motors that still move for an earlier host may take to come to rest.
const LONGEST_REST: Duration = Duration::from_secs(30);

/// A line to a board: sends and receives bytes, and has the host's clock.
pub trait Port: Send {
    /// Time since the port was opened.
    fn now(&self) -> Duration;

    /// Queues bytes for sending. Does not wait until they are out.
    ///
    /// # Errors
    /// When the port is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError>;

    /// Waits until `until`, or until bytes have come, and appends those to `into`.
    ///
    /// # Errors
    /// When the port is gone.
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError>;

    /// Changes the rate, once all bytes that were given to [`send`](Port::send) are out.
    ///
    /// # Errors
    /// When the port is gone, or does not have that rate.
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError>;

    /// Appends the edges of the board's pins since the last call to `into`, in board ticks. Only virtual ports have any.
    fn edges(&mut self, into: &mut Vec<Edge>) {
        let _ = into;
    }

    /// Whether the edges of the board's pins are known: not those of a real board.
    fn has_edges(&self) -> bool {
        true
    }
}

impl<P: Port + ?Sized> Port for Box<P> {
    fn now(&self) -> Duration {
        (**self).now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        (**self).send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        (**self).receive(until, into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        (**self).set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        (**self).edges(into);
    }

    fn has_edges(&self) -> bool {
        (**self).has_edges()
    }
}

/// Why a port cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortError {
    /// There is no port of that name.
    #[error("there is no port {name}{}", listed(.there_are))]
    NotThere {
        /// The name that the user gave.
        name: String,
        /// The names of the ports that there are.
        there_are: Vec<String>,
    },
    /// Another program uses the port.
    #[error("{name} is in use: close the program that has it open (an IDE's serial monitor, say)")]
    Busy {
        /// The name of the port.
        name: String,
    },
    /// The user has no permission to open the port.
    #[error("no permission to open {name}: on Linux, `sudo usermod -aG dialout $USER`, then log in again")]
    Denied {
        /// The name of the port.
        name: String,
    },
    /// The name exists, but it cannot be opened as a port.
    #[error("{name} cannot be opened as a serial port: {why}")]
    Unusable {
        /// The name that the user gave.
        name: String,
        /// The system's error.
        why: String,
    },
    /// The port was open, and is gone.
    #[error("{name} is gone: {why}")]
    Gone {
        /// The name of the port.
        name: String,
        /// The system's error.
        why: String,
    },
}

fn listed(ports: &[String]) -> String {
    if ports.is_empty() {
        "; no serial port was found: is the board plugged in?".to_owned()
    } else {
        format!("; there are {}", ports.join(", "))
    }
}

/// Why a remote board cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RemoteError {
    /// The port failed.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The link failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The board refused a command.
    #[error("the board refuses to {what}: {}", reason_text(*.reason, *.detail))]
    Refused {
        /// What it was asked to do, to follow "the board refuses to".
        what: &'static str,
        /// Its reason.
        reason: Reason,
        /// A number that belongs to the reason; see [`Reason`].
        detail: u16,
    },
    /// The board has stopped its motors because of a fault or an event, and accepts no more of the plan.
    #[error("the board stopped: {}", in_words(*.cause))]
    Stopped {
        /// The cause that it reported.
        cause: Cause,
    },
    /// There are more orders than fit in one frame. None was sent.
    #[error("{orders} orders are more than the board takes at once: {most}. Each axis of each verb is one")]
    TooManyOrders {
        /// The number of orders.
        orders: usize,
        /// The number that fits.
        most: usize,
    },
    /// The board's answer does not belong to the command.
    #[error("the board's answer makes no sense: its firmware is not what it says")]
    Nonsense,
    /// The plan is for another kind of board.
    #[error(
        "the board is {is}, but the motion is planned for `{wanted}`: a clock of {wanted_hz} Hz, {wanted_bits} fraction bits"
    )]
    OtherBoard {
        /// The connected board: [`name_of`](crate::profiles::name_of).
        is: &'static str,
        /// The board that the plan is for, by its name in motion files.
        wanted: String,
        /// That board's ticks per second.
        wanted_hz: u64,
        /// That board's fraction bits (F).
        wanted_bits: u32,
    },
    /// The Uno has another firmware image than is needed.
    #[error("the board has the image `{is}`, and this takes the image `{wanted}`")]
    OtherImage {
        /// The image that it has: [`image_name`].
        is: &'static str,
        /// The image that is needed: [`image_name`].
        wanted: &'static str,
    },
    /// The board did not keep the settings that were stored.
    #[error("the board's memory did not take the settings: try again; if that does not help it is worn out")]
    NotKept,
    /// Motors still move for an earlier host, and did not come to rest while this one waited.
    #[error("the board still moves motors for a host before this one")]
    StillMoving,
}

/// A refusal in words, for messages.
fn reason_text(reason: Reason, detail: u16) -> String {
    match reason {
        Reason::UnknownKind if detail == u16::from(kind::ORDERS) => {
            "its firmware obeys no verbs; `pulsetrain flash uno --port PORT --image verbs` writes the Uno's that does"
                .to_owned()
        }
        Reason::UnknownKind => format!("it does not know command {detail:#04x}"),
        Reason::Malformed => format!("command {detail:#04x} is malformed"),
        Reason::Taken => "another program drives it".to_owned(),
        Reason::NotConfigured => "it has no configuration".to_owned(),
        Reason::NotArmed => "its motors are not armed; they stopped, or never were".to_owned(),
        Reason::Moving => "its motors are moving".to_owned(),
        Reason::NoSuchMotor => format!("it has no motor {detail}"),
        Reason::Full => format!("the queue of motor {detail} is full"),
        Reason::TooManyMotors => format!("it drives at most {detail} motors"),
        Reason::Pin => format!("pin {detail} is not there, or cannot be that"),
        Reason::PinTaken => format!("pin {detail} is used twice"),
        Reason::PinMix => format!("pin {detail} does not go with those before it"),
        Reason::Timing => format!("pulse, set-up or hold is beyond its limit of {detail} ticks"),
        Reason::Baud => format!("it cannot do rate {detail}"),
        Reason::Period => format!("a period must be {detail} ticks at least, and 2^62 at most (2^30 on an Uno)"),
        Reason::Busy => {
            format!(
                "motor {detail} has a move under way and one that waits, or moves that are done and not reported: wait until one is done, or halt it"
            )
        }
        Reason::Obeying => "its motors obey verbs until they are released".to_owned(),
        Reason::SharedDir => {
            "motors that share a DIR line cannot obey verbs on it: give each its own, or send plans".to_owned()
        }
        Reason::Baked => {
            "a motion in its flash runs, which was baked; `pulsetrain flash pico` brings the plain firmware back"
                .to_owned()
        }
    }
}

/// Why a board stopped or restarted, in words for messages.
#[must_use]
pub const fn in_words(cause: Cause) -> &'static str {
    match cause {
        Cause::None => "none yet",
        Cause::Finished => "the motion was complete",
        Cause::StopNow => "the host asked for an immediate stop",
        Cause::HostLost => "the host was silent for too long",
        Cause::Starved => "its step generator did not keep up",
        Cause::BadItem => "a queue held data that no host sends",
        Cause::CheckFailed => "the board's position or accumulator differed from the host's",
        Cause::StepMissed => "a step was ordered too late",
        Cause::EdgeLate => "an edge was late",
        Cause::Overrun => "bytes were lost on the line",
        Cause::BaudFellBack => "the line fell back to 115 200 baud",
        Cause::Watchdog => "the watchdog restarted the program",
        Cause::BrownOut => "the supply fell too low",
        Cause::ResetLine => "the reset line, as when a port is opened",
        Cause::PowerOn => "power came on",
        Cause::MoveDone => "a move was done",
        Cause::Lapsed => "the plan came too late, and the motors braked",
        Cause::Braked => "the host asked the motors to brake",
        Cause::RanDry => "a motor's plan ran out, and all motors braked",
    }
}

/// The name of an Uno's image (one of [`image`]), as `pulsetrain flash uno --image` takes it. `uno` is the default image.
#[must_use]
pub const fn image_name(number: u8) -> &'static str {
    match number {
        image::PLANS => "uno",
        image::WINCH => "winch",
        image::VERBS => "verbs",
        _ => "unknown",
    }
}

/// The configuration of a board: what Configure of docs/protocol.md sends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// How long STEP is active, ticks.
    pub pulse_ticks: u16,
    /// How long DIR has its level before a step, ticks.
    pub setup_ticks: u16,
    /// How long DIR keeps its level after the end of a pulse, ticks.
    pub hold_ticks: u16,
    /// The pin that enables all drivers, and whether it is active high.
    pub enable: Option<(u8, bool)>,
    /// The motors are released after resting this long, ms; `None` if they hold.
    pub idle_ms: Option<u16>,
    /// The board ends the session after this silence of the host, ms; 0 means 2000.
    pub silence_ms: u16,
    /// The motors, at most 8.
    pub motors: Vec<MotorSetup>,
}

impl Setup {
    /// The motors, as the bytes of a [`Configuration`].
    #[must_use]
    pub fn motor_bytes(&self) -> Vec<u8> {
        self.motors.iter().flat_map(MotorSetup::to_bytes).collect()
    }

    /// The message; `motors` are its [`motor_bytes`](Setup::motor_bytes). `None` with more than 8 motors.
    #[must_use]
    pub fn configuration<'m>(&self, motors: &'m [u8]) -> Option<Configuration<'m>> {
        let mut configuration = Configuration::new(motors)?;
        configuration.pulse_ticks = self.pulse_ticks;
        configuration.setup_ticks = self.setup_ticks;
        configuration.hold_ticks = self.hold_ticks;
        (configuration.enable_pin, configuration.enable_high) = self.enable.unwrap_or((NO_PIN, false));
        configuration.idle_ms = self.idle_ms;
        configuration.silence_ms = self.silence_ms;
        Some(configuration)
    }
}

/// An item that the board may still have in its queue.
#[derive(Clone, Copy, Debug)]
struct QueuedItem {
    epoch: Epoch,
    /// The tick at which the item leaves the queue at the latest: when it begins, or at a switch to another epoch.
    until: u64,
    len: usize,
    /// The epoch and packer from before the item, to go back to if it is taken back.
    before: (Option<Epoch>, Packer),
}

/// What the host keeps of one motor.
#[derive(Clone, Debug)]
struct RemoteQueue {
    packing: Packing,
    /// Bytes of its empty queue.
    capacity: usize,
    /// The epoch that is being packed, and its packer; `None` before the first item.
    epoch: Option<Epoch>,
    packer: Packer,
    /// Bytes that are packed but not sent.
    packed: Vec<u8>,
    /// The items that may still be in the board's queue, in order.
    waiting: VecDeque<QueuedItem>,
    position: i64,
    faults: u8,
}

/// A board at the other end of a [`Port`].
#[derive(Clone, Debug)]
pub struct Remote<P> {
    port: P,
    link: Link,
    info: Info,
    /// The board's kind, if it is known.
    kind: Option<BoardKind>,
    clock: BoardClock,
    motors: Vec<RemoteQueue>,
    epoch: Epoch,
    /// The lease, as far as the board has confirmed it.
    lease: LeaseState,
    /// Extensions without an answer, oldest first, each with the braking limits that it brings.
    unconfirmed: VecDeque<(Lease, Vec<Limit>)>,
    /// The board's answers, oldest first, that [`Leased::extended`] has not reported yet.
    extended: VecDeque<bool>,
    /// How hard each motor may brake, as the board has confirmed it.
    limits: Vec<Limit>,
    /// The switch that began the lease: the tick at which it was accepted, and the tick at which it is made.
    lease_switch: (u64, u64),
    /// Ticks from the board's time to its horizon, by its last status.
    horizon_ticks: u64,
    /// Whether the board was idle, by its last status after the last command that can move motors.
    idle: bool,
    /// When the last command that can move motors was given.
    commanded_at: Duration,
    /// When the status was requested last.
    status_requested_at: Duration,
    /// When the room in the queues was requested last.
    room_requested_at: Duration,
    /// All ticks before this one have passed, whatever the clock's reading says: time never goes back.
    passed_until: u64,
    edges: Vec<Edge>,
    events: Vec<Event>,
    error: Option<RemoteError>,
    /// Bytes of the link that are not sent yet.
    outbox: Vec<u8>,
    /// When the next of them may be sent.
    next_send: Duration,
    /// Whether an answer is waited for.
    awaits_answer: bool,
    /// Plans that the board has switched to since it was configured.
    plans: u32,
    inbox: Vec<u8>,
}

impl<P: Port> Remote<P> {
    /// Begins a session with the board at the other end: sends Hello until it answers. `nonce` must differ from that of the session before.
    ///
    /// # Errors
    /// When nobody answers, another host has the board, or it speaks another protocol.
    pub fn open(port: P, nonce: u32) -> Result<Remote<P>, RemoteError> {
        let mut link = Link::new(nonce);
        link.hello(port.now());
        Remote::greet(port, link)
    }

    /// As [`open`](Remote::open), but does not wait for a board that another host has.
    ///
    /// # Errors
    /// As [`open`](Remote::open). When another host or a client of its text has the board, at once.
    pub fn open_if_free(port: P, nonce: u32) -> Result<Remote<P>, RemoteError> {
        let mut link = Link::new(nonce);
        link.hello_if_free(port.now());
        Remote::greet(port, link)
    }

    /// Waits until Hello is answered.
    fn greet(port: P, link: Link) -> Result<Remote<P>, RemoteError> {
        let info = Info::NOBODY;
        let now = port.now();
        let mut remote = Remote {
            port,
            link,
            info,
            kind: None,
            clock: BoardClock::new(1),
            motors: Vec::new(),
            epoch: Epoch(0),
            lease: LeaseState::Off,
            unconfirmed: VecDeque::new(),
            extended: VecDeque::new(),
            limits: Vec::new(),
            lease_switch: (0, 0),
            horizon_ticks: 0,
            idle: false,
            commanded_at: now,
            status_requested_at: now,
            room_requested_at: now,
            passed_until: 0,
            edges: Vec::new(),
            events: Vec::new(),
            error: None,
            outbox: Vec::new(),
            next_send: now,
            awaits_answer: false,
            plans: 0,
            inbox: Vec::new(),
        };
        match remote.answer()?.reply {
            Reply::Info(info) => remote.info = info,
            _ => return Err(RemoteError::Nonsense),
        }
        remote.kind = BoardKind::numbered(remote.info.board);
        remote.clock = BoardClock::new(remote.info.tick_hz);
        remote.read_clock()?;
        Ok(remote)
    }

    /// Which board it is: by its number one of [this project's](BoardKind::ALL), or what [`as_board`](Remote::as_board) said. `None` for a
    /// model.
    #[must_use]
    pub const fn kind(&self) -> Option<BoardKind> {
        self.kind
    }

    /// This board, of a kind that is not among this project's: one with a profile of the program's own.
    #[must_use]
    pub fn as_board(self, kind: BoardKind) -> Remote<P> {
        Remote { kind: Some(kind), ..self }
    }

    /// The board's Info: kind, firmware, tick rate and limits.
    #[must_use]
    pub const fn info(&self) -> &Info {
        &self.info
    }

    /// Changes the rate of the line. Returns the rate that both ends have then: 115 200 baud if the new one did not work.
    ///
    /// # Errors
    /// When the board is lost, or refuses.
    pub fn set_baud(&mut self, baud: Baud) -> Result<Baud, RemoteError> {
        self.wait_until_quiet()?;
        self.done("change its rate", &Command::Baud { baud })?;
        self.wait_until_quiet()?;
        Ok(self.link.baud())
    }

    /// Waits until motors rest that still move for an earlier host. Meanwhile it calls `goes_on` again and again, and waits as long as that returns true.
    ///
    /// # Errors
    /// When the board is lost. [`RemoteError::StillMoving`] if `goes_on` returns false, or the motors do not rest within half a minute.
    pub fn wait_for_rest(&mut self, goes_on: impl FnMut() -> bool) -> Result<(), RemoteError> {
        self.at_rest(goes_on).map(drop)
    }

    /// Configures the board's pins, and powers the motors ([`arm`](Remote::arm)). Waits first until motors rest that still move for an earlier host.
    ///
    /// # Errors
    /// When the board is lost or refuses. No motor is powered then.
    ///
    /// # Panics
    /// With more than 8 motors.
    pub fn configure(&mut self, setup: &Setup) -> Result<(), RemoteError> {
        if setup.motors.len() > usize::from(self.info.max_motors) {
            // A board cannot refuse a frame that is too long for it: it drops that.
            let (what, reason) = ("take this configuration", Reason::TooManyMotors);
            return Err(RemoteError::Refused { what, reason, detail: u16::from(self.info.max_motors) });
        }
        let motors = setup.motor_bytes();
        let configuration = setup.configuration(&motors).expect("at most 8 motors");
        self.wait_for_rest(|| true)?;
        let answer = self.ask(&Command::Configure(configuration))?;
        let Reply::Configured(queues) = answer.reply else { return Err(refusal("take this configuration", &answer)) };
        if queues.as_slice().len() != setup.motors.len() {
            return Err(RemoteError::Nonsense);
        }
        let fraction_bits = u32::from(self.info.fraction_bits);
        let motor = |(motor, bytes): (&MotorSetup, &u16)| RemoteQueue {
            packing: Packing { fraction_bits, gain: motor.gain },
            capacity: usize::from(*bytes),
            epoch: None,
            packer: Packer::new(Packing { fraction_bits, gain: motor.gain }, usize::from(*bytes)),
            packed: Vec::new(),
            waiting: VecDeque::new(),
            position: 0,
            faults: 0,
        };
        self.motors = setup.motors.iter().zip(queues.as_slice()).map(motor).collect();
        self.plans = 0;
        self.limits = vec![Limit::WITHIN_A_STEP; self.motors.len()];
        self.arm()?;
        for _ in 0..FIRST_READINGS {
            self.read_clock()?;
        }
        Ok(())
    }

    /// Empties the queues and powers the motors. Needed again after [`Board::stop_now`].
    ///
    /// # Errors
    /// When the board is lost, or refuses.
    pub fn arm(&mut self) -> Result<(), RemoteError> {
        self.done("arm its motors", &Command::Arm)?;
        self.end_lease();
        for motor in &mut self.motors {
            motor.reset_packing();
            motor.waiting.clear();
        }
        self.status().map(drop)
    }

    /// Stops all motors at once, without ramps, whichever host moved them. Returns the last tick at which a step may have begun, which positions are
    /// uncertain, and the count of each of the board's motors.
    ///
    /// # Errors
    /// When the board is lost.
    pub fn stop_motors(&mut self) -> Result<(Stopped, Vec<i64>), RemoteError> {
        let answer = self.ask(&Command::StopNow);
        self.end_lease();
        for motor in &mut self.motors {
            motor.reset_packing();
            motor.waiting.clear();
        }
        let answer = answer?;
        let Reply::Stopped { stopped, positions } = answer.reply else { return Err(refusal("stop", &answer)) };
        for (motor, position) in self.motors.iter_mut().zip(positions.as_slice()) {
            motor.set_count(*position);
        }
        Ok((stopped, positions.as_slice().iter().map(|position| i64::from(*position)).collect()))
    }

    /// Switches the power of resting motors off.
    ///
    /// # Errors
    /// When the board is lost, or a motor moves.
    pub fn release(&mut self) -> Result<(), RemoteError> {
        self.done("release its motors", &Command::Release)
    }

    /// Reads the board's status.
    ///
    /// # Errors
    /// When the board is lost.
    pub fn status(&mut self) -> Result<Status, RemoteError> {
        let answer = self.ask(&Command::Status)?;
        match answer.reply {
            Reply::Status(status) => Ok(status),
            _ => Err(refusal("say how it is", &answer)),
        }
    }

    /// Reads the board's measurements of itself; `reset` restarts them from zero first.
    ///
    /// # Errors
    /// When the board is lost.
    pub fn measures(&mut self, reset: bool) -> Result<Measures, RemoteError> {
        let answer = self.ask(&Command::Measures { reset })?;
        match answer.reply {
            Reply::Measures(measures) => Ok(measures),
            _ => Err(refusal("say what it measured", &answer)),
        }
    }

    /// Sends verbs to motors ([`Verbs`](pulsetrain_core::verbs::Verbs)). `orders` are pairs of a motor and its verb, eight at most (six on an Uno). All of
    /// them begin at the same tick.
    ///
    /// The end of a move is reported by [`events`](Board::events), as [`Cause::MoveDone`].
    ///
    /// # Errors
    /// When the board is lost or refuses, or when the orders do not fit in one frame. No order is obeyed then.
    pub fn tell_motors(&mut self, orders: &[(u8, Verb)]) -> Result<Obeyed, RemoteError> {
        // A frame's body has two bytes before the orders.
        let most = (usize::from(self.info().max_body).saturating_sub(2) / ORDER_LEN).min(MAX_ORDERS);
        if orders.len() > most {
            return Err(RemoteError::TooManyOrders { orders: orders.len(), most });
        }
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        let command = Command::Orders(Orders::decode(&bytes).expect("at most eight orders"));
        self.commanded_at = self.port.now();
        self.idle = false;
        let answer = self.ask(&command)?;
        match answer.reply {
            Reply::Obeyed(obeyed) => Ok(obeyed),
            _ => Err(self.refused(refusal("do that", &answer))),
        }
    }

    /// Whether the board obeys verbs: [`tell_motors`](Remote::tell_motors).
    ///
    /// # Errors
    /// When the board is lost.
    pub fn obeys(&mut self) -> Result<bool, RemoteError> {
        let answer = self.ask(&Command::Orders(Orders::NONE))?;
        Ok(!matches!(answer.reply, Reply::Refused { reason: Reason::UnknownKind, .. }))
    }

    /// Stores `settings` on the board, in place of those before. It keeps them without power, and uses them for later configurations and text.
    ///
    /// # Errors
    /// When the board is lost or refuses: its motors are powered, it has no storage, or limits are out of the ranges of [`Settings`].
    pub fn store(&mut self, settings: &Settings) -> Result<(), RemoteError> {
        let stored = self.settings(Some(*settings))?;
        if stored.settings == Some(*settings) { Ok(()) } else { Err(RemoteError::NotKept) }
    }

    /// Reads the settings that the board has stored.
    ///
    /// # Errors
    /// When the board is lost or refuses: its motors are powered, or it has no storage.
    pub fn stored(&mut self) -> Result<Stored, RemoteError> {
        self.settings(None)
    }

    fn settings(&mut self, settings: Option<Settings>) -> Result<Stored, RemoteError> {
        let answer = self.ask(&Command::Store(settings))?;
        match answer.reply {
            Reply::Stored(stored) => Ok(stored),
            _ => Err(refusal("keep settings", &answer)),
        }
    }

    /// Ends the session and returns the port. The board follows the plan that it has.
    pub fn close(mut self) -> P {
        // Without an answer the session ends too, as this host is silent from now on.
        let _ = self.done("say good-bye", &Command::Bye);
        self.port
    }

    /// Why the board cannot be used any more; `None` while it can.
    #[must_use]
    pub const fn error(&self) -> Option<&RemoteError> {
        self.error.as_ref()
    }

    /// The board's clock, as the host has read it.
    #[must_use]
    pub const fn clock(&self) -> &BoardClock {
        &self.clock
    }

    /// The link: the line's rate, and counts of frames.
    #[must_use]
    pub const fn link(&self) -> &Link {
        &self.link
    }

    /// The port.
    #[must_use]
    pub const fn port(&self) -> &P {
        &self.port
    }

    /// The port, for what has nothing to do with the link. Bytes must not be sent or received here.
    pub const fn port_mut(&mut self) -> &mut P {
        &mut self.port
    }

    /// Replaces the refusal "not armed" by the cause of the stop that the board reported, which says more.
    fn refused(&self, refused: RemoteError) -> RemoteError {
        match (&refused, self.reported_stop()) {
            (RemoteError::Refused { reason: Reason::NotArmed, .. }, Some(cause)) => RemoteError::Stopped { cause },
            _ => refused,
        }
    }

    /// The cause of an unplanned stop, if the board has reported one.
    fn reported_stop(&self) -> Option<Cause> {
        let reported = self.events.iter().rev().map(|event| event.cause);
        reported.into_iter().find(|cause| matches!(cause, Cause::StopNow | Cause::Starved) || cause.lapse().is_some())
    }

    fn read_clock(&mut self) -> Result<(), RemoteError> {
        self.ask(&Command::Clock).map(drop)
    }

    /// Sends a command that is answered by "done".
    fn done(&mut self, what: &'static str, command: &Command<'_>) -> Result<(), RemoteError> {
        let answer = self.ask(command)?;
        if let Reply::Done { .. } = answer.reply { Ok(()) } else { Err(refusal(what, &answer)) }
    }

    fn ask(&mut self, command: &Command<'_>) -> Result<Answer, RemoteError> {
        while self.link.is_asking() {
            self.round(Duration::MAX)?;
        }
        self.link.ask(command, self.port.now());
        self.answer()
    }

    fn answer(&mut self) -> Result<Answer, RemoteError> {
        loop {
            if let Some(answer) = self.link.answer() {
                self.note(&answer);
                return Ok(answer);
            }
            self.awaits_answer = true;
            let done = self.round(Duration::MAX);
            self.awaits_answer = false;
            done?;
        }
    }

    /// Waits until every frame is confirmed and every command answered.
    fn wait_until_quiet(&mut self) -> Result<(), RemoteError> {
        while !self.link.is_quiet() {
            self.round(Duration::MAX)?;
        }
        Ok(())
    }

    fn pause(&mut self, duration: Duration) -> Result<(), RemoteError> {
        let until = self.port.now() + duration;
        while self.port.now() < until {
            self.round(until)?;
        }
        Ok(())
    }

    /// Sends what is due, and waits: until `until`, until bytes come from the board, or until something is due.
    fn round(&mut self, until: Duration) -> Result<(), RemoteError> {
        let done = self.try_round(until);
        if let Err(error) = &done {
            self.error.get_or_insert_with(|| error.clone());
        }
        done
    }

    fn try_round(&mut self, until: Duration) -> Result<(), RemoteError> {
        let now = self.port.now();
        self.link.output(now, &mut self.outbox);
        if let Some(error) = self.link.error() {
            return Err(error.into());
        }
        if let Some(baud) = self.link.take_rate() {
            self.port.set_baud(baud)?;
        }
        let budget = self.frame_budget();
        if budget == usize::MAX || now >= self.next_send {
            self.port.send(&self.outbox[..budget.min(self.outbox.len())])?;
            self.outbox.drain(..budget.min(self.outbox.len()));
            self.next_send = now + SEND_EVERY;
        }
        let mut due = self.link.deadline().unwrap_or(until).min(until);
        if !self.outbox.is_empty() {
            due = due.min(self.next_send);
        }
        self.inbox.clear();
        self.port.receive(due.max(now + SHORTEST_ROUND), &mut self.inbox)?;
        self.link.input(&self.inbox, self.port.now());
        self.take_events();
        if let Some((reason, detail)) = self.link.refusal() {
            return Err(self.refused(RemoteError::Refused { what: "take more", reason, detail }));
        }
        self.port.edges(&mut self.edges);
        Ok(())
    }

    /// Takes the board's events, and its answers to extensions.
    fn take_events(&mut self) {
        while let Some(event) = self.link.event() {
            if let Some(cause) = event.cause.lapse() {
                self.note_lapse(event.tick, Some(cause), self.now());
            }
            if event.cause == Cause::Starved && self.lease != LeaseState::Off {
                // An immediate stop: the lease does not end by the rules that the host replays.
                self.error.get_or_insert(RemoteError::Stopped { cause: event.cause });
            }
            self.events.push(event);
        }
        while let Some(accepted) = self.link.extended()
            && let Some((lease, limits)) = self.unconfirmed.pop_front()
        {
            match (accepted, self.lease) {
                // The event of the lease's end came first.
                (true, LeaseState::Lapsed { .. }) => self.limits = limits,
                (true, _) => (self.lease, self.limits) = (lease.into(), limits),
                // Request a status at once: it tells the reason.
                (false, _) => self.status_requested_at = Duration::ZERO,
            }
            self.extended.push_back(accepted);
        }
    }

    /// Notes that the lease ended at tick `at`, as the board reported at its tick `now`. An event has a `cause`, and comes only if motors were in motion; a
    /// status has none.
    fn note_lapse(&mut self, at: u64, cause: Option<lease::LapseCause>, now: u64) {
        let (accepted, begins) = self.lease_switch;
        // The report may be of the lease before: the switch to the new one is accepted but not made yet.
        let is_old = at <= accepted && now < begins;
        match &mut self.lease {
            LeaseState::Off => {}
            LeaseState::Lapsed { at: known, cause: why, in_motion } => {
                if let Some(cause) = cause {
                    (*known, *why, *in_motion) = (at, cause, true);
                }
            }
            LeaseState::Until(_) | LeaseState::Last if is_old => {}
            LeaseState::Until(_) | LeaseState::Last => {
                let (why, in_motion) = (cause.unwrap_or(lease::LapseCause::NotExtended), cause.is_some());
                self.lease = LeaseState::Lapsed { at, cause: why, in_motion };
            }
        }
    }

    fn switch_with(
        &mut self,
        epoch: Epoch,
        tick: u64,
        lease: lease::Lease,
        limits: &[Limit],
    ) -> Result<(), SwitchRefused> {
        self.flush();
        self.note_command();
        if self.error.is_some() || self.settle_extensions().is_err() {
            return Err(SwitchRefused::Lost);
        }
        let limits: Vec<u8> = limits.iter().copied().flat_map(limit_bytes).collect();
        let command = Command::Switch { epoch, tick, lease, limits: &limits };
        let answer = self.ask(&command).map_err(|_| SwitchRefused::Lost)?;
        let refused = match answer.reply {
            Reply::Switched(Switched::Accepted) => {
                self.epoch = epoch;
                self.plans = self.plans.saturating_add(1);
                self.motors.iter_mut().for_each(|motor| motor.switch(epoch, tick));
                return Ok(());
            }
            Reply::Switched(Switched::Late { horizon }) => SwitchRefused::Late { horizon },
            Reply::Switched(Switched::Early { limit }) => SwitchRefused::Early { limit },
            Reply::Switched(Switched::Full) => SwitchRefused::Full,
            _ => {
                let why = self.refused(refusal("go over to an epoch", &answer));
                self.error.get_or_insert(why);
                SwitchRefused::Lost
            }
        };
        for motor in self.motors.iter_mut().filter(|motor| motor.epoch == Some(epoch)) {
            motor.drop_epoch(epoch);
        }
        // Reads the room in the queues, as the board has dropped the items.
        let _ = self.status();
        Err(refused)
    }

    /// Notes that there is no lease, and that no extension will be answered.
    fn end_lease(&mut self) {
        self.lease = LeaseState::Off;
        self.unconfirmed.clear();
        self.extended.clear();
        self.link.forget_extensions();
    }

    /// Decides which extensions the board accepted before an order to brake; `sent` of them were sent, and the motors brake from `tick` on. If one of the
    /// leases ends at that tick, it was over before the order came, and the extensions after it were refused. Else all were accepted.
    fn decide_extensions(&mut self, sent: usize, tick: Option<u64>) {
        let ends_there = |(lease, _): &(Lease, Vec<Limit>)| tick.is_some_and(|at| *lease == Lease::Until(at));
        let was_over = match self.lease {
            LeaseState::Until(until) => tick == Some(until),
            LeaseState::Lapsed { cause, .. } => cause != lease::LapseCause::Ordered,
            LeaseState::Off | LeaseState::Last => tick.is_none(),
        };
        let last = self.unconfirmed.iter().take(sent).rposition(ends_there);
        let accepted = last.map_or(if was_over { 0 } else { sent }, |last| last + 1);
        for (index, (_, limits)) in self.unconfirmed.drain(..).enumerate() {
            self.extended.push_back(index < accepted);
            if index < accepted {
                self.limits = limits;
            }
        }
    }

    /// Waits until all extensions are answered. It must come before a further command: the board reports only the last one that it accepted.
    fn settle_extensions(&mut self) -> Result<(), RemoteError> {
        while self.link.extending() > 0 {
            self.round(Duration::MAX)?;
        }
        Ok(())
    }

    /// Converts a lease to the 32-bit ticks of frames.
    ///
    /// # Errors
    /// The first tick that is too far ahead, if the lease ends there or later.
    fn core_lease(&self, lease: Lease) -> Result<lease::Lease, u64> {
        let limit = self.now() + (1 << 30);
        match lease {
            Lease::Until(tick) if tick >= limit => Err(limit),
            Lease::Until(tick) => Ok(lease::Lease::Until(Tick32::of(tick))),
            Lease::Last => Ok(lease::Lease::Last),
        }
    }

    /// The limits of all motors, with the given ones in place of those before.
    fn limits_with(&self, given: &[Limit]) -> Vec<Limit> {
        let mut all = self.limits.clone();
        all.iter_mut().zip(given).for_each(|(limit, given)| *limit = *given);
        all
    }

    /// Takes the clock, counts and faults from an answer.
    fn note(&mut self, answer: &Answer) {
        match answer.reply {
            Reply::Clock { tick } => self.clock.read(tick, answer.asked_at, answer.answered_at),
            Reply::Status(status) => {
                self.clock.read(status.head.tick, answer.asked_at, answer.answered_at);
                self.horizon_ticks = status.head.horizon.saturating_sub(status.head.tick);
                if let message::LeaseState::Lapsed(at) = status.head.lease {
                    let now = status.head.tick;
                    let ahead = at.since(Tick32::of(now)).cast_signed();
                    self.note_lapse(now.saturating_add_signed(ahead.into()), None, now);
                }
                if answer.asked_at >= self.commanded_at {
                    self.idle = status.is_idle();
                }
                for (motor, said) in self.motors.iter_mut().zip(status.motors.as_slice()) {
                    motor.set_count(said.position);
                    motor.faults = said.faults;
                }
            }
            _ => {}
        }
    }

    /// Gives all packed bytes to the link.
    fn flush(&mut self) {
        let now = self.port.now();
        for (index, motor) in (0..).zip(&mut self.motors) {
            motor.flush(index, &mut self.link, now);
        }
    }

    /// Gives packed bytes to the link, but gathers more of them while the board's queue is nearly full or enough frames are on their way: long frames
    /// cost a board little more than short ones.
    fn gather(&mut self) {
        let (now, tick) = (self.port.now(), self.now());
        let much = self.link.max_packed() / 2;
        for (index, motor) in (0..).zip(&mut self.motors) {
            let percent_full = motor.percent_full(tick, self.epoch);
            let most = if percent_full < PLENTY_PERCENT {
                FRAMES_FOR_SHORT_QUEUE
            } else if motor.packed.len() > much {
                FRAMES_HALF_FULL
            } else {
                1
            };
            if percent_full < FULL_PERCENT && self.link.frames() < most {
                motor.flush(index, &mut self.link, now);
            }
        }
    }

    /// How many bytes are sent at once. Few if the board's queues are full, as each byte takes an Uno's time from its steps; without limit if they are
    /// not, or while an answer is waited for. From the first change of the plan on there is always a limit: a beginning that comes in one go takes an
    /// Uno's time when it needs that most.
    fn frame_budget(&self) -> usize {
        let tick = self.now();
        let least = self.motors.iter().map(|motor| motor.percent_full(tick, self.epoch)).min().unwrap_or(0);
        let few = (usize::from(self.info.pool) / LIMIT_PARTS).max(1);
        let begins_another = self.plans == 1 && self.motors.iter().any(|motor| motor.epoch != Some(self.epoch));
        let has_changed = self.plans > 1 || begins_another;
        let soon = tick + u64::from(self.info.tick_hz) / 1000 * SOON_MS;
        let lasts = self.motors.iter().all(|motor| motor.waiting.back().is_some_and(|item| item.until >= soon));
        match least {
            _ if has_changed && (self.awaits_answer || (lasts && least < ENOUGH_PERCENT)) => 2 * few,
            _ if self.awaits_answer => usize::MAX,
            PLENTY_PERCENT.. => few,
            ENOUGH_PERCENT.. => 2 * few,
            _ => usize::MAX,
        }
    }

    /// Ticks after the computed one until an item counts as gone from its queue.
    fn taken_margin(&self) -> u64 {
        u64::from(self.info.tick_hz) / TAKEN_MARGIN_PER_S
    }

    /// Notes that a command is sent that can move motors.
    fn note_command(&mut self) {
        self.commanded_at = self.port.now();
        self.idle = false;
    }

    /// Requests the status and the room in the queues when they are due.
    fn request_news(&mut self) {
        let now = self.port.now();
        if let Some(answer) = self.link.answer() {
            self.note(&answer);
        }
        if now >= self.status_requested_at + STATUS_EVERY && !self.link.is_asking() {
            self.status_requested_at = now;
            self.link.ask(&Command::Status, now);
        }
        let full = (0..).zip(&self.motors).any(|(index, motor)| self.link.room(index) < motor.capacity / 2);
        if full && now >= self.room_requested_at + FREE_BYTES_EVERY {
            self.room_requested_at = now;
            self.link.poll(now);
        }
    }

    /// Passes the edges up to `until` on to the observer. A virtual board's time may be later, up to the end of a USB frame: its later edges wait.
    fn hand_over(&mut self, until: u64, observer: &mut impl Observer) {
        let due = self.edges.partition_point(|edge| edge.tick <= until);
        self.edges.drain(..due).for_each(|edge| observer.edge(edge));
    }
}

impl RemoteQueue {
    fn flush(&mut self, index: u8, link: &mut Link, now: Duration) {
        if let (Some(epoch), false) = (self.epoch, self.packed.is_empty()) {
            link.send(index, epoch, &self.packed, now);
            self.packed.clear();
        }
    }

    /// Drops what is packed, and begins the next item's epoch from a reset state.
    fn reset_packing(&mut self) {
        self.epoch = None;
        self.packed.clear();
    }

    /// Drops the items of an epoch, which are the last that were pushed. The epoch before it is packed on as if they had not been there: the board
    /// reads it on from where it was, too.
    fn drop_epoch(&mut self, epoch: Epoch) {
        self.reset_packing();
        while let Some(item) = self.waiting.pop_back_if(|item| item.epoch == epoch) {
            (self.epoch, self.packer) = item.before;
        }
    }

    /// Notes that the board drops the items of older epochs at `tick`.
    fn switch(&mut self, epoch: Epoch, tick: u64) {
        for item in self.waiting.iter_mut().filter(|item| item.epoch != epoch) {
            item.until = item.until.min(tick);
        }
    }

    /// How full the queue is at tick `now`, %, computed from when items leave it. 0 while an epoch is packed that has not begun: its switch comes soon,
    /// and its items must be sent before.
    fn percent_full(&self, now: u64, running: Epoch) -> usize {
        if self.epoch != Some(running) {
            return 0;
        }
        let free = self.room_at(now) + self.packed.len();
        100 * self.capacity.saturating_sub(free) / self.capacity.max(1)
    }

    /// Room in the queue at tick `now`, computed from when items leave it; packed items count as if they were sent.
    fn room_at(&self, now: u64) -> usize {
        let left = self.waiting.iter().skip_while(|item| item.until < now).map(|item| item.len);
        self.capacity.saturating_sub(left.sum())
    }

    /// Takes the board's count, which has 32 bits, into the 64-bit position.
    fn set_count(&mut self, position: i32) {
        let moved = position.wrapping_sub(self.position as i32);
        self.position += i64::from(moved);
    }
}

fn refusal(what: &'static str, answer: &Answer) -> RemoteError {
    match answer.reply {
        Reply::Refused { reason, detail, .. } => RemoteError::Refused { what, reason, detail },
        _ => RemoteError::Nonsense,
    }
}

impl<P: Port> Board for Remote<P> {
    fn push(&mut self, index: usize, entry: Entry) -> Result<(), Entry> {
        let (room, lost, taken) = (self.room(index), self.error.is_some(), self.taken_margin());
        let Some(motor) = self.motors.get_mut(index) else { return Err(entry) };
        let (now, tick) = (self.port.now(), self.clock.tick_at(self.port.now()).unwrap_or(0).max(self.passed_until));
        let fresh = motor.epoch != Some(entry.epoch);
        let before = (motor.epoch, motor.packer);
        let mut packer = if fresh { Packer::new(motor.packing, motor.capacity) } else { motor.packer };
        let mut bytes = [0; MAX_LEN];
        let begins = match entry.item {
            Item::Anchor { tick } => tick,
            Item::Dwell { .. } | Item::Run { .. } => packer.tick(),
        };
        let Ok(len) = packer.pack(&entry.item, &mut bytes) else { return Err(entry) };
        if len > room {
            return Err(entry);
        }
        if lost {
            return Ok(());
        }
        if fresh || motor.packed.len() + len > self.link.max_packed() {
            // Motors are at most 8.
            motor.flush(index as u8, &mut self.link, now);
        }
        motor.epoch = Some(entry.epoch);
        motor.packer = packer;
        while motor.waiting.pop_front_if(|item| item.until + taken < tick).is_some() {}
        // Extends the 32-bit tick: ticks in a queue are within 2^31 of now.
        let until =
            |begins: Tick32| tick.saturating_add_signed(begins.0.wrapping_sub(tick as u32).cast_signed().into());
        let until = until(begins);
        motor.waiting.push_back(QueuedItem { epoch: entry.epoch, until, len, before });
        motor.packed.extend_from_slice(&bytes[..len]);
        self.note_command();
        Ok(())
    }

    fn discard(&mut self, epoch: Epoch) {
        for motor in self.motors.iter_mut().filter(|motor| motor.epoch == Some(epoch)) {
            motor.drop_epoch(epoch);
        }
        if self.error.is_none() && self.done("drop an epoch", &Command::Discard { epoch }).is_ok() {
            // Errors are ignored: the room then stays too small, which does no harm.
            let _ = self.status();
        }
    }

    fn room(&self, motor: usize) -> usize {
        let Some(queue) = self.motors.get(motor) else { return 0 };
        if self.error.is_some() {
            // The items go nowhere, but a host that waits for room would wait for ever.
            return queue.capacity;
        }
        let said = u8::try_from(motor).map_or(0, |index| self.link.room(index).saturating_sub(queue.packed.len()));
        // The reported room is some milliseconds old; the computed one may be greater. What is sent now arrives later still.
        said.max(queue.room_at(self.now().saturating_sub(self.taken_margin())))
    }

    fn sizer(&self, motor: usize) -> Sizer {
        let none = Packing { fraction_bits: u32::from(self.info.fraction_bits), gain: 0 };
        self.motors.get(motor).map_or(Sizer::packed(none, 0), |motor| Sizer::packed(motor.packing, motor.capacity))
    }

    fn round_trip(&self) -> u64 {
        // Time to fill half of all queues, which is the most that is sent before a switch; for a repeat after an error; and for the switch itself.
        let fill = Duration::from_secs(BITS * u64::from(self.info.pool) / 2) / self.link.baud().rate();
        let lead = fill + 2 * self.link.shortest_timeout();
        (lead.as_secs_f64() * f64::from(self.info.tick_hz)) as u64
    }

    fn delivery(&self, bytes: usize) -> u64 {
        let baud = u64::from(self.link.baud().rate());
        // Frames are longer than what is packed in them. A frame of the plan before may be on its way, and the command is one.
        let on_line = BITS * (bytes + bytes / FRAME_SHARE + 2 * MAX_FRAME) as u64;
        let read_late = self.kind.map_or(0, |kind| kind.profile().hearing_byte_us) * bytes as u64;
        let time = Duration::from_nanos(on_line * 1_000_000_000 / baud) + HEARING + Duration::from_micros(read_late);
        (time.as_secs_f64() * f64::from(self.info.tick_hz)) as u64
    }

    fn repetition(&self) -> u64 {
        (self.link.shortest_timeout().as_secs_f64() * f64::from(self.info.tick_hz)) as u64
    }

    fn horizon(&self) -> u64 {
        self.now() + self.horizon_ticks
    }

    fn now(&self) -> u64 {
        self.clock.tick_at(self.port.now()).unwrap_or(0).max(self.passed_until)
    }

    fn epoch(&self) -> Epoch {
        self.epoch
    }

    fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while self.now() <= until {
            self.gather();
            if self.error.is_none() {
                self.request_news();
            }
            let end = self.clock.time_of(until.saturating_add(1)).unwrap_or_default();
            let next = self.port.now() + LONGEST_ROUND;
            if self.round(end.min(next)).is_err() {
                // The link is lost, but time goes on, and a virtual board runs on.
                let gone = self.port.receive(end.max(self.port.now() + SHORTEST_ROUND), &mut self.inbox).is_err();
                self.port.edges(&mut self.edges);
                self.inbox.clear();
                if gone {
                    self.passed_until = until.saturating_add(1);
                }
            }
            self.passed_until = self.passed_until.max(self.clock.tick_at(self.port.now()).unwrap_or(0).min(until + 1));
            self.hand_over(until, observer);
        }
        self.hand_over(until, observer);
    }

    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        if self.now() <= tick {
            self.advance(tick, observer);
        }
        let report = match self.stop_motors() {
            Ok((stopped, _)) => {
                let uncertain = (0..self.motors.len()).map(|motor| stopped.uncertain >> motor & 1 == 1).collect();
                StopReport { tick: stopped.tick, positions: self.positions(), uncertain }
            }
            Err(error) => {
                self.error.get_or_insert(error);
                self.unknown_stop()
            }
        };
        self.hand_over(u64::MAX, observer);
        report
    }

    fn positions(&self) -> Vec<i64> {
        self.motors.iter().map(|motor| motor.position).collect()
    }

    fn is_idle(&self) -> bool {
        self.idle || self.error.is_some()
    }

    fn faults(&self, motor: usize) -> Faults {
        let faults = self.motors.get(motor).map_or(0, |motor| motor.faults);
        Faults {
            step_missed: faults & (flags::STEP_MISSED | flags::BAD_ITEM | flags::CHECK_FAILED) != 0,
            setup_cut_short: faults & flags::SETUP_CUT_SHORT != 0,
        }
    }

    fn events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    fn lost(&self) -> Option<&RemoteError> {
        self.error()
    }

    fn final_report(&mut self) -> Result<AtRest, RemoteError> {
        let clock = self.clock.clone();
        let is_lost = self.link.error().is_some();
        if is_lost {
            self.take_again()?;
        }
        // A board that has stopped refuses each frame of data that was on its way.
        while !self.link.is_quiet() {
            match self.round(Duration::MAX) {
                Ok(()) | Err(RemoteError::Refused { .. } | RemoteError::Stopped { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        let Answer { reply: Reply::Clock { tick }, asked_at: asked, answered_at: answered } =
            self.ask(&Command::Clock)?
        else {
            return Err(RemoteError::Nonsense);
        };
        // If the board restarted, its clock is far behind. If not, the clock is right to within its tolerance and the uncertainty of the readings. A board
        // that still has the session did not restart.
        let expected = clock.tick_at(asked).unwrap_or(0);
        let reading = 2 * (answered - asked) + BRIDGE_DELAY;
        let doubt = expected / CLOCK_ERROR_PART + (reading.as_secs_f64() * f64::from(self.info.tick_hz)) as u64;
        let was_reset = is_lost && tick + doubt < expected;
        let status = self.at_rest(|| true)?;
        let counts = status.motors.as_slice().iter().map(|motor| i64::from(motor.position));
        let positions = if was_reset { counts.collect() } else { self.positions() };
        let is_armed = status.head.flags & flags::ARMED != 0;
        let last_stop = match self.reported_stop() {
            _ if is_lost => self.info.last_stop,
            Some(cause) => cause,
            None if is_armed => Cause::Finished,
            // A board keeps only two events, and that of the stop may be lost. The answer to a new Hello has the cause.
            None => {
                self.done("say good-bye", &Command::Bye)?;
                self.take_again()?;
                self.info.last_stop
            }
        };
        Ok(AtRest { positions, last_stop, reset: was_reset.then_some(self.info.last_reset) })
    }
}

impl<P: Port> Leased for Remote<P> {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        let wire_lease = match self.core_lease(lease) {
            Ok(wire_lease) => wire_lease,
            Err(limit) => {
                self.discard(epoch);
                return Err(SwitchRefused::Early { limit });
            }
        };
        let all = self.limits_with(limits);
        self.switch_with(epoch, tick, wire_lease, if limits.is_empty() { &[] } else { &all })?;
        (self.lease, self.limits, self.lease_switch) = (lease.into(), all, (self.now(), tick));
        Ok(())
    }

    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused> {
        if self.error.is_some() {
            return Err(ExtendRefused::Lost);
        }
        match self.lease {
            LeaseState::Off => return Err(ExtendRefused::Off),
            LeaseState::Lapsed { at, .. } => return Err(ExtendRefused::Lapsed { at }),
            LeaseState::Until(_) | LeaseState::Last => {}
        }
        let wire_lease = self.core_lease(lease).map_err(|limit| ExtendRefused::Early { limit })?;
        self.flush();
        self.note_command();
        let all = self.limits_with(limits);
        let bytes: Vec<u8> =
            if limits.is_empty() { Vec::new() } else { all.iter().copied().flat_map(limit_bytes).collect() };
        self.link.extend(wire_lease, &bytes, self.port.now());
        self.unconfirmed.push_back((lease, all));
        Ok(())
    }

    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        let lease = self.core_lease(Lease::Until(until)).map_err(|limit| ExtendRefused::Early { limit })?;
        let lease::Lease::Until(end) = lease else { return Err(ExtendRefused::Off.into()) };
        // Everything packed must be in the board's queue, as its last items are to be dropped.
        self.flush();
        self.note_command();
        if self.error.is_some() || self.settle_extensions().is_err() {
            return Err(ExtendRefused::Lost.into());
        }
        let mut lens = Vec::new();
        for (index, motor) in self.motors.iter().enumerate() {
            let count = items.get(index).copied().unwrap_or(0);
            let kept = motor.waiting.len().checked_sub(count).ok_or(TrimRefused::Read { motor: index })?;
            lens.push(motor.waiting.range(kept..).map(|item| item.len).sum::<usize>());
        }
        // A queue has fewer bytes than 2^16.
        let bytes: Vec<u8> = lens.iter().flat_map(|len| (*len as u16).to_le_bytes()).collect();
        let Ok(answer) = self.ask(&Command::Trim { until: end, bytes: &bytes }) else {
            // The board may have accepted it, so it counts as an extension without an answer.
            self.unconfirmed.push_back((Lease::Until(until), self.limits.clone()));
            return Err(ExtendRefused::Lost.into());
        };
        match answer.reply {
            Reply::Trimmed(Trimmed::Accepted) => {}
            Reply::Trimmed(Trimmed::Late { horizon }) => return Err(ExtendRefused::Late { horizon }.into()),
            Reply::Trimmed(Trimmed::TooMany { motor }) => return Err(TrimRefused::Read { motor: motor.into() }),
            Reply::Trimmed(Trimmed::NoLease) => {
                // The status tells when the lease ended.
                let _ = self.status();
                return Err(match self.lease {
                    LeaseState::Lapsed { at, .. } => ExtendRefused::Lapsed { at }.into(),
                    _ => ExtendRefused::Off.into(),
                });
            }
            _ => {
                let why = self.refused(refusal("take items back", &answer));
                self.error.get_or_insert(why);
                return Err(ExtendRefused::Lost.into());
            }
        }
        for ((index, motor), (len, count)) in (0..).zip(&mut self.motors).zip(lens.into_iter().zip(items)) {
            let kept = motor.waiting.len().saturating_sub(*count);
            if let Some(QueuedItem { before, .. }) = motor.waiting.drain(kept..).next() {
                (motor.epoch, motor.packer) = before;
            }
            self.link.freed(index, len);
        }
        if !matches!(self.lease, LeaseState::Lapsed { .. }) {
            self.lease = LeaseState::Until(until);
        }
        Ok(())
    }

    fn brake(&mut self) -> Option<u64> {
        while self.error.is_none() && self.link.is_asking() {
            let _ = self.round(Duration::MAX);
        }
        match self.lease {
            LeaseState::Off => return None,
            LeaseState::Lapsed { at, .. } => return Some(at),
            LeaseState::Until(_) | LeaseState::Last if self.error.is_some() => return None,
            LeaseState::Until(_) | LeaseState::Last => {}
        }
        // What was not sent yet would only be dropped by the board.
        self.link.withdraw();
        let sent = self.link.extending();
        self.link.forget_extensions();
        self.motors.iter_mut().for_each(RemoteQueue::reset_packing);
        self.note_command();
        let Ok(Answer { reply: Reply::Braked { tick }, .. }) = self.ask(&Command::Brake) else { return None };
        self.decide_extensions(sent, tick);
        match (tick, self.lease) {
            // The event came first, and has the cause.
            (Some(_), LeaseState::Lapsed { .. }) => {}
            (Some(at), _) => {
                self.lease = LeaseState::Lapsed { at, cause: lease::LapseCause::Ordered, in_motion: false }
            }
            (None, _) => self.lease = LeaseState::Off,
        }
        tick
    }

    fn lease(&self) -> LeaseState {
        self.lease
    }

    fn extended(&mut self) -> Option<bool> {
        self.extended.pop_front()
    }

    fn await_extensions(&mut self) {
        if self.error.is_none() {
            // The error is kept in `self.error`.
            let _ = self.settle_extensions();
        }
    }
}

impl<P: Port> Remote<P> {
    /// The last extension or trim without an answer. The real lease is this one, the one of [`lease`](Leased::lease), or one of an extension in
    /// between.
    #[must_use]
    pub fn unconfirmed(&self) -> Option<Lease> {
        self.unconfirmed.back().map(|(lease, _)| *lease)
    }

    /// Begins a new session with a board that was lost or has ended the session.
    fn take_again(&mut self) -> Result<(), RemoteError> {
        self.port.set_baud(Baud::B115200)?;
        self.link = Link::new(!self.info.nonce);
        self.link.hello(self.port.now());
        match self.answer()?.reply {
            Reply::Info(info) => self.info = info,
            _ => return Err(RemoteError::Nonsense),
        }
        Ok(())
    }

    /// Waits until no motor moves, as long as `goes_on` returns true.
    fn at_rest(&mut self, mut goes_on: impl FnMut() -> bool) -> Result<Status, RemoteError> {
        let patience = self.port.now() + LONGEST_REST;
        loop {
            let status = self.status()?;
            if status.head.flags & flags::BAKED != 0 {
                let (what, reason) = ("do what a host says", Reason::Baked);
                return Err(RemoteError::Refused { what, reason, detail: 0 });
            }
            if status.is_idle() {
                return Ok(status);
            }
            if self.port.now() > patience || !goes_on() {
                return Err(RemoteError::StillMoving);
            }
            self.pause(STATUS_EVERY)?;
        }
    }

    /// The report of a stop whose answer did not come: every position is uncertain. At the latest the motors stop at the end of their lease.
    fn unknown_stop(&self) -> StopReport {
        StopReport { tick: self.now(), positions: self.positions(), uncertain: vec![true; self.motors.len()] }
    }
}
