//! Settings that a board keeps without power, for everything that a host's configuration leaves open.

/// Bytes of [`Settings`], in frames and in a board's memory, where their CRC ([`check`](super::frame::check)) follows.
pub const SETTINGS_LEN: usize = 14;

/// Settings that a board keeps without power: the payload of Store. All zeros mean the board's own defaults.
///
/// | byte | |
/// |---|---|
/// | 2–3 | deadman of text: the initial value for its command `deadman`, ms; 0: off |
/// | 4–5 | idle: text releases the drivers after all axes have rested this long, ms; 0: never |
/// | 6–7 | silence: the meaning of 0 in Configuration, ms; 0: 2000 |
/// | 8–11 | vmax of text, 0.001 steps/s, at most 10 000 000; with amax 0: the board's default |
/// | 12–15 | amax of text, 0.001 steps/s², 1000 to 250 000 000; 0: the board's default |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Settings {
    /// Text stops the axes after this long without a line, ms; 0: never.
    pub deadman_ms: u16,
    /// Text releases the drivers after this long a rest, ms; 0: never.
    pub idle_ms: u16,
    /// A host counts as lost after this long without a frame, ms, if its configuration has 0; 0: 2000.
    pub silence_ms: u16,
    /// Greatest speed of text's axes, 0.001 steps/s.
    pub vmax: u32,
    /// Greatest acceleration of text's axes, 0.001 steps/s²; 0: the board's defaults hold for this and for [`vmax`](Settings::vmax).
    pub amax: u32,
}

/// The stored settings of a board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Stored {
    /// The valid settings; `None` if nothing was stored, or only damaged settings are there.
    pub settings: Option<Settings>,
    /// Whether damaged settings were found, so that older ones are used, or none. Only a Pico reports it. To an Uno, damaged
    /// settings look like none.
    pub is_damaged: bool,
}

/// The greatest vmax that text's command `l` takes as it is (docs/winch.md), 0.001 steps/s. It is the fastest that a path may go.
pub const MAX_VMAX: u32 = 10_000_000;
/// Lowest and highest amax that `l` takes as it is, 0.001 steps/s².
pub const AMAX: [u32; 2] = [1000, 250_000_000];

/// The settings in a payload of Store, in the bytes that a board stores; `None` if the length is wrong, or a limit is out of the range in the
/// table of [`Settings`].
#[must_use]
pub fn of_payload(payload: &[u8]) -> Option<&[u8; SETTINGS_LEN]> {
    let bytes: &[u8; SETTINGS_LEN] = payload.try_into().ok()?;
    let (vmax, amax) = limits(bytes);
    let possible = if amax == 0 { vmax == 0 } else { amax >= AMAX[0] && amax <= AMAX[1] && vmax <= MAX_VMAX };
    possible.then_some(bytes)
}

/// The silence in stored settings, ms.
#[must_use]
pub const fn silence_ms(bytes: &[u8; SETTINGS_LEN]) -> u16 {
    let [_, _, _, _, low, high, ..] = *bytes;
    u16::from_le_bytes([low, high])
}

/// vmax and amax in stored settings.
const fn limits(bytes: &[u8; SETTINGS_LEN]) -> (u32, u32) {
    let [_, _, _, _, _, _, v0, v1, v2, v3, a0, a1, a2, a3] = *bytes;
    (u32::from_le_bytes([v0, v1, v2, v3]), u32::from_le_bytes([a0, a1, a2, a3]))
}

impl Settings {
    /// Reads a payload of Store, or stored bytes; `None` where [`of_payload`] has none.
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

    /// The bytes that [`decode`](Settings::decode) reads.
    #[must_use]
    pub const fn to_bytes(&self) -> [u8; SETTINGS_LEN] {
        let Settings { deadman_ms, idle_ms, silence_ms, vmax, amax } = self;
        let ([d0, d1], [i0, i1], [s0, s1]) =
            (deadman_ms.to_le_bytes(), idle_ms.to_le_bytes(), silence_ms.to_le_bytes());
        let ([v0, v1, v2, v3], [a0, a1, a2, a3]) = (vmax.to_le_bytes(), amax.to_le_bytes());
        [d0, d1, i0, i1, s0, s1, v0, v1, v2, v3, a0, a1, a2, a3]
    }
}
