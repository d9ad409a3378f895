//! Whether steps keep to a motor's limits.

/// A step: its tick, and 1 forward or -1 backward.
pub type Step = (u64, i64);

/// No acceleration above `limit` (steps/s²) over any stretch of steps, as far as ticks that may be off by `doubt` tell.
///
/// # Errors
/// With the acceleration, its bound, and where.
pub fn check_acceleration(steps: &[Step], tick_hz: u64, limit: f64, doubt: f64) -> Result<(), String> {
    let hz = tick_hz as f64;
    for run in steps.chunk_by(|a, b| a.1 == b.1) {
        let mut stride = 1;
        while 2 * stride < run.len() {
            for k in 0..run.len() - 2 * stride {
                let [a, b, c] = [k, k + stride, k + 2 * stride].map(|k| run[k].0 as f64 / hz);
                let (before, after) = (stride as f64 / (b - a), stride as f64 / (c - b));
                let error = 2.0 * doubt / hz * (before / (b - a) + after / (c - b));
                let acceleration = (after - before).abs() / (0.5 * (c - a));
                let bound = limit * 1.001 + error * 1.1 / (0.5 * (c - a));
                if acceleration > bound {
                    return Err(format!("{acceleration} steps/s² over {bound} at {:?}", run[k]));
                }
            }
            stride *= 2;
        }
    }
    Ok(())
}

/// The last step comes at a speed from which a motor that starts at `pull_in` steps/s, and brakes by `limit` steps/s², can stop at once:
/// less than a step before rest it has run at √(4a) or less since the step before. Opposite steps are a hysteresis apart, so their interval
/// is no speed.
///
/// # Errors
/// With the speed, and what would do.
pub fn check_last_step(steps: &[Step], tick_hz: u64, limit: f64, pull_in: f64) -> Result<(), String> {
    if let [.., before, last] = steps
        && before.1 == last.1
    {
        let speed = tick_hz as f64 / (last.0 - before.0) as f64;
        let slow = pull_in + 1.05 * (4.0 * limit).sqrt();
        if speed > slow {
            return Err(format!("it stops at once from {speed} steps/s; {slow} would do"));
        }
    }
    Ok(())
}
