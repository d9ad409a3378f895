//! The flash: two planes of 256 KiB, each with its controller (EEFC; Atmel-11057C §18), and what reading them costs.
//!
//! What the datasheet leaves open: the buffers are one line of code, the line after it ("sequential code read
//! optimization"), and one line of data; who reads a plane that is being written waits until that has ended. The times of
//! erasing and writing are those of the SAM3U, whose flash is of the same kind (est.).

use crate::arm::Size;
use std::collections::VecDeque;

/// Bytes of a plane, of a page, of a lock region.
pub(super) const PLANE_BYTES: usize = 256 * 1024;
const PAGE_BYTES: usize = 256;
const PAGES: u32 = (PLANE_BYTES / PAGE_BYTES) as u32;
const REGION_BYTES: usize = 16 * 1024;
const REGIONS: u32 = (PLANE_BYTES / REGION_BYTES) as u32;

const NEVER: u64 = u64::MAX;
const NO_LINE: u32 = u32::MAX;

/// Times, microseconds: writing a page, erasing and writing it, erasing a plane, a lock or GPNVM bit (est.).
const WRITE_US: u64 = 2300;
const ERASE_AND_WRITE_US: u64 = 4600;
const ERASE_ALL_US: u64 = 11_500;
const BIT_US: u64 = 1300;

/// EEFC_FMR (§18).
mod fmr {
    pub(super) const READY_INTERRUPT: u32 = 1;
    pub(super) const WAIT_STATES_AT: u32 = 8;
    /// SCOD: no reading ahead.
    pub(super) const NOT_AHEAD: u32 = 1 << 16;
    /// FAM: 64 bits at once instead of 128.
    pub(super) const NARROW: u32 = 1 << 24;
}

/// EEFC_FSR (§18).
mod fsr {
    pub(super) const READY: u32 = 1;
    pub(super) const COMMAND_ERROR: u32 = 1 << 1;
    pub(super) const LOCK_ERROR: u32 = 1 << 2;
}

const KEY: u32 = 0x5a;

/// The commands of EEFC_FCR (§18).
mod command {
    pub(super) const DESCRIPTOR: u32 = 0;
    pub(super) const WRITE: u32 = 1;
    pub(super) const WRITE_LOCK: u32 = 2;
    pub(super) const ERASE_WRITE: u32 = 3;
    pub(super) const ERASE_WRITE_LOCK: u32 = 4;
    pub(super) const ERASE_ALL: u32 = 5;
    pub(super) const SET_LOCK: u32 = 8;
    pub(super) const CLEAR_LOCK: u32 = 9;
    pub(super) const GET_LOCKS: u32 = 10;
    pub(super) const SET_GPNVM: u32 = 11;
    pub(super) const CLEAR_GPNVM: u32 = 12;
    pub(super) const GET_GPNVM: u32 = 13;
    pub(super) const START_ID: u32 = 14;
    pub(super) const STOP_ID: u32 = 15;
}

/// GPNVM bits: security, boot from flash, boot from plane 1.
const GPNVM_BITS: u32 = 3;
pub(super) const BOOTS_FLASH: u32 = 1 << 1;
pub(super) const BOOTS_PLANE_1: u32 = 1 << 2;

/// A controller and its plane's state.
#[derive(Clone)]
struct Controller {
    mode: u32,
    errors: u32,
    results: VecDeque<u32>,
    latch: [u8; PAGE_BYTES],
    /// Lock bits, one for each region.
    locks: u16,
    /// The cycle in which the command under way ends.
    busy_until: u64,
    /// The page that gets the latch's contents when the command ends, and whether its region is locked then.
    writes: Option<(u32, bool)>,
    shows_id: bool,
}

impl Controller {
    fn new() -> Controller {
        Controller {
            mode: 0,
            errors: 0,
            results: VecDeque::new(),
            latch: [0xff; PAGE_BYTES],
            locks: 0,
            busy_until: 0,
            writes: None,
            shows_id: false,
        }
    }

    fn wait_states(&self) -> u64 {
        (self.mode >> fmr::WAIT_STATES_AT & 15).into()
    }

    /// Bits of an address within a line.
    fn line_bits(&self) -> u32 {
        if self.mode & fmr::NARROW != 0 { 3 } else { 4 }
    }
}

#[derive(Clone)]
pub(super) struct Flash {
    pub(super) bytes: Vec<u8>,
    controllers: [Controller; 2],
    pub(super) gpnvm: u32,
    /// The unique number that STUI shows.
    pub(super) id: [u8; 16],
    /// The line of code in the buffer, the cycle in which it came, and the one from which the next line is read.
    code_line: u32,
    code_ready: u64,
    ahead_from: u64,
    data_line: u32,
    /// The cycle of the next event: a command ends.
    pub(super) next: u64,
}

impl Flash {
    /// A flash with an image at its beginning, the rest erased, and GPNVM1 set: the chip boots from it.
    pub(super) fn new(image: &[u8]) -> Flash {
        let mut bytes = image.to_vec();
        bytes.resize(2 * PLANE_BYTES, 0xff);
        Flash {
            bytes,
            controllers: [Controller::new(), Controller::new()],
            gpnvm: BOOTS_FLASH,
            id: *b"SAM3X8E emulator",
            code_line: NO_LINE,
            code_ready: 0,
            ahead_from: 0,
            data_line: NO_LINE,
            next: NEVER,
        }
    }

    /// Resets the controllers. What a command has not written yet is lost; lock and GPNVM bits stay.
    pub(super) fn reset(&mut self) {
        for controller in &mut self.controllers {
            *controller = Controller { locks: controller.locks, ..Controller::new() };
        }
        self.forget();
        self.next = NEVER;
    }

    /// The ERASE pin (§9.1.4): both planes, lock bits and GPNVM bits.
    pub(super) fn erase(&mut self) {
        self.bytes.fill(0xff);
        self.gpnvm = 0;
        self.controllers = [Controller::new(), Controller::new()];
        self.forget();
        self.next = NEVER;
    }

    fn forget(&mut self) {
        (self.code_line, self.data_line) = (NO_LINE, NO_LINE);
    }

    fn plane(offset: u32) -> usize {
        usize::from(offset as usize >= PLANE_BYTES)
    }

    // Reading. Offsets are from the beginning of plane 0.

    /// Reads the half-word of an instruction. Returns it with the cycles that the processor waits; `slow` are those that
    /// the bus matrix adds to each line.
    #[inline]
    pub(super) fn fetch(&mut self, offset: u32, cycle: u64, reads_ahead: bool, slow: u32) -> (u16, u32) {
        let controller = &self.controllers[Self::plane(offset)];
        let line = offset >> controller.line_bits();
        let at = offset as usize;
        let half = u16::from_le_bytes([self.bytes[at], self.bytes[at + 1]]);
        if line == self.code_line && cycle >= self.code_ready && cycle >= controller.busy_until {
            return (half, 0);
        }
        (half, self.fetch_line(line, Self::plane(offset), cycle, reads_ahead, slow))
    }

    fn fetch_line(&mut self, line: u32, plane: usize, cycle: u64, reads_ahead: bool, slow: u32) -> u32 {
        let controller = &self.controllers[plane];
        let states = controller.wait_states();
        let ready = if line == self.code_line {
            self.code_ready
        } else {
            let is_next = line == self.code_line.wrapping_add(1) && self.code_line != NO_LINE;
            let asked = cycle + states + u64::from(slow);
            if is_next && reads_ahead && controller.mode & fmr::NOT_AHEAD == 0 {
                (self.ahead_from + states + 1).min(asked)
            } else {
                asked
            }
        };
        let ready = ready.max(cycle).max(controller.busy_until);
        if line != self.code_line {
            (self.code_line, self.code_ready, self.ahead_from) = (line, ready, ready);
        }
        u32::try_from(ready - cycle).unwrap_or(u32::MAX)
    }

    /// Reads data. Returns them with the cycles that the processor waits.
    pub(super) fn read(&mut self, offset: u32, size: Size, cycle: u64, slow: u32) -> (u32, u32) {
        let plane = Self::plane(offset);
        let controller = &self.controllers[plane];
        let line = offset >> controller.line_bits();
        let value = self.value(offset, size);
        let mut ready = cycle.max(controller.busy_until);
        if line != self.data_line {
            ready += controller.wait_states() + u64::from(slow);
            self.data_line = line;
            // Reading ahead goes on behind it.
            self.ahead_from = self.ahead_from.max(ready);
        }
        (value, u32::try_from(ready - cycle).unwrap_or(u32::MAX))
    }

    /// Reads without an effect and without time. While the unique number is shown, its plane begins with it.
    pub(super) fn value(&self, offset: u32, size: Size) -> u32 {
        let (at, plane) = (offset as usize, Self::plane(offset));
        let within = at % PLANE_BYTES;
        let shows_id = self.controllers[plane].shows_id && within < self.id.len();
        let (bytes, at) = if shows_id { (&self.id[..], within) } else { (&self.bytes[..], at) };
        let bytes = bytes.get(at..at + size.bytes() as usize).unwrap_or(&[]);
        bytes.iter().rev().fold(0, |value, byte| value << 8 | u32::from(*byte))
    }

    /// Writes to a plane's latch. Only words are taken (§18).
    pub(super) fn write(&mut self, offset: u32, size: Size, value: u32) {
        if size == Size::Word {
            let place = offset as usize % PAGE_BYTES;
            let latch = &mut self.controllers[Self::plane(offset)].latch;
            latch[place..place + 4].copy_from_slice(&value.to_le_bytes());
        }
    }

    // The controllers.

    /// Whether a controller's interrupt line is high.
    pub(super) fn line_asserted(&self, number: usize, cycle: u64) -> bool {
        let controller = &self.controllers[number];
        controller.mode & fmr::READY_INTERRUPT != 0 && cycle >= controller.busy_until
    }

    pub(super) fn read_register(&mut self, number: usize, offset: u32, cycle: u64) -> u32 {
        let controller = &mut self.controllers[number];
        match offset {
            0x00 => controller.mode,
            0x08 => {
                let ready = if cycle >= controller.busy_until { fsr::READY } else { 0 };
                ready | std::mem::take(&mut controller.errors)
            }
            0x0c => controller.results.pop_front().unwrap_or(0),
            _ => 0,
        }
    }

    pub(super) fn write_register(&mut self, number: usize, offset: u32, value: u32, cycle: u64, hz: u64) {
        match offset {
            0x00 => {
                self.controllers[number].mode = value & 0x0101_0f01;
                self.forget();
            }
            0x04 => self.command(number, value, cycle, hz),
            _ => {}
        }
    }

    fn command(&mut self, number: usize, value: u32, cycle: u64, hz: u64) {
        let (command, argument) = (value & 0xff, value >> 8 & 0xffff);
        let (start, gpnvm) = (number * PLANE_BYTES, self.gpnvm);
        let controller = &mut self.controllers[number];
        if cycle < controller.busy_until {
            // §18: a command while another is under way is an error, and so is a wrong key.
            controller.errors |= fsr::COMMAND_ERROR;
            return;
        }
        let is_page = matches!(command, command::WRITE..=command::ERASE_WRITE_LOCK);
        let is_region = matches!(command, command::SET_LOCK | command::CLEAR_LOCK);
        let is_bit = matches!(command, command::SET_GPNVM | command::CLEAR_GPNVM);
        let wrong = value >> 24 != KEY
            || is_page && argument >= PAGES
            || is_region && argument >= PAGES
            || is_bit && argument >= GPNVM_BITS
            || !matches!(command, command::DESCRIPTOR..=command::ERASE_ALL | command::SET_LOCK..=command::STOP_ID);
        if wrong {
            controller.errors |= fsr::COMMAND_ERROR;
            return;
        }
        let region = argument / (REGION_BYTES / PAGE_BYTES) as u32;
        let is_locked = is_page && controller.locks >> region & 1 != 0;
        if is_locked || command == command::ERASE_ALL && controller.locks != 0 {
            controller.errors |= fsr::LOCK_ERROR;
            return;
        }
        controller.results.clear();
        let microseconds = match command {
            command::WRITE | command::WRITE_LOCK => WRITE_US,
            command::ERASE_WRITE | command::ERASE_WRITE_LOCK => ERASE_AND_WRITE_US,
            command::ERASE_ALL => ERASE_ALL_US,
            command::SET_LOCK | command::CLEAR_LOCK | command::SET_GPNVM | command::CLEAR_GPNVM => BIT_US,
            _ => 0,
        };
        controller.busy_until = cycle + microseconds * hz / 1_000_000;
        match command {
            command::WRITE..=command::ERASE_WRITE_LOCK => {
                let locks = matches!(command, command::WRITE_LOCK | command::ERASE_WRITE_LOCK);
                controller.writes = Some((argument, locks));
                if command >= command::ERASE_WRITE {
                    let page = start + argument as usize * PAGE_BYTES;
                    self.bytes[page..page + PAGE_BYTES].fill(0xff);
                }
            }
            command::ERASE_ALL => self.bytes[start..start + PLANE_BYTES].fill(0xff),
            command::SET_LOCK => controller.locks |= 1 << region,
            command::CLEAR_LOCK => controller.locks &= !(1 << region),
            command::GET_LOCKS => controller.results.push_back(controller.locks.into()),
            command::SET_GPNVM => self.gpnvm |= 1 << argument,
            command::CLEAR_GPNVM => self.gpnvm &= !(1 << argument),
            command::GET_GPNVM => controller.results.push_back(gpnvm),
            command::START_ID => controller.shows_id = true,
            command::STOP_ID => controller.shows_id = false,
            _ => {
                let regions = std::iter::repeat_n(REGION_BYTES as u32, REGIONS as usize);
                let bytes = PLANE_BYTES as u32;
                controller.results.extend([0x000f_0640, bytes, PAGE_BYTES as u32, 1, bytes, REGIONS]);
                controller.results.extend(regions);
            }
        }
        // While the number is shown the controller is not ready (§18), but nothing keeps a program from stopping it.
        self.forget();
        self.schedule();
    }

    fn schedule(&mut self) {
        let ends = self.controllers.iter().filter(|controller| controller.writes.is_some());
        self.next = ends.map(|controller| controller.busy_until).min().unwrap_or(NEVER);
    }

    /// Ends the commands that end by a cycle: bits that are 0 in the latch become 0 in the page.
    pub(super) fn run(&mut self, cycle: u64) {
        for number in 0..2 {
            let controller = &mut self.controllers[number];
            if controller.busy_until > cycle {
                continue;
            }
            let Some((page, locks)) = controller.writes.take() else { continue };
            let at = number * PLANE_BYTES + page as usize * PAGE_BYTES;
            for (byte, latched) in self.bytes[at..].iter_mut().zip(&controller.latch) {
                *byte &= latched;
            }
            controller.latch.fill(0xff);
            if locks {
                controller.locks |= 1 << (page / (REGION_BYTES / PAGE_BYTES) as u32);
            }
        }
        self.schedule();
    }
}
