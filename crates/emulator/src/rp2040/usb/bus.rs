//! Time on a full-speed bus: frames of 1 ms, 12 000 bit times each (USB 2.0 §5.3.3, §7.1.11).

/// Bit times of a frame.
const FRAME_BITS: u64 = 12_000;
/// Start of frame: synchronisation, packet identifier, number with CRC, end: 5 bytes.
const START_BITS: u64 = 5 * 8;
/// What a transaction takes beyond its data (table 5-9): 3 synchronisations, 3 packet identifiers, address with CRC,
/// CRC of the data, 3 bytes of delays between packets.
const OVERHEAD_BYTES: u64 = 13;
const _: () = assert!((FRAME_BITS - START_BITS) / transaction_bits(64) == 19, "table 5-9: 19 transfers of 64 bytes");
/// An IN token that is refused: token of 4 bytes, delay, handshake of 2, delay.
pub(super) const REFUSED_IN_BITS: u64 = 8 * 8;

/// Bit times of a transaction with so many bytes of data.
pub(super) const fn transaction_bits(bytes: u64) -> u64 {
    (OVERHEAD_BYTES + bytes) * 8
}

#[derive(Clone, Debug)]
pub(super) struct Bus {
    cycles_per_ms: u64,
    /// A frame began in this cycle, and had this number.
    origin: u64,
    number: u64,
}

impl Bus {
    pub(super) fn new() -> Bus {
        Bus { cycles_per_ms: 1, origin: 0, number: 0 }
    }

    /// From a cycle on there are so many in a second. The frame that is under way begins anew.
    pub(super) fn set_clock(&mut self, hz: u64, cycle: u64) {
        self.number += (cycle - self.origin) / self.cycles_per_ms;
        self.origin = cycle;
        self.cycles_per_ms = (hz / 1000).max(1);
    }

    /// Cycles of so many milliseconds.
    pub(super) fn milliseconds(&self, ms: u64) -> u64 {
        ms * self.cycles_per_ms
    }

    pub(super) fn cycles(&self, bits: u64) -> u64 {
        (bits * self.cycles_per_ms).div_ceil(FRAME_BITS)
    }

    /// The number of the frame that a cycle is in: 11 bits.
    pub(super) fn frame(&self, cycle: u64) -> u32 {
        let frames = cycle.saturating_sub(self.origin) / self.cycles_per_ms;
        ((self.number + frames) & 0x7ff) as u32
    }

    /// The cycle in which the frame that a cycle is in began.
    fn frame_start(&self, cycle: u64) -> u64 {
        let since = cycle.saturating_sub(self.origin);
        self.origin + since - since % self.cycles_per_ms
    }

    /// The cycle in which the next frame begins.
    pub(super) fn next_frame(&self, cycle: u64) -> u64 {
        self.frame_start(cycle) + self.cycles_per_ms
    }

    /// The cycles in which a transaction begins and ends that can begin in a cycle or later: whole within a frame,
    /// after its start.
    pub(super) fn fit(&self, from: u64, bits: u64) -> (u64, u64) {
        let frame = self.frame_start(from);
        let begin = from.max(frame + self.cycles(START_BITS));
        let end = begin + self.cycles(bits);
        if end <= frame + self.cycles_per_ms {
            return (begin, end);
        }
        let begin = frame + self.cycles_per_ms + self.cycles(START_BITS);
        (begin, begin + self.cycles(bits))
    }

    /// The first cycle from `now` on at which the PC comes back to a device that it has been asking since `since`, every
    /// so many bit times.
    pub(super) fn next_poll(&self, since: u64, now: u64, bits: u64) -> u64 {
        let period = self.cycles(bits).max(1);
        since + now.saturating_sub(since).div_ceil(period) * period
    }
}
