//! The PC at the other end of the cable: it detects the device, enumerates it, opens its serial port and moves bytes
//! (USB 2.0 §9).
//!
//! Its requests come in the order of Linux (reset, a first descriptor, reset, address, descriptors, strings,
//! configuration), with the shortest times that USB 2.0 allows. Transactions follow one another without a pause, each
//! within one frame; the endpoints take turns. A refused token is repeated for ever, and takes its time on the bus. The
//! delays of drivers and programs on a PC are not emulated.

use super::bus::{Bus, REFUSED_IN_BITS, transaction_bits};
use super::control::{Endpoint, Port, Request, STRING, Token, Transfer, port};
use super::{Answer, Direction, NEVER, UsbDevice};
use crate::Observer;
use std::collections::{BTreeMap, VecDeque};

/// Times of the enumeration, ms: from the pull-up to the reset (USB 2.0 §7.1.7.3), length of a reset by a root port
/// (TDRSTR), recovery after it (TRSTRCY), recovery after the address (§9.2.6.3).
const DEBOUNCE_MS: u64 = 100;
const RESET_MS: u64 = 50;
const RECOVERY_MS: u64 = 10;
const ADDRESS_MS: u64 = 2;
/// Time without frames after which the bus is suspended, ms (§7.1.7.6).
const SUSPEND_MS: u64 = 3;
/// Time after which a request has failed, ms (§9.2.6.4).
const REQUEST_MS: u64 = 5000;
/// The address that the PC assigns to the device.
const ADDRESS: u8 = 1;

/// How far the PC has brought the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum UsbState {
    /// No device: the cable is out, or the device's pull-up is off.
    Detached,
    /// The PC resets, addresses and configures it.
    Enumerating,
    /// It is configured, and no program has its serial port open.
    Configured,
    /// A program has its serial port open: bytes are moved.
    Open,
    /// It broke the protocol, and the PC ignores it until it is plugged in again.
    Failed,
}

/// What the PC does, or waits for.
#[derive(Clone, Debug)]
enum HostTask {
    /// It waits for a device.
    Nothing,
    /// It waits for a cycle, and then does this.
    Wait(u64, After),
    /// It makes a control transfer, which has failed if it is not complete by a cycle.
    Control(Transfer, u64),
    /// The device is configured and programs may use it.
    Idle,
    GivenUp,
}

/// What comes after a wait. The device is reset twice; after the second reset it gets its address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum After {
    Reset { second: bool },
    Recovery { second: bool },
    Ask { second: bool },
    Address,
}

/// The pipes that share the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pipe {
    Control,
    Notifications,
    In,
    Out,
}

const PIPES: [Pipe; 4] = [Pipe::Control, Pipe::Notifications, Pipe::In, Pipe::Out];

/// A transaction that could come next.
struct Offer {
    answer: Answer,
    /// Its bit times if the device takes it, and if the device refuses it.
    bits: u64,
    refused_bits: u64,
    number: u8,
    direction: Direction,
}

#[derive(Clone)]
pub(super) struct Host {
    pub(super) bus: Bus,
    /// The cycle of the next event.
    pub(super) next: u64,
    plugged: bool,
    work: HostTask,
    /// The transaction on the bus, and the cycle of its end.
    flight: Option<(u64, Pipe)>,
    /// The pipe that comes first in the next round.
    turn: usize,
    /// The bus has been free since this cycle. The device has refused everything since, and each round of polls takes
    /// `polling_bits`.
    free: u64,
    polling_bits: u64,
    suspend_at: u64,
    address: u8,
    /// The largest packet of endpoint 0, if it is known.
    packet0: Option<usize>,
    port: Port,
    configured: bool,
    wanted_open: bool,
    is_open: bool,
    /// Whether the program does not read and the PC's buffers are full.
    is_full: bool,
    /// Requests that programs on the PC have made of the driver.
    asked: Vec<Request>,
    /// The requests to come, in order.
    requests: VecDeque<Request>,
    /// Whether the next packet is DATA1.
    in_data1: bool,
    out_data1: bool,
    out: VecDeque<u8>,
    /// Which endpoints have stalled: data to the PC, data from it, notifications. The PC leaves them alone until their
    /// halt is cleared.
    stalled: [bool; 3],
    /// The device's strings, by index.
    texts: BTreeMap<u8, String>,
}

impl Host {
    pub(super) fn new() -> Host {
        Host {
            bus: Bus::new(),
            next: NEVER,
            plugged: false,
            work: HostTask::Nothing,
            flight: None,
            turn: 0,
            free: 0,
            polling_bits: 0,
            suspend_at: NEVER,
            address: 0,
            packet0: None,
            port: Port::default(),
            configured: false,
            wanted_open: false,
            is_open: false,
            is_full: false,
            asked: Vec::new(),
            requests: VecDeque::new(),
            in_data1: false,
            out_data1: false,
            out: VecDeque::new(),
            stalled: [false; 3],
            texts: BTreeMap::new(),
        }
    }

    pub(super) fn text(&self, index: u8) -> Option<String> {
        self.texts.get(&index).cloned()
    }

    pub(super) fn plug(&mut self, plugged: bool) {
        self.plugged = plugged;
    }

    pub(super) fn open(&mut self, open: bool) {
        self.wanted_open = open;
    }

    pub(super) fn fill(&mut self, is_full: bool) {
        self.is_full = is_full;
    }

    /// A program on the PC makes a request. It is sent when the device is configured.
    pub(super) fn ask(&mut self, request: Request) {
        self.asked.push(request);
    }

    pub(super) fn send(&mut self, bytes: &[u8]) {
        self.out.extend(bytes);
    }

    /// Bytes that the device has not taken yet.
    pub(super) fn backlog(&self) -> usize {
        self.out.len()
    }

    pub(super) fn state(&self) -> UsbState {
        match self.work {
            HostTask::Nothing => UsbState::Detached,
            HostTask::GivenUp => UsbState::Failed,
            _ if self.is_open => UsbState::Open,
            _ if self.configured => UsbState::Configured,
            _ => UsbState::Enumerating,
        }
    }

    /// Whether frames are on the bus. They begin with the end of the first reset.
    pub(super) fn makes_frames(&self) -> bool {
        match self.work {
            HostTask::Nothing => false,
            HostTask::Wait(_, after) => matches!(after, After::Ask { .. } | After::Address),
            HostTask::Control(..) | HostTask::Idle | HostTask::GivenUp => true,
        }
    }

    /// Handles the events that are due in a cycle.
    pub(super) fn run(&mut self, cycle: u64, controller: &mut impl UsbDevice, observer: &mut impl Observer) {
        if self.suspend_at <= cycle {
            self.suspend_at = NEVER;
            controller.suspend();
        }
        if let Some((end, pipe)) = self.flight
            && end <= cycle
        {
            self.flight = None;
            self.free = end;
            self.finish(pipe, cycle, controller, observer);
        }
        match self.work {
            HostTask::Wait(until, after) if until <= cycle => self.go_on(after, cycle, controller),
            HostTask::Control(_, deadline) if deadline <= cycle => self.work = HostTask::GivenUp,
            _ => {}
        }
    }

    /// Notices what has changed by a cycle, and begins the next transaction if there is one.
    pub(super) fn plan(&mut self, cycle: u64, controller: &mut impl UsbDevice) {
        controller.set_power(self.plugged);
        match (controller.is_attached(), &self.work) {
            (false, HostTask::Nothing) => {}
            (false, _) => self.detach(cycle),
            (true, HostTask::Nothing) => {
                self.suspend_at = NEVER;
                self.work = HostTask::Wait(cycle + self.bus.milliseconds(DEBOUNCE_MS), After::Reset { second: false });
            }
            (true, HostTask::Idle) if self.wanted_open != self.is_open => {
                let interface = self.port.interface;
                if self.wanted_open {
                    self.requests.push_back(Request::SetLineCoding(interface));
                }
                self.requests.push_back(Request::SetLineState(interface, self.wanted_open));
                self.request(cycle);
            }
            (true, HostTask::Idle) if self.configured && !self.asked.is_empty() => {
                self.requests.extend(self.asked.drain(..));
                self.request(cycle);
            }
            _ => {}
        }
        if self.flight.is_none() && self.makes_frames() {
            self.begin(cycle, controller);
        }
        let flight = self.flight.map_or(NEVER, |(end, _)| end);
        let work = match self.work {
            HostTask::Wait(until, _) => until,
            HostTask::Control(_, deadline) => deadline,
            _ => NEVER,
        };
        self.next = flight.min(work).min(self.suspend_at);
    }

    fn detach(&mut self, cycle: u64) {
        let (bus, plugged, wanted_open) = (self.bus.clone(), self.plugged, self.wanted_open);
        let suspend_at = cycle + self.bus.milliseconds(SUSPEND_MS);
        *self = Host { bus, plugged, wanted_open, suspend_at, free: cycle, ..Host::new() };
    }

    /// Goes on after a wait.
    fn go_on(&mut self, after: After, cycle: u64, controller: &mut impl UsbDevice) {
        let wait = |ms, then| HostTask::Wait(cycle + self.bus.milliseconds(ms), then);
        match after {
            After::Reset { second } => {
                controller.bus_reset();
                self.address = 0;
                self.work = wait(RESET_MS, After::Recovery { second });
            }
            After::Recovery { second } => {
                controller.bus_reset_ends();
                self.work = wait(RECOVERY_MS, After::Ask { second });
            }
            After::Ask { second } => {
                self.requests.push_back(if second { Request::SetAddress(ADDRESS) } else { Request::FIRST_LOOK });
                self.request(cycle);
            }
            After::Address => {
                self.requests.push_back(Request::DEVICE);
                self.request(cycle);
            }
        }
    }

    /// Starts the transfer of the next request, if there is one.
    fn request(&mut self, cycle: u64) {
        self.work = match self.requests.pop_front() {
            Some(request) => {
                HostTask::Control(Transfer::new(request, self.packet0), cycle + self.bus.milliseconds(REQUEST_MS))
            }
            None => HostTask::Idle,
        };
    }

    /// A request is complete. `data` is empty if the device has refused it.
    fn answered(&mut self, request: Request, data: &[u8], cycle: u64) {
        match (request, data) {
            (Request::FIRST_LOOK, [_, _, _, _, _, _, _, packet, ..]) if *packet != 0 => {
                self.packet0 = Some((*packet).into());
                self.work = HostTask::Wait(cycle, After::Reset { second: true });
                return;
            }
            (Request::SetAddress(address), _) => {
                self.address = address;
                self.work = HostTask::Wait(cycle + self.bus.milliseconds(ADDRESS_MS), After::Address);
                return;
            }
            (Request::DEVICE, [.., manufacturer, product, serial, _]) if data.len() == 18 => {
                self.requests.push_back(Request::configuration(9));
                self.requests.push_back(Request::string(0));
                let texts = [*manufacturer, *product, *serial].into_iter().filter(|index| *index != 0);
                self.requests.extend(texts.map(Request::string));
            }
            // The first nine bytes of the configuration contain the length of all of it.
            (Request::Descriptor { length: 9, .. }, [9, _, low, high, ..])
                if data.len() == 9 && u16::from_le_bytes([*low, *high]) > 9 =>
            {
                self.requests.push_front(Request::configuration(u16::from_le_bytes([*low, *high])));
            }
            (Request::Descriptor { length: 10.., .. }, [9, ..]) if !request.is_optional() => {
                self.port = port(data);
                self.requests.push_back(Request::SetConfiguration(self.port.configuration));
            }
            (Request::SetConfiguration(_), _) => {
                (self.in_data1, self.out_data1) = (false, false);
                self.configured = true;
            }
            (Request::SetLineState(_, open), _) => {
                self.is_open = open;
                if !open {
                    self.out.clear();
                }
            }
            (Request::ClearHalt(endpoint), _) => {
                let is = |of: Option<Endpoint>| of.is_some_and(|of| of.number == endpoint & 15);
                match endpoint & 0x80 != 0 {
                    true if is(self.port.data_in) => (self.in_data1, self.stalled[0]) = (false, false),
                    false if is(self.port.data_out) => (self.out_data1, self.stalled[1]) = (false, false),
                    true if is(self.port.notifications) => self.stalled[2] = false,
                    _ => {}
                }
            }
            (Request::Descriptor { kind: STRING, index: index @ 1.., .. }, [_, _, units @ ..]) => {
                let units: Vec<u16> =
                    units.chunks_exact(2).map(|pair| u16::from_le_bytes([pair[0], pair[1]])).collect();
                self.texts.insert(index, String::from_utf16_lossy(&units));
            }
            _ if request.is_optional() => {}
            _ => {
                self.work = HostTask::GivenUp;
                return;
            }
        }
        self.request(cycle);
    }

    /// The next transaction of a pipe, if there is one.
    fn offer(&self, pipe: Pipe, controller: &impl UsbDevice) -> Option<Offer> {
        let offer = |number, direction, bytes: Option<usize>| {
            let answer = if controller.has_address(self.address) {
                controller.answer(number, direction)
            } else {
                Answer::Refused
            };
            let (bits, refused_bits) = match (bytes, answer) {
                (Some(bytes), _) => (transaction_bits(bytes as u64), transaction_bits(bytes as u64)),
                (None, Answer::Ready { bytes }) => (transaction_bits(bytes.into()), REFUSED_IN_BITS),
                (None, _) => (REFUSED_IN_BITS, REFUSED_IN_BITS),
            };
            Offer { answer, bits, refused_bits, number, direction }
        };
        match pipe {
            Pipe::Control => {
                let HostTask::Control(transfer, _) = &self.work else { return None };
                Some(match transfer.token() {
                    Token::Setup(packet) => {
                        let answer = if controller.has_address(self.address) {
                            Answer::Ready { bytes: 8 }
                        } else {
                            Answer::Refused
                        };
                        Offer { answer, ..offer(0, Direction::Out, Some(packet.len())) }
                    }
                    Token::In => offer(0, Direction::In, None),
                    Token::Out { data, .. } => offer(0, Direction::Out, Some(data.len())),
                })
            }
            // A driver clears an endpoint while no transfer is under way on it.
            _ if !self.is_open || self.clears() => None,
            Pipe::Notifications if self.stalled[2] => None,
            Pipe::Notifications => {
                // Notifications are polled so seldom that refusals take no time here.
                let endpoint = self.port.notifications?;
                Some(Offer { refused_bits: 0, ..offer(endpoint.number, Direction::In, None) })
            }
            Pipe::In if self.is_full || self.stalled[0] => None,
            Pipe::In => Some(offer(self.port.data_in?.number, Direction::In, None)),
            Pipe::Out if self.out.is_empty() || self.stalled[1] => None,
            Pipe::Out => {
                let endpoint = self.port.data_out?;
                Some(offer(endpoint.number, Direction::Out, Some(self.packet(endpoint))))
            }
        }
    }

    /// Whether an endpoint's halt is being cleared.
    fn clears(&self) -> bool {
        matches!(&self.work, HostTask::Control(Transfer { request: Request::ClearHalt(_), .. }, _))
    }

    /// The length of the next packet to the device, bytes.
    fn packet(&self, endpoint: Endpoint) -> usize {
        endpoint.packet.min(self.out.len())
    }

    /// Begins the next transaction that the device does not refuse, if there is one.
    fn begin(&mut self, cycle: u64, controller: &mut impl UsbDevice) {
        let mut chosen = None;
        let mut refused_bits = 0;
        for place in 0..PIPES.len() {
            let index = (self.turn + place) % PIPES.len();
            match self.offer(PIPES[index], controller) {
                Some(offer) if offer.answer == Answer::Refused => {
                    controller.refused(offer.number, offer.direction, false);
                    refused_bits += offer.refused_bits;
                }
                Some(offer) if chosen.is_none() => chosen = Some((index, offer.bits)),
                _ => {}
            }
        }
        let Some((index, bits)) = chosen else {
            self.polling_bits = refused_bits;
            return;
        };
        let from = match (cycle > self.free, self.polling_bits) {
            // The tokens that the device refused come first.
            (false, _) => self.free + self.bus.cycles(refused_bits),
            (true, 0) => cycle,
            (true, round) => self.bus.next_poll(self.free, cycle, round),
        };
        let (_, end) = self.bus.fit(from, bits);
        self.polling_bits = 0;
        self.flight = Some((end, PIPES[index]));
        self.turn = index + 1;
    }

    /// A transaction has ended.
    fn finish(&mut self, pipe: Pipe, cycle: u64, controller: &mut impl UsbDevice, observer: &mut impl Observer) {
        // The program may have withdrawn the buffer since the transaction began.
        let Some(offer) = self.offer(pipe, controller).filter(|offer| offer.answer != Answer::Refused) else { return };
        let Offer { answer, number, direction, .. } = offer;
        if answer == Answer::Stall {
            controller.refused(number, direction, true);
            match &self.work {
                HostTask::Control(transfer, _) if pipe == Pipe::Control && transfer.request.is_optional() => {
                    let request = transfer.request;
                    self.answered(request, &[], cycle);
                }
                _ if pipe == Pipe::In => self.stalled[0] = true,
                _ if pipe == Pipe::Out => self.stalled[1] = true,
                _ if pipe == Pipe::Notifications => self.stalled[2] = true,
                _ => self.work = HostTask::GivenUp,
            }
            return;
        }
        match pipe {
            Pipe::Control => self.finish_control(cycle, controller),
            Pipe::Notifications => {
                controller.take(number);
            }
            Pipe::In => {
                let (data1, data) = controller.take(number);
                // The wrong toggle: this packet was received before.
                if data1 == self.in_data1 {
                    self.in_data1 = !data1;
                    if !data.is_empty() {
                        observer.usb(cycle, &data);
                    }
                }
            }
            Pipe::Out => {
                let Some(endpoint) = self.port.data_out else { return };
                let data: Vec<u8> = self.out.drain(..self.packet(endpoint)).collect();
                controller.put(number, self.out_data1, &data);
                self.out_data1 = !self.out_data1;
            }
        }
    }

    fn finish_control(&mut self, cycle: u64, controller: &mut impl UsbDevice) {
        let HostTask::Control(transfer, _) = &mut self.work else { return };
        match transfer.token() {
            Token::Setup(packet) => {
                controller.setup(packet);
                transfer.sent();
            }
            Token::In => {
                let (data1, data) = controller.take(0);
                transfer.received(data1, &data);
            }
            Token::Out { data1, data } => {
                controller.put(0, data1, &data);
                transfer.sent();
            }
        }
        if transfer.is_done() {
            let (request, data) = (transfer.request, std::mem::take(&mut transfer.data));
            self.answered(request, &data, cycle);
        }
    }
}
