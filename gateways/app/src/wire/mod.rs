//! The messages of APP, their framing and the client's session.
//!
//! Neither clock nor socket. Decoding follows the published plug-in, its faults included; encoding stays within what
//! it accepts. Bytes from a peer cannot panic, and cannot make memory grow beyond its limits.

mod codec;
mod frames;
mod header;
mod message;
mod shapes;

pub use codec::{
    HEADER_BYTES, Id, MESSAGE_BYTES_MAX, MalformedMessage, POINTS_MAX, POSTS_MAX, Surface,
    TEXT_BYTES_MAX, TRIANGLES_MAX,
};
pub use frames::{FramedMessage, MessageFraming};
pub(crate) use frames::{Session, SessionError};
pub use header::Kind;
pub use message::{
    ActorsCollided, AddJoint, ApplyForce, ApplyTorque, AttachShape, Byte, CreateDynamicActor,
    CreateStaticActor, DetachShape, ErrorReport, Grip, Logon, Message, Motion, Place, SetWorld,
    Surfacing,
};
pub use shapes::{ConvexMesh, HeightGrid, TriangleMesh};
