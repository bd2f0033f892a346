//! The loss report: which packets a receiver has received and lost.

use alloc::vec::Vec;

use super::header::{Head, Low16, PacketKind, StreamId};
use crate::limits::{FEC_SPAN, LOST_NUMBERS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A receiver's report about its stream. It requests a refresh of each lost packet and a watermark.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LossReport {
    /// Low bits of one more than the number of the newest packet known to have been sent.
    pub next: Low16,
    /// Low bits of the count of packets that did not arrive, whether or not repair symbols recovered them.
    pub abandoned: Low16,
    /// The number of repair symbols that would recover the newest losses; zero if refreshes are needed.
    pub repair_symbols: u8,
    /// Numbers of lost packets below `next`, oldest first.
    pub lost: Vec<Low16>,
}

impl LossReport {
    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: PacketKind::LossReport,
            stream,
        }
        .encode(&mut to);
        self.next.encode(&mut to);
        self.abandoned.encode(&mut to);
        to.u8(self.repair_symbols);
        to.varint(self.lost.len() as u64);
        for lost in &self.lost {
            lost.encode(&mut to);
        }
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no loss report.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let abandoned = Low16::decode(&mut from)?;
        let repair_symbols = from.u8()?;
        if u32::from(repair_symbols) > FEC_SPAN {
            return Err(Malformed::OutOfRange);
        }
        let count = from.varint()?;
        if count > LOST_NUMBERS_MAX as u64 {
            return Err(Malformed::TooLong);
        }
        let mut lost = Vec::new();
        for _ in 0..count {
            lost.push(Low16::decode(&mut from)?);
        }
        from.finish()?;
        Ok(Self {
            next,
            abandoned,
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
        fn a_loss_report_round_trips(next: u16, abandoned: u16, repair_symbols in 0..=FEC_SPAN as u8, lost in proptest::collection::vec(any::<u16>(), 0..LOST_NUMBERS_MAX)) {
            let (next, abandoned) = (Low16(next), Low16(abandoned));
            let loss_report = LossReport { next, abandoned, repair_symbols, lost: lost.into_iter().map(Low16).collect() };
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
