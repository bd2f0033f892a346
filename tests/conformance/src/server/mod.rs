//! The cases of servers, by level and group.

mod all;
mod l0_frames;
mod l0_pieces;
mod l0_vectors;
mod l1_features;
mod l1_limits;
mod l1_resume;
mod l1_scenes;
mod l1_session;
mod l1_states;
mod l1_transport;
mod l2_stream;
mod l2_wire;
mod l3_authority;
mod l3_changes;
mod l3_characters;
mod l3_commands;
mod l3_joints;
mod l3_motion;
mod l3_physics;
mod l3_queries;
mod l4_exact;
mod l4_free;
mod l4_tolerance;
mod l5_datagrams;
mod l5_security;
mod raw_member;
mod scenery;
mod table;

pub(super) use all::cases;
