//! Clips of a wheel: the tracker, which is Python on OpenCV, and how it is run.
//!
//! The tracker's text is in this program. It runs with the user's Python, which needs OpenCV and PyAV; a message names the
//! commands that install what is missing.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use miette::miette;
use serde::{Deserialize, Serialize};

use crate::console::Console;

const TRACKER: &str = include_str!("tracker.py");
/// What the tracker imports.
const IMPORTS: &str = "import cv2, av, numpy";
/// What has them.
const PACKAGES: &str = "opencv-python-headless av";
/// The variable that names a Python.
const VARIABLE: &str = "PULSETRAIN_PYTHON";

/// What the tracker is asked; the keys are those of its `Settings`.
#[derive(Debug, Default, Serialize)]
pub(crate) struct Settings {
    pub(crate) video: String,
    pub(crate) exposure_s: f64,
    pub(crate) readout_s: Option<f64>,
    pub(crate) slow: f64,
    pub(crate) from_s: Option<f64>,
    pub(crate) to_s: Option<f64>,
    pub(crate) marks: Vec<Vec<f64>>,
    pub(crate) frame: Option<[f64; 2]>,
    pub(crate) corners: Vec<Vec<f64>>,
    pub(crate) picture: Option<String>,
}

/// What the tracker found.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct Tracked {
    /// Time, s; angle and its standard deviation, degrees.
    #[serde(skip_serializing)]
    pub(crate) frames: Vec<[f64; 3]>,
    /// Frames of the clip.
    pub(crate) in_clip: u64,
    /// Frames without a mark.
    pub(crate) lost: u64,
    /// Frames with one mark alone.
    pub(crate) one_mark: u64,
    /// Frames that show the one before again.
    pub(crate) repeated: u64,
    /// Frames whose marks are not where a turning wheel's are.
    pub(crate) not_fitting: u64,
    /// The usual time from frame to frame, s.
    pub(crate) interval_s: f64,
    /// The longest time from frame to frame, s.
    pub(crate) longest_gap_s: f64,
    /// Pixels of the picture.
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// The wheel's centre, pixels.
    pub(crate) centre: [f64; 2],
    /// Both marks, as they are first seen.
    pub(crate) marks: [FoundMark; 2],
    /// Whether the marks look alike.
    pub(crate) alike: bool,
    /// How far they are apart, pixels.
    pub(crate) apart_px: f64,
    /// How oblique the view is; what is left, if marks on the frame corrected it.
    pub(crate) tilt_deg: f64,
    /// Whether marks on the frame corrected the view.
    pub(crate) frame_used: bool,
    /// How much the camera moved, pixels; known with marks on the frame.
    pub(crate) shake_px: f64,
    /// Time from the first row to the last, s, and its standard deviation.
    pub(crate) readout_s: f64,
    pub(crate) readout_sigma_s: f64,
    /// Whether it was given.
    pub(crate) readout_given: bool,
    /// How many times longer than wide marks are seen in the fastest frames.
    pub(crate) stretch: f64,
}

/// A mark on the wheel.
#[derive(Debug, Deserialize, Serialize)]
pub(crate) struct FoundMark {
    pub(crate) colour: String,
    pub(crate) x: f64,
    pub(crate) y: f64,
}

/// A line of the tracker's output.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Reply {
    progress: Option<f64>,
    track: Option<Tracked>,
    error: Option<String>,
    help: String,
}

/// Runs the tracker.
///
/// # Errors
/// When Python or its packages are missing, or the clip cannot be tracked.
pub(crate) fn track(settings: &Settings, python: Option<&Path>, console: &Console<'_>) -> miette::Result<Tracked> {
    let python = find_python(python)?;
    let asked = serde_json::to_string(settings).map_err(|error| miette!("{error}"))?;
    let failed = |error: std::io::Error| miette!("cannot run {}: {error}", python.display());
    let mut tracker = Command::new(&python);
    tracker.arg("-").arg(asked).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = tracker.spawn().map_err(failed)?;
    if let Some(mut input) = child.stdin.take() {
        // If Python ended already, its own message says why.
        let _ = input.write_all(TRACKER.as_bytes());
    }
    let stderr = child.stderr.take();
    let complaint = std::thread::spawn(move || {
        let mut text = Vec::new();
        stderr.map(|mut stderr| stderr.read_to_end(&mut text));
        String::from_utf8_lossy(&text).into_owned()
    });
    let progress = console.progress(1.0, "the clip");
    progress.stage("tracking");
    let mut reply = Reply::default();
    for line in child.stdout.take().into_iter().flat_map(|stdout| BufReader::new(stdout).lines()) {
        let line = line.map_err(failed)?;
        let Ok(next) = serde_json::from_str::<Reply>(&line) else { continue };
        if let Some(share) = next.progress {
            progress.set(share);
        } else {
            reply = next;
        }
    }
    drop(progress);
    child.wait().map_err(failed)?;
    match reply {
        Reply { track: Some(track), .. } => Ok(track),
        Reply { error: Some(error), help, .. } if help.is_empty() => Err(miette!("{error}")),
        Reply { error: Some(error), help, .. } => Err(miette!(help = help, "{error}")),
        _ => {
            let complaint = complaint.join().unwrap_or_default();
            let last = complaint.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it said nothing").to_owned();
            Err(miette!(
                help = format!("newer packages may help: {} -m pip install --upgrade {PACKAGES}", python.display()),
                "the tracker stopped: {last}"
            ))
        }
    }
}

/// The Python that has the packages: the one that was named, else the environment that the message below has a user
/// make, else the system's.
fn find_python(named: Option<&Path>) -> miette::Result<PathBuf> {
    let variable = std::env::var_os(VARIABLE).filter(|value| !value.is_empty()).map(PathBuf::from);
    let is_named = named.is_some() || variable.is_some();
    let candidates = match named.map(Path::to_path_buf).or(variable) {
        Some(python) => vec![python],
        None => {
            let own = environment().map(|folder| inside(&folder, "python"));
            own.into_iter().filter(|python| python.exists()).chain(system_pythons()).collect()
        }
    };
    let mut found = None;
    for python in candidates {
        match says(&python, IMPORTS) {
            Some(true) => return Ok(python),
            Some(false) => found = found.or(Some(python)),
            None if is_named => {
                return Err(miette!(
                    help = format!("name a Python 3 with --python or {VARIABLE}, such as /usr/bin/python3"),
                    "cannot run {}",
                    python.display()
                ));
            }
            None => {}
        }
    }
    Err(missing(found, is_named))
}

/// The error that says what to install.
fn missing(python: Option<PathBuf>, is_named: bool) -> miette::Report {
    let Some(python) = python else {
        let help = if cfg!(windows) {
            "install it from https://python.org, and run this again"
        } else if cfg!(target_os = "macos") {
            "install it, and run this again:\n  brew install python"
        } else {
            "install it, and run this again:\n  sudo apt install python3 python3-venv\n(Debian, Ubuntu; elsewhere: the system's package of Python 3)"
        };
        return miette!(help = help, "Python 3 is missing: the tracker runs on it");
    };
    let what = "the tracker needs the Python packages opencv-python-headless and av";
    if is_named {
        let help = format!("install them, and run this again:\n  {} -m pip install {PACKAGES}", quoted(&python));
        return miette!(help = help, "{what}; {} has not both", python.display());
    }
    let Some(folder) = environment() else {
        return miette!(help = format!("name a Python that has them with --python or {VARIABLE}"), "{what}");
    };
    let mut commands = Vec::new();
    if says(&python, "import venv, ensurepip") == Some(false) && cfg!(target_os = "linux") {
        commands.push("sudo apt install python3-venv".to_owned());
    }
    let shown = from_home(&folder);
    // An environment that is there already may be one whose packages are missing.
    if !inside(&folder, "pip").exists() {
        commands.push(format!("{} -m venv {}", python.display(), quoted(&shown)));
    }
    commands.push(format!("{} install {PACKAGES}", quoted(&inside(&shown, "pip"))));
    let commands: String = commands.iter().map(|command| format!("\n  {command}")).collect();
    miette!(help = format!("install them once, and run this again:{commands}"), "{what}")
}

/// Whether a Python runs a statement without an error. `None` if it cannot be run.
fn says(python: &Path, statement: &str) -> Option<bool> {
    let mut run = Command::new(python);
    run.args(["-c", statement]).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    run.status().ok().map(|status| status.success())
}

fn system_pythons() -> Vec<PathBuf> {
    let names: &[&str] = if cfg!(windows) { &["python", "python3"] } else { &["python3", "python"] };
    names.iter().map(PathBuf::from).collect()
}

/// The folder of the environment with the tracker's packages. `None` if nobody knows a home.
fn environment() -> Option<PathBuf> {
    let folder = |variable: &str| std::env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from);
    let data = if cfg!(windows) {
        folder("LOCALAPPDATA")
    } else {
        folder("XDG_DATA_HOME").or_else(|| folder("HOME").map(|home| home.join(".local").join("share")))
    };
    data.map(|data| data.join("pulsetrain").join("python"))
}

/// A program of an environment.
fn inside(environment: &Path, program: &str) -> PathBuf {
    if cfg!(windows) {
        environment.join("Scripts").join(format!("{program}.exe"))
    } else {
        environment.join("bin").join(program)
    }
}

/// A path as a shell takes it, shorter: `~/…`.
fn from_home(path: &Path) -> PathBuf {
    let home = std::env::var_os("HOME").filter(|home| !home.is_empty() && !cfg!(windows));
    let rest = home.and_then(|home| path.strip_prefix(home).ok().map(Path::to_path_buf));
    rest.map_or_else(|| path.to_path_buf(), |rest| Path::new("~").join(rest))
}

fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    if text.contains(' ') { format!("\"{text}\"") } else { text }
}

/// A path as text for the tracker.
pub(crate) fn text(path: &Path) -> String {
    OsString::from(path).to_string_lossy().into_owned()
}
