//! A chip whose processor sleeps: registers are written by hand, in the cycle that is wanted.
#![allow(dead_code, reason = "each test uses its part")]

pub(crate) mod slow;

use pulsetrain_emulator::{GpioEdge, Observer, Rp2040, UartByte};

/// What left the chip.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Seen {
    pub(crate) edges: Vec<GpioEdge>,
    pub(crate) sent: Vec<UartByte>,
    pub(crate) frequencies: Vec<(u64, u64)>,
    pub(crate) resets: Vec<u64>,
    pub(crate) packets: Vec<(u64, Vec<u8>)>,
}

impl Observer for Seen {
    fn gpio(&mut self, edge: GpioEdge) {
        self.edges.push(edge);
    }

    fn transmit(&mut self, byte: UartByte) {
        self.sent.push(byte);
    }

    fn usb(&mut self, cycle: u64, data: &[u8]) {
        self.packets.push((cycle, data.to_vec()));
    }

    fn clock_frequency(&mut self, cycle: u64, hz: u64) {
        self.frequencies.push((cycle, hz));
    }

    fn watchdog_reset(&mut self, cycle: u64) {
        self.resets.push(cycle);
    }
}

/// Flash with a program: half-words from 0x1000_0108 on, with the stack at the end of RAM.
pub(crate) fn flash(program: &[u16]) -> Vec<u8> {
    let mut image = vec![0; 0x100];
    image.extend(0x2004_2000u32.to_le_bytes());
    image.extend(0x1000_0109u32.to_le_bytes());
    image.extend(program.iter().flat_map(|half| half.to_le_bytes()));
    image
}

/// A chip and what it did.
#[derive(Clone)]
pub(crate) struct Bench {
    pub(crate) chip: Rp2040,
    pub(crate) seen: Seen,
}

/// The SET and CLR aliases of a register (RP2040 datasheet §2.1.2).
pub(crate) const SET: u32 = 0x2000;
pub(crate) const CLR: u32 = 0x3000;
pub(crate) const XOR: u32 = 0x1000;

impl Bench {
    /// Asleep at a cycle well past its start, every peripheral out of reset.
    pub(crate) fn new() -> Bench {
        // wfi; b to it
        let chip = Rp2040::new(&flash(&[0xbf30, 0xe7fd])).expect("it fits");
        let mut bench = Bench { chip, seen: Seen::default() };
        bench.run(200);
        bench.set(0x4000_c000, 0);
        bench.run(1);
        bench
    }

    pub(crate) fn now(&self) -> u64 {
        self.chip.cycle()
    }

    pub(crate) fn run(&mut self, cycles: u64) {
        let end = self.now() + cycles;
        self.chip.run(end, &mut self.seen);
        assert_eq!(self.now(), end, "the processor is awake");
    }

    pub(crate) fn run_to(&mut self, cycle: u64) {
        self.run(cycle - self.now());
    }

    /// Writes in the present cycle, so that the next sees it.
    pub(crate) fn set(&mut self, address: u32, value: u32) {
        self.chip.write(address, value, &mut self.seen);
    }

    pub(crate) fn get(&mut self, address: u32) -> u32 {
        self.chip.read(address, &mut self.seen)
    }

    /// The edges of one pin since the last call: cycle, and whether it rose.
    pub(crate) fn edges(&mut self, gpio: u8) -> Vec<(u64, bool)> {
        let edges = std::mem::take(&mut self.seen.edges);
        edges.iter().filter(|edge| edge.gpio == gpio).map(|edge| (edge.cycle, edge.level.is_high())).collect()
    }

    /// Gives pins to a PIO block (function 6 or 7) or to SIO (5).
    pub(crate) fn give(&mut self, pins: impl IntoIterator<Item = u32>, function: u32) {
        for pin in pins {
            self.set(0x4001_4004 + 8 * pin, function);
        }
    }

    /// A word of RAM.
    pub(crate) fn poke(&mut self, address: u32, value: u32) {
        self.set(address, value);
    }
}

/// A state machine to be set up.
#[derive(Clone, Copy)]
pub(crate) struct Machine {
    pub(crate) block: u32,
    pub(crate) number: u32,
}

impl Machine {
    pub(crate) const fn new(block: u32, number: u32) -> Machine {
        Machine { block, number }
    }

    pub(crate) const fn base(self) -> u32 {
        0x5020_0000 + self.block * 0x10_0000
    }

    pub(crate) const fn register(self, offset: u32) -> u32 {
        self.base() + 0xc8 + self.number * 0x18 + offset
    }

    pub(crate) const fn clkdiv(self) -> u32 {
        self.register(0x00)
    }

    pub(crate) const fn execctrl(self) -> u32 {
        self.register(0x04)
    }

    pub(crate) const fn shiftctrl(self) -> u32 {
        self.register(0x08)
    }

    pub(crate) const fn addr(self) -> u32 {
        self.register(0x0c)
    }

    pub(crate) const fn instr(self) -> u32 {
        self.register(0x10)
    }

    pub(crate) const fn pinctrl(self) -> u32 {
        self.register(0x14)
    }

    pub(crate) const fn txf(self) -> u32 {
        self.base() + 0x10 + 4 * self.number
    }

    pub(crate) const fn rxf(self) -> u32 {
        self.base() + 0x20 + 4 * self.number
    }

    /// The DREQ of its TX FIFO; that of its RX FIFO is 4 more.
    pub(crate) const fn dreq(self) -> u32 {
        8 * self.block + self.number
    }

    /// Loads a program at an address and lets the machine wrap as it says; the side-set's count and enable too.
    pub(crate) fn load(self, bench: &mut Bench, program: &pio::Program<32>, at: u32) {
        for (address, word) in (at..).zip(&program.code) {
            let relocated = if word >> 13 == 0 { word + at as u16 } else { *word };
            bench.set(self.base() + 0x48 + 4 * address, relocated.into());
        }
        let wrap = (u32::from(program.wrap.source) + at) << 12 | (u32::from(program.wrap.target) + at) << 7;
        let optional = u32::from(program.side_set.optional()) << 30 | u32::from(program.side_set.pindirs()) << 29;
        bench.set(self.execctrl(), wrap | optional);
        let bits = u32::from(program.side_set.bits());
        bench.set(self.pinctrl(), bits << 29 | 5 << 26);
        bench.set(self.instr(), at);
        bench.run(2);
    }

    /// Makes pins from a base on outputs, low, as SDKs do: with forced `set pindirs`.
    pub(crate) fn outputs(self, bench: &mut Bench, base: u32, pins: u32) {
        let pinctrl = bench.get(self.pinctrl());
        for pin in base..base + pins {
            bench.set(self.pinctrl(), 1 << 26 | pin << 5);
            bench.set(self.instr(), 0xe081);
            bench.run(2);
        }
        bench.set(self.pinctrl(), pinctrl);
        bench.give(base..base + pins, 6 + self.block);
    }

    pub(crate) fn enable(self, bench: &mut Bench) {
        bench.set(self.base() + SET, 1 << self.number);
    }

    pub(crate) fn disable(self, bench: &mut Bench) {
        bench.set(self.base() + CLR, 1 << self.number);
    }

    pub(crate) fn push(self, bench: &mut Bench, word: u32) {
        bench.set(self.txf(), word);
    }

    /// Words in the TX FIFO and in the RX FIFO.
    pub(crate) fn levels(self, bench: &mut Bench) -> (u32, u32) {
        let levels = bench.get(self.base() + 0x0c) >> (8 * self.number);
        (levels & 15, levels >> 4 & 15)
    }

    /// Executes an instruction at once.
    pub(crate) fn force(self, bench: &mut Bench, instruction: u32) {
        bench.set(self.instr(), instruction);
        bench.run(1);
    }

    /// X, read by `mov isr, x` and a push: the machine must be disabled, its RX FIFO empty.
    pub(crate) fn x(self, bench: &mut Bench) -> u32 {
        self.scratch(bench, 0xa0c1)
    }

    /// Y, likewise.
    pub(crate) fn y(self, bench: &mut Bench) -> u32 {
        self.scratch(bench, 0xa0c2)
    }

    fn scratch(self, bench: &mut Bench, mov: u32) -> u32 {
        self.force(bench, mov);
        self.force(bench, 0x8000);
        bench.run(1);
        bench.get(self.rxf())
    }
}
