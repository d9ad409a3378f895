//! Open Sound Control (OSC 1.0) over UDP: what TouchDesigner, Max, QLab and phones send becomes [`RunCommand`]s of a live motion.
//!
//! # What is here, top down
//! - [`serve_osc`]: all of it, as a client of a motion's hub
//! - [`OscServer`]: the UDP socket with its threads. It never waits for the motion, nor the motion for it
//! - [`Translator`]: packets to groups of requests, and what happens to the motion to replies; no socket, no clock of its own
//! - [`Agenda`]: groups that wait for their time
//! - `address`: what an OSC address and its arguments ask for; `time_tag`: times of bundles on the host's clock
//!
//! # What is not
//! It does not know the motion: whoever opens the server passes the groups on, and tells the server what happens. docs/osc.md has the addresses for
//! users.

mod address;
mod agenda;
mod client;
mod server;
mod time_tag;
mod translator;

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Instant, SystemTime};

use miette::Diagnostic;

use crate::live::MotorInfo;
use crate::live::{KnobInfo, RunCommand};

pub use agenda::{Agenda, MOST_PLANNED};
pub use client::{serve_osc, serve_osc_on};
pub use server::{OscCounts, OscServer, listen};
pub use translator::{OscReply, Translation, Translator};

/// The longest packet, bytes. Longer ones are refused.
pub const LONGEST_PACKET: usize = 4096;

/// What the translator knows of a motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OscInfo {
    /// The motors, in the file's order: motor 1 is the first.
    pub motors: Vec<MotorInfo>,
    /// The knobs: those of `[live.knobs]`, and the parameters MOTOR.PARAMETER.
    pub knobs: Vec<KnobInfo>,
}

/// Where the server listens and answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OscSettings {
    /// Where it listens.
    pub address: SocketAddr,
    /// The port to which clients are answered. `None`: the port from which they send.
    pub reply_port: Option<u16>,
}

/// Requests that belong together: they act on one tick of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// In the order in which they were sent; at least one.
    pub requests: Vec<RunCommand>,
    /// When they are to act.
    pub due: Instant,
    /// Who sent them for that time, and hears if they act later; `None` if they are to act at once.
    pub sender: Option<SocketAddr>,
}

/// The host's clocks at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// For what is due.
    pub instant: Instant,
    /// What the time tags of bundles are compared with.
    pub system: SystemTime,
}

impl Now {
    /// Reads the host's clocks.
    #[must_use]
    pub fn read() -> Now {
        Now { instant: Instant::now(), system: SystemTime::now() }
    }
}

/// Where a server itself is: answers never go there, and what comes from there is no order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OwnAddress(pub SocketAddr);

impl OwnAddress {
    /// Whether packets to an address come to this server, or those from it are its own.
    #[must_use]
    pub fn is(&self, other: SocketAddr) -> bool {
        let (own, other_ip) = (self.0.ip().to_canonical(), other.ip().to_canonical());
        // An address to which a socket can be bound is one of this computer.
        let is_here = || other_ip.is_unspecified() || UdpSocket::bind((other_ip, 0)).is_ok();
        self.0.port() == other.port() && (own == other_ip || (own.is_unspecified() && is_here()))
    }
}

/// Why there is no OSC.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum OscError {
    /// The address to listen at cannot be read.
    #[error("`{text}` is no address to listen at")]
    #[diagnostic(help(
        "write a port, such as 9000, for programs of this computer; or 192.168.1.20:9000, the address of this computer in the network where \
         the other programs are; 0.0.0.0:9000 is all networks"
    ))]
    Address {
        /// What was written.
        text: String,
    },
    /// The system does not give the port.
    #[error("OSC cannot listen at {address}: {why}")]
    #[diagnostic(help(
        "another program may have the port, or the address is not one of this computer: choose another port or address"
    ))]
    Listen {
        /// The address.
        address: SocketAddr,
        /// The system's reason.
        why: std::io::Error,
    },
    /// The system does not start a thread.
    #[error("OSC cannot start a thread: {0}")]
    Thread(std::io::Error),
}

/// The address of `[ADDR:]PORT`: without ADDR, that of this computer alone.
///
/// ```
/// use pulsetrain::osc::listen_address;
/// assert_eq!(listen_address("9000").unwrap().to_string(), "127.0.0.1:9000");
/// assert_eq!(listen_address("0.0.0.0:9000").unwrap().to_string(), "0.0.0.0:9000");
/// assert_eq!(listen_address("[::1]:9000").unwrap().to_string(), "[::1]:9000");
/// assert!(listen_address("localhost").is_err() && listen_address("70000").is_err());
/// ```
///
/// # Errors
/// [`OscError::Address`] if it is none. Names are not looked up.
pub fn listen_address(text: &str) -> Result<SocketAddr, OscError> {
    let port = text.parse::<u16>().map(|port| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    port.ok().or_else(|| text.parse().ok()).ok_or_else(|| OscError::Address { text: text.to_owned() })
}
