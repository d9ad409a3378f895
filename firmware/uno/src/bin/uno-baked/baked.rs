//! The main loop of a board without a host. A motion is stored in the flash, right behind this image. It begins when the board starts, and the main
//! loop feeds it to the motors as a host would. [`pulsetrain_core::baked::avr`] describes its format.
//!
//! # When nothing moves
//! If a bit of the motion is wrong, or none was stored, no pin is touched. If something goes wrong while it runs, all motors are stopped at once.
//! After a reset by the watchdog nothing moves either, since nobody knows where the motors are. In these cases the board's LED (pin 13) is lit until
//! the next start, if no motor uses that pin.

use crate::engine::machine::Board;
use crate::engine::memory;
use crate::engine::steps::pins::{MAX_MOTORS, Pin};
use crate::engine::steps::refill;
use crate::engine::{BOARD, clock, link, millis, regs, reset};
use pulsetrain_core::baked::avr::{AvrPlayer, LONGEST_PIECE, MOTOR_LEN, NEAR, QueueState, ZERO, block};
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::message::{Cause, Configuration};
use pulsetrain_core::wire::{BoardSide, Millis, Switched};
use pulsetrain_core::{Epoch, Tick32};

/// The epoch of the motion.
const EPOCH: Epoch = Epoch(1);

/// The epoch begins so long before the motion, ticks: 1 ms, for the set-up of DIR before the first step.
const BEFORE: u32 = 16_000;
const _: () = assert!(BEFORE == clock::TICK_HZ / 1000);

/// The first address of the bootloader: optiboot takes 512 bytes.
const LIMIT: u16 = 32_768 - 512;

/// Bytes of a configuration, at most.
const LONGEST_CONFIGURATION: usize = 13 + 8 * MAX_MOTORS;

unsafe extern "C" {
    /// The first byte of the flash behind this image, as the linker has it.
    #[link_name = "__data_load_end"]
    static IMAGE_END: u8;
}

/// The whole program.
///
/// # Safety
/// To be called by main, which the start-up code calls once; nobody else takes the board.
#[inline(always)]
pub(crate) unsafe fn main() -> ! {
    memory::paint_stack();
    let cause = reset::begin();
    // SAFETY: only the address is taken.
    let at = (&raw const IMAGE_END).addr() as u16;
    // SAFETY: the caller's promise.
    let board = unsafe { BOARD.take() };
    if let Some((says, end)) = block(at.wrapping_add(at & 1), LIMIT, regs::flash) {
        let lamp = if regs::flash(says) & 1 != 0 { Pin::LAMP } else { Pin::NONE };
        if cause != Cause::Watchdog {
            // Idle mode: timers go on (§10.3).
            regs::SMCR.write(1);
            board.begin(cause);
            link::leave();
            // SAFETY: as above; zeros are a motion of nothing.
            let motion: &mut Motion = unsafe { memory::take_first_page().assume_init_mut() };
            if motion.begin(board, says.wrapping_add(1), end).is_some() {
                motion.run(board, lamp);
            }
        }
        lamp.drive(true);
    }
    loop {
        regs::kick_watchdog();
    }
}

/// How much room the queue of a motor has, and whether it runs out soon.
#[inline(never)]
fn standing(motor: u8) -> QueueState {
    let soon = clock::moment().after(NEAR);
    let stepper = refill::lock();
    stepper.motor(motor).map_or(QueueState { room: 0, near: false }, |motor| QueueState {
        room: motor.room(),
        near: motor.is_empty() && Tick32(motor.registers.tick).is_before(soon),
    })
}

/// A motion that runs. The buffers for what is read of the flash are here too, since the stack has no room for them.
struct Motion {
    players: [AvrPlayer; MAX_MOTORS],
    piece: [u8; LONGEST_PIECE],
    configuration: [u8; LONGEST_CONFIGURATION],
}

impl Motion {
    /// Starts all motors at the same tick. `None` if the board cannot do that: then nothing moves.
    #[inline(never)]
    fn begin(&mut self, board: &mut Board, says: u16, end: u16) -> Option<()> {
        let len = regs::flash(says);
        let mut at = says;
        for byte in &mut self.configuration {
            at = at.wrapping_add(1);
            *byte = regs::flash(at);
        }
        let configuration = Configuration::decode(self.configuration.get(..usize::from(len))?)?;
        board.configure(&configuration).ok()?;
        regs::enable_interrupts();
        board.arm().ok()?;
        let says = says.wrapping_add(1).wrapping_add(u16::from(len));
        let motors = board.motors();
        let mut head = says.wrapping_add(MOTOR_LEN * u16::from(motors));
        let mut at = says;
        for player in self.players.iter_mut().take(usize::from(motors)) {
            *player = AvrPlayer::new(at, head, regs::flash);
            head = player.end();
            at = at.wrapping_add(MOTOR_LEN);
        }
        // The motors' pieces must fill the rest of the block.
        if head != end {
            return None;
        }
        while self.feed(board) {}
        let switched = board.switch(EPOCH, u64::from(ZERO - BEFORE), Lease::Off, &[]);
        (switched == Ok(Switched::Accepted)).then_some(())
    }

    /// The main loop. It ends when something is wrong.
    fn run(&mut self, board: &mut Board, lamp: Pin) {
        let mut last = millis(clock::moment());
        // Before the first step, so that the board knows that motors are busy.
        let mut well = self.look(board, last, lamp);
        while well {
            regs::kick_watchdog();
            let fed = self.feed(board);
            let now = millis(clock::moment());
            if now != last {
                // Every fourth millisecond or so: it keeps the refill out for a while. A round may last longer than a millisecond, so compare all bits.
                if (now.0 ^ last.0) & !3 != 0 {
                    well = self.look(board, now, lamp);
                }
                last = now;
            } else if !fed {
                board.wait();
            }
        }
    }

    /// Supervises the motors. `false` if the motion cannot go on.
    fn look(&self, board: &mut Board, now: Millis, lamp: Pin) -> bool {
        board.supervise(now, self.players.iter().all(AvrPlayer::is_over));
        while let Some(event) = board.event() {
            match event.cause {
                Cause::Finished => {}
                // The edge was made, only later.
                Cause::EdgeLate => lamp.drive(true),
                _ => {
                    board.stop_now();
                    return false;
                }
            }
        }
        true
    }

    /// Gives each motor's queue another piece of the motion. `true` if there may be more to do.
    #[inline(never)]
    fn feed(&mut self, board: &mut Board) -> bool {
        let mut fed = false;
        for (motor, player) in (0..).zip(self.players.iter_mut()) {
            if player.is_over() {
                continue;
            }
            let len = player.next(standing(motor), regs::flash, &mut self.piece);
            if let Some(piece @ [_, ..]) = self.piece.get(..len) {
                // The player asked for the room, and the board is armed as long as this runs.
                let _ = board.push(motor, EPOCH, piece);
                fed = true;
            }
        }
        fed
    }
}
