//! What the tests and benches of plans share.
#![allow(dead_code, reason = "each test and bench uses some of it")]

pub(crate) mod drift;
pub(crate) mod laws;
pub(crate) mod lorenz;

use pulsetrain_core::packing::{MAX_PACKED_LEN, Packing, State};
use pulsetrain_core::{Direction, Item};
use pulsetrain_motion::Law;
use pulsetrain_motion::program::Limits;
use pulsetrain_plan::{Certificate, Move, PlanError, Planner, Settings};

/// The step timers that plans are tested for: Uno, Due, Pico; ticks per second and fraction bits.
pub(crate) const BOARDS: [(u64, u32); 3] = [(16_000_000, 16), (42_000_000, 32), (125_000_000, 32)];

/// A tolerance of 1 tick, the `nearest` grid, and a motor that can do everything: laws here may begin at any speed.
pub(crate) fn settings((tick_hz, fraction_bits): (u64, u32)) -> Settings {
    let limits = Limits { pull_in: f64::INFINITY, ..Limits::default() };
    Settings { limits, ..Settings::new(tick_hz, fraction_bits) }
}

/// A step of a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Step {
    /// Scheduled tick.
    pub(crate) tick: u64,
    /// Whether the position counts up.
    pub(crate) forward: bool,
}

/// Plans `law` and shows `each` of its steps, replayed in wide integers: not with the code that boards run.
pub(crate) fn replay(law: &Law, settings: &Settings, mut each: impl FnMut(Step)) -> Result<Certificate, PlanError> {
    let mut planner = Planner::new(law, settings)?;
    let mut accumulator = 1_i128 << (settings.registers.fraction_bits - 1);
    while let Some(next) = planner.next_move()? {
        match next {
            Move::Dwell { ticks } => accumulator += i128::from(ticks) << settings.registers.fraction_bits,
            Move::Run { segment, direction } => {
                let (mut interval, mut add) = (i128::from(segment.interval), i128::from(segment.add));
                for _ in 0..segment.count {
                    accumulator += interval;
                    interval += add;
                    add += i128::from(segment.add2);
                    let tick =
                        u64::try_from(accumulator >> settings.registers.fraction_bits).expect("a tick after the start");
                    each(Step { tick, forward: direction == Direction::Forward });
                }
            }
        }
    }
    Ok(planner.certificate().clone())
}

/// Plans `law`, and gives back all of its steps with the certificate.
pub(crate) fn steps(law: &Law, settings: &Settings) -> Result<(Vec<Step>, Certificate), PlanError> {
    let mut steps = Vec::new();
    let certificate = replay(law, settings, |step| steps.push(step))?;
    Ok((steps, certificate))
}

/// Bytes of the packed stream of `law`, by core's packing; each is unpacked again.
pub(crate) fn packed_bytes(law: &Law, settings: &Settings) -> Result<usize, PlanError> {
    let gain = settings.gain().expect("settings for the packed stream");
    let packing = Packing { fraction_bits: settings.registers.fraction_bits, gain };
    let (mut here, mut there) = (State::default(), State::default());
    let mut planner = Planner::new(law, settings)?;
    let mut bytes = 0;
    while let Some(next) = planner.next_move()? {
        let item = match next {
            Move::Dwell { ticks } => Item::Dwell { ticks: u32::try_from(ticks).expect("a dwell of 32 bits") },
            Move::Run { segment, direction } => Item::Run { segment, direction },
        };
        let mut buffer = [0; MAX_PACKED_LEN];
        let len = packing.pack(&mut here, &item, &mut buffer).expect("a segment with steps");
        let unpacked = packing.unpack(&mut there, &mut &buffer[..len]).expect("what was packed").expect("an item");
        assert_eq!(in_use(unpacked), in_use(item));
        bytes += len;
    }
    Ok(bytes)
}

/// An item without what one or two steps have no use for: the stream need not say that.
fn in_use(item: Item) -> Item {
    let Item::Run { mut segment, direction } = item else { return item };
    if segment.count < 3 {
        segment.add2 = 0;
    }
    if segment.count < 2 {
        segment.add = 0;
    }
    Item::Run { segment, direction }
}
