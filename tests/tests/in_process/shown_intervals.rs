//! Shown poses between published ticks are within their stated bounds.

use std::num::NonZeroU32;

use rhumb_protocol::scene::{PublishSchedule, SceneConfig, Stepping};
use rhumb_reckoning::Ticks;
use rhumb_tests::seed;
use rhumb_view::ViewOptions;

use crate::shown_poses::{World, judge, watch};

/// Delays with and without smoothing.
fn all_options() -> Vec<ViewOptions> {
    [0.0, 2.0, 5.0, 8.0, 12.0]
        .into_iter()
        .flat_map(|delay_ticks| {
            [true, false].map(|smooth| ViewOptions {
                delay_ticks,
                whole_ticks: delay_ticks == 5.0,
                smooth,
            })
        })
        .collect()
}

#[test]
fn no_pose_between_published_ticks_is_further_off_than_its_bound() {
    let all = all_options();
    for (links, latency) in [("rtt=20ms", 1.0), ("rtt=40ms,jitter=5ms,loss=5%", 2.0)] {
        for (interval, lookahead) in [(1, 0), (2, 0), (3, 2), (4, 0), (5, 0), (6, 3), (8, 0)] {
            let seed = seed(u64::from(interval));
            let config = SceneConfig {
                stepping: Stepping::FreeRunning,
                publish_schedule: PublishSchedule {
                    publish_interval: NonZeroU32::new(interval).expect("not zero"),
                    lookahead: Ticks::new(lookahead),
                },
                ..SceneConfig::default()
            };
            let (truth, watchers) = watch(World::of(config, links, seed), &all, 600);
            for (watcher, options) in watchers.iter().zip(&all) {
                let what = format!("interval {interval}, {links}, seed {seed}, {options:?}");
                let counts = judge(&truth, watcher, &what);
                let share = counts.bounded as f64 / counts.poses as f64;
                println!("{what}: known in {share:.2} of {} poses", counts.poses);
                // The delay covers the interval and the way of the news.
                let covered = options.delay_ticks > f64::from(interval) + latency + 2.0;
                assert!(!covered || share > 0.3, "{what}: known in {share:.2} only");
            }
        }
    }
}
