//! A program for the library's tests: it makes the calls that a mailbox in RAM asks for, and writes the results there. Up to eight
//! drivers, STEP on GPIO 2, 4, 6, …, DIR on the next ones; or up to five motors on coils, from GPIO 2 on.
//!
//! `crates/testkit/src/mailbox.rs` has the other end, and finds it by its first word.
#![no_std]
#![no_main]

use core::pin::Pin;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use core::task::{Context, Poll, RawWaker, RawWakerVTable, Waker};
use pulsetrain_pico::motors::{Done, Heading, MotorSetup, Motors, Refusal, Sequence, Times, Verb, set_handler};

/// How many futures, and done moves, the mailbox has room for.
const FUTURES: usize = 6;
const DONES: usize = 64;

/// Arguments of a call at most.
const ARGUMENTS: usize = 28;

#[repr(C)]
struct Mailbox {
    magic: AtomicU32,
    /// Motors, and 256 more if they are on coils: written into the image, before it runs.
    count: AtomicU32,
    /// The number of the call, and of the last one that was answered.
    call: AtomicU32,
    answered: AtomicU32,
    /// Which call: see [`serve`].
    what: AtomicU32,
    arguments: [AtomicU32; ARGUMENTS],
    /// 0, or the reason of a [`Refusal`] with its detail in the upper half; then the results of the call.
    refused: AtomicU32,
    results: [AtomicU32; 4],
    /// Done moves so far, and the last of them: motor, tick's lower half, number.
    dones: AtomicU32,
    done: [[AtomicU32; 3]; DONES],
    /// For each future: 0 while it waits, 1 done, 2 refused; and how often it was polled.
    futures: [[AtomicU32; 2]; FUTURES],
    /// How often the program's own interrupt came.
    interrupts: AtomicU32,
}

static MAILBOX: Mailbox = Mailbox {
    magic: AtomicU32::new(0x6d61_696c),
    count: AtomicU32::new(1),
    call: AtomicU32::new(0),
    answered: AtomicU32::new(0),
    what: AtomicU32::new(0),
    arguments: [const { AtomicU32::new(0) }; ARGUMENTS],
    refused: AtomicU32::new(0),
    results: [const { AtomicU32::new(0) }; 4],
    dones: AtomicU32::new(0),
    done: [const { [const { AtomicU32::new(0) }; 3] }; DONES],
    futures: [const { [const { AtomicU32::new(0) }; 2] }; FUTURES],
    interrupts: AtomicU32::new(0),
};

/// Which futures were woken.
static WOKEN: [AtomicBool; FUTURES] = [const { AtomicBool::new(false) }; FUTURES];

/// How long the program's own interrupt takes, and how long `on_done`, ticks.
static INTERRUPT_TICKS: AtomicU32 = AtomicU32::new(0);
static ON_DONE_TICKS: AtomicU32 = AtomicU32::new(0);
/// Steps of the next move that `on_done` orders when a move is done; 0: none.
static CHAIN: AtomicU32 = AtomicU32::new(0);

/// The interrupt of the timer's alarm 2, which the tests force.
const OWN: usize = 2;

/// Clears bits of the forced interrupts (§4.6.5, INTF; §2.1.2).
const TIMER_INTF_CLEAR: usize = 0x4005_4000 + 0x3c + 0x3000;

/// Registers of the NVIC (ARMv6-M, B3.4): enabled interrupts, priorities of 0 to 3.
const ISER: usize = 0xe000_e100;
const IPR0: usize = 0xe000_e400;
/// SysTick's value, which counts down, modulo 2^24 (B3.3).
const SYST_CVR: usize = 0xe000_e018;

fn read(register: usize) -> u32 {
    // SAFETY: a register of the processor; reading it changes nothing.
    unsafe { (register as *const u32).read_volatile() }
}

fn write(register: usize, value: u32) {
    // SAFETY: a register of the NVIC or the timer, of an interrupt that is this program's.
    unsafe { (register as *mut u32).write_volatile(value) }
}

fn spin(ticks: u32) {
    let begun = read(SYST_CVR);
    while begun.wrapping_sub(read(SYST_CVR)) & 0xff_ffff < ticks {}
}

extern "C" fn own_interrupt() {
    write(TIMER_INTF_CLEAR, 1 << OWN);
    spin(INTERRUPT_TICKS.load(Ordering::Relaxed));
    let count = &MAILBOX.interrupts;
    count.store(count.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
}

fn on_done(motors: Motors, done: Done) {
    let count = MAILBOX.dones.load(Ordering::Relaxed);
    let words = [u32::from(done.motor), done.tick as u32, done.number];
    for (place, word) in MAILBOX.done[count as usize % DONES].iter().zip(words) {
        place.store(word, Ordering::Relaxed);
    }
    MAILBOX.dones.store(count + 1, Ordering::Relaxed);
    let steps = CHAIN.load(Ordering::Relaxed);
    if steps != 0
        && let Some(motor) = motors.motor(done.motor)
    {
        // If it is refused, the chain of moves ends.
        let _ = motor.move_steps(steps);
    }
    spin(ON_DONE_TICKS.load(Ordering::Relaxed));
}

/// The data of a waker is the number of its future.
const WAKING: RawWakerVTable = RawWakerVTable::new(
    |number| RawWaker::new(number, &WAKING),
    |number| wake(number as usize),
    |number| wake(number as usize),
    |_| {},
);

fn wake(number: usize) {
    WOKEN[number].store(true, Ordering::Relaxed);
}

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let driver = |number: u8| MotorSetup {
        step_pin: 2 + 2 * number,
        dir_pin: 3 + 2 * number,
        forward_high: true,
        ..MotorSetup::default()
    };
    let coils = |number: u8| MotorSetup::coils_on(2 + 4 * number, Sequence::Half);
    let asked = MAILBOX.count.load(Ordering::Relaxed) as usize;
    let count = asked & 0xff;
    let wiring = [0, 1, 2, 3, 4, 5, 6, 7].map(|number| if asked == count { driver(number) } else { coils(number) });
    let times = Times { pulse_ticks: 50, setup_ticks: 50, hold_ticks: 50, ..Times::default() };
    // SAFETY: once, and nothing else is set up.
    let Ok(motors) = (unsafe { Motors::begin(&wiring[..count], times) }) else { panic!() };
    motors.on_done(on_done);
    // SAFETY: it is not enabled yet, and shares only atomics. How long it takes is what the tests are about.
    if unsafe { set_handler(OWN, own_interrupt) }.is_err() {
        panic!();
    }
    write(ISER, 1 << OWN);
    let mut futures = [const { None }; FUTURES];
    loop {
        let call = MAILBOX.call.load(Ordering::Relaxed);
        if call != MAILBOX.answered.load(Ordering::Relaxed) {
            let asked = MAILBOX.arguments.each_ref().map(|argument| argument.load(Ordering::Relaxed));
            let refused = match MAILBOX.what.load(Ordering::Relaxed) {
                // Waits in future number asked[0] for motor asked[1].
                WAIT => {
                    let number = asked[0] as usize;
                    futures[number] = motors.motor(asked[1] as u8).map(|motor| motor.rests());
                    MAILBOX.futures[number].iter().for_each(|word| word.store(0, Ordering::Relaxed));
                    wake(number);
                    Ok(())
                }
                what => serve(motors, what, &asked),
            };
            let refused = refused.map_or_else(|why| why.reason as u32 | u32::from(why.detail) << 16, |()| 0);
            MAILBOX.refused.store(refused, Ordering::Relaxed);
            MAILBOX.answered.store(call, Ordering::Relaxed);
        }
        for (number, place) in futures.iter_mut().enumerate() {
            let Some(future) = place else { continue };
            if !WOKEN[number].load(Ordering::Relaxed) {
                continue;
            }
            WOKEN[number].store(false, Ordering::Relaxed);
            let [state, polls] = &MAILBOX.futures[number];
            polls.store(polls.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
            // SAFETY: the table's functions treat the number as wakers must, on any thread.
            let waker = unsafe { Waker::new(number as *const (), &WAKING) };
            if let Poll::Ready(ended) = Pin::new(future).poll(&mut Context::from_waker(&waker)) {
                state.store(if ended.is_ok() { 1 } else { 2 }, Ordering::Relaxed);
                *place = None;
            }
        }
        // SAFETY: it only waits for an interrupt.
        unsafe { core::arch::asm!("wfi") }
    }
}

const WAIT: u32 = 10;

/// Calls of the library, but for waiting for rest.
fn serve(motors: Motors, what: u32, asked: &[u32; ARGUMENTS]) -> Result<(), Refusal> {
    let answer = |results: [u32; 4]| {
        for (place, results) in MAILBOX.results.iter().zip(results) {
            place.store(results, Ordering::Relaxed);
        }
    };
    let halves = |tick: u64| [tick as u32, (tick >> 32) as u32];
    match what {
        // Gives asked[0] orders: motor, verb, number. Returns the tick.
        1 => {
            let mut verbs = [(0, Verb::Halt); 9];
            let verbs = &mut verbs[..asked[0] as usize];
            for (place, [motor, verb, number]) in verbs.iter_mut().zip(asked[1..].as_chunks().0) {
                let verb = match (verb, number) {
                    (0, steps) => Verb::Move { steps: *steps },
                    (1, _) => Verb::Run,
                    (2, ticks) => Verb::Speed { ticks: u64::from(*ticks) },
                    (3, 0) => Verb::Heading(Heading::Stationary),
                    (3, 1) => Verb::Heading(Heading::Forward),
                    (3, _) => Verb::Heading(Heading::Backward),
                    _ => Verb::Halt,
                };
                *place = (*motor as u8, verb);
            }
            let [low, high] = halves(motors.tell(verbs)?.tick);
            answer([low, high, 0, 0]);
        }
        2 => motors.arm()?,
        // Returns the tick, and whose position is uncertain.
        3 => {
            let stopped = motors.stop();
            let [low, high] = halves(stopped.tick);
            answer([low, high, u32::from(stopped.uncertain), 0]);
        }
        4 => motors.release()?,
        // Disables interrupts for asked[0] ticks.
        5 => {
            // SAFETY: it only delays interrupts.
            unsafe { core::arch::asm!("cpsid i") };
            spin(asked[0]);
            // SAFETY: they were enabled before.
            unsafe { core::arch::asm!("cpsie i") };
        }
        // Its own interrupt takes asked[0] ticks and has priority asked[1].
        6 => {
            INTERRUPT_TICKS.store(asked[0], Ordering::Relaxed);
            write(IPR0, read(IPR0) & !(0xff << 16) | asked[1] << 16);
        }
        // `on_done` takes asked[0] ticks, and goes on with asked[1] steps.
        7 => {
            ON_DONE_TICKS.store(asked[0], Ordering::Relaxed);
            CHAIN.store(asked[1], Ordering::Relaxed);
        }
        // Returns of motor asked[0] the position and whether it rests; whether all are armed; and the clock.
        8 => {
            let (mut position, mut rests) = (0, false);
            if let Some(motor) = motors.motor(asked[0] as u8) {
                (position, rests) = (motor.position(), motor.is_at_rest());
            }
            answer([position.cast_unsigned(), rests.into(), motors.is_armed().into(), motors.now() as u32]);
        }
        // Returns whether interrupt asked[0] is refused to the program.
        9 => {
            // SAFETY: only asked for those that are refused.
            let refused = unsafe { set_handler(asked[0] as usize, own_interrupt) }.is_err();
            answer([refused.into(), 0, 0, 0]);
        }
        _ => {}
    }
    Ok(())
}
