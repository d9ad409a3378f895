//! Random sequences of transfers on eight channels, four of them between memory and state machines, compared with a
//! second model of the datasheet (§2.5) that executes cycle by cycle and counts credit as the requests come (§2.5.3.2).
//! The chip's schedule of who may issue when must not be visible.

use crate::pico::slow::{Model, Slow};
use crate::pico::{Bench, CLR, Machine, SET};
use crate::random::Random;

const DMA: u32 = 0x5000_0000;
const RAM: u32 = 0x2000_0000;
/// Bytes of RAM that channels read and write.
const AREA: u32 = 0x2000;
const CHANNELS: usize = 8;

const EN: u32 = 1;
const HIGH: u32 = 2;
const INCR_READ: u32 = 1 << 4;
const INCR_WRITE: u32 = 1 << 5;
const QUIET: u32 = 1 << 21;

/// What paces a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// Room in the TX FIFO of a machine.
    Tx(usize),
    /// Words in its RX FIFO.
    Rx(usize),
    /// X/Y of a pulse a cycle, since a cycle.
    Timer {
        x: u64,
        y: u64,
        since: u64,
    },
    Always,
}

#[derive(Clone, Debug)]
struct Channel {
    read: u32,
    write: u32,
    count: u32,
    reload: u32,
    ctrl: u32,
    pace: Pace,
    busy: bool,
    to_issue: u32,
    reading: u32,
    writing: u32,
    aborting: bool,
    /// Transfers that may be issued, and when more of them become known.
    credit: u32,
    coming: Vec<u64>,
    started: u64,
}

/// A transfer: channel, from, to, when it was issued, the word, whether it is the last.
type Transfer = (usize, u32, u32, u64, u32, bool);

struct Slowly {
    pio: Model,
    channels: Vec<Channel>,
    memory: Vec<u32>,
    under_way: Vec<Transfer>,
    intr: u32,
    last_low: usize,
    /// High channels that still have their turn in this round.
    turn: Vec<usize>,
    /// By machine: the cycles in which it took a word out of its TX FIFO, or put one into its RX FIFO.
    moved: [Vec<u64>; 4],
}

impl Slowly {
    fn cycle(&mut self, now: u64) {
        let level = |m: &Slow| (m.tx.len(), m.rx.len());
        let before: Vec<_> = self.pio.machines.iter().map(level).collect();
        self.pio.cycle(now);
        for (number, before) in before.into_iter().enumerate() {
            if level(&self.pio.machines[number]) != before {
                self.moved[number].push(now);
                for channel in &mut self.channels {
                    if matches!(channel.pace, Pace::Tx(of) | Pace::Rx(of) if of == number) && channel.busy {
                        channel.coming.push(now + 2);
                    }
                }
            }
        }
        for at in 0..self.under_way.len() {
            let (channel, from, _, issued, ..) = self.under_way[at];
            if issued + 1 == now {
                self.under_way[at].4 = match self.channels[channel].pace {
                    Pace::Rx(machine) => self.pio.machines[machine].rx.remove(0),
                    _ => self.memory[((from - RAM) / 4) as usize],
                };
                self.channels[channel].reading -= 1;
            }
        }
        if self.under_way.first().is_some_and(|transfer| transfer.3 + 3 == now) {
            self.complete(now);
        }
        if self.under_way.len() < 4 {
            self.issue(now);
        }
    }

    fn complete(&mut self, now: u64) {
        let (number, _, to, _, word, last) = self.under_way.remove(0);
        match self.channels[number].pace {
            Pace::Tx(machine) => self.pio.machines[machine].tx.push(word),
            _ => self.memory[((to - RAM) / 4) as usize] = word,
        }
        let channel = &mut self.channels[number];
        channel.count -= 1;
        channel.writing -= 1;
        if channel.aborting {
            if channel.writing == 0 {
                (channel.aborting, channel.busy) = (false, false);
                self.intr |= 1 << number;
            }
        } else if last {
            channel.busy = false;
            if channel.ctrl & QUIET == 0 {
                self.intr |= 1 << number;
            }
            let chain = (channel.ctrl >> 11 & 15) as usize;
            if chain != number {
                self.trigger(chain, now);
            }
        }
    }

    /// Starts a channel, which may issue from `now` on.
    fn trigger(&mut self, number: usize, now: u64) {
        let channel = &mut self.channels[number];
        if channel.busy || channel.ctrl & EN == 0 {
            return;
        }
        (channel.busy, channel.count, channel.to_issue) = (true, channel.reload, channel.reload);
        channel.coming.clear();
        channel.credit = 0;
        if let Pace::Tx(machine) | Pace::Rx(machine) = channel.pace {
            let m = &self.pio.machines[machine];
            let there = if matches!(channel.pace, Pace::Tx(_)) { m.tx_depth - m.tx.len() } else { m.rx.len() };
            channel.coming = self.moved[machine].iter().map(|at| at + 2).filter(|at| *at > now).collect();
            channel.credit = there.saturating_sub(channel.coming.len()) as u32;
        }
        channel.started = now;
    }

    fn issue(&mut self, now: u64) {
        let mut ready = Vec::new();
        for (number, channel) in self.channels.iter_mut().enumerate() {
            let known = channel.coming.iter().filter(|at| **at <= now).count();
            channel.coming.drain(..known);
            channel.credit += known as u32;
            if let Pace::Timer { x, y, since } = channel.pace
                // What came before the start does not count.
                && channel.busy
                && now > channel.started
                && (now - since) * x / y > (now - 1 - since) * x / y
            {
                channel.credit += 1;
            }
            if channel.busy
                && channel.ctrl & EN != 0
                && channel.to_issue > 0
                && (channel.credit > 0 || channel.pace == Pace::Always)
            {
                ready.push(number);
            }
        }
        if ready.is_empty() {
            return;
        }
        let is_high = |number: &&usize| self.channels[**number].ctrl & HIGH != 0;
        let high: Vec<usize> = ready.iter().filter(is_high).copied().collect();
        let low: Vec<usize> = ready.iter().filter(|number| !is_high(number)).copied().collect();
        if low.is_empty() && !high.iter().any(|number| self.turn.contains(number)) {
            self.turn = high.clone();
        }
        let number = match high.iter().find(|number| self.turn.contains(number)) {
            Some(number) => {
                self.turn.retain(|other| other != number);
                *number
            }
            None => {
                let next = *low.iter().find(|number| **number > self.last_low).unwrap_or(&low[0]);
                (self.last_low, self.turn) = (next, (0..12).collect());
                next
            }
        };
        let channel = &mut self.channels[number];
        channel.to_issue -= 1;
        channel.credit = channel.credit.saturating_sub(1);
        channel.reading += 1;
        channel.writing += 1;
        self.under_way.push((number, channel.read, channel.write, now, 0, channel.to_issue == 0));
        let ring = channel.ctrl >> 6 & 15;
        let wrap = |address: u32, here: bool| {
            if here && ring != 0 {
                address & !((1 << ring) - 1) | (address + 4) & ((1 << ring) - 1)
            } else {
                address + 4
            }
        };
        let ring_writes = channel.ctrl >> 10 & 1 != 0;
        if channel.ctrl & INCR_READ != 0 {
            channel.read = wrap(channel.read, !ring_writes);
        }
        if channel.ctrl & INCR_WRITE != 0 {
            channel.write = wrap(channel.write, ring_writes);
        }
    }
}

struct Case {
    random: Random,
    bench: Bench,
    slowly: Slowly,
    now: u64,
}

impl Case {
    fn new(seed: u64) -> Case {
        let mut random = Random::new(seed);
        let mut bench = Bench::new();
        let memory: Vec<u32> = (0..AREA / 4).map(|_| random.next()).collect();
        for (at, word) in (0..).zip(&memory) {
            bench.poke(RAM + 4 * at, *word);
        }
        let mut slow_memory = [0; 32];
        let mut machines = Vec::new();
        for number in 0..4u32 {
            // Two take words, two make them: out null, 32 and in x, 32, with delays, each on itself.
            let word = if number < 2 { 0x6060 } else { 0x4020 } | random.below(32) << 8;
            let machine = Machine::new(0, number);
            slow_memory[number as usize] = word as u16;
            bench.set(0x5020_0048 + 4 * number, word);
            let join = if random.one_in(2) { [1 << 30, 1 << 31][usize::from(number > 1)] } else { 0 };
            let shiftctrl = join | 3 << 18 | 1 << 17 | 1 << 16;
            let clkdiv = [1 << 16, 3 << 15, 5 << 14][random.below(3) as usize];
            bench.set(machine.shiftctrl(), shiftctrl);
            bench.set(machine.execctrl(), number << 12 | number << 7);
            bench.set(machine.clkdiv(), clkdiv);
            machine.force(&mut bench, number);
            machines.push(Slow {
                number,
                enabled: true,
                pc: number,
                x: 0,
                y: 0,
                osr: 0,
                isr: 0,
                osr_count: 32,
                isr_count: 0,
                delay: 0,
                latched: None,
                raised: false,
                tx: Vec::new(),
                rx: Vec::new(),
                tx_depth: if join == 1 << 30 { 8 } else { 4 },
                rx_depth: if join == 1 << 31 { 8 } else { 4 },
                execctrl: number << 12 | number << 7,
                shiftctrl,
                pinctrl: 5 << 26,
                divider_256: u64::from(clkdiv >> 8),
                tick_256: 0,
            });
        }
        let since = bench.now() + 1;
        let (x, y) = (1 + random.below(9), 10 + random.below(40));
        bench.set(DMA + 0x420, x << 16 | y);
        let channels =
            (0..CHANNELS).map(|number| Case::channel(&mut random, &mut bench, number, (x, y, since))).collect();
        // All begin here.
        bench.set(0x5020_0000, 0xf << 8 | 0xf);
        let now = bench.now() + 1;
        bench.run(1);
        for machine in &mut machines {
            machine.tick_256 = now << 8;
        }
        let pio = Model {
            machines,
            memory: slow_memory,
            irq: 0,
            out: 0,
            directions: 0,
            world: 0,
            bypass: 0,
            fdebug: 0,
            pads: [0; 3],
            set_flags: 0,
            clear_flags: 0,
            edges: Vec::new(),
        };
        let slowly = Slowly {
            pio,
            channels,
            memory,
            under_way: Vec::new(),
            intr: 0,
            last_low: 11,
            turn: Vec::new(),
            moved: Default::default(),
        };
        Case { random, bench, slowly, now }
    }

    fn channel(random: &mut Random, bench: &mut Bench, number: usize, (x, y, since): (u32, u32, u64)) -> Channel {
        let place = |random: &mut Random| RAM + random.below(AREA / 8) * 4;
        let (pace, request) = match number {
            0 | 1 => (Pace::Tx(number), number as u32),
            2 | 3 => (Pace::Rx(number), number as u32 + 4),
            4 | 5 => (Pace::Timer { x: x.into(), y: y.into(), since }, 0x3b),
            _ => (Pace::Always, 0x3f),
        };
        let ring = if random.one_in(2) { random.below(6) << 6 | random.below(2) << 10 } else { 0 };
        let read = if let Pace::Rx(machine) = pace { Machine::new(0, machine as u32).rxf() } else { place(random) };
        let write = if let Pace::Tx(machine) = pace { Machine::new(0, machine as u32).txf() } else { place(random) };
        let increments = match pace {
            Pace::Tx(_) => INCR_READ,
            Pace::Rx(_) => INCR_WRITE,
            _ => random.below(4) << 4,
        };
        let chain = if random.one_in(2) { number as u32 } else { random.below(CHANNELS as u32) };
        let ctrl = EN
            | 2 << 2
            | increments
            | ring
            | chain << 11
            | request << 15
            | if random.one_in(4) { HIGH } else { 0 }
            | if random.one_in(4) { QUIET } else { 0 };
        // Within the area, whatever it adds up to.
        let reload = 1 + random.below(40);
        let base = DMA + 0x40 * number as u32;
        for (offset, value) in [(0, read), (4, write), (8, reload), (0x10, ctrl)] {
            bench.set(base + offset, value);
        }
        Channel {
            read,
            write,
            count: 0,
            reload,
            ctrl,
            pace,
            busy: false,
            to_issue: 0,
            reading: 0,
            writing: 0,
            aborting: false,
            credit: 0,
            coming: Vec::new(),
            started: 0,
        }
    }

    fn run(&mut self, cycles: u64) {
        self.bench.run(cycles);
        for _ in 0..cycles {
            self.slowly.cycle(self.now);
            self.now += 1;
        }
    }

    /// A register is written in this cycle, after everything else in it.
    fn disturb(&mut self) {
        self.slowly.cycle(self.now);
        self.now += 1;
        // No further than a sequence from the end: addresses are set back while nothing is under way there.
        for number in 0..CHANNELS {
            self.set_back(number);
        }
        let (what, word) = (self.random.below(12), self.random.next());
        let number = (word % 8) as usize;
        let slowly = &mut self.slowly;
        match what {
            0..=6 => {
                let which = word >> 8 & word >> 16 & 0xff;
                self.bench.set(DMA + 0x430, which);
                for channel in (0..CHANNELS).filter(|channel| which >> channel & 1 != 0) {
                    slowly.trigger(channel, self.now);
                }
            }
            7 | 8 => {
                let alias = if word >> 8 & 1 != 0 { SET } else { CLR };
                self.bench.set(DMA + 0x40 * number as u32 + 0x10 + alias, EN);
                let ctrl = &mut slowly.channels[number].ctrl;
                *ctrl = if alias == SET { *ctrl | EN } else { *ctrl & !EN };
            }
            9 => {
                self.bench.set(DMA + 0x444, 1 << number);
                let channel = &mut slowly.channels[number];
                if channel.busy {
                    channel.to_issue = 0;
                    channel.aborting = channel.writing > 0;
                    channel.busy = channel.aborting;
                }
            }
            _ => {
                let enables = (word | word >> 8) & 0xf;
                self.bench.set(0x5020_0000, enables);
                for (machine, slow) in slowly.pio.machines.iter_mut().enumerate() {
                    slow.enabled = enables >> machine & 1 != 0;
                }
            }
        }
        self.bench.run(1);
    }

    fn set_back(&mut self, number: usize) {
        let channel = &mut self.slowly.channels[number];
        let far = |address: u32| (RAM + AREA * 3 / 4..RAM + AREA).contains(&address);
        if !channel.busy && channel.writing == 0 {
            let base = DMA + 0x40 * number as u32;
            if far(channel.read) {
                channel.read = RAM + 64 * number as u32;
                self.bench.set(base, channel.read);
            }
            if far(channel.write) {
                channel.write = RAM + 128 * number as u32;
                self.bench.set(base + 4, channel.write);
            }
        }
    }

    fn compare(&mut self, place: &str) {
        let (bench, slowly) = (&mut self.bench, &self.slowly);
        for (number, channel) in slowly.channels.iter().enumerate() {
            let base = DMA + 0x40 * number as u32;
            let found = [0, 4, 8, 0x10].map(|offset| bench.get(base + offset));
            let expected = [
                channel.read - 4 * channel.reading,
                channel.write - 4 * channel.writing,
                channel.count,
                channel.ctrl | u32::from(channel.busy) << 24,
            ];
            assert_eq!(found, expected, "{place}: channel {number}, {:?}", channel.pace);
        }
        assert_eq!(bench.get(DMA + 0x400), slowly.intr, "{place}: INTR");
        assert_eq!(bench.get(0x5020_0008), slowly.pio.fdebug, "{place}: FDEBUG");
        for (number, slow) in (0..).zip(&slowly.pio.machines) {
            let levels = Machine::new(0, number).levels(bench);
            assert_eq!(levels, (slow.tx.len() as u32, slow.rx.len() as u32), "{place}: FIFOs of machine {number}");
        }
        for (at, word) in (0..).zip(&slowly.memory) {
            assert_eq!(bench.chip.peek(RAM + 4 * at), Some(*word), "{place}: word {at}");
        }
    }
}

#[test]
fn random_transfers() {
    let mut moved = 0;
    for seed in 1..=300 {
        let mut case = Case::new(seed);
        for round in 0..60 {
            let place = format!("case {seed}, round {round}, cycle {}", case.now);
            let cycles = [1u64, 2, 3, 7, 40, 200][case.random.below(6) as usize];
            case.run(cycles);
            case.disturb();
            if case.random.one_in(5) {
                case.compare(&place);
            }
        }
        case.compare(&format!("case {seed}, its end"));
        moved += case.slowly.moved.iter().map(Vec::len).sum::<usize>();
    }
    assert!(moved > 20_000, "machines that hardly move: {moved} words");
}
