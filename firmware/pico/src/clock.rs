//! The chip's clocks, and the board's clock: SysTick at 125 MHz, extended to 64 bits. It must be read at least once in 2^24 ticks
//! (134 ms), or a wrap is missed.

use crate::regs;
use pulsetrain_core::Tick32;
use pulsetrain_core::wire::Millis;

pub(crate) use pulsetrain_core::boards::pico::TICK_HZ;

/// The Pico's crystal.
const CRYSTAL_HZ: u32 = 12_000_000;

/// §2.18.2.1: 12 MHz · 125 / 6 / 2; the PLL's oscillator runs at 1500 MHz, within 750 to 1600.
const PLL_FEEDBACK: u32 = 125;
const PLL_DIVIDERS: [u32; 2] = [6, 2];
const _: () = assert!(CRYSTAL_HZ / 4 * PLL_FEEDBACK / PLL_DIVIDERS[0] / PLL_DIVIDERS[1] * 4 == TICK_HZ);

/// The same for USB: 12 MHz · 120 / 6 / 5; the oscillator runs at 1440 MHz.
const USB_HZ: u32 = 48_000_000;
const USB_PLL_FEEDBACK: u32 = 120;
const USB_PLL_DIVIDERS: [u32; 2] = [6, 5];
const _: () = assert!(CRYSTAL_HZ / 5 * USB_PLL_FEEDBACK / USB_PLL_DIVIDERS[0] / USB_PLL_DIVIDERS[1] * 5 == USB_HZ);

/// Bits of SysTick.
const SYSTICK_BITS: u32 = 24;
const SYSTICK_MASK: u32 = (1 << SYSTICK_BITS) - 1;

/// Sets up crystal, PLLs and clocks: processor and peripherals at [`TICK_HZ`], USB at 48 MHz, the timer at 1 MHz.
pub(crate) fn set_up() {
    regs::CLK_SYS_RESUS_CTRL.write(0);
    // §2.16.3: 1 ms at 12 MHz, in units of 256 cycles.
    regs::XOSC_STARTUP.write(47);
    regs::XOSC_CTRL.write(0xfab << 12 | 0xaa0);
    while regs::XOSC_STATUS.read() & 1 << 31 == 0 {}
    // clk_sys runs on the reference while the PLL starts (§2.15.3.2).
    regs::CLK_SYS_CTRL.clear(1);
    while regs::CLK_SYS_SELECTED.read() & 1 == 0 {}
    regs::CLK_REF_CTRL.write(2);
    while regs::CLK_REF_SELECTED.read() & 1 << 2 == 0 {}
    start_pll(regs::PLL_SYS, regs::reset::PLL_SYS, PLL_FEEDBACK, PLL_DIVIDERS);
    start_pll(regs::PLL_USB, regs::reset::PLL_USB, USB_PLL_FEEDBACK, USB_PLL_DIVIDERS);
    // First the source is set to the PLL, then clk_sys takes it.
    regs::CLK_SYS_CTRL.write(0);
    regs::CLK_SYS_CTRL.set(1);
    while regs::CLK_SYS_SELECTED.read() & 1 << 1 == 0 {}
    regs::CLK_PERI_CTRL.write(1 << 11);
    // The USB PLL is source 0 of clk_usb.
    regs::CLK_USB_CTRL.write(1 << 11);
    // The timer counts the watchdog's ticks: one in 12 cycles of the crystal (§4.7.2).
    regs::WATCHDOG_TICK.write((1 << 9) | (CRYSTAL_HZ / 1_000_000));
}

/// Takes pins, pads and the timer out of reset.
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
        regs::SYST_RVR.write(SYSTICK_MASK);
        regs::SYST_CVR.write(0);
        regs::SYST_CSR.write(0b101);
        Clock { now: 0 }
    }

    /// Ticks since it was started.
    #[inline(always)]
    pub(crate) fn now(&mut self) -> u64 {
        self.at_systick(regs::SYST_CVR.read())
    }

    /// The clock when SysTick was read as `value`, ticks.
    #[inline(always)]
    pub(crate) fn at_systick(&mut self, value: u32) -> u64 {
        // SysTick counts down.
        let on = value.wrapping_neg().wrapping_sub(self.now as u32) & SYSTICK_MASK;
        self.now += u64::from(on);
        self.now
    }

    /// Ticks since it was started, modulo 2^32.
    #[inline(always)]
    pub(crate) fn now32(&mut self) -> Tick32 {
        Tick32::of(self.now())
    }

    /// A tick within 2^31 of now, in 64 bits.
    pub(crate) fn widen(&mut self, tick: Tick32) -> u64 {
        let now = self.now();
        let ahead = tick.since(Tick32::of(now)).cast_signed();
        now.wrapping_add_signed(i64::from(ahead))
    }
}

/// Time in units of 2^17 ticks, 1.049 ms: a shift, where a division takes 150 cycles.
pub(crate) const fn millis(now: u64) -> Millis {
    Millis((now >> 17) as u16)
}

/// Ticks in µs, rounded down, or one fewer: a multiplication, where a division takes 150 cycles.
pub(crate) const fn us(ticks: u32) -> u32 {
    const TICKS_PER_US: u64 = TICK_HZ as u64 / 1_000_000;
    ((ticks as u64 * ((1 << 32) / TICKS_PER_US)) >> 32) as u32
}

/// The interrupts that end a sleep: they are masked, so that no handler runs, but they wake the processor.
const WAKERS: u32 = regs::TIMER_IRQ_0 | regs::USBCTRL_IRQ;

/// Sleeps for about `us` µs, or until USB has something or the DMA's interrupt comes. At least 2 µs: an alarm that is already past
/// would come after 72 min.
pub(crate) fn sleep(us: u32) {
    regs::TIMER_INTE.write(1);
    regs::disable_interrupts();
    regs::TIMER_ALARM0.write(regs::TIMER_RAW.read().wrapping_add(us.max(2)));
    // With interrupts off it ends the sleep all the same, and no handler runs.
    regs::NVIC_ISER.write(WAKERS);
    regs::wait_for_interrupt();
    regs::NVIC_ICER.write(WAKERS);
    regs::TIMER_INTR.write(1);
    regs::NVIC_ICPR.write(WAKERS);
    regs::enable_interrupts();
}
