//! The winch: text on the line instead of frames. Motors follow paths, which the board works out itself.
//!
//! docs/winch.md describes the commands, and `pulsetrain_core::winch` defines them. Paths, reader and replies are assembly that does the same (tick.s,
//! command.s, text.s, reply.s); crates/board/tests/it/chips/winch_avr.rs compares them.
//!
//! # What is here
//! - this file: the main loop's side; lines, and what they ask for
//! - [`feed`]: the refill's side; from paths to the motors
//! - [`obey`]: main's side; what lines do to the paths
//!
//! # Who has the board
//! Text is *on* as long as frames have not taken the board and no motor moves for them. Then every byte goes to the reader of lines. From a zero on bytes
//! go to the receiver of frames, too, until there is a command. Paths and reader are in the memory of the queues. From the first command that enables the
//! drivers, until `enable 0` has released them, text *drives*, and a Hello in frames is refused.

pub(crate) mod feed;
mod obey;

use crate::engine::link::{self, Receiver};
use crate::engine::machine::Board;
use crate::engine::memory::REPLY_LEN;
use crate::engine::program::Program;
use crate::engine::steps::refill;
use crate::engine::tuning::winch::{BACKLOG, FRAMES_SILENT};
use crate::engine::{clock, host, store, tuning};
use core::arch::global_asm;
use pulsetrain_core::Tick32;
use pulsetrain_core::winch::text::LineCommand;
use pulsetrain_core::wire::message::{Configuration, image};
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{BoardSide, Millis, Service};

/// Bytes of four paths, of the reader, and of the longest line that is sent.
const PATHS: usize = 4 * PATH;
const READER: usize = TEXT + 81;
const LINE: usize = pulsetrain_core::winch::reply::LONGEST;

/// Bytes of the values of a status line: the clock and four positions.
const VALUES: usize = 5 * 4;
// Value k is read before `txyza` and k numbers have been written over it.
const _: () = assert!(5 + 12 * 4 <= LINE - VALUES + 4 * 4);

const PATH: usize = 51;
/// Where the reader has the line.
const TEXT: usize = 25;
/// Where a path has its gains, and its limits; as many bytes each.
const OF_GAINS: usize = 22;
const OF_LIMITS: usize = 32;
/// Where a path has its speed, whole steps/s, 2 bytes.
const SPEED: usize = 18;

/// Where settings are read to: so that their limits are where the reader has values.
const SETTINGS: usize = reader::VALUES - 6;
const _: () = assert!(SETTINGS_LEN == 6 + 2 * 4);

/// Fields of the reader.
mod reader {
    pub(super) const STAR: usize = 2;
    pub(super) const WORD: usize = 5;
    pub(super) const AXES: usize = 7;
    pub(super) const GIVEN: usize = 8;
    pub(super) const VALUES: usize = 9;
    pub(super) const STRICT: u8 = 1;
    pub(super) const OVER: u8 = 2;
    pub(super) const CHECKED: u8 = 4;
}

/// What `winch_say` says beside refusals, as in reply.s.
const AWAKE: u8 = 14;
const ID: u8 = 15;
const TAKEN: u8 = 16;

/// Period of status lines at first, ms.
const REPORT_MS: u8 = 200;

/// `winch_listen` returns this when it comes to a zero.
const ZERO: u8 = 0x40;

// text.s has the length of the receive page.
const _: () = assert!(link::PAGE == 0x80);

// Where other programs have their queues.
global_asm!(
    r#"
    .global winch_paths, winch_reader, winch_line, winch_asked
    .set winch_paths, queues
    .set winch_reader, queues + {PATHS}
    .set winch_line, queues + {PATHS} + {READER}
    .set winch_asked, queues + {PATHS} + {READER} + {LINE}
    "#,
    PATHS = const PATHS,
    READER = const READER,
    LINE = const LINE,
);

const _: () = assert!(PATHS + READER + LINE + size_of::<Asked>() <= Winch::POOL);

global_asm!(include_str!("winch/tick.s"), options(raw));
global_asm!(include_str!("winch/command.s"), options(raw));
global_asm!(include_str!("winch/text.s"), options(raw));
global_asm!(include_str!("winch/reply.s"), options(raw));

unsafe extern "C" {
    static mut winch_reader: [u8; READER];
    static mut winch_line: [u8; LINE];
    static mut winch_asked: Asked;
    fn winch_listen(reader: *mut u8, bytes: *const u8, count: u8) -> u16;
    fn winch_say(out: *mut u8, what: u8, word: u8) -> u8;
    fn winch_status(out: *mut u8, values: *const i32) -> u8;
}

/// The text protocol, as main knows it.
pub(crate) struct Winch {
    /// Text is read. Only then [`asked`] may be used.
    on: bool,
    /// Frames were seen: nothing is sent until there is a command.
    quiet: bool,
    /// The shield's configuration is set.
    set_up: bool,
    /// Motors follow the paths.
    drives: bool,
    /// What is to be sent next, or 0.
    say: u8,
    /// The receiver's tail, when that was looked at last.
    seen: u8,
}

impl Program for Winch {
    const IMAGE: u8 = image::WINCH;
    const SHARED: bool = false;
    const SHIELD_B: bool = false;

    #[inline(always)]
    fn is_on(&self) -> bool {
        self.on
    }

    #[inline(always)]
    fn drives(&self) -> bool {
        self.drives
    }

    // No zero has come since the last command.
    #[inline(always)]
    fn has_line(&self) -> bool {
        self.on && !self.quiet
    }

    #[inline(always)]
    fn listen(&mut self, board: &mut Board, receiver: &mut Receiver) -> u8 {
        self.hear_lines(board, receiver)
    }

    #[inline(always)]
    fn look(&mut self, board: &mut Board, service: &Service, receiver: &Receiver, now: Millis) {
        self.watch(board, service, receiver, now);
    }

    #[inline(always)]
    fn speak(&mut self, receiver: &Receiver, out: &mut [u8; REPLY_LEN]) -> (*const u8, u8) {
        self.say_next(receiver, out)
    }
}

/// What text has asked for. In the memory of the queues.
#[repr(C)]
struct Asked {
    /// The drivers are to be released when all axes rest.
    releasing: bool,
    /// The deadman has stopped the axes.
    dead: bool,
    /// The word that the next reply is about.
    word: u8,
    report_ms: u16,
    deadman_ms: u16,
    /// The drivers are released after so long a rest, unless it is 0.
    idle_ms: u16,
    /// When the axes were last seen moving.
    moved: Millis,
    /// When the last status line was due.
    reported: Tick32,
    /// When the last command came.
    heard: Tick32,
}

/// See [`Asked`]. Only while text is on.
#[inline(always)]
fn asked() -> &'static mut Asked {
    let asked = &raw mut winch_asked;
    // SAFETY: main's alone. Each use ends before the next begins, and it was initialised when text became on.
    unsafe { &mut *asked }
}

impl Winch {
    /// Text is not on yet.
    pub(crate) const fn new() -> Winch {
        Winch { on: false, quiet: false, set_up: false, drives: false, say: 0, seen: 0 }
    }

    /// Text becomes on.
    #[inline(never)]
    fn begin(&mut self) {
        if !self.quiet {
            self.say = AWAKE;
        }
        self.set_up = false;
        // SAFETY: frames do not use the queues while text is on, and the refill does not use paths while nothing drives.
        unsafe { obey::winch_begin() };
        // SAFETY: the reader is main's alone, and has room for so many bytes of values.
        let settings = unsafe { &mut *(&raw mut winch_reader).cast::<u8>().wrapping_add(SETTINGS).cast() };
        store::read(settings);
        let [deadman_low, deadman_high, idle_low, idle_high, .., amax_low, amax_high, amax_higher, _] = *settings;
        let asked = asked();
        asked.deadman_ms = u16::from_le_bytes([deadman_low, deadman_high]);
        asked.idle_ms = u16::from_le_bytes([idle_low, idle_high]);
        if amax_low | amax_high | amax_higher != 0 {
            // The limits are where the command would have them.
            obey::winch_obey_axes(0b1111, LineCommand::Limits as u8);
        }
    }

    /// Reads the lines among the waiting bytes and does what they say, up to one with a reply, or a zero. Drops what is text alone. Gives how many of the
    /// bytes it read may belong to frames too.
    ///
    /// If bytes were lost, nobody knows where: what waits is dropped, and the line that has begun, or the next, is refused.
    #[inline(never)]
    fn hear_lines(&mut self, board: &mut Board, receiver: &mut Receiver) -> u8 {
        let (mut heard, mut taken) = (0, 0);
        loop {
            // Nothing is done before it is known that the bytes were not overwritten.
            let unread = host::unread(board, receiver);
            if unread.lost != 0 {
                // A byte 1 in their place, which no text has. `on` is such a byte.
                let _ = read((&raw const self.on).cast(), 1);
                receiver.skip(unread.bytes);
                return 0;
            }
            if heard & 0x80 != 0 {
                self.hear(board, heard & 0x7f);
            } else if heard == ZERO && !self.quiet {
                // Frames have zeros, and text has none: this zero belongs to frames.
                receiver.skip(taken - 1);
                self.quiet = true;
                return 0;
            } else if heard != 0 && !self.quiet {
                self.say = heard;
                asked().word = get(reader::WORD);
            }
            let mut count = unread.bytes - taken;
            if self.quiet {
                if taken != 0 {
                    return taken;
                }
                count = count.min(tuning::host::BYTES_A_ROUND);
            }
            receiver.skip(taken);
            if count == 0 || (self.say != 0 && count < BACKLOG) {
                return 0;
            }
            let left;
            [heard, left] = read(receiver.after(0), count);
            taken = count - left;
        }
    }

    /// Does what a line says.
    #[inline(never)]
    fn hear(&mut self, board: &mut Board, verb: u8) {
        self.quiet = false;
        let needed = obey::winch_do(verb);
        let asked = asked();
        if asked.deadman_ms != 0 {
            asked.heard = clock::moment();
        }
        if needed & obey::AXES == 0 {
            // It does not replace a refusal that was not sent yet.
            if needed != 0 && (self.say == 0 || self.say >= AWAKE) {
                self.say = needed;
            }
            return;
        }
        if !self.set_up {
            self.set_up = true;
            set_up_shield(board);
        }
        if needed & obey::DRIVE != 0 && !self.drives {
            self.drives = true;
            drive(board);
        }
    }

    /// Does what is due by time. To be called every few milliseconds.
    #[inline(never)]
    fn watch(&mut self, board: &mut Board, service: &Service, receiver: &Receiver, millis: Millis) {
        let now = clock::moment();
        if self.drives {
            let ran_dry = !board.is_armed();
            if ran_dry || has_rested(millis) {
                self.drives = false;
                // After an underrun all stands still, and nobody knows where: start as after a reset.
                self.on &= !ran_dry;
                let _ = board.release();
            } else if is_silent(now) {
                asked().dead = true;
                obey::winch_obey_axes(0b1111, LineCommand::Enable as u8);
            }
        } else {
            feed::pass(now);
            if !self.on && receiver.ends_line(&mut self.seen) && service.silence(millis) >= FRAMES_SILENT {
                self.say = TAKEN;
            }
            let on = !service.is_taken() && board.rests();
            if on && !self.on {
                self.begin();
            }
            self.on = on;
        }
    }

    /// What is to be sent now, if anything: its first byte, and how many there are. It may be written to `out`.
    #[inline(never)]
    fn say_next(&mut self, receiver: &Receiver, out: &mut [u8; REPLY_LEN]) -> (*const u8, u8) {
        let out = out.as_mut_ptr();
        let say = core::mem::replace(&mut self.say, 0);
        if say != 0 {
            // SAFETY: `out` has room for the longest of these. TAKEN has no word, so it does not matter what the memory of the queues has there.
            return (out, unsafe { winch_say(out, say, (&raw const winch_asked.word).read()) });
        }
        let now = clock::moment();
        let asked = asked();
        // Lines are answered before a status is sent.
        if !self.on
            || self.quiet
            || receiver.waiting() >= BACKLOG / 2
            || !obey::winch_has_passed(now, &mut asked.reported, asked.report_ms)
        {
            return (out, 0);
        }
        let line = (&raw mut winch_line).cast::<u8>();
        // At the end of the line, so that each value is read before it is written over.
        let values = line.wrapping_add(LINE - VALUES).cast();
        // SAFETY: the line is main's, and its last content has been sent.
        unsafe {
            obey::winch_clock_and_positions(values);
            (line, winch_status(line, values))
        }
    }
}

/// Sets the shield's configuration. No motor moves.
#[inline(always)]
fn set_up_shield(board: &mut Board) {
    if let Some(mut configuration) = Configuration::new(obey::shield()) {
        // STEP is high for 1.94 µs, and DIR is right for 1 µs before and after: that suits any driver on such a shield.
        configuration.pulse_ticks = 31;
        configuration.setup_ticks = 16;
        configuration.hold_ticks = 16;
        configuration.enable_pin = 8;
        // It cannot fail: nothing moves, and the pins are valid.
        let _ = board.configure(&configuration);
    }
}

/// Powers the motors. The refill is kept out until there are trains, which it reads.
#[inline(never)]
fn drive(board: &mut Board) {
    let _out = refill::block();
    let _ = board.arm();
    let mut stepper = refill::lock();
    feed::begin(clock::moment());
    stepper.share_list_page();
    stepper.merge_by_source();
}

/// Whether all paths are at rest, and the motors with them.
#[inline(always)]
fn has_arrived() -> bool {
    let stepper = refill::lock();
    feed::rests() && stepper.is_idle()
}

/// The reader takes bytes from the receive page: see [`winch_listen`].
fn read(bytes: *const u8, count: u8) -> [u8; 2] {
    // SAFETY: so many bytes wait. The reader is main's alone while text is on.
    unsafe { winch_listen((&raw mut winch_reader).cast(), bytes, count) }.to_le_bytes()
}

/// Whether the drivers are to be released: all axes rest, and a command asked for that, or they have rested long enough.
fn has_rested(now: Millis) -> bool {
    let asked = asked();
    if !(asked.releasing || asked.idle_ms != 0) || !has_arrived() {
        asked.moved = now;
        return false;
    }
    asked.releasing || now.since(asked.moved) >= asked.idle_ms
}

/// Whether the deadman is to stop the axes.
fn is_silent(now: Tick32) -> bool {
    let asked = asked();
    asked.deadman_ms != 0 && !asked.dead && obey::winch_has_passed(now, &mut asked.heard, asked.deadman_ms)
}

/// A byte of the reader.
fn get(at: usize) -> u8 {
    // SAFETY: the reader is main's alone; `at` is in it.
    unsafe { (&raw const winch_reader).cast::<u8>().wrapping_add(at).read() }
}
