//! The config of a reckoned stream.
//!
//! Contains data alone. A subscriber learns from the stream's start what it needs of it.

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_reckoning::{Integrator, Tick, Tolerance};

use super::features::Features;
use super::start::StreamStart;
use crate::packet::{LargestPacket, StreamId};

/// The config of a stream.
#[derive(Clone, Copy, Debug)]
pub struct StreamConfig {
    /// The tolerance of every body with the usual scale.
    pub tolerance: Tolerance,
    /// The integrator and rate of the scene.
    pub integrator: Integrator,
    /// The stream publishes at ticks that are multiples of this number.
    pub publish_interval: NonZeroU32,
    /// The present gravity, m/s², world frame.
    pub gravity: Vec3,
    /// The largest packet that the publisher makes.
    pub largest_packet: LargestPacket,
    /// The features that the publisher may use.
    pub features: Features,
}

impl StreamConfig {
    /// Sixty ticks a second, each published, without gravity: the config of unit tests.
    #[cfg(test)]
    pub(crate) const PLAIN: Self = Self {
        tolerance: Tolerance::NORMAL,
        integrator: Integrator {
            rate: rhumb_reckoning::Rate::HZ_60,
            substeps: NonZeroU32::MIN,
        },
        publish_interval: NonZeroU32::MIN,
        gravity: Vec3::ZERO,
        largest_packet: LargestPacket::DEFAULT,
        features: Features::ALL,
    };

    /// The start of a subscriber that receives the stream from its first tick.
    #[must_use]
    pub const fn start(&self, stream: StreamId, tick: Tick) -> StreamStart {
        StreamStart {
            stream,
            largest_packet: self.largest_packet,
            tolerance: self.tolerance,
            integrator: self.integrator,
            publish_interval: self.publish_interval,
            gravity: self.gravity,
            tick,
            next: 0,
            scene_events: 0,
        }
    }
}
