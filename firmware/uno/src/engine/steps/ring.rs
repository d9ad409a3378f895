//! The rings: what the step interrupts play.
//!
//! # A ring
//! One 256-byte page of 64 groups of four bytes: `[at_tick, high byte of next, low byte of next, at_end]`. At a group's tick the interrupt toggles the
//! pins in `at_tick`. Then it sets the compare register to the tick of the *next* group, and 1.0 µs later it toggles the pins in `at_end` (writing PINx
//! toggles: ATmega328P DS40002061B §14.2.2). Everything is a group:
//!
//! | what | at_tick | at_end |
//! |---|---|---|
//! | a step with the short pulse | STEP | STEP |
//! | either edge of a long pulse | STEP | 0 |
//! | a turn of DIR | 0 | DIR |
//! | a filler: it keeps the compare register moving | 0 | 0 |
//!
//! The last group of a ring is *pending*: its tick is in the compare register, but the group after it is not known yet. Its first byte is an END mark,
//! where the interrupt stops. So an underrun stops at a step that was planned, and no old group is ever played again. `put_push` gives the pending group
//! its successor, and then its own first byte, with one write: that publishes it.

use core::arch::global_asm;

use super::register;
use crate::engine::memory::RING_PAGES;

/// Bits of GPIOR0, which the interrupts read and set.
pub(crate) mod flags {
    /// Ring A is not on PORTD alone, or has longer pulses: see [`SHIELD`].
    pub(crate) const NOT_PLAIN_A: u8 = 0;
    /// Ring B has the pulse of 1.9 µs, or is ring B of the shield.
    pub(crate) const NOT_PLAIN_B: u8 = 1;
    /// Ring A plays PB4 and PB5, too.
    pub(crate) const SHIELD: u8 = 2;
    /// With [`NOT_PLAIN_B`]: this is ring B of the shield, next to a merged ring A.
    pub(crate) const SHIELD_B: u8 = SHIELD;
    /// The shield's pulse is the one of 1.9 µs. Without a shield: ring B plays PORTD, as ring A does.
    pub(crate) const SHIELD_STRETCHED: u8 = 3;
    /// See [`SHIELD_STRETCHED`].
    pub(crate) const B_ON_PORTD: u8 = SHIELD_STRETCHED;
    /// Ring A reached its END mark.
    pub(crate) const UNDERRUN_A: u8 = 4;
    /// Ring B reached its END mark.
    pub(crate) const UNDERRUN_B: u8 = 5;
    /// Either of them, as a mask.
    pub(crate) const UNDERRUN: u8 = 1 << UNDERRUN_A | 1 << UNDERRUN_B;
    /// If the compare hardware makes ring A's edges: its DIR pin is on PORTB, not PORTD.
    pub(crate) const DIR_A_ON_PORTB: u8 = 6;
    /// If the compare hardware makes ring B's edges: its DIR pin is on PORTB, not PORTD.
    pub(crate) const DIR_B_ON_PORTB: u8 = 7;
}

/// Bits of the first byte of a group that the compare hardware plays; the ring's END bit is always set, too.
pub(super) mod hardware {
    /// A plain step, followed by another edge: the interrupt only ends the pulse. The other bits mean nothing.
    pub(in crate::engine::steps) const PLAIN: u8 = 1 << 6;
    /// A group to be played. Without this and [`PLAIN`] it is the END mark.
    pub(in crate::engine::steps) const PLAY: u8 = 1 << 5;
    /// The interrupt ends the pulse (force output compare).
    pub(in crate::engine::steps) const END_PULSE: u8 = 1 << 4;
    /// The match has toggled the pin.
    pub(in crate::engine::steps) const TOGGLED: u8 = 1 << 3;
    /// The next match is to toggle the pin.
    pub(in crate::engine::steps) const NEXT_TOGGLES: u8 = 1 << 0;
}

/// END bit of ring A: PD1 is TXD, whose port bit nobody toggles.
pub(crate) const END_A: u8 = 1 << 1;
/// END bit of ring B: PB7 is the crystal.
pub(crate) const END_B: u8 = 1 << 7;
/// END bit of ring B if it plays PORTD: PD0 is RXD.
pub(super) const END_B_ON_PORTD: u8 = 1 << 0;

mod interrupts;

// Counts steps in the groups from the newest to the next one to be played; 17 to 30 cycles each.
//   r24:25  address of the pending group (then Z)
//   r22     low byte of the address of the last group to count
//   r20     levels of STEP and DIR
//   r18 r19 STEP and DIR of the motor
//   r16 r17 what the group toggles at its tick, and at its end
//   r14     with the compare hardware the bit that stands for STEP, else 0
//   r12     where the ring begins in its page
global_asm!(
    r#"
    .section .text.steps_unplayed, "ax", @progbits
    .global steps_unplayed
steps_unplayed:
    push r16
    push r17
    movw r30, r24
    clr r24
    rjmp 4f
1:  subi r30, 4
    cp r30, r12
    brsh .+2
    sub r30, r12
    ld r16, Z
    ldd r17, Z+3
    tst r14
    breq 4f
    mov r25, r16                        // the hardware's bits
    clr r16
    sbrc r25, {PLAIN}
    ldi r25, 1 << {TOGGLED} | 1 << {END_PULSE}
    sbrc r25, {TOGGLED}
    or r16, r14
    sbrc r25, {END_PULSE}
    or r17, r14
4:  eor r20, r17                        // levels between rise and fall
    mov r25, r16
    and r25, r20
    and r25, r18
    breq 3f                             // no step begins
    mov r25, r20
    and r25, r19
    breq 2f
    subi r24, -2
2:  dec r24
3:  eor r20, r16
    cp r30, r22
    brne 1b
    pop r17
    pop r16
    ret
    "#,
    PLAIN = const hardware::PLAIN.trailing_zeros(),
    TOGGLED = const hardware::TOGGLED.trailing_zeros(),
    END_PULSE = const hardware::END_PULSE.trailing_zeros(),
);

unsafe extern "C" {
    fn steps_unplayed(
        newest: *mut u8,
        last: u8,
        levels: u8,
        step_dir: u16,
        tick_end: u16,
        compare_bit: u8,
        start: u8,
    ) -> i8;
}

/// Bytes of a group.
pub(crate) const GROUP: u8 = 4;

/// Groups of a page.
pub(super) const GROUPS: u8 = 64;

/// Where the short ring begins in its page: ring B of the shield, behind the lists of the merge.
pub(super) const SHORT_RING_START: u8 = 0xa0;

/// Groups of the short ring, which ends with the page.
pub(super) const SHORT_RING_GROUPS: u8 = SHORT_RING_START.wrapping_neg() / GROUP;
const _: () = assert!(SHORT_RING_GROUPS == 24 && GROUPS as u16 * GROUP as u16 == 256);

/// Which of the two rings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum RingName {
    /// Compare match A: PORTD, the shield, or pin 9 by hardware.
    A,
    /// Compare match B: PORTB, or pin 10 by hardware.
    B,
}

/// What a group toggles.
///
/// With the compare hardware the bit [`Ring::compare_bit`] stands for STEP: in `at_tick` the hardware toggles the pin at the tick, in `at_end` the
/// interrupt ends the pulse. All other bits of `at_end` are toggled on the port of DIR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub(crate) struct Group {
    /// At the tick.
    pub(crate) at_tick: u8,
    /// At the end of a short pulse.
    pub(crate) at_end: u8,
}

impl Group {
    /// A filler.
    pub(crate) const NOTHING: Group = Group { at_tick: 0, at_end: 0 };
}

/// The end of a ring where groups are added; [`one_motor`](super::one_motor) and others know the layout.
#[derive(Debug)]
#[repr(C)]
pub(crate) struct Ring {
    /// Its page: the high byte of its addresses.
    pub(super) page: u8,
    /// The END bit, which also tells ring A from ring B.
    pub(super) end: u8,
    /// With the compare hardware the bit that stands for STEP; else 0.
    pub(super) compare_bit: u8,
    /// Low byte of the address of the pending group.
    pub(super) head: u8,
    /// What the pending group toggles.
    pub(super) pending: Group,
    /// The byte with which the pending group is published if a step follows.
    pub(super) before_step: u8,
    /// The byte with which a step is published if another follows, and the first byte of a step that is pending.
    pub(super) step_published: u8,
    pub(super) step_pending: u8,
    /// The last byte of a step's group.
    pub(super) step_end: u8,
    /// Data address of the tail.
    pub(super) tail_at: u8,
    /// So many groups must still be filled with steps until all groups of the ring toggle what a step toggles. At 0 an expansion writes ticks alone.
    pub(super) unprimed: u8,
    /// Where it begins in its page: 0, or [`SHORT_RING_START`].
    pub(super) start: u8,
}

impl Ring {
    /// Zeros, which take no flash. Call [`Ring::use_page_a`] or another before its use.
    pub(crate) const NONE: Ring = Ring {
        page: 0,
        end: 0,
        compare_bit: 0,
        head: 0,
        pending: Group::NOTHING,
        before_step: 0,
        step_published: 0,
        step_pending: 0,
        step_end: 0,
        tail_at: 0,
        unprimed: 0,
        start: 0,
    };

    /// Sets which ring it is. Call [`Ring::clear`] before its use. `end` is its END bit; `compare_bit` the bit that stands for STEP if the compare hardware
    /// makes its edges, else 0.
    #[inline(never)]
    fn reset(&mut self, name: RingName, end: u8, compare_bit: u8) {
        *self = Ring { end, compare_bit, unprimed: GROUPS, ..Ring::NONE };
        (self.page, self.tail_at) = match name {
            RingName::A => (RING_PAGES[0], 0x20 + register::OCR0A),
            RingName::B => (RING_PAGES[1], 0x20 + register::OCR0B),
        };
    }

    /// Its interrupt makes the edges, on PORTD, on the shield, or on PORTB.
    pub(crate) fn software(&mut self, name: RingName) {
        self.reset(name, if name == RingName::A { END_A } else { END_B }, 0);
    }

    /// Ring B plays PORTD, as ring A does. GPIOR0 must say so, too ([`flags::B_ON_PORTD`]).
    pub(crate) fn second_on_portd(&mut self) {
        self.reset(RingName::B, END_B_ON_PORTD, 0);
    }

    /// Ring B of the shield, behind the lists of a merge.
    pub(crate) fn after_lists(&mut self) {
        self.software(RingName::B);
        self.start = SHORT_RING_START;
    }

    /// Where it begins in its page.
    #[inline(always)]
    fn start(&self) -> u8 {
        self.start
    }

    /// The place `bytes` after another.
    #[inline(always)]
    fn after(&self, at: u8, bytes: u8) -> u8 {
        let after = at.wrapping_add(bytes);
        if after < self.start() { self.start() } else { after }
    }

    /// Bytes from one place to a later one, minus `less`. The end of the page may lie between them.
    #[inline(always)]
    fn distance(&self, to: u8, from: u8, less: u8) -> u8 {
        let distance = to.wrapping_sub(from).wrapping_sub(less);
        if u16::from(to) < u16::from(from) + u16::from(less) { distance.wrapping_sub(self.start()) } else { distance }
    }

    /// The compare hardware makes STEP edges on pin 9 (A) or 10 (B).
    ///
    /// `dir_on_portb` says on which port the DIR pin is. GPIOR0 must say so, too ([`flags::DIR_A_ON_PORTB`]).
    pub(crate) fn hardware(&mut self, name: RingName, dir_on_portb: bool) {
        // A bit of no DIR pin on that port: PD0 is RXD, PB7 the crystal.
        let compare_bit = if dir_on_portb { 1 << 7 } else { 1 << 0 };
        self.reset(name, if name == RingName::A { END_A } else { END_B }, compare_bit);
    }

    /// It is the only ring, in the page of ring A. The other page is free for other data.
    pub(crate) fn use_page_a(&mut self) {
        self.page = RING_PAGES[0];
    }

    /// Ring A or B.
    #[inline(always)]
    pub(crate) fn name(&self) -> RingName {
        if self.end == END_A { RingName::A } else { RingName::B }
    }

    /// With the compare hardware the bit that stands for STEP; else 0.
    #[inline(always)]
    pub(crate) fn compare_bit(&self) -> u8 {
        self.compare_bit
    }

    /// What the pending group toggles.
    #[inline(always)]
    pub(crate) fn pending(&self) -> Group {
        self.pending
    }

    fn tail_register(&self) -> *mut u8 {
        register::io(match self.name() {
            RingName::A => register::OCR0A,
            RingName::B => register::OCR0B,
        })
    }

    #[inline(always)]
    fn group(&self, at: u8) -> *mut u8 {
        core::ptr::with_exposed_provenance_mut(usize::from(u16::from_le_bytes([at, self.page])))
    }

    /// First byte of the pending group.
    #[inline(never)]
    fn pending_byte(&self, group: Group) -> u8 {
        if self.compare_bit == 0 { self.end } else { self.end | self.compare_bits(group) }
    }

    /// What the compare hardware and its interrupt do in `group`, as bits.
    fn compare_bits(&self, group: Group) -> u8 {
        let mut bits = 0;
        if group.at_tick & self.compare_bit != 0 {
            bits |= hardware::TOGGLED;
        }
        if group.at_end & self.compare_bit != 0 {
            bits |= hardware::END_PULSE;
        }
        bits
    }

    /// First byte of `group` when it is published and followed by `next`.
    #[inline(never)]
    fn published_byte(&self, group: Group, next: Group) -> u8 {
        if self.compare_bit == 0 {
            return group.at_tick;
        }
        let step = Group { at_tick: self.compare_bit, at_end: self.compare_bit };
        match (group == step, next.at_tick & self.compare_bit != 0) {
            (true, true) => self.end | hardware::PLAIN,
            (_, true) => self.end | hardware::PLAY | hardware::NEXT_TOGGLES | self.compare_bits(group),
            (_, false) => self.end | hardware::PLAY | self.compare_bits(group),
        }
    }

    /// Last byte of `group`.
    #[inline(always)]
    fn end_byte(&self, group: Group) -> u8 {
        group.at_end & !self.compare_bit
    }

    /// Drops all groups. The interrupt must be off.
    #[inline(never)]
    pub(crate) fn clear(&mut self) {
        self.head = self.start();
        self.pending = Group::NOTHING;
        self.prepare();
        // SAFETY: this ring's interrupt is off (the caller's promise), so nobody else uses the page and the tail.
        unsafe {
            self.group(self.start()).write_volatile(self.end);
            self.group(self.start() + 3).write_volatile(0);
            self.tail_register().write_volatile(self.start());
            if self.name() == RingName::B {
                register::io(register::EEARH).write_volatile(self.page);
            }
        }
    }

    /// Groups that can be added now.
    #[inline(always)]
    pub(crate) fn free(&self) -> u8 {
        self.distance(self.tail(), self.head, 1) / GROUP
    }

    /// From now on every step of its motor is `step`; [`one_motor`](super::one_motor) needs to know.
    #[inline(never)]
    pub(crate) fn set_step(&mut self, step: Group) {
        self.step_published = self.published_byte(step, step);
        self.step_pending = self.pending_byte(step);
        self.step_end = self.end_byte(step);
    }

    /// The pending group has changed: works out the byte with which it is published.
    fn prepare(&mut self) {
        self.unprimed = GROUPS;
        self.before_step =
            self.published_byte(self.pending, Group { at_tick: self.compare_bit, at_end: self.compare_bit });
    }

    /// Whether the pending group is one edge of a long pulse that the compare hardware makes. If the ring is empty then, the motors must be stopped.
    pub(crate) fn pending_begins_pulse(&self) -> bool {
        self.compare_bit != 0
            && self.pending.at_tick & self.compare_bit != 0
            && self.pending.at_end & self.compare_bit == 0
    }

    /// Whether the pending group is a step with the short pulse that the compare hardware makes.
    pub(crate) fn pending_is_plain_step(&self) -> bool {
        self.compare_bit != 0 && self.pending == Group { at_tick: self.compare_bit, at_end: self.compare_bit }
    }

    /// If the next group is a plain step of the compare hardware, changes it to one that switches toggling on for the next match. The interrupt must be off.
    pub(crate) fn next_match_toggles(&mut self) {
        use hardware::{END_PULSE, NEXT_TOGGLES, PLAIN, PLAY, TOGGLED};
        let group = self.group(self.tail());
        // SAFETY: only the interrupt reads it, and that is off.
        unsafe {
            if self.compare_bit != 0 && group.read_volatile() & PLAIN != 0 {
                group.write_volatile(self.end | PLAY | NEXT_TOGGLES | TOGGLED | END_PULSE);
            }
        }
    }

    /// Whether all published groups have been played.
    #[inline(always)]
    pub(crate) fn is_empty(&self) -> bool {
        self.tail() == self.head
    }

    /// Low byte of the address of the next group to be played.
    #[inline(always)]
    pub(crate) fn tail(&self) -> u8 {
        // SAFETY: one byte, which the interrupt may move on at any time.
        unsafe { self.tail_register().read_volatile() }
    }

    /// Steps in the groups from `tail` on, forward minus backward: those that make STEP active while DIR is forward. `levels` are those of STEP and DIR
    /// after the pending group, high where active and forward.
    ///
    /// The interrupt may play more meanwhile. The result is right for the time at which `tail` was the tail.
    pub(crate) fn unplayed(&self, tail: u8, levels: u8, step: u8, dir: u8) -> i8 {
        let Group { at_tick, at_end } = self.pending;
        if self.unprimed == 0 {
            // All groups are steps of the ring's one motor, the pending group too.
            let steps = (self.distance(self.head, self.tail(), 0) / GROUP + 1).cast_signed();
            return if levels & dir != 0 { steps } else { -steps };
        }
        // SAFETY: only reads published groups, which nobody writes now.
        unsafe {
            let newest = self.group(self.head);
            // The pending group has an END mark in place of its first byte, so pass what it toggles.
            steps_unplayed(
                newest,
                tail,
                levels,
                u16::from_le_bytes([step, dir]),
                u16::from_le_bytes([at_tick, at_end]),
                self.compare_bit,
                self.start,
            )
        }
    }

    /// Whether all groups that are still to be played are fillers.
    pub(crate) fn is_idle(&self) -> bool {
        let mut at = self.tail();
        while at != self.head {
            if self.read(at) != Group::NOTHING {
                return false;
            }
            at = self.after(at, GROUP);
        }
        self.pending == Group::NOTHING
    }

    /// The published group at `index`.
    fn read(&self, index: u8) -> Group {
        let group = self.group(index);
        // SAFETY: only main and the refill write groups, and the caller has the stepper.
        let (first, at_end) = unsafe { (group.read_volatile(), group.wrapping_add(3).read_volatile()) };
        if self.compare_bit == 0 {
            return Group { at_tick: first, at_end };
        }
        let plain = first & hardware::PLAIN != 0;
        let edge = |bit| if plain || first & bit != 0 { self.compare_bit } else { 0 };
        Group { at_tick: edge(hardware::TOGGLED), at_end: at_end | edge(hardware::END_PULSE) }
    }

    /// The compare register, and the ring's bit in TIMSK1 and TIFR1.
    fn compare(&self) -> (*mut u8, u8) {
        match self.name() {
            RingName::A => (register::data(register::OCR1A), 1 << 1),
            RingName::B => (register::data(register::OCR1B), 1 << 2),
        }
    }

    /// The immediate stop: after this no group is played, and the hardware makes no edge. A short pulse that the hardware has begun is ended.
    /// [`Ring::unplayed`] then counts what was not played. Interrupts must be off.
    #[inline(never)]
    pub(crate) fn halt(&mut self) {
        let (compare, bit) = self.compare();
        let (flags, mask) = (register::io(register::TIFR1), register::data(register::TIMSK1));
        let (mode, force) = (register::data(register::TCCR1A), register::data(register::TCCR1C));
        let counter = register::data(register::TCNT1);
        // SAFETY: interrupts are off, so nobody else uses the timer's registers or their shared high byte.
        unsafe {
            mask.write_volatile(mask.read_volatile() & !bit);
            if self.compare_bit == 0 {
                return;
            }
            // No match within the next 65 000 ticks. The flag tells whether one has just been.
            let low = counter.read_volatile();
            let high = counter.wrapping_add(1).read_volatile();
            let [low, high] = u16::from_le_bytes([low, high]).wrapping_sub(1).to_le_bytes();
            compare.wrapping_add(1).write_volatile(high);
            compare.write_volatile(low);
            // After an underrun the hardware has made the pending group's edge, too.
            let dry = register::io(register::GPIOR0).read_volatile() & self.underrun_flag() != 0;
            if flags.read_volatile() & bit != 0 || dry {
                let tail = self.tail();
                let group = if tail == self.head { self.pending } else { self.read(tail) };
                if group.at_end & self.compare_bit != 0 {
                    for _ in 0..8 {
                        core::arch::asm!("rjmp .+0", "rjmp .+0");
                    }
                    force.write_volatile(match self.name() {
                        RingName::A => 1 << 7,
                        RingName::B => 1 << 6,
                    });
                }
                if group.at_tick & self.compare_bit != 0 {
                    self.skip(tail);
                }
                flags.write_volatile(bit);
            }
            let com = match self.name() {
                RingName::A => 0b11 << 6,
                RingName::B => 0b11 << 4,
            };
            // A long pulse goes on until the caller ends it: the port takes over its level.
            let (pins, port) = (register::io(register::PINB), register::io(register::PORTB));
            let pin = match self.name() {
                RingName::A => 1 << 1,
                RingName::B => 1 << 2,
            };
            port.write_volatile(port.read_volatile() | pins.read_volatile() & pin);
            mode.write_volatile(mode.read_volatile() & !com);
        }
    }

    /// The flag that says that it reached its END.
    #[inline(always)]
    pub(crate) fn underrun_flag(&self) -> u8 {
        match self.name() {
            RingName::A => 1 << flags::UNDERRUN_A,
            RingName::B => 1 << flags::UNDERRUN_B,
        }
    }

    /// Counts the group at `tail` as played.
    fn skip(&mut self, tail: u8) {
        if tail == self.head {
            self.pending = Group::NOTHING;
            self.prepare();
        } else {
            // SAFETY: the ring's interrupt is off.
            unsafe { self.tail_register().write_volatile(tail.wrapping_add(GROUP)) };
        }
    }
}
