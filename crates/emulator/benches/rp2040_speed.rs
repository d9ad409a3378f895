//! How fast the RP2040 is: instructions per second of a program in RAM that never sleeps, alone and beside eight state machines that
//! make 625 000 pulses a second each, fed by DMA; and simulated cycles per second of those alone.
//! `cargo bench -p pulsetrain-emulator --bench rp2040_speed`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pulsetrain_emulator::{GpioEdge, Observer, Rp2040, hex};

/// 10 ms at 125 MHz.
const CYCLES: u64 = 1_250_000;
/// Where the program lies, behind what it uses.
const CODE: usize = 0x2_0000;
const CODE_BYTES: usize = 4096;
/// Words for the machines, 4 kB.
const RING: u32 = 0x2001_0000;

#[derive(Default)]
struct Count(u64);

impl Observer for Count {
    fn gpio(&mut self, _: GpioEdge) {
        self.0 += 1;
    }
}

/// A chip that runs the program of `arm_busy.s` from RAM, or sleeps.
fn chip(asleep: bool) -> Rp2040 {
    let code = hex::parse(include_str!("arm_busy.hex"), CODE_BYTES).expect("an image");
    let mut flash = vec![0; 0x100];
    for (at, word) in code[..64].chunks_exact(4).enumerate() {
        let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        let moved = if at == 0 { word } else { word + Rp2040::RAM_ADDRESS + CODE as u32 };
        flash.extend(moved.to_le_bytes());
    }
    if asleep {
        flash[0x104..0x108].copy_from_slice(&0x1000_0141u32.to_le_bytes());
        flash.extend([0x30, 0xbf, 0xfd, 0xe7]);
    }
    let mut chip = Rp2040::new(&flash).expect("it fits");
    chip.ram_mut()[CODE..CODE + code.len()].copy_from_slice(&code);
    chip
}

/// Eight machines with a period of 200 cycles: out x, 28; jmp x-- on itself; out pins, 2; out pins, 2.
fn pulses(chip: &mut Rp2040) {
    chip.write(0x4000_c000, 0, &mut ());
    for word in 0..1024 {
        chip.write(RING + 4 * word, 196 | 1 << 28, &mut ());
    }
    for machine in 0..8u32 {
        let (base, number) = (0x5020_0000 + machine / 4 * 0x10_0000, machine % 4);
        for (at, word) in [0x603c, 0x0041, 0x6002, 0x6002].into_iter().enumerate() {
            chip.write(base + 0x48 + 4 * at as u32, word, &mut ());
        }
        for pin in [2 * machine, 2 * machine + 1] {
            chip.write(0x4001_4004 + 8 * pin, 6 + machine / 4, &mut ());
        }
        let own = base + 0xc8 + 0x18 * number;
        chip.write(own + 0x04, 3 << 12, &mut ());
        chip.write(own + 0x08, 1 << 30 | 1 << 19 | 1 << 17, &mut ());
        // set pindirs, 3; then OUT has two pins.
        chip.write(own + 0x14, 2 << 26 | machine << 6, &mut ());
        chip.write(own + 0x10, 0xe083, &mut ());
        chip.run(chip.cycle() + 10, &mut ());
        chip.write(own + 0x14, 2 << 20 | machine << 1, &mut ());
        let channel = 0x5000_0000 + 0x40 * machine;
        let request = machine / 4 * 8 + number;
        for (offset, value) in [
            (0, RING),
            (4, base + 0x10 + 4 * number),
            (8, u32::MAX),
            (12, 1 | 2 << 2 | 1 << 4 | 12 << 6 | machine << 11 | request << 15),
        ] {
            chip.write(channel + offset, value, &mut ());
        }
    }
    chip.run(chip.cycle() + 100, &mut ());
    for base in [0x5020_0000, 0x5030_0000] {
        chip.write(base, 0xf, &mut ());
    }
}

/// How many instructions the chip executes in so many cycles.
fn instructions(chip: &Rp2040) -> u64 {
    let mut chip = chip.clone();
    let end = chip.cycle() + CYCLES;
    std::iter::from_fn(|| (chip.cycle() < end).then(|| chip.step(&mut ()))).count() as u64
}

fn speed(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("rp2040");
    for (name, asleep, moves) in
        [("program", false, false), ("program and eight machines", false, true), ("eight machines", true, true)]
    {
        let mut chip = chip(asleep);
        chip.run(1000, &mut ());
        if moves {
            pulses(&mut chip);
        }
        // An element is an instruction, or, where there are none, a cycle, of which 125 M are a second.
        let elements = if asleep { CYCLES } else { instructions(&chip) };
        println!("{name}: {elements} {} in {CYCLES} cycles", if asleep { "cycles" } else { "instructions" });
        group.throughput(Throughput::Elements(elements));
        let (mut count, begin) = (Count::default(), chip.cycle());
        group.bench_function(name, |bencher| bencher.iter(|| chip.run(chip.cycle() + CYCLES, &mut count)));
        let steps = (chip.cycle() - begin) / 200 * 8;
        assert!(count.0.abs_diff(if moves { 2 * steps } else { 0 }) < 100, "{} edges of {steps} pulses", count.0);
        assert!(chip.fault().is_none() && chip.is_asleep() == asleep, "the program did not run: {:?}", chip.fault());
    }
    group.finish();
}

criterion_group!(benches, speed);
criterion_main!(benches);
