//! The firmware of the Raspberry Pi Pico.
//!
//! # What is here, top down
//! - this file: start-up and the main loop
//! - [`machine`]: what the link asks of a board, done on this one
//! - [`steps`]: from packed bytes to edges on the pins
//! - [`link`], [`usb`]: the serial line, and the serial port over USB; whoever spoke last is answered
//! - [`clock`]: the chip's clocks, and SysTick extended to 64 bits
//! - [`reset`]: the watchdog, and why the program began
//! - [`start`]: vectors, and memory that there is one of
//! - [`regs`]: the registers, and instructions that Rust has no words for
//!
//! # Who makes the edges
//! State machines, which nobody interrupts: each word says how long to wait. The main loop writes words up to 2.4 ms ahead, motor by
//! motor, and does all else in between. One interrupt, of the DMA, hands on what was written: it must come within the eight
//! words of a FIFO. If the main loop is late by 1.8 ms, or the interrupt by eight words, a state machine runs dry, which is
//! seen, and all motors stop at once.
//!
//! # What is not
//! Motion: segments come from the host, as `pulsetrain_core::packing` has them.
#![no_std]
#![no_main]

mod clock;
mod link;
mod machine;
mod regs;
mod reset;
mod start;
mod steps;
mod usb;

use link::Line;
use machine::Board;
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::{Decoder, MAX_BODY, MAX_FRAME, Millis, Service};
use usb::Usb;

/// Bytes that one round of the main loop takes from the line at most.
const BYTES_A_ROUND: usize = 32;

/// How long the main loop sleeps at most, µs: while motors are armed, and else.
const NAP: [u32; 2] = [50, 500];

/// All there is one of.
struct All {
    board: Board,
    service: Service,
    line: Line,
    usb: Usb,
    /// Of line and USB.
    decoders: [Decoder; 2],
    /// The last frame came over USB: there the answers go.
    by_usb: bool,
    reply: Reply,
}

/// A reply on its way to the line.
struct Reply {
    bytes: [u8; MAX_FRAME + 1],
    len: usize,
    sent: usize,
}

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    clock::set_up();
    let blocks = regs::reset::IO_BANK0 | regs::reset::PADS_BANK0 | regs::reset::TIMER;
    regs::take_out_of_reset(blocks);
    // SAFETY: the start-up code calls main once.
    let (board, line) = unsafe { (Board::begin(), Line::open()) };
    let mut all = All {
        board,
        service: Service::new(MAX_BODY),
        line,
        usb: Usb::open(),
        decoders: [Decoder::new(), Decoder::new()],
        by_usb: false,
        reply: Reply { bytes: [0; MAX_FRAME + 1], len: 0, sent: 0 },
    };
    reset::begin();
    regs::enable_interrupts();
    all.run()
}

impl All {
    fn run(&mut self) -> ! {
        let mut last = Millis(0);
        let mut woken = 0;
        loop {
            reset::kick_watchdog();
            let more = self.board.go_on();
            let now = self.board.clock.now();
            self.count_round(now - woken);
            woken = now;
            let millis = millis(now);
            self.usb.poll();
            let heard = self.listen(millis);
            let spoke = self.speak(millis);
            if millis != last {
                last = millis;
                self.board.housekeeping(millis, &mut self.line, self.by_usb);
            }
            if !(more || heard || spoke) {
                self.nap();
                woken = self.board.clock.now();
            }
        }
    }

    /// Takes bytes from the line, or else from USB; whether there were some. One place for both: the way into the board is
    /// long, and is there once.
    #[inline(always)]
    fn listen(&mut self, now: Millis) -> bool {
        let unread = self.line.waiting();
        let usb = unread == 0;
        if usb && self.usb.waiting() == 0 {
            return false;
        }
        let most = &mut self.board.measures.most_unread;
        *most = (*most).max(unread as u16);
        for _ in 0..BYTES_A_ROUND {
            let byte = if usb { self.usb.take() } else { self.line.take() };
            let Some(byte) = byte else { break };
            let received = self.decoders[usize::from(usb)].push(byte);
            self.answer_by(received, usb);
            self.service.receive(received, self.decoders[usize::from(usb)].body(), now, &mut self.board);
        }
        true
    }

    /// A frame says where the answers go; what was under way to the other one is dropped.
    #[inline(always)]
    fn answer_by(&mut self, received: Received, usb: bool) {
        if matches!(received, Received::Frame(_)) && self.by_usb != usb {
            self.by_usb = usb;
            (self.reply.sent, self.reply.len) = (0, 0);
        }
    }

    /// Sends what there is to say, as far as the line takes it; whether there was something.
    #[inline(always)]
    fn speak(&mut self, now: Millis) -> bool {
        let reply = &mut self.reply;
        if reply.sent == reply.len && !self.board.changes_rate() {
            reply.sent = 0;
            reply.len = self.service.poll(now, &mut self.board, &mut reply.bytes);
        }
        let mut spoke = false;
        while let Some(byte) = reply.bytes[..reply.len].get(reply.sent) {
            match self.by_usb {
                true if self.usb.can_send() => self.usb.send(*byte),
                false if link::can_send() => link::send(*byte),
                _ => return spoke,
            }
            reply.sent += 1;
            spoke = true;
        }
        self.usb.flush();
        spoke
    }

    fn count_round(&mut self, ticks: u64) {
        let measures = &mut self.board.measures;
        measures.longest_round_ticks = measures.longest_round_ticks.max(u16::try_from(ticks).unwrap_or(u16::MAX));
        measures.rounds = measures.rounds.wrapping_add(1);
    }

    /// Sleeps until something may be to do.
    fn nap(&mut self) {
        let before = self.board.clock.now();
        let us = if self.board.is_armed() { NAP[0] } else { NAP[1] };
        clock::sleep(us);
        let slept = self.board.clock.now() - before;
        self.board.measures.idle_ticks = self.board.measures.idle_ticks.wrapping_add(slept);
    }
}

/// Ticks / 2^17: 1.049 ms each.
const fn millis(now: u64) -> Millis {
    Millis((now >> 17) as u16)
}
