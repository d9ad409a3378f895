//! What two Cortex-M3 execute to compare exceptions: random interrupts with random priorities, groups and masks, pended by
//! the program and by handlers, and faults of all kinds. Each handler prints its number and what it sees; the order is the
//! result. Text goes out, and the program ends, by semihosting (`bkpt 0xab`), which every emulator of Arm has.
//!
//! It is compiled for ARMv6-M; what only ARMv7-M has is written in half-words.
#![no_std]
#![no_main]

use core::arch::{asm, global_asm};
use core::ptr::{read_volatile, write_volatile};

/// Interrupts that take part.
const LINES: u32 = 12;
const ROUNDS: u32 = 4000;

const ISER: u32 = 0xe000_e100;
const ISPR: u32 = 0xe000_e200;
const IABR: u32 = 0xe000_e300;
const IPR: u32 = 0xe000_e400;
const ICSR: u32 = 0xe000_ed04;
const AIRCR: u32 = 0xe000_ed0c;
const CCR: u32 = 0xe000_ed14;
const SHPR1: u32 = 0xe000_ed18;
const SHPR2: u32 = 0xe000_ed1c;
const SHPR3: u32 = 0xe000_ed20;
const SHCSR: u32 = 0xe000_ed24;
const CFSR: u32 = 0xe000_ed28;
const HFSR: u32 = 0xe000_ed2c;
const STIR: u32 = 0xe000_ef00;

// The vector table: a stack, the start, and one handler for all. A fault's handler goes on behind the instruction, which
// has two half-words.
global_asm!(
    ".section .vectors, \"a\"",
    ".word 0x20010000",
    ".word start",
    ".rept 14 + 44",
    ".word entry",
    ".endr",
    ".section .text.entry",
    ".thumb",
    ".global entry",
    ".thumb_func",
    "entry:",
    "mov r0, lr",
    "mov r1, sp",
    "push {{r4, lr}}",
    "bl handle",
    "pop {{r4, pc}}",
);

fn read(address: u32) -> u32 {
    // SAFETY: only addresses of the processor's registers and of the stack come here; nothing else runs meanwhile that
    // could mind.
    unsafe { read_volatile(address as *const u32) }
}

fn write(address: u32, value: u32) {
    // SAFETY: as for `read`.
    unsafe { write_volatile(address as *mut u32, value) }
}

/// The state of the random numbers; handlers take part.
static mut STATE: u32 = 0;

fn random() -> u32 {
    let address = &raw mut STATE as u32;
    let next = read(address).wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    write(address, next);
    next >> 8
}

fn print(character: u8) {
    // SAFETY: semihosting's SYS_WRITEC reads one byte.
    unsafe { asm!("bkpt 0xab", inout("r0") 3 => _, in("r1") &raw const character) };
}

fn print_hex(value: u32) {
    let digits = (32 - (value | 1).leading_zeros()).div_ceil(4);
    for place in (0..digits).rev() {
        print(b"0123456789abcdef"[(value >> (4 * place) & 15) as usize]);
    }
}

fn exit() -> ! {
    // SAFETY: semihosting's SYS_EXIT does not come back.
    unsafe { asm!("bkpt 0xab", in("r0") 0x18, in("r1") 0x2_0026) };
    loop {}
}

/// `dsb` and `isb`: what was written is seen.
fn settle() {
    // SAFETY: barriers touch nothing.
    unsafe { asm!(".hword 0xf3bf, 0x8f4f", ".hword 0xf3bf, 0x8f6f") };
}

/// `msr basepri, r0`.
fn set_basepri(value: u32) {
    // SAFETY: it masks exceptions.
    unsafe { asm!(".hword 0xf380, 0x8811", in("r0") value) };
    settle();
}

/// `msr basepri_max, r0`.
fn set_basepri_max(value: u32) {
    // SAFETY: it masks exceptions.
    unsafe { asm!(".hword 0xf380, 0x8812", in("r0") value) };
    settle();
}

fn basepri() -> u32 {
    let value: u32;
    // SAFETY: it reads.
    unsafe { asm!(".hword 0xf3ef, 0x8011", out("r0") value) };
    value
}

/// PRIMASK, or FAULTMASK.
fn set_mask(fault: bool, set: bool) {
    // SAFETY: they mask exceptions.
    match (fault, set) {
        (false, true) => unsafe { asm!("cpsid i") },
        (false, false) => unsafe { asm!("cpsie i") },
        (true, true) => unsafe { asm!(".hword 0xb671") },
        (true, false) => unsafe { asm!(".hword 0xb661") },
    }
    settle();
}

/// Pends some interrupts, or another exception, and lets them come.
fn pend() {
    match random() % 8 {
        0 => write(ICSR, 1 << 28),
        1 => write(ICSR, 1 << 26),
        2 => write(STIR, random() % LINES),
        3 => write(SHCSR, read(SHCSR) | 1 << 15),
        _ => write(ISPR, random() & random() & ((1 << LINES) - 1)),
    }
    settle();
}

/// Every exception but the reset. `frame` is the stack pointer behind the saved registers.
#[unsafe(no_mangle)]
extern "C" fn handle(link: u32, frame: u32) {
    let number = read(ICSR) & 0x1ff;
    print(b'[');
    print_hex(number);
    print(b':');
    print_hex(link & 0xf);
    print(b':');
    // RETTOBASE, and what is active.
    print_hex(read(ICSR) >> 11 & 1);
    print(b':');
    print_hex(read(IABR));
    if (3..=6).contains(&number) {
        print(b'!');
        print_hex(read(CFSR));
        print(b':');
        print_hex(read(HFSR));
        write(CFSR, u32::MAX);
        write(HFSR, u32::MAX);
        write(frame + 24, read(frame + 24) + 4);
    } else if random() % 3 == 0 {
        pend();
    }
    print(b']');
}

/// Instructions that fault: an undefined one, a coprocessor's, an unaligned `ldrd`, a division by 0. Each has two
/// half-words.
fn fault(kind: u32) {
    // SAFETY: the handler goes on behind the instruction; registers that it may write are named.
    unsafe {
        match kind {
            0 => asm!(".hword 0xf7f0, 0xa000"),
            1 => asm!(".hword 0xee00, 0x0a10"),
            2 => asm!(".hword 0xe9d0, 0x1200", in("r0") 0x2000_0001, out("r1") _, out("r2") _),
            _ => asm!(".hword 0xfbb0, 0xf0f1", inout("r0") 1 => _, in("r1") 0),
        }
    }
}

#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    write(&raw mut STATE as u32, 1);
    write(ISER, (1 << LINES) - 1);
    for round in 0..ROUNDS {
        print(b'\n');
        print_hex(round);
        print(b' ');
        write(AIRCR, 0x05fa_0000 | (random() % 8) << 8);
        for word in 0..LINES / 4 {
            write(IPR + 4 * word, random() << 8 ^ random());
        }
        write(SHPR1, random());
        write(SHPR2, random() << 8);
        write(SHPR3, random() << 8);
        // STKALIGN; sometimes DIV_0_TRP.
        write(CCR, 1 << 9 | random() & 1 << 4);
        write(SHCSR, (random() & 7) << 16);
        settle();
        match random() % 6 {
            0 => {
                set_basepri(random() & 0xff);
                pend();
                set_basepri_max(random() & 0xff);
                print_hex(basepri());
                pend();
                print(b'-');
                set_basepri(0);
            }
            1 => {
                let is_fault = random() % 2 == 0;
                set_mask(is_fault, true);
                pend();
                pend();
                print(b'-');
                set_mask(is_fault, false);
            }
            2 => fault(random() % 4),
            3 => {
                // SAFETY: the handler returns.
                unsafe { asm!("svc 0") };
            }
            _ => pend(),
        }
        print(b'.');
    }
    print(b'\n');
    exit()
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    exit()
}
