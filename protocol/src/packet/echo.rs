//! What comes back on the state path: how far was heard, and what was lost.

use alloc::vec::Vec;

use super::header::{Head, Kind, Low16, StreamId};
use crate::limits::LOST_NAMED_MAX;
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A member's account of its stream. It asks for a repair of each lost packet and for a vouch.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Echo {
    /// One more than the number of the newest packet heard.
    pub next: Low16,
    /// Packets below that were not heard, oldest first.
    pub lost: Vec<Low16>,
}

impl Echo {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: Kind::Echo,
            stream,
        }
        .encode(&mut to);
        self.next.encode(&mut to);
        to.varint(self.lost.len() as u64);
        for lost in &self.lost {
            lost.encode(&mut to);
        }
        to.into_bytes()
    }

    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not an echo.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let count = from.varint()?;
        if count > LOST_NAMED_MAX as u64 {
            return Err(Malformed::TooLong);
        }
        let mut lost = Vec::new();
        for _ in 0..count {
            lost.push(Low16::decode(&mut from)?);
        }
        from.finish()?;
        Ok(Self { next, lost })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_echo_comes_back(next: u16, lost in proptest::collection::vec(any::<u16>(), 0..LOST_NAMED_MAX)) {
            let echo = Echo { next: Low16(next), lost: lost.into_iter().map(Low16).collect() };
            let bytes = echo.encode(StreamId(300));
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: Kind::Echo, stream: StreamId(300) }));
            prop_assert_eq!(Echo::decode(reader.clone()), Ok(echo));
            for cut in 0..reader.rest().len() {
                prop_assert!(Echo::decode(Reader::new(&reader.rest()[..cut])).is_err());
            }
        }
    }
}
