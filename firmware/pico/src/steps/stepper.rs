//! All motors: filling their tapes, starting and stopping together.

use super::expand::expand;
use super::pins::{Lines, MotorPins, PinLayout};
use super::pio::{self, GATE, StateMachine};
use super::{MOTORS, RING_WORDS, feed};
use crate::clock::{Clock, TICK_HZ};
use crate::regs;
use crate::start::StaticCell;
use core::iter;
use pulsetrain_core::channels;
use pulsetrain_core::firmware::{Halt, LeaseReport};
use pulsetrain_core::lease::{Lapse, Lease};
use pulsetrain_core::output::{Coils, Output, StepDir, StepDirSettings};
use pulsetrain_core::packed_queue::{Fault, PackedQueue, Pool};
use pulsetrain_core::packing::Packing;
use pulsetrain_core::pio::{SHORTEST_PULSE, STEP_DIR_OVERHEAD, Tape, WordWriter, lines};
use pulsetrain_core::queue::{Items, Queue};
use pulsetrain_core::verbs::MotorTiming;
use pulsetrain_core::winch::spacing::SliceSteps;
use pulsetrain_core::wire::message::{Configuration, QUEUE_PARTS, flags, limits_of};
use pulsetrain_core::{Entry, Epoch, Item, Segment, Tick32};

pub(crate) use pulsetrain_core::boards::pico::{
    LOOK_AHEAD, MAX_PULSE as LONGEST_PULSE, MAX_QUEUE_BYTES as LONGEST_QUEUE_BYTES, QUEUE_BYTES as POOL_BYTES,
};

/// F.
pub(crate) const FRACTION_BITS: u32 = pulsetrain_core::boards::pico::REGISTERS.fraction_bits;

/// Runs of a tape: words that all count the same. A motor that turns at every step has a run for each word.
const TAPE_RUNS: usize = 128;

/// When words are written, and how far ahead; all in ticks.
#[derive(Clone, Copy)]
pub(crate) struct FillTiming {
    /// Words are written for steps up to so long after now.
    look_ahead: u32,
    /// A motor gets words when no more than this is left.
    refill_below: u32,
    /// A motor gets words with the others if it has less than this left: then the next round comes later.
    refill_early_below: u32,
    /// Words for rest are written up to so long after now, where steps end sooner.
    rest_look_ahead: u32,
    /// All motors are looked at again after so long at most.
    longest_wait: u32,
    /// Words that are due may wait so long: the more of them are written at a time, the less time each takes.
    longest_delay: u32,
    /// A motor that has less than this left is behind: its words come before the host's frames.
    behind_below: u32,
    /// The steps of verbs are worked out for so long at least at a time: each time takes some 2000 cycles a motor.
    pub(crate) verb_slice: u32,
}

/// 0.1 ms, ticks.
const TENTH_MS: u32 = TICK_HZ / 10_000;

impl FillTiming {
    /// Of plans and paths, by the main loop.
    const PLANS: FillTiming = FillTiming::of_main_loop(LOOK_AHEAD);

    /// Of verbs, by the main loop. Half as far ahead, since a verb cannot change what is written.
    pub(crate) const VERBS: FillTiming = FillTiming::of_main_loop(12 * TENTH_MS);

    /// Of verbs, by a timer's interrupt, for `count` motors. It comes as seldom as it can, so that the program has the processor:
    /// when the words that are left last for one round of all motors, and for as long as the interrupt may be kept out. A verb then
    /// takes effect after 2 ms at most.
    pub(crate) const fn of_interrupt(count: u8) -> FillTiming {
        // One motor's words take about 0.05 ms to write, at its shortest period. A program may keep the interrupt out for 0.35 ms.
        let (kept_out, round) = (7 * TENTH_MS / 2, count as u32 * TENTH_MS / 2);
        let (look_ahead, refill_below) = (18 * TENTH_MS, kept_out + round);
        FillTiming {
            look_ahead,
            refill_below,
            refill_early_below: refill_below + 6 * TENTH_MS,
            rest_look_ahead: look_ahead,
            longest_wait: look_ahead - refill_below,
            longest_delay: 0,
            behind_below: 0,
            verb_slice: 4 * TENTH_MS,
        }
    }

    const fn of_main_loop(look_ahead: u32) -> FillTiming {
        let refill_below = look_ahead / 4 * 3;
        let longest_wait = look_ahead / 8;
        FillTiming {
            look_ahead,
            refill_below,
            refill_early_below: refill_below,
            rest_look_ahead: refill_below,
            longest_wait,
            longest_delay: longest_wait,
            behind_below: look_ahead / 2,
            verb_slice: TENTH_MS,
        }
    }
}

/// Words that a motor gets at a time, and at most a run more. Writing them takes some 0.05 ms: so long the other motors wait.
const WORDS_PER_FILL: u32 = 512;

/// Words come too late for a state machine that has less than this to do, ticks: the DMA's first transfer takes a while to begin,
/// and an interrupt may come before it.
const NEARLY_DRY: u32 = 200;

/// If motors were not looked at for longer than this, ticks, the main loop was late: 0.6 ms, twice as long as they may be left
/// alone. Then the motor with the least words is filled first, once for each motor. At other times turns go on in order: to compare
/// all motors before each fill costs two of them 2 % of their highest rate. The library's interrupt comes less often than this, and
/// always begins with the least.
const LATE: u32 = 6 * TENTH_MS;

/// From the opened gate to the first change of lines: 0.5 ms, so that there is time to write the first words.
const FIRST_WAIT: u32 = TICK_HZ / 2000;

/// Coils are released at most so long after a step, ms: a `Tick32` tells ticks apart within 2^31, which is 17 s.
pub(crate) const LONGEST_IDLE_MS: u16 = 8000;

/// From the reading of SysTick to the first instruction of a state machine after the gate, ticks.
const GATE_TICKS: u32 = 2;

/// Items of one motor whose steps are worked out on the board. A path makes three items a millisecond, and [`LOOK_AHEAD`] is less
/// than 3 ms; verbs ask for [room](Stepper::has_room) first.
const LOCAL_ITEMS: usize = 32;

/// No words are written for the last so many ticks before steps that are not known yet, as DIR changes before a step. 20 µs at
/// least; more with a long set-up of DIR.
pub(crate) const DIR_CLEARANCE: u32 = 2500;

#[repr(C, align(8192))]
struct WordRing([u32; RING_WORDS]);

/// The large memory. All zeros at first, so that it takes no room in the image.
pub(crate) struct Memory {
    rings: [WordRing; MOTORS],
    tapes: [Tape<RING_WORDS, TAPE_RUNS>; MOTORS],
    pool: Pool<POOL_BYTES>,
    local_items: [Queue<LOCAL_ITEMS>; MOTORS],
}

static MEMORY: StaticCell<Memory> = StaticCell::new(Memory {
    rings: [const { WordRing([0; RING_WORDS]) }; MOTORS],
    tapes: [const { Tape::new() }; MOTORS],
    pool: Pool::new(),
    local_items: [const { Queue::new() }; MOTORS],
});

/// One motor.
pub(crate) struct MotorState {
    words: WordWriter<FRACTION_BITS>,
    packed: PackedQueue,
    wiring: MotorPins,
    pulse_ticks: u32,
    pull_in_ticks: u32,
    /// What verbs may ask of it.
    limits: MotorTiming,
}

impl MotorState {
    const NONE: MotorState = MotorState {
        words: WordWriter::new(MotorState::NO_OUTPUT, 0, SHORTEST_PULSE),
        packed: PackedQueue::new(Pool::<POOL_BYTES>::part(0, 0), Packing { fraction_bits: FRACTION_BITS, gain: 0 }),
        wiring: MotorPins::NONE,
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

/// A motor with its tape and its ring.
struct MotorParts<'a> {
    number: u8,
    motor: &'a mut MotorState,
    tape: &'a mut Tape<RING_WORDS, TAPE_RUNS>,
    ring: &'a mut [u32; RING_WORDS],
}

/// All motors.
pub(crate) struct Stepper {
    motors: [MotorState; MOTORS],
    count: u8,
    memory: &'static mut Memory,
    /// The gate is open.
    runs: bool,
    /// The motor that is looked at next.
    next_motor: u8,
    least_ahead: u32,
    /// A motor's words came too late, and were kept back.
    too_late: bool,
    /// The motor that got words last had less than [`FillTiming::behind_below`].
    behind: bool,
    /// No motor needs words before this tick.
    next_fill: Tick32,
    /// When a motor's words were looked at last, and how many fills from now on go by need, as that was long ago.
    looked: Tick32,
    fills_by_need: u8,
    /// Steps are worked out on the board and known up to this tick. `None`: motors follow packed items.
    known_until: Option<Tick32>,
    timing: FillTiming,
    /// No words are written for the last so many ticks before steps that are not known yet: see [`DIR_CLEARANCE`].
    dir_clearance: u32,
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
            motors: [MotorState::NONE; MOTORS],
            count: 0,
            // SAFETY: the caller's promise.
            memory: unsafe { MEMORY.take() },
            runs: false,
            next_motor: 0,
            least_ahead: u32::MAX,
            too_late: false,
            behind: false,
            next_fill: Tick32(0),
            looked: Tick32(0),
            fills_by_need: 0,
            known_until: None,
            timing: FillTiming::PLANS,
            dir_clearance: DIR_CLEARANCE,
            at_fault: 0,
        }
    }

    /// All steps up to tick `known` are in the queues. From the first call on, at rest, steps come by
    /// [`push_steps`](Stepper::push_steps) or [`push_item`](Stepper::push_item), until the motors are stopped.
    pub(crate) const fn set_known_until(&mut self, known: Tick32) {
        self.known_until = Some(known);
    }

    /// Sets when words are written, until the motors are stopped.
    pub(crate) const fn set_timing(&mut self, timing: FillTiming) {
        self.timing = timing;
    }

    /// How far ahead steps have to be known, ticks.
    pub(crate) const fn foresight(&self, timing: FillTiming) -> u32 {
        timing.look_ahead + self.dir_clearance
    }

    /// Whether each motor's queue has room for `items` items more.
    pub(crate) fn has_room(&self, items: usize) -> bool {
        self.memory.local_items.iter().all(|queue| queue.credit() >= items)
    }

    /// Puts an item last in a motor's queue. The caller has asked whether there is [room](Stepper::has_room).
    pub(crate) fn push_item(&mut self, number: u8, item: Item) {
        let epoch = self.epoch();
        if let Some(queue) = self.memory.local_items.get_mut(usize::from(number)) {
            let _ = queue.push(Entry { epoch, item });
        }
    }

    /// What verbs may ask of each motor, and its position.
    pub(crate) fn limits(&self) -> impl Iterator<Item = (MotorTiming, i32)> {
        self.motors().map(|motor| (motor.limits, motor.words.channel().position()))
    }

    /// Has a motor make the steps of a path in the millisecond that begins at `begin`.
    pub(crate) fn push_steps(&mut self, number: u8, begin: Tick32, steps: SliceSteps) {
        let epoch = self.epoch();
        let Some(queue) = self.memory.local_items.get_mut(usize::from(number)) else { return };
        let mut push = |item| {
            // It has no room only if the main loop was late by milliseconds. Then the state machines have run dry, and all motors
            // stop.
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

    /// All motors with their memory, and the pool of their queues.
    fn parts(&mut self) -> (&mut Pool<POOL_BYTES>, impl Iterator<Item = MotorParts<'_>>) {
        let Memory { rings, tapes, pool, .. } = &mut *self.memory;
        let places = (0..).zip(&mut self.motors).zip(tapes).zip(rings).take(usize::from(self.count));
        (pool, places.map(|(((number, motor), tape), WordRing(ring))| MotorParts { number, motor, tape, ring }))
    }

    fn motor(&self, motor: u8) -> Option<&MotorState> {
        self.motors.get(usize::from(motor)).filter(|_| motor < self.count)
    }

    fn motors(&self) -> impl Iterator<Item = &MotorState> {
        self.motors.iter().take(usize::from(self.count))
    }

    fn motors_mut(&mut self) -> impl Iterator<Item = &mut MotorState> {
        self.motors.iter_mut().take(usize::from(self.count))
    }

    /// Sets up the motors of a configuration that was checked, while nothing runs. Positions begin at 0.
    pub(crate) fn configure(&mut self, layout: &PinLayout, configuration: &Configuration<'_>, now: Tick32) {
        if self.count > 4 && layout.count <= 4 {
            pio::unload(1);
        }
        (self.count, self.next_motor) = (layout.count, 0);
        let mut at = 0;
        let pulse_ticks = u32::from(configuration.pulse_ticks).max(SHORTEST_PULSE);
        let setup_ticks = u32::from(configuration.setup_ticks).max(pulse_ticks + STEP_DIR_OVERHEAD);
        let release_ticks = configuration.idle_ms.map(|ms| u32::from(ms.max(1)) * (TICK_HZ / 1000));
        let motors = self.motors.iter_mut().zip(configuration.motors()).zip(&layout.motors);
        for ((motor, setup), wiring) in motors {
            let (output, step_line) = match wiring.lines {
                Lines::StepDir { step_line, forward_high, .. } => {
                    let (dir_line, shared_dir) = (1 - step_line, false);
                    let settings =
                        StepDirSettings { step_line, dir_line, pulse_ticks, setup_ticks, forward_high, shared_dir };
                    (Output::StepDir(StepDir::new(settings)), step_line)
                }
                Lines::Coils { sequence } => {
                    let mut lines = [0; 4];
                    for (line, pin) in lines.iter_mut().zip(wiring.pins()) {
                        *line = pin - wiring.base;
                    }
                    (Output::Coils(Coils::new(lines, sequence, release_ticks)), 0)
                }
            };
            motor.words = WordWriter::new(output, step_line, pulse_ticks);
            let packing = Packing { fraction_bits: FRACTION_BITS, gain: setup.gain };
            let equal = POOL_BYTES / usize::from(layout.count.max(1));
            let by_need = POOL_BYTES / usize::from(QUEUE_PARTS) * usize::from(setup.queue_parts);
            let queue = if by_need == 0 { equal } else { by_need }.min(LONGEST_QUEUE_BYTES) as u16;
            motor.packed = PackedQueue::new(Pool::<POOL_BYTES>::part(at, queue), packing);
            at += queue;
            (motor.wiring, motor.pulse_ticks, motor.pull_in_ticks) = (*wiring, pulse_ticks, setup.pull_in_ticks);
            motor.limits =
                limits(&motor.words, layout.count, setup_ticks, pulse_ticks + u32::from(configuration.hold_ticks));
            motor.words.channel_mut().start_at(now);
        }
        self.dir_clearance = DIR_CLEARANCE.max(setup_ticks + 4 * (pulse_ticks + STEP_DIR_OVERHEAD));
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
            StateMachine::of(number).set_up(&motor.wiring, motor.pulse_ticks, motor.words.levels());
        }
    }

    /// Opens the gate: all state machines begin in the same cycle, with empty queues and no faults.
    pub(crate) fn start(&mut self, clock: &mut Clock) {
        let mut machines = [0; 2];
        self.memory.local_items.iter_mut().for_each(Queue::clear);
        let (pool, parts) = self.parts();
        for MotorParts { number, motor, tape, ring } in parts {
            let machine = StateMachine::of(number);
            motor.packed.items(pool).clear();
            motor.packed.clear_faults();
            motor.words.clear_faults();
            machine.set_up(&motor.wiring, motor.pulse_ticks, motor.words.levels());
            feed::set_up(number, ring, machine.fifo());
            motor.words.begin(tape, ring, FIRST_WAIT);
            feed::publish(number, tape.written());
            machines[usize::from(machine.block() & 1)] |= machine.bit();
        }
        for (block, mask) in (0..).zip(machines).filter(|(_, mask)| *mask != 0) {
            pio::enable(block, mask);
        }
        // Each has its first word by now. It stalled while it had none, which is no underrun.
        for number in 0..self.count {
            StateMachine::of(number).forget_stall();
        }
        let value = regs::interrupt_free(|| regs::set_and_time(1 << GATE));
        let at = Tick32::of(clock.at_systick(value)).after(GATE_TICKS);
        for MotorParts { motor, tape, .. } in self.parts().1 {
            motor.words.start(tape, at);
        }
        (self.runs, self.too_late, self.behind) = (true, false, false);
        self.least_ahead = u32::MAX;
        (self.next_fill, self.looked, self.fills_by_need) = (at, at, 0);
    }

    /// Writes words for the next motor that needs some. Whether there is more to do: another motor may need words, or all must be
    /// stopped as words were late.
    #[inline(never)]
    pub(crate) fn fill(&mut self, clock: &mut Clock) -> bool {
        let now = clock.now32();
        if !self.runs || now.is_before(self.next_fill) {
            return false;
        }
        let timing = self.timing;
        let mut wait = timing.longest_wait;
        let (mut least, mut until) = (now.after(timing.rest_look_ahead), now.after(timing.look_ahead));
        if let Some(known) = self.known_until {
            let last = known.before(self.dir_clearance);
            until = if last.is_before(until) { last } else { until };
            least = if last.is_before(least) { last } else { least };
        }
        if now.since(self.looked) > LATE {
            self.fills_by_need = self.count;
        }
        self.looked = now;
        if self.fills_by_need != 0 {
            self.fills_by_need -= 1;
            self.next_motor = self.first_to_run_dry(now);
        }
        let Memory { rings, tapes, pool, local_items } = &mut *self.memory;
        for _ in 0..self.count {
            let number = self.next_motor;
            self.next_motor = if number + 1 >= self.count { 0 } else { number + 1 };
            let index = usize::from(number);
            let (Some(motor), Some(tape), Some(WordRing(ring))) =
                (self.motors.get_mut(index), tapes.get_mut(index), rings.get_mut(index))
            else {
                continue;
            };
            let ahead = motor.words.end().since(now).cast_signed();
            if ahead >= timing.refill_early_below.cast_signed() {
                wait = wait.min(ahead.cast_unsigned() - timing.refill_below);
                continue;
            }
            tape.pass(now);
            motor.words.pass(now);
            // Then words come before the host's frames.
            self.behind = ahead < timing.behind_below.cast_signed();
            self.least_ahead = self.least_ahead.min(ahead.max(0).cast_unsigned());
            let stretch = [least, until];
            let dry = motor.words.end().after(motor.words.overhead());
            match local_items.get_mut(index).filter(|_| self.known_until.is_some()) {
                Some(items) => motor.words.fill(items, tape, ring, stretch, WORDS_PER_FILL, expand),
                None => motor.words.fill(&mut motor.packed.items(pool), tape, ring, stretch, WORDS_PER_FILL, expand),
            };
            let has_unreported_lapse = motor.words.channel().has_unreported_lapse();
            if !clock.now32().after(NEARLY_DRY).is_before(dry) {
                // Words that come too late would be steps at wrong times: better none at all. The caller looks at once, instead of
                // sleeping first.
                self.too_late = true;
                return true;
            }
            feed::publish(number, tape.written());
            if has_unreported_lapse {
                self.share_lapse();
            }
            return true;
        }
        self.next_fill = now.after(wait);
        self.behind = false;
        false
    }

    /// The motor whose words end first. Slow motors have up to 0.6 ms less than fast ones, as words for rest are written for less:
    /// if turns went on in order after the main loop was late, a slow one could run dry while faster ones, that have time, get
    /// words.
    #[inline(never)]
    fn first_to_run_dry(&self, now: Tick32) -> u8 {
        let mut first = (0, i32::MAX);
        for (number, motor) in (0..self.count).zip(&self.motors) {
            let ahead = motor.words.end().since(now).cast_signed();
            if ahead < first.1 {
                first = (number, ahead);
            }
        }
        first.0
    }

    /// A motor has noticed that its lease is over: all others brake from the same tick on.
    #[inline(never)]
    fn share_lapse(&mut self) {
        let channels = || self.motors.iter().take(usize::from(self.count)).map(|motor| motor.words.channel());
        let Some(lapse) = channels::agreed_lapse(channels()) else { return };
        if lapse.cause.is_fault()
            && let Some((number, _)) = (0..).zip(channels()).find(|(_, channel)| channel.has_unreported_lapse())
        {
            self.at_fault = number;
        }
        self.lapse_at(lapse);
    }

    /// How long the motors need nothing, ticks.
    pub(crate) const fn ticks_to_next_fill(&self, now: Tick32) -> u32 {
        let wait = self.next_fill.since(now).cast_signed();
        match wait {
            _ if !self.runs => self.timing.longest_wait,
            // A motor needs words by now.
            ..=0 => self.timing.longest_delay,
            wait => wait.cast_unsigned(),
        }
    }

    /// Whether words are more urgent than the host's frames.
    #[inline(always)]
    pub(crate) const fn is_behind(&self) -> bool {
        self.runs && self.behind
    }

    /// Notes the time while nothing runs. To be called at least once in 2^30 ticks.
    pub(crate) fn pass(&mut self, now: Tick32) {
        if !self.runs {
            for motor in self.motors_mut() {
                motor.words.channel_mut().pass(now);
            }
        }
    }

    /// Whether a state machine ran dry, or words for one came too late.
    #[inline(always)]
    pub(crate) fn has_underrun(&self) -> bool {
        let dry = || (pio::stalled(0) | if self.count > 4 { pio::stalled(1) } else { 0 }) != 0;
        self.runs && (self.too_late || dry())
    }

    /// The immediate stop: halts all state machines, and counts what they did.
    pub(crate) fn stop(&mut self, clock: &mut Clock) -> Halt {
        (self.known_until, self.timing) = (None, FillTiming::PLANS);
        if !self.runs {
            let tick = clock.now();
            return Halt { tick, uncertain: 0, reached: [tick; MOTORS] };
        }
        self.runs = false;
        // With interrupts off: none may start a DMA channel again, or come between a halt and the end of a pulse.
        let (tick, in_pulse) = regs::interrupt_free(|| {
            pio::halt(0, 0xf);
            if self.count > 4 {
                pio::halt(1, 0xf);
            }
            let tick = clock.now();
            regs::SIO_OUT_CLR.write(1 << GATE);
            (tick, self.end_pulses())
        });
        // All pulses that were begun are over by then.
        let fall = clock.now32().after(self.longest_pulse() + STEP_DIR_OVERHEAD);
        let mut halt = Halt { tick, uncertain: 0, reached: [tick; MOTORS] };
        let (pool, parts) = self.parts();
        for MotorParts { number, motor, tape, ring } in parts {
            let machine = StateMachine::of(number);
            let taken = regs::interrupt_free(|| feed::end(number, ring));
            let pulled = taken.wrapping_sub(machine.waiting());
            let is_done = in_pulse >> number & 1 != 0 || machine.has_changed_lines(&motor.wiring.lines);
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
            let last = ring[done.saturating_sub(1) as usize % RING_WORDS];
            words.stop(&mut items, made, lines(last));
        }
        while in_pulse != 0 && clock.now32().is_before(fall) {}
        for (block, mask) in blocks(in_pulse) {
            pio::halt(block, mask);
        }
        halt
    }

    /// Lets state machines that were halted in a pulse go on to its end, and returns which, bit by motor. The gate is closed.
    ///
    /// To be called right after the halt: until then STEP stays active longer than its pulse.
    fn end_pulses(&self) -> u8 {
        let mut in_pulse = 0;
        for (number, motor) in (0..self.count).zip(&self.motors) {
            let machine = StateMachine::of(number);
            if matches!(motor.wiring.lines, Lines::StepDir { .. }) && machine.is_in_pulse() {
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

    /// Switches the current of all coils off, while nothing runs.
    pub(crate) fn release_coils(&mut self) {
        for (number, motor) in (0..self.count).zip(&mut self.motors) {
            if let Lines::Coils { .. } = motor.wiring.lines {
                motor.words.release();
                StateMachine::of(number).set_lines(&motor.wiring, motor.words.levels());
            }
        }
    }

    /// Puts packed items last in a motor's queue; `None` if it has no room, or is not there.
    pub(crate) fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Option<()> {
        let motor = self.motors.get_mut(usize::from(motor))?;
        if !motor.words.channel().accepts(epoch) {
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

    /// Switches all motors, or none if a switch waits for an earlier tick or one is committed too far. From `at` on the plan holds
    /// as long as `lease` says.
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

    /// Extends the lease of all motors to `lease`. The caller has asked whether that [can be done](Stepper::can_extend).
    pub(crate) fn extend(&mut self, lease: Lease, limits: &[u8]) {
        for (motor, limit) in self.motors_mut().zip(limits_of(limits).map(Some).chain(iter::repeat(None))) {
            motor.words.channel_mut().extend(lease, limit);
        }
    }

    /// Whether [`extend`](Stepper::extend) would be accepted now.
    pub(crate) fn can_extend(&self, lease: Lease) -> bool {
        self.motors().all(|motor| motor.words.channel().check_extend(lease).is_ok())
    }

    /// Takes bytes back from the end of each motor's queue; `counts` has two bytes for each motor. Returns the first motor that has
    /// fewer bytes unread: then nothing changes.
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

    /// Has all motors brake from the lapse's tick on, if they do not already.
    pub(crate) fn lapse_at(&mut self, lapse: Lapse) {
        for motor in self.motors_mut() {
            motor.words.channel_mut().lapse_at(lapse);
        }
    }

    /// The lease of all motors.
    #[inline(never)]
    pub(crate) fn lease(&self) -> LeaseReport {
        let lease = self.motor(0).map_or(Lease::Off, |motor| motor.words.channel().lease());
        let mut report = LeaseReport { lease, lapse: None, was_moving: false, at_fault: self.at_fault };
        for channel in self.motors().filter(|_| lease != Lease::Off).map(|motor| motor.words.channel()) {
            let lapse = channel.lapse();
            // A fault is the cause of all others' lapses.
            if report.lapse.is_none() || lapse.is_some_and(|lapse| lapse.cause.is_fault()) {
                report.lapse = lapse.or(report.lapse);
            }
            report.was_moving |= channel.was_moving();
        }
        report
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
        let (Some(motor), Some(tape), Some(WordRing(ring))) =
            (self.motor(number), self.memory.tapes.get(index), self.memory.rings.get(index))
        else {
            return 0;
        };
        if self.runs { tape.position_at(now, motor.words.overhead(), ring) } else { motor.words.channel().position() }
    }

    /// Whether nothing is left to do on any motor: no step, no end of a pulse.
    pub(crate) fn is_idle(&self, now: Tick32) -> bool {
        let follows = self.known_until.is_some() && self.memory.local_items.iter().any(|items| !items.is_empty());
        !self.runs || (!follows && self.motors().all(|motor| motor.words.is_idle(&motor.packed, now)))
    }

    /// What is wrong with a motor's queue: see [`flags`].
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

    /// The least that any motor had left when it got words, ticks.
    pub(crate) const fn least_ahead(&self) -> u32 {
        self.least_ahead
    }

    /// Begins to measure again.
    pub(crate) const fn reset_measures(&mut self) {
        self.least_ahead = u32::MAX;
    }
}

/// The blocks that have state machines of these motors, bit by motor, and which.
fn blocks(motors: u8) -> impl Iterator<Item = (u8, u32)> {
    (0..).zip([u32::from(motors & 0xf), u32::from(motors >> 4)]).filter(|(_, mask)| *mask != 0)
}

/// What verbs may ask of a motor: `pulse` is the time of a pulse with the hold of DIR, `setup` the set-up of DIR, ticks.
fn limits(words: &WordWriter<FRACTION_BITS>, count: u8, setup: u32, pulse: u32) -> MotorTiming {
    let (work, turn) =
        if words.makes_pulses() { (STEP_TICKS, pulse.max(words.overhead()) + setup) } else { (PATTERN_TICKS, 0) };
    let shortest = (work * u32::from(count)).max(words.overhead() + 1);
    MotorTiming { shortest, turn: turn.max(shortest), period: FIRST_PERIOD.max(shortest) }
}

/// What a step of a verb takes of the processor's time, with room for everything else, cycles: for a driver, and for coils.
const STEP_TICKS: u32 = 125;
const PATTERN_TICKS: u32 = 1000;

/// The period until a verb sets another, ticks: 1000 steps/s, as fast as the motors of the Pico plotter (002) turn.
const FIRST_PERIOD: u32 = TICK_HZ / 1000;
