//! The types of messages, and how long each may be.

use crate::header::HEADER_BYTES;
use crate::limits::{MESSAGE_BYTES_MAX, POINTS_MAX, POSTS_MAX, TEXT_BYTES_MAX};
use crate::malformed::Malformed;

macro_rules! kinds {
    ($($(#[$doc:meta])* $name:ident = $code:literal, $least:expr, $most:expr;)+) => {
        /// What a message is about. Its number is its code on the wire.
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
            pub const fn from_code(code: u16) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)+
                    _ => None,
                }
            }

            /// Least and most bytes behind the header.
            pub(crate) const fn body_bytes(self) -> (usize, usize) {
                match self {
                    $(Self::$name => ($least, $most),)+
                }
            }
        }
    };
}

kinds! {
    /// Something was wrong with a message.
    Error = 1, 4, 4 + TEXT_BYTES_MAX;
    /// A client is there.
    Logon = 11, 52, 52;
    /// It is taken in.
    LogonReady = 12, 4, 4;
    /// It is gone.
    Logoff = 13, 4, 4;
    /// Time shall pass.
    AdvanceTime = 14, 8, 8;
    /// It has passed.
    TimeAdvanced = 15, 4, 4;
    /// Gravity and the ground plane.
    SetWorld = 101, 52, 52;
    /// An actor that does not move.
    CreateStaticActor = 102, 40, 40;
    /// An actor that moves.
    CreateDynamicActor = 103, 68, 68;
    /// Where an actor stands.
    SetStaticActor = 104, 36, 36;
    /// Where an actor is, and how it moves: the state.
    SetDynamicActor = 105, 64, 64;
    /// Puts an actor elsewhere.
    UpdateActorPosition = 106, 20, 20;
    /// Turns an actor.
    UpdateActorOrientation = 107, 24, 24;
    /// How much gravity pulls at an actor.
    UpdateGravityModifier = 108, 12, 12;
    /// Sets an actor going.
    UpdateLinearVelocity = 109, 20, 20;
    /// Sets an actor spinning.
    UpdateAngularVelocity = 110, 20, 20;
    /// The mass of an actor.
    UpdateMass = 111, 12, 12;
    /// Asks for it.
    GetMass = 112, 8, 8;
    /// Takes an actor out.
    RemoveActor = 113, 8, 8;
    /// Holds two actors together, or one to the world.
    AddJoint = 201, 128, 128;
    /// Lets go.
    RemoveJoint = 202, 8, 8;
    /// A ball.
    AddSphere = 301, 24, 24;
    /// A plane.
    AddPlane = 302, 24, 24;
    /// A capsule.
    AddCapsule = 303, 16, 16;
    /// A box.
    AddBox = 304, 20, 20;
    /// The hull of some points.
    AddConvexMesh = 305, 12, 12 + 12 * POINTS_MAX;
    /// A mesh of triangles.
    AddTriangleMesh = 306, 16, MESSAGE_BYTES_MAX - HEADER_BYTES;
    /// A field of heights.
    AddHeightField = 307, 24, 24 + 4 * POSTS_MAX;
    /// Forgets a shape.
    RemoveShape = 308, 8, 8;
    /// Puts a shape on an actor.
    AttachShape = 309, 60, 60;
    /// What a shape on an actor is made of.
    UpdateShapeMaterial = 310, 32, 32;
    /// Takes a shape off an actor.
    DetachShape = 311, 16, 16;
    /// Two actors touch.
    ActorsCollided = 401, 44, 44;
    /// Pushes an actor.
    ApplyForce = 402, 20, 20;
    /// Turns an actor.
    ApplyTorque = 403, 20, 20;
}

impl Kind {
    /// Its code.
    #[must_use]
    pub const fn code(self) -> u16 {
        self as u16
    }

    /// Whether a message of this type may be so long, header included.
    pub(crate) const fn check_length(self, bytes: u32) -> Result<usize, Malformed> {
        let (least, most) = self.body_bytes();
        let length = bytes as usize;
        if length >= least + HEADER_BYTES && length <= most + HEADER_BYTES {
            Ok(length)
        } else {
            let kind = self.code();
            Err(Malformed::Length { kind, bytes })
        }
    }
}
