//! A serial port over USB that sends back what it gets, each byte with all bits turned. Polled, at 125 MHz; with
//! exceptions that follow one another all the time.
#![no_std]
#![no_main]

use core::sync::atomic::{AtomicU32, Ordering};
use cortex_m::peripheral::{SCB, syst::SystClkSource};
use cortex_m_rt::exception;
use rp2040_hal::{Clock as _, Watchdog, clocks::init_clocks_and_plls, pac, usb::UsbBus};
use usb_device::{class_prelude::UsbBusAllocator, prelude::*};
use usbd_serial::SerialPort;

#[panic_handler]
fn panic(_: &core::panic::PanicInfo) -> ! {
    loop {}
}

/// Cycles from one SysTick to the next: it comes at ever other places of the program.
const TICK_CYCLES: u32 = 4999;
static TICKS: AtomicU32 = AtomicU32::new(0);

/// Asks for another exception, which is entered as this one returns.
#[exception]
fn SysTick() {
    SCB::set_pendsv();
}

#[exception]
fn PendSV() {
    TICKS.store(TICKS.load(Ordering::Relaxed) + 1, Ordering::Relaxed);
}

const CRYSTAL_HZ: u32 = 12_000_000;

#[rp2040_hal::entry]
fn main() -> ! {
    let mut chip = pac::Peripherals::take().unwrap();
    let mut watchdog = Watchdog::new(chip.WATCHDOG);
    let clocks = init_clocks_and_plls(
        CRYSTAL_HZ,
        chip.XOSC,
        chip.CLOCKS,
        chip.PLL_SYS,
        chip.PLL_USB,
        &mut chip.RESETS,
        &mut watchdog,
    );
    let Ok(clocks) = clocks else { panic!() };
    assert!(clocks.system_clock.freq().to_Hz() == 125_000_000);
    let bus = UsbBus::new(chip.USBCTRL_REGS, chip.USBCTRL_DPRAM, clocks.usb_clock, true, &mut chip.RESETS);
    let bus = UsbBusAllocator::new(bus);
    let mut port = SerialPort::new(&bus);
    let texts = StringDescriptors::default().manufacturer("maker").product("product").serial_number("7");
    let mut device = UsbDeviceBuilder::new(&bus, UsbVidPid(0x1209, 1))
        .strings(&[texts])
        .unwrap()
        // rp2040js's helper takes descriptors of one packet only.
        .max_packet_size_0(64)
        .unwrap()
        .device_class(usbd_serial::USB_CLASS_CDC)
        .build();
    let Some(mut core) = pac::CorePeripherals::take() else { panic!() };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(TICK_CYCLES - 1);
    core.SYST.clear_current();
    core.SYST.enable_counter();
    core.SYST.enable_interrupt();
    let mut buffer = [0; 64];
    let (mut length, mut sent) = (0, 0);
    loop {
        device.poll(&mut [&mut port]);
        if sent == length {
            (length, sent) = (port.read(&mut buffer).unwrap_or(0), 0);
            buffer[..length].iter_mut().for_each(|byte| *byte = !*byte);
        }
        if sent < length {
            sent += port.write(&buffer[sent..length]).unwrap_or(0);
        }
    }
}
