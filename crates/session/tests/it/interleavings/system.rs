//! A host, a line and a board, as a state machine; and what must hold in each of its states.

use super::board::{Board, Mutation};
use super::host::{Belief, Host};
use super::plan::{PULL_IN_TICKS, Plan, Told};
use pulsetrain_board::lease::{Lease, LeaseState};
use pulsetrain_core::lease::Cause;
use pulsetrain_core::wire::Command;
use stateright::{Model, Property};
use std::collections::VecDeque;
use std::fmt::{self, Write};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

/// What is explored: small enough to end.
#[derive(Clone, Debug)]
pub(crate) struct System {
    pub(crate) plan: Plan,
    /// Bytes of a motor's queue.
    pub(crate) queue: u16,
    /// Time goes on by so many ticks, so often.
    pub(crate) quantum: u64,
    pub(crate) quanta: u8,
    pub(crate) most: Budget,
    pub(crate) mutation: Mutation,
}

/// How often something happens at most.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct Budget {
    /// Frames that vanish.
    pub(crate) lost: u8,
    /// Frames that arrive damaged.
    pub(crate) damaged: u8,
    /// Times that the host is out of patience with the line.
    pub(crate) repeats: u8,
    pub(crate) trims: u8,
    pub(crate) brakes: u8,
    /// Times that the host asks how the board is.
    pub(crate) statuses: u8,
}

#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) board: Arc<Board>,
    /// Of all that the board is: printing it takes longer than all else, and few steps change it.
    board_hash: u64,
    pub(crate) host: Host,
    to_board: VecDeque<Vec<u8>>,
    to_host: VecDeque<Vec<u8>>,
    quanta: u8,
    left: Budget,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Step {
    /// The host tells a motor the next portion of its plan, and so on.
    Append(usize, Told),
    Extend(Lease),
    Trim,
    Brake,
    AskStatus,
    /// What was not confirmed goes out again.
    Repeat,
    /// The frame that is first on the line.
    Board(Fate),
    Host(Fate),
    /// Time goes on at the board. The host stands still if it does nothing meanwhile.
    Tick,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fate {
    Arrives,
    Vanishes,
    Damaged,
}

/// Hands text on to a hasher.
struct Hashed<'a, H>(&'a mut H);

impl<H: Hasher> Write for Hashed<'_, H> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0.write(text.as_bytes());
        Ok(())
    }
}

impl State {
    /// Prints all that matters for what comes: what `Debug` prints of the real code, so that no field of it is forgotten.
    fn print(&self, out: &mut impl Write) -> fmt::Result {
        let State { board: _, board_hash, host, to_board, to_host, quanta, left } = self;
        let Host {
            link,
            clock,
            told,
            held,
            extending,
            ended,
            asked,
            heard_rest,
            is_stale,
            is_wary,
            is_over,
            is_refused,
        } = host;
        write!(out, "{board_hash} {clock:?}{told:?}{held:?}{extending:?}{ended:?}{asked:?}")?;
        write!(out, "{heard_rest}{is_stale}{is_wary}{is_over}{is_refused}{to_board:?}{to_host:?}{quanta}{left:?}")?;
        // What the link read last, and how much it sent in all, is the past.
        let link = format!("{link:?}");
        let (_, link) = link.split_once(", tag: ").ok_or(fmt::Error)?;
        let (link, _) = link.rsplit_once(", counts: ").ok_or(fmt::Error)?;
        out.write_str(link)
    }
}

impl Hash for State {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.print(&mut Hashed(hasher)).expect("a link has a decoder, a tag and counts");
    }
}

impl PartialEq for State {
    fn eq(&self, other: &State) -> bool {
        let [mut own, mut others] = [String::new(), String::new()];
        self.print(&mut own).is_ok() && other.print(&mut others).is_ok() && own == others
    }
}

impl System {
    /// Both have greeted each other, and the switch with the first portion is accepted. Nothing of that is lost.
    fn begin(&self) -> State {
        let mut state = State {
            board: Arc::new(Board::new(&self.plan, self.queue)),
            board_hash: 0,
            host: Host::new(&self.plan),
            to_board: VecDeque::new(),
            to_host: VecDeque::new(),
            quanta: self.quanta,
            left: self.most,
        };
        state.host.say_hello();
        self.exchange(&mut state);
        let setup = self.plan.setup();
        let motors = setup.motor_bytes();
        state.host.ask(&Command::Configure(setup.configuration(&motors).expect("two motors")));
        self.exchange(&mut state);
        state.host.ask(&Command::Arm);
        self.exchange(&mut state);
        state.host.link.poll(std::time::Duration::ZERO);
        self.exchange(&mut state);
        for motor in 0..self.plan.motors() {
            let told = state.host.can_append(&self.plan, motor).expect("room for the first portion");
            state.host.append(&self.plan, motor, told);
        }
        state.host.switch(&self.plan, self.mutation);
        self.exchange(&mut state);
        assert_eq!(state.board.ledger.told, state.host.told, "the switch was made");
        state
    }

    fn exchange(&self, state: &mut State) {
        state.send();
        while !state.to_board.is_empty() || !state.to_host.is_empty() {
            self.reach_board(state, Fate::Arrives);
            self.reach_host(state, Fate::Arrives);
        }
    }

    fn reach_board(&self, state: &mut State, fate: Fate) {
        let Some(mut frame) = state.to_board.pop_front() else { return };
        if fate == Fate::Vanishes {
            return;
        }
        if fate == Fate::Damaged {
            damage(&mut frame);
        }
        state.change_board(|board| board.receive(&frame, self.mutation));
    }

    fn reach_host(&self, state: &mut State, fate: Fate) {
        let Some(frame) = state.to_host.pop_front() else { return };
        // A host does nothing about a frame that is damaged.
        if fate == Fate::Arrives {
            state.host.receive(&self.plan, &frame);
            state.send();
        }
    }

    fn is_late(&self, state: &State) -> bool {
        state.quanta == 0
    }
}

/// The last byte before the end is another one, and not the end.
fn damage(frame: &mut [u8]) {
    if let [.., last, 0] = frame {
        *last = if *last == 0x55 { 0x54 } else { 0x55 };
    }
}

impl State {
    /// Does something to the board, and puts what it says then on the line.
    fn change_board(&mut self, change: impl FnOnce(&mut Board) -> Vec<Vec<u8>>) {
        let board = Arc::make_mut(&mut self.board);
        self.to_host.extend(change(board));
        let mut hasher = DefaultHasher::new();
        write!(Hashed(&mut hasher), "{board:?}").expect("a hasher takes everything");
        self.board_hash = hasher.finish();
    }

    fn send(&mut self) {
        let frames = self.host.frames();
        self.to_board.extend(frames);
    }
}

impl Model for System {
    type State = State;
    type Action = Step;

    fn init_states(&self) -> Vec<State> {
        vec![self.begin()]
    }

    fn actions(&self, state: &State, steps: &mut Vec<Step>) {
        let State { board, host, left, .. } = state;
        if !self.is_late(state) {
            let appended =
                (0..self.plan.motors()).filter_map(|motor| Some((motor, host.can_append(&self.plan, motor)?)));
            steps.extend(appended.map(|(motor, told)| Step::Append(motor, told)));
            steps.extend(host.can_extend(&self.plan, board.now(), self.mutation).map(Step::Extend));
            if left.trims > 0 && host.can_trim().is_some() {
                steps.push(Step::Trim);
            }
            if left.brakes > 0 && host.can_brake() {
                steps.push(Step::Brake);
            }
            steps.push(Step::Tick);
        }
        if left.statuses > 0 && host.can_ask_status(board.now()) {
            steps.push(Step::AskStatus);
        }
        if left.repeats > 0 && host.link.deadline().is_some() && state.to_board.is_empty() && state.to_host.is_empty() {
            steps.push(Step::Repeat);
        }
        let fates = [(Fate::Arrives, true), (Fate::Vanishes, left.lost > 0), (Fate::Damaged, left.damaged > 0)];
        for (fate, is_possible) in fates {
            if is_possible && !state.to_board.is_empty() {
                steps.push(Step::Board(fate));
            }
            if is_possible && !state.to_host.is_empty() && fate != Fate::Damaged {
                steps.push(Step::Host(fate));
            }
        }
    }

    fn next_state(&self, last: &State, step: Step) -> Option<State> {
        let mut state = last.clone();
        let State { host, left, .. } = &mut state;
        match step {
            Step::Append(motor, told) => host.append(&self.plan, motor, told),
            Step::Extend(lease) => host.extend(lease, self.mutation),
            Step::Trim => {
                left.trims -= 1;
                host.trim(&self.plan, self.mutation);
            }
            Step::Brake => {
                left.brakes -= 1;
                host.brake(self.mutation);
            }
            Step::AskStatus => {
                left.statuses -= 1;
                host.ask_status();
            }
            Step::Repeat => {
                left.repeats -= 1;
                host.lose_patience();
            }
            Step::Tick => {
                state.quanta -= 1;
                state.change_board(|board| board.run(board.now() + self.quantum - 1));
                return Some(state);
            }
            Step::Board(fate) => {
                state.left.spend(fate);
                self.reach_board(&mut state, fate);
                return Some(state);
            }
            Step::Host(fate) => {
                state.left.spend(fate);
                self.reach_host(&mut state, fate);
                return Some(state);
            }
        }
        state.send();
        Some(state)
    }

    fn properties(&self) -> Vec<Property<System>> {
        vec![
            Property::always(
                "each step before the lease's end is made at its tick, once",
                |system: &System, state: &State| system.makes_the_plan(state),
            ),
            Property::always(
                "after it each motor makes the stop that the host would replay",
                |system: &System, state: &State| system.makes_the_stop(state),
            ),
            Property::always("no motor stops dead", |_, state: &State| !state.stops_dead()),
            Property::always("a host never believes a wrong count", |system: &System, state: &State| {
                system.belief_is_right(state)
            }),
            Property::always("who has heard the last word knows the count", |system: &System, state: &State| {
                system.last_word_is_enough(state)
            }),
            Property::always("what was accepted holds, and nothing else", |_, state: &State| {
                state.holds_what_was_accepted()
            }),
            Property::always("what the host holds for sure was accepted", |_, state: &State| state.host_is_modest()),
            Property::always(
                "the lease ends no later than what the board was told",
                |system: &System, state: &State| system.lease_is_covered(state),
            ),
            Property::always("no trim reaches below the horizon", |_, state: &State| !state.board.ledger.seen.bad_trim),
            Property::always("nothing is at fault", |_, state: &State| state.is_sound()),
            Property::always("all rest in the end", |system: &System, state: &State| {
                !system.is_late(state) || state.board.rests()
            }),
            Property::eventually("all come to rest", |_, state: &State| {
                state.board.rests() && !matches!(state.board.lease(), LeaseState::Off | LeaseState::Until(_))
            }),
            Property::sometimes("a run finishes", |_, state: &State| {
                state.host.heard_rest && matches!(state.board.lease(), LeaseState::Last)
            }),
            Property::sometimes("a lease lapses, and motors brake", |_, state: &State| {
                matches!(state.board.lease(), LeaseState::Lapsed { cause: Cause::NotExtended, in_motion: true, .. })
            }),
            Property::sometimes("an extension comes just in time", |_, state: &State| {
                state.board.ledger.seen.just_in_time
            }),
            Property::sometimes("an extension is refused", |_, state: &State| state.board.ledger.seen.refused),
            Property::sometimes(
                "the host does not know which of two counts it is",
                |system: &System, state: &State| {
                    matches!(state.host.belief(&system.plan), Belief::Either([one, other]) if one != other)
                        && state.board.rests()
                },
            ),
        ]
    }
}

impl Budget {
    fn spend(&mut self, fate: Fate) {
        match fate {
            Fate::Arrives => {}
            Fate::Vanishes => self.lost -= 1,
            Fate::Damaged => self.damaged -= 1,
        }
    }
}

impl System {
    fn makes_the_plan(&self, state: &State) -> bool {
        let Board { ledger, log, .. } = &*state.board;
        let until = state.lapsed().map_or(state.board.now(), |at| at.min(state.board.now()));
        log.iter().enumerate().all(|(motor, steps)| {
            let planned = self.plan.steps(motor, ledger.told[motor]);
            let planned = planned.iter().take_while(|(tick, _)| *tick < until);
            planned.eq(steps.iter().take_while(|(tick, _)| *tick < until))
        })
    }

    fn makes_the_stop(&self, state: &State) -> bool {
        let Board { ledger, log, .. } = &*state.board;
        let Some(at) = state.lapsed() else { return true };
        let replayed = self.plan.replay(&ledger.told, Lease::Until(at));
        log.iter()
            .zip(&replayed)
            .all(|(steps, replayed)| steps.iter().eq(replayed.iter().take_while(|(tick, _)| *tick < state.board.now())))
    }

    /// Looked at once the motors will not move any more, whatever the host says.
    fn belief_is_right(&self, state: &State) -> bool {
        if !state.is_final(&self.plan) {
            return true;
        }
        let counted = state.board.counts();
        match state.host.belief(&self.plan) {
            Belief::Counts(counts) => counts == counted,
            Belief::Either(both) => both.contains(&counted),
            Belief::Unknown => true,
        }
    }

    fn last_word_is_enough(&self, state: &State) -> bool {
        let host = &state.host;
        let has_heard =
            host.heard_rest && host.extending.is_none() && host.asked.is_none() && state.is_final(&self.plan);
        !has_heard || host.belief(&self.plan) == Belief::Counts(state.board.counts())
    }

    fn lease_is_covered(&self, state: &State) -> bool {
        let ledger = &state.board.ledger;
        match (ledger.lease, self.plan.longest_lease(&ledger.told)) {
            (_, Lease::Last) => true,
            (Lease::Until(until), Lease::Until(longest)) => until <= longest,
            (Lease::Last, Lease::Until(_)) => false,
        }
    }
}

impl State {
    /// Since when the lease is over, if it is.
    fn lapsed(&self) -> Option<u64> {
        match self.board.lease() {
            LeaseState::Lapsed { at, .. } => Some(at),
            LeaseState::Off | LeaseState::Until(_) | LeaseState::Last => None,
        }
    }

    /// Whether the motors have made all steps that they will make.
    fn is_final(&self, plan: &Plan) -> bool {
        let told = &self.board.ledger.told;
        let is_finished = || {
            self.board.lease() == LeaseState::Last && (0..plan.motors()).all(|motor| plan.is_told(motor, told[motor]))
        };
        self.board.rests() && (self.lapsed().is_some() || is_finished())
    }

    /// A motor rests after an interval at which it may not, or slows down too much from one step to the next.
    fn stops_dead(&self) -> bool {
        self.board.log.iter().any(|steps| {
            let mut intervals = steps.windows(2).map(|pair| pair[1].0 - pair[0].0);
            let is_abrupt = |(before, after): (u64, u64)| before < PULL_IN_TICKS && 2 * after > 3 * before + 2;
            let all: Vec<u64> = intervals.by_ref().collect();
            let rests_fast = self.board.rests() && all.last().is_some_and(|last| *last < PULL_IN_TICKS);
            rests_fast || all.windows(2).any(|pair| is_abrupt((pair[0], pair[1])))
        })
    }

    fn holds_what_was_accepted(&self) -> bool {
        let ledger = &self.board.ledger;
        match (self.board.lease(), ledger.lease) {
            (LeaseState::Until(until), Lease::Until(accepted)) => ledger.braked.is_none() && until == accepted,
            (LeaseState::Last, Lease::Last) => ledger.braked.is_none(),
            (LeaseState::Lapsed { at, cause: Cause::NotExtended, .. }, Lease::Until(accepted)) => {
                ledger.braked.is_none() && at == accepted
            }
            (LeaseState::Lapsed { at, cause: Cause::Ordered, .. }, _) => ledger.braked == Some(at),
            // The switch that begins it waits.
            (LeaseState::Off, _) => self.board.log.iter().all(Vec::is_empty),
            _ => false,
        }
    }

    fn host_is_modest(&self) -> bool {
        let host = &self.host;
        let accepted = self.board.ledger.lease;
        host.held == accepted
            || host.extending == Some(accepted)
            || host.ended.is_some()
            || host.is_over
            || matches!((host.asked, accepted), (Some(super::host::Asked::Trim(until)), Lease::Until(at)) if until == at)
    }

    fn is_sound(&self) -> bool {
        let is_fault = matches!(self.board.lease(), LeaseState::Lapsed { cause, .. } if cause.is_fault())
            || self.board.has_faults();
        !is_fault && !self.host.is_refused && self.host.link.error().is_none()
    }
}
