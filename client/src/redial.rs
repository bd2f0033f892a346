//! A connection of any kind, and the way to its server again.

use std::sync::Arc;
use std::time::Duration;

use rhumb_transport::ClientTransport;

/// A connection, whatever carries its bytes.
pub(crate) type BoxedConnection = Box<dyn ClientTransport>;

/// Reaches the server of an ended connection again, within some time.
pub(crate) type Redial = Arc<dyn Fn(Duration) -> Option<BoxedConnection> + Send + Sync>;
