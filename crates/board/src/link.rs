//! The host's side of the link, without a line and without a clock: bytes and times come in as arguments, bytes go out.
//!
//! Frames wait in one row, in order of their sequence numbers; those at its front are on their way, as many as the board
//! can hold unread. What the board took leaves the row; what it missed, or did not confirm in time, goes out again
//! from the front on. One command at most waits for its answer; data, extensions of the lease and polls may go along with it.
//!
//! docs/protocol.md has the rules that both ends keep.

use pulsetrain_core::Epoch;
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::message::{Event, Info, MAX_PACKED, Missing, kind, version_of};
use pulsetrain_core::wire::service::TRIAL_MS;
use pulsetrain_core::wire::{Baud, Command, Decoder, Encoder, MAX_FRAME, Reason, Reply, Switched, Trimmed, VERSION};
use std::collections::VecDeque;
use std::time::Duration;

/// Nothing is confirmed sooner, whatever the rate: USB bridges hold bytes back for 1 to 2 ms each way.
const SHORTEST_TIMEOUT: Duration = Duration::from_millis(8);

/// Bits of a byte on the line, at most: start, data and two stop bits.
pub(crate) const BITS: u64 = 11;

/// How often Hello is said until it is answered; a board that was reset needs a second or two.
const HELLO_AGAIN: Duration = Duration::from_millis(200);

/// Without a word from the board for so long although something waits for its answer, it is lost: soon it gives us up.
const LOST: Duration = Duration::from_millis(1900);

/// What a board that is heard does not take, or does not answer, for so long, it never will.
const UNANSWERED: Duration = Duration::from_millis(3800);

/// How long Hello waits for a board.
const NOBODY: Duration = Duration::from_secs(6);

/// How long the board's trial of a rate can last, as the host sees it.
const TRIAL: Duration = Duration::from_millis(TRIAL_MS as u64 + 100);

/// How long the host speaks at one rate while it looks for the board at several.
const HOP: Duration = Duration::from_millis(100);

/// Until Hello is answered.
const FIRST_WINDOW: usize = 64;

/// The line by which text says that the board is another client's: `core::winch`'s, and that of a virtual board's port, which hands no
/// frame on while it serves another.
pub const TAKEN: &[u8] = b"err taken\r\n";

/// Why nothing more can be said to a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// Nobody answered Hello.
    #[error(
        "no board answers; is its firmware Pulsetrain's, is the port the right one, and has no other program the port open?"
    )]
    Nobody,
    /// Another host has the board.
    #[error(
        "another program drives this board; it is free once that says good-bye, or 2 s after it was last heard; or, if that \
         speaks text, after `enable 0`"
    )]
    Taken,
    /// It speaks another version of the protocol.
    #[error(
        "the board's firmware speaks protocol {board}, this program {host}: `pulsetrain flash uno --port PORT`, or `flash pico`, writes the firmware that belongs to it"
    )]
    Version {
        /// The board's.
        board: u8,
        /// Ours.
        host: u8,
    },
    /// It was heard before, and is no more.
    #[error("the board does not answer any more")]
    Lost,
    /// It is heard, but what it was sent or asked for is neither taken nor answered.
    #[error("the board is sending, but has left a question unanswered for {} s", UNANSWERED.as_secs_f64())]
    Unanswered,
    /// It restarted, or gave us up.
    #[error("the board does not know this session any more: it was reset, or heard nothing for too long")]
    Forgotten,
}

/// A frame in the row.
#[derive(Clone, Debug)]
struct Frame {
    seq: u8,
    /// Which motor's queue it fills, and with how many bytes.
    fills: Option<(u8, usize)>,
    bytes: Vec<u8>,
}

/// The command that waits for its answer.
#[derive(Clone, Debug)]
struct Asked {
    seq: u8,
    bytes: Vec<u8>,
    /// When the board confirmed that it received the question. Asking again does not change it.
    taken: Option<Duration>,
    /// When it went out first and last.
    first: Option<Duration>,
    last: Duration,
}

/// An answer, and the time within which the board wrote it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// What it says.
    pub reply: Reply,
    /// When the command was sent first.
    pub asked: Duration,
    /// When the answer had come.
    pub answered: Duration,
}

/// How far a change of rate is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rate {
    Steady,
    /// The command is out.
    Asked {
        baud: Baud,
    },
    /// Both should be at the new rate; the poll that goes out there was not confirmed yet.
    Trying {
        since: Duration,
    },
}

/// The rates that a board may be at, after a change that was not confirmed.
#[derive(Clone, Copy, Debug)]
struct Search {
    rates: [Baud; 3],
    next: usize,
    /// When this rate was taken up.
    since: Duration,
}

/// What came of the link so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames sent, repeats included.
    pub sent: u64,
    /// Frames sent again.
    pub repeated: u64,
    /// Frames that came in.
    pub received: u64,
    /// What came in and was no frame.
    pub damaged: u64,
    /// Frames of other sessions, or that no board writes.
    pub strange: u64,
}

/// The host's side of a link.
#[derive(Clone, Debug)]
pub struct Link {
    decoder: Decoder,
    tag: Tag,
    nonce: u32,
    hello: Option<Duration>,
    /// Hello was refused, or answered by [`TAKEN`].
    occupied: bool,
    /// A board that another has is waited for.
    is_patient: bool,
    /// So many bytes of [`TAKEN`] have just come.
    taken: usize,
    next_seq: u8,
    row: VecDeque<Frame>,
    /// How many at the front of the row are on their way, and how many have ever been.
    sent: usize,
    ever_sent: usize,
    /// Bytes that may be on their way.
    window: usize,
    /// When something was sent or confirmed last.
    progress: Duration,
    /// When something was confirmed last, or began to wait for that.
    moved: Duration,
    timeout: Duration,
    /// When the board was heard last, or was first asked after it had nothing to say.
    heard: Duration,
    asked: Option<Asked>,
    answer: Option<Answer>,
    flags: u8,
    /// Free bytes of each queue after all that was confirmed.
    free: Vec<usize>,
    refused: Option<(Reason, u16)>,
    /// The board's, as far as it is known.
    accepted: u8,
    /// The extensions whose fate is not known, oldest first.
    extending: VecDeque<u8>,
    /// The fate of those before.
    extended: VecDeque<bool>,
    events: VecDeque<Event>,
    info: Option<Info>,
    baud: Baud,
    rate: Rate,
    search: Option<Search>,
    /// To be told to the port.
    new_rate: Option<Baud>,
    error: Option<LinkError>,
    counts: Counts,
}

impl Link {
    /// Nobody is there yet. `nonce` is to be another one for each session.
    #[must_use]
    pub fn new(nonce: u32) -> Link {
        Link {
            decoder: Decoder::new(),
            tag: Tag::NONE,
            nonce,
            hello: None,
            occupied: false,
            is_patient: true,
            taken: 0,
            next_seq: 0,
            row: VecDeque::new(),
            sent: 0,
            ever_sent: 0,
            window: FIRST_WINDOW,
            progress: Duration::ZERO,
            moved: Duration::ZERO,
            timeout: HELLO_AGAIN,
            heard: Duration::ZERO,
            asked: None,
            answer: None,
            flags: 0,
            free: Vec::new(),
            refused: None,
            accepted: 0,
            extending: VecDeque::new(),
            extended: VecDeque::new(),
            events: VecDeque::new(),
            info: None,
            baud: Baud::B115200,
            rate: Rate::Steady,
            search: None,
            new_rate: None,
            error: None,
            counts: Counts::default(),
        }
    }

    /// Says Hello until a board answers with [`Link::info`], or for six seconds.
    pub fn hello(&mut self, now: Duration) {
        self.hello = Some(now);
        self.timeout = HELLO_AGAIN;
        let command = Command::Hello { version: VERSION, nonce: self.nonce };
        self.ask_as(&command, Tag::NONE);
    }

    /// The same, but a board that says that another has it is [`LinkError::Taken`] at once.
    pub fn hello_if_free(&mut self, now: Duration) {
        self.is_patient = false;
        self.hello(now);
    }

    /// Asks for something; the answer comes with [`Link::answer`].
    ///
    /// # Panics
    /// While another command waits for its answer; for another rate, while anything waits.
    pub fn ask(&mut self, command: &Command<'_>, now: Duration) {
        self.begin_to_wait(now);
        if let Command::Baud { baud } = *command {
            assert!(self.is_quiet(), "nothing goes along with a change of rate");
            self.rate = Rate::Asked { baud };
            // If the answer gets lost, the board is there, and then back where both began.
            self.search = Some(Search { rates: [self.baud, baud, Baud::B115200], next: 1, since: now });
        }
        self.ask_as(command, self.tag);
    }

    fn ask_as(&mut self, command: &Command<'_>, tag: Tag) {
        assert!(self.asked.is_none(), "one command at a time");
        self.answer = None;
        let (seq, bytes) = self.frame(command, tag);
        self.asked = Some(Asked { seq, bytes: bytes.clone(), taken: None, first: None, last: Duration::ZERO });
        self.row.push_back(Frame { seq, fills: None, bytes });
    }

    /// Asks again under a new number what the board took, but has not answered: it answers again what it answered last alone, and that is
    /// something else by now.
    fn ask_anew(&mut self, now: Duration) {
        let Some(asked) = &self.asked else { return };
        if self.row.iter().any(|frame| frame.seq == asked.seq) {
            return;
        }
        let mut decoder: Decoder = Decoder::new();
        decoder.feed(&asked.bytes);
        let body = decoder.body().to_vec();
        self.begin_to_wait(now);
        let seq = self.next_number();
        let mut bytes = [0; MAX_FRAME];
        let mut frame = Encoder::new(&mut bytes);
        frame.u8(seq);
        frame.bytes(&body[1..]);
        let len = frame.finish(self.tag).expect("as long as it was");
        let bytes = bytes[..len].to_vec();
        if let Some(asked) = &mut self.asked {
            (asked.seq, asked.bytes) = (seq, bytes.clone());
        }
        self.row.push_back(Frame { seq, fills: None, bytes });
    }

    /// Notes that something waits for the board from now on, if nothing did before.
    fn begin_to_wait(&mut self, now: Duration) {
        if self.row.is_empty() {
            (self.heard, self.moved) = (now, now);
        }
    }

    /// Most packed bytes in one frame to this board.
    #[must_use]
    pub fn max_packed(&self) -> usize {
        self.info.map_or(MAX_PACKED, |info| usize::from(info.max_body) - 3)
    }

    /// Sends packed items to a motor's queue, at least one byte, at most [`Link::max_packed`]. Beyond its [`Link::room`] the
    /// board does not take them, nor what follows, until there is room.
    ///
    /// # Panics
    /// With none or more.
    pub fn send(&mut self, motor: u8, epoch: Epoch, packed: &[u8], now: Duration) {
        assert!((1..=self.max_packed()).contains(&packed.len()), "a frame's worth of bytes");
        self.begin_to_wait(now);
        let (seq, bytes) = self.frame(&Command::Data { motor, epoch, packed }, self.tag);
        self.row.push_back(Frame { seq, fills: Some((motor, packed.len())), bytes });
    }

    /// Sends an extension of the lease, behind all that was sent before; [`Link::extended`] says what became of it. `limits` are those of
    /// [`Command::Extend`].
    ///
    /// # Panics
    /// With limits for more than 8 motors.
    pub fn extend(&mut self, lease: Lease, limits: &[u8], now: Duration) {
        self.begin_to_wait(now);
        if self.next_seq == self.accepted {
            // The board would tell that number if it refused it, too.
            let (seq, bytes) = self.frame(&Command::Poll, self.tag);
            self.row.push_back(Frame { seq, fills: None, bytes });
        }
        let (seq, bytes) = self.frame(&Command::Extend { lease, limits }, self.tag);
        self.row.push_back(Frame { seq, fills: None, bytes });
        self.extending.push_back(seq);
    }

    /// Of how many extensions it is not known what became of them.
    #[must_use]
    pub fn extending(&self) -> usize {
        self.extending.len()
    }

    /// Whether the oldest extension that was not asked for yet was accepted, once it is known; once. One that was refused before another that was
    /// accepted counts as accepted: the other took its place.
    pub fn extended(&mut self) -> Option<bool> {
        self.extended.pop_front()
    }

    /// What becomes of the extensions that are on their way is not to be looked at: something behind them will be accepted, or there is no
    /// lease any more.
    pub fn forget_extensions(&mut self) {
        self.extending.clear();
        self.extended.clear();
    }

    /// Takes back data and extensions that were never sent.
    ///
    /// # Panics
    /// While a command waits for its answer: it may be among them.
    pub fn withdraw(&mut self) {
        assert!(self.asked.is_none(), "a question is not withdrawn");
        for frame in self.row.drain(self.ever_sent..) {
            self.extending.retain(|seq| *seq != frame.seq);
            self.next_seq = self.next_seq.wrapping_sub(1);
        }
    }

    /// So many bytes at the end of a motor's queue were taken back.
    pub fn freed(&mut self, motor: u8, len: usize) {
        if let Some(free) = self.free.get_mut(usize::from(motor)) {
            *free += len;
        }
    }

    /// The board has taken all frames up to `last`, and `accepted` is the one that it accepted last.
    fn judge(&mut self, last: u8, accepted: u8) {
        let unsent = self.row.len() - self.ever_sent;
        let newest = self.next_seq.wrapping_sub(1).wrapping_sub(unsent as u8);
        let is_unsent = |seq: u8| self.row.iter().skip(self.ever_sent).any(|frame| frame.seq == seq);
        // An answer that comes before an extension went out does not tell its fate.
        let Some(oldest) = self.extending.front().copied().filter(|seq| !is_unsent(*seq)) else {
            if last == newest {
                self.accepted = accepted;
            }
            return;
        };
        let since = |number: u8| number.wrapping_sub(oldest);
        // It is older than all extensions.
        if since(last) > since(newest) {
            return;
        }
        self.accepted = accepted;
        let known = self.extending.iter().take_while(|seq| since(**seq) <= since(last)).count();
        let mut known: Vec<u8> = self.extending.drain(..known).collect();
        let taken = known.iter().rposition(|seq| *seq == accepted).map_or(0, |index| index + 1);
        let refused = known.split_off(taken).len();
        self.extended.extend(std::iter::repeat_n(true, taken).chain(std::iter::repeat_n(false, refused)));
    }

    /// How many frames wait to be sent, or to be confirmed.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.row.len()
    }

    /// Asks for news of the queues, unless that is on its way already.
    pub fn poll(&mut self, now: Duration) {
        if self.row.is_empty() {
            self.begin_to_wait(now);
            let (seq, bytes) = self.frame(&Command::Poll, self.tag);
            self.row.push_back(Frame { seq, fills: None, bytes });
        }
    }

    fn frame(&mut self, command: &Command<'_>, tag: Tag) -> (u8, Vec<u8>) {
        let mut bytes = [0; MAX_FRAME];
        let seq = self.next_number();
        let len = command.encode(seq, tag, &mut bytes).expect("a command is within the longest frame");
        (seq, bytes[..len].to_vec())
    }

    const fn next_number(&mut self) -> u8 {
        let seq = self.next_seq;
        self.next_seq = seq.wrapping_add(1);
        seq
    }

    /// The bytes that are to go out now, appended to `out`.
    pub fn output(&mut self, now: Duration, out: &mut Vec<u8>) {
        self.watch(now);
        if self.error.is_some() {
            return;
        }
        if !self.extending.is_empty() && self.asked.is_none() {
            // Its frame was confirmed by an answer that does not tell what was accepted.
            self.poll(now);
        }
        let before = out.len();
        if self.hello.is_some() || self.new_rate.is_some() {
            // Ends whatever the board took for the beginning of a frame.
            out.push(0);
        }
        let nothing = out.len();
        let mut on_the_way: usize = self.row.iter().take(self.sent).map(|frame| frame.bytes.len()).sum();
        if let Some(asked) = &mut self.asked
            && !self.row.iter().any(|frame| frame.seq == asked.seq)
            && now >= asked.last + self.timeout
        {
            // It was taken, but its answer got lost. It counts as part of nobody's window: there is one at most.
            asked.last = now;
            out.extend_from_slice(&asked.bytes);
            self.counts.sent += 1;
            self.counts.repeated += 1;
        }
        while let Some(frame) = self.row.get(self.sent) {
            if self.sent > 0 && on_the_way + frame.bytes.len() > self.window {
                break;
            }
            out.extend_from_slice(&frame.bytes);
            on_the_way += frame.bytes.len();
            self.counts.sent += 1;
            self.counts.repeated += u64::from(self.sent < self.ever_sent);
            self.progress = now;
            if let Some(asked) = self.asked.as_mut().filter(|asked| asked.seq == frame.seq) {
                asked.first = asked.first.or(Some(now));
                asked.last = now;
            }
            self.sent += 1;
            self.ever_sent = self.ever_sent.max(self.sent);
        }
        if out.len() == nothing {
            out.truncate(before);
        }
    }

    /// When [`Link::output`] is to be called at the latest; `None` while nothing waits for the board.
    #[must_use]
    pub fn deadline(&self) -> Option<Duration> {
        if self.error.is_some() {
            return None;
        }
        let confirmed = (self.sent > 0).then(|| self.progress + self.timeout);
        let unsent = (self.sent == 0 && !self.row.is_empty()).then_some(self.progress);
        let answered = self.asked.as_ref().map(|asked| asked.last + self.timeout);
        [confirmed, unsent, answered].into_iter().flatten().min()
    }

    /// What time brings: repeats, rates, losses.
    fn watch(&mut self, now: Duration) {
        let waits = !self.row.is_empty() || self.asked.is_some();
        if self.error.is_some() || !waits {
            return;
        }
        match (self.rate, self.hello) {
            (_, Some(since)) if now >= since + NOBODY => {
                self.error = Some(if self.occupied { LinkError::Taken } else { LinkError::Nobody });
            }
            (_, None) if now >= self.heard + LOST => self.error = Some(LinkError::Lost),
            (_, None) if self.waits_since().is_some_and(|since| now >= since + UNANSWERED) => {
                self.error = Some(LinkError::Unanswered);
            }
            (Rate::Trying { since }, _) if now >= since + TRIAL => {
                // The board went back; or it did hear us, and only its answers got lost.
                self.rate = Rate::Steady;
                self.search = Some(Search { rates: [self.baud, Baud::B115200, Baud::B115200], next: 1, since: now });
                self.hop(now);
            }
            _ => {}
        }
        if self.search.is_some_and(|search| now >= search.since + HOP) {
            self.hop(now);
        }
        if self.sent > 0 && now >= self.progress + self.timeout {
            self.go_back();
            if self.hello.is_none() && self.rate == Rate::Steady && self.search.is_none() {
                // No longer than that: what was lost in a long silence is to be there soon after it.
                self.timeout = 2 * self.shortest_timeout();
            }
        }
    }

    /// Since when the board leaves something waiting: a frame that it does not take, or a command that it does not answer.
    fn waits_since(&self) -> Option<Duration> {
        let untaken = (!self.row.is_empty()).then_some(self.moved);
        // A slow line may need seconds for the data before a question.
        let unanswered = self.asked.as_ref().and_then(|asked| asked.taken);
        [untaken, unanswered].into_iter().flatten().min()
    }

    /// All that was not confirmed goes out again.
    fn go_back(&mut self) {
        self.sent = 0;
    }

    /// Speaks at the next rate that the board may be at.
    fn hop(&mut self, now: Duration) {
        let Some(search) = &mut self.search else { return };
        let baud = search.rates[search.next];
        search.next = (search.next + 1) % search.rates.len();
        search.since = now;
        if baud != self.baud {
            self.set_rate(baud);
            self.go_back();
        }
    }

    fn set_rate(&mut self, baud: Baud) {
        self.baud = baud;
        self.new_rate = Some(baud);
        self.decoder.reset();
        self.timeout = self.shortest_timeout();
    }

    /// The rate that the port is to have from now on, if it is another one: to be asked after [`Link::output`], and to
    /// be set before its bytes go out.
    pub fn take_rate(&mut self) -> Option<Baud> {
        self.new_rate.take()
    }

    /// The time in which something must be confirmed after the last that was sent or confirmed: a frame on its way, its
    /// acknowledgement and another one before that, and a bridge on either side.
    #[must_use]
    pub fn shortest_timeout(&self) -> Duration {
        let bits = BITS * 3 * MAX_FRAME as u64;
        SHORTEST_TIMEOUT + Duration::from_nanos(bits * 1_000_000_000 / u64::from(self.baud.rate()))
    }

    /// Takes bytes that came from the board by `now`.
    pub fn input(&mut self, bytes: &[u8], now: Duration) {
        for byte in bytes {
            if self.hello.is_some() {
                self.hear_text(*byte);
            }
            match self.decoder.push(*byte) {
                Received::More => {}
                Received::Damaged => self.counts.damaged += 1,
                Received::Frame(tag) => {
                    let body = self.decoder.body().to_vec();
                    self.receive(tag, &body, now);
                }
            }
        }
    }

    /// Looks for [`TAKEN`].
    fn hear_text(&mut self, byte: u8) {
        self.taken = if byte == TAKEN[self.taken] { self.taken + 1 } else { usize::from(byte == TAKEN[0]) };
        if self.taken == TAKEN.len() {
            self.taken = 0;
            self.finds_it_taken();
        }
    }

    /// Another has the board. Hello goes on being said, as that one may go, unless there is no time.
    const fn finds_it_taken(&mut self) {
        self.occupied = true;
        if !self.is_patient {
            self.error = Some(LinkError::Taken);
        }
    }

    fn receive(&mut self, tag: Tag, body: &[u8], now: Duration) {
        if let Some(board) = version_of(body).filter(|version| *version != VERSION && self.hello.is_some()) {
            self.error = Some(LinkError::Version { board, host: VERSION });
            return;
        }
        let reply = Reply::decode(body).filter(|(_, reply)| self.is_ours(tag, reply));
        let Some((seq, reply)) = reply else {
            self.counts.strange += 1;
            return;
        };
        self.counts.received += 1;
        self.heard = now;
        if self.rate == Rate::Steady {
            self.search = None;
        } else if let Some(search) = &mut self.search {
            search.since = now;
        }
        match reply {
            Reply::Event(event) => self.events.push_back(event),
            Reply::Missing { why: Missing::NotTaken, .. } => {
                // While Hello is out, that is what it is for; after Bye, as it should be.
                if self.hello.is_none() {
                    self.error = Some(LinkError::Forgotten);
                }
            }
            Reply::Missing { why, accepted } => {
                self.confirm(seq, now);
                self.judge(seq, accepted);
                if why == Missing::Gap {
                    self.go_back();
                } else {
                    self.progress = now;
                }
            }
            Reply::Ack(ack) => {
                let newest = self.row.is_empty() && seq == self.next_seq.wrapping_sub(1);
                if self.confirm(seq, now) || newest {
                    self.set_free(ack.free.as_slice().iter().copied());
                    self.flags = ack.flags;
                }
                self.judge(seq, ack.accepted);
            }
            Reply::Info(info) => {
                if self.hello.take().is_some() {
                    (self.tag, self.window) = (info.tag, usize::from(info.window));
                    self.info = Some(info);
                    self.accepted = seq;
                    self.timeout = self.shortest_timeout();
                }
                self.answered(seq, reply, now);
            }
            _ => self.answered(seq, reply, now),
        }
    }

    /// Whether a frame is of this session, or speaks of its beginning or end.
    fn is_ours(&self, tag: Tag, reply: &Reply) -> bool {
        match reply {
            Reply::Info(info) => tag == Tag::NONE && info.nonce == self.nonce && self.hello.is_some(),
            Reply::Refused { kind: kind::HELLO, .. } => tag == Tag::NONE && self.hello.is_some(),
            Reply::Missing { why: Missing::NotTaken, .. } => tag == Tag::NONE,
            _ => tag == self.tag && self.tag != Tag::NONE,
        }
    }

    /// Everything up to `seq` was taken. `false` if that is old news.
    fn confirm(&mut self, seq: u8, now: Duration) -> bool {
        let Some(first) = self.row.front() else { return false };
        let taken = usize::from(seq.wrapping_sub(first.seq)) + 1;
        if taken > self.ever_sent {
            return false;
        }
        for (motor, len) in self.row.drain(..taken).filter_map(|frame| frame.fills) {
            if let Some(free) = self.free.get_mut(usize::from(motor)) {
                *free = free.saturating_sub(len);
            }
        }
        self.sent = self.sent.saturating_sub(taken);
        self.ever_sent -= taken;
        if let Some(asked) = self.asked.as_mut().filter(|asked| self.row.iter().all(|frame| frame.seq != asked.seq)) {
            asked.taken.get_or_insert(now);
        }
        (self.progress, self.moved) = (now, now);
        self.timeout = self.shortest_timeout();
        if let Rate::Trying { .. } = self.rate {
            // Nothing but the poll was in the row.
            self.rate = Rate::Steady;
        }
        true
    }

    fn answered(&mut self, seq: u8, reply: Reply, now: Duration) {
        if let Reply::Refused { kind: kind::HELLO, .. } = reply {
            self.finds_it_taken();
            return;
        }
        let Some(asked) = self.asked.take_if(|asked| asked.seq == seq) else {
            if let Reply::Refused { kind: kind::DATA.., reason, detail } = reply {
                self.confirm(seq, now);
                self.refused = Some((reason, detail));
                self.ask_anew(now);
            }
            return;
        };
        self.confirm(seq, now);
        match reply {
            Reply::Configured(free) => self.set_free(free.as_slice().iter().copied()),
            Reply::Status(status) => {
                self.set_free(status.motors.as_slice().iter().map(|motor| motor.free));
                self.flags = status.head.flags;
                self.judge(seq, status.head.accepted);
            }
            Reply::Switched(Switched::Accepted)
            | Reply::Trimmed(Trimmed::Accepted)
            | Reply::Braked { tick: Some(_) } => {
                self.accepted = seq;
            }
            _ => {}
        }
        if let Rate::Asked { baud } = self.rate {
            (self.rate, self.search) = (Rate::Steady, None);
            if let Reply::Done { kind: kind::BAUD } = reply {
                self.set_rate(baud);
                self.rate = Rate::Trying { since: now };
                self.poll(now);
            }
        }
        self.answer = Some(Answer { reply, asked: asked.first.unwrap_or(now), answered: now });
    }

    fn set_free(&mut self, free: impl Iterator<Item = u16>) {
        self.free = free.map(usize::from).collect();
    }

    /// The answer to the last command, once.
    pub fn answer(&mut self) -> Option<Answer> {
        self.answer.take()
    }

    /// Whether a command waits for its answer.
    #[must_use]
    pub const fn is_asking(&self) -> bool {
        self.asked.is_some()
    }

    /// Whether nothing waits to be sent or confirmed, and the rate is settled.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.row.is_empty() && self.asked.is_none() && self.rate == Rate::Steady
    }

    /// What the board said to Hello.
    #[must_use]
    pub const fn info(&self) -> Option<&Info> {
        self.info.as_ref()
    }

    /// The rate of the line, as far as this end knows.
    #[must_use]
    pub const fn baud(&self) -> Baud {
        self.baud
    }

    /// Why nothing more can be said.
    #[must_use]
    pub const fn error(&self) -> Option<LinkError> {
        self.error
    }

    /// What the board said unasked, oldest first.
    pub fn event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Why the board refused data, once.
    pub const fn refusal(&mut self) -> Option<(Reason, u16)> {
        self.refused.take()
    }

    /// [`flags`](pulsetrain_core::wire::message::flags) of the board, as it said last.
    #[must_use]
    pub const fn flags(&self) -> u8 {
        self.flags
    }

    /// Bytes that a motor's queue has room for, less those that are on their way; 0 for a motor that is not there.
    #[must_use]
    pub fn room(&self, motor: u8) -> usize {
        let free = self.free.get(usize::from(motor)).copied().unwrap_or(0);
        let fills = self.row.iter().filter_map(|frame| frame.fills).filter(|(to, _)| *to == motor);
        free.saturating_sub(fills.map(|(_, len)| len).sum())
    }

    /// Frames sent, repeated, received, damaged.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.counts
    }
}
