//! The cases of servers, by level and group.

mod l0_frames;
mod l0_pieces;
mod l0_vectors;
mod l1_features;
mod l1_limits;
mod l1_scenes;
mod l1_session;
mod l1_states;
mod l1_transport;
mod l2_stream;
mod l2_wire;
mod l3_authority;
mod l3_commands;
mod l3_joints;
mod l3_motion;
mod l3_physics;
mod l4_exact;
mod l4_free;
mod l4_tolerance;
mod l5_datagrams;
mod l5_security;
mod raw_member;
mod scenery;

use super::case::{Case, CaseRow};
use super::feature::Feature;

/// The cases of a group that need the same features.
fn table(group: &str, needs: &[Feature], rows: &[CaseRow]) -> impl Iterator<Item = Case> + use<> {
    let case = |(number, name, cites, play): &CaseRow| {
        Case::server(&format!("{group}.{number}"), name)
            .cites(cites)
            .needs(needs)
            .play(*play)
    };
    rows.iter().map(case).collect::<Vec<_>>().into_iter()
}

/// All cases of this module.
pub(super) fn cases() -> Vec<Case> {
    [
        l0_frames::cases(),
        l0_pieces::cases(),
        l0_vectors::cases(),
        l1_session::cases(),
        l1_states::cases(),
        l1_transport::cases(),
        l1_scenes::cases(),
        l1_limits::cases(),
        l1_features::cases(),
        l2_stream::cases(),
        l2_wire::cases(),
        l3_commands::cases(),
        l3_authority::cases(),
        l3_joints::cases(),
        l3_motion::cases(),
        l3_physics::cases(),
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
