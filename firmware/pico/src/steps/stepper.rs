//! All motors: filling their tapes, starting and stopping together.

use super::expand::expand;
use super::pins::{Layout, Lines, Wired};
use super::pio::{self, GATE, Machine};
use super::{MOTORS, RING, feed};
use crate::clock::{Clock, TICK_HZ};
use crate::regs;
use crate::start::Once;
use core::iter;
use pulsetrain_core::channels;
use pulsetrain_core::lease::{Lapse, Lease};
use pulsetrain_core::output::{Coils, Output, StepDir, StepDirSettings};
use pulsetrain_core::packed_queue::{Fault, PackedQueue, Pool};
use pulsetrain_core::packing::Packing;
use pulsetrain_core::pio::{SHORTEST_PULSE, STEP_DIR_OVERHEAD, Tape, Words, lines};
use pulsetrain_core::queue::{Items, Queue};
use pulsetrain_core::verbs::MotorTiming;
use pulsetrain_core::winch::spacing::SliceSteps;
use pulsetrain_core::wire::message::{Configuration, QUEUE_PARTS, flags, limits_of};
use pulsetrain_core::{Entry, Epoch, Item, Segment, Tick32};

/// F.
pub(crate) const FRACTION_BITS: u32 = 32;

/// Bytes of all queues together.
pub(crate) const POOL: usize = 32_768;

/// Bytes of one motor's queue at most.
const LONGEST_QUEUE: usize = 8192;

/// Runs of a tape.
const RUNS: usize = 128;

/// Words are written so far ahead, ticks: 2.4 ms. A switch can be no sooner.
pub(crate) const AHEAD: u32 = TICK_HZ / 10_000 * 24;

/// How far ahead words are written, and when again; all in ticks.
#[derive(Clone, Copy)]
pub(crate) struct Pace {
    /// So far.
    ahead: u32,
    /// When no more than this is left.
    refill: u32,
    /// A motor whose words end sooner gets some, if another needs them.
    soon: u32,
    /// Words for rest are written if the last step is sooner.
    least: u32,
    /// All motors are looked at again after so long at most.
    spare: u32,
    /// Words that are due by now may wait so long: the more of them are written at a time the less each takes.
    late: u32,
    /// A motor that has less comes before what the host says.
    behind: u32,
    /// What motors do that are told directly is worked out for so long at least at once: each time takes some 2000 cycles a motor.
    pub(crate) slice: u32,
}

/// 0.1 ms, ticks.
const TENTH_MS: u32 = TICK_HZ / 10_000;

impl Pace {
    /// Of plans and paths.
    const FAR: Pace = Pace::of_main_loop(AHEAD);

    /// Of motors that are told directly, by the main loop: what is written can be told otherwise no more.
    pub(crate) const NEAR: Pace = Pace::of_main_loop(12 * TENTH_MS);

    /// The same by an interrupt, as seldom as can be: it comes while the words that are left last for a round of so many motors, and as
    /// much longer as it may be late. A verb then holds 2 ms later at most.
    pub(crate) const fn of_interrupt(count: u8) -> Pace {
        // A motor's part of a round takes 0.05 ms or so, at its shortest period.
        let (kept_out, round) = (7 * TENTH_MS / 2, count as u32 * TENTH_MS / 2);
        let (ahead, refill) = (18 * TENTH_MS, kept_out + round);
        Pace {
            ahead,
            refill,
            soon: refill + 6 * TENTH_MS,
            least: ahead,
            spare: ahead - refill,
            late: 0,
            behind: 0,
            slice: 4 * TENTH_MS,
        }
    }

    const fn of_main_loop(ahead: u32) -> Pace {
        let refill = ahead / 4 * 3;
        let spare = ahead / 8;
        Pace { ahead, refill, soon: refill, least: refill, spare, late: spare, behind: ahead / 2, slice: TENTH_MS }
    }
}

/// Words that a motor gets before the next one has its turn, and a run more at most.
const TURN: u32 = 512;

/// Words that are handed over when a state machine has less than that to do may come too late, ticks: the way to the DMA's
/// first transfer, and an interrupt before it.
const NEARLY_DRY: u32 = 200;

/// From the gate to the first change of lines: 0.5 ms, in which the first words are written.
const FIRST_WAIT: u32 = TICK_HZ / 2000;

/// The longest pulse and set-up, ticks: 0.5 ms.
pub(crate) const LONGEST: u16 = 62_500;

/// A coil's release must be sooner than that after a step, ms: ticks are told apart within 2^31.
pub(crate) const LONGEST_IDLE_MS: u16 = 8000;

/// SysTick is read so many ticks before the first instruction behind the gate.
const GATE_TICKS: u32 = 2;

/// Items of a motor whose steps are worked out here: of a path three a millisecond, and [`AHEAD`] is less than three of those; of verbs
/// no more than there is [room](Stepper::has_room) for.
const FOLLOWED: usize = 32;

/// Before steps that are not known yet nothing is written for so long, ticks: longer than DIR is turned before one.
pub(crate) const CLEAR: u32 = 2500;

#[repr(C, align(8192))]
struct Ring([u32; RING]);

/// What is large, and nothing but zeros at first: so it takes no room in the image.
pub(crate) struct Memory {
    rings: [Ring; MOTORS],
    tapes: [Tape<RING, RUNS>; MOTORS],
    pool: Pool<POOL>,
    followed: [Queue<FOLLOWED>; MOTORS],
}

static MEMORY: Once<Memory> = Once::new(Memory {
    rings: [const { Ring([0; RING]) }; MOTORS],
    tapes: [const { Tape::new() }; MOTORS],
    pool: Pool::new(),
    followed: [const { Queue::new() }; MOTORS],
});

/// One motor.
pub(crate) struct Motor {
    words: Words<FRACTION_BITS>,
    packed: PackedQueue,
    wired: Wired,
    pulse_ticks: u32,
    pull_in_ticks: u32,
    /// What it can be told directly.
    limits: MotorTiming,
}

impl Motor {
    const NONE: Motor = Motor {
        words: Words::new(Motor::NO_OUTPUT, 0, SHORTEST_PULSE),
        packed: PackedQueue::new(Pool::<POOL>::part(0, 0), Packing { fraction_bits: FRACTION_BITS, gain: 0 }),
        wired: Wired::NONE,
        pulse_ticks: SHORTEST_PULSE,
        pull_in_ticks: 0,
        limits: MotorTiming { shortest: 1, turn: 1, period: 1 },
    };

    const NO_OUTPUT: Output = Output::StepDir(StepDir::new(StepDirSettings {
        step_line: 0,
        dir_line: 1,
        pulse_ticks: SHORTEST_PULSE,
        setup_ticks: 0,
        forward_high: false,
        shared_dir: false,
    }));
}

/// A motor and what is its own.
struct Parts<'a> {
    number: u8,
    motor: &'a mut Motor,
    tape: &'a mut Tape<RING, RUNS>,
    ring: &'a mut [u32; RING],
}

/// How all motors were stopped.
pub(crate) struct Halt {
    /// No step was begun after it.
    pub(crate) tick: u64,
    /// Motors that were faster than they can stop at once, bit by motor.
    pub(crate) uncertain: u8,
    /// Up to then each motor did what it was to do: up to `tick`, or to the end of its words, if it ran dry.
    pub(crate) reached: [u64; MOTORS],
}

/// All motors.
pub(crate) struct Stepper {
    motors: [Motor; MOTORS],
    count: u8,
    memory: &'static mut Memory,
    /// The gate is open.
    runs: bool,
    /// Which motor has the next turn.
    turn: u8,
    least_ahead: u32,
    /// A motor's words came too late, and were kept back.
    too_late: bool,
    /// The motor that got words last had less than its [pace](Pace)'s `behind`.
    behind: bool,
    /// No motor needs words before.
    due: Tick32,
    /// Steps are worked out here and known up to then; else motors do what was packed.
    known: Option<Tick32>,
    pace: Pace,
    /// Before steps that are not known yet nothing is written for so long, ticks: longer than DIR is turned before one.
    clear: u32,
    /// The motor that could not follow its plan last, so that all brake.
    at_fault: u8,
}

impl Stepper {
    /// Sets up what all motors share; there are none yet.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn begin() -> Stepper {
        pio::close_gate();
        feed::begin();
        Stepper {
            motors: [Motor::NONE; MOTORS],
            count: 0,
            // SAFETY: the caller's promise.
            memory: unsafe { MEMORY.take() },
            runs: false,
            turn: 0,
            least_ahead: u32::MAX,
            too_late: false,
            behind: false,
            due: Tick32(0),
            known: None,
            pace: Pace::FAR,
            clear: CLEAR,
            at_fault: 0,
        }
    }

    /// From the next [`start`](Stepper::start) on, or from where all motors rest, their steps come by [`follow`](Stepper::follow) or
    /// [`take`](Stepper::take): there are none before `known`.
    pub(crate) const fn follow_from(&mut self, known: Tick32) {
        self.known = Some(known);
    }

    /// From now on, until it stops, words are written at another pace.
    pub(crate) const fn set_pace(&mut self, pace: Pace) {
        self.pace = pace;
    }

    /// So far ahead steps have to be known at a pace, ticks.
    pub(crate) const fn foresight(&self, pace: Pace) -> u32 {
        pace.ahead + self.clear
    }

    /// Whether each motor's queue has room for `items` items more.
    pub(crate) fn has_room(&self, items: usize) -> bool {
        self.memory.followed.iter().all(|queue| queue.credit() >= items)
    }

    /// Has a motor do an item: there is room.
    pub(crate) fn take(&mut self, number: u8, item: Item) {
        let epoch = self.epoch();
        if let Some(queue) = self.memory.followed.get_mut(usize::from(number)) {
            let _ = queue.push(Entry { epoch, item });
        }
    }

    /// What each motor can be told directly, and its position.
    pub(crate) fn limits(&self) -> impl Iterator<Item = (MotorTiming, i32)> {
        self.motors().map(|motor| (motor.limits, motor.words.channel().position()))
    }

    /// The shortest interval that a motor can start and stop at, ticks.
    pub(crate) fn pull_in_ticks(&self, motor: u8) -> u32 {
        self.motor(motor).map_or(0, |motor| motor.pull_in_ticks)
    }

    /// Has a motor make steps in the millisecond that begins at `begin`.
    pub(crate) fn follow(&mut self, number: u8, begin: Tick32, steps: SliceSteps) {
        let epoch = self.epoch();
        let Some(queue) = self.memory.followed.get_mut(usize::from(number)) else { return };
        let mut push = |item| {
            // If it has no room the main loop was late by several milliseconds, and the state machines have run dry.
            let _ = queue.push(Entry { epoch, item });
        };
        let direction = steps.direction;
        let run = |count: u8, interval: u64| {
            // 2^-16 ticks to F = 32.
            let segment = Segment { count: count.into(), interval: (interval << 16).cast_signed(), add: 0, add2: 0 };
            Item::Run { segment, direction }
        };
        push(Item::Anchor { tick: begin });
        push(run(1, steps.first));
        if steps.count > 1 {
            push(run(steps.count - 1, steps.interval));
        }
    }

    /// Motors configured.
    pub(crate) const fn count(&self) -> u8 {
        self.count
    }

    /// The motors with what is theirs, and the memory of their queues.
    fn all(&mut self) -> (&mut Pool<POOL>, impl Iterator<Item = Parts<'_>>) {
        let Memory { rings, tapes, pool, .. } = &mut *self.memory;
        let places = (0..).zip(&mut self.motors).zip(tapes).zip(rings).take(usize::from(self.count));
        (pool, places.map(|(((number, motor), tape), Ring(ring))| Parts { number, motor, tape, ring }))
    }

    fn motor(&self, motor: u8) -> Option<&Motor> {
        self.motors.get(usize::from(motor)).filter(|_| motor < self.count)
    }

    fn motors(&self) -> impl Iterator<Item = &Motor> {
        self.motors.iter().take(usize::from(self.count))
    }

    fn motors_mut(&mut self) -> impl Iterator<Item = &mut Motor> {
        self.motors.iter_mut().take(usize::from(self.count))
    }

    /// Takes on a configuration that is possible; nothing runs. Counts begin at 0.
    pub(crate) fn configure(&mut self, layout: &Layout, configuration: &Configuration<'_>, now: Tick32) {
        if self.count > 4 && layout.count <= 4 {
            pio::unload(1);
        }
        (self.count, self.turn) = (layout.count, 0);
        let mut at = 0;
        let pulse_ticks = u32::from(configuration.pulse_ticks).max(SHORTEST_PULSE);
        let setup_ticks = u32::from(configuration.setup_ticks).max(pulse_ticks + STEP_DIR_OVERHEAD);
        let release_ticks = configuration.idle_ms.map(|ms| u32::from(ms.max(1)) * (TICK_HZ / 1000));
        let motors = self.motors.iter_mut().zip(configuration.motors()).zip(&layout.motors);
        for ((motor, setup), wired) in motors {
            let (output, step_line) = match wired.lines {
                Lines::StepDir { step_line, forward_high, .. } => {
                    let (dir_line, shared_dir) = (1 - step_line, false);
                    let settings =
                        StepDirSettings { step_line, dir_line, pulse_ticks, setup_ticks, forward_high, shared_dir };
                    (Output::StepDir(StepDir::new(settings)), step_line)
                }
                Lines::Coils { sequence } => {
                    let mut lines = [0; 4];
                    for (line, pin) in lines.iter_mut().zip(wired.pins()) {
                        *line = pin - wired.base;
                    }
                    (Output::Coils(Coils::new(lines, sequence, release_ticks)), 0)
                }
            };
            motor.words = Words::new(output, step_line, pulse_ticks);
            let packing = Packing { fraction_bits: FRACTION_BITS, gain: setup.gain };
            let equal = POOL / usize::from(layout.count.max(1));
            let by_need = POOL / usize::from(QUEUE_PARTS) * usize::from(setup.queue_parts);
            let queue = if by_need == 0 { equal } else { by_need }.min(LONGEST_QUEUE) as u16;
            motor.packed = PackedQueue::new(Pool::<POOL>::part(at, queue), packing);
            at += queue;
            (motor.wired, motor.pulse_ticks, motor.pull_in_ticks) = (*wired, pulse_ticks, setup.pull_in_ticks);
            motor.limits =
                limits(&motor.words, layout.count, setup_ticks, pulse_ticks + u32::from(configuration.hold_ticks));
            motor.words.channel_mut().open_from(now);
        }
        self.clear = CLEAR.max(setup_ticks + 4 * (pulse_ticks + STEP_DIR_OVERHEAD));
        let blocks = layout.count.div_ceil(4);
        for block in 0..blocks {
            pio::load(block);
        }
        for number in 0..layout.count {
            self.set_up_machine(number);
        }
    }

    /// Sets up a motor's state machine, before the gate, and its pins.
    fn set_up_machine(&self, number: u8) {
        if let Some(motor) = self.motor(number) {
            Machine::of(number).set_up(&motor.wired, motor.pulse_ticks, motor.words.levels());
        }
    }

    /// Opens the gate: all state machines begin in the same cycle. Queues are empty, faults forgotten.
    pub(crate) fn start(&mut self, clock: &mut Clock) {
        let mut machines = [0; 2];
        self.memory.followed.iter_mut().for_each(Queue::clear);
        let (pool, all) = self.all();
        for Parts { number, motor, tape, ring } in all {
            let machine = Machine::of(number);
            motor.packed.items(pool).clear();
            motor.packed.forgive();
            motor.words.forgive();
            machine.set_up(&motor.wired, motor.pulse_ticks, motor.words.levels());
            feed::set_up(number, ring, machine.fifo());
            motor.words.begin(tape, ring, FIRST_WAIT);
            feed::publish(number, tape.written());
            machines[usize::from(machine.block() & 1)] |= machine.bit();
        }
        for (block, mask) in (0..).zip(machines).filter(|(_, mask)| *mask != 0) {
            pio::enable(block, mask);
        }
        // By now each has its first word.
        for number in 0..self.count {
            Machine::of(number).forget_stall();
        }
        let value = regs::free(|| regs::set_and_time(1 << GATE));
        let at = Tick32::of(clock.seen(value)).after(GATE_TICKS);
        for Parts { motor, tape, .. } in self.all().1 {
            motor.words.start(tape, at);
        }
        (self.runs, self.too_late, self.behind) = (true, false, false);
        self.least_ahead = u32::MAX;
        self.due = at;
    }

    /// Writes words for the next motor that needs some; whether there was one.
    #[inline(never)]
    pub(crate) fn fill(&mut self, clock: &mut Clock) -> bool {
        let now = clock.moment();
        if !self.runs || now.is_before(self.due) {
            return false;
        }
        let pace = self.pace;
        let mut spare = pace.spare;
        let (mut least, mut until) = (now.after(pace.least), now.after(pace.ahead));
        if let Some(known) = self.known {
            let last = known.before(self.clear);
            until = if last.is_before(until) { last } else { until };
            least = if last.is_before(least) { last } else { least };
        }
        let Memory { rings, tapes, pool, followed } = &mut *self.memory;
        for _ in 0..self.count {
            let number = self.turn;
            self.turn = if number + 1 >= self.count { 0 } else { number + 1 };
            let index = usize::from(number);
            let (Some(motor), Some(tape), Some(Ring(ring))) =
                (self.motors.get_mut(index), tapes.get_mut(index), rings.get_mut(index))
            else {
                continue;
            };
            let ahead = motor.words.end().since(now).cast_signed();
            if ahead >= pace.soon.cast_signed() {
                spare = spare.min(ahead.cast_unsigned() - pace.refill);
                continue;
            }
            tape.pass(now);
            motor.words.pass(now);
            // Then it comes before what the host says.
            self.behind = ahead < pace.behind.cast_signed();
            self.least_ahead = self.least_ahead.min(ahead.max(0).cast_unsigned());
            let stretch = [least, until];
            let dry = motor.words.end().after(motor.words.overhead());
            match followed.get_mut(index).filter(|_| self.known.is_some()) {
                Some(items) => motor.words.fill(items, tape, ring, stretch, TURN, expand),
                None => motor.words.fill(&mut motor.packed.items(pool), tape, ring, stretch, TURN, expand),
            };
            let has_news = motor.words.channel().has_news();
            if !clock.moment().after(NEARLY_DRY).is_before(dry) {
                // Late words would be late steps: better none.
                self.too_late = true;
                return false;
            }
            feed::publish(number, tape.written());
            if has_news {
                self.agree();
            }
            return true;
        }
        self.due = now.after(spare);
        self.behind = false;
        false
    }

    /// A motor has noticed that its lease is over: all others are told, from when on.
    #[inline(never)]
    fn agree(&mut self) {
        let channels = || self.motors.iter().take(usize::from(self.count)).map(|motor| motor.words.channel());
        let Some(lapse) = channels::agreed_lapse(channels()) else { return };
        if lapse.cause.is_fault()
            && let Some((number, _)) = (0..).zip(channels()).find(|(_, channel)| channel.has_news())
        {
            self.at_fault = number;
        }
        self.lapse_at(lapse);
    }

    /// How long motors may be left alone, ticks.
    pub(crate) const fn spare(&self, now: Tick32) -> u32 {
        let spare = self.due.since(now).cast_signed();
        match spare {
            _ if !self.runs => self.pace.spare,
            // One needs words by now.
            ..=0 => self.pace.late,
            spare => spare.cast_unsigned(),
        }
    }

    /// Whether words are more urgent than what the host says.
    #[inline(always)]
    pub(crate) const fn is_behind(&self) -> bool {
        self.runs && self.behind
    }

    /// Notes that time goes on, while nothing runs.
    pub(crate) fn rest(&mut self, now: Tick32) {
        if !self.runs {
            for motor in self.motors_mut() {
                motor.words.channel_mut().pass(now);
            }
        }
    }

    /// Whether a state machine found no word, or nearly: what it was to do is late.
    #[inline(always)]
    pub(crate) fn has_starved(&self) -> bool {
        let dry = || (pio::stalled(0) | if self.count > 4 { pio::stalled(1) } else { 0 }) != 0;
        self.runs && (self.too_late || dry())
    }

    /// The immediate stop: halts all state machines, and counts what they did.
    pub(crate) fn stop(&mut self, clock: &mut Clock) -> Halt {
        (self.known, self.pace) = (None, Pace::FAR);
        if !self.runs {
            let tick = clock.now();
            return Halt { tick, uncertain: 0, reached: [tick; MOTORS] };
        }
        self.runs = false;
        // No interrupt starts a channel again, or comes between a halt and the end of a pulse.
        let (tick, in_pulse) = regs::free(|| {
            pio::halt(0, 0xf);
            if self.count > 4 {
                pio::halt(1, 0xf);
            }
            let tick = clock.now();
            regs::SIO_OUT_CLR.write(1 << GATE);
            (tick, self.end_pulses())
        });
        // By then all pulses that were begun are over, whatever is done meanwhile.
        let fall = clock.moment().after(self.longest_pulse() + STEP_DIR_OVERHEAD);
        let mut halt = Halt { tick, uncertain: 0, reached: [tick; MOTORS] };
        let (pool, all) = self.all();
        for Parts { number, motor, tape, ring } in all {
            let machine = Machine::of(number);
            let taken = regs::free(|| feed::end(number, ring));
            let pulled = taken.wrapping_sub(machine.waiting());
            let is_done = in_pulse >> number & 1 != 0 || machine.has_changed_lines(&motor.wired.lines);
            let done = if is_done { pulled } else { pulled.wrapping_sub(1) };
            let made = tape.position_after(done);
            let (words, mut items) = (&mut motor.words, motor.packed.items(pool));
            let goes = made != words.channel().position() || !words.channel().is_idle(&items);
            let apart = tape.apart(done.max(1), Tick32::of(tick), words.overhead(), ring);
            if goes && done != 0 && apart < motor.pull_in_ticks {
                halt.uncertain |= 1 << number;
            }
            if machine.is_dry()
                && let Some(reached) = halt.reached.get_mut(usize::from(number))
            {
                let (last, ..) = tape.last(done.max(1), words.overhead(), ring);
                *reached -= u64::from(Tick32::of(tick).since(last));
            }
            // Before its first word the lines are as in that.
            let last = ring[done.saturating_sub(1) as usize % RING];
            words.stop(&mut items, made, lines(last));
        }
        while in_pulse != 0 && clock.moment().is_before(fall) {}
        for (block, mask) in blocks(in_pulse) {
            pio::halt(block, mask);
        }
        halt
    }

    /// Lets the pulses go on that state machines were halted in, each to its own end; gives whose, bit by motor. The gate is closed.
    ///
    /// Nobody works out anything before: so long STEP stays active beyond its pulse.
    fn end_pulses(&self) -> u8 {
        let mut in_pulse = 0;
        for (number, motor) in (0..self.count).zip(&self.motors) {
            let machine = Machine::of(number);
            if matches!(motor.wired.lines, Lines::StepDir { .. }) && machine.is_in_pulse() {
                machine.end_with_pulse();
                in_pulse |= 1 << number;
            }
        }
        for (block, mask) in blocks(in_pulse) {
            pio::enable(block, mask);
        }
        in_pulse
    }

    /// The longest pulse of any motor, ticks.
    fn longest_pulse(&self) -> u32 {
        self.motors().map(|motor| motor.pulse_ticks).max().unwrap_or(0)
    }

    /// Takes the current from coils; nothing runs.
    pub(crate) fn release_coils(&mut self) {
        for (number, motor) in (0..self.count).zip(&mut self.motors) {
            if let Lines::Coils { .. } = motor.wired.lines {
                motor.words.release();
                Machine::of(number).set_lines(&motor.wired, motor.words.levels());
            }
        }
    }

    /// Puts packed items last in a motor's queue; `None` if it has no room, or is not there.
    pub(crate) fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Option<()> {
        let motor = self.motors.get_mut(usize::from(motor))?;
        if !motor.words.channel().keeps(epoch) {
            return Some(());
        }
        motor.packed.push(&mut self.memory.pool, epoch, packed).ok()
    }

    /// Takes back what was pushed last of `epoch`.
    pub(crate) fn discard(&mut self, epoch: Epoch) {
        for motor in self.motors_mut() {
            motor.packed.discard(epoch);
        }
    }

    /// Switches all motors, or none if a switch waits for an earlier tick or one is committed too far. From `at` on the plan holds as long as `lease` says.
    pub(crate) fn switch(&mut self, epoch: Epoch, at: Tick32, lease: Lease, limits: &[u8]) -> bool {
        if self.motors().any(|motor| motor.words.channel().check_switch(at).is_err()) {
            return false;
        }
        for (motor, limit) in self.motors_mut().zip(limits_of(limits).map(Some).chain(iter::repeat(None))) {
            // Just asked.
            let _ = motor.words.channel_mut().schedule_switch(epoch, at, lease, limit);
        }
        true
    }

    /// Has the plan hold as long as `lease` says; `false`, and nothing changes, if a motor refuses.
    pub(crate) fn extend(&mut self, lease: Lease, limits: &[u8]) -> bool {
        if !self.can_extend(lease) {
            return false;
        }
        for (motor, limit) in self.motors_mut().zip(limits_of(limits).map(Some).chain(iter::repeat(None))) {
            motor.words.channel_mut().extend(lease, limit);
        }
        true
    }

    /// Whether [`extend`](Stepper::extend) would be right now.
    pub(crate) fn can_extend(&self, lease: Lease) -> bool {
        self.motors().all(|motor| motor.words.channel().check_extend(lease).is_ok())
    }

    /// Takes back bytes from the end of each motor's queue, two bytes of `counts` each; the first motor that has not so many unread, and then
    /// nothing changes.
    pub(crate) fn take_back(&mut self, counts: &[u8]) -> Result<(), u8> {
        let counts = || counts.as_chunks().0.iter().map(|count| u16::from_le_bytes(*count));
        if let Some((number, _)) =
            (0..).zip(self.motors().zip(counts())).find(|(_, (motor, count))| !motor.packed.can_drop_last(*count))
        {
            return Err(number);
        }
        for (motor, count) in self.motors_mut().zip(counts()) {
            motor.packed.drop_last(count);
        }
        Ok(())
    }

    /// All motors brake from there, if they do not already.
    pub(crate) fn lapse_at(&mut self, lapse: Lapse) {
        for motor in self.motors_mut() {
            motor.words.channel_mut().lapse_at(lapse);
        }
    }

    /// How long the plan holds, and since when it is over, if it is.
    pub(crate) fn lease(&self) -> (Lease, Option<Lapse>) {
        let lease = self.motor(0).map_or(Lease::Off, |motor| motor.words.channel().lease());
        if lease == Lease::Off {
            return (lease, None);
        }
        let lapses = self.motors().filter_map(|motor| motor.words.channel().lapse());
        (lease, lapses.min_by_key(|lapse| !lapse.cause.is_fault()))
    }

    /// The motor that could not follow its plan last, so that all brake.
    pub(crate) const fn at_fault(&self) -> u8 {
        self.at_fault
    }

    /// Whether a motor was in motion when the lease was over.
    pub(crate) fn was_moving(&self) -> bool {
        self.motors().any(|motor| motor.words.channel().was_moving())
    }

    /// The first tick that no motor is committed to, not before `now`.
    pub(crate) fn horizon(&self, now: Tick32) -> Tick32 {
        let horizons = self.motors().map(|motor| motor.words.channel().horizon());
        horizons.fold(now, |latest, horizon| if latest.is_before(horizon) { horizon } else { latest })
    }

    /// The epoch that is being run.
    pub(crate) fn epoch(&self) -> Epoch {
        self.motor(0).map_or(Epoch(0), |motor| motor.words.channel().epoch())
    }

    /// Free bytes of a motor's queue.
    pub(crate) fn free(&self, motor: u8) -> u16 {
        self.motor(motor).map_or(0, |motor| motor.packed.room())
    }

    /// Pulses that a motor has begun by now, forward less backward.
    pub(crate) fn position(&self, number: u8, now: Tick32) -> i32 {
        let index = usize::from(number);
        let (Some(motor), Some(tape), Some(Ring(ring))) =
            (self.motor(number), self.memory.tapes.get(index), self.memory.rings.get(index))
        else {
            return 0;
        };
        if self.runs { tape.position_at(now, motor.words.overhead(), ring) } else { motor.words.channel().position() }
    }

    /// Whether nothing is left to do on any motor: no step, no end of a pulse.
    pub(crate) fn is_idle(&self, now: Tick32) -> bool {
        let follows = self.known.is_some() && self.memory.followed.iter().any(|items| !items.is_empty());
        !self.runs || (!follows && self.motors().all(|motor| motor.words.is_idle(&motor.packed, now)))
    }

    /// What is wrong with a motor's queue: [`flags`] of the motor.
    pub(crate) fn faults(&self, motor: u8) -> u8 {
        let Some(motor) = self.motor(motor) else { return 0 };
        let missed = if motor.words.channel().missed().is_some() { flags::STEP_MISSED } else { 0 };
        let cut = if motor.words.setup_cut_short() { flags::SETUP_CUT_SHORT } else { 0 };
        missed
            | cut
            | match motor.packed.fault() {
                Some(Fault::BadItem) => flags::BAD_ITEM,
                Some(Fault::CheckFailed) => flags::CHECK_FAILED,
                None => 0,
            }
    }

    /// Least that any motor had left when it was filled, ticks.
    pub(crate) const fn least_ahead(&self) -> u32 {
        self.least_ahead
    }

    /// It is measured anew.
    pub(crate) const fn reset_measures(&mut self) {
        self.least_ahead = u32::MAX;
    }
}

/// The blocks that have state machines of these motors, bit by motor, and which.
fn blocks(motors: u8) -> impl Iterator<Item = (u8, u32)> {
    (0..).zip([u32::from(motors & 0xf), u32::from(motors >> 4)]).filter(|(_, mask)| *mask != 0)
}

/// What a motor can be told directly: `pulse` is what a pulse and the hold of DIR take, `setup` DIR's set-up, ticks.
fn limits(words: &Words<FRACTION_BITS>, count: u8, setup: u32, pulse: u32) -> MotorTiming {
    let (work, turn) =
        if words.makes_pulses() { (STEP_TICKS, pulse.max(words.overhead()) + setup) } else { (PATTERN_TICKS, 0) };
    let shortest = (work * u32::from(count)).max(words.overhead() + 1);
    MotorTiming { shortest, turn: turn.max(shortest), period: FIRST_PERIOD.max(shortest) }
}

/// What a step costs of the processor's time while motors are told directly, with room for all else, cycles: of a driver, and of coils.
const STEP_TICKS: u32 = 125;
const PATTERN_TICKS: u32 = 1000;

/// The period until another is said, ticks: 1000 steps/s, as fast as the motors of seed 002 turn.
const FIRST_PERIOD: u32 = TICK_HZ / 1000;
