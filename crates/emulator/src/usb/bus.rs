//! Time on a full-speed bus: frames of 1 ms, 12 000 bit times each (USB 2.0 §5.3.3, §7.1.11).

/// Length of a frame, bit times.
const FRAME_BITS: u64 = 12_000;
/// Length of a start of frame, bit times: synchronisation, packet identifier, number with CRC, end make 5 bytes.
const START_BITS: u64 = 5 * 8;
/// Length of a transaction without its data, bytes (table 5-9): 3 synchronisations, 3 packet identifiers, address with
/// CRC, CRC of the data, 3 bytes of delays between packets.
const OVERHEAD_BYTES: u64 = 13;
const _: () = assert!((FRAME_BITS - START_BITS) / transaction_bits(64) == 19, "table 5-9: 19 transfers of 64 bytes");
/// Length of an IN token that is refused, bit times: token of 4 bytes, delay, handshake of 2 bytes, delay.
pub(super) const REFUSED_IN_BITS: u64 = 8 * 8;

/// Length of a transaction with this many bytes of data, bit times.
pub(super) const fn transaction_bits(bytes: u64) -> u64 {
    (OVERHEAD_BYTES + bytes) * 8
}

#[derive(Clone, Debug)]
pub(super) struct Bus {
    cycles_per_ms: u64,
    /// The cycle in which a frame began, and the number of that frame.
    origin: u64,
    number: u64,
}

impl Bus {
    pub(super) fn new() -> Bus {
        Bus { cycles_per_ms: 1, origin: 0, number: 0 }
    }

    /// Sets the cycles in a second from a cycle on. A new frame begins in that cycle.
    pub(super) fn set_clock(&mut self, hz: u64, cycle: u64) {
        self.number += (cycle - self.origin) / self.cycles_per_ms;
        self.origin = cycle;
        self.cycles_per_ms = (hz / 1000).max(1);
    }

    /// The number of cycles in some milliseconds.
    pub(super) fn milliseconds(&self, ms: u64) -> u64 {
        ms * self.cycles_per_ms
    }

    pub(super) fn cycles(&self, bits: u64) -> u64 {
        (bits * self.cycles_per_ms).div_ceil(FRAME_BITS)
    }

    /// The number, of 11 bits, of the frame that a cycle is in.
    pub(super) fn frame(&self, cycle: u64) -> u32 {
        let frames = cycle.saturating_sub(self.origin) / self.cycles_per_ms;
        ((self.number + frames) & 0x7ff) as u32
    }

    /// The cycle in which the frame began that a cycle is in.
    fn frame_start(&self, cycle: u64) -> u64 {
        let since = cycle.saturating_sub(self.origin);
        self.origin + since - since % self.cycles_per_ms
    }

    /// The cycle in which the next frame begins.
    pub(super) fn next_frame(&self, cycle: u64) -> u64 {
        self.frame_start(cycle) + self.cycles_per_ms
    }

    /// The cycles in which a transaction begins and ends that is ready in a cycle. It must lie within one frame, after
    /// its start.
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

    /// The first cycle from `now` on in which the PC polls the device, if it has polled since `since` every `bits` bit
    /// times.
    pub(super) fn next_poll(&self, since: u64, now: u64, bits: u64) -> u64 {
        let period = self.cycles(bits).max(1);
        since + now.saturating_sub(since).div_ceil(period) * period
    }
}
