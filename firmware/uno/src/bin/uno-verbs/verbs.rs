//! Motors told directly: `pulsetrain_core::verbs`, from which the task gets their steps.
//!
//! # Who works out what
//! Main tells, the task asks. What happens before the tick [`known`](Verbs::known) is settled, and an order holds from there on. Each
//! call of the task sees to it that this is a while away ([`verbs_advance`]); a motor that has used up its steps takes
//! the next evenly spaced ones before it right into its registers ([`verbs_load`]). Nothing else is planned up to there: the limit is so
//! long before it that DIR can be turned for a step at that very tick.
//!
//! # Where
//! In the memory of the queues, which are empty as long as verbs have the motors: until these are released or stopped. Moves that were
//! done and not told are still there then, until a plan comes.
//!
//! # Cycles
//! A motor's next steps: some 1000, once in every 0.8 to 1.2 ms.

use crate::clock;
use crate::machine::extended;
use crate::memory::POOL;
use crate::steps::motor::Motor;
use crate::steps::pins::MAX_MOTORS;
use crate::steps::stepper::{AHEAD, Stepper};
use crate::steps::task::{self, Guard};
use crate::steps::times::TIMES;
use core::arch::global_asm;
use pulsetrain_core::Moment;
use pulsetrain_core::narrow::verbs::{MOTORS, Verbs};
use pulsetrain_core::wire::message::{Configuration, Reason};
use pulsetrain_core::wire::orders::{self, Orders};
use pulsetrain_core::wire::{Encoder, Refusal};

/// Motors can be told directly.
pub(crate) const OBEYS: bool = true;

/// What is known ends so soon, ticks, when it has been put off: 1.95 ms, and 0.25 ms more for each further motor, whose steps take the
/// task so much longer.
const FORESEE: u16 = 27_200;
const FORESEE_MORE: u16 = 4_000;
/// It is put off again when half of that has passed, but for so much.
const SOONER: u16 = 3_000;
/// From the limit to what is known, ticks, beside what a turn of DIR takes: two groups, and a filler's room.
const CLEAR: u16 = 512;

/// The shortest period, ticks, for each motor; and so many pulses more.
const SHORTEST: u16 = 320;
const PULSES: u16 = 3;
/// The longest pulse, ticks: longer ones are two groups a step, which the task has no time for beside the next slices.
const LONGEST_PULSE: u16 = 31;
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
/// Verbs have the motors.
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
    verbs: Verbs,
    /// Bit by motor: it has no more steps before what is known.
    used_up: u8,
}

const _: () = assert!(size_of::<Place>() <= POOL && MOTORS == MAX_MOTORS);

// Where frames have their queues.
global_asm!(".global verbs_place", ".set verbs_place, queues");

#[expect(improper_ctypes, reason = "no other language knows it")]
unsafe extern "C" {
    static mut verbs_place: Place;
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
pub(crate) fn is_on() -> bool {
    state() == ON
}

/// Has armed motors, which rest with empty queues, do what is ordered, if that can be: from then on verbs have them.
///
/// # Errors
/// [`Reason::SharedDir`]; [`Reason::Timing`]: pulses are too long; as [`Verbs::obey`].
#[inline(never)]
pub(crate) fn begin(orders: &Orders<'_>) -> Result<(), Refusal> {
    let now = clock::moment();
    let stepper = task::lock();
    if TIMES.get().shared {
        return Err(Refusal::of(Reason::SharedDir));
    }
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
        set_state(ON);
    }
    Ok(())
}

/// Has motors do what is ordered. Waits until that can be: it can, unless in what is settled one move ends, the next one begins, and
/// the motor has not come to that; as long as what is settled lasts, at most.
///
/// # Errors
/// As [`Verbs::obey`]; [`Reason::Busy`]: that motor did not come to it.
#[inline(never)]
pub(crate) fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
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
pub(crate) fn encode_obeyed(frame: &mut Encoder<'_>) {
    let guard = task::lock();
    if let Some(place) = place(&guard) {
        let (at, motors) = place.verbs.obeyed();
        orders::encode_obeyed(extended(at), motors, frame);
    }
}

/// Motors were stopped at once, so that what was due a shortest period before [`Stepper::halted`] was made. `dry`: not even that.
#[inline(never)]
pub(crate) fn stop(dry: bool) {
    if is_on() {
        let guard = task::lock();
        if let Some(place) = place(&guard) {
            place.verbs.stop((!dry).then_some(guard.halted()));
        }
        set_state(STOPPED);
    }
}

/// A plan's bytes come where all this is.
pub(crate) fn forget() {
    set_state(NONE);
}

/// Whether nothing is left to be done, if verbs have the motors.
#[inline(never)]
pub(crate) fn rest() -> bool {
    if !is_on() {
        return true;
    }
    let now = clock::moment();
    let guard = task::lock();
    place(&guard).is_none_or(|place| place.verbs.rest_at(now))
}

/// A move that was done and not told yet: motor, tick, number.
#[inline(never)]
pub(crate) fn take_done() -> Option<(u8, Moment, u32)> {
    if state() == NONE {
        return None;
    }
    let now = clock::moment();
    let guard = task::lock();
    place(&guard)?.verbs.take_done(now)
}

/// Nobody tells motors any more: see [`Verbs::forsake`].
#[inline(never)]
pub(crate) fn forsake() {
    let guard = task::lock();
    if let Some(place) = place(&guard) {
        place.verbs.forsake();
    }
}

/// Of the configuration.
fn my_limits() -> Limits {
    // SAFETY: `set_up` alone writes it, while neither main nor the task reads it.
    unsafe { (&raw const LIMITS).read() }
}

/// Notes what the motors of a configuration can do.
#[inline(never)]
pub(crate) fn set_up(configuration: &Configuration<'_>) {
    let Configuration { pulse_ticks, setup_ticks, hold_ticks, .. } = *configuration;
    let motors = configuration.motors().len() as u16;
    let limits = Limits {
        shortest: (SHORTEST + PULSES * pulse_ticks) * motors,
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
    let now = Moment(limit).before(AHEAD);
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
extern "C" fn verbs_load(motor: &mut Motor) -> u8 {
    let number = Stepper::number_of(motor);
    let bit = 1 << number;
    let place = &raw mut verbs_place;
    // SAFETY: as above.
    let place = unsafe { &mut *place };
    if place.used_up & bit != 0 {
        return 1;
    }
    match place.verbs.take(number) {
        Some(steps) => {
            motor.follow(&steps);
            0
        }
        None => {
            place.used_up |= bit;
            1
        }
    }
}
