//! The board: core's [`FirmwareBoard`] on the Pico's hardware, and what text, motions in the flash and the main loop ask of both.

use crate::clock;
use crate::hardware::PicoHardware;
use crate::reset;
use crate::uart::{self, Uart};
use crate::winch;
use core::ops::{Deref, DerefMut};
use pulsetrain_core::firmware::FirmwareBoard;
use pulsetrain_core::winch::path::Slice;
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause};
use pulsetrain_core::wire::{BoardSide, Millis};
use pulsetrain_core::{Epoch, Tick32};

/// Motors that get words in one round of the main loop at most. Four take about 0.2 ms, and so long the host waits.
const FILLS_A_ROUND: u32 = 4;

/// The board: all of it but the service and the ports.
pub(crate) struct Board {
    /// What the service drives.
    pub(crate) side: FirmwareBoard<PicoHardware>,
}

impl Deref for Board {
    type Target = FirmwareBoard<PicoHardware>;

    fn deref(&self) -> &FirmwareBoard<PicoHardware> {
        &self.side
    }
}

impl DerefMut for Board {
    fn deref_mut(&mut self) -> &mut FirmwareBoard<PicoHardware> {
        &mut self.side
    }
}

impl Board {
    /// Starts the clock and sets up what all motors share. No motor is configured yet.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn begin() -> Board {
        // SAFETY: the caller's promise.
        let (hardware, orders) = unsafe { PicoHardware::begin() };
        Board { side: FirmwareBoard::new(hardware, orders, reset::cause()) }
    }

    /// The clock, ticks.
    #[inline(always)]
    pub(crate) fn now(&mut self) -> u64 {
        self.hardware.clock.now()
    }

    /// Does what cannot wait: words for the motors. Whether there was something to do.
    #[inline(always)]
    pub(crate) fn fill_motors(&mut self) -> bool {
        let mut more = false;
        self.plan_orders();
        for _ in 0..FILLS_A_ROUND {
            // After an underrun words would be steps at wrong times.
            self.check_underrun();
            let PicoHardware { stepper, clock, .. } = &mut self.hardware;
            if !stepper.fill(clock) {
                break;
            }
            more = true;
        }
        more
    }

    /// How long no motor needs words, µs.
    pub(crate) fn spare_us(&mut self) -> u32 {
        let PicoHardware { stepper, clock, .. } = &mut self.hardware;
        clock::us(stepper.ticks_to_next_fill(clock.now32()))
    }

    /// Whether words for the motors are more urgent than the host's frames.
    #[inline(always)]
    pub(crate) const fn is_behind(&self) -> bool {
        self.side.hardware.stepper.is_behind()
    }

    /// Configures the axes of text, with drivers off and positions at 0, while the motors of frames rest. Whether it could be done.
    pub(crate) fn configure_axes(&mut self) -> bool {
        winch::wiring().is_some_and(|wiring| self.configure(&wiring).is_ok())
    }

    /// Enables the drivers and has motors follow paths. Their steps come by [`push_slice`](Board::push_slice), and the first of
    /// them at tick `first` or later, which is at least a millisecond from now.
    pub(crate) fn begin_paths(&mut self, first: u64) -> bool {
        self.hardware.stepper.set_known_until(Tick32::of(first));
        self.arm().is_ok()
    }

    /// Hands over the steps of all axes in the millisecond from tick `begin` to `end`.
    pub(crate) fn push_slice(&mut self, slices: [Slice; 4], begin: u64, end: u64) {
        let stepper = &mut self.hardware.stepper;
        for (motor, slice) in (0..).zip(slices) {
            if let Some(steps) = slice.steps(winch::SLICE_TICKS) {
                stepper.push_steps(motor, Tick32::of(begin), steps);
            }
        }
        stepper.set_known_until(Tick32::of(end));
    }

    /// Puts packed items of a motion in the flash last in a motor's queue. It has room for them.
    pub(crate) fn push_baked(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) {
        // The caller has asked for the room.
        let _ = self.hardware.stepper.push(motor, epoch, packed);
    }

    /// The clock, ticks, and the positions of the axes at that tick.
    pub(crate) fn positions(&mut self) -> (u64, [i32; 4]) {
        let now = self.now();
        (now, [0, 1, 2, 3].map(|motor| self.hardware.stepper.position(motor, Tick32::of(now))))
    }

    /// Does what can wait a millisecond. Whether the UART's receiver lost a byte.
    pub(crate) fn housekeeping(&mut self, now: Millis, uart: &mut Uart) -> bool {
        uart.keep_receiving();
        let overrun = uart::has_overrun();
        let lost = uart.take_lost_bytes().saturating_add(overrun.into());
        if lost != 0 {
            let all = u32::from(self.measures.lost_bytes).saturating_add(lost);
            self.measures.lost_bytes = u16::try_from(all).unwrap_or(u16::MAX);
            self.report(Cause::Overrun, ALL_MOTORS, lost);
        }
        self.supervise(now);
        overrun
    }
}
