//! Scenes that follow a log while it is written.

use super::*;

/// The scene as its files have it now.
fn follow(recorded: &Recorded) -> Restored {
    let begun = recorded
        .files
        .begin_to_follow(&StepThreads::default(), &mut || {});
    begun.unwrap().unwrap()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// The followed scene is the recorded one at each look, across segments and torn ends, and continues to the same bits.
    #[test]
    fn a_followed_scene_is_the_recorded_one_and_goes_on_to_the_same_bits(seed: u64) {
        let mut recorded = run(seed, 20);
        recorded.write();
        recorded.sync();
        let mut followed = follow(&recorded);
        for _ in 0..30 {
            recorded.tick();
            match recorded.chance.below(6) {
                0 => recorded.snapshot(),
                1..3 => recorded.write(),
                _ => {
                    recorded.write();
                    recorded.sync();
                }
            }
            followed = recorded.files.catch_up(followed, &mut || {}).unwrap();
            recorded.check(&followed)?;
            prop_assert!(followed.scene.tick() >= recorded.durable);
        }
        recorded.write();
        recorded.sync();
        followed = recorded.files.catch_up(followed, &mut || {}).unwrap();
        prop_assert!(recorded.files.is_at_end(&followed).unwrap());
        prop_assert_eq!(followed.scene.tick(), recorded.scene.tick());
        prop_assert_eq!(&followed.sessions, &recorded.sessions);
        let restored = recorded.restore().unwrap().unwrap();
        prop_assert_eq!(followed.next_segment, restored.next_segment);
        prop_assert_eq!(followed.last, restored.last);
        recorded.continue_from(followed);
        recorded.check_after(1)?;
    }
}

#[test]
fn a_followed_scene_that_lacks_the_end_is_not_at_the_end() {
    let mut recorded = Recorded::new(5);
    recorded.tick_durably();
    let followed = follow(&recorded);
    assert!(recorded.files.is_at_end(&followed).unwrap());
    recorded.tick_durably();
    assert!(!recorded.files.is_at_end(&followed).unwrap());
}

#[test]
fn a_followed_segment_that_was_removed_is_an_error() {
    let mut recorded = Recorded::new(6);
    recorded.tick_durably();
    let followed = follow(&recorded);
    recorded.files.remove_before(1).unwrap();
    assert!(recorded.files.catch_up(followed, &mut || {}).is_err());
}
