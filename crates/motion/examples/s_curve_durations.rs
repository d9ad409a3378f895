//! Durations of S-curves, for cross-checks with other planners.
//!
//! Reads lines of `distance max_speed max_acceleration max_jerk start_speed` (steps, s) and prints a duration in
//! seconds for each, or the reason why there is none.

use pulsetrain_motion::Law;
use pulsetrain_motion::law::SCurve;
use std::io::BufRead;

fn duration(line: &str) -> Result<f64, String> {
    let numbers: Result<Vec<f64>, _> = line.split_whitespace().map(str::parse).collect();
    let [distance, max_speed, max_acceleration, max_jerk, start_speed] = numbers.map_err(|e| e.to_string())?[..] else {
        return Err("five numbers expected".into());
    };
    let law = Law::s_curve(SCurve { distance, max_speed, max_acceleration, max_jerk, start_speed });
    law.map_err(|e| e.to_string()).map(|law| law.end().map_or(f64::INFINITY, |end| end.seconds()))
}

fn main() -> std::io::Result<()> {
    for line in std::io::stdin().lock().lines() {
        match duration(&line?) {
            Ok(duration) => println!("{duration}"),
            Err(why) => println!("error: {why}"),
        }
    }
    Ok(())
}
