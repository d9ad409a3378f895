//! A board that obeys StepperWinch's text (docs/winch.md), without a firmware, in virtual time.
//!
//! Core reads the text and computes the steps, with the same code as on a Pico; this module adds a clock, a serial line and pins. (The Uno's firmware
//! does the same in assembly: tests/it/chips/winch_avr.rs compares the two.)
//!
//! It also obeys the text form of verbs (docs/verbs.md), with ticks of 62.5 ns: [`NativeVerbs`] makes those steps.

use crate::bridge::{self, Bridge, CYCLES_PER_S, ToHost, bit_cycles};
use crate::native_verbs::NativeVerbs;
use crate::{Config, Edge, MotorConfig, Port, PortError, VirtualBoard, Wiring};
use pulsetrain_core::Direction;
use pulsetrain_core::verbs::MotorTiming;
use pulsetrain_core::winch::AXES;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::reply::{LONGEST, LineReply};
use pulsetrain_core::winch::session::Session;
use pulsetrain_core::winch::spacing::TICKS;
use pulsetrain_core::winch::text::{Heard, LineCommand, LineError, LineFault, LineReader};
use pulsetrain_core::winch::verb_lines::{self as text, LineOrders, VerbLine};
use pulsetrain_core::wire::message::{Cause, Event};
use pulsetrain_core::wire::{Baud, Reason, Refusal as Refused};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::Duration;

/// STEP of x, y, z and a: the CNC shield's pins.
pub const STEP_PINS: [u8; 4] = [2, 3, 4, 12];
/// DIR of x, y, z and a; high is forward.
pub const DIR_PINS: [u8; 4] = [5, 6, 7, 13];
/// The drivers' common enable input; low is on.
pub const ENABLE_PIN: u8 = 8;

/// How long STEP stays high, ticks: 2 µs.
const PULSE: u64 = 32;
/// How long before a step DIR has its level, ticks: 5 µs.
const SETUP: u64 = 80;
/// While this many bytes wait for the line, finished moves are not reported. Answers are never held back, so that none is lost.
const UNSENT: usize = 256;

/// The timing for verbs, ticks: STEP is low for at least as long as a pulse, DIR is kept as long after one, and axes begin with 1000 steps/s.
const LIMITS: MotorTiming =
    MotorTiming { shortest: 2 * PULSE as u32, turn: (2 * PULSE + SETUP) as u32, period: (CYCLES_PER_S / 1000) as u32 };

// Steps of a path are at least 100 µs apart, 124 µs at a reversal: a pulse ends before DIR changes for the next one.
const _: () = assert!(PULSE + SETUP < 1600 && SETUP < TICKS as u64);

/// The answer while the axes still stop after `enable 0`.
const MOVING: text::VerbReply = text::VerbReply::Refused(Refused::of(Reason::Moving));

/// A StepperWinch board in virtual time. One tick is 62.5 ns, as on the Uno.
///
/// Each millisecond it computes the steps of the path for the next one.
///
/// ```
/// use pulsetrain_board::native_winch::NativeWinch;
/// use pulsetrain_board::Port;
/// use std::time::Duration;
/// let (mut winch, mut heard) = (NativeWinch::new(), Vec::new());
/// winch.send(b"ping\n").unwrap();
/// while winch.now() < Duration::from_millis(10) {
///     winch.receive(Duration::from_millis(10), &mut heard).unwrap();
/// }
/// assert_eq!(heard, b"awake\r\nawake\r\n");
/// ```
#[derive(Debug)]
pub struct NativeWinch {
    /// Ticks since the board was made.
    now: u64,
    /// The tick at which the board's own clock began: at its last reset.
    zero: u64,
    /// The next millisecond of the board's clock.
    next_ms: u64,
    reader: LineReader,
    session: Session,
    forward: [bool; 4],
    positions: [i32; 4],
    is_enabled: bool,
    /// The axes while they obey verbs instead of paths.
    verbs: Option<NativeVerbs>,
    /// Whether axes that obey verbs got `enable 0`: they stop, and once they rest, they obey paths again.
    is_stopping: bool,
    /// Reports of finished moves that wait for the line.
    done: VecDeque<text::VerbReply>,
    /// Edges that are still to be made, the earliest first: tick, line, level.
    planned: BinaryHeap<Reverse<(u64, u8, bool)>>,
    edges: Vec<Edge>,
    line: SerialLine,
}

/// The serial line; ticks are those of [`NativeWinch::now`].
#[derive(Clone, Debug)]
struct SerialLine {
    baud: Baud,
    /// Bytes on their way to the board, with the tick at which each arrives.
    to_board: VecDeque<(u64, u8)>,
    /// Bytes on their way to the host, with the tick at which each arrives.
    to_host: ToHost,
    /// The tick up to which the line to the board is busy.
    busy_to_board: u64,
    /// The tick up to which the line to the host is busy.
    busy_to_host: u64,
}

impl Default for NativeWinch {
    fn default() -> NativeWinch {
        NativeWinch::new()
    }
}

impl NativeWinch {
    /// A board that has just been plugged in: it sends `awake`, and its drivers are off.
    #[must_use]
    pub fn new() -> NativeWinch {
        let line = SerialLine {
            baud: Baud::B115200,
            to_board: VecDeque::new(),
            to_host: ToHost::default(),
            busy_to_board: 0,
            busy_to_host: 0,
        };
        let mut winch = NativeWinch {
            now: 0,
            zero: 0,
            next_ms: 0,
            reader: LineReader::new(),
            session: Session::new(),
            forward: [false; 4],
            positions: [0; 4],
            is_enabled: false,
            verbs: None,
            is_stopping: false,
            done: VecDeque::new(),
            planned: BinaryHeap::new(),
            edges: Vec::new(),
            line,
        };
        winch.start();
        winch
    }

    fn start(&mut self) {
        self.edges.push(Edge { tick: 0, line: ENABLE_PIN, level: true });
        self.say(&LineReply::Awake);
    }

    /// Steps forward minus backward of x, y, z and a, by the pulses that have begun.
    #[must_use]
    pub const fn positions(&self) -> [i32; 4] {
        self.positions
    }

    /// Whether the drivers are on.
    #[must_use]
    pub const fn is_enabled(&self) -> bool {
        self.is_enabled
    }

    /// Whether no axis moves, and none has an order left.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.session.is_at_rest() && self.verbs.as_ref().is_none_or(NativeVerbs::is_idle)
    }

    /// The board's clock, ticks.
    const fn clock(&self) -> u64 {
        self.now - self.zero
    }

    fn run(&mut self, until: u64) {
        while self.now < until {
            let ms = self.zero + self.next_ms * u64::from(TICKS);
            let byte = self.line.to_board.front().map_or(u64::MAX, |byte| byte.0);
            let next = until.min(ms).min(byte);
            self.play(next);
            self.now = next;
            // A byte that arrives as a millisecond begins is handled before it: a line that ends with it acts on this millisecond.
            if byte == next
                && let Some((_, byte)) = self.line.to_board.pop_front()
            {
                let noise = self.line.baud != Baud::B115200;
                self.receive_byte(if noise { bridge::garbled(byte) } else { byte });
            } else if ms == next {
                self.millisecond();
            }
        }
    }

    /// Makes the edges up to `until`.
    fn play(&mut self, until: u64) {
        if let Some(verbs) = &mut self.verbs {
            let (zero, planned) = (self.zero, &mut self.planned);
            let plan = |edge: Edge| planned.push(Reverse((zero + edge.tick, edge.line, edge.level)));
            verbs.advance(until - zero, &mut { plan });
            let done = verbs.events().into_iter().filter(|event| event.cause == Cause::MoveDone);
            let line = |Event { motor, tick, detail, .. }| text::VerbReply::Done { axis: motor, tick, number: detail };
            self.done.extend(done.map(line));
        }
        while let Some(Reverse((at, line, level))) = self.planned.peek().copied()
            && at <= until
        {
            self.planned.pop();
            if level && let Some(axis) = STEP_PINS.iter().position(|pin| *pin == line) {
                let step = if self.forward[axis] { 1 } else { -1 };
                self.positions[axis] = self.positions[axis].wrapping_add(step);
            } else if let Some(axis) = DIR_PINS.iter().position(|pin| *pin == line) {
                if self.forward[axis] == level {
                    continue;
                }
                self.forward[axis] = level;
            }
            self.edges.push(Edge { tick: at - self.zero, line, level });
        }
    }

    /// Computes the next millisecond, and sends the reports that are due.
    fn millisecond(&mut self) {
        if self.session.is_report_due() && self.line.unsent(self.now) == 0 {
            self.session.reported();
            let usec = self.clock() / (CYCLES_PER_S / 1_000_000);
            self.say(&LineReply::Status { usec: (usec as u32).cast_signed(), positions: self.positions });
        }
        self.next_ms += 1;
        let plays_at = self.zero + self.next_ms * u64::from(TICKS);
        for (axis, slice) in self.session.millisecond().into_iter().enumerate() {
            let Some(steps) = slice.steps(TICKS.into()) else { continue };
            let forward = steps.direction == Direction::Forward;
            for (step, tick) in steps.ticks().enumerate() {
                let at = plays_at + u64::from(tick);
                if step == 0 {
                    self.planned.push(Reverse((at - SETUP, DIR_PINS[axis], forward)));
                }
                self.planned.push(Reverse((at, STEP_PINS[axis], true)));
                self.planned.push(Reverse((at + PULSE, STEP_PINS[axis], false)));
            }
        }
        while self.line.unsent(self.now) < UNSENT
            && let Some(done) = self.done.pop_front()
        {
            self.answer(&done);
        }
        if let Some(verbs) = &mut self.verbs {
            let stopped = if self.is_stopping || self.session.deadman_expired() { verbs.halt() } else { 0 };
            let rests = verbs.is_idle();
            // A client that sent `enable 0` knows that the positions are uncertain.
            if stopped != 0 && !self.is_stopping {
                self.answer(&text::VerbReply::Uncertain { axes: stopped });
            }
            // Finished moves are reported before `awake`.
            if self.is_stopping && rests && self.done.is_empty() {
                (self.verbs, self.is_stopping) = (None, false);
                (self.session, self.positions) = (Session::new(), [0; 4]);
                self.enable();
                self.say(&LineReply::Awake);
            }
        }
        if self.session.has_stopped() && self.planned.is_empty() {
            self.session.release();
            self.enable();
        }
    }

    /// Switches the drivers on while axes obey a path or verbs, else off.
    fn enable(&mut self) {
        let on = self.session.drives() || self.verbs.is_some();
        if on != self.is_enabled {
            self.is_enabled = on;
            self.edges.push(Edge { tick: self.clock(), line: ENABLE_PIN, level: !on });
        }
    }

    fn receive_byte(&mut self, byte: u8) {
        let reply = match self.reader.push::<InMemory>(byte) {
            Heard::Nothing => return,
            // A line that is no command of paths may be one of verbs.
            Heard::Refused(refusal @ LineError { what: LineFault::Command, .. }) => {
                match text::read(self.reader.line()) {
                    VerbLine::Unknown => Some(LineReply::Refused(refusal)),
                    VerbLine::Refused(what, word) => return self.answer(&text::VerbReply::Unread(what, word)),
                    VerbLine::Orders(line) => {
                        let reply = self.obey_verbs(&line);
                        self.enable();
                        return self.answer(&reply);
                    }
                }
            }
            Heard::Refused(refusal) => Some(LineReply::Refused(refusal)),
            Heard::Command(verb) if self.verbs.is_some() && verb.has_flags() => {
                return self.answer(&text::VerbReply::Verbs);
            }
            // While the axes stop, they cannot be enabled again.
            Heard::Command(LineCommand::Enable) if self.is_stopping && self.reader.value() != 0 => {
                return self.answer(&MOVING);
            }
            Heard::Command(LineCommand::Enable) if self.verbs.is_some() => {
                self.session.heard();
                self.is_stopping = self.reader.value() == 0;
                None
            }
            Heard::Command(verb) => self.session.obey(verb, &mut self.reader),
        };
        self.enable();
        if let Some(reply) = reply {
            self.say(&reply);
        }
    }

    /// Obeys a line of verbs, and returns the answer.
    fn obey_verbs(&mut self, line: &LineOrders) -> text::VerbReply {
        if self.session.drives() {
            return text::VerbReply::Path;
        }
        if self.is_stopping {
            return MOVING;
        }
        let Some(orders) = line.orders() else { return text::VerbReply::Refused(Refused::of(Reason::Malformed)) };
        // If the first line of verbs is refused, the axes go on obeying paths.
        let mut first = self.verbs.is_none().then(|| self.verbs_from_here());
        let Some(verbs) = self.verbs.as_mut().or(first.as_mut()) else { return text::VerbReply::Path };
        match verbs.obey(verbs.open(), &orders) {
            Ok(obeyed) => {
                self.session.heard();
                if let Some(verbs) = first {
                    self.verbs = Some(verbs);
                    self.lower_dir();
                }
                text::VerbReply::At { obeyed, axes: line.axes() }
            }
            Err(refused) => text::VerbReply::Refused(refused),
        }
    }

    /// The axes at their present positions, ready to obey verbs.
    fn verbs_from_here(&self) -> NativeVerbs {
        let motor = |axis: usize| MotorConfig {
            wiring: Wiring::StepDir {
                step: STEP_PINS[axis],
                dir: DIR_PINS[axis],
                forward_high: true,
                pulse_ticks: PULSE as u32,
                setup_ticks: SETUP as u32,
            },
            pull_in_ticks: 0,
        };
        let config = Config { fraction_bits: 32, motors: (0..AXES.len()).map(motor).collect() };
        NativeVerbs::at(&config, &[LIMITS; AXES.len()], &self.positions, self.clock() + 1).expect("four axes")
    }

    /// Makes all DIR lines low, as [`NativeVerbs`] expects them at its beginning.
    fn lower_dir(&mut self) {
        let tick = self.clock();
        for (forward, line) in self.forward.iter_mut().zip(DIR_PINS).filter(|(forward, _)| **forward) {
            *forward = false;
            self.edges.push(Edge { tick, line, level: false });
        }
    }

    fn say(&mut self, reply: &LineReply) {
        let mut text = [0; LONGEST];
        let len = reply.write::<InMemory>(&mut text);
        self.line.say(self.now, &text[..usize::from(len)]);
    }

    fn answer(&mut self, reply: &text::VerbReply) {
        let mut text = [0; text::LONGEST];
        let len = reply.write(&mut text);
        self.line.say(self.now, &text[..len]);
    }
}

impl SerialLine {
    fn byte_ticks(&self) -> u64 {
        10 * bit_cycles(self.baud.rate())
    }

    /// How many bytes to the host are not on the line yet.
    fn unsent(&self, now: u64) -> usize {
        let left = self.busy_to_host.saturating_sub(now).div_ceil(self.byte_ticks());
        usize::try_from(left).unwrap_or(usize::MAX)
    }

    fn say(&mut self, now: u64, text: &[u8]) {
        let at_wrong_rate = self.baud != Baud::B115200;
        for byte in text {
            self.busy_to_host = self.busy_to_host.max(now) + self.byte_ticks();
            let byte = if at_wrong_rate { bridge::garbled(*byte) } else { *byte };
            self.to_host.say(self.busy_to_host, byte);
        }
    }
}

impl VirtualBoard for NativeWinch {
    fn reset(&mut self) {
        let NativeWinch { now, line: SerialLine { baud, .. }, .. } = *self;
        *self = NativeWinch::new();
        (self.now, self.zero, self.line.baud) = (now, now, baud);
        (self.line.busy_to_board, self.line.busy_to_host) = (now, now);
        self.line.to_host.clear();
        self.edges.clear();
        self.start();
    }

    fn zero(&self) -> Option<u64> {
        Some(self.zero)
    }

    fn baud(&self) -> Baud {
        self.line.baud
    }

    fn set_bridge(&mut self, bridge: Bridge) -> bool {
        self.line.to_host = ToHost::through(bridge);
        true
    }
}

impl Port for NativeWinch {
    fn now(&self) -> Duration {
        bridge::duration(self.now)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        let frame = bridge::next_frame(self.now);
        for byte in bytes {
            self.line.busy_to_board = self.line.busy_to_board.max(frame) + self.line.byte_ticks();
            self.line.to_board.push_back((self.line.busy_to_board, *byte));
        }
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let until = bridge::cycles(until);
        let had = into.len();
        while into.len() == had && self.now < until {
            let frame = bridge::next_frame(self.now);
            self.run(frame.min(until));
            if self.now == frame {
                self.line.to_host.hand_over(frame, into);
            }
        }
        Ok(())
    }

    /// Text works at 115 200 baud. At another rate both ends receive wrong bytes.
    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.line.baud = baud;
        Ok(())
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        into.append(&mut self.edges);
    }
}

const _: () = assert!(AXES.len() == STEP_PINS.len());
