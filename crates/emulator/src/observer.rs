//! What the chip tells the world.

use crate::{GpioEdge, PinEdge, UartByte};

/// Sees what leaves the chip, in the order of its cycles. Every method does nothing unless written otherwise.
///
/// ```
/// use pulsetrain_emulator::{Observer, PinEdge};
///
/// #[derive(Default)]
/// struct Edges(Vec<PinEdge>);
///
/// impl Observer for Edges {
///     fn pin(&mut self, edge: PinEdge) {
///         self.0.push(edge);
///     }
/// }
/// ```
pub trait Observer {
    /// A pin took another level because the chip changed what it drives.
    fn pin(&mut self, edge: PinEdge) {
        let _ = edge;
    }

    /// The same, of a chip whose pins have numbers only.
    fn gpio(&mut self, edge: GpioEdge) {
        let _ = edge;
    }

    /// A character has left a UART. Characters come when their stop bit is over; a pin's edges may have been told
    /// before that have later cycles than the character's start, never later than its end.
    fn transmit(&mut self, byte: UartByte) {
        let _ = byte;
    }

    /// The PC has taken a packet from the chip's USB serial port; the transaction ended in this cycle.
    fn usb(&mut self, cycle: u64, data: &[u8]) {
        let _ = (cycle, data);
    }

    /// From this cycle on, a cycle is `division` periods of the oscillator (CLKPR; 1 to 256).
    fn clock_division(&mut self, cycle: u64, division: u16) {
        let _ = (cycle, division);
    }

    /// From this cycle on, cycles come at this frequency (RP2040: clk_sys got another source or divider).
    fn clock_frequency(&mut self, cycle: u64, hz: u64) {
        let _ = (cycle, hz);
    }

    /// The chip has reset itself: its watchdog did, or its program asked for it.
    fn watchdog_reset(&mut self, cycle: u64) {
        let _ = cycle;
    }
}

/// Sees nothing.
impl Observer for () {}
