//! Instructions of ARMv7-M that `cargo xtask cross-check` cannot compare, or not in all respects: cycles, accesses, and
//! what the private registers change (ARM DDI 0403E; TRM DDI 0337). What each instruction computes is compared there.

use crate::arm_common::{Access, CODE, NOP, RAM, SLOW};
use crate::m3_common::{CCR, CFSR, M3Bench};
use proptest::prelude::*;
use pulsetrain_emulator::arm::{FaultCause, M3Options, Size};

/// Code, and the cycles of its instructions by the TRM's table, with a pipeline that fills again in 2.
#[test]
fn cycles() {
    let check = |name: &str, code: &[u16], expected: &[u32]| {
        let mut bench = M3Bench::with(code);
        for number in 0..8 {
            bench.cpu.set_register(number, RAM + 0x4000 + 0x40 * number as u32);
        }
        // A divisor, a dividend and the place in a table of jumps.
        bench.cpu.set_register(8, 7);
        bench.cpu.set_register(9, 700);
        bench.cpu.set_register(10, 0);
        assert_eq!(bench.cycles(expected.len()), expected, "{name}: {:?}", bench.cpu.fault());
    };
    check("movs, adds, lsls, muls", &[0x2001, 0x3001, 0x0080, 0x4348], &[1, 1, 1, 1]);
    check("movw, add.w, ubfx, clz", &[0xf240, 0x1000, 0xeb00, 0x0001, 0xf3c0, 0x0007, 0xfab0, 0xf080], &[1, 1, 1, 1]);
    check("mla, mls", &[0xfb00, 0x1002, 0xfb00, 0x1012], &[2, 2]);
    // Both factors have more than 16 bits.
    check(
        "umull, smull, umlal, smlal",
        &[0xfba0, 0x4501, 0xfb80, 0x4501, 0xfbe0, 0x4501, 0xfbc0, 0x4501],
        &[5, 5, 6, 7],
    );
    check("umull of short factors", &[0xfba8, 0x4509], &[3]);
    check("udiv r0, r9, r8; udiv r0, r8, r9", &[0xfbb9, 0xf0f8, 0xfbb8, 0xf0f9], &[5, 2]);
    check("b", &[0xe000, NOP, NOP], &[3, 1]);
    check("beq, which is not taken; bne", &[0x2001, 0xd000, 0xd100, NOP, NOP], &[1, 1, 3, 1]);
    check("cbz, not taken and taken", &[0x2001, 0xb100, 0x2000, 0xb100, NOP, NOP], &[1, 1, 1, 3]);
    check("bl", &[0xf000, 0xf800], &[3]);
    check("bx r0", &[0x4700], &[3]);
    check("mov pc, r0", &[0x4687], &[3]);
    check("it eq; moveq; movne", &[0x2800, 0xbf08, 0x2001, NOP], &[1, 1, 1, 1]);
    check("ldr r0, [r1]; nop", &[0x6808, NOP], &[2, 1]);
    check("str r0, [r1]; nop", &[0x6008, NOP], &[1, 1]);
    check("str r0, [r1, r10]", &[0xf841, 0x000a], &[2]);
    check("ldmia r0!, {r1, r2, r3}", &[0xc80e], &[4]);
    check("stmia r0!, {r1, r2, r3}", &[0xc00e], &[4]);
    check("push {r0-r7}; pop {r0-r7}", &[0xb4ff, 0xbcff], &[9, 9]);
    check("ldrd, strd", &[0xe9d0, 0x2300, 0xe9c1, 0x2300], &[3, 3]);
    check("tbb [pc, r10]", &[0xe8df, 0xf00a, 0x0001], &[4]);
    check("mrs, msr, cpsie", &[0xf3ef, 0x8010, 0xf380, 0x8810, 0xb662], &[2, 2, 2]);
    check("dsb, isb", &[0xf3bf, 0x8f4f, 0xf3bf, 0x8f6f], &[1, 3]);
    check("ldrex, strex", &[0xe851, 0x0f00, 0xe841, 0x2000], &[2, 2]);
}

/// The TRM's examples of pipelined loads, and pairs that cannot be pipelined.
#[test]
fn loads_overlap() {
    let check = |name: &str, code: &[u16], expected: &[u32]| {
        let mut bench = M3Bench::with(code);
        for number in 0..6 {
            bench.cpu.set_register(number, RAM + 0x4000 + 0x40 * number as u32);
        }
        bench.memory.set_word(RAM + 0x4040, RAM + 0x4100);
        bench.cpu.set_register(2, 8);
        bench.cpu.set_register(5, 4);
        assert_eq!(bench.cycles(expected.len()), expected, "{name}");
    };
    check("ldr r0, [r1]; ldr r4, [r3]: three", &[0x6808, 0x681c], &[2, 1]);
    check("ldr r0, [r1, r2]; str r0, [r3, #20]: three", &[0x5888, 0x6158], &[2, 1]);
    check("ldr r0, [r1, r2]; str r1, [r3, r2]: three", &[0x5888, 0x5099], &[2, 1]);
    check("ldr r0, [r1, r5]; ldr r1, [r3]; ldr r4, [r3, #4]: four", &[0x5948, 0x6819, 0x685c], &[2, 1, 1]);
    check("ldr r3, [r1]; ldr r4, [r3]: the address is what was loaded", &[0x680b, 0x681c], &[2, 2]);
    check("ldr r0, [r1]; nop; ldr r4, [r3]", &[0x6808, NOP, 0x681c], &[2, 1, 2]);
    check("str r0, [r1]; ldr r4, [r3]: nothing is pipelined behind a store", &[0x6008, 0x681c], &[1, 2]);
    check("ldrd r0, r2, [r1]; ldr r4, [r3]", &[0xe9d1, 0x0200, 0x681c], &[3, 2]);
}

/// A store to slow memory (three cycles more) is waited for by the next access only.
#[test]
fn the_store_buffer() {
    let store_then = |then: &[u16], expected: &[u32]| {
        let mut bench = M3Bench::with(&[&[0x6008], then].concat()); // str r0, [r1]
        bench.cpu.set_register(1, SLOW + 0x100);
        bench.cpu.set_register(2, RAM + 0x4000);
        assert_eq!(bench.cycles(expected.len()), expected);
        bench
    };
    store_then(&[NOP, NOP, NOP, NOP, 0x6813], &[1, 1, 1, 1, 1, 2]);
    // The load's address follows the last of the store's four cycles of data: 3 of these are waited for.
    let bench = store_then(&[0x6813], &[1, 2 + 3]); // ldr r3, [r2]
    assert_eq!(bench.memory.accesses.iter().map(|access| access.cycle).collect::<Vec<_>>(), [1, 5]);
    store_then(&[NOP, 0x6813], &[1, 1, 2 + 2]);
    store_then(&[0x6008, NOP], &[1, 1 + 3, 1]);
    store_then(&[0xf3bf, 0x8f4f], &[1, 4]); // dsb
}

#[test]
fn unaligned_accesses() {
    let check = |code: &[u16], address: u32, cycles: u32, parts: &[(u32, Size)]| {
        let mut bench = M3Bench::with(code);
        bench.memory.set_word(RAM + 0x4000, 0x4433_2211);
        bench.memory.set_word(RAM + 0x4004, 0x8877_6655);
        bench.cpu.set_register(0, 0xddcc_bbaa);
        bench.cpu.set_register(1, address);
        assert_eq!(bench.cycles(1), [cycles]);
        let seen: Vec<_> = bench.memory.accesses.iter().map(|access| (access.address, access.size)).collect();
        assert_eq!(seen, parts);
        bench
    };
    let at = RAM + 0x4000;
    let (ldr, ldrh, str) = (0x6808, 0x8808, 0x6008);
    let bench = check(&[ldr], at + 2, 3, &[(at + 2, Size::Half), (at + 4, Size::Half)]);
    assert_eq!(bench.cpu.register(0), 0x6655_4433);
    let bench = check(&[ldr], at + 1, 4, &[(at + 1, Size::Byte), (at + 2, Size::Half), (at + 4, Size::Byte)]);
    assert_eq!(bench.cpu.register(0), 0x5544_3322);
    let bench = check(&[ldrh], at + 1, 3, &[(at + 1, Size::Byte), (at + 2, Size::Byte)]);
    assert_eq!(bench.cpu.register(0), 0x3322);
    // The store buffer takes it.
    let bench = check(&[str], at + 3, 1, &[(at + 3, Size::Byte), (at + 4, Size::Half), (at + 6, Size::Byte)]);
    assert_eq!((bench.memory.word(at), bench.memory.word(at + 4)), (0xaa33_2211, 0x88dd_ccbb));

    for (code, address, traps) in [
        (&[ldr][..], at + 2, true),
        (&[0xc904][..], at + 2, false),         // ldmia r1!, {r2}
        (&[0xe9d1, 0x2300][..], at + 2, false), // ldrd r2, r3, [r1]
        (&[0xe851, 0x2f00][..], at + 2, false), // ldrex r2, [r1]
    ] {
        let mut bench = M3Bench::with(code);
        bench.poke(CCR, 1 << 9 | u32::from(traps) << 3);
        bench.cpu.set_register(1, address);
        bench.step();
        assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(FaultCause::Unaligned { address }));
        bench.reach(crate::arm_common::handler(3));
        assert_eq!(bench.peek(CFSR), 1 << 24);
    }
}

/// A word of the alias at 0x2200_0000 is a bit of the memory at 0x2000_0000.
#[test]
fn bit_band() {
    let address = RAM + 0x4004;
    let alias = 0x2200_0000 + 0x4004 * 32 + 4 * 9;
    let mut bench = M3Bench::with(&[0x6008, 0x6808, 0x7008, 0x780b]); // str r0, [r1]; ldr r0, [r1]; strb; ldrb r3
    bench.memory.set_word(address, 0x0f0f_0d0f);
    bench.cpu.set_register(0, 0xffff_ffff);
    bench.cpu.set_register(1, alias);
    bench.step();
    assert_eq!(bench.memory.word(address), 0x0f0f_0f0f);
    let [read, write] = bench.memory.accesses[..] else { panic!("two accesses") };
    assert_eq!((read.address, read.written, write.written), (address, None, Some(0x0f0f_0f0f)));
    bench.step();
    assert_eq!(bench.cpu.register(0), 1);
    bench.cpu.set_register(0, 0xfe);
    bench.cycles(2);
    assert_eq!((bench.memory.word(address), bench.cpu.register(3)), (0x0f0f_0d0f, 0));
}

#[test]
fn division_by_zero() {
    let mut bench = M3Bench::with(&[0xfbb0, 0xf2f1, 0xfb90, 0xf2f1]); // udiv r2, r0, r1; sdiv
    bench.cpu.set_register(0, 5);
    bench.cpu.set_register(2, 9);
    bench.step();
    assert_eq!(bench.cpu.register(2), 0);
    bench.poke(CCR, 1 << 9 | 1 << 4);
    bench.step();
    assert_eq!(bench.cpu.fault().map(|fault| (fault.cause, fault.pc)), Some((FaultCause::DivideByZero, CODE + 4)));
}

/// A store is exclusive if nothing came between it and its load: another one, `clrex`, or an exception.
#[test]
fn exclusive_access() {
    let (ldrex, strex, clrex) = ([0xe851, 0x0f00], [0xe841, 0x2300], [0xf3bf, 0x8f2f]);
    let run = |code: &[u16], steps: usize, interrupt: bool| {
        let mut bench = M3Bench::with(code);
        bench.poke(crate::m3_common::ISER, 1);
        bench.memory.set_word(RAM + 0x4000, 0);
        bench.cpu.set_register(1, RAM + 0x4000);
        bench.cpu.set_register(2, 0x1234);
        bench.step();
        if interrupt {
            bench.cpu.set_irq_lines(1);
            bench.reach(crate::arm_common::handler(16));
            bench.cpu.set_irq_lines(0);
        }
        while bench.cpu.pc() != CODE + 4 {
            bench.step();
        }
        bench.cycles(steps - 1);
        (bench.cpu.register(3), bench.memory.word(RAM + 0x4000))
    };
    assert_eq!(run(&[ldrex, strex].concat(), 2, false), (0, 0x1234));
    assert_eq!(run(&[ldrex, clrex, strex].concat(), 3, false), (1, 0));
    assert_eq!(run(&[ldrex, strex].concat(), 2, true), (1, 0));
    assert_eq!(run(&[ldrex, strex, strex].concat(), 3, false), (1, 0x1234), "the second store is not exclusive");
}

/// An IT block executes or skips each of its instructions, and one that is skipped takes a cycle.
#[test]
fn it_blocks() {
    // cmp r0, #1; ittee eq; addeq r1, #1; ldreq r3, [r2]; addne r1, #2; addne r1, #4; adds r1, #8
    let code = [0x2801, 0xbf07, 0x3101, 0x6813, 0x3102, 0x3104, 0x3108];
    for (r0, sum, cycles) in [(1, 9, [1, 1, 1, 2, 1, 1, 1]), (0, 14, [1, 1, 1, 1, 1, 1, 1])] {
        let mut bench = M3Bench::with(&code);
        bench.cpu.set_register(0, r0);
        bench.cpu.set_register(2, RAM);
        assert_eq!(bench.cycles(7), cycles);
        assert_eq!(bench.cpu.register(1), sum);
    }
}

/// P of the TRM's table is a choice.
#[test]
fn refill() {
    for refill in 1..4 {
        let mut bench = M3Bench::with_options(&[0xe000], M3Options { refill, ..M3Options::default() });
        assert_eq!(bench.step(), 1 + refill);
    }
}

/// Each access of an instruction with many is a cycle, the address coming first.
#[test]
fn accesses_of_many() {
    let mut bench = M3Bench::with(&[0xe920, 0x000e]); // stmdb r0!, {r1, r2, r3}
    bench.cpu.set_register(0, RAM + 0x4010);
    (1..4).for_each(|number| bench.cpu.set_register(number, 100 + number as u32));
    bench.step();
    let access = |at: u32| Access {
        cycle: u64::from(at) + 1,
        address: RAM + 0x4004 + 4 * at,
        size: Size::Word,
        written: Some(101 + at),
    };
    assert_eq!(bench.memory.accesses, [access(0), access(1), access(2)]);
    assert_eq!(bench.cpu.register(0), RAM + 0x4004);
}

proptest! {
    /// Whatever code and lines do, each step takes time, and a processor that is not locked up goes on.
    #[test]
    fn any_code(code in prop::collection::vec(any::<u16>(), 500), lines in prop::collection::vec(any::<u64>(), 20), r in any::<[u32; 8]>()) {
        let mut bench = M3Bench::with(&code);
        bench.poke(crate::m3_common::ISER, u32::MAX);
        bench.memory.set_code(crate::arm_common::handler(3), &code);
        for (number, value) in r.into_iter().enumerate() {
            // Some are addresses of memory, or of the processor's own registers.
            let value = if number % 2 == 0 { RAM + value % 0x1_0000 } else { value };
            bench.cpu.set_register(number, if number == 7 { 0xe000_ed00 | value & 0xff } else { value });
        }
        for line in lines {
            bench.cpu.set_irq_lines(line);
            for _ in 0..100 {
                let before = bench.now();
                let cycles = bench.step();
                prop_assert!((1..=64).contains(&cycles), "{cycles}");
                prop_assert_eq!(bench.now(), before + u64::from(cycles));
                prop_assert_eq!(bench.cpu.pc() % 2, 0);
                prop_assert_eq!(bench.cpu.register(13) % 4, 0);
            }
        }
        prop_assert!(!bench.cpu.is_locked_up() || bench.cpu.fault().is_some());
    }
}
