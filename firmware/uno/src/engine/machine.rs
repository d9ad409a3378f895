//! The board's side of the wire protocol: what its [`Service`](pulsetrain_core::wire::Service) asks for.

use crate::ThisProgram;
use crate::engine::clock::low_half;
use crate::engine::clock::{self, TICK_HZ};
use crate::engine::link::{self, WINDOW};
use crate::engine::link::{Receiver, Unread};
use crate::engine::memory;
use crate::engine::program::Program;
use crate::engine::regs;
use crate::engine::steps::brake::{CurrentLease, lease};
use crate::engine::steps::motor;
use crate::engine::steps::pins::{Layout, MAX_MOTORS, Pin};
use crate::engine::steps::plan_frames::answer;
use crate::engine::steps::refill;
use crate::engine::steps::stepper::{self, LONGEST, RingFault};
use crate::engine::store;
use pulsetrain_core::boards::uno;
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::frame::Tag;
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause, Configuration, Event, Info, Measures, flags, kind};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::outcome::NO_LEASE;
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Encoder, BoardSide, Millis, Reason, Refusal, Stopped, Switched};
use pulsetrain_core::{Epoch, Tick32};

/// A switch must be less than this ahead, ticks. Ticks are compared within 2^31, and pulse and set-up reach beyond a switch.
const MAX_SWITCH_AHEAD: u64 = 1 << 30;

/// Bits of [`Board::reported`], by number.
mod reported {
    /// The host asked motors to brake.
    pub(super) const BRAKE_ASKED: u8 = 6;
    /// The end of the lease was reported.
    pub(super) const LEASE_END: u8 = 7;
}

/// All of the board but the service.
pub(crate) struct Board {
    power: Power,
    armed: bool,
    pull_in: [u32; MAX_MOTORS],
    /// A baud rate to be set when the last reply is out, and whether its last byte has left the data register.
    pub(crate) baud: Option<(Baud, bool)>,
    /// Events for the host: the oldest two, [`Cause::None`] for none. What does not fit is dropped.
    events: [PendingEvent; 2],
    /// Faults that were reported, bit by motor; and bits of [`reported`].
    reported: u8,
    /// A motor had something to do when that was asked last.
    was_busy: bool,
    /// When this round of the main loop began, or the last sleep ended, modulo 2^16.
    round_start: u16,
    last_stop: Cause,
    last_reset: Cause,
    pub(crate) measures: Measures,
}

/// The enable line of the drivers.
struct Power {
    pin: Pin,
    /// Enable is active high.
    high: bool,
    /// The drivers are released after so long a rest.
    idle_ms: Option<u16>,
    on: bool,
    /// When a motor last had something to do.
    busy: Millis,
}

impl Power {
    const OFF: Power = Power { pin: Pin::NONE, high: false, idle_ms: None, on: false, busy: Millis(0) };

    fn set(&mut self, on: bool) {
        self.on = on;
        self.pin.set(on == self.high);
    }

    /// Powers the drivers while there is something to do, and `idle_ms` longer.
    fn update(&mut self, now: Millis, idle: bool) {
        if !idle {
            self.busy = now;
            if !self.on {
                self.set(true);
            }
        } else if let Some(idle_ms) = self.idle_ms
            && self.on
            && now.since(self.busy) >= idle_ms
        {
            self.set(false);
        }
    }
}

/// An event for the host.
#[derive(Clone, Copy)]
struct PendingEvent {
    cause: Cause,
    motor: u8,
    /// When. It must be reported within 2^31 ticks (two minutes).
    at: Tick32,
    detail: u32,
}

impl PendingEvent {
    const NONE: PendingEvent = PendingEvent { cause: Cause::None, motor: 0, at: Tick32(0), detail: 0 };
}

impl Board {
    /// A board without pins, not started: zeros, which take no flash. Call [`Board::begin`] before its use.
    pub(crate) const fn new() -> Board {
        Board {
            power: Power { pin: Pin::UNSET, ..Power::OFF },
            armed: false,
            pull_in: [0; MAX_MOTORS],
            baud: Some((Baud::B115200, false)),
            events: [PendingEvent::NONE; 2],
            reported: 0,
            was_busy: false,
            round_start: 0,
            last_stop: Cause::None,
            last_reset: Cause::None,
            measures: Board::NO_MEASURES,
        }
    }

    /// Starts clock and line.
    pub(crate) fn begin(&mut self, last_reset: Cause) {
        self.power.pin = Pin::NONE;
        self.baud = None;
        self.last_reset = last_reset;
        // SAFETY: main calls this once.
        unsafe { refill::lock().begin() };
        clock::start();
        refill::start();
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

    /// Lets some time pass. While motors move it does not sleep, since interrupts wake up from a sleep later.
    pub(crate) fn wait(&self) {
        // There is no line: nobody writes the head.
        let head = regs::EEARL.read();
        if self.was_busy {
            regs::watch_while_head_is(head);
        } else {
            regs::sleep_while_head_is(head);
        }
    }

    /// Waits for an interrupt, unless bytes wait already.
    #[inline(always)]
    pub(crate) fn rest(&mut self, receiver: &Receiver) {
        let idle = if self.was_busy {
            receiver.watch()
        } else {
            let before = low_half(clock::moment().0);
            // Less than 2^16 ticks: Timer0 interrupts it.
            receiver.sleep();
            low_half(clock::moment().0).wrapping_sub(before)
        };
        memory::add(&mut self.measures.idle_ticks, idle);
        self.round_start = low_half(clock::moment().0);
    }

    /// Whether a motor moved when that was asked last.
    #[inline(always)]
    pub(crate) const fn was_busy(&self) -> bool {
        self.was_busy
    }

    /// Counts a round of the main loop, which begins now.
    #[inline(always)]
    pub(crate) fn count_round(&mut self, now: Tick32) {
        let now = low_half(now.0);
        let round = now.wrapping_sub(self.round_start);
        if round > self.measures.longest_round_ticks {
            self.measures.longest_round_ticks = round;
        }
        self.round_start = now;
        memory::add(&mut self.measures.rounds, 1);
    }

    /// Notes how many bytes wait to be read, and how many were lost.
    #[inline(always)]
    pub(crate) fn note(&mut self, unread: &Unread) {
        let bytes = u16::from(unread.bytes);
        if bytes > self.measures.most_unread {
            self.measures.most_unread = bytes;
        }
        if unread.lost != 0 {
            self.overrun(unread.lost);
        }
    }

    #[inline(never)]
    fn overrun(&mut self, lost: u8) {
        self.measures.lost_bytes = self.measures.lost_bytes.saturating_add(u16::from(lost));
        self.report(Cause::Overrun, ALL_MOTORS, u32::from(lost));
    }

    /// What can wait a millisecond. A new baud rate is set here, when the last reply is out.
    #[inline(never)]
    pub(crate) fn housekeeping(&mut self, now: Millis, receiver: &mut Receiver) {
        match self.baud {
            // The last byte has gone from the data register into the shift register by now. A round later it is out.
            Some((baud, false)) if link::can_send() => self.baud = Some((baud, true)),
            Some((baud, true)) => {
                self.baud = None;
                link::set_baud(baud);
                receiver.reset();
            }
            _ => {}
        }
        self.supervise(now, true);
    }

    /// Supervises motors and drivers, every millisecond or so. `over`: no steps wait elsewhere.
    #[inline(always)]
    pub(crate) fn supervise(&mut self, now: Millis, over: bool) {
        refill::run_now();
        let mut stepper = refill::lock();
        let moment = clock::moment();
        if self.armed {
            stepper.watch(moment);
            drop(stepper);
            self.report_ring_faults();
            self.report_motor_faults();
        } else {
            stepper.rest(moment);
        }
        // Drivers of motors that were stopped are released after a while, too.
        let idle = over && self.rests();
        self.power.update(now, idle);
        if idle && self.was_busy {
            self.report(Cause::Finished, ALL_MOTORS, 0);
        }
        self.was_busy = !idle;
    }

    /// Reports what went wrong in the rings.
    #[inline(never)]
    fn report_ring_faults(&mut self) {
        let fault = refill::lock().take_fault();
        if let Some(fault) = fault {
            match fault {
                RingFault::Late { ticks } => {
                    self.measures.late = self.measures.late.saturating_add(1);
                    self.measures.latest_ticks = self.measures.latest_ticks.max(ticks);
                    // Two events are kept until they are reported: leave one for the cause of a stop.
                    if self.events[0].cause == Cause::None {
                        self.report(Cause::EdgeLate, ALL_MOTORS, u32::from(ticks));
                    }
                }
                RingFault::Underrun => {
                    self.measures.starved = self.measures.starved.saturating_add(1);
                    self.stop(Cause::Starved, ALL_MOTORS, 0);
                }
            }
        }
    }

    /// Reports what went wrong in a motor's queue, and the end of the lease.
    #[inline(never)]
    fn report_motor_faults(&mut self) {
        let lease = if ThisProgram::LEASES { refill::lock().lease() } else { CurrentLease::OFF };
        for motor in 0..self.motors() {
            let fault = refill::lock().motor_mut(motor).and_then(|motor| motor.fault());
            let Some(fault) = fault else { continue };
            let cause = match fault.kind {
                motor::FaultKind::Missed => Cause::StepMissed,
                motor::FaultKind::Mismatch => Cause::CheckFailed,
                motor::FaultKind::Bad => Cause::BadItem,
                motor::FaultKind::Underrun => Cause::RanDry,
            };
            if self.reported & 1 << motor == 0 {
                self.reported |= 1 << motor;
                if lease.state == lease::OFF {
                    self.report(cause, motor, fault.tick.0);
                } else {
                    self.reported |= 1 << reported::LEASE_END;
                    self.report_at(lease.at, cause, motor, 0);
                }
            }
        }
        if !ThisProgram::LEASES || lease.state != lease::LAPSED {
            // Another lease has begun: what happens from now on is reported.
            if ThisProgram::LEASES && lease.state != lease::OFF {
                self.reported = 0;
            }
        } else if lease.moved != 0 && self.reported & 1 << reported::LEASE_END == 0 {
            let cause = if self.reported & 1 << reported::BRAKE_ASKED != 0 { Cause::Braked } else { Cause::Lapsed };
            self.reported |= 1 << reported::LEASE_END;
            self.report_at(lease.at, cause, ALL_MOTORS, 0);
        }
    }

    /// The immediate stop. Gives, bit by motor, whether it was faster than it can stop at once.
    #[inline(never)]
    fn stop(&mut self, cause: Cause, motor: u8, detail: u32) -> Stopped {
        let uncertain = refill::lock().stop(&self.pull_in);
        ThisProgram::stop(cause == Cause::Starved);
        self.was_busy = false;
        if self.armed {
            self.armed = false;
            if cause != Cause::None {
                self.last_stop = cause;
            }
            if cause != Cause::StopNow {
                self.report(cause, motor, detail);
            }
        }
        Stopped { tick: extended(refill::lock().halted()), uncertain }
    }

    /// Applies a configuration that was checked.
    #[inline(never)]
    fn apply(&mut self, layout: &Layout, configuration: &Configuration<'_>) {
        self.power.pin.float();
        let high = configuration.enable_high;
        layout.enable.drive(!high);
        self.power = Power { pin: layout.enable, high, idle_ms: configuration.idle_ms, ..Power::OFF };
        for (place, motor) in self.pull_in.iter_mut().zip(configuration.motors()) {
            *place = motor.pull_in_ticks;
        }
        refill::lock().configure(layout, configuration, clock::moment());
    }

    #[inline(never)]
    fn report(&mut self, cause: Cause, motor: u8, detail: u32) {
        self.report_at(clock::moment(), cause, motor, detail);
    }

    #[inline(never)]
    fn report_at(&mut self, at: Tick32, cause: Cause, motor: u8, detail: u32) {
        // If the host was lost before, that stays the cause.
        if cause == Cause::Finished && self.last_stop != Cause::HostLost {
            self.last_stop = cause;
        }
        if let Some(place) = self.events.iter_mut().find(|event| event.cause == Cause::None) {
            *place = PendingEvent { cause, motor, at, detail };
        }
    }

    #[inline(never)]
    fn is_idle(&self) -> bool {
        // The program first: it notes which moves are done.
        ThisProgram::rest() && refill::lock().is_idle()
    }

    /// Whether the motors are powered, or were before they stopped by themselves.
    #[inline(always)]
    pub(crate) fn is_armed(&self) -> bool {
        self.armed
    }

    /// Whether no motor moves.
    #[inline(never)]
    pub(crate) fn rests(&self) -> bool {
        !self.armed || self.is_idle()
    }
}

/// A tick within 2^31 ticks of now, in 64 bits.
#[inline(never)]
pub(crate) fn extended(moment: Tick32) -> u64 {
    let now = clock::now();
    let ahead = moment.since(Tick32::of(now)).cast_signed();
    now.wrapping_add_signed(i64::from(ahead))
}

/// A tick of the past in 64 bits, if it was less than 2^32 ticks ago.
// Not inlined, so that its stack is not added to its caller's.
#[inline(never)]
fn past(moment: Tick32) -> u64 {
    let now = clock::now();
    now - u64::from(Tick32::of(now).since(moment))
}

impl BoardSide for Board {
    const PLANS: bool = ThisProgram::PLANS;
    const OBEYS: bool = ThisProgram::OBEYS;
    const STORES: bool = true;

    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        if self.armed {
            return Err(Refusal::of(Reason::Moving));
        }
        if let Some(settings) = settings {
            store::write(settings);
        }
        Ok(())
    }

    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        store::read(settings)
    }

    #[inline(always)]
    fn info(&mut self) -> Info {
        Info {
            nonce: 0,
            tag: Tag::NONE,
            board: uno::NUMBER,
            firmware: [0, 2, 0],
            tick_hz: TICK_HZ,
            fraction_bits: uno::REGISTERS.fraction_bits as u8,
            max_motors: MAX_MOTORS as u8,
            pool: if ThisProgram::PLANS { memory::POOL as u16 } else { 0 },
            max_body: 0,
            image: ThisProgram::IMAGE,
            window: WINDOW,
            bauds: 0b1_1111,
            last_stop: self.last_stop,
            last_reset: self.last_reset,
        }
    }

    #[inline(never)]
    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal> {
        if !self.rests() {
            return Err(Refusal::of(Reason::Moving));
        }
        let Configuration { pulse_ticks, setup_ticks, hold_ticks, .. } = *configuration;
        if pulse_ticks.max(setup_ticks).max(hold_ticks) > LONGEST {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST });
        }
        let mut layout = Layout::of(configuration)?;
        if layout.is_shared() && !ThisProgram::SHARED {
            return Err(Refusal::of(Reason::SharedDir));
        }
        layout.part(configuration.motors().len() as u8, pulse_ticks);
        self.stop(Cause::None, ALL_MOTORS, 0);
        self.apply(&layout, configuration);
        ThisProgram::set_up(configuration);
        Ok(())
    }

    #[inline(never)]
    fn arm(&mut self) -> Result<(), Refusal> {
        if self.motors() == 0 {
            return Err(Refusal::of(Reason::NotConfigured));
        }
        if !self.armed {
            self.power.set(true);
            self.armed = true;
            self.last_stop = Cause::None;
            self.reported = 0;
            refill::lock().start(clock::moment());
        }
        Ok(())
    }

    #[inline(never)]
    fn release(&mut self) -> Result<(), Refusal> {
        if !self.rests() {
            return Err(Refusal::of(Reason::Moving));
        }
        self.stop(Cause::None, ALL_MOTORS, 0);
        self.events = [PendingEvent::NONE; 2];
        self.power.set(false);
        Ok(())
    }

    fn motors(&self) -> u8 {
        refill::lock().count()
    }

    fn free(&self, motor: u8) -> u16 {
        refill::lock().motor(motor).map_or(0, |motor| motor.room())
    }

    #[inline(never)]
    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if ThisProgram::is_obeying() {
            return Err(Refusal::of(Reason::Obeying));
        }
        let detail = u16::from(motor);
        let full = Refusal { reason: Reason::Full, detail };
        let len = packed.len() as u16;
        let mut stepper = refill::lock();
        let Some(axis) = stepper.motor_mut(motor) else {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail });
        };
        if ThisProgram::LEASES && axis.drops(epoch) {
            return Ok(());
        }
        let room = axis.push(epoch, len).ok_or(full)?;
        drop(stepper);
        // The refill may run meanwhile: it takes bytes from the other end.
        room.write(packed);
        if let Some(axis) = refill::lock().motor_mut(motor) {
            axis.pushed(epoch, len);
        }
        Ok(())
    }

    fn discard(&mut self, epoch: Epoch) {
        refill::lock().discard(epoch);
    }

    // For the motion in the flash: it has no lease, and no frame begins one.
    #[inline(never)]
    fn switch(&mut self, epoch: Epoch, tick: u64, _: Lease, _: &[u8]) -> Result<Switched, Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if ThisProgram::is_obeying() {
            return Err(Refusal::of(Reason::Obeying));
        }
        let mut stepper = refill::lock();
        let limit = clock::now() + MAX_SWITCH_AHEAD;
        let horizon = extended(stepper.horizon());
        let switched = if tick < horizon {
            Switched::Late { horizon }
        } else if tick >= limit {
            Switched::Early { limit }
        } else if stepper.switch(epoch, Tick32::of(tick)) {
            Switched::Accepted
        } else {
            Switched::Full
        };
        if switched != Switched::Accepted {
            stepper.discard(epoch);
        }
        Ok(switched)
    }

    fn obey_plan(&mut self, kind: u8, payload: &[u8], code: &mut u8, tick: &mut [u8; 8]) -> Result<bool, Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        let mut stepper = refill::lock();
        let (answer, moment) = stepper.obey_plan_frame(kind, payload);
        // A repeated Extend does not change the last answer.
        if kind == kind::EXTEND && answer != answer::MALFORMED {
            return Ok(answer == answer::ACCEPTED);
        }
        *code = answer & !answer::MOMENT;
        let at = if answer & answer::MOMENT != 0 { extended(moment) } else { u64::from(moment.0) };
        *tick = at.to_le_bytes();
        if *code == answer::MALFORMED {
            return Err(Refusal::of(Reason::Malformed));
        }
        if kind == kind::BRAKE {
            self.reported |= 1 << reported::BRAKE_ASKED;
            if *code != answer::ACCEPTED {
                *tick = NO_LEASE.to_le_bytes();
            }
        } else if kind == kind::SWITCH
            && *code != answer::ACCEPTED
            && let Some(epoch) = payload.first()
        {
            stepper.discard(Epoch(*epoch));
        }
        Ok(*code == answer::ACCEPTED)
    }

    fn lease(&self) -> (u8, u32) {
        if !ThisProgram::LEASES {
            return (lease::OFF, 0);
        }
        let lease = refill::lock().lease();
        (lease.state, lease.at.0)
    }

    fn stop_now(&mut self) -> Stopped {
        self.stop(Cause::StopNow, ALL_MOTORS, 0)
    }

    #[inline(always)]
    fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if ThisProgram::is_obeying() {
            return ThisProgram::obey(orders);
        }
        if !self.is_idle() || !refill::lock().is_empty() {
            return Err(Refusal::of(Reason::Moving));
        }
        ThisProgram::begin(orders)
    }

    #[inline(always)]
    fn obeyed(&self, frame: &mut Encoder<'_>) {
        ThisProgram::encode_obeyed(frame);
    }

    #[inline(always)]
    fn clock(&mut self) -> u64 {
        clock::now()
    }

    fn flags(&self) -> u8 {
        let mut all = 0;
        if self.is_idle() {
            all |= flags::IDLE;
        }
        if self.motors() != 0 {
            all |= flags::CONFIGURED;
        }
        if self.armed {
            all |= flags::ARMED;
        }
        all
    }

    #[inline(never)]
    fn horizon(&mut self) -> u64 {
        let horizon = refill::lock().horizon();
        extended(horizon)
    }

    fn epoch(&self) -> Epoch {
        refill::lock().epoch()
    }

    #[inline(never)]
    fn position(&mut self, motor: u8) -> i32 {
        refill::run_now();
        let stepper = refill::lock();
        stepper.position(motor, stepper.tail_of(motor))
    }

    fn faults(&self, motor: u8) -> u8 {
        refill::lock().motor(motor).map_or(0, stepper::faults)
    }

    #[inline(never)]
    fn measures(&mut self) -> &mut Measures {
        self.measures.least_ahead_ticks = refill::lock().least_ahead();
        self.measures.stack_left = memory::stack_left();
        &mut self.measures
    }

    fn reset_measures(&mut self) {
        self.measures = Board::NO_MEASURES;
        refill::lock().reset_measures();
    }

    fn can_baud(&self, _: Baud) -> bool {
        true
    }

    fn set_baud(&mut self, baud: Baud) {
        self.baud = Some((baud, false));
    }

    fn rate_fell_back(&mut self) {
        self.report(Cause::BaudFellBack, ALL_MOTORS, 0);
    }

    fn host_gone(&mut self, lost: bool) {
        if lost && !self.rests() {
            self.last_stop = Cause::HostLost;
        }
        if ThisProgram::is_obeying() {
            if lost {
                self.stop(Cause::None, ALL_MOTORS, 0);
            } else {
                ThisProgram::host_left();
            }
        }
    }

    #[inline(never)]
    fn event(&mut self) -> Option<Event> {
        // A move that is done is reported before the motors' rest.
        if let Some((motor, at, detail)) = ThisProgram::take_done() {
            return Some(Event { cause: Cause::MoveDone, motor, tick: past(at), detail });
        }
        let [PendingEvent { cause, motor, at, detail }, second] = self.events;
        if cause == Cause::None {
            return None;
        }
        self.events = [second, PendingEvent::NONE];
        Some(Event { cause, motor, tick: extended(at), detail })
    }
}
