//! Server of APP clients (the book, `operating/app.md`), without sockets.
//!
//! Each client owns a scene of its host, which members of that host may subscribe to: same engine, same checks, same
//! containment.

mod actor;
mod app_server;
mod apply;
mod client;
mod host;
mod joint;
mod send_queue;
mod shape_definition;
mod state_reporter;
mod world_mirror;

pub use app_server::AppServer;
pub use host::{AppHost, AppOptions, AppScene, Bulk, Datagrams, Geometry, States, TimeAdvanced};
pub use send_queue::{AppDatagram, AppTransmit, CoalescingKey, Urgency};
