//! The firmware of the Raspberry Pi Pico.
//!
//! # What is here, top down
//! - this file: start-up and the main loop
//! - [`machine`]: what the link asks of a board, done on this one
//! - [`steps`]: from packed bytes to edges on the pins
//! - [`link`], [`usb`]: the serial line, and the serial port over USB: one session, on whichever of them it was begun
//! - [`clock`]: the chip's clocks, and SysTick extended to 64 bits
//! - [`reset`]: the watchdog, and why the program began
//! - [`start`]: vectors, and memory that there is one of
//! - [`regs`]: the registers, and instructions that Rust has no words for
//!
//! # Who makes the edges
//! State machines, which nobody interrupts: each word says how long to wait. The main loop writes words up to 2.4 ms ahead, motor by
//! motor, and does all else in between. One interrupt, of the DMA, hands on what was written: it must come within the eight
//! words of a FIFO. If the main loop is late by 1.8 ms, or the interrupt by eight words, a state machine runs dry: it gets
//! nothing more, and all motors stop as soon as the main loop sees it.
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
use pulsetrain_core::wire::{Baud, Decoder, MAX_BODY, MAX_FRAME, Millis, Service};
use usb::{Packet, Usb};

/// So many rounds of the main loop may pass in which the host is not heard, as motors need words; 0.2 ms each.
const MOST_DEAF: u32 = 7;

/// How long the main loop sleeps at most, µs: while motors are armed, and else.
const NAP: [u32; 2] = [200, 500];

/// How long at least, µs: an alarm that the timer has passed when it is set would come an hour later.
const SHORTEST_NAP: u32 = 10;

/// The ways to a host.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Uart,
    Usb,
}

/// All there is one of.
struct All {
    board: Board,
    service: Service,
    line: Line,
    usb: Usb,
    /// What is heard and said on each of them.
    talks: [Talk; 2],
    /// The session's; while there is none, that of the last frame.
    way: Way,
}

/// What is heard and said on a way.
struct Talk {
    decoder: Decoder,
    reply: [u8; MAX_FRAME + 1],
    len: usize,
    sent: usize,
}

impl Talk {
    const NONE: Talk = Talk { decoder: Decoder::new(), reply: [0; MAX_FRAME + 1], len: 0, sent: 0 };

    /// Whether all was handed over that was to be said.
    #[inline(always)]
    const fn is_out(&self) -> bool {
        self.sent == self.len
    }

    /// What was written into `reply` is to be said next.
    #[inline(always)]
    const fn begin(&mut self, len: usize) {
        (self.len, self.sent) = (len, 0);
    }
}

#[unsafe(no_mangle)]
extern "C" fn main() -> ! {
    clock::set_up();
    let blocks = regs::reset::IO_BANK0 | regs::reset::PADS_BANK0 | regs::reset::TIMER;
    regs::take_out_of_reset(blocks);
    // SAFETY: the start-up code calls main once.
    let (board, line) = unsafe { (Board::begin(), Line::open()) };
    let mut all =
        All { board, service: Service::new(MAX_BODY), line, usb: Usb::open(), talks: [Talk::NONE; 2], way: Way::Uart };
    reset::begin();
    regs::enable_interrupts();
    all.run()
}

impl All {
    fn run(&mut self) -> ! {
        let mut last = Millis(0);
        let mut woken = 0;
        let mut deaf = 0;
        loop {
            reset::kick_watchdog();
            let more = self.board.go_on();
            let now = self.board.clock.now();
            self.count_round(now - woken);
            woken = now;
            let millis = clock::millis(now);
            self.usb.poll();
            // Over USB the host waits, and the UART has room for all that may come.
            deaf = if self.board.is_behind() && deaf < MOST_DEAF { deaf + 1 } else { 0 };
            let (heard, spoke) = if deaf == 0 { (self.listen(millis), self.speak(millis)) } else { (false, false) };
            if millis != last {
                last = millis;
                self.set_baud();
                self.board.housekeeping(millis, &self.line);
            }
            if !(more || heard || spoke) {
                self.nap();
                woken = self.board.clock.now();
            }
        }
    }

    /// Takes what came on the line, or else over USB: a packet's length at most; whether there was something. One place for both:
    /// the way into the board is long, and is there once.
    #[inline(never)]
    fn listen(&mut self, now: Millis) -> bool {
        let mut packet = Packet::default();
        let unread = self.line.waiting();
        let (way, mut bytes) = match unread {
            0 => (Way::Usb, self.usb.read(&mut packet)),
            _ => (Way::Uart, self.line.read(packet.as_flattened_mut())),
        };
        if bytes.is_empty() {
            return false;
        }
        let most = &mut self.board.measures.most_unread;
        *most = (*most).max(unread as u16);
        while !bytes.is_empty() {
            let talk = &mut self.talks[way as usize];
            let (taken, received) = feed(&mut talk.decoder, bytes);
            bytes = bytes.get(taken..).unwrap_or_default();
            if way != self.way && self.service.is_taken() {
                turn_away(talk, received);
                continue;
            }
            if let Received::Frame(_) = received {
                self.way = way;
            }
            self.service.receive(received, talk.decoder.body(), now, &mut self.board);
        }
        true
    }

    /// Sends what there is to say, as far as the lines take it; whether there was something.
    #[inline(never)]
    fn speak(&mut self, now: Millis) -> bool {
        let talk = &mut self.talks[self.way as usize];
        if !talk.is_out() && self.service.is_lost(now) {
            // Nobody takes it, and the session ends only when something else can be said.
            talk.begin(0);
            self.service.interrupted();
        }
        // The change of rate is that of the UART, which is quiet until then.
        if talk.is_out() && !(self.way == Way::Uart && self.board.baud.is_some()) {
            let len = self.service.poll(now, &mut self.board, &mut talk.reply);
            talk.begin(len);
        }
        let mut spoke = false;
        let [uart, usb] = &mut self.talks;
        while let Some(byte) = uart.reply[..uart.len].get(uart.sent)
            && link::can_send()
        {
            link::send(*byte);
            uart.sent += 1;
            spoke = true;
        }
        while let Some(byte) = usb.reply[..usb.len].get(usb.sent)
            && self.usb.can_send()
        {
            self.usb.send(*byte);
            usb.sent += 1;
            spoke = true;
        }
        self.usb.flush();
        spoke
    }

    /// Changes the rate of the UART when all is out that was said at the old one. A session over USB changes none: there the
    /// UART waits at 115 200 baud for the next host.
    fn set_baud(&mut self) {
        if self.board.baud.is_some() && self.talks[Way::Uart as usize].is_out() && link::is_out() {
            let asked = self.board.baud.take().filter(|_| self.way == Way::Uart);
            self.line.set_baud(asked.unwrap_or(Baud::B115200));
        }
    }

    fn count_round(&mut self, ticks: u64) {
        let measures = &mut self.board.measures;
        measures.longest_round_ticks = measures.longest_round_ticks.max(u16::try_from(ticks).unwrap_or(u16::MAX));
        measures.rounds = measures.rounds.wrapping_add(1);
    }

    /// Sleeps until something may be to do.
    fn nap(&mut self) {
        let before = self.board.clock.now();
        let us = if self.board.is_armed() { self.board.spare_us().clamp(SHORTEST_NAP, NAP[0]) } else { NAP[1] };
        clock::sleep(us);
        let slept = self.board.clock.now() - before;
        self.board.measures.idle_ticks = self.board.measures.idle_ticks.wrapping_add(slept);
    }
}

/// As [`Decoder::feed`]: a call, so that it has the registers to itself.
#[inline(never)]
fn feed(decoder: &mut Decoder, bytes: &[u8]) -> (usize, Received) {
    decoder.feed(bytes)
}

/// Says on a way that is not the session's what there is to be said there, if nothing else is under way.
#[inline(never)]
fn turn_away(talk: &mut Talk, received: Received) {
    if talk.is_out() {
        let len = Service::turn_away(received, talk.decoder.body(), &mut talk.reply);
        talk.begin(len);
    }
}
