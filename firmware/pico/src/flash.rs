//! The flash: reading and writing it, and the unique number of its chip. The RP2040 has none of its own.
//!
//! The program is in RAM, so that the flash is free for commands. After each command the boot ROM's set-up for reading in place is
//! restored. The chip is a Winbond W25Q16JV (datasheet rev. H, §8.2), whose commands here are those of all chips of its kind.

use crate::clock::TICK_HZ;
use crate::regs::{self, ssi};
use pulsetrain_core::baked::PROGRAM_FLASH_BYTES;

/// Commands.
mod command {
    pub(super) const PAGE_PROGRAM: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    pub(super) const READ_STATUS: u8 = 0x05;
    pub(super) const WRITE_ENABLE: u8 = 0x06;
    pub(super) const SECTOR_ERASE: u8 = 0x20;
    /// Four dummy bytes follow, then the 64 bits.
    pub(super) const READ_UNIQUE_ID: u8 = 0x4b;
}

/// Bit of Status Register-1 (§7.1): the chip erases or programs, and takes no other command.
const BUSY: u8 = 1 << 0;

/// Bytes that are erased together.
pub(crate) const SECTOR: usize = 4096;

/// A chip that is busy for longer is broken, ticks: 0.5 s. A sector takes 0.4 s at most to erase, a page 3 ms to program (§9.6).
const LONGEST_WRITE: u64 = TICK_HZ as u64 / 2;

/// §4.10.13, CTRLR0: frames of 8 bits, one line each way.
const FRAMES_OF_8_BITS: u32 = 7 << 16;

/// Reads of the status register for one byte at most. A byte takes some 400 cycles of the processor: after so many reads the
/// interface does not work.
const MOST_POLLS: u32 = 10_000;

/// Where the processor reads the flash (§2.6).
const XIP_BASE: usize = 0x1000_0000;

/// The flash, but for the sectors of [`store`](crate::store). A byte that is not in the cache takes some 50 cycles: eight are read
/// at a time, by a command of 32 bits at a quarter of the clock.
pub(crate) const fn contents() -> &'static [u8] {
    // SAFETY: nothing writes to this part of the flash while this program runs, and all of it can be read: a smaller chip repeats
    // its contents. It must not be read while `transfer` has the interface, which calls nothing that reads it, nor while the chip
    // is busy: `erase` and `program` return only after that.
    unsafe { core::slice::from_raw_parts(core::ptr::with_exposed_provenance(XIP_BASE), PROGRAM_FLASH_BYTES as usize) }
}

/// The chip's unique number. `None` if it does not answer, or has none.
pub(crate) fn unique_id() -> Option<[u8; 8]> {
    let mut id = [0; 8];
    let answers = transfer(&[command::READ_UNIQUE_ID, 0, 0, 0, 0], &[], &mut id);
    (answers && id != [0; 8] && id != [0xff; 8]).then_some(id)
}

/// Fills `into` from address `at` on. Whether the chip answers.
pub(crate) fn read(at: u32, into: &mut [u8]) -> bool {
    transfer(&addressed(command::READ, at), &[], into)
}

/// Erases the sector at `at`, and waits until it is done. `clock` is called meanwhile, and returns the time, ticks. Whether it was
/// done.
pub(crate) fn erase(at: u32, clock: &mut impl FnMut() -> u64) -> bool {
    enable_write() && transfer(&addressed(command::SECTOR_ERASE, at), &[], &mut []) && is_done(clock)
}

/// Programs `bytes` from `at` on, which are erased and within one page of 256 bytes; waits as [`erase`] does.
pub(crate) fn program(at: u32, bytes: &[u8], clock: &mut impl FnMut() -> u64) -> bool {
    enable_write() && transfer(&addressed(command::PAGE_PROGRAM, at), bytes, &mut []) && is_done(clock)
}

const fn addressed(command: u8, at: u32) -> [u8; 4] {
    let [_, high, middle, low] = at.to_be_bytes();
    [command, high, middle, low]
}

/// Write enable, for the next command.
fn enable_write() -> bool {
    transfer(&[command::WRITE_ENABLE], &[], &mut [])
}

fn is_done(clock: &mut impl FnMut() -> u64) -> bool {
    let began = clock();
    loop {
        let mut status = [BUSY];
        if !transfer(&[command::READ_STATUS], &[], &mut status) || clock() - began > LONGEST_WRITE {
            return false;
        }
        if status[0] & BUSY == 0 {
            return true;
        }
    }
}

/// Sends a command with its `data`, then reads its `answer`. Whether the interface took all of it.
#[inline(never)]
fn transfer(command: &[u8], data: &[u8], answer: &mut [u8]) -> bool {
    let reading = ssi::CTRLR0.read();
    ssi::SSIENR.write(0);
    ssi::CTRLR0.write(FRAMES_OF_8_BITS);
    ssi::SSIENR.write(1);
    // Chip select by hand: the interface would release it whenever it has nothing to send.
    select(2);
    let said = command.iter().chain(data).all(|byte| exchange(*byte).is_some());
    let heard = answer.iter_mut().all(|into| exchange(0).map(|byte| *into = byte).is_some());
    select(3);
    ssi::SSIENR.write(0);
    ssi::CTRLR0.write(reading);
    ssi::SSIENR.write(1);
    select(0);
    said && heard
}

fn select(how: u32) {
    regs::QSPI_SS_CTRL.clear(3 << 8);
    regs::QSPI_SS_CTRL.set(how << 8);
    // Read back, so that the write has arrived.
    regs::QSPI_SS_CTRL.read();
}

/// Sends a byte, and returns the one that comes meanwhile.
fn exchange(byte: u8) -> Option<u8> {
    ssi::DR0.write(byte.into());
    (0..MOST_POLLS).find(|_| ssi::SR.read() & ssi::RFNE != 0)?;
    Some(ssi::DR0.read() as u8)
}
