//! How long an Uno's pins and pulses keep its motors apart, ticks.

use crate::boards::pins::{PinRules, PinsError};
use crate::boards::profile::{BoardProfile, EdgeDelay, SharedSteps};
use crate::motor::{DriverTiming, Motor};
use pulsetrain_core::boards::uno;

use super::measured::{BY_COMPARE, BY_SOFTWARE, LATENESS, PAIR, PULSES};
use super::pins::PinKind;

/// The number of pulse lengths that were measured.
const COLUMNS: usize = PULSES.len();

// The firmware's own numbers, as ticks of the host.
const LATENCY: u32 = uno::LATENCY as u32;
const LATENCY_MERGED: u32 = uno::LATENCY_MERGED as u32;
const SPACING: u32 = uno::SPACING as u32;
const SPACING_SHIELD: [u32; 2] = [uno::SPACING_SHIELD[0] as u32, uno::SPACING_SHIELD[1] as u32];
const SPACING_TWO_RINGS: u32 = uno::SPACING_TWO_RINGS as u32;
const SPACING_TWO_COMPARE: u32 = uno::SPACING_TWO_COMPARE as u32;
const END_DELAY: u32 = uno::END_DELAY as u32;
const MAX_PULSE: u32 = uno::MAX_SHORT_PULSE as u32;

/// The rules of [`PinKind`]. Each kind has rates of its own.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnoPins;

impl PinRules for UnoPins {
    fn check(&self, motors: &[Motor]) -> Result<(), PinsError> {
        PinKind::of(motors)?;
        Ok(())
    }

    fn shortest_intervals(&self, board: &BoardProfile, motors: &[Motor]) -> Vec<u32> {
        let Ok(kind) = PinKind::of(motors) else { return board.min_interval_ticks.to_vec() };
        let hz = board.tick_hz;
        let timing = DriverTiming::longest(motors).ticks(hz);
        let pulse = timing.pulse_high;
        let shares = shares_dir(motors);
        let is_pair = |count: usize| count == 2 && motors.len() == 2 && kind == PinKind::PortD;
        let of = |(count, by_pulse): (usize, &[u32; COLUMNS])| {
            let by_pulse = if is_pair(count) && !shares { &PAIR } else { by_pulse };
            let long = LongPulse::of(kind, count, is_pair(count));
            let own = if pulse > long.longest_together() {
                by_pulse[COLUMNS - 1]
            } else {
                // A pulse between two measured lengths counts as the longer one.
                let column = PULSES[..COLUMNS - 2].iter().position(|longest| pulse <= u64::from(*longest));
                by_pulse[column.unwrap_or(COLUMNS - 2)]
            };
            // Motors that share a DIR line step one after the other.
            let shared = if shares { SHARED_STEP_TICKS * count as u32 } else { 0 };
            let edges = long.shortest_interval(pulse, timing.pulse_low);
            own.max(shared).max(edges)
        };
        let by_count = if kind == PinKind::Compare { &BY_COMPARE[..] } else { &BY_SOFTWARE[..] };
        (1..).zip(by_count).map(of).collect()
    }

    fn longest_pulse_together(&self, board: &BoardProfile, motors: &[Motor]) -> Option<u32> {
        let kind = PinKind::of(motors).ok()?;
        let hz = board.tick_hz;
        let is_pair = motors.len() == 2 && kind == PinKind::PortD;
        let longest = LongPulse::of(kind, motors.len(), is_pair).longest_together();
        let is_longer = DriverTiming::longest(motors).ticks(hz).pulse_high > longest;
        (is_longer && !shares_dir(motors)).then(|| u32::try_from(longest * 1_000_000_000 / hz).unwrap_or(u32::MAX))
    }

    /// That image has no second ring for the fourth motor, so that all four are merged, as with longer pulses.
    fn shortest_of_four_baked(&self) -> Option<u32> {
        Some(BY_SOFTWARE[3][1])
    }

    fn turn_ticks(&self, board: &BoardProfile, motors: &[Motor]) -> u32 {
        match PinKind::of(motors) {
            Ok(PinKind::PortD | PinKind::PortB | PinKind::Shield) if motors.len() > 1 && !shares_dir(motors) => {
                TURN_TICKS[1]
            }
            Ok(PinKind::Compare) => TURN_TICKS_BY_COMPARE[usize::from(motors.len() > 1)],
            _ => board.turn_ticks,
        }
    }

    /// An Uno makes steps one after the other if motors share a DIR line. But a pulse up to 1.94 µs is over so soon that no step has to wait for it.
    fn shared_steps(&self, board: &BoardProfile, motors: &[Motor]) -> Option<SharedSteps> {
        let pulse = DriverTiming::longest(motors).ticks(board.tick_hz).pulse_high;
        if !shares_dir(motors) || pulse <= u64::from(MAX_PULSE) {
            return None;
        }
        let apart_ticks = u64::from(LATENCY + SPACING_SHIELD[0]) + pulse;
        Some(SharedSteps { together_ticks: SPACING / 2, apart_ticks: u32::try_from(apart_ticks).unwrap_or(u32::MAX) })
    }

    fn edge_delay(&self, _: &BoardProfile, motors: &[Motor]) -> EdgeDelay {
        match PinKind::of(motors) {
            Ok(PinKind::Compare) => EdgeDelay { constant_ticks: PinKind::Compare.constant_ticks(), late_ticks: 0 },
            Ok(kind) => EdgeDelay { constant_ticks: kind.constant_ticks(), late_ticks: LATENESS },
            Err(_) => EdgeDelay::default(),
        }
    }
}

/// The time that a turn of DIR takes an Uno, ticks: alone, and where motors are merged in one ring. `PulseTiming::of` in
/// firmware/uno/src/engine/steps/stepper/timing.rs adds it up: an edge may be late before the turn and after it, the way to the line after the
/// match takes time, and a merge moves edges by up to two spacings.
pub(super) const TURN_TICKS: [u32; 2] =
    [LATENCY + SPACING + LATENCY, LATENCY_MERGED + END_DELAY + LATENCY_MERGED + 2 * SPACING_SHIELD[1]];
/// The same for one and for two motors of the compare hardware: the spacing of groups, before the turn and after it.
const TURN_TICKS_BY_COMPARE: [u32; 2] = [2 * SPACING_TWO_RINGS, 2 * SPACING_TWO_COMPARE];

/// The time that a step takes on an Uno whose motors share a DIR line, ticks. With 2400, sweeps of four motors at nine tenths of the rate ended in
/// a stop (`cargo xtask accept --seed 20 --only 1080 --board uno`).
const SHARED_STEP_TICKS: u32 = 2_800;

/// How an Uno makes a pulse whose end is a compare match of its own: `PulseTiming::of` in firmware/uno/src/engine/steps/stepper/timing.rs.
struct LongPulse {
    /// How much longer the pulse is than configured, ticks.
    more: u32,
    /// How late its end may be, ticks.
    late: u32,
    /// Shortest time from its end to the next step, ticks.
    apart: u32,
    /// Whether several steps may be worked out at once.
    together: bool,
}

impl LongPulse {
    /// The pulse with this many motors, none of which share a DIR line. The motors of a pair have a ring each.
    fn of(kind: PinKind, motors: usize, is_pair: bool) -> LongPulse {
        let (alone, moved) = (LATENCY, LATENCY_MERGED);
        if kind == PinKind::Compare {
            let apart = if motors > 1 { SPACING_TWO_COMPARE } else { SPACING_TWO_RINGS };
            return LongPulse { more: 0, late: 0, apart, together: false };
        }
        if is_pair {
            return LongPulse { more: moved, late: moved, apart: SPACING_TWO_RINGS, together: true };
        }
        let apart = if kind == PinKind::Shield { SPACING_SHIELD[0] } else { SPACING };
        // If motors are merged in one ring, the second edge may be early.
        let (more, late) = if motors > 1 { (moved + apart, moved) } else { (alone, alone) };
        LongPulse { more, late, apart, together: true }
    }

    /// The longest pulse with which several steps are worked out at once, ticks: with its extension it must fit in 8 bits. The compare hardware has
    /// no such mode; its limit is the longest pulse that one interrupt makes.
    fn longest_together(&self) -> u64 {
        if self.together { u64::from(u8::MAX) - u64::from(self.more) } else { u64::from(MAX_PULSE) }
    }

    /// The shortest interval, ticks, with the margin of the table's limits: the pulse as it is made, and the shortest time to the next one.
    fn shortest_interval(&self, pulse: u64, low: u64) -> u32 {
        let [pulse, low] = [pulse, low].map(|ticks| u32::try_from(ticks).unwrap_or(u32::MAX));
        let low = low.saturating_add(self.late);
        let ticks = if pulse > MAX_PULSE {
            pulse.saturating_add(self.more).saturating_add(low.max(self.apart))
        } else {
            low.saturating_add(MAX_PULSE)
        };
        ticks.saturating_add(ticks.div_ceil(40))
    }
}

/// Whether two motors have one DIR line.
fn shares_dir(motors: &[Motor]) -> bool {
    motors.iter().any(|motor| motors.iter().any(|other| other.shares_dir_with(motor)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::boards::find;

    #[test]
    fn motors_and_longer_pulses_take_time() {
        let row = find("Uno").unwrap();
        // Not the last column: one step at a time takes a ring longer than a merge's lists.
        for column in 0..COLUMNS - 1 {
            assert!(BY_SOFTWARE.is_sorted_by_key(|by_pulse| by_pulse[column]));
            assert!(BY_COMPARE.is_sorted_by_key(|by_pulse| by_pulse[column]));
        }
        let motor = |step, pulse_high_ns| Motor {
            name: "m".to_owned(),
            law: crate::Law::sine(100.0, crate::Time::SECOND, Some(1)).unwrap(),
            wiring: crate::motor::Wiring::StepDir { step, dir: 8, forward_high: true, enable: None },
            timing: DriverTiming { pulse_high_ns, ..Default::default() },
            limits: crate::motor::Limits::default(),
            scale: crate::motor::Scale { unit: "step".to_owned(), steps_per_unit: 1.0, steps_per_rev: 200.0 },
            winding: None,
            driver: None,
        };
        let check = |step, pulse_ns, expected: &[[u32; COLUMNS]], column: usize| {
            let expected: Vec<u32> = expected.iter().map(|by_pulse| by_pulse[column]).collect();
            assert_eq!(row.shortest_intervals(&[motor(step, pulse_ns)]), expected, "{step}, {pulse_ns} ns");
        };
        check(11, 1000, &BY_SOFTWARE, 0);
        check(11, 1900, &BY_SOFTWARE, 1);
        check(11, 5000, &BY_SOFTWARE, 2);
        check(11, 16_000, &BY_SOFTWARE, 3);
        check(9, 1000, &BY_COMPARE, 0);
        // Long pulses on one DIR line: one after the other.
        let together =
            |name: &str, pulse_ns| find(name).unwrap().shared_steps(&[motor(10, pulse_ns), motor(11, pulse_ns)]);
        let steps = Some(SharedSteps { together_ticks: 24, apart_ticks: 160 + 24 + 60 });
        assert_eq!(together("uno", 10_000), steps);
        assert_eq!([together("uno", 1900), together("pico", 10_000), together("native", 10_000)], [None; 3]);
        assert_eq!(row.shared_steps(&[motor(10, 10_000)]), None);
        // Two on port D have a ring each.
        let pair = |steps: [u8; 2], pulse_ns| {
            let own_dir = |step: u8| Motor {
                wiring: crate::motor::Wiring::StepDir { step, dir: step + 2, forward_high: true, enable: None },
                ..motor(step, pulse_ns)
            };
            row.shortest_intervals(&steps.map(own_dir))[1]
        };
        assert_eq!([pair([2, 3], 1000), pair([2, 3], 5000)], [PAIR[0], PAIR[2]]);
        assert_eq!(pair([8, 9], 1000), BY_SOFTWARE[1][0]);
        assert!(PAIR[0] < BY_SOFTWARE[1][0] && PAIR[0] < PAIR[2]);
        // The longest pulse with which steps are worked out together is that of the pins; behind it there is room for the edges.
        let one = |pulse_ns| row.shortest_intervals(&[motor(11, pulse_ns)])[0];
        assert_eq!([one(14_437), one(14_438)], [311, BY_SOFTWARE[0][3]]);
        assert_eq!([pair([2, 3], 12_187), pair([2, 3], 12_188)], [PAIR[2], PAIR[3]]);
        assert_eq!([pair([8, 9], 9187), pair([8, 9], 9188)], [BY_SOFTWARE[1][2], BY_SOFTWARE[1][3]]);
        assert_eq!(row.longest_pulse_together(&[motor(11, 14_437)]), None);
        assert_eq!(row.longest_pulse_together(&[motor(11, 50_000)]), Some(14_437));
        // Such a pulse may be longer than what its steps take.
        assert_eq!(one(200_000), 3200 + 24 + 48 + 82);
    }
}
