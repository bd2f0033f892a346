//! `rhumb-bench evaluate` with real servers: all modes have one truth.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::Command;

use rhumb_bench::recording::{self, ReadOptions};
use rhumb_protocol::stream::Activity;

/// Runs a scene and returns the runs of its summary.
fn runs(name: &str, arguments: &[&str]) -> Vec<serde_json::Value> {
    let out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("evaluate-{name}"));
    let brief = !arguments.contains(&"--seconds");
    let seconds: &[&str] = if brief { &["--seconds", "0.5"] } else { &[] };
    let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
        .arg("evaluate")
        .args(arguments)
        .args(seconds)
        .args(["--no-trace", "--no-pin", "--out"])
        .arg(&out)
        .output()
        .expect("the benchmark starts");
    let printed = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{name}: {printed}");
    let summary = std::fs::read(out.join("summary.json")).expect("the file exists");
    let summary: serde_json::Value = serde_json::from_slice(&summary).expect("the file is JSON");
    summary["runs"].as_array().expect("runs exist").clone()
}

#[test]
fn integrated_and_remote_scenes_have_one_truth() {
    for (scene, bodies) in [("asteroids", "20"), ("zoo", "5")] {
        let runs = runs(scene, &["--scene", scene, "--bodies", bodies]);
        let truths: Vec<_> = runs.iter().map(|run| &run["truth_hash"]).collect();
        assert_eq!(truths.len(), 4, "{scene}");
        for run in &runs[1..] {
            let over = (&run["over_tolerance"]["count"], &run["mismatches"]);
            assert_eq!(over, (&0.into(), &0.into()), "{scene}: {}", run["mode"]);
        }
        assert!(
            runs.iter().all(|run| run["void"] == false)
                && truths.iter().all(|truth| *truth == truths[0]),
            "{scene}: {truths:?}"
        );
    }
}

#[test]
fn a_pipelined_run_includes_its_last_tick() {
    let modes = ["--modes", "naive,rhumb,rhumb-pipelined", "--bodies", "30"];
    let runs = runs("pipelined", &modes);
    assert_eq!(runs[1]["updates"], runs[2]["updates"]);
    assert_eq!(runs[1]["payload_bytes_down"], runs[2]["payload_bytes_down"]);
    // The first frame shows tick 0 unless tick 1 is already there, and the bodies are from tick 1 on.
    let unjudged = runs[2]["unjudged_frames"].as_u64();
    assert!(unjudged.is_some_and(|frames| frames <= 1), "{unjudged:?}");
}

#[test]
fn a_free_running_scene_may_exceed_the_first_grant() {
    let more = [
        "--modes",
        "rhumb-free",
        "--scene",
        "rest-10k",
        "--bodies",
        "4200",
    ];
    let runs = runs("many", &more);
    assert_eq!(runs.len(), 1);
    assert_eq!(runs[0]["over_tolerance"]["by_cause"]["fault"], 0);
}

#[test]
fn publish_settings_without_a_free_running_mode_are_refused() {
    for flag in [
        ["--publish-interval", "2"],
        ["--lookahead", "3"],
        ["--delay", "1"],
    ] {
        let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
            .args(["evaluate", "--modes", "rhumb", "--no-pin"])
            .args(flag)
            .output()
            .expect("the benchmark starts");
        assert!(!run.status.success());
        let printed = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(
            printed.contains(
                "--publish-interval, --lookahead and --delay apply to free-running modes"
            ),
            "{printed}"
        );
    }
}

#[test]
fn a_free_running_mode_is_compared_with_naive_on_the_same_server() {
    let modes = ["--modes", "rhumb-free,naive-free", "--bodies", "30"];
    let runs = runs("free", &modes);
    assert_eq!(runs[0]["truth_hash"], runs[1]["truth_hash"]);
    let less = runs[0]["less_than_naive"]["payload"].as_f64();
    assert!(less.is_some_and(|times| times > 1.0), "{less:?}");
    for run in &runs {
        let unjudged = run["unjudged_frames"].as_u64().expect("a count");
        // Only frames before the first received tick have no truth.
        assert!(unjudged < 15, "{unjudged} of 30 frames");
        assert_eq!(run["over_tolerance"]["by_cause"]["fault"], 0);
        assert_eq!(run["mismatches"], 0);
    }
}

#[test]
fn a_body_that_sleeps_in_a_free_running_scene_sleeps_in_its_trace() {
    let out = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("evaluate-asleep");
    let modes = ["evaluate", "--modes", "rhumb-free", "--seconds", "2"];
    let scene = ["--scene", "rest-10k", "--bodies", "20"];
    let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
        .args([&modes[..], &scene[..]].concat())
        .args(["--no-pin", "--no-limit", "--out"])
        .arg(&out)
        .output()
        .expect("the benchmark starts");
    let printed = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "{printed}");
    let recording = recording::read(&out.join("trace.mcap"), &ReadOptions::default())
        .expect("the trace is a recording");
    let mut last = BTreeMap::new();
    for (tick, row) in recording.truth.ticks.iter().enumerate() {
        last.extend(
            row.iter()
                .map(|observation| (observation.id, (tick, observation.activity))),
        );
    }
    assert_eq!(last.len(), 20);
    for (id, (tick, activity)) in last {
        // A sleeping body has no further observations.
        let ended = tick + 30 < recording.truth.ticks.len();
        assert_eq!((ended, activity), (true, Activity::Asleep), "{id:?}");
    }
}

#[test]
fn a_delayed_view_shows_received_ticks_only() {
    let how = [
        "--modes",
        "rhumb-free",
        "--bodies",
        "30",
        "--lookahead",
        "3",
    ];
    let runs = runs("later", &[&how[..], &["--delay", "12"]].concat());
    let subscription =
        serde_json::json!({"publish_interval": 1, "lookahead_ticks": 3, "delay_ticks": 12});
    assert_eq!(runs[0]["subscription"], subscription);
    assert_eq!(runs[0]["over_tolerance"]["by_cause"]["late"], 0);
}

#[test]
fn breaches_of_a_budget_are_counted_as_budget_and_no_others_occur() {
    let modes = [
        "--modes",
        "naive,rhumb",
        "--scene",
        "tumbler",
        "--bodies",
        "200",
    ];
    let tight = ["--seconds", "4", "--tolerance", "0.005", "--budget", "600"];
    let modes = [&modes[..], &tight[..]].concat();
    let runs = runs("budget", &modes);
    let run = &runs[1];
    assert_eq!(run["budget_bytes_per_second"], 600);
    let over = &run["over_tolerance"];
    assert!(
        over["by_cause"]["budget"]
            .as_u64()
            .is_some_and(|count| count > 0),
        "{over}"
    );
    assert_eq!(over["count"], over["by_cause"]["budget"]);
    assert_eq!(run["mismatches"], 0);
    assert_eq!(runs[0]["budget_bytes_per_second"], serde_json::Value::Null);
}

#[test]
fn the_papers_protocol_has_the_same_truth_and_sends_every_body_in_its_own_datagram() {
    let modes = "integrated,app-all,app-active,app-packed";
    let runs = runs("app", &["--modes", modes, "--bodies", "30"]);
    for run in &runs {
        assert_eq!(run["void"], false, "{run}");
        assert_eq!(run["truth_hash"], runs[0]["truth_hash"]);
    }
    let number = |run: &serde_json::Value, name: &str| run[name].as_u64().expect("a count");
    let (all, packed) = (&runs[1], &runs[3]);
    // Thirty ticks of thirty states, and the end of each; the acknowledgement of each step is a packet too.
    assert_eq!(number(all, "updates"), 900);
    assert_eq!(number(all, "payload_bytes_down"), 30 * (30 * 88 + 28));
    assert_eq!(number(all, "datagrams_down"), 30 * (30 + 1 + 1));
    let on_wire = 30 * (30 * 116 + 56 + 40);
    assert_eq!(number(all, "bytes_down"), on_wire);
    assert_eq!(number(packed, "payload_bytes_down"), 30 * (30 * 88 + 28));
    assert_eq!(number(packed, "datagrams_down"), 30 * (2 + 1));
    assert_eq!(
        all["surface_error_m"]["max"], 0.0,
        "received states are exact"
    );
}

#[test]
fn each_defect_of_the_published_client_can_be_selected() {
    for losses in ["poll", "cap", "list", "buffer"] {
        let client = ["--modes", "integrated,app-all", "--bodies", "10"];
        let runs = runs(losses, &[&client[..], &["--app-defects", losses]].concat());
        assert_eq!(runs[1]["void"], false);
        assert_eq!(runs[1]["updates"], 300, "{losses}");
        let link = runs[1]["link"].to_string();
        assert!(link.contains(losses), "{link}");
    }
}

#[test]
fn commands_missing_from_the_papers_protocol_are_refused() {
    let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
        .args(["evaluate", "--scene", "ragdolls", "--modes", "app-all"])
        .args(["--seconds", "0.5", "--no-trace", "--no-pin", "--out"])
        .arg(PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("evaluate-unsaid"))
        .output()
        .expect("the benchmark starts");
    let printed = String::from_utf8_lossy(&run.stderr);
    assert!(!run.status.success());
    assert!(
        printed.contains("the paper's protocol cannot express"),
        "{printed}"
    );
}
