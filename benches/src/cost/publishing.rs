//! Measures publishing of awake bodies, as a share of the step.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::median::median;
use crate::processor::time_of;
use crate::setup::publishing::{
    MEASURED, ObservedRun, PublishCost, SCENARIOS, Scenario, SleepLoad, TIERS,
};

/// Ticks with all bodies asleep, measured as one block.
const SILENT: u32 = 1_000;

/// Cost of publishing a scene, per tick.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Publishing {
    /// Scene and stage.
    pub scene: String,
    /// Number of streams, one tier each.
    pub streams: usize,
    /// Bodies awake in the last tick.
    pub awake: usize,
    /// Mean step of the engine, milliseconds.
    pub step_ms: f64,
    /// Mean time to read every body, milliseconds.
    pub observe_ms: f64,
    /// Mean time of selection and encoding for all streams, milliseconds.
    pub publish_ms: f64,
    /// Observing and publishing as a share of the step.
    pub of_step: f64,
    /// Updates per tick over all streams.
    pub updates_per_tick: f64,
}

/// Cost of publishing where nothing moves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sleeping {
    /// Bodies of the stream, all asleep.
    pub bodies: u32,
    /// One tick of one stream, microseconds.
    pub publish_us: f64,
}

/// Number of progress calls for `repeats`.
pub(super) fn publishing_steps(repeats: u32) -> u64 {
    let ticks = SCENARIOS.iter().map(Scenario::steps);
    ticks.sum::<u64>() + SCENARIOS.len() as u64 * TIERS.len() as u64 * u64::from(repeats)
}

/// Measures each scene, as one stream and as four.
///
/// # Errors
///
/// The refusal of the engine or its scene, as text.
pub(super) fn measure_publishing(
    bodies: u32,
    repeats: u32,
    progress: &mut dyn FnMut(),
) -> Result<Vec<Publishing>, String> {
    let mut all = Vec::new();
    for scenario in &SCENARIOS {
        let run = ObservedRun::record(scenario, bodies, progress)?;
        for tiers in TIERS {
            let measured = (0..repeats).map(|_| {
                let cost = run.publish(tiers);
                progress();
                cost
            });
            let costs: Vec<PublishCost> = measured.collect();
            let ms = |time: Duration| time.as_secs_f64() * 1e3;
            let publish_ms = ms(median(costs.iter().map(|cost| cost.tick)));
            let observe_ms = ms(run.observe);
            let step_ms = ms(run.step);
            // All repeats encode the same updates.
            let updates = costs.first().map_or(0, |cost| cost.updates);
            all.push(Publishing {
                scene: scenario.name.to_owned(),
                streams: tiers.len(),
                awake: run.awake(),
                step_ms,
                publish_ms,
                observe_ms,
                of_step: (observe_ms + publish_ms) / step_ms,
                updates_per_tick: updates as f64 / MEASURED as f64,
            });
        }
    }
    Ok(all)
}

/// Measures a stream of `bodies` sleeping bodies.
pub(super) fn measure_sleeping(bodies: u32, repeats: u32) -> Sleeping {
    let mut load = SleepLoad::new(bodies);
    let mut silence = || {
        let publish = || {
            for _ in 0..SILENT {
                load.publish();
            }
        };
        time_of(publish).0
    };
    silence();
    let took = median((0..repeats).map(|_| silence()));
    Sleeping {
        bodies,
        publish_us: took.as_secs_f64() * 1e6 / f64::from(SILENT),
    }
}
