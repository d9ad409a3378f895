//! An image of a Pico's flash that plays a motion from power-up on. It holds the committed firmware and, behind it, a
//! block with the motion that the firmware finds at its start ([`pulsetrain_core::baked`]). The firmware itself works
//! out the gap between two turns.

use pulsetrain_board::virtual_pico::{self, VirtualPico};
use pulsetrain_board::{RemoteError, Setup, image};
use pulsetrain_core::baked::{LONGEST_PIECE, MAGIC, POINTER, PROGRAM_FLASH_BYTES, Repeats, crc32};
use pulsetrain_core::wire::Baud;
use pulsetrain_motion::program::Program;

use crate::Target;
use crate::error::BakeError;
use crate::streams::{Gap, Shape, Stream, streams};
use crate::table::PutOff;
use pulsetrain_session::drive;

/// Address of a Pico's flash (RP2040 datasheet §2.6).
const FLASH_AT: u32 = 0x1000_0000;

/// An image has whole sectors: of a sector that is given in part the boot ROM may leave the rest unwritten (RP2040
/// datasheet, erratum E14).
const SECTOR: usize = 4096;

/// Ticks that the firmware needs in addition to read a segment from the flash: some 12 bytes, at 48 ticks each with the
/// command that every flash chip knows (8 bytes: 96 bits, each 4 ticks). (est.)
const READ_TICKS: u32 = 600;

/// How the firmware reads a stream.
const SHAPE: Shape = Shape { board: "a Pico", piece: LONGEST_PIECE, long: None, by_pairs: |_| false };

/// An image of a Pico's flash.
#[derive(Clone, Debug)]
pub struct PicoImage {
    /// The flash from its beginning on.
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

impl PicoImage {
    /// Bytes of a Pico's flash that an image may fill. The settings lie behind them.
    pub const FLASH_BYTES: usize = PROGRAM_FLASH_BYTES as usize;

    /// Makes the image of a program for the Pico. The committed firmware runs on the virtual Pico meanwhile, and says
    /// whether it accepts the pins and the pulse times.
    ///
    /// # Errors
    /// [`BakeError`]: the planner refuses the motion, the motion does not repeat or does not fit, or the firmware
    /// refuses the pins.
    pub fn new(program: &Program) -> Result<PicoImage, BakeError> {
        PicoImage::within(program, PicoImage::FLASH_BYTES)
    }

    /// Makes the image within the first `flash_bytes` of the flash, [`FLASH_BYTES`](PicoImage::FLASH_BYTES) at most.
    ///
    /// # Errors
    /// As [`PicoImage::new`].
    pub fn within(program: &Program, flash_bytes: usize) -> Result<PicoImage, BakeError> {
        if Target::of(program) != Some(Target::Rp2040) {
            return Err(BakeError::Board { board: program.board.name.clone() });
        }
        drive::connect(VirtualPico::new(), program, Baud::B115200).map_err(Box::new)?;
        let mut program = program.clone();
        for (motors, ticks) in (1..).zip(&mut program.board.segment_ticks) {
            ticks.onward += motors * READ_TICKS;
            ticks.turning += motors * READ_TICKS;
            // A baked motion comes from no host.
            ticks.heard = 0;
        }
        let mut flash = firmware()?;
        let at = flash.len();
        let limit = flash_bytes.min(PicoImage::FLASH_BYTES).saturating_sub(at);
        let setup = drive::setup(&program);
        let streams = streams(&program, &setup, limit, SHAPE)?;
        let block = block(&setup, &streams).ok_or(RemoteError::Nonsense).map_err(Box::new)?;
        if block.len() > limit {
            let whole_s = streams.iter().map(|stream| stream.length_s).fold(0.0, f64::max);
            let bytes = block.len();
            return Err(BakeError::TooLarge {
                board: SHAPE.board,
                bytes,
                limit,
                fits_s: whole_s * limit as f64 / bytes as f64,
            });
        }
        flash[POINTER..POINTER + 4].copy_from_slice(&(at as u32).to_le_bytes());
        flash.extend(&block);
        flash.resize(flash.len().next_multiple_of(SECTOR), 0xff);
        Ok(PicoImage {
            flash,
            block_bytes: block.len(),
            items: streams.iter().map(|stream| stream.items).sum(),
            endless: streams.iter().any(|stream| stream.repeats.is_some()),
            put_off: streams.iter().map(|stream| stream.put_off).sum(),
        })
    }

    /// The image as UF2, which a Pico's drive and `pulsetrain flash` accept.
    #[must_use]
    pub fn uf2(&self) -> Vec<u8> {
        image::to_uf2(&self.flash, FLASH_AT, virtual_pico::FAMILY)
    }
}

/// The committed firmware, in whole sectors.
fn firmware() -> Result<Vec<u8>, BakeError> {
    let broken = |error: image::ImageError| BakeError::Player { what: error.to_string() };
    let pieces = image::uf2(virtual_pico::IMAGE, virtual_pico::FAMILY).map_err(broken)?;
    let mut flash = image::flat(&pieces, FLASH_AT, PicoImage::FLASH_BYTES).map_err(broken)?;
    flash.resize(flash.len().next_multiple_of(SECTOR), 0xff);
    Ok(flash)
}

/// The block of all motors. `None` with more than 8 motors or more than 2^32 bytes.
fn block(setup: &Setup, streams: &[Stream]) -> Option<Vec<u8>> {
    let motors = setup.motor_bytes();
    let (head, motors) = setup.configuration(&motors)?.to_bytes();
    let mut body = vec![u8::try_from(head.len() + motors.len()).ok()?];
    body.extend(head);
    body.extend(motors);
    for Stream { head, turn, repeats, .. } in streams {
        for part in [head, turn] {
            body.extend(u32::try_from(part.len()).ok()?.to_le_bytes());
        }
        body.extend(Repeats::to_bytes(repeats.map(|Gap { wait, from, to }| Repeats {
            ticks: (wait >> 64) as u64,
            part: (wait >> 32) as u32,
            rest: wait as u32,
            from,
            to,
        })));
    }
    body.extend(streams.iter().flat_map(|stream| [&stream.head, &stream.turn]).flatten());
    let len = u32::try_from(pulsetrain_core::baked::HEAD_LEN + body.len()).ok()?;
    Some([&MAGIC[..], &len.to_le_bytes(), &crc32(&body).to_le_bytes(), &body].concat())
}
