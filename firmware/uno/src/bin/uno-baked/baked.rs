//! The main loop of a board without a host: a motion that lies in the flash, right behind this image, begins with the board and is fed
//! from there as a host would feed it. What the block is: [`pulsetrain_core::baked::avr`].
//!
//! # When nothing moves
//! A block of which a bit is wrong, as in an image that was never baked, is none: no pin is touched. A motion that went wrong has its
//! motors stopped at once, and so has one after a reset by the watchdog, since nobody knows where they are: the lamp shines, if no motor
//! has its pin, until the board's next start.

use crate::engine::machine::Board;
use crate::engine::memory;
use crate::engine::steps::pins::{MAX_MOTORS, Pin};
use crate::engine::steps::task;
use crate::engine::{BOARD, clock, link, millis, regs, reset};
use pulsetrain_core::baked::avr::{AvrPlayer, LONGEST_PIECE, MOTOR_LEN, NEAR, QueueState, ZERO, block};
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::message::{Cause, Configuration};
use pulsetrain_core::wire::{Machine, Millis, Switched};
use pulsetrain_core::{Epoch, Tick32};

/// The motors'.
const EPOCH: Epoch = Epoch(1);

/// It begins so long before the motion, ticks: 1 ms, for DIR's set-up before a first step.
const BEFORE: u32 = 16_000;

/// The first address that is the bootloader's.
const LIMIT: u16 = 32_768 - 512;

/// Bytes of a configuration at most.
const LONGEST_CONFIGURATION: usize = 13 + 8 * MAX_MOTORS;

unsafe extern "C" {
    /// The first byte of the flash behind this image: the linker's.
    #[link_name = "__data_load_end"]
    static IMAGE_END: u8;
}

/// All that main does.
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

/// Where a motor is that is to be fed.
#[inline(never)]
fn standing(motor: u8) -> QueueState {
    let soon = clock::moment().after(NEAR);
    let stepper = task::lock();
    stepper.motor(motor).map_or(QueueState { room: 0, near: false }, |motor| QueueState {
        room: motor.room(),
        near: motor.is_empty() && Tick32(motor.registers.tick).is_before(soon),
    })
}

/// A motion that runs. What is read of the flash is here too: the stack has no room to spare.
struct Motion {
    players: [AvrPlayer; MAX_MOTORS],
    piece: [u8; LONGEST_PIECE],
    configuration: [u8; LONGEST_CONFIGURATION],
}

impl Motion {
    /// Begins it: all motors at the same tick. `None` if the board cannot do that: then nothing moves.
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
        // Its pieces are all that is left of the block.
        if head != end {
            return None;
        }
        while self.feed(board) {}
        let switched = board.switch(EPOCH, u64::from(ZERO - BEFORE), Lease::Off, &[]);
        (switched == Ok(Switched::Accepted)).then_some(())
    }

    /// The main loop, until something is wrong.
    fn run(&mut self, board: &mut Board, lamp: Pin) {
        let mut last = millis(clock::moment());
        // So that it is known from the first step on that motors are busy.
        let mut well = self.look(board, last, lamp);
        while well {
            regs::kick_watchdog();
            let fed = self.feed(board);
            let now = millis(clock::moment());
            if now != last {
                // It takes the task's time, and rounds may be longer than one.
                if (now.0 ^ last.0) & !3 != 0 {
                    well = self.look(board, now, lamp);
                }
                last = now;
            } else if !fed {
                board.wait();
            }
        }
    }

    /// Looks after the board; whether all is well, or nearly so.
    fn look(&self, board: &mut Board, now: Millis, lamp: Pin) -> bool {
        board.look_after(now, self.players.iter().all(AvrPlayer::is_over));
        while let Some(event) = board.event() {
            match event.cause {
                Cause::Finished => {}
                // It was made all the same.
                Cause::EdgeLate => lamp.drive(true),
                _ => {
                    board.stop_now();
                    return false;
                }
            }
        }
        true
    }

    /// Fills the motors' queues: a piece for each. Whether there may be more to do.
    #[inline(never)]
    fn feed(&mut self, board: &mut Board) -> bool {
        let mut fed = false;
        for (motor, player) in (0..).zip(self.players.iter_mut()) {
            if player.is_over() {
                continue;
            }
            let len = player.next(standing(motor), regs::flash, &mut self.piece);
            if let Some(piece @ [_, ..]) = self.piece.get(..len) {
                // There is room, and it is armed, or this is not called any more.
                let _ = board.push(motor, EPOCH, piece);
                fed = true;
            }
        }
        fed
    }
}
