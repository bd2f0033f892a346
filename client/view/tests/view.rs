//! The view shows the prediction of the tracks for its moment.
//!
//! Proved on a publisher and a subscriber in one process, without a network.

use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
use proptest::prelude::*;
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Grid, Integrator, Metres, Predictor, QuantisedState, Rate, Seconds,
    Tick, Tolerance, Track,
};
use rhumb_view::{RenderParams, RenderTime, View};

const STREAM: StreamId = StreamId(0);
const BALL: BodyId = BodyId::new(3, 0);
const OTHER: BodyId = BodyId::new(7, 0);

struct Pair {
    observation_history: ObservationHistory,
    publisher: Publisher,
    subscriber: Subscriber,
    view: View,
}

fn moving(x: f32, speed: f32) -> BodyState {
    BodyState::new(
        [x, 0.1, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [speed, 0.0, 0.0],
        [0.0; 3],
    )
    .expect("these numbers are finite")
}

fn config() -> StreamConfig {
    StreamConfig {
        tolerance: Tolerance::NORMAL,
        integrator: Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        },
        publish_interval: PublishSchedule::EACH_TICK.publish_interval,
        largest_packet: LargestPacket::DEFAULT,
        gravity: Vec3::ZERO,
        features: Features::ALL,
    }
}

/// A track from the first tick on.
fn track(predictor: Predictor, start: BodyState, parent: Option<BodyId>) -> Track {
    Track {
        origin: Tick::ZERO,
        predictor,
        anchor: Anchor::Exact(start),
        parent,
    }
}

fn params(at: RenderTime, now: Seconds, smooth: bool) -> RenderParams {
    RenderParams {
        at,
        now,
        smooth,
        step: Rate::HZ_60.step(),
    }
}

impl Pair {
    fn new() -> Self {
        let config = config();
        let mut publisher = Publisher::new(STREAM, &config, Tick::ZERO);
        let mut subscriber = Subscriber::new(&config.start(STREAM, Tick::ZERO));
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        for id in [BALL, OTHER] {
            let track = track(Predictor::Uniform, moving(0.0, 6.0), None);
            assert!(publisher.place(id, &parameters, track));
            assert!(subscriber.place(id, &parameters, track));
        }
        subscriber.handle_snapshot_end();
        Self {
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            publisher,
            subscriber,
            view: View::default(),
        }
    }

    fn publish(&mut self, tick: u64, motion: BodyState, activity: Activity) {
        self.publish_body(BALL, tick, motion, activity);
    }

    fn publish_body(
        &mut self,
        id: BodyId,
        tick: u64,
        motion: BodyState,
        activity: Activity,
    ) -> Vec<Bytes> {
        let observation = Observation {
            id,
            motion,
            activity,
        };
        let mut out: Vec<Bytes> = Vec::new();
        self.observation_history
            .observe(Tick::new(tick), &[observation]);
        self.publisher
            .publish(&self.observation_history, 0, &mut out);
        for datagram in &out {
            self.subscriber.handle_datagram(datagram);
        }
        out
    }

    fn look(&mut self, tick: u64) -> (Vec3, bool) {
        let at = RenderTime::at(Tick::new(tick));
        let (now, smooth) = (Seconds::new(0.0), false);
        self.view
            .refresh(&mut self.subscriber, &params(at, now, smooth));
        let place = self.view.place(BALL).expect("the ball is in the view");
        (self.view.positions()[place], self.view.resting()[place])
    }
}

#[test]
fn a_resting_body_has_the_pose_of_the_engine_and_does_not_change() {
    let mut pair = Pair::new();
    let rest = moving(0.123_456_7, 0.0);
    pair.publish(1, rest, Activity::Asleep);
    let (position, resting) = pair.look(1);
    assert_eq!(position.to_array(), rest.position());
    assert!(resting);
    pair.look(2);
    let changed: Vec<_> = pair
        .view
        .changed()
        .map(|place| pair.view.ids()[place])
        .collect();
    assert_eq!(changed, [OTHER]);
}

#[test]
fn two_views_of_one_moment_are_equal() {
    let mut pair = Pair::new();
    let first = pair.look(5);
    assert_eq!(pair.look(5), first);
    assert_eq!(pair.view.changed().count(), 0);
}

#[test]
fn a_view_behind_the_stream_does_not_show_a_rest_before_it_began() {
    let mut pair = Pair::new();
    let (before, _) = pair.look(4);
    pair.publish(9, moving(2.0, 0.0), Activity::Asleep);
    let (still_before, resting) = pair.look(4);
    assert_eq!(before, still_before);
    assert!(!resting);
    let (after, resting) = pair.look(9);
    assert_eq!(after.x, 2.0);
    assert!(resting);
}

#[test]
fn the_removal_of_a_body_keeps_the_other_bodies() {
    let mut pair = Pair::new();
    pair.look(1);
    assert!(pair.subscriber.remove(BALL));
    let at = RenderTime::at(Tick::new(2));
    let (now, smooth) = (Seconds::new(0.0), false);
    pair.view
        .refresh(&mut pair.subscriber, &params(at, now, smooth));
    assert_eq!(pair.view.removed(), [BALL]);
    assert_eq!(pair.view.place(BALL), None);
    assert_eq!(pair.view.ids(), [OTHER]);
    assert_eq!(pair.view.place(OTHER), Some(0));
}

#[test]
fn smoothing_hides_the_jump_of_a_prediction_and_not_the_motion_of_the_body() {
    let look = |pair: &mut Pair, tick: u64| {
        let at = RenderTime::at(Tick::new(tick));
        let now = Seconds::new(tick as f64 / 60.0);
        let smooth = true;
        pair.view
            .refresh(&mut pair.subscriber, &params(at, now, smooth));
        let place = pair.view.place(BALL).expect("the ball is in the view");
        pair.view.positions()[place].x
    };
    // At one view per tick or per six ticks, an update that corrects the prediction by 7 cm causes neither a pause nor
    // a jump.
    for pause in [1, 6] {
        let mut pair = Pair::new();
        let mut last = look(&mut pair, 0);
        for tick in 1..=30 {
            if tick == 12 {
                let jumped = moving(6.0 * 12.0 / 60.0 + 0.07, 6.0);
                pair.publish(12, jumped, Activity::Awake);
            }
            if tick % pause == 0 {
                let shown = look(&mut pair, tick);
                let travelled = 6.0 * pause as f32 / 60.0;
                assert!(
                    (shown - last - travelled).abs() < 0.075,
                    "{pause}, {tick}: {}",
                    shown - last
                );
                if tick == 12 {
                    assert!(
                        (shown - last - travelled).abs() < 0.01,
                        "the correction begins at the shown pose"
                    );
                }
                last = shown;
            }
        }
    }
}

/// The x of the other body, in a view of a moment.
fn look_at_other(pair: &mut Pair, at: RenderTime, smooth: bool) -> f32 {
    // Long after the look before: a correction is over.
    let now = Seconds::new(10.0 * at.ticks());
    pair.view
        .refresh(&mut pair.subscriber, &params(at, now, smooth));
    pair.view.position(OTHER).expect("it is in the view").x
}

/// A pair whose other body is attached to the ball, two metres beside it.
fn attached_pair() -> Pair {
    let mut pair = Pair::new();
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let attached = Track {
        anchor: Anchor::Quantised(QuantisedState::of(&moving(2.0, 0.0).motion(), &grid)),
        ..track(Predictor::Rest, moving(2.0, 0.0), Some(BALL))
    };
    assert!(pair.publisher.place(OTHER, &parameters, attached));
    assert!(pair.subscriber.place(OTHER, &parameters, attached));
    pair
}

#[test]
fn a_body_whose_parent_was_removed_stays_until_the_track_of_its_update() {
    for smooth in [false, true] {
        let mut pair = attached_pair();
        let at = |tick| RenderTime::at(Tick::new(tick));
        let held = look_at_other(&mut pair, at(30), smooth);
        assert!((held - 5.0).abs() < 0.05, "3 m by its parent: {held}");
        assert!(pair.subscriber.remove(BALL));
        pair.publisher.remove(BALL);
        assert_eq!(look_at_other(&mut pair, at(60), smooth), held);
        // A view behind the stream, also between two ticks, does not show the relative pose either.
        pair.publish_body(OTHER, 100, moving(7.0, 0.0), Activity::Awake);
        assert_eq!(pair.subscriber.track(OTHER).unwrap().parent, None);
        let between = RenderTime {
            fraction: 0.5,
            ..at(98)
        };
        for moment in [at(90), between, at(99)] {
            assert_eq!(look_at_other(&mut pair, moment, smooth), held);
        }
        let own = look_at_other(&mut pair, at(130), smooth);
        assert!((own - 7.0).abs() < 0.05, "{own}");
    }
}

#[test]
fn a_body_that_comes_without_its_parent_has_a_pose() {
    let mut pair = attached_pair();
    assert!(pair.subscriber.remove(BALL));
    let shown = look_at_other(&mut pair, RenderTime::at(Tick::new(30)), false);
    assert!(shown.is_finite());
}

#[test]
fn bodies_that_a_resumed_session_lacks_are_removed() {
    let mut pair = Pair::new();
    pair.look(1);
    pair.subscriber = Subscriber::new(&config().start(STREAM, Tick::new(2)));
    let track = Track {
        origin: Tick::new(2),
        ..track(Predictor::Uniform, moving(1.0, 0.0), None)
    };
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    assert!(pair.subscriber.place(BALL, &parameters, track));
    pair.subscriber.handle_snapshot_end();
    pair.view.begin_anew();
    let (position, _) = pair.look(2);
    assert_eq!(position.x, 1.0);
    assert_eq!(
        (pair.view.ids(), pair.view.removed()),
        (&[BALL][..], &[OTHER][..])
    );
    pair.look(3);
    assert_eq!(
        (pair.view.ids(), pair.view.removed()),
        (&[BALL][..], &[][..])
    );
}

/// A scene of bodies that move, fall and rest.
fn crowd() -> Pair {
    let mut pair = Pair::new();
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    for index in 10..40 {
        let predictor = match index % 3 {
            0 => Predictor::Rest,
            1 => Predictor::Uniform,
            _ => Predictor::Ballistic,
        };
        let start = moving(index as f32, 0.1 * (index % 7) as f32);
        let start = if index % 3 == 0 {
            start.stilled()
        } else {
            start
        };
        let (id, track) = (BodyId::new(index, 0), track(predictor, start, None));
        assert!(pair.publisher.place(id, &parameters, track));
        assert!(pair.subscriber.place(id, &parameters, track));
    }
    pair
}

proptest! {
    #[test]
    fn a_view_shows_what_the_tracks_predict_whatever_it_has_kept(
        steps in proptest::collection::vec((0_u32..4, 10_u32..40, -3.0_f32..3.0, 0_usize..3), 1..40),
    ) {
        let mut pair = crowd();
        // It is never shown, so that a new view of a copy of it begins with nothing.
        let mut unseen = pair.subscriber.clone();
        let mut tick = 0_u64;
        for (what, index, speed, fraction) in steps {
            let id = BodyId::new(index, 0);
            let activity = if what == 2 { Activity::Asleep } else { Activity::Awake };
            match what {
                0 => tick += 1,
                1 | 2 => {
                    tick += 1;
                    for datagram in pair.publish_body(id, tick, moving(index as f32, speed), activity) {
                        unseen.handle_datagram(&datagram);
                    }
                }
                _ => {
                    pair.publisher.remove(id);
                    assert_eq!(pair.subscriber.remove(id), unseen.remove(id));
                }
            }
            let at = RenderTime { tick: Tick::new(tick), fraction: [0.0, 0.25, 0.5][fraction] };
            let params = params(at, Seconds::new(tick as f64 / 60.0), false);
            pair.view.refresh(&mut pair.subscriber, &params);
            let mut fresh = View::default();
            fresh.refresh(&mut unseen.clone(), &params);
            for id in fresh.ids() {
                prop_assert_eq!(fresh.position(*id), pair.view.position(*id), "{} at {:?}", id, at);
                prop_assert_eq!(fresh.rotation(*id), pair.view.rotation(*id), "{} at {:?}", id, at);
            }
            prop_assert_eq!(fresh.ids().len(), pair.view.ids().len());
        }
    }
}
