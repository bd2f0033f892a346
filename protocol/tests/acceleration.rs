//! Bodies that something pushes steadily are told so, and spoken of less often
//!
//! One body that an engine of four substeps pushes for a while, and lets fly again, at a centimetre. It is proved by
//! what the publisher counts, by the listener's track, and by how far it is from the truth.

use std::num::NonZeroU32;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamTerms, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, Metres, Predictor, Rate, Tick, Ticks, Tolerance, Track,
};

const STREAM: StreamId = StreamId(3);
const BODY: BodyId = BodyId::new(0, 0);
const SUBSTEPS: NonZeroU32 = NonZeroU32::new(4).expect("four is not zero");
const INTEGRATOR: Integrator = Integrator {
    rate: Rate::HZ_60,
    substeps: SUBSTEPS,
};
const FIRST: DVec3 = DVec3::new(2.0, 0.5, -1.0);

/// Where a body is, and how fast.
#[derive(Clone, Copy)]
struct AcceleratedBody {
    position: DVec3,
    linear: DVec3,
}

impl AcceleratedBody {
    /// As an engine does it.
    fn step(&mut self, push: DVec3) {
        let substep = INTEGRATOR.rate.step().seconds() / f64::from(SUBSTEPS.get());
        for _ in 0..SUBSTEPS.get() {
            self.linear += push * substep;
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

/// How a run went.
struct RunResult {
    updates: u64,
    /// Share of the tolerance that the listener's track used at most.
    worst: f64,
    /// Ticks at which the listener took the body for one that is accelerated.
    accelerated: u32,
}

/// One body's publisher, its listener, and what was seen.
struct AccelerationLink {
    observation_history: ObservationHistory,
    publisher: Publisher,
    listener: Subscriber,
    past: Vec<AcceleratedBody>,
}

impl AccelerationLink {
    fn new(features: Features, lookahead: u32) -> Self {
        let tolerance = Tolerance::from_metres(Metres::new(0.01)).expect("a centimetre");
        let publish_schedule = PublishSchedule {
            lookahead: Ticks::new(lookahead),
            ..PublishSchedule::EACH_TICK
        };
        let config = StreamTerms {
            tolerance,
            integrator: INTEGRATOR,
            publish_interval: publish_schedule.publish_interval,
            gravity: Vec3::ZERO,
            features,
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
        let mut listener = Subscriber::new(&start);
        assert!(
            publisher.place(BODY, &parameters, first) && listener.place(BODY, &parameters, first)
        );
        listener.handle_snapshot_end();
        Self {
            observation_history: ObservationHistory::new(publish_schedule),
            publisher,
            listener,
            past: vec![flight],
        }
    }

    /// A tick passes; what the listener believes from then on, and how far that is from the truth, m.
    fn step(&mut self, push: DVec3) -> Option<(Track, f64)> {
        let mut flight = *self.past.last()?;
        flight.step(push);
        let tick = Tick::new(self.past.len() as u64);
        self.past.push(flight);
        let seen = Observation {
            id: BODY,
            motion: flight.body_state(),
            activity: Activity::Awake,
        };
        self.observation_history.observe(tick, &[seen]);
        let mut packets = Vec::new();
        self.publisher
            .publish(&self.observation_history, 0, &mut packets);
        for packet in &packets {
            self.listener.handle_datagram(packet);
        }
        let present = self.observation_history.present()?;
        let track = self.listener.track(BODY)?;
        let predicted_motion = self
            .listener
            .predicted_motion(BODY, present)?
            .pose()
            .position;
        let truth = self.past[present.value() as usize].position.as_vec3();
        Some((track, predicted_motion.distance(truth.as_dvec3())))
    }
}

/// A body that is accelerated so from tick to tick.
fn run(pushes: &[DVec3], features: Features, lookahead: u32) -> RunResult {
    let mut link = AccelerationLink::new(features, lookahead);
    let (mut worst, mut accelerated) = (0.0_f64, 0);
    for push in pushes {
        if let Some((track, off)) = link.step(*push) {
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

/// Flies for a while, is accelerated for a while, and flies on.
fn once(push: DVec3, ticks: usize) -> Vec<DVec3> {
    let mut pushes = vec![DVec3::ZERO; 20];
    pushes.extend(vec![push; ticks]);
    pushes.extend(vec![DVec3::ZERO; 60]);
    pushes
}

#[test]
fn steady_acceleration_needs_fewer_updates() {
    let pushes = once(DVec3::new(-9.0, 3.0, 2.0), 40);
    for lookahead in [0, 6] {
        let told = run(&pushes, Features::ALL, lookahead);
        let blind = Features {
            accelerated: false,
            ..Features::ALL
        };
        let untold = run(&pushes, blind, lookahead);
        assert!(told.accelerated > 20, "{} ticks", told.accelerated);
        assert_eq!(untold.accelerated, 0);
        let (some, many) = (told.updates, untold.updates);
        assert!(some * 2 <= many, "{some} updates, {many} without");
    }
}

#[test]
fn ended_acceleration_is_corrected_soon() {
    let pushes = once(DVec3::new(0.0, 10.0, 0.0), 30);
    let told = run(&pushes, Features::ALL, 0);
    assert!(
        (10..40).contains(&told.accelerated),
        "{} ticks",
        told.accelerated
    );
}

proptest! {
    #[test]
    fn accelerated_bodies_stay_within_tolerance(
        pushes in proptest::collection::vec((proptest::array::uniform3(-40.0..40.0_f64), 1..30_usize), 1..8),
        lookahead in 0..=6_u32,
    ) {
        let each = |(push, ticks): ([f64; 3], usize)| vec![DVec3::from_array(push); ticks];
        let pushes: Vec<_> = pushes.into_iter().flat_map(each).collect();
        let run = run(&pushes, Features::ALL, lookahead);
        prop_assert!(run.worst <= 1.0, "{} of the tolerance", run.worst);
    }
}
