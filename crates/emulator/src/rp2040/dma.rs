//! The DMA controller (RP2040 datasheet §2.5): twelve channels, at most one transfer begun in each cycle. It accesses
//! memory through `fabric`.
//!
//! A transfer that is issued in cycle t has its read address phase in t, its read data phase in t + 1, its write
//! address phase in t + 2 and its write data phase in t + 3. Four transfers overlap, so that one word passes in each
//! cycle. The effect of a write is there from t + 4 on. The DMA learns of a word that a peripheral has, or of room for
//! one, two cycles later. Together this makes the 11 cycles that were measured on a chip for a state machine's push,
//! two chained transfers and a stalled `out` (github.com/raspberrypi/pico-feedback, issue 202).

use super::fabric::{Fabric, lane, replicate};
use crate::Observer;
use crate::arm::{BusFault, Size};

const NEVER: u64 = u64::MAX;
const CHANNELS: usize = 12;

// CHx_CTRL (§2.5.7).
const EN: u32 = 1;
const HIGH_PRIORITY: u32 = 1 << 1;
const INCR_READ: u32 = 1 << 4;
const INCR_WRITE: u32 = 1 << 5;
const RING_SEL: u32 = 1 << 10;
const IRQ_QUIET: u32 = 1 << 21;
const BSWAP: u32 = 1 << 22;
const SNIFF_EN: u32 = 1 << 23;
const BUSY: u32 = 1 << 24;
const WRITE_ERROR: u32 = 1 << 29;
const READ_ERROR: u32 = 1 << 30;
const AHB_ERROR: u32 = 1 << 31;

/// TREQ_SEL values: the first pacing timer, and no pacing.
const TREQ_TIMER0: u32 = 0x3b;
const TREQ_PERMANENT: u32 = 0x3f;

#[derive(Clone, Copy, Default)]
struct Channel {
    read: u32,
    write: u32,
    /// Transfers that are not complete, those under way included.
    count: u32,
    reload: u32,
    ctrl: u32,
    busy: bool,
    /// Transfers that have not been issued.
    to_issue: u32,
    /// Transfers that have been issued and have not read, or not written.
    reading: u8,
    writing: u8,
    aborting: bool,
    /// Pulses of the pacing timer when the channel started, and transfers issued since.
    pulses: u64,
    issued: u64,
    /// The cycle from which the channel may have a transfer to issue.
    check_at: u64,
}

impl Channel {
    fn size(&self) -> Size {
        match self.ctrl >> 2 & 3 {
            0 => Size::Byte,
            1 => Size::Half,
            _ => Size::Word,
        }
    }

    fn request(&self) -> u32 {
        self.ctrl >> 15 & 0x3f
    }

    fn wants(&self) -> bool {
        self.busy && self.ctrl & EN != 0 && self.to_issue > 0
    }

    /// The address of the transfer after this one, within its ring (§2.5.1.1).
    fn next_address(&self, address: u32, increments: bool, ring: bool) -> u32 {
        if !increments {
            return address;
        }
        let next = address.wrapping_add(self.size().bytes());
        match self.ctrl >> 6 & 15 {
            bits if ring && bits != 0 => {
                let mask = (1 << bits) - 1;
                address & !mask | next & mask
            }
            _ => next,
        }
    }
}

/// A transfer under way.
#[derive(Clone, Copy)]
struct DmaTransfer {
    channel: usize,
    size: Size,
    from: u32,
    to: u32,
    read_at: u64,
    write_at: u64,
    /// The word, after it has been read.
    data: Option<Result<u32, BusFault>>,
    last: bool,
}

/// A pacing timer (§2.5.5.1): X pulses in Y cycles.
#[derive(Clone, Copy, Default)]
struct Pacer {
    value: u32,
    since: u64,
}

impl Pacer {
    fn rate(&self) -> Option<(u64, u64)> {
        let (x, y) = (u64::from(self.value >> 16), u64::from(self.value & 0xffff));
        // There is at most one pulse in a cycle.
        (x != 0 && y != 0).then_some((x.min(y), y))
    }

    fn pulses(&self, cycle: u64) -> u64 {
        self.rate().map_or(0, |(x, y)| cycle.saturating_sub(self.since) * x / y)
    }

    /// The first cycle with more pulses than this number.
    fn after(&self, pulses: u64) -> u64 {
        self.rate().map_or(NEVER, |(x, y)| self.since + ((pulses + 1) * y).div_ceil(x))
    }
}

#[derive(Clone)]
pub(super) struct Dma {
    channels: [Channel; CHANNELS],
    /// Transfers under way, in the order of their issue.
    under_way: [Option<DmaTransfer>; 4],
    pacers: [Pacer; 4],
    intr: u32,
    inte: [u32; 2],
    intf: [u32; 2],
    sniff_ctrl: u32,
    sniff_data: u32,
    /// Channels that have transfers to issue, for each DREQ that they wait for.
    wanting: [u16; 64],
    /// Of these, the channels that may have one to issue now or in a known cycle.
    looking: u32,
    /// Of these, the channels that can issue one now.
    ready: u32,
    /// The last low-priority channel that issued, and the high-priority channels that have not had their turn in this
    /// round.
    last_low: usize,
    high_left: u32,
    /// Channels of high priority.
    high: u32,
    last_read_at: u64,
    last_write_at: u64,
    /// Whether an interrupt line may have changed.
    pub(super) lines_changed: bool,
    /// The cycle of the next event.
    pub(super) next: u64,
}

impl Dma {
    pub(super) fn new() -> Dma {
        let mut channels = [Channel { check_at: NEVER, ..Channel::default() }; CHANNELS];
        for (number, channel) in channels.iter_mut().enumerate() {
            // A channel that is chained to itself is not chained.
            channel.ctrl = (number as u32) << 11;
        }
        Dma {
            channels,
            under_way: [None; 4],
            pacers: [Pacer::default(); 4],
            intr: 0,
            inte: [0; 2],
            intf: [0; 2],
            sniff_ctrl: 0,
            sniff_data: 0,
            wanting: [0; 64],
            looking: 0,
            ready: 0,
            last_low: CHANNELS - 1,
            high_left: 0,
            high: 0,
            last_read_at: 0,
            last_write_at: 0,
            lines_changed: false,
            next: NEVER,
        }
    }

    /// The levels of both interrupt lines, bits 0 and 1.
    pub(super) fn lines(&self) -> u32 {
        u32::from(self.ints(0) != 0) | u32::from(self.ints(1) != 0) << 1
    }

    fn ints(&self, line: usize) -> u32 {
        self.intr & self.inte[line] | self.intf[line]
    }

    /// Peripherals have had words, or room for words, since `cycle`. `requests` has one bit for each DREQ number.
    pub(super) fn requested(&mut self, mut requests: u64, cycle: u64) {
        while requests != 0 {
            let mut channels = u32::from(self.wanting[requests.trailing_zeros() as usize]);
            requests &= requests - 1;
            self.looking |= channels;
            self.ready &= !channels;
            while channels != 0 {
                let channel = &mut self.channels[channels.trailing_zeros() as usize];
                channels &= channels - 1;
                channel.check_at = channel.check_at.min(cycle + 2);
                self.next = self.next.min(cycle + 2);
            }
        }
    }

    /// Handles the events that are due in a cycle.
    pub(super) fn run(&mut self, cycle: u64, fabric: &mut Fabric, observer: &mut impl Observer) {
        for slot in 0..4 {
            if self.under_way[slot].is_some_and(|transfer| transfer.read_at == cycle && transfer.data.is_none()) {
                self.read_data(slot, cycle, fabric);
            }
        }
        for slot in 0..4 {
            if let Some(transfer) = self.under_way[slot]
                && transfer.write_at == cycle
            {
                self.under_way[slot] = None;
                self.write_data(transfer, cycle, fabric, observer);
            }
        }
        self.issue(cycle, fabric);
        self.schedule(cycle);
    }

    fn read_data(&mut self, slot: usize, cycle: u64, fabric: &mut Fabric) {
        let Some(DmaTransfer { channel: number, from, size, .. }) = self.under_way[slot] else { return };
        let data = match own_register(from) {
            Some(offset) => Ok(lane(self.read(offset), from, size)),
            None => fabric.read(from, size, cycle),
        };
        self.lines_changed |= may_interrupt(from);
        let channel = &mut self.channels[number];
        channel.reading -= 1;
        let swaps = channel.ctrl & BSWAP != 0;
        let data = data.map(|word| if swaps { swapped(word, size) } else { word });
        if let Some(transfer) = &mut self.under_way[slot] {
            transfer.data = Some(data);
        }
        if let Ok(word) = data {
            self.sniff(number, word, size);
        }
    }

    fn write_data(&mut self, transfer: DmaTransfer, cycle: u64, fabric: &mut Fabric, observer: &mut impl Observer) {
        let number = transfer.channel;
        self.channels[number].writing -= 1;
        // The chain and the interrupt come with the address phase of the last write, before its data phase.
        self.channels[number].count = self.channels[number].count.saturating_sub(1);
        if transfer.last && !self.channels[number].aborting {
            self.finish(number, cycle);
        }
        match transfer.data.unwrap_or(Ok(0)) {
            Err(_) => self.fail(number, READ_ERROR),
            Ok(word) => {
                let written = match own_register(transfer.to) {
                    Some(offset) => {
                        self.write(offset, replicate(word, transfer.size), |_| word, cycle);
                        Ok(())
                    }
                    None => fabric.write(transfer.to, transfer.size, word, cycle, observer),
                };
                self.lines_changed |= may_interrupt(transfer.to);
                if written.is_err() {
                    self.fail(number, WRITE_ERROR);
                }
            }
        }
        let channel = &mut self.channels[number];
        if channel.aborting && channel.writing == 0 {
            (channel.aborting, channel.busy) = (false, false);
            // Erratum RP2040-E13: an abort of a channel that makes progress raises its interrupt.
            self.interrupt(number);
        }
    }

    /// A bus error halts the channel and raises its interrupt (§2.5.7, AHB_ERROR).
    fn fail(&mut self, number: usize, error: u32) {
        let channel = &mut self.channels[number];
        channel.ctrl |= error;
        (channel.busy, channel.to_issue, channel.check_at) = (false, 0, NEVER);
        self.interrupt(number);
        self.note(number);
    }

    fn interrupt(&mut self, number: usize) {
        self.intr |= 1 << number;
        self.lines_changed = true;
    }

    fn finish(&mut self, number: usize, cycle: u64) {
        let channel = &mut self.channels[number];
        (channel.busy, channel.check_at) = (false, NEVER);
        let (quiet, chain) = (channel.ctrl & IRQ_QUIET != 0, (channel.ctrl >> 11 & 15) as usize);
        if !quiet {
            self.interrupt(number);
        }
        self.note(number);
        if chain != number && chain < CHANNELS {
            self.trigger(chain, cycle);
        }
    }

    /// Sorts a channel into the sets above after a change of its registers.
    fn note(&mut self, number: usize) {
        let bit = 1 << number;
        for channels in &mut self.wanting {
            *channels &= !bit;
        }
        let channel = &self.channels[number];
        let high = channel.ctrl & HIGH_PRIORITY != 0;
        self.high = if high { self.high | u32::from(bit) } else { self.high & !u32::from(bit) };
        self.looking &= !u32::from(bit);
        self.ready &= !u32::from(bit);
        if channel.wants() {
            self.wanting[channel.request() as usize] |= bit;
            if channel.check_at != NEVER {
                self.looking |= u32::from(bit);
            }
        }
    }

    /// Starts a channel. Its first transfer can be issued in `cycle`.
    fn trigger(&mut self, number: usize, cycle: u64) {
        let pulses = self.pacer(self.channels[number].request()).map_or(0, |pacer| pacer.pulses(cycle));
        let channel = &mut self.channels[number];
        if channel.busy || channel.ctrl & EN == 0 {
            return;
        }
        (channel.busy, channel.count, channel.to_issue) = (true, channel.reload, channel.reload);
        (channel.pulses, channel.issued, channel.check_at) = (pulses, 0, cycle);
        if channel.reload == 0 {
            self.finish(number, cycle);
            return;
        }
        self.note(number);
        self.next = self.next.min(cycle);
    }

    fn pacer(&self, request: u32) -> Option<&Pacer> {
        self.pacers.get(request.checked_sub(TREQ_TIMER0)? as usize)
    }

    /// Whether a channel can issue a transfer in `cycle`. If not, `check_at` becomes the cycle of the next check.
    fn may_issue(&mut self, number: usize, cycle: u64, fabric: &Fabric) -> bool {
        let channel = &self.channels[number];
        if channel.check_at > cycle {
            return false;
        }
        let request = channel.request();
        let check_at = if request == TREQ_PERMANENT {
            return true;
        } else if let Some(pacer) = self.pacer(request) {
            let used = channel.pulses + channel.issued;
            if pacer.pulses(cycle) > used {
                return true;
            }
            pacer.after(used)
        } else {
            let credit = fabric.credit(request, cycle);
            let under_way = if credit.reads { channel.reading } else { channel.writing };
            if credit.now > under_way {
                return true;
            }
            // A word that came within the last two cycles will be known soon.
            if credit.soon > under_way { cycle + 1 } else { NEVER }
        };
        self.channels[number].check_at = check_at;
        if check_at == NEVER {
            self.looking &= !(1 << number);
        }
        false
    }

    /// Picks the channel that issues: each high-priority channel once, then one low-priority channel, in turn (§2.5.7,
    /// HIGH_PRIORITY).
    fn issue(&mut self, cycle: u64, fabric: &mut Fabric) {
        let Some(slot) = self.under_way.iter().position(Option::is_none) else { return };
        let mut unknown = self.looking & !self.ready;
        while unknown != 0 {
            let number = unknown.trailing_zeros() as usize;
            unknown &= unknown - 1;
            if self.may_issue(number, cycle, fabric) {
                self.ready |= 1 << number;
            }
        }
        let ready = self.ready;
        if ready == 0 {
            return;
        }
        let high = ready & self.high;
        if ready & !high == 0 && high & self.high_left == 0 {
            // No low-priority channel is ready: the next round of the high-priority ones begins.
            self.high_left = high;
        }
        let turn = high & self.high_left;
        let number = if turn != 0 {
            let number = turn.trailing_zeros() as usize;
            self.high_left &= !(1 << number);
            number
        } else {
            let low = ready & !high;
            let after = low & !((2 << self.last_low) - 1);
            let number = if after != 0 { after } else { low }.trailing_zeros() as usize;
            (self.last_low, self.high_left) = (number, u32::MAX);
            number
        };
        self.ready &= !(1 << number);
        self.begin(slot, number, cycle, fabric);
    }

    fn begin(&mut self, slot: usize, number: usize, cycle: u64, fabric: &mut Fabric) {
        let channel = &mut self.channels[number];
        let (from, to, size) = (channel.read, channel.write, channel.size());
        let ring_writes = channel.ctrl & RING_SEL != 0;
        channel.read = channel.next_address(from, channel.ctrl & INCR_READ != 0, !ring_writes);
        channel.write = channel.next_address(to, channel.ctrl & INCR_WRITE != 0, ring_writes);
        channel.to_issue -= 1;
        channel.issued += 1;
        channel.reading += 1;
        channel.writing += 1;
        let last = channel.to_issue == 0;
        if last {
            self.note(number);
        }
        let read_at = (cycle + 1).max(self.last_read_at + 1) + u64::from(fabric.read_waits(from));
        let write_at = (read_at + 2).max(self.last_write_at + 1) + u64::from(fabric.write_waits(to));
        (self.last_read_at, self.last_write_at) = (read_at, write_at);
        self.under_way[slot] =
            Some(DmaTransfer { channel: number, size, from, to, read_at, write_at, data: None, last });
    }

    fn schedule(&mut self, cycle: u64) {
        let mut next = NEVER;
        for transfer in self.under_way.iter().flatten() {
            next = next.min(if transfer.data.is_none() { transfer.read_at } else { transfer.write_at });
        }
        let mut looking = self.looking;
        while looking != 0 {
            let channel = &self.channels[looking.trailing_zeros() as usize];
            looking &= looking - 1;
            next = next.min(channel.check_at.max(cycle + 1));
        }
        self.next = next;
    }

    /// The sniffer (§2.5.5.2): a checksum over the data of one channel.
    fn sniff(&mut self, number: usize, word: u32, size: Size) {
        let wanted = self.sniff_ctrl & 1 != 0 && (self.sniff_ctrl >> 1 & 15) as usize == number;
        if !wanted || self.channels[number].ctrl & SNIFF_EN == 0 {
            return;
        }
        let word = if self.sniff_ctrl & 1 << 9 != 0 { swapped(word, size) } else { word };
        match self.sniff_ctrl >> 5 & 15 {
            mode @ 0..=3 => {
                let (polynomial, top) = if mode < 2 { (0x04c1_1db7, 31) } else { (0x1021, 15) };
                for byte in &word.to_le_bytes()[..size.bytes() as usize] {
                    let byte = if mode & 1 != 0 { byte.reverse_bits() } else { *byte };
                    for bit in (0..8).rev() {
                        let carry = (self.sniff_data >> top ^ u32::from(byte >> bit)) & 1;
                        self.sniff_data = (self.sniff_data << 1) ^ (carry * polynomial);
                    }
                }
            }
            0xe => self.sniff_data ^= word.count_ones() & 1,
            0xf => self.sniff_data = self.sniff_data.wrapping_add(word),
            _ => {}
        }
    }

    fn sniff_result(&self) -> u32 {
        let value = if self.sniff_ctrl & 1 << 10 != 0 { self.sniff_data.reverse_bits() } else { self.sniff_data };
        if self.sniff_ctrl & 1 << 11 != 0 { !value } else { value }
    }

    // Registers (§2.5.7).

    pub(super) fn read(&self, offset: u32) -> u32 {
        match offset {
            0x000..=0x2fc => {
                let channel = &self.channels[(offset / 0x40) as usize];
                match field(offset) {
                    // READ_ADDR returns the address without the transfers under way, whatever INCR and RING are
                    // (pico-feedback issue 208).
                    Field::Read => channel.read.wrapping_sub(u32::from(channel.reading) * channel.size().bytes()),
                    Field::Write => channel.write.wrapping_sub(u32::from(channel.writing) * channel.size().bytes()),
                    Field::Count => channel.count,
                    Field::Ctrl => {
                        let error = if channel.ctrl & (READ_ERROR | WRITE_ERROR) != 0 { AHB_ERROR } else { 0 };
                        channel.ctrl | error | if channel.busy { BUSY } else { 0 }
                    }
                }
            }
            0x400 => self.intr,
            0x404 | 0x414 => self.inte[usize::from(offset == 0x414)],
            0x408 | 0x418 => self.intf[usize::from(offset == 0x418)],
            0x40c | 0x41c => self.ints(usize::from(offset == 0x41c)),
            0x420..=0x42c => self.pacers[(offset as usize - 0x420) / 4].value,
            0x434 => self.sniff_ctrl,
            0x438 => self.sniff_result(),
            0x444 => (0..CHANNELS).fold(0, |bits, number| bits | u32::from(self.channels[number].aborting) << number),
            0x448 => CHANNELS as u32,
            0x800..=0xac4 if offset & 0x3f == 4 => self.channels[(offset as usize - 0x800) / 0x40].reload,
            _ => 0,
        }
    }

    /// Writes a register in the data phase's cycle. `merge` makes the new value from the old one.
    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        match offset {
            0x000..=0x2fc => self.write_channel((offset / 0x40) as usize, offset, value, merge, cycle),
            0x400 | 0x40c | 0x41c => self.intr &= !value,
            0x404 | 0x414 => {
                let enables = &mut self.inte[usize::from(offset == 0x414)];
                *enables = merge(*enables) & 0xfff;
            }
            0x408 | 0x418 => {
                let forces = &mut self.intf[usize::from(offset == 0x418)];
                *forces = merge(*forces) & 0xfff;
            }
            0x420..=0x42c => {
                let pacer = &mut self.pacers[(offset as usize - 0x420) / 4];
                *pacer = Pacer { value: merge(pacer.value), since: cycle + 1 };
            }
            0x430 => {
                for number in (0..CHANNELS).filter(|number| value >> number & 1 != 0) {
                    self.trigger(number, cycle + 1);
                }
            }
            0x434 => self.sniff_ctrl = merge(self.sniff_ctrl) & 0xfff,
            0x438 => self.sniff_data = merge(self.sniff_data),
            0x444 => {
                for number in (0..CHANNELS).filter(|number| value >> number & 1 != 0) {
                    self.abort(number);
                }
            }
            _ => {}
        }
    }

    fn write_channel(&mut self, number: usize, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        let channel = &mut self.channels[number];
        match field(offset) {
            Field::Read => channel.read = merge(channel.read),
            Field::Write => channel.write = merge(channel.write),
            Field::Count => channel.reload = merge(channel.reload),
            Field::Ctrl => {
                let errors = (READ_ERROR | WRITE_ERROR) & channel.ctrl & !value;
                channel.ctrl = merge(channel.ctrl) & 0x00ff_ffff | errors;
                channel.check_at = cycle + 1;
                self.note(number);
                self.next = self.next.min(cycle + 1);
            }
        }
        // The last register of each alias triggers the channel (§2.5.2.1), unless a zero is written to it (§2.5.2.3).
        if offset & 0xf == 0xc {
            if value != 0 {
                self.trigger(number, cycle + 1);
            } else if self.channels[number].ctrl & IRQ_QUIET != 0 {
                self.interrupt(number);
            }
        }
    }

    fn abort(&mut self, number: usize) {
        let channel = &mut self.channels[number];
        if !channel.busy {
            return;
        }
        (channel.to_issue, channel.check_at) = (0, NEVER);
        channel.aborting = channel.writing > 0;
        channel.busy = channel.aborting;
        self.note(number);
    }
}

enum Field {
    Read,
    Write,
    Count,
    Ctrl,
}

/// Which of a channel's registers an offset is. They have four orders (§2.5.2.1).
fn field(offset: u32) -> Field {
    match offset & 0x3c {
        0x00 | 0x14 | 0x28 | 0x3c => Field::Read,
        0x04 | 0x18 | 0x2c | 0x34 => Field::Write,
        0x08 | 0x1c | 0x24 | 0x38 => Field::Count,
        _ => Field::Ctrl,
    }
}

/// The offset of one of the DMA's own registers. The DMA does not use its own atomic aliases.
fn own_register(address: u32) -> Option<u32> {
    (address & !0xfff == 0x5000_0000).then_some(address & 0xffc)
}

/// Whether an access there can change an interrupt line. Memory cannot, and PIO blocks are checked elsewhere.
fn may_interrupt(address: u32) -> bool {
    !matches!(address >> 20, 0x100..=0x210 | 0x502 | 0x503)
}

fn swapped(word: u32, size: Size) -> u32 {
    match size {
        Size::Byte => word,
        Size::Half => u32::from((word as u16).swap_bytes()),
        Size::Word => word.swap_bytes(),
    }
}
