//! The messages of APP, their framing and the client's session.
//!
//! Neither clock nor socket. Decoding follows the published plug-in, its faults included; encoding stays within what
//! it accepts. Bytes from a peer cannot panic, and cannot make memory grow beyond `limits`.

mod codec;
mod fields;
mod frames;
mod header;
mod kind;
pub mod limits;
mod malformed;
mod message;
mod session;
mod shapes;

pub use fields::{Id, Surface};
pub use frames::{FramedMessage, MessageFraming};
pub use kind::Kind;
pub use limits::HEADER_BYTES;
pub use malformed::MalformedMessage;
pub use message::{
    ActorsCollided, AddJoint, ApplyForce, ApplyTorque, AttachShape, Byte, CreateDynamicActor,
    CreateStaticActor, DetachShape, ErrorReport, Grip, Logon, Message, Motion, Place, SetWorld,
    Surfacing,
};
pub(crate) use session::{Session, SessionError};
pub use shapes::{ConvexMesh, HeightGrid, TriangleMesh};
