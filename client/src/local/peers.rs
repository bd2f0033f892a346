//! Clients of this process beside a server's driver, or that feed scenes.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};

use rhumb_link::{Clock, TransportCode};
use rhumb_protocol::{Ending, Endpoint, Instant, LinkReport, Peer, Transmit, Wake};
use rhumb_scene::{FeedTaken, SceneName};

use super::{
    Driver, Host, INPUTS_PER_TURN, InputQueue, LocalConnection, LocalServer, Queued, ScenesCall,
    ServerGone,
};
use crate::error::{FeedError, OpenError};
use crate::feeding::Feeding;
use crate::server_connection::ServerConnection;

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

impl LocalServer {
    /// Connects the client that will feed a scene: one whose engine is elsewhere, such as MuJoCo or an engine of one's own.
    ///
    /// The client makes the scene when it joins, adds the bodies, and hands their states over with
    /// [`Client::feed`](crate::Client::feed), once a tick. Other clients follow the scene as any other, within the tolerance
    /// of their stream and nothing besides; what they ask for comes to
    /// [`Client::poll_request`](crate::Client::poll_request). The scene ends with the client.
    ///
    /// # Errors
    ///
    /// [`OpenError`] for a name that cannot be a scene's, or that another client feeds, and for the server of
    /// [`Self::beside`].
    ///
    /// # Example
    ///
    /// ```
    /// use rhumb_client::scene::{BodyDesc, Shape};
    /// use rhumb_client::{BodyState, FedVelocities, LocalServer, Tick};
    ///
    /// # fn main() -> Result<(), rhumb_client::MainError> {
    /// let server = LocalServer::new();
    /// let mut owner = server.feed("drop")?.join("drop")?;
    /// let ball = owner.add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(0.0, 10.0, 0.0))?;
    /// let mut follower = server.connect().join("drop")?;
    /// for tick in 1..=60 {
    ///     // An engine of one's own.
    ///     let (time, height) = (tick as f32 / 60.0, 10.0 - 4.905 * (tick as f32 / 60.0).powi(2));
    ///     let (turn, still) = ([0.0, 0.0, 0.0, 1.0], [0.0; 3]);
    ///     let state = BodyState::new([0.0, height, 0.0], turn, [0.0, -9.81 * time, 0.0], still)?;
    ///     owner.feed(Tick::new(tick), &[(ball, state)], FedVelocities::Given)?;
    ///     follower.poll()?;
    ///     let shown = follower.view().position(ball).ok_or("the ball is gone")?.y;
    ///     assert!((shown - height).abs() < 0.05);
    /// }
    /// # Ok(())
    /// # }
    /// ```
    pub fn feed(&self, scene: &str) -> Result<ServerConnection, OpenError> {
        let name: SceneName = scene.parse().map_err(|cause| OpenError::SceneName {
            scene: scene.to_owned(),
            cause,
        })?;
        let feeds = (self.feeds.as_ref()).ok_or(OpenError::Feed(FeedError::NoServer))?;
        let peer = Peer(self.next_peer.fetch_add(1, Ordering::Relaxed));
        let taken = |FeedTaken(name)| OpenError::Feed(FeedError::Taken(name));
        let feed = feeds.open(&name, peer).map_err(taken)?;
        let connection = LocalConnection::open(self.host.clone(), peer, None);
        let host = self.host.clone();
        // A server that is gone ends the connection, which the client learns.
        let feeding = Feeding::new(feed, move |feed| {
            let _ = host.wake(|| feed.is_taken());
        });
        Ok(ServerConnection::over(connection).feeding(feeding))
    }
}

/// Turns of a server that runs on a caller's thread until what that caller fed is taken, at most: its commands before that
/// have 512 places in each.
const FED_TURNS_MAX: usize = 4_096;

impl Host {
    /// Wakes the scenes for new feeds. A server on the caller's thread has taken it when this returns, unless commands
    /// before it have to wait.
    fn wake(&self, is_taken: impl Fn() -> bool) -> Result<(), ServerGone> {
        match self {
            Self::Caller(driver) => {
                let mut driver = driver.lock().map_err(|_| ServerGone)?;
                for _ in 0..FED_TURNS_MAX {
                    if is_taken() {
                        break;
                    }
                    driver.run();
                }
                Ok(())
            }
            Self::Thread(queue) => {
                let look: ScenesCall = Box::new(|_, _| {});
                let sent = queue.sender.send(Queued::Call(look));
                sent.map_err(|_| ServerGone)
            }
        }
    }
}
