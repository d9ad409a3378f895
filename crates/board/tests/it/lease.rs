//! Leases on the native board: what it does when one ends is what the host replays, to the tick.

use proptest::prelude::*;
use pulsetrain_board::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use pulsetrain_board::replay::{Replay, Sent, Start};
use pulsetrain_board::{Board, Config, Edge, MotorConfig, Native, Observer, ScheduledStep, Wiring, WithReference};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;
use pulsetrain_core::output::{Output, StepDir, StepDirSettings};
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause};
use pulsetrain_core::{Axis, Direction, Entry, Epoch, Item, Queue, Segment, Tick32};

use Direction::{Backward, Forward};

const PULSE: u32 = 6;
const SETUP: u32 = 4;
const HOLD: u32 = 5;
const APART: u64 = (PULSE + SETUP + HOLD) as u64;
const EPOCH: Epoch = Epoch(1);
/// When the plans begin.
const ZERO: u64 = 1000;

/// Motor m has STEP on line 2m, and DIR on line 2m + 1 or, if it shares that of another, there.
fn board(fraction_bits: u32, dirs: &[u8]) -> Native {
    let wiring = |(motor, dir): (usize, &u8)| Wiring::StepDir {
        step: 2 * motor as u8,
        dir: 2 * dir + 1,
        forward_high: motor % 2 == 0,
        pulse_ticks: PULSE,
        setup_ticks: SETUP,
    };
    let motor = |wiring| MotorConfig { wiring, pull_in_ticks: 500 };
    let motors = dirs.iter().enumerate().map(wiring).map(motor).collect();
    Native::new(&Config { fraction_bits, motors }).unwrap().with_dir_hold(HOLD)
}

/// Counts pulses as drivers would, and keeps what was scheduled.
struct Lab {
    dirs: Vec<u8>,
    levels: u32,
    counted: Vec<i64>,
    steps: Vec<ScheduledStep>,
    /// Of each line, when it changed and when a pulse that needs it ended, to see that drivers had their setup and hold.
    changed: [u64; 32],
    needed: [u64; 32],
}

impl Lab {
    fn new(dirs: &[u8]) -> Lab {
        let dirs = dirs.to_vec();
        Lab { counted: vec![0; dirs.len()], dirs, levels: 0, steps: Vec::new(), changed: [0; 32], needed: [0; 32] }
    }
}

impl Observer for Lab {
    fn edge(&mut self, edge: Edge) {
        self.levels ^= 1 << edge.line;
        if edge.line % 2 == 1 {
            let line = usize::from(edge.line);
            assert!(edge.tick >= self.needed[line], "line {line} at {} is held up to {}", edge.tick, self.needed[line]);
            self.changed[line] = edge.tick;
        } else if edge.level {
            let motor = usize::from(edge.line / 2);
            let line = usize::from(2 * self.dirs[motor] + 1);
            assert!(
                edge.tick >= self.changed[line] + u64::from(SETUP) || self.changed[line] == 0,
                "motor {motor} at {}",
                edge.tick
            );
            // A line that no other motor needs is the planner's to hold.
            let shared = self.dirs.iter().filter(|dir| **dir == self.dirs[motor]).count() > 1;
            self.needed[line] = edge.tick + u64::from(PULSE) + if shared { u64::from(HOLD) } else { 0 };
            let forward = (self.levels >> line & 1 == 1) == (motor % 2 == 0);
            self.counted[motor] += if forward { 1 } else { -1 };
        }
    }

    fn step(&mut self, step: ScheduledStep) {
        self.steps.push(step);
    }
}

/// A piece of a motor's plan.
#[derive(Clone, Copy, Debug)]
enum Piece {
    /// Steps, the interval changing by so many 2^-10 of itself in all.
    Run { count: u32, ticks: u32, fraction: u32, bend: i64 },
    /// A wait, and then perhaps the other way.
    Wait { ticks: u32, turn: bool },
    /// The other way at once.
    Turn,
    /// A rest that ends in an anchor.
    Anchor { ticks: u32 },
}

fn piece() -> impl Strategy<Value = Piece> {
    let run = || {
        (1u32..60, 60u32..2000, any::<u32>(), -400i64..400).prop_map(|(count, ticks, fraction, bend)| Piece::Run {
            count,
            ticks,
            fraction,
            bend,
        })
    };
    prop_oneof![
        6 => run(),
        1 => (0u32..3000, any::<bool>()).prop_map(|(ticks, turn)| Piece::Wait { ticks, turn }),
        1 => Just(Piece::Turn),
        1 => (30u32..3000).prop_map(|ticks| Piece::Anchor { ticks }),
    ]
}

/// The items of a motor: they begin with an anchor and end in a wait of nothing.
fn items(f: u32, pieces: &[Piece], delay: u32, forward: bool) -> Vec<Item> {
    let mut direction = if forward { Forward } else { Backward };
    let mut accumulator = (i128::from(ZERO + u64::from(delay)) << f) + (1 << (f - 1));
    let anchor = |accumulator: i128| Item::Anchor { tick: Tick32::of((accumulator >> f) as u64) };
    let mut items = vec![anchor(accumulator)];
    for piece in pieces {
        match *piece {
            Piece::Run { count, ticks, fraction, bend } => {
                let interval = i64::from(ticks) << f | i64::from(fraction >> (32 - f));
                let segment = Segment { count, interval, add: (interval >> 10) * bend / i64::from(count), add2: 0 };
                accumulator += segment.span(count);
                items.push(Item::Run { segment, direction });
            }
            Piece::Wait { ticks, turn } => {
                accumulator += i128::from(ticks) << f;
                items.push(Item::Dwell { ticks });
                direction = if turn { direction.reversed() } else { direction };
            }
            Piece::Turn => direction = direction.reversed(),
            Piece::Anchor { ticks } => {
                accumulator = (((accumulator >> f) + i128::from(ticks)) << f) + (1 << (f - 1));
                items.push(anchor(accumulator));
            }
        }
    }
    items.push(Item::Dwell { ticks: 0 });
    items
}

/// What a host does next; fractions are of what there is.
#[derive(Clone, Copy, Debug)]
enum Act {
    Advance {
        ticks: u64,
    },
    Push {
        items: usize,
    },
    /// Up to this part of what has been sent, 2^-8.
    Extend {
        part: u64,
    },
    /// The same, and so many items of each motor are taken back.
    Trim {
        part: u64,
        items: [u8; 4],
    },
    Last,
    Brake,
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        8 => (1u64..6000).prop_map(|ticks| Act::Advance { ticks }),
        6 => (1usize..4).prop_map(|items| Act::Push { items }),
        10 => (0u64..=256).prop_map(|part| Act::Extend { part }),
        3 => (0u64..=256, any::<[u8; 4]>()).prop_map(|(part, items)| Act::Trim { part, items: items.map(|n| n % 4) }),
        1 => Just(Act::Last),
        1 => Just(Act::Brake),
    ]
}

/// A host: what it sends and has sent.
struct Host<'a> {
    f: u32,
    plans: &'a [Vec<Item>],
    /// Items of each plan that were sent.
    sent: Vec<usize>,
    limits: &'a [Limit],
    lines: Vec<Option<(usize, bool)>>,
}

impl Host<'_> {
    fn replay(&self, until: Option<u64>) -> Replay<'_> {
        let motors =
            self.plans.iter().zip(&self.sent).zip(self.limits).zip(&self.lines).map(|(((plan, sent), limit), line)| {
                Sent {
                    start: Start::at(ZERO, self.f),
                    items: &plan[..*sent],
                    limit: *limit,
                    gap_ticks: u64::from(PULSE) + 1,
                    line: *line,
                }
            });
        Replay::new(motors, &[APART; 8], self.f, until)
    }

    /// The tick of the last step that was sent, of the motor that goes on and has least; `None` if none goes on.
    fn told(&self) -> Option<u64> {
        let mut last = vec![ZERO; self.plans.len()];
        self.replay(None).for_each(|step| last[step.motor] = last[step.motor].max(step.tick));
        let goes_on = |motor: &usize| self.sent[*motor] < self.plans[*motor].len();
        (0..last.len()).filter(goes_on).map(|motor| last[motor]).min()
    }
}

/// The DIR lines of motors, and of each its pieces, when it begins and whether it goes forward first.
type Wired = (Vec<u8>, Vec<(Vec<Piece>, u32, bool)>);

/// Motors that keep apart on the lines that they share: two on each, at the same speed, in turns.
fn sharing() -> impl Strategy<Value = Wired> {
    let pair = (prop::collection::vec((1u32..40, 80u32..300), 1..6), any::<[bool; 2]>()).prop_map(|(runs, forward)| {
        // The next run's first step comes with its own interval, for both; half of the shortest is enough for the line.
        let pieces =
            runs.iter().map(|&(count, ticks)| Piece::Run { count, ticks, fraction: 0, bend: 0 }).collect::<Vec<_>>();
        let shortest = runs.iter().map(|(_, ticks)| *ticks).min().unwrap_or(0);
        [(pieces.clone(), 0, forward[0]), (pieces, shortest / 2, forward[1])]
    });
    prop::collection::vec(pair, 1..=2).prop_map(|pairs| {
        let dirs = (0..pairs.len() as u8).flat_map(|pair| [2 * pair; 2]).collect();
        (dirs, pairs.into_iter().flatten().collect())
    })
}

fn apart() -> impl Strategy<Value = Wired> {
    prop::collection::vec((prop::collection::vec(piece(), 1..12), 20u32..2000, any::<bool>()), 1..=8)
        .prop_map(|motors| ((0..motors.len() as u8).collect(), motors))
}

fn limits() -> impl Strategy<Value = Vec<(u8, u8, u8)>> {
    prop::collection::vec((128..=255u8, 6..13u8, 0..4u8), 8)
}

proptest! {
    #[test]
    fn whatever_the_host_does_the_stop_is_as_it_is_replayed(
        f in prop_oneof![Just(16u32), Just(24), Just(32)],
        (dirs, motors) in prop_oneof![2 => apart(), 1 => sharing()],
        limits in limits(),
        acts in prop::collection::vec(act(), 1..60),
        first in (1usize..6, 0u64..=256),
        stretches in prop::collection::vec(1u64..5000, 1..4),
    ) {
        let plans: Vec<Vec<Item>> =
            motors.iter().map(|(pieces, delay, forward)| items(f, pieces, *delay, *forward)).collect();
        let limits: Vec<Limit> =
            limits.iter().take(plans.len()).map(|&(m, e, l)| Limit::new(m, e + f as u8, l).unwrap()).collect();
        let shares = |motor: usize| dirs.iter().filter(|dir| **dir == dirs[motor]).count() > 1;
        let lines = (0..dirs.len()).map(|motor| shares(motor).then(|| (usize::from(dirs[motor]), motor % 2 == 0))).collect();
        let mut host = Host { f, plans: &plans, sent: vec![0; plans.len()], limits: &limits, lines };
        let shadow = board(f, &dirs);
        let mut board = WithReference::new(board(f, &dirs), shadow);
        let mut lab = Lab::new(&dirs);

        let push = |host: &mut Host, board: &mut WithReference<Native>, most: usize| {
            for (motor, plan) in plans.iter().enumerate() {
                for item in plan.iter().skip(host.sent[motor]).take(most) {
                    board.push(motor, Entry { epoch: EPOCH, item: *item }).unwrap();
                    host.sent[motor] += 1;
                }
            }
        };
        // Where a lease may end: not beyond what has been sent of any motor that goes on.
        let part = |host: &Host, now: u64, part: u64| {
            let told = host.told().unwrap_or(now + 20_000);
            if told <= now { told } else { now + (told - now) * part / 256 }
        };
        push(&mut host, &mut board, first.0);
        let until = part(&host, ZERO, first.1);
        prop_assert_eq!(board.switch(EPOCH, ZERO, Lease::Until(until), &limits), Ok(()));

        for act in acts {
            if matches!(board.lease(), LeaseState::Lapsed { .. }) {
                break;
            }
            let (now, horizon) = (board.now(), board.horizon());
            let expected = |until: u64| if until < horizon { Err(ExtendRefused::Late { horizon }) } else { Ok(()) };
            match act {
                Act::Advance { ticks } => board.advance(now + ticks, &mut lab),
                Act::Push { items } => push(&mut host, &mut board, items),
                Act::Extend { part: p } => {
                    let until = part(&host, now, p);
                    prop_assert_eq!(board.extend(Lease::Until(until), &[]), expected(until));
                }
                Act::Trim { part: p, items } => {
                    let before = host.sent.clone();
                    let items: Vec<usize> = (0..plans.len()).map(|motor| usize::from(items[motor % 4]).min(before[motor])).collect();
                    items.iter().zip(&mut host.sent).for_each(|(count, sent)| *sent -= count);
                    let until = part(&host, now, p);
                    let answer = board.trim(until, &items);
                    match answer {
                        Ok(()) => prop_assert!(until >= horizon),
                        Err(TrimRefused::Extend(refused)) => prop_assert_eq!(Err(refused), expected(until)),
                        Err(TrimRefused::Read { motor }) => prop_assert!(items[motor] > 0 && until >= horizon),
                    }
                    if answer.is_err() {
                        host.sent = before;
                    }
                }
                Act::Last if host.told().is_none() => prop_assert_eq!(board.extend(Lease::Last, &[]), Ok(())),
                Act::Last => {}
                Act::Brake => {
                    let at = board.brake().unwrap();
                    prop_assert!(at <= horizon && board.brake() == Some(at));
                }
            }
        }

        // To the end, whatever it is, in other stretches; data that come now are not kept.
        for ticks in stretches.iter().cycle() {
            let lapsed = matches!(board.lease(), LeaseState::Lapsed { .. });
            if board.is_idle() && (lapsed || board.lease() == LeaseState::Last) {
                break;
            }
            board.advance(board.now() + ticks, &mut lab);
            if lapsed {
                board.push(0, Entry { epoch: EPOCH, item: Item::Dwell { ticks: 1 } }).unwrap();
                let LeaseState::Lapsed { at, .. } = board.lease() else { panic!("{:?}", board.lease()) };
                prop_assert_eq!(board.extend(Lease::Until(board.now() + 1000), &[]), Err(ExtendRefused::Lapsed { at }));
                prop_assert_eq!(board.brake(), Some(at));
            }
        }
        let until = match board.lease() {
            LeaseState::Lapsed { at, cause, .. } => {
                prop_assert!(!cause.is_fault(), "{cause:?}");
                Some(at)
            }
            LeaseState::Last => None,
            other => panic!("{other:?}"),
        };
        let by_motor = |mut steps: Vec<ScheduledStep>| { steps.sort_by_key(|step| (step.motor, step.tick)); steps };
        let (made, replayed) = (by_motor(lab.steps), by_motor(host.replay(until).collect()));
        prop_assert_eq!(made, replayed.clone());
        let mut positions = vec![0; plans.len()];
        replayed.iter().for_each(|step| positions[step.motor] += i64::from(step.direction.sign()));
        prop_assert_eq!(board.positions(), positions);
        prop_assert_eq!(board.positions(), lab.counted);
        prop_assert!(board.record_is_complete());
        for motor in 0..plans.len() {
            prop_assert_eq!(board.faults(motor), pulsetrain_board::Faults::default());
        }
    }
}

/// The steps of one axis with any number of fraction bits, whose lease ends at `until`.
fn axis_steps<const F: u32>(items: &[Item], until: u64, limit: Limit) -> Vec<(u64, Direction)> {
    let settings = StepDirSettings {
        step_line: 0,
        dir_line: 1,
        pulse_ticks: PULSE,
        setup_ticks: SETUP,
        forward_high: true,
        shared_dir: false,
    };
    let mut axis = Axis::<F, Queue<32>>::new(Output::StepDir(StepDir::new(settings)), Queue::new());
    items.iter().for_each(|item| axis.queue_mut().push(Entry { epoch: EPOCH, item: *item }).unwrap());
    let lease = pulsetrain_core::Lease::Until(Tick32::of(until));
    axis.channel_mut().schedule_switch(EPOCH, Tick32::of(ZERO), lease, Some(limit)).unwrap();
    let mut steps = Vec::new();
    let mut now = Tick32(0);
    while axis.channel().lapse().is_none() || !axis.is_idle() {
        now = now.after(5000);
        let mut position = axis.channel().position();
        while let Some(edge) = axis.next(now) {
            let moved = axis.channel().position() - position;
            if moved != 0 {
                steps.push((u64::from(edge.tick.0), if moved > 0 { Forward } else { Backward }));
            }
            position += moved;
        }
        axis.pass(now);
    }
    steps
}

proptest! {
    #[test]
    fn with_any_number_of_fraction_bits_the_stop_is_as_it_is_replayed(
        f in 0usize..7, pieces in prop::collection::vec(piece(), 1..12), (m, e, l) in (128..=255u8, 6..13u8, 0..4u8), part in 0u64..=256,
    ) {
        let bits = [8, 11, 12, 16, 20, 27, 32];
        let limit = Limit::new(m, e + bits[f] as u8, l).unwrap();
        let items = items(bits[f], &pieces, 500, true);
        let start = Start::at(ZERO, bits[f]);
        let sent = Sent { start, items: &items, limit, gap_ticks: u64::from(PULSE) + 1, line: None };
        let replay = |until| Replay::new([sent.clone()], &[], bits[f], until);
        let last = replay(None).map(|step| step.tick).max().unwrap_or(ZERO);
        let until = ZERO + (last + 1000 - ZERO) * part / 256;
        let made = match f {
            0 => axis_steps::<8>(&items, until, limit),
            1 => axis_steps::<11>(&items, until, limit),
            2 => axis_steps::<12>(&items, until, limit),
            3 => axis_steps::<16>(&items, until, limit),
            4 => axis_steps::<20>(&items, until, limit),
            5 => axis_steps::<27>(&items, until, limit),
            _ => axis_steps::<32>(&items, until, limit),
        };
        prop_assert_eq!(made, replay(Some(until)).map(|step| (step.tick, step.direction)).collect::<Vec<_>>());
    }
}

/// What a careless host does.
#[derive(Clone, Copy, Debug)]
enum Careless {
    Advance {
        ticks: u64,
    },
    /// Of one motor alone.
    Push {
        motor: usize,
        items: usize,
    },
    /// Whatever has been sent.
    Extend {
        ahead: u64,
    },
    Brake,
}

fn careless() -> impl Strategy<Value = Careless> {
    prop_oneof![
        6 => (1u64..3000).prop_map(|ticks| Careless::Advance { ticks }),
        8 => (0usize..8, 1usize..4).prop_map(|(motor, items)| Careless::Push { motor, items }),
        4 => (0u64..20_000).prop_map(|ahead| Careless::Extend { ahead }),
        1 => Just(Careless::Brake),
    ]
}

proptest! {
    /// Data that come late or not at all, leases beyond what was sent: no step is lost on the way to the driver, none is
    /// made that is not counted, and the stop only ever gets slower.
    #[test]
    fn a_careless_host_loses_no_step(
        f in prop_oneof![Just(16u32), Just(24), Just(32)],
        (dirs, motors) in prop_oneof![1 => apart(), 2 => sharing()],
        limits in limits(),
        acts in prop::collection::vec(careless(), 1..60),
        length in 0u64..10_000,
    ) {
        let plans: Vec<Vec<Item>> =
            motors.iter().map(|(pieces, delay, forward)| items(f, pieces, *delay, *forward)).collect();
        let limits: Vec<Limit> = limits.iter().map(|&(m, e, l)| Limit::new(m, e + f as u8, l).unwrap()).collect();
        let mut board = board(f, &dirs);
        let mut lab = Lab::new(&dirs);
        let mut left: Vec<_> = plans.iter().map(|plan| plan.iter()).collect();
        for (motor, items) in left.iter_mut().enumerate() {
            items.by_ref().take(2).for_each(|item| board.push(motor, Entry { epoch: EPOCH, item: *item }).unwrap());
        }
        prop_assert_eq!(board.switch(EPOCH, ZERO, Lease::Until(ZERO + length), &limits[..plans.len()]), Ok(()));
        for act in acts {
            match act {
                Careless::Advance { ticks } => board.advance(board.now() + ticks, &mut lab),
                Careless::Push { motor, items } => {
                    let motor = motor % plans.len();
                    left[motor].by_ref().take(items)
                        .for_each(|item| board.push(motor, Entry { epoch: EPOCH, item: *item }).unwrap());
                }
                Careless::Extend { ahead } => drop(board.extend(Lease::Until(board.now() + ahead), &[])),
                Careless::Brake => assert!(board.brake().is_some()),
            }
            prop_assert_eq!(&board.positions(), &lab.counted);
        }
        for _ in 0..1000 {
            if board.is_idle() && matches!(board.lease(), LeaseState::Lapsed { .. }) {
                break;
            }
            board.advance(board.now() + 50_000, &mut lab);
        }
        let LeaseState::Lapsed { at, .. } = board.lease() else { panic!("{:?}", board.lease()) };
        prop_assert!(board.is_idle());
        prop_assert_eq!(&board.positions(), &lab.counted);
        // A step that a line puts off comes nearer to the next one.
        for motor in (0..plans.len()).filter(|motor| dirs.iter().filter(|dir| **dir == dirs[*motor]).count() == 1) {
            let stop: Vec<_> = lab.steps.iter().filter(|step| step.motor == motor && step.tick >= at).collect();
            let intervals: Vec<u64> = stop.windows(2).map(|pair| pair[1].tick - pair[0].tick).collect();
            prop_assert!(intervals.windows(2).all(|pair| pair[0] <= pair[1] + 1), "motor {motor} from {at}: {intervals:?}");
            prop_assert!(stop.windows(2).all(|pair| pair[0].direction == pair[1].direction));
        }
    }
}

const F: u32 = 16;

fn run(count: u32, ticks: i64, direction: Direction) -> Item {
    Item::Run { segment: Segment { count, interval: ticks << F, add: 0, add2: 0 }, direction }
}

/// Two motors that go at 200 ticks a step, from tick 1000 on, with `more` after 50 steps of the first; until when their lease is.
fn two(more: &[Item], lease: Lease) -> (Native, Lab, [Vec<Item>; 2]) {
    let dirs = [0, 1];
    let (mut board, lab) = (board(F, &dirs), Lab::new(&dirs));
    let anchor = Item::Anchor { tick: Tick32::of(ZERO) };
    let items = [[&[anchor, run(50, 200, Forward)], more].concat(), vec![anchor, run(200, 200, Backward)]];
    for (motor, items) in items.iter().enumerate() {
        items.iter().for_each(|item| board.push(motor, Entry { epoch: EPOCH, item: *item }).unwrap());
    }
    // 600 ticks to rest: (600 / 200)² = 9 steps for an ideal stop.
    let limit = Limit::new(150, 9 + F as u8, 0).unwrap();
    board.switch(EPOCH, ZERO, lease, &[limit; 2]).unwrap();
    (board, lab, items)
}

/// The ticks of a motor's steps if its lease ends at `until`.
fn replayed(items: &[Item], until: u64) -> Vec<u64> {
    let limit = Limit::new(150, 9 + F as u8, 0).unwrap();
    let sent = Sent { start: Start::at(ZERO, F), items, limit, gap_ticks: u64::from(PULSE) + 1, line: None };
    Replay::new([sent], &[], F, Some(until)).map(|step| step.tick).collect()
}

fn ticks(lab: &Lab, motor: usize) -> Vec<u64> {
    lab.steps.iter().filter(|step| step.motor == motor).map(|step| step.tick).collect()
}

/// The step after the 50th would come at tick 11 200.
#[test]
fn whatever_is_wrong_with_one_motor_all_brake() {
    let check = |more: &[Item], cause: LapseCause, good: usize| {
        let (mut board, mut lab, items) = two(more, Lease::Until(30_000));
        board.advance(60_000, &mut lab);
        let LeaseState::Lapsed { at, cause: why, in_motion: true } = board.lease() else {
            panic!("{:?}", board.lease())
        };
        assert_eq!(why, cause, "{more:?}");
        assert!((11_000..=11_250).contains(&at), "{more:?}: {at}");
        let told: Vec<_> = board.events().iter().map(|event| (event.cause, event.tick)).collect();
        assert_eq!(told.first(), Some(&(Cause::from(cause), at)), "{more:?}: {told:?}");
        assert!(matches!(told[1..], [(Cause::Finished, _)]), "{told:?}");
        // The one at fault goes on as it went, and slows down from there.
        assert_eq!(ticks(&lab, 0), replayed(&items[0][..good], 11_200), "{more:?}");
        assert_eq!(ticks(&lab, 1), replayed(&items[1], at), "{more:?}");
        assert!(lab.counted[0] > 58 && lab.counted[1] < -58);
        assert_eq!(board.positions(), lab.counted);
        assert!(board.is_idle());
        // What is sent now is not kept; a switch begins anew.
        let room = board.room(0);
        board.push(0, Entry { epoch: EPOCH, item: run(5, 200, Forward) }).unwrap();
        assert_eq!(board.room(0), room);
        let counted = lab.counted[0];
        for item in [Item::Anchor { tick: Tick32(70_000) }, run(5, 200, Backward), Item::Dwell { ticks: 0 }] {
            board.push(0, Entry { epoch: Epoch(2), item }).unwrap();
        }
        assert_eq!(board.extend(Lease::Last, &[]), Err(ExtendRefused::Lapsed { at }));
        assert_eq!(board.switch(Epoch(2), 70_000, Lease::Last, &[]), Ok(()));
        board.advance(80_000, &mut lab);
        assert_eq!((lab.counted[0], board.lease()), (counted - 5, LeaseState::Last));
    };
    check(&[], LapseCause::Underrun, 2);
    check(&[run(5, i64::from(PULSE), Forward)], LapseCause::StepMissed, 2);
}

#[test]
fn who_has_ended_with_a_wait_has_not_run_dry() {
    let (mut board, mut lab, items) = two(&[Item::Dwell { ticks: 0 }], Lease::Until(30_000));
    board.advance(60_000, &mut lab);
    assert_eq!(board.lease(), LeaseState::Lapsed { at: 30_000, cause: LapseCause::NotExtended, in_motion: true });
    assert_eq!(lab.counted[0], 50);
    assert_eq!(ticks(&lab, 1), replayed(&items[1], 30_000));
    // The lapse is reported once, with its tick, and then the rest after the stop.
    let told: Vec<_> = board.events().iter().map(|event| (event.cause, event.motor, event.tick)).collect();
    let [lapsed, (Cause::Finished, ALL_MOTORS, _)] = told[..] else { panic!("{told:?}") };
    assert_eq!(lapsed, (Cause::Lapsed, ALL_MOTORS, 30_000));
    board.advance(90_000, &mut lab);
    assert_eq!(board.events(), []);
}

#[test]
fn a_lease_that_ends_when_nothing_moves_is_no_stop() {
    let (mut board, mut lab, _) = two(&[Item::Dwell { ticks: 0 }], Lease::Until(60_000));
    board.push(1, Entry { epoch: EPOCH, item: Item::Dwell { ticks: 0 } }).unwrap();
    board.advance(60_000, &mut lab);
    assert_eq!(board.lease(), LeaseState::Lapsed { at: 60_000, cause: LapseCause::NotExtended, in_motion: false });
    assert_eq!(lab.counted, [50, -200]);
    let told: Vec<_> = board.events().iter().map(|event| event.cause).collect();
    assert_eq!(told, [Cause::Finished]);
}

#[test]
fn a_plan_that_is_told_to_its_end_needs_no_wait_there() {
    let (mut board, mut lab, _) = two(&[], Lease::Last);
    board.advance(60_000, &mut lab);
    assert_eq!((board.lease(), lab.counted, board.is_idle()), (LeaseState::Last, vec![50, -200], true));
}

#[test]
fn a_switch_behind_the_end_of_the_lease_is_not_made() {
    let (mut board, mut lab, items) = two(&[Item::Dwell { ticks: 0 }], Lease::Until(9000));
    // The first switch has been made: one may wait.
    board.advance(ZERO, &mut lab);
    for motor in 0..2 {
        board.push(motor, Entry { epoch: Epoch(2), item: Item::Anchor { tick: Tick32(9000) } }).unwrap();
        board.push(motor, Entry { epoch: Epoch(2), item: run(9, 500, Forward) }).unwrap();
    }
    let room = board.room(0);
    assert_eq!(board.switch(Epoch(2), 9500, Lease::Until(20_000), &[]), Ok(()));
    board.advance(60_000, &mut lab);
    assert_eq!(board.lease(), LeaseState::Lapsed { at: 9000, cause: LapseCause::NotExtended, in_motion: true });
    assert_eq!([ticks(&lab, 0), ticks(&lab, 1)], [replayed(&items[0], 9000), replayed(&items[1], 9000)]);
    assert!(board.is_idle() && board.room(0) > room);
    // Nor are those that come now, of that epoch.
    let room = board.room(0);
    board.push(0, Entry { epoch: Epoch(2), item: run(9, 500, Forward) }).unwrap();
    assert_eq!((board.room(0), Board::epoch(&board)), (room, Epoch(2)));
}

#[test]
fn an_extension_reaches_the_lease_that_a_switch_will_begin() {
    let (mut board, mut lab, _) = two(&[Item::Dwell { ticks: 0 }], Lease::Until(9000));
    // The first switch has been made: one may wait.
    board.advance(ZERO, &mut lab);
    for motor in 0..2 {
        let items = [Item::Anchor { tick: Tick32(8500) }, run(20, 500, Forward), Item::Dwell { ticks: 0 }];
        items.iter().for_each(|item| board.push(motor, Entry { epoch: Epoch(2), item: *item }).unwrap());
    }
    assert_eq!(board.switch(Epoch(2), 8500, Lease::Until(8600), &[]), Ok(()));
    assert_eq!(board.extend(Lease::Until(14_100), &[]), Ok(()));
    assert_eq!(board.extend(Lease::Until(12_100), &[]), Ok(()));
    board.advance(60_000, &mut lab);
    assert_eq!(board.lease(), LeaseState::Lapsed { at: 12_100, cause: LapseCause::NotExtended, in_motion: true });
    let after = ticks(&lab, 0).into_iter().filter(|tick| (8500..12_100).contains(tick)).count();
    assert_eq!(after, 7);
}

#[test]
fn a_brake_keeps_a_switch_that_waits_from_being_made() {
    let (mut board, mut lab, _) = two(&[], Lease::Until(9000));
    assert_eq!(board.brake(), Some(board.horizon()));
    board.advance(60_000, &mut lab);
    assert_eq!((lab.counted, board.is_idle()), (vec![0, 0], true));
    // And one that comes after a lapse.
    let (mut board, mut lab, _) = two(&[], Lease::Until(9000));
    board.advance(30_000, &mut lab);
    let counted = lab.counted.clone();
    board.push(0, Entry { epoch: Epoch(2), item: Item::Anchor { tick: Tick32(40_000) } }).unwrap();
    board.push(0, Entry { epoch: Epoch(2), item: run(9, 500, Forward) }).unwrap();
    assert_eq!(board.switch(Epoch(2), 40_000, Lease::Last, &[]), Ok(()));
    assert_eq!(board.brake(), Some(9000));
    board.advance(60_000, &mut lab);
    assert_eq!((lab.counted, board.is_idle()), (counted, true));
}

#[test]
fn what_cannot_be_is_refused() {
    let mut off = board(F, &[0]);
    assert_eq!(off.lease(), LeaseState::Off);
    assert_eq!(off.extend(Lease::Until(100), &[]), Err(ExtendRefused::Off));
    assert_eq!(off.trim(100, &[0]), Err(TrimRefused::Extend(ExtendRefused::Off)));
    assert_eq!(off.brake(), None);
    let (mut board, mut lab, _) = two(&[], Lease::Until(9000));
    board.advance(5000, &mut lab);
    let horizon = board.horizon();
    assert_eq!(board.lease(), LeaseState::Until(9000));
    assert_eq!(board.extend(Lease::Until(horizon - 1), &[]), Err(ExtendRefused::Late { horizon }));
    let limit = board.now() + (1 << 30);
    assert_eq!(board.extend(Lease::Until(limit), &[]), Err(ExtendRefused::Early { limit }));
    assert_eq!(board.trim(8000, &[0, 1]), Err(TrimRefused::Read { motor: 1 }));
    assert_eq!(board.lease(), LeaseState::Until(9000));
    assert_eq!(board.trim(8000, &[]), Ok(()));
    assert_eq!(board.lease(), LeaseState::Until(8000));
}

/// A tick of 32 bits comes back; a lease that is over does not.
#[test]
fn a_lease_stays_over_after_ticks_have_wrapped() {
    let (mut board, mut lab, _) = two(&[], Lease::Until(9000));
    board.advance(3 << 31, &mut lab);
    let counted = lab.counted.clone();
    assert_eq!(board.lease(), LeaseState::Lapsed { at: 9000, cause: LapseCause::NotExtended, in_motion: true });
    assert_eq!(board.extend(Lease::Until((3 << 31) + 1000), &[]), Err(ExtendRefused::Lapsed { at: 9000 }));
    board.advance(4 << 31, &mut lab);
    assert_eq!(lab.counted, counted);
}
