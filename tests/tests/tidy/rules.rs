//! Rules for every source: its first line, its lengths, its names.
//!
//! Each exception is listed beside its rule.

use crate::code::{functions, without_tests};
use crate::house::{File, files, report, sources};

/// Longest first line, including `//! `.
const FIRST_LINE_MAX: usize = 79;
/// Most lines of a file before its unit tests, which stand at its end.
const FILE_LINES_MAX: usize = 800;
const FUNCTION_LINES_MAX: usize = 70;

#[test]
fn every_file_begins_with_its_purpose() {
    let mut violations = Vec::new();
    for File { path, text } in sources() {
        let first = text.lines().next().unwrap_or_default();
        let length = first.chars().count();
        if !first.starts_with("//! ") {
            violations.push(format!("{path}: begins with {first:?}"));
        } else if length > FIRST_LINE_MAX {
            violations.push(format!(
                "{path}: its first line has {length} characters, {FIRST_LINE_MAX} at most"
            ));
        }
    }
    report(
        "a file begins with a line that says its purpose",
        &violations,
    );
}

#[test]
fn every_file_of_a_binding_begins_with_its_purpose() {
    let marks = [
        (".c", "// "),
        (".cpp", "// "),
        (".h", "// "),
        (".hpp", "// "),
        (".cs", "// "),
        (".py", "\"\"\""),
        (".pyi", "\"\"\""),
    ];
    let mut violations = Vec::new();
    for File { path, text } in files()
        .into_iter()
        .filter(|file| file.is_in(&["bindings/"]))
    {
        let mark = marks.iter().find(|(ending, _)| path.ends_with(ending));
        let first = text.lines().next().unwrap_or_default();
        let length = first.chars().count();
        if let Some((_, mark)) = mark
            && (!first.starts_with(mark) || length > FIRST_LINE_MAX)
        {
            violations.push(format!("{path}: {length} characters: {first:?}"));
        }
    }
    report(
        "a file in another language begins with a line that says its purpose",
        &violations,
    );
}

#[test]
fn files_and_functions_are_short() {
    let mut violations = Vec::new();
    for file in sources() {
        let path = &file.path;
        let lines = without_tests(&file.text).lines().count();
        if lines > FILE_LINES_MAX {
            violations.push(format!(
                "{path}: {lines} lines before its tests, {FILE_LINES_MAX} at most"
            ));
        }
        for function in functions(&file.code()) {
            if function.lines > FUNCTION_LINES_MAX {
                let (line, name, lines) = (function.line, function.name, function.lines);
                violations.push(format!(
                    "{path}:{line}: {name} has {lines} lines, {FUNCTION_LINES_MAX} at most"
                ));
            }
        }
    }
    report(
        "a file has 800 lines before its tests at most, a function 70",
        &violations,
    );
}

/// All places in the code of these files that contain one of these words.
fn naming(words: &[&str], wanted: impl Fn(&File) -> bool) -> Vec<String> {
    let mut violations = Vec::new();
    for file in sources().into_iter().filter(wanted) {
        for (number, line) in file.code().lines().enumerate() {
            for word in words.iter().filter(|word| holds(line, word)) {
                violations.push(format!("{}:{}: {word}", file.path, number + 1));
            }
        }
    }
    violations
}

/// True if a line contains a word, not only as a part of a longer name.
fn holds(line: &str, word: &str) -> bool {
    let in_name = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    line.match_indices(word).any(|(start, _)| {
        let before = line[..start].chars().next_back();
        let after = line[start + word.len()..].chars().next();
        let begins_name = in_name(word.chars().next());
        let ends_name = in_name(word.chars().next_back());
        !(begins_name && in_name(before) || ends_name && in_name(after))
    })
}

#[test]
fn no_code_is_unfinished_silenced_or_expected_to_panic() {
    let words = [
        "todo!",
        "unimplemented!",
        "dbg!",
        "#[ignore",
        "#[allow(",
        "#![allow(",
        "should_panic",
    ];
    report(
        "no code is unfinished, silenced or expected to panic",
        &naming(&words, |_| true),
    );
}

#[test]
fn no_test_sleeps() {
    // The relay delays packets by its clock.
    let tests = |file: &File| file.is_test() && !file.is_in(&["tests/netsim/src/"]);
    let violations = naming(&["thread::sleep", "sleep_ms", "tokio::time::sleep"], tests);
    report("a test waits by a call with a time limit", &violations);
}

#[test]
fn reckoning_and_protocol_read_no_clock_open_no_socket_and_iterate_no_hash() {
    let words = [
        "std::time",
        "std::net",
        "std::thread",
        "HashMap",
        "HashSet",
        "SystemTime",
    ];
    let pure = |file: &File| file.is_in(&["reckoning/src/", "protocol/src/"]);
    report(
        "reckoning and protocol use neither clock nor socket",
        &naming(&words, pure),
    );
}

#[test]
fn only_the_engines_files_name_the_engine() {
    let words = ["rapier3d", "rapier", "box3d_sys"];
    let others = |file: &File| !file.is_in(&["server/src/engine/"]);
    report(
        "only server/src/engine/ names the engines",
        &naming(&words, others),
    );
    for (word, own) in [
        ("rapier3d", "server/src/engine/rapier"),
        ("box3d_sys", "server/src/engine/box3d/native"),
    ] {
        let beside = |file: &File| file.is_in(&["server/src/engine/"]) && !file.is_in(&[own]);
        report(
            "only an engine's own files name its library",
            &naming(&[word], beside),
        );
    }
}

#[test]
fn sockets_and_clocks_are_used_only_in_the_crates_that_own_them() {
    let own = |file: &File| {
        file.is_in(&[
            "transport/",
            "benches/",
            "gateways/app/src/datagram_sender.rs",
            "gateways/app/src/listener.rs",
            "gateways/app/src/send_queue.rs",
            "gateways/dis/src/main.rs",
            "gateways/dis/src/socket.rs",
            "service/src/serve.rs",
            "service/src/cli.rs",
            "service/src/main.rs",
            "service/src/directory/etcd.rs",
            "service/src/http.rs",
            "service/src/recording/live.rs",
            "service/src/top/reading.rs",
            "service/src/view.rs",
        ]) || file.is_test()
    };
    let mut clocks = naming(&["Instant::now", "SystemTime"], |file| !own(file));
    for file in sources().into_iter().filter(|file| !own(file)) {
        let code = file.code();
        let imports = code.lines().filter(|line| line.contains("std::time"));
        let hosts = imports.filter(|line| holds(line, "Instant"));
        clocks.extend(hosts.map(|line| format!("{}: {line}", file.path)));
    }
    report("only its owners read a clock", &clocks);
    // Addresses are not sockets: a client resolves its server's name, and settings name addresses.
    let sockets = ["UdpSocket", "TcpStream", "TcpListener", "UnixStream"];
    report(
        "only its owners open a socket",
        &naming(&sockets, |file| !own(file)),
    );
    let net = naming(&["std::net"], |file| {
        let names_addresses = [
            "client/src/network.rs",
            "service/src/edge.rs",
            "service/src/settings.rs",
            "service/src/start.rs",
            "trace/src/live.rs",
        ];
        !own(file) && !file.is_in(&names_addresses)
    });
    report("only its owners name the network", &net);
}

#[test]
fn no_library_prints() {
    let words = ["println!", "print!"];
    let libraries = [
        "reckoning/src/",
        "protocol/src/",
        "transport/link/src/",
        "transport/src/",
        "gateways/app/src/",
        "server/src/",
        "service/src/",
        "client/src/",
        "client/view/src/",
        "bindings/core/src/",
        "bindings/c/src/",
        "bindings/python/src/",
        "bindings/bevy/src/",
        "bindings/godot/src/",
        "sims/src/",
    ];
    report(
        "a library does not print",
        &naming(&words, |file| file.is_in(&libraries)),
    );
}

#[test]
fn cargo_bench_runs_nothing_but_benches() {
    let mut violations = Vec::new();
    let targets = ["src/lib.rs", "src/main.rs", "src/bin/"];
    let sources = sources();
    // They are workspaces of their own.
    let elsewhere = ["bindings/bevy/", "bindings/godot/"];
    let manifests = files()
        .into_iter()
        .filter(|file| file.path.ends_with("/Cargo.toml") && !file.is_in(&elsewhere));
    for File { path, text } in manifests {
        let folder = path.trim_end_matches("Cargo.toml");
        let own = targets.map(|target| format!("{folder}{target}"));
        let count = sources.iter().filter(|source| {
            let own: Vec<&str> = own.iter().map(String::as_str).collect();
            source.is_in(&own)
        });
        let (count, off) = (count.count(), text.matches("\nbench = false\n").count());
        if off < count {
            violations.push(format!(
                "{path}: {count} targets, {off} with `bench = false`"
            ));
        }
    }
    report(
        "a target other than a bench refuses Criterion's flags, so it is no bench",
        &violations,
    );
}
