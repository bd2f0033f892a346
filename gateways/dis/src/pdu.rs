//! PDUs of DIS, read and written, and their timestamps.
//!
//! Entity State, Entity State Update and Remove Entity are understood. Other PDUs, and versions other than 5 to 7, pass as
//! bytes. So do variable parameters, and whatever bits a field may hold: what is read is written again bit for bit. Reading
//! allocates nothing and never panics. A PDU whose length is not that of its contents is refused, and so is one that is
//! cut.
//!
//! A timestamp is time past the hour. Its unit is 3600 s / 2^31, or 1.676 µs; the lowest bit says whether the sender's clock
//! is absolute. No clock is read here.

use core::fmt;
use core::time::Duration;

use crate::entity::{
    EntityState, EntityStateUpdate, Fields, PARAMETER_BYTES, RemoveEntity, Writer,
};

/// Bytes of the header of every PDU.
pub const HEADER_BYTES: usize = 12;
/// Bytes of an Entity State PDU without variable parameters.
pub const ENTITY_STATE_BYTES: usize = 144;
/// Bytes of an Entity State Update PDU without variable parameters.
pub const UPDATE_BYTES: usize = 72;
/// Bytes of a Remove Entity PDU.
pub const REMOVE_BYTES: usize = 28;
/// Most variable parameters of a PDU: their count is one byte.
pub const PARAMETERS_MAX: usize = 255;

/// A type of PDU, by its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PduType(pub u8);

impl PduType {
    /// Entity State.
    pub const ENTITY_STATE: Self = Self(1);
    /// Remove Entity.
    pub const REMOVE_ENTITY: Self = Self(12);
    /// Entity State Update.
    pub const ENTITY_STATE_UPDATE: Self = Self(67);
}

/// The reason why bytes are no PDU. Offsets count from the start of the datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Malformed {
    /// Fewer bytes than a header has.
    CutHeader {
        /// Offset of the PDU.
        offset: usize,
        /// Bytes from there on.
        available: usize,
    },
    /// A length field below the header's own bytes.
    ShortLength {
        /// Offset of the PDU.
        offset: usize,
        /// As in its header.
        length: u16,
    },
    /// A length field beyond the datagram's end.
    Cut {
        /// Offset of the PDU.
        offset: usize,
        /// As in its header.
        length: u16,
        /// Bytes from there on.
        available: usize,
    },
    /// A length field that is not that of the PDU's contents.
    WrongLength {
        /// Offset of the PDU.
        offset: usize,
        /// Its type.
        pdu_type: PduType,
        /// As in its header.
        length: u16,
        /// Bytes of its type with its number of variable parameters.
        expected: usize,
    },
    /// Bytes after the only PDU.
    Trailing {
        /// Offset of the first of them.
        offset: usize,
        /// Their number.
        available: usize,
    },
}

impl fmt::Display for Malformed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::CutHeader { offset, available } => write!(
                f,
                "pdu at byte {offset} is cut: {available} bytes are left, its header has {HEADER_BYTES}"
            ),
            Self::ShortLength { offset, length } => write!(
                f,
                "length {length} at byte {} is less than the {HEADER_BYTES} bytes of a header",
                offset + LENGTH_OFFSET
            ),
            Self::Cut {
                offset,
                length,
                available,
            } => write!(
                f,
                "pdu at byte {offset} is cut: its length is {length}, {available} bytes are left"
            ),
            Self::Trailing { offset, available } => write!(
                f,
                "{available} bytes follow the only pdu, from byte {offset} on; a bundle is read as one"
            ),
            Self::WrongLength {
                offset,
                pdu_type,
                length,
                expected,
            } => write!(
                f,
                "length {length} at byte {} is not the {expected} bytes of this pdu of type {}",
                offset + LENGTH_OFFSET,
                pdu_type.0
            ),
        }
    }
}

impl core::error::Error for Malformed {}

/// The reason why a PDU is not written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unwritable {
    /// More bytes than there is room for.
    NoRoom {
        /// Bytes of the PDU.
        needed: usize,
        /// Bytes of the buffer.
        room: usize,
    },
    /// More variable parameters than their count can say.
    TooManyParameters {
        /// Their number.
        count: usize,
    },
    /// A body of bytes beyond the length field.
    TooLong {
        /// Bytes of the PDU.
        bytes: usize,
    },
}

impl fmt::Display for Unwritable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoRoom { needed, room } => {
                write!(f, "pdu of {needed} bytes, with room for {room}")
            }
            Self::TooManyParameters { count } => {
                write!(
                    f,
                    "{count} variable parameters are more than {PARAMETERS_MAX}"
                )
            }
            Self::TooLong { bytes } => {
                write!(f, "pdu of {bytes} bytes is longer than {}", u16::MAX)
            }
        }
    }
}

impl core::error::Error for Unwritable {}

/// The start of every PDU, but for its type and length, which follow from its body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// 5: IEEE 1278.1-1995, 6: 1278.1A-1998, 7: 1278.1-2012.
    pub version: u8,
    /// The exercise of the PDU; receivers ignore others.
    pub exercise: u8,
    /// Protocol family, 1 for entity information.
    pub family: u8,
    /// When its data are valid.
    pub timestamp: Timestamp,
    /// The PDU status of version 7; padding before.
    pub status: u8,
    /// Zero from most senders.
    pub padding: u8,
}

impl Header {
    /// A header of version 7 and the entity information family.
    #[must_use]
    pub const fn new(exercise: u8, timestamp: Timestamp) -> Self {
        Self {
            version: 7,
            exercise,
            family: 1,
            timestamp,
            status: 0,
            padding: 0,
        }
    }
}

/// The fields after a header.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Body<'a> {
    /// Type 1.
    EntityState(EntityState<'a>),
    /// Type 67.
    EntityStateUpdate(EntityStateUpdate<'a>),
    /// Type 12.
    RemoveEntity(RemoveEntity),
    /// Any other type, or version; not understood.
    Other {
        /// Its type.
        pdu_type: PduType,
        /// All after the header.
        bytes: &'a [u8],
    },
}

/// A PDU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pdu<'a> {
    /// The start of every PDU.
    pub header: Header,
    /// The rest.
    pub body: Body<'a>,
}

/// Versions whose bodies are understood.
const VERSIONS: core::ops::RangeInclusive<u8> = 5..=7;
/// Offset of the length in a header.
const LENGTH_OFFSET: usize = 8;

impl<'a> Pdu<'a> {
    /// Reads a PDU that stands alone in a datagram.
    ///
    /// # Errors
    ///
    /// [`Malformed`], also for bytes that follow the PDU.
    pub fn decode(bytes: &'a [u8]) -> Result<Self, Malformed> {
        let (frame, pdu) = Self::decode_first(bytes, 0)?;
        if frame == bytes.len() {
            Ok(pdu)
        } else {
            let available = bytes.len() - frame;
            Err(Malformed::Trailing {
                offset: frame,
                available,
            })
        }
    }

    /// Reads the PDU at the start of `bytes`, which stand at `offset` in their datagram; returns its bytes too.
    fn decode_first(bytes: &'a [u8], offset: usize) -> Result<(usize, Self), Malformed> {
        let length = frame_length(bytes, offset)?;
        let mut fields = Fields::new(&bytes[..usize::from(length)]);
        let [version, exercise, number, family] = fields.bytes();
        let timestamp = Timestamp(fields.u32());
        let [_, _, status, padding] = fields.bytes();
        let header = Header {
            version,
            exercise,
            family,
            timestamp,
            status,
            padding,
        };
        let pdu_type = PduType(number);
        let known = if VERSIONS.contains(&version) {
            check_length(pdu_type, &bytes[..usize::from(length)], length, offset)?
        } else {
            false
        };
        let body = match pdu_type {
            PduType::ENTITY_STATE if known => Body::EntityState(fields.entity_state()),
            PduType::ENTITY_STATE_UPDATE if known => Body::EntityStateUpdate(fields.update()),
            PduType::REMOVE_ENTITY if known => Body::RemoveEntity(RemoveEntity {
                originating: fields.entity_id(),
                receiving: fields.entity_id(),
                request: fields.u32(),
            }),
            _ => Body::Other {
                pdu_type,
                bytes: fields.rest(),
            },
        };
        Ok((usize::from(length), Self { header, body }))
    }

    /// Bytes of the PDU.
    #[must_use]
    pub const fn encoded_len(&self) -> usize {
        match &self.body {
            Body::EntityState(state) => {
                ENTITY_STATE_BYTES + PARAMETER_BYTES * state.parameters.len()
            }
            Body::EntityStateUpdate(update) => {
                UPDATE_BYTES + PARAMETER_BYTES * update.parameters.len()
            }
            Body::RemoveEntity(_) => REMOVE_BYTES,
            Body::Other { bytes, .. } => HEADER_BYTES + bytes.len(),
        }
    }

    /// Writes the PDU at the start of `to`, and returns its bytes. Nothing is written on an error.
    ///
    /// # Errors
    ///
    /// [`Unwritable`] when it has no room, and for a PDU that has no length or count on the wire.
    pub fn encode(&self, to: &mut [u8]) -> Result<usize, Unwritable> {
        let needed = self.encoded_len();
        let parameters = match &self.body {
            Body::EntityState(state) => state.parameters.len(),
            Body::EntityStateUpdate(update) => update.parameters.len(),
            Body::RemoveEntity(_) | Body::Other { .. } => 0,
        };
        if parameters > PARAMETERS_MAX {
            return Err(Unwritable::TooManyParameters { count: parameters });
        }
        let length = u16::try_from(needed).map_err(|_| Unwritable::TooLong { bytes: needed })?;
        let room = to.len();
        let to = to
            .get_mut(..needed)
            .ok_or(Unwritable::NoRoom { needed, room })?;
        let mut writer = Writer::new(to);
        let Header {
            version,
            exercise,
            family,
            timestamp,
            status,
            padding,
        } = self.header;
        writer.put(&[version, exercise, self.body.pdu_type().0, family]);
        writer.put(&timestamp.0.to_be_bytes());
        writer.put(&length.to_be_bytes());
        writer.put(&[status, padding]);
        match &self.body {
            Body::EntityState(state) => writer.entity_state(state),
            Body::EntityStateUpdate(update) => writer.update(update),
            Body::RemoveEntity(remove) => {
                writer.entity_id(remove.originating);
                writer.entity_id(remove.receiving);
                writer.put(&remove.request.to_be_bytes());
            }
            Body::Other { bytes, .. } => writer.put(bytes),
        }
        debug_assert_eq!(
            writer.written(),
            needed,
            "a pdu has the length that it says"
        );
        Ok(needed)
    }
}

impl Body<'_> {
    /// Its number in the header.
    #[must_use]
    pub const fn pdu_type(&self) -> PduType {
        match self {
            Self::EntityState(_) => PduType::ENTITY_STATE,
            Self::EntityStateUpdate(_) => PduType::ENTITY_STATE_UPDATE,
            Self::RemoveEntity(_) => PduType::REMOVE_ENTITY,
            Self::Other { pdu_type, .. } => *pdu_type,
        }
    }
}

/// The length field of the PDU at the start of `bytes`, if all of it is there.
fn frame_length(bytes: &[u8], offset: usize) -> Result<u16, Malformed> {
    let available = bytes.len();
    if available < HEADER_BYTES {
        return Err(Malformed::CutHeader { offset, available });
    }
    let length = u16::from_be_bytes([bytes[LENGTH_OFFSET], bytes[LENGTH_OFFSET + 1]]);
    if usize::from(length) < HEADER_BYTES {
        return Err(Malformed::ShortLength { offset, length });
    }
    if usize::from(length) > available {
        return Err(Malformed::Cut {
            offset,
            length,
            available,
        });
    }
    Ok(length)
}

/// True if this type is understood; its length must then be that of its contents.
fn check_length(
    pdu_type: PduType,
    frame: &[u8],
    length: u16,
    offset: usize,
) -> Result<bool, Malformed> {
    let with_parameters = |fixed: usize, count_at: usize| {
        let count = frame.get(count_at).copied().map_or(0, usize::from);
        fixed + PARAMETER_BYTES * count
    };
    let expected = match pdu_type {
        PduType::ENTITY_STATE => with_parameters(ENTITY_STATE_BYTES, 19),
        PduType::ENTITY_STATE_UPDATE => with_parameters(UPDATE_BYTES, 19),
        PduType::REMOVE_ENTITY => REMOVE_BYTES,
        _ => return Ok(false),
    };
    if usize::from(length) == expected {
        Ok(true)
    } else {
        Err(Malformed::WrongLength {
            offset,
            pdu_type,
            length,
            expected,
        })
    }
}

/// The PDUs of a datagram, which may be a bundle of several.
///
/// Ends after the datagram, or at the first PDU whose length cannot be trusted. One that has the wrong length for its type
/// is an error, and the next one follows it. Up to seven bytes of zeros that fill a PDU to a multiple of eight are skipped.
#[derive(Clone, Debug)]
pub struct Bundle<'a> {
    datagram: &'a [u8],
    offset: usize,
}

impl<'a> Bundle<'a> {
    /// The PDUs of this datagram.
    #[must_use]
    pub const fn new(datagram: &'a [u8]) -> Self {
        Self {
            datagram,
            offset: 0,
        }
    }

    fn skip_filling(&mut self) {
        let next = self.offset.next_multiple_of(8).min(self.datagram.len());
        if self.datagram[self.offset..next]
            .iter()
            .all(|byte| *byte == 0)
        {
            self.offset = next;
        }
    }
}

impl<'a> Iterator for Bundle<'a> {
    /// A PDU with its own bytes, or why there is none.
    type Item = Result<(&'a [u8], Pdu<'a>), Malformed>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = &self.datagram[self.offset..];
        if rest.is_empty() {
            return None;
        }
        let read = Pdu::decode_first(rest, self.offset);
        let frame = match &read {
            Ok((frame, _)) => *frame,
            Err(Malformed::WrongLength { length, .. }) => usize::from(*length),
            Err(_) => rest.len(),
        };
        self.offset += frame;
        self.skip_filling();
        Some(read.map(|(frame, pdu)| (&rest[..frame], pdu)))
    }
}

/// Length of an hour, in nanoseconds.
const HOUR_NS: u128 = 3_600_000_000_000;
/// Units in an hour.
const UNITS: u128 = 1 << 31;

/// The moment from which a timestamp counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeBase {
    /// From a moment that only the sender knows.
    Relative,
    /// From the last full hour of UTC.
    Absolute,
}

/// A timestamp as it is on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Timestamp(pub u32);

impl Timestamp {
    /// The timestamp of a moment, rounded to the nearest unit. Only its part past the hour is kept.
    #[must_use]
    pub const fn at(moment: Duration, base: TimeBase) -> Self {
        let units = ((moment.as_nanos() % HOUR_NS) * UNITS + HOUR_NS / 2) / HOUR_NS % UNITS;
        Self(((units as u32) << 1) | matches!(base, TimeBase::Absolute) as u32)
    }

    /// The origin from which it counts.
    #[must_use]
    pub const fn base(self) -> TimeBase {
        match self.0 & 1 {
            0 => TimeBase::Relative,
            _ => TimeBase::Absolute,
        }
    }

    /// Time past the hour, rounded down to a nanosecond; below one hour.
    #[must_use]
    pub const fn past_hour(self) -> Duration {
        Duration::from_nanos(((self.0 >> 1) as u128 * HOUR_NS / UNITS) as u64)
    }

    /// Seconds from `earlier` to this one by the shorter way around the hour, in [−1800, 1800).
    #[must_use]
    pub const fn seconds_since(self, earlier: Self) -> f64 {
        // The lowest bits are no part of the time. The difference of 31-bit counts keeps its sign in 32 bits.
        let units = (self.0 & !1).wrapping_sub(earlier.0 & !1).cast_signed() >> 1;
        units as f64 * (3600.0 / UNITS as f64)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;

    use super::*;
    use crate::entity::{DeadReckoning, EntityId, EntityType, FROZEN, Kinematics, Marking};

    /// Bytes of a PDU that is well formed, with anything in its fields.
    fn sound() -> impl Strategy<Value = Vec<u8>> {
        let form = prop_oneof![
            (0..4_usize).prop_map(|count| (1, count, ENTITY_STATE_BYTES + 16 * count)),
            (0..4_usize).prop_map(|count| (67, count, UPDATE_BYTES + 16 * count)),
            Just((12, 0, REMOVE_BYTES)),
            (13..60_u8, 12..80_usize).prop_map(|(pdu_type, length)| (pdu_type, 0, length)),
        ];
        (form, 5..8_u8).prop_flat_map(|((pdu_type, count, length), version)| {
            prop::collection::vec(any::<u8>(), length).prop_map(move |mut bytes| {
                bytes[0] = version;
                bytes[2] = pdu_type;
                bytes[8..10].copy_from_slice(&(length as u16).to_be_bytes());
                if pdu_type == 1 || pdu_type == 67 {
                    bytes[19] = count as u8;
                }
                bytes
            })
        })
    }

    proptest! {
        #[test]
        fn what_is_read_is_written_again_bit_for_bit(bytes in sound()) {
            let pdu = Pdu::decode(&bytes).expect("it is well formed");
            let mut written = vec![0xa5; bytes.len() + 3];
            prop_assert_eq!(pdu.encode(&mut written), Ok(bytes.len()));
            prop_assert_eq!(&written[..bytes.len()], &bytes[..]);
            prop_assert_eq!(&written[bytes.len()..], &[0xa5; 3]);
            let room = bytes.len() - 1;
            let refused = Unwritable::NoRoom { needed: bytes.len(), room };
            prop_assert_eq!(pdu.encode(&mut written[..room]), Err(refused));
        }

        #[test]
        fn every_cut_is_refused(bytes in sound(), cut in any::<prop::sample::Index>()) {
            let left = cut.index(bytes.len());
            let length = bytes.len() as u16;
            let expected = if left < HEADER_BYTES {
                Malformed::CutHeader { offset: 0, available: left }
            } else {
                Malformed::Cut { offset: 0, length, available: left }
            };
            prop_assert_eq!(Pdu::decode(&bytes[..left]), Err(expected));
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            for read in Bundle::new(&bytes) {
                match read {
                    Ok((frame, pdu)) => {
                        let mut written = vec![0; frame.len()];
                        prop_assert_eq!(pdu.encode(&mut written), Ok(frame.len()));
                        prop_assert_eq!(&written[..], frame);
                    }
                    Err(error) => prop_assert!(!error.to_string().is_empty()),
                }
            }
        }

        #[test]
        fn a_bundle_gives_all_of_its_pdus(all in prop::collection::vec(sound(), 0..6)) {
            let read: Result<Vec<_>, _> = Bundle::new(&all.concat()).map(|read| Ok(read?.0.to_vec())).collect();
            prop_assert_eq!(read, Ok::<_, Malformed>(all));
        }
    }

    fn state() -> Vec<u8> {
        let mut bytes = vec![0; ENTITY_STATE_BYTES];
        (bytes[0], bytes[2], bytes[9]) = (7, 1, 144);
        bytes
    }

    #[test]
    fn fields_are_where_the_standard_has_them() {
        let parameters = [[7; 16]];
        let pdu = Pdu {
            header: Header::new(9, Timestamp(0x0102_0305)),
            body: Body::EntityState(EntityState {
                id: EntityId {
                    site: 1,
                    application: 2,
                    entity: 3,
                },
                force: 1,
                entity_type: EntityType {
                    kind: 1,
                    domain: 2,
                    country: 225,
                    category: 4,
                    subcategory: 5,
                    specific: 6,
                    extra: 7,
                },
                alternative_type: EntityType {
                    extra: 8,
                    ..EntityType::default()
                },
                kinematics: Kinematics {
                    velocity: [1.0, 2.0, 3.0],
                    location: DVec3::new(4.0, 5.0, 6.0),
                    orientation: [0.5, 0.25, 0.125],
                    appearance: FROZEN,
                },
                dead_reckoning: DeadReckoning {
                    model: 4,
                    other: [9; 15],
                    acceleration: [7.0, 8.0, 9.0],
                    spin: [10.0, 11.0, 12.0],
                },
                marking: Marking::ascii("RHUMB-é"),
                capabilities: 0xdead_beef,
                parameters: &parameters,
            }),
        };
        let mut bytes = [0; 160];
        assert_eq!(pdu.encode(&mut bytes), Ok(160));
        assert_eq!(bytes[..12], [7, 9, 1, 1, 1, 2, 3, 5, 0, 160, 0, 0]);
        assert_eq!(bytes[12..20], [0, 1, 0, 2, 0, 3, 1, 1]);
        assert_eq!(bytes[20..28], [1, 2, 0, 225, 4, 5, 6, 7]);
        assert_eq!(bytes[35], 8);
        assert_eq!(bytes[36..40], 1.0_f32.to_be_bytes());
        assert_eq!(bytes[48..56], 4.0_f64.to_be_bytes());
        assert_eq!(bytes[72..76], 0.5_f32.to_be_bytes());
        assert_eq!(bytes[84..90], [0, 0x20, 0, 0, 4, 9]);
        assert_eq!(bytes[104..108], 7.0_f32.to_be_bytes());
        assert_eq!(bytes[116..120], 10.0_f32.to_be_bytes());
        assert_eq!(&bytes[128..140], b"\x01RHUMB-?\0\0\0\0");
        assert_eq!(bytes[140..144], [0xde, 0xad, 0xbe, 0xef]);
        assert_eq!(bytes[144..], [7; 16]);
        assert_eq!(Pdu::decode(&bytes), Ok(pdu));
    }

    #[test]
    fn a_wrong_length_names_its_value_its_limit_and_its_place() {
        let mut bytes = state();
        bytes[19] = 1;
        let error = Pdu::decode(&bytes).expect_err("a parameter is missing");
        let text = "length 144 at byte 8 is not the 160 bytes of this pdu of type 1";
        assert_eq!(error.to_string(), text);
        bytes[9] = 11;
        let error = Pdu::decode(&bytes).expect_err("no room for a header");
        assert_eq!(
            error.to_string(),
            "length 11 at byte 8 is less than the 12 bytes of a header"
        );
        bytes[9] = 150;
        let error = Pdu::decode(&bytes).expect_err("six bytes are missing");
        assert_eq!(
            error.to_string(),
            "pdu at byte 0 is cut: its length is 150, 144 bytes are left"
        );
        let more = [state(), vec![0; 4]].concat();
        let error = Pdu::decode(&more).expect_err("four bytes follow");
        assert_eq!(
            error.to_string(),
            "4 bytes follow the only pdu, from byte 144 on; a bundle is read as one"
        );
        let error = Pdu::decode(&bytes[..5]).expect_err("no header");
        assert_eq!(
            error.to_string(),
            "pdu at byte 0 is cut: 5 bytes are left, its header has 12"
        );
    }

    #[test]
    fn a_bad_pdu_costs_a_bundle_only_itself() {
        let mut bad = state();
        bad[19] = 3;
        let bundle = [state(), bad, state(), vec![7, 0, 1]].concat();
        let read: Vec<_> = Bundle::new(&bundle)
            .map(|read| read.map(|(_, pdu)| pdu.body.pdu_type()))
            .collect();
        assert_eq!(read[0], Ok(PduType::ENTITY_STATE));
        assert!(matches!(
            read[1],
            Err(Malformed::WrongLength {
                offset: 144,
                expected: 192,
                ..
            })
        ));
        assert_eq!(read[2], Ok(PduType::ENTITY_STATE));
        assert_eq!(
            read[3],
            Err(Malformed::CutHeader {
                offset: 432,
                available: 3
            })
        );
        assert_eq!(read.len(), 4);
    }

    #[test]
    fn zeros_that_fill_up_to_eight_bytes_are_no_pdu() {
        let mut remove = vec![0; REMOVE_BYTES];
        (remove[0], remove[2], remove[9]) = (7, 12, 28);
        let filled = [remove.clone(), vec![0; 4], state()].concat();
        assert_eq!(Bundle::new(&filled).filter(Result::is_ok).count(), 2);
        assert_eq!(
            Bundle::new(&[remove.clone(), vec![0; 4]].concat()).count(),
            1
        );
        assert!(Bundle::new(&[state(), vec![0; 4]].concat()).any(|read| read.is_err()));
        assert!(Bundle::new(&[remove, vec![0, 0, 0, 1]].concat()).any(|read| read.is_err()));
    }

    #[test]
    fn versions_and_types_that_are_not_understood_pass_as_they_are() {
        let mut bytes = state();
        bytes[0] = 8;
        bytes[19] = 200;
        let pdu = Pdu::decode(&bytes).expect("its length is right");
        assert!(matches!(
            pdu.body,
            Body::Other {
                pdu_type: PduType::ENTITY_STATE,
                ..
            }
        ));
    }

    #[test]
    fn a_moment_is_within_half_a_unit_of_its_timestamp() {
        for nanos in [
            0,
            1,
            837,
            838,
            1_800_000_000_000,
            3_599_999_998_000,
            5_000_000_000_123,
        ] {
            let moment = Duration::from_nanos(nanos);
            let back = Timestamp::at(moment, TimeBase::Absolute).past_hour();
            let error = back.as_nanos().abs_diff(moment.as_nanos() % HOUR_NS);
            assert!(error <= 839, "{nanos} ns is read as {back:?}");
        }
    }

    #[test]
    fn the_last_unit_of_an_hour_rounds_to_the_next_hour() {
        let end = Duration::from_nanos(3_599_999_999_999);
        assert_eq!(Timestamp::at(end, TimeBase::Relative), Timestamp(0));
        assert_eq!(Timestamp::at(end, TimeBase::Absolute), Timestamp(1));
    }

    #[test]
    fn differences_go_the_short_way_over_the_full_hour() {
        let at = |seconds| Timestamp::at(Duration::from_secs(seconds), TimeBase::Absolute);
        assert!((at(3601).seconds_since(at(3599)) - 2.0).abs() < 1e-5);
        assert!((at(3599).seconds_since(at(3601)) + 2.0).abs() < 1e-5);
        let relative = Timestamp::at(Duration::from_secs(2), TimeBase::Relative);
        assert!((at(3).seconds_since(relative) - 1.0).abs() < 1e-5);
    }
}
