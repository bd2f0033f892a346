//! A WebTransport session on a connection of HTTP/3, and its settings.
//!
//! Its setup, its frames, its end. The kept crate `web-transport-proto` encodes and decodes; this file moves the
//! bytes. A connection carries one session. Every frame of a peer is bounded by that crate, and streams that no
//! session has are not read.
//!
//! The server offers the settings of all drafts of WebTransport at once, and each client chooses (PROTOCOL 1.5). Of a
//! client it needs datagrams alone: no two drafts agree in what else a client sends.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use bytes::{BufMut, Bytes, BytesMut};
use quinn::{Connection, RecvStream, SendStream, VarInt};
use rhumb_link::connection::CarriedSession;
use rhumb_link::tuning::FLUSH;
use rhumb_protocol::session::TransportCode;
use tokio::io::AsyncReadExt;
use tokio::sync::{Notify, mpsc};
use tokio::time::timeout;
use web_transport_proto as proto;
use web_transport_proto::http::StatusCode;
use web_transport_proto::{Setting, StreamUni};

use crate::web_request;
pub(crate) use crate::web_request::WebRefusal;
use crate::web_request::{Origins, broken, refused};

/// The end of a connection with HTTP/3 that has nothing to report. Source: RFC 9114, section 8.1.
const H3_NO_ERROR: u32 = 0x100;

/// The reset of a request that is not looked at. Source: RFC 9114, section 8.1.
const H3_REQUEST_REJECTED: u32 = 0x10b;

/// The reset of a stream whose session has ended.
const SESSION_GONE: u32 = 0x170d_7b68;

/// Time for which a closing end waits for the peer to take the close code, before it closes the connection.
const CODE_TAKEN: Duration = Duration::from_millis(80);

/// A session of a browser.
#[derive(Debug)]
pub(crate) struct WebSession {
    connection: Connection,
    /// Number of the session: that of the stream that requested it.
    session_id: proto::VarInt,
    /// First bytes of each datagram: a quarter of the session's number.
    datagram_header: Bytes,
    /// The stream of the request, which must not end before the session.
    request: Mutex<Option<(SendStream, RecvStream)>>,
    _settings: SentSettings,
    /// The code that the peer closed the session with; above u32 before.
    peer_code: AtomicU64,
    /// The code to close the session with; above u32 before.
    own_code: AtomicU64,
    close_requested: Notify,
}

/// A number above all codes.
const NO_CODE: u64 = u64::MAX;

impl WebSession {
    /// Answers the request of a client, whose settings come before it or after it.
    ///
    /// A refused client has its status, and some time to read it.
    pub(crate) async fn accept(
        connection: &Connection,
        settings: SentSettings,
        origins: &Origins,
    ) -> Result<Self, WebRefusal> {
        let mut settings_of_client = ClientSettings::take(connection);
        let client = settings_of_client.received().await?;
        let (mut send, mut recv) = connection.accept_bi().await.map_err(broken)?;
        let request = web_request::read_request(&mut recv).await;
        if let Ok(request) = &request {
            let address = connection.remote_address();
            let protocol = request.protocol;
            tracing::debug!(%address, protocol, settings = ?client, "asked for a session");
        }
        let answer = match request {
            Ok(_) if !takes_datagrams(&client) => Err(refused(
                StatusCode::BAD_REQUEST,
                "the client's settings do not allow datagrams",
            )),
            Ok(request) => web_request::answer(&request.connect, origins),
            Err(refusal) => Err(refusal),
        };
        let answer = match answer {
            Ok(answer) => answer,
            Err(refusal) => {
                if let Some(status) = refusal.status() {
                    web_request::refuse(&mut send, status).await;
                    // The end of the connection ends what the client has not read; most clients end it themselves.
                    let _ = timeout(FLUSH, connection.closed()).await;
                }
                return Err(refusal);
            }
        };
        answer.write(&mut send).await.map_err(broken)?;
        let id = VarInt::from(send.id()).into_inner();
        let session_id = proto::VarInt::try_from(id).expect("a stream's number fits");
        let quarter = proto::VarInt::try_from(id / 4).expect("a smaller number fits too");
        let mut header = BytesMut::new();
        quarter.encode(&mut header);
        Ok(Self {
            connection: connection.clone(),
            session_id,
            datagram_header: header.freeze(),
            request: Mutex::new(Some((send, recv))),
            _settings: settings,
            peer_code: AtomicU64::new(NO_CODE),
            own_code: AtomicU64::new(NO_CODE),
            close_requested: Notify::new(),
        })
    }

    /// The session's next bidirectional stream, behind its header; `None` after the end of the connection. Further requests
    /// are refused: a connection carries one session.
    pub(crate) async fn accept_bi(&self) -> Option<(SendStream, RecvStream)> {
        loop {
            let (mut send, mut recv) = self.connection.accept_bi().await.ok()?;
            let frame = read_number(&mut recv).await;
            if frame == Some(proto::Frame::WEBTRANSPORT.0)
                && read_number(&mut recv).await == Some(self.session_id)
            {
                return Some((send, recv));
            }
            // A further request, or a stream of its session. A client that has ended it needs no answer.
            let _ = send.reset(VarInt::from_u32(H3_REQUEST_REJECTED));
            let _ = recv.stop(VarInt::from_u32(H3_REQUEST_REJECTED));
        }
    }

    /// A datagram for the peer.
    pub(crate) fn wrap(&self, bytes: &[u8]) -> Bytes {
        let mut wrapped = BytesMut::with_capacity(self.datagram_header.len() + bytes.len());
        wrapped.put_slice(&self.datagram_header);
        wrapped.put_slice(bytes);
        wrapped.freeze()
    }

    /// The content of a datagram of the peer; `None` for one of another session.
    pub(crate) fn unwrap(&self, datagram: Bytes) -> Option<Bytes> {
        let is_ours = datagram.starts_with(&self.datagram_header);
        is_ours.then(|| datagram.slice(self.datagram_header.len()..))
    }

    /// Bytes by which a datagram grows on the way.
    pub(crate) const fn overhead(&self) -> usize {
        self.datagram_header.len()
    }

    /// Waits for either end to close the session, and then closes the connection by `close`.
    pub(crate) async fn run(&self, close: impl Fn(VarInt)) {
        let request = self.request.lock();
        let request = request.unwrap_or_else(PoisonError::into_inner).take();
        let Some((mut send, mut recv)) = request else {
            return;
        };
        tokio::select! {
            biased;
            // First: many clients end their connection behind the code, which then waits to be read.
            // The stream is only borrowed: to drop it would stop the peer's end, and its session, before it has the code.
            code = read_close(&mut recv) => {
                // A page that leaves says nothing. The end of a connection has a code of its own.
                let is_over = self.connection.close_reason().is_some();
                if let Some(code) = code.or((!is_over).then_some(TransportCode::LEFT.0)) {
                    self.peer_code.store(code.into(), Ordering::Relaxed);
                }
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
        }
    }
}

impl CarriedSession for WebSession {
    /// [`Self::run`] performs it.
    fn close(&self, code: u32) {
        self.own_code.store(code.into(), Ordering::Relaxed);
        self.close_requested.notify_one();
    }

    fn peer_code(&self) -> Option<u32> {
        u32::try_from(self.peer_code.load(Ordering::Relaxed)).ok()
    }

    /// Source: draft 16, section 6.
    fn is_end_of_session(&self, code: VarInt) -> bool {
        code == VarInt::from_u32(SESSION_GONE)
    }

    fn code_of_connection(&self, code: VarInt) -> Option<u32> {
        // Without a reason: by HTTP/3's code, and by that of libraries below it.
        match [H3_NO_ERROR, 0].contains(&u32::try_from(code.into_inner()).unwrap_or(u32::MAX)) {
            true => Some(TransportCode::LEFT.0),
            false => proto::error_from_http3(code.into_inner()),
        }
    }
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

/// Sessions at a time on one connection, of drafts 13 and 14.
const WT_MAX_SESSIONS: Setting = Setting(proto::VarInt::from_u32(0x14e9_cd29));

/// Support for sessions, of drafts 15 and 16.
const WT_ENABLED: Setting = Setting(proto::VarInt::from_u32(0x2c7c_f000));

/// This end's settings, whose stream must not end before the connection.
#[derive(Debug)]
pub(crate) struct SentSettings {
    _stream: SendStream,
}

/// A client's unidirectional streams: its settings, and two of header compression that stay empty, in any order.
#[derive(Debug)]
struct ClientSettings {
    settings: mpsc::Receiver<Result<proto::Settings, WebRefusal>>,
}

/// Sends this end's settings. They wait for nothing of the client (RFC 9114, section 7.2.4.2).
pub(crate) async fn send_settings(connection: &Connection) -> Result<SentSettings, WebRefusal> {
    let one = proto::VarInt::from_u32(1);
    let mut settings = proto::Settings::default();
    // Drafts 2 to 12.
    settings.enable_webtransport(1);
    settings.insert(WT_MAX_SESSIONS, one);
    settings.insert(WT_ENABLED, one);
    let mut stream = connection.open_uni().await.map_err(broken)?;
    settings.write(&mut stream).await.map_err(broken)?;
    Ok(SentSettings { _stream: stream })
}

impl ClientSettings {
    /// Takes the client's streams from now on, until the end of the connection.
    pub(crate) fn take(connection: &Connection) -> Self {
        let (sender, settings) = mpsc::channel(1);
        let connection = connection.clone();
        tokio::spawn(async move {
            while let Ok(stream) = connection.accept_uni().await {
                tokio::spawn(take_stream(connection.clone(), stream, sender.clone()));
            }
        });
        Self { settings }
    }

    /// Waits for the client's settings.
    pub(crate) async fn received(&mut self) -> Result<proto::Settings, WebRefusal> {
        let settings = self.settings.recv().await;
        settings.unwrap_or_else(|| Err(broken("the connection ended before the client's settings")))
    }
}

/// True if the client takes datagrams, by the setting of RFC 9297 or that of its drafts.
fn takes_datagrams(settings: &proto::Settings) -> bool {
    [
        Setting::ENABLE_DATAGRAM,
        Setting::ENABLE_DATAGRAM_DEPRECATED,
    ]
    .iter()
    .any(|setting| settings.get(setting) == Some(&proto::VarInt::from_u32(1)))
}

/// Reads settings if the stream has them, and holds it open, unread, for as long as its connection: to drop it would
/// refuse it.
async fn take_stream(
    connection: Connection,
    mut stream: RecvStream,
    settings: mpsc::Sender<Result<proto::Settings, WebRefusal>>,
) {
    if let Ok(kind) = proto::VarInt::read(&mut stream).await
        && StreamUni(kind) == StreamUni::CONTROL
    {
        let mut whole = (&[0][..]).chain(&mut stream);
        let read = proto::Settings::read(&mut whole).await.map_err(broken);
        // A client has one such stream; of a second one nothing counts.
        let _ = settings.try_send(read);
    }
    drop(settings);
    connection.closed().await;
    drop(stream);
}
