//! Finds the web client for the page, or notes why there is none.
//!
//! A package has it beside this file: `pack` put it there. A checkout compiles it.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

/// Folders whose change changes the web client, from the root of the repository.
const SOURCES: [&str; 6] = [
    "bindings/web/Cargo.toml",
    "bindings/web/src",
    "client/view",
    "protocol/src",
    "reckoning/src",
    "Cargo.lock",
];
/// The web client, from the root of the repository.
const CLIENT: &str = "bindings/web";
/// The folder of a package that has the web client, as `pack` makes it.
const PACKED: &str = "client";
/// The target of the web client.
const TARGET: &str = "wasm32-unknown-unknown";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed=build.rs");
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let own = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?);
    let root = own.join("..");
    for source in SOURCES.map(|source| root.join(source)) {
        if source.exists() {
            println!("cargo::rerun-if-changed={}", source.display());
        }
    }
    let (client, unavailable) = match client(&own, &out) {
        Ok(client) => (Some(client), String::new()),
        Err(reason) => {
            println!("cargo::warning=the page is left out: {reason}");
            // A file that is never there: the next build tries again, for what is missing may be installed by then.
            println!("cargo::rerun-if-changed={}", out.join("missing").display());
            (None, reason)
        }
    };
    println!("cargo::rustc-env=RHUMB_VIEWER_UNAVAILABLE={unavailable}");
    fs::write(out.join("assets.rs"), table(client.as_ref())?)?;
    Ok(())
}

/// Files of the web client.
struct WebClient {
    module: PathBuf,
    /// The folder of its scripts.
    scripts: PathBuf,
}

/// The table of assets, as Rust code: files of the page, kept libraries, and the web client.
fn table(client: Option<&WebClient>) -> Result<String, Box<dyn Error>> {
    let mut files = Vec::new();
    let own = PathBuf::from(env::var("CARGO_MANIFEST_DIR")?);
    collect("", &own.join("page"), &mut files)?;
    for library in ["three", "fzstd"] {
        let folder = own.join("vendor").join(library);
        collect(&format!("/{library}"), &folder, &mut files)?;
    }
    if let Some(client) = client {
        files.push(("/client/rhumb.wasm".to_owned(), client.module.clone()));
        for entry in fs::read_dir(&client.scripts)? {
            let name = entry?.file_name().into_string();
            let name = name.map_err(|_| "a name is no text")?;
            if name.ends_with(".js") {
                let script = client.scripts.join(&name);
                println!("cargo::rerun-if-changed={}", script.display());
                files.push((format!("/client/{name}"), script));
            }
        }
    }
    let mut code = String::from("&[\n");
    for (path, file) in files {
        let path = if path == "/index.html" { "/" } else { &path };
        let content_type = content_type(&file)?;
        code += &format!(
            "Asset {{ path: {path:?}, content_type: {content_type:?}, bytes: include_bytes!({file:?}) }},\n"
        );
    }
    Ok(code + "]\n")
}

/// Adds the files below a folder, with their paths on the server.
fn collect(
    path: &str,
    folder: &Path,
    files: &mut Vec<(String, PathBuf)>,
) -> Result<(), Box<dyn Error>> {
    println!("cargo::rerun-if-changed={}", folder.display());
    let mut entries = fs::read_dir(folder)?.collect::<Result<Vec<_>, _>>()?;
    entries.sort_by_key(fs::DirEntry::file_name);
    for entry in entries {
        let name = entry
            .file_name()
            .into_string()
            .map_err(|_| "a name is no text")?;
        let path = format!("{path}/{name}");
        if entry.file_type()?.is_dir() {
            collect(&path, &entry.path(), files)?;
        } else {
            files.push((path, entry.path()));
        }
    }
    Ok(())
}

fn content_type(file: &Path) -> Result<&'static str, String> {
    let name = file.to_string_lossy();
    let ending = file.extension().and_then(|ending| ending.to_str());
    match ending {
        Some("html") => Ok("text/html; charset=utf-8"),
        Some("css") => Ok("text/css; charset=utf-8"),
        Some("js") => Ok("text/javascript; charset=utf-8"),
        Some("svg") => Ok("image/svg+xml"),
        Some("wasm") => Ok("application/wasm"),
        _ if name.ends_with("LICENSE") => Ok("text/plain; charset=utf-8"),
        _ => Err(format!("{name} has no known type")),
    }
}

/// The web client: that of the package, or the checkout's, compiled into the folder of outputs.
fn client(own: &Path, out: &Path) -> Result<WebClient, String> {
    let folder = own.join("..").join(CLIENT);
    if !folder.join("Cargo.toml").exists() {
        let scripts = own.join(PACKED);
        let module = scripts.join("rhumb.wasm");
        return match module.exists() {
            true => Ok(WebClient { module, scripts }),
            false => Err(format!(
                "{} is missing: run `viewer/pack` before `cargo package`",
                module.display()
            )),
        };
    }
    let installed = run(Command::new(variable("RUSTC")?).args([
        "--print",
        "target-libdir",
        "--target",
        TARGET,
    ]))?;
    if !Path::new(installed.trim()).exists() {
        return Err(format!("run `rustup target add {TARGET}` and build again"));
    }
    let target = target_folder(out)?;
    let mut cargo = Command::new(variable("CARGO")?);
    cargo
        .args([
            "build",
            "--profile",
            "web",
            "--locked",
            "--lib",
            "--target",
            TARGET,
            "--target-dir",
        ])
        .arg(&target)
        .arg("--manifest-path")
        .arg(folder.join("Cargo.toml"));
    for (name, _) in env::vars().filter(|(name, _)| concerns_this_build(name)) {
        cargo.env_remove(name);
    }
    run(&mut cargo)?;
    let built = target.join(TARGET).join("web/rhumb_web.wasm");
    let module = out.join("rhumb.wasm");
    fs::copy(&built, &module).map_err(|cause| format!("{}: {cause}", built.display()))?;
    Ok(WebClient {
        module,
        scripts: folder,
    })
}

/// The folder in which every build of this workspace, and `bindings/web/build`, compiles the web client: once for all of
/// them. It is not that of this build, whose lock is held.
fn target_folder(out: &Path) -> Result<PathBuf, String> {
    // OUT_DIR is target/PROFILE/build/PACKAGE/out, or has a folder of the target before PROFILE.
    let mut above = out
        .ancestors()
        .skip_while(|folder| !folder.ends_with("build"));
    above
        .nth(2)
        .map(|folder| folder.join("web-client"))
        .ok_or_else(|| format!("{} is no folder of a build script", out.display()))
}

/// True for a variable of the environment that sets flags, wrappers or folders of the build that this one is part of.
fn concerns_this_build(name: &str) -> bool {
    let flags = [
        "RUSTFLAGS",
        "RUSTC_WORKSPACE_WRAPPER",
        "CLIPPY_ARGS",
        "TARGET",
        "HOST",
        "PROFILE",
        "OPT_LEVEL",
        "DEBUG",
    ];
    let prefixes = [
        "CARGO_ENCODED_",
        "CARGO_BUILD_",
        "CARGO_CFG_",
        "CARGO_FEATURE_",
        "CARGO_MANIFEST_",
        "CARGO_PKG_",
        "CARGO_PROFILE_",
        "CARGO_TARGET_",
        "CARGO_UNSTABLE_",
    ];
    flags.contains(&name) || prefixes.iter().any(|prefix| name.starts_with(prefix))
}

fn variable(name: &str) -> Result<String, String> {
    env::var(name).map_err(|cause| format!("{name}: {cause}"))
}

/// Runs a command to its end; returns what it printed.
fn run(command: &mut Command) -> Result<String, String> {
    let program = command.get_program().to_string_lossy().into_owned();
    let output = command
        .output()
        .map_err(|cause| format!("{program}: {cause}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    let errors = String::from_utf8_lossy(&output.stderr);
    for line in errors.lines() {
        println!("cargo::warning={line}");
    }
    let first = errors.lines().find(|line| line.starts_with("error"));
    Err(format!(
        "the web client does not compile: {}",
        first.unwrap_or("see the warnings of rhumb-viewer")
    ))
}
