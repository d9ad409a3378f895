//! What the [`Service`](super::Service) needs of a board: its motors, its clock, its line. How a board does it is the firmware's
//! matter.

use super::frame::Encoder;
use super::limits::{Baud, MAX_MOTORS};
use super::message::{Configuration, Event, Info, LIMIT_LEN, LeaseField, Measures, is_lease, kind, lease_of};
use super::orders::Orders;
use super::outcome::{NO_LEASE, Reason, Refusal, Stopped, Switched, Trimmed};
use super::settings::SETTINGS_LEN;
use crate::lease::Lease;
use crate::{Epoch, Tick32};

/// A board, as the [`Service`](super::Service) sees it. No method may wait for something.
///
/// Motors are numbered from 0. Only [`push`](BoardSide::push) and [`free`](BoardSide::free) may be called for a motor beyond
/// [`motors`](BoardSide::motors).
pub trait BoardSide {
    /// Whether its motors follow plans, under a [lease](crate::lease): [`push`](BoardSide::push), [`switch`](BoardSide::switch),
    /// [`extend`](BoardSide::extend), [`trim`](BoardSide::trim), [`brake`](BoardSide::brake).
    const PLANS: bool = true;

    /// Whether its motors obey verbs: [`obey`](BoardSide::obey).
    const OBEYS: bool = false;

    /// Whether it keeps settings without power: [`store`](BoardSide::store).
    const STORES: bool = false;

    /// What the board is. The service fills in the session's fields.
    fn info(&mut self) -> Info;

    /// Sets pins and times, and splits the queues' memory. Counts begin at 0. Nothing is powered until
    /// [`arm`](BoardSide::arm).
    ///
    /// A second call with the same content must change nothing: the host repeats the frame if the answer was lost.
    ///
    /// # Errors
    /// The reason why this board cannot do it, or [`Reason::Moving`]. The old configuration stays.
    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal>;

    /// Powers the motors, and takes packed bytes from now on. Counts stay. Queues are emptied and faults cleared.
    ///
    /// # Errors
    /// [`Reason::NotConfigured`], [`Reason::Moving`].
    fn arm(&mut self) -> Result<(), Refusal>;

    /// Switches off the motors, which must be at rest, and empties their queues.
    ///
    /// # Errors
    /// [`Reason::Moving`].
    fn release(&mut self) -> Result<(), Refusal>;

    /// The number of configured motors, at most [`MAX_MOTORS`].
    fn motors(&self) -> u8;

    /// Free bytes in a motor's queue: as many as [`push`](BoardSide::push) will take.
    fn free(&self, motor: u8) -> u16;

    /// Appends packed items ([`packing`](crate::packing)), none cut in two, to a motor's queue: all of them or none.
    ///
    /// # Errors
    /// [`Reason::Full`]: the host will be asked to repeat the frame. [`Reason::NotArmed`], [`Reason::NoSuchMotor`]: the frame is dropped.
    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal>;

    /// Removes the items of `epoch` from the ends of all queues.
    fn discard(&mut self, epoch: Epoch);

    /// Begins `epoch` at `tick`. All motors drop the rest of the old epoch then. The new plan is valid as long as `lease` says, which is never
    /// [`Lease::Off`] here. Either all motors switch, or none does; then the queued items of `epoch` are dropped.
    ///
    /// `limits` say how hard motors may brake in the new plan: three valid bytes for each motor ([`limits_of`](super::message::limits_of)). If
    /// it is empty, motors keep their limits.
    ///
    /// # Errors
    /// [`Reason::NotArmed`].
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> Result<Switched, Refusal>;

    /// Moves the end of the lease, later or earlier, and sets limits as [`switch`](BoardSide::switch) does. `lease` is not [`Lease::Off`]. Returns
    /// whether it was accepted. It is refused, and nothing changes, if the new end is before the horizon, or the lease has lapsed.
    fn extend(&mut self, lease: Lease, limits: &[u8]) -> bool {
        let _ = (lease, limits);
        false
    }

    /// Drops bytes from the end of each motor's queue, and ends the lease at `until`, where the rest of the plan ends. `bytes` has two bytes
    /// for each motor: how many to drop. Either all of this is done, or nothing.
    ///
    /// # Errors
    /// [`Reason::NotArmed`].
    fn trim(&mut self, until: Tick32, bytes: &[u8]) -> Result<Trimmed, Refusal> {
        let _ = (until, bytes);
        Ok(Trimmed::NoLease)
    }

    /// All motors brake, from the horizon on if they do not brake already. Returns the tick from which on; [`NO_LEASE`] without a lease.
    fn brake(&mut self) -> u64 {
        NO_LEASE
    }

    /// Does what the payload of Switch, Extend, Trim or Brake asks, by the methods above. Sets `code` and `tick` for the answer, and returns
    /// whether the command was accepted. Only a board that is short of flash needs a version of its own, which reads the bytes where they are.
    ///
    /// # Errors
    /// Those of the methods, and [`Reason::Malformed`].
    fn obey_plan(&mut self, kind: u8, payload: &[u8], code: &mut u8, tick: &mut [u8; 8]) -> Result<bool, Refusal>
    where
        Self: Sized,
    {
        obey_plan(self, kind, payload, code, tick)
    }

    /// The state of the lease: [`LeaseState::to_parts`](super::message::LeaseState::to_parts).
    fn lease(&self) -> (u8, u32) {
        (0, 0)
    }

    /// Stops at once, without braking: no step begins from now on. The motors stay powered, but must be armed again.
    fn stop_now(&mut self) -> Stopped;

    /// Has motors obey orders, all of them or none. Until the motors are released or stopped, the board takes no plans.
    ///
    /// # Errors
    /// [`Reason::NotArmed`]; [`Reason::Moving`] while motors follow a plan; the errors of [`Verbs::obey`](crate::verbs::Verbs::obey).
    fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        let _ = orders;
        Err(Refusal { reason: Reason::UnknownKind, detail: u16::from(kind::ORDERS) })
    }

    /// Writes the answer to the last orders: an [`Obeyed`](super::orders::Obeyed).
    fn obeyed(&self, frame: &mut Encoder<'_>) {
        let _ = frame;
    }

    /// Stores these [`Settings`](super::Settings), which the board keeps without power. With `None` it stores nothing. They act on later
    /// configurations and on later text.
    ///
    /// # Errors
    /// [`Reason::Moving`] while motors are powered, also with `None`.
    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        let _ = settings;
        Err(Refusal { reason: Reason::UnknownKind, detail: u16::from(kind::STORE) })
    }

    /// Reads the stored settings into `settings`. Zeros, and `false`, if none were stored or they are damaged. Called only while motors rest.
    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        settings.fill(0);
        false
    }

    /// Whether the stored settings are damaged. Then older ones are used, or none. A board that cannot tell damage from an empty memory
    /// returns `false`.
    fn store_is_damaged(&self) -> bool {
        false
    }

    /// The board's clock now, ticks.
    fn clock(&mut self) -> u64;

    /// [`flags`](super::message::flags) of the board, which go into every acknowledgement.
    fn flags(&self) -> u8;

    /// The first tick at which a switch would be accepted.
    fn horizon(&mut self) -> u64;

    /// The epoch being run, or that was run last.
    fn epoch(&self) -> Epoch;

    /// A motor's steps forward minus steps backward, pulses begun, modulo 2^32.
    fn position(&mut self, motor: u8) -> i32;

    /// [`flags`](super::message::flags) of a motor, since it was armed.
    fn faults(&self, motor: u8) -> u8;

    /// The board's measurements of itself. The service fills in the number of damaged frames.
    fn measures(&mut self) -> &mut Measures;

    /// Sets the counters of [`measures`](BoardSide::measures) to zero.
    fn reset_measures(&mut self);

    /// Whether the line can do `baud`.
    fn can_baud(&self, baud: Baud) -> bool;

    /// Changes the rate of the line as soon as all bytes that were handed over are out. Bytes received before that are dropped, and with
    /// them the beginning of a frame.
    fn set_baud(&mut self, baud: Baud);

    /// The line went back to 115 200 baud, and now the host is heard again. The board makes this an event
    /// ([`Cause::BaudFellBack`](super::message::Cause::BaudFellBack)).
    fn rate_fell_back(&mut self);

    /// The session is over: the host sent Bye, or (`lost`) was silent for too long. Motors follow their queues up to the end of the
    /// lease.
    fn host_gone(&mut self, lost: bool);

    /// The next event that was not sent to the host yet, oldest first.
    fn event(&mut self) -> Option<Event>;
}

/// The [`BoardSide::obey_plan`] of most boards.
fn obey_plan<M: BoardSide>(
    board: &mut M,
    kind: u8,
    payload: &[u8],
    code: &mut u8,
    tick: &mut [u8; 8],
) -> Result<bool, Refusal> {
    let bad = Refusal::malformed(kind);
    let answer = match kind {
        kind::EXTEND => {
            let (field, limits) = lease_for(payload, board.motors()).ok_or(bad)?;
            return Ok(board.extend(lease_of(*field), limits));
        }
        kind::TRIM => {
            let (until, bytes) = payload.split_first_chunk().ok_or(bad)?;
            if bytes.len() != 2 * usize::from(board.motors()) {
                return Err(bad);
            }
            board.trim(Tick32(u32::from_le_bytes(*until)), bytes)?.to_parts()
        }
        kind::BRAKE if payload.is_empty() => {
            let braked = board.brake();
            *tick = braked.to_le_bytes();
            return Ok(braked != NO_LEASE);
        }
        kind::SWITCH => {
            let (&[epoch, at @ ..], rest) = payload.split_first_chunk::<9>().ok_or(bad)?;
            let (field, limits) = lease_for(rest, board.motors()).ok_or(bad)?;
            board.switch(Epoch(epoch), u64::from_le_bytes(at), lease_of(*field), limits)?.to_parts()
        }
        _ => return Err(bad),
    };
    (*code, *tick) = (answer.0, answer.1.to_le_bytes());
    Ok(answer.0 == 0)
}

/// Splits a payload into a lease field and the limits of `motors` motors, or of none.
#[inline(always)]
fn lease_for(payload: &[u8], motors: u8) -> Option<(&LeaseField, &[u8])> {
    let (field, limits) = payload.split_first_chunk()?;
    let all = LIMIT_LEN * usize::from(motors);
    ((limits.is_empty() || limits.len() == all) && is_lease(payload)).then_some((field, limits))
}

const _: () = assert!(MAX_MOTORS <= 8, "`uncertain` has a bit for each");
