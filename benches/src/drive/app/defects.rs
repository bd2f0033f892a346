//! Where the published client loses its time, each as a switch.
//!
//! What each costs here is measured; that it cost the paper's client the same is inferred, since that one ran on another
//! runtime and machine.

use std::fmt;

use clap::ValueEnum;

/// One thing that the published client does and need not.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, ValueEnum)]
pub enum Defect {
    /// Threads look for work each 30 ms (TCP) and 10 ms (what was heard), instead of when there is some.
    Poll,
    /// No more than fifty messages leave in 30 ms.
    Cap,
    /// A list of who was heard of is never emptied: each state scans it, each frame's end copies and walks it.
    List,
    /// The socket's buffer is the system's default, which holds 277 datagrams.
    Buffer,
}

/// Which of them a client has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Defects {
    /// See [`Loss::Poll`].
    pub poll: bool,
    /// See [`Loss::Cap`].
    pub cap: bool,
    /// See [`Loss::List`].
    pub list: bool,
    /// See [`Loss::Buffer`].
    pub buffer: bool,
    /// Entries that the list has from the beginning on, as if the client had heard so many states before.
    pub listed: u32,
}

impl Defects {
    /// A client that loses nothing but what the protocol costs.
    pub const SOUND: Self = Self {
        poll: false,
        cap: false,
        list: false,
        buffer: false,
        listed: 0,
    };

    /// The client that was published.
    pub const AS_PUBLISHED: Self = Self {
        poll: true,
        cap: true,
        list: true,
        buffer: true,
        listed: 0,
    };

    /// A sound client with these alone.
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

    /// The same, with a list that has so many entries from the beginning on.
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
            names => write!(f, "sound but for {}", names.join(", ")),
        }
    }
}
