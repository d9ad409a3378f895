//! Verbs on an 8-bit chip make the same steps as `pulsetrain_core::verbs`, tick for tick, with random orders.

use proptest::prelude::*;
use pulsetrain_core::avr::verbs as avr;
use pulsetrain_core::verbs::{Heading, MotorTiming, Verb, Verbs};
use pulsetrain_core::wire::orders::{Orders, order};
use pulsetrain_core::{Direction, Item, Tick32};

const LIMITS: MotorTiming = MotorTiming { shortest: 300, turn: 900, period: 16_000 };
const MOTORS: u8 = 3;

/// Ticks and directions of a motor's steps, from items.
#[derive(Default)]
struct Axis {
    tick: u64,
    steps: Vec<(u32, Direction)>,
}

impl Axis {
    fn take(&mut self, item: Item) {
        match item {
            Item::Anchor { tick } => self.tick = u64::from(tick.0),
            Item::Dwell { ticks } => self.tick += u64::from(ticks),
            Item::Run { segment, direction } => {
                for _ in 0..segment.count {
                    self.tick += segment.interval.cast_unsigned() >> 16;
                    self.steps.push((Tick32::of(self.tick).0, direction));
                }
            }
        }
    }
}

fn a_verb() -> impl Strategy<Value = Verb> {
    prop_oneof![
        3 => prop::sample::select(vec![0, 1, 2, 8, 100, 2000, u32::MAX]).prop_map(|steps| Verb::Move { steps }),
        1 => Just(Verb::Run),
        3 => (300..20_000_u64).prop_map(|ticks| Verb::Speed { ticks }),
        1 => (20_000..u64::from(avr::LONGEST_PERIOD) + 1).prop_map(|ticks| Verb::Speed { ticks }),
        1 => prop::sample::select(vec![299, u64::from(avr::LONGEST_PERIOD) + 1]).prop_map(|ticks| Verb::Speed { ticks }),
        3 => prop::sample::select(vec![Heading::Stationary, Heading::Forward, Heading::Backward]).prop_map(Verb::Heading),
        1 => Just(Verb::Halt),
    ]
}

/// A part of a script: slices without orders, then, if all motors rest, a long wait in ticks, then orders.
type Told = ((u32, u64), Vec<(u8, Verb)>);

fn a_script() -> impl Strategy<Value = Vec<Told>> {
    let idle = (0..6_u32, prop_oneof![4 => Just(0), 1 => 1..4_u64 << 29]);
    prop::collection::vec((idle, prop::collection::vec((0..MOTORS, a_verb()), 1..6)), 1..40)
}

/// Both implementations, from the same tick on.
struct Both {
    wide: Verbs,
    avr: avr::AvrVerbs,
    known: u64,
    axes: Vec<Axis>,
    steps: Vec<Vec<(u32, Direction)>>,
}

impl Both {
    fn new(known: u64) -> Both {
        let (mut wide, mut avr) = (Verbs::new(), avr::AvrVerbs::new());
        wide.begin((0..MOTORS).map(|motor| (LIMITS, i32::from(motor))), known);
        avr.begin((0..MOTORS).map(i32::from), (300, 900, 16_000), Tick32::of(known));
        let axes = (0..MOTORS).map(|_| Axis::default()).collect();
        Both { wide, avr, known, axes, steps: vec![Vec::new(); MOTORS.into()] }
    }

    /// Moves on by a slice, and takes the steps of both in it.
    fn go_on(&mut self, ticks: u64) {
        self.known += ticks;
        let axes = &mut self.axes;
        self.wide.work_out::<16>(self.known, |motor, item| axes[usize::from(motor)].take(item));
        self.avr.foresee(Tick32::of(self.known));
        self.take();
    }

    fn take(&mut self) {
        for (motor, steps) in (0..).zip(&mut self.steps) {
            let mut has_all = false;
            while let Some(row) = self.avr.take(motor) {
                assert!(!has_all, "motor {motor}: more came behind all");
                has_all = self.avr.has_all(motor);
                let ticks = (0..u32::from(row.count)).map(|step| row.first.after(step.wrapping_mul(row.period)).0);
                steps.extend(ticks.map(|tick| (tick, row.direction)));
            }
        }
    }

    /// Takes the reports of both, so that neither refuses a move for lack of room.
    fn compare(&mut self) -> Result<(), TestCaseError> {
        for (axis, steps) in self.axes.iter().zip(&self.steps) {
            prop_assert_eq!(&axis.steps, steps);
        }
        loop {
            let wide = self.wide.take_done(self.known);
            let avr = self.avr.take_done(Tick32::of(self.known));
            prop_assert_eq!(wide.map(|(motor, tick, number)| (motor, Tick32::of(tick), number)), avr);
            if avr.is_none() {
                break;
            }
        }
        prop_assert_eq!(self.wide.rest_at(self.known), self.avr.rest_at(Tick32::of(self.known)));
        Ok(())
    }
}

proptest! {
    /// Both make the same steps, reports and answers, also after long rests, and where ticks of 32 bits wrap.
    #[test]
    fn they_do_what_the_wide_ones_do(begin in prop_oneof![Just(1000), (1_u64 << 32) - 200_000..1 << 32], script in a_script(), slice in prop_oneof![9 => 3000..40_000_u64, 1 => 40_000..400_000_u64]) {
        let mut both = Both::new(begin);
        for ((slices, mut rest), orders) in script {
            for _ in 0..slices {
                both.go_on(slice);
                both.compare()?;
            }
            while rest > 0 && both.wide.rest_at(both.known) {
                both.go_on(rest.min(1 << 29));
                rest = rest.saturating_sub(1 << 29);
            }
            let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
            let orders = Orders::decode(&bytes).unwrap();
            // The 8-bit version takes two moves of each motor at most.
            prop_assert_eq!(both.avr.busy(), None);
            let mut tried = both.wide.clone();
            let wide = orders.tell(&mut tried);
            let avr = both.avr.obey(&orders);
            let too_long = orders.iter().any(|(_, verb)| matches!(verb, Verb::Speed { ticks } if ticks > u64::from(avr::LONGEST_PERIOD)));
            prop_assert_eq!(avr.is_ok(), wide.is_ok() && !too_long);
            if let (Ok(obeyed), true) = (wide, avr.is_ok()) {
                both.wide = tried;
                let (at, motors) = both.avr.obeyed();
                prop_assert_eq!(at, Tick32::of(obeyed.tick));
                prop_assert_eq!(motors, obeyed.motors());
            }
        }
        both.go_on(slice);
        both.compare()?;
    }

    /// Steps that were worked out early because of an order are taken first, and are the same ones.
    #[test]
    fn an_order_puts_steps_by(period in 300..5000_u64, ticks in 1000..40_000_u64) {
        let mut both = Both::new(0);
        let bytes: Vec<u8> = [order(0, Verb::Speed { ticks: period }), order(0, Verb::Run)].concat();
        let orders = Orders::decode(&bytes).unwrap();
        orders.tell(&mut both.wide).unwrap();
        both.avr.obey(&orders).unwrap();
        both.known += ticks;
        let axes = &mut both.axes;
        both.wide.work_out::<16>(both.known, |motor, item| axes[usize::from(motor)].take(item));
        both.avr.foresee(Tick32::of(both.known));
        prop_assert_eq!(both.avr.busy(), None);
        let halt = order(0, Verb::Halt);
        let halt = Orders::decode(&halt).unwrap();
        both.wide.obey(&halt).unwrap();
        both.avr.obey(&halt).unwrap();
        both.take();
        both.go_on(ticks);
        both.compare()?;
    }
}

/// Which orders are dropped when the host is lost, and which moves are finished when motors are stopped.
#[test]
fn forsaken_and_stopped() {
    let told = |orders: &[(u8, Verb)]| {
        let mut both = Both::new(0);
        let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
        let orders = Orders::decode(&bytes).unwrap();
        orders.tell(&mut both.wide).unwrap();
        both.avr.obey(&orders).unwrap();
        both.go_on(100_000);
        both
    };
    let orders = [(0, Verb::Run), (1, Verb::Move { steps: 1000 }), (2, Verb::Speed { ticks: 90_000 }), (2, Verb::Run)];
    let mut both = told(&orders);
    let _ = both.wide.host_gone(false, |_| 0);
    both.avr.drop_endless();
    both.go_on(20_000_000);
    both.compare().unwrap();
    assert_eq!(both.steps[1].len(), 1000);
    let mut both =
        told(&[(0, Verb::Speed { ticks: 1000 }), (0, Verb::Move { steps: 5 }), (1, Verb::Move { steps: 6 })]);
    both.wide.stop(|_| 50_000);
    both.avr.stop(Some(Tick32(50_000)));
    assert_eq!(both.avr.take_done(Tick32(200_000)), Some((0, Tick32(5000), 1)));
    assert_eq!(both.avr.take_done(Tick32(200_000)), None, "motor 1 was stopped first");
    let mut both = told(&[(0, Verb::Move { steps: 1 })]);
    both.avr.stop(None);
    assert_eq!(both.avr.take_done(Tick32(200_000)), None);
}

/// One motor of an 8-bit board, with these verbs at tick 0.
fn avr_alone(orders: &[(u8, Verb)]) -> avr::AvrVerbs {
    let mut verbs = avr::AvrVerbs::new();
    verbs.begin([0, 0].into_iter(), (300, 900, 16_000), Tick32(0));
    let bytes: Vec<u8> = orders.iter().flat_map(|(motor, verb)| order(*motor, *verb)).collect();
    verbs.obey(&Orders::decode(&bytes).unwrap()).unwrap();
    verbs
}

/// Where one move ends and the next begins before `known`, an order waits until the first move's steps are taken.
#[test]
fn an_order_waits_between_moves() {
    let mut verbs = avr_alone(&[(1, Verb::Move { steps: 2 }), (1, Verb::Move { steps: 3 })]);
    verbs.foresee(Tick32(40_000));
    assert_eq!(verbs.busy(), Some(1));
    assert_eq!(verbs.busy(), Some(1), "nothing was taken");
    assert_eq!(verbs.take(1).map(|steps| (steps.first, steps.count)), Some((Tick32(0), 2)));
    assert_eq!(verbs.busy(), None);
    assert_eq!(verbs.take(1).map(|steps| (steps.first, steps.count)), Some((Tick32(32_000), 1)));
}

/// Steps more than 2^16 ticks apart come one by one, even if much is worked out at once.
#[test]
fn steps_far_apart_come_one_by_one() {
    let mut verbs = avr_alone(&[(0, Verb::Speed { ticks: 100_000 }), (0, Verb::Run)]);
    verbs.foresee(Tick32(250_000));
    let steps: Vec<_> = std::iter::from_fn(|| verbs.take(0)).map(|steps| (steps.first.0, steps.count)).collect();
    assert_eq!(steps, [(0, 1), (100_000, 1), (200_000, 1)]);
}

/// A motor rests through several wraps of 32-bit ticks after its move. The move is reported even then.
#[test]
fn what_is_past_stays_past() {
    for stopped in [false, true] {
        let mut verbs = avr_alone(&[(0, Verb::Move { steps: 5 }), (0, Verb::Move { steps: 0 })]);
        for tick in (0..10_u64 << 30).step_by(1 << 28).map(|tick| tick + 200_000) {
            verbs.foresee(Tick32::of(tick));
            while verbs.take(0).is_some() {}
            assert!(verbs.rest_at(Tick32::of(tick)), "tick {tick}");
            if stopped {
                verbs.stop(Some(Tick32::of(tick)));
            }
        }
        assert_eq!(verbs.take_done(Tick32(0)), Some((0, Tick32(80_000), 1)));
        assert_eq!(verbs.take_done(Tick32(0)), Some((0, Tick32(80_000), 2)));
        assert_eq!(verbs.take_done(Tick32(0)), None);
    }
    // The motor is stopped. The host asks for the move much later.
    let mut verbs = avr_alone(&[(0, Verb::Move { steps: 1 })]);
    verbs.foresee(Tick32(50_000));
    while verbs.take(0).is_some() {}
    verbs.stop(Some(Tick32(20_000)));
    assert_eq!(verbs.take_done(Tick32(3 << 30)), Some((0, Tick32(16_000), 1)));
}
