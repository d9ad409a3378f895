//! Channel, output and merge together, compared with a model in rational numbers.

use dashu::rational::RBig;
use proptest::prelude::*;
use pulsetrain_core::channel::{Channel, EventKind, SwitchRefused};
use pulsetrain_core::lease::Lease;
use pulsetrain_core::output::{Coils, Edge, HALF_STEPS, Output, Sequence, StepDir, StepDirSettings};
use pulsetrain_core::{Axis, Direction, Entry, Epoch, Item, Merge, Queue, Segment, Tick32};

use Direction::{Backward, Forward};

const F: u32 = 16;
const PULSE: u32 = 5;
const SETUP: u32 = 7;
const HOLD: u32 = 3;
const STEP: u32 = 1;
const DIR: u32 = 2;

fn driver(forward_high: bool) -> Output {
    let settings = StepDirSettings {
        step_line: 0,
        dir_line: 1,
        pulse_ticks: PULSE,
        setup_ticks: SETUP,
        forward_high,
        shared_dir: false,
    };
    Output::StepDir(StepDir::new(settings))
}

fn run(count: u32, ticks: i64, direction: Direction) -> Item {
    Item::Run { segment: Segment { count, interval: ticks << F, add: 0, add2: 0 }, direction }
}

fn anchor(tick: u32) -> Item {
    Item::Anchor { tick: Tick32(tick) }
}

fn push<const N: usize>(axis: &mut Axis<F, Queue<N>>, epoch: u8, items: &[Item]) {
    for &item in items {
        axis.queue_mut().push(Entry { epoch: Epoch(epoch), item }).unwrap();
    }
}

/// All edges up to `until`.
fn edges<const N: usize>(axis: &mut Axis<F, Queue<N>>, until: u32) -> Vec<Edge> {
    let edges = std::iter::from_fn(|| axis.next(Tick32(until))).collect();
    axis.pass(Tick32(until));
    edges
}

/// A scheduled step.
type Scheduled = (i128, Direction);

/// Ticks and directions of `items`, by rational arithmetic.
fn schedule(items: &[Item]) -> Vec<Scheduled> {
    let one = RBig::from(1u64 << F);
    let mut time = RBig::from(0);
    let mut steps = Vec::new();
    for item in items {
        match *item {
            Item::Anchor { tick } => time = RBig::from(tick.0) + RBig::from(1) / RBig::from(2),
            Item::Dwell { ticks } => time += RBig::from(ticks),
            Item::Run { segment, direction } => {
                let [interval, add, add2] = [segment.interval, segment.add, segment.add2].map(|x| RBig::from(x) / &one);
                let at = |k: u32| {
                    let k = RBig::from(k);
                    let pairs = &k * (&k - RBig::from(1)) / RBig::from(2);
                    let triples = &pairs * (&k - RBig::from(2)) / RBig::from(3);
                    &k * &interval + pairs * &add + triples * &add2
                };
                for k in 1..=segment.count {
                    steps.push(((&time + at(k)).floor().try_into().unwrap(), direction));
                }
                time += at(segment.count);
            }
        }
    }
    steps
}

/// The steps that the edges of a step/dir driver make. It also checks the width of pulses, and set-up and hold of DIR.
fn read_back(edges: &[Edge], forward_high: bool) -> Vec<Scheduled> {
    let (mut dir_high, mut dir_since, mut rise, mut fall) = (false, None, None, None);
    let mut steps = Vec::new();
    for edge in edges {
        let tick = i128::from(edge.tick.0);
        if edge.clear & STEP != 0 {
            assert_eq!(rise.take(), Some(tick - i128::from(PULSE)), "a pulse is not {PULSE} ticks wide");
            fall = Some(tick);
        }
        if (edge.set | edge.clear) & DIR != 0 && dir_high != (edge.set & DIR != 0) {
            assert!(rise.is_none(), "DIR changes inside a pulse");
            assert!(fall.is_none_or(|fall| tick - fall >= i128::from(HOLD)), "DIR is not held");
            dir_high = edge.set & DIR != 0;
            dir_since = Some(tick);
        }
        if edge.set & STEP != 0 {
            assert!(dir_since.is_none_or(|since| tick - since >= i128::from(SETUP)), "DIR comes late");
            steps.push((tick, if dir_high == forward_high { Forward } else { Backward }));
            assert!(rise.replace(tick).is_none());
        }
    }
    assert!(rise.is_none(), "a pulse has no end");
    steps
}

fn position(steps: &[Scheduled]) -> i32 {
    steps.iter().map(|(_, direction)| direction.sign()).sum()
}

/// Items that a planner might make from tick `from` on: intervals between 10 and about 1000 ticks, reversals with
/// room for DIR, waits between.
fn motion(from: u32) -> impl Strategy<Value = Vec<Item>> {
    let interval = (10i64 << F)..(1000 << F);
    let part = (1u32..40, interval.clone(), interval, any::<bool>(), prop::option::of(0u32..5000), -1i64..=1);
    prop::collection::vec(part, 1..8).prop_map(move |parts| {
        let mut items = vec![anchor(from)];
        let mut last = None;
        for (count, first, last_interval, forward, wait, add2) in parts {
            let direction = if forward { Forward } else { Backward };
            if last.replace(direction) != Some(direction) {
                items.push(Item::Dwell { ticks: PULSE + HOLD + SETUP });
            }
            if let Some(ticks) = wait {
                items.push(Item::Dwell { ticks });
            }
            let add = (last_interval - first) / i64::from(count);
            items.push(Item::Run { segment: Segment { count, interval: first, add, add2 }, direction });
        }
        items
    })
}

/// Increasing ticks up to which the board is advanced.
fn looks() -> impl Strategy<Value = Vec<u32>> {
    prop::collection::vec(1u32..3000, 0..60).prop_map(|gaps| {
        gaps.into_iter()
            .scan(0, |tick, gap| {
                *tick += gap;
                Some(*tick)
            })
            .collect()
    })
}

const END: u32 = 1 << 30;

proptest! {
    #[test]
    fn steps_are_where_rationals_put_them(items in motion(100), forward_high: bool, looks in looks()) {
        let expected = schedule(&items);
        let mut whole = Axis::<F, Queue<64>>::new(driver(forward_high), Queue::new());
        push(&mut whole, 0, &items);
        let mut pieces = whole.clone();

        let in_one = edges(&mut whole, END);
        prop_assert_eq!(read_back(&in_one, forward_high), &expected[..]);
        prop_assert_eq!(whole.channel().position(), position(&expected));
        prop_assert!(whole.is_idle());
        prop_assert!(!whole.setup_cut_short());
        prop_assert_eq!(whole.channel().missed(), None);

        let mut in_pieces = Vec::new();
        for until in looks.into_iter().chain([END]) {
            in_pieces.extend(edges(&mut pieces, until));
            let made = in_pieces.iter().filter(|edge| edge.set & STEP != 0).count();
            prop_assert_eq!(made, expected.iter().filter(|(tick, _)| *tick <= i128::from(until)).count());
            prop_assert_eq!(pieces.channel().position(), position(&expected[..made]));
        }
        prop_assert_eq!(in_pieces, in_one);
    }

    #[test]
    fn at_a_switch_the_old_epoch_ends_and_the_new_begins(
        old in motion(100),
        new in motion(0),
        now in 0u32..20_000,
        ahead in 0u32..20_000,
        looks in looks(),
    ) {
        let mut axis = Axis::<F, Queue<64>>::new(driver(true), Queue::new());
        push(&mut axis, 0, &old);
        let mut made = edges(&mut axis, now);
        let at = now + 1 + ahead;
        let new: Vec<Item> = [anchor(at), Item::Dwell { ticks: PULSE + HOLD + SETUP }].into_iter().chain(new.into_iter().skip(1)).collect();
        push(&mut axis, 1, &new);
        let horizon = axis.channel().horizon();
        match axis.channel_mut().schedule_switch(Epoch(1), Tick32(at), Lease::Off, None) {
            Ok(()) => prop_assert!(at >= horizon.0),
            Err(refused) => {
                prop_assert!(at < horizon.0);
                prop_assert_eq!(refused, SwitchRefused::Late { horizon });
                axis.queue_mut().discard(Epoch(1));
            }
        }
        let old_steps = schedule(&old);
        let expected: Vec<Scheduled> = if at < horizon.0 {
            old_steps
        } else {
            old_steps.into_iter().filter(|(tick, _)| *tick < i128::from(at)).chain(schedule(&new)).collect()
        };
        let mut other = axis.clone();
        let rest = edges(&mut other, END);
        for until in looks.into_iter().map(|look| now + look).chain([END]) {
            made.extend(edges(&mut axis, until));
            let by_now = expected.iter().filter(|(tick, _)| *tick <= i128::from(until)).count();
            prop_assert_eq!(axis.channel().position(), position(&expected[..by_now]));
        }
        prop_assert!(made.ends_with(&rest));
        prop_assert_eq!(read_back(&made, true), expected);
    }

    #[test]
    fn whatever_is_in_the_queue_steps_counted_are_pulses(
        entries in prop::collection::vec(
            (0u8..3, prop_oneof![
                any::<u32>().prop_map(anchor),
                (0u32..4000).prop_map(anchor),
                any::<u32>().prop_map(|ticks| Item::Dwell { ticks }),
                (0u32..50, -2_000_000i64..40_000_000, -1000i64..1000, -9i64..9, any::<bool>()).prop_map(
                    |(count, interval, add, add2, forward)| Item::Run {
                        segment: Segment { count, interval, add, add2 },
                        direction: if forward { Forward } else { Backward },
                    },
                ),
                (any::<u32>(), any::<i64>(), any::<i64>(), any::<i64>()).prop_map(|(count, interval, add, add2)| {
                    Item::Run { segment: Segment { count: count >> 20, interval, add, add2 }, direction: Backward }
                }),
            ]),
            0..40,
        ),
        switches in prop::collection::vec((0u32..4000, 0u8..3, any::<u32>()), 0..6),
    ) {
        let mut axis = Axis::<F, Queue<40>>::new(driver(true), Queue::new());
        for (epoch, item) in entries {
            axis.queue_mut().push(Entry { epoch: Epoch(epoch), item }).unwrap();
        }
        let (mut now, mut high, mut counted, mut dir_high, mut last) = (0, false, 0i32, false, None);
        let mut look = |axis: &mut Axis<F, Queue<40>>, until| {
            for edge in edges(axis, until) {
                assert!(last.is_none_or(|last| edge.tick.0 >= last), "edges are out of order");
                last = Some(edge.tick.0);
                dir_high = (dir_high && edge.clear & DIR == 0) || edge.set & DIR != 0;
                if edge.set & STEP != 0 {
                    assert!(!std::mem::replace(&mut high, true));
                    counted += if dir_high { 1 } else { -1 };
                }
                if edge.clear & STEP != 0 {
                    assert!(std::mem::replace(&mut high, false));
                }
            }
            assert_eq!(axis.channel().position(), counted);
        };
        for (gap, epoch, ahead) in switches {
            now += gap;
            look(&mut axis, now);
            let _ = axis.channel_mut().schedule_switch(Epoch(epoch), Tick32(now.wrapping_add(ahead >> (epoch * 9))), Lease::Off, None);
        }
        look(&mut axis, now + (1 << 16));
        axis.stop();
        look(&mut axis, now + (1 << 17));
        prop_assert!(axis.is_idle());
        prop_assert!(!high);
    }

    #[test]
    fn merged_edges_are_those_of_the_streams(
        streams in prop::collection::vec(prop::collection::vec((0u32..6, 0u32..16, 0u32..16), 0..40), 3),
        from: u32,
    ) {
        let streams: Vec<Vec<Edge>> = streams
            .into_iter()
            .map(|stream| {
                let mut tick = Tick32(from);
                stream.into_iter().map(|(gap, set, clear)| { tick = tick.after(gap); Edge { tick, set, clear: clear & !set } }).collect()
            })
            .collect();
        let mut heads: Vec<_> = streams.iter().map(|stream| stream.iter().copied()).collect();
        let mut merge = Merge::<3>::new();
        let merged: Vec<Edge> = std::iter::from_fn(|| merge.next(|i| heads[i].next())).collect();

        let (mut levels, mut next) = (0, merged.iter());
        for offset in 0..240 {
            let tick = Tick32(from).after(offset);
            let before = levels;
            for edge in streams.iter().flatten().filter(|edge| edge.tick == tick) {
                levels = (levels & !edge.clear) | edge.set;
            }
            if levels != before {
                let expected = Edge { tick, set: levels & !before, clear: before & !levels };
                prop_assert_eq!(next.next(), Some(&expected));
            }
        }
        prop_assert_eq!(next.next(), None);
        prop_assert_eq!(merge.levels(), levels);
    }

    #[test]
    fn coils_go_through_their_patterns_and_back(
        steps in prop::collection::vec((20u32..200, any::<bool>()), 1..60),
        sequence in prop_oneof![Just(Sequence::Wave), Just(Sequence::Full), Just(Sequence::Half)],
        release in prop::option::of(1u32..200),
    ) {
        let mut axis = Axis::<F, Queue<64>>::new(Output::Coils(Coils::new([0, 1, 2, 3], sequence, release)), Queue::new());
        push(&mut axis, 0, &[anchor(0)]);
        for &(ticks, forward) in &steps {
            push(&mut axis, 0, &[run(1, i64::from(ticks), if forward { Forward } else { Backward })]);
        }
        let (first, half_steps): (i32, i32) = match sequence { Sequence::Wave => (1, 2), Sequence::Full => (0, 2), Sequence::Half => (0, 1) };
        let (mut phase, mut tick, mut expected) = (first, 0u32, Vec::new());
        for (place, &(ticks, forward)) in steps.iter().enumerate() {
            tick += ticks;
            phase += if forward { half_steps } else { -half_steps };
            expected.push((tick, u32::from(HALF_STEPS[phase.rem_euclid(8) as usize])));
            if let Some(release) = release && steps.get(place + 1).is_none_or(|(next, _)| release < *next) {
                expected.push((tick + release, 0));
            }
        }
        let mut levels = 0;
        let mut seen = Vec::new();
        for edge in edges(&mut axis, END) {
            prop_assert_eq!((levels & edge.set, !levels & edge.clear), (0, 0), "an edge is redundant");
            levels = (levels & !edge.clear) | edge.set;
            if edge.set | edge.clear != 0 {
                seen.push((edge.tick.0, levels));
            }
        }
        prop_assert_eq!(seen, expected);
    }
}

/// The patterns that the Pico plotter's program puts on the pins, bit 0 on IN1. Forward, it goes through them in this order.
#[test]
fn coils_go_the_way_of_the_seed() {
    let half: [u32; 8] = [0b1001, 0b1000, 0b1100, 0b0100, 0b0110, 0b0010, 0b0011, 0b0001];
    let full: [u32; 4] = [0b1001, 0b1100, 0b0110, 0b0011];
    let wave: [u32; 4] = [0b1000, 0b0100, 0b0010, 0b0001];
    let cases: [(Sequence, &[u32]); 3] = [(Sequence::Half, &half), (Sequence::Full, &full), (Sequence::Wave, &wave)];
    for (sequence, patterns) in cases {
        for (direction, sign) in [(Forward, 1), (Backward, -1)] {
            let mut axis =
                Axis::<F, Queue<8>>::new(Output::Coils(Coils::new([0, 1, 2, 3], sequence, None)), Queue::new());
            push(&mut axis, 0, &[anchor(0), run(20, 100, direction)]);
            let mut levels = 0;
            // An edge without lines is a change of DIR, which coils do not have.
            let changes = edges(&mut axis, END).into_iter().filter(|edge| edge.set | edge.clear != 0);
            for (number, edge) in (1_i32..).zip(changes) {
                levels = levels & !edge.clear | edge.set;
                let place = (sign * number).rem_euclid(patterns.len() as i32) as usize;
                assert_eq!(levels, patterns[place], "{sequence:?}, step {number} {direction:?}");
            }
            assert_ne!(levels, 0, "{sequence:?}: no edge");
        }
    }
}

#[test]
fn the_direction_comes_before_its_step_with_its_tick() {
    let mut channel = Channel::<F>::new(1, false);
    let mut queue = Queue::<4>::new();
    for item in [anchor(10), run(2, 100, Forward), run(1, 50, Backward)] {
        queue.push(Entry { epoch: Epoch(0), item }).unwrap();
    }
    let events: Vec<_> = std::iter::from_fn(|| {
        let event = channel.peek(&mut queue, Tick32(END))?;
        channel.take(event);
        Some((event.tick.0, event.kind))
    })
    .collect();
    let expected = [
        (110, EventKind::Direction(Forward)),
        (110, EventKind::Step),
        (210, EventKind::Step),
        (260, EventKind::Direction(Backward)),
        (260, EventKind::Step),
    ];
    assert_eq!(events, expected);
}

#[test]
fn time_wraps() {
    let mut axis = Axis::<F, Queue<8>>::new(driver(true), Queue::new());
    for quarter in 0..4 {
        assert_eq!(edges(&mut axis, quarter << 30), []);
    }
    axis.pass(Tick32(u32::MAX - 500));
    push(&mut axis, 0, &[anchor(u32::MAX - 99), run(3, 100, Forward)]);
    let ticks: Vec<u32> = edges(&mut axis, 1000).iter().map(|edge| edge.tick.0).collect();
    assert_eq!(ticks, [0u32.wrapping_sub(SETUP), 0, PULSE, 100, 100 + PULSE, 200, 200 + PULSE]);
    // A day at rest. The accumulator's old tick must not count as one in the future.
    for quarter in 1..40u32 {
        assert_eq!(edges(&mut axis, quarter.wrapping_mul(1 << 30)), []);
    }
    let now = 39u32.wrapping_mul(1 << 30);
    push(&mut axis, 0, &[run(1, 1000, Forward)]);
    assert_eq!(edges(&mut axis, now.wrapping_add(2000)), []);
    assert!(axis.channel().missed().is_some(), "a run without an anchor");
    assert_eq!(axis.channel().position(), 3);
}

#[test]
fn waits_add_up_to_more_than_a_moment_holds() {
    let mut axis = Axis::<F, Queue<16>>::new(driver(true), Queue::new());
    push(&mut axis, 0, &[anchor(0)]);
    push(&mut axis, 0, &[Item::Dwell { ticks: i32::MAX as u32 }; 5]);
    push(&mut axis, 0, &[run(1, 100, Forward)]);
    let expected = 5 * i64::from(i32::MAX) + 100;
    for now in (0i64..).step_by(1 << 29) {
        let rises: Vec<Edge> = edges(&mut axis, now as u32).into_iter().filter(|edge| edge.set & STEP != 0).collect();
        assert_eq!(rises.len(), usize::from(now - (1 << 29) < expected && expected <= now), "at {now}");
        if now > expected {
            assert_eq!(axis.channel().position(), 1);
            break;
        }
    }
}

#[test]
fn what_comes_too_late_is_not_made() {
    let mut axis = Axis::<F, Queue<8>>::new(driver(true), Queue::new());
    push(&mut axis, 0, &[anchor(0), run(3, 100, Forward)]);
    assert_eq!(edges(&mut axis, 350).len(), 7);
    push(&mut axis, 0, &[run(3, 20, Forward)]);
    assert_eq!(edges(&mut axis, 500), []);
    assert_eq!(axis.channel().missed(), Some(Tick32(320)));
    assert!(axis.is_idle());
    push(&mut axis, 0, &[run(3, 1000, Forward), anchor(900), run(1, 100, Forward)]);
    assert_eq!(edges(&mut axis, 2000)[0].tick, Tick32(1000));
}

#[test]
fn one_switch_waits_and_a_sooner_one_replaces_it() {
    let mut channel = Channel::<F>::new(1, false);
    let mut switch = |epoch, at| channel.schedule_switch(Epoch(epoch), Tick32(at), Lease::Off, None);
    assert_eq!(switch(1, 2000), Ok(()));
    assert_eq!(switch(2, 2001), Err(SwitchRefused::Full));
    assert_eq!(switch(2, 2000), Ok(()));
    assert_eq!(switch(3, 1000), Ok(()));
    assert_eq!(switch(4, 1500), Err(SwitchRefused::Full));
    let mut queue = Queue::<1>::new();
    let mut epochs = Vec::new();
    for now in [999, 1000, 1999, 2000] {
        assert_eq!(channel.peek(&mut queue, Tick32(now)), None);
        epochs.push(channel.epoch().0);
    }
    assert_eq!(epochs, [0, 3, 3, 3]);
    let mut switch = |epoch, at| channel.schedule_switch(Epoch(epoch), Tick32(at), Lease::Off, None);
    assert_eq!(switch(4, 999), Err(SwitchRefused::Late { horizon: Tick32(1000) }));
    assert_eq!(switch(4, 3000), Ok(()));
}

#[test]
fn a_shared_dir_line_says_every_step_its_direction() {
    let output = |step_line| {
        Output::StepDir(StepDir::new(StepDirSettings {
            step_line,
            dir_line: 2,
            pulse_ticks: 2,
            setup_ticks: 3,
            forward_high: true,
            shared_dir: true,
        }))
    };
    let mut axes =
        [Axis::<F, Queue<4>>::new(output(0), Queue::new()), Axis::<F, Queue<4>>::new(output(1), Queue::new())];
    push(&mut axes[0], 0, &[anchor(0), run(3, 100, Forward)]);
    push(&mut axes[1], 0, &[anchor(50), run(2, 100, Backward)]);
    let mut merge = Merge::<2>::new();
    let edges: Vec<(u32, u32, u32)> =
        std::iter::from_fn(|| merge.next(|i| axes[i].next(Tick32(1000)))).map(|e| (e.tick.0, e.set, e.clear)).collect();
    let expected = [
        (97, 4, 0),
        (100, 1, 0),
        (102, 0, 1),
        (147, 0, 4),
        (150, 2, 0),
        (152, 0, 2),
        (197, 4, 0),
        (200, 1, 0),
        (202, 0, 1),
        (247, 0, 4),
        (250, 2, 0),
        (252, 0, 2),
        (297, 4, 0),
        (300, 1, 0),
        (302, 0, 1),
    ];
    assert_eq!(edges, expected);
}
