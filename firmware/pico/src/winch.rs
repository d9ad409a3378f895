//! The winch: text on the lines instead of frames, and motors that follow paths which the board works out itself.
//!
//! docs/winch.md has the commands; what they mean and which steps come of them is `pulsetrain_core::winch`, the same code as the
//! native winch's. Here is when: milliseconds are those of the board's clock, worked out as far ahead as words are written.
//!
//! # Who has the board
//! As long as frames have not taken it and no motor of theirs moves, text is *on*. From the first command that enables the drivers,
//! until `enable 0` has released them, text *drives*, and frames' Hello is refused. Text has one session, whose axes and settings are
//! those of both lines, and an [`Ear`] for each of them.
//!
//! # Verbs
//! Lines that tell motors directly (`pulsetrain_core::winch::verb_lines`) enable the drivers, too, of the same axes, and text *tells* them
//! until `enable 0`. Paths and verbs do not mix: who has the axes keeps them until then. After verbs text begins anew, since paths
//! would not know where the axes are.

use crate::clock::TICK_HZ;
use crate::machine::Board;
use crate::steps::stepper::{AHEAD, CLEAR};
use crate::talk::Line;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::Slice;
use pulsetrain_core::winch::reply::LineReply;
use pulsetrain_core::winch::session::Session;
use pulsetrain_core::winch::text::{Heard, LineCommand, LineError, LineFault, LineReader};
use pulsetrain_core::winch::verb_lines::{self as text, LineOrders, VerbLine};
use pulsetrain_core::wire::message::{Configuration, Event, MOTOR_SETUP_LEN};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::{Machine, Reason, Refusal as Refused, Service, Settings};

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
        // Text knows no pull-in speed: none is so slow that a stop at once is sure to be one.
        [axes[at + 4], axes[at + 5], axes[at + 6], axes[at + 7]] = [0xff; 4];
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

/// The axes cannot be had yet.
const MOVING: text::VerbReply = text::VerbReply::Refused(Refused::of(Reason::Moving));

/// What is heard as text on a line.
pub(crate) struct Ear {
    reader: LineReader,
    /// A zero has come since the last command: frames are spoken, and nothing is said as text.
    quiet: bool,
    /// A status line is to be said.
    pub(crate) owes_status: bool,
}

impl Ear {
    pub(crate) const fn new() -> Ear {
        Ear { reader: LineReader::new(), quiet: false, owes_status: false }
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

/// What a byte of a line has brought.
pub(crate) enum Brought {
    Nothing,
    /// Something to say.
    Answer(Line),
    /// Something to tell motors directly.
    Told(LineOrders),
}

impl Brought {
    const fn answer(reply: LineReply) -> Brought {
        Brought::Answer(Line::Winch(reply))
    }
}

/// Text, as main has it.
pub(crate) struct Winch {
    session: Session,
    on: bool,
    /// Pins are text's.
    wired: bool,
    drives: bool,
    /// Verbs have the axes.
    tells: bool,
    /// `enable 0` was said to them: they stop, and verbs lose them as soon as they rest.
    ends: bool,
    /// The beginning of the next slice to be worked out, ticks.
    next: u64,
    /// A status line is due.
    pub(crate) report: bool,
    /// Axes that a deadman stopped at once, which is to be said.
    stopped: u8,
}

impl Winch {
    /// Text is not on yet.
    pub(crate) const fn new() -> Winch {
        Winch {
            session: Session::new(),
            on: false,
            wired: false,
            drives: false,
            tells: false,
            ends: false,
            next: 0,
            report: false,
            stopped: 0,
        }
    }

    /// Whether lines are obeyed.
    pub(crate) const fn is_on(&self) -> bool {
        self.on
    }

    /// Takes a byte of a line; gives what is to be answered. `obeyed`: frames do not have the board.
    pub(crate) fn hear(&mut self, ear: &mut Ear, byte: u8, obeyed: bool) -> Brought {
        if byte == 0 {
            // Frames have zeros, text has none.
            ear.quiet = true;
            ear.reader.restart();
            return Brought::Nothing;
        }
        match ear.reader.push::<InMemory>(byte) {
            Heard::Nothing => Brought::Nothing,
            // The winch does not know verbs.
            Heard::Refused(refusal @ LineError { what: LineFault::Command, .. }) if obeyed => {
                match text::read(ear.reader.line()) {
                    VerbLine::Orders(told) => {
                        ear.quiet = false;
                        Brought::Told(told)
                    }
                    _ if ear.quiet => Brought::Nothing,
                    VerbLine::Refused(what, word) => Brought::Answer(Line::Verbs(text::VerbReply::Unread(what, word))),
                    VerbLine::Unknown => Brought::answer(LineReply::Refused(refusal)),
                }
            }
            Heard::Refused(_) if ear.quiet => Brought::Nothing,
            Heard::Refused(_) | Heard::Command(_) if !obeyed => Brought::answer(LineReply::Taken),
            Heard::Refused(refusal) => Brought::answer(LineReply::Refused(refusal)),
            Heard::Command(verb) => {
                ear.quiet = false;
                match verb {
                    verb if self.tells && verb.has_flags() => Brought::Answer(Line::Verbs(text::VerbReply::Verbs)),
                    LineCommand::Enable if self.tells && ear.reader.value() == 0 => {
                        self.session.heard();
                        self.ends = true;
                        Brought::Nothing
                    }
                    // A stop goes to its end, whatever comes behind it.
                    LineCommand::Enable if self.ends => Brought::Answer(Line::Verbs(MOVING)),
                    LineCommand::Enable if self.tells => {
                        self.session.heard();
                        Brought::Nothing
                    }
                    _ => self.session.obey(verb, &mut ear.reader).map_or(Brought::Nothing, Brought::answer),
                }
            }
        }
    }

    /// Tells motors directly what a line says; gives what is to be answered.
    pub(crate) fn tell(&mut self, board: &mut Board, told: &LineOrders) -> text::VerbReply {
        if self.drives {
            return text::VerbReply::Path;
        }
        if self.ends {
            return MOVING;
        }
        self.wired = self.wired || board.wire();
        let done = match told.orders() {
            Some(orders) if self.wired => self.obey(board, &orders),
            _ => return MOVING,
        };
        match done {
            Ok(()) => {
                self.session.heard();
                text::VerbReply::At { obeyed: board.obeyed, axes: told.axes() }
            }
            Err(refused) => text::VerbReply::Refused(refused),
        }
    }

    fn obey(&mut self, board: &mut Board, orders: &Orders<'_>) -> Result<(), Refused> {
        if !self.tells {
            // What frames' motors have done is not text's to tell.
            while board.move_done().is_some() {}
            // A line that is refused does not enable the drivers.
            board.would_obey(orders)?;
            board.arm()?;
        }
        self.tells = true;
        board.obey(orders)
    }

    /// A move of verbs that was done.
    pub(crate) fn move_done(&mut self, board: &mut Board) -> Option<text::VerbReply> {
        let Event { motor, tick, detail, .. } = if self.tells { board.move_done()? } else { return None };
        Some(text::VerbReply::Done { axis: motor, tick, number: detail })
    }

    /// What is to be said of axes that a deadman has stopped.
    pub(crate) fn uncertain(&mut self) -> Option<text::VerbReply> {
        let axes = core::mem::take(&mut self.stopped);
        (axes != 0).then_some(text::VerbReply::Uncertain { axes })
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
        service.hold(self.drives || self.tells);
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
        if self.tells {
            if self.ends || self.session.deadman_expired() {
                let stopped = board.halt(true);
                // Who says `enable 0` knows.
                self.stopped |= if self.ends { 0 } else { stopped };
            }
            // What was done is told first.
            if board.next_done().is_none() && (!board.is_armed() || (self.ends && board.rests())) {
                // Nothing moves any more.
                let _ = board.release();
                board.host_gone(false);
                (self.tells, self.on) = (false, false);
                service.hold(false);
            }
            return false;
        }
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
            let kept = board.store.settings().and_then(|bytes| Settings::decode(bytes)).unwrap_or_default();
            *self = Winch { session: Session::keeping(&kept), ..Winch::new() };
            self.next = (board.clock.now() / u64::from(SLICE) + 1) * u64::from(SLICE);
        }
        self.on = on;
        begins
    }

    /// What a status line says now.
    pub(crate) fn status(&self, board: &mut Board) -> LineReply {
        let (now, positions) = board.positions();
        let usec = (now / u64::from(TICK_HZ / 1_000_000)) as u32;
        // Else the motors are those of frames.
        LineReply::Status { usec: usec.cast_signed(), positions: if self.wired { positions } else { [0; 4] } }
    }
}
