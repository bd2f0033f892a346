//! The 24 bytes at the start of every message, and the types of messages.
//!
//! Each type has a least and a greatest length.

use super::codec::{
    Field, FieldReader, HEADER_BYTES, MESSAGE_BYTES_MAX, MalformedMessage, POINTS_MAX, POSTS_MAX,
    TEXT_BYTES_MAX,
};

/// The only version.
const VERSION: u16 = 1;

/// Type and length of a message. Timestamp and reserved bytes are written as zero and not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Header {
    /// The message's type.
    pub(crate) kind: Kind,
    /// The sender's counter. It only serves to name a faulty message: it repeats and goes back.
    pub(crate) index: u32,
    /// Bytes of the message, header included.
    pub(crate) length: usize,
}

impl Header {
    /// Appends the header.
    pub(crate) fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&VERSION.to_be_bytes());
        to.extend_from_slice(&self.kind.code().to_be_bytes());
        self.index.put(to);
        (self.length as u32).put(to);
        [0_u32; 3].put(to);
    }

    /// Takes the header off the front.
    ///
    /// # Errors
    ///
    /// [`MalformedMessage`] for another version, an unknown type, or a length that no message of the type has.
    pub(crate) fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let version = from.array().map(u16::from_be_bytes)?;
        let code = from.array().map(u16::from_be_bytes)?;
        let index = u32::take(from)?;
        let bytes = u32::take(from)?;
        from.array::<12>()?;
        if version != VERSION {
            return Err(MalformedMessage::Version(version));
        }
        let kind = Kind::from_code(code).ok_or(MalformedMessage::UnknownKind(code))?;
        let length = kind.check_length(bytes)?;
        Ok(Self {
            kind,
            index,
            length,
        })
    }
}

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
            const fn from_code(code: u16) -> Option<Self> {
                match code {
                    $($code => Some(Self::$name),)+
                    _ => None,
                }
            }

            /// Least and greatest length of the body, bytes.
            const fn body_bytes(self) -> (usize, usize) {
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
    const fn code(self) -> u16 {
        self as u16
    }

    /// Checks the length of a message of this type, header included.
    const fn check_length(self, bytes: u32) -> Result<usize, MalformedMessage> {
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
