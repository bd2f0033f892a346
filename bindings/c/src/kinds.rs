//! Enumerations of the C interface.
//!
//! A struct of C holds their numbers as `uint32_t`, because C does not keep a number within its enumeration.

use rhumb_bindings::rhumb_client::Refusals;
use rhumb_bindings::rhumb_client::scene::{BodyKind, Edges, Stepping};
use rhumb_bindings::{Coordinates, JoinCondition, JointFreedom};

/// Axes and unit of length of an application. Up is the same direction in all of them.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbCoordinates {
    /// Right-handed, y up, metres: Rhumb's own, Godot's and Bevy's. Pose arrays are not even copied.
    Rhumb,
    /// Left-handed, y up, z forward, metres.
    Unity,
    /// Left-handed, z up, x forward, y to the right, centimetres.
    Unreal,
    /// Right-handed, z up, metres: of ROS, Blender and OpenSimulator.
    ZUp,
}

/// The condition of joining: a new scene, an existing one, or either.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbJoinCondition {
    /// Creates the scene unless it exists.
    CreateOrJoin,
    /// Creates the scene, which must not exist.
    Create,
    /// Joins the scene, which must exist.
    Join,
}

/// Source of a scene's ticks.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbStepping {
    /// The scene steps when a client advances it: `rhumb_scene_advance`.
    Lockstep,
    /// The scene steps by the server's clock: `rhumb_scene_poll`.
    FreeRunning,
}

/// How a client reports what the server refuses: commands, and requests for authority.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbRefusals {
    /// The next advance, wait or poll is `RHUMB_CODE_REFUSED`, after it has done its work. They are events as well.
    Errors,
    /// They are events alone, for an application that reads all events.
    Events,
}

/// Kind of a body's motion.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbBodyKind {
    /// The engine moves it.
    Dynamic,
    /// It does not move.
    Fixed,
    /// Commands move it; it pushes others and is not pushed.
    Kinematic,
}

/// Conditions under which bodies fall asleep.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbSleep {
    /// Of a body: as the scene has it. Of a new scene: as `RHUMB_SLEEP_SETTLED`.
    Default,
    /// A body sleeps once it has settled: it is slow, and neither gravity nor a motor still moves it.
    Settled,
    /// A body sleeps once it is slower than `sleep_speed` and `sleep_angular_speed` for `sleep_seconds`, whatever moves it.
    Below,
    /// A body never falls asleep by itself, and neither does what it touches.
    Never,
}

/// How bodies touch the edges that two triangles of a mesh or of heights share.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbEdges {
    /// Each triangle is touched as if it were alone: a body that slides over flat ground may catch on an edge.
    Plain,
    /// A body slides and rolls over flat ground as over one face. Heights are then touched from above only.
    Smooth,
}

/// Kind of a shape. Its origin is its body's centre of mass, but for hulls and compounds. Long axes point up.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbShapeKind {
    /// A sphere: `radius`.
    Ball,
    /// A box: `half_extents`.
    Cuboid,
    /// A cylinder with half balls on its ends: `half_height` of its straight part, `radius`.
    Capsule,
    /// A cylinder: `half_height`, `radius`.
    Cylinder,
    /// A cone whose tip points up: `half_height`, `radius` of its base.
    Cone,
    /// A box with round edges: `half_extents` of the box inside, `radius`.
    RoundedCuboid,
    /// Everything behind a plane through the body's origin: `normal`. For fixed and kinematic bodies.
    HalfSpace,
    /// The convex hull of `points`, which may be given from anywhere: see `rhumb_shape_centre`. It has 255 corners at most;
    /// other points are left out.
    Hull,
    /// A mesh of `points` and `triangles`. For fixed and kinematic bodies.
    Mesh,
    /// A height field: `points` holds one height for each post, `rows` rows of them. The first post is at the body's origin;
    /// the rows follow each other along x, the columns along the other axis of the ground. For fixed and kinematic bodies.
    Heights,
    /// Several shapes: `parts`. No part is a compound.
    Compound,
}

/// Kind of a joint: which motions of the second frame in the first are free. Angles are twice the arc sine of a part of
/// the turn's quaternion.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbJointKind {
    /// None.
    Fixed,
    /// Every turn; limits about x, y and z.
    Spherical,
    /// The turn about x; a limit about x.
    Revolute,
    /// The displacement along x; a limit along x.
    Prismatic,
    /// Every one, but the anchors are at most `length` apart.
    Rope,
    /// Every one; a spring of `length`, `stiffness` and `damping` pulls the anchors.
    Spring,
    /// Every axis that `locked_axes` does not name, with any limits.
    Generic,
}

/// Kind of a query.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbQueryKind {
    /// The nearest bodies along the line from `position` by `translation`.
    Ray,
    /// The nearest bodies that `shape`, at `position` and `rotation`, touches on its way by `translation`.
    ShapeCast,
    /// The bodies whose surfaces are nearest to `position`, within `distance`.
    Projection,
    /// The bodies that `shape` overlaps at `position` and `rotation`.
    Overlap,
    /// The bodies that touch `body` after the last step, the deepest contact first; their points lie on `body`.
    Contacts,
}

/// The coordinates in the order of their numbers.
pub(crate) const COORDINATES: [Coordinates; 4] = Coordinates::EACH;

pub(crate) const CONDITIONS: [JoinCondition; 3] = [
    JoinCondition::CreateOrJoin,
    JoinCondition::Create,
    JoinCondition::Join,
];

pub(crate) const REFUSALS: [Refusals; 2] = [Refusals::Errors, Refusals::Events];
pub(crate) const STEPPINGS: [Stepping; 2] = [Stepping::Lockstep, Stepping::FreeRunning];

pub(crate) const EDGES: [Edges; 2] = [Edges::Plain, Edges::Smooth];

pub(crate) const BODY_KINDS: [BodyKind; 3] =
    [BodyKind::Dynamic, BodyKind::Fixed, BodyKind::Kinematic];

/// The kinds of joints in the order of their numbers.
pub(crate) const JOINT_KINDS: [JointFreedom; 7] = [
    JointFreedom::Fixed,
    JointFreedom::Spherical,
    JointFreedom::Revolute,
    JointFreedom::Prismatic,
    JointFreedom::Rope,
    JointFreedom::Spring,
    JointFreedom::Generic,
];

impl RhumbSleep {
    pub(crate) const EACH: [Self; 4] = [Self::Default, Self::Settled, Self::Below, Self::Never];
}

impl RhumbShapeKind {
    /// In the order of their numbers.
    pub(crate) const EACH: [Self; 11] = [
        Self::Ball,
        Self::Cuboid,
        Self::Capsule,
        Self::Cylinder,
        Self::Cone,
        Self::RoundedCuboid,
        Self::HalfSpace,
        Self::Hull,
        Self::Mesh,
        Self::Heights,
        Self::Compound,
    ];
}

impl RhumbQueryKind {
    /// In the order of their numbers.
    pub(crate) const EACH: [Self; 5] = [
        Self::Ray,
        Self::ShapeCast,
        Self::Projection,
        Self::Overlap,
        Self::Contacts,
    ];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_numbers_of_the_header_are_places_in_the_lists() {
        for (place, kind) in RhumbSleep::EACH.into_iter().enumerate() {
            assert_eq!(kind as usize, place);
        }
        for (place, kind) in RhumbShapeKind::EACH.into_iter().enumerate() {
            assert_eq!(kind as usize, place);
        }
        for (place, kind) in RhumbQueryKind::EACH.into_iter().enumerate() {
            assert_eq!(kind as usize, place);
        }
        let coordinates = |kind: RhumbCoordinates| COORDINATES[kind as usize];
        assert_eq!(coordinates(RhumbCoordinates::Rhumb), Coordinates::Rhumb);
        assert_eq!(coordinates(RhumbCoordinates::Unity), Coordinates::Unity);
        assert_eq!(coordinates(RhumbCoordinates::Unreal), Coordinates::Unreal);
        assert_eq!(coordinates(RhumbCoordinates::ZUp), Coordinates::ZUp);
        assert_eq!(
            BODY_KINDS[RhumbBodyKind::Dynamic as usize],
            BodyKind::Dynamic
        );
        assert_eq!(BODY_KINDS[RhumbBodyKind::Fixed as usize], BodyKind::Fixed);
        assert_eq!(
            BODY_KINDS[RhumbBodyKind::Kinematic as usize],
            BodyKind::Kinematic
        );
        assert_eq!(
            STEPPINGS[RhumbStepping::FreeRunning as usize],
            Stepping::FreeRunning
        );
        for (kind, freedom) in [
            (RhumbJointKind::Fixed, JointFreedom::Fixed),
            (RhumbJointKind::Spherical, JointFreedom::Spherical),
            (RhumbJointKind::Revolute, JointFreedom::Revolute),
            (RhumbJointKind::Prismatic, JointFreedom::Prismatic),
            (RhumbJointKind::Rope, JointFreedom::Rope),
            (RhumbJointKind::Spring, JointFreedom::Spring),
            (RhumbJointKind::Generic, JointFreedom::Generic),
        ] {
            assert_eq!(JOINT_KINDS[kind as usize], freedom);
        }
        assert_eq!(
            CONDITIONS[RhumbJoinCondition::Create as usize],
            JoinCondition::Create
        );
        assert_eq!(
            CONDITIONS[RhumbJoinCondition::Join as usize],
            JoinCondition::Join
        );
    }
}
