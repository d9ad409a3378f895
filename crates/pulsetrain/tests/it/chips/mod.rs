//! Tests that run firmware on an emulated chip.

mod baked;
mod baked_pico;
mod clock;
mod embed;
mod faults;
mod live;
mod pause;
mod pico;
mod pico_figures;
mod pico_session;
mod rehearsal;
mod serve;
mod sketches;
mod stops;
mod uno;
mod uno_promises;
