//! Whether steps keep to a motor's limits.

/// A step: its tick, and 1 forward or -1 backward.
pub type Step = (u64, i64);

/// Checks that no two neighbouring stretches of equally many steps show an acceleration above `limit`, steps/s². Each tick may be off by `doubt`.
///
/// # Errors
/// The acceleration, its bound, and the place.
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

/// Checks that no two steps in the same direction come sooner after one another than at `limit`, steps/s. Each tick may be off by `doubt`.
///
/// # Errors
/// The interval, the least that is allowed, and the place.
pub fn check_speed(steps: &[Step], tick_hz: u64, limit: f64, doubt: f64) -> Result<(), String> {
    let least = tick_hz as f64 / (limit * 1.001) - 2.0 * doubt;
    match steps.windows(2).find(|pair| pair[0].1 == pair[1].1 && ((pair[1].0 - pair[0].0) as f64) < least) {
        Some(pair) => {
            Err(format!("a step {} ticks after {:?}; {least} ticks are the least", pair[1].0 - pair[0].0, pair[0]))
        }
        None => Ok(()),
    }
}

/// Checks that a motor with a pull-in rate of `pull_in`, steps/s, that brakes by `limit`, steps/s², can stop at once after its last step: with less than
/// a step to go, its mean speed since the step before is at most √(4a). A last step in the opposite direction is not checked: its interval is no
/// speed.
///
/// # Errors
/// The speed, and the speed that would be allowed.
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
