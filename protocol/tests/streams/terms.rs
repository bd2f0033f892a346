//! The terms of a plain stream, from which the tests deviate.

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::stream::{Features, StreamConfig};
use rhumb_reckoning::{Integrator, Rate, Tolerance};

/// Sixty ticks a second, each published, without gravity.
pub(crate) const TERMS: StreamConfig = StreamConfig {
    tolerance: Tolerance::NORMAL,
    integrator: Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::MIN,
    },
    publish_interval: NonZeroU32::MIN,
    largest_packet: LargestPacket::DEFAULT,
    gravity: Vec3::ZERO,
    features: Features::ALL,
};
