//! Exceptions of the Cortex-M3: entry, return, priorities, masks, faults (ARMv7-M ARM DDI 0403E §B1.5; TRM DDI 0337). What
//! it has in common with the Cortex-M0+ (levels and pulses, sleep, SysTick, both stacks) is tested there.

use crate::arm_common::{BX_LR, CODE, NOP, RAM, STACK, handler};
use crate::m3_common::{CCR, CFSR, HFSR, IPR, ISER, ISPR, M3Bench, SHCSR};
use pulsetrain_emulator::arm::{FaultCause, M3Options, Mode};

const ICTR: u32 = 0xe000_e004;
const ICER: u32 = 0xe000_e180;
const IABR: u32 = 0xe000_e300;
const ICSR: u32 = 0xe000_ed04;
const VTOR: u32 = 0xe000_ed08;
const AIRCR: u32 = 0xe000_ed0c;
const SHPR1: u32 = 0xe000_ed18;
const SHPR3: u32 = 0xe000_ed20;
const BFAR: u32 = 0xe000_ed38;
const DEMCR: u32 = 0xe000_edfc;
const STIR: u32 = 0xe000_ef00;
const DWT_CTRL: u32 = 0xe000_1000;
const DWT_CYCCNT: u32 = 0xe000_1004;

const HARD_FAULT: u32 = 3;
const BUS_FAULT: u32 = 5;
const USAGE_FAULT: u32 = 6;
const SVCALL: u32 = 11;
const PENDSV: u32 = 14;
const IRQ: u32 = 16;

/// `msr basepri, r0`, `msr basepri_max, r0`, `msr faultmask, r0`.
const MSR_BASEPRI: [u16; 2] = [0xf380, 0x8811];
const MSR_BASEPRI_MAX: [u16; 2] = [0xf380, 0x8812];
const MSR_FAULTMASK: [u16; 2] = [0xf380, 0x8813];
const UNDEFINED: u16 = 0xde00;

/// A program of `nop`, all interrupts enabled.
fn nops() -> M3Bench {
    let mut bench = M3Bench::with(&[NOP; 400]);
    bench.poke(ISER, u32::MAX);
    bench.poke(ISER + 4, u32::MAX);
    bench
}

/// TRM: 12 cycles to the handler, the registers of §B1.5.6 on the stack; back in as many as the drawings mean.
#[test]
fn entry_and_return() {
    for (sp, frame, padding) in [(STACK, STACK - 32, 0), (STACK - 4, STACK - 40, 1)] {
        let mut bench = nops();
        for number in 0..13 {
            bench.cpu.set_register(number, 0x100 + number as u32);
        }
        bench.cpu.set_register(13, sp);
        bench.cpu.set_register(14, 0x1234_5679);
        bench.cpu.set_xpsr(0x9800_0000);
        let (began, pc) = (bench.now(), bench.cpu.pc());
        bench.cpu.set_irq_lines(1 << 40);
        assert_eq!(bench.reach(handler(IRQ + 40)), began + 12);
        let words: Vec<u32> = (0..8).map(|at| bench.memory.word(frame + 4 * at)).collect();
        assert_eq!(words, [0x100, 0x101, 0x102, 0x103, 0x10c, 0x1234_5679, pc, 0x9900_0000 | padding << 9]);
        assert_eq!((bench.cpu.register(13), bench.cpu.register(14)), (frame, 0xffff_fff9));
        assert_eq!((bench.cpu.xpsr() & 0x1ff, bench.cpu.mode()), (IRQ + 40, Mode::Handler));
        assert_eq!(bench.peek(IABR + 4), 1 << 8);

        bench.cpu.set_irq_lines(0);
        bench.cpu.set_register(0, 0);
        bench.cpu.set_xpsr(0);
        let returned = bench.now() + 1 + 12;
        assert_eq!(bench.reach(pc), returned);
        assert_eq!((bench.cpu.register(0), bench.cpu.register(13), bench.cpu.xpsr()), (0x100, sp, 0x9900_0000));
    }
    let options = M3Options { return_cycles: 10, ..M3Options::default() };
    let mut bench = M3Bench::with_options(&[NOP; 100], options);
    bench.poke(ISER, 1);
    bench.poke(ISPR, 1);
    let pc = bench.cpu.pc();
    let entered = bench.reach(handler(IRQ));
    assert_eq!(bench.reach(pc), entered + 1 + 10);
}

/// CCR.STKALIGN off: the frame is where the stack pointer was.
#[test]
fn an_unaligned_frame() {
    let mut bench = nops();
    bench.poke(CCR, 0);
    bench.cpu.set_register(13, STACK - 4);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    assert_eq!(bench.cpu.register(13), STACK - 36);
    assert_eq!(bench.memory.word(STACK - 36 + 28) >> 9 & 1, 0);
}

/// TRM: 6 cycles from a handler's end to the next handler; what is more urgent and comes while registers are saved is
/// handled first, without delay.
#[test]
fn late_arrival_and_tail_chaining() {
    let mut bench = nops();
    bench.poke(IPR, 0x0000_4080);
    let (began, pc) = (bench.now(), bench.cpu.pc());
    bench.cpu.set_irq_lines(1);
    assert_eq!(bench.step(), 8);
    bench.cpu.set_irq_lines(0b11);
    assert_eq!(bench.reach(handler(IRQ + 1)), began + 12);
    bench.cpu.set_irq_lines(0);
    let ended = bench.now() + 1;
    assert_eq!(bench.reach(handler(IRQ)), ended + 6);
    assert_eq!((bench.cpu.register(13), bench.cpu.register(14)), (STACK - 32, 0xffff_fff9));
    let ended = bench.now() + 1;
    assert_eq!(bench.reach(pc), ended + 12);
}

/// An exception that comes while registers are restored begins 7 to 18 cycles after the handler's end.
#[test]
fn an_interrupted_return() {
    for late in 0..12 {
        let mut bench = nops();
        bench.cpu.set_irq_lines(1);
        bench.reach(handler(IRQ));
        bench.cpu.set_irq_lines(0);
        bench.step();
        let ended = bench.now();
        bench.run_to(ended + late);
        bench.cpu.set_irq_lines(2);
        assert_eq!(bench.reach(handler(IRQ + 1)), ended + late + 7);
        assert_eq!((bench.cpu.register(13), bench.cpu.register(14)), (STACK - 32, 0xffff_fff9));
        bench.cpu.set_irq_lines(0);
        let pc = bench.memory.word(STACK - 32 + 24);
        bench.reach(pc);
        assert_eq!(bench.cpu.register(13), STACK);
    }
}

/// §B1.5.4: four bits of priority; those of the group preempt, the others only decide who is first.
#[test]
fn priorities_and_groups() {
    let mut bench = nops();
    bench.poke(IPR + 44, u32::MAX);
    assert_eq!(bench.peek(IPR + 44), 0xf0, "four bits; 45 interrupts");
    bench.poke(IPR, 0x1020_3040);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    bench.cpu.set_irq_lines(0b1111);
    bench.reach(handler(IRQ + 3));
    assert_eq!(bench.cpu.register(14), 0xffff_fff1, "0x10 preempts 0x40");

    // PRIGROUP 5: bits 7 and 6 are the group, 5 and 4 the order within it.
    let mut bench = nops();
    bench.poke(AIRCR, 0x05fa_0500);
    assert_eq!(bench.peek(AIRCR), 0xfa05_0500);
    bench.poke(IPR, 0x3f10_2030);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    bench.cpu.set_irq_lines(0b0111);
    bench.step();
    assert_eq!(bench.cpu.pc(), handler(IRQ), "the return is interrupted, the same group does not preempt");
    bench.cpu.set_irq_lines(0b0110);
    bench.reach(handler(IRQ + 2));
    bench.cpu.set_irq_lines(0b0010);
    bench.reach(handler(IRQ + 1));
    bench.cpu.set_irq_lines(0);

    // Without its key AIRCR stays.
    bench.poke(AIRCR, 0x0700);
    assert_eq!(bench.peek(AIRCR), 0xfa05_0500);
    // A byte alone.
    bench.memory.set_code(RAM + 0xe000, &[0x7008]); // strb r0, [r1]
    for (number, value) in [(0, 0xa0), (1, IPR + 2), (15, RAM + 0xe000)] {
        bench.cpu.set_register(number, value);
    }
    bench.step();
    assert_eq!(bench.peek(IPR), 0x30a0_2030);
}

/// §B1.4.3: BASEPRI keeps out what is not more urgent, PRIMASK all, FAULTMASK also HardFault.
#[test]
fn masks() {
    let code = [&MSR_BASEPRI[..], &MSR_BASEPRI_MAX, &MSR_FAULTMASK, &[NOP; 50]].concat();
    let mut bench = M3Bench::with(&code);
    bench.poke(ISER, 0b11);
    bench.poke(IPR, 0x4030);
    bench.cpu.set_register(0, 0x4f);
    bench.step();
    assert_eq!(bench.cpu.basepri(), 0x40);
    bench.cpu.set_irq_lines(0b10);
    bench.cpu.set_register(0, 0x80);
    bench.step();
    assert_eq!(bench.cpu.basepri(), 0x40, "basepri_max only grows more urgent");
    assert_eq!(bench.cpu.pc(), CODE + 8, "0x40 is kept out");
    bench.cpu.set_irq_lines(0b11);
    bench.reach(handler(IRQ));
    bench.cpu.set_irq_lines(0b10);
    bench.reach(CODE + 8);
    bench.cpu.set_register(0, 1);
    bench.step();
    assert!(bench.cpu.faultmask());
    bench.cpu.set_irq_lines(0b11);
    bench.cycles(10);
    assert_eq!(bench.cpu.mode(), Mode::Thread);
    bench.cpu.set_nmi_line(true);
    bench.reach(handler(2));
    bench.cpu.set_nmi_line(false);
    bench.cycles(20);
    assert!(bench.cpu.faultmask(), "an NMI leaves it");
    // A fault now has nowhere to go.
    bench.memory.set_code(bench.cpu.pc(), &[UNDEFINED]);
    bench.step();
    assert!(bench.cpu.is_locked_up());

    // A handler's end clears FAULTMASK.
    let mut bench = nops();
    bench.memory.set_code(handler(IRQ), &[&MSR_FAULTMASK[..], &[BX_LR]].concat());
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    bench.cpu.set_irq_lines(0);
    bench.cpu.set_register(0, 1);
    bench.step();
    assert!(bench.cpu.faultmask());
    bench.cycles(15);
    assert_eq!((bench.cpu.faultmask(), bench.cpu.mode()), (false, Mode::Thread));

    // `wfi` ends by what PRIMASK keeps out, but not by what BASEPRI does.
    for (mask, value, wakes) in [([0xf380, 0x8810], 1, true), (MSR_BASEPRI, 0x20, false)] {
        let mut bench = M3Bench::with(&[&mask[..], &[0xbf30, NOP]].concat());
        bench.poke(ISER, 1);
        bench.poke(IPR, 0x40);
        bench.cpu.set_register(0, value);
        bench.cycles(2);
        bench.cpu.set_irq_lines(1);
        assert_eq!(bench.cpu.is_asleep(), !wakes);
        bench.cycles(3);
        assert_eq!(bench.cpu.mode(), Mode::Thread);
    }
}

/// §B1.5.14: a fault has an exception of its own if that is enabled and urgent enough; else it is a HardFault.
#[test]
fn faults() {
    let ldr = 0x6808; // ldr r0, [r1]
    for (code, cause, exception, status, number) in [
        (vec![UNDEFINED], FaultCause::Undefined, USAGE_FAULT, 1 << 16, 18),
        (vec![0xee00, 0x0a10], FaultCause::NoCoprocessor, USAGE_FAULT, 1 << 19, 18),
        (vec![0x4708], FaultCause::NotThumb, USAGE_FAULT, 1 << 17, 18), // bx r1
        (vec![ldr], FaultCause::Bus { address: 0x6000_0000 }, BUS_FAULT, 1 << 9 | 1 << 15, 17),
    ] {
        let mut bench = M3Bench::with(&code);
        bench.cpu.set_register(1, 0x6000_0000);
        bench.reach(handler(HARD_FAULT));
        assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(cause));
        assert_eq!((bench.peek(CFSR), bench.peek(HFSR)), (status, 1 << 30));
        bench.poke(CFSR, status);
        bench.poke(HFSR, u32::MAX);
        assert_eq!((bench.peek(CFSR), bench.peek(HFSR)), (0, 0));

        let mut bench = M3Bench::with(&code);
        bench.poke(SHCSR, 7 << 16);
        bench.cpu.set_register(1, 0x6000_0000);
        bench.reach(handler(exception));
        assert_eq!((bench.peek(CFSR), bench.peek(HFSR)), (status, 0));
        assert_eq!(bench.peek(SHCSR) & 0xf, if exception == BUS_FAULT { 2 } else { 8 });
        assert_eq!(bench.peek(SHCSR) >> 16, 7, "{number}");
        if exception == BUS_FAULT {
            assert_eq!(bench.peek(BFAR), 0x6000_0000);
        }
        assert!(!bench.cpu.is_locked_up());
    }

    // Enabled, but not more urgent than the handler in which it happens.
    let mut bench = nops();
    bench.poke(SHCSR, 7 << 16);
    bench.poke(SHPR1, 0x0080_8080);
    assert_eq!(bench.peek(SHPR1), 0x0080_8080);
    bench.poke(IPR, 0x80);
    bench.memory.set_code(handler(IRQ), &[UNDEFINED]);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(HARD_FAULT));
    assert_eq!(bench.peek(HFSR), 1 << 30);

    // `bkpt` without a debugger.
    let mut bench = M3Bench::with(&[0xbe00]);
    bench.reach(handler(HARD_FAULT));
    assert_eq!(bench.peek(HFSR), 1 << 31);

    // A fault in HardFault's handler.
    bench.memory.set_code(handler(HARD_FAULT), &[UNDEFINED]);
    bench.step();
    assert!(bench.cpu.is_locked_up());
}

/// A block after IT goes on where it was interrupted, and its handler is not conditional.
#[test]
fn an_interrupted_block() {
    // cmp r0, r0; itete eq; addeq r1, #1; addne r1, #16; addeq r1, #2; addne r1, #16
    let mut bench = M3Bench::with(&[0x4280, 0xbf0b, 0x3101, 0x3110, 0x3102, 0x3110, NOP]);
    bench.poke(ISER, 1);
    bench.memory.set_code(handler(IRQ), &[0x2800, 0x3201, BX_LR]); // cmp r0, #0; adds r2, #1
    bench.cpu.set_register(0, 1);
    bench.cycles(3);
    for _ in 0..2 {
        bench.cpu.set_irq_lines(1);
        bench.reach(handler(IRQ));
        assert_eq!(bench.cpu.xpsr() & 0x0600_fc00, 0);
        bench.cpu.set_irq_lines(0);
        let back = bench.memory.word(bench.cpu.register(13) + 24);
        bench.reach(back);
        bench.step();
    }
    bench.reach(CODE + 12);
    assert_eq!((bench.cpu.register(1), bench.cpu.xpsr() & 0x0600_fc00), (3, 0));
}

#[test]
fn system_registers() {
    let mut bench = nops();
    assert_eq!(bench.peek(ICTR), 1);
    bench.poke(VTOR, u32::MAX);
    assert_eq!(bench.peek(VTOR), 0x3fff_ff80);
    bench.poke(VTOR, RAM);
    bench.poke(SHPR3, 0xf0e0_0000);
    assert_eq!(bench.peek(SHPR3), 0xf0e0_0000);
    bench.poke(ICER + 4, 1 << 12);
    bench.poke(STIR, 44);
    assert_eq!(bench.peek(ISPR + 4), 1 << 12);
    assert_eq!(bench.peek(ICSR), 1 << 22 | 1 << 11);
    bench.poke(ISER + 4, 1 << 12);
    bench.reach(handler(IRQ + 44));
    bench.poke(ICSR, 1 << 28);
    assert_eq!(bench.peek(ICSR), 1 << 28 | PENDSV << 12 | 1 << 11 | (IRQ + 44));
    bench.reach(handler(PENDSV));
    bench.poke(STIR, 45);
    assert_eq!(bench.peek(ISPR + 4), 0, "there is no such interrupt");

    // The cycle counter counts with tracing on.
    bench.poke(DWT_CTRL, 1);
    assert_eq!(bench.peek(DWT_CYCCNT), 0);
    bench.poke(DEMCR, 1 << 24);
    let before = bench.peek(DWT_CYCCNT);
    let began = bench.now();
    bench.run_to(began + 100);
    assert_eq!(u64::from(bench.peek(DWT_CYCCNT) - before), bench.now() - began);
    bench.poke(AIRCR, 0x05fa_0004);
    assert_eq!(bench.memory.resets, 1);
}

/// `svc` is entered after it; where BASEPRI keeps it out it is a HardFault.
#[test]
fn supervisor_calls() {
    let mut bench = M3Bench::with(&[&[0xdf00][..], &MSR_BASEPRI, &[0xdf00]].concat());
    assert_eq!(bench.reach(handler(SVCALL)), 13);
    assert_eq!(bench.memory.word(bench.cpu.register(13) + 24), CODE + 2);
    bench.reach(CODE + 2);
    bench.poke(0xe000_ed1c, 0x8000_0000);
    bench.cpu.set_register(0, 0x80);
    bench.reach(handler(HARD_FAULT));
    assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(FaultCause::Supervisor));
}

/// CCR.NONBASETHRDENA: a handler may return to the thread although another is active.
#[test]
fn a_return_past_another_handler() {
    for (ccr, allowed) in [(1 << 9 | 1, true), (1 << 9, false)] {
        let mut bench = nops();
        bench.poke(CCR, ccr);
        bench.poke(IPR, 0x4080);
        bench.cpu.set_irq_lines(1);
        bench.reach(handler(IRQ));
        bench.cpu.set_irq_lines(3);
        bench.reach(handler(IRQ + 1));
        bench.cpu.set_irq_lines(1);
        bench.cpu.set_register(14, 0xffff_fff9);
        bench.cycles(14);
        assert_eq!(bench.cpu.fault().is_none(), allowed);
        assert_eq!(bench.cpu.mode() == Mode::Thread, allowed);
    }
}

/// CONTROL.nPRIV: a program without privileges changes no mask and reaches no private register, but STIR if CCR lets it.
#[test]
fn without_privileges() {
    const MSR_CONTROL: [u16; 2] = [0xf380, 0x8814];
    let program = |then: &[u16]| {
        let mut bench = M3Bench::with(&[&MSR_CONTROL[..], then].concat());
        bench.poke(ISER, u32::MAX);
        bench.poke(CCR, 1 << 9 | 1 << 1);
        bench.cpu.set_register(0, 1);
        bench.step();
        bench
    };
    let mut bench = program(&[&MSR_BASEPRI[..], &MSR_FAULTMASK, &[0xb672]].concat());
    bench.cpu.set_register(0, 0xff);
    bench.cycles(3);
    assert_eq!((bench.cpu.basepri(), bench.cpu.faultmask(), bench.cpu.primask()), (0, false, false));

    // str r1, [r2]
    for (address, allowed) in [(STIR, true), (ISPR, false), (CCR, false)] {
        let mut bench = program(&[0x6011]);
        bench.cpu.set_register(1, 3);
        bench.cpu.set_register(2, address);
        bench.reach(if allowed { handler(IRQ + 3) } else { handler(HARD_FAULT) });
        assert_eq!(bench.cpu.fault().map(|fault| fault.cause), (!allowed).then_some(FaultCause::Bus { address }));
        // A handler has privileges.
        assert_eq!(bench.peek(CCR), 1 << 9 | 1 << 1);
    }
}

/// CONTROL.SPSEL and sleep on exit: the thread's registers are on its own stack, and it does not go on after the handler.
#[test]
fn process_stack_and_sleep_on_exit() {
    let mut bench = M3Bench::with(&[0xf380, 0x8809, 0xf381, 0x8814, NOP, NOP, NOP]); // msr psp, r0; msr control, r1
    bench.poke(ISER, 1);
    bench.cpu.set_register(0, RAM + 0xa000);
    bench.cpu.set_register(1, 2);
    bench.cycles(2);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    assert_eq!(
        (bench.cpu.psp(), bench.cpu.register(13), bench.cpu.register(14)),
        (RAM + 0xa000 - 32, STACK, 0xffff_fffd)
    );
    bench.poke(0xe000_ed10, 1 << 1);
    bench.cpu.set_irq_lines(0);
    let back = bench.now() + 1 + 12;
    while !bench.cpu.is_asleep() {
        bench.step();
    }
    assert_eq!((bench.now(), bench.cpu.pc(), bench.cpu.register(13)), (back, CODE + 8, RAM + 0xa000));
    bench.cpu.set_irq_lines(1);
    assert_eq!(bench.reach(handler(IRQ)), back + 12);
}
