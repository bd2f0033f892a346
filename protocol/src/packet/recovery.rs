//! Recovery of losses: reports, refreshes, checksums, repair symbols.
//!
//! A refresh holds the present tracks of the bodies in a lost packet, as keyframes with their ages, so it can be read
//! without any other packet. A refresh that exceeds a datagram is split into parts; each part is useful alone. Codec
//! only: `stream/state_checksum` computes the checksum over all tracks.
//!
//! A repair symbol is a sum over recent packets that recovers a lost one; `stream` decides which packets a symbol
//! covers and how losses are recovered. Invariant: the packets do not depend on repair symbols, so a packet can be read
//! alone.
//!
//! Bytes are elements of GF(256). Addition is exclusive or; multiplication is that of polynomials over one bit modulo
//! x⁸ + x⁴ + x³ + x² + 1 (PROTOCOL 5.16). Invariant: every non-zero element has an inverse.

use alloc::vec::Vec;

use rhumb_reckoning::Ticks;

use super::LargestPacket;
use super::header::{Datagram, Head, Low16, PacketKind, StreamId};
use super::keyframe::Keyframe;
use super::payload::AGE_MAX;
use crate::limits::{
    DATAGRAM_BYTES_MAX, FEC_ROWS, FEC_SPAN, INDICES_MAX, LARGEST_PACKET_MIN, LOST_NUMBERS_MAX,
    REFRESH_PARTS_MAX, UPDATES_PER_PACKET_MAX,
};
use crate::wire::bits::{BitReader, BitWriter, PutBits, TakeBits, golomb_len};
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

/// Orders of the codes of a record's index gap, alias and age.
const GAP_ORDER: u32 = 3;
const ALIAS_ORDER: u32 = 5;
const AGE_ORDER: u32 = 4;

/// One body's track.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RefreshRecord {
    /// Index of the body.
    pub index: u32,
    /// Its alias, if it has one.
    pub alias: Option<u32>,
    /// Ticks from the track's origin to the tick of the refresh.
    pub age: Ticks,
    /// The track, without its origin.
    pub keyframe: Keyframe,
}

/// One part of a refresh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refresh {
    /// Low bits of the lost packet's number.
    pub lost: Low16,
    /// Low bits of the tick to which the ages refer.
    pub tick: Low16,
    /// Low bits of the count of scene events that the reader must have received.
    pub scene_events: Low16,
    /// The index of this part.
    pub part: u8,
    /// The number of parts; at least one.
    pub parts: u8,
    /// The records, in rising order of index.
    pub records: Vec<RefreshRecord>,
}

impl Refresh {
    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no part of a refresh.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let lost = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let (part, parts) = (from.u8()?, from.u8()?);
        if part >= parts || parts > REFRESH_PARTS_MAX {
            return Err(Malformed::OutOfRange);
        }
        let count = from.varint_to((DATAGRAM_BYTES_MAX * 8) as u64)?;
        let mut bits = BitReader::new(from.rest());
        let mut records = Vec::new();
        let mut next_index = 0_u32;
        for _ in 0..count {
            let gap = bits.golomb(GAP_ORDER)?;
            let index = next_index.checked_add(gap).ok_or(Malformed::OutOfRange)?;
            let alias = bits.golomb(ALIAS_ORDER)?.checked_sub(1);
            let age = bits.golomb(AGE_ORDER)?;
            if index >= INDICES_MAX
                || age > AGE_MAX
                || alias.is_some_and(|alias| alias >= INDICES_MAX)
            {
                return Err(Malformed::OutOfRange);
            }
            let keyframe = Keyframe::decode(&mut bits)?;
            let age = Ticks::new(age);
            records.push(RefreshRecord {
                index,
                alias,
                age,
                keyframe,
            });
            next_index = index + 1;
        }
        bits.finish()?;
        Ok(Self {
            lost,
            tick,
            scene_events,
            part,
            parts,
            records,
        })
    }
}

/// Bytes before the records.
const HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 2 + 2 + 2 + 2;

/// Splits records into the datagrams of one refresh.
#[derive(Debug)]
pub struct RefreshWriter {
    largest_packet: LargestPacket,
    parts: Vec<(u16, Vec<u8>)>,
    bits: BitWriter,
    next_index: u32,
    count: u16,
}

impl Default for RefreshWriter {
    /// Makes datagrams as large as the protocol allows.
    fn default() -> Self {
        Self::within(LargestPacket::GREATEST)
    }
}

impl RefreshWriter {
    /// Makes datagrams of at most this size.
    #[must_use]
    pub fn within(largest_packet: LargestPacket) -> Self {
        Self {
            largest_packet,
            parts: Vec::new(),
            bits: BitWriter::default(),
            next_index: 0,
            count: 0,
        }
    }

    /// Appends a record, in rising order of index.
    pub fn push(&mut self, record: &RefreshRecord) {
        let age = record.age.count().min(AGE_MAX);
        let gap = record.index - self.next_index;
        let alias = record.alias.map_or(0, |alias| alias + 1);
        let bits = golomb_len(record.index, GAP_ORDER)
            + golomb_len(alias, ALIAS_ORDER)
            + golomb_len(age, AGE_ORDER);
        let bits = bits as usize + record.keyframe.bit_len();
        let full = self.bits.bit_len() + bits > (self.largest_packet.bytes() - HEAD_BYTES_MAX) * 8;
        let gap = if full {
            self.end_part();
            record.index
        } else {
            gap
        };
        self.bits.golomb(gap, GAP_ORDER);
        self.bits.golomb(alias, ALIAS_ORDER);
        self.bits.golomb(age, AGE_ORDER);
        record.keyframe.encode(&mut self.bits);
        self.next_index = record.index + 1;
        self.count += 1;
    }

    fn end_part(&mut self) {
        let bits = core::mem::take(&mut self.bits);
        self.parts.push((self.count, bits.into_bytes()));
        self.next_index = 0;
        self.count = 0;
    }

    /// The datagrams; one without records if no body of the lost packet needs a refresh.
    #[must_use]
    pub fn finish(
        mut self,
        stream: StreamId,
        lost: u64,
        tick: u64,
        scene_events: u64,
    ) -> Vec<Vec<u8>> {
        self.end_part();
        let parts = self.parts.len() as u8;
        let part_bytes = |(part, (count, bits)): (usize, (u16, Vec<u8>))| {
            let mut to = Writer::new();
            Head {
                kind: PacketKind::Refresh,
                stream,
            }
            .encode(&mut to);
            Low16::of(lost).encode(&mut to);
            Low16::of(tick).encode(&mut to);
            Low16::of(scene_events).encode(&mut to);
            to.u8(part as u8);
            to.u8(parts);
            to.varint(u64::from(count));
            to.raw(&bits);
            to.into_bytes()
        };
        self.parts.into_iter().enumerate().map(part_bytes).collect()
    }
}

// The bodies of the fullest packet fit the parts of a refresh, also in the smallest datagrams.
const _: () = assert!(
    UPDATES_PER_PACKET_MAX * (Keyframe::BITS_MAX + 100)
        <= REFRESH_PARTS_MAX as usize
            * (LARGEST_PACKET_MIN - HEAD_BYTES_MAX - Keyframe::BITS_MAX / 8)
            * 8
);

/// The checksum over a publisher's tracks after its newest packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checksums {
    /// Number of the stream's next packet: the checksum covers all packets before it.
    pub next: Low16,
    /// Low bits of the tick up to which everything was sent.
    pub tick: Low16,
    /// Low bits of the count of scene events up to that tick.
    pub scene_events: Low16,
    /// The checksum over the tracks of all bodies.
    pub sum: u64,
}

impl Checksums {
    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        let kind = PacketKind::Checksums;
        Head { kind, stream }.encode(&mut to);
        self.next.encode(&mut to);
        self.tick.encode(&mut to);
        self.scene_events.encode(&mut to);
        to.raw(&self.sum.to_le_bytes());
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if the body is no checksum packet.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let next = Low16::decode(&mut from)?;
        let tick = Low16::decode(&mut from)?;
        let scene_events = Low16::decode(&mut from)?;
        let mut sum = [0; 8];
        sum.copy_from_slice(from.raw(8)?);
        from.finish()?;
        Ok(Self {
            next,
            tick,
            scene_events,
            sum: u64::from_le_bytes(sum),
        })
    }
}

/// Bytes before the sums: kind, stream, last, covered, row.
pub(super) const REPAIR_SYMBOL_HEAD_BYTES_MAX: usize = 1 + 5 + 2 + 5 + 1;
/// Bytes of a source symbol before the updates: kind, tick, scene events.
pub(super) const SOURCE_SYMBOL_HEAD_BYTES: usize = 1 + 2 + 2;
/// The longest source symbol, bytes.
const SOURCE_SYMBOL_BYTES_MAX: usize = DATAGRAM_BYTES_MAX - REPAIR_SYMBOL_HEAD_BYTES_MAX;

/// A linear combination of source symbols in GF(256).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RepairSymbol {
    /// The number of the newest covered packet.
    pub last: Low16,
    /// The other covered packets as bits: bit 0 is the packet before the newest, and so on.
    pub covered: u32,
    /// The row of the coefficient matrix; below [`FEC_ROWS`].
    pub row: u8,
    /// The sums, without trailing zeros.
    pub sums: Vec<u8>,
}

impl RepairSymbol {
    /// The coefficient of a packet in a row. The coefficients of some rows and as many packets form a Cauchy matrix. It
    /// has an inverse as long as no two packet numbers differ by 128 (PROTOCOL 5.16).
    #[must_use]
    pub const fn factor(row: u8, number: u64) -> u8 {
        inverse((FEC_ROWS | row) ^ (number % FEC_ROWS as u64) as u8)
    }

    /// The numbers of the covered packets, newest first. `last` is the full number of the newest one.
    pub fn numbers(&self, last: u64) -> impl Iterator<Item = u64> + use<> {
        let mask = u64::from(self.covered) << 1 | 1;
        (0..u64::from(FEC_SPAN)).filter_map(move |back| {
            let covered = mask >> back & 1 == 1;
            last.checked_sub(back).filter(|_| covered)
        })
    }

    /// The repair symbol of some state packets, the newest last, whose numbers lie within [`FEC_SPAN`]. `None` for no
    /// packets, or if one of them cannot be covered.
    #[must_use]
    pub fn of(row: u8, packets: &[(u64, &[u8])]) -> Option<Self> {
        let (last, _) = *packets.last()?;
        let mut repair_symbol = Self::begin(row, last);
        for (number, datagram) in packets {
            let (_, source_symbol) = source_symbol_of(datagram)?;
            repair_symbol.add(*number, last.checked_sub(*number)?, &source_symbol);
        }
        repair_symbol
            .sums
            .truncate(without_zeros(&repair_symbol.sums).len());
        Some(repair_symbol)
    }

    /// A repair symbol that covers nothing yet.
    pub(crate) fn begin(row: u8, last: u64) -> Self {
        Self {
            last: Low16::of(last),
            covered: 0,
            row,
            sums: Vec::new(),
        }
    }

    /// Adds the source symbol of a packet that lies `back` numbers before the newest one.
    pub(crate) fn add(&mut self, number: u64, back: u64, source_symbol: &[u8]) {
        if back > 0 {
            self.covered |= 1 << (back - 1);
        }
        if self.sums.len() < source_symbol.len() {
            self.sums.resize(source_symbol.len(), 0);
        }
        add_times(
            &mut self.sums,
            Self::factor(self.row, number),
            source_symbol,
        );
    }

    /// Encodes the datagram.
    #[must_use]
    pub fn encode(&self, stream: StreamId) -> Vec<u8> {
        let mut to = Writer::new();
        Head {
            kind: PacketKind::RepairSymbol,
            stream,
        }
        .encode(&mut to);
        self.last.encode(&mut to);
        to.varint(u64::from(self.covered));
        to.u8(self.row);
        to.raw(without_zeros(&self.sums));
        to.into_bytes()
    }

    /// Reads the bytes after the head.
    ///
    /// # Errors
    ///
    /// [`Malformed`] if they are no repair symbol.
    pub fn decode(mut from: Reader<'_>) -> Result<Self, Malformed> {
        let last = Low16::decode(&mut from)?;
        let covered = from.varint32()?;
        let row = from.u8()?;
        let sums = from.rest();
        let far = covered.checked_shr(FEC_SPAN - 1).unwrap_or(0) != 0;
        if row >= FEC_ROWS || far {
            return Err(Malformed::OutOfRange);
        }
        if sums.len() > SOURCE_SYMBOL_BYTES_MAX {
            return Err(Malformed::TooLong);
        }
        if sums.last() == Some(&0) {
            return Err(Malformed::NotCanonical);
        }
        Ok(Self {
            last,
            covered,
            row,
            sums: sums.to_vec(),
        })
    }
}

/// The source symbol of a state packet: its kind, and the bytes after its number. `None` for another datagram, for a
/// packet without updates, and for one that is too long.
pub(crate) fn source_symbol_of(datagram: &[u8]) -> Option<(Low16, Vec<u8>)> {
    let mut source_symbol = Vec::new();
    let number = source_symbol_into(&Datagram::open(datagram).ok()?, &mut source_symbol)?;
    Some((number, source_symbol))
}

/// As [`source_symbol_of`], into a buffer whose content is replaced.
pub(crate) fn source_symbol_into(
    datagram: &Datagram<'_>,
    source_symbol: &mut Vec<u8>,
) -> Option<Low16> {
    source_symbol.clear();
    let mut reader = datagram.body();
    let kind = match datagram.head().kind {
        PacketKind::Updates => 0,
        PacketKind::UpdatesEnd => 1,
        _ => return None,
    };
    let number = Low16::decode(&mut reader).ok()?;
    let rest = reader.rest();
    // Trailing zeros would be lost; a packet with updates never ends in a zero byte.
    let is_recoverable = rest.last().is_some_and(|last| *last != 0);
    if !is_recoverable || rest.len() >= SOURCE_SYMBOL_BYTES_MAX {
        return None;
    }
    source_symbol.push(kind);
    source_symbol.extend_from_slice(rest);
    Some(number)
}

/// The datagram of a recovered source symbol; `None` if no packet has this symbol. It is shorter than the repair
/// symbol, or no longer than another packet that the symbol covers.
pub(crate) fn packet_of(stream: StreamId, number: u64, source_symbol: &[u8]) -> Option<Vec<u8>> {
    let (kind, rest) = without_zeros(source_symbol).split_first()?;
    let kind = match kind {
        0 => PacketKind::Updates,
        1 => PacketKind::UpdatesEnd,
        _ => return None,
    };
    let mut to = Writer::new();
    Head { kind, stream }.encode(&mut to);
    Low16::of(number).encode(&mut to);
    to.raw(rest);
    Some(to.into_bytes())
}

fn without_zeros(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|byte| *byte != 0);
    &bytes[..end.map_or(0, |end| end + 1)]
}

/// x⁸ + x⁴ + x³ + x² + 1, of which x is a generator. Source: PROTOCOL 5.16.
const POLYNOMIAL: u16 = 0x11d;

/// Powers of x, twice over so that a sum of two logarithms needs no reduction, and logarithms to base x.
struct GaloisTables {
    of: [u8; 510],
    log: [u8; 256],
}

const POWERS: GaloisTables = powers();

const fn powers() -> GaloisTables {
    let mut powers = GaloisTables {
        of: [0; 510],
        log: [0; 256],
    };
    let mut value = 1_u16;
    let mut exponent = 0;
    while exponent < 255 {
        powers.of[exponent] = value as u8;
        powers.of[exponent + 255] = value as u8;
        powers.log[value as usize] = exponent as u8;
        value <<= 1;
        if value > 0xff {
            value ^= POLYNOMIAL;
        }
        exponent += 1;
    }
    powers
}

/// The product of two elements.
pub(crate) const fn times(a: u8, b: u8) -> u8 {
    if a == 0 || b == 0 {
        return 0;
    }
    let exponent = POWERS.log[a as usize] as usize + POWERS.log[b as usize] as usize;
    POWERS.of[exponent]
}

/// The inverse of a non-zero element; zero for zero.
pub(crate) const fn inverse(a: u8) -> u8 {
    if a == 0 {
        return 0;
    }
    POWERS.of[255 - POWERS.log[a as usize] as usize]
}

/// Adds `factor` times each term to the sum at the same position. Terms beyond the sums are ignored.
pub(crate) fn add_times(sums: &mut [u8], factor: u8, terms: &[u8]) {
    if factor == 0 {
        return;
    }
    let log = usize::from(POWERS.log[usize::from(factor)]);
    for (sum, term) in sums.iter_mut().zip(terms) {
        if *term != 0 {
            *sum ^= POWERS.of[log + usize::from(POWERS.log[usize::from(*term)])];
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;
    use rhumb_reckoning::{Anchor, BodyState, Predictor};

    use super::*;

    proptest! {
        #[test]
        fn a_loss_report_round_trips(next: u16, abandoned: u16, repair_symbols in 0..=FEC_SPAN as u8, lost in vec(any::<u16>(), 0..LOST_NUMBERS_MAX)) {
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

    fn record(index: u32) -> RefreshRecord {
        let moving =
            BodyState::new([index as f32; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3], [2.0; 3]).unwrap();
        RefreshRecord {
            index,
            alias: (!index.is_multiple_of(3)).then_some(index / 2),
            age: Ticks::new(index % 1_000),
            keyframe: Keyframe {
                predictor: Predictor::Ballistic,
                anchor: Anchor::Exact(moving),
                parent: None,
            },
        }
    }

    fn decode(datagram: &[u8]) -> Refresh {
        let mut reader = Reader::new(datagram);
        assert_eq!(Head::decode(&mut reader).unwrap().kind, PacketKind::Refresh);
        Refresh::decode(reader).unwrap()
    }

    #[test]
    fn refresh_parts_decode_independently() {
        let mut writer = RefreshWriter::default();
        let written: Vec<_> = (0..100).map(|i| record(i * 7)).collect();
        for one in &written {
            writer.push(one);
        }
        let datagrams = writer.finish(StreamId(1), 5, 6, 7);
        assert!(datagrams.len() > 1);
        let mut received = Vec::new();
        for (part, datagram) in datagrams.iter().enumerate() {
            assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
            let refresh = decode(datagram);
            assert_eq!(
                (usize::from(refresh.part), usize::from(refresh.parts)),
                (part, datagrams.len())
            );
            received.extend(refresh.records);
        }
        assert_eq!(received, written);
    }

    #[test]
    fn empty_refresh_is_encoded() {
        let datagrams = RefreshWriter::default().finish(StreamId(1), 5, 6, 7);
        assert_eq!(datagrams.len(), 1);
        assert_eq!(decode(&datagrams[0]).records, []);
        for cut in 2..datagrams[0].len() {
            assert_eq!(
                Refresh::decode(Reader::new(&datagrams[0][2..cut])),
                Err(Malformed::Truncated)
            );
        }
    }

    #[test]
    fn a_checksum_packet_has_these_bytes() {
        let checksums = Checksums {
            next: Low16(0x1170),
            tick: Low16(300),
            scene_events: Low16(12),
            sum: 0x0102_0304_0506_0708,
        };
        let bytes = checksums.encode(StreamId(5));
        let expected = [0x57, 0x70, 0x11, 0x2c, 1, 12, 0, 8, 7, 6, 5, 4, 3, 2, 1];
        assert_eq!(bytes, expected);
        let mut reader = Reader::new(&bytes);
        assert!(Head::decode(&mut reader).is_ok());
        assert_eq!(Checksums::decode(reader.clone()), Ok(checksums));
        for cut in 0..reader.rest().len() {
            assert!(Checksums::decode(Reader::new(&reader.rest()[..cut])).is_err());
        }
    }

    fn decode_symbol(datagram: &[u8]) -> Result<RepairSymbol, Malformed> {
        let mut reader = Reader::new(datagram);
        assert_eq!(Head::decode(&mut reader)?.kind, PacketKind::RepairSymbol);
        RepairSymbol::decode(reader)
    }

    proptest! {
        #[test]
        fn a_repair_symbol_round_trips(last: u16, covered in 0_u32..1 << 31, row in 0..FEC_ROWS, sums in vec(any::<u8>(), 0..SOURCE_SYMBOL_BYTES_MAX)) {
            let sums = without_zeros(&sums).to_vec();
            let repair_symbol = RepairSymbol { last: Low16(last), covered, row, sums };
            let datagram = repair_symbol.encode(StreamId(300));
            prop_assert!(datagram.len() <= DATAGRAM_BYTES_MAX);
            prop_assert_eq!(decode_symbol(&datagram), Ok(repair_symbol));
        }

        #[test]
        fn arbitrary_bytes_are_refused_or_reencode_identically(bytes in vec(any::<u8>(), 0..40)) {
            let mut datagram = alloc::vec![0x19];
            datagram.extend(&bytes);
            if let Ok(repair_symbol) = decode_symbol(&datagram) {
                prop_assert_eq!(repair_symbol.encode(StreamId(1)), datagram);
            }
        }

        #[test]
        fn a_packet_is_recovered_from_its_source_symbol(kind in 0_u8..2, number: u16, rest in vec(any::<u8>(), 1..200), zeros in 0_usize..9) {
            let mut datagram = alloc::vec![kind | 0x70];
            datagram.extend(number.to_le_bytes());
            datagram.extend(&rest);
            match source_symbol_of(&datagram) {
                Some((low, mut source_symbol)) => {
                    prop_assert_eq!(low, Low16(number));
                    source_symbol.resize(source_symbol.len() + zeros, 0);
                    let number = 3 << 16 | u64::from(number);
                    prop_assert_eq!(packet_of(StreamId(7), number, &source_symbol), Some(datagram));
                }
                None => prop_assert_eq!(rest.last(), Some(&0)),
            }
        }
    }

    #[test]
    fn the_coefficients_of_a_row_are_distinct_and_not_zero() {
        for row in 0..FEC_ROWS {
            let mut factors: Vec<u8> = (0..128).map(|n| RepairSymbol::factor(row, n)).collect();
            factors.sort_unstable();
            factors.dedup();
            assert_eq!(factors.len(), 128);
            assert_ne!(factors[0], 0);
        }
    }

    #[test]
    fn invalid_repair_symbols_are_refused() {
        let repair_symbol = RepairSymbol {
            last: Low16(5),
            covered: 3,
            row: 2,
            sums: alloc::vec![1, 2, 3],
        };
        let good = repair_symbol.encode(StreamId(1));
        assert_eq!(good, [0x19, 5, 0, 3, 2, 1, 2, 3]);
        let with = |place: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[place] = byte;
            decode_symbol(&bytes)
        };
        assert_eq!(with(4, FEC_ROWS), Err(Malformed::OutOfRange));
        assert_eq!(with(7, 0), Err(Malformed::NotCanonical));
        let far = [0x19, 5, 0, 0x80, 0x80, 0x80, 0x80, 8, 2, 1];
        assert_eq!(decode_symbol(&far), Err(Malformed::OutOfRange));
        for cut in 1..5 {
            assert_eq!(decode_symbol(&good[..cut]), Err(Malformed::Truncated));
        }
        let mut long = good;
        long.resize(DATAGRAM_BYTES_MAX + 1, 1);
        assert_eq!(decode_symbol(&long), Err(Malformed::TooLong));
    }

    /// Multiplication by shifts and reduction, as the specification defines it.
    fn by_shifts(a: u8, b: u8) -> u8 {
        let mut sum = 0_u16;
        for bit in 0..8 {
            if b >> bit & 1 == 1 {
                sum ^= u16::from(a) << bit;
            }
        }
        for bit in (8..16).rev() {
            if sum >> bit & 1 == 1 {
                sum ^= POLYNOMIAL << (bit - 8);
            }
        }
        sum as u8
    }

    #[test]
    fn products_are_those_of_polynomials_and_every_element_has_an_inverse() {
        for a in 0..=255 {
            for b in 0..=255 {
                assert_eq!(times(a, b), by_shifts(a, b), "{a} {b}");
            }
            let one = u8::from(a != 0);
            assert_eq!(times(a, inverse(a)), one, "{a}");
        }
    }

    #[test]
    fn terms_beyond_the_sums_are_ignored() {
        let mut sums = [1, 2, 3];
        add_times(&mut sums, 7, &[0, 9]);
        assert_eq!(sums, [1, 2 ^ times(7, 9), 3]);
        add_times(&mut sums, 0, &[5; 3]);
        add_times(&mut sums, 1, &[1, 2 ^ times(7, 9), 3, 4, 5]);
        assert_eq!(sums, [0; 3]);
    }
}
