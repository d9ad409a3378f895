//! From tapes to state machines: a DMA channel for each motor takes words from its ring, as far as they have been written.
//!
//! A channel is started only for words that are there. When it is done, its interrupt starts it for those that were written
//! meanwhile, while the state machine still has eight in its FIFO. So no old word is ever played: if nothing was written, the
//! channel rests, and the state machine runs dry at the end of a word, where STEP is not active.

use super::pio::StateMachine;
use super::{MOTORS, RING_WORDS};
use crate::regs::{self, DmaChannel};
use core::sync::atomic::{AtomicU32, Ordering, compiler_fence};

/// What main and the interrupt know of a channel. Both numbers wrap.
struct Feed {
    /// Words written so far: main writes it.
    written: AtomicU32,
    /// Words that the channel was started for so far: the interrupt writes it, and main with interrupts off.
    started: AtomicU32,
}

static FEEDS: [Feed; MOTORS] = [const { Feed { written: AtomicU32::new(0), started: AtomicU32::new(0) } }; MOTORS];

impl Feed {
    /// Starts a channel that is at rest for the words that are new, if there are some.
    #[inline(always)]
    fn start_next(&self, channel: DmaChannel) {
        let written = self.written.load(Ordering::Acquire);
        let more = written.wrapping_sub(self.started.load(Ordering::Relaxed));
        if more != 0 {
            self.started.store(written, Ordering::Relaxed);
            channel.trans_count_trig().write(more);
        }
    }
}

/// The DMA's interrupt: channels have taken all words that they were started for.
#[unsafe(no_mangle)]
extern "C" fn dma_irq_0() {
    let done = regs::DMA_INTS0.read();
    regs::DMA_INTS0.write(done);
    for (number, feed) in (0..).zip(&FEEDS) {
        // A state machine that ran dry gets no more words: its steps would be late.
        if done & 1 << number != 0 && !StateMachine::of(number).is_dry() {
            feed.start_next(DmaChannel(number));
        }
    }
}

/// §2.5.7, CTRL: words, from a ring (the lowest 13 bits of the address go around), at the FIFO's request, with high priority,
/// and chained to itself, which means to no channel.
const CTRL: u32 = 1 | 1 << 1 | 2 << 2 | 1 << 4 | 13 << 6;
const _: () = assert!(RING_WORDS * 4 == 1 << 13);

/// Takes the DMA out of reset and enables its interrupt.
pub(crate) fn begin() {
    regs::take_out_of_reset(regs::reset::DMA);
    regs::NVIC_ISER.write(regs::DMA_IRQ_0);
}

/// Sets a motor's channel up from the beginning of `ring` into a FIFO, while no word is written yet.
pub(crate) fn set_up(motor: u8, ring: &[u32; RING_WORDS], (fifo, request): (u32, u32)) {
    let (channel, bit) = (DmaChannel(motor), 1 << motor);
    regs::DMA_INTE0.clear(bit);
    regs::DMA_INTR.write(bit);
    let Some(feed) = FEEDS.get(usize::from(motor)) else { return };
    feed.written.store(0, Ordering::Relaxed);
    feed.started.store(0, Ordering::Relaxed);
    channel.read_addr().write(ring.as_ptr() as u32);
    channel.write_addr().write(fifo);
    channel.ctrl().write(CTRL | u32::from(motor) << 11 | request << 15);
    regs::DMA_INTE0.set(bit);
}

/// Hands over the words up to number `written`, which main has written.
#[inline(always)]
pub(crate) fn publish(motor: u8, written: u32) {
    let Some(feed) = FEEDS.get(usize::from(motor)) else { return };
    // The words must be in memory before the DMA may read them.
    compiler_fence(Ordering::SeqCst);
    feed.written.store(written, Ordering::Release);
    let channel = DmaChannel(motor);
    regs::interrupt_free(|| {
        // If it is done and its interrupt is still to come, the interrupt starts it for these words.
        let busy = channel.ctrl().read() & 1 << 24 != 0;
        if !busy && regs::DMA_INTR.read() & 1 << motor == 0 {
            feed.start_next(channel);
        }
    });
}

/// Ends a motor's channel, while its state machine is halted and interrupts are off. Returns how many words it took into the FIFO
/// so far, wrapping.
pub(crate) fn end(motor: u8, ring: &[u32; RING_WORDS]) -> u32 {
    let (channel, bit) = (DmaChannel(motor), 1 << motor);
    // §2.5.5.3. Its interrupt is disabled first, as an abort may raise it (erratum E13).
    regs::DMA_INTE0.clear(bit);
    regs::DMA_ABORT.write(bit);
    while regs::DMA_ABORT.read() & bit != 0 {}
    while channel.ctrl().read() & 1 << 24 != 0 {}
    regs::DMA_INTR.write(bit);
    let Some(feed) = FEEDS.get(usize::from(motor)) else { return 0 };
    let started = feed.started.load(Ordering::Relaxed);
    let next = (channel.read_addr().read() - ring.as_ptr() as u32) >> 2;
    started.wrapping_sub(started.wrapping_sub(next) & (RING_WORDS as u32 - 1))
}
