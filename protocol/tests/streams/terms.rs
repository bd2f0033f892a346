//! The terms of a plain stream, from which the tests deviate, and its bodies.

use core::num::NonZeroU32;

use glam::Vec3;
use rhumb_protocol::packet::LargestPacket;
use rhumb_protocol::scene::SceneConfig;
use rhumb_protocol::stream::{
    Activity, Features, Observation, PredictionParameters, Publisher, StreamConfig, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, Predictor, Rate, Tick, Tolerance, Track,
};

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

/// A scene of that stream, with gravity.
pub(crate) fn scene() -> SceneConfig {
    SceneConfig {
        integrator: TERMS.integrator,
        gravity: Vec3::NEG_Y,
        ..SceneConfig::default()
    }
}

/// Places a body that falls from tick zero on, at both ends of a stream.
pub(crate) fn place_falling(
    (publisher, subscriber): (&mut Publisher, &mut Subscriber),
    body: u32,
    parameters: &PredictionParameters,
    motion: BodyState,
) {
    let track = Track {
        origin: Tick::ZERO,
        predictor: Predictor::Ballistic,
        anchor: Anchor::Exact(motion),
        parent: None,
    };
    assert!(publisher.place(BodyId::new(body, 0), parameters, track));
    assert!(subscriber.place(BodyId::new(body, 0), parameters, track));
}

/// The observations of bodies that are awake, by index.
pub(crate) fn awake(bodies: u32, motion: impl Fn(u32) -> BodyState) -> Vec<Observation> {
    let observation = |body| Observation {
        id: BodyId::new(body, 0),
        motion: motion(body),
        activity: Activity::Awake,
    };
    (0..bodies).map(observation).collect()
}
