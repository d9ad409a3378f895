//! What the [`Service`](pulsetrain_core::wire::Service) asks of a board, done on this one.

use crate::clock::{self, Clock, TICK_HZ};
use crate::link::{self, Line, WINDOW};
use crate::regs;
use crate::reset;
use crate::start::{self, Once};
use crate::steps::MOTORS;
use crate::steps::pins::{self, Layout};
use crate::steps::stepper::{FRACTION_BITS, Halt, LONGEST, LONGEST_IDLE_MS, POOL, Pace, Stepper};
use crate::store::Store;
use crate::winch;
use pulsetrain_core::lease::{self, Lapse, Lease};
use pulsetrain_core::verbs::motor::MOST_ITEMS;
use pulsetrain_core::verbs::{Motor, Verbs};
use pulsetrain_core::winch::path::Slice;
use pulsetrain_core::wire::message::{
    ALL_MOTORS, Cause, Configuration, Event, Info, LeaseState, Measures, NO_PIN, flags,
};
use pulsetrain_core::wire::orders::{Obeyed, Orders};
use pulsetrain_core::wire::outcome::NO_LEASE;
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Encoder, Machine, Millis, Reason, Refusal, Stopped, Switched, Trimmed};
use pulsetrain_core::{Epoch, Tick32};

/// A switch must be less than this ahead, ticks: moments are told apart within 2^31.
const SWITCH_AHEAD: u64 = 1 << 30;

/// Motors that get words before others have their turn with the main loop.
const FILLS_A_ROUND: u32 = 4;

/// News that the host has not been told yet; what does not fit is dropped.
const NEWS: usize = 8;

/// Kinds of faults of a motor's queue.
const FAULTS: usize = 3;

/// What motors do that are told directly is worked out so much farther than words are to be written, ticks: 0.1 ms.
const FARTHER: u64 = TICK_HZ as u64 / 10_000;

static VERBS: Once<Verbs> = Once::new(Verbs::new());

/// Everything but the service that speaks for it.
pub(crate) struct Board {
    pub(crate) clock: Clock,
    stepper: Stepper,
    power: Power,
    /// The pins of the configuration, bit by GPIO.
    pins: u32,
    armed: bool,
    /// A motion in the flash has the motors.
    baked: bool,
    /// Motors are told directly, by what is in `verbs`; `obeyed` came of it last.
    obeys: bool,
    /// At which pace.
    pub(crate) pace: Pace,
    verbs: &'static mut Verbs,
    pub(crate) obeyed: Obeyed,
    /// The rate of the session's line, to be set when that is quiet.
    pub(crate) baud: Option<Baud>,
    news: [Option<Event>; NEWS],
    /// Faults that were told, kind by kind, bit by motor.
    told: [u8; FAULTS],
    /// Motors that were stopped faster than they can, since they were armed, bit by motor.
    uncertain: u8,
    was_idle: bool,
    /// When the lease was over, if it is: noted before moments wrap.
    ended: Option<u64>,
    last_stop: Cause,
    last_reset: Cause,
    pub(crate) measures: Measures,
    pub(crate) store: Store,
}

/// The enable line of the drivers.
struct Power {
    pin: u8,
    /// Enable is active high.
    high: bool,
    /// Rest after which the drivers are released.
    idle_ms: Option<u16>,
    on: bool,
    /// When something was last to be done.
    busy: Millis,
}

impl Power {
    const OFF: Power = Power { pin: NO_PIN, high: false, idle_ms: None, on: false, busy: Millis(0) };

    /// Takes on a pin, and releases the drivers.
    fn set_up(&mut self, pin: u8, high: bool, idle_ms: Option<u16>) {
        *self = Power { pin, high, idle_ms, ..Power::OFF };
        self.set(false);
        if pin != NO_PIN {
            regs::SIO_OE_SET.write(1 << pin);
            // §2.19.6.3: input on, 4 mA, Schmitt trigger. §2.19.2: the processor's.
            regs::pad(pin).write(1 << 6 | 1 << 4 | 1 << 1);
            regs::gpio_ctrl(pin).write(5);
        }
    }

    fn set(&mut self, on: bool) {
        self.on = on;
        if self.pin != NO_PIN {
            let register = if on == self.high { regs::SIO_OUT_SET } else { regs::SIO_OUT_CLR };
            register.write(1 << self.pin);
        }
    }

    /// Holds while there is something to do, and `idle_ms` longer. Whether it lets go just now.
    fn look(&mut self, now: Millis, idle: bool) -> bool {
        if !idle {
            self.busy = now;
            if !self.on {
                self.set(true);
            }
            return false;
        }
        let rests = self.idle_ms.is_some_and(|idle_ms| now.since(self.busy) >= idle_ms);
        let goes = self.on && rests;
        if goes {
            self.set(false);
        }
        goes
    }
}

impl Board {
    /// Starts clock and motors; it knows no pins yet.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn begin() -> Board {
        Board {
            clock: Clock::start(),
            // SAFETY: the caller's promise.
            stepper: unsafe { Stepper::begin() },
            power: Power::OFF,
            pins: 0,
            armed: false,
            baked: false,
            obeys: false,
            pace: Pace::NEAR,
            // SAFETY: the caller's promise.
            verbs: unsafe { VERBS.take() },
            obeyed: Obeyed::NONE,
            baud: None,
            news: [None; NEWS],
            told: [0; FAULTS],
            uncertain: 0,
            was_idle: true,
            ended: None,
            last_stop: Cause::None,
            last_reset: reset::why(),
            measures: Board::NO_MEASURES,
            store: Store::EMPTY,
        }
    }

    const NO_MEASURES: Measures = Measures {
        late: 0,
        latest_ticks: 0,
        starved: 0,
        least_ahead_ticks: 0,
        longest_round_ticks: 0,
        most_unread: 0,
        lost_bytes: 0,
        damaged_frames: 0,
        stack_left: 0,
        rounds: 0,
        idle_ticks: 0,
    };

    /// What cannot wait: words for the motors. Whether there was some of that to do.
    #[inline(always)]
    pub(crate) fn go_on(&mut self) -> bool {
        let mut more = false;
        if self.obeys {
            self.work_out();
        }
        for _ in 0..FILLS_A_ROUND {
            // Words that come after that would be steps at wrong times.
            if self.stepper.has_starved() {
                self.starved();
            }
            if !self.stepper.fill(&mut self.clock) {
                break;
            }
            more = true;
        }
        more
    }

    /// Works out what motors do that are told directly, as far as words are written.
    #[inline(never)]
    fn work_out(&mut self) {
        let Board { verbs, stepper, clock, pace, .. } = self;
        let until = clock.now() + u64::from(stepper.foresight(*pace)) + FARTHER;
        if until >= verbs.known() + u64::from(pace.slice) && stepper.has_room(MOST_ITEMS) {
            verbs.work_out::<FRACTION_BITS>(until, |motor, item| stepper.take(motor, item));
            stepper.follow_from(Tick32::of(until));
        }
    }

    /// How long no motor needs words, µs.
    pub(crate) fn spare_us(&mut self) -> u32 {
        let now = self.clock.moment();
        clock::us(self.stepper.spare(now))
    }

    /// Whether words for the motors are more urgent than what the host says.
    #[inline(always)]
    pub(crate) const fn is_behind(&self) -> bool {
        self.stepper.is_behind()
    }

    #[inline(never)]
    fn starved(&mut self) {
        self.measures.starved = self.measures.starved.saturating_add(1);
        self.stop(Cause::Starved);
    }

    /// Sets up the pins that text's axes have, drivers off, motors at 0; whether that could be done. Frames' motors rest.
    pub(crate) fn wire(&mut self) -> bool {
        winch::wiring().is_some_and(|wiring| self.configure(&wiring).is_ok())
    }

    /// Switches the drivers on and has motors follow paths, whose steps come by [`follow`](Board::follow) and begin at `first` or
    /// later, at least a millisecond from now.
    pub(crate) fn drive(&mut self, first: u64) -> bool {
        self.stepper.follow_from(Tick32::of(first));
        self.arm().is_ok()
    }

    /// The steps of all axes in the millisecond that begins at tick `begin` and ends at `end`.
    pub(crate) fn follow(&mut self, slices: [Slice; 4], begin: u64, end: u64) {
        for (motor, slice) in (0..).zip(slices) {
            if let Some(steps) = slice.steps(winch::SLICE) {
                self.stepper.follow(motor, Tick32::of(begin), steps);
            }
        }
        self.stepper.follow_from(Tick32::of(end));
    }

    /// Whether nothing moves, and nothing is to.
    pub(crate) fn rests(&mut self) -> bool {
        let now = self.clock.now();
        !self.armed || (!self.baked && self.is_idle(now))
    }

    /// Has a motion in the flash have the motors; gives its epoch. `None` if they cannot be set up so.
    pub(crate) fn begin_baked(&mut self, configuration: &Configuration<'_>) -> Option<Epoch> {
        self.configure(configuration).ok()?;
        self.arm().ok()?;
        self.baked = true;
        Some(self.stepper.epoch().next())
    }

    /// All motors begin that at `tick`; whether they do.
    pub(crate) fn switch_baked(&mut self, epoch: Epoch, tick: u64) -> bool {
        self.was_idle = false;
        self.stepper.switch(epoch, Tick32::of(tick), Lease::Off, &[])
    }

    /// Free bytes of a motor's queue.
    pub(crate) fn room(&self, motor: u8) -> u16 {
        self.stepper.free(motor)
    }

    /// Puts packed items of a motion in the flash last in a motor's queue, which has room for them.
    pub(crate) fn feed(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) {
        // There is room: that was asked.
        let _ = self.stepper.push(motor, epoch, packed);
    }

    /// Whether a motion in the flash still has the motors; `fed`: all of it was handed over.
    pub(crate) fn looks_baked(&mut self, fed: bool) -> bool {
        if fed && self.baked {
            let now = self.clock.now();
            self.baked = !self.is_idle(now);
        }
        self.baked
    }

    /// While a motion in the flash has the motors nobody else does.
    const fn check_free(&self) -> Result<(), Refusal> {
        if self.baked { Err(Refusal::of(Reason::Baked)) } else { Ok(()) }
    }

    /// The clock, ticks, and the steps that the axes have made by then.
    pub(crate) fn positions(&mut self) -> (u64, [i32; 4]) {
        let now = self.clock.now();
        (now, [0, 1, 2, 3].map(|motor| self.stepper.position(motor, Tick32::of(now))))
    }

    /// Whether motors are armed: the main loop may not sleep for long.
    pub(crate) const fn is_armed(&self) -> bool {
        self.armed
    }

    /// What can wait a millisecond. Whether the UART lost a byte by itself.
    pub(crate) fn housekeeping(&mut self, now: Millis, line: &mut Line) -> bool {
        line.look_after();
        let overrun = link::has_overrun();
        let lost = line.take_loss().saturating_add(overrun.into());
        if lost != 0 {
            let all = u32::from(self.measures.lost_bytes).saturating_add(lost);
            self.measures.lost_bytes = u16::try_from(all).unwrap_or(u16::MAX);
            self.tell(Cause::Overrun, ALL_MOTORS, lost);
        }
        let idle = self.look_after(now);
        if self.armed {
            self.look_at_lease();
            self.look_at_motors();
            if idle && !self.was_idle {
                self.tell(Cause::Finished, ALL_MOTORS, 0);
            }
            self.was_idle = idle;
        }
        overrun
    }

    /// Tells that the lease ended in motion, once that is past.
    fn look_at_lease(&mut self) {
        let (_, Some(lapse)) = self.stepper.lease() else {
            self.ended = None;
            return;
        };
        if self.ended.is_some() || self.clock.moment().is_before(lapse.at) {
            return;
        }
        self.ended = Some(self.clock.extended(lapse.at));
        let (cause, motor) = match lapse.cause {
            // Not in motion: that is Finished.
            lease::LapseCause::NotExtended | lease::LapseCause::Ordered if !self.stepper.was_moving() => return,
            lease::LapseCause::NotExtended => (Cause::Lapsed, ALL_MOTORS),
            lease::LapseCause::Ordered => (Cause::Braked, ALL_MOTORS),
            lease::LapseCause::Underrun => (Cause::RanDry, self.stepper.at_fault()),
            lease::LapseCause::StepMissed => (Cause::StepMissed, self.stepper.at_fault()),
            lease::LapseCause::BadItem => (Cause::BadItem, self.stepper.at_fault()),
        };
        self.last_stop = cause;
        // The queue's own faults are told for each motor.
        if !matches!(cause, Cause::StepMissed | Cause::BadItem) {
            self.tell(cause, motor, 0);
        }
    }

    /// Tells what a motor's own queue asked for and could not be: each kind once, until motors are armed again.
    fn look_at_motors(&mut self) {
        const CAUSES: [(u8, Cause); FAULTS] = [
            (flags::CHECK_FAILED, Cause::CheckFailed),
            (flags::BAD_ITEM, Cause::BadItem),
            (flags::STEP_MISSED, Cause::StepMissed),
        ];
        for motor in 0..self.stepper.count() {
            let faults = self.stepper.faults(motor);
            for (kind, (flag, cause)) in CAUSES.into_iter().enumerate() {
                if faults & flag != 0 && self.told[kind] & 1 << motor == 0 {
                    self.told[kind] |= 1 << motor;
                    self.tell(cause, motor, 0);
                }
            }
        }
    }

    /// The immediate stop.
    fn stop(&mut self, cause: Cause) -> Stopped {
        let Halt { tick, uncertain, reached } = self.stepper.stop(&mut self.clock);
        self.baked = false;
        self.uncertain |= uncertain;
        if self.obeys {
            self.obeys = false;
            self.verbs.stop(|motor| reached.get(usize::from(motor)).copied().unwrap_or(0));
        }
        if self.armed {
            self.armed = false;
            if cause != Cause::None {
                self.last_stop = cause;
            }
            if !matches!(cause, Cause::StopNow | Cause::None) {
                self.tell(cause, ALL_MOTORS, 0);
            }
        }
        Stopped { tick, uncertain }
    }

    /// When the next move is done that is worked out, ticks.
    pub(crate) fn next_done(&self) -> Option<u64> {
        self.verbs.next_done()
    }

    /// What can wait a millisecond, without a line to a host. Whether nothing moves, and nothing is to.
    pub(crate) fn look_after(&mut self, now: Millis) -> bool {
        let tick = self.clock.now();
        self.stepper.rest(Tick32::of(tick));
        let idle = self.is_idle(tick);
        // While motors are armed their coils let go by themselves, to the tick.
        if self.power.look(now, idle) && !self.armed {
            self.stepper.release_coils();
        }
        idle
    }

    /// Whether a motor that is told directly has nothing to do, and all that it did was told.
    pub(crate) fn is_told(&self, motor: u8) -> bool {
        self.verbs.motors().get(usize::from(motor)).is_none_or(|motor| motor.is_at_rest() && motor.is_told())
    }

    /// Whether motors that rest, and are not told directly yet, would do that.
    pub(crate) fn would_obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        self.verbs.begin(self.stepper.limits(), 0);
        orders.tell(&mut self.verbs).map(drop)
    }

    /// Motors that are told directly forget what they do; with `all` false only [what has no end](Verbs::forsake). Gives, bit by motor,
    /// which ones were faster than they can stop.
    pub(crate) fn halt(&mut self, all: bool) -> u8 {
        if !self.obeys {
            return 0;
        }
        let stepper = &self.stepper;
        let uncertain = self.verbs.host_gone(all, |motor| u64::from(stepper.pull_in_ticks(motor)));
        self.uncertain |= uncertain;
        uncertain
    }

    /// A move that was done and not told yet; also after motors were stopped.
    pub(crate) fn move_done(&mut self) -> Option<Event> {
        let now = self.clock.now();
        // An interrupt may have kept words back since they were looked at last. If none is dry by now, all was made that was to be.
        if self.stepper.has_starved() {
            self.starved();
        }
        let (motor, tick, detail) = self.verbs.take_done(now)?;
        Some(Event { cause: Cause::MoveDone, motor, tick, detail })
    }

    fn tell(&mut self, cause: Cause, motor: u8, detail: u32) {
        let now = self.clock.now();
        let ends = [Cause::Lapsed, Cause::Braked, Cause::RanDry, Cause::BadItem, Cause::CheckFailed, Cause::StepMissed];
        let tick = self.ended.filter(|_| ends.contains(&cause)).unwrap_or(now);
        // That a host was lost, or a lease over, is the better reason for the same end.
        if cause == Cause::Finished && self.last_stop == Cause::None {
            self.last_stop = cause;
        }
        if let Some(place) = self.news.iter_mut().find(|news| news.is_none()) {
            *place = Some(Event { cause, motor, tick, detail });
        }
    }

    /// Whether at tick `now` nothing moves, and nothing is to: a last period is over, too.
    fn is_idle(&self, now: u64) -> bool {
        self.stepper.is_idle(Tick32::of(now)) && (!self.obeys || self.verbs.rest_at(now))
    }

    /// Has armed motors that rest be told directly from now on.
    ///
    /// # Errors
    /// [`Reason::NotArmed`], [`Reason::Moving`].
    pub(crate) fn begin_verbs(&mut self) -> Result<(), Refusal> {
        if !self.obeys {
            self.meet()?;
            self.begin_to_obey();
        }
        Ok(())
    }

    /// Motors that rest, and are not told directly yet, would be from here on; so far nothing of theirs changes.
    fn meet(&mut self) -> Result<(), Refusal> {
        let now = self.clock.now();
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if !self.is_idle(now) {
            return Err(Refusal::of(Reason::Moving));
        }
        // Nothing that is written comes after that: see `Words::fill`.
        let written = self.clock.extended(self.stepper.horizon(Tick32::of(now)));
        let known = now.max(written) + u64::from(self.stepper.foresight(self.pace));
        self.verbs.begin(self.stepper.limits(), known);
        Ok(())
    }

    /// They are: see [`meet`](Board::meet).
    fn begin_to_obey(&mut self) {
        self.stepper.set_pace(self.pace);
        self.stepper.follow_from(Tick32::of(self.verbs.known()));
        self.obeys = true;
    }
}

impl Machine for Board {
    const OBEYS: bool = true;
    const STORES: bool = true;

    fn info(&mut self) -> Info {
        Info {
            board: 2,
            firmware: [0, 1, 0],
            tick_hz: TICK_HZ,
            fraction_bits: FRACTION_BITS as u8,
            max_motors: MOTORS as u8,
            pool: POOL as u16,
            window: WINDOW,
            bauds: 0b1_1111,
            last_stop: self.last_stop,
            last_reset: self.last_reset,
            ..Info::NOBODY
        }
    }

    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal> {
        self.check_free()?;
        let now = self.clock.now();
        if self.armed && !self.is_idle(now) {
            return Err(Refusal::of(Reason::Moving));
        }
        let Configuration { pulse_ticks, setup_ticks, hold_ticks, idle_ms, .. } = *configuration;
        if pulse_ticks.max(setup_ticks).max(hold_ticks) > LONGEST {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST });
        }
        let has_coils = configuration.motors().any(|motor| motor.coils().is_some());
        if has_coils && idle_ms.is_some_and(|ms| ms > LONGEST_IDLE_MS) {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST_IDLE_MS });
        }
        let layout = Layout::of(configuration)?;
        self.stop(Cause::None);
        pins::free(self.pins & !layout.used);
        self.pins = layout.used;
        self.power.set_up(layout.enable, configuration.enable_high, idle_ms);
        self.stepper.configure(&layout, configuration, Tick32::of(now));
        Ok(())
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        self.check_free()?;
        if self.motors() == 0 {
            return Err(Refusal::of(Reason::NotConfigured));
        }
        if !self.armed {
            self.power.set(true);
            self.power.busy = clock::millis(self.clock.now());
            self.armed = true;
            self.last_stop = Cause::None;
            self.was_idle = true;
            (self.told, self.uncertain) = ([0; FAULTS], 0);
            self.stepper.start(&mut self.clock);
        }
        Ok(())
    }

    fn release(&mut self) -> Result<(), Refusal> {
        self.check_free()?;
        let now = self.clock.now();
        if self.armed && !self.is_idle(now) {
            return Err(Refusal::of(Reason::Moving));
        }
        self.stop(Cause::None);
        self.power.set(false);
        self.stepper.release_coils();
        Ok(())
    }

    fn motors(&self) -> u8 {
        self.stepper.count()
    }

    fn free(&self, motor: u8) -> u16 {
        self.stepper.free(motor)
    }

    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal> {
        self.check_free()?;
        let detail = u16::from(motor);
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if motor >= self.motors() {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail });
        }
        if self.obeys {
            return Err(Refusal::of(Reason::Obeying));
        }
        self.stepper.push(motor, epoch, packed).ok_or(Refusal { reason: Reason::Full, detail })
    }

    fn discard(&mut self, epoch: Epoch) {
        // Nothing of a host's is there.
        if !self.baked {
            self.stepper.discard(epoch);
        }
    }

    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> Result<Switched, Refusal> {
        self.check_free()?;
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if self.obeys {
            return Err(Refusal::of(Reason::Obeying));
        }
        let horizon = self.horizon();
        let limit = self.clock.now() + SWITCH_AHEAD;
        let switched = if tick < horizon {
            Switched::Late { horizon }
        } else if tick >= limit {
            Switched::Early { limit }
        } else if self.stepper.switch(epoch, Tick32::of(tick), lease, limits) {
            (self.was_idle, self.last_stop) = (false, Cause::None);
            Switched::Accepted
        } else {
            Switched::Full
        };
        if switched != Switched::Accepted {
            self.stepper.discard(epoch);
        }
        Ok(switched)
    }

    fn extend(&mut self, lease: Lease, limits: &[u8]) -> bool {
        self.stepper.extend(lease, limits)
    }

    fn trim(&mut self, until: Tick32, bytes: &[u8]) -> Result<Trimmed, Refusal> {
        self.check_free()?;
        let lease = Lease::Until(until);
        if !self.stepper.can_extend(Lease::Last) {
            return Ok(Trimmed::NoLease);
        }
        if !self.stepper.can_extend(lease) {
            return Ok(Trimmed::Late { horizon: self.horizon() });
        }
        if let Err(motor) = self.stepper.take_back(bytes) {
            return Ok(Trimmed::TooMany { motor });
        }
        self.stepper.extend(lease, &[]);
        Ok(Trimmed::Accepted)
    }

    fn brake(&mut self) -> u64 {
        if self.stepper.can_extend(Lease::Last) {
            let at = self.stepper.horizon(self.clock.moment());
            self.stepper.lapse_at(Lapse { at, cause: lease::LapseCause::Ordered });
        }
        let ended = self.ended.or_else(|| self.stepper.lease().1.map(|lapse| self.clock.extended(lapse.at)));
        ended.unwrap_or(NO_LEASE)
    }

    fn lease(&self) -> (u8, u32) {
        let state = match self.stepper.lease() {
            (_, Some(lapse)) => LeaseState::Lapsed(lapse.at),
            (Lease::Off, None) => LeaseState::Off,
            (Lease::Until(tick), None) => LeaseState::Until(tick),
            (Lease::Last, None) => LeaseState::Last,
        };
        state.to_parts()
    }

    fn stop_now(&mut self) -> Stopped {
        self.stop(Cause::StopNow)
    }

    fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        self.check_free()?;
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if !self.obeys {
            self.meet()?;
        }
        self.obeyed = orders.tell(&mut self.verbs)?;
        // Who is refused, or only asks, leaves motors as they are.
        if !self.obeys && !orders.is_empty() {
            self.begin_to_obey();
        }
        self.was_idle &= self.verbs.motors().iter().all(Motor::is_at_rest);
        Ok(())
    }

    fn obeyed(&self, frame: &mut Encoder<'_>) {
        self.obeyed.encode(frame);
    }

    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        self.check_free()?;
        if self.armed {
            return Err(Refusal::of(Reason::Moving));
        }
        if let Some(settings) = settings {
            let Board { store, clock, .. } = self;
            // Nothing needs words, and no motion is read from the flash.
            store.write(settings, || {
                reset::kick_watchdog();
                clock.now()
            });
        }
        Ok(())
    }

    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        let kept = self.store.settings();
        *settings = kept.copied().unwrap_or_default();
        kept.is_some()
    }

    fn store_is_damaged(&self) -> bool {
        self.store.is_damaged()
    }

    fn clock(&mut self) -> u64 {
        self.clock.now()
    }

    fn flags(&self) -> u8 {
        let configured = if self.motors() > 0 { flags::CONFIGURED } else { 0 };
        let armed = if self.armed { flags::ARMED } else { 0 };
        let baked = if self.baked { flags::BAKED } else { 0 };
        configured | armed | baked | if self.was_idle || !self.armed { flags::IDLE } else { 0 }
    }

    fn horizon(&mut self) -> u64 {
        let now = self.clock.moment();
        self.clock.extended(self.stepper.horizon(now))
    }

    fn epoch(&self) -> Epoch {
        self.stepper.epoch()
    }

    fn position(&mut self, motor: u8) -> i32 {
        let now = self.clock.moment();
        self.stepper.position(motor, now)
    }

    fn faults(&self, motor: u8) -> u8 {
        let uncertain = if self.uncertain >> motor & 1 != 0 { flags::UNCERTAIN } else { 0 };
        self.stepper.faults(motor) | uncertain
    }

    fn measures(&mut self) -> &mut Measures {
        self.measures.stack_left = start::stack_left();
        self.measures.least_ahead_ticks = u16::try_from(self.stepper.least_ahead()).unwrap_or(u16::MAX);
        &mut self.measures
    }

    fn reset_measures(&mut self) {
        self.measures = Board::NO_MEASURES;
        self.stepper.reset_measures();
    }

    fn can_baud(&self, _: Baud) -> bool {
        true
    }

    fn set_baud(&mut self, baud: Baud) {
        self.baud = Some(baud);
    }

    fn rate_fell_back(&mut self) {
        self.tell(Cause::BaudFellBack, ALL_MOTORS, 0);
    }

    fn host_gone(&mut self, lost: bool) {
        if lost && self.armed && !self.was_idle && !self.baked {
            self.last_stop = Cause::HostLost;
        }
        self.halt(lost);
        // They were its news.
        self.news = [None; NEWS];
        self.verbs.mute_moves();
    }

    fn event(&mut self) -> Option<Event> {
        // What was done comes before that all was.
        if let Some(done) = self.move_done() {
            return Some(done);
        }
        let first = self.news[0].take()?;
        self.news.rotate_left(1);
        Some(first)
    }
}
