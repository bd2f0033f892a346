//! Connections whose tokens end; a hello for tests beside.

use std::sync::mpsc::channel;
use std::time::Duration;

use rhumb_protocol::message::{ClientMessage, Extensions, Token, VERSIONS};
use rhumb_protocol::session::CloseCode;
use rhumb_protocol::{Endpoint, Instant, Peer, Span, Transmit};

use crate::access::tests::Signed;
use crate::dispatcher::{Dispatcher, DispatcherSettings};

/// Longer than any turn of a worker; reached only by a failure.
const LONG: Duration = Duration::from_secs(30);

/// A hello with a token, for a scene.
pub(in crate::dispatcher) fn hello(token: &str, scene: &str) -> Vec<u8> {
    let mut extensions = Extensions::NONE;
    let token: Token = token.parse().unwrap();
    assert!(extensions.insert(token.extension()));
    let mut bytes = Vec::new();
    let hello = ClientMessage::Hello {
        versions: VERSIONS.to_vec(),
        scene: scene.parse().unwrap(),
        extensions,
    };
    hello.encode(&mut bytes);
    bytes
}

fn closed(dispatcher: &mut Dispatcher) -> Option<u32> {
    let transmits = std::iter::from_fn(|| dispatcher.poll_transmit());
    transmits.fold(None, |closed, transmit| match transmit {
        Transmit::Close { code, .. } => Some(code),
        _ => closed,
    })
}

#[test]
fn a_connection_ends_with_its_token() {
    let signed = Signed::new("expiry");
    let settings = DispatcherSettings {
        authenticator: signed.authenticator(),
        ..DispatcherSettings::new(|| Instant::ZERO)
    };
    let (wake, woken) = channel();
    let mut dispatcher = Dispatcher::new(settings, move || wake.send(()).unwrap_or(()));
    let (peer, mut now) = (Peer(1), Instant::ZERO);
    dispatcher.handle_opened(now, peer);
    dispatcher.handle_control(now, peer, &hello(&signed.token(), "pit"));
    assert_eq!(closed(&mut dispatcher), None);
    now = now + Span::from_millis(89_999);
    dispatcher.handle_timeout(now);
    assert_eq!(closed(&mut dispatcher), None);
    assert_eq!(
        dispatcher.poll_timeout().map(|wake| wake.at),
        Some(now + Span::from_millis(1))
    );
    dispatcher.handle_timeout(now + Span::from_millis(1));
    assert_eq!(closed(&mut dispatcher), Some(CloseCode::TOKEN_EXPIRED.0));
    // The scene without clients is let go.
    while !dispatcher.workers.is_empty() {
        woken.recv_timeout(LONG).expect("the worker has output");
        assert_eq!(closed(&mut dispatcher), None);
    }
}
