//! State datagrams of one connection, with the header of a browser's session.
//!
//! Neither queues nor interprets them.

use std::sync::Arc;

use bytes::Bytes;
use quinn::{Connection, SendDatagramError};

use super::web_session::WebSession;

/// Sends and receives the datagrams of a connection.
#[derive(Clone, Debug)]
pub(super) struct DatagramLane {
    connection: Connection,
    /// The session of a browser; `None` for a connection of this protocol alone.
    web: Option<Arc<WebSession>>,
}

impl DatagramLane {
    pub(super) const fn new(connection: Connection, web: Option<Arc<WebSession>>) -> Self {
        Self { connection, web }
    }

    pub(super) const fn connection(&self) -> &Connection {
        &self.connection
    }

    /// Sends a datagram without waiting.
    pub(super) fn send(&self, bytes: Bytes) -> Result<(), SendDatagramError> {
        self.connection.send_datagram(match &self.web {
            None => bytes,
            Some(web) => web.wrap(&bytes),
        })
    }

    /// The next datagram; `None` after the end of the connection.
    pub(super) async fn read(&self) -> Option<Bytes> {
        loop {
            let datagram = self.connection.read_datagram().await.ok()?;
            match &self.web {
                None => return Some(datagram),
                Some(web) => {
                    // One of another session is dropped: the connection has none.
                    if let Some(bytes) = web.unwrap(datagram) {
                        return Some(bytes);
                    }
                }
            }
        }
    }

    /// Bytes of the largest datagram that fits now; `None` if the peer takes none.
    pub(super) fn largest(&self) -> Option<usize> {
        let overhead = self.web.as_ref().map_or(0, |web| web.overhead());
        let bytes = self.connection.max_datagram_size()?;
        Some(bytes.saturating_sub(overhead))
    }
}
