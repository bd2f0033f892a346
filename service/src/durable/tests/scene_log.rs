//! The log of a scene whose disk breaks or hangs, and works again.
//!
//! The log's own thread writes on a simulated disk. The scene that is restored at the end must equal the recorded run.

use std::sync::Arc;

use rhumb_protocol::scene::{Command, SceneConfig, Shape, ShapeId};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_scene::engine::StepThreads;
use rhumb_scene::{Batch, CommandLog, Frozen, Limits, Ownership, SceneStore};
use rhumb_transport::Clock;

use super::sim_disk::SimDisk;
use super::{Recorded, files, name};
use crate::durable::StoredScenes;
use crate::durable::data_dir::{DataDir, Room};
use crate::durable::disk::Disk;
use crate::durable::recovery::{LogTail, ReplayStart};
use crate::durable::scene_files::Generation;
use crate::durable::writer::{Origin, SceneLog, WAITING_BYTES_MAX};

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    let clock = Clock::start();
    let end = Instant::ZERO + Span::from_millis(20_000);
    while !is_so() {
        assert!(clock.now() < end, "{what}");
        std::thread::yield_now();
    }
}

/// A recorded scene, and its log on a disk of its own.
struct Logged {
    recorded: Recorded,
    disk: SimDisk,
    log: SceneLog,
}

impl Logged {
    fn on(disk: SimDisk) -> Self {
        Self::within(disk, &Limits::default())
    }

    fn within(disk: SimDisk, limits: &Limits) -> Self {
        let origin = Origin {
            name: name(),
            config: SceneConfig::default(),
            tick: Tick::ZERO,
            segment: 0,
            previous: None,
        };
        let room = Room::new((Arc::new(disk.clone()), "scenes".into()), limits);
        let log = SceneLog::start((files(&disk), room), origin, Arc::new(|| {}));
        Self {
            recorded: Recorded::new(11),
            disk,
            log: log.expect("the log has a thread"),
        }
    }

    /// On a disk that works; the first batch is durable.
    fn begun() -> Self {
        let mut logged = Self::on(SimDisk::default());
        let first = logged.append();
        wait_until("durable at first", || logged.log.durable() == first);
        logged
    }

    /// Steps, and hands the records over.
    fn append(&mut self) -> u64 {
        self.recorded.tick();
        let batch = self.recorded.scene.record_mut().take_batch();
        self.log.append(batch.expect("a step is recorded"))
    }

    /// Hands a snapshot of the present state over.
    fn snapshot(&mut self) {
        let scene = &self.recorded.scene;
        self.log.snapshot(Frozen {
            tick: scene.tick(),
            digest: scene.digest(),
            sessions: self.recorded.sessions.clone(),
            ownership: Ownership::default(),
            scene: scene.freeze().expect("a step was the last change"),
        });
    }

    /// Hands a snapshot over, which makes the log whole.
    fn mend(&mut self) {
        self.snapshot();
        wait_until("the log is whole again", || !self.log.is_broken());
    }

    /// Waits until everything is durable. Then the log ends, and the machine loses each name that was not
    /// synchronised: the files have the newest state.
    fn must_be_restored(mut self) {
        let last = self.append();
        wait_until("durable again", || self.log.durable() == last);
        drop(self.log);
        self.disk.crash(|n| n - 1);
        let newest = (ReplayStart::Newest, LogTail::Kept);
        let restored = files(&self.disk).restore(&StepThreads::default(), newest, &mut || {});
        let restored = restored.expect("the files are whole");
        let restored = restored.expect("the scene is durable");
        let checked = self.recorded.check(&restored);
        checked.expect("the scene is as it was recorded");
        assert_eq!(restored.scene.tick(), self.recorded.scene.tick());
    }
}

/// A log whose disk breaks and works again: nothing is acknowledged until a snapshot has made it whole.
fn a_disk_breaks(breaks: impl Fn(&SimDisk), works: impl Fn(&SimDisk)) {
    let mut logged = Logged::begun();
    let first = logged.log.durable();
    breaks(&logged.disk);
    logged.append();
    wait_until("the log breaks", || logged.log.is_broken());
    logged.append();
    assert_eq!(logged.log.durable(), first);
    works(&logged.disk);
    logged.mend();
    logged.must_be_restored();
}

#[test]
fn a_full_disk_ends_the_acknowledgements_until_a_snapshot_finds_room() {
    a_disk_breaks(|disk| disk.set_room(Some(10)), |disk| disk.set_room(None));
}

#[test]
fn a_file_whose_synchronisation_failed_is_not_trusted_again() {
    a_disk_breaks(
        |disk| disk.set_failing(true),
        |disk| disk.set_failing(false),
    );
}

#[test]
fn a_snapshot_of_a_state_that_the_scene_has_left_does_not_make_the_log_whole() {
    let mut logged = Logged::begun();
    let held = logged.disk.hold_syncs();
    let written = logged.append();
    wait_until("the disk hangs", || held.has_one());
    logged.snapshot();
    logged.log.give_up();
    logged.append();
    drop(held);
    wait_until("the snapshot is done with", || logged.log.may_snapshot());
    assert!(logged.log.is_broken());
    logged.append();
    assert_eq!(logged.log.durable(), written);
    logged.mend();
    logged.must_be_restored();
}

/// Hands over 100 MiB that the disk does not take.
fn overload(log: &mut SceneLog) {
    let batch = || Batch {
        tick: Tick::ZERO,
        records: vec![0; 1 << 20],
    };
    let most = WAITING_BYTES_MAX + batch().memory_bytes();
    for _ in 0..100 {
        log.append(batch());
        assert!(log.waiting_bytes() <= most);
    }
    assert!(log.is_broken());
}

#[test]
fn what_waits_for_a_disk_that_hangs_is_bounded() {
    let mut logged = Logged::begun();
    let held = logged.disk.hold_syncs();
    logged.append();
    wait_until("the disk hangs", || held.has_one());
    overload(&mut logged.log);
    logged.snapshot();
    overload(&mut logged.log);
    drop(held);
    wait_until("nothing waits", || logged.log.waiting_bytes() == 0);
    wait_until("the snapshot is done with", || logged.log.may_snapshot());
    assert!(logged.log.is_broken());
    logged.mend();
    logged.must_be_restored();
}

#[test]
fn batches_behind_the_snapshot_that_makes_the_log_whole_are_kept() {
    let mut logged = Logged::begun();
    logged.log.give_up();
    logged.append();
    let held = logged.disk.hold_syncs();
    logged.snapshot();
    wait_until("the disk hangs", || held.has_one());
    logged.append();
    logged.append();
    drop(held);
    logged.must_be_restored();
}

#[test]
fn the_directory_of_a_new_scene_is_durable_with_its_log() {
    Logged::begun().must_be_restored();
}

#[test]
fn a_scene_whose_directory_could_not_be_made_is_durable_after_a_snapshot() {
    let disk = SimDisk::default();
    disk.set_refusing_directories(true);
    let mut logged = Logged::on(disk);
    wait_until("the log breaks", || logged.log.is_broken());
    logged.append();
    logged.disk.set_refusing_directories(false);
    logged.mend();
    logged.must_be_restored();
}

#[test]
fn a_snapshot_between_two_steps_has_the_shapes_that_came_since() {
    let mut logged = Logged::begun();
    for round in 0..3 {
        let id = ShapeId(100 + round);
        let shape = Shape::ball(0.25);
        (logged.recorded).command(&Command::AddShape { id, shape });
        let batch = logged.recorded.scene.record_mut().take_batch();
        logged.log.append(batch.expect("a command is recorded"));
        logged.snapshot();
        wait_until("the snapshot is written", || logged.log.may_snapshot());
        (logged.recorded).command(&Command::RemoveShape { id });
        logged.append();
    }
    logged.must_be_restored();
}

#[test]
fn a_body_that_changed_since_the_last_step_forbids_a_snapshot() {
    let mut logged = Logged::begun();
    assert!(logged.recorded.scene.freeze().is_some());
    let gravity = glam::Vec3::ZERO;
    (logged.recorded).command(&Command::SetGravity { gravity });
    assert!(logged.recorded.scene.freeze().is_none());
}

#[test]
fn a_log_in_a_full_directory_waits_for_room_and_goes_on() {
    let disk = SimDisk::default();
    // The scene has no tenant: what a tenant's part refuses, the tests of `Room` say.
    let limits = Limits {
        data_mib: 1,
        ..Limits::default()
    };
    let (others, file) = ("scenes/other.1", "scenes/other.1/00000000.log");
    disk.make_directory(others.as_ref()).expect("a directory");
    let mut other = disk.create(file.as_ref()).expect("a file");
    other.append(&vec![0; 1 << 20]).expect("a disk with room");
    let mut logged = Logged::within(disk.clone(), &limits);
    let first = logged.append();
    wait_until("the log breaks off", || logged.log.is_broken());
    logged.snapshot();
    wait_until("the snapshot is tried", || logged.log.may_snapshot());
    assert!(logged.log.is_broken() && logged.log.durable() < first);
    disk.remove(file.as_ref()).expect("it is there");
    logged.mend();
    logged.must_be_restored();
}

/// A directory of several servers, and a log that one of them begins there by a claim of epoch 5.
fn of_a_claim() -> (tempfile::TempDir, DataDir, Logged) {
    let folder = tempfile::tempdir().expect("a directory");
    let data = DataDir::open_shared(folder.path()).expect("it is free");
    let origin = Origin {
        name: name(),
        config: SceneConfig::default(),
        tick: Tick::ZERO,
        segment: 0,
        previous: None,
    };
    let room = Room::new(data.scenes_on_disk(), &Limits::default());
    let files = data.files_to_make(&name(), Generation(5));
    let log = SceneLog::start((files, room), origin, Arc::new(|| {}));
    let logged = Logged {
        recorded: Recorded::new(11),
        disk: SimDisk::default(),
        log: log.expect("the log has a thread"),
    };
    (folder, data, logged)
}

fn take(data: &DataDir, epoch: u64) -> Generation {
    let taken = data.take_over(&[(name(), epoch)], &|| true);
    let taken = taken.expect("the directory is there").pop();
    taken.expect("one scene").expect("its files are there")
}

#[test]
fn a_log_whose_files_were_taken_over_makes_no_others() {
    let (folder, data, mut logged) = of_a_claim();
    let first = logged.append();
    wait_until("durable", || logged.log.durable() == first);
    assert_eq!(take(&data, 6), Generation(6));
    logged.snapshot();
    wait_until("broken", || logged.log.is_broken());
    logged.append();
    logged.snapshot();
    logged.append();
    drop(logged.log);
    let names = std::fs::read_dir(folder.path().join("scenes")).expect("it is there");
    let names = names.map(|entry| entry.expect("a name").file_name());
    assert_eq!(names.collect::<Vec<_>>(), ["pit.6"]);
}

#[test]
fn a_restoration_under_a_claim_that_is_over_leaves_the_files_of_the_owner_alone() {
    let (folder, data, mut logged) = of_a_claim();
    let first = logged.append();
    wait_until("durable at first", || logged.log.durable() == first);
    let stale = DataDir::open_shared(folder.path()).expect("it is shared");
    let stored = StoredScenes::new(
        (stale, &Limits::default()),
        StepThreads::default(),
        Arc::new(|| {}),
    );
    // Its server had the scene, was frozen and has just been woken; then it ends.
    stored.take(Generation(4));
    let newest = (LogTail::Kept, None);
    let restored = stored.restore(&name(), newest, &|| Instant::ZERO, &mut || {});
    assert!(restored.is_none() && !stored.is_damaged(&name()));
    for _ in 0..5 {
        let last = logged.append();
        wait_until("durable", || logged.log.durable() == last);
    }
    let tick = logged.recorded.scene.tick();
    drop(logged.log);
    let generation = take(&data, 8);
    let files = data.files_of(&name(), generation).expect("it is read");
    let newest = (ReplayStart::Newest, LogTail::Kept);
    let restored =
        (files.expect("it is there")).restore(&StepThreads::default(), newest, &mut || {});
    let restored = restored.expect("it is whole").expect("it is there");
    assert_eq!(restored.scene.tick(), tick);
}
