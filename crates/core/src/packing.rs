//! Segments as few bytes: corrections to the continuation of the last segment, in units that both ends
//! derive from its count.

/// The unit of a correction is 2^-(shift) tick; `order` 1 is the interval, 2 add, 3 add2.
///
/// `previous_count` is the count of the segment before (4 after a reset), `gain` the stream's one
/// tuning number, `fraction_bits` the board's F. Shifts are clamped to 0..=F.
///
/// ```
/// use pulsetrain_core::packing::unit_shift;
/// assert_eq!(unit_shift(1, 8, 0, 16), 6);  // bitlen(8) + 2
/// assert_eq!(unit_shift(3, 100, 0, 16), 16); // 3·7 − 5, clamped
/// ```
#[must_use]
pub const fn unit_shift(order: u32, previous_count: u32, gain: i8, fraction_bits: u32) -> u32 {
    let bits = (u32::BITS - previous_count.leading_zeros()) as i32;
    let shift = match order {
        1 => bits + 2,
        2 => 2 * bits - 2,
        _ => 3 * bits - 5,
    } + gain as i32;
    if shift < 0 {
        0
    } else if shift > fraction_bits as i32 {
        fraction_bits
    } else {
        shift as u32
    }
}
