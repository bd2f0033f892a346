//! The fuzz targets and their kept inputs.
//!
//! Each target accepts arbitrary bytes and panics if a promise is broken. The program `fuzz` calls the
//! same functions as the test that replays the kept inputs, so this code builds with the normal compiler.

mod app;
mod client_session;
mod commands;
mod control_messages;
mod control_script;
mod dis;
pub mod inputs;
mod link;
mod packets;
mod payloads;
mod reckoning;
mod recordings;
mod repair_symbols;
mod scene_commands;
mod scene_files;
mod script;
mod source;
mod subscriber;
mod target;
mod targets;
mod upstream;
mod walking;

pub use app::{app_messages, app_scene};
pub use client_session::client_session;
pub use commands::random_commands;
pub use control_messages::{client_messages, server_messages};
pub use control_script::{assert_peer_code, control_script};
pub use dis::dis_datagrams;
pub use link::link;
pub use packets::{side_packets, state_packets};
pub use reckoning::{prefilter, quantiser};
pub use recordings::recordings;
pub use repair_symbols::repair_symbols;
pub use scene_commands::scene_commands;
pub use scene_files::{mesh_files, scene_files};
pub use subscriber::subscriber;
pub use target::Target;
pub use targets::{TARGETS, target};
pub use upstream::upstream;
