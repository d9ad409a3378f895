//! State machines (RP2040 datasheet §3).

use crate::pico::{Bench, CLR, Machine, SET};
use pio::pio_asm;

const M: Machine = Machine::new(0, 0);

// SHIFTCTRL.
const OUT_RIGHT: u32 = 1 << 19;
const IN_RIGHT: u32 = 1 << 18;
const AUTOPULL: u32 = 1 << 17;
const AUTOPUSH: u32 = 1 << 16;

/// §3.2, §3.4: an instruction a cycle; an enable written in cycle c has its first in c + 1, and its pin's edge is in
/// c + 2. Wrapping costs nothing.
#[test]
fn a_cycle_an_instruction() {
    let mut bench = Bench::new();
    let program = pio_asm!("set pins, 1", "set pins, 0 [2]").program;
    M.load(&mut bench, &program, 3);
    M.outputs(&mut bench, 5, 1);
    bench.set(M.pinctrl(), 1 << 26 | 5 << 5);
    let start = bench.now();
    M.enable(&mut bench);
    bench.run(10);
    let expected = [2, 3, 6, 7, 10].map(|after| start + after);
    assert_eq!(bench.edges(5).iter().map(|edge| edge.0).collect::<Vec<_>>(), expected);
}

/// §3.5.5: the divider's periods, the fraction included: 1 + 128/256 makes 1 and 2 cycles in turn, 2.5 makes 2 and 3.
#[test]
fn the_clock_divider() {
    for (divider, gaps) in [
        (0x0001_0000, [2, 2, 2, 2, 2, 2]),
        (0x0001_8000, [3, 3, 3, 3, 3, 3]),
        (0x0002_8000, [5, 5, 5, 5, 5, 5]),
        (0x0003_4000, [6, 7, 6, 7, 6, 7]),
        (0x0001_4000, [2, 3, 2, 3, 2, 3]),
    ] {
        let mut bench = Bench::new();
        let program = pio_asm!("set pins, 1", "set pins, 0").program;
        M.load(&mut bench, &program, 0);
        M.outputs(&mut bench, 0, 1);
        bench.set(M.pinctrl(), 1 << 26);
        bench.set(M.clkdiv(), divider);
        // CLKDIV_RESTART and SM_ENABLE.
        bench.set(M.base(), 1 << 8 | 1);
        bench.run(100);
        let rises: Vec<u64> = bench.edges(0).iter().filter(|edge| edge.1).map(|edge| edge.0).collect();
        let found: Vec<u64> = rises.windows(2).map(|pair| pair[1] - pair[0]).take(6).collect();
        assert_eq!(found, gaps, "divider {divider:#x}");
    }
}

/// §3.7, SMx_CLKDIV: an integer part of 0 is 65 536.
#[test]
fn the_slowest_clock() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("set pins, 1", "set pins, 0").program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(M.pinctrl(), 1 << 26);
    bench.set(M.clkdiv(), 0);
    bench.set(M.base(), 1 << 8 | 1);
    bench.run(300_000);
    let edges = bench.edges(0);
    assert_eq!(edges[1].0 - edges[0].0, 65_536);
}

/// §3.7, CTRL: machines whose dividers are restarted in one write run in step; restarted one cycle apart, one cycle
/// apart. Dividers run whether the machine is enabled or not.
#[test]
fn dividers_in_step() {
    let mut bench = Bench::new();
    let other = Machine::new(0, 2);
    let program = pio_asm!("set pins, 1", "set pins, 0").program;
    for (machine, pin) in [(M, 0), (other, 1)] {
        machine.load(&mut bench, &program, 0);
        machine.outputs(&mut bench, pin, 1);
        bench.set(machine.pinctrl(), 1 << 26 | pin << 5);
        bench.set(machine.clkdiv(), 7 << 16);
    }
    bench.set(M.base(), 1 << 8 | 1 << 10);
    bench.run(3);
    M.enable(&mut bench);
    bench.run(30);
    other.enable(&mut bench);
    bench.run(100);
    let edges = bench.seen.edges.clone();
    let of = |pin: u8| edges.iter().filter(|edge| edge.gpio == pin).map(|edge| edge.cycle % 7).collect::<Vec<_>>();
    assert!(of(0).iter().chain(&of(1)).all(|phase| *phase == of(0)[0]), "{:?} {:?}", of(0), of(1));
}

/// §3.4.2: conditions; `x--` decrements whether it jumps or not.
#[test]
fn jumps() {
    // set x, n; set y, m; jmp condition, taken; set pins, 1; halt: jmp halt; taken: set pins, 2; jmp halt
    let check = |x: u32, y: u32, condition: u32, taken: bool, after: (u32, u32)| {
        let mut bench = Bench::new();
        M.load(&mut bench, &pio_asm!("h:", "jmp h").program, 20);
        for (at, word) in [0xe020 | x, 0xe040 | y, condition << 5 | 5, 0xe001, 4, 0xe002, 4].into_iter().enumerate() {
            bench.set(M.base() + 0x48 + 4 * at as u32, word);
        }
        M.outputs(&mut bench, 0, 2);
        bench.set(M.pinctrl(), 2 << 26);
        M.force(&mut bench, 0);
        M.enable(&mut bench);
        bench.run(20);
        M.disable(&mut bench);
        bench.run(2);
        let pins = bench.seen.edges.last().map(|edge| edge.gpio);
        let place = format!("x {x}, y {y}, condition {condition}");
        assert_eq!(pins, Some(u8::from(taken)), "{place}");
        assert_eq!((M.x(&mut bench), M.y(&mut bench)), after, "{place}");
    };
    check(3, 4, 0, true, (3, 4));
    check(0, 4, 1, true, (0, 4));
    check(1, 4, 1, false, (1, 4));
    check(3, 4, 2, true, (2, 4));
    check(0, 4, 2, false, (u32::MAX, 4));
    check(3, 0, 3, true, (3, 0));
    check(3, 1, 3, false, (3, 1));
    check(3, 4, 4, true, (3, 3));
    check(3, 0, 4, false, (3, u32::MAX));
    check(3, 4, 5, true, (3, 4));
    check(4, 4, 5, false, (4, 4));
    // No pin is high, and the OSR is empty after the restart of a machine.
    check(3, 4, 6, false, (3, 4));
    check(3, 4, 7, false, (3, 4));
}

/// A counted jump to its own address takes x + 1 times its cycles, delay and divider included. At every time X is what
/// it would be if the jumps were executed one by one.
#[test]
fn counting_down() {
    for (divider, delay, y) in [(0x0001_0000, 0, false), (0x0001_0000, 2, true), (0x0002_8000, 1, false)] {
        for stop in 1..70 {
            let mut bench = Bench::new();
            // One loop in two forms: a jump to itself, and a jump around another one, for which there is no short cut.
            let (one, two) = (Machine::new(0, 0), Machine::new(1, 0));
            let jump = if y { 4 } else { 2 } << 5 | delay << 8;
            let set = if y { 0xe040 } else { 0xe020 };
            for (machine, program) in [(one, [set | 12, jump | 1, 0xe001, 3]), (two, [set | 12, jump | 1, 0xe001, 3])] {
                for (at, word) in program.into_iter().enumerate() {
                    bench.set(machine.base() + 0x48 + 4 * at as u32, word);
                }
                machine.outputs(&mut bench, machine.block, 1);
                bench.set(machine.pinctrl(), 1 << 26 | machine.block << 5);
                bench.set(machine.clkdiv(), divider);
            }
            // Both start in one cycle. One is read in every cycle, so that it never gets far ahead.
            for machine in [one, two] {
                bench.set(machine.base(), 1 << 8 | 1);
            }
            for _ in 0..stop {
                bench.run(1);
                bench.get(two.addr());
            }
            for machine in [one, two] {
                machine.disable(&mut bench);
            }
            bench.run(1);
            let place = format!("divider {divider:#x}, delay {delay}, stopped after {stop}");
            assert_eq!(bench.get(one.addr()), bench.get(two.addr()), "{place}");
            let registers = [one, two].map(|machine| (machine.x(&mut bench), machine.y(&mut bench)));
            assert_eq!(registers[0], registers[1], "{place}");
            let edges = bench.seen.edges.iter().map(|edge| edge.cycle).collect::<Vec<_>>();
            assert!(edges.len() % 2 == 0 && edges.iter().min() == edges.iter().max(), "{place}: {edges:?}");
        }
    }
}

/// The loop's length, up to its maximum of 2^32 times 32 cycles.
#[test]
fn the_longest_count() {
    let mut bench = Bench::new();
    let program = pio_asm!("mov x, !null", "l:", "jmp x-- l [31]", "set pins, 1", "h:", "jmp h").program;
    M.load(&mut bench, &program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(M.pinctrl(), 1 << 26);
    let start = bench.now();
    M.enable(&mut bench);
    bench.run(10 + (32 << 32));
    // Enable, mov, 2^32 jumps of 32 cycles, set.
    assert_eq!(bench.edges(0), [(start + 1 + 1 + (32 << 32) + 1, true)]);
}

/// §3.4.3: `wait gpio` through two flip-flops: a level that is new in cycle e lets the machine go on in e + 2; with the
/// synchroniser bypassed (§3.5.6.3) in e.
#[test]
fn the_input_synchroniser() {
    for (bypass, latency) in [(0, 2), (1 << 3, 0)] {
        let mut bench = Bench::new();
        M.load(&mut bench, &pio_asm!("wait 1 gpio 3", "set pins, 1", "h:", "jmp h").program, 0);
        M.outputs(&mut bench, 0, 1);
        bench.set(M.pinctrl(), 1 << 26);
        bench.set(M.base() + 0x38, bypass);
        M.enable(&mut bench);
        bench.run(20);
        let level = bench.now();
        bench.chip.set_input(3, Some(true.into()));
        bench.run(10);
        // The wait ends in level + latency, `set` is executed in the next, its edge is in the one after.
        assert_eq!(bench.edges(0), [(level + latency + 2, true)]);
    }
}

/// A machine sees what another put out three cycles later: one to the pin, two of synchroniser. A wait that begins
/// while the edge is on its way sees it too.
#[test]
fn a_pin_between_machines() {
    for early in 0..6 {
        let mut bench = Bench::new();
        let waits = Machine::new(1, 1);
        M.load(&mut bench, &pio_asm!("set pins, 1", "h:", "jmp h").program, 0);
        waits.load(&mut bench, &pio_asm!("wait 1 gpio 7", "set pins, 1", "h:", "jmp h").program, 0);
        M.outputs(&mut bench, 7, 1);
        waits.outputs(&mut bench, 8, 1);
        bench.set(M.pinctrl(), 1 << 26 | 7 << 5);
        bench.set(waits.pinctrl(), 1 << 26 | 8 << 5);
        M.enable(&mut bench);
        let set_at = bench.now() + 1;
        bench.run(early);
        waits.enable(&mut bench);
        let first = bench.now() + 1;
        bench.run(20);
        assert_eq!(bench.edges(8), [((set_at + 3).max(first) + 2, true)], "enabled {early} later");
    }
}

/// §3.4.9, §3.4.3: a flag set in t is seen in t + 1; `wait 1 irq` clears it.
#[test]
fn irq_flags() {
    let mut bench = Bench::new();
    let waits = Machine::new(0, 1);
    let program = pio_asm!("irq 4", "h:", "jmp h", "wait 1 irq 4", "set pins, 1", "g:", "jmp g").program;
    M.load(&mut bench, &program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(waits.pinctrl(), 1 << 26);
    bench.set(waits.execctrl(), 31 << 12);
    waits.force(&mut bench, 2);
    waits.enable(&mut bench);
    bench.run(5);
    let start = bench.now();
    M.enable(&mut bench);
    bench.run(1);
    // The machine sets it in start + 1.
    assert_eq!(bench.get(M.base() + 0x30), 0);
    bench.run(1);
    assert_eq!(bench.get(M.base() + 0x30), 1 << 4);
    bench.run(1);
    assert_eq!(bench.get(M.base() + 0x30), 0);
    bench.run(10);
    // Set in +1, seen and cleared in +2, `set pins` in +3, its edge in +4.
    assert_eq!(bench.edges(0), [(start + 4, true)]);
}

/// §3.4.9: `rel` adds the machine's number to the lowest two bits, and leaves the third.
#[test]
fn irq_rel() {
    for number in 0..4 {
        let mut bench = Bench::new();
        let machine = Machine::new(1, number);
        machine.load(&mut bench, &pio_asm!("irq 2 rel", "irq 7 rel", "irq 5", "h:", "jmp h").program, 0);
        machine.enable(&mut bench);
        bench.run(10);
        let flags = bench.get(machine.base() + 0x30);
        assert_eq!(flags, 1 << ((2 + number) % 4) | 1 << (4 + (3 + number) % 4) | 1 << 5, "machine {number}");
    }
}

/// §3.4.9: `irq wait` goes on in the cycle after that in which it sees its flag cleared.
#[test]
fn irq_wait() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("irq wait 1", "set pins, 1", "h:", "jmp h").program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(M.pinctrl(), 1 << 26);
    M.enable(&mut bench);
    bench.run(20);
    assert_eq!(bench.get(M.base() + 0x30), 2);
    let clear = bench.now();
    bench.set(M.base() + 0x30, 2);
    bench.run(10);
    // Clear from +1 on, `set` in +2, edge in +3. It is not raised again.
    assert_eq!((bench.edges(0), bench.get(M.base() + 0x30)), (vec![(clear + 3, true)], 0));
}

/// §3.5.4.2: OUT with an empty OSR pulls in one cycle and shifts in the next; a last OUT of a word refills at once, so
/// that `out pins, 1` makes a bit a cycle.
#[test]
fn autopull() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("out pins, 1").program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(M.pinctrl(), 1 << 20);
    // Threshold 4.
    bench.set(M.shiftctrl(), OUT_RIGHT | AUTOPULL | 4 << 25);
    for word in [0b0101, 0b0101, 0b1101] {
        M.push(&mut bench, word);
    }
    let start = bench.now();
    M.enable(&mut bench);
    bench.run(40);
    // +1 pulls, +2 is the first bit.
    let edges: Vec<_> = bench.edges(0).iter().map(|edge| edge.0 - start).collect();
    assert_eq!(edges, [3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13]);
    // Starved, it waits in the cycle after its last bit and says so.
    assert_eq!(bench.get(M.base() + 8), 1 << 24);
    let push = bench.now();
    M.push(&mut bench, 0);
    bench.run(10);
    // In the FIFO from +1: pulled in +1, out in +2.
    assert_eq!(bench.edges(0), [(push + 3, false)]);
}

/// §3.7, FDEBUG: TXSTALL is set again at once while the machine still waits, and stays clear if it does not.
#[test]
fn txstall() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("out x, 32").program, 0);
    bench.set(M.shiftctrl(), OUT_RIGHT | AUTOPULL);
    let fdebug = M.base() + 8;
    M.enable(&mut bench);
    bench.run(5);
    bench.set(fdebug, 1 << 24);
    bench.run(2);
    assert_eq!(bench.get(fdebug), 1 << 24);
    M.disable(&mut bench);
    for word in 0..4 {
        M.push(&mut bench, word);
    }
    M.push(&mut bench, 4);
    bench.run(1);
    // The fifth was one too many: TXOVER.
    assert_eq!(bench.get(fdebug), 1 << 24 | 1 << 16);
    bench.get(M.rxf());
    assert_eq!(bench.get(fdebug), 1 << 24 | 1 << 16 | 1 << 8, "RXUNDER");
}

/// §3.4.5, §3.4.4: shifting either way, and what the counters do: `out` and `in` of 32 bits, and of fewer.
#[test]
fn shifting() {
    let mut bench = Bench::new();
    bench.set(M.execctrl(), 31 << 12);
    M.push(&mut bench, 0x8765_4321);
    // pull; out x, 8; mov isr, null; in x, 4; push
    for (direction, x, isr) in [(OUT_RIGHT | IN_RIGHT, 0x21, 0x1000_0000), (0, 0x87, 0x7)] {
        bench.set(M.shiftctrl(), direction);
        M.push(&mut bench, 0x8765_4321);
        for word in [0x80a0, 0x6028, 0xa0c3, 0x4024] {
            M.force(&mut bench, word);
        }
        M.force(&mut bench, 0x8020);
        bench.run(1);
        assert_eq!(bench.get(M.rxf()), isr);
        assert_eq!(M.x(&mut bench), x);
    }
}

/// §3.4.8: invert, bit-reverse, STATUS.
#[test]
fn moves() {
    let mut bench = Bench::new();
    // set x, 5; mov x, ~x
    M.force(&mut bench, 0xe025);
    M.force(&mut bench, 0xa029);
    assert_eq!(M.x(&mut bench), !5);
    M.force(&mut bench, 0xa031);
    assert_eq!(M.x(&mut bench), (!5u32).reverse_bits());
    // mov x, status: TX level below 2.
    bench.set(M.execctrl(), 31 << 12 | 2);
    for (words, status) in [(0, u32::MAX), (1, u32::MAX), (2, 0)] {
        while M.levels(&mut bench).0 < words {
            M.push(&mut bench, 0);
            bench.run(1);
        }
        M.force(&mut bench, 0xa025);
        assert_eq!(M.x(&mut bench), status, "{words} words");
    }
}

/// §3.5.1: side-set of two pins with an enable bit: three bits of the delay field; also of directions. It happens in
/// the first cycle, even if the instruction stalls.
#[test]
fn side_set() {
    let mut bench = Bench::new();
    let program =
        pio_asm!(".side_set 2 opt", "nop side 0b01 [1]", "nop [3]", "nop side 0b10", "pull block side 0b11",).program;
    M.load(&mut bench, &program, 0);
    M.outputs(&mut bench, 10, 2);
    bench.set(M.pinctrl(), 3 << 29 | 10 << 10);
    let start = bench.now();
    M.enable(&mut bench);
    bench.run(30);
    let edges: Vec<_> = bench.seen.edges.iter().map(|e| (e.cycle - start, e.gpio, e.level.is_high())).collect();
    assert_eq!(edges, [(2, 10, true), (8, 10, false), (8, 11, true), (9, 10, true)]);
}

/// §3.5.6: side-set wins over OUT and SET of the same machine, and the machine of the highest number over others.
#[test]
fn who_wins() {
    let mut bench = Bench::new();
    let program = pio_asm!(".side_set 1", "set pins, 3 side 0 [3]", "h:", "jmp h side 0").program;
    M.load(&mut bench, &program, 0);
    M.outputs(&mut bench, 0, 2);
    bench.set(M.pinctrl(), 1 << 29 | 2 << 26);
    M.enable(&mut bench);
    bench.run(10);
    let edges: Vec<_> = bench.seen.edges.iter().map(|e| (e.gpio, e.level.is_high())).collect();
    assert_eq!(edges, [(1, true)]);

    let mut bench = Bench::new();
    let program =
        pio_asm!("set pins, 1 [1]", "set pins, 0", "h:", "jmp h", "set pins, 0 [1]", "set pins, 1", "jmp h").program;
    let other = Machine::new(0, 3);
    for (machine, entry) in [(M, 0), (other, 3)] {
        machine.load(&mut bench, &program, 0);
        machine.outputs(&mut bench, 0, 1);
        bench.set(machine.pinctrl(), 1 << 26);
        machine.force(&mut bench, entry);
    }
    let start = bench.now();
    bench.set(M.base(), 0b1001);
    bench.run(20);
    assert_eq!(bench.edges(0), [(start + 4, true)]);
}

/// §3.5.6.2: with OUT_STICKY the last OUT holds its pins, and INLINE_OUT_EN's bit lets them go.
#[test]
fn sticky_outputs() {
    let mut bench = Bench::new();
    let other = Machine::new(0, 0);
    let holds = Machine::new(0, 3);
    let program = pio_asm!("out pins, 2", "h:", "jmp h").program;
    holds.load(&mut bench, &program, 0);
    holds.outputs(&mut bench, 0, 1);
    // Bit 1 of the data enables.
    let execctrl = bench.get(holds.execctrl());
    bench.set(holds.execctrl(), execctrl | 1 << 17 | 1 << 18 | 1 << 19);
    bench.set(holds.pinctrl(), 1 << 20);
    holds.push(&mut bench, 0b11);
    holds.force(&mut bench, 0x80a0);
    holds.enable(&mut bench);
    bench.set(other.pinctrl(), 1 << 26);
    bench.run(5);
    // set pins, 0 from a machine of a lower number: it cannot.
    other.force(&mut bench, 0xe000);
    bench.run(5);
    assert!(bench.chip.pin(0).is_high());
    // Without the enable the machine no longer holds the pin, and the level stays until the next write.
    holds.force(&mut bench, 0x6002);
    bench.run(2);
    other.force(&mut bench, 0xe000);
    bench.run(2);
    assert!(!bench.chip.pin(0).is_high());
}

/// §3.5.7: what is written to SMx_INSTR is executed in the next cycle, also by a machine that is disabled or slow; a
/// running program goes on where it was.
#[test]
fn forced_instructions() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("nop [15]", "set pins, 1", "h:", "jmp h").program, 0);
    M.outputs(&mut bench, 0, 2);
    bench.set(M.pinctrl(), 2 << 26);
    bench.set(M.clkdiv(), 100 << 16);
    // Disabled.
    let now = bench.now();
    bench.set(M.instr(), 0xe002);
    bench.run(2);
    assert_eq!(bench.edges(1), [(now + 2, true)]);
    // Slow and running.
    bench.set(M.base(), 1 << 8 | 1);
    bench.run(250);
    let now = bench.now();
    bench.set(M.instr(), 0xe000);
    bench.run(2);
    assert_eq!(bench.edges(1), [(now + 2, false)]);
    assert_eq!(bench.get(M.addr()), 1);
    // A jump takes the program elsewhere.
    bench.set(M.instr(), 2);
    bench.run(2);
    assert_eq!(bench.get(M.addr()), 2);
    // One that stalls says so until it can be completed.
    M.disable(&mut bench);
    bench.set(M.instr(), 0x80a0);
    bench.run(5);
    assert_eq!(bench.get(M.execctrl()) >> 31, 1);
    M.push(&mut bench, 0x55);
    bench.run(2);
    assert_eq!(bench.get(M.execctrl()) >> 31, 0);
    assert_eq!(M.levels(&mut bench).0, 0);
}

/// §3.4.5: OUT EXEC executes its data next; its own delay is ignored, that of the executed one is not.
#[test]
fn out_exec() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("out exec, 16 [7]", "set pins, 0", "h:", "jmp h").program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(M.pinctrl(), 1 << 26);
    // set pins, 1 [2]
    M.push(&mut bench, 0xe201);
    M.force(&mut bench, 0x80a0);
    let start = bench.now();
    M.enable(&mut bench);
    bench.run(20);
    assert_eq!(bench.edges(0), [(start + 3, true), (start + 6, false)]);
}

/// §3.5.3: joined, one FIFO has eight words and the other none: both full and empty.
#[test]
fn joined_fifos() {
    let mut bench = Bench::new();
    bench.set(M.shiftctrl(), 1 << 30);
    for word in 0..9 {
        M.push(&mut bench, word);
    }
    bench.run(1);
    assert_eq!(M.levels(&mut bench), (8, 0));
    // RXFULL, RXEMPTY and TXFULL of machine 0; the others' are empty.
    assert_eq!(bench.get(M.base() + 4), 1 | 0xf << 8 | 1 << 16 | 0xe << 24);
    // Changing FJOIN discards.
    bench.set(M.shiftctrl(), 1 << 31);
    bench.run(1);
    assert_eq!(M.levels(&mut bench), (0, 0));
    assert_eq!(bench.get(M.base() + 4), 0xf << 8 | 1 << 16 | 0xf << 24);
}

/// §3.5.4.1: autopush at its threshold, in the cycle of the IN; a full FIFO stalls it (RXSTALL), and nothing is lost.
#[test]
fn autopush() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("in x, 16", "jmp x-- n", "n:").program, 0);
    bench.set(M.execctrl(), 1 << 12);
    bench.set(M.shiftctrl(), AUTOPUSH);
    M.force(&mut bench, 0xe03f);
    M.enable(&mut bench);
    bench.run(100);
    assert_eq!((M.levels(&mut bench).1, bench.get(M.base() + 8)), (4, 1));
    let words: Vec<u32> = (0..6)
        .map(|_| {
            let word = bench.get(M.rxf());
            bench.run(10);
            word
        })
        .collect();
    let expected: Vec<u32> = (0..6).map(|n| (31 - 2 * n) << 16 | (30 - 2 * n)).collect();
    assert_eq!(words, expected);
}

/// §3.4.6, §3.4.7: PUSH IFFULL, PUSH without blocking loses its word and says so; PULL without blocking takes X.
#[test]
fn push_and_pull() {
    let mut bench = Bench::new();
    bench.set(M.shiftctrl(), 8 << 20);
    M.force(&mut bench, 0xe027);
    // in x, 4; push iffull: not yet. in x, 4; push iffull
    for word in [0x4024, 0x8040, 0x4024, 0x8040] {
        M.force(&mut bench, word);
    }
    bench.run(1);
    assert_eq!((M.levels(&mut bench).1, bench.get(M.rxf())), (1, 0x77));
    for _ in 0..5 {
        M.force(&mut bench, 0x8000);
    }
    bench.run(1);
    assert_eq!((M.levels(&mut bench).1, bench.get(M.base() + 8)), (4, 1));
    // pull noblock; mov y, osr
    M.force(&mut bench, 0x8080);
    M.force(&mut bench, 0xa047);
    for _ in 0..4 {
        bench.get(M.rxf());
    }
    assert_eq!(M.y(&mut bench), 7);
}

/// §3.7, CTRL: SM_RESTART clears shift counters, ISR and delay, and leaves PC, X and Y; disabling keeps the delay that
/// is left.
#[test]
fn restart_and_pause() {
    let mut bench = Bench::new();
    M.load(&mut bench, &pio_asm!("nop [9]", "set pins, 1", "h:", "jmp h").program, 0);
    M.outputs(&mut bench, 0, 1);
    bench.set(M.pinctrl(), 1 << 26);
    M.enable(&mut bench);
    bench.run(5);
    M.disable(&mut bench);
    bench.run(100);
    let again = bench.now();
    M.enable(&mut bench);
    bench.run(20);
    // Five of the ten cycles were left.
    assert_eq!(bench.edges(0), [(again + 1 + 5 + 1, true)]);

    M.force(&mut bench, 0xe025);
    M.force(&mut bench, 0x4024);
    bench.set(M.base() + SET, 1 << 4);
    bench.set(M.base() + CLR, 1);
    bench.run(1);
    assert_eq!(bench.get(M.addr()), 2);
    assert_eq!(M.x(&mut bench), 5);
}

/// §3.7, INTR: RX not empty, TX not full, flags 0 to 3; both lines with their enables and forces.
#[test]
fn interrupts() {
    let mut bench = Bench::new();
    let (intr, inte, intf, ints) = (M.base() + 0x128, M.base() + 0x12c, M.base() + 0x130, M.base() + 0x134);
    assert_eq!(bench.get(intr), 0xf0);
    for _ in 0..4 {
        M.push(&mut bench, 0);
    }
    bench.set(M.base() + 0x34, 0b1_0010);
    bench.run(1);
    // Flags above 3 do not interrupt.
    assert_eq!(bench.get(intr), 0xe0 | 1 << 9);
    bench.set(inte, 1 << 9 | 1);
    bench.set(intf, 1 << 11);
    bench.run(1);
    assert_eq!(bench.get(ints), 1 << 9 | 1 << 11);
    assert_eq!(bench.get(M.base() + 0x140), 0);
}

/// A loop of a program that others measured on a chip: FastAccelStepper's `LOOP_OVERHEAD` is 26 cycles, and each turn of
/// its inner loop 3 (github.com/gin66/FastAccelStepper, src/pd_pico/pico_pio.cpp: "from test on rp2040 and rp2350 hw
/// the loop overhead is 26 and not 27"). This is a program of our own with its instructions' kinds in its order: both
/// ways through each fork, delays, a pin read back, a push without blocking in the inner loop, and the wrap from the
/// last of 32 instructions, which is the one cycle that its author had counted too much.
#[test]
fn a_loop_of_26_cycles() {
    let program = pio_asm!(
        "pull block",
        "mov x, osr",
        "out null, 9",
        ".wrap_target",
        "out y, 1",
        "jmp !y low",
        "set pins, 1",
        "jmp joined",
        "low:",
        "set pins, 0 [1]",
        "joined:",
        "out y, 1",
        "jmp x-- less",
        "less:",
        "mov pins, x",
        "mov osr, x",
        "jmp pin high",
        "jmp both [6]",
        "high:",
        "mov x, isr",
        "jmp !y up",
        "mov x, !isr",
        "up:",
        "jmp x-- counted",
        "counted:",
        "mov isr, !x",
        "jmp y-- kept",
        "mov isr, x",
        "kept:",
        "mov x, osr",
        "both:",
        "out null, 11",
        "mov y, osr",
        "mov osr, x",
        "mov x, isr",
        "period:",
        "push noblock",
        "mov isr, x",
        "jmp y-- period",
        "mov x, osr",
        "out y, 9",
        "jmp !y 0",
        ".wrap"
    )
    .program;
    assert_eq!(program.code.len(), 32);
    for (period, up, direction) in [(0u32, 0u32, 0u32), (1, 1, 0), (5, 0, 1), (100, 1, 1)] {
        let mut bench = Bench::new();
        M.load(&mut bench, &program, 0);
        M.outputs(&mut bench, 14, 2);
        // OUT, and JMP PIN, are the step pin 14; SET is the direction pin 15.
        bench.set(M.pinctrl(), 1 << 20 | 14 | 1 << 26 | 15 << 5);
        let execctrl = bench.get(M.execctrl());
        bench.set(M.execctrl(), execctrl | 14 << 24);
        // Ten half periods: five pulses.
        M.push(&mut bench, period << 11 | up << 10 | direction << 9 | 10);
        M.enable(&mut bench);
        bench.run(10_000);
        let edges = bench.edges(14);
        assert_eq!(edges.len(), 10);
        let gaps: Vec<u64> = edges.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        assert_eq!(gaps, [26 + 3 * u64::from(period); 9], "period {period}, up {up}, direction {direction}");
    }
}
