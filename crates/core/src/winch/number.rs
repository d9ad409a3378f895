//! Scaled factors for a chip whose multiplier has 8 bits, and which has no floating point unit. Only what a path needs is here.

/// The factor m·2^−8n. Its scale is a whole number of bytes, because an 8-bit chip needs no instructions to shift by those.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Scaled {
    /// m: 0, or at least 2^24.
    pub mantissa: u32,
    /// n.
    pub bytes: u8,
}

impl Scaled {
    /// `a`·`b`·`c`·2^−8·`bytes`. It is rounded down twice, each time by less than 2^-24 of itself. `bytes` ≥ 8.
    ///
    /// ```
    /// use pulsetrain_core::winch::number::Scaled;
    /// assert_eq!(Scaled::product(1 << 20, 3, 1 << 16, 8), Scaled { mantissa: 3 << 28, bytes: 7 });
    /// ```
    #[must_use]
    pub const fn product(a: u32, b: u32, c: u32, bytes: u8) -> Scaled {
        let (first, cut) = upper(a as u64 * b as u64);
        let (mantissa, cut_again) = upper(first as u64 * c as u64);
        Scaled { mantissa, bytes: bytes - 8 + cut + cut_again }
    }
}

/// The four highest bytes of `value` that are not leading zeros, and the number of leading zero bytes.
const fn upper(value: u64) -> (u32, u8) {
    let (mut value, mut above) = (value, 0);
    while value >> 56 == 0 && above < 8 {
        value <<= 8;
        above += 1;
    }
    let [_, _, _, _, b4, b5, b6, b7] = value.to_le_bytes();
    (u32::from_le_bytes([b4, b5, b6, b7]), above)
}

#[cfg(test)]
#[expect(clippy::float_arithmetic, reason = "tests compare with floats")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn products_keep_23_bits(a in 1..=u32::MAX, b in 1..=u32::MAX, c in 1 << 24..=u32::MAX) {
            let Scaled { mantissa, bytes } = Scaled::product(a, b, c, 20);
            let exact = f64::from(a) * f64::from(b) * f64::from(c) / 256_f64.powi(20);
            let scaled = f64::from(mantissa) / 256_f64.powi(bytes.into());
            prop_assert!(mantissa >= 1 << 24);
            prop_assert!((scaled / exact - 1.0).abs() <= 0.5_f64.powi(23), "{} {}", scaled, exact);
        }
    }

    #[test]
    fn nothing_is_nothing() {
        assert_eq!(Scaled::product(0, 5, 7, 10).mantissa, 0);
    }
}
