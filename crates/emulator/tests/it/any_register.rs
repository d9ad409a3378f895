//! Any register, any value, in any order: no panic, no cycle that never ends, and time goes on.

use crate::pico::{Bench, Machine};
use crate::random::Random;
use pulsetrain_emulator::LineByte;

/// Where registers lie; those of what can stop the others come up less often.
const REGIONS: [u32; 20] = [
    0x5020_0000,
    0x5020_0000,
    0x5020_0000,
    0x5030_0000,
    0x5000_0000,
    0x5000_0000,
    0x5000_0000,
    0x4001_4000,
    0x4001_c000,
    0x4003_4000,
    0x4003_8000,
    0x4005_4000,
    0x4005_8000,
    0x4000_8000,
    0x4002_4000,
    0x4002_8000,
    0xd000_0000,
    0x1400_0000,
    0x5011_0000,
    0x4000_c000,
];

#[test]
fn any_register() {
    let (mut edges, mut writes) = (0, 0);
    for seed in 1..=200u64 {
        let mut random = Random::new(seed);
        let mut bench = Bench::new();
        // Machines that do something until their registers are changed.
        for block in 0..2 {
            Machine::new(block, 0).outputs(&mut bench, 12 * block, 12);
            for at in 0..32 {
                bench.set(0x5020_0048 + block * 0x10_0000 + 4 * at, random.next() & 0xffff);
            }
            for number in 0..4 {
                bench.set(Machine::new(block, number).pinctrl(), random.next());
            }
            bench.set(0x5020_0000 + block * 0x10_0000, 0xf);
        }
        for _ in 0..600 {
            let region = REGIONS[random.below(20) as usize];
            let register = match region {
                0x5000_0000 => random.below(0x118) * 4,
                0x5020_0000 | 0x5030_0000 => random.below(0x51) * 4,
                0x4000_c000 if random.one_in(4) => 0,
                0x4000_c000 => continue,
                _ => random.below(0x80) * 4,
            };
            let alias = if region >> 28 == 0xd { 0 } else { random.below(4) << 12 };
            // Values that mean something are small, addresses, or anything.
            let value = match random.below(4) {
                0 => random.below(64),
                1 => 0x2000_0000 | random.next() & 0x3_fffc,
                2 => REGIONS[random.below(20) as usize] | random.next() & 0xffc,
                _ => random.next(),
            };
            bench.set(region | alias | register, value);
            writes += 1;
            if random.one_in(4) {
                bench.get(region + random.below(0x100) * 4);
            }
            if random.one_in(8) {
                bench.chip.set_input(random.below(40) as u8, Some(random.one_in(2).into()));
            }
            if random.one_in(16) {
                let bit = random.next() >> random.below(32);
                let from = bench.now().max(bench.chip.line_idle_from(0));
                bench.chip.receive(0, LineByte::new(from, random.next() as u8, bit & 0xf_ffff));
            }
            let end = bench.now() + u64::from(random.below(200));
            bench.chip.run(end, &mut bench.seen);
            assert!(bench.now() >= end && bench.now() < end + 1000, "case {seed}: {} and not {end}", bench.now());
        }
        // In the order of their cycles.
        assert!(bench.seen.edges.windows(2).all(|pair| pair[0].cycle <= pair[1].cycle), "case {seed}");
        edges += bench.seen.edges.len();
    }
    assert!(writes > 100_000 && edges > 10_000, "{writes} writes, {edges} edges");
}
