//! docs/protocol.md against the code: every table, every number, and the session at its end.

use pulsetrain_board::Port;
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::message::{
    Ack, Cause, Configuration, Event, Info, LeaseField, MAX_PACKED, Measures, Missing, MotorSetup, Reason, flags, image,
};
use pulsetrain_core::wire::service::{SILENCE_MS, TRIAL_MS};
use pulsetrain_core::wire::{
    Baud, Command, Decoder, Encoder, MAX_BODY, MAX_FRAME, MAX_MOTORS, MIN_BODY, Reply, Settings, Switched, VERSION,
};
use pulsetrain_core::{Epoch, Tick32};
use pulsetrain_testkit::model::ModelPort;
use std::time::Duration;

const DOC: &str = include_str!("../../../../docs/protocol.md");
const FRAME: &str = include_str!("../../../core/src/wire/frame.rs");
const MESSAGE: &str = include_str!("../../../core/src/wire/message.rs");
const ORDERS: &str = include_str!("../../../core/src/wire/orders.rs");
const SETTINGS: &str = include_str!("../../../core/src/wire/settings.rs");

/// A table, and the heading or the item that it belongs to.
type Table = (String, Vec<String>);

/// The tables of a document, with the heading before each.
fn tables_of_doc() -> Vec<Table> {
    let (mut tables, mut heading) = (Vec::<Table>::new(), String::new());
    let mut inside = false;
    for line in DOC.lines() {
        if let Some(text) = line.strip_prefix('#') {
            heading = text.trim_matches(['#', ' ']).to_owned();
        }
        if line.starts_with('|') {
            if !inside {
                tables.push((heading.clone(), Vec::new()));
            }
            tables.last_mut().expect("just pushed").1.push(line.to_owned());
        }
        inside = line.starts_with('|');
    }
    tables
}

/// The tables in the comments of a source, with the item that follows each.
fn tables_of_source(source: &str) -> Vec<Table> {
    let (mut tables, mut table) = (Vec::new(), Vec::new());
    for line in source.lines().map(str::trim) {
        let comment = line.strip_prefix("///").or_else(|| line.strip_prefix("//!")).map(str::trim);
        match comment {
            Some(row) if row.starts_with('|') => table.push(without_links(row)),
            Some(_) => {}
            None if line.starts_with("#[") || table.is_empty() => {}
            None => {
                let name = line.trim_start_matches("pub ").trim_start_matches("struct ").trim_start_matches("type ");
                let name = name.split(|c: char| !c.is_alphanumeric()).next().unwrap_or_default();
                tables.push((name.to_owned(), std::mem::take(&mut table)));
            }
        }
    }
    tables
}

/// [`X`] and [`X`](y) as `X`.
fn without_links(text: &str) -> String {
    let mut out = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once("[`") {
        let (name, after) = after.split_once("`]").expect("a link ends");
        out += before;
        out += &format!("`{name}`");
        rest = match after.strip_prefix('(') {
            Some(target) => target.split_once(')').expect("a target ends").1,
            None => after,
        };
    }
    out + rest
}

/// The table under a heading that has so many columns.
fn rows(heading: &str, first: &str) -> Vec<Vec<String>> {
    let found: Vec<_> = tables_of_doc()
        .into_iter()
        .filter(|(under, table)| under == heading && table[0].starts_with(&format!("| {first} |")))
        .collect();
    let [(_, table)] = &found[..] else { panic!("{} tables {first} under {heading}", found.len()) };
    let cells = |row: &String| row.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect();
    table[2..].iter().map(cells).collect()
}

#[test]
fn byte_tables_are_those_of_the_code() {
    let mut source = tables_of_source(MESSAGE);
    source.extend(tables_of_source(ORDERS));
    source.extend(tables_of_source(SETTINGS));
    assert!(source.len() >= 20, "{} tables", source.len());
    let frame = tables_of_source(FRAME).remove(0);
    assert!(tables_of_doc().contains(&("Frames".into(), frame.1)), "the table of frames");
    for table in tables_of_doc().into_iter().filter(|(_, table)| table[0] == "| byte | |") {
        let Some(at) = source.iter().position(|have| *have == table) else { panic!("not in the code: {table:#?}") };
        source.remove(at);
    }
    assert!(source.is_empty(), "not in the document: {source:#?}");
}

/// The last byte of each fixed layout is where the table says.
#[test]
fn layouts_are_as_long_as_their_tables() {
    fn check(heading: &str, len: usize) {
        let tables = tables_of_doc();
        let table = tables.iter().rfind(|(under, table)| under == heading && table[0] == "| byte | |");
        let last = table.and_then(|(_, rows)| rows.last()).expect("a table").split('|').nth(1).expect("a cell").trim();
        let end = last.rsplit('–').next().expect("a number");
        let number = end.trim_end_matches('…').parse::<usize>().expect("a number");
        assert_eq!(number + usize::from(!end.ends_with('…')), len, "{heading}");
    }
    // A frame has six bytes more than its body.
    let command = |command: Command<'_>| {
        let mut bytes = [0; MAX_FRAME];
        command.encode(1, Tag(1), &mut bytes).expect("fits") - 6
    };
    check("Hello", command(Command::Hello { version: VERSION, nonce: 2 }));
    check("Discard", command(Command::Discard { epoch: Epoch(1) }));
    check("Switch", command(Command::Switch { epoch: Epoch(1), tick: 5, lease: Lease::Last, limits: &[] }));
    check("Extend", command(Command::Extend { lease: Lease::Last, limits: &[] }));
    check("Trim", command(Command::Trim { until: Tick32(5), bytes: &[] }));
    check("LeaseField", size_of::<LeaseField>());
    check("Baud", command(Command::Baud { baud: Baud::B1M }));
    let reply = |encode: &dyn Fn(&mut Encoder<'_>)| {
        let mut bytes = [0; MAX_FRAME];
        let mut frame = Encoder::new(&mut bytes);
        frame.u16(0);
        encode(&mut frame);
        frame.finish(Tag(1)).expect("fits") - 6
    };
    check("Info", reply(&|frame| Info { image: image::PLANS, ..Info::NOBODY }.encode(frame)));
    check("Measures", reply(&|frame| Measures::default().encode(frame)));
    let event = Event { cause: Cause::Finished, motor: 0, tick: 0, detail: 0 };
    check("Event", reply(&|frame| event.encode(frame)));
    // The board writes these field by field: of all lengths the host reads one.
    let read = |kind: u8| {
        let mut read = (2..80).filter(|len| Reply::decode(&[&[1, kind][..], &vec![0; len - 2]].concat()).is_some());
        (read.next(), read.next())
    };
    assert_eq!(read(0x86), (Some(21), Some(28)));
    let switched = read(0x88).0.expect("one");
    check("Switched", switched);
    check("Trimmed", read(0x99).0.expect("one"));
    check("Braked", read(0x9a).0.expect("one"));
    check("Settings", command(Command::Store(Some(Settings::default()))));
    check("Stored", read(0x8f).0.expect("one"));
    assert_eq!(MotorSetup::default().to_bytes().len(), 8);
    assert_eq!(command(Command::Configure(Configuration::new(&[]).expect("no motors"))), 15);
}

#[test]
fn numbers_are_those_of_the_code() {
    let bauds: Vec<_> = Baud::ALL.iter().map(|baud| vec![(*baud as u8).to_string(), baud.rate().to_string()]).collect();
    assert_eq!(rows("The line", "code"), bauds);
    let limits = [
        ("longest body", format!("{MAX_BODY} bytes")),
        ("longest body that every board takes", format!("{MIN_BODY} bytes")),
        ("longest frame", format!("{MAX_FRAME} bytes")),
        ("most packed bytes in a frame", format!("{MAX_PACKED} bytes")),
        ("motors", MAX_MOTORS.to_string()),
        ("trial of a rate", format!("{TRIAL_MS} ms")),
        ("silence after which a host is lost", format!("{SILENCE_MS} ms")),
    ];
    assert_eq!(rows("The line", "limit"), limits.map(|(what, value)| vec![what.to_owned(), value]));
    assert!(DOC.contains(&format!("\nVersion {VERSION}. ")));

    let named = |heading, which: usize, all: Vec<(u8, String)>| {
        let tables = tables_of_doc();
        let table =
            tables.iter().filter(|(under, table)| under == heading && table[0] == "| code | name | |").nth(which);
        let rows = table.expect("a table").1[2..].iter();
        let told: Vec<_> = rows
            .map(|row| {
                let mut cells = row.split('|').skip(1).map(|cell| cell.trim().trim_matches('`').to_owned());
                (cells.next().and_then(|code| code.parse().ok()).expect("a code"), cells.next().expect("a name"))
            })
            .collect();
        assert_eq!(told, all);
    };
    named("Numbers", 0, Reason::ALL.iter().map(|reason| (*reason as u8, format!("{reason:?}"))).collect());
    named("Numbers", 1, Cause::ALL.iter().map(|cause| (*cause as u8, format!("{cause:?}"))).collect());
    named("Numbers", 2, Missing::ALL.iter().map(|why| (*why as u8, format!("{why:?}"))).collect());
    let bits = [
        (flags::IDLE, "IDLE"),
        (flags::CONFIGURED, "CONFIGURED"),
        (flags::ARMED, "ARMED"),
        (flags::BAKED, "BAKED"),
        (flags::STEP_MISSED, "STEP_MISSED"),
        (flags::SETUP_CUT_SHORT, "SETUP_CUT_SHORT"),
        (flags::BAD_ITEM, "BAD_ITEM"),
        (flags::CHECK_FAILED, "CHECK_FAILED"),
        (flags::UNCERTAIN, "UNCERTAIN"),
    ];
    let told = rows("Numbers", "bit of value").into_iter().map(|row| (row[0].clone(), row[1].clone()));
    assert!(told.eq(bits.map(|(value, name)| (value.to_string(), format!("`{name}`")))));
}

#[test]
fn kinds_are_those_of_the_code() {
    let rows = rows("Bodies", "kind");
    let listed = |kind: u8| {
        rows.iter().find(|row| {
            let mut ends = row[0].split('–').map(|code| u8::from_str_radix(&code[2..], 16).expect("a hex number"));
            let first = ends.next().expect("a code");
            (first..=ends.next().unwrap_or(first)).contains(&kind)
        })
    };
    for kind in 0..=255 {
        // Some payload makes a command of every kind that there is.
        let payloads = [&[][..], &[1], &[1; 5], &[1; 6], &[1; 14], &[0; 13]];
        let command = payloads.iter().find_map(|payload| Command::decode(kind, payload).ok());
        let unknown = Command::decode(kind, &[]) == Err(Reason::UnknownKind);
        assert_eq!(listed(kind).is_none(), unknown, "{kind:#04x}");
        if let Some(row) = listed(kind) {
            let command = command.expect("a payload that fits");
            let name = format!("{command:?}");
            assert!(name.starts_with(row[1].split(' ').next().expect("a word")), "{name} is not {}", row[1]);
        }
    }
}

/// What is between the fences of the session.
fn session() -> impl Iterator<Item = &'static str> {
    DOC.split_once("```hex\n").and_then(|(_, rest)| rest.split_once("```")).expect("a session").0.lines()
}

fn bytes(hex: &str) -> Vec<u8> {
    hex.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect("a hex byte")).collect()
}

#[test]
fn the_session_goes_as_it_is_told() {
    let mut port = ModelPort::new();
    let (mut told, mut happened) = (String::new(), String::new());
    let mut frames = Vec::new();
    for line in session() {
        told += &format!("{line}\n");
        match line.split_at(1) {
            (">", hex) => {
                port.send(&bytes(hex)).expect("a model's port");
                // Answers come within some milliseconds, and nothing else after.
                let until = port.now() + Duration::from_millis(20);
                let mut answer = Vec::new();
                while port.now() < until {
                    port.receive(until, &mut answer).expect("a model's port");
                }
                frames.extend(answer.split_inclusive(|byte| *byte == 0).map(<[u8]>::to_vec));
                happened += &format!("{line}\n");
            }
            ("<", _) => {
                let frame = if frames.is_empty() { Vec::new() } else { frames.remove(0) };
                let hex: Vec<String> = frame.iter().map(|byte| format!("{byte:02x}")).collect();
                happened += &format!("< {}\n", hex.join(" "));
            }
            _ => happened += &format!("{line}\n"),
        }
    }
    assert_eq!(told, happened, "the document says the first, the model the second:\n{happened}");
    assert!(frames.is_empty(), "more answers than are told: {frames:02x?}");
}

/// The remarks of the session speak of what its bytes say.
#[test]
fn the_session_is_what_its_remarks_say() {
    let mut decoder = Decoder::<MAX_BODY>::new();
    let mut take = |hex: &str| {
        let mut taken = None;
        for byte in bytes(hex) {
            if let Received::Frame(tag) = decoder.push(byte) {
                taken = Some((tag, decoder.body().to_vec()));
            }
        }
        taken.expect("a frame")
    };
    let (mut commands, mut replies) = (Vec::new(), Vec::new());
    for line in session() {
        match line.split_at(1) {
            (">", hex) => {
                let (_, body) = take(hex);
                let command = Command::decode(body[1], &body[2..]).expect("a command");
                commands.push(format!("{} {command:?}", body[0]));
            }
            ("<", hex) => replies.push(Reply::decode(&take(hex).1).expect("a reply")),
            _ => {}
        }
    }
    assert_eq!(commands[0], "0 Hello { version: 3, nonce: 305419896 }");
    assert!(matches!(replies[0], (0, Reply::Info(Info { tag: Tag(1), pool: 1024, window: 240, .. }))));
    let free = |reply: &(u8, Reply)| match reply.1 {
        Reply::Configured(free) | Reply::Ack(Ack { free, .. }) => free.as_slice().to_vec(),
        _ => panic!("no queues in {reply:?}"),
    };
    assert_eq!(free(&replies[1]), [512, 512]);
    assert_eq!(replies[2], (2, Reply::Done { kind: 3 }));
    assert_eq!((&commands[3], replies[3]), (&commands[2], replies[2]));
    assert_eq!(replies[4], (2, Reply::Missing { why: Missing::Gap, accepted: 0 }));
    assert_eq!(free(&replies[5]), [512 - 16, 512]);
    assert_eq!(replies[6], (4, Reply::Switched(Switched::Accepted)));
    assert!(matches!(replies[7], (5, Reply::Status(status)) if status.motors.as_slice().len() == 2));
    assert!(matches!(replies[8], (6, Reply::Switched(Switched::Late { .. }))));
    assert!(matches!(replies[9], (7, Reply::Stopped { .. })));
    assert_eq!(replies[10], (8, Reply::Done { kind: 11 }));
    assert_eq!(replies[11].1, Reply::Missing { why: Missing::NotTaken, accepted: 4 });
}
