//! How fast the Cortex-M0+ is without a chip around it: instructions per second on a program that never sleeps, with an
//! interrupt every 1000 cycles. `cargo bench -p pulsetrain-emulator --bench arm_speed`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pulsetrain_emulator::arm::{Bus, BusFault, Config, Cpu, Size};
use pulsetrain_emulator::hex;
use std::hint::black_box;

const INSTRUCTIONS: u64 = 1_000_000;
const CODE_BYTES: usize = 4096;
const RAM: u32 = 0x2000_0000;
const RAM_BYTES: usize = 0x4000;
/// What the program counts, in RAM.
const TICKS: u32 = RAM + 0x1000;
const ROUNDS: u32 = RAM + 0x1004;

/// Code at 0, memory at `RAM`.
struct Memory {
    code: Vec<u8>,
    ram: Vec<u8>,
}

impl Memory {
    fn place(&self, address: u32) -> (&[u8], usize) {
        if address >= RAM { (&self.ram, (address - RAM) as usize) } else { (&self.code, address as usize) }
    }
}

impl Bus for Memory {
    fn read(&mut self, address: u32, size: Size, _: u64) -> Result<u32, BusFault> {
        let (bytes, at) = self.place(address);
        let bytes = bytes.get(at..at + size.bytes() as usize).ok_or(BusFault { address })?;
        Ok(match *bytes {
            [a] => a.into(),
            [a, b] => u16::from_le_bytes([a, b]).into(),
            [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
            _ => 0,
        })
    }

    fn write(&mut self, address: u32, size: Size, value: u32, _: u64) -> Result<(), BusFault> {
        let (at, bytes) = (address.wrapping_sub(RAM) as usize, size.bytes() as usize);
        let place = self.ram.get_mut(at..at.wrapping_add(bytes)).ok_or(BusFault { address })?;
        place.copy_from_slice(&value.to_le_bytes()[..bytes]);
        Ok(())
    }

    fn fetch(&mut self, address: u32, _: u64) -> Result<u16, BusFault> {
        let at = address as usize;
        let bytes = self.code.get(at..at + 2).ok_or(BusFault { address })?;
        Ok(u16::from_le_bytes([bytes[0], bytes[1]]))
    }
}

fn busy(criterion: &mut Criterion) {
    let code = hex::parse(include_str!("arm_busy.hex"), CODE_BYTES).expect("an image");
    let mut memory = Memory { code, ram: vec![0; RAM_BYTES] };
    let mut cpu = Cpu::new(Config::default());
    cpu.reset(&mut memory);
    let mut group = criterion.benchmark_group("arm");
    // An element is an instruction.
    group.throughput(Throughput::Elements(INSTRUCTIONS));
    group.bench_function("busy", |bencher| {
        bencher.iter(|| {
            for _ in 0..INSTRUCTIONS {
                black_box(cpu.step(&mut memory));
            }
        });
    });
    group.finish();
    let mut counted = |address| memory.read(address, Size::Word, 0).expect("memory");
    assert!(counted(TICKS) > 0 && counted(ROUNDS) > 0 && cpu.fault().is_none(), "the program did not run");
    assert!(u64::from(counted(TICKS)) >= cpu.cycle() / 1000 - 1, "an interrupt was lost");
}

criterion_group!(benches, busy);
criterion_main!(benches);
