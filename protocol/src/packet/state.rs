//! The packets of a reckoned stream: updates, and the vouching for silence.

use alloc::vec::Vec;

use super::cost::Pricing;
use super::excess::Excess;
use super::header::{Head, Kind, Low16, StreamId};
use super::parity::{COLUMN_BYTES_MAX, COLUMN_HEAD_BYTES};
use super::saying::{Saying, Tongue};
use super::whole::TrackSaying;
use crate::limits::{DATAGRAM_BYTES_MAX, INDICES_MAX, UPDATES_PER_PACKET_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::range::{RangeReader, RangeWriter};
use crate::wire::{Malformed, Wire};

/// What is said of one body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Update {
    /// The body's seat: bodies that are much spoken of sit close together, so that naming them is cheap.
    pub seat: u32,
    /// Index of the body, where it takes the seat or a whole track is said; otherwise it has the seat already. Its
    /// generation is the one that lives at the packet's tick.
    pub body: Option<u32>,
    /// What is said.
    pub saying: Saying,
}

/// Writes one packet of updates, given in rising order of seat.
#[derive(Debug)]
pub struct StateWriter {
    words: RangeWriter,
    tongue: Tongue,
    next_seat: u32,
    count: u16,
    stream: StreamId,
    number: Low16,
    tick: Low16,
    notices: Low16,
}

/// Bytes before the updates: kind, stream, excess, number, tick and notices.
const HEAD_BYTES_MAX: usize = 1 + 5 + 1 + 2 + 2 + 2;
/// Bytes of updates, so that every packet has a column for parities.
const UPDATES_BYTES_MAX: usize = COLUMN_BYTES_MAX - COLUMN_HEAD_BYTES;
/// More than the end of the updates takes.
const END_BYTES_MAX: usize = 2;
/// More than the widest gap and the naming of a body take.
const GAP_BYTES_MAX: usize = 12;
/// More than any update takes: fifteen numbers of at most 88 bits each, a form and two names, and an eighth.
const UPDATE_BYTES_MAX: usize = 256;

impl StateWriter {
    /// An empty packet.
    #[must_use]
    pub fn new(stream: StreamId, number: u64, tick: u64, notices: u64) -> Self {
        Self {
            words: RangeWriter::with_capacity(DATAGRAM_BYTES_MAX),
            tongue: Tongue::default(),
            next_seat: 0,
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
    /// When seats do not rise: the publisher sorts.
    pub fn push(&mut self, update: &Update) -> bool {
        let gap = update
            .seat
            .checked_sub(self.next_seat)
            .expect("updates come in rising order of seat");
        let room = (UPDATES_BYTES_MAX - END_BYTES_MAX).saturating_sub(self.words.byte_len_most());
        let full = usize::from(self.count) == UPDATES_PER_PACKET_MAX;
        if full || room < UPDATE_BYTES_MAX && self.bytes_most(&update.saying) > room {
            return false;
        }
        self.tongue
            .write(gap, update.body, &update.saying, &mut self.words);
        self.next_seat = update.seat + 1;
        self.count += 1;
        true
    }

    /// Bytes that an update takes at most.
    fn bytes_most(&self, saying: &Saying) -> usize {
        // The cost is a broken line under the true one, and a range is worth a little less than it says.
        let cost = self.tongue.cost(saying) as usize;
        (cost + cost / 8) / (8 * 256) + GAP_BYTES_MAX
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
        self.finish_as(kind, None)
    }

    /// The datagram that ends a tick at which tracks exceed their tolerances by this.
    #[must_use]
    pub fn finish_in_arrears(self, excess: Excess) -> Vec<u8> {
        self.finish_as(Kind::StateInArrears, Some(excess))
    }

    fn finish_as(mut self, kind: Kind, excess: Option<Excess>) -> Vec<u8> {
        self.tongue.end(&mut self.words);
        let mut head = Writer::new();
        Head {
            kind,
            stream: self.stream,
        }
        .encode(&mut head);
        if let Some(excess) = excess {
            excess.encode(&mut head);
        }
        self.number.encode(&mut head);
        self.tick.encode(&mut head);
        self.notices.encode(&mut head);
        head.raw(&self.words.into_bytes());
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
    /// By what factor tracks exceed their tolerances, of a packet that says so.
    pub excess: Excess,
    words: RangeReader<'a>,
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
        Ok(Self {
            number,
            tick,
            notices,
            ends_tick,
            excess: Excess::NONE,
            words: RangeReader::new(from.rest()),
        })
    }

    /// Reads what follows the head of one that says an excess.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not such a packet.
    pub fn decode_in_arrears(mut from: Reader<'a>) -> Result<Self, Malformed> {
        let excess = Excess::decode(&mut from)?;
        let packet = Self::decode(true, from)?;
        Ok(Self { excess, ..packet })
    }

    /// Reads every update; `out` keeps its capacity from packet to packet.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when any of it is not what a publisher writes; `out` is then of no use.
    pub fn updates(mut self, out: &mut Vec<Update>) -> Result<(), Malformed> {
        out.clear();
        let mut tongue = Tongue::default();
        let mut next_seat = 0_u32;
        while let Some((gap, body, saying)) = tongue.read(&mut self.words)? {
            if out.len() == UPDATES_PER_PACKET_MAX {
                return Err(Malformed::TooLong);
            }
            let seat = next_seat.checked_add(gap).ok_or(Malformed::OutOfRange)?;
            if seat >= INDICES_MAX {
                return Err(Malformed::OutOfRange);
            }
            out.push(Update { seat, body, saying });
            next_seat = seat + 1;
        }
        self.words.finish()
    }
}

/// Says that all packets before `next` were sent, and that nothing more was to be said up to a tick (PROTOCOL 5.10).
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
        self.encode_as(Kind::Vouch, stream, None)
    }

    /// The datagram that vouches for ticks at which tracks exceed their tolerances by this (PROTOCOL 5.17).
    #[must_use]
    pub fn encode_in_arrears(&self, stream: StreamId, excess: Excess) -> Vec<u8> {
        self.encode_as(Kind::VouchInArrears, stream, Some(excess))
    }

    fn encode_as(&self, kind: Kind, stream: StreamId, excess: Option<Excess>) -> Vec<u8> {
        let mut to = Writer::new();
        Head { kind, stream }.encode(&mut to);
        if let Some(excess) = excess {
            excess.encode(&mut to);
        }
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

    /// Reads what follows the head of one that says an excess.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when that is not such a vouch.
    pub fn decode_in_arrears(mut from: Reader<'_>) -> Result<(Self, Excess), Malformed> {
        let excess = Excess::decode(&mut from)?;
        Ok((Self::decode(from)?, excess))
    }
}

// A packet has room for the longest update, and a datagram for the packet.
const _: () = assert!(UPDATES_BYTES_MAX > TrackSaying::BITS_MAX / 8 + 32 + END_BYTES_MAX);
const _: () = assert!(HEAD_BYTES_MAX + UPDATES_BYTES_MAX <= DATAGRAM_BYTES_MAX);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::packet::saying::tests::saying;
    use proptest::prelude::*;

    fn updates() -> impl Strategy<Value = Vec<Update>> {
        let body = proptest::option::of(0..INDICES_MAX);
        // So few that what a packet cut short says fits one too.
        proptest::collection::btree_map(0..INDICES_MAX, (body, saying()), 0..8).prop_map(|map| {
            map.into_iter()
                .map(|(seat, (body, saying))| {
                    let whole = matches!(saying, Saying::Whole(_));
                    let body = body.or(whole.then_some(seat));
                    Update { seat, body, saying }
                })
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
        fn a_truncation_is_refused_or_says_something_else_in_its_one_form(updates in updates()) {
            let bytes = datagram(&updates);
            for cut in 1..bytes.len() {
                if let Ok(other) = decode(&bytes[..cut]) {
                    prop_assert_ne!(&other, &updates);
                    prop_assert_eq!(datagram(&other), &bytes[..cut]);
                }
            }
            let mut longer = bytes;
            longer.push(0);
            prop_assert!(decode(&longer).is_err());
        }
    }

    #[test]
    fn what_is_said_in_arrears_comes_back_and_no_excess_is_not_said_so() {
        let excess = Excess::covering(3.0);
        let writer = StateWriter::new(StreamId(7), 70_000, 80_000, 90_000);
        let state = writer.finish_in_arrears(excess);
        let vouch = Vouch {
            next: Low16(1),
            tick: Low16(2),
            notices: Low16(3),
        };
        let silence = vouch.encode_in_arrears(StreamId(7), excess);
        for (bytes, kind) in [
            (state, Kind::StateInArrears),
            (silence, Kind::VouchInArrears),
        ] {
            let stream = StreamId(7);
            let read = |bytes: &[u8]| {
                let mut reader = Reader::new(bytes);
                assert_eq!(Head::decode(&mut reader), Ok(Head { kind, stream }));
                match kind {
                    Kind::StateInArrears => {
                        StatePacket::decode_in_arrears(reader).and_then(|packet| {
                            assert!(packet.ends_tick);
                            let excess = packet.excess;
                            packet.updates(&mut Vec::new()).map(|()| excess)
                        })
                    }
                    _ => Vouch::decode_in_arrears(reader).map(|(read, excess)| {
                        assert_eq!(read, vouch);
                        excess
                    }),
                }
            };
            assert_eq!(read(&bytes), Ok(excess));
            let head = if kind == Kind::StateInArrears {
                8
            } else {
                bytes.len()
            };
            for cut in 1..head {
                assert_eq!(read(&bytes[..cut]), Err(Malformed::Truncated));
            }
            let mut within = bytes;
            within[1] = 0;
            assert_eq!(read(&within), Err(Malformed::NotCanonical));
        }
    }

    #[test]
    fn a_full_packet_refuses_and_stays_as_it_was() {
        let saying = Saying::Whole(TrackSaying {
            predictor: rhumb_reckoning::Predictor::Uniform,
            anchor: rhumb_reckoning::Anchor::Verbatim(
                rhumb_reckoning::Verbatim::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [1.0; 3])
                    .unwrap(),
            ),
            carrier: None,
        });
        let mut writer = StateWriter::new(StreamId(7), 0, 0, 0);
        let mut index = 0;
        while writer.push(&Update {
            seat: index,
            body: Some(index),
            saying,
        }) {
            index += 1;
        }
        assert_eq!(usize::from(writer.count()), index as usize);
        let bytes = writer.finish(true);
        assert_eq!(decode(&bytes).unwrap().len(), index as usize);
    }
}
