//! A simple model of the state machine does the words. Its edges must be those of an axis with the same items.

use proptest::prelude::*;
use pulsetrain_core::braking::{BrakingPart, Limit, RegisterLimits};
use pulsetrain_core::lease::LapseCause;
use pulsetrain_core::output::{Coils, Output, Sequence, StepDir, StepDirSettings};
use pulsetrain_core::packed_queue::{Fault, PackedQueue, Pool};
use pulsetrain_core::packing::{Check, MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::pio::{Filled, LONGEST_WAIT, Tape, WordWriter, expand, lines};
use pulsetrain_core::queue::Items;
use pulsetrain_core::{Axis, Direction, Entry, Epoch, Item, Lapse, Lease, Queue, Segment, Tick32};

use Direction::{Backward, Forward};

const F: u32 = 32;
const PACKING: Packing = Packing { fraction_bits: F, gain: 0 };
const N: usize = 1024;
const RUNS: usize = 128;
const POOL: usize = 4096;

/// How a motor of these tests is driven.
#[derive(Clone, Copy, Debug)]
enum Kind {
    StepDir { pulse: u32, setup: u32, forward_high: bool, dir_first: bool },
    Coils { sequence: Sequence, release: Option<u32> },
}

impl Kind {
    fn overhead(self) -> u32 {
        match self {
            Kind::StepDir { pulse, .. } => pulse + 3,
            Kind::Coils { .. } => 3,
        }
    }

    fn step_line(self) -> u8 {
        matches!(self, Kind::StepDir { dir_first: true, .. }).into()
    }

    fn pulse(self) -> u32 {
        if let Kind::StepDir { pulse, .. } = self { pulse } else { 0 }
    }

    fn output(self) -> Output {
        match self {
            Kind::StepDir { pulse, setup, forward_high, .. } => Output::StepDir(StepDir::new(StepDirSettings {
                step_line: self.step_line(),
                dir_line: 1 - self.step_line(),
                pulse_ticks: pulse,
                setup_ticks: setup.max(self.overhead()),
                forward_high,
                shared_dir: false,
            })),
            Kind::Coils { sequence, release } => Output::Coils(Coils::new([0, 1, 2, 3], sequence, release)),
        }
    }

    /// The shortest wait before the first step in the other direction.
    fn turn(self) -> u32 {
        match self {
            Kind::StepDir { setup, .. } => 2 * self.overhead() + setup,
            Kind::Coils { .. } => 0,
        }
    }
}

/// All lines of a motor from a tick on.
type Levels = (u32, u32);

/// A motor driven by words, and what its state machine did.
struct Machine {
    kind: Kind,
    pool: Box<Pool<POOL>>,
    packed: PackedQueue,
    packer: State,
    words: WordWriter<F>,
    tape: Tape<N, RUNS>,
    memory: [u32; N],
    /// The number of words done, and the tick at which the last one changed the lines.
    done: u32,
    tick: Tick32,
    levels: Vec<Levels>,
    /// The tick of each word, and the position after it, counted on the lines.
    counted: Vec<(u32, i32)>,
}

impl Machine {
    fn new(kind: Kind) -> Machine {
        let mut machine = Machine {
            kind,
            pool: Box::new(Pool::new()),
            packed: PackedQueue::new(Pool::<POOL>::part(0, POOL as u16), PACKING),
            packer: State::default(),
            words: WordWriter::new(kind.output(), kind.step_line(), kind.pulse()),
            tape: Tape::new(),
            memory: [0; N],
            done: 0,
            tick: Tick32(0),
            levels: vec![(0, 0)],
            counted: vec![(0, 0)],
        };
        machine.start(1000);
        machine
    }

    /// The state machine's gate opens at tick `at`, and the lines change 1003 ticks later at first.
    fn start(&mut self, at: u32) {
        self.words.begin(&mut self.tape, &mut self.memory, 1000);
        self.words.start(&mut self.tape, Tick32(at));
        self.done = 0;
        self.tick = Tick32(at + 3).before(self.kind.overhead());
    }

    fn push(&mut self, epoch: u8, items: &[Item]) {
        self.packer = State::default();
        for item in items {
            let mut bytes = [0; MAX_PACKED_LEN];
            let len = PACKING.pack(&mut self.packer, item, &mut bytes).unwrap();
            self.packed.push(&mut self.pool, Epoch(epoch), &bytes[..len]).unwrap();
        }
    }

    fn fill(&mut self, until: u32, most: u32) -> Filled {
        let Machine { words, packed, pool, tape, memory, .. } = self;
        // The machine may have less to do than `least` asks for.
        let least = Tick32(until - until / 1000 % 100);
        words.fill(&mut packed.items(pool), tape, memory, [least, Tick32(until)], most, expand::<F>)
    }

    /// Does the words whose lines change up to `now`.
    fn play(&mut self, now: u32) {
        while self.done != self.tape.written() {
            let word = self.memory[self.done as usize % N];
            let tick = self.tick.after((word & LONGEST_WAIT) + self.kind.overhead());
            if Tick32(now).is_before(tick) {
                break;
            }
            let before = self.levels.last().unwrap().1;
            let bits = lines(word);
            let mut position = self.counted.last().unwrap().1;
            match self.kind {
                Kind::StepDir { pulse, forward_high, .. } => {
                    let (step, dir) = (1 << self.kind.step_line(), 2 >> self.kind.step_line());
                    assert_eq!(before & step, 0, "a pulse has no end");
                    self.change(tick, bits & 3);
                    self.change(tick.after(pulse), bits >> 2);
                    assert_eq!(bits >> 2 & step, 0);
                    if bits & step != 0 {
                        position += if (bits & dir != 0) == forward_high { 1 } else { -1 };
                    }
                }
                Kind::Coils { .. } => {
                    self.change(tick, bits);
                    // The tape's position is used, since the lines of coils alone do not show it.
                    position = self.tape.position_after(self.done + 1);
                }
            }
            self.counted.push((tick.0, position));
            self.tick = tick;
            self.done += 1;
        }
    }

    fn change(&mut self, tick: Tick32, levels: u32) {
        if self.levels.last().unwrap().1 != levels {
            self.levels.push((tick.0, levels));
        }
    }
}

/// The levels of the axis that has the same items.
fn axis_levels(axis: &mut Axis<F, Queue<64>>, levels: &mut Vec<Levels>, until: u32) {
    while let Some(edge) = axis.next(Tick32(until)) {
        let before = levels.last().unwrap().1;
        let after = before & !edge.clear | edge.set;
        if after != before {
            levels.push((edge.tick.0, after));
        }
    }
    axis.pass(Tick32(until));
}

fn kinds() -> impl Strategy<Value = Kind> {
    let sequence = prop_oneof![Just(Sequence::Wave), Just(Sequence::Full), Just(Sequence::Half)];
    prop_oneof![
        (3u32..40, 0u32..60, any::<bool>(), any::<bool>()).prop_map(|(pulse, setup, forward_high, dir_first)| {
            Kind::StepDir { pulse, setup, forward_high, dir_first }
        }),
        (sequence, prop::option::of(100u32..2000)).prop_map(|(sequence, release)| Kind::Coils { sequence, release }),
    ]
}

/// Parts of a motion: count, first interval, last interval (ticks beyond the shortest), whether forward, wait.
type Part = (u32, i64, i64, bool, Option<u32>);

fn parts() -> impl Strategy<Value = Vec<Part>> {
    let part = (1u32..60, 0i64..400, 0i64..400, any::<bool>(), prop::option::of(0u32..5000));
    prop::collection::vec(part, 1..8)
}

fn items(kind: Kind, from: u32, parts: &[Part]) -> Vec<Item> {
    let mut items = vec![Item::Anchor { tick: Tick32(from) }, Item::Dwell { ticks: kind.turn() }];
    let shortest = i64::from(kind.overhead()) + 1;
    let mut last = None;
    for (count, first, last_interval, forward, wait) in parts {
        let direction = if *forward { Forward } else { Backward };
        if last.replace(direction) != Some(direction) {
            items.push(Item::Dwell { ticks: kind.turn() });
        }
        if let Some(ticks) = *wait {
            items.push(Item::Dwell { ticks });
        }
        let interval = ((shortest + first) << F) + 12_345;
        let add = ((last_interval - first) << F) / i64::from(*count);
        let segment = Segment { count: *count, interval, add, add2: 0 };
        items.push(Item::Run { segment, direction });
    }
    items
}

/// A lease that ends during the motion or after the plan's end: its length, and how hard the motor brakes.
fn lease() -> impl Strategy<Value = (u32, Limit)> {
    let limit = (128..=255u8, 4..9u8, 0..4u8).prop_map(|(m, e, l)| Limit::new(m, e + F as u8, l).unwrap());
    (0u32..30_000, limit)
}

const END: u32 = 400_000;

proptest! {
    /// Random motions, switches and leases, with words written any time ahead.
    #[test]
    fn words_make_the_edges_of_the_axis(
        kind in kinds(),
        plans in prop::collection::vec((parts(), 0u32..40_000, prop::option::of(lease())), 1..4),
        ahead in 200u32..4000,
        chunk in 1u32..300,
        pace in 50u32..3000,
    ) {
        let mut machine = Machine::new(kind);
        let mut axis = Axis::<F, Queue<64>>::new(kind.output(), Queue::new());
        let mut levels = vec![(0, 0)];
        let mut plans = plans.into_iter();
        let (mut now, mut epoch, mut next, mut until) = (1000, 0, 1500, 0);
        while now < END {
            // Only one switch may wait, and the axis is behind the words.
            let has_begun = axis.channel().epoch() == Epoch(epoch);
            if now >= next && has_begun && let Some((parts, gap, lease)) = plans.next() {
                // The tick up to which words have been written.
                let at = machine.words.channel().horizon().after(kind.turn());
                epoch += 1;
                let items = items(kind, at.0, &parts);
                machine.push(epoch, &items);
                for item in items {
                    axis.queue_mut().push(Entry { epoch: Epoch(epoch), item }).unwrap();
                }
                let (lease, limit) = match lease {
                    Some((ticks, limit)) => (Lease::Until(at.after(ticks)), Some(limit)),
                    None => (Lease::Off, None),
                };
                // Of two motors the one that looks further ahead may find the lapse first. It is passed to both.
                if let Some(lapse) = machine.words.channel().lapse() {
                    axis.channel_mut().lapse_at(lapse);
                }
                for channel in [machine.words.channel_mut(), axis.channel_mut()] {
                    prop_assert_eq!(channel.schedule_switch(Epoch(epoch), at, lease, limit), Ok(()));
                }
                next = now + gap;
            }
            until = until.max(now + ahead);
            while machine.fill(until, chunk) == Filled::Part {
                if !machine.tape.has_room(2) {
                    break;
                }
            }
            prop_assert!(!machine.words.setup_cut_short());
            machine.play(now);
            axis_levels(&mut axis, &mut levels, now);
            machine.tape.pass(Tick32(now));
            let by_lines = machine.counted.last().unwrap().1;
            if let Kind::StepDir { .. } = kind {
                prop_assert_eq!(axis.channel().position(), by_lines);
            }
            let overhead = machine.words.overhead();
            prop_assert_eq!(machine.tape.position_at(Tick32(now), overhead, &machine.memory), axis.channel().position());
            prop_assert_eq!(machine.tape.position_after(machine.done), axis.channel().position());
            if let [.., (before, was), (tick, is)] = machine.counted[..] {
                let last = machine.tape.last(machine.done, overhead, &machine.memory);
                prop_assert_eq!(last, (Tick32(tick), if before == 0 { last.1 } else { tick - before }, is - was));
            }
            now += pace.min(ahead / 2);
        }
        prop_assert_eq!(machine.words.channel().missed(), None);
        let cause = |lapse: Option<Lapse>| lapse.map(|lapse| lapse.cause);
        prop_assert_eq!(cause(machine.words.channel().lapse()), cause(axis.channel().lapse()));
        prop_assert_eq!(machine.words.channel().position(), axis.channel().position());
        // Coils whose next step comes within a word's time are not switched off before it.
        if let Kind::Coils { .. } = kind {
            let ticks: Vec<_> = levels.iter().map(|(tick, _)| *tick).skip(1).chain([u32::MAX]).collect();
            let mut next = ticks.iter();
            levels.retain(|(tick, on)| *next.next().unwrap() - tick >= 3 || *on != 0);
            levels.dedup_by_key(|(_, on)| *on);
        }
        prop_assert_eq!(machine.levels, levels);
    }
}

fn run(count: u32, ticks: i64, direction: Direction) -> Item {
    Item::Run { segment: Segment { count, interval: ticks << F, add: 0, add2: 0 }, direction }
}

const DRIVER: Kind = Kind::StepDir { pulse: 10, setup: 20, forward_high: true, dir_first: false };

/// A machine whose tape has begun with one epoch of `items`.
fn begun(kind: Kind, items: &[Item]) -> Machine {
    let mut machine = Machine::new(kind);
    machine.push(1, items);
    assert_eq!(machine.words.channel_mut().schedule_switch(Epoch(1), Tick32(3000), Lease::Off, None), Ok(()));
    machine
}

#[test]
fn all_that_is_between_is_in_a_word() {
    let items = [Item::Anchor { tick: Tick32(5000) }, run(2, 100, Forward), run(1, 200, Backward)];
    let mut machine = begun(DRIVER, &items);
    assert_eq!(machine.fill(6000, 100), Filled::All);
    let words: Vec<_> = machine.memory[..machine.tape.written() as usize]
        .iter()
        .map(|word| (word & LONGEST_WAIT, lines(*word)))
        .collect();
    // First the word of `begin`, to tick 2003. A step's word waits for its period minus 13; DIR comes 20 ticks before its step; then rest up to
    // 6000.
    let (dir, step) = (0b1010, 0b0001);
    let expected = [
        (1000, 0),
        (5080 - 2003 - 13, dir),
        (20 - 13, dir | step),
        (100 - 13, dir | step),
        (180 - 13, 0),
        (20 - 13, step),
        (6000 - 5400 - 13, 0),
    ];
    assert_eq!(words, expected);
}

/// A run is unpacked correctly even if steps of the run before could not be made.
#[test]
fn runs_after_a_missed_step_are_as_they_were_told() {
    let bent = |count: u32, ticks: i64, add: i64| Item::Run {
        segment: Segment { count, interval: ticks << F, add: (add << F) + 77, add2: 3 },
        direction: Forward,
    };
    // The first step of a run comes too soon, then one in its middle.
    for missed in [run(30, 5, Forward), bent(30, 100, -9)] {
        let items = [
            Item::Anchor { tick: Tick32(5000) },
            run(20, 100, Forward),
            bent(24, 100, 1),
            missed,
            Item::Anchor { tick: Tick32(30_000) },
            bent(20, 120, 2),
            bent(25, 160, -3),
            run(20, 90, Forward),
        ];
        let mut machine = begun(DRIVER, &items);
        let mut axis = Axis::<F, Queue<64>>::new(DRIVER.output(), Queue::new());
        for item in items {
            axis.queue_mut().push(Entry { epoch: Epoch(1), item }).unwrap();
        }
        axis.channel_mut().schedule_switch(Epoch(1), Tick32(3000), Lease::Off, None).unwrap();
        let mut levels = vec![(0, 0)];
        for until in (4000..50_000).step_by(1000) {
            machine.fill(until, 10_000);
            machine.play(until);
            axis_levels(&mut axis, &mut levels, until);
            machine.tape.pass(Tick32(until));
        }
        assert!(axis.channel().missed().is_some());
        assert_eq!(machine.words.channel().missed(), axis.channel().missed());
        assert_eq!(machine.levels, levels);
        assert_eq!(machine.words.channel().position(), axis.channel().position());
    }
}

#[test]
fn dir_without_room_goes_with_the_step() {
    let items = [Item::Anchor { tick: Tick32(5000) }, run(1, 100, Backward), run(1, 15, Forward)];
    let mut machine = begun(DRIVER, &items);
    assert_eq!(machine.fill(6000, 100), Filled::All);
    machine.play(6000);
    assert!(machine.words.setup_cut_short());
    assert_eq!(machine.levels, [(0, 0), (5100, 1), (5110, 0), (5115, 3), (5125, 2)]);
}

#[test]
fn a_full_tape_waits_for_time_to_pass() {
    let mut machine = begun(DRIVER, &[Item::Anchor { tick: Tick32(5000) }, run(10_000, 20, Forward)]);
    assert_eq!(machine.fill(200_000, 10_000), Filled::Part);
    assert!(!machine.tape.has_room(2));
    let written = machine.tape.written();
    assert!((N as u32 - 1..=N as u32).contains(&written), "{written}");
    // The places of a run are free once the next run is done.
    let first = machine.memory[..N].to_vec();
    machine.tape.pass(Tick32(5000 + 20 * 521));
    assert_eq!(machine.fill(200_000, 10_000), Filled::Part);
    assert!((256..=262).contains(&(machine.tape.written() - written)));
    assert_eq!(machine.memory[264..], first[264..], "what is to be played stays");
}

#[test]
fn no_more_is_written_than_was_allowed() {
    let mut machine = begun(DRIVER, &[Item::Anchor { tick: Tick32(5000) }, run(10_000, 20, Forward)]);
    assert_eq!(machine.fill(20_000, 10), Filled::Part);
    assert!(machine.tape.written() <= 10 + 256);
}

#[test]
fn a_stop_counts_what_was_made() {
    for (kind, sign) in [(DRIVER, 1), (DRIVER, -1), (coils(Sequence::Half), 1), (coils(Sequence::Full), -1)] {
        let direction = if sign > 0 { Forward } else { Backward };
        let mut machine = begun(kind, &[Item::Anchor { tick: Tick32(5000) }, run(1000, 50, direction)]);
        machine.fill(12_000, 1000);
        machine.play(6020);
        let made = machine.tape.position_after(machine.done);
        assert_eq!(made, 20 * sign);
        let (words, packed) = (&mut machine.words, &mut machine.packed);
        words.stop(&mut packed.items(&machine.pool), made, lines(machine.memory[machine.done as usize - 1]));
        assert_eq!(words.channel().position(), made);
        assert!(words.is_idle(packed, Tick32(6020)));
        // It continues with the coils at the phase of this position.
        machine.start(19_000);
        let before = machine.levels.last().unwrap().1;
        machine.push(2, &[Item::Anchor { tick: Tick32(30_000) }, run(1, 100, direction.reversed())]);
        assert_eq!(machine.words.channel_mut().schedule_switch(Epoch(2), Tick32(25_000), Lease::Off, None), Ok(()));
        machine.fill(24_000, 1000);
        machine.play(24_000);
        if let Kind::Coils { .. } = kind {
            assert_eq!(machine.levels.last().unwrap().1, before, "no coil is switched");
        }
        machine.fill(40_000, 1000);
        machine.play(40_000);
        assert_eq!(machine.tape.position_after(machine.done), 19 * sign);
        if let Kind::Coils { sequence, .. } = kind {
            let back = if sequence == Sequence::Half { 1 } else { 2 };
            let phase = |levels: u32| {
                pulsetrain_core::output::HALF_STEPS.iter().position(|p| u32::from(*p) == levels).unwrap() as i32
            };
            assert_eq!((phase(before) - back * sign).rem_euclid(8), phase(machine.levels.last().unwrap().1));
        }
    }
}

fn coils(sequence: Sequence) -> Kind {
    Kind::Coils { sequence, release: None }
}

#[test]
fn checks_are_compared() {
    for off in [0, 1] {
        let mut machine = begun(DRIVER, &[Item::Anchor { tick: Tick32(5000) }, run(5, 100, Backward)]);
        let check = Check { position: -5i16 as u16, tick: Tick32(5500 + off), fraction: 1 << 15 };
        let mut bytes = [0; 10];
        let len = PACKING.pack_check(&check, &mut bytes).unwrap();
        machine.packed.push(&mut machine.pool, Epoch(1), &bytes[..len]).unwrap();
        let mut packer = machine.packer;
        let mut bytes = [0; MAX_PACKED_LEN];
        let len = PACKING.pack(&mut packer, &run(5, 100, Backward), &mut bytes).unwrap();
        machine.packed.push(&mut machine.pool, Epoch(1), &bytes[..len]).unwrap();
        assert_eq!(machine.fill(20_000, 100), Filled::All);
        let (position, fault) = if off == 0 { (-10, None) } else { (-5, Some(Fault::CheckFailed)) };
        assert_eq!((machine.words.channel().position(), machine.packed.fault()), (position, fault));
    }
}

#[test]
fn bytes_that_are_none_end_their_epoch() {
    let mut machine = begun(DRIVER, &[Item::Anchor { tick: Tick32(5000) }, run(5, 100, Backward)]);
    machine.packed.push(&mut machine.pool, Epoch(1), &[0x37, 0, 1, 2, 3]).unwrap();
    // The first switch has been made, so that another may wait.
    assert_eq!(machine.fill(4000, 100), Filled::All);
    machine.push(2, &[Item::Anchor { tick: Tick32(9000) }, run(5, 100, Forward)]);
    assert_eq!(machine.words.channel_mut().schedule_switch(Epoch(2), Tick32(9000), Lease::Off, None), Ok(()));
    assert_eq!(machine.fill(20_000, 100), Filled::All);
    assert_eq!((machine.words.channel().position(), machine.packed.fault()), (0, Some(Fault::BadItem)));
    assert!(machine.words.is_idle(&machine.packed, Tick32(20_000)));
    machine.packed.items(&machine.pool).clear();
    assert_eq!(usize::from(machine.packed.room()), POOL);
}

#[test]
fn resets_and_reversals_in_a_row_are_no_items() {
    let mut machine = begun(DRIVER, &[]);
    let mut bytes = [0; 200];
    let mut len = 0;
    for _ in 0..20 {
        len += PACKING.pack_reset(&mut machine.packer, &mut bytes[len..]).unwrap();
    }
    machine.packed.push(&mut machine.pool, Epoch(1), &bytes[..len]).unwrap();
    machine.push(1, &[Item::Anchor { tick: Tick32(5000) }, run(5, 1 << 30, Backward), run(1, 5, Backward)]);
    assert_eq!(machine.fill(20_000, 100), Filled::All);
    assert_eq!(machine.packed.fault(), None);
}

/// Under a lease a motor does not stop at once at wrong bytes: it brakes from its speed.
#[test]
fn what_is_no_item_makes_a_motor_brake() {
    // R is 1200 ticks, 4 intervals.
    let limit = Limit::new(150, 10 + F as u8, 0).unwrap();
    let check = |wrong: &[u8]| {
        let mut machine = Machine::new(DRIVER);
        machine.push(1, &[Item::Anchor { tick: Tick32(5000) }, run(50, 300, Forward)]);
        machine.packed.push(&mut machine.pool, Epoch(1), wrong).unwrap();
        machine.packed.push(&mut machine.pool, Epoch(2), &[1, 2, 3]).unwrap();
        let lease = Lease::Until(Tick32(40_000));
        machine.words.channel_mut().schedule_switch(Epoch(1), Tick32(3000), lease, Some(limit)).unwrap();
        for until in (3000..60_000).step_by(500) {
            while machine.fill(until, 100) == Filled::Part {}
            machine.play(until);
            machine.tape.pass(Tick32(until));
        }
        let channel = machine.words.channel();
        assert_eq!(channel.lapse().map(|lapse| lapse.cause), Some(LapseCause::BadItem), "{wrong:?}");
        let (position, registers) = (channel.position(), RegisterLimits::with_fraction_bits(F));
        let (mut steps, mut interval) = (0, 300 << F);
        while let BrakingPart::Steps { count, add } = limit.next(interval, &registers) {
            (steps, interval) = (steps + count, interval + i64::from(count) * add);
        }
        assert_eq!(position, 50 + steps.cast_signed() + 1, "{wrong:?}");
        assert_eq!(machine.counted.last().unwrap().1, position);
        // Items of another epoch still wait.
        assert!(!channel.accepts(Epoch(1)) && channel.accepts(Epoch(2)) && channel.is_done());
        assert_eq!(usize::from(machine.packed.room()), POOL - 3);
    };
    // An unknown control record, and a check that says another position.
    check(&[0x07 | 9 << 3, 0]);
    check(&[0x2f, 0, 1, 0, 2, 0, 0, 0, 0, 0]);
}

/// Ten hours of steps, forward and back, through a thousand wraps of 32-bit ticks: each word's tick, added up in 64 bits, is the one of exact
/// arithmetic.
#[test]
fn ten_hours_lose_no_tick() {
    const HZ: u64 = 125_000_000;
    const TEN_HOURS: u64 = 36_000 * HZ;
    let kind = Kind::StepDir { pulse: 13, setup: 3, forward_high: true, dir_first: false };
    let mut machine = Machine::new(kind);
    let mut tick = u64::from(machine.tick.0);
    let push = |machine: &mut Machine, item: &Item| {
        let mut bytes = [0; MAX_PACKED_LEN];
        let len = PACKING.pack(&mut machine.packer, item, &mut bytes).unwrap();
        machine.packed.push(&mut machine.pool, Epoch(0), &bytes[..len]).unwrap();
    };
    let first = 10_000_000_u32;
    push(&mut machine, &Item::Anchor { tick: Tick32(first) });
    let mut exact = (i128::from(first) << F) + (1 << (F - 1));
    let mut due = std::collections::VecDeque::new();
    let (mut number, mut steps, mut position) = (0_u64, 0_u64, 0_i32);
    let mut now = u64::from(first);
    while now < TEN_HOURS {
        while usize::from(machine.packed.room()) > MAX_PACKED_LEN && due.len() < 4000 {
            // Some 100 steps/s, with fractions of all kinds, faster and slower.
            let fraction = number.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let segment = Segment {
                count: 300 + (fraction % 500) as u32,
                interval: (1_250_000 << F) + (fraction >> 20) as i64,
                add: (fraction >> 30) as i32 as i64 * 4,
                add2: (fraction >> 50) as i64 - (1 << 13),
            };
            let direction = if number / 7 % 2 == 0 { Forward } else { Backward };
            number += 1;
            push(&mut machine, &Item::Run { segment, direction });
            let sign = if direction == Forward { 1 } else { -1 };
            due.extend((1..=segment.count).map(|k| ((exact + segment.span(k)) >> F, sign)));
            exact += segment.span(segment.count);
        }
        now += 6_000_000;
        while machine.fill(now as u32, 400) == Filled::Part {}
        while machine.done != machine.tape.written() {
            let word = machine.memory[machine.done as usize % N];
            tick += u64::from((word & LONGEST_WAIT) + kind.overhead());
            machine.done += 1;
            if lines(word) & 1 != 0 {
                let (ought, sign) = due.pop_front().expect("a step too many");
                assert_eq!(i128::from(tick), ought, "step {steps}");
                (steps, position) = (steps + 1, position.wrapping_add(sign));
            }
        }
        assert_eq!(machine.words.channel().position(), position);
        machine.words.pass(Tick32(now as u32));
        machine.tape.pass(Tick32(now as u32));
    }
    assert!(tick + HZ > TEN_HOURS && steps > 3_000_000, "{steps} steps up to tick {tick}");
    assert_eq!((machine.packed.fault(), machine.words.channel().missed()), (None, None));
}
