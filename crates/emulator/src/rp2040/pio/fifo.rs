//! A state machine's FIFO (RP2040 datasheet §3.5.3).

/// A FIFO of up to eight words. It keeps the cycles of the last words in and out, because the DMA sees a change later
/// than the state machine.
#[derive(Clone, Default)]
pub(super) struct Fifo {
    words: [u32; 8],
    first: u8,
    len: u8,
    /// 4; or 8 and 0 when the two FIFOs of a machine are joined.
    capacity: u8,
    /// The cycles of the last two words in, and of the last two out; the later one first.
    pushed: [u64; 2],
    popped: [u64; 2],
}

impl Fifo {
    pub(super) fn new(capacity: u8) -> Fifo {
        Fifo { capacity, ..Fifo::default() }
    }

    /// Changes the capacity, which discards the contents.
    pub(super) fn resize(&mut self, capacity: u8) {
        (self.capacity, self.first, self.len) = (capacity, 0, 0);
    }

    pub(super) fn level(&self) -> u8 {
        self.len
    }

    pub(super) fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub(super) fn is_full(&self) -> bool {
        self.len >= self.capacity
    }

    /// Appends a word in a cycle. Returns `false` if the FIFO is full.
    pub(super) fn push(&mut self, word: u32, cycle: u64) -> bool {
        if self.is_full() {
            return false;
        }
        self.words[usize::from((self.first + self.len) & 7)] = word;
        self.len += 1;
        self.pushed = [cycle, self.pushed[0]];
        true
    }

    pub(super) fn pop(&mut self, cycle: u64) -> Option<u32> {
        if self.is_empty() {
            return None;
        }
        let word = self.words[usize::from(self.first)];
        self.first = (self.first + 1) & 7;
        self.len -= 1;
        self.popped = [cycle, self.popped[0]];
        Some(word)
    }

    /// Words that the DMA may read now (those that came at least two cycles before `cycle`), and all words.
    pub(super) fn words_for_dma(&self, cycle: u64) -> (u8, u8) {
        (self.len.saturating_sub(recent(self.pushed, cycle)), self.len)
    }

    /// Places that the DMA may fill now (those that were free at least two cycles before `cycle`), and all places.
    pub(super) fn room_for_dma(&self, cycle: u64) -> (u8, u8) {
        let room = self.capacity.saturating_sub(self.len);
        (room.saturating_sub(recent(self.popped, cycle)), room)
    }
}

/// How many of the cycles are less than two before `cycle`. There is at most one change in a cycle, so that two are
/// enough.
fn recent(cycles: [u64; 2], cycle: u64) -> u8 {
    cycles.iter().filter(|at| **at != 0 && **at + 2 > cycle).count() as u8
}
