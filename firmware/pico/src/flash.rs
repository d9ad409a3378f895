//! The flash: what is in it, and the chip's number: no two are alike, and the RP2040 has none of its own.
//!
//! The program is in RAM, so that the flash is free for commands. What the boot ROM has set up for reading is put back after each. The
//! chip is a Winbond W25Q16JV (datasheet rev. H, §8.2), whose commands here are those of all chips of its kind.

use crate::clock::TICK_HZ;
use crate::regs::{self, ssi};
use pulsetrain_core::baked::FLASH_ROOM;

/// Commands.
mod command {
    pub(super) const PAGE_PROGRAM: u8 = 0x02;
    pub(super) const READ: u8 = 0x03;
    pub(super) const READ_STATUS: u8 = 0x05;
    pub(super) const WRITE_ENABLE: u8 = 0x06;
    pub(super) const SECTOR_ERASE: u8 = 0x20;
    /// Four bytes follow of which nothing is said, then 64 bits.
    pub(super) const READ_UNIQUE_ID: u8 = 0x4b;
}

/// Bit of Status Register-1 (§7.1): it erases or programs, and hears nothing else.
const BUSY: u8 = 1 << 0;

/// Bytes that are erased together.
pub(crate) const SECTOR: usize = 4096;

/// It is done after so long, ticks: 0.5 s. A sector takes 0.4 s at most, a page 3 ms (§9.6).
const LONGEST_WRITE: u64 = TICK_HZ as u64 / 2;

/// §4.10.13, CTRLR0: frames of 8 bits, one line each way.
const FRAMES_OF_8_BITS: u32 = 7 << 16;

/// A byte takes some 400 cycles of the processor; after so many looks there is no such interface.
const MOST_POLLS: u32 = 10_000;

/// Where the processor reads the flash (§2.6).
const XIP_BASE: usize = 0x1000_0000;

/// What is in the flash, but for [`store`](crate::store)'s sectors. A byte that was not read of late takes some 50 cycles: eight are
/// read at once, at a quarter of the clock, by a command of 32 bits.
pub(crate) const fn contents() -> &'static [u8] {
    // SAFETY: nothing writes to this part of the flash while this program runs, and it is all there: a smaller chip's repeats. It must
    // not be read while `command` has the interface, which calls nothing that does, or while the chip is busy, which whoever has it
    // erase or program waits for.
    unsafe { core::slice::from_raw_parts(core::ptr::with_exposed_provenance(XIP_BASE), FLASH_ROOM as usize) }
}

/// The chip's number; `None` if it does not answer, or has none.
pub(crate) fn unique_id() -> Option<[u8; 8]> {
    let mut id = [0; 8];
    let answers = transfer(&[command::READ_UNIQUE_ID, 0, 0, 0, 0], &[], &mut id);
    (answers && id != [0; 8] && id != [0xff; 8]).then_some(id)
}

/// Fills `into` with what is in the flash from `at` on; whether it answers.
pub(crate) fn read(at: u32, into: &mut [u8]) -> bool {
    transfer(&addressed(command::READ, at), &[], into)
}

/// Erases the sector at `at`, and waits until that is done: `look` is called meanwhile, and gives the time, ticks. Whether it was.
pub(crate) fn erase(at: u32, look: &mut impl FnMut() -> u64) -> bool {
    enable_write() && transfer(&addressed(command::SECTOR_ERASE, at), &[], &mut []) && is_done(look)
}

/// Writes `bytes` from `at` on, where all is erased, within one page of 256 bytes; waits as [`erase`] does.
pub(crate) fn program(at: u32, bytes: &[u8], look: &mut impl FnMut() -> u64) -> bool {
    enable_write() && transfer(&addressed(command::PAGE_PROGRAM, at), bytes, &mut []) && is_done(look)
}

const fn addressed(command: u8, at: u32) -> [u8; 4] {
    let [_, high, middle, low] = at.to_be_bytes();
    [command, high, middle, low]
}

/// For the next command.
fn enable_write() -> bool {
    transfer(&[command::WRITE_ENABLE], &[], &mut [])
}

fn is_done(look: &mut impl FnMut() -> u64) -> bool {
    let began = look();
    loop {
        let mut status = [BUSY];
        if !transfer(&[command::READ_STATUS], &[], &mut status) || look() - began > LONGEST_WRITE {
            return false;
        }
        if status[0] & BUSY == 0 {
            return true;
        }
    }
}

/// Says a command, and its `data`, then listens to its `answer`; whether the interface took all of it.
#[inline(never)]
fn transfer(command: &[u8], data: &[u8], answer: &mut [u8]) -> bool {
    let reading = ssi::CTRLR0.read();
    ssi::SSIENR.write(0);
    ssi::CTRLR0.write(FRAMES_OF_8_BITS);
    ssi::SSIENR.write(1);
    // The interface takes chip select back whenever it has nothing to send.
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
    // It has arrived.
    regs::QSPI_SS_CTRL.read();
}

/// Sends a byte, and gives the one that comes meanwhile.
fn exchange(byte: u8) -> Option<u8> {
    ssi::DR0.write(byte.into());
    (0..MOST_POLLS).find(|_| ssi::SR.read() & ssi::RFNE != 0)?;
    Some(ssi::DR0.read() as u8)
}
