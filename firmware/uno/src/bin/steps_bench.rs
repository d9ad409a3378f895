//! Measures the step path alone: segments come over the serial line, raw, and go out as steps.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch)]

#[path = "../steps/mod.rs"]
mod steps;

use core::arch::global_asm;
use steps::expand::Registers;
use steps::register;
use steps::ring::{Group, Name, Ring};

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

global_asm!(
    r#"
    .global __vector_18
    .section .text.receive, "ax", @progbits
__vector_18:                            //                               7
    out 0x2a, r24                       // 1
    out 0x2b, r30                       // 1
    out 0x20, r31                       // 1                            10
    lds r24, 0xc6                       // 2                            12
    in r30, 0x21                        // 1                            13
    ldi r31, hi8(receive_page)          // 1                            14
    st Z+, r24                          // 2                            16
    out 0x21, r30                       // 1                            17
    in r24, 0x2a                        // 1
    in r30, 0x2b                        // 1
    in r31, 0x20                        // 1                            20
    reti                                // 4                            24
    "#
);

unsafe extern "C" {
    static mut receive_page: [u8; 256];
}

#[unsafe(no_mangle)]
static mut receive_tail: u8 = 0;

struct Receiver {
    tail: u8,
    crc: u16,
}

impl Receiver {
    #[inline(always)]
    fn waiting(&self) -> u8 {
        unsafe { register::io(register::EEARL).read_volatile().wrapping_sub(self.tail) }
    }

    #[inline(always)]
    fn next(&mut self) -> u8 {
        let byte = unsafe { (&raw const receive_page).cast::<u8>().wrapping_add(self.tail as usize).read_volatile() };
        self.tail = self.tail.wrapping_add(1);
        let [low, high] = self.crc.to_le_bytes();
        let mut x = high ^ byte;
        x ^= x >> 4;
        self.crc = u16::from_le_bytes([x ^ x << 5, low ^ x << 4 ^ x >> 3]);
        byte
    }

    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        for b in &mut out {
            *b = self.next();
        }
        out
    }
}

const QUEUE: usize = 16;

struct Queue {
    records: [[u8; 10]; QUEUE],
    head: u8,
    tail: u8,
}

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    unsafe {
        for r in [0x2a, 0x24] {
            register::data(r).write_volatile(0xff); // DDRD, DDRB
        }
        register::data(0xc0).write_volatile(2);
        register::data(0xc4).write_volatile(1);
        register::data(0xc1).write_volatile(0x98);
        register::io(register::EEARL).write_volatile(0);
        register::io(register::GPIOR0).write_volatile(0);
        core::arch::asm!("sei");
    }
    let mut receiver = Receiver { tail: 0, crc: 0xffff };
    let mut ring = Ring::new(Name::A);
    let mut registers = Registers { fraction: 0x8000, tick: 1000, ..Registers::default() };
    let mut queue = Queue { records: [[0; 10]; QUEUE], head: 0, tail: 0 };
    let mut started = false;
    loop {
        if receiver.waiting() >= 10 && queue.head.wrapping_sub(queue.tail) < QUEUE as u8 {
            let record = receiver.take::<10>();
            unsafe { (&raw mut receive_tail).write_volatile(receiver.tail) };
            queue.records[(queue.head & 15) as usize] = record;
            queue.head = queue.head.wrapping_add(1);
        }
        if registers.left == 0 && queue.head != queue.tail {
            let r = &queue.records[(queue.tail & 15) as usize];
            queue.tail = queue.tail.wrapping_add(1);
            registers.left = r[0] as u16;
            registers.interval = [r[1], r[2], r[3], r[4], 0];
            let s = |b: u8| if b & 0x80 != 0 { 0xff } else { 0 };
            registers.add = i32::from_le_bytes([r[5], r[6], r[7], s(r[7])]);
            registers.add2 = i32::from_le_bytes([r[8], r[9], s(r[9]), s(r[9])]);
        }
        if registers.left != 0 {
            let free = ring.free();
            let left = if registers.left > 255 { 255 } else { registers.left as u8 };
            if free >= 32 {
                let n = if left < free { left } else { free };
                unsafe { ring.expand(&mut registers, n, Group { rise: 4, fall: 4 }) };
            } else if !started && queue.head.wrapping_sub(queue.tail) == QUEUE as u8 && receiver.waiting() > 190 {
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
}
