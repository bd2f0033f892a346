//! Damaged scenes that are cut back to their last good tick.
//!
//! After any damage that a restoration refuses, the repaired scene is restored by the ordinary way, is the recorded run at
//! its tick, and goes on; everything that was there stays.

use super::*;

/// Cuts a scene back; returns its files, and the tick.
fn repaired(recorded: &Recorded) -> (SceneFiles, Tick) {
    let cut = recorded.files.find_cut(&name()).unwrap().unwrap();
    let to = SceneFiles {
        directory: PathBuf::from("scenes/pit.1"),
        ..recorded.files.clone()
    };
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
        recorded.go_on(restored);
        for _ in 0..5 {
            recorded.tick();
            recorded.write();
        }
        recorded.sync();
        let again = recorded.restore().unwrap().unwrap();
        recorded.check(&again)?;
        prop_assert_eq!(again.scene.tick(), recorded.scene.tick());
    }
}

#[test]
fn a_log_cut_at_any_byte_comes_back_to_the_tick_before_the_cut() {
    let mut recorded = Recorded::new(5);
    let mut ends = Vec::new();
    let path = recorded.files.segment_path(0);
    for tick in 1..4 {
        recorded.tick();
        recorded.write();
        recorded.sync();
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
    recorded.tick();
    recorded.write();
    recorded.sync();
    make_older(&recorded);
    let refused = recorded.files.find_cut(&name()).unwrap_err();
    assert!(refused.to_string().contains("written by another version"));
}
