//! The map of the 2048 bytes of RAM.
//!
//! | address | bytes | what |
//! |---|---|---|
//! | 0x100 | 128 | receive page: bytes from the line |
//! | 0x180 | 72 | [`Receiver`]: the frame that is being received |
//! | 0x1c8 | 56 | the reply that is being sent |
//! | 0x200 | 256 | ring A; the only ring, if one is enough |
//! | 0x300 | 256 | ring B; or the lists of a merge (and behind them the winch's trains, or the short ring B of the shield); or more of the queues |
//! | 0x400 | [`POOL`] | the motors' queues; in uno-winch the paths, the reader and the line that is being sent; in uno-verbs the motors' orders |
//! | then | | initialised variables, then others |
//! | to 0x900 | at least 245 | stack, downwards: tests saw 192 used at most |
//! | | uno-winch 235, uno-verbs 270 | tests saw 154 and 248 used at most |
//!
//! In uno-baked the first page has the motion's state, and nothing else.
//!
//! memory.ld makes the linker refuse another layout, or less stack. `cargo xtask firmware uno` prints the sizes. The start-up code does not initialise
//! what is below the variables.

use crate::ThisProgram;
use crate::engine::link::Receiver;
use crate::engine::program::Program;
use crate::engine::regs;
use core::arch::global_asm;
use core::mem::MaybeUninit;
use pulsetrain_core::wire::message::QUEUE_PARTS;

/// Bytes of all motors' queues together. There are [`PAGE`] more where one ring is enough and nothing is merged.
pub(crate) const POOL: usize = ThisProgram::POOL;
/// Bytes of a ring.
const PAGE: usize = pulsetrain_core::boards::uno::RING_BYTES;
/// Room for the longest reply: Status of four motors, and a zero before it.
pub(crate) const REPLY_LEN: usize = 56;

const _: () = assert!(crate::engine::link::PAGE as usize + size_of::<Receiver>() + REPLY_LEN == PAGE);

global_asm!(
    r#"
    .section .pages, "aw", @nobits
    .p2align 8
    .global receive_page, receiver, reply, ring_a_page, ring_b_page, queues
receive_page: .skip {RECEIVE_PAGE}
receiver:     .skip {RECEIVER}
reply:        .skip {REPLY}
ring_a_page:  .skip {PAGE}
ring_b_page:  .skip {PAGE}
queues:       .skip {POOL}
    "#,
    RECEIVE_PAGE = const crate::engine::link::PAGE,
    RECEIVER = const size_of::<Receiver>(),
    REPLY = const REPLY_LEN,
    PAGE = const PAGE,
    POOL = const POOL,
);

/// High bytes of the addresses of rings A and B.
pub(crate) const RING_PAGES: [u8; 2] = [2, 3];

unsafe extern "C" {
    static mut receive_page: u8;
}

/// The first page, zeroed, in a program without a line.
///
/// # Safety
/// Only once, and in place of [`take`].
pub(crate) unsafe fn take_first_page<T>() -> &'static mut MaybeUninit<T> {
    const { assert!(size_of::<T>() <= PAGE && align_of::<T>() <= PAGE) };
    let page = (&raw mut receive_page).cast::<MaybeUninit<T>>();
    // SAFETY: the page has so many bytes, and belongs to the caller.
    unsafe {
        page.cast::<u8>().write_bytes(0, PAGE);
        &mut *page
    }
}

unsafe extern "C" {
    static mut receiver: MaybeUninit<Receiver>;
    static mut reply: [u8; REPLY_LEN];
}

unsafe extern "C" {
    static ring_b_page: u8;
    static queues: u8;
}

/// The receiver and the buffer for replies.
///
/// # Safety
/// Only once.
pub(crate) unsafe fn take() -> (&'static mut Receiver, &'static mut [u8; REPLY_LEN]) {
    let (frame, bytes) = (&raw mut receiver, &raw mut reply);
    // SAFETY: the caller's promise. Any bytes are a valid reply.
    unsafe { ((*frame).write(Receiver::new()), &mut *bytes) }
}

/// First address and length, in bytes, of the memory that all motors' queues share. `with_page`: it includes page B, which nothing else uses then.
#[inline(always)]
pub(crate) fn queue_memory(with_page: bool) -> (u16, u16) {
    // Only addresses are taken.
    let (start, bytes) =
        if with_page { ((&raw const ring_b_page).addr(), PAGE + POOL) } else { ((&raw const queues).addr(), POOL) };
    (start as u16, bytes as u16)
}

/// Bytes for the queue of one of `motors` motors, of `bytes` in all: `parts` of [`QUEUE_PARTS`] parts, or an equal share if `parts` is 0.
#[inline(never)]
pub(crate) fn queue_len(bytes: u16, motors: u8, parts: u8) -> u16 {
    const { assert!((PAGE + POOL) as u32 * (QUEUE_PARTS as u32) < 1 << 16 && QUEUE_PARTS == 64) };
    if parts != 0 {
        return (bytes * u16::from(parts)) >> 6;
    }
    // Divides by subtracting: it runs once a motor, and a division would take more flash.
    let (mut each, mut left) = (0, bytes);
    while left >= u16::from(motors) {
        left -= u16::from(motors);
        each += 1;
    }
    each
}

// queue_fill: 7 cycles a byte.
//   r24:25  where the first byte goes (then X)
//   r22:23  the queue's first address, and
//   r20:21  its last + 1
//   r18:19  the bytes (then Z)
//   r16     how many, not 0
// Inside, r20 counts the bytes up to the queue's end, and r24 those that go on at its beginning.
global_asm!(
    r#"
    .section .text.queue_fill, "ax", @progbits
    .global queue_fill
queue_fill:
    movw r26, r24
    movw r30, r18
    sub r20, r26
    sbc r21, r27
    tst r21
    brne 1f
    cp r20, r16
    brlo 2f
1:  mov r20, r16
2:  mov r24, r16
    sub r24, r20
3:  ld r25, Z+                          // 2
    st X+, r25                          // 2
    dec r20                             // 1
    brne 3b                             // 2                            7
    movw r26, r22
    add r20, r24
    mov r24, r1
    brne 3b
    ret
    "#
);

unsafe extern "C" {
    fn queue_fill(at: u16, start: u16, end: u16, bytes: *const u8, len: u8);
}

/// Writes `bytes`, 1 to 255, into the queue between `start` and `end`, from `at` on.
#[inline(always)]
pub(crate) fn fill_queue(at: u16, start: u16, end: u16, bytes: &[u8]) {
    // SAFETY: `at` is inside what `queue_memory` gave, to which no reference exists. The assembly does not read these bytes yet.
    unsafe { queue_fill(at, start, end, bytes.as_ptr(), bytes.len() as u8) };
}

// add_to: adds r22:23 to the number of r20 bytes at r24:25.
global_asm!(
    r#"
    .section .text.add_to, "ax", @progbits
    .global add_to
add_to:
    movw r30, r24
1:  ld r24, Z
    add r24, r22
    st Z+, r24
    mov r22, r23
    ldi r23, 0
    adc r22, r1
    adc r23, r1
    mov r24, r22
    or r24, r23
    breq 2f                             // no more, as nearly always
    dec r20
    brne 1b
2:  ret
    "#,
);

unsafe extern "C" {
    fn add_to(number: *mut u8, amount: u16, bytes: u8);
}

/// Adds to a number of `BYTES` bytes, which may wrap. The compiler's own code would take four times as much flash.
#[inline(always)]
pub(crate) fn add<T>(number: &mut T, amount: u16) {
    // SAFETY: the number has so many bytes, and any bytes are a valid integer.
    unsafe { add_to((&raw mut *number).cast(), amount, size_of::<T>() as u8) };
}

/// The free stack is filled with this at start-up, so that its deepest use can be seen later.
pub(crate) const PAINT: u8 = 0xc5;

unsafe extern "C" {
    /// The first byte of the stack, as the linker has it.
    static mut _end: u8;
    static mut reset_note: u16;
    #[link_name = "end_of_program"]
    safe fn stop_and_reset() -> !;
}

/// See [`reset::end`](crate::engine::reset::end).
pub(crate) fn end_of_program() -> ! {
    stop_and_reset()
}

/// Replaces the reset note, and gives the old one.
pub(crate) fn exchange_reset_note(new: u16) -> u16 {
    // SAFETY: only `end_of_program` writes it too, and that does not return. Any bytes are valid.
    unsafe {
        let old = (&raw const reset_note).read_volatile();
        (&raw mut reset_note).write_volatile(new);
        old
    }
}

/// Fills the free stack with [`PAINT`]. Main must call it first.
#[inline(always)]
pub(crate) fn paint_stack() {
    let mut at = &raw mut _end;
    // Main itself uses less than 32 bytes of stack here.
    let end = usize::from(regs::SP.read()) - 32;
    while at.addr() < end {
        // SAFETY: nothing lies between the end of all statics and the stack pointer.
        unsafe { at.write_volatile(PAINT) };
        at = at.wrapping_add(1);
    }
}

/// Bytes of stack that were never used.
pub(crate) fn stack_left() -> u16 {
    let mut left = 0;
    let mut at = &raw const _end;
    // SAFETY: the loop ends at the first byte that the stack has used.
    while unsafe { at.read_volatile() } == PAINT {
        at = at.wrapping_add(1);
        left += 1;
    }
    left
}

/// A value that exists once. Main takes it, and nobody else.
pub(crate) struct Singleton<T>(core::cell::UnsafeCell<T>);

// SAFETY: `take` hands it out once, to main. Interrupts do not use it.
unsafe impl<T> Sync for Singleton<T> {}

impl<T> Singleton<T> {
    /// `value`, to be taken.
    pub(crate) const fn new(value: T) -> Singleton<T> {
        Singleton(core::cell::UnsafeCell::new(value))
    }

    /// Takes it.
    ///
    /// # Safety
    /// Only once.
    #[expect(clippy::mut_from_ref, reason = "only once")]
    pub(crate) unsafe fn take(&'static self) -> &'static mut T {
        // SAFETY: the caller's promise.
        unsafe { &mut *self.0.get() }
    }
}

// The compiler calls these to copy and fill memory. Those of compiler_builtins are made for large machines and take a thousand bytes.
// Arguments are in r24:25, r22:23 and r20:21, the result in r24:25 (the convention of avr-gcc).
global_asm!(
    r#"
    .section .text.memory, "ax", @progbits
    .global memcpy, memmove, memset
memmove:
    cp r22, r24
    cpc r23, r25
    brsh memcpy                 // the source is behind: forwards
    movw r30, r22
    movw r26, r24
    add r30, r20                // backwards, from the ends
    adc r31, r21
    add r26, r20
    adc r27, r21
    rjmp 2f
1:  ld r0, -Z
    st -X, r0
2:  subi r20, 1
    sbci r21, 0
    brcc 1b
    ret
memcpy:
    movw r30, r22
    movw r26, r24
    rjmp 2f
1:  ld r0, Z+                   // 8 cycles a byte
    st X+, r0
2:  subi r20, 1
    sbci r21, 0
    brcc 1b
    ret
memset:
    movw r26, r24
    rjmp 2f
1:  st X+, r22
2:  subi r20, 1
    sbci r21, 0
    brcc 1b
    ret
    "#
);
