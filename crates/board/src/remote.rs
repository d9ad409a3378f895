//! A board at the other end of a line.
//!
//! What is pushed is packed and sent as soon as time passes ([`Board::advance`], [`Leased::switch`]). Time is the
//! port's: a real one waits, a virtual one lets its board run. Ticks are the board's own, as its clock was read.
//!
//! When the board is lost, nothing waits for it: what is pushed goes nowhere, switches are refused, time goes on, and
//! [`Remote::error`] says why. What the board was told goes on to the end of its lease, from where the motors brake.

use crate::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use crate::link::{Answer, BITS, Link, LinkError};
use crate::packer::{MAX_LEN, Packer};
use crate::{Board, BoardClock, Edge, Fared, Faults, Observer, Sizer, StopReport, SwitchRefused};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease;
use pulsetrain_core::packing::Packing;
use pulsetrain_core::verbs::Verb;
use pulsetrain_core::wire::message::{
    self, Cause, Configuration, Event, Info, Measures, MotorSetup, NO_PIN, Status, flags, image, kind, limit_bytes,
};
use pulsetrain_core::wire::orders::{ORDER_LEN, Obeyed, Orders, order};
use pulsetrain_core::wire::{Baud, Command, Reason, Reply, Settings, Stopped, Stored, Switched, Trimmed};
use pulsetrain_core::{Entry, Epoch, Item, Tick32};
use std::collections::VecDeque;
use std::time::Duration;

/// How often the board is asked for its status while time passes.
const STATUS_EVERY: Duration = Duration::from_millis(50);

/// A frame that is not full goes out when fewer are on their way, if it is half full; else when none is.
const GATHERED: usize = 2;
/// Or, full or not, when fewer than these are, if its queue is not half full: answers of a board that has much to do take some milliseconds.
const NEEDED: usize = 3;

/// A board has enough to do when its queues are so full, all of them, %; and plenty.
const ENOUGH: usize = 25;
const PLENTY: usize = 50;
/// What goes into a queue that is fuller than this, %, may wait for more.
const FULL: usize = 75;

/// A board that has plenty is sent so much of its queues' bytes at once, one part of so many; one that has enough twice as much.
const PORTIONS: usize = 15;

/// And so often: a frame of USB.
const PORTION_EVERY: Duration = Duration::from_millis(1);

/// How often it is asked for room while a queue is fuller than half. The host knows by itself when items leave it; each question
/// costs an Uno as much as a frame of data.
const ROOM_EVERY: Duration = Duration::from_millis(10);

/// Time passes so much in one round at most.
const LONGEST_ROUND: Duration = Duration::from_millis(3);

/// A reading of the board's clock, over USB bridges that hold bytes back for a millisecond or two each way.
const BRIDGE_DELAY: Duration = Duration::from_millis(6);

/// An item has left its queue so long after it was due to, whatever the host's idea of the board's clock: a thousandth of a
/// second.
const TAKEN_PER_S: u64 = 1000;

/// Time passes at least so much in each round, however close its end is estimated.
const SHORTEST_ROUND: Duration = Duration::from_micros(10);

/// Readings of the clock before the first motion.
const FIRST_READINGS: usize = 8;

/// No clock is further off than one part in so many: twice what a ceramic resonator may be.
const CLOCK_DOUBT: u64 = 100;

/// How long motors that still move, for a host before this one, may take to come to rest.
const REST: Duration = Duration::from_secs(30);

/// A line to a board: bytes, and a clock of its own.
pub trait Port {
    /// Time since the port was opened.
    fn now(&self) -> Duration;

    /// Hands bytes over; they go out one after the other.
    ///
    /// # Errors
    /// When the port is gone.
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError>;

    /// Lets time pass until `until`, or until bytes have come; appends them to `into`.
    ///
    /// # Errors
    /// When the port is gone.
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError>;

    /// Changes the rate once all bytes that were handed over are out.
    ///
    /// # Errors
    /// When the port is gone, or cannot do it.
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError>;

    /// The edges of the board's pins since the last call, appended to `into`, in board ticks: what a virtual port knows.
    fn edges(&mut self, into: &mut Vec<Edge>) {
        let _ = into;
    }
}

/// What is wrong with a port.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PortError {
    /// There is none of that name.
    #[error("there is no port {name}{}", listed(.there_are))]
    NotThere {
        /// As it was asked for.
        name: String,
        /// What there is.
        there_are: Vec<String>,
    },
    /// Another program has it.
    #[error("{name} is in use: close the program that has it open (an IDE's serial monitor, say)")]
    Busy {
        /// The port.
        name: String,
    },
    /// The user may not open it.
    #[error("no permission to open {name}: on Linux, `sudo usermod -aG dialout $USER`, then log in again")]
    Denied {
        /// The port.
        name: String,
    },
    /// It is there, but nothing that could be opened as a port.
    #[error("{name} cannot be opened as a serial port: {why}")]
    Unusable {
        /// As it was asked for.
        name: String,
        /// What the system says.
        why: String,
    },
    /// It was there, and is no more.
    #[error("{name} is gone: {why}")]
    Gone {
        /// The port.
        name: String,
        /// What the system says.
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

/// Why a remote board cannot be used, or not any more.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RemoteError {
    /// The port.
    #[error(transparent)]
    Port(#[from] PortError),
    /// The link.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The board refuses.
    #[error("the board refuses to {what}: {}", said(*.reason, *.detail))]
    Refused {
        /// What it was to do.
        what: &'static str,
        /// Why not.
        reason: Reason,
        /// As [`Reason`] says.
        detail: u16,
    },
    /// The board stopped by itself, and takes nothing more.
    #[error("the board stopped: {}", in_words(*.cause))]
    Stopped {
        /// Why.
        cause: Cause,
    },
    /// More orders than one frame has room for: none was sent.
    #[error("{orders} orders are more than the board takes at once: {most}")]
    TooManyOrders {
        /// How many they were.
        orders: usize,
        /// How many it takes.
        most: usize,
    },
    /// The answer was to something else.
    #[error("the board's answer makes no sense: its firmware is not what it says")]
    Nonsense,
    /// Another kind of board than the plan is for.
    #[error(
        "the board is {is}, but the motion is planned for `{wanted}`: a clock of {wanted_hz} Hz, {wanted_bits} fraction bits"
    )]
    OtherBoard {
        /// What it is: [`name_of`].
        is: &'static str,
        /// What was planned for, as a motion file calls it.
        wanted: String,
        /// Its ticks a second.
        wanted_hz: u64,
        /// Its F.
        wanted_bits: u32,
    },
    /// An Uno with another of its images than is needed.
    #[error("the board has the image `{is}`, and this takes the image `{wanted}`")]
    OtherImage {
        /// What it has: [`image_name`].
        is: &'static str,
        /// What is needed.
        wanted: &'static str,
    },
    /// What was to be stored is not what it keeps then.
    #[error("the board's memory did not take the settings: try again; if that does not help it is worn out")]
    NotKept,
    /// Motors that the board moves for a host before this one do not come to rest.
    #[error("the board still moves motors for a host before this one")]
    StillMoving,
}

/// A refusal in words.
fn said(reason: Reason, detail: u16) -> String {
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
                "motor {detail} has a move under way and one that waits, or moves that are done and not told: wait until one is done, or halt it"
            )
        }
        Reason::Obeying => "its motors are told directly until they are released".to_owned(),
        Reason::SharedDir => {
            "motors that share a DIR line cannot be told directly on it: give each its own, or send plans".to_owned()
        }
        Reason::Baked => {
            "a motion in its flash runs, which was baked; `pulsetrain flash pico` brings the plain firmware back"
                .to_owned()
        }
    }
}

/// A cause in words: why a board stopped, or restarted.
#[must_use]
pub const fn in_words(cause: Cause) -> &'static str {
    match cause {
        Cause::None => "none yet",
        Cause::Finished => "everything was done",
        Cause::StopNow => "the host asked for an immediate stop",
        Cause::HostLost => "the host was silent for too long",
        Cause::Starved => "its step generator did not keep up",
        Cause::BadItem => "a queue held what no host packs",
        Cause::CheckFailed => "position or accumulator were not the host's",
        Cause::StepMissed => "a step was asked for too late",
        Cause::EdgeLate => "an edge was late",
        Cause::Overrun => "bytes were lost on the line",
        Cause::BaudFellBack => "the line fell back to 115 200 baud",
        Cause::Watchdog => "the watchdog restarted the program",
        Cause::BrownOut => "the supply fell too low",
        Cause::ResetLine => "the reset line, as when a port is opened",
        Cause::PowerOn => "power came on",
        Cause::MoveDone => "a move was done",
        Cause::Lapsed => "the host was late, and the motors braked",
        Cause::Braked => "the host asked the motors to brake",
        Cause::RanDry => "a motor had no more plan, and all braked",
    }
}

/// What a board says that it is.
#[must_use]
pub const fn name_of(info: &Info) -> &'static str {
    match info.board {
        1 => "an Arduino Uno",
        2 => "a Raspberry Pi Pico",
        _ => "a model, no chip",
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

/// What a board is to be configured for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Setup {
    /// STEP is active so long, ticks.
    pub pulse_ticks: u16,
    /// DIR is right so long before the step, ticks.
    pub setup_ticks: u16,
    /// DIR stays so long after the end of the pulse, ticks.
    pub hold_ticks: u16,
    /// The pin that enables all drivers, and whether it is active high.
    pub enable: Option<(u8, bool)>,
    /// The motors are released after so long a rest, ms; `None`: they hold.
    pub idle_ms: Option<u16>,
    /// The board gives this host up after so long a silence, ms; 0: 2000.
    pub silence_ms: u16,
    /// The motors, at most 8.
    pub motors: Vec<MotorSetup>,
}

impl Setup {
    /// Its motors, as a [`Configuration`] has them.
    #[must_use]
    pub fn motor_bytes(&self) -> Vec<u8> {
        self.motors.iter().flat_map(MotorSetup::to_bytes).collect()
    }

    /// What Configure says; `motors` are its [`motor_bytes`](Setup::motor_bytes). `None` with more than 8 of them.
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

/// An item in a board's queue.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    epoch: Epoch,
    /// When the board has taken it at the latest, if its switches are those that were accepted.
    until: u64,
    len: usize,
    /// How it was before the item was packed.
    before: (Option<Epoch>, Packer),
}

/// One motor, as far as the host remembers it.
#[derive(Clone, Debug)]
struct Motor {
    packing: Packing,
    /// Bytes of its queue.
    capacity: usize,
    /// The epoch that is being packed, and how far.
    epoch: Option<Epoch>,
    packer: Packer,
    /// Packed, but not sent.
    packed: Vec<u8>,
    /// What the board may not have taken yet, in order.
    waiting: VecDeque<Waiting>,
    position: i64,
    faults: u8,
}

/// A board at the other end of a [`Port`].
#[derive(Clone, Debug)]
pub struct Remote<P> {
    port: P,
    link: Link,
    info: Info,
    clock: BoardClock,
    motors: Vec<Motor>,
    epoch: Epoch,
    /// As far as the board has confirmed it.
    lease: LeaseState,
    /// Extensions on their way, oldest first, and the limits that they bring.
    unconfirmed: VecDeque<(Lease, Vec<Limit>)>,
    /// The board's answers, oldest first, that [`Leased::extended`] has not reported yet.
    extended: VecDeque<bool>,
    /// How hard each motor brakes.
    limits: Vec<Limit>,
    /// Of the switch that began the lease: when it was accepted, and for which tick.
    leased: (u64, u64),
    /// Ticks from the board's clock to its horizon, when it was asked last.
    ahead: u64,
    /// Whether the board was idle, when it was asked last after it was told something.
    idle: bool,
    /// When it was told something last.
    told: Duration,
    asked_status: Duration,
    asked_room: Duration,
    /// No tick before it is left to pass.
    passed: u64,
    edges: Vec<Edge>,
    events: Vec<Event>,
    error: Option<RemoteError>,
    /// Handed out by the link, not sent; when its next portion may be.
    outbox: Vec<u8>,
    next_portion: Duration,
    /// Somebody waits for an answer.
    waits: bool,
    inbox: Vec<u8>,
}

impl<P: Port> Remote<P> {
    /// Takes the board at the other end: says Hello until it answers. `nonce` is to be another one each time.
    ///
    /// # Errors
    /// When nobody answers, another host has the board, or it speaks another protocol.
    pub fn open(port: P, nonce: u32) -> Result<Remote<P>, RemoteError> {
        let mut link = Link::new(nonce);
        link.hello(port.now());
        Remote::greet(port, link)
    }

    /// The same, but does not wait for another who has the board.
    ///
    /// # Errors
    /// As [`open`](Remote::open); when another host, or text, has the board, at its first word.
    pub fn open_if_free(port: P, nonce: u32) -> Result<Remote<P>, RemoteError> {
        let mut link = Link::new(nonce);
        link.hello_if_free(port.now());
        Remote::greet(port, link)
    }

    /// Goes on until Hello is answered.
    fn greet(port: P, link: Link) -> Result<Remote<P>, RemoteError> {
        let info = Info::NOBODY;
        let now = port.now();
        let mut remote = Remote {
            port,
            link,
            info,
            clock: BoardClock::new(1),
            motors: Vec::new(),
            epoch: Epoch(0),
            lease: LeaseState::Off,
            unconfirmed: VecDeque::new(),
            extended: VecDeque::new(),
            limits: Vec::new(),
            leased: (0, 0),
            ahead: 0,
            idle: false,
            told: now,
            asked_status: now,
            asked_room: now,
            passed: 0,
            edges: Vec::new(),
            events: Vec::new(),
            error: None,
            outbox: Vec::new(),
            next_portion: now,
            waits: false,
            inbox: Vec::new(),
        };
        match remote.answer()?.reply {
            Reply::Info(info) => remote.info = info,
            _ => return Err(RemoteError::Nonsense),
        }
        remote.clock = BoardClock::new(remote.info.tick_hz);
        remote.read_clock()?;
        Ok(remote)
    }

    /// What the board is.
    #[must_use]
    pub const fn info(&self) -> &Info {
        &self.info
    }

    /// Changes the rate of the line. Gives the one that both ends are at then: 115 200 baud if the new one failed.
    ///
    /// # Errors
    /// When the board is lost, or refuses.
    pub fn set_baud(&mut self, baud: Baud) -> Result<Baud, RemoteError> {
        self.settle()?;
        self.done("change its rate", &Command::Baud { baud })?;
        self.settle()?;
        Ok(self.link.baud())
    }

    /// Waits until motors rest that the board still moves for a host before this one; while one moves, `goes_on` is asked again and again
    /// whether to wait on.
    ///
    /// # Errors
    /// When the board is lost; [`RemoteError::StillMoving`] if `goes_on` says no, or if they do not rest within half a minute.
    pub fn wait_for_rest(&mut self, goes_on: impl FnMut() -> bool) -> Result<(), RemoteError> {
        self.at_rest(goes_on).map(drop)
    }

    /// Has the board set up its pins, and arms it. Motors that move come to rest first: [`wait_for_rest`](Remote::wait_for_rest).
    ///
    /// # Errors
    /// When the board is lost, or refuses; nothing is powered then.
    ///
    /// # Panics
    /// With more than 8 motors.
    pub fn configure(&mut self, setup: &Setup) -> Result<(), RemoteError> {
        if setup.motors.len() > usize::from(self.info.max_motors) {
            // A frame that is too long would not even be refused.
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
        let motor = |(motor, bytes): (&MotorSetup, &u16)| Motor {
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
        self.limits = vec![Limit::WITHIN_A_STEP; self.motors.len()];
        self.arm()?;
        for _ in 0..FIRST_READINGS {
            self.read_clock()?;
        }
        Ok(())
    }

    /// Powers the motors, with empty queues: also after [`Board::stop_now`].
    ///
    /// # Errors
    /// When the board is lost, or refuses.
    pub fn arm(&mut self) -> Result<(), RemoteError> {
        self.done("arm its motors", &Command::Arm)?;
        self.end_lease();
        for motor in &mut self.motors {
            motor.forget();
            motor.waiting.clear();
        }
        self.status().map(drop)
    }

    /// Stops all motors at once, without ramps, whoever told them to move. Gives after which tick no step was begun and whose position is
    /// uncertain, and what each of the board's motors counts.
    ///
    /// # Errors
    /// When the board is lost.
    pub fn stop_motors(&mut self) -> Result<(Stopped, Vec<i64>), RemoteError> {
        let answer = self.ask(&Command::StopNow);
        self.end_lease();
        for motor in &mut self.motors {
            motor.forget();
            motor.waiting.clear();
        }
        let answer = answer?;
        let Reply::Stopped { stopped, positions } = answer.reply else { return Err(refusal("stop", &answer)) };
        for (motor, position) in self.motors.iter_mut().zip(positions.as_slice()) {
            motor.count(*position);
        }
        Ok((stopped, positions.as_slice().iter().map(|position| i64::from(*position)).collect()))
    }

    /// Takes the power from motors that rest.
    ///
    /// # Errors
    /// When the board is lost, or motors move.
    pub fn release(&mut self) -> Result<(), RemoteError> {
        self.done("release its motors", &Command::Release)
    }

    /// Asks the board how it is.
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

    /// Asks the board what it measured of itself; with `reset`, everything begins anew first.
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

    /// Tells motors directly: see [`Verbs`](pulsetrain_core::verbs::Verbs). `orders` are motors and what each is told, eight at most (six on an
    /// Uno), all from the same tick on.
    ///
    /// Moves that are done are told as [`events`](Remote::events), [`Cause::MoveDone`].
    ///
    /// # Errors
    /// When the board is lost, or refuses, or takes fewer at once: nothing was done then.
    ///
    /// # Panics
    /// With more than eight orders.
    pub fn tell_motors(&mut self, orders: &[(u8, Verb)]) -> Result<Obeyed, RemoteError> {
        // A body has two bytes before them.
        let most = (usize::from(self.info().max_body) - 2) / ORDER_LEN;
        if orders.len() > most {
            return Err(RemoteError::TooManyOrders { orders: orders.len(), most });
        }
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        let command = Command::Orders(Orders::decode(&bytes).expect("at most eight orders"));
        self.told = self.port.now();
        self.idle = false;
        let answer = self.ask(&command)?;
        match answer.reply {
            Reply::Obeyed(obeyed) => Ok(obeyed),
            _ => Err(self.refused(refusal("do that", &answer))),
        }
    }

    /// Whether its motors can be told directly: [`tell_motors`](Remote::tell_motors).
    ///
    /// # Errors
    /// When the board is lost.
    pub fn obeys(&mut self) -> Result<bool, RemoteError> {
        let answer = self.ask(&Command::Orders(Orders::NONE))?;
        Ok(!matches!(answer.reply, Reply::Refused { reason: Reason::UnknownKind, .. }))
    }

    /// Has the board keep `settings` without power, in place of those before. They hold for configurations and text that come after.
    ///
    /// # Errors
    /// When the board is lost, or refuses: its motors are powered, it keeps nothing, or limits are beyond what
    /// [`Settings`] says.
    pub fn store(&mut self, settings: &Settings) -> Result<(), RemoteError> {
        let stored = self.settings(Some(*settings))?;
        if stored.settings == Some(*settings) { Ok(()) } else { Err(RemoteError::NotKept) }
    }

    /// What the board keeps without power.
    ///
    /// # Errors
    /// When the board is lost, or refuses: its motors are powered, or it keeps nothing.
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

    /// Gives the board up; what it was told goes on. Gives the port back.
    pub fn close(mut self) -> P {
        // Unanswered, it is over all the same: the board gives up a silent host.
        let _ = self.done("say good-bye", &Command::Bye);
        self.port
    }

    /// What the board said unasked since the last call.
    pub fn events(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.events)
    }

    /// Why the board cannot be used any more.
    #[must_use]
    pub const fn error(&self) -> Option<&RemoteError> {
        self.error.as_ref()
    }

    /// The board's clock.
    #[must_use]
    pub const fn clock(&self) -> &BoardClock {
        &self.clock
    }

    /// The link: its rate and counts.
    #[must_use]
    pub const fn link(&self) -> &Link {
        &self.link
    }

    /// The port.
    #[must_use]
    pub const fn port(&self) -> &P {
        &self.port
    }

    /// The port, for what is not the link's.
    pub const fn port_mut(&mut self) -> &mut P {
        &mut self.port
    }

    /// Why it stopped says more than that its motors are not armed.
    fn refused(&self, refused: RemoteError) -> RemoteError {
        match (&refused, self.told_stop()) {
            (RemoteError::Refused { reason: Reason::NotArmed, .. }, Some(cause)) => RemoteError::Stopped { cause },
            _ => refused,
        }
    }

    /// The stop that was none of the plan's, if the board told of one.
    fn told_stop(&self) -> Option<Cause> {
        let told = self.events.iter().rev().map(|event| event.cause);
        told.into_iter().find(|cause| {
            matches!(
                cause,
                Cause::StopNow
                    | Cause::Starved
                    | Cause::BadItem
                    | Cause::CheckFailed
                    | Cause::StepMissed
                    | Cause::Lapsed
                    | Cause::Braked
                    | Cause::RanDry
            )
        })
    }

    fn read_clock(&mut self) -> Result<(), RemoteError> {
        self.ask(&Command::Clock).map(drop)
    }

    /// Asks for something that is answered by "done".
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
            self.waits = true;
            let done = self.round(Duration::MAX);
            self.waits = false;
            done?;
        }
    }

    /// Waits until nothing is on its way.
    fn settle(&mut self) -> Result<(), RemoteError> {
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

    /// Sends what is due, and waits until `until`, or until the board says something, or something is due.
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
        let portion = self.portion();
        if portion == usize::MAX || now >= self.next_portion {
            self.port.send(&self.outbox[..portion.min(self.outbox.len())])?;
            self.outbox.drain(..portion.min(self.outbox.len()));
            self.next_portion = now + PORTION_EVERY;
        }
        let mut due = self.link.deadline().unwrap_or(until).min(until);
        if !self.outbox.is_empty() {
            due = due.min(self.next_portion);
        }
        self.inbox.clear();
        self.port.receive(due.max(now + SHORTEST_ROUND), &mut self.inbox)?;
        self.link.input(&self.inbox, self.port.now());
        self.hear_of_lease();
        if let Some((reason, detail)) = self.link.refusal() {
            return Err(self.refused(RemoteError::Refused { what: "take more", reason, detail }));
        }
        self.port.edges(&mut self.edges);
        Ok(())
    }

    /// What the board said unasked, and of an extension.
    fn hear_of_lease(&mut self) {
        while let Some(event) = self.link.event() {
            let cause = match event.cause {
                Cause::Lapsed => Some(lease::LapseCause::NotExtended),
                Cause::Braked => Some(lease::LapseCause::Ordered),
                Cause::RanDry => Some(lease::LapseCause::Underrun),
                Cause::BadItem | Cause::CheckFailed => Some(lease::LapseCause::BadItem),
                Cause::StepMissed => Some(lease::LapseCause::StepMissed),
                _ => None,
            };
            if let Some(cause) = cause {
                self.note_lapse(event.tick, Some(cause), self.now());
            }
            if event.cause == Cause::Starved && self.lease != LeaseState::Off {
                // An immediate stop: it ends no lease by the rule that the host replays.
                self.error.get_or_insert(RemoteError::Stopped { cause: event.cause });
            }
            self.events.push(event);
        }
        while let Some(accepted) = self.link.extended()
            && let Some((lease, limits)) = self.unconfirmed.pop_front()
        {
            match (accepted, self.lease) {
                // An event of its end was sooner.
                (true, LeaseState::Lapsed { .. }) => self.limits = limits,
                (true, _) => (self.lease, self.limits) = (lease.into(), limits),
                // The board is to say why.
                (false, _) => self.asked_status = Duration::ZERO,
            }
            self.extended.push_back(accepted);
        }
    }

    /// The board says, at its tick `now`, that the lease is over since `at`; an event has the `cause`, and says so only of motors in motion.
    fn note_lapse(&mut self, at: u64, cause: Option<lease::LapseCause>, now: u64) {
        let (accepted, begins) = self.leased;
        // That of the lease before, from which the switch is to lead away.
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
        self.tell();
        if self.error.is_some() || self.settle_extensions().is_err() {
            return Err(SwitchRefused::Lost);
        }
        let limits: Vec<u8> = limits.iter().copied().flat_map(limit_bytes).collect();
        let command = Command::Switch { epoch, tick, lease, limits: &limits };
        let answer = self.ask(&command).map_err(|_| SwitchRefused::Lost)?;
        let refused = match answer.reply {
            Reply::Switched(Switched::Accepted) => {
                self.epoch = epoch;
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
            motor.forget();
            motor.drop_epoch(epoch);
        }
        // The room that the dropped items took.
        let _ = self.status();
        Err(refused)
    }

    /// There is none, and no extension on its way.
    fn end_lease(&mut self) {
        self.lease = LeaseState::Off;
        self.unconfirmed.clear();
        self.extended.clear();
        self.link.forget_extensions();
    }

    /// What became of the extensions before an order to brake, of which so many were sent: the motors brake from `tick` on. If a lease ends there, it
    /// was over before the order came, and what was sent behind it was refused. Else the board accepted all.
    fn judge_extensions(&mut self, sent: usize, tick: Option<u64>) {
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

    /// Waits until it is known what became of all extensions: the board tells only what it accepted last.
    fn settle_extensions(&mut self) -> Result<(), RemoteError> {
        while self.link.extending() > 0 {
            self.round(Duration::MAX)?;
        }
        Ok(())
    }

    /// A lease as frames have it, if ticks so far ahead can be told apart; else the first that cannot.
    fn moment_of(&self, lease: Lease) -> Result<lease::Lease, u64> {
        let limit = self.now() + (1 << 30);
        match lease {
            Lease::Until(tick) if tick >= limit => Err(limit),
            Lease::Until(tick) => Ok(lease::Lease::Until(Tick32::of(tick))),
            Lease::Last => Ok(lease::Lease::Last),
        }
    }

    /// All motors' limits, if some are given: those that are not stay.
    fn limits_with(&self, given: &[Limit]) -> Vec<Limit> {
        let mut all = self.limits.clone();
        all.iter_mut().zip(given).for_each(|(limit, given)| *limit = *given);
        all
    }

    /// What an answer says of clock and motors.
    fn note(&mut self, answer: &Answer) {
        match answer.reply {
            Reply::Clock { tick } => self.clock.read(tick, answer.asked, answer.answered),
            Reply::Status(status) => {
                self.clock.read(status.head.tick, answer.asked, answer.answered);
                self.ahead = status.head.horizon.saturating_sub(status.head.tick);
                if let message::LeaseState::Lapsed(at) = status.head.lease {
                    let now = status.head.tick;
                    let ahead = at.since(Tick32::of(now)).cast_signed();
                    self.note_lapse(now.saturating_add_signed(ahead.into()), None, now);
                }
                if answer.asked >= self.told {
                    self.idle = status.is_idle();
                }
                for (motor, said) in self.motors.iter_mut().zip(status.motors.as_slice()) {
                    motor.count(said.position);
                    motor.faults = said.faults;
                }
            }
            _ => {}
        }
    }

    /// Hands what was packed over to the link.
    fn flush(&mut self) {
        let now = self.port.now();
        for (index, motor) in (0..).zip(&mut self.motors) {
            motor.flush(index, &mut self.link, now);
        }
    }

    /// The same, but for what may wait: as long as the board's queue is nearly full, or frames are on their way, more is gathered, so
    /// that frames are long: what one costs a board is much the same, however long it is.
    fn gather(&mut self) {
        let (now, tick) = (self.port.now(), self.now());
        let much = self.link.max_packed() / 2;
        for (index, motor) in (0..).zip(&mut self.motors) {
            let has = motor.has(tick, self.epoch);
            let most = if has < PLENTY {
                NEEDED
            } else if motor.packed.len() > much {
                GATHERED
            } else {
                1
            };
            if has < FULL && self.link.frames() < most {
                motor.flush(index, &mut self.link, now);
            }
        }
    }

    /// How many bytes go out at once. The more the board has to do, the fewer, and not as fast as the line takes
    /// them: each keeps an Uno from its steps.
    fn portion(&self) -> usize {
        let tick = self.now();
        let least = self.motors.iter().map(|motor| motor.has(tick, self.epoch)).min().unwrap_or(0);
        let few = usize::from(self.info.pool) / PORTIONS;
        match least {
            _ if self.waits => usize::MAX,
            PLENTY.. => few.max(1),
            ENOUGH.. => 2 * few.max(1),
            _ => usize::MAX,
        }
    }

    /// After so many ticks an item has left its queue.
    fn taken(&self) -> u64 {
        u64::from(self.info.tick_hz) / TAKEN_PER_S
    }

    /// Notes that the board is being told something that it may move for.
    fn tell(&mut self) {
        self.told = self.port.now();
        self.idle = false;
    }

    /// Asks what there is to ask while time passes.
    fn look_after(&mut self) {
        let now = self.port.now();
        if let Some(answer) = self.link.answer() {
            self.note(&answer);
        }
        if now >= self.asked_status + STATUS_EVERY && !self.link.is_asking() {
            self.asked_status = now;
            self.link.ask(&Command::Status, now);
        }
        let full = (0..).zip(&self.motors).any(|(index, motor)| self.link.room(index) < motor.capacity / 2);
        if full && now >= self.asked_room + ROOM_EVERY {
            self.asked_room = now;
            self.link.poll(now);
        }
    }

    /// A virtual board may be beyond `until`, to the end of a frame of USB: its later edges wait.
    fn hand_over(&mut self, until: u64, observer: &mut impl Observer) {
        let due = self.edges.partition_point(|edge| edge.tick <= until);
        self.edges.drain(..due).for_each(|edge| observer.edge(edge));
    }
}

impl Motor {
    fn flush(&mut self, index: u8, link: &mut Link, now: Duration) {
        if let (Some(epoch), false) = (self.epoch, self.packed.is_empty()) {
            link.send(index, epoch, &self.packed, now);
            self.packed.clear();
        }
    }

    /// What was packed last is not to come, or has been dropped.
    fn forget(&mut self) {
        self.epoch = None;
        self.packed.clear();
    }

    /// Drops the items of an epoch, which are the last that were pushed.
    fn drop_epoch(&mut self, epoch: Epoch) {
        while self.waiting.pop_back_if(|item| item.epoch == epoch).is_some() {}
    }

    /// What is left of older epochs goes at `tick`.
    fn switch(&mut self, epoch: Epoch, tick: u64) {
        for item in self.waiting.iter_mut().filter(|item| item.epoch != epoch) {
            item.until = item.until.min(tick);
        }
    }

    /// How full its queue is at tick `now`, by when the board takes what; %. None of it counts when what is packed waits for its switch,
    /// which is to be asked for soon.
    fn has(&self, now: u64, running: Epoch) -> usize {
        if self.epoch != Some(running) {
            return 0;
        }
        let free = self.room_at(now) + self.packed.len();
        100 * self.capacity.saturating_sub(free) / self.capacity.max(1)
    }

    /// Room that there is at tick `now`, sent or not, by when the board takes what.
    fn room_at(&self, now: u64) -> usize {
        let left = self.waiting.iter().skip_while(|item| item.until < now).map(|item| item.len);
        self.capacity.saturating_sub(left.sum())
    }

    /// The board counts in 32 bits.
    fn count(&mut self, position: i32) {
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
        let (room, lost, taken) = (self.room(index), self.error.is_some(), self.taken());
        let Some(motor) = self.motors.get_mut(index) else { return Err(entry) };
        let (now, tick) = (self.port.now(), self.clock.tick_at(self.port.now()).unwrap_or(0).max(self.passed));
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
        // Ticks of one queue are within 2^31 of now.
        let until =
            |begins: Tick32| tick.saturating_add_signed(begins.0.wrapping_sub(tick as u32).cast_signed().into());
        let until = until(begins);
        motor.waiting.push_back(Waiting { epoch: entry.epoch, until, len, before });
        motor.packed.extend_from_slice(&bytes[..len]);
        self.tell();
        Ok(())
    }

    fn discard(&mut self, epoch: Epoch) {
        for motor in self.motors.iter_mut().filter(|motor| motor.epoch == Some(epoch)) {
            motor.forget();
            motor.drop_epoch(epoch);
        }
        if self.error.is_none() && self.done("drop an epoch", &Command::Discard { epoch }).is_ok() {
            // Without an answer the room stays what it was: too little.
            let _ = self.status();
        }
    }

    fn room(&self, motor: usize) -> usize {
        let Some(queue) = self.motors.get(motor) else { return 0 };
        if self.error.is_some() {
            // For nothing: but a host that waits for room would wait for ever.
            return queue.capacity;
        }
        let said = u8::try_from(motor).map_or(0, |index| self.link.room(index).saturating_sub(queue.packed.len()));
        // News of room is some milliseconds old. What is sent now arrives later still.
        said.max(queue.room_at(self.now().saturating_sub(self.taken())))
    }

    fn sizer(&self, motor: usize) -> Sizer {
        let none = Packing { fraction_bits: u32::from(self.info.fraction_bits), gain: 0 };
        self.motors.get(motor).map_or(Sizer::packed(none, 0), |motor| Sizer::packed(motor.packing, motor.capacity))
    }

    fn lead(&self) -> u64 {
        // Half of all queues filled, as most that goes before a switch; a fault on the way; and the switch itself.
        let fill = Duration::from_secs(BITS * u64::from(self.info.pool) / 2) / self.link.baud().rate();
        let lead = fill + 2 * self.link.shortest_timeout();
        (lead.as_secs_f64() * f64::from(self.info.tick_hz)) as u64
    }

    fn horizon(&self) -> u64 {
        self.now() + self.ahead
    }

    fn now(&self) -> u64 {
        self.clock.tick_at(self.port.now()).unwrap_or(0).max(self.passed)
    }

    fn epoch(&self) -> Epoch {
        self.epoch
    }

    fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        while self.now() <= until {
            self.gather();
            if self.error.is_none() {
                self.look_after();
            }
            let end = self.clock.time_of(until.saturating_add(1)).unwrap_or_default();
            let next = self.port.now() + LONGEST_ROUND;
            if self.round(end.min(next)).is_err() {
                // The board may run on, if it is a virtual one; its link is gone.
                let gone = self.port.receive(end.max(self.port.now() + SHORTEST_ROUND), &mut self.inbox).is_err();
                self.port.edges(&mut self.edges);
                self.inbox.clear();
                if gone {
                    self.passed = until.saturating_add(1);
                }
            }
            self.passed = self.passed.max(self.clock.tick_at(self.port.now()).unwrap_or(0).min(until + 1));
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

    fn lost(&self) -> Option<&RemoteError> {
        self.error()
    }

    fn fared(&mut self) -> Result<Fared, RemoteError> {
        let clock = self.clock.clone();
        let is_lost = self.link.error().is_some();
        if is_lost {
            self.take_again()?;
        }
        // A board that stopped refuses each frame of data that is still on its way.
        while !self.link.is_quiet() {
            match self.round(Duration::MAX) {
                Ok(()) | Err(RemoteError::Refused { .. } | RemoteError::Stopped { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        let Answer { reply: Reply::Clock { tick }, asked, answered } = self.ask(&Command::Clock)? else {
            return Err(RemoteError::Nonsense);
        };
        // A clock that restarted is far behind; one that runs on is within what it may be off, and what readings are uncertain by. A
        // board that still knows the session was not reset.
        let expected = clock.tick_at(asked).unwrap_or(0);
        let reading = 2 * (answered - asked) + BRIDGE_DELAY;
        let doubt = expected / CLOCK_DOUBT + (reading.as_secs_f64() * f64::from(self.info.tick_hz)) as u64;
        let was_reset = is_lost && tick + doubt < expected;
        let status = self.at_rest(|| true)?;
        let counts = status.motors.as_slice().iter().map(|motor| i64::from(motor.position));
        let positions = if was_reset { counts.collect() } else { self.positions() };
        let is_armed = status.head.flags & flags::ARMED != 0;
        let last_stop = match self.told_stop() {
            _ if is_lost => self.info.last_stop,
            Some(cause) => cause,
            None if is_armed => Cause::Finished,
            // The board keeps two events, and the stop may not be among them. The answer to Hello has its cause.
            None => {
                self.done("say good-bye", &Command::Bye)?;
                self.take_again()?;
                self.info.last_stop
            }
        };
        Ok(Fared { positions, last_stop, reset: was_reset.then_some(self.info.last_reset) })
    }
}

impl<P: Port> Leased for Remote<P> {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        let told = match self.moment_of(lease) {
            Ok(told) => told,
            Err(limit) => {
                self.discard(epoch);
                return Err(SwitchRefused::Early { limit });
            }
        };
        let all = self.limits_with(limits);
        self.switch_with(epoch, tick, told, if limits.is_empty() { &[] } else { &all })?;
        (self.lease, self.limits, self.leased) = (lease.into(), all, (self.now(), tick));
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
        let told = self.moment_of(lease).map_err(|limit| ExtendRefused::Early { limit })?;
        self.flush();
        self.tell();
        let all = self.limits_with(limits);
        let bytes: Vec<u8> =
            if limits.is_empty() { Vec::new() } else { all.iter().copied().flat_map(limit_bytes).collect() };
        self.link.extend(told, &bytes, self.port.now());
        self.unconfirmed.push_back((lease, all));
        Ok(())
    }

    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        let lease = self.moment_of(Lease::Until(until)).map_err(|limit| ExtendRefused::Early { limit })?;
        let lease::Lease::Until(moment) = lease else { return Err(ExtendRefused::Off.into()) };
        // What is dropped is at the end of the board's queue then.
        self.flush();
        self.tell();
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
        let Ok(answer) = self.ask(&Command::Trim { until: moment, bytes: &bytes }) else {
            // The board may have taken it.
            self.unconfirmed.push_back((Lease::Until(until), self.limits.clone()));
            return Err(ExtendRefused::Lost.into());
        };
        match answer.reply {
            Reply::Trimmed(Trimmed::Accepted) => {}
            Reply::Trimmed(Trimmed::Late { horizon }) => return Err(ExtendRefused::Late { horizon }.into()),
            Reply::Trimmed(Trimmed::TooMany { motor }) => return Err(TrimRefused::Read { motor: motor.into() }),
            Reply::Trimmed(Trimmed::NoLease) => {
                // Since when it is over, the board says.
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
            if let Some(Waiting { before, .. }) = motor.waiting.drain(kept..).next() {
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
        // The board would drop what it has not been sent.
        self.link.withdraw();
        let sent = self.link.extending();
        self.link.forget_extensions();
        self.motors.iter_mut().for_each(Motor::forget);
        self.tell();
        let Ok(Answer { reply: Reply::Braked { tick }, .. }) = self.ask(&Command::Brake) else { return None };
        self.judge_extensions(sent, tick);
        match (tick, self.lease) {
            // An event was sooner, and knows the cause.
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
            // An error is kept.
            let _ = self.settle_extensions();
        }
    }
}

impl<P: Port> Remote<P> {
    /// The last extension or trim that has no answer: the plan holds so long, or as [`lease`](Leased::lease) says, or as an extension before it.
    #[must_use]
    pub fn unconfirmed(&self) -> Option<Lease> {
        self.unconfirmed.back().map(|(lease, _)| *lease)
    }

    /// Takes a board that was lost, or has forgotten the session, with a new one.
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

    /// Waits until no motor moves, or `goes_on` says no.
    fn at_rest(&mut self, mut goes_on: impl FnMut() -> bool) -> Result<Status, RemoteError> {
        let patience = self.port.now() + REST;
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

    /// Nobody knows whether the board stopped: it stops as it was planned at the latest.
    fn unknown_stop(&self) -> StopReport {
        StopReport { tick: self.now(), positions: self.positions(), uncertain: vec![true; self.motors.len()] }
    }
}
