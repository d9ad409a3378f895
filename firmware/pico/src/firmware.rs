//! The board that hosts drive: start-up and the main loop.

use crate::baked::{self, Baked};
use crate::link::{self, Line};
use crate::machine::Board;
use crate::start::Once;
use crate::store::Store;
use crate::talk::{self, Talk};
use crate::usb::{Packet, Usb};
use crate::winch::{Brought, Ear, Winch};
use crate::{clock, flash, regs, reset};
use pulsetrain_core::winch::reply::LineReply;
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::{Baud, Decoder, MAX_BODY, Millis, Service};

/// So many rounds of the main loop may pass in which the host is not heard, as motors need words; 0.2 ms each.
const MOST_DEAF: u32 = 7;

/// How long the main loop sleeps at most, µs: while motors are armed, and else.
const NAP: [u32; 2] = [200, 500];

/// As long as fewer bytes than this wait on the UART, lines wait for room to be answered.
const PATIENCE: usize = 768;

/// If no frame of the session has come for so long, about ms, a line is told that frames have the board.
const SILENCE: u16 = 100;

/// The ways to a host.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Way {
    Uart,
    Usb,
}

impl Way {
    const ALL: [Way; 2] = [Way::Uart, Way::Usb];
}

/// All there is one of.
struct All {
    board: Board,
    service: Service,
    line: Line,
    usb: Usb,
    /// What is heard and said on each of them.
    talks: &'static mut [Talk; 2],
    /// The session's; while there is none, that of the last frame.
    way: Way,
    /// By which motors were told as text last: there is to be room for what they have done.
    teller: Way,
    winch: &'static mut Winch,
    /// The motion in the flash, while it runs.
    baked: Option<Baked>,
}

// The stack has no room for these.
static TALKS: Once<[Talk; 2]> = Once::new([const { Talk::new() }; 2]);
static WINCH: Once<Winch> = Once::new(Winch::new());

/// The whole firmware: what the committed image does.
///
/// # Safety
/// Only once, as what the start-up code calls; never with [`motors`](crate::motors) beside it.
pub unsafe fn run() -> ! {
    clock::set_up();
    clock::take_pins();
    let block = baked::block();
    // SAFETY: the caller's promise.
    let (mut board, line, usb) = unsafe { (Board::begin(), Line::open(), Usb::open(flash::unique_id())) };
    // SAFETY: as above.
    let (talks, winch) = unsafe { (TALKS.take(), WINCH.take()) };
    board.store = Store::read();
    let baked = block.and_then(|block| Baked::begin(&mut board, &block));
    let (way, teller) = (Way::Uart, Way::Uart);
    let mut all = All { board, service: Service::new(MAX_BODY), line, usb, talks, way, teller, winch, baked };
    reset::begin();
    regs::enable_interrupts();
    all.run()
}

impl All {
    fn run(&mut self) -> ! {
        let mut last = Millis(0);
        let mut woken = 0;
        // Text is on from the beginning.
        self.housekeeping(last);
        let mut deaf = 0;
        loop {
            reset::kick_watchdog();
            self.winch.go_on(&mut self.board);
            let fed = self.feed();
            let more = self.board.go_on() || fed;
            let now = self.board.clock.now();
            self.count_round(now - woken);
            woken = now;
            let millis = clock::millis(now);
            self.usb.poll(&mut self.board.clock);
            if self.usb.was_opened() {
                self.greet();
            }
            // Over USB the host waits, and the UART has room for all that may come.
            deaf = if self.board.is_behind() && deaf < MOST_DEAF { deaf + 1 } else { 0 };
            let (heard, spoke) = if deaf == 0 { (self.listen(millis), self.speak(millis)) } else { (false, false) };
            if millis != last {
                last = millis;
                self.set_baud();
                self.housekeeping(millis);
            }
            if !(more || heard || spoke) {
                self.nap();
                woken = self.board.clock.now();
            }
        }
    }

    /// Goes on with the motion in the flash; whether there was something to do.
    #[inline(always)]
    fn feed(&mut self) -> bool {
        let Some(baked) = &mut self.baked else { return false };
        if self.board.looks_baked(baked.is_over()) {
            return baked.go_on(&mut self.board);
        }
        self.baked = None;
        false
    }

    /// Whoever has USB's port open now has said nothing yet, and heard nothing.
    #[inline(never)]
    fn greet(&mut self) {
        let talk = &mut self.talks[Way::Usb as usize];
        talk.hush();
        talk.ear = Ear::new();
        self.service.interrupted();
        if self.winch.is_on() {
            self.say(Way::Usb, &talk::Line::Winch(LineReply::Awake));
        }
    }

    /// What can wait a millisecond.
    #[inline(never)]
    fn housekeeping(&mut self, now: Millis) {
        if self.board.housekeeping(now, &mut self.line) {
            self.talks[Way::Uart as usize].ear.lose();
        }
        // One that has no room yet is told later: it is not taken off before. Nobody waits for a host that does not read.
        let teller = self.teller as usize;
        while let talk = &self.talks[teller]
            && (talk.has_room_for_line() || talk.ear.is_quiet() || talk.is_stuck(now))
            && let Some(done) = self.winch.move_done(&mut self.board)
        {
            self.say_to_text(&talk::Line::Verbs(done));
        }
        if self.winch.look(&mut self.board, &mut self.service) {
            self.say_to_text(&talk::Line::Winch(LineReply::Awake));
        }
        if let Some(uncertain) = self.winch.uncertain() {
            self.say_to_text(&talk::Line::Verbs(uncertain));
        }
        if core::mem::take(&mut self.winch.report) {
            for talk in &mut *self.talks {
                talk.ear.owes_status = true;
            }
        }
    }

    /// Says a line wherever text is spoken.
    fn say_to_text(&mut self, line: &talk::Line) {
        for way in Way::ALL {
            if !self.ear(way).is_quiet() {
                self.say(way, line);
            }
        }
    }

    /// Takes what came on the UART, or else over USB: a packet's length at most; whether there was something. One place for both:
    /// the way into the board is long, and is there once.
    #[inline(never)]
    fn listen(&mut self, now: Millis) -> bool {
        let mut packet = Packet::default();
        let unread = self.line.waiting();
        let (way, mut bytes) = if unread != 0 && !self.waits(Way::Uart, unread, now) {
            (Way::Uart, self.line.read(packet.as_flattened_mut()))
        } else if self.waits(Way::Usb, 0, now) {
            return false;
        } else {
            (Way::Usb, self.usb.read(&mut packet))
        };
        if bytes.is_empty() {
            return false;
        }
        if way == Way::Uart && self.line.take_gap() {
            self.talks[Way::Uart as usize].ear.lose();
        }
        let most = &mut self.board.measures.most_unread;
        *most = (*most).max(unread as u16);
        if way == Way::Usb {
            self.usb.presume_open();
        }
        while let [byte, rest @ ..] = bytes {
            let is_taken = self.service.is_taken();
            let talk = &mut self.talks[way as usize];
            if is_taken && way == self.way && self.service.silence(now) < SILENCE {
                let (taken, received) = feed(&mut talk.decoder, bytes);
                bytes = bytes.get(taken..).unwrap_or_default();
                self.service.receive(received, talk.decoder.body(), now, &mut self.board);
                continue;
            }
            bytes = rest;
            self.text(way, *byte);
            // Frames begin with a zero: before there is one it is all text.
            if self.ear(way).is_quiet() {
                self.frame(way, *byte, now);
            }
        }
        true
    }

    fn ear(&self, way: Way) -> &Ear {
        &self.talks[way as usize].ear
    }

    /// Whether lines wait until there is room for what they would say. If the host does not read, or bytes would be lost, they do
    /// not.
    #[inline(always)]
    fn waits(&self, way: Way, unread: usize, now: Millis) -> bool {
        let talk = &self.talks[way as usize];
        !talk.has_room() && !talk.ear.is_quiet() && !talk.is_stuck(now) && unread < PATIENCE
    }

    /// A byte that may be a frame's, beside text.
    fn frame(&mut self, way: Way, byte: u8, now: Millis) {
        let talk = &mut self.talks[way as usize];
        let received = talk.decoder.push(byte);
        if self.way != way {
            if self.service.is_taken() {
                return talk.turn_away(received);
            }
            if let Received::Frame(_) = received {
                self.way = way;
                self.service.interrupted();
            }
        }
        self.service.receive(received, talk.decoder.body(), now, &mut self.board);
    }

    /// A byte of a line.
    #[inline(never)]
    fn text(&mut self, way: Way, byte: u8) {
        let is_obeyed = self.winch.is_on() && !self.service.is_taken();
        let reply = match self.winch.hear(&mut self.talks[way as usize].ear, byte, is_obeyed) {
            Brought::Nothing => None,
            Brought::Answer(reply) => Some(reply),
            Brought::Told(told) => {
                self.teller = way;
                let reply = self.winch.tell(&mut self.board, &told);
                // A packet has a dozen lines, whose work together is longer than words last.
                self.board.go_on();
                Some(talk::Line::Verbs(reply))
            }
        };
        if is_obeyed {
            self.winch.settle(&mut self.board, &mut self.service);
        }
        if let Some(reply) = reply {
            self.say(way, &reply);
        }
    }

    /// Says a line of text. Nobody hears it while USB's port is closed.
    fn say(&mut self, way: Way, line: &talk::Line) {
        if way == Way::Uart || self.usb.is_open() {
            self.talks[way as usize].say(line);
            self.service.interrupted();
        }
    }

    /// Sends what there is to say, as far as the lines take it; whether there was something.
    #[inline(never)]
    fn speak(&mut self, now: Millis) -> bool {
        let talk = &mut self.talks[self.way as usize];
        if !talk.is_out() && self.service.is_lost(now) {
            // Nobody takes it, and the session ends only when something else can be said.
            talk.hush();
            self.service.interrupted();
        }
        // The change of rate is that of the UART, which is quiet until then.
        if talk.is_out() && !(self.way == Way::Uart && self.board.baud.is_some()) {
            talk.frame(|reply| self.service.poll(now, &mut self.board, reply));
        }
        for way in Way::ALL {
            let talk = &mut self.talks[way as usize];
            if talk.ear.owes_status && talk.is_out() {
                talk.ear.owes_status = false;
                self.report(way);
            }
        }
        let [uart, usb] = &mut *self.talks;
        let to_uart = uart.send(now, |byte| {
            let can_send = link::can_send();
            if can_send {
                link::send(byte);
            }
            can_send
        });
        let to_usb = usb.send(now, |byte| {
            let can_send = self.usb.can_send();
            if can_send {
                self.usb.send(byte);
            }
            can_send
        });
        self.usb.flush(&mut self.board.clock);
        to_uart || to_usb
    }

    /// Says where the axes are, on a way that has text alone.
    #[inline(never)]
    fn report(&mut self, way: Way) {
        if self.winch.is_on() && !self.service.is_taken() && !self.ear(way).is_quiet() {
            let status = self.winch.status(&mut self.board);
            self.say(way, &talk::Line::Winch(status));
        }
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
        let us = if self.board.is_armed() { self.board.spare_us().min(NAP[0]) } else { NAP[1] };
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
