//! A gateway of the ARCHIMEDES Physics Protocol to scenes.
//!
//! OpenSimulator's RemotePhysics plug-in uses this protocol with a physics server: big-endian, control on TCP, state on
//! UDP. The book describes it (`operating/app.md`). A [`Gateway`] has a scene for each such client, joins it over the
//! client interface like any other member, and has no sockets; [`AppListener`] owns the sockets, and a thread for each
//! client. No engine and no server: the server may be in the same process or elsewhere.
#![forbid(unsafe_code)]

mod actor;
mod apply;
mod client;
mod codec;
mod datagram_sender;
mod gateway;
mod listener;
mod message;
mod scene;
mod send_queue;
mod shape_definition;
mod state_reporter;
mod world_mirror;

pub use client::AppClient;
pub use codec::{
    HEADER_BYTES, Id, Kind, MESSAGE_BYTES_MAX, MalformedMessage, POINTS_MAX, POSTS_MAX, Surface,
    TEXT_BYTES_MAX, TRIANGLES_MAX,
};
pub use gateway::{AppOptions, Datagrams, Gateway, States, TimeAdvanced};
pub use listener::{AppBindError, AppListen, AppListener};
pub use message::{
    ActorsCollided, AddJoint, ApplyForce, ApplyTorque, AttachShape, Byte, ConvexMesh,
    CreateDynamicActor, CreateStaticActor, DetachShape, ErrorReport, FramedMessage, Grip,
    HeightGrid, Logon, Message, MessageFraming, Motion, Place, SetWorld, Surfacing, TriangleMesh,
};
pub use send_queue::{AppDatagram, AppTransmit, CoalescingKey, Urgency};
