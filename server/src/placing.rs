//! What is said of a body to those who lack it: what it is, and a track.
//!
//! Pure functions of a scene; who is told is decided in `room`.

use rhumb_protocol::message::Notice;
use rhumb_protocol::scene::{BodyKind, BodyTerms};
use rhumb_protocol::stream::{Activity, Manner, Observation};
use rhumb_reckoning::{Anchor, BodyId, Predictor, Tick, Track, Verbatim};

use crate::scene::Scene;

/// That a body is in a scene, and moves so.
pub(crate) fn notice(scene: &Scene, terms: BodyTerms, track: Track, seat: Option<u32>) -> Notice {
    Notice::BodyPlaced {
        terms,
        inertia: scene.inertia(terms.id),
        track,
        seat,
    }
}

/// What predictors need to know of a body of a scene.
pub(crate) fn manner(scene: &Scene, id: BodyId) -> Option<Manner> {
    let terms = scene.body(id)?;
    let shape = scene.shape(terms.shape)?;
    let damping = scene.terms().damping;
    Some(Manner::of(terms, shape, damping, scene.inertia(id)))
}

/// What is believed of a body before anything was said of it.
pub(crate) fn first_track(
    tick: Tick,
    observation: &Observation,
    kind: BodyKind,
    tumbles: bool,
) -> Track {
    let predictor = match (observation.activity, kind) {
        (Activity::Asleep, _) | (_, BodyKind::Static) => Predictor::Rest,
        (Activity::Awake, BodyKind::Dynamic) if tumbles => Predictor::Thrown,
        (Activity::Awake, BodyKind::Dynamic) => Predictor::Ballistic,
        (Activity::Awake, BodyKind::Kinematic) => Predictor::Uniform,
    };
    let resting = predictor == Predictor::Rest;
    let motion: Verbatim = observation.motion;
    Track {
        origin: tick,
        predictor,
        anchor: Anchor::Verbatim(if resting { motion.stilled() } else { motion }),
        carrier: None,
    }
}

/// Every body of a scene as it is now, in order of index.
pub(crate) fn everything(scene: &Scene) -> Vec<(BodyId, Manner, Track, Verbatim)> {
    let mut observations = Vec::new();
    scene.observe_all(&mut observations);
    let first = |observation: &Observation| {
        let id = observation.id;
        let kind = scene.body(id)?.kind;
        let manner = manner(scene, id)?;
        let tumbles = manner.inertia.is_some();
        let track = first_track(scene.tick(), observation, kind, tumbles);
        Some((id, manner, track, observation.motion))
    };
    observations.iter().filter_map(first).collect()
}
