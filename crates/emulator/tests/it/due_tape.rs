//! The seam of a Due's step output: an interrupt takes a word of a tape and sets the timer's compare registers
//! (due_tape.s). How many cycles it takes, how fast it can go, and that a step that comes too late is not made at a wrong
//! time.

use pulsetrain_emulator::{GpioEdge, Observer, Sam3x8e, Sam3x8eTiming, hex};

/// The beginning of RAM, which is also at 0x2007_0000.
const STATES: u32 = 0x2000_0000;
const TC0: u32 = 0x4008_0000;
/// Tapes of 4 KiB each, at multiples of 8 KiB.
const TAPES: u32 = 0x2007_4000;
const TAPE_WORDS: u32 = 1024;
/// A pulse in ticks of two cycles, as the program has it.
const PULSE: u32 = 8;
/// TIOA0, 1 and 2: PB25, PA2, PA5.
const PINS: [u8; 3] = [32 + 25, 2, 5];
/// The first edge, in ticks after the start.
const FIRST: u32 = 1000;
/// A tick that no test reaches.
const NEVER: u32 = 0xf000_0000;

#[derive(Default)]
struct Edges(Vec<GpioEdge>);

impl Observer for Edges {
    fn gpio(&mut self, edge: GpioEdge) {
        self.0.push(edge);
    }
}

struct Bench {
    chip: Sam3x8e,
    /// A cycle after the last step.
    ends: u64,
    edges: Edges,
}

impl Bench {
    /// A chip with a tape for each of three motors; one with an empty tape stands still.
    fn new(timing: Sam3x8eTiming, tapes: [&[u32]; 3]) -> Bench {
        let image = hex::parse(include_str!("due_tape.hex"), 4096).expect("an image");
        let mut chip = Sam3x8e::new(&image, timing).expect("it fits");
        let mut edges = Edges::default();
        for (motor, tape) in (0..).zip(tapes) {
            let (at, state) = (TAPES + 0x2000 * motor, STATES + 16 * motor);
            for place in 0..TAPE_WORDS {
                let word = tape.get(place as usize).copied().unwrap_or(0);
                chip.write(at + 4 * place, word, &mut edges);
            }
            let first = if tape.is_empty() { NEVER } else { FIRST };
            for (offset, value) in [(0, at), (4, first), (8, 0), (12, TC0 + 0x40 * motor)] {
                chip.write(state + offset, value, &mut edges);
            }
        }
        let longest = tapes.iter().map(|tape| tape.iter().sum::<u32>()).max().unwrap_or(0);
        Bench { chip, ends: 2 * u64::from(FIRST + longest) + 5000, edges }
    }

    /// Runs past the end of all tapes; the rises of each motor, in cycles. A motor whose step came so late that the
    /// pulse's end was over too has no interrupt any more, and is quiet.
    fn run(&mut self) -> [Vec<u64>; 3] {
        self.chip.run(self.ends, &mut self.edges);
        assert_eq!(self.chip.fault(), None);
        PINS.map(|pin| {
            let edges = self.edges.0.iter().filter(|edge| edge.gpio == pin && edge.cycle > 1000);
            edges.filter(|edge| edge.level.is_high()).map(|edge| edge.cycle).collect()
        })
    }
}

/// Whether the rises are those of a tape.
fn is_exact(rises: &[u64], tape: &[u32]) -> bool {
    let steps = rises.windows(2).map(|pair| pair[1] - pair[0]);
    let count = if tape.is_empty() { 0 } else { tape.len() + 1 };
    rises.len() == count && steps.eq(tape.iter().map(|ticks| 2 * u64::from(*ticks)))
}

/// The cycles from a pulse's end to the handler's first instruction, in the handler, and back to the program.
fn handler_cycles(timing: Sam3x8eTiming) -> [u64; 3] {
    let image = hex::parse(include_str!("due_tape.hex"), 4096).expect("an image");
    let word = |at: usize| u32::from_le_bytes(image[at..at + 4].try_into().expect("four bytes"));
    let handler = word(4 * (16 + 27)) & !1;
    let mut bench = Bench::new(timing, [&[200; 20], &[], &[]]);
    // The tenth interrupt of the first motor; those before it fill the flash's buffers as all others do.
    let mut seen = 0;
    let (mut fell, mut began) = (0, 0);
    loop {
        let was_in_handler = bench.chip.cpu().xpsr() & 0x1ff == 16 + 27;
        bench.chip.step(&mut bench.edges);
        let cpu = bench.chip.cpu();
        let is_in_handler = cpu.xpsr() & 0x1ff == 16 + 27;
        if cpu.pc() == handler && !was_in_handler {
            seen += 1;
            let low = |edge: &&GpioEdge| edge.gpio == PINS[0] && !edge.level.is_high();
            fell = bench.edges.0.iter().rev().find(low).expect("a pulse").cycle;
            began = bench.chip.cycle();
        }
        // `bx lr` is the last instruction before the return.
        if was_in_handler && !is_in_handler && seen == 10 {
            let back = bench.chip.cycle();
            let returns = u64::from(timing.return_cycles);
            return [began - fell, back - returns - began, returns];
        }
    }
}

/// How many steps a second the three motors make, and the shortest interval, in ticks, at which no step is late.
fn shortest(timing: Sam3x8eTiming, motors: usize) -> u32 {
    let keeps = |ticks: u32| {
        // The motors' ticks differ a little, so that they meet in all ways.
        let tapes: [Vec<u32>; 3] =
            std::array::from_fn(|motor| if motor < motors { vec![ticks + motor as u32; 1000] } else { Vec::new() });
        let rises = Bench::new(timing, [&tapes[0], &tapes[1], &tapes[2]]).run();
        rises.iter().zip(&tapes).all(|(rises, tape)| is_exact(rises, tape))
    };
    (20..200).find(|ticks| keeps(*ticks)).expect("some interval is long enough")
}

/// What the interrupt takes. The budget of docs for one motor at 1.13 million steps/s is 74 cycles a step, for all.
#[test]
fn cycles_of_the_interrupt() {
    for (timing, name, most) in
        [(Sam3x8eTiming::LIKELY, "likely", [13, 30, 10]), (Sam3x8eTiming::PESSIMISTIC, "pessimistic", [14, 41, 12])]
    {
        let cycles = handler_cycles(timing);
        println!(
            "{name}: entry {}, handler {}, return {}: {}",
            cycles[0],
            cycles[1],
            cycles[2],
            cycles.iter().sum::<u64>()
        );
        assert!(cycles.iter().zip(most).all(|(cycles, most)| *cycles <= most), "{name}: {cycles:?}");
    }
}

/// Every edge is exact down to an interval; one motor alone, and three in all.
#[test]
fn the_shortest_interval() {
    for (timing, name, most) in
        [(Sam3x8eTiming::LIKELY, "likely", [30, 70]), (Sam3x8eTiming::PESSIMISTIC, "pessimistic", [32, 80])]
    {
        let ticks = [shortest(timing, 1), shortest(timing, 3)];
        let rate = |motors: u32, ticks: u32| 42e6 * f64::from(motors) / f64::from(ticks);
        println!(
            "{name}: {} ticks, {:.0} steps/s; three {} ticks, {:.0} steps/s in all",
            ticks[0],
            rate(1, ticks[0]),
            ticks[1],
            rate(3, ticks[1])
        );
        assert!(ticks.iter().zip(most).all(|(ticks, most)| *ticks <= most), "{name}: {ticks:?}");
    }
}

/// A word that is shorter than the handler can keep: the motor makes no step at a wrong time, and stops; what it made is
/// what was written before.
#[test]
fn a_late_step_is_not_made() {
    for timing in [Sam3x8eTiming::LIKELY, Sam3x8eTiming::PESSIMISTIC] {
        let mut tape = vec![100; 50];
        tape[30] = PULSE + 2;
        let other = vec![77; 60];
        let [rises, others, _] = Bench::new(timing, [&tape, &other, &[]]).run();
        assert!(is_exact(&rises, &tape[..30]), "{rises:?}");
        assert!(is_exact(&others, &other), "the other motor goes on");
    }
}

/// Intervals that change with each step, to the end of the tape, whatever the phase of three motors.
#[test]
fn every_edge_is_exact() {
    let tape = |seed: u32| -> Vec<u32> { (0..1000).map(|at: u32| 120 + (at * seed) % 61).collect() };
    let tapes = [tape(7), tape(11), tape(13)];
    for timing in [Sam3x8eTiming::LIKELY, Sam3x8eTiming::PESSIMISTIC] {
        let mut bench = Bench::new(timing, [&tapes[0], &tapes[1], &tapes[2]]);
        let rises = bench.run();
        for (rises, tape) in rises.iter().zip(&tapes) {
            assert!(is_exact(rises, tape));
        }
        // All channels began in one cycle, and each pulse is as long as it should be.
        assert!(rises.iter().all(|of| of[0] == rises[0][0]));
        for pin in PINS {
            let edges: Vec<_> = bench.edges.0.iter().filter(|edge| edge.gpio == pin && edge.cycle > 1000).collect();
            assert!(edges.chunks(2).all(|pair| pair[1].cycle - pair[0].cycle == 2 * u64::from(PULSE)));
        }
    }
}
