//! What must hold in each state, and what must happen in one.

use super::board::{Board, Ledger, Verdict};
use super::host::{Asked, Belief, Host};
use super::plan::{PULL_IN_TICKS, Plan, Steps};
use super::system::{State, System};
use pulsetrain_board::lease::{Lease, LeaseState};
use pulsetrain_core::lease::LapseCause;
use stateright::Property;

impl System {
    pub(crate) fn all_properties(&self) -> Vec<Property<System>> {
        let mut all = vec![
            always("each step before the lease's end is made at its tick, once", |_, state| {
                state.board.verdict.makes_the_plan
            }),
            always("after it each motor makes the stop that the host replays", |_, state| {
                state.board.verdict.makes_the_stop
            }),
            always("no motor stops dead", |_, state| !state.board.verdict.stops_dead),
            always("a host never believes a wrong count", |system, state| state.belief_is_right(&system.plan)),
            always("who has heard the last word knows the count", |system, state| {
                state.last_word_is_enough(&system.plan)
            }),
            always("what was accepted holds, and nothing else", |_, state| state.board.verdict.holds_what_was_accepted),
            always("what the host holds for sure was accepted", |_, state| state.host_is_modest()),
            always("the lease ends no later than what the board was told", |_, state| {
                state.board.verdict.lease_is_covered
            }),
            always("no trim reaches below the horizon", |_, state| !state.board.ledger.seen.bad_trim),
            always("nothing is at fault", |_, state| {
                !state.board.verdict.has_faults && !state.host.is_refused && state.host.link.error().is_none()
            }),
            always("all rest in the end", |_, state| state.quanta > 0 || state.board.rests()),
            Property::eventually("all come to rest", |_, state: &State| state.board.verdict.is_final),
            sometimes("a run finishes", |_, state| state.is_finished()),
            sometimes("a lease lapses, and motors brake", |_, state| {
                matches!(
                    state.board.lease(),
                    LeaseState::Lapsed { cause: LapseCause::NotExtended, in_motion: true, .. }
                )
            }),
            sometimes("an extension comes just in time", |_, state| state.board.ledger.seen.just_in_time),
            sometimes("an extension is refused", |_, state| state.board.ledger.seen.refused),
            sometimes("the host does not know which of two counts it is", |system, state| {
                state.board.verdict.is_final
                    && matches!(state.host.belief(&system.plan), Belief::OneOf(counts) if counts.windows(2).any(|two| two[0] != two[1]))
            }),
        ];
        if self.most.lost > 0 {
            all.push(sometimes("a frame is lost, and the run finishes", |system, state| {
                state.left.lost < system.most.lost && state.is_finished()
            }));
        }
        if self.most.lost + self.most.damaged > 0 {
            all.push(sometimes("a frame comes before its turn", |_, state| state.board.ledger.seen.gap));
        }
        if self.most.repeats > 0 {
            all.push(sometimes("an extension comes again", |_, state| state.board.ledger.seen.repeat));
        }
        if self.most.statuses > 0 {
            all.push(sometimes("the host hears the last word", |_, state| {
                state.host.heard_rest && state.board.verdict.is_final
            }));
        }
        if self.most.guesses > 0 {
            all.push(sometimes("a queue is full", |_, state| state.board.ledger.seen.no_room));
        }
        if self.most.trims > 0 {
            all.push(sometimes("a trim succeeds, and the other plan is done", |_, state| {
                state.board.ledger.told[0].is_cut && state.is_finished()
            }));
            all.push(sometimes("a trim is refused", |_, state| state.board.ledger.seen.trim_refused));
        }
        if self.most.brakes > 0 {
            all.push(sometimes("motors brake since the host said so", |_, state| {
                matches!(state.board.lease(), LeaseState::Lapsed { cause: LapseCause::Ordered, in_motion: true, .. })
            }));
            all.push(sometimes("nobody knows whether the order to brake came", |system, state| {
                state.board.verdict.is_final && state.host.belief(&system.plan) == Belief::Unknown
            }));
        }
        all
    }
}

fn always(name: &'static str, holds: fn(&System, &State) -> bool) -> Property<System> {
    Property::always(name, holds)
}

fn sometimes(name: &'static str, happens: fn(&System, &State) -> bool) -> Property<System> {
    Property::sometimes(name, happens)
}

impl Board {
    /// Works the verdict out.
    pub(crate) fn judge(&mut self, plan: &Plan) {
        self.verdict = Verdict {
            makes_the_plan: self.makes_the_plan(plan),
            makes_the_stop: self.makes_the_stop(plan),
            stops_dead: self.stops_dead(),
            holds_what_was_accepted: self.holds_what_was_accepted(),
            lease_is_covered: self.lease_is_covered(plan),
            has_faults: self.has_faults(),
            is_final: self.is_final(plan),
        };
    }

    /// Since when the lease is over, if it is.
    fn lapsed(&self) -> Option<u64> {
        match self.lease() {
            LeaseState::Lapsed { at, .. } => Some(at),
            LeaseState::Off | LeaseState::Until(_) | LeaseState::Last => None,
        }
    }

    fn makes_the_plan(&self, plan: &Plan) -> bool {
        let until = self.lapsed().map_or(self.now(), |at| at.min(self.now()));
        self.log.iter().zip(&self.ledger.told).enumerate().all(|(motor, (steps, told))| {
            let planned = plan.steps(motor, *told);
            let planned = planned.iter().take_while(|(tick, _)| *tick < until);
            planned.eq(steps.iter().take_while(|(tick, _)| *tick < until))
        })
    }

    fn makes_the_stop(&self, plan: &Plan) -> bool {
        let Some(at) = self.lapsed() else { return true };
        let replayed = plan.replay(&self.ledger.told, Lease::Until(at));
        let made = |steps: &Steps| steps.iter().take_while(|(tick, _)| *tick < self.now()).copied().collect::<Steps>();
        self.log.iter().eq(&replayed.iter().map(made).collect::<Vec<_>>())
    }

    /// A motor rests after an interval at which it may not, or slows down too much from one step to the next.
    fn stops_dead(&self) -> bool {
        let is_dead = |steps: &Steps| {
            let intervals: Vec<u64> = steps.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
            let is_abrupt = |pair: &[u64]| pair[0] < PULL_IN_TICKS && 2 * pair[1] > 3 * pair[0];
            let rests_fast = self.rests() && intervals.last().is_some_and(|last| *last < PULL_IN_TICKS);
            rests_fast || intervals.windows(2).any(is_abrupt)
        };
        self.log.iter().any(is_dead)
    }

    fn holds_what_was_accepted(&self) -> bool {
        let Ledger { lease, braked, .. } = self.ledger;
        match (self.lease(), lease) {
            (LeaseState::Until(until), Lease::Until(accepted))
            | (LeaseState::Lapsed { at: until, cause: LapseCause::NotExtended, .. }, Lease::Until(accepted)) => {
                braked.is_none() && until == accepted
            }
            (LeaseState::Last, Lease::Last) => braked.is_none(),
            (LeaseState::Lapsed { at, cause: LapseCause::Ordered, .. }, _) => braked == Some(at),
            // The switch that begins it waits.
            (LeaseState::Off, _) => self.log.iter().all(Vec::is_empty),
            _ => false,
        }
    }

    fn lease_is_covered(&self, plan: &Plan) -> bool {
        match (self.ledger.lease, plan.longest_lease(&self.ledger.told)) {
            (_, Lease::Last) => true,
            (Lease::Until(until), Lease::Until(longest)) => until <= longest,
            (Lease::Last, Lease::Until(_)) => false,
        }
    }

    fn has_faults(&self) -> bool {
        self.has_motor_faults() || matches!(self.lease(), LeaseState::Lapsed { cause, .. } if cause.is_fault())
    }

    fn is_final(&self, plan: &Plan) -> bool {
        let told = &self.ledger.told;
        let is_finished =
            || self.lease() == LeaseState::Last && (0..plan.motors()).all(|motor| plan.is_told(motor, told[motor]));
        self.rests() && (self.lapsed().is_some() || is_finished())
    }
}

impl State {
    /// The plan was done to its end.
    fn is_finished(&self) -> bool {
        self.board.verdict.is_final && self.board.lease() == LeaseState::Last
    }

    /// Looked at once the motors will not move any more, whatever the host says.
    fn belief_is_right(&self, plan: &Plan) -> bool {
        if !self.board.verdict.is_final {
            return true;
        }
        let counted = self.board.counts();
        match self.host.belief(plan) {
            Belief::Counts(counts) => counts == counted,
            Belief::OneOf(counts) => counts.contains(&counted),
            Belief::Unknown => true,
        }
    }

    fn last_word_is_enough(&self, plan: &Plan) -> bool {
        let Host { heard_rest, extending, asked, .. } = &*self.host;
        let has_heard = *heard_rest && extending.is_empty() && asked.is_none() && self.board.verdict.is_final;
        !has_heard || self.host.belief(plan) == Belief::Counts(self.board.counts())
    }

    fn host_is_modest(&self) -> bool {
        let Host { held, extending, ended, asked, is_over, .. } = &*self.host;
        let accepted = self.board.ledger.lease;
        let is_trim = matches!((asked, accepted), (Some(Asked::Trim(until)), Lease::Until(at)) if *until == at);
        *held == accepted || extending.contains(&accepted) || ended.is_some() || *is_over || is_trim
    }
}
