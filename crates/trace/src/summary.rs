//! A short summary of the verdict: one line for each motor, then the failures.

use std::fmt;

use crate::verdict::{Alignment, FilmReport, Measured, MotorReport, Report};

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
        writeln!(
            f,
            "{}: {} frames, {:.3} s to {:.3} s of the motion; error max {:+.3} steps ({:+.3}°) at {:.3} s, rms {:.3} ({:.3}°), limit {:.2} steps",
            self.motor,
            self.frames,
            self.from_s,
            self.to_s,
            self.max_error_steps,
            self.max_error_deg,
            self.max_error_at_s,
            self.rms_error_steps,
            self.rms_error_deg,
            self.limit_steps,
        )?;
        let Alignment { shift_s, rate_ppm } = self.alignment;
        if shift_s != 0.0 || rate_ppm != 0.0 || self.zero_deg != 0.0 {
            let zero_deg = self.zero_deg;
            writeln!(
                f,
                "time zero at {shift_s:.4} s of the film, at {zero_deg:.3}°; clocks differ by {rate_ppm:+.0} ppm"
            )?;
        }
        failures(f, self.failures.iter(), self.failures.len() as u64)?;
        f.write_str(if self.ok { "PASS" } else { "FAIL" })
    }
}

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
