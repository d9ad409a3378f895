//! Plays a motion on the virtual Uno before a real Uno gets it, for `bake` and `run --port`.

use miette::miette;
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::Time;
use schemars::JsonSchema;
use serde::Serialize;

use crate::console::Console;
use pulsetrain_motion::human;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_session::rehearsal;
use pulsetrain_session::rehearsal::{Length, Rehearsed};

/// A rehearsal that succeeded, as reports have it.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Rehearsal {
    /// How much was played, s of the laws' time.
    #[serde(rename = "played_s")]
    seconds: f64,
    /// How long it takes until everything was seen once, s. `None` if the motors' phases never repeat.
    #[serde(rename = "of_s", skip_serializing_if = "Option::is_none")]
    of_seconds: Option<f64>,
    /// Lateness of all steps that no shared DIR line delays.
    max_error_ticks: f64,
    /// The bound on it.
    bound_ticks: f64,
    /// Steps that are later than the bound because motors share a DIR line, with their greatest lateness and the
    /// greatest that is allowed.
    steps_put_off: u64,
    /// The greatest lateness of such a step.
    longest_put_off_ticks: f64,
    /// The bound on it.
    put_off_bound_ticks: f64,
    /// The result in words, to follow "rehearsed".
    #[serde(skip)]
    pub(super) says: String,
}

impl Rehearsal {
    /// `put_off_ticks`: the longest delay of a step in the plan.
    ///
    /// # Errors
    /// If a step is later than that delay and the bound of all other steps allow.
    pub(super) fn new(done: &Rehearsed, put_off_ticks: u64, prepared: &Prepared) -> miette::Result<Rehearsal> {
        let Length { seconds, all_s, endless } = done.length;
        let (max_error_ticks, bound_ticks) = (done.max_error_ticks(), done.bound_ticks);
        let much = human::seconds(seconds);
        let much = match (done.length.is_all(), endless, all_s) {
            (true, false, _) => format!("all {much}"),
            (true, true, _) => format!("{much}, each phase of what repeats"),
            (false, false, Some(all_s)) => format!("the first {much} of {}, not the rest", human::seconds(all_s)),
            (false, _, Some(all_s)) => {
                format!("{much}, not each phase of what repeats, which takes {}", human::seconds(all_s))
            }
            (false, _, None) => format!("{much}; motors that repeat come to ever new phases, which were not"),
        };
        let (steps_put_off, longest_put_off_ticks) = done.put_off();
        let put_off_bound_ticks = put_off_ticks as f64 + bound_ticks;
        if longest_put_off_ticks > put_off_bound_ticks {
            let help = "please report this motion file";
            return Err(miette!(
                help = help,
                "{}: rehearsed on the virtual Uno, a step that waits for a shared DIR line comes {longest_put_off_ticks:.1} ticks late, \
                 {put_off_bound_ticks:.1} are promised",
                prepared.file
            ));
        }
        let (every, put_off) = match steps_put_off {
            0 => ("every edge", String::new()),
            steps => {
                let steps = human::count(steps.into());
                let put_off = format!(
                    "; {steps} steps waited for a shared DIR line and came up to {longest_put_off_ticks:.1} ticks late, \
                     {put_off_bound_ticks:.1} are promised"
                );
                ("all other edges", put_off)
            }
        };
        let says = format!(
            "on the virtual Uno: {much}: {every} within {max_error_ticks:.1} ticks of the law, {bound_ticks:.1} are promised{put_off}"
        );
        Ok(Rehearsal {
            seconds,
            of_seconds: all_s,
            max_error_ticks,
            bound_ticks,
            steps_put_off,
            longest_put_off_ticks,
            put_off_bound_ticks,
            says,
        })
    }

    /// Plays a run's session on the virtual Uno, or as much of it as the user wants, before anything is sent to the Uno
    /// at a port.
    pub(super) fn of_run(
        prepared: &Prepared,
        baud: Baud,
        asked: Option<Time>,
        put_off_ticks: u64,
        console: &Console<'_>,
    ) -> miette::Result<Rehearsal> {
        let seconds = asked.map_or(rehearsal::MOST_S, Time::seconds);
        let length = Length::exactly(&prepared.program, seconds);
        let bar = console.progress(length.seconds, &human::seconds(length.seconds));
        bar.stage("rehearsing");
        let done = rehearsal::rehearse(prepared, baud, length, |seconds| bar.set(seconds));
        drop(bar);
        let done = done.map_err(|failed| {
            let help = failed.advice();
            miette!(help = help, "{}: {failed}", prepared.file)
        })?;
        Rehearsal::new(&done, put_off_ticks, prepared)
    }
}
