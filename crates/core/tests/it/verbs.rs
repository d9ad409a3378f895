//! Motors that obey verbs: every step at its tick, none lost, none twice, compared with a model that looks at each tick.

use proptest::prelude::*;
use pulsetrain_core::channel::EventKind;
use pulsetrain_core::verbs::motor::{LONGEST_PERIOD, MAX_ITEMS, MAX_UNREPORTED};
use pulsetrain_core::verbs::{Heading, Motor, MotorTiming, Refused, Verb, Verbs};
use pulsetrain_core::winch::text::LineFault;
use pulsetrain_core::winch::verb_lines::{LONGEST, VerbLine, VerbReply, read};
use pulsetrain_core::wire::frame::{Encoder, Received, Tag};
use pulsetrain_core::wire::message::{self, Command, Reason, kind};
use pulsetrain_core::wire::orders::{MAX_ORDERS, NextStep, Obeyed, Orders, order};
use pulsetrain_core::wire::{Decoder, MAX_FRAME, Refusal};
use pulsetrain_core::{Channel, Direction, Entry, Epoch, Item, Queue, Tick32};

const LIMITS: MotorTiming = MotorTiming { shortest: 3, turn: 40, period: 25 };

/// What a motor did: steps with their ticks, and the ticks at which moves were finished.
#[derive(Debug, Default, PartialEq)]
struct Made {
    steps: Vec<(u64, Direction)>,
    done: Vec<u64>,
}

/// From this tick on the host is gone. It hears of finished moves `lag` ticks later.
#[derive(Clone, Copy, Debug)]
struct Cut {
    at: u64,
    lag: u64,
}

impl Cut {
    const NEVER: Cut = Cut { at: u64::MAX, lag: 0 };

    /// Whether a host hears of a move that was ordered at `begun` and finished at `tick`.
    fn is_heard(self, begun: u64, tick: u64) -> bool {
        begun >= self.at || (tick < self.at && tick <= self.at.saturating_sub(self.lag))
    }
}

/// The model: it looks at each tick whether a step is due.
fn by_the_letter(script: &[(u64, Verb)], cut: Cut, end: u64) -> Made {
    let (mut made, mut period, mut course) = (Made::default(), 25, Heading::Forward);
    // Moves, the first of which is under way: steps left (None: without an end), and when it was ordered.
    let mut moves: Vec<(Option<u32>, u64)> = Vec::new();
    let mut script = script.iter().peekable();
    for tick in 0..end {
        while let Some((_, verb)) = script.next_if(|(at, _)| *at == tick) {
            let mut begin = |steps| match moves[..] {
                [] => moves.push((steps, tick)),
                [(None, _), ..] => moves = vec![(steps, tick)],
                [(Some(_), _)] => moves.push((steps, tick)),
                _ => {}
            };
            match *verb {
                Verb::Move { steps } => begin(Some(steps)),
                Verb::Run => begin(None),
                Verb::Speed { ticks } if ticks >= 3 => period = ticks,
                Verb::Speed { .. } => {}
                Verb::Heading(to) => course = to,
                Verb::Halt => moves.clear(),
            }
        }
        let since = made.steps.last().map_or(u64::MAX, |(last, _)| tick - last);
        while let Some(&(Some(0), begun)) = moves.first()
            && since >= period
        {
            moves.remove(0);
            if cut.is_heard(begun, tick) {
                made.done.push(tick);
            }
        }
        let Some(direction) = course.direction() else { continue };
        let turns = made.steps.last().is_some_and(|(_, facing)| *facing != direction);
        if since < period || (turns && since < 40) {
            continue;
        }
        if let Some((left, _)) = moves.first_mut() {
            *left = left.map(|left| left - 1);
            made.steps.push((tick, direction));
        }
    }
    made
}

/// The motor itself, with slices and a channel, and which orders of the script it obeyed. Moves are reported `lag` ticks behind the end of the
/// last slice, as on a board, which works out steps ahead.
fn by_slices(script: &[(u64, Verb)], cut: Cut, end: u64, slices: &[u64]) -> (Made, Vec<(u64, Verb)>) {
    let (mut motor, mut known) = (Motor::new(LIMITS, 0, 0), 0);
    let (mut queue, mut channel) = (Queue::<64>::new(), Channel::<32>::new(1, false));
    let (mut made, mut lengths) = (Made::default(), slices.iter().cycle());
    let mut script = script.iter().peekable();
    let mut obeyed = Vec::new();
    while known < end {
        let next = script.peek().map_or(end, |(at, _)| *at).min(known + lengths.next().expect("cycles")).min(end);
        let next = if known < cut.at { next.min(cut.at) } else { next };
        let mut items = 0;
        motor.work_out::<32>(next, |item| {
            items += 1;
            queue.push(Entry { epoch: Epoch(0), item }).expect("room");
        });
        assert!(items <= MAX_ITEMS);
        known = next;
        // If the channel is advanced less far, it takes the rest with the next slice.
        let limit = Tick32::of(known).before(1);
        while let Some(event) = channel.peek(&mut queue, limit) {
            channel.take(event);
            match event.kind {
                EventKind::Direction(_) => {}
                EventKind::Step => made.steps.push((event.tick.0.into(), channel.direction())),
            }
        }
        assert!(queue.is_empty() && channel.missed().is_none());
        let told = known.saturating_sub(cut.lag);
        while let Some((at, number)) = motor.take_done(told) {
            made.done.push(at);
            assert!(known >= cut.at || number as usize == made.done.len(), "none is left out");
        }
        assert!(motor.next_done().is_none_or(|at| at > told));
        if known == cut.at {
            motor.mute_moves();
        }
        while let Some((_, verb)) = script.next_if(|(at, _)| *at == known) {
            // A script may have orders that are refused: then nothing happens.
            if motor.obey(*verb, known).is_ok() {
                obeyed.push((known, *verb));
            }
        }
    }
    made.done.extend(std::iter::from_fn(|| motor.take_done(end)).map(|(at, _)| at));
    assert_eq!(motor.position(), made.steps.iter().map(|(_, direction)| direction.sign()).sum::<i32>());
    (made, obeyed)
}

fn verb() -> impl Strategy<Value = Verb> {
    prop_oneof![
        3 => (0u32..9).prop_map(|steps| Verb::Move { steps }),
        1 => Just(Verb::Run),
        3 => (0u64..120).prop_map(|ticks| Verb::Speed { ticks }),
        1 => Just(Verb::Heading(Heading::Stationary)),
        2 => Just(Verb::Heading(Heading::Forward)),
        2 => Just(Verb::Heading(Heading::Backward)),
        1 => Just(Verb::Halt),
    ]
}

fn script() -> impl Strategy<Value = Vec<(u64, Verb)>> {
    prop::collection::vec((0u64..300, verb()), 0..40).prop_map(|script| {
        let mut at = 0;
        let step = |(wait, verb)| {
            at += wait;
            (at, verb)
        };
        script.into_iter().map(step).collect()
    })
}

proptest! {
    #[test]
    fn every_step_is_where_the_letter_has_it(script in script(), slices in prop::collection::vec(1u64..400, 1..8)) {
        let end = script.last().map_or(0, |(at, _)| *at) + 2000;
        prop_assert_eq!(by_slices(&script, Cut::NEVER, end, &slices).0, by_the_letter(&script, Cut::NEVER, end));
    }

    /// A host that hears late still hears of every move that was accepted. A move that could not be reported is refused.
    #[test]
    fn every_move_is_told(script in script(), slices in prop::collection::vec(1u64..400, 1..8), lag in 1u64..3000) {
        let end = script.last().map_or(0, |(at, _)| *at) + 2000;
        let cut = Cut { lag, ..Cut::NEVER };
        let (made, obeyed) = by_slices(&script, cut, end, &slices);
        prop_assert_eq!(made, by_the_letter(&obeyed, cut, end));
    }

    /// A second host hears of its own moves, and of no others.
    #[test]
    fn moves_of_who_is_gone_are_nobodys(
        script in script(), slices in prop::collection::vec(1u64..400, 1..8), at in 1u64..4000, lag in prop_oneof![Just(0), 1u64..3000]
    ) {
        let end = script.last().map_or(0, |(at, _)| *at) + 2000;
        let cut = Cut { at: 1 + at % (end - 1), lag };
        let (made, obeyed) = by_slices(&script, cut, end, &slices);
        prop_assert_eq!(made, by_the_letter(&obeyed, cut, end));
    }

    /// Any line is read, or refused at one of its words. Any payload is read, or refused.
    #[test]
    fn any_bytes_are_read(line in prop::collection::vec(prop_oneof![any::<u8>(), prop::sample::select(&b"move speed dir run halt xyza 0129-"[..])], 0..81)) {
        match read(&line) {
            VerbLine::Refused(_, word) => prop_assert!((2..=7).contains(&word)),
            VerbLine::Orders(told) => prop_assert!((1..=4).contains(&told.orders().expect("orders").iter().count())),
            VerbLine::Unknown => {}
        }
        if let Some(orders) = Orders::decode(&line) {
            prop_assert_eq!(orders.iter().count() * 9, line.len());
        }
    }

    #[test]
    fn orders_are_read_as_they_were_written(orders in prop::collection::vec((0u8..8, verb()), 0..=MAX_ORDERS)) {
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        let command = Command::Orders(Orders::decode(&bytes).expect("whole orders"));
        let mut frame = [0; MAX_FRAME];
        let len = command.encode(7, Tag(3), &mut frame).expect("fits");
        let mut decoder: Decoder = Decoder::new();
        prop_assert_eq!(decoder.feed(&frame[..len]), (len, Received::Frame(Tag(3))));
        let [7, kind::ORDERS, payload @ ..] = decoder.body() else { panic!("{:?}", decoder.body()) };
        prop_assert_eq!(Command::decode(kind::ORDERS, payload), Ok(command));
        let Ok(Command::Orders(read)) = Command::decode(kind::ORDERS, payload) else { panic!() };
        for motor in 0..8 {
            prop_assert!(read.of(motor).eq(orders.iter().filter(|order| order.0 == motor).map(|order| order.1)));
        }
        prop_assert_eq!(read.iter().collect::<Vec<_>>(), orders);
    }
}

/// Counts and ticks of steps, from the items alone, because a channel would take too long for so many.
fn count(steps: u32, ticks: u64, slice: u64) -> (u64, u64, u64) {
    let limits = MotorTiming { shortest: 1, turn: 1, period: 1 };
    let mut motor = Motor::new(limits, 0, 0);
    motor.obey(Verb::Speed { ticks }, 1000).unwrap();
    motor.obey(Verb::Move { steps }, 1000).unwrap();
    let (mut known, mut count, mut at, mut first) = (0, 0, 0u64, None);
    loop {
        known += slice;
        motor.work_out::<32>(known, |item| match item {
            Item::Anchor { tick } => {
                // The tick with these low bits in the slice.
                let from = known - slice;
                at = from + u64::from(tick.since(Tick32::of(from)).cast_signed().max(0).cast_unsigned());
                if tick.is_before(Tick32::of(from)) {
                    at = from - 1;
                }
            }
            Item::Run { segment, .. } => {
                assert_eq!((segment.add, segment.add2, segment.interval & 0xffff_ffff), (0, 0, 0));
                first.get_or_insert(at + (segment.interval >> 32).cast_unsigned());
                at += (segment.interval >> 32).cast_unsigned() * u64::from(segment.count);
                count += u64::from(segment.count);
            }
            Item::Dwell { .. } => panic!("it makes none"),
        });
        if let Some((done, number)) = motor.take_done(u64::MAX) {
            assert_eq!((number, motor.is_at_rest()), (1, true));
            assert_eq!(motor.position(), steps.cast_signed());
            assert_eq!(first.unwrap_or(1000), 1000);
            return (count, at, done);
        }
    }
}

/// MOVE n makes exactly n steps, a period apart, across all boundaries of items and slices. It is finished a period after the last step.
#[test]
fn a_move_has_exactly_its_steps() {
    assert_eq!(count(0, 5, 777), (0, 0, 1000));
    for (steps, ticks, slice) in [
        (1, 50, 12_500),
        (2, 12_500, 12_500),
        (8, 12_499, 12_500),
        (100, 125_000, 12_500),
        (2000, 125_000, 10_007),
        (2000, 7, 12_500),
        (65_536, 3, 999),
        // Periods may be longer than the channel's intervals of 31 bits, and than ticks of 32 bits.
        (3, (1 << 31) - 1, 1 << 29),
        (3, 1 << 31, 1 << 29),
        (3, 1 << 32, 1 << 29),
        (3, (1 << 33) + 12_345, 1 << 29),
        (2, 1 << 40, 1 << 30),
        (u32::MAX, 1, 1 << 30),
        (u32::MAX, 3, 1 << 30),
    ] {
        let last = 1000 + u64::from(steps - 1) * ticks;
        assert_eq!(count(steps, ticks, slice), (steps.into(), last, last + ticks), "{steps} steps, {ticks} ticks");
    }
}

#[test]
fn what_cannot_be_is_refused_and_changes_nothing() {
    let mut motor = Motor::new(LIMITS, 0, 0);
    assert_eq!(motor.obey(Verb::Speed { ticks: 2 }, 9), Err(Refused::Period { shortest: 3 }));
    assert_eq!(motor.obey(Verb::Speed { ticks: LONGEST_PERIOD + 1 }, 9), Err(Refused::Period { shortest: 3 }));
    assert_eq!(motor.obey(Verb::Speed { ticks: LONGEST_PERIOD }, 9), Ok(()));
    for steps in [4, 5] {
        assert_eq!(motor.obey(Verb::Move { steps }, 9), Ok(()));
    }
    assert_eq!(motor.obey(Verb::Move { steps: 6 }, 9), Err(Refused::Busy));
    assert_eq!(motor.obey(Verb::Run, 9), Err(Refused::Busy));
    assert_eq!(motor.next_step(), Some(9));

    let mut verbs = Verbs::new();
    verbs.begin([(LIMITS, 5), (LIMITS, -5)].into_iter(), 100);
    let mut tell = |orders: &[(u8, Verb)]| {
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        Orders::decode(&bytes).expect("whole orders").tell(&mut verbs)
    };
    let go = Verb::Move { steps: 1 };
    let refused = |reason, detail| Err(Refusal { reason, detail });
    assert_eq!(tell(&[(0, go), (2, go)]), refused(Reason::NoSuchMotor, 2));
    assert_eq!(tell(&[(0, go), (1, Verb::Speed { ticks: 1 })]), refused(Reason::Period, 3));
    assert_eq!(tell(&[(1, go), (1, go), (1, go)]), refused(Reason::Busy, 1));
    // Nothing of all that was done.
    let obeyed = tell(&[]).expect("a question");
    let rests = |position| NextStep { position, wait: u32::MAX };
    assert_eq!((obeyed.tick, obeyed.motors()), (100, &[rests(5), rests(-5)][..]));
    let obeyed = tell(&[(1, go)]).expect("possible");
    assert_eq!(obeyed.motors(), [rests(5), NextStep { position: -5, wait: 0 }]);
}

/// A dropped move that would not have been reported is not counted as unreported any more: the next one is reported.
#[test]
fn what_is_forgotten_is_nobodys_no_more() {
    let go = Verb::Move { steps: 1 };
    let begin = || {
        let mut motor = Motor::new(LIMITS, 0, 0);
        (0..2).for_each(|_| motor.obey(go, 0).unwrap());
        motor
    };
    let ways: [fn(&mut Motor); 3] = [
        |motor| motor.obey(Verb::Halt, 10).unwrap(),
        |motor| motor.stop(10),
        // The first move is finished. The second waits, because the heading is stationary.
        |motor| {
            motor.obey(Verb::Heading(Heading::Stationary), 10).unwrap();
            motor.drop_endless();
            motor.obey(Verb::Heading(Heading::Forward), 10).unwrap();
        },
    ];
    for (number, forget) in ways.into_iter().enumerate() {
        let mut motor = begin();
        motor.work_out::<32>(10, |_| {});
        motor.mute_moves();
        forget(&mut motor);
        motor.obey(go, 10).unwrap();
        motor.work_out::<32>(1000, |_| {});
        let told: Vec<u64> = std::iter::from_fn(|| motor.take_done(1000)).map(|(at, _)| at).collect();
        assert_eq!(told, [50], "{number}");
    }
}

/// Two motors get these orders at tick 100, and lose their host at 151. Returns where they stop, and which of them are uncertain, with pull-in
/// intervals of 30 and of 20 ticks.
fn forsaken(orders: &[(u8, Verb)], lost: bool) -> ([i32; 2], u8) {
    let mut verbs = Verbs::new();
    verbs.begin([(LIMITS, 0); 2].into_iter(), 100);
    let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
    Orders::decode(&bytes).expect("whole orders").tell(&mut verbs).expect("possible");
    verbs.work_out::<32>(151, |_, _| {});
    let uncertain = verbs.host_gone(lost, |motor| [30, 20][usize::from(motor)]);
    verbs.work_out::<32>(1 << 20, |_, _| {});
    assert!(verbs.rest_at(1 << 20), "{orders:?}");
    let positions: Vec<i32> = verbs.motors().iter().map(Motor::position).collect();
    ([positions[0], positions[1]], uncertain)
}

/// The host is gone: runs end, and moves too if the host was lost. A motor that was too fast to stop at once is flagged.
#[test]
fn a_motor_without_a_host_stops() {
    let go = |steps| Verb::Move { steps };
    let run_and_move = [(0, Verb::Run), (1, go(10))];
    assert_eq!(forsaken(&run_and_move, false), ([3, 10], 1));
    assert_eq!(forsaken(&run_and_move, true), ([3, 3], 1));
    // A move goes on to its end, also if a run waits after it.
    assert_eq!(forsaken(&[(0, go(20)), (0, Verb::Run), (1, go(10)), (1, go(4))], false), ([20, 14], 0));
    // Everything that would never end is dropped. A move before it is finished.
    let stands = Verb::Heading(Heading::Stationary);
    assert_eq!(forsaken(&[(0, stands), (0, go(5)), (1, stands), (1, go(0)), (1, go(3))], false), ([0, 0], 0));
    // At an interval of 16 ticks both are too fast. A motor that has made all its steps is not.
    let fast = Verb::Speed { ticks: 16 };
    assert_eq!(forsaken(&[(0, fast), (1, fast), (0, go(99)), (1, go(99))], true), ([4, 4], 3));
    assert_eq!(forsaken(&[(0, fast), (1, fast), (0, go(4)), (1, go(4))], true), ([4, 4], 0));
}

/// Each of two motors has moves of one and of two steps, which would be finished at 125 and 175.
fn two_moves_each() -> Verbs {
    let mut verbs = Verbs::new();
    verbs.begin([(LIMITS, 0), (LIMITS, 0)].into_iter(), 100);
    let moves = |motor| [order(motor, Verb::Move { steps: 1 }), order(motor, Verb::Move { steps: 2 })].concat();
    let bytes = [moves(0), moves(1)].concat();
    Orders::decode(&bytes).expect("whole orders").tell(&mut verbs).expect("possible");
    verbs.work_out::<32>(1000, |_, _| {});
    assert!(verbs.rest_at(175) && !verbs.rest_at(174));
    verbs
}

fn told(verbs: &mut Verbs) -> Vec<(u8, u64, u32)> {
    let told = std::iter::from_fn(|| verbs.take_done(u64::MAX)).collect();
    assert_eq!(verbs.next_done(), None);
    assert!(verbs.motors().iter().all(Motor::is_reported));
    told
}

/// After an immediate stop, moves that were finished by then are reported, and later ones are not, at each motor's own tick.
#[test]
fn who_is_stopped_was_not_done_later() {
    for (at, count) in [(0, 0), (124, 0), (125, 1), (174, 1), (175, 2)] {
        let mut verbs = two_moves_each();
        verbs.stop(|motor| if motor == 0 { at } else { 174 });
        assert!(verbs.rest_at(175));
        let all = [(0, 125, 1), (0, 175, 2)];
        assert_eq!(told(&mut verbs), [&all[..count], &[(1, 125, 1)]].concat(), "stopped at {at}");
    }
}

/// A finished move that the host has not heard of is reported after a new configuration too, even if its motor is not configured any longer. Later moves
/// count from 1.
#[test]
fn who_begins_anew_is_told_what_was_done_before() {
    for count in [1, 2] {
        let mut verbs = two_moves_each();
        verbs.stop(|_| 174);
        verbs.begin([(LIMITS, 0); 2].into_iter().take(count), 300);
        let one = order(0, Verb::Move { steps: 1 });
        Orders::decode(&one).expect("one order").tell(&mut verbs).expect("possible");
        verbs.work_out::<32>(1000, |_, _| {});
        assert_eq!(told(&mut verbs), [(0, 125, 1), (0, 325, 1), (1, 125, 1)]);
    }
}

/// A move that could not be reported is refused. As soon as one is reported, another is accepted.
#[test]
fn a_move_that_could_not_be_told_is_refused() {
    let mut motor = Motor::new(LIMITS, 0, 0);
    let go = |motor: &mut Motor, number: u64| {
        let taken = motor.obey(Verb::Move { steps: 1 }, 1000 * number);
        motor.work_out::<32>(1000 * number + 500, |_| {});
        taken
    };
    for number in 0..u64::from(MAX_UNREPORTED) {
        assert_eq!(go(&mut motor, number), Ok(()));
    }
    assert_eq!(go(&mut motor, 4), Err(Refused::Busy));
    // Runs and speeds need no place.
    assert_eq!(motor.obey(Verb::Speed { ticks: 30 }, 4500), Ok(()));
    assert_eq!(motor.obey(Verb::Run, 4500), Ok(()));
    assert_eq!(motor.obey(Verb::Halt, 4500), Ok(()));
    assert_eq!(motor.take_done(u64::MAX), Some((25, 1)));
    assert_eq!(go(&mut motor, 5), Ok(()));
    assert_eq!(go(&mut motor, 6), Err(Refused::Busy));
    let told: Vec<_> = std::iter::from_fn(|| motor.take_done(u64::MAX)).collect();
    assert_eq!(told, [(1025, 2), (2025, 3), (3025, 4), (5030, 5)]);
    assert!(motor.is_reported());
}

#[test]
fn orders_that_are_none_are_refused() {
    let good = order(3, Verb::Move { steps: u32::MAX });
    assert!(Orders::decode(&good).is_some() && Orders::decode(&[]).is_some());
    let bad = |at: usize, byte: u8| {
        let mut order = good;
        order[at] = byte;
        Orders::decode(&order).is_none()
    };
    // A bit between motor and verb; an unknown verb; 2^32 steps; a value where there must be none; half an order; one too many.
    assert_eq!([bad(0, 0x0b), bad(0, 0x53), bad(5, 1), bad(0, 0x33)], [true; 4]);
    assert_eq!(Orders::decode(&good[..8]), None);
    assert_eq!(Orders::decode(&good.repeat(9)), None);
    assert_eq!(Command::decode(kind::ORDERS, &good[..8]), Err(Reason::Malformed));
}

#[test]
fn what_came_of_orders_is_read_as_it_was_written() {
    for count in 0..=8 {
        let motors = (0..count).map(|motor| (motor - 4, (motor & 1 == 0).then_some(1 << (40 + motor) | 77)));
        let obeyed = Obeyed::new(1 << 40, motors);
        let mut frame = [0; MAX_FRAME];
        let mut to = Encoder::new(&mut frame);
        to.u8(9);
        to.u8(kind::ORDERS | kind::ANSWER);
        obeyed.encode(&mut to);
        let len = to.finish(Tag(1)).expect("the longest fits");
        let mut decoder: Decoder = Decoder::new();
        decoder.feed(&frame[..len]);
        assert_eq!(message::Reply::decode(decoder.body()), Some((9, message::Reply::Obeyed(obeyed))));
        assert_eq!(message::Reply::decode(&decoder.body()[..decoder.body().len() - 1]), None);
    }
}

#[test]
fn lines_say_what_orders_do() {
    fn told(line: &str, expected: &[(u8, Verb)]) {
        let VerbLine::Orders(told) = read(line.as_bytes()) else { panic!("{line}: {:?}", read(line.as_bytes())) };
        assert_eq!(told.orders().expect("orders").iter().collect::<Vec<_>>(), expected, "{line}");
        assert_eq!(told.axes(), expected.iter().fold(0, |axes, (axis, _)| axes | 1 << axis));
    }
    let go = |steps| Verb::Move { steps };
    told("move x 4294967295", &[(0, go(u32::MAX))]);
    told(" move\tax  +1   0 ", &[(3, go(1)), (0, go(0))]);
    told("speed xyza 4611686018427387904", &[0, 1, 2, 3].map(|axis| (axis, Verb::Speed { ticks: 1 << 62 })));
    told("dir zx -1 0", &[(2, Verb::Heading(Heading::Backward)), (0, Verb::Heading(Heading::Stationary))]);
    told("dir y 1", &[(1, Verb::Heading(Heading::Forward))]);
    told("run yz", &[(1, Verb::Run), (2, Verb::Run)]);
    told("halt", &[0, 1, 2, 3].map(|axis| (axis, Verb::Halt)));
    told("halt a", &[(3, Verb::Halt)]);

    for (line, what, word) in [
        ("move", LineFault::Missing, 2),
        ("move x", LineFault::Missing, 3),
        ("move xyz 1 2", LineFault::Missing, 5),
        ("move x 1 2", LineFault::Extra, 4),
        ("run x 1", LineFault::Extra, 3),
        ("move b 1", LineFault::Flags, 2),
        ("move xx 1", LineFault::Flags, 2),
        ("move x 4294967296", LineFault::Range, 3),
        ("move x -1", LineFault::Range, 3),
        ("move xy 1 1e3", LineFault::Number, 4),
        ("speed x -", LineFault::Number, 3),
        ("speed x 99999999999999999999999", LineFault::Range, 3),
        ("dir x 2", LineFault::Range, 3),
    ] {
        let refused = match read(line.as_bytes()) {
            // A value that is beyond a motor's limits is refused by the motor.
            VerbLine::Orders(told) if line.starts_with("speed") => {
                assert_eq!(told.orders().expect("orders").iter().next(), Some((0, Verb::Speed { ticks: u64::MAX })));
                continue;
            }
            refused => refused,
        };
        assert_eq!(refused, VerbLine::Refused(what, word), "{line}");
    }
    for line in ["", "  ", "a x 5", "mov x 1", "MOVE x 1", "enable 1"] {
        assert_eq!(read(line.as_bytes()), VerbLine::Unknown, "{line}");
    }
}

#[test]
fn replies_are_lines() {
    fn check(reply: VerbReply, expected: &str) {
        let mut line = [0; LONGEST];
        let len = reply.write(&mut line);
        assert_eq!(std::str::from_utf8(&line[..len]), Ok(format!("{expected}\r\n").as_str()));
    }
    let motors = [(i32::MIN, Some(7)), (5, None), (0, Some(u64::MAX)), (i32::MAX, Some(u64::from(u32::MAX - 1) + 7))];
    let obeyed = Obeyed::new(7, motors.into_iter());
    check(VerbReply::At { obeyed, axes: 0b0101 }, "at 7 x -2147483648 0 z 0 -");
    check(VerbReply::At { obeyed, axes: 0b1010 }, "at 7 y 5 - a 2147483647 4294967294");
    check(VerbReply::Done { axis: 1, tick: 0, number: u32::MAX }, "done y 0 4294967295");
    check(VerbReply::Unread(LineFault::Missing, 3), "err missing 3");
    check(VerbReply::Refused(Refusal { reason: Reason::Period, detail: 500 }), "err period 500");
    check(VerbReply::Refused(Refusal { reason: Reason::Busy, detail: 2 }), "err busy z");
    check(VerbReply::Refused(Refusal::of(Reason::NotArmed)), "err stopped");
    check(VerbReply::Refused(Refusal::of(Reason::Moving)), "err moving");
    check(VerbReply::Path, "err path");
    check(VerbReply::Verbs, "err verbs");
    // The longest reply: a tick of 20 digits, and the longest wait.
    let tick = u64::MAX - u64::from(u32::MAX - 1);
    let worst = Obeyed::new(tick, [(i32::MIN, Some(u64::MAX)); 4].into_iter());
    let mut line = [0; 2 * LONGEST];
    let len = VerbReply::At { obeyed: worst, axes: 0b1111 }.write(&mut line);
    assert!(line[..len].ends_with(b" a -2147483648 4294967294\r\n"), "{:?}", str::from_utf8(&line[..len]));
    assert_eq!(len, LONGEST);
}
