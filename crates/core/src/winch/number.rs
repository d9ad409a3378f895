//! Numbers for a chip without a multiplier of 32 bits: products from bytes, and decimals from a line.

/// An unsigned number m·2^e with 32 significant bits: m is at least 2^31, or 0 with the lowest exponent.
///
/// Each product is off by at most 2^-32 of itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Float {
    mantissa: u32,
    exponent: i8,
}

impl Float {
    /// 0.
    pub const ZERO: Float = Float { mantissa: 0, exponent: i8::MIN };
    /// 10.
    pub const TEN: Float = Float { mantissa: 0xa000_0000, exponent: -28 };
    /// 0.1, rounded.
    pub const TENTH: Float = Float { mantissa: 0xcccc_cccd, exponent: -35 };

    /// `mantissa`·2^`exponent`; `mantissa` is 0 or has its highest bit set.
    #[must_use]
    pub const fn new(mantissa: u32, exponent: i8) -> Float {
        Float { mantissa, exponent }
    }

    /// m and e.
    #[must_use]
    pub const fn parts(self) -> (u32, i8) {
        (self.mantissa, self.exponent)
    }

    /// `digits`·10^`power`, if it is less than 2^32; what is less than 10^-18 is 0.
    #[must_use]
    #[inline(never)]
    pub fn from_decimal(digits: u32, mut power: i8) -> Option<Float> {
        let mut float = Float { mantissa: digits, exponent: 0 };
        if digits == 0 {
            return Some(Float::ZERO);
        }
        while float.mantissa < 1 << 31 {
            float.mantissa <<= 1;
            float.exponent -= 1;
        }
        while power > 0 {
            if float.exponent > 0 {
                return None;
            }
            float = float.times(Float::TEN);
            power -= 1;
        }
        while power < 0 {
            if float.exponent < -92 {
                return Some(Float::ZERO);
            }
            float = float.times(Float::TENTH);
            power += 1;
        }
        if float.exponent > 0 { None } else { Some(float) }
    }

    /// The product, rounded to nearest. Exponents must not leave i8: −128 ≤ sum + 32.
    #[must_use]
    #[inline(never)]
    pub fn times(self, other: Float) -> Float {
        let (mut mantissa, low) = multiply(self.mantissa, other.mantissa);
        let [_, _, _, mut below] = low.to_le_bytes();
        if mantissa == 0 {
            return Float::ZERO;
        }
        let mut exponent = self.exponent.wrapping_add(other.exponent).wrapping_add(32);
        if mantissa < 1 << 31 {
            mantissa = mantissa << 1 | u32::from(below >> 7);
            below <<= 1;
            exponent -= 1;
        }
        if below >= 0x80 && mantissa != u32::MAX {
            mantissa += 1;
        }
        Float { mantissa, exponent }
    }

    /// For comparing: by exponent, then by the upper 16 bits of the mantissa, so that numbers within 2^-15 of each other
    /// may be the same.
    #[must_use]
    pub const fn key(self) -> i32 {
        let [_, _, b2, b3] = self.mantissa.to_le_bytes();
        let [exponent] = self.exponent.to_le_bytes();
        i32::from_le_bytes([b2, b3, exponent, if self.exponent < 0 { 0xff } else { 0 }])
    }

    /// In units of 2^-`bits`, rounded to nearest: the lower 32 bits and the upper 8. What is 2^40 of them or more is all
    /// ones.
    #[must_use]
    #[inline(never)]
    pub const fn to_fixed(self, bits: i8) -> (u32, u8) {
        let (mut low, mut high) = (self.mantissa, 0u8);
        let mut exponent = self.exponent.saturating_add(bits);
        while exponent > 0 {
            if high >= 0x80 {
                return (u32::MAX, u8::MAX);
            }
            high = high << 1 | (low >> 31) as u8;
            low <<= 1;
            exponent -= 1;
        }
        let mut half = 0;
        while exponent < 0 {
            half = low & 1;
            low >>= 1;
            exponent += 1;
        }
        (low + half, high)
    }

    /// As m·2^−8n with 2^24 ≤ m < 2^32, and n; the last bits are lost. Less than 2^7 only.
    #[must_use]
    pub const fn to_scaled(self) -> Scaled {
        let mut bytes = 0;
        let mut exponent = self.exponent;
        // −8 < exponent ≤ 0 in the end.
        while exponent < -7 {
            exponent += 8;
            bytes += 1;
        }
        let mut mantissa = self.mantissa;
        let mut half = false;
        while exponent < 0 {
            half = mantissa & 1 != 0;
            mantissa >>= 1;
            exponent += 1;
        }
        Scaled { mantissa: mantissa.saturating_add(half as u32), bytes }
    }
}

/// m·2^−8n: a factor whose product is aligned by bytes, which an 8-bit chip moves for nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Scaled {
    /// m.
    pub mantissa: u32,
    /// n.
    pub bytes: u8,
}

/// The product of 32 bits and 32 bits: its upper and its lower half.
#[must_use]
#[inline(never)]
pub const fn multiply(a: u32, b: u32) -> (u32, u32) {
    // In products of 16 bits and 16 bits, which every compiler's library has.
    let ([a0, a1], [b0, b1]) = (halves(a), halves(b));
    let (low, high) = (a0.wrapping_mul(b0), a1.wrapping_mul(b1));
    let ([l0, l1], [m0, m1], [n0, n1]) = (halves(low), halves(a0.wrapping_mul(b1)), halves(a1.wrapping_mul(b0)));
    let [s0, s1] = halves(l1 + m0 + n0);
    (high + m1 + n1 + s1, s0 << 16 | l0)
}

const fn halves(value: u32) -> [u32; 2] {
    let [b0, b1, b2, b3] = value.to_le_bytes();
    [u32::from_le_bytes([b0, b1, 0, 0]), u32::from_le_bytes([b2, b3, 0, 0])]
}

#[cfg(test)]
#[expect(clippy::float_arithmetic, reason = "tests compare with floats")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn value(float: Float) -> f64 {
        power(2.0, float.exponent) * f64::from(float.mantissa)
    }

    fn power(base: f64, exponent: i8) -> f64 {
        let product = (0..exponent.unsigned_abs()).fold(1.0, |product, _| product * base);
        if exponent < 0 { 1.0 / product } else { product }
    }

    proptest! {
        #[test]
        fn products_are_exact(a: u32, b: u32) {
            let (high, low) = multiply(a, b);
            prop_assert_eq!(u64::from(high) << 32 | u64::from(low), u64::from(a) * u64::from(b));
        }

        #[test]
        fn decimals_are_read(digits: u32, tens in -20..20_i8) {
            let exact = f64::from(digits) * power(10.0, tens);
            match Float::from_decimal(digits, tens) {
                Some(float) => {
                    prop_assert!((value(float) - exact).abs() <= exact * 1e-8 + 1e-18, "{} {}", value(float), exact);
                    prop_assert!(float.mantissa == 0 || float.mantissa >= 1 << 31);
                }
                None => prop_assert!(exact > 4.294_967_2e9),
            }
        }

        #[test]
        fn order_is_kept(a: u32, b: u32, p in -8..2_i8, q in -8..2_i8) {
            let (Some(a), Some(b)) = (Float::from_decimal(a, p), Float::from_decimal(b, q)) else { return Ok(()) };
            if a.key() < b.key() {
                prop_assert!(value(a) < value(b));
            } else if a.key() == b.key() {
                prop_assert!((value(a) - value(b)).abs() <= value(b) * power(2.0, -15));
            }
        }

        #[test]
        fn fixed_point_is_nearest(digits: u32, tens in -9..1_i8, bits in 0..33_i8) {
            let Some(float) = Float::from_decimal(digits, tens) else { return Ok(()) };
            let exact = value(float) * power(2.0, bits);
            let (low, high) = float.to_fixed(bits);
            let fixed = f64::from(high) * 4_294_967_296.0 + f64::from(low);
            let most = 1_099_511_627_775.0;
            prop_assert!((fixed - exact).abs() <= 0.5 || (exact >= most && fixed >= most), "{} {}", fixed, exact);
        }

        #[test]
        fn scaling_keeps_25_bits(digits in 1..=u32::MAX, tens in -16..-8_i8) {
            let Some(float) = Float::from_decimal(digits, tens) else { return Ok(()) };
            prop_assume!(value(float) < 1.9);
            let Scaled { mantissa, bytes } = float.to_scaled();
            let scaled = f64::from(mantissa) * power(256.0, -bytes.cast_signed());
            prop_assert!((scaled / value(float) - 1.0).abs() <= power(2.0, -25), "{}", scaled);
            prop_assert!(mantissa >= 1 << 24);
        }
    }

    #[test]
    fn ends_of_the_range() {
        assert_eq!(Float::from_decimal(0, 127), Some(Float::ZERO));
        assert_eq!(Float::from_decimal(1, 127), None);
        assert_eq!(Float::from_decimal(u32::MAX, -128), Some(Float::ZERO));
        assert_eq!(Float::ZERO.to_fixed(32), (0, 0));
        assert_eq!(Float::new(1 << 31, -31).to_fixed(39), (0, 128));
        assert_eq!(Float::new(1 << 31, -31).to_fixed(40), (u32::MAX, u8::MAX));
        assert!(Float::ZERO.key() < Float::TENTH.key() && Float::TENTH.key() < Float::TEN.key());
    }
}
