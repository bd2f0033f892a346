//! Judges the states of a recording that has no client's copy: a server's.
//!
//! Nothing of the promise can be compared there. Judged is whether a reader can rely on the file: ticks follow each
//! other, bodies are placed before they move, and every state is one.

use std::collections::BTreeSet;

use super::grid::Body;
use super::messages::{States, pose, steps};
use crate::outcome::{CaseResult, Stop};

/// Distance of a quaternion's length from one that counts as rounded.
const LENGTH_SLACK: f64 = 1e-3;

/// Judges the states of a load, in the order of their ticks.
pub(super) fn judge(states: &[States]) -> CaseResult {
    let mut there: BTreeSet<Body> = BTreeSet::new();
    let mut last: Option<u64> = None;
    for message in states {
        let tick = message.tick;
        if last.is_some_and(|last| tick <= last) {
            return Stop::fail(format!("tick {tick} does not follow the tick before it"));
        }
        last = Some(tick);
        let removed = bodies(&message.removed_index, &message.removed_generation);
        let coming = message
            .placed
            .iter()
            .map(|placed| (placed.index, placed.generation));
        // A body may be placed and observed, or observed and removed, in one message.
        let known: BTreeSet<Body> = there.iter().copied().chain(coming.clone()).collect();
        for (place, body) in bodies(&message.index, &message.generation).enumerate() {
            if !known.contains(&body) {
                return Stop::fail(format!("{body:?} moves at {tick} and was not placed"));
            }
            if !is_state(message, place) {
                return Stop::fail(format!("the state of {body:?} at {tick} is none"));
            }
        }
        for placed in &message.placed {
            let body = (placed.index, placed.generation);
            let rotation = placed.motion.get(3..7).unwrap_or_default();
            if placed.motion.len() != 13 || !is_unit(rotation) || !is_finite(&placed.motion) {
                return Stop::fail(format!("{body:?} is placed at {tick} without a state"));
            }
        }
        for body in removed {
            there.remove(&body);
        }
        there.extend(coming);
    }
    match states.len() {
        0 => Err(Stop::Inconclusive("the recording has no states".into())),
        _ => Ok(()),
    }
}

fn bodies(index: &[u32], generation: &[u32]) -> impl Iterator<Item = Body> {
    index.iter().copied().zip(generation.iter().copied())
}

fn is_state(message: &States, place: usize) -> bool {
    if steps(&message.steps(), place).is_some() {
        return message.awake.get(place).is_some();
    }
    let pose = pose(&message.columns(), place);
    pose.is_some_and(|pose| is_finite(&pose) && is_unit(&pose[3..]))
        && message.awake.get(place).is_some()
}

fn is_finite(numbers: &[f32]) -> bool {
    numbers.iter().all(|number| number.is_finite())
}

fn is_unit(rotation: &[f32]) -> bool {
    let squares = rotation.iter().map(|part| f64::from(*part).powi(2));
    (squares.sum::<f64>().sqrt() - 1.0).abs() <= LENGTH_SLACK
}

#[cfg(test)]
mod tests {
    use super::super::messages::Placement;
    use super::*;

    fn placed() -> Placement {
        Placement {
            index: 3,
            motion: [0.0; 6].into_iter().chain([1.0]).chain([0.0; 6]).collect(),
            ..Placement::default()
        }
    }

    fn at(tick: u64) -> States {
        States {
            tick,
            index: vec![3],
            generation: vec![0],
            px: vec![0.0],
            py: vec![0.0],
            pz: vec![0.0],
            qx: vec![0.0],
            qy: vec![0.0],
            qz: vec![0.0],
            qw: vec![1.0],
            awake: vec![true],
            ..States::default()
        }
    }

    #[test]
    fn a_recording_is_good_until_one_of_its_states_is_not() {
        let first = States {
            tick: 7,
            placed: vec![placed()],
            ..States::default()
        };
        let good = [first.clone(), at(8), at(10)];
        assert_eq!(judge(&good), Ok(()));
        let nan = States {
            py: vec![f32::NAN],
            ..at(8)
        };
        let long = States {
            qw: vec![1.1],
            ..at(8)
        };
        let short = States {
            qz: Vec::new(),
            ..at(8)
        };
        let unplaced = States {
            placed: vec![Placement {
                motion: vec![0.0; 12],
                ..placed()
            }],
            ..States::default()
        };
        for wrong in [nan, long, short, at(7), unplaced] {
            assert!(judge(&[first.clone(), wrong.clone()]).is_err(), "{wrong:?}");
        }
        assert!(judge(&[at(8)]).is_err(), "it was not placed");
        assert!(judge(&[]).is_err(), "there is nothing");
    }
}
