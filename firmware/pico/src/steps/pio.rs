//! The state machines: one for each motor, and two programs that are in both blocks.
//!
//! A state machine waits for the gate, and then takes word after word, as `pulsetrain_core::pio` has them. All machines see the
//! gate in the same cycle. The gate is GPIO 25, which no header has; the Pico's LED is on it, and shines while motors are armed.

use super::pins::{Lines, MotorPins};
use crate::regs::{self, Pio};
use pulsetrain_core::pio::{LONGEST_WAIT, SHORTEST_PULSE};

/// GPIO of the gate.
pub(crate) const GATE: u8 = 25;

/// Where the two programs begin in instruction memory.
const STEP_DIR_AT: u8 = 0;
const COILS_AT: u8 = 7;

/// Offset in both programs: the first instruction of the loop, behind the wait for the gate.
const LOOP_OFFSET: u8 = 1;

/// Offset in both programs: the instruction that changes the lines.
const CHANGE_OFFSET: u8 = 3;

/// Instructions (§3.4): `wait 1 gpio`, `out x`, `out pins`, `jmp x--`, `mov x, y`.
const WAIT_GATE: u16 = 0x2080 | GATE as u16;
const OUT_X: u16 = 0x6020 | 25;
const OUT_PINS: u16 = 0x6000;
const JMP_X_DEC: u16 = 0x0040;
const MOV_X_Y: u16 = 0xa022;

const _: () = assert!(LONGEST_WAIT == (1 << 25) - 1);

/// The program for step/dir: wait, set the lines, make the pulse, set the lines after it. Y is the pulse less [`SHORTEST_PULSE`].
const STEP_DIR_PROGRAM: [u16; 7] = [
    WAIT_GATE,
    OUT_X,                                // 1: here it waits for words, too
    JMP_X_DEC | (STEP_DIR_AT as u16 + 2), // 2
    OUT_PINS | 2,                         // 3
    MOV_X_Y,                              // 4
    JMP_X_DEC | (STEP_DIR_AT as u16 + 5), // 5
    // The rest of the word goes out, of which the two pins take two bits.
    OUT_PINS | 5, // 6
];

/// The program for coils: wait, set the next pattern. Among its pins may be GPIOs that are not the motor's: they stay as they are.
const COILS_PROGRAM: [u16; 4] = [WAIT_GATE, OUT_X, JMP_X_DEC | (COILS_AT as u16 + 2), OUT_PINS | 7];

const _: () = assert!(COILS_AT as usize == STEP_DIR_AT as usize + STEP_DIR_PROGRAM.len());

/// The instruction that ends the pulse of a driver.
const STEP_DIR_END_AT: u8 = STEP_DIR_AT + 6;

/// Instructions that the processor executes on a halted state machine: `pull block`, `mov y, osr`, `set pindirs`, `set pins`,
/// `jmp`, `jmp !osre`.
const PULL: u32 = 0x80a0;
const MOV_Y_OSR: u32 = 0xa047;
const SET_PINDIRS: u32 = 0xe080;
const SET_PINS: u32 = 0xe000;
const JMP: u32 = 0x0000;
const JMP_NOT_OSRE: u32 = 0x00e0;

/// §3.7, SHIFTCTRL: both FIFOs are joined for sending; a word is pulled when all bits of the one before are used; bit 0 comes
/// first.
const SHIFTCTRL: u32 = 1 << 30 | 1 << 19;
const AUTOPULL: u32 = 1 << 17;

/// The state machine of a motor.
#[derive(Clone, Copy)]
pub(crate) struct StateMachine {
    pio: Pio,
    number: u8,
}

/// Sets up the gate, closed.
pub(crate) fn close_gate() {
    regs::SIO_OUT_CLR.write(1 << GATE);
    regs::SIO_OE_SET.write(1 << GATE);
    regs::pad(GATE).write(PAD_OF_OUTPUT);
    regs::gpio_ctrl(GATE).write(5);
}

/// §2.19.6.3: input on, 4 mA, Schmitt trigger.
const PAD_OF_OUTPUT: u32 = 1 << 6 | 1 << 4 | 1 << 1;

/// Puts a block that is not used any more into reset: it has no programs then, and drives no pins.
pub(crate) fn unload(block: u8) {
    regs::RESETS_RESET.set(regs::reset::PIO[usize::from(block & 1)]);
}

/// Takes the block out of reset and loads the programs.
pub(crate) fn load(block: u8) {
    let bit = regs::reset::PIO[usize::from(block & 1)];
    regs::RESETS_RESET.set(bit);
    regs::take_out_of_reset(bit);
    let pio = Pio(block);
    for (at, instruction) in (0..).zip(STEP_DIR_PROGRAM.iter().chain(&COILS_PROGRAM)) {
        pio.instr_mem(at).write(u32::from(*instruction));
    }
}

impl StateMachine {
    /// The state machine of motor number `motor`.
    pub(crate) const fn of(motor: u8) -> StateMachine {
        StateMachine { pio: Pio(motor >> 2), number: motor & 3 }
    }

    /// The block that it is in.
    pub(crate) const fn block(self) -> u8 {
        self.pio.0
    }

    /// Its bit in the registers of its block.
    pub(crate) const fn bit(self) -> u32 {
        1 << self.number
    }

    /// Its FIFO: the address, and the number of its DMA request (§2.5.3.1).
    pub(crate) const fn fifo(self) -> (u32, u32) {
        (self.pio.txf(self.number).address(), (self.pio.0 as u32) << 3 | self.number as u32)
    }

    /// Sets it up to wait for the gate, with empty FIFOs; its lines are outputs at `levels`.
    pub(crate) fn set_up(self, wiring: &MotorPins, pulse_ticks: u32, levels: u32) {
        let StateMachine { pio, number } = self;
        let (at, end) = match wiring.lines {
            Lines::StepDir { .. } => (STEP_DIR_AT, STEP_DIR_END_AT),
            Lines::Coils { .. } => (COILS_AT, COILS_AT + 3),
        };
        pio.ctrl().clear(self.bit());
        pio.clkdiv(number).write(1 << 16);
        self.wrap(end, at + LOOP_OFFSET);
        // Joining the FIFOs again empties them.
        pio.shiftctrl(number).write(0);
        pio.shiftctrl(number).write(SHIFTCTRL);
        pio.txf(number).write(pulse_ticks.saturating_sub(SHORTEST_PULSE));
        self.execute(PULL);
        self.execute(MOV_Y_OSR);
        self.set_lines(wiring, levels);
        // Clears its shift register, its delay and its divider (§3.7, CTRL: SM_RESTART, CLKDIV_RESTART).
        pio.ctrl().set(self.bit() << 4 | self.bit() << 8);
        pio.shiftctrl(number).write(SHIFTCTRL | AUTOPULL);
        self.execute(JMP | u32::from(at));
        for pin in wiring.pins() {
            regs::pad(pin).write(PAD_OF_OUTPUT);
            // §2.19.2: PIO0 is function 6, PIO1 is 7. An inverted output is bit 8.
            regs::gpio_ctrl(pin).write((6 + u32::from(pio.0)) | (u32::from(wiring.is_inverted(pin)) << 8));
        }
    }

    /// Executes an instruction now; only while it is halted.
    fn execute(self, instruction: u32) {
        self.pio.instr(self.number).write(instruction);
    }

    /// Forgets that it found no word.
    pub(crate) fn forget_stall(self) {
        self.pio.fdebug().write(self.bit() << 24);
    }

    /// Whether it found no word since [`forget_stall`](StateMachine::forget_stall).
    #[inline(always)]
    pub(crate) fn is_dry(self) -> bool {
        stalled(self.pio.0) & self.bit() != 0
    }

    /// Words in its FIFO.
    pub(crate) fn waiting(self) -> u32 {
        self.pio.flevel().read() >> (8 * self.number) & 15
    }

    /// Has it go on at `begin` after the instruction at `end`.
    fn wrap(self, end: u8, begin: u8) {
        self.pio.execctrl(self.number).write(u32::from(end) << 12 | u32::from(begin) << 7);
    }

    /// Whether a machine of a driver was halted between the two changes of its lines: STEP may be active.
    #[inline(always)]
    pub(crate) fn is_in_pulse(self) -> bool {
        self.pio.addr(self.number).read() as u8 > STEP_DIR_AT + CHANGE_OFFSET
    }

    /// Has a machine that was halted in its pulse end the pulse when it is enabled again, and then wait for the gate. It takes no
    /// word more.
    #[inline(always)]
    pub(crate) fn end_with_pulse(self) {
        self.pio.shiftctrl(self.number).write(SHIFTCTRL);
        self.wrap(STEP_DIR_END_AT, STEP_DIR_AT);
    }

    /// Whether the last word that it pulled has changed the lines. It is halted, and not in its pulse.
    pub(crate) fn has_changed_lines(self, lines: &Lines) -> bool {
        let first = match lines {
            Lines::StepDir { .. } => STEP_DIR_AT,
            Lines::Coils { .. } => COILS_AT,
        };
        if self.pio.addr(self.number).read() as u8 != first + LOOP_OFFSET {
            return false;
        }
        // It jumps if the next word is in its shift register already: then that one has not changed the lines.
        self.execute(JMP_NOT_OSRE | u32::from(first));
        let jumped = self.pio.addr(self.number).read() as u8 == first;
        self.execute(JMP | u32::from(first + LOOP_OFFSET));
        !jumped
    }

    /// Sets its lines, and makes them outputs, while it is halted.
    pub(crate) fn set_lines(self, wiring: &MotorPins, levels: u32) {
        let pinctrl = self.pio.pinctrl(self.number);
        // `set` reaches five pins at most, so they are set one by one.
        for pin in wiring.pins() {
            let level = levels >> (pin - wiring.base) & 1;
            pinctrl.write(1 << 26 | u32::from(pin) << 5);
            self.execute(SET_PINS | level);
            self.execute(SET_PINDIRS | 1);
        }
        pinctrl.write(wiring.span() << 20 | u32::from(wiring.base));
    }
}

/// The state machines of a block that found no word since [`forget_stall`](StateMachine::forget_stall).
#[inline(always)]
pub(crate) fn stalled(block: u8) -> u32 {
    Pio(block).fdebug().read() >> 24 & 0xf
}

/// Halts the machines of a block that are in `mask`.
#[inline(always)]
pub(crate) fn halt(block: u8, mask: u32) {
    Pio(block).ctrl().clear(mask);
}

/// Enables the machines of a block that are in `mask`: they go as far as the gate.
pub(crate) fn enable(block: u8, mask: u32) {
    Pio(block).ctrl().set(mask);
}
