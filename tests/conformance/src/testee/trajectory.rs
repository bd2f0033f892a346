//! The trajectory of a body under the authority of a client under test.
//!
//! It is specified in `docs/book/src/implementing.md`, so that clients in all languages have the same one, except for
//! rounding.

use rhumb_reckoning::{BodyState, Tick};

/// The last tick that the client publishes and requests.
pub const TRAJECTORY_TICKS: u64 = 240;

/// Ticks of each cycle: the body moves for [`GOING`] and stands still for the rest.
const ROUND: u64 = 120;
const GOING: u64 = 80;
/// Distance from the axis, in metres.
const RADIUS: f64 = 2.0;
/// Rotation about the axis, in radians per tick.
const TURN: f64 = 0.05;
/// Ticks per second of the scene.
const RATE: f64 = 60.0;

/// State of the body at a tick: it circles at a height of 50 m, and stands still once every two seconds.
///
/// # Panics
///
/// Never: the numbers are finite.
#[must_use]
pub fn trajectory(tick: Tick) -> BodyState {
    let (rounds, within) = (tick.value() / ROUND, tick.value() % ROUND);
    let gone = rounds * GOING + within.min(GOING);
    let (sin, cos) = (gone as f64 * TURN).sin_cos();
    let speed = if within < GOING {
        RADIUS * TURN * RATE
    } else {
        0.0
    };
    let position = [(RADIUS * cos) as f32, 50.0, (RADIUS * sin) as f32];
    let linear = [(-speed * sin) as f32, 0.0, (speed * cos) as f32];
    BodyState::new(position, [0.0, 0.0, 0.0, 1.0], linear, [0.0; 3]).expect("finite numbers")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_body_alternates_between_moving_and_standing() {
        let parts = |tick| trajectory(Tick::new(tick)).parts();
        assert_eq!(parts(0)[..3], [2.0, 50.0, 0.0]);
        assert_eq!(parts(80), parts(119));
        assert_eq!(parts(80)[..3], parts(120)[..3]);
        assert_eq!(parts(80)[7..], [0.0; 6]);
        assert!(parts(120)[9] != 0.0 && parts(121)[..3] != parts(120)[..3]);
    }
}
