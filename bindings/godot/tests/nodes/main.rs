//! The extension in Godot without a window, beside a server process.
//!
//! `RHUMB_TEST_GODOT` names Godot 4.4 or newer; without it, `godot` on the path is taken. Where there is none, each test says
//! so and passes.

mod agent;
mod book;
mod commands;
mod endings;
mod following;
mod pit;
mod scripts;
#[path = "../../../bevy/tests/plugin/server.rs"]
mod server;
mod shapes;
