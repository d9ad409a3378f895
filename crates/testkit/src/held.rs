//! A Pico whose main loop is held up for a while, longer than any code of the firmware does.

use pulsetrain_board::Port;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_emulator::arm::Mode;
use std::time::Duration;

/// Lets time pass to `until`.
fn run(pico: &mut VirtualPico, until: Duration, into: &mut Vec<u8>) {
    while pico.now() < until {
        pico.receive(until, into).expect("it is there");
    }
}

fn run_on(pico: &mut VirtualPico, into: &mut Vec<u8>) {
    run(pico, pico.now() + Duration::from_nanos(8), into);
}

/// Holds the main loop up to `until`, in a loop of 500 `nop` and a branch back at the end of RAM, which is unused. It begins when the main loop is
/// awake and interrupts are enabled; interrupts go on. The bytes that the board sends meanwhile are appended to `into`.
pub fn hold_up(pico: &mut VirtualPico, until: Duration, into: &mut Vec<u8>) {
    const LOOP: u32 = 0x2003_c000;
    const NOPS: usize = 500;
    const NOP: u16 = 0xbf00;
    const BACK: u16 = 0xe000 | (-(NOPS as i16) - 2) as u16 & 0x7ff;
    let is_away = |pico: &VirtualPico| {
        let cpu = pico.chip().cpu();
        cpu.is_asleep() || cpu.mode() != Mode::Thread || cpu.primask()
    };
    // If an exception is just being entered, its return would restore the program counter that is changed here.
    let is_interrupted = |pico: &VirtualPico| {
        let mut later = pico.clone();
        let soon = later.now() + Duration::from_nanos(8 * 20);
        run(&mut later, soon, &mut Vec::new());
        later.chip().cpu().mode() != Mode::Thread
    };
    while is_away(pico) || is_interrupted(pico) {
        run_on(pico, into);
    }
    let (chip, at) = (pico.chip_mut(), (LOOP - 0x2000_0000) as usize);
    let code: Vec<u8> = [NOP; NOPS].iter().chain([&BACK]).flat_map(|code| code.to_le_bytes()).collect();
    let place = &mut chip.ram_mut()[at..at + code.len()];
    assert!(place.iter().all(|byte| *byte == 0) || *place == *code, "something is there");
    place.copy_from_slice(&code);
    let [sp, pc] = [13, 15].map(|register| chip.cpu().register(register));
    chip.cpu_mut().set_register(15, LOOP);
    run(pico, until, into);
    while pico.chip().cpu().mode() != Mode::Thread || pico.chip().cpu().register(13) != sp {
        run_on(pico, into);
    }
    pico.chip_mut().cpu_mut().set_register(15, pc);
}

/// As [`hold_up`], for `ticks`; drops the bytes that the board sends. Returns the tick of the end.
#[allow(dead_code, reason = "not every suite needs it")]
pub fn hold_for(pico: &mut VirtualPico, ticks: u64) -> u64 {
    hold_up(pico, pico.now() + Duration::from_nanos(8 * ticks), &mut Vec::new());
    pico.chip().cycle() - pico.zero()
}
