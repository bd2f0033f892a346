//! Raw server: accepts every connection and does nothing else.
//!
//! Its connections run on its thread and end with it.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use quinn::crypto::rustls::QuicServerConfig;
use quinn::{Endpoint, EndpointConfig, ServerConfig, TokioRuntime};
use rhumb_transport::{Certificate, Fingerprint, TransportCode, bind_udp, io_runtime};
use tokio::sync::oneshot;
use web_transport_quinn::Session;

use super::config::{RawPeerConfig, RawPeerError};
use super::connection::RawConnection;

/// A server that listens until it is dropped.
#[derive(Debug)]
pub struct RawPeerServer {
    address: SocketAddr,
    fingerprint: Fingerprint,
    connections: Receiver<Result<RawConnection, RawPeerError>>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl RawPeerServer {
    /// Listens; port 0 picks a free one.
    ///
    /// # Errors
    ///
    /// [`RawPeerError`] when the certificate, the socket or the thread is unusable.
    pub fn listen(
        listen: SocketAddr,
        certificate: &Certificate,
        raw_config: &RawPeerConfig,
    ) -> Result<Self, RawPeerError> {
        let mut tls = Arc::unwrap_or_clone(certificate.tls());
        tls.alpn_protocols.clone_from(&raw_config.alpn);
        let tls = QuicServerConfig::try_from(tls)
            .map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
        let mut config = ServerConfig::with_crypto(Arc::new(tls));
        config.transport_config(Arc::new(raw_config.transport()));
        let socket = bind_udp(listen).map_err(RawPeerError::Host)?;
        let runtime = io_runtime().map_err(RawPeerError::Host)?;
        let endpoint = {
            let _inside = runtime.enter();
            let local = EndpointConfig::default();
            Endpoint::new(local, Some(config), socket, Arc::new(TokioRuntime))
                .map_err(RawPeerError::Host)?
        };
        let address = endpoint.local_addr().map_err(RawPeerError::Host)?;
        let (arrived, connections) = mpsc::channel();
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new()
            .name("rhumb-raw-server".into())
            .spawn(move || runtime.block_on(accept(endpoint, arrived, ended)))
            .map_err(RawPeerError::Host)?;
        Ok(Self {
            address,
            fingerprint: certificate.fingerprint(),
            connections,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// The address that it listens at.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// The fingerprint for clients to pin.
    #[must_use]
    pub const fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// The next connection, or how its handshake ended; `None` when none arrives within `timeout`.
    #[must_use]
    pub fn accept(&self, timeout: Duration) -> Option<Result<RawConnection, RawPeerError>> {
        self.connections.recv_timeout(timeout).ok()
    }
}

impl Drop for RawPeerServer {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // An error means that the thread has ended already.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the raw server's I/O thread panicked");
        }
    }
}

async fn accept(
    endpoint: Endpoint,
    arrived: Sender<Result<RawConnection, RawPeerError>>,
    mut ended: oneshot::Receiver<()>,
) {
    loop {
        tokio::select! {
            _ = &mut ended => break,
            incoming = endpoint.accept() => {
                let Some(incoming) = incoming else { break };
                let arrived = arrived.clone();
                tokio::spawn(async move {
                    let connection = match incoming.await {
                        Ok(connection) => Ok(RawConnection::over(Session::raw(connection))),
                        Err(error) => Err(RawPeerError::Handshake(error.into())),
                    };
                    // A dropped server takes no connections.
                    let _ = arrived.send(connection);
                });
            }
        }
    }
    endpoint.close(TransportCode::GOING_AWAY.0.into(), b"");
    let _ = tokio::time::timeout(Duration::from_millis(50), endpoint.wait_idle()).await;
}
