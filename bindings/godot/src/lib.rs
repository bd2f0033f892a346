//! An extension for Godot: nodes for the bodies of a remote physics scene.
//!
//! The physics runs in a Rhumb server. A node `RhumbScene` joins a scene, adds the nodes `RhumbBody` below it, makes nodes for
//! the bodies of others, and moves all of them.
//!
//! Positions are in metres, in Godot's own axes, which are Rhumb's: right-handed, y up.
#![deny(unsafe_op_in_unsafe_fn)]

mod axes;
mod body;
mod body_nodes;
mod event;
mod generated;
mod join;
mod joint;
mod leaving;
mod membership;
mod motion_settings;
mod scene;
mod shapes;

use godot::init::{ExtensionLibrary, InitStage, gdextension};

struct RhumbExtension;

// SAFETY: the library is built without the feature that leaves out the checks of objects and borrows.
#[gdextension]
unsafe impl ExtensionLibrary for RhumbExtension {
    fn on_stage_deinit(stage: InitStage) {
        if stage == InitStage::Scene {
            leaving::wait_for_all();
        }
    }
}
