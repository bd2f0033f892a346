//! Data directories on real disks: full, read-only, hanging, or damaged.
//!
//! The full and the read-only one are a small `tmpfs` of their own, the hanging one an image of `ext4` that is frozen. Both
//! need the right to mount: without it, those tests say so and end. `service/src/durable/tests.rs` tries every byte and
//! every crash on a simulated disk.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use rhumb_client::{Client, Denial, JoinMode, JoinOptions, OpenError, Trust};
use rhumb_reckoning::BodyId;
use rhumb_tests::{ServerProcess, signal};

use crate::SERVER;
use crate::durable::{
    Seen, check, commands, create, digest_without_server, serve, step, take_events,
};

/// Disks of loaded machines take seconds.
const LONG: Duration = Duration::from_secs(60);

/// A file system in memory of a few hundred kilobytes; unmounted when dropped.
struct SmallDisk(tempfile::TempDir);

impl SmallDisk {
    fn mount() -> Option<Self> {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let at = directory.path().to_owned();
        let mounted = mount(&["-t", "tmpfs", "-o", "size=900k", "tmpfs"], &at);
        if !mounted {
            eprintln!("not tried: this user may not mount a file system");
        }
        mounted.then_some(Self(directory))
    }

    fn path(&self) -> &Path {
        self.0.path()
    }

    /// Fills it to the last byte; the file to remove for room.
    fn fill(&self) -> PathBuf {
        let path = self.path().join("filler");
        let mut file = fs::File::create(&path).expect("a file");
        while file.write_all(&[0; 512]).is_ok() {}
        path
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        // A directory that stays mounted lies among temporary files.
        let _ = Command::new("umount").arg("-l").arg(self.path()).status();
    }
}

/// A file system of its own on which writes can be made to wait; unmounted when dropped.
struct HangingDisk(tempfile::TempDir);

impl HangingDisk {
    fn mount() -> Option<Self> {
        let directory = tempfile::tempdir().expect("a temporary directory");
        let disk = Self(directory);
        let image = disk.0.path().join("image");
        let file = fs::File::create(&image).expect("a file");
        file.set_len(64 << 20).expect("room for holes");
        fs::create_dir(disk.path()).expect("a directory");
        let image = image.to_str().expect("text");
        let is_there = succeeds("mkfs.ext4", &["-q", "-F", image])
            && mount(&["-o", "loop", image], &disk.path());
        if !is_there {
            eprintln!("not tried: this user may not mount an image of a file system");
        }
        is_there.then_some(disk)
    }

    fn path(&self) -> PathBuf {
        self.0.path().join("disk")
    }

    /// Lets what has begun be written, and then nothing more.
    fn hang(&self) -> Hang<'_> {
        assert!(self.freeze("--freeze"), "it is mounted");
        Hang(self)
    }

    fn freeze(&self, what: &str) -> bool {
        succeeds("fsfreeze", &[what, self.path().to_str().expect("text")])
    }
}

impl Drop for HangingDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.path()).status();
    }
}

/// Writes wait as long as it lives. A server that is killed ends only after it.
struct Hang<'a>(&'a HangingDisk);

impl Drop for Hang<'_> {
    fn drop(&mut self) {
        self.0.freeze("--unfreeze");
    }
}

fn mount(arguments: &[&str], at: &Path) -> bool {
    let at = at.to_str().expect("text");
    succeeds("mount", &[arguments, &[at]].concat())
}

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    let output = Command::new(program).args(arguments).output();
    output.is_ok_and(|output| output.status.success())
}

/// A run that advances tick by tick.
struct Run {
    client: Client,
    ids: Vec<BodyId>,
    tick: u64,
    sent: u64,
    seen: Seen,
}

impl Run {
    /// A server with this data directory, and a run of some ticks of which everything is durable.
    fn until_durable_in(data: &Path, ticks: u64) -> (ServerProcess, Self) {
        let server = serve("127.0.0.1:0", data);
        let (client, ids) = create(&server);
        let mut run = Self {
            client,
            ids,
            tick: 0,
            sent: 0,
            seen: Seen::default(),
        };
        run.go(ticks);
        run.until_durable();
        (server, run)
    }

    fn go(&mut self, ticks: u64) {
        for _ in 0..ticks {
            for command in commands(self.tick, &self.ids) {
                self.client.command(command).expect("the session continues");
                self.sent += 1;
            }
            step(&mut self.client);
            take_events(&mut self.client, &mut self.seen);
            self.tick += 1;
        }
    }

    /// Waits until everything sent so far is durable.
    fn until_durable(&mut self) {
        let sent = self.sent;
        let begun = Instant::now();
        while self.seen.durable < sent {
            assert!(begun.elapsed() < LONG, "nothing becomes durable");
            self.go(1);
            // A disk under load takes longer than thousands of ticks.
            self.client
                .idle(Duration::from_millis(2))
                .expect("the session continues");
        }
    }

    fn must_be_right(&mut self) {
        let truth = self.client.inspect().expect("the server answers");
        assert_eq!(truth.truth, digest_without_server(self.tick, &self.ids));
    }
}

#[test]
fn a_disk_that_hangs_stops_no_scene_and_what_it_has_not_written_is_not_durable() {
    let Some(disk) = HangingDisk::mount() else {
        return;
    };
    let data = disk.path().join("data");
    let (server, mut run) = Run::until_durable_in(&data, 20);
    let address = server.address.to_string();
    for _ in 0..2 {
        let hang = disk.hang();
        let written = run.sent;
        run.go(30);
        // Another scene needs a directory that cannot be made now: its client waits, and no one else.
        let (address, trust) = (address.clone(), Trust::Fingerprint(server.fingerprint));
        let another = thread::spawn(move || {
            let connection = Client::connect(&address, trust).expect("the server answers");
            connection.join("another").map(drop)
        });
        run.go(30);
        assert!(run.seen.durable <= written, "nothing was written");
        drop(hang);
        another.join().expect("a thread").expect("a scene");
        run.until_durable();
    }
    let hang = disk.hang();
    run.go(30);
    signal(server.id(), "KILL");
    drop(hang);
    drop(server);
    let _server = serve(&address, &data);
    run.go(30);
    assert_eq!(run.seen.resumed, 1);
    run.must_be_right();
}

#[test]
fn a_full_disk_costs_acknowledgements_and_no_command() {
    let Some(disk) = SmallDisk::mount() else {
        return;
    };
    let data = disk.path().join("data");
    let (server, mut run) = Run::until_durable_in(&data, 20);
    let filler = disk.fill();
    run.go(150);
    assert!(run.seen.durable < run.sent, "a full disk keeps nothing");
    fs::remove_file(&filler).expect("the filler is there");
    run.until_durable();
    disk.fill();
    run.go(150);
    assert!(run.seen.durable < run.sent, "a full disk keeps nothing");
    // The server ends and begins again while the disk is full: the client has what was not durable.
    let listen = server.address.to_string();
    server.kill();
    let checked = check(&data);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
    let server = serve(&listen, &data);
    run.go(20);
    assert_eq!(run.seen.resumed, 1);
    run.must_be_right();
    fs::remove_file(&filler).expect("the filler is there");
    run.until_durable();
    server.kill();
    let server = serve(&listen, &data);
    run.go(5);
    run.must_be_right();
    drop(server);
}

#[test]
fn a_read_only_disk_is_named_and_can_be_checked() {
    let Some(disk) = SmallDisk::mount() else {
        return;
    };
    let data = disk.path().join("data");
    let (server, run) = Run::until_durable_in(&data, 20);
    server.kill();
    assert!(mount(&["-o", "remount,ro"], disk.path()));
    let path = data.to_str().expect("text");
    let refused = SERVER.run(&["--open", "--listen", "127.0.0.1:0", "--data", path]);
    assert_eq!(refused.code, Some(1), "{}", refused.log);
    assert!(refused.log.contains(path), "{}", refused.log);
    let checked = check(&data);
    assert_eq!(checked.code, Some(0), "{}{}", checked.out, checked.log);
    drop(run);
}

/// The files of the scene in a data directory, by name.
fn scene_files(data: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(data.join("scenes/pit.0")).expect("a scene");
    let mut files: Vec<_> = files.map(|entry| entry.expect("an entry").path()).collect();
    files.sort();
    files
}

#[test]
fn a_file_that_is_cut_or_missing_is_named_with_what_is_lost() {
    let directory = tempfile::tempdir().expect("a temporary directory");
    let data = directory.path().join("data");
    let (server, run) = Run::until_durable_in(&data, 30);
    let (listen, trust) = (
        server.address.to_string(),
        Trust::Fingerprint(server.fingerprint),
    );
    server.signal("TERM");
    assert_eq!(server.wait().code, Some(0));
    drop(run);
    let files = scene_files(&data);
    let log = files
        .iter()
        .rfind(|path| path.extension().is_some_and(|end| end == "log"));
    let log = log.expect("a log");
    let bytes = fs::read(log).expect("a log");
    // Between any two frames, and in the midst of the frames.
    let frames: Vec<_> = (1..bytes.len())
        .filter(|at| bytes[*at..].starts_with(b"RhF1"))
        .collect();
    let cuts = frames.iter().flat_map(|at| [*at, *at + 9]).chain([0, 1]);
    for cut in cuts {
        fs::write(log, &bytes[..cut]).expect("a writable file");
        let checked = check(&data);
        assert_eq!(checked.code, Some(1), "cut to {cut}: {}", checked.out);
        let name = log.display().to_string();
        let named = checked.out.contains(&name) && checked.out.contains("is lost, to tick");
        assert!(named, "cut to {cut}: {}", checked.out);
    }
    // A server does not serve a wrong world.
    let server = serve(&listen, &data);
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let joined = Client::connect(&listen, trust).expect("the server is there");
    let denied = joined.join_with("pit", options).err();
    assert!(
        matches!(
            denied,
            Some(OpenError::Denied {
                denial: Denial::SceneFaulted,
                ..
            })
        ),
        "{denied:?}"
    );
    server.kill();
    fs::write(log, &bytes).expect("a writable file");
    for missing in [log.clone(), log.with_file_name("head")] {
        let kept = fs::read(&missing).expect("a file");
        fs::remove_file(&missing).expect("a file");
        let checked = check(&data);
        assert_eq!(checked.code, Some(1), "{}", checked.out);
        let expected = format!("{}: missing", missing.display());
        assert!(checked.out.contains(&expected), "{}", checked.out);
        fs::write(&missing, kept).expect("a writable file");
    }
    assert_eq!(check(&data).code, Some(0));
}
