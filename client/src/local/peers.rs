//! Clients of this process beside those of a server's own driver.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::sync::mpsc::{Receiver, channel};

use rhumb_link::{Clock, TransportCode};
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake};

use super::{Driver, Host, INPUTS_PER_TURN, InputQueue, LocalServer, Queued};

/// The first number of peers of this process beside those of another driver: between those of the network and those of a
/// Unix socket.
const FIRST_PEER: u64 = 1 << 62;

/// True for a peer of [`LocalServer::beside`].
#[must_use]
pub fn is_local_peer(peer: Peer) -> bool {
    peer.0 & !(FIRST_PEER - 1) == FIRST_PEER
}

impl LocalServer {
    /// The clients of a server with a driver of its own: [`LocalPeers::serve`] joins them to the driver's. `wake` makes the
    /// driver poll the server; it is called after each input.
    #[must_use]
    pub fn beside(wake: impl Fn() + Send + Sync + 'static) -> (Self, LocalPeers) {
        let (sender, inputs) = channel();
        let wake: Arc<dyn Fn() + Send + Sync> = Arc::new(wake);
        let mut queue = InputQueue::new(sender);
        queue.wake = Some(Arc::clone(&wake));
        let server = Self {
            host: Host::Thread(queue),
            next_peer: Arc::new(AtomicU64::new(FIRST_PEER)),
            feeds: None,
        };
        (server, LocalPeers { inputs, wake })
    }
}

/// The messages and datagrams of the clients of [`LocalServer::beside`].
pub struct LocalPeers {
    inputs: Receiver<Queued>,
    wake: Arc<dyn Fn() + Send + Sync>,
}

/// An endpoint, and its peers of this process beside those of the driver that calls it.
pub struct WithLocalPeers<'a, E> {
    driver: Driver<&'a mut E>,
    peers: LocalPeers,
}

impl LocalPeers {
    /// The endpoint with these peers.
    pub fn serve<E: Endpoint>(self, endpoint: &mut E) -> WithLocalPeers<'_, E> {
        WithLocalPeers {
            driver: Driver::new(endpoint, Clock::start()),
            peers: self,
        }
    }
}

impl<E: Endpoint> WithLocalPeers<'_, E> {
    fn handle_inputs(&mut self) {
        for _ in 0..INPUTS_PER_TURN {
            match self.peers.inputs.try_recv() {
                Ok(Queued::Input(input)) => self.driver.take(input.from, input.input),
                // The driver's scenes are not these: the caller learns it as the call is dropped.
                Ok(Queued::Call(_)) => {}
                Err(_) => return,
            }
        }
        (self.peers.wake)();
    }
}

impl<E> Drop for WithLocalPeers<'_, E> {
    /// Closes every connection.
    fn drop(&mut self) {
        self.driver.end(Ending::Closed(TransportCode::GOING_AWAY.0));
    }
}

impl<E: Endpoint> Endpoint for WithLocalPeers<'_, E> {
    fn handle_opened(&mut self, now: Instant, peer: Peer) {
        self.driver.server.handle_opened(now, peer);
    }

    fn handle_control(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.driver.server.handle_control(now, from, bytes);
    }

    fn handle_control_taken(&mut self, now: Instant, peer: Peer, bytes: usize) {
        self.driver.server.handle_control_taken(now, peer, bytes);
    }

    fn wants_control(&self, from: Peer) -> bool {
        self.driver.server.wants_control(from)
    }

    fn handle_datagram(&mut self, now: Instant, from: Peer, bytes: &[u8]) {
        self.driver.server.handle_datagram(now, from, bytes);
    }

    fn handle_link(&mut self, now: Instant, peer: Peer, report: &LinkReport) {
        self.driver.server.handle_link(now, peer, report);
    }

    fn handle_ended(&mut self, now: Instant, peer: Peer, ending: Ending) {
        self.driver.server.handle_ended(now, peer, ending);
    }

    fn handle_timeout(&mut self, now: Instant) {
        self.driver.server.handle_timeout(now);
    }

    /// The next transmission of the driver that calls; those of this process's peers leave on the way.
    fn poll_transmit(&mut self) -> Option<Transmit> {
        self.handle_inputs();
        loop {
            while let Some(transmit) = self.driver.server.poll_transmit() {
                let (Transmit::Control { to, .. }
                | Transmit::State { to, .. }
                | Transmit::Close { to, .. }) = &transmit;
                if !is_local_peer(*to) {
                    return Some(transmit);
                }
                self.driver.send(transmit);
            }
            let now = self.driver.clock.now();
            let driver = &mut self.driver;
            if !driver.held_back.deliver(now, &mut driver.server) {
                return None;
            }
        }
    }

    fn poll_timeout(&self) -> Option<Wake> {
        self.driver.server.poll_timeout()
    }
}
