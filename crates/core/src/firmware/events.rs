//! Reports that wait for the host.

use crate::wire::message::Event;

/// The oldest `N` events. What does not fit is dropped: a stop makes one, and a fault one for each motor.
#[derive(Clone, Debug)]
pub struct EventQueue<const N: usize>([Option<Event>; N]);

impl<const N: usize> EventQueue<N> {
    /// No event waits.
    pub const EMPTY: EventQueue<N> = EventQueue([None; N]);

    /// Whether no event waits.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.first().is_none_or(Option::is_none)
    }

    /// Puts an event last, if there is room.
    pub fn push(&mut self, event: Event) {
        if let Some(place) = self.0.iter_mut().find(|place| place.is_none()) {
            *place = Some(event);
        }
    }

    /// Takes the oldest event.
    pub fn pop(&mut self) -> Option<Event> {
        let first = self.0.first_mut()?.take()?;
        self.0.rotate_left(1);
        Some(first)
    }
}
