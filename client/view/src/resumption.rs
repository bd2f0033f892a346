//! The time for which a client tries to go on over another connection.

use std::time::Duration;

use rhumb_protocol::Ending;
use rhumb_protocol::session::{CloseCode, TransportCode};

/// Time for which a client of a durable scene tries to resume by default. A machine starts again within a minute, its
/// server in seconds, and a client notices within ten; the server keeps the session for five minutes.
pub const RESUME_WITHIN: Duration = Duration::from_secs(60);

/// True if another connection may go on after this end of one: the server has not refused the client.
#[must_use]
pub const fn may_resume(ending: Ending) -> bool {
    match ending {
        Ending::Closed(code) => {
            code == TransportCode::GOING_AWAY.0
                || code == CloseCode::BUSY.0
                // The application slept while a connection was opened for it.
                || code == CloseCode::HELLO_LATE.0
                || code == CloseCode::SCENE_RESTORING.0
        }
        Ending::TimedOut | Ending::Broken => true,
    }
}
