//! The ARCHIMEDES Physics Protocol: messages, framing, sessions.
//!
//! OpenSimulator's RemotePhysics plug-in uses this protocol with a physics server: big-endian, control on TCP, state
//! on UDP. No clock, no socket, no engine. Decoding follows the published plug-in, its faults included; encoding stays
//! within what it accepts. Bytes from a peer cannot panic, and cannot make memory grow beyond `limits`.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

mod fields;
mod frames;
mod header;
mod kind;
pub mod limits;
mod malformed;
mod message;
mod session;
mod shapes;
mod wire;

pub use fields::{Id, Surface};
pub use frames::{FramedMessage, MessageFraming};
pub use header::Header;
pub use kind::Kind;
pub use limits::HEADER_BYTES;
pub use malformed::MalformedMessage;
pub use message::{
    ActorsCollided, AddJoint, ApplyForce, ApplyTorque, AttachShape, Byte, CreateDynamicActor,
    CreateStaticActor, DetachShape, ErrorReport, Grip, Logon, Message, Motion, Place, SetWorld,
    Surfacing,
};
pub use session::{Session, SessionError};
pub use shapes::{ConvexMesh, HeightGrid, TriangleMesh};
