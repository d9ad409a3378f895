//! The winch: text on the lines instead of frames, and motors that follow paths which the board works out itself.
//!
//! docs/winch.md has the commands; what they mean and which steps come of them is `pulsetrain_core::winch`, the same code as the
//! native winch's. Here is when: milliseconds are those of the board's clock, worked out as far ahead as words are written.
//!
//! # Who has the board
//! As long as frames have not taken it and no motor of theirs moves, text is *on*. From the first command that enables the drivers,
//! until `enable 0` has released them, text *drives*, and frames' Hello is refused. Text has one session, whose axes and settings are
//! those of both lines, and an [`Ear`] for each of them.

use crate::clock::TICK_HZ;
use crate::machine::Board;
use crate::steps::stepper::{AHEAD, CLEAR};
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::Slice;
use pulsetrain_core::winch::reply::Reply;
use pulsetrain_core::winch::session::Session;
use pulsetrain_core::winch::text::{Heard, Reader};
use pulsetrain_core::wire::message::{Configuration, MOTOR_SETUP_LEN};
use pulsetrain_core::wire::{Machine, Service};

/// Ticks of a slice, a millisecond: slices begin at the clock's multiples of it.
pub(crate) const SLICE: u32 = TICK_HZ / 1000;

/// Slices are worked out that begin this soon, ticks: what words are written for, and a while for the main loop.
const KNOWN: u32 = AHEAD + CLEAR + SLICE / 10;

/// Slices from a command that enables the drivers to the first one in which they may step.
const FIRST: u64 = 2;

/// Pulses of 2 µs, and DIR 5 µs before them, ticks.
const PULSE: u16 = 250;
const SETUP: u16 = 625;
const _: () = assert!(PULSE as u32 * 500_000 == TICK_HZ && SETUP as u32 * 200_000 == TICK_HZ);

// A DIR line turns within what is known: its set-up, and words of DIR and step, which last a pulse and more.
const _: () = assert!(SETUP as u32 + 4 * PULSE as u32 <= CLEAR);

/// STEP of the axes; DIR is the pin above. High is forward.
const STEP_PINS: [u8; 4] = [2, 4, 6, 8];
/// The drivers' common enable input; low is on.
const ENABLE_PIN: u8 = 22;

/// The axes, as frames' motors.
const AXES: [u8; 4 * MOTOR_SETUP_LEN] = {
    let mut axes = [0; 4 * MOTOR_SETUP_LEN];
    let mut axis = 0;
    while axis < 4 {
        let at = MOTOR_SETUP_LEN * axis;
        [axes[at], axes[at + 1], axes[at + 2]] = [STEP_PINS[axis], STEP_PINS[axis] + 1, FORWARD_HIGH];
        axis += 1;
    }
    axes
};

/// Bit 0 of [`MotorSetup`](pulsetrain_core::wire::message::MotorSetup)'s flags.
const FORWARD_HIGH: u8 = 1;

/// Pins and times, as frames would configure them.
pub(crate) fn wiring() -> Option<Configuration<'static>> {
    let mut wiring = Configuration::new(&AXES)?;
    (wiring.pulse_ticks, wiring.setup_ticks, wiring.hold_ticks) = (PULSE, SETUP, PULSE);
    wiring.enable_pin = ENABLE_PIN;
    Some(wiring)
}

/// What is heard as text on a line.
pub(crate) struct Ear {
    reader: Reader,
    /// A zero has come since the last command: frames are spoken, and nothing is said as text.
    quiet: bool,
    /// A status line is to be said.
    pub(crate) owes_status: bool,
}

impl Ear {
    pub(crate) const fn new() -> Ear {
        Ear { reader: Reader::new(), quiet: false, owes_status: false }
    }

    /// Whether frames are spoken: the line is no text alone.
    pub(crate) const fn is_quiet(&self) -> bool {
        self.quiet
    }

    /// A line of which a byte was lost is noise.
    pub(crate) fn lose(&mut self) {
        self.reader.push::<InMemory>(0xff);
    }
}

/// Text, as main has it.
pub(crate) struct Winch {
    session: Session,
    on: bool,
    /// Pins are text's.
    wired: bool,
    drives: bool,
    /// The beginning of the next slice to be worked out, ticks.
    next: u64,
    /// A status line is due.
    pub(crate) report: bool,
}

impl Winch {
    /// Text is not on yet.
    pub(crate) const fn new() -> Winch {
        Winch { session: Session::new(), on: false, wired: false, drives: false, next: 0, report: false }
    }

    /// Whether lines are obeyed.
    pub(crate) const fn is_on(&self) -> bool {
        self.on
    }

    /// Takes a byte of a line; gives what is to be answered. `obeyed`: frames do not have the board.
    pub(crate) fn hear(&mut self, ear: &mut Ear, byte: u8, obeyed: bool) -> Option<Reply> {
        if byte == 0 {
            // Frames have zeros, text has none.
            ear.quiet = true;
            ear.reader.restart();
            return None;
        }
        match ear.reader.push::<InMemory>(byte) {
            Heard::Nothing => None,
            Heard::Refused(_) if ear.quiet => None,
            Heard::Refused(_) | Heard::Command(_) if !obeyed => Some(Reply::Taken),
            Heard::Refused(refusal) => Some(Reply::Refused(refusal)),
            Heard::Command(verb) => {
                ear.quiet = false;
                self.session.obey(verb, &mut ear.reader)
            }
        }
    }

    /// Sees to what a command has changed.
    pub(crate) fn settle(&mut self, board: &mut Board, service: &mut Service) {
        if self.session.is_wired() && !self.wired {
            self.wired = board.wire();
        }
        if self.session.drives() && !self.drives {
            let next = (board.clock.now() / u64::from(SLICE) + FIRST) * u64::from(SLICE);
            self.drives = self.wired && board.drive(next);
            if self.drives {
                self.next = next;
            } else {
                self.session.release();
            }
        }
        service.hold(self.drives);
    }

    /// Works out the slices that are due, and hands their steps on.
    #[inline(always)]
    pub(crate) fn go_on(&mut self, board: &mut Board) {
        if self.on {
            let ahead = if self.drives { KNOWN } else { 0 };
            let until = board.clock.now() + u64::from(ahead);
            while self.next <= until {
                self.slice(board);
            }
        }
    }

    #[inline(never)]
    fn slice(&mut self, board: &mut Board) {
        if self.session.is_report_due() {
            self.session.reported();
            self.report = true;
        }
        let slices: [Slice; 4] = self.session.millisecond();
        let begin = self.next;
        self.next += u64::from(SLICE);
        if self.drives {
            board.follow(slices, begin, self.next);
        }
    }

    /// What time brings; to be called every millisecond or so. Whether text begins anew.
    pub(crate) fn look(&mut self, board: &mut Board, service: &mut Service) -> bool {
        if self.drives {
            let ran_dry = !board.is_armed();
            if ran_dry || (self.session.has_stopped() && board.rests()) {
                self.session.release();
                self.drives = false;
                // Nothing moves any more.
                let _ = board.release();
                // What there is to tell of text is no news for frames.
                board.host_gone(false);
                // If it ran dry nobody knows where the motors stand: as after a reset.
                self.on &= !ran_dry;
                service.hold(false);
            }
            return false;
        }
        let on = !service.is_taken() && board.rests();
        let begins = on && !self.on;
        if begins {
            *self = Winch::new();
            self.next = (board.clock.now() / u64::from(SLICE) + 1) * u64::from(SLICE);
        }
        self.on = on;
        begins
    }

    /// What a status line says now.
    pub(crate) fn status(&self, board: &mut Board) -> Reply {
        let (now, positions) = board.positions();
        let usec = (now / u64::from(TICK_HZ / 1_000_000)) as u32;
        // Else the motors are those of frames.
        Reply::Status { usec: usec.cast_signed(), positions: if self.wired { positions } else { [0; 4] } }
    }
}
