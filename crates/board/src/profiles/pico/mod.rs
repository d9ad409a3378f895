//! A Raspberry Pi Pico: RP2040.

use super::{AxisWiring, DeviceProfile, Emulation, Flashing, NoProgram, Role};
use crate::VirtualBoard;
use crate::virtual_pico::{self, VirtualPico};
use pulsetrain_core::boards::pico;
use pulsetrain_core::wire::Baud;

/// The Pico.
pub static PICO: DeviceProfile = DeviceProfile {
    name: "pico",
    title: "Pico",
    title_with_article: "a Pico",
    full_name: "a Raspberry Pi Pico",
    chip: "RP2040",
    other_chip_help: "the firmware is for the RP2040 of a Raspberry Pi Pico; a Pico 2 has another chip",
    number: pico::NUMBER,
    // Its clock makes 2 Mbaud exactly.
    usual_baud: Baud::B2M,
    resets_when_opened: false,
    hearing_byte_us: 0,
    flashing: Flashing::Uf2 { family: virtual_pico::FAMILY, drive: "RPI-RP2" },
    has_image_for_each_role: false,
    image: |_| virtual_pico::IMAGE.to_vec(),
    emulation: Some(Emulation {
        // Obtained with `run` of pico.toml.
        speed: 5.0,
        board: |role| match role {
            // The firmware takes text on its UART, as an Uno does.
            Role::Winch => Box::new(VirtualPico::new()),
            Role::Plans | Role::Verbs => Box::new(VirtualPico::on_usb()),
        },
        with_program,
        with_bootloader: None,
    }),
    is_rehearsed: false,
    counts_missed_compares: false,
    bench_steps: 19_000.0,
    // 2 µs, 5 µs.
    axes: AxisWiring {
        pins: [
            (pico::AXIS_STEP_PINS[0], pico::AXIS_STEP_PINS[0] + 1),
            (pico::AXIS_STEP_PINS[1], pico::AXIS_STEP_PINS[1] + 1),
            (pico::AXIS_STEP_PINS[2], pico::AXIS_STEP_PINS[2] + 1),
            (pico::AXIS_STEP_PINS[3], pico::AXIS_STEP_PINS[3] + 1),
        ],
        enable: pico::AXIS_ENABLE_PIN,
        pulse_ticks: pico::AXIS_PULSE_TICKS,
        setup_ticks: pico::AXIS_SETUP_TICKS,
        edge_delay_ticks: 0,
    },
    first_coil_pin: Some(2),
};

/// Its port is its USB if the program has USB, else its UART.
fn with_program(uf2: &[u8]) -> Result<Box<dyn VirtualBoard>, NoProgram> {
    let pico = VirtualPico::with_image(uf2)?;
    Ok(Box::new(pico.clone().opened().unwrap_or(pico)))
}
