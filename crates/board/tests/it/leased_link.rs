//! Leases of a board at the end of a bad line: what the host believes is what the board does, or one of two things.

use pulsetrain_board::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use pulsetrain_board::replay::{Replay, Sent, Start};
use pulsetrain_board::{Board, Edge, Native, Observer, Port, Remote, ScheduledStep, WithReference};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::lease::LapseCause;
use pulsetrain_core::wire::message::{self, ALL_MOTORS};
use pulsetrain_core::{Entry, Epoch, Item, Tick32};
use pulsetrain_testkit::faulty::{Faulty, Rates};
use pulsetrain_testkit::model::ModelPort;
use pulsetrain_testkit::{Random, TICK_HZ, model_setup, native_config, run, tell, unseen};
use std::time::Duration;

const MS: u64 = TICK_HZ / 1000;

/// Comes to rest within some 30 steps from 2000 steps/s.
fn limit() -> Limit {
    Limit::new(200, 31, 2).unwrap()
}

type Line = Remote<Faulty<ModelPort>>;

fn connect(seed: u64) -> Line {
    let mut remote = Remote::open(Faulty::new(ModelPort::new(), seed), 7).unwrap();
    remote.configure(&model_setup(1)).unwrap();
    remote
}

/// The plan of most tests: 2000 steps/s, longer than any of them.
fn plan() -> [Item; 1] {
    [run(2_000_000, 8000)]
}

/// Has it follow `items` from the tick that is given, with a lease to `until`.
fn begin(remote: &mut Line, epoch: u8, items: &[Item], lease: impl Fn(u64) -> Lease) -> u64 {
    let from = remote.now() + 100 * MS;
    tell(remote, epoch, from, items);
    remote.switch(Epoch(epoch), from, lease(from), &[limit()]).unwrap();
    from
}

/// Where the motor of such a plan comes to rest if the lease ends at `until`.
fn rest_at(items: &[Item], from: u64, until: u64) -> i64 {
    rest_with(limit(), items, from, until)
}

fn rest_with(limit: Limit, items: &[Item], from: u64, until: u64) -> i64 {
    let items: Vec<Item> = [Item::Anchor { tick: Tick32::of(from) }].iter().chain(items).copied().collect();
    let sent = Sent { start: Start::at(from, 16), items: &items, limit, gap_ticks: 17, line: None };
    Replay::new([sent], &[], 16, Some(until)).map(|step| i64::from(step.direction.sign())).sum()
}

/// The model goes on without the host until it rests.
fn goes_on_alone(remote: &mut Line) -> (LeaseState, i64) {
    let port = remote.port_mut().inner_mut();
    let until = port.now().as_nanos() as u64 * 2 / 125 + 3 * TICK_HZ;
    port.run_alone(until);
    (port.lease(), port.positions()[0])
}

#[test]
fn an_extension_is_believed_when_the_board_has_told_it() {
    let mut remote = connect(1);
    assert_eq!((remote.lease(), remote.extend(Lease::Last, &[])), (LeaseState::Off, Err(ExtendRefused::Off)));
    assert_eq!((remote.brake(), remote.trim(0, &[0])), (None, Err(TrimRefused::Extend(ExtendRefused::Off))));
    let from = begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 100 * MS));
    let until = |ms: u64| Lease::Until(from + ms * MS);
    assert_eq!((remote.lease(), remote.unconfirmed()), (until(100).into(), None));
    let now = remote.now();
    assert_eq!(remote.extend(until(150), &[]), Ok(()));
    // Nobody waits for it.
    assert_eq!((remote.now(), remote.lease(), remote.unconfirmed()), (now, until(100).into(), Some(until(150))));
    remote.advance(now + 15 * MS, &mut unseen);
    assert_eq!((remote.lease(), remote.unconfirmed()), (until(150).into(), None));
    // Shorter is allowed; too far ahead is not.
    assert_eq!(remote.extend(until(120), &[limit()]), Ok(()));
    remote.advance(now + 30 * MS, &mut unseen);
    assert_eq!((remote.lease(), remote.unconfirmed()), (until(120).into(), None));
    let far = Lease::Until(remote.now() + (1 << 30));
    assert!(matches!(remote.extend(far, &[]), Err(ExtendRefused::Early { .. })));
    assert_eq!(remote.extend(Lease::Last, &[]), Ok(()));
    remote.advance(from + 130 * MS, &mut unseen);
    assert_eq!((remote.lease(), remote.port().inner().lease()), (LeaseState::Last, LeaseState::Last));
}

/// Whenever it is asked, the board holds one of the two leases that the host thinks possible, and it comes to rest as one of them says.
#[test]
fn the_board_has_one_of_two_leases_on_a_bad_line_and_when_the_cable_is_cut() {
    let (mut waited, mut extended) = (0, 0);
    for seed in 0..30 {
        let mut remote = connect(seed);
        let mut random = Random::new(seed);
        let from = begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 150 * MS));
        remote.port_mut().set(Rates { drop: 120, flip: 60, delay: 100, duplicate: 150 });
        let cut = from + random.between(100, 400) * MS;
        remote.advance(from + 20 * MS, &mut unseen);
        let mut next = from;
        while remote.now() < cut {
            let until = remote.now() + random.between(1, 4) * MS / 2;
            remote.advance(until, &mut unseen);
            if remote.now() >= next && remote.unconfirmed().is_none() {
                extended += 1;
                next += 20 * MS;
                match remote.extend(Lease::Until(remote.now() + 150 * MS), &[]) {
                    Ok(()) => {}
                    Err(ExtendRefused::Lapsed { .. }) => break,
                    Err(refused) => panic!("seed {seed}: {refused}"),
                }
            }
            waited += u32::from(remote.unconfirmed().is_some());
            let has = remote.port().inner().lease();
            let lapsed = matches!(has, LeaseState::Lapsed { .. });
            let thought = [Some(remote.lease()), remote.unconfirmed().map(LeaseState::from)];
            assert!(lapsed || thought.contains(&Some(has)), "seed {seed}: {has:?}, but the host thinks {thought:?}");
        }
        remote.port_mut().cut(Duration::from_secs(60));
        let (has, position) = goes_on_alone(&mut remote);
        let LeaseState::Lapsed { at, .. } = has else { panic!("seed {seed}: {has:?}") };
        let thought = [Some(remote.lease()), remote.unconfirmed().map(LeaseState::from)];
        let possible: Vec<u64> = thought
            .into_iter()
            .flatten()
            .map(|state| match state {
                LeaseState::Until(at) | LeaseState::Lapsed { at, .. } => at,
                LeaseState::Off | LeaseState::Last => panic!("seed {seed}: {state:?}"),
            })
            .collect();
        assert!(possible.contains(&at), "seed {seed}: {at}, but the host thinks {possible:?}");
        assert_eq!(position, rest_at(&plan(), from, at), "seed {seed}");
        assert!(position > 0);
    }
    assert!(extended > 200 && waited > 100, "{extended} extensions, {waited} on their way");
}

/// An end that is committed by the time that it arrives is refused: what was told before holds, and the host comes to know it. Numbers
/// of frames wrap meanwhile: the one of the extension that was accepted last comes again.
#[test]
fn a_refused_extension_is_never_taken_for_an_accepted_one() {
    let mut remote = connect(1);
    begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 100 * MS));
    let settle = |remote: &mut Line| {
        let patience = remote.now() + 100 * MS;
        while remote.unconfirmed().is_some() {
            assert!(remote.now() < patience, "it is never known");
            let until = remote.now() + MS;
            remote.advance(until, &mut unseen);
        }
    };
    for others in 245..262 {
        let holds = Lease::Until(remote.now() + 60 * TICK_HZ);
        assert_eq!(remote.extend(holds, &[]), Ok(()));
        settle(&mut remote);
        assert_eq!(remote.lease(), holds.into(), "{others}");
        for _ in 0..others {
            remote.measures(false).unwrap();
        }
        assert_eq!(remote.extend(Lease::Until(remote.now() - 5 * MS), &[]), Ok(()));
        settle(&mut remote);
        let has = remote.port().inner().lease();
        assert_eq!((remote.lease(), has), (holds.into(), holds.into()), "{others} frames later");
    }
}

#[test]
fn a_lapse_is_an_event_and_another_switch_ends_it() {
    let mut remote = connect(1);
    let from = begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 100 * MS + 77));
    let at = from + 100 * MS + 77;
    remote.advance(at + 600 * MS, &mut unseen);
    let told: Vec<_> = remote.events().iter().map(|event| (event.cause, event.motor, event.tick)).collect();
    // The stop's own end is one, too, as on every board.
    let [lapsed, (message::Cause::Finished, ALL_MOTORS, finished)] = told[..] else { panic!("{told:?}") };
    assert_eq!(lapsed, (message::Cause::Lapsed, ALL_MOTORS, at));
    assert!((at + 1..remote.now()).contains(&finished), "{finished}");
    assert_eq!(remote.lease(), LeaseState::Lapsed { at, cause: LapseCause::NotExtended, in_motion: true });
    assert_eq!(remote.extend(Lease::Last, &[]), Err(ExtendRefused::Lapsed { at }));
    assert_eq!((remote.brake(), remote.lease()), (Some(at), remote.lease()));
    assert!(matches!(remote.trim(u64::MAX / 2, &[0]), Err(TrimRefused::Extend(_))));
    let rest = rest_at(&plan(), from, at);
    assert_eq!((remote.positions(), remote.is_idle()), (vec![rest], true));
    // What comes of that epoch later is taken, and dropped.
    for _ in 0..5 {
        remote.push(0, Entry { epoch: Epoch(1), item: run(100, 8000) }).unwrap();
    }
    let until = remote.now() + 50 * MS;
    remote.advance(until, &mut unseen);
    assert_eq!((remote.positions(), remote.room(0), remote.error()), (vec![rest], 1024, None));
    // Its motion ends before the lease: no stop, and no lapse in motion.
    let items = [run(40, 16_000), Item::Dwell { ticks: 0 }];
    let from = begin(&mut remote, 2, &items, |from| Lease::Until(from + 100 * MS));
    remote.advance(from + 150 * MS, &mut unseen);
    let told: Vec<_> = remote.events().iter().map(|event| event.cause).collect();
    assert_eq!(told, [message::Cause::Finished]);
    assert_eq!(remote.positions(), [rest + 40]);
    assert!(matches!(remote.lease(), LeaseState::Lapsed { in_motion: false, .. }), "{:?}", remote.lease());
}

/// Counts what was scheduled.
#[derive(Default)]
struct Pulses(i64);

impl Observer for Pulses {
    fn edge(&mut self, edge: Edge) {
        self.0 += i64::from(edge.line == 0 && edge.level);
    }

    fn step(&mut self, _: ScheduledStep) {}
}

#[test]
fn brake_is_done_once_on_a_bad_line() {
    let mut told = 0;
    for seed in 0..30 {
        let mut remote = connect(seed);
        let mut random = Random::new(seed);
        let from = begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 2 * TICK_HZ));
        remote.port_mut().set(Rates { drop: 150, flip: 60, delay: 100, duplicate: 200 });
        remote.advance(from + random.between(0, 300) * MS, &mut unseen);
        if seed % 2 == 0 {
            // It is on its way, or is withdrawn.
            remote.extend(Lease::Until(from + 3 * TICK_HZ), &[]).unwrap();
        }
        let at = remote.brake().unwrap_or_else(|| panic!("seed {seed}: {:?}", remote.error()));
        assert!(at < remote.now() + 50 * MS, "seed {seed}");
        assert_eq!(remote.unconfirmed(), None);
        assert_eq!(remote.brake(), Some(at), "seed {seed}");
        remote.port_mut().set(Rates::default());
        let until = remote.now() + TICK_HZ / 2;
        remote.advance(until, &mut unseen);
        // The event may get lost; all else not.
        let events = remote.events();
        let in_motion = events.iter().any(|event| (event.cause, event.tick) == (message::Cause::Braked, at));
        told += u32::from(in_motion);
        assert_eq!(remote.lease(), LeaseState::Lapsed { at, cause: LapseCause::Ordered, in_motion }, "seed {seed}");
        assert_eq!(remote.positions(), [rest_at(&plan(), from, at)], "seed {seed}");
    }
    assert!(told > 15, "{told} events");
}

/// An extension that is on its way when the order to brake goes out is before it: its limits hold, and the host knows.
#[test]
fn an_order_to_brake_tells_what_became_of_extensions_before_it() {
    let softer = Limit::new(200, 32, 2).unwrap();
    let mut remote = connect(1);
    let from = begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 300 * MS));
    remote.advance(from + 50 * MS, &mut unseen);
    for (more, limits) in [(310, limit()), (320, softer)] {
        remote.extend(Lease::Until(from + more * MS), &[limits]).unwrap();
    }
    // They go out, and no answer has come.
    let now = remote.now();
    remote.advance(now, &mut unseen);
    assert_eq!(remote.unconfirmed(), Some(Lease::Until(from + 320 * MS)));
    let at = remote.brake().expect("the lease holds");
    assert!(at < from + 200 * MS);
    assert_eq!([remote.extended(), remote.extended(), remote.extended()], [Some(true), Some(true), None]);
    remote.advance(at + 3 * TICK_HZ, &mut unseen);
    let rests = rest_with(softer, &plan(), from, at);
    assert_eq!((remote.positions(), remote.unconfirmed()), (vec![rests], None));
    assert!(rests > rest_at(&plan(), from, at));

    // One that comes after the lease is over is refused.
    let mut remote = connect(2);
    let from = begin(&mut remote, 1, &plan(), |from| Lease::Until(from + 50 * MS));
    remote.advance(from + 49 * MS, &mut unseen);
    remote.port_mut().set(Rates { drop: 1000, ..Rates::default() });
    remote.extend(Lease::Until(from + 400 * MS), &[softer]).unwrap();
    remote.advance(from + 60 * MS, &mut unseen);
    remote.port_mut().set(Rates::default());
    let at = remote.brake().expect("the lease is over");
    assert_eq!((at, remote.extended(), remote.extended()), (from + 50 * MS, Some(false), None));
    remote.advance(at + 3 * TICK_HZ, &mut unseen);
    assert_eq!(remote.positions(), [rest_at(&plan(), from, at)]);
}

/// The end of the plan is taken back and told otherwise, again and again: each trim is done once, and both ends pack what follows from the same
/// place.
#[test]
fn trims_are_done_once_on_a_bad_line() {
    for seed in 0..30 {
        let mut remote = connect(seed);
        let mut random = Random::new(seed);
        // Of other lengths and periods each, so that packed bytes depend on what was before.
        let mut some = |least: u64| -> Vec<Item> {
            let count = random.between(least, least + 12);
            (0..count).map(|_| run(random.between(20, 60) as u32, random.between(5000, 9000) as i64)).collect()
        };
        let mut items = some(40);
        begin(&mut remote, 1, &items, |from| Lease::Until(from + 4 * TICK_HZ));
        remote.port_mut().set(Rates { drop: 120, flip: 60, delay: 60, duplicate: 200 });
        let mut pulses = Pulses::default();
        for _ in 0..4 {
            let until = remote.now() + 5 * MS;
            remote.advance(until, &mut pulses);
            let (room, count) = (remote.room(0), 8);
            let until = remote.now() + 4 * TICK_HZ;
            assert_eq!(remote.trim(until, &[count]), Ok(()), "seed {seed}");
            assert_eq!(remote.lease(), LeaseState::Until(until));
            assert!(remote.room(0) > room, "seed {seed}: {} of {room}", remote.room(0));
            items.truncate(items.len() - count);
            let more = some(7);
            for item in &more {
                remote.push(0, Entry { epoch: Epoch(1), item: *item }).unwrap();
            }
            items.extend(more);
        }
        // More than wait.
        let until = remote.now() + 4 * TICK_HZ;
        assert_eq!(remote.trim(until, &[200]), Err(TrimRefused::Read { motor: 0 }));
        remote.extend(Lease::Last, &[]).unwrap();
        remote.port_mut().set(Rates::default());
        let until = remote.now() + 3 * TICK_HZ;
        remote.advance(until, &mut pulses);
        let steps = |item: &Item| if let Item::Run { segment, .. } = item { i64::from(segment.count) } else { 0 };
        let steps: i64 = items.iter().map(steps).sum();
        assert_eq!((remote.positions(), pulses.0), (vec![steps], steps), "seed {seed}");
        assert_eq!((remote.room(0), remote.lease(), remote.error()), (1024, LeaseState::Last, None), "seed {seed}");
    }
}

/// The beginning of another plan is dropped, as it had no room: both ends pack the plan that goes on from where it was.
#[test]
fn a_plan_goes_on_after_another_was_dropped() {
    for seed in 0..10 {
        let mut remote = connect(seed);
        let mut random = Random::new(seed);
        let mut some = |count: u64| -> Vec<Item> {
            (0..count).map(|_| run(random.between(20, 60) as u32, random.between(5000, 9000) as i64)).collect()
        };
        let mut items = some(20);
        begin(&mut remote, 1, &items, |from| Lease::Until(from + 4 * TICK_HZ));
        let until = remote.now() + 5 * MS;
        let mut pulses = Pulses::default();
        remote.advance(until, &mut pulses);
        let anchor = Item::Anchor { tick: Tick32::of(until + TICK_HZ) };
        for item in std::iter::once(anchor).chain(some(4)) {
            remote.push(0, Entry { epoch: Epoch(2), item }).unwrap();
        }
        remote.discard(Epoch(2));
        let more = some(7);
        for item in &more {
            remote.push(0, Entry { epoch: Epoch(1), item: *item }).unwrap();
        }
        items.extend(more);
        remote.extend(Lease::Last, &[]).unwrap();
        let until = remote.now() + 3 * TICK_HZ;
        remote.advance(until, &mut pulses);
        let steps = |item: &Item| if let Item::Run { segment, .. } = item { i64::from(segment.count) } else { 0 };
        let steps: i64 = items.iter().map(steps).sum();
        assert_eq!((remote.positions(), pulses.0), (vec![steps], steps), "seed {seed}");
        assert_eq!((remote.lease(), remote.error()), (LeaseState::Last, None), "seed {seed}");
    }
}

/// A trim whose answer is lost may have been done: the host knows both ends.
#[test]
fn a_trim_without_an_answer_leaves_two_ends() {
    let items: Vec<Item> = (0..30).map(|_| run(50, 8000)).collect();
    for is_taken in [true, false] {
        let mut remote = connect(1);
        let from = begin(&mut remote, 1, &items, |from| Lease::Until(from + 300 * MS));
        let now = remote.now();
        remote.advance(now + 5 * MS, &mut unseen);
        let (before, until) = (remote.lease(), from + 200 * MS);
        if is_taken {
            remote.port_mut().mute();
        } else {
            remote.port_mut().cut(Duration::from_secs(60));
        }
        assert_eq!(remote.trim(until, &[4]), Err(TrimRefused::Extend(ExtendRefused::Lost)));
        assert_eq!((remote.lease(), remote.unconfirmed()), (before, Some(Lease::Until(until))));
        let (has, position) = goes_on_alone(&mut remote);
        let LeaseState::Lapsed { at, .. } = has else { panic!("{has:?}") };
        assert_eq!(at, if is_taken { until } else { from + 300 * MS });
        assert_eq!(position, rest_at(&items, from, at));
    }
}

/// Nothing is said to a board that is lost, and it says so.
#[test]
fn a_board_that_is_lost_takes_no_lease() {
    let mut remote = connect(1);
    begin(&mut remote, 1, &plan(), |from| Lease::Until(from + TICK_HZ));
    let holds = remote.lease();
    remote.port_mut().cut(Duration::from_secs(60));
    assert!(remote.status().is_err());
    assert_eq!(remote.extend(Lease::Last, &[]), Err(ExtendRefused::Lost));
    assert_eq!(remote.trim(0, &[0]), Err(TrimRefused::Extend(ExtendRefused::Lost)));
    assert_eq!((remote.brake(), remote.lease(), remote.unconfirmed()), (None, holds, None));
}

/// A shadow waits where the board may have one of two leases, and then schedules what the board does.
#[test]
fn a_shadow_goes_by_the_lease_that_was_accepted() {
    #[derive(Default)]
    struct Both(i64, i64);
    impl Observer for Both {
        fn edge(&mut self, edge: Edge) {
            self.0 += i64::from(edge.line == 0 && edge.level);
        }
        fn step(&mut self, _: ScheduledStep) {
            self.1 += 1;
        }
    }
    for seed in 0..20 {
        let shadow = Native::unbounded(&native_config(&model_setup(1))).unwrap();
        let mut board = WithReference::new(connect(seed), shadow);
        let from = board.now() + 100 * MS;
        tell(&mut board, 1, from, &plan());
        board.switch(Epoch(1), from, Lease::Until(from + 60 * MS), &[limit()]).unwrap();
        board.board_mut().port_mut().set(Rates { drop: 120, flip: 60, delay: 100, duplicate: 150 });
        let mut seen = Both::default();
        board.advance(from, &mut seen);
        for _ in 0..30 {
            if board.board().unconfirmed().is_none() && board.extend(Lease::Until(board.now() + 50 * MS), &[]).is_err()
            {
                break;
            }
            let until = board.now() + 12 * MS;
            board.advance(until, &mut seen);
        }
        board.board_mut().port_mut().set(Rates::default());
        let until = board.now() + TICK_HZ;
        board.advance(until, &mut seen);
        assert!(matches!(board.lease(), LeaseState::Lapsed { .. }), "seed {seed}: {:?}", board.lease());
        assert!(board.record_is_complete() && seen.0 > 0, "seed {seed}");
        assert_eq!((seen.1, board.positions()), (seen.0, vec![seen.0]), "seed {seed}");
    }
}
