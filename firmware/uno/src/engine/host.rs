//! The main loop of a board that has a host: frames and text, answers, and all that is looked after beside the steps.

use crate::ThisProgram;
use crate::engine::link::{self, LONGEST_BODY, Receiver, Unread};
use crate::engine::machine::Board;
use crate::engine::memory::{self, REPLY_LEN, Singleton};
use crate::engine::program::Program;
use crate::engine::steps::refill;
use crate::engine::tuning::host::{BYTES_A_ROUND, POLLS};
use crate::engine::{BOARD, clock, millis, regs, reset};
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::{Millis, Service};

/// A reply on its way to the line.
struct Reply {
    bytes: &'static mut [u8; REPLY_LEN],
    /// Its next byte: of `bytes`, or of the winch's line.
    next: *const u8,
    len: u8,
    sent: u8,
}

static SERVICE: Singleton<Service> = Singleton::new(Service::UNSET);

/// Runs a program that has a host: all that main does.
///
/// # Safety
/// To be called by main, which the start-up code calls once; nobody else takes `program`.
#[inline(always)]
pub(crate) unsafe fn main(program: &'static Singleton<ThisProgram>) -> ! {
    memory::paint_stack();
    // SAFETY: the caller's promise. The references are taken here, not handed over by `begin`, so that the
    // compiler knows the addresses.
    unsafe {
        begin();
        let service = SERVICE.take();
        service.begin(LONGEST_BODY);
        let (receiver, bytes) = memory::take();
        let reply = &mut Reply { bytes, next: core::ptr::null(), len: 0, sent: 0 };
        run(BOARD.take(), service, program.take(), receiver, reply)
    }
}

/// Makes all that there is one of. Apart from main: what it needs of the stack is free again afterwards.
///
/// # Safety
/// To be called first, and once.
#[inline(never)]
unsafe fn begin() {
    // SAFETY: the caller's promise; the references end here.
    let board = unsafe { BOARD.take() };
    board.begin(reset::begin());
    link::start();
}

/// The main loop. What it calls is not inlined: so the deepest call decides how much stack is needed, not their sum.
fn run(
    board: &mut Board,
    service: &mut Service,
    program: &mut ThisProgram,
    receiver: &mut Receiver,
    reply: &mut Reply,
) -> ! {
    let mut last = Millis(0);
    // Something came that was not answered yet.
    let mut due = false;
    // So that text is on before the first byte can have come.
    program.look(board, service, receiver, last);
    // Idle mode: timer and line go on (§10.3).
    regs::SMCR.write(1);
    regs::enable_interrupts();
    loop {
        regs::kick_watchdog();
        let now = clock::moment();
        board.count_round(now);
        let now = millis(now);
        let next = now != last;
        // Once in four is enough, and a motor may need the time; text is said as soon as there is some, at rest each time that Timer0 wakes main
        // up: a millisecond that ended in the round before would be seen a sleep later. Not just when four divides it:
        // rounds may be longer than one.
        let looks = (now.0 ^ last.0) & !3 != 0;
        // Frames and answers take the deepest calls of all; rings last for several of them.
        refill::block_if_shared();
        let heard = listen(board, service, program, receiver, now);
        due |= heard;
        if reply.sent < reply.len {
            reply.go_on();
        } else if (due || looks || ((next || reply.len != 0 || !board.was_busy()) && !service.is_taken()))
            && board.baud.is_none()
        {
            speak(board, service, program, receiver, reply, now);
            due = false;
            if ThisProgram::PLANS {
                // The host waits for it before it streams more. Elsewhere bytes that have come are taken first.
                reply.go_on();
            }
        }
        refill::allow();
        if next {
            last = now;
            if looks {
                board.housekeeping(now, receiver);
                program.look(board, service, receiver, now);
            }
        } else if !heard && reply.sent == reply.len {
            board.rest(receiver);
        }
    }
}

impl Reply {
    /// Sends its next bytes, as long as the line takes one every few polls: at 1 Mbaud all of them. The host waits for it, and a
    /// round of the main loop for each byte would keep it waiting.
    #[inline(always)]
    fn go_on(&mut self) {
        let mut polls = POLLS;
        while self.sent < self.len && polls != 0 {
            polls -= 1;
            if link::can_send() {
                // SAFETY: so many bytes are there, which nobody writes until all are sent.
                link::send(unsafe { self.next.read() });
                self.next = self.next.wrapping_add(1);
                self.sent += 1;
                polls = POLLS;
            }
        }
    }
}

/// Takes bytes from the line, lines or up to the end of a frame; whether it came to one.
#[inline(always)]
fn listen(
    board: &mut Board,
    service: &mut Service,
    program: &mut ThisProgram,
    receiver: &mut Receiver,
    now: Millis,
) -> bool {
    let count = if program.is_on() && !service.is_taken() {
        program.listen(board, receiver)
    } else {
        unread(board, receiver).bytes
    };
    // Before frames are read: the line before a Hello may have been the one that switches the drivers on.
    service.hold(program.drives());
    if count == 0 {
        return false;
    }
    let received = receiver.take(count.min(BYTES_A_ROUND));
    if received == Received::More {
        return false;
    }
    hear(board, service, received, receiver.body(), now);
    true
}

/// What has come, noted.
#[inline(never)]
pub(crate) fn unread(board: &mut Board, receiver: &mut Receiver) -> Unread {
    let unread = receiver.unread();
    board.note(&unread);
    unread
}

/// Does what a frame asks.
#[inline(never)]
fn hear(board: &mut Board, service: &mut Service, received: Received, body: &[u8], now: Millis) {
    service.receive(received, body, now, board);
}

/// Asks the service for a reply, then the program.
#[inline(never)]
fn speak(
    board: &mut Board,
    service: &mut Service,
    program: &mut ThisProgram,
    receiver: &Receiver,
    reply: &mut Reply,
    now: Millis,
) {
    reply.sent = 0;
    // As long as there is text alone, the service has nothing to say.
    reply.len = if program.has_line() { 0 } else { service.poll(now, board, reply.bytes) as u8 };
    reply.next = reply.bytes.as_ptr();
    if reply.len == 0 {
        (reply.next, reply.len) = program.speak(receiver, reply.bytes);
        if reply.len != 0 {
            service.interrupted();
        }
    }
}
