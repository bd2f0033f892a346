//! Connections of the network, carried to a server in this process.
//!
//! Each peer of the network has a connection of its own to that server, and bytes pass unread. A peer that reads slowly is
//! given no more than [`WINDOW_BYTES`] of control bytes ahead of what its link has taken.

use std::collections::BTreeMap;
use std::time::Duration;

use bytes::Bytes;
use rhumb_client::{ClientTransport, Received, TransportCode};
use rhumb_protocol::{
    Ending, Endpoint, Instant, LinkReport, Peer, Span, Transmit, Wake, WakeReason,
};

/// Control bytes that a link may have still to take.
const WINDOW_BYTES: usize = 256 << 10;
/// Time between two looks at a server that steps within calls: a page moves on while the program makes none.
const LOOK: Span = Span::from_millis(5);

/// Carries connections of the network to a server in this process.
pub(crate) struct NetworkDoor {
    open: Box<dyn FnMut() -> Box<dyn ClientTransport> + Send>,
    carried: BTreeMap<Peer, Carried>,
    next_look: Instant,
}

/// One carried connection.
struct Carried {
    inner: Box<dyn ClientTransport>,
    /// Control bytes that the link has still to take.
    ahead: usize,
    /// True once its end was handed on.
    ended: bool,
}

impl NetworkDoor {
    /// `open` opens one more connection to the server.
    pub(crate) fn new(open: impl FnMut() -> Box<dyn ClientTransport> + Send + 'static) -> Self {
        Self {
            open: Box::new(open),
            carried: BTreeMap::new(),
            next_look: Instant::ZERO,
        }
    }
}

impl Carried {
    /// The next bytes of the server for this peer.
    fn poll(&mut self, to: Peer) -> Option<Transmit> {
        if self.ended || self.ahead >= WINDOW_BYTES {
            return None;
        }
        Some(match self.inner.recv(Duration::ZERO)? {
            Received::Control(bytes) => {
                self.ahead += bytes.len();
                Transmit::Control { to, bytes }
            }
            Received::State(bytes) => Transmit::State { to, bytes },
            Received::Ended(ending) => {
                self.ended = true;
                let code = match ending {
                    Ending::Closed(code) => code,
                    Ending::TimedOut | Ending::Broken => TransportCode::GOING_AWAY.0,
                };
                Transmit::Close { to, code }
            }
        })
    }
}

impl Endpoint for NetworkDoor {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        let carried = Carried {
            inner: (self.open)(),
            ahead: 0,
            ended: false,
        };
        self.carried.insert(peer, carried);
        self.next_look = now + LOOK;
    }

    fn handle_control(&mut self, _now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(carried) = self.carried.get(&from) {
            carried.inner.send_control(Bytes::copy_from_slice(bytes));
        }
    }

    fn handle_datagram(&mut self, _now: Instant, from: Peer, bytes: &[u8]) {
        if let Some(carried) = self.carried.get(&from) {
            carried.inner.send_state(Bytes::copy_from_slice(bytes));
        }
    }

    fn wants_control(&self, from: Peer) -> bool {
        let carried = self.carried.get(&from);
        carried.is_none_or(|carried| carried.inner.wants_control())
    }

    fn handle_link(&mut self, _now: Instant, peer: Peer, report: &LinkReport) {
        if let Some(carried) = self.carried.get(&peer) {
            carried.inner.report_link(report);
        }
    }

    fn handle_ended(&mut self, _now: Instant, peer: Peer, _ending: Ending) {
        // Its connection ends with it.
        self.carried.remove(&peer);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.next_look = now + LOOK;
    }

    fn handle_control_taken(&mut self, _now: Instant, peer: Peer, bytes: usize) {
        if let Some(carried) = self.carried.get_mut(&peer) {
            carried.ahead = carried.ahead.saturating_sub(bytes);
        }
    }

    fn poll_transmit(&mut self) -> Option<Transmit> {
        let mut each = self.carried.iter_mut();
        each.find_map(|(peer, carried)| carried.poll(*peer))
    }

    fn poll_timeout(&self) -> Option<Wake> {
        let look = Wake {
            at: self.next_look,
            reason: WakeReason::Input,
        };
        (!self.carried.is_empty()).then_some(look)
    }
}

#[cfg(test)]
mod tests {
    use core::net::SocketAddr;
    use std::sync::{Arc, Mutex};
    use std::thread;

    use rhumb_client::scene::{BodyDesc, Shape};
    use rhumb_client::{Client, JoinMode, JoinOptions, LocalServer, PipelineDepth, Trust};
    use rhumb_client::{TransportCode, WireStatistics};
    use rhumb_transport::{Certificate, QuicServer, ServerOptions, Stop};

    use super::*;

    /// A server that has control bytes without end.
    struct Endless;

    impl ClientTransport for Endless {
        fn send_control(&self, _bytes: Bytes) {}

        fn send_state(&self, _bytes: Bytes) {}

        fn close(&self, _code: u32) {}

        fn recv(&mut self, _timeout: Duration) -> Option<Received> {
            Some(Received::Control(Bytes::from_static(&[0; 1 << 10])))
        }

        fn statistics(&self) -> WireStatistics {
            WireStatistics::default()
        }
    }

    #[test]
    fn a_slow_reader_is_given_a_window_and_does_not_hold_up_others() {
        let mut door = NetworkDoor::new(|| Box::new(Endless));
        let (slow, other) = (Peer(1), Peer(2));
        let drain = |door: &mut NetworkDoor, peer: Peer| {
            let all = std::iter::from_fn(|| door.poll_transmit());
            let own =
                all.filter(|sent| matches!(sent, Transmit::Control { to, .. } if *to == peer));
            own.count()
        };
        assert_eq!(door.poll_timeout(), None);
        door.handle_opened(Instant::ZERO, slow);
        assert_eq!(drain(&mut door, slow), WINDOW_BYTES >> 10);
        door.handle_opened(Instant::ZERO, other);
        assert_eq!(drain(&mut door, other), WINDOW_BYTES >> 10);
        door.handle_control_taken(Instant::ZERO, slow, 3 << 10);
        assert_eq!(drain(&mut door, slow), 3);
        door.handle_ended(Instant::ZERO, slow, Ending::Broken);
        door.handle_ended(Instant::ZERO, other, Ending::Closed(TransportCode::LEFT.0));
        assert_eq!(door.poll_timeout(), None);
    }

    /// A server that has enough for now, and the round trips that were reported to it.
    struct SatedServer(Arc<Mutex<Vec<Span>>>);

    impl ClientTransport for SatedServer {
        fn send_control(&self, _bytes: Bytes) {}

        fn send_state(&self, _bytes: Bytes) {}

        fn close(&self, _code: u32) {}

        fn recv(&mut self, _timeout: Duration) -> Option<Received> {
            None
        }

        fn statistics(&self) -> WireStatistics {
            WireStatistics::default()
        }

        fn wants_control(&self) -> bool {
            false
        }

        fn report_link(&self, report: &LinkReport) {
            self.0.lock().expect("no panic").push(report.round_trip);
        }
    }

    #[test]
    fn a_server_that_has_enough_slows_the_peer_down_and_hears_of_its_link() {
        let reported = Arc::new(Mutex::new(Vec::new()));
        let mut door = NetworkDoor::new({
            let reported = Arc::clone(&reported);
            move || Box::new(SatedServer(Arc::clone(&reported)))
        });
        let peer = Peer(1);
        door.handle_opened(Instant::ZERO, peer);
        assert!(!door.wants_control(peer));
        let report = LinkReport {
            waiting_bytes: 0,
            sent_bytes: 0,
            over: Span::from_millis(100),
            round_trip: Span::from_millis(7),
        };
        door.handle_link(Instant::ZERO, peer, &report);
        assert_eq!(reported.lock().expect("no panic")[..], [report.round_trip]);
        door.handle_ended(Instant::ZERO, peer, Ending::Broken);
        assert!(door.wants_control(peer));
    }

    #[test]
    fn a_client_of_the_network_joins_a_scene_of_this_process_and_sees_its_bodies() {
        let server = LocalServer::new();
        let mut own = server.connect().join("shared").expect("the scene is made");
        let certificate = Certificate::development(["localhost"]).expect("a certificate");
        let listen = SocketAddr::from(([127, 0, 0, 1], 0));
        let transport =
            QuicServer::bind(ServerOptions::new(listen, certificate)).expect("a socket");
        let (address, print) = (transport.local_addr(), transport.fingerprint());
        let (stop, waker) = (Stop::new(), transport.waker());
        let mut door = NetworkDoor::new(move || {
            let waker = waker.clone();
            server.open(move || waker.wake())
        });
        let carrying = thread::spawn({
            let stop = stop.clone();
            move || transport.run(&mut door, &stop)
        });
        let connected = Client::connect(&address.to_string(), Trust::Fingerprint(print));
        let options = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        let joined = connected
            .expect("the door answers")
            .join_with("shared", options);
        let mut other = joined.expect("the scene is there");
        let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0);
        let ball = own.add_body(ball).expect("a ball");
        for _ in 0..30 {
            own.advance(PipelineDepth::LOCKSTEP).expect("a step");
            other.advance(PipelineDepth::LOCKSTEP).expect("a step");
        }
        let heights =
            [&own, &other].map(|client| client.view().position(ball).expect("the ball").y);
        assert!(
            (heights[0] - heights[1]).abs() < 0.2 && heights[1] < 9.5,
            "{heights:?}"
        );
        stop.stop();
        carrying.join().expect("no panic").expect("a stop");
    }
}
