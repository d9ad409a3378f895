//! What leaves a chip: the trait through which a chip reports edges, characters and changes of its clock.

use crate::{GpioEdge, PinEdge, UartByte};

/// Gets everything that leaves the chip, in the order of its cycles. A method that is not implemented does nothing.
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
    /// The chip has changed the level of a pin.
    fn pin(&mut self, edge: PinEdge) {
        let _ = edge;
    }

    /// The chip has changed the level of a pin, where pins have numbers only (RP2040).
    fn gpio(&mut self, edge: GpioEdge) {
        let _ = edge;
    }

    /// A UART has sent a character. This is called at the end of the stop bit, so that edges with later cycles than the
    /// start bit may have come before, but none with later cycles than the stop bit's end.
    fn transmit(&mut self, byte: UartByte) {
        let _ = byte;
    }

    /// The PC has taken a packet from the chip's USB serial port, in a transaction that ended in this cycle.
    fn usb(&mut self, cycle: u64, data: &[u8]) {
        let _ = (cycle, data);
    }

    /// From this cycle on, a cycle is `division` periods of the oscillator (CLKPR; 1 to 256).
    fn clock_division(&mut self, cycle: u64, division: u16) {
        let _ = (cycle, division);
    }

    /// From this cycle on, cycles have this frequency (RP2040: clk_sys has another source or divider).
    fn clock_frequency(&mut self, cycle: u64, hz: u64) {
        let _ = (cycle, hz);
    }

    /// The chip has reset itself, because its watchdog ran out or its program requested it.
    fn watchdog_reset(&mut self, cycle: u64) {
        let _ = cycle;
    }
}

/// Ignores everything.
impl Observer for () {}
