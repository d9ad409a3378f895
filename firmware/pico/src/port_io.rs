//! The bytes of one port to a host: what is being read, and what waits to be sent.

use crate::winch::TextInput;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::reply::{self, LineReply};
use pulsetrain_core::winch::verb_lines as text;
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::{Decoder, MAX_FRAME, Millis, Service};

/// Bytes that may wait to be sent: one frame, or lines of text.
const REPLY_BYTES: usize = 2048;
const _: () = assert!(REPLY_BYTES > MAX_FRAME);

/// Bytes of the longest line.
const LONGEST_LINE: usize = if reply::LONGEST > text::LONGEST { reply::LONGEST } else { text::LONGEST };

/// Bytes of the replies to one packet of 64 bytes, and of a status line: to 12 `halt`s, or to 32 lines of two bytes (`*` and a
/// line's end).
const PACKET_REPLY_BYTES: usize = 64 / "halt\n".len() * LONGEST_LINE + LONGEST_LINE;
const _: () =
    assert!(PACKET_REPLY_BYTES < REPLY_BYTES && PACKET_REPLY_BYTES > 32 * "err checksum 0\r\n".len() + LONGEST_LINE);

/// A line of text to a host.
pub(crate) enum TextLine {
    Winch(LineReply),
    Verbs(text::VerbReply),
}

/// If no byte could be sent for so long, about ms, the host does not read, and nothing waits for it.
const STUCK_MS: u16 = 20;

/// One port's.
pub(crate) struct PortIo {
    pub(crate) decoder: Decoder,
    pub(crate) text: TextInput,
    reply: [u8; REPLY_BYTES],
    len: usize,
    sent: usize,
    /// When a byte was sent last, or nothing waited.
    last_progress: Millis,
}

impl PortIo {
    /// Nothing was received yet.
    pub(crate) const fn new() -> PortIo {
        PortIo {
            decoder: Decoder::new(),
            text: TextInput::new(),
            reply: [0; REPLY_BYTES],
            len: 0,
            sent: 0,
            last_progress: Millis(0),
        }
    }

    /// Whether nothing waits to be sent.
    #[inline(always)]
    pub(crate) const fn is_out(&self) -> bool {
        self.sent == self.len
    }

    /// Drops what waits to be sent.
    pub(crate) const fn discard_replies(&mut self) {
        (self.len, self.sent) = (0, 0);
    }

    /// Puts a frame in the buffer, which is empty: `write` writes it and returns its length.
    #[inline(always)]
    pub(crate) fn write_frame(&mut self, write: impl FnOnce(&mut [u8]) -> usize) {
        self.sent = 0;
        self.len = write(&mut self.reply);
    }

    /// Answers a frame on a port that is not the session's, unless another answer still waits to be sent.
    #[inline(never)]
    pub(crate) fn turn_away(&mut self, received: Received) {
        if self.is_out() {
            self.sent = 0;
            self.len = Service::turn_away(received, self.decoder.body(), &mut self.reply);
        }
    }

    /// Puts a line of text behind what waits. It is dropped if there is no room.
    #[inline(never)]
    pub(crate) fn push_line(&mut self, line: &TextLine) {
        if REPLY_BYTES - self.len < LONGEST_LINE {
            self.reply.copy_within(self.sent..self.len, 0);
            (self.len, self.sent) = (self.len - self.sent, 0);
        }
        if self.has_room_for_line() {
            let room = &mut self.reply[self.len..];
            self.len += match line {
                TextLine::Winch(reply) => usize::from(reply.write::<InMemory>(room)),
                TextLine::Verbs(reply) => reply.write(room),
            };
        }
    }

    /// Whether there is room for the replies to a packet of lines.
    #[inline(always)]
    pub(crate) const fn has_room(&self) -> bool {
        self.room() >= PACKET_REPLY_BYTES
    }

    /// Whether there is room for a line.
    pub(crate) const fn has_room_for_line(&self) -> bool {
        self.room() >= LONGEST_LINE
    }

    const fn room(&self) -> usize {
        REPLY_BYTES - (self.len - self.sent)
    }

    /// Whether the host does not read.
    pub(crate) const fn is_stuck(&self, now: Millis) -> bool {
        now.since(self.last_progress) >= STUCK_MS
    }

    /// Sends what waits, as long as `send` takes bytes. Whether one was sent.
    #[inline(always)]
    pub(crate) fn send(&mut self, now: Millis, mut send: impl FnMut(u8) -> bool) -> bool {
        let sent = self.sent;
        while let Some(byte) = self.reply[..self.len].get(self.sent)
            && send(*byte)
        {
            self.sent += 1;
        }
        let moved = self.sent != sent;
        if moved || self.is_out() {
            self.last_progress = now;
        }
        moved
    }
}
