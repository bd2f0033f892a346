//! Tasks on a recording, and the cost task, write complete results.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::bounce;

/// Output of a task.
struct Done {
    printed: String,
    /// Standard error.
    complained: String,
    succeeded: bool,
    summary: Value,
    limit: Value,
    page: String,
}

impl Done {
    fn runs(&self) -> &[Value] {
        self.summary["runs"].as_array().expect("there are runs")
    }

    fn number(&self, run: usize, name: &str) -> f64 {
        let value = &self.runs()[run][name];
        value
            .as_f64()
            .unwrap_or_else(|| panic!("{name} of run {run} is {value}"))
    }
}

fn task(name: &str, arguments: &[&str]) -> Done {
    let done = tried(name, arguments);
    assert!(done.succeeded, "{}", done.complained);
    done
}

fn tried(name: &str, arguments: &[&str]) -> Done {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("task-{name}"));
    std::fs::create_dir_all(&folder).expect("a folder");
    let trace = folder.join("bounce.rhtrace.zst");
    std::fs::write(&trace, bounce::packed()).expect("a file");
    let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
        .args(arguments)
        .arg("--out")
        .arg(&folder)
        .arg(&trace)
        .output()
        .expect("the benchmark starts");
    let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap_or_default();
    Done {
        printed: String::from_utf8(run.stdout).expect("text"),
        complained: String::from_utf8(run.stderr).expect("text"),
        succeeded: run.status.success(),
        summary: serde_json::from_str(&read("summary.json")).unwrap_or_default(),
        limit: serde_json::from_str(&read("limit.json")).unwrap_or_default(),
        page: read("report.html"),
    }
}

/// The root of the sources, in which an ablation counts lines and requirements.
const CHECKOUT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/..");

#[test]
fn an_ablation_compares_every_mechanism_on_every_load_and_link() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("task-ablate");
    std::fs::create_dir_all(&folder).expect("a folder");
    let trace = folder.join("bounce.rhtrace.zst");
    std::fs::write(&trace, bounce::packed()).expect("a file");
    let bench = |checkout: &Path| {
        Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
            .args(["ablate", "--seeds", "2", "--load"])
            .arg(format!("pit={}", trace.display()))
            .arg("--checkout")
            .arg(checkout)
            .arg("--out")
            .arg(&folder)
            .output()
            .expect("the benchmark starts")
    };
    let run = bench(Path::new(CHECKOUT));
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let text = std::fs::read_to_string(folder.join("ablation.json")).expect("the file exists");
    let ablation: Value = serde_json::from_str(&text).expect("the file is JSON");
    assert_eq!(
        (&ablation["faults"], &ablation["seeds"]),
        (&0.into(), &2.into())
    );
    let rows = ablation["rows"].as_array().expect("rows");
    let bytes = |row: &Value, side: &str, link: usize| {
        row["comparisons"][0][side][link]["payload_bytes"]
            .as_f64()
            .unwrap_or_else(|| panic!("{} {side} has bytes", row["name"]))
    };
    let mut measured = 0;
    for row in rows {
        assert!(row["lines"].as_u64().is_some_and(|lines| lines > 0));
        let comparisons = row["comparisons"].as_array().expect("comparisons");
        if row["without"].is_null() {
            assert!(comparisons.is_empty(), "{}", row["name"]);
            continue;
        }
        measured += 1;
        assert_eq!(comparisons.len(), 1, "{}", row["name"]);
        // A repair symbol or a refresh is sent where packets are lost.
        assert!(bytes(row, "with", 1) > bytes(row, "with", 0));
    }
    assert_eq!(measured, 20);
    let without = |name: &str| {
        let mut found = rows.iter().filter(|row| row["without"] == name);
        let row = found.next().expect("each feature is switched off once");
        bytes(row, "without", 0) / bytes(row, "with", 0)
    };
    for costly in ["residuals", "prefilter", "packing", "coder"] {
        assert!(without(costly) > 1.0, "{costly}");
    }
    assert!((without("fec") - 1.0).abs() < 1e-12, "nothing is lost");
    let printed = String::from_utf8(run.stdout).expect("text");
    for phrase in [
        "pit, loss",
        "range coder and contexts",
        "stays for",
        "budgets",
    ] {
        assert!(printed.contains(phrase), "{phrase}");
    }
    let run = bench(&folder);
    let complained = String::from_utf8_lossy(&run.stderr);
    assert!(!run.status.success() && complained.contains("name the checkout by --checkout"));
}

#[test]
fn a_sweep_of_tolerances_draws_the_frontier() {
    let values = "tolerance=0.005,0.02,0.08";
    let done = task("sweep", &["replay", "--no-trace", "--sweep", values]);
    assert!(done.number(0, "payload_bytes_down") > done.number(2, "payload_bytes_down"));
    let figures: Vec<_> = done.page.split("<svg ").skip(1).collect();
    assert_eq!(figures.len(), 1);
    assert!(done.page.contains("What exactness costs"));
    for label in ["5 mm", "20 mm", "80 mm"] {
        assert!(figures[0].contains(label), "{label}");
    }
    assert!(figures[0].matches("<circle").count() == 9);
}

#[test]
fn a_failed_replay_does_not_stop_the_others() {
    let done = tried(
        "unfinished",
        &["replay", "--sweep", "publish-interval=1,60000"],
    );
    assert!(!done.succeeded);
    assert!(done.complained.contains("1 of 2 replays failed"));
    assert_eq!(done.runs().len(), 1);
    assert!(done.number(0, "payload_bytes_down") > 0.0);
    let unfinished = done.summary["unfinished"]
        .as_array()
        .expect("unfinished replays are listed");
    assert_eq!(unfinished.len(), 1);
    assert!(
        unfinished[0]["setting"]
            .as_str()
            .is_some_and(|text| text.contains("each 60000 ticks"))
    );
    let line = "each 60000 ticks: no tick would be published";
    assert!(
        done.printed.contains(line) && done.page.contains(line),
        "{}",
        done.printed
    );
    let done = tried(
        "none-ended",
        &["replay", "--sweep", "publish-interval=60000,60001"],
    );
    assert!(!done.succeeded && done.summary.is_null());
    assert!(
        done.complained
            .contains("all 2 replays failed; the first: no tick would be published")
    );
}

#[test]
fn a_matrix_has_every_loss_even_and_in_bursts_at_every_round_trip() {
    let done = task("matrix", &["replay", "--no-trace", "--matrix"]);
    let links: Vec<_> = done
        .runs()
        .iter()
        .map(|run| run["link"].as_str().unwrap_or_default())
        .collect();
    assert_eq!(links.len(), 28);
    for link in ["", "loss=20%", "delay=150ms,loss=5%,burst=4", "delay=25ms"] {
        assert!(links.contains(&link), "{link:?} of {links:?}");
    }
    for run in done.runs() {
        let lossless = run["link"]
            .as_str()
            .is_none_or(|link| !link.contains("loss"));
        // Of two hundred packets, a link with a loss of one percent may lose none.
        let loses_much = run["link"]
            .as_str()
            .is_some_and(|link| link.contains("20%"));
        assert!(run["recovery"].is_null() || !lossless, "{}", run["link"]);
        assert!(!run["recovery"].is_null() || !loses_much, "{}", run["link"]);
        let over = run["over_tolerance"]["count"].as_u64();
        assert!(!lossless || over == Some(0));
        assert_eq!(run["over_tolerance"]["by_cause"]["fault"], 0);
    }
    let titles = [
        "rtt ms",
        "loss",
        "burst",
        "over %",
        "rec p50 ms",
        "rec p99 ms",
    ];
    assert!(
        titles.iter().all(|title| done.printed.contains(title)),
        "{}",
        done.printed
    );
    assert!(done.page.contains("recovery p99"));
}

#[test]
fn a_replay_is_compared_to_the_limit_of_its_recording() {
    let config = ["--tolerance", "0.02", "--publish-interval", "2"];
    let limit = task("limit", &[&["dev", "limit"], &config[..]].concat());
    let done = task(
        "of-limit",
        &[&["replay", "--no-trace"], &config[..]].concat(),
    );
    let (updates, bits) = (&limit.limit["fewest_updates"], &limit.limit["fewest_bits"]);
    let rate = updates["updates_per_second"].as_f64().expect("a rate");
    let kbps = bits["kbps"].as_f64().expect("a rate");
    let of = &done.runs()[0]["of_limit"];
    let expected = done.number(0, "payload_kbps_down") / kbps;
    assert!((of["bits"].as_f64().expect("a ratio") - expected).abs() < 1e-9);
    assert!(of["updates"].as_f64().is_some_and(|ratio| ratio > 1.0));
    assert!(rate > 0.0 && limit.printed.contains("fewest bits"));
    assert!(done.printed.contains("bits/limit") && done.page.contains("updates of limit"));
}

#[test]
fn a_replay_of_a_server_trace_publishes_the_same_updates() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("task-own");
    let run = |arguments: &[&str], out: &Path| {
        Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
            .args(arguments)
            .arg("--out")
            .arg(out)
            .output()
            .expect("the benchmark starts")
    };
    let bench = |arguments: &[&str], out: &Path| {
        let run = run(arguments, out);
        let error = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.success(), "{error}");
        let text = std::fs::read(out.join("summary.json")).expect("the file exists");
        serde_json::from_slice::<Value>(&text).expect("JSON")
    };
    let scene = ["evaluate", "--scene", "asteroids", "--bodies", "40"];
    let how = [
        "--seconds",
        "2",
        "--modes",
        "rhumb",
        "--no-pin",
        "--seed",
        "7",
    ];
    let live = bench(&[&scene[..], &how[..]].concat(), &folder);
    let of = |summary: &Value| summary["runs"][0]["updates"].clone();
    assert!(of(&live).as_u64().is_some_and(|updates| updates > 0));
    // All predictors work: inertias follow from the script, which the trace of a replay names too.
    let mut within = folder;
    for _ in 0..2 {
        let trace = within.join("trace.mcap");
        let replay = [
            "replay",
            trace.to_str().expect("the path is UTF-8"),
            "--tolerance",
            "0.05",
        ];
        let before = std::fs::read(&trace).expect("the file exists");
        let over = run(&replay, &within);
        assert!(String::from_utf8_lossy(&over.stderr).contains("--out"));
        assert_eq!(
            std::fs::read(&trace).ok(),
            Some(before),
            "the trace is unchanged"
        );
        within = within.join("again");
        assert_eq!(of(&live), of(&bench(&replay, &within)));
    }
}

#[test]
fn costs_are_measured_at_every_stage() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("task-cost");
    let run = Command::new(env!("CARGO_BIN_EXE_rhumb-bench"))
        .args([
            "cost",
            "--bodies",
            "200",
            "--repeats",
            "2",
            "--members",
            "1,2",
        ])
        .args(["--member-seconds", "1", "--out"])
        .arg(&folder)
        .output()
        .expect("the benchmark starts");
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let text = std::fs::read_to_string(folder.join("cost.json")).expect("the file exists");
    let costs: Value = serde_json::from_str(&text).expect("the file is JSON");
    let rows = |name: &str| costs[name].as_array().expect("a list").clone();
    let took = |row: &Value, name: &str| row[name].as_f64().expect("a number");
    // Three scenes, each as one stream and as four; the finer tiers send more updates.
    let publishing = rows("publishing");
    assert_eq!(publishing.len(), 6);
    for pair in publishing.chunks(2) {
        assert_eq!(
            (&pair[0]["streams"], &pair[1]["streams"]),
            (&1.into(), &4.into())
        );
        assert!(took(&pair[0], "step_ms") > 0.0 && took(&pair[0], "publish_ms") > 0.0);
        assert!(took(&pair[1], "updates_per_tick") >= took(&pair[0], "updates_per_tick"));
    }
    assert_eq!(publishing[0]["awake"], 200);
    assert!(took(&publishing[2], "updates_per_tick") > 0.0);
    let sleepers: Vec<_> = rows("sleeping")
        .iter()
        .map(|row| row["bodies"].clone())
        .collect();
    assert_eq!(sleepers, [2, 20, 200]);
    for name in ["first_ns", "update_ns", "view_ms"] {
        assert!(took(&costs["decoding"], name) > 0.0, "{name}");
    }
    let members = rows("members");
    assert_eq!(members.len(), if cfg!(target_os = "linux") { 4 } else { 0 });
    assert!(
        members
            .iter()
            .all(|row| took(row, "sockets_us") > 0.0 && took(row, "floor_us") > 0.0)
    );
    let printed = String::from_utf8(run.stdout).expect("text");
    for phrase in ["flight", "burst", "pile", "aimed at", "written to"] {
        assert!(printed.contains(phrase), "{phrase}");
    }
}
