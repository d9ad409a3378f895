//! Sums, shifts, saturation, multiplication and division, with flags and cycles (ARMv7-M ARM DDI 0403E §A2.2, §A7.4).

use super::CortexM3;
use super::operation::{Alu, Flags, Reversal, Shift};

impl CortexM3 {
    #[inline(always)]
    pub(super) fn sets(&self, flags: Flags) -> bool {
        match flags {
            Flags::Never => false,
            Flags::Always => true,
            Flags::OutsideIt => !self.in_it(),
        }
    }

    #[inline(always)]
    fn set_nz(&mut self, value: u32) {
        self.n = value >> 31 != 0;
        self.z = value == 0;
    }

    /// Computes a result from two operands, and sets the flags if `sets`. `carry` is what the shifter gave out.
    #[inline(always)]
    pub(super) fn compute(&mut self, alu: Alu, sets: bool, a: u32, b: u32, carry: bool) -> u32 {
        let (x, y, with) = match alu {
            Alu::Add => (a, b, false),
            Alu::Adc => (a, b, self.c),
            Alu::Sub => (a, !b, true),
            Alu::Sbc => (a, !b, self.c),
            Alu::Rsb => (!a, b, true),
            logical => {
                let value = match logical {
                    Alu::And => a & b,
                    Alu::Bic => a & !b,
                    Alu::Orr => a | b,
                    Alu::Orn => a | !b,
                    Alu::Eor => a ^ b,
                    Alu::Mvn => !b,
                    _ => b,
                };
                if sets {
                    self.set_nz(value);
                    self.c = carry;
                }
                return value;
            }
        };
        let (sum, over) = x.carrying_add(y, with);
        if sets {
            self.set_nz(sum);
            self.c = over;
            self.v = ((x ^ sum) & (y ^ sum)) >> 31 != 0;
        }
        sum
    }

    /// Shift_C (§A2.2.1): shifts by 0 to 255 places. Returns the result and the carry.
    #[inline(always)]
    pub(super) fn shifted(&self, shift: Shift, value: u32, places: u32) -> (u32, bool) {
        if places == 0 {
            return (value, self.c);
        }
        match shift {
            Shift::Left => {
                let wide = u64::from(value).checked_shl(places).unwrap_or(0);
                (wide as u32, wide >> 32 & 1 != 0)
            }
            Shift::Right => {
                let carry = value.checked_shr(places - 1).unwrap_or(0) & 1 != 0;
                (value.checked_shr(places).unwrap_or(0), carry)
            }
            Shift::RightSigned => {
                let carry = (value as i32) >> (places - 1).min(31) & 1 != 0;
                (((value as i32) >> places.min(31)) as u32, carry)
            }
            Shift::Rotate => {
                let rotated = value.rotate_right(places & 31);
                (rotated, rotated >> 31 != 0)
            }
            Shift::RotateExtended => (u32::from(self.c) << 31 | value >> 1, value & 1 != 0),
        }
    }

    pub(super) fn shift_by(&mut self, shift: Shift, sets: bool, value: u32, places: u32) -> u32 {
        let (value, carry) = self.shifted(shift, value, places & 0xff);
        if sets {
            self.set_nz(value);
            self.c = carry;
        }
        value
    }

    /// SSAT and USAT (§A7.7.152, §A7.7.212). Sets Q if the value does not fit.
    pub(super) fn saturate(&mut self, signed: bool, value: u32, bits: u8) -> u32 {
        let value = i64::from(value as i32);
        let (least, most) = match signed {
            true => (-(1i64 << (bits - 1)), (1i64 << (bits - 1)) - 1),
            false => (0, (1i64 << bits) - 1),
        };
        let fits = value.clamp(least, most);
        self.variant.q |= fits != value;
        fits as u32
    }

    pub(super) fn multiply(&mut self, sets: bool, a: u32, b: u32) -> u32 {
        let product = a.wrapping_mul(b);
        if sets {
            self.set_nz(product);
        }
        product
    }
}

/// The product of two words, with a sum of two words added to it.
pub(super) fn multiply_long(signed: bool, a: u32, b: u32, sum: u64) -> u64 {
    let product = if signed { (i64::from(a as i32) * i64::from(b as i32)) as u64 } else { u64::from(a) * u64::from(b) };
    product.wrapping_add(sum)
}

/// Cycles of a long multiplication: the TRM has 3 to 5, and with accumulation 4 to 6, or 7 if it is signed. It ends
/// early with small factors; how small it does not say.
pub(super) fn long_cycles(signed: bool, accumulate: bool, a: u32, b: u32) -> u64 {
    let is_short = |value: u32| if signed { i32::from(value as i16) as u32 == value } else { value >> 16 == 0 };
    let longest = if is_short(a) && is_short(b) { 3 } else { 5 };
    longest + u64::from(accumulate) + u64::from(accumulate && signed && longest == 5)
}

/// The quotient, rounded towards 0; 0 by a division by 0 (§A7.7.127, §A7.7.195).
pub(super) fn divide(signed: bool, a: u32, b: u32) -> u32 {
    match (signed, b) {
        (_, 0) => 0,
        (true, _) => (a as i32).wrapping_div(b as i32) as u32,
        _ => a / b,
    }
}

/// Cycles of a division: the TRM has 2 to 12, by the leading zeros of both operands. Here they grow with the places of
/// the quotient, so that both ends are met.
pub(super) fn divide_cycles(signed: bool, a: u32, b: u32) -> u64 {
    let magnitude = |value: u32| if signed { (value as i32).unsigned_abs() } else { value };
    let (a, b) = (magnitude(a), magnitude(b));
    if b == 0 || a < b {
        return 2;
    }
    2 + u64::from(b.leading_zeros() - a.leading_zeros() + 1).div_ceil(3).min(10)
}

pub(super) fn reversed(kind: Reversal, value: u32) -> u32 {
    match kind {
        Reversal::Bytes => value.swap_bytes(),
        Reversal::BytesOfHalves => value.swap_bytes().rotate_left(16),
        Reversal::BytesOfSignedHalf => i32::from((value as u16).swap_bytes() as i16) as u32,
        Reversal::Bits => value.reverse_bits(),
        Reversal::LeadingZeros => value.leading_zeros(),
    }
}
