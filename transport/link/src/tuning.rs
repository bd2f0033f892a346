//! All parameters of QUIC, with their reasons.
//!
//! Opens nothing. Both ends agree by construction: this file configures both.

use std::sync::Arc;
use std::time::Duration;

use quinn::congestion::BbrConfig;
use quinn::crypto::rustls::{NoInitialCipherSuite, QuicClientConfig};
use quinn::{ClientConfig, IdleTimeout, ServerConfig, TransportConfig, VarInt, crypto, rustls};

use crate::client_transport::PIECE_COST_BYTES;

/// The application protocol, by its TLS name.
pub const ALPN: &[u8] = b"rhumb/1";

/// The same of this draft alone (PROTOCOL 1.1-5): a later draft that changes a byte has another.
pub const DRAFT_ALPN: &[u8] = b"rhumb/1-draft-1";

/// HTTP/3, on which browsers open sessions.
pub const WEB_ALPN: &[u8] = b"h3";

/// Bytes of a state datagram that each connection can carry from its start (PROTOCOL 1.1-4).
///
/// Derived: a UDP payload of 1,200, less 38 for QUIC (flags 1, connection id 8 at most, packet number 4,
/// tag 16, frame header 9).
/// Payload only: `max_datagram_frame_size` counts the frame header too, and must be 9 more.
pub const DATAGRAM_BYTES_MIN: usize = 1_162;

/// Silence after which a connection is considered lost.
const IDLE_MS: VarInt = VarInt::from_u32(10_000);

/// The same at a server whose scenes another one takes up. It is longer than a machine that is busy stands still, and shorter
/// than the lease by which such servers have their scenes: a client is there when the scene comes back.
const SHORT_IDLE_MS: VarInt = VarInt::from_u32(4_000);

/// Such a server breaks silence after this long, as its scene may have nothing to say and its clients may not know.
const SHORT_KEEP_ALIVE: Duration = Duration::from_secs(1);

/// The silence after which clients of a server consider it lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum IdleLimit {
    /// Ten seconds.
    #[default]
    Usual,
    /// Four seconds: clients have another server to go to.
    Short,
}

/// The client breaks silence after this long (PROTOCOL 1.4-2): three attempts before `IDLE_MS`. None is needed while a
/// quiet scene sends a watermark every two and a half seconds.
const KEEP_ALIVE: Duration = Duration::from_secs(3);

/// Time limit of a handshake, and again of the opening of the control stream.
pub const SETUP: Duration = Duration::from_secs(5);

/// A closing end waits this long at most until its last control bytes are written and acknowledged.
pub const FLUSH: Duration = Duration::from_millis(500);

/// A closing end waits this long at most for its close frame to leave.
pub const CLOSE_LEAVES: Duration = Duration::from_millis(100);

/// Connections of one server. With every bound below at its limit each costs some 7 MiB.
pub const CONNECTIONS_MAX: usize = 1_024;

/// Connections and attempts of one address: half of all, so that no address takes them all.
pub const CONNECTIONS_PER_ADDRESS_MAX: usize = 512;

/// Handshakes in progress beyond which a client must first prove its address.
pub const HANDSHAKES_UNPROVEN_MAX: usize = 64;

/// Queued control bytes before a peer is dropped as too slow. An endpoint that heeds what its links take never gets
/// there.
pub const CONTROL_QUEUE_BYTES: usize = 12 << 20;

/// State bytes between the sockets and the server thread, per connection; beyond them datagrams are dropped.
pub const STATE_IN_FLIGHT_BYTES: usize = 1 << 20;

/// Unsent datagrams per connection: a tick's burst of 500 full packets and more, yet never seconds of stale state.
pub const DATAGRAM_SEND_BYTES: usize = 1 << 20;

/// Datagrams that quinn holds before this crate's task takes them.
const DATAGRAM_RECEIVE_BYTES: usize = 1 << 20;

/// Unread stream bytes of a peer at a server, and at a client that receives a whole scene.
const SERVER_STREAM_WINDOW: VarInt = VarInt::from_u32(256 << 10);
const CLIENT_STREAM_WINDOW: VarInt = VarInt::from_u32(1 << 20);

/// Unread bytes of all streams of a peer at a server. Control bytes that wait leave room for the close of a browser's
/// session, which comes on a stream of its own.
const SERVER_WINDOW: VarInt = VarInt::from_u32((256 + 16) << 10);

/// Stream bytes kept for retransmission, per connection.
const SEND_WINDOW: u64 = 1 << 20;

/// Connection attempts that wait to be accepted, and their bytes: some 5 MiB where quinn allows 100.
const INCOMING_MAX: usize = 1_024;
const INCOMING_BYTES: u64 = 16 << 10;
const INCOMING_BYTES_TOTAL: u64 = 4 << 20;

const _: () = assert!(500 * (1_200 + PIECE_COST_BYTES) < DATAGRAM_SEND_BYTES);
const _: () = assert!(CONTROL_QUEUE_BYTES + DATAGRAM_SEND_BYTES + SEND_WINDOW as usize <= 16 << 20);

/// Streams that a client may have open at a time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClientStreams {
    bidirectional: VarInt,
    unidirectional: VarInt,
}

impl ClientStreams {
    /// The control stream alone.
    pub const PLAIN: Self = Self {
        bidirectional: VarInt::from_u32(1),
        unidirectional: VarInt::from_u32(0),
    };
    /// Also those of HTTP/3: the request, settings, and two of header compression. Browsers give up a handshake that
    /// does not grant them, before a server knows who asks; so a server stops them where a plain client opens them.
    pub const WEB: Self = Self {
        bidirectional: VarInt::from_u32(2),
        unidirectional: VarInt::from_u32(3),
    };
}

/// A server's configuration from its TLS side. `streams`: those that a client may open.
pub fn server(
    crypto: Arc<dyn crypto::ServerConfig>,
    streams: ClientStreams,
    idle_limit: IdleLimit,
) -> ServerConfig {
    let mut config = ServerConfig::with_crypto(crypto);
    let mut transport = common();
    if idle_limit == IdleLimit::Short {
        // Of the two ends' idle timeouts the shorter one holds at both.
        transport
            .max_idle_timeout(Some(IdleTimeout::from(SHORT_IDLE_MS)))
            .keep_alive_interval(Some(SHORT_KEEP_ALIVE));
    }
    transport
        .max_concurrent_bidi_streams(streams.bidirectional)
        .max_concurrent_uni_streams(streams.unidirectional)
        .stream_receive_window(SERVER_STREAM_WINDOW)
        .receive_window(SERVER_WINDOW);
    config
        .transport_config(Arc::new(transport))
        .max_incoming(INCOMING_MAX)
        .incoming_buffer_size(INCOMING_BYTES)
        .incoming_buffer_size_total(INCOMING_BYTES_TOTAL);
    config
}

/// A client's configuration from its TLS configuration.
///
/// # Errors
///
/// The provider has no initial cipher suite.
pub fn client(tls: Arc<rustls::ClientConfig>) -> Result<ClientConfig, NoInitialCipherSuite> {
    let mut config = ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls)?));
    let mut transport = common();
    transport
        .max_concurrent_bidi_streams(VarInt::from_u32(0))
        .stream_receive_window(CLIENT_STREAM_WINDOW)
        .receive_window(CLIENT_STREAM_WINDOW)
        .keep_alive_interval(Some(KEEP_ALIVE));
    config.transport_config(Arc::new(transport));
    Ok(config)
}

fn common() -> TransportConfig {
    let mut transport = TransportConfig::default();
    // New state supersedes old: a controller that halves its window at each random loss would delay state for seconds.
    transport.congestion_controller_factory(Arc::new(BbrConfig::default()));
    transport
        .max_concurrent_uni_streams(VarInt::from_u32(0))
        .max_idle_timeout(Some(IdleTimeout::from(IDLE_MS)))
        .send_window(SEND_WINDOW)
        .datagram_send_buffer_size(DATAGRAM_SEND_BYTES)
        .datagram_receive_buffer_size(Some(DATAGRAM_RECEIVE_BYTES));
    transport
}
