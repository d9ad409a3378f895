//! The narrow stepgen against the wide one: the same bytes, cut anywhere, give the same events.

use proptest::prelude::*;
use pulsetrain_core::channel::{Channel, Kind, SwitchRefused};
use pulsetrain_core::narrow::{BLIND_STEPS, Fault, Motor, Pool, PushRefused, Reason, SLOWEST_BLIND, Settings};
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Moment, Queue, Segment};
use std::collections::VecDeque;

const POOL: usize = 640;

/// A number of any magnitude below 2^`bits`.
fn any_size(bits: u32) -> impl Strategy<Value = u64> {
    (0..=bits, any::<u64>()).prop_map(|(bits, number)| number & ((1 << bits) - 1))
}

fn any_size_signed(bits: u32) -> impl Strategy<Value = i64> {
    (any_size(bits), any::<bool>()).prop_map(|(number, minus)| {
        let number = i64::try_from(number).unwrap();
        if minus { -number } else { number }
    })
}

/// Part of a motion, as it is packed.
#[derive(Clone, Debug)]
enum Part {
    /// So many ticks from now, with a fraction or ½; the first of an epoch.
    Anchor(i32, Option<u16>),
    Dwell(u32),
    /// In full, whatever went before.
    Run {
        segment: Segment,
        forward: bool,
    },
    /// By corrections, in units.
    Correct {
        count: u32,
        corrections: [i64; 3],
        turn: bool,
    },
    Reset,
    /// Slowing down from what is predicted.
    Slow(u32),
}

fn count() -> impl Strategy<Value = u32> {
    prop_oneof![8 => 1u32..6, 8 => 1u32..200, 1 => 60_000u32..=65_535]
}

fn part() -> impl Strategy<Value = Part> {
    prop_oneof![
        2 => any_size(26).prop_map(|ticks| Part::Dwell(u32::try_from(ticks).unwrap())),
        3 => (count(), any_size(40), any_size_signed(31), any_size_signed(31), any::<bool>()).prop_map(
            |(count, interval, add, add2, forward)| {
                let interval = i64::try_from(interval).unwrap();
                Part::Run { segment: Segment { count, interval, add, add2 }, forward }
            }
        ),
        // As a planner has them, so that most of them fit: about a millisecond, changed by little.
        12 => (count(), 8i64 << 16..2000 << 16, any_size_signed(22), any_size_signed(14), any::<bool>()).prop_map(
            |(count, interval, add, add2, forward)| {
                let (add, add2) = (add / i64::from(count), add2 / i64::from(count * count.min(1000)));
                Part::Run { segment: Segment { count, interval, add, add2 }, forward }
            }
        ),
        9 => (count(), [any_size_signed(16), any_size_signed(9), any_size_signed(6)], any::<bool>(), 0u32..20).prop_map(
            |(count, corrections, turn, often)| Part::Correct { count, corrections, turn: turn && often == 0 }
        ),
        3 => (1u32..80, [any_size_signed(33), any_size_signed(9), any_size_signed(6)]).prop_map(
            |(count, corrections)| Part::Correct { count, corrections, turn: false }
        ),
        1 => Just(Part::Reset),
        3 => (0u32..=15).prop_map(Part::Slow),
    ]
}

/// Whether each step's interval and add are in what a narrow register holds.
fn fits(segment: &Segment) -> bool {
    let Segment { count, mut interval, mut add, add2 } = *segment;
    (0..count).all(|_| {
        let fits = (0..1 << 40).contains(&interval) && i32::try_from(add).is_ok() && i32::try_from(add2).is_ok();
        interval += add;
        add += add2;
        fits
    })
}

#[derive(Clone, Debug)]
enum Action {
    /// Packs more of the epoch that is being filled.
    Fill(Vec<Part>),
    /// Sends so many bytes of what was packed.
    Send(usize),
    /// Fills the next epoch from here on.
    NextEpoch,
    /// Fills the next epoch with what begins so far from now, sends what there is room for, and switches to it.
    Plan {
        from: u16,
        parts: Vec<Part>,
        ahead: i32,
    },
    /// Takes `most` events, none later than `ahead` after `by` from now; if that was all, time goes on `by`.
    Go {
        by: u32,
        ahead: u32,
        most: usize,
    },
    /// Makes steps blindly.
    Blind {
        fastest: u16,
        ahead: u32,
    },
    /// So far after the horizon, or before it; to the epoch that is being filled or some epoch after it.
    Switch {
        after: i32,
        skip: u8,
    },
    Discard,
    Stop,
}

fn small_or_large(bits: u32) -> impl Strategy<Value = u32> {
    any_size(bits).prop_map(|ticks| u32::try_from(ticks).unwrap())
}

fn action() -> impl Strategy<Value = Action> {
    prop_oneof![
        6 => prop::collection::vec(part(), 1..8).prop_map(Action::Fill),
        8 => (1usize..60).prop_map(Action::Send),
        2 => Just(Action::NextEpoch),
        2 => (1000u16..20_000, prop::collection::vec(part(), 3..20), 0i32..2000)
            .prop_map(|(from, parts, ahead)| Action::Plan { from, parts, ahead }),
        12 => (small_or_large(17), small_or_large(17), prop_oneof![Just(100_000usize), 0usize..10])
            .prop_map(|(by, ahead, most)| Action::Go { by, ahead, most }),
        1 => (small_or_large(29), small_or_large(22)).prop_map(|(by, ahead)| Action::Go { by, ahead, most: 100_000 }),
        12 => (1u16..300, small_or_large(20)).prop_map(|(fastest, ahead)| Action::Blind { fastest, ahead }),
        2 => (-100i32..100_000, prop_oneof![4 => Just(0u8), 1 => 1u8..3])
            .prop_map(|(after, skip)| Action::Switch { after, skip }),
        1 => Just(Action::Discard),
        1 => Just(Action::Stop),
    ]
}

/// Both, and the sender.
struct Pair {
    packing: Packing,
    gap: u16,
    pool: Pool<POOL>,
    motor: Motor,
    channel: Channel<16>,
    queue: Queue<700>,
    now: Moment,
    limit: Moment,
    /// The epoch being filled, its packing state, and what was packed but not sent.
    filling: u8,
    packed: State,
    unsent: VecDeque<u8>,
    /// The highest epoch number used.
    newest: u8,
    /// The lowest epoch number that no switch was ever made to.
    next_target: u8,
    /// What was sent but is no whole item yet, and the state of who unpacks it for the channel.
    partial: Vec<u8>,
    /// Whether anything was sent after the last whole item.
    open: bool,
    unpacked: State,
    steps: u32,
    blind_steps: u32,
}

impl Pair {
    fn new(gain: i8, gap: u16, asserts_every_step: bool, motors: u8, start: Moment) -> Pair {
        let settings = Settings { gap_ticks: gap, asserts_every_step, gain };
        let mut pair = Pair {
            packing: Packing { fraction_bits: 16, gain },
            gap: gap.max(1),
            pool: Pool::new(),
            motor: Motor::new(Pool::<POOL>::share(motors, motors - 1), settings),
            channel: Channel::new(gap.into(), asserts_every_step),
            queue: Queue::new(),
            now: Moment(0),
            limit: Moment(0),
            filling: 0,
            packed: State::default(),
            unsent: VecDeque::new(),
            newest: 0,
            next_target: 1,
            partial: Vec::new(),
            open: false,
            unpacked: State::default(),
            steps: 0,
            blind_steps: 0,
        };
        // To the tick at which the test begins, as time goes.
        while pair.now != start {
            let by = start.since(pair.now).min((1 << 30) - 1);
            pair.go(by, 0, 1);
        }
        pair
    }

    /// Sends what is missing of the last item: an epoch of which nothing whole was sent is none to the wide queue.
    fn finish_item(&mut self) -> bool {
        if !self.open {
            return true;
        }
        self.fill(vec![Part::Dwell(0)]);
        self.send(usize::MAX);
        !self.open
    }

    fn begin_epoch(&mut self, epoch: u8) {
        self.filling = epoch;
        self.newest = self.newest.max(epoch);
        self.packed = State::default();
        self.unpacked = State::default();
        self.unsent.clear();
        self.partial.clear();
        self.open = false;
    }

    fn fill(&mut self, parts: Vec<Part>) {
        for part in parts {
            let mut buffer = [0; MAX_PACKED_LEN];
            let item = match part {
                Part::Reset => {
                    let len = self.packing.pack_reset(&mut self.packed, &mut buffer).unwrap();
                    self.unsent.extend(&buffer[..len]);
                    continue;
                }
                Part::Anchor(offset, fraction) => {
                    let tick = Moment(self.now.0.wrapping_add_signed(offset));
                    fraction.map_or(Item::Anchor { tick }, |fraction| Item::Resume { tick, fraction })
                }
                Part::Dwell(ticks) => Item::Dwell { ticks },
                Part::Run { segment, forward } => {
                    let direction = if forward { Direction::Forward } else { Direction::Backward };
                    if !fits(&segment) {
                        continue;
                    }
                    Item::Run { segment, direction }
                }
                Part::Correct { count, corrections, turn } => {
                    let start = if turn { State::new(self.packed.direction.reversed()) } else { self.packed };
                    let State { previous_count, interval, add, add2, direction } = start;
                    let units = self.packing.units(previous_count);
                    let [k1, k2, k3] = corrections;
                    let add2 = if count > 2 { add2 + k3 * units[2] } else { add2 };
                    let add = if count > 1 { add + k2 * units[1] } else { add };
                    let segment = Segment { count, interval: interval + k1 * units[0], add, add2 };
                    if !fits(&segment) {
                        continue;
                    }
                    Item::Run { segment, direction }
                }
                Part::Slow(m) => match self.packed.slow(m, 16) {
                    Some(segment) if segment.interval > 0 && fits(&segment) => {
                        Item::Run { segment, direction: self.packed.direction }
                    }
                    _ => continue,
                },
            };
            let len = self.packing.pack(&mut self.packed, &item, &mut buffer).unwrap();
            self.unsent.extend(&buffer[..len]);
        }
    }

    fn send(&mut self, most: usize) {
        let len = most.min(self.unsent.len());
        let bytes: Vec<u8> = self.unsent.iter().copied().take(len).collect();
        let room = self.motor.bytes().room();
        match self.motor.push(&mut self.pool, Epoch(self.filling), &bytes) {
            Ok(()) => {}
            Err(PushRefused::NoRoom { free }) => {
                assert_eq!(free, room);
                assert!(len > usize::from(free));
                return;
            }
            Err(PushRefused::TooManyEpochs) => return,
        }
        self.unsent.drain(..len);
        self.partial.extend(bytes);
        self.open |= len > 0;
        let mut rest = &self.partial[..];
        while let Ok(Some(item)) = self.packing.unpack(&mut self.unpacked, &mut rest) {
            self.queue.push(Entry { epoch: Epoch(self.filling), item }).unwrap();
            self.open = !rest.is_empty();
        }
        self.partial = rest.to_vec();
    }

    fn compare(&self) {
        assert_eq!(self.motor.position(), self.channel.position());
        assert_eq!(self.motor.horizon(), self.channel.horizon());
        assert_eq!(self.motor.epoch(), self.channel.epoch());
        let missed = self.channel.missed().map(|tick| Fault { reason: Reason::Missed, tick });
        assert_eq!(self.motor.fault(), missed);
    }

    /// Takes the next event of both.
    fn event(&mut self) -> bool {
        let event = self.channel.peek(&mut self.queue, self.limit);
        assert_eq!(self.motor.peek(&self.pool, self.limit), event);
        self.compare();
        let Some(event) = event else { return false };
        assert_eq!(self.motor.peek(&self.pool, self.limit), Some(event), "it stays next");
        self.channel.take(event);
        self.motor.take(event);
        self.steps += u32::from(event.kind == Kind::Step);
        self.compare();
        true
    }

    fn raise_limit(&mut self, ticks: u32) {
        let limit = self.now.after(ticks);
        if self.limit.is_before(limit) {
            self.limit = limit;
        }
    }

    fn go(&mut self, by: u32, ahead: u32, most: usize) {
        self.raise_limit(by + ahead);
        for _ in 0..most {
            if !self.event() {
                self.now = self.now.after(by);
                self.channel.pass(self.now);
                self.motor.pass(self.now);
                self.compare();
                if !self.open {
                    assert_eq!(self.motor.is_idle(), self.channel.is_idle(&self.queue));
                }
                return;
            }
        }
    }

    fn blind(&mut self, fastest: u16, ahead: u32) {
        self.raise_limit(ahead);
        let fastest = fastest.max(self.gap);
        let granted = self.motor.blind(fastest, self.limit);
        assert!(granted <= BLIND_STEPS);
        for _ in 0..granted {
            // What is granted, the other makes too, and nothing else in between.
            let event = self.channel.peek(&mut self.queue, self.limit).expect("a step");
            assert_eq!(event.kind, Kind::Step);
            self.channel.take(event);
            let registers = self.motor.registers_mut();
            let interval = registers.interval_low >> 16;
            assert_eq!(registers.interval_high, 0);
            assert!((u32::from(fastest)..=u32::from(SLOWEST_BLIND)).contains(&interval));
            registers.advance();
            registers.left -= 1;
            assert_eq!(registers.tick, event.tick.0);
        }
        if granted > 0 {
            self.motor.took(granted);
        }
        self.steps += u32::from(granted);
        self.blind_steps += u32::from(granted);
        self.compare();
    }

    fn switch(&mut self, after: i32, skip: u8) {
        // The one that is being filled, or one that nothing was sent of yet.
        let target = self.newest + skip;
        if target < self.next_target {
            return;
        }
        let at = Moment(self.motor.horizon().0.wrapping_add_signed(after));
        let before = self.motor.clone();
        let refused = self.motor.check_switch(at).err();
        if refused == Some(SwitchRefused::Full) {
            // The wide one has room for more.
            assert_eq!(self.channel.check_switch(at), Ok(()));
            assert_eq!(self.motor.schedule_switch(Epoch(target), at), Err(SwitchRefused::Full));
        } else {
            let result = self.channel.schedule_switch(Epoch(target), at);
            assert_eq!(refused, result.err());
            assert_eq!(self.motor.schedule_switch(Epoch(target), at), result);
        }
        assert_eq!(self.motor.position(), before.position());
        self.compare();
        // Another switch is to another epoch.
        if refused.is_none() {
            self.next_target = target + 1;
        }
    }

    fn act(&mut self, action: Action) {
        match action {
            Action::Fill(parts) => self.fill(parts),
            Action::Send(len) => self.send(len),
            Action::NextEpoch => {
                if self.newest < 250 && self.finish_item() {
                    self.begin_epoch(self.newest + 1);
                }
            }
            Action::Plan { from, parts, ahead } => {
                self.act(Action::NextEpoch);
                let fraction = (from % 2 == 1).then_some(from.wrapping_mul(40_503));
                self.fill(vec![Part::Anchor(from.into(), fraction)]);
                self.fill(parts);
                while !self.unsent.is_empty() && self.motor.bytes().room() > 0 {
                    let before = self.unsent.len();
                    self.send(usize::from(self.motor.bytes().room()));
                    if self.unsent.len() == before {
                        break;
                    }
                }
                self.act(Action::Switch { after: ahead, skip: 0 });
            }
            Action::Go { by, ahead, most } => self.go(by, ahead, most),
            // As an engine does: blindly while it may, one step with a look when it may not.
            Action::Blind { fastest, ahead } => {
                for _ in 0..20 {
                    self.blind(fastest, ahead);
                    self.event();
                }
            }
            Action::Switch { after, skip } => {
                if self.newest < 240 && self.finish_item() {
                    self.switch(after, skip);
                }
            }
            Action::Discard => {
                if Epoch(self.filling) != self.motor.epoch() && self.newest < 250 && self.finish_item() {
                    self.motor.discard(Epoch(self.filling));
                    self.queue.discard(Epoch(self.filling));
                    self.begin_epoch(self.newest + 1);
                }
            }
            Action::Stop => {
                self.motor.stop();
                self.channel.stop(&mut self.queue);
                assert!(self.motor.is_idle());
                self.compare();
                self.begin_epoch(self.motor.epoch().0);
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 512, ..ProptestConfig::default() })]

    #[test]
    fn it_does_what_the_wide_channel_does(
        actions in prop::collection::vec(action(), 1..80),
        gain in -45i8..=20,
        gap in prop_oneof![0u16..10, 0u16..100],
        asserts_every_step in prop::bool::weighted(0.1),
        motors in 1u8..=4,
        start: u32,
        wraps: bool,
    ) {
        let start = if wraps { u32::MAX - (start >> 12) } else { start };
        let mut pair = Pair::new(gain, gap, asserts_every_step, motors, Moment(start));
        pair.fill(vec![Part::Anchor(100, None)]);
        for action in actions {
            pair.act(action);
        }
    }
}
