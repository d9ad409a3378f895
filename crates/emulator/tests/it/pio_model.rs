//! Random programs on four machines at once, compared with a second model of the datasheet (§3.2 to §3.5) that executes
//! cycle by cycle and has no short cuts. The chip skips cycles and does work later. This must not be visible in any
//! edge or register, at whatever time a test reads, pushes, pulls, moves a pin or stops a machine.

use crate::pico::slow::{Model, PINS, Slow};
use crate::pico::{Bench, Machine};
use crate::random::Random;

/// Those that the world moves; the machines may too.
const WORLD: u32 = 0x00ff_0000;

/// An instruction: every kind, with a liking for jumps that count and for what lets programs live long.
fn instruction(random: &mut Random, at: u32) -> u16 {
    let word = random.next() & 0xffff;
    let delay = if random.one_in(3) { word & 0x1f00 } else { 0 };
    (match random.below(20) {
        // jmp x--, jmp y-- on itself, behind a short count often.
        0 => 2 << 5 | at | delay,
        1 => 4 << 5 | at | delay,
        2 => 0xe020 | word & 0x5f | delay,
        // No waits for ever: reserved sources, and jumps of the counting kind elsewhere are rarer.
        3 if word >> 5 & 3 == 3 => 0xa042,
        3 => 0x2000 | word & 0x1fff,
        // Pins by SET and MOV; X and Y by both.
        12..=14 => 0xe000 | word & 0x1f1f,
        15 | 16 => 0xa000 | word & 0x1f1f,
        17 => 0xa020 | word & 0x1f5f,
        18 => 0xe020 | word & 0x1f5f,
        4 => 0x6000 | word & 0x1fff,
        5 => 0x4000 | word & 0x1fff,
        6 => 0x8000 | word & 0x1fe0,
        7 => 0xc000 | word & 0x1f7f,
        _ => word,
    }) as u16
}

struct Case {
    random: Random,
    bench: Bench,
    model: Model,
    now: u64,
    /// What the world did: cycle and pin.
    moves: Vec<(u64, u8)>,
}

impl Case {
    fn new(seed: u64) -> Case {
        let mut random = Random::new(seed);
        let mut bench = Bench::new();
        Machine::new(0, 0).outputs(&mut bench, 0, 16);
        bench.give(16..30, 6);
        let memory: [u16; 32] = std::array::from_fn(|at| instruction(&mut random, at as u32));
        for (at, word) in memory.iter().enumerate() {
            bench.set(0x5020_0048 + 4 * at as u32, (*word).into());
        }
        let bypass = if random.one_in(3) { random.next() & PINS } else { 0 };
        bench.set(0x5020_0038, bypass);
        let mut machines = Vec::new();
        for number in 0..4 {
            machines.push(Case::machine(&mut random, &mut bench, number));
        }
        bench.run(10);
        // All dividers begin here.
        bench.set(0x5020_0000, 0xf << 8);
        let now = bench.now() + 1;
        for machine in &mut machines {
            machine.tick_256 = now << 8;
        }
        bench.run(1);
        bench.seen.edges.clear();
        let model = Model {
            machines,
            memory,
            irq: 0,
            out: 0,
            directions: 0xffff,
            world: 0,
            bypass,
            fdebug: 0,
            pads: [0; 3],
            set_flags: 0,
            clear_flags: 0,
            edges: Vec::new(),
        };
        Case { random, bench, model, now, moves: Vec::new() }
    }

    fn machine(random: &mut Random, bench: &mut Bench, number: u32) -> Slow {
        let machine = Machine::new(0, number);
        let wrap = (random.below(32), random.below(32));
        // No OUT_STICKY, no inline enable: they have tests of their own.
        let execctrl = wrap.0 << 12 | wrap.1 << 7 | random.next() & 0x7f00_001f;
        let joins = [0, 0, 1 << 30, 1 << 31][random.below(4) as usize];
        let shiftctrl = joins | random.next() & 0x3fff_0000;
        let side = random.below(4) << 29;
        let execctrl = if side == 0 { execctrl & !(1 << 30) } else { execctrl };
        let pinctrl = side | random.below(6) << 26 | random.below(9) << 20 | random.next() & 0xf_ffff;
        let clkdiv = [1 << 16, 1 << 16, 1 << 16, 3 << 15, 9 << 14, 7 << 16, 0x0001_0100][random.below(7) as usize];
        bench.set(machine.execctrl(), execctrl);
        bench.set(machine.shiftctrl(), shiftctrl);
        bench.set(machine.pinctrl(), pinctrl);
        bench.set(machine.clkdiv(), clkdiv);
        let (tx_depth, rx_depth) = match shiftctrl >> 30 {
            1 => (8, 0),
            2 => (0, 8),
            _ => (4, 4),
        };
        Slow {
            number,
            enabled: false,
            pc: 0,
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
            tx_depth,
            rx_depth,
            execctrl,
            shiftctrl,
            pinctrl,
            divider_256: u64::from(clkdiv >> 8),
            tick_256: 0,
        }
    }

    fn run(&mut self, cycles: u64) {
        self.bench.run(cycles);
        for _ in 0..cycles {
            self.model.cycle(self.now);
            self.now += 1;
        }
    }

    /// Something from outside happens in this cycle, after everything in it.
    fn disturb(&mut self) {
        let number = self.random.below(4);
        let machine = Machine::new(0, number);
        let what = self.random.below(10);
        let word = self.random.next();
        if what == 0 {
            // A pin of the world, from this cycle on.
            let pin = 16 + word % 8;
            let level = word >> 8 & 1 != 0;
            self.bench.chip.set_input(pin as u8, Some(level.into()));
            self.moves.push((self.now, pin as u8));
            self.model.world = self.model.world & !(1 << pin) | u32::from(level) << pin & WORLD;
            return;
        }
        // What was there in the beginning of the cycle.
        let front = self.model.machines[number as usize].rx.first().copied();
        self.model.cycle(self.now);
        self.now += 1;
        let slow = &mut self.model.machines[number as usize];
        match what {
            1..=4 => {
                machine.push(&mut self.bench, word);
                if slow.tx.len() < slow.tx_depth {
                    slow.tx.push(word);
                } else {
                    self.model.fdebug |= 1 << (16 + number);
                }
            }
            5 | 6 => {
                let read = self.bench.get(machine.rxf());
                assert_eq!(read, front.unwrap_or(0), "RX FIFO");
                if front.is_some() {
                    slow.rx.remove(0);
                } else {
                    self.model.fdebug |= 1 << (8 + number);
                }
            }
            7 => {
                self.bench.set(0x5020_0030, word & 0xff);
                self.model.irq &= !(word & 0xff);
            }
            8 => {
                self.bench.set(0x5020_0034, 1 << (word & 7));
                self.model.irq |= 1 << (word & 7);
            }
            _ => {
                // Enables, restarts, dividers.
                let enables = (word | word >> 8) & 0xf;
                let restarts = if word >> 16 & 3 == 0 { word >> 4 & 0xf } else { 0 };
                let clocks = if word >> 18 & 3 == 0 { word >> 20 & 0xf } else { 0 };
                self.bench.set(0x5020_0000, clocks << 8 | restarts << 4 | enables);
                for (number, slow) in self.model.machines.iter_mut().enumerate() {
                    if restarts >> number & 1 != 0 {
                        (slow.osr_count, slow.isr_count, slow.isr, slow.delay) = (32, 0, 0, 0);
                        (slow.latched, slow.raised) = (None, false);
                    }
                    if clocks >> number & 1 != 0 {
                        slow.tick_256 = self.now << 8;
                    }
                    slow.enabled = enables >> number & 1 != 0;
                }
            }
        }
        self.bench.run(1);
    }

    fn compare(&mut self, place: &str) {
        let (bench, model) = (&mut self.bench, &mut self.model);
        let chip: Vec<(u32, u32, u32)> = (0..4)
            .map(|number| {
                let machine = Machine::new(0, number);
                let levels = machine.levels(bench);
                (bench.get(machine.addr()), levels.0, levels.1)
            })
            .collect();
        let slow: Vec<(u32, u32, u32)> =
            model.machines.iter().map(|m| (m.pc, m.tx.len() as u32, m.rx.len() as u32)).collect();
        assert_eq!(chip, slow, "{place}: program counters and FIFOs");
        assert_eq!(bench.get(0x5020_0030), model.irq, "{place}: flags");
        assert_eq!(bench.get(0x5020_0008), model.fdebug, "{place}: FDEBUG");
        assert_eq!(bench.get(0x5020_003c) & PINS, model.out & PINS, "{place}: levels");
        assert_eq!(bench.get(0x5020_0040) & PINS, model.directions & PINS, "{place}: directions");
    }

    /// The scratch registers and shift registers, which ends the case: through the RX FIFO of machines that stand still.
    fn registers(&mut self, place: &str) {
        self.bench.set(0x5020_0000, 0xf << 4);
        self.model.cycle(self.now);
        self.now += 1;
        self.bench.run(3);
        for number in 0..4 {
            let machine = Machine::new(0, number);
            // Another FJOIN empties the FIFO, so that there is room.
            let joined = self.bench.get(machine.shiftctrl()) & 0x3fff_0000;
            self.bench.set(machine.shiftctrl(), 3 << 30);
            self.bench.set(machine.shiftctrl(), joined & !(3 << 16));
            let found = (machine.x(&mut self.bench), machine.y(&mut self.bench));
            let slow = &self.model.machines[number as usize];
            assert_eq!(found, (slow.x, slow.y), "{place}: X and Y of machine {number}");
        }
    }
}

#[test]
fn random_programs() {
    let mut edges = 0;
    for seed in 1..=1000 {
        let mut case = Case::new(seed);
        case.bench.set(0x5020_0000, 0xf);
        case.model.cycle(case.now);
        case.now += 1;
        case.bench.run(1);
        for machine in &mut case.model.machines {
            machine.enabled = true;
        }
        for round in 0..60 {
            let place = format!("case {seed}, round {round}, cycle {}", case.now);
            let cycles = [1u64, 2, 3, 5, 40, 300][case.random.below(6) as usize];
            case.run(cycles);
            case.disturb();
            if case.random.one_in(4) {
                case.compare(&place);
            }
        }
        case.run(100);
        case.compare(&format!("case {seed}, its end"));
        let place = format!("case {seed}, its registers");
        edges += compare_edges(&case, &place);
        case.registers(&place);
    }
    assert!(edges > 50_000, "programs that do nothing: {edges} edges");
}

/// Edges that the chip caused, against all changes of level but those of pins that the world moved in that cycle.
fn compare_edges(case: &Case, place: &str) -> usize {
    let found = &case.bench.seen.edges;
    let mut expected = Vec::new();
    let mut before = 0;
    // The last cycle's effects are seen in the present one.
    let present = (case.now, case.model.pad());
    for (cycle, level) in case.model.edges.iter().chain([&present]) {
        let mut changed = before ^ level;
        while changed != 0 {
            let gpio = changed.trailing_zeros();
            changed &= changed - 1;
            expected.push((*cycle, gpio as u8, level >> gpio & 1 != 0));
        }
        before = *level;
    }
    let by_chip = |edge: &(u64, u8, bool)| !case.moves.contains(&(edge.0, edge.1));
    let chip: Vec<_> = found.iter().map(|edge| (edge.cycle, edge.gpio, edge.level.is_high())).filter(by_chip).collect();
    expected.retain(by_chip);
    assert_eq!(chip, expected, "{place}");
    found.len()
}
