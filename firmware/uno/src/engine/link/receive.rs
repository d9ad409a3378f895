//! From bytes in the receive page to frames: `pulsetrain_core`'s `Decoder`, in assembly.
//!
//! A frame begins with its length, so that no byte must be held back: bytes of the body go into the buffer and into the CRC at once, and the trailer
//! of three bytes goes behind them. The CRC takes 14 cycles a byte (11 if its halves may swap). It multiplies where others shift: with x = high ^ byte and
//! then x ^= x >> 4, the new CRC is high = low ^ x << 4 ^ x >> 3, low = x ^ x << 5.
//!
//! A byte of the body takes 21.5 cycles, 27.5 if it stands for a zero (crates/board/tests/it/chips/uno_receive.rs measures and holds them).

use super::PAGE;
use crate::engine::regs;
use core::arch::global_asm;
use pulsetrain_core::wire::frame::{Received, Tag, framed_len};

/// The longest body. Two such frames fit into the receive page.
pub(crate) const LONGEST_BODY: usize = 57;

const _: () = assert!(2 * framed_len(LONGEST_BODY) <= super::WINDOW as usize);

/// Where in a frame the next byte is.
mod phase {
    /// The length, or a lone zero.
    pub(super) const START: u8 = 0;
    /// The body, in COBS: codes and bytes.
    pub(super) const BODY: u8 = 1;
    /// The three bytes of the trailer: CRC and tag.
    pub(super) const TRAILER: u8 = 2;
    /// The zero that ends the frame.
    pub(super) const END: u8 = 3;
    /// No valid frame: skip to the next zero.
    pub(super) const NOISE: u8 = 4;
}

/// What `receive_frame` returns if it is not a tag.
const MORE: u8 = 0x40;
const DAMAGED: u8 = 0x80;

/// The frame that is being received.
#[repr(C)]
pub(crate) struct Receiver {
    /// Low byte of the address of the next byte to read.
    tail: u8,
    phase: u8,
    /// Bytes of this phase that are still to come.
    left: u8,
    /// Bytes of this COBS run that are still to come.
    run: u8,
    /// The CRC so far, high byte first.
    sum: [u8; 2],
    /// Bytes of the body.
    len: u8,
    /// Where the next byte goes.
    at: u16,
    /// A zero, as COBS has one before each body; the body; and the trailer.
    body: [u8; 1 + LONGEST_BODY + 3],
    /// `receive_lap` when the tail was last at the beginning of the page.
    lap: u8,
    /// `receive_lost` when that was asked last.
    lost: u8,
}

const _: () = assert!(core::mem::offset_of!(Receiver, at) == AT as usize);
const _: () = assert!(core::mem::offset_of!(Receiver, body) == BODY as usize);

const AT: u8 = 7;
const BODY: u8 = 9;

// receive_frame: takes bytes from the receive page until a frame ends, or `count` are taken.
//   r24:25  the Receiver (then Y)
//   r22     count (then r25)
//   r24     result: the tag of a frame, MORE or DAMAGED
// Inside:
//   r18 r19 CRC, high and low
//   r20 r21 run, left
//   r22 r23 16 and 32: multiplying by them shifts
//   X       where the next byte goes
//   Z       the receive page
global_asm!(
    r#"
    .macro crc                          // one more byte, r24, into r18 and r19; 14
    eor r18, r24
    mul r18, r22
    eor r18, r1
    mul r18, r22
    eor r19, r0
    mul r18, r23
    eor r19, r1
    eor r18, r0
    mov r0, r18
    mov r18, r19
    mov r19, r0
    .endm

    .macro next none_left               // the next byte in r24, and whether it is a zero; 6
    subi r25, 1
    brcs \none_left
    ld r24, Z+
    andi r30, {PAGE} - 1
    tst r24
    .endm

    .section .text.receive_frame, "ax", @progbits
    .global receive_frame
receive_frame:
    push r28
    push r29
    movw r28, r24
    ldd r30, Y+0
    ldi r31, hi8(receive_page)
    ldd r21, Y+2
    ldd r20, Y+3
    ldd r18, Y+4
    ldd r19, Y+5
    ldd r26, Y+{AT}
    ldd r27, Y+{AT}+1
    mov r25, r22
    ldi r22, 16
    ldi r23, 32
    ldd r24, Y+1
    cpi r24, {IN_BODY}
    brlo 1f
    brne .+2
    rjmp 2f
    cpi r24, {END}
    brsh .+2
    rjmp 4f
    brne 6f
    rjmp 5f

    // The length has an even number of ones, and is not too long.
1:  next 11f
    breq 1b                             // a lone zero
    mov r0, r24
    swap r0
    eor r0, r24
    mov r18, r0
    lsr r18
    lsr r18
    eor r18, r0
    mov r0, r18
    lsr r0
    eor r0, r18
    sbrc r0, 0
    rjmp 6f
    mov r21, r24
    lsr r21
    cpi r21, {MAX} + 1
    brsh 6f
    std Y+6, r21
    inc r21                             // and the first code, whose zero goes before the body
    clr r20
    movw r26, r28
    adiw r26, {BODY}
    ldi r18, 0xff
    ldi r19, 0xff
    rcall 18f
    rjmp 2f

6:  next 15f
    brne 6b
7:  ldi r24, {DAMAGED}
9:  ldi r25, {START}
10: std Y+1, r25
    std Y+0, r30
    std Y+2, r21
    std Y+3, r20
    std Y+4, r18
    std Y+5, r19
    std Y+{AT}, r26
    std Y+{AT}+1, r27
    clr r1
    pop r29
    pop r28
    ret

11: ldi r25, {START}
    rjmp 16f
12: ldi r25, {IN_BODY}
    rjmp 16f
13: ldi r25, {TRAILER}
    rjmp 16f
14: ldi r25, {END}
    rjmp 16f
15: ldi r25, {NOISE}
16: ldi r24, {MORE}
    rjmp 10b

4:  next 13b
    breq 17f
    st X+, r24
    dec r21
    brne 4b

5:  next 14b
    brne 19f
    cpse r20, r21                       // 0: the last run is complete
17: rjmp 7b
    ld r25, -X
    mov r24, r25
    lsr r24
    lsr r24
    andi r24, 31
    rcall 18f
    mov r21, r25                        // 1, tag, and the CRC's bits 1 and 0
    eor r21, r19
    andi r21, 3
    brne 17b
    sbrs r25, 7
    rjmp 7b
    mov r21, r18                        // 1, bits 15 to 9
    sec
    ror r21
    mov r25, r19                        // 1, bits 8 to 2
    ror r25
    sec
    ror r25
    ld r0, -X
    cpse r0, r25
    rjmp 7b
    ld r0, -X
    cpse r0, r21
    rjmp 7b
    rjmp 9b
19: rjmp 6b

18: crc
    ret

    // r17 bytes in one go: as many as have come, up to the end of the body or of the page.
2:  mov r0, r21
    cp r25, r0
    brsh 20f
    mov r0, r25
20: ldi r24, {PAGE}
    sub r24, r30
    cp r24, r0
    brsh 20f
    mov r0, r24
20: tst r0
    brne .+2
    rjmp 12b
    sub r25, r0
    sub r21, r0
    push r17
    mov r17, r0
21: ld r24, Z+                          // 2
    tst r24                             // 1
    breq 25f                            // 1
    crc                                 // 14
    subi r20, 1                         // 1
    brcs 26f                            // 1
3:  st X+, r24                          // 2
    dec r17                             // 1
    brne 21b                            // 2                            25
    pop r17
    andi r30, {PAGE} - 1
    tst r21
    brne 2b
    ldi r21, 3
    rjmp 4b
    // A zero inside the body: damaged.
25: pop r17
    andi r30, {PAGE} - 1
    rjmp 7b
    // A COBS code: it stands for the zero before it, and says how far the next one is. 6 more
26: mov r20, r24
    dec r20
    clr r24
    rjmp 3b
    "#,
    PAGE = const PAGE,
    AT = const AT,
    BODY = const BODY,
    MAX = const LONGEST_BODY,
    START = const phase::START,
    IN_BODY = const phase::BODY,
    TRAILER = const phase::TRAILER,
    END = const phase::END,
    NOISE = const phase::NOISE,
    MORE = const MORE,
    DAMAGED = const DAMAGED,
);

unsafe extern "C" {
    fn receive_frame(receiver: *mut Receiver, count: u8) -> u8;
    static receive_page: u8;
    /// The interrupt's: it toggles between 0x80 and 0 at each end of the page.
    static mut receive_lap: u8;
    /// The interrupt's: counts bytes that the USART lost, modulo 256.
    static mut receive_lost: u8;
}

/// What has come from the line.
pub(crate) struct Unread {
    /// Bytes that wait to be read.
    pub(crate) bytes: u8,
    /// Bytes that were lost since this was asked last, at least.
    pub(crate) lost: u8,
}

impl Receiver {
    /// Between two frames.
    pub(crate) const fn new() -> Receiver {
        Receiver {
            tail: 0,
            phase: phase::START,
            left: 0,
            run: 0,
            sum: [0; 2],
            len: 0,
            at: 0,
            body: [0; 1 + LONGEST_BODY + 3],
            lap: 0,
            lost: 0,
        }
    }

    /// Drops all bytes that have come.
    pub(crate) fn reset(&mut self) {
        (self.tail, self.lap) = head();
        self.phase = phase::START;
    }

    /// How many bytes wait. If more came than the page can hold, all of them are dropped, and counted as lost.
    #[inline(always)]
    pub(crate) fn unread(&mut self) -> Unread {
        let (head, lap) = head();
        // SAFETY: one byte, which the interrupt may write at any time.
        let mut lost = unsafe { (&raw const receive_lost).read_volatile() };
        lost = lost.wrapping_sub(core::mem::replace(&mut self.lost, lost));
        let mut bytes = (head | lap).wrapping_sub(self.tail | self.lap);
        if bytes >= PAGE {
            lost = lost.saturating_add(bytes);
            bytes = 0;
            (self.tail, self.lap) = (head, lap);
            self.phase = phase::NOISE;
        }
        Unread { bytes, lost }
    }
}

/// For the winch's reader of lines.
impl Receiver {
    /// How many bytes wait, if none were overwritten.
    #[inline(always)]
    pub(crate) fn waiting(&self) -> u8 {
        regs::EEARL.read().wrapping_sub(self.tail) & (PAGE - 1)
    }

    /// The address of the byte to read after `count` others. After the end of the page it goes on at its beginning.
    #[inline(always)]
    pub(crate) fn after(&self, count: u8) -> *const u8 {
        (&raw const receive_page).wrapping_add(usize::from(self.tail.wrapping_add(count) & (PAGE - 1)))
    }

    /// Whether the byte that was taken last ends a line; true once for each. `seen` is the tail when that was asked last. If it has changed the answer is
    /// false: only a byte after which nothing came ends a line, not one in the middle of a frame.
    #[inline(always)]
    pub(crate) fn ends_line(&self, seen: &mut u8) -> bool {
        if core::mem::replace(seen, self.tail) != self.tail {
            return false;
        }
        let last = self.after(PAGE - 1).cast_mut();
        // SAFETY: this byte has been taken: nobody reads it, and the interrupt may write over it.
        unsafe {
            let is_end = last.read_volatile() == b'\n';
            last.write_volatile(0);
            is_end
        }
    }

    /// Drops `count` bytes that belong to no frame.
    #[inline(always)]
    pub(crate) fn skip(&mut self, count: u8) {
        let tail = self.tail + count;
        if tail >= PAGE {
            self.lap ^= PAGE;
        }
        self.tail = tail & (PAGE - 1);
    }
}

impl Receiver {
    /// Takes up to `count` bytes, up to the end of a frame.
    #[inline(always)]
    pub(crate) fn take(&mut self, count: u8) -> Received {
        let before = self.tail;
        // SAFETY: `count` bytes wait. The interrupt writes over none of them until the tail has passed, and moves its head past a byte only after it has
        // written it.
        let result = unsafe { receive_frame(self, count) };
        if self.tail < before {
            self.lap ^= PAGE;
        }
        match result {
            DAMAGED => Received::Damaged,
            MORE => Received::More,
            tag => Received::Frame(Tag(tag)),
        }
    }

    /// The body of the frame that was completed last, valid until the next byte is taken.
    #[inline(always)]
    pub(crate) fn body(&self) -> &[u8] {
        self.body.get(1..=usize::from(self.len)).unwrap_or_default()
    }

    /// Waits a while for a byte, awake, and gives how many ticks it waited. It does not sleep, because an interrupt that ends a sleep is 4 cycles later.
    #[inline(always)]
    pub(crate) fn watch(&self) -> u16 {
        regs::watch_while_head_is(self.tail)
    }

    /// Sleeps until an interrupt has run, unless bytes wait.
    #[inline(always)]
    pub(crate) fn sleep(&self) {
        regs::sleep_while_head_is(self.tail);
    }
}

/// Where the next byte from the line goes: low byte of its address, and the lap. Interrupts are off for 5 cycles.
#[inline(always)]
fn head() -> (u8, u8) {
    // SAFETY: as in `unread`.
    regs::critical(|| (regs::EEARL.read(), unsafe { (&raw const receive_lap).read_volatile() }))
}
