//! The link to a model board: taking it, changing its rate, losing it, all with the board's own service.

use pulsetrain_board::shared::Shared;
use pulsetrain_board::{
    Board, Edge, Lease, Leased, Link, LinkError, Port, PortError, Remote, RemoteError, SwitchRefused,
};
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::message::{Cause, Info, Missing, kind};
use pulsetrain_core::wire::{Baud, Command, Decoder, Encoder, MAX_FRAME, Reason, Reply};
use pulsetrain_core::{Entry, Epoch, Item, Tick32};
use pulsetrain_testkit::faulty::{Faulty, Rates};
use pulsetrain_testkit::model::ModelPort;
use pulsetrain_testkit::{TICK_HZ, model_setup, run, tell, unseen};
use std::time::Duration;

fn connect(seed: u64) -> Remote<Faulty<ModelPort>> {
    let mut remote = Remote::open(Faulty::new(ModelPort::new(), seed), 7).unwrap();
    remote.configure(&model_setup(1)).unwrap();
    remote
}

#[test]
fn a_board_that_is_taken_stays_with_its_host_until_good_bye_or_silence() {
    let line = Shared::new(ModelPort::new());
    let mut first = Remote::open(line.clone(), 1).unwrap();
    first.configure(&model_setup(1)).unwrap();
    let from = first.now() + TICK_HZ / 10;
    tell(&mut first, 1, from, &[run(400, 160_000)]);
    first.switch(Epoch(1), from, Lease::Last, &[]).unwrap();

    // A second host that asks for six seconds, while the first is heard every 0.1 s.
    let mut second = Link::new(2);
    let mut port = line.clone();
    second.hello(port.now());
    let mut bytes = Vec::new();
    while second.error().is_none() {
        assert!(second.info().is_none(), "taken away");
        bytes.clear();
        second.output(port.now(), &mut bytes);
        port.send(&bytes).unwrap();
        let until = port.now() + Duration::from_millis(20);
        while port.now() < until {
            bytes.clear();
            port.receive(until, &mut bytes).unwrap();
            second.input(&bytes, port.now());
        }
        first.status().unwrap();
    }
    assert_eq!(second.error(), Some(LinkError::Taken));
    assert_eq!(first.status().unwrap().motors.as_slice()[0].position, 400);

    // Good-bye, and it is the next one's; silence, and it is the one's after that.
    first.close();
    let second = Remote::open(line.clone(), 2).unwrap();
    assert!(line.port().is_taken());
    drop(second);
    assert_eq!(Remote::open(line.clone(), 3).map(|remote| remote.info().nonce), Ok(3));
}

/// Who has the port open where a board's text is heard: only then is it known that the board is another's.
#[test]
fn a_hello_that_text_answers_with_taken_is_refused_as_that() {
    let check = |said: &[&[u8]], expected| {
        let (mut link, mut hello) = (Link::new(1), Vec::new());
        link.hello(Duration::ZERO);
        for (ms, bytes) in (1..).zip(said) {
            link.output(Duration::from_millis(ms), &mut hello);
            link.input(bytes, Duration::from_millis(ms));
        }
        assert!(!hello.is_empty() && link.error().is_none(), "{said:?}");
        link.output(Duration::from_secs(6), &mut hello);
        assert_eq!(link.error(), Some(expected), "{said:?}");
    };
    check(&[b"err taken\r\n"], LinkError::Taken);
    check(&[b"txyza 1 0 0 0 0\r\nerr er", b"r tak", b"en\r\nawake\r\n"], LinkError::Taken);
    check(&[b"awake\r\nerr words 3\r\n", b"err take\r\n"], LinkError::Nobody);
    check(&[b""], LinkError::Nobody);
}

#[test]
fn frames_of_an_old_session_are_nobodys() {
    let line = Shared::new(ModelPort::new());
    let mut old = Remote::open(line.clone(), 1).unwrap();
    line.port().run_alone(3 * TICK_HZ);
    let mut new = Remote::open(line.clone(), 2).unwrap();
    assert_eq!(old.status(), Err(RemoteError::Link(LinkError::Lost)));
    assert!(new.status().is_ok());
}

#[test]
fn a_board_that_begins_anew_has_forgotten_its_host() {
    let mut remote = connect(1);
    remote.port_mut().inner_mut().reset();
    assert_eq!(remote.status(), Err(RemoteError::Link(LinkError::Forgotten)));
    assert_eq!(remote.switch(Epoch(1), u64::MAX, Lease::Last, &[]), Err(SwitchRefused::Lost));
    // What is pushed goes nowhere; nothing waits.
    tell(&mut remote, 2, 0, &[run(5, 4000)]);
    assert_eq!(remote.switch(Epoch(2), 0, Lease::Last, &[]), Err(SwitchRefused::Lost));
    let until = remote.now() + TICK_HZ;
    remote.advance(until, &mut unseen);
    assert!(remote.now() > until && remote.is_idle());
}

#[test]
fn nobody_there_is_an_error_after_six_seconds() {
    let mut line = Faulty::new(ModelPort::new(), 1);
    line.cut(Duration::from_secs(60));
    assert_eq!(Remote::open(line, 1).err(), Some(RemoteError::Link(LinkError::Nobody)));
}

#[test]
fn a_rate_that_nobody_hears_is_taken_back_by_both() {
    // A port that says yes, and does another rate.
    struct Stuck(ModelPort);
    impl Port for Stuck {
        fn now(&self) -> Duration {
            self.0.now()
        }
        fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
            self.0.send(bytes)
        }
        fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
            self.0.receive(until, into)
        }
        fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
            self.0.set_baud(if baud == Baud::B115200 { baud } else { Baud::B500k })
        }
    }
    let mut remote = Remote::open(Stuck(ModelPort::new()), 1).unwrap();
    for baud in [Baud::B250k, Baud::B2M] {
        assert_eq!(remote.set_baud(baud), Ok(Baud::B115200));
        assert_eq!(remote.port().0.board_baud(), Baud::B115200);
    }
    let until = remote.now() + TICK_HZ / 10;
    remote.advance(until, &mut unseen);
    let events: Vec<Cause> = remote.events().iter().map(|event| event.cause).collect();
    // One may stand for both: it is told when the rate is settled.
    assert!(!events.is_empty() && events.iter().all(|cause| *cause == Cause::BaudFellBack), "{events:?}");
}

#[test]
fn rates_change_on_a_bad_line_or_stay_what_they_were_at_both_ends() {
    let mut changed = 0;
    for seed in 0..40 {
        let mut remote = connect(seed);
        remote.port_mut().set(Rates { drop: 150, flip: 100, delay: 100, duplicate: 100 });
        let mut asked = Baud::B115200;
        for baud in [Baud::B1M, Baud::B250k, Baud::B2M] {
            match remote.set_baud(baud) {
                Ok(now) => {
                    assert!(now == baud || now == Baud::B115200, "seed {seed}: {now:?}");
                    assert_eq!(remote.port().inner().board_baud(), now, "seed {seed}");
                    changed += u32::from(now != asked);
                    asked = now;
                }
                Err(error) => panic!("seed {seed}: {error}"),
            }
        }
    }
    assert!(changed > 60, "{changed} changes");
}

#[test]
fn nothing_is_done_twice_and_nothing_left_out_on_a_bad_line() {
    for seed in 0..30 {
        let mut remote = connect(seed);
        remote.port_mut().set(Rates { drop: 100, flip: 60, delay: 60, duplicate: 200 });
        let mut edges = Vec::new();
        let mut steps = 0;
        for epoch in 1..=5 {
            let from = remote.horizon() + TICK_HZ;
            // More than one frame holds.
            let items: Vec<Item> = (0..20).map(|k| run(3 + k, 4000 + 37 * i64::from(k))).collect();
            tell(&mut remote, epoch, from, &items);
            assert_eq!(remote.switch(Epoch(epoch), from, Lease::Last, &[]), Ok(()), "seed {seed}");
            steps += (0..20).map(|k| 3 + k).sum::<u32>();
            let until = from + 20 * 40 * 5000;
            remote.advance(until, &mut |edge: Edge| edges.push(edge));
        }
        remote.port_mut().set(Rates::default());
        let until = remote.now() + TICK_HZ;
        remote.advance(until, &mut |edge: Edge| edges.push(edge));
        assert!(remote.is_idle(), "seed {seed}");
        assert_eq!(remote.positions(), [i64::from(steps)], "seed {seed}");
        let pulses = edges.iter().filter(|edge| edge.line == 0 && edge.level).count();
        assert_eq!(pulses, steps as usize, "seed {seed}");
        assert!(remote.link().counts().repeated > 0, "seed {seed}: no fault did anything");
    }
}

#[test]
fn a_queue_takes_what_it_has_room_for_and_tells_of_new_room() {
    let mut remote = connect(1);
    let capacity = remote.room(0);
    assert_eq!(capacity, 1024);
    let from = remote.now() + TICK_HZ / 5;
    let mut sizer = remote.sizer(0);
    let anchor = Item::Anchor { tick: Tick32::of(from) };
    let mut left = capacity - sizer.size(&anchor);
    remote.push(0, Entry { epoch: Epoch(1), item: anchor }).unwrap();
    let mut steps = 0;
    let items = (0_u32..).map(|k| run(3 + k % 50, 3000 + 11 * i64::from(k * k % 97)));
    for item in items {
        let size = sizer.size(&item);
        let entry = Entry { epoch: Epoch(1), item };
        assert_eq!(remote.room(0), left);
        if size > left {
            assert_eq!(remote.push(0, entry), Err(entry));
            break;
        }
        remote.push(0, entry).unwrap();
        left -= size;
        let Item::Run { segment, .. } = item else { panic!("a run") };
        steps += i64::from(segment.count);
    }
    remote.switch(Epoch(1), from, Lease::Last, &[]).unwrap();
    assert!(remote.room(0) < 40);
    remote.advance(from + steps as u64 * 4100 + TICK_HZ / 10, &mut unseen);
    assert_eq!((remote.positions(), remote.is_idle(), remote.room(0)), (vec![steps], true, capacity));
}

#[test]
fn refused_switches_and_discarded_epochs_leave_no_trace() {
    let mut remote = connect(1);
    let capacity = remote.room(0);
    tell(&mut remote, 1, 0, &[run(5, 4000)]);
    assert!(
        matches!(remote.switch(Epoch(1), 10, Lease::Last, &[]), Err(SwitchRefused::Late { horizon }) if horizon > 10)
    );
    assert_eq!(remote.room(0), capacity);
    tell(&mut remote, 1, 0, &[run(5, 4000)]);
    let far = remote.now() + (1 << 40);
    assert!(
        matches!(remote.switch(Epoch(1), far, Lease::Last, &[]), Err(SwitchRefused::Early { limit }) if limit < far)
    );
    tell(&mut remote, 1, 0, &[run(7, 4000)]);
    remote.discard(Epoch(1));
    assert_eq!(remote.room(0), capacity);
    // The same number again, packed from the beginning.
    let from = remote.now() + TICK_HZ / 10;
    tell(&mut remote, 1, from, &[run(9, 4000)]);
    remote.switch(Epoch(1), from, Lease::Last, &[]).unwrap();
    remote.advance(from + TICK_HZ / 5, &mut unseen);
    assert_eq!(remote.positions(), [9]);
}

#[test]
fn refusals_say_what_and_why() {
    let mut remote = Remote::open(ModelPort::new(), 1).unwrap();
    let refused = remote.arm().unwrap_err();
    assert_eq!(refused, RemoteError::Refused { what: "arm its motors", reason: Reason::NotConfigured, detail: 0 });
    assert_eq!(refused.to_string(), "the board refuses to arm its motors: it has no configuration");
    let refused = remote.configure(&model_setup(5)).unwrap_err();
    assert_eq!(refused.to_string(), "the board refuses to take this configuration: it drives at most 4 motors");
    remote.configure(&model_setup(2)).unwrap();
    let from = remote.now() + TICK_HZ / 10;
    tell(&mut remote, 1, from, &[run(100, 16_000)]);
    remote.switch(Epoch(1), from, Lease::Last, &[]).unwrap();
    remote.advance(from, &mut unseen);
    let refused = remote.release().unwrap_err();
    assert_eq!(refused.to_string(), "the board refuses to release its motors: its motors are moving");
    // Waits until they rest.
    remote.configure(&model_setup(1)).unwrap();
    assert!(remote.now() > from + 100 * 16_000);
}

#[test]
fn the_board_clock_is_read_to_a_millisecond() {
    let mut remote = connect(1);
    for _ in 0..20 {
        let until = remote.now() + TICK_HZ / 10;
        remote.advance(until, &mut unseen);
        let true_tick = (remote.port().now().as_nanos() * 2 / 125) as u64;
        // A bridge on either side, and who knows which of them was slow.
        assert!(remote.now().abs_diff(true_tick) < 3 * TICK_HZ / 1000);
    }
    let (ppm, uncertain) = remote.clock().ppm().unwrap();
    assert!(ppm.abs() <= uncertain, "{ppm} ± {uncertain}");
}

fn framed(tag: Tag, body: impl Fn(&mut Encoder<'_>)) -> Vec<u8> {
    let mut bytes = [0; MAX_FRAME];
    let mut frame = Encoder::new(&mut bytes);
    body(&mut frame);
    let len = frame.finish(tag).unwrap();
    bytes[..len].to_vec()
}

/// A link that a board with tag 1 has taken at 0 s: the next frame has number 1.
fn taken_link() -> Link {
    let mut link = Link::new(1);
    link.hello(Duration::ZERO);
    let info = Info { nonce: 1, tag: Tag(1), window: 240, max_body: 47, ..Info::NOBODY };
    link.output(Duration::ZERO, &mut Vec::new());
    let hello = framed(Tag::NONE, |frame| {
        frame.bytes(&[0, kind::HELLO | kind::ANSWER]);
        info.encode(frame);
    });
    link.input(&hello, Duration::ZERO);
    assert_eq!(link.info(), Some(&info));
    assert!(link.answer().is_some());
    link
}

/// A board that has much to do takes several frames before it answers, and answers the last one: docs/protocol.md. Data that it refuses behind a
/// question take the place of the answer.
#[test]
fn a_question_before_data_that_are_refused_is_answered() {
    let mut link = taken_link();
    link.ask(&Command::Clock, Duration::ZERO);
    link.send(0, Epoch(1), &[0; 8], Duration::ZERO);
    let (mut expected, mut last) = (1, (0, 0));
    for ms in (0..).step_by(5) {
        let now = Duration::from_millis(ms);
        assert!(ms < 1000 && link.error().is_none(), "the question is never answered");
        let (mut bytes, mut decoder) = (Vec::new(), <Decoder>::new());
        link.output(now, &mut bytes);
        let mut said = None;
        for byte in bytes {
            if let Received::Frame(_) = decoder.push(byte) {
                let [seq, code, ..] = *decoder.body() else { panic!("a frame has a number and a kind") };
                if seq == expected {
                    (expected, last) = (seq + 1, (seq, code));
                }
                said = Some((seq, code) == last);
            }
        }
        match (said, last) {
            (None, _) => {}
            (Some(false), _) => link
                .input(&framed(Tag(1), |frame| frame.bytes(&[expected - 1, kind::POLL | kind::ANSWER, 0, 0, 0])), now),
            (_, (seq, kind::CLOCK)) => {
                let clock = framed(Tag(1), |frame| {
                    frame.bytes(&[seq, kind::CLOCK | kind::ANSWER]);
                    frame.u64(17);
                });
                link.input(&clock, now);
            }
            (_, (seq, code)) => {
                let refused = [seq, kind::REFUSED, code, Reason::NotArmed as u8, 0, 0];
                link.input(&framed(Tag(1), |frame| frame.bytes(&refused)), now);
            }
        }
        if let Some(answer) = link.answer() {
            assert_eq!(answer.reply, Reply::Clock { tick: 17 });
            break;
        }
    }
    assert_eq!(link.refusal(), Some((Reason::NotArmed, 0)));
}

/// A board that is heard, but takes nothing or answers nothing: the host does not wait for ever.
#[test]
fn a_board_that_speaks_but_does_not_answer_is_an_error() {
    let check = |ask: &dyn Fn(&mut Link, Duration), said: &[u8], given_up_ms: u64| {
        let mut link = taken_link();
        ask(&mut link, Duration::ZERO);
        let mut ms = 0;
        while link.error().is_none() {
            ms += 5;
            let now = Duration::from_millis(ms);
            link.output(now, &mut Vec::new());
            link.input(&framed(Tag(1), |frame| frame.bytes(said)), now);
            assert!(ms < 10_000, "it waits for ever");
        }
        assert_eq!((link.error(), ms), (Some(LinkError::Unanswered), given_up_ms));
    };
    // A question that is taken after 5 ms, and not answered; data that there is no room for.
    check(&|link, now| link.ask(&Command::Status, now), &[1, kind::POLL | kind::ANSWER, 0, 0, 0], 3805);
    check(&|link, now| link.send(0, Epoch(1), &[0; 8], now), &[0, kind::MISSING, Missing::NoRoom as u8, 0], 3800);
}

/// A question waits behind data. While the board takes those, however slowly, the question is not overdue.
#[test]
fn a_question_behind_slow_data_is_waited_for() {
    let mut link = taken_link();
    let data: u8 = 12;
    for _ in 0..data {
        link.send(0, Epoch(1), &[0; 8], Duration::ZERO);
    }
    link.ask(&Command::Status, Duration::ZERO);
    for seq in 1..=data + 1 {
        let now = Duration::from_millis(500 * u64::from(seq));
        link.output(now, &mut Vec::new());
        link.input(&framed(Tag(1), |frame| frame.bytes(&[seq, kind::POLL | kind::ANSWER, 0, 0, 0])), now);
        assert_eq!(link.error(), None, "after frame {seq}");
    }
}
