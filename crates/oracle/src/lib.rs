//! Exact step times to 192 bits: what tests and benches compare plans with.
//!
//! It shares nothing with what it judges: no code, no floating point that a step time depends on, not even the law's
//! types. Laws are stated here a second time, in rational numbers.
//!
//! # What is here
//! - [`Sine`]: the tutorial's sinusoid, by arc cosines
//! - [`Trapezoid`]: speed up, cruise, slow down, by square roots; constant speed is one without the first and last
//! - [`Waves`]: a constant speed and sinusoids, by Newton's iteration
//! - [`Lorenz`]: the states of an orbit, by extrapolation; no step times: nobody has them but of an interpolant
//! - [`Crossing`]: when a step is due, exactly, and how far a scheduled tick is from it
//!
//! # What is not
//! Speed: a crossing costs 1 µs to 1 ms. Limits, dropped pairs, shared lines: those are not in θ(t).
#![forbid(unsafe_code)]

mod crossing;
mod lorenz;
mod sine;
mod trapezoid;
mod waves;

pub use crossing::{Crossing, Rational, Real, rational};
pub use lorenz::Lorenz;
pub use sine::Sine;
pub use trapezoid::Trapezoid;
pub use waves::{Wave, Waves};
