//! The board that hosts drive: start-up and the main loop.

use crate::baked::{self, BakedMotion};
use crate::board::Board;
use crate::port_io::{PortIo, TextLine};
use crate::start::StaticCell;
use crate::store::Store;
use crate::uart::{self, Uart};
use crate::usb::{Packet, Usb};
use crate::winch::{TextEvent, TextInput, Winch};
use crate::{clock, flash, regs, reset};
use pulsetrain_core::winch::reply::LineReply;
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::{Baud, Decoder, MAX_BODY, Millis, Service};

/// Rounds of the main loop in a row that may leave the host's bytes unread, as motors need words. A round takes 0.2 ms then, so
/// that a stop is read after 1.4 ms at most.
const MOST_ROUNDS_UNHEARD: u32 = 7;

/// How long the main loop sleeps at most, µs: while motors are armed, and while they are not.
const LONGEST_NAP_US: [u32; 2] = [200, 500];

/// If so many bytes are unread on the UART, lines are obeyed though there is no room for their replies: its ring must not overflow.
const UNREAD_LIMIT: usize = 768;

/// If no frame of the session has come for so long, about ms, bytes are read as text too: a line gets the answer that frames have
/// the board.
const SESSION_SILENCE_MS: u16 = 100;

/// The ports that a host may be on.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Port {
    Uart,
    Usb,
}

impl Port {
    const ALL: [Port; 2] = [Port::Uart, Port::Usb];
}

/// The board with its service, its ports and its text.
struct Firmware {
    board: Board,
    service: Service,
    uart: Uart,
    usb: Usb,
    /// The bytes of each port, by [`Port`].
    ports: &'static mut [PortIo; 2],
    /// The port of the session; without a session, that of the last frame.
    port: Port,
    /// The port that verbs came from last. Moves that are done are reported when it has room.
    text_port: Port,
    winch: &'static mut Winch,
    /// The motion in the flash, while it runs.
    baked: Option<BakedMotion>,
}

// Statics, as the stack has no room for these.
static PORTS: StaticCell<[PortIo; 2]> = StaticCell::new([const { PortIo::new() }; 2]);
static WINCH: StaticCell<Winch> = StaticCell::new(Winch::new());

/// Runs the whole firmware, as the committed image does.
///
/// # Safety
/// Only once, called by the start-up code, and never in a program that uses [`motors`](crate::motors).
pub unsafe fn run() -> ! {
    clock::set_up();
    clock::take_pins();
    let block = baked::block();
    // SAFETY: the caller's promise.
    let (mut board, uart, usb) = unsafe { (Board::begin(), Uart::open(), Usb::open(flash::unique_id())) };
    // SAFETY: as above.
    let (ports, winch) = unsafe { (PORTS.take(), WINCH.take()) };
    board.hardware.store = Store::read();
    let baked = block.and_then(|block| BakedMotion::begin(&mut board, &block));
    let (port, text_port) = (Port::Uart, Port::Uart);
    let mut firmware =
        Firmware { board, service: Service::new(MAX_BODY), uart, usb, ports, port, text_port, winch, baked };
    reset::start_watchdog();
    regs::enable_interrupts();
    firmware.run()
}

impl Firmware {
    fn run(&mut self) -> ! {
        let mut last = Millis(0);
        let mut woken = 0;
        // Text is on from the beginning.
        self.housekeeping(last);
        let mut unheard = 0;
        loop {
            reset::kick_watchdog();
            self.winch.advance(&mut self.board);
            let fed = self.feed_baked();
            let more = self.board.fill_motors() || fed;
            let now = self.board.now();
            self.count_round(now - woken);
            woken = now;
            let millis = clock::millis(now);
            self.usb.poll(&mut self.board.hardware.clock);
            if self.usb.was_opened() {
                self.greet();
            }
            // Nothing is lost meanwhile: over USB the host waits, and the UART's ring takes all that may come.
            unheard = if self.board.is_behind() && unheard < MOST_ROUNDS_UNHEARD { unheard + 1 } else { 0 };
            let (received, sent) =
                if unheard == 0 { (self.receive(millis), self.send_replies(millis)) } else { (false, false) };
            if millis != last {
                last = millis;
                self.set_baud();
                self.housekeeping(millis);
            }
            if !(more || received || sent) {
                self.nap();
                woken = self.board.now();
            }
        }
    }

    /// Fills queues from the motion in the flash. Whether there was something to do.
    #[inline(always)]
    fn feed_baked(&mut self) -> bool {
        let Some(baked) = &mut self.baked else { return false };
        if self.board.update_baked(baked.is_over()) {
            return baked.feed(&mut self.board);
        }
        self.baked = None;
        false
    }

    /// A program has just opened the USB port: forgets the bytes of the program before, and greets if text is on.
    #[inline(never)]
    fn greet(&mut self) {
        let io = &mut self.ports[Port::Usb as usize];
        io.discard_replies();
        io.text = TextInput::new();
        self.service.interrupted();
        if self.winch.is_on() {
            self.push_line(Port::Usb, &TextLine::Winch(LineReply::Awake));
        }
    }

    /// Does what can wait a millisecond.
    #[inline(never)]
    fn housekeeping(&mut self, now: Millis) {
        if self.board.housekeeping(now, &mut self.uart) {
            self.ports[Port::Uart as usize].text.mark_lost_byte();
        }
        // A done move stays in its queue until there is room to report it; but a host that does not read delays nothing.
        let text_port = self.text_port as usize;
        while let io = &self.ports[text_port]
            && (io.has_room_for_line() || io.text.is_muted() || io.is_stuck(now))
            && let Some(done) = self.winch.move_done(&mut self.board)
        {
            self.push_line_to_text_ports(&TextLine::Verbs(done));
        }
        if self.winch.poll(&mut self.board, &mut self.service) {
            self.push_line_to_text_ports(&TextLine::Winch(LineReply::Awake));
        }
        if let Some(uncertain) = self.winch.uncertain() {
            self.push_line_to_text_ports(&TextLine::Verbs(uncertain));
        }
        if core::mem::take(&mut self.winch.status_due) {
            for io in &mut *self.ports {
                io.text.owes_status = true;
            }
        }
    }

    /// Sends a line on each port where text is spoken.
    fn push_line_to_text_ports(&mut self, line: &TextLine) {
        for port in Port::ALL {
            if !self.text_input(port).is_muted() {
                self.push_line(port, line);
            }
        }
    }

    /// Takes what came on the UART, or else over USB, a packet's length at most. Whether there was something. One function for
    /// both, so that the long code behind it is in the image once.
    #[inline(never)]
    fn receive(&mut self, now: Millis) -> bool {
        let mut packet = Packet::default();
        let unread = self.uart.waiting();
        let (port, mut bytes) = if unread != 0 && !self.must_wait(Port::Uart, unread, now) {
            (Port::Uart, self.uart.read(packet.as_flattened_mut()))
        } else if self.must_wait(Port::Usb, 0, now) {
            return false;
        } else {
            (Port::Usb, self.usb.read(&mut packet))
        };
        if bytes.is_empty() {
            return false;
        }
        if port == Port::Uart && self.uart.take_gap() {
            self.ports[Port::Uart as usize].text.mark_lost_byte();
        }
        let most = &mut self.board.measures.most_unread;
        *most = (*most).max(unread as u16);
        if port == Port::Usb {
            self.usb.presume_open();
        }
        while let [byte, rest @ ..] = bytes {
            let is_taken = self.service.is_taken();
            let io = &mut self.ports[port as usize];
            if is_taken && port == self.port && self.service.silence(now) < SESSION_SILENCE_MS {
                let (taken, received) = feed(&mut io.decoder, bytes);
                bytes = bytes.get(taken..).unwrap_or_default();
                self.service.receive(received, io.decoder.body(), now, &mut self.board.side);
                continue;
            }
            bytes = rest;
            self.receive_text_byte(port, *byte);
            // Frames begin with a zero: before there is one it is all text.
            if self.text_input(port).is_muted() {
                self.receive_frame_byte(port, *byte, now);
            }
        }
        true
    }

    fn text_input(&self, port: Port) -> &TextInput {
        &self.ports[port as usize].text
    }

    /// Whether lines must wait until there is room for their replies. Not if the host does not read, nor if bytes would be lost.
    #[inline(always)]
    fn must_wait(&self, port: Port, unread: usize, now: Millis) -> bool {
        let io = &self.ports[port as usize];
        !io.has_room() && !io.text.is_muted() && !io.is_stuck(now) && unread < UNREAD_LIMIT
    }

    /// Takes a byte that may be of a frame; it was also read as text.
    fn receive_frame_byte(&mut self, port: Port, byte: u8, now: Millis) {
        let io = &mut self.ports[port as usize];
        let received = io.decoder.push(byte);
        if self.port != port {
            if self.service.is_taken() {
                return io.turn_away(received);
            }
            if let Received::Frame(_) = received {
                self.port = port;
                self.service.interrupted();
            }
        }
        self.service.receive(received, io.decoder.body(), now, &mut self.board.side);
    }

    /// Takes a byte of a line of text.
    #[inline(never)]
    fn receive_text_byte(&mut self, port: Port, byte: u8) {
        let is_obeyed = self.winch.is_on() && !self.service.is_taken();
        let reply = match self.winch.receive(&mut self.ports[port as usize].text, byte, is_obeyed) {
            TextEvent::Nothing => None,
            TextEvent::Answer(reply) => Some(reply),
            TextEvent::Orders(orders) => {
                self.text_port = port;
                let reply = self.winch.obey_verbs(&mut self.board, &orders);
                // Words in between: the work of a dozen lines, as a packet may have, takes longer than the words last.
                self.board.fill_motors();
                Some(TextLine::Verbs(reply))
            }
        };
        if is_obeyed {
            self.winch.apply_command(&mut self.board, &mut self.service);
        }
        if let Some(reply) = reply {
            self.push_line(port, &reply);
        }
    }

    /// Sends a line of text. It is dropped while the USB port is closed.
    fn push_line(&mut self, port: Port, line: &TextLine) {
        if port == Port::Uart || self.usb.is_open() {
            self.ports[port as usize].push_line(line);
            self.service.interrupted();
        }
    }

    /// Sends replies, as far as the ports take them. Whether there was something.
    #[inline(never)]
    fn send_replies(&mut self, now: Millis) -> bool {
        let io = &mut self.ports[self.port as usize];
        if !io.is_out() && self.service.is_lost(now) {
            // Nobody reads what waits, and the session can end only when another reply can be sent.
            io.discard_replies();
            self.service.interrupted();
        }
        // Before a change of the UART's rate nothing more is sent on it.
        if io.is_out() && !(self.port == Port::Uart && self.board.hardware.baud.is_some()) {
            io.write_frame(|reply| self.service.poll(now, &mut self.board.side, reply));
        }
        for port in Port::ALL {
            let io = &mut self.ports[port as usize];
            if io.text.owes_status && io.is_out() {
                io.text.owes_status = false;
                self.push_status(port);
            }
        }
        let [uart, usb] = &mut *self.ports;
        let to_uart = uart.send(now, |byte| {
            let can_send = uart::can_send();
            if can_send {
                uart::send(byte);
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
        self.usb.flush(&mut self.board.hardware.clock);
        to_uart || to_usb
    }

    /// Sends a status line, on a port that has only text.
    #[inline(never)]
    fn push_status(&mut self, port: Port) {
        if self.winch.is_on() && !self.service.is_taken() && !self.text_input(port).is_muted() {
            let status = self.winch.status(&mut self.board);
            self.push_line(port, &TextLine::Winch(status));
        }
    }

    /// Changes the rate of the UART once all bytes at the old rate are sent. A session over USB changes none: then the UART waits
    /// at 115 200 baud for the next host.
    fn set_baud(&mut self) {
        if self.board.hardware.baud.is_some() && self.ports[Port::Uart as usize].is_out() && uart::is_out() {
            let asked = self.board.hardware.baud.take().filter(|_| self.port == Port::Uart);
            self.uart.set_baud(asked.unwrap_or(Baud::B115200));
        }
    }

    fn count_round(&mut self, ticks: u64) {
        let measures = &mut self.board.measures;
        measures.longest_round_ticks = measures.longest_round_ticks.max(u16::try_from(ticks).unwrap_or(u16::MAX));
        measures.rounds = measures.rounds.wrapping_add(1);
    }

    /// Sleeps until there may be something to do.
    fn nap(&mut self) {
        let before = self.board.now();
        let us = if self.board.is_armed() { self.board.spare_us().min(LONGEST_NAP_US[0]) } else { LONGEST_NAP_US[1] };
        clock::sleep(us);
        let slept = self.board.now() - before;
        self.board.measures.idle_ticks = self.board.measures.idle_ticks.wrapping_add(slept);
    }
}

/// [`Decoder::feed`], not inlined, so that its loop has all registers.
#[inline(never)]
fn feed(decoder: &mut Decoder, bytes: &[u8]) -> (usize, Received) {
    decoder.feed(bytes)
}
