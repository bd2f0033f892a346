//! The messages of APP, their framing and the client's session.
//!
//! Neither clock nor socket. Decoding follows the published plug-in, its faults included; encoding stays within what
//! it accepts. Bytes from a peer cannot panic, and cannot make memory grow beyond its limits.

mod codec;
mod message;

pub use codec::{
    HEADER_BYTES, Id, Kind, MESSAGE_BYTES_MAX, MalformedMessage, POINTS_MAX, POSTS_MAX, Surface,
    TEXT_BYTES_MAX, TRIANGLES_MAX,
};
pub use message::{
    ActorsCollided, AddJoint, ApplyForce, ApplyTorque, AttachShape, Byte, ConvexMesh,
    CreateDynamicActor, CreateStaticActor, DetachShape, ErrorReport, FramedMessage, Grip,
    HeightGrid, Logon, Message, MessageFraming, Motion, Place, SetWorld, Surfacing, TriangleMesh,
};
pub(crate) use message::{Session, SessionError};
