//! Raw client: connects once, on its own thread.
//!
//! Verifies the server's certificate against its trust, and nothing else.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Duration;

use quinn::crypto::rustls::QuicClientConfig;
use quinn::{ClientConfig, Connecting, ConnectionError, Endpoint, EndpointConfig, TokioRuntime};
use rhumb_link::trust::client_tls;
use rhumb_link::{Trust, bind_udp, io_runtime};
use url::Url;
use web_transport_quinn::http::HeaderValue;
use web_transport_quinn::http::header::ORIGIN;
use web_transport_quinn::proto::{ConnectError as Answer, ConnectRequest};
use web_transport_quinn::{ClientError, ConnectError, Session};

use super::config::{Carrier, RawPeerConfig, RawPeerError};
use super::connection::{RawConnection, RawPeerEnd};

/// Time limit for the transmission of a close frame.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(50);

impl RawConnection {
    /// Connects to a server within `timeout`.
    ///
    /// # Errors
    ///
    /// [`RawPeerError`] when a certificate, socket or thread is unusable, or when the handshake fails.
    pub fn connect(
        server: SocketAddr,
        server_name: &str,
        trust: &Trust,
        raw_config: &RawPeerConfig,
        timeout: Duration,
    ) -> Result<Self, RawPeerError> {
        let tls = client_tls(trust).map_err(RawPeerError::Certificate)?;
        let mut tls = Arc::unwrap_or_clone(tls);
        tls.alpn_protocols.clone_from(&raw_config.alpn);
        let tls = QuicClientConfig::try_from(tls)
            .map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
        let mut config = ClientConfig::new(Arc::new(tls));
        config.transport_config(Arc::new(raw_config.transport()));
        let any: SocketAddr = match server {
            SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
            SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
        };
        let socket = bind_udp(any).map_err(RawPeerError::Host)?;
        let runtime = io_runtime().map_err(RawPeerError::Host)?;
        let (ready, connected) = mpsc::sync_channel(1);
        let name = server_name.to_owned();
        let raw_config = raw_config.clone();
        thread::Builder::new()
            .name("rhumb-raw-client".into())
            .spawn(move || {
                runtime.block_on(async move {
                    let endpoint = Endpoint::new(
                        EndpointConfig::default(),
                        None,
                        socket,
                        Arc::new(TokioRuntime),
                    );
                    let endpoint = match endpoint {
                        Ok(endpoint) => endpoint,
                        // The caller waits for the result; without a caller there is nothing to report.
                        Err(cause) => return drop(ready.send(Err(RawPeerError::Host(cause)))),
                    };
                    let connecting = async {
                        let connecting = endpoint.connect_with(config, server, &name);
                        let connecting =
                            connecting.map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
                        open(connecting, &raw_config).await
                    };
                    let late = RawPeerError::Handshake(RawPeerEnd::TimedOut);
                    let opened = tokio::time::timeout(timeout, connecting).await;
                    carry(&endpoint, opened.unwrap_or(Err(late)), &ready).await;
                });
            })
            .map_err(RawPeerError::Host)?;
        let thread_ended = |_| RawPeerError::Host(std::io::Error::other("its thread ended"));
        connected.recv().map_err(thread_ended)?
    }
}

/// Opens what carries the control stream and the datagrams.
async fn open(connecting: Connecting, raw_config: &RawPeerConfig) -> Result<Session, RawPeerError> {
    let ended = |error: ConnectionError| RawPeerError::Handshake(RawPeerEnd::from(error));
    let connection = connecting.await.map_err(ended)?;
    match raw_config.carrier {
        Carrier::Quic => Ok(Session::raw(connection)),
        Carrier::WebTransport => {
            let url = format!("https://{}{}", connection.remote_address(), raw_config.path);
            let url = Url::parse(&url).map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
            let mut request = ConnectRequest::new(url);
            if let Some(origin) = &raw_config.origin {
                let origin = HeaderValue::from_str(origin);
                let origin = origin.map_err(|cause| RawPeerError::Tls(cause.to_string()))?;
                request = request.with_header(ORIGIN, origin);
            }
            let session = Session::connect(connection.clone(), request).await;
            session.map_err(|cause| match (&cause, connection.close_reason()) {
                // A status says more than the end of the connection behind it.
                (ClientError::HttpError(ConnectError::ProtoError(Answer::WrongStatus(_))), _)
                | (_, None) => RawPeerError::Handshake(RawPeerEnd::Fault(cause.to_string())),
                (_, Some(reason)) => ended(reason),
            })
        }
    }
}

/// Hands an opened connection over, and stays until it has ended.
async fn carry(
    endpoint: &Endpoint,
    opened: Result<Session, RawPeerError>,
    ready: &mpsc::SyncSender<Result<RawConnection, RawPeerError>>,
) {
    let session = match opened {
        Ok(session) => session,
        Err(error) => return drop(ready.send(Err(error))),
    };
    if ready
        .send(Ok(RawConnection::over(session.clone())))
        .is_err()
    {
        return;
    }
    session.closed().await;
    // If the frame does not leave in time, the server's idle timeout ends the connection.
    let _ = tokio::time::timeout(CLOSE_TIMEOUT, endpoint.wait_idle()).await;
}
