//! The board's side of the link: takes frames, executes them through a [`BoardSide`], and writes the answers.
//!
//! # Order
//! A frame is executed if its sequence number is the next one. A repeated frame is answered again and not executed
//! again. A frame that comes too early is not executed, and the answer ([`Reply::Missing`]) tells the host from which
//! frame to repeat. One acknowledgement serves for all Data up to its number, and for extensions of a lease; a field
//! tells which extension was accepted. A command is answered when it is done, and the host sends nothing more before
//! that. The last request is kept with its outcome, so that a lost answer can be repeated.
//!
//! # Who may speak
//! Hello takes the board; until Bye, or until the host was silent for too long, another Hello is refused. Each session
//! has a [`Tag`], and frames of another one are as good as noise. A board with several lines hands over what comes on the
//! session's own while it is [taken](Service::is_taken), and [turns away](Service::turn_away) the others.
//!
//! # Rate
//! The board changes it after the answer to Baud is out, and goes back to 115 200 baud if it then hears nothing
//! of its session for [`TRIAL_MS`]; also when the session ends.
//!
//! [`Reply::Missing`]: super::Reply::Missing

use super::board_side::BoardSide;
use super::frame::{Encoder, MAX_BODY, Received, Tag};
use super::limits::{Baud, Millis, VERSION};
use super::message::{Configuration, MIN_BODY, kind, len_of};
use super::orders::Orders;
use super::outcome::{Missing, Reason, Refusal, Stopped};
use super::settings::{self, SETTINGS_LEN};
use crate::{Epoch, Tick32};

/// How long a board listens at a new rate before it goes back to 115 200 baud, ms.
pub const TRIAL_MS: u16 = 250;

/// How long a host may be silent unless it says otherwise, ms.
pub const SILENCE_MS: u16 = 2000;

/// The last request and its outcome. The answer is written from it, again if it was lost.
#[derive(Clone, Copy, Debug)]
struct Answer {
    seq: u8,
    kind: u8,
    /// Why the board refused it. (A question is answered with new values each time.)
    refused: Option<Refusal>,
    /// The outcome of Switch, Trim, Brake or StopNow: a tick, and in `code` the result, or for StopNow which motors are uncertain.
    tick: [u8; 8],
    code: u8,
}

/// The progress of a change of rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    None,
    /// The rate changes when the answer is out.
    Due(Baud),
    /// The rate has changed, but nothing was heard at it yet.
    Trial {
        since: Millis,
    },
    /// The change was taken back, and the host has not been heard since.
    FellBack,
}

/// The board's side of the link. It is given whole frames. A [`Decoder`](super::Decoder) makes these of the bytes on the line, or a reader
/// of the board's own that does the same.
#[derive(Clone, Debug)]
pub struct Service {
    /// The tag of the newest session, which is over unless `taken`.
    tag: Tag,
    nonce: u32,
    taken: bool,
    /// The sequence number of the next frame.
    expected: u8,
    /// The sequence number of the last Extend, Switch, Trim or Brake that was accepted; that of Hello if none was.
    accepted: u8,
    answer: Answer,
    answer_due: bool,
    ack_due: bool,
    missing_due: Option<Missing>,
    /// The host has been sent a Missing, and has not gone back yet. A second one would make it go back twice.
    missing_sent: bool,
    /// The sequence number of a Hello that will be refused.
    refusal_due: Option<u8>,
    /// When the host was last heard.
    heard: Millis,
    silence_ms: u16,
    baud: Baud,
    change: Change,
    max_body: u8,
    events: u8,
    damaged: u16,
    /// The last byte to the host was not the end of a frame: nothing was sent at this rate yet, or text was. The next frame gets a zero
    /// before it.
    new_rate: bool,
    /// No host may take the board.
    held: bool,
}

impl Service {
    /// A board that no host has taken, with its line at 115 200 baud. It takes bodies of up to `max_body` bytes, [`MIN_BODY`] to
    /// [`MAX_BODY`].
    ///
    /// # Panics
    /// If `max_body` is out of this range. In a constant, the compiler finds that.
    ///
    /// [`MIN_BODY`]: super::MIN_BODY
    /// [`MAX_BODY`]: super::MAX_BODY
    #[must_use]
    pub const fn new(max_body: usize) -> Service {
        let mut service = Service::UNSET;
        service.begin(max_body);
        service
    }

    /// A service before [`begin`](Service::begin), for a static variable: it is all zeros, which take no flash.
    pub const UNSET: Service = Service {
        tag: Tag::NONE,
        nonce: 0,
        taken: false,
        expected: 0,
        accepted: 0,
        answer: Answer { seq: 0, kind: 0, refused: None, tick: [0; 8], code: 0 },
        answer_due: false,
        ack_due: false,
        missing_due: Some(Missing::Gap),
        missing_sent: false,
        refusal_due: None,
        heard: Millis(0),
        silence_ms: 0,
        baud: Baud::B115200,
        change: Change::None,
        max_body: 0,
        events: 0,
        damaged: 0,
        new_rate: false,
        held: false,
    };

    /// Turns an [`UNSET`](Service::UNSET) service into a [`new`](Service::new) one.
    ///
    /// # Panics
    /// As [`new`](Service::new).
    #[expect(clippy::cast_possible_truncation, reason = "below 128")]
    pub const fn begin(&mut self, max_body: usize) {
        assert!(MIN_BODY <= max_body && max_body <= MAX_BODY);
        self.max_body = max_body as u8;
        self.missing_due = None;
    }

    /// Says whether another dialect (text) has the board, so that Hello is refused. Do not call it while a host has taken the board.
    pub const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// Call this after something that is no frame was sent. The next frame then begins with a zero, which ends what came before.
    pub const fn interrupted(&mut self) {
        self.new_rate = true;
    }

    /// The time since the session's last frame, ms.
    #[must_use]
    pub const fn silence(&self, now: Millis) -> u16 {
        now.since(self.heard)
    }

    /// Whether the host that has the board was silent for too long, so that [`poll`](Service::poll) will end its session. If a reply is still
    /// waiting for the line, the caller drops it and calls [`interrupted`](Service::interrupted).
    #[must_use]
    pub const fn is_lost(&self, now: Millis) -> bool {
        self.taken && now.since(self.heard) >= self.silence_ms
    }

    /// Answers a frame on a line that is not the session's: refuses Hello, and ignores all else. Writes the answer at the front of `out`, and
    /// returns its length, 0 if there is none.
    pub fn turn_away(received: Received, body: &[u8], out: &mut [u8]) -> usize {
        let (Received::Frame(Tag::NONE), &[seq, kind::HELLO, _, _, _, _, _]) = (received, body) else { return 0 };
        let mut frame = Encoder::new(out);
        refuse(&mut frame, seq, kind::HELLO, Refusal::of(Reason::Taken));
        frame.finish(Tag::NONE).unwrap_or(0)
    }

    /// Whether a host has taken the board. Other dialects on the line are off then.
    #[must_use]
    pub const fn is_taken(&self) -> bool {
        self.taken
    }

    /// The rate of the line.
    #[must_use]
    pub const fn baud(&self) -> Baud {
        self.baud
    }

    /// Executes a frame with this `body`; or notes that damaged bytes came.
    pub fn receive(&mut self, received: Received, body: &[u8], now: Millis, board: &mut impl BoardSide) {
        match (received, body) {
            (Received::Frame(tag), [seq, kind, payload @ ..]) => {
                self.receive_frame(tag, *seq, *kind, payload, now, board)
            }
            (Received::More | Received::Frame(_), _) => {}
            (Received::Damaged, _) => self.damaged(),
        }
    }

    /// Checks the timeouts, and writes the next reply at the front of `out`. Returns its length, 0 if no reply is due.
    ///
    /// Call it again and again, but only after the line has taken all of the reply before. `out` has one byte more than
    /// [`MAX_FRAME`](super::MAX_FRAME), or than this board's longest answer. An answer that does not fit is not sent.
    pub fn poll(&mut self, now: Millis, board: &mut impl BoardSide, out: &mut [u8]) -> usize {
        self.check_timeouts(now, board);
        if !self.new_rate {
            return self.reply(board, out);
        }
        // A zero first: it ends the noise that the host received while the rates were different.
        let Some((first, rest)) = out.split_first_mut() else { return 0 };
        match self.reply(board, rest) {
            0 => 0,
            len => {
                *first = 0;
                self.new_rate = false;
                len + 1
            }
        }
    }

    /// Writes the reply that is due.
    #[inline(never)]
    fn reply(&mut self, board: &mut impl BoardSide, out: &mut [u8]) -> usize {
        let mut frame = Encoder::new(out);
        let mut tag = if self.taken { self.tag } else { Tag::NONE };
        let last = self.expected.wrapping_sub(1);
        if let Some(seq) = self.refusal_due.take() {
            tag = Tag::NONE;
            refuse(&mut frame, seq, kind::HELLO, Refusal::of(Reason::Taken));
        } else if self.answer_due {
            (self.answer_due, self.ack_due) = (false, false);
            let Answer { seq, kind, refused, .. } = self.answer;
            if let Some(refusal) = refused {
                refuse(&mut frame, seq, kind, refusal);
            } else {
                if kind == kind::HELLO {
                    tag = Tag::NONE;
                }
                frame.u8(seq);
                frame.u8(kind | kind::ANSWER);
                self.answer(board, &mut frame);
            }
        } else if let Some(why) = self.missing_due.take() {
            frame.u8(last);
            frame.u8(kind::MISSING);
            frame.u8(why as u8);
            frame.u8(self.accepted);
        } else if self.ack_due {
            self.ack_due = false;
            frame.u8(last);
            frame.u8(kind::POLL | kind::ANSWER);
            frame.u8(board.flags());
            frame.u8(self.accepted);
            free(&mut frame, board);
        // No event is sent around a change of rate, when the host may not receive it.
        } else if self.taken
            && !matches!(self.change, Change::Due(_) | Change::Trial { .. })
            && let Some(event) = board.event()
        {
            self.events = self.events.wrapping_add(1);
            frame.u8(self.events);
            frame.u8(kind::EVENT);
            event.encode(&mut frame);
        }
        // An empty frame: no reply is due.
        frame.finish(tag).unwrap_or(0)
    }

    /// Does what is due with time: changes the rate, ends its trial, gives up a silent host.
    fn check_timeouts(&mut self, now: Millis, board: &mut impl BoardSide) {
        if self.taken && self.answer.kind == kind::BYE && self.answer.refused.is_none() && !self.answer_due {
            // The answer to good-bye is out.
            self.end_session(board, false);
        }
        match self.change {
            // The line has that rate already.
            Change::Due(baud) if baud == self.baud => self.change = Change::None,
            Change::Due(baud) if !self.answer_due => {
                self.set_baud(baud, board);
                self.change = Change::Trial { since: now };
            }
            Change::Trial { since } if now.since(since) >= TRIAL_MS => {
                self.change = Change::FellBack;
                self.set_baud(Baud::B115200, board);
            }
            _ => {}
        }
        if self.is_lost(now) {
            self.end_session(board, true);
        }
    }

    fn set_baud(&mut self, baud: Baud, board: &mut impl BoardSide) {
        if baud != self.baud {
            self.baud = baud;
            self.new_rate = true;
            board.set_baud(baud);
        }
    }

    fn end_session(&mut self, board: &mut impl BoardSide, lost: bool) {
        self.taken = false;
        (self.answer_due, self.ack_due, self.missing_due) = (false, false, None);
        self.change = Change::None;
        self.set_baud(Baud::B115200, board);
        board.host_gone(lost);
    }

    fn receive_frame(&mut self, tag: Tag, seq: u8, kind: u8, payload: &[u8], now: Millis, board: &mut impl BoardSide) {
        if tag == Tag::NONE {
            match (kind, payload) {
                (kind::HELLO, &[version, a, b, c, d]) => {
                    self.hello(seq, version, u32::from_le_bytes([a, b, c, d]), now)
                }
                _ if self.taken => {}
                _ => self.missing_due = Some(Missing::NotTaken),
            }
            return;
        }
        if !self.taken {
            self.missing_due = Some(Missing::NotTaken);
            return;
        }
        if tag != self.tag {
            return;
        }
        self.heard = now;
        match self.change {
            Change::Trial { .. } => self.change = Change::None,
            Change::FellBack => {
                self.change = Change::None;
                board.rate_fell_back();
            }
            Change::None | Change::Due(_) => {}
        }
        match seq.wrapping_sub(self.expected) {
            0 => self.execute_next(seq, kind, payload, board),
            1..=0x7f => self.request_repeat(Missing::Gap),
            _ if seq == self.answer.seq && kind == self.answer.kind => {
                self.answer_due = true;
                self.repeat_rate_change(payload);
            }
            _ => self.ack_due = true,
        }
    }

    fn hello(&mut self, seq: u8, version: u8, nonce: u32, now: Millis) {
        let again = self.taken && nonce == self.nonce;
        if self.held || (self.taken && !again) {
            self.refusal_due = Some(seq);
            return;
        }
        if !again {
            self.nonce = nonce;
            self.taken = version == VERSION;
            if self.taken {
                self.tag = self.tag.next();
            }
            (self.expected, self.accepted) = (seq.wrapping_add(1), seq);
            (self.silence_ms, self.missing_sent, self.ack_due, self.missing_due) = (SILENCE_MS, false, false, None);
        }
        self.heard = now;
        self.answer_to(seq, kind::HELLO, None);
    }

    /// Executes the frame that is next in order.
    #[inline(always)]
    fn execute_next<M: BoardSide>(&mut self, seq: u8, kind: u8, payload: &[u8], board: &mut M) {
        let is_answered;
        let done = if let kind::DATA..kind::EXTEND = kind
            && M::PLANS
        {
            let pushed = match payload {
                [epoch, packed @ ..] if !packed.is_empty() => board.push(kind & 7, Epoch(*epoch), packed),
                _ => Err(Refusal::malformed(kind)),
            };
            if let Err(Refusal { reason: Reason::Full, .. }) = pushed {
                return self.request_repeat(Missing::NoRoom);
            }
            is_answered = pushed.is_err();
            pushed
        } else if kind == kind::POLL && payload.is_empty() {
            is_answered = false;
            Ok(())
        } else {
            let done = self.execute(kind, payload, board);
            is_answered = !(M::PLANS && kind == kind::EXTEND) || done.is_err();
            done
        };
        self.expected = seq.wrapping_add(1);
        self.missing_sent = false;
        self.missing_due = None;
        if is_answered {
            self.answer_to(seq, kind, done.err());
        } else {
            self.ack_due = true;
        }
    }

    #[inline(never)]
    fn answer_to(&mut self, seq: u8, kind: u8, refused: Option<Refusal>) {
        (self.answer.seq, self.answer.kind, self.answer.refused) = (seq, kind, refused);
        self.answer_due = true;
    }

    /// Executes a command. It reads the payload as [`Command::decode`](super::Command::decode) does, but does not build a `Command`, which
    /// would take RAM.
    #[inline(never)]
    fn execute<M: BoardSide>(&mut self, kind: u8, payload: &[u8], board: &mut M) -> Result<(), Refusal> {
        // An image without plans and verbs does not move motors by frames, so it takes no configuration either.
        let drives = M::PLANS || M::OBEYS;
        if drives && kind == kind::CONFIGURE {
            let configuration = Configuration::decode(payload).ok_or(Refusal::malformed(kind))?;
            board.configure(&configuration)?;
            let mut silence_ms = configuration.silence_ms;
            if M::STORES && silence_ms == 0 {
                let mut settings = [0; SETTINGS_LEN];
                board.stored(&mut settings);
                silence_ms = settings::silence_ms(&settings);
            }
            self.silence_ms = if silence_ms == 0 { SILENCE_MS } else { silence_ms };
            return Ok(());
        }
        if M::STORES && kind == kind::STORE {
            let settings = settings::of_payload(payload);
            if settings.is_none() && !payload.is_empty() {
                return Err(Refusal::malformed(kind));
            }
            return board.store(settings);
        }
        if M::OBEYS && kind == kind::ORDERS {
            return board.obey(&Orders::decode(payload).ok_or(Refusal::malformed(kind))?);
        }
        if M::PLANS && matches!(kind, kind::SWITCH | kind::EXTEND | kind::TRIM | kind::BRAKE) {
            return self.obey_plan(kind, payload, board);
        }
        let Some(len) = len_of(kind) else {
            return Err(Refusal { reason: Reason::UnknownKind, detail: u16::from(kind) });
        };
        if payload.len() != usize::from(len) {
            return Err(Refusal::malformed(kind));
        }
        if (!M::PLANS && kind == kind::DISCARD)
            || kind == kind::BRAKE
            || (!drives && matches!(kind, kind::ARM | kind::RELEASE))
        {
            return Err(Refusal { reason: Reason::UnknownKind, detail: u16::from(kind) });
        }
        let first = payload.first().copied().unwrap_or(0);
        match kind {
            kind::ARM if drives => return board.arm(),
            kind::RELEASE if drives => return board.release(),
            kind::DISCARD if M::PLANS => board.discard(Epoch(first)),
            kind::STOP_NOW => {
                let Stopped { tick, uncertain } = board.stop_now();
                (self.answer.tick, self.answer.code) = (tick.to_le_bytes(), uncertain);
            }
            kind::BAUD => {
                let baud = Baud::from_code(first).ok_or(Refusal::malformed(kind))?;
                if !board.can_baud(baud) {
                    return Err(Refusal { reason: Reason::Baud, detail: u16::from(first) });
                }
                self.change = Change::Due(baud);
            }
            // A Hello with a session's tag: no session can begin inside another.
            kind::HELLO => return Err(Refusal::of(Reason::Taken)),
            kind::MEASURES if first > 1 => return Err(Refusal::malformed(kind)),
            kind::MEASURES if first == 1 => {
                self.damaged = 0;
                board.reset_measures();
            }
            // Questions need nothing here: `answer` reads the values. Bye ends the session when its answer is out.
            _ => {}
        }
        Ok(())
    }

    /// Executes a command that changes the plan, and notes its sequence number if it was accepted.
    #[inline(never)]
    fn obey_plan<M: BoardSide>(&mut self, kind: u8, payload: &[u8], board: &mut M) -> Result<(), Refusal> {
        let accepted = board.obey_plan(kind, payload, &mut self.answer.code, &mut self.answer.tick)?;
        if accepted {
            self.accepted = self.expected;
        }
        Ok(())
    }

    /// The last answered frame came again. Only a change of rate is made again, because the host has not changed its own yet.
    #[inline(always)]
    fn repeat_rate_change(&mut self, payload: &[u8]) {
        if let (kind::BAUD, None, [code]) = (self.answer.kind, self.answer.refused, payload)
            && let Some(baud) = Baud::from_code(*code)
        {
            self.change = Change::Due(baud);
        }
    }

    fn damaged(&mut self) {
        self.damaged = self.damaged.saturating_add(1);
        // At a new rate all is noise until the host has changed, too.
        if self.taken && !matches!(self.change, Change::Trial { .. }) {
            self.request_repeat(Missing::Gap);
        }
    }

    fn request_repeat(&mut self, why: Missing) {
        if !self.missing_sent {
            self.missing_sent = true;
            self.missing_due = Some(why);
        }
    }

    /// Writes the answer to the last request. Values that the board can be asked for are read now.
    #[inline(never)]
    fn answer<M: BoardSide>(&self, board: &mut M, frame: &mut Encoder<'_>) {
        let motors = board.motors();
        match self.answer.kind {
            kind::HELLO => {
                let mut info = board.info();
                info.nonce = self.nonce;
                info.tag = if self.taken { self.tag } else { Tag::NONE };
                info.max_body = self.max_body;
                info.encode(frame);
            }
            kind::CONFIGURE => free(frame, board),
            kind::CLOCK => frame.u64(board.clock()),
            kind::STATUS => {
                frame.u64(board.clock());
                frame.u32(Tick32::of(board.horizon()).0);
                frame.u8(board.epoch().0);
                let (state, tick) = board.lease();
                frame.u8(board.flags() | state << 4);
                frame.u8(self.accepted);
                frame.u32(tick);
                for motor in 0..motors {
                    frame.u32(board.position(motor).cast_unsigned());
                    frame.u16(board.free(motor));
                    frame.u8(board.faults(motor));
                }
            }
            kind::SWITCH | kind::TRIM => {
                frame.u8(self.answer.code);
                frame.bytes(&self.answer.tick);
            }
            kind::BRAKE => frame.bytes(&self.answer.tick),
            kind::STOP_NOW => {
                frame.bytes(&self.answer.tick);
                frame.u8(self.answer.code);
                frame.u8(motors);
                for motor in 0..motors {
                    frame.u32(board.position(motor).cast_unsigned());
                }
            }
            kind::MEASURES => {
                let measures = board.measures();
                measures.damaged_frames = self.damaged;
                measures.encode(frame);
            }
            kind::ORDERS if M::OBEYS => board.obeyed(frame),
            kind::STORE if M::STORES => {
                let mut settings = [0; SETTINGS_LEN];
                let is_kept = u8::from(board.stored(&mut settings));
                frame.u8(is_kept | u8::from(board.store_is_damaged()) << 1);
                frame.bytes(&settings);
            }
            _ => {}
        }
    }
}

#[inline(never)]
fn refuse(frame: &mut Encoder<'_>, seq: u8, kind: u8, refusal: Refusal) {
    frame.u8(seq);
    frame.u8(kind::REFUSED);
    frame.u8(kind);
    frame.u8(refusal.reason as u8);
    frame.u16(refusal.detail);
}

#[inline(never)]
fn free(frame: &mut Encoder<'_>, board: &impl BoardSide) {
    let motors = board.motors();
    frame.u8(motors);
    for motor in 0..motors {
        frame.u16(board.free(motor));
    }
}
