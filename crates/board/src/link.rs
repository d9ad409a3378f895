//! The host's side of the link to a board (docs/protocol.md), without a line and without a clock: bytes and times are arguments.
//!
//! Frames wait in one queue, in the order of their sequence numbers. The first of them are on their way, at most as many as the board's receive
//! buffer holds. A frame that the board confirms leaves the queue. When the board reports a gap, or confirms nothing in time, all frames go
//! out again from the first one on. At most one command waits for its answer; data, extensions of the lease and polls may follow it.

use pulsetrain_core::Epoch;
use pulsetrain_core::lease::Lease;
use pulsetrain_core::wire::frame::{Received, Tag};
use pulsetrain_core::wire::message::{Event, Info, MAX_PACKED, Missing, kind, version_of};
use pulsetrain_core::wire::service::TRIAL_MS;
use pulsetrain_core::wire::{Baud, Command, Decoder, Encoder, MAX_FRAME, Reason, Reply, Switched, Trimmed, VERSION};
use std::collections::VecDeque;
use std::time::Duration;

/// The least time in which a confirmation is expected, whatever the rate: a frame of USB to the board, and 5.1 ms back from a 16U2 ([`crate::bridge`]).
const SHORTEST_TIMEOUT: Duration = Duration::from_millis(8);

/// Answers that take longer make the link wait longer, by this much more than the slowest, and up to the most: those of an FTDI take 17 ms.
const MORE_THAN_SLOWEST: Duration = Duration::from_millis(3);
const MOST_SLOWEST: Duration = Duration::from_millis(20);

/// Bits of a byte on the line, at most: start, data and two stop bits.
pub(crate) const BITS: u64 = 11;

/// How often Hello is sent until it is answered. A board that was reset needs a second or two to answer.
const HELLO_EVERY: Duration = Duration::from_millis(200);

/// After this silence, with something unanswered, the board counts as lost. The board ends a silent host's session soon after (2 s by default).
const LONGEST_SILENCE: Duration = Duration::from_millis(1900);

/// After this time a frame that is not confirmed, or a command that is not answered, counts as lost for ever, even if the board sends other
/// frames. Twice the silence that means a lost board.
const LONGEST_WAIT: Duration = Duration::from_millis(3800);

/// How long Hello is sent before the search for a board is given up.
const LONGEST_HELLO: Duration = Duration::from_secs(6);

/// How long the board tries a new rate before it goes back, plus 100 ms for the line.
const TRIAL: Duration = Duration::from_millis(TRIAL_MS as u64 + 100);

/// How long the host tries each rate when it does not know the board's: enough for a poll and its answer.
const TRY_EACH_RATE: Duration = Duration::from_millis(100);

/// Bytes that may be on their way before Info has told the board's own limit. Only Hello is sent by then, and it is shorter.
const FIRST_WINDOW: usize = 64;

/// The line of text that refuses a second client: a board sends it while it obeys text, and the port of a virtual board while it serves another
/// client.
pub const TAKEN: &[u8] = b"err taken\r\n";

/// Why a board cannot be reached any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkError {
    /// No board answered Hello.
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
    /// The board has another version of the protocol.
    #[error(
        "the board's firmware speaks protocol {board}, this program {host}: `pulsetrain flash uno --port PORT`, or `flash pico`, writes the firmware that belongs to it"
    )]
    Version {
        /// The board's version.
        board: u8,
        /// This program's version.
        host: u8,
    },
    /// The board answered before, and is silent now.
    #[error("the board does not answer any more")]
    Lost,
    /// The board sends frames, but does not confirm or answer what it was sent.
    #[error("the board is sending, but has left a question unanswered for {} s", LONGEST_WAIT.as_secs_f64())]
    Unanswered,
    /// The board restarted, or ended the session because it heard nothing from this host.
    #[error("the board does not know this session any more: it was reset, or heard nothing for too long")]
    Forgotten,
}

/// A frame that is not confirmed.
#[derive(Clone, Debug)]
struct Frame {
    seq: u8,
    /// For data: the motor, and how many bytes of its queue they fill.
    fills: Option<(u8, usize)>,
    bytes: Vec<u8>,
}

/// The command that waits for its answer.
#[derive(Clone, Debug)]
struct PendingCommand {
    seq: u8,
    bytes: Vec<u8>,
    /// When the board confirmed that it received the command. Sending it again does not change this.
    taken: Option<Duration>,
    /// When it was sent first; `None` if it was not sent yet.
    first: Option<Duration>,
    /// When it was sent last.
    last: Duration,
}

/// An answer. The board wrote it some time between the two times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// The content of the answer.
    pub reply: Reply,
    /// When the command was sent for the first time.
    pub asked_at: Duration,
    /// When the answer was received.
    pub answered_at: Duration,
}

/// The progress of a change of rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rate {
    /// There is none.
    Steady,
    /// The command for it waits for its answer.
    Asked { baud: Baud },
    /// Both ends should have the new rate, but the poll that was sent at that rate is not confirmed yet.
    Trying { since: Duration },
}

/// The search for a board's rate, after a change that was not confirmed.
#[derive(Clone, Copy, Debug)]
struct Search {
    rates: [Baud; 3],
    next: usize,
    /// Since when the current rate is tried.
    since: Duration,
}

/// Counts of frames since the link began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Frames sent, repeats included.
    pub sent: u64,
    /// Frames sent again.
    pub repeated: u64,
    /// Frames that came in.
    pub received: u64,
    /// Received data that were no valid frame.
    pub damaged: u64,
    /// Received frames of other sessions, or of a kind that no board sends.
    pub strange: u64,
}

/// The host's side of a link.
#[derive(Clone, Debug)]
pub struct Link {
    decoder: Decoder,
    /// The longest time that an answer took, of those to commands that were sent once.
    slowest_answer: Duration,
    tag: Tag,
    nonce: u32,
    hello_since: Option<Duration>,
    /// Whether Hello was refused, or answered by [`TAKEN`].
    occupied: bool,
    /// Whether to wait for a board that another host has.
    is_patient: bool,
    /// How many bytes of [`TAKEN`] have just come, in a row.
    taken: usize,
    next_seq: u8,
    frames: VecDeque<Frame>,
    /// How many frames of the queue, from the first one, are on their way; and how many were sent at least once.
    sent: usize,
    ever_sent: usize,
    /// Most bytes that may be on their way.
    window: usize,
    /// When something was last sent or confirmed.
    last_progress: Duration,
    /// When something was last confirmed, or the first frame began to wait.
    last_confirmed: Duration,
    timeout: Duration,
    /// When the board was heard last, or when the first frame began to wait after a time in which the board had nothing to answer.
    last_heard: Duration,
    pending: Option<PendingCommand>,
    answer: Option<Answer>,
    flags: u8,
    /// Free bytes of each queue after all that was confirmed.
    free: Vec<usize>,
    refused: Option<(Reason, u16)>,
    /// The sequence number of the command that changed the lease last, as the board reported it.
    accepted: u8,
    /// The sequence numbers of the extensions of which it is not known whether the board accepted them, oldest first.
    extending: VecDeque<u8>,
    /// For the extensions before those: whether the board accepted them.
    extended: VecDeque<bool>,
    events: VecDeque<Event>,
    info: Option<Info>,
    baud: Baud,
    rate: Rate,
    search: Option<Search>,
    /// The rate that the port has to be set to.
    new_rate: Option<Baud>,
    error: Option<LinkError>,
    counts: Counts,
}

impl Link {
    /// A link without a board. `nonce` must differ from that of the session before it.
    #[must_use]
    pub fn new(nonce: u32) -> Link {
        Link {
            decoder: Decoder::new(),
            slowest_answer: Duration::ZERO,
            tag: Tag::NONE,
            nonce,
            hello_since: None,
            occupied: false,
            is_patient: true,
            taken: 0,
            next_seq: 0,
            frames: VecDeque::new(),
            sent: 0,
            ever_sent: 0,
            window: FIRST_WINDOW,
            last_progress: Duration::ZERO,
            last_confirmed: Duration::ZERO,
            timeout: HELLO_EVERY,
            last_heard: Duration::ZERO,
            pending: None,
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

    /// Sends Hello until a board answers with [`Link::info`], but not for more than six seconds.
    pub fn hello(&mut self, now: Duration) {
        self.hello_since = Some(now);
        self.timeout = HELLO_EVERY;
        let command = Command::Hello { version: VERSION, nonce: self.nonce };
        self.ask_as(&command, Tag::NONE);
    }

    /// As [`hello`](Link::hello), but does not wait for a board that another host has: [`LinkError::Taken`] comes at its first answer.
    pub fn hello_if_free(&mut self, now: Duration) {
        self.is_patient = false;
        self.hello(now);
    }

    /// Sends a command; [`Link::answer`] gives its answer.
    ///
    /// # Panics
    /// While another command waits for its answer. For a change of rate: while anything waits.
    pub fn ask(&mut self, command: &Command<'_>, now: Duration) {
        self.start_timeouts(now);
        if let Command::Baud { baud } = *command {
            assert!(self.is_quiet(), "nothing goes along with a change of rate");
            self.rate = Rate::Asked { baud };
            // If the answer is lost, the board tries the new rate, and then goes back to the first one.
            self.search = Some(Search { rates: [self.baud, baud, Baud::B115200], next: 1, since: now });
        }
        self.ask_as(command, self.tag);
    }

    fn ask_as(&mut self, command: &Command<'_>, tag: Tag) {
        assert!(self.pending.is_none(), "one command at a time");
        self.answer = None;
        let (seq, bytes) = self.frame(command, tag);
        self.pending =
            Some(PendingCommand { seq, bytes: bytes.clone(), taken: None, first: None, last: Duration::ZERO });
        self.frames.push_back(Frame { seq, fills: None, bytes });
    }

    /// Sends the command again under a new number, if the board has received it but not answered. The board repeats only its last answer, which was
    /// another one meanwhile.
    fn ask_again(&mut self, now: Duration) {
        let Some(pending) = &self.pending else { return };
        if self.frames.iter().any(|frame| frame.seq == pending.seq) {
            return;
        }
        let mut decoder: Decoder = Decoder::new();
        decoder.feed(&pending.bytes);
        let body = decoder.body().to_vec();
        self.start_timeouts(now);
        let seq = self.next_number();
        let mut bytes = [0; MAX_FRAME];
        let mut frame = Encoder::new(&mut bytes);
        frame.u8(seq);
        frame.bytes(&body[1..]);
        let len = frame.finish(self.tag).expect("as long as it was");
        let bytes = bytes[..len].to_vec();
        if let Some(pending) = &mut self.pending {
            (pending.seq, pending.bytes) = (seq, bytes.clone());
        }
        self.frames.push_back(Frame { seq, fills: None, bytes });
    }

    /// Starts the timeouts, if nothing waited for the board before.
    fn start_timeouts(&mut self, now: Duration) {
        if self.frames.is_empty() {
            (self.last_heard, self.last_confirmed) = (now, now);
        }
    }

    /// Most packed bytes that a frame to this board may have.
    #[must_use]
    pub fn max_packed(&self) -> usize {
        self.info.map_or(MAX_PACKED, |info| usize::from(info.max_body) - 3)
    }

    /// Sends packed items to a motor's queue: 1 to [`Link::max_packed`] bytes. If they are more than the queue's [`Link::room`], the board takes neither
    /// them nor anything after them until there is room.
    ///
    /// # Panics
    /// With no bytes, or more than that.
    pub fn send(&mut self, motor: u8, epoch: Epoch, packed: &[u8], now: Duration) {
        assert!((1..=self.max_packed()).contains(&packed.len()), "a frame's worth of bytes");
        self.start_timeouts(now);
        let (seq, bytes) = self.frame(&Command::Data { motor, epoch, packed }, self.tag);
        self.frames.push_back(Frame { seq, fills: Some((motor, packed.len())), bytes });
    }

    /// Sends an extension of the lease, after everything that was sent before; [`Link::extended`] says whether it was accepted. `limits` are as in
    /// [`Command::Extend`].
    ///
    /// # Panics
    /// With limits for more than 8 motors.
    pub fn extend(&mut self, lease: Lease, limits: &[u8], now: Duration) {
        self.start_timeouts(now);
        if self.next_seq == self.accepted {
            // The extension would have the number of the last accepted command: a refusal could not be told from that. A poll uses the number up.
            let (seq, bytes) = self.frame(&Command::Poll, self.tag);
            self.frames.push_back(Frame { seq, fills: None, bytes });
        }
        let (seq, bytes) = self.frame(&Command::Extend { lease, limits }, self.tag);
        self.frames.push_back(Frame { seq, fills: None, bytes });
        self.extending.push_back(seq);
    }

    /// How many extensions have no answer yet.
    #[must_use]
    pub fn extending(&self) -> usize {
        self.extending.len()
    }

    /// Whether the next extension was accepted, in the order in which they were sent, each once; `None` if it is not known yet. An extension that was
    /// refused before another one was accepted counts as accepted, as the later one replaced it.
    pub fn extended(&mut self) -> Option<bool> {
        self.extended.pop_front()
    }

    /// Forgets all extensions without an answer: a command after them decides, or there is no lease any more.
    pub fn forget_extensions(&mut self) {
        self.extending.clear();
        self.extended.clear();
    }

    /// Drops data and extensions that were never sent.
    ///
    /// # Panics
    /// While a command waits for its answer, as it could be among them.
    pub fn withdraw(&mut self) {
        assert!(self.pending.is_none(), "a question is not withdrawn");
        for frame in self.frames.drain(self.ever_sent..) {
            self.extending.retain(|seq| *seq != frame.seq);
            self.next_seq = self.next_seq.wrapping_sub(1);
        }
    }

    /// Notes that the board has removed `len` bytes from the end of a motor's queue.
    pub fn freed(&mut self, motor: u8, len: usize) {
        if let Some(free) = self.free.get_mut(usize::from(motor)) {
            *free += len;
        }
    }

    /// Decides which extensions were accepted. The board has received all frames up to `last`, and `accepted` is the number of the last command that
    /// changed its lease.
    fn decide_extensions(&mut self, last: u8, accepted: u8) {
        let unsent = self.frames.len() - self.ever_sent;
        let newest = self.next_seq.wrapping_sub(1).wrapping_sub(unsent as u8);
        let is_unsent = |seq: u8| self.frames.iter().skip(self.ever_sent).any(|frame| frame.seq == seq);
        // An answer from before an extension was sent says nothing about it.
        let Some(oldest) = self.extending.front().copied().filter(|seq| !is_unsent(*seq)) else {
            if last == newest {
                self.accepted = accepted;
            }
            return;
        };
        let since = |number: u8| number.wrapping_sub(oldest);
        // The answer is older than all extensions.
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

    /// How many frames wait to be sent or confirmed.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames.len()
    }

    /// Sends a poll for the free room in the queues. Does nothing while a frame waits for its confirmation, which reports the room, too.
    pub fn poll(&mut self, now: Duration) {
        if self.frames.is_empty() {
            self.start_timeouts(now);
            let (seq, bytes) = self.frame(&Command::Poll, self.tag);
            self.frames.push_back(Frame { seq, fills: None, bytes });
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

    /// Appends the bytes that have to be sent now to `out`.
    pub fn output(&mut self, now: Duration, out: &mut Vec<u8>) {
        self.check_timeouts(now);
        if self.error.is_some() {
            return;
        }
        if !self.extending.is_empty() && self.pending.is_none() {
            // The extension was confirmed by an answer that does not say whether it was accepted.
            self.poll(now);
        }
        let before = out.len();
        if self.hello_since.is_some() || self.new_rate.is_some() {
            // A zero ends whatever the board may have taken for the beginning of a frame.
            out.push(0);
        }
        let nothing = out.len();
        let mut on_the_way: usize = self.frames.iter().take(self.sent).map(|frame| frame.bytes.len()).sum();
        if let Some(pending) = &mut self.pending
            && !self.frames.iter().any(|frame| frame.seq == pending.seq)
            && now >= pending.last + self.timeout
        {
            // The board received the command, but its answer was lost. There is one such frame at most, so it is not counted in the window.
            pending.last = now;
            out.extend_from_slice(&pending.bytes);
            self.counts.sent += 1;
            self.counts.repeated += 1;
        }
        while let Some(frame) = self.frames.get(self.sent) {
            if self.sent > 0 && on_the_way + frame.bytes.len() > self.window {
                break;
            }
            out.extend_from_slice(&frame.bytes);
            on_the_way += frame.bytes.len();
            self.counts.sent += 1;
            self.counts.repeated += u64::from(self.sent < self.ever_sent);
            self.last_progress = now;
            if let Some(pending) = self.pending.as_mut().filter(|pending| pending.seq == frame.seq) {
                pending.first = pending.first.or(Some(now));
                pending.last = now;
            }
            self.sent += 1;
            self.ever_sent = self.ever_sent.max(self.sent);
        }
        if out.len() == nothing {
            out.truncate(before);
        }
    }

    /// When [`Link::output`] must be called at the latest; `None` while nothing waits for the board.
    #[must_use]
    pub fn deadline(&self) -> Option<Duration> {
        if self.error.is_some() {
            return None;
        }
        let confirmed = (self.sent > 0).then(|| self.last_progress + self.timeout);
        let unsent = (self.sent == 0 && !self.frames.is_empty()).then_some(self.last_progress);
        let answered = self.pending.as_ref().map(|pending| pending.last + self.timeout);
        [confirmed, unsent, answered].into_iter().flatten().min()
    }

    /// Does what is due by `now`: repeats frames, tries another rate, or gives the board up.
    fn check_timeouts(&mut self, now: Duration) {
        let waits = !self.frames.is_empty() || self.pending.is_some();
        if self.error.is_some() || !waits {
            return;
        }
        match (self.rate, self.hello_since) {
            (_, Some(since)) if now >= since + LONGEST_HELLO => {
                self.error = Some(if self.occupied { LinkError::Taken } else { LinkError::Nobody });
            }
            (_, None) if now >= self.last_heard + LONGEST_SILENCE => self.error = Some(LinkError::Lost),
            (_, None) if self.waits_since().is_some_and(|since| now >= since + LONGEST_WAIT) => {
                self.error = Some(LinkError::Unanswered);
            }
            (Rate::Trying { since }, _) if now >= since + TRIAL => {
                // The board went back to its old rate; or it received the poll at the new rate, and only its answer was lost.
                self.rate = Rate::Steady;
                self.search = Some(Search { rates: [self.baud, Baud::B115200, Baud::B115200], next: 1, since: now });
                self.try_next_rate(now);
            }
            _ => {}
        }
        if self.search.is_some_and(|search| now >= search.since + TRY_EACH_RATE) {
            self.try_next_rate(now);
        }
        if self.sent > 0 && now >= self.last_progress + self.timeout {
            self.go_back();
            if self.hello_since.is_none() && self.rate == Rate::Steady && self.search.is_none() {
                // Not longer with each repeat: after a long silence of the line the frames should arrive soon.
                self.timeout = 2 * self.shortest_timeout();
            }
        }
    }

    /// Since when the board has left a frame unconfirmed, or a command that it received unanswered.
    fn waits_since(&self) -> Option<Duration> {
        let untaken = (!self.frames.is_empty()).then_some(self.last_confirmed);
        // Counted from when the board received the command: a slow line may need seconds for the data before it.
        let unanswered = self.pending.as_ref().and_then(|pending| pending.taken);
        [untaken, unanswered].into_iter().flatten().min()
    }

    /// Has everything that was not confirmed sent again.
    fn go_back(&mut self) {
        self.sent = 0;
    }

    /// Tries the next rate that the board may have.
    fn try_next_rate(&mut self, now: Duration) {
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

    /// The rate that the port must be set to, if it changes. To be called after [`Link::output`]; the rate must be set before those bytes are sent.
    pub fn take_rate(&mut self) -> Option<Baud> {
        self.new_rate.take()
    }

    /// How long after the last sent or confirmed frame the next confirmation must come: the time for a frame, its acknowledgement and another one
    /// before that, and for the USB bridge in both directions.
    #[must_use]
    pub fn shortest_timeout(&self) -> Duration {
        let bits = BITS * 3 * MAX_FRAME as u64;
        SHORTEST_TIMEOUT.max(self.slowest_answer + MORE_THAN_SLOWEST)
            + Duration::from_nanos(bits * 1_000_000_000 / u64::from(self.baud.rate()))
    }

    /// Takes bytes that were received from the board by `now`.
    pub fn input(&mut self, bytes: &[u8], now: Duration) {
        for byte in bytes {
            if self.hello_since.is_some() {
                self.match_taken(*byte);
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

    /// Looks for [`TAKEN`] in the received bytes.
    fn match_taken(&mut self, byte: u8) {
        self.taken = if byte == TAKEN[self.taken] { self.taken + 1 } else { usize::from(byte == TAKEN[0]) };
        if self.taken == TAKEN.len() {
            self.taken = 0;
            self.note_taken();
        }
    }

    /// Notes that another host has the board. Hello is sent on, as that host may go, unless this one does not wait.
    const fn note_taken(&mut self) {
        self.occupied = true;
        if !self.is_patient {
            self.error = Some(LinkError::Taken);
        }
    }

    fn receive(&mut self, tag: Tag, body: &[u8], now: Duration) {
        if let Some(board) = version_of(body).filter(|version| *version != VERSION && self.hello_since.is_some()) {
            self.error = Some(LinkError::Version { board, host: VERSION });
            return;
        }
        let reply = Reply::decode(body).filter(|(_, reply)| self.is_ours(tag, reply));
        let Some((seq, reply)) = reply else {
            self.counts.strange += 1;
            return;
        };
        self.counts.received += 1;
        self.last_heard = now;
        if self.rate == Rate::Steady {
            self.search = None;
        } else if let Some(search) = &mut self.search {
            search.since = now;
        }
        match reply {
            Reply::Event(event) => self.events.push_back(event),
            Reply::Missing { why: Missing::NotTaken, .. } => {
                // Before a session this is expected, as Hello opens one; after Bye, too.
                if self.hello_since.is_none() {
                    self.error = Some(LinkError::Forgotten);
                }
            }
            Reply::Missing { why, accepted } => {
                self.confirm(seq, now);
                self.decide_extensions(seq, accepted);
                if why == Missing::Gap {
                    self.go_back();
                } else {
                    self.last_progress = now;
                }
            }
            Reply::Ack(ack) => {
                let newest = self.frames.is_empty() && seq == self.next_seq.wrapping_sub(1);
                if self.confirm(seq, now) || newest {
                    self.set_free(ack.free.as_slice().iter().copied());
                    self.flags = ack.flags;
                }
                self.decide_extensions(seq, ack.accepted);
            }
            Reply::Info(info) => {
                if self.hello_since.take().is_some() {
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

    /// Whether a frame belongs to this session, or to its beginning or end.
    fn is_ours(&self, tag: Tag, reply: &Reply) -> bool {
        match reply {
            Reply::Info(info) => tag == Tag::NONE && info.nonce == self.nonce && self.hello_since.is_some(),
            Reply::Refused { kind: kind::HELLO, .. } => tag == Tag::NONE && self.hello_since.is_some(),
            Reply::Missing { why: Missing::NotTaken, .. } => tag == Tag::NONE,
            _ => tag == self.tag && self.tag != Tag::NONE,
        }
    }

    /// Notes that the board has received all frames up to `seq`. Returns false if that was known.
    fn confirm(&mut self, seq: u8, now: Duration) -> bool {
        let Some(first) = self.frames.front() else { return false };
        let taken = usize::from(seq.wrapping_sub(first.seq)) + 1;
        if taken > self.ever_sent {
            return false;
        }
        for (motor, len) in self.frames.drain(..taken).filter_map(|frame| frame.fills) {
            if let Some(free) = self.free.get_mut(usize::from(motor)) {
                *free = free.saturating_sub(len);
            }
        }
        self.sent = self.sent.saturating_sub(taken);
        self.ever_sent -= taken;
        if let Some(pending) =
            self.pending.as_mut().filter(|pending| self.frames.iter().all(|frame| frame.seq != pending.seq))
        {
            pending.taken.get_or_insert(now);
        }
        (self.last_progress, self.last_confirmed) = (now, now);
        self.timeout = self.shortest_timeout();
        if let Rate::Trying { .. } = self.rate {
            // The only frame that waited was the poll.
            self.rate = Rate::Steady;
        }
        true
    }

    fn answered(&mut self, seq: u8, reply: Reply, now: Duration) {
        if let Reply::Refused { kind: kind::HELLO, .. } = reply {
            self.note_taken();
            return;
        }
        let Some(pending) = self.pending.take_if(|pending| pending.seq == seq) else {
            if let Reply::Refused { kind: kind::DATA.., reason, detail } = reply {
                self.confirm(seq, now);
                self.refused = Some((reason, detail));
                self.ask_again(now);
            }
            return;
        };
        if let Some(asked) = pending.first.filter(|first| *first == pending.last) {
            self.slowest_answer = self.slowest_answer.max((now - asked).min(MOST_SLOWEST));
        }
        self.confirm(seq, now);
        match reply {
            Reply::Configured(free) => self.set_free(free.as_slice().iter().copied()),
            Reply::Status(status) => {
                self.set_free(status.motors.as_slice().iter().map(|motor| motor.free));
                self.flags = status.head.flags;
                self.decide_extensions(seq, status.head.accepted);
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
        self.answer = Some(Answer { reply, asked_at: pending.first.unwrap_or(now), answered_at: now });
    }

    fn set_free(&mut self, free: impl Iterator<Item = u16>) {
        self.free = free.map(usize::from).collect();
    }

    /// The answer to the last command; each answer is given once.
    pub fn answer(&mut self) -> Option<Answer> {
        self.answer.take()
    }

    /// Whether a command waits for its answer.
    #[must_use]
    pub const fn is_asking(&self) -> bool {
        self.pending.is_some()
    }

    /// Whether nothing waits to be sent or confirmed, and the rate is settled.
    #[must_use]
    pub fn is_quiet(&self) -> bool {
        self.frames.is_empty() && self.pending.is_none() && self.rate == Rate::Steady
    }

    /// The board's answer to Hello; `None` if it has not come yet.
    #[must_use]
    pub const fn info(&self) -> Option<&Info> {
        self.info.as_ref()
    }

    /// The rate of the line at this end.
    #[must_use]
    pub const fn baud(&self) -> Baud {
        self.baud
    }

    /// Why the board cannot be reached any more; `None` while it can.
    #[must_use]
    pub const fn error(&self) -> Option<LinkError> {
        self.error
    }

    /// The next event that the board has reported, oldest first.
    pub fn event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Why the board refused data: reason and detail. Each refusal is given once.
    pub const fn refusal(&mut self) -> Option<(Reason, u16)> {
        self.refused.take()
    }

    /// The board's [`flags`](pulsetrain_core::wire::message::flags), as it reported them last.
    #[must_use]
    pub const fn flags(&self) -> u8 {
        self.flags
    }

    /// Bytes that a motor's queue has room for, without those on their way to it; 0 for a motor that is not there.
    #[must_use]
    pub fn room(&self, motor: u8) -> usize {
        let free = self.free.get(usize::from(motor)).copied().unwrap_or(0);
        let fills = self.frames.iter().filter_map(|frame| frame.fills).filter(|(to, _)| *to == motor);
        free.saturating_sub(fills.map(|(_, len)| len).sum())
    }

    /// Counts of frames: sent, repeated, received, damaged.
    #[must_use]
    pub const fn counts(&self) -> Counts {
        self.counts
    }
}
