//! The command line of the suite refuses invalid arguments before any case.
//!
//! The tests run the binary. Exit code 2 means that no case ran.

use std::path::PathBuf;
use std::process::{Command, Output};
use std::{env, fs};

use rhumb_conformance::LocalServer;
use serde_json::Value;

/// An address without a listener: the port of the obsolete discard service.
const UNREACHABLE: &str = "127.0.0.1:9";

fn conformance(arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rhumb-conformance"));
    command
        .args(arguments)
        .output()
        .expect("running the binary")
}

/// Checks that these arguments are refused before any case runs, with a message that contains these words.
#[track_caller]
fn refused(arguments: &[&str], words: &[&str]) {
    let output = conformance(arguments);
    let sent = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {sent}");
    assert!(output.stdout.is_empty(), "{arguments:?} runs a case");
    for word in words {
        assert!(sent.contains(word), "{arguments:?}: no {word:?} in {sent}");
    }
}

fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = env::temp_dir().join(format!("rhumb-cli-{}-{name}", std::process::id()));
    fs::write(&path, bytes).expect("writing a temporary file");
    path
}

#[test]
fn a_zero_time_limit_or_parallelism_is_refused() {
    refused(
        &["vectors", "--timeout", "0"],
        &["--timeout", "must be positive"],
    );
    refused(&["vectors", "--timeout=-1"], &["--timeout"]);
    refused(&["vectors", "--side-by-side", "0"], &["--side-by-side"]);
}

#[test]
fn a_pattern_that_selects_no_case_is_named() {
    let patterns = ["vectors", "--case", "L0.84", "--case", "NOSUCH"];
    refused(&patterns, &["--case \"NOSUCH\""]);
    refused(&["client", "--list", "--case", "L9"], &["--case \"L9\""]);
}

#[test]
fn options_that_do_not_apply_are_refused() {
    refused(&["vectors", "--link", "loss=5%"], &["--link"]);
    refused(&["vectors", "--without", "authority"], &["--without"]);
    let bits = ["client", "--exec", "true", "--profile", "bit-exact"];
    refused(&bits, &["--profile"]);
    let fixed = ["client", "--exec", "true", "--listen", "127.0.0.1:4999"];
    refused(&fixed, &["--side-by-side 1"]);
}

#[test]
fn an_unreachable_server_is_one_error() {
    let pin = "00".repeat(32);
    let matrix = format!("one={UNREACHABLE},{pin}");
    let target = [
        "--target",
        UNREACHABLE,
        "--fingerprint",
        &pin,
        "--timeout",
        "0.5",
    ];
    refused(&[&["server"], &target[..]].concat(), &[UNREACHABLE]);
    let matrix = ["matrix", "--server", &matrix, "--client", "one=true"];
    refused(&[&matrix[..], &["--timeout", "0.5"]].concat(), &["one"]);
}

#[test]
fn a_server_with_another_certificate_is_one_error() {
    let server = LocalServer::start().expect("loopback has a free port");
    let (target, pin) = (server.address.to_string(), "00".repeat(32));
    let arguments = ["server", "--target", &target, "--fingerprint", &pin];
    refused(&arguments, &[&target, "cannot be reached"]);
}

#[test]
fn an_invalid_trace_is_named() {
    let (empty, noise) = (file("empty.mcap", b""), file("noise.mcap", &[0x5a; 400]));
    for path in [&empty, &noise, &PathBuf::from("nosuch.mcap")] {
        let name = path.display().to_string();
        refused(&["trace", &name], &[&name]);
    }
    fs::remove_file(empty).expect("removing the file");
    fs::remove_file(noise).expect("removing the file");
}

#[test]
fn a_report_without_a_folder_is_refused_before_any_case() {
    for option in ["--html", "--json", "--junit"] {
        refused(&["vectors", option, "nosuch/report"], &["nosuch/report"]);
        refused(&["vectors", option, "."], &[".: it is a folder"]);
    }
}

#[test]
fn a_client_without_any_feature_does_not_pass() {
    for case in ["L2.51", "L4.51.1"] {
        let output = conformance(&["client", "--exec", "sh -c 'exit 127'", "--case", case]);
        assert_eq!(output.status.code(), Some(1), "{output:?}");
        let sent = String::from_utf8_lossy(&output.stdout);
        assert!(sent.contains("even a plain subscription"), "{sent}");
    }
}

#[test]
fn a_decoder_without_any_feature_does_not_pass() {
    let exec = "sh -c 'while read line; do echo \"{\\\"unsupported\\\":true}\"; done'";
    let output = conformance(&["vectors", "--exec", exec, "--case", "L0.81"]);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let sent = String::from_utf8_lossy(&output.stdout);
    assert!(sent.contains("nothing passed"), "{sent}");
}

#[test]
fn stderr_of_a_client_is_reported_with_the_failing_case() {
    let report = file("report.json", b"");
    let path = report.display().to_string();
    let exec = "sh -c 'echo no such interpreter >&2'";
    let arguments = ["client", "--exec", exec, "--case", "L1.51.2", "--json"];
    let output = conformance(&[&arguments[..], &[&path, "--timeout", "0.5"]].concat());
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let text = fs::read_to_string(&report).expect("reading the report");
    let value: Value = serde_json::from_str(&text).expect("JSON");
    let trace = value["cases"][0]["trace"].to_string();
    assert!(trace.contains("stderr: no such interpreter"), "{value}");
    fs::remove_file(report).expect("removing the file");
}
