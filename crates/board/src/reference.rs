//! A board, and as its reference a native board that gets the same items.
//!
//! The board makes the edges. The reference knows the tick for which each step was scheduled.

use crate::lease::{ExtendRefused, Lease, LeaseState, Leased, TrimRefused};
use crate::{Board, Edge, Faults, Native, Observer, ScheduledStep, Sizer, StopReport, SwitchRefused};
use pulsetrain_core::braking::Limit;
use pulsetrain_core::wire::message::Event;
use pulsetrain_core::{Entry, Epoch};
use std::collections::VecDeque;

/// A board and its reference: an observer gets the edges of the board and the scheduled steps of the reference.
#[derive(Debug)]
pub struct WithReference<B> {
    board: B,
    reference: Native,
    /// Whether the reference has accepted everything that the board accepted.
    is_complete: bool,
    /// Steps that the reference scheduled while there was no observer.
    steps: Vec<ScheduledStep>,
    /// The lease of both.
    lease: Option<Lease>,
    /// Extensions that the board has not answered, oldest first. The reference gets an extension once the board has accepted it. Until then the
    /// reference's time does not pass the earliest possible end of the lease.
    extending: VecDeque<(Lease, Vec<Limit>)>,
    /// The board's answers, oldest first, that [`Leased::extended`] has not reported yet.
    extended: VecDeque<bool>,
}

impl<B: Board> WithReference<B> {
    /// `reference` must be new and have the same motors as `board`, and queues as long ([`Native::unbounded`]). Its time is brought to that of the
    /// board, which may have been on for days.
    #[must_use]
    pub fn new(board: B, mut reference: Native) -> WithReference<B> {
        if let Some(last) = board.now().checked_sub(1) {
            reference.advance(last, &mut |_: Edge| {});
        }
        let (extending, extended) = (VecDeque::new(), VecDeque::new());
        WithReference { board, reference, is_complete: true, steps: Vec::new(), lease: None, extending, extended }
    }

    /// The board.
    #[must_use]
    pub const fn board(&self) -> &B {
        &self.board
    }

    /// The board, to send it commands. What is pushed there does not reach the reference.
    pub const fn board_mut(&mut self) -> &mut B {
        &mut self.board
    }

    /// The board, without its reference.
    #[must_use]
    pub fn into_board(self) -> B {
        self.board
    }

    /// Brings the reference to the board's time, but not to `tick`: it can accept a switch only before the switch's tick. The board accepted it in
    /// time, even if its answer was lost and came after that tick when it was repeated.
    fn advance_reference_to_switch(&mut self, tick: u64) {
        let tick = self.earliest_end().map_or(tick, |open| open.min(tick));
        let passed = self.board.now().checked_sub(1).zip(self.reference.last_before_switch(tick));
        if let Some(last) = passed.map(|(now, before)| now.min(before)).filter(|last| self.reference.now() <= *last) {
            self.reference.advance(last, &mut StepBuffer(&mut self.steps));
        }
    }

    /// Brings the reference's time to `until`, but not past the earliest possible end of the lease.
    fn advance_reference(&mut self, until: u64, observer: &mut impl Observer) {
        self.steps.drain(..).for_each(|step| observer.step(step));
        // After an immediate stop the board makes no more steps; the reference must not go on with its plan.
        if matches!(self.board.lost(), Some(crate::RemoteError::Stopped { .. })) {
            return;
        }
        let open = self.earliest_end().map_or(Some(until), |open| self.reference.last_before_switch(open));
        let Some(until) = open.map(|last| last.min(until)) else { return };
        if self.reference.now() <= until {
            self.reference.advance(until, &mut Steps(observer));
        }
    }
}

impl<B> WithReference<B> {
    /// The earliest possible end of the lease while the board has extensions to answer; else `None`.
    fn earliest_end(&self) -> Option<u64> {
        let leases = self.extending.iter().map(|(lease, _)| *lease).chain(self.lease);
        let ends = leases.filter_map(|lease| if let Lease::Until(tick) = lease { Some(tick) } else { None });
        ends.min().filter(|_| !self.extending.is_empty())
    }
}

impl<B: Leased> WithReference<B> {
    /// Takes the board's answers to extensions, and gives the accepted ones to the reference.
    fn take_answers(&mut self) {
        while let Some(accepted) = self.board.extended() {
            if let Some((lease, limits)) = self.extending.pop_front()
                && accepted
            {
                self.is_complete &= self.reference.extend(lease, &limits).is_ok();
                self.lease = Some(lease);
            }
            self.extended.push_back(accepted);
        }
    }
}

/// An observer that keeps the steps for the next observer.
struct StepBuffer<'s>(&'s mut Vec<ScheduledStep>);

impl Observer for StepBuffer<'_> {
    fn edge(&mut self, _edge: Edge) {}

    fn step(&mut self, step: ScheduledStep) {
        self.0.push(step);
    }
}

/// Passes on only the edges: those of the board.
struct Edges<'o, O>(&'o mut O);

impl<O: Observer> Observer for Edges<'_, O> {
    fn edge(&mut self, edge: Edge) {
        self.0.edge(edge);
    }
}

/// Passes on only the steps: those of the reference.
struct Steps<'o, O>(&'o mut O);

impl<O: Observer> Observer for Steps<'_, O> {
    fn edge(&mut self, _edge: Edge) {}

    fn step(&mut self, step: ScheduledStep) {
        self.0.step(step);
    }
}

impl<B: Leased> Board for WithReference<B> {
    fn push(&mut self, motor: usize, entry: Entry) -> Result<(), Entry> {
        self.board.push(motor, entry)?;
        self.is_complete &= self.reference.push(motor, entry).is_ok();
        Ok(())
    }

    fn discard(&mut self, epoch: Epoch) {
        self.board.discard(epoch);
        Board::discard(&mut self.reference, epoch);
    }

    fn room(&self, motor: usize) -> usize {
        self.board.room(motor)
    }

    fn sizer(&self, motor: usize) -> Sizer {
        self.board.sizer(motor)
    }

    fn round_trip(&self) -> u64 {
        self.board.round_trip()
    }

    fn delivery(&self, bytes: usize) -> u64 {
        self.board.delivery(bytes)
    }

    fn repetition(&self) -> u64 {
        self.board.repetition()
    }

    fn horizon(&self) -> u64 {
        self.board.horizon()
    }

    fn now(&self) -> u64 {
        self.board.now()
    }

    fn epoch(&self) -> Epoch {
        self.board.epoch()
    }

    fn advance(&mut self, until: u64, observer: &mut impl Observer) {
        self.board.advance(until, &mut Edges(observer));
        self.take_answers();
        self.advance_reference(until, observer);
    }

    fn stop_now(&mut self, tick: u64, observer: &mut impl Observer) -> StopReport {
        let report = self.board.stop_now(tick, &mut Edges(observer));
        self.take_answers();
        self.advance_reference(report.tick, observer);
        self.reference.stop_now(report.tick, &mut Steps(observer));
        report
    }

    fn positions(&self) -> Vec<i64> {
        self.board.positions()
    }

    fn is_idle(&self) -> bool {
        self.board.is_idle()
    }

    fn faults(&self, motor: usize) -> Faults {
        self.board.faults(motor)
    }

    fn events(&mut self) -> Vec<Event> {
        self.board.events()
    }

    fn lost(&self) -> Option<&crate::RemoteError> {
        self.board.lost()
    }

    fn record_is_complete(&self) -> bool {
        self.is_complete && self.board.record_is_complete()
    }

    fn final_report(&mut self) -> Result<crate::AtRest, crate::RemoteError> {
        self.board.final_report()
    }
}

impl<B: Leased> Leased for WithReference<B> {
    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[Limit]) -> Result<(), SwitchRefused> {
        self.await_extensions();
        let answer = self.board.switch(epoch, tick, lease, limits);
        self.advance_reference_to_switch(tick);
        match answer {
            Ok(()) => {
                self.is_complete &= self.reference.switch(epoch, tick, lease, limits).is_ok();
                self.lease = Some(lease);
            }
            Err(_) => Board::discard(&mut self.reference, epoch),
        }
        answer
    }

    fn extend(&mut self, lease: Lease, limits: &[Limit]) -> Result<(), ExtendRefused> {
        self.board.extend(lease, limits)?;
        self.extending.push_back((lease, limits.to_vec()));
        self.take_answers();
        Ok(())
    }

    fn trim(&mut self, until: u64, items: &[usize]) -> Result<(), TrimRefused> {
        self.await_extensions();
        self.board.trim(until, items)?;
        self.is_complete &= self.reference.trim(until, items).is_ok();
        self.lease = Some(Lease::Until(until));
        Ok(())
    }

    fn brake(&mut self) -> Option<u64> {
        let at = self.board.brake();
        self.take_answers();
        let at = at?;
        // The reference's time is behind the board's, so it can still brake at the same tick.
        self.reference.brake_at(at);
        Some(at)
    }

    fn lease(&self) -> LeaseState {
        self.board.lease()
    }

    fn extended(&mut self) -> Option<bool> {
        self.extended.pop_front()
    }

    fn await_extensions(&mut self) {
        self.board.await_extensions();
        self.take_answers();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Config, MotorConfig, Wiring};
    use pulsetrain_core::{Direction, Item, Segment, Tick32};

    fn config() -> Config {
        let wiring = Wiring::StepDir { step: 8, dir: 9, forward_high: true, pulse_ticks: 10, setup_ticks: 5 };
        Config { fraction_bits: 16, motors: vec![MotorConfig { wiring, pull_in_ticks: 1000 }] }
    }

    #[derive(Default)]
    struct Seen {
        rises: usize,
        steps: usize,
    }

    impl Observer for Seen {
        fn edge(&mut self, edge: Edge) {
            self.rises += usize::from(edge.line == 8 && edge.level);
        }

        fn step(&mut self, _: ScheduledStep) {
            self.steps += 1;
        }
    }

    /// Pushes so many runs of one step each before any time passes. Returns what an observer saw, and whether the reference has everything.
    fn run_all(runs: usize, reference: Native) -> (Seen, bool) {
        let mut board = WithReference::new(Native::unbounded(&config()).expect("it can be wired so"), reference);
        let segment = Segment { count: 1, interval: 100 << 16, add: 0, add2: 0 };
        let run = Item::Run { segment, direction: Direction::Forward };
        for item in [Item::Anchor { tick: Tick32(0) }].into_iter().chain(std::iter::repeat_n(run, runs)) {
            board.push(0, Entry { epoch: Epoch(0), item }).expect("it has room");
        }
        let mut seen = Seen::default();
        board.advance(100 * (runs as u64 + 1), &mut seen);
        (seen, board.record_is_complete())
    }

    #[test]
    fn a_shadow_holds_what_the_board_holds_or_says_that_it_does_not() {
        let (seen, agrees) = run_all(5000, Native::unbounded(&config()).expect("it can be wired so"));
        assert_eq!((seen.rises, seen.steps, agrees), (5000, 5000, true));
        let (seen, agrees) = run_all(5000, Native::new(&config()).expect("it can be wired so"));
        assert_eq!(seen.rises, 5000);
        assert!(seen.steps < 5000 && !agrees, "{} steps", seen.steps);
    }
}
