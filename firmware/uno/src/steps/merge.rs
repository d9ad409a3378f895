//! Two to four motors in one ring: each has a list of ticks, and the merge takes the earliest of their heads.
//!
//! # Lists
//! A lane is one motor: up to 32 ticks that all toggle the same pins. When its list is used up, the merge expands the next
//! batch itself as long as Rust granted steps ([`Lane::blind`]); else it hands back to Rust, which puts a single tick there
//! (a change of direction, half a long pulse, a filler: anything), or grants more.
//! All heads lie within 32 767 ticks of each other; lanes with nothing to do get fillers, masks 0.
//!
//! # Spacing
//! Groups are at least W ticks apart, so that the interrupt has set the compare register before the next match, even if
//! something kept it waiting. A tick less than W/2 after the last group (or before it) joins that group; one from W/2
//! to W after it is put off to W. So no edge is early or late by more than W/2. Two ticks that toggle
//! the same pin never share a group.
//!
//! W ≥ (match to compare register written) + (the longest that an interrupt is kept waiting: the receive interrupt's 24 cycles and
//! an instruction of main's), and W ≥ the interrupt's length + 4, so that delays die out: 52 for the short pulse.
//!
//! # Cycles
//! A step: 34 or 35, and expansion's 18.5; 150 + 90 around a batch; 180 to hand over to Rust and back.

use core::arch::global_asm;
use core::mem::offset_of;

use super::expand::{self, Registers};
use super::ring::Group;

/// Motors at most.
pub const LANES: usize = 4;

/// Ticks that a lane's list holds.
pub const LIST: u8 = 32;

/// One motor's list.
#[derive(Debug)]
#[repr(C)]
pub struct Lane {
    /// What the ticks in the list toggle.
    masks: Group,
    /// What steps toggle: those that the merge expands itself.
    step: Group,
    /// Steps that may be expanded without asking.
    blind: u8,
    /// Steps to expand at once, 1..=32.
    batch: u8,
    /// The segment being run.
    registers: *mut Registers,
    /// The list's first tick, taken out of it.
    head: u16,
    /// Low byte of the address of the second.
    next: u8,
}

/// State of the merge; the assembly knows its layout.
#[derive(Debug)]
#[repr(C)]
pub struct Merge {
    lanes: [Lane; LANES],
    /// The tick of the pending group + W.
    deadline: u16,
    /// What the pending group toggles.
    pending: Group,
    /// Low byte of the address of the pending group.
    at: u8,
    /// The ring's END bit.
    end: u8,
    /// W/2 and W.
    half: u8,
    spacing: u8,
    /// The lane without a head, if any.
    wanting: Option<u8>,
    /// Lanes of motors; those after them get fillers.
    motors: u8,
    /// What the lanes after them run.
    fillers: Registers,
}

const LANE_SIZE: usize = size_of::<Lane>();

global_asm!(
    r#"
    // While merging:
    //   r2:3 r4:5 r6:7 r8:9           heads of the lanes
    //   r10 to r13                    next of the lanes
    //   r14:15 r20:21 r22:23 r28:29   masks of the lanes, rise and fall
    //   r16:17                        masks of the pending group; END in its rise if it is the first of a batch
    //   r18:19                        deadline: tick of the pending group + W
    //   r24 r25                       W/2, W
    //   r0                            groups that the ring has room for
    //   X                             the pending group's place in the ring
    //   Z                             into the lists' page

    // Makes the lane's head the pending group, and puts the one that was pending into the ring.    18
    .macro put_out low, high, rise, fall, lane
    cp \low, r18                        // 1                            1
    cpc \high, r19                      // 1                            2
    brmi 3f                             // 1                            3
    st X+, r16                          // 2                            5
    st X+, \high                        // 2                            7
    st X+, \low                         // 2                            9
    st X+, r17                          // 2                            11
    ldi r27, hi8(ring_a_page)           // 1                            12
    movw r18, \low                      // 1                            13
1:  add r18, r25                        // 1                            14
    adc r19, r1                         // 1                            15
    movw r16, \rise                     // 1                            16
    dec r0                              // 1                            17
    breq 5f                             // 1                            18
2:
    .endm

    // What is rarer: the tick comes before the deadline.
    .macro put_out_early low, high, rise, fall, lane
3:  movw r30, r18
    sub r30, r24
    sbc r31, r1
    cp \low, r30
    cpc \high, r31
    ldi r31, hi8(ring_b_page)
    brpl 4f
    mov r30, r16
    and r30, \rise
    brne 4f
    mov r30, r17
    and r30, \fall
    brne 4f
    or r16, \rise                       // joins the pending group
    or r17, \fall
    rjmp 2b
4:  st X+, r16                          // put off to the deadline
    st X+, r19
    st X+, r18
    st X+, r17
    ldi r27, hi8(ring_a_page)
    rjmp 1b
5:  ldi r30, \lane
    rjmp merge_full
    .endm

    // The next tick of the lane.                                                                   8
    .macro advance_0
    sbrc r10, 6                         // 2 (skips)                    2
    rcall merge_refill_0
    mov r30, r10                        // 1                            3
    ld r2, Z+                           // 2                            5
    ld r3, Z+                           // 2                            7
    mov r10, r30                        // 1                            8
    .endm
    .macro advance_1
    sbrc r11, 7
    rcall merge_refill_1
    mov r30, r11
    ld r4, Z+
    ld r5, Z+
    mov r11, r30
    .endm
    .macro advance_2
    sbrc r12, 6
    rcall merge_refill_2
    mov r30, r12
    ld r6, Z+
    ld r7, Z+
    mov r12, r30
    .endm
    .macro advance_3                    // this list ends with its page                             9
    sbrs r13, 7
    rcall merge_refill_3
    mov r30, r13
    ld r8, Z+
    ld r9, Z+
    mov r13, r30
    ldi r31, hi8(ring_b_page)
    .endm

    // Lane a (0 or 1) has the earlier head of the first two, b (2 or 3) of the others.             34 to 36
    .macro merge_state name, a_low, a_high, a_rise, a_fall, a, b_low, b_high, b_rise, b_fall, b
\name:
    cp \a_low, \b_low                   // 1                            1
    cpc \a_high, \b_high                // 1                            2
    brmi .+2                            // 2, or 1 and 2                4 or 5
    rjmp 6f
    put_out \a_low, \a_high, \a_rise, \a_fall, \a //                    22
    advance_\a                          //                              30
    cp r2, r4                           // 1                            31
    cpc r3, r5                          // 1                            32
    brmi .+2                            // 2, or 1                      34
    rjmp merge_1\b                      // 2                            35
    rjmp merge_0\b                      // 2                            36
    put_out_early \a_low, \a_high, \a_rise, \a_fall, \a
6:  put_out \b_low, \b_high, \b_rise, \b_fall, \b //                    23
    advance_\b                          //                              31 or 32
    cp r6, r8
    cpc r7, r9
    brmi .+2
    rjmp merge_\a\()3
    rjmp merge_\a\()2                   //                              37
    put_out_early \b_low, \b_high, \b_rise, \b_fall, \b
    .endm

    .macro load_masks                   //                              20
    lds r14, steps_merge+{LANE0}+{RISE}
    lds r15, steps_merge+{LANE0}+{FALL}
    lds r20, steps_merge+{LANE1}+{RISE}
    lds r21, steps_merge+{LANE1}+{FALL}
    lds r22, steps_merge+{LANE2}+{RISE}
    lds r23, steps_merge+{LANE2}+{FALL}
    lds r28, steps_merge+{LANE3}+{RISE}
    lds r29, steps_merge+{LANE3}+{FALL}
    lds r24, steps_merge+{HALF}
    lds r25, steps_merge+{SPACING}
    .endm

    .macro each_head what
    \what 2, {LANE0}+{HEAD}
    \what 3, {LANE0}+{HEAD}+1
    \what 4, {LANE1}+{HEAD}
    \what 5, {LANE1}+{HEAD}+1
    \what 6, {LANE2}+{HEAD}
    \what 7, {LANE2}+{HEAD}+1
    \what 8, {LANE3}+{HEAD}
    \what 9, {LANE3}+{HEAD}+1
    \what 10, {LANE0}+{NEXT}
    \what 11, {LANE1}+{NEXT}
    \what 12, {LANE2}+{NEXT}
    \what 13, {LANE3}+{NEXT}
    \what 17, {PENDING_FALL}
    \what 18, {DEADLINE}
    \what 19, {DEADLINE}+1
    .endm
    .macro fetch register, offset
    lds r\register, steps_merge+\offset
    .endm
    .macro store register, offset
    sts steps_merge+\offset, r\register
    .endm

    .section .text.steps_merge_run, "ax", @progbits
    .global steps_merge_run
    // r24:25: the state, steps_merge; r22: groups that the ring has room for, at least 1. Gives the lane that wants its next tick, + 0x80 if the ring is full.
steps_merge_run:
    .irp r, 2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,17,28,29
    push r\r                            // 18 x 2                       36
    .endr
    mov r0, r22
    each_head fetch                     // 15 x 2                       67
    lds r16, steps_merge+{PENDING_RISE}
    lds r24, steps_merge+{END}
    or r16, r24
    lds r26, steps_merge+{AT}
    ldi r27, hi8(ring_a_page)
    ldi r31, hi8(ring_b_page)
    load_masks                          //                              96
    cp r2, r4
    cpc r3, r5
    brmi 2f
    cp r6, r8
    cpc r7, r9
    brmi 1f
    rjmp merge_13
1:  rjmp merge_12
2:  cp r6, r8
    cpc r7, r9
    brmi 3f
    rjmp merge_03
3:  rjmp merge_02                       //                              106

    merge_state merge_02, r2, r3, r14, r15, 0, r6, r7, r22, r23, 2
    merge_state merge_03, r2, r3, r14, r15, 0, r8, r9, r28, r29, 3
    merge_state merge_12, r4, r5, r20, r21, 1, r6, r7, r22, r23, 2
    merge_state merge_13, r4, r5, r20, r21, 1, r8, r9, r28, r29, 3

    // Publishes what has been put into the ring. Uses r24, r25, Y.     28
merge_publish:
    lds r28, steps_merge+{AT}           // 2
    cp r26, r28                         // 1
    breq 1f                             // 1
    lds r25, steps_merge+{END}          // 2
    st X, r25                           // 2  END where the pending group will be
    ldi r29, hi8(ring_a_page)           // 1
    ld r24, Y                           // 2
    eor r24, r25                        // 1
    st Y, r24                           // 2  and off the first one
    sts steps_merge+{AT}, r26           // 2
    or r16, r25                         // 1
1:  ret                                 // 4, and 3 for the call

    .macro refill lane, next, offset, list_end
merge_refill_\lane:
    rcall merge_publish
    ldi r28, lo8(steps_merge+\offset)
    ldi r29, hi8(steps_merge+\offset)
    ldi r30, \list_end
    ldi r31, \lane
    rcall merge_expand
    mov \next, r30
    ldi r31, hi8(ring_b_page)
    ret
    .endm
    refill 0, r10, {LANE0}, 64
    refill 1, r11, {LANE1}, 128
    refill 2, r12, {LANE2}, 192
    refill 3, r13, {LANE3}, 0

    // Y: the lane; r30: low byte of its list's end. Gives the list's start in r30.
merge_expand:
    ldd r20, Y+{BLIND}
    ldd r21, Y+{BATCH}
    mov r24, r20
    sub r24, r21
    brcc 1f
    clr r24
    mov r21, r20
1:  tst r21
    breq merge_empty
    std Y+{BLIND}, r24
    mov r20, r21
    ldd r24, Y+{STEP_RISE}
    ldd r25, Y+{STEP_FALL}
    std Y+{RISE}, r24
    std Y+{FALL}, r25
    ldd r24, Y+{REGISTERS}
    ldd r25, Y+{REGISTERS}+1
    sub r30, r20
    sub r30, r20
    mov r22, r30
    ldi r23, hi8(ring_b_page)
    push r0
    push r26
    push r27
    push r30
    call steps_expand_list
    pop r30
    pop r27
    pop r26
    pop r0
    load_masks
    ret

    // The lane that has nothing: its refill's return address and the merge's go.
merge_empty:
    mov r24, r31
    pop r0
    pop r0
    pop r0
    pop r0
    rjmp merge_leave

    // r30: the lane that was put out when the ring became full.
merge_full:
    push r30
    rcall merge_publish
    pop r24
    ori r24, 0x80
merge_leave:
    lds r25, steps_merge+{END}
    com r25
    and r16, r25
    sts steps_merge+{PENDING_RISE}, r16
    each_head store
    .irp r, 29,28,17,16,15,14,13,12,11,10,9,8,7,6,5,4,3,2
    pop r\r
    .endr
    ret
    "#,
    LANE0 = const 0,
    LANE1 = const LANE_SIZE,
    LANE2 = const 2 * LANE_SIZE,
    LANE3 = const 3 * LANE_SIZE,
    RISE = const offset_of!(Lane, masks) + offset_of!(Group, rise),
    FALL = const offset_of!(Lane, masks) + offset_of!(Group, fall),
    STEP_RISE = const offset_of!(Lane, step) + offset_of!(Group, rise),
    STEP_FALL = const offset_of!(Lane, step) + offset_of!(Group, fall),
    BLIND = const offset_of!(Lane, blind),
    BATCH = const offset_of!(Lane, batch),
    REGISTERS = const offset_of!(Lane, registers),
    HEAD = const offset_of!(Lane, head),
    NEXT = const offset_of!(Lane, next),
    DEADLINE = const offset_of!(Merge, deadline),
    PENDING_RISE = const offset_of!(Merge, pending) + offset_of!(Group, rise),
    PENDING_FALL = const offset_of!(Merge, pending) + offset_of!(Group, fall),
    AT = const offset_of!(Merge, at),
    END = const offset_of!(Merge, end),
    HALF = const offset_of!(Merge, half),
    SPACING = const offset_of!(Merge, spacing),
);

unsafe extern "C" {
    static mut ring_a_page: [u8; 256];
    static mut ring_b_page: [u8; 256];
    fn steps_merge_run(state: *mut Merge, free: u8) -> u8;
}

const NOTHING: Group = Group { rise: 0, fall: 0 };

/// At most so many ticks from one group to the next, ticks.
const FILLER: u16 = 16_384;

/// The one merge: the assembly knows it by this name.
#[unsafe(export_name = "steps_merge")]
static mut MERGE: Merge = Merge {
    lanes: [const {
        Lane {
            masks: NOTHING,
            step: NOTHING,
            blind: 0,
            batch: 1,
            registers: core::ptr::null_mut(),
            head: 0,
            next: 0,
        }
    }; LANES],
    deadline: 0,
    pending: NOTHING,
    at: 0,
    end: 0,
    half: 0,
    spacing: 0,
    wanting: None,
    motors: 0,
    fillers: Registers { fraction: 0, tick: 0, interval: [0; 5], add: 0, add2: 0, left: 0 },
};

/// Why the merge came back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pause {
    /// The ring has no room.
    Full,
    /// This lane needs its next tick, or steps granted.
    Wants(u8),
}

impl Lane {
    /// Byte after the list of lane `index`.
    fn end(index: u8) -> u8 {
        (index + 1).wrapping_mul(2 * LIST)
    }
}

impl Merge {
    /// The one merge.
    ///
    /// # Safety
    /// To be called once.
    pub unsafe fn take() -> &'static mut Merge {
        // SAFETY: the caller's promise: no other reference exists.
        unsafe { &mut *(&raw mut MERGE) }
    }

    /// Empties everything: the pending group does nothing, at the low 16 bits of the tick `start`. The interrupt must be off.
    pub fn clear(&mut self, motors: u8, spacing: u8, start: u32) {
        self.motors = motors;
        self.spacing = spacing;
        self.half = spacing / 2;
        self.end = super::ring::END_A;
        self.at = 0;
        self.pending = NOTHING;
        self.deadline = (start as u16).wrapping_add(u16::from(spacing));
        self.wanting = None;
        self.fillers = Registers { tick: start, interval: [0, 0, 0, 0x40, 0], left: 1, ..Registers::default() };
        for lane in motors..LANES as u8 {
            self.put(lane, (start as u16).wrapping_add(FILLER), NOTHING);
        }
        // SAFETY: the interrupt is off.
        unsafe {
            self.group(0).write_volatile(self.end);
            super::register::io(super::register::OCR0A).write_volatile(0);
        }
    }

    fn group(&self, at: u8) -> *mut u8 {
        (&raw mut ring_a_page).cast::<u8>().wrapping_add(usize::from(at))
    }

    fn list(&self, at: u8) -> *mut u8 {
        (&raw mut ring_b_page).cast::<u8>().wrapping_add(usize::from(at))
    }

    /// Groups that the ring has room for.
    #[inline(always)]
    pub fn free(&self) -> u8 {
        // SAFETY: one byte, read whole.
        let tail = unsafe { super::register::io(super::register::OCR0A).read_volatile() };
        tail.wrapping_sub(self.at).wrapping_sub(1) / super::ring::GROUP
    }

    /// Gives `lane`, which wants it, the low 16 bits of its next tick, and what is toggled then.
    pub fn put(&mut self, lane: u8, tick: u16, masks: Group) {
        let entry = &mut self.lanes[usize::from(lane)];
        entry.head = tick;
        entry.masks = masks;
        entry.next = Lane::end(lane);
        if self.wanting == Some(lane) {
            self.wanting = None;
        }
    }

    /// Lets the merge expand `steps` steps of `registers` into `lane`, `batch` at a time.
    ///
    /// # Safety
    /// What [`expand`](super::expand) says of the interval, for all of them; `registers` stays where it is until they
    /// are used up.
    pub unsafe fn grant(&mut self, lane: u8, registers: *mut Registers, step: Group, steps: u8, batch: u8) {
        let entry = &mut self.lanes[usize::from(lane)];
        entry.registers = registers;
        entry.step = step;
        entry.blind = steps;
        entry.batch = batch;
    }

    /// The next tick of `lane`, from its list or expanded; whether there is one.
    fn advance(&mut self, lane: u8) -> bool {
        let end = Lane::end(lane);
        let index = usize::from(lane);
        let mut next = self.lanes[index].next;
        if next == end {
            let entry = &mut self.lanes[index];
            // A short first batch, another length for each lane: else motors whose segments begin together would
            // stay in step, and all their work would come at once.
            let n = entry.blind.min(entry.batch).min(8 + 4 * lane);
            if n == 0 {
                return false;
            }
            entry.blind -= n;
            entry.masks = entry.step;
            next = end.wrapping_sub(2 * n);
            let registers = entry.registers;
            // SAFETY: what was promised to `grant`; a lane's list has room for `LIST` ≥ n.
            unsafe { expand::into_list(registers, self.list(next).cast(), n) };
        }
        // SAFETY: main alone uses the lists' page.
        let head = unsafe { [self.list(next).read(), self.list(next.wrapping_add(1)).read()] };
        let entry = &mut self.lanes[index];
        entry.head = u16::from_le_bytes(head);
        entry.next = next.wrapping_add(2);
        true
    }

    /// Merges until the ring is full or a lane wants a tick. All lanes but a wanting one must have a head.
    #[inline(never)]
    pub fn run(&mut self) -> Pause {
        loop {
            if let Some(lane) = self.wanting {
                if !self.advance(lane) {
                    if lane < self.motors {
                        return Pause::Wants(lane);
                    }
                    self.fillers.left = 255;
                    let fillers = &raw mut self.fillers;
                    // SAFETY: the interval is 16 384 and stays; the registers are a static's.
                    unsafe { self.grant(lane, fillers, NOTHING, 2, 2) };
                    continue;
                }
                self.wanting = None;
            }
            let free = self.free();
            if free == 0 {
                return Pause::Full;
            }
            // SAFETY: all heads are set, and the ring has room for `free` groups.
            let answer = unsafe { steps_merge_run(self, free) };
            self.wanting = Some(answer & 3);
            if answer & 0x80 != 0 {
                return Pause::Full;
            }
        }
    }
}
