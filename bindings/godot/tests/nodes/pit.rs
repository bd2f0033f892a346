//! The example: a pit whose walls are nodes of a scene file.

use std::process::{Command, Stdio};
use std::time::Duration;

use rhumb_client::{JoinMode, JoinOptions};

use crate::agent::{godot, project};
use crate::server::Server;

#[test]
fn the_pit_fills_and_a_second_window_adds_nothing() {
    let server = Server::start();
    let Some(godot) = godot() else { return };
    let start = || {
        let folder = project("project");
        let child = Command::new(&godot)
            .current_dir(folder.path())
            .args(["--headless", "--", &server.address, &server.fingerprint])
            .stdout(Stdio::null())
            .spawn()
            .expect("Godot starts");
        (child, folder)
    };
    // Another scene, for the time that passes in it.
    let mut clock = server.connect().join("clock").expect("the server answers");
    let (mut first, _first_folder) = start();
    let mut tries = 0..200;
    let mut pit = loop {
        assert!(tries.next().is_some(), "Godot creates no scene");
        let existing = JoinOptions {
            mode: JoinMode::Join,
            ..JoinOptions::default()
        };
        match server.connect().join_with("pit", existing) {
            Ok(pit) if !pit.view().ids().is_empty() => break pit,
            Ok(_) | Err(_) => clock
                .idle(Duration::from_millis(50))
                .expect("the server continues"),
        }
    };
    let count = 5 + 8 * 8 * 4;
    assert_eq!(pit.view().ids().len(), count);
    let (mut second, _second_folder) = start();
    let mut fallen = false;
    // Five seconds at least, in which the second window joins, and more on a busy machine.
    for step in 0..600 {
        if fallen && step > 100 {
            break;
        }
        pit.idle(Duration::from_millis(50))
            .expect("the server continues");
        pit.poll().expect("the server continues");
        let low = |position: &&rhumb_client::glam::Vec3| (0.0..1.0).contains(&position.y);
        fallen |= pit.view().positions().iter().filter(low).count() > 50;
    }
    assert!(fallen, "balls lie in the pit");
    assert_eq!(
        pit.view().ids().len(),
        count,
        "the second window added none"
    );
    for child in [&mut first, &mut second] {
        assert_eq!(
            child.try_wait().expect("the process is ours"),
            None,
            "it runs on"
        );
        child.kill().expect("the process is ours");
        child.wait().expect("it has ended");
    }
}
