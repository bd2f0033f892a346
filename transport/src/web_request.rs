//! Requests for sessions of WebTransport: origins, answers.
//!
//! The browser names the page's origin in its request, and no page can change that. A client that is no browser names
//! none and is let in: a token decides about it.
//!
//! The kept codec knows the name that sessions have in drafts up to 14. Those after it have another, which this file
//! replaces; it reads the fields of a request only as far as that needs. A refused request is answered by a status.

use std::fmt;
use std::net::IpAddr;
use std::str::FromStr;

use quinn::{RecvStream, SendStream};
use tokio::io::{AsyncReadExt, copy, sink};
use web_transport_proto::http::StatusCode;
use web_transport_proto::http::header::ORIGIN;
use web_transport_proto::{ConnectError, ConnectRequest, ConnectResponse, Frame, VarInt};

/// The path that a client requests: it names the protocol, as the ALPN name does elsewhere.
const WEB_PATH: &str = "/rhumb/1";

/// The protocol by its name of ALPN, for a client that lists what it speaks.
const WEB_PROTOCOL: &str = "rhumb/1";

/// Bytes of a request's fields, as this end's settings state them.
const FIELDS_BYTES_MAX: u64 = 16 << 10;

/// Bytes of a frame that is passed over.
const FRAME_BYTES_MAX: u64 = 64 << 10;

/// The field that names what a request opens, and the names of a session: up to draft 14, and from draft 15.
const PROTOCOL: Word = Word {
    plain: b":protocol",
    packed: &[0xb9, 0x5d, 0x87, 0x49, 0xc8, 0x7a, 0x3f],
};
const EARLIER_SESSION: &[u8] = b"webtransport";
const LATER_SESSION: Word = Word {
    plain: b"webtransport-h3",
    packed: &[
        0xf0, 0x58, 0xd3, 0x60, 0xea, 0x45, 0x67, 0xb1, 0x2b, 0x4e, 0xcf,
    ],
};

/// The field in which a client lists what it speaks.
const AVAILABLE: Word = Word {
    plain: b"wt-available-protocols",
    packed: &[
        0xf0, 0x95, 0x87, 0xdc, 0x66, 0xa0, 0x71, 0xd0, 0x55, 0xab, 0xb0, 0xe9, 0x39, 0x0f, 0x42,
        0x3f,
    ],
};

/// Reason why a connection with HTTP/3 has no session.
#[derive(Debug)]
pub(crate) enum WebRefusal {
    /// The peer does not speak HTTP/3 as it should, or was lost.
    Handshake(String),
    /// The request is for something else than a session of this protocol.
    Request {
        /// The answer.
        status: StatusCode,
        /// The defect.
        cause: String,
    },
    /// The page's origin is not allowed.
    Origin(String),
}

impl WebRefusal {
    /// The answer; `None` if no request came.
    pub(crate) const fn status(&self) -> Option<StatusCode> {
        match self {
            Self::Handshake(_) => None,
            Self::Request { status, .. } => Some(*status),
            Self::Origin(_) => Some(StatusCode::FORBIDDEN),
        }
    }

    /// The origin that is not allowed.
    pub(crate) fn foreign_origin(&self) -> Option<&str> {
        match self {
            Self::Origin(origin) => Some(origin),
            Self::Handshake(_) | Self::Request { .. } => None,
        }
    }
}

impl fmt::Display for WebRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Handshake(cause) => cause.fmt(f),
            Self::Request { status, cause } => write!(f, "{cause}: answered by {status}"),
            Self::Origin(origin) => write!(f, "the origin {origin:?} is not allowed"),
        }
    }
}

pub(crate) fn broken(cause: impl fmt::Display) -> WebRefusal {
    WebRefusal::Handshake(cause.to_string())
}

/// A request of this client is malformed, or wants something that this server has not.
pub(crate) fn refused(status: StatusCode, cause: impl fmt::Display) -> WebRefusal {
    WebRefusal::Request {
        status,
        cause: cause.to_string(),
    }
}

/// A request for a session.
#[derive(Debug)]
pub(crate) struct WebRequest {
    /// The requested path, and the page's origin.
    pub(crate) connect: ConnectRequest,
    /// The name that it gives to sessions.
    pub(crate) protocol: &'static str,
}

/// Reads a request for a session.
pub(crate) async fn read_request(stream: &mut RecvStream) -> Result<WebRequest, WebRefusal> {
    let fields = read_fields(stream).await?;
    let request = match decode(&fields) {
        // A list of protocols that cannot be read counts as none (draft 16, section 3.3).
        Err(ConnectError::InvalidProtocol | ConnectError::StructuredFieldError(_)) => {
            decode(&without(&fields, &AVAILABLE))
        }
        request => request,
    };
    request.map_err(|cause| {
        let status = match &cause {
            ConnectError::WrongMethod(_) => StatusCode::METHOD_NOT_ALLOWED,
            // RFC 9220, section 3.
            ConnectError::WrongProtocol(Some(_)) => StatusCode::NOT_IMPLEMENTED,
            ConnectError::FieldSectionTooLarge => StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE,
            _ => StatusCode::BAD_REQUEST,
        };
        refused(status, cause)
    })
}

/// The answer to a request, if it is for a session of this protocol and from a page that may have one.
pub(crate) fn answer(
    request: &ConnectRequest,
    origins: &Origins,
) -> Result<ConnectResponse, WebRefusal> {
    if request.url.path() != WEB_PATH {
        let path = request.url.path();
        let cause = format!("the page asks for {path:?}, not for {WEB_PATH}");
        return Err(refused(StatusCode::NOT_FOUND, cause));
    }
    // Bytes that are no text are no origin that could be allowed.
    let origin = (request.headers.get(ORIGIN)).map(|origin| origin.to_str().unwrap_or("?"));
    if !origins.allows(origin) {
        return Err(WebRefusal::Origin(origin.unwrap_or_default().to_owned()));
    }
    let lists_it = (request.protocols.iter()).any(|protocol| protocol == WEB_PROTOCOL);
    Ok(match lists_it {
        true => ConnectResponse::OK.with_protocol(WEB_PROTOCOL),
        false => ConnectResponse::OK,
    })
}

/// Answers a request that is refused, and finishes its stream.
pub(crate) async fn refuse(stream: &mut SendStream, status: StatusCode) {
    // A client that is gone needs no answer.
    if ConnectResponse::new(status).write(stream).await.is_ok() {
        let _ = stream.finish();
    }
}

/// The fields of the first request on a stream; frames that are none of HTTP/3's own are passed over.
async fn read_fields(stream: &mut RecvStream) -> Result<Vec<u8>, WebRefusal> {
    loop {
        let frame = Frame(VarInt::read(stream).await.map_err(broken)?);
        let bytes = VarInt::read(stream).await.map_err(broken)?.into_inner();
        match frame.0.into_inner() {
            0x01 if bytes <= FIELDS_BYTES_MAX => {
                let mut fields = Vec::new();
                let read = stream.take(bytes).read_to_end(&mut fields).await;
                return match read.map_err(broken)? as u64 == bytes {
                    true => Ok(fields),
                    false => Err(broken("the request was cut off")),
                };
            }
            0x01 => {
                let cause = format!("fields of {bytes} bytes, above {FIELDS_BYTES_MAX}");
                let status = StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE;
                return Err(refused(status, cause));
            }
            // Frames of HTTP/3 that cannot begin a request, frames of HTTP/2, and a stream of a session.
            frame @ (0x00..=0x09 | 0x0d | 0x41) => {
                let cause = format!("a request begins with the frame {frame:#x}");
                return Err(refused(StatusCode::BAD_REQUEST, cause));
            }
            _ if bytes <= FRAME_BYTES_MAX => {
                let mut payload = stream.take(bytes);
                copy(&mut payload, &mut sink()).await.map_err(broken)?;
            }
            _ => return Err(broken("a frame before the request is too long")),
        }
    }
}

fn decode(sent: &[u8]) -> Result<WebRequest, ConnectError> {
    let fields = with_earlier_name(sent);
    let protocol = if fields == sent {
        EARLIER_SESSION
    } else {
        LATER_SESSION.plain
    };
    let mut frame = Vec::new();
    Frame::HEADERS.encode(&mut frame);
    let bytes = VarInt::try_from(fields.len()).map_err(|_| ConnectError::FieldSectionTooLarge)?;
    bytes.encode(&mut frame);
    frame.extend_from_slice(&fields);
    Ok(WebRequest {
        connect: ConnectRequest::decode(&mut frame.as_slice())?,
        protocol: str::from_utf8(protocol).expect("both names are text"),
    })
}

/// The fields with a session's earlier name, which the kept codec knows, in place of its later one.
fn with_earlier_name(fields: &[u8]) -> Vec<u8> {
    edited(fields, |line, edited| {
        match PROTOCOL.is(line.name) && LATER_SESSION.is(line.value) {
            true => write_field(edited, PROTOCOL.plain, EARLIER_SESSION),
            false => edited.extend_from_slice(line.bytes),
        }
    })
}

/// The fields without one.
fn without(fields: &[u8], name: &Word) -> Vec<u8> {
    edited(fields, |line, edited| {
        if !name.is(line.name) {
            edited.extend_from_slice(line.bytes);
        }
    })
}

/// A text of fields, in both of its encodings (RFC 9204, section 4.1.2).
struct Word {
    plain: &'static [u8],
    /// In Huffman's code of RFC 7541, appendix B.
    packed: &'static [u8],
}

impl Word {
    fn is(&self, text: Option<FieldText<'_>>) -> bool {
        text.is_some_and(|text| match text.is_packed {
            true => text.bytes == self.packed,
            false => text.bytes == self.plain,
        })
    }
}

/// A text as a field has it.
#[derive(Clone, Copy)]
struct FieldText<'a> {
    bytes: &'a [u8],
    is_packed: bool,
}

/// One field.
struct FieldLine<'a> {
    bytes: &'a [u8],
    /// `None`: it is one of a table.
    name: Option<FieldText<'a>>,
    value: Option<FieldText<'a>>,
}

/// Copies fields line by line, as `copy` does. A line that cannot be read is copied as it is, for the codec to refuse.
fn edited(fields: &[u8], mut copy: impl FnMut(FieldLine<'_>, &mut Vec<u8>)) -> Vec<u8> {
    let mut edited = Vec::with_capacity(fields.len());
    let mut rest = fields;
    // Two numbers of the dynamic table, which stays empty.
    if number(&mut rest, 8)
        .and_then(|_| number(&mut rest, 7))
        .is_some()
    {
        edited.extend_from_slice(&fields[..fields.len() - rest.len()]);
        let mut behind = rest;
        while let Some(line) = next_line(&mut behind) {
            copy(line, &mut edited);
            rest = behind;
        }
    }
    edited.extend_from_slice(rest);
    edited
}

/// The next field; `None` at the end, and where it is cut off. Source: RFC 9204, section 4.5.
fn next_line<'a>(rest: &mut &'a [u8]) -> Option<FieldLine<'a>> {
    let from = *rest;
    let (name, has_value) = match from.first()? {
        // One of a table, name and value.
        0x80.. => (number(rest, 6).map(|_| None)?, false),
        0x10..=0x1f => (number(rest, 4).map(|_| None)?, false),
        // A name of a table.
        0x40..=0x7f => (number(rest, 4).map(|_| None)?, true),
        0x00..=0x0f => (number(rest, 3).map(|_| None)?, true),
        0x20..=0x3f => (Some(text(rest, 3)?), true),
    };
    let value = match has_value {
        true => Some(text(rest, 7)?),
        false => None,
    };
    Some(FieldLine {
        bytes: &from[..from.len() - rest.len()],
        name,
        value,
    })
}

/// A text behind its length, whose first `bits` bits are the last ones of a byte; the bit before them says how it is
/// encoded.
fn text<'a>(rest: &mut &'a [u8], bits: u32) -> Option<FieldText<'a>> {
    let is_packed = rest.first()? & 1 << bits != 0;
    let length = number(rest, bits)?;
    let (bytes, behind) = rest.split_at_checked(length)?;
    *rest = behind;
    Some(FieldText { bytes, is_packed })
}

/// A number that begins in the last `bits` bits of a byte (RFC 7541, section 5.1); `None` for one beyond any request.
fn number(rest: &mut &[u8], bits: u32) -> Option<usize> {
    let (&first, mut behind) = rest.split_first()?;
    let most = (1_usize << bits) - 1;
    let mut value = usize::from(first) & most;
    if value == most {
        for shift in [0, 7, 14] {
            let (&more, after) = behind.split_first()?;
            behind = after;
            value += usize::from(more & 0x7f) << shift;
            if more & 0x80 == 0 {
                *rest = behind;
                return Some(value);
            }
        }
        return None;
    }
    *rest = behind;
    Some(value)
}

/// Writes a field with its name as text.
fn write_field(fields: &mut Vec<u8>, name: &[u8], value: &[u8]) {
    for (text, bits, flags) in [(name, 3, 0x20), (value, 7, 0)] {
        let most = (1 << bits) - 1;
        match u8::try_from(text.len()).expect("a short word") {
            short if short < most => fields.push(flags | short),
            long => fields.extend([flags | most, long - most]),
        }
        fields.extend_from_slice(text);
    }
}

/// The origins of pages that may connect.
///
/// Pages of this machine may always: their origin is `localhost` or a loopback address.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Origins {
    allowed: Vec<PageOrigin>,
}

/// The origin of a page, as a browser writes it: scheme, host, and port unless it is the scheme's own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageOrigin {
    text: String,
}

/// A text that is neither an origin nor `*`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InvalidPageOrigin {
    text: String,
}

impl Origins {
    /// Pages of this machine alone.
    #[must_use]
    pub const fn loopback() -> Self {
        Self {
            allowed: Vec::new(),
        }
    }

    /// Lets pages of one more origin connect.
    pub fn allow(&mut self, origin: PageOrigin) {
        self.allowed.push(origin);
    }

    /// True if a page of this origin may connect; `None` is a client that is no browser.
    #[must_use]
    pub fn allows(&self, origin: Option<&str>) -> bool {
        let Some(origin) = origin else {
            return true;
        };
        let origin = origin.to_ascii_lowercase();
        is_loopback(&origin)
            || (self.allowed.iter())
                .any(|allowed| allowed.text == PageOrigin::ANY || allowed.text == origin)
    }
}

impl FromIterator<PageOrigin> for Origins {
    fn from_iter<T: IntoIterator<Item = PageOrigin>>(origins: T) -> Self {
        Self {
            allowed: origins.into_iter().collect(),
        }
    }
}

impl PageOrigin {
    /// The text that stands for every origin.
    const ANY: &str = "*";
}

/// The host of an origin, without its port; `None` for a text that is none.
fn host(origin: &str) -> Option<&str> {
    let (scheme, rest) = origin.split_once("://")?;
    if !matches!(scheme, "http" | "https") {
        return None;
    }
    let (host, port) = match rest.strip_prefix('[') {
        Some(rest) => {
            let (host, port) = rest.split_once(']')?;
            host.parse::<std::net::Ipv6Addr>().ok()?;
            (
                host,
                port.strip_prefix(':').or(port.is_empty().then_some("0")),
            )
        }
        None => match rest.split_once(':') {
            Some((host, port)) => (host, Some(port)),
            None => (rest, Some("0")),
        },
    };
    port?.parse::<u16>().ok()?;
    let is_host = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '_' | ':');
    (!host.is_empty() && host.chars().all(is_host)).then_some(host)
}

fn is_loopback(origin: &str) -> bool {
    host(origin).is_some_and(|host| {
        host == "localhost" || host.parse::<IpAddr>().is_ok_and(|at| at.is_loopback())
    })
}

impl FromStr for PageOrigin {
    type Err = InvalidPageOrigin;

    fn from_str(text: &str) -> Result<Self, InvalidPageOrigin> {
        let lower = text.to_ascii_lowercase();
        if lower != Self::ANY && host(&lower).is_none() {
            return Err(InvalidPageOrigin { text: text.into() });
        }
        Ok(Self { text: lower })
    }
}

impl fmt::Display for PageOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.text.fmt(f)
    }
}

impl fmt::Display for InvalidPageOrigin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{:?} is not an origin: write https://host, https://host:port, or * for all",
            self.text
        )
    }
}

impl std::error::Error for InvalidPageOrigin {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fields behind the two numbers of an empty table, each with its name as text, or packed where `packed` has it.
    fn fields(lines: &[(&[u8], &[u8])], packed: &[&Word]) -> Vec<u8> {
        let mut fields = vec![0, 0];
        for (name, value) in lines {
            for (text, bits, flags) in [(name, 3, 0x20), (value, 7, 0)] {
                let short = packed.iter().find(|word| word.plain == *text);
                let bytes = short.map_or(*text, |word| word.packed);
                let flags = flags | u8::from(short.is_some()) << bits;
                let most = (1 << bits) - 1;
                match u8::try_from(bytes.len()).unwrap() {
                    length if length < most => fields.push(flags | length),
                    length => fields.extend([flags | most, length - most]),
                }
                fields.extend_from_slice(bytes);
            }
        }
        fields
    }

    fn request<'a>(protocol: &'a [u8], more: &[(&'a [u8], &'a [u8])]) -> Vec<(&'a [u8], &'a [u8])> {
        let mut lines: Vec<(&[u8], &[u8])> = vec![
            (b":method", b"CONNECT"),
            (b":scheme", b"https"),
            (b":authority", b"127.0.0.1:4433"),
            (b":path", b"/rhumb/1"),
            (b":protocol", protocol),
        ];
        lines.extend_from_slice(more);
        lines
    }

    #[test]
    fn a_session_has_a_name_before_draft_15_and_another_since_however_they_are_packed() {
        for (name, packed) in [
            (&b"webtransport"[..], &[][..]),
            (b"webtransport", &[&PROTOCOL]),
            (b"webtransport-h3", &[]),
            (b"webtransport-h3", &[&PROTOCOL]),
            (b"webtransport-h3", &[&LATER_SESSION]),
            (b"webtransport-h3", &[&PROTOCOL, &LATER_SESSION]),
        ] {
            let lines = request(name, &[(b"origin", b"https://example.org"), (b"x", b"y")]);
            let request = decode(&fields(&lines, packed)).unwrap();
            assert_eq!(request.protocol.as_bytes(), name);
            assert_eq!(request.connect.url.path(), "/rhumb/1");
            assert_eq!(request.connect.headers[ORIGIN], "https://example.org");
            assert_eq!(request.connect.headers["x"], "y");
        }
    }

    #[test]
    fn packed_words_are_those_of_the_code() {
        for word in [&PROTOCOL, &LATER_SESSION, &AVAILABLE] {
            let lines = request(b"webtransport", &[(b"x", word.plain)]);
            let request = decode(&fields(&lines, &[word])).unwrap();
            assert_eq!(request.connect.headers["x"].as_bytes(), word.plain);
        }
    }

    #[test]
    fn fields_of_tables_pass_and_a_session_behind_them_is_found() {
        // CONNECT and https whole; the authority and the path by their names.
        let mut sent = vec![0, 0, 0xc0 | 15, 0xc0 | 23, 0x50, 1, b'a', 0x51, 8];
        sent.extend_from_slice(b"/rhumb/1");
        sent.extend_from_slice(&fields(&[(b":protocol", b"webtransport-h3")], &[])[2..]);
        let request = decode(&sent).unwrap();
        assert_eq!(request.protocol, "webtransport-h3");
        assert_eq!(request.connect.url.path(), "/rhumb/1");
    }

    #[test]
    fn the_name_counts_in_its_field_alone() {
        for value in [&b"websocket"[..], b"webtransport-h4", b""] {
            let lines = request(value, &[(b"x", b"webtransport-h3")]);
            let error = decode(&fields(&lines, &[])).unwrap_err();
            assert!(matches!(error, ConnectError::WrongProtocol(_)), "{error:?}");
        }
    }

    #[test]
    fn fields_that_are_cut_anywhere_or_have_any_bytes_are_refused_or_read() {
        let whole = fields(&request(b"webtransport-h3", &[]), &[&PROTOCOL]);
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err(), "{length} bytes");
        }
        proptest::proptest!(|(bytes: Vec<u8>)| drop(decode(&bytes)));
    }

    #[test]
    fn a_list_of_protocols_without_meaning_is_dropped_from_fields() {
        let list: (&[u8], &[u8]) = (AVAILABLE.plain, b"no string, 7");
        for packed in [&[][..], &[&AVAILABLE]] {
            let sent = fields(&request(b"webtransport-h3", &[list, (b"x", b"y")]), packed);
            let error = decode(&sent).unwrap_err();
            assert!(matches!(error, ConnectError::InvalidProtocol), "{error:?}");
            let request = decode(&without(&sent, &AVAILABLE)).unwrap().connect;
            assert!(request.protocols.is_empty() && request.headers["x"] == "y");
        }
    }

    #[test]
    fn a_request_is_answered_by_path_then_origin_and_with_a_protocol_that_the_client_lists() {
        let answered = |path: &str, origin: Option<&str>, list: &[&str]| {
            let url: url::Url = format!("https://127.0.0.1{path}").parse().unwrap();
            let protocols = list.iter().map(|protocol| (*protocol).to_owned());
            let mut request = ConnectRequest::new(url).with_protocols(protocols);
            if let Some(origin) = origin {
                request = request.with_header(ORIGIN, origin.parse().unwrap());
            }
            answer(&request, &Origins::loopback())
        };
        let status = |answer: Result<ConnectResponse, WebRefusal>| match answer {
            Ok(answer) => (answer.status.as_u16(), answer.protocol),
            Err(refusal) => (refusal.status().unwrap().as_u16(), None),
        };
        let (page, foreign) = (Some("http://localhost:8080"), Some("https://example.org"));
        assert_eq!(status(answered("/rhumb/1", None, &[])), (200, None));
        assert_eq!(status(answered("/rhumb/1", page, &["moq"])), (200, None));
        let chosen = (200, Some("rhumb/1".to_owned()));
        assert_eq!(
            status(answered("/rhumb/1", page, &["moq", "rhumb/1"])),
            chosen
        );
        assert_eq!(
            status(answered("/rhumb/1", foreign, &["rhumb/1"])),
            (403, None)
        );
        assert_eq!(status(answered("/rhumb/1/", page, &[])), (404, None));
        assert_eq!(status(answered("/", foreign, &[])), (404, None));
    }

    #[test]
    fn pages_of_this_machine_and_clients_without_a_page_may_connect() {
        let origins = Origins::loopback();
        for origin in [
            None,
            Some("http://localhost"),
            Some("http://localhost:8080"),
            Some("https://127.0.0.1:4433"),
            Some("http://127.3.2.1"),
            Some("http://[::1]:80"),
        ] {
            assert!(origins.allows(origin), "{origin:?}");
        }
        for origin in [
            "https://example.org",
            "https://localhost.example.org",
            "http://127.0.0.1.example.org",
            "http://[::2]",
            "null",
            "file://",
            "",
            "http://localhost:80:80",
            "http://localhost/x",
        ] {
            assert!(!origins.allows(Some(origin)), "{origin}");
        }
    }

    #[test]
    fn an_allowed_origin_is_compared_whole_and_a_star_allows_all() {
        let one: Origins = ["https://Example.org:8443".parse().unwrap()]
            .into_iter()
            .collect();
        assert!(one.allows(Some("https://example.org:8443")));
        assert!(!one.allows(Some("https://example.org")));
        assert!(!one.allows(Some("http://example.org:8443")));
        let mut all = Origins::loopback();
        all.allow("*".parse().unwrap());
        assert!(all.allows(Some("https://example.net")) && all.allows(Some("null")));
    }

    #[test]
    fn a_text_that_is_no_origin_is_refused_with_the_form_to_write() {
        for text in [
            "",
            "example.org",
            "https://",
            "ftp://host",
            "https://a/b",
            "https://a:b",
        ] {
            let error = text.parse::<PageOrigin>().unwrap_err().to_string();
            assert!(error.contains("https://host"), "{error}");
        }
    }
}
