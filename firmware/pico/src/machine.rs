//! The board behind the link: does what the [`Service`](pulsetrain_core::wire::Service) asks of it.

use crate::clock::{self, Clock, TICK_HZ};
use crate::regs;
use crate::reset;
use crate::start::{self, StaticCell};
use crate::steps::MOTORS;
use crate::steps::pins::{self, PinLayout};
use crate::steps::stepper::{
    FRACTION_BITS, FillTiming, HaltReport, LONGEST_IDLE_MS, LONGEST_PULSE, POOL_BYTES, Stepper,
};
use crate::store::Store;
use crate::uart::{self, Uart, WINDOW};
use crate::winch;
use pulsetrain_core::lease::{self, Lapse, Lease};
use pulsetrain_core::verbs::motor::MAX_ITEMS;
use pulsetrain_core::verbs::{Motor, Verbs};
use pulsetrain_core::winch::path::Slice;
use pulsetrain_core::wire::message::{
    ALL_MOTORS, Cause, Configuration, Event, Info, LeaseState, Measures, NO_PIN, flags,
};
use pulsetrain_core::wire::orders::{Obeyed, Orders};
use pulsetrain_core::wire::outcome::NO_LEASE;
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Encoder, BoardSide, Millis, Reason, Refusal, Stopped, Switched, Trimmed};
use pulsetrain_core::{Epoch, Tick32};

/// A switch must be less than this ahead, ticks: 8.6 s. Ticks of 32 bits are told apart within 2^31; half of that leaves room for
/// what is compared with it.
const FARTHEST_SWITCH: u64 = 1 << 30;

/// Motors that get words in one round of the main loop at most. Four take about 0.2 ms, and so long the host waits.
const FILLS_A_ROUND: u32 = 4;

/// Events that wait for the host at most. More are dropped: a stop makes one, and a fault one for each motor.
const MOST_EVENTS: usize = 8;

/// Kinds of faults of a motor's queue: a failed check, a bad item, a missed step.
const FAULT_KINDS: usize = 3;

/// Steps of verbs are worked out so much farther than words are written, ticks: 0.1 ms, so that a fill a little later finds them.
const VERBS_MARGIN: u64 = TICK_HZ as u64 / 10_000;

static VERBS: StaticCell<Verbs> = StaticCell::new(Verbs::new());

/// The board: all of it but the service and the ports.
pub(crate) struct Board {
    pub(crate) clock: Clock,
    stepper: Stepper,
    power: EnableLine,
    /// The pins of the configuration, bit by GPIO.
    pins: u32,
    armed: bool,
    /// The motors follow a motion in the flash.
    baked: bool,
    /// The motors follow `verbs`. `obeyed` is the answer to the last orders.
    verbs_run: bool,
    /// When words are written meanwhile.
    pub(crate) timing: FillTiming,
    verbs: &'static mut Verbs,
    pub(crate) obeyed: Obeyed,
    /// The new rate of the session's UART, which is set when all bytes at the old rate are sent.
    pub(crate) baud: Option<Baud>,
    events: [Option<Event>; MOST_EVENTS],
    /// Faults that were reported, by kind, bit by motor.
    reported: [u8; FAULT_KINDS],
    /// Motors that were stopped while they were faster than their pull-in speed, since they were armed, bit by motor.
    uncertain: u8,
    was_idle: bool,
    /// The tick at which the lease lapsed: noted in 64 bits before 32 bits wrap.
    lapsed_at: Option<u64>,
    last_stop: Cause,
    last_reset: Cause,
    pub(crate) measures: Measures,
    pub(crate) store: Store,
}

/// The enable line of the drivers.
struct EnableLine {
    pin: u8,
    /// Enable is active high.
    high: bool,
    /// Rest after which the drivers are released.
    idle_ms: Option<u16>,
    on: bool,
    /// When there was last something to do.
    busy_at: Millis,
}

impl EnableLine {
    const OFF: EnableLine = EnableLine { pin: NO_PIN, high: false, idle_ms: None, on: false, busy_at: Millis(0) };

    /// Sets the pin up, and releases the drivers.
    fn set_up(&mut self, pin: u8, high: bool, idle_ms: Option<u16>) {
        *self = EnableLine { pin, high, idle_ms, ..EnableLine::OFF };
        self.set(false);
        if pin != NO_PIN {
            regs::SIO_OE_SET.write(1 << pin);
            // §2.19.6.3: input on, 4 mA, Schmitt trigger. §2.19.2: driven by the processor.
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

    /// Enables the drivers while there is something to do, and for `idle_ms` after it. Whether they were released just now.
    fn update(&mut self, now: Millis, idle: bool) -> bool {
        if !idle {
            self.busy_at = now;
            if !self.on {
                self.set(true);
            }
            return false;
        }
        let rests = self.idle_ms.is_some_and(|idle_ms| now.since(self.busy_at) >= idle_ms);
        let goes = self.on && rests;
        if goes {
            self.set(false);
        }
        goes
    }
}

impl Board {
    /// Starts the clock and sets up what all motors share. No motor is configured yet.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn begin() -> Board {
        Board {
            clock: Clock::start(),
            // SAFETY: the caller's promise.
            stepper: unsafe { Stepper::begin() },
            power: EnableLine::OFF,
            pins: 0,
            armed: false,
            baked: false,
            verbs_run: false,
            timing: FillTiming::VERBS,
            // SAFETY: the caller's promise.
            verbs: unsafe { VERBS.take() },
            obeyed: Obeyed::NONE,
            baud: None,
            events: [None; MOST_EVENTS],
            reported: [0; FAULT_KINDS],
            uncertain: 0,
            was_idle: true,
            lapsed_at: None,
            last_stop: Cause::None,
            last_reset: reset::cause(),
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

    /// Does what cannot wait: words for the motors. Whether there was something to do.
    #[inline(always)]
    pub(crate) fn fill_motors(&mut self) -> bool {
        let mut more = false;
        if self.verbs_run {
            self.plan_verbs();
        }
        for _ in 0..FILLS_A_ROUND {
            // After an underrun words would be steps at wrong times.
            if self.stepper.has_underrun() {
                self.stop_for_underrun();
            }
            if !self.stepper.fill(&mut self.clock) {
                break;
            }
            more = true;
        }
        more
    }

    /// Works out the steps of verbs, as far as words are written.
    #[inline(never)]
    fn plan_verbs(&mut self) {
        let Board { verbs, stepper, clock, timing, .. } = self;
        let until = clock.now() + u64::from(stepper.foresight(*timing)) + VERBS_MARGIN;
        if until >= verbs.known() + u64::from(timing.verb_slice) && stepper.has_room(MAX_ITEMS) {
            verbs.work_out::<FRACTION_BITS>(until, |motor, item| stepper.push_item(motor, item));
            stepper.set_known_until(Tick32::of(until));
        }
    }

    /// How long no motor needs words, µs.
    pub(crate) fn spare_us(&mut self) -> u32 {
        let now = self.clock.now32();
        clock::us(self.stepper.ticks_to_next_fill(now))
    }

    /// Whether words for the motors are more urgent than the host's frames.
    #[inline(always)]
    pub(crate) const fn is_behind(&self) -> bool {
        self.stepper.is_behind()
    }

    #[inline(never)]
    fn stop_for_underrun(&mut self) {
        self.measures.starved = self.measures.starved.saturating_add(1);
        self.stop(Cause::Starved);
    }

    /// Configures the axes of text, with drivers off and positions at 0, while the motors of frames rest. Whether it could be done.
    pub(crate) fn configure_axes(&mut self) -> bool {
        winch::wiring().is_some_and(|wiring| self.configure(&wiring).is_ok())
    }

    /// Enables the drivers and has motors follow paths. Their steps come by [`push_slice`](Board::push_slice), and the first of
    /// them at tick `first` or later, which is at least a millisecond from now.
    pub(crate) fn begin_paths(&mut self, first: u64) -> bool {
        self.stepper.set_known_until(Tick32::of(first));
        self.arm().is_ok()
    }

    /// Hands over the steps of all axes in the millisecond from tick `begin` to `end`.
    pub(crate) fn push_slice(&mut self, slices: [Slice; 4], begin: u64, end: u64) {
        for (motor, slice) in (0..).zip(slices) {
            if let Some(steps) = slice.steps(winch::SLICE_TICKS) {
                self.stepper.push_steps(motor, Tick32::of(begin), steps);
            }
        }
        self.stepper.set_known_until(Tick32::of(end));
    }

    /// Whether nothing moves, and nothing will.
    pub(crate) fn is_at_rest(&mut self) -> bool {
        let now = self.clock.now();
        !self.armed || (!self.baked && self.is_idle(now))
    }

    /// Configures and arms the motors for a motion in the flash, and returns its epoch. `None` if they cannot be set up so.
    pub(crate) fn begin_baked(&mut self, configuration: &Configuration<'_>) -> Option<Epoch> {
        self.configure(configuration).ok()?;
        self.arm().ok()?;
        self.baked = true;
        Some(self.stepper.epoch().next())
    }

    /// Has all motors begin that motion at `tick`. Whether they do.
    pub(crate) fn switch_baked(&mut self, epoch: Epoch, tick: u64) -> bool {
        self.was_idle = false;
        self.stepper.switch(epoch, Tick32::of(tick), Lease::Off, &[])
    }

    /// Free bytes of a motor's queue.
    pub(crate) fn free_bytes(&self, motor: u8) -> u16 {
        self.stepper.free(motor)
    }

    /// Puts packed items of a motion in the flash last in a motor's queue. It has room for them.
    pub(crate) fn push_baked(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) {
        // The caller has asked for the room.
        let _ = self.stepper.push(motor, epoch, packed);
    }

    /// Whether the motors still follow a motion in the flash. `fed`: all of it is in the queues.
    pub(crate) fn update_baked(&mut self, fed: bool) -> bool {
        if fed && self.baked {
            let now = self.clock.now();
            self.baked = !self.is_idle(now);
        }
        self.baked
    }

    /// Refuses a host's request while the motors follow a motion in the flash.
    const fn check_free(&self) -> Result<(), Refusal> {
        if self.baked { Err(Refusal::of(Reason::Baked)) } else { Ok(()) }
    }

    /// The clock, ticks, and the positions of the axes at that tick.
    pub(crate) fn positions(&mut self) -> (u64, [i32; 4]) {
        let now = self.clock.now();
        (now, [0, 1, 2, 3].map(|motor| self.stepper.position(motor, Tick32::of(now))))
    }

    /// Whether motors are armed: the main loop may not sleep for long.
    pub(crate) const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Does what can wait a millisecond. Whether the UART's receiver lost a byte.
    pub(crate) fn housekeeping(&mut self, now: Millis, uart: &mut Uart) -> bool {
        uart.keep_receiving();
        let overrun = uart::has_overrun();
        let lost = uart.take_lost_bytes().saturating_add(overrun.into());
        if lost != 0 {
            let all = u32::from(self.measures.lost_bytes).saturating_add(lost);
            self.measures.lost_bytes = u16::try_from(all).unwrap_or(u16::MAX);
            self.report(Cause::Overrun, ALL_MOTORS, lost);
        }
        let idle = self.update_idle(now);
        if self.armed {
            self.report_lapse();
            self.report_faults();
            if idle && !self.was_idle {
                self.report(Cause::Finished, ALL_MOTORS, 0);
            }
            self.was_idle = idle;
        }
        overrun
    }

    /// Reports that the lease lapsed in motion, once its tick is past.
    fn report_lapse(&mut self) {
        let (_, Some(lapse)) = self.stepper.lease() else {
            self.lapsed_at = None;
            return;
        };
        if self.lapsed_at.is_some() || self.clock.now32().is_before(lapse.at) {
            return;
        }
        self.lapsed_at = Some(self.clock.widen(lapse.at));
        let (cause, motor) = match lapse.cause {
            // At rest this is `Finished`.
            lease::LapseCause::NotExtended | lease::LapseCause::Ordered if !self.stepper.was_moving() => return,
            lease::LapseCause::NotExtended => (Cause::Lapsed, ALL_MOTORS),
            lease::LapseCause::Ordered => (Cause::Braked, ALL_MOTORS),
            lease::LapseCause::Underrun => (Cause::RanDry, self.stepper.at_fault()),
            lease::LapseCause::StepMissed => (Cause::StepMissed, self.stepper.at_fault()),
            lease::LapseCause::BadItem => (Cause::BadItem, self.stepper.at_fault()),
        };
        self.last_stop = cause;
        // `report_faults` reports faults of queues, for each motor.
        if !matches!(cause, Cause::StepMissed | Cause::BadItem) {
            self.report(cause, motor, 0);
        }
    }

    /// Reports what queues asked for that could not be done: each kind once for each motor, until motors are armed again.
    fn report_faults(&mut self) {
        const CAUSES: [(u8, Cause); FAULT_KINDS] = [
            (flags::CHECK_FAILED, Cause::CheckFailed),
            (flags::BAD_ITEM, Cause::BadItem),
            (flags::STEP_MISSED, Cause::StepMissed),
        ];
        for motor in 0..self.stepper.count() {
            let faults = self.stepper.faults(motor);
            for (kind, (flag, cause)) in CAUSES.into_iter().enumerate() {
                if faults & flag != 0 && self.reported[kind] & 1 << motor == 0 {
                    self.reported[kind] |= 1 << motor;
                    self.report(cause, motor, 0);
                }
            }
        }
    }

    /// The immediate stop.
    fn stop(&mut self, cause: Cause) -> Stopped {
        let HaltReport { tick, uncertain, reached } = self.stepper.stop(&mut self.clock);
        self.baked = false;
        self.uncertain |= uncertain;
        if self.verbs_run {
            self.verbs_run = false;
            self.verbs.stop(|motor| reached.get(usize::from(motor)).copied().unwrap_or(0));
        }
        if self.armed {
            self.armed = false;
            if cause != Cause::None {
                self.last_stop = cause;
            }
            if !matches!(cause, Cause::StopNow | Cause::None) {
                self.report(cause, ALL_MOTORS, 0);
            }
        }
        Stopped { tick, uncertain }
    }

    /// The tick at which the next move is done, of those that are worked out.
    pub(crate) fn next_done(&self) -> Option<u64> {
        self.verbs.next_done()
    }

    /// Notes the time, and releases drivers that have rested long enough; to be called every millisecond or so. Whether nothing
    /// moves, and nothing will.
    pub(crate) fn update_idle(&mut self, now: Millis) -> bool {
        let tick = self.clock.now();
        self.stepper.pass(Tick32::of(tick));
        let idle = self.is_idle(tick);
        // While motors are armed the words release coils, at their tick.
        if self.power.update(now, idle) && !self.armed {
            self.stepper.release_coils();
        }
        idle
    }

    /// Whether a motor has no verb left to do, and all its done moves were reported.
    pub(crate) fn is_motor_done(&self, motor: u8) -> bool {
        self.verbs.motors().get(usize::from(motor)).is_none_or(|motor| motor.is_at_rest() && motor.is_reported())
    }

    /// Whether these orders would be accepted, while motors rest and follow no verbs yet.
    pub(crate) fn check_orders(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        self.verbs.begin(self.stepper.limits(), 0);
        orders.tell(self.verbs).map(drop)
    }

    /// Has motors that follow verbs forget them; with `all` false only [those without an end](Verbs::host_gone). Returns, bit by
    /// motor, which were faster than their pull-in speed.
    pub(crate) fn halt(&mut self, all: bool) -> u8 {
        if !self.verbs_run {
            return 0;
        }
        let stepper = &self.stepper;
        let uncertain = self.verbs.host_gone(all, |motor| u64::from(stepper.pull_in_ticks(motor)));
        self.uncertain |= uncertain;
        uncertain
    }

    /// A move that is done and was not reported yet; also after motors were stopped.
    pub(crate) fn move_done(&mut self) -> Option<Event> {
        let now = self.clock.now();
        // A motor may have run dry since the last look: then its move is not done. If none has by now, all steps up to now were
        // made.
        if self.stepper.has_underrun() {
            self.stop_for_underrun();
        }
        let (motor, tick, detail) = self.verbs.take_done(now)?;
        Some(Event { cause: Cause::MoveDone, motor, tick, detail })
    }

    fn report(&mut self, cause: Cause, motor: u8, detail: u32) {
        let now = self.clock.now();
        let ends = [Cause::Lapsed, Cause::Braked, Cause::RanDry, Cause::BadItem, Cause::CheckFailed, Cause::StepMissed];
        let tick = self.lapsed_at.filter(|_| ends.contains(&cause)).unwrap_or(now);
        // A lost host or a lapsed lease is the better reason for the same end.
        if cause == Cause::Finished && self.last_stop == Cause::None {
            self.last_stop = cause;
        }
        if let Some(place) = self.events.iter_mut().find(|news| news.is_none()) {
            *place = Some(Event { cause, motor, tick, detail });
        }
    }

    /// Whether at tick `now` nothing moves, and nothing will; the period after the last step of a verb is over, too.
    fn is_idle(&self, now: u64) -> bool {
        self.stepper.is_idle(Tick32::of(now)) && (!self.verbs_run || self.verbs.rest_at(now))
    }

    /// Has armed motors that rest follow verbs from now on.
    ///
    /// # Errors
    /// [`Reason::NotArmed`], [`Reason::Moving`].
    pub(crate) fn begin_verbs(&mut self) -> Result<(), Refusal> {
        if !self.verbs_run {
            self.prepare_verbs()?;
            self.run_verbs();
        }
        Ok(())
    }

    /// Prepares `verbs` for motors that rest and follow none yet. The motors themselves do not change: see
    /// [`run_verbs`](Board::run_verbs).
    fn prepare_verbs(&mut self) -> Result<(), Refusal> {
        let now = self.clock.now();
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if !self.is_idle(now) {
            return Err(Refusal::of(Reason::Moving));
        }
        // No word that is written ends later than that: see `WordWriter::fill`.
        let written = self.clock.widen(self.stepper.horizon(Tick32::of(now)));
        let known = now.max(written) + u64::from(self.stepper.foresight(self.timing));
        self.verbs.begin(self.stepper.limits(), known);
        Ok(())
    }

    /// Has the motors follow the verbs that [`prepare_verbs`](Board::prepare_verbs) has prepared.
    fn run_verbs(&mut self) {
        self.stepper.set_timing(self.timing);
        self.stepper.set_known_until(Tick32::of(self.verbs.known()));
        self.verbs_run = true;
    }
}

impl BoardSide for Board {
    const OBEYS: bool = true;
    const STORES: bool = true;

    fn info(&mut self) -> Info {
        Info {
            board: pulsetrain_core::boards::pico::NUMBER,
            firmware: [0, 2, 0],
            tick_hz: TICK_HZ,
            fraction_bits: FRACTION_BITS as u8,
            max_motors: MOTORS as u8,
            pool: POOL_BYTES as u16,
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
        if pulse_ticks.max(setup_ticks).max(hold_ticks) > LONGEST_PULSE {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST_PULSE });
        }
        let has_coils = configuration.motors().any(|motor| motor.coils().is_some());
        if has_coils && idle_ms.is_some_and(|ms| ms > LONGEST_IDLE_MS) {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST_IDLE_MS });
        }
        let layout = PinLayout::of(configuration)?;
        self.stop(Cause::None);
        pins::release(self.pins & !layout.used);
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
            self.power.busy_at = clock::millis(self.clock.now());
            self.armed = true;
            self.last_stop = Cause::None;
            self.was_idle = true;
            (self.reported, self.uncertain) = ([0; FAULT_KINDS], 0);
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
        if self.verbs_run {
            return Err(Refusal::of(Reason::Obeying));
        }
        self.stepper.push(motor, epoch, packed).ok_or(Refusal { reason: Reason::Full, detail })
    }

    fn discard(&mut self, epoch: Epoch) {
        // A motion in the flash has nothing of a host's in the queues.
        if !self.baked {
            self.stepper.discard(epoch);
        }
    }

    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> Result<Switched, Refusal> {
        self.check_free()?;
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if self.verbs_run {
            return Err(Refusal::of(Reason::Obeying));
        }
        let horizon = self.horizon();
        let limit = self.clock.now() + FARTHEST_SWITCH;
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
            let at = self.stepper.horizon(self.clock.now32());
            self.stepper.lapse_at(Lapse { at, cause: lease::LapseCause::Ordered });
        }
        let ended = self.lapsed_at.or_else(|| self.stepper.lease().1.map(|lapse| self.clock.widen(lapse.at)));
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
        if !self.verbs_run {
            self.prepare_verbs()?;
        }
        self.obeyed = orders.tell(self.verbs)?;
        // Orders that are refused, or empty to ask for positions, change nothing.
        if !self.verbs_run && !orders.is_empty() {
            self.run_verbs();
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
            // No motor needs words meanwhile, and no motion is read from the flash: nothing is armed.
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
        let now = self.clock.now32();
        self.clock.widen(self.stepper.horizon(now))
    }

    fn epoch(&self) -> Epoch {
        self.stepper.epoch()
    }

    fn position(&mut self, motor: u8) -> i32 {
        let now = self.clock.now32();
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
        self.report(Cause::BaudFellBack, ALL_MOTORS, 0);
    }

    fn host_gone(&mut self, lost: bool) {
        if lost && self.armed && !self.was_idle && !self.baked {
            self.last_stop = Cause::HostLost;
        }
        self.halt(lost);
        // The events were for that host.
        self.events = [None; MOST_EVENTS];
        self.verbs.mute_moves();
    }

    fn event(&mut self) -> Option<Event> {
        // Done moves come before the event that all is finished.
        if let Some(done) = self.move_done() {
            return Some(done);
        }
        let first = self.events[0].take()?;
        self.events.rotate_left(1);
        Some(first)
    }
}
