//! The link to the firmware itself, on the virtual Uno.

use pulsetrain_board::{Board, Edge, Faults, Lease, Leased, Port, PortError, Remote, Setup, virtual_uno::VirtualUno};
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::{Cause, MotorSetup};
use pulsetrain_core::{Direction, Entry, Epoch, Item, Segment, Tick32};
use pulsetrain_testkit::segments::{Law, Stream};
use pulsetrain_testkit::uno_setup;
use std::time::Duration;

const TICK_HZ: u64 = 16_000_000;

#[test]
fn the_firmware_finds_its_checks_right_at_every_rate() {
    for baud in Baud::ALL {
        let mut remote = Remote::open(VirtualUno::new(), 1).unwrap();
        assert_eq!(remote.set_baud(baud), Ok(baud));
        let motor =
            MotorSetup { step_pin: 8, dir_pin: 9, forward_high: true, pull_in_ticks: 16_000, ..MotorSetup::default() };
        let setup = Setup { pulse_ticks: 16, setup_ticks: 16, hold_ticks: 16, motors: vec![motor], ..Setup::default() };
        remote.configure(&setup).unwrap();
        let from = remote.horizon() + TICK_HZ / 4;
        let mut steps = 0;
        let push = |remote: &mut Remote<VirtualUno>, item| {
            remote.push(0, Entry { epoch: Epoch(1), item }).unwrap();
        };
        push(&mut remote, Item::Anchor { tick: Tick32::of(from) });
        let mut ticks = 0;
        // Each one different from the one before: as many bytes as fit, and some checks among them.
        for k in 0_i64.. {
            if remote.room(0) < 60 {
                break;
            }
            let segment = Segment {
                count: 5 + (k % 3) as u32,
                interval: (4000 + 97 * (k * k % 31)) << 16,
                add: k << 16,
                add2: 0,
            };
            let direction = if k % 9 == 8 { Direction::Backward } else { Direction::Forward };
            push(&mut remote, Item::Run { segment, direction });
            steps += i64::from(direction.sign()) * i64::from(segment.count);
            ticks += (segment.span(segment.count) >> 16) as u64;
        }
        assert_eq!(remote.switch(Epoch(1), from, Lease::Last, &[]), Ok(()), "{baud:?}");
        let mut rises = 0;
        let until = from + ticks + TICK_HZ / 5;
        remote.advance(until, &mut |edge: Edge| rises += i64::from(edge.line == 8 && edge.level));
        assert_eq!(remote.error(), None, "{baud:?}");
        assert!(remote.is_idle(), "{baud:?}");
        assert_eq!((remote.positions(), remote.faults(0)), (vec![steps], Faults::default()), "{baud:?}");
        assert!(rises > steps, "{baud:?}");
    }
}

/// An Uno, and when how many bytes were sent to it.
struct Noted {
    uno: VirtualUno,
    sent: Vec<(Duration, usize)>,
}

impl Port for Noted {
    fn now(&self) -> Duration {
        self.uno.now()
    }
    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        if !bytes.is_empty() {
            self.sent.push((self.now(), bytes.len()));
        }
        self.uno.send(bytes)
    }
    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        self.uno.receive(until, into)
    }
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.uno.set_baud(baud)
    }
}

#[test]
fn a_board_that_has_plenty_to_do_is_sent_a_little_at_a_time() {
    let mut board = Remote::open(Noted { uno: VirtualUno::new(), sent: Vec::new() }, 7).unwrap();
    assert_eq!(board.set_baud(Baud::B1M), Ok(Baud::B1M));
    board.configure(&uno_setup(&[(8, 9)], 16)).unwrap();
    let pool = usize::from(board.info().pool);
    let seconds = TICK_HZ / 2;
    let mut stream = Stream::new(&board, &[Law::changing(50e3)], 0.0, 1, seconds);
    let mut sent = Vec::new();
    stream
        .play(&mut board, &mut |_: Edge| {}, |stream, board| {
            let so_far = std::mem::take(&mut board.port_mut().sent);
            // Neither the first filling of the queue nor its end.
            if (stream.begin + TICK_HZ / 50..stream.begin + seconds - TICK_HZ / 20).contains(&board.now()) {
                sent.extend(so_far);
            }
            Ok(())
        })
        .unwrap();
    assert_eq!(board.error(), None);
    // 50 000 steps a second are some 5 bytes a millisecond.
    let bytes: usize = sent.iter().map(|(_, len)| len).sum();
    assert!(bytes > 2000, "{bytes}");
    assert!(sent.iter().all(|(_, len)| *len <= pool / 12), "{sent:?}");
    assert!(sent.windows(2).all(|pair| pair[1].0 - pair[0].0 >= Duration::from_millis(1)), "{sent:?}");
}

/// Why a board stopped is known, even if the event that says so was not told: the board keeps two of them.
#[test]
fn a_board_that_ran_dry_says_so_though_the_event_is_gone() {
    let mut dry = 0;
    for seed in 1..=8 {
        let mut board = Remote::open(VirtualUno::new(), 7).unwrap();
        board.set_baud(Baud::B1M).unwrap();
        board.configure(&uno_setup(&[(9, 8), (10, 7)], 16)).unwrap();
        // Far more than it keeps up with.
        let mut stream = Stream::new(&board, &[Law::changing(120e3); 2], 1.0, seed, TICK_HZ / 5);
        let lost = |board: &Remote<_>| board.error().map_or(Ok(()), |error| Err(error.to_string()));
        stream.play(&mut board, &mut |_: Edge| {}, |_, board| lost(board)).expect_err("it is too fast");
        let until = board.now() + TICK_HZ / 10;
        board.advance(until, &mut |_: Edge| {});
        let told = board.events().into_iter().map(|event| event.cause).find(|cause| *cause == Cause::Starved);
        let report = board.final_report().expect("it answers, though it refuses what was on its way");
        if told.is_some() {
            dry += 1;
            assert_eq!(report.last_stop, Cause::Starved, "seed {seed}");
        }
        let counts = board.status().unwrap();
        let counts: Vec<_> = counts.motors.as_slice().iter().map(|motor| i64::from(motor.position)).collect();
        assert_eq!(report.positions, counts, "seed {seed}");
    }
    assert!(dry > 0, "none ran dry");
}
