//! A short summary of the verdict: one line for each motor, then the failures.

use std::fmt;

use crate::verdict::{Alignment, Fault, FilmReport, Jump, Measured, MotorReport, Report};

/// Number of failures in the summary; the report counts all.
const SHOWN: usize = 10;

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for motor in &self.motors {
            writeln!(f, "{motor}")?;
        }
        let alignment = &self.alignment;
        if alignment.shift_s != 0.0 {
            writeln!(
                f,
                "time zero at {:.9} s of the trace; board's clock {:+.2} ppm",
                alignment.shift_s, alignment.rate_ppm
            )?;
        }
        let faults = self.motors.iter().map(|m| m.faults).sum::<u64>();
        failures(f, self.failures.iter(), faults)?;
        f.write_str(if self.ok { "PASS" } else { "FAIL" })
    }
}

impl fmt::Display for MotorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let m = self;
        write!(
            f,
            "{}: {} of {} steps, at {} (wanted {}); error max {:+.3} ticks ({:+.3} µs), rms {:.3}, limit {:.2}; drift {:+.3} ppm",
            m.motor,
            m.steps_got,
            m.steps_wanted,
            m.position_got,
            m.position_wanted,
            m.max_error_ticks,
            m.max_error_us,
            m.rms_error_ticks,
            m.bound_ticks,
            m.drift_ppm,
        )?;
        if let Some(rate) = m.peak_rate_hz {
            write!(f, "; peak {rate:.0} steps/s")?;
        }
        let times = [("HIGH", m.pulse_high), ("LOW", m.pulse_low), ("setup", m.dir_setup), ("hold", m.dir_hold)];
        for (name, Measured { seen_ns, .. }) in times.into_iter().filter_map(|(name, m)| Some((name, m?))) {
            write!(f, "; {name} {}", duration(seen_ns))?;
        }
        if m.pairs_dropped > 0 {
            write!(f, "; {} pairs dropped (off by {:.3} steps at most)", m.pairs_dropped, m.worst_position_error)?;
        }
        if m.steps_put_off > 0 {
            write!(f, "; {} steps put off ({:.1} ticks at most)", m.steps_put_off, m.longest_put_off_ticks)?;
        }
        Ok(())
    }
}

impl fmt::Display for FilmReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let FilmReport { motor, frames, from_s, to_s, .. } = self;
        writeln!(f, "{motor}: {frames} frames, {from_s:.3} s to {to_s:.3} s of the motion")?;
        let Alignment { shift_s, rate_ppm } = self.alignment;
        if shift_s != 0.0 || rate_ppm != 0.0 || self.zero_deg != 0.0 || self.reversed {
            writeln!(
                f,
                "  found: the motion starts at {shift_s:.4} s of the film; its 0 is at {:.2}° of the film; clocks differ by {rate_ppm:+.0} ppm",
                self.zero_deg
            )?;
        }
        if self.reversed {
            writeln!(f, "  the film shows the motion the other way round, as from behind")?;
        }
        if let Some(sigma_deg) = self.sigma_deg {
            writeln!(f, "  uncertainty of an angle: {sigma_deg:.3}° (1 σ, the middle one)")?;
        }
        writeln!(
            f,
            "  largest error {:+.3}° ({:+.2} steps) at {:.3} s, rms {:.3}° ({:.2} steps); limit {:.3}° ({:.2} steps)",
            self.max_error_deg,
            self.max_error_steps,
            self.max_error_at_s,
            self.rms_error_deg,
            self.rms_error_steps,
            self.limit_deg,
            self.limit_steps,
        )?;
        if self.doubtful_frames > 0 {
            writeln!(f, "  frames too uncertain to tell: {} of {frames}", self.doubtful_frames)?;
        }
        for jump in &self.jumps {
            writeln!(f, "  {jump}")?;
        }
        if self.jumps.is_empty() {
            failures(f, self.failures.iter().take(FEW), self.frames_beyond_limit.max(self.failures.len() as u64))?;
        } else {
            // Every frame behind a jump is off; the jump says it.
            failures(f, self.failures.iter().filter(|failure| !matches!(failure.fault, Fault::Angle { .. })), 0)?;
        }
        if self.ok { f.write_str("PASS: no bound broke") } else { write!(f, "FAIL: {}", self.reason()) }
    }
}

/// Frames beyond the limit that are listed.
const FEW: usize = 3;

impl FilmReport {
    /// Why it failed, in a few words.
    fn reason(&self) -> String {
        let mut reasons: Vec<String> =
            self.jumps.iter().filter(|jump| jump.is_certain()).map(Jump::to_string).collect();
        if reasons.is_empty() && self.frames_beyond_limit > 0 {
            reasons.push(format!(
                "the wheel is off by more than {:.3}° in {} frames",
                self.limit_deg, self.frames_beyond_limit
            ));
        }
        if let Some(clock) = self.failures.iter().find(|failure| matches!(failure.fault, Fault::Clock { .. })) {
            reasons.push(clock.to_string());
        }
        reasons.join("; ")
    }
}

/// "8 steps lost at 0.75 s".
impl fmt::Display for Jump {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let what = match (self.way, self.is_loss()) {
            (0, _) if self.steps > 0.0 => "too far forward",
            (0, _) => "too far backward",
            (_, true) => "lost",
            (_, false) => "added",
        };
        match self.whole {
            Some(1 | -1) => write!(f, "1 step {what}")?,
            Some(whole) => write!(f, "{} steps {what}", whole.unsigned_abs())?,
            None => write!(f, "about {:.1} ± {:.1} steps {what}", self.steps.abs(), self.sigma_steps)?,
        }
        let (from_s, to_s) = (self.from_s, self.to_s);
        if to_s - from_s > GRADUAL_S {
            write!(f, " from {from_s:.2} s to {to_s:.2} s")?;
        } else {
            write!(f, " at {:.2} s", 0.5 * (from_s + to_s))?;
        }
        if self.whole.is_none() {
            let why = if 3.0 * self.sigma_steps < 0.5 { "no whole number" } else { "the film cannot tell how many" };
            write!(f, " ({why})")?;
        }
        Ok(())
    }
}

/// Steps that are lost over a longer time than this are lost one after the other.
const GRADUAL_S: f64 = 0.06;

fn failures(f: &mut fmt::Formatter<'_>, failures: impl Iterator<Item = impl fmt::Display>, in_all: u64) -> fmt::Result {
    let mut shown = 0;
    for failure in failures.take(SHOWN) {
        writeln!(f, "  {failure}")?;
        shown += 1;
    }
    if in_all > shown {
        writeln!(f, "  and {} more", in_all - shown)?;
    }
    Ok(())
}

/// A time in the unit that suits it.
fn duration(ns: f64) -> String {
    match ns {
        ..1e4 => format!("{ns:.0} ns"),
        1e4..1e7 => format!("{:.1} µs", ns * 1e-3),
        _ => format!("{:.1} ms", ns * 1e-6),
    }
}
