//! Turns channel and output of one motor into words on its tape. The board decides when they are written, and how far
//! ahead.

use super::{COILS_OVERHEAD, Expand, LONGEST_WAIT, STEP_DIR_OVERHEAD, Stretch, Tape, WAIT_BITS};
use crate::channel::{Ahead, Channel, EventKind, StepEvent};
use crate::output::{Edge, Output};
use crate::packed_queue::PackedQueue;
use crate::queue::Items;
use crate::{Direction, Recurrence, Tick32};

/// How far [`Words::fill`] came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filled {
    /// Up to the tick of the call.
    All,
    /// To the end of the room that there was, or of the work that was allowed.
    Part,
}

/// The channel and the output of one motor, with `F` fraction bits. It writes words.
///
/// A DIR line is set up by a word of its own, which must end before the step: set-up times below [`Words::overhead`] are made
/// as long as that by whoever makes the output.
#[derive(Clone, Debug)]
pub struct Words<const F: u32> {
    channel: Channel<F>,
    output: Output,
    /// How long a word lasts in addition to its wait, ticks.
    overhead: u32,
    /// The lines after the last word, and what a step adds to them for a pulse.
    levels: u32,
    step: u32,
    /// The tick at which the last word changes the lines.
    end: Tick32,
    /// Until when the last step, or the release of coils, takes.
    busy: Option<Tick32>,
    setup_cut_short: bool,
}

/// A word that is due.
#[derive(Clone, Copy)]
struct Due {
    tick: Tick32,
    bits: u32,
    sign: i32,
}

impl<const F: u32> Words<F> {
    /// A motor at rest at position 0, all lines low. The lines of a driver are 0 and 1, `step_line` being that of STEP, and
    /// its pulses `pulse_ticks` long; the lines of coils are four of 0 to 6.
    #[must_use]
    pub const fn new(output: Output, step_line: u8, pulse_ticks: u32) -> Words<F> {
        let (overhead, step) = match output {
            Output::StepDir(_) => (STEP_DIR_OVERHEAD + pulse_ticks, 1 << (step_line & 1)),
            Output::Coils(_) => (COILS_OVERHEAD, 0),
        };
        let asserts_every_step = output.asserts_every_step();
        Words {
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

    /// Whether its steps are pulses; else patterns of coils.
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

    /// When the lines change in the last word: the state machine has something to do up to then, and [`overhead`](Words::overhead)
    /// longer.
    #[must_use]
    pub const fn end(&self) -> Tick32 {
        self.end
    }

    /// Whether a DIR edge could not come its set-up before the step: the plan left no room for it.
    #[must_use]
    pub const fn setup_cut_short(&self) -> bool {
        self.setup_cut_short
    }

    /// Forgets that.
    pub const fn forgive(&mut self) {
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
        let rests = self.busy.is_none_or(|busy| !now.is_before(busy)) && self.output.owed().is_none();
        rests && self.channel.is_done() && !packed.has(self.channel.epoch())
    }

    /// Notes that time is past `now`. To be called at least once in 2^30 ticks.
    pub fn pass(&mut self, now: Tick32) {
        if self.busy.is_some_and(|busy| !now.is_before(busy)) {
            self.busy = None;
        }
    }

    /// Switches coils off while no words are done. The caller does the same to the lines.
    pub fn release(&mut self) {
        if let Output::Coils(coils) = &mut self.output {
            coils.switch_off();
            self.levels = 0;
        }
    }

    /// Begins a tape, with one word that waits for `wait` and leaves the lines as they are. When it begins is said later: by
    /// [`start`](Words::start), which comes next.
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

    /// Stops: nothing more is taken. The position is what was made, and the lines of coils stay as they were in the last word
    /// that was done: on at that position's phase, or off.
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

    /// Writes words up to tick `until`, `most` of them or a few more: every step up to then is made, and the state machine has
    /// something to do until tick `least` at least, which is not after it.
    ///
    /// Both go up from call to call, by less than 2^24 ticks. `items` are the motor's: a [`PackedQueue`] with its memory, or what a board
    /// has worked out itself. `expand` is the board's, or [`expand`](super::expand()).
    pub fn fill<const N: usize, const RUNS: usize>(
        &mut self,
        items: &mut impl Items,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        [least, until]: [Tick32; 2],
        most: u32,
        expand: Expand,
    ) -> Filled {
        // A word that begins after `until` is over would be too late for events before that.
        let limit = until.after(self.overhead);
        // As far as a DIR edge may come before its step, and coils' release before the next one.
        let look = limit.after(self.output.lead_ticks()).after(self.overhead);
        let stop = tape.written().wrapping_add(most);
        self.go_on(items, tape, memory, [limit, Tick32(stop)], expand);
        loop {
            if !tape.has_room(2) || !Tick32(tape.written()).is_before(Tick32(stop)) {
                return Filled::Part;
            }
            if self.output.owed().is_none() && self.channel.waits_beyond(look) {
                break;
            }
            let event = self.peek(items, look);
            if let (Output::Coils(_), Some(release)) = (&self.output, self.output.owed())
                && event.is_none_or(|event| release.is_before(event.tick))
            {
                // Coils that are switched on again at once need not be switched off.
                let at_once = event.is_some_and(|event| event.tick.is_before(release.after(self.overhead)));
                let made_now = event.is_some_and(|event| !limit.is_before(event.tick));
                if until.is_before(release) && !(at_once && made_now) {
                    break;
                }
                if let Some(edge) = self.output.settle() {
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
                // A segment that continues the one before it: its first step is one of many, too.
                let before = tape.written();
                self.go_on(items, tape, memory, [limit, Tick32(stop)], expand);
                if tape.written() != before {
                    continue;
                }
            }
            if let Some(due) = self.make(event) {
                self.put(tape, memory, due);
                if event.kind == EventKind::Step {
                    self.go_on(items, tape, memory, [limit, Tick32(stop)], expand);
                }
            }
        }
        if self.end.is_before(least) {
            self.wait(tape, memory, until, limit);
        }
        Filled::All
    }

    /// Writes a word that leaves the lines as they are, up to `until`: nothing comes before `limit` from now on.
    #[inline(never)]
    fn wait<const N: usize, const RUNS: usize>(
        &mut self,
        tape: &mut Tape<N, RUNS>,
        memory: &mut [u32; N],
        until: Tick32,
        limit: Tick32,
    ) {
        // The release of coils is no event, so this word leaves time for it.
        let release = if let Output::Coils(_) = self.output { self.output.owed() } else { None };
        let tick = match release {
            Some(release) if release.is_before(limit) => release.before(self.overhead),
            _ => until,
        };
        if !tick.is_before(self.end.after(self.overhead)) {
            self.put(tape, memory, Due { tick, bits: self.idle_bits(), sign: 0 });
        }
        self.channel.pass(limit);
    }

    // These are calls, so that each has the registers to itself: a run's steps need none of them.
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
                // There is no time for a word of its own, so it is joined with the step's word.
                let fits = !event.tick.is_before(tick.after(self.overhead));
                fits.then_some(Due { tick, bits: self.idle_bits(), sign: 0 })
            }
            EventKind::Step => {
                if self.step == 0 {
                    self.change(edge);
                } else {
                    // The end of the pulse is in the same word.
                    self.output.settle();
                }
                self.busy = Some(tick.after(self.overhead));
                Some(Due { tick, bits: self.step_bits(), sign: self.sign() })
            }
        }
    }

    /// Writes the steps that follow one that is the last word, as long as nothing else comes between, and word number `stop` is not reached.
    #[inline(always)]
    fn go_on<const N: usize, const RUNS: usize>(
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
        // Those that take none have nothing to gain: steps of verbs come by ones and twos.
        if self.step != 0 && items.run_direction().is_some() && self.channel.goes_on(limits[0]) {
            self.write_runs(items, tape, memory, limits, expand);
        } else {
            self.write_run(tape, memory, limits, expand);
        }
    }

    /// The same of a driver that only steps, up to `limit`: run after run, with as little between them as can be. Here is what a processor does most of its
    /// time where motions bend fast.
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
            let taken = self
                .channel
                .go_on(items, limit, |recurrence, ahead| expand_into(words, bits, expand, recurrence, ahead));
            if taken == 0 {
                break;
            }
            tape.wrote(taken, tick, position, sign);
        }
        if tape.written() != before {
            self.channel.went_on();
            self.end = self.channel.place().tick;
            self.busy = Some(self.end.after(self.overhead));
        }
    }

    /// The same of any motor, and of the run that is under way alone.
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
            // Nearer than that none of them lets coils be released before it.
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
            let taken =
                self.channel.take_steps(limit, |recurrence, ahead| expand_into(words, bits, expand, recurrence, ahead));
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
            // The next one is for later, or another item's.
            if made < len {
                return;
            }
        }
    }

    /// Writes a word. Its wait fits: `until` does not go up by so much.
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

/// Moves a recurrence on by the next steps of a run, as a channel asks: a word for each, as many as `words` has room for. Gives how many
/// steps it took.
#[inline(always)]
fn expand_into(words: &mut [u32], bits: u32, expand: Expand, recurrence: &mut Recurrence, ahead: Ahead) -> u32 {
    let most = usize::try_from(ahead.most).unwrap_or(usize::MAX);
    let room = words.len().min(most);
    let Some(words) = words.get_mut(..room) else { return 0 };
    if room == 0 {
        return 0;
    }
    // One word cannot wait longer.
    let stretch = Stretch { gap: ahead.gap, ticks: ahead.ticks.min(LONGEST_WAIT), bits };
    expand(recurrence, words, &stretch)
}
