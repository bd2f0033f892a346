//! All cases of clients, in order.

use super::{
    l0_vectors, l1_session, l1_snapshot, l2_aliases, l2_checksums, l2_links, l2_stream,
    l3_authority, l4_reckoning, l5_hostile,
};
use crate::case::Case;

/// All cases of this side.
pub(crate) fn cases() -> Vec<Case> {
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
