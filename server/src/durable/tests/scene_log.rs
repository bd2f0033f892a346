//! The log of a scene whose disk breaks and works again.
//!
//! The log's own thread writes on a simulated disk. What is restored at the end must equal the recorded run.

use std::sync::Arc;

use rhumb_protocol::scene::SceneConfig;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::Tick;
use rhumb_transport::Clock;

use super::{Recorded, files, name};
use crate::access::Ownership;
use crate::durable::log_tail::LogTail;
use crate::durable::recovery::ReplayStart;
use crate::durable::sim_disk::SimDisk;
use crate::durable::writer::{Frozen, Origin, SceneLog};
use crate::engine::Workers;

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    let clock = Clock::start();
    let end = Instant::ZERO + Span::from_millis(20_000);
    while !is_so() {
        assert!(clock.now() < end, "{what}");
        std::thread::yield_now();
    }
}

/// A log whose disk breaks and works again: nothing is acknowledged until a snapshot has made it whole.
fn a_disk_breaks(breaks: impl Fn(&SimDisk), works: impl Fn(&SimDisk)) {
    let mut recorded = Recorded::new(11);
    let disk = SimDisk::default();
    let origin = Origin {
        name: name(),
        config: SceneConfig::default(),
        tick: Tick::ZERO,
        segment: 0,
        previous: None,
    };
    let mut log = SceneLog::start(files(&disk), origin, Arc::new(|| {})).unwrap();
    let append = |recorded: &mut Recorded, log: &mut SceneLog| {
        recorded.tick();
        log.append(recorded.scene.journal_mut().unwrap().take().unwrap())
    };
    let first = append(&mut recorded, &mut log);
    wait_until("durable at first", || log.durable() == first);
    breaks(&disk);
    append(&mut recorded, &mut log);
    wait_until("the log breaks", || log.is_broken());
    append(&mut recorded, &mut log);
    assert_eq!(log.durable(), first);
    works(&disk);
    let frozen = Frozen {
        tick: recorded.scene.tick(),
        digest: recorded.scene.digest(),
        sessions: recorded.sessions.clone(),
        ownership: Ownership::default(),
        scene: recorded.scene.freeze().unwrap(),
    };
    log.snapshot(frozen);
    wait_until("the log is whole again", || !log.is_broken());
    let last = append(&mut recorded, &mut log);
    wait_until("durable again", || log.durable() == last);
    drop(log);
    let restored = files(&disk).restore(
        &Workers::default(),
        (ReplayStart::Newest, LogTail::Kept),
        &mut || {},
    );
    let restored = restored.unwrap().unwrap();
    recorded.check(&restored).unwrap();
    assert_eq!(restored.scene.tick(), recorded.scene.tick());
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
