//! The EEPROM (DS40002061B §8.4, §8.6): its 1024 bytes, and EECR, EEDR and EEAR. Reading halts the processor for
//! cycles, writing runs for milliseconds.

use super::sequence::OPEN;

/// Size, bytes (§8.4).
pub(super) const BYTES: usize = 1024;

const EERE: u8 = 1;
const EEPE: u8 = 1 << 1;
const EEMPE: u8 = 1 << 2;
const EERIE: u8 = 1 << 3;
const MODE: u8 = 0b11 << 4;

#[derive(Clone)]
pub(super) struct Eeprom {
    pub(super) bytes: Box<[u8; BYTES]>,
    pub(super) address: u16,
    pub(super) data: u8,
    /// The bits EERIE and EEPM of EECR.
    control: u8,
    /// The first cycle in which it is too late to set EEPE.
    open_until: u64,
    /// The cycle in which the present write is done.
    busy_until: Option<u64>,
}

impl Eeprom {
    pub(super) fn new() -> Eeprom {
        Eeprom { bytes: Box::new([0xff; BYTES]), address: 0, data: 0, control: 0, open_until: 0, busy_until: None }
    }

    /// A reset clears the registers; a write that has begun runs to its end.
    pub(super) fn reset(&mut self) {
        (self.control, self.open_until, self.data) = (0, 0, 0);
    }

    pub(super) fn read(&self, cycle: u64) -> u8 {
        let open = if cycle < self.open_until { EEMPE } else { 0 };
        self.control | open | if self.busy_until.is_some() { EEPE } else { 0 }
    }

    /// Writes EECR in `cycle`. Returns for how many cycles the processor is halted. `division` is that of the system
    /// clock.
    pub(super) fn write(&mut self, value: u8, cycle: u64, division: u16) -> u64 {
        let busy = self.busy_until.is_some();
        self.control = value & EERIE | if busy { self.control & MODE } else { value & MODE };
        let open = cycle < self.open_until;
        if value & EEPE != 0 && open && !busy {
            let cell = &mut self.bytes[usize::from(self.address) % BYTES];
            let (new, microseconds) = match value & MODE {
                0x00 => (self.data, 3400),
                0x10 => (0xff, 1800),
                0x20 => (*cell & self.data, 1800),
                // Mode 3 is reserved: nothing is written.
                _ => (*cell, 0),
            };
            *cell = new;
            self.busy_until = Some(cycle + microseconds * 16 / u64::from(division));
            self.open_until = 0;
            return 2;
        }
        if value & EEMPE != 0 {
            self.open_until = cycle + OPEN;
        }
        if value & EERE != 0 && !busy {
            self.data = self.bytes[usize::from(self.address) % BYTES];
            return 4;
        }
        0
    }

    /// Writes one byte of EEAR. While the EEPROM is written, EEAR keeps its value (§8.6.1).
    pub(super) fn set_address(&mut self, half: usize, value: u8) {
        if self.busy_until.is_none() {
            let mut bytes = self.address.to_le_bytes();
            bytes[half] = value;
            self.address = u16::from_le_bytes(bytes);
        }
    }

    pub(super) fn next_event(&self) -> u64 {
        self.busy_until.unwrap_or(u64::MAX)
    }

    pub(super) fn event(&mut self) {
        self.busy_until = None;
    }

    /// Whether the interrupt is pending: as long as nothing is being written.
    pub(super) fn pending(&self) -> bool {
        self.control & EERIE != 0 && self.busy_until.is_none()
    }
}
