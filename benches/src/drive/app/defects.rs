//! Time losses of the published client, each as a switch.
//!
//! Each cost is measured here. That the paper's client lost the same time is inferred, because it ran on another
//! runtime and machine.

use std::fmt;

use clap::ValueEnum;

/// An avoidable time loss of the published client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Defect {
    /// Threads poll for work every 30 ms (TCP) and 10 ms (received messages) instead of being woken.
    Poll,
    /// At most fifty messages are sent per 30 ms.
    Cap,
    /// A list of received bodies is never emptied: each state scans it, each end of frame copies and walks it.
    List,
    /// The socket buffer has the system's default size, which holds 277 datagrams.
    Buffer,
}

/// The defects of a client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// See [`Defect::Poll`].
    pub poll: bool,
    /// See [`Defect::Cap`].
    pub cap: bool,
    /// See [`Defect::List`].
    pub list: bool,
    /// See [`Defect::Buffer`].
    pub buffer: bool,
    /// Initial entries of the list, as if the client had received that many states before.
    pub listed: u32,
}

impl Defects {
    /// A client without defects.
    pub const SOUND: Self = Self {
        poll: false,
        cap: false,
        list: false,
        buffer: false,
        listed: 0,
    };

    /// The published client, with all defects.
    pub const AS_PUBLISHED: Self = Self {
        poll: true,
        cap: true,
        list: true,
        buffer: true,
        listed: 0,
    };

    /// A client with the given defects only.
    #[must_use]
    pub fn only(defects: &[Defect]) -> Self {
        Self {
            poll: defects.contains(&Defect::Poll),
            cap: defects.contains(&Defect::Cap),
            list: defects.contains(&Defect::List),
            buffer: defects.contains(&Defect::Buffer),
            listed: 0,
        }
    }

    /// The same, with a list of this many initial entries.
    #[must_use]
    pub const fn with_listed(self, listed: u32) -> Self {
        Self { listed, ..self }
    }
}

impl fmt::Display for Defects {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = [
            (self.poll, "poll"),
            (self.cap, "cap"),
            (self.list, "list"),
            (self.buffer, "buffer"),
        ];
        let names: Vec<_> = named
            .iter()
            .filter(|(on, _)| *on)
            .map(|(_, n)| *n)
            .collect();
        match names.as_slice() {
            [] => f.write_str("sound"),
            _ if self.with_listed(0) == Self::AS_PUBLISHED => f.write_str("as published"),
            names => write!(f, "sound except for {}", names.join(", ")),
        }
    }
}
