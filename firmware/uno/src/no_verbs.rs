//! In place of `verbs.rs` in the image that has text: motors are not told directly.

use pulsetrain_core::Moment;
use pulsetrain_core::wire::message::{Configuration, Reason, kind};
use pulsetrain_core::wire::orders::Orders;
use pulsetrain_core::wire::{Encoder, Refusal};

/// They cannot be.
pub(crate) const OBEYS: bool = false;

/// No state is this one.
pub(crate) const ON: u8 = 1;

#[inline(always)]
pub(crate) const fn is_on() -> bool {
    false
}

#[inline(always)]
pub(crate) fn set_up(_: &Configuration<'_>) {}

#[inline(always)]
pub(crate) fn begin(_: &Orders<'_>) -> Result<(), Refusal> {
    Err(Refusal { reason: Reason::UnknownKind, detail: kind::ORDERS as u16 })
}

#[inline(always)]
pub(crate) fn obey(orders: &Orders<'_>) -> Result<(), Refusal> {
    begin(orders)
}

#[inline(always)]
pub(crate) fn encode_obeyed(_: &mut Encoder<'_>) {}

#[inline(always)]
pub(crate) fn stop(_: bool) {}

#[inline(always)]
pub(crate) fn forget() {}

#[inline(always)]
pub(crate) const fn rest() -> bool {
    true
}

#[inline(always)]
pub(crate) const fn take_done() -> Option<(u8, Moment, u32)> {
    None
}

#[inline(always)]
pub(crate) const fn forsake() {}
