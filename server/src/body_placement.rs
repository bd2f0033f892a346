//! Description of a body and its first track, for members that lack it.
//!
//! Pure functions of a scene; `scene_runner` decides who receives them.

use rhumb_protocol::message::SceneEvent;
use rhumb_protocol::scene::{BodyDesc, BodyKind};
use rhumb_protocol::stream::{Activity, Observation, PredictionParameters};
use rhumb_reckoning::{Anchor, BodyId, BodyState, Predictor, Tick, Track};

use crate::scene::Scene;

/// Event of a body that is in a scene, with its motion.
pub(crate) fn scene_event(
    scene: &Scene,
    desc: BodyDesc,
    track: Track,
    alias: Option<u32>,
) -> SceneEvent {
    SceneEvent::BodyPlaced {
        desc,
        inertia: scene.inertia(desc.id),
        track,
        alias,
    }
}

/// Parameters of a body's predictions.
pub(crate) fn parameters(scene: &Scene, id: BodyId) -> Option<PredictionParameters> {
    let desc = scene.body(id)?;
    let shape = scene.shape(desc.shape)?;
    let damping = scene.config().damping;
    Some(PredictionParameters::of(
        desc,
        shape,
        damping,
        scene.inertia(id),
    ))
}

/// The track of a body before its first update.
pub(crate) fn first_track(
    tick: Tick,
    (motion, activity): (BodyState, Activity),
    desc: &BodyDesc,
    tumbles: bool,
) -> Track {
    let activity = if desc.enabled {
        activity
    } else {
        Activity::Asleep
    };
    let predictor = match (activity, desc.kind) {
        (Activity::Asleep, _) | (_, BodyKind::Fixed) => Predictor::Rest,
        (Activity::Awake, BodyKind::Dynamic) if tumbles => Predictor::BallisticTorqueFree,
        (Activity::Awake, BodyKind::Dynamic) => Predictor::Ballistic,
        (Activity::Awake, BodyKind::Kinematic) => Predictor::Uniform,
    };
    let resting = predictor == Predictor::Rest;
    Track {
        origin: tick,
        predictor,
        anchor: Anchor::Exact(if resting { motion.stilled() } else { motion }),
        parent: None,
    }
}

/// Every body of a scene at present, in order of index.
pub(crate) fn everything(scene: &Scene) -> Vec<(BodyId, PredictionParameters, Track, BodyState)> {
    let mut observations = Vec::new();
    scene.observe_all(&mut observations);
    let first = |observation: &Observation| {
        let id = observation.id;
        let desc = scene.body(id)?;
        let parameters = parameters(scene, id)?;
        let tumbles = parameters.inertia.is_some();
        let state = (observation.motion, observation.activity);
        let track = first_track(scene.tick(), state, desc, tumbles);
        Some((id, parameters, track, observation.motion))
    };
    observations.iter().filter_map(first).collect()
}
