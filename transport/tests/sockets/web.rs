//! Sessions of WebTransport on the server's own port.
//!
//! The client's end shares no code with the server's but the codec of frames.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread::{self, JoinHandle};

use bytes::Bytes;
use quinn::crypto::rustls::QuicClientConfig;
use rhumb_protocol::{Ending, Endpoint};
use rhumb_transport::{
    Certificate, CertificateHashes, ClientOptions, Fingerprint, Origins, QuicClient, QuicServer,
    ServeError, ServerOptions, ServerStatistics, Stop, Trust, WebIdentity, WebOptions,
};
use tokio::runtime::Runtime;
use web_transport_quinn::http::HeaderValue;
use web_transport_quinn::http::header::ORIGIN;
use web_transport_quinn::proto::ConnectRequest;
use web_transport_quinn::{Session, SessionError, WebTransportError};

use crate::support::{Echo, Event, TIMEOUT, Unwilling};

/// A server for browsers, and what a test needs of it.
pub(crate) struct WebServer {
    pub(crate) address: SocketAddr,
    fingerprint: Fingerprint,
    pub(crate) hashes: CertificateHashes,
    pub(crate) events: Receiver<Event>,
    stop: Stop,
    thread: Option<JoinHandle<Result<ServerStatistics, ServeError>>>,
}

impl Drop for WebServer {
    fn drop(&mut self) {
        self.stop.stop();
        if let Some(thread) = self.thread.take() {
            let served = thread.join().expect("the server thread returns");
            // A failed test must not abort by a second panic.
            assert!(served.is_ok() || thread::panicking(), "{served:?}");
        }
    }
}

pub(crate) fn serve(origins: Origins) -> WebServer {
    let (sender, events) = channel();
    serve_endpoint(origins, Echo::new(sender), events)
}

fn serve_endpoint<E: Endpoint + Send + 'static>(
    origins: Origins,
    mut endpoint: E,
    events: Receiver<Event>,
) -> WebServer {
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let certificate = Certificate::development(["localhost"]).expect("localhost is a name");
    let server = QuicServer::bind(ServerOptions {
        web: Some(WebOptions {
            origins,
            certificate: WebIdentity::Pinned(vec!["localhost".into()]),
        }),
        ..ServerOptions::new(listen, certificate)
    });
    let server = server.expect("a free port is bound");
    let hashes = server.certificate_hashes();
    let (address, fingerprint) = (server.local_addr(), server.fingerprint());
    let stop = Stop::new();
    let thread = thread::spawn({
        let stop = stop.clone();
        move || server.run(&mut endpoint, &stop)
    });
    WebServer {
        address,
        fingerprint,
        hashes,
        events,
        stop,
        thread: Some(thread),
    }
}

impl WebServer {
    /// Connects as a browser does for a page of an origin.
    async fn connect(&self, path: &str, origin: Option<&str>) -> Option<Session> {
        self.connect_pinned(self.hashes.current()[0], path, origin)
            .await
    }

    pub(crate) async fn open(
        &self,
        pinned: Fingerprint,
        protocol: &[u8],
    ) -> Option<quinn::Connection> {
        self.open_through(self.address, pinned, protocol).await
    }

    /// Connects through another address.
    pub(crate) async fn open_through(
        &self,
        address: SocketAddr,
        pinned: Fingerprint,
        protocol: &[u8],
    ) -> Option<quinn::Connection> {
        let tls =
            rhumb_link::trust::client_tls(&Trust::Fingerprint(pinned)).expect("a fingerprint");
        let mut tls = Arc::unwrap_or_clone(tls);
        tls.alpn_protocols = vec![protocol.to_vec()];
        let tls = QuicClientConfig::try_from(tls).expect("TLS 1.3");
        let config = quinn::ClientConfig::new(Arc::new(tls));
        let endpoint = quinn::Endpoint::client((Ipv4Addr::LOCALHOST, 0).into()).expect("a socket");
        let connecting = endpoint.connect_with(config, address, "localhost");
        connecting.expect("an address").await.ok()
    }

    async fn connect_pinned(
        &self,
        pinned: Fingerprint,
        path: &str,
        origin: Option<&str>,
    ) -> Option<Session> {
        let connection = self.open(pinned, b"h3").await?;
        let url = format!("https://{}{path}", self.address);
        let mut request = ConnectRequest::new(url.parse::<url::Url>().expect("an address"));
        if let Some(origin) = origin {
            let origin = HeaderValue::from_str(origin).expect("a header");
            request = request.with_header(ORIGIN, origin);
        }
        Session::connect(connection, request).await.ok()
    }
}

pub(crate) fn runtime() -> Runtime {
    tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime")
}

pub(crate) const PATH: &str = "/rhumb/1";

/// The code that a session was closed with.
async fn code(session: &Session) -> Option<u32> {
    let closed = tokio::time::timeout(TIMEOUT, session.closed()).await;
    match closed.expect("the server closes") {
        SessionError::WebTransportError(WebTransportError::Closed(code, _)) => Some(code),
        _ => None,
    }
}

/// The next end that a server reports.
pub(crate) async fn ending(server: &WebServer) -> Ending {
    let end = async {
        loop {
            match server.events.try_recv() {
                Ok(Event::Ended(_, ending)) => return ending,
                Ok(_) => {}
                Err(_) => tokio::task::yield_now().await,
            }
        }
    };
    tokio::time::timeout(TIMEOUT, end).await.expect("an end")
}

#[test]
fn a_session_carries_both_lanes_and_the_servers_close_code() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        let session = server.connect(PATH, Some("http://localhost:8080")).await;
        let session = session.expect("a page of this machine connects");
        let (mut send, mut recv) = session.open_bi().await.expect("the control stream");
        send.write_all(b"abc").await.expect("it is open");
        let mut echo = [0; 3];
        recv.read_exact(&mut echo).await.expect("the echo");
        assert_eq!(&echo, b"abc");
        for length in [0, 1, 1_150] {
            let datagram = Bytes::from(vec![7; length]);
            session.send_datagram(datagram.clone()).expect("it fits");
            assert_eq!(session.read_datagram().await.expect("the echo"), datagram);
        }
        send.write_all(b"!").await.expect("it is open");
        let mut bye = [0; 3];
        recv.read_exact(&mut bye).await.expect("the last bytes");
        assert_eq!((&bye, code(&session).await), (b"bye", Some(7)));
    });
    let events: Vec<_> = server.events.iter().take(2).collect();
    assert!(
        matches!(events[..], [Event::Opened(one), Event::Ended(other, Ending::Closed(7))] if one == other),
        "{events:?}"
    );
}

#[test]
fn a_close_code_of_a_page_arrives_and_a_page_that_leaves_has_left() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        for (close, expected) in [(Some(9), 9), (None, 0x100)] {
            let session = server.connect(PATH, None).await.expect("no origin");
            match close {
                Some(code) => session.close(code, b"done"),
                None => drop(session),
            }
            assert_eq!(ending(&server).await, Ending::Closed(expected));
        }
    });
}

#[test]
fn a_page_that_closes_while_its_bytes_wait_ends() {
    let (sender, events) = channel();
    let server = serve_endpoint(Origins::loopback(), Unwilling::new(sender), events);
    runtime().block_on(async {
        let session = server.connect(PATH, None).await.expect("no origin");
        let (mut send, _recv) = session.open_bi().await.expect("the control stream");
        // More than flow control lets arrive: the client's own queue takes the rest.
        let bytes = vec![0; 700 << 10];
        let taken = || quinn::Connection::stats(&session).udp_tx.bytes;
        let sent = async {
            while taken() < 400 << 10 {
                tokio::task::yield_now().await;
            }
        };
        tokio::select! {
            written = send.write_all(&bytes) => panic!("the server takes all: {written:?}"),
            sent = tokio::time::timeout(TIMEOUT, sent) => {
                assert!(sent.is_ok(), "the server takes more than {} bytes", taken());
            }
        }
        session.close(9, b"done");
        assert_eq!(ending(&server).await, Ending::Closed(9));
    });
}

#[test]
fn a_page_of_another_origin_has_no_session_unless_it_is_allowed() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        let session = server.connect(PATH, Some("https://example.org")).await;
        assert!(session.is_none());
    });
    assert!(
        server.events.try_recv().is_err(),
        "the endpoint saw nothing"
    );
    let allowed = serve(
        ["https://example.org".parse().unwrap()]
            .into_iter()
            .collect(),
    );
    runtime().block_on(async {
        let session = allowed.connect(PATH, Some("https://example.org")).await;
        assert!(session.is_some());
    });
}

#[test]
fn browsers_are_shown_a_certificate_of_their_own() {
    let server = serve(Origins::loopback());
    let own = server.fingerprint;
    let hashes = server.hashes.current();
    assert!(hashes.len() == 2 && !hashes.contains(&own), "{hashes:?}");
    runtime().block_on(async {
        assert!(server.connect_pinned(own, PATH, None).await.is_none());
        assert!(server.connect_pinned(hashes[1], PATH, None).await.is_none());
    });
    let plain = ClientOptions::new(server.address, Trust::Fingerprint(own));
    QuicClient::connect(plain, TIMEOUT).expect("a plain client");
}

#[test]
fn further_streams_of_a_plain_client_are_stopped_and_its_connection_goes_on() {
    let server = serve(Origins::loopback());
    runtime().block_on(async {
        let connection = server.open(server.fingerprint, b"rhumb/1").await;
        let connection = connection.expect("the server's own certificate");
        let (mut send, mut recv) = connection.open_bi().await.expect("the control stream");
        send.write_all(b"a").await.expect("it is open");
        // More of each kind than a client may have open at a time.
        for round in 0..8 {
            let mut stray = match round % 2 {
                0 => {
                    connection
                        .open_bi()
                        .await
                        .expect("the last one was stopped")
                        .0
                }
                _ => connection
                    .open_uni()
                    .await
                    .expect("the last one was stopped"),
            };
            // The server may stop it at once.
            let _ = stray.write_all(b"stray").await;
            let stopped = tokio::time::timeout(TIMEOUT, stray.stopped()).await;
            assert!(stopped.is_ok(), "a stray stream is stopped");
        }
        send.write_all(b"b").await.expect("it is open");
        let mut echo = [0; 2];
        recv.read_exact(&mut echo).await.expect("the echo");
        assert_eq!(&echo, b"ab");
    });
}
