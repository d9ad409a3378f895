//! The 2048 bytes of RAM, and what each is for.
//!
//! | address | bytes | what |
//! |---|---|---|
//! | 0x100 | 128 | receive page: what the USART's interrupt takes |
//! | 0x180 | 72 | [`Receiver`]: the frame that is coming in |
//! | 0x1c8 | 56 | the reply being sent |
//! | 0x200 | 256 | ring A; the only ring, if one is enough |
//! | 0x300 | 256 | ring B; the lists of a merge (and trains of the winch, in what its lists leave; or a ring behind three of them); else more of the queues |
//! | 0x400 | [`POOL`] | the motors' queues; while text is on, the winch's paths, its reader and the line being sent; while verbs have the motors, what they do |
//! | then | | initialised variables, others |
//! | to 0x900 | at least 245 | stack, downwards: 192 is the most that a test saw |
//! | | of uno-winch 235, of uno-verbs 270 | 154 and 248 are the most that tests saw |
//!
//! In uno-baked the first page has its motion, and nothing else.
//!
//! memory.ld makes the linker refuse an image that is laid out otherwise, or has less stack; `cargo xtask firmware uno` prints
//! what came out. Up to the queues nothing is set at start-up by the code that sets variables.

use crate::ThisProgram;
use crate::engine::link::Receiver;
use crate::engine::program::Program;
use crate::engine::regs;
use core::arch::global_asm;
use core::mem::MaybeUninit;
use pulsetrain_core::wire::message::QUEUE_PARTS;

/// Bytes of all motors' queues together; [`PAGE`] more where one ring and no merge serves them.
pub(crate) const POOL: usize = ThisProgram::POOL;
/// Bytes of a ring.
const PAGE: usize = 256;
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

/// The first page, zeros, where nobody is heard.
///
/// # Safety
/// Only once, and in place of [`take`].
pub(crate) unsafe fn take_first_page<T>() -> &'static mut MaybeUninit<T> {
    const { assert!(size_of::<T>() <= PAGE && align_of::<T>() <= PAGE) };
    let page = (&raw mut receive_page).cast::<MaybeUninit<T>>();
    // SAFETY: it has so many bytes, and is the caller's.
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

/// What there is one of in these pages.
///
/// # Safety
/// Only once.
pub(crate) unsafe fn take() -> (&'static mut Receiver, &'static mut [u8; REPLY_LEN]) {
    let (frame, bytes) = (&raw mut receiver, &raw mut reply);
    // SAFETY: the caller's promise; any byte is one of a reply.
    unsafe { ((*frame).write(Receiver::new()), &mut *bytes) }
}

/// First address and length, in bytes, of the memory that all motors' queues share. `with_page`: it includes page B, which nothing else uses then.
#[inline(always)]
pub(crate) fn queue_memory(with_page: bool) -> (u16, u16) {
    // Only addresses are taken here.
    let (start, bytes) =
        if with_page { ((&raw const ring_b_page).addr(), PAGE + POOL) } else { ((&raw const queues).addr(), POOL) };
    (start as u16, bytes as u16)
}

/// Bytes of the queue of one of `motors` motors, of `bytes` in all: so many parts of them ([`QUEUE_PARTS`]), or an equal part.
#[inline(never)]
pub(crate) fn queue_len(bytes: u16, motors: u8, parts: u8) -> u16 {
    const { assert!((PAGE + POOL) as u32 * (QUEUE_PARTS as u32) < 1 << 16 && QUEUE_PARTS == 64) };
    if parts != 0 {
        return (bytes * u16::from(parts)) >> 6;
    }
    // Divided by subtracting: it is done once a motor, and a division takes more of the flash.
    let (mut each, mut left) = (0, bytes);
    while left >= u16::from(motors) {
        left -= u16::from(motors);
        each += 1;
    }
    each
}

// queue_fill: 7 cycles a byte.
//   r24:25  where the first byte goes, in X then
//   r22:23  the queue's first address, and
//   r20:21  last + 1
//   r18:19  the bytes, in Z then
//   r16     how many, not 0
// Inside, r20 counts up to the queue's end; r24 is what goes on at its beginning.
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
    // SAFETY: `at` is inside what `queue` gave, of which no reference exists; the assembly reads it at other times.
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

/// Adds to a number of `BYTES` bytes, which may wrap. The compiler's own way takes four times as much of the flash.
#[inline(always)]
pub(crate) fn add<T>(number: &mut T, amount: u16) {
    // SAFETY: it has so many bytes, and any are an integer.
    unsafe { add_to((&raw mut *number).cast(), amount, size_of::<T>() as u8) };
}

/// What the stack is filled with at start-up, to see later how far it came.
pub(crate) const PAINT: u8 = 0xc5;

unsafe extern "C" {
    /// The first byte after everything that is not stack: the linker's.
    static mut _end: u8;
    static mut reset_note: u16;
    #[link_name = "end_of_program"]
    safe fn stop_and_reset() -> !;
}

/// See [`reset::end`](crate::engine::reset::end).
pub(crate) fn end_of_program() -> ! {
    stop_and_reset()
}

/// What the reset note said, and what it says from now on.
pub(crate) fn exchange_reset_note(new: u16) -> u16 {
    // SAFETY: only `end_of_program` touches it too, and that does not return. Any bytes are valid.
    unsafe {
        let old = (&raw const reset_note).read_volatile();
        (&raw mut reset_note).write_volatile(new);
        old
    }
}

/// Fills the free stack with [`PAINT`]; to be called first, from main.
#[inline(always)]
pub(crate) fn paint_stack() {
    let mut at = &raw mut _end;
    // Well below what main itself has on the stack.
    let end = usize::from(regs::SP.read()) - 32;
    while at.addr() < end {
        // SAFETY: between the end of all statics and the stack pointer there is nothing.
        unsafe { at.write_volatile(PAINT) };
        at = at.wrapping_add(1);
    }
}

/// Bytes of stack that were never used.
pub(crate) fn stack_left() -> u16 {
    let mut left = 0;
    let mut at = &raw const _end;
    // SAFETY: the loop ends at the first byte that the stack used, at the latest at the stack itself.
    while unsafe { at.read_volatile() } == PAINT {
        at = at.wrapping_add(1);
        left += 1;
    }
    left
}

/// Something there is one of, which main takes and nobody else.
pub(crate) struct Singleton<T>(core::cell::UnsafeCell<T>);

// SAFETY: `take` hands it out once, to main; interrupts do not know of it.
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

// What the compiler calls to copy and fill memory: compiler_builtins' own are fast on large machines, and take a
// thousand bytes here. Arguments are in r24:25, r22:23 and r20:21, the result in r24:25 (avr-gcc's convention).
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
