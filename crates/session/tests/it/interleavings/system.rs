//! A host, a line and a board, as a state machine.

use super::board::{Board, Mutation};
use super::host::Host;
use super::plan::{Plan, Told};
use super::printed::Printed;
use pulsetrain_board::lease::Lease;
use pulsetrain_core::wire::Command;
use stateright::{Model, Property};
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};

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
    /// So many extensions of the lease may be on their way.
    pub(crate) on_their_way: usize,
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
    /// Portions that the host sends before it hears that there is room: it knows by the clock when items leave a queue.
    pub(crate) guesses: u8,
}

/// A state: two are the same if the parts are, by their hashes.
#[derive(Clone, Debug)]
pub(crate) struct State {
    pub(crate) board: Printed<Board>,
    pub(crate) host: Printed<Host>,
    to_board: VecDeque<Vec<u8>>,
    to_host: VecDeque<Vec<u8>>,
    pub(crate) quanta: u8,
    pub(crate) left: Budget,
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

impl State {
    fn parts(&self) -> impl Hash + Eq + '_ {
        let State { board, host, to_board, to_host, quanta, left } = self;
        (board.hash(), host.hash(), to_board, to_host, quanta, left)
    }

    /// Does something to the board, and puts what it says then on the line.
    fn change_board(&mut self, plan: &Plan, change: impl FnOnce(&mut Board) -> Vec<Vec<u8>>) {
        self.to_host.extend(self.board.change(|board| {
            let said = change(board);
            board.judge(plan);
            said
        }));
    }

    /// Does something to the host, and puts what it says then on the line.
    fn change_host(&mut self, change: impl FnOnce(&mut Host)) {
        self.to_board.extend(self.host.change(|host| {
            change(host);
            host.frames()
        }));
    }
}

impl Hash for State {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        self.parts().hash(hasher);
    }
}

impl PartialEq for State {
    fn eq(&self, other: &State) -> bool {
        self.parts() == other.parts()
    }
}

impl System {
    /// Both have greeted each other, and the switch with the first portion is accepted. Nothing of that is lost.
    fn begin(&self) -> State {
        let mut state = State {
            board: Printed::new(Board::new(&self.plan, self.queue)),
            host: Printed::new(Host::new(&self.plan)),
            to_board: VecDeque::new(),
            to_host: VecDeque::new(),
            quanta: self.quanta,
            left: self.most,
        };
        self.exchange(&mut state, Host::say_hello);
        let setup = self.plan.setup();
        let motors = setup.motor_bytes();
        let configuration = setup.configuration(&motors).expect("two motors");
        self.exchange(&mut state, |host| host.ask(&Command::Configure(configuration)));
        self.exchange(&mut state, |host| host.ask(&Command::Arm));
        self.exchange(&mut state, |host| {
            for motor in 0..self.plan.motors() {
                let told = self.plan.next(motor, host.told[motor]).expect("a first portion");
                host.append(&self.plan, motor, told);
            }
            host.switch(&self.plan, self.mutation);
        });
        assert_eq!(state.board.ledger.told, state.host.told, "the switch was made");
        state
    }

    fn exchange(&self, state: &mut State, change: impl FnOnce(&mut Host)) {
        state.change_host(change);
        while !state.to_board.is_empty() || !state.to_host.is_empty() {
            self.reach_board(state, Fate::Arrives);
            self.reach_host(state, Fate::Arrives);
        }
    }

    fn reach_board(&self, state: &mut State, fate: Fate) {
        let Some(mut frame) = state.to_board.pop_front() else { return };
        if fate == Fate::Damaged {
            damage(&mut frame);
        }
        if fate != Fate::Vanishes {
            state.change_board(&self.plan, |board| board.receive(&frame, self.mutation));
        }
    }

    fn reach_host(&self, state: &mut State, fate: Fate) {
        let Some(frame) = state.to_host.pop_front() else { return };
        // A host does nothing about a frame that is damaged.
        if fate == Fate::Arrives {
            state.change_host(|host| host.receive(&self.plan, &frame));
        }
    }

    /// What the host says.
    fn say(&self, host: &mut Host, step: Step) {
        match step {
            Step::Append(motor, told) => host.append(&self.plan, motor, told),
            Step::Extend(lease) => host.extend(lease, self.mutation),
            Step::Trim => host.trim(&self.plan, self.mutation),
            Step::Brake => host.brake(self.mutation),
            Step::AskStatus => host.ask_status(),
            Step::Repeat => host.lose_patience(),
            Step::Board(_) | Step::Host(_) | Step::Tick => {}
        }
    }
}

/// The last byte before the end is another one, and not the end.
fn damage(frame: &mut [u8]) {
    if let [.., last, 0] = frame {
        *last = if *last == 0x55 { 0x54 } else { 0x55 };
    }
}

impl Model for System {
    type State = State;
    type Action = Step;

    fn init_states(&self) -> Vec<State> {
        vec![self.begin()]
    }

    fn actions(&self, state: &State, steps: &mut Vec<Step>) {
        let State { board, host, left, to_board, to_host, quanta } = state;
        if *quanta > 0 {
            for motor in 0..self.plan.motors() {
                let told = host.can_append(&self.plan, motor, left.guesses > 0);
                steps.extend(told.map(|told| Step::Append(motor, told)));
            }
            steps.extend(host.can_extend(&self.plan, board.now(), self.on_their_way, self.mutation).map(Step::Extend));
            if left.trims > 0 && host.can_trim() {
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
        // The link waits for longer than a frame and its answer take, but a board may be slow.
        if left.repeats > 0 && host.link.deadline().is_some() && to_board.is_empty() {
            steps.push(Step::Repeat);
        }
        if !to_board.is_empty() {
            steps.push(Step::Board(Fate::Arrives));
            if left.lost > 0 {
                steps.push(Step::Board(Fate::Vanishes));
            }
            if left.damaged > 0 {
                steps.push(Step::Board(Fate::Damaged));
            }
        }
        if !to_host.is_empty() {
            steps.push(Step::Host(Fate::Arrives));
            if left.lost > 0 {
                steps.push(Step::Host(Fate::Vanishes));
            }
        }
    }

    fn next_state(&self, last: &State, step: Step) -> Option<State> {
        let mut state = last.clone();
        match step {
            Step::Append(motor, told) => {
                let is_guess = last.host.can_append(&self.plan, motor, false) != Some(told);
                state.left.guesses -= u8::from(is_guess);
            }
            Step::Trim => state.left.trims -= 1,
            Step::Brake => state.left.brakes -= 1,
            Step::AskStatus => state.left.statuses -= 1,
            Step::Repeat => state.left.repeats -= 1,
            Step::Tick => state.quanta -= 1,
            Step::Board(fate) | Step::Host(fate) => state.left.spend(fate),
            Step::Extend(_) => {}
        }
        match step {
            Step::Tick => {
                state.change_board(&self.plan, |board| board.run(board.now() + self.quantum - 1));
            }
            Step::Board(fate) => self.reach_board(&mut state, fate),
            Step::Host(fate) => self.reach_host(&mut state, fate),
            _ => state.change_host(|host| self.say(host, step)),
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<System>> {
        self.all_properties()
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
