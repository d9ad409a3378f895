//! The board's side of the link: takes frames, executes them through a [`Machine`], and writes the answers.
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

use super::frame::{Encoder, MAX_BODY, Received, Tag};
use super::limits::{Baud, Millis, VERSION};
use super::machine::Machine;
use super::message::{Configuration, MIN_BODY, kind, len_of};
use super::orders::Orders;
use super::outcome::{Missing, Reason, Refusal, Stopped};
use super::settings::{self, SETTINGS_LEN};
use crate::{Epoch, Tick32};

/// How long a board listens at a new rate before it goes back to 115 200 baud, ms.
pub const TRIAL_MS: u16 = 250;

/// How long a host may be silent unless it says otherwise, ms.
pub const SILENCE_MS: u16 = 2000;

/// The frame that was answered last, or is to be answered: what it takes to give that answer, again if need be.
#[derive(Clone, Copy, Debug)]
struct Answer {
    seq: u8,
    kind: u8,
    /// Why it was not done. Questions are answered with new values whenever they are asked.
    refused: Option<Refusal>,
    /// Of Switch, Trim, Brake and StopNow, with `code`: a tick, and how the switch or the trim went or which motors are uncertain.
    tick: [u8; 8],
    code: u8,
}

/// How far a change of rate is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    None,
    /// To be made when the answer is out.
    Due(Baud),
    /// Made, but nothing was heard yet.
    Trial {
        since: Millis,
    },
    /// Taken back; the host has not been heard since.
    FellBack,
}

/// The board's side of the link. The bytes that come are taken by a [`Decoder`](super::Decoder), or by a board's own
/// reader that does the same, and frames are handed over whole.
#[derive(Clone, Debug)]
pub struct Service {
    /// The newest session's; it is over unless `taken`.
    tag: Tag,
    nonce: u32,
    taken: bool,
    /// The sequence number that is next.
    expected: u8,
    /// That of the last Extend, Switch, Trim or Brake that was accepted, else of Hello.
    accepted: u8,
    answer: Answer,
    answer_due: bool,
    ack_due: bool,
    missing_due: Option<Missing>,
    /// A Missing was sent that says where to go back to, and the host has not gone back yet.
    missing_told: bool,
    /// A Hello that is refused, by its sequence number.
    refusal_due: Option<u8>,
    /// When the host was last heard.
    heard: Millis,
    silence_ms: u16,
    baud: Baud,
    change: Change,
    max_body: u8,
    events: u8,
    damaged: u16,
    /// The line's last byte to the host was no frame's end: nothing was sent at this rate yet, or text was.
    new_rate: bool,
    /// Nobody may take the board.
    held: bool,
}

impl Service {
    /// Nobody has taken the board, which takes bodies of up to `max_body` bytes: of [`MIN_BODY`] to [`MAX_BODY`]. The line is at
    /// 115 200 baud.
    ///
    /// # Panics
    /// With another `max_body`; where it is a constant, that shows when it is built.
    ///
    /// [`MIN_BODY`]: super::MIN_BODY
    /// [`MAX_BODY`]: super::MAX_BODY
    #[must_use]
    pub const fn new(max_body: usize) -> Service {
        let mut service = Service::UNSET;
        service.begin(max_body);
        service
    }

    /// Not begun: zeros, which take no flash. [`begin`](Service::begin) comes before its use.
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
        missing_told: false,
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

    /// Makes an [`UNSET`](Service::UNSET) one what [`new`](Service::new) gives.
    ///
    /// # Panics
    /// As `new`.
    #[expect(clippy::cast_possible_truncation, reason = "below 128")]
    pub const fn begin(&mut self, max_body: usize) {
        assert!(MIN_BODY <= max_body && max_body <= MAX_BODY);
        self.max_body = max_body as u8;
        self.missing_due = None;
    }

    /// Whether another dialect has the board: Hello is refused then. Not while a host has taken it.
    pub const fn hold(&mut self, held: bool) {
        self.held = held;
    }

    /// Something that is no frame was sent: the next frame has a zero before it.
    pub const fn interrupted(&mut self) {
        self.new_rate = true;
    }

    /// How long no frame of the session has come.
    #[must_use]
    pub const fn silence(&self, now: Millis) -> u16 {
        now.since(self.heard)
    }

    /// Whether the host that has the board was silent for too long: [`poll`](Service::poll) ends its session. What is still under
    /// way to it, on a line that does not take it, is to be dropped, and [`interrupted`](Service::interrupted) is to be called.
    #[must_use]
    pub const fn is_lost(&self, now: Millis) -> bool {
        self.taken && now.since(self.heard) >= self.silence_ms
    }

    /// Answers what came on a line that is not the session's: Hello is refused, all else gets no answer. Writes it into the front of `out`, and gives its length, 0 if there is none.
    pub fn turn_away(received: Received, body: &[u8], out: &mut [u8]) -> usize {
        let (Received::Frame(Tag::NONE), &[seq, kind::HELLO, _, _, _, _, _]) = (received, body) else { return 0 };
        let mut frame = Encoder::new(out);
        refuse(&mut frame, seq, kind::HELLO, Refusal::of(Reason::Taken));
        frame.finish(Tag::NONE).unwrap_or(0)
    }

    /// Whether a host has taken the board: other dialects on the line are off then.
    #[must_use]
    pub const fn is_taken(&self) -> bool {
        self.taken
    }

    /// The rate of the line.
    #[must_use]
    pub const fn baud(&self) -> Baud {
        self.baud
    }

    /// Does what the frame asks for whose `body` the line brought; or notes that something came that was none.
    pub fn receive(&mut self, received: Received, body: &[u8], now: Millis, machine: &mut impl Machine) {
        match (received, body) {
            (Received::Frame(tag), [seq, kind, payload @ ..]) => self.frame(tag, *seq, *kind, payload, now, machine),
            (Received::More | Received::Frame(_), _) => {}
            (Received::Damaged, _) => self.damaged(),
        }
    }

    /// Looks at the clock, and writes the reply that is due into the front of `out`; gives its length, 0 if there is none.
    ///
    /// To be called again and again, but only when the reply before has been handed to the line whole. `out` has
    /// room for [`MAX_FRAME`](super::MAX_FRAME) bytes and one more, or as many as the longest answer of this board takes;
    /// one that does not fit is not sent.
    pub fn poll(&mut self, now: Millis, machine: &mut impl Machine, out: &mut [u8]) -> usize {
        self.watch(now, machine);
        if !self.new_rate {
            return self.reply(machine, out);
        }
        // A zero first: it ends what the host took for a frame while the rates were different.
        let Some((first, rest)) = out.split_first_mut() else { return 0 };
        match self.reply(machine, rest) {
            0 => 0,
            len => {
                *first = 0;
                self.new_rate = false;
                len + 1
            }
        }
    }

    /// The reply that is due.
    #[inline(never)]
    fn reply(&mut self, machine: &mut impl Machine, out: &mut [u8]) -> usize {
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
                self.answer(machine, &mut frame);
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
            frame.u8(machine.flags());
            frame.u8(self.accepted);
            free(&mut frame, machine);
        // Around a change of rate the host may not receive it.
        } else if self.taken
            && !matches!(self.change, Change::Due(_) | Change::Trial { .. })
            && let Some(event) = machine.event()
        {
            self.events = self.events.wrapping_add(1);
            frame.u8(self.events);
            frame.u8(kind::EVENT);
            event.encode(&mut frame);
        }
        // An empty frame: no reply is due.
        frame.finish(tag).unwrap_or(0)
    }

    /// What time brings: the new rate, the end of its trial, a host that is lost.
    fn watch(&mut self, now: Millis, machine: &mut impl Machine) {
        if self.taken && self.answer.kind == kind::BYE && self.answer.refused.is_none() && !self.answer_due {
            // The answer to good-bye is out.
            self.leave(machine, false);
        }
        match self.change {
            // Asked for at that very rate: the host is there already.
            Change::Due(baud) if baud == self.baud => self.change = Change::None,
            Change::Due(baud) if !self.answer_due => {
                self.set_baud(baud, machine);
                self.change = Change::Trial { since: now };
            }
            Change::Trial { since } if now.since(since) >= TRIAL_MS => {
                self.change = Change::FellBack;
                self.set_baud(Baud::B115200, machine);
            }
            _ => {}
        }
        if self.is_lost(now) {
            self.leave(machine, true);
        }
    }

    fn set_baud(&mut self, baud: Baud, machine: &mut impl Machine) {
        if baud != self.baud {
            self.baud = baud;
            self.new_rate = true;
            machine.set_baud(baud);
        }
    }

    fn leave(&mut self, machine: &mut impl Machine, lost: bool) {
        self.taken = false;
        (self.answer_due, self.ack_due, self.missing_due) = (false, false, None);
        self.change = Change::None;
        self.set_baud(Baud::B115200, machine);
        machine.host_gone(lost);
    }

    fn frame(&mut self, tag: Tag, seq: u8, kind: u8, payload: &[u8], now: Millis, machine: &mut impl Machine) {
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
                machine.rate_fell_back();
            }
            Change::None | Change::Due(_) => {}
        }
        match seq.wrapping_sub(self.expected) {
            0 => self.take(seq, kind, payload, machine),
            1..=0x7f => self.miss(Missing::Gap),
            _ if seq == self.answer.seq && kind == self.answer.kind => {
                self.answer_due = true;
                self.again(payload);
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
            (self.silence_ms, self.missing_told, self.ack_due, self.missing_due) = (SILENCE_MS, false, false, None);
        }
        self.heard = now;
        self.answer_to(seq, kind::HELLO, None);
    }

    /// The frame that is next.
    #[inline(always)]
    fn take<M: Machine>(&mut self, seq: u8, kind: u8, payload: &[u8], machine: &mut M) {
        let is_answered;
        let done = if let kind::DATA..kind::EXTEND = kind
            && M::PLANS
        {
            let pushed = match payload {
                [epoch, packed @ ..] if !packed.is_empty() => machine.push(kind & 7, Epoch(*epoch), packed),
                _ => Err(Refusal::malformed(kind)),
            };
            if let Err(Refusal { reason: Reason::Full, .. }) = pushed {
                return self.miss(Missing::NoRoom);
            }
            is_answered = pushed.is_err();
            pushed
        } else if kind == kind::POLL && payload.is_empty() {
            is_answered = false;
            Ok(())
        } else {
            let done = self.execute(kind, payload, machine);
            is_answered = !(M::PLANS && kind == kind::EXTEND) || done.is_err();
            done
        };
        self.expected = seq.wrapping_add(1);
        self.missing_told = false;
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

    /// Does what a command asks for: what [`Command::decode`](super::Command::decode) would say of it, but without a detour
    /// through RAM.
    #[inline(never)]
    fn execute<M: Machine>(&mut self, kind: u8, payload: &[u8], machine: &mut M) -> Result<(), Refusal> {
        // An image without plans and orders moves no motor for frames.
        let drives = M::PLANS || M::OBEYS;
        if drives && kind == kind::CONFIGURE {
            let configuration = Configuration::decode(payload).ok_or(Refusal::malformed(kind))?;
            machine.configure(&configuration)?;
            let mut silence_ms = configuration.silence_ms;
            if M::STORES && silence_ms == 0 {
                let mut settings = [0; SETTINGS_LEN];
                machine.stored(&mut settings);
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
            return machine.store(settings);
        }
        if M::OBEYS && kind == kind::ORDERS {
            return machine.obey(&Orders::decode(payload).ok_or(Refusal::malformed(kind))?);
        }
        if M::PLANS && matches!(kind, kind::SWITCH | kind::EXTEND | kind::TRIM | kind::BRAKE) {
            return self.obey_plan(kind, payload, machine);
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
            kind::ARM if drives => return machine.arm(),
            kind::RELEASE if drives => return machine.release(),
            kind::DISCARD if M::PLANS => machine.discard(Epoch(first)),
            kind::STOP_NOW => {
                let Stopped { tick, uncertain } = machine.stop_now();
                (self.answer.tick, self.answer.code) = (tick.to_le_bytes(), uncertain);
            }
            kind::BAUD => {
                let baud = Baud::from_code(first).ok_or(Refusal::malformed(kind))?;
                if !machine.can_baud(baud) {
                    return Err(Refusal { reason: Reason::Baud, detail: u16::from(first) });
                }
                self.change = Change::Due(baud);
            }
            // With a tag: no session begins inside another.
            kind::HELLO => return Err(Refusal::of(Reason::Taken)),
            kind::MEASURES if first > 1 => return Err(Refusal::malformed(kind)),
            kind::MEASURES if first == 1 => {
                self.damaged = 0;
                machine.reset_measures();
            }
            // Questions, answered from what is there; good-bye, which ends the session when its answer is out.
            _ => {}
        }
        Ok(())
    }

    /// What changes plans. The number of what is accepted is the one that is next.
    #[inline(never)]
    fn obey_plan<M: Machine>(&mut self, kind: u8, payload: &[u8], machine: &mut M) -> Result<(), Refusal> {
        let accepted = machine.obey_plan(kind, payload, &mut self.answer.code, &mut self.answer.tick)?;
        if accepted {
            self.accepted = self.expected;
        }
        Ok(())
    }

    /// The frame answered last came again. Only a change of rate is done again: the host has not seen it.
    #[inline(always)]
    fn again(&mut self, payload: &[u8]) {
        if let (kind::BAUD, None, [code]) = (self.answer.kind, self.answer.refused, payload)
            && let Some(baud) = Baud::from_code(*code)
        {
            self.change = Change::Due(baud);
        }
    }

    fn damaged(&mut self) {
        self.damaged = self.damaged.saturating_add(1);
        // At a new rate, all is noise until the host is there too.
        if self.taken && !matches!(self.change, Change::Trial { .. }) {
            self.miss(Missing::Gap);
        }
    }

    fn miss(&mut self, why: Missing) {
        if !self.missing_told {
            self.missing_told = true;
            self.missing_due = Some(why);
        }
    }

    /// The answer to what was asked last. What can be read from the machine is read now.
    #[inline(never)]
    fn answer<M: Machine>(&self, machine: &mut M, frame: &mut Encoder<'_>) {
        let motors = machine.motors();
        match self.answer.kind {
            kind::HELLO => {
                let mut info = machine.info();
                info.nonce = self.nonce;
                info.tag = if self.taken { self.tag } else { Tag::NONE };
                info.max_body = self.max_body;
                info.encode(frame);
            }
            kind::CONFIGURE => free(frame, machine),
            kind::CLOCK => frame.u64(machine.clock()),
            kind::STATUS => {
                frame.u64(machine.clock());
                frame.u32(Tick32::of(machine.horizon()).0);
                frame.u8(machine.epoch().0);
                let (state, tick) = machine.lease();
                frame.u8(machine.flags() | state << 4);
                frame.u8(self.accepted);
                frame.u32(tick);
                for motor in 0..motors {
                    frame.u32(machine.position(motor).cast_unsigned());
                    frame.u16(machine.free(motor));
                    frame.u8(machine.faults(motor));
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
                    frame.u32(machine.position(motor).cast_unsigned());
                }
            }
            kind::MEASURES => {
                let measures = machine.measures();
                measures.damaged_frames = self.damaged;
                measures.encode(frame);
            }
            kind::ORDERS if M::OBEYS => machine.obeyed(frame),
            kind::STORE if M::STORES => {
                let mut settings = [0; SETTINGS_LEN];
                let is_kept = u8::from(machine.stored(&mut settings));
                frame.u8(is_kept | u8::from(machine.store_is_damaged()) << 1);
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
fn free(frame: &mut Encoder<'_>, machine: &impl Machine) {
    let motors = machine.motors();
    frame.u8(motors);
    for motor in 0..motors {
        frame.u16(machine.free(motor));
    }
}
