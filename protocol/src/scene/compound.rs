//! Compound shape: several shapes as one.
//!
//! A compound without parts touches nothing. Parts are not compounds. Cheap to copy: copies share their parts.

use alloc::sync::Arc;
use alloc::vec::Vec;

use glam::{Quat, Vec3};
use rhumb_reckoning::Metres;

use super::checks::{Invalid, Quantity, rotation, vector};
use super::shape::Shape;
use crate::limits::{EXTENT_MAX, EXTENT_MIN, PARTS_BYTES_MAX, PARTS_MAX};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// A part of a compound.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Metres, in the body's axes.
    pub position: Vec3,
    /// Part → body.
    pub rotation: Quat,
    /// Its shape; not a compound.
    pub shape: Shape,
}

/// Parts in the axes of a body, from its centre of mass.
#[derive(Clone, Debug, PartialEq)]
pub struct Compound {
    parts: Arc<[Part]>,
}

impl Compound {
    /// A compound of these parts.
    ///
    /// # Errors
    ///
    /// [`Invalid`] when they are too many, when one is a compound, or for the first invalid number.
    pub fn new(parts: Vec<Part>) -> Result<Self, Invalid> {
        let compound = Self {
            parts: parts.into(),
        };
        compound.check()?;
        Ok(compound)
    }

    /// A shape that touches nothing.
    #[must_use]
    pub fn nothing() -> Self {
        Self {
            parts: Arc::new([]),
        }
    }

    /// The parts.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Radius of a ball around the centre of mass that holds the bounding balls of all parts; at least a millimetre.
    #[must_use]
    pub fn bounding_radius(&self) -> Metres {
        let reach = |part: &Part| {
            let squared = part.position.as_dvec3().length_squared();
            libm::sqrt(squared) + part.shape.bounding_radius().metres()
        };
        let reaches = self.parts.iter().map(reach);
        Metres::new(reaches.fold(f64::from(EXTENT_MIN), f64::max))
    }

    /// Checks every number (PROTOCOL 2.6).
    pub(super) fn check(&self) -> Result<(), Invalid> {
        if self.parts.len() > PARTS_MAX {
            return Err(Invalid::OutOfRange(Quantity::Parts));
        }
        for part in self.parts.iter() {
            vector(part.position, EXTENT_MAX, Quantity::Extent)?;
            rotation(part.rotation)?;
            if matches!(part.shape, Shape::Compound(_)) {
                return Err(Invalid::OutOfRange(Quantity::Parts));
            }
            part.shape.check()?;
        }
        let bytes: usize = self.parts.iter().map(|part| part.shape.bytes()).sum();
        if bytes > PARTS_BYTES_MAX {
            return Err(Invalid::OutOfRange(Quantity::Parts));
        }
        Ok(())
    }
}

impl Wire for Compound {
    fn encode(&self, to: &mut Writer) {
        debug_assert!(self.parts.len() <= PARTS_MAX, "counted when made");
        to.u8(self.parts.len() as u8);
        for part in self.parts.iter() {
            to.f32s(&part.position.to_array());
            to.f32s(&part.rotation.to_array());
            part.shape.encode(to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let count = usize::from(from.u8()?);
        if count > PARTS_MAX {
            return Err(Malformed::OutOfRange);
        }
        let mut parts = Vec::with_capacity(count);
        for _ in 0..count {
            parts.push(Part {
                position: Vec3::from_array(from.f32s()?),
                rotation: Quat::from_array(from.f32s()?),
                shape: Shape::decode_part(from)?,
            });
        }
        Ok(Self {
            parts: parts.into(),
        })
    }
}

#[cfg(test)]
mod tests {
    use alloc::vec;

    use super::*;
    use crate::scene::Mesh;

    fn part(x: f32, shape: Shape) -> Part {
        Part {
            position: Vec3::new(x, 0.0, 0.0),
            rotation: Quat::IDENTITY,
            shape,
        }
    }

    #[test]
    fn a_compound_round_trips_and_truncations_are_refused() {
        let balls = [1.0, 2.0].map(|x| part(x, Shape::Ball { radius: 0.5 }));
        let compound = Compound::new(balls.to_vec()).expect("two balls");
        assert_eq!(compound.bounding_radius().metres(), 2.5);
        let shape = Shape::Compound(compound);
        let mut writer = Writer::new();
        shape.encode(&mut writer);
        let bytes = writer.into_bytes();
        assert_eq!(Shape::decode(&mut Reader::new(&bytes)), Ok(shape));
        for cut in 0..bytes.len() {
            let cut = Shape::decode(&mut Reader::new(&bytes[..cut]));
            assert_eq!(cut, Err(Malformed::Truncated));
        }
    }

    #[test]
    fn parts_of_parts_and_too_many_parts_are_refused() {
        let inner = Shape::Compound(Compound::nothing());
        let wrong = Err(Invalid::OutOfRange(Quantity::Parts));
        assert_eq!(Compound::new(vec![part(0.0, inner.clone())]), wrong);
        let ball = part(0.0, Shape::Ball { radius: 0.5 });
        assert_eq!(Compound::new(vec![ball; PARTS_MAX + 1]), wrong);
        let nested = Compound {
            parts: [part(0.0, inner)].into(),
        };
        let mut writer = Writer::new();
        nested.encode(&mut writer);
        let read = Compound::decode(&mut Reader::new(&writer.into_bytes()));
        assert_eq!(read, Err(Malformed::UnknownCode));
    }

    #[test]
    fn a_compound_at_its_limits_fits_a_long_message_and_one_beyond_is_refused() {
        let points = vec![Vec3::X; 60_000];
        let triangles = vec![[59_999_u32; 3]; 60_000];
        let mesh = Shape::Mesh(Mesh::new(&points, &triangles).expect("within the limits"));
        let one = Compound::new(vec![part(0.0, mesh.clone())]).expect("within the limits");
        let mut writer = Writer::new();
        one.encode(&mut writer);
        assert!(writer.len() < crate::limits::LONG_MESSAGE_BYTES_MAX);
        let two = Compound::new(vec![part(0.0, mesh.clone()), part(1.0, mesh)]);
        assert_eq!(two, Err(Invalid::OutOfRange(Quantity::Parts)));
    }

    #[test]
    fn an_empty_compound_has_a_ball_of_a_millimetre() {
        let radius = Compound::nothing().bounding_radius().metres();
        assert_eq!(radius, f64::from(EXTENT_MIN));
    }
}
