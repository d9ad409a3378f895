//! Commands to a run, and the events that it tells.

use pulsetrain_board::virtual_uno::VirtualUno;
use pulsetrain_board::{Board as _, Config, Edge, MotorConfig, Native, Port, PortError, Remote, Wiring};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::{LawError, file, template};
use pulsetrain_session::control::{Command, Event, Status};
use pulsetrain_session::drive::{DriveError, Driven, connect};
use pulsetrain_session::prepare::Prepared;
use pulsetrain_session::rehearsal::{Length, rehearse};
use pulsetrain_session::{FARTHEST_BEGIN_S, Session, SessionError};
use pulsetrain_trace::Line;
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

/// Three turns there and back, a rest, three turns: 8 steps a full step, 200 a turn.
fn prepared() -> Prepared {
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let contents = file::read_contents(&template::motion_file("wheel"), "wheel.toml", &no_files);
    Prepared::new("wheel.toml".to_owned(), contents.expect("it is a motion file"), None).expect("it fits an Uno")
}

fn status(event: &Event) -> Option<&Status> {
    if let Event::Status(status) = event { Some(status) } else { None }
}

/// A user reads names and seconds, not indices and ticks.
#[test]
fn refusals_have_names_and_seconds() {
    let prepared = prepared();
    let driven = Driven::native(&prepared).unwrap();
    let tick = driven.zero() + 3 * prepared.program.board.tick_hz / 2;
    let undefined = LawError::Undefined { at_s: 2.0, why: "θ is undefined".to_owned() };
    for (error, part) in [
        (SessionError::Law { motor: 0, error: undefined }, "motor wheel: "),
        (SessionError::Early { at: 7, earliest: tick }, "1.5 s is the earliest"),
        (SessionError::Waiting { at: 7, until: tick }, "from 1.5 s on"),
        (SessionError::Late { at: 7, latest: tick }, "1.5 s is the latest"),
    ] {
        let why = driven.why(error);
        assert!(why.contains(part) && !why.contains("tick"), "{why}");
    }
}

#[test]
fn a_run_is_paused_and_goes_on_and_makes_every_step() {
    let prepared = prepared();
    let (commands, receiver) = channel();
    let (mut told, mut rests_s, mut resumed) = (Vec::new(), f64::INFINITY, false);
    let mut positions = Vec::new();
    let mut driven = Driven::native(&prepared).unwrap();
    let ended = driven.run_with(&receiver, &mut |_: Edge| {}, |event| {
        if let Some(status) = status(&event) {
            if status.at_s >= 1.0 && told.is_empty() {
                commands.send(Command::Pause).unwrap();
                commands.send(Command::Pause).unwrap();
            }
            if status.at_s > rests_s {
                positions.push(status.motors[0].position);
            }
            if status.at_s > rests_s + 3.0 && !resumed {
                resumed = true;
                commands.send(Command::Resume).unwrap();
                commands.send(Command::Resume).unwrap();
            }
        }
        if let Event::Pausing { rests_s: at_s } = event {
            rests_s = at_s;
        }
        if !matches!(event, Event::Progress { .. } | Event::Status(_)) {
            told.push(event);
        }
    });
    let ended = ended.unwrap();
    assert_eq!((ended.counted, ended.stopped), (vec![4800], false));
    // For three seconds it stands where it came to rest.
    assert!(positions.len() > 50 && positions[..50].iter().all(|position| *position == positions[0]), "{positions:?}");
    let [Event::Pausing { rests_s: first }, Event::Pausing { rests_s: second }, rest @ ..] = &told[..] else {
        panic!("{told:?}")
    };
    assert_eq!(first, second, "once is enough");
    let [Event::Resuming { full_speed_s }, Event::Refused { command: Command::Resume, why }, Event::Ended(_)] = rest
    else {
        panic!("{told:?}")
    };
    assert!(*full_speed_s > first + 3.0 && why == "the motion is not paused", "{told:?}");
    assert_eq!(driven.lateness().unwrap().lost, 0);
}

/// Otherwise it would wait for ever.
#[test]
fn a_paused_run_ends_when_nobody_can_send_a_command() {
    let prepared = prepared();
    let (commands, receiver) = channel();
    let mut commands = Some(commands);
    let mut driven = Driven::native(&prepared).unwrap();
    let ended = driven.run_with(&receiver, &mut |_: Edge| {}, |event| {
        if status(&event).is_some_and(|status| status.at_s >= 1.0)
            && let Some(commands) = commands.take()
        {
            commands.send(Command::Pause).unwrap();
        }
    });
    let ended = ended.unwrap();
    // It is paused near the far end of the first swing.
    assert!(ended.stopped && (1600..=3200).contains(&ended.counted[0]), "{ended:?}");
}

/// Time, lease, law, queue and lateness are told as they are.
#[test]
fn a_status_says_where_everything_is() {
    let prepared = prepared();
    let mut driven = Driven::native(&prepared).unwrap();
    let mut seen = Vec::new();
    driven.run(&mut |_: Edge| {}, |event| seen.extend(status(&event).cloned())).unwrap();
    let swing = |at_s: f64| 1600.0 * (1.0 - (std::f64::consts::PI * at_s).cos());
    for status in seen.iter().filter(|status| status.at_s < 6.0) {
        let motor = status.motors[0];
        let (target, speed) = (motor.target.unwrap(), motor.speed.unwrap());
        assert!((target - swing(status.at_s)).abs() < 1e-6, "{status:?}");
        assert!((motor.position as f64 - target).abs() < 0.6 && speed.abs() < 5027.0, "{status:?}");
        assert!(status.lease_s.is_some_and(|lease_s| lease_s > 0.0 && lease_s < 0.6), "{status:?}");
        assert!(motor.queue.0 <= motor.queue.1 && motor.queue.1 > 0, "{status:?}");
    }
    let last = seen.last().unwrap();
    assert_eq!((last.motors[0].position, last.lease_s), (4800, None));
    // The last pulse is matched when it is known that none comes after it.
    assert_eq!(last.lateness.as_ref().map(|lateness| (lateness.edges, lateness.max_ticks)), Some((23_999, 0)));
    assert_eq!(driven.lateness().unwrap().edges, 24_000);
    let text = serde_json::to_string(&Event::Status(last.clone())).unwrap();
    assert_eq!(serde_json::from_str::<Event>(&text).unwrap(), Event::Status(last.clone()));
}

#[test]
fn a_session_lives_in_a_thread_of_its_own() {
    const fn is_send<T: Send>() {}
    const { is_send::<Session<Native>>() };
    const { is_send::<Session<Remote<VirtualUno>>>() };
    let prepared = prepared();
    let mut driven = Driven::native(&prepared).unwrap();
    let (commands, receiver) = channel();
    let (events, told) = channel();
    // Sent before the thread begins: the run is over within milliseconds.
    commands.send(Command::Stop).unwrap();
    let run = thread::spawn(move || {
        driven.run_with(&receiver, &mut |_: Edge| {}, |event| {
            let _ = events.send(event);
        })
    });
    let ended = run.join().unwrap().unwrap();
    assert!(told.iter().any(|event| matches!(event, Event::Stopping { .. })));
    assert!(ended.stopped && ended.counted[0] < 100, "{ended:?}");
}

#[test]
fn a_session_begins_at_the_tick_that_it_is_told() {
    let prepared = prepared();
    let program = &prepared.program;
    let wiring = Wiring::StepDir { step: 0, dir: 1, forward_high: true, pulse_ticks: 16, setup_ticks: 16 };
    let motors = vec![MotorConfig { wiring, pull_in_ticks: 1 }];
    let config = Config { fraction_bits: program.board.registers.fraction_bits, motors };
    let board = || Native::new(&config).unwrap();
    let hz = program.board.tick_hz;
    let mut first = None;
    let mut session = Session::begin_at(board(), program.clone(), 3 * hz).unwrap();
    assert_eq!(session.zero(), 3 * hz);
    let mut look = |edge: Edge| first = first.or(Some(edge.tick).filter(|_| edge.level && edge.line == 0));
    session.advance(4 * hz, &mut look).unwrap();
    let after_s = (first.unwrap() - 3 * hz) as f64 / hz as f64;
    let due_s = (1.0 - (0.5 + 1.0 / 64.0) / 1600.0_f64).acos() / std::f64::consts::PI;
    assert!((after_s - due_s).abs() < 1e-6, "{after_s} {due_s}");

    let latest = FARTHEST_BEGIN_S * hz;
    assert!(Session::begin_at(board(), program.clone(), latest).is_ok());
    let late = Session::begin_at(board(), program.clone(), latest + 1).err();
    assert_eq!(late, Some(SessionError::Late { at: latest + 1, latest }));
    assert!(matches!(Session::begin_at(board(), program.clone(), 5).err(), Some(SessionError::Early { at: 5, .. })));
}

/// A motion that is stopped in its pause has not come to its end.
#[test]
fn a_stop_in_a_pause_says_that_the_motion_was_stopped() {
    let prepared = prepared();
    let (commands, receiver) = channel();
    let (mut rests_s, mut sent) = (None, 0);
    let mut driven = Driven::native(&prepared).unwrap();
    let ended = driven.run_with(&receiver, &mut |_: Edge| {}, |event| {
        if let Some(status) = status(&event) {
            if sent == 0 && status.at_s >= 1.0 {
                sent = 1;
                commands.send(Command::Pause).unwrap();
            }
            if sent == 1 && rests_s.is_some_and(|rests_s| status.at_s > rests_s + 0.5) {
                sent = 2;
                commands.send(Command::Stop).unwrap();
            }
        }
        if let Event::Pausing { rests_s: at_s } = event {
            rests_s = Some(at_s);
        }
    });
    let ended = ended.unwrap();
    assert_eq!((sent, ended.stopped), (2, true));
    assert!((1600..=3200).contains(&ended.counted[0]), "{ended:?}");
}

/// Whoever stops the motors need not wait until commands before were obeyed.
#[test]
fn a_stop_goes_before_commands_that_wait() {
    let prepared = prepared();
    for (stop, is_at_once) in [(Command::Stop, false), (Command::StopNow, true)] {
        let (commands, receiver) = channel();
        for command in [Command::Pause, Command::Resume, Command::Pause, stop] {
            commands.send(command).unwrap();
        }
        let mut told = Vec::new();
        let mut driven = Driven::native(&prepared).unwrap();
        let ended = driven.run_with(&receiver, &mut |_: Edge| {}, |event| {
            if !matches!(event, Event::Progress { .. } | Event::Status(_)) {
                told.push(event);
            }
        });
        assert!(ended.unwrap().stopped);
        let first = told.first();
        let is_right = match first {
            Some(Event::StoppedAtOnce { .. }) => is_at_once,
            Some(Event::Stopping { .. }) => !is_at_once,
            _ => false,
        };
        assert!(is_right, "{told:?}");
    }
}

/// A program without threads steps the motion itself, at times of its own.
#[test]
fn a_motion_that_is_stepped_makes_the_same_edges() {
    let prepared = prepared();
    let (mut run, mut stepped) = (Vec::new(), Vec::new());
    let ended = Driven::native(&prepared).unwrap().run(&mut |edge: Edge| run.push(edge), |_| {}).unwrap();

    let mut driven = Driven::native(&prepared).unwrap();
    let (mut last, mut count) = (None, 0);
    let end = loop {
        count += 1;
        let step = driven.step(None, &mut |edge: Edge| stepped.push(edge), |event| last = Some(event));
        if let Some(end) = step.unwrap() {
            break end;
        }
    };
    assert_eq!((&end, last), (&ended, Some(Event::Ended(ended.clone()))));
    assert!(run == stepped && (100..1000).contains(&count), "{} {} {count}", run.len(), stepped.len());
}

#[test]
fn a_motion_that_is_stepped_obeys_commands() {
    let mut driven = Driven::native(&prepared()).unwrap();
    let (mut events, mut nobody) = (Vec::new(), |_: Edge| {});
    let mut keep = |event| {
        if !matches!(event, Event::Progress { .. } | Event::Status(_)) {
            events.push(event);
        }
    };
    for _ in 0..20 {
        assert_eq!(driven.step(None, &mut nobody, &mut keep).unwrap(), None);
    }
    let mut ended = driven.step(Some(Command::Stop), &mut nobody, &mut keep).unwrap();
    while ended.is_none() {
        ended = driven.step(Some(Command::Stop), &mut nobody, &mut keep).unwrap();
    }
    let ended = ended.unwrap();
    assert!(ended.stopped && ended.counted[0] > 0, "{ended:?}");
    let [Event::Stopping { at_s }, Event::Ended(said)] = &events[..] else { panic!("{events:?}") };
    assert!((1.0..1.5).contains(at_s) && *said == ended, "{events:?}");
}

/// The template's motor may turn 5 times a second, and its motion does so 3.14 times.
#[test]
fn a_tempo_is_what_the_limits_allow_and_says_which_one_it_is() {
    let check = |rate: f64, expected: Result<(f64, Option<&str>), &str>| {
        let mut driven = Driven::native(&prepared()).unwrap();
        let (mut nobody, mut answer) = (|_: Edge| {}, None);
        for _ in 0..20 {
            driven.step(None, &mut nobody, |_| {}).unwrap();
        }
        let mut look = |event| match event {
            Event::Tempo { rate, ceiling, from_s } => answer = Some(Ok((rate, ceiling, from_s))),
            Event::Refused { why, .. } => answer = Some(Err(why)),
            _ => {}
        };
        let mut ended = driven.step(Some(Command::Tempo { rate }), &mut nobody, &mut look).unwrap();
        while ended.is_none() {
            ended = driven.step(None, &mut nobody, |_| {}).unwrap();
        }
        assert_eq!(ended.unwrap().counted, [4800], "{rate}");
        match (answer.unwrap(), expected) {
            (Ok((got, ceiling, from_s)), Ok((rate, why))) => {
                assert!((got - rate).abs() < 1e-2 && (1.0..3.0).contains(&from_s), "{got} from {from_s} s");
                assert_eq!(ceiling.as_deref(), why, "{rate}");
            }
            (Err(why), Err(part)) => assert!(why.contains(part), "{why}"),
            (answer, expected) => panic!("{answer:?}, not {expected:?}"),
        }
    };
    check(0.5, Ok((0.5, None)));
    check(1.5, Ok((1.5, None)));
    check(10.0, Ok((1.54, Some("wheel: max_speed"))));
    for rate in [0.0, -1.0, 10.5, f64::NAN, f64::INFINITY] {
        check(rate, Err("above 0, and at most 10"));
    }
}

#[test]
fn a_tempo_in_a_pause_is_that_of_the_resumption() {
    let mut driven = Driven::native(&prepared()).unwrap();
    let (mut nobody, mut events) = (|_: Edge| {}, Vec::new());
    let commands = [(20, Command::Pause), (40, Command::Tempo { rate: 0.5 }), (60, Command::Resume)];
    let mut ended = None;
    for k in 0.. {
        let command = commands.iter().find(|(at, _)| *at == k).map(|(_, command)| *command);
        ended = driven.step(command, &mut nobody, |event| events.push(event)).unwrap();
        if ended.is_some() {
            break;
        }
    }
    assert_eq!(ended.unwrap().counted, [4800]);
    assert!(events.iter().any(|event| matches!(event, Event::Tempo { rate: 0.5, ceiling: None, .. })));
    let last_s = events.iter().rev().find_map(status).unwrap().at_s;
    // 8.6 s by the file: 1 s before the pause, 2 s in it, and twice what was left.
    assert!((17.5..19.5).contains(&last_s), "{last_s}");
}

/// The template's motor, and another motion of it.
fn moved_by(law: &str) -> Prepared {
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let text = template::motion_file("wheel");
    let head = text.split("[[motion]]").next().unwrap();
    let text = format!("{head}[[motion]]\nmotor = \"wheel\"\n{law}\n");
    let contents = file::read_contents(&text, "wheel.toml", &no_files);
    let contents = contents.unwrap_or_else(|error| panic!("{}", error.plain()));
    Prepared::new("wheel.toml".to_owned(), contents, None).expect("it fits an Uno")
}

/// A formula that gets too fast after a minute: its beginning is proven, and then the rest while it runs.
#[test]
fn a_part_that_is_refused_on_the_way_stops_the_motors_before_it() {
    let mut prepared =
        moved_by(r#"law.formula = { theta = "2*(1 - cos(t)) + (t/120)^8", unit = "rev", duration = "28800 s" }"#);
    assert!(prepared.prove_first(|_| {}).is_ok_and(|proof| !proof.is_whole));
    let mut driven = Driven::native(&prepared).unwrap().proving(&prepared, 10.0).unwrap();
    let mut stopping_s = f64::INFINITY;
    let error = driven.run(&mut |_: Edge| {}, |event| {
        if let Event::Stopping { at_s } = event {
            stopping_s = at_s;
        }
    });
    let error = error.unwrap_err();
    // (d/dt)(t/120)^8 rev is 5 rev/s, the motor's limit, at 222 s.
    let text = error.to_string();
    assert!(text.contains("motor wheel: at t = 2") && text.contains("the motor's limit is 8000"), "{text}");
    assert!(text.contains("the motors braked and stand still: wheel at "), "{text}");
    // The proof is far ahead by then.
    assert!(stopping_s < 100.0, "{stopping_s}");
}

/// The motor's limit is broken after 4 s: the session does not plan so far ahead, and the proof does.
#[test]
fn a_stop_at_once_goes_before_what_the_proof_finds() {
    let slow = r#"law.sine = { amplitude = "0.5 rev", period = "2 s", cycles = 2 }"#;
    let fast = r#"law.sine = { amplitude = "2 rev", period = "1 s", cycles = 1 }"#;
    let prepared = moved_by(&format!("{slow}\n[[motion]]\nmotor = \"wheel\"\n{fast}"));
    let proving = || Driven::native(&prepared).unwrap().proving(&prepared, 0.0).unwrap();
    let step = |driven: &mut Driven<Native>, command| {
        let mut events = Vec::new();
        let stepped = driven.step(command, &mut |_: Edge| {}, |event| events.push(event));
        (stepped, events)
    };
    // Without a command the motors brake because of the refusal.
    let mut driven = proving();
    let (stepped, events) = step(&mut driven, None);
    assert!(matches!((&stepped, &events[0]), (Ok(None), Event::Stopping { .. })), "{stepped:?} {events:?}");
    let mut ended = stepped;
    while let Ok(None) = ended {
        ended = step(&mut driven, None).0;
    }
    let why = ended.unwrap_err().to_string();
    assert!(why.contains("the motor's limit is 8000"), "{why}");

    let (stepped, events) = step(&mut proving(), Some(Command::StopNow));
    let ended = stepped.unwrap().expect("the motors stand");
    assert!(ended.stopped && ended.uncertain.is_some(), "{ended:?}");
    assert!(matches!(events[..], [Event::StoppedAtOnce { .. }, Event::Ended(_)]), "{events:?}");
}

#[test]
fn a_proof_that_is_made_on_the_way_is_the_whole_one() {
    let mut whole = prepared();
    let proven = whole.prove(|_| {}).unwrap();
    let mut driven = Driven::native(&whole).unwrap().proving(&whole, 0.0).unwrap();
    driven.run(&mut |_: Edge| {}, |_| {}).unwrap();
    let planned = driven.planned();
    assert_eq!(planned.len(), 1);
    assert_eq!((&planned[0].certificate, planned[0].last_tick), (&proven[0].certificate, proven[0].last_tick));
}

/// So that the first step need not wait: ten seconds of it would take half a second to plan.
#[test]
fn of_a_sum_of_thousands_of_terms_only_the_first_seconds_are_proven_before_the_first_step() {
    let proven_s = |terms: u32| {
        let terms = (0..terms).map(|k| format!("{}*cos({}*t)", 0.2 / f64::from(k + 1), 0.3 + f64::from(k) * 0.0007));
        let theta = terms.collect::<Vec<_>>().join("+");
        let mut endless = moved_by(&format!("law.formula = {{ theta = \"{theta}\", unit = \"rev\" }}"));
        let until_s = endless.prove_first(|_| {}).unwrap().until_s;
        // It goes on while the motors move.
        let mut driven = Driven::native(&endless).unwrap().proving(&endless, until_s).unwrap();
        let mut at_s = 0.0;
        while at_s < 1.0 {
            let mut look = |event: Event| at_s = status(&event).map_or(at_s, |status| status.at_s);
            assert_eq!(driven.step(None, &mut |_: Edge| {}, &mut look).unwrap(), None);
        }
        until_s
    };
    assert!(proven_s(10) >= 10.0);
    assert!((2.0..6.0).contains(&proven_s(5000)), "{}", proven_s(5000));
}

/// What repeats is proven for two periods. The motors' limits hold for all time then.
#[test]
fn an_endless_motion_is_proven_for_its_beginning() {
    let text = template::motion_file("wheel").replace("cycles = 3", "cycles = \"forever\"");
    let text = text.split("[[motion]]").take(2).collect::<Vec<_>>().join("[[motion]]");
    let no_files = |_: &std::path::Path| Err(std::io::ErrorKind::NotFound.into());
    let contents = file::read_contents(&text, "wheel.toml", &no_files);
    let contents = contents.unwrap_or_else(|error| panic!("{}", error.plain()));
    let mut endless = Prepared::new("wheel.toml".to_owned(), contents, None).unwrap();
    assert!(endless.prove_first(|_| {}).is_ok_and(|proof| !proof.is_whole));
    let mut driven = Driven::native(&endless).unwrap().proving(&endless, 10.0).unwrap();
    let (mut nobody, mut at_s) = (|_: Edge| {}, 0.0);
    while at_s < 100.0 {
        let mut look = |event: Event| at_s = status(&event).map_or(at_s, |status| status.at_s);
        assert_eq!(driven.step(None, &mut nobody, &mut look).unwrap(), None);
    }
    let mut ended = None;
    while ended.is_none() {
        ended = driven.step(Some(Command::Stop), &mut nobody, |_| {}).unwrap();
    }
    assert!(ended.unwrap().stopped);
}

/// A port of which nothing is known but what the board says, and which is gone after a while.
struct Real {
    uno: VirtualUno,
    gone: Duration,
}

impl Port for Real {
    fn now(&self) -> Duration {
        self.uno.now()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        if self.uno.now() >= self.gone {
            return Err(PortError::Gone { name: "cable".to_owned(), why: "pulled".to_owned() });
        }
        self.uno.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        if self.uno.now() >= self.gone {
            return Err(PortError::Gone { name: "cable".to_owned(), why: "pulled".to_owned() });
        }
        self.uno.receive(until, into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.uno.set_baud(baud)
    }

    fn has_edges(&self) -> bool {
        false
    }
}

/// Runs on the virtual Uno.
mod chips {
    use super::*;

    /// Something new may always come, so a minute is played if nobody says how much.
    #[test]
    fn a_rehearsal_of_a_law_without_an_end_or_a_period_ends() {
        let prepared = moved_by(r#"law.formula = { theta = "2 - cos(t) - cos(sqrt(2)*t)", unit = "rev" }"#);
        let program = &prepared.program;
        let length = Length::of(program);
        assert_eq!((length.seconds, length.all_s, length.endless), (Length::MOST_S, None, true));
        let mut watched = 0.0;
        let length = Length::exactly(program, 1.5);
        let done = rehearse(&prepared, Baud::B1M, length, |at_s| watched = at_s).unwrap();
        assert_eq!((done.length, watched), (length, 1.5));
        let position = 1600.0 * (2.0 - 1.5_f64.cos() - (2.0_f64.sqrt() * 1.5).cos());
        let judged = done.report.motors[0].position_got as f64;
        assert!((judged - position).abs() <= 1.0, "{judged} {position}");
        assert!(done.max_error_ticks() <= done.bound_ticks, "{done:?}");
    }

    /// Of a real board no edge is known: steps must not wait for theirs in memory, and a lateness of 0 would be a lie.
    #[test]
    fn no_lateness_is_told_of_a_real_board() {
        let prepared = prepared();
        let port = Real { uno: VirtualUno::new(), gone: Duration::MAX };
        let mut driven = Driven::at(&prepared, port, Baud::B1M).unwrap();
        let mut seen = 0;
        driven
            .run(&mut |_: Edge| {}, |event| {
                if let Some(status) = status(&event) {
                    assert_eq!(status.lateness, None);
                    seen += 1;
                }
            })
            .unwrap();
        assert!(seen > 100 && driven.lateness().is_none());
    }

    /// Several boards begin together.
    #[test]
    fn a_motion_on_a_board_begins_at_a_given_tick() {
        let prepared = prepared();
        let connected = || connect(VirtualUno::new(), &prepared.program, Baud::B1M).unwrap();
        let begin = connected().now() + 3 * prepared.program.board.tick_hz;
        let mut first = None;
        let mut driven = Driven::on_board(&prepared, connected(), Some(begin)).unwrap();
        assert_eq!(driven.zero(), begin);
        let is_step = |line: &Line| line.names.contains(&"wheel.step".to_owned());
        let step = driven.lines.iter().position(is_step).unwrap() as u8;
        let mut look = |edge: Edge| first = first.or(Some(edge.tick).filter(|_| edge.line == step));
        driven.run(&mut look, |_| {}).unwrap();
        // Ticks are counted from the laws' time 0, and the first step is due as ever.
        let due_s = (1.0 - (0.5 + 1.0 / 64.0) / 1600.0_f64).acos() / std::f64::consts::PI;
        let first_s = first.unwrap() as f64 / prepared.program.board.tick_hz as f64;
        assert!((first_s - due_s).abs() < 2e-6, "{first_s} {due_s}");
        assert!(Driven::on_board(&prepared, connected(), Some(5)).is_err());
    }

    #[test]
    fn a_cable_that_is_pulled_in_a_pause_ends_the_run() {
        let prepared = prepared();
        let port = Real { uno: VirtualUno::new(), gone: Duration::from_secs(5) };
        let (commands, receiver) = channel();
        let mut is_paused = false;
        let mut driven = Driven::at(&prepared, port, Baud::B1M).unwrap();
        let mut last = None;
        let error = driven.run_with(&receiver, &mut |_: Edge| {}, |event| {
            last = Some(event.clone());
            if !is_paused && status(&event).is_some_and(|status| status.at_s >= 1.0) {
                is_paused = true;
                commands.send(Command::Pause).unwrap();
            }
        });
        let error = error.unwrap_err();
        assert!(matches!(error, DriveError::Halted { .. }) && error.to_string().contains("pulled"), "{error}");
        let Some(Event::Failed { why, positions: Some(positions), advice: Some(_), .. }) = &last else {
            panic!("{last:?}")
        };
        assert!(why.contains("pulled") && (1600..=3200).contains(&positions.motors[0].1), "{last:?}");
        let text = serde_json::to_string(&last).unwrap();
        assert_eq!(serde_json::from_str::<Option<Event>>(&text).unwrap(), last);
    }
}
