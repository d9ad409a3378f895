//! The Pico's hardware, as core's [`FirmwareBoard`](pulsetrain_core::firmware::FirmwareBoard) asks for it.

use crate::clock::{Clock, TICK_HZ};
use crate::regs;
use crate::reset;
use crate::start::{self, StaticCell};
use crate::steps::MOTORS;
use crate::steps::pins::{self, PinLayout};
use crate::steps::stepper::{FRACTION_BITS, FillTiming, LONGEST_IDLE_MS, LONGEST_PULSE, POOL_BYTES, Stepper};
use crate::store::Store;
use crate::uart::WINDOW;
use pulsetrain_core::firmware::{Halt, Hardware, LeaseReport};
use pulsetrain_core::lease::{Lapse, Lease};
use pulsetrain_core::verbs::motor::MAX_ITEMS;
use pulsetrain_core::verbs::{MotorTiming, Verbs};
use pulsetrain_core::wire::message::{Configuration, Info, Measures, NO_PIN};
use pulsetrain_core::wire::settings::SETTINGS_LEN;
use pulsetrain_core::wire::{Baud, Reason, Refusal};
use pulsetrain_core::{Epoch, Tick32};

/// Steps of orders are worked out so much farther than words are written, ticks: 0.1 ms, so that a fill a little later finds them.
const ORDERS_MARGIN: u64 = TICK_HZ as u64 / 10_000;

static ORDERS: StaticCell<Verbs> = StaticCell::new(Verbs::new());

/// All of the chip but its ports.
pub(crate) struct PicoHardware {
    pub(crate) clock: Clock,
    pub(crate) stepper: Stepper,
    /// The pins of the configuration, bit by GPIO.
    pins: u32,
    /// When words are written while motors follow orders.
    pub(crate) timing: FillTiming,
    /// The new rate of the session's UART, which is set when all bytes at the old rate are sent.
    pub(crate) baud: Option<Baud>,
    pub(crate) store: Store,
}

impl PicoHardware {
    /// Starts the clock and sets up what all motors share. No motor is configured yet. Returns the place of the motors' orders, too.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn begin() -> (PicoHardware, &'static mut Verbs) {
        let clock = Clock::start();
        // SAFETY: the caller's promise.
        let (stepper, orders) = unsafe { (Stepper::begin(), ORDERS.take()) };
        let (timing, store) = (FillTiming::VERBS, Store::EMPTY);
        (PicoHardware { clock, stepper, pins: 0, timing, baud: None, store }, orders)
    }
}

impl Hardware for PicoHardware {
    type Layout = PinLayout;
    type Orders = &'static mut Verbs;

    fn info(&self) -> Info {
        Info {
            board: pulsetrain_core::boards::pico::NUMBER,
            firmware: [0, 2, 0],
            tick_hz: TICK_HZ,
            fraction_bits: FRACTION_BITS as u8,
            max_motors: MOTORS as u8,
            pool: POOL_BYTES as u16,
            window: WINDOW,
            bauds: 0b1_1111,
            ..Info::NOBODY
        }
    }

    #[inline(always)]
    fn now(&mut self) -> u64 {
        self.clock.now()
    }

    fn check(&self, configuration: &Configuration<'_>) -> Result<PinLayout, Refusal> {
        let Configuration { pulse_ticks, setup_ticks, hold_ticks, idle_ms, .. } = *configuration;
        if pulse_ticks.max(setup_ticks).max(hold_ticks) > LONGEST_PULSE {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST_PULSE });
        }
        let has_coils = configuration.motors().any(|motor| motor.coils().is_some());
        if has_coils && idle_ms.is_some_and(|ms| ms > LONGEST_IDLE_MS) {
            return Err(Refusal { reason: Reason::Timing, detail: LONGEST_IDLE_MS });
        }
        PinLayout::of(configuration)
    }

    fn configure(&mut self, layout: &PinLayout, configuration: &Configuration<'_>) {
        pins::release(self.pins & !layout.used);
        self.pins = layout.used;
        if layout.enable != NO_PIN {
            regs::SIO_OE_SET.write(1 << layout.enable);
            // §2.19.6.3: input on, 4 mA, Schmitt trigger. §2.19.2: driven by the processor.
            regs::pad(layout.enable).write(1 << 6 | 1 << 4 | 1 << 1);
            regs::gpio_ctrl(layout.enable).write(5);
        }
        let now = self.clock.now32();
        self.stepper.configure(layout, configuration, now);
    }

    fn set_enable(&mut self, pin: u8, high: bool) {
        let register = if high { regs::SIO_OUT_SET } else { regs::SIO_OUT_CLR };
        register.write(1 << pin);
    }

    fn release_coils(&mut self) {
        self.stepper.release_coils();
    }

    fn motors(&self) -> u8 {
        self.stepper.count()
    }

    fn start(&mut self) {
        self.stepper.start(&mut self.clock);
    }

    fn stop(&mut self) -> Halt {
        self.stepper.stop(&mut self.clock)
    }

    fn is_idle(&mut self, now: u64) -> bool {
        let now = Tick32::of(now);
        self.stepper.pass(now);
        self.stepper.is_idle(now)
    }

    #[inline(always)]
    fn has_underrun(&self) -> bool {
        self.stepper.has_underrun()
    }

    fn free(&self, motor: u8) -> u16 {
        self.stepper.free(motor)
    }

    fn push(&mut self, motor: u8, epoch: Epoch, packed: &[u8]) -> Option<()> {
        self.stepper.push(motor, epoch, packed)
    }

    fn discard(&mut self, epoch: Epoch) {
        self.stepper.discard(epoch);
    }

    fn switch(&mut self, epoch: Epoch, tick: u64, lease: Lease, limits: &[u8]) -> bool {
        self.stepper.switch(epoch, Tick32::of(tick), lease, limits)
    }

    fn can_extend(&self, lease: Lease) -> bool {
        self.stepper.can_extend(lease)
    }

    fn extend(&mut self, lease: Lease, limits: &[u8]) {
        self.stepper.extend(lease, limits);
    }

    fn take_back(&mut self, bytes: &[u8]) -> Result<(), u8> {
        self.stepper.take_back(bytes)
    }

    fn lapse_at(&mut self, lapse: Lapse) {
        self.stepper.lapse_at(lapse);
    }

    fn lease(&self) -> LeaseReport {
        self.stepper.lease()
    }

    fn horizon(&mut self) -> u64 {
        let now = self.clock.now32();
        self.clock.widen(self.stepper.horizon(now))
    }

    fn epoch(&self) -> Epoch {
        self.stepper.epoch()
    }

    fn position(&mut self, motor: u8) -> i32 {
        let now = self.clock.now32();
        self.stepper.position(motor, now)
    }

    fn faults(&self, motor: u8) -> u8 {
        self.stepper.faults(motor)
    }

    fn timings(&self) -> impl Iterator<Item = (MotorTiming, i32)> {
        self.stepper.limits()
    }

    fn foresight(&self) -> u32 {
        self.stepper.foresight(self.timing)
    }

    fn begin_orders(&mut self, known: u64) {
        self.stepper.set_timing(self.timing);
        self.stepper.set_known_until(Tick32::of(known));
    }

    /// As far as words are written.
    #[inline(never)]
    fn plan_orders(&mut self, orders: &mut Verbs) {
        let PicoHardware { stepper, clock, timing, .. } = self;
        let until = clock.now() + u64::from(stepper.foresight(*timing)) + ORDERS_MARGIN;
        if until >= orders.known() + u64::from(timing.verb_slice) && stepper.has_room(MAX_ITEMS) {
            orders.work_out::<FRACTION_BITS>(until, |motor, item| stepper.push_item(motor, item));
            stepper.set_known_until(Tick32::of(until));
        }
    }

    fn measure(&mut self, measures: &mut Measures) {
        measures.stack_left = start::stack_left();
        measures.least_ahead_ticks = u16::try_from(self.stepper.least_ahead()).unwrap_or(u16::MAX);
    }

    fn reset_measures(&mut self) {
        self.stepper.reset_measures();
    }

    fn set_baud(&mut self, baud: Baud) {
        self.baud = Some(baud);
    }

    fn store(&mut self, settings: &[u8; SETTINGS_LEN]) {
        let PicoHardware { store, clock, .. } = self;
        // No motor needs words meanwhile, and no motion is read from the flash: nothing is armed.
        store.write(settings, || {
            reset::kick_watchdog();
            clock.now()
        });
    }

    fn stored(&self) -> Option<[u8; SETTINGS_LEN]> {
        self.store.settings().copied()
    }

    fn store_is_damaged(&self) -> bool {
        self.store.is_damaged()
    }
}
