//! A scene and its streams give equal results on any number of threads.
//!
//! Proved on a pile that is large enough for the engine to share its work out. Without the feature `parallel`, the
//! test proves that more threads than one are refused. `scripts` proves that both builds give equal results.

use std::num::NonZeroU32;

use rhumb_reckoning::{Metres, Tolerance};
use rhumb_scene::{Scene, StepThreads, StepThreadsError};
use rhumb_sims::{BallPit, Script};

use crate::displayed::displayed_digests;

fn threads(count: u32) -> Option<NonZeroU32> {
    Some(NonZeroU32::new(count).expect("the tests name no zero"))
}

/// Digest of 600 balls after two seconds.
fn truth(workers: &StepThreads) -> u64 {
    let mut script = BallPit::new(600, 1, 5);
    let mut scene = Scene::on(script.config(), workers).expect("a script's config are valid");
    let mut commands = Vec::new();
    for _ in 0..120 {
        commands.clear();
        script.commands(scene.tick(), &mut commands);
        for command in &commands {
            scene.apply(command).expect("a script's commands are done");
        }
        scene.step().expect("nothing of it breaks an engine");
    }
    scene.digest().value()
}

#[test]
fn a_pile_gives_equal_results_on_any_number_of_threads() {
    let one = truth(&StepThreads::new(threads(1)).unwrap());
    assert_eq!(one, truth(&StepThreads::default()), "by default");
    if StepThreads::may_be_many() {
        for count in [2, 3, 4, 8] {
            let workers = StepThreads::new(threads(count)).unwrap();
            assert_eq!(one, truth(&workers), "{count} threads");
        }
    } else {
        let asked = NonZeroU32::new(2).unwrap();
        let refused = StepThreads::new(threads(2)).err();
        assert_eq!(refused, Some(StepThreadsError::OneOnly { asked }));
    }
}

/// Four tiers of a scene are published side by side where there are threads.
#[test]
fn copies_of_four_tiers_are_the_same_on_any_number_of_threads() {
    let tolerances = [0.01, 0.05, 0.2, 1.0]
        .map(|metres| Tolerance::from_metres(Metres::new(metres)).expect("within the limits"));
    let of = |count| {
        let workers = StepThreads::new(threads(count)).expect("the threads are available");
        displayed_digests("ball-pit", &tolerances, workers)
    };
    let one = of(1);
    for (at, digest) in one.iter().enumerate() {
        assert!(!one[..at].contains(digest), "two tiers are one");
    }
    if StepThreads::may_be_many() {
        for count in [2, 4] {
            assert_eq!(one, of(count), "{count} threads");
        }
    }
}
