//! In place of the winch in the image that has verbs: there is no text, which nobody hears or says.

use crate::link::Receiver;
use crate::machine::Board;
use crate::memory::REPLY_LEN;
use pulsetrain_core::wire::{Millis, Service};

/// Text, as main knows it.
pub(crate) struct Winch;

impl Winch {
    pub(crate) const fn new() -> Winch {
        Winch
    }

    pub(crate) const fn is_on(&self) -> bool {
        false
    }

    pub(crate) const fn drives(&self) -> bool {
        false
    }

    pub(crate) const fn has_line(&self) -> bool {
        false
    }

    #[inline(always)]
    pub(crate) fn listen(&mut self, _: &mut Board, _: &mut Receiver) -> u8 {
        0
    }

    #[inline(always)]
    pub(crate) fn look(&mut self, _: &mut Board, _: &Service, _: &Receiver, _: Millis) {}

    #[inline(always)]
    pub(crate) fn speak(&mut self, _: &Receiver, out: &mut [u8; REPLY_LEN]) -> (*const u8, u8) {
        (out.as_ptr(), 0)
    }
}

/// No motor has trains.
pub(crate) mod feed {
    pub(crate) const TEXT: bool = false;
    pub(crate) const SLICE: u16 = 0;
    pub(crate) const TRAIN: u8 = 0;
}
