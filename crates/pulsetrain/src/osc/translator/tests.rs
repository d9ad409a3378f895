use std::time::{SystemTime, UNIX_EPOCH};

use expect_test::{Expect, expect};
use proptest::prelude::*;
use pulsetrain_session::control::{Ended, MotorStatus};
use rosc::OscTime;

use super::*;
use crate::live::KnobValue;
use crate::live::MotorInfo;

fn from(port: u16) -> SocketAddr {
    SocketAddr::from(([127, 0, 0, 1], port))
}

fn info() -> OscInfo {
    let motor = |name: &str, start_steps| MotorInfo {
        name: name.into(),
        unit: "deg".into(),
        steps_per_unit: 10.0,
        start_steps,
        max_speed: None,
    };
    let knob = |name: &str, unit: &str| KnobInfo {
        name: name.into(),
        target: name.into(),
        unit: unit.into(),
        least: Some(0.0),
        greatest: Some(10.0),
        value: 1.0,
    };
    OscInfo {
        motors: vec![motor("first", 0.0), motor("second arm", -100.4)],
        knobs: vec![
            knob("wildness", ""),
            knob("how far?", "deg"),
            knob("first.speed", "deg/s"),
            knob("second arm.law.a", "deg"),
        ],
    }
}

fn message(address: &str, arguments: Vec<OscType>) -> OscPacket {
    OscPacket::Message(OscMessage { addr: address.into(), args: arguments })
}

fn bytes(packet: &OscPacket) -> Vec<u8> {
    rosc::encoder::encode(packet).unwrap()
}

fn bundle(tag: OscTime, content: Vec<OscPacket>) -> OscPacket {
    OscPacket::Bundle(OscBundle { timetag: tag, content })
}

fn text(text: &str) -> OscType {
    OscType::String(text.into())
}

fn argument(argument: &OscType) -> String {
    match argument {
        OscType::Int(number) => format!("(i) {number}"),
        OscType::Long(number) => format!("(h) {number}"),
        OscType::Float(number) => format!("(f) {number}"),
        OscType::String(text) => format!("(s) {text}"),
        other => panic!("no reply has {other:?}"),
    }
}

/// Replies for people: to which port, the address, the arguments.
fn shown(replies: &[OscReply]) -> String {
    let mut all = String::new();
    for OscReply { to, packet } in replies {
        let Ok(([], OscPacket::Message(OscMessage { addr, args }))) = rosc::decoder::decode_udp(packet) else {
            panic!("{packet:?}");
        };
        let args: Vec<String> = args.iter().map(argument).collect();
        all += &format!("{}: {addr} {}\n", to.port(), args.join(" "));
    }
    all
}

/// A moment of a clock that tests set.
fn now() -> Now {
    Now { instant: Instant::now(), system: UNIX_EPOCH + Duration::from_secs(1_795_000_000) }
}

fn after(now: Now, seconds: f64) -> SystemTime {
    now.system + Duration::from_secs_f64(seconds)
}

fn status(at_s: f64, positions: [i64; 2]) -> RunEvent {
    let motor = |position| MotorStatus { position, target: Some(position as f64), speed: Some(0.0), queue: (0, 0) };
    RunEvent::Status(Status { at_s, lease_s: None, motors: positions.map(motor).to_vec(), lateness: None })
}

/// What a message becomes: its requests as JSON, or the reply.
#[track_caller]
fn check(address: &str, arguments: Vec<OscType>, expected: Expect) {
    let mut translator = Translator::new(info(), None);
    translator.happened(&status(1.0, [40, 7]), Instant::now());
    let translation = translator.packet(&bytes(&message(address, arguments)), from(5000), now());
    let mut found = String::new();
    for request in translation.groups.iter().flat_map(|group| &group.requests) {
        found += &(serde_json::to_string(request).unwrap() + "\n");
    }
    found += &shown(&translation.replies);
    expected.assert_eq(&found);
}

#[test]
fn commands() {
    check(
        "/pause",
        vec![],
        expect![[r#"
        {"command":"pause"}
    "#]],
    );
    // A button of a phone, pressed and released.
    check(
        "/resume",
        vec![OscType::Float(1.0)],
        expect![[r#"
        {"command":"resume"}
    "#]],
    );
    check("/resume", vec![OscType::Float(0.0)], expect![""]);
    check(
        "/pulsetrain/stop",
        vec![OscType::Bool(true)],
        expect![[r#"
        {"command":"stop"}
    "#]],
    );
    check(
        "/stop_now",
        vec![OscType::Inf],
        expect![[r#"
        {"command":"stop_now"}
    "#]],
    );
    check(
        "/tempo",
        vec![OscType::Float(0.1)],
        expect![[r#"
        {"command":"tempo","rate":0.1}
    "#]],
    );
    check(
        "/go",
        vec![OscType::Int(1)],
        expect![[r#"
        {"command":"go"}
    "#]],
    );
    check(
        "/back",
        vec![],
        expect![[r#"
        {"command":"back"}
    "#]],
    );
    check(
        "/cue",
        vec![text("the end")],
        expect![[r#"
        {"command":"cue","name":"the end"}
    "#]],
    );
    check(
        "/cue",
        vec![OscType::Int(3)],
        expect![[r#"
        {"command":"cue","name":"3"}
    "#]],
    );
    check(
        "/cue/3",
        vec![OscType::Float(1.0)],
        expect![[r#"
        {"command":"cue","name":"3"}
    "#]],
    );
    check(
        "/goto",
        vec![OscType::Float(0.0)],
        expect![[r#"
        {"command":"goto","position":"0"}
    "#]],
    );
    check(
        "/goto",
        vec![text("90 deg")],
        expect![[r#"
        {"command":"goto","position":"90 deg"}
    "#]],
    );
}

#[test]
fn knobs() {
    check(
        "/wildness",
        vec![OscType::Float(0.3)],
        expect![[r#"
        {"command":"set","knob":"wildness","value":0.3}
    "#]],
    );
    check(
        "/pulsetrain/knob/wildness",
        vec![OscType::Int(2)],
        expect![[r#"
        {"command":"set","knob":"wildness","value":2.0}
    "#]],
    );
    check(
        "/how_far_",
        vec![text("30 deg")],
        expect![[r#"
        {"command":"set","knob":"how far?","value":"30 deg"}
    "#]],
    );
    check(
        "/pulsetrain/second_arm/law/a",
        vec![OscType::Double(0.25), text("rev")],
        expect![[r#"
        {"command":"set","knob":"second arm.law.a","value":"0.25 rev"}
    "#]],
    );
    // What the translator does not know, the motion may.
    check(
        "/pulsetrain/first/amplitude",
        vec![OscType::Long(7)],
        expect![[r#"
        {"command":"set","knob":"first.amplitude","value":7.0}
    "#]],
    );
}

/// Two servers that hear one another must come to an end.
#[test]
fn answers_are_not_answered() {
    let mut translator = Translator::new(info(), None);
    translator.happened(&status(1.0, [40, 7]), Instant::now());
    let mut packets: Vec<Vec<u8>> = [
        ("/bad", vec![]),
        ("/setDestIp", vec![]),
        ("/getPosition", vec![OscType::Int(255)]),
        ("/getPositionList", vec![]),
        ("/getBusy", vec![OscType::Int(1)]),
    ]
    .map(|(address, arguments)| bytes(&message(address, arguments)))
    .to_vec();
    packets.push(b"rubbish".to_vec());
    let mut answer = |packet: &[u8]| translator.packet(packet, from(5000), now()).replies;
    let answers: Vec<OscReply> = packets.iter().flat_map(|packet| answer(packet)).collect();
    assert_eq!(answers.len(), 7);
    for OscReply { packet, .. } in answers {
        assert_eq!(answer(&packet), []);
    }
}

#[test]
fn what_is_misunderstood_is_answered() {
    check(
        "/wildnes",
        vec![OscType::Float(0.3)],
        expect![[r#"
        5000: /error/command (s) /wildnes: this address is unknown; there are /pulsetrain/knob/wildness, /pulsetrain/knob/how_far_, /pulsetrain/first/speed, /pulsetrain/second_arm/law/a, /tempo, /pause, /resume, /stop, /go, /back, /cue (i) 0
    "#]],
    );
    check(
        "/wildness",
        vec![OscType::Float(f32::NAN)],
        expect![[r#"
        5000: /error/command (s) /wildness: NaN is no number (i) 0
    "#]],
    );
    check(
        "/wildness",
        vec![],
        expect![[r#"
        5000: /error/command (s) /wildness: it needs one value: a number, or text with a unit such as "0.9 Hz" (i) 0
    "#]],
    );
    check(
        "/tempo",
        vec![text("fast")],
        expect![[r#"
        5000: /error/command (s) /tempo: WrongDataType: it needs the tempo: 1 is that of the file, as a number (i) 0
    "#]],
    );
    check(
        "/pulsetrain/*/speed",
        vec![OscType::Int(1)],
        expect![[r#"
        5000: /error/command (s) /pulsetrain/*/speed: patterns are not understood: send a message for each motor or knob (i) 0
    "#]],
    );
    check(
        "/getPosition",
        vec![OscType::Int(3)],
        expect![[r#"
        5000: /error/command (s) MotorIdNotMatch: 3 is no motor; there are 1 to 2, and 255 is all (i) 3
    "#]],
    );
    check(
        "/run",
        vec![OscType::Int(2), OscType::Float(100.0)],
        expect![[r#"
        5000: /error/command (s) CommandIgnored: the law of motor second arm has no parameter `speed` that can be changed (i) 2
    "#]],
    );
    check(
        "/move",
        vec![OscType::Int(1), OscType::Int(100)],
        expect![[r#"
        5000: /error/command (s) CommandIgnored: a live motion has one path for all its motors: only /goTo 255 brings them to a position (i) 1
    "#]],
    );
}

/// `[live.knobs]` may give the speed of a motor another name.
#[test]
fn a_named_knob_for_a_speed_is_found_by_what_it_sets() {
    let check = |least: f64, address: &str, arguments: &[OscType], expected: &str| {
        let named = |knob: KnobInfo| match knob.name.as_str() {
            "first.speed" => KnobInfo { name: "pace".into(), least: Some(least), ..knob },
            _ => knob,
        };
        let OscInfo { motors, knobs } = info();
        let mut translator = Translator::new(OscInfo { motors, knobs: knobs.into_iter().map(named).collect() }, None);
        let packet = bytes(&message(address, arguments.to_vec()));
        let translation = translator.packet(&packet, from(5000), now());
        assert_eq!(serde_json::to_string(&translation.groups[0].requests[0]).unwrap(), expected);
    };
    let [run, stop] = [[OscType::Int(1), OscType::Int(-20)].to_vec(), vec![OscType::Int(1)]];
    check(0.0, "/run", &run, r#"{"command":"set","knob":"pace","value":"-20 steps/s"}"#);
    check(0.0, "/softStop", &stop, r#"{"command":"set","knob":"pace","value":"0 steps/s"}"#);
    // This knob would keep the motor running.
    check(0.5, "/softStop", &stop, r#"{"command":"set","knob":"first.speed","value":"0 steps/s"}"#);
}

#[test]
fn commands_of_a_step400() {
    check(
        "/run",
        vec![OscType::Int(1), OscType::Float(-100.5)],
        expect![[r#"
        {"command":"set","knob":"first.speed","value":"-100.5 steps/s"}
    "#]],
    );
    check(
        "/softStop",
        vec![OscType::Int(1)],
        expect![[r#"
        {"command":"set","knob":"first.speed","value":"0 steps/s"}
    "#]],
    );
    // A stop is never refused, whatever it has with it.
    for arguments in [vec![text("now")], vec![text("x"), OscType::Int(1)]] {
        check(
            "/stop",
            arguments,
            expect![[r#"
            {"command":"stop"}
        "#]],
        );
    }
    check("/stop", vec![OscType::Int(0)], expect![""]);
    for arguments in [vec![OscType::Int(2)], vec![OscType::Int(255)], vec![OscType::Int(77)], vec![], vec![text("x")]] {
        check(
            "/softStop",
            arguments.clone(),
            expect![[r#"
            {"command":"pause"}
        "#]],
        );
        check(
            "/hardStop",
            arguments,
            expect![[r#"
            {"command":"stop_now"}
        "#]],
        );
    }
    check(
        "/goTo",
        vec![OscType::Int(255), OscType::Int(-1200)],
        expect![[r#"
        {"command":"goto","position":"-1200 steps"}
    "#]],
    );
    // Floats are taken for whole numbers, as a STEP400 does.
    check(
        "/getPosition",
        vec![OscType::Float(2.0)],
        expect![[r#"
        5000: /position (i) 2 (i) -93
    "#]],
    );
    check(
        "/getPosition",
        vec![OscType::Int(255)],
        expect![[r#"
        5000: /position (i) 1 (i) 40
        5000: /position (i) 2 (i) -93
    "#]],
    );
    check(
        "/getPositionList",
        vec![],
        expect![[r#"
        5000: /positionList (i) 40 (i) -93
    "#]],
    );
    check(
        "/getBusy",
        vec![OscType::Int(1)],
        expect![[r#"
        5000: /busy (i) 1 (i) 0
    "#]],
    );
    check(
        "/setDestIp",
        vec![],
        expect![[r#"
        5000: /destIp (i) 127 (i) 0 (i) 0 (i) 1 (i) 1
    "#]],
    );
}

#[test]
fn one_motor_alone_moves_from_where_it_stands() {
    let mut one = info();
    one.motors.truncate(1);
    let mut translator = Translator::new(one, None);
    let moves = bytes(&message("/move", vec![OscType::Int(1), OscType::Int(-50)]));
    let refused = translator.packet(&moves, from(5000), now());
    assert!(refused.groups.is_empty() && shown(&refused.replies).contains("no position is known yet"));
    translator.happened(&status(1.0, [40, 7]), Instant::now());
    let position = "-10 steps".to_owned();
    let requests = &translator.packet(&moves, from(5000), now()).groups[0].requests;
    assert_eq!(*requests, [RunCommand::Goto { position }]);
    let RunEvent::Status(mut moving) = status(2.0, [41, 7]) else { unreachable!("it is a status") };
    moving.motors[0].speed = Some(3.0);
    translator.happened(&RunEvent::Status(moving), Instant::now());
    assert!(shown(&translator.packet(&moves, from(5000), now()).replies).contains("/move needs a motor at rest"));
}

/// The bytes are what python-osc 1.10.2 made of these numbers: 0.9, and 1 764 294 000.25 s since 1970.
#[test]
fn a_bundle_of_python_osc_is_one_group_at_its_time() {
    let mut packet = b"#bundle\0\xec\xd3{\xf0@\0\0\0\0\0\0\x14/wildness\0\0\0,f\0\0?fff".to_vec();
    packet.extend(b"\0\0\0,/pulsetrain/second/amplitude\0\0\0\0,s\0\x0030 deg\0\0");
    let mut info = info();
    info.motors[1].name = "second".into();
    let sent = UNIX_EPOCH + Duration::from_millis(1_764_294_000_250);
    for (ahead_s, replies) in [(10.0, ""), (0.0, ""), (-0.001, ""), (-0.5, "5000: /pulsetrain/late (f) 0.5\n")] {
        let now = Now { instant: Instant::now(), system: sent - Duration::from_secs(20) };
        let now = Now { system: now.system + Duration::from_secs_f64(20.0 - ahead_s), ..now };
        let mut translator = Translator::new(info.clone(), None);
        let translation = translator.packet(&packet, from(5000), now);
        let [group] = translation.groups.as_slice() else { panic!("{translation:?}") };
        let set = |knob: &str, value| RunCommand::Set { knob: knob.into(), value };
        let amplitude = set("second.amplitude", KnobValue::Text("30 deg".into()));
        assert_eq!(group.requests, [set("wildness", KnobValue::Number(0.9)), amplitude]);
        let ahead = Duration::from_secs_f64(f64::max(ahead_s, 0.0));
        assert!((group.due - now.instant).abs_diff(ahead) < Duration::from_micros(1), "{:?}", group.due - now.instant);
        assert_eq!(shown(&translation.replies), replies);
    }
    // Too far ahead nothing is done.
    let now = Now { instant: Instant::now(), system: sent - Duration::from_secs(61) };
    let translation = Translator::new(info, None).packet(&packet, from(5000), now);
    assert_eq!(translation.groups, []);
    assert_eq!(
        shown(&translation.replies),
        "5000: /error/command (s) the bundle is for 61.0 s from now on this computer's clock; 60 s are the most. Are both clocks right? (i) 0\n"
    );
}

/// A bundle that was passed on for its time, and acts later than that: only its sender hears it.
#[test]
fn the_sender_of_a_bundle_hears_that_it_acts_late() {
    let now = now();
    let mut translator = Translator::new(info(), None);
    translator.packet(&bytes(&message("/setDestIp", vec![])), from(6000), now);
    for (port, ahead_s) in [(5000, 0.03), (5001, 0.05)] {
        let packet = bundle(time_tag::tag_of(after(now, ahead_s)), vec![message("/pause", vec![])]);
        let translation = translator.packet(&bytes(&packet), from(port), now);
        let [Group { sender: Some(sender), .. }] = translation.groups.as_slice() else { panic!("{translation:?}") };
        translator.expect(9.0 + ahead_s, *sender);
    }
    let late = |wanted_s: f64| RunEvent::Late { wanted_s, by_s: 0.25 };
    assert_eq!(shown(&translator.happened(&late(9.03), now.instant)), "5000: /pulsetrain/late (f) 0.25\n");
    // Once; and there is no answer about a time that no bundle had.
    assert_eq!(translator.happened(&late(9.03), now.instant), []);
    assert_eq!(translator.happened(&late(9.04), now.instant), []);
    assert_eq!(shown(&translator.happened(&late(9.05), now.instant)), "5001: /pulsetrain/late (f) 0.25\n");
    assert_eq!(translator.counted().late, 2);
    // One for now acts at once.
    let packet = bundle(time_tag::tag_of(now.system), vec![message("/pause", vec![])]);
    assert_eq!(translator.packet(&bytes(&packet), from(5000), now).groups[0].sender, None);
}

#[test]
fn positions_are_said_and_the_motion_begins() {
    let here = |arguments, expected: Expect| check("/here", arguments, expected);
    here(
        vec![text("0 deg")],
        expect![[r#"
            {"command":"here","motor":null,"position":"0 deg"}
        "#]],
    );
    here(
        vec![text("second arm"), text("90 deg")],
        expect![[r#"
            {"command":"here","motor":"second arm","position":"90 deg"}
        "#]],
    );
    here(
        vec![OscType::Int(2), OscType::Float(0.0)],
        expect![[r#"
            {"command":"here","motor":"second arm","position":"0"}
        "#]],
    );
    here(
        vec![OscType::Int(255), text("last")],
        expect![[r#"
            {"command":"here","motor":null,"position":"last"}
        "#]],
    );
    here(
        vec![OscType::Int(3), text("last")],
        expect![[r#"
            5000: /error/command (s) MotorIdNotMatch: 3 is no motor; there are 1 to 2, and 255 is all (i) 3
        "#]],
    );
    here(
        vec![],
        expect![[r#"
            5000: /error/command (s) /here: it needs a position such as "90 deg"; for one motor its name or number before that (i) 0
        "#]],
    );
    check(
        "/pulsetrain/begin",
        vec![OscType::Int(1)],
        expect![[r#"
            {"command":"begin"}
        "#]],
    );
    check("/begin", vec![OscType::Int(0)], expect![""]);
}

#[test]
fn bundles_in_a_bundle_are_never_earlier_than_it() {
    let now = now();
    let tag = |seconds| time_tag::tag_of(after(now, seconds));
    let at_once = OscTime { seconds: 0, fractional: 1 };
    let pause = || message("/pause", vec![]);
    let packet = bundle(
        tag(2.0),
        vec![
            bundle(tag(3.0), vec![message("/resume", vec![])]),
            pause(),
            bundle(at_once, vec![message("/go", vec![])]),
            message("/nothing", vec![]),
            bundle(tag(99.0), vec![pause()]),
        ],
    );
    let translation = Translator::new(info(), None).packet(&bytes(&packet), from(5000), now);
    let due: Vec<(f64, usize)> = translation
        .groups
        .iter()
        .map(|group| ((group.due - now.instant).as_secs_f64(), group.requests.len()))
        .collect();
    assert!(
        matches!(due.as_slice(), [(a, 1), (b, 1), (c, 1)] if (a - 2.0).abs() < 1e-6 && (b - 3.0).abs() < 1e-6 && c == a),
        "{due:?}"
    );
    assert_eq!(shown(&translation.replies).lines().count(), 2);
}

#[test]
fn clients_hear_what_happens_where_they_listen() {
    let mut translator = Translator::new(info(), Some(9001));
    let mut send = |port: u16, address: &str, arguments: Vec<OscType>| {
        translator.packet(&bytes(&message(address, arguments)), from(port), now()).replies
    };
    assert_eq!(shown(&send(5000, "/setDestIp", vec![])), "9001: /destIp (i) 127 (i) 0 (i) 0 (i) 1 (i) 1\n");
    assert_eq!(shown(&send(5000, "/setDestIp", vec![])), "9001: /destIp (i) 127 (i) 0 (i) 0 (i) 1 (i) 0\n");
    send(5000, "/enableBusyReport", vec![OscType::Int(2), OscType::Int(1)]);
    // Another program, with a port of its own for replies, that wants positions every 100 ms and no errors.
    send(6000, "/setDestIp", vec![OscType::Int(7000)]);
    send(6000, "/setPositionListReportInterval", vec![OscType::Int(100)]);
    send(6000, "/setPositionReportInterval", vec![OscType::Int(1), OscType::Float(1000.0)]);
    send(6000, "/reportError", vec![OscType::Int(0)]);
    assert_eq!(send(6000, "/bad", vec![]), []);
    send(5000, "/pulsetrain/first/amplitude", vec![OscType::Int(3)]);

    let begin = Instant::now();
    let (from_s, until_s) = (1.0, 2.5);
    let set = RunEvent::Set {
        knob: "second arm.law.a".into(),
        value: 3.5,
        unit: "deg".into(),
        ceiling: Some("max_speed of second arm".into()),
        from_s,
        until_s,
    };
    let command = RunCommand::Set { knob: "first.amplitude".into(), value: KnobValue::Number(3.0) };
    let events = [
        (status(1.0, [40, 7]), 0),
        (status(1.05, [41, 7]), 50),
        (set, 60),
        (RunEvent::Cue { name: "storm".into(), from_s, until_s: 3.0 }, 70),
        (status(2.6, [42, 7]), 100),
        (status(3.0, [43, 7]), 200),
        (RunEvent::Tempo { rate: 0.5, from_s: 3.2, ceiling: None }, 210),
        (RunEvent::Refused { command: RunCommand::Resume, why: "it is not paused".into() }, 220),
        (RunEvent::Refused { command, why: "no such parameter".into() }, 230),
        (RunEvent::Ended(Ended { counted: vec![43, 7], stopped: true, uncertain: None }), 240),
    ];
    let mut heard = String::new();
    for (event, ms) in events {
        heard += &shown(&translator.happened(&event, begin + Duration::from_millis(ms)));
    }
    expect![[r#"
        7000: /position (i) 1 (i) 40
        7000: /positionList (i) 40 (i) -93
        9001: /pulsetrain/second_arm/law/a (f) 3.5
        7000: /pulsetrain/second_arm/law/a (f) 3.5
        9001: /pulsetrain/ceiling (s) second arm.law.a (s) max_speed of second arm
        7000: /pulsetrain/ceiling (s) second arm.law.a (s) max_speed of second arm
        9001: /busy (i) 2 (i) 1
        9001: /pulsetrain/cue (s) storm
        7000: /pulsetrain/cue (s) storm
        7000: /positionList (i) 42 (i) -93
        9001: /busy (i) 2 (i) 0
        7000: /positionList (i) 43 (i) -93
        9001: /pulsetrain/tempo (f) 0.5
        7000: /pulsetrain/tempo (f) 0.5
        9001: /busy (i) 2 (i) 1
        9001: /error/command (s) it is not paused (i) 0
        9001: /error/command (s) no such parameter (i) 0
        9001: /pulsetrain/state (s) stopped
        7000: /pulsetrain/state (s) stopped
        9001: /busy (i) 2 (i) 0
    "#]]
    .assert_eq(&heard);
}

#[test]
fn clients_hear_that_a_motion_has_ended_and_begins_again() {
    let mut translator = Translator::new(info(), Some(9001));
    translator.packet(&bytes(&message("/setDestIp", vec![])), from(5000), now());
    let mut heard = |event: RunEvent| shown(&translator.happened(&event, Instant::now()));
    assert_eq!(heard(RunEvent::MotionEnded { at_s: 9.0 }), "9001: /pulsetrain/state (s) ended\n");
    assert_eq!(heard(RunEvent::Began { from_s: 10.0, until_s: 10.1 }), "9001: /pulsetrain/state (s) running\n");
    assert_eq!(heard(RunEvent::AlreadyRuns), "9001: /pulsetrain/state (s) running\n");
}

/// A client that never asked to listen hears why its own command was refused, and nobody else's.
#[test]
fn a_refusal_goes_to_who_asked() {
    let mut translator = Translator::new(info(), None);
    translator.packet(&bytes(&message("/go", vec![])), from(5000), now());
    translator.packet(&bytes(&message("/back", vec![])), from(6000), now());
    let refused = RunEvent::Refused { command: RunCommand::Back, why: "this is the first cue".into() };
    let replies = translator.happened(&refused, Instant::now());
    assert_eq!(shown(&replies), "6000: /error/command (s) this is the first cue (i) 0\n");
}

#[test]
fn replies_about_errors_are_no_flood() {
    let mut translator = Translator::new(info(), None);
    let mut now = now();
    let replies = |translator: &mut Translator, now: Now| {
        (0..1000).map(|_| translator.packet(b"rubbish", from(5000), now).replies.len()).sum::<usize>()
    };
    assert_eq!(replies(&mut translator, now), MOST_ERRORS as usize);
    assert_eq!(translator.counted(), Counted { packets: 1000, malformed: 1000, refused: 1000, late: 0 });
    now.instant += Duration::from_secs(1);
    let again = translator.packet(b"rubbish", from(5000), now);
    assert_eq!(shown(&again.replies).lines().count(), 1);
    // A sender whose clock is behind.
    let late = bytes(&bundle(time_tag::tag_of(now.system - Duration::from_secs(1)), vec![message("/pause", vec![])]));
    let heard = |translator: &mut Translator| translator.packet(&late, from(5000), now).replies.len();
    assert_eq!((0..1000).map(|_| heard(&mut translator)).sum::<usize>(), MOST_ERRORS as usize - 1);
    assert_eq!(translator.counted().late, 1000);
    // A small packet that asks for much.
    translator.happened(&status(1.0, [40, 7]), now.instant);
    let questions = vec![message("/getPosition", vec![OscType::Int(255)]); 100];
    let tag = OscTime { seconds: 0, fractional: 1 };
    assert_eq!(translator.packet(&bytes(&bundle(tag, questions)), from(5000), now).replies.len(), MOST_REPLIES);
}

#[test]
fn packets_beyond_the_limits_are_refused() {
    let tag = OscTime { seconds: 0, fractional: 1 };
    let refusal = |packet: &[u8]| {
        let translation = Translator::new(info(), None).packet(packet, from(5000), now());
        assert_eq!(translation.groups, []);
        shown(&translation.replies)
    };
    let mut deep = message("/pause", vec![]);
    for _ in 0..MOST_BUNDLES {
        deep = bundle(tag, vec![deep]);
    }
    let fits = Translator::new(info(), None).packet(&bytes(&deep), from(5000), now());
    assert_eq!(fits.groups[0].requests, [RunCommand::Pause]);
    assert!(refusal(&bytes(&bundle(tag, vec![deep]))).contains("more than 16 bundles"));
    let long = message("/wildness", vec![text(&"x".repeat(LONGEST_PACKET))]);
    assert!(refusal(&bytes(&long)).contains("more than 4096 bytes"));
    assert!(refusal(&bytes(&message("/wildness", vec![text(&"x".repeat(257))]))).contains("257 bytes"));
    // A second message behind the first, and a part of a bundle that is cut off.
    let two = [bytes(&message("/pause", vec![])), bytes(&message("/pause", vec![]))].concat();
    assert!(refusal(&two).contains("more bytes than its messages"));
    let whole = bytes(&bundle(tag, vec![message("/pause", vec![])]));
    assert!(refusal(&whole[..whole.len() - 4]).contains("no OSC"));
    // Arrays as deep as a packet can have them: they are dropped one in the other.
    let mut arrays = b"/wildness\0\0\0,".to_vec();
    let half = (LONGEST_PACKET - arrays.len()) / 2 - 4;
    arrays.extend(std::iter::repeat_n(b'[', half).chain(std::iter::repeat_n(b']', half)));
    arrays.resize((arrays.len() + 1).next_multiple_of(4), 0);
    assert!(refusal(&arrays).contains("/wildness: WrongDataType"), "{}", refusal(&arrays));
}

fn arguments() -> impl Strategy<Value = Vec<OscType>> {
    let argument = prop_oneof![
        any::<i32>().prop_map(OscType::Int),
        prop_oneof![Just(0), Just(1), Just(2), Just(255)].prop_map(OscType::Int),
        any::<i64>().prop_map(OscType::Long),
        any::<f32>().prop_map(OscType::Float),
        any::<f64>().prop_map(OscType::Double),
        any::<bool>().prop_map(OscType::Bool),
        "\\PC{0,20}".prop_map(OscType::String),
        prop::collection::vec(any::<u8>(), 0..9).prop_map(OscType::Blob),
        (any::<u32>(), any::<u32>()).prop_map(|tag| OscType::Time(tag.into())),
        Just(OscType::Nil),
        Just(OscType::Inf),
    ];
    prop::collection::vec(argument, 0..4)
}

fn messages() -> impl Strategy<Value = OscPacket> {
    let known = prop::sample::select(vec![
        "/pause",
        "/tempo",
        "/go",
        "/cue",
        "/cue/3",
        "/goto",
        "/here",
        "/begin",
        "/wildness",
        "/pulsetrain/first/speed",
        "/pulsetrain",
        "/pulsetrain/",
        "/getPosition",
        "/getPositionList",
        "/getBusy",
        "/enableBusyReport",
        "/reportError",
        "/setPositionReportInterval",
        "/setPositionListReportInterval",
        "/setDestIp",
        "/hardStop",
        "/softStop",
        "/run",
        "/goTo",
        "/move",
        "/",
        "//",
    ]);
    let address = prop_oneof![known.prop_map(str::to_owned), "/[ -~/]{0,30}"];
    (address, arguments()).prop_map(|(address, arguments)| message(&address, arguments))
}

fn packets() -> impl Strategy<Value = OscPacket> {
    let tag = prop_oneof![Just((0, 1)), any::<(u32, u32)>(), (3_900_000_000_u32..4_100_000_000, any::<u32>()),];
    messages().prop_recursive(3, 12, 4, move |inner| {
        (tag.clone(), prop::collection::vec(inner, 0..4)).prop_map(|(tag, content)| bundle(tag.into(), content))
    })
}

proptest! {
    #[test]
    fn any_bytes_are_answered_without_a_panic(
        start in prop_oneof![Just(&b""[..]), Just(&b"/pause\0\0,"[..]), Just(BUNDLE), Just(&b"#bundle\0\0\0\0\0\0\0\0\x01\0\0\0"[..])],
        rest in prop::collection::vec(prop_oneof![Just(0), Just(b'/'), Just(b','), any::<u8>()], 0..300),
    ) {
        let mut translator = Translator::new(info(), None);
        let packet = [start, rest.as_slice()].concat();
        let translation = translator.packet(&packet, from(5000), now());
        prop_assert_eq!(translator.counted().packets, 1);
        prop_assert!(translator.counted().malformed == 0 || translation.groups.is_empty() && translation.replies.len() == 1);
    }

    /// Groups have requests and a time within the next minute; numbers are numbers; replies can be read.
    #[test]
    fn any_packets_keep_to_the_limits(
        packets in prop::collection::vec((packets(), 4000_u16..4004, any::<bool>()), 1..12),
        cut in 0_usize..40,
        positions in any::<[i64; 2]>(),
    ) {
        let mut translator = Translator::new(info(), None);
        for (packet, port, is_cut) in packets {
            let now = now();
            let mut packet = bytes(&packet);
            packet.truncate(packet.len() - if is_cut { cut.min(packet.len()) } else { 0 });
            let translation = translator.packet(&packet, from(port), now);
            for Group { requests, due, sender } in &translation.groups {
                prop_assert!(!requests.is_empty());
                prop_assert_eq!(sender.is_some(), *due > now.instant);
                prop_assert!(*due >= now.instant && *due <= now.instant + FARTHEST_AHEAD);
                for request in requests {
                    let is_sound = match request {
                        RunCommand::Tempo { rate: value }
                        | RunCommand::Set { value: KnobValue::Number(value), .. } => value.is_finite(),
                        _ => true,
                    };
                    prop_assert!(is_sound, "{request:?}");
                }
            }
            prop_assert!(translation.replies.len() <= MOST_REPLIES);
            shown(&translation.replies);
            let half = positions.map(|position| position / 2);
            shown(&translator.happened(&status(1.0, half), now.instant));
        }
        prop_assert!(translator.clients.len() <= 4);
    }
}

/// Two programs that answer each other, and one that sends back all that it hears: neither goes on for ever.
#[test]
fn an_echo_is_no_order_and_an_answer_is_not_answered() {
    let (ours, theirs): (SocketAddr, SocketAddr) =
        ("127.0.0.1:9000".parse().unwrap(), "127.0.0.1:9001".parse().unwrap());
    let knob = KnobInfo {
        name: "speed".into(),
        target: "x.speed".into(),
        unit: "rev/s".into(),
        least: None,
        greatest: None,
        value: 0.0,
    };
    let mut translator = Translator::new(OscInfo { motors: Vec::new(), knobs: vec![knob] }, None).at(OwnAddress(ours));
    let now = Now::read();
    translator.packet(b"/setDestIp\0\0,\0\0\0", theirs, now);
    let set = |value| RunEvent::Set {
        knob: "speed".into(),
        value,
        unit: "rev/s".into(),
        from_s: 0.0,
        until_s: 0.0,
        ceiling: None,
    };
    for value in [0.5, 0.75] {
        for OscReply { to, packet } in translator.happened(&set(value), now.instant) {
            assert_eq!(to, theirs);
            let back = translator.packet(&packet, theirs, now);
            assert_eq!((back.groups.len(), back.replies.len()), (0, 0));
        }
    }
    // Another value is an order, and so is the old one after it.
    for value in [0.5_f32, 0.75] {
        let packet = [&b"/speed\0\0,f\0\0"[..], &value.to_be_bytes()].concat();
        assert_eq!(translator.packet(&packet, theirs, now).groups.len(), 1);
    }
    for answer in ANSWERS {
        let mut packet = answer.as_bytes().to_vec();
        packet.resize((packet.len() + 1).next_multiple_of(4), 0);
        packet.extend(b",\0\0\0");
        let back = translator.packet(&packet, theirs, now);
        assert_eq!((back.groups.len(), back.replies.len()), (0, 0), "{answer}");
    }
}
