//! QUIC server: bound here, run by the thread that owns the endpoint.
//!
//! Neither interprets the protocol nor steps a world. The caller's thread feeds the endpoint; a second one owns the
//! sockets.

use std::net::SocketAddr;
use std::sync::{Arc, mpsc};
use std::thread::JoinHandle;
use std::time::Duration;
use std::{fmt, io, thread};

use quinn::crypto::rustls::{NoInitialCipherSuite, QuicServerConfig};
use quinn::rustls::crypto::CryptoProvider;
use quinn::{ConnectionId, ConnectionIdGenerator, EndpointConfig, TokioRuntime, crypto, rustls};
use rhumb_link::tuning::ClientStreams;
use rhumb_link::{CertificateError, Fingerprint, bind_udp, io_runtime, tuning};
use rhumb_protocol::Endpoint;
use tokio::sync::oneshot;

use crate::certificate::{
    Certificate, CertificateHashes, HandshakeCertificate, WebOptions, server_tls,
};
use crate::reset_stream_at::PartialResetConfig;
use crate::server_io;
use crate::server_loop::{
    EndpointLoop, Input, ServeError, ServerStatistics, ServerWatch, Stop, Waker,
};

/// Address and certificate of a server, and what it has for browsers.
#[derive(Clone, Debug)]
pub struct ServerOptions {
    /// The UDP address; port 0 picks a free one.
    pub listen: SocketAddr,
    /// The server's certificate.
    pub certificate: Certificate,
    /// Its options for browsers; `None`: they find no server.
    pub web: Option<WebOptions>,
}

impl ServerOptions {
    /// A server without anything for browsers.
    #[must_use]
    pub const fn new(listen: SocketAddr, certificate: Certificate) -> Self {
        Self {
            listen,
            certificate,
            web: None,
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
                &[tuning::DRAFT_ALPN, tuning::ALPN, tuning::WEB_ALPN],
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
    wake: mpsc::Sender<Input>,
    waker: Waker,
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
struct CloseOnDrop(mpsc::Sender<Input>);

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
        } = options;
        let origins = web.map(|web| Arc::new(web.origins));
        let address = |cause| BindError::Address { listen, cause };
        let provider = Arc::clone(tls.config.crypto_provider());
        let mut local = EndpointConfig::new(Arc::new(certificate.reset_key()));
        local.cid_generator(move || Box::new(Short::new(Arc::clone(&provider))));
        let crypto = tls.crypto().map_err(BindError::Tls)?;
        let config = tuning::server(crypto, tls.streams);
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
        let watch = ServerWatch::default();
        let thread = thread::Builder::new()
            .name("rhumb-server-io".into())
            .spawn({
                let (server_loop, watch) = (wake.clone(), watch.clone());
                move || {
                    let _last_word = CloseOnDrop(server_loop.clone());
                    runtime.block_on(server_io::accept(
                        endpoint,
                        origins,
                        server_loop,
                        watch,
                        ended,
                    ));
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
        let mut server_loop =
            EndpointLoop::new(self.inputs, self.waker.clone(), self.watch.clone());
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
/// an id gains nothing, since every packet is authenticated. With some 5,000 in use at most, one draw in a million is repeated.
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
