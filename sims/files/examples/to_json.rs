//! Converts a robot or a scene to Rhumb's JSON, and lists what it loses.
//!
//! `cargo run --example to_json -- robot.urdf > scene.json`

use std::error::Error;
use std::io::{Write, stderr, stdout};

use rhumb_scene_files::{Folder, LoadOptions, SceneFile, load};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("which file?")?;
    let scene = load(&Folder::default(), &path, &LoadOptions::default())?;
    for note in scene.report.notes() {
        writeln!(stderr(), "{note}")?;
    }
    serde_json::to_writer(stdout(), &SceneFile::of(&scene))?;
    Ok(())
}
