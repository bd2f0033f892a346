//! Headers, big-endian fields and their limits, and malformed messages.
//!
//! Neither clock nor socket. Decoding follows the published plug-in, its faults included; encoding stays within what it
//! accepts. Bytes from a peer cannot panic, and cannot make memory grow beyond its limits: every length is checked, and
//! nothing asserts.

use core::fmt;

use glam::{Quat, Vec3};

/// Takes values off the front of a slice.
#[derive(Clone, Debug)]
pub(crate) struct FieldReader<'a> {
    rest: &'a [u8],
}

impl<'a> FieldReader<'a> {
    pub(crate) const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes }
    }

    pub(crate) const fn left(&self) -> usize {
        self.rest.len()
    }

    pub(crate) fn raw(&mut self, count: usize) -> Result<&'a [u8], MalformedMessage> {
        let split = self.rest.split_at_checked(count);
        let (taken, rest) = split.ok_or(MalformedMessage::Truncated)?;
        self.rest = rest;
        Ok(taken)
    }

    pub(crate) fn array<const N: usize>(&mut self) -> Result<[u8; N], MalformedMessage> {
        let (taken, rest) = self
            .rest
            .split_first_chunk()
            .ok_or(MalformedMessage::Truncated)?;
        self.rest = rest;
        Ok(*taken)
    }

    pub(crate) const fn finish(self) -> Result<(), MalformedMessage> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(MalformedMessage::TrailingBytes)
        }
    }
}

/// A field in the body of a message.
pub(crate) trait Field: Sized {
    /// Appends the field's bytes.
    fn put(&self, to: &mut Vec<u8>);

    /// Takes the field off the front.
    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage>;

    /// Takes `count` fields; the caller has checked that their bytes are present.
    fn take_all(from: &mut FieldReader<'_>, count: usize) -> Result<Vec<Self>, MalformedMessage> {
        (0..count).map(|_| Self::take(from)).collect()
    }
}

impl Field for u32 {
    fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&self.to_be_bytes());
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        from.array().map(Self::from_be_bytes)
    }
}

impl Field for f32 {
    fn put(&self, to: &mut Vec<u8>) {
        to.extend_from_slice(&self.to_be_bytes());
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        from.array().map(Self::from_be_bytes)
    }
}

impl<T: Field + Copy + Default, const N: usize> Field for [T; N] {
    fn put(&self, to: &mut Vec<u8>) {
        for value in self {
            value.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let mut values = [T::default(); N];
        for value in &mut values {
            *value = T::take(from)?;
        }
        Ok(values)
    }
}

impl Field for Vec3 {
    fn put(&self, to: &mut Vec<u8>) {
        self.to_array().put(to);
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        <[f32; 3]>::take(from).map(Self::from_array)
    }
}

impl Field for Quat {
    fn put(&self, to: &mut Vec<u8>) {
        self.to_array().put(to);
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        <[f32; 4]>::take(from).map(Self::from_array)
    }
}

/// A struct whose bytes are those of its fields, in order.
macro_rules! fields {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $field:ident: $type:ty,)+ }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            $($(#[$doc])* pub $field: $type,)+
        }

        impl $crate::codec::Field for $name {
            fn put(&self, to: &mut Vec<u8>) {
                $($crate::codec::Field::put(&self.$field, to);)+
            }

            fn take(
                from: &mut $crate::codec::FieldReader<'_>,
            ) -> Result<Self, $crate::codec::MalformedMessage> {
                Ok(Self { $($field: $crate::codec::Field::take(from)?,)+ })
            }
        }
    };
}
pub(crate) use fields;

/// Bytes that do not follow the protocol. Nothing after them can be decoded either.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MalformedMessage {
    /// The bytes end too soon.
    Truncated,
    /// The bytes continue after the end of the message.
    TrailingBytes,
    /// An unknown version.
    Version(u16),
    /// An unknown type.
    UnknownKind(u16),
    /// A length that no message of this type has.
    Length {
        /// The type in the header.
        kind: u16,
        /// The length in the header.
        bytes: u32,
    },
    /// More points, triangles or posts than allowed, or than the length provides bytes for.
    Count(u32),
    /// A text that is not UTF-8.
    Text,
}

impl fmt::Display for MalformedMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated => f.write_str("the message ends too soon"),
            Self::TrailingBytes => f.write_str("bytes follow the end of the message"),
            Self::Version(version) => write!(f, "version {version} is not supported"),
            Self::UnknownKind(kind) => write!(f, "there is no message of type {kind}"),
            Self::Length { kind, bytes } => {
                write!(f, "no message of type {kind} is {bytes} bytes long")
            }
            Self::Count(count) => write!(f, "a count of {count} does not fit the message"),
            Self::Text => f.write_str("a text is not UTF-8"),
        }
    }
}

impl core::error::Error for MalformedMessage {}

fields! {
    /// Names an actor, a shape or a joint; each kind has its own numbers.
    #[derive(Eq, PartialOrd, Ord, Hash)]
    Id {
        /// The simulation; always zero in the shape's name of `AttachShape` and `DetachShape`.
        simulation: u32,
        /// Number within its kind.
        object: u32,
    }
}

fields! {
    /// Density and surface of a shape on an actor.
    Surface {
        /// Density, kg/m³.
        density: f32,
        /// Coefficient of static friction.
        static_friction: f32,
        /// Coefficient of kinetic friction.
        kinetic_friction: f32,
        /// Share of the closing speed that is returned.
        restitution: f32,
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.simulation, self.object)
    }
}

/// Bytes of a header.
pub const HEADER_BYTES: usize = 24;
/// Bytes of one message, header included: a triangle mesh at its limits.
pub const MESSAGE_BYTES_MAX: usize = 40 + 12 * POINTS_MAX + 12 * TRIANGLES_MAX;
/// Points of a mesh, as many as triangles: a closed mesh has half as many, a set of loose triangles three times.
pub const POINTS_MAX: usize = 65_536;
/// Triangles of a mesh: by measurement, building and stepping a larger one takes more than a frame.
pub const TRIANGLES_MAX: usize = 65_536;
/// Posts of a height field: 512 by 512, twice a region of OpenSimulator in each direction.
pub const POSTS_MAX: usize = 512 * 512;
/// Bytes of the text of an error.
pub const TEXT_BYTES_MAX: usize = 256;

const _: () = assert!(48 + 4 * POSTS_MAX <= MESSAGE_BYTES_MAX);

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
