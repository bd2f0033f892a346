//! Questions about where the bodies of a scene are, and their answers.
//!
//! An engine evaluates them; nothing here does. Each question states how many bodies it finds at most. Positions
//! and directions are in the world frame.

use alloc::vec::Vec;

use glam::{Quat, Vec3};
use rhumb_reckoning::BodyId;

use super::body::{BodyDesc, BodyKind};
use super::checks::{Invalid, Quantity, rotation, scalar, vector};
use super::ids::IdOutOfRange;
use super::shape::Shape;
use crate::limits::{COORDINATE_MAX, HITS_MAX, QUERY_COST_MAX, SHAPE_CAST_COST};
use crate::wire::bytes::{Reader, Writer};
use crate::wire::{Malformed, Wire};

/// One question: its geometry, which bodies it considers, and how many it finds.
#[derive(Clone, Debug, PartialEq)]
pub struct Query {
    /// Its geometry.
    pub kind: QueryKind,
    /// The bodies that it considers.
    pub filter: QueryFilter,
    /// Most bodies in its answer, from 1 to [`HITS_MAX`].
    pub hits: u8,
}

/// Geometry of a question.
#[derive(Clone, Debug, PartialEq)]
pub enum QueryKind {
    /// Finds the nearest bodies along a line.
    Ray {
        /// Metres: the beginning of the line.
        origin: Vec3,
        /// Metres: from the beginning to the end of the line, not zero.
        translation: Vec3,
    },
    /// Finds the nearest bodies that a shape touches on its way; the shape does not turn.
    ShapeCast {
        /// A convex shape of few numbers: see [`Query::allows`].
        shape: Shape,
        /// Metres: where it begins.
        position: Vec3,
        /// Its orientation.
        rotation: Quat,
        /// Metres: from the beginning to the end of the way.
        translation: Vec3,
    },
    /// Finds the bodies whose surfaces are nearest to a point; a body that contains the point comes first.
    Projection {
        /// Metres.
        point: Vec3,
        /// Metres: bodies farther away are not found.
        distance: f32,
    },
    /// Finds bodies that a shape overlaps, in the order of ids.
    Overlap {
        /// As for a shape cast.
        shape: Shape,
        /// Metres.
        position: Vec3,
        /// Its orientation.
        rotation: Quat,
    },
    /// Finds the bodies that touch a body after the last step, the deepest contact first.
    Contacts {
        /// The body; one that the scene does not have touches nothing.
        body: BodyId,
    },
}

/// The advice of the error about a ray that leads nowhere.
const RAY_WITHOUT_LENGTH: &str = "the translation of a ray is zero, and must lead from its origin to its end: a projection finds what is at a point";

/// Selection of the bodies that a question considers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct QueryFilter {
    /// True if fixed bodies count.
    pub with_fixed: bool,
    /// True if dynamic bodies count.
    pub with_dynamic: bool,
    /// True if kinematic bodies count.
    pub with_kinematic: bool,
    /// True if sensors count.
    pub with_sensors: bool,
    /// A body that does not count, such as the one that asks.
    pub except: Option<BodyId>,
    /// Only bodies that are in one of these collision groups count.
    pub groups: u32,
}

impl QueryFilter {
    /// All bodies except sensors.
    pub const DEFAULT: Self = Self {
        with_fixed: true,
        with_dynamic: true,
        with_kinematic: true,
        with_sensors: false,
        except: None,
        groups: u32::MAX,
    };

    /// All bodies.
    pub const ALL: Self = Self {
        with_sensors: true,
        ..Self::DEFAULT
    };

    /// True if a body counts.
    #[must_use]
    pub fn takes(&self, candidate: &QueryCandidate) -> bool {
        let of_kind = match candidate.kind {
            BodyKind::Fixed => self.with_fixed,
            BodyKind::Dynamic => self.with_dynamic,
            BodyKind::Kinematic => self.with_kinematic,
        };
        of_kind
            && (self.with_sensors || !candidate.is_sensor)
            && self.except != Some(candidate.id)
            && self.groups & candidate.members != 0
    }
}

/// The properties of a body that decide whether a filter takes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueryCandidate {
    /// The body.
    pub id: BodyId,
    /// Kind of its motion.
    pub kind: BodyKind,
    /// True if bodies pass through it.
    pub is_sensor: bool,
    /// The collision groups that it is in, a bit for each.
    pub members: u32,
}

impl QueryCandidate {
    /// The properties of a described body.
    #[must_use]
    pub const fn of(desc: &BodyDesc) -> Self {
        Self {
            id: desc.id,
            kind: desc.kind,
            is_sensor: desc.sensor,
            members: desc.groups.members,
        }
    }
}

impl Query {
    /// The most bodies that a query finds.
    pub const HITS_MAX: u8 = HITS_MAX;

    /// The nearest body along a line.
    #[must_use]
    pub const fn ray(origin: Vec3, translation: Vec3) -> Self {
        Self::new(QueryKind::Ray {
            origin,
            translation,
        })
    }

    /// The nearest body that a shape touches on its way.
    #[must_use]
    pub const fn shape_cast(
        shape: Shape,
        position: Vec3,
        rotation: Quat,
        translation: Vec3,
    ) -> Self {
        Self::new(QueryKind::ShapeCast {
            shape,
            position,
            rotation,
            translation,
        })
    }

    /// The body whose surface is nearest to a point, within a distance in metres.
    #[must_use]
    pub const fn projection(point: Vec3, distance: f32) -> Self {
        Self::new(QueryKind::Projection { point, distance })
    }

    /// The bodies that a shape overlaps, at most [`HITS_MAX`].
    #[must_use]
    pub const fn overlap(shape: Shape, position: Vec3, rotation: Quat) -> Self {
        let mut query = Self::new(QueryKind::Overlap {
            shape,
            position,
            rotation,
        });
        query.hits = HITS_MAX;
        query
    }

    /// The bodies that touch a body, at most [`HITS_MAX`].
    #[must_use]
    pub const fn contacts(body: BodyId) -> Self {
        let mut query = Self::new(QueryKind::Contacts { body });
        query.hits = HITS_MAX;
        query
    }

    const fn new(kind: QueryKind) -> Self {
        Self {
            kind,
            filter: QueryFilter::DEFAULT,
            hits: 1,
        }
    }

    /// The same question about other bodies.
    #[must_use]
    pub const fn among(mut self, filter: QueryFilter) -> Self {
        self.filter = filter;
        self
    }

    /// The same question for this many bodies at most.
    #[must_use]
    pub const fn finding(mut self, hits: u8) -> Self {
        self.hits = hits;
        self
    }

    /// True if a shape may be cast or overlapped: its cost is known from its kind.
    #[must_use]
    pub const fn allows(shape: &Shape) -> bool {
        !matches!(
            shape,
            Shape::Hull(_)
                | Shape::Heights(_)
                | Shape::Mesh(_)
                | Shape::Compound(_)
                | Shape::HalfSpace { .. }
        )
    }

    /// Cost of its answer, in nearest bodies of a ray.
    #[must_use]
    pub const fn cost(&self) -> u32 {
        let each = match self.kind {
            QueryKind::ShapeCast { .. } => SHAPE_CAST_COST,
            QueryKind::Ray { .. }
            | QueryKind::Projection { .. }
            | QueryKind::Overlap { .. }
            | QueryKind::Contacts { .. } => 1,
        };
        self.hits as u32 * each
    }

    /// Cost of the queries of one message; `None` if they break a limit: there is at least one, and each finds at
    /// least one body.
    #[must_use]
    pub fn total_cost(queries: &[Self]) -> Option<u32> {
        let mut cost = 0_u32;
        for query in queries {
            if !query.has_valid_hits() {
                return None;
            }
            cost = cost.saturating_add(query.cost());
        }
        (1..=QUERY_COST_MAX).contains(&cost).then_some(cost)
    }

    /// True if it finds at least one body, and no more than a query may.
    pub(crate) const fn has_valid_hits(&self) -> bool {
        self.hits > 0 && self.hits <= HITS_MAX
    }

    /// Checks every number, as both ends do.
    ///
    /// # Errors
    ///
    /// [`Invalid`] names the first invalid number.
    pub fn check(&self) -> Result<(), Invalid> {
        let place = |place| vector(place, COORDINATE_MAX, Quantity::Position);
        match self.kind {
            QueryKind::Ray {
                origin,
                translation,
            } => {
                place(origin)?;
                place(translation)?;
                match translation == Vec3::ZERO {
                    true => Err(Invalid::because(Quantity::Position, RAY_WITHOUT_LENGTH)),
                    false => Ok(()),
                }
            }
            QueryKind::ShapeCast {
                ref shape,
                position,
                rotation: turned,
                translation,
            } => {
                shape.check()?;
                place(position)?;
                rotation(turned)?;
                place(translation)
            }
            QueryKind::Projection { point, distance } => {
                place(point)?;
                scalar(distance, 0.0, COORDINATE_MAX, Quantity::Position)
                    .map_err(|wrong| wrong.of("distance of a projection", "m"))
            }
            QueryKind::Overlap {
                ref shape,
                position,
                rotation: turned,
            } => {
                shape.check()?;
                place(position)?;
                rotation(turned)
            }
            QueryKind::Contacts { .. } => Ok(()),
        }
    }

    /// Checks every id, as a client does before it sends. A server that reads the query finds no other ids in it.
    ///
    /// # Errors
    ///
    /// [`IdOutOfRange`] for a body that no scene can have: the one whose contacts are asked for, or the one that does not
    /// count.
    pub fn check_ids(&self) -> Result<(), IdOutOfRange> {
        if let QueryKind::Contacts { body } = self.kind {
            IdOutOfRange::check_body(body)?;
        }
        self.filter.except.map_or(Ok(()), IdOutOfRange::check_body)
    }
}

/// A body on the way of a ray or a shape, or near a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// The body.
    pub body: BodyId,
    /// Metres: along the way, or from the point to the surface. It is 0 for a ray or a shape that begins inside the
    /// body, and negative for a point inside the body. Of a contact: from surface to surface, negative where they overlap.
    pub distance: f32,
    /// Metres: on the body's surface; where a ray begins inside the body, its beginning. Of a contact: on the surface of the
    /// body whose contacts were asked for.
    pub point: Vec3,
    /// Outward from the surface, of unit length; zero where there is none, as for a ray that begins inside.
    pub normal: Vec3,
}

/// The answer to one question.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    /// The nearest bodies, nearest first: of a ray, a shape cast, a projection or contacts.
    Hits(Vec<Hit>),
    /// The overlapped bodies in the order of ids. There may be more if there are as many as were asked for.
    Bodies(Vec<BodyId>),
}

/// First byte of a question.
mod code {
    pub(super) const RAY: u8 = 0;
    pub(super) const SHAPE_CAST: u8 = 1;
    pub(super) const PROJECTION: u8 = 2;
    pub(super) const OVERLAP: u8 = 3;
    pub(super) const CONTACTS: u8 = 4;
}

/// Bits of a filter's first byte.
mod flag {
    pub(super) const NOT_STATIC: u8 = 1;
    pub(super) const NOT_DYNAMIC: u8 = 1 << 1;
    pub(super) const NOT_KINEMATIC: u8 = 1 << 2;
    pub(super) const SENSORS: u8 = 1 << 3;
    pub(super) const EXCEPT: u8 = 1 << 4;
    pub(super) const GROUPS: u8 = 1 << 5;
}

fn vec3(from: &mut Reader<'_>) -> Result<Vec3, Malformed> {
    from.f32s().map(Vec3::from_array)
}

fn simple_shape(from: &mut Reader<'_>) -> Result<Shape, Malformed> {
    let shape = Shape::decode(from)?;
    if Query::allows(&shape) {
        Ok(shape)
    } else {
        Err(Malformed::UnknownCode)
    }
}

impl Wire for Query {
    fn encode(&self, to: &mut Writer) {
        match self.kind {
            QueryKind::Ray {
                origin,
                translation,
            } => {
                to.u8(code::RAY);
                to.f32s(&origin.to_array());
                to.f32s(&translation.to_array());
            }
            QueryKind::ShapeCast {
                ref shape,
                position,
                rotation,
                translation,
            } => {
                to.u8(code::SHAPE_CAST);
                shape.encode(to);
                to.f32s(&position.to_array());
                to.f32s(&rotation.to_array());
                to.f32s(&translation.to_array());
            }
            QueryKind::Projection { point, distance } => {
                to.u8(code::PROJECTION);
                to.f32s(&point.to_array());
                to.f32(distance);
            }
            QueryKind::Overlap {
                ref shape,
                position,
                rotation,
            } => {
                to.u8(code::OVERLAP);
                shape.encode(to);
                to.f32s(&position.to_array());
                to.f32s(&rotation.to_array());
            }
            QueryKind::Contacts { body } => {
                to.u8(code::CONTACTS);
                body.encode(to);
            }
        }
        self.filter.encode(to);
        to.u8(self.hits);
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let kind = match from.u8()? {
            code::RAY => QueryKind::Ray {
                origin: vec3(from)?,
                translation: vec3(from)?,
            },
            code::SHAPE_CAST => QueryKind::ShapeCast {
                shape: simple_shape(from)?,
                position: vec3(from)?,
                rotation: Quat::from_array(from.f32s()?),
                translation: vec3(from)?,
            },
            code::PROJECTION => QueryKind::Projection {
                point: vec3(from)?,
                distance: from.f32()?,
            },
            code::OVERLAP => QueryKind::Overlap {
                shape: simple_shape(from)?,
                position: vec3(from)?,
                rotation: Quat::from_array(from.f32s()?),
            },
            code::CONTACTS => QueryKind::Contacts {
                body: BodyId::decode(from)?,
            },
            _ => return Err(Malformed::UnknownCode),
        };
        let filter = QueryFilter::decode(from)?;
        let hits = from.u8()?;
        if hits == 0 || hits > HITS_MAX {
            return Err(Malformed::OutOfRange);
        }
        Ok(Self { kind, filter, hits })
    }
}

impl Wire for QueryFilter {
    fn encode(&self, to: &mut Writer) {
        let mut flags = 0;
        for (set, bit) in [
            (!self.with_fixed, flag::NOT_STATIC),
            (!self.with_dynamic, flag::NOT_DYNAMIC),
            (!self.with_kinematic, flag::NOT_KINEMATIC),
            (self.with_sensors, flag::SENSORS),
            (self.except.is_some(), flag::EXCEPT),
            (self.groups != u32::MAX, flag::GROUPS),
        ] {
            if set {
                flags |= bit;
            }
        }
        to.u8(flags);
        if let Some(id) = self.except {
            id.encode(to);
        }
        if self.groups != u32::MAX {
            to.raw(&self.groups.to_le_bytes());
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let flags = from.u8()?;
        if flags >= flag::GROUPS << 1 {
            return Err(Malformed::UnknownCode);
        }
        let has = |bit| flags & bit != 0;
        let mut filter = Self {
            with_fixed: !has(flag::NOT_STATIC),
            with_dynamic: !has(flag::NOT_DYNAMIC),
            with_kinematic: !has(flag::NOT_KINEMATIC),
            with_sensors: has(flag::SENSORS),
            ..Self::DEFAULT
        };
        if has(flag::EXCEPT) {
            filter.except = Some(BodyId::decode(from)?);
        }
        if has(flag::GROUPS) {
            let mut groups = [0; 4];
            groups.copy_from_slice(from.raw(4)?);
            filter.groups = u32::from_le_bytes(groups);
            if filter.groups == u32::MAX {
                return Err(Malformed::NotCanonical);
            }
        }
        Ok(filter)
    }
}

/// Appends the questions of one message.
pub(crate) fn encode_queries(queries: &[Query], to: &mut Writer) {
    to.varint(queries.len() as u64);
    for query in queries {
        query.encode(to);
    }
}

/// Reads the questions of one message: at least one, and together within the limit of their cost.
pub(crate) fn decode_queries(from: &mut Reader<'_>) -> Result<Vec<Query>, Malformed> {
    let count = from.varint_to(u64::from(QUERY_COST_MAX))?;
    let mut queries = Vec::new();
    for _ in 0..count {
        queries.push(Query::decode(from)?);
    }
    Query::total_cost(&queries).ok_or(Malformed::OutOfRange)?;
    Ok(queries)
}

impl Wire for Answer {
    fn encode(&self, to: &mut Writer) {
        match self {
            Self::Hits(hits) => {
                to.u8(0);
                to.varint(hits.len() as u64);
                for hit in hits {
                    hit.body.encode(to);
                    to.f32(hit.distance);
                    to.f32s(&hit.point.to_array());
                    to.f32s(&hit.normal.to_array());
                }
            }
            Self::Bodies(bodies) => {
                to.u8(1);
                to.varint(bodies.len() as u64);
                for body in bodies {
                    body.encode(to);
                }
            }
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let code = from.u8()?;
        if code > 1 {
            return Err(Malformed::UnknownCode);
        }
        let count = from.varint_to(u64::from(HITS_MAX))?;
        if code == 1 {
            let mut bodies: Vec<BodyId> = Vec::new();
            for _ in 0..count {
                let body = BodyId::decode(from)?;
                if bodies.last().is_some_and(|last| *last >= body) {
                    return Err(Malformed::NotCanonical);
                }
                bodies.push(body);
            }
            return Ok(Self::Bodies(bodies));
        }
        let mut hits = Vec::new();
        for _ in 0..count {
            let hit = Hit {
                body: BodyId::decode(from)?,
                distance: from.f32()?,
                point: vec3(from)?,
                normal: vec3(from)?,
            };
            if !hit.distance.is_finite() || !hit.point.is_finite() || !hit.normal.is_finite() {
                return Err(Malformed::NotFinite);
            }
            hits.push(hit);
        }
        Ok(Self::Hits(hits))
    }
}
