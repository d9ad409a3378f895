//! The serial line: UART0 on GPIO 0 and 1, 8 bits, no parity, one stop bit.
//!
//! Bytes from the host go into a ring by DMA, without an interrupt; bytes to the host into the UART's FIFO.

use crate::clock::TICK_HZ;
use crate::regs::{self, DmaChannel};
use crate::start::StaticCell;
use pulsetrain_core::wire::Baud;

/// Bytes of the ring: 5 ms at 2 Mbaud.
const RING_BYTES: usize = 1024;

/// Bytes that the host may send ahead of an answer: so many are unread at most, and 64 places stay free.
pub(crate) const WINDOW: u16 = RING_BYTES as u16 - 64;

/// The DMA channel: none of the motors'.
const CHANNEL: DmaChannel = DmaChannel(11);

/// §2.5.7, CTRL: bytes, into a ring of 2^10, at the UART's request (§2.5.3.1: 21), chained to itself, which means to no channel.
const CTRL: u32 = 1 | 1 << 5 | 10 << 6 | 1 << 10 | (CHANNEL.0 as u32) << 11 | 21 << 15;
const _: () = assert!(RING_BYTES == 1 << 10);

#[repr(C, align(1024))]
struct ReceiveRing([u8; RING_BYTES]);

static RING_MEMORY: StaticCell<ReceiveRing> = StaticCell::new(ReceiveRing([0; RING_BYTES]));

/// The serial line; main's.
pub(crate) struct Uart {
    /// Where the ring begins; the DMA writes there, so that there is no reference to it.
    ring: *const u8,
    /// Place of the next byte to be read.
    next: usize,
    /// Bytes read from the ring since the DMA was started for 2^32 − 1 of them, wrapping.
    taken: u32,
    /// Bytes that were overwritten in the ring, and not reported yet.
    lost: u32,
    /// Bytes are missing between those that were read last and the next.
    gap: bool,
    baud: Baud,
}

impl Uart {
    /// Opens the line at 115 200 baud. The DMA must be out of reset.
    ///
    /// # Safety
    /// Only once.
    pub(crate) unsafe fn open() -> Uart {
        // SAFETY: the caller's promise; from here on the memory is the DMA's.
        let ring = unsafe { RING_MEMORY.take() }.0.as_ptr();
        regs::take_out_of_reset(regs::reset::UART0);
        set_baud(Baud::B115200);
        for pin in 0..2 {
            // §2.19.6.3: input on, 4 mA, pull-up, so that a line with nothing on it is idle. §2.19.2: function 2.
            regs::pad(pin).write(1 << 6 | 1 << 4 | 1 << 3 | 1 << 1);
            regs::gpio_ctrl(pin).write(2);
        }
        // §4.2.8: enabled, both ways; requests of the receiver.
        regs::UART_CR.write(1 << 9 | 1 << 8 | 1);
        regs::UART_DMACR.write(1);
        CHANNEL.read_addr().write(regs::UART_DR.address());
        CHANNEL.write_addr().write(ring as u32);
        CHANNEL.ctrl().write(CTRL);
        CHANNEL.trans_count_trig().write(u32::MAX);
        Uart { ring, next: 0, taken: 0, lost: 0, gap: false, baud: Baud::B115200 }
    }

    /// Unread bytes in the ring.
    #[inline(always)]
    pub(crate) fn waiting(&self) -> usize {
        (CHANNEL.write_addr().read() as usize).wrapping_sub(self.ring as usize + self.next) & (RING_BYTES - 1)
    }

    /// If more bytes came than the ring holds, unread ones were overwritten: drops all.
    #[inline(always)]
    fn check_for_overflow(&mut self) {
        // §2.5.7, TRANS_COUNT: what may still come.
        let unread = (!CHANNEL.trans_count().read()).wrapping_sub(self.taken);
        if unread > RING_BYTES as u32 {
            self.lost = self.lost.saturating_add(unread);
            self.gap = true;
            self.drop_all();
        }
    }

    fn drop_all(&mut self) {
        // In this order, so that a byte that comes in between counts as unread.
        self.taken = !CHANNEL.trans_count().read();
        self.next = (self.next + self.waiting()) & (RING_BYTES - 1);
    }

    /// Whether bytes were lost before those that were read last, since the last call.
    pub(crate) const fn take_gap(&mut self) -> bool {
        core::mem::replace(&mut self.gap, false)
    }

    /// Bytes lost since the last call.
    pub(crate) const fn take_lost_bytes(&mut self) -> u32 {
        core::mem::replace(&mut self.lost, 0)
    }

    /// Reads bytes, as many as `into` has room for. At the end of the ring it reads up to there: the next call reads on from its
    /// beginning.
    #[inline(always)]
    pub(crate) fn read<'a>(&mut self, into: &'a mut [u8]) -> &'a [u8] {
        self.check_for_overflow();
        let count = self.waiting().min(RING_BYTES - self.next).min(into.len());
        let Some(bytes) = into.get_mut(..count) else { return &[] };
        for (at, byte) in (self.next..).zip(bytes.iter_mut()) {
            // SAFETY: inside the ring; the DMA has written there already.
            *byte = unsafe { self.ring.add(at).read_volatile() };
        }
        self.next = (self.next + count) & (RING_BYTES - 1);
        self.taken = self.taken.wrapping_add(count as u32);
        bytes
    }

    /// Starts the DMA again when its 2^32 − 1 bytes have come; to be called now and then.
    pub(crate) fn keep_receiving(&mut self) {
        if CHANNEL.ctrl().read() & 1 << 24 == 0 {
            self.taken = self.taken.wrapping_sub(u32::MAX);
            CHANNEL.trans_count_trig().write(u32::MAX);
        }
    }

    /// Changes the rate, and drops what came at the old one. The last byte must be sent.
    pub(crate) fn set_baud(&mut self, baud: Baud) {
        if baud != self.baud {
            self.baud = baud;
            set_baud(baud);
            self.drop_all();
        }
    }
}

/// Whether the receiver lost a byte, since the last call.
pub(crate) fn has_overrun() -> bool {
    let overrun = regs::UART_RSR.read() & 1 << 3 != 0;
    if overrun {
        regs::UART_RSR.write(0);
    }
    overrun
}

/// Whether the UART takes another byte.
#[inline(always)]
pub(crate) fn can_send() -> bool {
    regs::UART_FR.read() & 1 << 5 == 0
}

/// Whether every byte is sent, up to its last bit.
#[inline(always)]
pub(crate) fn is_out() -> bool {
    regs::UART_FR.read() & 1 << 3 == 0
}

/// Hands a byte to the UART; see [`can_send`].
#[inline(always)]
pub(crate) fn send(byte: u8) {
    regs::UART_DR.write(u32::from(byte));
}

fn set_baud(baud: Baud) {
    // §4.2.7.1: the divisor in 64ths; a byte takes 16 of its cycles a bit.
    let divisor = (4 * TICK_HZ + baud.rate() / 2) / baud.rate();
    regs::UART_IBRD.write(divisor >> 6);
    regs::UART_FBRD.write(divisor & 63);
    // 8 bits, FIFOs. The divisor takes effect with this write.
    regs::UART_LCR.write(0b11 << 5 | 1 << 4);
}
