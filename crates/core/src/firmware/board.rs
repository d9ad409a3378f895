//! The board behind the link, on any [`Hardware`]: it does what the [`Service`](crate::wire::Service) asks.

use super::enable::EnableLine;
use super::events::EventQueue;
use super::hardware::{Halt, Hardware, LeaseReport};
use crate::lease::{Lapse, LapseCause, Lease};
use crate::verbs::Motor;
use crate::wire::message::{ALL_MOTORS, Cause, Configuration, Event, Info, LeaseState, Measures, NO_PIN, flags};
use crate::wire::orders::{Obeyed, Orders};
use crate::wire::outcome::NO_LEASE;
use crate::wire::settings::SETTINGS_LEN;
use crate::wire::{Baud, BoardSide, Encoder, MAX_MOTORS, Millis, Reason, Refusal, Stopped, Switched, Trimmed};
use crate::{Epoch, Tick32};

/// A switch must be less than this ahead, ticks: 67 s on a board with 16 MHz, 8.6 s with 125 MHz. Ticks of 32 bits are told apart within
/// 2^31; half of that leaves room for what is compared with it.
pub const MAX_SWITCH_AHEAD: u64 = 1 << 30;

/// Events that wait for the host at most.
const MAX_EVENTS: usize = 8;

/// Faults of a motor's queue, each reported once for each motor until motors are armed again.
const FAULTS: [(u8, Cause); 3] = [
    (flags::CHECK_FAILED, Cause::CheckFailed),
    (flags::BAD_ITEM, Cause::BadItem),
    (flags::STEP_MISSED, Cause::StepMissed),
];

/// What armed motors follow. Each excludes the others until motors rest or are stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Followed {
    /// A host's plan, or paths.
    Plan,
    /// Orders. Until motors are stopped or released no plan is taken.
    Orders,
    /// A motion in the flash. Until it ends only StopNow is taken.
    Baked,
}

/// A board: its hardware, and all that does not depend on it.
#[derive(Clone, Debug)]
pub struct FirmwareBoard<H: Hardware> {
    /// The hardware.
    pub hardware: H,
    /// What the board measures of itself. The main loop counts here.
    pub measures: Measures,
    orders: H::Orders,
    obeyed: Obeyed,
    enable: EnableLine,
    enable_pin: u8,
    /// The shortest interval at which each motor can start and stop, ticks.
    pull_in_ticks: [u32; MAX_MOTORS],
    armed: bool,
    followed: Followed,
    events: EventQueue<MAX_EVENTS>,
    /// Faults that were reported, by kind, bit by motor.
    reported: [u8; FAULTS.len()],
    /// Motors that were stopped while they were faster than their pull-in speed, since they were armed, bit by motor.
    uncertain: u8,
    /// Nothing moved when that was asked last.
    was_idle: bool,
    /// The tick at which the lease lapsed: noted in 64 bits before 32 bits wrap.
    lapsed_at: Option<u64>,
    last_stop: Cause,
    last_reset: Cause,
}

impl<H: Hardware> FirmwareBoard<H> {
    /// A board without configured motors. `last_reset`: why it started.
    pub fn new(hardware: H, orders: H::Orders, last_reset: Cause) -> FirmwareBoard<H> {
        FirmwareBoard {
            hardware,
            measures: Measures::default(),
            orders,
            obeyed: Obeyed::NONE,
            enable: EnableLine::OFF,
            enable_pin: NO_PIN,
            pull_in_ticks: [0; MAX_MOTORS],
            armed: false,
            followed: Followed::Plan,
            events: EventQueue::EMPTY,
            reported: [0; FAULTS.len()],
            uncertain: 0,
            was_idle: true,
            lapsed_at: None,
            last_stop: Cause::None,
            last_reset,
        }
    }

    /// Whether motors are armed.
    #[must_use]
    pub const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Whether motors follow a motion in the flash.
    #[must_use]
    pub const fn is_baked(&self) -> bool {
        matches!(self.followed, Followed::Baked)
    }

    /// Whether nothing moves, and nothing will.
    pub fn is_at_rest(&mut self) -> bool {
        !self.armed || (!self.is_baked() && self.is_idle())
    }

    /// The answer to the last orders.
    #[must_use]
    pub const fn last_orders(&self) -> Obeyed {
        self.obeyed
    }

    /// Whether nothing moves, and nothing will; the period after the last step of an order is over, too.
    fn is_idle(&mut self) -> bool {
        let now = self.hardware.now();
        self.hardware.is_idle(now) && (self.followed != Followed::Orders || self.orders.rest_at(now))
    }

    /// Refuses a host's request while motors follow a motion in the flash.
    const fn check_unbaked(&self) -> Result<(), Refusal> {
        if self.is_baked() { Err(Refusal::of(Reason::Baked)) } else { Ok(()) }
    }

    /// Refuses what only motors at rest may be asked.
    #[inline(never)]
    fn check_rest(&mut self) -> Result<(), Refusal> {
        self.check_unbaked()?;
        if self.armed && !self.is_idle() { Err(Refusal::of(Reason::Moving)) } else { Ok(()) }
    }

    /// Refuses what only armed motors may be asked.
    fn check_armed(&self) -> Result<(), Refusal> {
        self.check_unbaked()?;
        if self.armed { Ok(()) } else { Err(Refusal::of(Reason::NotArmed)) }
    }

    /// Refuses a plan while motors cannot follow one.
    fn check_takes_plans(&self) -> Result<(), Refusal> {
        self.check_armed()?;
        if self.followed == Followed::Orders { Err(Refusal::of(Reason::Obeying)) } else { Ok(()) }
    }

    fn set_enable(&mut self) {
        if self.enable_pin != NO_PIN {
            self.hardware.set_enable(self.enable_pin, self.enable.level());
        }
    }

    /// Works out the steps of orders, if motors follow some: a part of each round of the main loop.
    #[inline(always)]
    pub fn plan_orders(&mut self) {
        if self.followed == Followed::Orders {
            self.hardware.plan_orders(&mut self.orders);
        }
    }

    /// After an underrun steps would come at wrong times: stops all motors.
    #[inline(always)]
    pub fn check_underrun(&mut self) {
        if self.hardware.has_underrun() {
            self.stop_for_underrun();
        }
    }

    #[inline(never)]
    fn stop_for_underrun(&mut self) {
        self.measures.starved = self.measures.starved.saturating_add(1);
        self.stop(Cause::Starved);
    }

    /// Does what depends on time; to be called every millisecond or so. Whatever the board finds out by itself is noticed here, and becomes
    /// an event.
    pub fn supervise(&mut self, now: Millis) {
        let idle = self.update_drivers(now);
        if self.armed {
            self.report_lapse();
            self.report_faults();
            if idle && !self.was_idle {
                self.report(Cause::Finished, ALL_MOTORS, 0);
            }
            self.was_idle = idle;
        }
    }

    /// Releases drivers that have rested long enough; a part of [`supervise`](FirmwareBoard::supervise). Whether nothing moves, and nothing will.
    pub fn update_drivers(&mut self, now: Millis) -> bool {
        let idle = self.is_idle();
        if self.enable.update(now, idle) {
            self.set_enable();
            // While motors are armed their plan releases coils, at its tick.
            if idle && !self.armed {
                self.hardware.release_coils();
            }
        }
        idle
    }

    /// Reports that the lease lapsed in motion, once its tick is past.
    fn report_lapse(&mut self) {
        let LeaseReport { lapse, was_moving, at_fault, .. } = self.hardware.lease();
        let Some(lapse) = lapse else {
            self.lapsed_at = None;
            return;
        };
        if self.lapsed_at.is_some() || Tick32::of(self.hardware.now()).is_before(lapse.at) {
            return;
        }
        self.lapsed_at = Some(self.hardware.widen(lapse.at));
        let is_fault = lapse.cause.is_fault();
        if !is_fault && !was_moving {
            // At rest this is `Finished`.
            return;
        }
        self.last_stop = lapse.cause.into();
        // `report_faults` reports faults of queues, for each motor.
        if !is_fault || lapse.cause == LapseCause::Underrun {
            self.report(lapse.cause.into(), if is_fault { at_fault } else { ALL_MOTORS }, 0);
        }
    }

    /// Reports what queues asked for that could not be done.
    fn report_faults(&mut self) {
        for motor in 0..self.hardware.motors() {
            let faults = self.hardware.faults(motor);
            for (kind, (flag, cause)) in FAULTS.into_iter().enumerate() {
                if faults & flag != 0 && self.reported[kind] & 1 << motor == 0 {
                    self.reported[kind] |= 1 << motor;
                    self.report(cause, motor, 0);
                }
            }
        }
    }

    /// Has an event sent to the host. Causes that end a lease have its tick, others that of now.
    #[inline(never)]
    pub fn report(&mut self, cause: Cause, motor: u8, detail: u32) {
        let now = self.hardware.now();
        let tick = self.lapsed_at.filter(|_| cause.lapse().is_some()).unwrap_or(now);
        // A lost host or a lapsed lease is the better reason for the same end.
        if cause == Cause::Finished && self.last_stop == Cause::None {
            self.last_stop = cause;
        }
        self.events.push(Event { cause, motor, tick, detail });
    }

    /// The immediate stop.
    #[inline(never)]
    fn stop(&mut self, cause: Cause) -> Stopped {
        let Halt { tick, uncertain, reached } = self.hardware.stop();
        self.uncertain |= uncertain;
        if self.followed == Followed::Orders {
            self.orders.stop(|motor| reached.get(usize::from(motor)).copied().unwrap_or(0));
        }
        self.followed = Followed::Plan;
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

    /// Configures and arms the motors for a motion in the flash, and returns its epoch. Its items are pushed into the
    /// [hardware's](FirmwareBoard::hardware) queues.
    ///
    /// # Errors
    /// If they cannot be set up so.
    pub fn begin_baked(&mut self, configuration: &Configuration<'_>) -> Result<Epoch, Refusal> {
        self.configure(configuration)?;
        self.arm()?;
        self.followed = Followed::Baked;
        Ok(self.hardware.epoch().next())
    }

    /// Has all motors begin that motion at `tick`. Whether they do.
    pub fn switch_baked(&mut self, epoch: Epoch, tick: u64) -> bool {
        self.was_idle = false;
        self.hardware.switch(epoch, tick, Lease::Off, &[])
    }

    /// Whether motors still follow a motion in the flash. `fed`: all of it is in the queues.
    pub fn update_baked(&mut self, fed: bool) -> bool {
        if fed && self.is_baked() && self.is_idle() {
            self.followed = Followed::Plan;
        }
        self.is_baked()
    }

    /// The tick at which the next move is done, of those that are worked out.
    #[must_use]
    pub fn next_done(&self) -> Option<u64> {
        self.orders.next_done()
    }

    /// Whether a motor has no order left to do, and all its done moves were reported.
    #[must_use]
    pub fn is_motor_done(&self, motor: u8) -> bool {
        self.orders.motors().get(usize::from(motor)).is_none_or(|motor| motor.is_at_rest() && motor.is_reported())
    }

    /// Whether these orders would be accepted, while motors rest and follow none yet.
    ///
    /// # Errors
    /// As [`obey`](BoardSide::obey).
    pub fn check_orders(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        self.orders.begin(self.hardware.timings(), 0);
        orders.tell(&mut self.orders).map(drop)
    }

    /// Has motors that follow orders forget them; with `all` false only [those without an end](crate::verbs::Verbs::host_gone). Returns, bit by
    /// motor, which were faster than their pull-in speed.
    pub fn drop_orders(&mut self, all: bool) -> u8 {
        if self.followed != Followed::Orders {
            return 0;
        }
        let pull_in = self.pull_in_ticks;
        let uncertain =
            self.orders.host_gone(all, |motor| pull_in.get(usize::from(motor)).copied().unwrap_or(0).into());
        self.uncertain |= uncertain;
        uncertain
    }

    /// A move that is done and was not reported yet; also after motors were stopped.
    pub fn move_done(&mut self) -> Option<Event> {
        let now = self.hardware.now();
        // A motor may have run dry since the last look: then its move is not done. If none has by now, all steps up to now were made.
        self.check_underrun();
        let (motor, tick, detail) = self.orders.take_done(now)?;
        Some(Event { cause: Cause::MoveDone, motor, tick, detail })
    }

    /// Has armed motors that rest follow orders from now on.
    ///
    /// # Errors
    /// [`Reason::NotArmed`], [`Reason::Moving`].
    pub fn begin_orders(&mut self) -> Result<(), Refusal> {
        if self.followed != Followed::Orders {
            self.prepare_orders()?;
            self.follow_orders();
        }
        Ok(())
    }

    /// Prepares orders for motors that rest and follow none yet. The motors themselves do not change.
    #[inline(never)]
    fn prepare_orders(&mut self) -> Result<(), Refusal> {
        self.check_armed()?;
        if !self.is_idle() {
            return Err(Refusal::of(Reason::Moving));
        }
        let known = self.hardware.horizon() + u64::from(self.hardware.foresight());
        self.orders.begin(self.hardware.timings(), known);
        Ok(())
    }

    /// Has the motors follow orders that are [prepared](FirmwareBoard::prepare_orders).
    fn follow_orders(&mut self) {
        self.hardware.begin_orders(self.orders.known());
        self.followed = Followed::Orders;
    }
}

impl<H: Hardware> BoardSide for FirmwareBoard<H> {
    const OBEYS: bool = true;
    const STORES: bool = true;

    fn info(&mut self) -> Info {
        Info { last_stop: self.last_stop, last_reset: self.last_reset, ..self.hardware.info() }
    }

    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal> {
        self.check_rest()?;
        let layout = self.hardware.check(configuration)?;
        self.stop(Cause::None);
        (self.enable, self.enable_pin) = (EnableLine::of(configuration), configuration.enable_pin);
        self.set_enable();
        for (place, motor) in self.pull_in_ticks.iter_mut().zip(configuration.motors()) {
            *place = motor.pull_in_ticks;
        }
        self.hardware.configure(&layout, configuration);
        Ok(())
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        self.check_unbaked()?;
        if self.motors() == 0 {
            return Err(Refusal::of(Reason::NotConfigured));
        }
        if !self.armed {
            self.enable.set(true);
            self.set_enable();
            (self.armed, self.was_idle, self.last_stop) = (true, true, Cause::None);
            (self.reported, self.uncertain) = ([0; FAULTS.len()], 0);
            self.hardware.start();
        }
        Ok(())
    }

    fn release(&mut self) -> Result<(), Refusal> {
        self.check_rest()?;
        self.stop(Cause::None);
        self.enable.set(false);
        self.set_enable();
        self.hardware.release_coils();
        Ok(())
    }

    fn motors(&self) -> u8 {
        self.hardware.motors()
    }

    fn free(&self, motor: u8) -> u16 {
        self.hardware.free(motor)
    }

    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal> {
        self.check_takes_plans()?;
        let detail = u16::from(motor);
        if motor >= self.motors() {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail });
        }
        self.hardware.push(motor, epoch, packed).ok_or(Refusal { reason: Reason::Full, detail })
    }

    fn discard(&mut self, epoch: Epoch) {
        // A motion in the flash has nothing of a host's in the queues.
        if !self.is_baked() {
            self.hardware.discard(epoch);
        }
    }

    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> Result<Switched, Refusal> {
        self.check_takes_plans()?;
        let horizon = self.hardware.horizon();
        let limit = self.hardware.now() + MAX_SWITCH_AHEAD;
        let switched = if tick < horizon {
            Switched::Late { horizon }
        } else if tick >= limit {
            Switched::Early { limit }
        } else if self.hardware.switch(epoch, tick, lease, limits) {
            (self.was_idle, self.last_stop) = (false, Cause::None);
            return Ok(Switched::Accepted);
        } else {
            Switched::Full
        };
        self.hardware.discard(epoch);
        Ok(switched)
    }

    fn extend(&mut self, lease: Lease, limits: &[u8]) -> bool {
        let accepted = self.armed && self.hardware.can_extend(lease);
        if accepted {
            self.hardware.extend(lease, limits);
        }
        accepted
    }

    fn trim(&mut self, until: Tick32, bytes: &[u8]) -> Result<Trimmed, Refusal> {
        self.check_armed()?;
        let lease = Lease::Until(until);
        if !self.hardware.can_extend(Lease::Last) {
            return Ok(Trimmed::NoLease);
        }
        if !self.hardware.can_extend(lease) {
            return Ok(Trimmed::Late { horizon: self.hardware.horizon() });
        }
        if let Err(motor) = self.hardware.take_back(bytes) {
            return Ok(Trimmed::TooMany { motor });
        }
        self.hardware.extend(lease, &[]);
        Ok(Trimmed::Accepted)
    }

    fn brake(&mut self) -> u64 {
        if self.armed && self.hardware.can_extend(Lease::Last) {
            let at = Tick32::of(self.hardware.horizon());
            self.hardware.lapse_at(Lapse { at, cause: LapseCause::Ordered });
        }
        match (self.lapsed_at, self.hardware.lease().lapse) {
            (Some(at), _) => at,
            (None, Some(lapse)) => self.hardware.widen(lapse.at),
            (None, None) => NO_LEASE,
        }
    }

    fn lease(&self) -> (u8, u32) {
        let LeaseReport { lease, lapse, .. } = self.hardware.lease();
        let state = match (lease, lapse) {
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
        self.check_armed()?;
        if self.followed != Followed::Orders {
            self.prepare_orders()?;
        }
        self.obeyed = orders.tell(&mut self.orders)?;
        // Orders that are refused, or empty to ask for positions, change nothing.
        if self.followed != Followed::Orders && !orders.is_empty() {
            self.follow_orders();
        }
        self.was_idle &= self.orders.motors().iter().all(Motor::is_at_rest);
        Ok(())
    }

    fn obeyed(&self, frame: &mut Encoder<'_>) {
        self.obeyed.encode(frame);
    }

    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        self.check_unbaked()?;
        if self.armed {
            return Err(Refusal::of(Reason::Moving));
        }
        if let Some(settings) = settings {
            self.hardware.store(settings);
        }
        Ok(())
    }

    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        let stored = self.hardware.stored();
        *settings = stored.unwrap_or_default();
        stored.is_some()
    }

    fn store_is_damaged(&self) -> bool {
        self.hardware.store_is_damaged()
    }

    fn clock(&mut self) -> u64 {
        self.hardware.now()
    }

    fn flags(&self) -> u8 {
        let configured = if self.motors() > 0 { flags::CONFIGURED } else { 0 };
        let armed = if self.armed { flags::ARMED } else { 0 };
        let baked = if self.is_baked() { flags::BAKED } else { 0 };
        configured | armed | baked | if self.was_idle || !self.armed { flags::IDLE } else { 0 }
    }

    fn horizon(&mut self) -> u64 {
        self.hardware.horizon()
    }

    fn epoch(&self) -> Epoch {
        self.hardware.epoch()
    }

    fn position(&mut self, motor: u8) -> i32 {
        self.hardware.position(motor)
    }

    fn faults(&self, motor: u8) -> u8 {
        let uncertain = if self.uncertain >> motor & 1 != 0 { flags::UNCERTAIN } else { 0 };
        self.hardware.faults(motor) | uncertain
    }

    fn measures(&mut self) -> &mut Measures {
        self.hardware.measure(&mut self.measures);
        &mut self.measures
    }

    fn reset_measures(&mut self) {
        self.measures = Measures::default();
        self.hardware.reset_measures();
    }

    fn can_baud(&self, baud: Baud) -> bool {
        self.hardware.can_baud(baud)
    }

    fn set_baud(&mut self, baud: Baud) {
        self.hardware.set_baud(baud);
    }

    fn rate_fell_back(&mut self) {
        self.report(Cause::BaudFellBack, ALL_MOTORS, 0);
    }

    fn host_gone(&mut self, lost: bool) {
        if lost && self.armed && !self.was_idle && !self.is_baked() {
            self.last_stop = Cause::HostLost;
        }
        self.drop_orders(lost);
        // The events were for that host.
        self.events = EventQueue::EMPTY;
        self.orders.mute_moves();
    }

    fn event(&mut self) -> Option<Event> {
        // Done moves come before the event that all is finished.
        self.move_done().or_else(|| self.events.pop())
    }
}
