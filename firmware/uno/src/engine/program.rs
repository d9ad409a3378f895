//! What a program tells the engine: what it takes from the host, and where its motors' steps come from.
//!
//! # Routines
//! The engine's assembly calls these routines. Each program sets the symbols, most often to a routine of the engine (`.set source_limit, steps_limit`),
//! or to `steps_absent` for what it does not support.
//!
//! | symbol | what it does | the engine's own |
//! |---|---|---|
//! | `source_limit` | for the refill: gives the tick up to which motions are known, in r22 to r25. May use all registers | `steps_limit`: 3 ms from now |
//! | `source_load` | for the plan: loads the next steps of the motor Y into its registers. Carry: there are none yet. Keeps r2 to r13, r16, r17 | `steps_load_record`: the next record of the motor's queue |
//! | `source_due` | for the refill: r26 is the time to the next refill, counts of 64 cycles. It may make it shorter; with carry set no other rule does. Uses r18 to r25, r27, r30, r31 | `steps_due`: changes nothing |
//! | `ring_fill_one` | for the refill: fills the ring of one motor | `one_motor_fill` |
//! | `ring_fill_shared` | the same where motors share DIR lines | `shared_fill` |
//! | `ring_fill_shield` | the same on the shield: the merged ring A, and ring B | `shield_fill` |
//! | `ring_fill_shield_b` | ring B alone, in the middle of a merge | `shield_b_fill` |
//! | `ring_merge_three` | the merge of three motors in a known order | `merge_three` |

use crate::engine::link::Receiver;
use crate::engine::machine::Board;
use crate::engine::memory::REPLY_LEN;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::message::{Configuration, Reason, kind};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::{Encoder, Millis, Refusal, Service};

/// A program: what it adds to the engine. What it does not use is not in its image. Each main.rs defines `ThisProgram`.
pub(crate) trait Program: Sized + 'static {
    /// Which image this is, as [`Info`](pulsetrain_core::wire::message::Info) reports it.
    const IMAGE: u8;

    /// Motors follow plans: packed segments in queues, from a host or the flash.
    const PLANS: bool = false;

    /// Plans hold by lease: [`brake`](crate::engine::steps::brake). The program must use `load_leased` and `limit_leased`.
    const LEASES: bool = false;

    /// Motors can get orders: [`obey`](Program::obey).
    const OBEYS: bool = false;

    /// Ticks between two events of a motor, at most: a multiple of 256, up to 16 384. Less in a program that does not always know so far ahead what
    /// motors do.
    const FILLER: u16 = 16_384;

    /// Bytes of the queues, from the symbol `queues` on. A program without plans has its own data there. build.rs has the same number.
    const POOL: usize = 396;

    /// Motors may share DIR lines: `ring_fill_shared`.
    const SHARED: bool = true;

    /// The shield's motor on PORTB may have a ring of its own: `ring_fill_shield`.
    const SHIELD_B: bool = true;

    /// Up to three motors are merged in a known order, which is faster: `ring_merge_three`. Without that they are merged as four are.
    const THREE_LANES: bool = false;

    // Text on the line.

    /// Whether text is read.
    #[inline(always)]
    fn is_on(&self) -> bool {
        false
    }

    /// Whether text has the motors. Nobody else may take the board then.
    #[inline(always)]
    fn drives(&self) -> bool {
        false
    }

    /// Whether only text was read since the last command.
    #[inline(always)]
    fn has_line(&self) -> bool {
        false
    }

    /// Reads the lines among the waiting bytes and does what they say. Gives how many of the bytes it read may belong to frames too.
    #[inline(always)]
    fn listen(&mut self, board: &mut Board, receiver: &mut Receiver) -> u8 {
        let _ = (board, receiver);
        0
    }

    /// Does what is due by time. To be called every few milliseconds.
    #[inline(always)]
    fn look(&mut self, board: &mut Board, service: &Service, receiver: &Receiver, now: Millis) {
        let _ = (board, service, receiver, now);
    }

    /// What is to be sent now, if anything: its first byte, and how many there are. It may be written to `out`.
    #[inline(always)]
    fn speak(&mut self, receiver: &Receiver, out: &mut [u8; REPLY_LEN]) -> (*const u8, u8) {
        let _ = receiver;
        (out.as_ptr(), 0)
    }

    // Orders to motors.

    /// Whether orders have the motors now.
    #[inline(always)]
    fn is_obeying() -> bool {
        false
    }

    /// Notes the limits of a configuration's motors.
    #[inline(always)]
    fn set_up(configuration: &Configuration<'_>) {
        let _ = configuration;
    }

    /// Gives the first orders to armed motors that rest. From then on orders have the motors.
    ///
    /// # Errors
    /// Why they are refused.
    #[inline(always)]
    fn begin(orders: &Orders<'_>) -> Result<(), Refusal> {
        let _ = orders;
        Err(Refusal { reason: Reason::UnknownKind, detail: kind::ORDERS as u16 })
    }

    /// Gives further orders.
    ///
    /// # Errors
    /// Why they are refused.
    #[inline(always)]
    fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
        Self::begin(orders)
    }

    /// Writes the answer to the last orders.
    #[inline(always)]
    fn encode_obeyed(frame: &mut Encoder<'_>) {
        let _ = frame;
    }

    /// Motors were stopped at once; `dry`: because of an underrun.
    #[inline(always)]
    fn stop(dry: bool) {
        let _ = dry;
    }

    /// Whether all orders are done.
    #[inline(always)]
    fn rest() -> bool {
        true
    }

    /// A move that is done and not reported yet: motor, tick, number.
    #[inline(always)]
    fn take_done() -> Option<(u8, Tick32, u32)> {
        None
    }

    /// The host has left: motors finish what they do.
    #[inline(always)]
    fn host_left() {}
}
