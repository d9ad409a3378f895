//! Measures merging alone: segments come over the serial line, raw, and go out as steps.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch)]
#[path = "../steps/mod.rs"]
mod steps;
use core::arch::global_asm;
use steps::expand::Registers;
use steps::merge::{Merge, Pause};
use steps::register;
use steps::ring::Group;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}
global_asm!(
    r#"
    .global __vector_18
    .section .text.receive, "ax", @progbits
__vector_18:
    out 0x2a, r24
    out 0x2b, r30
    out 0x20, r31
    lds r24, 0xc6
    in r30, 0x21
    ldi r31, hi8(receive_page)
    st Z+, r24
    out 0x21, r30
    in r24, 0x2a
    in r30, 0x2b
    in r31, 0x20
    reti
    "#
);
unsafe extern "C" {
    static mut receive_page: [u8; 256];
}
#[unsafe(no_mangle)]
static mut receive_tail: u8 = 0;
#[unsafe(no_mangle)]
static mut motors: u8 = 4;
#[unsafe(no_mangle)]
static mut batch: u8 = 24;

struct Receiver {
    tail: u8,
    crc: u16,
}
impl Receiver {
    #[inline(always)]
    fn waiting(&self) -> u8 {
        unsafe { register::io(register::EEARL).read_volatile().wrapping_sub(self.tail) }
    }
    fn next(&mut self) -> u8 {
        let byte = unsafe { (&raw const receive_page).cast::<u8>().wrapping_add(self.tail as usize).read_volatile() };
        self.tail = self.tail.wrapping_add(1);
        let [low, high] = self.crc.to_le_bytes();
        let mut x = high ^ byte;
        x ^= x >> 4;
        self.crc = u16::from_le_bytes([x ^ x << 5, low ^ x << 4 ^ x >> 3]);
        byte
    }
}
const QUEUE: usize = 8;
struct Motor {
    records: [[u8; 10]; QUEUE],
    head: u8,
    tail: u8,
    registers: Registers,
}
const MOTOR: Motor = Motor {
    records: [[0; 10]; QUEUE],
    head: 0,
    tail: 0,
    registers: Registers { fraction: 0x8000, tick: 1000, interval: [0; 5], add: 0, add2: 0, left: 0 },
};
static mut ALL: [Motor; 4] = [MOTOR; 4];
static MASK: [u8; 4] = [4, 8, 16, 32];

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let n;
    let b;
    unsafe {
        for r in [0x2a, 0x24] {
            register::data(r).write_volatile(0xff);
        }
        register::data(0xc0).write_volatile(2);
        register::data(0xc4).write_volatile(1);
        register::data(0xc1).write_volatile(0x98);
        register::io(register::EEARL).write_volatile(0);
        register::io(register::GPIOR0).write_volatile(0);
        n = (&raw const motors).read_volatile();
        b = (&raw const batch).read_volatile();
        core::arch::asm!("sei");
    }
    let all = unsafe { &mut *(&raw mut ALL) };
    let mut receiver = Receiver { tail: 0, crc: 0xffff };
    let merge = unsafe { Merge::take() };
    merge.clear(n, 52, 1000);
    for m in 0..n {
        merge.put(m, 1000 + 60 * m as u16, Group { rise: 0, fall: 0 });
    }
    let mut started = false;
    let mut wanting = None;
    let mut full = false;
    loop {
        if receiver.waiting() >= 11 {
            let byte = unsafe { (&raw const receive_page).cast::<u8>().wrapping_add(receiver.tail as usize).read_volatile() };
            let motor = &mut all[(byte & 3) as usize];
            if motor.head.wrapping_sub(motor.tail) < QUEUE as u8 {
                receiver.next();
                let record = &mut motor.records[(motor.head as usize) % QUEUE];
                for b in record {
                    *b = receiver.next();
                }
                unsafe { (&raw mut receive_tail).write_volatile(receiver.tail) };
                motor.head = motor.head.wrapping_add(1);
            }
        }
        if let Some(m) = wanting {
            let motor: &mut Motor = &mut all[m as usize];
            if motor.head != motor.tail {
                let r = &motor.records[(motor.tail as usize) % QUEUE];
                motor.tail = motor.tail.wrapping_add(1);
                motor.registers.left = r[0] as u16;
                motor.registers.interval = [r[1], r[2], r[3], r[4], 0];
                let s = |b: u8| if b & 0x80 != 0 { 0xff } else { 0 };
                motor.registers.add = i32::from_le_bytes([r[5], r[6], r[7], s(r[7])]);
                motor.registers.add2 = i32::from_le_bytes([r[8], r[9], s(r[9]), s(r[9])]);
                let mask = MASK[m as usize];
                unsafe { merge.grant(m, &raw mut motor.registers, Group { rise: mask, fall: mask }, r[0], b) };
                wanting = None;
            }
        }
        if wanting.is_none() && (!full || merge.free() >= 24) {
            match merge.run() {
                Pause::Full => full = true,
                Pause::Wants(m) => {
                    full = false;
                    wanting = Some(m);
                }
            }
        } else if !started && receiver.waiting() > 180 && wanting.is_none() {
            started = true;
            unsafe {
                register::data(0x89).write_volatile((1000u16 >> 8) as u8);
                register::data(0x88).write_volatile(1000u16 as u8);
                register::data(0x85).write_volatile(0);
                register::data(0x84).write_volatile(0);
                register::data(register::TIMSK1).write_volatile(2);
                register::data(register::TCCR1B).write_volatile(1);
            }
        }
    }
}
