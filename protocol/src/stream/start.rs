//! Where a subscriber begins.
//!
//! Told by the server before the snapshot.

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{Integrator, Tick, Tolerance};

use crate::packet::StreamId;

/// Where a subscriber begins: what the server says when a member joins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamStart {
    /// The stream's name.
    pub stream: StreamId,
    /// Its promise.
    pub tolerance: Tolerance,
    /// How the scene steps.
    pub integrator: Integrator,
    /// The multiples of this number are the ticks that it is said of.
    pub publish_interval: NonZeroU32,
    /// What pulls now.
    pub gravity: Vec3,
    /// The tick of the snapshot.
    pub tick: Tick,
    /// Number of the first packet after it.
    pub next: u64,
    /// SceneEvents that it includes.
    pub scene_events: u64,
}
