//! In place of the line and of what speaks on it, in the image that plays what lies behind it: nobody hears, and nobody is heard.

/// The line.
pub(crate) mod link {
    use crate::regs;

    pub(crate) const TALKS: bool = false;

    /// Of nobody's bytes: pages stay where they are.
    pub(crate) const PAGE: u8 = 128;
    pub(crate) const WINDOW: u16 = 0;

    /// What the other images have of a frame that is coming in.
    pub(crate) struct Receiver {
        _bytes: [u8; 72],
    }

    /// There is nobody to be kept out.
    pub(crate) fn let_others_in() {}

    /// Leaves its pins alone, which the bootloader had.
    pub(crate) fn start() {
        regs::UCSR0B.write(0);
    }
}

/// Text.
pub(crate) mod winch {
    /// No motor has trains.
    pub(crate) mod feed {
        pub(crate) const TEXT: bool = false;
        pub(crate) const SLICE: u16 = 0;
        pub(crate) const TRAIN: u8 = 0;
    }
}
