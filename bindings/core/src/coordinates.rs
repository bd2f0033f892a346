//! Conversion between the coordinates of other engines and those of Rhumb.
//!
//! Rhumb's own are right-handed, y up, in metres. Each conversion is a signed permutation of axes and a scale, so it
//! rounds only by the scale. Up is Rhumb's y in all of them: a capsule stands upright in each. A zero stays without a
//! sign, so that an application whose numbers are mirrored gets the same scene to the bit.
//!
//! Angles are radians and masses are kilograms everywhere. Densities are kg/m³ everywhere.
//!
//! A joint's frames turn with the axes of their bodies. The first axis of a frame stays the first one in all coordinates, so
//! a hinge stays a hinge; limits and motors go to the axis that the application's becomes, with its direction.

use glam::{Quat, Vec3};
use rhumb_client::scene::{
    Cell, CellGrid, Character, Compound, Contact, Heights, Hit, Hull, Invalid, Joint, JointFrame,
    JointKind, JointLimits, JointStrength, LockedAxes, Mesh, Motor, Part, Query, QueryKind, Shape,
    Sleep, SleepThresholds, Spring, Wheel,
};

/// Axes and unit of length that an application uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Coordinates {
    /// Right-handed, y up, metres: Rhumb's own, Godot's and Bevy's.
    #[default]
    Rhumb,
    /// Left-handed, y up, z forward, metres.
    Unity,
    /// Left-handed, z up, x forward, y to the right, centimetres.
    Unreal,
    /// Right-handed, z up, metres: of ROS, Blender and OpenSimulator.
    ZUp,
}

impl Coordinates {
    /// Each of them.
    pub const EACH: [Self; 4] = [Self::Rhumb, Self::Unity, Self::Unreal, Self::ZUp];

    /// The coordinates of Bevy.
    pub const BEVY: Self = Self::Rhumb;

    /// The coordinates of Godot.
    pub const GODOT: Self = Self::Rhumb;

    /// Rhumb's metres in one unit of length.
    #[must_use]
    pub const fn metres_per_unit(self) -> f32 {
        match self {
            Self::Rhumb | Self::Unity | Self::ZUp => 1.0,
            Self::Unreal => 0.01,
        }
    }

    /// Units of length in a metre.
    const fn units_per_metre(self) -> f32 {
        match self {
            Self::Rhumb | Self::Unity | Self::ZUp => 1.0,
            Self::Unreal => 100.0,
        }
    }

    /// True if the axes are left-handed.
    #[must_use]
    pub const fn is_left_handed(self) -> bool {
        matches!(self, Self::Unity | Self::Unreal)
    }

    /// The axes of a vector in Rhumb's order; its length stays.
    const fn turned_in(self, v: Vec3) -> Vec3 {
        match self {
            Self::Rhumb => v,
            Self::Unity => Vec3::new(v.x, v.y, 0.0 - v.z),
            Self::Unreal => Vec3::new(v.x, v.z, v.y),
            Self::ZUp => Vec3::new(v.x, v.z, 0.0 - v.y),
        }
    }

    /// The axes of one of Rhumb's vectors in this order; its length stays.
    const fn turned_out(self, v: Vec3) -> Vec3 {
        match self {
            Self::Rhumb => v,
            Self::Unity => Vec3::new(v.x, v.y, 0.0 - v.z),
            Self::Unreal => Vec3::new(v.x, v.z, v.y),
            Self::ZUp => Vec3::new(v.x, 0.0 - v.z, v.y),
        }
    }

    /// A direction, in Rhumb's axes.
    #[must_use]
    pub const fn direction_in(self, direction: Vec3) -> Vec3 {
        self.turned_in(direction)
    }

    /// One of Rhumb's directions.
    #[must_use]
    pub const fn direction_out(self, direction: Vec3) -> Vec3 {
        self.turned_out(direction)
    }

    /// A position, velocity, acceleration, force or impulse: metres in it, and Rhumb's axes.
    #[must_use]
    pub fn vector_in(self, vector: Vec3) -> Vec3 {
        self.turned_in(vector) * self.metres_per_unit()
    }

    /// One of Rhumb's positions or velocities.
    #[must_use]
    pub fn vector_out(self, vector: Vec3) -> Vec3 {
        self.turned_out(vector) * self.units_per_metre()
    }

    /// An angular velocity, rad/s. In left-handed axes a positive turn is the other way round.
    #[must_use]
    pub fn angular_in(self, angular: Vec3) -> Vec3 {
        match self.is_left_handed() {
            true => Vec3::ZERO - self.turned_in(angular),
            false => self.turned_in(angular),
        }
    }

    /// One of Rhumb's angular velocities.
    #[must_use]
    pub fn angular_out(self, angular: Vec3) -> Vec3 {
        match self.is_left_handed() {
            true => Vec3::ZERO - self.turned_out(angular),
            false => self.turned_out(angular),
        }
    }

    /// A torque or angular impulse. Its unit has the unit of length twice.
    #[must_use]
    pub fn torque_in(self, torque: Vec3) -> Vec3 {
        self.angular_in(torque) * (self.metres_per_unit() * self.metres_per_unit())
    }

    /// One of Rhumb's torques or angular impulses.
    #[must_use]
    pub fn torque_out(self, torque: Vec3) -> Vec3 {
        self.angular_out(torque) * (self.units_per_metre() * self.units_per_metre())
    }

    /// A rotation body → world, for a body whose own axes are in the same coordinates.
    #[must_use]
    pub fn rotation_in(self, rotation: Quat) -> Quat {
        let axis = self.angular_in(Vec3::new(rotation.x, rotation.y, rotation.z));
        Quat::from_xyzw(axis.x, axis.y, axis.z, rotation.w)
    }

    /// One of Rhumb's rotations.
    #[must_use]
    pub fn rotation_out(self, rotation: Quat) -> Quat {
        let axis = self.angular_out(Vec3::new(rotation.x, rotation.y, rotation.z));
        Quat::from_xyzw(axis.x, axis.y, axis.z, rotation.w)
    }

    /// A length, in metres.
    #[must_use]
    pub fn length_in(self, length: f32) -> f32 {
        length * self.metres_per_unit()
    }

    /// A turn about an axis, in radians. In left-handed axes a positive one is the other way round.
    pub(crate) fn turn_in(self, turn: f32) -> f32 {
        match self.is_left_handed() {
            true => 0.0 - turn,
            false => turn,
        }
    }

    /// Conditions of sleep, whose speed is in units of length per second.
    #[must_use]
    pub fn sleep_in(self, sleep: Sleep) -> Sleep {
        match sleep {
            Sleep::Settled | Sleep::Never => sleep,
            Sleep::Below(thresholds) => Sleep::Below(SleepThresholds {
                speed: self.length_in(thresholds.speed),
                ..thresholds
            }),
        }
    }

    /// A length of Rhumb's, in metres.
    #[must_use]
    pub fn length_out(self, metres: f32) -> f32 {
        metres * self.units_per_metre()
    }

    /// The edges of a grid along these axes, in units of length; 0 along one that is not divided.
    #[must_use]
    pub fn cell_edges_out(self, grid: CellGrid) -> [f32; 3] {
        let edges = self.turned_out(Vec3::from_array(grid.edges())).abs();
        (edges * self.units_per_metre()).to_array()
    }

    /// A cell by its places along these axes.
    #[must_use]
    pub fn cell_in(self, places: [i32; 3], grid: CellGrid) -> Cell {
        let divided = self.cell_edges_out(grid).map(|edge| edge > 0.0);
        let centre = self.turned_in(centre_of(places, divided));
        Cell(places_of(centre, grid.edges().map(|edge| edge > 0.0)))
    }

    /// The places of a cell along these axes.
    #[must_use]
    pub fn cell_out(self, cell: Cell, grid: CellGrid) -> [i32; 3] {
        let divided = grid.edges().map(|edge| edge > 0.0);
        let centre = self.turned_out(centre_of(cell.0, divided));
        places_of(centre, self.cell_edges_out(grid).map(|edge| edge > 0.0))
    }

    /// Half edge lengths along the axes.
    fn extents_in(self, extents: Vec3) -> Vec3 {
        // A negative extent keeps its sign, so that the check of the shape refuses it.
        let turned = match self {
            Self::Rhumb | Self::Unity => extents,
            Self::Unreal | Self::ZUp => Vec3::new(extents.x, extents.z, extents.y),
        };
        turned * self.metres_per_unit()
    }

    /// Moments of inertia about a body's axes, kg·m² whatever the unit of length.
    pub(crate) const fn moments_in(self, moments: Vec3) -> Vec3 {
        match self {
            Self::Rhumb | Self::Unity => moments,
            Self::Unreal | Self::ZUp => Vec3::new(moments.x, moments.z, moments.y),
        }
    }

    /// A set of axes without motion.
    #[must_use]
    pub fn locked_axes_in(self, locked: LockedAxes) -> LockedAxes {
        let order = match self {
            Self::Rhumb | Self::Unity => [0, 1, 2],
            Self::Unreal | Self::ZUp => [0, 2, 1],
        };
        let mut turned = LockedAxes::NONE;
        for (to, from) in order.into_iter().enumerate() {
            for first in [0, 3] {
                if locked.locks(first + from) {
                    turned = turned | LockedAxes::EACH[first + to];
                }
            }
        }
        turned
    }

    /// A shape in Rhumb's coordinates.
    ///
    /// A height field whose columns run against Rhumb's third axis becomes a compound of one field with reversed columns,
    /// moved to the far end.
    ///
    /// # Errors
    ///
    /// [`Invalid`] for a number that is not finite or outside the limits.
    pub fn shape_in(self, shape: Shape) -> Result<Shape, Invalid> {
        let length = |length| self.length_in(length);
        Ok(match shape {
            Shape::Ball { radius } => Shape::ball(length(radius)),
            Shape::Cuboid { half_extents } => Shape::Cuboid {
                half_extents: self.extents_in(half_extents),
            },
            Shape::RoundedCuboid {
                half_extents,
                radius,
            } => Shape::RoundedCuboid {
                half_extents: self.extents_in(half_extents),
                radius: length(radius),
            },
            Shape::Capsule {
                half_height,
                radius,
            } => Shape::capsule(length(half_height), length(radius)),
            Shape::Cylinder {
                half_height,
                radius,
            } => Shape::cylinder(length(half_height), length(radius)),
            Shape::Cone {
                half_height,
                radius,
            } => Shape::cone(length(half_height), length(radius)),
            Shape::HalfSpace { normal } => Shape::HalfSpace {
                normal: self.direction_in(normal),
            },
            Shape::Hull(hull) => Shape::Hull(Hull::new(&self.points_in(hull.points()))?),
            Shape::Mesh(mesh) => Shape::Mesh(self.mesh_in(&mesh)?),
            Shape::Heights(heights) => self.heights_in(&heights)?,
            Shape::Compound(compound) => {
                let parts = compound.parts().iter().map(|part| self.part_in(part));
                Shape::Compound(Compound::new(parts.collect::<Result<_, Invalid>>()?)?)
            }
        })
    }

    fn points_in(self, points: &[Vec3]) -> Vec<Vec3> {
        points.iter().map(|point| self.vector_in(*point)).collect()
    }

    /// A mesh; its triangles keep their front in mirrored axes.
    fn mesh_in(self, mesh: &Mesh) -> Result<Mesh, Invalid> {
        let turned = |&[a, b, c]: &[u32; 3]| match self.is_left_handed() {
            true => [a, c, b],
            false => [a, b, c],
        };
        let triangles: Vec<_> = mesh.triangles().iter().map(turned).collect();
        let turned = Mesh::new(&self.points_in(mesh.points()), &triangles)?;
        Ok(turned.with_edges(mesh.edges()))
    }

    fn heights_in(self, heights: &Heights) -> Result<Shape, Invalid> {
        let columns = heights.columns();
        let (row, column) = (heights.row_spacing(), heights.column_spacing());
        let (row, column) = (self.length_in(row), self.length_in(column));
        let scaled = |height: &f32| self.length_in(*height);
        match self {
            Self::Rhumb | Self::Unreal => {
                let values: Vec<f32> = heights.heights().iter().map(scaled).collect();
                let field = Heights::new(heights.rows(), row, column, &values)?;
                Ok(Shape::Heights(field.with_edges(heights.edges())))
            }
            Self::Unity | Self::ZUp => {
                let rows = heights.heights().chunks_exact(columns as usize);
                let values: Vec<f32> = rows.flat_map(|row| row.iter().rev().map(scaled)).collect();
                let field = Heights::new(heights.rows(), row, column, &values)?;
                let end = Vec3::new(0.0, 0.0, -column * (columns - 1) as f32);
                let part = Part {
                    position: end,
                    rotation: Quat::IDENTITY,
                    shape: Shape::Heights(field.with_edges(heights.edges())),
                };
                Compound::new(vec![part]).map(Shape::Compound)
            }
        }
    }

    /// A part of a compound. A height field may become a compound of one part, and compounds do not nest: that part takes its
    /// place.
    fn part_in(self, part: &Part) -> Result<Part, Invalid> {
        let turned = Part {
            position: self.vector_in(part.position),
            rotation: self.rotation_in(part.rotation),
            shape: self.shape_in(part.shape.clone())?,
        };
        match &turned.shape {
            Shape::Compound(of_one) if !matches!(part.shape, Shape::Compound(_)) => {
                let inner = &of_one.parts()[0];
                Ok(Part {
                    position: turned.position + turned.rotation * inner.position,
                    rotation: turned.rotation,
                    shape: inner.shape.clone(),
                })
            }
            _ => Ok(turned),
        }
    }

    /// A joint in Rhumb's coordinates.
    #[must_use]
    pub fn joint_in(self, joint: &Joint) -> Joint {
        let axes = JointAxes::new(
            |direction| self.direction_in(direction),
            |angular| self.angular_in(angular),
            self.metres_per_unit(),
        );
        Joint {
            kind: axes.kind(joint.kind),
            frames: joint.frames.map(|frame| JointFrame {
                anchor: self.vector_in(frame.anchor),
                rotation: self.rotation_in(frame.rotation),
            }),
            motors: axes.motors(joint.motors),
            strength: joint.strength.map(|strength| axes.strength(strength)),
            ..*joint
        }
    }

    /// The default character, in the application's units of length.
    #[must_use]
    pub fn plain_character(self) -> Character {
        let plain = Character::default();
        Character {
            offset: self.length_out(plain.offset),
            snap: plain.snap.map(|snap| self.length_out(snap)),
            ..plain
        }
    }

    /// A wheel with the default suspension, which points down. Its axle points to the right: along x, in Unreal along y.
    ///
    /// Its suspension may push with any force.
    #[must_use]
    pub fn plain_wheel(self, position: Vec3, radius: f32) -> Wheel {
        let plain = Wheel::at(position, radius);
        Wheel {
            direction: self.direction_out(plain.direction),
            axle: match self {
                Self::Rhumb | Self::Unity | Self::ZUp => Vec3::X,
                Self::Unreal => Vec3::Y,
            },
            rest_length: self.length_out(plain.rest_length),
            travel: self.length_out(plain.travel),
            ..plain
        }
    }

    /// A query in Rhumb's coordinates.
    ///
    /// # Errors
    ///
    /// [`Invalid`] for a shape with a number that is not finite or outside the limits.
    pub fn query_in(self, query: Query) -> Result<Query, Invalid> {
        let kind = match query.kind {
            QueryKind::Ray {
                origin,
                translation,
            } => QueryKind::Ray {
                origin: self.vector_in(origin),
                translation: self.vector_in(translation),
            },
            QueryKind::ShapeCast {
                shape,
                position,
                rotation,
                translation,
            } => QueryKind::ShapeCast {
                shape: self.shape_in(shape)?,
                position: self.vector_in(position),
                rotation: self.rotation_in(rotation),
                translation: self.vector_in(translation),
            },
            QueryKind::Projection { point, distance } => QueryKind::Projection {
                point: self.vector_in(point),
                distance: self.length_in(distance),
            },
            QueryKind::Overlap {
                shape,
                position,
                rotation,
            } => QueryKind::Overlap {
                shape: self.shape_in(shape)?,
                position: self.vector_in(position),
                rotation: self.rotation_in(rotation),
            },
            QueryKind::Contacts { body } => QueryKind::Contacts { body },
        };
        Ok(Query { kind, ..query })
    }

    /// A hit of one of Rhumb's queries.
    #[must_use]
    pub fn hit_out(self, hit: Hit) -> Hit {
        Hit {
            body: hit.body,
            distance: self.length_out(hit.distance),
            point: self.vector_out(hit.point),
            normal: self.direction_out(hit.normal),
        }
    }

    /// One of Rhumb's contacts.
    #[must_use]
    pub fn contact_out(self, contact: Contact) -> Contact {
        Contact {
            with: contact.with,
            point: self.vector_out(contact.point),
            normal: self.direction_out(contact.normal),
            separation: self.length_out(contact.separation),
            force: self.length_out(contact.force),
        }
    }
}

/// How far a pose may be from the view's by the rounding of the coordinates in which it is handed out, units of length.
///
/// Each component of a position is rounded by half a unit in its last place where it is scaled. That of a body's origin is
/// rounded as often where the turned centre is taken from it; that one has an error of its own, below four such roundings
/// of its length.
pub(crate) fn rounding(position: Vec3, centre: Vec3, coordinates: Coordinates) -> f64 {
    let ulp = |value: f32| f64::from(value.abs().next_up() - value.abs());
    let scale = f64::from(1.0 / coordinates.metres_per_unit());
    let length = centre.length();
    let mut squares = 0.0;
    for component in position.to_array() {
        let component = component.abs() + length;
        let mut error = 0.0;
        if coordinates == Coordinates::Unreal {
            error += 0.5 * ulp(coordinates.length_out(component));
        }
        if centre != Vec3::ZERO {
            error += scale * (0.5 * ulp(component) + 4.0 * ulp(length));
        }
        squares += error * error;
    }
    squares.sqrt()
}

/// A bound rounded up, so that it stays a bound.
pub(crate) fn units_up(exact: f64) -> f32 {
    let near = exact as f32;
    match f64::from(near) < exact {
        true => near.next_up(),
        false => near,
    }
}

/// The centre of a cell in half edges, from places along axes of which some are divided. Places beyond those of cells stay
/// beyond them.
fn centre_of(places: [i32; 3], divided: [bool; 3]) -> Vec3 {
    let limit = 2 * Cell::PLACE_MAX;
    let centre = |axis: usize| {
        let place = places[axis].clamp(-limit, limit);
        (2 * place + i32::from(divided[axis])) as f32
    };
    Vec3::new(centre(0), centre(1), centre(2))
}

/// The inverse of [`centre_of`].
fn places_of(centre: Vec3, divided: [bool; 3]) -> [i32; 3] {
    let centre = centre.to_array();
    std::array::from_fn(|axis| (centre[axis] as i32 - i32::from(divided[axis])) / 2)
}

#[cfg(test)]
mod joint_tests;
#[cfg(test)]
mod locomotion_tests;
#[cfg(test)]
mod tests;

/// The axes of an application's joints, as Rhumb's.
struct JointAxes {
    each: [JointAxis; 6],
    metres_per_unit: f32,
}

/// The axis of Rhumb's that corresponds to one of the application's.
struct JointAxis {
    place: usize,
    /// −1 where it points the other way.
    sign: f32,
    /// Rhumb's metres or radians in one unit.
    unit: f32,
    /// Rhumb's newtons or newton metres in one unit.
    load: f32,
}

impl JointAxis {
    /// A position or velocity. A zero stays without a sign.
    fn value(&self, value: f32) -> f32 {
        let scaled = value * self.unit;
        match self.sign < 0.0 {
            true => 0.0 - scaled,
            false => scaled,
        }
    }

    fn limits(&self, limits: JointLimits) -> JointLimits {
        let ends = [self.value(limits.least), self.value(limits.most)];
        let [least, most] = match self.sign < 0.0 {
            true => [ends[1], ends[0]],
            false => ends,
        };
        JointLimits { least, most }
    }

    fn motor(&self, motor: Motor) -> Motor {
        Motor {
            position: self.value(motor.position),
            velocity: self.value(motor.velocity),
            force: motor.force * self.load,
            ..motor
        }
    }
}

impl JointAxes {
    /// The axes by what a direction and an angular velocity of the application become.
    fn new(
        direction: impl Fn(Vec3) -> Vec3,
        angular: impl Fn(Vec3) -> Vec3,
        metres_per_unit: f32,
    ) -> Self {
        let translation = |axis: usize| {
            let turned = direction(Vec3::AXES[axis]);
            let place = turned.abs().max_position();
            JointAxis {
                place,
                sign: turned[place],
                unit: metres_per_unit,
                load: metres_per_unit,
            }
        };
        let rotation = |axis: usize| {
            let turned = angular(Vec3::AXES[axis]);
            let place = turned.abs().max_position();
            JointAxis {
                place: place + 3,
                sign: turned[place],
                unit: 1.0,
                load: metres_per_unit * metres_per_unit,
            }
        };
        let each = std::array::from_fn(|axis| match axis {
            0..3 => translation(axis),
            _ => rotation(axis - 3),
        });
        Self {
            each,
            metres_per_unit,
        }
    }

    /// Values of six axes, at Rhumb's.
    fn six<T: Copy>(
        &self,
        values: [Option<T>; 6],
        convert: impl Fn(&JointAxis, T) -> T,
    ) -> [Option<T>; 6] {
        let mut turned = [None; 6];
        for (axis, value) in self.each.iter().zip(values) {
            turned[axis.place] = value.map(|value| convert(axis, value));
        }
        turned
    }

    fn locked(&self, locked: LockedAxes) -> LockedAxes {
        let axes = self.each.iter().enumerate();
        let turned = axes.filter(|(axis, _)| locked.locks(*axis));
        turned.fold(LockedAxes::NONE, |all, (_, axis)| {
            all | LockedAxes::EACH[axis.place]
        })
    }

    fn kind(&self, kind: JointKind) -> JointKind {
        let limits = self.six(kind.limits(), JointAxis::limits);
        match kind {
            JointKind::Fixed | JointKind::Spherical(None) => kind,
            JointKind::Spherical(Some(_)) => JointKind::Spherical(match limits {
                [_, _, _, Some(x), Some(y), Some(z)] => Some([x, y, z]),
                _ => None,
            }),
            JointKind::Revolute(_) => JointKind::Revolute(limits[3]),
            JointKind::Prismatic(_) => JointKind::Prismatic(limits[0]),
            JointKind::Rope(length) => JointKind::Rope(length * self.metres_per_unit),
            // Newtons per metre have no unit of length.
            JointKind::Spring(spring) => JointKind::Spring(Spring {
                length: spring.length * self.metres_per_unit,
                ..spring
            }),
            JointKind::Generic(locked, _) => JointKind::Generic(self.locked(locked), limits),
        }
    }

    fn motors(&self, motors: [Option<Motor>; 6]) -> [Option<Motor>; 6] {
        self.six(motors, JointAxis::motor)
    }

    fn strength(&self, strength: JointStrength) -> JointStrength {
        JointStrength {
            force: strength.force * self.metres_per_unit,
            torque: strength.torque * (self.metres_per_unit * self.metres_per_unit),
        }
    }
}
