//! `pulsetrain calibrate`: compares a board's clock with this computer's.

use crate::arguments;
use clap::Args;
use miette::miette;
use pulsetrain_board::{Board, Port, Remote, RemoteError, Serial};
use pulsetrain_motion::Time;
use schemars::JsonSchema;
use serde::Serialize;

use super::problems::{drive_problem, port_problem};
use crate::console::{Console, Exit};
use pulsetrain_motion::human;
use pulsetrain_session::drive::session_number;
use pulsetrain_session::prepare::WORST_CLOCK_PPM;

#[derive(Args, Debug)]
#[command(after_help = "\
An Uno's clock is a ceramic resonator. It is off by up to 0.5 % and moves with temperature. A Pico has a crystal, \
which is off by 50 ppm or less.

Examples:
  pulsetrain calibrate --port /dev/ttyACM0
  pulsetrain calibrate --port /dev/ttyACM0 --for \"10 min\"
  pulsetrain run examples/tutorial.toml --port /dev/ttyACM0 --clock-ppm=-1250")]
pub(crate) struct CalibrateArgs {
    /// The board at this serial port
    #[arg(long, value_name = "PORT")]
    pub(crate) port: String,
    /// How long the clock is watched: the result of twice the time is twice as exact
    #[arg(long = "for", value_name = "TIME", value_parser = arguments::duration, allow_hyphen_values = true, default_value = "60 s")]
    pub(crate) length: Time,
    /// Print the result as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// The result.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct ClockReport {
    /// How much faster than its nominal rate the board's clock runs by this computer's clock, ppm.
    clock_ppm: f64,
    /// How much that figure may be off, ppm.
    within_ppm: f64,
    /// How long the clock was watched, s by the board's clock.
    watched_s: f64,
}

pub(crate) fn run(args: &CalibrateArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let seconds = args.length.seconds();
    let bar = console.progress(seconds, &human::seconds(seconds));
    bar.stage("comparing");
    let port = Serial::open(&args.port, false).map_err(port_problem)?;
    let compared = compare(port, seconds, |done| bar.set(done)).map_err(|error| drive_problem(error.into()))?;
    drop(bar);
    let Some((clock_ppm, within_ppm)) = compared else {
        let help = "half a second is the least; a minute tells it to some 70 ppm";
        return Err(miette!(help = help, "{} is too short to compare clocks", human::seconds(seconds)));
    };
    if args.json {
        console.print_json(&ClockReport { clock_ppm, within_ppm, watched_s: seconds })?;
        return Ok(Exit::Success);
    }
    let (ppm, within) = (human::significant(clock_ppm, 4), human::significant(within_ppm, 2));
    let way = way(clock_ppm, within_ppm);
    let advice = advice(clock_ppm, within_ppm, &args.port);
    console.print(format_args!(
        "the board's clock is {ppm} ppm off this computer's, give or take {within}: {way}.\n{advice}\n"
    ))?;
    Ok(Exit::Success)
}

/// What the figure means for the board's clock.
fn way(clock_ppm: f64, within_ppm: f64) -> &'static str {
    if clock_ppm.abs() <= within_ppm {
        "whether it runs faster or slower is not known"
    } else if clock_ppm < 0.0 {
        "it runs slower"
    } else {
        "it runs faster"
    }
}

/// What the user can do about it.
fn advice(clock_ppm: f64, within_ppm: f64, port: &str) -> String {
    if clock_ppm.abs() <= within_ppm {
        return format!(
            "There is nothing to correct for that is known. Watched for longer it is surer: \
             `pulsetrain calibrate --port {port} --for \"2 min\"`, some 35 ppm."
        );
    }
    if clock_ppm.abs() > WORST_CLOCK_PPM {
        return format!(
            "No board's clock is off by more than {} ppm: this computer had too much else to do, or the board is a virtual one that it \
             is too slow for. Try again.",
            human::count(WORST_CLOCK_PPM as i128)
        );
    }
    format!(
        "`pulsetrain run FILE --port {port} --clock-ppm={clock_ppm:.1}` corrects for it. It moves with the board's temperature."
    )
}

/// Watches a board's clock for a time. Gives how much faster than its nominal rate it runs, ppm, and how much that may
/// be off. `None` if the time was too short for an estimate. Calls `watch` with the time that has passed, s.
fn compare<P: Port>(port: P, seconds: f64, mut watch: impl FnMut(f64)) -> Result<Option<(f64, f64)>, RemoteError> {
    /// How often `watch` is called.
    const LOOKS_PER_S: f64 = 5.0;
    let mut board = Remote::open(port, session_number())?;
    let hz = f64::from(board.info().tick_hz);
    let began = board.now();
    let end = began + (seconds * hz) as u64;
    while board.now() < end {
        let next = (board.now() + (hz / LOOKS_PER_S) as u64).min(end);
        board.advance(next, &mut |_| {});
        if let Some(error) = board.error() {
            return Err(error.clone());
        }
        watch((board.now() - began) as f64 / hz);
    }
    let ppm = board.clock().ppm();
    board.close();
    Ok(ppm)
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulsetrain_board::skewed::Skewed;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_board::virtual_uno::VirtualUno;

    #[test]
    fn a_way_is_told_beyond_the_doubt_alone() {
        assert_eq!(way(0.0, 70.0), "whether it runs faster or slower is not known");
        assert_eq!(way(-69.0, 70.0), way(0.0, 70.0));
        assert_eq!((way(71.0, 70.0), way(-71.0, 70.0)), ("it runs faster", "it runs slower"));
    }

    #[test]
    fn a_correction_is_proposed_where_run_takes_it_and_it_is_known() {
        let said = |ppm, within| advice(ppm, within, "/dev/ttyACM0");
        assert!(said(-1250.04, 70.0).contains("--port /dev/ttyACM0 --clock-ppm=-1250.0`"), "{}", said(-1250.04, 70.0));
        for (ppm, within, part) in
            [(-60.0, 70.0, "calibrate --port /dev/ttyACM0 --for"), (-758_000.0, 1000.0, "10 000 ppm: this computer")]
        {
            let said = said(ppm, within);
            assert!(said.contains(part) && !said.contains("--clock-ppm"), "{said}");
        }
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        /// In simulated time the true rate lies within the estimate's own bounds, and the bounds are narrow enough to
        /// be useful.
        #[test]
        fn a_clock_that_is_off_is_found_out() {
            for off in [5000, -5000, 0, 37] {
                let uno = Skewed::new(VirtualUno::new(), off);
                let (ppm, within) = compare(uno, 10.0, |_| {}).unwrap().expect("long enough");
                assert!((ppm - f64::from(off)).abs() <= within && within < 500.0, "{off}: {ppm} ± {within}");
            }
            let pico = Skewed::new(VirtualPico::on_usb(), -40);
            let (ppm, within) = compare(pico, 2.0, |_| {}).unwrap().expect("long enough");
            assert!((ppm + 40.0).abs() <= within && within < 1500.0, "{ppm} ± {within}");
        }

        /// The message of `calibrate` if the time is too short.
        #[test]
        fn a_minute_tells_it_to_some_70_ppm() {
            let (ppm, within) = compare(Skewed::new(VirtualUno::new(), -1250), 60.0, |_| {}).unwrap().unwrap();
            assert!((ppm + 1250.0).abs() <= within && within <= 75.0, "{ppm} ± {within}");
        }

        #[test]
        fn twice_as_long_is_twice_as_sure() {
            let within =
                |seconds| compare(Skewed::new(VirtualUno::new(), 1000), seconds, |_| {}).unwrap().map(|found| found.1);
            let (short, long) = (within(4.0).unwrap(), within(8.0).unwrap());
            assert!(long < 0.7 * short, "{short} {long}");
            assert_eq!(within(0.1), None);
        }
    }
}
