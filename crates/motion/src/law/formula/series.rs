//! Taylor recurrences: from the coefficients of x to those of f(x), truncated to N terms.
//!
//! Source: A. Griewank, A. Walther, "Evaluating Derivatives", 2nd ed., SIAM 2008, table 13.2.

use super::scalar::Scalar;
use crate::law::curve::RECIPROCAL;
use std::array::from_fn;

pub(in crate::law) type Series<S, const N: usize> = [S; N];

/// Σ over `from..=to` of f(i), in order; 0 if there is none.
fn total<S: Scalar>(from: usize, to: usize, f: impl Fn(usize) -> S) -> S {
    if from > to {
        return S::exact(0.0);
    }
    (from + 1..=to).fold(f(from), |sum, i| sum + f(i))
}

/// 1/k, k from 1 to 8.
pub(in crate::law) fn reciprocal<S: Scalar>(k: usize) -> S {
    S::rounded(RECIPROCAL[k])
}

pub(in crate::law) fn constant<S: Scalar, const N: usize>(c: S) -> Series<S, N> {
    from_fn(|k| if k == 0 { c } else { S::exact(0.0) })
}

pub(in crate::law) fn multiply<S: Scalar, const N: usize>(a: &Series<S, N>, b: &Series<S, N>) -> Series<S, N> {
    from_fn(|k| total(0, k, |i| a[i] * b[k - i]))
}

pub(in crate::law) fn divide<S: Scalar, const N: usize>(a: &Series<S, N>, b: &Series<S, N>) -> Series<S, N> {
    let mut q = constant(S::exact(0.0));
    for k in 0..N {
        let rest = if k == 0 { a[0] } else { a[k] - total(1, k, |i| b[i] * q[k - i]) };
        q[k] = rest / b[0];
    }
    q
}

/// From f and the derivative's coefficients d (of x^0, x^1, …) to those of f.
fn integral<S: Scalar, const N: usize>(first: S, d: impl Fn(usize) -> S) -> Series<S, N> {
    from_fn(|k| if k == 0 { first } else { d(k - 1) * reciprocal(k) })
}

/// The coefficients of x'; the last one is not known and stays 0.
fn derivative<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    from_fn(|k| if k + 1 < N { S::exact((k + 1) as f64) * x[k + 1] } else { S::exact(0.0) })
}

pub(in crate::law) fn sin_cos<S: Scalar, const N: usize>(x: &Series<S, N>) -> (Series<S, N>, Series<S, N>) {
    let (first_sin, first_cos) = x[0].sin_cos();
    let (mut sin, mut cos) = (constant(first_sin), constant(first_cos));
    for k in 1..N {
        sin[k] = total(1, k, |i| S::exact(i as f64) * x[i] * cos[k - i]) * reciprocal(k);
        cos[k] = -(total(1, k, |i| S::exact(i as f64) * x[i] * sin[k - i]) * reciprocal(k));
    }
    (sin, cos)
}

pub(in crate::law) fn exp<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    let mut y = constant(x[0].exp());
    for k in 1..N {
        y[k] = total(1, k, |i| S::exact(i as f64) * x[i] * y[k - i]) * reciprocal(k);
    }
    y
}

pub(in crate::law) fn ln<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    let d = divide(&derivative(x), x);
    integral(x[0].ln(), |k| d[k])
}

pub(in crate::law) fn sqrt<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    let mut y = constant(x[0].sqrt());
    let twice = y[0] + y[0];
    for k in 1..N {
        y[k] = (x[k] - total(1, k - 1, |i| y[i] * y[k - i])) / twice;
    }
    y
}

/// x to a constant power that is no whole number.
pub(in crate::law) fn power<S: Scalar, const N: usize>(x: &Series<S, N>, exponent: f64) -> Series<S, N> {
    let mut y = constant(x[0].power(exponent));
    let r = S::exact(exponent);
    for k in 1..N {
        let order = S::exact(k as f64);
        let sum = total(1, k, |i| (S::exact(i as f64) * r - S::exact((k - i) as f64)) * x[i] * y[k - i]);
        y[k] = sum / (order * x[0]);
    }
    y
}

/// x to a whole power, by squaring.
pub(in crate::law) fn whole_power<S: Scalar, const N: usize>(x: &Series<S, N>, exponent: u32) -> Series<S, N> {
    match exponent {
        0 => constant(S::exact(1.0)),
        1 => *x,
        n => {
            let half = whole_power(x, n / 2);
            let square = multiply(&half, &half);
            if n % 2 == 0 { square } else { multiply(&square, x) }
        }
    }
}

pub(in crate::law) fn asin<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    let square = multiply(x, x);
    let below_one = from_fn(|k| if k == 0 { S::exact(1.0) - square[0] } else { -square[k] });
    let d = divide(&derivative(x), &sqrt(&below_one));
    integral(x[0].asin(), |k| d[k])
}

pub(in crate::law) fn atan<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    let square = multiply(x, x);
    let above_one = from_fn(|k| if k == 0 { S::exact(1.0) + square[0] } else { square[k] });
    let d = divide(&derivative(x), &above_one);
    integral(x[0].atan(), |k| d[k])
}

pub(in crate::law) fn tanh<S: Scalar, const N: usize>(x: &Series<S, N>) -> Series<S, N> {
    let mut y = constant(x[0].tanh());
    // w = 1 − y²; y' = w·x'.
    let mut w: Series<S, N> = constant(S::exact(1.0) - y[0] * y[0]);
    for k in 1..N {
        y[k] = total(1, k, |i| S::exact(i as f64) * x[i] * w[k - i]) * reciprocal(k);
        w[k] = -total(0, k, |i| y[i] * y[k - i]);
    }
    y
}
