//! How fast the emulator is: simulated seconds per second on a program that never sleeps, with interrupts of Timer1 and
//! full serial traffic both ways at 1 Mbaud. `cargo bench -p pulsetrain-emulator`.

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pulsetrain_emulator::{Atmega328p, LineByte, Observer, PinEdge, UartByte, hex};

/// 100 ms of a 16 MHz clock.
const CYCLES: u64 = 1_600_000;

#[derive(Default)]
struct Count {
    edges: u64,
    bytes: u64,
}

impl Observer for Count {
    fn pin(&mut self, _: PinEdge) {
        self.edges += 1;
    }

    fn transmit(&mut self, _: UartByte) {
        self.bytes += 1;
    }
}

fn busy(criterion: &mut Criterion) {
    let image = hex::parse(include_str!("busy.hex"), Atmega328p::FLASH_BYTES).expect("an image");
    let mut chip = Atmega328p::new(&image).expect("it fits");
    let mut count = Count::default();
    let mut group = criterion.benchmark_group("emulator");
    // An element is a simulated cycle: 160 M elements/s are ten seconds per second.
    group.throughput(Throughput::Elements(CYCLES));
    group.bench_function("busy", |bencher| {
        bencher.iter(|| {
            let end = chip.cycle() + CYCLES;
            while chip.cycle() < end {
                // 16 cycles a bit, in portions of 1 ms as a USB bridge has them.
                for n in 0..100 {
                    chip.receive(LineByte::new(chip.cycle() + n * 160, n as u8, 16 * 256));
                }
                chip.run(chip.cycle() + 16_000, &mut count);
            }
        });
    });
    group.finish();
    assert!(count.edges > 0 && count.bytes > 0 && chip.odd().undefined == 0, "the program did not run");
}

criterion_group!(benches, busy);
criterion_main!(benches);
