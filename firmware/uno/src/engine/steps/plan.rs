//! What a motor does next: a batch of steps, or a single event with its tick.
//!
//! # Batches
//! The next steps of a motor are planned as a batch if it only steps, at intervals between [`Times::min_interval`](super::times::Times) and 16 383 ticks
//! that change little. Nobody looks at these steps one by one; the expansion makes them ([`expand`](super::expand)). Most segments are checked as a whole
//! when they are loaded ([`Motor::prechecked`]). Otherwise the plan checks the next 31 steps, or 15, 7, 3 or one.
//!
//! # Events
//! All else is a single event: a step, a turn of DIR, or a filler, which keeps the compare register moving (two events are [`FILLER`] ticks apart at
//! most).
//!
//! # DIR
//! A line turns `dir_early` before its step ([`Times`](super::times::Times)), or later if it is not free until then, but `dir_setup` before it at least.
//! The step is then committed: no switch takes it back.
//!
//! # Cycles
//! A batch takes 30; 85 if the limit is checked, 120 if a switch waits, too; 110 if intervals are checked, 35 more for each halving, and 16 for each step
//! that is counted up to the limit. A single event takes 250 to 400.

use crate::ThisProgram;
use crate::engine::program::Program;
use crate::engine::steps::motor::{EpochBytes, Motor, WAITING_EPOCHS, flag};
use crate::engine::steps::times;
use core::arch::global_asm;
use core::mem::offset_of;

/// Two events of a motor are so far apart at most, ticks. After 2^14 the compare register is a quarter of the way round.
pub(crate) const FILLER: u16 = ThisProgram::FILLER;
const _: () = assert!(FILLER <= 16_384 && FILLER % 256 == 0);

/// For assembly: what the motor Y makes next, if that is steps of a prechecked segment which need no check of the limit. r24: how many are left, up to
/// 255. Otherwise goes to `$slow`, where [`plan`](self) must be asked. Uses r25.
macro_rules! prechecked_steps {
    ($slow:literal) => {
        concat!(
            "
    ldd r24, Y+{FLAGS}
    andi r24, 1 << {TURN} | 1 << {STEPPED} | 1 << {ANCHORED} | 1 << {COMMITTED} | 1 << {SWITCH} | 1 << {SINGLY}
    cpi r24, 1 << {STEPPED} | 1 << {ANCHORED}
    brne ",
            $slow,
            "
    ldd r24, Y+{PRECHECKED}
    andi r24, 0xff - {HIGH_FIXED}
    dec r24
    cpi r24, {LIMIT_CHECK_FROM} - 1
    brsh ",
            $slow,
            "
    ldd r24, Y+{LEFT}
    ldd r25, Y+{LEFT}+1
    cpse r25, r1
    ser r24
    tst r24
    breq ",
            $slow,
            "\n"
        )
    };
}
pub(super) use prechecked_steps;

/// Where in a motor its switch is, after its epochs.
pub(super) const OF_SWITCH: usize = offset_of!(Motor, switch) - offset_of!(Motor, epochs);

global_asm!(
    r#"
    .macro load_4 a, b, c, d, offset
    ldd \a, Y+\offset
    ldd \b, Y+\offset+1
    ldd \c, Y+\offset+2
    ldd \d, Y+\offset+3
    .endm
    .macro store_4 a, b, c, d, offset
    std Y+\offset, \a
    std Y+\offset+1, \b
    std Y+\offset+2, \c
    std Y+\offset+3, \d
    .endm
    .macro load_limit a, b, c, d
    lds \a, steps_times+{LIMIT}
    lds \b, steps_times+{LIMIT}+1
    lds \c, steps_times+{LIMIT}+2
    lds \d, steps_times+{LIMIT}+3
    .endm
    // Compares a to d with the tick at Y+\offset. N: it is before. Uses \temp.
    .macro compare_4 a, b, c, d, offset, temp
    ldd \temp, Y+\offset
    cp \a, \temp
    ldd \temp, Y+\offset+1
    cpc \b, \temp
    ldd \temp, Y+\offset+2
    cpc \c, \temp
    ldd \temp, Y+\offset+3
    cpc \d, \temp
    .endm

    // Drops the bytes of epochs before that of r22. Z points to the epochs of the motor Y. With \if_also, T says whether the epoch being run goes in any
    // case; if not, bytes of the epoch r22 go as well. Uses r20, r21, X, r18, r19.
    .macro drop_epochs if_also
    ldd r26, Y+{NEXT}
    ldd r27, Y+{NEXT}+1
    ldd r18, Y+{END}
    ldd r19, Y+{END}+1
93: ld r20, Z
    ldd r21, Z+1
    add r26, r20
    adc r27, r21
    cp r26, r18
    cpc r27, r19
    brlo 94f
    ldd r20, Y+{START}
    ldd r21, Y+{START}+1
    sub r26, r18
    sbc r27, r19
    add r26, r20
    adc r27, r21
94:
    .if \if_also
    st Z, r1
    std Z+1, r1
    brts 95f
    ldd r20, Z+{EPOCH_RUNNING}
    cp r20, r22
    breq 97f
    .endif
95: ldi r20, {WAITING_EPOCHS} * {EPOCH_SIZE}
96: ldd r21, Z+{EPOCH_SIZE}
    st Z+, r21
    dec r20
    brne 96b
    st Z, r1                            // the last one: no bytes
    std Z+1, r1
    std Z+2, r1
    sbiw r30, {WAITING_EPOCHS} * {EPOCH_SIZE}
    ldd r20, Z+{WAITING}
    subi r20, 1
    brcs 97f
    std Z+{WAITING}, r20
    .if \if_also
    brtc 93b
    .endif
    ldd r21, Z+{EPOCH_RUNNING}
    cp r21, r22
    brne 93b
97: std Z+{EPOCH_RUNNING}, r22
    std Y+{NEXT}, r26
    std Y+{NEXT}+1, r27
    .endm
    // The horizon is not before the switch, whose tick is r18 to r21 then. Uses r26.
    .macro horizon_to_switch
    load_4 r18, r19, r20, r21, {SWITCH_AT}
    compare_4 r18, r19, r20, r21, {HORIZON}, r26
    brmi 98f
    store_4 r18, r19, r20, r21, {HORIZON}
98:
    .endm

    .section .text.steps_plan, "ax", @progbits
    .global steps_settle, steps_plan, plan_slow, plan_window, plan_make_step
    // Works out horizon, last and dir_free from the last step, if that was left to do. Uses r18 to r21, r24, r25.
steps_settle:
    ldd r24, Y+{FLAGS}
    sbrs r24, {STEPPED}
    ret
    andi r24, 0xff - (1 << {STEPPED})
    std Y+{FLAGS}, r24
    load_4 r18, r19, r20, r21, {TICK}
    store_4 r18, r19, r20, r21, {LAST}
    lds r24, steps_times+{STEP_GAP}
    lds r25, steps_times+{STEP_GAP}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    store_4 r18, r19, r20, r21, {HORIZON}
    load_4 r18, r19, r20, r21, {TICK}
    lds r24, steps_times+{DIR_HOLD}
    lds r25, steps_times+{DIR_HOLD}+1
    add r18, r24
    adc r19, r25
    adc r20, r1
    adc r21, r1
    store_4 r18, r19, r20, r21, {DIR_FREE}
    ret
    "#,
    TICK = const offset_of!(Motor, registers) + 2,
    FLAGS = const offset_of!(Motor, flags),
    HORIZON = const offset_of!(Motor, horizon),
    LAST = const offset_of!(Motor, last),
    DIR_FREE = const offset_of!(Motor, dir_free),
    SWITCH_AT = const offset_of!(Motor, switch_at),
    NEXT = const offset_of!(Motor, next),
    START = const offset_of!(Motor, start),
    END = const offset_of!(Motor, end),
    WAITING_EPOCHS = const WAITING_EPOCHS,
    EPOCH_SIZE = const size_of::<EpochBytes>(),
    EPOCH_RUNNING = const offset_of!(EpochBytes, epoch),
    WAITING = const offset_of!(Motor, waiting_epochs) - offset_of!(Motor, epochs),
    STEPPED = const flag::STEPPED,
    LIMIT = const times::LIMIT,
    STEP_GAP = const times::STEP_GAP,
    DIR_HOLD = const times::DIR_HOLD,
);

mod batch;
mod event;
