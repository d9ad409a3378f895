//! Runs a script on a board: sends each line at its time, then judges, draws and writes down the run.

use std::fmt::{self, Display};
use std::time::Duration;

use pulsetrain_board::{Port, PortError, VirtualBoard};
use pulsetrain_motion::program::Scale;
use pulsetrain_trace::Edge;
use pulsetrain_trace::winch::{self, AXES, Command, Onlooker, Order, SentLine, Status, WinchOptions};
use schemars::JsonSchema;
use serde::Serialize;

use super::script::Script;
use super::talk::{BYTE, BoardLine, STOP, Talk, meaning};
use pulsetrain_motion::human::{self, Table};
use pulsetrain_plot::{Errors, MotorPicture, Picture};

/// The shortest time of a byte that an Uno's USB bridge makes of it: its rate is not exact.
const FAST_BYTE: Duration = Duration::from_nanos(85_000);
/// The first byte may wait for a frame of USB.
const USB_FRAME: Duration = Duration::from_millis(1);

/// What the caller of a running script wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ScriptControl {
    /// The script goes on.
    GoOn,
    /// The script ends: all axes stop within their limits.
    Stop,
}

/// How long the board gets to stop its axes.
const AFTER_STOP: Duration = Duration::from_secs(1);

/// Ticks a second of a run whose pins nobody sees.
const UNSEEN_TICK_HZ: u64 = 16_000_000;

/// What happened in a run. Times are by the board's clock.
#[derive(Clone, Debug)]
pub struct Run {
    /// Ticks in a second.
    pub tick_hz: u64,
    /// When the script began, ticks.
    pub begin: u64,
    /// When it ended, ticks.
    pub end: u64,
    /// The lines that were sent.
    pub told: Vec<SentLine>,
    /// Whether the last of them is the stop that the user wanted, and not the script's.
    pub is_stopped: bool,
    /// Number of lines that were not sent, because the run ended before their time.
    pub unsent: usize,
    /// Status lines that came.
    pub statuses: Vec<Status>,
    /// Lines that were refused.
    pub refusals: Vec<Refusal>,
    /// Faults that a board in order does not have.
    pub troubles: Vec<Trouble>,
    /// All edges of the pins, if they are known.
    pub edges: Vec<Edge>,
}

/// A line that the board refused.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Refusal {
    /// When the refusal came, s from the script's beginning.
    pub at_s: f64,
    /// The board's text.
    pub said: String,
}

/// A board restarted during the script, or fell silent.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Trouble {
    /// When that was seen, s from the script's beginning.
    pub at_s: f64,
    /// The fault in words.
    pub what: String,
}

/// The positions of a real board's axes by its next status, if they are not all 0. `None` if they are, or if no status
/// comes for a second. Without edges a run is judged by the board's positions, which must count from 0.
///
/// # Errors
/// If the port is gone.
pub fn positions_off_zero<P: Port>(talk: &mut Talk<P>) -> Result<Option<[i32; 4]>, PortError> {
    let status = talk.status(Duration::from_secs(1))?;
    Ok(status.map(|status| status.positions).filter(|positions| *positions != [0; 4]))
}

/// Runs a script on a virtual board that has given its name. Calls `watch` with the script's time, s.
///
/// # Errors
/// If the port is gone.
pub fn on_virtual<B: VirtualBoard>(
    talk: &mut Talk<B>,
    script: &Script,
    watch: impl FnMut(f64) -> ScriptControl,
) -> Result<Run, PortError> {
    // The board has answered, so its clock runs.
    let zero = talk.port().zero().unwrap_or(0);
    let hz = talk.port().cycles_per_s();
    let to_tick = move |at: Duration| ticks(at, hz) - zero;
    send(talk, script, watch, |_, _| {}).map(|sent| sent.run(hz, to_tick))
}

/// Runs a script on a real board, of which only the text that it sends is known.
///
/// # Errors
/// If the port is gone.
pub fn on_port<P: Port>(
    talk: &mut Talk<P>,
    script: &Script,
    watch: impl FnMut(f64) -> ScriptControl,
) -> Result<Run, PortError> {
    // The board's time zero, by the status that took the shortest time to arrive.
    let mut zero_us = f64::INFINITY;
    let sent = send(talk, script, watch, |at, said| {
        if let BoardLine::Status(status) = said {
            zero_us = zero_us.min(at.as_secs_f64() * 1e6 - status.usec as f64);
        }
    })?;
    let zero_us = if zero_us.is_finite() { zero_us } else { 0.0 };
    let ticks_per_us = UNSEEN_TICK_HZ as f64 / 1e6;
    Ok(sent.run(UNSEEN_TICK_HZ, move |at| ((at.as_secs_f64() * 1e6 - zero_us).max(0.0) * ticks_per_us) as u64))
}

/// Lines that were sent and received, in the port's time.
struct Sent {
    begin: Duration,
    end: Duration,
    /// Each line, with the earliest and the latest time at which the board has it.
    told: Vec<(Duration, Duration, Command)>,
    is_stopped: bool,
    unsent: usize,
    statuses: Vec<Status>,
    refusals: Vec<Refusal>,
    troubles: Vec<Trouble>,
    edges: Vec<Edge>,
}

impl Sent {
    fn run(self, tick_hz: u64, tick: impl Fn(Duration) -> u64) -> Run {
        let told = |(soonest, latest, command): &(Duration, Duration, Command)| SentLine {
            tick: tick(*soonest),
            until: tick(*latest),
            command: *command,
        };
        Run {
            tick_hz,
            begin: tick(self.begin),
            end: tick(self.end),
            told: self.told.iter().map(told).collect(),
            is_stopped: self.is_stopped,
            unsent: self.unsent,
            statuses: self.statuses,
            refusals: self.refusals,
            troubles: self.troubles,
            edges: self.edges,
        }
    }
}

fn send<P: Port>(
    talk: &mut Talk<P>,
    script: &Script,
    mut watch: impl FnMut(f64) -> ScriptControl,
    mut also: impl FnMut(Duration, &BoardLine),
) -> Result<Sent, PortError> {
    /// How often `watch` is called.
    const SLICE: Duration = Duration::from_millis(50);
    let begin = talk.now();
    let at = |seconds: f64| begin + Duration::from_secs_f64(seconds);
    let mut end = at(script.end_s);
    let (mut told, mut statuses, mut refusals) = (Vec::new(), Vec::new(), Vec::new());
    let mut health = Health::new(begin);
    let mut lines = script.lines.iter().take_while(|line| line.at_s <= script.end_s).peekable();
    // When the line to the board is free again: the earliest and the latest time.
    let (mut soonest, mut free) = (begin, begin);
    let mut tell = |talk: &mut Talk<P>, health: &mut Health, text: &str, command: Command| {
        talk.tell(text)?;
        health.sent_line(text);
        let now = talk.now();
        let bytes = text.len() as u32 + 1;
        soonest = soonest.max(now) + FAST_BYTE * bytes;
        free = free.max(now + USB_FRAME) + BYTE * bytes;
        told.push((soonest, free, command));
        Ok::<(), PortError>(())
    };
    let mut stopped = false;
    while talk.now() < end {
        let now = talk.now();
        while let Some(line) = lines.next_if(|line| !stopped && at(line.at_s) <= now) {
            tell(talk, &mut health, &line.text, line.command)?;
        }
        let next = lines.peek().filter(|_| !stopped).map_or(end, |line| at(line.at_s));
        let until = next.min(now + SLICE).min(end);
        talk.wait(until, |at, said| {
            also(at, &said);
            health.heard(at, &said);
            match said {
                BoardLine::Status(status) => statuses.push(status),
                BoardLine::Line(ref line) if said.is_refusal() => {
                    refusals.push(Refusal { at_s: (at - begin).as_secs_f64(), said: line.clone() });
                }
                BoardLine::Line(_) => {}
            }
        })?;
        if watch((talk.now() - begin).as_secs_f64()) == ScriptControl::Stop && !stopped {
            stopped = true;
            end = end.min(talk.now() + AFTER_STOP);
            let stop = talk.as_wanted(STOP);
            tell(talk, &mut health, &stop, Command::parse(&stop).unwrap_or_default())?;
        }
    }
    health.look(talk.now());
    let unsent = script.lines.len() - (told.len() - usize::from(stopped));
    let edge = |edge: pulsetrain_board::Edge| Edge { tick: edge.tick, line: edge.line, level: edge.level };
    let edges = talk.edges().into_iter().map(edge).collect();
    Ok(Sent { begin, end, told, is_stopped: stopped, unsent, statuses, refusals, troubles: health.troubles, edges })
}

/// Checks that the board runs on: it starts once, and its statuses come in time.
struct Health {
    begin: Duration,
    /// The longest interval until the next status. After `srate` it is the longer of both.
    due: Duration,
    /// The interval after the next status.
    next_due: Duration,
    /// The last status: its time of arrival by the port, and its clock, µs.
    last: Option<(Duration, u64)>,
    /// Number of `ping`s without an answer.
    pings: usize,
    troubles: Vec<Trouble>,
}

/// How late a status may be by the board's clock: other replies may occupy the line.
const STATUS_LATE: Duration = Duration::from_millis(50);
/// How late this computer may receive a status.
const HEARD_LATE: Duration = Duration::from_millis(300);
/// If the two clocks differ by more than this between two statuses, the board has restarted. (A resonator's error is
/// 0.5 % at most, which is 0.33 s in the longest interval of 65 s.)
const CLOCKS_APART: Duration = Duration::from_secs(1);

impl Health {
    fn new(begin: Duration) -> Health {
        // The interval of a board that has just started.
        let due = Duration::from_millis(200);
        Health { begin, due, next_due: due, last: None, pings: 0, troubles: Vec::new() }
    }

    fn sent_line(&mut self, text: &str) {
        let mut words = text.split('*').next().unwrap_or_default().split_ascii_whitespace();
        match (words.next(), words.next().and_then(|value| value.parse().ok())) {
            (Some("ping"), _) => self.pings += 1,
            (Some("srate"), Some(ms)) => {
                self.next_due = Duration::from_millis(ms);
                self.due = self.due.max(self.next_due);
            }
            _ => {}
        }
    }

    fn heard(&mut self, at: Duration, said: &BoardLine) {
        match said {
            BoardLine::Line(line) if line == "awake" => match self.pings.checked_sub(1) {
                Some(left) => self.pings = left,
                None => {
                    let what = "it restarted (`awake`): positions, gains and limits are lost".to_owned();
                    self.trouble(at, what);
                }
            },
            BoardLine::Line(_) => {}
            BoardLine::Status(status) => {
                if let Some((before, clock)) = self.last {
                    let passed = Duration::from_micros(status.usec.saturating_sub(clock));
                    let waited = at.saturating_sub(before);
                    if passed.abs_diff(waited) > CLOCKS_APART {
                        let (passed, waited) = (seconds(passed), seconds(waited));
                        self.trouble(at, format!("its clock went on by {passed} in {waited}: it restarted"));
                    } else if passed > self.due + STATUS_LATE {
                        self.silent(at, passed);
                    }
                } else {
                    self.look(at);
                }
                self.last = Some((at, status.usec));
                self.due = self.next_due;
            }
        }
    }

    /// Reports a status that is overdue by the port's time.
    fn look(&mut self, now: Duration) {
        let waited = now.saturating_sub(self.last.map_or(self.begin, |last| last.0));
        if waited > self.due + HEARD_LATE {
            self.silent(now, waited);
        }
    }

    fn silent(&mut self, at: Duration, passed: Duration) {
        let what = format!("no status line for {}, where one is due every {}", seconds(passed), seconds(self.due));
        self.trouble(at, what);
    }

    fn trouble(&mut self, at: Duration, what: String) {
        self.troubles.push(Trouble { at_s: at.saturating_sub(self.begin).as_secs_f64(), what });
    }
}

fn seconds(time: Duration) -> String {
    human::seconds(time.as_secs_f64())
}

fn ticks(at: Duration, tick_hz: u64) -> u64 {
    (at.as_nanos() * u128::from(tick_hz) / 1_000_000_000) as u64
}

/// The report of a script.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct WinchReport {
    /// The script's name.
    pub script: String,
    /// What made the steps: "native winch", "virtual Uno", or "board at PORT".
    pub runner: String,
    /// The board's name for itself.
    pub board: String,
    /// How long the run lasted, s.
    pub duration_s: f64,
    /// Lines of the script that were sent.
    pub lines: usize,
    /// Number of lines that were not sent, because the run ended before their time.
    pub unsent: usize,
    /// Lines that the board refused.
    pub refusals: Vec<Refusal>,
    /// Faults that a board in order does not have.
    pub troubles: Vec<Trouble>,
    /// The judge's verdict on the pins' edges.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub verdict: Option<winch::WinchReport>,
    /// If no edges are known: the positions that the board reported.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub word: Option<Vec<AxisReport>>,
    /// The file that could not be written, and why.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unwritten: Option<String>,
}

/// An axis by the board's own positions.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct AxisReport {
    /// x, y, z or a.
    pub axis: String,
    /// The axis's last position, steps.
    pub position: i32,
    /// The path's position at that time, steps.
    pub wanted: f64,
    /// Largest distance of a reported position from the path, steps.
    pub farthest: f64,
    /// Whether the path is at rest there.
    pub is_at_rest: bool,
    /// Whether the path's rest is known. The place where it rests after a drift, or after a stop during a move, depends
    /// on the millisecond in which the board read the line, and nobody saw that millisecond.
    pub is_judged: bool,
}

impl AxisReport {
    /// Whether the axis stands where it should, as far as that is known.
    fn is_ok(&self) -> bool {
        // Half a step, the threshold's 1/64, and 0.1 for the path.
        !self.is_judged || (f64::from(self.position) - self.wanted).abs() < 0.62
    }
}

impl WinchReport {
    /// Whether the board refused no line, no bound broke, and the board answered to the end.
    #[must_use]
    pub fn is_ok(&self) -> bool {
        let word_ok = self.word.iter().flatten().all(AxisReport::is_ok);
        let all_well = self.refusals.is_empty() && self.troubles.is_empty();
        all_well && word_ok && self.verdict.as_ref().is_none_or(|verdict| verdict.ok)
    }
}

/// A run with its verdict.
#[derive(Clone, Debug)]
pub struct Judged {
    /// The report.
    pub report: WinchReport,
    /// The picture.
    pub picture: Picture,
}

/// Judges a run by its edges.
///
/// # Errors
/// If the edges are not in order of time.
pub fn judge(run: &Run, names: Names<'_>, options: &WinchOptions) -> Result<Judged, winch::OutOfOrder> {
    let options = &WinchOptions { origin_s: run.begin as f64 / options.tick_hz, ..options.clone() };
    let mut drawing = Drawing::new(run, options);
    let verdict = winch::judge(&run.told, &run.edges, &run.statuses, run.end, options, &mut drawing)?;
    let report = WinchReport { verdict: Some(verdict), ..names.report(run) };
    Ok(Judged { report, picture: drawing.finish(names.title()) })
}

/// Judges a run without edges, by the positions that the board reported.
#[must_use]
pub fn judge_by_statuses(run: &Run, names: Names<'_>) -> Judged {
    let tick_hz = run.tick_hz as f64;
    let options = WinchOptions { tick_hz, origin_s: run.begin as f64 / tick_hz, ..WinchOptions::default() };
    let mut drawing = Drawing::new(run, &options);
    let mut compared = Compared { run, drawing: &mut drawing, next: [0; 4], words: Vec::new() };
    compared.words.extend(AXES.map(|axis| AxisReport {
        axis: axis.to_string(),
        position: 0,
        wanted: 0.0,
        farthest: 0.0,
        is_at_rest: true,
        is_judged: true,
    }));
    let is_known = winch::predict(&run.told, run.end, &options, &mut compared);
    let mut words = compared.words;
    for (word, is_known) in words.iter_mut().zip(is_known) {
        word.is_judged = word.is_at_rest && is_known;
    }
    let mut report = WinchReport { word: Some(words), ..names.report(run) };
    if run.statuses.is_empty() && report.troubles.is_empty() {
        let what = "no status line came: without one the positions of the axes are not known".to_owned();
        report.troubles.push(Trouble { at_s: report.duration_s, what });
    }
    let picture = Picture { errors: Errors::Unknown, ..drawing.finish(names.title()) };
    Judged { report, picture }
}

/// The names in a report.
#[derive(Clone, Copy, Debug)]
pub struct Names<'a> {
    /// The script's name.
    pub script: &'a str,
    /// What made the steps.
    pub runner: &'a str,
    /// The board's name for itself.
    pub board: &'a str,
}

impl Names<'_> {
    fn title(&self) -> String {
        format!("{} on the {}", self.script, self.runner)
    }

    fn report(&self, run: &Run) -> WinchReport {
        WinchReport {
            script: self.script.to_owned(),
            runner: self.runner.to_owned(),
            board: self.board.to_owned(),
            duration_s: (run.end - run.begin) as f64 / run.tick_hz as f64,
            lines: run.told.len() - usize::from(run.is_stopped),
            unsent: run.unsent,
            refusals: run.refusals.clone(),
            troubles: run.troubles.clone(),
            verdict: None,
            word: None,
            unwritten: None,
        }
    }
}

/// Draws the run while the judge follows the path.
struct Drawing {
    axes: [MotorPicture; 4],
    is_told: [bool; 4],
    /// The path's points for the close view.
    closely: [Vec<(f64, f64)>; 4],
    /// Of this many milliseconds one is drawn.
    every_ms: u64,
    ms: [u64; 4],
    tick_s: f64,
}

/// Number of points of a path in the picture; it may be somewhat more.
const POINTS: u64 = 1000;

impl Drawing {
    fn new(run: &Run, options: &WinchOptions) -> Drawing {
        let axis = |axis: usize| {
            let scale = Scale { unit: "step".into(), steps_per_unit: 1.0, steps_per_rev: 1.0 };
            MotorPicture::new(AXES[axis].to_string(), scale, options.bound_steps)
        };
        let moves = |order: Order| !matches!(order, Order::Stop | Order::Halt);
        let is_told = |axis: usize| run.told.iter().any(|told| told.command.orders[axis].is_some_and(moves));
        Drawing {
            axes: std::array::from_fn(axis),
            is_told: std::array::from_fn(is_told),
            closely: [const { Vec::new() }; 4],
            every_ms: (run.end - run.begin) / (run.tick_hz / 1000) / POINTS + 1,
            ms: [0; 4],
            tick_s: 1.0 / run.tick_hz as f64,
        }
    }

    fn finish(self, title: String) -> Picture {
        let Drawing { axes, is_told, closely, tick_s, .. } = self;
        let mut picture = Picture {
            title,
            tick_s,
            motors: Vec::new(),
            errors: Errors::Steps,
            figures: Vec::new(),
            changes: Vec::new(),
        };
        let mut shown: Vec<_> = axes.into_iter().zip(closely).zip(is_told).filter(|(_, told)| *told).collect();
        picture.motors = shown.iter().map(|((axis, _), _)| axis.clone()).collect();
        if let Some((from, to)) = picture.close_view() {
            for (axis, ((_, closely), _)) in picture.motors.iter_mut().zip(&mut shown) {
                let inside = closely.iter().filter(|(t, _)| (from..=to).contains(t));
                inside.for_each(|(t, position)| axis.want_close(*t, *position));
            }
        }
        picture
    }
}

/// Number of the path's milliseconds that are kept for the close view.
const CLOSE: usize = 2000;

impl Onlooker for Drawing {
    fn path(&mut self, axis: usize, at_s: f64, position: f64, speed: f64) {
        if at_s < 0.0 {
            return;
        }
        if self.ms[axis].is_multiple_of(self.every_ms) {
            self.axes[axis].want(at_s, position, speed);
        }
        self.ms[axis] += 1;
        if self.closely[axis].len() < CLOSE && (position != 0.0 || !self.closely[axis].is_empty()) {
            self.closely[axis].push((at_s, position));
        }
    }

    fn step(&mut self, axis: usize, at_s: f64, position: i64, behind: f64) {
        self.axes[axis].step(at_s, position);
        self.axes[axis].error(at_s, behind);
    }
}

/// Compares the reported positions with the path, and draws both.
struct Compared<'a> {
    run: &'a Run,
    drawing: &'a mut Drawing,
    next: [usize; 4],
    words: Vec<AxisReport>,
}

impl Onlooker for Compared<'_> {
    fn path(&mut self, axis: usize, at_s: f64, position: f64, speed: f64) {
        self.drawing.path(axis, at_s, position, speed);
        let now_us = (at_s + self.run.begin as f64 / self.run.tick_hz as f64) * 1e6;
        while let Some(status) = self.run.statuses.get(self.next[axis])
            && (status.usec as f64) < now_us + 1000.0
        {
            self.next[axis] += 1;
            let said = status.positions[axis];
            self.drawing.axes[axis].step(at_s, said.into());
            let word = &mut self.words[axis];
            (word.position, word.wanted, word.is_at_rest) = (said, position, speed.abs() < 1.0);
            word.farthest = word.farthest.max((f64::from(said) - position).abs());
        }
    }

    fn step(&mut self, _: usize, _: f64, _: i64, _: f64) {}
}

impl Display for WinchReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let WinchReport {
            script,
            runner,
            board,
            duration_s,
            lines,
            unsent,
            refusals,
            troubles,
            verdict,
            word,
            unwritten: _,
        } = self;
        let duration = human::seconds(*duration_s);
        let plural = if *lines == 1 { "" } else { "s" };
        writeln!(f, "{script}: {lines} line{plural} in {duration}, to the {runner} ({board})\n")?;
        match unsent {
            0 => {}
            1 => writeln!(f, "Its last line was not sent: it ended before its time.\n")?,
            _ => writeln!(f, "The last {unsent} of its lines were not sent: it ended before their time.\n")?,
        }
        if let Some(verdict) = verdict {
            self.edges(verdict, f)?;
        }
        if let Some(words) = word {
            writeln!(f, "This is the board's own word: its pins were not measured.\n")?;
            let mut table = Table::new(["axis", "at", "the path", "farthest, in moves a few ms off", "at rest"]);
            for word in words {
                table.row([
                    word.axis.clone(),
                    human::count(word.position.into()),
                    hundredths(word.wanted),
                    human::significant(word.farthest, 3),
                    match (word.is_judged, word.is_ok()) {
                        (false, _) => "not judged".to_owned(),
                        (true, true) => "PASS".to_owned(),
                        (true, false) => "FAIL".to_owned(),
                    },
                ]);
            }
            writeln!(f, "{table}")?;
            if words.iter().any(|word| !word.is_judged) {
                let why = "it moves, or had a drift or was stopped in mid-move, and no absolute target since: where it is depends on \
                           the millisecond in which a line acted";
                writeln!(f, "  not judged: {why}")?;
            }
        }
        for Refusal { at_s, said } in refusals {
            let meaning = meaning(said).map_or_else(String::new, |meaning| format!(" ({meaning})"));
            writeln!(f, "  refused at {}: {said}{meaning}", human::seconds(*at_s))?;
        }
        for Trouble { at_s, what } in troubles {
            writeln!(f, "  the board at {}: {what}", human::seconds(*at_s))?;
        }
        writeln!(f, "{}", if self.is_ok() { "PASS" } else { "FAIL" })
    }
}

/// Rounds to two digits after the point.
fn hundredths(steps: f64) -> String {
    human::significant((steps * 100.0).round() / 100.0, 9)
}

impl WinchReport {
    fn edges(&self, verdict: &winch::WinchReport, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Every edge, against the path in f64:\n")?;
        let mut table =
            Table::new(["axis", "steps", "ends at", "the path", "farthest from it", "rms", "shortest interval"]);
        for axis in &verdict.axes {
            table.row([
                axis.axis.clone(),
                human::count(axis.steps.into()),
                human::count(axis.position.into()),
                hundredths(axis.position_wanted),
                format!("{} step", human::significant(axis.max_error_steps, 2)),
                format!("{} step", human::significant(axis.rms_error_steps, 2)),
                axis.shortest_interval_us.map_or_else(String::new, |us| human::seconds(us * 1e-6)),
            ]);
        }
        writeln!(f, "{table}")?;
        if let Some((least, most)) = verdict.effect_ms {
            let ms = |ms: f64| human::significant(ms.max(0.0), 2);
            writeln!(f, "  a line acted {} to {} ms after it had come", ms(least), ms(most))?;
        }
        writeln!(f, "  statuses that say what the pins did: {}", verdict.statuses)?;
        for axis in verdict.axes.iter().filter(|axis| axis.max_doubt_steps > 0.05) {
            let doubt = human::significant(axis.max_doubt_steps, 2);
            writeln!(
                f,
                "  {}: what rounding makes grows with these gains; its path is known to {doubt} step by its steps",
                axis.axis
            )?;
        }
        for fault in &verdict.faults {
            writeln!(f, "  {} at {}: {}", fault.axis, human::seconds(fault.at_s), fault.what)?;
        }
        let untold = verdict.fault_count - verdict.faults.len();
        if untold > 0 {
            writeln!(f, "  and {untold} faults more")?;
        }
        Ok(())
    }
}
