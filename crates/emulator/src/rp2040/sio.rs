//! The single-cycle I/O block SIO (RP2040 datasheet §2.3.1): GPIO registers, divider, spinlocks, and the FIFOs between
//! the processors. The interpolators are not emulated: their registers only store what is written.

/// Cycles from the write that starts a division to its result (§2.3.1.5).
const DIVISION: u64 = 8;

#[derive(Clone, Default)]
struct Divider {
    dividend: u32,
    divisor: u32,
    quotient: u32,
    remainder: u32,
    dirty: bool,
    ready_at: u64,
}

impl Divider {
    /// Divides. A division by zero gives what the hardware's algorithm leaves, because programs read it (§2.3.1.5).
    fn start(&mut self, signed: bool, cycle: u64) {
        let (dividend, divisor) = (self.dividend, self.divisor);
        (self.quotient, self.remainder) = if signed {
            let (dividend, divisor) = (dividend as i32, divisor as i32);
            match divisor {
                0 => (if dividend >= 0 { u32::MAX } else { 1 }, dividend as u32),
                _ => (dividend.wrapping_div(divisor) as u32, dividend.wrapping_rem(divisor) as u32),
            }
        } else {
            match divisor {
                0 => (u32::MAX, dividend),
                _ => (dividend / divisor, dividend % divisor),
            }
        };
        self.dirty = true;
        self.ready_at = cycle + DIVISION;
    }
}

#[derive(Clone)]
pub(super) struct Sio {
    pub(super) out: u32,
    pub(super) out_enable: u32,
    hi_out: u32,
    hi_enable: u32,
    divider: [Divider; 2],
    spinlocks: u32,
    /// The FIFO that each processor reads, with up to eight words.
    fifo: [Vec<u32>; 2],
    /// The sticky flags of FIFO_ST: written while full, and read while empty.
    overflow: [bool; 2],
    underflow: [bool; 2],
    interpolators: [[u32; 32]; 2],
}

impl Sio {
    pub(super) fn new() -> Sio {
        Sio {
            out: 0,
            out_enable: 0,
            hi_out: 0,
            hi_enable: 0,
            divider: Default::default(),
            spinlocks: 0,
            fifo: [Vec::new(), Vec::new()],
            overflow: [false; 2],
            underflow: [false; 2],
            interpolators: [[0; 32]; 2],
        }
    }

    /// The level of a processor's FIFO interrupt: a word waits, or a sticky flag is set (§2.3.1.4).
    pub(super) fn line(&self, core: usize) -> bool {
        !self.fifo[core].is_empty() || self.overflow[core] || self.underflow[core]
    }

    /// Takes a word that the other processor has sent.
    pub(super) fn take(&mut self, core: usize) -> Option<u32> {
        (!self.fifo[core].is_empty()).then(|| self.fifo[core].remove(0))
    }

    /// Sends a word to a processor. Returns `false` if the FIFO is full.
    pub(super) fn send(&mut self, to: usize, word: u32) -> bool {
        let room = self.fifo[to].len() < 8;
        if room {
            self.fifo[to].push(word);
        }
        room
    }

    pub(super) fn read(&mut self, core: usize, offset: u32, inputs: u32, cycle: u64) -> u32 {
        match offset {
            0x000 => core as u32,
            0x004 => inputs,
            // The inputs of the QSPI pins: SD0 to SD3 and CS are pulled up.
            0x008 => 0x3e,
            0x010 => self.out,
            0x020 => self.out_enable,
            0x030 => self.hi_out,
            0x040 => self.hi_enable,
            0x050 => {
                u32::from(!self.fifo[core].is_empty())
                    | u32::from(self.fifo[1 - core].len() < 8) << 1
                    | u32::from(self.overflow[core]) << 2
                    | u32::from(self.underflow[core]) << 3
            }
            0x058 => self.take(core).unwrap_or_else(|| {
                self.underflow[core] = true;
                0
            }),
            0x05c => self.spinlocks,
            0x060..=0x078 => self.read_divider(core, offset, cycle),
            0x080..=0x0fc => self.interpolators[core][(offset as usize - 0x80) / 4],
            0x100..=0x17c => {
                // Reading takes the spinlock. It returns the lock's bit, or 0 if the lock was already taken.
                let bit = 1 << ((offset - 0x100) / 4);
                let free = self.spinlocks & bit == 0;
                self.spinlocks |= bit;
                if free { bit } else { 0 }
            }
            _ => 0,
        }
    }

    fn read_divider(&mut self, core: usize, offset: u32, cycle: u64) -> u32 {
        let divider = &mut self.divider[core];
        let ready = cycle >= divider.ready_at;
        match offset {
            0x060 | 0x068 => divider.dividend,
            0x064 | 0x06c => divider.divisor,
            // A program that reads before the division is complete gets a wrong result on the chip; here it gets the
            // final one.
            0x070 => {
                divider.dirty = false;
                if ready { divider.quotient } else { 0 }
            }
            0x074 => {
                if ready {
                    divider.remainder
                } else {
                    0
                }
            }
            _ => u32::from(ready) | u32::from(divider.dirty) << 1,
        }
    }

    /// Writes a register. Returns whether the pins may have changed.
    pub(super) fn write(&mut self, core: usize, offset: u32, value: u32, cycle: u64) -> bool {
        match offset {
            0x010..=0x01c => alias(&mut self.out, offset, value & super::gpio::PINS),
            0x020..=0x02c => alias(&mut self.out_enable, offset, value & super::gpio::PINS),
            0x030..=0x03c => alias(&mut self.hi_out, offset, value & 0x3f),
            0x040..=0x04c => alias(&mut self.hi_enable, offset, value & 0x3f),
            // The sticky flags are cleared by any write.
            0x050 => (self.overflow[core], self.underflow[core]) = (false, false),
            0x054 => self.overflow[core] |= !self.send(1 - core, value),
            0x060..=0x074 => {
                let divider = &mut self.divider[core];
                match offset {
                    0x060 | 0x068 => divider.dividend = value,
                    0x064 | 0x06c => divider.divisor = value,
                    0x070 => (divider.quotient, divider.dirty) = (value, true),
                    _ => (divider.remainder, divider.dirty) = (value, true),
                }
                if offset < 0x070 {
                    divider.start(offset >= 0x068, cycle);
                }
            }
            0x080..=0x0fc => self.interpolators[core][(offset as usize - 0x80) / 4] = value,
            0x100..=0x17c => self.spinlocks &= !(1 << ((offset - 0x100) / 4)),
            _ => {}
        }
        (0x010..0x030).contains(&offset)
    }
}

/// Writes a register through its own address, or through those that set, clear and toggle.
fn alias(register: &mut u32, offset: u32, value: u32) {
    match offset & 0xc {
        0x0 => *register = value,
        0x4 => *register |= value,
        0x8 => *register &= !value,
        _ => *register ^= value,
    }
}
