//! What comes back on the state path: how far was heard, and what was lost.

use alloc::vec::Vec;

use super::header::{Head, Low16, PacketKind, StreamId};
use crate::limits::{FEC_SPAN, LOST_NAMED_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A member's account of its stream. It asks for a refresh of each lost packet and for a watermark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LossReport {
    /// One more than the number of the newest packet known to have been sent.
    pub next: Low16,
    /// How many of all packets so far did not come by themselves, whether repair_symbols gave them back or not.
    pub gone: Low16,
    /// How many repair_symbols would do for those of the lost packets that were sent last; none where refreshes are wanted.
    pub repair_symbols: u8,
    /// Packets below that were not heard, oldest first.
    pub lost: Vec<Low16>,
}

impl LossReport {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: PacketKind::LossReport,
            stream,
        }
        .encode(&mut to);
        self.next.encode(&mut to);
        self.gone.encode(&mut to);
        to.u8(self.repair_symbols);
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
    /// [`Malformed`] when that is not an loss_report.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let gone = Low16::decode(&mut from)?;
        let repair_symbols = from.u8()?;
        if u32::from(repair_symbols) > FEC_SPAN {
            return Err(Malformed::OutOfRange);
        }
        let count = from.varint()?;
        if count > LOST_NAMED_MAX as u64 {
            return Err(Malformed::TooLong);
        }
        let mut lost = Vec::new();
        for _ in 0..count {
            lost.push(Low16::decode(&mut from)?);
        }
        from.finish()?;
        Ok(Self {
            next,
            gone,
            repair_symbols,
            lost,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_loss_report_comes_back(next: u16, gone: u16, repair_symbols in 0..=FEC_SPAN as u8, lost in proptest::collection::vec(any::<u16>(), 0..LOST_NAMED_MAX)) {
            let (next, gone) = (Low16(next), Low16(gone));
            let loss_report = LossReport { next, gone, repair_symbols, lost: lost.into_iter().map(Low16).collect() };
            let bytes = loss_report.encode(StreamId(300));
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Head::decode(&mut reader), Ok(Head { kind: PacketKind::LossReport, stream: StreamId(300) }));
            prop_assert_eq!(LossReport::decode(reader.clone()), Ok(loss_report));
            for cut in 0..reader.rest().len() {
                prop_assert!(LossReport::decode(Reader::new(&reader.rest()[..cut])).is_err());
            }
        }
    }
}
