//! The code of the book's page runs.

use std::process::{Command, Stdio};
use std::time::Duration;

use rhumb_client::{JoinMode, JoinOptions};

use crate::agent::{godot, project};
use crate::server::Server;

const PAGE: &str = include_str!("../../../../docs/book/src/how-to/engines.md");

#[test]
fn the_code_of_the_page_lets_a_ball_rise_and_fall() {
    let server = Server::start();
    let Some(godot) = godot() else { return };
    let (_, code) = PAGE.split_once("```gdscript\n").expect("a block of code");
    let (code, _) = code.split_once("```").expect("the end of the block");
    let folder = project("tests/project");
    std::fs::write(folder.path().join("agent.gd"), code).expect("a file");
    let mut child = Command::new(godot)
        .current_dir(folder.path())
        .args(["--headless", "--", &server.address, &server.fingerprint])
        .stdout(Stdio::null())
        .spawn()
        .expect("Godot starts");
    // Another scene, for the time that passes in it.
    let mut clock = server.connect().join("clock").expect("the server answers");
    let existing = || JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let mut heights = Vec::new();
    for _ in 0..200 {
        clock
            .idle(Duration::from_millis(50))
            .expect("the server continues");
        if let Ok(scene) = server.connect().join_with("drop", existing()) {
            heights.extend(scene.view().positions().iter().map(|position| position.y));
        }
        if heights.iter().any(|height| *height < 9.0) {
            break;
        }
    }
    child.kill().expect("the process is ours");
    child.wait().expect("it has ended");
    assert!(
        heights.iter().any(|height| *height < 9.0),
        "it falls: {heights:?}"
    );
}
