//! The I/O registers at data addresses 0x20 to 0xff (DS40002061B §31): what a read and a write of each does.
//!
//! The registers of peripherals that are not emulated (SPI, two-wire, ADC, analogue comparator) keep what is written to
//! them and do nothing.

use super::cpu::Io;
use super::peripherals::{PRTIM0, PRTIM1, PRTIM2, PRUSART0, Peripherals, Pins, WDRF};
use super::sequence::OPEN;
use super::spm::{FlashChange, NRWW_START, Store};
use super::timer::Timer;
use super::timer8::{shared_clock, timer2_clock};
use super::timer16::Wide;
use crate::{Observer, Port};

macro_rules! registers {
    ($($name:ident = $address:literal,)*) => { $(const $name: u16 = $address;)* };
}
registers! {
    PINB = 0x23, PORTD = 0x2b,
    TIFR0 = 0x35, TIFR1 = 0x36, TIFR2 = 0x37, PCIFR = 0x3b, EIFR = 0x3c, EIMSK = 0x3d,
    EECR = 0x3f, EEDR = 0x40, EEARL = 0x41, EEARH = 0x42, GTCCR = 0x43,
    TCCR0A = 0x44, TCCR0B = 0x45, TCNT0 = 0x46, OCR0A = 0x47, OCR0B = 0x48,
    SMCR = 0x53, MCUSR = 0x54, MCUCR = 0x55, SPMCSR = 0x57,
    WDTCSR = 0x60, CLKPR = 0x61, PRR = 0x64, PCICR = 0x68, EICRA = 0x69, PCMSK0 = 0x6b, PCMSK2 = 0x6d,
    TIMSK0 = 0x6e, TIMSK2 = 0x70,
    TCCR1A = 0x80, TCCR1B = 0x81, TCCR1C = 0x82, TCNT1L = 0x84, OCR1BH = 0x8b,
    TCCR2A = 0xb0, TCCR2B = 0xb1, TCNT2 = 0xb2, OCR2A = 0xb3, OCR2B = 0xb4, ASSR = 0xb6,
    UCSR0A = 0xc0, UCSR0B = 0xc1, UCSR0C = 0xc2, UBRR0L = 0xc4, UBRR0H = 0xc5, UDR0 = 0xc6,
}

// GTCCR (§17.4.1, §18.11.9).
const TSM: u8 = 1 << 7;
const PSRASY: u8 = 1 << 1;
const PSRSYNC: u8 = 1;
// MCUCR.
const IVCE: u8 = 1;
const PUD: u8 = 1 << 4;
/// CLKPR.
const CLKPCE: u8 = 1 << 7;

/// The peripherals, with the observer of the present run.
pub(super) struct Bus<'a, O> {
    pub(super) peripherals: &'a mut Peripherals,
    pub(super) observer: &'a mut O,
}

impl<O: Observer> Bus<'_, O> {
    /// Brings Timer0 up to `cycle` and passes it to `write`. Nothing is written while PRR has stopped its clock.
    fn timer0(&mut self, cycle: u64, write: impl FnOnce(&mut Peripherals, &mut O)) {
        if self.peripherals.prr & PRTIM0 == 0 {
            self.peripherals.sync0(cycle, self.observer);
            write(self.peripherals, self.observer);
        }
    }

    fn timer2(&mut self, cycle: u64, write: impl FnOnce(&mut Peripherals, &mut O)) {
        if self.peripherals.prr & PRTIM2 == 0 {
            self.peripherals.sync2(cycle, self.observer);
            write(self.peripherals, self.observer);
        }
    }

    fn write_timer0(&mut self, address: u16, value: u8, cycle: u64) {
        self.timer0(cycle, |peripherals, observer| {
            let Peripherals { timer0, ports, .. } = peripherals;
            let mut pins = Pins::timer0(ports, observer);
            match address {
                TCCR0A => timer0.write_a(value, cycle, &mut pins),
                TCCR0B => timer0.write_b(value, shared_clock(value), cycle, &mut pins),
                TCNT0 => timer0.timer.write_value(value.into()),
                _ => timer0.timer.write_compare(usize::from(address == OCR0B), value.into()),
            }
        });
    }

    fn write_timer2(&mut self, address: u16, value: u8, cycle: u64) {
        self.timer2(cycle, |peripherals, observer| {
            let Peripherals { timer2, ports, .. } = peripherals;
            let mut pins = Pins::timer2(ports, observer);
            match address {
                TCCR2A => timer2.write_a(value, cycle, &mut pins),
                TCCR2B => timer2.write_b(value, timer2_clock(value), cycle, &mut pins),
                TCNT2 => timer2.timer.write_value(value.into()),
                _ => timer2.timer.write_compare(usize::from(address == OCR2B), value.into()),
            }
        });
    }

    fn write_timer1(&mut self, address: u16, value: u8, cycle: u64) {
        if self.peripherals.prr & PRTIM1 != 0 {
            return;
        }
        self.peripherals.sync1(cycle, self.observer);
        let Peripherals { timer1, ports, .. } = &mut *self.peripherals;
        let mut pins = Pins::timer1(ports, self.observer);
        match address {
            TCCR1A => timer1.write_a(value, cycle, &mut pins),
            TCCR1B => timer1.write_b(value, cycle, &mut pins),
            TCCR1C => timer1.write_c(value, cycle, &mut pins),
            _ => {
                if let Some((register, high)) = wide(address) {
                    timer1.write(register, high, value);
                }
            }
        }
    }

    /// Writes TIFRn: a 1 clears the flag. A flag that is set in this same cycle stays set.
    fn clear_flags(&mut self, number: usize, value: u8, cycle: u64) {
        self.peripherals.advance(cycle - 1, self.observer);
        self.sync(number, cycle - 1);
        self.timer(number).flags &= !value;
        self.peripherals.refresh();
        self.peripherals.advance(cycle, self.observer);
        self.sync(number, cycle);
    }

    fn sync(&mut self, number: usize, cycle: u64) {
        match number {
            0 => self.peripherals.sync0(cycle, self.observer),
            1 => self.peripherals.sync1(cycle, self.observer),
            _ => self.peripherals.sync2(cycle, self.observer),
        }
    }

    fn timer(&mut self, number: usize) -> &mut Timer {
        match number {
            0 => &mut self.peripherals.timer0.timer,
            1 => &mut self.peripherals.timer1.timer,
            _ => &mut self.peripherals.timer2.timer,
        }
    }

    fn set_mask(&mut self, number: usize, value: u8, cycle: u64) {
        self.sync(number, cycle);
        self.timer(number).mask = value & if number == 1 { 0x27 } else { 0x07 };
    }

    /// Writes GTCCR: PSRSYNC resets the prescaler that Timer0 and Timer1 share, PSRASY that of Timer2. While TSM is 1
    /// they stay in reset.
    fn write_gtccr(&mut self, value: u8, cycle: u64) {
        self.peripherals.sync_all(cycle, self.observer);
        let hold = value & TSM != 0;
        let was = self.peripherals.gtccr;
        for (number, bit) in [(0, PSRSYNC), (1, PSRSYNC), (2, PSRASY)] {
            if value & bit != 0 || was & bit != 0 {
                self.timer(number).reset_prescaler(cycle, hold && value & bit != 0);
            }
        }
        // Without TSM the bits are cleared by hardware at once.
        self.peripherals.gtccr = if hold { value & (TSM | PSRASY | PSRSYNC) } else { 0 };
    }

    fn write_prr(&mut self, value: u8, cycle: u64) {
        let peripherals = &mut *self.peripherals;
        peripherals.sync_all(cycle, self.observer);
        let (before, value) = (peripherals.prr, value & 0xef);
        peripherals.prr = value;
        let back = before & !value;
        for (timer, bit) in [
            (&mut peripherals.timer0.timer, PRTIM0),
            (&mut peripherals.timer1.timer, PRTIM1),
            (&mut peripherals.timer2.timer, PRTIM2),
        ] {
            if back & bit != 0 {
                timer.resume(cycle);
            }
        }
        if value & !before & PRUSART0 != 0 {
            peripherals.usart_off_at = cycle;
        }
        if back & PRUSART0 != 0 {
            peripherals.usart.delay(cycle - peripherals.usart_off_at);
        }
    }

    fn write_mcucr(&mut self, value: u8, cycle: u64) {
        let peripherals = &mut *self.peripherals;
        // IVSEL can only change within four cycles after IVCE was written (§12.4).
        let vectors =
            if cycle < peripherals.vectors_open_until && value & IVCE == 0 { value & 2 } else { peripherals.mcucr & 2 };
        if value & IVCE != 0 {
            peripherals.vectors_open_until = cycle + OPEN;
        }
        peripherals.mcucr = value & PUD | vectors;
        peripherals.ports.set_pull_ups_off(value & PUD != 0, cycle, self.observer);
    }

    fn write_usart(&mut self, address: u16, value: u8, cycle: u64) {
        let peripherals = &mut *self.peripherals;
        if peripherals.prr & PRUSART0 != 0 {
            return;
        }
        match address {
            UCSR0A => peripherals.usart.write_a(value),
            UCSR0B => peripherals.usart.write_b(value, cycle),
            UCSR0C => peripherals.usart.write_c(value),
            UBRR0L => {
                let ubrr = peripherals.usart.ubrr() & 0xff00 | u16::from(value);
                peripherals.usart.write_ubrr(ubrr, cycle);
            }
            UBRR0H => peripherals.usart.write_high(value),
            _ => peripherals.usart.write_data(value, cycle),
        }
        peripherals.serial_pins(cycle, self.observer);
    }
}

/// Which 16-bit register of Timer1 an address belongs to, and whether it is the high byte.
fn wide(address: u16) -> Option<(Wide, bool)> {
    let register = match address & !1 {
        0x84 => Wide::Counter,
        0x86 => Wide::Capture,
        0x88 => Wide::CompareA,
        0x8a => Wide::CompareB,
        _ => return None,
    };
    Some((register, address & 1 != 0))
}

/// Which port an address belongs to, and which register of it: 0 PINx, 1 DDRx, 2 PORTx.
fn port(address: u16) -> (Port, u16) {
    let offset = address - PINB;
    (Port::ALL[usize::from(offset / 3) % 3], offset % 3)
}

/// Whether writing a 1 to the register triggers something. `sbi` then writes its one bit alone, so that the other flags
/// stay.
fn writes_ones(address: u16) -> bool {
    matches!(address, TIFR0 | TIFR1 | TIFR2 | PCIFR | EIFR) || (PINB..=PORTD).contains(&address) && port(address).1 == 0
}

impl<O: Observer> Io for Bus<'_, O> {
    fn read(&mut self, address: u16, cycle: u64) -> u8 {
        self.peripherals.advance(cycle, self.observer);
        match address {
            PINB..=PORTD => {
                let (port, which) = port(address);
                match which {
                    0 => self.peripherals.ports.pin(port, cycle),
                    1 => self.peripherals.ports.ddr(port),
                    _ => self.peripherals.ports.port(port),
                }
            }
            TIFR0..=TIFR2 => {
                let number = usize::from(address - TIFR0);
                self.sync(number, cycle);
                self.timer(number).flags
            }
            PCIFR => self.peripherals.external.change_flags,
            EIFR => self.peripherals.external.flags,
            EIMSK => self.peripherals.external.mask,
            EECR => self.peripherals.eeprom.read(cycle),
            SPMCSR => self.peripherals.programming.read(cycle),
            EEDR => self.peripherals.eeprom.data,
            EEARL => self.peripherals.eeprom.address.to_le_bytes()[0],
            EEARH => self.peripherals.eeprom.address.to_le_bytes()[1],
            GTCCR => self.peripherals.gtccr,
            TCCR0A => self.peripherals.timer0.a,
            TCCR0B => self.peripherals.timer0.b,
            TCNT0 => {
                self.sync(0, cycle);
                self.timer(0).value().to_le_bytes()[0]
            }
            OCR0A | OCR0B => self.timer(0).compare_register(usize::from(address - OCR0A)).to_le_bytes()[0],
            SMCR => self.peripherals.smcr,
            MCUSR => self.peripherals.mcusr,
            MCUCR => {
                let open = if cycle < self.peripherals.vectors_open_until { IVCE } else { 0 };
                self.peripherals.mcucr | open
            }
            WDTCSR => self.peripherals.watchdog.read(cycle),
            CLKPR => {
                let open = if cycle < self.peripherals.clock_open_until { CLKPCE } else { 0 };
                self.peripherals.clkpr | open
            }
            PRR => self.peripherals.prr,
            PCICR => self.peripherals.external.change_enable,
            EICRA => self.peripherals.external.sense,
            PCMSK0..=PCMSK2 => self.peripherals.external.change_mask[usize::from(address - PCMSK0)],
            TIMSK0..=TIMSK2 => self.timer(usize::from(address - TIMSK0)).mask,
            TCCR1A => self.peripherals.timer1.a,
            TCCR1B => self.peripherals.timer1.b,
            TCCR1C => 0,
            TCNT1L..=OCR1BH => {
                self.sync(1, cycle);
                wide(address).map_or(0, |(register, high)| self.peripherals.timer1.read(register, high))
            }
            TCCR2A => self.peripherals.timer2.a,
            TCCR2B => self.peripherals.timer2.b,
            TCNT2 => {
                self.sync(2, cycle);
                self.timer(2).value().to_le_bytes()[0]
            }
            OCR2A | OCR2B => self.timer(2).compare_register(usize::from(address - OCR2A)).to_le_bytes()[0],
            UCSR0A => self.peripherals.usart.read_a(),
            UCSR0B => self.peripherals.usart.read_b(),
            UCSR0C => self.peripherals.usart.read_c(),
            UBRR0L => self.peripherals.usart.ubrr().to_le_bytes()[0],
            UBRR0H => self.peripherals.usart.ubrr().to_le_bytes()[1],
            UDR0 => {
                let data = self.peripherals.usart.read_data();
                self.peripherals.refresh();
                data
            }
            _ => self.peripherals.plain[usize::from(address & 0xff)],
        }
    }

    fn write(&mut self, address: u16, value: u8, cycle: u64) {
        if let TIFR0..=TIFR2 = address {
            self.clear_flags(usize::from(address - TIFR0), value, cycle);
            self.peripherals.refresh();
            return;
        }
        self.peripherals.advance(cycle, self.observer);
        match address {
            PINB..=PORTD => {
                let (port, which) = port(address);
                let ports = &mut self.peripherals.ports;
                match which {
                    // Ones toggle PORTx (§14.2.2).
                    0 => ports.set_port(port, ports.port(port) ^ value, cycle, self.observer),
                    1 => ports.set_ddr(port, value, cycle, self.observer),
                    _ => ports.set_port(port, value, cycle, self.observer),
                }
                self.peripherals.pin_changes();
                return;
            }
            PCIFR => self.peripherals.external.change_flags &= !value,
            EIFR => self.peripherals.external.flags &= !value,
            EIMSK => self.peripherals.external.mask = value & 3,
            EECR => {
                let division = self.peripherals.division();
                let idle = self.peripherals.eeprom.next_event() == u64::MAX;
                self.peripherals.halt += self.peripherals.eeprom.write(value, cycle, division);
                if idle && self.peripherals.eeprom.next_event() != u64::MAX {
                    self.peripherals.programming.eeprom_written();
                }
            }
            EEDR => self.peripherals.eeprom.data = value,
            EEARL => self.peripherals.eeprom.set_address(0, value),
            EEARH => self.peripherals.eeprom.set_address(1, value & 3),
            GTCCR => self.write_gtccr(value, cycle),
            TCCR0A..=OCR0B => self.write_timer0(address, value, cycle),
            SMCR => self.peripherals.smcr = value & 0x0f,
            // Bits are cleared by zeros (§11.9.1).
            MCUSR => self.peripherals.mcusr &= value,
            MCUCR => self.write_mcucr(value, cycle),
            SPMCSR => {
                let eeprom_busy = self.peripherals.eeprom.next_event() != u64::MAX;
                self.peripherals.programming.write(value, cycle, eeprom_busy);
            }
            WDTCSR => {
                let forced = self.peripherals.mcusr & WDRF != 0;
                self.peripherals.watchdog.write(value, cycle, forced);
            }
            CLKPR => {
                if value & CLKPCE != 0 && value & 0x0f == 0 {
                    self.peripherals.clock_open_until = cycle + OPEN;
                } else if cycle < self.peripherals.clock_open_until && value & CLKPCE == 0 {
                    self.peripherals.clock_open_until = 0;
                    // Table 9-17: divisions beyond 256 are reserved.
                    self.peripherals.set_division((value & 0x0f).min(8), cycle, self.observer);
                }
            }
            PRR => self.write_prr(value, cycle),
            PCICR => self.peripherals.external.change_enable = value & 7,
            EICRA => self.peripherals.external.sense = value & 0x0f,
            PCMSK0..=PCMSK2 => self.peripherals.external.change_mask[usize::from(address - PCMSK0)] = value,
            TIMSK0..=TIMSK2 => self.set_mask(usize::from(address - TIMSK0), value, cycle),
            TCCR1A..=TCCR1C | TCNT1L..=OCR1BH => self.write_timer1(address, value, cycle),
            TCCR2A..=OCR2B => self.write_timer2(address, value, cycle),
            // Timer2 with a crystal of its own is not emulated.
            ASSR => {}
            UCSR0A..=UCSR0C | UBRR0L..=UDR0 => self.write_usart(address, value, cycle),
            _ => {
                self.peripherals.plain[usize::from(address & 0xff)] = value;
                return;
            }
        }
        if matches!(address, EIMSK | EICRA | PCMSK0..=PCMSK2 | TCCR0B | TCCR1B) {
            self.peripherals.watch();
        }
        self.peripherals.pin_changes();
        self.peripherals.refresh();
    }

    fn write_bit(&mut self, address: u16, bit: u8, value: bool, cycle: u64) {
        let mask = 1 << bit;
        if writes_ones(address) {
            if value {
                self.write(address, mask, cycle);
            }
            return;
        }
        // `sbi` and `cbi` read the register in the first of their two cycles.
        let before = self.read(address, cycle - 2);
        self.write(address, if value { before | mask } else { before & !mask }, cycle);
    }

    fn next(&self) -> u64 {
        // A halt takes effect at once: the processor must look before its next instruction.
        if self.peripherals.halt != 0 { 0 } else { self.peripherals.next }
    }

    fn waits(&self) -> bool {
        self.peripherals.waiting != 0
    }

    fn watchdog(&mut self, cycle: u64) {
        self.peripherals.watchdog.feed(cycle);
        self.peripherals.refresh();
    }

    fn sleep(&mut self, cycle: u64) -> bool {
        self.peripherals.sleep(cycle, self.observer)
    }

    fn store_program_memory(&mut self, pc: u16, z: u16, word: u16, cycle: u64) -> Option<FlashChange> {
        let division = self.peripherals.division();
        let Peripherals { programming, boot, .. } = &mut *self.peripherals;
        let (boot, from_boot) = (*boot, pc >= *boot);
        let (change, halt) = programming.store(Store { z, word, from_boot, boot, cycle, division });
        self.peripherals.spm += 1;
        self.peripherals.halt += halt;
        self.peripherals.refresh();
        change
    }

    fn load_program_memory(&mut self, pc: u16, z: u16, cycle: u64) -> Option<u8> {
        let Peripherals { programming, boot, fuses, .. } = &mut *self.peripherals;
        if programming.attends() { programming.load(z, *fuses, pc >= *boot, *boot, cycle) } else { None }
    }

    fn program_blocked(&self, pc: u16) -> bool {
        self.peripherals.programming.blocks() && pc < NRWW_START
    }
}
