//! Exact step times, to 192 bits: tests and benches compare plans with them.
//!
//! An oracle must not repeat the errors of what it judges. So it shares no code with the planner, not even the types of laws: each law is stated a
//! second time here, in rational numbers. No step time depends on floating point of 64 bits.
//!
//! # What is here
//! - [`Crossing`]: when a step is due, exactly, and how far a scheduled tick is from that time
//! - [`Sine`]: the tutorial's sinusoid, by arc cosines
//! - [`Trapezoid`]: speeding up, cruising and slowing down, by square roots; a constant speed is a trapezoid without the first and the last
//! - [`Waves`]: a constant speed plus sinusoids, by Newton's iteration
//! - [`Lorenz`]: the states of an orbit, by extrapolation. It has no step times: between two states only an interpolant has any
//!
//! # What is not
//! Speed: a crossing takes 1 µs to 1 ms. Limits, dropped pairs of steps and shared DIR lines: they are not part of θ(t).
//!
//! # Example
//! The time of one step, and the error of a scheduled tick:
//! ```
//! use pulsetrain_oracle::{Trapezoid, rational};
//!
//! // 1000 steps/s on a grid without hysteresis: the first step is due half a step after the begin, at 0.5 ms.
//! let law = Trapezoid::constant_speed(rational(1000, 1), 10);
//! let first = law.crossings(&rational(0, 1)).next().unwrap();
//! assert!(first.forward);
//! assert_eq!(first.nearest_tick(16_000_000), 8000);
//! assert_eq!(first.error_ticks(16_000_000, 8003), 3.0);
//! ```
#![allow(clippy::disallowed_methods, reason = "what tests compute may differ in the last digit")]
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
