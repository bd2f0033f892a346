//! A WebTransport session on a connection of HTTP/3.
//!
//! Its setup, its frames, its end. The kept crate `web-transport-proto` encodes and decodes; this file moves the bytes. A connection carries one session.
//! Every frame of a peer is bounded by that crate, and streams that no session has are not read.

use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use bytes::{BufMut, Bytes, BytesMut};
use quinn::{Connection, RecvStream, SendStream, VarInt};
use rhumb_protocol::session::TransportCode;
use tokio::sync::Notify;
use tokio::time::timeout;
use web_transport_proto as proto;
use web_transport_proto::http::StatusCode;
use web_transport_proto::http::header::ORIGIN;

use super::origins::Origins;

/// The path that a client requests: it names the protocol, as the ALPN name does elsewhere.
const WEB_PATH: &str = "/rhumb/1";

/// The end of a connection with HTTP/3 that has nothing to report. Source: RFC 9114, section 8.1.
const H3_NO_ERROR: u32 = 0x100;

/// Time for which a closing end waits for the peer to take the close code, before it closes the connection.
const CODE_TAKEN: Duration = Duration::from_millis(80);

/// A session of a browser.
#[derive(Debug)]
pub(super) struct WebSession {
    connection: Connection,
    /// Number of the session: that of the stream that requested it.
    session_id: proto::VarInt,
    /// First bytes of each datagram: a quarter of the session's number.
    datagram_header: Bytes,
    /// Streams that must not end before the session: settings and the request.
    request: Mutex<Option<(SendStream, RecvStream)>>,
    _settings: (SendStream, RecvStream),
    /// The code that the peer closed the session with; above u32 before.
    peer_code: AtomicU64,
    /// The code to close the session with; above u32 before.
    own_code: AtomicU64,
    close_requested: Notify,
}

/// A number above all codes.
const NO_CODE: u64 = u64::MAX;

/// Reason why a connection with HTTP/3 has no session.
#[derive(Debug)]
pub(super) enum WebRefusal {
    /// The peer does not speak WebTransport as it should, or was lost.
    Handshake(String),
    /// The path is not that of this protocol.
    Path(String),
}

impl fmt::Display for WebRefusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Handshake(cause) => cause.fmt(f),
            Self::Path(path) => write!(f, "the page asks for {path:?}, not for {WEB_PATH}"),
        }
    }
}

impl WebSession {
    /// Answers the settings and the request of a client. The second result is the page's origin if it may not connect.
    pub(super) async fn accept(
        connection: &Connection,
        origins: &Origins,
    ) -> Result<(Self, Result<(), String>), WebRefusal> {
        let settings = tokio::try_join!(send_settings(connection), read_settings(connection))?;
        let (mut send, mut recv) = connection.accept_bi().await.map_err(broken)?;
        let request = proto::ConnectRequest::read(&mut recv)
            .await
            .map_err(broken)?;
        if request.url.path() != WEB_PATH {
            let refusal = proto::ConnectResponse::new(StatusCode::NOT_FOUND);
            refusal.write(&mut send).await.map_err(broken)?;
            // The end of the connection, which follows, ends the stream too.
            let _ = send.finish();
            let _ = timeout(CODE_TAKEN, send.stopped()).await;
            return Err(WebRefusal::Path(request.url.path().to_owned()));
        }
        // Bytes that are no text are no origin that could be allowed.
        let origin = (request.headers.get(ORIGIN)).map(|origin| origin.to_str().unwrap_or("?"));
        let verdict = match origins.allows(origin) {
            true => Ok(()),
            false => Err(origin.unwrap_or_default().to_owned()),
        };
        // A page reads neither status nor text of a refused request. It reads the code of a closed session.
        let response = proto::ConnectResponse::OK;
        response.write(&mut send).await.map_err(broken)?;
        let id = VarInt::from(send.id()).into_inner();
        let session_id = proto::VarInt::try_from(id).expect("a stream's number fits");
        let quarter = proto::VarInt::try_from(id / 4).expect("a smaller number fits too");
        let mut header = BytesMut::new();
        quarter.encode(&mut header);
        let session = Self {
            connection: connection.clone(),
            session_id,
            datagram_header: header.freeze(),
            request: Mutex::new(Some((send, recv))),
            _settings: settings,
            peer_code: AtomicU64::new(NO_CODE),
            own_code: AtomicU64::new(NO_CODE),
            close_requested: Notify::new(),
        };
        Ok((session, verdict))
    }

    /// The session's next bidirectional stream, behind its header; `None` after the end of the connection. Streams of no
    /// session, and those that end before their header, are ignored.
    pub(super) async fn accept_bi(&self) -> Option<(SendStream, RecvStream)> {
        loop {
            let (send, mut recv) = self.connection.accept_bi().await.ok()?;
            let frame = read_number(&mut recv).await;
            if frame == Some(proto::Frame::WEBTRANSPORT.0)
                && read_number(&mut recv).await == Some(self.session_id)
            {
                return Some((send, recv));
            }
        }
    }

    /// A datagram for the peer.
    pub(super) fn wrap(&self, bytes: &[u8]) -> Bytes {
        let mut wrapped = BytesMut::with_capacity(self.datagram_header.len() + bytes.len());
        wrapped.put_slice(&self.datagram_header);
        wrapped.put_slice(bytes);
        wrapped.freeze()
    }

    /// The content of a datagram of the peer; `None` for one of another session.
    pub(super) fn unwrap(&self, datagram: Bytes) -> Option<Bytes> {
        let is_ours = datagram.starts_with(&self.datagram_header);
        is_ours.then(|| datagram.slice(self.datagram_header.len()..))
    }

    /// Bytes by which a datagram grows on the way.
    pub(super) const fn overhead(&self) -> usize {
        self.datagram_header.len()
    }

    /// Requests the end of the session, from any thread; [`Self::run`] performs it.
    pub(super) fn close(&self, code: u32) {
        self.own_code.store(code.into(), Ordering::Relaxed);
        self.close_requested.notify_one();
    }

    /// The code that the peer closed with.
    pub(super) fn peer_code(&self) -> Option<u32> {
        u32::try_from(self.peer_code.load(Ordering::Relaxed)).ok()
    }

    /// Waits for either end to close the session, and then closes the connection by `close`.
    pub(super) async fn run(&self, close: impl Fn(VarInt)) {
        let request = self.request.lock();
        let request = request.unwrap_or_else(PoisonError::into_inner).take();
        let Some((mut send, mut recv)) = request else {
            return;
        };
        let strays = async {
            while let Ok(stream) = self.connection.accept_uni().await {
                // The two streams of header compression, which stay empty, must not be refused.
                tokio::spawn(hold(self.connection.clone(), stream));
            }
        };
        tokio::select! {
            // The stream is only borrowed: to drop it would stop the peer's end, and its session, before it has the code.
            code = read_close(&mut recv) => {
                // A page that leaves says nothing.
                self.peer_code.store(code.unwrap_or(TransportCode::LEFT.0).into(), Ordering::Relaxed);
                close(VarInt::from_u32(H3_NO_ERROR));
            }
            () = self.close_requested.notified() => {
                let code = self.own_code.load(Ordering::Relaxed);
                let code = u32::try_from(code).unwrap_or(TransportCode::LEFT.0);
                let delivered = async {
                    let capsule = close_capsule(code);
                    if send.write_all(&capsule).await.is_ok() && send.finish().is_ok() {
                        self.connection.closed().await;
                    }
                };
                // If the peer does not take it in time, the connection's own end has the code too.
                let _ = timeout(CODE_TAKEN, delivered).await;
                let code = proto::error_to_http3(code);
                close(VarInt::from_u64(code).expect("a code of http/3 fits"));
            }
            _ = self.connection.closed() => {}
            () = strays => {}
        }
    }
}

/// The code that a peer closed a session with by the connection's own code; `None` for any other code.
pub(super) fn session_code(code: VarInt) -> Option<u32> {
    match code == VarInt::from_u32(H3_NO_ERROR) {
        true => Some(TransportCode::LEFT.0),
        false => proto::error_from_http3(code.into_inner()),
    }
}

async fn send_settings(connection: &Connection) -> Result<SendStream, WebRefusal> {
    let mut settings = proto::Settings::default();
    settings.enable_webtransport(1);
    let mut stream = connection.open_uni().await.map_err(broken)?;
    settings.write(&mut stream).await.map_err(broken)?;
    Ok(stream)
}

async fn read_settings(connection: &Connection) -> Result<RecvStream, WebRefusal> {
    let mut stream = connection.accept_uni().await.map_err(broken)?;
    let settings = proto::Settings::read(&mut stream).await.map_err(broken)?;
    if settings.supports_webtransport() == 0 {
        let cause = "the peer's settings do not allow webtransport";
        return Err(WebRefusal::Handshake(cause.into()));
    }
    Ok(stream)
}

fn broken(cause: impl fmt::Display) -> WebRefusal {
    WebRefusal::Handshake(cause.to_string())
}

/// Reads the request's stream to its end; `None` if that comes without a code.
async fn read_close(stream: &mut RecvStream) -> Option<u32> {
    let mut capsules = proto::Http3CapsuleReader::new(stream);
    loop {
        match capsules.read().await {
            Ok(Some(proto::Capsule::CloseWebTransportSession { code, .. })) => return Some(code),
            Ok(Some(_)) => {}
            Ok(None) | Err(_) => return None,
        }
    }
}

/// The code as a capsule in a frame of data (RFC 9297, section 3.2).
fn close_capsule(code: u32) -> Vec<u8> {
    let mut capsule = Vec::new();
    // Codes below those of the transport are the protocol's, which the client words itself.
    let reason = match code {
        TransportCode::FIRST.. => TransportCode(code).to_string(),
        _ => String::new(),
    };
    proto::Capsule::CloseWebTransportSession { code, reason }.encode(&mut capsule);
    let mut frame = Vec::new();
    proto::Frame::DATA.encode(&mut frame);
    let length = u32::try_from(capsule.len()).expect("a code and a sentence");
    proto::VarInt::from_u32(length).encode(&mut frame);
    frame.extend_from_slice(&capsule);
    frame
}

async fn read_number(stream: &mut RecvStream) -> Option<proto::VarInt> {
    proto::VarInt::read(stream).await.ok()
}

/// Keeps a stream open, unread, for as long as its connection.
async fn hold(connection: Connection, stream: RecvStream) {
    connection.closed().await;
    drop(stream);
}
