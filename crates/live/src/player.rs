//! The loop of a live motion: commands in, a step of the board's time, events out. If the board is lost and may come back, the motion waits for it.
//!
//! The [`Player`] waits for nobody by itself: each [`Player::step`] is one turn of the loop. A program with threads calls it again and again, and lets its
//! [`CommandSource`] wait; a page in a browser calls it from a timer.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use pulsetrain_board::{Leased, Observer, RemoteError};
use pulsetrain_motion::program::Program;
use pulsetrain_report::positions::{start, typed};
use pulsetrain_session::control::{Ended, Status};
use pulsetrain_session::drive::{DriveError, Driven};

use crate::command::RunCommand;
use crate::command_queue::{CommandQueue, CommandSource, MAX_MERGED_COMMANDS};
use crate::event::RunEvent;
use crate::live_run::{LiveRun, SuspendedRun};
use crate::log::{LogEntry, text_hash};
use crate::setpoints::LiveSetpoints;

/// How long the loop waits for commands, at most, before it looks for a lost board again.
const BOARD_LOOK: Duration = Duration::from_millis(300);

/// How a live motion ended: with the counts from where it begins, or `None` if no motor has moved; or why the motors stopped though nobody asked for it.
pub type PlayerEnd = Result<Option<Ended>, DriveError>;

/// The program around a live motion: it publishes events, writes the log, and knows the time.
pub trait LiveHost {
    /// Something happened.
    fn publish(&mut self, event: &RunEvent);

    /// Other setpoints are in force, perhaps with other knobs and cues.
    fn change_setpoints(&mut self, setpoints: &LiveSetpoints) {
        let _ = setpoints;
    }

    /// The board counts from these positions now, steps by motor.
    fn count_from(&mut self, positions: &[f64]) {
        let _ = positions;
    }

    /// The commands that had come are taken: others may come. `clock` is the board's time, and the motion's at that moment, s; `None` without a board.
    fn looked(&mut self, clock: Option<(Duration, f64)>) {
        let _ = clock;
    }

    /// How long the loop is to wait for commands until the time of day is where the board's time is. A real board keeps time by itself, and a virtual one
    /// may run as fast as it can.
    fn ahead(&mut self, board_time: Duration) -> Duration {
        let _ = board_time;
        Duration::ZERO
    }

    /// A time that goes on, from whatever moment it counts: how long a board was away.
    fn now(&self) -> Duration {
        Duration::ZERO
    }

    /// Writes a line of the log. `tick` is the board's, and `at_s` the same from the begin of the motion, s.
    fn log(&mut self, tick: u64, at_s: f64, entry: LogEntry) {
        let _ = (tick, at_s, entry);
    }
}

/// Nobody looks on.
impl LiveHost for () {
    fn publish(&mut self, _event: &RunEvent) {}
}

/// The board of a live motion. A virtual one needs none of this: [`NoPort`].
pub trait LiveBoard<B: Leased> {
    /// Keeps the positions, from time to time.
    fn keep(&mut self, status: &Status, is_resting: bool) {
        let _ = (status, is_resting);
    }

    /// Ends the session in the end. `ended` has the board's counts, if they are known.
    fn close(&mut self, driven: Driven<B>, ended: Option<&Ended>) {
        let _ = ended;
        drop(driven);
    }

    /// The port, if there is one that may come back.
    fn port(&self) -> Option<&str> {
        None
    }

    /// The board is lost: notes what is needed to know it again, and closes the port.
    fn lose(&mut self, driven: Driven<B>) {
        drop(driven);
    }

    /// Looks for the board.
    fn look(&mut self) -> FoundBoard {
        FoundBoard::Nothing
    }

    /// Where the motors stood when they were known last, steps, if they rested there.
    fn last(&self) -> Option<Vec<f64>> {
        None
    }

    /// Begins another session, with the motors at rest at these positions, steps. Gives the program for which it was set up.
    ///
    /// # Errors
    /// If the board is not there, or refuses.
    fn begin(&mut self, positions: &[f64]) -> Result<(Driven<B>, Program), DriveError> {
        let _ = positions;
        Err(DriveError::Remote(RemoteError::Nonsense))
    }
}

/// A board that does not come back once it is lost.
#[derive(Clone, Copy, Debug)]
pub struct NoPort;

impl<B: Leased> LiveBoard<B> for NoPort {}

/// What a look for the board has found.
#[derive(Clone, Debug, PartialEq)]
pub enum FoundBoard {
    /// It is not there, or does not answer yet.
    Nothing,
    /// It is there and still counts: where the motors stand, steps.
    Known(Vec<f64>),
    /// It is there, but the motors' positions are unknown: the reason.
    Unknown(String),
}

/// How a live motion is played.
#[derive(Clone, Debug, Default)]
pub struct PlayerOptions {
    /// Whether the host writes a log.
    pub has_log: bool,
    /// Where the motors stand if the board does not know: each a [`RunCommand::Here`].
    pub here: Vec<RunCommand>,
}

/// A live motion with its board and its commands.
pub struct Player<B: Leased> {
    phase: Phase<B>,
    board: Box<dyn LiveBoard<B> + Send>,
    queue: CommandQueue,
    here: Vec<RunCommand>,
    log: PlayerLog,
    /// Whether other knobs or cues may be there now.
    has_new_setpoints: bool,
}

/// Where the motion is.
enum Phase<B> {
    /// On a board.
    Running(Box<LiveRun<B>>),
    /// Without one.
    Waiting(Box<Waiting>),
    /// It has ended.
    Over,
}

/// A motion that waits for its board, or for somebody who says where the motors are.
struct Waiting {
    suspended: SuspendedRun,
    /// How it ended if it ends here; `None`: no motor has moved.
    lost: Option<DriveError>,
    /// When the board was lost, by the host's clock.
    since: Option<Duration>,
    /// By motor: where it stands, steps, once somebody has said so. `None` as a whole while that need not be said.
    places: Option<Vec<Option<f64>>>,
    /// Why the board could not begin when that was published last.
    last_why: Option<String>,
}

/// What the log needs to know.
struct PlayerLog {
    is_wanted: bool,
    /// The files that are in it: the hash of each one's text.
    files: BTreeMap<PathBuf, u64>,
    /// What happened since the last lines.
    done: Vec<RunEvent>,
    /// Ticks of the sessions before this one.
    base: u64,
    /// The tick of this session at which something was logged last.
    latest: u64,
    /// The tick at which the motion begins, and ticks in a second.
    zero: u64,
    tick_hz: u64,
}

impl PlayerLog {
    fn new(setpoints: &LiveSetpoints, options: &PlayerOptions) -> PlayerLog {
        let mut log = PlayerLog {
            is_wanted: options.has_log,
            files: BTreeMap::new(),
            done: Vec::new(),
            base: 0,
            latest: 0,
            zero: 0,
            tick_hz: setpoints.setup().board.tick_hz,
        };
        log.know(&setpoints.files());
        log
    }

    fn line(&self, host: &mut impl LiveHost, tick: u64, entry: LogEntry) {
        if self.is_wanted {
            let tick = self.base + tick;
            host.log(tick, (tick as f64 - self.zero as f64) / self.tick_hz as f64, entry);
        }
    }

    /// Writes what happened until a tick of this session.
    fn done(&mut self, host: &mut impl LiveHost, tick: u64) {
        self.latest = tick;
        for done in std::mem::take(&mut self.done) {
            self.line(host, tick, LogEntry::Done(done));
        }
    }

    fn know(&mut self, files: &BTreeMap<PathBuf, String>) {
        self.files.extend(files.iter().map(|(name, text)| (name.clone(), text_hash(text))));
    }

    /// Writes the files that a changed motion file names, if they are others than before.
    fn new_files(&mut self, host: &mut impl LiveHost, tick: u64, setpoints: &LiveSetpoints) {
        if !self.is_wanted {
            return;
        }
        let mut files = setpoints.files();
        files.retain(|name, text| self.files.insert(name.clone(), text_hash(text)) != Some(text_hash(text)));
        if !files.is_empty() {
            self.line(host, tick, LogEntry::Files(files));
        }
    }
}

/// Publishes what happens, and keeps it for the log.
struct Publisher<'a, H> {
    host: &'a mut H,
    done: &'a mut Vec<RunEvent>,
    has_new_setpoints: &'a mut bool,
}

impl<H: LiveHost> Publisher<'_, H> {
    fn publish(&mut self, event: RunEvent) {
        self.host.publish(&event);
        *self.has_new_setpoints |= match &event {
            RunEvent::Cue { .. } | RunEvent::Motion { .. } | RunEvent::Began { .. } | RunEvent::TakenBack { .. } => {
                true
            }
            RunEvent::Refused { command, .. } => command.of_session().is_none(),
            _ => false,
        };
        if !matches!(event, RunEvent::Progress { .. } | RunEvent::Status(_)) {
            self.done.push(event);
        }
    }
}

impl<B: Leased> Player<B> {
    /// A motion on its board.
    #[must_use]
    pub fn new(run: LiveRun<B>, board: Box<dyn LiveBoard<B> + Send>, options: PlayerOptions) -> Player<B> {
        let (zero, log) = (run.zero(), PlayerLog::new(run.setpoints(), &options));
        Player::of(Phase::Running(Box::new(run)), PlayerLog { zero, ..log }, board, options)
    }

    /// A motion that waits for its board before it begins.
    #[must_use]
    pub fn waiting(suspended: SuspendedRun, board: Box<dyn LiveBoard<B> + Send>, options: PlayerOptions) -> Player<B> {
        let log = PlayerLog::new(suspended.setpoints(), &options);
        let waiting = Waiting { suspended, lost: None, since: None, places: None, last_why: None };
        Player::of(Phase::Waiting(Box::new(waiting)), log, board, options)
    }

    fn of(phase: Phase<B>, log: PlayerLog, board: Box<dyn LiveBoard<B> + Send>, options: PlayerOptions) -> Player<B> {
        let queue = CommandQueue::default();
        Player { phase, board, queue, here: options.here, log, has_new_setpoints: false }
    }

    /// Takes the commands that have come, and lets a hundredth of a second of the board's time pass; or looks for the board, if it is lost. `Some` when the
    /// motion is over; the caller steps no further then.
    pub fn step(
        &mut self,
        source: &mut impl CommandSource,
        host: &mut impl LiveHost,
        observer: &mut impl Observer,
    ) -> Option<PlayerEnd> {
        match std::mem::replace(&mut self.phase, Phase::Over) {
            Phase::Running(mut run) => match self.perform(&mut run, source, host, observer) {
                None => {
                    self.phase = Phase::Running(run);
                    None
                }
                Some(ended) => self.end_session(*run, ended, host),
            },
            Phase::Waiting(waiting) => self.wait(waiting, source, host),
            Phase::Over => Some(Ok(None)),
        }
    }

    /// The motion as it is wanted; `None` when it is over.
    #[must_use]
    pub fn setpoints(&self) -> Option<&LiveSetpoints> {
        match &self.phase {
            Phase::Running(run) => Some(run.setpoints()),
            Phase::Waiting(waiting) => Some(waiting.suspended.setpoints()),
            Phase::Over => None,
        }
    }

    /// One turn of the loop on a board. `Some` when the session is over.
    fn perform(
        &mut self,
        run: &mut LiveRun<B>,
        source: &mut impl CommandSource,
        host: &mut impl LiveHost,
        observer: &mut impl Observer,
    ) -> Option<Result<Ended, DriveError>> {
        let Player { queue, log, board, has_new_setpoints, .. } = self;
        let (zero, tick_hz) = (run.zero(), log.tick_hz);
        let time = |tick: u64| Duration::from_secs_f64(tick as f64 / tick_hz as f64);
        let motion_s = |tick: u64| tick.saturating_sub(zero) as f64 / tick_hz as f64;
        let mut taken = 0;
        // A stop that ended a search is given at the tick at which it was seen: a replay of the log ends the search there.
        while taken < MAX_MERGED_COMMANDS || queue.stop_waits(source) {
            let wait = host.ahead(time(run.now()));
            let Some(batch) = queue.next(source, wait, run.setpoints()) else { break };
            taken += 1;
            let tick = run.now();
            if log.is_wanted {
                log.line(host, tick, LogEntry::Asked(batch.clone()));
            }
            let mut has_file = false;
            for command in &batch.commands {
                if let RunCommand::Motion { files, .. } = command {
                    has_file = true;
                    // The command's own line has them.
                    log.know(files);
                }
            }
            let mut news = Publisher { host: &mut *host, done: &mut log.done, has_new_setpoints };
            let mut stop_waits = |_| queue.stop_waits(source);
            let handled = run.handle_until(batch, &mut stop_waits, observer, &mut |event| news.publish(event));
            if has_file {
                log.new_files(host, tick, run.setpoints());
            }
            if let Some(over) = handled.transpose() {
                log.done(host, run.now());
                return Some(over);
            }
        }
        host.looked(Some((time(run.now()), motion_s(run.now()))));
        let mut status = None;
        let mut news = Publisher { host: &mut *host, done: &mut log.done, has_new_setpoints };
        let mut stop_waits = |_| queue.stop_waits(source);
        let stepped = run.step_until(&mut stop_waits, observer, &mut |event| {
            if let RunEvent::Status(of_now) = &event {
                status = Some(of_now.clone());
            }
            news.publish(event);
        });
        log.done(host, run.now());
        if let Some(status) = status {
            board.keep(&status, run.is_resting());
        }
        if std::mem::take(has_new_setpoints) {
            host.change_setpoints(run.setpoints());
        }
        stepped.transpose()
    }

    /// The session with the board is over: the motion waits for the board, or ends.
    fn end_session(
        &mut self,
        run: LiveRun<B>,
        ended: Result<Ended, DriveError>,
        host: &mut impl LiveHost,
    ) -> Option<PlayerEnd> {
        let why = ended.as_ref().err().and_then(unplugged).map(ToString::to_string);
        let lost = why.zip(self.board.port().map(str::to_owned)).filter(|_| run.rejoins());
        let Some((why, port)) = lost else {
            // Counts are given from where the motion begins.
            let offsets = counts_from_home(run.setpoints());
            self.board.close(run.into_driven(), ended.as_ref().ok());
            let counted = |counts: &[i64]| counts.iter().zip(&offsets).map(|(count, by)| count + by).collect();
            let ended = ended.map(|ended| Some(Ended { counted: counted(&ended.counted), ..ended }));
            return self.over(ended, host);
        };
        self.log.base += run.now();
        self.publish(RunEvent::Unplugged { why, port }, host);
        let (driven, suspended) = run.suspend();
        self.board.lose(driven);
        let (lost, since) = (ended.err(), Some(host.now()));
        let waiting = Waiting { suspended, lost, since, places: None, last_why: Some(String::new()) };
        self.phase = Phase::Waiting(Box::new(waiting));
        None
    }

    fn over(&mut self, ended: PlayerEnd, host: &mut impl LiveHost) -> Option<PlayerEnd> {
        let latest = self.log.latest;
        self.log.done(host, latest);
        self.log.line(host, latest, LogEntry::Over);
        Some(ended)
    }

    fn publish(&mut self, event: RunEvent, host: &mut impl LiveHost) {
        let Player { log, has_new_setpoints, .. } = self;
        Publisher { host, done: &mut log.done, has_new_setpoints }.publish(event);
    }

    /// One turn of the loop without a board. If the motors' positions are unknown, it waits for [`RunCommand::Here`], too.
    fn wait(
        &mut self,
        mut waiting: Box<Waiting>,
        source: &mut impl CommandSource,
        host: &mut impl LiveHost,
    ) -> Option<PlayerEnd> {
        let known = match &waiting.places {
            Some(places) => places.iter().copied().collect::<Option<Vec<f64>>>(),
            None => match self.board.look() {
                FoundBoard::Known(positions) => Some(positions),
                FoundBoard::Unknown(why) => {
                    self.ask_for_places(&mut waiting, why, host);
                    None
                }
                FoundBoard::Nothing => None,
            },
        };
        if let Some(positions) = known {
            match self.board.begin(&positions) {
                Ok(begun) => {
                    self.rejoin(*waiting, begun, &positions, host);
                    return None;
                }
                Err(error) => {
                    let why = error.to_string();
                    if waiting.last_why.replace(why.clone()).as_ref() != Some(&why) {
                        let port = self.board.port().unwrap_or_default().to_owned();
                        self.publish(RunEvent::Unplugged { why, port }, host);
                    }
                }
            }
        }
        self.log.done(host, 0);
        let mut wait = BOARD_LOOK;
        while let Some(batch) = self.queue.next_without_board(source, wait) {
            wait = Duration::ZERO;
            if self.log.is_wanted {
                self.log.line(host, 0, LogEntry::Asked(batch.clone()));
            }
            for command in batch.commands {
                match command {
                    stop if stop.is_stop() => {
                        return self.over(waiting.lost.map_or(Ok(None), Err), host);
                    }
                    RunCommand::Here { .. } if waiting.places.is_some() => self.place(&mut waiting, command, host),
                    command => {
                        let Player { log, has_new_setpoints, .. } = &mut *self;
                        let mut news = Publisher { host: &mut *host, done: &mut log.done, has_new_setpoints };
                        waiting.suspended.handle(command, &mut |event| news.publish(event));
                    }
                }
            }
        }
        if std::mem::take(&mut self.has_new_setpoints) {
            host.change_setpoints(waiting.suspended.setpoints());
        }
        host.looked(None);
        self.phase = Phase::Waiting(waiting);
        None
    }

    /// The board does not know where the motors are: somebody has to say it.
    fn ask_for_places(&mut self, waiting: &mut Waiting, why: String, host: &mut impl LiveHost) {
        let motors = &waiting.suspended.setpoints().setup().motors;
        let last = self.board.last().unwrap_or_default();
        let last = last.iter().zip(motors);
        let last = last.map(|(steps, motor)| format!("{} {}", motor.name, typed(*steps, &motor.scale))).collect();
        let names: Vec<String> = motors.iter().map(|motor| motor.name.clone()).collect();
        waiting.places = Some(vec![None; names.len()]);
        self.publish(RunEvent::Unplaced { why, last, motors: names }, host);
        for command in std::mem::take(&mut self.here) {
            self.place(waiting, command, host);
        }
    }

    /// Notes where motors stand.
    fn place(&mut self, waiting: &mut Waiting, command: RunCommand, host: &mut impl LiveHost) {
        let (RunCommand::Here { motor, position }, Some(places)) = (&command, &mut waiting.places) else { return };
        let setpoints = waiting.suspended.setpoints();
        match setpoints.places(motor.as_deref(), position, self.board.last().as_deref()) {
            Ok(found) => {
                let motors = &setpoints.setup().motors;
                let names = found.iter().map(|(motor, _)| motors[*motor].name.clone()).collect();
                found.iter().for_each(|(motor, steps)| places[*motor] = Some(*steps));
                let position = position.clone();
                self.publish(RunEvent::Placed { motors: names, position }, host);
            }
            Err(error) => {
                let why = error.to_string();
                self.publish(RunEvent::Refused { command, why }, host);
            }
        }
    }

    /// The board is there again, with the motors at rest at these positions, steps.
    fn rejoin(
        &mut self,
        waiting: Waiting,
        (driven, program): (Driven<B>, Program),
        positions: &[f64],
        host: &mut impl LiveHost,
    ) {
        host.count_from(positions);
        let passed = waiting.since.map_or(Duration::ZERO, |since| host.now().saturating_sub(since));
        self.log.done(host, 0);
        let run = waiting.suspended.rejoin_on(driven, &program, passed.as_secs_f64());
        self.log.zero = self.log.base + run.zero();
        host.change_setpoints(run.setpoints());
        self.phase = Phase::Running(Box::new(run));
    }
}

/// Why a run ended since the board cannot be reached any more; `None` if it ended otherwise.
fn unplugged(error: &DriveError) -> Option<&RemoteError> {
    match error {
        DriveError::Halted { why, .. } => unplugged(why),
        DriveError::Remote(error @ (RemoteError::Port(_) | RemoteError::Link(_))) => Some(error),
        _ => None,
    }
}

/// By motor: how many steps from where the motion begins the board counts from.
fn counts_from_home(setpoints: &LiveSetpoints) -> Vec<i64> {
    let starts = setpoints.setup().motors.iter().map(start);
    starts.zip(setpoints.home()).map(|(start, home)| (start - home).round() as i64).collect()
}
