//! `rhumb-bench evaluate` with real servers has one truth in all modes.

use std::path::PathBuf;
use std::process::Command;

/// Runs a scene in all lockstep modes and returns its digests.
fn truths(scene: &str, bodies: &str) -> Vec<String> {
    let out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("evaluate-{scene}"));
    let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
        .args(["evaluate", "--scene", scene, "--bodies", bodies])
        .args(["--seconds", "0.5", "--no-trace", "--no-pin", "--out"])
        .arg(&out)
        .output()
        .expect("the bench starts");
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{scene}: {said}");
    let summary = std::fs::read(out.join("summary.json")).expect("it was written");
    let summary: serde_json::Value = serde_json::from_slice(&summary).expect("it is JSON");
    let runs = summary["runs"].as_array().expect("there are runs");
    runs.iter()
        .map(|run| run["truth_hash"].to_string())
        .collect()
}

#[test]
fn integrated_and_hosted_scenes_have_one_truth() {
    for (scene, bodies) in [("asteroids", "20"), ("zoo", "5")] {
        let truths = truths(scene, bodies);
        assert_eq!(truths.len(), 4, "{scene}");
        assert!(
            truths.iter().all(|truth| *truth == truths[0]),
            "{scene}: {truths:?}"
        );
    }
}
