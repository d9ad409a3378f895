//! The Pico's expansion, in assembly, against core's: random recurrences, on the emulated chip.

use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_core::Recurrence;
use pulsetrain_core::pio::{MAX_UNCHECKED, Stretch, Unchecked, expand, unchecked_steps};
use pulsetrain_emulator::Rp2040;
use pulsetrain_testkit::Random;

/// The map of symbols of the Pico's image.
const SYMBOLS: &str = include_str!("../../../../../testdata/pico.sym");

/// Where a routine is, by its name.
fn address(name: &str) -> u32 {
    let line = SYMBOLS.lines().find_map(|line| line.split_once(' ').filter(|(_, own)| *own == name));
    let (address, _) = line.unwrap_or_else(|| panic!("the map has no {name}"));
    u32::from_str_radix(address.trim_start_matches("0x"), 16).expect("a number")
}

/// Places in RAM, as offsets: nobody is there after the functions, as the main loop does not go on.
const RECURRENCE: usize = 0x3_0000;
const STRETCH: usize = 0x3_0040;
const WORDS: usize = 0x3_1000;
const STACK: usize = 0x3_3000;
/// Where a function returns to.
const RETURN: u32 = 0x2003_4000;

/// What is where no word was written.
const UNTOUCHED: u32 = 0x5555_5555;

/// The chip once its program is in RAM.
struct Bench {
    chip: Rp2040,
    surely: u32,
    step_by_step: u32,
}

impl Bench {
    fn new() -> Bench {
        let chip = VirtualPico::new().chip().clone();
        Bench { chip, surely: address("expand_unchecked"), step_by_step: address("expand_steps") }
    }

    fn put(&mut self, at: usize, words: &[u32]) {
        for (place, word) in self.chip.ram_mut()[at..].chunks_exact_mut(4).zip(words) {
            place.copy_from_slice(&word.to_le_bytes());
        }
    }

    fn get(&self, at: usize, count: usize) -> Vec<u32> {
        let words = self.chip.ram()[at..].chunks_exact(4).take(count);
        words.map(|bytes| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])).collect()
    }

    fn recurrence(&self) -> Recurrence {
        let words = self.get(RECURRENCE, 8);
        let long = |at: usize| u64::from(words[at]) | u64::from(words[at + 1]) << 32;
        Recurrence {
            accumulator: long(0),
            interval: long(2).cast_signed(),
            add: long(4).cast_signed(),
            add2: long(6).cast_signed(),
        }
    }

    /// Calls a function with a recurrence, room for `count` words and what is to be in r3 and on the stack; gives r0 and the
    /// cycles.
    fn call(&mut self, function: u32, recurrence: &Recurrence, count: u32, r3: u32, gentle: u32) -> (u32, u64) {
        let Recurrence { accumulator, interval, add, add2 } = *recurrence;
        let long = |value: u64| [value as u32, (value >> 32) as u32];
        let words: Vec<u32> =
            [accumulator, interval as u64, add as u64, add2 as u64].into_iter().flat_map(long).collect();
        self.put(RECURRENCE, &words);
        self.put(WORDS, &vec![UNTOUCHED; count as usize + 4]);
        self.put(STACK, &[gentle]);
        let at = |offset: usize| Rp2040::RAM_ADDRESS + offset as u32;
        let saved = [4, 5, 6, 7, 8, 9, 10, 11].map(|register| (register, 0xabcd_0000 + register as u32));
        let cpu = self.chip.cpu_mut();
        for (register, value) in [
            (0, at(RECURRENCE)),
            (1, at(WORDS)),
            (2, at(WORDS) + 4 * count),
            (3, r3),
            (13, at(STACK)),
            (14, RETURN | 1),
        ]
        .into_iter()
        .chain(saved)
        .chain([(15, function)])
        {
            cpu.set_register(register, value);
        }
        let begin = self.chip.cycle();
        while self.chip.cpu().pc() != RETURN {
            self.chip.step(&mut ());
            assert!(self.chip.cycle() - begin < 100_000, "it does not return");
        }
        for (register, value) in saved {
            assert_eq!(self.chip.cpu().register(register), value, "r{register} is not kept");
        }
        assert_eq!(self.chip.cpu().register(13), at(STACK));
        assert_eq!(self.get(WORDS + 4 * count as usize, 4), [UNTOUCHED; 4], "words after the end");
        (self.chip.cpu().register(0), self.chip.cycle() - begin)
    }
}

/// Registers such as plans have them, with `add2` and without, up and down.
fn random_recurrence(random: &mut Random) -> Recurrence {
    let signed = |random: &mut Random, bits: u64| (random.below(2 << bits) as i64) - (1 << bits);
    let add_bits = random.below(36);
    let add2_bits = random.below(24);
    Recurrence {
        accumulator: random.below(u64::MAX),
        interval: ((20 + random.below(2000)) << 32 | random.below(1 << 32)) as i64,
        add: if random.one_in(5) { 0 } else { signed(random, add_bits) },
        add2: if random.one_in(5) { 0 } else { signed(random, add2_bits) },
    }
}

fn random_stretch(random: &mut Random) -> Stretch {
    let ticks = if random.one_in(2) { (1 << 25) - 1 } else { 1 + random.below(300_000) as u32 };
    Stretch { gap: 6 + random.below(40) as u32, ticks, bits: (random.below(128) as u32) << 25 }
}

#[test]
fn step_by_step_it_is_what_core_does() {
    let (random, mut bench) = (&mut Random::new(1), Bench::new());
    let (mut stopped, mut whole) = (0, 0);
    for _ in 0..2000 {
        let (recurrence, stretch) = (random_recurrence(random), random_stretch(random));
        let count = 1 + random.below(128) as u32;
        let (mut after, mut words) = (recurrence, vec![UNTOUCHED; count as usize]);
        let taken = expand::<32>(&mut after, &mut words, &stretch);
        bench.put(STRETCH, &[stretch.gap, stretch.ticks, stretch.bits]);
        let (next, _) = bench.call(bench.step_by_step, &recurrence, count, Rp2040::RAM_ADDRESS + STRETCH as u32, 0);
        assert_eq!((next - Rp2040::RAM_ADDRESS - WORDS as u32) / 4, taken, "{recurrence:?} {stretch:?}");
        let taken = taken as usize;
        assert_eq!(bench.get(WORDS, taken), words[..taken], "{recurrence:?} {stretch:?}");
        assert_eq!(bench.recurrence(), after, "{recurrence:?} {stretch:?}");
        *(if taken == words.len() { &mut whole } else { &mut stopped }) += 1;
    }
    assert!(whole > 100 && stopped > 100, "{whole} went to the end, {stopped} stopped before");
}

#[test]
fn what_is_sure_comes_eight_at_a_time() {
    let (random, mut bench) = (&mut Random::new(2), Bench::new());
    // Of each kind, and how many were no multiple of 8.
    let (mut tried, mut odd) = ([0; 2], 0);
    while tried.iter().any(|tried| *tried < 1000) {
        let (recurrence, stretch) = (random_recurrence(random), random_stretch(random));
        let most = 1 + random.below(u64::from(MAX_UNCHECKED)) as u32;
        let Unchecked { count, small_add } = unchecked_steps(&recurrence, &stretch, most);
        if count == 0 {
            continue;
        }
        let (mut after, mut words) = (recurrence, vec![UNTOUCHED; count as usize]);
        assert_eq!(expand::<32>(&mut after, &mut words, &stretch), count);
        let offset = stretch.bits.wrapping_sub(stretch.gap);
        let (ticks, cycles) = bench.call(bench.surely, &recurrence, count, offset, small_add.into());
        assert_eq!(bench.get(WORDS, count as usize), words, "{recurrence:?} {stretch:?}");
        assert_eq!(bench.recurrence(), after, "{recurrence:?} {stretch:?}");
        assert_eq!(ticks, ((after.accumulator >> 32) as u32).wrapping_sub((recurrence.accumulator >> 32) as u32));
        // 75 or 91 cycles for eight steps, and what is around them.
        let (loops, each) = (u64::from(count.div_ceil(8)), if small_add { 9 } else { 11 });
        assert!(cycles <= each * u64::from(count) + 3 * loops + 90, "{cycles} cycles for {count} steps");
        tried[usize::from(small_add)] += 1;
        odd += u32::from(count % 8 != 0);
    }
    assert!(odd > 1000, "{odd} that are no multiple of 8");
}
