//! A model of a board behind a serial line, without an emulated chip: fast enough for many tests of the link.
//!
//! Its steps are those of a native board with 16 fraction bits, and its protocol is the [`Service`] that firmware runs. Bytes take their time on the
//! line, and behind a USB bridge, which is that of a virtual Uno. The model is also the shortest example of a [`Hardware`].

use crate::Random;
use pulsetrain_board::bridge::ToHost;
use pulsetrain_board::native::QUEUE_LEN;
use pulsetrain_board::{Board, Config, Edge, Lease, LeaseState, Leased, MotorConfig, Native, Port, PortError, Wiring};
use pulsetrain_core::firmware::{FirmwareBoard, Halt, Hardware, LeaseReport};
use pulsetrain_core::lease::{self, Lapse};
use pulsetrain_core::packing::{Packing, State};
use pulsetrain_core::verbs::{MotorTiming, Verbs};
use pulsetrain_core::wire::message::{ALL_MOTORS, Cause, Configuration, Info, Measures, QUEUE_PARTS, flags, limits_of};
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Decoder, MAX_BODY, MAX_FRAME, MAX_MOTORS, Millis, Reason, Refusal, Service};
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
const AHEAD: u32 = 4 * ROUND as u32;

/// The period with which motors that obey verbs begin, ticks: 1000 steps/s.
const FIRST_PERIOD: u32 = TICK_HZ / 1000;

/// Ticks from one frame of USB to the next: 1 ms.
const USB_FRAME: u64 = TICK_HZ as u64 / 1000;

/// The board, without the line: core's [`FirmwareBoard`] on [`ModelHardware`].
#[derive(Clone, Debug)]
pub struct Model {
    /// What the service drives.
    pub side: FirmwareBoard<ModelHardware>,
}

/// A native board with queues in bytes, and a clock that the caller moves.
#[derive(Clone, Debug)]
pub struct ModelHardware {
    /// Bytes of all queues together, and of the receive buffer.
    memory: [u16; 2],
    native: Native,
    motors: Vec<Motor>,
    /// The tick up to which time passes in this round.
    round_end: u64,
    /// The rate that the line should have.
    baud: Baud,
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
    /// Packed bytes were no item.
    has_bad_item: bool,
    timing: MotorTiming,
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
        let hardware = ModelHardware {
            memory,
            native: bare(),
            motors: Vec::new(),
            round_end: 0,
            baud: Baud::B115200,
            settings: None,
        };
        Model { side: FirmwareBoard::new(hardware, Box::new(Verbs::new()), Cause::PowerOn) }
    }

    /// The native board that makes its steps.
    #[must_use]
    pub const fn native(&self) -> &Native {
        &self.side.hardware.native
    }

    /// Lets time pass, up to and with `tick`.
    pub fn run(&mut self, tick: u64, edges: &mut Vec<Edge>) {
        self.side.hardware.round_end = tick;
        self.side.plan_orders();
        self.side.hardware.native.advance(tick, &mut |edge: Edge| edges.push(edge));
        // The board reports what it sees, as others do.
        Board::events(&mut self.side.hardware.native);
        self.side.supervise(millis(tick));
        self.side.hardware.sync(false);
    }
}

/// Time in units of 2^14 ticks, 1.024 ms.
const fn millis(tick: u64) -> Millis {
    Millis((tick >> 14) as u16)
}

impl ModelHardware {
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

impl Hardware for ModelHardware {
    type Layout = Config;
    type Orders = Box<Verbs>;

    fn info(&self) -> Info {
        Info {
            board: 0,
            firmware: [0, 1, 0],
            tick_hz: TICK_HZ,
            fraction_bits: FRACTION_BITS as u8,
            max_motors: MOTORS,
            pool: self.memory[0],
            window: self.memory[1],
            bauds: 0b1_1111,
            ..Info::NOBODY
        }
    }

    fn now(&mut self) -> u64 {
        self.native.now()
    }

    fn check(&self, configuration: &Configuration<'_>) -> Result<Config, Refusal> {
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
        Native::new(&config).map(drop).map_err(|_| Refusal::of(Reason::PinMix))?;
        Ok(config)
    }

    fn configure(&mut self, layout: &Config, configuration: &Configuration<'_>) {
        let native = Native::new(layout).expect("the configuration was checked");
        let mut native = native.with_dir_hold(configuration.hold_ticks.into());
        // The board's clock goes on.
        if let Some(last) = self.native.now().checked_sub(1) {
            native.advance(last, &mut |_: Edge| {});
        }
        self.native = native;
        let [pulse, setup, hold] = [configuration.pulse_ticks, configuration.setup_ticks, configuration.hold_ticks];
        let turn = u32::from(pulse.max(1)) + u32::from(hold) + u32::from(setup);
        let shortest = u32::from(pulse.max(1)) + 1;
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
                has_bad_item: false,
                timing: MotorTiming { shortest, turn: turn.max(shortest), period: FIRST_PERIOD.max(shortest) },
            })
            .collect();
    }

    /// There is no enable pin.
    fn set_enable(&mut self, _: u8, _: bool) {}

    fn motors(&self) -> u8 {
        self.motors.len() as u8
    }

    fn start(&mut self) {
        self.stop();
        self.motors.iter_mut().for_each(|motor| motor.has_bad_item = false);
    }

    fn stop(&mut self) -> Halt {
        let report = self.native.stop_now(self.native.now().saturating_sub(1), &mut |_: Edge| {});
        let uncertain = (0..).zip(&report.uncertain).fold(0, |all, (bit, one)| all | u8::from(*one) << bit);
        self.empty();
        Halt { tick: report.tick, uncertain, reached: [report.tick; MAX_MOTORS] }
    }

    fn is_idle(&mut self, _: u64) -> bool {
        self.native.idle()
    }

    fn free(&self, motor: u8) -> u16 {
        self.motors
            .get(usize::from(motor))
            .map_or(0, |motor| (motor.capacity - motor.items.iter().map(|item| item.len).sum::<usize>()) as u16)
    }

    fn push(&mut self, index: u8, epoch: Epoch, packed: &[u8]) -> Option<()> {
        if packed.len() > usize::from(self.free(index)) {
            return None;
        }
        let motor = self.motors.get_mut(usize::from(index))?;
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
                Ok(None) => return Some(()),
                Err(_) => {
                    motor.has_bad_item = true;
                    return Some(());
                }
            }
        }
    }

    fn discard(&mut self, epoch: Epoch) {
        Board::discard(&mut self.native, epoch);
        self.drop_epoch(epoch);
    }

    fn switch(&mut self, epoch: Epoch, tick: u64, lease: lease::Lease, limits: &[u8]) -> bool {
        let limits: Vec<_> = limits_of(limits).collect();
        self.native.switch(epoch, tick, self.lease_of(lease), &limits).is_ok()
    }

    fn can_extend(&self, lease: lease::Lease) -> bool {
        lease != lease::Lease::Off && self.native.check_extend(self.lease_of(lease)).is_ok()
    }

    fn extend(&mut self, lease: lease::Lease, limits: &[u8]) {
        let limits: Vec<_> = limits_of(limits).collect();
        self.native.extend(self.lease_of(lease), &limits).expect("this was asked just before");
    }

    fn take_back(&mut self, bytes: &[u8]) -> Result<(), u8> {
        self.sync(false);
        let bytes = bytes.as_chunks().0.iter().map(|bytes| usize::from(u16::from_le_bytes(*bytes)));
        let mut counts = Vec::new();
        for (index, (motor, bytes)) in (0..).zip(self.motors.iter().zip(bytes)) {
            counts.push(self.items_of(motor, bytes).ok_or(index)?);
        }
        self.native.take_back(&counts).map_err(|motor| motor as u8)?;
        for (motor, count) in self.motors.iter_mut().zip(counts) {
            let left = motor.items.len() - count;
            if let Some(Waiting { epoch, state, .. }) = motor.items.drain(left..).next() {
                (motor.epoch, motor.state) = (epoch, state);
            }
        }
        Ok(())
    }

    fn lapse_at(&mut self, lapse: Lapse) {
        self.native.brake_at(self.near(lapse.at));
    }

    fn lease(&self) -> LeaseReport {
        let (lease, lapse, was_moving) = match Leased::lease(&self.native) {
            LeaseState::Off => (lease::Lease::Off, None, false),
            LeaseState::Until(until) => (lease::Lease::Until(Tick32::of(until)), None, false),
            LeaseState::Last => (lease::Lease::Last, None, false),
            LeaseState::Lapsed { at, cause, in_motion } => {
                (lease::Lease::Last, Some(Lapse { at: Tick32::of(at), cause }), in_motion)
            }
        };
        let is_at_fault = |motor: &u8| self.native.faults(usize::from(*motor)).step_missed;
        let at_fault = (0..self.motors()).find(is_at_fault).unwrap_or(ALL_MOTORS);
        LeaseReport { lease, lapse, was_moving, at_fault }
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
        let is_bad = self.motors.get(index).is_some_and(|motor| motor.has_bad_item);
        let all = [
            (is_bad, flags::BAD_ITEM),
            (faults.step_missed, flags::STEP_MISSED),
            (faults.setup_cut_short, flags::SETUP_CUT_SHORT),
        ];
        all.into_iter().filter(|(is_set, _)| *is_set).fold(0, |all, (_, flag)| all | flag)
    }

    fn timings(&self) -> impl Iterator<Item = (MotorTiming, i32)> {
        let positions = self.native.positions();
        self.motors.iter().zip(positions).map(|(motor, position)| (motor.timing, position as i32))
    }

    fn foresight(&self) -> u32 {
        AHEAD
    }

    fn begin_orders(&mut self, _: u64) {}

    fn plan_orders(&mut self, orders: &mut Verbs) {
        orders.work_out::<FRACTION_BITS>(self.round_end + u64::from(AHEAD), |motor, item| {
            let entry = pulsetrain_core::Entry { epoch: Board::epoch(&self.native), item };
            self.native.push(motor.into(), entry).expect("a slice has few items");
        });
    }

    fn measure(&mut self, _: &mut Measures) {}

    fn reset_measures(&mut self) {}

    fn set_baud(&mut self, baud: Baud) {
        self.baud = baud;
    }

    fn store(&mut self, settings: &[u8; SETTINGS_LEN]) {
        self.settings = Some(*settings);
    }

    fn stored(&self) -> Option<[u8; SETTINGS_LEN]> {
        self.settings
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
        self.model.native().positions()
    }

    /// The state of the model's lease, read past the line and its faults.
    #[must_use]
    pub fn lease(&self) -> LeaseState {
        Leased::lease(self.model.native())
    }

    /// Whether a host has a session with it.
    #[must_use]
    pub const fn is_taken(&self) -> bool {
        self.service.is_taken()
    }

    /// The rate of the model's end of the line.
    #[must_use]
    pub const fn board_baud(&self) -> Baud {
        self.model.side.hardware.baud
    }

    /// Resets the board, as opening a port does: everything it knew is gone, and the motors stop where they are.
    pub fn reset(&mut self) {
        self.model = Model::new(self.model.side.hardware.memory);
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
        self.model.run(self.model.native().now() + ROUND - 1, &mut self.edges);
        let millis = millis(self.now);
        let ModelPort { model, decoder, service, now, to_board, to_host, noise, .. } = self;
        while let Some((_, baud, byte)) = to_board.pop_front_if(|(at, ..)| *at <= *now) {
            let received = decoder.push(heard(byte, baud, model.side.hardware.baud, noise));
            service.receive(received, decoder.body(), millis, &mut model.side);
        }
        if to_host.back().is_none_or(|(at, ..)| *at <= *now) {
            let mut out = [0; MAX_FRAME + 1];
            let baud = model.side.hardware.baud;
            let len = service.poll(millis, &mut model.side, &mut out);
            let new_baud = model.side.hardware.baud;
            if new_baud != baud {
                decoder.reset();
            }
            let byte_ticks = byte_ticks(new_baud);
            to_host.extend((1..).zip(&out[..len]).map(|(index, byte)| (*now + index * byte_ticks, new_baud, *byte)));
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
