//! Settings that a board keeps without power, for everything that a host's configuration leaves open.

/// Bytes of [`Settings`], in frames and in a board's memory, where their CRC ([`check`](super::frame::check)) follows.
pub const SETTINGS_LEN: usize = 14;

/// Settings that a board keeps without power, as the payload of Store; without payload Store only asks. All zeros are a board's own.
///
/// | byte | |
/// |---|---|
/// | 2–3 | deadman of text, as its command sets it, ms; 0: off |
/// | 4–5 | idle: text releases the drivers when all axes have rested for so long, ms; 0: not |
/// | 6–7 | silence: what 0 means in Configuration, ms; 0: 2000 |
/// | 8–11 | vmax of text, 0.001 steps/s, at most 10 000 000; with amax 0: the board's own |
/// | 12–15 | amax of text, 0.001 steps/s², 1000 to 250 000 000; 0: the board's own |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// Deadman of text, ms; 0: off.
    pub deadman_ms: u16,
    /// Text releases the drivers after so long a rest, ms; 0: not.
    pub idle_ms: u16,
    /// A host counts as lost after this long without a frame, ms, if its configuration has 0; 0: 2000.
    pub silence_ms: u16,
    /// Greatest speed of text's axes, 0.001 steps/s.
    pub vmax: u32,
    /// Greatest acceleration of text's axes, 0.001 steps/s²; 0: this and [`vmax`](Settings::vmax) are the board's own.
    pub amax: u32,
}

/// The stored settings of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// The valid settings; `None`: nothing was stored, or it was damaged.
    pub settings: Option<Settings>,
    /// Whether damaged settings were found, so that older ones hold, or none. A Pico can tell; on an Uno damaged
    /// settings are as if nothing had been stored.
    pub is_damaged: bool,
}

/// What text's command `l` takes without cutting it down (docs/winch.md), 0.001 steps/s and 0.001 steps/s².
pub const MOST_VMAX: u32 = 10_000_000;
/// Least and most acceleration.
pub const AMAX: [u32; 2] = [1000, 250_000_000];

/// The settings in a payload of Store, as a board keeps them; `None` if it is none, or limits are beyond what the table of [`Settings`]
/// says.
#[must_use]
pub fn of_payload(payload: &[u8]) -> Option<&[u8; SETTINGS_LEN]> {
    let bytes: &[u8; SETTINGS_LEN] = payload.try_into().ok()?;
    let (vmax, amax) = limits(bytes);
    let possible = if amax == 0 { vmax == 0 } else { amax >= AMAX[0] && amax <= AMAX[1] && vmax <= MOST_VMAX };
    possible.then_some(bytes)
}

/// Silence, as a board keeps it, ms.
#[must_use]
pub const fn silence_ms(bytes: &[u8; SETTINGS_LEN]) -> u16 {
    let [_, _, _, _, low, high, ..] = *bytes;
    u16::from_le_bytes([low, high])
}

/// Greatest speed and acceleration.
const fn limits(bytes: &[u8; SETTINGS_LEN]) -> (u32, u32) {
    let [_, _, _, _, _, _, v0, v1, v2, v3, a0, a1, a2, a3] = *bytes;
    (u32::from_le_bytes([v0, v1, v2, v3]), u32::from_le_bytes([a0, a1, a2, a3]))
}

impl Settings {
    /// Of a payload of Store, or what was kept of it; `None` as [`of_payload`] says.
    #[must_use]
    pub fn decode(payload: &[u8]) -> Option<Settings> {
        let bytes = of_payload(payload)?;
        let [d0, d1, i0, i1, ..] = *bytes;
        let (vmax, amax) = limits(bytes);
        Some(Settings {
            deadman_ms: u16::from_le_bytes([d0, d1]),
            idle_ms: u16::from_le_bytes([i0, i1]),
            silence_ms: silence_ms(bytes),
            vmax,
            amax,
        })
    }

    /// The bytes of them.
    #[must_use]
    pub const fn to_bytes(&self) -> [u8; SETTINGS_LEN] {
        let Settings { deadman_ms, idle_ms, silence_ms, vmax, amax } = self;
        let ([d0, d1], [i0, i1], [s0, s1]) =
            (deadman_ms.to_le_bytes(), idle_ms.to_le_bytes(), silence_ms.to_le_bytes());
        let ([v0, v1, v2, v3], [a0, a1, a2, a3]) = (vmax.to_le_bytes(), amax.to_le_bytes());
        [d0, d1, i0, i1, s0, s1, v0, v1, v2, v3, a0, a1, a2, a3]
    }
}
