//! Clocks (RP2040 datasheet §2.15 to §2.18): the oscillators, the PLLs, and the sources of clk_ref, clk_sys and
//! clk_peri. A cycle of the emulator is a period of clk_sys.
//!
//! Oscillators and PLLs take time to start: the crystal 256 · STARTUP.DELAY of its periods, a PLL [`PLL_LOCK_US`]. On
//! the chip a clock whose source is off stands still. Here its frequency is then 0 Hz and what it clocks stands still;
//! clk_sys alone keeps its frequency, because the emulator counts time in it.

const NEVER: u64 = u64::MAX;

/// Frequency of the Pico's crystal, Hz.
const XOSC_HZ: u64 = 12_000_000;
/// Frequency of the ring oscillator after a reset, Hz: the typical value (§2.17.1).
const ROSC_HZ: u64 = 6_500_000;
/// Time from a PLL's power-up to LOCK, µs. The datasheet has no figure, because programs wait for the bit. (est.)
const PLL_LOCK_US: u64 = 50;

/// The value of XOSC_CTRL.ENABLE that enables the crystal (§2.16.7).
const XOSC_ENABLE: u32 = 0xfab;

// PLL_PWR (§2.18.4).
const PLL_PD: u32 = 1;
const PLL_VCOPD: u32 = 1 << 5;
const PLL_POSTDIVPD: u32 = 1 << 3;

/// A rational number of ticks in each cycle, counted from a cycle on.
#[derive(Clone, Copy)]
pub(super) struct Tick {
    since: u64,
    /// The number of ticks before cycle `since`.
    before: u64,
    /// `ticks` ticks come in `cycles` cycles. With 0 ticks the clock stands still.
    ticks: u64,
    cycles: u64,
}

impl Tick {
    pub(super) const fn stopped() -> Tick {
        Tick { since: 0, before: 0, ticks: 0, cycles: 1 }
    }

    /// Changes the rate from a cycle on.
    fn changed(&self, ticks: u64, cycles: u64, cycle: u64) -> Tick {
        let divisor = gcd(ticks, cycles).max(1);
        Tick { since: cycle, before: self.ticks(cycle), ticks: ticks / divisor, cycles: (cycles / divisor).max(1) }
    }

    /// The number of ticks before the beginning of a cycle or in it.
    pub(super) fn ticks(&self, cycle: u64) -> u64 {
        let passed = cycle.saturating_sub(self.since);
        if self.ticks == 1 {
            return self.before + passed / self.cycles;
        }
        let ticks = u128::from(passed) * u128::from(self.ticks) / u128::from(self.cycles);
        self.before + u64::try_from(ticks).unwrap_or(u64::MAX)
    }

    /// The first cycle by which there have been this many ticks.
    pub(super) fn cycle_of(&self, ticks: u64) -> u64 {
        let Some(wanted) = ticks.checked_sub(self.before) else { return self.since };
        if wanted == 0 {
            return self.since;
        }
        if self.ticks == 0 {
            return NEVER;
        }
        let cycles = (u128::from(wanted) * u128::from(self.cycles)).div_ceil(u128::from(self.ticks));
        u64::try_from(cycles).map_or(NEVER, |cycles| self.since.saturating_add(cycles))
    }
}

const fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[derive(Clone)]
struct Pll {
    cs: u32,
    power: u32,
    fbdiv: u32,
    prim: u32,
    locked_at: u64,
}

impl Pll {
    const fn new() -> Pll {
        Pll { cs: 1, power: 0x2d, fbdiv: 0, prim: 0x0007_7000, locked_at: NEVER }
    }

    fn is_on(&self) -> bool {
        self.power & (PLL_PD | PLL_VCOPD) == 0
    }

    /// The output frequency, Hz: FREF / REFDIV · FBDIV / (POSTDIV1 · POSTDIV2) (§2.18.2).
    fn hz(&self, reference: u64, cycle: u64) -> u64 {
        if self.cs >> 8 & 1 != 0 {
            return reference;
        }
        if !self.is_on() || self.power & PLL_POSTDIVPD != 0 || cycle < self.locked_at {
            return 0;
        }
        let divisor = u64::from(self.cs & 0x3f) * u64::from(self.prim >> 16 & 7) * u64::from(self.prim >> 12 & 7);
        (reference * u64::from(self.fbdiv)).checked_div(divisor).unwrap_or(0)
    }

    fn read(&self, offset: u32, cycle: u64) -> u32 {
        match offset {
            0x0 => self.cs | u32::from(self.is_on() && cycle >= self.locked_at) << 31,
            0x4 => self.power,
            0x8 => self.fbdiv,
            _ => self.prim,
        }
    }
}

/// A clock generator: its source and its divider.
#[derive(Clone, Copy)]
struct Generator {
    ctrl: u32,
    /// The divider: 24 bits of integer, 8 of fraction. An integer of 0 means 2^16.
    div: u32,
}

impl Generator {
    fn divide(&self, hz: u64) -> u64 {
        let div = if self.div >> 8 == 0 { 1 << 24 | self.div } else { self.div };
        (hz << 8) / u64::from(div)
    }
}

// The numbers of the generators in the order of their registers. The first four drive pins.
const REF: usize = 4;
const SYS: usize = 5;
const PERI: usize = 6;

/// The oscillators, the PLLs and the clock generators.
#[derive(Clone)]
pub(super) struct Clocks {
    generators: [Generator; 10],
    pll: [Pll; 2],
    xosc_ctrl: u32,
    xosc_startup: u32,
    xosc_stable_at: u64,
    rosc: [u32; 8],
    /// Registers that only store what is written.
    plain: [u32; 0x32],
    sys_hz: u64,
    tick: Tick,
    tick_rate: (u64, u64),
    /// The cycle in which an oscillator or a PLL becomes ready.
    pub(super) next: u64,
}

impl Clocks {
    pub(super) fn new() -> Clocks {
        Clocks {
            generators: [Generator { ctrl: 0, div: 0x100 }; 10],
            pll: [const { Pll::new() }; 2],
            xosc_ctrl: 0,
            xosc_startup: 0xc4,
            xosc_stable_at: NEVER,
            rosc: [0xaa0, 0, 0, 0, 0, 0, 0, 0],
            plain: [0; 0x32],
            sys_hz: ROSC_HZ,
            tick: Tick::stopped(),
            tick_rate: (0, 1),
            next: NEVER,
        }
    }

    /// Frequency of clk_sys, Hz.
    pub(super) fn sys_hz(&self) -> u64 {
        self.sys_hz
    }

    fn xosc_hz(&self, cycle: u64) -> u64 {
        if self.xosc_ctrl >> 12 & 0xfff == XOSC_ENABLE && cycle >= self.xosc_stable_at { XOSC_HZ } else { 0 }
    }

    fn pll_hz(&self, which: usize, cycle: u64) -> u64 {
        self.pll[which].hz(self.xosc_hz(cycle), cycle)
    }

    /// Frequency of clk_ref, Hz (§2.15.7, CLK_REF_CTRL).
    fn ref_hz(&self, cycle: u64) -> u64 {
        let generator = self.generators[REF];
        let hz = match generator.ctrl & 3 {
            0 => ROSC_HZ,
            2 => self.xosc_hz(cycle),
            _ if generator.ctrl >> 5 & 3 == 0 => self.pll_hz(1, cycle),
            _ => 0,
        };
        generator.divide(hz)
    }

    fn wanted_sys_hz(&self, cycle: u64) -> u64 {
        let generator = self.generators[SYS];
        let hz = if generator.ctrl & 1 == 0 {
            self.ref_hz(cycle)
        } else {
            match generator.ctrl >> 5 & 7 {
                0 => self.pll_hz(0, cycle),
                1 => self.pll_hz(1, cycle),
                2 => ROSC_HZ,
                3 => self.xosc_hz(cycle),
                _ => 0,
            }
        };
        generator.divide(hz)
    }

    /// Frequency of clk_peri, Hz, which clocks the UARTs; 0 while it is off.
    pub(super) fn peri_hz(&self, cycle: u64) -> u64 {
        let generator = self.generators[PERI];
        if generator.ctrl >> 11 & 1 == 0 {
            return 0;
        }
        match generator.ctrl >> 5 & 7 {
            0 => self.sys_hz,
            1 => self.pll_hz(0, cycle),
            2 => self.pll_hz(1, cycle),
            3 => ROSC_HZ,
            4 => self.xosc_hz(cycle),
            _ => 0,
        }
    }

    /// Computes the frequencies from a cycle on. Returns that of clk_sys if it has changed.
    pub(super) fn refresh(&mut self, cycle: u64) -> Option<u64> {
        self.next = self
            .pll
            .iter()
            .map(|pll| pll.locked_at)
            .chain([self.xosc_stable_at])
            .filter(|at| *at > cycle)
            .fold(NEVER, u64::min);
        let wanted = self.wanted_sys_hz(cycle);
        if wanted == 0 || wanted == self.sys_hz {
            return None;
        }
        // Start-up times are in µs: a change of clk_sys changes how many cycles they take.
        for at in [&mut self.xosc_stable_at].into_iter().chain(self.pll.iter_mut().map(|pll| &mut pll.locked_at)) {
            if *at != NEVER && *at > cycle {
                *at = cycle + (*at - cycle) * wanted / self.sys_hz;
            }
        }
        self.sys_hz = wanted;
        Some(wanted)
    }

    /// The tick generator with `per_tick` cycles of clk_ref in a tick. Returns it if it is another one from `cycle` on.
    pub(super) fn tick(&mut self, per_tick: Option<u32>, cycle: u64) -> Option<Tick> {
        let rate = per_tick.map_or((0, 1), |per_tick| (self.ref_hz(cycle), self.sys_hz * u64::from(per_tick)));
        if rate == self.tick_rate {
            return None;
        }
        self.tick_rate = rate;
        self.tick = self.tick.changed(rate.0, rate.1, cycle);
        Some(self.tick)
    }

    // CLOCKS (§2.15.7).

    pub(super) fn read(&self, offset: u32) -> u32 {
        match offset {
            0x00..=0x74 => {
                let generator = self.generators[(offset / 12) as usize];
                match offset % 12 {
                    0 => generator.ctrl,
                    4 => generator.div,
                    // SELECTED has one bit for each source in the two glitchless multiplexers; elsewhere it is 1.
                    _ => match (offset / 12) as usize {
                        REF => 1 << (generator.ctrl & 3),
                        SYS => 1 << (generator.ctrl & 1),
                        _ => 1,
                    },
                }
            }
            0x78..=0xc4 => self.plain[((offset - 0x78) / 4) as usize],
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, offset: u32, merge: impl Fn(u32) -> u32) {
        match offset {
            0x00..=0x74 => {
                let number = (offset / 12) as usize;
                let generator = &mut self.generators[number];
                match offset % 12 {
                    0 => generator.ctrl = merge(generator.ctrl),
                    // clk_peri has no divider.
                    4 if number != PERI => generator.div = merge(generator.div),
                    _ => {}
                }
            }
            0x78..=0xc4 => {
                let register = &mut self.plain[((offset - 0x78) / 4) as usize];
                *register = merge(*register);
            }
            _ => {}
        }
    }

    // XOSC (§2.16.7).

    pub(super) fn read_xosc(&self, offset: u32, cycle: u64) -> u32 {
        let enabled = self.xosc_ctrl >> 12 & 0xfff == XOSC_ENABLE;
        match offset {
            0x00 => self.xosc_ctrl,
            0x04 => u32::from(enabled && cycle >= self.xosc_stable_at) << 31 | u32::from(enabled) << 12,
            0x0c => self.xosc_startup,
            _ => 0,
        }
    }

    pub(super) fn write_xosc(&mut self, offset: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        match offset {
            0x00 => {
                let was = self.xosc_ctrl >> 12 & 0xfff == XOSC_ENABLE;
                self.xosc_ctrl = merge(self.xosc_ctrl) & 0x00ff_ffff;
                if self.xosc_ctrl >> 12 & 0xfff != XOSC_ENABLE {
                    self.xosc_stable_at = NEVER;
                } else if !was {
                    let periods = 256 * u64::from(self.xosc_startup & 0x3fff);
                    self.xosc_stable_at = cycle + 1 + (periods * self.sys_hz).div_ceil(XOSC_HZ);
                }
            }
            0x0c => self.xosc_startup = merge(self.xosc_startup) & 0x0010_3fff,
            _ => {}
        }
    }

    // ROSC (§2.17.8). It always runs, at its nominal frequency.

    pub(super) fn read_rosc(&self, offset: u32, cycle: u64) -> u32 {
        match offset {
            0x18 => 1 << 31 | 1 << 12,
            // RANDOMBIT comes from the cycle count, not from noise, so that every run is alike.
            0x1c => (cycle.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 63) as u32,
            _ => self.rosc.get(offset as usize / 4).copied().unwrap_or(0),
        }
    }

    pub(super) fn write_rosc(&mut self, offset: u32, merge: impl Fn(u32) -> u32) {
        if let Some(register) = self.rosc.get_mut(offset as usize / 4) {
            *register = merge(*register);
        }
    }

    // PLL_SYS and PLL_USB (§2.18.4).

    pub(super) fn read_pll(&self, which: usize, offset: u32, cycle: u64) -> u32 {
        self.pll[which].read(offset, cycle)
    }

    pub(super) fn write_pll(&mut self, which: usize, offset: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        let sys_hz = self.sys_hz;
        let pll = &mut self.pll[which];
        let was_on = pll.is_on();
        match offset {
            0x0 => pll.cs = merge(pll.cs) & 0x13f,
            0x4 => pll.power = merge(pll.power) & 0x2d,
            0x8 => pll.fbdiv = merge(pll.fbdiv) & 0xfff,
            0xc => pll.prim = merge(pll.prim) & 0x0007_7000,
            _ => {}
        }
        if !pll.is_on() {
            pll.locked_at = NEVER;
        } else if !was_on {
            pll.locked_at = cycle + 1 + (PLL_LOCK_US * sys_hz).div_ceil(1_000_000);
        }
    }

    /// Resets a PLL.
    pub(super) fn reset_pll(&mut self, which: usize) {
        self.pll[which] = Pll::new();
    }
}
