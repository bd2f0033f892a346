//! The plug-in for OpenSimulator, compiled and run by Mono.
//!
//! OpenSimulator is not part of this repository. The plug-in is compiled with declarations of the types that it uses, and
//! a program of ours is its region. Where `RHUMB_OPENSIM` names the folder `bin` of a built OpenSimulator, the plug-in is
//! compiled with that folder's assemblies too.

use std::io::{BufRead, BufReader, Write};
use std::net::UdpSocket;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use rhumb_tests::ServerProcess;
use tempfile::TempDir;

use super::{has, libraries, root, run_well};
use crate::SERVER;

/// The sources in C# of a folder of bindings.
fn sources(folder: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(root().join("bindings").join(folder)).expect("the sources");
    let paths = entries.map(|entry| entry.expect("a source").path());
    paths
        .filter(|path| path.extension().is_some_and(|end| end == "cs"))
        .collect()
}

/// Compiles sources to an assembly, with references.
fn compile(out: &Path, sources: &[PathBuf], references: &[PathBuf]) {
    let mut command = Command::new("mcs");
    let kind = match out.extension().is_some_and(|end| end == "exe") {
        true => "exe",
        false => "library",
    };
    command.args(["-unsafe", "-langversion:latest", "-warnaserror", "-warn:4"]);
    // Fields of C that no C# code names, and the header's documentation, which is not XML.
    command.args(["-nowarn:169,649,1591", "-r:System.Core"]);
    command.arg(format!("-target:{kind}"));
    command.arg(format!("-out:{}", out.display()));
    for reference in references {
        command.arg(format!("-r:{}", reference.display()));
    }
    run_well(command.args(sources));
}

/// Compiles the plug-in with references.
fn compile_plugin(out: &Path, references: &[PathBuf]) {
    let all = [sources("csharp/src"), sources("opensim/src")].concat();
    compile(out, &all, references);
}

/// A certificate in files, so that a server that starts again has the same fingerprint.
fn identity(folder: &Path) -> [String; 4] {
    let made = rcgen::generate_simple_self_signed(["localhost".to_owned()]).expect("a certificate");
    let (cert, key) = (folder.join("cert.pem"), folder.join("key.pem"));
    std::fs::write(&cert, made.cert.pem()).expect("writing the certificate");
    std::fs::write(&key, made.signing_key.serialize_pem()).expect("writing the key");
    [
        "--cert".to_owned(),
        cert.display().to_string(),
        "--key".to_owned(),
        key.display().to_string(),
    ]
}

/// A server at a fixed address.
fn serve(address: &str, identity: &[String; 4]) -> ServerProcess {
    SERVER.serve_with(address, &identity.each_ref().map(String::as_str))
}

#[test]
fn a_region_keeps_its_promises_and_outlives_the_server() {
    if !has("mcs") || !has("mono") {
        return;
    }
    let folder = TempDir::new().expect("a folder for the programs");
    let at = |name: &str| folder.path().join(name);
    let tests = |name: &str| root().join("bindings/opensim/tests").join(name);
    let signatures = [at("Signatures.dll")];
    compile(&signatures[0], &[tests("Signatures.cs")], &[]);
    compile_plugin(&at("Rhumb.OpenSim.dll"), &signatures);
    let region = [tests("Host.cs"), tests("Region.cs")];
    compile(&at("region.exe"), &region, &signatures);

    let identity = identity(folder.path());
    // A port that is free now; the server that starts again needs the same one.
    let free = UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr());
    let address = free.expect("a free port").to_string();
    let server = serve(&address, &identity);
    let mut region = Command::new("mono")
        .arg("--debug")
        .args([at("region.exe"), at("Rhumb.OpenSim.dll")])
        .args([server.address.to_string(), server.fingerprint.to_string()])
        .env("LD_LIBRARY_PATH", libraries())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .expect("running the region");
    let mut answers = region.stdin.take().expect("its input is piped");
    let mut server = Some(server);
    let mut lines = Vec::new();
    let out = BufReader::new(region.stdout.take().expect("its output is piped"));
    for line in out.lines() {
        let line = line.expect("its output is text");
        match line.as_str() {
            "stop the server" => server.as_ref().expect("a running server").signal("STOP"),
            "continue the server" => server.as_ref().expect("a stopped server").signal("CONT"),
            "kill the server" => server.take().expect("a running server").kill(),
            "start the server" => server = Some(serve(&address, &identity)),
            _ => {}
        }
        if line.ends_with("the server") {
            writeln!(answers, "done").expect("the region reads");
        }
        lines.push(line);
    }
    let status = region.wait().expect("waiting for the region");
    assert!(status.success(), "{status}: {lines:?}");
    let expected = [
        "stop the server",
        "continue the server",
        "kill the server",
        "start the server",
        "the region kept every promise",
    ];
    assert_eq!(lines, expected);
}

#[test]
fn the_plugin_compiles_with_the_assemblies_of_opensimulator() {
    let bin = std::env::var_os("RHUMB_OPENSIM").map(PathBuf::from);
    let named = bin.filter(|bin| bin.join("OpenSim.Region.Physics.Manager.dll").exists());
    // Not a tool that a machine can be asked to have: the test runs where a folder is named.
    let Some(bin) = named else {
        eprintln!("RHUMB_OPENSIM names no folder with OpenSimulator's assemblies, left out");
        return;
    };
    if !has("mcs") {
        return;
    }
    let folder = TempDir::new().expect("a folder for the plug-in");
    let names = [
        "OpenSim.Region.Physics.Manager",
        "OpenSim.Framework",
        "OpenMetaverseTypes",
        "OpenMetaverse",
        "log4net",
        "Nini",
    ];
    let references = names.map(|name| bin.join(format!("{name}.dll")));
    let plugin = folder.path().join("Rhumb.OpenSim.dll");
    compile_plugin(&plugin, &references);
    assert!(plugin.exists());
}
