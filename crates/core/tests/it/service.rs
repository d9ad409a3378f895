//! The board's side of the link, with a board that only records what it is asked to do.

use proptest::prelude::*;
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::message::{
    Configuration, Event, Info, LeaseState, Measures, Missing, MotorSetup, MotorStatus, Reason, StatusHead,
};
use pulsetrain_core::wire::orders::{Obeyed, Orders};
use pulsetrain_core::wire::outcome::NO_LEASE;
use pulsetrain_core::wire::service::{SILENCE_MS, TRIAL_MS};
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{
    Baud, BoardSide, Command, Decoder, Encoder, MAX_BODY, MAX_FRAME, MIN_BODY, Millis, Refusal, Reply, Service,
    Settings, Stopped, Stored, Switched, Trimmed, VERSION,
};
use pulsetrain_core::{Epoch, Tick32};

/// A board that accepts everything.
#[derive(Default)]
struct Notebook {
    asked: Vec<String>,
    full: bool,
    measures: Measures,
    settings: Option<[u8; SETTINGS_LEN]>,
    is_damaged: bool,
    /// It refuses commands that concern a lease.
    has_lapsed: bool,
}

impl Notebook {
    fn note(&mut self, what: String) {
        self.asked.push(what);
    }
}

impl Notebook {
    const OBEYED: [(i32, Option<u64>); 2] = [(-1, None), (-2, Some(86))];
}

impl BoardSide for Notebook {
    const OBEYS: bool = true;

    fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        self.note(format!("{:?}", Command::Orders(*orders)));
        Ok(())
    }
    const STORES: bool = true;

    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        self.note(format!("{:?}", Command::Store(settings.map(|bytes| Settings::decode(bytes).expect("possible")))));
        self.settings = settings.copied().or(self.settings);
        Ok(())
    }
    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        *settings = self.settings.unwrap_or_default();
        self.settings.is_some()
    }
    fn store_is_damaged(&self) -> bool {
        self.is_damaged
    }
    fn obeyed(&self, frame: &mut Encoder<'_>) {
        Obeyed::new(77, Notebook::OBEYED.into_iter()).encode(frame);
    }
    fn info(&mut self) -> Info {
        Info::NOBODY
    }
    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal> {
        self.note(format!("{:?}", Command::Configure(*configuration)));
        Ok(())
    }
    fn arm(&mut self) -> Result<(), Refusal> {
        self.note(format!("{:?}", Command::Arm));
        Ok(())
    }
    fn release(&mut self) -> Result<(), Refusal> {
        self.note(format!("{:?}", Command::Release));
        Ok(())
    }
    fn motors(&self) -> u8 {
        2
    }
    fn free(&self, motor: u8) -> u16 {
        100 + u16::from(motor)
    }
    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal> {
        if self.full {
            return Err(Refusal { reason: Reason::Full, detail: u16::from(motor) });
        }
        self.note(format!("{:?}", Command::Data { motor, epoch, packed }));
        Ok(())
    }
    fn discard(&mut self, epoch: Epoch) {
        self.note(format!("{:?}", Command::Discard { epoch }));
    }
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> Result<Switched, Refusal> {
        self.note(format!("{:?}", Command::Switch { epoch, tick, lease, limits }));
        Ok(switched(tick))
    }
    fn extend(&mut self, lease: Lease, limits: &[u8]) -> bool {
        self.note(format!("{:?}", Command::Extend { lease, limits }));
        !self.has_lapsed
    }
    fn trim(&mut self, until: Tick32, bytes: &[u8]) -> Result<Trimmed, Refusal> {
        self.note(format!("{:?}", Command::Trim { until, bytes }));
        Ok(if self.has_lapsed { Trimmed::NoLease } else { Trimmed::Accepted })
    }
    fn brake(&mut self) -> u64 {
        self.note(format!("{:?}", Command::Brake));
        if self.has_lapsed { NO_LEASE } else { 0x1234_5678_9abc }
    }
    fn lease(&self) -> (u8, u32) {
        LeaseState::Lapsed(Tick32(12)).to_parts()
    }
    fn stop_now(&mut self) -> Stopped {
        self.note(format!("{:?}", Command::StopNow));
        Stopped { tick: 77, uncertain: 2 }
    }
    fn clock(&mut self) -> u64 {
        0x0102_0304_0506_0708
    }
    fn flags(&self) -> u8 {
        5
    }
    fn horizon(&mut self) -> u64 {
        0x0102_0304_0506_0710
    }
    fn epoch(&self) -> Epoch {
        Epoch(11)
    }
    fn position(&mut self, motor: u8) -> i32 {
        -1 - i32::from(motor)
    }
    fn faults(&self, motor: u8) -> u8 {
        motor
    }
    fn measures(&mut self) -> &mut Measures {
        self.measures.late = 3;
        &mut self.measures
    }
    fn rate_fell_back(&mut self) {
        self.note("fell back".to_owned());
    }
    fn reset_measures(&mut self) {
        self.note(format!("{:?}", Command::Measures { reset: true }));
    }
    fn can_baud(&self, baud: Baud) -> bool {
        baud != Baud::B2M
    }
    fn set_baud(&mut self, baud: Baud) {
        self.note(format!("{baud:?}"));
    }
    fn host_gone(&mut self, lost: bool) {
        self.note(format!("gone, lost: {lost}"));
    }
    fn event(&mut self) -> Option<Event> {
        None
    }
}

/// The results of the notebook's switches.
const fn switched(tick: u64) -> Switched {
    match tick % 4 {
        0 => Switched::Accepted,
        1 => Switched::Late { horizon: tick ^ 0x55 },
        2 => Switched::Early { limit: tick ^ 0x55 },
        _ => Switched::Full,
    }
}

/// Kind and payload of a frame: random ones, ones of the length of a command with a fixed length, and Data with only an epoch.
fn content() -> impl Strategy<Value = (u8, Vec<u8>)> {
    const LENGTHS: [(u8, usize); 13] = [
        (0x01, 5),
        (0x03, 0),
        (0x04, 0),
        (0x05, 0),
        (0x06, 0),
        (0x07, 1),
        (0x08, 9),
        (0x09, 0),
        (0x0a, 1),
        (0x0b, 0),
        (0x0c, 0),
        (0x0d, 1),
        (0x10, 1),
    ];
    let byte = || prop_oneof![Just(0u8), Just(1), any::<u8>()];
    let any_kind = (prop_oneof![0u8..0x20, any::<u8>()], prop::collection::vec(byte(), 0..60));
    let known = prop::sample::select(&LENGTHS[..])
        .prop_flat_map(move |(kind, len)| (Just(kind), prop::collection::vec(byte(), len)));
    prop_oneof![any_kind, known]
}

/// A board that host number 7 has taken with frame 0; frame 1 is next, and its tag is 1.
fn taken() -> (Service, Notebook) {
    let (mut service, mut machine) = (Service::new(MAX_BODY), Notebook::default());
    say(&mut service, &mut machine, &frame(&Command::Hello { version: VERSION, nonce: 7 }, 0, Tag::NONE), 0);
    assert!(matches!(hear(&mut service, &mut machine, 0), Some((Tag::NONE, 0, Reply::Info(Info { tag: Tag(1), .. })))));
    (service, machine)
}

fn frame(command: &Command<'_>, seq: u8, tag: Tag) -> Vec<u8> {
    let mut bytes = [0; MAX_FRAME];
    let len = command.encode(seq, tag, &mut bytes).unwrap();
    bytes[..len].to_vec()
}

fn body(body: &[u8], tag: Tag) -> Vec<u8> {
    let mut bytes = [0; MAX_FRAME];
    let mut frame = Encoder::new(&mut bytes);
    frame.bytes(body);
    let len = frame.finish(tag).unwrap();
    bytes[..len].to_vec()
}

fn say(service: &mut Service, machine: &mut Notebook, bytes: &[u8], ms: u16) {
    say_in::<MAX_BODY>(service, machine, bytes, ms);
}

/// To a board that takes bodies of `N` bytes.
fn say_in<const N: usize>(service: &mut Service, machine: &mut Notebook, bytes: &[u8], ms: u16) {
    let mut decoder = Decoder::<N>::new();
    let (len, received) = decoder.feed(bytes);
    assert_eq!(len, bytes.len());
    service.receive(received, decoder.body(), Millis(ms), machine);
}

/// The next reply: tag, sequence number, content.
fn hear(service: &mut Service, machine: &mut Notebook, ms: u16) -> Option<(Tag, u8, Reply)> {
    let mut bytes = [0; MAX_FRAME + 1];
    let len = service.poll(Millis(ms), machine, &mut bytes);
    let mut decoder = Decoder::<MAX_BODY>::new();
    let mut heard = None;
    for byte in &bytes[..len] {
        if let Received::Frame(tag) = decoder.push(*byte) {
            let (seq, reply) = Reply::decode(decoder.body()).expect("a reply that a host can read");
            heard = Some((tag, seq, reply));
        }
    }
    assert_eq!(heard.is_some(), len > 0);
    heard
}

proptest! {
    /// A frame of any content is read as `Command::decode` reads it: it is executed once, or refused for the same reason.
    #[test]
    fn what_is_asked_is_done_once((kind, payload) in content()) {
        let (mut service, mut machine) = taken();
        let bytes = body(&[&[1, kind][..], &payload].concat(), Tag(1));
        let decoded = Command::decode(kind, &payload);
        for _ in 0..3 {
            say(&mut service, &mut machine, &bytes, 5);
            let (tag, seq, reply) = hear(&mut service, &mut machine, 5).unwrap();
            prop_assert_eq!((tag, seq), (Tag(1), 1));
            match decoded {
                Err(reason) => {
                    prop_assert_eq!(reply, Reply::Refused { kind, reason, detail: u16::from(kind) });
                }
                Ok(Command::Hello { .. }) => {
                    prop_assert_eq!(reply, Reply::Refused { kind, reason: Reason::Taken, detail: 0 });
                }
                Ok(Command::Baud { baud: Baud::B2M }) => {
                    prop_assert_eq!(reply, Reply::Refused { kind, reason: Reason::Baud, detail: 4 });
                }
                Ok(Command::Switch { limits, .. } | Command::Extend { limits, .. }) if !matches!(limits.len(), 0 | 6) => {
                    prop_assert_eq!(reply, Reply::Refused { kind, reason: Reason::Malformed, detail: u16::from(kind) });
                }
                Ok(Command::Trim { bytes, .. }) if bytes.len() != 4 => {
                    prop_assert_eq!(reply, Reply::Refused { kind, reason: Reason::Malformed, detail: u16::from(kind) });
                }
                Ok(Command::Switch { tick, .. }) => {
                    prop_assert_eq!(reply, Reply::Switched(switched(tick)));
                }
                Ok(Command::Trim { .. }) => prop_assert_eq!(reply, Reply::Trimmed(Trimmed::Accepted)),
                Ok(Command::Brake) => prop_assert_eq!(reply, Reply::Braked { tick: Some(0x1234_5678_9abc) }),
                Ok(Command::StopNow) => {
                    let Reply::Stopped { stopped, positions } = reply else { panic!("{reply:?}") };
                    prop_assert_eq!((stopped.tick, stopped.uncertain), (77, 2));
                    prop_assert_eq!(positions.as_slice(), [-1, -2]);
                }
                Ok(Command::Clock) => prop_assert_eq!(reply, Reply::Clock { tick: 0x0102_0304_0506_0708 }),
                Ok(Command::Status) => {
                    let Reply::Status(status) = reply else { panic!("{reply:?}") };
                    let head = StatusHead {
                        tick: machine.clock(),
                        horizon: 0x0102_0304_0506_0710,
                        epoch: Epoch(11),
                        flags: 5,
                        accepted: 0,
                        lease: LeaseState::Lapsed(Tick32(12)),
                    };
                    prop_assert_eq!(status.head, head);
                    let motor = |motor| MotorStatus { position: -1 - i32::from(motor), free: 100 + u16::from(motor), faults: motor };
                    prop_assert_eq!(status.motors.as_slice(), [motor(0), motor(1)]);
                }
                Ok(Command::Measures { .. }) => {
 let Reply::Measures(measures) = reply else { panic!("{reply:?}") };
 prop_assert_eq!(measures.late, 3);
}
                Ok(Command::Orders(_)) => {
                    prop_assert_eq!(reply, Reply::Obeyed(Obeyed::new(77, Notebook::OBEYED.into_iter())));
                }
                Ok(Command::Store(_)) => {
                    let kept = machine.settings.map(|bytes| Settings::decode(&bytes).expect("possible"));
                    prop_assert_eq!(reply, Reply::Stored(Stored { settings: kept, is_damaged: false }));
                }
                Ok(Command::Configure(_)) => {
                    let Reply::Configured(free) = reply else { panic!("{reply:?}") };
                    prop_assert_eq!(free.as_slice(), [100, 101]);
                }
                Ok(Command::Poll | Command::Data { .. } | Command::Extend { .. }) => {
                    let Reply::Ack(ack) = reply else { panic!("{reply:?}") };
                    prop_assert_eq!((ack.flags, ack.free.as_slice()), (5, &[100, 101][..]));
                    prop_assert_eq!(ack.accepted, u8::from(matches!(decoded, Ok(Command::Extend { .. }))));
                }
                Ok(_) => prop_assert_eq!(reply, Reply::Done { kind }),
            }
            if kind == 0x0b || kind == 0x0a {
                // From here on the session or the rate is another one.
                break;
            }
        }
        let expected: Vec<String> = match decoded {
            Ok(Command::Hello { .. } | Command::Clock | Command::Status | Command::Poll | Command::Bye | Command::Baud { .. }) => vec![],
            Ok(Command::Measures { reset: false }) | Err(_) => vec![],
            Ok(Command::Switch { limits, .. } | Command::Extend { limits, .. }) if !matches!(limits.len(), 0 | 6) => vec![],
            Ok(Command::Trim { bytes, .. }) if bytes.len() != 4 => vec![],
            Ok(command) => vec![format!("{command:?}")],
        };
        prop_assert_eq!(machine.asked, expected);
    }
}

/// One Ack may answer several frames. Only `accepted` tells which Extend, Switch, Trim or Brake was accepted, and repeated frames change nothing.
#[test]
fn what_was_accepted_is_told_by_its_number() {
    fn accepted(service: &mut Service, machine: &mut Notebook) -> Option<u8> {
        match hear(service, machine, 0)?.2 {
            Reply::Ack(ack) => Some(ack.accepted),
            Reply::Missing { accepted, .. } => Some(accepted),
            Reply::Status(status) => Some(status.head.accepted),
            reply => panic!("{reply:?}"),
        }
    }
    let (mut service, mut machine) = taken();
    let extend = |tick| Command::Extend { lease: Lease::Until(Tick32(tick)), limits: &[128, 61, 0, 255, 0, 9] };
    let tell = |service: &mut Service, machine: &mut Notebook, command: &Command<'_>, seq: u8| {
        say(service, machine, &frame(command, seq, Tag(1)), 0);
    };
    // Only Hello has been accepted.
    tell(&mut service, &mut machine, &Command::Poll, 1);
    assert_eq!(accepted(&mut service, &mut machine), Some(0));
    // Data after it is acknowledged together with it. A repeated Extend is not executed again.
    tell(&mut service, &mut machine, &extend(5), 2);
    tell(&mut service, &mut machine, &Command::Data { motor: 0, epoch: Epoch(1), packed: &[1] }, 3);
    assert_eq!(accepted(&mut service, &mut machine), Some(2));
    machine.has_lapsed = true;
    tell(&mut service, &mut machine, &extend(5), 2);
    assert_eq!(accepted(&mut service, &mut machine), Some(2));
    // An extension that is refused does not change the number in the answers.
    tell(&mut service, &mut machine, &extend(6), 4);
    assert_eq!(accepted(&mut service, &mut machine), Some(2));
    tell(&mut service, &mut machine, &Command::Status, 5);
    assert_eq!(accepted(&mut service, &mut machine), Some(2));
    tell(&mut service, &mut machine, &Command::Poll, 7);
    assert_eq!(accepted(&mut service, &mut machine), Some(2));
    assert_eq!(machine.asked.iter().filter(|asked| asked.starts_with("Extend")).count(), 2);
    // Switch, Trim and Brake: the number becomes theirs only if they are accepted.
    let until = Tick32(7);
    let switch = |tick| Command::Switch { epoch: Epoch(2), tick, lease: Lease::Last, limits: &[] };
    let trim = Command::Trim { until, bytes: &[1, 0, 2, 0] };
    let mut seq = 6;
    let mut number = 2;
    for (command, has_lapsed, is_accepted) in [
        (switch(9), false, false),
        (switch(8), false, true),
        (trim, true, false),
        (trim, false, true),
        (Command::Brake, true, false),
        (Command::Brake, false, true),
    ] {
        machine.has_lapsed = has_lapsed;
        tell(&mut service, &mut machine, &command, seq);
        let answer = hear(&mut service, &mut machine, 0);
        assert!(answer.is_some_and(|(_, to, _)| to == seq), "{command:?}: {answer:?}");
        // The answer was lost. It is repeated, although the command would have another result now.
        machine.has_lapsed = !has_lapsed;
        tell(&mut service, &mut machine, &command, seq);
        assert_eq!(hear(&mut service, &mut machine, 0), answer);
        number = if is_accepted { seq } else { number };
        tell(&mut service, &mut machine, &Command::Poll, seq + 1);
        assert_eq!(accepted(&mut service, &mut machine), Some(number), "{command:?}");
        seq += 2;
    }
    assert_eq!(machine.asked.len(), 3 + 6, "{:?}", machine.asked);
}

/// An Extend or a Switch with an invalid lease or limit is refused, and nothing is done.
#[test]
fn leases_that_are_none_are_malformed() {
    let (mut service, mut machine) = taken();
    let bad: [&[u8]; 6] = [
        // Lease off; an unknown state; a byte too many; limits for one of two motors; M too small; E too large.
        &[0, 0, 0, 0, 0],
        &[3, 0, 0, 0, 0],
        &[2, 0, 0, 0, 0, 1],
        &[2, 0, 0, 0, 0, 128, 1, 1],
        &[2, 0, 0, 0, 0, 127, 1, 1, 128, 1, 1],
        &[2, 0, 0, 0, 0, 128, 1, 1, 128, 62, 1],
    ];
    let kinds = bad.iter().flat_map(|payload| [(0x18, &[][..], payload), (0x08, &[0; 9][..], payload)]);
    for (seq, (kind, head, payload)) in (1..).zip(kinds) {
        say(&mut service, &mut machine, &body(&[&[seq, kind], head, payload].concat(), Tag(1)), 0);
        let refused = Reply::Refused { kind, reason: Reason::Malformed, detail: kind.into() };
        assert_eq!(hear(&mut service, &mut machine, 0), Some((Tag(1), seq, refused)), "{kind} {payload:?}");
    }
    assert_eq!(machine.asked, [""; 0]);
}

#[test]
fn a_gap_is_told_once_until_it_is_filled() {
    let (mut service, mut machine) = taken();
    let data = |seq| frame(&Command::Data { motor: 0, epoch: Epoch(1), packed: &[seq] }, seq, Tag(1));
    let gap = Some((Tag(1), 0, Reply::Missing { why: Missing::Gap, accepted: 0 }));
    say(&mut service, &mut machine, &data(2), 0);
    assert_eq!(hear(&mut service, &mut machine, 0), gap);
    say(&mut service, &mut machine, &data(3), 0);
    assert_eq!(hear(&mut service, &mut machine, 0), None);
    // The Ack of the last one serves for several.
    for seq in [1, 2, 3] {
        say(&mut service, &mut machine, &data(seq), 0);
    }
    assert!(matches!(hear(&mut service, &mut machine, 0), Some((Tag(1), 3, Reply::Ack(_)))));
    assert_eq!(hear(&mut service, &mut machine, 0), None);
    // A damaged frame counts as a missing one.
    let mut damaged = data(4);
    damaged[3] ^= 1;
    say(&mut service, &mut machine, &damaged, 0);
    assert_eq!(
        hear(&mut service, &mut machine, 0),
        Some((Tag(1), 3, Reply::Missing { why: Missing::Gap, accepted: 0 }))
    );
    assert_eq!(machine.asked.len(), 3);
}

#[test]
fn what_there_is_no_room_for_is_asked_for_again() {
    let (mut service, mut machine) = taken();
    let data = frame(&Command::Data { motor: 1, epoch: Epoch(1), packed: &[1] }, 1, Tag(1));
    machine.full = true;
    say(&mut service, &mut machine, &data, 0);
    assert_eq!(
        hear(&mut service, &mut machine, 0),
        Some((Tag(1), 0, Reply::Missing { why: Missing::NoRoom, accepted: 0 }))
    );
    machine.full = false;
    say(&mut service, &mut machine, &data, 0);
    assert!(matches!(hear(&mut service, &mut machine, 0), Some((Tag(1), 1, Reply::Ack(_)))));
    assert_eq!(machine.asked.len(), 1);
}

#[test]
fn silence_frees_a_board_and_not_before() {
    let (mut service, mut machine) = taken();
    // The clock of milliseconds wraps meanwhile.
    let start = u16::MAX - 500;
    say(&mut service, &mut machine, &frame(&Command::Poll, 1, Tag(1)), start);
    assert!(hear(&mut service, &mut machine, start).is_some());
    assert_eq!(hear(&mut service, &mut machine, start.wrapping_add(SILENCE_MS - 1)), None);
    assert!(service.is_taken());
    // Another host is refused until then.
    let hello = frame(&Command::Hello { version: VERSION, nonce: 8 }, 9, Tag::NONE);
    say(&mut service, &mut machine, &hello, start.wrapping_add(SILENCE_MS - 1));
    let refused = Reply::Refused { kind: 1, reason: Reason::Taken, detail: 0 };
    assert_eq!(hear(&mut service, &mut machine, start.wrapping_add(SILENCE_MS - 1)), Some((Tag::NONE, 9, refused)));
    assert_eq!(hear(&mut service, &mut machine, start.wrapping_add(SILENCE_MS)), None);
    assert!(!service.is_taken());
    assert_eq!(machine.asked, ["gone, lost: true"]);
    // The old host gets an answer, and the new one gets the next tag.
    say(&mut service, &mut machine, &frame(&Command::Poll, 2, Tag(1)), 0);
    let not_taken = Reply::Missing { why: Missing::NotTaken, accepted: 0 };
    assert!(matches!(hear(&mut service, &mut machine, 0), Some((Tag::NONE, _, reply)) if reply == not_taken));
    say(&mut service, &mut machine, &hello, 0);
    assert!(matches!(
        hear(&mut service, &mut machine, 0),
        Some((_, 9, Reply::Info(Info { tag: Tag(2), nonce: 8, .. })))
    ));
}

#[test]
fn settings_are_kept_and_told() {
    let (mut service, mut machine) = taken();
    let settings =
        Settings { deadman_ms: 500, silence_ms: 300, vmax: 3_000_000, amax: 20_000_000, ..Settings::default() };
    let mut seq = 0;
    let mut ask = |service: &mut Service, machine: &mut Notebook, payload: &[u8]| {
        seq += 1;
        say(service, machine, &body(&[&[seq, 0x0f][..], payload].concat(), Tag(1)), 0);
        let heard = hear(service, machine, 0).expect("an answer");
        assert_eq!((heard.0, heard.1), (Tag(1), seq));
        heard.2
    };
    let stored = Reply::Stored(Stored { settings: Some(settings), is_damaged: false });
    assert_eq!(ask(&mut service, &mut machine, &[]), Reply::Stored(Stored::default()));
    assert_eq!(ask(&mut service, &mut machine, &settings.to_bytes()), stored);
    // Refused, so that the stored settings stay: limits that are too high, one limit without the other, a wrong length.
    let with = |vmax, amax| Settings { vmax, amax, ..settings }.to_bytes();
    let malformed = Reply::Refused { kind: 0x0f, reason: Reason::Malformed, detail: 0x0f };
    for bad in [with(10_000_001, 1000), with(1, 0), with(1, 999), with(1, 250_000_001)] {
        assert_eq!(ask(&mut service, &mut machine, &bad), malformed, "{bad:?}");
    }
    assert_eq!(ask(&mut service, &mut machine, &[0; SETTINGS_LEN - 1]), malformed);
    assert_eq!(ask(&mut service, &mut machine, &[0; SETTINGS_LEN + 1]), malformed);
    assert_eq!(ask(&mut service, &mut machine, &[]), stored);
    machine.is_damaged = true;
    let damaged = Reply::Stored(Stored { settings: Some(settings), is_damaged: true });
    assert_eq!(ask(&mut service, &mut machine, &[]), damaged);
    // A configuration without a silence uses the stored one.
    let mut configuration = Configuration::new(&[]).expect("no motors");
    for (seq, silence_ms, is) in [(11, 0, 300), (12, 700, 700)] {
        configuration.silence_ms = silence_ms;
        say(&mut service, &mut machine, &frame(&Command::Configure(configuration), seq, Tag(1)), 0);
        assert!(hear(&mut service, &mut machine, 0).is_some());
        assert!(!service.is_lost(Millis(is - 1)) && service.is_lost(Millis(is)), "{silence_ms} ms");
    }
}

#[test]
fn a_rate_that_brings_no_frame_is_given_up() {
    let (mut service, mut machine) = taken();
    say(&mut service, &mut machine, &frame(&Command::Baud { baud: Baud::B1M }, 1, Tag(1)), 0);
    assert_eq!(hear(&mut service, &mut machine, 0), Some((Tag(1), 1, Reply::Done { kind: 0x0a })));
    assert_eq!(service.baud(), Baud::B115200, "not before the answer is out");
    assert_eq!(hear(&mut service, &mut machine, 1), None);
    assert_eq!(service.baud(), Baud::B1M);
    // Noise at the new rate is not reported.
    say(&mut service, &mut machine, &[0x55, 0x33, 0], 2);
    assert_eq!(hear(&mut service, &mut machine, TRIAL_MS), None);
    assert_eq!(service.baud(), Baud::B1M);
    assert_eq!(hear(&mut service, &mut machine, 1 + TRIAL_MS), None);
    assert_eq!(service.baud(), Baud::B115200);
    assert_eq!(machine.asked, ["B1M", "B115200"]);
    // The board reports it when the host is heard again.
    say(&mut service, &mut machine, &frame(&Command::Poll, 2, Tag(1)), 300);
    assert!(matches!(hear(&mut service, &mut machine, 300), Some((_, 2, Reply::Ack(_)))));
    assert_eq!(machine.asked, ["B1M", "B115200", "fell back"]);
}

#[test]
fn another_protocol_is_told_ours_and_not_taken() {
    let (mut service, mut machine) = (Service::new(MAX_BODY), Notebook::default());
    say(&mut service, &mut machine, &frame(&Command::Hello { version: VERSION + 1, nonce: 7 }, 0, Tag::NONE), 0);
    assert!(matches!(hear(&mut service, &mut machine, 0), Some((_, 0, Reply::Info(Info { tag: Tag::NONE, .. })))));
    assert!(!service.is_taken());
}

/// The smallest board takes four motors' configuration, and nothing longer.
#[test]
fn small_boards_take_what_every_board_must() {
    let (mut service, mut machine) = (Service::new(MIN_BODY), Notebook::default());
    say_in::<MIN_BODY>(
        &mut service,
        &mut machine,
        &frame(&Command::Hello { version: VERSION, nonce: 7 }, 0, Tag::NONE),
        0,
    );
    let Some((_, _, Reply::Info(info))) = hear(&mut service, &mut machine, 0) else { panic!("no info") };
    assert_eq!(usize::from(info.max_body), MIN_BODY);
    let four = [MotorSetup::default().to_bytes(); 4].concat();
    say_in::<MIN_BODY>(
        &mut service,
        &mut machine,
        &frame(&Command::Configure(Configuration::new(&four).unwrap()), 1, Tag(1)),
        0,
    );
    assert!(matches!(hear(&mut service, &mut machine, 0), Some((_, 1, Reply::Configured(_)))));
    let five = [MotorSetup::default().to_bytes(); 5].concat();
    say_in::<MIN_BODY>(
        &mut service,
        &mut machine,
        &frame(&Command::Configure(Configuration::new(&five).unwrap()), 2, Tag(1)),
        0,
    );
    assert_eq!(
        hear(&mut service, &mut machine, 0),
        Some((Tag(1), 1, Reply::Missing { why: Missing::Gap, accepted: 0 }))
    );
}
