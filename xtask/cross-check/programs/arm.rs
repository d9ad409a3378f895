//! What two ARMv6-M emulators execute to compare every instruction: sorting, CRC, integers of 64 and 128 bits with
//! division, floats of both sizes in software, recursion, text. It ends at `wfi`.
#![no_std]
#![no_main]

use core::fmt::Write;
use core::hint::black_box;

#[unsafe(link_section = ".vectors")]
#[used]
static VECTORS: (usize, extern "C" fn() -> !) = (0x2004_0000, start);

/// Results, so that nothing is left out.
static mut RESULTS: [u64; 8] = [0; 8];

#[unsafe(no_mangle)]
extern "C" fn start() -> ! {
    let results = [
        sorted(),
        crc().into(),
        integers(),
        wide(),
        singles().to_bits().into(),
        doubles().to_bits(),
        ackermann(2, black_box(6)).into(),
        text(),
    ];
    // SAFETY: there is one thread, and no interrupt.
    unsafe { core::ptr::write_volatile(&raw mut RESULTS, results) };
    loop {
        // SAFETY: it waits, and touches nothing.
        unsafe { core::arch::asm!("wfi") };
    }
}

fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state ^ *state >> 29
}

fn sorted() -> u64 {
    let mut state = black_box(1);
    let mut numbers = [0_i16; 300];
    numbers.fill_with(|| next(&mut state) as i16);
    numbers.sort_unstable();
    let mut shorts = [0_u8; 301];
    shorts.fill_with(|| next(&mut state) as u8);
    shorts.sort_unstable_by_key(|byte| byte.rotate_left(3));
    numbers.iter().fold(0, |sum: u64, number| sum.rotate_left(5) ^ *number as u64) + u64::from(shorts[150])
}

fn crc() -> u32 {
    let mut state = black_box(2);
    (0..500).fold(u32::MAX, |crc, _| {
        let mixed = crc ^ next(&mut state) as u32 & 0xff;
        (0..8).fold(mixed, |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
    })
}

fn integers() -> u64 {
    let mut state = black_box(3);
    (0..400).fold(0_u64, |sum, round| {
        let (a, b) = (next(&mut state), next(&mut state) >> (round % 60) | 1);
        let signed = (a as i64 / (b as i64 | 1)) as u64 ^ (a as i32 % (b as i32 | 1)) as u64;
        sum.rotate_left(7) ^ a / b ^ a % b ^ a.wrapping_mul(b) ^ signed ^ (a as u32 / (b as u32 | 1)) as u64
    })
}

fn wide() -> u64 {
    let mut state = black_box(4);
    (0..100).fold(0_u64, |sum, round| {
        let a = u128::from(next(&mut state)) << 64 | u128::from(next(&mut state));
        let b = (u128::from(next(&mut state)) << (round % 64)) | 1;
        sum.rotate_left(9) ^ (a / b) as u64 ^ (a % b >> 3) as u64 ^ (a.wrapping_mul(b) >> 64) as u64
    })
}

fn singles() -> f32 {
    let mut x = black_box(1.5_f32);
    for round in 1..300 {
        x = x * 1.01 + 1.0 / round as f32 - x / 7.0;
        if x > 5.0 {
            x -= (x as i32) as f32;
        }
    }
    x
}

fn doubles() -> f64 {
    let mut x = black_box(0.3_f64);
    for round in 1..300 {
        // The logistic map: every bit counts.
        x = 3.99 * x * (1.0 - x) + 1e-12 / f64::from(round) + (x as f32) as f64 * 1e-9;
    }
    x
}

fn ackermann(m: u32, n: u32) -> u32 {
    match (m, n) {
        (0, n) => n + 1,
        (m, 0) => ackermann(m - 1, 1),
        (m, n) => ackermann(m - 1, ackermann(m, n - 1)),
    }
}

/// Adds up the characters it is given.
struct Sum(u64);

impl Write for Sum {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        self.0 = text.bytes().fold(self.0, |sum, byte| sum.rotate_left(3) ^ u64::from(byte));
        Ok(())
    }
}

fn text() -> u64 {
    let mut sum = Sum(0);
    let mut state = black_box(5);
    for round in 0..30 {
        let number = next(&mut state);
        let _ = write!(sum, "{round}: {number} {:x} {:>12} {:?};", number as u32, number as i16, number & 1 == 0);
    }
    sum.0
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}
