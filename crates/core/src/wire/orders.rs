//! Verbs in frames: orders to motors, and the answer. [`verbs`](crate::verbs) says what each verb does.

use super::frame::Encoder;
use super::limits::MAX_MOTORS;
use super::outcome::{Reason, Refusal};
use crate::verbs::{Heading, OrderError, OrderList, Refused, Verb, Verbs};

/// Verbs in one frame at most.
pub const MAX_ORDERS: usize = 8;

/// Bytes of each order.
pub const ORDER_LEN: usize = 9;

/// Codes of verbs, in the upper half of an order's first byte.
mod code {
    pub(super) const MOVE: u8 = 0;
    pub(super) const SPEED: u8 = 1;
    pub(super) const HEADING: u8 = 2;
    pub(super) const RUN: u8 = 3;
    pub(super) const HALT: u8 = 4;
}

/// Verbs for motors, which all begin at the same tick.
///
/// | byte | |
/// |---|---|
/// | 2… | up to eight orders, nine bytes each, executed in this order; none: the host only asks where motors are |
/// | +0 | bits 0–2: the motor; bits 4–7: 0 move, 1 speed, 2 heading, 3 run, 4 halt; others 0 |
/// | +1–8 | move: steps, below 2^32; speed: ticks from step to step, at most 2^62; heading: 0 stationary, 1 forward, 2 backward; else 0 |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orders<'a> {
    /// The orders' bytes in the frame. `decode` has checked each.
    bytes: &'a [u8],
}

impl<'a> Orders<'a> {
    /// No order: the host only asks where motors are.
    pub const NONE: Orders<'static> = Orders { bytes: &[] };

    /// Reads a frame's payload; `None` if it is not valid.
    #[must_use]
    pub fn decode(bytes: &'a [u8]) -> Option<Orders<'a>> {
        let (orders, rest) = bytes.as_chunks::<ORDER_LEN>();
        let whole = rest.is_empty() && orders.len() <= MAX_ORDERS;
        (whole && orders.iter().all(|order| read(order).is_some())).then_some(Orders { bytes })
    }

    /// Whether there is no order.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Each order's motor and verb.
    pub fn iter(&self) -> impl Iterator<Item = (u8, Verb)> + 'a {
        self.bytes.as_chunks::<ORDER_LEN>().0.iter().filter_map(read)
    }

    /// The verbs for one motor, in order; `motor` is below 8. Verbs of other motors are not decoded.
    pub fn of(&self, motor: u8) -> impl Iterator<Item = Verb> + 'a {
        let own = self.bytes.as_chunks::<ORDER_LEN>().0.iter().filter(move |[first, ..]| first & 15 == motor);
        own.filter_map(|order| Some(read(order)?.1))
    }

    /// Has the motors of `verbs` obey all orders or, with an error, none. Returns the answer to the host.
    ///
    /// # Errors
    /// [`Reason::NoSuchMotor`], [`Reason::Period`], [`Reason::Busy`].
    pub fn tell(&self, verbs: &mut Verbs) -> Result<Obeyed, Refusal> {
        verbs.obey(self)?;
        Ok(Obeyed::by(verbs))
    }

    /// Writes them.
    pub(super) fn encode(&self, frame: &mut Encoder<'_>) {
        frame.bytes(self.bytes);
    }
}

impl OrderList for Orders<'_> {
    fn iter(&self) -> impl Iterator<Item = (u8, Verb)> {
        Orders::iter(self)
    }

    fn of(&self, motor: u8) -> impl Iterator<Item = Verb> {
        Orders::of(self, motor)
    }
}

impl From<OrderError> for Refusal {
    fn from(error: OrderError) -> Refusal {
        match error {
            OrderError::NoSuchMotor { motor } => Refusal { reason: Reason::NoSuchMotor, detail: u16::from(motor) },
            OrderError::Refused { why: Refused::Period { shortest }, .. } => {
                Refusal { reason: Reason::Period, detail: u16::try_from(shortest).unwrap_or(u16::MAX) }
            }
            OrderError::Refused { motor, why: Refused::Busy } => {
                Refusal { reason: Reason::Busy, detail: u16::from(motor) }
            }
        }
    }
}

fn read(order: &[u8; ORDER_LEN]) -> Option<(u8, Verb)> {
    let [first, value @ ..] = *order;
    let value = u64::from_le_bytes(value);
    let verb = match (first >> 4, value) {
        (code::MOVE, steps) => Verb::Move { steps: u32::try_from(steps).ok()? },
        (code::SPEED, ticks) => Verb::Speed { ticks },
        (code::HEADING, 0) => Verb::Heading(Heading::Stationary),
        (code::HEADING, 1) => Verb::Heading(Heading::Forward),
        (code::HEADING, 2) => Verb::Heading(Heading::Backward),
        (code::RUN, 0) => Verb::Run,
        (code::HALT, 0) => Verb::Halt,
        _ => return None,
    };
    (first & 8 == 0).then_some((first & 7, verb))
}

/// The bytes of one order. [`Orders::decode`] reads any number of these, one after the other. `motor` is taken modulo 8.
#[must_use]
pub const fn order(motor: u8, verb: Verb) -> [u8; ORDER_LEN] {
    let (code, value) = match verb {
        Verb::Move { steps } => (code::MOVE, steps as u64),
        Verb::Speed { ticks } => (code::SPEED, ticks),
        Verb::Heading(heading) => (code::HEADING, heading as u64),
        Verb::Run => (code::RUN, 0),
        Verb::Halt => (code::HALT, 0),
    };
    let [a, b, c, d, e, f, g, h] = value.to_le_bytes();
    [motor & 7 | code << 4, a, b, c, d, e, f, g, h]
}

/// The tick from which on an order acts, and what each motor does there: the answer to [`Orders`].
///
/// | byte | |
/// |---|---|
/// | 2–9 | the tick from which on the order acts |
/// | 10 | motors |
/// | 11… | eight bytes each: position there (4); ticks from there to the next step (4), 2^32 − 1: none, or later |
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Obeyed {
    /// The tick from which on the order acts. Earlier steps are not changed.
    pub tick: u64,
    motors: [NextStep; MAX_MOTORS],
    count: u8,
}

/// A motor's position at a tick, and its next step from there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NextStep {
    /// Steps forward minus steps backward before the tick, modulo 2^32.
    pub position: i32,
    /// Ticks from there to the next step; [`u32::MAX`] if there is none, or it is further away.
    pub wait: u32,
}

impl Obeyed {
    /// The answer of a board without motors.
    pub const NONE: Obeyed =
        Obeyed { tick: 0, motors: [NextStep { position: 0, wait: u32::MAX }; MAX_MOTORS], count: 0 };

    /// The answer for motors at `tick`, each with its position and the tick of its next step.
    #[must_use]
    pub fn new(tick: u64, motors: impl Iterator<Item = (i32, Option<u64>)>) -> Obeyed {
        let mut obeyed = Obeyed { tick, ..Obeyed::NONE };
        for (place, (position, next)) in obeyed.motors.iter_mut().zip(motors) {
            let wait = next.and_then(|next| u32::try_from(next.saturating_sub(tick)).ok());
            *place = NextStep { position, wait: wait.unwrap_or(u32::MAX) };
            obeyed.count += 1;
        }
        obeyed
    }

    /// The answer from `verbs`: what motors do from [`Verbs::known`] on, unless other orders come.
    #[must_use]
    pub fn by(verbs: &Verbs) -> Obeyed {
        Obeyed::new(verbs.known(), verbs.next_steps())
    }

    /// The motors, in order.
    #[must_use]
    pub fn motors(&self) -> &[NextStep] {
        self.motors.get(..usize::from(self.count)).unwrap_or_default()
    }

    /// Writes the answer.
    pub fn encode(&self, frame: &mut Encoder<'_>) {
        encode_obeyed(self.tick, self.motors(), frame);
    }

    pub(super) fn decode(payload: &[u8]) -> Option<Obeyed> {
        let (tick, rest) = payload.split_first_chunk()?;
        let (count, rest) = rest.split_first()?;
        let (motors, rest) = rest.as_chunks::<8>();
        let mut obeyed = Obeyed { tick: u64::from_le_bytes(*tick), count: *count, ..Obeyed::NONE };
        for (place, [a, b, c, d, wait @ ..]) in obeyed.motors.iter_mut().zip(motors) {
            *place = NextStep { position: i32::from_le_bytes([*a, *b, *c, *d]), wait: u32::from_le_bytes(*wait) };
        }
        let whole = rest.is_empty() && motors.len() == usize::from(*count) && motors.len() <= MAX_MOTORS;
        whole.then_some(obeyed)
    }
}

/// Writes an [`Obeyed`] of at most [`MAX_MOTORS`] motors. It is for a board that is too small to hold one in its RAM.
#[expect(clippy::cast_possible_truncation, reason = "at most 8")]
pub fn encode_obeyed(tick: u64, motors: &[NextStep], frame: &mut Encoder<'_>) {
    frame.u64(tick);
    frame.u8(motors.len() as u8);
    for NextStep { position, wait } in motors {
        frame.u32(position.cast_unsigned());
        frame.u32(*wait);
    }
}
