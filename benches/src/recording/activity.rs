//! Activity of bodies whose recording has none: by their records.

use rhumb_protocol::stream::{Activity, Observation};
use rhumb_server::Digest;

use crate::record::Truth;
use rhumb_reckoning::Tick;

/// Derives activity from the records. A body with a record in the next frame moves, so it is awake; a body without one
/// has not changed, so it sleeps.
pub(super) fn activity_from_records(truth: &mut Truth) {
    for placed in &mut truth.placed {
        let next = truth.ticks.get(placed.tick.value() as usize);
        let moves = next.is_some_and(|row| has(row, &placed.observation));
        placed.observation.activity = of(moves);
    }
    for next in 1..truth.ticks.len() {
        let (before, after) = truth.ticks.split_at_mut(next);
        for observation in &mut before[next - 1] {
            observation.activity = of(has(&after[0], observation));
        }
    }
}

const fn of(moves: bool) -> Activity {
    if moves {
        Activity::Awake
    } else {
        Activity::Asleep
    }
}

/// True if a row, which is in the order of indices, has the body.
fn has(row: &[Observation], of: &Observation) -> bool {
    let found = row.binary_search_by_key(&of.id.index(), |observation| observation.id.index());
    found.is_ok()
}

/// Sets the digest over all observations.
pub(super) fn set_digest(truth: &mut Truth) {
    let mut digest = Digest::START;
    for (row, tick) in truth.ticks.iter().zip(1..) {
        digest.fold_tick(Tick::new(tick), row);
    }
    truth.digest = digest.value();
}
