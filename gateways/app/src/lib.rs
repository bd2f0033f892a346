//! A gateway of the ARCHIMEDES Physics Protocol to scenes.
//!
//! OpenSimulator's RemotePhysics plug-in uses this protocol with a physics server: big-endian, control on TCP, state
//! on UDP. A [`Gateway`] has a scene for each such client, and is a member of it like any other; [`AppListener`] owns the
//! sockets, and a thread for each client. No engine and no server: the server may be in the same process or elsewhere.
#![forbid(unsafe_code)]

mod server;
mod sockets;
mod wire;

pub use server::{
    AppClient, AppDatagram, AppOptions, AppTransmit, CoalescingKey, Datagrams, Gateway, States,
    TimeAdvanced, Urgency,
};
pub use sockets::{AppBindError, AppListen, AppListener};
pub use wire::*;
