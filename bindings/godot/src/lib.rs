//! An extension for Godot: nodes for the bodies of a remote physics scene.
//!
//! The physics runs in a Rhumb server. A node `RhumbScene` joins a scene, adds the nodes `RhumbBody` below it, makes
//! nodes for the bodies of others, and moves all of them.
//!
//! Positions are in metres, in Godot's own axes, which are Rhumb's: right-handed, y up.
#![deny(unsafe_op_in_unsafe_fn)]

mod body;
mod conversion;
mod generated;
mod joint;
mod membership;
mod scene;

use godot::init::{ExtensionLibrary, InitStage, gdextension};

struct RhumbExtension;

// SAFETY: the library is built without the feature that leaves out the checks of objects and borrows.
#[gdextension]
unsafe impl ExtensionLibrary for RhumbExtension {
    fn on_stage_deinit(stage: InitStage) {
        if stage == InitStage::Scene {
            membership::wait_for_all();
        }
    }
}
