//! An Arduino Uno: ATmega328P.

use super::{AxisWiring, DeviceProfile, Emulation, Flashing, NoProgram, Role};
use crate::VirtualBoard;
use crate::virtual_uno::{self, VirtualUno};
use pulsetrain_core::boards::uno;
use pulsetrain_core::wire::Baud;

/// The Uno.
pub static UNO: DeviceProfile = DeviceProfile {
    name: "uno",
    title: "Uno",
    title_with_article: "an Uno",
    full_name: "an Arduino Uno",
    chip: "ATmega328P",
    other_chip_help: "nothing was written; the firmware is for the ATmega328P of Uno and Nano",
    number: uno::NUMBER,
    // Its USB bridge makes 1 Mbaud exactly, and that is enough for all plans.
    usual_baud: Baud::B1M,
    resets_when_opened: true,
    // On the emulated one a Switch behind 199 bytes was answered after 13.7 ms.
    hearing_byte_us: 60,
    flashing: Flashing::Stk500,
    has_image_for_each_role: true,
    image: |role| match role {
        Role::Plans => virtual_uno::image(),
        Role::Winch => virtual_uno::winch_image(),
        Role::Verbs => virtual_uno::verbs_image(),
    },
    emulation: Some(Emulation {
        // Obtained with `run` of sweep.toml.
        speed: 12.0,
        board: |role| match role {
            Role::Plans => Box::new(VirtualUno::new()),
            Role::Winch => Box::new(VirtualUno::with_winch()),
            Role::Verbs => Box::new(VirtualUno::with_verbs()),
        },
        with_program,
        with_bootloader: Some(with_bootloader),
    }),
    // Its processor does everything, and its queues are short.
    is_rehearsed: true,
    counts_missed_compares: true,
    // The tutorial's amplitude. Its own sketch makes the first of the bench's periods at a third of its speed.
    bench_steps: 2000.0,
    // Those of a CNC shield. 1.94 µs, 5 µs.
    axes: AxisWiring {
        pins: [(2, 5), (3, 6), (4, 7), (12, 13)],
        enable: 8,
        pulse_ticks: uno::MAX_SHORT_PULSE,
        setup_ticks: 80,
        edge_delay_ticks: uno::EDGE_DELAY_SHIELD,
    },
    first_coil_pin: None,
};

fn with_program(flash: &[u8]) -> Result<Box<dyn VirtualBoard>, NoProgram> {
    Ok(Box::new(VirtualUno::with_program(flash)?))
}

fn with_bootloader(bootloader: &[u8]) -> Result<Box<dyn VirtualBoard>, NoProgram> {
    Ok(Box::new(VirtualUno::with_bootloader(&[], bootloader)?))
}
