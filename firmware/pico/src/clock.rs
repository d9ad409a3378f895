//! The chip's clocks, and the board's: SysTick at 125 MHz, extended to 64 bits by looking at it often enough: at least once in
//! 2^24 ticks (134 ms), or a wrap is missed.

use crate::regs;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::Millis;

/// Ticks per second; one tick is one cycle of processor, PIO and DMA.
pub(crate) const TICK_HZ: u32 = 125_000_000;

/// The crystal.
const CRYSTAL_HZ: u32 = 12_000_000;

/// §2.18.2.1: 12 MHz · 125 / 6 / 2; the oscillator within is at 1500 MHz, of 750 to 1600.
const FEEDBACK: u32 = 125;
const DIVIDERS: [u32; 2] = [6, 2];
const _: () = assert!(CRYSTAL_HZ / 4 * FEEDBACK / DIVIDERS[0] / DIVIDERS[1] * 4 == TICK_HZ);

/// The same for USB: 12 MHz · 120 / 6 / 5; within 1440 MHz.
const USB_HZ: u32 = 48_000_000;
const USB_FEEDBACK: u32 = 120;
const USB_DIVIDERS: [u32; 2] = [6, 5];
const _: () = assert!(CRYSTAL_HZ / 5 * USB_FEEDBACK / USB_DIVIDERS[0] / USB_DIVIDERS[1] * 5 == USB_HZ);

/// Bits of SysTick.
const BITS: u32 = 24;
const MASK: u32 = (1 << BITS) - 1;

/// Sets up crystal, PLLs and clocks: processor and peripherals at [`TICK_HZ`], USB at 48 MHz, the timer at 1 MHz.
pub(crate) fn set_up() {
    regs::CLK_SYS_RESUS_CTRL.write(0);
    // §2.16.3: 1 ms at 12 MHz, in units of 256 cycles.
    regs::XOSC_STARTUP.write(47);
    regs::XOSC_CTRL.write(0xfab << 12 | 0xaa0);
    while regs::XOSC_STATUS.read() & 1 << 31 == 0 {}
    // On the reference while the PLL starts (§2.15.3.2).
    regs::CLK_SYS_CTRL.clear(1);
    while regs::CLK_SYS_SELECTED.read() & 1 == 0 {}
    regs::CLK_REF_CTRL.write(2);
    while regs::CLK_REF_SELECTED.read() & 1 << 2 == 0 {}
    start_pll(regs::PLL_SYS, regs::reset::PLL_SYS, FEEDBACK, DIVIDERS);
    start_pll(regs::PLL_USB, regs::reset::PLL_USB, USB_FEEDBACK, USB_DIVIDERS);
    // Its source is the PLL; then it is taken.
    regs::CLK_SYS_CTRL.write(0);
    regs::CLK_SYS_CTRL.set(1);
    while regs::CLK_SYS_SELECTED.read() & 1 << 1 == 0 {}
    regs::CLK_PERI_CTRL.write(1 << 11);
    // Its PLL is source 0.
    regs::CLK_USB_CTRL.write(1 << 11);
    // The timer counts the watchdog's ticks: one in 12 cycles of the crystal (§4.7.2).
    regs::WATCHDOG_TICK.write((1 << 9) | (CRYSTAL_HZ / 1_000_000));
}

/// Takes pins and timer out of reset.
pub(crate) fn take_pins() {
    regs::take_out_of_reset(regs::reset::IO_BANK0 | regs::reset::PADS_BANK0 | regs::reset::TIMER);
}

/// §2.18.3: power and oscillator on, wait for lock, dividers on.
fn start_pll(pll: regs::Pll, reset: u32, feedback: u32, dividers: [u32; 2]) {
    regs::RESETS_RESET.set(reset);
    regs::take_out_of_reset(reset);
    pll.cs().write(1);
    pll.fbdiv().write(feedback);
    pll.pwr().clear(1 << 0 | 1 << 5);
    while pll.cs().read() & 1 << 31 == 0 {}
    pll.prim().write(dividers[0] << 16 | dividers[1] << 12);
    pll.pwr().clear(1 << 3);
}

/// The board's clock. Tick 0 is when it was started.
pub(crate) struct Clock {
    now: u64,
}

impl Clock {
    /// Starts it, at tick 0.
    pub(crate) fn start() -> Clock {
        regs::SYST_RVR.write(MASK);
        regs::SYST_CVR.write(0);
        regs::SYST_CSR.write(0b101);
        Clock { now: 0 }
    }

    /// Ticks since it was started.
    #[inline(always)]
    pub(crate) fn now(&mut self) -> u64 {
        self.seen(regs::SYST_CVR.read())
    }

    /// The same when SysTick showed `value`.
    #[inline(always)]
    pub(crate) fn seen(&mut self, value: u32) -> u64 {
        // It counts down.
        let on = value.wrapping_neg().wrapping_sub(self.now as u32) & MASK;
        self.now += u64::from(on);
        self.now
    }

    /// Modulo 2^32.
    #[inline(always)]
    pub(crate) fn moment(&mut self) -> Tick32 {
        Tick32::of(self.now())
    }

    /// A moment within 2^31 ticks of now, in 64 bits.
    pub(crate) fn extended(&mut self, moment: Tick32) -> u64 {
        let now = self.now();
        let ahead = moment.since(Tick32::of(now)).cast_signed();
        now.wrapping_add_signed(i64::from(ahead))
    }
}

/// Ticks / 2^17: 1.049 ms each.
pub(crate) const fn millis(now: u64) -> Millis {
    Millis((now >> 17) as u16)
}

/// µs of so many ticks, rounded down, or one fewer: a division takes this processor 150 cycles.
pub(crate) const fn us(ticks: u32) -> u32 {
    const TICKS_PER_US: u64 = TICK_HZ as u64 / 1_000_000;
    ((ticks as u64 * ((1 << 32) / TICKS_PER_US)) >> 32) as u32
}

/// What ends a sleep, kept out though it is.
const WAKERS: u32 = regs::TIMER_IRQ_0 | regs::USBCTRL_IRQ;

/// Sleeps for about `us` µs, at least 2 (an alarm that is not ahead comes after 72 min), or until USB has something or the DMA's interrupt.
pub(crate) fn sleep(us: u32) {
    regs::TIMER_INTE.write(1);
    regs::disable_interrupts();
    regs::TIMER_ALARM0.write(regs::TIMER_RAW.read().wrapping_add(us.max(2)));
    // Kept out, it wakes all the same; nobody serves it.
    regs::NVIC_ISER.write(WAKERS);
    regs::wait_for_interrupt();
    regs::NVIC_ICER.write(WAKERS);
    regs::TIMER_INTR.write(1);
    regs::NVIC_ICPR.write(WAKERS);
    regs::enable_interrupts();
}
