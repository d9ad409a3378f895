//! What other systems reach with the same laws. These are constants, since their code does not run here.

/// Law, and ns a step: ours, Klipper within 25 µs, Klipper within 3 ticks, Kalico.
pub(crate) const PLANNING: [[&str; 5]; 5] = [
    ["sine, A = 2000, T = 1 s", "8.66", "76", "85", "107"],
    ["sine, A = 2e6, T = 10 s", "0.088", "84", "90", "97"],
    ["trapezoid, 20 k steps/s, 180 000 steps", "0.302", "19.6", "20.4", "27.9"],
    ["Lorenz, 500·∫x dt, 20 s", "26.2", "122", "130", "153"],
    ["1000t + 300 sin 7t + 50 sin 31t, 20 s", "95.6", "120", "123", "163"],
];

/// How they were measured.
pub(crate) const PLANNING_NOTE: &str = "Planning: one run, of commit 971f61c5, on one machine, in processor time, where one f64 acos took 4.5 ns. \
Klipper (itersolve and stepcompress, commit 84104bb) and Kalico (stepcompress_hp) were compiled there; a law is a C function that they call. Compare the columns with one another, \
not with the tables above. Bytes a step of the first sine, in that run: ours 0.090 (±1 tick) and 0.061 (±3.5 ticks), Klipper 1.137 (2 ticks), Kalico 0.229 (±1.5 ticks) and 0.178 (±3.5 ticks).";

/// System, law, quantity, value.
pub(crate) const SKETCHES: [[&str; 4]; 4] = [
    ["the tutorial's sketch on an Uno", "sine, A = 2000, T = 1 s", "half period, s", "1.647 instead of 0.495"],
    ["StepperWinch on an Uno", "1234 steps/s", "timing", "±1.16 ms, 0.08 % slow"],
    ["AccelStepper on an Uno", "constant speed, one motor", "steps/s", "4503"],
    ["grbl 1.1h on an Uno", "constant speed, one motor", "steps/s", "30 000"],
];

/// How they were measured.
pub(crate) const SKETCHES_NOTE: &str = "On an Uno: the unchanged sketches and libraries on an emulated 16 MHz ATmega328P, where cycles are the same on every machine.";
