//! A scene gives equal results on any number of threads.
//!
//! Proved on a pile that is large enough for the engine to share its work out. Without the feature `parallel`, the
//! test proves that more threads than one are refused. `scripts` proves that both builds give equal results.

use std::num::NonZeroU32;

use rhumb_server::{Scene, Workers, WorkersError};
use rhumb_sims::{BallPit, Script};

fn threads(count: u32) -> Option<NonZeroU32> {
    Some(NonZeroU32::new(count).expect("the tests name no zero"))
}

/// Digest of 600 balls after two seconds.
fn truth(workers: &Workers) -> u64 {
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
    let one = truth(&Workers::new(threads(1)).unwrap());
    assert_eq!(one, truth(&Workers::default()), "by default");
    if Workers::may_be_many() {
        for count in [2, 3, 4, 8] {
            let workers = Workers::new(threads(count)).unwrap();
            assert_eq!(one, truth(&workers), "{count} threads");
        }
    } else {
        let asked = NonZeroU32::new(2).unwrap();
        let refused = Workers::new(threads(2)).err();
        assert_eq!(refused, Some(WorkersError::OneOnly { asked }));
    }
}
