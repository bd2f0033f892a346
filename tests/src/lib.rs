//! Shared code of the workspace tests: stage, truth, table, process.
//!
//! It contains no tests; those are in `tests/`. Nothing here sleeps or reads a clock.
#![forbid(unsafe_code)]

mod altered_script;
mod avatar;
#[cfg(doctest)]
mod book;
mod edge_stage;
mod failing_engine;
pub mod fuzzing;
mod observation_history;
mod plugin;
mod process;
mod raw_peer;
mod scripted_session;
mod stage;
mod table;
mod truth;
pub mod vectors;
mod walk;

pub use altered_script::AlteredScript;
pub use avatar::Avatars;
pub use edge_stage::{EdgeStage, Place};
pub use failing_engine::{FailingEngine, Fails, failing_body};
pub use observation_history::{Claim, ObservationHistory, assert_same_copy};
pub use plugin::{PluginServer, PluginSession, Recording, falling, falling_apart, plugin_world};
pub use process::{Ended, Programme, ServerProcess, signal};
pub use raw_peer::RawPeer;
pub use rhumb_conformance::seed::{Dice, seed};
pub use scripted_session::ScriptedSession;
pub use stage::{COMMANDER, Stage, TICK};
pub use table::{Delivered, DeliveryAction, LossFilter, Table};
pub use truth::{MemberRecord, SceneTruth};
pub use walk::{Walk, take_authority};
