//! An entity as PDUs describe it: its name, type, state and prediction.
//!
//! Plain fields as they are on the wire, read and written one after the other, big-endian; `pdu` checks the number of bytes,
//! and the room. Types also have their usual text, with dots.

use core::fmt;
use core::str::FromStr;

use glam::DVec3;

/// Bytes of a variable parameter: an articulated or attached part, or one that the standard added later.
pub const PARAMETER_BYTES: usize = 16;

/// Name of an entity within an exercise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct EntityId {
    /// Of the place that simulates it.
    pub site: u16,
    /// Of the program there.
    pub application: u16,
    /// Of the entity there; 1 to 65,533 for single entities.
    pub entity: u16,
}

/// The type of an entity, by the enumerations of SISO-REF-010.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct EntityType {
    /// 1 platform, 2 munition, 3 life form, 5 cultural feature.
    pub kind: u8,
    /// 1 land, 2 air, 3 surface, 4 subsurface, 5 space.
    pub domain: u8,
    /// Of its maker.
    pub country: u16,
    /// Within kind and domain.
    pub category: u8,
    /// Within the category.
    pub subcategory: u8,
    /// Within the subcategory.
    pub specific: u8,
    /// Anything further.
    pub extra: u8,
}

impl EntityType {
    /// Its seven numbers, in the order of its text.
    #[must_use]
    pub fn numbers(self) -> [u16; 7] {
        [
            u16::from(self.kind),
            u16::from(self.domain),
            self.country,
            u16::from(self.category),
            u16::from(self.subcategory),
            u16::from(self.specific),
            u16::from(self.extra),
        ]
    }
}

impl fmt::Display for EntityType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [kind, domain, country, rest @ ..] = self.numbers();
        write!(f, "{kind}.{domain}.{country}")?;
        rest.iter().try_for_each(|number| write!(f, ".{number}"))
    }
}

/// The reason why a text is no type of entity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidEntityType {
    /// More parts than seven.
    TooManyParts,
    /// A part that is no number of its field.
    Part {
        /// Its place, from one on.
        place: usize,
        /// Largest number there.
        limit: u16,
    },
}

impl fmt::Display for InvalidEntityType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooManyParts => f.write_str(
                "an entity type has seven numbers: kind.domain.country.category.subcategory.specific.extra",
            ),
            Self::Part { place, limit } => {
                write!(f, "part {place} of an entity type is a number from 0 to {limit}")
            }
        }
    }
}

impl core::error::Error for InvalidEntityType {}

impl FromStr for EntityType {
    type Err = InvalidEntityType;

    /// `kind.domain.country.category.subcategory.specific.extra`; numbers left out at the end are zero.
    fn from_str(text: &str) -> Result<Self, InvalidEntityType> {
        let mut numbers = [0; 7];
        for (index, part) in text.split('.').enumerate() {
            let limit = if index == 2 { u16::MAX } else { 255 };
            let number = numbers
                .get_mut(index)
                .ok_or(InvalidEntityType::TooManyParts)?;
            let read = part.parse().ok().filter(|number| *number <= limit);
            *number = read.ok_or(InvalidEntityType::Part {
                place: index + 1,
                limit,
            })?;
        }
        let [
            kind,
            domain,
            country,
            category,
            subcategory,
            specific,
            extra,
        ] = numbers;
        let byte = |number: u16| number as u8;
        Ok(Self {
            kind: byte(kind),
            domain: byte(domain),
            country,
            category: byte(category),
            subcategory: byte(subcategory),
            specific: byte(specific),
            extra: byte(extra),
        })
    }
}

/// The name that a tool shows beside an entity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Marking {
    /// 1: ASCII.
    pub character_set: u8,
    /// Padded with zeros.
    pub text: [u8; 11],
}

impl Marking {
    /// The first eleven characters of ASCII text; others become `?`.
    #[must_use]
    pub fn ascii(text: &str) -> Self {
        let mut marking = Self {
            character_set: 1,
            text: [0; 11],
        };
        for (to, from) in marking.text.iter_mut().zip(text.chars()) {
            *to = if from.is_ascii_graphic() || from == ' ' {
                from as u8
            } else {
                b'?'
            };
        }
        marking
    }
}

/// The parameters by which receivers predict an entity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DeadReckoning {
    /// Its number; [`crate::dead_reckoning::Model::of`] knows 1 to 9.
    pub model: u8,
    /// Fifteen bytes whose use depends on the model; zero from most senders.
    pub other: [u8; 15],
    /// Metres per second squared; geocentric axes in models 1 to 5, the entity's in 6 to 9.
    pub acceleration: [f32; 3],
    /// Radians per second about the entity's axes.
    pub spin: [f32; 3],
}

/// Pose and velocity of an entity, as both state PDUs have them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Kinematics {
    /// Metres per second; geocentric axes in models 1 to 5, the entity's in 6 to 9.
    pub velocity: [f32; 3],
    /// Geocentric, metres.
    pub location: DVec3,
    /// Psi, theta, phi, radians.
    pub orientation: [f32; 3],
    /// Bits whose meaning depends on the type of the entity.
    pub appearance: u32,
}

/// Bit of the appearance: the entity stands still, and is not predicted.
pub const FROZEN: u32 = 1 << 21;
/// Bit of the appearance: the entity has left the exercise.
pub const DEACTIVATED: u32 = 1 << 23;

/// The whole state of an entity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EntityState<'a> {
    /// Its name.
    pub id: EntityId,
    /// 0 other, 1 friendly, 2 opposing, 3 neutral.
    pub force: u8,
    /// Its type.
    pub entity_type: EntityType,
    /// The type that the other side takes it for.
    pub alternative_type: EntityType,
    /// Its pose and velocity.
    pub kinematics: Kinematics,
    /// The parameters by which receivers predict it.
    pub dead_reckoning: DeadReckoning,
    /// Its name for people.
    pub marking: Marking,
    /// Its services for others, such as repair and supply, as bits.
    pub capabilities: u32,
    /// Articulated parts and the like, as bytes.
    pub parameters: &'a [[u8; PARAMETER_BYTES]],
}

/// A change of an entity whose state is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EntityStateUpdate<'a> {
    /// Its name.
    pub id: EntityId,
    /// Zero from most senders.
    pub padding: u8,
    /// Its pose and velocity.
    pub kinematics: Kinematics,
    /// Articulated parts and the like, as bytes.
    pub parameters: &'a [[u8; PARAMETER_BYTES]],
}

/// A request that an entity leaves the exercise.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RemoveEntity {
    /// The entity or application that asks.
    pub originating: EntityId,
    /// The entity that leaves.
    pub receiving: EntityId,
    /// Number for the acknowledgement.
    pub request: u32,
}

/// Reads fields one after the other from bytes whose number has been checked.
pub(crate) struct Fields<'a> {
    rest: &'a [u8],
}

impl<'a> Fields<'a> {
    /// All fields of these bytes.
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    /// The bytes that have not been read.
    pub(crate) const fn rest(&self) -> &'a [u8] {
        self.rest
    }

    pub(crate) fn bytes<const N: usize>(&mut self) -> [u8; N] {
        let (first, rest) = self
            .rest
            .split_first_chunk()
            .expect("the length was checked");
        self.rest = rest;
        *first
    }

    fn u8(&mut self) -> u8 {
        let [byte] = self.bytes();
        byte
    }

    fn u16(&mut self) -> u16 {
        u16::from_be_bytes(self.bytes())
    }

    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_be_bytes(self.bytes())
    }

    fn floats(&mut self) -> [f32; 3] {
        [(); 3].map(|()| f32::from_be_bytes(self.bytes()))
    }

    fn location(&mut self) -> DVec3 {
        DVec3::from([(); 3].map(|()| f64::from_be_bytes(self.bytes())))
    }

    pub(crate) fn entity_id(&mut self) -> EntityId {
        EntityId {
            site: self.u16(),
            application: self.u16(),
            entity: self.u16(),
        }
    }

    fn entity_type(&mut self) -> EntityType {
        EntityType {
            kind: self.u8(),
            domain: self.u8(),
            country: self.u16(),
            category: self.u8(),
            subcategory: self.u8(),
            specific: self.u8(),
            extra: self.u8(),
        }
    }

    fn kinematics(&mut self) -> Kinematics {
        Kinematics {
            velocity: self.floats(),
            location: self.location(),
            orientation: self.floats(),
            appearance: self.u32(),
        }
    }

    fn parameters(&self) -> &'a [[u8; PARAMETER_BYTES]] {
        self.rest.as_chunks().0
    }

    pub(crate) fn entity_state(&mut self) -> EntityState<'a> {
        let id = self.entity_id();
        let [force, _] = self.bytes();
        EntityState {
            id,
            force,
            entity_type: self.entity_type(),
            alternative_type: self.entity_type(),
            kinematics: self.kinematics(),
            dead_reckoning: DeadReckoning {
                model: self.u8(),
                other: self.bytes(),
                acceleration: self.floats(),
                spin: self.floats(),
            },
            marking: Marking {
                character_set: self.u8(),
                text: self.bytes(),
            },
            capabilities: self.u32(),
            parameters: self.parameters(),
        }
    }

    pub(crate) fn update(&mut self) -> EntityStateUpdate<'a> {
        let id = self.entity_id();
        let [padding, _] = self.bytes();
        let kinematics = self.kinematics();
        EntityStateUpdate {
            id,
            padding,
            kinematics,
            parameters: self.parameters(),
        }
    }
}

/// Writes fields one after the other into room whose size has been checked.
pub(crate) struct Writer<'a> {
    to: &'a mut [u8],
    at: usize,
}

impl<'a> Writer<'a> {
    /// Writes from the start of this room.
    pub(crate) const fn new(to: &'a mut [u8]) -> Self {
        Self { to, at: 0 }
    }

    /// Bytes so far.
    pub(crate) const fn written(&self) -> usize {
        self.at
    }

    pub(crate) fn put(&mut self, bytes: &[u8]) {
        self.to[self.at..self.at + bytes.len()].copy_from_slice(bytes);
        self.at += bytes.len();
    }

    fn floats(&mut self, floats: [f32; 3]) {
        floats
            .iter()
            .for_each(|float| self.put(&float.to_be_bytes()));
    }

    pub(crate) fn entity_id(&mut self, id: EntityId) {
        for number in [id.site, id.application, id.entity] {
            self.put(&number.to_be_bytes());
        }
    }

    fn entity_type(&mut self, is: EntityType) {
        self.put(&[is.kind, is.domain]);
        self.put(&is.country.to_be_bytes());
        self.put(&[is.category, is.subcategory, is.specific, is.extra]);
    }

    fn kinematics(&mut self, kinematics: &Kinematics) {
        self.floats(kinematics.velocity);
        for coordinate in kinematics.location.to_array() {
            self.put(&coordinate.to_be_bytes());
        }
        self.floats(kinematics.orientation);
        self.put(&kinematics.appearance.to_be_bytes());
    }

    pub(crate) fn entity_state(&mut self, state: &EntityState<'_>) {
        self.entity_id(state.id);
        self.put(&[state.force, state.parameters.len() as u8]);
        self.entity_type(state.entity_type);
        self.entity_type(state.alternative_type);
        self.kinematics(&state.kinematics);
        let DeadReckoning {
            model,
            other,
            acceleration,
            spin,
        } = state.dead_reckoning;
        self.put(&[model]);
        self.put(&other);
        self.floats(acceleration);
        self.floats(spin);
        self.put(&[state.marking.character_set]);
        self.put(&state.marking.text);
        self.put(&state.capabilities.to_be_bytes());
        self.put(state.parameters.as_flattened());
    }

    pub(crate) fn update(&mut self, update: &EntityStateUpdate<'_>) {
        self.entity_id(update.id);
        self.put(&[update.padding, update.parameters.len() as u8]);
        self.kinematics(&update.kinematics);
        self.put(update.parameters.as_flattened());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entity_type_is_its_text_and_wrong_parts_are_named() {
        let tank: EntityType = "1.1.225.1.1.3.255".parse().expect("seven numbers");
        assert_eq!(tank.to_string(), "1.1.225.1.1.3.255");
        let short: EntityType = "1.2".parse().expect("the rest is zero");
        assert_eq!(short.to_string(), "1.2.0.0.0.0.0");
        for (text, error) in [
            (
                "1.1.225.1.1.3.0.0",
                "an entity type has seven numbers: kind.domain.country.category.subcategory.specific.extra",
            ),
            (
                "1.256",
                "part 2 of an entity type is a number from 0 to 255",
            ),
            (
                "1.2.65536",
                "part 3 of an entity type is a number from 0 to 65535",
            ),
            ("tank", "part 1 of an entity type is a number from 0 to 255"),
            ("", "part 1 of an entity type is a number from 0 to 255"),
        ] {
            let found = text.parse::<EntityType>().expect_err(text);
            assert_eq!(found.to_string(), error);
        }
    }
}
