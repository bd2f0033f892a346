//! Predicted constant acceleration saves updates and stays in tolerance.
//!
//! An engine with four substeps accelerates one body for a while and lets it fly again; the tolerance is one
//! centimetre. Proved by the publisher's counters, by the subscriber's track, and by the distance between track and
//! truth.

use std::num::NonZeroU32;

use glam::DVec3;
use proptest::prelude::*;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, Metres, Predictor, Rate, Tick, Ticks, Tolerance, Track,
};

use crate::terms::TERMS;

const STREAM: StreamId = StreamId(3);
const BODY: BodyId = BodyId::new(0, 0);
const SUBSTEPS: NonZeroU32 = NonZeroU32::new(4).expect("four is not zero");
const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: SUBSTEPS,
};
const FIRST: DVec3 = DVec3::new(2.0, 0.5, -1.0);

/// The position and velocity of the body.
#[derive(Clone, Copy)]
struct AcceleratedBody {
    position: DVec3,
    linear: DVec3,
}

impl AcceleratedBody {
    /// Steps as an engine does, by substeps.
    fn step(&mut self, acceleration: DVec3) {
        let substep = INTEGRATOR.rate.step().seconds() / f64::from(SUBSTEPS.get());
        for _ in 0..SUBSTEPS.get() {
            self.linear += acceleration * substep;
            self.position += self.linear * substep;
        }
    }

    fn body_state(&self) -> BodyState {
        let narrow = |v: DVec3| v.as_vec3().to_array();
        BodyState::new(
            narrow(self.position),
            [0.0, 0.0, 0.0, 1.0],
            narrow(self.linear),
            [0.0; 3],
        )
        .expect("it is finite")
    }
}

/// The result of a run.
struct RunResult {
    updates: u64,
    /// The greatest share of the tolerance that the error of the subscriber's track takes.
    worst: f64,
    /// The number of ticks at which the subscriber's track has a constant acceleration.
    accelerated: u32,
}

/// The publisher of one body, its subscriber, and the body's true motion.
struct AccelerationLink {
    observation_history: ObservationHistory,
    publisher: Publisher,
    subscriber: Subscriber,
    past: Vec<AcceleratedBody>,
}

impl AccelerationLink {
    fn new(features: Features, lookahead: u32) -> Self {
        let tolerance = Tolerance::from_metres(Metres::new(0.01)).expect("a centimetre");
        let publish_schedule = PublishSchedule {
            lookahead: Ticks::new(lookahead),
            ..PublishSchedule::EACH_TICK
        };
        let config = StreamConfig {
            tolerance,
            integrator: INTEGRATOR,
            publish_interval: publish_schedule.publish_interval,
            features,
            ..TERMS
        };
        let start = config.start(STREAM, Tick::ZERO);
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        let flight = AcceleratedBody {
            position: DVec3::ZERO,
            linear: FIRST,
        };
        let first = Track {
            origin: Tick::ZERO,
            predictor: Predictor::Uniform,
            anchor: Anchor::Exact(flight.body_state()),
            parent: None,
        };
        let mut publisher = Publisher::new(STREAM, &config, Tick::ZERO);
        let mut subscriber = Subscriber::new(&start);
        assert!(
            publisher.place(BODY, &parameters, first) && subscriber.place(BODY, &parameters, first)
        );
        subscriber.handle_snapshot_end();
        Self {
            observation_history: ObservationHistory::new(publish_schedule),
            publisher,
            subscriber,
            past: vec![flight],
        }
    }

    /// Steps one tick. Returns the subscriber's track and its distance from the truth, m.
    fn step(&mut self, acceleration: DVec3) -> Option<(Track, f64)> {
        let mut flight = *self.past.last()?;
        flight.step(acceleration);
        let tick = Tick::new(self.past.len() as u64);
        self.past.push(flight);
        let observation = Observation {
            id: BODY,
            motion: flight.body_state(),
            activity: Activity::Awake,
        };
        self.observation_history.observe(tick, &[observation]);
        let mut packets = Vec::new();
        self.publisher
            .publish(&self.observation_history, 0, &mut packets);
        for packet in &packets {
            self.subscriber.handle_datagram(packet);
        }
        let present = self.observation_history.present()?;
        let track = self.subscriber.track(BODY)?;
        let predicted_motion = self
            .subscriber
            .predicted_motion(BODY, present)?
            .pose()
            .position;
        let truth = self.past[present.value() as usize].position.as_vec3();
        Some((track, predicted_motion.distance(truth.as_dvec3())))
    }
}

/// Runs a body with this acceleration in each tick.
fn run(accelerations: &[DVec3], features: Features, lookahead: u32) -> RunResult {
    let mut link = AccelerationLink::new(features, lookahead);
    let (mut worst, mut accelerated) = (0.0_f64, 0);
    for acceleration in accelerations {
        if let Some((track, off)) = link.step(*acceleration) {
            assert_eq!(link.publisher.tracks().next(), Some((BODY, track)));
            accelerated += u32::from(track.predictor.acceleration().is_some());
            worst = worst.max(off / 0.01);
        }
    }
    RunResult {
        updates: link.publisher.statistics().updates,
        worst,
        accelerated,
    }
}

/// The accelerations of a body that flies, is accelerated for some ticks, and flies on.
fn once(acceleration: DVec3, ticks: usize) -> Vec<DVec3> {
    let mut accelerations = vec![DVec3::ZERO; 20];
    accelerations.extend(vec![acceleration; ticks]);
    accelerations.extend(vec![DVec3::ZERO; 60]);
    accelerations
}

#[test]
fn steady_acceleration_needs_fewer_updates() {
    let accelerations = once(DVec3::new(-9.0, 3.0, 2.0), 40);
    for lookahead in [0, 6] {
        let with = run(&accelerations, Features::ALL, lookahead);
        let blind = Features {
            accelerated: false,
            ..Features::ALL
        };
        let without = run(&accelerations, blind, lookahead);
        assert!(with.accelerated > 20, "{} ticks", with.accelerated);
        assert_eq!(without.accelerated, 0);
        let (some, many) = (with.updates, without.updates);
        assert!(
            some * 2 <= many,
            "{some} updates with the feature, {many} without it"
        );
    }
}

#[test]
fn ended_acceleration_is_corrected_soon() {
    let accelerations = once(DVec3::new(0.0, 10.0, 0.0), 30);
    let with = run(&accelerations, Features::ALL, 0);
    assert!(
        (10..40).contains(&with.accelerated),
        "{} ticks",
        with.accelerated
    );
}

proptest! {
    #[test]
    fn accelerated_bodies_stay_within_tolerance(
        accelerations in proptest::collection::vec((proptest::array::uniform3(-40.0..40.0_f64), 1..30_usize), 1..8),
        lookahead in 0..=6_u32,
    ) {
        let each = |(acceleration, ticks): ([f64; 3], usize)| vec![DVec3::from_array(acceleration); ticks];
        let accelerations: Vec<_> = accelerations.into_iter().flat_map(each).collect();
        let run = run(&accelerations, Features::ALL, lookahead);
        prop_assert!(run.worst <= 1.0, "{} of the tolerance", run.worst);
    }
}
