//! The flash: what is in it, and the chip's number: no two are alike, and the RP2040 has none of its own.
//!
//! The program is in RAM, so that the flash is free for commands. What the boot ROM has set up for reading is put back after that.

use crate::regs::{self, ssi};

/// Read Unique ID: the command, four bytes of which nothing is said, 64 bits (Winbond W25Q16JV, rev. H, §8.2.32).
const READ_UNIQUE_ID: u8 = 0x4b;
const SILENT: usize = 4;

/// §4.10.13, CTRLR0: frames of 8 bits, one line each way.
const BYTES: u32 = 7 << 16;

/// A byte takes some 400 cycles of the processor; after so many looks there is no such interface.
const PATIENCE: u32 = 10_000;

/// Where the processor reads the flash (§2.6), and its bytes: a Pico's, as memory.ld has them.
const AT: usize = 0x1000_0000;
const ALL: usize = 2 << 20;

/// What is in the flash. A byte that was not read of late takes some 50 cycles: eight are read at once, at a quarter of the clock,
/// by a command of 32 bits.
pub(crate) const fn content() -> &'static [u8] {
    // SAFETY: nothing writes to the flash while this program runs, and it is all there: a smaller chip's repeats. It must not be
    // read while `unique_id` has the interface, which calls nothing that does.
    unsafe { core::slice::from_raw_parts(core::ptr::with_exposed_provenance(AT), ALL) }
}

/// The chip's number; `None` if it does not answer, or has none.
pub(crate) fn unique_id() -> Option<[u8; 8]> {
    let reading = ssi::CTRLR0.read();
    ssi::SSIENR.write(0);
    ssi::CTRLR0.write(BYTES);
    ssi::SSIENR.write(1);
    // The interface takes chip select back whenever it has nothing to send.
    select(2);
    let mut id = Some([0; 8]);
    for place in 0..1 + SILENT + 8 {
        let byte = exchange(if place == 0 { READ_UNIQUE_ID } else { 0 });
        id = match (id, byte) {
            (Some(mut id), Some(byte)) => {
                if let Some(place) = place.checked_sub(1 + SILENT) {
                    id[place] = byte;
                }
                Some(id)
            }
            _ => None,
        };
    }
    select(3);
    ssi::SSIENR.write(0);
    ssi::CTRLR0.write(reading);
    ssi::SSIENR.write(1);
    select(0);
    id.filter(|id| *id != [0; 8] && *id != [0xff; 8])
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
    (0..PATIENCE).find(|_| ssi::SR.read() & ssi::RFNE != 0)?;
    Some(ssi::DR0.read() as u8)
}
