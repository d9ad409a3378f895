//! Leases on the virtual Uno: when the host is lost, is late, takes items back or orders it, all motors brake, and every edge of the pins is what the host replays.
//!
//! `PULSETRAIN_SEED` says other random plans, `PULSETRAIN_ROUNDS` how many times as many.

use pulsetrain_board::lease::{Lease, LeaseState, Leased};
use pulsetrain_board::replay::{Replay, Sent, Start};
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Faults, Remote, ScheduledStep, Setup};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::lab::{EXACT, Lab, SOFTWARE, Timing};
use pulsetrain_testkit::seed::seeds;
use pulsetrain_testkit::{Random, TICK_HZ, uno_setup};

/// Pins of motors (STEP, DIR), and what the edges' ticks are compared by.
struct Pins {
    name: &'static str,
    pins: &'static [(u8, u8)],
    timing: Timing,
}

const ALL: [Pins; 6] = [
    Pins { name: "one motor", pins: &[(8, 9)], timing: SOFTWARE },
    Pins { name: "pins 9 and 10 by hardware", pins: &[(9, 8), (10, 13)], timing: EXACT },
    Pins { name: "two on port D", pins: &[(2, 5), (3, 6)], timing: SOFTWARE },
    Pins { name: "three on port D", pins: &[(2, 5), (3, 6), (4, 7)], timing: SOFTWARE },
    Pins { name: "three on port B", pins: &[(8, 11), (9, 12), (10, 13)], timing: SOFTWARE },
    Pins { name: "the CNC shield", pins: &[(2, 5), (3, 6), (4, 7), (12, 13)], timing: SOFTWARE },
];

const EPOCH: Epoch = Epoch(1);

/// A limit of so many steps/s².
fn limit(acceleration: f64, rest_level: u8) -> Limit {
    let rest = TICK_HZ as f64 * 65_536.0 / (2.0 * acceleration).sqrt();
    let mut exponent = rest.log2().floor() as i32;
    let mut mantissa = (rest / 2f64.powi(exponent - 7)).ceil() as u32;
    if mantissa == 256 {
        (mantissa, exponent) = (128, exponent + 1);
    }
    Limit::new(mantissa as u8, exponent as u8, rest_level).expect("it is one")
}

/// Items of a plan from tick `from` on: runs that speed up and slow down, waits, turns, anchors; a wait of nothing at the end.
fn items(random: &mut Random, motors: usize, room: u64, from: u64) -> Vec<Item> {
    let fastest = [600, 900, 1400, 2200][motors - 1];
    let mut tick = from + room + random.below(20_000);
    let mut items = vec![Item::Anchor { tick: Tick32::of(tick) }];
    let mut accumulator = ((tick as i128) << 16) + (1 << 15);
    let mut direction = Direction::Forward;
    let interval = |random: &mut Random| (fastest as f64 * 12f64.powf(random.fraction().powi(2))) as i64;
    let mut now = interval(random);
    let mut goes_on = false;
    for _ in 0..random.between(2, 30) {
        if !goes_on || random.one_in(5) {
            let ticks = room + random.below(30_000);
            if random.one_in(3) {
                direction = direction.reversed();
            }
            if goes_on && random.one_in(3) {
                tick = (accumulator >> 16) as u64 + ticks;
                accumulator = ((tick as i128) << 16) + (1 << 15);
                items.push(Item::Anchor { tick: Tick32::of(tick) });
            } else {
                accumulator += (ticks as i128) << 16;
                items.push(Item::Dwell { ticks: ticks as u32 });
            }
            now = interval(random);
        }
        let next = interval(random);
        let least = 16_000 * motors as u64 / now.min(next) as u64 + 1;
        let count = (least + random.below(300)) as u32;
        let add = ((next - now) << 16) / i64::from(count);
        let segment = Segment { count, interval: now << 16 | random.below(1 << 16) as i64, add, add2: 0 };
        now += (add * i64::from(count)) >> 16;
        accumulator += segment.span(count);
        items.push(Item::Run { segment, direction });
        goes_on = true;
    }
    items.push(Item::Dwell { ticks: 0 });
    items
}

/// What the host has, and what it has sent.
struct Host {
    plans: Vec<Vec<Item>>,
    sent: Vec<usize>,
    limits: Vec<Limit>,
    from: u64,
}

impl Host {
    fn replay(&self, until: Option<u64>) -> Replay<'_> {
        let motors = self.plans.iter().zip(&self.sent).zip(&self.limits);
        let motors = motors.map(|((plan, sent), limit)| Sent {
            start: Start::at(self.from, 16),
            items: &plan[..*sent],
            limit: *limit,
            gap_ticks: 18,
            line: None,
        });
        Replay::new(motors, &[], 16, until)
    }

    /// The tick of the last step that was sent, of the motor that goes on and has least; `None` if none goes on.
    fn told(&self) -> Option<u64> {
        let mut last = vec![self.from; self.plans.len()];
        self.replay(None).for_each(|step| last[step.motor] = last[step.motor].max(step.tick));
        let goes_on = |motor: &usize| self.sent[*motor] < self.plans[*motor].len();
        (0..last.len()).filter(goes_on).map(|motor| last[motor]).min()
    }

    fn push(&mut self, board: &mut Remote<VirtualUno>, most: usize) {
        for (motor, plan) in self.plans.iter().enumerate() {
            for item in plan.iter().skip(self.sent[motor]).take(most) {
                if board.room(motor) < 30 || board.push(motor, Entry { epoch: EPOCH, item: *item }).is_err() {
                    break;
                }
                self.sent[motor] += 1;
            }
        }
    }
}

/// How runs ended.
#[derive(Debug, Default)]
struct Ends {
    runs: u32,
    last: u32,
    ordered: u32,
    in_motion: u32,
    trims: u32,
    late: u32,
    steps: usize,
}

fn run(pins: &Pins, seed: u64, ends: &mut Ends) {
    let random = &mut Random::new(seed);
    let setup: Setup = uno_setup(pins.pins, 16);
    let mut board = Remote::open(VirtualUno::new(), 7).expect("it answers");
    assert_eq!(board.set_baud(Baud::B1M), Ok(Baud::B1M));
    board.configure(&setup).expect("it takes the configuration");
    board.arm().expect("it can be armed");
    let room = u64::from(setup.pulse_ticks + setup.hold_ticks + setup.setup_ticks) + 400;
    let from = board.now() + board.round_trip() + TICK_HZ / 100;
    let motors = pins.pins.len();
    let limits =
        (0..motors).map(|_| limit(3000.0 * 30f64.powf(random.fraction()), random.below(5) as u8)).collect::<Vec<_>>();
    let plans = (0..motors).map(|_| items(random, motors, room, from)).collect::<Vec<_>>();
    let mut host = Host { plans, sent: vec![0; motors], limits: limits.clone(), from };
    host.push(&mut board, 100);
    let until = host.told().unwrap_or(from + 1000).max(from);
    assert_eq!(board.switch(EPOCH, from, Lease::Until(until), &limits), Ok(()));
    let mut lab = Lab::default();
    // The host is lost after so many rounds.
    let acts = random.below(60);
    let (mut orders, mut ordered) = (random.one_in(5), false);
    let mut number = 0;
    loop {
        let stretch = if random.one_in(20) { TICK_HZ / 50 } else { TICK_HZ / 500 };
        let until = board.now() + random.below(stretch);
        board.advance(until, &mut lab);
        assert_eq!(board.error(), None);
        if matches!(board.lease(), LeaseState::Lapsed { .. }) {
            break;
        }
        if board.unconfirmed().is_some() {
            continue;
        }
        number += 1;
        if number > acts {
            if orders {
                orders = false;
                ordered = board.brake().is_some();
            }
            if board.lease() == LeaseState::Last && board.is_idle() {
                break;
            }
            continue;
        }
        host.push(&mut board, random.between(1, 4) as usize);
        if random.one_in(10) {
            let before = host.sent.clone();
            let items: Vec<usize> = (0..motors).map(|motor| (random.below(3) as usize).min(before[motor])).collect();
            items.iter().zip(&mut host.sent).for_each(|(count, sent)| *sent -= count);
            let told = host.told().unwrap_or(board.now() + 100_000);
            match board.trim(told, &items) {
                Ok(()) => ends.trims += 1,
                Err(_) => {
                    host.sent = before;
                    ends.late += 1;
                }
            }
            continue;
        }
        let lease = match host.told() {
            None if random.one_in(2) => Lease::Last,
            None => continue,
            Some(told) => {
                let now = board.now();
                Lease::Until(if told < now || random.one_in(2) { told } else { now + random.below(told - now + 1) })
            }
        };
        if board.extend(lease, &[]).is_err() {
            ends.late += 1;
        }
    }
    let patience = board.now() + 40 * TICK_HZ;
    while !board.is_idle() {
        assert!(board.now() < patience, "it does not come to rest");
        let until = board.now() + TICK_HZ / 50;
        board.advance(until, &mut lab);
    }
    let until = board.now() + TICK_HZ / 100;
    board.advance(until, &mut lab);
    assert_eq!(board.error(), None);
    let lease = board.lease();
    let (until, in_motion) = match lease {
        LeaseState::Lapsed { at, cause, in_motion } => {
            assert!(matches!(cause, LapseCause::NotExtended | LapseCause::Ordered), "{lease:?}");
            // It may have been over before the order came.
            ordered &= cause == LapseCause::Ordered;
            (Some(at), in_motion)
        }
        LeaseState::Last => (None, false),
        other => panic!("{other:?}"),
    };
    let told: Vec<_> = board.events().into_iter().filter(|event| event.cause != Cause::Finished).collect();
    println!("{lease:?} {told:?}");
    let mut steps: Vec<ScheduledStep> = host.replay(until).collect();
    steps.sort_by_key(|step| (step.motor, step.tick));
    lab.steps = steps;
    lab.check(&setup, pins.timing, None);
    let status = board.status().expect("it answers");
    let positions = status.motors.as_slice().iter().map(|motor| i64::from(motor.position));
    assert_eq!(positions.collect::<Vec<_>>(), lab.counts(&setup), "what it counted, and the pins");
    for motor in 0..motors {
        assert_eq!(board.faults(motor), Faults::default());
    }
    ends.runs += 1;
    ends.last += u32::from(until.is_none());
    ends.ordered += u32::from(ordered);
    ends.in_motion += u32::from(in_motion);
    ends.steps += lab.steps.len();
}

#[test]
fn the_stop_is_as_it_is_replayed() {
    let mut ends = Ends::default();
    let mut failed = Vec::new();
    for pins in &ALL {
        for seed in seeds(1, 16) {
            println!("{}, seed {seed}", pins.name);
            if std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| run(pins, seed, &mut ends))).is_err() {
                failed.push((pins.name, seed));
            }
        }
    }
    println!("{ends:?}");
    assert!(failed.is_empty(), "{} of {}: {failed:?}", failed.len(), ends.runs);
    assert!(ends.last > 1 && ends.ordered > 1 && ends.in_motion > 6 && ends.trims > 3 && ends.late > 1, "{ends:?}");
}
