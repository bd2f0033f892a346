//! Damaged scenes that are cut back to their last good tick.
//!
//! After any damage that a restoration refuses, the repaired scene is restored by the ordinary way, is the recorded run at
//! its tick, and continues; everything that was there stays.

use super::*;

/// The files of the repaired scene.
fn target(recorded: &Recorded) -> SceneFiles {
    SceneFiles {
        is_there: None,
        directory: PathBuf::from("scenes/pit.1"),
        ..recorded.files.clone()
    }
}

/// Cuts a scene back; returns its files, and the tick.
fn repaired(recorded: &Recorded) -> (SceneFiles, Tick) {
    let cut = recorded.files.find_cut(&name()).unwrap().unwrap();
    let to = target(recorded);
    let old = recorded.files.cut_back(&name(), &cut, &to).unwrap();
    assert_eq!(old, PathBuf::from("scenes/pit.0.damaged"));
    (to, cut.tick)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_damaged_scene_is_cut_back_to_a_state_of_its_run_and_goes_on(
        seed in any::<u64>(),
        file in any::<prop::sample::Index>(),
        place in any::<prop::sample::Index>(),
        kind in 0..3_usize,
    ) {
        let mut recorded = run(seed, 40);
        let paths = recorded.disk.paths();
        let path = paths[file.index(paths.len())].clone();
        recorded.disk.damage(&path, |bytes| {
            let place = place.index(bytes.len());
            match kind {
                0 => bytes.truncate(place),
                1 => bytes[place] ^= 1,
                _ => bytes[place..].fill(0xa5),
            }
        });
        if recorded.restore().is_ok() {
            return Ok(());
        }
        let before: Vec<_> = recorded.disk.paths();
        let left = recorded.files.find_cut(&name()).unwrap();
        let Some(cut) = left else {
            // One segment without a snapshot, whose beginning is lost.
            prop_assert_eq!(recorded.files.numbers().unwrap().0.len(), 1);
            return Ok(());
        };
        prop_assert!(cut.newest >= cut.tick);
        let (files, tick) = repaired(&recorded);
        let now = recorded.disk.paths();
        for path in before {
            let path = path.to_string_lossy().replace("pit.0", "pit.0.damaged");
            prop_assert!(now.contains(&PathBuf::from(&path)), "{}", path);
        }
        recorded.files = files;
        let restored = recorded.restore().unwrap().unwrap();
        recorded.check(&restored)?;
        prop_assert_eq!(restored.scene.tick(), tick);
        recorded.digests.truncate(tick.value() as usize + 1);
        recorded.continue_from(restored);
        recorded.check_after(5)?;
    }
}

#[test]
fn a_log_cut_at_any_byte_comes_back_to_the_tick_before_the_cut() {
    let mut recorded = Recorded::new(5);
    let mut ends = Vec::new();
    let path = recorded.files.segment_path(0);
    for tick in 1..4 {
        recorded.tick_durably();
        ends.push((recorded.disk.read(&path).unwrap().len(), tick));
    }
    let bytes = recorded.disk.read(&path).unwrap();
    let beginning = recorded.first_frame();
    for cut in beginning..bytes.len() {
        recorded
            .disk
            .damage(&path, |now| *now = bytes[..cut].to_vec());
        let found = recorded.files.find_cut(&name()).unwrap().unwrap();
        let kept = ends.iter().filter(|(end, _)| *end <= cut);
        let tick = kept.map(|(_, tick)| *tick).max().unwrap_or(0);
        assert_eq!(
            (found.tick, found.newest),
            (Tick::new(tick), Tick::new(2)),
            "{cut}"
        );
    }
    recorded
        .disk
        .damage(&path, |now| now.truncate(beginning - 1));
    assert!(recorded.files.find_cut(&name()).unwrap().is_none());
}

#[test]
fn a_log_of_another_version_is_not_cut() {
    let mut recorded = Recorded::new(13);
    recorded.tick_durably();
    make_older(&recorded);
    let refused = recorded.files.find_cut(&name()).unwrap_err();
    assert!(refused.to_string().contains("written by another version"));
}

#[test]
fn a_snapshot_of_another_version_or_one_that_cannot_be_read_ends_the_search() {
    let mut recorded = run(3, 10);
    recorded.snapshot();
    let (_, snapshots) = recorded.files.numbers().unwrap();
    let path = recorded.files.snapshot_path(*snapshots.last().unwrap());
    recorded.disk.damage(&path, |bytes| {
        bytes.truncate(bytes.len() - 32);
        let version = bytes.windows(12).position(|text| text == b"rhumb-server");
        bytes[version.unwrap()] = b'c';
        let key = hmac::Key::new(hmac::HMAC_SHA256, &[7; 32]);
        let code = hmac::sign(&key, bytes);
        bytes.extend_from_slice(code.as_ref());
    });
    let refused = recorded.files.find_cut(&name()).unwrap_err().to_string();
    assert!(
        refused.contains("written by another version") && refused.contains("snapshot"),
        "{refused}"
    );
    recorded.disk.refuse_to_read(&path);
    let refused = recorded.files.find_cut(&name()).unwrap_err().to_string();
    assert!(refused.starts_with("cannot read"), "{refused}");
}

#[test]
fn a_run_that_went_on_without_a_tail_is_followed_without_it() {
    let mut recorded = run(21, 8);
    recorded.write();
    recorded.sync();
    let tick = recorded.scene.tick();
    // Commands on which a step hung.
    recorded.add(BodyKind::Dynamic, ShapeId(2), Vec3::Y * 9.0);
    recorded.write();
    recorded.sync();
    let left_out = (ReplayStart::Newest, LogTail::LeftOut);
    let restored = (recorded.files).restore(&StepThreads::default(), left_out, &mut || {});
    recorded.continue_from(restored.unwrap().unwrap());
    let hour = tick.value() + 20;
    while recorded.scene.tick().value() < hour {
        recorded.tick_durably();
    }
    let newest = recorded.files.numbers().unwrap().0.pop().unwrap();
    let path = recorded.files.segment_path(newest);
    recorded.disk.damage(&path, |bytes| {
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
    });
    assert!(recorded.restore().is_err());
    let cut = recorded.files.find_cut(&name()).unwrap().unwrap();
    assert_eq!(cut.tick, Tick::new(hour - 1));
    let bytes = recorded.disk.read(&path).unwrap();
    let lost = bytes.len() - LogFrames::read(&bytes).length;
    assert_eq!(cut.bytes, lost as u64, "the tail was lost before");
    let (files, tick) = repaired(&recorded);
    recorded.files = files;
    let restored = recorded.restore().unwrap().unwrap();
    recorded.check(&restored).unwrap();
    assert_eq!(restored.scene.tick(), tick);
}

#[test]
fn a_segment_that_never_was_durable_does_not_end_the_run() {
    let mut recorded = run(17, 6);
    recorded.write();
    recorded.sync();
    // A process that began a segment, and crashed before it was durable; another one that continued.
    let restored = recorded.restore().unwrap().unwrap();
    let torn = recorded.files.segment_path(restored.next_segment);
    let mut file = recorded.disk.create(&torn).unwrap();
    file.append(&[0; 5]).unwrap();
    let restored = recorded.restore().unwrap().unwrap();
    recorded.continue_from(restored);
    for _ in 0..5 {
        recorded.tick_durably();
    }
    let newest = recorded.files.numbers().unwrap().0.pop().unwrap();
    let path = recorded.files.segment_path(newest);
    assert_ne!(path, torn);
    recorded.disk.damage(&path, |bytes| {
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
    });
    assert!(recorded.restore().is_err());
    let tick = recorded.scene.tick().value() - 1;
    let (files, cut) = repaired(&recorded);
    assert_eq!(cut, Tick::new(tick));
    recorded.files = files;
    let restored = recorded.restore().unwrap().unwrap();
    recorded.check(&restored).unwrap();
}

#[test]
fn segments_before_the_snapshot_of_a_cut_are_not_lost() {
    let mut recorded = Recorded::new(8);
    for _ in 0..6 {
        recorded.tick();
    }
    recorded.snapshot();
    for _ in 0..3 {
        recorded.tick_durably();
    }
    // The first segment is damaged at its end, and a snapshot stands in for it.
    for number in [0, 1] {
        recorded
            .disk
            .damage(&recorded.files.segment_path(number), |bytes| {
                let last = bytes.len() - 1;
                bytes[last] ^= 1;
            });
    }
    let cut = recorded.files.find_cut(&name()).unwrap().unwrap();
    assert_eq!(cut.tick, Tick::new(8));
    let bytes = recorded.disk.read(&recorded.files.segment_path(1)).unwrap();
    let kept = LogFrames::read(&bytes).length;
    assert_eq!(cut.bytes, (bytes.len() - kept) as u64);
}

#[test]
fn a_crash_at_any_change_of_a_repair_leaves_the_scene_as_it_was_or_repaired() {
    for seed in 0..6 {
        for changes in 0.. {
            let mut recorded = run(4, 12);
            recorded.write();
            recorded.sync();
            recorded
                .disk
                .sync_directory(&PathBuf::from("scenes"))
                .unwrap();
            recorded
                .disk
                .damage(&recorded.files.segment_path(0), |bytes| {
                    let last = bytes.len() - 1;
                    bytes[last] ^= 1;
                });
            let cut = recorded.files.find_cut(&name()).unwrap().unwrap();
            let to = target(&recorded);
            recorded.disk.set_changes(Some(changes));
            let is_done = recorded.files.cut_back(&name(), &cut, &to).is_ok();
            let mut chance = Chance(seed);
            recorded.disk.crash(|n| chance.below(n));
            let there = recorded.disk.list(&PathBuf::from("scenes")).unwrap();
            if there.contains(&"pit.1".to_owned()) {
                recorded.files = to;
                let restored = recorded.restore().unwrap().unwrap();
                assert_eq!(restored.scene.digest(), cut.digest, "{changes}");
            } else {
                assert!(there.contains(&"pit.0".to_owned()), "{changes}: {there:?}");
                let again = recorded.files.find_cut(&name()).unwrap().unwrap();
                assert_eq!(again.digest, cut.digest, "{changes}");
            }
            if is_done {
                assert!(!there.contains(&"pit.0".to_owned()), "{there:?}");
                break;
            }
        }
    }
}
