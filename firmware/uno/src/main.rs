//! The firmware of the Arduino Uno.
#![no_std]
#![no_main]
#![feature(asm_experimental_arch)]

mod clock;
mod regs;

use core::panic::PanicInfo;

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    let mut clock = clock::Clock::start();
    loop {
        let t = clock.now();
        regs::OCR0B.write((t >> 40) as u8);
    }
}

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    regs::disable_interrupts();
    loop {}
}
