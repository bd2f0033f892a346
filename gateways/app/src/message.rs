//! All messages, in both directions, and their framing for a client's session.
//!
//! Numbers are passed on as received: their users check whether they are finite and in range. Counts of points are
//! checked against the present bytes before anything is allocated; the solid's builder checks that indices name points.
//!
//! The published plug-in sends torques without a header: 24 zero bytes, then 20 of body. Such bytes are decoded as a
//! torque: a length of zero would lose the stream.
//!
//! A client logs on once, with its first message, and off with its last. The logon names its simulation; names in
//! later messages count as of that simulation, since some of them have simulation zero.

use core::fmt;

use glam::{Quat, Vec3};

use crate::codec::{
    Field, FieldReader, HEADER_BYTES, Header, Id, Kind, MalformedMessage, POINTS_MAX, POSTS_MAX,
    Surface, TEXT_BYTES_MAX, TRIANGLES_MAX, fields,
};

fields! {
    /// Logs a client on. The published plug-in sends only two characters of its name, as UTF-16.
    Logon {
        /// The simulation.
        simulation: u32,
        /// Padded with zeros.
        name: [Byte; 48],
    }
}

fields! {
    /// Sets gravity and a ground plane.
    SetWorld {
        /// The plane's actor.
        plane: Id,
        /// m/s².
        gravity: Vec3,
        /// Coefficient of the plane.
        static_friction: f32,
        /// Coefficient of the plane.
        kinetic_friction: f32,
        /// Restitution of the plane; the published plug-in sends the collision margin here.
        restitution: f32,
        /// Metres; the published plug-in sends the restitution here.
        margin: f32,
        /// Metres along the normal.
        height: f32,
        /// Unit vector.
        normal: Vec3,
    }
}

fields! {
    /// Creates an actor that does not move.
    CreateStaticActor {
        /// Its name.
        actor: Id,
        /// Metres.
        position: Vec3,
        /// Actor → world.
        rotation: Quat,
        /// Zero from the published plug-in; no meaning is known.
        flags: u32,
    }
}

fields! {
    /// Creates an actor that moves.
    CreateDynamicActor {
        /// Pose and velocities.
        motion: Motion,
        /// Bit 0: collisions are to be reported.
        flags: u32,
    }
}

fields! {
    /// Pose of an actor.
    Place {
        /// The actor.
        actor: Id,
        /// Metres.
        position: Vec3,
        /// Actor → world.
        rotation: Quat,
    }
}

fields! {
    /// Pose and velocities of an actor.
    Motion {
        /// The actor.
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
    /// Joins two actors; if the second one does not exist, joins the first to the world.
    AddJoint {
        /// The joint's name.
        joint: Id,
        /// First actor.
        first: Grip,
        /// Second actor.
        second: Grip,
        /// Least offset along x, y, z, metres; an axis whose least exceeds its greatest is free.
        linear_lower: Vec3,
        /// Greatest offset, metres.
        linear_upper: Vec3,
        /// Least turn about x, y, z, radians; an axis whose least exceeds its greatest is free.
        angular_lower: Vec3,
        /// Greatest turn, radians.
        angular_upper: Vec3,
    }
}

fields! {
    /// Frame of a joint in an actor.
    Grip {
        /// The actor.
        actor: Id,
        /// Frame → actor.
        rotation: Quat,
        /// Metres, in the actor's axes.
        anchor: Vec3,
    }
}

fields! {
    /// Attaches a shape to an actor.
    AttachShape {
        /// The actor.
        actor: Id,
        /// The shape; its simulation is zero.
        shape: Id,
        /// Its density and surface.
        surface: Surface,
        /// Shape → actor.
        rotation: Quat,
        /// Metres, in the actor's axes.
        position: Vec3,
    }
}

fields! {
    /// Sets density and surface of a shape on an actor.
    Surfacing {
        /// The actor.
        actor: Id,
        /// The shape.
        shape: Id,
        /// Its new density and surface.
        surface: Surface,
    }
}

fields! {
    /// Detaches a shape from an actor.
    DetachShape {
        /// The actor.
        actor: Id,
        /// The shape; its simulation is zero.
        shape: Id,
    }
}

fields! {
    /// Two actors touch.
    ActorsCollided {
        /// The actor whose collisions are reported.
        colliding: Id,
        /// The other actor.
        collided: Id,
        /// Point of contact, metres, world.
        point: Vec3,
        /// Normal from the other actor towards the reported one, unit, world.
        normal: Vec3,
        /// Separation, metres; negative: they overlap.
        separation: f32,
    }
}

fields! {
    /// Applies a force to an actor.
    ApplyForce {
        /// The actor.
        actor: Id,
        /// N, world.
        force: Vec3,
    }
}

fields! {
    /// Applies a torque to an actor.
    ApplyTorque {
        /// The actor.
        actor: Id,
        /// N·m, world.
        torque: Vec3,
    }
}

/// Reports a faulty message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorReport {
    /// The message's index, as received.
    pub index: u32,
    /// The fault. Only the first 256 bytes are encoded.
    pub text: String,
}

/// A byte of a name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Byte(pub u8);

impl Field for Byte {
    fn put(&self, to: &mut Vec<u8>) {
        to.push(self.0);
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        from.array().map(|[byte]| Self(byte))
    }
}

impl Logon {
    /// A logon of a simulation; only the first 48 bytes of the name are encoded.
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

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let index = u32::take(from)?;
        let bytes = from.raw(from.left())?;
        let text = core::str::from_utf8(bytes).map_err(|_| MalformedMessage::Text)?;
        let text = text.into();
        Ok(Self { index, text })
    }
}

macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident($type:ty),)+) => {
        /// A message of either end.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Message {
            $($(#[$doc])* $name($type),)+
        }

        impl Message {
            /// The message's type.
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

            fn take(kind: Kind, from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
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

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
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

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        Ok((A::take(from)?, B::take(from)?, C::take(from)?))
    }
}

messages! {
    /// Reports a faulty message.
    Error(ErrorReport),
    /// Logs a client on.
    Logon(Logon),
    /// Accepts a client: its simulation.
    LogonReady(u32),
    /// Logs a client off: its simulation.
    Logoff(u32),
    /// Asks to advance time: simulation and seconds.
    AdvanceTime((u32, f32)),
    /// Reports that time was advanced: the simulation.
    TimeAdvanced(u32),
    /// Gravity and the ground plane.
    SetWorld(SetWorld),
    /// Creates an actor that does not move.
    CreateStaticActor(CreateStaticActor),
    /// Creates an actor that moves.
    CreateDynamicActor(CreateDynamicActor),
    /// Sets the pose of a static actor.
    SetStaticActor(Place),
    /// Pose and velocities of an actor: its state.
    SetDynamicActor(Motion),
    /// Sets an actor's position: metres.
    UpdateActorPosition((Id, Vec3)),
    /// Sets an actor's orientation: actor → world.
    UpdateActorOrientation((Id, Quat)),
    /// Sets an actor's factor on gravity.
    UpdateGravityModifier((Id, f32)),
    /// Sets an actor's linear velocity: m/s.
    UpdateLinearVelocity((Id, Vec3)),
    /// Sets an actor's angular velocity: rad/s.
    UpdateAngularVelocity((Id, Vec3)),
    /// The mass of an actor: kg.
    UpdateMass((Id, f32)),
    /// Asks for the mass of an actor.
    GetMass(Id),
    /// Removes an actor.
    RemoveActor(Id),
    /// Joins two actors, or one to the world.
    AddJoint(AddJoint),
    /// Removes a joint.
    RemoveJoint(Id),
    /// A ball: its name, its centre, its radius in metres.
    AddSphere((Id, Vec3, f32)),
    /// A plane: its name, a constant, and a normal, which the published plug-in leaves zero.
    AddPlane((Id, f32, Vec3)),
    /// A capsule along x: its name, radius and height in metres.
    AddCapsule((Id, f32, f32)),
    /// A box: its name and its edges in metres.
    AddBox((Id, Vec3)),
    /// The convex hull of points.
    AddConvexMesh(ConvexMesh),
    /// A mesh of triangles.
    AddTriangleMesh(TriangleMesh),
    /// A height field.
    AddHeightField(HeightGrid),
    /// Removes the definition of a shape.
    RemoveShape(Id),
    /// Attaches a shape to an actor.
    AttachShape(AttachShape),
    /// Sets density and surface of a shape on an actor.
    UpdateShapeMaterial(Surfacing),
    /// Detaches a shape from an actor.
    DetachShape(DetachShape),
    /// Two actors touch.
    ActorsCollided(ActorsCollided),
    /// Applies a force to an actor.
    ApplyForce(ApplyForce),
    /// Applies a torque to an actor.
    ApplyTorque(ApplyTorque),
}

impl Message {
    /// Appends the message with its header. `index`: the sender's counter; the published plug-in writes it to the
    /// upper sixteen bits.
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

    /// Decodes the body of a message.
    ///
    /// # Errors
    ///
    /// [`MalformedMessage`] when the body is shorter or longer than its content.
    pub fn decode(kind: Kind, body: &[u8]) -> Result<Self, MalformedMessage> {
        let mut reader = FieldReader::new(body);
        let message = Self::take(kind, &mut reader)?;
        reader.finish()?;
        Ok(message)
    }

    /// Decodes the first message of a datagram; the bytes after it are ignored.
    ///
    /// # Errors
    ///
    /// [`MalformedMessage`] when the datagram does not start with a whole message.
    pub fn from_datagram(datagram: &[u8]) -> Result<Self, MalformedMessage> {
        let mut reader = FieldReader::new(datagram);
        let header = Header::take(&mut reader)?;
        let body = reader.raw(header.length - HEADER_BYTES)?;
        Self::decode(header.kind, body)
    }
}

/// Offset of the length in a header.
const LENGTH_AT: usize = 8;

/// The convex hull of points.
#[derive(Clone, Debug, PartialEq)]
pub struct ConvexMesh {
    /// The shape's name.
    pub shape: Id,
    /// Metres, in the shape's axes.
    pub points: Vec<Vec3>,
}

/// A mesh of triangles.
#[derive(Clone, Debug, PartialEq)]
pub struct TriangleMesh {
    /// The shape's name.
    pub shape: Id,
    /// Metres, in the shape's axes.
    pub points: Vec<Vec3>,
    /// Three point indices each.
    pub triangles: Vec<[u32; 3]>,
}

/// A height field: row r and column c are at x = r · row spacing, y = the height, z = c · column spacing.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightGrid {
    /// The shape's name.
    pub shape: Id,
    /// Number of rows.
    pub rows: u32,
    /// Number of columns.
    pub columns: u32,
    /// Distance between rows, metres.
    pub row_spacing: f32,
    /// Distance between columns, metres.
    pub column_spacing: f32,
    /// Heights, metres, row by row.
    pub heights: Vec<f32>,
}

/// A count of items of this size, checked against the present bytes.
fn checked(
    count: u32,
    most: usize,
    bytes_each: usize,
    from: &FieldReader<'_>,
) -> Result<usize, MalformedMessage> {
    let counted = count as usize;
    if counted > most {
        return Err(MalformedMessage::Count(count));
    }
    if counted * bytes_each > from.left() {
        return Err(MalformedMessage::Truncated);
    }
    Ok(counted)
}

impl Field for ConvexMesh {
    fn put(&self, to: &mut Vec<u8>) {
        self.shape.put(to);
        (self.points.len() as u32).put(to);
        for point in &self.points {
            point.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let shape = Id::take(from)?;
        let points = u32::take(from)?;
        let points = checked(points, POINTS_MAX, 12, from)?;
        let points = Vec3::take_all(from, points)?;
        Ok(Self { shape, points })
    }
}

impl Field for TriangleMesh {
    fn put(&self, to: &mut Vec<u8>) {
        self.shape.put(to);
        (self.points.len() as u32).put(to);
        (self.triangles.len() as u32).put(to);
        for point in &self.points {
            point.put(to);
        }
        for triangle in &self.triangles {
            triangle.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let shape = Id::take(from)?;
        let points = u32::take(from)?;
        let triangles = u32::take(from)?;
        let points = checked(points, POINTS_MAX, 12, from)?;
        let points = Vec3::take_all(from, points)?;
        let triangles = checked(triangles, TRIANGLES_MAX, 12, from)?;
        let triangles = <[u32; 3]>::take_all(from, triangles)?;
        Ok(Self {
            shape,
            points,
            triangles,
        })
    }
}

impl Field for HeightGrid {
    fn put(&self, to: &mut Vec<u8>) {
        self.shape.put(to);
        self.rows.put(to);
        self.columns.put(to);
        self.row_spacing.put(to);
        self.column_spacing.put(to);
        for height in &self.heights {
            height.put(to);
        }
    }

    fn take(from: &mut FieldReader<'_>) -> Result<Self, MalformedMessage> {
        let shape = Id::take(from)?;
        let (rows, columns) = (u32::take(from)?, u32::take(from)?);
        let (row_spacing, column_spacing) = (f32::take(from)?, f32::take(from)?);
        let posts = rows
            .checked_mul(columns)
            .ok_or(MalformedMessage::Count(rows))?;
        let posts = checked(posts, POSTS_MAX, 4, from)?;
        let heights = f32::take_all(from, posts)?;
        Ok(Self {
            shape,
            rows,
            columns,
            row_spacing,
            column_spacing,
            heights,
        })
    }
}

/// A message, with its sender's counter.
#[derive(Clone, Debug, PartialEq)]
pub struct FramedMessage {
    /// The counter, as received.
    pub index: u32,
    /// The message.
    pub message: Message,
}

/// Splits a stream of bytes into messages. Holds at most one unfinished message and the bytes received with it.
#[derive(Debug, Default)]
pub struct MessageFraming {
    buffer: Vec<u8>,
    /// Bytes at the front of the buffer that are decoded already.
    taken: usize,
}

impl MessageFraming {
    /// Appends the next bytes of the stream, cut at any place.
    pub fn push(&mut self, bytes: &[u8]) {
        if self.taken > 0 {
            self.buffer.drain(..self.taken);
            self.taken = 0;
        }
        self.buffer.extend_from_slice(bytes);
    }

    /// The next whole message, or `None` until more bytes come.
    ///
    /// # Errors
    ///
    /// [`MalformedMessage`] when the front cannot be a message; nothing after it can be decoded either.
    pub fn next_message(&mut self) -> Result<Option<FramedMessage>, MalformedMessage> {
        let front = &self.buffer[self.taken..];
        let Some(head) = front.first_chunk::<HEADER_BYTES>() else {
            return Ok(None);
        };
        let header = if *head == [0; HEADER_BYTES] {
            Header {
                kind: Kind::ApplyTorque,
                index: 0,
                length: TORQUE_BYTES,
            }
        } else {
            Header::take(&mut FieldReader::new(head))?
        };
        let Some(body) = front.get(HEADER_BYTES..header.length) else {
            return Ok(None);
        };
        let message = Message::decode(header.kind, body)?;
        self.taken += header.length;
        Ok(Some(FramedMessage {
            index: header.index,
            message,
        }))
    }
}

/// Bytes of a torque, header included.
const TORQUE_BYTES: usize = HEADER_BYTES + 20;

/// Progress of a session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum SessionPhase {
    /// No message yet.
    #[default]
    Silent,
    /// Logged on.
    Active,
    /// Logged off, or failed.
    Over,
}

/// The server's end of a session.
#[derive(Debug, Default)]
pub(crate) struct Session {
    frames: MessageFraming,
    state: SessionPhase,
}

/// Reason for which a session ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum SessionError {
    /// The bytes are not a message.
    Malformed(MalformedMessage),
    /// The client sent another message before its logon.
    NotLoggedOn,
    /// The client logged on twice.
    LoggedOnTwice,
    /// The client sent a message that only servers send.
    ServersWord,
}

impl fmt::Display for SessionError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Malformed(malformed) => malformed.fmt(f),
            Self::NotLoggedOn => f.write_str("the first message was not a logon"),
            Self::LoggedOnTwice => f.write_str("the client logged on twice"),
            Self::ServersWord => f.write_str("the client sent a message that only servers send"),
        }
    }
}

impl core::error::Error for SessionError {}

impl Session {
    /// Appends the next bytes of the connection, cut at any place.
    pub(crate) fn handle_bytes(&mut self, bytes: &[u8]) {
        if self.state != SessionPhase::Over {
            self.frames.push(bytes);
        }
    }

    /// The next message that is allowed; `None` after a logoff.
    ///
    /// # Errors
    ///
    /// [`SessionError`] when the session cannot continue; from then on it accepts nothing.
    pub(crate) fn poll_message(&mut self) -> Result<Option<FramedMessage>, SessionError> {
        if self.state == SessionPhase::Over {
            return Ok(None);
        }
        let next = self.frames.next_message().map_err(SessionError::Malformed);
        let checked = next.and_then(|framed| match framed {
            Some(framed) => self.admit(&framed.message).map(|()| Some(framed)),
            None => Ok(None),
        });
        if checked.is_err() {
            self.end();
        }
        checked
    }

    fn admit(&mut self, message: &Message) -> Result<(), SessionError> {
        match (self.state, message) {
            (SessionPhase::Silent, Message::Logon(_)) => self.state = SessionPhase::Active,
            (SessionPhase::Silent, _) => return Err(SessionError::NotLoggedOn),
            (_, Message::Logon(_)) => return Err(SessionError::LoggedOnTwice),
            (
                _,
                Message::Error(_)
                | Message::LogonReady(_)
                | Message::TimeAdvanced(_)
                | Message::UpdateMass(_)
                | Message::ActorsCollided(_),
            ) => return Err(SessionError::ServersWord),
            (_, Message::Logoff(_)) => self.end(),
            _ => {}
        }
        Ok(())
    }

    fn end(&mut self) {
        self.state = SessionPhase::Over;
        self.frames = MessageFraming::default();
    }
}
