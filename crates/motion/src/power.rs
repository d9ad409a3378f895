//! Whole powers that are equal on all platforms: `f64::powi` promises that of none.

/// `base` to a whole power, by squaring from the lowest bit of the exponent on. A negative power is the reciprocal of the positive one.
///
/// ```
/// use pulsetrain_motion::whole_power;
/// assert_eq!([whole_power(3.0, 4), whole_power(10.0, -3), whole_power(0.0, 0)], [81.0, 1e-3, 1.0]);
/// ```
#[inline]
#[must_use]
pub fn whole_power(base: f64, exponent: i32) -> f64 {
    let (mut power, mut square, mut rest) = (1.0, base, exponent.unsigned_abs());
    loop {
        if rest % 2 == 1 {
            power *= square;
        }
        rest /= 2;
        if rest == 0 {
            break;
        }
        square *= square;
    }
    if exponent < 0 { 1.0 / power } else { power }
}
