//! The winch: text instead of frames, and motors that follow paths which the board works out itself.
//!
//! docs/winch.md has the commands. What they mean, and which steps they make, is in `pulsetrain_core::winch`, which the native
//! winch uses too. This file says when: the session's milliseconds are those of the board's clock, and are worked out as far ahead
//! as words are written.
//!
//! # Whose the board is
//! Text is *on* while no session of frames is open and no motor of frames moves. A command that enables the drivers starts *paths*:
//! they run until `enable 0` has released the drivers, and meanwhile the Hello of frames is refused. There is one session of text,
//! so that both ports have the same axes and settings, and a [`TextInput`] for each port.
//!
//! # Verbs
//! Lines with verbs (`pulsetrain_core::winch::verb_lines`) enable the same drivers, and *verbs run* until `enable 0`. Paths and
//! verbs do not mix: whichever was first keeps the axes until then. After verbs a new session of text begins, since paths would not
//! know where the axes are.

use crate::board::Board;
use crate::clock::TICK_HZ;
use crate::port_io::TextLine;
use crate::steps::stepper::{DIR_CLEARANCE, LOOK_AHEAD};
use pulsetrain_core::boards::pico::{
    AXIS_ENABLE_PIN as ENABLE_PIN, AXIS_PULSE_TICKS as PULSE_TICKS, AXIS_SETUP_TICKS as SETUP_TICKS,
    AXIS_STEP_PINS as STEP_PINS,
};
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::path::Slice;
use pulsetrain_core::winch::reply::LineReply;
use pulsetrain_core::winch::session::Session;
use pulsetrain_core::winch::text::{Heard, LineCommand, LineError, LineFault, LineReader};
use pulsetrain_core::winch::verb_lines::{self as text, LineOrders, VerbLine};
use pulsetrain_core::wire::message::{Configuration, Event, MOTOR_SETUP_LEN};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::{BoardSide, Reason, Refusal as Refused, Service, Settings};

/// Ticks of a slice: a millisecond of the session. Slices begin at the clock's multiples of it.
pub(crate) const SLICE_TICKS: u32 = TICK_HZ / 1000;

/// Slices are worked out if they begin so soon, ticks: as far ahead as words are written, and 0.1 ms for the main loop.
const LOOK_AHEAD_OF_PATHS: u32 = LOOK_AHEAD + DIR_CLEARANCE + SLICE_TICKS / 10;

/// Slices from a command that enables the drivers to the first in which they may step: [`Board::begin_paths`] needs a millisecond.
const FIRST_SLICE: u64 = 2;

const _: () = assert!(PULSE_TICKS as u32 * 500_000 == TICK_HZ && SETUP_TICKS as u32 * 200_000 == TICK_HZ);

// A change of DIR fits in the clearance: its set-up, and the words of DIR and of the step, which last a pulse and more each.
const _: () = assert!(SETUP_TICKS as u32 + 4 * PULSE_TICKS as u32 <= DIR_CLEARANCE);

/// The axes, as a Configure of frames would have them.
const AXES: [u8; 4 * MOTOR_SETUP_LEN] = {
    let mut axes = [0; 4 * MOTOR_SETUP_LEN];
    let mut axis = 0;
    while axis < 4 {
        let at = MOTOR_SETUP_LEN * axis;
        [axes[at], axes[at + 1], axes[at + 2]] = [STEP_PINS[axis], STEP_PINS[axis] + 1, FORWARD_HIGH];
        // Text says no pull-in speed. So the longest interval: after a stop in motion the position is always uncertain.
        [axes[at + 4], axes[at + 5], axes[at + 6], axes[at + 7]] = [0xff; 4];
        axis += 1;
    }
    axes
};

/// Bit 0 of [`MotorSetup`](pulsetrain_core::wire::message::MotorSetup)'s flags.
const FORWARD_HIGH: u8 = 1;

/// Pins and times of the axes, as a Configure of frames would have them.
pub(crate) fn wiring() -> Option<Configuration<'static>> {
    let mut wiring = Configuration::new(&AXES)?;
    (wiring.pulse_ticks, wiring.setup_ticks, wiring.hold_ticks) = (PULSE_TICKS, SETUP_TICKS, PULSE_TICKS);
    wiring.enable_pin = ENABLE_PIN;
    Some(wiring)
}

/// The answer while motors still move: verbs cannot have the axes yet.
const REFUSED_AS_MOVING: text::VerbReply = text::VerbReply::Refused(Refused::of(Reason::Moving));

/// The reader of one port's text.
pub(crate) struct TextInput {
    reader: LineReader,
    /// A zero byte has come since the last command: the host speaks frames, and gets no text.
    muted: bool,
    /// A status line is to be sent.
    pub(crate) owes_status: bool,
}

impl TextInput {
    pub(crate) const fn new() -> TextInput {
        TextInput { reader: LineReader::new(), muted: false, owes_status: false }
    }

    /// Whether the host speaks frames, so that no text is sent.
    pub(crate) const fn is_muted(&self) -> bool {
        self.muted
    }

    /// Notes that a byte was lost: the line that it was in is not obeyed.
    pub(crate) fn mark_lost_byte(&mut self) {
        self.reader.push::<InMemory>(0xff);
    }
}

/// What a byte of text completes.
pub(crate) enum TextEvent {
    Nothing,
    /// A line that has to be answered at once.
    Answer(TextLine),
    /// Verbs for the motors.
    Orders(LineOrders),
}

impl TextEvent {
    const fn answer(reply: LineReply) -> TextEvent {
        TextEvent::Answer(TextLine::Winch(reply))
    }
}

/// The state of text; main's.
pub(crate) struct Winch {
    session: Session,
    on: bool,
    /// The pins are configured for text.
    wired: bool,
    path_runs: bool,
    /// The axes follow verbs.
    verbs_run: bool,
    /// `enable 0` came while verbs ran: the axes stop, and are released as soon as they rest.
    releasing: bool,
    /// When the next slice that is to be worked out begins, ticks.
    next: u64,
    /// A status line is due.
    pub(crate) status_due: bool,
    /// Axes that a deadman stopped too fast, bit by axis, which is not yet reported.
    stopped_by_deadman: u8,
}

impl Winch {
    /// Text is not on yet.
    pub(crate) const fn new() -> Winch {
        Winch {
            session: Session::new(),
            on: false,
            wired: false,
            path_runs: false,
            verbs_run: false,
            releasing: false,
            next: 0,
            status_due: false,
            stopped_by_deadman: 0,
        }
    }

    /// Whether lines are obeyed.
    pub(crate) const fn is_on(&self) -> bool {
        self.on
    }

    /// Takes a byte of text. `obeyed`: no session of frames has the board.
    pub(crate) fn receive(&mut self, ear: &mut TextInput, byte: u8, obeyed: bool) -> TextEvent {
        if byte == 0 {
            // Frames have zeros, text has none.
            ear.muted = true;
            ear.reader.restart();
            return TextEvent::Nothing;
        }
        match ear.reader.push::<InMemory>(byte) {
            Heard::Nothing => TextEvent::Nothing,
            // What is no command of the winch may be a verb.
            Heard::Refused(refusal @ LineError { what: LineFault::Command, .. }) if obeyed => {
                match text::read(ear.reader.line()) {
                    VerbLine::Orders(orders) => {
                        ear.muted = false;
                        TextEvent::Orders(orders)
                    }
                    _ if ear.muted => TextEvent::Nothing,
                    VerbLine::Refused(what, word) => {
                        TextEvent::Answer(TextLine::Verbs(text::VerbReply::Unread(what, word)))
                    }
                    VerbLine::Unknown => TextEvent::answer(LineReply::Refused(refusal)),
                }
            }
            Heard::Refused(_) if ear.muted => TextEvent::Nothing,
            Heard::Refused(_) | Heard::Command(_) if !obeyed => TextEvent::answer(LineReply::Taken),
            Heard::Refused(refusal) => TextEvent::answer(LineReply::Refused(refusal)),
            Heard::Command(verb) => {
                ear.muted = false;
                match verb {
                    verb if self.verbs_run && verb.has_flags() => {
                        TextEvent::Answer(TextLine::Verbs(text::VerbReply::Verbs))
                    }
                    LineCommand::Enable if self.verbs_run && ear.reader.value() == 0 => {
                        self.session.heard();
                        self.releasing = true;
                        TextEvent::Nothing
                    }
                    // A stop goes on to its end, whatever comes after it.
                    LineCommand::Enable if self.releasing => TextEvent::Answer(TextLine::Verbs(REFUSED_AS_MOVING)),
                    LineCommand::Enable if self.verbs_run => {
                        self.session.heard();
                        TextEvent::Nothing
                    }
                    _ => self.session.obey(verb, &mut ear.reader).map_or(TextEvent::Nothing, TextEvent::answer),
                }
            }
        }
    }

    /// Has motors follow the verbs of a line, and returns the answer.
    pub(crate) fn obey_verbs(&mut self, board: &mut Board, orders: &LineOrders) -> text::VerbReply {
        if self.path_runs {
            return text::VerbReply::Path;
        }
        if self.releasing {
            return REFUSED_AS_MOVING;
        }
        self.wired = self.wired || board.configure_axes();
        let done = match orders.orders() {
            Some(orders) if self.wired => self.obey(board, &orders),
            _ => return REFUSED_AS_MOVING,
        };
        match done {
            Ok(()) => {
                self.session.heard();
                text::VerbReply::At { obeyed: board.last_orders(), axes: orders.axes() }
            }
            Err(refused) => text::VerbReply::Refused(refused),
        }
    }

    fn obey(&mut self, board: &mut Board, orders: &Orders<'_>) -> Result<(), Refused> {
        if !self.verbs_run {
            // Done moves of frames' motors are not for text.
            while board.move_done().is_some() {}
            // Checked first: a line that is refused must not enable the drivers.
            board.check_orders(orders)?;
            board.arm()?;
        }
        self.verbs_run = true;
        board.obey(orders)
    }

    /// The report of a move that is done.
    pub(crate) fn move_done(&mut self, board: &mut Board) -> Option<text::VerbReply> {
        let Event { motor, tick, detail, .. } = if self.verbs_run { board.move_done()? } else { return None };
        Some(text::VerbReply::Done { axis: motor, tick, number: detail })
    }

    /// The report of axes that a deadman has stopped too fast.
    pub(crate) fn uncertain(&mut self) -> Option<text::VerbReply> {
        let axes = core::mem::take(&mut self.stopped_by_deadman);
        (axes != 0).then_some(text::VerbReply::Uncertain { axes })
    }

    /// Does what the last command asks of the board.
    pub(crate) fn apply_command(&mut self, board: &mut Board, service: &mut Service) {
        if self.session.is_wired() && !self.wired {
            self.wired = board.configure_axes();
        }
        if self.session.drives() && !self.path_runs {
            let next = (board.now() / u64::from(SLICE_TICKS) + FIRST_SLICE) * u64::from(SLICE_TICKS);
            self.path_runs = self.wired && board.begin_paths(next);
            if self.path_runs {
                self.next = next;
            } else {
                self.session.release();
            }
        }
        service.hold(self.path_runs || self.verbs_run);
    }

    /// Works out the slices that are due, and hands their steps over.
    #[inline(always)]
    pub(crate) fn advance(&mut self, board: &mut Board) {
        if self.on {
            let ahead = if self.path_runs { LOOK_AHEAD_OF_PATHS } else { 0 };
            let until = board.now() + u64::from(ahead);
            while self.next <= until {
                self.slice(board);
            }
        }
    }

    #[inline(never)]
    fn slice(&mut self, board: &mut Board) {
        if self.session.is_report_due() {
            self.session.reported();
            self.status_due = true;
        }
        let slices: [Slice; 4] = self.session.millisecond();
        let begin = self.next;
        self.next += u64::from(SLICE_TICKS);
        if self.path_runs {
            board.push_slice(slices, begin, self.next);
        }
    }

    /// Does what depends on time; to be called every millisecond or so. Whether a new session of text begins.
    pub(crate) fn poll(&mut self, board: &mut Board, service: &mut Service) -> bool {
        if self.verbs_run {
            if self.releasing || self.session.deadman_expired() {
                let stopped = board.drop_orders(true);
                // Not after `enable 0`: that host asked for the stop.
                self.stopped_by_deadman |= if self.releasing { 0 } else { stopped };
            }
            // Done moves are reported first.
            if board.next_done().is_none() && (!board.is_armed() || (self.releasing && board.is_at_rest())) {
                // It cannot be refused: nothing moves any more.
                let _ = board.release();
                board.host_gone(false);
                (self.verbs_run, self.on) = (false, false);
                service.hold(false);
            }
            return false;
        }
        if self.path_runs {
            let ran_dry = !board.is_armed();
            if ran_dry || (self.session.has_stopped() && board.is_at_rest()) {
                self.session.release();
                self.path_runs = false;
                // It cannot be refused: nothing moves any more.
                let _ = board.release();
                // Events of text are not for frames.
                board.host_gone(false);
                // After an underrun the session does not know where the axes are: text begins again, as after a reset.
                self.on &= !ran_dry;
                service.hold(false);
            }
            return false;
        }
        let on = !service.is_taken() && board.is_at_rest();
        let begins = on && !self.on;
        if begins {
            let kept = board.hardware.store.settings().and_then(|bytes| Settings::decode(bytes)).unwrap_or_default();
            *self = Winch { session: Session::keeping(&kept), ..Winch::new() };
            self.next = (board.now() / u64::from(SLICE_TICKS) + 1) * u64::from(SLICE_TICKS);
        }
        self.on = on;
        begins
    }

    /// The status line for now.
    pub(crate) fn status(&self, board: &mut Board) -> LineReply {
        let (now, positions) = board.positions();
        let usec = (now / u64::from(TICK_HZ / 1_000_000)) as u32;
        // If text has not configured the pins, the positions are of frames' motors.
        LineReply::Status { usec: usec.cast_signed(), positions: if self.wired { positions } else { [0; 4] } }
    }
}
