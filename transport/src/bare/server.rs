//! A bare server: takes whoever comes, and leaves all else to its caller.
//!
//! Its lines live on its thread, and end with it.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use quinn::crypto::rustls::QuicServerConfig;
use quinn::{Endpoint, EndpointConfig, ServerConfig, TokioRuntime};
use tokio::sync::oneshot;

use super::line::BareLine;
use super::terms::{BareError, BareTerms};
use crate::quic::{Certificate, Fingerprint};
use crate::socket;

/// A server that listens until it is dropped.
#[derive(Debug)]
pub struct BareServer {
    address: SocketAddr,
    fingerprint: Fingerprint,
    lines: Receiver<Result<BareLine, BareError>>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl BareServer {
    /// Listens; port 0 picks a free one.
    ///
    /// # Errors
    ///
    /// [`BareError`] says what is missing.
    pub fn listen(
        listen: SocketAddr,
        certificate: &Certificate,
        terms: &BareTerms,
    ) -> Result<Self, BareError> {
        let mut tls = Arc::unwrap_or_clone(certificate.tls());
        tls.alpn_protocols.clone_from(&terms.alpn);
        let tls =
            QuicServerConfig::try_from(tls).map_err(|cause| BareError::Tls(cause.to_string()))?;
        let mut config = ServerConfig::with_crypto(Arc::new(tls));
        config.transport_config(Arc::new(terms.transport()));
        let socket = socket::bind(listen).map_err(BareError::Host)?;
        let runtime = socket::runtime().map_err(BareError::Host)?;
        let endpoint = {
            let _inside = runtime.enter();
            let local = EndpointConfig::default();
            Endpoint::new(local, Some(config), socket, Arc::new(TokioRuntime))
                .map_err(BareError::Host)?
        };
        let address = endpoint.local_addr().map_err(BareError::Host)?;
        let (arrived, lines) = mpsc::channel();
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new()
            .name("rhumb-bare-server".into())
            .spawn(move || runtime.block_on(accept(endpoint, arrived, ended)))
            .map_err(BareError::Host)?;
        Ok(Self {
            address,
            fingerprint: certificate.fingerprint(),
            lines,
            end: Some(end),
            thread: Some(thread),
        })
    }

    /// Where it listens.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    /// What clients pin.
    #[must_use]
    pub const fn fingerprint(&self) -> Fingerprint {
        self.fingerprint
    }

    /// The next who came, or how its handshake ended; `None` when nobody did within `patience`.
    #[must_use]
    pub fn accept(&self, patience: Duration) -> Option<Result<BareLine, BareError>> {
        self.lines.recv_timeout(patience).ok()
    }
}

impl Drop for BareServer {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // Already over: nothing to end.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            tracing::error!("the bare server's i/o thread panicked");
        }
    }
}

async fn accept(
    endpoint: Endpoint,
    arrived: Sender<Result<BareLine, BareError>>,
    mut ended: oneshot::Receiver<()>,
) {
    loop {
        tokio::select! {
            _ = &mut ended => break,
            incoming = endpoint.accept() => {
                let Some(incoming) = incoming else { break };
                let arrived = arrived.clone();
                tokio::spawn(async move {
                    let line = match incoming.await {
                        Ok(connection) => Ok(BareLine::over(connection)),
                        Err(error) => Err(BareError::Handshake(error.into())),
                    };
                    // Who listens no more wants nobody.
                    let _ = arrived.send(line);
                });
            }
        }
    }
    endpoint.close(crate::quic::TransportCode::GOING_AWAY.0.into(), b"");
    let _ = tokio::time::timeout(Duration::from_millis(50), endpoint.wait_idle()).await;
}
