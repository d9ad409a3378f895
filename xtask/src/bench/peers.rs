//! What other systems reach with the same laws, as measured or published. These are constants, since their code does
//! not run here.

/// System, law, quantity, value.
pub(crate) const PEERS: [[&str; 4]; 8] = [
    ["Klipper, itersolve + stepcompress", "sine, A = 2000, T = 1 s", "planning, ns/step", "258, at 25 µs error"],
    ["Klipper, itersolve + stepcompress", "sine, A = 2e6, T = 10 s", "planning, ns/step", "47, at 25 µs error"],
    ["Kalico, 3rd-order stepcompress", "sine, A = 2000, T = 1 s", "bytes/step", "0.182, at ±3.5 ticks"],
    ["one f64 acos per step", "sine, A = 2000, T = 1 s", "planning, ns/step", "9, at 0.5 tick"],
    ["the tutorial's sketch on an Uno", "sine, A = 2000, T = 1 s", "half period, s", "1.647 instead of 0.495"],
    ["StepperWinch on an Uno", "1234 steps/s", "timing", "±1.16 ms, 0.08 % slow"],
    ["AccelStepper on an Uno", "constant speed, one motor", "steps/s", "4503"],
    ["grbl 1.1h on an Uno", "constant speed, one motor", "steps/s", "30 000"],
];

/// How the values were obtained.
pub(crate) const NOTE: &str = "Planning times: Klipper at commit 84104bb and Kalico's stepcompress_hp, compiled and run \
on one core of a PC where one f64 acos costs 9 ns. Uno figures: the unchanged sketches and libraries on an emulated \
16 MHz ATmega328P.";
