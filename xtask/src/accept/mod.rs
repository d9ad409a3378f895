//! Plans and runs random realistic motions with the program that users run. What `plan` accepts must run.

mod boundary;
mod expected;
mod motions;
mod outcome;

use crate::command::{self, Done, Failure, command, target_dir};
use crate::programs;
use motions::{BOARDS, Motion, Rig, reproduce};
use outcome::{Ended, Outcome};
use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

/// Which motions are tried.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// How many motions
    #[arg(long, default_value_t = 200, value_name = "N")]
    count: u64,
    /// Another seed makes other motions
    #[arg(long, default_value_t = 1, value_name = "S")]
    seed: u64,
    /// This motion alone, and keep what it wrote
    #[arg(long, value_name = "K")]
    only: Option<u64>,
    /// All on this board; else the boards take turns
    #[arg(long, value_parser = BOARDS)]
    board: Option<String>,
    /// Rate of the lines to the boards; else the usual one
    #[arg(long, value_name = "BAUD")]
    baud: Option<u32>,
    /// Keep every motion's files, with what was run and seen; else those that break
    #[arg(long)]
    keep: bool,
    /// Instead of random motions: the largest peak that runs, of sinusoids in phase, as a table
    #[arg(long, conflicts_with_all = ["count", "only"])]
    boundary: bool,
}

impl Options {
    /// This many random motions, with the boards in turn.
    pub(crate) fn random(count: u64, seed: u64) -> Options {
        Options { count, seed, only: None, board: None, baud: None, keep: false, boundary: false }
    }
}

/// If a process takes longer than this, s, it is taken to hang. The processes of a motion take a few seconds.
const HANGS_S: u64 = 300;
/// Of the runs that pass, one in this many has its trace judged again, from the file.
const VERIFIED: u64 = 4;

/// Tries motions, prints the outcomes, and fails if any broke.
pub(crate) fn run(options: &Options) -> Done {
    let program = Program::build(options.baud)?;
    if options.boundary {
        return boundary::run(&program, options.board.as_deref());
    }
    let numbers = options.only.map_or(0..options.count, |only| only..only + 1);
    let begin = Instant::now();
    let tried: Vec<Tried> = command::side_by_side(numbers, |number| {
        let board = BOARDS[(number % BOARDS.len() as u64) as usize];
        let board = BOARDS.into_iter().find(|name| options.board.as_deref() == Some(name)).unwrap_or(board);
        let tried = program.attempt(options, number, board)?;
        if let Outcome::Broken(why) = &tried.outcome {
            eprintln!("broken: {}: {why}", tried.folder.display());
        }
        Ok(tried)
    })
    .into_iter()
    .collect::<Done<_>>()?;
    let took_s = begin.elapsed().as_secs_f64();
    print!("{}", report(options, &tried));
    println!("\n{} motions in {took_s:.0} s: {:.0} a minute", tried.len(), 60.0 * tried.len() as f64 / took_s);
    let broken = tried.iter().filter(|tried| tried.outcome.is_failure()).count();
    // The rates are those at 1 Mbaud.
    let too_many = options.baud.is_none() && expected::line(&tried).1;
    let passed = tried.iter().filter(|tried| matches!(tried.outcome, Outcome::Passed)).count();
    match (broken, passed) {
        (1.., _) => Err(Failure::Check(format!("{broken} motions broke"))),
        (_, 0) => Err(Failure::Check("no motion passed".to_owned())),
        _ if too_many => {
            Err(Failure::Check("too many motions were refused of those that an Uno is to follow".to_owned()))
        }
        _ => Ok(()),
    }
}

impl Outcome {
    fn is_failure(&self) -> bool {
        match self {
            Outcome::Broken(_) => true,
            Outcome::Refused(_) | Outcome::Passed => false,
        }
    }

    /// The place in [`COLUMNS`], and the program's message.
    fn column(&self) -> (usize, &str) {
        match self {
            Outcome::Refused(why) => (0, why),
            Outcome::Passed => (1, ""),
            Outcome::Broken(why) => (2, why),
        }
    }
}

/// The possible outcomes of a motion.
const COLUMNS: [&str; 3] = ["refused", "passed", "broken"];

/// A motion and its outcome.
struct Tried {
    number: u64,
    board: &'static str,
    motors: usize,
    /// Whether `plan` should accept it: see [`expected::is_expected`].
    expected: bool,
    outcome: Outcome,
    /// Where its files are, or were.
    folder: PathBuf,
}

/// Tables and lists of the outcomes.
fn report(options: &Options, tried: &[Tried]) -> String {
    let baud = options.baud.map_or_else(String::new, |baud| format!(" --baud {baud}"));
    let mut rows: BTreeMap<(usize, usize), [usize; 3]> = BTreeMap::new();
    let mut kinds: [BTreeMap<String, Vec<&Tried>>; 3] = Default::default();
    for motion in tried {
        let (column, why) = motion.outcome.column();
        let board = BOARDS.iter().position(|board| *board == motion.board).unwrap_or(0);
        // A row for each board, and one for each number of its motors.
        for motors in [0, motion.motors] {
            rows.entry((board, motors)).or_default()[column] += 1;
        }
        if !why.is_empty() {
            kinds[column].entry(outcome::kind(why)).or_default().push(motion);
        }
    }
    let mut text = format!(
        "| board | motors | tried | {} |\n|---|---|---|{}\n",
        COLUMNS.join(" | "),
        "---|".repeat(COLUMNS.len())
    );
    for ((board, motors), counts) in rows {
        let tried: usize = counts.iter().sum();
        let motors = if motors == 0 { "all".to_owned() } else { motors.to_string() };
        let counts = counts.map(|count| count.to_string()).join(" | ");
        text.push_str(&format!("| {} | {motors} | {tried} | {counts} |\n", BOARDS[board]));
    }
    text.push_str(&expected::line(tried).0);
    for (column, kinds) in COLUMNS.iter().zip(kinds) {
        let mut kinds: Vec<_> = kinds.into_iter().collect();
        kinds.sort_by_key(|(_, motions)| std::cmp::Reverse(motions.len()));
        for (place, (kind, motions)) in kinds.into_iter().enumerate() {
            if place == 0 {
                text.push_str(&format!("\n{column}:\n"));
            }
            text.push_str(&format!("{:6}  {kind}\n", motions.len()));
            if *column == "broken" {
                for Tried { number, board, folder, outcome, .. } in motions {
                    let why = outcome.column().1.lines().next().unwrap_or_default();
                    text.push_str(&format!(
                        "        {}: {why}\n          {}{baud}\n",
                        folder.display(),
                        reproduce(options.seed, *number, board)
                    ));
                }
            }
        }
    }
    text
}

/// The program that users run.
struct Program {
    binary: PathBuf,
    /// `--baud` and the rate, or nothing.
    baud: Vec<String>,
}

impl Program {
    fn build(baud: Option<u32>) -> Done<Program> {
        programs::build()?;
        let baud = baud.map_or_else(Vec::new, |baud| vec!["--baud".to_owned(), baud.to_string()]);
        Ok(Program { binary: programs::pulsetrain(), baud })
    }

    /// Makes a motion, plans and runs it. Some are judged a second time, from their traces.
    fn attempt(&self, options: &Options, number: u64, board: &'static str) -> Done<Tried> {
        let seed = options.seed;
        let folder = Folder::new(format!("seed-{seed}-{number}-{board}"))?;
        let rig = Rig::new(seed, number, board);
        folder.write("too-fast.toml", rig.too_fast())?;
        let limit_hz = self.limit_hz(&folder, "too-fast.toml")?;
        let motion = rig.motion(limit_hz);
        let motors = motion.motors;
        let expected = board == "uno" && expected::is_expected(&motion, limit_hz);
        let outcome = self.outcome(&folder, &motion, number.is_multiple_of(VERIFIED))?;
        if !options.keep && options.only.is_none() {
            if outcome.is_failure() { folder.remove_run()? } else { folder.remove()? }
        }
        Ok(Tried { number, board, motors, expected, outcome, folder: folder.0 })
    }

    fn outcome(&self, folder: &Folder, motion: &Motion, verify: bool) -> Done<Outcome> {
        for (name, text) in &motion.files {
            folder.write(name, text)?;
        }
        let until: &[&str] = if motion.endless { &["--for", "2 s"] } else { &[] };
        let baud: Vec<&str> = self.baud.iter().map(String::as_str).collect();
        let plan = match outcome::planned(&self.say(folder, "plan", &[&["motion.toml"], until, &baud])?) {
            Ok(plan) => plan,
            Err(outcome) => return Ok(outcome),
        };
        let run = self.say(folder, "run", &[&["motion.toml", "--out", RUN], until, &baud])?;
        let outcome = outcome::ran(&plan, &run);
        if outcome != Outcome::Passed || !verify {
            return Ok(outcome);
        }
        let trace = format!("{RUN}/trace.vcd");
        let pins: &[&str] = if plan["board"] == "uno" { &["--pins"] } else { &[] };
        Ok(outcome::verified(&self.say(folder, "verify", &[&[&trace, "motion.toml"], until, pins])?))
    }

    /// The rate that `plan` allows for this many motors on such pins and drivers, steps/s of each.
    fn limit_hz(&self, folder: &Folder, too_fast: &str) -> Done<f64> {
        let ended = self.say(folder, "plan", &[&[too_fast, "--yes"]])?;
        let said = String::from_utf8_lossy(&ended.stdout);
        let limit = said.split("the board makes ").nth(1).and_then(|rest| rest.split(' ').next()?.parse().ok());
        limit.ok_or_else(|| {
            Failure::Check(format!(
                "{}/{too_fast}: `plan` does not say what the board makes: {said}",
                folder.0.display()
            ))
        })
    }

    /// Runs a command of the program in a folder, with `--json`.
    fn say(&self, folder: &Folder, name: &str, arguments: &[&[&str]]) -> Done<Ended> {
        let mut command = command(&self.binary);
        command.current_dir(&folder.0).arg(name).args(arguments.concat()).arg("--json");
        let ended = ended(&mut command, Duration::from_secs(HANGS_S))?;
        for (ending, said) in [("json", &ended.stdout), ("err", &ended.stderr)] {
            folder.write(&format!("{name}.{ending}"), said)?;
        }
        Ok(ended)
    }
}

/// Runs a process to its end, or ends it after `limit`.
fn ended(command: &mut Command, limit: Duration) -> Done<Ended> {
    let text = format!("{command:?}");
    let failure = |why| Failure::Start { command: text.clone(), why };
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let mut child = child.map_err(failure)?;
    let (sender, ends) = mpsc::channel();
    let read = |pipe: Option<Box<dyn Read + Send>>| {
        let sender = sender.clone();
        thread::spawn(move || {
            let mut said = Vec::new();
            // Output before a pipe broke is kept.
            let _ = pipe.map(|mut pipe| pipe.read_to_end(&mut said));
            let _ = sender.send(());
            said
        })
    };
    let stdout = read(child.stdout.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>));
    let stderr = read(child.stderr.take().map(|pipe| Box::new(pipe) as Box<dyn Read + Send>));
    let until = Instant::now() + limit;
    // Both pipes end with the process.
    let hung = (0..2).any(|_| ends.recv_timeout(until.saturating_duration_since(Instant::now())).is_err());
    if hung {
        child.kill().map_err(failure)?;
    }
    let status = child.wait().map_err(failure)?;
    let [stdout, stderr] = [stdout, stderr].map(|reader| reader.join().unwrap_or_default());
    Ok(Ended { code: status.code(), stdout, stderr, hung })
}

/// The folder in a motion's folder that `run` writes to.
const RUN: &str = "run";

/// A motion's folder, below the target folder.
struct Folder(PathBuf);

impl Folder {
    /// Makes an empty one.
    fn new(name: String) -> Done<Folder> {
        let folder = Folder(target_dir().join("accept").join(name));
        if folder.0.exists() {
            folder.remove()?;
        }
        fs::create_dir_all(&folder.0).map_err(|why| folder.failure(&folder.0, why))?;
        Ok(folder)
    }

    fn write(&self, name: &str, text: impl AsRef<[u8]>) -> Done {
        let path = self.0.join(name);
        fs::write(&path, text).map_err(|why| self.failure(&path, why))
    }

    /// The files of `run` may be large, and can be made again.
    fn remove_run(&self) -> Done {
        let run = self.0.join(RUN);
        if run.exists() { fs::remove_dir_all(&run).map_err(|why| self.failure(&run, why)) } else { Ok(()) }
    }

    fn remove(&self) -> Done {
        fs::remove_dir_all(&self.0).map_err(|why| self.failure(&self.0, why))
    }

    fn failure(&self, path: &Path, why: std::io::Error) -> Failure {
        Failure::File { path: path.to_path_buf(), why }
    }
}
