//! A model of a board behind a serial line, without an emulated chip: fast enough for many tests of the link.
//!
//! Its steps are those of a native board with 16 fraction bits, and its protocol is the [`Service`] that firmware runs. Bytes take their time on the
//! line, and behind a USB bridge, which is that of a virtual Uno. The model is also an example of what a [`BoardSide`] has to do.

use crate::Random;
use pulsetrain_board::bridge::ToHost;
use pulsetrain_board::lease::{ExtendRefused, TrimRefused};
use pulsetrain_board::native::QUEUE_LEN;
use pulsetrain_board::{
    Board, Config, Edge, Lease, LeaseState, Leased, MotorConfig, Native, Port, PortError, SwitchRefused, Wiring,
};
use pulsetrain_core::lease;
use pulsetrain_core::packing::{Packing, State};
use pulsetrain_core::verbs::{MotorTiming, Verbs};
use pulsetrain_core::wire::message::{
    self, ALL_MOTORS, Cause, Configuration, Event, Info, Measures, QUEUE_PARTS, Reason, flags, limits_of,
};
use pulsetrain_core::wire::orders::{Obeyed, Orders};
use pulsetrain_core::wire::outcome::NO_LEASE;
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{
    Baud, BoardSide, Decoder, Encoder, MAX_BODY, MAX_FRAME, Millis, Refusal, Service, Stopped, Switched, Trimmed,
};
use pulsetrain_core::{Epoch, Tick32};
use std::collections::VecDeque;
use std::time::Duration;

/// Ticks per second.
pub const TICK_HZ: u32 = 16_000_000;

/// Fraction bits of an interval (F).
const FRACTION_BITS: u32 = 16;

/// Most motors of the model.
const MOTORS: u8 = 4;

/// Bytes of all queues together.
const POOL: u16 = 1024;

/// Bytes of the receive buffer.
const UNREAD: u16 = 240;

/// Ticks of a round of the main loop: 50 µs.
const ROUND: u64 = 800;

/// How far ahead the steps of motors that obey verbs are computed, ticks: a verb holds from there on. Two rounds, and as much for the DIR setup.
const AHEAD: u64 = 4 * ROUND;

/// The period with which motors that obey verbs begin, ticks: 1000 steps/s.
const FIRST_PERIOD: u32 = TICK_HZ / 1000;

/// Ticks from one frame of USB to the next: 1 ms.
const USB_FRAME: u64 = TICK_HZ as u64 / 1000;

/// The board: motors, queues and clock, without the line.
#[derive(Clone, Debug)]
pub struct Model {
    /// Bytes of all queues together, and of the receive buffer.
    memory: [u16; 2],
    native: Native,
    motors: Vec<Motor>,
    /// Whether the motors are armed.
    armed: bool,
    /// The rate that the line should have.
    baud: Baud,
    events: VecDeque<Event>,
    measures: Measures,
    last_stop: Cause,
    was_idle: bool,
    /// The end of a lease that was reported as an event.
    braked: Option<u64>,
    limits: Vec<MotorTiming>,
    /// Whether the motors obey verbs: until they are released or stopped.
    obeys: bool,
    verbs: Verbs,
    obeyed: Obeyed,
    /// The stored settings, which the board keeps without power.
    settings: Option<[u8; SETTINGS_LEN]>,
}

#[derive(Clone, Debug)]
struct Motor {
    packing: Packing,
    epoch: Option<Epoch>,
    state: State,
    /// The items in the native board's queue.
    items: VecDeque<Waiting>,
    capacity: usize,
    faults: u8,
    /// The shortest interval at which the motor can start and stop, ticks.
    pull_in_ticks: u64,
}

/// An item in the native board's queue.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    len: usize,
    /// The epoch, and the state of unpacking, from before the item.
    epoch: Option<Epoch>,
    state: State,
}

impl Model {
    /// A board at tick 0 without configured motors. `memory`: bytes of all queues together, and of the receive buffer.
    #[must_use]
    pub fn new(memory: [u16; 2]) -> Model {
        Model {
            memory,
            native: bare(),
            motors: Vec::new(),
            armed: false,
            baud: Baud::B115200,
            events: VecDeque::new(),
            measures: Measures::default(),
            last_stop: Cause::None,
            was_idle: true,
            braked: None,
            limits: Vec::new(),
            obeys: false,
            verbs: Verbs::new(),
            obeyed: Obeyed::NONE,
            settings: None,
        }
    }

    /// Computes the steps of motors that obey verbs.
    fn work_out(&mut self, until: u64) {
        if self.obeys {
            self.verbs.work_out::<FRACTION_BITS>(until, |motor, item| {
                let entry = pulsetrain_core::Entry { epoch: Board::epoch(&self.native), item };
                self.native.push(motor.into(), entry).expect("a slice has few items");
            });
        }
    }

    fn rests(&self) -> bool {
        self.native.idle() && (!self.obeys || self.verbs.rest_at(self.native.now()))
    }

    /// Marks the positions of motors that were stopped too fast as uncertain.
    fn flag(&mut self, uncertain: u8) {
        for (number, motor) in self.motors.iter_mut().enumerate() {
            motor.faults |= if uncertain >> number & 1 == 0 { 0 } else { flags::UNCERTAIN };
        }
    }

    /// The native board that makes its steps.
    #[must_use]
    pub const fn native(&self) -> &Native {
        &self.native
    }

    /// Lets time pass, up to and with `tick`.
    pub fn run(&mut self, tick: u64, edges: &mut Vec<Edge>) {
        self.work_out(tick + AHEAD);
        self.native.advance(tick, &mut |edge: Edge| edges.push(edge));
        self.look_after_lease();
        let idle = self.rests();
        if idle && !self.was_idle && self.braked.is_none() {
            self.stopped(Cause::Finished);
        }
        self.was_idle = idle;
        self.sync(false);
    }

    /// Reports the end of a lease as an event if motors were in motion, once the time of all motors is past it.
    fn look_after_lease(&mut self) {
        let LeaseState::Lapsed { at, cause, in_motion } = Leased::lease(&self.native) else {
            self.braked = None;
            return;
        };
        if !in_motion || at >= self.native.now() || self.braked.is_some() {
            return;
        }
        self.braked = Some(at);
        self.last_stop = match cause {
            lease::LapseCause::NotExtended => Cause::Lapsed,
            lease::LapseCause::Ordered => Cause::Braked,
            lease::LapseCause::Underrun => Cause::RanDry,
            lease::LapseCause::BadItem => Cause::BadItem,
            lease::LapseCause::StepMissed => Cause::StepMissed,
        };
        let at_fault = |motor: &u8| self.native.faults(usize::from(*motor)).step_missed;
        let motor = (0..self.motors()).find(at_fault).unwrap_or(ALL_MOTORS);
        self.events.push_back(Event { cause: self.last_stop, motor, tick: at, detail: 0 });
    }

    /// The lease of a frame, with 64-bit ticks.
    fn lease_of(&self, lease: lease::Lease) -> Lease {
        match lease {
            lease::Lease::Off => unreachable!("no frame sets a lease off"),
            lease::Lease::Until(until) => Lease::Until(self.near(until)),
            lease::Lease::Last => Lease::Last,
        }
    }

    /// A 32-bit tick in 64 bits: the one within 2^31 of now.
    fn near(&self, moment: Tick32) -> u64 {
        let now = self.native.now();
        now.saturating_add_signed(moment.since(Tick32::of(now)).cast_signed().into())
    }

    /// How many items at the end of a motor's queue have `len` bytes together; `None` if no number of items has.
    fn items_of(&self, motor: &Motor, bytes: usize) -> Option<usize> {
        let ends = motor.items.iter().rev().scan(0, |sum, item| {
            *sum += item.len;
            Some(*sum)
        });
        std::iter::once(0).chain(ends).position(|sum| sum == bytes)
    }

    fn stopped(&mut self, cause: Cause) {
        self.last_stop = cause;
        self.tell(cause, ALL_MOTORS, 0);
    }

    fn tell(&mut self, cause: Cause, motor: u8, detail: u32) {
        self.events.push_back(Event { cause, motor, tick: self.native.now(), detail });
    }

    /// Forgets the items that have left the queues: at the front, or at the end if `back`.
    fn sync(&mut self, back: bool) {
        for (index, motor) in self.motors.iter_mut().enumerate() {
            let waiting = QUEUE_LEN - self.native.credit(index);
            while motor.items.len() > waiting {
                if back {
                    motor.items.pop_back();
                } else {
                    motor.items.pop_front();
                }
            }
        }
    }

    fn drop_epoch(&mut self, epoch: Epoch) {
        self.sync(true);
        for motor in self.motors.iter_mut().filter(|motor| motor.epoch == Some(epoch)) {
            motor.epoch = None;
        }
    }

    fn empty(&mut self) {
        for motor in &mut self.motors {
            motor.items.clear();
            motor.epoch = None;
        }
    }
}

fn bare() -> Native {
    Native::new(&Config { fraction_bits: FRACTION_BITS, motors: Vec::new() }).expect("no motors, nothing to refuse")
}

impl BoardSide for Model {
    const OBEYS: bool = true;
    const STORES: bool = true;

    fn info(&mut self) -> Info {
        Info {
            board: 0,
            firmware: [0, 1, 0],
            tick_hz: TICK_HZ,
            fraction_bits: FRACTION_BITS as u8,
            max_motors: MOTORS,
            pool: self.memory[0],
            window: self.memory[1],
            bauds: 0b1_1111,
            last_stop: self.last_stop,
            last_reset: Cause::PowerOn,
            ..Info::NOBODY
        }
    }

    fn configure(&mut self, configuration: &Configuration<'_>) -> Result<(), Refusal> {
        if !self.rests() {
            return Err(Refusal::of(Reason::Moving));
        }
        if configuration.motors().len() > usize::from(MOTORS) {
            return Err(Refusal { reason: Reason::TooManyMotors, detail: u16::from(MOTORS) });
        }
        let motors = configuration.motors().map(|motor| MotorConfig {
            wiring: Wiring::StepDir {
                step: motor.step_pin,
                dir: motor.dir_pin,
                forward_high: motor.forward_high,
                pulse_ticks: u32::from(configuration.pulse_ticks),
                setup_ticks: u32::from(configuration.setup_ticks),
            },
            pull_in_ticks: u64::from(motor.pull_in_ticks),
        });
        let config = Config { fraction_bits: FRACTION_BITS, motors: motors.collect() };
        let native = Native::new(&config).map_err(|_| Refusal::of(Reason::PinMix))?;
        let mut native = native.with_dir_hold(configuration.hold_ticks.into());
        // The board's clock goes on.
        if let Some(last) = self.native.now().checked_sub(1) {
            native.advance(last, &mut |_: Edge| {});
        }
        self.native = native;
        let [pulse, setup, hold] = [configuration.pulse_ticks, configuration.setup_ticks, configuration.hold_ticks];
        let turn = u32::from(pulse.max(1)) + u32::from(hold) + u32::from(setup);
        let shortest = u32::from(pulse.max(1)) + 1;
        self.limits = configuration
            .motors()
            .map(|_| MotorTiming { shortest, turn: turn.max(shortest), period: FIRST_PERIOD.max(shortest) })
            .collect();
        let count = configuration.motors().len().max(1);
        self.motors = configuration
            .motors()
            .map(|motor| Motor {
                packing: Packing { fraction_bits: FRACTION_BITS, gain: motor.gain },
                epoch: None,
                state: State::default(),
                items: VecDeque::new(),
                capacity: match usize::from(motor.queue_parts) {
                    0 => usize::from(self.memory[0]) / count,
                    parts => usize::from(self.memory[0]) * parts / usize::from(QUEUE_PARTS),
                },
                faults: 0,
                pull_in_ticks: motor.pull_in_ticks.into(),
            })
            .collect();
        self.armed = false;
        Ok(())
    }

    fn arm(&mut self) -> Result<(), Refusal> {
        if self.motors.is_empty() {
            return Err(Refusal::of(Reason::NotConfigured));
        }
        if !self.rests() {
            return Err(Refusal::of(Reason::Moving));
        }
        // Empties the queues.
        self.native.stop_now(self.native.now().saturating_sub(1), &mut |_: Edge| {});
        self.empty();
        self.obeys = false;
        self.motors.iter_mut().for_each(|motor| motor.faults = 0);
        self.armed = true;
        Ok(())
    }

    fn release(&mut self) -> Result<(), Refusal> {
        if !self.rests() {
            return Err(Refusal::of(Reason::Moving));
        }
        self.armed = false;
        self.obeys = false;
        Ok(())
    }

    fn motors(&self) -> u8 {
        self.motors.len() as u8
    }

    fn free(&self, motor: u8) -> u16 {
        self.motors
            .get(usize::from(motor))
            .map_or(0, |motor| (motor.capacity - motor.items.iter().map(|item| item.len).sum::<usize>()) as u16)
    }

    fn push(&mut self, index: u8, epoch: Epoch, packed: &[u8]) -> Result<(), Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if self.obeys {
            return Err(Refusal::of(Reason::Obeying));
        }
        let free = usize::from(self.free(index));
        let Some(motor) = self.motors.get_mut(usize::from(index)) else {
            return Err(Refusal { reason: Reason::NoSuchMotor, detail: u16::from(index) });
        };
        if packed.len() > free {
            return Err(Refusal { reason: Reason::Full, detail: u16::from(index) });
        }
        let mut rest = packed;
        loop {
            let before = (rest.len(), motor.epoch, motor.state);
            if motor.epoch != Some(epoch) {
                (motor.epoch, motor.state) = (Some(epoch), State::default());
            }
            match motor.packing.unpack(&mut motor.state, &mut rest) {
                Ok(Some(item)) => {
                    let entry = pulsetrain_core::Entry { epoch, item };
                    let credit = self.native.credit(index.into());
                    self.native.push(usize::from(index), entry).expect("an item takes a byte at least");
                    // After the end of its lease, an epoch's items are dropped.
                    if self.native.credit(index.into()) < credit {
                        let (len, epoch, state) = before;
                        motor.items.push_back(Waiting { len: len - rest.len(), epoch, state });
                    }
                }
                Ok(None) => return Ok(()),
                Err(_) => {
                    motor.faults |= flags::BAD_ITEM;
                    self.tell(Cause::BadItem, index, 0);
                    return Ok(());
                }
            }
        }
    }

    fn discard(&mut self, epoch: Epoch) {
        Board::discard(&mut self.native, epoch);
        self.drop_epoch(epoch);
    }

    fn switch(&mut self, epoch: Epoch, tick: u64, lease: lease::Lease, limits: &[u8]) -> Result<Switched, Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if self.obeys {
            return Err(Refusal::of(Reason::Obeying));
        }
        let limits: Vec<_> = limits_of(limits).collect();
        Ok(match self.native.switch(epoch, tick, self.lease_of(lease), &limits) {
            Ok(()) => {
                self.was_idle = false;
                return Ok(Switched::Accepted);
            }
            Err(refused) => {
                self.drop_epoch(epoch);
                match refused {
                    SwitchRefused::Late { horizon } => Switched::Late { horizon },
                    SwitchRefused::Early { limit } => Switched::Early { limit },
                    SwitchRefused::Full | SwitchRefused::Lost => Switched::Full,
                }
            }
        })
    }

    fn extend(&mut self, lease: lease::Lease, limits: &[u8]) -> bool {
        let limits: Vec<_> = limits_of(limits).collect();
        self.armed && self.native.extend(self.lease_of(lease), &limits).is_ok()
    }

    fn trim(&mut self, until: Tick32, bytes: &[u8]) -> Result<Trimmed, Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        self.sync(false);
        let bytes = bytes.as_chunks().0.iter().map(|bytes| usize::from(u16::from_le_bytes(*bytes)));
        let mut counts = Vec::new();
        for (index, (motor, bytes)) in (0..).zip(self.motors.iter().zip(bytes)) {
            match self.items_of(motor, bytes) {
                Some(count) => counts.push(count),
                None => return Ok(Trimmed::TooMany { motor: index }),
            }
        }
        let horizon = self.native.horizon();
        Ok(match self.native.trim(self.near(until), &counts) {
            Ok(()) => {
                for (motor, count) in self.motors.iter_mut().zip(counts) {
                    let left = motor.items.len() - count;
                    if let Some(Waiting { epoch, state, .. }) = motor.items.drain(left..).next() {
                        (motor.epoch, motor.state) = (epoch, state);
                    }
                }
                Trimmed::Accepted
            }
            Err(TrimRefused::Extend(ExtendRefused::Late { .. } | ExtendRefused::Early { .. })) => {
                Trimmed::Late { horizon }
            }
            Err(TrimRefused::Extend(_)) => Trimmed::NoLease,
            Err(TrimRefused::Read { motor }) => Trimmed::TooMany { motor: motor as u8 },
        })
    }

    fn brake(&mut self) -> u64 {
        if self.armed { self.native.brake().unwrap_or(NO_LEASE) } else { NO_LEASE }
    }

    fn lease(&self) -> (u8, u32) {
        let state = match Leased::lease(&self.native) {
            LeaseState::Off => message::LeaseState::Off,
            LeaseState::Until(until) => message::LeaseState::Until(Tick32::of(until)),
            LeaseState::Last => message::LeaseState::Last,
            LeaseState::Lapsed { at, .. } => message::LeaseState::Lapsed(Tick32::of(at)),
        };
        state.to_parts()
    }

    fn stop_now(&mut self) -> Stopped {
        let report = self.native.stop_now(self.native.now().saturating_sub(1), &mut |_: Edge| {});
        let uncertain = (0..).zip(&report.uncertain).fold(0, |all, (bit, one)| all | u8::from(*one) << bit);
        self.empty();
        self.armed = false;
        if self.obeys {
            self.verbs.stop(|_| report.tick);
        }
        self.obeys = false;
        self.flag(uncertain);
        self.stopped(Cause::StopNow);
        self.was_idle = true;
        Stopped { tick: report.tick, uncertain }
    }

    fn clock(&mut self) -> u64 {
        self.native.now()
    }

    fn flags(&self) -> u8 {
        let configured = if self.motors.is_empty() { 0 } else { flags::CONFIGURED };
        let armed = if self.armed { flags::ARMED } else { 0 };
        configured | armed | if self.rests() { flags::IDLE } else { 0 }
    }

    fn horizon(&mut self) -> u64 {
        self.native.horizon()
    }

    fn epoch(&self) -> Epoch {
        Board::epoch(&self.native)
    }

    fn position(&mut self, motor: u8) -> i32 {
        self.native.positions().get(usize::from(motor)).map_or(0, |position| *position as i32)
    }

    fn faults(&self, motor: u8) -> u8 {
        let index = usize::from(motor);
        let faults = self.native.faults(index);
        let mut all = self.motors.get(index).map_or(0, |motor| motor.faults);
        if faults.step_missed {
            all |= flags::STEP_MISSED;
        }
        if faults.setup_cut_short {
            all |= flags::SETUP_CUT_SHORT;
        }
        all
    }

    fn measures(&mut self) -> &mut Measures {
        &mut self.measures
    }

    fn rate_fell_back(&mut self) {
        self.tell(Cause::BaudFellBack, ALL_MOTORS, 0);
    }

    fn reset_measures(&mut self) {}

    fn can_baud(&self, _: Baud) -> bool {
        true
    }

    fn set_baud(&mut self, baud: Baud) {
        self.baud = baud;
    }

    fn host_gone(&mut self, lost: bool) {
        if lost && !self.rests() {
            self.stopped(Cause::HostLost);
        }
        if self.obeys {
            let motors = &self.motors;
            let uncertain = self
                .verbs
                .host_gone(lost, |motor| motors.get(usize::from(motor)).map_or(0, |motor| motor.pull_in_ticks));
            self.flag(uncertain);
        }
        self.verbs.mute_moves();
    }

    fn obey(&mut self, orders: &Orders<'_>) -> Result<(), Refusal> {
        if !self.armed {
            return Err(Refusal::of(Reason::NotArmed));
        }
        if !self.obeys {
            if !self.native.idle() {
                return Err(Refusal::of(Reason::Moving));
            }
            let positions = self.native.positions();
            let motors = self.limits.iter().zip(positions).map(|(limits, position)| (*limits, position as i32));
            self.verbs.begin(motors, self.native.now() + AHEAD);
        }
        self.obeyed = orders.tell(&mut self.verbs)?;
        // A command without orders only asks, and changes nothing.
        if !orders.is_empty() {
            self.obeys = true;
            self.was_idle = false;
        }
        Ok(())
    }

    fn obeyed(&self, frame: &mut Encoder<'_>) {
        self.obeyed.encode(frame);
    }

    fn store(&mut self, settings: Option<&[u8; SETTINGS_LEN]>) -> Result<(), Refusal> {
        if self.armed {
            return Err(Refusal::of(Reason::Moving));
        }
        self.settings = settings.copied().or(self.settings);
        Ok(())
    }

    fn stored(&mut self, settings: &mut [u8; SETTINGS_LEN]) -> bool {
        *settings = self.settings.unwrap_or_default();
        self.settings.is_some()
    }

    fn event(&mut self) -> Option<Event> {
        let now = self.native.now();
        if let Some((motor, tick, detail)) = self.verbs.take_done(now) {
            return Some(Event { cause: Cause::MoveDone, motor, tick, detail });
        }
        self.events.pop_front()
    }
}

/// A byte on the line: when it arrives, and the rate at which it was sent.
type Flying = (u64, Baud, u8);

/// A port: the line to a model, and the model at its end.
#[derive(Debug)]
pub struct ModelPort {
    model: Model,
    decoder: Decoder,
    service: Service,
    /// Ticks since the port was opened.
    now: u64,
    /// The host's rate.
    baud: Baud,
    to_board: VecDeque<Flying>,
    to_host: VecDeque<Flying>,
    /// What the bridge holds back.
    bridge: ToHost,
    edges: Vec<Edge>,
    /// Random bits, for bytes that were sent at another rate.
    noise: Random,
}

impl ModelPort {
    /// A model at tick 0, without a session.
    #[must_use]
    pub fn new() -> ModelPort {
        ModelPort::with_memory(POOL, UNREAD)
    }

    /// As [`new`](ModelPort::new), with `pool` bytes of queues in all, and a receive buffer of `unread` bytes.
    #[must_use]
    pub fn with_memory(pool: u16, unread: u16) -> ModelPort {
        ModelPort {
            model: Model::new([pool, unread]),
            decoder: Decoder::new(),
            service: Service::new(MAX_BODY),
            now: 0,
            baud: Baud::B115200,
            to_board: VecDeque::new(),
            to_host: VecDeque::new(),
            bridge: ToHost::default(),
            edges: Vec::new(),
            noise: Random::new(1),
        }
    }

    /// The model's positions, read past the line and its faults.
    #[must_use]
    pub fn positions(&self) -> Vec<i64> {
        self.model.native.positions()
    }

    /// The state of the model's lease, read past the line and its faults.
    #[must_use]
    pub fn lease(&self) -> LeaseState {
        Leased::lease(&self.model.native)
    }

    /// Whether a host has a session with it.
    #[must_use]
    pub const fn is_taken(&self) -> bool {
        self.service.is_taken()
    }

    /// The rate of the model's end of the line.
    #[must_use]
    pub const fn board_baud(&self) -> Baud {
        self.model.baud
    }

    /// Resets the board, as opening a port does: everything it knew is gone, and the motors stop where they are.
    pub fn reset(&mut self) {
        self.model = Model::new(self.model.memory);
        self.decoder = Decoder::new();
        self.service = Service::new(MAX_BODY);
        self.to_host.clear();
    }

    /// Lets the model's time pass to tick `until` while no host sends or receives.
    pub fn run_alone(&mut self, until: u64) {
        while self.now < until {
            self.round();
        }
    }

    /// One round of the board's main loop.
    fn round(&mut self) {
        self.now += ROUND;
        self.model.run(self.model.native.now() + ROUND - 1, &mut self.edges);
        let millis = Millis((self.now >> 14) as u16);
        let ModelPort { model, decoder, service, now, to_board, to_host, noise, .. } = self;
        while let Some((_, baud, byte)) = to_board.pop_front_if(|(at, ..)| *at <= *now) {
            let received = decoder.push(heard(byte, baud, model.baud, noise));
            service.receive(received, decoder.body(), millis, model);
        }
        if to_host.back().is_none_or(|(at, ..)| *at <= *now) {
            let mut out = [0; MAX_FRAME + 1];
            let baud = model.baud;
            let len = service.poll(millis, model, &mut out);
            if model.baud != baud {
                decoder.reset();
            }
            let byte_ticks = byte_ticks(model.baud);
            to_host.extend((1..).zip(&out[..len]).map(|(index, byte)| (*now + index * byte_ticks, model.baud, *byte)));
        }
        while let Some((at, baud, byte)) = self.to_host.pop_front_if(|(at, ..)| *at <= self.now) {
            let byte = heard(byte, baud, self.baud, &mut self.noise);
            self.bridge.say(at, byte);
        }
    }
}

impl Default for ModelPort {
    fn default() -> ModelPort {
        ModelPort::new()
    }
}

/// The ticks of a byte: ten bits.
fn byte_ticks(baud: Baud) -> u64 {
    (10 * u64::from(TICK_HZ)).div_ceil(u64::from(baud.rate()))
}

fn heard(byte: u8, sent: Baud, heard: Baud, noise: &mut Random) -> u8 {
    if sent == heard { byte } else { noise.below(256) as u8 }
}

impl Port for ModelPort {
    fn now(&self) -> Duration {
        Duration::from_nanos(self.now * 125 / 2)
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        // Bytes go out with the next frame of USB, after those before them.
        let bridged = self.now.next_multiple_of(USB_FRAME);
        let mut at = self.to_board.back().map_or(bridged, |(at, ..)| bridged.max(*at));
        for byte in bytes {
            at += byte_ticks(self.baud);
            self.to_board.push_back((at, self.baud, *byte));
        }
        Ok(())
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        let had = into.len();
        while into.len() == had && self.now() < until {
            self.round();
            if self.now.is_multiple_of(USB_FRAME) {
                self.bridge.hand_over(self.now, into);
            }
        }
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        // Bytes that were sent before go out at the old rate: each has its own.
        self.baud = baud;
        Ok(())
    }

    fn edges(&mut self, into: &mut Vec<Edge>) {
        into.append(&mut self.edges);
    }
}
