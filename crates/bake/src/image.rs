//! An image of an Uno's flash that plays a motion from power-up on. It holds the committed firmware and, right behind
//! it, a block with the motion. The firmware finds that block at its start and then needs no host
//! ([`pulsetrain_core::baked::avr`]).

use std::fmt::Write as _;

use pulsetrain_board::virtual_uno::{self, VirtualUno};
use pulsetrain_board::{RemoteError, Setup, stk500};
use pulsetrain_core::baked::avr::{FRACTION_BITS, HEAD_LEN, LONG, LONG_WAIT, LONGEST_PIECE, LONGEST_WAIT, MAGIC, ZERO};
use pulsetrain_core::baked::crc32;
use pulsetrain_core::packing::Packing;
use pulsetrain_core::wire::Baud;
use pulsetrain_core::wire::message::MotorSetup;
use pulsetrain_core::{Item, Segment, Tick32};
use pulsetrain_motion::program::{Motor, Program, Wiring};

use crate::Target;
use crate::error::BakeError;
use crate::streams::{Gap, LongWaits, Pieces, Shape, Stream, streams};
use crate::table::PutOff;
use pulsetrain_session::drive;

/// Motors that the firmware drives at most.
const MOST: usize = 4;

/// The pin of the Uno's lamp, which bootloaders flash.
const LAMP: u8 = 13;

/// How the firmware reads a stream.
const SHAPE: Shape = Shape {
    board: "an Uno",
    piece: LONGEST_PIECE,
    long: Some(LongWaits { from: LONG_WAIT as u64, most: LONGEST_WAIT as u64, mark: LONG }),
    by_pairs: steps_singly,
};

/// Shortest interval, ticks, at which the firmware has the time to plan steps one at a time.
const FAR: u64 = 2048;

/// Shortest interval, ticks, of steps that the firmware makes without planning each one, where two motors have a ring
/// each (`firmware/uno/src/engine/tuning.rs`).
const FASTEST: u64 = 130;

/// From this many ticks on a gap becomes a wait and a step: the firmware's intervals have 24 bits.
const SHORT_GAP: u64 = 1 << 20;
const LAST_WAIT: u64 = 1 << 16;

/// An image of an Uno's flash.
#[derive(Clone, Debug)]
pub struct Image {
    /// The flash from address 0 on.
    pub flash: Vec<u8>,
    /// Bytes of the motion in the image.
    pub block_bytes: usize,
    /// Segments and waits of all motors.
    pub items: usize,
    /// Whether any motor goes on for ever.
    pub endless: bool,
    /// The steps of all motors that a shared DIR line delays.
    pub put_off: PutOff,
}

impl Image {
    /// Bytes of an Uno's flash that an image may fill. The bootloader lies behind them.
    pub const FLASH_BYTES: usize = stk500::room(stk500::RATES[0]);

    /// Makes the image of a program for the Uno. The committed firmware runs on the virtual Uno meanwhile, and says
    /// whether it accepts the pins and the pulse times.
    ///
    /// # Errors
    /// [`BakeError`]: the planner refuses the motion, the motion does not repeat or does not fit, or the firmware
    /// refuses the pins.
    pub fn new(program: &Program) -> Result<Image, BakeError> {
        if Target::of(program) != Some(Target::Avr) {
            return Err(BakeError::Board { board: program.board.name.clone() });
        }
        check(program)?;
        let mut program = program.clone();
        let baked = program.board.profile.shortest_of_four_baked();
        if let (Some(of_four), Some(baked)) = (program.board.min_interval_ticks.get_mut(3), baked) {
            *of_four = baked.max(*of_four);
        }
        let program = &program;
        drive::connect(VirtualUno::new(), program, Baud::B115200).map_err(Box::new)?;
        let mut flash = virtual_uno::baked_image();
        flash.resize(flash.len().next_multiple_of(2), 0xff);
        let limit = Image::FLASH_BYTES.saturating_sub(flash.len());
        let setup = drive::setup(program);
        let streams = streams(program, &setup, limit, SHAPE)?;
        let block = block(&setup, has_lamp(program), &streams).ok_or(RemoteError::Nonsense).map_err(Box::new)?;
        let bytes = block.len();
        if bytes > limit {
            let whole_s = streams.iter().map(|stream| stream.length_s).fold(0.0, f64::max);
            let fits_s = whole_s * limit as f64 / bytes as f64;
            return Err(BakeError::TooLarge { board: SHAPE.board, bytes, limit, fits_s });
        }
        flash.extend(&block);
        Ok(Image {
            flash,
            block_bytes: bytes,
            items: streams.iter().map(|stream| stream.items).sum(),
            endless: streams.iter().any(|stream| stream.repeats.is_some()),
            put_off: streams.iter().map(|stream| stream.put_off).sum(),
        })
    }

    /// The image as Intel HEX, which `pulsetrain flash` and avrdude write.
    #[must_use]
    pub fn hex(&self) -> String {
        let mut text = String::new();
        for (number, bytes) in self.flash.chunks(16).enumerate() {
            let [high, low] = ((16 * number) as u16).to_be_bytes();
            let record = [&[bytes.len() as u8, high, low, 0], bytes].concat();
            let sum = record.iter().fold(0u8, |sum, byte| sum.wrapping_sub(*byte));
            text.push(':');
            for byte in record.iter().chain([&sum]) {
                let _ = write!(text, "{byte:02X}");
            }
            text.push('\n');
        }
        text + ":00000001FF\n"
    }
}

/// Whether the firmware would plan the steps of this segment one at a time, at 1000 cycles each, though the steps are a few
/// hundred ticks apart. Where a ramp ends, two motors can come to such a segment at once: that was an underrun. The
/// firmware plans step by step if add2 is a tick or more and if add and add2, by its estimate for seven steps, could
/// bring the interval below the shortest one (`firmware/uno/src/engine/steps/plan.rs`, `load.rs`). In two steps add2
/// has no effect.
fn steps_singly(&Segment { count, interval, add, add2 }: &Segment) -> bool {
    let [interval, add, add2] = [interval, add, add2].map(i64::unsigned_abs);
    let change = 8 * add + 128 * add2 + (1 << FRACTION_BITS);
    count > 2
        && add2 >> FRACTION_BITS != 0
        && interval < FAR << FRACTION_BITS
        && interval < change + (FASTEST << FRACTION_BITS)
}

/// Refuses wirings that do not work without a host, though the firmware accepts them. Also refuses what the firmware
/// would refuse, with a message that names the motor.
fn check(program: &Program) -> Result<(), BakeError> {
    let refuse = |motor: &Motor, what: String| Err(BakeError::Wiring { motor: motor.name.clone(), what });
    if let Some(motor) = program.motors.get(MOST) {
        return refuse(motor, format!("there are more than {MOST} motors"));
    }
    for motor in &program.motors {
        match motor.wiring {
            Wiring::Coils { .. } => return refuse(motor, "its coils cannot be baked yet".to_owned()),
            Wiring::StepDir { step: LAMP, .. } => {
                return refuse(
                    motor,
                    format!(
                        "STEP is on pin {LAMP}, which the bootloader flashes at each power-up: steps that are not counted"
                    ),
                );
            }
            Wiring::StepDir { .. } => {}
        }
    }
    Ok(())
}

/// Whether no motor has the lamp's pin.
pub(super) fn has_lamp(program: &Program) -> bool {
    program.motors.iter().all(|motor| match motor.wiring {
        Wiring::StepDir { step, dir, enable, .. } => {
            step != LAMP && dir != LAMP && enable.is_none_or(|(pin, _)| pin != LAMP)
        }
        Wiring::Coils { pins, .. } => !pins.contains(&LAMP),
    })
}

/// The block of all motors. `None` with more than 8 motors. A block that is longer than its length field can say does
/// not fit into the flash anyway.
fn block(setup: &Setup, lamp: bool, streams: &[Stream]) -> Option<Vec<u8>> {
    let motors = setup.motor_bytes();
    let (head, motors) = setup.configuration(&motors)?.to_bytes();
    let mut body = vec![u8::from(lamp), u8::try_from(head.len() + motors.len()).ok()?];
    body.extend(head);
    body.extend(motors);
    let mut parts = Vec::new();
    for (stream, wired) in streams.iter().zip(&setup.motors) {
        let (gaps, rest) = stream.repeats.map_or_else(Default::default, |gap| gaps(&gap, wired));
        let own = [&[anchor(wired), stream.head.clone()].concat(), &stream.turn, &gaps[0], &gaps[1]].map(Vec::clone);
        for part in &own {
            body.extend((part.len() as u16).to_le_bytes());
        }
        body.extend(rest.to_le_bytes());
        parts.extend(own);
    }
    body.extend(parts.concat());
    let len = usize::from(HEAD_LEN) + body.len();
    Some([&MAGIC.to_le_bytes()[..], &(len as u16).to_le_bytes(), &crc32(&body).to_le_bytes(), &body].concat())
}

fn pieces(wired: &MotorSetup, direction: pulsetrain_core::Direction) -> Pieces {
    Pieces::new(Packing { fraction_bits: FRACTION_BITS, gain: wired.gain }, SHAPE, direction)
}

/// Bytes that a block's head begins with.
fn anchor(wired: &MotorSetup) -> Vec<u8> {
    let mut first = pieces(wired, pulsetrain_core::Direction::Forward);
    first.item(&Item::Anchor { tick: Tick32(ZERO) });
    first.finish().0
}

/// The gap, ticks; the gap that is 2^-16 ticks longer; and the remainder below the first one, ticks · 2^-48.
fn gaps(&Gap { wait, from, to }: &Gap, wired: &MotorSetup) -> ([Vec<u8>; 2], u32) {
    let below = 64 - FRACTION_BITS;
    let of = |wait: i128| {
        let mut gap = pieces(wired, from);
        gap.reset();
        let ticks = (wait >> FRACTION_BITS).cast_unsigned() as u64;
        let apart = if ticks >= SHORT_GAP { ticks - LAST_WAIT } else { 0 };
        gap.dwell(apart);
        let interval = (wait - (i128::from(apart) << FRACTION_BITS)) as i64;
        gap.item(&Item::Run { segment: Segment { count: 1, interval, add: 0, add2: 0 }, direction: to });
        gap.finish().0
    };
    let whole = wait >> below;
    ([of(whole), of(whole + 1)], (wait >> (below - 32)) as u32)
}
