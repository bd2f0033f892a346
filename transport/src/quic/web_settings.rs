//! Settings of HTTP/3, with clients of each draft of WebTransport.
//!
//! The server offers all drafts at once, and each client chooses (PROTOCOL 1.5). Of a client it needs datagrams alone: no
//! two drafts agree in what else a client sends.

use quinn::{Connection, RecvStream, SendStream};
use tokio::io::AsyncReadExt;
use tokio::sync::mpsc;
use web_transport_proto as proto;
use web_transport_proto::{Setting, StreamUni};

use super::web_request::{WebRefusal, broken};

/// Sessions at a time on one connection, of drafts 13 and 14.
const WT_MAX_SESSIONS: Setting = Setting(proto::VarInt::from_u32(0x14e9_cd29));

/// Support for sessions, of drafts 15 and 16.
const WT_ENABLED: Setting = Setting(proto::VarInt::from_u32(0x2c7c_f000));

/// This end's settings, whose stream must not end before the connection.
#[derive(Debug)]
pub(super) struct SentSettings {
    _stream: SendStream,
}

/// A client's unidirectional streams: its settings, and two of header compression that stay empty, in any order.
#[derive(Debug)]
pub(super) struct ClientSettings {
    settings: mpsc::Receiver<Result<proto::Settings, WebRefusal>>,
}

/// Sends this end's settings. They wait for nothing of the client (RFC 9114, section 7.2.4.2).
pub(super) async fn send_settings(connection: &Connection) -> Result<SentSettings, WebRefusal> {
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
    pub(super) fn take(connection: &Connection) -> Self {
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
    pub(super) async fn received(&mut self) -> Result<proto::Settings, WebRefusal> {
        let settings = self.settings.recv().await;
        settings.unwrap_or_else(|| Err(broken("the connection ended before the client's settings")))
    }
}

/// True if the client takes datagrams, by the setting of RFC 9297 or that of its drafts.
pub(super) fn takes_datagrams(settings: &proto::Settings) -> bool {
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
