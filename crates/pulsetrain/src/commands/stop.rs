//! `pulsetrain stop`: stops runs of this computer, or a board's motors at once, whichever program moves them.

use clap::Args;
use std::fmt::{self, Display};
use std::time::Duration;

use miette::{Report, miette};
use pulsetrain_board::{BoardKind, LinkError, Port, PortError, Remote, RemoteError, Serial};
use pulsetrain_trace::winch::{AXES, Status};
use schemars::JsonSchema;
use serde::Serialize;

use super::info::{listed, motor_list};
use super::problems::{drive_problem, port_problem};
use crate::console::{Console, Exit};
use crate::control_socket::{RunClient, SocketError, port_paths, runs};
use crate::live::{Ending, RunCommand, RunEnded, RunEvent, RunInfo, RunLine};
use crate::way_back::quoted;
use crate::winch::talk::{BoardLine, Talk, with_checksum};
use pulsetrain_motion::human;
use pulsetrain_session::drive::session_number;

/// Which runs or board to stop.
#[derive(Args, Debug)]
#[command(after_help = "\
If a `pulsetrain run` of this computer has the port, the run gets the order: it brakes all motors within their limits, \
or stops them at once with --now, and prints where they are. Without --port, the only run is stopped, also one on a \
virtual board.

If no run has the port, the board itself is stopped: all motors stop at once, without ramps, whatever moves them (a \
long MOVE, a baked motion). Axes that follow StepperWinch's text brake within their limits first; then their drivers \
are switched off. An Uno is reset when its port is opened, and that stops it, too. The output says where all motors \
are, and which ones were too fast to stop at once: these may have turned further than the count says.

Examples:
  pulsetrain stop
  pulsetrain stop --now
  pulsetrain stop --port /dev/ttyACM0")]
pub(crate) struct StopArgs {
    /// The run or the board at this serial port; or a run's name, as `pulsetrain status` lists it
    #[arg(long, value_name = "PORT")]
    pub(crate) port: Option<String>,
    /// Stop at once, without braking: a fast motor may turn further than the count says
    #[arg(long)]
    pub(crate) now: bool,
    /// Stop all runs of this computer
    #[arg(long, conflicts_with = "port")]
    pub(crate) all: bool,
    /// Print the answers as JSON
    #[arg(long)]
    pub(crate) json: bool,
}

/// The board's report of a stop.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct StopReport {
    /// Whether motors moved, or waited to move. `None` for paths whose positions did not change: they may have stopped
    /// before the first status.
    moved: Option<bool>,
    /// Whether opening the port has reset the board, which also stops its motors.
    reset: bool,
    /// Whether the axes were driven by text. Axes with paths stopped within their limits, axes that verbs move at once.
    text: bool,
    /// When the motors stopped, s by the board's clock. Of frames: no step was begun after it. Of paths: the time of
    /// the positions. `None` for verbs in text.
    at_s: Option<f64>,
    /// Steps of each motor, or of text's axes x, y, z and a: forward minus backward.
    positions: Vec<i64>,
    /// Motors that may stand elsewhere than their counts. Of frames: those that were above their pull-in speed. Of
    /// verbs in text, which knows no pull-in speed: all that were stepping.
    uncertain: Vec<usize>,
}

pub(crate) fn run(args: &StopArgs, console: &mut Console<'_>) -> miette::Result<Exit> {
    let runs = match (runs(), &args.port) {
        (Ok(runs), _) => runs,
        // Without a socket no run can be asked, but the board can.
        (Err(SocketError::System), Some(_)) => Vec::new(),
        (Err(error), _) => return Err(error.into()),
    };
    let chosen = chosen(runs, args.port.as_deref(), args.all, "stop")?;
    match &args.port {
        Some(port) if chosen.is_empty() => stop_board(port, args.json, console),
        _ => stop_runs(chosen, args.now, args.json, console),
    }
}

/// The runs that are meant: those at a port or of a name, all, or the only one. None is an error unless a port is named.
pub(super) fn chosen(
    runs: Vec<RunClient>,
    port: Option<&str>,
    all: bool,
    command: &str,
) -> miette::Result<Vec<RunClient>> {
    if let Some(port) = port {
        let paths = port_paths(port);
        return Ok(runs.into_iter().filter(|run| run.info().is_at(port, &paths)).collect());
    }
    if runs.is_empty() {
        let help = "a run that another user began is stopped by that user; a board that moves without a run: \
                    `pulsetrain stop --port PORT`";
        return Err(miette!(help = help, "nothing runs on this computer"));
    }
    if runs.len() > 1 && !all {
        let each = runs.iter().map(|run| {
            let place = quoted(run.info().place());
            format!("  pulsetrain {command} --port {place}    {} on {}", run.info().file, run.info().board)
        });
        let each: Vec<String> = each.collect();
        let all_too = if command == "stop" { ", or --all" } else { "" };
        let help = format!("say which one{all_too}:\n{}", each.join("\n"));
        return Err(miette!(help = help, "{} runs are there", runs.len()));
    }
    Ok(runs)
}

/// How a run took its stop.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct StoppedRunReport {
    /// The run.
    run: RunInfo,
    /// From when on its motors braked, s of the motion. `None` if they were stopped at once, or did not move any more.
    brakes_at_s: Option<f64>,
    #[serde(flatten)]
    end: RunEnded,
}

/// Asks all these runs to stop, and then waits for each.
fn stop_runs(mut runs: Vec<RunClient>, now: bool, json: bool, console: &mut Console<'_>) -> miette::Result<Exit> {
    let command = if now { RunCommand::StopNow } else { RunCommand::Stop };
    for run in &mut runs {
        run.command(&command)?;
    }
    let mut reports = Vec::new();
    for mut run in runs {
        let mut brakes_at_s = None;
        let end = loop {
            match run.next_line()? {
                RunLine::Event(RunEvent::Stopping { at_s }) => brakes_at_s = Some(at_s),
                RunLine::Event(_) | RunLine::Control { .. } | RunLine::Info(_) => {}
                RunLine::Error { error } => {
                    return Err(miette!("the run at {} refuses to stop: {error}", run.info().place()));
                }
                RunLine::Ended(end) => break end,
            }
        };
        let report = StoppedRunReport { run: run.info().clone(), brakes_at_s, end };
        if !json {
            console.print(&report)?;
        }
        reports.push(report);
    }
    if json {
        console.print_json(&reports)?;
    }
    let all_well = reports.iter().all(|report| report.end.ended != Ending::Failed || !report.end.moved);
    Ok(if all_well { Exit::Success } else { Exit::Stopped })
}

impl Display for StoppedRunReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let StoppedRunReport { run, brakes_at_s, end } = self;
        write!(f, "the run of {} at {}: ", run.file, run.place())?;
        match (end.ended, brakes_at_s) {
            (Ending::Failed, _) => writeln!(f, "{}", end.why.as_deref().unwrap_or("it failed"))?,
            (Ending::Finished, _) => writeln!(f, "it came to its end before it could be stopped")?,
            (Ending::Stopped, Some(at_s)) => {
                writeln!(f, "the motors braked from {} on, and rest", human::seconds_to(*at_s, 6))?;
            }
            (Ending::Stopped, None) => writeln!(f, "the motors were stopped at once")?,
        }
        end.motors.iter().try_for_each(|motor| writeln!(f, "  {motor}"))?;
        end.way_back.as_ref().map_or(Ok(()), |way_back| writeln!(f, "back to the start: {way_back}"))
    }
}

/// Stops the board at a port, which no run of this computer has.
fn stop_board(port: &str, json: bool, console: &mut Console<'_>) -> miette::Result<Exit> {
    let stopped = stop(|| Serial::open(port, false))?;
    if json {
        console.print_json(&stopped)?;
    } else {
        console.print(format_args!("{}\n", stopped.in_words()))?;
    }
    Ok(Exit::Success)
}

impl StopReport {
    /// The report in words.
    fn in_words(&self) -> String {
        let StopReport { moved, at_s, positions, uncertain, .. } = self;
        let when = at_s.map_or_else(String::new, |at| format!("{} after the board began; ", human::seconds(at)));
        if self.reset {
            let board = if self.text { "board" } else { "Uno" };
            return format!(
                "opening the port has reset the {board}: what moved has stopped at once, and its position is not known"
            );
        }
        if self.text {
            let named = |axis: usize| AXES.get(axis).map_or_else(|| axis.to_string(), char::to_string);
            let axes: Vec<String> =
                positions.iter().enumerate().map(|(axis, at)| format!("{} {at}", named(axis))).collect();
            let what = match moved {
                Some(false) => "none moved",
                _ if at_s.is_none() => "they were stopped at once",
                _ => "they have stopped within their limits",
            };
            let mut told =
                format!("text had the axes: {what}, and the drivers are off; {when}steps counted: {}", axes.join(", "));
            if !uncertain.is_empty() {
                let axes: Vec<String> = uncertain.iter().map(|axis| named(*axis)).collect();
                told.push_str(&format!(
                    "\nstopped between two steps, so may stand elsewhere than counted if they were faster than they can start: {}",
                    axes.join(", ")
                ));
            }
            return told;
        }
        let what = if *moved == Some(true) { "the motors were stopped at once" } else { "nothing moved" };
        let counted = if positions.is_empty() { "no motor is set up".to_owned() } else { listed(positions) };
        let mut told = format!("{what}, {when}steps counted: {counted}");
        if !uncertain.is_empty() {
            let motors = motor_list(uncertain);
            told.push_str(&format!("\ntoo fast for that, so may stand elsewhere than counted: {motors}"));
        }
        told
    }
}

/// Stops all motors of the board at the port that `open` opens. It tries frames first. The board refuses frames while
/// text or another host has the axes, so it tries text next. If another host has them, it waits until that host leaves
/// the board.
fn stop<P: Port>(mut open: impl FnMut() -> Result<P, PortError>) -> miette::Result<StopReport> {
    let first = Remote::open_if_free(open().map_err(port_problem)?, session_number());
    let refused = match first.and_then(stop_frames) {
        Ok(stopped) => return Ok(stopped),
        // A board that speaks only text does not answer frames.
        Err(refused @ RemoteError::Link(LinkError::Taken | LinkError::Nobody)) => refused,
        Err(error) => return Err(drive_problem(error.into())),
    };
    let mut talk = Talk::new(open().map_err(port_problem)?);
    if let Some(mut stopped) = stop_text(&mut talk)? {
        // A board that knows no frames is an Uno, or behaves like one: if it started when its port was opened, that
        // reset has stopped its motors.
        let is_young = stopped.at_s.is_none_or(|at| at < talk.now().as_secs_f64());
        stopped.reset = refused == RemoteError::Link(LinkError::Nobody) && is_young && stopped.moved != Some(true);
        return Ok(stopped);
    }
    match refused {
        RemoteError::Link(LinkError::Taken) => Remote::open(open().map_err(port_problem)?, session_number())
            .and_then(stop_frames)
            .map_err(|error| drive_problem(error.into())),
        nobody => Err(drive_problem(nobody.into())),
    }
}

fn stop_frames<P: Port>(mut board: Remote<P>) -> Result<StopReport, RemoteError> {
    let moved = !board.status()?.is_idle();
    let (stopped, positions) = board.stop_motors()?;
    let tick_hz = f64::from(board.info().tick_hz);
    // If opening the port does not reset the board, its motors are still set up.
    let resets = board.kind().is_some_and(BoardKind::resets_when_opened);
    let reset = resets && !moved && positions.is_empty();
    board.close();
    let uncertain = (0..positions.len()).filter(|motor| stopped.uncertain >> motor & 1 == 1).collect();
    let (moved, at_s) = (Some(moved), Some(stopped.tick as f64 / tick_hz));
    Ok(StopReport { moved, reset, text: false, at_s, positions, uncertain })
}

/// The longest period that no step ends during a stop: half a minute on a Pico. The board's answer says for each axis
/// when its next step comes, which is never for an axis at rest. So this line stops the axes that step, and its answer
/// names them; text has no other question for that.
const STOP_STEPPING: &str = "speed xyza 4294967294";
/// Then the axes forget their moves and runs. The answer has their positions.
const FORGET: &str = "halt";
/// Paths stop within their limits. Then the drivers go off, for paths and for verbs.
const RELEASE: &str = "enable 0";
/// Shorter than any period: the board refuses it with `err period` once paths have left the axes, and with `err path`
/// before.
const PROBE: &str = "speed x 1";

/// The board answers a line within this time, also through an adapter that holds bytes back.
const ANSWER: Duration = Duration::from_millis(100);
/// How often the lines are repeated if nobody answers. A board that has just started is deaf for a second or two.
const TRIES: usize = 40;
/// Longest time until stopped axes have released their drivers.
const RELEASED: Duration = Duration::from_secs(2);
/// Longest time that a path takes to brake.
const BRAKED: Duration = Duration::from_secs(60);
/// Longest wait for a status. Statuses come every 0.2 s unless a host has changed that.
const STATUS: Duration = Duration::from_millis(500);
/// A path without a step for this time, µs by the board's clock, counts as stopped. For boards that know no verbs,
/// which cannot answer whether it has.
const REST_US: u64 = 500_000;

/// What the board has sent since the stop began.
#[derive(Debug, Default)]
struct Heard {
    /// The board answers lines of text.
    answers: bool,
    /// A program that sends frames has the board.
    is_taken: bool,
    /// The board's answers to verbs.
    ats: Vec<[(i64, bool); AXES.len()]>,
    /// Whether paths have the axes, by the last answer. `None` if the board does not say.
    paths: Option<bool>,
    /// `awake` came after an answer to a verb: the axes are free.
    is_released: bool,
    /// The first status, the first one with the present positions, and the last one.
    first: Option<Status>,
    since: Option<Status>,
    last: Option<Status>,
}

impl Heard {
    fn hear(&mut self, said: &BoardLine) {
        let line = match said {
            BoardLine::Status(status) => {
                self.first.get_or_insert(*status);
                self.since = self.since.filter(|since| since.positions == status.positions).or(Some(*status));
                self.last = Some(*status);
                return;
            }
            BoardLine::Line(line) => line.as_str(),
        };
        match line {
            "err path" => self.paths = Some(true),
            "err taken" => self.is_taken = true,
            // On USB the board also sends `awake` when the port is opened.
            "awake" => self.is_released |= !self.ats.is_empty(),
            _ if line.starts_with("id ") => self.answers = true,
            _ if line.starts_with("err period ") => self.paths = Some(false),
            _ => self.ats.extend(read_at(line)),
        }
    }

    /// Whether positions have not changed for [`REST_US`].
    fn is_still(&self) -> bool {
        matches!((self.since, self.last), (Some(since), Some(last)) if last.usec - since.usec >= REST_US)
    }
}

/// `at <tick> x <position> <wait> …`: each axis's position, and whether it has a step to come.
fn read_at(line: &str) -> Option<[(i64, bool); AXES.len()]> {
    let mut words = line.strip_prefix("at ")?.split(' ').skip(1);
    let mut axes = [(0, false); AXES.len()];
    for (name, axis) in AXES.iter().zip(&mut axes) {
        words.next().filter(|word| word.chars().eq([*name]))?;
        *axis = (words.next()?.parse().ok()?, words.next()? != "-");
    }
    Some(axes)
}

/// Listens until `until`, or until `is_enough`.
fn listen<P: Port>(
    talk: &mut Talk<P>,
    heard: &mut Heard,
    until: Duration,
    is_enough: impl Fn(&Heard) -> bool,
) -> miette::Result<()> {
    const ROUND: Duration = Duration::from_millis(10);
    while !is_enough(heard) && talk.now() < until {
        talk.wait(until.min(talk.now() + ROUND), |_, said| heard.hear(&said)).map_err(port_problem)?;
    }
    Ok(())
}

/// Stops axes that text drives. `None` if the board does not answer text, or a host that sends frames has it.
fn stop_text<P: Port>(talk: &mut Talk<P>) -> miette::Result<Option<StopReport>> {
    let mut heard = Heard::default();
    for round in 0..TRIES {
        for line in [STOP_STEPPING, FORGET, RELEASE, "version"] {
            // A board that is strict ignores lines without a checksum, but cannot say so, so every second round has
            // checksums.
            let line = if round % 2 == 1 { with_checksum(line) } else { line.to_owned() };
            talk.tell(&line).map_err(port_problem)?;
        }
        let until = talk.now() + ANSWER;
        listen(talk, &mut heard, until, |heard| heard.answers || heard.is_taken)?;
        if heard.is_taken {
            return Ok(None);
        }
        if heard.answers {
            break;
        }
    }
    if !heard.answers {
        return Ok(None);
    }
    let (Some(before), Some(after)) = (heard.ats.first().copied(), heard.ats.last().copied()) else {
        return stop_paths(talk, heard).map(Some);
    };
    let until = talk.now() + RELEASED;
    listen(talk, &mut heard, until, |heard| heard.is_released)?;
    if !heard.is_released {
        return Err(does_not_stop("it does not say that its axes are released"));
    }
    let uncertain: Vec<usize> = (0..AXES.len()).filter(|axis| before[*axis].1).collect();
    let positions = after.map(|(position, _)| position).to_vec();
    Ok(Some(StopReport {
        moved: Some(!uncertain.is_empty()),
        reset: false,
        text: true,
        at_s: None,
        positions,
        uncertain,
    }))
}

/// Waits until paths have come to rest after `enable 0`.
fn stop_paths<P: Port>(talk: &mut Talk<P>, mut heard: Heard) -> miette::Result<StopReport> {
    let end = talk.now() + BRAKED;
    let mut patience = talk.now() + STATUS;
    loop {
        heard.paths = None;
        let line = talk.as_wanted(PROBE);
        talk.tell(&line).map_err(port_problem)?;
        let until = talk.now() + ANSWER;
        listen(talk, &mut heard, until, |heard| heard.paths == Some(false))?;
        match heard.paths {
            Some(false) => break,
            None if heard.is_still() => break,
            _ => {}
        }
        if heard.first.is_none() && talk.now() >= patience {
            // The statuses' usual interval: the program that changed it is gone.
            let line = talk.as_wanted("srate 200");
            talk.tell(&line).map_err(port_problem)?;
            patience = end;
        }
        if talk.now() >= end {
            return Err(does_not_stop("its axes still move"));
        }
    }
    // The next status has the positions at rest.
    heard.last = None;
    let until = talk.now() + STATUS;
    listen(talk, &mut heard, until, |heard| heard.last.is_some())?;
    if heard.last.is_none() {
        let line = talk.as_wanted("srate 200");
        talk.tell(&line).map_err(port_problem)?;
        let until = talk.now() + STATUS;
        listen(talk, &mut heard, until, |heard| heard.last.is_some())?;
    }
    let (Some(first), Some(last)) = (heard.first, heard.last) else {
        return Err(does_not_stop("it does not say where its axes are"));
    };
    Ok(StopReport {
        moved: (first.positions != last.positions).then_some(true),
        reset: false,
        text: true,
        at_s: Some(last.usec as f64 * 1e-6),
        positions: last.positions.map(i64::from).to_vec(),
        uncertain: Vec::new(),
    })
}

fn does_not_stop(why: &str) -> Report {
    let help = "look with `pulsetrain winch --port PORT`; if axes still move, cut the power";
    miette!(help = help, "the board was sent an order to stop, but {why}")
}

#[cfg(test)]
mod tests {
    use super::super::info;
    use super::*;
    use pulsetrain_board::Setup;
    use pulsetrain_board::shared::Shared;
    use pulsetrain_board::virtual_pico::VirtualPico;
    use pulsetrain_core::verbs::Verb;
    use pulsetrain_core::wire::Baud;
    use pulsetrain_core::wire::message::MotorSetup;

    /// Lets a Pico obey lines and stops it 0.2 s later. Gives the report, the time and position of the last steps of x,
    /// y and z, and when the report came. Times count from the beginning of the stop.
    fn stopped(lines: &[&str]) -> (StopReport, [i64; 3], Duration, Duration) {
        const TICKS_PER_S: f64 = 125e6;
        let pico = Shared::new(VirtualPico::on_usb());
        let mut talk = Talk::new(pico.clone());
        for line in lines {
            talk.tell(line).unwrap();
        }
        talk.wait(talk.now() + Duration::from_millis(200), |_, said| assert!(!said.is_refusal(), "{said:?}")).unwrap();
        let begun = pico.now();
        // The program that has the port open also takes its edges, so they are read from the board itself.
        let mut edges = Vec::new();
        pico.port().edges(&mut edges);
        let stopped = stop(|| Ok(pico.clone())).unwrap();
        let known = pico.now() - begun;
        let tick = edges.last().map_or(0, |edge| edge.tick);
        pico.port().edges(&mut edges);
        let mut forward = [false; 10];
        let mut counts = [0; 3];
        let mut last = tick;
        for edge in edges {
            if edge.line % 2 == 1 && edge.line < 10 {
                forward[usize::from(edge.line)] = edge.level;
            } else if let Some(axis) = [2, 4, 6].iter().position(|step| *step == edge.line && edge.level) {
                counts[axis] += if forward[usize::from(edge.line) + 1] { 1 } else { -1 };
                last = edge.tick;
            }
        }
        (stopped, counts, Duration::from_secs_f64((last - tick) as f64 / TICKS_PER_S), known)
    }

    #[test]
    fn who_waits_for_rest_is_told_how_to_stop() {
        let waits = drive_problem(RemoteError::StillMoving.into());
        assert!(waits.help().is_some_and(|help| help.to_string().contains("pulsetrain stop --port PORT")));
    }

    /// Tests that run firmware on an emulated chip.
    mod chips {
        use super::*;

        #[test]
        fn a_board_that_was_told_nothing_is_said_to_rest() {
            let (stopped, counts, ..) = stopped(&["ping"]);
            assert_eq!((stopped.text, stopped.moved, counts), (false, Some(false), [0; 3]));
        }

        /// Paths brake: 4000 steps/s by 20 000 steps/s² take 0.2 s and 400 steps.
        #[test]
        fn axes_on_paths_brake_and_are_asked_where_they_came_to_rest() {
            // A strict board refuses a line without a checksum.
            for lines in [&["l x 4000 20000", "v x 4000"][..], &["strict 1", "l x 4000 20000", "v x 4000"]] {
                let lines =
                    lines.iter().map(|line| if lines.len() == 3 { with_checksum(line) } else { (*line).to_owned() });
                let lines: Vec<String> = lines.collect();
                let lines: Vec<&str> = lines.iter().map(String::as_str).collect();
                let (stopped, [x, ..], last, known) = stopped(&lines);
                assert_eq!(stopped.positions, [x, 0, 0, 0]);
                assert!(x > 400 && stopped.text && stopped.uncertain.is_empty() && stopped.moved != Some(false));
                let (shortest, longest) = (Duration::from_millis(150), Duration::from_millis(300));
                assert!(last > shortest && last < longest && known < Duration::from_millis(900), "{last:?} {known:?}");
            }
        }

        /// x runs, y goes backward, z has done its move, a has no order: the counts agree with the pins, and x and y
        /// are named.
        #[test]
        fn axes_told_directly_stop_soon_and_their_places_are_told() {
            let lines = ["speed xyz 12500 50000 12500", "dir ya -1 0", "run xa", "move y 100000", "move z 40"];
            let (stopped, [x, y, z], last, known) = stopped(&lines);
            assert!(x > 1000 && y < -200 && z == 40, "{x} {y} {z}");
            assert_eq!(stopped.positions, [x, y, z, 0]);
            assert_eq!((stopped.text, stopped.moved, &stopped.uncertain[..]), (true, Some(true), &[0, 1][..]));
            assert!(stopped.in_words().contains("than they can start: x, y"), "{}", stopped.in_words());
            assert!(last < Duration::from_millis(15) && known < Duration::from_millis(500), "{last:?} {known:?}");
        }

        /// A host has left a MOVE of a day behind. The next host learns of it, and may end it.
        #[test]
        fn what_a_host_left_behind_is_told_and_stopped() {
            let mut host = Remote::open(VirtualPico::on_usb(), 1).unwrap();
            let driver = MotorSetup { step_pin: 2, dir_pin: 3, pull_in_ticks: 1_250_000, ..MotorSetup::default() };
            host.configure(&Setup { pulse_ticks: 250, motors: vec![driver], ..Setup::default() }).unwrap();
            host.tell_motors(&[(0, Verb::Speed { ticks: 125_000 }), (0, Verb::Move { steps: 86_400_000 })]).unwrap();
            let mut lost = host.port().clone();
            let port = host.close();
            let said = info::ask(port.clone(), Baud::B1M).unwrap();
            assert_eq!(said.keeps(), "not reported while motors are powered");
            assert!(said.moves && said.positions.len() == 1 && said.uncertain.is_empty(), "{said:?}");
            // It is stopped at 1000 steps/s; its pull-in speed is 100 steps/s.
            let StopReport { moved, positions, uncertain, .. } = stop(|| Ok(port.clone())).unwrap();
            assert!(moved == Some(true) && positions[0] > 0, "{positions:?}");
            assert_eq!(uncertain, [0]);
            // A host that falls silent leaves nothing that moves.
            let until = lost.now() + Duration::from_secs(3);
            while lost.now() < until {
                lost.receive(until, &mut Vec::new()).unwrap();
            }
            let said = info::ask(lost, Baud::B1M).unwrap();
            assert!(!said.moves, "{said:?}");
            assert_eq!(said.uncertain, [0]);
        }
    }
}
