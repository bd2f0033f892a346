//! QUIC server: bound here, run by the thread that owns the endpoint.
//!
//! Neither interprets the protocol nor steps a world. The caller's thread feeds the endpoint; a second one owns the
//! sockets.
//!
//! Interprets nothing. Inputs are bounded per connection and lane; a full server refuses attempts at the listener.
//! Connections and attempts of each address are bounded, so that one address cannot take all connections of a server.

use std::any::Any;
use std::collections::BTreeMap;
use std::net::{IpAddr, SocketAddr};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{self, Sender};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;
use std::{fmt, io};

use quinn::crypto::rustls::{HandshakeData, NoInitialCipherSuite, QuicServerConfig};
use quinn::rustls::crypto::CryptoProvider;
use quinn::{
    Connecting, Connection, ConnectionError, ConnectionId, ConnectionIdGenerator, EndpointConfig,
    Incoming, ReadError, RecvStream, SendStream, TokioRuntime, VarInt, crypto, rustls,
};
use rhumb_link::connection::{CarriedSession, Closing, ControlWriter, control_queue};
use rhumb_link::tuning::{
    self, CONNECTIONS_MAX, CONNECTIONS_PER_ADDRESS_MAX, ClientStreams, DATAGRAM_BYTES_MIN,
    HANDSHAKES_UNPROVEN_MAX, SETUP, STATE_IN_FLIGHT_BYTES, WEB_ALPN,
};
use rhumb_link::{
    ByteCredit, CONTROL_IN_FLIGHT_BYTES, CertificateError, Fingerprint, IdleLimit, Piece, bind_udp,
    io_runtime,
};
use rhumb_protocol::limits::DATAGRAM_BYTES_MAX;
use rhumb_protocol::session::TransportCode;
use rhumb_protocol::{Endpoint, Peer};
use tokio::sync::oneshot;
use tokio::time::{sleep, timeout};

use crate::certificate::{
    Certificate, CertificateHashes, HandshakeCertificate, WebOptions, server_tls,
};
use crate::reset_stream_at::PartialResetConfig;
use crate::server_loop::{
    BATCHES_WAITING, DatagramLane, EndpointLoop, Input, PeerHandles, ServeError, ServerStatistics,
    ServerWatch, StateDatagram, Stop, Waker, send_batches,
};
use crate::web_request::Origins;
use crate::web_session::{SentSettings, WebRefusal, WebSession, send_settings};

/// Address and certificate of a server, and what it has for browsers.
#[derive(Clone, Debug)]
pub struct ServerOptions {
    /// The UDP address; port 0 picks a free one.
    pub listen: SocketAddr,
    /// The server's certificate.
    pub certificate: Certificate,
    /// Its options for browsers; `None`: they find no server.
    pub web: Option<WebOptions>,
    /// The silence after which its clients consider it lost.
    pub idle_limit: IdleLimit,
}

impl ServerOptions {
    /// A server without anything for browsers.
    #[must_use]
    pub const fn new(listen: SocketAddr, certificate: Certificate) -> Self {
        Self {
            listen,
            certificate,
            web: None,
            idle_limit: IdleLimit::Usual,
        }
    }

    /// The certificates to serve with, the protocols, and what else a browser needs.
    fn tls(&self) -> Result<TlsSide, CertificateError> {
        let Some(web) = &self.web else {
            return Ok(TlsSide {
                config: self.certificate.tls(),
                streams: ClientStreams::PLAIN,
                hashes: CertificateHashes::none(),
            });
        };
        let hashes = web.certificate.hashes()?;
        let resolver = HandshakeCertificate::new(self.certificate.key(), hashes.clone());
        Ok(TlsSide {
            config: server_tls(
                Arc::new(resolver),
                &[tuning::DRAFT_ALPN, tuning::ALPN, WEB_ALPN],
            ),
            streams: ClientStreams::WEB,
            hashes,
        })
    }
}

/// The TLS configuration of a server, and what follows from it.
struct TlsSide {
    config: Arc<rustls::ServerConfig>,
    streams: ClientStreams,
    hashes: CertificateHashes,
}

impl TlsSide {
    /// The TLS side of QUIC: browsers may ask for what QUIC's library has not.
    fn crypto(&self) -> Result<Arc<dyn crypto::ServerConfig>, NoInitialCipherSuite> {
        let tls = Arc::clone(&self.config);
        Ok(match self.streams == ClientStreams::WEB {
            true => Arc::new(PartialResetConfig::new(tls)?),
            false => Arc::new(QuicServerConfig::try_from(tls)?),
        })
    }
}

/// A server that is bound but not yet running. Clients can connect already; they wait.
#[derive(Debug)]
pub struct QuicServer {
    local_addr: SocketAddr,
    fingerprint: Fingerprint,
    hashes: CertificateHashes,
    inputs: mpsc::Receiver<Input>,
    wake: Sender<Input>,
    waker: Waker,
    /// Takes the datagrams of each drain to the I/O thread.
    batches: tokio::sync::mpsc::Sender<Vec<StateDatagram>>,
    watch: ServerWatch,
    io: IoThread,
}

/// Reason why a server cannot listen.
#[derive(Debug)]
pub enum BindError {
    /// The address cannot be bound.
    Address {
        /// The address.
        listen: SocketAddr,
        /// The system's error.
        cause: io::Error,
    },
    /// The certificate's TLS configuration has no cipher suite that QUIC starts with.
    Tls(NoInitialCipherSuite),
    /// No certificate can be made for browsers.
    Certificate(CertificateError),
    /// The I/O thread cannot start.
    Thread(io::Error),
}

/// The thread of the sockets; it ends when this is dropped.
#[derive(Debug)]
struct IoThread {
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

/// Reports the end of the I/O thread to the server loop, on every path.
#[derive(Debug)]
struct CloseOnDrop(Sender<Input>);

impl QuicServer {
    /// Binds the address and starts the I/O thread.
    ///
    /// # Errors
    ///
    /// [`BindError`] names the address or the thread that failed.
    pub fn bind(options: ServerOptions) -> Result<Self, BindError> {
        let tls = options.tls().map_err(BindError::Certificate)?;
        let ServerOptions {
            listen,
            certificate,
            web,
            idle_limit,
        } = options;
        let origins = web.map(|web| Arc::new(web.origins));
        let address = |cause| BindError::Address { listen, cause };
        let provider = Arc::clone(tls.config.crypto_provider());
        let mut local = EndpointConfig::new(Arc::new(certificate.reset_key()));
        local.cid_generator(move || Box::new(Short::new(Arc::clone(&provider))));
        let crypto = tls.crypto().map_err(BindError::Tls)?;
        let config = tuning::server(crypto, tls.streams, idle_limit);
        let socket = bind_udp(listen).map_err(address)?;
        let runtime = io_runtime().map_err(BindError::Thread)?;
        let endpoint = {
            let _inside = runtime.enter();
            quinn::Endpoint::new(local, Some(config), socket, Arc::new(TokioRuntime))
                .map_err(address)?
        };
        let local_addr = endpoint.local_addr().map_err(address)?;
        let (wake, inputs) = mpsc::channel();
        let (end, ended) = oneshot::channel();
        let (batches, sent) = tokio::sync::mpsc::channel(BATCHES_WAITING);
        let watch = ServerWatch::default();
        let thread = thread::Builder::new()
            .name("rhumb-server-io".into())
            .spawn({
                let (server_loop, watch) = (wake.clone(), watch.clone());
                move || {
                    let _last_word = CloseOnDrop(server_loop.clone());
                    runtime.spawn(send_batches(sent, watch.clone()));
                    runtime.block_on(accept(endpoint, origins, server_loop, watch, ended));
                }
            })
            .map_err(BindError::Thread)?;
        Ok(Self {
            local_addr,
            fingerprint: certificate.fingerprint(),
            hashes: tls.hashes,
            inputs,
            waker: Waker::new(wake.clone()),
            wake,
            batches,
            watch,
            io: IoThread {
                end: Some(end),
                thread: Some(thread),
            },
        })
    }

    /// The address that clients connect to.
    #[must_use]
    pub fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// The fingerprint for clients to pin.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// The hashes of the certificates that browsers are shown, for pages to pin.
    #[must_use]
    pub fn certificate_hashes(&self) -> CertificateHashes {
        self.hashes.clone()
    }

    /// Counters of the server that outlive the call of [`run`](Self::run).
    #[must_use]
    pub fn watch(&self) -> ServerWatch {
        self.watch.clone()
    }

    /// Wakes the thread that runs the server, from other threads that the endpoint has.
    #[must_use]
    pub fn waker(&self) -> Waker {
        self.waker.clone()
    }

    /// Feeds and drains `endpoint` on the calling thread until `stop` is requested.
    ///
    /// Exactly one `handle_ended` follows every `handle_opened`, unless the server stops first. A connection that the
    /// endpoint or the driver closed ends as `Closed` with that code; after `Close` its end is the only further input.
    /// After a stop the endpoint gets no further inputs; its peers see [`TransportCode::GOING_AWAY`].
    ///
    /// [`TransportCode::GOING_AWAY`]: rhumb_protocol::session::TransportCode::GOING_AWAY
    ///
    /// # Errors
    ///
    /// [`ServeError`] if the I/O thread has ended.
    pub fn run<E: Endpoint>(
        self,
        endpoint: &mut E,
        stop: &Stop,
    ) -> Result<ServerStatistics, ServeError> {
        let wake = self.wake.clone();
        // If the server loop has ended, there is nothing to wake.
        stop.on_stop(move || drop(wake.send(Input::Stop)));
        let (waker, watch) = (self.waker.clone(), self.watch.clone());
        let mut server_loop = EndpointLoop::new(self.inputs, waker, self.batches, watch);
        let outcome = server_loop.run(endpoint);
        server_loop.close_all();
        drop(self.io);
        outcome.map(|()| self.watch.statistics())
    }
}

impl Drop for CloseOnDrop {
    fn drop(&mut self) {
        // If the server loop has ended, there is nothing to report.
        let _ = self.0.send(Input::IoOver);
    }
}

impl Drop for IoThread {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the server's i/o thread panicked");
        }
    }
}

/// Bytes of a connection's id: packets to a server need one, so that a connection survives a change of address. Guessing
/// an id gains nothing, since every packet is authenticated. With some 5,000 in use at most, one draw in a million is
/// repeated.
const SERVER_ID_BYTES: usize = 4;

/// Generates random ids.
struct Short {
    provider: Arc<CryptoProvider>,
}

impl Short {
    /// Uses the provider's random numbers.
    const fn new(provider: Arc<CryptoProvider>) -> Self {
        Self { provider }
    }
}

impl ConnectionIdGenerator for Short {
    fn generate_cid(&mut self) -> ConnectionId {
        let mut bytes = [0; SERVER_ID_BYTES];
        let filled = self.provider.secure_random.fill(&mut bytes);
        filled.expect("a system that made a TLS key has random numbers");
        ConnectionId::new(&bytes)
    }

    fn cid_len(&self) -> usize {
        SERVER_ID_BYTES
    }

    fn cid_lifetime(&self) -> Option<Duration> {
        None
    }
}

impl fmt::Display for BindError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address { listen, cause } => {
                write!(
                    f,
                    "cannot listen on udp {listen}: {cause}; choose another address or port 0"
                )
            }
            Self::Tls(cause) => write!(f, "cannot serve quic with this tls configuration: {cause}"),
            Self::Certificate(cause) => cause.fmt(f),
            Self::Thread(cause) => write!(f, "cannot start the server's i/o thread: {cause}"),
        }
    }
}

impl std::error::Error for BindError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            Self::Address { cause, .. } | Self::Thread(cause) => Some(cause),
            Self::Tls(cause) => Some(cause),
            Self::Certificate(cause) => Some(cause),
        }
    }
}

/// Accepts until its end is requested, then refuses the attempts that still arrive.
///
/// `origins`: the pages that may connect; `None`: no browser.
pub(crate) async fn accept(
    endpoint: quinn::Endpoint,
    origins: Option<Arc<Origins>>,
    inputs: Sender<Input>,
    watch: ServerWatch,
    mut ended: oneshot::Receiver<()>,
) {
    let handshakes = Arc::new(AtomicUsize::new(0));
    let addresses = Addresses::default();
    let mut peers = 0;
    loop {
        let incoming = tokio::select! {
            incoming = endpoint.accept() => incoming,
            _ = &mut ended => break,
        };
        let Some(incoming) = incoming else { break };
        let Some(place) = addresses.take(incoming.remote_address().ip().to_canonical()) else {
            watch.count(|counters| &counters.refused);
            incoming.refuse();
            continue;
        };
        let Some(connecting) = admit(&endpoint, incoming, &handshakes, &watch) else {
            continue;
        };
        let peer = Peer(peers);
        peers += 1;
        handshakes.fetch_add(1, Ordering::Relaxed);
        let (inputs, watch, handshakes) = (inputs.clone(), watch.clone(), Arc::clone(&handshakes));
        let origins = origins.clone();
        tokio::spawn(async move {
            let connected = timeout(SETUP, establish(connecting, origins.is_some())).await;
            handshakes.fetch_sub(1, Ordering::Relaxed);
            match connected {
                Ok(Ok(connection)) => greet(connection, origins, peer, inputs, watch).await,
                Ok(Err(cause)) => tracing::debug!(peer = peer.0, %cause, "handshake failed"),
                Err(_) => tracing::debug!(peer = peer.0, "handshake took too long"),
            }
            drop(place);
        });
    }
    endpoint.close(VarInt::from_u32(TransportCode::GOING_AWAY.0), b"");
    // Every connection's task gets a turn to send its close frame, those in a handshake too.
    sleep(LAST_TURN).await;
}

/// Accepts an attempt, demands proof of its address when many wait, or refuses it when the server is full.
fn admit(
    endpoint: &quinn::Endpoint,
    incoming: Incoming,
    handshakes: &AtomicUsize,
    watch: &ServerWatch,
) -> Option<Connecting> {
    if endpoint.open_connections() >= CONNECTIONS_MAX {
        watch.count(|counters| &counters.refused);
        incoming.refuse();
        return None;
    }
    if handshakes.load(Ordering::Relaxed) >= HANDSHAKES_UNPROVEN_MAX
        && !incoming.remote_address_validated()
        && incoming.may_retry()
    {
        // The attempt may retry, so that this call cannot fail.
        let _ = incoming.retry();
        return None;
    }
    match incoming.accept() {
        Ok(connecting) => Some(connecting),
        Err(cause) => {
            tracing::debug!(%cause, "attempt failed at once");
            None
        }
    }
}

/// A connection, and what it has for a browser if it is one of HTTP/3.
struct Established {
    connection: Connection,
    settings: Option<Result<SentSettings, WebRefusal>>,
}

/// Waits for the handshake. A connection of HTTP/3 is sent this end's settings in the first flight: the client needs
/// them before it requests a session.
async fn establish(
    mut connecting: Connecting,
    serves_web: bool,
) -> Result<Established, ConnectionError> {
    let is_web = is_web(connecting.handshake_data().await?);
    if !serves_web || !is_web {
        return Ok(Established {
            connection: connecting.await?,
            settings: None,
        });
    }
    let early = connecting.into_0rtt();
    let (connection, established) = early.unwrap_or_else(|_| unreachable!("a server may"));
    let settings = send_settings(&connection).await;
    established.await;
    match connection.close_reason() {
        Some(reason) => Err(reason),
        None => Ok(Established {
            connection,
            settings: Some(settings),
        }),
    }
}

/// Serves a plain client at once, and a browser once its page has a session.
async fn greet(
    established: Established,
    origins: Option<Arc<Origins>>,
    peer: Peer,
    inputs: Sender<Input>,
    watch: ServerWatch,
) {
    let Established {
        connection,
        settings,
    } = established;
    let (Some(settings), Some(origins)) = (settings, origins) else {
        return serve(connection, None, peer, inputs, watch).await;
    };
    let session = async { WebSession::accept(&connection, settings?, &origins).await };
    match timeout(SETUP, session).await {
        Ok(Ok(session)) => {
            serve(connection, Some(Arc::new(session)), peer, inputs, watch).await;
        }
        Ok(Err(cause)) => {
            match cause.foreign_origin() {
                Some(origin) => {
                    tracing::info!(
                        peer = peer.0,
                        origin,
                        "refused a page: its origin is not allowed"
                    );
                    watch.count(|counters| &counters.refused);
                }
                None => tracing::debug!(peer = peer.0, %cause, "no webtransport session"),
            }
            connection.close(VarInt::from_u32(TransportCode::LEFT.0), b"");
        }
        Err(_) => {
            tracing::debug!(peer = peer.0, "the webtransport session took too long");
            connection.close(VarInt::from_u32(TransportCode::NO_CONTROL_STREAM.0), b"");
        }
    }
}

/// True for the handshake of a connection of HTTP/3.
fn is_web(handshake: Box<dyn Any>) -> bool {
    let data = handshake.downcast::<HandshakeData>();
    data.is_ok_and(|data| data.protocol.as_deref() == Some(WEB_ALPN))
}

/// Carries one connection from start to end.
async fn serve(
    connection: Connection,
    web: Option<Arc<WebSession>>,
    peer: Peer,
    inputs: Sender<Input>,
    watch: ServerWatch,
) {
    let carried = web.clone().map(|web| web as Arc<dyn CarriedSession>);
    let closing = Closing::of(&connection, carried);
    let datagrams = Arc::new(DatagramLane::new(connection.clone(), web.clone()));
    let least = match web {
        None => DATAGRAM_BYTES_MIN,
        Some(_) => DATAGRAM_BYTES_MAX,
    };
    if datagrams.largest().is_none_or(|bytes| bytes < least) {
        closing.now(TransportCode::NO_DATAGRAMS.0);
        return run_session(web.as_deref(), &closing).await;
    }
    let is_web = web.is_some();
    tracing::debug!(peer = peer.0, address = %connection.remote_address(), is_web, "opened");
    watch.opened(peer, connection.clone());
    let (control, writer) = control_queue();
    let handles = PeerHandles {
        datagrams: Arc::clone(&datagrams),
        control,
        closing: Arc::clone(&closing),
    };
    // If the server thread has ended, this thread ends soon too.
    let _ = inputs.send(Input::Opened { peer, handles });
    let streams = PeerStreams {
        connection: &connection,
        web: web.as_deref(),
        peer,
        inputs: &inputs,
        closing: &closing,
    };
    tokio::join!(
        streams.carry_control(writer),
        streams.refuse_unidirectional(),
        carry_state(&datagrams, peer, &inputs, &watch),
        run_session(web.as_deref(), &closing),
    );
    let ending = closing.ended().await;
    tracing::debug!(peer = peer.0, ?ending, "ended");
    watch.ended(peer);
    let _ = inputs.send(Input::Ended { peer, ending });
}

/// Ends the session of a browser, if the connection has one, when either end closes it.
async fn run_session(web: Option<&WebSession>, closing: &Closing) {
    if let Some(web) = web {
        web.run(|code| closing.close_connection(code)).await;
    }
}

/// The streams of one connection.
struct PeerStreams<'a> {
    connection: &'a Connection,
    web: Option<&'a WebSession>,
    peer: Peer,
    inputs: &'a Sender<Input>,
    closing: &'a Closing,
}

impl PeerStreams<'_> {
    /// Both directions of the control stream, from its opening.
    async fn carry_control(&self, mut writer: ControlWriter) {
        let opened = tokio::select! {
            opened = timeout(SETUP, self.next()) => opened,
            () = self.closing.flush_requested() => return self.closing.finish(),
        };
        match opened {
            Ok(Some((mut send, recv))) => {
                tokio::join!(
                    writer.run(self.closing, &mut send, || {
                        // If the server thread has ended, this thread ends soon too.
                        let _ = self.inputs.send(Input::ControlTaken { peer: self.peer });
                    }),
                    self.read_control(recv),
                    self.refuse_streams(),
                );
            }
            Ok(None) => {}
            Err(_) => self.closing.now(TransportCode::NO_CONTROL_STREAM.0),
        }
    }

    /// The next bidirectional stream of the client; `None` after the end of the connection.
    async fn next(&self) -> Option<(SendStream, RecvStream)> {
        match self.web {
            None => self.connection.accept_bi().await.ok(),
            Some(web) => web.accept_bi().await,
        }
    }

    /// Stops each further stream of the client: the protocol has none.
    async fn refuse_streams(&self) {
        while let Some(stray) = self.next().await {
            drop(stray);
        }
    }

    /// Stops unidirectional streams of a plain client; those of a browser belong to its session.
    async fn refuse_unidirectional(&self) {
        if self.web.is_none() {
            while let Ok(stray) = self.connection.accept_uni().await {
                drop(stray);
            }
        }
    }

    /// Reads no further than the server thread keeps up: QUIC's flow control then slows the client down.
    async fn read_control(&self, mut stream: RecvStream) {
        let credit = ByteCredit::new(CONTROL_IN_FLIGHT_BYTES);
        let peer = self.peer;
        loop {
            match stream.read_chunk(READ_BYTES_MAX, true).await {
                Ok(Some(chunk)) => {
                    let piece = self.admit(&credit, &chunk.bytes).await;
                    if self.inputs.send(Input::Control { peer, piece }).is_err() {
                        return;
                    }
                }
                // The client has finished its stream; its close follows.
                Ok(None) | Err(ReadError::ConnectionLost(_)) => return,
                Err(ReadError::Reset(code)) => return self.closing.control_broke(code).await,
                Err(_) => return self.closing.now(TransportCode::NO_CONTROL_STREAM.0),
            }
        }
    }

    /// Waits until the bound allows the bytes, or until the connection has ended.
    ///
    /// The server thread holds bytes back until it learns of the end, which comes after the last of them. What has
    /// arrived before the end is a window of the stream at most, and needs no other bound.
    async fn admit(&self, credit: &ByteCredit, bytes: &[u8]) -> Piece {
        tokio::select! {
            biased;
            piece = credit.admit(bytes) => piece,
            _ = self.closing.ended() => Piece::without_share(bytes),
        }
    }
}

async fn carry_state(
    datagrams: &DatagramLane,
    peer: Peer,
    inputs: &Sender<Input>,
    watch: &ServerWatch,
) {
    let credit = ByteCredit::new(STATE_IN_FLIGHT_BYTES);
    while let Some(bytes) = datagrams.read().await {
        match credit.try_admit(&bytes) {
            Some(piece) => {
                if inputs.send(Input::State { peer, piece }).is_err() {
                    return;
                }
            }
            None => watch.count(|counters| &counters.state_dropped),
        }
    }
}

/// Long enough for a turn of each task, short enough not to delay a stop.
const LAST_TURN: Duration = Duration::from_millis(2);

/// Bytes of one read of the control stream, at most.
const READ_BYTES_MAX: usize = 64 << 10;

/// Counts connections by address; all clones are one count.
#[derive(Clone, Debug, Default)]
struct Addresses {
    counts: Arc<Mutex<BTreeMap<IpAddr, usize>>>,
}

/// The place of one connection; dropping it frees the place.
#[derive(Debug)]
struct AddressPlace {
    address: IpAddr,
    addresses: Addresses,
}

impl Addresses {
    /// A place for another connection from this address; `None` if it has as many as it may.
    pub(crate) fn take(&self, address: IpAddr) -> Option<AddressPlace> {
        let mut counts = self.counts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(address).or_insert(0);
        if *count >= CONNECTIONS_PER_ADDRESS_MAX {
            return None;
        }
        *count += 1;
        Some(AddressPlace {
            address,
            addresses: self.clone(),
        })
    }
}

impl Drop for AddressPlace {
    fn drop(&mut self) {
        let counts = &self.addresses.counts;
        let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(count) = counts.get_mut(&self.address) {
            *count -= 1;
            if *count == 0 {
                counts.remove(&self.address);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_address_leaves_places_for_others_and_gets_its_own_back() {
        let addresses = Addresses::default();
        let [one, other] = [1, 2].map(|last| IpAddr::from([127, 0, 0, last]));
        let mut places: Vec<_> = std::iter::from_fn(|| addresses.take(one)).collect();
        assert_eq!(places.len(), CONNECTIONS_PER_ADDRESS_MAX);
        assert!(addresses.take(other).is_some());
        places.pop();
        assert!(addresses.take(one).is_some());
        drop(places);
        assert!(addresses.counts.lock().expect("no panic").is_empty());
    }
}
