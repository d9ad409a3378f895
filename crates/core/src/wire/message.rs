//! Commands, answers and events: the bodies of frames.
//!
//! Every body begins with the sequence number and the kind; what follows is said in a table at each type. All integers
//! are little-endian.
//!
//! Why a board refuses, and why motors stopped, is in [`outcome`](super::outcome).
//!
//! The board writes its answers field by field into the frame ([`Info::encode`] and its like; Status, Switched and Stopped
//! are [`service`](super::service)'s), the host reads them into structs ([`Reply::decode`]); commands the other way round ([`Command`]).

use super::frame::{Encoder, MAX_BODY, Tag};
use super::limits::{Baud, MAX_MOTORS, VERSION};
use super::orders::{Obeyed, Orders};
pub use super::outcome::{Cause, Missing, Reason};
use super::outcome::{NO_LEASE, Stopped, Switched, Trimmed};
use super::settings::{SETTINGS_LEN, Settings, Stored};
use crate::braking::Limit;
use crate::lease::Lease;
use crate::output::Sequence;
use crate::{Epoch, Tick32};

/// What a command is, byte 1 of its body.
pub mod kind {
    /// [`Command::Hello`](super::Command::Hello)
    pub const HELLO: u8 = 0x01;
    /// [`Command::Configure`](super::Command::Configure)
    pub const CONFIGURE: u8 = 0x02;
    /// [`Command::Arm`](super::Command::Arm)
    pub const ARM: u8 = 0x03;
    /// [`Command::Release`](super::Command::Release)
    pub const RELEASE: u8 = 0x04;
    /// [`Command::Clock`](super::Command::Clock)
    pub const CLOCK: u8 = 0x05;
    /// [`Command::Status`](super::Command::Status)
    pub const STATUS: u8 = 0x06;
    /// [`Command::Discard`](super::Command::Discard)
    pub const DISCARD: u8 = 0x07;
    /// [`Command::Switch`](super::Command::Switch)
    pub const SWITCH: u8 = 0x08;
    /// [`Command::StopNow`](super::Command::StopNow)
    pub const STOP_NOW: u8 = 0x09;
    /// [`Command::Baud`](super::Command::Baud)
    pub const BAUD: u8 = 0x0a;
    /// [`Command::Bye`](super::Command::Bye)
    pub const BYE: u8 = 0x0b;
    /// [`Command::Poll`](super::Command::Poll)
    pub const POLL: u8 = 0x0c;
    /// [`Command::Measures`](super::Command::Measures)
    pub const MEASURES: u8 = 0x0d;
    /// [`Command::Orders`](super::Command::Orders)
    pub const ORDERS: u8 = 0x0e;
    /// [`Command::Store`](super::Command::Store)
    pub const STORE: u8 = 0x0f;
    /// [`Command::Data`](super::Command::Data) for motor 0; the next seven are for the others.
    pub const DATA: u8 = 0x10;
    /// [`Command::Extend`](super::Command::Extend)
    pub const EXTEND: u8 = 0x18;
    /// [`Command::Trim`](super::Command::Trim)
    pub const TRIM: u8 = 0x19;
    /// [`Command::Brake`](super::Command::Brake)
    pub const BRAKE: u8 = 0x1a;
    /// Set in an answer's kind; the rest is the command's.
    pub const ANSWER: u8 = 0x80;
    /// [`Reply::Event`](super::Reply::Event)
    pub const EVENT: u8 = 0xe0;
    /// [`Reply::Missing`](super::Reply::Missing)
    pub const MISSING: u8 = 0xe1;
    /// [`Reply::Refused`](super::Reply::Refused)
    pub const REFUSED: u8 = 0xe2;
}

/// Reads a payload from the front.
#[derive(Debug)]
struct Payload<'a>(&'a [u8]);

impl<'a> Payload<'a> {
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*head)
    }

    fn u8(&mut self) -> Option<u8> {
        self.array().map(|[byte]| byte)
    }

    fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// `value`, if nothing is left over.
    fn end<T>(&self, value: T) -> Option<T> {
        self.0.is_empty().then_some(value)
    }
}

/// What a host asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command<'a> {
    /// Takes the board and begins to count from this frame's sequence number. Answer: [`Info`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | the host's [`VERSION`] |
    /// | 3–6 | a number of the host's choice, new for each session; the answer repeats it |
    Hello {
        /// The host's protocol.
        version: u8,
        /// The session's number.
        nonce: u32,
    },
    /// Sets pins and times. Answer: [`Configured`].
    Configure(Configuration<'a>),
    /// Powers the motors; data are taken from now on. Answer: done. No payload.
    Arm,
    /// Takes the power from motors that rest. Answer: done. No payload.
    Release,
    /// Answer: [`Reply::Clock`]. No payload.
    Clock,
    /// Answer: [`Status`]. No payload.
    Status,
    /// Takes back what was pushed last of an epoch, of all motors. Answer: done.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | epoch |
    Discard {
        /// Which.
        epoch: Epoch,
    },
    /// At a tick, all motors go over to an epoch. Answer: [`Reply::Switched`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | epoch |
    /// | 3–10 | tick |
    /// | 11–15 | how long the plan holds from there on: see [`LeaseField`] |
    /// | 16… | limits: nothing, or three bytes for each configured motor: M (128 to 255), E (0 to 61), L |
    Switch {
        /// Which.
        epoch: Epoch,
        /// When.
        tick: u64,
        /// How long the plan holds from there on; not [`Lease::Off`].
        lease: Lease,
        /// How hard each motor may brake from there on, as [`limit_bytes`] has it; none: as before.
        limits: &'a [u8],
    },
    /// The immediate stop. Answer: [`Reply::Stopped`]. No payload.
    StopNow,
    /// Another rate, from the answer on. Answer: done.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | [`Baud`] |
    Baud {
        /// Which.
        baud: Baud,
    },
    /// Gives the board up; what is queued goes on. Answer: done. No payload.
    Bye,
    /// Asks for an [`Ack`], and shows that the host is alive. No payload.
    Poll,
    /// The board's own measurements. Answer: [`Measures`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | 1: counters restart at zero before the answer; else 0 |
    Measures {
        /// Whether counters restart at zero before the answer.
        reset: bool,
    },
    /// Tells motors directly; not every board takes it. Answer: [`Obeyed`].
    Orders(Orders<'a>),
    /// Has the board keep these without power; `None`: only asks what it keeps. Not every board takes it. Answer:
    /// [`Reply::Stored`].
    Store(Option<Settings>),
    /// Packed items for a motor's queue: whole ones. Acknowledged by an [`Ack`], which may answer several at once.
    ///
    /// | byte | |
    /// |---|---|
    /// | 1 | 0x10 + motor |
    /// | 2 | epoch |
    /// | 3… | packed items, at least one byte |
    Data {
        /// Index of the motor, below [`MAX_MOTORS`].
        motor: u8,
        /// Of all the items.
        epoch: Epoch,
        /// Items as [`packing`](crate::packing) has them.
        packed: &'a [u8],
    },
    /// Puts the end of the lease off, or earlier. Acknowledged like Data; `accepted` says whether it was accepted.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–6 | how long the plan holds: see [`LeaseField`] |
    /// | 7… | limits, as in Switch |
    Extend {
        /// How long the plan holds; not [`Lease::Off`].
        lease: Lease,
        /// As in Switch.
        limits: &'a [u8],
    },
    /// Drops bytes from the end of each motor's queue; the plan that is left holds up to a tick. Answer: [`Reply::Trimmed`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–5 | the new end of the lease: the low 32 bits of the tick |
    /// | 6… | bytes to drop, two for each configured motor |
    Trim {
        /// The new end of the lease.
        until: Tick32,
        /// Two bytes for each configured motor.
        bytes: &'a [u8],
    },
    /// All motors brake as soon as they can. Answer: [`Reply::Braked`]. No payload.
    Brake,
}

/// How long a plan holds, in Switch and Extend.
///
/// | byte | |
/// |---|---|
/// | 0 | 1: up to a tick; 2: to its end, all has been told |
/// | 1–4 | the low 32 bits of that tick, which is less than 2^30 ahead; else 0 |
pub type LeaseField = [u8; 5];

/// The lease field. [`Lease::Off`] makes one that boards refuse.
const fn lease_bytes(lease: Lease) -> LeaseField {
    match lease {
        Lease::Off => [0; 5],
        Lease::Until(Tick32(tick)) => {
            let [a, b, c, d] = tick.to_le_bytes();
            [1, a, b, c, d]
        }
        Lease::Last => [2, 0, 0, 0, 0],
    }
}

/// Whether this is a lease field with limits behind it, of any number of motors.
#[inline(never)]
pub(super) fn is_lease(payload: &[u8]) -> bool {
    let [state, _, _, _, _, limits @ ..] = payload else { return false };
    let mut rest = limits;
    while let [mantissa, exponent, rest_level, after @ ..] = rest {
        if Limit::new(*mantissa, *exponent, *rest_level).is_none() {
            return false;
        }
        rest = after;
    }
    matches!(state, 1 | 2) && rest.is_empty()
}

/// What a lease field says that [is one](is_lease).
#[inline(always)]
pub(super) const fn lease_of([state, tick @ ..]: LeaseField) -> Lease {
    match state {
        1 => Lease::Until(Tick32(u32::from_le_bytes(tick))),
        _ => Lease::Last,
    }
}

/// Limits as Switch and Extend have them.
///
/// ```
/// use pulsetrain_core::braking::Limit;
/// use pulsetrain_core::wire::message::{limit_bytes, limits_of};
/// let limits = [Limit::new(221, 32, 0).unwrap(), Limit::new(128, 40, 3).unwrap()];
/// assert!(limits_of(limits.map(limit_bytes).as_flattened()).eq(limits));
/// ```
#[must_use]
pub const fn limit_bytes(limit: Limit) -> [u8; LIMIT_LEN] {
    [limit.mantissa(), limit.exponent(), limit.rest_level()]
}

/// The limits in the bytes of a Switch or an Extend, one for each motor, or none.
pub fn limits_of(bytes: &[u8]) -> impl Iterator<Item = Limit> {
    bytes
        .as_chunks::<LIMIT_LEN>()
        .0
        .iter()
        .filter_map(|[mantissa, exponent, level]| Limit::new(*mantissa, *exponent, *level))
}

/// Bytes of a [`Limit`].
pub const LIMIT_LEN: usize = 3;

/// Most packed bytes in one frame, to a board that takes the longest bodies; else three fewer than its longest body.
pub const MAX_PACKED: usize = MAX_BODY - 3;

/// Bytes of the payload of a command that always has as many; `None` for other kinds.
pub(super) const fn len_of(kind: u8) -> Option<u8> {
    Some(match kind {
        kind::HELLO => 5,
        kind::DISCARD | kind::BAUD | kind::MEASURES => 1,
        kind::ARM | kind::RELEASE | kind::CLOCK | kind::STATUS | kind::STOP_NOW | kind::BYE | kind::POLL => 0,
        kind::BRAKE => 0,
        _ => return None,
    })
}

/// The first bytes of `bytes`, and zeros if it has fewer.
fn padded<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut all = [0; N];
    for (place, byte) in all.iter_mut().zip(bytes) {
        *place = *byte;
    }
    all
}

impl<'a> Command<'a> {
    /// Byte 1 of its body.
    #[must_use]
    pub const fn kind(&self) -> u8 {
        match self {
            Command::Hello { .. } => kind::HELLO,
            Command::Configure(_) => kind::CONFIGURE,
            Command::Arm => kind::ARM,
            Command::Release => kind::RELEASE,
            Command::Clock => kind::CLOCK,
            Command::Status => kind::STATUS,
            Command::Discard { .. } => kind::DISCARD,
            Command::Switch { .. } => kind::SWITCH,
            Command::StopNow => kind::STOP_NOW,
            Command::Baud { .. } => kind::BAUD,
            Command::Bye => kind::BYE,
            Command::Poll => kind::POLL,
            Command::Measures { .. } => kind::MEASURES,
            Command::Orders(_) => kind::ORDERS,
            Command::Store(_) => kind::STORE,
            Command::Data { motor, .. } => kind::DATA | (*motor & 7),
            Command::Extend { .. } => kind::EXTEND,
            Command::Trim { .. } => kind::TRIM,
            Command::Brake => kind::BRAKE,
        }
    }

    /// Reads what comes after sequence number and kind.
    ///
    /// # Errors
    /// [`Reason::UnknownKind`] or [`Reason::Malformed`].
    pub fn decode(kind: u8, payload: &'a [u8]) -> Result<Command<'a>, Reason> {
        if let kind::DATA..kind::EXTEND = kind {
            return match payload {
                [epoch, packed @ ..] if !packed.is_empty() => {
                    Ok(Command::Data { motor: kind & 7, epoch: Epoch(*epoch), packed })
                }
                _ => Err(Reason::Malformed),
            };
        }
        if kind == kind::CONFIGURE {
            return Configuration::decode(payload).map(Command::Configure).ok_or(Reason::Malformed);
        }
        if kind == kind::ORDERS {
            return Orders::decode(payload).map(Command::Orders).ok_or(Reason::Malformed);
        }
        if kind == kind::STORE {
            if payload.is_empty() {
                return Ok(Command::Store(None));
            }
            return Settings::decode(payload).map(|settings| Command::Store(Some(settings))).ok_or(Reason::Malformed);
        }
        if let kind::SWITCH | kind::EXTEND | kind::TRIM = kind {
            return Command::decode_leased(kind, payload).ok_or(Reason::Malformed);
        }
        if payload.len() != usize::from(len_of(kind).ok_or(Reason::UnknownKind)?) {
            return Err(Reason::Malformed);
        }
        let (first, number) = payload.split_first().map_or((0, &[][..]), |(first, number)| (*first, number));
        Ok(match kind {
            kind::HELLO => Command::Hello { version: first, nonce: u32::from_le_bytes(padded(number)) },
            kind::ARM => Command::Arm,
            kind::RELEASE => Command::Release,
            kind::CLOCK => Command::Clock,
            kind::STATUS => Command::Status,
            kind::DISCARD => Command::Discard { epoch: Epoch(first) },
            kind::STOP_NOW => Command::StopNow,
            kind::BAUD => Command::Baud { baud: Baud::from_code(first).ok_or(Reason::Malformed)? },
            kind::BYE => Command::Bye,
            kind::POLL => Command::Poll,
            kind::BRAKE => Command::Brake,
            _ if first > 1 => return Err(Reason::Malformed),
            _ => Command::Measures { reset: first == 1 },
        })
    }

    /// Switch, Extend or Trim.
    fn decode_leased(kind: u8, payload: &'a [u8]) -> Option<Command<'a>> {
        if kind == kind::TRIM {
            let (until, bytes) = payload.split_first_chunk()?;
            let whole = bytes.len() & 1 == 0 && bytes.len() <= 2 * MAX_MOTORS;
            return whole.then_some(Command::Trim { until: Tick32(u32::from_le_bytes(*until)), bytes });
        }
        let (head, rest) = if kind == kind::SWITCH { payload.split_at_checked(9)? } else { (&[][..], payload) };
        let (field, limits) = rest.split_first_chunk()?;
        if !is_lease(rest) || limits.len() > LIMIT_LEN * MAX_MOTORS {
            return None;
        }
        let lease = lease_of(*field);
        Some(match head {
            [epoch, tick @ ..] => {
                Command::Switch { epoch: Epoch(*epoch), tick: u64::from_le_bytes(padded(tick)), lease, limits }
            }
            [] => Command::Extend { lease, limits },
        })
    }

    /// Makes a frame of it in the front of `out` and gives its length; `None` if it does not fit.
    pub fn encode(&self, seq: u8, tag: Tag, out: &mut [u8]) -> Option<usize> {
        let mut frame = Encoder::new(out);
        frame.u8(seq);
        frame.u8(self.kind());
        match *self {
            Command::Hello { version, nonce } => {
                frame.u8(version);
                frame.u32(nonce);
            }
            Command::Configure(configuration) => configuration.encode(&mut frame),
            Command::Discard { epoch } => frame.u8(epoch.0),
            Command::Switch { epoch, tick, lease, limits } => {
                frame.u8(epoch.0);
                frame.u64(tick);
                frame.bytes(&lease_bytes(lease));
                frame.bytes(limits);
            }
            Command::Extend { lease, limits } => {
                frame.bytes(&lease_bytes(lease));
                frame.bytes(limits);
            }
            Command::Trim { until, bytes } => {
                frame.u32(until.0);
                frame.bytes(bytes);
            }
            Command::Baud { baud } => frame.u8(baud as u8),
            Command::Measures { reset } => frame.u8(u8::from(reset)),
            Command::Orders(orders) => orders.encode(&mut frame),
            Command::Store(settings) => {
                if let Some(settings) = settings {
                    frame.bytes(&settings.to_bytes());
                }
            }
            Command::Data { epoch, packed, .. } => {
                frame.u8(epoch.0);
                frame.bytes(packed);
            }
            Command::Arm
            | Command::Release
            | Command::Clock
            | Command::Status
            | Command::StopNow
            | Command::Bye
            | Command::Poll
            | Command::Brake => {}
        }
        frame.finish(tag)
    }
}

/// A pin that is not there.
pub const NO_PIN: u8 = 0xff;

/// Pins and times of all motors.
///
/// | byte | |
/// |---|---|
/// | 2–3 | pulse: STEP is active so long, ticks; on a Pico up to 5 µs longer if an immediate stop comes in it |
/// | 4–5 | set-up: DIR is right so long before the step, ticks |
/// | 6–7 | hold: DIR stays so long after the step's end, ticks |
/// | 8 | enable pin of all drivers; 255: none |
/// | 9 | bit 0: enable is active high; bit 1: release the motors after `idle`; others 0 |
/// | 10–11 | idle: the motors are released after so long a rest, ms; also when they were stopped, or their host was lost |
/// | 12–13 | silence: the host is lost after so long without a valid frame, ms; 0: 2000 |
/// | 14 | motors, at most 8 |
/// | 15… | eight bytes each: see [`MotorSetup`] |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Configuration<'a> {
    /// STEP is active so long, ticks.
    pub pulse_ticks: u16,
    /// DIR is right so long before the step, ticks.
    pub setup_ticks: u16,
    /// DIR stays so long after the end of the pulse, ticks.
    pub hold_ticks: u16,
    /// Enables all drivers; [`NO_PIN`] for none.
    pub enable_pin: u8,
    /// Enable is active high.
    pub enable_high: bool,
    /// The motors are released after so long a rest, ms; `None`: they hold.
    pub idle_ms: Option<u16>,
    /// The host is lost after so long without a valid frame, ms; 0: 2000.
    pub silence_ms: u16,
    /// [`MotorSetup`]s, packed.
    motors: &'a [u8],
}

/// One motor's part of a [`Configuration`].
///
/// | byte | |
/// |---|---|
/// | 0 | pin of STEP; of coils, that of IN1, which the pins of IN2 to IN4 follow (on a Pico as on its header: 26 after 22) |
/// | 1 | pin of DIR; motors may share it. 240, 241, 242: four coils, switched one at a time, two at a time, in half steps |
/// | 2 | bit 0: forward is DIR high; bit 1: STEP is active low; bits 2 to 7: how much of the queues' bytes the motor gets, 64ths |
/// | 3 | packing gain, signed |
/// | 4–7 | pull-in: the shortest interval that the motor can start and stop at, ticks |
///
/// With 0 for all motors each gets an equal part of the queues' bytes. Else none may be 0, and together they are 64 at most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorSetup {
    /// Pin of STEP.
    pub step_pin: u8,
    /// Pin of DIR; motors may share it. Or one of [`COILS`]: no board has so many pins.
    pub dir_pin: u8,
    /// Forward is DIR high.
    pub forward_high: bool,
    /// STEP is active low.
    pub step_low: bool,
    /// How much of the queues' bytes the motor gets, in parts of [`QUEUE_PARTS`], less than all; 0: as much as the others.
    pub queue_parts: u8,
    /// Of [`Packing`](crate::packing::Packing).
    pub gain: i8,
    /// The shortest interval that the motor can start and stop at, ticks.
    pub pull_in_ticks: u32,
}

/// What stands in DIR's place for four coils: wave, full and half step. Boards without coils refuse it as a pin.
pub const COILS: [u8; 3] = [240, 241, 242];

/// Bytes of a [`MotorSetup`].
pub const MOTOR_SETUP_LEN: usize = 8;

/// Every board takes bodies of so many bytes: a configuration of four motors. How many more it takes, [`Info`] says.
pub const MIN_BODY: usize = 2 + 13 + 4 * MOTOR_SETUP_LEN;

/// What [`MotorSetup::queue_parts`] are parts of.
pub const QUEUE_PARTS: u8 = 64;

/// Pins of coils, IN1 to IN4, the first being `pin`: one after the other as a Pico's header has them, which goes on with
/// GPIO 26 after 22.
///
/// ```
/// use pulsetrain_core::wire::message::coil_pins;
/// assert_eq!(coil_pins(2), [2, 3, 4, 5]);
/// assert_eq!(coil_pins(21), [21, 22, 26, 27]);
/// ```
#[must_use]
pub const fn coil_pins(pin: u8) -> [u8; 4] {
    const fn next(pin: u8) -> u8 {
        if pin == 22 { 26 } else { pin.wrapping_add(1) }
    }
    let (second, third) = (next(pin), next(next(pin)));
    [pin, second, third, next(third)]
}

impl MotorSetup {
    /// Four coils, from IN1 on `pin` on as [`coil_pins`] says; not on every board.
    #[must_use]
    pub fn coils_on(pin: u8, sequence: Sequence) -> MotorSetup {
        let [wave, full, half] = COILS;
        let dir_pin = match sequence {
            Sequence::Wave => wave,
            Sequence::Full => full,
            Sequence::Half => half,
        };
        MotorSetup { step_pin: pin, dir_pin, ..MotorSetup::default() }
    }

    /// How its coils are switched; `None` of a driver.
    #[must_use]
    pub const fn coils(&self) -> Option<Sequence> {
        match self.dir_pin {
            240 => Some(Sequence::Wave),
            241 => Some(Sequence::Full),
            242 => Some(Sequence::Half),
            _ => None,
        }
    }

    /// Its bytes.
    #[must_use]
    pub const fn to_bytes(&self) -> [u8; MOTOR_SETUP_LEN] {
        let [a, b, c, d] = self.pull_in_ticks.to_le_bytes();
        let flags = self.forward_high as u8 | (self.step_low as u8) << 1 | self.queue_parts << 2;
        [self.step_pin, self.dir_pin, flags, self.gain.cast_unsigned(), a, b, c, d]
    }

    const fn from_bytes(bytes: [u8; MOTOR_SETUP_LEN]) -> MotorSetup {
        let [step_pin, dir_pin, flags, gain, a, b, c, d] = bytes;
        MotorSetup {
            step_pin,
            dir_pin,
            forward_high: flags & 1 != 0,
            step_low: flags & 2 != 0,
            queue_parts: flags >> 2,
            gain: gain.cast_signed(),
            pull_in_ticks: u32::from_le_bytes([a, b, c, d]),
        }
    }
}

impl<'a> Configuration<'a> {
    /// For the motors in `motors`, [`MotorSetup::to_bytes`] one after the other; times 0, no enable pin.
    ///
    /// `None` if these are not whole ones, or more than [`MAX_MOTORS`].
    #[must_use]
    pub fn new(motors: &'a [u8]) -> Option<Configuration<'a>> {
        let whole = motors.len() & (MOTOR_SETUP_LEN - 1) == 0 && motors.len() <= MAX_MOTORS * MOTOR_SETUP_LEN;
        whole.then_some(Configuration {
            pulse_ticks: 0,
            setup_ticks: 0,
            hold_ticks: 0,
            enable_pin: NO_PIN,
            enable_high: false,
            idle_ms: None,
            silence_ms: 0,
            motors,
        })
    }

    /// The motors, in order.
    pub fn motors(&self) -> impl ExactSizeIterator<Item = MotorSetup> + 'a {
        self.motors.as_chunks::<MOTOR_SETUP_LEN>().0.iter().map(|bytes| MotorSetup::from_bytes(*bytes))
    }

    /// From the payload of Configure; `None` if it is none.
    #[must_use]
    pub fn decode(payload: &'a [u8]) -> Option<Configuration<'a>> {
        let (head, motors) = payload.split_first_chunk::<13>()?;
        if !is_configuration(head, motors) {
            return None;
        }
        let [p0, p1, s0, s1, h0, h1, enable_pin, flags, i0, i1, q0, q1, _] = *head;
        let mut configuration = Configuration::new(motors)?;
        configuration.pulse_ticks = u16::from_le_bytes([p0, p1]);
        configuration.setup_ticks = u16::from_le_bytes([s0, s1]);
        configuration.hold_ticks = u16::from_le_bytes([h0, h1]);
        configuration.enable_pin = enable_pin;
        configuration.enable_high = flags & 1 != 0;
        configuration.idle_ms = (flags & 2 != 0).then_some(u16::from_le_bytes([i0, i1]));
        configuration.silence_ms = u16::from_le_bytes([q0, q1]);
        Some(configuration)
    }

    /// The payload of Configure: what comes before the motors, and these.
    #[must_use]
    pub fn to_bytes(&self) -> ([u8; 13], &'a [u8]) {
        let [p0, p1] = self.pulse_ticks.to_le_bytes();
        let [s0, s1] = self.setup_ticks.to_le_bytes();
        let [h0, h1] = self.hold_ticks.to_le_bytes();
        let [i0, i1] = self.idle_ms.unwrap_or(0).to_le_bytes();
        let [q0, q1] = self.silence_ms.to_le_bytes();
        let flags = u8::from(self.enable_high) | u8::from(self.idle_ms.is_some()) << 1;
        // `new` and `decode` let no more than MAX_MOTORS pass.
        let motors = u8::try_from(self.motors().len()).unwrap_or(u8::MAX);
        ([p0, p1, s0, s1, h0, h1, self.enable_pin, flags, i0, i1, q0, q1, motors], self.motors)
    }

    fn encode(&self, frame: &mut Encoder<'_>) {
        let (head, motors) = self.to_bytes();
        frame.bytes(&head);
        frame.bytes(motors);
    }
}

/// Whether flags, parts of the queues and length of a configuration are right.
// A function of its own, so that the registers it needs are not kept while fields are written.
#[inline(never)]
fn is_configuration(head: &[u8; 13], motors: &[u8]) -> bool {
    let [_, _, _, _, _, _, _, flags, _, _, _, _, count] = *head;
    let (mut parts, mut without) = (0u8, false);
    for [_, _, flags, ..] in motors.as_chunks::<MOTOR_SETUP_LEN>().0 {
        parts = parts.saturating_add(flags >> 2);
        without |= flags >> 2 == 0;
    }
    flags & !3 == 0 && (parts == 0 || !without && parts <= QUEUE_PARTS) && motors.len() == usize::from(count) << 3
}

/// What a board is: the answer to Hello, with tag 0.
///
/// | byte | |
/// |---|---|
/// | 2 | protocol: [`VERSION`] |
/// | 3–6 | the host's number from Hello |
/// | 7 | the session's [`Tag`]: of all frames that follow, both ways |
/// | 8 | board: 1 the Uno, 2 the Pico; 0 a model |
/// | 9–11 | firmware's version |
/// | 12–15 | ticks a second |
/// | 16 | F |
/// | 17 | motors at most |
/// | 18–19 | bytes of all queues together |
/// | 20–21 | bytes that may be on their way to the board |
/// | 22 | rates that the line can do: bit by code of [`Baud`] |
/// | 23 | [`Cause`] of the last stop |
/// | 24 | [`Cause`] of the last reset |
/// | 25 | bytes of the longest body that the board takes, 47 to 80 |
/// | 26 | of an Uno, its image: 1 plans, 2 text, 3 verbs; other boards leave it out |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Info {
    /// The host's number from Hello; the service's.
    pub nonce: u32,
    /// Of all frames that follow; the service's.
    pub tag: Tag,
    /// 1 the Uno, 2 the Pico; 0 a model.
    pub board: u8,
    /// Major, minor, patch.
    pub firmware: [u8; 3],
    /// Ticks a second.
    pub tick_hz: u32,
    /// F.
    pub fraction_bits: u8,
    /// Motors at most.
    pub max_motors: u8,
    /// Bytes of all queues together.
    pub pool: u16,
    /// Bytes that may be on their way to the board.
    pub window: u16,
    /// Rates that [`can_baud`](super::Machine::can_baud) says yes to, bit by code.
    pub bauds: u8,
    /// Why motors stopped last.
    pub last_stop: Cause,
    /// Why the program began last.
    pub last_reset: Cause,
    /// Bytes of the longest body that the board takes; the service's.
    pub max_body: u8,
    /// Which of its images the board has, an [`image`]; 0 where there is one.
    pub image: u8,
}

/// Images of an Uno, as [`Info`] has them.
pub mod image {
    /// Plans, streamed from a host.
    pub const PLANS: u8 = 1;
    /// `StepperWinch`'s text.
    pub const WINCH: u8 = 2;
    /// Motors that obey MOVE, SPEED and DIRECTION.
    pub const VERBS: u8 = 3;
}

impl Info {
    /// Of no board.
    pub const NOBODY: Info = Info {
        nonce: 0,
        tag: Tag::NONE,
        board: 0,
        firmware: [0; 3],
        tick_hz: 1,
        fraction_bits: 0,
        max_motors: 0,
        pool: 0,
        window: 0,
        bauds: 0,
        last_stop: Cause::None,
        last_reset: Cause::None,
        max_body: 0,
        image: 0,
    };

    /// Writes it.
    // Most of it is constant on a board.
    #[inline(always)]
    pub fn encode(&self, frame: &mut Encoder<'_>) {
        frame.u8(VERSION);
        frame.u32(self.nonce);
        frame.u8(self.tag.0);
        frame.u8(self.board);
        let [major, minor, patch] = self.firmware;
        frame.u8(major);
        frame.u8(minor);
        frame.u8(patch);
        frame.u32(self.tick_hz);
        frame.u8(self.fraction_bits);
        frame.u8(self.max_motors);
        frame.u16(self.pool);
        frame.u16(self.window);
        frame.u8(self.bauds);
        frame.u8(self.last_stop as u8);
        frame.u8(self.last_reset as u8);
        frame.u8(self.max_body);
        if self.image != 0 {
            frame.u8(self.image);
        }
    }

    fn decode(reader: &mut Payload<'_>) -> Option<Info> {
        Some(Info {
            nonce: reader.u32()?,
            tag: Tag(reader.u8()?),
            board: reader.u8()?,
            firmware: reader.array()?,
            tick_hz: reader.u32()?,
            fraction_bits: reader.u8()?,
            max_motors: reader.u8()?,
            pool: reader.u16()?,
            window: reader.u16()?,
            bauds: reader.u8()?,
            last_stop: Cause::from_code(reader.u8()?)?,
            last_reset: Cause::from_code(reader.u8()?)?,
            max_body: reader.u8().filter(|len| (MIN_BODY..=MAX_BODY).contains(&usize::from(*len)))?,
            image: reader.u8().unwrap_or(0),
        })
    }
}

/// One number for each motor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PerMotor<T> {
    values: [T; MAX_MOTORS],
    len: u8,
}

impl<T> PerMotor<T> {
    /// The motors', in order.
    #[must_use]
    pub fn as_slice(&self) -> &[T] {
        self.values.get(..usize::from(self.len)).unwrap_or_default()
    }
}

impl<T: Copy + Default> PerMotor<T> {
    fn decode(count: u8, mut one: impl FnMut() -> Option<T>) -> Option<PerMotor<T>> {
        let mut values = [T::default(); MAX_MOTORS];
        for value in values.get_mut(..usize::from(count))? {
            *value = one()?;
        }
        Some(PerMotor { values, len: count })
    }
}

/// The answer to Configure.
///
/// | byte | |
/// |---|---|
/// | 2 | motors |
/// | 3… | bytes of each motor's queue, two each |
pub type Configured = PerMotor<u16>;

/// What was received in order, and what there is room for: the answer to Data and Poll.
///
/// | byte | |
/// |---|---|
/// | 0 | sequence number of the last frame that was taken in order |
/// | 2 | [`flags`] of the board |
/// | 3 | accepted: sequence number of the last Extend, Switch, Trim or Brake that was, else of Hello |
/// | 4 | motors |
/// | 5… | free bytes of each motor's queue, two each |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ack {
    /// See [`flags`].
    pub flags: u8,
    /// Sequence number of the last Extend, Switch, Trim or Brake that was accepted.
    pub accepted: u8,
    /// Free bytes of each motor's queue.
    pub free: PerMotor<u16>,
}

/// Bits of what a board, or a motor, is in.
pub mod flags {
    /// Nothing is left to do on any motor: no step, no end of a pulse.
    pub const IDLE: u8 = 1;
    /// There is a configuration.
    pub const CONFIGURED: u8 = 2;
    /// Data are taken.
    pub const ARMED: u8 = 4;
    /// A motion in the board's flash runs, from power-up until its end or a stop.
    pub const BAKED: u8 = 8;
    /// Of a motor: a step was asked for too late or too soon, and what followed in its epoch was not made.
    pub const STEP_MISSED: u8 = 1;
    /// Of a motor: a DIR edge came later than its set-up before the step. The Uno puts the step off instead.
    pub const SETUP_CUT_SHORT: u8 = 2;
    /// Of a motor: its queue ran dry inside an item, or held what no packer makes.
    pub const BAD_ITEM: u8 = 4;
    /// Of a motor: position or accumulator were not those that the host expected.
    pub const CHECK_FAILED: u8 = 8;
    /// Of a motor: it was stopped at once above its pull-in speed, and may stand elsewhere than it counts. An Uno says it in Stopped alone.
    pub const UNCERTAIN: u8 = 16;
}

/// What is common to all motors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StatusHead {
    /// The clock.
    pub tick: u64,
    /// The first tick at which a switch would be accepted.
    pub horizon: u64,
    /// The epoch being run, or that was run last.
    pub epoch: Epoch,
    /// See [`flags`].
    pub flags: u8,
    /// Sequence number of the last Extend, Switch, Trim or Brake that was accepted.
    pub accepted: u8,
    /// How long the plan holds.
    pub lease: LeaseState,
}

/// What has become of a lease, as Status has it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LeaseState {
    /// There is none.
    #[default]
    Off,
    /// The plan holds up to this tick.
    Until(Tick32),
    /// The plan holds to its end.
    Last,
    /// It is over since this tick.
    Lapsed(Tick32),
}

impl LeaseState {
    /// As [`Machine::lease`](super::Machine::lease) gives it.
    #[must_use]
    pub const fn to_parts(self) -> (u8, u32) {
        match self {
            LeaseState::Off => (0, 0),
            LeaseState::Until(Tick32(tick)) => (1, tick),
            LeaseState::Last => (2, 0),
            LeaseState::Lapsed(Tick32(tick)) => (3, tick),
        }
    }

    const fn from_parts(state: u8, tick: u32) -> Option<LeaseState> {
        match state {
            0 => Some(LeaseState::Off),
            1 => Some(LeaseState::Until(Tick32(tick))),
            2 => Some(LeaseState::Last),
            3 => Some(LeaseState::Lapsed(Tick32(tick))),
            _ => None,
        }
    }
}

/// What is each motor's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorStatus {
    /// Steps forward minus steps backward, pulses begun, modulo 2^32.
    pub position: i32,
    /// Free bytes of the queue.
    pub free: u16,
    /// Since it was armed: see [`flags`].
    pub faults: u8,
}

/// The answer to Status.
///
/// | byte | |
/// |---|---|
/// | 2–9 | the clock |
/// | 10–13 | horizon: the low 32 bits of the tick |
/// | 14 | epoch |
/// | 15 | bits 0–3: [`flags`] of the board; bits 4–5: lease: 0 off, 1 until, 2 last, 3 lapsed |
/// | 16 | accepted: sequence number of the last Extend, Switch, Trim or Brake that was, else of Hello |
/// | 17–20 | until, or lapsed since: the low 32 bits of the tick; else 0 |
/// | 21… | seven bytes for each motor: position (4), free bytes (2), [`flags`] of the motor |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Status {
    /// Common to all motors.
    pub head: StatusHead,
    /// Each motor's.
    pub motors: PerMotor<MotorStatus>,
}

impl Status {
    /// Whether nothing is left to do on any motor.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        self.head.flags & flags::IDLE != 0
    }

    fn decode(reader: &mut Payload<'_>) -> Option<Status> {
        let tick = reader.u64()?;
        // Not before the clock was read, or but a little.
        let ahead = reader.u32()?.wrapping_sub(Tick32::of(tick).0).cast_signed();
        let horizon = tick.saturating_add_signed(ahead.into());
        let (epoch, marks, accepted) = (Epoch(reader.u8()?), reader.u8()?, reader.u8()?);
        let lease = LeaseState::from_parts(marks >> 4, reader.u32()?)?;
        let head = StatusHead { tick, horizon, epoch, flags: marks & 15, accepted, lease };
        let count = u8::try_from(reader.0.as_chunks::<7>().0.len()).ok()?;
        let motors = PerMotor::decode(count, || {
            Some(MotorStatus { position: reader.u32()?.cast_signed(), free: reader.u16()?, faults: reader.u8()? })
        })?;
        Some(Status { head, motors })
    }
}

/// What a board measured of itself since its counters were last set to zero: the answer to Measures. Counters stay at their end.
///
/// | byte | |
/// |---|---|
/// | 2–3 | compares that were missed and made late |
/// | 4–5 | the latest of them, ticks |
/// | 6–7 | times that the step interrupt found nothing though steps were left |
/// | 8–9 | least that rings were filled ahead while there was more to come, ticks; 65535 if nothing was |
/// | 10–11 | longest round of the main loop, ticks |
/// | 12–13 | most bytes that waited to be read |
/// | 14–15 | bytes from the line that were lost, or came damaged |
/// | 16–17 | frames whose CRC was wrong |
/// | 18–19 | fewest bytes of stack that were never used |
/// | 20–23 | rounds of the main loop |
/// | 24–31 | ticks in which the main loop had nothing to do |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measures {
    /// Compares that were missed and made late.
    pub late: u16,
    /// The latest of them, ticks.
    pub latest_ticks: u16,
    /// Times that the step interrupt found nothing though steps were left.
    pub starved: u16,
    /// Least that rings were filled ahead while there was more to come, ticks; `u16::MAX` if nothing was.
    pub least_ahead_ticks: u16,
    /// Longest round of the main loop, ticks.
    pub longest_round_ticks: u16,
    /// Most bytes that waited to be read.
    pub most_unread: u16,
    /// Bytes from the line that were lost, or came damaged.
    pub lost_bytes: u16,
    /// Frames whose CRC was wrong; the service's.
    pub damaged_frames: u16,
    /// Fewest bytes of stack that were never used.
    pub stack_left: u16,
    /// Rounds of the main loop.
    pub rounds: u32,
    /// Ticks in which the main loop had nothing to do.
    pub idle_ticks: u64,
}

impl Measures {
    /// Writes it.
    #[inline(always)]
    pub fn encode(&self, frame: &mut Encoder<'_>) {
        frame.u16(self.late);
        frame.u16(self.latest_ticks);
        frame.u16(self.starved);
        frame.u16(self.least_ahead_ticks);
        frame.u16(self.longest_round_ticks);
        frame.u16(self.most_unread);
        frame.u16(self.lost_bytes);
        frame.u16(self.damaged_frames);
        frame.u16(self.stack_left);
        frame.u32(self.rounds);
        frame.u64(self.idle_ticks);
    }

    fn decode(reader: &mut Payload<'_>) -> Option<Measures> {
        Some(Measures {
            late: reader.u16()?,
            latest_ticks: reader.u16()?,
            starved: reader.u16()?,
            least_ahead_ticks: reader.u16()?,
            longest_round_ticks: reader.u16()?,
            most_unread: reader.u16()?,
            lost_bytes: reader.u16()?,
            damaged_frames: reader.u16()?,
            stack_left: reader.u16()?,
            rounds: reader.u32()?,
            idle_ticks: reader.u64()?,
        })
    }
}

/// What a board says unasked. Its sequence number is a count of its own: events that were lost leave a gap.
///
/// | byte | |
/// |---|---|
/// | 0 | events so far, wrapping |
/// | 2 | [`Cause`] |
/// | 3 | motor; 255: all |
/// | 4–11 | when |
/// | 12–15 | a number that explains it, as [`Cause`] says |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event {
    /// What happened.
    pub cause: Cause,
    /// Whom it concerns; [`ALL_MOTORS`] for all.
    pub motor: u8,
    /// When.
    pub tick: u64,
    /// As [`Cause`] says.
    pub detail: u32,
}

/// Not one motor's.
pub const ALL_MOTORS: u8 = 0xff;

impl Event {
    /// Writes it.
    pub fn encode(&self, frame: &mut Encoder<'_>) {
        frame.u8(self.cause as u8);
        frame.u8(self.motor);
        frame.u64(self.tick);
        frame.u32(self.detail);
    }

    fn decode(reader: &mut Payload<'_>) -> Option<Event> {
        Some(Event {
            cause: Cause::from_code(reader.u8()?)?,
            motor: reader.u8()?,
            tick: reader.u64()?,
            detail: reader.u32()?,
        })
    }
}

/// What a board says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// To Hello.
    Info(Info),
    /// To Configure.
    Configured(Configured),
    /// To Clock: the tick at which the answer was written.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–9 | tick |
    Clock {
        /// Then.
        tick: u64,
    },
    /// To Status.
    Status(Status),
    /// To Switch.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | 0 accepted, 1 late, 2 early, 3 full |
    /// | 3–10 | late: horizon; early: first tick that is too far; else 0 |
    Switched(Switched),
    /// To Trim.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | 0 accepted, 1 late, 2 so many bytes do not wait, 3 no lease, or it lapsed |
    /// | 3–10 | 1: horizon; 2: the motor; else 0 |
    Trimmed(Trimmed),
    /// To Brake.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–9 | all motors brake from this tick on, or did already; 2^64 − 1 if there is no lease |
    Braked {
        /// Then.
        tick: Option<u64>,
    },
    /// To StopNow.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–9 | no step was begun after this tick |
    /// | 10 | bit by motor: position uncertain |
    /// | 11 | motors |
    /// | 12… | positions, four bytes each |
    Stopped {
        /// Tick and uncertainty.
        stopped: Stopped,
        /// Of each motor, modulo 2^32.
        positions: PerMotor<i32>,
    },
    /// To Data and Poll.
    Ack(Ack),
    /// To Measures.
    Measures(Measures),
    /// To Orders.
    Obeyed(Obeyed),
    /// To Store: what the board keeps.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | bit 0: the board keeps what follows; else nothing was stored, or it was damaged. Bit 1: it has found something damaged |
    /// | 3–16 | as the bytes 2 to 15 of `Settings`; else 0 |
    Stored(Stored),
    /// To Arm, Release, Discard, Baud, Bye: done. No payload.
    Done {
        /// The command's kind.
        kind: u8,
    },
    /// To any command: not done.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | the command's kind |
    /// | 3 | [`Reason`] |
    /// | 4–5 | a number that explains it |
    Refused {
        /// The command's kind.
        kind: u8,
        /// Why.
        reason: Reason,
        /// As [`Reason`] says.
        detail: u16,
    },
    /// A frame came that is not the next one: the host is to go back to the one after byte 0.
    ///
    /// | byte | |
    /// |---|---|
    /// | 0 | sequence number of the last frame that was taken in order |
    /// | 2 | 0: a frame is missing; 1: nobody has taken the board; 2: no room for the next frame |
    /// | 3 | accepted: sequence number of the last Extend, Switch, Trim or Brake that was, else of Hello |
    Missing {
        /// Byte 2.
        why: Missing,
        /// Byte 3.
        accepted: u8,
    },
    /// Unasked.
    Event(Event),
}

impl Reply {
    /// Reads a body that came from a board; `None` if no board of this version writes it so.
    ///
    /// Gives the sequence number with it.
    #[must_use]
    pub fn decode(body: &[u8]) -> Option<(u8, Reply)> {
        let mut reader = Payload(body);
        let (seq, code) = (reader.u8()?, reader.u8()?);
        let reply = match code {
            kind::EVENT => Reply::Event(Event::decode(&mut reader)?),
            kind::MISSING => Reply::Missing { why: Missing::from_code(reader.u8()?)?, accepted: reader.u8()? },
            kind::REFUSED => {
                let (kind, reason) = (reader.u8()?, Reason::from_code(reader.u8()?)?);
                Reply::Refused { kind, reason, detail: reader.u16()? }
            }
            _ if code & kind::ANSWER == 0 => return None,
            _ => Reply::answer(code & !kind::ANSWER, &mut reader)?,
        };
        reader.end((seq, reply))
    }

    fn answer(kind: u8, reader: &mut Payload<'_>) -> Option<Reply> {
        Some(match kind {
            // Another version may go on otherwise: `version_of` reads that byte.
            kind::HELLO => {
                reader.u8().filter(|version| *version == VERSION)?;
                Reply::Info(Info::decode(reader)?)
            }
            kind::CONFIGURE => {
                let count = reader.u8()?;
                Reply::Configured(PerMotor::decode(count, || reader.u16())?)
            }
            kind::CLOCK => Reply::Clock { tick: reader.u64()? },
            kind::STATUS => Reply::Status(Status::decode(reader)?),
            kind::SWITCH => {
                let (code, tick) = (reader.u8()?, reader.u64()?);
                Reply::Switched(match code {
                    0 => Switched::Accepted,
                    1 => Switched::Late { horizon: tick },
                    2 => Switched::Early { limit: tick },
                    3 => Switched::Full,
                    _ => return None,
                })
            }
            kind::TRIM => {
                let (code, tick) = (reader.u8()?, reader.u64()?);
                Reply::Trimmed(match code {
                    0 => Trimmed::Accepted,
                    1 => Trimmed::Late { horizon: tick },
                    2 => Trimmed::TooMany { motor: u8::try_from(tick).ok()? },
                    3 => Trimmed::NoLease,
                    _ => return None,
                })
            }
            kind::BRAKE => Reply::Braked { tick: Some(reader.u64()?).filter(|tick| *tick != NO_LEASE) },
            kind::STOP_NOW => {
                let stopped = Stopped { tick: reader.u64()?, uncertain: reader.u8()? };
                let count = reader.u8()?;
                let positions = PerMotor::decode(count, || reader.u32().map(u32::cast_signed))?;
                Reply::Stopped { stopped, positions }
            }
            kind::POLL => {
                let (flags, accepted, count) = (reader.u8()?, reader.u8()?, reader.u8()?);
                Reply::Ack(Ack { flags, accepted, free: PerMotor::decode(count, || reader.u16())? })
            }
            kind::MEASURES => Reply::Measures(Measures::decode(reader)?),
            kind::ORDERS => Reply::Obeyed(Obeyed::decode(core::mem::take(&mut reader.0))?),
            kind::STORE => {
                let marks = reader.u8()?;
                let settings = Settings::decode(&reader.array::<SETTINGS_LEN>()?)?;
                if marks > 3 {
                    return None;
                }
                Reply::Stored(Stored { settings: (marks & 1 != 0).then_some(settings), is_damaged: marks & 2 != 0 })
            }
            kind::ARM | kind::RELEASE | kind::DISCARD | kind::BAUD | kind::BYE => Reply::Done { kind },
            _ => return None,
        })
    }
}

/// The protocol that a board speaks, from the body of its answer to Hello, whatever its version.
#[must_use]
pub fn version_of(body: &[u8]) -> Option<u8> {
    match body {
        [_, kind, version, ..] if *kind == kind::HELLO | kind::ANSWER => Some(*version),
        _ => None,
    }
}
