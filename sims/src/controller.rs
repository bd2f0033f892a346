//! What acts in a scene beside its engine, before each step.
//!
//! Knows neither engine nor network. Invariant: what it does is a function of its script's name, number of bodies and
//! seed, and of the motions that it has seen, to the bit on every platform.

use glam::Vec3;
use rhumb_protocol::scene::Command;
use rhumb_reckoning::{BodyId, BodyState, Tick};

/// Pushes bodies about without a word over the wire, at the server as in one process.
pub trait Controller: Send {
    /// Adds what is done before the step that leaves `tick`: pushes, velocities and poses, and nothing else.
    ///
    /// `motion`: what a body of the scene does now. A body may not be there yet, or no more.
    fn before_step(
        &mut self,
        tick: Tick,
        motion: &dyn Fn(BodyId) -> Option<BodyState>,
        out: &mut Vec<Command>,
    );
}

/// Position and linear velocity of a body, world frame, m and m/s.
pub(crate) fn flight(motion: &BodyState) -> (Vec3, Vec3) {
    let parts = motion.parts();
    (
        Vec3::from_slice(&parts[..3]),
        Vec3::from_slice(&parts[7..10]),
    )
}
