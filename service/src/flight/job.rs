//! Work that is given to the thread of flight recorders.

use rhumb_protocol::scene::SceneName;

use super::cause::FlightCause;

/// A piece of work for the thread.
pub(super) enum FlightJob {
    /// The entries of a scene's recorder are to be written.
    Write {
        scene: SceneName,
        cause: FlightCause,
        /// Older entries that it no longer had.
        dropped: u64,
        entries: Vec<u8>,
    },
    /// Nothing more is to be written.
    End,
}
