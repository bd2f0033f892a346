//! Measures decoding per update and rendering per view.
//!
//! Bodies fly and each is struck at intervals; the tier is 5 cm. A new subscriber decodes updates of a tenth of the
//! bodies, all with velocities. In mid-run, each body reverses three times a second and a subscriber decodes twenty
//! ticks. A view renders all bodies; none of them rests.

use std::hint::black_box;
use std::num::NonZeroU32;
use std::time::Duration;

use bytes::Bytes;
use glam::Vec3;
use rhumb_client::{RenderParams, RenderTime, View};
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
use serde::{Deserialize, Serialize};

use super::floor::PredictionFloor;
use super::median::median;
use crate::processor::time_of;

const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);
const STREAM: StreamId = StreamId(0);

/// Ticks that a view renders in turn.
const TICKS: u64 = 60;
/// Ticks of a run decoded before and during the measurement.
const DECODED_TICKS: [u64; 2] = [60, 20];
/// Ticks between two impulses on one body; each tick of a run strikes one body in this many.
const IMPULSE_TICK: u64 = 20;

/// State of a body at a tick; a tenth of the bodies are struck at tick 1.
fn state(index: u32, tick: u64) -> BodyState {
    let place = index as f32;
    let seconds = tick as f32 / 60.0;
    let struck = if index.is_multiple_of(10) && tick > 0 {
        30.0
    } else {
        0.0
    };
    let position = [place % 100.0 + struck * seconds, place / 100.0, 0.0];
    BodyState::new(
        position,
        [0.0, 0.0, 0.0, 1.0],
        [struck, 0.0, 0.0],
        [0.0, 1.0, 0.0],
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
        gravity: GRAVITY,
        features: Features::ALL,
    }
}

/// Parameters of a body without gravity or inertia.
fn parameters() -> PredictionParameters {
    PredictionParameters {
        gravity_scale: 0.0,
        ..PredictionParameters::plain(Metres::new(0.5))
    }
}

fn track(index: u32) -> Track {
    Track {
        origin: Tick::ZERO,
        predictor: Predictor::Ballistic,
        anchor: Anchor::Exact(state(index, 0)),
        parent: None,
    }
}

/// State of a body in mid-run: it moves back and forth and reverses at each impulse.
fn impulse_state(index: u32, tick: u64) -> BodyState {
    let phase = tick + u64::from(index) % IMPULSE_TICK;
    let seconds = (phase % IMPULSE_TICK) as f32 / 60.0;
    let back = (phase / IMPULSE_TICK) % 2 == 1;
    let (speed, from) = if back {
        (-3.0, IMPULSE_TICK as f32 / 20.0)
    } else {
        (3.0, 0.0)
    };
    let place = index as f32;
    BodyState::new(
        [place % 100.0 + from + speed * seconds, place / 100.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [speed, 0.0, 0.0],
        [0.0; 3],
    )
    .expect("these numbers are finite")
}

/// A publisher of `bodies` bodies without updates yet.
#[must_use]
pub fn publisher(bodies: u32) -> Publisher {
    let mut publisher = Publisher::new(STREAM, &config(), Tick::ZERO);
    for index in 0..bodies {
        assert!(publisher.place(BodyId::new(index, 0), &parameters(), track(index)));
    }
    publisher
}

/// A subscriber that has just received a snapshot of `bodies` bodies.
#[must_use]
pub fn subscriber(bodies: u32) -> Subscriber {
    let mut subscriber = Subscriber::new(&config().start(STREAM, Tick::ZERO));
    for index in 0..bodies {
        assert!(subscriber.place(BodyId::new(index, 0), &parameters(), track(index)));
    }
    subscriber.handle_snapshot_end();
    subscriber
}

/// Observations of the first tick, at which a tenth of the bodies are struck.
#[must_use]
pub fn first_observations(bodies: u32) -> ObservationHistory {
    let observation = |index| Observation {
        id: BodyId::new(index, 0),
        motion: state(index, 1),
        activity: Activity::Awake,
    };
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    observation_history.observe(
        Tick::new(1),
        &(0..bodies).map(observation).collect::<Vec<_>>(),
    );
    observation_history
}

/// A subscriber and the datagrams it decodes.
#[derive(Clone, Debug)]
pub struct DecodeLoad {
    /// State of the subscriber before decoding.
    pub subscriber: Subscriber,
    /// Datagrams in order.
    pub datagrams: Vec<Bytes>,
    /// Number of updates in them.
    pub updates: u64,
}

impl DecodeLoad {
    fn of(subscriber: Subscriber, datagrams: Vec<Bytes>) -> Self {
        let mut load = Self {
            subscriber,
            datagrams,
            updates: 0,
        };
        let mut decoded = load.subscriber.clone();
        load.decode(&mut decoded);
        let updates = |of: &Subscriber| of.statistics().updates;
        load.updates = updates(&decoded) - updates(&load.subscriber);
        load
    }

    /// A subscriber that has just joined, and updates of a tenth of the bodies.
    #[must_use]
    pub fn new(bodies: u32) -> Self {
        let mut datagrams = Vec::new();
        publisher(bodies).publish(&first_observations(bodies), 0, &mut datagrams);
        Self::of(subscriber(bodies), datagrams)
    }

    /// A subscriber in mid-run, and the ticks that follow.
    #[must_use]
    pub fn in_mid_run(bodies: u32) -> Self {
        let (mut publisher, mut subscriber) = (publisher(bodies), subscriber(bodies));
        let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
        let mut following = Vec::new();
        for tick in 1..=DECODED_TICKS[0] + DECODED_TICKS[1] {
            let observation = |index| Observation {
                id: BodyId::new(index, 0),
                motion: impulse_state(index, tick),
                activity: Activity::Awake,
            };
            observation_history.observe(
                Tick::new(tick),
                &(0..bodies).map(observation).collect::<Vec<_>>(),
            );
            let mut encoded = Vec::new();
            publisher.publish(&observation_history, 0, &mut encoded);
            if tick > DECODED_TICKS[0] {
                following.extend(encoded);
                continue;
            }
            for datagram in &encoded {
                subscriber.handle_datagram(datagram);
            }
            subscriber.forget_before(Tick::new(tick));
        }
        Self::of(subscriber, following)
    }

    /// Decodes all datagrams.
    pub fn decode(&self, subscriber: &mut Subscriber) {
        for datagram in &self.datagrams {
            subscriber.handle_datagram(datagram);
        }
    }

    fn measure(&self, repeats: u32) -> f64 {
        let once = || {
            let mut subscriber = self.subscriber.clone();
            let (took, ()) = time_of(|| self.decode(&mut subscriber));
            black_box(subscriber);
            took
        };
        let took = median((0..repeats).map(|_| once()));
        took.as_nanos() as f64 / self.updates.max(1) as f64
    }
}

/// Renders all bodies of a stream at the next of sixty ticks, repeatedly.
#[derive(Debug)]
pub struct RenderLoad {
    subscriber: Subscriber,
    view: View,
    tick: u64,
}

impl RenderLoad {
    /// A load of `bodies` bodies.
    #[must_use]
    pub fn new(bodies: u32) -> Self {
        Self {
            subscriber: subscriber(bodies),
            view: View::default(),
            tick: 0,
        }
    }

    /// Renders the next tick.
    pub fn refresh(&mut self) {
        self.tick = (self.tick + 1) % TICKS;
        let render_params = RenderParams {
            at: RenderTime::at(Tick::new(self.tick)),
            now: Seconds::new(0.0),
            smooth: false,
        };
        self.view.refresh(&mut self.subscriber, &render_params);
    }

    fn measure(&mut self, repeats: u32) -> Duration {
        let mut each = || time_of(|| self.refresh()).0;
        median((0..repeats * TICKS as u32).map(|_| each()))
    }
}

/// Cost of decoding and rendering.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Decoding {
    /// Bodies of the stream.
    pub bodies: u32,
    /// First update of a body, nanoseconds.
    pub first_ns: f64,
    /// Update in mid-run, nanoseconds.
    pub update_ns: f64,
    /// View of all bodies, milliseconds.
    pub view_ms: f64,
    /// Lower bound: prediction and correction of one body alone, nanoseconds.
    pub correcting_ns: f64,
    /// Lower bound: prediction of all bodies alone, milliseconds.
    pub predicting_ms: f64,
}

/// Measures decoding; each figure is the median of `repeats`.
pub(super) fn decoding(bodies: u32, repeats: u32) -> Decoding {
    let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
    let often = repeats * TICKS as u32;
    let floor = |track: &dyn Fn(u32) -> Track| {
        PredictionFloor::of((0..bodies).map(track), config().integrator, grid)
    };
    // Anchors in mid-run lie on the grid; anchors of a snapshot do not.
    let quantised_track = |index| Track {
        anchor: Anchor::Quantised(QuantisedState::of(&impulse_state(index, 0).motion(), &grid)),
        ..track(index)
    };
    Decoding {
        bodies,
        first_ns: DecodeLoad::new(bodies).measure(repeats),
        update_ns: DecodeLoad::in_mid_run(bodies).measure(repeats),
        view_ms: RenderLoad::new(bodies).measure(repeats).as_secs_f64() * 1e3,
        correcting_ns: floor(&quantised_track).correcting(often),
        predicting_ms: floor(&track).predicting(often).as_secs_f64() * 1e3,
    }
}
