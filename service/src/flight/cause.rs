//! The faults after which a flight recorder is written.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A fault of a scene. The numbers in files are those of the order; new causes are added at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) enum FlightCause {
    /// The engine panicked.
    EnginePanicked,
    /// The thread of the scene panicked.
    ThreadPanicked,
    /// The scene did not answer the watchdog and is quarantined.
    Quarantined,
    /// The engine removed a body whose state was not finite.
    NotFinite,
    /// A checksum of a client's copy differs from that of the stream.
    ChecksumMismatch,
    /// The scene did not answer the watchdog, and its process was killed.
    Killed,
    /// The process of the scene ended.
    ProcessEnded,
}

impl FlightCause {
    /// The word for the cause in the name of a file.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::EnginePanicked => "engine-panicked",
            Self::ThreadPanicked => "thread-panicked",
            Self::Quarantined => "quarantined",
            Self::NotFinite => "not-finite",
            Self::ChecksumMismatch => "checksum-mismatch",
            Self::Killed => "killed",
            Self::ProcessEnded => "process-ended",
        }
    }
}

impl fmt::Display for FlightCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::EnginePanicked => "the physics engine panicked",
            Self::ThreadPanicked => "the thread of the scene panicked",
            Self::Quarantined => "the scene did not answer and is quarantined",
            Self::NotFinite => "a body's state was not finite",
            Self::ChecksumMismatch => "a client's copy has another checksum than its stream",
            Self::Killed => "the scene did not answer and its process was killed",
            Self::ProcessEnded => "the process of the scene ended",
        })
    }
}
