//! The RP2040's registers, and the few instructions that Rust has no functions for.
//!
//! Sections are those of the RP2040 datasheet (build of 2024-10-15) and the ARMv6-M manual (DDI 0419). All of it is safe to call,
//! but for what hands memory to a DMA.

use core::arch::asm;

/// A register of 32 bits, by its address.
#[derive(Clone, Copy)]
pub(crate) struct Reg(u32);

impl Reg {
    /// What it holds.
    #[inline(always)]
    pub(crate) fn read(self) -> u32 {
        // SAFETY: only this file makes one of these; each is a register of this chip, always there to be read.
        unsafe { core::ptr::read_volatile(self.0 as *const u32) }
    }

    /// Sets it.
    #[inline(always)]
    pub(crate) fn write(self, value: u32) {
        // SAFETY: as above. Only addresses given to a DMA change what memory means to Rust: see `DmaChannel`.
        unsafe { core::ptr::write_volatile(self.0 as *mut u32, value) }
    }

    /// Sets the bits of `mask` in one access (§2.1.2). Not for SIO, nor the processor's own.
    #[inline(always)]
    pub(crate) fn set(self, mask: u32) {
        Reg(self.0 + 0x2000).write(mask);
    }

    /// Clears the bits of `mask` in one access (§2.1.2). Not for SIO, nor the processor's own.
    #[inline(always)]
    pub(crate) fn clear(self, mask: u32) {
        Reg(self.0 + 0x3000).write(mask);
    }

    /// Its address, for a DMA.
    #[inline(always)]
    pub(crate) const fn address(self) -> u32 {
        self.0
    }
}

/// §2.14.3.
pub(crate) const RESETS_RESET: Reg = Reg(0x4000_c000);
pub(crate) const RESETS_DONE: Reg = Reg(0x4000_c008);

/// Bits of the resets (§2.14.3).
pub(crate) mod reset {
    pub(crate) const DMA: u32 = 1 << 2;
    pub(crate) const IO_BANK0: u32 = 1 << 5;
    pub(crate) const PADS_BANK0: u32 = 1 << 8;
    pub(crate) const PIO: [u32; 2] = [1 << 10, 1 << 11];
    pub(crate) const PLL_SYS: u32 = 1 << 12;
    pub(crate) const PLL_USB: u32 = 1 << 13;
    pub(crate) const TIMER: u32 = 1 << 21;
    pub(crate) const UART0: u32 = 1 << 22;
    pub(crate) const USBCTRL: u32 = 1 << 24;
}

/// §2.16.7: the crystal oscillator.
pub(crate) const XOSC_CTRL: Reg = Reg(0x4002_4000);
pub(crate) const XOSC_STATUS: Reg = Reg(0x4002_4004);
pub(crate) const XOSC_STARTUP: Reg = Reg(0x4002_400c);

/// §2.18.4: one of the two PLLs.
#[derive(Clone, Copy)]
pub(crate) struct Pll(u32);

pub(crate) const PLL_SYS: Pll = Pll(0x4002_8000);
pub(crate) const PLL_USB: Pll = Pll(0x4002_c000);

impl Pll {
    pub(crate) const fn cs(self) -> Reg {
        Reg(self.0)
    }

    pub(crate) const fn pwr(self) -> Reg {
        Reg(self.0 + 4)
    }

    pub(crate) const fn fbdiv(self) -> Reg {
        Reg(self.0 + 8)
    }

    pub(crate) const fn prim(self) -> Reg {
        Reg(self.0 + 12)
    }
}

/// §2.15.7: clocks.
pub(crate) const CLK_REF_CTRL: Reg = Reg(0x4000_8030);
pub(crate) const CLK_REF_SELECTED: Reg = Reg(0x4000_8038);
pub(crate) const CLK_SYS_CTRL: Reg = Reg(0x4000_803c);
pub(crate) const CLK_SYS_SELECTED: Reg = Reg(0x4000_8044);
pub(crate) const CLK_PERI_CTRL: Reg = Reg(0x4000_8048);
pub(crate) const CLK_USB_CTRL: Reg = Reg(0x4000_8054);
pub(crate) const CLK_SYS_RESUS_CTRL: Reg = Reg(0x4000_8078);

/// §4.7.6: the watchdog, and the tick of the timer.
pub(crate) const WATCHDOG_CTRL: Reg = Reg(0x4005_8000);
pub(crate) const WATCHDOG_LOAD: Reg = Reg(0x4005_8004);
pub(crate) const WATCHDOG_REASON: Reg = Reg(0x4005_8008);
pub(crate) const WATCHDOG_SCRATCH0: Reg = Reg(0x4005_800c);
pub(crate) const WATCHDOG_TICK: Reg = Reg(0x4005_802c);

/// §4.10.13: the serial interface to the flash.
pub(crate) mod ssi {
    use super::Reg;

    pub(crate) const CTRLR0: Reg = Reg(0x1800_0000);
    pub(crate) const SSIENR: Reg = Reg(0x1800_0008);
    pub(crate) const SR: Reg = Reg(0x1800_0028);
    pub(crate) const DR0: Reg = Reg(0x1800_0060);

    /// Bits of SR: the receiver has something.
    pub(crate) const RFNE: u32 = 1 << 3;
}

/// §2.19.6.2: what drives the chip select of the flash, bits 8 and 9. 0: the interface; 2: low; 3: high.
pub(crate) const QSPI_SS_CTRL: Reg = Reg(0x4001_800c);

/// §2.20.2: the chip and its revision.
pub(crate) const CHIP_ID: Reg = Reg(0x4000_0000);

/// §2.13.5: which blocks a reset of the watchdog reaches.
pub(crate) const PSM_WDSEL: Reg = Reg(0x4001_0008);

/// §2.10.6: why the chip began.
pub(crate) const CHIP_RESET: Reg = Reg(0x4006_4008);

/// §4.6.5: the timer, µs.
pub(crate) const TIMER_ALARM0: Reg = Reg(0x4005_4010);
pub(crate) const TIMER_ALARM1: Reg = Reg(0x4005_4014);
pub(crate) const TIMER_RAW: Reg = Reg(0x4005_4028);
pub(crate) const TIMER_INTR: Reg = Reg(0x4005_4034);
pub(crate) const TIMER_INTE: Reg = Reg(0x4005_4038);

/// §2.3.1.7: GPIO by the processor.
pub(crate) const SIO_OUT_SET: Reg = Reg(0xd000_0014);
pub(crate) const SIO_OUT_CLR: Reg = Reg(0xd000_0018);
pub(crate) const SIO_OE_SET: Reg = Reg(0xd000_0024);
pub(crate) const SIO_OE_CLR: Reg = Reg(0xd000_0028);

/// §4.2.8: the first serial line.
pub(crate) const UART_DR: Reg = Reg(0x4003_4000);
pub(crate) const UART_RSR: Reg = Reg(0x4003_4004);
pub(crate) const UART_FR: Reg = Reg(0x4003_4018);
pub(crate) const UART_IBRD: Reg = Reg(0x4003_4024);
pub(crate) const UART_FBRD: Reg = Reg(0x4003_4028);
pub(crate) const UART_LCR: Reg = Reg(0x4003_402c);
pub(crate) const UART_CR: Reg = Reg(0x4003_4030);
pub(crate) const UART_DMACR: Reg = Reg(0x4003_4048);

/// ARMv6-M, B3.3: SysTick.
pub(crate) const SYST_CSR: Reg = Reg(0xe000_e010);
pub(crate) const SYST_RVR: Reg = Reg(0xe000_e014);
pub(crate) const SYST_CVR: Reg = Reg(0xe000_e018);

/// ARMv6-M, B3.4: interrupts.
pub(crate) const NVIC_ISER: Reg = Reg(0xe000_e100);
pub(crate) const NVIC_ICER: Reg = Reg(0xe000_e180);
pub(crate) const NVIC_ISPR: Reg = Reg(0xe000_e200);
pub(crate) const NVIC_ICPR: Reg = Reg(0xe000_e280);

/// Priorities of the first four: two bits at the top of each byte, 0 the highest.
pub(crate) const NVIC_IPR0: Reg = Reg(0xe000_e400);

/// Interrupts (§2.3.2).
pub(crate) const TIMER_IRQ_0: u32 = 1;
pub(crate) const TIMER_IRQ_1: u32 = 1 << 1;
pub(crate) const USBCTRL_IRQ: u32 = 1 << 5;
pub(crate) const DMA_IRQ_0: u32 = 1 << 11;

/// §2.19.6.1: what drives a pin.
pub(crate) const fn gpio_ctrl(pin: u8) -> Reg {
    Reg(0x4001_4004 + 8 * pin as u32)
}

/// §2.19.6.3: its pad.
pub(crate) const fn pad(pin: u8) -> Reg {
    Reg(0x4001_c004 + 4 * pin as u32)
}

/// One of the two PIO blocks (§3.7).
#[derive(Clone, Copy)]
pub(crate) struct Pio(pub(crate) u8);

impl Pio {
    const fn at(self, offset: u32) -> Reg {
        Reg(0x5020_0000 + 0x10_0000 * self.0 as u32 + offset)
    }

    pub(crate) const fn ctrl(self) -> Reg {
        self.at(0)
    }

    pub(crate) const fn fdebug(self) -> Reg {
        self.at(0x8)
    }

    pub(crate) const fn flevel(self) -> Reg {
        self.at(0xc)
    }

    pub(crate) const fn txf(self, machine: u8) -> Reg {
        self.at(0x10 + 4 * machine as u32)
    }

    pub(crate) const fn instr_mem(self, at: u8) -> Reg {
        self.at(0x48 + 4 * at as u32)
    }

    pub(crate) const fn clkdiv(self, machine: u8) -> Reg {
        self.at(0xc8 + 0x18 * machine as u32)
    }

    pub(crate) const fn execctrl(self, machine: u8) -> Reg {
        self.at(0xcc + 0x18 * machine as u32)
    }

    pub(crate) const fn shiftctrl(self, machine: u8) -> Reg {
        self.at(0xd0 + 0x18 * machine as u32)
    }

    pub(crate) const fn addr(self, machine: u8) -> Reg {
        self.at(0xd4 + 0x18 * machine as u32)
    }

    pub(crate) const fn instr(self, machine: u8) -> Reg {
        self.at(0xd8 + 0x18 * machine as u32)
    }

    pub(crate) const fn pinctrl(self, machine: u8) -> Reg {
        self.at(0xdc + 0x18 * machine as u32)
    }
}

/// One of the DMA's channels (§2.5.7).
///
/// The caller that sets its addresses must own the memory for as long as the channel runs.
#[derive(Clone, Copy)]
pub(crate) struct DmaChannel(pub(crate) u8);

impl DmaChannel {
    const fn at(self, offset: u32) -> Reg {
        Reg(0x5000_0000 + 0x40 * self.0 as u32 + offset)
    }

    pub(crate) const fn read_addr(self) -> Reg {
        self.at(0)
    }

    pub(crate) const fn write_addr(self) -> Reg {
        self.at(4)
    }

    /// Transfers that are still to be made.
    pub(crate) const fn trans_count(self) -> Reg {
        self.at(8)
    }

    /// CTRL without starting it.
    pub(crate) const fn ctrl(self) -> Reg {
        self.at(0x10)
    }

    /// Sets how many transfers there are to be, and starts them.
    pub(crate) const fn trans_count_trig(self) -> Reg {
        self.at(0x1c)
    }
}

/// §2.5.7: finished channels, before the mask; the mask; finished channels, after the mask; channels to be ended.
pub(crate) const DMA_INTR: Reg = Reg(0x5000_0400);
pub(crate) const DMA_INTE0: Reg = Reg(0x5000_0404);
pub(crate) const DMA_INTS0: Reg = Reg(0x5000_040c);
pub(crate) const DMA_ABORT: Reg = Reg(0x5000_0444);

/// The USB controller: registers (§4.1.4), and the memory that it shares with the processor (§4.1.2.5), which can be
/// accessed in bytes and half-words too.
pub(crate) mod usb {
    use super::Reg;

    const MEMORY: u32 = 0x5010_0000;
    const BYTES: u32 = 4096;

    pub(crate) const ADDR_ENDP: Reg = Reg(0x5011_0000);
    pub(crate) const MAIN_CTRL: Reg = Reg(0x5011_0040);
    pub(crate) const SIE_CTRL: Reg = Reg(0x5011_004c);
    pub(crate) const SOF_RD: Reg = Reg(0x5011_0048);
    pub(crate) const SIE_STATUS: Reg = Reg(0x5011_0050);
    pub(crate) const BUFF_STATUS: Reg = Reg(0x5011_0058);
    pub(crate) const EP_STALL_ARM: Reg = Reg(0x5011_0068);
    pub(crate) const MUXING: Reg = Reg(0x5011_0074);
    pub(crate) const PWR: Reg = Reg(0x5011_0078);
    pub(crate) const INTE: Reg = Reg(0x5011_0090);
    pub(crate) const INTS: Reg = Reg(0x5011_0098);

    /// Bits of SIE_STATUS.
    pub(crate) const BUS_RESET: u32 = 1 << 19;
    pub(crate) const SETUP: u32 = 1 << 17;

    /// Bits of a buffer's control (§4.1.2.5.3).
    pub(crate) const LEN: u32 = 0x3ff;
    pub(crate) const AVAILABLE: u32 = 1 << 10;
    pub(crate) const STALL: u32 = 1 << 11;
    pub(crate) const RESET_HALF: u32 = 1 << 12;
    pub(crate) const DATA1: u32 = 1 << 13;
    pub(crate) const FULL: u32 = 1 << 15;

    /// A word of the memory.
    pub(crate) const fn memory(offset: u32) -> Reg {
        Reg(MEMORY + offset % BYTES)
    }

    /// A byte of the memory.
    #[inline(always)]
    pub(crate) fn memory_byte(offset: u32) -> u8 {
        // SAFETY: inside the memory; what the controller writes there is read as it is.
        unsafe { core::ptr::read_volatile((MEMORY + offset % BYTES) as *const u8) }
    }

    /// Sets a byte of the memory.
    #[inline(always)]
    pub(crate) fn set_memory_byte(offset: u32, byte: u8) {
        // SAFETY: inside the memory, which holds nothing of Rust's.
        unsafe { core::ptr::write_volatile((MEMORY + offset % BYTES) as *mut u8, byte) }
    }

    /// An endpoint's control, not of endpoint 0.
    pub(crate) const fn endpoint_control(endpoint: u32, out: bool) -> Reg {
        memory(8 * endpoint + 4 * out as u32)
    }

    /// The control of an endpoint's buffers.
    pub(crate) const fn buffer_control(endpoint: u32, out: bool) -> Reg {
        memory(0x80 + 8 * endpoint + 4 * out as u32)
    }

    /// The half of it that belongs to buffer 0 or 1.
    #[inline(always)]
    pub(crate) fn buffer_half(endpoint: u32, out: bool, half: u32) -> u32 {
        buffer_control(endpoint, out).read() >> (16 * half) & 0xffff
    }

    /// Sets a half, while it is not the controller's.
    pub(crate) fn set_half(endpoint: u32, out: bool, half: u32, bits: u32) {
        let address = buffer_control(endpoint, out).0 + 2 * half;
        // SAFETY: as in `set_memory_byte`.
        unsafe { core::ptr::write_volatile(address as *mut u16, bits as u16) }
    }

    /// Gives a buffer to the controller: AVAILABLE is set 3 cycles of clk_usb, 8 of the processor, after the other
    /// bits (§4.1.2.5.1). The other half may be the controller's, and is not written.
    pub(crate) fn arm_half(endpoint: u32, out: bool, half: u32, bits: u32) {
        let write = |bits: u32| set_half(endpoint, out, half, bits);
        write(bits);
        for _ in 0..4 {
            // Two cycles each, at least.
            MAIN_CTRL.read();
        }
        write(bits | AVAILABLE);
    }
}

/// Takes blocks out of reset and waits until they are.
pub(crate) fn take_out_of_reset(blocks: u32) {
    RESETS_RESET.clear(blocks);
    while RESETS_DONE.read() & blocks != blocks {}
}

/// Enables interrupts.
#[inline(always)]
pub(crate) fn enable_interrupts() {
    // SAFETY: the one interrupt that there is shares nothing with main but atomics. No `nomem`: nothing moves past it.
    unsafe { asm!("cpsie i", options(nostack, preserves_flags)) }
}

/// Disables interrupts.
#[inline(always)]
pub(crate) fn disable_interrupts() {
    // SAFETY: it only delays interrupts.
    unsafe { asm!("cpsid i", options(nostack, preserves_flags)) }
}

/// Runs `f` with interrupts off, and enables them after it.
#[inline(always)]
pub(crate) fn interrupt_free<T>(f: impl FnOnce() -> T) -> T {
    disable_interrupts();
    let done = f();
    enable_interrupts();
    done
}

/// Sleeps until an interrupt is pending, even one that is disabled by `cpsid`.
#[inline(always)]
pub(crate) fn wait_for_interrupt() {
    // SAFETY: it only waits.
    unsafe { asm!("dsb", "wfi", options(nostack, preserves_flags)) }
}

/// Waits until writes to the processor's own registers have taken effect.
#[inline(always)]
pub(crate) fn barrier() {
    // SAFETY: it changes nothing.
    unsafe { asm!("dsb", "isb", options(nostack, preserves_flags)) }
}

/// Sets the GPIO bits of `mask`, and reads SysTick right after it: always the same number of cycles later.
#[inline(always)]
pub(crate) fn set_and_time(mask: u32) -> u32 {
    let value: u32;
    // SAFETY: a write to SIO and a read of SysTick, as `Reg` does them.
    unsafe {
        asm!(
            "str {mask}, [{sio}]",
            "ldr {value}, [{systick}]",
            mask = in(reg) mask,
            sio = in(reg) SIO_OUT_SET.0,
            systick = in(reg) SYST_CVR.0,
            value = out(reg) value,
            options(nostack, preserves_flags),
        );
    }
    value
}
