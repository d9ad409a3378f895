//! What a plan costs on the wire.

use crate::Move;
use crate::settings::Settings;
use pulsetrain_core::Item;
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};

/// Counts the payload bytes of a stream of moves.
#[derive(Clone, Debug)]
pub(crate) struct Meter {
    packing: Packing,
    state: State,
    bytes: u64,
    segments: u64,
}

impl Meter {
    pub(crate) fn new(settings: &Settings) -> Meter {
        let packing =
            Packing { fraction_bits: settings.registers.fraction_bits, gain: settings.gain().unwrap_or(i8::MAX) };
        Meter { packing, state: State::default(), bytes: 0, segments: 0 }
    }

    pub(crate) fn add(&mut self, next: &Move) {
        let item = match *next {
            // Long waits take one record for each 2^31 ticks.
            Move::Dwell { ticks } => {
                self.bytes += 6 * (ticks >> 31);
                Item::Dwell { ticks: (ticks & ((1 << 31) - 1)) as u32 }
            }
            Move::Run { segment, direction } => {
                self.segments += 1;
                Item::Run { segment, direction }
            }
        };
        let mut buffer = [0; MAX_PACKED_LEN];
        // Planned segments have steps, and the buffer is long enough.
        self.bytes += self.packing.pack(&mut self.state, &item, &mut buffer).unwrap_or(MAX_PACKED_LEN) as u64;
    }

    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }

    pub(crate) fn segments(&self) -> u64 {
        self.segments
    }
}
