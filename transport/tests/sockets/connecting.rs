//! A client connects to the right server only; an error names the cause.

use std::fs;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::process;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use quinn::crypto::rustls::{HandshakeData, QuicClientConfig, QuicServerConfig};
use quinn::rustls::{self, pki_types::PrivatePkcs8KeyDer};
use rhumb_transport::{
    BindError, Certificate, CertificateError, ClientOptions, ConnectError, Fingerprint, QuicClient,
    QuicServer, ServerOptions, Trust,
};

use crate::support::{Running, TIMEOUT};

#[test]
fn a_wrong_fingerprint_error_names_both_fingerprints() {
    let server = Running::echo();
    let pinned = Fingerprint([7; 32]);
    let options = ClientOptions {
        trust: Trust::Fingerprint(pinned),
        ..server.options()
    };
    let error = QuicClient::connect(options, TIMEOUT).unwrap_err();
    let text = error.to_string();
    assert!(
        text.contains(&pinned.to_string()) && text.contains(&server.fingerprint.to_string()),
        "{text}"
    );
    let ConnectError::WrongFingerprint {
        expected,
        presented,
        ..
    } = error
    else {
        panic!("{text}")
    };
    assert_eq!((expected, presented), (pinned, server.fingerprint));
}

#[test]
fn a_silent_server_is_reported_after_the_time_limit() {
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = silent.local_addr().unwrap();
    let options = ClientOptions::new(address, Trust::Fingerprint(Fingerprint([0; 32])));
    let timeout = Duration::from_millis(100);
    let error = QuicClient::connect(options, timeout).unwrap_err();
    let ConnectError::NothingAnswers {
        server,
        timeout: tried,
    } = error
    else {
        panic!("{error}")
    };
    assert_eq!((server, tried), (address, timeout));
}

/// A server of QUIC alone that takes these protocols: where it listens, its certificate's fingerprint, and the protocol of
/// each connection.
fn server_of(protocols: &[&[u8]]) -> (SocketAddr, Fingerprint, Receiver<Vec<u8>>) {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    let inside = runtime.enter();
    let made =
        rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("localhost is a name");
    let key = PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
    let fingerprint = Fingerprint::of(made.cert.der());
    let provider = Arc::new(rustls::crypto::ring::default_provider());
    let mut tls = rustls::ServerConfig::builder_with_provider(provider)
        .with_protocol_versions(&[&rustls::version::TLS13])
        .expect("the provider speaks TLS 1.3")
        .with_no_client_auth()
        .with_single_cert(vec![made.cert.der().clone()], key.into())
        .expect("the key is the certificate's");
    tls.alpn_protocols = protocols.iter().map(|name| name.to_vec()).collect();
    let tls = QuicServerConfig::try_from(tls).expect("the provider has an initial suite");
    let config = quinn::ServerConfig::with_crypto(Arc::new(tls));
    let local = (Ipv4Addr::LOCALHOST, 0).into();
    let other = quinn::Endpoint::server(config, local).expect("a free port");
    let address = other.local_addr().expect("a bound address");
    drop(inside);
    let (taken, protocol) = channel();
    thread::spawn(move || {
        runtime.block_on(async move {
            while let Some(incoming) = other.accept().await {
                let Ok(connection) = incoming.await else {
                    continue;
                };
                let _ = taken.send(protocol_of(&connection));
            }
        });
    });
    (address, fingerprint, protocol)
}

fn protocol_of(connection: &quinn::Connection) -> Vec<u8> {
    let data = connection.handshake_data().expect("a connection has it");
    let data = data.downcast::<HandshakeData>().expect("data of rustls");
    data.protocol.expect("both ends name protocols")
}

#[test]
fn another_protocol_has_its_own_error() {
    for other in [&b"h3"[..], b"rhumb/1-draft-2", b"rhumb/2"] {
        let (address, fingerprint, _) = server_of(&[other]);
        let options = ClientOptions::new(address, Trust::Fingerprint(fingerprint));
        let error = QuicClient::connect(options, TIMEOUT).unwrap_err();
        assert!(
            matches!(error, ConnectError::OtherProtocol { .. }),
            "{error:?}"
        );
    }
}

/// PROTOCOL 1.1-5.
#[test]
fn a_client_prefers_the_name_of_its_draft_and_takes_that_of_the_version() {
    let (draft, version) = (&b"rhumb/1-draft-1"[..], &b"rhumb/1"[..]);
    let servers = [
        (&[draft][..], draft),
        (&[version][..], version),
        (&[draft, version][..], draft),
    ];
    for (protocols, expected) in servers {
        let (address, fingerprint, protocol) = server_of(protocols);
        let options = ClientOptions::new(address, Trust::Fingerprint(fingerprint));
        let _client = QuicClient::connect(options, TIMEOUT).unwrap();
        assert_eq!(protocol.recv_timeout(TIMEOUT).unwrap(), expected);
    }
}

/// PROTOCOL 1.1-5, 8-1.
#[test]
fn a_server_takes_both_names_of_its_draft_and_no_other() {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let server = Running::echo();
    let (draft, version) = ("rhumb/1-draft-1", "rhumb/1");
    for (offered, expected) in [
        (vec![draft], Some(draft)),
        (vec![version], Some(version)),
        (vec![version, draft], Some(draft)),
        (vec!["rhumb/1-draft-2"], None),
    ] {
        let mut tls =
            rhumb_link::trust::client_tls(&Trust::Fingerprint(server.fingerprint)).unwrap();
        Arc::make_mut(&mut tls).alpn_protocols = offered.into_iter().map(Into::into).collect();
        let config = QuicClientConfig::try_from(tls).unwrap();
        let taken = runtime.block_on(async {
            let endpoint = quinn::Endpoint::client("127.0.0.1:0".parse().unwrap()).unwrap();
            let config = quinn::ClientConfig::new(Arc::new(config));
            let connecting = endpoint.connect_with(config, server.address, "localhost");
            connecting.unwrap().await.ok().as_ref().map(protocol_of)
        });
        assert_eq!(taken, expected.map(Into::into));
    }
}

#[test]
fn roots_are_trusted_for_the_certified_name_only() {
    let folder = folder("roots");
    let made = rcgen::generate_simple_self_signed(["physics.test".to_owned()]).unwrap();
    let (certificate, key) = (folder.join("certificate.pem"), folder.join("key.pem"));
    fs::write(&certificate, made.cert.pem()).unwrap();
    fs::write(&key, made.signing_key.serialize_pem()).unwrap();
    let server = Running::start(
        Certificate::from_pem_files(&certificate, &key).unwrap(),
        None,
    );
    let named = |server_name: &str| ClientOptions {
        server_name: server_name.to_owned(),
        trust: Trust::Roots(certificate.clone()),
        ..server.options()
    };
    QuicClient::connect(named("physics.test"), TIMEOUT).unwrap();
    let error = QuicClient::connect(named("other.test"), TIMEOUT).unwrap_err();
    let ConnectError::Untrusted { server_name, .. } = error else {
        panic!("{error}")
    };
    assert_eq!(server_name, "other.test");
}

#[test]
fn a_certificate_error_names_the_file() {
    let folder = folder("files");
    let missing = folder.join("missing.pem");
    let error = Certificate::from_pem_files(&missing, &missing).unwrap_err();
    assert!(error.to_string().contains("missing.pem"), "{error}");
    let empty = folder.join("empty.pem");
    fs::write(&empty, "").unwrap();
    let error = Certificate::from_pem_files(&empty, &missing).unwrap_err();
    assert!(
        matches!(&error, CertificateError::NoCertificate { file } if *file == empty),
        "{error:?}"
    );
    let pair = || rcgen::generate_simple_self_signed(["localhost".to_owned()]).unwrap();
    let (certificate, key) = (folder.join("one.pem"), folder.join("other.pem"));
    fs::write(&certificate, pair().cert.pem()).unwrap();
    fs::write(&key, pair().signing_key.serialize_pem()).unwrap();
    let error = Certificate::from_pem_files(&certificate, &key).unwrap_err();
    assert!(
        matches!(error, CertificateError::Unusable { .. }),
        "{error:?}"
    );
}

#[test]
fn a_taken_address_is_named() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let listen = taken.local_addr().unwrap();
    let certificate = Certificate::development(["localhost"]).unwrap();
    let error = QuicServer::bind(ServerOptions::new(listen, certificate)).unwrap_err();
    assert!(error.to_string().contains(&listen.to_string()), "{error}");
    assert!(matches!(error, BindError::Address { .. }));
}

/// A folder of this process's own, so that parallel runs do not share it.
fn folder(name: &str) -> PathBuf {
    let own = format!("{name}-{}", process::id());
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(own);
    fs::create_dir_all(&folder).expect("the target folder is writable");
    folder
}

#[test]
fn of_several_addresses_the_one_that_answers_is_taken() {
    let server = Running::echo();
    let [silent, closed] = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    let [first, second] = [&silent, &closed].map(|socket| socket.local_addr().unwrap());
    drop(closed);
    for (server_place, from_here) in [(0, true), (1, true), (2, true), (2, false)] {
        let mut addresses = vec![first, second];
        addresses.insert(server_place, server.address);
        if !from_here {
            // No route leads there: documentation prefix of RFC 3849.
            addresses.insert(0, "[2001:db8::1]:4433".parse().unwrap());
        }
        let options = ClientOptions {
            server: addresses[0],
            others: addresses[1..].to_vec(),
            ..server.options()
        };
        let client = QuicClient::connect(options, TIMEOUT).unwrap();
        assert_eq!(client.server(), server.address);
    }
}

#[test]
fn an_error_of_several_addresses_names_each_and_its_cause() {
    let server = Running::echo();
    let silent = UdpSocket::bind("127.0.0.1:0").unwrap();
    let silent = silent.local_addr().unwrap();
    let options = ClientOptions {
        others: vec![silent],
        trust: Trust::Fingerprint(Fingerprint([7; 32])),
        ..server.options()
    };
    let error = QuicClient::connect(options, Duration::from_millis(500)).unwrap_err();
    let text = error.to_string();
    let ConnectError::EachAddress(errors) = error else {
        panic!("{text}")
    };
    assert!(
        matches!(errors[0], ConnectError::WrongFingerprint { server: named, .. } if named == server.address),
        "{text}"
    );
    assert!(
        matches!(errors[1], ConnectError::NothingAnswers { server, .. } if server == silent),
        "{text}"
    );
    for named in [server.address, silent] {
        assert!(text.contains(&named.to_string()), "{text}");
    }
}

#[test]
fn a_server_at_every_address_answers_in_both_families() {
    if UdpSocket::bind("[::1]:0").is_err() {
        return;
    }
    let server = Running::echo_at("[::]:0".parse().unwrap());
    let port = server.address.port();
    for host in ["127.0.0.1", "[::1]"] {
        let options = ClientOptions {
            server: format!("{host}:{port}").parse().unwrap(),
            ..server.options()
        };
        QuicClient::connect(options, TIMEOUT).unwrap();
    }
}
