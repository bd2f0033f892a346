//! Ids in a scene: what a member is granted, and what no scene can have.
//!
//! A client checks the ids of a call before it sends them: a decoder refuses an id that no scene can have, and a
//! server then closes the connection. No server answers with [`IdOutOfRange`].

use core::fmt;

use rhumb_reckoning::BodyId;

use super::joint::JointId;
use super::shape::ShapeId;
use crate::limits::{INDICES_MAX, JOINTS_MAX, SHAPES_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A range of body indices granted to one member.
///
/// The member assigns the ids of its bodies, so that it can command them without waiting for an answer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IdRange {
    first: u32,
    count: u32,
    generation: u16,
}

impl IdRange {
    /// A range without indices.
    pub const EMPTY: Self = Self {
        first: 0,
        count: 0,
        generation: 0,
    };

    /// `count` indices from `first` on, none of which had a body of this generation or a later one.
    ///
    /// `None` beyond the limit of indices.
    #[must_use]
    pub fn new(first: u32, count: u32, generation: u16) -> Option<Self> {
        let end = first.checked_add(count)?;
        (end <= INDICES_MAX).then_some(Self {
            first,
            count,
            generation,
        })
    }

    /// True if a body's index is in the range.
    #[must_use]
    pub fn contains(&self, id: BodyId) -> bool {
        id.index() >= self.first && id.index() - self.first < self.count
    }

    /// The first id of the `place`-th of these indices.
    #[must_use]
    pub fn id(&self, place: u32) -> Option<BodyId> {
        (place < self.count).then(|| BodyId::new(self.first + place, self.generation))
    }

    /// The first index.
    #[must_use]
    pub const fn first(&self) -> u32 {
        self.first
    }

    /// The number of indices.
    #[must_use]
    pub const fn count(&self) -> u32 {
        self.count
    }

    /// The least generation of the ids.
    #[must_use]
    pub const fn generation(&self) -> u16 {
        self.generation
    }
}

impl Wire for IdRange {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.first));
        to.varint(u64::from(self.count));
        to.varint(u64::from(self.generation));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let (first, count) = (from.varint32()?, from.varint32()?);
        let generation = from.varint_to(u64::from(u16::MAX))? as u16;
        Self::new(first, count, generation).ok_or(Malformed::OutOfRange)
    }
}

impl Wire for BodyId {
    fn encode(&self, to: &mut Writer) {
        to.varint(u64::from(self.index()));
        to.varint(u64::from(self.generation()));
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let index = from.varint_to(u64::from(INDICES_MAX) - 1)?;
        let generation = from.varint_to(u64::from(u16::MAX))?;
        Ok(Self::new(index as u32, generation as u16))
    }
}

/// An id that no scene can have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IdOutOfRange {
    /// The index of the body is not below [`INDICES_MAX`].
    Body(BodyId),
    /// The number of the shape is not below [`SHAPES_MAX`].
    Shape(ShapeId),
    /// The number of the joint is not below [`JOINTS_MAX`].
    Joint(JointId),
}

impl IdOutOfRange {
    /// Checks the id of a body.
    ///
    /// # Errors
    ///
    /// [`Self::Body`] for an index that no scene can have.
    pub const fn check_body(id: BodyId) -> Result<(), Self> {
        match id.index() < INDICES_MAX {
            true => Ok(()),
            false => Err(Self::Body(id)),
        }
    }

    /// Checks the id of a shape.
    ///
    /// # Errors
    ///
    /// [`Self::Shape`] for a number that no scene can have.
    pub const fn check_shape(id: ShapeId) -> Result<(), Self> {
        match id.0 < SHAPES_MAX {
            true => Ok(()),
            false => Err(Self::Shape(id)),
        }
    }

    /// Checks the id of a joint.
    ///
    /// # Errors
    ///
    /// [`Self::Joint`] for a number that no scene can have.
    pub const fn check_joint(id: JointId) -> Result<(), Self> {
        match id.0 < JOINTS_MAX {
            true => Ok(()),
            false => Err(Self::Joint(id)),
        }
    }
}

impl fmt::Display for IdOutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Body(id) => {
                write!(
                    f,
                    "no scene has {id}: the index of a body is below {INDICES_MAX}"
                )
            }
            Self::Shape(id) => {
                write!(
                    f,
                    "no scene has {id}: the number of a shape is below {SHAPES_MAX}"
                )
            }
            Self::Joint(id) => {
                write!(
                    f,
                    "no scene has {id}: the number of a joint is below {JOINTS_MAX}"
                )
            }
        }
    }
}

impl core::error::Error for IdOutOfRange {}

#[cfg(test)]
mod tests {
    use alloc::boxed::Box;
    use alloc::string::ToString;
    use alloc::vec::Vec;

    use glam::Vec3;
    use rhumb_reckoning::BodyState;

    use super::*;
    use crate::scene::{
        ActiveEvents, BodyDesc, BodyKind, Command, Joint, JointFrame, JointKind, Query,
        QueryFilter, Shape,
    };
    use crate::wire::Wire;
    use crate::wire::bytes::{Reader, Writer};

    const BODY: BodyId = BodyId::new(INDICES_MAX - 1, 7);
    const SHAPE: ShapeId = ShapeId(SHAPES_MAX - 1);
    const JOINT: JointId = JointId(JOINTS_MAX - 1);

    /// Commands that name a body, a shape or a joint, by these ids.
    fn commands(body: BodyId, shape: ShapeId, joint: JointId) -> Vec<Command> {
        let desc = BodyDesc::plain(body, BodyKind::Dynamic, shape);
        let motion = BodyState::new([0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
        let fixed = |bodies| {
            let frames = [JointFrame::at(Vec3::ZERO); 2];
            Box::new(Joint::plain(JointKind::Fixed, bodies, frames))
        };
        Vec::from([
            Command::AddShape {
                id: shape,
                shape: Shape::ball(1.0),
            },
            Command::RemoveShape { id: shape },
            Command::AddBody {
                desc,
                motion: motion.expect("these numbers are finite"),
            },
            Command::ChangeBody { desc },
            Command::RemoveBody { id: body },
            Command::Force {
                id: body,
                force: Vec3::Y,
            },
            Command::Sleep { id: body },
            Command::SetEvents {
                id: body,
                events: ActiveEvents::NONE,
            },
            Command::AddJoint {
                id: joint,
                joint: fixed([body, BODY]),
            },
            Command::ChangeJoint {
                id: joint,
                joint: fixed([BODY, body]),
            },
            Command::RemoveJoint { id: joint },
            Command::SetGravity { gravity: Vec3::Y },
        ])
    }

    fn is_read<T: Wire>(value: &T) -> bool {
        let mut to = Writer::new();
        value.encode(&mut to);
        T::decode(&mut Reader::new(&to.into_bytes())).is_ok()
    }

    #[test]
    fn a_command_passes_exactly_if_a_decoder_reads_it() {
        for command in commands(BODY, SHAPE, JOINT) {
            assert_eq!(command.check_ids(), Ok(()), "{command:?}");
            assert!(is_read(&command), "{command:?}");
        }
        let wrong = [
            (BodyId::new(INDICES_MAX, 7), SHAPE, JOINT),
            (BodyId::new(u32::MAX, 0), SHAPE, JOINT),
            (BODY, ShapeId(SHAPES_MAX), JOINT),
            (BODY, SHAPE, JointId(JOINTS_MAX)),
            (BODY, SHAPE, JointId(u32::MAX)),
        ];
        for (body, shape, joint) in wrong {
            let commands = commands(body, shape, joint);
            let passes = |command: &Command| command.check_ids().is_ok();
            assert!(!commands.iter().all(passes), "{body}, {shape}, {joint}");
            for command in commands {
                assert_eq!(passes(&command), is_read(&command), "{command:?}");
            }
        }
    }

    #[test]
    fn a_query_passes_exactly_if_a_decoder_reads_it() {
        let beyond = BodyId::new(INDICES_MAX, 0);
        for (except, expected) in [
            (None, Ok(())),
            (Some(BODY), Ok(())),
            (Some(beyond), Err(IdOutOfRange::Body(beyond))),
        ] {
            let filter = QueryFilter {
                except,
                ..QueryFilter::DEFAULT
            };
            let query = Query::ray(Vec3::ZERO, Vec3::Y).among(filter);
            assert_eq!(query.check_ids(), expected);
            assert_eq!(is_read(&query), expected.is_ok());
        }
    }

    #[test]
    fn the_sentence_has_the_limit() {
        let error = IdOutOfRange::Joint(JointId(JOINTS_MAX)).to_string();
        let expected = "no scene has joint 65536: the number of a joint is below 65536";
        assert_eq!(error, expected);
    }
}
