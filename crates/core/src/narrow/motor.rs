//! The channel of one motor: packed items → events.
//!
//! The rules are those of [`Channel`](crate::Channel): ticks go up strictly; a step that cannot be made is not made, and
//! what follows of its epoch is dropped (there is one anchor in it, the first item: `Channel` would go on at another); a step of the old epoch at a tick ≥ the switch's is not made.

use super::bytes::{Bytes, Pool, PushRefused};
use super::registers::Registers;
use super::unpack::{Found, Record, Unpacker};
use crate::channel::{Event, Kind, SwitchRefused};
use crate::{Direction, Epoch, Moment};

/// How many switches may wait, one after the other.
pub const SWITCHES: usize = 2;

/// The most steps that [`Motor::blind`] grants.
pub const BLIND_STEPS: u8 = 31;

/// The longest interval that [`Motor::blind`] grants, ticks.
pub const SLOWEST_BLIND: u16 = 16_383;

/// What a motor needs to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Steps closer than so many ticks (at least 1) are not made.
    pub gap_ticks: u16,
    /// Each step is preceded by its direction, as a shared DIR line needs it, not only the first after a change.
    pub asserts_every_step: bool,
    /// The packing's gain: [`Packing::gain`](crate::packing::Packing::gain).
    pub gain: i8,
}

/// Why steps of an epoch were not made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// An interval was too short, an item came too late, or a motion had no anchor.
    Missed,
    /// A check found the motor elsewhere than the sender thought.
    Mismatch,
    /// The bytes are no items, or say what does not fit. No more of the epoch is read.
    Bad,
}

/// The first thing that went wrong in an epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fault {
    /// What.
    pub reason: Reason,
    /// Of the first step that could not be made; otherwise the scheduled tick up to which all was well.
    pub tick: Moment,
}

#[derive(Clone, Copy, Debug)]
struct Switch {
    epoch: Epoch,
    at: Moment,
}

/// Expands the packed items of one motor.
///
/// ```
/// use pulsetrain_core::channel::{Event, Kind};
/// use pulsetrain_core::narrow::{Motor, Pool, Settings};
/// use pulsetrain_core::packing::{Packing, State};
/// use pulsetrain_core::{Direction, Epoch, Item, Moment, Segment};
/// let mut pool = Pool::<64>::new();
/// let settings = Settings { gap_ticks: 32, asserts_every_step: false, gain: 0 };
/// let mut motor = Motor::new(Pool::<64>::share(1, 0), settings);
///
/// let (packing, mut state) = (Packing { fraction_bits: 16, gain: 0 }, State::default());
/// let segment = Segment { count: 2, interval: 1000 << 16, add: 0, add2: 0 };
/// for item in [Item::Anchor { tick: Moment(0) }, Item::Run { segment, direction: Direction::Forward }] {
///     let mut bytes = [0; 30];
///     let len = packing.pack(&mut state, &item, &mut bytes).unwrap();
///     motor.push(&mut pool, Epoch(0), &bytes[..len]).unwrap();
/// }
///
/// let mut next = |limit| {
///     let event = motor.peek(&pool, Moment(limit))?;
///     motor.take(event);
///     Some((event.tick.0, event.kind))
/// };
/// assert_eq!(next(1999), Some((1000, Kind::Direction(Direction::Forward))));
/// assert_eq!(next(1999), Some((1000, Kind::Step)));
/// assert_eq!(next(1999), None);
/// assert_eq!(next(2000), Some((2000, Kind::Step)));
/// assert_eq!(motor.position(), 2);
/// ```
#[derive(Clone, Debug)]
pub struct Motor {
    registers: Registers,
    unpacker: Unpacker,
    bytes: Bytes,
    /// What the DIR line was last asked to say.
    facing: Option<Direction>,
    /// Whether the next step's direction has been asserted: the step is then committed.
    committed: bool,
    /// Whether the accumulator means anything.
    anchored: bool,
    /// Whether the rest of the epoch cannot be read, or is not to be made.
    unreadable: bool,
    asserts_every_step: bool,
    gap: u16,
    position: i32,
    /// The lower bits of the position at the last anchor.
    origin: u16,
    horizon: Moment,
    epoch: Epoch,
    switches: [Option<Switch>; SWITCHES],
    fault: Option<Fault>,
}

impl Motor {
    /// A motor at rest at tick 0, position 0, epoch 0, with an empty queue.
    #[must_use]
    pub const fn new(bytes: Bytes, settings: Settings) -> Motor {
        let Settings { gap_ticks, asserts_every_step, gain } = settings;
        Motor {
            registers: Registers::new(),
            unpacker: Unpacker::new(gain),
            bytes,
            facing: None,
            committed: false,
            anchored: false,
            unreadable: false,
            asserts_every_step,
            gap: if gap_ticks == 0 { 1 } else { gap_ticks },
            position: 0,
            origin: 0,
            horizon: Moment(0),
            epoch: Epoch(0),
            switches: [None; SWITCHES],
            fault: None,
        }
    }

    /// Puts packed items of `epoch` last; they may be cut anywhere. Each epoch begins with a reset packing state.
    ///
    /// # Errors
    /// When there is no room; nothing is taken then.
    pub fn push<const N: usize>(&mut self, pool: &mut Pool<N>, epoch: Epoch, bytes: &[u8]) -> Result<(), PushRefused> {
        self.bytes.push(pool, epoch, bytes)
    }

    /// Takes back the bytes of `epoch` if they were pushed last, as after a switch that was refused.
    ///
    /// Not for the epoch being run.
    pub fn discard(&mut self, epoch: Epoch) {
        self.bytes.discard(epoch);
    }

    /// The next event that is not after `limit`; it stays next until [`take`](Motor::take).
    ///
    /// `limit` goes up from call to call, by less than 2^30 ticks beyond the last [`pass`](Motor::pass).
    pub fn peek<const N: usize>(&mut self, pool: &Pool<N>, limit: Moment) -> Option<Event> {
        loop {
            let left = self.registers.left > 0;
            let tick = if left { self.registers.next_tick() } else { Moment(self.registers.tick) };
            if self.committed {
                return Some(Event { tick, kind: Kind::Step });
            }
            // Before anything else: beyond the limit, ticks may be too far from others to be compared with them.
            let beyond = self.anchored && limit.is_before(tick);
            if let Some(switch) = self.switches[0]
                && (beyond || (self.anchored && !tick.is_before(switch.at)))
            {
                if limit.is_before(switch.at) {
                    return None;
                }
                self.begin(switch);
                continue;
            }
            if beyond {
                return None;
            }
            if left {
                if tick.is_before(self.horizon) {
                    self.miss(tick);
                    continue;
                }
                let turned = self.facing != Some(self.unpacker.direction);
                let kind = if turned || self.asserts_every_step {
                    Kind::Direction(self.unpacker.direction)
                } else {
                    Kind::Step
                };
                return Some(Event { tick, kind });
            }
            if self.load(pool) {
                continue;
            }
            match self.switches[0] {
                Some(switch) if !limit.is_before(switch.at) => self.begin(switch),
                _ => return None,
            }
        }
    }

    /// Commits the event that [`peek`](Motor::peek) gave: a step is counted here.
    pub fn take(&mut self, event: Event) {
        match event.kind {
            Kind::Direction(direction) => {
                self.facing = Some(direction);
                self.committed = true;
                self.horizon = event.tick.after(1);
            }
            Kind::Step => {
                self.registers.advance();
                self.registers.left = self.registers.left.wrapping_sub(1);
                self.committed = false;
                self.count(1);
            }
        }
    }

    /// How many of the steps that come next, all of the running segment and in the direction that the DIR line has, may
    /// be made without looking, by whoever advances [`registers_mut`](Motor::registers_mut): 0..=[`BLIND_STEPS`].
    ///
    /// These steps are not after `limit` (less than 2^15 ticks after the last step, to make use of all), no switch
    /// reaches them, and the intervals before them are at least `fastest` (no less than the gap) and at most
    /// [`SLOWEST_BLIND`]. The test is a cheap one and errs on the side of 0: then [`peek`](Motor::peek) knows.
    #[inline(never)]
    #[must_use]
    pub fn blind(&self, fastest: u16, limit: Moment) -> u8 {
        let registers = &self.registers;
        if registers.left == 0
            || self.committed
            || self.asserts_every_step
            || !self.anchored
            || self.facing != Some(self.unpacker.direction)
        {
            return 0;
        }
        // The interval's whole ticks, and how far it may go up or down within 31 steps: no further than
        // 31·|add| + 465·|add2|, for which 32 and 512 are taken.
        let [_, _, ticks_low, ticks_mid] = registers.interval_low.to_le_bytes();
        let interval = u16::from_le_bytes([ticks_low, ticks_mid]);
        let (add, add2) = (upper_half(registers.add), upper_half(registers.add2));
        if registers.interval_high != 0 || interval > SLOWEST_BLIND || add > 0x7fff || add2 > 0x7ff {
            return 0;
        }
        // In units of 2^-8 tick, add2's rounded up by 2: of its 2·256 / 256 ticks.
        let slack = (add >> 3) + (add2 << 1) + 4;
        let longest = interval + slack;
        if longest > SLOWEST_BLIND || interval < slack || interval - slack < fastest {
            return 0;
        }
        if registers.next_tick().is_before(self.horizon) {
            return 0;
        }
        let mut until = limit;
        if let Some(switch) = self.switches[0]
            && !limit.is_before(switch.at)
        {
            until = switch.at.before(1);
        }
        let last = Moment(registers.tick);
        if until.is_before(last) {
            return 0;
        }
        let mut room = u16::try_from(until.since(last)).unwrap_or(u16::MAX);
        // How many times `longest` there is room for: five bits of a quotient, or three where 16 bits hold no more.
        let (mut times, mut bit) = if longest < 1 << 12 { (longest << 4, 16u8) } else { (longest << 2, 4) };
        let mut steps = 0;
        while bit > 0 {
            if room >= times {
                room -= times;
                steps |= bit;
            }
            times >>= 1;
            bit >>= 1;
        }
        match u8::try_from(registers.left) {
            Ok(left) if left < steps => left,
            _ => steps,
        }
    }

    /// The registers, to make steps without looking: as many as [`blind`](Motor::blind) grants, each as
    /// [`Registers::advance`] does it, with [`left`](Registers::left) counted down. Then [`took`](Motor::took).
    pub const fn registers_mut(&mut self) -> &mut Registers {
        &mut self.registers
    }

    /// The registers.
    #[must_use]
    pub const fn registers(&self) -> &Registers {
        &self.registers
    }

    /// Counts `steps` (1..=[`BLIND_STEPS`]) by which the registers were advanced.
    pub fn took(&mut self, steps: u8) {
        self.count(steps);
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks, after all events up to `now` have
    /// been taken.
    pub fn pass(&mut self, now: Moment) {
        let open = now.after(1);
        if self.horizon.is_before(open) {
            self.horizon = open;
        }
        // An accumulator that is left behind would come back as the future.
        if self.registers.left == 0 && matches!(now.since(Moment(self.registers.tick)), 0x4000_0000..0x8000_0000) {
            self.anchored = false;
        }
    }

    /// At tick `at` (less than 2^31 ahead), what is left of the old epoch is to be dropped and `epoch` begun, which is
    /// another one than that being run.
    ///
    /// Switches still waiting at `at` or later are replaced, earlier ones stay.
    ///
    /// # Errors
    /// When `at` lies before the horizon or [`SWITCHES`] wait; nothing changes then.
    pub fn schedule_switch(&mut self, epoch: Epoch, at: Moment) -> Result<(), SwitchRefused> {
        self.check_switch(at)?;
        let switch = Some(Switch { epoch, at });
        self.switches = match self.switches {
            [Some(first), _] if first.at.is_before(at) => [Some(first), switch],
            _ => [switch, None],
        };
        Ok(())
    }

    /// Whether [`schedule_switch`](Motor::schedule_switch) would accept `at`.
    ///
    /// # Errors
    /// As there.
    pub fn check_switch(&self, at: Moment) -> Result<(), SwitchRefused> {
        if at.is_before(self.horizon) {
            return Err(SwitchRefused::Late { horizon: self.horizon });
        }
        match self.switches {
            [Some(first), Some(second)] if first.at.is_before(at) && second.at.is_before(at) => {
                Err(SwitchRefused::Full)
            }
            _ => Ok(()),
        }
    }

    /// Forgets everything that is not yet committed by a pulse: the motor stands where it is, and the count is right.
    /// The packing state is reset.
    pub fn stop(&mut self) {
        self.bytes.clear();
        self.restart();
        self.committed = false;
        self.switches = [None; SWITCHES];
    }

    /// Steps forward minus steps backward that were taken, wrapping.
    #[must_use]
    pub const fn position(&self) -> i32 {
        self.position
    }

    /// The first tick that is not committed: a switch is accepted from there on.
    #[must_use]
    pub const fn horizon(&self) -> Moment {
        self.horizon
    }

    /// The epoch being run.
    #[must_use]
    pub const fn epoch(&self) -> Epoch {
        self.epoch
    }

    /// Which way the steps of the running segment go.
    #[must_use]
    pub const fn direction(&self) -> Direction {
        self.unpacker.direction
    }

    /// What first went wrong in this epoch.
    #[must_use]
    pub const fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// Its queue.
    #[must_use]
    pub const fn bytes(&self) -> &Bytes {
        &self.bytes
    }

    /// Whether there is nothing to do, now or later, unless more is pushed.
    #[must_use]
    pub const fn is_idle(&self) -> bool {
        self.registers.left == 0
            && self.switches[0].is_none()
            && (self.unreadable || self.bytes.waiting(self.epoch) == 0)
    }

    /// Takes the next record and does what it says; whether there was one.
    #[inline(never)]
    fn load<const N: usize>(&mut self, pool: &Pool<N>) -> bool {
        if self.unreadable {
            return false;
        }
        let record = match self.unpacker.next(&mut self.registers, &mut self.bytes, pool, self.epoch) {
            Found::Nothing => return false,
            Found::Bad => {
                self.fail(Reason::Bad, Moment(self.registers.tick));
                self.unreadable = true;
                return false;
            }
            Found::Record(record) => record,
        };
        match record {
            Record::Run if self.anchored => {}
            Record::Run => self.miss(self.horizon),
            Record::Anchor { tick, fraction } => {
                (self.registers.tick, self.registers.fraction) = (tick, fraction);
                self.origin = low(self.position);
                self.anchored = true;
            }
            Record::Dwell(ticks) if self.anchored => {
                self.registers.tick = self.registers.tick.wrapping_add(ticks);
            }
            Record::Check { position, tick, fraction } if self.anchored => {
                let Registers { tick: last, fraction: below, .. } = self.registers;
                let moved = low(self.position).wrapping_sub(self.origin);
                if position != moved || tick != last || fraction != below {
                    self.fail(Reason::Mismatch, Moment(last));
                }
            }
            Record::Dwell(_) | Record::Check { .. } | Record::Prediction => {}
        }
        true
    }

    #[cold]
    #[inline(never)]
    fn miss(&mut self, tick: Moment) {
        self.registers.left = 0;
        self.unreadable = true;
        self.fail(Reason::Missed, tick);
    }

    fn fail(&mut self, reason: Reason, tick: Moment) {
        self.fault = self.fault.or(Some(Fault { reason, tick }));
        self.anchored = false;
    }

    #[cold]
    fn begin(&mut self, switch: Switch) {
        self.bytes.skip_to(switch.epoch);
        self.epoch = switch.epoch;
        self.restart();
        self.fault = None;
        if self.horizon.is_before(switch.at) {
            self.horizon = switch.at;
        }
        self.switches = [self.switches[1], None];
    }

    /// Without steps, anchor and prediction.
    fn restart(&mut self) {
        self.unpacker.restart(&mut self.registers);
        self.registers.left = 0;
        self.anchored = false;
        self.unreadable = false;
    }

    /// Counts steps that the registers have made.
    fn count(&mut self, steps: u8) {
        let steps = i32::from(steps);
        self.position = match self.unpacker.direction {
            Direction::Forward => self.position.wrapping_add(steps),
            Direction::Backward => self.position.wrapping_sub(steps),
        };
        self.horizon = Moment(self.registers.tick).after(u32::from(self.gap));
    }
}

/// |`value`| / 2^8, rounded down, if it fits 16 bits; else the largest number. −1 counts as 0.
const fn upper_half(value: i32) -> u16 {
    let magnitude = if value < 0 { !value } else { value };
    let [_, low, high, beyond] = magnitude.to_le_bytes();
    if beyond == 0 { u16::from_le_bytes([low, high]) } else { u16::MAX }
}

/// The lower bits of a position.
const fn low(position: i32) -> u16 {
    let [low, high, ..] = position.to_le_bytes();
    u16::from_le_bytes([low, high])
}
