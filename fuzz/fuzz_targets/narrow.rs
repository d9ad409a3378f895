//! A packed stream of any content: what fits the narrow motor makes the same events there as in the wide channel; what
//! does not fit breaks nothing.
#![no_main]

use libfuzzer_sys::fuzz_target;
use pulsetrain_core::channel::{Channel, Event};
use pulsetrain_core::narrow::{Motor, Pool, Settings};
use pulsetrain_core::packing::{Packing, State};
use pulsetrain_core::{Entry, Epoch, Item, Moment, Queue, Segment};

const POOL: usize = 8192;

fuzz_target!(|input: (u8, i8, &[u8])| {
    let (gap, gain, bytes) = input;
    if bytes.len() > POOL - 2 {
        return;
    }
    let packing = Packing { fraction_bits: 16, gain };
    let settings = Settings { gap_ticks: gap.into(), asserts_every_step: false, gain };
    let mut pool = Pool::<POOL>::new();
    let mut motor = Motor::new(Pool::<POOL>::share(1, 0), settings);
    let mut channel = Channel::<16>::new(gap.into(), false);

    let (mut state, mut rest, mut limit) = (State::default(), bytes, Moment(0));
    loop {
        let before = rest;
        if begins_with_check(rest) {
            break;
        }
        let Ok(Some(item)) = packing.unpack(&mut state, &mut rest) else { break };
        if !fits(&item) {
            rest = before;
            break;
        }
        let mut queue = Queue::<1>::new();
        queue.push(Entry { epoch: Epoch(0), item }).expect("an empty queue");
        motor.push(&mut pool, Epoch(0), &before[..before.len() - rest.len()]).expect("it was read up to here");
        let mut now = limit;
        for round in 0.. {
            // As far as the first event may be: a step after an interval of 2^24 ticks, and the wait before.
            if round == 200 {
                return;
            }
            limit = now.after(1 << 25);
            let mut events = 0;
            while let Some(event) = next(&mut channel, &mut queue, &mut motor, &pool, limit) {
                channel.take(event);
                motor.take(event);
                events += 1;
                if events == 100_000 {
                    return;
                }
            }
            assert_eq!(motor.position(), channel.position());
            assert_eq!(motor.fault().map(|fault| fault.tick), channel.missed());
            // A step that cannot be made ends the narrow motor's epoch; the wide channel goes on at the next anchor.
            if channel.missed().is_some() {
                return;
            }
            if channel.is_idle(&queue) {
                break;
            }
            now = limit;
            channel.pass(now);
            motor.pass(now);
        }
    }

    // The rest, whatever it is.
    if motor.push(&mut pool, Epoch(0), rest).is_ok() {
        for _ in 0..100_000 {
            let Some(event) = motor.peek(&pool, limit) else { break };
            motor.take(event);
        }
    }
});

fn next(
    channel: &mut Channel<16>,
    queue: &mut Queue<1>,
    motor: &mut Motor,
    pool: &Pool<POOL>,
    limit: Moment,
) -> Option<Event> {
    let event = channel.peek(queue, limit);
    assert_eq!(motor.peek(pool, limit), event);
    event
}

/// Whether a check comes before the next item: the wide channel passes over it.
fn begins_with_check(mut rest: &[u8]) -> bool {
    while let [header, 0, after @ ..] = rest {
        match header {
            0b000_111 | 0b001_111 => rest = after,
            header => return *header == 0b101_111,
        }
    }
    false
}

/// Whether a narrow motor can have it.
fn fits(item: &Item) -> bool {
    let Item::Run { segment: Segment { count, mut interval, mut add, add2 }, .. } = *item else { return true };
    count <= 65_535
        && (0..count).all(|_| {
            let fits = (0..1 << 40).contains(&interval) && i32::try_from(add).is_ok() && i32::try_from(add2).is_ok();
            interval = interval.wrapping_add(add);
            add = add.wrapping_add(add2);
            fits
        })
}
