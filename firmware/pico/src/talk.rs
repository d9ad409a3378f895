//! What is heard and said on a way to a host.

use crate::winch::Ear;
use pulsetrain_core::winch::letters::InMemory;
use pulsetrain_core::winch::reply::{self, LineReply};
use pulsetrain_core::winch::verb_lines as text;
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::{Decoder, MAX_FRAME, Millis, Service};

/// Bytes that may wait to be sent: one frame, or lines.
const ROOM: usize = 2048;
const _: () = assert!(ROOM > MAX_FRAME);

/// The longest line.
const LONGEST: usize = if reply::LONGEST > text::LONGEST { reply::LONGEST } else { text::LONGEST };

/// What the lines of one packet may say at most, and a status: 32 of two bytes (`*` and a line's end), or as many `halt`s.
const PACKET_SAYS: usize = 64 / "halt\n".len() * LONGEST + LONGEST;
const _: () = assert!(PACKET_SAYS < ROOM && PACKET_SAYS > 32 * "err checksum 0\r\n".len() + LONGEST);

/// A line of text to a host.
pub(crate) enum Line {
    Winch(LineReply),
    Verbs(text::VerbReply),
}

/// If no byte has left for so long, about ms, the host does not read: nothing waits for it.
const STUCK: u16 = 20;

/// One way's.
pub(crate) struct Talk {
    pub(crate) decoder: Decoder,
    pub(crate) ear: Ear,
    reply: [u8; ROOM],
    len: usize,
    sent: usize,
    /// When a byte left last, or nothing waited.
    moved: Millis,
}

impl Talk {
    /// Nothing was heard yet.
    pub(crate) const fn new() -> Talk {
        Talk { decoder: Decoder::new(), ear: Ear::new(), reply: [0; ROOM], len: 0, sent: 0, moved: Millis(0) }
    }

    /// Whether all was handed over that was to be said.
    #[inline(always)]
    pub(crate) const fn is_out(&self) -> bool {
        self.sent == self.len
    }

    /// Forgets what was to be said.
    pub(crate) const fn hush(&mut self) {
        (self.len, self.sent) = (0, 0);
    }

    /// Says a frame, which `write` writes and gives the length of; all before is out.
    #[inline(always)]
    pub(crate) fn frame(&mut self, write: impl FnOnce(&mut [u8]) -> usize) {
        self.sent = 0;
        self.len = write(&mut self.reply);
    }

    /// Says on a way that is not the session's what there is to be said there, if nothing else is under way.
    #[inline(never)]
    pub(crate) fn turn_away(&mut self, received: Received) {
        if self.is_out() {
            self.sent = 0;
            self.len = Service::turn_away(received, self.decoder.body(), &mut self.reply);
        }
    }

    /// Says a line of text, behind what waits; one that has no room is dropped.
    #[inline(never)]
    pub(crate) fn say(&mut self, line: &Line) {
        if ROOM - self.len < LONGEST {
            self.reply.copy_within(self.sent..self.len, 0);
            (self.len, self.sent) = (self.len - self.sent, 0);
        }
        if self.has_room_for_line() {
            let room = &mut self.reply[self.len..];
            self.len += match line {
                Line::Winch(reply) => usize::from(reply.write::<InMemory>(room)),
                Line::Verbs(reply) => reply.write(room),
            };
        }
    }

    /// Whether there is room for what a packet of lines may say.
    #[inline(always)]
    pub(crate) const fn has_room(&self) -> bool {
        self.room() >= PACKET_SAYS
    }

    /// Whether there is room for a line.
    pub(crate) const fn has_room_for_line(&self) -> bool {
        self.room() >= LONGEST
    }

    const fn room(&self) -> usize {
        ROOM - (self.len - self.sent)
    }

    /// Whether the host does not read.
    pub(crate) const fn is_stuck(&self, now: Millis) -> bool {
        now.since(self.moved) >= STUCK
    }

    /// Sends what waits, as long as `send` takes a byte; whether one was sent.
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
            self.moved = now;
        }
        moved
    }
}
