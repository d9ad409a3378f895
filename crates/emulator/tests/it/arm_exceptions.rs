//! Exceptions, interrupts, faults, sleep and SysTick (ARMv6-M ARM DDI 0419E §B1.5, §B3; TRM DDI 0484C §3.6.1).

use proptest::prelude::*;

use crate::arm_common::{BX_LR, Bench, CODE, NOP, PROCESS_STACK, RAM, STACK, VECTORS, handler};
use pulsetrain_emulator::arm::{FaultCause, Mode};

const CPSID: u16 = 0xb672;
const CPSIE: u16 = 0xb662;
const WFE: u16 = 0xbf20;
const WFI: u16 = 0xbf30;
const SEV: u16 = 0xbf40;
const SVC: u16 = 0xdf00;
const BKPT: u16 = 0xbe00;
const UNDEFINED: u16 = 0xde00;

const SYST_CSR: u32 = 0xe000_e010;
const SYST_RVR: u32 = 0xe000_e014;
const SYST_CVR: u32 = 0xe000_e018;
const SYST_CALIB: u32 = 0xe000_e01c;
const ISER: u32 = 0xe000_e100;
const ICER: u32 = 0xe000_e180;
const ISPR: u32 = 0xe000_e200;
const ICPR: u32 = 0xe000_e280;
const IPR: u32 = 0xe000_e400;
const CPUID: u32 = 0xe000_ed00;
const ICSR: u32 = 0xe000_ed04;
const VTOR: u32 = 0xe000_ed08;
const AIRCR: u32 = 0xe000_ed0c;
const SCR: u32 = 0xe000_ed10;
const CCR: u32 = 0xe000_ed14;
const SHPR2: u32 = 0xe000_ed1c;
const SHPR3: u32 = 0xe000_ed20;

const NMI: u32 = 2;
const HARD_FAULT: u32 = 3;
const SVCALL: u32 = 11;
const PENDSV: u32 = 14;
const SYSTICK: u32 = 15;
const IRQ: u32 = 16;

/// A program of `nop`, all interrupts enabled.
fn nops() -> Bench {
    let mut bench = Bench::with(&[NOP; 200]);
    bench.poke(ISER, u32::MAX);
    bench
}

/// As the manual has it: R0 to R3, R12, LR, return address, XPSR, at an address that is a multiple of 8.
#[test]
fn entry_saves_registers_and_takes_15_cycles() {
    for (sp, frame, padding) in [(STACK, STACK - 32, 0), (STACK - 4, STACK - 40, 1)] {
        let mut bench = nops();
        for number in 0..13 {
            bench.cpu.set_register(number, 0x100 + number as u32);
        }
        bench.cpu.set_register(13, sp);
        bench.cpu.set_register(14, 0x1234_5679);
        bench.cpu.set_flags(0x9000_0000);
        let (began, pc) = (bench.now(), bench.cpu.pc());
        bench.cpu.set_irq_lines(1 << 5);
        assert_eq!(bench.reach(handler(IRQ + 5)), began + 15);
        let words: Vec<u32> = (0..8).map(|at| bench.memory.word(frame + 4 * at)).collect();
        let xpsr = 0x9100_0000 | padding << 9;
        assert_eq!(words, [0x100, 0x101, 0x102, 0x103, 0x10c, 0x1234_5679, pc, xpsr]);
        assert_eq!((bench.cpu.register(13), bench.cpu.register(14)), (frame, 0xffff_fff9));
        assert_eq!((bench.cpu.xpsr() & 0x3f, bench.cpu.mode()), (IRQ + 5, Mode::Handler));

        bench.cpu.set_irq_lines(0);
        for number in [0, 1, 2, 3, 12] {
            bench.cpu.set_register(number, 0);
        }
        bench.cpu.set_flags(0);
        // bx: 2, and then as pop of eight registers with the program counter: 3 + 8.
        let returned = bench.now() + 2 + 11;
        assert_eq!(bench.reach(pc), returned);
        for number in 0..13 {
            assert_eq!(bench.cpu.register(number), 0x100 + number as u32);
        }
        assert_eq!((bench.cpu.register(13), bench.cpu.register(14)), (sp, 0x1234_5679));
        assert_eq!((bench.cpu.xpsr(), bench.cpu.mode()), (0x9100_0000, Mode::Thread));
    }
}

/// §B1.5.12: what is more urgent and comes while registers are saved is handled first, 15 cycles after what made them
/// be saved; the other follows without unstacking.
#[test]
fn late_arrival_and_tail_chaining() {
    let mut bench = nops();
    bench.poke(IPR, 0x0000_4080);
    let (began, pc) = (bench.now(), bench.cpu.pc());
    bench.cpu.set_irq_lines(1);
    assert_eq!(bench.step(), 12);
    bench.cpu.set_irq_lines(0b11);
    assert_eq!(bench.reach(handler(IRQ + 1)), began + 15);
    let sp = bench.cpu.register(13);
    bench.cpu.set_irq_lines(0);
    let ended = bench.now() + 2;
    assert_eq!(bench.reach(handler(IRQ)), ended + 3);
    assert_eq!((bench.cpu.register(13), bench.cpu.register(14)), (sp, 0xffff_fff9));
    let ended = bench.now() + 2;
    assert_eq!(bench.reach(pc), ended + 11);
}

/// §B1.5.4: a lower value preempts; an equal one does not; among equals the lower number is first.
#[test]
fn priorities() {
    let mut bench = nops();
    // Interrupts 0 to 3: 0x80, 0x80, 0x40, 0xc0.
    bench.poke(IPR, 0xffff_ffff);
    assert_eq!(bench.peek(IPR), 0xc0c0_c0c0, "two bits are implemented");
    bench.poke(IPR, 0xc040_8080);
    let pc = bench.cpu.pc();
    bench.cpu.set_irq_lines(0b1011);
    bench.reach(handler(IRQ));
    bench.cpu.set_irq_lines(0b1110);
    let began = bench.now();
    assert_eq!(bench.reach(handler(IRQ + 2)), began + 15, "0x40 preempts 0x80");
    assert_eq!(bench.cpu.register(14), 0xffff_fff1);
    bench.cpu.set_irq_lines(0b1010);
    let ended = bench.now() + 2;
    assert_eq!(bench.reach(handler(IRQ)), ended + 11, "back to the one that was interrupted");
    let ended = bench.now() + 2;
    assert_eq!(bench.reach(handler(IRQ + 1)), ended + 3);
    bench.cpu.set_irq_lines(0b1000);
    bench.reach(handler(IRQ + 3));
    bench.cpu.set_irq_lines(0);
    bench.reach(pc);
    assert_eq!(bench.cpu.register(13), STACK);
}

/// §B3.4.1: a line that is high is pending until it is active, and again when its handler returns; a pulse is kept.
#[test]
fn levels_and_pulses() {
    let mut bench = nops();
    bench.poke(ICER, u32::MAX);
    bench.cpu.set_irq_lines(1 << 4);
    bench.cpu.set_irq_lines(1 << 9);
    assert_eq!(bench.peek(ISPR), 1 << 9 | 1 << 4, "a pulse is kept");
    bench.poke(ICPR, u32::MAX);
    assert_eq!(bench.peek(ICPR), 1 << 9, "what is still high cannot be cleared");
    bench.poke(ISER, 1 << 9);
    bench.reach(handler(IRQ + 9));
    assert_eq!(bench.peek(ICER), 1 << 9);
    assert_eq!(bench.peek(ISPR), 0);
    assert_eq!((bench.step(), bench.step(), bench.cpu.pc()), (2, 3, handler(IRQ + 9)), "still high");
    bench.cpu.set_irq_lines(0);
    bench.cpu.set_irq_lines(1 << 9);
    bench.cpu.set_irq_lines(0);
    assert_eq!(bench.peek(ISPR), 1 << 9, "a pulse during the handler");
    bench.step();
    bench.step();
    assert_eq!(bench.cpu.pc(), handler(IRQ + 9));
    bench.step();
    assert_eq!((bench.cpu.mode(), bench.peek(ISPR)), (Mode::Thread, 0));

    bench.poke(ISER, 1 << 31);
    bench.poke(ISPR, 1 << 9 | 1 << 31);
    bench.reach(handler(IRQ + 9));
    bench.reach(handler(IRQ + 31));
}

/// §B1.4.3: PRIMASK keeps out what has a priority that can be set; `cpsie` lets it in before the next instruction.
#[test]
fn primask() {
    let mut bench = Bench::with(&[CPSID, NOP, NOP, CPSIE, NOP]);
    bench.poke(ISER, 1);
    bench.step();
    bench.cpu.set_irq_lines(1);
    assert_eq!((bench.step(), bench.step(), bench.cpu.pc()), (1, 1, CODE + 6));
    bench.cpu.set_nmi_line(true);
    bench.reach(handler(NMI));
    bench.cpu.set_nmi_line(false);
    bench.reach(CODE + 6);
    let began = bench.now();
    assert_eq!(bench.reach(handler(IRQ)), began + 1 + 15);
    assert_eq!(bench.memory.word(bench.cpu.register(13) + 24), CODE + 8);
}

/// `svc`, PendSV and SysTick by software; the return address of `svc` is the next instruction.
#[test]
fn system_exceptions() {
    let mut bench = Bench::with(&[SVC, NOP, CPSID, SVC]);
    let began = bench.now();
    assert_eq!(bench.reach(handler(SVCALL)), began + 1 + 15);
    bench.reach(CODE + 2);
    assert_eq!(bench.cpu.xpsr() & 0x3f, 0);

    bench.poke(SHPR2, u32::MAX);
    bench.poke(SHPR3, 0x40ff_ffff);
    assert_eq!((bench.peek(SHPR2), bench.peek(SHPR3)), (0xc000_0000, 0x40c0_0000));
    bench.poke(ICSR, 1 << 28 | 1 << 26);
    assert_eq!(bench.reach(handler(SYSTICK)), bench.now());
    assert_eq!(bench.peek(ICSR), 1 << 28 | PENDSV << 12 | SYSTICK);
    bench.reach(handler(PENDSV));
    bench.reach(CODE + 2);
    bench.cpu.set_register(15, CODE + 4);
    bench.step();
    bench.poke(ICSR, 1 << 28 | 1 << 26);
    assert_eq!(bench.peek(ICSR) >> 26, 0b101);
    bench.poke(ICSR, 1 << 27 | 1 << 25);
    assert_eq!(bench.peek(ICSR), 0);

    // PRIMASK is set: the call cannot be entered.
    bench.reach(handler(HARD_FAULT));
    assert_eq!(bench.memory.word(bench.cpu.register(13) + 24), CODE + 6);
    assert_eq!(bench.cpu.fault().map(|fault| (fault.cause, fault.pc)), Some((FaultCause::Supervisor, CODE + 6)));

    bench.poke(ICSR, 1 << 31);
    bench.reach(handler(NMI));
    assert_eq!(bench.cpu.register(14), 0xffff_fff1);
}

/// What faults comes back to the instruction; PRIMASK does not keep HardFault out.
#[test]
fn faults() {
    let ldr = 0x6808; // ldr r0, [r1]
    let blx = 0x4788; // blx r1
    let unaligned = FaultCause::Unaligned { address: RAM + 2 };
    let nowhere = FaultCause::Bus { address: 0x6000_0000 };
    let no_code = FaultCause::Fetch { address: 0x6000_0000 };
    for (instruction, r1, cause, pc) in [
        (ldr, RAM + 2, unaligned, CODE + 2),
        (0x6008, RAM + 2, unaligned, CODE + 2),
        (ldr, 0x6000_0000, nowhere, CODE + 2),
        (0x7008, 0x6000_0000, nowhere, CODE + 2),
        (0x8808, RAM + 1, FaultCause::Unaligned { address: RAM + 1 }, CODE + 2),
        (0xc901, RAM + 2, unaligned, CODE + 2),
        (0x7808, SYST_CSR, FaultCause::Bus { address: SYST_CSR }, CODE + 2),
        (UNDEFINED, 0, FaultCause::Undefined, CODE + 2),
        (BKPT, 0, FaultCause::Breakpoint, CODE + 2),
        (blx, CODE + 8, FaultCause::NotThumb, CODE + 8),
        (blx, 0x6000_0001, no_code, 0x6000_0000),
    ] {
        let mut bench = Bench::with(&[CPSID, instruction]);
        bench.step();
        bench.cpu.set_register(1, r1);
        let sp = bench.cpu.register(13);
        bench.reach(handler(HARD_FAULT));
        let fault = bench.cpu.fault().expect("a fault");
        assert_eq!((fault.cause, fault.pc), (cause, pc), "{instruction:#x}");
        assert_eq!(bench.memory.word(sp - 32 + 24), pc);
        assert_eq!(bench.memory.word(sp - 32 + 4), r1);
        assert_eq!(bench.memory.word(sp - 32 + 28) >> 24 & 1, u32::from(cause != FaultCause::NotThumb), "T bit");
        assert!(!bench.cpu.is_locked_up());
    }
}

/// §B1.5.10: a fault in HardFault's handler, or where it cannot be entered, is the end; but for an NMI.
#[test]
fn lock_up() {
    let mut bench = Bench::with(&[UNDEFINED]);
    bench.memory.set_code(handler(HARD_FAULT), &[BKPT]);
    bench.reach(handler(HARD_FAULT));
    bench.step();
    assert!(bench.cpu.is_locked_up());
    let pc = bench.cpu.pc();
    assert_eq!((bench.step(), bench.step(), bench.cpu.pc()), (1, 1, pc));
    bench.cpu.sleep_until(5000);
    assert_eq!(bench.now(), 5000);
    bench.cpu.set_nmi_line(true);
    assert_eq!(bench.reach(handler(NMI)), 5015);
    assert!(!bench.cpu.is_locked_up());

    let mut bench = Bench::with(&[UNDEFINED]);
    bench.memory.set_word(VECTORS + 4 * HARD_FAULT, handler(HARD_FAULT));
    bench.run_to(100);
    assert!(bench.cpu.is_locked_up(), "an even vector");
    assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(FaultCause::NotThumb));

    // No stack: saving registers faults, and HardFault's handler is entered without them.
    let mut bench = nops();
    bench.cpu.set_register(13, 0x6000_0100);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(HARD_FAULT));
    assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(FaultCause::Frame { address: 0x6000_00e0 }));
    let mut bench = Bench::with(&[UNDEFINED]);
    bench.cpu.set_register(13, 0x6000_0100);
    bench.run_to(100);
    assert!(bench.cpu.is_locked_up());
}

/// §B1.5.8: a value that does not fit what is active faults; as a branch target in the thread it is only an address.
#[test]
fn exception_return_values() {
    for value in [0xffff_fff1_u32, 0xffff_fff0, 0xf000_0009] {
        let mut bench = nops();
        bench.cpu.set_irq_lines(1);
        bench.reach(handler(IRQ));
        bench.cpu.set_register(14, value);
        bench.reach(handler(HARD_FAULT));
        assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(FaultCause::Return { value }));
    }
    let mut bench = Bench::with(&[BX_LR]);
    bench.cpu.set_register(14, 0xffff_fff9);
    bench.step();
    assert_eq!(bench.cpu.pc(), 0xffff_fff8);
    bench.reach(handler(HARD_FAULT));

    // pop {pc} ends a handler too: 3 + 1, and 11.
    let mut bench = nops();
    let pc = bench.cpu.pc();
    bench.memory.set_code(handler(IRQ), &[0xb500, 0xbd00]);
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ) + 2);
    bench.cpu.set_irq_lines(0);
    let began = bench.now();
    assert_eq!(bench.reach(pc), began + 4 + 11);
}

/// CONTROL.SPSEL: the thread's registers go to the process stack, a handler's to the main one.
#[test]
fn process_stack() {
    let mut bench = Bench::with(&[0xf380, 0x8809, 0xf381, 0x8814, NOP, NOP]);
    bench.poke(ISER, 0b11);
    bench.poke(IPR, 0x80);
    bench.cpu.set_register(0, PROCESS_STACK);
    bench.cpu.set_register(1, 2);
    bench.reach(CODE + 8);
    assert_eq!((bench.cpu.psp(), bench.cpu.msp(), bench.cpu.register(13)), (PROCESS_STACK, STACK, PROCESS_STACK));
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    assert_eq!((bench.cpu.psp(), bench.cpu.msp(), bench.cpu.register(13)), (PROCESS_STACK - 32, STACK, STACK));
    assert_eq!(bench.cpu.register(14), 0xffff_fffd);
    bench.cpu.set_irq_lines(0b10);
    bench.reach(handler(IRQ + 1));
    assert_eq!((bench.cpu.psp(), bench.cpu.msp()), (PROCESS_STACK - 32, STACK - 32));
    bench.cpu.set_irq_lines(0);
    bench.reach(CODE + 8);
    assert_eq!((bench.cpu.psp(), bench.cpu.msp(), bench.cpu.register(13)), (PROCESS_STACK, STACK, PROCESS_STACK));
}

/// `wfi` ends with an interrupt that would be taken without PRIMASK; with it, the program just goes on (§B1.5.17).
#[test]
fn wait_for_interrupt() {
    for masked in [false, true] {
        let mut bench = Bench::with(&[if masked { CPSID } else { NOP }, WFI, NOP]);
        bench.poke(ISER, 1);
        assert_eq!((bench.step(), bench.step()), (1, 2));
        assert!(bench.cpu.is_asleep());
        bench.cpu.set_irq_lines(0b10);
        assert!(bench.cpu.is_asleep(), "an interrupt that is not enabled");
        bench.cpu.event();
        assert_eq!(bench.step(), 1);
        assert!(bench.cpu.is_asleep(), "an event is not an interrupt");
        bench.cpu.sleep_until(1000);
        assert_eq!(bench.now(), 1000);
        bench.cpu.set_irq_lines(0b11);
        assert!(!bench.cpu.is_asleep());
        bench.cpu.sleep_until(2000);
        assert_eq!(bench.now(), 1000, "awake");
        if masked {
            assert_eq!((bench.step(), bench.cpu.pc()), (1, CODE + 6));
        } else {
            assert_eq!(bench.reach(handler(IRQ)), 1015);
            assert_eq!(bench.memory.word(bench.cpu.register(13) + 24), CODE + 4);
        }
    }
}

/// `wfe` waits unless there was an event: `sev`, another processor's, an exception's entry or return, or, with
/// SEVONPEND, an interrupt that became pending (§B1.5.18).
#[test]
fn wait_for_event() {
    let mut bench = Bench::with(&[SEV, WFE, WFE, WFE, WFE, NOP]);
    assert_eq!((bench.step(), bench.memory.events), (1, 1));
    assert_eq!((bench.step(), bench.cpu.is_asleep()), (2, false));
    bench.step();
    assert!(bench.cpu.is_asleep());
    bench.cpu.set_irq_lines(1);
    assert!(bench.cpu.is_asleep(), "not enabled, no SEVONPEND");
    bench.cpu.event();
    assert!(!bench.cpu.is_asleep());
    bench.step();
    assert_eq!((bench.cpu.pc(), bench.cpu.is_asleep()), (CODE + 8, true), "the event was used up");
    bench.cpu.event();
    bench.step();
    bench.cpu.event();
    bench.step();
    bench.poke(SCR, 1 << 4);
    assert_eq!(bench.peek(SCR), 1 << 4);

    let mut bench = Bench::with(&[WFE, WFE]);
    bench.poke(SCR, 1 << 4);
    bench.step();
    assert!(bench.cpu.is_asleep());
    bench.cpu.set_irq_lines(1 << 7);
    assert!(!bench.cpu.is_asleep(), "SEVONPEND");
}

/// SCR.SLEEPONEXIT: the return to the thread sleeps, and to another handler does not.
#[test]
fn sleep_on_exit() {
    let mut bench = nops();
    bench.poke(SCR, 1 << 1);
    let pc = bench.cpu.pc();
    bench.cpu.set_irq_lines(1);
    bench.reach(handler(IRQ));
    bench.cpu.set_irq_lines(0);
    bench.reach(pc);
    assert!(bench.cpu.is_asleep());
    bench.cpu.set_irq_lines(1);
    assert!(!bench.cpu.is_asleep());
    bench.reach(handler(IRQ));
}

/// §B3.3: the counter counts down to 0 and continues at the reload value: a period of reload + 1 clocks.
#[test]
fn systick_counts() {
    let mut bench = nops();
    bench.poke(SYST_RVR, 99);
    bench.poke(SYST_CVR, 12_345);
    bench.poke(SYST_CSR, 0b101);
    let start = bench.now();
    for _ in 0..400 {
        // The load reads in its second cycle.
        let cycle = bench.now() + 1 - start;
        let value = (100 - cycle % 100) % 100;
        assert_eq!(u64::from(bench.peek(SYST_CVR)), value, "{cycle} cycles after the start");
        assert_eq!(u64::from(bench.cpu.systick_value()), (value + 99) % 100, "a cycle later");
        bench.step();
    }
    assert_eq!(bench.peek(SYST_CSR), 0b101 | 1 << 16);
    assert_eq!(bench.peek(SYST_CSR), 0b101, "reading clears COUNTFLAG");
    assert_eq!(bench.peek(SYST_RVR), 99);
    bench.poke(SYST_CSR, 0b100);
    let value = bench.peek(SYST_CVR);
    bench.step();
    assert_eq!(bench.peek(SYST_CVR), value, "stopped");
    bench.poke(SYST_RVR, 0);
    bench.poke(SYST_CSR, 0b111);
    bench.run_to(bench.now() + 300);
    assert_eq!(bench.peek(SYST_CVR), 0, "without a reload value it stays at 0");
    assert_eq!(bench.cpu.next_own_event(), None);
    assert_eq!(bench.peek(SYST_CALIB), 0);
}

/// The exception becomes pending in the cycle in which the counter reaches 0, also while the processor sleeps.
#[test]
fn systick_interrupts() {
    let mut bench = Bench::with(&[WFI, 0xe7fd]);
    bench.poke(SYST_RVR, 999);
    bench.poke(SYST_CVR, 0);
    bench.poke(SYST_CSR, 0b111);
    let start = bench.now();
    assert_eq!(bench.cpu.next_own_event(), Some(start + 1000));
    bench.step();
    bench.cpu.sleep_until(start + 500);
    assert_eq!(bench.now(), start + 500);
    bench.cpu.sleep_until(u64::MAX);
    for round in 1..4 {
        assert_eq!(bench.reach(handler(SYSTICK)), start + 1000 * round + 15);
        while !bench.cpu.is_asleep() {
            bench.step();
        }
        bench.cpu.sleep_until(u64::MAX);
    }

    // A reference clock of 125 cycles, as 1 us is at 125 MHz.
    let mut bench = nops();
    bench.cpu.set_systick_reference(125);
    bench.poke(SYST_RVR, 7);
    bench.poke(SYST_CVR, 0);
    bench.poke(SYST_CSR, 0b011);
    assert_eq!(bench.cpu.next_own_event(), Some(8 * 125));
    bench.cpu.set_register(15, CODE + 0x100);
    bench.memory.set_code(CODE + 0x100, &[WFI]);
    bench.step();
    bench.cpu.sleep_until(u64::MAX);
    assert_eq!(bench.reach(handler(SYSTICK)), 1000 + 15);
    assert_eq!(bench.peek(SYST_CVR), 0);
    bench.run_to(1130);
    assert_eq!(bench.peek(SYST_CVR), 7);
}

#[test]
fn system_control() {
    let mut bench = nops();
    assert_eq!(bench.peek(CPUID), 0x410c_c601);
    assert_eq!(bench.peek(CCR), 0x208);
    assert_eq!(bench.peek(AIRCR), 0xfa05_0000);
    bench.poke(AIRCR, 4);
    assert_eq!(bench.memory.resets, 0, "without its key it ignores what is written");
    bench.poke(AIRCR, 0x05fa_0004);
    assert_eq!(bench.memory.resets, 1);
    bench.poke(VTOR, RAM + 0x4fff);
    assert_eq!(bench.peek(VTOR), RAM + 0x4f00);
    bench.memory.set_word(RAM + 0x4f00 + 4 * IRQ, (RAM + 0x5000) | 1);
    bench.memory.set_code(RAM + 0x5000, &[BX_LR]);
    bench.cpu.set_irq_lines(1);
    bench.reach(RAM + 0x5000);

    // Without privileges they cannot be reached.
    let mut bench = Bench::with(&[0xf380, 0x8814, 0x6808]);
    bench.cpu.set_register(0, 1);
    bench.cpu.set_register(1, ISER);
    bench.reach(handler(HARD_FAULT));
    assert_eq!(bench.cpu.fault().map(|fault| fault.cause), Some(FaultCause::Bus { address: ISER }));
}

/// A reset begins at the vector table's first two words, and keeps the clock and what the world does to the lines.
#[test]
fn reset() {
    let mut bench = nops();
    bench.cpu.set_irq_lines(1 << 3);
    bench.reach(handler(IRQ + 3));
    let cycle = bench.now();
    bench.cpu.reset(&mut bench.memory);
    assert_eq!((bench.cpu.pc(), bench.cpu.register(13), bench.now()), (CODE, STACK, cycle));
    assert_eq!((bench.cpu.mode(), bench.peek(ISER), bench.peek(ISPR)), (Mode::Thread, 0, 1 << 3));
}

proptest! {
    /// Whatever code and lines do, each step takes time, and a processor that is not locked up goes on.
    #[test]
    fn any_code(code in prop::collection::vec(any::<u16>(), 500), lines in prop::collection::vec(any::<u32>(), 20), r in any::<[u32; 8]>()) {
        let mut bench = nops();
        bench.memory.set_code(CODE, &code);
        bench.memory.set_code(handler(HARD_FAULT), &code);
        for (number, value) in r.into_iter().enumerate() {
            // Some are addresses of memory, or of the processor's own registers.
            let value = if number % 2 == 0 { RAM + value % 0x1_0000 } else { value };
            bench.cpu.set_register(number, if number == 7 { ICSR & !0xff | value & 0xff } else { value });
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
