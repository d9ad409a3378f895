//! The main loop of a board that has a host: it reads frames and text, replies, and supervises the motors.

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

/// A reply that is being sent.
struct Reply {
    bytes: &'static mut [u8; REPLY_LEN],
    /// Its next byte: in `bytes`, or in the winch's line.
    next: *const u8,
    len: u8,
    sent: u8,
}

static SERVICE: Singleton<Service> = Singleton::new(Service::UNSET);

/// The whole program, if it has a host.
///
/// # Safety
/// To be called by main, which the start-up code calls once; nobody else takes `program`.
#[inline(always)]
pub(crate) unsafe fn main(program: &'static Singleton<ThisProgram>) -> ! {
    memory::paint_stack();
    // SAFETY: the caller's promise. The references are taken here and not returned by `begin`, so that the compiler knows the addresses.
    unsafe {
        begin();
        let service = SERVICE.take();
        service.begin(LONGEST_BODY);
        let (receiver, bytes) = memory::take();
        let reply = &mut Reply { bytes, next: core::ptr::null(), len: 0, sent: 0 };
        run(BOARD.take(), service, program.take(), receiver, reply)
    }
}

/// Initialises what there is one of. Not inlined into main, so that its stack is free again afterwards.
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

/// The main loop. What it calls is not inlined, so that the deepest call decides how much stack is needed, not the sum of all.
fn run(
    board: &mut Board,
    service: &mut Service,
    program: &mut ThisProgram,
    receiver: &mut Receiver,
    reply: &mut Reply,
) -> ! {
    let mut last = Millis(0);
    // A frame was read and is not answered yet.
    let mut due = false;
    // Text must be on before the first byte can come.
    program.look(board, service, receiver, last);
    // Idle mode: timers and line keep running (§10.3).
    regs::SMCR.write(1);
    regs::enable_interrupts();
    loop {
        regs::kick_watchdog();
        let now = clock::moment();
        board.count_round(now);
        let now = millis(now);
        let next = now != last;
        // The service is asked every fourth millisecond: that is enough, and motors may need the time. At rest it is asked each time that Timer0 wakes
        // main up, so that text is sent at once. Compare all bits above the lowest two: a round may last longer than a millisecond.
        let looks = (now.0 ^ last.0) & !3 != 0;
        // Reading and answering frames takes the deepest calls of all. Rings last for several of them.
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
                // The host waits for the reply before it streams more. Other programs take the bytes that have come first.
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
    /// Sends as many of its bytes as the line takes without much waiting: at 1 Mbaud all of them. One byte in each round of the main loop would keep the
    /// host waiting.
    #[inline(always)]
    fn go_on(&mut self) {
        let mut polls = POLLS;
        while self.sent < self.len && polls != 0 {
            polls -= 1;
            if link::can_send() {
                // SAFETY: `len` bytes are there, and nobody writes them until all are sent.
                link::send(unsafe { self.next.read() });
                self.next = self.next.wrapping_add(1);
                self.sent += 1;
                polls = POLLS;
            }
        }
    }
}

/// Reads lines, or bytes up to the end of a frame. `true` if a frame has ended.
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
    // Before frames are read, since the line before a Hello may have switched the drivers on.
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

/// How many bytes wait; noted in the measures.
#[inline(never)]
pub(crate) fn unread(board: &mut Board, receiver: &mut Receiver) -> Unread {
    let unread = receiver.unread();
    board.note(&unread);
    unread
}

/// Does what a frame asks for.
#[inline(never)]
fn hear(board: &mut Board, service: &mut Service, received: Received, body: &[u8], now: Millis) {
    service.receive(received, body, now, board);
}

/// Asks the service for a reply, and then the program.
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
    // While only text is read, the service has nothing to say.
    reply.len = if program.has_line() { 0 } else { service.poll(now, board, reply.bytes) as u8 };
    reply.next = reply.bytes.as_ptr();
    if reply.len == 0 {
        (reply.next, reply.len) = program.speak(receiver, reply.bytes);
        if reply.len != 0 {
            service.interrupted();
        }
    }
}
