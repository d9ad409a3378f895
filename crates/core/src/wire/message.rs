//! Commands, answers and events: the bodies of frames.
//!
//! Every body begins with the sequence number and the kind. A table at each type has the bytes that follow. All integers are
//! little-endian.
//!
//! Why a board refuses, and why motors stopped, is in [`outcome`](super::outcome).
//!
//! The board has little RAM, so it writes its answers into the frame field by field ([`Info::encode`] and others here; Status,
//! Switched and Stopped in [`service`](super::service)). The host reads them into structs ([`Reply::decode`]). With commands it is
//! the host that writes ([`Command::encode`]) and the board that reads.

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

/// The kind of a command or a reply: byte 1 of its body.
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
    /// The bit that makes a command's kind the kind of its answer.
    pub const ANSWER: u8 = 0x80;
    /// [`Reply::Event`](super::Reply::Event)
    pub const EVENT: u8 = 0xe0;
    /// [`Reply::Missing`](super::Reply::Missing)
    pub const MISSING: u8 = 0xe1;
    /// [`Reply::Refused`](super::Reply::Refused)
    pub const REFUSED: u8 = 0xe2;
}

/// Reads the fields of a payload, first to last.
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

/// What a host asks the board to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Command<'a> {
    /// Takes the board for a new session. Sequence numbers count on from this frame's. Answer: [`Info`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | the host's [`VERSION`] |
    /// | 3–6 | a number of the host's choice, new for each session; the answer repeats it |
    Hello {
        /// The version of the host's protocol.
        version: u8,
        /// The host's number for this session. A repeated Hello has the same one.
        nonce: u32,
    },
    /// Sets pins and times. Answer: [`Configured`].
    Configure(Configuration<'a>),
    /// Powers the motors. From now on the board takes Data. Answer: done. No payload.
    Arm,
    /// Switches off the motors, which must be at rest. Answer: done. No payload.
    Release,
    /// Asks for the board's clock. Answer: [`Reply::Clock`]. No payload.
    Clock,
    /// Asks where motors, queues and lease are. Answer: [`Status`]. No payload.
    Status,
    /// Removes the items of an epoch from the ends of all queues. Answer: done.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | epoch |
    Discard {
        /// The epoch whose items are removed.
        epoch: Epoch,
    },
    /// At a tick, all motors go over to an epoch. Answer: [`Reply::Switched`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | epoch |
    /// | 3–10 | tick |
    /// | 11–15 | how long the new plan is valid: see [`LeaseField`] |
    /// | 16… | braking limits: nothing, or three bytes for each configured motor: M (128 to 255), E (0 to 61), L |
    Switch {
        /// The epoch that begins.
        epoch: Epoch,
        /// The tick at which it begins.
        tick: u64,
        /// How long the new plan is valid; not [`Lease::Off`].
        lease: Lease,
        /// How hard each motor may brake from then on, in the bytes of [`limit_bytes`]. Empty: the limits do not change.
        limits: &'a [u8],
    },
    /// The immediate stop. Answer: [`Reply::Stopped`]. No payload.
    StopNow,
    /// Changes the rate of the line, as soon as the answer is out. Answer: done.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | [`Baud`] |
    Baud {
        /// The new rate.
        baud: Baud,
    },
    /// Ends the session. What is queued is still made. Answer: done. No payload.
    Bye,
    /// Asks for an [`Ack`], and shows that the host is alive. No payload.
    Poll,
    /// Asks for the board's measurements of itself. Answer: [`Measures`].
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | 1: counters restart at zero before the answer; else 0 |
    Measures {
        /// Whether counters restart at zero before the answer.
        reset: bool,
    },
    /// Verbs for motors, without a plan. Not every board takes them. Answer: [`Obeyed`].
    Orders(Orders<'a>),
    /// Stores settings on the board, which keeps them without power; `None` only asks for them. Not every board takes it. Answer:
    /// [`Reply::Stored`].
    Store(Option<Settings>),
    /// Packed items for a motor's queue, none cut in two. Acknowledged by an [`Ack`]; one Ack may serve for several frames.
    ///
    /// | byte | |
    /// |---|---|
    /// | 1 | 0x10 + motor |
    /// | 2 | epoch |
    /// | 3… | packed items, at least one byte |
    Data {
        /// Index of the motor, below [`MAX_MOTORS`].
        motor: u8,
        /// The epoch of all these items.
        epoch: Epoch,
        /// The items, in the bytes of [`packing`](crate::packing).
        packed: &'a [u8],
    },
    /// Moves the end of the lease, later or earlier. Acknowledged like Data. The Ack's `accepted` says whether the board accepted it.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–6 | how long the plan is valid: see [`LeaseField`] |
    /// | 7… | braking limits, as in Switch |
    Extend {
        /// How long the plan is valid; not [`Lease::Off`].
        lease: Lease,
        /// Braking limits, as in Switch.
        limits: &'a [u8],
    },
    /// Drops bytes from the end of each motor's queue, and ends the lease where the rest of the plan ends. Answer: [`Reply::Trimmed`].
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

/// How long a plan is valid, in Switch and Extend.
///
/// | byte | |
/// |---|---|
/// | 0 | 1: up to a tick; 2: to its end, and the host has sent all of it |
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

/// Whether `payload` is a lease field followed by the limits of any number of motors.
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

/// The lease in a lease field that [`is_lease`] has checked.
#[inline(always)]
pub(super) const fn lease_of([state, tick @ ..]: LeaseField) -> Lease {
    match state {
        1 => Lease::Until(Tick32(u32::from_le_bytes(tick))),
        _ => Lease::Last,
    }
}

/// The bytes of a limit in Switch and Extend.
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

/// The limits in a Switch or an Extend: one for each motor, or none at all.
pub fn limits_of(bytes: &[u8]) -> impl Iterator<Item = Limit> {
    bytes
        .as_chunks::<LIMIT_LEN>()
        .0
        .iter()
        .filter_map(|[mantissa, exponent, level]| Limit::new(*mantissa, *exponent, *level))
}

/// Bytes of a [`Limit`].
pub const LIMIT_LEN: usize = 3;

/// The most packed bytes in one frame, for a board that takes the longest bodies. Other boards take three fewer than the bytes of
/// their longest body: the frame has sequence number, kind and epoch, too.
pub const MAX_PACKED: usize = MAX_BODY - 3;

/// The length of a command's payload, bytes; `None` if it varies, or if the kind is unknown.
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

    /// Writes its frame at the front of `out`, and returns the frame's length; `None` if it does not fit.
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

/// No pin.
pub const NO_PIN: u8 = 0xff;

/// Pins and times of all motors.
///
/// | byte | |
/// |---|---|
/// | 2–3 | pulse: how long STEP is active, ticks; on a Pico up to 5 µs longer if an immediate stop comes during the pulse |
/// | 4–5 | set-up: how long DIR stands before a step, ticks |
/// | 6–7 | hold: how long DIR stays after the end of a pulse, ticks |
/// | 8 | enable pin of all drivers; 255: none |
/// | 9 | bit 0: enable is active high; bit 1: release the motors after `idle`; others 0 |
/// | 10–11 | idle: after this long a rest the motors are released, ms; also after a stop, or when the host was lost |
/// | 12–13 | silence: after this long without a valid frame the host counts as lost, ms; 0: 2000 |
/// | 14 | motors, at most 8 |
/// | 15… | eight bytes each: see [`MotorSetup`] |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Configuration<'a> {
    /// How long STEP is active, ticks.
    pub pulse_ticks: u16,
    /// How long DIR stands before a step, ticks.
    pub setup_ticks: u16,
    /// How long DIR stays after the end of a pulse, ticks.
    pub hold_ticks: u16,
    /// Enables all drivers; [`NO_PIN`] for none.
    pub enable_pin: u8,
    /// Enable is active high.
    pub enable_high: bool,
    /// After this long a rest the motors are released, ms; `None`: they stay powered.
    pub idle_ms: Option<u16>,
    /// After this long without a valid frame the host counts as lost, ms; 0: 2000.
    pub silence_ms: u16,
    /// [`MotorSetup`]s, packed.
    motors: &'a [u8],
}

/// One motor's part of a [`Configuration`].
///
/// | byte | |
/// |---|---|
/// | 0 | pin of STEP; for coils that of IN1, and IN2 to IN4 are the next ones (on a Pico, GPIO 26 comes after 22) |
/// | 1 | pin of DIR; motors may share it. 240, 241, 242: four coils, switched one at a time, two at a time, in half steps |
/// | 2 | bit 0: DIR is high for forward; bit 1: STEP is active low; bits 2 to 7: the motor's share of the queues' bytes, in 64ths |
/// | 3 | packing gain, signed |
/// | 4–7 | pull-in: the shortest interval that the motor can start and stop at, ticks |
///
/// If all shares are 0, each motor gets an equal share. Otherwise none may be 0, and their sum is at most 64.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorSetup {
    /// Pin of STEP.
    pub step_pin: u8,
    /// Pin of DIR; motors may share it. Or one of [`COILS`]: no board has so many pins.
    pub dir_pin: u8,
    /// DIR is high for forward.
    pub forward_high: bool,
    /// STEP is active low.
    pub step_low: bool,
    /// The motor's share of the queues' bytes, in parts of [`QUEUE_PARTS`], below that; 0: an equal share.
    pub queue_parts: u8,
    /// The gain of its [`Packing`](crate::packing::Packing).
    pub gain: i8,
    /// The shortest interval that the motor can start and stop at, ticks.
    pub pull_in_ticks: u32,
}

/// Values of [`dir_pin`](MotorSetup::dir_pin) that mean four coils: wave, full and half step. A board that drives no coils refuses them as
/// pins that it does not have.
pub const COILS: [u8; 3] = [240, 241, 242];

/// Bytes of a [`MotorSetup`].
pub const MOTOR_SETUP_LEN: usize = 8;

/// The length of a body that every board takes, bytes: a configuration of four motors. [`Info::max_body`] has each board's own.
pub const MIN_BODY: usize = 2 + 13 + 4 * MOTOR_SETUP_LEN;

/// What [`MotorSetup::queue_parts`] are parts of.
pub const QUEUE_PARTS: u8 = 64;

/// The pins of four coils, IN1 to IN4, where IN1 is `pin`. They follow one another as on a Pico's header, where GPIO 26 comes
/// after 22.
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
    /// Four coils on [`coil_pins`]`(pin)`. Not every board drives coils.
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

    /// How its coils are switched; `None` for a step/dir driver.
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
    /// `None` if the bytes end inside a motor's, or are of more than [`MAX_MOTORS`].
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

    /// Reads the payload of Configure; `None` if it is not valid.
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

    /// The payload of Configure: the part before the motors, and the motors.
    #[must_use]
    pub fn to_bytes(&self) -> ([u8; 13], &'a [u8]) {
        let [p0, p1] = self.pulse_ticks.to_le_bytes();
        let [s0, s1] = self.setup_ticks.to_le_bytes();
        let [h0, h1] = self.hold_ticks.to_le_bytes();
        let [i0, i1] = self.idle_ms.unwrap_or(0).to_le_bytes();
        let [q0, q1] = self.silence_ms.to_le_bytes();
        let flags = u8::from(self.enable_high) | u8::from(self.idle_ms.is_some()) << 1;
        // `new` and `decode` refuse more than MAX_MOTORS, so that this always fits.
        let motors = u8::try_from(self.motors().len()).unwrap_or(u8::MAX);
        ([p0, p1, s0, s1, h0, h1, self.enable_pin, flags, i0, i1, q0, q1, motors], self.motors)
    }

    fn encode(&self, frame: &mut Encoder<'_>) {
        let (head, motors) = self.to_bytes();
        frame.bytes(&head);
        frame.bytes(motors);
    }
}

/// Whether flags, shares of the queues and length of a configuration are valid.
// It is not inlined: else an AVR would save and restore its registers around the code that writes the fields.
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

/// What the board is: the answer to Hello, which has tag 0.
///
/// | byte | |
/// |---|---|
/// | 2 | protocol: [`VERSION`] |
/// | 3–6 | the host's number from Hello |
/// | 7 | the session's [`Tag`], which all further frames have, both ways |
/// | 8 | board: 1 the Uno, 2 the Pico; 0 a model |
/// | 9–11 | firmware's version |
/// | 12–15 | ticks a second |
/// | 16 | fraction bits of the recurrence, F; with 16 or fewer, add has 32 bits and intervals are below 2^24 ticks: `RegisterWidths` |
/// | 17 | motors at most |
/// | 18–19 | bytes of all queues together |
/// | 20–21 | bytes that may be on their way to the board |
/// | 22 | rates that the line can do: a bit for each code of [`Baud`] |
/// | 23 | [`Cause`] of the last stop |
/// | 24 | [`Cause`] of the last reset |
/// | 25 | bytes of the longest body that the board takes, 47 to 80 |
/// | 26 | only from an Uno: its image, 1 plans, 2 text, 3 verbs |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Info {
    /// The host's number from Hello. The service fills it in.
    pub nonce: u32,
    /// The tag of all further frames. The service fills it in.
    pub tag: Tag,
    /// 1 the Uno, 2 the Pico; 0 a model.
    pub board: u8,
    /// Major, minor, patch.
    pub firmware: [u8; 3],
    /// Ticks a second.
    pub tick_hz: u32,
    /// Fraction bits of the recurrence, F.
    pub fraction_bits: u8,
    /// Motors at most.
    pub max_motors: u8,
    /// Bytes of all queues together.
    pub pool: u16,
    /// Bytes that may be on their way to the board.
    pub window: u16,
    /// Rates that the line can do ([`can_baud`](super::BoardSide::can_baud)): a bit for each code.
    pub bauds: u8,
    /// Why motors stopped last.
    pub last_stop: Cause,
    /// Why the board's program started last.
    pub last_reset: Cause,
    /// Bytes of the longest body that the board takes. The service fills it in.
    pub max_body: u8,
    /// The [`image`] on the board; 0 for a board that has only one.
    pub image: u8,
}

/// Images of an Uno, in [`Info::image`].
pub mod image {
    /// Plans, streamed from a host.
    pub const PLANS: u8 = 1;
    /// `StepperWinch`'s text.
    pub const WINCH: u8 = 2;
    /// Motors that obey MOVE, SPEED and DIRECTION.
    pub const VERBS: u8 = 3;
}

impl Info {
    /// A placeholder for a board that has not answered yet.
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

/// How far frames were taken, and how much more the queues take: the answer to Data and Poll.
///
/// | byte | |
/// |---|---|
/// | 0 | sequence number of the last frame that was taken in order |
/// | 2 | [`flags`] of the board |
/// | 3 | accepted: sequence number of the last Extend, Switch, Trim or Brake that was accepted; that of Hello if none was |
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

/// State bits of the board, and fault bits of a motor.
pub mod flags {
    /// Nothing is left to do on any motor: no step, no end of a pulse.
    pub const IDLE: u8 = 1;
    /// There is a configuration.
    pub const CONFIGURED: u8 = 2;
    /// The board takes Data.
    pub const ARMED: u8 = 4;
    /// A motion in the board's flash runs, from power-up until its end or a stop.
    pub const BAKED: u8 = 8;
    /// Of a motor: a step came too late, or too soon after another. It was not made, nor what followed in its epoch.
    pub const STEP_MISSED: u8 = 1;
    /// Of a motor: a DIR edge came too close before its step. (An Uno delays the step instead.)
    pub const SETUP_CUT_SHORT: u8 = 2;
    /// Of a motor: its queue ended inside an item, or had bytes that are no item.
    pub const BAD_ITEM: u8 = 4;
    /// Of a motor: position or accumulator were not those that the host expected.
    pub const CHECK_FAILED: u8 = 8;
    /// Of a motor: an immediate stop came above its pull-in speed, so that it may stand elsewhere than the count says. An Uno reports this
    /// only in Stopped.
    pub const UNCERTAIN: u8 = 16;
}

/// The part of [`Status`] that is common to all motors.
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
    /// How long the plan is valid.
    pub lease: LeaseState,
}

/// The state of a lease, in Status.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LeaseState {
    /// There is none.
    #[default]
    Off,
    /// The plan is valid up to this tick.
    Until(Tick32),
    /// The plan is valid to its end.
    Last,
    /// The lease has been over since this tick.
    Lapsed(Tick32),
}

impl LeaseState {
    /// The result of [`BoardSide::lease`](super::BoardSide::lease).
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

/// The part of [`Status`] that each motor has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotorStatus {
    /// Steps forward minus steps backward, pulses begun, modulo 2^32.
    pub position: i32,
    /// Free bytes of the queue.
    pub free: u16,
    /// Its faults since it was armed: see [`flags`].
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
/// | 16 | accepted: sequence number of the last Extend, Switch, Trim or Brake that was accepted; that of Hello if none was |
/// | 17–20 | the lease's end, or the tick at which it lapsed: the low 32 bits of the tick; else 0 |
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
        // The horizon comes as 32 bits. It is near the clock, mostly after it, so that the clock has its upper half.
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

/// A board's measurements of itself since its counters were last set to zero: the answer to Measures. A counter that has reached its largest
/// value keeps it.
///
/// | byte | |
/// |---|---|
/// | 2–3 | compares that were missed and made late |
/// | 4–5 | the latest of them, ticks |
/// | 6–7 | how often the step interrupt found no edge although steps were left |
/// | 8–9 | how far the rings were filled ahead at least while steps were left, ticks; 65535 if there were none |
/// | 10–11 | longest round of the main loop, ticks |
/// | 12–13 | the most received bytes that waited at a time |
/// | 14–15 | bytes from the line that were lost, or came damaged |
/// | 16–17 | frames whose CRC was wrong |
/// | 18–19 | bytes of the stack that were never used |
/// | 20–23 | rounds of the main loop |
/// | 24–31 | ticks in which the main loop had nothing to do |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Measures {
    /// Compares that were missed and made late.
    pub late: u16,
    /// The latest of them, ticks.
    pub latest_ticks: u16,
    /// How often the step interrupt found no edge although steps were left.
    pub starved: u16,
    /// How far the rings were filled ahead at least while steps were left, ticks; `u16::MAX` if there were none.
    pub least_ahead_ticks: u16,
    /// Longest round of the main loop, ticks.
    pub longest_round_ticks: u16,
    /// The most received bytes that waited at a time.
    pub most_unread: u16,
    /// Bytes from the line that were lost, or came damaged.
    pub lost_bytes: u16,
    /// Frames whose CRC was wrong. The service fills it in.
    pub damaged_frames: u16,
    /// Bytes of the stack that were never used.
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

/// A report that the board sends unasked. Byte 0 counts events, so that a lost event leaves a gap.
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
    /// The motor that it concerns; [`ALL_MOTORS`] for all.
    pub motor: u8,
    /// The tick at which it happened.
    pub tick: u64,
    /// A number that explains it: see [`Cause`].
    pub detail: u32,
}

/// In place of a motor's number: all motors.
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

/// What a board sends.
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
        /// The board's clock.
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
    /// | 2 | 0 accepted, 1 late, 2 a queue has fewer bytes than that, 3 no lease, or it has lapsed |
    /// | 3–10 | late: horizon; fewer bytes: the motor; else 0 |
    Trimmed(Trimmed),
    /// To Brake.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2–9 | the tick from which on all motors brake, or did so already; 2^64 − 1 if there is no lease |
    Braked {
        /// The tick from which on all motors brake; `None` without a lease.
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
        /// When motors stopped, and which positions are uncertain.
        stopped: Stopped,
        /// Each motor's position, steps modulo 2^32.
        positions: PerMotor<i32>,
    },
    /// To Data and Poll.
    Ack(Ack),
    /// To Measures.
    Measures(Measures),
    /// To Orders.
    Obeyed(Obeyed),
    /// To Store: the stored settings.
    ///
    /// | byte | |
    /// |---|---|
    /// | 2 | bit 0: settings are stored and valid. Bit 1: the board has found damaged settings |
    /// | 3–16 | the settings, bytes 2 to 15 of `Settings`; 0 if there are none |
    Stored(Stored),
    /// To Arm, Release, Discard, Baud, Bye: done. No payload.
    Done {
        /// The command's kind.
        kind: u8,
    },
    /// To any command: the board does not do it.
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
        /// A number that explains it: see [`Reason`].
        detail: u16,
    },
    /// A frame came that the board cannot take yet. The host goes back, and repeats all frames after the one in byte 0.
    ///
    /// | byte | |
    /// |---|---|
    /// | 0 | sequence number of the last frame that was taken in order |
    /// | 2 | 0: a frame is missing; 1: no host has taken the board; 2: no room for the next frame |
    /// | 3 | accepted: sequence number of the last Extend, Switch, Trim or Brake that was accepted; that of Hello if none was |
    Missing {
        /// Why (byte 2).
        why: Missing,
        /// Sequence number of the last change of the plan that was accepted (byte 3).
        accepted: u8,
    },
    /// A report that is no answer to a command.
    Event(Event),
}

impl Reply {
    /// Reads a body that came from a board, and returns it with its sequence number; `None` if no board of this protocol version writes
    /// such a body.
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
            // In another version of the protocol other bytes may follow. `version_of` reads the version in any case.
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

/// The protocol version of a board, from the body of its answer to Hello. This byte is the same in all versions.
#[must_use]
pub fn version_of(body: &[u8]) -> Option<u8> {
    match body {
        [_, kind, version, ..] if *kind == kind::HELLO | kind::ANSWER => Some(*version),
        _ => None,
    }
}
