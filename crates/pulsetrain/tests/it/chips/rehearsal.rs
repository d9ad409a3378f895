//! A run's session on the virtual Uno before it goes to a real one: the results for motions that the board can follow,
//! and for others. `serve.rs` tries the command at a port.

use std::io;

use pulsetrain_board::RemoteError;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::Cause;
use pulsetrain_motion::law::Cursor;
use pulsetrain_motion::program::Motor;
use pulsetrain_motion::{Time, file};
use pulsetrain_session::drive::DriveError;
use pulsetrain_session::prepare::Prepared;
use pulsetrain_session::rehearsal::Rehearsed;
use pulsetrain_session::rehearsal::{Failed, Length, What, rehearse};
use pulsetrain_trace::verdict::{Failure, Fault};

const PINS: [(u8, u8); 4] = [(2, 5), (3, 6), (4, 7), (12, 13)];

/// One law for some motors, each `apart_us` after the one before. The planner accepts it at any rate.
fn prepared(motors: usize, apart_us: u32, tolerance: &str, law: &str) -> Prepared {
    let mut text = format!("board = \"uno\"\ntolerance = \"{tolerance}\"\n");
    for ((step, dir), k) in PINS.into_iter().zip(0..).take(motors) {
        text += &format!(
            "[motor.m{step}]\nsteps_per_rev = 200\nmicrosteps = 8\ndriver = \"TMC2209\"\npins = {{ step = {step}, dir = {dir} }}\n\
             forward = \"high\"\n[[motion]]\nmotor = \"m{step}\"\nstart = \"{} us\"\n{law}\n",
            k * apart_us,
        );
    }
    let mut program = file::read(&text, "motion.toml", &|_| Err(io::ErrorKind::NotFound.into())).unwrap();
    program.board.min_interval_ticks = vec![60; 4];
    Prepared {
        file: "motion.toml".to_owned(),
        program,
        cut: None,
        pause: None,
        line: None,
        tables: Vec::new(),
        recordings: Vec::new(),
    }
}

/// A trapezoid of 1.75 s with ramps of half a second.
fn ramps(rate: u32) -> String {
    let (distance, acceleration) = (rate / 4 * 5, 2 * rate);
    format!(
        "law.trapezoid = {{ distance = \"{distance} step\", speed = \"{rate} step/s\", acceleration = \"{acceleration} step/s^2\" }}"
    )
}

/// Rehearses its first seconds. Gives how much was played, too, s.
fn rehearsed(prepared: &Prepared, seconds: f64) -> (Result<Rehearsed, Failed>, f64) {
    let mut heard = 0.0;
    let length = Length::exactly(&prepared.program, seconds);
    let done = rehearse(prepared, Baud::B1M, length, |seconds| heard = f64::max(heard, seconds));
    (done, heard)
}

fn refused(prepared: &Prepared) -> Failed {
    let (done, _) = rehearsed(prepared, 10.0);
    done.expect_err("the board keeps up")
}

#[test]
fn what_the_board_keeps_up_with_is_played_to_its_end_or_as_far_as_is_asked_for() {
    let prepared = prepared(2, 25, "1 us", &ramps(20_000));
    let (done, heard) = rehearsed(&prepared, 10.0);
    let done = done.unwrap();
    assert!(done.length.is_all() && (1.7..1.8).contains(&heard), "{heard}");
    assert!(done.report.motors.iter().all(|motor| motor.steps_got == 25_000), "{:?}", done.report);
    assert!((1.0..done.bound_ticks).contains(&done.max_error_ticks()), "{done:?}");
    let (done, heard) = rehearsed(&prepared, 0.6);
    let done = done.unwrap();
    assert!(!done.length.is_all() && heard == 0.6, "{heard}");
    // 5000 on the ramp of half a second, and 2000 after it.
    let steps: Vec<_> = done.report.motors.iter().map(|motor| motor.steps_got).collect();
    assert!(steps.iter().all(|steps| (6995..7005).contains(steps)), "{steps:?}");
}

/// Four motors that reverse 400 times a second after a calm second need more bytes than the line carries.
#[test]
fn a_queue_that_is_too_short_is_told_with_motor_time_and_rates() {
    let law = "law.then = [ { sine = { amplitude = \"20 step\", period = \"1 s\", cycles = 1 } }, \
               { sine = { amplitude = \"3 step\", period = \"5 ms\", cycles = 40 } } ]";
    let prepared = prepared(4, 0, "0.05 us", law);
    let failed = refused(&prepared);
    let What::Session { why, at_s: Some(at_s), first: None } = &failed.what else { panic!("{failed}") };
    assert!(matches!(**why, DriveError::QueueTooShort { .. }) && (0.9..1.1).contains(at_s), "{failed}");
    let said = failed.to_string();
    assert!(said.starts_with("rehearsed on the virtual Uno, at ") && said.contains(" queue for motor m"), "{said}");
    let law = |motor: &Motor| Cursor::new(&motor.law).at(Time::from_seconds(*at_s)).unwrap().speed.abs();
    let rates = prepared.program.motors.iter().map(|motor| (motor.name.clone(), law(motor)));
    assert_eq!(failed.rates, rates.filter(|(_, rate)| *rate >= 1.0).collect());
    let advice = failed.advice();
    for wanted in ["nothing has moved", "slower motors", "another tolerance", "--no-rehearsal begins all the same"] {
        assert!(advice.contains(wanted), "{wanted}: {advice}");
    }
    // The calm second alone is not refused.
    let (done, heard) = rehearsed(&prepared, 0.5);
    assert!(done.is_ok() && heard == 0.5, "{done:?}");
}

/// Here the run does not even begin.
#[test]
fn a_queue_that_is_too_short_for_the_beginning_is_told_as_that() {
    let law = "law.sine = { amplitude = \"3 step\", period = \"5 ms\", cycles = 40 }";
    let failed = refused(&prepared(4, 0, "0.05 us", law));
    let What::Session { why, at_s: Some(at_s), .. } = &failed.what else { panic!("{failed}") };
    assert!(matches!(**why, DriveError::QueueTooShort { .. }) && *at_s < 0.01, "{failed}");
    assert!(failed.advice().contains("another tolerance"), "{}", failed.advice());
}

/// The first motor with a missing step is named, though the board reports only that it did not keep up.
#[test]
fn a_board_that_stops_at_once_is_told_with_the_step_that_did_not_come() {
    let failed = refused(&prepared(2, 4, "1 us", &ramps(130_000)));
    let What::Session { why, at_s: Some(at_s), first: Some(first) } = &failed.what else { panic!("{failed}") };
    assert!(matches!(**why, DriveError::Remote(RemoteError::Stopped { cause: Cause::Starved })), "{failed}");
    assert!(
        matches!(first, Failure { fault: Fault::Missing { forward: true }, .. }) && first.at_s == *at_s,
        "{failed}"
    );
    // θ = a t² / 2 on the ramp.
    assert!((first.step as f64 / (130_000.0 * at_s * at_s) - 1.0).abs() < 1e-3, "{failed}");
    assert!(failed.to_string().contains("its step generator did not keep up; motor m"), "{failed}");
    let advice = failed.advice();
    assert!(
        advice.contains("(then m2 at ") && advice.contains("k steps/s") && !advice.contains("tolerance"),
        "{advice}"
    );
}

/// On a slow line parts of the plan come late: the error has the time, and advice. On a faster line they are in time.
#[test]
fn a_line_that_is_too_slow_is_told() {
    let law = "law.sine = { amplitude = \"40 step\", period = \"66 ms\", cycles = 15 }";
    let prepared = prepared(4, 3000, "1 us", law);
    let at = |baud| rehearse(&prepared, baud, Length::exactly(&prepared.program, 0.5), |_| {});
    assert!(at(Baud::B1M).is_ok());
    let failed = at(Baud::B115200).unwrap_err();
    let What::Session { why, at_s: Some(at_s), first: None } = &failed.what else { panic!("{failed}") };
    assert!(matches!(**why, DriveError::QueueTooShort { .. } | DriveError::TooLate { .. }) && *at_s < 0.5, "{failed}");
    assert!(failed.advice().contains("faster line (--baud)"), "{}", failed.advice());
}

/// Edges are compared with the law, too: 17 ticks of delay are usual on an Uno, but wrong on a board that is never
/// late.
#[test]
fn a_step_that_is_late_is_told() {
    let mut prepared = prepared(1, 0, "0.1 us", &ramps(1000));
    // The judge takes the edges to be a native board's, which are never late.
    prepared.program.board.name = "native".to_owned();
    prepared.program.board.profile = pulsetrain_motion::boards::find("native").unwrap();
    let (done, heard) = rehearsed(&prepared, 10.0);
    let failed = done.unwrap_err();
    let What::Edge(Failure { fault: Fault::OffTime { error_ticks, .. }, .. }) = failed.what else { panic!("{failed}") };
    assert!((10.0..30.0).contains(&error_ticks) && heard < 0.5, "{failed}, {heard}");
}

#[test]
fn a_session_that_does_not_begin_says_why() {
    let mut prepared = prepared(1, 0, "1 us", &ramps(1000));
    prepared.program.board.tick_hz = 20_000_000;
    let failed = refused(&prepared);
    assert!(matches!(failed.what, What::Session { at_s: None, .. }) && failed.rates.is_empty(), "{failed}");
    assert!(failed.advice().contains("tries it on the board all the same"), "{}", failed.advice());
}
