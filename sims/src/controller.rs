//! Controller of a scene: commands that depend on the bodies' motions.
//!
//! Knows neither engine nor network. Invariant: its commands are a function of the script's name, number of bodies and
//! seed, and of the motions it receives, bit exact on every platform.

use glam::Vec3;
use rhumb_protocol::scene::Command;
use rhumb_reckoning::{BodyId, BodyState, Tick};

/// Acts on bodies from inside the server or the local process, without network traffic.
pub trait Controller: Send {
    /// Appends the commands that precede the step from `tick`: forces, velocities and poses, nothing else.
    ///
    /// `motion` returns the current state of a body, or `None` if the body does not exist at this tick.
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
