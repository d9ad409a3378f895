//! A line with faults: any port, with frames that get lost, change, come late or twice, by a seed.

use crate::Random;
use pulsetrain_board::{Edge, Port, PortError};
use pulsetrain_core::wire::Baud;
use std::collections::VecDeque;
use std::time::Duration;

/// How often what happens to a frame, in either direction; all of it in a thousand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rates {
    /// It does not arrive.
    pub drop: u16,
    /// One to three of its bits change.
    pub flip: u16,
    /// It comes up to 5 ms late; what comes after it may overtake it.
    pub delay: u16,
    /// It comes twice.
    pub duplicate: u16,
}

/// A port whose frames suffer.
#[derive(Debug)]
pub struct Faulty<P> {
    port: P,
    rates: Rates,
    /// Until then nothing passes.
    dead_until: Duration,
    is_mute: bool,
    random: Random,
    to_board: Direction,
    to_host: Direction,
}

/// One way of the line.
#[derive(Debug, Default)]
struct Direction {
    /// The frame that is not whole yet.
    begun: Vec<u8>,
    /// Frames that are to pass, and when.
    held: VecDeque<(Duration, Vec<u8>)>,
}

impl<P: Port> Faulty<P> {
    /// A port without faults so far; `seed` makes them repeat.
    #[must_use]
    pub fn new(port: P, seed: u64) -> Faulty<P> {
        let rates = Rates::default();
        let (to_board, to_host) = (Direction::default(), Direction::default());
        Faulty { port, rates, dead_until: Duration::ZERO, is_mute: false, random: Random::new(seed), to_board, to_host }
    }

    /// From now on frames suffer so often.
    pub const fn set(&mut self, rates: Rates) {
        self.rates = rates;
    }

    /// From now on nothing passes for so long.
    pub fn cut(&mut self, duration: Duration) {
        self.dead_until = self.port.now() + duration;
    }

    /// From now on nothing comes to the host.
    pub const fn mute(&mut self) {
        self.is_mute = true;
    }

    /// The port behind the faults.
    pub const fn inner(&self) -> &P {
        &self.port
    }

    /// The port behind the faults.
    pub const fn inner_mut(&mut self) -> &mut P {
        &mut self.port
    }

    /// Sends what waited long enough.
    fn pass_on(&mut self) -> Result<(), PortError> {
        let due = self.to_board.due(self.port.now());
        self.port.send(&due)
    }
}

impl Direction {
    fn take(&mut self, bytes: &[u8], now: Duration, dead: bool, rates: Rates, random: &mut Random) {
        for byte in bytes {
            self.begun.push(*byte);
            if *byte != 0 {
                continue;
            }
            let mut frame = std::mem::take(&mut self.begun);
            if random.per_mille(rates.drop) || dead {
                continue;
            }
            if random.per_mille(rates.flip) {
                for _ in 0..=random.below(3) {
                    let bit = random.below(8 * frame.len() as u64);
                    frame[(bit / 8) as usize] ^= 1 << (bit % 8);
                }
            }
            let late = if random.per_mille(rates.delay) { random.below(5000) } else { 0 };
            let at = now + Duration::from_micros(late);
            if random.per_mille(rates.duplicate) {
                self.held.push_back((at, frame.clone()));
            }
            self.held.push_back((at, frame));
        }
    }

    fn due(&mut self, now: Duration) -> Vec<u8> {
        let (due, held) = std::mem::take(&mut self.held).into_iter().partition(|(at, _)| *at <= now);
        self.held = held;
        VecDeque::into_iter(due).flat_map(|(_, frame)| frame).collect()
    }

    fn next(&self) -> Option<Duration> {
        self.held.iter().map(|(at, _)| *at).min()
    }
}

impl<P: Port> Port for Faulty<P> {
    fn now(&self) -> Duration {
        self.port.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        let now = self.port.now();
        self.to_board.take(bytes, now, now < self.dead_until, self.rates, &mut self.random);
        self.pass_on()
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let before = into.len();
        loop {
            let next = [self.to_board.next(), self.to_host.next()].into_iter().flatten().min();
            let mut bytes = Vec::new();
            self.port.receive(next.map_or(until, |next| next.min(until)), &mut bytes)?;
            let now = self.port.now();
            self.to_host.take(&bytes, now, self.is_mute || now < self.dead_until, self.rates, &mut self.random);
            into.extend(self.to_host.due(now));
            self.pass_on()?;
            if into.len() > before || now >= until {
                return Ok(());
            }
        }
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.port.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.port.edges(into);
    }
}
