//! PIO once more, cycle by cycle, without any shortcut: what the chip is compared with.

/// GPIO 0 to 29.
pub(crate) const PINS: u32 = 0x3fff_ffff;

/// One machine, cycle by cycle.
#[derive(Clone, Debug)]
pub(crate) struct Slow {
    pub(crate) number: u32,
    pub(crate) enabled: bool,
    pub(crate) pc: u32,
    pub(crate) x: u32,
    pub(crate) y: u32,
    pub(crate) osr: u32,
    pub(crate) isr: u32,
    pub(crate) osr_count: u32,
    pub(crate) isr_count: u32,
    pub(crate) delay: u32,
    pub(crate) latched: Option<u16>,
    pub(crate) raised: bool,
    pub(crate) tx: Vec<u32>,
    pub(crate) rx: Vec<u32>,
    pub(crate) tx_depth: usize,
    pub(crate) rx_depth: usize,
    pub(crate) execctrl: u32,
    pub(crate) shiftctrl: u32,
    pub(crate) pinctrl: u32,
    pub(crate) divider_256: u64,
    /// The next tick, 1/256 cycle.
    pub(crate) tick_256: u64,
}

/// The block.
pub(crate) struct Model {
    pub(crate) machines: Vec<Slow>,
    pub(crate) memory: [u16; 32],
    pub(crate) irq: u32,
    pub(crate) out: u32,
    pub(crate) directions: u32,
    pub(crate) world: u32,
    pub(crate) bypass: u32,
    pub(crate) fdebug: u32,
    /// Levels of the pins in the last three cycles, the present first.
    pub(crate) pads: [u32; 3],
    pub(crate) set_flags: u32,
    pub(crate) clear_flags: u32,
    pub(crate) edges: Vec<(u64, u32)>,
}

fn bits(field: u32) -> u32 {
    if field & 31 == 0 { 32 } else { field & 31 }
}

fn mask(count: u32) -> u32 {
    if count >= 32 { u32::MAX } else { (1 << count) - 1 }
}

impl Model {
    pub(crate) fn pad(&self) -> u32 {
        (self.out & self.directions | self.world & !self.directions) & PINS
    }

    /// Everything that happens in a cycle.
    pub(crate) fn cycle(&mut self, cycle: u64) {
        let pad = self.pad();
        if pad != self.pads[0] {
            self.edges.push((cycle, pad));
        }
        self.pads = [pad, self.pads[0], self.pads[1]];
        let seen = self.pads[2] & !self.bypass | pad & self.bypass;
        for number in 0..4 {
            self.machine(number, cycle, seen);
        }
        self.irq = self.irq & !self.clear_flags | self.set_flags;
        (self.set_flags, self.clear_flags) = (0, 0);
    }

    fn machine(&mut self, number: usize, cycle: u64, seen: u32) {
        let mut m = self.machines[number].clone();
        let tick = m.tick_256 >> 8 == cycle;
        if tick {
            m.tick_256 += m.divider_256;
        }
        if !tick || !m.enabled {
            self.machines[number] = m;
            return;
        }
        let mut is_out = false;
        if m.delay > 0 {
            m.delay -= 1;
        } else {
            let instruction = u32::from(m.latched.unwrap_or(self.memory[m.pc as usize]));
            is_out = instruction >> 13 == 3;
            self.instruction(&mut m, instruction, seen);
        }
        // §3.5.4.2: on cycles without OUT; an OUT does its own.
        if !is_out && m.shiftctrl >> 17 & 1 != 0 && m.osr_count >= bits(m.shiftctrl >> 25) && !m.tx.is_empty() {
            m.osr = m.tx.remove(0);
            m.osr_count = 0;
        }
        self.machines[number] = m;
    }

    fn instruction(&mut self, m: &mut Slow, instruction: u32, seen: u32) {
        let side_bits = (m.pinctrl >> 29).min(5);
        let field = instruction >> 8 & 31;
        let (side, delay) = (field >> (5 - side_bits), field & mask(5 - side_bits));
        let mut next = if m.pc == m.execctrl >> 12 & 31 { m.execctrl >> 7 & 31 } else { (m.pc + 1) % 32 };
        let mut exec = None;
        let mut jumped = false;
        let done = self.operate(m, instruction, seen, &mut next, &mut jumped, &mut exec);
        if side_bits > 0 {
            let optional = m.execctrl >> 30 & 1;
            let pins = side_bits - optional;
            if optional == 0 || side >> pins & 1 != 0 {
                let base = m.pinctrl >> 10 & 31;
                let (into, which) = (mask(pins).rotate_left(base), side.rotate_left(base));
                let target = if m.execctrl >> 29 & 1 != 0 { &mut self.directions } else { &mut self.out };
                *target = *target & !into | which & into;
            }
        }
        if !done {
            return;
        }
        let was_latched = m.latched.is_some();
        m.latched = exec;
        m.delay = if exec.is_some() { 0 } else { delay };
        if jumped || !was_latched {
            m.pc = next;
        }
    }

    fn write_pins(&mut self, base: u32, count: u32, value: u32, directions: bool) {
        let into = mask(count).rotate_left(base);
        let target = if directions { &mut self.directions } else { &mut self.out };
        *target = *target & !into | value.rotate_left(base) & into;
    }

    fn flag(m: &Slow, index: u32) -> u32 {
        1 << if index & 16 != 0 { index & 4 | (index + m.number) & 3 } else { index & 7 }
    }

    /// Whether the instruction is complete.
    fn operate(
        &mut self,
        m: &mut Slow,
        instruction: u32,
        seen: u32,
        next: &mut u32,
        jumped: &mut bool,
        exec: &mut Option<u16>,
    ) -> bool {
        let (kind, low) = (instruction >> 5 & 7, instruction & 31);
        let in_base = m.pinctrl >> 15 & 31;
        let (out_base, out_count) = (m.pinctrl & 31, m.pinctrl >> 20 & 63);
        let (set_base, set_count) = (m.pinctrl >> 5 & 31, m.pinctrl >> 26 & 7);
        let (pull, push) = (bits(m.shiftctrl >> 25), bits(m.shiftctrl >> 20));
        let (autopull, autopush) = (m.shiftctrl >> 17 & 1 != 0, m.shiftctrl >> 16 & 1 != 0);
        match instruction >> 13 {
            0 => {
                let taken = match kind {
                    0 => true,
                    1 => m.x == 0,
                    2 => m.x != 0,
                    3 => m.y == 0,
                    4 => m.y != 0,
                    5 => m.x != m.y,
                    6 => seen >> (m.execctrl >> 24 & 31) & 1 != 0,
                    _ => m.osr_count < pull,
                };
                if kind == 2 {
                    m.x = m.x.wrapping_sub(1);
                }
                if kind == 4 {
                    m.y = m.y.wrapping_sub(1);
                }
                if taken {
                    (*next, *jumped) = (low, true);
                }
            }
            1 => {
                let wanted = instruction >> 7 & 1;
                match kind & 3 {
                    0 => return seen >> low & 1 == wanted,
                    1 => return seen >> ((low + in_base) % 32) & 1 == wanted,
                    2 => {
                        let flag = Model::flag(m, low);
                        if u32::from(self.irq & flag != 0) != wanted {
                            return false;
                        }
                        if wanted == 1 {
                            self.clear_flags |= flag;
                        }
                    }
                    _ => return false,
                }
            }
            2 => {
                let source = match kind {
                    0 => seen.rotate_right(in_base),
                    1 => m.x,
                    2 => m.y,
                    6 => m.isr,
                    7 => m.osr,
                    _ => 0,
                };
                let count = bits(low);
                let total = (m.isr_count + count).min(32);
                if autopush && total >= push && m.rx.len() >= m.rx_depth {
                    self.fdebug |= 1 << m.number;
                    return false;
                }
                let both = if m.shiftctrl >> 18 & 1 != 0 {
                    (u64::from(source & mask(count)) << 32 | u64::from(m.isr)) >> count
                } else {
                    u64::from(m.isr) << count | u64::from(source & mask(count))
                };
                (m.isr, m.isr_count) = (both as u32, total);
                if autopush && total >= push {
                    m.rx.push(m.isr);
                    (m.isr, m.isr_count) = (0, 0);
                }
            }
            3 => {
                if autopull && m.osr_count >= pull {
                    if m.tx.is_empty() {
                        self.fdebug |= 1 << (24 + m.number);
                    } else {
                        (m.osr, m.osr_count) = (m.tx.remove(0), 0);
                    }
                    return false;
                }
                let count = bits(low);
                let value = if m.shiftctrl >> 19 & 1 != 0 {
                    let value = m.osr & mask(count);
                    m.osr = (u64::from(m.osr) >> count) as u32;
                    value
                } else {
                    let both = u64::from(m.osr) << count;
                    m.osr = both as u32;
                    (both >> 32) as u32
                };
                m.osr_count = (m.osr_count + count).min(32);
                match kind {
                    0 => self.write_pins(out_base, out_count, value, false),
                    1 => m.x = value,
                    2 => m.y = value,
                    4 => self.write_pins(out_base, out_count, value, true),
                    5 => (*next, *jumped) = (value & 31, true),
                    6 => (m.isr, m.isr_count) = (value, count),
                    7 => *exec = Some(value as u16),
                    _ => {}
                }
                if autopull && m.osr_count >= pull && !m.tx.is_empty() {
                    (m.osr, m.osr_count) = (m.tx.remove(0), 0);
                }
            }
            4 if instruction & 0x80 == 0 => {
                if instruction & 0x40 != 0 && m.isr_count < push {
                    return true;
                }
                if m.rx.len() >= m.rx_depth {
                    self.fdebug |= 1 << m.number;
                    if instruction & 0x20 != 0 {
                        return false;
                    }
                } else {
                    m.rx.push(m.isr);
                }
                (m.isr, m.isr_count) = (0, 0);
            }
            4 => {
                if instruction & 0x40 != 0 && m.osr_count < pull || autopull && m.osr_count == 0 {
                    return true;
                }
                if !m.tx.is_empty() {
                    m.osr = m.tx.remove(0);
                } else if instruction & 0x20 != 0 {
                    self.fdebug |= 1 << (24 + m.number);
                    return false;
                } else {
                    m.osr = m.x;
                }
                m.osr_count = 0;
            }
            5 => {
                let level = if m.execctrl & 16 == 0 { m.tx.len() } else { m.rx.len() };
                let value = match instruction & 7 {
                    0 => seen.rotate_right(in_base),
                    1 => m.x,
                    2 => m.y,
                    5 if (level as u32) < m.execctrl & 15 => u32::MAX,
                    6 => m.isr,
                    7 => m.osr,
                    _ => 0,
                };
                let value = match instruction >> 3 & 3 {
                    1 => !value,
                    2 => value.reverse_bits(),
                    _ => value,
                };
                match kind {
                    0 => self.write_pins(out_base, out_count, value, false),
                    1 => m.x = value,
                    2 => m.y = value,
                    4 => *exec = Some(value as u16),
                    5 => (*next, *jumped) = (value & 31, true),
                    6 => (m.isr, m.isr_count) = (value, 0),
                    7 => (m.osr, m.osr_count) = (value, 0),
                    _ => {}
                }
            }
            6 => {
                let flag = Model::flag(m, low);
                if instruction & 0x40 != 0 {
                    self.clear_flags |= flag;
                } else if instruction & 0x20 == 0 {
                    self.set_flags |= flag;
                } else if !m.raised {
                    self.set_flags |= flag;
                    m.raised = true;
                    return false;
                } else if self.irq & flag != 0 {
                    return false;
                } else {
                    m.raised = false;
                }
            }
            _ => match kind {
                0 => self.write_pins(set_base, set_count, low, false),
                1 => m.x = low,
                2 => m.y = low,
                4 => self.write_pins(set_base, set_count, low, true),
                _ => {}
            },
        }
        true
    }
}
