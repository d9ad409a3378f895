//! Settings in the last two sectors of the flash, kept without power: a copy in each sector, of which the newer one counts.
//!
//! A copy has a number, the settings and a CRC. A new copy overwrites the older one, so that the settings before it are still there
//! if the supply fails meanwhile.

use crate::flash::{self, SECTOR};
use pulsetrain_core::baked::PROGRAM_FLASH_BYTES;
use pulsetrain_core::wire::frame::check;
use pulsetrain_core::wire::settings::SETTINGS_LEN;

/// Addresses of the copies in the flash.
const COPY_ADDRESSES: [u32; 2] = [PROGRAM_FLASH_BYTES, PROGRAM_FLASH_BYTES + SECTOR as u32];

/// Bytes of number and settings, without their CRC.
const CHECKED_BYTES: usize = 1 + SETTINGS_LEN;
const COPY_BYTES: usize = CHECKED_BYTES + 2;

/// What is in a sector.
#[derive(Clone, Copy)]
enum StoredCopy {
    None,
    /// Not erased, and no settings either.
    Damaged,
    Whole {
        /// The newer of two copies has the higher number, modulo 256.
        number: u8,
        settings: [u8; SETTINGS_LEN],
    },
}

impl StoredCopy {
    fn of(bytes: &[u8; COPY_BYTES]) -> StoredCopy {
        let [number, settings @ .., high, low] = *bytes;
        if check(&bytes[..CHECKED_BYTES]) == [high, low] {
            StoredCopy::Whole { number, settings }
        } else if *bytes == [0xff; COPY_BYTES] {
            StoredCopy::None
        } else {
            StoredCopy::Damaged
        }
    }

    fn read(at: u32) -> StoredCopy {
        let mut bytes = [0; COPY_BYTES];
        // A flash that does not answer keeps nothing.
        if flash::read(at, &mut bytes) { StoredCopy::of(&bytes) } else { StoredCopy::None }
    }
}

/// The copies in the flash, as they were read last.
pub(crate) struct Store([StoredCopy; 2]);

impl Store {
    /// Nothing was read yet.
    pub(crate) const EMPTY: Store = Store([StoredCopy::None; 2]);

    /// Reads both copies, while nothing reads the flash in place.
    pub(crate) fn read() -> Store {
        Store(COPY_ADDRESSES.map(StoredCopy::read))
    }

    /// Which copy counts.
    fn newest(&self) -> Option<usize> {
        match self.0 {
            [StoredCopy::Whole { number: first, .. }, StoredCopy::Whole { number: second, .. }] => {
                Some(usize::from(second.wrapping_sub(first) < 0x80))
            }
            [StoredCopy::Whole { .. }, _] => Some(0),
            [_, StoredCopy::Whole { .. }] => Some(1),
            _ => None,
        }
    }

    /// The settings, if any are kept.
    pub(crate) fn settings(&self) -> Option<&[u8; SETTINGS_LEN]> {
        match self.newest().map(|place| &self.0[place]) {
            Some(StoredCopy::Whole { settings, .. }) => Some(settings),
            _ => None,
        }
    }

    /// Whether a copy is damaged.
    pub(crate) fn is_damaged(&self) -> bool {
        self.0.iter().any(|copy| matches!(copy, StoredCopy::Damaged))
    }

    /// Keeps `settings`, if the flash takes them; the same settings are not written again. Takes 45 ms, at most 0.4 s, in which
    /// nothing may read the flash in place. `clock` is called every now and then, and returns the time, ticks.
    pub(crate) fn write(&mut self, settings: &[u8; SETTINGS_LEN], mut clock: impl FnMut() -> u64) {
        if self.settings() == Some(settings) && !self.is_damaged() {
            return;
        }
        let (newest, number) = match self.newest().map(|place| (place, self.0[place])) {
            Some((place, StoredCopy::Whole { number, .. })) => (place, number),
            _ => (1, 0),
        };
        let mut bytes = [0; COPY_BYTES];
        bytes[0] = number.wrapping_add(1);
        bytes[1..CHECKED_BYTES].copy_from_slice(settings);
        let sum = check(&bytes[..CHECKED_BYTES]);
        bytes[CHECKED_BYTES..].copy_from_slice(&sum);
        let older = 1 - newest;
        self.0[older] = replace(older, &bytes, &mut clock);
        if matches!((self.0[older], self.0[newest]), (StoredCopy::Whole { .. }, StoredCopy::Damaged)) {
            // Its damage is of no use any more, and would be reported for ever.
            flash::erase(COPY_ADDRESSES[newest], &mut clock);
            self.0[newest] = StoredCopy::read(COPY_ADDRESSES[newest]);
        }
    }
}

/// Writes a copy, and returns what is there then.
fn replace(place: usize, bytes: &[u8; COPY_BYTES], clock: &mut impl FnMut() -> u64) -> StoredCopy {
    let at = COPY_ADDRESSES[place];
    if flash::erase(at, clock) {
        flash::program(at, bytes, clock);
    }
    StoredCopy::read(at)
}
