//! All cases of servers, in order.

use super::{
    l0_frames, l0_pieces, l0_vectors, l1_features, l1_limits, l1_resume, l1_scenes, l1_session,
    l1_states, l1_transport, l2_stream, l2_wire, l3_authority, l3_changes, l3_characters,
    l3_commands, l3_joints, l3_motion, l3_physics, l3_queries, l4_exact, l4_free, l4_tolerance,
    l5_datagrams, l5_security,
};
use crate::case::Case;

/// All cases of this side.
pub(crate) fn cases() -> Vec<Case> {
    [
        l0_frames::cases(),
        l0_pieces::cases(),
        l0_vectors::cases(),
        l1_session::cases(),
        l1_states::cases(),
        l1_transport::cases(),
        l1_scenes::cases(),
        l1_limits::cases(),
        l1_resume::cases(),
        l1_features::cases(),
        l2_stream::cases(),
        l2_wire::cases(),
        l3_commands::cases(),
        l3_authority::cases(),
        l3_joints::cases(),
        l3_changes::cases(),
        l3_motion::cases(),
        l3_physics::cases(),
        l3_queries::cases(),
        l3_characters::cases(),
        l4_tolerance::cases(),
        l4_free::cases(),
        l4_exact::cases(),
        l5_security::cases(),
        l5_datagrams::cases(),
    ]
    .into_iter()
    .flatten()
    .collect()
}
