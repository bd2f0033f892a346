//! The state from which a subscriber starts.
//!
//! The server sends it before the snapshot.

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{Integrator, Tick, Tolerance};

use crate::packet::{LargestPacket, StreamId};

/// The start of a subscriber, sent by the server when a member joins or changes its stream.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StreamStart {
    /// The id of the stream.
    pub stream: StreamId,
    /// The largest packet that the publisher makes. A larger one is malformed.
    pub largest_packet: LargestPacket,
    /// The tolerance of a body with the usual scale.
    pub tolerance: Tolerance,
    /// The integrator and rate of the scene.
    pub integrator: Integrator,
    /// The stream publishes at ticks that are multiples of this number.
    pub publish_interval: NonZeroU32,
    /// The present gravity, m/s², world frame.
    pub gravity: Vec3,
    /// The tick of the snapshot.
    pub tick: Tick,
    /// Number of the first packet after the snapshot.
    pub next: u64,
    /// Scene events included in the snapshot.
    pub scene_events: u64,
}
