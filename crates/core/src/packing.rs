//! Packs segments into few bytes. A segment is sent as corrections to what the segment before predicts. Both ends derive the
//! units of these corrections from the count of the segment before.
//!
//! # State
//! Both ends keep the [`State`]: the three registers (interval, add, add2) as they stand after the last step, the
//! count of the last segment, and the direction. It starts, and starts again at a [reset](Control), with all
//! registers 0 and a previous count of 4; the direction starts forward.
//! The accumulator's fraction is not part of it. It carries on through segments, waits, reversals and resets; only an anchor sets
//! it, to ½.
//!
//! # A segment
//! | byte | bits | |
//! |---|---|---|
//! | 0 | 0–2 | count: n + n/2, n + n/4, n + n/8, n, n − n/8, n − n/4, n − n/2 (n the previous count, quotients rounded down), 7: explicit. The lowest code that gives the count |
//! | | 3–4 | widths, narrow / wide: 0 / 1, 1 / 2, 2 / 3, 3 / 5 bytes |
//! | | 5, 6, 7 | whether the interval's, add's, add2's correction is wide |
//! | 1 | | if explicit: the count, 1..=254; 255: it follows in two bytes, little-endian, 1..=65535; 0: a control record |
//! | then | | the corrections dI, da, db, little-endian, two's complement |
//!
//! A register is its prediction + correction · 2^(F − shift), with the shift of [`unit_shift`]. A segment of one step
//! has no da and db, and one of two steps has no db: those registers keep their prediction. The values of the registers after the
//! segment's steps are the prediction for the next segment.
//!
//! # A control record
//! | byte | bits | |
//! |---|---|---|
//! | 0 | 0–2 | 7 |
//! | | 3–7 | what: see [`Control`] |
//! | 1 | | 0 |
//! | 2–5 | | dwell: ticks; anchor: tick; little-endian. Reversal and reset: absent |
//! | 2–3, 4–7, 8–9 | | check only: steps since the anchor, forward minus backward, modulo 2^16; accumulator: tick, fraction · 2^16; little-endian |
//!
//! # Checks
//! A check says where the motor must be when all items before it are done. A board compares. If the motor is elsewhere, the plan was
//! damaged, and the board ignores what follows, up to the next anchor. A check is no item; [`Packing::unpack`] passes over it.
//!
//! # An exact segment
//! An exact segment has whole registers instead of corrections. It is for a segment that does not fit the units or the widths of
//! corrections: a step that was delayed because of a shared DIR line, or the rest of a segment whose first step was delayed.
//!
//! | byte | bits | |
//! |---|---|---|
//! | 0, 1 | | 0x27, 0: the control record 4 |
//! | 2 | 0–3 | bytes of the interval, 0..=8 |
//! | | 4–7 | bytes of add, 0..=8 |
//! | 3 | 0–3 | bytes of add2, 0..=8 |
//! | | 4–7 | bytes of the count, 1..=4 |
//! | then | | count, interval, add, add2, little-endian, the last three in two's complement; one without bytes is 0 |
//!
//! A segment of one step has no bytes for add and add2, one of two steps none for add2: these keep their prediction. The next
//! prediction is made as after any segment, but the previous count then counts as [`COUNT_AFTER_EXACT`] at least: the segment after
//! one that was cut was planned in the units that follow the whole one.

use crate::{Direction, Item, Recurrence, RegisterWidths, Segment, Tick32};

/// The longest packed item: a reversal and an exact segment.
pub const MAX_PACKED_LEN: usize = 2 + 4 + 4 + 3 * 8;

/// After an exact segment the previous count counts as this at least. These units are as fine as those after a segment of up to 255
/// steps, of which the exact one may be the rest.
pub const COUNT_AFTER_EXACT: u32 = 255;

/// The largest count in a header: two bytes. A longer segment is packed as an exact one.
pub const MAX_EXPLICIT_COUNT: u32 = 65_535;

/// The longest segment that [`Packing::unpack_continued`] takes, bytes: header, count, three corrections of up to three bytes.
pub(crate) const MAX_CONTINUED_LEN: usize = 2 + 3 * 3;

/// Bytes of narrow and wide corrections, by header bits 3–4.
const WIDTHS: [(u8, u8); 4] = [(0, 1), (1, 2), (2, 3), (3, 5)];

const EXPLICIT_COUNT: u8 = 7;
const LONG_COUNT: u8 = 255;

/// The kinds of control records: header bits 3–7.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Control {
    /// The direction changes, and the state is reset.
    Reverse = 0,
    /// The state is reset: registers 0, previous count 4.
    Reset = 1,
    /// Wait.
    Dwell = 2,
    /// Set the accumulator.
    Anchor = 3,
    /// An exact segment follows.
    Exact = 4,
    /// Where the motor must be.
    Check = 5,
}

/// Where a motor must be when all items before are done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Check {
    /// Steps since the last anchor, forward minus backward, modulo 2^16. They count from the anchor, because the sender may not know the
    /// motor's position there.
    pub position: u16,
    /// The tick of the accumulator, waits included.
    pub tick: Tick32,
    /// The accumulator's fraction, 2^-16 ticks.
    pub fraction: u16,
}

/// Bytes of a packed [`Check`].
pub const CHECK_LEN: usize = 2 + 2 + 4 + 2;

/// The unit of a correction is 2^-(shift) tick; `order` 1 is the interval, 2 add, 3 add2.
///
/// `previous_count` is the count of the segment before (4 after a reset), `fraction_bits` the board's F. `gain` makes all units
/// of a stream finer. Shifts are clamped to 0..=F. Longer segments have finer units, because an error in interval, add or add2 grows
/// with the count, its square, or its cube.
///
/// ```
/// use pulsetrain_core::packing::unit_shift;
/// assert_eq!(unit_shift(1, 8, 0, 16), 6);  // bitlen(8) + 2
/// assert_eq!(unit_shift(1, 8, 3, 16), 9);
/// assert_eq!(unit_shift(3, 100, 0, 16), 16); // 3·7 − 5, clamped
/// ```
#[must_use]
pub const fn unit_shift(order: u32, previous_count: u32, gain: i8, fraction_bits: u32) -> u32 {
    let bits = (u32::BITS - previous_count.leading_zeros()).cast_signed();
    let shift = match order {
        1 => bits + 2,
        2 => 2 * bits - 2,
        _ => 3 * bits - 5,
    } + gain as i32;
    if shift < 0 {
        0
    } else if shift > fraction_bits.cast_signed() {
        fraction_bits
    } else {
        shift.cast_unsigned()
    }
}

/// The parameters of a stream of packed items. Sender and board must have the same ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Packing {
    /// F of the board's recurrence, 0..=32.
    pub fraction_bits: u32,
    /// By how many bits units are finer; about −log2((E − ½) / ½) for a tolerance of E ticks.
    pub gain: i8,
}

/// The units of corrections after the last segment. They are kept here, since they change only with the number of bits of its count, and
/// take long to work out on a board.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Units {
    /// Bits of that count, minus one.
    bits: u8,
    exponents: [u8; 3],
}

impl Units {
    /// For no count: the first call works the units out.
    pub(crate) const UNKNOWN: Units = Units { bits: 31, exponents: [0; 3] };

    /// The exponents of the three units after a segment of `previous_count` steps, below 2^31.
    #[expect(clippy::cast_possible_truncation, reason = "up to 32")]
    #[inline(always)]
    fn exponents(&mut self, packing: &Packing, previous_count: u32) -> [u8; 3] {
        if previous_count >> self.bits != 1 {
            self.bits = (u32::BITS - 1).saturating_sub(previous_count.leading_zeros()) as u8;
            self.exponents = packing.exponents(previous_count).map(|exponent| exponent as u8);
        }
        self.exponents
    }
}

/// The state that both ends keep: the prediction of the next segment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct State {
    /// Count of the last segment.
    pub previous_count: u32,
    /// The interval after its last step, ticks · 2^F.
    pub interval: i64,
    /// The change of the interval, ticks · 2^F.
    pub add: i64,
    /// The change of that, ticks · 2^F.
    pub add2: i64,
    /// The direction of the segments that follow.
    pub direction: Direction,
}

impl State {
    /// The state after a reset.
    #[must_use]
    pub const fn new(direction: Direction) -> State {
        State { previous_count: 4, interval: 0, add: 0, add2: 0, direction }
    }

    /// The registers of an exact segment: its own where it has bytes for them, else the prediction.
    fn with(&self, exact: &Segment) -> [i64; 3] {
        let (mut all, registers) = ([self.interval, self.add, self.add2], [exact.interval, exact.add, exact.add2]);
        let fields = fields_of(exact.count);
        all[..fields].copy_from_slice(&registers[..fields]);
        all
    }

    /// The state after an exact segment.
    fn after_exact(self, exact: &Segment) -> State {
        let [interval, add, add2] = self.with(exact);
        let after = self.after(&Segment { interval, add, add2, ..*exact });
        State { previous_count: exact.count.max(COUNT_AFTER_EXACT), ..after }
    }

    /// The state after `segment`, an ordinary one.
    const fn after(self, segment: &Segment) -> State {
        let Segment { interval, add, add2, .. } = segment.after(segment.count);
        State { previous_count: segment.count, interval, add, add2, direction: self.direction }
    }
}

impl Default for State {
    fn default() -> State {
        State::new(Direction::Forward)
    }
}

/// Why an item cannot be packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PackError {
    /// A segment has no steps.
    NoSteps,
    /// The buffer is shorter than the packed item.
    Buffer {
        /// Bytes needed.
        needed: usize,
    },
}

/// Why bytes are no packed items.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UnpackError {
    /// They end inside an item.
    Truncated,
    /// The explicit count is 0.
    ZeroCount,
    /// In an exact segment the count has 0 bytes or more than 4, a register has more than 8, or a register has bytes that the count does not
    /// allow.
    ExactWidths {
        /// Bytes 2 and 3, the latter in the high half.
        widths: u16,
    },
    /// The count code gives more than 2^32 − 1 steps.
    CountOverflow,
    /// The control record is unknown.
    UnknownControl {
        /// Header bits 3–7.
        control: u8,
    },
}

/// How a segment is written: its header codes, and the width of each correction.
struct Layout {
    count_code: u8,
    width_code: u8,
    /// Each correction with its width in bytes.
    fields: [(i64, u8); 3],
    /// Which of them are wide; bits 0 to 2.
    wide: u8,
}

impl Packing {
    /// The units of the three corrections after a segment of `previous_count` steps, ticks · 2^F.
    ///
    /// ```
    /// use pulsetrain_core::packing::Packing;
    /// let packing = Packing { fraction_bits: 16, gain: 0 };
    /// assert_eq!(packing.units(8), [1 << 10, 1 << 10, 1 << 9]);
    /// ```
    #[must_use]
    pub const fn units(&self, previous_count: u32) -> [i64; 3] {
        let exponents = self.exponents(previous_count);
        [1 << exponents[0], 1 << exponents[1], 1 << exponents[2]]
    }

    const fn exponents(&self, previous_count: u32) -> [u32; 3] {
        let f = self.fraction_bits;
        [
            f - unit_shift(1, previous_count, self.gain, f),
            f - unit_shift(2, previous_count, self.gain, f),
            f - unit_shift(3, previous_count, self.gain, f),
        ]
    }

    /// Bytes that `segment` takes after `state`, in the same direction.
    ///
    /// # Errors
    /// When it has no steps.
    pub fn packed_len(&self, state: &State, segment: &Segment) -> Result<usize, PackError> {
        if segment.count == 0 {
            return Err(PackError::NoSteps);
        }
        let (reset, state) =
            if self.is_beyond_registers(state, segment) { (2, &State::new(state.direction)) } else { (0, state) };
        let layout = self.layout(state, segment);
        Ok(reset + layout.map_or_else(|| Exact::of(segment).len(), |layout| layout.len(segment.count)))
    }

    /// Packs `item` into the front of `out`, moves `state` on, and returns the number of bytes: at most [`MAX_PACKED_LEN`]. A run in the
    /// other direction gets a reversal before it. A single step whose predicted add is too large for an 8-bit board's registers gets a reset
    /// before it.
    ///
    /// # Errors
    /// When a segment has no steps, or `out` is too short; `state` stays then.
    ///
    /// ```
    /// use pulsetrain_core::packing::{Packing, State};
    /// use pulsetrain_core::{Direction, Item, Segment};
    /// let packing = Packing { fraction_bits: 16, gain: 0 };
    /// let (mut here, mut there) = (State::default(), State::default());
    /// let run = |count, interval| Item::Run {
    ///     segment: Segment { count, interval, add: 0, add2: 0 },
    ///     direction: Direction::Forward,
    /// };
    /// let mut bytes = [0; 21];
    /// assert_eq!(packing.pack(&mut here, &run(40, 100 << 16), &mut bytes), Ok(6));
    /// // The same speed for longer: the header alone says so.
    /// assert_eq!(packing.pack(&mut here, &run(60, 100 << 16), &mut bytes[6..]), Ok(1));
    /// let mut rest = &bytes[..7];
    /// assert_eq!(packing.unpack(&mut there, &mut rest), Ok(Some(run(40, 100 << 16))));
    /// assert_eq!(packing.unpack(&mut there, &mut rest), Ok(Some(run(60, 100 << 16))));
    /// assert_eq!(packing.unpack(&mut there, &mut rest), Ok(None));
    /// ```
    pub fn pack(&self, state: &mut State, item: &Item, out: &mut [u8]) -> Result<usize, PackError> {
        let mut writer = ByteWriter { out, len: 0 };
        match *item {
            Item::Anchor { tick } => writer.control(Control::Anchor, &tick.0.to_le_bytes()),
            Item::Dwell { ticks } => writer.control(Control::Dwell, &ticks.to_le_bytes()),
            Item::Run { segment, direction } => {
                let mut start = *state;
                if direction != start.direction {
                    start = State::new(direction);
                    writer.control(Control::Reverse, &[]);
                } else if self.is_beyond_registers(&start, &segment) {
                    start = State::new(direction);
                    writer.control(Control::Reset, &[]);
                }
                if segment.count == 0 {
                    return Err(PackError::NoSteps);
                }
                let next = match self.layout(&start, &segment) {
                    Some(layout) => {
                        layout.write(segment.count, &mut writer);
                        let [_, add, add2] = self.corrected(&start, layout.fields.map(|(k, _)| k));
                        start.after(&Segment { add, add2, ..segment })
                    }
                    None => {
                        Exact::of(&segment).write(&segment, &mut writer);
                        start.after_exact(&segment)
                    }
                };
                writer.finish()?;
                *state = next;
            }
        }
        writer.finish()
    }

    /// Packs a reset, two bytes. It saves bytes where the motion does not continue as it was, so that the prediction would be far off.
    ///
    /// # Errors
    /// When `out` is too short.
    pub fn pack_reset(&self, state: &mut State, out: &mut [u8]) -> Result<usize, PackError> {
        let mut writer = ByteWriter { out, len: 0 };
        writer.control(Control::Reset, &[]);
        let len = writer.finish()?;
        *state = State::new(state.direction);
        Ok(len)
    }

    /// Packs a check, [`CHECK_LEN`] bytes. It leaves the state as it is.
    ///
    /// # Errors
    /// When `out` is too short.
    pub fn pack_check(&self, check: &Check, out: &mut [u8]) -> Result<usize, PackError> {
        let mut writer = ByteWriter { out, len: 0 };
        writer.control(Control::Check, &check.position.to_le_bytes());
        writer.bytes(&check.tick.0.to_le_bytes());
        writer.bytes(&check.fraction.to_le_bytes());
        writer.finish()
    }

    /// Takes the next item off the front of `bytes` and moves `state` on; `None` when no item is left.
    ///
    /// # Errors
    /// When the bytes are no packed items. Then `state` and `bytes` stay as they were.
    pub fn unpack(&self, state: &mut State, bytes: &mut &[u8]) -> Result<Option<Item>, UnpackError> {
        let mut now = *state;
        let mut rest = *bytes;
        let item = loop {
            let Some((&header, after)) = rest.split_first() else { break None };
            rest = after;
            let n = now.previous_count;
            let count = match header & 7 {
                0 => n.checked_add(n >> 1),
                1 => n.checked_add(n >> 2),
                2 => n.checked_add(n >> 3),
                3 => Some(n),
                4 => Some(n - (n >> 3)),
                5 => Some(n - (n >> 2)),
                6 => Some(n - (n >> 1)),
                _ => match take::<1>(&mut rest)? {
                    [0] => None,
                    [LONG_COUNT] => Some(u32::from(u16::from_le_bytes(take(&mut rest)?))),
                    [count] => Some(u32::from(count)),
                },
            };
            match count {
                Some(0) => return Err(UnpackError::ZeroCount),
                Some(count) => break Some(self.unpack_run(&mut now, count, header, &mut rest)?),
                None if header & 7 != EXPLICIT_COUNT => return Err(UnpackError::CountOverflow),
                None => {}
            }
            match header >> 3 {
                0 => now = State::new(now.direction.reversed()),
                1 => now = State::new(now.direction),
                2 => break Some(Item::Dwell { ticks: u32::from_le_bytes(take(&mut rest)?) }),
                3 => break Some(Item::Anchor { tick: Tick32(u32::from_le_bytes(take(&mut rest)?)) }),
                4 => {
                    let exact = Exact::read(&mut rest)?;
                    let [interval, add, add2] = now.with(&exact);
                    let segment = Segment { interval, add, add2, ..exact };
                    now = now.after_exact(&segment);
                    break Some(Item::Run { segment, direction: now.direction });
                }
                5 => {
                    take::<{ CHECK_LEN - 2 }>(&mut rest)?;
                }
                control => return Err(UnpackError::UnknownControl { control }),
            }
        };
        *state = now;
        *bytes = rest;
        Ok(item)
    }

    /// Takes a segment off the front of `bytes` quickly, if it is of the usual kind: its count in the header or in one byte, corrections of
    /// up to three bytes. `registers` are as after the segment before, of `n` steps; they become this segment's. Returns its steps and its
    /// bytes. `None`, and nothing changes, if it is of another kind: then call [`unpack`](Packing::unpack).
    pub(crate) fn unpack_continued(
        &self,
        units: &mut Units,
        n: u32,
        registers: &mut Recurrence,
        bytes: &[u8; MAX_CONTINUED_LEN],
    ) -> Option<(u32, usize)> {
        if n >= 1 << 15 {
            return None;
        }
        let [header, ref rest @ ..] = *bytes;
        let mut rest = rest.as_slice();
        let count = match header & 7 {
            0 => n + (n >> 1),
            1 => n + (n >> 2),
            2 => n + (n >> 3),
            3 => n,
            4 => n - (n >> 3),
            5 => n - (n >> 2),
            6 => n - (n >> 1),
            _ => match rest {
                // A control record, or a count of two bytes: not the usual kind.
                [0 | LONG_COUNT, ..] | [] => return None,
                [count, after @ ..] => {
                    rest = after;
                    u32::from(*count)
                }
            },
        };
        let width_code = header >> 3 & 3;
        if count == 0 || (width_code == 3 && header >> 5 != 0) {
            return None;
        }
        let exponents = units.exponents(self, n);
        let width = |field: u8| width_code + (header >> (5 + field) & 1);
        rest = correct(&mut registers.interval, rest, width(0), exponents[0]);
        if count > 1 {
            rest = correct(&mut registers.add, rest, width(1), exponents[1]);
        }
        if count > 2 {
            rest = correct(&mut registers.add2, rest, width(2), exponents[2]);
        }
        Some((count, MAX_CONTINUED_LEN - rest.len()))
    }

    fn unpack_run(&self, state: &mut State, count: u32, header: u8, rest: &mut &[u8]) -> Result<Item, UnpackError> {
        let (narrow, wide) = WIDTHS[usize::from(header >> 3 & 3)];
        let mut corrections = [0; 3];
        for (field, correction) in corrections.iter_mut().enumerate().take(fields_of(count)) {
            let width = if header >> (5 + field) & 1 == 1 { wide } else { narrow };
            let (bytes, after) = rest.split_at_checked(usize::from(width)).ok_or(UnpackError::Truncated)?;
            *rest = after;
            *correction = signed(bytes);
        }
        let [interval, add, add2] = self.corrected(state, corrections);
        let segment = Segment { count, interval, add, add2 };
        *state = state.after(&segment);
        Ok(Item::Run { segment, direction: state.direction })
    }

    /// Whether the predicted add is too large for the board's registers. A segment of one step does not set add, so that add2 may have
    /// made it grow over several of these.
    fn is_beyond_registers(&self, state: &State, segment: &Segment) -> bool {
        RegisterWidths::is_narrow(self.fraction_bits) && segment.count == 1 && i32::try_from(state.add).is_err()
    }

    /// The prediction with `corrections` added.
    const fn corrected(&self, state: &State, corrections: [i64; 3]) -> [i64; 3] {
        let exponents = self.exponents(state.previous_count);
        [
            state.interval.wrapping_add(corrections[0] << exponents[0]),
            state.add.wrapping_add(corrections[1] << exponents[1]),
            state.add2.wrapping_add(corrections[2] << exponents[2]),
        ]
    }

    /// How `segment`, which has steps, is written as corrections; `None` if it needs an exact segment.
    fn layout(&self, state: &State, segment: &Segment) -> Option<Layout> {
        let n = state.previous_count;
        let count = segment.count;
        let by_code = [n >> 1, n >> 2, n >> 3, 0].map(|more| n.checked_add(more));
        let less = [n >> 3, n >> 2, n >> 1].map(|less| Some(n - less));
        let codes = by_code.iter().chain(&less);
        let count_code = match (0..EXPLICIT_COUNT).zip(codes).find(|&(_, &coded)| coded == Some(count)) {
            Some((code, _)) => code,
            None if count <= MAX_EXPLICIT_COUNT => EXPLICIT_COUNT,
            None => return None,
        };

        let exponents = self.exponents(n);
        let differences = [
            i128::from(segment.interval) - i128::from(state.interval),
            i128::from(segment.add) - i128::from(state.add),
            i128::from(segment.add2) - i128::from(state.add2),
        ];
        let present = fields_of(count);
        let mut fields = [(0, 0); 3];
        for ((field, difference), exponent) in fields.iter_mut().zip(differences).zip(exponents).take(present) {
            if difference & ((1 << exponent) - 1) != 0 {
                return None;
            }
            let correction = i64::try_from(difference >> exponent).ok()?;
            *field = (correction, width_of(correction));
        }

        let mut best: Option<(u32, Layout)> = None;
        for (width_code, &(narrow, wide)) in (0..).zip(&WIDTHS) {
            let mut layout = Layout { count_code, width_code, fields, wide: 0 };
            let mut total = 0;
            for (bit, (_, width)) in layout.fields.iter_mut().enumerate().take(present) {
                let is_wide = *width > narrow;
                layout.wide |= u8::from(is_wide) << bit;
                // It does not fit this pair of widths. 100 bytes are more than any that fit, so that this pair is not chosen.
                *width = if *width > wide {
                    100
                } else if is_wide {
                    wide
                } else {
                    narrow
                };
                total += u32::from(*width);
            }
            if total < best.as_ref().map_or(100, |(least, _)| *least) {
                best = Some((total, layout));
            }
        }
        best.map(|(_, layout)| layout)
    }
}

impl Layout {
    fn len(&self, count: u32) -> usize {
        let explicit = match (self.count_code, count) {
            (EXPLICIT_COUNT, 0..=254) => 1,
            (EXPLICIT_COUNT, _) => 3,
            _ => 0,
        };
        1 + explicit + self.fields.iter().map(|&(_, width)| usize::from(width)).sum::<usize>()
    }

    fn write(&self, count: u32, writer: &mut ByteWriter<'_>) {
        writer.bytes(&[self.count_code | self.width_code << 3 | self.wide << 5]);
        if self.count_code == EXPLICIT_COUNT {
            match u8::try_from(count) {
                Ok(count) if count < LONG_COUNT => writer.bytes(&[count]),
                _ => {
                    let [low, high, ..] = count.to_le_bytes();
                    writer.bytes(&[LONG_COUNT, low, high]);
                }
            }
        }
        for (correction, width) in self.fields {
            writer.bytes(&correction.to_le_bytes()[..usize::from(width)]);
        }
    }
}

/// The widths of an exact segment's parts, bytes.
struct Exact {
    count: u8,
    registers: [u8; 3],
}

impl Exact {
    fn of(segment: &Segment) -> Exact {
        let bytes = |bits: u32| u8::try_from((bits + 7) >> 3).unwrap_or(8);
        let mut registers = [0; 3];
        let values = [segment.interval, segment.add, segment.add2];
        for (width, value) in registers.iter_mut().zip(values).take(fields_of(segment.count)) {
            // One bit for the sign; 0 takes no bytes.
            let magnitude = if value < 0 { !value } else { value };
            *width = if value == 0 { 0 } else { bytes(u64::BITS - magnitude.leading_zeros() + 1) };
        }
        Exact { count: bytes(u32::BITS - segment.count.leading_zeros()), registers }
    }

    fn len(&self) -> usize {
        4 + usize::from(self.count) + self.registers.iter().map(|&width| usize::from(width)).sum::<usize>()
    }

    fn write(&self, segment: &Segment, writer: &mut ByteWriter<'_>) {
        let [interval, add, add2] = self.registers;
        writer.control(Control::Exact, &[interval | add << 4, add2 | self.count << 4]);
        writer.bytes(&segment.count.to_le_bytes()[..usize::from(self.count)]);
        for (width, value) in self.registers.iter().zip([segment.interval, segment.add, segment.add2]) {
            writer.bytes(&value.to_le_bytes()[..usize::from(*width)]);
        }
    }

    /// Reads what follows the two bytes of the control record. Registers without bytes are 0.
    fn read(rest: &mut &[u8]) -> Result<Segment, UnpackError> {
        let widths: [u8; 2] = take(rest)?;
        let refused = UnpackError::ExactWidths { widths: u16::from_le_bytes(widths) };
        let [interval, add, add2, count_len] = [widths[0] & 15, widths[0] >> 4, widths[1] & 15, widths[1] >> 4];
        if !(1..=4).contains(&count_len) || interval.max(add).max(add2) > 8 {
            return Err(refused);
        }
        let mut part = |len: u8| {
            let (bytes, after) = rest.split_at_checked(usize::from(len)).ok_or(UnpackError::Truncated)?;
            *rest = after;
            Ok(bytes)
        };
        let count = part(count_len)?.iter().rev().fold(0, |count, &byte| count << 8 | u32::from(byte));
        let fields = fields_of(count);
        match count {
            0 => return Err(UnpackError::ZeroCount),
            _ if [0, interval, add, add2][fields + 1..].iter().any(|&len| len > 0) => return Err(refused),
            _ => {}
        }
        Ok(Segment { count, interval: signed(part(interval)?), add: signed(part(add)?), add2: signed(part(add2)?) })
    }
}

/// Writes bytes as long as they fit, and counts all of them.
struct ByteWriter<'a> {
    out: &'a mut [u8],
    len: usize,
}

impl ByteWriter<'_> {
    fn bytes(&mut self, bytes: &[u8]) {
        if let Some(place) = self.out.get_mut(self.len..self.len + bytes.len()) {
            place.copy_from_slice(bytes);
        }
        self.len += bytes.len();
    }

    fn control(&mut self, control: Control, operand: &[u8]) {
        self.bytes(&[EXPLICIT_COUNT | (control as u8) << 3, 0]);
        self.bytes(operand);
    }

    fn finish(&self) -> Result<usize, PackError> {
        if self.len <= self.out.len() { Ok(self.len) } else { Err(PackError::Buffer { needed: self.len }) }
    }
}

/// How many corrections a segment of `count` steps has.
fn fields_of(count: u32) -> usize {
    match count {
        0 | 1 => 1,
        2 => 2,
        _ => 3,
    }
}

/// The narrowest width of [`WIDTHS`] for `value` in two's complement, bytes; 0 for 0, and 8 if none is wide enough.
const fn width_of(value: i64) -> u8 {
    if value == 0 {
        return 0;
    }
    let magnitude = if value < 0 { !value } else { value };
    match u64::BITS - magnitude.leading_zeros() {
        0..8 => 1,
        8..16 => 2,
        16..24 => 3,
        24..40 => 5,
        _ => 8,
    }
}

/// Adds a correction to a register: the first `width` of `bytes`, 3 at most, in units of 2^`exponent`, 2^32 at most. Returns the other
/// bytes.
///
/// It is not inlined, because a Cortex-M0+ has too few registers for this and its caller.
#[inline(never)]
fn correct<'a>(register: &mut i64, bytes: &'a [u8], width: u8, exponent: u8) -> &'a [u8] {
    if width == 0 {
        return bytes;
    }
    let (own, rest) = bytes.split_at_checked(usize::from(width)).unwrap_or_default();
    // The correction stands at the upper end of 32 bits, and these at the upper end of 64. So shifts to the right extend its sign.
    let value = own.iter().fold(0, |value, byte| value >> 8 | u32::from(*byte) << 24);
    let right = 64 - (u32::from(width) << 3) - u32::from(exponent);
    let sign = value.cast_signed();
    let (low, high) = if right < 32 {
        (value << (32 - right), sign >> right)
    } else {
        ((sign >> (right - 32)).cast_unsigned(), sign >> 31)
    };
    *register = register.wrapping_add(i64::from(high) << 32 | i64::from(low));
    rest
}

/// Little-endian two's complement of up to 8 bytes.
fn signed(bytes: &[u8]) -> i64 {
    let mut value = match bytes.last() {
        Some(128..) => -1,
        _ => 0,
    };
    for &byte in bytes.iter().rev() {
        value = value << 8 | i64::from(byte);
    }
    value
}

fn take<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], UnpackError> {
    let (bytes, after) = rest.split_first_chunk().ok_or(UnpackError::Truncated)?;
    *rest = after;
    Ok(*bytes)
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;
    use std::vec::Vec;

    const PACKING: Packing = Packing { fraction_bits: 16, gain: 0 };

    fn check(items: &[Item], expected: &[u8]) {
        let mut state = State::default();
        let mut bytes = Vec::new();
        for item in items {
            let mut buffer = [0; MAX_PACKED_LEN];
            let len = PACKING.pack(&mut state, item, &mut buffer).unwrap();
            bytes.extend(&buffer[..len]);
        }
        assert_eq!(bytes, expected);
        let mut there = State::default();
        let mut rest = &bytes[..];
        for item in items {
            assert_eq!(PACKING.unpack(&mut there, &mut rest), Ok(Some(*item)));
        }
        assert_eq!(PACKING.unpack(&mut there, &mut rest), Ok(None));
        assert_eq!(there, state);
    }

    fn run(count: u32, interval: i64, add: i64, add2: i64, direction: Direction) -> Item {
        Item::Run { segment: Segment { count, interval, add, add2 }, direction }
    }

    #[test]
    fn waits_and_anchors_are_six_bytes() {
        check(
            &[Item::Anchor { tick: Tick32(0x0102_0304) }, Item::Dwell { ticks: 5 }],
            &[0b11111, 0, 4, 3, 2, 1, 0b10111, 0, 5, 0, 0, 0],
        );
    }

    /// An Uno's registers hold an add of 32 bits: where the prediction for one step has more, both ends begin from nothing.
    #[test]
    fn one_step_after_an_add_beyond_32_bits_is_reset() {
        let far = Segment { count: 2, interval: 100 << 16, add: 1 << 31, add2: 0 };
        let step = run(1, 150 << 16, 0, 0, Direction::Forward);
        for (fraction_bits, resets) in [(16, true), (32, false)] {
            let packing = Packing { fraction_bits, gain: 0 };
            let mut state = State::default();
            let mut bytes = [0; MAX_PACKED_LEN];
            let before = run(far.count, far.interval, far.add, far.add2, Direction::Forward);
            packing.pack(&mut state, &before, &mut bytes).unwrap();
            let Item::Run { segment, .. } = step else { unreachable!() };
            let expected = packing.packed_len(&state, &segment);
            let len = packing.pack(&mut state, &step, &mut bytes);
            assert_eq!(len, expected);
            assert_eq!(bytes[..2] == [0b1111, 0], resets, "{fraction_bits} bits: {:?}", &bytes[..len.unwrap()]);
        }
    }

    proptest! {
        /// What is taken straight into the recurrence is what is taken as an item.
        #[test]
        fn a_run_taken_onward_is_the_item(
            bits in 16u32..=32,
            gain in -8i8..4,
            parts in prop::collection::vec((prop_oneof![1u32..4, 1u32..70, 1u32..70_000], any::<[i32; 3]>(), 0u32..32), 1..20),
        ) {
            let packing = Packing { fraction_bits: bits, gain };
            let (mut here, mut there) = (State::default(), State::default());
            let (mut units, mut taken_onward) = (Units::UNKNOWN, 0);
            for (count, corrections, scale) in parts {
                let [interval, add, add2] = packing.corrected(&here, corrections.map(|by| i64::from(by >> scale)));
                let mut bytes = [0; MAX_PACKED_LEN];
                let item = run(count, interval, add, add2, Direction::Forward);
                let len = packing.pack(&mut here, &item, &mut bytes).unwrap();
                let mut registers = Recurrence { accumulator: 5, interval: there.interval, add: there.add, add2: there.add2 };
                let before = (registers, there.previous_count);
                let onward =
                    packing.unpack_continued(&mut units, before.1, &mut registers, bytes.first_chunk().unwrap());
                let Ok(Some(Item::Run { segment, .. })) = packing.unpack(&mut there, &mut &bytes[..]) else {
                    unreachable!()
                };
                match onward {
                    Some(onward) => {
                        taken_onward += 1;
                        prop_assert_eq!(onward, (segment.count, len));
                        let Segment { interval, add, add2, .. } = segment;
                        prop_assert_eq!(registers, Recurrence { accumulator: 5, interval, add, add2 });
                    }
                    None => prop_assert_eq!(registers, before.0),
                }
                prop_assert_eq!(there, here);
            }
            prop_assume!(taken_onward > 0);
        }
    }

    #[test]
    fn a_check_is_ten_bytes_and_passed_over() {
        let check = Check { position: 0x0102, tick: Tick32(0x0304_0506), fraction: 0x0708 };
        let mut bytes = [0; CHECK_LEN + 6];
        assert_eq!(PACKING.pack_check(&check, &mut bytes), Ok(CHECK_LEN));
        assert_eq!(bytes[..CHECK_LEN], [0b101_111, 0, 2, 1, 6, 5, 4, 3, 8, 7]);
        let dwell = Item::Dwell { ticks: 5 };
        assert_eq!(PACKING.pack(&mut State::default(), &dwell, &mut bytes[CHECK_LEN..]), Ok(6));
        assert_eq!(PACKING.unpack(&mut State::default(), &mut &bytes[..]), Ok(Some(dwell)));
        assert_eq!(PACKING.unpack(&mut State::default(), &mut &bytes[..9]), Err(UnpackError::Truncated));
        assert_eq!(PACKING.pack_check(&check, &mut bytes[..9]), Err(PackError::Buffer { needed: CHECK_LEN }));
    }

    #[test]
    fn a_reversal_is_two_bytes_and_resets() {
        use Direction::{Backward, Forward};
        // After a reset the previous count is 4: units 2^-5, 2^-4, 2^-4 tick.
        check(
            &[run(4, 3 << 16, 0, 0, Forward), run(4, 3 << 16, 0, 0, Backward)],
            &[0b0010_0010, 96, 0b111, 0, 0b0010_0010, 96],
        );
    }

    #[test]
    fn a_segment_that_goes_on_is_one_byte() {
        let mut segment = Segment { count: 12, interval: 1000 << 16, add: 16 << 16, add2: 0 };
        let items = [12, 18, 14, 255].map(|count| {
            segment.count = count;
            let item = Item::Run { segment, direction: Direction::Forward };
            segment = Segment { count, ..segment.after(count) };
            item
        });
        // 32000 / 32 = 1000 ticks, 256 / 16 = 16 ticks; then 12 + 12/2, 18 − 18/4, and 255 by its three bytes.
        check(&items, &[0b0110_1111, 12, 0x00, 0x7d, 0x00, 0x01, 0, 0x00, 0x05, 0x07, 255, 255, 0]);
    }

    #[test]
    fn controls_that_mean_nothing_are_refused() {
        for control in 6..32 {
            let record = [EXPLICIT_COUNT | control << 3, 0, 1, 2, 3, 4, 5, 6];
            let refused = PACKING.unpack(&mut State { interval: 1 << 20, ..State::default() }, &mut &record[..]);
            assert_eq!(refused, Err(UnpackError::UnknownControl { control }));
        }
    }

    #[test]
    fn what_corrections_cannot_say_is_said_in_full() {
        use Direction::Forward;
        // Off the grid of units, too wide, and a count beyond two bytes.
        check(&[run(1, -5, 0, 0, Forward)], &[0x27, 0, 0x01, 0x10, 1, 251]);
        check(&[run(2, 128, 1 << 56, 0, Forward)], &[0x27, 0, 0x82, 0x10, 2, 128, 0, 0, 0, 0, 0, 0, 0, 0, 1]);
        check(&[run(1 << 16, 0, 0, 0, Forward)], &[0x27, 0, 0x00, 0x30, 0, 0, 1]);
        // What follows is said in units as after 255 steps: 2^-10 tick for the interval.
        check(
            &[run(2, 65_537, 0, 0, Forward), run(2, 65_537 + 64, 0, 0, Forward)],
            &[0x27, 0, 0x03, 0x10, 2, 1, 0, 1, 0b0010_0111, 2, 1],
        );
    }

    #[test]
    fn exact_segments_that_make_no_sense_are_refused() {
        let refused = |bytes: &[u8]| PACKING.unpack(&mut State::default(), &mut &*bytes).unwrap_err();
        assert_eq!(refused(&[0x27, 0, 0x01, 0x00, 1, 5]), UnpackError::ExactWidths { widths: 0x0001 });
        assert_eq!(refused(&[0x27, 0, 0x01, 0x50, 1, 5]), UnpackError::ExactWidths { widths: 0x5001 });
        assert_eq!(refused(&[0x27, 0, 0x09, 0x10, 1, 5]), UnpackError::ExactWidths { widths: 0x1009 });
        // add, of one step.
        assert_eq!(refused(&[0x27, 0, 0x11, 0x10, 1, 5, 5]), UnpackError::ExactWidths { widths: 0x1011 });
        assert_eq!(refused(&[0x27, 0, 0x01, 0x10, 0, 5]), UnpackError::ZeroCount);
        assert_eq!(refused(&[0x27, 0, 0x02, 0x10, 1, 5]), UnpackError::Truncated);
    }

    #[test]
    fn what_cannot_be_packed_says_why() {
        let mut state = State::default();
        let mut buffer = [0; MAX_PACKED_LEN];
        let mut check = |item, len: usize, expected| {
            let before = state;
            assert_eq!(PACKING.pack(&mut state, &item, &mut buffer[..len]), Err(expected));
            assert_eq!(state, before);
        };
        check(run(0, 1 << 16, 0, 0, Direction::Forward), MAX_PACKED_LEN, PackError::NoSteps);
        check(run(3, 1, 0, 0, Direction::Backward), 7, PackError::Buffer { needed: 8 });
        check(Item::Dwell { ticks: 1 }, 5, PackError::Buffer { needed: 6 });
    }

    prop_compose! {
        /// Registers as a planner finds them: the prediction, corrected by whole units.
        fn corrections()(magnitude in 0u32..39)(k in -(1i64 << magnitude)..=(1 << magnitude) - 1) -> i64 { k }
    }

    proptest! {
        #[test]
        fn what_is_packed_is_unpacked(
            fraction_bits in 0u32..=32,
            gain in -40i8..=40,
            steps in prop::collection::vec(
                (prop_oneof![1u32..6, 1u32..100_000], corrections(), corrections(), corrections(), any::<bool>()),
                1..20,
            ),
            off_grid in 0i64..2,
        ) {
            let packing = Packing { fraction_bits, gain };
            let (mut here, mut there) = (State::default(), State::default());
            for (count, k1, k2, k3, forward) in steps {
                let direction = if forward { Direction::Forward } else { Direction::Backward };
                let start = if direction == here.direction { here } else { State::new(direction) };
                let units = packing.units(start.previous_count);
                let (Some(interval), Some(add), Some(add2)) = (
                    k1.checked_mul(units[0]).and_then(|d| start.interval.checked_add(d + off_grid)),
                    k2.checked_mul(units[1]).and_then(|d| start.add.checked_add(d)),
                    k3.checked_mul(units[2]).and_then(|d| start.add2.checked_add(d)),
                ) else { continue };
                let segment = Segment { count, interval, add, add2 };
                let item = Item::Run { segment, direction };
                let mut bytes = [0; MAX_PACKED_LEN];
                let len = packing.pack(&mut here, &item, &mut bytes).unwrap();
                let turned = if start == there { 0 } else { 2 };
                prop_assert_eq!(packing.packed_len(&start, &segment), Ok(len - turned));
                let mut rest = &bytes[..len];
                let Ok(Some(Item::Run { segment: got, direction: way })) = packing.unpack(&mut there, &mut rest) else {
                    panic!("no run came back");
                };
                prop_assert!(rest.is_empty());
                prop_assert_eq!(way, direction);
                prop_assert_eq!(got.count, count);
                // The same ticks: what comes after the last step is not compared.
                for k in [1, 2, 3, count].into_iter().filter(|&k| k <= count) {
                    prop_assert_eq!(got.span(k), segment.span(k));
                }
                prop_assert_eq!(here, there);
            }
        }

        #[test]
        fn no_bytes_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), fraction_bits in 0u32..=32, gain: i8) {
            let packing = Packing { fraction_bits, gain };
            let mut state = State::default();
            let mut rest = &bytes[..];
            loop {
                let before = (state, rest);
                match packing.unpack(&mut state, &mut rest) {
                    Ok(Some(_)) => prop_assert!(rest.len() < before.1.len()),
                    Ok(None) => {
                        prop_assert!(rest.is_empty());
                        break;
                    }
                    Err(_) => {
                        prop_assert_eq!((state, rest), before);
                        break;
                    }
                }
            }
        }
    }
}
