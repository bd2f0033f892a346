//! The fuzz targets and their kept inputs.
//!
//! Each target accepts arbitrary bytes and panics if a promise is broken. The fuzzers of `fuzz/` call the same
//! functions as the test that replays the kept inputs, so this code builds with the normal compiler.

mod app;
mod client_session;
mod commands;
mod control_messages;
mod control_script;
pub mod inputs;
mod link;
mod packets;
mod payloads;
mod reckoning;
mod recordings;
mod repair_symbols;
mod scene_commands;
mod script;
mod source;
mod subscriber;
mod upstream;

pub use app::{app_messages, app_scene};
pub use client_session::client_session;
pub use control_messages::{client_messages, server_messages};
pub use control_script::control_script;
pub use link::link;
pub use packets::{side_packets, state_packets};
pub use reckoning::{prefilter, quantiser};
pub use recordings::recordings;
pub use repair_symbols::repair_symbols;
pub use scene_commands::scene_commands;
pub use subscriber::subscriber;
pub use upstream::upstream;

/// A fuzz target.
#[derive(Clone, Copy, Debug)]
pub struct Target {
    /// Its name, here and in `fuzz/`.
    pub name: &'static str,
    /// Runs one input.
    pub run: fn(&[u8]),
}

macro_rules! targets {
    ($($name:ident)*) => {
        /// All targets, in order of name.
        pub const TARGETS: &[Target] = &[$(Target { name: stringify!($name), run: $name }),*];
    };
}

targets! {
    app_messages app_scene client_messages client_session control_script upstream prefilter quantiser
    link repair_symbols recordings scene_commands server_messages side_packets state_packets subscriber
}
