//! Motors for a program of one's own on the Pico, without a host: MOVE, SPEED and DIRECTION, without waiting.
//!
//! # How it goes
//! [`Motors::begin`] sets up clocks, pins and state machines, and a timer's interrupt that works out steps and writes words for the
//! motors ahead of time, up to 1.9 ms. The program does what it likes meanwhile: it may compute for seconds. Steps come on their
//! ticks of 8 ns; what a program says holds from the tick that [`Motors::tell`] gives back.
//!
//! When a move is done, its last step's period included, a function is called ([`Motors::on_done`]), and who awaits
//! [`Motor::rests`] goes on.
//!
//! # What it takes
//! State machines and DMA channels with the motors' numbers: up to four motors leave PIO block 1 and all its state machines to the
//! program. The gate (GPIO 25), DMA interrupt 0, alarm 1 of the timer with its interrupt, and SysTick. The vectors, too: a program's
//! own interrupts come by [`set_handler`].
//!
//! # What a program may not do
//! Keep the library's interrupts out for long: by `cpsid`, or by an interrupt of its own that they wait for.
//! - The timer's comes when some motor has words left for 0.35 ms, and for 0.05 ms more for each motor that there is, and has to write
//!   more for all before they are used up. So it may be kept out for that, less what its own round takes: for 0.25 ms at the shortest
//!   periods, also as all motors begin at once (with eight 0.2 ms); with one motor 0.3 ms; with four 0.35 ms at 25 000 steps/s; with eight 0.3 ms at 62 500. What
//!   [`Motors::on_done`] calls takes of the same, and so do orders, which keep it out.
//! - The DMA's hands on what was written as soon as the eight words of a FIFO are all that is left: eight steps, or fewer at a turn.
//!   So it may be kept out for seven of the shortest periods in use: 17 µs at 400 000 steps/s, 7 µs at a million. That is what
//!   an interrupt of the highest priority may take at most, and after a reset all have that; one that takes longer needs a lower one
//!   (0x40, 0x80 or 0xc0 in the NVIC's IPR; the timer's has 0xc0).
//!
//! Who does all the same runs a motor dry: then all stop at once, without ramps, and count what they did; moves that were done
//! before are told, the one under way is not. From then on [`Motors::tell`] and [`Motor::rests`] say [`NotArmed`](Reason::NotArmed),
//! until [`Motors::arm`] begins again.
//!
//! # What is not
//! Ramps: a motor has a new speed with its next step. Motors for the other core, or for interrupts of one's own: neither can get at
//! [`Motors`].

use crate::clock::{self, TICK_HZ};
use crate::machine::Board;
use crate::regs;
use crate::start::{self, Shared};
use crate::steps::MOTORS;
use crate::steps::stepper::Pace;
use core::future::Future;
use core::marker::PhantomData;
use core::pin::{Pin, pin};
use core::sync::atomic::{Ordering, compiler_fence};
use core::task::{Context, Poll, Waker};
use pulsetrain_core::wire::Machine;
use pulsetrain_core::wire::message::{Configuration, Event, MOTOR_SETUP_LEN, NO_PIN};
use pulsetrain_core::wire::orders::{MOST_ORDERS, ORDER_LEN, Orders, order};

pub use pulsetrain_core::output::Sequence;
pub use pulsetrain_core::verbs::{Heading, Verb};
pub use pulsetrain_core::wire::message::{MotorSetup, Reason};
pub use pulsetrain_core::wire::orders::Obeyed;
pub use pulsetrain_core::wire::{Refusal, Stopped};

/// Ticks a second: a tick is 8 ns.
pub const TICKS_PER_S: u32 = TICK_HZ;

/// How often motors are looked after, at least, µs.
const ROUND_US: u32 = 1400;

/// And at most: an alarm that is not ahead comes after 72 min.
const SHORTEST_ROUND_US: u32 = 5;

/// Futures that wait for one motor; of more the oldest is woken for nothing, and waits again.
const WAITING: usize = 4;

/// Times that all motors have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Times {
    /// STEP is active so long, ticks, at most 62 500.
    pub pulse_ticks: u16,
    /// DIR is right so long before a step, ticks, at most 62 500.
    pub setup_ticks: u16,
    /// DIR stays so long after a pulse, ticks, at most 62 500.
    pub hold_ticks: u16,
    /// Coils are released after so long a rest, ms, at most 8000; `None`: they hold.
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

/// A move that was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Done {
    /// Whose, counted from 0.
    pub motor: u8,
    /// When the last step's period was over, ticks.
    pub tick: u64,
    /// The motor's moves that are done by then, wrapping.
    pub number: u32,
}

/// What main and the timer's interrupt have.
struct State {
    board: Board,
    on_done: Option<fn(Motors, Done)>,
    wakers: [[Option<Waker>; WAITING]; MOTORS],
    /// Times that motors were armed, wrapping.
    armings: u32,
}

static STATE: Shared<Option<State>> = Shared::new(None);

/// Has the state, with the interrupt kept out; the DMA's still comes.
fn with<T>(f: impl FnOnce(&mut State) -> T) -> T {
    regs::NVIC_ICER.write(regs::TIMER_IRQ_1);
    regs::settle();
    // SAFETY: only main and the timer's interrupt, on one core, call this: who else could has no `Motors`. The interrupt is kept
    // out, or it is what calls. No `f` in this file calls `with`, nor anybody else's code.
    let done = unsafe {
        STATE.with(|state| match state {
            Some(state) => f(state),
            // Nobody has a `Motors` or a `Motor` before.
            None => panic!(),
        })
    };
    // What `f` wrote is in memory before the interrupt comes.
    compiler_fence(Ordering::SeqCst);
    regs::NVIC_ISER.write(regs::TIMER_IRQ_1);
    done
}

/// The timer's interrupt: words for the motors, and what was done.
extern "C" fn look_after() {
    // Alarm 1's bit, of what was raised.
    regs::TIMER_INTR.write(1 << 1);
    let motors = with(|state| {
        while state.board.go_on() {}
        let now = clock::millis(state.board.clock.now());
        state.board.look_after(now);
        Motors::of(state.board.motors())
    });
    while let Some(done) = with(State::take_done) {
        // Outside of `with`: they may tell motors what to do next.
        if let Some(on_done) = with(|state| state.on_done) {
            on_done(motors, done);
        }
        wake(done.motor);
    }
    if !motors.is_armed() {
        (0..motors.count).for_each(wake);
    }
    let us = with(State::spare_us);
    // With nothing between: an alarm that is set for a time that is past comes after 72 min.
    regs::free(|| regs::TIMER_ALARM1.write(regs::TIMER_RAW.read().wrapping_add(us)));
}

/// Wakes who waits for a motor: that is the executor's code, so outside of `with`.
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
        let now = self.board.clock.now();
        let done = self.board.next_done().map_or(u64::MAX, |done| done.saturating_sub(now));
        let done = u32::try_from(done).map_or(ROUND_US, clock::us);
        // A little later, so that it is over.
        (self.board.spare_us().min(done) + 2).clamp(SHORTEST_ROUND_US, ROUND_US)
    }

    fn take_done(&mut self) -> Option<Done> {
        let Event { motor, tick, detail, .. } = self.board.move_done()?;
        Some(Done { motor, tick, number: detail })
    }

    /// Arms the motors, which rest and are told directly from then on.
    fn arm(&mut self) -> Result<(), Refusal> {
        self.board.arm()?;
        // Words are written from now on; nothing is told.
        self.board.begin_verbs()?;
        self.armings = self.armings.wrapping_add(1);
        Ok(())
    }

    /// How waiting for a motor ends that was begun at that arming; `None`: it does not yet.
    fn waited(&self, motor: u8, arming: u32) -> Option<Result<(), Refusal>> {
        if !self.board.is_armed() || self.armings != arming {
            return Some(Err(Refusal::of(Reason::NotArmed)));
        }
        self.board.is_told(motor).then_some(Ok(()))
    }

    /// Keeps a waker, unless it has it. If there was no room, `waker` is then the one that waited for longest, and true.
    fn keep(&mut self, motor: u8, waker: &mut Option<Waker>) -> bool {
        let Some(places) = self.wakers.get_mut(usize::from(motor)) else { return false };
        if places.iter().flatten().any(|kept| waker.as_ref().is_some_and(|waker| waker.will_wake(kept))) {
            return false;
        }
        // The newest is last.
        places.rotate_left(1);
        core::mem::swap(&mut places[WAITING - 1], waker);
        waker.is_some()
    }
}

/// All motors, on the core that began them, in main and in [`on_done`](Motors::on_done): it can be sent to nobody else.
#[derive(Clone, Copy, Debug)]
pub struct Motors {
    count: u8,
    here: Here,
}

/// What cannot be sent to another core, nor be had by an interrupt.
type Here = PhantomData<*const ()>;

/// Fails to compile if one can be sent: then there are two `is_sent`.
const _: fn() = {
    trait Sent<A> {
        fn is_sent() {}
    }
    impl<T> Sent<()> for T {}
    impl<T: Send> Sent<u8> for T {}
    <Motors as Sent<_>>::is_sent
};

impl Motors {
    /// Sets up the chip at 125 MHz and the motors, whose drivers are enabled; nothing moves.
    ///
    /// # Errors
    /// What a Pico cannot do: see [`Reason`]; [`Reason::TooManyMotors`] with more than 8.
    ///
    /// # Safety
    /// Only once, in main, on core 0, and before other parts of the chip are set up; nothing else changes what the [module](self) takes.
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
        board.pace = Pace::of_interrupt(motors.len() as u8);
        board.configure(&configuration)?;
        regs::enable_interrupts();
        let wakers = [const { [const { None }; WAITING] }; MOTORS];
        let mut state = State { board, on_done: None, wakers, armings: 0 };
        state.arm()?;
        // SAFETY: the interrupt is not let in yet.
        unsafe {
            STATE.with(|place| *place = Some(state));
        }
        start::set_handler(TIMER_IRQ_1, look_after);
        // Behind the DMA's.
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

    /// Tells motors, by their numbers, what to do, all from the same tick on, or none of it; up to eight things.
    ///
    /// # Errors
    /// [`Reason::NoSuchMotor`], [`Reason::Period`], [`Reason::Busy`]; [`Reason::NotArmed`] if motors [were stopped](Motors::stop), or
    /// stopped since their words were late; [`Reason::Full`] with more than eight.
    pub fn tell(self, verbs: &[(u8, Verb)]) -> Result<Obeyed, Refusal> {
        tell(verbs)
    }

    /// Calls `on_done` with each move that is done, in the timer's interrupt, some 10 µs later. It may tell motors what to do
    /// next; how long it may take the [module](self) says. If it [stops](Motors::stop) them and [arms](Motors::arm) them again, it is
    /// still told of others that were done by then.
    pub fn on_done(self, on_done: fn(Motors, Done)) {
        with(|state| state.on_done = Some(on_done));
    }

    /// Stops all motors at once, without ramps; tells after which tick no step was begun, and whose position is uncertain. What
    /// they were to do is forgotten, without "done"; positions are what they did, coils and drivers hold.
    pub fn stop(self) -> Stopped {
        let stopped = with(|state| state.board.stop_now());
        look_after_soon();
        stopped
    }

    /// Releases drivers and coils of motors that rest, which are then not armed.
    ///
    /// # Errors
    /// [`Reason::Moving`].
    pub fn release(self) -> Result<(), Refusal> {
        with(|state| state.board.release())?;
        look_after_soon();
        Ok(())
    }

    /// Begins again after motors were [stopped](Motors::stop) or [released](Motors::release), or stopped since words were late: enables
    /// drivers; positions stay, periods and directions are as at first, moves are counted from 0. Nothing moves until it is told. If
    /// motors are armed it does nothing.
    ///
    /// # Errors
    /// None that is known: they were configured.
    pub fn arm(self) -> Result<(), Refusal> {
        with(|state| if state.board.is_armed() { Ok(()) } else { state.arm() })
    }

    /// Whether motors can be told what to do: since [`begin`](Motors::begin) or [`arm`](Motors::arm) nothing stopped them.
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

/// Has the timer's interrupt come now.
fn look_after_soon() {
    regs::NVIC_ISPR.write(regs::TIMER_IRQ_1);
}

fn now() -> u64 {
    with(|state| state.board.clock.now())
}

fn tell(verbs: &[(u8, Verb)]) -> Result<Obeyed, Refusal> {
    let mut bytes = [[0; ORDER_LEN]; MOST_ORDERS];
    let full = Refusal { reason: Reason::Full, detail: MOST_ORDERS as u16 };
    let used = bytes.get_mut(..verbs.len()).ok_or(full)?;
    for (place, (motor, verb)) in used.iter_mut().zip(verbs) {
        if usize::from(*motor) >= MOTORS {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail: u16::from(*motor) });
        }
        *place = order(*motor, *verb);
    }
    let orders = Orders::decode(used.as_flattened()).ok_or(full)?;
    let obeyed = with(|state| state.board.obey(&orders).map(|()| state.board.obeyed))?;
    // Who waits for a motor's rest has it now.
    for (motor, verb) in verbs {
        if *verb == Verb::Halt {
            wake(*motor);
        }
    }
    Ok(obeyed)
}

/// One motor; as [`Motors`], it stays on its core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motor {
    number: u8,
    here: Here,
}

impl Motor {
    /// MOVE: exactly `steps` steps, then done. Behind a move under way one may wait.
    ///
    /// # Errors
    /// [`Reason::Busy`] if one waits already.
    pub fn move_steps(self, steps: u32) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Move { steps })])
    }

    /// Steps without an end.
    ///
    /// # Errors
    /// [`Reason::Busy`] if a move waits behind one.
    pub fn run(self) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Run)])
    }

    /// SPEED: exactly `ticks` from step to step. A wait is not a velocity: see docs/pico.md.
    ///
    /// # Errors
    /// [`Reason::Period`] if it is shorter than this motor's shortest, which is the number with it, or longer than 2^62.
    pub fn set_period(self, ticks: u64) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Speed { ticks })])
    }

    /// DIRECTION: forward, backward, stationary; also in mid-move.
    ///
    /// # Errors
    /// None but what [`Motors::tell`] says of all.
    pub fn set_direction(self, course: Heading) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Heading(course))])
    }

    /// Forgets move and run, and what waits.
    ///
    /// # Errors
    /// As [`set_direction`](Motor::set_direction).
    pub fn halt(self) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Halt)])
    }

    /// Steps forward less steps backward by now: pulses begun, wrapping.
    #[must_use]
    pub fn position(self) -> i32 {
        with(|state| state.board.position(self.number))
    }

    /// Whether nothing is left: the last move is done, its last period included, or was halted.
    #[must_use]
    pub fn is_at_rest(self) -> bool {
        with(|state| state.board.is_told(self.number))
    }

    /// Waits until it [is at rest](Motor::is_at_rest).
    ///
    /// # Errors
    /// [`Reason::NotArmed`] as soon as motors are not armed, or were not at some time since this was called: they may not have done
    /// what they were to do.
    pub fn rests(self) -> impl Future<Output = Result<(), Refusal>> {
        Rests { motor: self, arming: with(|state| state.armings) }
    }
}

/// See [`Motor::rests`].
struct Rests {
    motor: Motor,
    arming: u32,
}

impl Future for Rests {
    type Output = Result<(), Refusal>;

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Self::Output> {
        let Rests { motor: Motor { number, .. }, arming } = *self;
        // Cloned and dropped out here: that is the executor's code.
        let mut waker = Some(context.waker().clone());
        let (waited, is_older) = with(|state| {
            let waited = state.waited(number, arming);
            (waited, waited.is_none() && state.keep(number, &mut waker))
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
        // The timer's interrupt ends it.
        regs::wait_for_interrupt();
    }
}

/// The timer's alarm 1, of the chip's interrupts.
const TIMER_IRQ_1: usize = 1;

/// Interrupts of the chip (§2.3.2).
const INTERRUPTS: usize = 32;

/// What the library has of them.
const TAKEN: [usize; 2] = [TIMER_IRQ_1, 11];

/// No interrupt of the program's: the library has it, or there is none of that number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotYours {
    /// Which.
    pub interrupt: usize,
}

/// Has `handler` called for an interrupt of the chip, by its number (RP2040 datasheet, §2.3.2): 0 to 31, but 1 and 11. It comes as soon as it is let
/// in by the NVIC's ISER, which is the program's to do. One without a handler ends the program.
///
/// # Errors
/// [`NotYours`]; nothing changes then.
///
/// # Safety
/// The interrupt is not let in yet. The handler takes no longer than the [module](self) allows, at its priority, and has what others have too only as Rust
/// allows for threads. It lets nobody else in by `cpsie` who keeps interrupts out.
pub unsafe fn set_handler(interrupt: usize, handler: extern "C" fn()) -> Result<(), NotYours> {
    if interrupt >= INTERRUPTS || TAKEN.contains(&interrupt) {
        return Err(NotYours { interrupt });
    }
    start::set_handler(interrupt, handler);
    Ok(())
}
