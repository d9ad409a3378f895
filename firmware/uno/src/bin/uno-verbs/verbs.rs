//! Orders to motors: `pulsetrain_core::verbs` works out their steps, and the refill takes them from there.
//!
//! # Who does what
//! Main takes orders. What happens before the tick [`known`](AvrVerbs::known) is settled, and an order holds from there on. Each refill moves `known` on, so
//! that it stays some time ahead ([`verbs_advance`]). A motor that has used up its steps takes the next evenly spaced ones before `known` right into
//! its registers ([`verbs_take`]). The limit is a little before `known`, so that DIR can still be turned for a step at `known` itself.
//!
//! # Where
//! In the memory of the queues. These are empty as long as orders have the motors, until the motors are released or stopped. Moves that are done and not
//! reported stay there even then, until a plan comes.
//!
//! # Cycles
//! A motor's next steps take some 1000, once in every 0.8 to 1.2 ms.

use crate::engine::clock;
use crate::engine::machine::extended;
use crate::engine::program::Program;
use crate::engine::steps::motor::{Motor, flag};
use crate::engine::steps::pins::MAX_MOTORS;
use crate::engine::steps::refill::{self, Guard, mode};
use crate::engine::steps::register;
use crate::engine::steps::stepper::Stepper;
use crate::engine::steps::times::{self, TIMES};
use crate::engine::tuning::refill::MIN_PERIOD;
use crate::engine::tuning::stepper::LOOK_AHEAD;
use crate::engine::tuning::verbs::{
    CLEARANCE, KNOWN_AHEAD, KNOWN_AHEAD_A_MOTOR, MARGIN, MAX_PULSE, SHORT_PULSE, SHORTEST_PERIOD,
    SHORTEST_PERIOD_STRETCHED,
};
use core::arch::global_asm;
use core::mem::offset_of;
use pulsetrain_core::Tick32;
use pulsetrain_core::avr::verbs::{AvrVerbs, MOTORS};
use pulsetrain_core::wire::message::{Configuration, Reason, image};
use pulsetrain_core::wire::orders::{self, Orders};
use pulsetrain_core::wire::{Encoder, Refusal};

/// From a step to one the other way, at least, ticks, beside pulse, hold and set-up: `dir_hold` and `dir_early` of any [`Times`] are no more than that.
///
/// [`Times`]: crate::engine::steps::times::Times
const TURN: u16 = 640;
/// Until an order sets another one: 1000 steps/s.
const PERIOD: u32 = clock::TICK_HZ / 1000;

/// There are no moves to report.
const NONE: u8 = 0;
/// There may be moves that are done and not reported.
const STOPPED: u8 = 1;
/// Orders have the motors.
pub(crate) const ON: u8 = 2;

/// One of these. Main writes it, and the refill reads it.
#[unsafe(export_name = "verbs_state")]
static mut STATE: u8 = NONE;

/// How soon the refill must look at `known` again, at most, counts of 64 cycles.
#[unsafe(export_name = "verbs_due")]
static mut DUE: u8 = 0;

#[derive(Clone, Copy)]
struct Limits {
    shortest: u16,
    turn: u16,
    /// From now to `known`, ticks, when it was moved.
    foresee: u16,
}

/// Those of the configuration.
static mut LIMITS: Limits = Limits { shortest: 0, turn: 0, foresee: 0 };

#[repr(C)]
struct VerbsMemory {
    verbs: AvrVerbs,
    /// Bit by motor: it has no more steps before `known`.
    used_up: u8,
}

const _: () = assert!(size_of::<VerbsMemory>() <= VerbsProgram::POOL && MOTORS == MAX_MOTORS);

// Where other programs have their queues.
global_asm!(".global verbs_place", ".set verbs_place, queues");

// The routines that the engine asks of a program, as long as orders have the motors.
global_asm!(
    r#"
    .section .text.verbs, "ax", @progbits
    .global verbs_limit, verbs_load, verbs_due_soon
verbs_limit:
    call steps_limit
    lds r18, verbs_state
    cpi r18, {ON}
    brne 1f
    call verbs_advance
    lds r18, steps_mode
    cpi r18, {MERGED_BY_SOURCE}
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

    // When the refill must look at `known` again. That was counted from the begin of this refill, and Timer0 has counted since.
verbs_due_soon:
    lds r24, verbs_state
    cpi r24, {ON}
    brne 4f
    lds r24, verbs_due
    in r20, {TCNT0}
    sub r24, r20
    brcs 1f
    sbic {TIFR0}, 0
1:  ldi r24, {MIN_PERIOD}
    cpi r24, {MIN_PERIOD}
    brsh 2f
    ldi r24, {MIN_PERIOD}
2:  cp r26, r24
    brlo 3f
    mov r26, r24
3:  sec
    ret
4:  clc
    ret
    "#,
    ON = const ON,
    MERGED_BY_SOURCE = const mode::MERGED_BY_SOURCE,
    LIMIT = const times::LIMIT,
    USED_UP = const offset_of!(VerbsMemory, used_up),
    MOTOR_SIZE = const size_of::<Motor>(),
    FLAGS = const offset_of!(Motor, flags),
    UNREADABLE = const flag::UNREADABLE,
    TCNT0 = const register::TCNT0,
    TIFR0 = const register::TIFR0,
    MIN_PERIOD = const MIN_PERIOD,
);

#[expect(improper_ctypes, reason = "no other language knows it")]
unsafe extern "C" {
    static mut verbs_place: VerbsMemory;
}

/// The program for orders.
pub(crate) struct VerbsProgram;

impl Program for VerbsProgram {
    const IMAGE: u8 = image::VERBS;
    const SHARED: bool = false;
    const SHIELD_B: bool = false;
    const OBEYS: bool = true;
    // The limit is not always 3 ms ahead.
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
    fn host_left() {
        host_left();
    }
}

fn state() -> u8 {
    // SAFETY: one byte, which main alone writes.
    unsafe { (&raw const STATE).read_volatile() }
}

fn set_state(state: u8) {
    // SAFETY: as above. The refill reads only whether it is `ON`, and that changes while it is out.
    unsafe { (&raw mut STATE).write_volatile(state) }
}

/// The orders, if there are any, for a caller who keeps the refill out as long as it uses them.
#[expect(clippy::mut_from_ref, reason = "main has one guard at a time")]
fn place(_: &Guard) -> Option<&mut VerbsMemory> {
    let place = &raw mut verbs_place;
    // SAFETY: it was initialised before the state was one of these, and queues are empty. Main has one guard at a time, and gives up what it got from it
    // before it takes the next.
    (state() != NONE).then(|| unsafe { &mut *place })
}

/// Whether orders have the motors.
#[inline(always)]
fn is_on() -> bool {
    state() == ON
}

/// Gives the first orders to armed motors that rest with empty queues. From then on orders have the motors.
///
/// # Errors
/// [`Reason::Timing`]: pulses are too long. All of [`AvrVerbs::obey`].
#[inline(never)]
fn begin(orders: &Orders<'_>) -> Result<(), Refusal> {
    let now = clock::moment();
    let stepper = refill::lock();
    if TIMES.get().pulse != 0 {
        return Err(Refusal { reason: Reason::Timing, detail: MAX_PULSE });
    }
    let Limits { shortest, turn, foresee } = my_limits();
    let limits = (shortest, turn, PERIOD);
    let ahead = stepper.horizon().after(u32::from(clear())).since(now);
    let known = now.after(ahead.max(u32::from(foresee)));
    if state() == NONE {
        let place = &raw mut verbs_place;
        // SAFETY: queues are empty, and nobody refers to this. Zeros are a valid state (see `Verbs`). Not by value: that would be on the stack first.
        unsafe { place.write_bytes(0, 1) };
        set_state(STOPPED);
    }
    let Some(place) = place(&stepper) else { return Ok(()) };
    place.verbs.begin((0..stepper.count()).map(|motor| stepper.position(motor, stepper.tail_of(motor))), limits, known);
    place.verbs.obey(orders)?;
    place.used_up = 0;
    // An empty order only asks, and leaves motors as they are.
    if !orders.is_empty() {
        stepper.merge_by_source();
        set_state(ON);
    }
    Ok(())
}

/// Gives further orders. If a motor has two moves in the time that is settled, and has not come to the second yet, it waits for that, but no longer than
/// the settled time lasts.
///
/// # Errors
/// All of [`AvrVerbs::obey`]. [`Reason::Busy`]: that motor did not come to its second move.
#[inline(never)]
fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
    let end = clock::moment().after(u32::from(my_limits().foresee));
    loop {
        let stepper = refill::lock();
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

/// Writes the answer to the last orders.
fn encode_obeyed(frame: &mut Encoder<'_>) {
    let guard = refill::lock();
    if let Some(place) = place(&guard) {
        let (at, motors) = place.verbs.obeyed();
        orders::encode_obeyed(extended(at), motors, frame);
    }
}

/// Motors were stopped at once. Steps that were due a shortest period before [`Stepper::halted`] were made; after an underrun (`dry`) not even those.
#[inline(never)]
fn stop(dry: bool) {
    if is_on() {
        let guard = refill::lock();
        if let Some(place) = place(&guard) {
            place.verbs.stop((!dry).then_some(guard.halted()));
        }
        set_state(STOPPED);
    }
}

/// Whether all orders are done.
#[inline(never)]
fn rest() -> bool {
    if !is_on() {
        return true;
    }
    let now = clock::moment();
    let guard = refill::lock();
    place(&guard).is_none_or(|place| place.verbs.rest_at(now))
}

/// A move that is done and not reported yet: motor, tick, number.
#[inline(never)]
fn take_done() -> Option<(u8, Tick32, u32)> {
    if state() == NONE {
        return None;
    }
    let now = clock::moment();
    let guard = refill::lock();
    place(&guard)?.verbs.take_done(now)
}

/// The host has left: see [`AvrVerbs::drop_endless`].
#[inline(never)]
fn host_left() {
    let guard = refill::lock();
    if let Some(place) = place(&guard) {
        place.verbs.drop_endless();
    }
}

/// Those of the configuration.
fn my_limits() -> Limits {
    // SAFETY: only `set_up` writes it, while neither main nor the refill reads it.
    unsafe { (&raw const LIMITS).read() }
}

/// Notes the limits of a configuration's motors.
#[inline(never)]
fn set_up(configuration: &Configuration<'_>) {
    let Configuration { pulse_ticks, setup_ticks, hold_ticks, .. } = *configuration;
    let motors = configuration.motors().len() as u16;
    let limits = Limits {
        shortest: if pulse_ticks <= SHORT_PULSE { SHORTEST_PERIOD } else { SHORTEST_PERIOD_STRETCHED } * motors,
        turn: TURN + pulse_ticks + setup_ticks + hold_ticks,
        foresee: KNOWN_AHEAD + KNOWN_AHEAD_A_MOTOR * motors,
    };
    // SAFETY: main alone writes it, while orders do not have the motors.
    unsafe { (&raw mut LIMITS).write(limits) }
}

/// From the limit to `known`, ticks.
fn clear() -> u16 {
    TIMES.get().dir_early + CLEARANCE
}

/// For the refill: moves `known` on if it is time, and gives the limit. `limit` is that of other programs, [`LOOK_AHEAD`] from now.
#[unsafe(no_mangle)]
extern "C" fn verbs_advance(limit: u32) -> u32 {
    let now = Tick32(limit).before(LOOK_AHEAD);
    let place = &raw mut verbs_place;
    // SAFETY: this is the refill, which a guard would have kept out.
    let place = unsafe { &mut *place };
    let foresee = my_limits().foresee;
    let slice = u32::from(foresee / 2 - MARGIN);
    let next = now.after(u32::from(foresee));
    let mut known = place.verbs.known();
    // Ticks until `known` is to be moved.
    let mut left = known.after(slice).since(next).cast_signed();
    if left < 0 {
        (known, left) = (next, slice.cast_signed());
        place.verbs.foresee(known);
        place.used_up = 0;
    }
    // Divided by 64: shifted left and taken by bytes, as an AVR shifts by one bit at a time.
    let [_, due, more, _] = (left.cast_unsigned() << 2).to_le_bytes();
    // SAFETY: one byte, which only the refill uses.
    unsafe { (&raw mut DUE).write(if more == 0 { due } else { u8::MAX }) };
    known.before(u32::from(clear())).0
}

/// For the refill: the next steps of a motor that has none left, into its registers. Gives 1 if there are none yet.
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
    // If there are none before `known`, do not ask again: that takes as long as steps do.
    if taken.is_none() || place.verbs.has_all(number) {
        place.used_up |= 1 << number;
    }
    u8::from(taken.is_none())
}
