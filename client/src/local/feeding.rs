//! Clients that feed their scenes, of a server in this process.

use std::sync::atomic::Ordering;

use rhumb_protocol::Peer;
use rhumb_scene::{FeedTaken, SceneName};

use super::{Host, LocalConnection, LocalServer, Queued, ScenesCall, ServerGone};
use crate::error::OpenError;
use crate::feed_error::FeedError;
use crate::feeding::Feeding;
use crate::server_connection::ServerConnection;

impl LocalServer {
    /// Connects the client that will feed a scene: one whose engine is elsewhere, such as MuJoCo or an engine of one's own.
    ///
    /// The client makes the scene when it joins, adds the bodies, and hands their states over with
    /// [`Client::feed`](crate::Client::feed), once a tick. Other clients follow the scene as any other, within the tolerance of their stream and nothing besides; what they
    /// ask for comes to [`Client::poll_request`](crate::Client::poll_request). The scene ends with the client.
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
    /// Has the scenes look at what was fed. A server on the caller's thread has taken it when this returns, unless commands
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
