//! `pulsetrain store`: changes and prints the settings that a board keeps without power.

use crate::arguments;
use clap::{ArgGroup, Args};
use miette::miette;
use pulsetrain_board::BoardKind;
use pulsetrain_board::profiles::Role;
use pulsetrain_board::{Port, Remote, RemoteError, Serial};
use pulsetrain_core::wire::settings::{AMAX, MAX_VMAX};
use pulsetrain_core::wire::{Reason, Settings, Stored};
use schemars::JsonSchema;
use serde::Serialize;

use super::problems::{drive_problem, port_problem, virtual_board};
use crate::console::{Console, Exit};
use pulsetrain_motion::human;
use pulsetrain_session::drive::session_number;

/// What a board keeps.
#[derive(Args, Debug)]
#[command(after_help = "\
A setting that you leave out stays as it was. The settings of text axes hold from the board's next start on, `silence` \
from the next run on. A host that sends its own value overrides them.

Examples:
  pulsetrain store --port /dev/ttyACM0
  pulsetrain store --port /dev/ttyACM0 --deadman 500ms --limits 3000 20000
  pulsetrain store --port /dev/ttyACM0 --clear")]
#[command(group = ArgGroup::new("keeper").args(["port", "board"]).required(true))]
pub(crate) struct StoreArgs {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// A virtual board, which forgets the settings when the command ends
    #[arg(long, value_name = "BOARD", value_parser = arguments::board_kind())]
    pub(crate) board: Option<BoardKind>,
    /// Text axes stop after this long without an accepted command, or "off"
    #[arg(long, value_name = "TIME", value_parser = arguments::kept_time)]
    pub(crate) deadman: Option<u16>,
    /// The drivers of text axes are switched off after all axes have rested for this long, or "off"
    #[arg(long, value_name = "TIME", value_parser = arguments::kept_time)]
    pub(crate) idle: Option<u16>,
    /// After this long without a word from the host, the board takes it for lost; "off": 2 s. A host may send its own value
    #[arg(long, value_name = "TIME", value_parser = arguments::kept_time)]
    pub(crate) silence: Option<u16>,
    /// Highest speed, steps/s, and acceleration, steps/s², of text axes after the board's start; 0 0: the board's own
    #[arg(long, value_names = ["SPEED", "ACCELERATION"], num_args = 2, allow_negative_numbers = true)]
    pub(crate) limits: Option<Vec<f64>>,
    /// Clear all settings first
    #[arg(long)]
    pub(crate) clear: bool,
    /// Print the settings as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// A board's stored settings. 0 means the board's default.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, JsonSchema)]
pub(crate) struct Kept {
    /// After so long without a line of text its axes stop, ms.
    deadman_ms: u16,
    /// After so long a rest text releases the motors, ms.
    idle_ms: u16,
    /// After so long without a frame a host is lost, ms.
    silence_ms: u16,
    /// Largest speed of text's axes, steps/s.
    steps_per_s: f64,
    /// Largest acceleration of text's axes, steps/s².
    steps_per_s2: f64,
}

impl Kept {
    pub(super) fn of(settings: Settings) -> Kept {
        let Settings { deadman_ms, idle_ms, silence_ms, vmax, amax } = settings;
        let [steps_per_s, steps_per_s2] = [vmax, amax].map(|thousandths| f64::from(thousandths) / 1000.0);
        Kept { deadman_ms, idle_ms, silence_ms, steps_per_s, steps_per_s2 }
    }

    /// The settings in words.
    fn in_words(&self) -> String {
        let time = |ms: u16| human::seconds(f64::from(ms) / 1000.0);
        let [speed, acceleration] = [self.steps_per_s, self.steps_per_s2].map(figure);
        let limits = format!("axes of text at most {speed} steps/s and {acceleration} steps/s²");
        let parts = [
            (self.deadman_ms != 0).then(|| format!("text's deadman {}", time(self.deadman_ms))),
            (self.idle_ms != 0).then(|| format!("text releases after {} of rest", time(self.idle_ms))),
            (self.silence_ms != 0).then(|| format!("a host is lost after {}", time(self.silence_ms))),
            (self.steps_per_s2 != 0.0).then_some(limits),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        if parts.is_empty() { "nothing that is not its own way".to_owned() } else { parts.join("; ") }
    }
}

/// A speed or an acceleration in the user's digits; whole numbers in groups of three digits.
fn figure(value: f64) -> String {
    if value.fract() == 0.0 { human::count(value as i128) } else { value.to_string() }
}

/// The settings for JSON.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct StoreReport {
    #[serde(flatten)]
    kept: Option<Kept>,
    /// Whether the newest copy is damaged.
    damaged: bool,
}

/// The stored settings in words, and whether they are damaged.
pub(super) fn stored_in_words(kept: Option<&Kept>, is_damaged: bool) -> String {
    match (kept.map_or("nothing".to_owned(), Kept::in_words), is_damaged) {
        (told, false) => told,
        (told, true) => format!("{told} (what was stored last is damaged: store it again)"),
    }
}

pub(crate) fn run(args: &StoreArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let limits = args.limits.as_deref().map(limits).transpose()?;
    let kept = match &args.port {
        Some(name) => store(Serial::open(name, false).map_err(port_problem)?, args, limits),
        None => store(virtual_board(args.board.unwrap_or_default(), Role::Plans)?, args, limits),
    };
    let stored = kept.map_err(problem)?;
    let kept = stored.settings.map(Kept::of);
    if args.json {
        console.print_json(&StoreReport { kept, damaged: stored.is_damaged })?;
        return Ok(Exit::Success);
    }
    console.print(format_args!("the board keeps: {}\n", stored_in_words(kept.as_ref(), stored.is_damaged)))?;
    Ok(Exit::Success)
}

/// The error, with advice.
fn problem(error: RemoteError) -> miette::Report {
    match error {
        RemoteError::Refused { reason: Reason::Moving, .. } => {
            let help = "`pulsetrain stop --port PORT` disarms them; what still moves stops at once, wherever it is";
            miette!(help = help, "the board tells and keeps no settings while motors are armed, as a run leaves them")
        }
        error => drive_problem(error.into()),
    }
}

/// Speed and acceleration of text's axes, in thousandths.
fn limits(values: &[f64]) -> miette::Result<(u32, u32)> {
    let thousandths = |value: f64| (value * 1000.0).round();
    let (vmax, amax) = match values {
        [speed, acceleration] => (thousandths(*speed), thousandths(*acceleration)),
        _ => (0.0, 0.0),
    };
    let possible =
        (0.0..=f64::from(MAX_VMAX)).contains(&vmax) && (f64::from(AMAX[0])..=f64::from(AMAX[1])).contains(&amax);
    if possible || (vmax, amax) == (0.0, 0.0) {
        return Ok((vmax as u32, amax as u32));
    }
    let help = "a board takes up to 10 000 steps/s, and 1 to 250 000 steps/s²; `--limits 0 0` for the board's own";
    let values: Vec<String> = values.iter().map(|value| figure(*value)).collect();
    let limits = values.join(" steps/s and ");
    Err(miette!(help = help, "--limits of {limits} steps/s² are beyond what a board takes"))
}

/// Stores the settings that the user gave, and reads what is stored then.
fn store<P: Port>(port: P, args: &StoreArgs, limits: Option<(u32, u32)>) -> Result<Stored, RemoteError> {
    let mut board = Remote::open(port, session_number())?;
    let kept = settle(&mut board, args, limits);
    // Also after a refusal, so that the next command finds the board free.
    board.close();
    kept
}

fn settle<P: Port>(board: &mut Remote<P>, args: &StoreArgs, limits: Option<(u32, u32)>) -> Result<Stored, RemoteError> {
    let Stored { settings: before, is_damaged } = board.stored()?;
    let mut settings = if args.clear { Settings::default() } else { before.unwrap_or_default() };
    settings.deadman_ms = args.deadman.unwrap_or(settings.deadman_ms);
    settings.idle_ms = args.idle.unwrap_or(settings.idle_ms);
    settings.silence_ms = args.silence.unwrap_or(settings.silence_ms);
    (settings.vmax, settings.amax) = limits.unwrap_or((settings.vmax, settings.amax));
    let says = args.deadman.or(args.idle).or(args.silence).is_some() || limits.is_some();
    // Storing the same values again replaces a damaged copy.
    if args.clear || settings != before.unwrap_or_default() || (says && is_damaged) {
        board.store(&settings)?;
    }
    board.stored()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::Setup;
    use pulsetrain_board::shared::Shared;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_board::virtual_uno::VirtualUno;
    use pulsetrain_core::baked::PROGRAM_FLASH_BYTES;
    use pulsetrain_core::wire::message::MotorSetup;

    const ASK: StoreArgs = StoreArgs {
        port: None,
        board: None,
        deadman: None,
        idle: None,
        silence: None,
        limits: None,
        clear: false,
        json: false,
    };

    #[test]
    fn limits_that_no_board_takes_are_told_as_they_were_said() {
        let refused = limits(&[-5.0, 1e6]).unwrap_err();
        assert_eq!(refused.to_string(), "--limits of −5 steps/s and 1 000 000 steps/s² are beyond what a board takes");
    }

    #[test]
    fn what_is_damaged_is_told() {
        let kept = Kept::of(Settings { deadman_ms: 500, ..Settings::default() });
        assert_eq!(stored_in_words(Some(&kept), false), "text's deadman 500 ms");
        assert_eq!(
            stored_in_words(Some(&kept), true),
            "text's deadman 500 ms (what was stored last is damaged: store it again)"
        );
        let limits = Kept::of(Settings { vmax: 2_500_500, amax: 20_000_000, ..Settings::default() });
        assert_eq!(stored_in_words(Some(&limits), false), "axes of text at most 2500.5 steps/s and 20 000 steps/s²");
        assert_eq!(stored_in_words(None, true), "nothing (what was stored last is damaged: store it again)");
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        /// A run has left a Pico with powered motors: `store` gives advice, and the next host finds the board free.
        #[test]
        fn armed_motors_keep_settings_from_being_told_and_nobody_out() {
            let board = Shared::new(VirtualPico::on_usb());
            let mut host = Remote::open(board.clone(), 1).unwrap();
            let driver = MotorSetup { step_pin: 2, dir_pin: 3, ..MotorSetup::default() };
            host.configure(&Setup { pulse_ticks: 250, motors: vec![driver], ..Setup::default() }).unwrap();
            host.arm().unwrap();
            host.close();
            let refused = problem(store(board.clone(), &ASK, None).unwrap_err());
            assert!(refused.to_string().contains("motors are armed"), "{refused}");
            assert!(refused.help().unwrap().to_string().contains("pulsetrain stop"));
            let mut next = Remote::open_if_free(board.clone(), 2).unwrap();
            next.stop_motors().unwrap();
            next.close();
            let kept =
                Stored { settings: Some(Settings { deadman_ms: 400, ..Settings::default() }), is_damaged: false };
            assert_eq!(store(board, &StoreArgs { deadman: Some(400), ..ASK }, None).unwrap(), kept);
        }

        #[test]
        fn every_image_of_an_uno_keeps_settings() {
            let kept =
                Stored { settings: Some(Settings { silence_ms: 700, ..Settings::default() }), is_damaged: false };
            for uno in [VirtualUno::new(), VirtualUno::with_winch(), VirtualUno::with_verbs()] {
                assert_eq!(store(uno, &StoreArgs { silence: Some(700), ..ASK }, None).unwrap(), kept);
            }
        }

        /// The newer of two copies is damaged: storing the older one's values again repairs it.
        #[test]
        fn the_same_once_more_mends_what_is_damaged() {
            let mut board = Remote::open(VirtualPico::on_usb(), 1).unwrap();
            let settings = [400, 500].map(|deadman_ms| Settings { deadman_ms, ..Settings::default() });
            settings.iter().for_each(|settings| board.store(settings).unwrap());
            let mut memory = board.close().chip().flash().to_vec();
            memory[PROGRAM_FLASH_BYTES as usize + 4096 + 3] ^= 1;
            let after = |args: &StoreArgs| store(VirtualPico::with_flash(&memory).unwrap(), args, None).unwrap();
            let damaged = Stored { settings: Some(settings[0]), is_damaged: true };
            assert_eq!(after(&ASK), damaged);
            let said =
                serde_json::to_value(StoreReport { kept: damaged.settings.map(Kept::of), damaged: true }).unwrap();
            assert_eq!((&said["deadman_ms"], &said["damaged"]), (&400.into(), &true.into()));
            assert_eq!(after(&StoreArgs { deadman: Some(400), ..ASK }), Stored { is_damaged: false, ..damaged });
        }
    }
}
