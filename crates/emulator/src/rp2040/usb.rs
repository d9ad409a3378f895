//! The USB device controller: registers (RP2040 datasheet §4.1.4), DPRAM (§4.1.2.5), and its answers to tokens. The PC at
//! the other end of the cable is [`crate::usb`].
//!
//! Not emulated: host mode, isochronous endpoints, remote wake-up, direct control of the pins, and the three cycles
//! that §4.1.2.5.1 demands between AVAILABLE and the other bits of a buffer control.

use crate::arm::Size;
use crate::usb::{Answer, Direction, UsbDevice, UsbLink};

/// Offsets of the registers.
pub(super) mod at {
    pub(super) const ADDR_ENDP: u32 = 0x00;
    pub(super) const MAIN_CTRL: u32 = 0x40;
    pub(super) const SOF_RD: u32 = 0x48;
    pub(super) const SIE_CTRL: u32 = 0x4c;
    pub(super) const SIE_STATUS: u32 = 0x50;
    pub(super) const BUFF_STATUS: u32 = 0x58;
    pub(super) const BUFF_CPU_SHOULD_HANDLE: u32 = 0x5c;
    pub(super) const EP_ABORT: u32 = 0x60;
    pub(super) const EP_ABORT_DONE: u32 = 0x64;
    pub(super) const EP_STALL_ARM: u32 = 0x68;
    pub(super) const NAK_POLL: u32 = 0x6c;
    pub(super) const EP_STATUS_STALL_NAK: u32 = 0x70;
    pub(super) const USB_MUXING: u32 = 0x74;
    pub(super) const USB_PWR: u32 = 0x78;
    pub(super) const INTR: u32 = 0x8c;
    pub(super) const INTE: u32 = 0x90;
    pub(super) const INTF: u32 = 0x94;
    pub(super) const INTS: u32 = 0x98;
}

const CONTROLLER_EN: u32 = 1;
const HOST: u32 = 1 << 1;
/// USB_MUXING: connects the controller to the pins of the chip.
const TO_PHY: u32 = 1;
/// USB_PWR.
const VBUS_DETECT: u32 = 1 << 2;
const VBUS_DETECT_OVERRIDE: u32 = 1 << 3;

/// SIE_CTRL.
mod sie_ctrl {
    pub(super) const PULL_UP: u32 = 1 << 16;
    pub(super) const EP0_INT_NAK: u32 = 1 << 27;
    pub(super) const EP0_INT_2BUF: u32 = 1 << 28;
    pub(super) const EP0_INT_1BUF: u32 = 1 << 29;
    pub(super) const EP0_DOUBLE: u32 = 1 << 30;
    pub(super) const EP0_INT_STALL: u32 = 1 << 31;
}

/// SIE_STATUS.
mod status {
    pub(super) const VBUS: u32 = 1;
    /// Bits 3 and 2: J, an idle line.
    pub(super) const LINE_J: u32 = 1 << 2;
    pub(super) const SUSPENDED: u32 = 1 << 4;
    pub(super) const RESUME: u32 = 1 << 11;
    pub(super) const CONNECTED: u32 = 1 << 16;
    pub(super) const SETUP: u32 = 1 << 17;
    pub(super) const TRANSACTION: u32 = 1 << 18;
    pub(super) const BUS_RESET: u32 = 1 << 19;
    pub(super) const ACK: u32 = 1 << 30;
    pub(super) const SEQUENCE: u32 = 1 << 31;
    /// Errors that do not occur on this bus.
    pub(super) const OTHERS: u32 = 0x3f << 24;
    pub(super) const CLEARED_BY_ONES: u32 =
        SUSPENDED | RESUME | CONNECTED | SETUP | TRANSACTION | BUS_RESET | ACK | SEQUENCE | OTHERS;
}

/// INTR.
mod interrupt {
    pub(super) const TRANSACTION: u32 = 1 << 3;
    pub(super) const BUFF_STATUS: u32 = 1 << 4;
    pub(super) const SEQUENCE: u32 = 1 << 5;
    pub(super) const VBUS: u32 = 1 << 11;
    pub(super) const BUS_RESET: u32 = 1 << 12;
    pub(super) const CONNECTED: u32 = 1 << 13;
    pub(super) const SUSPEND: u32 = 1 << 14;
    pub(super) const RESUME: u32 = 1 << 15;
    pub(super) const SETUP: u32 = 1 << 16;
    pub(super) const FRAME: u32 = 1 << 17;
    pub(super) const ABORT_DONE: u32 = 1 << 18;
    pub(super) const STALL_NAK: u32 = 1 << 19;
    pub(super) const ALL: u32 = (1 << 20) - 1;
}

/// The control register of an endpoint in DPRAM (table 394).
mod endpoint {
    pub(super) const ENABLE: u32 = 1 << 31;
    pub(super) const DOUBLE: u32 = 1 << 30;
    pub(super) const INT_1BUF: u32 = 1 << 29;
    pub(super) const INT_2BUF: u32 = 1 << 28;
    pub(super) const INT_STALL: u32 = 1 << 17;
    pub(super) const INT_NAK: u32 = 1 << 16;
    /// The address of its buffers.
    pub(super) const ADDRESS: u32 = 0xffc0;
}

/// Half of an endpoint's buffer control in DPRAM (table 395).
mod buffer {
    pub(super) const LENGTH: u32 = 0x3ff;
    pub(super) const AVAILABLE: u32 = 1 << 10;
    pub(super) const STALL: u32 = 1 << 11;
    /// In the lower half only: buffer 0 is the next one.
    pub(super) const RESET: u32 = 1 << 12;
    pub(super) const DATA1: u32 = 1 << 13;
    pub(super) const LAST: u32 = 1 << 14;
    pub(super) const FULL: u32 = 1 << 15;
}

/// Where the buffer controls are, and the buffers of endpoint 0.
const BUFFER_CONTROLS: std::ops::Range<u32> = 0x80..0x100;
const EP0_BUFFERS: u32 = 0x100;
const BUFFER_BYTES: u32 = 64;

/// The 4 KB that processor and controller share. They can be read and written in bytes.
#[derive(Clone)]
pub(super) struct Memory(Box<[u8; Memory::BYTES as usize]>);

impl Memory {
    const BYTES: u32 = 4096;

    pub(super) fn read(&self, offset: u32, size: Size) -> u32 {
        let bytes = (offset..offset + size.bytes()).rev();
        bytes.fold(0, |value, at| value << 8 | u32::from(self.0[(at % Memory::BYTES) as usize]))
    }

    pub(super) fn write(&mut self, offset: u32, size: Size, value: u32) {
        for (at, byte) in (offset..).zip(value.to_le_bytes()).take(size.bytes() as usize) {
            self.0[(at % Memory::BYTES) as usize] = byte;
        }
    }

    fn word(&self, offset: u32) -> u32 {
        self.read(offset, Size::Word)
    }
}

#[derive(Clone)]
pub(super) struct Controller {
    pub(super) memory: Memory,
    address: u32,
    main_ctrl: u32,
    sie_ctrl: u32,
    sie_status: u32,
    buff_status: u32,
    /// For endpoints with two buffers: the buffer that was done last; then a second buffer that was done before the
    /// program handled the first.
    handle: u32,
    done_again: u32,
    /// Whether an endpoint's second buffer is next, one bit each as in BUFF_STATUS.
    second_next: u32,
    abort: u32,
    abort_done: u32,
    stall_arm: u32,
    nak_poll: u32,
    stall_nak: u32,
    muxing: u32,
    power: u32,
    /// The frame number that was read last.
    frame_read: u32,
    enabled: u32,
    forced: u32,
    /// Whether the cable supplies power.
    powered: bool,
}

/// The bit of an endpoint in BUFF_STATUS.
fn bit(number: u8, direction: Direction) -> u32 {
    1 << (2 * u32::from(number) + u32::from(direction == Direction::Out))
}

impl Controller {
    pub(super) fn new() -> Controller {
        Controller {
            memory: Memory(Box::new([0; Memory::BYTES as usize])),
            address: 0,
            main_ctrl: 0,
            sie_ctrl: 0,
            sie_status: 0,
            buff_status: 0,
            handle: 0,
            done_again: 0,
            second_next: 0,
            abort: 0,
            abort_done: 0,
            stall_arm: 0,
            nak_poll: 0x0010_0010,
            stall_nak: 0,
            muxing: 0,
            power: 0,
            frame_read: 0,
            enabled: 0,
            forced: 0,
            powered: false,
        }
    }

    /// Resets the controller. DPRAM keeps its contents.
    pub(super) fn reset(&mut self) {
        let memory = std::mem::replace(&mut self.memory, Memory(Box::new([0; Memory::BYTES as usize])));
        *self = Controller { memory, powered: self.powered, ..Controller::new() };
    }

    // Registers. `frame` is the number of the present frame, if there is one.

    pub(super) fn read(&mut self, offset: u32, frame: Option<u32>) -> u32 {
        match offset {
            at::ADDR_ENDP => self.address,
            at::MAIN_CTRL => self.main_ctrl,
            at::SOF_RD => {
                self.frame_read = frame.unwrap_or(self.frame_read);
                self.frame_read
            }
            at::SIE_CTRL => self.sie_ctrl,
            at::SIE_STATUS => self.status(),
            at::BUFF_STATUS => self.buff_status,
            at::BUFF_CPU_SHOULD_HANDLE => self.handle,
            at::EP_ABORT => self.abort,
            at::EP_ABORT_DONE => self.abort_done,
            at::EP_STALL_ARM => self.stall_arm,
            at::NAK_POLL => self.nak_poll,
            at::EP_STATUS_STALL_NAK => self.stall_nak,
            at::USB_MUXING => self.muxing,
            at::USB_PWR => self.power,
            at::INTR => self.raw_interrupts(frame),
            at::INTE => self.enabled,
            at::INTF => self.forced,
            at::INTS => self.interrupts(frame),
            _ => 0,
        }
    }

    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32) {
        match offset {
            at::ADDR_ENDP => self.address = merge(self.address) & 0x000f_007f,
            at::MAIN_CTRL => self.main_ctrl = merge(self.main_ctrl) & (1 << 31 | HOST | CONTROLLER_EN),
            at::SIE_CTRL => self.sie_ctrl = merge(self.sie_ctrl),
            at::SIE_STATUS => self.sie_status &= !(value & status::CLEARED_BY_ONES),
            at::BUFF_STATUS => {
                // A second buffer that was done meanwhile sets its bit again at once (§4.1.4, BUFF_STATUS).
                let again = self.done_again & value & self.buff_status;
                self.buff_status = self.buff_status & !value | again;
                self.done_again &= !again;
                self.handle ^= again;
            }
            at::EP_ABORT => {
                self.abort = merge(self.abort);
                // Between two cycles of the processor no transaction is under way, so that an abort is complete at
                // once.
                self.abort_done |= self.abort;
            }
            at::EP_ABORT_DONE => self.abort_done &= !value,
            at::EP_STALL_ARM => self.stall_arm = merge(self.stall_arm) & 3,
            at::NAK_POLL => self.nak_poll = merge(self.nak_poll),
            at::EP_STATUS_STALL_NAK => self.stall_nak &= !value,
            at::USB_MUXING => self.muxing = merge(self.muxing),
            at::USB_PWR => self.power = merge(self.power),
            at::INTE => self.enabled = merge(self.enabled) & interrupt::ALL,
            at::INTF => self.forced = merge(self.forced) & interrupt::ALL,
            _ => {}
        }
    }

    fn vbus(&self) -> bool {
        if self.power & VBUS_DETECT_OVERRIDE != 0 { self.power & VBUS_DETECT != 0 } else { self.powered }
    }

    fn status(&self) -> u32 {
        let vbus = if self.vbus() { status::VBUS } else { 0 };
        self.sie_status | vbus | if self.is_attached() { status::LINE_J } else { 0 }
    }

    fn raw_interrupts(&self, frame: Option<u32>) -> u32 {
        let shown = self.status();
        let of_status = [
            (status::SETUP, interrupt::SETUP),
            (status::BUS_RESET, interrupt::BUS_RESET),
            (status::CONNECTED, interrupt::CONNECTED),
            (status::SUSPENDED, interrupt::SUSPEND),
            (status::RESUME, interrupt::RESUME),
            (status::VBUS, interrupt::VBUS),
            (status::TRANSACTION, interrupt::TRANSACTION),
            (status::SEQUENCE, interrupt::SEQUENCE),
        ];
        let of_status = of_status.iter().filter(|(bit, _)| shown & bit != 0).fold(0, |all, (_, bit)| all | bit);
        let set = |so: bool, bit| if so { bit } else { 0 };
        of_status
            | set(self.buff_status != 0, interrupt::BUFF_STATUS)
            | set(self.abort_done != 0, interrupt::ABORT_DONE)
            | set(self.stall_nak != 0, interrupt::STALL_NAK)
            | set(frame.is_some_and(|frame| frame != self.frame_read), interrupt::FRAME)
    }

    pub(super) fn interrupts(&self, frame: Option<u32>) -> u32 {
        self.raw_interrupts(frame) & self.enabled | self.forced
    }

    /// The program has written DPRAM. Returns whether this may change the answer to a token.
    pub(super) fn memory_written(&mut self, offset: u32) -> bool {
        if !BUFFER_CONTROLS.contains(&offset) {
            return offset < BUFFER_CONTROLS.start;
        }
        let control = offset & !3;
        if self.memory.word(control) & buffer::RESET != 0 {
            self.second_next &= !(1 << ((control - BUFFER_CONTROLS.start) / 4));
        }
        true
    }

    // Endpoints.

    fn endpoint_control(&self, number: u8, direction: Direction) -> u32 {
        if number == 0 {
            // Endpoint 0 has its bits in SIE_CTRL, and it is always there.
            let moved = [
                (sie_ctrl::EP0_DOUBLE, endpoint::DOUBLE),
                (sie_ctrl::EP0_INT_1BUF, endpoint::INT_1BUF),
                (sie_ctrl::EP0_INT_2BUF, endpoint::INT_2BUF),
                (sie_ctrl::EP0_INT_STALL, endpoint::INT_STALL),
                (sie_ctrl::EP0_INT_NAK, endpoint::INT_NAK),
            ];
            let bits = moved.iter().filter(|(from, _)| self.sie_ctrl & from != 0).fold(0, |all, (_, bit)| all | bit);
            return endpoint::ENABLE | EP0_BUFFERS | bits;
        }
        self.memory.word(8 * u32::from(number) + 4 * u32::from(direction == Direction::Out))
    }

    fn control_offset(number: u8, direction: Direction) -> u32 {
        BUFFER_CONTROLS.start + 8 * u32::from(number) + 4 * u32::from(direction == Direction::Out)
    }

    /// Whether an endpoint's second buffer is next.
    fn uses_second(&self, number: u8, direction: Direction) -> bool {
        let double = self.endpoint_control(number, direction) & endpoint::DOUBLE != 0;
        double && self.second_next & bit(number, direction) != 0
    }

    /// The control of the buffer that is next, and the address of the buffer.
    fn buffer(&self, number: u8, direction: Direction) -> (u32, u32) {
        let both = self.memory.word(Controller::control_offset(number, direction));
        let first = self.endpoint_control(number, direction) & endpoint::ADDRESS;
        if self.uses_second(number, direction) { (both >> 16, first + BUFFER_BYTES) } else { (both & 0xffff, first) }
    }

    /// A buffer is done: writes its control back, selects the next buffer, and sets the flags that the program has
    /// enabled.
    fn done(&mut self, number: u8, direction: Direction, control: u32) {
        let (second, bit) = (self.uses_second(number, direction), bit(number, direction));
        let (offset, asked) = (Controller::control_offset(number, direction), self.endpoint_control(number, direction));
        self.memory.write(if second { offset + 2 } else { offset }, Size::Half, control);
        if asked & endpoint::DOUBLE != 0 {
            self.second_next ^= bit;
        }
        if control & buffer::LAST != 0 {
            self.sie_status |= status::TRANSACTION;
        }
        if asked & endpoint::INT_1BUF != 0 || asked & endpoint::INT_2BUF != 0 && second {
            if self.buff_status & bit != 0 {
                self.done_again |= bit;
            } else {
                self.handle = self.handle & !bit | if second { bit } else { 0 };
            }
            self.buff_status |= bit;
        }
    }
}

impl UsbDevice for Controller {
    fn set_power(&mut self, powered: bool) {
        self.powered = powered;
    }

    /// Whether the pull-up shows the PC that a device is connected.
    fn is_attached(&self) -> bool {
        let enabled = self.main_ctrl & (CONTROLLER_EN | HOST) == CONTROLLER_EN;
        enabled && self.powered && self.vbus() && self.sie_ctrl & sie_ctrl::PULL_UP != 0 && self.muxing & TO_PHY != 0
    }

    /// The PC resets the bus (§4.1.2.6.1). The address register keeps what the program has written.
    fn bus_reset(&mut self) {
        self.sie_status |= status::BUS_RESET | status::CONNECTED;
        self.sie_status &= !status::SUSPENDED;
    }

    /// The bus has had no frame for 3 ms.
    fn suspend(&mut self) {
        self.sie_status |= status::SUSPENDED;
    }

    /// Whether the device has this address.
    fn has_address(&self, address: u8) -> bool {
        self.is_attached() && self.address & 0x7f == u32::from(address)
    }

    /// The device's answer to a token.
    fn answer(&self, number: u8, direction: Direction) -> Answer {
        if self.endpoint_control(number, direction) & endpoint::ENABLE == 0 || self.abort & bit(number, direction) != 0
        {
            return Answer::Refused;
        }
        let (control, _) = self.buffer(number, direction);
        let stall_armed = number != 0 || self.stall_arm & bit(0, direction) != 0;
        // One bit, in the half of the first buffer, counts for both (§4.1.2.5.3).
        let both = self.memory.read(Controller::control_offset(number, direction), Size::Word);
        if both & buffer::STALL != 0 && stall_armed {
            return Answer::Stall;
        }
        let filled = control & buffer::FULL != 0;
        if control & buffer::AVAILABLE != 0 && filled == (direction == Direction::In) {
            Answer::Ready { bytes: control & buffer::LENGTH }
        } else {
            Answer::Refused
        }
    }

    /// The device refused or stalled a token: sets the flags that the program has enabled.
    fn refused(&mut self, number: u8, direction: Direction, stall: bool) {
        let asked = if stall { endpoint::INT_STALL } else { endpoint::INT_NAK };
        if self.endpoint_control(number, direction) & asked != 0 {
            self.stall_nak |= bit(number, direction);
        }
    }

    /// The PC begins a control transfer, which a device must always accept (§4.1.2.6.3).
    fn setup(&mut self, packet: [u8; 8]) {
        for (offset, byte) in (0..).zip(packet) {
            self.memory.write(offset, Size::Byte, byte.into());
        }
        self.stall_arm = 0;
        self.sie_status |= status::SETUP;
    }

    /// The PC takes the data of the next buffer. Returns whether they are DATA1, and the data.
    fn take(&mut self, number: u8) -> (bool, Vec<u8>) {
        let (control, address) = self.buffer(number, Direction::In);
        let range = address..address + (control & buffer::LENGTH);
        let data = range.map(|offset| self.memory.read(offset, Size::Byte) as u8).collect();
        self.done(number, Direction::In, control & !(buffer::AVAILABLE | buffer::FULL));
        self.sie_status |= status::ACK;
        (control & buffer::DATA1 != 0, data)
    }

    /// The PC sends data. If they are not the expected one of DATA0 and DATA1, they are a repetition: they are
    /// acknowledged and dropped.
    fn put(&mut self, number: u8, data1: bool, data: &[u8]) {
        let (control, address) = self.buffer(number, Direction::Out);
        if (control & buffer::DATA1 != 0) != data1 {
            self.sie_status |= status::SEQUENCE;
            return;
        }
        for (offset, byte) in (address..).zip(data) {
            self.memory.write(offset, Size::Byte, (*byte).into());
        }
        let control = control & !(buffer::AVAILABLE | buffer::LENGTH);
        self.done(number, Direction::Out, control | buffer::FULL | data.len() as u32);
    }

    /// Whether the start of this frame raises an interrupt.
    fn wants_frames(&self, frame: u32) -> bool {
        self.enabled & interrupt::FRAME != 0 && self.frame_read == frame
    }
}

/// The controller with its cable.
pub(super) type Usb = UsbLink<Controller>;

impl Usb {
    /// Resets the controller. The PC sees that the device has gone.
    pub(super) fn reset(&mut self, cycle: u64) {
        self.device.reset();
        self.plan(cycle);
    }

    /// Whether the interrupt line (USBCTRL_IRQ) is high.
    pub(super) fn line_asserted(&self) -> bool {
        self.device.interrupts(self.frame()) != 0
    }

    pub(super) fn read(&mut self, offset: u32, cycle: u64) -> u32 {
        let frame = self.frame_in(cycle);
        let value = self.device.read(offset, frame);
        if offset == at::SOF_RD {
            self.plan(cycle);
        }
        value
    }

    /// `value` is the written word, for bits that ones clear. `merge` makes the new value of the other registers.
    pub(super) fn write(&mut self, offset: u32, value: u32, merge: impl Fn(u32) -> u32, cycle: u64) {
        self.device.write(offset, value, merge);
        self.plan(cycle + 1);
    }

    pub(super) fn read_memory(&self, offset: u32, size: Size) -> u32 {
        self.device.memory.read(offset, size)
    }

    pub(super) fn write_memory(&mut self, offset: u32, size: Size, value: u32, cycle: u64) {
        self.device.memory.write(offset, size, value);
        if self.device.memory_written(offset) {
            self.plan(cycle + 1);
        }
    }
}
