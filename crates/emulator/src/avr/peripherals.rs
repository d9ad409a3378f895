//! All peripherals together (DS40002061B §10, §12): pending interrupts, the time of the next event, sleep modes.
//!
//! What reading or writing a register does is in `registers`; each peripheral has a file of its own.

use super::eeprom::Eeprom;
use super::external::{External, SYNCHRONISER};
use super::ports::Ports;
use super::spm::SelfProgramming;
use super::timer::{Clock, ICF, OCF, Outputs, TOV, Timer};
use super::timer8::Timer8;
use super::timer16::Timer16;
use super::usart::{EMPTY, RECEIVED, TRANSMITTED, Usart};
use super::watchdog::{TimeOut, Watchdog};
use crate::{Observer, Port};

/// Vector numbers, from 0 for reset (table 12-6).
mod vector {
    pub(super) const INT0: u32 = 1;
    pub(super) const INT1: u32 = 2;
    pub(super) const PCINT0: u32 = 3;
    pub(super) const WDT: u32 = 6;
    pub(super) const TIMER2_COMPA: u32 = 7;
    pub(super) const TIMER1_CAPT: u32 = 10;
    pub(super) const TIMER1_COMPA: u32 = 11;
    pub(super) const TIMER0_COMPA: u32 = 14;
    pub(super) const USART_RX: u32 = 18;
    pub(super) const USART_UDRE: u32 = 19;
    pub(super) const USART_TX: u32 = 20;
    pub(super) const EE_READY: u32 = 22;
    pub(super) const SPM_READY: u32 = 25;
}

// PRR (§10.11.3).
pub(super) const PRUSART0: u8 = 1 << 1;
pub(super) const PRTIM1: u8 = 1 << 3;
pub(super) const PRTIM0: u8 = 1 << 5;
pub(super) const PRTIM2: u8 = 1 << 6;
/// MCUCR.
const IVSEL: u8 = 1 << 1;
/// MCUSR.
pub(super) const WDRF: u8 = 1 << 3;
/// Cycles of every wake-up, before the start-up time (§7.7.1).
const WAKE: u64 = 4;
/// Pins of the outputs OCnA and OCnB (§14.3).
const OC0: [(Port, u8); 2] = [(Port::D, 6), (Port::D, 5)];
const OC1: [(Port, u8); 2] = [(Port::B, 1), (Port::B, 2)];
const OC2: [(Port, u8); 2] = [(Port::B, 3), (Port::D, 3)];
/// Bits of the pins that clock Timer0 and Timer1 (T0, T1 in port D) and of the input capture (ICP1 in port B).
const T0: u8 = 1 << 4;
const T1: u8 = 1 << 5;
const ICP1: u8 = 1;

/// Sleep modes (table 10-2).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sleep {
    Idle,
    AdcNoiseReduction,
    PowerDown,
    PowerSave,
    Standby,
    ExtendedStandby,
}

impl Sleep {
    /// Cycles of start-up after a wake-up, in addition to [`WAKE`] (§10). They are those of an Uno's crystal
    /// oscillator: 16 K cycles in the modes that stop it (table 9-4), 6 in those that do not.
    fn start_up(self) -> u64 {
        match self {
            Sleep::Idle | Sleep::AdcNoiseReduction => 0,
            Sleep::PowerDown | Sleep::PowerSave => 16 * 1024,
            Sleep::Standby | Sleep::ExtendedStandby => 6,
        }
    }
}

/// Lets a timer's outputs drive their pins.
pub(super) struct Pins<'a, O> {
    ports: &'a mut Ports,
    observer: &'a mut O,
    pins: [(Port, u8); 2],
}

impl<'a, O> Pins<'a, O> {
    pub(super) fn timer0(ports: &'a mut Ports, observer: &'a mut O) -> Self {
        Pins { ports, observer, pins: OC0 }
    }

    pub(super) fn timer1(ports: &'a mut Ports, observer: &'a mut O) -> Self {
        Pins { ports, observer, pins: OC1 }
    }

    pub(super) fn timer2(ports: &'a mut Ports, observer: &'a mut O) -> Self {
        Pins { ports, observer, pins: OC2 }
    }
}

impl<O: Observer> Outputs for Pins<'_, O> {
    fn drive(&mut self, channel: usize, driven: Option<bool>, cycle: u64) {
        self.ports.set_override(self.pins[channel], driven, cycle, self.observer);
    }
}

/// An event on its way through a timer's edge detector.
#[derive(Clone, Copy)]
enum Detected {
    Count0,
    Count1,
    Capture { port_changes: u64 },
}

#[derive(Clone)]
pub(super) struct Peripherals {
    pub(super) ports: Ports,
    pub(super) timer0: Timer8,
    pub(super) timer1: Timer16,
    pub(super) timer2: Timer8,
    pub(super) usart: Usart,
    pub(super) watchdog: Watchdog,
    pub(super) eeprom: Eeprom,
    pub(super) programming: SelfProgramming,
    pub(super) external: External,
    /// Registers that are only stored: the peripherals behind them are not emulated.
    pub(super) plain: [u8; 0x100],
    pub(super) smcr: u8,
    pub(super) mcucr: u8,
    pub(super) mcusr: u8,
    pub(super) vectors_open_until: u64,
    pub(super) clkpr: u8,
    pub(super) clock_open_until: u64,
    pub(super) prr: u8,
    pub(super) gtccr: u8,
    /// Events in the edge detectors of the timers, earliest first.
    detected: Vec<(u64, Detected)>,
    /// How often ICP1 has changed. A filtered capture compares it with an earlier value, to know whether the pin was
    /// still.
    capture_changes: u64,
    /// Pending interrupts, one bit for each vector number.
    pub(super) waiting: u32,
    /// The cycle of the next event of any peripheral.
    pub(super) next: u64,
    /// For how many cycles from now the processor is halted.
    pub(super) halt: u64,
    /// The sleep mode, and the cycle in which it began, while the processor sleeps with the I/O clock stopped.
    pub(super) sleeping: Option<Sleep>,
    slept_at: u64,
    /// The cycle in which PRR stopped the USART's clock.
    pub(super) usart_off_at: u64,
    /// Whether the watchdog has timed out and the chip must be reset.
    pub(super) watchdog_reset: bool,
    /// How often `spm` was executed.
    pub(super) spm: u64,
    /// Word address of the boot section.
    pub(super) boot: u16,
    /// The fuse bytes low, high, extended.
    pub(super) fuses: [u8; 3],
}

impl Peripherals {
    pub(super) fn new(boot: u16, fuses: [u8; 3]) -> Peripherals {
        Peripherals {
            ports: Ports::default(),
            timer0: Timer8::new(),
            timer1: Timer16::new(),
            timer2: Timer8::new(),
            usart: Usart::default(),
            watchdog: Watchdog::new(),
            eeprom: Eeprom::new(),
            programming: SelfProgramming::new(),
            external: External::default(),
            plain: [0; 0x100],
            smcr: 0,
            mcucr: 0,
            mcusr: 0,
            vectors_open_until: 0,
            clkpr: 0,
            clock_open_until: 0,
            prr: 0,
            gtccr: 0,
            detected: Vec::new(),
            capture_changes: 0,
            waiting: 0,
            next: u64::MAX,
            halt: 0,
            sleeping: None,
            slept_at: 0,
            usart_off_at: 0,
            watchdog_reset: false,
            spm: 0,
            boot,
            fuses,
        }
    }

    /// Resets all peripherals. `cause` is the bit of MCUSR to set; MCUSR keeps its other bits, except at power-on
    /// (§11.9.1).
    pub(super) fn reset(&mut self, cause: u8, cycle: u64, observer: &mut impl Observer) {
        self.mcusr = if cause == 1 { 1 } else { self.mcusr | cause };
        self.timer0.reset(cycle);
        self.timer1.reset(cycle);
        self.timer2.reset(cycle);
        self.usart.reset(cycle);
        self.eeprom.reset();
        self.programming.reset();
        self.external = External::default();
        self.plain = [0; 0x100];
        (self.smcr, self.mcucr, self.prr, self.gtccr) = (0, 0, 0, 0);
        (self.vectors_open_until, self.clock_open_until) = (0, 0);
        self.set_division(0, cycle, observer);
        self.watchdog.reset(cycle, self.mcusr & WDRF != 0);
        self.detected.clear();
        (self.halt, self.sleeping, self.watchdog_reset) = (0, None, false);
        self.ports.reset(cycle, observer);
        self.ports.changes.clear();
        self.refresh();
    }

    pub(super) fn vectors_in_boot_section(&self) -> bool {
        self.mcucr & IVSEL != 0
    }

    pub(super) fn division(&self) -> u16 {
        1 << self.clkpr.min(8)
    }

    pub(super) fn set_division(&mut self, clkpr: u8, cycle: u64, observer: &mut impl Observer) {
        if self.clkpr != clkpr {
            self.clkpr = clkpr;
            self.watchdog.set_division(self.division(), cycle);
            observer.clock_division(cycle, self.division());
        }
    }

    /// Computes the pending interrupts and the time of the next event.
    pub(super) fn refresh(&mut self) {
        let mut waiting = u32::from(self.external.pending(self.ports.level(Port::D))) << vector::INT0;
        waiting |= u32::from(self.external.change_pending()) << vector::PCINT0;
        waiting |= u32::from(self.watchdog.pending()) << vector::WDT;
        let timer = |timer: &Timer| {
            let pending = u32::from(timer.pending());
            // In the vector table COMPA, COMPB and OVF follow one another.
            pending >> 1 & 1 | pending >> 1 & 2 | (pending & 1) << 2
        };
        waiting |= timer(&self.timer2.timer) << vector::TIMER2_COMPA;
        waiting |= timer(&self.timer1.timer) << vector::TIMER1_COMPA;
        waiting |= u32::from(self.timer1.timer.pending() & ICF != 0) << vector::TIMER1_CAPT;
        waiting |= timer(&self.timer0.timer) << vector::TIMER0_COMPA;
        let usart = self.usart.pending();
        waiting |= u32::from(usart & RECEIVED != 0) << vector::USART_RX;
        waiting |= u32::from(usart & EMPTY != 0) << vector::USART_UDRE;
        waiting |= u32::from(usart & TRANSMITTED != 0) << vector::USART_TX;
        waiting |= u32::from(self.eeprom.pending()) << vector::EE_READY;
        waiting |= u32::from(self.programming.pending()) << vector::SPM_READY;
        self.waiting = waiting;
        let memories = self.eeprom.next_event().min(self.programming.next_event());
        self.next = self.clocked_event().min(self.watchdog.next_event()).min(memories);
    }

    /// The time of the next event of the peripherals that need the I/O clock.
    fn clocked_event(&self) -> u64 {
        // Pin changes are seen without the I/O clock (§13.1).
        let external = self.external.next_event();
        if self.sleeping.is_some() {
            return external;
        }
        let detected = self.detected.first().map_or(u64::MAX, |first| first.0);
        let timer = |timer: &Timer, off: u8| if self.prr & off == 0 { timer.next_event() } else { u64::MAX };
        let usart = if self.prr & PRUSART0 == 0 { self.usart.next_event() } else { u64::MAX };
        timer(&self.timer0.timer, PRTIM0)
            .min(timer(&self.timer1.timer, PRTIM1))
            .min(timer(&self.timer2.timer, PRTIM2))
            .min(usart)
            .min(detected)
            .min(external)
    }

    /// Handles, in order of time, all events up to and including `cycle`.
    pub(super) fn advance(&mut self, cycle: u64, observer: &mut impl Observer) {
        while self.next <= cycle {
            let now = self.next;
            if self.sleeping.is_none() {
                self.timer_advance(now, observer);
                if self.prr & PRUSART0 == 0 && self.usart.next_event() == now {
                    self.usart.event(now, observer);
                    self.serial_pins(now, observer);
                }
                while self.detected.first().is_some_and(|first| first.0 <= now) {
                    let (_, detected) = self.detected.remove(0);
                    self.detected(detected, now, observer);
                }
            }
            self.external.event(now, self.sleeping.is_none());
            if self.eeprom.next_event() == now {
                self.eeprom.event();
            }
            if self.programming.next_event() == now {
                self.programming.event();
            }
            if self.watchdog.next_event() == now && self.watchdog.event(now) == TimeOut::Reset {
                self.watchdog_reset = true;
            }
            self.pin_changes();
            self.refresh();
        }
    }

    /// Advances those timers that have an event up to `now`.
    fn timer_advance(&mut self, now: u64, observer: &mut impl Observer) {
        if self.prr & PRTIM0 == 0 && self.timer0.timer.next_event() <= now {
            self.timer0.timer.advance(now, &mut Pins::timer0(&mut self.ports, observer));
        }
        if self.prr & PRTIM1 == 0 && self.timer1.timer.next_event() <= now {
            self.timer1.timer.advance(now, &mut Pins::timer1(&mut self.ports, observer));
        }
        if self.prr & PRTIM2 == 0 && self.timer2.timer.next_event() <= now {
            self.timer2.timer.advance(now, &mut Pins::timer2(&mut self.ports, observer));
        }
    }

    pub(super) fn sync0(&mut self, cycle: u64, observer: &mut impl Observer) {
        if self.prr & PRTIM0 == 0 {
            self.timer0.timer.advance(cycle, &mut Pins::timer0(&mut self.ports, observer));
        }
    }

    pub(super) fn sync1(&mut self, cycle: u64, observer: &mut impl Observer) {
        if self.prr & PRTIM1 == 0 {
            self.timer1.timer.advance(cycle, &mut Pins::timer1(&mut self.ports, observer));
        }
    }

    pub(super) fn sync2(&mut self, cycle: u64, observer: &mut impl Observer) {
        if self.prr & PRTIM2 == 0 {
            self.timer2.timer.advance(cycle, &mut Pins::timer2(&mut self.ports, observer));
        }
    }

    pub(super) fn sync_all(&mut self, cycle: u64, observer: &mut impl Observer) {
        self.sync0(cycle, observer);
        self.sync1(cycle, observer);
        self.sync2(cycle, observer);
    }

    fn detected(&mut self, detected: Detected, now: u64, observer: &mut impl Observer) {
        match detected {
            Detected::Count0 => {
                self.timer0.timer.count(now, &mut Pins::timer0(&mut self.ports, observer));
            }
            Detected::Count1 => {
                self.timer1.timer.count(now, &mut Pins::timer1(&mut self.ports, observer));
            }
            Detected::Capture { port_changes } => {
                if port_changes == self.capture_changes || !self.timer1.capture_filtered() {
                    self.sync1(now, observer);
                    self.timer1.timer.capture();
                }
            }
        }
    }

    /// Passes on the pin changes since the last call: to the interrupts, timer clocks and input capture that depend on
    /// them.
    pub(super) fn pin_changes(&mut self) {
        if self.ports.changes.is_empty() {
            return;
        }
        for change in std::mem::take(&mut self.ports.changes) {
            self.external.note(change);
            if self.sleeping.is_some() {
                continue;
            }
            let edge = |pin: u8, rising: bool| change.bits & pin != 0 && (change.level & pin != 0) == rising;
            let at = change.cycle + SYNCHRONISER;
            if change.port == Port::D {
                for (clock, pin, detected) in
                    [(self.timer0.timer.clock(), T0, Detected::Count0), (self.timer1.clock(), T1, Detected::Count1)]
                {
                    if let Clock::Pin { rising } = clock
                        && edge(pin, rising)
                    {
                        self.detect(at, detected);
                    }
                }
            }
            if change.port == Port::B && change.bits & ICP1 != 0 {
                self.capture_changes += 1;
                if edge(ICP1, self.timer1.capture_on_rising()) {
                    let extra = if self.timer1.capture_filtered() { 4 } else { 0 };
                    self.detect(at + extra, Detected::Capture { port_changes: self.capture_changes });
                }
            }
        }
        self.refresh();
    }

    fn detect(&mut self, cycle: u64, detected: Detected) {
        let at = self.detected.partition_point(|other| other.0 <= cycle);
        self.detected.insert(at, (cycle, detected));
    }

    /// Sets which pins' changes the ports must report.
    pub(super) fn watch(&mut self) {
        for port in Port::ALL {
            self.ports.watched[port.index()] = self.external.watched(port);
        }
        if matches!(self.timer0.timer.clock(), Clock::Pin { .. }) {
            self.ports.watched[Port::D.index()] |= T0;
        }
        if matches!(self.timer1.clock(), Clock::Pin { .. }) {
            self.ports.watched[Port::D.index()] |= T1;
        }
        // Input capture has no enable bit. Without a running timer its result is worthless, so that ICP1 needs no
        // watching.
        if self.timer1.clock() != Clock::Stopped {
            self.ports.watched[Port::B.index()] |= ICP1;
        }
    }

    pub(super) fn serial_pins(&mut self, cycle: u64, observer: &mut impl Observer) {
        self.ports.set_serial(self.usart.receives(), self.usart.transmits(), cycle, observer);
    }

    /// Takes the pending interrupt with the lowest number, and clears its flag where the chip does so. Returns the word
    /// address of its vector.
    pub(super) fn acknowledge(&mut self) -> u16 {
        let number = self.waiting.trailing_zeros();
        match number {
            vector::INT0 | vector::INT1 => self.external.flags &= !(1 << (number - vector::INT0)),
            3..=5 => self.external.change_flags &= !(1 << (number - vector::PCINT0)),
            vector::WDT => self.watchdog.acknowledge(),
            7..=9 => clear(&mut self.timer2.timer, number - vector::TIMER2_COMPA),
            vector::TIMER1_CAPT => self.timer1.timer.flags &= !ICF,
            11..=13 => clear(&mut self.timer1.timer, number - vector::TIMER1_COMPA),
            14..=16 => clear(&mut self.timer0.timer, number - vector::TIMER0_COMPA),
            vector::USART_TX => self.usart.acknowledge_transmitted(),
            // The other interrupts stay pending as long as their cause lasts.
            _ => {}
        }
        self.refresh();
        number as u16 * 2
    }

    /// Executes `sleep`. The processor falls asleep in `cycle` if SE is set (§10.11.1). Returns whether it does.
    pub(super) fn sleep(&mut self, cycle: u64, observer: &mut impl Observer) -> bool {
        if self.smcr & 1 == 0 {
            return false;
        }
        let mode = match self.smcr >> 1 & 7 {
            1 => Sleep::AdcNoiseReduction,
            2 => Sleep::PowerDown,
            3 => Sleep::PowerSave,
            6 => Sleep::Standby,
            7 => Sleep::ExtendedStandby,
            // Modes 4 and 5 are reserved.
            _ => Sleep::Idle,
        };
        if mode != Sleep::Idle {
            self.advance(cycle, observer);
            self.sync_all(cycle, observer);
            self.sleeping = Some(mode);
            self.slept_at = cycle;
            self.refresh();
        }
        true
    }

    /// Wakes the processor in `cycle`. Returns the cycles until it enters the interrupt.
    pub(super) fn wake(&mut self, cycle: u64) -> u64 {
        let Some(mode) = self.sleeping.take() else { return WAKE };
        let resumed = cycle + mode.start_up();
        let away = resumed - self.slept_at;
        for (timer, off) in
            [(&mut self.timer0.timer, PRTIM0), (&mut self.timer1.timer, PRTIM1), (&mut self.timer2.timer, PRTIM2)]
        {
            if self.prr & off == 0 {
                timer.resume(resumed);
            }
        }
        if self.prr & PRUSART0 == 0 {
            self.usart.delay(away);
        }
        for (due, _) in &mut self.detected {
            *due += away;
        }
        self.refresh();
        mode.start_up() + WAKE
    }
}

fn clear(timer: &mut Timer, which: u32) {
    timer.flags &= ![OCF[0], OCF[1], TOV][which as usize];
}
