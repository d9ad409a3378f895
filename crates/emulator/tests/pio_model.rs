//! Random programs on four machines at once, against a second statement of the datasheet (§3.2 to §3.5) that does every
//! cycle one after the other and knows no shortcut. What the chip skips, or does later, must not show: neither in an
//! edge nor in a register, whenever somebody looks, pushes, pulls, moves a pin or stops a machine.

mod pico;

use pico::{Bench, Machine};

/// GPIO 0 to 29.
const PINS: u32 = 0x3fff_ffff;
/// Those that the world moves; the machines may too.
const WORLD: u32 = 0x00ff_0000;

/// A small generator: the cases are the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 16) as u32
    }

    fn below(&mut self, limit: u32) -> u32 {
        self.next() % limit
    }

    fn one_in(&mut self, times: u32) -> bool {
        self.below(times) == 0
    }
}

/// One machine, cycle by cycle.
#[derive(Clone, Debug)]
struct Slow {
    number: u32,
    enabled: bool,
    pc: u32,
    x: u32,
    y: u32,
    osr: u32,
    isr: u32,
    osr_count: u32,
    isr_count: u32,
    delay: u32,
    latched: Option<u16>,
    raised: bool,
    tx: Vec<u32>,
    rx: Vec<u32>,
    tx_depth: usize,
    rx_depth: usize,
    execctrl: u32,
    shiftctrl: u32,
    pinctrl: u32,
    divider_256: u64,
    /// The next tick, 1/256 cycle.
    tick_256: u64,
}

/// The block.
struct Model {
    machines: Vec<Slow>,
    memory: [u16; 32],
    irq: u32,
    out: u32,
    directions: u32,
    world: u32,
    bypass: u32,
    fdebug: u32,
    /// Levels of the pins in the last three cycles, the present first.
    pads: [u32; 3],
    set_flags: u32,
    clear_flags: u32,
    edges: Vec<(u64, u32)>,
}

fn bits(field: u32) -> u32 {
    if field & 31 == 0 { 32 } else { field & 31 }
}

fn mask(count: u32) -> u32 {
    if count >= 32 { u32::MAX } else { (1 << count) - 1 }
}

impl Model {
    fn pad(&self) -> u32 {
        (self.out & self.directions | self.world & !self.directions) & PINS
    }

    fn cycle(&mut self, cycle: u64) {
        let pad = self.pad();
        if pad != self.pads[0] {
            self.edges.push((cycle, pad));
        }
        self.pads = [pad, self.pads[0], self.pads[1]];
        let seen = self.pads[2] & !self.bypass | pad & self.bypass;
        for number in 0..4 {
            self.machine(number, cycle, seen);
        }
        self.irq = self.irq & !self.clear_flags | self.set_flags;
        (self.set_flags, self.clear_flags) = (0, 0);
    }

    fn machine(&mut self, number: usize, cycle: u64, seen: u32) {
        let mut m = self.machines[number].clone();
        let tick = m.tick_256 >> 8 == cycle;
        if tick {
            m.tick_256 += m.divider_256;
        }
        if !tick || !m.enabled {
            self.machines[number] = m;
            return;
        }
        let mut is_out = false;
        if m.delay > 0 {
            m.delay -= 1;
        } else {
            let instruction = u32::from(m.latched.unwrap_or(self.memory[m.pc as usize]));
            is_out = instruction >> 13 == 3;
            self.instruction(&mut m, instruction, seen);
        }
        // §3.5.4.2: on cycles without OUT; an OUT does its own.
        if !is_out && m.shiftctrl >> 17 & 1 != 0 && m.osr_count >= bits(m.shiftctrl >> 25) && !m.tx.is_empty() {
            m.osr = m.tx.remove(0);
            m.osr_count = 0;
        }
        self.machines[number] = m;
    }

    fn instruction(&mut self, m: &mut Slow, instruction: u32, seen: u32) {
        let side_bits = (m.pinctrl >> 29).min(5);
        let field = instruction >> 8 & 31;
        let (side, delay) = (field >> (5 - side_bits), field & mask(5 - side_bits));
        let mut next = if m.pc == m.execctrl >> 12 & 31 { m.execctrl >> 7 & 31 } else { (m.pc + 1) % 32 };
        let mut exec = None;
        let mut jumped = false;
        let done = self.operate(m, instruction, seen, &mut next, &mut jumped, &mut exec);
        if side_bits > 0 {
            let optional = m.execctrl >> 30 & 1;
            let pins = side_bits - optional;
            if optional == 0 || side >> pins & 1 != 0 {
                let base = m.pinctrl >> 10 & 31;
                let (into, which) = (mask(pins).rotate_left(base), side.rotate_left(base));
                let target = if m.execctrl >> 29 & 1 != 0 { &mut self.directions } else { &mut self.out };
                *target = *target & !into | which & into;
            }
        }
        if !done {
            return;
        }
        let was_latched = m.latched.is_some();
        m.latched = exec;
        m.delay = if exec.is_some() { 0 } else { delay };
        if jumped || !was_latched {
            m.pc = next;
        }
    }

    fn write_pins(&mut self, base: u32, count: u32, value: u32, directions: bool) {
        let into = mask(count).rotate_left(base);
        let target = if directions { &mut self.directions } else { &mut self.out };
        *target = *target & !into | value.rotate_left(base) & into;
    }

    fn flag(m: &Slow, index: u32) -> u32 {
        1 << if index & 16 != 0 { index & 4 | (index + m.number) & 3 } else { index & 7 }
    }

    /// Whether the instruction is complete.
    fn operate(
        &mut self,
        m: &mut Slow,
        instruction: u32,
        seen: u32,
        next: &mut u32,
        jumped: &mut bool,
        exec: &mut Option<u16>,
    ) -> bool {
        let (kind, low) = (instruction >> 5 & 7, instruction & 31);
        let in_base = m.pinctrl >> 15 & 31;
        let (out_base, out_count) = (m.pinctrl & 31, m.pinctrl >> 20 & 63);
        let (set_base, set_count) = (m.pinctrl >> 5 & 31, m.pinctrl >> 26 & 7);
        let (pull, push) = (bits(m.shiftctrl >> 25), bits(m.shiftctrl >> 20));
        let (autopull, autopush) = (m.shiftctrl >> 17 & 1 != 0, m.shiftctrl >> 16 & 1 != 0);
        match instruction >> 13 {
            0 => {
                let taken = match kind {
                    0 => true,
                    1 => m.x == 0,
                    2 => m.x != 0,
                    3 => m.y == 0,
                    4 => m.y != 0,
                    5 => m.x != m.y,
                    6 => seen >> (m.execctrl >> 24 & 31) & 1 != 0,
                    _ => m.osr_count < pull,
                };
                if kind == 2 {
                    m.x = m.x.wrapping_sub(1);
                }
                if kind == 4 {
                    m.y = m.y.wrapping_sub(1);
                }
                if taken {
                    (*next, *jumped) = (low, true);
                }
            }
            1 => {
                let wanted = instruction >> 7 & 1;
                match kind & 3 {
                    0 => return seen >> low & 1 == wanted,
                    1 => return seen >> ((low + in_base) % 32) & 1 == wanted,
                    2 => {
                        let flag = Model::flag(m, low);
                        if u32::from(self.irq & flag != 0) != wanted {
                            return false;
                        }
                        if wanted == 1 {
                            self.clear_flags |= flag;
                        }
                    }
                    _ => return false,
                }
            }
            2 => {
                let source = match kind {
                    0 => seen.rotate_right(in_base),
                    1 => m.x,
                    2 => m.y,
                    6 => m.isr,
                    7 => m.osr,
                    _ => 0,
                };
                let count = bits(low);
                let total = (m.isr_count + count).min(32);
                if autopush && total >= push && m.rx.len() >= m.rx_depth {
                    self.fdebug |= 1 << m.number;
                    return false;
                }
                let both = if m.shiftctrl >> 18 & 1 != 0 {
                    (u64::from(source & mask(count)) << 32 | u64::from(m.isr)) >> count
                } else {
                    u64::from(m.isr) << count | u64::from(source & mask(count))
                };
                (m.isr, m.isr_count) = (both as u32, total);
                if autopush && total >= push {
                    m.rx.push(m.isr);
                    (m.isr, m.isr_count) = (0, 0);
                }
            }
            3 => {
                if autopull && m.osr_count >= pull {
                    if m.tx.is_empty() {
                        self.fdebug |= 1 << (24 + m.number);
                    } else {
                        (m.osr, m.osr_count) = (m.tx.remove(0), 0);
                    }
                    return false;
                }
                let count = bits(low);
                let value = if m.shiftctrl >> 19 & 1 != 0 {
                    let value = m.osr & mask(count);
                    m.osr = (u64::from(m.osr) >> count) as u32;
                    value
                } else {
                    let both = u64::from(m.osr) << count;
                    m.osr = both as u32;
                    (both >> 32) as u32
                };
                m.osr_count = (m.osr_count + count).min(32);
                match kind {
                    0 => self.write_pins(out_base, out_count, value, false),
                    1 => m.x = value,
                    2 => m.y = value,
                    4 => self.write_pins(out_base, out_count, value, true),
                    5 => (*next, *jumped) = (value & 31, true),
                    6 => (m.isr, m.isr_count) = (value, count),
                    7 => *exec = Some(value as u16),
                    _ => {}
                }
                if autopull && m.osr_count >= pull && !m.tx.is_empty() {
                    (m.osr, m.osr_count) = (m.tx.remove(0), 0);
                }
            }
            4 if instruction & 0x80 == 0 => {
                if instruction & 0x40 != 0 && m.isr_count < push {
                    return true;
                }
                if m.rx.len() >= m.rx_depth {
                    self.fdebug |= 1 << m.number;
                    if instruction & 0x20 != 0 {
                        return false;
                    }
                } else {
                    m.rx.push(m.isr);
                }
                (m.isr, m.isr_count) = (0, 0);
            }
            4 => {
                if instruction & 0x40 != 0 && m.osr_count < pull || autopull && m.osr_count == 0 {
                    return true;
                }
                if !m.tx.is_empty() {
                    m.osr = m.tx.remove(0);
                } else if instruction & 0x20 != 0 {
                    self.fdebug |= 1 << (24 + m.number);
                    return false;
                } else {
                    m.osr = m.x;
                }
                m.osr_count = 0;
            }
            5 => {
                let level = if m.execctrl & 16 == 0 { m.tx.len() } else { m.rx.len() };
                let value = match instruction & 7 {
                    0 => seen.rotate_right(in_base),
                    1 => m.x,
                    2 => m.y,
                    5 if (level as u32) < m.execctrl & 15 => u32::MAX,
                    6 => m.isr,
                    7 => m.osr,
                    _ => 0,
                };
                let value = match instruction >> 3 & 3 {
                    1 => !value,
                    2 => value.reverse_bits(),
                    _ => value,
                };
                match kind {
                    0 => self.write_pins(out_base, out_count, value, false),
                    1 => m.x = value,
                    2 => m.y = value,
                    4 => *exec = Some(value as u16),
                    5 => (*next, *jumped) = (value & 31, true),
                    6 => (m.isr, m.isr_count) = (value, 0),
                    7 => (m.osr, m.osr_count) = (value, 0),
                    _ => {}
                }
            }
            6 => {
                let flag = Model::flag(m, low);
                if instruction & 0x40 != 0 {
                    self.clear_flags |= flag;
                } else if instruction & 0x20 == 0 {
                    self.set_flags |= flag;
                } else if !m.raised {
                    self.set_flags |= flag;
                    m.raised = true;
                    return false;
                } else if self.irq & flag != 0 {
                    return false;
                } else {
                    m.raised = false;
                }
            }
            _ => match kind {
                0 => self.write_pins(set_base, set_count, low, false),
                1 => m.x = low,
                2 => m.y = low,
                4 => self.write_pins(set_base, set_count, low, true),
                _ => {}
            },
        }
        true
    }
}

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
}

impl Case {
    fn new(seed: u64) -> Case {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
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
        Case { random, bench, model, now }
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

/// Edges that the chip caused, against all changes of level: those of the world are no edges of the chip.
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
    // What the world moved may be missing among the chip's, and nothing else.
    let mut chip = found.iter().map(|edge| (edge.cycle, edge.gpio, edge.level.is_high())).peekable();
    for edge in &expected {
        if chip.peek() == Some(edge) {
            chip.next();
        } else {
            assert!((16..24).contains(&edge.1), "{place}: the chip lacks {edge:?}, and has {:?}", chip.peek());
        }
    }
    assert_eq!(chip.next(), None, "{place}");
    found.len()
}
