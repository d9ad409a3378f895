//! All texts that the reader compares and that replies write, in one piece, so that a board may keep them in its program memory.

/// How many names of commands there are.
pub(super) const COMMANDS: u8 = 13;

/// Texts, each with a 0 at its end. The [`COMMANDS`] names come first, in the order of their codes.
const TEXTS: &[u8] = b"\
a\0d\0v\0r\0s\0g\0l\0enable\0srate\0deadman\0strict\0version\0ping\0\
id StepperWinch Nov 21 2026\0awake\0txyza\0err \0\
command\0flags\0number\0range\0missing\0extra\0long\0noise\0checksum\0 0.01..20 Hz\0 0.07..5\0\
dbg invalid srate value\0dbg excessive input error\0taken\0";

/// How many letters there are.
pub const COUNT: usize = TEXTS.len();

/// All texts, as an array.
pub const LETTERS: [u8; COUNT] = {
    let mut letters = [0; COUNT];
    let mut at = 0;
    while at < COUNT {
        letters[at] = TEXTS[at];
        at += 1;
    }
    letters
};

// A place is a byte.
const _: () = assert!(COUNT <= 255);

/// The place where the names of commands begin.
pub(super) const NAMES: u8 = 0;

/// Numbers of the texts of replies, counted from the end of the names.
pub(super) mod text {
    pub(crate) const ID: u8 = 0;
    pub(crate) const AWAKE: u8 = 1;
    pub(crate) const STATUS: u8 = 2;
    pub(crate) const ERROR: u8 = 3;
    /// The first of the names of faults, from `Command` to `Checksum`.
    pub(crate) const FIRST_WHAT: u8 = 4;
    pub(crate) const FREQUENCY: u8 = 13;
    pub(crate) const RATIO: u8 = 14;
    pub(crate) const RATE: u8 = 15;
    pub(crate) const WORDS: u8 = 16;
    pub(crate) const TAKEN: u8 = 17;
}

/// The place where the texts of replies begin.
pub(super) const REPLIES: u8 = {
    let (mut at, mut names) = (0, 0);
    while names < COMMANDS {
        if LETTERS[at as usize] == 0 {
            names += 1;
        }
        at += 1;
    }
    at
};

/// Access to [`LETTERS`], one by one. An AVR would copy a constant to its RAM; it reads its program memory by special instructions.
pub trait Letters {
    /// The letter at that place; 0 beyond the last.
    fn letter(at: u8) -> u8;
}

/// Reads them from the constant [`LETTERS`].
#[derive(Clone, Copy, Debug)]
pub struct InMemory;

impl Letters for InMemory {
    fn letter(at: u8) -> u8 {
        LETTERS.get(usize::from(at)).copied().unwrap_or(0)
    }
}
