//! The delay of verbs: from a SPEED or a DIRECTION on the line to the pin, on the virtual Pico, and to the tick from which it holds, on the virtual Uno.

use super::lab::verb_limits;
use super::pico::{TICK_HZ, step_dir};
use super::{Random, uno_setup};
use pulsetrain_board::bridge::Bridge;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Remote, Setup, VirtualBoard};
use pulsetrain_core::verbs::{Heading, Verb};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::orders::Obeyed;

/// The longest delays that were found.
#[derive(Clone, Copy, Debug, Default)]
pub struct Delay {
    /// Steps that came after the order was on the line, the first new one included.
    pub steps: u64,
    /// From the order on the line to the first new step, µs.
    pub us: f64,
    /// From the order on the line to the tick from which it holds, µs.
    pub held_us: f64,
}

impl Delay {
    /// Whether the requirement is met: six steps or 2 ms, whichever is longer.
    pub fn is_kept(&self) -> bool {
        self.steps <= 6 || self.us <= 2000.0
    }
}

/// Bytes on the line of a frame with one order.
const FRAME: u64 = 17;

/// Sends an order while no other command waits for its answer. Returns the tick at which its last byte is on the line, and the board's answer.
pub fn tell(pico: &mut Remote<VirtualPico>, order: &[(u8, Verb); 1]) -> (u64, Obeyed) {
    pico.status().expect("it answers");
    // The adapter gets the frame with the next millisecond, and then sends it at 2 Mbaud.
    let frame = TICK_HZ / 1000;
    let sent = ((pico.port().chip().cycle() - pico.port().zero()) / frame + 1) * frame + FRAME * 625;
    (sent, pico.tell_motors(order).expect("it can"))
}

/// The time from `sent` to `tick`, µs.
pub fn us(tick: u64, sent: u64) -> f64 {
    tick.saturating_sub(sent) as f64 * 1e6 / TICK_HZ as f64
}

/// Gives a motor at `rate` steps/s another speed, or the other direction if `turns`, and does so `times` times.
pub fn delay(rate: u64, turns: bool, times: u32) -> Delay {
    let random = &mut Random::new(rate);
    let mut pico = Remote::open(VirtualPico::new(), 1).expect("it answers");
    assert_eq!(pico.set_baud(Baud::B2M), Ok(Baud::B2M));
    let motors = vec![step_dir(2)];
    pico.configure(&Setup { pulse_ticks: 250, setup_ticks: 625, hold_ticks: 250, motors, ..Setup::default() })
        .expect("it can");
    let (slow, fast) = (TICK_HZ / rate, TICK_HZ / rate * 9 / 10);
    pico.tell_motors(&[(0, Verb::Speed { ticks: slow }), (0, Verb::Run)]).expect("it can");
    let mut worst = Delay::default();
    for time in 1..=times {
        let forward = time % 2 == 0;
        let wait = 3 * slow + random.below(TICK_HZ / 200);
        pico.advance(pico.now() + wait, &mut |_: Edge| {});
        let verb = match (turns, forward) {
            (true, true) => Verb::Heading(Heading::Forward),
            (true, false) => Verb::Heading(Heading::Backward),
            (false, true) => Verb::Speed { ticks: slow },
            (false, false) => Verb::Speed { ticks: fast },
        };
        let (sent, obeyed) = tell(&mut pico, &[(0, verb)]);
        let mut edges = Vec::new();
        // The board's clock is known to some 30 µs: 200 µs more, so that all the steps are made.
        pico.advance(obeyed.tick + 3 * slow + TICK_HZ / 5000, &mut |edge: Edge| edges.push(edge));
        let rises: Vec<_> = edges.iter().filter(|edge| edge.line == 2 && edge.level).map(|edge| edge.tick).collect();
        let new = if turns {
            let dir = edges.iter().find(|edge| edge.line == 3).expect("it turns").tick;
            rises.iter().position(|tick| *tick > dir)
        } else {
            // The first step that the order has changed is the one that is not where the old speed would have it.
            let old = if forward { fast } else { slow };
            rises.windows(2).position(|pair| pair[1] - pair[0] != old).map(|place| place + 1)
        };
        let new = new.expect("it shows");
        let since = rises.iter().filter(|tick| (sent..=rises[new]).contains(tick)).count() as u64;
        worst.steps = worst.steps.max(since);
        worst.us = worst.us.max(us(rises[new], sent));
        worst.held_us = worst.held_us.max(us(obeyed.tick, sent));
    }
    worst
}

/// The longest time from a host's call to the tick from which its order holds, ticks: on an Uno over USB at 1 Mbaud, with all motors on `pins` running at
/// `slower` times their shortest period, and an order to all of them. No frame may be sent twice meanwhile.
pub fn uno_held_ticks(pins: &[(u8, u8)], slower: u64, bridge: Bridge) -> u64 {
    let setup = uno_setup(pins, 16);
    let mut uno = VirtualUno::with_verbs();
    assert!(uno.set_bridge(bridge));
    let mut uno = Remote::open(uno, 1).expect("it answers");
    assert_eq!(uno.set_baud(Baud::B1M), Ok(Baud::B1M));
    uno.configure(&setup).expect("it can");
    let tell = |uno: &mut Remote<VirtualUno>, verb| {
        let orders: Vec<_> = (0..pins.len() as u8).map(|motor| (motor, verb)).collect();
        uno.tell_motors(&orders).expect("it can").tick
    };
    let period = u64::from(verb_limits(&setup).shortest) * slower;
    tell(&mut uno, Verb::Speed { ticks: period });
    tell(&mut uno, Verb::Run);
    let before = uno.link().counts().repeated;
    let rounds = 0..20_u64;
    let held = rounds.map(|round| {
        uno.advance(uno.now() + 30_000 + 997 * round, &mut |_: Edge| {});
        let said = uno.now();
        tell(&mut uno, Verb::Speed { ticks: period + 100 * (round % 3) }) - said
    });
    let held = held.max().unwrap_or(0);
    assert_eq!(uno.link().counts().repeated, before, "{bridge:?}");
    held
}
