//! The ARCHIMEDES Physics Protocol: messages, framing, who may say what.
//!
//! The protocol by which OpenSimulator's RemotePhysics plug-in speaks to a physics server: big-endian, control on TCP,
//! state on UDP. No clock, no socket, no engine. It is read as the published plug-in writes it, its faults included, and
//! written as that plug-in can bear it. Bytes from a peer cannot panic, and cannot make memory grow beyond `limits`.
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
pub use frames::{Framed, Frames};
pub use header::{HEADER_BYTES, Header};
pub use kind::Kind;
pub use malformed::Malformed;
pub use message::{
    ActorsCollided, AddJoint, ApplyForce, ApplyTorque, AttachShape, Byte, CreateDynamicActor,
    CreateStaticActor, DetachShape, ErrorReport, Grip, Logon, Message, Motion, Place, SetWorld,
    Surfacing,
};
pub use session::{Session, SessionError};
pub use shapes::{ConvexMesh, Heights, TriangleMesh};
