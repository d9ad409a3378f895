//! The boards' limits: the table that plans are checked against.
//!
//! The source of a row says `estimate` until a bench on the emulated firmware has measured its figures.

mod pico;
mod uno;
mod uno_tuning;

use std::ops::RangeInclusive;

use crate::board::{Board, SegmentTicks, SharedSteps};
use crate::motor::{DriverTiming, Motor, Wiring};
use crate::pins::{self, PinKind, PinsError};
use uno_tuning::{
    END_DELAY, LATENCY, LATENCY_MERGED, MAX_PULSE, SPACING, SPACING_SHIELD, SPACING_TWO_COMPARE, SPACING_TWO_RINGS,
};

/// One row of the table: the limits of plans, and other things that a user should know.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardRow {
    /// The limits of plans.
    pub board: Board,
    /// What it is, in a line.
    pub about: &'static str,
    /// RAM, bytes; `None` if it is no limit.
    pub ram_bytes: Option<u32>,
    /// Flash, bytes; `None` if it is no limit.
    pub flash_bytes: Option<u32>,
    /// Each motor's queue, bytes, with 1, 2, … motors; the last entry is for more. Empty if it is no limit.
    pub queue_bytes: Vec<u32>,
    /// How far ahead steps are committed, ticks.
    pub horizon_ticks: u32,
    /// Largest |edge − scheduled| beyond its constant, ticks.
    pub lateness_ticks: u32,
    /// How plans come over its line; `None` if the board has no line.
    pub line: Option<LineRow>,
    /// What to know about its pins and timing.
    pub note: &'static str,
    /// Pins that exist.
    pins: RangeInclusive<u8>,
    /// Pins that exist but cannot drive a motor, with the reason.
    reserved: &'static [(RangeInclusive<u8>, &'static str)],
    /// Where the analogue pins A0, A1, … begin, and how many they are.
    analogue: Option<(u8, u8)>,
    pin_rules: PinRules,
}

/// How plans come to a board over its line while motors move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineRow {
    /// The time from when an item leaves its queue until a lease is extended over the item that replaced it, without the time on the line, µs. It
    /// is that of a board which has nothing else to read.
    pub delay_us: u32,
    /// Additional delay for each byte of plans that the board had to read in the last 10 ms, µs.
    pub delay_byte_us: u32,
    /// Other bytes that the line brings within this delay, bytes.
    pub delay_bytes: u32,
    /// Rate of the bytes that are no plans, bytes/s: extensions of the lease, and questions.
    pub other_bytes_per_s: u32,
    /// How many bytes a byte of a plan takes on the line, with its share of a frame's other bytes.
    pub frame_share: f64,
    /// The rate of the board's own USB, bytes/s, which has no baud. `None`: the board has only a UART, behind an adapter or a bridge.
    pub usb_bytes_per_s: Option<u32>,
}

/// How the pins of a board work together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PinRules {
    /// All pins are equivalent.
    Alike,
    /// The rules of [`PinKind`]. Each kind has rates of its own.
    Kinds(&'static Rates),
    /// The rules of [`pins::check_pico`].
    Neighbours,
}

/// The measurements of the Uno's firmware that the bench has written.
#[derive(Debug, PartialEq, Eq)]
struct Rates {
    pulses: [u32; PULSES],
    by_software: [[u32; PULSES]; 4],
    pair: [u32; PULSES],
    by_compare: [[u32; PULSES]; 2],
    lateness: u32,
    horizon: u32,
    queues: u32,
}

/// The number of pulse lengths that were measured.
const PULSES: usize = 4;

static UNO: Rates = Rates {
    pulses: uno::PULSES,
    by_software: uno::BY_SOFTWARE,
    pair: uno::PAIR,
    by_compare: uno::BY_COMPARE,
    lateness: uno::LATENESS,
    horizon: uno::HORIZON,
    queues: uno::QUEUES,
};

/// Why a pin cannot drive a motor.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PinError {
    /// The board has no such pin.
    #[error("the board `{board}` has no pin {pin}: its pins are {first} to {last}")]
    None {
        /// Board.
        board: String,
        /// The pin in the motion file.
        pin: String,
        /// Lowest pin number.
        first: u8,
        /// Highest pin number.
        last: u8,
    },
    /// The pin is taken.
    #[error("pin {pin} of the board `{board}` is taken: {why}")]
    Reserved {
        /// Board.
        board: String,
        /// Pin number.
        pin: u8,
        /// What uses it.
        why: &'static str,
    },
}

impl BoardRow {
    /// The pin of that number.
    ///
    /// # Errors
    /// [`PinError`] if the board has no such pin, or needs it itself.
    pub fn pin(&self, number: i64) -> Result<u8, PinError> {
        let Some(pin) = u8::try_from(number).ok().filter(|pin| self.pins.contains(pin)) else {
            return Err(self.no_pin(number.to_string()));
        };
        match self.reserved.iter().find(|(range, _)| range.contains(&pin)) {
            Some((_, why)) => Err(PinError::Reserved { board: self.board.name.clone(), pin, why }),
            None => Ok(pin),
        }
    }

    /// The pin of that name: `D8`, `A0`, `GP15` or `GPIO15`, whatever its case.
    ///
    /// # Errors
    /// [`PinError`] if the board has no such pin, or needs it itself.
    pub fn pin_named(&self, name: &str) -> Result<u8, PinError> {
        let lower = name.trim().to_ascii_lowercase();
        let number = |prefix: &str| lower.strip_prefix(prefix).and_then(|digits| digits.parse::<u8>().ok());
        let pin = match self.analogue {
            Some((first, count)) => number("a").filter(|n| *n < count).map(|n| first + n).or_else(|| number("d")),
            None => number("gpio").or_else(|| number("gp")),
        };
        self.pin(i64::from(pin.or_else(|| number("")).ok_or_else(|| self.no_pin(name.to_owned()))?))
    }

    /// The kind of the pins of these motors; `None` on boards whose pins are equivalent.
    ///
    /// # Errors
    /// [`PinsError`] if the board cannot drive them together.
    pub fn pin_kind(&self, motors: &[Motor]) -> Result<Option<PinKind>, PinsError> {
        match self.pin_rules {
            PinRules::Alike => Ok(None),
            PinRules::Kinds(_) => PinKind::of(motors).map(Some),
            PinRules::Neighbours => pins::check_pico(motors).map(|()| None),
        }
    }

    /// The shortest intervals with 1, 2, … motors, ticks, for these motors' pins and their longest pulse. They are at least
    /// [`Board::min_interval_ticks`], which is for the shortest pulses, except with the Uno's compare hardware.
    #[must_use]
    pub fn shortest_intervals(&self, motors: &[Motor]) -> Vec<u32> {
        let (PinRules::Kinds(rates), Ok(Some(kind))) = (self.pin_rules, self.pin_kind(motors)) else {
            let is_pico = self.pin_rules == PinRules::Neighbours;
            let word = if is_pico { word_ticks(motors, self.board.tick_hz) } else { 0 };
            let has_coils = is_pico && motors.iter().any(|motor| matches!(motor.wiring, Wiring::Coils { .. }));
            // The processor needs more time for coils. With drivers there may be more motors than there are pins for coils: then the last
            // figure is used.
            let coils = |count: usize| pico::COILS.get(count).or(pico::COILS.last()).map_or(0, |ticks| *ticks);
            let of = |(count, ticks): (usize, &u32)| word.max(*ticks).max(if has_coils { coils(count) } else { 0 });
            return self.board.min_interval_ticks.iter().enumerate().map(of).collect();
        };
        let hz = self.board.tick_hz;
        let timing = DriverTiming::longest(motors).ticks(hz);
        let pulse = timing.pulse_high;
        let shares = shares_dir(motors);
        let is_pair = |count: usize| count == 2 && motors.len() == 2 && kind == PinKind::PortD;
        let of = |(count, by_pulse): (usize, &[u32; PULSES])| {
            let by_pulse = if is_pair(count) && !shares { &rates.pair } else { by_pulse };
            let long = LongPulse::of(kind, count, is_pair(count));
            let own = if pulse > long.longest_together() {
                by_pulse[PULSES - 1]
            } else {
                // A pulse between two measured lengths counts as the longer one.
                let column = rates.pulses[..PULSES - 2].iter().position(|longest| pulse <= u64::from(*longest));
                by_pulse[column.unwrap_or(PULSES - 2)]
            };
            // Motors that share a DIR line step one after the other.
            let shared = if shares { SHARED_STEP_TICKS * count as u32 } else { 0 };
            let edges = long.shortest_interval(pulse, timing.pulse_low);
            own.max(shared).max(edges)
        };
        let by_count = if kind == PinKind::Compare { &rates.by_compare[..] } else { &rates.by_software[..] };
        (1..).zip(by_count).map(of).collect()
    }

    /// The longest pulse with which an Uno works out several steps of these motors at once, ns; `None` if their pulses are not longer. With
    /// longer pulses the Uno works out one step at a time, and its rate is several times lower.
    #[must_use]
    pub fn longest_pulse_together(&self, motors: &[Motor]) -> Option<u32> {
        let (PinRules::Kinds(_), Ok(Some(kind))) = (self.pin_rules, self.pin_kind(motors)) else { return None };
        let hz = self.board.tick_hz;
        let is_pair = motors.len() == 2 && kind == PinKind::PortD;
        let longest = LongPulse::of(kind, motors.len(), is_pair).longest_together();
        let is_longer = DriverTiming::longest(motors).ticks(hz).pulse_high > longest;
        (is_longer && !shares_dir(motors)).then(|| u32::try_from(longest * 1_000_000_000 / hz).unwrap_or(u32::MAX))
    }

    /// The shortest interval of each of four motors on an Uno that plays a motion from its flash, ticks. That image has no second ring for the
    /// fourth motor, so that all four are merged, as with longer pulses.
    #[must_use]
    pub const fn shortest_of_four_baked(&self) -> Option<u32> {
        match self.pin_rules {
            PinRules::Kinds(rates) => Some(rates.by_software[3][1]),
            _ => None,
        }
    }

    /// [`Board::turn_ticks`] for these motors' pins.
    #[must_use]
    pub fn turn_ticks(&self, motors: &[Motor]) -> u32 {
        if self.pin_rules == PinRules::Neighbours {
            return word_turn_ticks(motors, self.board.tick_hz);
        }
        match self.pin_kind(motors) {
            Ok(Some(PinKind::PortD | PinKind::PortB | PinKind::Shield)) if motors.len() > 1 && !shares_dir(motors) => {
                TURN_TICKS[1]
            }
            Ok(Some(PinKind::Compare)) => TURN_TICKS_BY_COMPARE[usize::from(motors.len() > 1)],
            _ => self.board.turn_ticks,
        }
    }

    /// [`Board::shared_steps`] for these motors. An Uno makes steps one after the other if motors share a DIR line. But a pulse up to
    /// 1.94 µs is over so soon that no step has to wait for it.
    #[must_use]
    pub fn shared_steps(&self, motors: &[Motor]) -> Option<SharedSteps> {
        let pulse = DriverTiming::longest(motors).ticks(self.board.tick_hz).pulse_high;
        if !matches!(self.pin_rules, PinRules::Kinds(_)) || !shares_dir(motors) || pulse <= u64::from(MAX_PULSE) {
            return None;
        }
        let apart_ticks = u64::from(LATENCY + SPACING_SHIELD[0]) + pulse;
        Some(SharedSteps { together_ticks: SPACING / 2, apart_ticks: u32::try_from(apart_ticks).unwrap_or(u32::MAX) })
    }

    fn no_pin(&self, pin: String) -> PinError {
        PinError::None { board: self.board.name.clone(), pin, first: *self.pins.start(), last: *self.pins.end() }
    }
}

/// The table, the most common board first.
#[must_use]
pub fn table() -> Vec<BoardRow> {
    vec![uno(), due(), pico(), native()]
}

/// The board of that name, whatever its case.
#[must_use]
pub fn find(name: &str) -> Option<BoardRow> {
    table().into_iter().find(|row| row.board.name.eq_ignore_ascii_case(name))
}

/// The time that a turn of DIR takes an Uno, ticks: alone, and where motors are merged in one ring. `PulseTiming::of` in
/// firmware/uno/src/engine/steps/stepper/timing.rs adds it up: an edge may be late before the turn and after it, the way to the line after the
/// match takes time, and a merge moves edges by up to two spacings.
const TURN_TICKS: [u32; 2] =
    [LATENCY + SPACING + LATENCY, LATENCY_MERGED + END_DELAY + LATENCY_MERGED + 2 * SPACING_SHIELD[1]];
/// The same for one and for two motors of the compare hardware: the spacing of groups, before the turn and after it.
const TURN_TICKS_BY_COMPARE: [u32; 2] = [2 * SPACING_TWO_RINGS, 2 * SPACING_TWO_COMPARE];

/// The shortest word of a Pico's state machine, ticks: the longest pulse of all motors and three cycles (`pulsetrain_core::pio`). Steps are
/// never closer than that, and a change of DIR is a word of its own.
fn word_ticks(motors: &[Motor], hz: u64) -> u32 {
    let pulse = DriverTiming::longest(motors).ticks(hz).pulse_high;
    u32::try_from(pulse.max(3) + 3).unwrap_or(u32::MAX)
}

/// Time that a turn takes a Pico in addition to pulse, hold and set-up, ticks: the word that changes DIR begins when
/// the word of the step before it is over, and ends before the word of the step after it.
fn word_turn_ticks(motors: &[Motor], hz: u64) -> u32 {
    let word = u64::from(word_ticks(motors, hz));
    let timing = DriverTiming::longest(motors).ticks(hz);
    let turn = word.max(timing.pulse_high + timing.dir_hold) + word.max(timing.dir_setup);
    u32::try_from(turn - timing.reversal()).unwrap_or(u32::MAX)
}

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

/// Ticks between steps at a rate, rounded up: the shortest interval that the rate allows.
fn interval_ticks(tick_hz: u64, rate_hz: u64) -> u32 {
    u32::try_from(tick_hz.div_ceil(rate_hz)).expect("an interval of a rate above 1 Hz fits 32 bits")
}

/// The new name of a board that has been renamed.
#[must_use]
pub fn renamed(name: &str) -> Option<&'static str> {
    name.eq_ignore_ascii_case("uno-stream").then_some("uno")
}

fn uno() -> BoardRow {
    const TICK_HZ: u64 = 16_000_000;
    let rates = &UNO;
    BoardRow {
        board: Board {
            name: "uno".to_owned(),
            tick_hz: TICK_HZ,
            fraction_bits: 16,
            max_motors: 4,
            // With pulses of 1 µs. `shortest_intervals` has those of longer pulses.
            min_interval_ticks: rates.by_software.iter().map(|by_pulse| by_pulse[0]).collect(),
            hardware_timed: false,
            one_timing: true,
            turn_ticks: TURN_TICKS[0],
            shared_steps: None,
            segment_ticks: Vec::new(),
            source: "its firmware on an emulated ATmega328P: cargo xtask bench uno".to_owned(),
        },
        about: "Arduino Uno, ATmega328P",
        ram_bytes: Some(2_048),
        flash_bytes: Some(32_256),
        // One motor alone also has the memory of the second ring. A test asks the virtual board.
        queue_bytes: vec![rates.queues + 256, rates.queues / 2, rates.queues / 3, rates.queues / 4],
        horizon_ticks: rates.horizon,
        lateness_ticks: rates.lateness,
        // Fitted to motions that ran without these limits. At 1 000 000 baud: 1000 of `cargo xtask accept --board uno --seed 20`, and 1541 of sinusoids, in
        // phase and not, of one to four motors at 5 to 60 Hz. At 115 200 baud: 500 of seed 8, and four of seed 62 that starved with a shorter delay. The queue of
        // every motion that was stopped for lack of plan lasted less than this; so did the queues of three in a thousand random motions that ran.
        line: Some(LineRow {
            delay_us: 700,
            delay_byte_us: 100,
            delay_bytes: 290,
            other_bytes_per_s: 2_300,
            frame_share: 1.33,
            usb_bytes_per_s: None,
        }),
        note: "one or two motors with STEP on pins 9 and 10 are timed by the compare hardware: no lateness",
        pins: 0..=19,
        reserved: &[(0..=1, "D0 and D1 are the serial line to the computer")],
        analogue: Some((14, 6)),
        pin_rules: PinRules::Kinds(rates),
    }
}

fn due() -> BoardRow {
    const TICK_HZ: u64 = 42_000_000;
    // Klipper's published benchmark of the same chip: 1 273 k steps/s with one motor, 981 k in all with three.
    const RATES_HZ: [u64; 8] = [1_273_000, 490_000, 327_000, 245_000, 196_000, 163_000, 140_000, 122_000];
    BoardRow {
        board: Board {
            name: "due".to_owned(),
            tick_hz: TICK_HZ,
            fraction_bits: 32,
            max_motors: 8,
            min_interval_ticks: RATES_HZ.iter().map(|&rate| interval_ticks(TICK_HZ, rate)).collect(),
            hardware_timed: false,
            one_timing: false,
            turn_ticks: 0,
            shared_steps: None,
            segment_ticks: Vec::new(),
            source: "estimate: rates of Klipper on the same chip, as published".to_owned(),
        },
        about: "Arduino Due, SAM3X8E",
        ram_bytes: Some(98_304),
        flash_bytes: Some(524_288),
        queue_bytes: (1..=8).map(|motors| 65_536 / motors).collect(),
        horizon_ticks: 42_000,
        lateness_ticks: 84,
        line: None,
        note: "3.3 V outputs: drivers with 5 V inputs may need a level shifter",
        pins: 0..=53,
        reserved: &[(0..=1, "D0 and D1 are the serial line to the computer")],
        analogue: Some((54, 0)),
        pin_rules: PinRules::Alike,
    }
}

fn pico() -> BoardRow {
    const TICK_HZ: u64 = 125_000_000;
    BoardRow {
        board: Board {
            name: "pico".to_owned(),
            tick_hz: TICK_HZ,
            fraction_bits: 32,
            max_motors: 8,
            // The processor's limits. `shortest_intervals` adds that of the pulse and three ticks.
            min_interval_ticks: pico::SHORTEST.to_vec(),
            hardware_timed: true,
            one_timing: true,
            turn_ticks: 0,
            shared_steps: None,
            segment_ticks: pico::ONWARD
                .into_iter()
                .zip(pico::TURNING)
                .zip(pico::HEARD)
                .map(|((onward, turning), heard)| SegmentTicks { onward, turning, heard })
                .collect(),
            source: "its firmware on an emulated RP2040: cargo xtask bench pico".to_owned(),
        },
        about: "Raspberry Pi Pico, RP2040",
        ram_bytes: Some(264 * 1024),
        flash_bytes: Some(2 * 1024 * 1024),
        // The shares that firmware/pico makes. A test asks the virtual board.
        queue_bytes: (1..=8).map(|motors| (32_768 / motors).min(8_192)).collect(),
        // 2.4 ms; with the longest pulses and set-up, by which a word and a DIR edge begin before their tick, 0.5 ms more for each.
        // A test asks the virtual board.
        horizon_ticks: 300_000 + 2 * 62_503,
        lateness_ticks: 0,
        // A guess: no random motion was short of plan on a Pico. The processor's limit comes first.
        line: Some(LineRow {
            delay_us: 15_000,
            delay_byte_us: 0,
            delay_bytes: 130,
            other_bytes_per_s: 1_500,
            frame_share: 1.2,
            // Measured on the virtual Pico's USB: 207 kB/s of plans, of one motor that turns 6000 times a second. USB at full speed takes up to
            // 19 packets of 64 bytes in a millisecond (USB 2.0, table 5-9), but a session has at most 960 bytes on their way.
            usb_bytes_per_s: Some(250_000),
        }),
        note: "edges come from PIO state machines fed by DMA: exact to the tick. STEP and DIR of a motor are neighbours, and so \
               are IN1 to IN4 of a ULN2003 (GP26 is next to GP22); 3.3 V outputs",
        pins: 0..=28,
        reserved: &[
            (0..=1, "GPIO 0 and 1 are the serial line"),
            (23..=25, "GPIO 23 to 25 run the Pico's own supply and LED and are not on its header"),
        ],
        analogue: None,
        pin_rules: PinRules::Neighbours,
    }
}

fn native() -> BoardRow {
    BoardRow {
        board: Board {
            name: "native".to_owned(),
            tick_hz: 125_000_000,
            fraction_bits: 32,
            max_motors: 8,
            min_interval_ticks: vec![50],
            hardware_timed: true,
            one_timing: false,
            turn_ticks: 0,
            shared_steps: None,
            segment_ticks: Vec::new(),
            source: "by definition: a board in virtual time".to_owned(),
        },
        about: "this computer, in virtual time: the same stepgen as the firmware's",
        ram_bytes: None,
        flash_bytes: None,
        queue_bytes: Vec::new(),
        horizon_ticks: 0,
        lateness_ticks: 0,
        line: None,
        note: "runs any motion without hardware; pins are names only",
        pins: 0..=31,
        reserved: &[],
        analogue: None,
        pin_rules: PinRules::Alike,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shortest_intervals_are_those_of_the_rates() {
        assert_eq!(find("due").unwrap().board.min_interval_ticks, [33, 86, 129, 172, 215, 258, 300, 345]);
        // Issue 5's 625 k steps/s on each of eight motors.
        assert!(find("pico").unwrap().board.min_interval_ticks[7] <= 200);
        // The tutorial at T = 0.1 s: A·ω = 2000·2π/0.1 = 125 664 steps/s passes on pin 9; at 0.01 s it does not.
        let peak_hz = |period: f64| 2000.0 * std::f64::consts::TAU / period;
        let limit_hz = |ticks: u32| 16e6 / f64::from(ticks);
        let by_compare = limit_hz(uno::BY_COMPARE[0][0]);
        assert!(peak_hz(0.1) < by_compare && by_compare < peak_hz(0.01), "{by_compare}");
    }

    #[test]
    fn motors_and_longer_pulses_take_time() {
        let row = find("Uno").unwrap();
        // Not the last column: one step at a time takes a ring longer than a merge's lists.
        for column in 0..PULSES - 1 {
            assert!(uno::BY_SOFTWARE.is_sorted_by_key(|by_pulse| by_pulse[column]));
            assert!(uno::BY_COMPARE.is_sorted_by_key(|by_pulse| by_pulse[column]));
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
        let check = |step, pulse_ns, expected: &[[u32; PULSES]], column: usize| {
            let expected: Vec<u32> = expected.iter().map(|by_pulse| by_pulse[column]).collect();
            assert_eq!(row.shortest_intervals(&[motor(step, pulse_ns)]), expected, "{step}, {pulse_ns} ns");
        };
        check(11, 1000, &uno::BY_SOFTWARE, 0);
        check(11, 1900, &uno::BY_SOFTWARE, 1);
        check(11, 5000, &uno::BY_SOFTWARE, 2);
        check(11, 16_000, &uno::BY_SOFTWARE, 3);
        check(9, 1000, &uno::BY_COMPARE, 0);
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
        assert_eq!([pair([2, 3], 1000), pair([2, 3], 5000)], [uno::PAIR[0], uno::PAIR[2]]);
        assert_eq!(pair([8, 9], 1000), uno::BY_SOFTWARE[1][0]);
        assert!(uno::PAIR[0] < uno::BY_SOFTWARE[1][0] && uno::PAIR[0] < uno::PAIR[2]);
        // The longest pulse with which steps are worked out together is that of the pins; behind it there is room for the edges.
        let one = |pulse_ns| row.shortest_intervals(&[motor(11, pulse_ns)])[0];
        assert_eq!([one(14_437), one(14_438)], [311, uno::BY_SOFTWARE[0][3]]);
        assert_eq!([pair([2, 3], 12_187), pair([2, 3], 12_188)], [uno::PAIR[2], uno::PAIR[3]]);
        assert_eq!([pair([8, 9], 9187), pair([8, 9], 9188)], [uno::BY_SOFTWARE[1][2], uno::BY_SOFTWARE[1][3]]);
        assert_eq!(row.longest_pulse_together(&[motor(11, 14_437)]), None);
        assert_eq!(row.longest_pulse_together(&[motor(11, 50_000)]), Some(14_437));
        // Such a pulse may be longer than what its steps take.
        assert_eq!(one(200_000), 3200 + 24 + 48 + 82);
    }

    #[test]
    fn what_no_bench_has_printed_is_an_estimate() {
        for row in table() {
            let is_measured = matches!(row.board.name.as_str(), "native" | "uno" | "pico");
            assert_eq!(row.board.source.starts_with("estimate"), !is_measured, "{}", row.board.name);
            assert!(row.board.min_interval_ticks.is_sorted(), "{}", row.board.name);
        }
    }

    #[test]
    fn pins_by_number_and_by_name() {
        let uno = find("uno").unwrap();
        assert_eq!(uno.pin(8), Ok(8));
        assert_eq!(uno.pin_named("A5"), Ok(19));
        assert_eq!(uno.pin_named("d13"), Ok(13));
        assert!(matches!(uno.pin(1), Err(PinError::Reserved { pin: 1, .. })));
        assert!(matches!(uno.pin(20), Err(PinError::None { last: 19, .. })));
        assert!(matches!(uno.pin_named("A6"), Err(PinError::None { .. })));
        assert!(matches!(uno.pin(-1), Err(PinError::None { .. })));
        assert!(matches!(uno.pin(1 << 40), Err(PinError::None { .. })));
        assert_eq!(find("due").unwrap().pin_named("D26"), Ok(26));
        assert_eq!(find("pico").unwrap().pin_named("GP15"), Ok(15));
        assert!(find("pico").unwrap().pin(24).is_err());
    }
}
