//! All fuzz targets, in order of name.

use super::app::{app_messages, app_scene};
use super::client_session::client_session;
use super::control_messages::{client_messages, server_messages};
use super::control_script::control_script;
use super::dis::dis_datagrams;
use super::link::link;
use super::packets::{side_packets, state_packets};
use super::reckoning::{prefilter, quantiser};
use super::recordings::recordings;
use super::repair_symbols::repair_symbols;
use super::scene_commands::scene_commands;
use super::scene_files::{mesh_files, scene_files};
use super::subscriber::subscriber;
use super::target::Target;
use super::upstream::upstream;

/// The target of this name.
#[must_use]
pub fn target(name: &str) -> Option<&'static Target> {
    TARGETS.iter().find(|target| target.name == name)
}

macro_rules! targets {
    ($($name:ident)*) => {
        /// All targets, in order of name.
        pub const TARGETS: &[Target] = &[$(Target { name: stringify!($name), run: $name }),*];
    };
}

targets! {
    app_messages app_scene client_messages client_session control_script dis_datagrams upstream prefilter
    quantiser link mesh_files repair_symbols recordings scene_commands scene_files server_messages side_packets state_packets subscriber
}
