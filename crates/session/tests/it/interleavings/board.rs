//! The board's end of the line: the real [`Service`] before the test kit's board, whose stepgen is core's. Beside it stands what the contract
//! says of each frame, written down once more: [`Ledger`].

use super::plan::{EPOCH, Plan, Told, ZERO};
use super::printed::Print;
use pulsetrain_board::lease::{Lease, LeaseState, Leased};
use pulsetrain_board::{Edge, Faults};
use pulsetrain_core::Tick32;
use pulsetrain_core::lease;
use pulsetrain_core::wire::frame::Received;
use pulsetrain_core::wire::message::kind;
use pulsetrain_core::wire::{BoardSide, Command, Decoder, MAX_FRAME, MIN_BODY, Millis, Service};
use pulsetrain_testkit::model::Model;
use std::fmt::{self, Write};

/// Something that is wrong with a board or a host, so that the checker has something to find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mutation {
    None,
    /// The board does again what an extension says that comes again, and by then it is the one before.
    BoardForgetsLease,
    /// The board takes data and drops them.
    BoardDropsData,
    /// The host takes an extension for accepted when it has sent it.
    HostBelievesExtension,
    /// The host takes items back, and leaves the lease where it was.
    HostTrimsBelowLease,
    /// The host does not mind that an order to brake is not answered: it counts on the lease before.
    HostBelievesBrake,
    /// The host puts the lease where the plan ends that it has, not where the board's does.
    HostLeasesAhead,
    /// The host never says how hard motors may brake.
    HostTellsNoLimits,
}

/// What the board has accepted so far: the items of each motor, and until when the lease holds.
#[derive(Clone, Debug)]
pub(crate) struct Ledger {
    /// Sequence number of the next frame.
    expected: u8,
    pub(crate) told: Vec<Told>,
    pub(crate) lease: Lease,
    /// The one before.
    previous: Lease,
    /// Since when motors brake since the host said so.
    pub(crate) braked: Option<u64>,
    pub(crate) seen: Seen,
}

/// What the last frame did: for what is to happen sometimes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Seen {
    pub(crate) just_in_time: bool,
    pub(crate) refused: bool,
    pub(crate) trimmed: bool,
    pub(crate) trim_refused: bool,
    pub(crate) no_room: bool,
    pub(crate) gap: bool,
    pub(crate) repeat: bool,
    /// A trim ended below what the board was committed to.
    pub(crate) bad_trim: bool,
}

/// Bytes that wait to be read: two frames or three.
const WINDOW: u16 = 36;

/// The board.
#[derive(Clone, Debug)]
pub(crate) struct Board {
    model: Model,
    service: Service,
    /// Levels of its lines: DIR of motor m is line 16 + m.
    levels: u32,
    /// Pulses of each motor.
    pub(crate) log: Vec<Vec<(u64, i64)>>,
    pub(crate) ledger: Ledger,
    pub(crate) verdict: Verdict,
}

/// What holds of a board: worked out when it changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Verdict {
    pub(crate) makes_the_plan: bool,
    pub(crate) makes_the_stop: bool,
    pub(crate) stops_dead: bool,
    pub(crate) holds_what_was_accepted: bool,
    pub(crate) lease_is_covered: bool,
    pub(crate) has_faults: bool,
    /// The motors have made all steps that they will make.
    pub(crate) is_final: bool,
}

impl Print for Board {
    fn print(&self, out: &mut impl Write) -> fmt::Result {
        write!(out, "{self:?}")
    }
}

impl Board {
    /// A board whose queues have so many bytes each.
    pub(crate) fn new(plan: &Plan, queue: u16) -> Board {
        let pool = queue * u16::try_from(plan.motors()).expect("two motors");
        Board {
            model: Model::new([pool, WINDOW]),
            service: Service::new(MIN_BODY),
            levels: 0,
            log: vec![Vec::new(); plan.motors()],
            ledger: Ledger {
                expected: 0,
                told: vec![Told::default(); plan.motors()],
                lease: Lease::Last,
                previous: Lease::Last,
                braked: None,
                seen: Seen::default(),
            },
            verdict: Verdict {
                makes_the_plan: true,
                makes_the_stop: true,
                stops_dead: false,
                holds_what_was_accepted: true,
                lease_is_covered: true,
                has_faults: false,
                is_final: false,
            },
        }
    }

    /// The first tick that has not passed.
    pub(crate) fn now(&self) -> u64 {
        self.model.native().now()
    }

    pub(crate) fn lease(&self) -> LeaseState {
        self.model.native().lease()
    }

    pub(crate) fn rests(&self) -> bool {
        self.model.native().idle()
    }

    pub(crate) fn has_motor_faults(&self) -> bool {
        let motors = 0..self.log.len();
        motors.map(|motor| self.model.native().faults(motor)).any(|faults| faults != Faults::default())
    }

    pub(crate) fn counts(&self) -> Vec<i64> {
        self.log.iter().map(|steps| steps.iter().map(|(_, sign)| sign).sum()).collect()
    }

    /// Takes a frame, and gives what it says to it.
    pub(crate) fn receive(&mut self, frame: &[u8], mutation: Mutation) -> Vec<Vec<u8>> {
        self.ledger.seen = Seen::default();
        let mut decoder: Decoder = Decoder::new();
        for byte in frame {
            let received = decoder.push(*byte);
            let body = decoder.body().to_vec();
            if let [seq, kind, payload @ ..] = &body[..]
                && !matches!(received, Received::More)
            {
                self.take(*seq, *kind, payload, received, mutation);
            } else {
                self.service.receive(received, &body, Millis(0), &mut self.model.side);
            }
        }
        self.speak()
    }

    /// A frame or a damaged one.
    fn take(&mut self, seq: u8, kind: u8, payload: &[u8], received: Received, mutation: Mutation) {
        let is_frame = matches!(received, Received::Frame(_));
        let is_next = is_frame && seq == self.ledger.expected;
        let free: Vec<u16> = self.free();
        let horizon = self.model.native().horizon();
        let was = self.lease();
        let drops = mutation == Mutation::BoardDropsData && kind == kind::DATA && self.ledger.told[0].main == 2;
        let body: Vec<u8> = match is_next && drops {
            true => vec![seq, kind::POLL],
            false => [seq, kind].into_iter().chain(payload.iter().copied()).collect(),
        };
        self.service.receive(received, &body, Millis(0), &mut self.model.side);
        if !is_next {
            let seen = &mut self.ledger.seen;
            let is_old = seq.wrapping_sub(self.ledger.expected) >= 0x80;
            seen.repeat |= is_frame && is_old && kind == kind::EXTEND;
            seen.gap |= !is_frame || !is_old;
            if is_frame && is_old && kind == kind::EXTEND && mutation == Mutation::BoardForgetsLease {
                let Lease::Until(previous) = self.ledger.previous else { return };
                self.model.side.extend(lease::Lease::Until(Tick32::of(previous)), &[]);
            }
            return;
        }
        self.note(kind, payload, &free, horizon, was, mutation);
    }

    fn free(&self) -> Vec<u16> {
        (0..).take(self.log.len()).map(|motor| self.model.side.free(motor)).collect()
    }

    /// What the contract says of the frame that was next.
    fn note(&mut self, kind: u8, payload: &[u8], free: &[u16], horizon: u64, was: LeaseState, mutation: Mutation) {
        let now_free = self.free();
        let now = self.now();
        let ledger = &mut self.ledger;
        let is_lapsed = matches!(was, LeaseState::Lapsed { .. });
        match Command::decode(kind, payload) {
            Ok(Command::Data { motor, epoch, packed }) => {
                let motor = usize::from(motor);
                if usize::from(free[motor]) < packed.len() {
                    ledger.seen.no_room = true;
                    return;
                }
                // What comes after a lapse is taken, and not kept.
                if !is_lapsed && epoch == EPOCH {
                    let told = &mut ledger.told[motor];
                    if told.is_cut { told.instead += 1 } else { told.main += 1 }
                }
            }
            Ok(Command::Switch { lease, .. }) => {
                ledger.lease = near(lease);
                ledger.previous = ledger.lease;
            }
            Ok(Command::Extend { lease, .. }) => {
                let lease = near(lease);
                let is_late = matches!(lease, Lease::Until(until) if until < horizon);
                if is_lapsed || is_late {
                    ledger.seen.refused = true;
                } else {
                    // Less than two intervals before it would have been over.
                    ledger.seen.just_in_time |=
                        matches!(ledger.lease, Lease::Until(until) if until - now.min(until) < 80);
                    let previous = std::mem::replace(&mut ledger.lease, lease);
                    if mutation == Mutation::BoardForgetsLease {
                        ledger.previous = previous;
                    }
                }
            }
            Ok(Command::Trim { until, .. }) => {
                if now_free.iter().zip(free).any(|(now, before)| now > before) {
                    let until = u64::from(until.0);
                    ledger.seen.trimmed = true;
                    ledger.seen.bad_trim |= until < horizon || is_lapsed;
                    ledger.lease = Lease::Until(until);
                    for (told, (now, before)) in ledger.told.iter_mut().zip(now_free.iter().zip(free)) {
                        if now > before {
                            told.main -= 1;
                        }
                        told.is_cut = true;
                    }
                } else {
                    ledger.seen.trim_refused = true;
                }
            }
            Ok(Command::Brake) if !is_lapsed => {
                let until = match ledger.lease {
                    Lease::Until(until) => until.min(horizon),
                    Lease::Last => horizon,
                };
                ledger.braked = Some(until);
            }
            _ => {}
        }
        ledger.expected = ledger.expected.wrapping_add(1);
    }

    /// Time goes on up to and with tick `until`; gives what the board says then.
    pub(crate) fn run(&mut self, until: u64) -> Vec<Vec<u8>> {
        self.ledger.seen = Seen::default();
        let mut edges: Vec<Edge> = Vec::new();
        self.model.run(until, &mut edges);
        for edge in edges {
            let bit = 1 << edge.line;
            self.levels = if edge.level { self.levels | bit } else { self.levels & !bit };
            let motor = usize::from(edge.line);
            if edge.level && motor < self.log.len() {
                let is_forward = self.levels >> (16 + motor) & 1 == 1;
                self.log[motor].push((edge.tick, if is_forward { 1 } else { -1 }));
            }
        }
        self.speak()
    }

    fn speak(&mut self) -> Vec<Vec<u8>> {
        let mut said = Vec::new();
        loop {
            let mut out = [0; MAX_FRAME + 1];
            match self.service.poll(Millis(0), &mut self.model.side, &mut out) {
                0 => return said,
                len => said.push(out[..len].to_vec()),
            }
        }
    }
}

/// A lease of a frame; ticks here stay far below 2^32.
fn near(lease: lease::Lease) -> Lease {
    match lease {
        lease::Lease::Until(until) => Lease::Until(until.0.into()),
        lease::Lease::Last => Lease::Last,
        lease::Lease::Off => Lease::Until(ZERO),
    }
}
