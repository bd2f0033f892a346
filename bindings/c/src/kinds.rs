//! Enumerations of the C interface.
//!
//! A struct of C holds their numbers as `uint32_t`, because C does not keep a number within its enumeration.

use rhumb_bindings::rhumb_client::Refusals;
use rhumb_bindings::rhumb_client::scene::{BodyKind, Edges, JumpFrom, Stepping};
use rhumb_bindings::{Coordinates, EventKind, JoinCondition, JointFreedom};

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
    /// Everything behind a plane through the body's origin: `normal`. For fixed bodies.
    HalfSpace,
    /// The convex hull of `points`, which may be given from anywhere: see `rhumb_shape_centre`. It has 255 corners at most;
    /// other points are left out.
    Hull,
    /// A mesh of `points` and `triangles`. For fixed bodies.
    Mesh,
    /// A height field: `points` holds one height for each post, `rows` rows of them. The first post is at the body's origin;
    /// the rows follow each other along x, the columns along the other axis of the ground. For fixed bodies.
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

/// Ground that a jump of a character needs.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbJumpFrom {
    /// The character jumps only if it stands on the ground.
    Ground,
    /// It jumps in the air too.
    Anywhere,
}

/// Kind of a command.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbCommandKind {
    /// Removes `body`.
    RemoveBody,
    /// Moves `body` to the position `vector` and to `rotation`: at once, or a kinematic one during the next tick. If poses of
    /// a kinematic body come more seldom than ticks, up to four a second, it moves evenly from one to the next and carries
    /// what lies on it. A pose beyond 100 m/s or a quarter of a turn in a tick is a jump that shoves nothing.
    SetPose,
    /// Gives `body` the velocity `vector` and the angular velocity `angular`.
    SetVelocity,
    /// Applies the force `vector` at the centre of mass of `body` during the next tick.
    Force,
    /// Applies the torque `vector` to `body` during the next tick.
    Torque,
    /// Applies the impulse `vector` at the centre of mass of `body`.
    Impulse,
    /// Applies the angular impulse `vector` to `body`.
    TorqueImpulse,
    /// Applies the force `vector` to `body` at `point` during the next tick.
    ForceAt,
    /// Applies the impulse `vector` to `body` at `point`.
    ImpulseAt,
    /// Makes `vector` the gravity of the scene.
    SetGravity,
    /// Puts `body` to sleep.
    Sleep,
    /// Wakes `body`.
    Wake,
    /// Makes `body` report the events that `events` names, and contacts from the force `event_force` on.
    SetEvents,
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
}

/// The kind of an event.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RhumbEventKind {
    /// There was no event.
    None,
    /// All commands up to `number` were applied or refused; they act in the step after `tick`.
    CommandsApplied,
    /// The command `number` was refused; `text` says why.
    CommandRefused,
    /// `body` was placed in the scene.
    BodyPlaced,
    /// `body` was removed; `text` says why.
    BodyRemoved,
    /// `body` and `other` began to touch.
    ContactBegan,
    /// `body` and `other` ceased to touch, or one of them was removed.
    ContactEnded,
    /// The force between `body` and `other` reached the threshold of one of them.
    ContactForce,
    /// `other` entered the sensor `body`.
    SensorEntered,
    /// `other` left the sensor `body`.
    SensorLeft,
    /// `body` fell asleep.
    FellAsleep,
    /// `body` woke.
    Woke,
    /// The state of `body` was not finite, and it was removed.
    BodyFault,
    /// So many events of bodies as `number` says were not kept.
    EventsMissed,
    /// The stream changed because of the link.
    StreamChanged,
    /// The engine failed, and the scene continues from `tick` without the commands that it failed on.
    SceneRestored,
    /// The engine failed, and the scene stands still after `tick`.
    SceneFaulted,
    /// The scene was deleted.
    SceneDeleted,
    /// The connection ended, and the client tries to resume.
    Interrupted,
    /// The client continues with its session over another connection.
    Resumed,
    /// The server does not know the session any more.
    SessionLost,
    /// The scene up to `tick` survives a crash of the server.
    Durable,
    /// The server granted authority over as many bodies as `number` says.
    AuthorityGranted,
    /// The server denied authority; `text` says why.
    AuthorityDenied,
    /// The server denied a request; `text` says why.
    Denied,
    /// The connection ended; `text` says why.
    Ended,
    /// Any other event; `text` names it.
    Other,
    /// The character `body` reached ground that carries it.
    ReachedGround,
    /// No ground carries the character `body` any more.
    LeftGround,
    /// The server receives nothing from the member with authority over `body`: from `tick` on its pose is a guess, and its
    /// error bound is infinite.
    PublisherSilent,
    /// It receives from that member again, or its authority has ended: from `tick` on `body` has an error bound.
    PublisherActive,
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

/// The grounds of jumps in the order of their numbers.
pub(crate) const JUMPS: [JumpFrom; 2] = [JumpFrom::Ground, JumpFrom::Anywhere];

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

impl RhumbCommandKind {
    /// In the order of their numbers.
    pub(crate) const EACH: [Self; 13] = [
        Self::RemoveBody,
        Self::SetPose,
        Self::SetVelocity,
        Self::Force,
        Self::Torque,
        Self::Impulse,
        Self::TorqueImpulse,
        Self::ForceAt,
        Self::ImpulseAt,
        Self::SetGravity,
        Self::Sleep,
        Self::Wake,
        Self::SetEvents,
    ];
}

impl RhumbQueryKind {
    /// In the order of their numbers.
    pub(crate) const EACH: [Self; 4] =
        [Self::Ray, Self::ShapeCast, Self::Projection, Self::Overlap];
}

impl RhumbEventKind {
    pub(crate) const fn of(kind: EventKind) -> Self {
        match kind {
            EventKind::CommandsApplied => Self::CommandsApplied,
            EventKind::CommandRefused => Self::CommandRefused,
            EventKind::BodyPlaced => Self::BodyPlaced,
            EventKind::BodyRemoved => Self::BodyRemoved,
            EventKind::ContactBegan => Self::ContactBegan,
            EventKind::ContactEnded => Self::ContactEnded,
            EventKind::ContactForce => Self::ContactForce,
            EventKind::SensorEntered => Self::SensorEntered,
            EventKind::SensorLeft => Self::SensorLeft,
            EventKind::FellAsleep => Self::FellAsleep,
            EventKind::Woke => Self::Woke,
            EventKind::BodyFault => Self::BodyFault,
            EventKind::ReachedGround => Self::ReachedGround,
            EventKind::LeftGround => Self::LeftGround,
            EventKind::EventsMissed => Self::EventsMissed,
            EventKind::StreamChanged => Self::StreamChanged,
            EventKind::PublisherSilent => Self::PublisherSilent,
            EventKind::PublisherActive => Self::PublisherActive,
            EventKind::SceneRestored => Self::SceneRestored,
            EventKind::SceneFaulted => Self::SceneFaulted,
            EventKind::SceneDeleted => Self::SceneDeleted,
            EventKind::Interrupted => Self::Interrupted,
            EventKind::Resumed => Self::Resumed,
            EventKind::SessionLost => Self::SessionLost,
            EventKind::Durable => Self::Durable,
            EventKind::AuthorityGranted => Self::AuthorityGranted,
            EventKind::AuthorityDenied => Self::AuthorityDenied,
            EventKind::Denied => Self::Denied,
            EventKind::Ended => Self::Ended,
            EventKind::Other => Self::Other,
        }
    }
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
        for (place, kind) in RhumbCommandKind::EACH.into_iter().enumerate() {
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
        assert_eq!(JUMPS[RhumbJumpFrom::Ground as usize], JumpFrom::Ground);
        assert_eq!(JUMPS[RhumbJumpFrom::Anywhere as usize], JumpFrom::Anywhere);
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
