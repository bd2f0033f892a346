//! Server of APP clients (the book, `operating/app.md`), without sockets.
//!
//! Each client owns a scene of its host, which members of that host may subscribe to: same engine, same checks, same
//! containment.

mod actor;
mod app_server;
mod apply;
mod body_ids;
mod body_properties;
mod client;
mod depenetration;
mod frame_clock;
mod host;
mod hull;
mod joint;
mod options;
mod refusal;
mod send_queue;
mod shape_cache;
mod shape_definition;
mod state_reporter;
mod subject;
mod transmit;
mod world_mirror;

pub use app_server::AppServer;
pub use host::{AppHost, AppScene, Bulk, Geometry};
pub use options::{AppOptions, Datagrams, States, TimeAdvanced};
pub use subject::{DatagramSubject, Urgency};
pub use transmit::{AppDatagram, AppTransmit};
