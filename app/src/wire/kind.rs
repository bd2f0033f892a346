//! The types of messages, and their least and greatest length.

use super::limits::{HEADER_BYTES, MESSAGE_BYTES_MAX, POINTS_MAX, POSTS_MAX, TEXT_BYTES_MAX};
use super::malformed::MalformedMessage;

macro_rules! kinds {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $least:expr, $most:expr;)+) => {
        /// Type of a message. Its number is its code on the wire.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u16)]
        pub enum Kind {
            $($(#[$doc])* $name = $code,)+
        }

        impl Kind {
            /// Every type, by code.
            pub const ALL: &[Self] = &[$(Self::$name),+];

            /// The type of a code.
            #[must_use]
            pub(crate) const fn from_code(code: u16) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)+
                    _ => None,
                }
            }

            /// Least and greatest length of the body, bytes.
            pub(crate) const fn body_bytes(self) -> (usize, usize) {
                match self {
                    $(Self::$name => ($least, $most),)+
                }
            }
        }
    };
}

kinds! {
    /// A message was faulty.
    Error = 1, 4, 4 + TEXT_BYTES_MAX;
    /// A client logs on.
    Logon = 11, 52, 52;
    /// The server accepts a client.
    LogonReady = 12, 4, 4;
    /// A client logs off.
    Logoff = 13, 4, 4;
    /// Asks the server to advance time.
    AdvanceTime = 14, 8, 8;
    /// Reports that time was advanced.
    TimeAdvanced = 15, 4, 4;
    /// Gravity and the ground plane.
    SetWorld = 101, 52, 52;
    /// Creates an actor that does not move.
    CreateStaticActor = 102, 40, 40;
    /// Creates an actor that moves.
    CreateDynamicActor = 103, 68, 68;
    /// Sets the pose of a static actor.
    SetStaticActor = 104, 36, 36;
    /// Pose and velocities of an actor: its state.
    SetDynamicActor = 105, 64, 64;
    /// Sets an actor's position.
    UpdateActorPosition = 106, 20, 20;
    /// Sets an actor's orientation.
    UpdateActorOrientation = 107, 24, 24;
    /// Sets an actor's factor on gravity.
    UpdateGravityModifier = 108, 12, 12;
    /// Sets an actor's linear velocity.
    UpdateLinearVelocity = 109, 20, 20;
    /// Sets an actor's angular velocity.
    UpdateAngularVelocity = 110, 20, 20;
    /// The mass of an actor.
    UpdateMass = 111, 12, 12;
    /// Asks for the mass of an actor.
    GetMass = 112, 8, 8;
    /// Removes an actor.
    RemoveActor = 113, 8, 8;
    /// Joins two actors, or one to the world.
    AddJoint = 201, 128, 128;
    /// Removes a joint.
    RemoveJoint = 202, 8, 8;
    /// A ball.
    AddSphere = 301, 24, 24;
    /// A plane.
    AddPlane = 302, 24, 24;
    /// A capsule.
    AddCapsule = 303, 16, 16;
    /// A box.
    AddBox = 304, 20, 20;
    /// The convex hull of points.
    AddConvexMesh = 305, 12, 12 + 12 * POINTS_MAX;
    /// A mesh of triangles.
    AddTriangleMesh = 306, 16, MESSAGE_BYTES_MAX - HEADER_BYTES;
    /// A height field.
    AddHeightField = 307, 24, 24 + 4 * POSTS_MAX;
    /// Removes the definition of a shape.
    RemoveShape = 308, 8, 8;
    /// Attaches a shape to an actor.
    AttachShape = 309, 60, 60;
    /// Sets density and surface of a shape on an actor.
    UpdateShapeMaterial = 310, 32, 32;
    /// Detaches a shape from an actor.
    DetachShape = 311, 16, 16;
    /// Two actors touch.
    ActorsCollided = 401, 44, 44;
    /// Applies a force to an actor.
    ApplyForce = 402, 20, 20;
    /// Applies a torque to an actor.
    ApplyTorque = 403, 20, 20;
}

impl Kind {
    /// Its code.
    #[must_use]
    pub(crate) const fn code(self) -> u16 {
        self as u16
    }

    /// Checks the length of a message of this type, header included.
    pub(crate) const fn check_length(self, bytes: u32) -> Result<usize, MalformedMessage> {
        let (least, most) = self.body_bytes();
        let length = bytes as usize;
        if length >= least + HEADER_BYTES && length <= most + HEADER_BYTES {
            Ok(length)
        } else {
            let kind = self.code();
            Err(MalformedMessage::Length { kind, bytes })
        }
    }
}
