//! Godot as a process that obeys a test, frame by frame.

use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use rhumb_client::Tick;
use rhumb_client::glam::{Quat, Vec3};
use tempfile::TempDir;

use crate::server::Server;

/// Frames after which a test gives up.
const FRAMES_MAX: u32 = 6_000;

/// Frames after which Godot ends by itself.
const QUIT_AFTER: &str = "20000";

/// Godot with the project in `tests/project`.
pub(crate) struct Agent {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    /// Sentences of the agent's own: what was joined, failed, ended.
    pub(crate) said: Vec<String>,
    folder: TempDir,
}

/// The bodies that the nodes show in a frame.
#[derive(Debug, Default)]
pub(crate) struct Frame {
    pub(crate) tick: f64,
    pub(crate) bodies: Vec<ShownBody>,
}

/// The node of a body.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShownBody {
    pub(crate) id: u64,
    pub(crate) position: Vec3,
    pub(crate) rotation: Quat,
    /// Metres; infinite if unknown.
    pub(crate) bound: f64,
    /// m/s upwards.
    pub(crate) rising: f32,
}

impl Frame {
    pub(crate) fn body(&self, id: u64) -> Option<ShownBody> {
        self.bodies.iter().find(|body| body.id == id).copied()
    }

    /// The tick that the nodes show, in a lockstep scene.
    pub(crate) fn shown(&self) -> Tick {
        Tick::new(self.tick as u64)
    }
}

/// Godot's program; `None` where there is none.
pub(crate) fn godot() -> Option<PathBuf> {
    let named = std::env::var_os("RHUMB_TEST_GODOT").map(PathBuf::from);
    let path = named.clone().unwrap_or_else(|| "godot".into());
    let version = Command::new(&path).arg("--version").output();
    match version {
        Ok(version) if version.stdout.starts_with(b"4.") => Some(path),
        _ => {
            assert!(named.is_none(), "{} is no Godot 4", path.display());
            eprintln!("left out: there is no Godot 4; RHUMB_TEST_GODOT names one");
            None
        }
    }
}

/// Copies a project to a folder of its own, with the extension that was built for this test.
pub(crate) fn project(from: &str) -> TempDir {
    let folder = TempDir::new().expect("a folder");
    let to = folder.path();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join(from);
    for entry in from.read_dir().expect("the project") {
        let path = entry.expect("a file of the project").path();
        if path.is_file() {
            std::fs::copy(&path, to.join(path.file_name().expect("a name"))).expect("a copy");
        }
    }
    let tests = std::env::current_exe().expect("this program");
    let library = tests.with_file_name("librhumb_godot.so");
    assert!(library.exists(), "there is no {}", library.display());
    let extension = format!(
        "[configuration]\nentry_symbol = \"gdext_rust_init\"\ncompatibility_minimum = 4.4\n\
         [libraries]\nlinux.x86_64 = \"{}\"\n",
        library.display()
    );
    std::fs::write(to.join("rhumb.gdextension"), extension).expect("a file");
    // The editor writes this list when it first opens a project.
    std::fs::create_dir_all(to.join(".godot")).expect("a folder");
    std::fs::write(
        to.join(".godot/extension_list.cfg"),
        "res://rhumb.gdextension\n",
    )
    .expect("a file");
    folder
}

impl Agent {
    /// Starts Godot; `None` where there is none.
    pub(crate) fn start(server: &Server, scene: &str, stepping: &str, depth: u32) -> Option<Self> {
        Self::start_with(&server.address, &server.fingerprint, scene, stepping, depth)
    }

    pub(crate) fn start_with(
        address: &str,
        fingerprint: &str,
        scene: &str,
        stepping: &str,
        depth: u32,
    ) -> Option<Self> {
        let godot = godot()?;
        let folder = project("tests/project");
        let errors = std::fs::File::create(folder.path().join("errors")).expect("a file");
        let mut child = Command::new(godot)
            .current_dir(folder.path())
            // A project that cannot be loaded reads nothing, and ends.
            .args([
                "--headless",
                "--fixed-fps",
                "60",
                "--quit-after",
                QUIT_AFTER,
                "--",
            ])
            .args([address, fingerprint, scene, stepping, &depth.to_string()])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(errors)
            .spawn()
            .expect("Godot starts");
        Some(Self {
            input: child.stdin.take().expect("a pipe"),
            output: BufReader::new(child.stdout.take().expect("a pipe")),
            child,
            said: Vec::new(),
            folder,
        })
    }

    /// Joins, and continues until the scene is joined.
    pub(crate) fn join(&mut self) -> Frame {
        self.frame();
        assert_eq!(self.eval("scene.join()"), "0");
        self.run_until("the scene is joined", |agent, _| agent.has_said("joined"))
    }

    /// True once a sentence of the agent's begins like this.
    pub(crate) fn has_said(&self, beginning: &str) -> bool {
        self.said.iter().any(|said| said.starts_with(beginning))
    }

    /// The errors that Godot has logged.
    pub(crate) fn errors(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("errors")).expect("a file")
    }

    /// The next frame, after which Godot waits for [`Self::eval`] and [`Self::go`].
    pub(crate) fn frame(&mut self) -> Frame {
        let mut frame = Frame::default();
        loop {
            let line = self.line();
            let mut words = line.split(' ');
            match words.next() {
                Some("body") => {
                    let id = words.next().and_then(|id| id.parse().ok()).expect("an id");
                    let numbers: Vec<f64> =
                        words.map(|word| word.parse().expect("a number")).collect();
                    let single = |place: usize| numbers[place] as f32;
                    frame.bodies.push(ShownBody {
                        id,
                        position: Vec3::new(single(0), single(1), single(2)),
                        rotation: Quat::from_xyzw(single(3), single(4), single(5), single(6)),
                        bound: numbers[7],
                        rising: single(8),
                    });
                }
                Some("frame") => {
                    frame.tick = words
                        .next()
                        .and_then(|tick| tick.parse().ok())
                        .expect("a tick");
                    return frame;
                }
                _ => {}
            }
        }
    }

    /// The value of an expression of GDScript, in which `scene` and `agent` are nodes.
    pub(crate) fn eval(&mut self, expression: &str) -> String {
        self.write(expression);
        loop {
            if let Some(value) = self.line().strip_prefix("= ") {
                return value.to_owned();
            }
        }
    }

    /// The number that an expression has.
    pub(crate) fn number(&mut self, expression: &str) -> u64 {
        let value = self.eval(expression);
        value
            .parse()
            .unwrap_or_else(|_| panic!("{expression} is {value}; {}", self.errors()))
    }

    /// Ends the frame.
    pub(crate) fn go(&mut self) {
        self.write("go");
    }

    /// Ends the frame, and returns the next one.
    pub(crate) fn step(&mut self) -> Frame {
        self.go();
        self.frame()
    }

    /// Runs frames until something holds.
    pub(crate) fn run_until(
        &mut self,
        what: &str,
        mut holds: impl FnMut(&mut Self, &Frame) -> bool,
    ) -> Frame {
        for _ in 0..FRAMES_MAX {
            let frame = self.step();
            if holds(self, &frame) {
                return frame;
            }
            self.eval("agent.rest()");
        }
        panic!("not in {FRAMES_MAX} frames: {what}; {}", self.errors());
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        let read = self
            .output
            .read_line(&mut line)
            .expect("the output is text");
        assert!(read > 0, "Godot has ended: {}", self.errors());
        let line = line.trim_end();
        if let Some(said) = line.strip_prefix("> ") {
            self.said.push(said.to_owned());
        }
        line.to_owned()
    }

    fn write(&mut self, line: &str) {
        let written = writeln!(self.input, "{line}").and_then(|()| self.input.flush());
        assert!(written.is_ok(), "Godot has ended: {}", self.errors());
    }
}

impl Drop for Agent {
    fn drop(&mut self) {
        // It may have ended already.
        let _ended = self.child.kill();
        let _ended = self.child.wait();
    }
}
