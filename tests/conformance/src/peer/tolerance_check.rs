//! Compares a copy with the truth: each body must be within its tolerance.
//!
//! The truth is the full stream of the same server, which is bit-exact.

use rhumb_protocol::scene::Shape;
use rhumb_protocol::session::Replica;
use rhumb_reckoning::{Divergence, Tick};

use super::lossy_client::LossyClient;
use crate::outcome::Stop;

/// The greatest ratio of error to tolerance over all bodies of a copy at a tick.
///
/// # Errors
///
/// [`Stop::Fail`] when the two do not hold the same bodies.
fn worst_share(copy: &Replica, truth: &Replica, tick: Tick) -> Result<f64, Stop> {
    let mut worst = 0.0_f64;
    let mut bodies = 0;
    for desc in truth.bodies() {
        let id = desc.id;
        let missing = || Stop::Fail(format!("{id} exists in the full stream only at {tick}"));
        let there = truth
            .stream()
            .predicted_motion(id, tick)
            .ok_or_else(missing)?;
        let here = copy
            .stream()
            .predicted_motion(id, tick)
            .ok_or_else(missing)?;
        let radius = truth
            .shape(desc.shape)
            .ok_or_else(missing)?
            .bounding_radius();
        let tolerance = copy.stream().tolerance_of(id).ok_or_else(missing)?;
        let apart = Divergence::between(&there.pose(), &here.pose());
        worst = worst.max(tolerance.share(&apart, radius));
        bodies += 1;
    }
    if bodies == copy.bodies().count() {
        Ok(worst)
    } else {
        Stop::fail(format!(
            "the copy holds other bodies than the full stream at {tick}"
        ))
    }
}

/// Fails unless each body of a copy is within `factor` times its tolerance at a tick. Returns the greatest ratio.
///
/// # Errors
///
/// [`Stop::Fail`] otherwise.
pub fn compare(copy: &Replica, truth: &Replica, tick: Tick, factor: f64) -> Result<f64, Stop> {
    let worst = worst_share(copy, truth, tick)?;
    if worst <= factor {
        Ok(worst)
    } else {
        Stop::fail(format!(
            "at {tick} an error is {worst:.3} times its tolerance; {factor} is allowed"
        ))
    }
}

/// Compares the recordings of two members at every tick that both have. Returns the number of these ticks.
///
/// # Errors
///
/// [`Stop::Fail`] when a body is beyond its tolerance at one of them.
pub fn compare_recorded(copy: &LossyClient, truth: &LossyClient) -> Result<usize, Stop> {
    let (here, there) = (copy.replica()?, truth.replica()?);
    let none = || Stop::Inconclusive("nothing was recorded".into());
    let (copied, true_ones) = (
        copy.recorded.as_ref().ok_or_else(none)?,
        truth.recorded.as_ref().ok_or_else(none)?,
    );
    let mut compared = 0;
    for (tick, poses) in copied {
        let Some(wanted) = true_ones.get(tick) else {
            continue;
        };
        for (id, pose) in poses {
            let (Some(truth), Some(desc)) = (wanted.get(id), there.body(*id)) else {
                continue;
            };
            let radius = there.shape(desc.shape).map(Shape::bounding_radius);
            let (Some(radius), Some(tolerance)) = (radius, here.stream().tolerance_of(*id)) else {
                continue;
            };
            let share = tolerance.share(&Divergence::between(truth, pose), radius);
            if share > 1.0 {
                return Stop::fail(format!(
                    "{id} at {tick} has an error of {share:.3} times its tolerance"
                ));
            }
        }
        compared += 1;
    }
    Ok(compared)
}
