//! A real serial port, in real time.
//!
//! A separate thread reads, so that no byte is lost while the host plans. This is the only place of the library that reads the wall clock:
//! everything else gets the time as an argument.

use crate::{Port, PortError};
use pulsetrain_core::wire::Baud;
use serialport::{ClearBuffer, ErrorKind, SerialPort, SerialPortType, StopBits};
use std::io::{self, Read};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

/// Longest wait of a read: how long the reading thread may take to notice that the port was closed.
const READ_TIMEOUT: Duration = Duration::from_millis(50);

/// How long a write may take: several times what all unconfirmed frames take at 115 200 baud.
const WRITE_TIMEOUT: Duration = Duration::from_secs(2);

/// How long DTR is off for a reset. An Uno's capacitor needs less than a millisecond; some adapters are slower.
const DTR_LOW: Duration = Duration::from_millis(20);

/// A serial port of this computer.
#[derive(Debug)]
pub struct Serial {
    name: String,
    port: Box<dyn SerialPort>,
    opened: Instant,
    bytes: Receiver<Vec<u8>>,
    /// Why the reading thread ended; `None` while it reads.
    broken: Arc<Mutex<Option<String>>>,
    closed: Arc<AtomicBool>,
    reader: Option<JoinHandle<()>>,
}

impl Serial {
    /// Opens a port at 115 200 baud, for this program alone.
    ///
    /// With `reset`, DTR is switched off and on, which restarts an Uno. (Most systems do that on opening anyway, so that a board may restart without
    /// `reset` too.)
    ///
    /// # Errors
    /// When there is no such port, it is in use, or the user may not open it. Each error says what to do.
    pub fn open(name: &str, reset: bool) -> Result<Serial, PortError> {
        Serial::open_at(name, reset, Baud::B115200.rate())
    }

    /// As [`open`](Serial::open), at any rate, bits a second.
    ///
    /// # Errors
    /// As [`open`](Serial::open).
    pub fn open_at(name: &str, reset: bool, rate: u32) -> Result<Serial, PortError> {
        let builder = serialport::new(name, rate).timeout(READ_TIMEOUT);
        let builder = if reset { builder.dtr_on_open(false) } else { builder };
        let mut port = builder.open().map_err(|error| refused(name, &error))?;
        if reset {
            // Some adapters have the capacitor at RTS. Errors are ignored: a pseudo-terminal has neither line.
            let _ = port.write_request_to_send(false);
            thread::sleep(DTR_LOW);
            let _ = port.write_data_terminal_ready(true);
            let _ = port.write_request_to_send(true);
        }
        // Bytes from before the opening are no answers. A pseudo-terminal may not be able to drop them: errors are ignored.
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

/// Reads until the port is closed or gone, and sends the bytes to the host's thread.
fn read(input: &mut dyn Read, to_host: &Sender<Vec<u8>>, closed: &AtomicBool) -> io::Result<()> {
    let mut buffer = [0; 1024];
    while !closed.load(Ordering::Relaxed) {
        match input.read(&mut buffer) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            // The receiver was dropped with the port.
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
            // The thread ends within READ_TIMEOUT, and its error is in `broken`.
            let _ = reader.join();
        }
    }
}

impl Port for Serial {
    fn has_edges(&self) -> bool {
        false
    }

    fn now(&self) -> Duration {
        self.opened.elapsed()
    }

    fn send(&mut self, bytes: &[u8]) -> Result<(), PortError> {
        self.port.write_all(bytes).map_err(|error| self.gone(error))
    }

    fn receive(&mut self, until: Duration, into: &mut Vec<u8>) -> Result<(), PortError> {
        // At most an hour, as some systems cannot wait for longer; the caller tries again.
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
        // Wait until the last byte is out of the computer. A USB bridge sends those that it has before it changes its rate.
        self.port.flush().map_err(|error| self.gone(error))?;
        let stop_bits = if baud.stop_bits() == 2 { StopBits::Two } else { StopBits::One };
        self.port.set_stop_bits(stop_bits).map_err(|error| self.gone(error))?;
        self.port.set_baud_rate(baud.rate()).map_err(|error| self.gone(error))
    }
}

/// How often [`happens`] looks again.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Whether `has` returns true within a time of the wall clock; it is called every 50 ms. For instance, whether a device is unplugged or appears.
pub fn happens(within: Duration, mut has: impl FnMut() -> bool) -> bool {
    let looks = within.as_millis() / LOOK_EVERY.as_millis();
    (0..=looks).any(|_| {
        let has = has();
        if !has {
            thread::sleep(LOOK_EVERY);
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
    /// The identity of its USB device; `None` if it is no USB device.
    pub usb: Option<Usb>,
}

/// The identity that a USB device reports.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Usb {
    /// Vendor ID.
    pub vendor: u16,
    /// Product ID.
    pub product: u16,
    /// The product's name.
    pub name: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
}

/// The serial ports of this computer, sorted by name. No port is opened.
#[must_use]
pub fn list() -> Vec<Listed> {
    // The serialport library panics without that folder, which some containers do not have.
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

/// The system's words for a file that is no port, in words that say so; other texts without the error's number.
fn unusable(text: &str) -> String {
    let no_port = ["not a typewriter", "inappropriate ioctl", "is a directory"];
    if no_port.iter().any(|system| text.to_lowercase().starts_with(system)) {
        return "it is a file or a device of another kind".to_owned();
    }
    text.split(" (os error").next().unwrap_or_default().to_owned()
}

/// The meaning of an error on opening a port.
fn refused(name: &str, error: &serialport::Error) -> PortError {
    let name = name.to_owned();
    match error.kind() {
        // Windows reports a port that is in use as access denied. It has no permissions on ports.
        ErrorKind::Io(io::ErrorKind::PermissionDenied) if cfg!(windows) => PortError::Busy { name },
        ErrorKind::Io(io::ErrorKind::PermissionDenied) => PortError::Denied { name },
        ErrorKind::Io(io::ErrorKind::NotFound) => PortError::NotThere { name, there_are: names() },
        // A port that is in use may give this error too, but its file exists.
        ErrorKind::NoDevice if std::path::Path::new(&name).exists() => PortError::Busy { name },
        ErrorKind::NoDevice => PortError::NotThere { name, there_are: names() },
        ErrorKind::InvalidInput | ErrorKind::Unknown | ErrorKind::Io(_) => {
            PortError::Unusable { name, why: unusable(&error.to_string()) }
        }
    }
}
