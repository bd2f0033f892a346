//! Programs in C#, compiled and run by Mono.

use std::path::{Path, PathBuf};
use std::process::Command;

use rhumb_tests::ServerProcess;
use tempfile::TempDir;

use super::script::expected;
use super::{has, libraries, root, run_well};
use crate::SERVER;

/// The sources of a folder.
fn sources(folder: &str) -> impl Iterator<Item = PathBuf> {
    let entries = std::fs::read_dir(root().join("bindings/csharp").join(folder));
    let paths = entries
        .expect("the sources")
        .map(|entry| entry.expect("a source").path());
    paths.filter(|path| path.extension().is_some_and(|end| end == "cs"))
}

/// A compiled program.
pub(super) struct Assembly {
    folder: TempDir,
}

impl Assembly {
    /// Compiles the library with one program; `None`, with a line that says so, without a compiler.
    pub(super) fn new(program: &str) -> Option<Self> {
        Self::with_sources(program, &[])
    }

    /// The same with more sources.
    pub(super) fn with_sources(program: &str, more: &[&Path]) -> Option<Self> {
        if !has("mcs") || !has("mono") {
            return None;
        }
        let folder = TempDir::new().expect("a folder for the program");
        let mut out = std::ffi::OsString::from("-out:");
        out.push(folder.path().join("program.exe"));
        let mut command = Command::new("mcs");
        command.args(["-unsafe", "-langversion:latest", "-warnaserror", "-warn:4"]);
        // Fields of C that no C# code names, and the header's documentation, which is not XML.
        command
            .args(["-nowarn:169,649,1591", "-r:System.Core"])
            .arg(out);
        let binding = root().join("bindings/csharp");
        let expectation = binding.join("tests/Expectation.cs");
        command
            .args(sources("src"))
            .arg(binding.join(program))
            .args(program.starts_with("tests/").then_some(expectation))
            .args(more);
        run_well(&mut command);
        Some(Self { folder })
    }

    pub(super) fn run_with(&self, server: &ServerProcess, more: &[String]) -> String {
        let arguments = [server.address.to_string(), server.fingerprint.to_string()];
        self.run_on(&[&arguments, more].concat())
    }

    /// Runs it with these arguments; returns what it wrote.
    pub(super) fn run_on(&self, arguments: &[String]) -> String {
        let mut command = Command::new("mono");
        command
            .arg("--debug")
            .arg(self.folder.path().join("program.exe"));
        command.env("LD_LIBRARY_PATH", libraries());
        run_well(command.args(arguments))
    }
}

#[test]
fn the_example_in_csharp_drops_a_ball_on_the_floor() {
    if let Some(program) = Assembly::new("examples/Drop.cs") {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server, &[]);
        assert_eq!(program.run_on(&[]), out, "in the process as on a server");
        assert_eq!(out.lines().count(), 180, "{out}");
        assert!(out.contains("\ntick 180: 0.000 0.5"), "{out}");
    }
}

#[test]
fn a_character_walks_and_a_vehicle_drives_in_csharp() {
    if let Some(program) = Assembly::new("tests/Locomotion.cs") {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let out = program.run_with(&server, &[]);
        assert_eq!(out, "the character walked and the vehicle drove\n");
    }
}

#[test]
fn a_member_by_cells_shows_what_it_takes_in_csharp() {
    if let Some(program) = Assembly::new("tests/Cells.cs") {
        let server = SERVER.serve_with("127.0.0.1:0", &["--cells", "10"]);
        assert_eq!(
            program.run_with(&server, &[]),
            "the cells around were shown\n"
        );
    }
}

#[test]
fn every_misuse_in_csharp_is_an_exception() {
    if let Some(program) = Assembly::new("tests/Misuse.cs") {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let process = server.id().to_string();
        assert_eq!(
            program.run_with(&server, &[process]),
            "every misuse was an exception\n"
        );
    }
}

#[test]
fn the_script_in_csharp_ends_with_the_hash_of_the_script_in_rust() {
    if let Some(program) = Assembly::new("tests/Script.cs") {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        let expected = expected(&server).line();
        assert_eq!(program.run_with(&server, &[]), expected);
    }
}

#[test]
fn the_whole_interface_of_c_is_reached_from_csharp() {
    if let Some(program) = Assembly::new("tests/Surface.cs") {
        let server = SERVER.serve_without_log("127.0.0.1:0");
        assert_eq!(
            program.run_with(&server, &[]),
            "the whole interface is reached\n"
        );
    }
}
