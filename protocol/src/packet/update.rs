//! The packets of a stream: updates and watermarks, or full states.
//!
//! Codec only: `publisher/packer` decides which updates a packet holds.
//!
//! A full stream, 56 bytes for a body, is the naive baseline for measuring reckoned streams, and a view of the engine
//! without any loss of precision.
//!
//! Symbol counts, and packets that no publisher sends, are not part of the protocol: a tool that fits tables decodes
//! recorded packets and counts their symbols (docs/decisions/0014); tests need packets that a subscriber refuses.

use alloc::vec::Vec;

use rhumb_reckoning::BodyState;

use super::LargestPacket;
use super::cost::CostModel;
use super::header::{ErrorScale, Head, Low16, PacketKind, StreamId};
use super::keyframe::Keyframe;
use super::model::{Model, code_cost};
use super::payload::{CountSink, UpdateCoder, UpdatePayload};
use super::recovery::{REPAIR_SYMBOL_HEAD_BYTES_MAX, SOURCE_SYMBOL_HEAD_BYTES};
use super::tables::{CLASSES, CODE_COUNT, CONTEXTS, GROUPS, MODES, SHAPES, SYMBOLS, contexts};
use crate::limits::{DATAGRAM_BYTES_MAX, INDICES_MAX, UPDATES_PER_PACKET_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::range::{RangeReader, RangeWriter, TOTAL_BITS};
use crate::wire::{Malformed, Wire};

/// The update of one body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Update {
    /// The body's alias. Frequently updated bodies have neighbouring aliases, which keeps alias gaps short.
    pub alias: u32,
    /// Index of the body, if it takes the alias or the payload is a keyframe; otherwise the alias already refers to it.
    /// Its generation is the one in the scene at the packet's tick.
    pub body: Option<u32>,
    /// The new track of the body.
    pub payload: UpdatePayload,
}

/// Writes one packet of updates, given in rising order of alias.
#[derive(Debug)]
pub struct UpdateWriter {
    range_writer: RangeWriter,
    coder: UpdateCoder,
    largest_packet: LargestPacket,
    next_alias: u32,
    count: u16,
    stream: StreamId,
    number: Low16,
    tick: Low16,
    scene_events: Low16,
}

/// Bytes before the updates: kind, stream, error scale, number, tick, scene events.
const HEAD_BYTES_MAX: usize = 1 + 5 + 1 + 2 + 2 + 2;
/// Upper bound of the bytes of updates, so that a repair symbol over the packet is no larger than the largest packet.
const fn updates_bytes_max(largest_packet: LargestPacket) -> usize {
    largest_packet.bytes() - REPAIR_SYMBOL_HEAD_BYTES_MAX - SOURCE_SYMBOL_HEAD_BYTES
}
/// Upper bound of the bytes of the end code.
const END_BYTES_MAX: usize = 2;
/// Upper bound of the bytes of an alias gap and a body's index.
const GAP_BYTES_MAX: usize = 12;
/// Upper bound of an update: fifteen numbers of at most 88 bits each, a form, two references, and an eighth more.
const UPDATE_BYTES_MAX: usize = 256;

impl UpdateWriter {
    /// An empty packet, at most as large as the protocol allows.
    #[must_use]
    pub fn new(stream: StreamId, number: u64, tick: u64, scene_events: u64) -> Self {
        Self {
            range_writer: RangeWriter::with_capacity(DATAGRAM_BYTES_MAX),
            coder: UpdateCoder::default(),
            largest_packet: LargestPacket::GREATEST,
            next_alias: 0,
            count: 0,
            stream,
            number: Low16::of(number),
            tick: Low16::of(tick),
            scene_events: Low16::of(scene_events),
        }
    }

    /// Bounds the size of the datagram, and of a repair symbol over it.
    #[must_use]
    pub const fn within(mut self, largest_packet: LargestPacket) -> Self {
        self.largest_packet = largest_packet;
        self
    }

    /// Appends an update. Returns `false` and leaves the packet unchanged if the update does not fit.
    ///
    /// # Panics
    ///
    /// If aliases do not rise: the publisher sorts the updates.
    pub fn push(&mut self, update: &Update) -> bool {
        let gap = update
            .alias
            .checked_sub(self.next_alias)
            .expect("updates come in rising order of alias");
        let free_bytes = (updates_bytes_max(self.largest_packet) - END_BYTES_MAX)
            .saturating_sub(self.range_writer.byte_len_max());
        let full = usize::from(self.count) == UPDATES_PER_PACKET_MAX;
        if full || free_bytes < UPDATE_BYTES_MAX && self.bytes_max(&update.payload) > free_bytes {
            return false;
        }
        self.append(gap, update);
        true
    }

    fn append(&mut self, gap: u32, update: &Update) {
        self.coder
            .write(gap, update.body, &update.payload, &mut self.range_writer);
        self.next_alias = update.alias + 1;
        self.count += 1;
    }

    /// Upper bound of the bytes that an update takes.
    fn bytes_max(&self, payload: &UpdatePayload) -> usize {
        // The estimate may lie slightly below the true cost, and a range holds slightly less than its size.
        let cost = self.coder.cost(payload) as usize;
        (cost + cost / 8) / (8 * 256) + GAP_BYTES_MAX
    }

    /// The number of updates in the packet.
    #[must_use]
    pub const fn count(&self) -> u16 {
        self.count
    }

    /// Encodes the datagram.
    #[must_use]
    pub fn finish(self, ends_tick: bool) -> Vec<u8> {
        let kind = if ends_tick {
            PacketKind::UpdatesEnd
        } else {
            PacketKind::Updates
        };
        self.finish_as(kind, None)
    }

    /// Encodes the last datagram of a tick at which tracks exceed their tolerances by this factor.
    #[must_use]
    pub fn finish_over_budget(self, error_scale: ErrorScale) -> Vec<u8> {
        self.finish_as(PacketKind::UpdatesOverBudget, Some(error_scale))
    }

    fn finish_as(mut self, kind: PacketKind, error_scale: Option<ErrorScale>) -> Vec<u8> {
        self.coder.end(&mut self.range_writer);
        let updates = self.range_writer.into_bytes();
        let mut head = Writer::with_capacity(HEAD_BYTES_MAX + updates.len());
        Head {
            kind,
            stream: self.stream,
        }
        .encode(&mut head);
        if let Some(error_scale) = error_scale {
            error_scale.encode(&mut head);
        }
        self.number.encode(&mut head);
        self.tick.encode(&mut head);
        self.scene_events.encode(&mut head);
        head.raw(&updates);
        head.into_bytes()
    }
}

/// The decoded head of an update packet, with its updates still encoded.
#[derive(Clone, Debug)]
pub struct UpdatePacket<'a> {
    /// Low bits of the packet number.
    pub number: Low16,
    /// Low bits of the tick.
    pub tick: Low16,
    /// Low bits of the count of scene events that the reader must have received.
    pub scene_events: Low16,
    /// True if this is the last packet of its tick.
    pub ends_tick: bool,
    /// The factor by which tracks may exceed their tolerances, if the packet carries one.
    pub error_scale: ErrorScale,
    range_reader: RangeReader<'a>,
}

impl<'a> UpdatePacket<'a> {
    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no update packet.
    pub fn decode(ends_tick: bool, mut from: Reader<'a>) -> Result<Self, Malformed> {
        let number = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        Ok(Self {
            number,
            tick,
            scene_events,
            ends_tick,
            error_scale: ErrorScale::NONE,
            range_reader: RangeReader::new(from.rest()),
        })
    }

    /// Reads the bytes after the head of a packet with an error scale.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no such packet.
    pub fn decode_over_budget(mut from: Reader<'a>) -> Result<Self, Malformed> {
        let error_scale = ErrorScale::decode(&mut from)?;
        let packet = Self::decode(true, from)?;
        Ok(Self {
            error_scale,
            ..packet
        })
    }

    /// Decodes every update; `out` keeps its capacity from packet to packet.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if a publisher could not have written the updates; the content of `out` is then meaningless.
    pub fn updates(mut self, out: &mut Vec<Update>) -> Result<(), Malformed> {
        out.clear();
        let mut coder = UpdateCoder::default();
        let mut next_alias = 0_u32;
        while coder.read(&mut self.range_reader, |gap, body, payload| {
            if out.len() == UPDATES_PER_PACKET_MAX {
                return Err(Malformed::TooLong);
            }
            let alias = next_alias.checked_add(gap).ok_or(Malformed::OutOfRange)?;
            if alias >= INDICES_MAX {
                return Err(Malformed::OutOfRange);
            }
            out.push(Update {
                alias,
                body,
                payload,
            });
            next_alias = alias + 1;
            Ok(())
        })? {}
        self.range_reader.finish()
    }
}

/// States that all packets before `next` were sent, and everything up to a tick (PROTOCOL 5.10).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Watermark {
    /// Low bits of the number of the stream's next packet.
    pub next: Low16,
    /// Low bits of the tick.
    pub tick: Low16,
    /// Low bits of the count of scene events up to that tick.
    pub scene_events: Low16,
}

impl Watermark {
    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        self.encode_as(PacketKind::Watermark, stream, None)
    }

    /// Encodes the datagram for ticks at which tracks exceed their tolerances by this factor (PROTOCOL 5.17).
    #[must_use]
    pub fn encode_over_budget(&self, stream: StreamId, error_scale: ErrorScale) -> Vec<u8> {
        self.encode_as(PacketKind::WatermarkOverBudget, stream, Some(error_scale))
    }

    fn encode_as(
        &self,
        kind: PacketKind,
        stream: StreamId,
        error_scale: Option<ErrorScale>,
    ) -> Vec<u8> {
        let mut to = Writer::new();
        Head { kind, stream }.encode(&mut to);
        if let Some(error_scale) = error_scale {
            error_scale.encode(&mut to);
        }
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no watermark.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let watermark = Self {
            next: Low16::decode(&mut from)?,
            tick: Low16::decode(&mut from)?,
            scene_events: Low16::decode(&mut from)?,
        };
        from.finish()?;
        Ok(watermark)
    }

    /// Reads the bytes after the head of a watermark with an error scale.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no such watermark.
    pub fn decode_over_budget(mut from: Reader<'_>) -> Result<(Self, ErrorScale), Malformed> {
        let error_scale = ErrorScale::decode(&mut from)?;
        Ok((Self::decode(from)?, error_scale))
    }
}

// Every packet holds the longest update, and a datagram holds the packet.
const _: () =
    assert!(updates_bytes_max(LargestPacket::LEAST) > Keyframe::BITS_MAX / 8 + 32 + END_BYTES_MAX);
const _: () = assert!(HEAD_BYTES_MAX <= REPAIR_SYMBOL_HEAD_BYTES_MAX + SOURCE_SYMBOL_HEAD_BYTES);

/// Index (u32), position, quaternion x y z w, linear and angular velocity (f32 each), little-endian.
const FULL_RECORD_BYTES: usize = 4 + 13 * 4;

/// Bytes before the records.
const FULL_HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 2 + 2;

/// One body's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FullRecord {
    /// Index of the body.
    pub index: u32,
    /// Its state, bit for bit.
    pub motion: BodyState,
}

impl FullRecord {
    fn encoded(&self) -> [u8; FULL_RECORD_BYTES] {
        let mut bytes = [0; FULL_RECORD_BYTES];
        let (index, motion) = bytes.split_at_mut(4);
        index.copy_from_slice(&self.index.to_le_bytes());
        for (place, part) in motion.chunks_exact_mut(4).zip(self.motion.parts()) {
            place.copy_from_slice(&part.to_le_bytes());
        }
        bytes
    }

    fn decode(bytes: &[u8; FULL_RECORD_BYTES]) -> Result<Self, Malformed> {
        let four = |place: usize| [0, 1, 2, 3].map(|byte| bytes[4 * place + byte]);
        let part = |place: usize| f32::from_le_bytes(four(1 + place));
        let three = |first: usize| [part(first), part(first + 1), part(first + 2)];
        let index = u32::from_le_bytes(four(0));
        if index >= INDICES_MAX {
            return Err(Malformed::OutOfRange);
        }
        let rotation = [part(3), part(4), part(5), part(6)];
        let motion = BodyState::new(three(0), rotation, three(7), three(10))
            .map_err(|_| Malformed::NotFinite)?;
        Ok(Self { index, motion })
    }
}

/// One packet of states.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FullPacket {
    /// Low bits of the packet number.
    pub number: Low16,
    /// Low bits of the tick.
    pub tick: Low16,
    /// Low bits of the count of scene events that the reader must have received.
    pub scene_events: Low16,
    /// True if this is the last packet of its tick.
    pub ends_tick: bool,
    /// The states.
    pub records: Vec<FullRecord>,
}

impl FullPacket {
    /// The number of records that fit a datagram.
    pub const RECORDS_MAX: usize = Self::records_within(LargestPacket::GREATEST);

    /// The number of records that fit a datagram of this size.
    #[must_use]
    pub(crate) const fn records_within(largest_packet: LargestPacket) -> usize {
        (largest_packet.bytes() - FULL_HEAD_BYTES_MAX) / FULL_RECORD_BYTES
    }

    /// Encodes the datagram.
    ///
    /// # Panics
    ///
    /// With more than [`Self::RECORDS_MAX`] records.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        assert!(
            self.records.len() <= Self::RECORDS_MAX,
            "records fit a datagram"
        );
        let kind = if self.ends_tick {
            PacketKind::FullEnd
        } else {
            PacketKind::Full
        };
        let bytes = FULL_HEAD_BYTES_MAX + self.records.len() * FULL_RECORD_BYTES;
        let mut to = Writer::with_capacity(bytes);
        Head { kind, stream }.encode(&mut to);
        self.number.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        for record in &self.records {
            to.raw(&record.encoded());
        }
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no packet of states.
    pub fn decode(ends_tick: bool, mut from: Reader<'_>) -> Result<Self, Malformed> {
        let number = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let mut records = Vec::with_capacity(from.rest().len() / FULL_RECORD_BYTES);
        while !from.rest().is_empty() {
            records.push(FullRecord::decode(&from.array()?)?);
        }
        Ok(Self {
            number,
            tick,
            scene_events,
            ends_tick,
            records,
        })
    }
}

/// The symbols of one packet.
#[derive(Clone, Debug, Default)]
pub struct SymbolCounts {
    /// Row and code of each form, of each alias assignment, and of the end.
    pub codes: Vec<[usize; 2]>,
    /// Context and value of each number, in order.
    pub numbers: Vec<(usize, u32)>,
}

impl SymbolCounts {
    /// The number of rows of forms, and of codes in each.
    pub const CODES: [usize; 2] = [4, CODE_COUNT];
    /// The numbers of contexts, of context groups, of classes in each group, and of symbols in an alphabet.
    pub const NUMBERS: [usize; 4] = [CONTEXTS, GROUPS, CLASSES, SYMBOLS];

    /// Counts a packet's updates.
    #[must_use]
    pub fn of(updates: &[Update]) -> Self {
        let (mut tally, mut coder, mut next) = (Self::default(), UpdateCoder::default(), 0);
        for update in updates {
            let (gap, named) = (update.alias - next, update.body.is_some());
            coder.note(gap, named, &update.payload, &mut tally);
            next = update.alias + 1;
        }
        coder.note_end(&mut tally);
        tally
    }

    /// The cost of all symbols under the packet coder, in 1/256 bits.
    #[must_use]
    pub fn coded(&self) -> u64 {
        let mut model = Model::default();
        let codes = self.codes.iter().map(|&[row, code]| code_cost(row, code));
        let codes: u64 = codes.map(u64::from).sum();
        let numbers = self.numbers.iter().map(|&(context, number)| {
            let cost = model.cost(context, number);
            model.learn(context, number);
            u64::from(cost)
        });
        codes + numbers.sum::<u64>()
    }

    /// The group of a context. Contexts of one group share their alphabets.
    #[must_use]
    pub const fn group(context: usize) -> usize {
        contexts::group(context)
    }
}

impl CountSink for SymbolCounts {
    fn code(&mut self, row: usize, code: usize) {
        self.codes.push([row, code]);
    }

    fn number(&mut self, context: usize, number: u32) {
        self.numbers.push((context, number));
    }
}

/// The updates of one packet, encoded number by number without checks.
#[derive(Debug, Default)]
pub struct TestEncoder {
    model: Model,
    range_writer: RangeWriter,
}

impl TestEncoder {
    /// Appends a number in a context.
    #[must_use]
    pub fn number(mut self, context: usize, number: u32) -> Self {
        self.model.write(context, number, &mut self.range_writer);
        self
    }

    /// Appends a code of a form, or of an alias assignment, after a form of this row.
    #[must_use]
    pub fn code(mut self, row: usize, code: usize) -> Self {
        let starts = &MODES[row];
        let size = starts[code + 1] - starts[code];
        self.range_writer
            .symbol(u32::from(starts[code]), u32::from(size), TOTAL_BITS);
        self
    }

    /// Appends the last symbol of a shape.
    #[must_use]
    pub fn escape(mut self, shape: usize) -> Self {
        let start = SHAPES[shape][SYMBOLS - 1];
        let size = SHAPES[shape][SYMBOLS] - start;
        self.range_writer
            .symbol(u32::from(start), u32::from(size), TOTAL_BITS);
        self
    }

    /// Appends raw bits; `count` is at most 32.
    #[must_use]
    pub fn raw(mut self, value: u32, count: u32) -> Self {
        self.range_writer.raw(value, count);
        self
    }

    /// The encoded bytes.
    #[must_use]
    pub fn into_bytes(self) -> Vec<u8> {
        self.range_writer.into_bytes()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, Predictor};

    use super::*;
    use crate::packet::payload::tests::payload;

    fn updates() -> impl Strategy<Value = Vec<Update>> {
        let body = proptest::option::of(0..INDICES_MAX);
        proptest::collection::btree_map(0..INDICES_MAX, (body, payload()), 0..8).prop_map(|map| {
            map.into_iter()
                .map(|(alias, (body, payload))| {
                    let is_keyframe = matches!(payload, UpdatePayload::Keyframe(_));
                    let body = body.or(is_keyframe.then_some(alias));
                    Update {
                        alias,
                        body,
                        payload,
                    }
                })
                .collect()
        })
    }

    /// The packet with these updates, whatever the writer estimates.
    fn datagram(updates: &[Update]) -> Vec<u8> {
        let mut writer = UpdateWriter::new(StreamId(7), 70_000, 80_000, 90_000);
        for update in updates {
            writer.append(update.alias - writer.next_alias, update);
        }
        writer.finish(true)
    }

    fn decode(bytes: &[u8]) -> Result<Vec<Update>, Malformed> {
        let mut reader = Reader::new(bytes);
        let head = Head::decode(&mut reader)?;
        assert_eq!(
            head,
            Head {
                kind: PacketKind::UpdatesEnd,
                stream: StreamId(7)
            }
        );
        let mut out = Vec::new();
        UpdatePacket::decode(true, reader)?.updates(&mut out)?;
        Ok(out)
    }

    proptest! {
        #[test]
        fn a_packet_round_trips(updates in updates()) {
            let bytes = datagram(&updates);
            prop_assert!(bytes.len() <= DATAGRAM_BYTES_MAX);
            prop_assert_eq!(decode(&bytes), Ok(updates));
        }

        /// Both readings take at most the bytes that arrived. A writer may still refuse to write the other one: `push`
        /// stops while its estimate, which is above the true size, exceeds the free bytes. So the other packet is
        /// written here without that estimate.
        #[test]
        fn a_truncation_is_refused_or_is_another_canonical_packet(updates in updates()) {
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
    fn over_budget_packets_round_trip() {
        let error_scale = ErrorScale::covering(3.0);
        let writer = UpdateWriter::new(StreamId(7), 70_000, 80_000, 90_000);
        let state = writer.finish_over_budget(error_scale);
        let watermark = Watermark {
            next: Low16(1),
            tick: Low16(2),
            scene_events: Low16(3),
        };
        let silence = watermark.encode_over_budget(StreamId(7), error_scale);
        for (bytes, kind) in [
            (state, PacketKind::UpdatesOverBudget),
            (silence, PacketKind::WatermarkOverBudget),
        ] {
            let stream = StreamId(7);
            let read = |bytes: &[u8]| {
                let mut reader = Reader::new(bytes);
                assert_eq!(Head::decode(&mut reader), Ok(Head { kind, stream }));
                match kind {
                    PacketKind::UpdatesOverBudget => UpdatePacket::decode_over_budget(reader)
                        .and_then(|packet| {
                            assert!(packet.ends_tick);
                            let error_scale = packet.error_scale;
                            packet.updates(&mut Vec::new()).map(|()| error_scale)
                        }),
                    _ => Watermark::decode_over_budget(reader).map(|(read, error_scale)| {
                        assert_eq!(read, watermark);
                        error_scale
                    }),
                }
            };
            assert_eq!(read(&bytes), Ok(error_scale));
            let head = if kind == PacketKind::UpdatesOverBudget {
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
    fn a_full_packet_refuses_an_update_unchanged() {
        let payload = UpdatePayload::Keyframe(Keyframe {
            predictor: Predictor::Uniform,
            anchor: Anchor::Exact(
                BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [1.0; 3]).unwrap(),
            ),
            parent: None,
        });
        let mut writer = UpdateWriter::new(StreamId(7), 0, 0, 0);
        let mut index = 0;
        while writer.push(&Update {
            alias: index,
            body: Some(index),
            payload,
        }) {
            index += 1;
        }
        assert_eq!(usize::from(writer.count()), index as usize);
        let bytes = writer.finish(true);
        assert_eq!(decode(&bytes).unwrap().len(), index as usize);
    }

    #[test]
    fn a_full_packet_round_trips_and_its_truncations_are_refused() {
        let motion = BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [2.0; 3], [3.0; 3]).unwrap();
        let packet = FullPacket {
            number: Low16(1),
            tick: Low16(2),
            scene_events: Low16(3),
            ends_tick: true,
            records: (0..FullPacket::RECORDS_MAX as u32)
                .map(|index| FullRecord { index, motion })
                .collect(),
        };
        let bytes = packet.encode(StreamId(9));
        assert!(bytes.len() <= LargestPacket::GREATEST.bytes());
        let mut reader = Reader::new(&bytes);
        assert_eq!(Head::decode(&mut reader).unwrap().kind, PacketKind::FullEnd);
        assert_eq!(FullPacket::decode(true, reader.clone()), Ok(packet));
        for cut in 0..reader.rest().len() {
            let whole_records = cut >= 6 && (cut - 6) % FULL_RECORD_BYTES == 0;
            assert_eq!(
                FullPacket::decode(true, Reader::new(&reader.rest()[..cut])).is_ok(),
                whole_records
            );
        }
    }
}
