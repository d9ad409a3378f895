//! Processor time: of a process with all that it started, and of a calibration loop beside it.
//!
//! Cores are shared: the same work takes more processor time while a neighbour uses the caches and the other thread of a core.
//! The loop does the same work again and again, so its time says how much more.

use crate::command::{Done, Failure, target_dir};
use crate::random::Random;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use std::{env, fs};

/// The environment variable with the path to which a stage's process writes its processor time.
pub(crate) const FILE: &str = "XTASK_USAGE";

/// Where the process of this stage is to write.
pub(crate) fn file(stage: &str) -> Done<PathBuf> {
    let folder = target_dir().join("ci");
    let path = folder.join(stage.replace(' ', "-"));
    let made = fs::create_dir_all(&folder).and_then(|()| fs::write(&path, ""));
    made.map(|()| path).map_err(|why| Failure::File { path: folder, why })
}

/// The processor time that a stage's process wrote, s.
pub(crate) fn written(file: &Path) -> Option<f64> {
    fs::read_to_string(file).ok()?.trim().parse().ok()
}

/// Writes the processor time of this process and of all that it started and waited for, if [`FILE`] says where.
pub(crate) fn write() {
    if let (Some(file), Some(seconds)) = (env::var_os(FILE), processor_s()) {
        // Without it, the table has a dash.
        let _ = fs::write(file, seconds.to_string());
    }
}

/// Clock ticks a second in `/proc`: `USER_HZ`, which is 100 on all of Linux's machines that Rust has tools for.
const TICKS_PER_S: f64 = 100.0;

/// Processor time of this process and of all that it started and waited for, s. `None` on systems without `/proc`.
fn processor_s() -> Option<f64> {
    of_stat(&fs::read_to_string("/proc/self/stat").ok()?)
}

/// From the line of `/proc/PID/stat`. Source: proc(5), fields 14 to 17: utime, stime, cutime, cstime.
fn of_stat(line: &str) -> Option<f64> {
    // The second field, a name in parentheses, may contain anything.
    let (_, rest) = line.rsplit_once(')')?;
    let fields: Vec<&str> = rest.split_whitespace().collect();
    let ticks = fields.get(11..15)?.iter().map(|field| field.parse::<u64>().ok());
    Some(ticks.sum::<Option<u64>>()? as f64 / TICKS_PER_S)
}

/// Processor time of one pass of the loop on two free cores of the machine on which the budgets were measured.
pub(crate) const REFERENCE: Duration = Duration::from_micros(5300);
/// From one pass to the next.
const PAUSE: Duration = Duration::from_secs(2);

/// A thread that runs the calibration loop until it is dropped.
pub(crate) struct Calibration {
    passes: Arc<Mutex<Vec<Duration>>>,
    over: Arc<AtomicBool>,
}

/// An instant in a [`Calibration`]: the number of passes until then.
#[derive(Clone, Copy)]
pub(crate) struct Mark(usize);

impl Calibration {
    pub(crate) fn start() -> Calibration {
        let (passes, over) = (Arc::new(Mutex::new(Vec::new())), Arc::new(AtomicBool::new(false)));
        let calibration = Calibration { passes: Arc::clone(&passes), over: Arc::clone(&over) };
        thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                let Some(took) = pass() else { break };
                passes.lock().unwrap_or_else(PoisonError::into_inner).push(took);
                thread::sleep(PAUSE);
            }
        });
        calibration
    }

    pub(crate) fn mark(&self) -> Mark {
        Mark(self.passes.lock().unwrap_or_else(PoisonError::into_inner).len())
    }

    /// The median of the passes since then, in multiples of [`REFERENCE`]; 1 if there were none.
    pub(crate) fn since(&self, mark: Mark) -> f64 {
        let passes = self.passes.lock().unwrap_or_else(PoisonError::into_inner);
        scale(passes.get(mark.0..).unwrap_or_default())
    }
}

impl Drop for Calibration {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Relaxed);
    }
}

fn scale(passes: &[Duration]) -> f64 {
    let mut passes = passes.to_vec();
    passes.sort_unstable();
    passes.get(passes.len() / 2).map_or(1.0, |median| median.as_secs_f64() / REFERENCE.as_secs_f64())
}

/// Does the work once: random numbers, and reads from half a megabyte in a random order, as compilers and emulators do.
/// Gives the processor time of this thread. `None` on systems that do not say it.
fn pass() -> Option<Duration> {
    let begin = thread_time()?;
    let mut random = Random::new(1);
    let mut words = vec![0_u64; 1 << 16];
    for _ in 0..400_000 {
        let number = random.next();
        let at = (number >> 48) as usize;
        words[at] = words[at].rotate_left(7) ^ number;
    }
    black_box(&words);
    thread_time()?.checked_sub(begin)
}

/// Time for which this thread has run on a processor. Source: Linux, Documentation/scheduler/sched-stats.rst, schedstat: ns.
fn thread_time() -> Option<Duration> {
    let text = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(Duration::from_nanos(text.split_whitespace().next()?.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_times_of_a_process_and_its_children_are_added() {
        let line = "42 (a (strange) name) S 1 42 42 0 -1 4194560 9 8 7 6 150 50 1000 300 20 0 1 0 5 6 7";
        assert_eq!(of_stat(line), Some(15.0));
        assert_eq!(of_stat("42 (name) S 1"), None);
    }

    #[test]
    fn the_median_is_the_scale() {
        let passes = [1, 9, 3].map(|times| REFERENCE * times);
        assert_eq!(scale(&passes), 3.0);
        assert_eq!(scale(&[]), 1.0);
    }
}
