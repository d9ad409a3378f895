//! The firmware's braking rule, in assembly, against core's: random intervals and limits, on the emulated chip.

use pulsetrain_board::virtual_uno;
use pulsetrain_core::braking::{BrakingPart, Limit, RegisterLimits};
use pulsetrain_emulator::Atmega328p;
use pulsetrain_testkit::Random;
use pulsetrain_testkit::lab::{SYMBOLS, address};
use pulsetrain_testkit::seed::{rounds, seed};

/// Where the test has a motor, and the stack; offsets in a motor (firmware/uno/src/engine/steps/motor.rs), and bits of its braking state and its flags.
const MOTOR: u16 = 0x500;
const STACK: u16 = 0x8f0;
const RETURN: u16 = 0x3ff0;
const INTERVAL: u16 = 6;
const ADD: u16 = 11;
const LEFT: u16 = 19;
const FLAGS: u16 = 23;
const PARTS: u16 = 62;
const STATE: u16 = PARTS + 21;
const MOTOR_BYTES: u16 = 120;
const BRAKES: u8 = 1 << 2;
const ANCHORED: u8 = 1 << 3;
const UNREADABLE: u8 = 1 << 4;
/// What a part may take at most, with what finds out whether its steps are sure, cycles.
const MOST_CYCLES: u64 = 700;

struct Chip {
    chip: Atmega328p,
    entry: u16,
    most: u64,
}

impl Chip {
    fn put(&mut self, at: u16, bytes: &[u8]) {
        for (address, byte) in (at..).zip(bytes) {
            self.chip.write_data(address, *byte, &mut ());
        }
    }

    fn get<const N: usize>(&self, at: u16) -> [u8; N] {
        self.chip.ram()[usize::from(at - 0x100)..][..N].try_into().expect("within RAM")
    }

    /// How a motor goes on that brakes from `interval`; whether it is to be asked again.
    fn next(&mut self, limit: &Limit, interval: i64) -> (BrakingPart, bool) {
        self.put(MOTOR, &[0xa5; MOTOR_BYTES as usize]);
        self.put(MOTOR + INTERVAL, &interval.to_le_bytes()[..5]);
        self.put(MOTOR + LEFT, &[0, 0]);
        self.put(MOTOR + FLAGS, &[ANCHORED | UNREADABLE]);
        self.put(MOTOR + STATE, &[BRAKES, limit.mantissa(), limit.exponent(), limit.rest_level()]);
        let [low, high] = RETURN.to_le_bytes();
        self.put(0x5d, &STACK.to_le_bytes());
        self.put(STACK + 1, &[high, low]);
        let [low, high] = MOTOR.to_le_bytes();
        self.chip.set_register(28, low);
        self.chip.set_register(29, high);
        self.chip.set_register(1, 0);
        self.chip.set_pc(self.entry);
        let begin = self.chip.cycle();
        while self.chip.pc() != RETURN {
            self.chip.step(&mut ());
            assert!(self.chip.cycle() - begin < 5_000, "it does not return");
        }
        self.most = self.most.max(self.chip.cycle() - begin);
        let left = u16::from_le_bytes(self.get(MOTOR + LEFT));
        let add = i32::from_le_bytes(self.get(MOTOR + ADD));
        let goes_on = self.get::<1>(MOTOR + STATE)[0] & BRAKES != 0;
        let next = match (self.chip.read_data(0x5f, &mut ()) & 1, left, add) {
            (1, 0, _) => BrakingPart::Rest,
            (0, 1, 0) => BrakingPart::LastStep,
            (0, count, add) => BrakingPart::Steps { count: count.into(), add: add.into() },
            what => panic!("neither steps nor rest: {what:?}"),
        };
        assert_eq!(self.get::<5>(MOTOR + INTERVAL), interval.to_le_bytes()[..5], "the interval stays");
        if next != BrakingPart::Rest {
            assert_eq!(self.get::<4>(MOTOR + ADD + 4), [0; 4], "add2");
        }
        (next, goes_on)
    }
}

#[test]
fn parts_are_cores() {
    let chip = Atmega328p::new(&virtual_uno::image()).expect("an image");
    let mut chip = Chip { chip, entry: address(SYMBOLS, "steps_load_leased"), most: 0 };
    let registers = RegisterLimits::with_fraction_bits(16);
    let mut random = Random::new(seed(1));
    let mut seen = [0; 4];
    let mut most_usual = 0;
    for round in 0..20_000 * rounds() {
        // Mantissas near each other, as often as not.
        let interval = (random.next() >> random.between(24, 63)) as i64;
        let usual = random.one_in(2);
        let mantissa = if random.one_in(2) {
            128 + random.below(128) as u8
        } else {
            let upper = interval.unsigned_abs().max(1) << interval.unsigned_abs().max(1).leading_zeros() >> 56;
            let near = upper as i64 * [128, 181, 256][random.below(3) as usize] / 181 + random.below(3) as i64 - 1;
            near.clamp(128, 255) as u8
        };
        let exponent = if usual { random.between(26, 40) } else { random.below(62) } as u8;
        let rest_level =
            if random.one_in(4) { random.next() as u8 } else { random.below(if usual { 3 } else { 12 }) as u8 };
        let limit = Limit::new(mantissa, exponent, rest_level).expect("it is one");
        let wanted = limit.next(interval, &registers);
        chip.most = 0;
        let (next, goes_on) = chip.next(&limit, interval);
        assert_eq!(next, wanted, "round {round}: {limit:?} from {interval}");
        if interval >= 100 << 16 && (26..40).contains(&exponent) {
            most_usual = most_usual.max(chip.most);
        }
        assert_eq!(goes_on, matches!(wanted, BrakingPart::Steps { .. }), "round {round}");
        seen[match wanted {
            BrakingPart::Rest => 0,
            BrakingPart::LastStep => 1,
            BrakingPart::Steps { count: 1, .. } => 2,
            BrakingPart::Steps { .. } => 3,
        }] += 1;
    }
    assert!(seen.iter().all(|times| *times > 100), "{seen:?}");
    assert!(most_usual <= MOST_CYCLES, "{most_usual} cycles");
}
