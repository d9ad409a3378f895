//! A page in the browser for a motion that runs: `pulsetrain serve`, and `live --page`.
//!
//! [`serve`] answers browsers at a listener. The page's files are in this program, so that no network is needed. The page
//! speaks the lines of the control socket over a WebSocket, and is a client of the run's [`Hub`]: it never delays a step.
//!
//! # What is here
//! - [`listen`] opens the listener; elsewhere than on this computer's own address it needs a [`Token`]
//! - `server`: connections, their limits, and the WebSocket; `http`: one request, and whether it may be answered
//! - `history`: the last ten minutes, for pages that come later
//!
//! # Who gets in
//! Every request needs a Host that is the address it came to, and an Origin of the same address if it has one; the WebSocket
//! must have one. So a page of another site, or a name that was made to lead here, gets nothing. Nothing changes by a
//! request; commands come by the WebSocket alone. Without a token only this computer itself is served.

use std::fmt::Write as _;
use std::io;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

use miette::Diagnostic;

use crate::control_socket::Hub;

mod history;
mod http;
mod server;

pub use server::Page;

/// The port of the page, if nobody names one.
pub const USUAL_PORT: u16 = 8016;

/// Where the page is, if nobody says where: this computer alone reaches it.
pub const USUAL_ADDRESS: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), USUAL_PORT);

/// 128 random bits that a browser must have to see a page on the network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    /// A new one, from the system's random numbers.
    ///
    /// # Errors
    /// If the system has none.
    pub fn random() -> Result<Token, PageError> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|error| PageError::Random { error: error.to_string() })?;
        Ok(Token(bytes.iter().fold(String::new(), |mut text, byte| {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
            text
        })))
    }

    /// Its 32 letters.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether a text is this token. The time that it takes says nothing of where they differ.
    fn is(&self, text: &str) -> bool {
        let differences = self.0.bytes().zip(text.bytes()).fold(0, |all, (one, other)| all | (one ^ other));
        text.len() == self.0.len() && differences == 0
    }
}

/// What a page has beside the hub.
#[derive(Clone, Debug, Default)]
pub struct PageOptions {
    /// The token that browsers must have; [`listen`] says whether there must be one.
    pub token: Option<Token>,
    /// The text of the motion file as it is in force, for the page's editor and for downloads. `live` changes it with the motion.
    pub motion: Arc<Mutex<String>>,
    /// The log of the motion, for downloads.
    pub log: Option<PathBuf>,
}

/// Reads where a page is to be, as users write it: an address with or without a port, or a port alone.
///
/// ```
/// use pulsetrain::page;
/// let check = |text: &str, expected: &str| assert_eq!(page::address(text).unwrap().to_string(), expected);
/// check("8017", "127.0.0.1:8017");
/// check("192.168.0.7", "192.168.0.7:8016");
/// check("0.0.0.0:80", "0.0.0.0:80");
/// check("::1", "[::1]:8016");
/// check("[::1]:80", "[::1]:80");
/// check("localhost", "127.0.0.1:8016");
/// let error = page::address("my-computer").unwrap_err();
/// assert_eq!(error.to_string(), "my-computer is no address of the form 192.168.0.7:8016");
/// ```
///
/// # Errors
/// If it is none of these.
pub fn address(text: &str) -> Result<SocketAddr, PageError> {
    let text = text.trim();
    let numbers = match text.strip_prefix("localhost") {
        Some(port) if port.is_empty() || port.starts_with(':') => format!("{}{port}", Ipv4Addr::LOCALHOST),
        _ => text.to_owned(),
    };
    let ip = numbers.trim_start_matches('[').trim_end_matches(']');
    if let Ok(address) = numbers.parse() {
        Ok(address)
    } else if let Ok(ip) = ip.parse() {
        Ok(SocketAddr::new(ip, USUAL_PORT))
    } else if let Ok(port) = text.parse() {
        Ok(SocketAddr::new(USUAL_ADDRESS.ip(), port))
    } else {
        Err(PageError::NoAddress { text: text.to_owned() })
    }
}

/// Opens the listener of a page. Elsewhere than at a loopback address there is a token with it.
///
/// # Errors
/// If the address cannot be used, or the system has no random numbers.
pub fn listen(address: SocketAddr) -> Result<(TcpListener, Option<Token>), PageError> {
    let listener = TcpListener::bind(address).map_err(|error| match error.kind() {
        io::ErrorKind::AddrInUse => PageError::Taken { address },
        _ => PageError::Address { address, error },
    })?;
    let token = if address.ip().is_loopback() { None } else { Some(Token::random()?) };
    Ok((listener, token))
}

/// Serves the page of a run, in threads of its own, until the value that it returns is dropped.
///
/// # Errors
/// If the listener is of a kind that has no address, if it is elsewhere than on this computer and there is no token, or if
/// the system has no more threads.
pub fn serve(hub: &Hub, listener: TcpListener, options: PageOptions) -> Result<Page, PageError> {
    let address = listener.local_addr().map_err(|error| PageError::Address { address: USUAL_ADDRESS, error })?;
    if options.token.is_none() && !address.ip().is_loopback() {
        return Err(PageError::NoToken { address });
    }
    Page::start(hub, listener, address, options)
}

/// Why there is no page.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum PageError {
    /// The user's text is no address.
    #[error("{text} is no address of the form 192.168.0.7:{USUAL_PORT}")]
    #[diagnostic(help("write an address of this computer in numbers, 0.0.0.0 for all of them, or a port alone"))]
    NoAddress {
        /// The text.
        text: String,
    },
    /// Another program has the port.
    #[error("another program listens at {address} already")]
    #[diagnostic(help("name another port, such as {}:{}; port 0 takes a free one", .address.ip(), .address.port().wrapping_add(1)))]
    Taken {
        /// The address.
        address: SocketAddr,
    },
    /// The address cannot be listened at.
    #[error("cannot listen at {address}: {error}")]
    #[diagnostic(help("it must be an address of this computer; 0.0.0.0 means all of them"))]
    Address {
        /// The address.
        address: SocketAddr,
        /// The system's error.
        error: io::Error,
    },
    /// A page that other computers reach must have a token.
    #[error("{address} can be reached by other computers, and there is no token")]
    NoToken {
        /// The address.
        address: SocketAddr,
    },
    /// There are no random numbers for the token.
    #[error("the system has no random numbers for the page's token: {error}")]
    Random {
        /// The system's error.
        error: String,
    },
    /// There is no thread for the page.
    #[error("cannot start a thread for the page: {error}")]
    Thread {
        /// The system's error.
        error: io::Error,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_random_and_is_itself_alone() {
        let (one, other) = (Token::random().unwrap(), Token::random().unwrap());
        assert!(one != other && one.text().len() == 32);
        assert!(one.is(one.text()) && !one.is(other.text()) && !one.is("") && !one.is(&one.text()[1..]));
        assert!(!one.is(&format!("{}0", one.text())));
    }
}
