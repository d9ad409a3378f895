//! The host: the real [`Link`], and above it what `Remote` and `Session` do with it. They wait for answers, which a step of a checker
//! cannot, so this says once more what they do between two of them.

use super::board::Mutation;
use super::plan::{EPOCH, Plan, Told, ZERO};
use super::printed::Print;
use pulsetrain_board::lease::Lease;
use pulsetrain_board::link::Link;
use pulsetrain_core::Tick32;
use pulsetrain_core::lease;
use pulsetrain_core::wire::message::{Cause, LeaseState, limit_bytes};
use pulsetrain_core::wire::{Command, Reply, Trimmed};
use std::collections::VecDeque;
use std::fmt::{self, Write};
use std::time::Duration;

/// What the host waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Asked {
    Status,
    /// The lease's new end.
    Trim(u64),
    Brake,
}

/// What the host knows of how the motors will have counted, if it says nothing more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Belief {
    Counts(Vec<i64>),
    /// What it said last was accepted, or it was not, or what it said before.
    OneOf(Vec<Vec<i64>>),
    /// The board has not answered an order to brake, so the host does not know when the motors stopped.
    Unknown,
}

#[derive(Clone, Debug)]
pub(crate) struct Host {
    pub(crate) link: Link,
    /// The link's time: it goes on when the link is to be out of patience.
    pub(crate) clock: Duration,
    pub(crate) told: Vec<Told>,
    /// What the board has confirmed.
    pub(crate) held: Lease,
    pub(crate) extending: VecDeque<Lease>,
    /// Since when the motors brake, as the board said.
    pub(crate) ended: Option<u64>,
    pub(crate) asked: Option<Asked>,
    /// The board reported that its motors rest, and the host has sent nothing since it asked.
    pub(crate) heard_rest: bool,
    /// The host has sent something since it last asked for the status.
    pub(crate) is_stale: bool,
    /// An extension was refused: the board is to say why.
    pub(crate) is_wary: bool,
    /// The host has stopped.
    pub(crate) is_over: bool,
    /// The board refused what it should have taken.
    pub(crate) is_refused: bool,
}

impl Print for Host {
    fn print(&self, out: &mut impl Write) -> fmt::Result {
        let Host { link, clock, told, held, extending, ended, asked, .. } = self;
        let Host { heard_rest, is_stale, is_wary, is_over, is_refused, .. } = self;
        write!(out, "{clock:?}{told:?}{held:?}{extending:?}{ended:?}{asked:?}")?;
        write!(out, "{heard_rest}{is_stale}{is_wary}{is_over}{is_refused}")?;
        // What the link read last, and how much it sent in all, is the past.
        let link = format!("{link:?}");
        let (_, link) = link.split_once(", tag: ").ok_or(fmt::Error)?;
        let (link, _) = link.rsplit_once(", counts: ").ok_or(fmt::Error)?;
        out.write_str(link)
    }
}

impl Host {
    pub(crate) fn new(plan: &Plan) -> Host {
        Host {
            link: Link::new(7),
            clock: Duration::ZERO,
            told: vec![Told::default(); plan.motors()],
            held: Lease::Last,
            extending: VecDeque::new(),
            ended: None,
            asked: None,
            heard_rest: false,
            is_stale: false,
            is_wary: false,
            is_over: false,
            is_refused: false,
        }
    }

    /// What the link sends now.
    pub(crate) fn frames(&mut self) -> Vec<Vec<u8>> {
        let mut out = Vec::new();
        self.link.output(self.clock, &mut out);
        out.split_inclusive(|byte| *byte == 0).filter(|frame| frame.len() > 1).map(<[u8]>::to_vec).collect()
    }

    /// Time goes on until the link sends again what was not confirmed.
    pub(crate) fn lose_patience(&mut self) {
        self.clock += 2 * self.link.shortest_timeout();
    }

    pub(crate) fn say_hello(&mut self) {
        self.link.hello(self.clock);
    }

    /// Asks for something when nothing else is asked.
    pub(crate) fn ask(&mut self, command: &Command<'_>) {
        self.link.ask(command, self.clock);
    }

    fn tell(&mut self) {
        (self.heard_rest, self.is_stale) = (false, true);
    }

    /// Whether more may be told: `Session` fills queues as long as it knows of no end; `Remote` says nothing while it waits for a trim.
    pub(crate) fn goes_on(&self) -> bool {
        !self.is_over && self.ended.is_none() && matches!(self.asked, None | Some(Asked::Status))
    }

    /// The next portion of a motor's plan, if there is room as far as the host knows, or `guesses`.
    pub(crate) fn can_append(&self, plan: &Plan, motor: usize, guesses: bool) -> Option<Told> {
        let told = plan.next(motor, self.told[motor])?;
        let len = plan.last_packed(motor, told).len();
        let index = u8::try_from(motor).expect("two motors");
        (self.goes_on() && (guesses || self.link.room(index) >= len)).then_some(told)
    }

    pub(crate) fn append(&mut self, plan: &Plan, motor: usize, told: Told) {
        let packed = plan.last_packed(motor, told);
        self.told[motor] = told;
        self.link.send(u8::try_from(motor).expect("two motors"), EPOCH, &packed, self.clock);
        self.tell();
    }

    /// The switch with which it all begins.
    pub(crate) fn switch(&mut self, plan: &Plan, mutation: Mutation) {
        let lease = plan.longest_lease(&self.told);
        let limits: Vec<u8> = plan.limits().into_iter().flat_map(limit_bytes).collect();
        let limits = if mutation == Mutation::HostTellsNoLimits { &[][..] } else { &limits };
        self.held = lease;
        self.ask(&Command::Switch { epoch: EPOCH, tick: ZERO, lease: moment_of(lease), limits });
        self.tell();
    }

    /// The longest lease, if it is longer than the one there is, and fewer than `most` are on their way. `now`: the board's time.
    pub(crate) fn can_extend(&self, plan: &Plan, now: u64, most: usize, mutation: Mutation) -> Option<Lease> {
        let Lease::Until(held) = self.extending.back().copied().unwrap_or(self.held) else { return None };
        let longest = if mutation == Mutation::HostLeasesAhead {
            let ahead: Vec<Told> = (0..plan.motors())
                .map(|motor| plan.next(motor, self.told[motor]).unwrap_or(self.told[motor]))
                .collect();
            plan.longest_lease(&ahead)
        } else {
            plan.longest_lease(&self.told)
        };
        let is_longer = match longest {
            Lease::Until(until) => until > held.max(now),
            Lease::Last => true,
        };
        (self.goes_on() && !self.is_wary && self.extending.len() < most && is_longer).then_some(longest)
    }

    pub(crate) fn extend(&mut self, lease: Lease, mutation: Mutation) {
        self.link.extend(moment_of(lease), &[], self.clock);
        if mutation == Mutation::HostBelievesExtension {
            self.held = lease;
        }
        self.extending.push_back(lease);
        self.tell();
    }

    /// Whether the last portion of the plan can be taken back.
    pub(crate) fn can_trim(&self) -> bool {
        let is_whole = self.told.iter().all(|told| !told.is_cut && told.main > 1);
        is_whole && self.goes_on() && self.asked.is_none() && self.extending.is_empty()
    }

    fn cut(&self) -> Vec<Told> {
        self.told.iter().map(|told| Told { main: told.main - 1, instead: 0, is_cut: true }).collect()
    }

    pub(crate) fn trim(&mut self, plan: &Plan, mutation: Mutation) {
        let Lease::Until(least) = plan.longest_lease(&self.cut()) else { unreachable!("there is more to be told") };
        let until = match self.held {
            Lease::Until(held) if mutation == Mutation::HostTrimsBelowLease => held,
            _ => least,
        };
        let lens = self.told.iter().enumerate().map(|(motor, told)| plan.last_packed(motor, *told).len());
        let bytes: Vec<u8> = lens.flat_map(|len| u16::try_from(len).expect("few bytes").to_le_bytes()).collect();
        self.ask(&Command::Trim { until: Tick32::of(until), bytes: &bytes });
        self.asked = Some(Asked::Trim(until));
        self.tell();
    }

    pub(crate) fn can_brake(&self) -> bool {
        !self.is_over && self.ended.is_none() && self.asked.is_none()
    }

    pub(crate) fn brake(&mut self, mutation: Mutation) {
        self.link.withdraw();
        self.extending.clear();
        self.link.forget_extensions();
        self.ask(&Command::Brake);
        self.asked = Some(Asked::Brake);
        self.is_over = true;
        if mutation == Mutation::HostBelievesBrake {
            self.asked = None;
        }
        self.tell();
    }

    /// Asks when the plan that it knows of is over, though `Remote` asks all the time.
    pub(crate) fn can_ask_status(&self, now: u64) -> bool {
        let is_past = matches!(self.held, Lease::Until(until) if until <= now) || self.held == Lease::Last;
        self.asked.is_none() && !self.link.is_asking() && (is_past || self.is_over)
    }

    pub(crate) fn ask_status(&mut self) {
        self.ask(&Command::Status);
        self.asked = Some(Asked::Status);
        self.is_stale = false;
    }

    /// Takes a frame of the board's.
    pub(crate) fn receive(&mut self, plan: &Plan, frame: &[u8]) {
        self.link.input(frame, self.clock);
        self.hear(plan);
    }

    fn hear(&mut self, plan: &Plan) {
        while let Some(event) = self.link.event() {
            if matches!(
                event.cause,
                Cause::Lapsed | Cause::Braked | Cause::RanDry | Cause::BadItem | Cause::CheckFailed | Cause::StepMissed
            ) {
                self.ended = Some(event.tick);
            }
        }
        while let Some(accepted) = self.link.extended()
            && let Some(lease) = self.extending.pop_front()
        {
            if !accepted {
                self.is_wary = true;
            } else if self.ended.is_none() {
                self.held = lease;
            }
        }
        if self.link.refusal().is_some() {
            self.is_refused = true;
        }
        if let Some(answer) = self.link.answer() {
            self.note(plan, answer.reply);
        }
        if self.is_wary && self.asked.is_none() && !self.link.is_asking() {
            self.ask_status();
        }
    }

    fn note(&mut self, plan: &Plan, reply: Reply) {
        match (self.asked.take(), reply) {
            (Some(Asked::Trim(until)), Reply::Trimmed(Trimmed::Accepted)) => {
                for motor in 0..plan.motors() {
                    let len = plan.last_packed(motor, self.told[motor]).len();
                    self.link.freed(u8::try_from(motor).expect("two motors"), len);
                }
                self.told = self.cut();
                if self.ended.is_none() {
                    self.held = Lease::Until(until);
                }
            }
            (Some(Asked::Brake), Reply::Braked { tick }) => self.ended = self.ended.or(tick),
            (_, Reply::Status(status)) => {
                if let LeaseState::Lapsed(at) = status.head.lease {
                    self.ended.get_or_insert(u64::from(at.0));
                }
                self.is_wary = false;
                self.heard_rest = status.is_idle() && !self.is_stale;
            }
            _ => {}
        }
    }

    /// What the host says if nothing more is heard, as `Session`'s report does.
    pub(crate) fn belief(&self, plan: &Plan) -> Belief {
        if let Some(at) = self.ended {
            return Belief::Counts(plan.counts(&self.told, Lease::Until(at)));
        }
        let held = plan.counts(&self.told, self.held);
        match self.asked {
            Some(Asked::Brake) => Belief::Unknown,
            Some(Asked::Trim(until)) => Belief::OneOf(vec![held, plan.counts(&self.cut(), Lease::Until(until))]),
            _ if self.extending.is_empty() => Belief::Counts(held),
            _ => {
                let on_their_way = self.extending.iter().map(|lease| plan.counts(&self.told, *lease));
                Belief::OneOf(std::iter::once(held).chain(on_their_way).collect())
            }
        }
    }
}

/// A lease in the form that frames carry: 32 bits of the tick.
fn moment_of(lease: Lease) -> lease::Lease {
    match lease {
        Lease::Until(until) => lease::Lease::Until(Tick32::of(until)),
        Lease::Last => lease::Lease::Last,
    }
}
