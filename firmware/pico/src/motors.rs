//! Motors for a program of one's own on the Pico, without a host: MOVE, SPEED and DIRECTION, which do not wait.
//!
//! # How it goes
//! [`Motors::begin`] sets up clocks, pins and state machines, and a timer's interrupt that works out steps and writes words for the
//! motors, up to 1.9 ms ahead. The program does what it likes meanwhile: it may compute for seconds. Steps come on their
//! ticks of 8 ns; orders take effect at the tick that [`Motors::tell`] returns.
//!
//! When a move is done, with the period after its last step, a function is called ([`Motors::on_done`]), and futures of
//! [`Motor::rests`] are ready.
//!
//! # What it uses
//! State machines and DMA channels with the motors' numbers: up to four motors leave PIO block 1 and all its state machines to the
//! program. The gate (GPIO 25), DMA interrupt 0, alarm 1 of the timer with its interrupt, and SysTick. The vectors, too: a program
//! sets handlers of its own interrupts by [`set_handler`].
//!
//! # What a program may not do
//! Delay the library's interrupts for long: by `cpsid`, or by an interrupt of its own with the same priority or a higher one.
//! - The timer's comes when some motor has words left for 0.35 ms, and 0.05 ms more for each motor that there is. It has to write
//!   more for all motors before those are used up. So it may be delayed for that time, less what its own round takes: for 0.25 ms
//!   at the shortest periods, also as all motors begin at once (with eight 0.2 ms); with one motor 0.3 ms; with four 0.35 ms at
//!   25 000 steps/s; with eight 0.3 ms at 62 500. What [`Motors::on_done`] calls takes of the same, and so do orders, which delay it.
//! - The DMA's hands words over when only the eight words of a FIFO are left: eight steps, or fewer where a motor turns.
//!   So it may be delayed for seven of the shortest periods in use: 17 µs at 400 000 steps/s, 7 µs at a million. That is what
//!   an interrupt of the highest priority may take at most, which all have after a reset; one that takes longer needs a lower one
//!   (0x40, 0x80 or 0xc0 in the NVIC's IPR; the timer's has 0xc0).
//!
//! If a program delays them for longer, a motor runs dry. Then all motors stop at once, without ramps, and count the steps that
//! they made; moves that were done before are reported, the one under way is not. From then on [`Motors::tell`] and
//! [`Motor::rests`] say [`NotArmed`](Reason::NotArmed), until [`Motors::arm`] begins again.
//!
//! # What is not
//! Ramps: a motor has a new speed from its next step on. Motors for the other core, or for a program's own interrupts: neither can
//! have [`Motors`].

use crate::board::Board;
use crate::clock::{self, TICK_HZ};
use crate::regs;
use crate::start::{self, Shared};
use crate::steps::MOTORS;
use crate::steps::stepper::FillTiming;
use core::future::Future;
use core::marker::PhantomData;
use core::pin::{Pin, pin};
use core::sync::atomic::{Ordering, compiler_fence};
use core::task::{Context, Poll, Waker};
use pulsetrain_core::wire::BoardSide;
use pulsetrain_core::wire::message::{Configuration, Event, MOTOR_SETUP_LEN, NO_PIN};
use pulsetrain_core::wire::orders::{MAX_ORDERS, ORDER_LEN, Orders, order};

pub use pulsetrain_core::output::Sequence;
pub use pulsetrain_core::verbs::{Heading, Verb};
pub use pulsetrain_core::wire::message::{MotorSetup, Reason};
pub use pulsetrain_core::wire::orders::Obeyed;
pub use pulsetrain_core::wire::{Refusal, Stopped};

/// Ticks a second: a tick is 8 ns.
pub const TICKS_PER_S: u32 = TICK_HZ;

/// The timer's interrupt comes after so long at most, µs: before the words that are written for rest, 1.8 ms, are used up.
const LONGEST_ROUND_US: u32 = 1400;

/// And after so long at least, µs: an alarm that is already past when it is set would come after 72 min.
const SHORTEST_ROUND_US: u32 = 5;

/// Futures that can wait for one motor. Of more, the oldest is woken too early, finds its motor moving, and waits again.
const WAKERS_PER_MOTOR: usize = 4;

/// Times that hold for all motors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// How long STEP is active, ticks, at most 62 500.
    pub pulse_ticks: u16,
    /// DIR changes at least so long before a step, ticks, at most 62 500.
    pub setup_ticks: u16,
    /// DIR stays at least so long after a pulse, ticks, at most 62 500.
    pub hold_ticks: u16,
    /// Coils are released after they have rested so long, ms, at most 8000; `None`: they hold.
    pub release_ms: Option<u16>,
    /// The pin that enables all drivers, and whether it is active high.
    pub enable: Option<(u8, bool)>,
}

impl Default for Times {
    /// Pulses of 2 µs, DIR 5 µs before and 2 µs after; coils hold; no pin enables drivers.
    fn default() -> Times {
        Times { pulse_ticks: 250, setup_ticks: 625, hold_ticks: 250, release_ms: None, enable: None }
    }
}

/// A move that is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Done {
    /// The motor, counted from 0.
    pub motor: u8,
    /// When the last step's period was over, ticks.
    pub tick: u64,
    /// How many of the motor's moves are done by then, wrapping.
    pub number: u32,
}

/// What main and the timer's interrupt share.
struct State {
    board: Board,
    on_done: Option<fn(Motors, Done)>,
    wakers: [[Option<Waker>; WAKERS_PER_MOTOR]; MOTORS],
    /// How often motors were armed, wrapping.
    armings: u32,
}

static STATE: Shared<Option<State>> = Shared::new(None);

/// Calls `f` with the state, while the timer's interrupt is disabled; the DMA's is not.
fn with<T>(f: impl FnOnce(&mut State) -> T) -> T {
    regs::NVIC_ICER.write(regs::TIMER_IRQ_1);
    regs::barrier();
    // SAFETY: only main and the timer's interrupt call this, on one core, as nobody else can have a `Motors`. The interrupt is
    // disabled, or it is the caller. No `f` in this file calls `with`, nor any code of the program's.
    let done = unsafe {
        STATE.with(|state| match state {
            Some(state) => f(state),
            // There is no `Motors` before the state is there.
            None => panic!(),
        })
    };
    // What `f` wrote must be in memory before the interrupt comes.
    compiler_fence(Ordering::SeqCst);
    regs::NVIC_ISER.write(regs::TIMER_IRQ_1);
    done
}

/// The timer's interrupt: writes words for the motors, and reports done moves.
extern "C" fn timer_interrupt() {
    // Alarm 1's bit, of what was raised.
    regs::TIMER_INTR.write(1 << 1);
    let motors = with(|state| {
        while state.board.fill_motors() {}
        let now = clock::millis(state.board.now());
        state.board.update_drivers(now);
        Motors::of(state.board.motors())
    });
    while let Some(done) = with(State::take_done) {
        // Outside of `with`, as it may give motors new orders.
        if let Some(on_done) = with(|state| state.on_done) {
            on_done(motors, done);
        }
        wake(done.motor);
    }
    if !motors.is_armed() {
        (0..motors.count).for_each(wake);
    }
    let us = with(State::spare_us);
    // With interrupts off, so that nothing comes between: an alarm that is set too late comes after 72 min.
    regs::interrupt_free(|| regs::TIMER_ALARM1.write(regs::TIMER_RAW.read().wrapping_add(us)));
}

/// Wakes the futures that wait for a motor. Outside of `with`, as wakers are the executor's code.
fn wake(motor: u8) {
    with(|state| state.wakers.get_mut(usize::from(motor)).map(core::mem::take))
        .into_iter()
        .flatten()
        .flatten()
        .for_each(Waker::wake);
}

impl State {
    /// How long there is nothing to do, µs.
    fn spare_us(&mut self) -> u32 {
        let now = self.board.now();
        let done = self.board.next_done().map_or(u64::MAX, |done| done.saturating_sub(now));
        let done = u32::try_from(done).map_or(LONGEST_ROUND_US, clock::us);
        // 2 µs later, so that the period of the move is over by then.
        (self.board.spare_us().min(done) + 2).clamp(SHORTEST_ROUND_US, LONGEST_ROUND_US)
    }

    fn take_done(&mut self) -> Option<Done> {
        let Event { motor, tick, detail, .. } = self.board.move_done()?;
        Some(Done { motor, tick, number: detail })
    }

    /// Arms the motors. They rest, and follow verbs from then on.
    fn arm(&mut self) -> Result<(), Refusal> {
        self.board.arm()?;
        // Words are written from now on, for rest until there are orders.
        self.board.begin_orders()?;
        self.armings = self.armings.wrapping_add(1);
        Ok(())
    }

    /// The outcome of waiting for a motor since that arming. `None`: it still moves.
    fn rest_outcome(&self, motor: u8, arming: u32) -> Option<Result<(), Refusal>> {
        if !self.board.is_armed() || self.armings != arming {
            return Some(Err(Refusal::of(Reason::NotArmed)));
        }
        self.board.is_motor_done(motor).then_some(Ok(()))
    }

    /// Keeps a waker, unless it is kept already. If there was no room, `waker` is then the one that has waited for longest, and the
    /// result is true.
    fn keep_waker(&mut self, motor: u8, waker: &mut Option<Waker>) -> bool {
        let Some(places) = self.wakers.get_mut(usize::from(motor)) else { return false };
        if places.iter().flatten().any(|kept| waker.as_ref().is_some_and(|waker| waker.will_wake(kept))) {
            return false;
        }
        // The newest is last.
        places.rotate_left(1);
        core::mem::swap(&mut places[WAKERS_PER_MOTOR - 1], waker);
        waker.is_some()
    }
}

/// All motors. It can be used on the core that set them up, in main and in [`on_done`](Motors::on_done), and cannot be sent
/// elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct Motors {
    count: u8,
    here: NotSend,
}

/// Keeps a type from being sent to another core, or to an interrupt.
type NotSend = PhantomData<*const ()>;

/// Does not compile if `Motors` can be sent: then there are two `is_sent`.
const _: fn() = {
    trait Sent<A> {
        fn is_sent() {}
    }
    impl<T> Sent<()> for T {}
    impl<T: Send> Sent<u8> for T {}
    <Motors as Sent<_>>::is_sent
};

impl Motors {
    /// Sets up the chip at 125 MHz and the motors, and enables their drivers. Nothing moves.
    ///
    /// # Errors
    /// When a Pico cannot do it: see [`Reason`]; [`Reason::TooManyMotors`] with more than 8.
    ///
    /// # Safety
    /// Only once, in main, on core 0, and before other parts of the chip are set up. Nothing else changes what the [module](self)
    /// uses.
    pub unsafe fn begin(motors: &[MotorSetup], times: Times) -> Result<Motors, Refusal> {
        let mut bytes = [0; MOTORS * MOTOR_SETUP_LEN];
        let too_many = Refusal { reason: Reason::TooManyMotors, detail: MOTORS as u16 };
        let bytes = bytes.get_mut(..motors.len() * MOTOR_SETUP_LEN).ok_or(too_many)?;
        for (place, motor) in bytes.chunks_exact_mut(MOTOR_SETUP_LEN).zip(motors) {
            place.copy_from_slice(&motor.to_bytes());
        }
        let mut configuration = Configuration::new(bytes).ok_or(too_many)?;
        configuration.pulse_ticks = times.pulse_ticks;
        configuration.setup_ticks = times.setup_ticks;
        configuration.hold_ticks = times.hold_ticks;
        configuration.idle_ms = times.release_ms;
        (configuration.enable_pin, configuration.enable_high) = times.enable.unwrap_or((NO_PIN, false));
        clock::set_up();
        clock::take_pins();
        // SAFETY: the caller's promise.
        let mut board = unsafe { Board::begin() };
        board.hardware.timing = FillTiming::of_interrupt(motors.len() as u8);
        board.configure(&configuration)?;
        regs::enable_interrupts();
        let wakers = [const { [const { None }; WAKERS_PER_MOTOR] }; MOTORS];
        let mut state = State { board, on_done: None, wakers, armings: 0 };
        state.arm()?;
        // SAFETY: the interrupt is not enabled yet.
        unsafe {
            STATE.with(|place| *place = Some(state));
        }
        start::set_handler(TIMER_IRQ_1, timer_interrupt);
        // The lowest priority: after the DMA's.
        regs::NVIC_IPR0.write(0xc0 << 8);
        regs::TIMER_INTE.write(1 << 1);
        regs::TIMER_ALARM1.write(regs::TIMER_RAW.read().wrapping_add(SHORTEST_ROUND_US));
        regs::NVIC_ISER.write(regs::TIMER_IRQ_1);
        Ok(Motors::of(motors.len() as u8))
    }

    const fn of(count: u8) -> Motors {
        Motors { count, here: PhantomData }
    }

    /// A motor; `None` if there are fewer.
    #[must_use]
    pub fn motor(self, number: u8) -> Option<Motor> {
        (number < self.count).then_some(Motor { number, here: PhantomData })
    }

    /// Gives motors, by their numbers, up to eight orders. All take effect at the same tick, or none does.
    ///
    /// # Errors
    /// [`Reason::NoSuchMotor`], [`Reason::Period`], [`Reason::Busy`]; [`Reason::NotArmed`] if motors [were stopped](Motors::stop),
    /// or ran dry; [`Reason::Full`] with more than eight.
    pub fn tell(self, verbs: &[(u8, Verb)]) -> Result<Obeyed, Refusal> {
        tell(verbs)
    }

    /// Has `on_done` called for each move that is done, in the timer's interrupt, some 10 µs later. It may give motors new orders;
    /// the [module](self) says how long it may take. If it [stops](Motors::stop) them and [arms](Motors::arm) them again, it is
    /// still called for other moves that were done by then.
    pub fn on_done(self, on_done: fn(Motors, Done)) {
        with(|state| state.on_done = Some(on_done));
    }

    /// Stops all motors at once, without ramps. Returns the tick after which no step was begun, and which positions are uncertain.
    /// Their orders are forgotten, and no "done" comes for them; positions count the steps that were made; coils and drivers hold.
    pub fn stop(self) -> Stopped {
        let stopped = with(|state| state.board.stop_now());
        pend_timer_interrupt();
        stopped
    }

    /// Releases drivers and coils of motors that rest. They are not armed then.
    ///
    /// # Errors
    /// [`Reason::Moving`].
    pub fn release(self) -> Result<(), Refusal> {
        with(|state| state.board.release())?;
        pend_timer_interrupt();
        Ok(())
    }

    /// Begins again after motors were [stopped](Motors::stop) or [released](Motors::release), or ran dry: enables the drivers.
    /// Positions stay, periods and directions are as at first, moves are counted from 0. Nothing moves until there are orders. If
    /// motors are armed it does nothing.
    ///
    /// # Errors
    /// None that is known, as the motors were configured.
    pub fn arm(self) -> Result<(), Refusal> {
        with(|state| if state.board.is_armed() { Ok(()) } else { state.arm() })
    }

    /// Whether motors take orders: nothing has stopped them since [`begin`](Motors::begin) or [`arm`](Motors::arm).
    #[must_use]
    pub fn is_armed(self) -> bool {
        with(|state| state.board.is_armed())
    }

    /// The clock, ticks.
    #[must_use]
    pub fn now(self) -> u64 {
        now()
    }

    /// Sleeps until the clock is at `tick`, or up to 1.4 ms longer.
    pub fn sleep_until(self, tick: u64) {
        while now() < tick {
            regs::wait_for_interrupt();
        }
    }
}

/// Makes the timer's interrupt come now.
fn pend_timer_interrupt() {
    regs::NVIC_ISPR.write(regs::TIMER_IRQ_1);
}

fn now() -> u64 {
    with(|state| state.board.now())
}

fn tell(verbs: &[(u8, Verb)]) -> Result<Obeyed, Refusal> {
    let mut bytes = [[0; ORDER_LEN]; MAX_ORDERS];
    let full = Refusal { reason: Reason::Full, detail: MAX_ORDERS as u16 };
    let used = bytes.get_mut(..verbs.len()).ok_or(full)?;
    for (place, (motor, verb)) in used.iter_mut().zip(verbs) {
        if usize::from(*motor) >= MOTORS {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail: u16::from(*motor) });
        }
        *place = order(*motor, *verb);
    }
    let orders = Orders::decode(used.as_flattened()).ok_or(full)?;
    let obeyed = with(|state| state.board.obey(&orders).map(|()| state.board.last_orders()))?;
    // Motors that were halted rest now: futures are ready.
    for (motor, verb) in verbs {
        if *verb == Verb::Halt {
            wake(*motor);
        }
    }
    Ok(obeyed)
}

/// One motor. As [`Motors`], it cannot be sent to the other core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motor {
    number: u8,
    here: NotSend,
}

impl Motor {
    /// MOVE: makes exactly `steps` steps, then is done. One move may wait behind the one under way.
    ///
    /// # Errors
    /// [`Reason::Busy`] if one waits already.
    pub fn move_steps(self, steps: u32) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Move { steps })])
    }

    /// Makes steps without an end.
    ///
    /// # Errors
    /// [`Reason::Busy`] if a move waits behind one.
    pub fn run(self) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Run)])
    }

    /// SPEED: the period, exactly `ticks` from step to step. A period is not a velocity: see docs/pico.md.
    ///
    /// # Errors
    /// [`Reason::Period`] if it is longer than 2^62, or shorter than this motor's shortest, which is the refusal's detail.
    pub fn set_period(self, ticks: u64) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Speed { ticks })])
    }

    /// DIRECTION: forward, backward or stationary; also during a move.
    ///
    /// # Errors
    /// None but what [`Motors::tell`] says of all.
    pub fn set_direction(self, heading: Heading) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Heading(heading))])
    }

    /// Ends a move or a run, and forgets the move that waits.
    ///
    /// # Errors
    /// As [`set_direction`](Motor::set_direction).
    pub fn halt(self) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Halt)])
    }

    /// The position now: steps forward less steps backward, counted when their pulses begin, wrapping.
    #[must_use]
    pub fn position(self) -> i32 {
        with(|state| state.board.position(self.number))
    }

    /// Whether it has no order left: the last move is done, with the period after its last step, or was halted.
    #[must_use]
    pub fn is_at_rest(self) -> bool {
        with(|state| state.board.is_motor_done(self.number))
    }

    /// Waits until it [is at rest](Motor::is_at_rest).
    ///
    /// # Errors
    /// [`Reason::NotArmed`] as soon as motors are not armed, or were not at some time since this was called: the move may not be
    /// complete.
    pub fn rests(self) -> impl Future<Output = Result<(), Refusal>> {
        RestFuture { motor: self, arming: with(|state| state.armings) }
    }
}

/// The future of [`Motor::rests`].
struct RestFuture {
    motor: Motor,
    arming: u32,
}

impl Future for RestFuture {
    type Output = Result<(), Refusal>;

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        let RestFuture { motor: Motor { number, .. }, arming } = *self;
        // Cloned and dropped outside of `with`, as wakers are the executor's code.
        let mut waker = Some(context.waker().clone());
        let (waited, is_older) = with(|state| {
            let waited = state.rest_outcome(number, arming);
            (waited, waited.is_none() && state.keep_waker(number, &mut waker))
        });
        if let Some(older) = waker.filter(|_| is_older) {
            older.wake();
        }
        waited.map_or(Poll::Pending, Poll::Ready)
    }
}

/// Runs a future to its end; sleeps while it waits.
pub fn block_on<F: Future>(future: F) -> F::Output {
    let mut future = pin!(future);
    let mut context = Context::from_waker(Waker::noop());
    loop {
        if let Poll::Ready(output) = future.as_mut().poll(&mut context) {
            return output;
        }
        // The timer's interrupt ends the sleep.
        regs::wait_for_interrupt();
    }
}

/// The number of the interrupt of the timer's alarm 1.
const TIMER_IRQ_1: usize = 1;

/// The number of the chip's interrupts (§2.3.2).
const INTERRUPT_COUNT: usize = 32;

/// The interrupts that the library uses: that of the timer, and 11, the DMA's.
const TAKEN_INTERRUPTS: [usize; 2] = [TIMER_IRQ_1, 11];

/// The interrupt cannot be the program's: the library uses it, or there is none of that number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InterruptTaken {
    /// Its number.
    pub interrupt: usize,
}

/// Has `handler` called for an interrupt of the chip, by its number (RP2040 datasheet, §2.3.2): 0 to 31, but not 1 and 11. The
/// program enables it by the NVIC's ISER. An interrupt without a handler ends the program.
///
/// # Errors
/// [`InterruptTaken`]: nothing changes then.
///
/// # Safety
/// The interrupt is not enabled yet. The handler takes no longer than the [module](self) allows at its priority, and shares data
/// with other code only as Rust allows between threads. It does not enable interrupts by `cpsie` where other code has disabled
/// them.
pub unsafe fn set_handler(interrupt: usize, handler: extern "C" fn()) -> Result<(), InterruptTaken> {
    if interrupt >= INTERRUPT_COUNT || TAKEN_INTERRUPTS.contains(&interrupt) {
        return Err(InterruptTaken { interrupt });
    }
    start::set_handler(interrupt, handler);
    Ok(())
}
