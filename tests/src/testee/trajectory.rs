//! Where a body that a client under test drives is at a tick.
//!
//! Stated in `docs/book/src/implementing.md`, so that a client in any language has the same course but for roundings.

use rhumb_reckoning::{BodyState, Tick};

/// The last tick that a client that drives says and asks for.
pub const COURSE_TICKS: u64 = 240;

/// Ticks of each round, of which it goes for [`GOING`] and stands for the others.
const ROUND: u64 = 120;
const GOING: u64 = 80;
/// Metres from the axis.
const RADIUS: f64 = 2.0;
/// Radians a tick.
const TURN: f64 = 0.05;
/// Ticks a second, of the scenes that it is driven in.
const RATE: f64 = 60.0;

/// Where the body is at a tick and how it moves: around a circle at a height of 50 m, with a rest each two seconds.
///
/// # Panics
///
/// Never: a circle is finite.
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
    BodyState::new(position, [0.0, 0.0, 0.0, 1.0], linear, [0.0; 3]).expect("a circle is finite")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_goes_and_stands_in_turns() {
        let parts = |tick| trajectory(Tick::new(tick)).parts();
        assert_eq!(parts(0)[..3], [2.0, 50.0, 0.0]);
        assert_eq!(parts(80), parts(119));
        assert_eq!(parts(80)[..3], parts(120)[..3]);
        assert_eq!(parts(80)[7..], [0.0; 6]);
        assert!(parts(120)[9] != 0.0 && parts(121)[..3] != parts(120)[..3]);
    }
}
