//! Programs in C and C++ under AddressSanitizer.
//!
//! Warnings are errors.

use std::path::{Path, PathBuf};
use std::process::Command;

use rhumb_tests::ServerProcess;
use tempfile::TempDir;

use super::{has, libraries, root, run_well};
use crate::SERVER;

/// The library that a program is linked with.
#[derive(Clone, Copy, Debug)]
pub(super) enum Linked {
    Shared,
    Static,
}

/// A compiled program of `bindings/c`.
pub(super) struct Compiled {
    path: PathBuf,
    ends_server: bool,
    _folder: TempDir,
}

impl Compiled {
    /// Compiles `bindings/c/SOURCE`, in C or C++ by its ending; `None`, with a line that says so, without a compiler.
    pub(super) fn new(source: &str, linked: Linked) -> Option<Self> {
        Self::with_headers(source, linked, &root().join("bindings/c/include"))
    }

    /// The same with headers of another folder too.
    pub(super) fn with_headers(source: &str, linked: Linked, headers: &Path) -> Option<Self> {
        let folder = TempDir::new().expect("a folder for the program");
        let path = folder.path().join("program");
        let c = root().join("bindings/c");
        let (compiler, standard) = match source.ends_with(".cpp") {
            true => ("c++", "-std=c++17"),
            false => ("cc", "-std=c11"),
        };
        if !has(compiler) {
            return None;
        }
        let mut command = Command::new(compiler);
        command
            .args([standard, "-Wall", "-Wextra", "-Werror", "-pedantic", "-g"])
            .args(["-fsanitize=address,undefined", "-fno-sanitize-recover=all"])
            .args(["-D_POSIX_C_SOURCE=200809L", "-pthread", "-I"])
            .arg(c.join("include"))
            .arg("-I")
            .arg(headers)
            .arg(c.join(source))
            .arg("-o")
            .arg(&path);
        link(&mut command, linked);
        run_well(&mut command);
        Some(Self {
            path,
            ends_server: source == "tests/misuse.c",
            _folder: folder,
        })
    }

    /// Runs it with a server's address and fingerprint, and its process id where it ends the server; returns what it
    /// wrote.
    pub(super) fn run_with(&self, server: &ServerProcess) -> String {
        let mut command = Command::new(&self.path);
        let asan = "detect_leaks=1:detect_stack_use_after_return=1";
        command.env("ASAN_OPTIONS", asan);
        command.args([server.address.to_string(), server.fingerprint.to_string()]);
        if self.ends_server {
            command.arg(server.id().to_string());
        }
        run_well(&mut command)
    }

    /// Runs it with these arguments; returns what it wrote.
    pub(super) fn run_on(&self, arguments: &[String]) -> String {
        run_well(Command::new(&self.path).args(arguments))
    }
}

fn link(command: &mut Command, linked: Linked) {
    let folder = libraries();
    match linked {
        Linked::Shared => {
            let rpath = format!("-Wl,-rpath,{}", folder.display());
            command.arg("-L").arg(&folder).args(["-lrhumb", "-lm"]);
            command.arg(rpath);
        }
        Linked::Static => {
            // The system's own libraries for threads and numbers, as the install script says too.
            command.arg(folder.join("librhumb.a")).args(["-ldl", "-lm"]);
        }
    }
}

#[test]
fn the_examples_in_c_and_cpp_drop_a_ball_on_the_floor() {
    for source in ["examples/drop.c", "examples/drop.cpp"] {
        let Some(program) = Compiled::new(source, Linked::Shared) else {
            continue;
        };
        let server = SERVER.serve("127.0.0.1:0");
        let out = program.run_with(&server);
        assert_eq!(program.run_on(&[]), out, "in the process as on a server");
        let lines: Vec<_> = out.lines().collect();
        assert_eq!(lines.len(), 180, "{out}");
        assert!(
            lines[0].starts_with("tick 1: 0.000 9.99"),
            "{source}: {}",
            lines[0]
        );
        assert!(
            lines[179].starts_with("tick 180: 0.000 0.5"),
            "{source}: {}",
            lines[179]
        );
        assert!(
            lines[179].ends_with("within 0.050 m"),
            "{source}: {}",
            lines[179]
        );
    }
}

#[test]
fn members_of_a_server_in_the_process_take_turns_and_see_each_other_in_c_and_in_cpp() {
    let tests = [
        ("tests/local.c", "the members took turns\n"),
        ("tests/local.cpp", "the members saw the ball\n"),
    ];
    for (source, expected) in tests {
        if let Some(program) = Compiled::new(source, Linked::Shared) {
            assert_eq!(program.run_on(&[]), expected, "{source}");
        }
    }
}

#[test]
fn a_member_by_cells_shows_each_body_once_in_c_and_in_cpp() {
    let tests = [
        (
            "tests/cells.c",
            "each body was shown once and within its bound\n",
        ),
        ("tests/cells.cpp", "the cells around were shown\n"),
    ];
    for (source, expected) in tests {
        if let Some(program) = Compiled::new(source, Linked::Shared) {
            let server = SERVER.serve_with("127.0.0.1:0", &["--cells", "10"]);
            assert_eq!(program.run_with(&server), expected, "{source}");
        }
    }
}

#[test]
fn followers_of_a_fed_scene_see_what_is_fed_and_ask_its_owner_in_c_and_in_cpp() {
    for source in ["tests/feeding.c", "tests/feeding.cpp"] {
        if let Some(program) = Compiled::new(source, Linked::Shared) {
            let out = program.run_on(&[]);
            assert_eq!(out, "the followers saw what was fed\n", "{source}");
        }
    }
}

#[test]
fn the_example_of_a_fed_scene_is_within_its_tolerance() {
    if let Some(program) = Compiled::new("examples/feed.c", Linked::Shared) {
        let out = program.run_on(&["200".to_owned(), "2".to_owned()]);
        let beyond = out
            .lines()
            .find_map(|line| line.strip_prefix("body-ticks beyond"));
        assert_eq!(beyond.map(str::trim), Some("0"), "{out}");
    }
}

#[test]
fn a_character_walks_and_a_vehicle_drives_in_c_and_in_cpp() {
    for source in ["tests/locomotion.c", "tests/locomotion.cpp"] {
        if let Some(program) = Compiled::new(source, Linked::Shared) {
            let server = SERVER.serve_without_log("127.0.0.1:0");
            let out = program.run_with(&server);
            assert_eq!(
                out, "the character walked and the vehicle drove\n",
                "{source}"
            );
        }
    }
}

#[test]
fn every_misuse_of_the_c_interface_is_an_error_and_none_does_harm() {
    if let Some(program) = Compiled::new("tests/misuse.c", Linked::Shared) {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server);
        assert_eq!(out, "every misuse was an error\n");
    }
}

#[test]
fn every_misuse_of_the_cpp_interface_is_an_exception() {
    if let Some(program) = Compiled::new("tests/misuse.cpp", Linked::Shared) {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server);
        assert_eq!(out, "every misuse was an exception\n");
    }
}

#[test]
fn a_static_object_of_the_cpp_interface_may_outlive_main() {
    if let Some(program) = Compiled::new("tests/static.cpp", Linked::Shared) {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server);
        assert_eq!(out, "both objects are left to the end\n");
    }
}

#[test]
fn an_installed_library_is_found_by_pkg_config_and_by_cmake() {
    let folder = TempDir::new().expect("a folder to install in");
    let (prefix, examples) = (folder.path(), root().join("bindings/c/examples"));
    let mut install = Command::new(root().join("bindings/c/install"));
    run_well(install.arg(prefix).arg("--from").arg(libraries()));
    let server = SERVER.serve("127.0.0.1:0");
    let drop_with = |program: &Path| {
        let mut command = Command::new(program);
        command.env("LD_LIBRARY_PATH", prefix.join("lib"));
        let out =
            run_well(command.args([server.address.to_string(), server.fingerprint.to_string()]));
        assert_eq!(out.lines().count(), 180, "{out}");
    };
    if has("pkg-config") {
        let mut flags = Command::new("pkg-config");
        flags.env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig"));
        let flags = run_well(flags.args(["--cflags", "--libs", "rhumb"]));
        let program = prefix.join("by-pkg-config");
        let mut compile = Command::new("cc");
        compile.arg(examples.join("drop.c")).arg("-o").arg(&program);
        run_well(compile.args(flags.split_whitespace()));
        drop_with(&program);
    }
    if has("cmake") {
        let build = prefix.join("build");
        let mut configure = Command::new("cmake");
        configure.arg("-S").arg(&examples).arg("-B").arg(&build);
        run_well(configure.arg(format!("-DCMAKE_PREFIX_PATH={}", prefix.display())));
        run_well(Command::new("cmake").arg("--build").arg(&build));
        drop_with(&build.join("drop_c"));
        drop_with(&build.join("drop_cpp"));
    }
}
