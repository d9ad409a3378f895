//! Motions in flash: the format of blocks, and the items that players return turn by turn, in exact integers.

use pulsetrain_core::baked::avr;
use pulsetrain_core::baked::{
    BakedMotor, Block, FRACTION_BITS, HEAD_LEN, LONGEST_PIECE, MAGIC, Player, Repeats, crc32,
};
use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::wire::message::{Configuration, MotorSetup};
use pulsetrain_core::{Direction, Item, Segment, Tick32};

const PACKING: Packing = Packing { fraction_bits: FRACTION_BITS, gain: 3 };

/// Packs items as one piece, from a state on, with a reset before them if they are a turn.
fn piece(state: State, reset: bool, items: &[Item]) -> Vec<u8> {
    let (mut state, mut bytes) = (state, Vec::new());
    let mut out = [0; MAX_PACKED_LEN];
    if reset {
        let len = PACKING.pack_reset(&mut state, &mut out).unwrap();
        bytes.extend(&out[..len]);
    }
    for item in items {
        let len = PACKING.pack(&mut state, item, &mut out).unwrap();
        bytes.extend(&out[..len]);
    }
    assert!((1..=LONGEST_PIECE).contains(&bytes.len()));
    [&[bytes.len() as u8], &bytes[..]].concat()
}

fn run(count: u32, ticks: i64, direction: Direction) -> Item {
    Item::Run { segment: Segment { count, interval: (ticks << 32) + 12_345, add: 678, add2: 0 }, direction }
}

/// The times of a motor's steps, by its unpacked bytes: 2^-32 ticks since the anchor.
struct Steps {
    state: State,
    at: i128,
    position: i64,
    steps: u64,
}

impl Steps {
    fn take(&mut self, mut bytes: &[u8]) {
        while let Some(item) = PACKING.unpack(&mut self.state, &mut bytes).unwrap() {
            match item {
                Item::Anchor { .. } => self.at = 0,
                Item::Dwell { ticks } => self.at += i128::from(ticks) << 32,
                Item::Run { segment, direction } => {
                    self.at += segment.span(segment.count);
                    self.position += i64::from(segment.count) * i64::from(direction.sign());
                    self.steps += u64::from(segment.count);
                }
            }
        }
    }

    fn of() -> Steps {
        Steps { state: State::default(), at: 0, position: 0, steps: 0 }
    }
}

/// A year of turns of 31.56 s on a Pico: turn n begins at n periods, to 2^-32 of a tick.
#[test]
fn nothing_adds_up_in_a_year() {
    let repeats = Repeats {
        ticks: 3_945_000_000,
        part: 0x8123_4567,
        rest: 0xfedc_ba98,
        from: Direction::Backward,
        to: Direction::Forward,
    };
    let head = piece(
        State::default(),
        false,
        &[run(3, 1000, Direction::Forward), run(2, 2000, Direction::Backward), run(1, 5, Direction::Forward)],
    );
    let turn = [run(2, 900, Direction::Forward), run(3, 1100, Direction::Backward)];
    let span: i128 = turn
        .iter()
        .map(|item| if let Item::Run { segment, .. } = item { segment.span(segment.count) } else { 0 })
        .sum();
    let turn = piece(State::new(Direction::Forward), true, &turn);
    let motor = BakedMotor { packing: PACKING, head: &head, turn: &turn, repeats: Some(repeats) };
    let mut player = Player::new(motor, Tick32(77));
    let (mut steps, mut out) = (Steps::of(), [0; LONGEST_PIECE]);
    // The anchor, the head and the first turn.
    for _ in 0..3 {
        let len = player.next(LONGEST_PIECE, &mut out);
        steps.take(&out[..len]);
    }
    let (begin, wait) =
        (steps.at, i128::from(repeats.ticks) << 64 | i128::from(repeats.part) << 32 | i128::from(repeats.rest));
    let turns = 1_000_000;
    for _ in 0..turns {
        // Three parts of the wait, then its rest with a step, then the turn's other steps.
        for _ in 0..5 {
            let len = player.next(LONGEST_PIECE, &mut out);
            steps.take(&out[..len]);
        }
    }
    assert_eq!(steps.at - begin, turns * span + ((turns * wait) >> 32));
    assert_eq!((steps.steps, steps.position), (11 + 6 * turns as u64, 1));
    assert!(!player.is_over());
}

/// A wait that is too long for one item, and a turn of one step.
#[test]
fn long_waits_go_in_parts() {
    let ticks = (5 << 30) + 99;
    let repeats = Repeats { ticks, part: 7, rest: 0, from: Direction::Forward, to: Direction::Forward };
    let head = piece(State::default(), false, &[run(1, 1000, Direction::Forward)]);
    let motor = BakedMotor { packing: PACKING, head: &head, turn: &[], repeats: Some(repeats) };
    let mut player = Player::new(motor, Tick32(0));
    let (mut steps, mut out) = (Steps::of(), [0; LONGEST_PIECE]);
    for _ in 0..2 {
        let len = player.next(LONGEST_PIECE, &mut out);
        steps.take(&out[..len]);
    }
    let begin = steps.at;
    for turn in 1..=3 {
        // Without room the player returns nothing, and loses nothing.
        assert_eq!(player.next(LONGEST_PIECE - 1, &mut out), 0);
        for _ in 0..6 {
            let len = player.next(LONGEST_PIECE, &mut out);
            steps.take(&out[..len]);
        }
        assert_eq!(steps.at - begin, turn * (i128::from(ticks) << 32 | 7));
        assert_eq!(i128::from(steps.steps), 1 + turn);
    }
}

#[test]
fn a_motion_that_ends_is_over() {
    let head = piece(State::default(), false, &[run(5, 1000, Direction::Backward)]);
    let mut player = Player::new(BakedMotor { packing: PACKING, head: &head, turn: &[], repeats: None }, Tick32(0));
    let (mut steps, mut out) = (Steps::of(), [0; LONGEST_PIECE]);
    for _ in 0..2 {
        assert!(!player.is_over());
        let len = player.next(LONGEST_PIECE, &mut out);
        steps.take(&out[..len]);
    }
    assert!(player.is_over() && steps.position == -5);
    assert_eq!(player.next(LONGEST_PIECE, &mut out), 0);
}

/// A block of two motors, as the host writes it.
fn block(repeats: Repeats) -> Vec<u8> {
    let setups = [MotorSetup { step_pin: 2, dir_pin: 3, gain: 3, ..MotorSetup::default() }, MotorSetup::default()];
    let setups: Vec<u8> = setups.iter().flat_map(MotorSetup::to_bytes).collect();
    let mut configuration = Configuration::new(&setups).unwrap();
    (configuration.pulse_ticks, configuration.idle_ms) = (250, Some(3));
    let (head, motors) = configuration.to_bytes();
    let mut body = vec![(head.len() + motors.len()) as u8];
    body.extend(head);
    body.extend(motors);
    for (lens, repeats) in [([3_u32, 2], Some(repeats)), ([1, 0], None)] {
        body.extend(lens.iter().flat_map(|len| len.to_le_bytes()));
        body.extend(Repeats::to_bytes(repeats));
    }
    body.extend([1, 2, 3, 4, 5, 6]);
    let len = (HEAD_LEN + body.len()) as u32;
    [&MAGIC[..], &len.to_le_bytes(), &crc32(&body).to_le_bytes(), &body].concat()
}

#[test]
fn a_block_is_read_whole_or_not_at_all() {
    let repeats = Repeats { ticks: 1 << 40 | 5, part: 6, rest: 7, from: Direction::Backward, to: Direction::Forward };
    let bytes = block(repeats);
    // Bytes after the block do not matter.
    let mut flash = bytes.clone();
    flash.extend([0xff; 100]);
    let read = Block::read(&flash).unwrap();
    assert_eq!((read.configuration.pulse_ticks, read.configuration.idle_ms), (250, Some(3)));
    let motors: Vec<BakedMotor<'_>> = read.motors().collect();
    let other = Packing { gain: 0, ..PACKING };
    assert_eq!(motors[0], BakedMotor { packing: PACKING, head: &[1, 2, 3], turn: &[4, 5], repeats: Some(repeats) });
    assert_eq!(motors[1..], [BakedMotor { packing: other, head: &[6], turn: &[], repeats: None }]);
    for bit in 0..8 * bytes.len() {
        let mut wrong = flash.clone();
        wrong[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(Block::read(&wrong), None, "bit {bit}");
    }
    for len in 0..bytes.len() {
        assert_eq!(Block::read(&bytes[..len]), None, "cut off after {len} bytes");
    }
}

/// A block of one motor at an address, in the Uno's format.
fn avr_block(at: u16, parts: [&[u8]; 4], rest: u32) -> Vec<u8> {
    let mut body = vec![1, 2, 0xaa, 0xbb];
    body.extend(parts.iter().flat_map(|part| (part.len() as u16).to_le_bytes()));
    body.extend(rest.to_le_bytes());
    body.extend(parts.concat());
    let len = avr::HEAD_LEN + body.len() as u16;
    let mut flash = vec![0xff; usize::from(at)];
    flash.extend(avr::MAGIC.to_le_bytes());
    flash.extend(len.to_le_bytes());
    flash.extend(crc32(&body).to_le_bytes());
    flash.extend(&body);
    flash
}

const HERE: avr::QueueState = avr::QueueState { room: avr::LONGEST_PIECE as u16, near: true };
const FAR: avr::QueueState = avr::QueueState { near: false, ..HERE };

/// Ten years of turns of 3 ms on an Uno: the longer gap comes as often as the period's fraction requires.
#[test]
fn nothing_adds_up_in_ten_years_of_a_player_of_8_bits() {
    let rest = 0x9abc_def1;
    let flash = avr_block(66, [&[2, 10, 11, 1, 12], &[3, 1, 2, 3, 1, 4], &[1, 5], &[2, 6, 6]], rest);
    let read = |at: u16| flash[usize::from(at)];
    let (says, end) = avr::block(66, 32_256, read).unwrap();
    assert_eq!((says, usize::from(end)), (76, flash.len()));
    let mut player = avr::AvrPlayer::new(says + 4, says + 4 + avr::MOTOR_LEN, read);
    assert_eq!(player.end(), end);
    let mut out = [0; avr::LONGEST_PIECE];
    let mut next = |player: &mut avr::AvrPlayer| {
        let len = player.next(HERE, read, &mut out);
        out[..len].to_vec()
    };
    assert_eq!([next(&mut player), next(&mut player)], [vec![10, 11], vec![12]]);
    let (mut longer, turns) = (0_u64, 1_000_000);
    for turn in 1..=turns {
        assert_eq!([next(&mut player), next(&mut player)], [vec![1, 2, 3], vec![4]]);
        let gap = next(&mut player);
        longer += u64::from(gap == [6, 6]);
        assert!(gap == [6, 6] || gap == [5], "{gap:?}");
        assert_eq!(longer, (turn * u64::from(rest)) >> 32);
    }
    // The stored period is off by less than 2^-48 ticks. This is the sum of that in ten years of turns of 3 ms.
    assert!(3650.0 * 86_400.0 / 0.003 * 0.5_f64.powi(48) < 0.001);
    assert!(!player.is_over());
}

/// A gap alone is a turn; a head alone ends. A long wait, and the piece after it, are handed over only when the queue is nearly done.
#[test]
fn players_of_8_bits_wait_and_end() {
    let flash = avr_block(0, [&[1, 10], &[], &[avr::LONG | 2, 7, 7, 1, 8], &[1, 9]], 0);
    let read = |at: u16| flash[usize::from(at)];
    let mut player = avr::AvrPlayer::new(14, 14 + avr::MOTOR_LEN, read);
    let mut out = [0; avr::LONGEST_PIECE];
    assert_eq!(player.next(avr::QueueState { room: 39, ..HERE }, read, &mut out), 0, "no room");
    assert_eq!((player.next(FAR, read, &mut out), out[0]), (1, 10));
    for _ in 0..3 {
        assert_eq!((player.next(FAR, read, &mut out), player.next(HERE, read, &mut out), out[1]), (0, 2, 7));
        assert_eq!((player.next(FAR, read, &mut out), player.next(HERE, read, &mut out), out[0]), (0, 1, 8));
    }
    let flash = avr_block(0, [&[1, 10], &[], &[], &[]], 0);
    let read = |at: u16| flash[usize::from(at)];
    let mut player = avr::AvrPlayer::new(14, 14 + avr::MOTOR_LEN, read);
    assert!(!player.is_over());
    assert_eq!(player.next(HERE, read, &mut out), 1);
    assert!(player.is_over() && player.next(HERE, read, &mut out) == 0);
}

/// A block with any one wrong bit is refused, and one that would reach into the bootloader.
#[test]
fn avr_blocks_are_whole_or_none() {
    let flash = avr_block(0, [&[1, 10], &[1, 3], &[1, 4], &[1, 5]], 7);
    let whole = |flash: &[u8], limit| avr::block(0, limit, |at| flash.get(usize::from(at)).copied().unwrap_or(0xff));
    let len = flash.len() as u16;
    assert!(whole(&flash, len).is_some() && whole(&flash, len - 1).is_none());
    for bit in 0..8 * flash.len() {
        let mut damaged = flash.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert_eq!(whole(&damaged, 32_256), None, "bit {bit}");
    }
}
