//! Every message there is, in both directions.
//!
//! Numbers are handed on as they came: whether they are finite and in range is decided where they are used.

use alloc::string::String;
use alloc::vec::Vec;

use glam::{Quat, Vec3};

use crate::fields::{Id, Surface};
use crate::header::{HEADER_BYTES, Header};
use crate::kind::Kind;
use crate::limits::TEXT_BYTES_MAX;
use crate::malformed::Malformed;
use crate::shapes::{ConvexMesh, Heights, TriangleMesh};
use crate::wire::{Field, Reader, fields};

fields! {
    /// Who logs on. Of the name the published plug-in sends two characters as UTF-16.
    Logon {
        /// The simulation.
        simulation: u32,
        /// Padded with zeros.
        name: [Byte; 48],
    }
}

fields! {
    /// Gravity and a plane below everything.
    SetWorld {
        /// The plane's actor.
        plane: Id,
        /// m/s².
        gravity: Vec3,
        /// Of the plane.
        static_friction: f32,
        /// Of the plane.
        kinetic_friction: f32,
        /// Of the plane; the published plug-in puts the collision margin here.
        restitution: f32,
        /// Metres; the published plug-in puts the restitution here.
        margin: f32,
        /// Metres along the normal.
        height: f32,
        /// Unit vector.
        normal: Vec3,
    }
}

fields! {
    /// An actor that does not move.
    CreateStaticActor {
        /// Its name.
        actor: Id,
        /// Metres.
        position: Vec3,
        /// Actor → world.
        rotation: Quat,
        /// Zero from the published plug-in, whatever it means.
        flags: u32,
    }
}

fields! {
    /// An actor that moves.
    CreateDynamicActor {
        /// Where it is, and how it moves.
        motion: Motion,
        /// Bit 0: collisions are to be reported.
        flags: u32,
    }
}

fields! {
    /// Where an actor stands.
    Place {
        /// Which.
        actor: Id,
        /// Metres.
        position: Vec3,
        /// Actor → world.
        rotation: Quat,
    }
}

fields! {
    /// Where an actor is, and how it moves.
    Motion {
        /// Which.
        actor: Id,
        /// Metres.
        position: Vec3,
        /// Actor → world.
        rotation: Quat,
        /// Factor on gravity.
        gravity_modifier: f32,
        /// m/s.
        linear: Vec3,
        /// rad/s.
        angular: Vec3,
    }
}

fields! {
    /// Holds two actors together; a second one that does not exist is the world.
    AddJoint {
        /// The joint's name.
        joint: Id,
        /// First.
        first: Grip,
        /// Second.
        second: Grip,
        /// Least way along x, y, z, metres; above the most: free.
        linear_lower: Vec3,
        /// Most.
        linear_upper: Vec3,
        /// Least turn about x, y, z, radians; above the most: free.
        angular_lower: Vec3,
        /// Most.
        angular_upper: Vec3,
    }
}

fields! {
    /// Where a joint sits in an actor.
    Grip {
        /// Which.
        actor: Id,
        /// Frame → actor.
        rotation: Quat,
        /// Metres, in the actor's axes.
        anchor: Vec3,
    }
}

fields! {
    /// Puts a shape on an actor.
    AttachShape {
        /// Which actor.
        actor: Id,
        /// Which shape; its simulation is zero.
        shape: Id,
        /// What it is made of.
        surface: Surface,
        /// Shape → actor.
        rotation: Quat,
        /// Metres, in the actor's axes.
        position: Vec3,
    }
}

fields! {
    /// What a shape on an actor is made of from now on.
    Surfacing {
        /// Which actor.
        actor: Id,
        /// Which shape.
        shape: Id,
        /// What.
        surface: Surface,
    }
}

fields! {
    /// Takes a shape off an actor.
    DetachShape {
        /// Which actor.
        actor: Id,
        /// Which shape; its simulation is zero.
        shape: Id,
    }
}

fields! {
    /// Two actors touch.
    ActorsCollided {
        /// Who asked to be told.
        colliding: Id,
        /// The other.
        collided: Id,
        /// Metres, world.
        point: Vec3,
        /// From the other towards who asked, unit, world.
        normal: Vec3,
        /// Metres; negative: they overlap.
        separation: f32,
    }
}

fields! {
    /// Pushes an actor.
    ApplyForce {
        /// Which.
        actor: Id,
        /// N, world.
        force: Vec3,
    }
}

fields! {
    /// Turns an actor.
    ApplyTorque {
        /// Which.
        actor: Id,
        /// N·m, world.
        torque: Vec3,
    }
}

/// Something was wrong with a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorReport {
    /// The message's index, as it came.
    pub index: u32,
    /// What was wrong. Of more than 256 bytes the first are said.
    pub text: String,
}

/// A byte of a name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Byte(pub u8);

impl Field for Byte {
    fn put(&self, to: &mut Vec<u8>) {
        to.push(self.0);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        from.array().map(|[byte]| Self(byte))
    }
}

impl Logon {
    /// Of a simulation with a name of which the first 48 bytes are said.
    #[must_use]
    pub fn new(simulation: u32, name: &str) -> Self {
        let mut bytes = [Byte(0); 48];
        for (to, from) in bytes.iter_mut().zip(name.bytes()) {
            *to = Byte(from);
        }
        Self {
            simulation,
            name: bytes,
        }
    }
}

impl Field for ErrorReport {
    fn put(&self, to: &mut Vec<u8>) {
        self.index.put(to);
        let mut end = self.text.len().min(TEXT_BYTES_MAX);
        while !self.text.is_char_boundary(end) {
            end -= 1;
        }
        to.extend_from_slice(&self.text.as_bytes()[..end]);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let index = u32::take(from)?;
        let bytes = from.raw(from.left())?;
        let text = core::str::from_utf8(bytes).map_err(|_| Malformed::Text)?;
        let text = text.into();
        Ok(Self { index, text })
    }
}

macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident($type:ty),)+) => {
        /// What either end says.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Message {
            $($(#[$doc])* $name($type),)+
        }

        impl Message {
            /// Its type.
            #[must_use]
            pub const fn kind(&self) -> Kind {
                match self {
                    $(Self::$name(_) => Kind::$name,)+
                }
            }

            fn put(&self, to: &mut Vec<u8>) {
                match self {
                    $(Self::$name(body) => body.put(to),)+
                }
            }

            fn take(kind: Kind, from: &mut Reader<'_>) -> Result<Self, Malformed> {
                Ok(match kind {
                    $(Kind::$name => Self::$name(<$type>::take(from)?),)+
                })
            }
        }
    };
}

/// Two fields in a row.
impl<A: Field, B: Field> Field for (A, B) {
    fn put(&self, to: &mut Vec<u8>) {
        self.0.put(to);
        self.1.put(to);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok((A::take(from)?, B::take(from)?))
    }
}

/// Three fields in a row.
impl<A: Field, B: Field, C: Field> Field for (A, B, C) {
    fn put(&self, to: &mut Vec<u8>) {
        self.0.put(to);
        self.1.put(to);
        self.2.put(to);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        Ok((A::take(from)?, B::take(from)?, C::take(from)?))
    }
}

messages! {
    /// Something was wrong with a message.
    Error(ErrorReport),
    /// A client is there.
    Logon(Logon),
    /// It is taken in: its simulation.
    LogonReady(u32),
    /// It is gone: its simulation.
    Logoff(u32),
    /// So many seconds shall pass in a simulation.
    AdvanceTime((u32, f32)),
    /// They have passed in it.
    TimeAdvanced(u32),
    /// Gravity and the ground plane.
    SetWorld(SetWorld),
    /// An actor that does not move.
    CreateStaticActor(CreateStaticActor),
    /// An actor that moves.
    CreateDynamicActor(CreateDynamicActor),
    /// Where an actor stands.
    SetStaticActor(Place),
    /// Where an actor is, and how it moves: the state.
    SetDynamicActor(Motion),
    /// Puts an actor elsewhere: metres.
    UpdateActorPosition((Id, Vec3)),
    /// Turns an actor: actor → world.
    UpdateActorOrientation((Id, Quat)),
    /// Factor on gravity for an actor.
    UpdateGravityModifier((Id, f32)),
    /// Sets an actor going: m/s.
    UpdateLinearVelocity((Id, Vec3)),
    /// Sets an actor spinning: rad/s.
    UpdateAngularVelocity((Id, Vec3)),
    /// The mass of an actor: kg.
    UpdateMass((Id, f32)),
    /// Asks for it.
    GetMass(Id),
    /// Takes an actor out.
    RemoveActor(Id),
    /// Holds two actors together, or one to the world.
    AddJoint(AddJoint),
    /// Lets go.
    RemoveJoint(Id),
    /// A ball: its name, its middle, its radius in metres.
    AddSphere((Id, Vec3, f32)),
    /// A plane: its name, a constant, and a normal, which the published plug-in leaves zero.
    AddPlane((Id, f32, Vec3)),
    /// A capsule along x: its name, radius and height in metres.
    AddCapsule((Id, f32, f32)),
    /// A box: its name and its edges in metres.
    AddBox((Id, Vec3)),
    /// The hull of some points.
    AddConvexMesh(ConvexMesh),
    /// A mesh of triangles.
    AddTriangleMesh(TriangleMesh),
    /// A field of heights.
    AddHeightField(Heights),
    /// Forgets a shape.
    RemoveShape(Id),
    /// Puts a shape on an actor.
    AttachShape(AttachShape),
    /// What a shape on an actor is made of.
    UpdateShapeMaterial(Surfacing),
    /// Takes a shape off an actor.
    DetachShape(DetachShape),
    /// Two actors touch.
    ActorsCollided(ActorsCollided),
    /// Pushes an actor.
    ApplyForce(ApplyForce),
    /// Turns an actor.
    ApplyTorque(ApplyTorque),
}

impl Message {
    /// Appends the message with its header. `index`: the sender's counter; the published plug-in writes sixteen bits into
    /// the upper half.
    pub fn encode(&self, index: u32, to: &mut Vec<u8>) {
        let start = to.len();
        let kind = self.kind();
        Header {
            kind,
            index,
            length: 0,
        }
        .put(to);
        self.put(to);
        let length = (to.len() - start) as u32;
        to[start + LENGTH_AT..start + LENGTH_AT + 4].copy_from_slice(&length.to_be_bytes());
    }

    /// Reads the body of a message.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when it is shorter or longer than what it says.
    pub fn decode(kind: Kind, body: &[u8]) -> Result<Self, Malformed> {
        let mut reader = Reader::new(body);
        let message = Self::take(kind, &mut reader)?;
        reader.finish()?;
        Ok(message)
    }

    /// Reads the first message of a datagram; what follows it is nobody's.
    ///
    /// # Errors
    ///
    /// [`Malformed`] when it does not begin with a whole message.
    pub fn from_datagram(datagram: &[u8]) -> Result<Self, Malformed> {
        let mut reader = Reader::new(datagram);
        let header = Header::take(&mut reader)?;
        let body = reader.raw(header.length - HEADER_BYTES)?;
        Self::decode(header.kind, body)
    }
}

/// Where a header says the length.
const LENGTH_AT: usize = 8;
