//! The firmware on the emulated chip makes the native board's steps, tick for tick: random plans, switches, stops.

use pulsetrain_board::{Board, Faults, Lease, Leased, Setup, SwitchRefused};
use pulsetrain_core::wire::message::Cause;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::lab::{EXACT, Lab, SHARED, SOFTWARE, Timing, UnoWithReference, uno};
use pulsetrain_testkit::seed::seeds;
use pulsetrain_testkit::{Random, TICK_HZ, uno_setup};

/// Pins of motors (STEP, DIR), and what the edges' ticks are compared by.
struct Pins {
    name: &'static str,
    pins: &'static [(u8, u8)],
    timing: Timing,
}

/// Every way to wire an Uno.
const ALL: [Pins; 12] = [
    Pins { name: "the tutorial", pins: &[(8, 9)], timing: SOFTWARE },
    Pins { name: "maximum-speed article", pins: &[(6, 7)], timing: SOFTWARE },
    Pins { name: "pin 9 by hardware", pins: &[(9, 8)], timing: EXACT },
    Pins { name: "pin 10 by hardware", pins: &[(10, 7)], timing: EXACT },
    Pins { name: "pins 9 and 10 by hardware", pins: &[(9, 8), (10, 13)], timing: EXACT },
    Pins { name: "two on port D", pins: &[(2, 5), (3, 6)], timing: SOFTWARE },
    Pins { name: "three on port D", pins: &[(2, 5), (3, 6), (4, 7)], timing: SOFTWARE },
    Pins { name: "three on port B", pins: &[(8, 11), (9, 12), (10, 13)], timing: SOFTWARE },
    Pins { name: "the CNC shield", pins: &[(2, 5), (3, 6), (4, 7), (12, 13)], timing: SOFTWARE },
    Pins {
        name: "the CNC shield, the motor on port B first",
        pins: &[(12, 13), (2, 5), (3, 6), (4, 7)],
        timing: SOFTWARE,
    },
    Pins { name: "three on the CNC shield", pins: &[(2, 5), (12, 13), (4, 7)], timing: SOFTWARE },
    Pins { name: "sweep article", pins: &[(9, 8), (10, 8), (11, 8), (12, 8)], timing: SHARED },
];

impl Pins {
    fn shares_dir(&self) -> bool {
        self.pins.len() > 1 && self.pins.iter().all(|(_, dir)| *dir == self.pins[0].1)
    }

    /// The shortest interval of the plans here, ticks: what boards do for a while, with motors that are not in step.
    fn fastest(&self) -> u64 {
        [3200, 6400, 10000, 14000][self.pins.len() - 1]
    }
}

/// No plan here takes longer, ticks.
const LONGEST_TICKS: u64 = 20 * TICK_HZ;

/// A segment lasts so long at least, for each motor, ticks.
const SEGMENT_TICKS: u64 = 16000;

/// After a turn, and after a switch, the first step comes so long after: DIR hold and set-up, and the firmware's own.
fn room_for_dir(setup: &Setup) -> u64 {
    u64::from(setup.pulse_ticks) + u64::from(setup.hold_ticks) + u64::from(setup.setup_ticks) + 400
}

/// A setup with levels, pulses and DIR times of any kind.
fn random_setup(pins: &Pins, random: &mut Random) -> Setup {
    let mut setup = uno_setup(pins.pins, [16, 16, 16, 31, 80, 160][random.below(6) as usize]);
    setup.setup_ticks = random.below(100) as u16;
    setup.hold_ticks = random.below(100) as u16;
    let shared = (random.below(2) == 0, random.below(2) == 0);
    for motor in &mut setup.motors {
        let own = (random.below(2) == 0, random.below(2) == 0);
        (motor.forward_high, motor.step_low) = if pins.shares_dir() { shared } else { own };
        // The compare hardware makes high pulses.
        motor.step_low &= pins.timing.late != 0;
        motor.gain = random.below(5) as i8 - 2;
    }
    setup
}

/// Items of a plan from tick `from` on: runs that speed up and slow down, waits, turns. On a shared DIR line all motors of an
/// epoch go the same way.
fn random_items(pins: &Pins, setup: &Setup, random: &mut Random, from: u64, forward: bool) -> Vec<Item> {
    let (fastest, room) = (pins.fastest(), room_for_dir(setup));
    let mut direction = if forward { Direction::Forward } else { Direction::Backward };
    let mut items = vec![Item::Anchor { tick: Tick32::of(from) }, Item::Dwell { ticks: room as u32 }];
    let interval = |random: &mut Random| (fastest as f64 * 30f64.powf(random.fraction().powi(2))) as i64;
    let mut now = interval(random);
    for _ in 0..random.between(2, 12) {
        if random.one_in(4) {
            items.push(Item::Dwell { ticks: random.below(60_000) as u32 });
        }
        if !pins.shares_dir() && random.one_in(3) {
            direction = direction.reversed();
            items.push(Item::Dwell { ticks: room as u32 });
        }
        let next = interval(random);
        // Each segment costs a board some time, however few steps it has.
        let least = SEGMENT_TICKS * pins.pins.len() as u64 / now.min(next) as u64 + 1;
        let count = (least + if random.one_in(3) { random.below(5) } else { random.below(200) }) as u32;
        // Within what a board has for it: 32 bits.
        let add = (((next - now) << 16) / i64::from(count)).clamp(-1 << 30, 1 << 30);
        let next = now + ((add * i64::from(count)) >> 16);
        let segment = Segment { count, interval: (now << 16) + random.below(1 << 16) as i64, add, add2: 0 };
        items.push(Item::Run { segment, direction });
        now = next;
    }
    items
}

/// Pushes an epoch of random items, as much of it as fits.
fn push(board: &mut UnoWithReference, pins: &Pins, setup: &Setup, random: &mut Random, epoch: u8, from: u64) {
    let forward = random.below(2) == 0;
    for motor in 0..pins.pins.len() {
        for item in random_items(pins, setup, random, from, forward) {
            // What it begins with is in every epoch of every motor. Some room is left for the next epoch's.
            let least = if matches!(item, Item::Anchor { .. }) { 10 } else { 40 };
            if board.room(motor) < least || board.push(motor, Entry { epoch: Epoch(epoch), item }).is_err() {
                break;
            }
        }
    }
}

/// What a random plan came to.
#[derive(Default)]
struct Tally {
    steps: usize,
    refused: u32,
    taken: u32,
}

/// Random epochs on one kind of pins; switches at random ticks, of which some come too late; at the end rest, or a stop.
fn random_plans(pins: &Pins, seed: u64, tally: &mut Tally) {
    let random = &mut Random::new(seed);
    let setup = random_setup(pins, random);
    println!("{setup:?}");
    let mut board = uno(&setup);
    let mut lab = Lab::default();
    let from = board.now() + board.round_trip() + TICK_HZ / 100;
    push(&mut board, pins, &setup, random, 1, from);
    assert_eq!(board.switch(Epoch(1), from, Lease::Last, &[]), Ok(()));
    let (mut epoch, mut begins) = (1, from);
    for _ in 0..random.below(4) {
        // One switch may wait: the Uno makes it before its tick, the native board at it.
        let until = begins.max(board.now() + random.below(TICK_HZ / 25));
        board.advance(until, &mut lab);
        // From the past to a little after it can be taken.
        let from = board.now() + random.below(2 * board.round_trip());
        push(&mut board, pins, &setup, random, epoch + 1, from);
        match board.switch(Epoch(epoch + 1), from, Lease::Last, &[]) {
            Ok(()) => (epoch, begins, tally.taken) = (epoch + 1, from, tally.taken + 1),
            Err(SwitchRefused::Late { .. }) => tally.refused += 1,
            Err(refused) => panic!("{refused}: {:?}", board.board().error()),
        }
    }
    let stopped = random.one_in(3).then(|| {
        let tick = board.now() + random.below(TICK_HZ / 20);
        let report = board.stop_now(tick, &mut lab);
        // Pulses that were begun end.
        board.advance(report.tick + TICK_HZ / 100, &mut lab);
        assert_eq!(report.positions, lab.counts(&setup), "what the stop says, and the pins");
        report.tick
    });
    let patience = board.now() + LONGEST_TICKS;
    while stopped.is_none() && !board.is_idle() {
        assert!(board.now() < patience, "it does not come to rest: {:?}", board.board_mut().events());
        let until = board.now() + TICK_HZ / 50;
        board.advance(until, &mut lab);
    }
    // The board may have come to rest within its USB frame: the last of its edges wait.
    let until = board.now() + TICK_HZ / 500;
    board.advance(until, &mut lab);
    assert!(board.record_is_complete(), "the native board took something else");
    let remote = board.board_mut();
    assert_eq!(remote.error(), None);
    let told: Vec<_> = remote.events().into_iter().filter(|event| event.cause != Cause::Finished).collect();
    assert!(told.is_empty(), "{told:?}");
    let status = remote.status().expect("it answers");
    let positions = status.motors.as_slice().iter().map(|motor| i64::from(motor.position));
    assert_eq!(positions.collect::<Vec<_>>(), lab.counts(&setup), "what it counted, and the pins");
    for motor in 0..pins.pins.len() {
        assert_eq!(board.faults(motor), Faults::default());
    }
    lab.check(&setup, pins.timing, stopped);
    tally.steps += lab.steps.len();
}

/// Plans on each kind of pins; `PULSETRAIN_ROUNDS` says how many times as many.
const SEEDS: u64 = 4;

fn random_plans_on(kinds: &[Pins]) {
    let mut failed = Vec::new();
    for pins in kinds {
        let mut tally = Tally::default();
        for seed in seeds(1, SEEDS) {
            println!("{}, seed {seed}", pins.name);
            let run = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| random_plans(pins, seed, &mut tally)));
            if run.is_err() {
                failed.push((pins.name, seed));
            }
        }
        println!("{}: {} steps, {} switches taken, {} refused", pins.name, tally.steps, tally.taken, tally.refused);
    }
    assert!(failed.is_empty(), "{failed:?}");
}

#[test]
fn one_motor() {
    random_plans_on(&ALL[..5]);
}

#[test]
fn several_motors() {
    random_plans_on(&ALL[5..]);
}
