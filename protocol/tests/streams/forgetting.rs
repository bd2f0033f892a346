//! A subscriber that drops previous tracks loses nothing that it needs.
//!
//! Two subscribers receive the same datagrams of a stream with losses. One of them receives the earliest tick of
//! interest again and again. From that tick on both predict the same motions, to the bit, with the same bounds.

use bytes::Bytes;
use glam::Vec3;
use proptest::prelude::*;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    ErrorBound, ObservationHistory, PredictionParameters, Publisher, StreamConfig, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, Metres, Predictor, Rate, Tick, Ticks, Tolerance, Track,
};

use crate::terms::{TERMS, awake, place_falling};

const BODIES: u32 = 10;
/// Bodies from this index on move along with the first one, as if attached to it.
const GATHERED: u32 = 5;

/// The state of a body at a tick: it hops; the last ones move as the first one does.
fn motion(body: u32, tick: u64) -> BodyState {
    let hops = if body < GATHERED { body } else { 0 };
    let phase = ((tick + u64::from(hops) * 3) % 7) as f32 / 7.0;
    let height = 2.0 * phase * (1.0 - phase);
    BodyState::new(
        [body as f32, height, tick as f32 * 0.02],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.2],
        [0.0; 3],
    )
    .expect("a hop is finite")
}

fn ends() -> (Publisher, Subscriber) {
    let tolerance = Tolerance::from_metres(Metres::new(0.02)).expect("two centimetres");
    let integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: std::num::NonZeroU32::MIN,
    };
    let (stream, gravity) = (StreamId(3), Vec3::new(0.0, -9.8, 0.0));
    let publish_interval = PublishSchedule::EACH_TICK.publish_interval;
    let config = StreamConfig {
        tolerance,
        integrator,
        publish_interval,
        gravity,
        ..TERMS
    };
    let mut publisher = Publisher::new(stream, &config, Tick::ZERO);
    let mut subscriber = Subscriber::new(&config.start(stream, Tick::ZERO));
    for body in 0..BODIES {
        let parameters =
            PredictionParameters::plain(Metres::new(if body == 0 { 4.0 } else { 0.5 }));
        place_falling(
            (&mut publisher, &mut subscriber),
            body,
            &parameters,
            motion(body, 0),
        );
    }
    subscriber.handle_snapshot_end();
    (publisher, subscriber)
}

/// Adds the observations of all bodies at a tick.
fn observe(observation_history: &mut ObservationHistory, tick: u64) -> &ObservationHistory {
    let observations = awake(BODIES, |body| motion(body, tick));
    observation_history.observe(Tick::new(tick), &observations);
    observation_history
}

/// The fate of a tick's packets, and how far back the next motions are needed.
#[derive(Clone, Copy, Debug)]
struct Step {
    lost: bool,
    refreshed: bool,
    back: u64,
}

fn step() -> impl Strategy<Value = Step> {
    let part = (prop::bool::weighted(0.2), prop::bool::weighted(0.3));
    (part, 0_u64..12).prop_map(|((lost, refreshed), back)| Step {
        lost,
        refreshed,
        back,
    })
}

proptest! {
    #[test]
    fn forgotten_tracks_are_never_needed(steps in proptest::collection::vec(step(), 1..120)) {
        let (mut publisher, mut keeping) = ends();
        let mut dropping = keeping.clone();
        let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        let mut from = 0;
        for (tick, step) in (1..).zip(&steps) {
            let mut datagrams: Vec<Bytes> = Vec::new();
            publisher.publish(observe(&mut observation_history, tick), 0, &mut datagrams);
            if step.lost {
                datagrams.clear();
            }
            if step.refreshed {
                let missing: Vec<u64> = keeping.missing_packets().collect();
                let refreshes = missing.iter().filter_map(|number| publisher.refresh(*number, 0));
                datagrams.extend(refreshes.flatten());
            }
            for datagram in &datagrams {
                keeping.handle_datagram(datagram);
                dropping.handle_datagram(datagram);
            }
            from = from.max(tick.saturating_sub(step.back));
            dropping.forget_before(Tick::new(from));
            prop_assert_eq!(keeping.statistics(), dropping.statistics());
            for (body, at) in (0..BODIES).flat_map(|body| (from..=tick + 1).map(move |at| (body, at))) {
                let (id, at) = (BodyId::new(body, 0), Tick::new(at));
                // A subscriber that knows the shown moment keeps the tracks for it, so that it knows more at times.
                let bound = keeping.bound_at(id, at);
                if matches!(bound, Some(ErrorBound::Within(_))) {
                    prop_assert_eq!(keeping.predicted_motion(id, at), dropping.predicted_motion(id, at));
                    prop_assert_eq!(bound, dropping.bound_at(id, at));
                }
            }
        }
    }
}

#[test]
fn a_body_that_changes_has_not_left_but_one_with_a_successor_has() {
    let (_, mut subscriber) = ends();
    subscriber.set_history(Ticks::new(8));
    subscriber.forget_before(Tick::ZERO);
    let [at, before] = [3, 2].map(Tick::new);
    let parameters = PredictionParameters::plain(Metres::new(0.7));
    let (changed, gone, successor) = (BodyId::new(1, 0), BodyId::new(2, 0), BodyId::new(2, 1));
    for id in [changed, successor] {
        let track = Track {
            origin: at,
            predictor: Predictor::Ballistic,
            anchor: Anchor::Exact(motion(id.index(), 3)),
            parent: None,
        };
        assert!(subscriber.place(id, &parameters, track));
    }
    assert_eq!(subscriber.body_at(1, at), Some(changed));
    assert!(!subscriber.has_left(changed, before) && !subscriber.has_left(changed, at));
    assert_eq!(subscriber.body_at(2, before), Some(gone));
    assert!(!subscriber.has_left(gone, before) && subscriber.has_left(gone, at));
}

#[test]
fn bodies_that_move_along_are_attached() {
    let (mut publisher, _) = ends();
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    for tick in 1..40 {
        publisher.publish(observe(&mut observation_history, tick), 0, &mut Vec::new());
    }
    let held = publisher
        .tracks()
        .filter(|(_, track)| track.parent.is_some());
    assert!(held.count() > 0);
}
