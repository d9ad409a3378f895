//! When a live motion runs: `[live.schedule]`, and the cues with times of day.
//!
//! A look at the clock says what should be so now. What differs from the look before becomes commands. Nothing is counted down, so that a clock that is
//! set, a computer that slept, and the hours of daylight saving need no care of their own: the next look finds what should be so then.

use jiff::civil::{Date, Weekday, time};
use jiff::{SignedDuration, ZonedDateTime};
use pulsetrain_motion::file::{Live, Period, RestPlace, TimeOfDay};

use crate::command::RunCommand;

/// What should be so at a time.
#[derive(Clone, Debug, PartialEq)]
struct ScheduleState {
    /// Whether it is time for the motion.
    is_time: bool,
    /// The cue that began last, with its time.
    cue: Option<(ZonedDateTime, String)>,
}

/// Looks at the clock, and says what a live motion is to do.
#[derive(Clone, Debug)]
pub struct Scheduler {
    periods: Vec<Period>,
    cues: Vec<(String, Vec<TimeOfDay>)>,
    /// What was so at the last look.
    known: Option<ScheduleState>,
    /// Where the motors rest since the last period.
    rest: RestPlace,
    /// The latest time that was seen.
    latest: Option<ZonedDateTime>,
}

/// A clock that goes back by less than this stands still for the schedule until it is right again: what has begun does not begin twice.
const SMALL_STEP: SignedDuration = SignedDuration::from_mins(10);

impl Scheduler {
    /// The schedule of a motion file. Without times nothing ever is to be done.
    #[must_use]
    pub fn new(live: &Live) -> Scheduler {
        let cues = live.cues.iter().filter(|cue| !cue.at.is_empty());
        Scheduler {
            periods: live.schedule.clone(),
            cues: cues.map(|cue| (cue.name.clone(), cue.at.clone())).collect(),
            known: None,
            rest: RestPlace::AtStart,
            latest: None,
        }
    }

    /// Takes a changed motion file over: what began before does not begin again.
    pub fn change(&mut self, live: &Live) {
        let Scheduler { periods, cues, .. } = Scheduler::new(live);
        (self.periods, self.cues) = (periods, cues);
    }

    /// Whether the motion is to run at that time.
    #[must_use]
    pub fn is_time(&self, now: &ZonedDateTime) -> bool {
        self.wanted(now).is_time
    }

    /// When the motion begins next, and ends, in words: `Mon 30 Nov at 10:00`.
    #[must_use]
    pub fn next_start(&self, now: &ZonedDateTime) -> Option<String> {
        let starts = (0..=8).filter_map(|days| date_in(now, days)).flat_map(|date| {
            self.periods.iter().filter_map(move |period| bounds(period, date, now)).map(|(start, _)| start)
        });
        let next = starts.filter(|start| start > now).min()?;
        let format = if next.second() == 0 { "%a %-d %b at %H:%M" } else { "%a %-d %b at %H:%M:%S" };
        Some(next.strftime(format).to_string())
    }

    /// What is to be done at that time.
    pub fn look(&mut self, now: &ZonedDateTime) -> Vec<RunCommand> {
        let now = match self.latest.take() {
            Some(latest) if *now < latest && latest.duration_since(now) < SMALL_STEP => latest,
            _ => now.clone(),
        };
        let wanted = self.wanted(&now);
        let mut commands = Vec::new();
        let is_first = self.known.is_none();
        let (was_on, had) = match self.known.take() {
            Some(known) => (known.is_time, known.cue),
            // The schedule allows the motion now: it begins without an order.
            None => (wanted.is_time, None),
        };
        match (was_on, wanted.is_time) {
            (false, true) => commands.push(match self.rest {
                RestPlace::AtStart => RunCommand::Begin,
                RestPlace::InPlace => RunCommand::Resume,
            }),
            (true, false) => {
                self.rest = self.rest_of(&now);
                commands.push(self.rest_command(&now));
            }
            (false, false) if is_first => commands.push(self.rest_command(&now)),
            _ => {}
        }
        if let Some((_, name)) = &wanted.cue
            && wanted.cue != had
        {
            commands.push(RunCommand::Cue { name: name.clone() });
        }
        (self.known, self.latest) = (Some(wanted), Some(now));
        commands
    }

    fn rest_command(&self, now: &ZonedDateTime) -> RunCommand {
        RunCommand::Rest { in_place: self.rest == RestPlace::InPlace, until: self.next_start(now).unwrap_or_default() }
    }

    /// Where the motors rest after the period that ended last.
    fn rest_of(&self, now: &ZonedDateTime) -> RestPlace {
        let ends = (-8..=0).filter_map(|days| date_in(now, days)).flat_map(|date| {
            self.periods
                .iter()
                .filter_map(move |period| Some((bounds(period, date, now)?.1, period.rest)))
                .filter(|(stop, _)| stop <= now)
        });
        ends.max_by(|(a, _), (b, _)| a.cmp(b)).map_or(RestPlace::AtStart, |(_, rest)| rest)
    }

    fn wanted(&self, now: &ZonedDateTime) -> ScheduleState {
        let dates = || (-2..=0).filter_map(|days| date_in(now, days));
        let since = if self.periods.is_empty() {
            // It is always time, and a cue of the last day counts.
            now.checked_sub(SignedDuration::from_hours(24)).ok()
        } else {
            let periods =
                dates().flat_map(|date| self.periods.iter().filter_map(move |period| bounds(period, date, now)));
            periods.filter(|(start, stop)| start <= now && now < stop).map(|(start, _)| start).min()
        };
        let cue = since.as_ref().and_then(|since| {
            let all = dates().flat_map(|date| {
                let cues = self.cues.iter().flat_map(|(name, at)| at.iter().map(move |at| (*at, name)));
                cues.filter_map(move |(at, name)| Some((moment(date, at, now)?, name.clone())))
            });
            all.filter(|(at, _)| since <= at && at <= now).max_by(|(a, _), (b, _)| a.cmp(b))
        });
        ScheduleState { is_time: since.is_some(), cue }
    }
}

/// The date so many days after that of a time.
fn date_in(now: &ZonedDateTime, days: i64) -> Option<Date> {
    now.date().checked_add(jiff::Span::new().days(days)).ok()
}

/// A time of day on a date, in the time zone of `like`. An hour that daylight saving leaves out comes an hour later; of one that comes twice, the first counts.
fn moment(date: Date, at: TimeOfDay, like: &ZonedDateTime) -> Option<ZonedDateTime> {
    let [hour, minute, second] = [at.hour, at.minute, at.second].map(u8::cast_signed);
    date.to_datetime(time(hour, minute, second, 0)).to_zoned_datetime(like.time_zone().clone()).ok()
}

/// When a period begins and ends that begins on a date, if it is of that day of the week.
fn bounds(period: &Period, date: Date, like: &ZonedDateTime) -> Option<(ZonedDateTime, ZonedDateTime)> {
    let day = usize::try_from(date.weekday().since(Weekday::Monday)).ok()?;
    let last = if period.stop > period.start { date } else { date.tomorrow().ok()? };
    let bounds = (moment(date, period.start, like)?, moment(last, period.stop, like)?);
    period.days.get(day).is_some_and(|is_day| *is_day).then_some(bounds)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LiveSetpoints, NamedFiles};
    use jiff::Timestamp;
    use jiff::civil::DateTime;
    use jiff::tz::TimeZone;

    /// A scheduler of a motion file with these lines at its end.
    fn scheduler(lines: &str) -> Scheduler {
        let text = format!("{}\n{lines}", pulsetrain_motion::template::motion_file("wheel"));
        let opened = LiveSetpoints::of(&text, "m.toml", None, NamedFiles::none());
        Scheduler::new(&opened.map_err(|error| error.plain()).unwrap().1.live)
    }

    /// A time in central Europe, whose rules are given, since a computer may have no time zones. With an offset it is that instant.
    fn at(text: &str) -> ZonedDateTime {
        let zone = TimeZone::posix("CET-1CEST,M3.5.0,M10.5.0/3").unwrap();
        match text.parse::<Timestamp>() {
            Ok(instant) => instant.to_zoned_datetime(zone),
            Err(_) => text.parse::<DateTime>().unwrap().to_zoned_datetime(zone).unwrap(),
        }
    }

    /// What is asked for at a time, in short.
    fn asked(scheduler: &mut Scheduler, now: &str) -> String {
        let commands = scheduler.look(&at(now));
        let words = commands.iter().map(|request| match request {
            RunCommand::Begin => "begin".to_owned(),
            RunCommand::Rest { in_place, until } => {
                format!("rest{} until {until}", if *in_place { " in place" } else { "" })
            }
            RunCommand::Cue { name } => format!("cue {name}"),
            RunCommand::Resume => "resume".to_owned(),
            other => format!("{other:?}"),
        });
        words.collect::<Vec<_>>().join(", ")
    }

    #[track_caller]
    fn check(lines: &str, looks: &[(&str, &str)]) {
        let mut scheduler = scheduler(lines);
        for (now, expected) in looks {
            assert_eq!(asked(&mut scheduler, now), *expected, "at {now}");
        }
    }

    const CUES: &str = "[[cue]]\nname = \"noon\"\nat = \"12:00\"\nset = { \"wheel.distance\" = \"1 rev\" }\n\
                        [[cue]]\nname = \"late\"\nat = [\"16:00\", \"17:30:30\"]\nset = { \"wheel.distance\" = \"2 rev\" }\n";

    #[test]
    fn it_begins_and_ends_by_the_clock_on_its_days() {
        let lines = "[live.schedule]\nstart = \"10:00\"\nstop = \"18:00\"\ndays = [\"mon\", \"Tuesday\"]\n";
        // 30 November 2026 is a Monday.
        check(
            lines,
            &[
                ("2026-11-28T12:00", "rest until Mon 30 Nov at 10:00"),
                ("2026-11-29T12:00", ""),
                ("2026-11-30T09:59:59", ""),
                ("2026-11-30T10:00", "begin"),
                ("2026-11-30T17:59:59", ""),
                ("2026-11-30T18:00", "rest until Tue 1 Dec at 10:00"),
                ("2026-12-01T10:00:01", "begin"),
                ("2026-12-01T19:00", "rest until Mon 7 Dec at 10:00"),
                ("2026-12-02T12:00", ""),
            ],
        );
        // The schedule allows the motion already: it begins without an order.
        check(lines, &[("2026-11-30T12:00", ""), ("2026-11-30T18:00", "rest until Tue 1 Dec at 10:00")]);
    }

    #[test]
    fn it_may_end_after_midnight_and_have_several_parts() {
        let lines = "[[live.schedule]]\nstart = \"22:00\"\nstop = \"2:00\"\ndays = [\"sat\"]\nrest = \"in-place\"\n\
                     [[live.schedule]]\nstart = \"14:00\"\nstop = \"15:00\"\ndays = [\"sun\"]\n";
        check(
            lines,
            &[
                ("2026-11-28T21:00", "rest until Sat 28 Nov at 22:00"),
                ("2026-11-28T22:00", "begin"),
                ("2026-11-29T01:59", ""),
                ("2026-11-29T02:00", "rest in place until Sun 29 Nov at 14:00"),
                ("2026-11-29T14:00", "resume"),
                ("2026-11-29T15:00", "rest until Sat 5 Dec at 22:00"),
            ],
        );
    }

    #[test]
    fn cues_come_at_their_times_and_a_show_that_begins_later_has_the_last_one() {
        let lines = format!("[live.schedule]\nstart = \"10:00\"\nstop = \"18:00\"\n{CUES}");
        check(
            &lines,
            &[
                ("2026-11-30T09:00", "rest until Mon 30 Nov at 10:00"),
                ("2026-11-30T10:00", "begin"),
                ("2026-11-30T12:00:00.2", "cue noon"),
                ("2026-11-30T12:01", ""),
                ("2026-11-30T16:00", "cue late"),
                ("2026-11-30T17:31", "cue late"),
                ("2026-11-30T18:00", "rest until Tue 1 Dec at 10:00"),
                ("2026-12-01T10:00", "begin"),
                ("2026-12-01T10:01", ""),
            ],
        );
        check(&lines, &[("2026-11-30T13:00", "cue noon"), ("2026-11-30T13:01", "")]);
        // The computer slept.
        check(
            &lines,
            &[("2026-11-30T09:00", "rest until Mon 30 Nov at 10:00"), ("2026-11-30T17:00", "begin, cue late")],
        );
        // Without a schedule the cue of the evening before counts until the next one.
        check(CUES, &[("2026-11-30T08:00", "cue late"), ("2026-11-30T12:00", "cue noon")]);
    }

    #[test]
    fn a_clock_that_is_set_back_a_little_begins_nothing_twice() {
        let lines = format!("[live.schedule]\nstart = \"10:00\"\nstop = \"18:00\"\n{CUES}");
        check(
            &lines,
            &[
                ("2026-11-30T09:59", "rest until Mon 30 Nov at 10:00"),
                ("2026-11-30T10:00", "begin"),
                ("2026-11-30T09:58", ""),
                ("2026-11-30T10:00:01", ""),
                ("2026-11-30T12:00", "cue noon"),
                ("2026-11-30T11:55", ""),
                ("2026-11-30T12:00", ""),
                // By hours: it is followed.
                ("2026-11-30T08:00", "rest until Mon 30 Nov at 10:00"),
                ("2026-11-30T10:00", "begin"),
                // Set forward by a day: it is the same part of the day, but another day's.
                ("2026-12-01T11:00", ""),
            ],
        );
    }

    #[test]
    fn daylight_saving_moves_a_time_that_does_not_exist_and_takes_the_first_of_two() {
        let lines = "[live.schedule]\nstart = \"2:30\"\nstop = \"5:00\"\n";
        // On 28 March 2027 the clock goes from 2:00 to 3:00, on 31 October from 3:00 to 2:00.
        check(
            lines,
            &[
                ("2027-03-28T01:59+01:00", "rest until Sun 28 Mar at 03:30"),
                ("2027-03-28T03:29+02:00", ""),
                ("2027-03-28T03:30+02:00", "begin"),
                ("2027-03-28T05:00+02:00", "rest until Mon 29 Mar at 02:30"),
            ],
        );
        check(
            lines,
            &[
                ("2027-10-31T02:29+02:00", "rest until Sun 31 Oct at 02:30"),
                ("2027-10-31T02:30+02:00", "begin"),
                // The second time that it is 2:29.
                ("2027-10-31T02:29+01:00", ""),
                ("2027-10-31T02:31+01:00", ""),
                ("2027-10-31T05:00+01:00", "rest until Mon 1 Nov at 02:30"),
            ],
        );
    }

    #[test]
    fn wrong_schedules_are_errors_of_the_file() {
        let check = |lines: &str, part: &str| {
            let text = format!("{}\n{lines}", pulsetrain_motion::template::motion_file("wheel"));
            let error = LiveSetpoints::of(&text, "m.toml", None, NamedFiles::none()).unwrap_err().plain();
            assert!(error.contains(part), "{lines}: {error}");
        };
        check("[live.schedule]\nstart = \"10:00\"\n", "`stop`");
        check("[live.schedule]\nstart = \"25:00\"\nstop = \"18:00\"\n", "\"25:00\" is no time of day");
        check("[live.schedule]\nstart = \"10\"\nstop = \"18:00\"\n", "from \"00:00\" to \"23:59\"");
        check("[live.schedule]\nstart = 10\nstop = \"18:00\"\n", "`start`");
        check("[live.schedule]\nstart = \"18:00\"\nstop = \"18:00\"\n", "stops when it starts");
        check("[live.schedule]\nstart = \"10:00\"\nstop = \"18:00\"\ndays = [\"xyz\"]\n", "\"xyz\" is no day");
        check("[live.schedule]\nstart = \"10:00\"\nstop = \"18:00\"\ndays = []\n", "has no day");
        check("[live.schedule]\nstart = \"10:00\"\nstop = \"18:00\"\nrest = \"home\"\n", "at-start");
        check("[live.schedule]\nstrat = \"10:00\"\nstop = \"18:00\"\n", "did you mean `start`?");
        check("[live.shedule]\nstart = \"10:00\"\n", "did you mean `schedule`?");
        check(
            "[[cue]]\nname = \"x\"\nat = \"noon\"\nset = { \"wheel.distance\" = \"1 rev\" }\n",
            "\"noon\" is no time of day",
        );
    }
}
