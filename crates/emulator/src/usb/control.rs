//! Control transfers (USB 2.0 §8.5.3), and the requests with which a PC sets up a serial port (§9.4; CDC 1.2 PSTN
//! §6.3).

use super::Direction;

/// The largest packet of endpoint 0 until the device's descriptor is known, bytes.
const FIRST_PACKET: usize = 64;

/// A standard or class request, as the packet of its setup stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Request {
    Descriptor {
        kind: u8,
        index: u8,
        length: u16,
    },
    SetAddress(u8),
    SetConfiguration(u8),
    /// Sets an interface to 115 200 baud, 8 data bits, no parity, one stop bit.
    SetLineCoding(u8),
    /// Sets DTR and RTS of an interface: whether a program has the port open.
    SetLineState(u8, bool),
    /// Ends the halt of an endpoint, which goes on with DATA0 (USB 2.0 §9.4.5).
    ClearHalt(u8),
    /// Halts an endpoint (USB 2.0 §9.4.9).
    SetHalt(u8),
    /// Selects a configuration that a program on the PC has chosen.
    TryConfiguration(u8),
}

const DEVICE: u8 = 1;
const CONFIGURATION: u8 = 2;
pub(super) const STRING: u8 = 3;
const INTERFACE: u8 = 4;
const ENDPOINT: u8 = 5;

impl Request {
    pub(super) const FIRST_LOOK: Request = Request::Descriptor { kind: DEVICE, index: 0, length: 64 };
    pub(super) const DEVICE: Request = Request::Descriptor { kind: DEVICE, index: 0, length: 18 };

    /// Requests the descriptors of the configuration, or their beginning.
    pub(super) fn configuration(length: u16) -> Request {
        Request::Descriptor { kind: CONFIGURATION, index: 0, length }
    }

    pub(super) fn string(index: u8) -> Request {
        Request::Descriptor { kind: STRING, index, length: 255 }
    }

    /// Whether the device may refuse the request, and the PC goes on.
    pub(super) fn is_optional(self) -> bool {
        matches!(
            self,
            Request::Descriptor { kind: STRING, .. }
                | Request::SetLineCoding(_)
                | Request::SetLineState(..)
                | Request::ClearHalt(_)
                | Request::SetHalt(_)
                | Request::TryConfiguration(_)
        )
    }

    fn setup(self) -> [u8; 8] {
        const ENGLISH: u16 = 0x0409;
        let (kind, request, value, index, length) = match self {
            Request::Descriptor { kind, index, length } => {
                let language = if kind == STRING && index != 0 { ENGLISH } else { 0 };
                (0x80, 6, u16::from_be_bytes([kind, index]), language, length)
            }
            Request::SetAddress(address) => (0x00, 5, address.into(), 0, 0),
            Request::SetConfiguration(value) | Request::TryConfiguration(value) => (0x00, 9, value.into(), 0, 0),
            Request::ClearHalt(endpoint) => (0x02, 1, 0, endpoint.into(), 0),
            Request::SetHalt(endpoint) => (0x02, 3, 0, endpoint.into(), 0),
            Request::SetLineCoding(interface) => (0x21, 0x20, 0, interface.into(), 7),
            Request::SetLineState(interface, on) => (0x21, 0x22, if on { 3 } else { 0 }, interface.into(), 0),
        };
        let ([v0, v1], [i0, i1], [l0, l1]) = (value.to_le_bytes(), u16::to_le_bytes(index), u16::to_le_bytes(length));
        [kind, request, v0, v1, i0, i1, l0, l1]
    }

    /// The data that the PC sends with the request.
    fn data(self) -> Vec<u8> {
        const BAUD: u32 = 115_200;
        match self {
            Request::SetLineCoding(_) => BAUD.to_le_bytes().into_iter().chain([0, 0, 8]).collect(),
            _ => Vec::new(),
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    Setup,
    Data,
    Status,
    Done,
}

/// The next transaction of a transfer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Token {
    Setup([u8; 8]),
    In,
    Out { data1: bool, data: Vec<u8> },
}

/// A control transfer that is under way.
#[derive(Clone, Debug)]
pub(super) struct Transfer {
    pub(super) request: Request,
    stage: Stage,
    /// Whether the next data packet is DATA1.
    data1: bool,
    setup: [u8; 8],
    /// The data to be sent, or those received so far.
    pub(super) data: Vec<u8>,
    sent: usize,
    packet: usize,
}

impl Transfer {
    /// `packet` is the device's largest packet of endpoint 0, if it is known.
    pub(super) fn new(request: Request, packet: Option<usize>) -> Transfer {
        Transfer {
            request,
            stage: Stage::Setup,
            data1: true,
            setup: request.setup(),
            data: request.data(),
            sent: 0,
            packet: packet.unwrap_or(FIRST_PACKET),
        }
    }

    fn direction(&self) -> Direction {
        if self.setup[0] & 0x80 != 0 { Direction::In } else { Direction::Out }
    }

    fn length(&self) -> usize {
        usize::from(u16::from_le_bytes([self.setup[6], self.setup[7]]))
    }

    pub(super) fn is_done(&self) -> bool {
        self.stage == Stage::Done
    }

    pub(super) fn token(&self) -> Token {
        match (self.stage, self.direction()) {
            (Stage::Setup, _) => Token::Setup(self.setup),
            (Stage::Data, Direction::Out) => {
                let end = self.data.len().min(self.sent + self.packet);
                Token::Out { data1: self.data1, data: self.data[self.sent..end].to_vec() }
            }
            (Stage::Data, Direction::In) => Token::In,
            // The status stage goes in the opposite direction and is an empty DATA1.
            (_, Direction::In) if self.length() != 0 => Token::Out { data1: true, data: Vec::new() },
            _ => Token::In,
        }
    }

    /// The device has taken the packet.
    pub(super) fn sent(&mut self) {
        match self.stage {
            Stage::Setup => self.stage = if self.length() == 0 { Stage::Status } else { Stage::Data },
            Stage::Data => {
                self.sent = self.data.len().min(self.sent + self.packet);
                self.data1 = !self.data1;
                if self.sent == self.data.len() {
                    self.stage = Stage::Status;
                }
            }
            Stage::Status | Stage::Done => self.stage = Stage::Done,
        }
    }

    /// The device has sent a packet. A repeated packet is acknowledged and dropped.
    pub(super) fn received(&mut self, data1: bool, data: &[u8]) {
        if self.stage == Stage::Status {
            self.stage = Stage::Done;
            return;
        }
        if data1 != self.data1 {
            return;
        }
        self.data1 = !self.data1;
        self.data.extend(data);
        // A short packet ends the data stage.
        if data.len() < self.packet || self.data.len() >= self.length() {
            self.stage = Stage::Status;
        }
    }
}

/// An endpoint, from its descriptor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Endpoint {
    pub(super) number: u8,
    /// Its largest packet, bytes.
    pub(super) packet: usize,
}

/// The serial port that a configuration offers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Port {
    /// The number of the configuration.
    pub(super) configuration: u8,
    /// The interface of the communication class, to which control requests go.
    pub(super) interface: u8,
    pub(super) data_in: Option<Endpoint>,
    pub(super) data_out: Option<Endpoint>,
    pub(super) notifications: Option<Endpoint>,
}

/// Finds the serial port in a configuration's descriptors (USB 2.0 §9.6).
pub(super) fn port(descriptors: &[u8]) -> Port {
    const COMMUNICATION: u8 = 2;
    const DATA: u8 = 10;
    const BULK: u8 = 2;
    const INTERRUPT: u8 = 3;
    let mut port = Port::default();
    let mut class = 0;
    let mut rest = descriptors;
    while let Some((length, descriptor)) = rest.first().map(|length| (usize::from(*length), rest)) {
        if length < 2 || length > descriptor.len() {
            break;
        }
        match descriptor[..length] {
            [_, CONFIGURATION, _, _, _, value, ..] => port.configuration = value,
            [_, INTERFACE, number, _, _, interface_class, ..] => {
                class = interface_class;
                if class == COMMUNICATION {
                    port.interface = number;
                }
            }
            [_, ENDPOINT, address, kind, low, high, ..] => {
                let packet = usize::from(u16::from_le_bytes([low, high]) & 0x7ff);
                let endpoint = Some(Endpoint { number: address & 15, packet });
                match (class, kind & 3, address >> 7) {
                    (DATA, BULK, 1) => port.data_in = endpoint,
                    (DATA, BULK, _) => port.data_out = endpoint,
                    (COMMUNICATION, INTERRUPT, 1) => port.notifications = endpoint,
                    _ => {}
                }
            }
            _ => {}
        }
        rest = &descriptor[length..];
    }
    port
}
