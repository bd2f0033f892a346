//! The cases of clients, by level.
//!
//! In each case the suite plays the server: either raw bytes, or a real server whose data the case intercepts.

mod hand;
mod l0_vectors;
mod l1_session;
mod l1_snapshot;
mod l2_aliases;
mod l2_checksums;
mod l2_links;
mod l2_stream;
mod l3_authority;
mod l4_reckoning;
mod l5_hostile;

use super::case::{Case, CaseRow};

/// The cases of a group.
fn table(group: &str, rows: &[CaseRow]) -> Vec<Case> {
    let case = |(number, name, cites, play): &CaseRow| {
        Case::client(&format!("{group}.{number}"), name)
            .cites(cites)
            .play(*play)
    };
    rows.iter().map(case).collect()
}

/// All cases of this module.
pub(super) fn cases() -> Vec<Case> {
    let groups = [
        l0_vectors::cases(),
        l1_session::cases(),
        l1_snapshot::cases(),
        l2_links::cases(),
        l2_stream::cases(),
        l2_aliases::cases(),
        l2_checksums::cases(),
        l3_authority::cases(),
        l4_reckoning::cases(),
        l5_hostile::cases(),
    ];
    groups.into_iter().flatten().collect()
}
