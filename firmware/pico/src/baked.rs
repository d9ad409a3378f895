//! A motion in the flash: it begins at power-up, and is fed into the queues as a host would do it.

use crate::board::Board;
use crate::clock::TICK_HZ;
use crate::flash;
use crate::steps::MOTORS;
use pulsetrain_core::baked::{Block, LONGEST_PIECE, POINTER, Player};
use pulsetrain_core::wire::BoardSide;
use pulsetrain_core::{Epoch, Tick32};

/// From power-up to the motion's time 0, ticks: 0.1 s, for drivers to be ready.
const START_DELAY: u64 = TICK_HZ as u64 / 10;

/// The motors' epoch begins so long before time 0, ticks: 1 ms, for the set-up of DIR before a first step.
const EPOCH_LEAD: u64 = TICK_HZ as u64 / 1000;

/// The motion that was baked into this image, if it is undamaged. To be called before the board's clock is started, which must be
/// read every 0.1 s: this takes 40 cycles a byte and more.
pub(crate) fn block() -> Option<Block<'static>> {
    let flash = flash::contents();
    let at = u32::from_le_bytes(*flash.get(POINTER..)?.first_chunk()?);
    if at == 0 { None } else { Block::read(flash.get(at as usize..)?) }
}

/// A baked motion that runs.
pub(crate) struct BakedMotion {
    epoch: Epoch,
    players: [Option<Player<'static>>; MOTORS],
}

impl BakedMotion {
    /// Begins it, all motors at the same tick. `None` if the board cannot do it: then nothing moves.
    pub(crate) fn begin(board: &mut Board, block: &Block<'static>) -> Option<BakedMotion> {
        let epoch = board.begin_baked(&block.configuration).ok()?;
        let zero = board.now() + START_DELAY;
        let mut motors = block.motors();
        let players = core::array::from_fn(|_| motors.next().map(|motor| Player::new(motor, Tick32::of(zero))));
        let mut baked = BakedMotion { epoch, players };
        // Armed motors need words while the queues are filled, too: they are at rest.
        while board.fill_motors() {}
        while baked.feed(board) {
            while board.fill_motors() {}
        }
        board.switch_baked(epoch, zero - EPOCH_LEAD).then_some(baked)
    }

    /// Puts a piece into each motor's queue that has room. Whether there may be more to do.
    pub(crate) fn feed(&mut self, board: &mut Board) -> bool {
        let mut more = false;
        for (motor, player) in (0..).zip(self.players.iter_mut().flatten()) {
            let mut piece = [0; LONGEST_PIECE];
            let len = player.next(board.free(motor).into(), &mut piece);
            if let Some(piece @ [_, ..]) = piece.get(..len) {
                board.push_baked(motor, self.epoch, piece);
                more = true;
            }
        }
        more
    }

    /// Whether all of it is in the queues.
    pub(crate) fn is_over(&self) -> bool {
        self.players.iter().flatten().all(Player::is_over)
    }
}
