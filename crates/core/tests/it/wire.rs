//! Frames on a line that changes bits, and messages both ways.

use proptest::prelude::*;
use pulsetrain_core::lease::Lease;
use pulsetrain_core::output::Sequence;
use pulsetrain_core::wire::frame::{Received, Tag, framed_len};
use pulsetrain_core::wire::message::{Configuration, MAX_PACKED, MotorSetup};
use pulsetrain_core::wire::settings::{AMAX, MAX_VMAX};
use pulsetrain_core::wire::{Baud, Command, Decoder, Encoder, MAX_BODY, MAX_FRAME, Settings, VERSION};
use pulsetrain_core::{Epoch, Tick32};

fn framed(body: &[u8], tag: Tag) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let mut frame = Encoder::new(&mut out);
    frame.bytes(body);
    let len = frame.finish(tag).expect("a body that fits");
    assert_eq!(len, framed_len(body.len()));
    out[..len].to_vec()
}

/// The frames that a decoder takes from `line`.
fn taken(line: &[u8]) -> Vec<(Tag, Vec<u8>)> {
    let mut decoder = Decoder::<MAX_BODY>::new();
    let mut frames = Vec::new();
    for byte in line {
        if let Received::Frame(tag) = decoder.push(*byte) {
            frames.push((tag, decoder.body().to_vec()));
        }
    }
    frames
}

#[test]
fn frames_are_byte_for_byte_what_the_format_says() {
    fn check(body: &[u8], tag: Tag, expected: &[u8]) {
        assert_eq!(framed(body, tag), expected);
        assert_eq!(taken(expected), [(tag, body.to_vec())]);
    }
    // A length of 1 and its parity; CRC of 03 02 07 and the tag: 0xe8eb = 1110100_0111010_11.
    check(&[7], Tag(0), &[0x03, 0x02, 0x07, 0xf4, 0xba, 0x83, 0x00]);
    check(&[7], Tag(31), &[0x03, 0x02, 0x07, 0x85, 0xcd, 0xfd, 0x00]);
    // COBS: a zero ends a run and is not sent.
    check(&[0x11, 0x00, 0x22], Tag(1), &[0x06, 0x02, 0x11, 0x02, 0x22, 0xda, 0xa9, 0x84, 0x00]);
}

#[test]
fn no_frame_is_longer_than_the_longest() {
    assert_eq!(taken(&framed(&[7; MAX_BODY], Tag(3))), [(Tag(3), vec![7; MAX_BODY])]);
    assert_eq!(taken(&framed(&[0; MAX_BODY], Tag(3))), [(Tag(3), vec![0; MAX_BODY])]);
    for fill in [0, 7] {
        let mut out = [0; 2 * MAX_FRAME];
        let mut frame = Encoder::new(&mut out);
        frame.bytes(&[fill; MAX_BODY + 1]);
        assert_eq!(frame.finish(Tag(3)), None);
    }
    assert_eq!(Encoder::new(&mut [0; MAX_FRAME]).finish(Tag(3)), None, "nothing in it");
    let mut short = [0; 11];
    let mut frame = Encoder::new(&mut short);
    frame.bytes(&[1; 6]);
    assert_eq!(frame.finish(Tag(0)), None, "one byte too short");
    // Longer than any frame, then one: the first is noise, the second is taken.
    for len in [MAX_FRAME, 300, 70_000] {
        let line = [vec![0x55; len], vec![0], framed(&[1, 2, 3], Tag(9))].concat();
        assert_eq!(taken(&line), [(Tag(9), vec![1, 2, 3])], "{len}");
    }
}

#[test]
fn a_motor_s_setup_is_read_as_it_was_written() {
    for (forward_high, step_low) in [(false, false), (false, true), (true, false), (true, true)] {
        let setup = MotorSetup {
            step_pin: 3,
            dir_pin: 8,
            forward_high,
            step_low,
            queue_parts: 61,
            gain: -2,
            pull_in_ticks: 0x0102_0304,
        };
        let bytes = setup.to_bytes();
        let expected = [3, 8, u8::from(forward_high) + 2 * u8::from(step_low) + 4 * 61, 0xfe, 4, 3, 2, 1];
        assert_eq!(bytes, expected);
        assert!(Configuration::new(&bytes).unwrap().motors().eq([setup]));
    }
    for (sequence, code) in [(Sequence::Wave, 240), (Sequence::Full, 241), (Sequence::Half, 242)] {
        let setup = MotorSetup::coils_on(5, sequence);
        assert_eq!((setup.to_bytes(), setup.coils()), ([5, code, 0, 0, 0, 0, 0, 0], Some(sequence)));
    }
}

#[test]
fn parts_of_the_queues_are_of_all_motors_and_no_more_than_all() {
    let is_taken = |parts: &[u8]| {
        let motors: Vec<u8> = parts
            .iter()
            .flat_map(|parts| MotorSetup { queue_parts: *parts, ..MotorSetup::default() }.to_bytes())
            .collect();
        let (head, motors) = Configuration::new(&motors).unwrap().to_bytes();
        Configuration::decode(&[head.as_slice(), motors].concat()).is_some()
    };
    assert!([&[0, 0, 0][..], &[16, 16, 16, 16], &[1, 63], &[1, 1], &[8; 8], &[63]].into_iter().all(is_taken));
    assert!(
        [&[0, 1][..], &[1, 0], &[32, 33], &[63, 0, 1], &[63; 8], &[9; 8]].into_iter().all(|parts| !is_taken(parts))
    );
}

/// Every change of one, two or three bits of a frame between two others: no frame is received that was not sent, and the unchanged
/// neighbour is always received.
///
/// For changes that leave the zeros where they are, the CRC guarantees that. A change that makes or removes a zero is missed so rarely (less
/// than once in 10^10) that none is missed here, where all are tried.
#[test]
fn all_changes_of_up_to_three_bits_are_found() {
    let mut motors = Vec::new();
    for pin in [2, 3] {
        motors.extend(
            MotorSetup { step_pin: pin, dir_pin: 8, pull_in_ticks: 16_000, ..MotorSetup::default() }.to_bytes(),
        );
    }
    let samples = [
        Command::Poll,
        Command::Hello { version: VERSION, nonce: 0x1234_5678 },
        Command::Switch {
            epoch: Epoch(5),
            tick: 0x0123_4567_89ab,
            lease: Lease::Until(Tick32(0x4567_99ab)),
            limits: &[221, 32, 0],
        },
        Command::Configure(Configuration::new(&motors).unwrap()),
        Command::Data { motor: 1, epoch: Epoch(6), packed: &[0x6f, 12, 0, 0x7d, 0, 1, 0, 0, 5, 7, 255, 255, 0] },
    ];
    for (seq, sample) in (250..=255).zip(samples) {
        let mut bytes = [0; MAX_FRAME];
        let len = sample.encode(seq, Tag(11), &mut bytes).unwrap();
        check_flips(&bytes[..len]);
    }
}

fn check_flips(frame: &[u8]) {
    let after = framed(&[0x40, 0x0c], Tag(11));
    let [sent, next] = [taken(frame).remove(0), taken(&after).remove(0)];
    let mut line = [frame, &after].concat();
    let bits = 8 * frame.len();
    let flip = |line: &mut [u8], bit: usize| line[bit / 8] ^= 1 << (bit % 8);
    let check = |line: &[u8]| {
        let mut decoder = Decoder::<MAX_BODY>::new();
        let mut seen_next = false;
        for byte in line {
            if let Received::Frame(tag) = decoder.push(*byte) {
                assert!(tag == next.0 && decoder.body() == next.1, "{line:02x?} from {frame:02x?}, sent {sent:02x?}");
                seen_next = true;
            }
        }
        // A zero that was changed joins the two frames.
        assert_eq!(seen_next, line[frame.len() - 1] == 0, "{line:02x?}");
    };
    for a in 0..bits {
        flip(&mut line, a);
        check(&line);
        for b in 0..a {
            flip(&mut line, b);
            check(&line);
            for c in 0..b {
                flip(&mut line, c);
                check(&line);
                flip(&mut line, c);
            }
            flip(&mut line, b);
        }
        flip(&mut line, a);
    }
}

fn commands() -> impl Strategy<Value = (Vec<u8>, usize)> {
    (prop::collection::vec(any::<u8>(), 1..=MAX_PACKED), 0usize..20)
}

proptest! {
    #[test]
    fn what_is_framed_is_taken(bodies in prop::collection::vec((prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..=MAX_BODY), 0u8..32), 1..6)) {
        let line: Vec<u8> = bodies.iter().flat_map(|(body, tag)| framed(body, Tag(*tag))).collect();
        let expected: Vec<_> = bodies.iter().map(|(body, tag)| (Tag(*tag), body.clone())).collect();
        prop_assert_eq!(taken(&line), expected);
    }

    /// Portions of any size have the same result as single bytes, whatever they contain.
    #[test]
    fn portions_do_not_matter(
        parts in prop::collection::vec(
            prop_oneof![
                prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..=MAX_BODY).prop_map(|body| framed(&body, Tag(5))),
                prop::collection::vec(any::<u8>(), 0..120),
            ],
            1..6,
        ),
        portion in 1usize..100,
    ) {
        let line = parts.concat();
        let (mut one, mut all) = (Decoder::<60>::new(), Decoder::<60>::new());
        let mut here = Vec::new();
        for byte in &line {
            match one.push(*byte) {
                Received::More => {}
                received => here.push((received, one.body().to_vec())),
            }
        }
        let mut there = Vec::new();
        for mut portion in line.chunks(portion) {
            while !portion.is_empty() {
                let (taken, received) = all.feed(portion);
                portion = &portion[taken..];
                if received != Received::More {
                    there.push((received, all.body().to_vec()));
                }
            }
        }
        prop_assert_eq!(here, there);
    }

    #[test]
    fn noise_is_survived(noise in prop::collection::vec(any::<u8>(), 0..400), body in prop::collection::vec(any::<u8>(), 2..60)) {
        let line = [&noise[..], &[0], &framed(&body, Tag(4))].concat();
        let frames = taken(&line);
        prop_assert_eq!(frames.last(), Some(&(Tag(4), body)));
    }

    #[test]
    fn commands_come_back((packed, which) in commands(), seq: u8, tick: u64, nonce: u32, epoch: u8, flags in 0u8..8, times: [u16; 5]) {
        let whole = packed.len() / 8 % 8 * 8;
        let mut setups = packed.clone();
        setups.iter_mut().skip(2).step_by(8).for_each(|flags| *flags &= 3);
        let mut configuration = Configuration::new(&setups[..whole]).unwrap();
        [configuration.pulse_ticks, configuration.setup_ticks, configuration.hold_ticks, configuration.silence_ms, _] = times;
        configuration.idle_ms = (flags & 1 != 0).then_some(times[4]);
        configuration.enable_high = flags & 2 != 0;
        configuration.enable_pin = epoch;
        let lease = if flags % 2 == 0 { Lease::Last } else { Lease::Until(Tick32(nonce)) };
        let limits: Vec<u8> = (0..flags).flat_map(|motor| [epoch | 0x80, 61 - motor, motor]).collect();
        let command = match which {
            0 => Command::Hello { version: epoch, nonce },
            1 => Command::Configure(configuration),
            2 => Command::Arm,
            3 => Command::Release,
            4 => Command::Clock,
            5 => Command::Status,
            6 => Command::Discard { epoch: Epoch(epoch) },
            7 => Command::Switch { epoch: Epoch(epoch), tick, lease, limits: &limits },
            8 => Command::StopNow,
            9 => Command::Baud { baud: Baud::ALL[usize::from(epoch % 5)] },
            10 => Command::Bye,
            11 => Command::Poll,
            12 => Command::Measures { reset: flags & 1 != 0 },
            13 => {
                let [deadman_ms, idle_ms, silence_ms, ..] = times;
                let (vmax, amax) = (nonce % (MAX_VMAX + 1), nonce.clamp(AMAX[0], AMAX[1]));
                Command::Store(Some(Settings { deadman_ms, idle_ms, silence_ms, vmax, amax }))
            }
            14 => Command::Extend { lease, limits: &limits },
            15 => Command::Trim { until: Tick32(nonce), bytes: &packed[..packed.len().min(16) & !1] },
            16 => Command::Brake,
            _ => Command::Data { motor: flags, epoch: Epoch(epoch), packed: &packed },
        };
        let mut bytes = [0; MAX_FRAME];
        let len = command.encode(seq, Tag(2), &mut bytes).unwrap();
        let frames = taken(&bytes[..len]);
        let [(Tag(2), body)] = &frames[..] else { panic!("one frame") };
        prop_assert_eq!(body[0], seq);
        prop_assert_eq!(Command::decode(body[1], &body[2..]), Ok(command));
        // One byte more or less is no command, unless it is data.
        if !matches!(command, Command::Data { .. }) {
            let longer = [&body[2..], &[0]].concat();
            prop_assert!(Command::decode(body[1], &longer).is_err());
            prop_assert!(body.len() == 2 || Command::decode(body[1], &body[2..body.len() - 1]).is_err());
        }
    }

    #[test]
    fn no_body_panics(kind: u8, payload in prop::collection::vec(any::<u8>(), 0..MAX_BODY)) {
        let _ = Command::decode(kind, &payload);
        let _ = pulsetrain_core::wire::Reply::decode(&[&[0, kind], &payload[..]].concat());
    }
}
