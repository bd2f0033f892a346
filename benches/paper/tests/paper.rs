//! `rhumb-paper` with real servers: resuming, results and pages.
//!
//! Times are never asserted. Tests wait by reading a process's output, never by sleeping.

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use serde_json::Value;

fn folder(name: &str) -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("paper-{name}"));
    // The folder may not exist yet.
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn bench(task: &[&str], out: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rhumb-paper"));
    command.args(task).arg("--out").arg(out);
    command
}

fn run(task: &[&str], out: &Path) -> Output {
    bench(task, out).output().expect("the benchmark starts")
}

fn succeeds(task: &[&str], out: &Path) -> String {
    let output = run(task, out);
    let printed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{task:?}: {printed}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn fails(task: &[&str], out: &Path) -> String {
    let output = run(task, out);
    assert!(!output.status.success(), "{task:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn json(path: &Path) -> Value {
    let bytes = fs::read(path).expect("the file exists");
    serde_json::from_slice(&bytes).expect("the file is JSON")
}

const SMALL: [&str; 6] = [
    "--loads",
    "20..40",
    "--stage-seconds",
    "0.5",
    "--no-pin",
    "--trials",
];

#[test]
fn an_interrupted_experiment_is_continued() {
    let out = folder("resume");
    let task = [&SMALL[..], &["3"]].concat();
    let mut first = bench(&task, &out)
        .stdout(Stdio::piped())
        .spawn()
        .expect("the benchmark starts");
    let mut printed = String::new();
    let mut lines = BufReader::new(first.stdout.take().expect("the output is piped"));
    lines
        .read_line(&mut printed)
        .expect("the process prints a line");
    assert!(printed.starts_with("trial 1 of 3, seed 1: "), "{printed}");
    first.kill().expect("the process can be killed");
    first.wait().expect("the process was started");
    let kept = out.join("trials/0001.json");
    let before = fs::read(&kept).expect("a finished trial is stored");

    let printed = succeeds(&task, &out);
    assert!(
        printed.contains(" of 3 trials are already finished"),
        "{printed}"
    );
    assert_eq!(before, fs::read(&kept).expect("the file still exists"));
    let results = json(&out.join("paper.json"));
    let trials = results["trials"].as_array().expect("there are trials");
    let seeds: Vec<_> = trials.iter().map(|trial| trial["seed"].as_u64()).collect();
    assert_eq!(seeds, [Some(1), Some(2), Some(3)]);
    assert_eq!(results["analysis"]["void"], Value::Array(Vec::new()));
    for load in results["analysis"]["loads"].as_array().expect("loads") {
        let modes = load["modes"].as_array().expect("modes");
        let names: Vec<_> = modes
            .iter()
            .filter_map(|mode| mode["mode"].as_str())
            .collect();
        assert_eq!(
            names,
            [
                "integrated",
                "app-all",
                "app-active",
                "app-packed",
                "naive",
                "rhumb",
                "rhumb-pipelined"
            ]
        );
        assert!(modes.iter().all(|mode| mode["phys_ft_ms"]["count"] == 3));
        assert!(modes[0]["against_integrated"].is_null());
        assert!(modes[1]["against_integrated"]["phys_ft_ms"]["z"]["p"].is_number());
    }
    for name in ["trials.csv", "analysis.csv", "paper.md", "paper.html"] {
        let text = fs::read_to_string(out.join(name)).expect("the file exists");
        assert!(text.contains("rhumb-pipelined"), "{name}");
    }
    let lines = fs::read_to_string(out.join("trials.csv")).expect("the file exists");
    // Titles, and a line for each of 3 trials, 2 loads, 7 modes.
    assert_eq!(lines.lines().count(), 43);

    // More trials are accepted, another seed is not.
    let more = [&SMALL[..], &["4"]].concat();
    assert!(succeeds(&more, &out).contains("3 of 4 trials are already finished"));
    let printed = fails(&[&task[..], &["--seed", "7"]].concat(), &out);
    assert!(
        printed.contains("another experiment (seed: 1 and 7)"),
        "{printed}"
    );
}

#[test]
fn invalid_arguments_are_refused_with_the_reason() {
    let out = folder("refused");
    for (task, why) in [
        (
            &["--modes", "naive,rhumb"][..],
            "--modes must name integrated",
        ),
        (&["--modes", "integrated,teleport"], "teleport"),
        (
            &["--loads", "500,1500"],
            "consecutive multiples of the first",
        ),
        (&["--loads", "none"], "not a number of balls"),
        (&["--trials", "0"], "0 is not in 1..=10000"),
        (
            &["--stage-seconds", "-1"],
            "must lie between 0.1 and 3600 seconds",
        ),
        (&["--tolerance", "NaN"], "a tolerance of NaN m"),
        (&["remote", "--awake", "101"], "101 is not in 0..=100"),
        (
            &["hardware", "--caller-percent", "5"],
            "5 is not in 10..=100",
        ),
        (
            &["hardware", "--threads", "some"],
            "must be a number of threads or",
        ),
        (&["merge", "nowhere.json"], "cannot read nowhere.json"),
    ] {
        let printed = fails(task, &out);
        assert!(printed.contains(why), "{task:?}: {printed}");
    }
    if !cfg!(feature = "parallel") {
        let printed = fails(&["--threads", "2"], &out);
        assert!(
            printed.contains("without the feature \"parallel\""),
            "{printed}"
        );
    }
}

#[test]
fn every_defect_of_the_published_client_has_a_row_with_the_same_truth() {
    let out = folder("gap");
    let printed = succeeds(
        &["gap", "--no-pin", "--loads", "40", "--frames", "14"],
        &out,
    );
    assert!(printed.contains("protocol alone"), "{printed}");
    let results = json(&out.join("gap.json"));
    let rows = results["rows"].as_array().expect("rows");
    let of = |client: &str| {
        let row = rows.iter().find(|row| row["client"] == client);
        &row.expect("a row of that name")["outcome"]
    };
    assert_eq!(rows.len(), 11);
    assert!(rows.iter().all(|row| row["outcome"]["void"] == false));
    // Each frame carries every body, one datagram each; one more ends the frame, and one acknowledges the advance.
    for client in ["sound", "list", "as published"] {
        assert_eq!(of(client)["updates"], 14 * 40, "{client}");
        assert_eq!(of(client)["datagrams_down"], 14 * 42, "{client}");
    }
    // The list starts at the experiment's length, so twelve frames suffice.
    assert_eq!(of("as published, its list as long")["updates"], 12 * 40);
    assert_eq!(of("sound, packed")["updates"], 14 * 40);
    assert!(of("sound, packed")["datagrams_down"].as_u64() < Some(14 * 10));
    assert!(of("rhumb")["updates"].as_u64() < Some(14 * 40));
}

#[test]
fn crossovers_come_from_points_with_one_truth() {
    let out = folder("remote");
    let task = [
        "remote",
        "--no-pin",
        "--loads",
        "60",
        "--awake",
        "100,20",
        "--other-work-ms",
        "0,2",
        "--depths",
        "0,1",
        "--frames",
        "2",
    ];
    let printed = succeeds(&task, &out);
    assert!(
        printed.contains("Where remote beats integrated"),
        "{printed}"
    );
    let results = json(&out.join("remote.json"));
    let points = results["points"].as_array().expect("points");
    // Two shares, two amounts of other work, and integrated with two depths.
    assert_eq!(points.len(), 12);
    assert!(points.iter().all(|point| point["void"] == false));
    // Over other work at the one load, and over loads at either amount: for two depths and two shares.
    assert_eq!(
        results["crossings"].as_array().expect("crossings").len(),
        12
    );
    let awake = |place: usize| points[place]["awake"].as_u64().expect("a count");
    assert!(awake(6) < awake(0), "{} of {}", awake(6), awake(0));
}

#[test]
fn a_slowed_caller_is_described_and_machines_merge() {
    let out = folder("hardware");
    let task = [
        "hardware",
        "--fast",
        "--threads",
        "1",
        "--caller-percent",
        "100,50",
    ];
    succeeds(&task, &out);
    let results = json(&out.join("hardware.json"));
    let rows = results["machines"][0]["rows"].as_array().expect("rows");
    // Pinned and not pinned, full and slowed, three modes.
    assert_eq!(rows.len(), 12);
    assert!(rows.iter().all(|row| row["outcome"]["void"] == false));
    let slowed = rows.iter().filter(|row| {
        let caller = row["caller"].as_str().expect("words");
        caller.starts_with("50 % by ")
    });
    assert_eq!(slowed.count(), 6);

    let file = out.join("hardware.json").display().to_string();
    let twice = fails(&["merge", &file, &file], &folder("merged-twice"));
    assert!(
        twice.contains("contains a machine that was already given"),
        "{twice}"
    );
    let other = folder("hardware-other").with_extension("json");
    let mut elsewhere = results;
    elsewhere["machines"][0]["machine"] = "another machine".into();
    elsewhere["machines"][0]["rows"][0]["outcome"]["truth"] = "0".into();
    fs::write(&other, elsewhere.to_string()).expect("the folder exists");
    let merged = folder("merged");
    let printed = succeeds(&["merge", &file, &other.display().to_string()], &merged);
    assert!(printed.contains("another machine"), "{printed}");
    let merged = json(&merged.join("hardware.json"));
    assert_eq!(merged["machines"].as_array().expect("machines").len(), 2);
    // The first machine's truth counts; a row with another one is void.
    assert_eq!(merged["machines"][1]["rows"][0]["outcome"]["void"], true);
    assert_eq!(merged["machines"][1]["rows"][1]["outcome"]["void"], false);
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder");
    let paths = entries.map(|entry| entry.expect("an entry").path());
    let below = |path: PathBuf| match path.is_dir() {
        true => files(&path),
        false => vec![path],
    };
    paths.flat_map(below).collect()
}

#[test]
fn no_stored_run_is_void_or_has_a_fault() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results/data/stream");
    let mut compared = 0;
    for path in files(&data) {
        for run in json(&path)["runs"].as_array().expect("runs") {
            let what = path.display();
            assert_eq!(run["void"], false, "{what}");
            if run["mode"] == "integrated" {
                continue;
            }
            compared += 1;
            assert_eq!(run["mismatches"], 0, "{what}");
            let causes = &run["over_tolerance"]["by_cause"];
            assert_eq!(causes["fault"], 0, "{what}");
            if run["link"].is_null() {
                // A free-running client may show a tick before its updates arrive.
                assert_eq!(run["over_tolerance"]["count"], causes["late"], "{what}");
                assert_eq!(causes["loss"], 0, "{what}");
                let free = run["mode"]
                    .as_str()
                    .is_some_and(|mode| mode.ends_with("-free"));
                assert!(free || causes["late"] == 0, "{what}");
            }
        }
    }
    assert!(compared > 50, "{compared} runs");
}

#[test]
fn the_stored_ablation_has_no_fault_and_every_row_has_its_loads() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results/data/ablation.json");
    let ablation = json(&path);
    assert_eq!(ablation["faults"], 0);
    let loads = ablation["loads"].as_array().expect("loads").len();
    assert_eq!(loads, 5);
    for row in ablation["rows"].as_array().expect("rows") {
        let compared = row["comparisons"].as_array().expect("comparisons").len();
        let expected = if row["without"].is_null() { 0 } else { loads };
        assert_eq!(compared, expected, "{}", row["name"]);
    }
}

#[test]
fn the_result_pages_are_current() {
    let results = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/results");
    let check = |page: &Path| {
        Command::new(env!("CARGO_BIN_EXE_rhumb-paper"))
            .args(["page", "--check"])
            .arg(page)
            .output()
            .expect("the benchmark starts")
    };
    for page in [
        "paper.md",
        "stream.md",
        "builds.md",
        "mechanisms.md",
        "service.md",
    ] {
        let printed = check(&results.join(page));
        let why = String::from_utf8_lossy(&printed.stderr);
        assert!(printed.status.success(), "{page}: {why}");
    }
    let page = results.join("paper.md");
    // The check also detects a stale page.
    let text = fs::read_to_string(&page).expect("the page exists");
    let copy = folder("page");
    fs::create_dir_all(copy.join("data")).expect("the folder is writable");
    for entry in fs::read_dir(page.parent().expect("a folder").join("data")).expect("data") {
        let from = entry.expect("a file").path();
        if from.is_dir() {
            continue;
        }
        let name = from.file_name().expect("a name").to_owned();
        fs::copy(&from, copy.join("data").join(name)).expect("the file can be copied");
    }
    let stale = copy.join("paper.md");
    fs::write(&stale, text.replacen("| 500 |", "| 501 |", 1)).expect("the file is writable");
    let printed = check(&stale);
    assert!(!printed.status.success());
    let printed = String::from_utf8_lossy(&printed.stderr).into_owned();
    assert!(printed.contains("sim-fps"), "{printed}");
}
