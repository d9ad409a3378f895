//! A line with faults: any port, with frames that are lost, damaged, late or doubled, at random from a seed.

use crate::Random;
use pulsetrain_board::{Edge, Port, PortError};
use pulsetrain_core::wire::Baud;
use std::collections::VecDeque;
use std::time::Duration;

/// How often each fault happens to a frame in either direction, per mille.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rates {
    /// The frame does not arrive.
    pub drop: u16,
    /// One to three bits of the frame change.
    pub flip: u16,
    /// The frame comes up to 5 ms late; later frames may overtake it.
    pub delay: u16,
    /// The frame comes twice.
    pub duplicate: u16,
}

/// A port with faults.
#[derive(Debug)]
pub struct Faulty<P> {
    port: P,
    rates: Rates,
    /// Until this time no frame arrives.
    dead_until: Duration,
    /// Whether no frame arrives at the host.
    is_mute: bool,
    random: Random,
    to_board: Direction,
    to_host: Direction,
}

/// One direction of the line.
#[derive(Debug, Default)]
struct Direction {
    /// The beginning of a frame that is not complete yet.
    begun: Vec<u8>,
    /// Frames on their way, and when each arrives.
    on_the_way: VecDeque<(Duration, Vec<u8>)>,
}

impl<P: Port> Faulty<P> {
    /// A port that has no faults yet. The faults depend on `seed`, so that a test can be repeated.
    #[must_use]
    pub fn new(port: P, seed: u64) -> Faulty<P> {
        let rates = Rates::default();
        let (to_board, to_host) = (Direction::default(), Direction::default());
        Faulty { port, rates, dead_until: Duration::ZERO, is_mute: false, random: Random::new(seed), to_board, to_host }
    }

    /// Sets how often faults happen from now on.
    pub const fn set(&mut self, rates: Rates) {
        self.rates = rates;
    }

    /// Lets no frame arrive for a time from now on.
    pub fn cut(&mut self, duration: Duration) {
        self.dead_until = self.port.now() + duration;
    }

    /// Lets no frame arrive at the host from now on.
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

    /// Sends the frames that are due.
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
                self.on_the_way.push_back((at, frame.clone()));
            }
            self.on_the_way.push_back((at, frame));
        }
    }

    fn due(&mut self, now: Duration) -> Vec<u8> {
        let (due, later) = std::mem::take(&mut self.on_the_way).into_iter().partition(|(at, _)| *at <= now);
        self.on_the_way = later;
        VecDeque::into_iter(due).flat_map(|(_, frame)| frame).collect()
    }

    fn next(&self) -> Option<Duration> {
        self.on_the_way.iter().map(|(at, _)| *at).min()
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
