//! The path of one axis: the recurrence at 1 kHz, in fixed point.
//!
//! Source: StepperWinch, `Path::pollForInterval`, whose loop has no fixed rate; this one has 1 ms. Every millisecond, all
//! from old values:
//!
//! - q″ = k (q_d − q) + b (q_d′ − q′), clamped to ±amax
//! - q += q′ dt, then q′ += q″ dt, then q_d += q_d′ dt, then q′ is clamped to ±vmax
//!
//! One thing differs from the original: when vmax is set below the present speed, the speed goes down to it by amax·dt in each
//! millisecond, not at once.
//!
//! # Formats
//! Positions are in millisteps. At 1 kHz a speed of 1 step/s is one millistep a tick, so that drifts are exact for ever.
//!
//! | what | unit | bits |
//! |---|---|---|
//! | speed q′ | steps/s | 16 before the point, 32 after it |
//! | steps made less q | millistep | 16, 16: the position moves by the upper 32 bits of the speed |
//! | q_d − q | millistep | 48, and the 16 after the point of the line before: q_d is a whole number of them |
//! | k·10^-6, b·10^-3 | | 24 significant ones at least ([`Scaled`]) |
//!
//! q itself is not stored, so that an axis may drift past 2^31 steps.
//!
//! # How far from the exact recurrence
//! The errors in each tick, each as the offset of a resting position that would have the same effect:
//!
//! - q_d − q is rounded down to 24 significant bits, or 2^-8 millisteps if that is more.
//! - The speed that moves q and that b acts on is rounded down to 2^-16 steps/s: at most b/k of it, 0.0024 step at the
//!   region's edge (0.01 Hz, ζ = 5).
//! - Products are cut at 2^-32 steps/s: 2^-32·1000/k, 6·10^-5 step at 0.01 Hz.
//! - k and b themselves are cut: by 2^-23 of themselves, at most. A ringing of amplitude A is then late by at most
//!   2.3·A·2^-23/(12.5 ζ) steps: 0.03 step at A = 100 000 and ζ = 0.08.
//! - amax·10^-3 is off by 1.1·10^-9 of itself: 5·10^-10·amax·T² steps after T seconds of acceleration.
//!
//! At ζ = 0.07, an error that repeats at the resonance grows to 9 times its offset, so that the sum stays below 0.1 step. This holds
//! with f·vmax ≤ amax, up to 10 Hz, and for ζ ≥ 0.15 up to 20 Hz; `tests/it/winch_path.rs` looks for the worst case there. With a lower
//! amax a motion swings at full acceleration from one side of its target to the other, near ζ = πf·(1 ms) for very long. The
//! recurrence is chaotic then, and rounding errors grow to steps.

use super::number::Scaled;

/// k·10^-6 of f = 10^-6 Hz: (2π)²·10^-18, in 2^-80.
const STIFFNESS: (u32, u8) = (47_726_478, 10);
/// b·10^-3 of f = 10^-6 Hz and ζ = 10^-6: 4π·10^-15, in 2^-72.
const DAMPING: (u32, u8) = (59_343_007, 9);
/// 10^-3 in 2^-40: b·10^-3 for b = 1.
const FIRST_DAMPING: Scaled = Scaled { mantissa: 1_099_511_628, bytes: 5 };
/// A thousandth of a step/s, in 2^-40 steps/s.
const SPEED: u32 = 1_099_511_628;
/// A thousandth of a step/s², a millisecond long, in 2^-48 steps/s.
const CHANGE: u32 = 281_474_977;

/// Lowest and highest f, 10^-6 Hz.
pub const FREQUENCIES: [u32; 2] = [10_000, 20_000_000];
/// Lowest and highest ζ, 10^-6.
pub const RATIOS: [u32; 2] = [70_000, 5_000_000];

/// vmax at first, steps/s. Source: StepperWinch, `Path::Path`.
pub const FIRST_SPEED: u16 = 3500;
/// amax at first, steps/s². Source: StepperWinch, `Path::Path`.
pub const FIRST_ACCELERATION: u32 = 35_000;
/// The fastest that a path may go, steps/s. A higher vmax is cut to this.
pub const FASTEST: u16 = 10_000;
/// The highest acceleration of a path, steps/s². A higher amax is cut to this.
pub const MAX_ACCELERATION: u32 = 250_000;
/// The lowest acceleration that is accepted, steps/s².
pub const MIN_ACCELERATION: u32 = 1;
/// The fastest drift of a target, steps/s.
pub const FASTEST_DRIFT: u16 = 15_000;

/// How far from a step's position the next step is made: 1/64 step beyond the middle, 515.625 millisteps, in units of 2^-16 millisteps.
pub(super) const THRESHOLD: i32 = 33_792_000;
/// A step, in 2^-16 millisteps.
pub(super) const STEP: i32 = 1000 << 16;

const _: () = assert!(MAX_ACCELERATION < 256_000);
const _: () = assert!(64 * (THRESHOLD as i64) == 33 * (STEP as i64));
// In a tick: at most 15 thresholds are crossed, and a difference of speeds has 16 bits before the point.
const _: () = assert!(FASTEST < 15_000 && FASTEST as u32 + (FASTEST_DRIFT as u32) < 1 << 15);

/// The layout of gains and limits in memory, which the Uno's assembly reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
struct Parts {
    first: u32,
    second: u32,
    low: u8,
    high: u8,
}

/// How a path follows its target: natural frequency f and damping ratio ζ, as k = (2πf)² and b = 4πfζ.
///
/// Mantissas and bytes ([`Scaled`]) of k·10^-6 and b·10^-3.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Gains(Parts);

impl Gains {
    /// k = 4π², b = 1: 1 Hz, and it rings (ζ = 0.08). Source: StepperWinch, `Path::Path`.
    pub const DEFAULT: Gains =
        Gains::from_scaled(Scaled::product(1_000_000, 1_000_000, STIFFNESS.0, STIFFNESS.1), FIRST_DAMPING);

    /// Of `frequency`, 10^-6 Hz, and damping ratio `ratio`, 10^-6; `None` outside of [`FREQUENCIES`] and [`RATIOS`], in
    /// which the recurrence is stable.
    ///
    /// At 1 kHz it is where k·(1 ms)² < b·(1 ms) < 2, that is ζ > πf·(1 ms), 0.063 at 20 Hz, and ζ < 1/(2πf·(1 ms)),
    /// 7.9 there.
    ///
    /// ```
    /// use pulsetrain_core::winch::path::Gains;
    /// assert!(Gains::new(20_000_000, 70_000).is_some());
    /// assert_eq!(Gains::new(20_010_000, 1_000_000), None);
    /// ```
    #[must_use]
    pub const fn new(frequency: u32, ratio: u32) -> Option<Gains> {
        if !is_within(frequency, FREQUENCIES) || !is_within(ratio, RATIOS) {
            return None;
        }
        let stiffness = Scaled::product(frequency, frequency, STIFFNESS.0, STIFFNESS.1);
        let damping = Scaled::product(frequency, ratio, DAMPING.0, DAMPING.1);
        Some(Gains::from_scaled(stiffness, damping))
    }

    const fn from_scaled(stiffness: Scaled, damping: Scaled) -> Gains {
        let (first, second) = (stiffness.mantissa, damping.mantissa);
        Gains(Parts { first, second, low: stiffness.bytes, high: damping.bytes })
    }
}

/// Whether it is neither below the first nor above the second.
pub(super) const fn is_within(value: u32, [low, high]: [u32; 2]) -> bool {
    low <= value && value <= high
}

/// How fast a path may go and speed up.
///
/// vmax in 2^-16 steps/s; amax·10^-3 in 2^-32 steps/s, 40 bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct Limits(Parts);

impl Limits {
    /// vmax, 2^-16 steps/s.
    const fn speed(&self) -> u32 {
        self.0.first
    }

    /// [`FIRST_SPEED`] and [`FIRST_ACCELERATION`].
    pub const DEFAULT: Limits = Limits::of(FIRST_SPEED as u32 * 1000, FIRST_ACCELERATION * 1000);

    /// Of `speed`, 10^-3 steps/s, and `acceleration`, 10^-3 steps/s², each at most [`FASTEST`] and [`MAX_ACCELERATION`]: more is
    /// taken as that. `None` if the acceleration is less than [`MIN_ACCELERATION`]: nothing could stop then.
    #[must_use]
    pub const fn new(speed: u32, acceleration: u32) -> Option<Limits> {
        if acceleration < MIN_ACCELERATION * 1000 {
            return None;
        }
        let (fastest, steepest) = (FASTEST as u32 * 1000, MAX_ACCELERATION * 1000);
        let speed = if speed > fastest { fastest } else { speed };
        let acceleration = if acceleration > steepest { steepest } else { acceleration };
        Some(Limits::of(speed, acceleration))
    }

    const fn of(speed: u32, acceleration: u32) -> Limits {
        let speed = (speed as u64 * SPEED as u64) >> 24;
        let change = (acceleration as u64 * CHANGE as u64) >> 16;
        let ([s0, s1, s2, s3, ..], [c0, c1, c2, c3, c4, ..]) = (speed.to_le_bytes(), change.to_le_bytes());
        let (first, second) = (u32::from_le_bytes([s0, s1, s2, s3]), u32::from_le_bytes([c0, c1, c2, c3]));
        Limits(Parts { first, second, low: c4, high: 0 })
    }

    /// amax·10^-3, 2^-32 steps/s.
    const fn change(&self) -> i64 {
        let [b0, b1, b2, b3] = self.0.second.to_le_bytes();
        i64::from_le_bytes([b0, b1, b2, b3, self.0.low, 0, 0, 0])
    }
}

/// A signed number of 48 bits, lowest byte first. Sums that do not fit become the largest or smallest number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Wide([u8; 6]);

impl Wide {
    const ZERO: Wide = Wide([0; 6]);

    const fn of(value: i64) -> Wide {
        const MOST: i64 = (1 << 47) - 1;
        let value = if value > MOST {
            MOST
        } else if value < -MOST - 1 {
            -MOST - 1
        } else {
            value
        };
        let [b0, b1, b2, b3, b4, b5, _, _] = value.to_le_bytes();
        Wide([b0, b1, b2, b3, b4, b5])
    }

    /// Steps, less than 2^32 either way, in millisteps.
    const fn thousandfold(steps: i64) -> Wide {
        Wide::of(steps * 1000)
    }

    const fn add(&mut self, other: &Wide) {
        *self = Wide::of(self.get() + other.get());
    }

    const fn subtract(&mut self, other: &Wide) {
        *self = Wide::of(self.get() - other.get());
    }

    const fn get(self) -> i64 {
        let [b0, b1, b2, b3, b4, b5] = self.0;
        let sign = if self.is_negative() { 0xff } else { 0 };
        i64::from_le_bytes([b0, b1, b2, b3, b4, b5, sign, sign])
    }

    const fn is_negative(&self) -> bool {
        let [.., top] = self.0;
        top >= 0x80
    }

    fn is_zero(&self) -> bool {
        self.0.iter().all(|byte| *byte == 0)
    }
}

/// The steps of one millisecond, in one direction and at one speed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slice {
    /// Steps that fall into it.
    pub count: u8,
    /// Which way.
    pub backward: bool,
    /// The distance from the slice's beginning to its first step, 2^-16 millisteps. It has no meaning without a step.
    pub distance: u32,
    /// Speed, 2^-16 steps/s. That is also the distance in a millisecond, in the unit of `distance`.
    pub speed: u32,
}

impl Slice {
    /// The slice of an axis that stands still.
    pub const NONE: Slice = Slice { count: 0, backward: false, distance: 0, speed: 0 };
}

/// The state of one axis: position, target, gains and limits.
///
/// ```
/// use pulsetrain_core::winch::path::Path;
/// let mut path = Path::new();
/// path.set_target(100);
/// let steps: u32 = (0..30_000).map(|_| u32::from(path.tick().count)).sum();
/// assert!(steps > 100, "it rings");
/// assert_eq!(path.made(), 100);
/// assert!(path.is_at_rest());
/// ```
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Path {
    /// Steps made, to the end of the last slice.
    made: i32,
    /// `made` less q, 2^-16 millisteps; within half a step and the threshold's 1/64.
    ahead: i32,
    /// q_d − q, millisteps rounded down. Its fraction is that of `ahead`.
    gap: Wide,
    /// The lower 16 bits of q′, below those of `speed`.
    speed_low: u16,
    /// 2^-16 steps/s.
    speed: i32,
    /// q_d′, steps/s.
    drift: i16,
    gains: Gains,
    limits: Limits,
    /// The axis stops within amax, without a target.
    stopping: bool,
    /// The speed of the reference towards its target, steps/s. 0: no limit, and `way` is 0.
    ramp: u16,
    /// How far q_d still has to move at `ramp` steps/s, millisteps.
    way: Wide,
}

impl Default for Path {
    fn default() -> Path {
        Path::new()
    }
}

impl Path {
    /// An axis at rest at 0, as after reset.
    #[must_use]
    pub const fn new() -> Path {
        Path::at(0)
    }

    /// An axis at rest at `steps`.
    #[must_use]
    pub const fn at(steps: i32) -> Path {
        Path {
            made: steps,
            ahead: 0,
            gap: Wide::ZERO,
            speed: 0,
            speed_low: 0,
            drift: 0,
            gains: Gains::DEFAULT,
            limits: Limits::DEFAULT,
            way: Wide::ZERO,
            ramp: 0,
            stopping: false,
        }
    }

    /// Moves on by one millisecond, and returns its steps.
    ///
    /// The Uno does this and [`Slice::train`] in assembly, with the same result to the bit. On an AVR the fields lie in the order of their
    /// declaration, without gaps.
    pub fn tick(&mut self) -> Slice {
        if !self.way.is_zero() {
            self.approach();
        }
        let change = self.change();
        let slice = self.advance();
        self.hasten(change);
        slice
    }

    /// `a`: the target is `steps`, from [`made`](Path::made) up to it or down: the way is never round the end of 32 bits, which
    /// a difference of 32 bits would take from 2^31 steps on.
    ///
    /// ```
    /// use pulsetrain_core::winch::path::Path;
    /// let mut path = Path::at(1);
    /// path.set_target(i32::MIN);
    /// let backward = (0..100).filter(|_| path.tick().backward).count();
    /// assert!(backward > 90, "down, though the way is longer than what 32 bits hold");
    /// ```
    pub fn set_target(&mut self, steps: i32) {
        let mut gap = Wide::thousandfold(i64::from(steps) - i64::from(self.made));
        gap.add(&Wide::of(upper(self.ahead).into()));
        self.aim(&gap);
    }

    /// `d`: the target moves by `steps`. It may leave 32 bits, as with a drift: [`made`](Path::made) then wraps.
    pub fn move_target(&mut self, steps: i32) {
        let mut gap = Wide::thousandfold(steps.into());
        gap.add(&self.gap);
        gap.add(&self.way);
        self.aim(&gap);
    }

    /// `v`: the target drifts by `speed` steps/s, at most [`FASTEST_DRIFT`] either way, for ever.
    pub fn set_drift(&mut self, speed: i16) {
        let most = FASTEST_DRIFT.cast_signed();
        self.stopping = false;
        self.drift = if speed > most {
            most
        } else if speed < -most {
            -most
        } else {
            speed
        };
    }

    /// `r`: moves target and reference by `steps` at once, without a ramp.
    pub fn push_reference(&mut self, steps: i32) {
        self.stopping = false;
        self.gap.add(&Wide::thousandfold(steps.into()));
    }

    /// `s`: from now on the reference moves to its target at `speed` steps/s; 0: at once.
    pub fn set_ramp(&mut self, speed: u16) {
        self.ramp = speed;
        self.move_target(0);
    }

    /// `g`: sets the gains.
    pub fn set_gains(&mut self, gains: &Gains) {
        self.gains = *gains;
    }

    /// `l`: sets the limits.
    pub fn set_limits(&mut self, limits: &Limits) {
        self.limits = *limits;
    }

    /// Stops within amax. That takes speed / amax, 0.1 s at most with the limits after reset. Then the target is where the axis rests. A new
    /// target ends the stop.
    pub fn stop(&mut self) {
        self.drift = 0;
        self.way = Wide::ZERO;
        self.gap = Wide::ZERO;
        self.stopping = true;
    }

    /// Its bytes in an AVR's memory, for the assembly.
    #[must_use]
    pub fn bytes(&self) -> [u8; 51] {
        let Path { made, ahead, gap, speed_low, speed, drift, gains, limits, stopping, ramp, way } = self;
        let mut bytes = [0; 51];
        let mut places = bytes.iter_mut();
        let mut put = |field: &[u8]| {
            for (byte, place) in field.iter().zip(places.by_ref()) {
                *place = *byte;
            }
        };
        put(&made.to_le_bytes());
        put(&ahead.to_le_bytes());
        put(&gap.0);
        put(&speed_low.to_le_bytes());
        put(&speed.to_le_bytes());
        put(&drift.to_le_bytes());
        for Parts { first, second, low, high } in [gains.0, limits.0] {
            put(&first.to_le_bytes());
            put(&second.to_le_bytes());
            put(&[low, high]);
        }
        put(&[u8::from(*stopping)]);
        put(&ramp.to_le_bytes());
        put(&way.0);
        bytes
    }

    /// Steps made, to the end of the last slice, wrapping.
    #[must_use]
    pub const fn made(&self) -> i32 {
        self.made
    }

    /// q less [`made`](Path::made), 2^-16 millisteps: within ±33 792 000.
    #[must_use]
    pub const fn offset(&self) -> i32 {
        -self.ahead
    }

    /// q′, 2^-16 steps/s: within ±[`FASTEST`].
    #[must_use]
    pub const fn speed(&self) -> i32 {
        self.speed
    }

    /// Whether it is slower than 1 step/s, and its target is within half a step and does not drift.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        let near = self.gap.get().wrapping_add(500).cast_unsigned() <= 1000;
        let slow = self.speed.wrapping_add(1 << 16).cast_unsigned() <= 2 << 16;
        near && slow && self.drift == 0 && self.way.is_zero()
    }

    /// Sets the target `gap` millisteps from q.
    fn aim(&mut self, gap: &Wide) {
        self.stopping = false;
        self.way = *gap;
        if self.ramp == 0 {
            self.gap = *gap;
            self.way = Wide::ZERO;
        } else {
            let gap = self.gap;
            self.way.subtract(&gap);
        }
    }

    /// Moves the reference towards its target, by one millisecond of the ramp.
    #[cold]
    fn approach(&mut self) {
        let ramp = i64::from(self.ramp);
        let mut step = Wide::of(if self.way.is_negative() { -ramp } else { ramp });
        let mut rest = self.way;
        rest.subtract(&step);
        if rest.is_negative() != self.way.is_negative() {
            step = self.way;
            rest = Wide::ZERO;
        }
        self.way = rest;
        self.gap.add(&step);
    }

    /// q″·10^-3 before it is clamped, 2^-32 steps/s.
    fn change(&self) -> i64 {
        if self.stopping {
            return -self.whole_speed();
        }
        let Wide([b0, b1, b2, b3, b4, b5]) = self.gap;
        // The four highest bytes that are not leading zeros, and how many bytes are below them.
        let [_, below, _, _] = self.ahead.to_le_bytes();
        let sign = |byte: u8| if byte >= 0x80 { 0xff } else { 0 };
        let (gap, fewer) = if b5 != sign(b4) {
            ([b2, b3, b4, b5], 6)
        } else if b4 != sign(b3) {
            ([b1, b2, b3, b4], 5)
        } else if b3 != sign(b2) {
            ([b0, b1, b2, b3], 4)
        } else {
            ([below, b0, b1, b2], 3)
        };
        let gap = i32::from_le_bytes(gap);
        let Gains(Parts { first: stiffness, second: damping, low: stiffness_bytes, high: damping_bytes }) = self.gains;
        // millisteps·k·10^-6 are steps/s.
        let pull = if stiffness_bytes >= fewer {
            scale(stiffness, gap, stiffness_bytes - fewer)
        } else if gap < 0 {
            // Beyond 2^55. That is more than damping (2^47) and amax (2^40), so that only the sign counts.
            -1 << 60
        } else {
            1 << 60
        };
        let behind = (i32::from(self.drift) << 16).wrapping_sub(self.speed);
        pull + scale(damping, behind, damping_bytes - 2)
    }

    /// q += q′ dt, q_d += q_d′ dt, and the steps on the way.
    fn advance(&mut self) -> Slice {
        let (before, speed) = (self.ahead, self.speed);
        let mut after = before.wrapping_sub(speed);
        if !self.stopping {
            let moved = upper(after).wrapping_sub(upper(before)).wrapping_add(self.drift);
            self.move_gap(moved);
        }
        // A backward slice is computed as its mirror image, a forward one.
        let backward = speed < 0;
        let mut distance = before;
        if backward {
            after = after.wrapping_neg();
            distance = distance.wrapping_neg();
        }
        let distance = distance.wrapping_add(THRESHOLD).cast_unsigned();
        // By halves, since LLVM would make a division of a simple loop.
        let mut count = 0;
        let mut weight = 8;
        let mut far = 8 * STEP;
        while weight != 0 {
            if after <= STEP - THRESHOLD - far {
                after += far;
                count += weight;
            }
            weight >>= 1;
            far >>= 1;
        }
        let steps = i32::from(count);
        if backward {
            self.made = self.made.wrapping_sub(steps);
            self.ahead = after.wrapping_neg();
        } else {
            self.made = self.made.wrapping_add(steps);
            self.ahead = after;
        }
        Slice { count, backward, distance, speed: speed.unsigned_abs() }
    }

    /// Changes q_d − q by `moved` millisteps, up to the end of 48 bits.
    fn move_gap(&mut self, moved: i16) {
        let [b0, b1, b2, b3, b4, b5, b6, b7] = self.gap.get().wrapping_add(moved.into()).to_le_bytes();
        if i16::from_le_bytes([b6, b7]) == if b5 >= 0x80 { -1 } else { 0 } {
            self.gap = Wide([b0, b1, b2, b3, b4, b5]);
        }
    }

    /// q′ += q″ dt, both clamped.
    fn hasten(&mut self, change: i64) {
        let steepest = self.limits.change();
        let change = if change > steepest {
            steepest
        } else if change < -steepest {
            -steepest
        } else {
            change
        };
        let old = self.whole_speed();
        let new = old.wrapping_add(change);
        let ([b0, b1, b2, b3, b4, b5, _, _], fastest) = (new.to_le_bytes(), self.limits.speed().cast_signed());
        self.speed_low = u16::from_le_bytes([b0, b1]);
        self.speed = i32::from_le_bytes([b2, b3, b4, b5]);
        if self.speed >= fastest || self.speed < -fastest {
            self.slow_down(old);
        }
        if self.stopping && new == 0 {
            self.stopping = false;
        }
    }

    /// Limits the speed to vmax, or to amax·dt less than `old`, whichever is more.
    #[cold]
    fn slow_down(&mut self, old: i64) {
        let fastest = i64::from(self.limits.speed()) << 16;
        let least = old.abs() - self.limits.change();
        let magnitude = if least > fastest { least } else { fastest };
        let bounded = if self.speed < 0 { -magnitude } else { magnitude };
        let [b0, b1, b2, b3, b4, b5, _, _] = bounded.to_le_bytes();
        self.speed_low = u16::from_le_bytes([b0, b1]);
        self.speed = i32::from_le_bytes([b2, b3, b4, b5]);
    }

    /// q′, 2^-32 steps/s.
    const fn whole_speed(&self) -> i64 {
        let ([b0, b1], [b2, b3, b4, b5]) = (self.speed_low.to_le_bytes(), self.speed.to_le_bytes());
        let sign = if self.speed < 0 { 0xff } else { 0 };
        i64::from_le_bytes([b0, b1, b2, b3, b4, b5, sign, sign])
    }
}

/// `mantissa`·|`x`| / 256^`bytes`, rounded down, with `x`'s sign. `bytes` ≤ 4.
fn scale(mantissa: u32, x: i32, bytes: u8) -> i64 {
    let product = ((u64::from(mantissa) * u64::from(x.unsigned_abs())) >> (8 * bytes)).cast_signed();
    if x < 0 { -product } else { product }
}

/// Its upper 16 bits.
#[inline(always)]
const fn upper(value: i32) -> i16 {
    let [_, _, b2, b3] = value.to_le_bytes();
    i16::from_le_bytes([b2, b3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn constants_are_what_they_say() {
        let check = |value: u32, bytes: u8, exact: f64| {
            let value = f64::from(value) / 256_f64.powi(bytes.into());
            assert!((value / exact - 1.0).abs() < 0.5_f64.powi(26), "{value} {exact}");
        };
        let pi = core::f64::consts::PI;
        check(STIFFNESS.0, STIFFNESS.1, 4.0 * pi * pi * 1e-18);
        check(DAMPING.0, DAMPING.1, 4.0 * pi * 1e-15);
        check(FIRST_DAMPING.mantissa, FIRST_DAMPING.bytes, 1e-3);
        check(SPEED, 5, 1e-3);
        check(CHANGE, 6, 1e-6);
        let Parts { first, second, low, .. } = Limits::DEFAULT.0;
        assert_eq!((first, second >> 8, low), (3500 << 16, 0, 35));
    }

    #[test]
    fn limits_have_ends() {
        assert_eq!(Limits::new(1000, 999), None);
        let most = Limits::new(10_000_000, 250_000_000);
        assert!(most.is_some_and(|most| most.0.first == 10_000 << 16 && most.0.low == 250));
        assert_eq!(Limits::new(u32::MAX, u32::MAX), most);
        assert!(Limits::new(0, 1000).is_some_and(|least| least.0.second == 4_294_967));
    }

    proptest! {
        #[test]
        fn wide_numbers_saturate(bytes: [u8; 6], other: [u8; 6], steps in -1_i64 << 32..1 << 32, high in 0..=255_u8) {
            let clamped = |value: i64| value.clamp(-1 << 47, (1 << 47) - 1);
            let mut bytes = bytes;
            // Some near the ends.
            bytes[5] = if high & 1 == 0 { high } else { bytes[5] };
            let (mut sum, other) = (Wide(bytes), Wide(other));
            let mut difference = sum;
            sum.add(&other);
            prop_assert_eq!(sum.get(), clamped(Wide(bytes).get() + other.get()));
            difference.subtract(&other);
            prop_assert_eq!(difference.get(), clamped(Wide(bytes).get() - other.get()));
            prop_assert_eq!(Wide::of(steps).get(), steps);
            prop_assert_eq!(Wide::thousandfold(steps).get(), steps * 1000);
        }

        #[test]
        fn products_are_cut_towards_0(mantissa: u32, x in -i32::MAX..i32::MAX, bytes in 0..5_u8) {
            let exact = i128::from(mantissa) * i128::from(x) / (1 << (8 * bytes));
            prop_assert_eq!(i128::from(scale(mantissa, x, bytes)), exact);
        }
    }
}
