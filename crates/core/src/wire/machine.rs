//! What a board must be able to do for the [`Service`](super::Service): its motors, its clock, its line. How a board does it is not
//! known here.

use super::frame::Encoder;
use super::limits::{Baud, MAX_MOTORS};
use super::message::{Configuration, Event, Info, LIMIT_LEN, LeaseField, Measures, is_lease, kind, lease_of};
use super::orders::Orders;
use super::outcome::{NO_LEASE, Reason, Refusal, Stopped, Switched, Trimmed};
use super::settings::SETTINGS_LEN;
use crate::lease::Lease;
use crate::{Epoch, Tick32};

/// A board, as the [`Service`](super::Service) sees it. Everything is done at once; nothing waits.
///
/// Motors are numbered from 0; those beyond [`motors`](Machine::motors) are never asked for but in
/// [`push`](Machine::push) and [`free`](Machine::free).
pub trait Machine {
    /// Whether its motors follow plans, which hold by [lease](crate::lease): [`push`](Machine::push), [`switch`](Machine::switch),
    /// [`extend`](Machine::extend), [`trim`](Machine::trim), [`brake`](Machine::brake).
    const PLANS: bool = true;

    /// Whether its motors take orders directly: [`obey`](Machine::obey).
    const OBEYS: bool = false;

    /// Whether it keeps settings without power: [`store`](Machine::store).
    const STORES: bool = false;

    /// What it is, and its marks; the service fills in what is the session's.
    fn info(&mut self) -> Info;

    /// Sets pins and times and splits the queues' memory. Counts begin at 0; nothing is powered until
    /// [`arm`](Machine::arm).
    ///
    /// Repeated with the same content it changes nothing: an answer that was lost is asked for again.
    ///
    /// # Errors
    /// What does not fit this board, or [`Reason::Moving`]; the old configuration stays.
    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal>;

    /// Powers the motors and takes packed bytes from now on. Counts stay; queues are empty and faults forgotten.
    ///
    /// # Errors
    /// [`Reason::NotConfigured`], [`Reason::Moving`].
    fn arm(&mut self) -> Result<(), Refusal>;

    /// Takes the power from motors that rest; queues are emptied.
    ///
    /// # Errors
    /// [`Reason::Moving`].
    fn release(&mut self) -> Result<(), Refusal>;

    /// Motors configured, at most [`MAX_MOTORS`].
    fn motors(&self) -> u8;

    /// Free bytes in a motor's queue: what [`push`](Machine::push) will take.
    fn free(&self, motor: u8) -> u16;

    /// Puts packed items (whole ones, as [`packing`](crate::packing) defines) last in a motor's queue: all or none.
    ///
    /// # Errors
    /// [`Reason::Full`]: the frame is asked for again. [`Reason::NotArmed`], [`Reason::NoSuchMotor`]: it is dropped.
    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal>;

    /// Takes back what was pushed last of `epoch`, of all motors.
    fn discard(&mut self, epoch: Epoch);

    /// Begins `epoch` at `tick`. All motors drop the rest of the old epoch then. The new plan holds as long as `lease` says, which in a frame is never
    /// [`Lease::Off`]. All motors switch, or none does: then what was pushed of `epoch` is dropped.
    ///
    /// `limits` are how hard motors may brake then: three bytes for each ([`limits_of`](super::message::limits_of)), all of them possible; or
    /// nothing, and those before hold.
    ///
    /// # Errors
    /// [`Reason::NotArmed`].
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> Result<Switched, Refusal>;

    /// Puts the end of the lease off, or earlier, and sets limits as [`switch`](Machine::switch) does; `lease` is not [`Lease::Off`]. Whether it is
    /// accepted: not before the horizon, and the lease has not lapsed. Otherwise nothing changes.
    fn extend(&mut self, lease: Lease, limits: &[u8]) -> bool {
        let _ = (lease, limits);
        false
    }

    /// Drops bytes from the end of each motor's queue, two bytes that say how many for each; the plan that is left holds up to `until`. All
    /// or nothing.
    ///
    /// # Errors
    /// [`Reason::NotArmed`].
    fn trim(&mut self, until: Tick32, bytes: &[u8]) -> Result<Trimmed, Refusal> {
        let _ = (until, bytes);
        Ok(Trimmed::NoLease)
    }

    /// All motors brake from the horizon on, if they do not earlier. Gives the tick from which on; [`NO_LEASE`] without a lease.
    fn brake(&mut self) -> u64 {
        NO_LEASE
    }

    /// Does what the payload of Switch, Extend, Trim or Brake says, by those methods; `code` and `tick` are set as the answer has them. Gives whether it is accepted. A
    /// board on which each byte of the program counts reads the bytes itself; others leave this as it is.
    ///
    /// # Errors
    /// As there, and [`Reason::Malformed`].
    fn obey_plan(&mut self, kind: u8, payload: &[u8], code: &mut u8, tick: &mut [u8; 8]) -> Result<bool, Refusal>
    where
        Self: Sized,
    {
        obey_plan(self, kind, payload, code, tick)
    }

    /// What has become of the lease, as [`LeaseState::to_parts`](super::message::LeaseState::to_parts) gives it.
    fn lease(&self) -> (u8, u32) {
        (0, 0)
    }

    /// The immediate, unplanned stop: no step begins from now on. The motors stay powered, but must be armed again.
    fn stop_now(&mut self) -> Stopped;

    /// Has motors obey orders, all of them or none. From then on, until they are released or stopped, no plans
    /// are taken.
    ///
    /// # Errors
    /// [`Reason::NotArmed`]; [`Reason::Moving`]: a plan is under way; what [`Verbs::obey`](crate::verbs::Verbs::obey) says.
    fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        let _ = orders;
        Err(Refusal { reason: Reason::UnknownKind, detail: u16::from(kind::ORDERS) })
    }

    /// Writes what came of what was obeyed last: an [`Obeyed`](super::orders::Obeyed).
    fn obeyed(&self, frame: &mut Encoder<'_>) {
        let _ = frame;
    }

    /// Keeps these [`Settings`](super::Settings) without power, in place of those before; with `None` nothing is changed. They hold for
    /// configurations and for text that come after.
    ///
    /// # Errors
    /// [`Reason::Moving`]: motors are powered; also with `None`.
    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        let _ = settings;
        Err(Refusal { reason: Reason::UnknownKind, detail: u16::from(kind::STORE) })
    }

    /// What it keeps, into `settings`; zeros, and `false`, if nothing was stored, or it was damaged. Asked for while motors rest.
    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        settings.fill(0);
        false
    }

    /// Whether it finds something damaged where it keeps them, if it can tell that from nothing: then those before hold, or none.
    fn store_is_damaged(&self) -> bool {
        false
    }

    /// The 64-bit clock, now.
    fn clock(&mut self) -> u64;

    /// [`flags`](super::message::flags) of the board: asked for with every acknowledgement.
    fn flags(&self) -> u8;

    /// The first tick at which a switch would be accepted.
    fn horizon(&mut self) -> u64;

    /// The epoch being run, or that was run last.
    fn epoch(&self) -> Epoch;

    /// A motor's steps forward minus steps backward, pulses begun, modulo 2^32.
    fn position(&mut self, motor: u8) -> i32;

    /// [`flags`](super::message::flags) of a motor, since it was armed.
    fn faults(&self, motor: u8) -> u8;

    /// The board's own measurements, up to date. The service fills in the damaged frames.
    fn measures(&mut self) -> &mut Measures;

    /// Counters restart at zero.
    fn reset_measures(&mut self);

    /// Whether the line can do `baud`.
    fn can_baud(&self, baud: Baud) -> bool;

    /// Changes the rate of the line as soon as all bytes that were handed over are out; what came in before is dropped, and a
    /// frame that it began.
    fn set_baud(&mut self, baud: Baud);

    /// The host is heard again after its new rate had been given up: an event
    /// ([`Cause::BaudFellBack`](super::message::Cause::BaudFellBack)).
    fn rate_fell_back(&mut self);

    /// The board has no host any more: it sent Bye, or (`lost`) was silent for too long. Motors follow what is queued up
    /// to the end of its lease.
    fn host_gone(&mut self, lost: bool);

    /// The next event that was not sent to the host yet, oldest first.
    fn event(&mut self) -> Option<Event>;
}

/// [`Machine::obey_plan`] of a machine that leaves it to this.
fn obey_plan<M: Machine>(
    machine: &mut M,
    kind: u8,
    payload: &[u8],
    code: &mut u8,
    tick: &mut [u8; 8],
) -> Result<bool, Refusal> {
    let bad = Refusal::malformed(kind);
    let answer = match kind {
        kind::EXTEND => {
            let (field, limits) = lease_for(payload, machine.motors()).ok_or(bad)?;
            return Ok(machine.extend(lease_of(*field), limits));
        }
        kind::TRIM => {
            let (until, bytes) = payload.split_first_chunk().ok_or(bad)?;
            if bytes.len() != 2 * usize::from(machine.motors()) {
                return Err(bad);
            }
            machine.trim(Tick32(u32::from_le_bytes(*until)), bytes)?.to_parts()
        }
        kind::BRAKE if payload.is_empty() => {
            let braked = machine.brake();
            *tick = braked.to_le_bytes();
            return Ok(braked != NO_LEASE);
        }
        kind::SWITCH => {
            let (&[epoch, at @ ..], rest) = payload.split_first_chunk::<9>().ok_or(bad)?;
            let (field, limits) = lease_for(rest, machine.motors()).ok_or(bad)?;
            machine.switch(Epoch(epoch), u64::from_le_bytes(at), lease_of(*field), limits)?.to_parts()
        }
        _ => return Err(bad),
    };
    (*code, *tick) = (answer.0, answer.1.to_le_bytes());
    Ok(answer.0 == 0)
}

/// A lease field, and limits for all of so many motors or none.
#[inline(always)]
fn lease_for(payload: &[u8], motors: u8) -> Option<(&LeaseField, &[u8])> {
    let (field, limits) = payload.split_first_chunk()?;
    let all = LIMIT_LEN * usize::from(motors);
    ((limits.is_empty() || limits.len() == all) && is_lease(payload)).then_some((field, limits))
}

const _: () = assert!(MAX_MOTORS <= 8, "`uncertain` has a bit for each");
