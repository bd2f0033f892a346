//! The cases of clients, by level.
//!
//! In each case the suite plays the server: either raw bytes, or a real server whose data the case intercepts.

mod all;
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
mod table;

pub(super) use all::cases;
