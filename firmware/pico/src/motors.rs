//! Motors for a program of one's own on the Pico, without a host: MOVE, SPEED and DIRECTION, without waiting.
//!
//! # How it goes
//! [`Motors::begin`] sets up clocks, pins and state machines, and a timer's interrupt that works out steps and writes words for the
//! motors ahead of time, up to 1.7 ms. The program does what it likes meanwhile: it may compute for seconds. Steps come on their
//! ticks of 8 ns; what a program says holds from the tick that [`Motors::tell`] gives back.
//!
//! When a move is done, its last step's period included, a function is called ([`Motors::on_done`]), and who awaits
//! [`Motor::rests`] goes on.
//!
//! # What it takes
//! State machines and DMA channels with the motors' numbers: up to four motors leave PIO block 1 and all its state machines to the
//! program. The gate (GPIO 25), DMA interrupt 0, alarm 1 of the timer with its interrupt, and SysTick.
//!
//! # What is not
//! Ramps: a motor has a new speed with its next step.

use crate::clock::{self, TICK_HZ};
use crate::machine::Board;
use crate::regs;
use crate::start::{Shared, set_handler};
use crate::steps::MOTORS;
use crate::steps::stepper::Pace;
use core::future::Future;
use core::pin::{Pin, pin};
use core::task::{Context, Poll, Waker};
use pulsetrain_core::wire::Machine;
use pulsetrain_core::wire::message::{Configuration, Event, MOTOR_SETUP_LEN, NO_PIN};
use pulsetrain_core::wire::orders::{MOST_ORDERS, ORDER_LEN, Orders, order};

pub use pulsetrain_core::output::Sequence;
pub use pulsetrain_core::verbs::{Course, Verb};
pub use pulsetrain_core::wire::Refusal;
pub use pulsetrain_core::wire::message::{MotorSetup, Reason};
pub use pulsetrain_core::wire::orders::Obeyed;

/// Ticks a second: a tick is 8 ns.
pub const TICKS_PER_S: u32 = TICK_HZ;

/// How often motors are looked after, at least, µs.
const ROUND_US: u32 = 1200;

/// And at most: an alarm that is not ahead comes after 72 min.
const SHORTEST_ROUND_US: u32 = 5;

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
    on_done: Option<fn(Done)>,
    wakers: [Option<Waker>; MOTORS],
}

static STATE: Shared<Option<State>> = Shared::new(None);

/// Has the state, with the interrupt kept out; the DMA's still comes.
fn with<T>(f: impl FnOnce(&mut State) -> T) -> T {
    regs::NVIC_ICER.write(regs::TIMER_IRQ_1);
    regs::settle();
    // SAFETY: only the timer's interrupt has it else, and that is kept out, or it is what calls; no `f` in this file calls `with`.
    let done = unsafe {
        STATE.with(|state| match state {
            Some(state) => f(state),
            // Nobody has a `Motors` or a `Motor` before.
            None => panic!(),
        })
    };
    regs::NVIC_ISER.write(regs::TIMER_IRQ_1);
    done
}

/// The timer's interrupt: words for the motors, and what was done.
extern "C" fn look_after() {
    // Alarm 1's bit, of what was raised.
    regs::TIMER_INTR.write(1 << 1);
    with(|state| {
        while state.board.go_on() {}
        let now = clock::millis(state.board.clock.now());
        state.board.look_after(now);
    });
    while let Some(done) = with(State::take_done) {
        // Outside of `with`: they may tell motors what to do next.
        if let Some(on_done) = with(|state| state.on_done) {
            on_done(done);
        }
        if let Some(waker) = with(|state| state.take_waker(done.motor)) {
            waker.wake();
        }
    }
    let us = with(State::spare_us);
    regs::TIMER_ALARM1.write(regs::TIMER_RAW.read().wrapping_add(us));
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

    fn take_waker(&mut self, motor: u8) -> Option<Waker> {
        self.wakers.get_mut(usize::from(motor)).and_then(Option::take)
    }
}

/// All motors.
#[derive(Clone, Copy, Debug)]
pub struct Motors {
    count: u8,
}

impl Motors {
    /// Sets up the chip at 125 MHz and the motors, whose drivers are enabled; nothing moves.
    ///
    /// # Errors
    /// What a Pico cannot do: see [`Reason`]; [`Reason::TooManyMotors`] with more than 8.
    ///
    /// # Safety
    /// Only once, and before other parts of the chip are set up; nothing else changes what the [module](self) takes.
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
        board.pace = Pace::SELDOM;
        board.configure(&configuration)?;
        regs::enable_interrupts();
        board.arm()?;
        // Words are written from now on; nothing is told.
        board.begin_verbs()?;
        // SAFETY: the interrupt is not let in yet.
        unsafe {
            STATE.with(|state| *state = Some(State { board, on_done: None, wakers: [const { None }; MOTORS] }));
        }
        set_handler(1, look_after);
        // Behind the DMA's.
        regs::NVIC_IPR0.write(0xc0 << 8);
        regs::TIMER_INTE.write(1 << 1);
        regs::TIMER_ALARM1.write(regs::TIMER_RAW.read().wrapping_add(SHORTEST_ROUND_US));
        regs::NVIC_ISER.write(regs::TIMER_IRQ_1);
        Ok(Motors { count: motors.len() as u8 })
    }

    /// A motor; `None` if there are fewer.
    #[must_use]
    pub fn motor(self, number: u8) -> Option<Motor> {
        (number < self.count).then_some(Motor { number })
    }

    /// Tells motors, by their numbers, what to do, all from the same tick on, or none of it; up to eight things.
    ///
    /// # Errors
    /// [`Reason::NoSuchMotor`], [`Reason::Period`], [`Reason::Busy`]; [`Reason::NotArmed`] if motors stopped since their words were
    /// late (interrupts were kept out for 1 ms); [`Reason::Full`] with more than eight.
    pub fn tell(self, verbs: &[(u8, Verb)]) -> Result<Obeyed, Refusal> {
        tell(verbs)
    }

    /// Calls `on_done` with each move that is done, in the timer's interrupt, some 10 µs later. It may tell motors what to do
    /// next, and ought to be short.
    pub fn on_done(self, on_done: fn(Done)) {
        with(|state| state.on_done = Some(on_done));
    }

    /// The clock, ticks.
    #[must_use]
    pub fn now(self) -> u64 {
        now()
    }

    /// Sleeps until the clock is at `tick`, or up to 1.2 ms longer.
    pub fn sleep_until(self, tick: u64) {
        while now() < tick {
            regs::wait_for_interrupt();
        }
    }
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
        if *verb == Verb::Halt
            && let Some(waker) = with(|state| state.take_waker(*motor))
        {
            waker.wake();
        }
    }
    Ok(obeyed)
}

/// One motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Motor {
    number: u8,
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
    pub fn set_direction(self, course: Course) -> Result<Obeyed, Refusal> {
        tell(&[(self.number, Verb::Course(course))])
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
    pub fn rests(self) -> impl Future<Output = ()> {
        Rests { motor: self }
    }
}

/// See [`Motor::rests`].
struct Rests {
    motor: Motor,
}

impl Future for Rests {
    type Output = ();

    fn poll(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let number = self.motor.number;
        with(|state| {
            if state.board.is_told(number) {
                return Poll::Ready(());
            }
            if let Some(place) = state.wakers.get_mut(usize::from(number)) {
                *place = Some(context.waker().clone());
            }
            Poll::Pending
        })
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
