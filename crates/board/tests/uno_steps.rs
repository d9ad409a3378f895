//! The firmware's step path under load, on the emulated chip: every edge against the recurrence, and what it costs.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board, Edge, Observer, Remote, ScheduledStep, Setup};
use pulsetrain_core::packing::{Packing, State};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Direction, Entry, Epoch, Item, Moment, Recurrence, Segment};
use std::collections::VecDeque;

const TICK_HZ: f64 = 16e6;

/// A small generator of random numbers: xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn fraction(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// What a motor is to do.
#[derive(Clone, Copy)]
struct Law {
    /// Steps per second, on the whole.
    rate: f64,
    /// The interval changes by so much of itself, either way, from segment to segment.
    swing: f64,
    /// One segment in so many turns around; 0: none.
    turns: u64,
}

/// Endless random segments and the ticks that they mean.
struct Source {
    law: Law,
    random: Random,
    packing: Packing,
    state: State,
    recurrence: Recurrence,
    direction: Direction,
    interval: f64,
    due: VecDeque<u64>,
    ahead: Option<Item>,
}

impl Source {
    fn new(law: Law, seed: u64, start: u64, gain: i8) -> Source {
        Source {
            law,
            random: Random(seed),
            packing: Packing { fraction_bits: 16, gain },
            state: State::default(),
            recurrence: Recurrence { accumulator: start << 16 | 1 << 15, interval: 0, add: 0, add2: 0 },
            direction: Direction::Forward,
            interval: TICK_HZ / law.rate,
            due: VecDeque::new(),
            ahead: None,
        }
    }

    /// The next item, and its ticks into `due`.
    fn item(&mut self) -> Item {
        if let Some(item) = self.ahead.take() {
            return item;
        }
        let count = 40 + (self.random.next() % 41) as u32;
        let steady = TICK_HZ / self.law.rate;
        let goal = steady * (1.0 + self.law.swing * (2.0 * self.random.fraction() - 1.0));
        let turn = self.law.turns != 0 && self.random.next().is_multiple_of(self.law.turns);
        if turn {
            self.direction = self.direction.reversed();
            self.state = State::new(self.direction);
            // Room for the driver's set-up.
            self.interval = self.interval.max(400.0);
        }
        let n = f64::from(count);
        let add = 1.3 * (goal - self.interval) / n;
        let add2 = -2.0 * (add * n - (goal - self.interval)) / (n * n);
        let units = self.packing.units(self.state.previous_count);
        let near = |wanted: f64, predicted: i64, unit: i64| {
            predicted + ((wanted * 65536.0 - predicted as f64) / unit as f64).round() as i64 * unit
        };
        let segment = Segment {
            count,
            interval: near(self.interval, self.state.interval, units[0]),
            add: near(add, self.state.add, units[1]),
            add2: near(add2, self.state.add2, units[2]),
        };
        let item = Item::Run { segment, direction: self.direction };
        let mut bytes = [0; 64];
        self.packing.pack(&mut self.state, &item, &mut bytes).unwrap();
        self.recurrence.load(&segment);
        for _ in 0..count {
            self.recurrence.advance();
            self.due.push_back(self.recurrence.accumulator >> 16);
        }
        self.interval = self.recurrence.interval as f64 / 65536.0;
        item
    }
}

/// Takes edges.
#[derive(Default)]
struct Edges(Vec<Edge>);

impl Observer for Edges {
    fn edge(&mut self, edge: Edge) {
        self.0.push(edge);
    }
    fn step(&mut self, _step: ScheduledStep) {}
}

/// What came of it.
#[derive(Debug)]
#[expect(dead_code, reason = "printed")]
struct Report {
    steps: usize,
    /// Edge less scheduled tick: the most frequent one.
    constant: i64,
    early: i64,
    median: i64,
    p99: i64,
    late: i64,
    bytes_a_step: f64,
    shortest_pulse: u64,
}

/// Streams `laws` to motors on `pins` (STEP, DIR) for `seconds`, and holds every edge against its tick.
fn run(pins: &[(u8, u8)], laws: &[Law], apart: f64, pulse: u16, seconds: f64) -> Result<Report, String> {
    let mut board = Remote::open(VirtualUno::new(), 7).map_err(|error| format!("open: {error}"))?;
    board.set_baud(Baud::B1M).map_err(|error| format!("baud: {error}"))?;
    let motors = pins.iter().map(|&(step_pin, dir_pin)| MotorSetup {
        step_pin,
        dir_pin,
        forward_high: true,
        step_low: false,
        gain: 0,
        pull_in_ticks: 16_000,
    });
    let setup =
        Setup { pulse_ticks: pulse, setup_ticks: 80, hold_ticks: 32, motors: motors.collect(), ..Setup::default() };
    board.configure(&setup).map_err(|error| format!("configure: {error}"))?;

    let begin = board.now() + board.lead() + 1_600_000;
    let mut sources: Vec<_> = laws
        .iter()
        .enumerate()
        .map(|(index, law)| {
            let offset = (apart * TICK_HZ / law.rate * index as f64 / laws.len() as f64) as u64;
            Source::new(*law, 1 + index as u64 * 977, begin + 8_000 + offset, 0)
        })
        .collect();
    let mut edges = Edges::default();
    let epoch = Epoch(1);
    let mut packed = 0;
    for (index, source) in sources.iter().enumerate() {
        let tick = Moment::of(source.recurrence.accumulator >> 16);
        board
            .push(index, Entry { epoch, item: Item::Anchor { tick } })
            .map_err(|_| "no room for an anchor".to_string())?;
    }
    let until = begin + (seconds * TICK_HZ) as u64;
    let mut switched = false;
    loop {
        // The motor with the least to do first.
        for _ in 0..64 {
            let mut any = false;
            for (index, source) in sources.iter_mut().enumerate() {
                let item = source.item();
                let room = board.room(index);
                match board.push(index, Entry { epoch, item }) {
                    Ok(()) => {
                        packed += room.saturating_sub(board.room(index));
                        any = true;
                    }
                    Err(entry) => source.ahead = Some(entry.item),
                }
            }
            if !any {
                break;
            }
        }
        if !switched && board.now() + 3 * board.lead() / 2 > begin {
            board.switch(epoch, begin).map_err(|refused| format!("switch: {refused:?}"))?;
            switched = true;
        }
        if board.now() > until {
            break;
        }
        let step = board.now() + 8_000;
        board.advance(step, &mut edges);
        let events = board.events();
        if let Some(event) = events.first() {
            return Err(format!("event at {:.4} s: {event:?}", (event.tick as f64 - begin as f64) / TICK_HZ));
        }
        if let Some(error) = board.error() {
            return Err(format!("link: {error} at {:.4} s; {events:?}", (board.now() as f64 - begin as f64) / TICK_HZ));
        }
    }
    let mut differences = Vec::new();
    let mut shortest_pulse = u64::MAX;
    for (index, source) in sources.iter().enumerate() {
        let line = pins[index].0;
        let mine: Vec<_> = edges.0.iter().filter(|edge| edge.line == line && edge.tick >= begin).collect();
        let rising: Vec<_> = mine.iter().filter(|edge| edge.level).collect();
        for pair in mine.windows(2) {
            if pair[0].level {
                shortest_pulse = shortest_pulse.min(pair[1].tick - pair[0].tick);
            }
        }
        for (number, (edge, due)) in rising.iter().zip(&source.due).enumerate() {
            let difference = edge.tick as i64 - *due as i64;
            if difference.abs() > 2000 {
                return Err(format!("motor {index}, step {number}: {difference} ticks off at {}", edge.tick - begin));
            }
            differences.push(difference);
        }
        let expected = source.due.iter().filter(|due| **due + 16_000 < board.now().min(until)).count();
        if rising.len() < expected {
            return Err(format!("motor {index}: {} steps, {expected} expected", rising.len()));
        }
    }
    differences.sort_unstable();
    let steps = differences.len();
    let constant = differences[steps / 2];
    let at = |part: f64| differences[((steps - 1) as f64 * part) as usize] - constant;
    Ok(Report {
        steps,
        constant,
        early: at(0.0),
        median: at(0.5),
        p99: at(0.99),
        late: at(1.0),
        bytes_a_step: packed as f64 / steps as f64,
        shortest_pulse,
    })
}

/// Every edge is made, at most so many ticks early and late, 99 of 100 within `p99`; pulses last as they should.
fn check(pins: &[(u8, u8)], law: Law, early: i64, p99: i64, late: i64) {
    let report = run(pins, &vec![law; pins.len()], 1.0, 16, 0.15).unwrap();
    println!("{} motors, {} steps/s each: {report:?}", pins.len(), law.rate);
    assert!(report.early >= early && report.late <= late && report.p99 <= p99, "{report:?}");
    assert!(report.shortest_pulse >= 16, "{report:?}");
}

const PORT_D: [(u8, u8); 1] = [(2, 5)];

const fn changing(rate: f64) -> Law {
    Law { rate, swing: 0.1, turns: 0 }
}

#[test]
fn one_motor() {
    check(&PORT_D, changing(2e3), -1, 40, 60);
    check(&PORT_D, changing(20e3), -1, 40, 60);
}

#[test]
fn the_compare_hardware_is_never_late() {
    check(&[(9, 8)], changing(20e3), 0, 0, 0);
    check(&[(9, 8), (10, 7)], changing(20e3), 0, 0, 0);
}
