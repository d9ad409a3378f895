//! What a program says of itself: what it takes from the host, and where its motors' steps come from.
//!
//! # Routines
//! The engine's assembly calls routines of the program by these names. The program sets each of them, most often to a routine of the engine
//! (`.set source_limit, steps_limit`):
//!
//! | symbol | what it is | the engine's |
//! |---|---|---|
//! | `source_limit` | for the task: the tick up to which it is known what motors do, in r22 to r25; all registers are free | `steps_limit`: 3 ms from now |
//! | `source_load` | for the plan: the next steps of the motor Y into its registers; carry: there are none yet. Keeps r2 to r13, r16, r17 | `steps_load_record`: the next record of its queue |
//! | `source_due` | for the task: r26 is in how many counts of 64 cycles it comes again, as rings that are not full want it; less, if need be, and with carry that is final. Uses r18 to r25, r27, r30, r31 | `steps_due`: when the rings want it |

use crate::engine::link::Receiver;
use crate::engine::machine::Board;
use crate::engine::memory::REPLY_LEN;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::message::{Configuration, Reason, kind};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::{Encoder, Millis, Refusal, Service};

/// A program: what it has beside the engine. What it does not have is not in its image. Each defines `Uses` in its main.rs.
pub(crate) trait Program: Sized + 'static {
    /// Which image this is, as [`Info`](pulsetrain_core::wire::message::Info) has it.
    const IMAGE: u8;

    /// Motors follow plans: packed segments in queues, which a host sends or the flash has.
    const PLANS: bool = false;

    /// Plans hold by lease: [`brake`](crate::engine::steps::brake). Needs `steps_load_leased` and `steps_limit_leased`.
    const LEASES: bool = false;

    /// Motors can be told directly: [`obey`](Program::obey).
    const OBEYS: bool = false;

    /// Ticks between two things that a motor does, at most: a multiple of 256, up to 16 384. Less where it is not always known so far ahead what
    /// motors do.
    const FILLER: u16 = 16_384;

    /// Bytes of the queues, from the symbol `queues` on; where there are no plans they are the program's own. build.rs has them, too.
    const POOL: usize = 396;

    /// Motors may share DIR lines: `ring_shared`.
    const SHARED: bool = true;

    /// One motor may have a ring of its own beside a merge of three: `ring_beside`.
    const BESIDE: bool = true;

    // Text on the line.

    /// Whether text is read.
    #[inline(always)]
    fn is_on(&self) -> bool {
        false
    }

    /// Whether text has the motors: nobody else may take the board then.
    #[inline(always)]
    fn drives(&self) -> bool {
        false
    }

    /// Whether what was read last is text alone.
    #[inline(always)]
    fn has_line(&self) -> bool {
        false
    }

    /// Reads lines among the bytes that wait, and does what they say; gives how many bytes were read that may be frames' too.
    #[inline(always)]
    fn listen(&mut self, board: &mut Board, receiver: &mut Receiver) -> u8 {
        let _ = (board, receiver);
        0
    }

    /// What time brings. To be called every few milliseconds.
    #[inline(always)]
    fn look(&mut self, board: &mut Board, service: &Service, receiver: &Receiver, now: Millis) {
        let _ = (board, service, receiver, now);
    }

    /// What is to be said now, if anything: its first byte and how many there are. It may be written to `out`.
    #[inline(always)]
    fn speak(&mut self, receiver: &Receiver, out: &mut [u8; REPLY_LEN]) -> (*const u8, u8) {
        let _ = receiver;
        (out.as_ptr(), 0)
    }

    // Motors told directly.

    /// Whether motors are told directly now.
    #[inline(always)]
    fn is_obeying() -> bool {
        false
    }

    /// Notes what the motors of a configuration can do.
    #[inline(always)]
    fn set_up(configuration: &Configuration<'_>) {
        let _ = configuration;
    }

    /// Has armed motors, which rest, do what is ordered: from then on they are told directly.
    ///
    /// # Errors
    /// Why that cannot be.
    #[inline(always)]
    fn begin(orders: &Orders<'_>) -> Result<(), Refusal> {
        let _ = orders;
        Err(Refusal { reason: Reason::UnknownKind, detail: kind::ORDERS as u16 })
    }

    /// Has motors that are told directly do what is ordered.
    ///
    /// # Errors
    /// Why that cannot be.
    #[inline(always)]
    fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
        Self::begin(orders)
    }

    /// Writes what came of what was obeyed last.
    #[inline(always)]
    fn encode_obeyed(frame: &mut Encoder<'_>) {
        let _ = frame;
    }

    /// Motors were stopped at once; `dry`: their ring had run empty.
    #[inline(always)]
    fn stop(dry: bool) {
        let _ = dry;
    }

    /// Whether nothing is left to be done of what they were told.
    #[inline(always)]
    fn rest() -> bool {
        true
    }

    /// A move that was done and not told to the host yet: motor, tick, number.
    #[inline(always)]
    fn take_done() -> Option<(u8, Tick32, u32)> {
        None
    }

    /// Nobody tells motors any more.
    #[inline(always)]
    fn forsake() {}
}
