//! Turns the events of one motor into words on its tape. The board decides when words are written, and how far ahead.

use super::{COILS_OVERHEAD, Expand, LONGEST_WAIT, STEP_DIR_OVERHEAD, Stretch, Tape, WAIT_BITS};
use crate::channel::{Channel, EventKind, StepBudget, StepEvent};
use crate::output::{Edge, Output};
use crate::packed_queue::PackedQueue;
use crate::queue::Items;
use crate::{Direction, Recurrence, Tick32};

/// How far [`WordWriter::fill`] came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filled {
    /// Up to the tick of the call.
    All,
    /// Less far: the tape was full, or the allowed number of words was written.
    Part,
}

/// Writes the words of one motor, from its channel and its output, with `F` fraction bits.
///
/// A change of DIR is a word of its own, which lasts [`WordWriter::overhead`] at least. So the `output` of [`new`](WordWriter::new) must have
/// a set-up time of at least that.
#[derive(Clone, Debug)]
pub struct WordWriter<const F: u32> {
    channel: Channel<F>,
    output: Output,
    /// How long a word lasts in addition to its wait, ticks.
    overhead: u32,
    /// The levels of the lines after the last word, and the line that a pulse sets; 0 for coils.
    levels: u32,
    step: u32,
    /// The tick at which the last word changes the lines.
    end: Tick32,
    /// The tick at which the last step, or the release of coils, is over.
    busy: Option<Tick32>,
    setup_cut_short: bool,
}

/// A word to be written.
#[derive(Clone, Copy)]
struct Due {
    tick: Tick32,
    bits: u32,
    sign: i32,
}

impl<const F: u32> WordWriter<F> {
    /// A motor at rest at position 0, all lines low. A driver has lines 0 and 1; `step_line` is that of STEP, and a pulse lasts
    /// `pulse_ticks`. Coils have four of the lines 0 to 6.
    #[must_use]
    pub const fn new(output: Output, step_line: u8, pulse_ticks: u32) -> WordWriter<F> {
        let (overhead, step) = match output {
            Output::StepDir(_) => (STEP_DIR_OVERHEAD + pulse_ticks, 1 << (step_line & 1)),
            Output::Coils(_) => (COILS_OVERHEAD, 0),
        };
        let asserts_every_step = output.asserts_every_step();
        WordWriter {
            channel: Channel::new(overhead, asserts_every_step),
            output,
            overhead,
            levels: 0,
            step,
            end: Tick32(0),
            busy: None,
            setup_cut_short: false,
        }
    }

    /// How long a word lasts in addition to its wait, ticks. Steps cannot be closer than that.
    #[must_use]
    pub const fn overhead(&self) -> u32 {
        self.overhead
    }

    /// Whether its steps are pulses, and not patterns of coils.
    #[must_use]
    pub const fn makes_pulses(&self) -> bool {
        self.step != 0
    }

    /// The channel: position, horizon, epoch.
    #[must_use]
    pub const fn channel(&self) -> &Channel<F> {
        &self.channel
    }

    /// Mutable access to the channel, to switch it.
    pub const fn channel_mut(&mut self) -> &mut Channel<F> {
        &mut self.channel
    }

    /// The tick at which the last word changes the lines. The state machine has something to do until [`overhead`](WordWriter::overhead)
    /// ticks after it.
    #[must_use]
    pub const fn end(&self) -> Tick32 {
        self.end
    }

    /// Whether a DIR edge came less than its set-up before a step, because the plan left no time for it.
    #[must_use]
    pub const fn setup_cut_short(&self) -> bool {
        self.setup_cut_short
    }

    /// Sets [`setup_cut_short`](WordWriter::setup_cut_short) back to `false`.
    pub const fn clear_faults(&mut self) {
        self.setup_cut_short = false;
    }

    /// The lines after the last word.
    #[must_use]
    pub const fn levels(&self) -> u32 {
        self.levels
    }

    /// Whether nothing is left to do by `now`: no step, no end of a pulse, no release of coils.
    #[must_use]
    pub fn is_idle(&self, packed: &PackedQueue, now: Tick32) -> bool {
        let rests = self.busy.is_none_or(|busy| !now.is_before(busy)) && self.output.pending_tick().is_none();
        rests && self.channel.is_done() && !packed.has(self.channel.epoch())
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks.
    pub fn pass(&mut self, now: Tick32) {
        if self.busy.is_some_and(|busy| !now.is_before(busy)) {
            self.busy = None;
        }
    }

    /// Notes that coils are off. The caller switches the lines off, while the state machine is stopped.
    pub fn release(&mut self) {
        if let Output::Coils(coils) = &mut self.output {
            coils.switch_off();
            self.levels = 0;
        }
    }

    /// Begins a tape with one word, which waits for `wait` and leaves the lines as they are. The tick at which it begins is not known yet:
    /// call [`start`](WordWriter::start) next, with that tick.
    pub fn begin<const N: usize, const RUNS: usize>(
        &mut self,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        wait: u32,
    ) {
        self.end = Tick32(STEP_DIR_OVERHEAD).before(self.overhead);
        tape.begin(self.end, self.channel.position());
        self.put(
            tape,
            memory,
            Due { tick: self.end.after(wait).after(self.overhead), bits: self.idle_bits(), sign: 0 },
        );
    }

    /// The first word began at tick `at`: its lines change `wait` + [`STEP_DIR_OVERHEAD`] ticks later, whatever the motor.
    pub fn start<const N: usize, const RUNS: usize>(&mut self, tape: &mut Tape<N, RUNS>, at: Tick32) {
        tape.set_start(at);
        self.end = self.end.after(at.0);
        self.channel.pass(self.end.after(self.overhead));
    }

    /// Stops at once. `position` and `lines` are those after the last word that the state machine did. Coils stay as they are: on, at the
    /// phase of this position, or off.
    pub fn stop(&mut self, items: &mut impl Items, position: i32, lines: u32) {
        self.channel.stop(items);
        self.channel.set_position(position);
        self.output.set_position(position);
        self.busy = None;
        if let Output::Coils(coils) = &mut self.output {
            if lines == 0 {
                coils.switch_off()
            } else {
                coils.switch_on()
            }
            self.levels = coils.levels();
        }
    }

    /// Writes words for all steps up to tick `until`, but only `most` words or a few more. If steps end earlier, a word for rest gives the
    /// state machine something to do until tick `least`, which is not after `until`.
    ///
    /// Both ticks go up from call to call, by less than 2^24. `items` are the motor's: a [`PackedQueue`] with its memory, or items that the
    /// board works out itself. `expand` is the board's own, or [`expand`](super::expand()).
    pub fn fill<const N: usize, const RUNS: usize>(
        &mut self,
        items: &mut impl Items,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        [least, until]: [Tick32; 2],
        most: u32,
        expand: Expand,
    ) -> Filled {
        // The next word can change the lines `overhead` after `until` at the earliest, so this one must serve all events before that.
        let limit = until.after(self.overhead);
        // It looks ahead by as much as a DIR edge may come before its step, and the release of coils before the next step.
        let look = limit.after(self.output.lead_ticks()).after(self.overhead);
        let stop = tape.written().wrapping_add(most);
        self.write_following_steps(items, tape, memory, [limit, Tick32(stop)], expand);
        loop {
            if !tape.has_room(2) || !Tick32(tape.written()).is_before(Tick32(stop)) {
                return Filled::Part;
            }
            if self.output.pending_tick().is_none() && self.channel.waits_beyond(look) {
                break;
            }
            let event = self.peek(items, look);
            if let (Output::Coils(_), Some(release)) = (&self.output, self.output.pending_tick())
                && event.is_none_or(|event| release.is_before(event.tick))
            {
                // If the coils' next step comes within a word's time, there is no time to switch them off before it.
                let at_once = event.is_some_and(|event| event.tick.is_before(release.after(self.overhead)));
                let made_now = event.is_some_and(|event| !limit.is_before(event.tick));
                if until.is_before(release) && !(at_once && made_now) {
                    break;
                }
                if let Some(edge) = self.output.take_pending() {
                    self.change(edge);
                }
                if !at_once {
                    self.put(tape, memory, Due { tick: release, bits: self.idle_bits(), sign: 0 });
                    self.busy = Some(release);
                    self.channel.pass(release.after(self.overhead - 1));
                }
                continue;
            }
            let Some(event) = event.filter(|event| !limit.is_before(self.output.due(*event))) else { break };
            if event.kind == EventKind::Step {
                // If the segment continues the one before it, its first step can be written together with the others.
                let before = tape.written();
                self.write_following_steps(items, tape, memory, [limit, Tick32(stop)], expand);
                if tape.written() != before {
                    continue;
                }
            }
            if let Some(due) = self.make(event) {
                self.put(tape, memory, due);
                if event.kind == EventKind::Step {
                    self.write_following_steps(items, tape, memory, [limit, Tick32(stop)], expand);
                }
            }
        }
        if self.end.is_before(least) {
            self.wait(tape, memory, until, limit);
        }
        Filled::All
    }

    /// Writes a word that leaves the lines as they are, up to `until`. Later words change the lines at `limit` or later.
    #[inline(never)]
    fn wait<const N: usize, const RUNS: usize>(
        &mut self,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        until: Tick32,
        limit: Tick32,
    ) {
        // The release of coils is not an event of the channel, so this word must leave time for it.
        let release = if let Output::Coils(_) = self.output { self.output.pending_tick() } else { None };
        let tick = match release {
            Some(release) if release.is_before(limit) => release.before(self.overhead),
            _ => until,
        };
        if !tick.is_before(self.end.after(self.overhead)) {
            self.put(tape, memory, Due { tick, bits: self.idle_bits(), sign: 0 });
        }
        self.channel.pass(limit);
    }

    // The next two are not inlined, so that a run's steps, which need neither, have all registers of the processor.
    #[inline(never)]
    fn peek(&mut self, items: &mut impl Items, look: Tick32) -> Option<StepEvent> {
        self.channel.peek(items, look)
    }

    /// Handles an event. Returns its word if the lines change.
    #[inline(never)]
    fn make(&mut self, event: StepEvent) -> Option<Due> {
        let due = self.output.due(event);
        self.channel.take(event);
        let open = self.end.after(self.overhead);
        let tick = if due.is_before(open) { open } else { due };
        let edge = self.output.apply(event, tick);
        match event.kind {
            EventKind::Direction(_) => {
                let before = self.levels;
                self.change(edge);
                if self.levels == before {
                    return None;
                }
                self.setup_cut_short |= tick != due;
                // If there is no time for a word of its own, the step's word changes DIR, too.
                let fits = !event.tick.is_before(tick.after(self.overhead));
                fits.then_some(Due { tick, bits: self.idle_bits(), sign: 0 })
            }
            EventKind::Step => {
                if self.step == 0 {
                    self.change(edge);
                } else {
                    // The end of the pulse is in the same word.
                    self.output.take_pending();
                }
                self.busy = Some(tick.after(self.overhead));
                Some(Due { tick, bits: self.step_bits(), sign: self.sign() })
            }
        }
    }

    /// Writes the steps that follow the last word, if that was a step, as long as nothing else comes between, up to word number `stop`.
    #[inline(always)]
    fn write_following_steps<const N: usize, const RUNS: usize>(
        &mut self,
        items: &mut impl Items,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        limits: [Tick32; 2],
        expand: Expand,
    ) {
        if self.end != self.channel.place().tick {
            return;
        }
        // The steps of verbs come by ones and twos. For these, `write_runs` gains nothing.
        if self.step != 0 && items.run_direction().is_some() && self.channel.is_run_until(limits[0]) {
            self.write_runs(items, tape, memory, limits, expand);
        } else {
            self.write_run(tape, memory, limits, expand);
        }
    }

    /// Writes run after run, with as little work between them as possible. In a motion whose speed changes fast, a processor spends most of its
    /// time here.
    #[inline(never)]
    fn write_runs<const N: usize, const RUNS: usize>(
        &mut self,
        items: &mut impl Items,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        [limit, stop]: [Tick32; 2],
        expand: Expand,
    ) {
        let (bits, sign) = (self.step_bits(), self.sign());
        let before = tape.written();
        while tape.has_room(2) && Tick32(tape.written()).is_before(stop) {
            let (at, len) = tape.space(sign);
            let Some(words) = memory.get_mut(at..at + len) else { break };
            let (tick, position) = (self.channel.place().tick, self.channel.position());
            let taken = self.channel.take_run_steps(items, limit, |recurrence, budget| {
                expand_into(words, bits, expand, recurrence, budget)
            });
            if taken == 0 {
                break;
            }
            tape.wrote(taken, tick, position, sign);
        }
        if tape.written() != before {
            self.channel.end_run_steps();
            self.end = self.channel.place().tick;
            self.busy = Some(self.end.after(self.overhead));
        }
    }

    /// Writes steps of the current run, for any motor.
    #[inline(never)]
    fn write_run<const N: usize, const RUNS: usize>(
        &mut self,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        [limit, stop]: [Tick32; 2],
        expand: Expand,
    ) {
        let (bits, limit) = match &self.output {
            Output::StepDir(_) => (self.step_bits(), limit),
            // A step before the release of the coils keeps them on.
            Output::Coils(coils) => match coils.release_ticks().map(|ticks| self.end.after(ticks)) {
                Some(release) if release.is_before(limit) => (0, release),
                _ => (0, limit),
            },
        };
        let sign = self.sign();
        while tape.has_room(2) && Tick32(tape.written()).is_before(stop) {
            let (at, len) = tape.space(sign);
            let (tick, position) = (self.end, self.channel.position());
            let Some(words) = memory.get_mut(at..at + len) else { return };
            let taken = self
                .channel
                .take_steps(limit, |recurrence, budget| expand_into(words, bits, expand, recurrence, budget));
            if taken == 0 {
                return;
            }
            let made = usize::try_from(taken).map_or(len, |taken| taken.min(len));
            self.end = self.channel.place().tick;
            if let (Output::Coils(coils), Some(words)) = (&mut self.output, words.get_mut(..made)) {
                coils.run(words, WAIT_BITS, self.end);
                self.levels = coils.levels();
            }
            tape.wrote(taken, tick, position, sign);
            self.busy = Some(self.end.after(self.overhead));
            // The next step is later, or of another item.
            if made < len {
                return;
            }
        }
    }

    /// Writes a word. Its wait has 25 bits at most, because `until` goes up by less than 2^24 ticks.
    #[inline(never)]
    fn put<const N: usize, const RUNS: usize>(&mut self, tape: &mut Tape<N, RUNS>, memory: &mut [u32; N], due: Due) {
        let wait = due.tick.since(self.end).wrapping_sub(self.overhead);
        let (at, _) = tape.space(due.sign);
        if let Some(word) = memory.get_mut(at) {
            *word = wait & LONGEST_WAIT | due.bits;
        }
        tape.wrote(1, self.end, self.channel.position().wrapping_sub(due.sign), due.sign);
        self.end = due.tick;
    }

    fn change(&mut self, edge: Edge) {
        self.levels = self.levels & !edge.clear | edge.set;
    }

    fn sign(&self) -> i32 {
        match self.channel.direction() {
            Direction::Forward => 1,
            Direction::Backward => -1,
        }
    }

    /// The line bits of a word that leaves the lines as they are.
    const fn idle_bits(&self) -> u32 {
        if self.step == 0 { self.levels << WAIT_BITS } else { (self.levels | self.levels << 2) << WAIT_BITS }
    }

    /// The line bits of a word with a step.
    const fn step_bits(&self) -> u32 {
        self.idle_bits() | self.step << WAIT_BITS
    }
}

/// Moves a recurrence on by the next steps of a run, and writes a word for each, as many as fit in `words` and in the channel's `budget`.
/// Returns the number of steps.
#[inline(always)]
fn expand_into(words: &mut [u32], bits: u32, expand: Expand, recurrence: &mut Recurrence, budget: StepBudget) -> u32 {
    let most = usize::try_from(budget.max_steps).unwrap_or(usize::MAX);
    let room = words.len().min(most);
    let Some(words) = words.get_mut(..room) else { return 0 };
    if room == 0 {
        return 0;
    }
    // A word cannot wait longer than LONGEST_WAIT.
    let stretch = Stretch { gap: budget.gap, ticks: budget.ticks.min(LONGEST_WAIT), bits };
    expand(recurrence, words, &stretch)
}
