//! The ARCHIMEDES Physics Protocol: its messages, its sockets, and its server.
//!
//! OpenSimulator's RemotePhysics plug-in uses this protocol with a physics server: big-endian, control on TCP, state
//! on UDP. [`AppServer`] serves such clients with scenes of an [`AppHost`]; [`AppListener`] owns the sockets. No engine
//! and no other server: the host has them.
#![forbid(unsafe_code)]

mod server;
mod sockets;
mod wire;

pub use server::{
    AppDatagram, AppHost, AppOptions, AppScene, AppServer, AppTransmit, Bulk, CoalescingKey,
    Datagrams, Geometry, States, TimeAdvanced, Urgency,
};
pub use sockets::{AppBindError, AppListen, AppListener};
pub use wire::*;
