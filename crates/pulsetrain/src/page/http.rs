//! One request of a browser: its head, and whether it may be answered. It reads no socket.

use std::net::SocketAddr;

use super::Token;

/// The longest head of a request, bytes.
pub(super) const LONGEST_HEAD: usize = 8192;
/// The most headers of a request.
const MOST_HEADERS: usize = 64;

/// What a browser may want.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    /// A file of the page, by its path.
    File(String),
    /// The WebSocket, with its key.
    Socket { key: String },
}

/// A request that may be answered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Admitted {
    pub(super) wanted: Wanted,
    /// Whether the token came with the address. The answer then sets a cookie.
    pub(super) sets_cookie: bool,
    /// Whether only the head of the answer is wanted.
    pub(super) head_only: bool,
}

/// A request that is refused: the status of HTTP, and why, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct RefusedRequest {
    pub(super) status: u16,
    pub(super) why: String,
}

fn refuse<T>(status: u16, why: impl Into<String>) -> Result<T, RefusedRequest> {
    Err(RefusedRequest { status, why: why.into() })
}

/// How many of these bytes are the head of a request, if they hold all of it.
pub(super) fn head_len(bytes: &[u8]) -> Option<usize> {
    let ends = |end: &[u8]| bytes.windows(end.len()).position(|window| window == end).map(|place| place + end.len());
    ends(b"\r\n\r\n").into_iter().chain(ends(b"\n\n")).min()
}

/// The name of the cookie that has the token. Cookies know no ports, so the name has it.
pub(super) fn cookie_name(address: SocketAddr) -> String {
    format!("pulsetrain-{}", address.port())
}

/// Reads the head of a request that came to `address`, and says whether it may be answered.
pub(super) fn admit(head: &[u8], address: SocketAddr, token: Option<&Token>) -> Result<Admitted, RefusedRequest> {
    let mut headers = [httparse::EMPTY_HEADER; MOST_HEADERS];
    let mut request = httparse::Request::new(&mut headers);
    match request.parse(head) {
        Ok(httparse::Status::Complete(_)) => {}
        Ok(httparse::Status::Partial) => return refuse(400, "the request has no end"),
        Err(httparse::Error::TooManyHeaders) => {
            return refuse(431, format!("a request has {MOST_HEADERS} headers at most"));
        }
        Err(error) => return refuse(400, format!("this is no request of HTTP: {error}")),
    }
    let head = Head { headers: request.headers };
    // 1. It was sent to this address, not to a name that leads here.
    let host = head.only("Host")?.unwrap_or_default();
    if !is_host(host, address) {
        return refuse(421, format!("this page is at http://{}/: open it by that address", written(address)));
    }
    // 2. It comes from this page, or from no page.
    let path_and_query = request.path.unwrap_or_default();
    let (path, query) = path_and_query.split_once('?').unwrap_or((path_and_query, ""));
    let origin = head.only("Origin")?;
    if origin.is_some_and(|origin| !is_origin(origin, host)) {
        return refuse(403, "another site may not use this page");
    }
    let site = head.only("Sec-Fetch-Site")?;
    // A link elsewhere may lead to the page itself.
    if site.is_some_and(|site| site != "same-origin" && site != "none") && path != "/" {
        return refuse(403, "another site may not use this page");
    }
    // 3. Nothing is changed by a request.
    let head_only = match request.method {
        Some("GET") => false,
        Some("HEAD") => true,
        _ => return refuse(405, "requests only read: commands come by the WebSocket"),
    };
    // 4. It has the token.
    let mut sets_cookie = false;
    if let Some(token) = token {
        let name = cookie_name(address);
        let cookies = head.all("Cookie").flat_map(|cookies| cookies.split(';'));
        let mut values = cookies.filter_map(|cookie| cookie.trim().strip_prefix(&*name)?.strip_prefix('='));
        let in_query = query.split('&').filter_map(|part| part.strip_prefix("token="));
        sets_cookie = path == "/" && in_query.clone().any(|value| token.is(value));
        if !sets_cookie && !values.any(|value| token.is(value)) {
            return refuse(401, "open the address that pulsetrain has printed, with its token");
        }
    }
    if path != "/socket" {
        return Ok(Admitted { wanted: Wanted::File(path.to_owned()), sets_cookie, head_only });
    }
    // 5. A WebSocket says where it comes from.
    if origin.is_none() {
        return refuse(403, "a WebSocket must have an Origin");
    }
    let is_upgrade = |name: &str, wanted: &str| {
        head.all(name).flat_map(|value| value.split(',')).any(|value| value.trim().eq_ignore_ascii_case(wanted))
    };
    let key = head.only("Sec-WebSocket-Key")?;
    if head_only || !is_upgrade("Upgrade", "websocket") || !is_upgrade("Connection", "upgrade") {
        return refuse(426, "this is a WebSocket");
    }
    match (key, head.only("Sec-WebSocket-Version")?) {
        (Some(key), Some("13")) => {
            Ok(Admitted { wanted: Wanted::Socket { key: key.to_owned() }, sets_cookie, head_only })
        }
        _ => refuse(426, "this is a WebSocket of version 13"),
    }
}

struct Head<'h> {
    headers: &'h [httparse::Header<'h>],
}

impl<'h> Head<'h> {
    fn all(&self, name: &str) -> impl Iterator<Item = &'h str> {
        let named = self.headers.iter().filter(move |header| header.name.eq_ignore_ascii_case(name));
        // What is no text is no value that is looked for.
        named.map(|header| std::str::from_utf8(header.value).unwrap_or("?").trim())
    }

    /// The value of a header that comes once at most.
    fn only(&self, name: &str) -> Result<Option<&'h str>, RefusedRequest> {
        let mut all = self.all(name);
        match (all.next(), all.next()) {
            (value, None) => Ok(value),
            _ => refuse(400, format!("the request has several headers {name}")),
        }
    }
}

/// An address as a browser writes it.
pub(super) fn written(address: SocketAddr) -> String {
    let address = SocketAddr::new(address.ip().to_canonical(), address.port());
    if address.port() == 80 { host_of(address) } else { address.to_string() }
}

fn host_of(address: SocketAddr) -> String {
    if address.is_ipv6() { format!("[{}]", address.ip()) } else { address.ip().to_string() }
}

/// Whether a header `Host` names the address at which the connection came.
fn is_host(host: &str, address: SocketAddr) -> bool {
    let canonical = SocketAddr::new(address.ip().to_canonical(), address.port());
    let names = [Some(host_of(canonical)), canonical.ip().is_loopback().then(|| "localhost".to_owned())];
    names.into_iter().flatten().any(|name| {
        let with_port = format!("{name}:{}", address.port());
        host.eq_ignore_ascii_case(&with_port) || address.port() == 80 && host.eq_ignore_ascii_case(&name)
    })
}

/// Whether an origin is the page at `host`.
fn is_origin(origin: &str, host: &str) -> bool {
    origin.strip_prefix("http://").is_some_and(|origin| origin.eq_ignore_ascii_case(host))
}

#[cfg(test)]
mod tests {
    use super::*;

    proptest::proptest! {
        /// Whatever comes, there is an answer, and only those get in who name this address.
        #[test]
        fn any_bytes_have_an_answer(parts in proptest::collection::vec(0..PARTS.len(), 0..12), noise: Vec<u8>) {
            let mut head: Vec<u8> = parts.iter().flat_map(|part| PARTS[*part].bytes()).collect();
            head.extend(noise);
            let names = |text: &str| head.to_ascii_lowercase().windows(text.len()).any(|part| part == text.as_bytes());
            if admit(&head, address(), None).is_ok() {
                assert!(names("host: 127.0.0.1:8016") || names("host:127.0.0.1:8016"));
            }
            assert!(head_len(&head).is_none_or(|len| len <= head.len()));
        }
    }

    const PARTS: [&str; 10] = [
        "GET / HTTP/1.1\r\n",
        "GET /socket HTTP/1.1\r\n",
        "POST / HTTP/1.1\r\n",
        "Host: 127.0.0.1:8016\r\n",
        "Host: evil.example\r\n",
        "Origin: http://127.0.0.1:8016\r\n",
        "Origin: null\r\n",
        "Connection: upgrade\r\nUpgrade: websocket\r\n",
        "\r\n",
        "Cookie: =;=\r\n",
    ];

    fn address() -> SocketAddr {
        "127.0.0.1:8016".parse().unwrap()
    }

    #[track_caller]
    fn check(lines: &[&str], token: Option<&Token>, expected: Result<&str, u16>) {
        let head = lines.join("\r\n") + "\r\n\r\n";
        assert_eq!(head_len(head.as_bytes()), Some(head.len()));
        match (admit(head.as_bytes(), address(), token), expected) {
            (Ok(Admitted { wanted: Wanted::File(path), .. }), Ok(expected)) => assert_eq!(path, expected),
            (Ok(Admitted { wanted: Wanted::Socket { key }, .. }), Ok(expected)) => assert_eq!(key, expected),
            (Err(refused), Err(status)) => assert_eq!(refused.status, status, "{refused:?}"),
            (read, _) => panic!("{lines:?}: {read:?}, not {expected:?}"),
        }
    }

    #[test]
    fn only_this_address_and_this_page_get_an_answer() {
        let host = "Host: 127.0.0.1:8016";
        check(&["GET / HTTP/1.1", host], None, Ok("/"));
        check(&["GET / HTTP/1.1", "host: LOCALHOST:8016"], None, Ok("/"));
        for wrong in
            ["Host: 127.0.0.1", "Host: evil.example:8016", "Host: 127.0.0.1:8017", "Host: 192.168.0.7:8016", "X: y"]
        {
            check(&["GET / HTTP/1.1", wrong], None, Err(421));
        }
        check(&["GET / HTTP/1.1", host, host], None, Err(400));
        for wrong in
            ["http://evil.example", "null", "https://127.0.0.1:8016", "http://127.0.0.1:80", "http://localhost:8016"]
        {
            check(&["GET /page.js HTTP/1.1", host, &format!("Origin: {wrong}")], None, Err(403));
        }
        check(&["GET /page.js HTTP/1.1", host, "Origin: http://127.0.0.1:8016"], None, Ok("/page.js"));
        check(&["GET /log.jsonl HTTP/1.1", host, "Sec-Fetch-Site: cross-site"], None, Err(403));
        check(&["GET / HTTP/1.1", host, "Sec-Fetch-Site: cross-site"], None, Ok("/"));
        for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
            check(&[&format!("{method} / HTTP/1.1"), host], None, Err(405));
        }
        check(&["HELO", host], None, Err(400));
    }

    #[test]
    fn the_web_socket_needs_an_origin() {
        let head = |origin: &'static str| {
            let upgrade = ["Upgrade: websocket", "Connection: keep-alive, Upgrade", "Sec-WebSocket-Version: 13"];
            let first = ["GET /socket HTTP/1.1", "Host: 127.0.0.1:8016", "Sec-WebSocket-Key: abc"];
            [&first[..], &upgrade, &[origin]].concat()
        };
        check(&head("Origin: http://127.0.0.1:8016"), None, Ok("abc"));
        check(&head("Origin: http://evil.example"), None, Err(403));
        check(&head("X: no origin"), None, Err(403));
        check(&["GET /socket HTTP/1.1", "Host: 127.0.0.1:8016", "Origin: http://127.0.0.1:8016"], None, Err(426));
    }

    #[test]
    fn on_the_network_all_need_the_token() {
        let token = Token::random().unwrap();
        let host = "Host: 127.0.0.1:8016";
        let cookie = format!("Cookie: a=b; pulsetrain-8016={}", token.text());
        check(&["GET /page.js HTTP/1.1", host, &cookie], Some(&token), Ok("/page.js"));
        check(&["GET /page.js HTTP/1.1", host], Some(&token), Err(401));
        check(&["GET / HTTP/1.1", host, "Cookie: pulsetrain-8016="], Some(&token), Err(401));
        let other = cookie.replace("8016=", "8017=");
        check(&["GET / HTTP/1.1", host, &other], Some(&token), Err(401));
        // Only the page itself takes it from the address.
        let query = format!("?token={}", token.text());
        check(&[&format!("GET /{query} HTTP/1.1"), host], Some(&token), Ok("/"));
        check(&[&format!("GET /page.js{query} HTTP/1.1"), host], Some(&token), Err(401));
        check(&[&format!("GET /{query}0 HTTP/1.1"), host], Some(&token), Err(401));
    }

    #[test]
    fn addresses_are_written_as_browsers_do() {
        let check = |address: &str, host: &str| {
            let address = address.parse().unwrap();
            assert_eq!(written(address), host);
            assert!(is_host(host, address), "{host}");
        };
        check("192.168.0.7:80", "192.168.0.7");
        check("[::1]:8016", "[::1]:8016");
        check("[::ffff:192.168.0.7]:8016", "192.168.0.7:8016");
    }
}
