//! What the [`Service`](pulsetrain_core::wire::Service) asks of a board, done on this one.

use crate::Uses;
use crate::engine::clock::low_half;
use crate::engine::clock::{self, TICK_HZ};
use crate::engine::link::{self, WINDOW};
use crate::engine::link::{Receiver, Unread};
use crate::engine::memory;
use crate::engine::program::Program;
use crate::engine::regs;
use crate::engine::steps::brake::{Lease, lease};
use crate::engine::steps::motor;
use crate::engine::steps::orders::answer;
use crate::engine::steps::pins::{Layout, MAX_MOTORS, Pin};
use crate::engine::steps::stepper::{self, LONGEST, Trouble};
use crate::engine::steps::task;
use crate::engine::store;
use pulsetrain_core::lease::Lease as CoreLease;
use pulsetrain_core::wire::frame::Tag;
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause, Configuration, Event, Info, Measures, flags, kind};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::outcome::NO_LEASE;
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Encoder, Machine, Millis, Reason, Refusal, Stopped, Switched};
use pulsetrain_core::{Epoch, Tick32};

/// A switch must be less than this ahead, ticks: moments are told apart within 2^31, and pulse and set-up reach beyond.
const SWITCH_AHEAD: u64 = 1 << 30;

/// Bits of [`Board::told`], by number.
mod told {
    /// The host asked motors to brake.
    pub(super) const ORDERED: u8 = 6;
    /// That the lease is over was told.
    pub(super) const LAPSE: u8 = 7;
}

/// Everything but the service that speaks for it.
pub(crate) struct Board {
    power: Power,
    armed: bool,
    pull_in: [u32; MAX_MOTORS],
    /// To be set when the line is quiet; whether the last byte is on its way.
    pub(crate) baud: Option<(Baud, bool)>,
    /// What the host has not been told yet: the oldest two, [`Cause::None`] for none; what does not fit is dropped.
    news: [News; 2],
    /// Faults that were told, bit by motor; and bits of [`told`].
    told: u8,
    /// Something was to be done when that was looked at last.
    was_busy: bool,
    /// When the round being made began, or the last rest ended, modulo 2^16.
    woken: u16,
    last_stop: Cause,
    last_reset: Cause,
    pub(crate) measures: Measures,
}

/// The enable line of the drivers.
struct Power {
    pin: Pin,
    /// Enable is active high.
    high: bool,
    /// Rest after which the drivers are released.
    idle_ms: Option<u16>,
    on: bool,
    /// When something was last to be done.
    busy: Millis,
}

impl Power {
    const OFF: Power = Power { pin: Pin::NONE, high: false, idle_ms: None, on: false, busy: Millis(0) };

    fn set(&mut self, on: bool) {
        self.on = on;
        self.pin.set(on == self.high);
    }

    /// Holds while there is something to do, and `idle_ms` longer.
    fn look(&mut self, now: Millis, idle: bool) {
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

/// What the host is to be told.
#[derive(Clone, Copy)]
struct News {
    cause: Cause,
    motor: u8,
    /// When; it must be told within 2^31 ticks (two minutes).
    at: Tick32,
    detail: u32,
}

impl News {
    const NONE: News = News { cause: Cause::None, motor: 0, at: Tick32(0), detail: 0 };
}

impl Board {
    /// A board that knows no pins, not started: zeros, which take no flash. [`Board::begin`] comes before its use.
    pub(crate) const fn new() -> Board {
        Board {
            power: Power { pin: Pin::UNSET, ..Power::OFF },
            armed: false,
            pull_in: [0; MAX_MOTORS],
            baud: Some((Baud::B115200, false)),
            news: [News::NONE; 2],
            told: 0,
            was_busy: false,
            woken: 0,
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
        unsafe { task::lock().begin() };
        clock::start();
        task::start();
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

    /// Lets some time pass: while motors move without a sleep, from which interrupts wake up later.
    pub(crate) fn wait(&self) {
        // Nobody writes it here.
        let head = regs::EEARL.read();
        if self.was_busy {
            regs::watch_while_head_is(head);
        } else {
            regs::sleep_while_head_is(head);
        }
    }

    /// Waits until an interrupt comes, unless bytes wait already.
    #[inline(always)]
    pub(crate) fn rest(&mut self, receiver: &Receiver) {
        let idle = if self.was_busy {
            receiver.watch()
        } else {
            let before = low_half(clock::moment().0);
            // Not for 2^16 ticks: Timer0 interrupts it.
            receiver.sleep();
            low_half(clock::moment().0).wrapping_sub(before)
        };
        memory::add(&mut self.measures.idle_ticks, idle);
        self.woken = low_half(clock::moment().0);
    }

    /// Whether a motor moved when it was looked for last.
    #[inline(always)]
    pub(crate) const fn was_busy(&self) -> bool {
        self.was_busy
    }

    /// Counts a round of the main loop that begins now.
    #[inline(always)]
    pub(crate) fn count_round(&mut self, now: Tick32) {
        let now = low_half(now.0);
        let round = now.wrapping_sub(self.woken);
        if round > self.measures.longest_round_ticks {
            self.measures.longest_round_ticks = round;
        }
        self.woken = now;
        memory::add(&mut self.measures.rounds, 1);
    }

    /// Notes how many bytes wait to be read, and what was lost of them.
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
        self.tell(Cause::Overrun, ALL_MOTORS, u32::from(lost));
    }

    /// What can wait a millisecond. The line's rate is changed here, when the last answer is out.
    #[inline(never)]
    pub(crate) fn housekeeping(&mut self, now: Millis, receiver: &mut Receiver) {
        match self.baud {
            // The last byte has gone from the data register into the shift register by now; out it is a round later.
            Some((baud, false)) if link::can_send() => self.baud = Some((baud, true)),
            Some((baud, true)) => {
                self.baud = None;
                link::set_baud(baud);
                receiver.reset();
            }
            _ => {}
        }
        self.look_after(now, true);
    }

    /// Looks after motors and drivers, each millisecond or so. `over`: nothing waits elsewhere that they are to do.
    #[inline(always)]
    pub(crate) fn look_after(&mut self, now: Millis, over: bool) {
        task::call();
        let mut stepper = task::lock();
        let moment = clock::moment();
        if self.armed {
            stepper.watch(moment);
            drop(stepper);
            self.look_for_faults();
            self.look_at_motors();
        } else {
            stepper.rest(moment);
        }
        // Motors that were stopped are released after a while, too.
        let idle = over && self.rests();
        self.power.look(now, idle);
        if idle && self.was_busy {
            self.tell(Cause::Finished, ALL_MOTORS, 0);
        }
        self.was_busy = !idle;
    }

    /// Tells each motor's faults, once.
    #[inline(never)]
    fn look_for_faults(&mut self) {
        let trouble = task::lock().trouble();
        if let Some(trouble) = trouble {
            match trouble {
                Trouble::Late { ticks } => {
                    self.measures.late = self.measures.late.saturating_add(1);
                    self.measures.latest_ticks = self.measures.latest_ticks.max(ticks);
                    // Two are remembered until they are told: one is left for why it stops.
                    if self.news[0].cause == Cause::None {
                        self.tell(Cause::EdgeLate, ALL_MOTORS, u32::from(ticks));
                    }
                }
                Trouble::Starved => {
                    self.measures.starved = self.measures.starved.saturating_add(1);
                    self.stop(Cause::Starved, ALL_MOTORS, 0);
                }
            }
        }
    }

    /// Tells what a motor's own queue asked for and could not be.
    #[inline(never)]
    fn look_at_motors(&mut self) {
        let lease = if Uses::LEASES { task::lock().lease() } else { Lease::OFF };
        for motor in 0..self.motors() {
            let fault = task::lock().motor_mut(motor).and_then(|motor| motor.fault());
            let Some(fault) = fault else { continue };
            let cause = match fault.reason {
                motor::Reason::Missed => Cause::StepMissed,
                motor::Reason::Mismatch => Cause::CheckFailed,
                motor::Reason::Bad => Cause::BadItem,
                motor::Reason::Dry => Cause::RanDry,
            };
            if self.told & 1 << motor == 0 {
                self.told |= 1 << motor;
                if lease.state == lease::OFF {
                    self.tell(cause, motor, fault.tick.0);
                } else {
                    self.told |= 1 << told::LAPSE;
                    self.tell_at(lease.at, cause, motor, 0);
                }
            }
        }
        if !Uses::LEASES || lease.state != lease::LAPSED {
            // What is told now is another lease's.
            if Uses::LEASES && lease.state != lease::OFF {
                self.told = 0;
            }
        } else if lease.moved != 0 && self.told & 1 << told::LAPSE == 0 {
            let cause = if self.told & 1 << told::ORDERED != 0 { Cause::Braked } else { Cause::Lapsed };
            self.told |= 1 << told::LAPSE;
            self.tell_at(lease.at, cause, ALL_MOTORS, 0);
        }
    }

    /// The immediate stop. Bit by motor: it was faster than it can stop at once.
    #[inline(never)]
    fn stop(&mut self, cause: Cause, motor: u8, detail: u32) -> Stopped {
        let uncertain = task::lock().stop(&self.pull_in);
        Uses::stop(cause == Cause::Starved);
        self.was_busy = false;
        if self.armed {
            self.armed = false;
            if cause != Cause::None {
                self.last_stop = cause;
            }
            if cause != Cause::StopNow {
                self.tell(cause, motor, detail);
            }
        }
        Stopped { tick: extended(task::lock().halted()), uncertain }
    }

    /// Takes on a configuration that is possible.
    #[inline(never)]
    fn set_up(&mut self, layout: &Layout, configuration: &Configuration<'_>) {
        self.power.pin.float();
        let high = configuration.enable_high;
        layout.enable.drive(!high);
        self.power = Power { pin: layout.enable, high, idle_ms: configuration.idle_ms, ..Power::OFF };
        for (place, motor) in self.pull_in.iter_mut().zip(configuration.motors()) {
            *place = motor.pull_in_ticks;
        }
        task::lock().configure(layout, configuration, clock::moment());
    }

    #[inline(never)]
    fn tell(&mut self, cause: Cause, motor: u8, detail: u32) {
        self.tell_at(clock::moment(), cause, motor, detail);
    }

    #[inline(never)]
    fn tell_at(&mut self, at: Tick32, cause: Cause, motor: u8, detail: u32) {
        // That a host was lost is the better reason for the same end.
        if cause == Cause::Finished && self.last_stop != Cause::HostLost {
            self.last_stop = cause;
        }
        if let Some(place) = self.news.iter_mut().find(|news| news.cause == Cause::None) {
            *place = News { cause, motor, at, detail };
        }
    }

    #[inline(never)]
    fn is_idle(&self) -> bool {
        // Verbs first: they note what is past.
        Uses::rest() && task::lock().is_idle()
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

/// A moment within 2^31 ticks of now, in 64 bits.
#[inline(never)]
pub(crate) fn extended(moment: Tick32) -> u64 {
    let now = clock::now();
    let ahead = moment.since(Tick32::of(now)).cast_signed();
    now.wrapping_add_signed(i64::from(ahead))
}

/// A moment of the past in 64 bits, if it was less than 2^32 ticks ago.
// Its stack is not its caller's.
#[inline(never)]
fn past(moment: Tick32) -> u64 {
    let now = clock::now();
    now - u64::from(Tick32::of(now).since(moment))
}

impl Machine for Board {
    const PLANS: bool = Uses::PLANS;
    const OBEYS: bool = Uses::OBEYS;
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
            board: 1,
            firmware: [0, 1, 0],
            tick_hz: TICK_HZ,
            fraction_bits: 16,
            max_motors: MAX_MOTORS as u8,
            pool: if Uses::PLANS { memory::POOL as u16 } else { 0 },
            max_body: 0,
            image: Uses::IMAGE,
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
        if layout.is_shared() && !Uses::SHARED {
            return Err(Refusal::of(Reason::SharedDir));
        }
        layout.part(configuration.motors().len() as u8, pulse_ticks);
        self.stop(Cause::None, ALL_MOTORS, 0);
        self.set_up(&layout, configuration);
        Uses::set_up(configuration);
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
            self.told = 0;
            task::lock().start(clock::moment());
        }
        Ok(())
    }

    #[inline(never)]
    fn release(&mut self) -> Result<(), Refusal> {
        if !self.rests() {
            return Err(Refusal::of(Reason::Moving));
        }
        self.stop(Cause::None, ALL_MOTORS, 0);
        self.news = [News::NONE; 2];
        self.power.set(false);
        Ok(())
    }

    fn motors(&self) -> u8 {
        task::lock().count()
    }

    fn free(&self, motor: u8) -> u16 {
        task::lock().motor(motor).map_or(0, |motor| motor.room())
    }

    #[inline(never)]
    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if Uses::is_obeying() {
            return Err(Refusal::of(Reason::Obeying));
        }
        let detail = u16::from(motor);
        let full = Refusal { reason: Reason::Full, detail };
        let len = packed.len() as u16;
        let mut stepper = task::lock();
        let Some(axis) = stepper.motor_mut(motor) else {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail });
        };
        if Uses::LEASES && axis.drops(epoch) {
            return Ok(());
        }
        let room = axis.push(epoch, len).ok_or(full)?;
        drop(stepper);
        // The task may go on meanwhile: it takes from the other end.
        room.write(packed);
        if let Some(axis) = task::lock().motor_mut(motor) {
            axis.pushed(epoch, len);
        }
        Ok(())
    }

    fn discard(&mut self, epoch: Epoch) {
        task::lock().discard(epoch);
    }

    // For the motion that lies in the flash: it has no lease, and no frame begins one.
    #[inline(never)]
    fn switch(&mut self, epoch: Epoch, tick: u64, _: CoreLease, _: &[u8]) -> Result<Switched, Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if Uses::is_obeying() {
            return Err(Refusal::of(Reason::Obeying));
        }
        let mut stepper = task::lock();
        let limit = clock::now() + SWITCH_AHEAD;
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
        let mut stepper = task::lock();
        let (answer, moment) = stepper.order(kind, payload);
        // The answer to what was asked last stays.
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
            self.told |= 1 << told::ORDERED;
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
        if !Uses::LEASES {
            return (lease::OFF, 0);
        }
        let lease = task::lock().lease();
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
        if Uses::is_obeying() {
            return Uses::obey(orders);
        }
        if !self.is_idle() || !task::lock().is_empty() {
            return Err(Refusal::of(Reason::Moving));
        }
        Uses::begin(orders)
    }

    #[inline(always)]
    fn obeyed(&self, frame: &mut Encoder<'_>) {
        Uses::encode_obeyed(frame);
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
        let horizon = task::lock().horizon();
        extended(horizon)
    }

    fn epoch(&self) -> Epoch {
        task::lock().epoch()
    }

    #[inline(never)]
    fn position(&mut self, motor: u8) -> i32 {
        task::call();
        let stepper = task::lock();
        stepper.position(motor, stepper.tail_of(motor))
    }

    fn faults(&self, motor: u8) -> u8 {
        task::lock().motor(motor).map_or(0, stepper::faults)
    }

    #[inline(never)]
    fn measures(&mut self) -> &mut Measures {
        self.measures.least_ahead_ticks = task::lock().least_ahead();
        self.measures.stack_left = memory::stack_left();
        &mut self.measures
    }

    fn reset_measures(&mut self) {
        self.measures = Board::NO_MEASURES;
        task::lock().reset_measures();
    }

    fn can_baud(&self, _: Baud) -> bool {
        true
    }

    fn set_baud(&mut self, baud: Baud) {
        self.baud = Some((baud, false));
    }

    fn rate_fell_back(&mut self) {
        self.tell(Cause::BaudFellBack, ALL_MOTORS, 0);
    }

    fn host_gone(&mut self, lost: bool) {
        if lost && !self.rests() {
            self.last_stop = Cause::HostLost;
        }
        if Uses::is_obeying() {
            if lost {
                self.stop(Cause::None, ALL_MOTORS, 0);
            } else {
                Uses::forsake();
            }
        }
    }

    #[inline(never)]
    fn event(&mut self) -> Option<Event> {
        // What was done comes before that all was.
        if let Some((motor, at, detail)) = Uses::take_done() {
            return Some(Event { cause: Cause::MoveDone, motor, tick: past(at), detail });
        }
        let [News { cause, motor, at, detail }, second] = self.news;
        if cause == Cause::None {
            return None;
        }
        self.news = [second, News::NONE];
        Some(Event { cause, motor, tick: extended(at), detail })
    }
}
