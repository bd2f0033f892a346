//! Bodies that something pushes steadily are told so, and spoken of less often
//!
//! One body that an engine of four substeps pushes for a while, and lets fly again, at a centimetre. It is proved by
//! what the publisher counts, by the listener's track, and by how far it is from the truth.

use std::num::NonZeroU32;

use glam::{DVec3, Vec3};
use proptest::prelude::*;
use rhumb_protocol::packet::StreamId;
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Features, Manner, Observation, Publisher, StreamTerms, Subscriber, Witness,
};
use rhumb_reckoning::{
    Anchor, BodyId, Integrator, Metres, Predictor, Rate, Tick, Ticks, Tolerance, Track, Verbatim,
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
struct Flight {
    position: DVec3,
    linear: DVec3,
}

impl Flight {
    /// As an engine does it.
    fn step(&mut self, push: DVec3) {
        let substep = INTEGRATOR.rate.step().seconds() / f64::from(SUBSTEPS.get());
        for _ in 0..SUBSTEPS.get() {
            self.linear += push * substep;
            self.position += self.linear * substep;
        }
    }

    fn verbatim(&self) -> Verbatim {
        let narrow = |v: DVec3| v.as_vec3().to_array();
        Verbatim::new(
            narrow(self.position),
            [0.0, 0.0, 0.0, 1.0],
            narrow(self.linear),
            [0.0; 3],
        )
        .expect("it is finite")
    }
}

/// How a run went.
struct Run {
    updates: u64,
    /// Share of the tolerance that the listener's track used at most.
    worst: f64,
    /// Ticks at which the listener took the body for one that is pushed.
    pushed: u32,
}

/// One body's publisher, its listener, and what was seen.
struct Stage {
    witness: Witness,
    publisher: Publisher,
    listener: Subscriber,
    past: Vec<Flight>,
}

impl Stage {
    fn new(features: Features, hindsight: u32) -> Self {
        let tolerance = Tolerance::from_metres(Metres::new(0.01)).expect("a centimetre");
        let cadence = Cadence {
            hindsight: Ticks::new(hindsight),
            ..Cadence::EACH_TICK
        };
        let terms = StreamTerms {
            tolerance,
            integrator: INTEGRATOR,
            every: cadence.every,
            gravity: Vec3::ZERO,
            features,
        };
        let start = terms.start(STREAM, Tick::ZERO);
        let manner = Manner::plain(Metres::new(0.5));
        let flight = Flight {
            position: DVec3::ZERO,
            linear: FIRST,
        };
        let first = Track {
            origin: Tick::ZERO,
            predictor: Predictor::Uniform,
            anchor: Anchor::Verbatim(flight.verbatim()),
            carrier: None,
        };
        let mut publisher = Publisher::new(STREAM, &terms, Tick::ZERO);
        let mut listener = Subscriber::new(&start);
        assert!(publisher.place(BODY, &manner, first) && listener.place(BODY, &manner, first));
        listener.handle_snapshot_end();
        Self {
            witness: Witness::new(cadence),
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
            motion: flight.verbatim(),
            activity: Activity::Awake,
        };
        self.witness.observe(tick, &[seen]);
        let mut packets = Vec::new();
        self.publisher.publish(&self.witness, 0, &mut packets);
        for packet in &packets {
            self.listener.handle_datagram(packet);
        }
        let present = self.witness.present()?;
        let track = self.listener.track(BODY)?;
        let believed = self.listener.believed(BODY, present)?.pose().position;
        let truth = self.past[present.value() as usize].position.as_vec3();
        Some((track, believed.distance(truth.as_dvec3())))
    }
}

/// A body that is pushed so from tick to tick.
fn run(pushes: &[DVec3], features: Features, hindsight: u32) -> Run {
    let mut stage = Stage::new(features, hindsight);
    let (mut worst, mut pushed) = (0.0_f64, 0);
    for push in pushes {
        if let Some((track, off)) = stage.step(*push) {
            assert_eq!(stage.publisher.tracks().next(), Some((BODY, track)));
            pushed += u32::from(track.predictor.push().is_some());
            worst = worst.max(off / 0.01);
        }
    }
    Run {
        updates: stage.publisher.statistics().updates,
        worst,
        pushed,
    }
}

/// Flies for a while, is pushed for a while, and flies on.
fn once(push: DVec3, ticks: usize) -> Vec<DVec3> {
    let mut pushes = vec![DVec3::ZERO; 20];
    pushes.extend(vec![push; ticks]);
    pushes.extend(vec![DVec3::ZERO; 60]);
    pushes
}

#[test]
fn who_is_pushed_steadily_is_spoken_of_less_often() {
    let pushes = once(DVec3::new(-9.0, 3.0, 2.0), 40);
    for hindsight in [0, 6] {
        let told = run(&pushes, Features::ALL, hindsight);
        let blind = Features {
            pushed: false,
            ..Features::ALL
        };
        let untold = run(&pushes, blind, hindsight);
        assert!(told.pushed > 20, "{} ticks", told.pushed);
        assert_eq!(untold.pushed, 0);
        let (some, many) = (told.updates, untold.updates);
        assert!(some * 2 <= many, "{some} updates, {many} without");
    }
}

#[test]
fn a_push_that_ends_is_not_believed_for_long() {
    let pushes = once(DVec3::new(0.0, 10.0, 0.0), 30);
    let told = run(&pushes, Features::ALL, 0);
    assert!((10..40).contains(&told.pushed), "{} ticks", told.pushed);
}

proptest! {
    #[test]
    fn whatever_pushes_a_body_its_listeners_are_within_tolerance(
        pushes in proptest::collection::vec((proptest::array::uniform3(-40.0..40.0_f64), 1..30_usize), 1..8),
        hindsight in 0..=6_u32,
    ) {
        let each = |(push, ticks): ([f64; 3], usize)| vec![DVec3::from_array(push); ticks];
        let pushes: Vec<_> = pushes.into_iter().flat_map(each).collect();
        let run = run(&pushes, Features::ALL, hindsight);
        prop_assert!(run.worst <= 1.0, "{} of the tolerance", run.worst);
    }
}
