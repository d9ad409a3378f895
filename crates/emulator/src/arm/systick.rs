//! SysTick, the processor's own timer (ARMv6-M ARM DDI 0419E §B3.3).
//!
//! The counter is computed when it is read, and `next` gives the cycle of its next exception. Between the two it takes
//! no computing time.

const ENABLE: u32 = 1;
const TICK_INTERRUPT: u32 = 1 << 1;
const PROCESSOR_CLOCK: u32 = 1 << 2;
const COUNT_FLAG: u32 = 1 << 16;
/// The 24 bits of the reload value and of the counter.
const MASK: u32 = 0x00ff_ffff;

#[derive(Clone, Debug)]
pub(super) struct SysTick {
    control: u32,
    reload: u32,
    /// The counter in cycle `since`.
    value: u32,
    since: u64,
    /// COUNTFLAG: the counter has reached 0 since SYST_CSR was last read.
    counted: bool,
    /// Processor cycles from one tick of the reference clock to the next. Ticks are at multiples of this.
    reference: u32,
    calibration: u32,
}

impl SysTick {
    pub(super) fn new(reference: u32, calibration: u32) -> SysTick {
        SysTick { control: 0, reload: 0, value: 0, since: 0, counted: false, reference: reference.max(1), calibration }
    }

    pub(super) fn reset(&mut self, cycle: u64) {
        *self = SysTick { since: cycle, ..SysTick::new(self.reference, self.calibration) };
    }

    /// Counts up to `cycle`. Returns whether the counter reached 0 with TICKINT set.
    pub(super) fn advance(&mut self, cycle: u64) -> bool {
        let ticks = self.ticks(cycle);
        self.since = self.since.max(cycle);
        if ticks < self.ticks_to_zero() {
            self.value = self.after(ticks);
            return false;
        }
        self.value = self.after(ticks);
        self.counted = true;
        self.control & TICK_INTERRUPT != 0
    }

    /// The cycle in which the counter next reaches 0, if it raises an exception then.
    pub(super) fn next(&self) -> Option<u64> {
        let ticks = self.ticks_to_zero();
        let asks = self.control & TICK_INTERRUPT != 0 && ticks != u64::MAX;
        asks.then(|| match self.processor_clock() {
            true => self.since + ticks,
            false => (self.since / self.period() + ticks) * self.period(),
        })
    }

    pub(super) fn set_reference(&mut self, cycles: u32) {
        self.reference = cycles.max(1);
    }

    /// Reads SYST_CSR, which clears COUNTFLAG.
    pub(super) fn read_control(&mut self) -> u32 {
        self.control | if std::mem::take(&mut self.counted) { COUNT_FLAG } else { 0 }
    }

    pub(super) fn write_control(&mut self, value: u32) {
        self.control = value & (ENABLE | TICK_INTERRUPT | PROCESSOR_CLOCK);
    }

    pub(super) fn reload(&self) -> u32 {
        self.reload
    }

    pub(super) fn write_reload(&mut self, value: u32) {
        self.reload = value & MASK;
    }

    pub(super) fn value(&self) -> u32 {
        self.value
    }

    /// The counter in a later cycle, if no register is written before.
    pub(super) fn value_in(&self, cycle: u64) -> u32 {
        self.after(self.ticks(cycle))
    }

    /// Writes SYST_CVR: any value clears the counter and COUNTFLAG, and raises no exception.
    pub(super) fn clear(&mut self) {
        self.value = 0;
        self.counted = false;
    }

    pub(super) fn calibration(&self) -> u32 {
        self.calibration
    }

    fn processor_clock(&self) -> bool {
        self.control & PROCESSOR_CLOCK != 0
    }

    fn period(&self) -> u64 {
        if self.processor_clock() { 1 } else { u64::from(self.reference) }
    }

    /// Ticks of the selected clock from `since` to `cycle`.
    fn ticks(&self, cycle: u64) -> u64 {
        if self.control & ENABLE == 0 || cycle <= self.since {
            return 0;
        }
        cycle / self.period() - self.since / self.period()
    }

    /// Ticks until the counter goes from 1 to 0; `u64::MAX` if it stands still.
    fn ticks_to_zero(&self) -> u64 {
        match (self.control & ENABLE, self.value, self.reload) {
            (0, ..) | (_, 0, 0) => u64::MAX,
            (_, 0, reload) => u64::from(reload) + 1,
            (_, value, _) => u64::from(value),
        }
    }

    /// The counter a number of ticks later: it counts to 0, and the next tick loads the reload value.
    fn after(&self, ticks: u64) -> u32 {
        let (value, turn) = (u64::from(self.value), u64::from(self.reload) + 1);
        if ticks <= value {
            return (value - ticks) as u32;
        }
        let beyond = (ticks - value) % turn;
        if beyond == 0 { 0 } else { (turn - beyond) as u32 }
    }
}
