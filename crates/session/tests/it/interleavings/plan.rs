//! What the motors are to do: a few steps up to a speed at which no motor may stop at once, and down again.

use pulsetrain_board::Setup;
use pulsetrain_board::lease::Lease;
use pulsetrain_board::replay::{Replay, Sent, Start};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::packing::{Packing, State};
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Epoch, Item, Segment, Tick32};

/// F of the board.
const FRACTION_BITS: u32 = 16;

/// The plan's epoch, and the tick at which it begins.
pub(crate) const EPOCH: Epoch = Epoch(1);
pub(crate) const ZERO: u64 = 100;

/// The shortest interval that a motor can start and stop at, ticks. From there on the rule makes one step more: R of its limit.
pub(crate) const PULL_IN_TICKS: u64 = 70;

/// Pulse and DIR setup, ticks.
const PULSE_TICKS: u16 = 5;
const SETUP_TICKS: u16 = 5;

/// Ticks at which a motor steps, and which way.
pub(crate) type Steps = Vec<(u64, i64)>;

/// How much of its plan a motor was told: portions of the plan, and then of what comes instead of the rest after a trim.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Told {
    pub(crate) main: usize,
    pub(crate) instead: usize,
    /// The plan was trimmed: what comes next is the other one.
    pub(crate) is_cut: bool,
}

/// One motor's plan, in portions of items that travel together.
#[derive(Clone, Debug)]
struct Motor {
    main: Vec<Vec<Item>>,
    instead: Vec<Vec<Item>>,
}

/// The plan of all motors.
#[derive(Clone, Debug)]
pub(crate) struct Plan {
    motors: Vec<Motor>,
}

const fn run(direction: Direction, count: u32, interval: i64, add: i64) -> Item {
    let segment = Segment { count, interval: interval << FRACTION_BITS, add: add << FRACTION_BITS, add2: 0 };
    Item::Run { segment, direction }
}

impl Plan {
    /// So many motors, the first of which goes through so many portions at its top speed. The second one is slower and goes the other way.
    pub(crate) fn new(motors: usize, at_top: usize) -> Plan {
        use Direction::{Backward, Forward};
        let anchor = Item::Anchor { tick: Tick32::of(ZERO) };
        // Less than 1.5 times slower from one step to the next.
        let down = |direction| vec![run(direction, 3, 56, 20), Item::Dwell { ticks: 0 }];
        let mut main = vec![vec![anchor, run(Forward, 3, 100, -20)]];
        main.extend((0..at_top).map(|_| vec![run(Forward, 4, 40, 0)]));
        main.push(down(Forward));
        let first = Motor { main, instead: vec![down(Forward)] };
        let slow = |count| vec![run(Backward, count, 90, 0)];
        let mut main = vec![vec![anchor, run(Backward, 3, 90, 0)]];
        main.extend((0..at_top).map(|_| slow(2)));
        main.push(vec![run(Backward, 1, 90, 0), Item::Dwell { ticks: 0 }]);
        let second = Motor { main, instead: vec![vec![run(Backward, 2, 90, 0), Item::Dwell { ticks: 0 }]] };
        Plan { motors: [first, second].into_iter().take(motors).collect() }
    }

    pub(crate) fn motors(&self) -> usize {
        self.motors.len()
    }

    /// What a board is configured for.
    pub(crate) fn setup(&self) -> Setup {
        let motor = |index| MotorSetup {
            step_pin: index,
            dir_pin: 16 + index,
            forward_high: true,
            pull_in_ticks: 70,
            ..MotorSetup::default()
        };
        let motors = (0..).take(self.motors()).map(motor).collect();
        Setup { pulse_ticks: PULSE_TICKS, setup_ticks: SETUP_TICKS, motors, ..Setup::default() }
    }

    /// How hard each motor brakes: from R ticks on it may rest within one step.
    pub(crate) fn limits(&self) -> Vec<Limit> {
        // 2^6 ≤ 70 < 2^7.
        let limit = Limit::new(140, 6 + FRACTION_BITS as u8, 0).expect("within the limits of a limit");
        vec![limit; self.motors()]
    }

    fn portions(&self, motor: usize, told: Told) -> impl Iterator<Item = &Vec<Item>> {
        let Motor { main, instead } = &self.motors[motor];
        main[..told.main].iter().chain(&instead[..told.instead])
    }

    pub(crate) fn items(&self, motor: usize, told: Told) -> Vec<Item> {
        self.portions(motor, told).flatten().copied().collect()
    }

    /// Whether a motor was told all.
    pub(crate) fn is_told(&self, motor: usize, told: Told) -> bool {
        let Motor { main, instead } = &self.motors[motor];
        if told.is_cut { told.instead == instead.len() } else { told.main == main.len() }
    }

    /// The same with one portion more; `None` if that is all.
    pub(crate) fn next(&self, motor: usize, told: Told) -> Option<Told> {
        let more = |told: Told| {
            if told.is_cut { Told { instead: told.instead + 1, ..told } } else { Told { main: told.main + 1, ..told } }
        };
        (!self.is_told(motor, told)).then(|| more(told))
    }

    /// The last portion that was told, packed.
    pub(crate) fn last_packed(&self, motor: usize, told: Told) -> Vec<u8> {
        let packing = Packing { fraction_bits: FRACTION_BITS, gain: 0 };
        let mut state = State::default();
        let mut last = Vec::new();
        for portion in self.portions(motor, told) {
            last.clear();
            for item in portion {
                let mut bytes = [0; 64];
                let len = packing.pack(&mut state, item, &mut bytes).expect("items have steps");
                last.extend_from_slice(&bytes[..len]);
            }
        }
        last
    }

    /// The steps of what a motor was told, one after the other.
    pub(crate) fn steps(&self, motor: usize, told: Told) -> Steps {
        let mut steps = Vec::new();
        let mut place = 0;
        for item in self.items(motor, told) {
            match item {
                Item::Anchor { tick } => place = (i64::from(tick.0) << FRACTION_BITS) + (1 << (FRACTION_BITS - 1)),
                Item::Dwell { ticks } => place += i64::from(ticks) << FRACTION_BITS,
                Item::Run { segment, direction } => {
                    let mut interval = segment.interval;
                    for _ in 0..segment.count {
                        place += interval;
                        interval += segment.add;
                        steps.push(((place >> FRACTION_BITS).cast_unsigned(), i64::from(direction.sign())));
                    }
                }
            }
        }
        steps
    }

    /// The longest lease for what the motors were told: up to the last step of the one that was told least far, of those that go on.
    pub(crate) fn longest_lease(&self, told: &[Told]) -> Lease {
        let going = (0..self.motors()).filter(|motor| !self.is_told(*motor, told[*motor]));
        let last = |motor| self.steps(motor, told[motor]).last().map_or(ZERO, |(tick, _)| *tick);
        going.map(last).min().map_or(Lease::Last, Lease::Until)
    }

    /// What each motor does, as a host replays it, if its lease ends so.
    pub(crate) fn replay(&self, told: &[Told], lease: Lease) -> Vec<Steps> {
        let items: Vec<_> = told.iter().enumerate().map(|(motor, told)| self.items(motor, *told)).collect();
        let sent = items.iter().zip(self.limits()).map(|(items, limit)| Sent {
            start: Start::at(ZERO, FRACTION_BITS),
            items,
            limit,
            gap_ticks: u64::from(PULSE_TICKS) + 1,
            line: None,
        });
        let until = match lease {
            Lease::Until(until) => Some(until),
            Lease::Last => None,
        };
        let mut all = vec![Steps::new(); self.motors()];
        for step in Replay::new(sent, &[], FRACTION_BITS, until) {
            all[step.motor].push((step.tick, step.direction.sign().into()));
        }
        all
    }

    /// What each motor will have counted.
    pub(crate) fn counts(&self, told: &[Told], lease: Lease) -> Vec<i64> {
        self.replay(told, lease).iter().map(|steps| steps.iter().map(|(_, sign)| sign).sum()).collect()
    }
}
