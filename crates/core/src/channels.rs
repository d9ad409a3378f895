//! The horizon and the end of the lease, which all channels of one machine share. A single channel is in
//! [`channel`](crate::channel).

use crate::{Channel, Lapse, Tick32};

/// The latest of all channels' horizons: the first tick that none has committed.
pub fn horizon<'a, const F: u32>(channels: impl Iterator<Item = &'a Channel<F>>) -> Option<Tick32> {
    channels.map(Channel::horizon).reduce(Tick32::or_later)
}

/// The lapse that all channels must know of, if one of them has lapsed: pass it to [`Channel::lapse_at`] of each.
pub fn agreed_lapse<'a, const F: u32>(channels: impl Iterator<Item = &'a Channel<F>> + Clone) -> Option<Lapse> {
    let open = horizon(channels.clone())?;
    let news = channels.filter(|channel| channel.has_unreported_lapse()).filter_map(Channel::lapse);
    let since = |lapse: Lapse| if lapse.cause.is_fault() { Lapse { at: open, ..lapse } } else { lapse };
    news.map(since).reduce(|one, other| {
        let at = if other.at.is_before(one.at) { other.at } else { one.at };
        Lapse { at, cause: if one.cause.is_fault() { one.cause } else { other.cause } }
    })
}
