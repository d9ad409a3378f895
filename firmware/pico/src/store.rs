//! Settings in the last two sectors of the flash, which keep them without power: a copy in each, of which the newer one holds.
//!
//! A copy is its number, the settings and their CRC. Each new one takes the place of the older, so that a supply which fails
//! meanwhile leaves those before.

use crate::flash::{self, SECTOR};
use pulsetrain_core::baked::FLASH_ROOM;
use pulsetrain_core::wire::frame::check;
use pulsetrain_core::wire::settings::SETTINGS_LEN;

/// Where the copies are.
const PLACES: [u32; 2] = [FLASH_ROOM, FLASH_ROOM + SECTOR as u32];

/// Number and settings, without their CRC.
const CHECKED: usize = 1 + SETTINGS_LEN;
const LEN: usize = CHECKED + 2;

/// What is in a sector.
#[derive(Clone, Copy)]
enum Copy {
    None,
    /// Neither nothing nor settings.
    Damaged,
    Whole {
        /// Of two copies the one with the higher number is newer, modulo 256.
        number: u8,
        settings: [u8; SETTINGS_LEN],
    },
}

impl Copy {
    fn of(bytes: &[u8; LEN]) -> Copy {
        let [number, settings @ .., high, low] = *bytes;
        if check(&bytes[..CHECKED]) == [high, low] {
            Copy::Whole { number, settings }
        } else if *bytes == [0xff; LEN] {
            Copy::None
        } else {
            Copy::Damaged
        }
    }

    fn read(at: u32) -> Copy {
        let mut bytes = [0; LEN];
        // Who does not answer keeps nothing.
        if flash::read(at, &mut bytes) { Copy::of(&bytes) } else { Copy::None }
    }
}

/// What the flash keeps, as it was read last.
pub(crate) struct Store([Copy; 2]);

impl Store {
    /// Nothing was read yet.
    pub(crate) const EMPTY: Store = Store([Copy::None; 2]);

    /// Reads it. While nobody reads in place.
    pub(crate) fn read() -> Store {
        Store(PLACES.map(Copy::read))
    }

    /// Which copy holds.
    fn newest(&self) -> Option<usize> {
        match self.0 {
            [Copy::Whole { number: first, .. }, Copy::Whole { number: second, .. }] => {
                Some(usize::from(second.wrapping_sub(first) < 0x80))
            }
            [Copy::Whole { .. }, _] => Some(0),
            [_, Copy::Whole { .. }] => Some(1),
            _ => None,
        }
    }

    /// The settings, if any are kept.
    pub(crate) fn settings(&self) -> Option<&[u8; SETTINGS_LEN]> {
        match self.newest().map(|place| &self.0[place]) {
            Some(Copy::Whole { settings, .. }) => Some(settings),
            _ => None,
        }
    }

    /// Whether a copy is damaged.
    pub(crate) fn is_damaged(&self) -> bool {
        self.0.iter().any(|copy| matches!(copy, Copy::Damaged))
    }

    /// Keeps `settings` from now on, if the flash takes them: for 45 ms, at most 0.4 s, in which nobody may read in place, and `look` is
    /// called every now and then, which gives the time, ticks. What is kept already is not written again.
    pub(crate) fn write(&mut self, settings: &[u8; SETTINGS_LEN], mut look: impl FnMut() -> u64) {
        if self.settings() == Some(settings) && !self.is_damaged() {
            return;
        }
        let (newest, number) = match self.newest().map(|place| (place, self.0[place])) {
            Some((place, Copy::Whole { number, .. })) => (place, number),
            _ => (1, 0),
        };
        let mut bytes = [0; LEN];
        bytes[0] = number.wrapping_add(1);
        bytes[1..CHECKED].copy_from_slice(settings);
        let sum = check(&bytes[..CHECKED]);
        bytes[CHECKED..].copy_from_slice(&sum);
        let older = 1 - newest;
        self.0[older] = replace(older, &bytes, &mut look);
        if matches!((self.0[older], self.0[newest]), (Copy::Whole { .. }, Copy::Damaged)) {
            // There is nothing left that it would tell.
            flash::erase(PLACES[newest], &mut look);
            self.0[newest] = Copy::read(PLACES[newest]);
        }
    }
}

/// Writes a copy; what is there then.
fn replace(place: usize, bytes: &[u8; LEN], look: &mut impl FnMut() -> u64) -> Copy {
    let at = PLACES[place];
    if flash::erase(at, look) {
        flash::program(at, bytes, look);
    }
    Copy::read(at)
}
