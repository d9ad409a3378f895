//! A virtual board whose clock runs too fast or too slow, as an Uno's ceramic resonator may by up to half a percent.

use crate::bridge::Bridge;
use crate::{Edge, Port, PortError, VirtualBoard};
use pulsetrain_core::wire::Baud;
use std::time::Duration;

/// A board whose chip runs faster or slower than its nominal rate: a second of the host is more or less than a second of the chip.
///
/// The serial line is off by as much at both ends, so that bytes still come through.
///
/// ```no_run
/// use pulsetrain_board::{Port, skewed::Skewed, virtual_uno::VirtualUno};
/// use std::time::Duration;
/// let mut uno = Skewed::new(VirtualUno::new(), 5000);
/// let began = uno.now();
/// uno.receive(began + Duration::from_millis(1), &mut Vec::new())?;
/// let took = uno.inner().now().as_secs_f64() - began.as_secs_f64() * 1.005;
/// assert!((took - 0.001_005).abs() < 1e-6);
/// # Ok::<(), pulsetrain_board::PortError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Skewed<B> {
    board: B,
    ppm: i32,
}

impl<B> Skewed<B> {
    /// A board whose clock is `ppm` parts per million faster than its nominal rate, or slower if negative; clamped to ±100 000.
    pub fn new(board: B, ppm: i32) -> Skewed<B> {
        Skewed { board, ppm: ppm.clamp(-100_000, 100_000) }
    }

    /// The board itself, with the chip's time.
    pub const fn inner(&self) -> &B {
        &self.board
    }

    fn chip_time(&self, host: Duration) -> Duration {
        scaled(host, i128::from(1_000_000 + self.ppm), 1_000_000)
    }
}

fn scaled(time: Duration, by: i128, over: i128) -> Duration {
    let nanos = (time.as_nanos() as i128).saturating_mul(by).div_euclid(over);
    Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
}

impl<B: Port> Port for Skewed<B> {
    fn now(&self) -> Duration {
        scaled(self.board.now(), 1_000_000, i128::from(1_000_000 + self.ppm))
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.board.send(bytes)
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        // Two nanoseconds more, so that the host's time is reached however the conversions were rounded.
        let until = self.chip_time(until).saturating_add(Duration::from_nanos(2));
        self.board.receive(until, into)
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        self.board.set_baud(baud)
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        self.board.edges(into);
    }
}

impl<B: VirtualBoard> VirtualBoard for Skewed<B> {
    fn cycles_per_s(&self) -> u64 {
        self.board.cycles_per_s()
    }

    fn traced(&self) -> std::ops::RangeInclusive<u8> {
        self.board.traced()
    }

    fn reset(&mut self) {
        self.board.reset();
    }

    fn zero(&self) -> Option<u64> {
        self.board.zero()
    }

    fn baud(&self) -> Baud {
        self.board.baud()
    }

    fn set_client_rate(&mut self, rate: u32) -> Result<(), PortError> {
        self.board.set_client_rate(rate)
    }

    fn set_bridge(&mut self, bridge: Bridge) -> bool {
        self.board.set_bridge(bridge)
    }
}
