//! A gateway of APP clients to scenes, without sockets.
//!
//! The book describes it (`operating/app.md`). Each client has a scene of its own, which it joins over the client
//! interface, and which others may join: same server, same checks, same containment.

mod actor;
mod apply;
mod client;
mod gateway;
mod joint;
mod options;
mod scene;
mod send_queue;
mod shape_definition;
mod state_reporter;
mod world_mirror;

pub use client::AppClient;
pub use gateway::Gateway;
pub use options::{AppOptions, Datagrams, States, TimeAdvanced};
pub use send_queue::{AppDatagram, AppTransmit, CoalescingKey, Urgency};
