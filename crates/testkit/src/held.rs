//! A Pico whose main loop is kept from doing anything for a while, as nothing of ours ever does.

use pulsetrain_board::Port;
use pulsetrain_board::virtual_pico::VirtualPico;
use pulsetrain_emulator::arm::Mode;
use std::time::Duration;

/// Runs on up to `until`.
fn run(pico: &mut VirtualPico, until: Duration, into: &mut Vec<u8>) {
    while pico.now() < until {
        pico.receive(until, into).expect("it is there");
    }
}

fn run_on(pico: &mut VirtualPico, into: &mut Vec<u8>) {
    run(pico, pico.now() + Duration::from_nanos(8), into);
}

/// Keeps the main loop, from when it is next awake and can be interrupted, in a loop at the end of RAM, where nothing is, up to
/// `until`; interrupts go on. It is 500 times `nop` and a branch back, so that it can be left in nearly every cycle. `into`: what
/// the board says meanwhile.
pub fn hold_up(pico: &mut VirtualPico, until: Duration, into: &mut Vec<u8>) {
    const LOOP: u32 = 0x2003_c000;
    const NOPS: usize = 500;
    const NOP: u16 = 0xbf00;
    const BACK: u16 = 0xe000 | (-(NOPS as i16) - 2) as u16 & 0x7ff;
    let is_away = |pico: &VirtualPico| {
        let cpu = pico.chip().cpu();
        cpu.is_asleep() || cpu.mode() != Mode::Thread || cpu.primask()
    };
    // An exception whose frame is being stacked would bring back what is set now.
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

/// The same for `ticks`; what the board says is lost. Gives the tick when it is over.
#[allow(dead_code, reason = "not every suite needs it")]
pub fn hold_for(pico: &mut VirtualPico, ticks: u64) -> u64 {
    hold_up(pico, pico.now() + Duration::from_nanos(8 * ticks), &mut Vec::new());
    pico.chip().cycle() - pico.zero()
}
