//! Motors told directly: `pulsetrain_core::verbs`, from which the task gets their steps.
//!
//! # Who works out what
//! Main tells, the task asks. What happens before the tick [`known`](AvrVerbs::known) is settled, and an order holds from there on. Each
//! call of the task sees to it that this is a while away ([`verbs_advance`]); a motor that has used up its steps takes
//! the next evenly spaced ones before it right into its registers ([`verbs_take`]). Nothing else is planned up to there: the limit is so
//! long before it that DIR can be turned for a step at that very tick.
//!
//! # Where
//! In the memory of the queues, which are empty as long as verbs have the motors: until these are released or stopped. Moves that were
//! done and not told are still there then, until a plan comes.
//!
//! # Cycles
//! A motor's next steps: some 1000, once in every 0.8 to 1.2 ms.

use crate::engine::clock;
use crate::engine::machine::extended;
use crate::engine::program::Program;
use crate::engine::steps::motor::{Motor, flag};
use crate::engine::steps::pins::MAX_MOTORS;
use crate::engine::steps::register;
use crate::engine::steps::stepper::Stepper;
use crate::engine::steps::task::{self, Guard, mode};
use crate::engine::steps::times::{self, TIMES};
use crate::engine::tuning::stepper::AHEAD;
use crate::engine::tuning::task::SOONEST;
use crate::engine::tuning::verbs::{
    CLEAR, FORESEE, FORESEE_MORE, LONGEST_PULSE, SHORT_PULSE, SHORTEST, SHORTEST_OF_LONG, SOONER,
};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::avr::verbs::{AvrVerbs, MOTORS};
use pulsetrain_core::wire::message::{Configuration, Reason, image};
use pulsetrain_core::wire::orders::{self, Orders};
use pulsetrain_core::wire::{Encoder, Refusal};

/// From a step to one the other way, ticks, beside pulse, hold and set-up: `keep` and `early` of no [`Times`] are more than that.
///
/// [`Times`]: crate::steps::times::Times
const TURN: u16 = 640;
/// Until another is said: 1000 steps/s.
const PERIOD: u32 = clock::TICK_HZ / 1000;

/// There is nothing to be told.
const NONE: u8 = 0;
/// Moves may be done and not told.
const STOPPED: u8 = 1;
/// AvrVerbs have the motors.
pub(crate) const ON: u8 = 2;

/// Which of these: main's, and the task's to look at.
#[unsafe(export_name = "verbs_state")]
static mut STATE: u8 = NONE;

/// Counts of 64 cycles until the task is to see again whether enough is known, at most.
#[unsafe(export_name = "verbs_due")]
static mut DUE: u8 = 0;

#[derive(Clone, Copy)]
struct Limits {
    shortest: u16,
    turn: u16,
    /// How soon what is known ends, when it has been put off.
    foresee: u16,
}

/// Of the configuration.
static mut LIMITS: Limits = Limits { shortest: 0, turn: 0, foresee: 0 };

#[repr(C)]
struct Place {
    verbs: AvrVerbs,
    /// Bit by motor: it has no more steps before what is known.
    used_up: u8,
}

const _: () = assert!(size_of::<Place>() <= Told::POOL && MOTORS == MAX_MOTORS);

// Where other programs have their queues.
global_asm!(".global verbs_place", ".set verbs_place, queues");

// What the engine asks of a program (see `program`), as long as verbs have the motors.
global_asm!(
    r#"
    .section .text.verbs, "ax", @progbits
    .global verbs_limit, verbs_load, verbs_soon
verbs_limit:
    call steps_limit
    lds r18, verbs_state
    cpi r18, {ON}
    brne 1f
    call verbs_advance
    lds r18, steps_mode
    cpi r18, {FILLED}
    brne 1f
    sts steps_times+{LIMIT}, r22
    sts steps_times+{LIMIT}+1, r23
    sts steps_times+{LIMIT}+2, r24
    sts steps_times+{LIMIT}+3, r25
    call steps_merge_run
    lds r22, steps_times+{LIMIT}
    lds r23, steps_times+{LIMIT}+1
    lds r24, steps_times+{LIMIT}+2
    lds r25, steps_times+{LIMIT}+3
1:  ret

    // Carry: there are no steps yet, or the motor makes none any more.
verbs_load:
    ldd r24, Y+{FLAGS}
    sbrc r24, {UNREADABLE}
    rjmp 1f
    lds r24, verbs_state
    cpi r24, {ON}
    brne 1f
    // Its bit.
    lds r24, verbs_place+{USED_UP}
    ldi r18, lo8(steps_motors)
    ldi r19, hi8(steps_motors)
2:  cp r18, r28
    cpc r19, r29
    breq 3f
    subi r18, lo8(-({MOTOR_SIZE}))
    sbci r19, hi8(-({MOTOR_SIZE}))
    lsr r24
    rjmp 2b
3:  sbrc r24, 0
    rjmp 1f
    movw r24, r28
    call verbs_take
    lsr r24
    ret
1:  sec
    ret

    // When verbs are due: that was counted from where this call of the task began, as Timer0 has done.
verbs_soon:
    lds r24, verbs_state
    cpi r24, {ON}
    brne 4f
    lds r24, verbs_due
    in r20, {TCNT0}
    sub r24, r20
    brcs 1f
    sbic {TIFR0}, 0
1:  ldi r24, {SOONEST}
    cpi r24, {SOONEST}
    brsh 2f
    ldi r24, {SOONEST}
2:  cp r26, r24
    brlo 3f
    mov r26, r24
3:  sec
    ret
4:  clc
    ret
    "#,
    ON = const ON,
    FILLED = const mode::FILLED,
    LIMIT = const times::LIMIT,
    USED_UP = const offset_of!(Place, used_up),
    MOTOR_SIZE = const size_of::<Motor>(),
    FLAGS = const offset_of!(Motor, flags),
    UNREADABLE = const flag::UNREADABLE,
    TCNT0 = const register::TCNT0,
    TIFR0 = const register::TIFR0,
    SOONEST = const SOONEST,
);

#[expect(improper_ctypes, reason = "no other language knows it")]
unsafe extern "C" {
    static mut verbs_place: Place;
}

/// AvrVerbs, and nothing else.
pub(crate) struct Told;

impl Program for Told {
    const IMAGE: u8 = image::VERBS;
    const SHARED: bool = false;
    const BESIDE: bool = false;
    const OBEYS: bool = true;
    // The limit is not always so far ahead.
    const FILLER: u16 = 8192;
    const POOL: usize = 366;

    #[inline(always)]
    fn is_obeying() -> bool {
        is_on()
    }

    #[inline(always)]
    fn set_up(configuration: &Configuration<'_>) {
        set_up(configuration);
    }

    #[inline(always)]
    fn begin(orders: &Orders<'_>) -> Result<(), Refusal> {
        begin(orders)
    }

    #[inline(always)]
    fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
        obey(orders)
    }

    #[inline(always)]
    fn encode_obeyed(frame: &mut Encoder<'_>) {
        encode_obeyed(frame);
    }

    #[inline(always)]
    fn stop(dry: bool) {
        stop(dry);
    }

    #[inline(always)]
    fn rest() -> bool {
        rest()
    }

    #[inline(always)]
    fn take_done() -> Option<(u8, Tick32, u32)> {
        take_done()
    }

    #[inline(always)]
    fn forsake() {
        forsake();
    }
}

fn state() -> u8 {
    // SAFETY: one byte, which main alone writes.
    unsafe { (&raw const STATE).read_volatile() }
}

fn set_state(state: u8) {
    // SAFETY: as above. The task looks for `ON` alone, which is set and unset while it is out.
    unsafe { (&raw mut STATE).write_volatile(state) }
}

/// What there is, for who keeps the task out as long as it uses this. Only if there is something.
#[expect(clippy::mut_from_ref, reason = "main has one guard at a time")]
fn place(_: &Guard) -> Option<&mut Place> {
    let place = &raw mut verbs_place;
    // SAFETY: it was written before the state was one of these, and queues are empty; main has one guard at a time, and uses what
    // it got from it before it gets it again.
    (state() != NONE).then(|| unsafe { &mut *place })
}

/// Whether verbs have the motors.
#[inline(always)]
fn is_on() -> bool {
    state() == ON
}

/// Has armed motors, which rest with empty queues, do what is ordered, if that can be: from then on verbs have them.
///
/// # Errors
/// [`Reason::Timing`]: pulses are too long; as [`AvrVerbs::obey`].
#[inline(never)]
fn begin(orders: &Orders<'_>) -> Result<(), Refusal> {
    let now = clock::moment();
    let stepper = task::lock();
    if TIMES.get().pulse != 0 {
        return Err(Refusal { reason: Reason::Timing, detail: LONGEST_PULSE });
    }
    let Limits { shortest, turn, foresee } = my_limits();
    let limits = (shortest, turn, PERIOD);
    let ahead = stepper.horizon().after(u32::from(clear())).since(now);
    let known = now.after(ahead.max(u32::from(foresee)));
    if state() == NONE {
        let place = &raw mut verbs_place;
        // SAFETY: queues are empty, and nobody refers to this; zeros are what it may be (see `Verbs`). Not by value: that would be
        // on the stack first.
        unsafe { place.write_bytes(0, 1) };
        set_state(STOPPED);
    }
    let Some(place) = place(&stepper) else { return Ok(()) };
    place.verbs.begin((0..stepper.count()).map(|motor| stepper.position(motor, stepper.tail_of(motor))), limits, known);
    place.verbs.obey(orders)?;
    place.used_up = 0;
    // Who only asks leaves motors as they are.
    if !orders.is_empty() {
        stepper.is_filled();
        set_state(ON);
    }
    Ok(())
}

/// Has motors do what is ordered. Waits until that can be: it can, unless in what is settled one move ends, the next one begins, and
/// the motor has not come to that; as long as what is settled lasts, at most.
///
/// # Errors
/// As [`AvrVerbs::obey`]; [`Reason::Busy`]: that motor did not come to it.
#[inline(never)]
fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
    let end = clock::moment().after(u32::from(my_limits().foresee));
    loop {
        let stepper = task::lock();
        let Some(place) = place(&stepper) else { return Err(Refusal::of(Reason::NotArmed)) };
        let Some(motor) = place.verbs.busy() else {
            place.verbs.obey(orders)?;
            place.used_up = 0;
            return Ok(());
        };
        if end.is_before(clock::moment()) {
            return Err(Refusal { reason: Reason::Busy, detail: u16::from(motor) });
        }
    }
}

/// Writes what came of what was obeyed last.
fn encode_obeyed(frame: &mut Encoder<'_>) {
    let guard = task::lock();
    if let Some(place) = place(&guard) {
        let (at, motors) = place.verbs.obeyed();
        orders::encode_obeyed(extended(at), motors, frame);
    }
}

/// Motors were stopped at once, so that what was due a shortest period before [`Stepper::halted`] was made. `dry`: not even that.
#[inline(never)]
fn stop(dry: bool) {
    if is_on() {
        let guard = task::lock();
        if let Some(place) = place(&guard) {
            place.verbs.stop((!dry).then_some(guard.halted()));
        }
        set_state(STOPPED);
    }
}

/// Whether nothing is left to be done, if verbs have the motors.
#[inline(never)]
fn rest() -> bool {
    if !is_on() {
        return true;
    }
    let now = clock::moment();
    let guard = task::lock();
    place(&guard).is_none_or(|place| place.verbs.rest_at(now))
}

/// A move that was done and not told yet: motor, tick, number.
#[inline(never)]
fn take_done() -> Option<(u8, Tick32, u32)> {
    if state() == NONE {
        return None;
    }
    let now = clock::moment();
    let guard = task::lock();
    place(&guard)?.verbs.take_done(now)
}

/// Nobody tells motors any more: see [`AvrVerbs::forsake`].
#[inline(never)]
fn forsake() {
    let guard = task::lock();
    if let Some(place) = place(&guard) {
        place.verbs.drop_endless();
    }
}

/// Of the configuration.
fn my_limits() -> Limits {
    // SAFETY: `set_up` alone writes it, while neither main nor the task reads it.
    unsafe { (&raw const LIMITS).read() }
}

/// Notes what the motors of a configuration can do.
#[inline(never)]
fn set_up(configuration: &Configuration<'_>) {
    let Configuration { pulse_ticks, setup_ticks, hold_ticks, .. } = *configuration;
    let motors = configuration.motors().len() as u16;
    let limits = Limits {
        shortest: if pulse_ticks <= SHORT_PULSE { SHORTEST } else { SHORTEST_OF_LONG } * motors,
        turn: TURN + pulse_ticks + setup_ticks + hold_ticks,
        foresee: FORESEE + FORESEE_MORE * motors,
    };
    // SAFETY: main alone writes it, while verbs do not have the motors.
    unsafe { (&raw mut LIMITS).write(limits) }
}

/// From the limit to what is known, ticks.
fn clear() -> u16 {
    TIMES.get().early + CLEAR
}

/// For the task: sees to it that enough is known, and gives the limit. `limit` is what that is for others, [`AHEAD`] from now.
#[unsafe(no_mangle)]
extern "C" fn verbs_advance(limit: u32) -> u32 {
    let now = Tick32(limit).before(AHEAD);
    let place = &raw mut verbs_place;
    // SAFETY: the task calls this while verbs have the motors, and a guard would have kept it out.
    let place = unsafe { &mut *place };
    let foresee = my_limits().foresee;
    let slice = u32::from(foresee / 2 - SOONER);
    let next = now.after(u32::from(foresee));
    let mut known = place.verbs.known();
    // Ticks until it is to be put off.
    let mut left = known.after(slice).since(next).cast_signed();
    if left < 0 {
        (known, left) = (next, slice.cast_signed());
        place.verbs.foresee(known);
        place.used_up = 0;
    }
    // Divided by 64: by bytes, an AVR shifts by one bit at a time.
    let [_, due, more, _] = (left.cast_unsigned() << 2).to_le_bytes();
    // SAFETY: one byte, the task's alone.
    unsafe { (&raw mut DUE).write(if more == 0 { due } else { u8::MAX }) };
    known.before(u32::from(clear())).0
}

/// For the task: the next steps of a motor that has none left, into its registers; gives 1 if there are none yet.
#[unsafe(no_mangle)]
extern "C" fn verbs_take(motor: &mut Motor) -> u8 {
    let number = Stepper::number_of(motor);
    let place = &raw mut verbs_place;
    // SAFETY: as above.
    let place = unsafe { &mut *place };
    let taken = place.verbs.take(number);
    if let Some(steps) = &taken {
        motor.follow(steps);
    }
    // It is not asked in vain, which takes as long as steps do.
    if taken.is_none() || place.verbs.has_all(number) {
        place.used_up |= 1 << number;
    }
    u8::from(taken.is_none())
}
