//! The cases of servers, by level and group.

mod l0_frames;
mod l0_vectors;
mod l1_session;
mod l1_states;
mod l2_stream;
mod l3_physics;
mod l4_promise;
mod l5_security;
mod scenery;

use super::case::Case;

/// All of them.
pub(super) fn cases() -> Vec<Case> {
    [
        l0_frames::cases(),
        l0_vectors::cases(),
        l1_session::cases(),
        l1_states::cases(),
        l2_stream::cases(),
        l3_physics::cases(),
        l4_promise::cases(),
        l5_security::cases(),
    ]
    .into_iter()
    .flatten()
    .collect()
}
