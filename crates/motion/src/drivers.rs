//! What drivers need, from their datasheets: pulse widths, DIR times, microsteps and how they are set.

use crate::program::{CoilSequence, DriverTiming};

/// One row of the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Driver {
    /// As motion files name it; case does not matter there.
    pub name: &'static str,
    /// Other names, in small letters and digits alone: those of its boards, and of what they are sold with.
    pub also: &'static [&'static str],
    /// What it is, in a line.
    pub about: &'static str,
    /// How it is driven.
    pub input: Input,
    /// Steps in a full step that it can make, ascending, each with how to set it.
    pub microsteps: &'static [Microsteps],
    /// Highest supply voltage of the motor, V.
    pub max_voltage_v: f64,
    /// Highest phase current, A: what the datasheet allows, which may need cooling.
    pub max_current_a: f64,
    /// Document, revision, section.
    pub source: &'static str,
}

/// How a driver is driven.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// STEP and DIR lines.
    StepDir(DriverTiming),
    /// Four coil lines.
    Coils,
}

/// One microstep setting.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Microsteps {
    /// Steps in a full step.
    pub count: u32,
    /// Pins or switches that choose it.
    pub setting: &'static str,
}

impl Driver {
    /// What the STEP and DIR lines need; zeros for coils.
    #[must_use]
    pub fn timing(&self) -> DriverTiming {
        match self.input {
            Input::StepDir(timing) => timing,
            Input::Coils => DriverTiming::default(),
        }
    }

    /// The setting for `count` steps in a full step, if the driver has it.
    #[must_use]
    pub fn setting(&self, count: u32) -> Option<&'static str> {
        self.microsteps.iter().find(|m| m.count == count).map(|m| m.setting)
    }

    /// How coils are switched to make `count` steps of a full step; `None` for step/dir drivers and other counts.
    #[must_use]
    pub fn coil_sequence(&self, count: u32) -> Option<CoilSequence> {
        match (self.input, count) {
            (Input::Coils, 1) => Some(CoilSequence::Full),
            (Input::Coils, 2) => Some(CoilSequence::Half),
            _ => None,
        }
    }
}

/// The driver of that name, as [`named`] finds it; `None` if it names several.
#[must_use]
pub fn find(name: &str) -> Option<&'static Driver> {
    match named(name)[..] {
        [driver] => Some(driver),
        _ => None,
    }
}

/// The drivers that `name` names: in any case, by the name of the board that they are on, and with words around it
/// that shops add.
///
/// ```
/// use pulsetrain_motion::drivers::named;
/// let names = |text: &str| named(text).iter().map(|driver| driver.name).collect::<Vec<_>>();
/// assert_eq!(names("EasyDriver"), ["A3967"]);
/// assert_eq!(names("drv8825 module"), ["DRV8825"]);
/// assert_eq!(names("TMC2208/2209"), ["TMC2208", "TMC2209"]);
/// assert!(names("DRV8834").is_empty());
/// ```
#[must_use]
pub fn named(name: &str) -> Vec<&'static Driver> {
    /// Words that name no driver.
    const NOISE: &[&str] = &[
        "driver",
        "drivers",
        "module",
        "board",
        "breakout",
        "carrier",
        "stepper",
        "motor",
        "clone",
        "v",
        "version",
        "rev",
        "pololu",
        "sparkfun",
        "adafruit",
        "bigtreetech",
        "btt",
        "fysetc",
        "watterott",
        "wantai",
        "allegro",
        "ti",
        "trinamic",
        "toshiba",
        "stealth",
        "stealthchop",
        "standalone",
        "silent",
        "silentstepstick",
        "red",
        "green",
        "purple",
        "blue",
        "black",
        "with",
        "and",
    ];
    let lower = name.to_lowercase();
    let words = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    let is_noise = |word: &str| {
        let version = word.strip_prefix('v').unwrap_or(word);
        NOISE.contains(&word) || version.len() < 2 && version.chars().all(|c| c.is_ascii_digit())
    };
    let mut rest: String = words.filter(|word| !is_noise(word)).collect();
    let mut found: Vec<&Driver> = Vec::new();
    while !rest.is_empty() {
        // The longest name wins: bigeasy is no easy.
        let begins = |row: &'static Driver| {
            let own = row.name.to_lowercase();
            let names = row.also.iter().copied().chain([own.as_str()]);
            let longest = names.filter(|name| rest.starts_with(name)).map(str::len).max()?;
            Some((longest, row))
        };
        let Some((length, driver)) = TABLE.iter().filter_map(begins).max_by_key(|(length, _)| *length) else {
            return Vec::new();
        };
        rest.drain(..length);
        if !found.contains(&driver) {
            found.push(driver);
        }
    }
    found
}

/// The one of several that may stand for all: they set that many microsteps alike, and its times do for all of them.
#[must_use]
pub fn only_one(found: &[&'static Driver], microsteps: u32) -> Option<&'static Driver> {
    let (first, others) = found.split_first()?;
    let is_same = |other: &&Driver| {
        std::mem::discriminant(&other.input) == std::mem::discriminant(&first.input)
            && other.setting(microsteps) == first.setting(microsteps)
    };
    let sets_it = others.is_empty() || first.setting(microsteps).is_some();
    // Of two, the one that needs the longer pulses, then the one with the lower current.
    let pulse_ns = |driver: &Driver| match driver.input {
        Input::StepDir(timing) => timing.pulse_high_ns.max(timing.pulse_low_ns),
        Input::Coils => 0,
    };
    let least = || {
        let before =
            |a: &&Driver, b: &&Driver| pulse_ns(b).cmp(&pulse_ns(a)).then(a.max_current_a.total_cmp(&b.max_current_a));
        found.iter().copied().min_by(before)
    };
    let does_for_all = |driver: &&Driver| {
        let own = driver.timing();
        found.iter().map(|other| other.timing()).all(|other| {
            own.pulse_high_ns >= other.pulse_high_ns
                && own.pulse_low_ns >= other.pulse_low_ns
                && own.dir_setup_ns >= other.dir_setup_ns
                && own.dir_hold_ns >= other.dir_hold_ns
        })
    };
    (sets_it && others.iter().all(is_same)).then(least).flatten().filter(does_for_all)
}

/// The table, in alphabetical order.
#[must_use]
pub fn table() -> &'static [Driver] {
    TABLE
}

const fn timing(high_ns: u32, low_ns: u32, setup_ns: u32, hold_ns: u32) -> Input {
    Input::StepDir(DriverTiming {
        pulse_high_ns: high_ns,
        pulse_low_ns: low_ns,
        dir_setup_ns: setup_ns,
        dir_hold_ns: hold_ns,
    })
}

const fn set(count: u32, setting: &'static str) -> Microsteps {
    Microsteps { count, setting }
}

const TABLE: &[Driver] = &[
    Driver {
        name: "A3967",
        also: &["easydriver", "easy", "sparkfuneasydriver", "a3967slb"],
        about: "EasyDriver",
        input: timing(1_000, 1_000, 200, 200),
        microsteps: &[
            set(1, "MS1 = L, MS2 = L"),
            set(2, "MS1 = H, MS2 = L"),
            set(4, "MS1 = L, MS2 = H"),
            set(8, "MS1 = H, MS2 = H (as delivered)"),
        ],
        max_voltage_v: 30.0,
        max_current_a: 0.75,
        source: "Allegro A3967SLB datasheet 26184.24B, timing requirements A, B, C, D; Table 1",
    },
    Driver {
        name: "A4988",
        also: &["a4983", "bigeasydriver", "bigeasy", "stepstick", "a4988set"],
        about: "Pololu-style carrier, CNC shield, StepStick, Big Easy Driver",
        input: timing(1_000, 1_000, 200, 200),
        microsteps: &[
            set(1, "MS1 = L, MS2 = L, MS3 = L"),
            set(2, "MS1 = H, MS2 = L, MS3 = L"),
            set(4, "MS1 = L, MS2 = H, MS3 = L"),
            set(8, "MS1 = H, MS2 = H, MS3 = L"),
            set(16, "MS1 = H, MS2 = H, MS3 = H"),
        ],
        max_voltage_v: 35.0,
        max_current_a: 2.0,
        source: "Allegro A4988 datasheet rev. 5, figure 1 (tA, tB, tC, tD); table 1",
    },
    Driver {
        name: "DQ542MA",
        also: &["dq542"],
        about: "Wantai industrial driver, the tutorial's",
        input: timing(5_050, 5_050, 500, 500),
        // 400 to 25 600 steps per revolution of a 200-step motor.
        microsteps: &[
            set(2, "400 pulse/rev: SW5 off, SW6 on, SW7 on, SW8 on"),
            set(4, "800 pulse/rev: SW5 on, SW6 off, SW7 on, SW8 on"),
            set(5, "1000 pulse/rev: SW5 on, SW6 on, SW7 on, SW8 off"),
            set(8, "1600 pulse/rev: SW5 off, SW6 off, SW7 on, SW8 on"),
            set(10, "2000 pulse/rev: SW5 off, SW6 on, SW7 on, SW8 off"),
            set(16, "3200 pulse/rev: SW5 on, SW6 on, SW7 off, SW8 on"),
            set(20, "4000 pulse/rev: SW5 on, SW6 off, SW7 on, SW8 off"),
            set(25, "5000 pulse/rev: SW5 off, SW6 off, SW7 on, SW8 off"),
            set(32, "6400 pulse/rev: SW5 off, SW6 on, SW7 off, SW8 on"),
            set(40, "8000 pulse/rev: SW5 on, SW6 on, SW7 off, SW8 off"),
            set(50, "10000 pulse/rev: SW5 off, SW6 on, SW7 off, SW8 off"),
            set(64, "12800 pulse/rev: SW5 on, SW6 off, SW7 off, SW8 on"),
            set(100, "20000 pulse/rev: SW5 on, SW6 off, SW7 off, SW8 off"),
            set(125, "25000 pulse/rev: SW5 off, SW6 off, SW7 off, SW8 off"),
            set(128, "25600 pulse/rev: SW5 off, SW6 off, SW7 off, SW8 on"),
        ],
        max_voltage_v: 50.0,
        max_current_a: 4.2,
        source: "times: as the LinuxCNC wiki quotes them, Stepper Drive Timing, row DQ542MA; switches: the common 542 \
                 table; check both against the case; 400-25 600 steps/rev: the tutorial",
    },
    Driver {
        name: "DRV8825",
        also: &["drv8825pwp"],
        about: "Pololu-style carrier",
        input: timing(1_900, 1_900, 650, 650),
        microsteps: &[
            set(1, "MODE0 = L, MODE1 = L, MODE2 = L"),
            set(2, "MODE0 = H, MODE1 = L, MODE2 = L"),
            set(4, "MODE0 = L, MODE1 = H, MODE2 = L"),
            set(8, "MODE0 = H, MODE1 = H, MODE2 = L"),
            set(16, "MODE0 = L, MODE1 = L, MODE2 = H"),
            set(32, "MODE0 = H, MODE1 = L, MODE2 = H"),
        ],
        max_voltage_v: 45.0,
        max_current_a: 2.5,
        source: "TI DRV8825 datasheet SLVSA73F, 6.6 timing requirements; table 1",
    },
    Driver {
        name: "TB6600",
        also: &["tb6600hg"],
        about: "boards with Toshiba's TB6600HG behind optocouplers",
        input: timing(10_000, 10_000, 5_000, 5_000),
        microsteps: &[
            set(1, "S1 on, S2 on, S3 off"),
            set(2, "S1 on, S2 off, S3 on (type A) or S1 off, S2 on, S3 on (type B)"),
            set(4, "S1 on, S2 off, S3 off"),
            set(8, "S1 off, S2 on, S3 off"),
            set(16, "S1 off, S2 off, S3 on"),
            set(32, "S1 off, S2 off, S3 off"),
        ],
        max_voltage_v: 42.0,
        max_current_a: 4.0,
        source: "limits and switches: DFRobot TB6600 user guide V1.2 (DRI0043); times: the chip alone takes 200 kHz \
                 (TB6600HG, 2016-06-10), but the optocouplers differ from board to board, hence 10 us; some want 30 us",
    },
    Driver {
        name: "TMC2208",
        also: &["2208"],
        about: "SilentStepStick, stand-alone (no UART)",
        input: timing(110, 110, 20, 20),
        microsteps: &[
            set(2, "MS1 = H, MS2 = L"),
            set(4, "MS1 = L, MS2 = H"),
            set(8, "MS1 = L, MS2 = L"),
            set(16, "MS1 = H, MS2 = H"),
        ],
        max_voltage_v: 36.0,
        max_current_a: 1.2,
        source: "STEP/DIR table of the TMC family, as in Trinamic TMC5160 datasheet rev. 1.14, section 15.1, and TMC2100, section 11.1: tSH and tSL \
                 are a clock period and 20 ns at least, 107 ns at the internal clock's lowest 11.5 MHz, hence 110 ns; tDSU and tDSH are 20 ns; \
                 TMC2202/TMC2208/TMC2224 datasheet rev. 1.13, table of MS1 and MS2",
    },
    Driver {
        name: "TMC2209",
        also: &["2209"],
        about: "SilentStepStick, stand-alone (no UART)",
        input: timing(100, 100, 20, 20),
        microsteps: &[
            set(8, "MS1 = L, MS2 = L"),
            set(16, "MS1 = H, MS2 = H"),
            set(32, "MS1 = H, MS2 = L"),
            set(64, "MS1 = L, MS2 = H"),
        ],
        max_voltage_v: 28.0,
        max_current_a: 2.0,
        source: "Trinamic TMC2209 datasheet rev. 1.03, section 13.1 (tSH, tSL, tDSU, tDSH); table of MS1 and MS2",
    },
    Driver {
        name: "ULN2003",
        also: &["uln2003a", "uln2003an", "uln2003apg", "28byj48", "28byj"],
        about: "Darlington array on four coil lines, with the 28BYJ-48",
        input: Input::Coils,
        microsteps: &[set(1, "two coils at a time (full steps)"), set(2, "one and two coils in turn (half steps)")],
        max_voltage_v: 50.0,
        max_current_a: 0.5,
        source: "TI ULN2003A datasheet SLRS027, absolute maximum ratings; half-step sequence: the Pico plotter",
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(name: &str, expected: &[&str]) {
        let found: Vec<&str> = named(name).iter().map(|driver| driver.name).collect();
        assert_eq!(found, expected, "{name}");
    }

    #[test]
    fn names_as_shops_write_them_are_known() {
        for driver in TABLE {
            for name in driver.also.iter().copied().chain([driver.name]) {
                check(name, &[driver.name]);
                check(&name.to_uppercase(), &[driver.name]);
                check(&format!("{name} module v2"), &[driver.name]);
            }
        }
        check("EasyDriver", &["A3967"]);
        check("Easy Driver v4.4", &["A3967"]);
        check("SparkFun EasyDriver (A3967)", &["A3967"]);
        check("Big Easy Driver", &["A4988"]);
        check("Pololu A4988 carrier", &["A4988"]);
        check("DRV8825 module", &["DRV8825"]);
        check("drv-8825", &["DRV8825"]);
        check("TMC2209 V1.3 SilentStepStick", &["TMC2209"]);
        check("TMC2208/2209 stealth", &["TMC2208", "TMC2209"]);
        check("28BYJ-48/ULN2003", &["ULN2003"]);
        check("ULN2003 driver board", &["ULN2003"]);
        for unknown in ["", "driver", "A4988x", "DM542", "TMC5160", "4988"] {
            check(unknown, &[]);
        }
    }

    #[test]
    fn two_that_are_set_alike_are_one() {
        let both = named("TMC2208/2209");
        let name = |microsteps| only_one(&both, microsteps).map(|driver| driver.name);
        assert_eq!([8, 16].map(name), [Some("TMC2208"); 2]);
        assert_eq!([1, 2, 4, 32, 64].map(name), [None; 5]);
        assert_eq!(only_one(&named("A4988"), 3).map(|driver| driver.name), Some("A4988"));
    }

    #[test]
    fn rows_are_in_order_and_sound() {
        assert!(TABLE.is_sorted_by_key(|row| row.name));
        for row in TABLE {
            assert!(row.microsteps.is_sorted_by(|a, b| a.count < b.count), "{}", row.name);
            assert!(!row.source.is_empty() && row.max_voltage_v > 0.0 && row.max_current_a > 0.0);
            if let Input::StepDir(timing) = row.input {
                assert!(timing.pulse_high_ns > 0 && timing.pulse_low_ns > 0);
            }
        }
    }

    #[test]
    fn the_easydriver_as_seed_004_has_it() {
        let driver = find("a3967").unwrap();
        assert_eq!(driver.setting(1), Some("MS1 = L, MS2 = L"));
        assert_eq!(driver.setting(2), Some("MS1 = H, MS2 = L"));
        assert_eq!(driver.setting(4), Some("MS1 = L, MS2 = H"));
        assert_eq!(driver.timing().pulse_high_ns, 1_000);
        assert_eq!(driver.setting(16), None);
    }

    #[test]
    fn the_tutorials_driver_spans_400_to_25600_steps_per_rev() {
        let counts: Vec<u32> = find("DQ542MA").unwrap().microsteps.iter().map(|m| m.count * 200).collect();
        assert_eq!((counts.first(), counts.last()), (Some(&400), Some(&25_600)));
        // Four switches: no two settings alike.
        let mut settings: Vec<&str> = find("DQ542MA")
            .unwrap()
            .microsteps
            .iter()
            .filter_map(|m| m.setting.split_once(": "))
            .map(|s| s.1)
            .collect();
        settings.sort_unstable();
        settings.dedup();
        assert_eq!(settings.len(), 15);
    }

    #[test]
    fn only_coil_drivers_have_sequences() {
        let uln = find("ULN2003").unwrap();
        assert_eq!(uln.coil_sequence(1), Some(CoilSequence::Full));
        assert_eq!(uln.coil_sequence(2), Some(CoilSequence::Half));
        assert_eq!(uln.coil_sequence(4), None);
        assert_eq!(find("A4988").unwrap().coil_sequence(2), None);
    }
}
