//! The packets of a reckoned stream: updates, and the vouching for silence.

use alloc::vec::Vec;

use super::header::{Head, Kind, Low16, StreamId};
use super::saying::Saying;
use crate::limits::{DATAGRAM_BYTES_MAX, INDICES_MAX};
use crate::wire::bits::{BitReader, BitWriter, golomb_len};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// Order of the code that holds how many indices lie between a body and the one before it.
const GAP_ORDER: u32 = 3;

/// What is said of one body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Update {
    /// Index of the body; its generation is the one that lives at the packet's tick.
    pub index: u32,
    /// What is said.
    pub saying: Saying,
}

/// Writes one packet of updates, given in rising order of index.
#[derive(Debug)]
pub struct StateWriter {
    bits: BitWriter,
    next_index: u32,
    count: u16,
    stream: StreamId,
    number: Low16,
    tick: Low16,
    notices: Low16,
}

/// Bytes before the updates: kind, stream, number, tick, notices and count.
const HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 2 + 2 + 2;

impl StateWriter {
    /// An empty packet.
    #[must_use]
    pub fn new(stream: StreamId, number: u64, tick: u64, notices: u64) -> Self {
        Self {
            bits: BitWriter::default(),
            next_index: 0,
            count: 0,
            stream,
            number: Low16::of(number),
            tick: Low16::of(tick),
            notices: Low16::of(notices),
        }
    }

    /// Appends an update, or returns `false` and leaves the packet as it is when the update does not fit any more.
    ///
    /// # Panics
    ///
    /// When indices do not rise: the publisher sorts.
    pub fn push(&mut self, update: &Update) -> bool {
        let gap = update
            .index
            .checked_sub(self.next_index)
            .expect("updates come in rising order of index");
        let bits = golomb_len(gap, GAP_ORDER) as usize + update.saying.bit_len();
        if self.bits.bit_len() + bits > (DATAGRAM_BYTES_MAX - HEAD_BYTES_MAX) * 8 {
            return false;
        }
        self.bits.golomb(gap, GAP_ORDER);
        update.saying.encode(&mut self.bits);
        self.next_index = update.index + 1;
        self.count += 1;
        true
    }

    /// How many updates it holds.
    #[must_use]
    pub const fn count(&self) -> u16 {
        self.count
    }

    /// The datagram.
    #[must_use]
    pub fn finish(self, ends_tick: bool) -> Vec<u8> {
        let kind = if ends_tick {
            Kind::StateEnd
        } else {
            Kind::State
        };
        let mut head = Writer::new();
        Head {
            kind,
            stream: self.stream,
        }
        .encode(&mut head);
        self.number.encode(&mut head);
        self.tick.encode(&mut head);
        self.notices.encode(&mut head);
        head.varint(u64::from(self.count));
        head.raw(&self.bits.into_bytes());
        head.into_bytes()
    }
}

/// The head of a received packet of updates, and the updates still in their bits.
#[derive(Clone, Debug)]
pub struct StatePacket<'a> {
    /// Low bits of its number.
    pub number: Low16,
    /// Low bits of its tick.
    pub tick: Low16,
    /// Low bits of the number of notices that must have been heard to read it.
    pub notices: Low16,
    /// Whether it is the last of its tick.
    pub ends_tick: bool,
    count: u64,
    bits: BitReader<'a>,
}

impl<'a> StatePacket<'a> {
    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a packet of updates.
    pub fn decode(ends_tick: bool, mut from: Reader<'a>) -> Result<Self, Malformed> {
        let number = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let notices = Low16::decode(&mut from)?;
        let count = from.varint_to((DATAGRAM_BYTES_MAX * 8) as u64)?;
        Ok(Self {
            number,
            tick,
            notices,
            ends_tick,
            count,
            bits: BitReader::new(from.rest()),
        })
    }

    /// Reads every update; `out` keeps its capacity from packet to packet.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when any of it is not what a publisher writes; `out` is then of no use.
    pub fn updates(mut self, out: &mut Vec<Update>) -> Result<(), Malformed> {
        out.clear();
        let mut next_index = 0_u32;
        for _ in 0..self.count {
            let gap = self.bits.golomb(GAP_ORDER)?;
            let index = next_index.checked_add(gap).ok_or(Malformed::OutOfRange)?;
            if index >= INDICES_MAX {
                return Err(Malformed::OutOfRange);
            }
            let saying = Saying::decode(&mut self.bits)?;
            out.push(Update { index, saying });
            next_index = index + 1;
        }
        self.bits.finish()
    }
}

/// Says that all packets before `next` were sent, and that nothing more was to be said up to a tick (PROTOCOL 5.7).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Vouch {
    /// Number of the stream's next packet: all before it were sent.
    pub next: Low16,
    /// Up to which tick.
    pub tick: Low16,
    /// Notices given up to that tick.
    pub notices: Low16,
}

impl Vouch {
    /// The datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: Kind::Vouch,
            stream,
        }
        .encode(&mut to);
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.notices.encode(&mut to);
        to.into_bytes()
    }

    /// Reads what follows the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not a vouch.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let vouch = Self {
            next: Low16::decode(&mut from)?,
            tick: Low16::decode(&mut from)?,
            notices: Low16::decode(&mut from)?,
        };
        from.finish()?;
        Ok(vouch)
    }
}

// A packet has room for the longest update.
const _: () = assert!(DATAGRAM_BYTES_MAX - HEAD_BYTES_MAX > Saying::MAX_BITS / 8 + 16);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::saying::tests::saying;
    use proptest::prelude::*;

    fn updates() -> impl Strategy<Value = Vec<Update>> {
        proptest::collection::btree_map(0..INDICES_MAX, saying(), 0..12).prop_map(|map| {
            map.into_iter()
                .map(|(index, saying)| Update { index, saying })
                .collect()
        })
    }

    fn datagram(updates: &[Update]) -> Vec<u8> {
        let mut writer = StateWriter::new(StreamId(7), 70_000, 80_000, 90_000);
        for update in updates {
            assert!(writer.push(update));
        }
        writer.finish(true)
    }

    fn decode(bytes: &[u8]) -> Result<Vec<Update>, Malformed> {
        let mut reader = Reader::new(bytes);
        let head = Head::decode(&mut reader)?;
        assert_eq!(
            head,
            Head {
                kind: Kind::StateEnd,
                stream: StreamId(7)
            }
        );
        let mut out = Vec::new();
        StatePacket::decode(true, reader)?.updates(&mut out)?;
        Ok(out)
    }

    proptest! {
        #[test]
        fn a_packet_comes_back(updates in updates()) {
            let bytes = datagram(&updates);
            prop_assert!(bytes.len() <= DATAGRAM_BYTES_MAX);
            prop_assert_eq!(decode(&bytes), Ok(updates));
        }

        #[test]
        fn every_truncation_is_refused(updates in updates()) {
            let bytes = datagram(&updates);
            for cut in 2..bytes.len() {
                prop_assert!(decode(&bytes[..cut]).is_err());
            }
            let mut longer = bytes;
            longer.push(0);
            prop_assert_eq!(decode(&longer), Err(Malformed::Trailing));
        }
    }

    #[test]
    fn a_full_packet_refuses_and_stays_as_it_was() {
        let saying = Saying::Whole(super::super::saying::TrackSaying {
            predictor: rhumb_reckoning::Predictor::Uniform,
            anchor: rhumb_reckoning::Anchor::Verbatim(
                rhumb_reckoning::Verbatim::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [1.0; 3])
                    .unwrap(),
            ),
        });
        let mut writer = StateWriter::new(StreamId(7), 0, 0, 0);
        let mut index = 0;
        while writer.push(&Update { index, saying }) {
            index += 1;
        }
        assert_eq!(usize::from(writer.count()), index as usize);
        let bytes = writer.finish(true);
        assert_eq!(decode(&bytes).unwrap().len(), index as usize);
    }
}
