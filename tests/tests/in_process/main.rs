//! Servers, sessions and codecs in one process, without a socket.
//!
//! Most tests run in virtual time. One executable holds them all: each further one would link the engine again.

mod app;
mod app_words;
mod authority;
mod bits;
mod body_events;
mod budgets;
mod cell_authority;
mod cell_members;
mod cells;
mod changes_in_flight;
mod checkpoints;
mod controllers;
mod copy_queries;
mod edge_members;
mod edges;
mod fed;
mod fed_members;
mod hostile;
mod joints;
mod lockstep_views;
mod physics;
mod placed_bodies;
mod provided_scenes;
mod publish_interval;
mod queries;
mod refusals;
mod restoration;
mod retaken_cells;
mod sessions;
mod shown_intervals;
mod shown_poses;
mod simulated_network;
mod tier_policy;
mod tiers;
mod tolerance_scales;
mod upstream;
mod upstream_hostile;
mod vectors;
