//! Time tags of bundles, on the host's clock.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use rosc::OscTime;

use super::Now;

/// From 1900, where time tags begin, to 1970, s. Source: RFC 5905, figure 4.
const FROM_1900_TO_1970_S: u64 = 2_208_988_800;
/// The time tag that means "at once". Source: OSC 1.0, "OSC Time Tags".
const AT_ONCE: OscTime = OscTime { seconds: 0, fractional: 1 };
/// A bundle that is later than this is reported. A sender that puts the present time on its bundles is always somewhat late.
const LATE: Duration = Duration::from_millis(2);
/// A bundle may be this long ahead of its time.
pub(super) const FARTHEST_AHEAD: Duration = Duration::from_secs(60);

/// When a bundle is to act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Due {
    /// At once, as its sender asked for.
    AtOnce,
    /// At this time, now or later.
    At(Instant),
    /// Its time is past by so much; it acts at once.
    Late(Duration),
    /// Its time is so far ahead that it is refused.
    TooFar(Duration),
}

pub(super) fn due(tag: OscTime, now: Now) -> Due {
    if tag == AT_ONCE {
        return Due::AtOnce;
    }
    let fixed = (u64::from(tag.seconds) << 32) | u64::from(tag.fractional);
    // In 2036 the seconds begin again at 0. The difference is right all the same, within 68 years.
    let ahead = fixed.wrapping_sub(since_1900(now.system)).cast_signed();
    let span = Duration::from_nanos(((u128::from(ahead.unsigned_abs()) * 1_000_000_000) >> 32) as u64);
    match ahead {
        0.. if span > FARTHEST_AHEAD => Due::TooFar(span),
        0.. => Due::At(now.instant + span),
        _ if span > LATE => Due::Late(span),
        _ => Due::At(now.instant),
    }
}

/// In units of 2^-32 s, modulo 2^64.
fn since_1900(time: SystemTime) -> u64 {
    // A clock before 1970 counts as 1970.
    let since_1970 = time.duration_since(UNIX_EPOCH).unwrap_or_default();
    let fraction = (u64::from(since_1970.subsec_nanos()) << 32) / 1_000_000_000;
    (since_1970.as_secs().wrapping_add(FROM_1900_TO_1970_S) << 32) | fraction
}

/// The time tag of a moment.
#[cfg(test)]
pub(super) fn tag_of(time: SystemTime) -> OscTime {
    let fixed = since_1900(time);
    OscTime { seconds: (fixed >> 32) as u32, fractional: fixed as u32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn now(system: SystemTime) -> Now {
        Now { instant: Instant::now(), system }
    }

    fn check(ahead_s: f64, system: SystemTime, expected: impl Fn(Now) -> Due) {
        let now = now(system);
        let span = Duration::from_secs_f64(ahead_s.abs());
        let when = if ahead_s < 0.0 { system - span } else { system + span };
        let (found, expected) = (due(tag_of(when), now), expected(now));
        let near = |a: Duration, b: Duration| a.abs_diff(b) < Duration::from_nanos(3);
        let same = match (found, expected) {
            (Due::At(a), Due::At(b)) => near(a - now.instant, b - now.instant),
            (Due::Late(a), Due::Late(b)) | (Due::TooFar(a), Due::TooFar(b)) => near(a, b),
            (a, b) => a == b,
        };
        assert!(same, "{ahead_s} s: {found:?}, not {expected:?}");
    }

    #[test]
    fn times_are_on_the_host_s_clock() {
        let seconds = Duration::from_secs_f64;
        // In 2026, and around the second in 2036 at which the count begins again.
        for since_1970_s in [1_795_000_000, 2_085_978_490, 2_085_978_496, 2_085_978_500] {
            let system = UNIX_EPOCH + Duration::from_secs(since_1970_s);
            check(0.25, system, |now| Due::At(now.instant + seconds(0.25)));
            check(59.9, system, |now| Due::At(now.instant + seconds(59.9)));
            check(60.5, system, |_| Due::TooFar(seconds(60.5)));
            check(-0.001, system, |now| Due::At(now.instant));
            check(-0.25, system, |_| Due::Late(seconds(0.25)));
            check(-1e6, system, |_| Due::Late(seconds(1e6)));
        }
        let now = now(SystemTime::now());
        assert_eq!(due(AT_ONCE, now), Due::AtOnce);
        // What a sender without a clock may put there.
        assert!(matches!(due(OscTime { seconds: 0, fractional: 0 }, now), Due::Late(_) | Due::TooFar(_)));
        assert!(matches!(due(OscTime { seconds: u32::MAX, fractional: u32::MAX }, now), Due::TooFar(_)));
    }
}
