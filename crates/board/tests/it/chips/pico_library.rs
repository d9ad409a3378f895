//! The library for programs of one's own on the Pico, on the emulated chip: what it refuses, what it tells, how it stops and begins
//! again, and how long its interrupts may be kept out.

use pulsetrain_core::verbs::{Heading, Verb};
use pulsetrain_core::wire::message::Reason;
use pulsetrain_testkit::mailbox::{Mailbox, Waited};
use pulsetrain_testkit::pico::TICK_HZ;

const MS: u64 = TICK_HZ / 1000;
const US: u64 = TICK_HZ / 1_000_000;

const BACKWARD: Verb = Verb::Heading(Heading::Backward);

fn steps(steps: u32) -> Verb {
    Verb::Move { steps }
}

fn speed(ticks: u64) -> Verb {
    Verb::Speed { ticks }
}

/// So many ticks, `period` apart, from `first` on.
fn every(first: u64, period: u64, count: usize) -> Vec<u64> {
    (first..).step_by(period as usize).take(count).collect()
}

/// Two motors after some time, in which the first interrupts came.
fn two() -> Mailbox {
    let mut mailbox = Mailbox::new(2);
    mailbox.advance(5 * MS);
    mailbox
}

#[test]
fn what_it_refuses_does_nothing() {
    let mut mailbox = two();
    assert_eq!(mailbox.tell(&[(1, steps(5)), (2, steps(5))]), Err((Reason::NoSuchMotor, 2)));
    assert_eq!(mailbox.tell(&[(1, steps(5)), (200, steps(5))]), Err((Reason::NoSuchMotor, 200)));
    assert_eq!(mailbox.tell(&[(1, steps(5)), (0, speed(249))]), Err((Reason::Period, 250)));
    assert_eq!(mailbox.tell(&[(1, steps(5)); 9]), Err((Reason::Full, 8)));
    assert_eq!(mailbox.tell(&[(1, steps(5)), (1, steps(5)), (1, steps(5))]), Err((Reason::Busy, 1)));
    mailbox.advance(mailbox.now() + 10 * MS);
    assert_eq!([0, 1].map(|motor| mailbox.steps(motor).len()), [0, 0]);
    assert_eq!(mailbox.dones, []);
    for motor in [0, 1] {
        assert_eq!(mailbox.motor(motor), (0, true, true));
    }
    // The timer's interrupt, and the DMA's, are the library's; there are 32.
    for interrupt in [1, 11, 32, 200] {
        assert!(mailbox.is_taken(interrupt), "{interrupt}");
    }
}

/// Steps on their ticks, positions while they go, and each done, once, a period after its last step.
#[test]
fn moves_are_made_and_told() {
    let mut mailbox = two();
    let first = mailbox
        .tell(&[(0, speed(2500)), (1, speed(7001)), (1, BACKWARD), (0, steps(300)), (1, steps(100)), (0, steps(50))])
        .expect("it can");
    mailbox.advance(first + 100 * 2500 + 1000);
    // Time passes until the answer.
    let before = mailbox.steps(0).len();
    let (position, rests, _) = mailbox.motor(0);
    assert!((before..=mailbox.steps(0).len()).contains(&(position as usize)), "{position}");
    assert!(!rests);
    mailbox.advance(first + 360 * 2500);
    assert_eq!(mailbox.steps(0), every(first, 2500, 350));
    assert_eq!(mailbox.steps(1), every(first, 7001, 100));
    let done = |motor, tick: u64, number| (motor, tick as u32, number);
    let wanted = [done(1, first + 100 * 7001, 1), done(0, first + 300 * 2500, 1), done(0, first + 350 * 2500, 2)];
    assert_eq!(mailbox.dones, wanted);
    assert_eq!([mailbox.motor(0), mailbox.motor(1)], [(350, true, true), (-100, true, true)]);
}

/// A done move tells the motor what to do next, again and again: none of them is lost.
#[test]
fn each_of_many_short_moves_is_told() {
    let mut mailbox = two();
    mailbox.on_done(0, 1);
    mailbox.tell(&[(0, speed(1000)), (0, steps(1)), (1, speed(100_000)), (1, steps(3))]).expect("it can");
    for _ in 0..20 {
        mailbox.advance(mailbox.now() + 5 * MS);
    }
    for motor in [0, 1] {
        let dones: Vec<_> = mailbox.dones.iter().filter(|done| done.0 == motor).collect();
        assert!(dones.len() > 30, "{}", dones.len());
        assert!(dones.iter().map(|done| done.2).eq(1..=dones.len() as u32), "{dones:?}");
        let all = mailbox.steps(motor as u8).len();
        let told = if motor == 0 { dones.len() } else { dones.len() + 2 };
        assert!((told..=told + 3).contains(&all), "{all} steps, {told} of them told");
    }
}

/// Several futures wait for one motor, more than have a place, and others for another; a halt ends them as a done move does.
#[test]
fn futures_end_with_what_they_wait_for() {
    let mut mailbox = two();
    mailbox.tell(&[(0, speed(12_500)), (1, speed(12_500)), (0, steps(200)), (1, Verb::Run)]).expect("it can");
    for future in 0..5 {
        mailbox.wait(future, 0);
    }
    mailbox.wait(5, 1);
    mailbox.advance(mailbox.now() + 10 * MS);
    assert!((0..6).all(|future| mailbox.waited(future).0 == Waited::Waits));
    mailbox.advance(mailbox.now() + 15 * MS);
    for future in 0..5 {
        assert_eq!(mailbox.waited(future).0, Waited::Done, "future {future}");
    }
    assert_eq!(mailbox.waited(5), (Waited::Waits, 1), "nothing woke it");
    mailbox.tell(&[(1, Verb::Halt)]).expect("it can");
    mailbox.advance(mailbox.now() + 2 * MS);
    assert_eq!(mailbox.waited(5), (Waited::Done, 2));
    // Four have a place each, and are polled as they begin, as the move is done, and no more.
    mailbox.tell(&[(0, steps(200))]).expect("it can");
    for future in 0..4 {
        mailbox.wait(future, 0);
    }
    mailbox.advance(mailbox.now() + 30 * MS);
    for future in 0..4 {
        assert_eq!(mailbox.waited(future), (Waited::Done, 2));
    }
}

/// After all stopped: positions are what was done, who waits is told, and it begins again. Gives the moves of motor 0 that were told,
/// and its steps.
#[track_caller]
fn begins_again(mailbox: &mut Mailbox) -> (usize, usize) {
    assert_eq!(mailbox.tell(&[(0, steps(5))]), Err((Reason::NotArmed, 0)));
    let made = mailbox.steps(0).len();
    assert_eq!(mailbox.motor(0), (made as i32, true, false));
    let backward = mailbox.steps(1).len() as i32;
    assert_eq!(mailbox.motor(1), (-backward, true, false));
    assert!(made > 10 && backward > 10, "they moved before: {made}, {backward}");
    // Who waited, and who waits now.
    mailbox.wait(1, 1);
    mailbox.advance(mailbox.now() + 3 * MS);
    assert_eq!([0, 1].map(|future| mailbox.waited(future).0), [Waited::Refused; 2]);
    assert_eq!(mailbox.arm(), Ok(()));
    assert_eq!(mailbox.arm(), Ok(()), "they are");
    let (seen, told) = (mailbox.steps(0).len() + mailbox.steps(1).len(), mailbox.dones.len());
    mailbox.advance(mailbox.now() + 10 * MS);
    assert_eq!(
        (mailbox.steps(0).len() + mailbox.steps(1).len(), mailbox.dones.len()),
        (seen, told),
        "nothing moves by itself"
    );
    let first = mailbox.tell(&[(0, speed(5000)), (0, BACKWARD), (0, steps(40))]).expect("it can");
    mailbox.wait(2, 0);
    mailbox.advance(first + 45 * 5000);
    assert_eq!(mailbox.steps(0)[made..], every(first, 5000, 40));
    assert_eq!(mailbox.dones[told..], [(0, (first + 40 * 5000) as u32, 1)]);
    assert_eq!(mailbox.motor(0), (made as i32 - 40, true, true));
    mailbox.advance(mailbox.now() + 2 * MS);
    assert_eq!(mailbox.waited(2).0, Waited::Done);
    (told, made)
}

/// Motor 0 makes moves of `moved` steps, one after the other; motor 1 runs; a future waits for motor 1.
fn moving(moved: u32) -> Mailbox {
    let mut mailbox = two();
    mailbox.on_done(0, moved);
    mailbox
        .tell(&[
            (0, speed(12_500)),
            (1, speed(30_000)),
            (1, BACKWARD),
            (1, Verb::Run),
            (0, steps(moved)),
            (0, steps(moved)),
        ])
        .expect("it can");
    mailbox.wait(0, 1);
    mailbox.advance(mailbox.now() + 20 * MS);
    assert_eq!(mailbox.waited(0).0, Waited::Waits);
    mailbox
}

#[test]
fn it_begins_again_after_a_stop() {
    for moved in [1, 2, 7] {
        let mut mailbox = moving(moved);
        mailbox.on_done(0, 0);
        let tick = mailbox.stop();
        mailbox.advance(mailbox.now() + 5 * MS);
        let made = mailbox.steps(0);
        assert!(made.iter().all(|step| *step <= tick), "no step after tick {tick}");
        let ended =
            made.iter().skip(moved as usize - 1).step_by(moved as usize).filter(|step| **step + 12_500 <= tick).count();
        let (told, _) = begins_again(&mut mailbox);
        assert_eq!(told, ended, "{} steps, {moved} a move, until {tick}", made.len());
    }
}

/// Interrupts are kept out for too long: all motors stop, and it can begin again. What was done is told: short moves were done, and
/// nobody told more, before words ended; of long ones words end in the midst.
#[test]
fn it_begins_again_after_words_were_late() {
    for moved in [1, 2, 7, 40] {
        let mut mailbox = moving(moved);
        mailbox.keep_out((10 * MS) as u32);
        mailbox.advance(mailbox.now() + 20 * MS);
        mailbox.on_done(0, 0);
        let (told, made) = begins_again(&mut mailbox);
        let moved = moved as usize;
        assert_eq!(told, made / moved, "{made} steps made, {moved} a move");
    }
}

/// Whenever words are late, by little or by much: what was done is told, and no more.
#[test]
fn what_was_done_before_words_were_late_is_told() {
    for us in [500, 1200] {
        let mut mailbox = moving(5);
        mailbox.own_interrupt((us * US) as u32, 0x40);
        let (end, mut stopped) = (mailbox.now() + 28 * MS / 10, 0);
        while mailbox.now() < end {
            let mut tried = mailbox.clone();
            tried.interrupt();
            tried.advance(tried.now() + 4 * MS);
            if !tried.motor(0).2 {
                stopped += 1;
                let (told, made) = (tried.dones.len(), tried.steps(0).len());
                // It may have run dry, or been stopped, in the period of a move's last step.
                let is_told = told == made / 5 || (made % 5 == 0 && told == made / 5 - 1);
                assert!(is_told, "{told} are told, {made} steps made; late by {us} us");
            }
            mailbox.advance(mailbox.now() + 31 * US + 5);
        }
        assert!(stopped > 3, "{stopped} stops, late by {us} us");
    }
}

#[test]
fn drivers_are_released_at_rest_alone() {
    let mut mailbox = two();
    mailbox.tell(&[(0, Verb::Run)]).expect("it can");
    assert_eq!(mailbox.release(), Err((Reason::Moving, 0)));
    mailbox.tell(&[(0, Verb::Halt)]).expect("it can");
    mailbox.advance(mailbox.now() + 5 * MS);
    assert_eq!(mailbox.release(), Ok(()));
    assert_eq!(mailbox.tell(&[(0, steps(1))]), Err((Reason::NotArmed, 0)));
    assert_eq!(mailbox.arm(), Ok(()));
    mailbox.tell(&[(0, steps(1))]).expect("it can");
}

/// All motors at their shortest period, each started at a time of its own, told a new direction and speed now and then: every step
/// on its tick.
#[test]
fn the_shortest_periods_hold() {
    for count in 1..=8_u32 {
        let period = 125 * u64::from(count);
        let mut mailbox = Mailbox::new(count as u8);
        mailbox.advance(3 * MS);
        let mut first = Vec::new();
        for motor in 0..count {
            first.push(mailbox.tell(&[(motor, speed(period)), (motor, Verb::Run)]).expect("it can"));
            mailbox.advance(mailbox.now() + MS / 3);
        }
        mailbox.advance(mailbox.now() + 30 * MS);
        let slower: Vec<_> = (0..count).map(|motor| (motor, speed(period + 1))).collect();
        let then = mailbox.tell(&slower).expect("it can");
        mailbox.advance(then + 20 * MS);
        assert!(mailbox.motor(0).2, "{count} motors did not starve");
        let end = mailbox.now();
        for (motor, first) in (0..).zip(first) {
            let made = mailbox.steps(motor);
            let before = made.partition_point(|tick| *tick < then);
            assert_eq!(made[..before], every(first, period, before), "motor {motor} of {count}");
            assert!(made[before - 1] + period >= then, "no gap before {then}");
            let after = made.len() - before;
            assert_eq!(
                made[before..],
                every(made[before - 1] + period + 1, period + 1, after),
                "motor {motor} of {count}"
            );
            assert!(made[made.len() - 1] + 2 * period > end, "it goes on");
        }
    }
}

/// All motors begin at their shortest period, in one order; then all turn at once: every step on its tick.
#[test]
fn motors_may_begin_and_turn_together() {
    for count in 1..=8_u32 {
        let period = 125 * u64::from(count);
        let mut mailbox = resting(count, period);
        let first = mailbox.tell(&all(count, Verb::Run)).expect("it can");
        mailbox.advance(first + 10 * MS);
        let turn = mailbox.tell(&all(count, BACKWARD)).expect("it can");
        mailbox.advance(turn + 10 * MS);
        assert!(mailbox.motor(0).2, "{count} motors did not starve");
        for motor in 0..count as u8 {
            let made = mailbox.steps(motor);
            let before = made.partition_point(|tick| *tick < turn);
            assert_eq!(made[..before], every(first, period, before), "motor {motor} of {count}");
            assert!(made[before - 1] + period >= turn, "no gap before the turn");
            // A pulse, a hold and a set-up of DIR, 50 ticks each, are more than the shortest of one motor; a word for DIR is more.
            let back = made[before];
            assert!((turn..=made[before - 1] + period.max(160)).contains(&back), "motor {motor} of {count}");
            assert_eq!(made[before..], every(back, period, made.len() - before), "motor {motor} of {count}");
            assert!(made[made.len() - 1] + 2 * period > mailbox.now(), "it goes on");
        }
    }
}

/// Coils, which half steps change one at a time.
#[test]
fn coils_hold_their_shortest_periods() {
    for count in 1..=5_u32 {
        let period = 1000 * u64::from(count);
        let mut mailbox = Mailbox::on_coils(count as u8);
        mailbox.advance(3 * MS);
        mailbox.tell(&all(count, speed(period))).expect("it can");
        let first = mailbox.tell(&all(count, Verb::Run)).expect("it can");
        mailbox.advance(first + 20 * MS);
        assert!(mailbox.motor(0).2, "{count} motors did not starve");
        for motor in 0..count as u8 {
            let coils = 2 + 4 * motor..6 + 4 * motor;
            let edges = mailbox.edges.iter().filter(|edge| coils.contains(&edge.line) && edge.tick >= first);
            let mut made: Vec<_> = edges.map(|edge| edge.tick).collect();
            // The first half step switches them on.
            made.dedup();
            assert_eq!(made, every(first, period, made.len()), "motor {motor} of {count}");
            assert!(made[made.len() - 1] + 2 * period > mailbox.now(), "it goes on");
        }
    }
}

/// The same for so many motors.
fn all(count: u32, verb: Verb) -> Vec<(u32, Verb)> {
    (0..count).map(|motor| (motor, verb)).collect()
}

/// So many motors at rest that have been told a period.
fn resting(count: u32, period: u64) -> Mailbox {
    let mut mailbox = Mailbox::new(count as u8);
    mailbox.advance(3 * MS);
    mailbox.tell(&all(count, speed(period))).expect("it can");
    mailbox
}

/// What is told holds within 2 ms, whenever it is told: an answer is seen 50 µs after it is there at most.
#[test]
fn orders_hold_within_two_milliseconds() {
    for (count, period) in [(1, 125_000), (1, 125), (8, 125_000), (8, 1001)] {
        let mut mailbox = running(count, period);
        for time in 0..40 {
            mailbox.advance(mailbox.now() + 370 * US);
            let from = mailbox.tell(&[(0, speed(period + time % 2))]).expect("it can");
            let ahead = from - mailbox.now();
            assert!((MS / 4..2 * MS - 50 * US).contains(&ahead), "{ahead} ticks; {count} motors at {period}");
        }
        assert!(mailbox.motor(0).2, "{count} motors at {period} did not starve");
    }
}

/// So many motors that run, one step every `period` ticks, for a while.
fn running(count: u32, period: u64) -> Mailbox {
    let mut mailbox = Mailbox::new(count as u8);
    mailbox.advance(3 * MS);
    for motor in 0..count {
        mailbox.tell(&[(motor, speed(period)), (motor, Verb::Run)]).expect("it can");
    }
    mailbox.advance(mailbox.now() + 10 * MS);
    mailbox
}

/// Whether motors go on, whenever an interrupt of the program's comes that takes so many ticks and has that priority: once within
/// two rounds of the timer's, `apart` ticks after the last one tried.
fn go_on(mailbox: &Mailbox, priority: u8, ticks: u64, apart: u64) -> bool {
    let mut mailbox = mailbox.clone();
    mailbox.own_interrupt(ticks as u32, priority);
    go_on_from_here(mailbox, apart)
}

/// The same if motors that rest begin all at once.
fn begin(mailbox: &Mailbox, priority: u8, ticks: u64, apart: u64) -> bool {
    let mut mailbox = mailbox.clone();
    mailbox.own_interrupt(ticks as u32, priority);
    mailbox.tell(&all(mailbox.motors(), Verb::Run)).expect("it can");
    go_on_from_here(mailbox, apart)
}

fn go_on_from_here(mut mailbox: Mailbox, apart: u64) -> bool {
    let end = mailbox.now() + 28 * MS / 10;
    while mailbox.now() < end {
        let mut tried = mailbox.clone();
        tried.interrupt();
        tried.advance(tried.now() + 2 * MS);
        assert_eq!(tried.interrupts(), 1);
        if !tried.motor(0).2 {
            return false;
        }
        mailbox.advance(mailbox.now() + apart);
    }
    true
}

/// What the library's page says that the timer's interrupt may be kept out.
#[test]
fn the_timers_interrupt_may_be_late() {
    for (count, period, us) in [
        (1, 125_000, 300),
        (1, 125, 300),
        (2, 250, 250),
        (4, 5000, 350),
        (4, 500, 250),
        (6, 750, 250),
        (8, 2000, 300),
        (8, 1000, 200),
    ] {
        let mailbox = running(count, period);
        // The DMA's comes before it, the timer's behind.
        assert!(go_on(&mailbox, 0x40, us * US, 31 * US + 5), "{count} motors at {period}: {us} us");
        assert!(
            begin(&resting(count, period), 0x40, us * US, 31 * US + 5),
            "{count} motors begin with {period}: {us} us"
        );
        // When the timer's comes words are left for so long.
        let left = 350 + 50 * u64::from(count);
        assert!(!go_on(&mailbox, 0x40, (left + 10) * US, 31 * US + 5), "{count} motors at {period}: more than is left");
    }
}

/// And the DMA's.
#[test]
fn the_dmas_interrupt_may_be_late() {
    for period in [125, 312, 1250] {
        let mailbox = running(1, period);
        // Of the highest priority: the DMA's waits.
        assert!(go_on(&mailbox, 0, 7 * period, 3 * period + 3), "every {period} ticks");
        assert!(!go_on(&mailbox, 0, 12 * period, 3 * period + 3), "every {period} ticks: more than eight words");
    }
}

/// `on_done` runs in the timer's interrupt, and takes of the same time.
#[test]
fn on_done_may_take_its_time() {
    // Moves of other lengths end elsewhere between two rounds.
    let hold = |us: u64| {
        let ends = (10..22).map(|moved| {
            let mut mailbox = running(2, 12_501);
            mailbox.tell(&[(0, Verb::Halt)]).expect("it can");
            mailbox.on_done((us * US) as u32, moved);
            mailbox.tell(&[(0, steps(moved))]).expect("it can");
            mailbox.advance(mailbox.now() + 60 * MS);
            mailbox.motor(0).2
        });
        ends.filter(|goes_on| *goes_on).count()
    };
    assert_eq!(hold(250), 12);
    assert!(hold(1000) < 12, "more than 0.4 ms");
}

/// An interrupt of the program's comes when the alarm of the next round has been worked out, and is not set yet.
#[test]
fn an_interrupt_does_not_make_it_miss_its_alarm() {
    const TIMER_ALARM1: u32 = 0x4005_4014;
    const TIMER_RAW: u32 = 0x4005_4028;
    let mut mailbox = two();
    // Two done moves 0.1 ms apart: between them its rounds are as short.
    mailbox.on_done(0, 1);
    mailbox.tell(&[(0, speed(12_500)), (0, steps(1)), (0, steps(1))]).expect("it can");
    mailbox.own_interrupt((150 * US) as u32, 0x40);
    mailbox.advance(mailbox.now() + 30 * MS);
    // The next one that is sooner than the interrupt takes.
    let mut ahead = mailbox.clone();
    let set = loop {
        let mut read = |register| ahead.pico.chip_mut().read(register, &mut ());
        let (alarm, soon) = (read(TIMER_ALARM1), read(TIMER_RAW) + 140);
        ahead.advance(ahead.now() + 1);
        let next = ahead.pico.chip_mut().read(TIMER_ALARM1, &mut ());
        match next {
            next if next == alarm => {}
            next if next < soon => break ahead.now(),
            _ => mailbox = ahead.clone(),
        }
    };
    mailbox.advance(set - 100);
    while mailbox.now() < set + 20 {
        let mut tried = mailbox.clone();
        tried.interrupt();
        tried.advance(tried.now() + 5 * MS);
        assert_eq!(tried.interrupts(), 1);
        assert!(tried.motor(0).2, "{} ticks before the alarm was set", set.cast_signed() - mailbox.now().cast_signed());
        mailbox.advance(mailbox.now() + 1);
    }
}
