//! A real serial port, in real time.
//!
//! A thread of its own reads, so that bytes have the time at which they came and none is lost while the host plans. This is
//! the one place of the library that reads the wall clock: everything else is told the time.

use crate::{Port, PortError};
use pulsetrain_core::wire::Baud;
use serialport::{ClearBuffer, ErrorKind, SerialPort, SerialPortType, StopBits};
use std::io::{self, Read};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// How soon the reading thread notices that the port is closed.
const READ_TIMEOUT: Duration = Duration::from_millis(50);

/// How long a write may take: the longest row of frames at 115 200 baud, several times over.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);

/// How long DTR is let go for a reset; an Uno's capacitor needs less than a millisecond.
const DTR_LOW: Duration = Duration::from_millis(20);

/// A serial port of this computer.
#[derive(Debug)]
pub struct Serial {
    name: String,
    port: Box<dyn SerialPort>,
    opened: Instant,
    bytes: Receiver<Vec<u8>>,
    /// Why the reading thread ended.
    broken: Arc<Mutex<Option<String>>>,
    closed: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl Serial {
    /// Opens a port at 115 200 baud, for nobody else.
    ///
    /// With `reset`, DTR is let go and taken up again: an Uno begins anew. (Most systems do that on opening anyway, so that
    /// without `reset` a board may still begin anew.)
    ///
    /// # Errors
    /// When there is no such port, it is in use, or the user may not open it; each says what to do.
    pub fn open(name: &str, reset: bool) -> Result<Serial, PortError> {
        Serial::open_at(name, reset, Baud::B115200.rate())
    }

    /// The same at any rate, bits a second.
    ///
    /// # Errors
    /// As [`open`](Serial::open).
    pub fn open_at(name: &str, reset: bool, rate: u32) -> Result<Serial, PortError> {
        let builder = serialport::new(name, rate).timeout(READ_TIMEOUT);
        let builder = if reset { builder.dtr_on_open(false) } else { builder };
        let mut port = builder.open().map_err(|error| refused(name, &error))?;
        if reset {
            // Some adapters have the capacitor at RTS. A pseudo-terminal has neither, and needs none.
            let _ = port.write_request_to_send(false);
            thread::sleep(DTR_LOW);
            let _ = port.write_data_terminal_ready(true);
            let _ = port.write_request_to_send(true);
        }
        // What came before belongs to nobody; a pseudo-terminal may not know how to drop it.
        let _ = port.clear(ClearBuffer::Input);
        let mut input = port.try_clone().map_err(|error| refused(name, &error))?;
        port.set_timeout(WRITE_TIMEOUT).map_err(|error| refused(name, &error))?;

        let (to_host, bytes) = channel();
        let (broken, closed) = (Arc::new(Mutex::new(None)), Arc::new(AtomicBool::new(false)));
        let (why, until) = (Arc::clone(&broken), Arc::clone(&closed));
        let reader = thread::Builder::new()
            .name("serial port".into())
            .spawn(move || {
                if let Err(error) = read(&mut *input, &to_host, &until) {
                    *why.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(error.to_string());
                }
            })
            .map_err(|error| PortError::Gone { name: name.to_owned(), why: error.to_string() })?;
        let reader = Some(reader);
        Ok(Serial { name: name.to_owned(), port, opened: Instant::now(), bytes, broken, closed, reader })
    }

    fn gone(&self, why: impl ToString) -> PortError {
        PortError::Gone { name: self.name.clone(), why: why.to_string() }
    }

    fn why_broken(&self) -> PortError {
        let broken = self.broken.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        self.gone(broken.as_deref().unwrap_or("it was closed"))
    }
}

/// Reads until the port is closed, or gone.
fn read(input: &mut dyn Read, to_host: &Sender<Vec<u8>>, closed: &AtomicBool) -> io::Result<()> {
    let mut buffer = [0; 1024];
    while !closed.load(Ordering::Relaxed) {
        match input.read(&mut buffer) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            // Nobody listens any more.
            Ok(len) if to_host.send(buffer[..len].to_vec()).is_err() => return Ok(()),
            Ok(_) => {}
            Err(error) if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

impl Drop for Serial {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Relaxed);
        if let Some(reader) = self.reader.take() {
            // It ends within READ_TIMEOUT; what it has to say has been said.
            let _ = reader.join();
        }
    }
}

impl Port for Serial {
    fn now(&self) -> Duration {
        self.opened.elapsed()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.port.write_all(bytes).map_err(|error| self.gone(error))
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        // An hour is as good as for ever: the caller comes again.
        let wait = until.saturating_sub(self.now()).min(Duration::from_secs(3600));
        match self.bytes.recv_timeout(wait) {
            Ok(bytes) => into.extend(bytes),
            Err(RecvTimeoutError::Timeout) => return Ok(()),
            Err(RecvTimeoutError::Disconnected) => return Err(self.why_broken()),
        }
        into.extend(self.bytes.try_iter().flatten());
        Ok(())
    }

    fn set_baud(&mut self, baud: Baud) -> Result<(), PortError> {
        // Until the last byte is out of the computer; a bridge may still have some, and changes after them.
        self.port.flush().map_err(|error| self.gone(error))?;
        let stop_bits = if baud.stop_bits() == 2 { StopBits::Two } else { StopBits::One };
        self.port.set_stop_bits(stop_bits).map_err(|error| self.gone(error))?;
        self.port.set_baud_rate(baud.rate()).map_err(|error| self.gone(error))
    }
}

/// How often it is looked whether something has become of a device.
const LOOK: Duration = Duration::from_millis(50);

/// Whether something becomes of a device that is plugged in, such as that it goes away, within that time of the wall clock; looked
/// for every 50 ms.
pub fn happens(within: Duration, mut has: impl FnMut() -> bool) -> bool {
    let looks = within.as_millis() / LOOK.as_millis();
    (0..=looks).any(|_| {
        let has = has();
        if !has {
            thread::sleep(LOOK);
        }
        has
    })
}

/// The names of the serial ports that this computer has.
#[must_use]
pub fn names() -> Vec<String> {
    list().into_iter().map(|port| port.name).collect()
}

/// A serial port of this computer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// What [`Serial::open`] takes.
    pub name: String,
    /// What its USB device says of itself, if it has one.
    pub usb: Option<Usb>,
}

/// What a USB device says of itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Usb {
    /// Vendor.
    pub vendor: u16,
    /// Product of that vendor.
    pub product: u16,
    /// The product's name.
    pub name: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
}

/// The serial ports that this computer has, by name. Nothing is opened.
#[must_use]
pub fn list() -> Vec<Listed> {
    // Without that folder, as in some containers, the library panics.
    if cfg!(target_os = "linux") && !std::path::Path::new("/sys/class/tty").exists() {
        return Vec::new();
    }
    let ports = serialport::available_ports().unwrap_or_default().into_iter().map(|port| {
        let usb = match port.port_type {
            SerialPortType::UsbPort(usb) => {
                Some(Usb { vendor: usb.vid, product: usb.pid, name: usb.product, serial: usb.serial_number })
            }
            _ => None,
        };
        Listed { name: port.port_name, usb }
    });
    let mut ports: Vec<Listed> = ports.collect();
    ports.sort_by(|a, b| a.name.cmp(&b.name));
    ports
}

/// What an error on opening means.
fn refused(name: &str, error: &serialport::Error) -> PortError {
    let name = name.to_owned();
    match error.kind() {
        // Windows says of a port in use that access is denied, and has no permissions on ports.
        ErrorKind::Io(io::ErrorKind::PermissionDenied) if cfg!(windows) => PortError::Busy { name },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => PortError::Denied { name },
        ErrorKind::Io(io::ErrorKind::NotFound) => PortError::NotThere { name, there_are: names() },
        // Also what a port in use gives, which is there.
        ErrorKind::NoDevice if std::path::Path::new(&name).exists() => PortError::Busy { name },
        ErrorKind::NoDevice => PortError::NotThere { name, there_are: names() },
        ErrorKind::InvalidInput | ErrorKind::Unknown | ErrorKind::Io(_) => {
            PortError::Unusable { name, why: error.to_string() }
        }
    }
}
