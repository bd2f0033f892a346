//! Setups of decoding, rendering, predictions and the prefilter.
//!
//! Bodies fly and each is struck at intervals; the tier is 5 cm. A new subscriber decodes updates of a tenth of the
//! bodies, all with velocities. In mid-run, each body reverses three times a second and a subscriber decodes twenty
//! ticks. A view renders all bodies; none of them rests.
//!
//! [`Lanes`] is the least work of decoding and rendering. Every subscriber must compute it bit-exactly, four lanes at a time
//! for speed. It reads, looks up, stores and renders nothing, so no decoder and no view of such bodies can be faster.
//!
//! Each predictor predicts many bodies at one tick, one by one, as a judgement does. The prefilter tests bodies that are
//! within their tolerance, which is what it finds nearly always.

use std::hint::black_box;
use std::num::NonZeroU32;

use bytes::Bytes;
use glam::{DVec3, Vec3};
use rhumb_client::{RenderParams, RenderTime, View};
use rhumb_protocol::packet::{
    Head, LargestPacket, PacketKind, StreamId, Update, UpdatePacket, UpdateWriter,
};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamConfig, Subscriber,
};
use rhumb_protocol::wire::Wire as _;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Conditions, Damping, DenseTrack, ErrorPrefilter, Grid, Inertia,
    Integrator, LaneCorrection, Metres, Motion, PredictionX4, Predictor, PrefilterBody,
    PrefilterInput, PrefilterTrack, QuantisedState, Rate, Residual, Seconds, StepCoefficientTable,
    TRACK_AGE_MAX, Tick, Tolerance, Track, VelocityResidual,
};

const GRAVITY: Vec3 = Vec3::new(0.0, -9.806_65, 0.0);
const STREAM: StreamId = StreamId(0);

/// Ticks that a view renders in turn.
pub const TICKS: u64 = 60;
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

/// The stream of all setups here.
#[must_use]
pub fn config() -> StreamConfig {
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

/// The first track of a body.
#[must_use]
pub fn track(index: u32) -> Track {
    Track {
        origin: Tick::ZERO,
        predictor: Predictor::Ballistic,
        anchor: Anchor::Exact(state(index, 0)),
        parent: None,
    }
}

/// State of a body in mid-run: it moves back and forth and reverses at each impulse.
#[must_use]
pub fn impulse_state(index: u32, tick: u64) -> BodyState {
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
    #[inline(never)]
    pub fn decode(&self, subscriber: &mut Subscriber) {
        for datagram in &self.datagrams {
            subscriber.handle_datagram(datagram);
        }
    }
}

/// Packets, and the updates that they hold: the codec alone.
#[derive(Clone, Debug)]
pub struct PacketLoad {
    packets: Vec<Bytes>,
    updates: Vec<Vec<Update>>,
}

impl PacketLoad {
    /// The packets of a run of `bodies` bodies, in mid-run.
    #[must_use]
    pub fn new(bodies: u32) -> Self {
        let packets = DecodeLoad::in_mid_run(bodies).datagrams;
        let updates = packets.iter().map(|packet| {
            let mut updates = Vec::new();
            decode_into(packet, &mut updates);
            updates
        });
        let updates = updates.collect();
        Self { packets, updates }
    }

    /// Number of updates in all packets.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.updates.iter().map(|each| each.len() as u64).sum()
    }

    /// Decodes all packets, one after the other into the same list.
    pub fn decode(&self, updates: &mut Vec<Update>) {
        for packet in &self.packets {
            decode_into(packet, updates);
        }
    }

    /// Encodes all packets anew; returns their bytes.
    #[must_use]
    pub fn encode(&self) -> usize {
        let packets = (0..).zip(&self.updates);
        packets
            .map(|(number, updates)| encoded(number, updates).len())
            .sum()
    }
}

/// Decodes a packet that the publisher made.
fn decode_into(packet: &Bytes, updates: &mut Vec<Update>) {
    let mut from = Reader::new(packet);
    let head = Head::decode(&mut from).expect("a datagram has a head");
    let ends_tick = head.kind == PacketKind::UpdatesEnd;
    let packet =
        UpdatePacket::decode(ends_tick, from).expect("the publisher sends packets of updates");
    packet
        .updates(updates)
        .expect("the publisher's updates are well formed");
}

/// Encodes a packet of updates as the publisher does.
fn encoded(number: u64, updates: &[Update]) -> Vec<u8> {
    let mut writer = UpdateWriter::new(STREAM, number, number, 0).within(LargestPacket::DEFAULT);
    for update in updates {
        assert!(writer.push(update), "the packet held them before");
    }
    writer.finish(true)
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
    #[inline(never)]
    pub fn refresh(&mut self) {
        self.tick = (self.tick + 1) % TICKS;
        let render_params = RenderParams {
            at: RenderTime::at(Tick::new(self.tick)),
            now: Seconds::new(0.0),
            smooth: false,
            step: Rate::HZ_60.step(),
        };
        self.view.refresh(&mut self.subscriber, &render_params);
    }

    /// The bodies of the view.
    #[must_use]
    pub fn shown(&self) -> usize {
        self.view.ids().len()
    }
}

/// Tick at which the tracks are evaluated.
const LANES_AGE: Tick = Tick::new(20);

/// Tracks of bodies without gravity.
#[derive(Clone, Debug)]
pub struct Lanes {
    tracks: Vec<DenseTrack>,
    flow: StepCoefficientTable,
    grid: Grid,
}

impl Lanes {
    /// Builds the tracks on the grid of a stream.
    #[must_use]
    pub fn of(tracks: impl Iterator<Item = Track>, integrator: Integrator, grid: Grid) -> Self {
        let mut flow = StepCoefficientTable::new(integrator, Damping::default());
        flow.extend_to(TRACK_AGE_MAX);
        Self {
            tracks: tracks.map(|track| DenseTrack::new(&track)).collect(),
            flow,
            grid,
        }
    }

    /// Predicts all tracks.
    pub fn predict(&self) {
        self.each_batch(|batch| {
            batch.predict(|_, motion| {
                black_box(motion);
            });
        });
    }

    /// Predicts all tracks, and corrects each with its velocities.
    pub fn correct(&self) {
        let residual = Residual {
            position: [2, -1, 1],
            turn: [1, 0, -1],
            velocity: Some(VelocityResidual {
                velocity_exponent: 3,
                linear: [9, -2, 1],
                angular: [0, 1, 0],
            }),
        };
        let correction = LaneCorrection {
            residual: &residual,
            over: Seconds::new(1.0 / 3.0),
            grid: &self.grid,
        };
        self.each_batch(|batch| {
            if let Some(corrected) = batch.correct([correction; PredictionX4::LANES]) {
                for lane in 0..corrected.len() {
                    black_box(corrected.at(lane));
                }
            }
        });
    }

    fn each_batch(&self, mut each: impl FnMut(&mut PredictionX4)) {
        let conditions = Conditions {
            gravity: DVec3::ZERO,
            flow: &self.flow,
            inertia: None,
        };
        let mut batch = PredictionX4::default();
        for (key, track) in (0..).zip(&self.tracks) {
            let accepted = batch.take(key, track, LANES_AGE, &self.grid, &conditions);
            debug_assert!(accepted, "the track neither rests nor rotates freely");
            if batch.is_full() {
                each(&mut batch);
            }
        }
        each(&mut batch);
    }
}

/// Radius of the bodies.
const RADIUS: Metres = Metres::new(0.5);
/// Tick at which the tracks are evaluated.
const PREDICTION_AGE: Tick = Tick::new(10);
/// Moments of inertia of a brick, kg m²: its torque-free rotation takes a step for each tick.
const MOMENTS: [f32; 3] = [1.0, 2.0, 2.5];

/// Tracks of one predictor.
#[derive(Clone, Debug)]
pub struct PredictorLoad {
    tracks: Vec<Track>,
    grid: Grid,
    flow: StepCoefficientTable,
    inertia: Inertia,
}

impl PredictorLoad {
    /// Tracks of `bodies` bodies that spin and move.
    #[must_use]
    pub fn new(bodies: u32, predictor: Predictor) -> Self {
        let grid = Grid::new(Tolerance::NORMAL, RADIUS);
        let quantised = |index| {
            let quantised = QuantisedState::of(&spinning_state(index).motion(), &grid);
            let rests = predictor == Predictor::Rest;
            if rests {
                quantised.stilled()
            } else {
                quantised
            }
        };
        let tracks = (0..bodies).map(|index| Track {
            predictor,
            anchor: Anchor::Quantised(quantised(index)),
            ..track(index)
        });
        Self {
            tracks: tracks.collect(),
            grid,
            flow: flow(),
            inertia: Inertia::new(MOMENTS, [0.0, 0.0, 0.0, 1.0])
                .expect("a brick has these moments of inertia"),
        }
    }

    /// Predicts all bodies.
    pub fn predict(&self) {
        let conditions = Conditions {
            gravity: DVec3::NEG_Y * 9.806_65,
            flow: &self.flow,
            inertia: Some(&self.inertia),
        };
        for track in &self.tracks {
            black_box(track.at(PREDICTION_AGE, &self.grid, &conditions));
        }
    }
}

/// Tracks and truths of bodies within their tolerance.
#[derive(Clone, Debug)]
pub struct PrefilterLoad {
    bodies: Vec<(PrefilterTrack, BodyState)>,
    prefilter: ErrorPrefilter,
    flow: StepCoefficientTable,
    undecided: Vec<u32>,
}

impl PrefilterLoad {
    /// Bodies that move.
    #[must_use]
    pub fn moving(bodies: u32) -> Self {
        Self::of(bodies, Predictor::Uniform)
    }

    /// Bodies that rest.
    #[must_use]
    pub fn resting(bodies: u32) -> Self {
        Self::of(bodies, Predictor::Rest)
    }

    fn of(bodies: u32, predictor: Predictor) -> Self {
        let grid = Grid::new(Tolerance::NORMAL, RADIUS);
        let (integrator, flow) = (config().integrator, flow());
        let prefilter = ErrorPrefilter::new(Tolerance::NORMAL, integrator);
        let body = |index| {
            let start = impulse_state(index, 0);
            let rests = predictor == Predictor::Rest;
            let start = if rests { start.stilled() } else { start };
            let track = Track {
                predictor,
                anchor: Anchor::Exact(start),
                ..track(index)
            };
            let conditions = conditions(&flow);
            let truth = rounded(&track.at(PREDICTION_AGE, &grid, &conditions));
            let body = PrefilterBody {
                tolerance: Tolerance::NORMAL,
                grid: &grid,
                radius: RADIUS,
                conditions: &conditions,
            };
            let track = prefilter.track(&DenseTrack::new(&track), &body);
            (track.expect("the prefilter tests such tracks"), truth)
        };
        Self {
            bodies: (0..bodies).map(body).collect(),
            prefilter,
            flow,
            undecided: Vec::new(),
        }
    }

    /// Tests all bodies; returns the number that the prefilter leaves undecided.
    pub fn test(&mut self) -> usize {
        self.undecided.clear();
        let age = PREDICTION_AGE.since(Tick::ZERO).unwrap_or_default();
        let (mut batch, mut at_once) = (self.prefilter.batch(), 0);
        for (place, (track, truth)) in (0..).zip(&self.bodies) {
            let input = PrefilterInput {
                truth,
                track,
                age,
                flow: &self.flow,
            };
            at_once += usize::from(batch.test(place, &input, &mut self.undecided));
        }
        batch.finish(&mut self.undecided);
        at_once + self.undecided.len()
    }
}

/// A motion in the engine's precision.
fn rounded(motion: &Motion) -> BodyState {
    let p = motion.parts().map(|part| part as f32);
    BodyState::new(
        [p[0], p[1], p[2]],
        [p[3], p[4], p[5], p[6]],
        [p[7], p[8], p[9]],
        [p[10], p[11], p[12]],
    )
    .expect("a predicted motion is finite")
}

/// Conditions without gravity and inertia.
const fn conditions(flow: &StepCoefficientTable) -> Conditions<'_> {
    Conditions {
        gravity: DVec3::ZERO,
        flow,
        inertia: None,
    }
}

fn flow() -> StepCoefficientTable {
    let mut flow = StepCoefficientTable::new(config().integrator, Damping::default());
    flow.extend_to(TRACK_AGE_MAX);
    flow
}

/// State of a body that spins about no axis of its own.
fn spinning_state(index: u32) -> BodyState {
    let place = index as f32;
    BodyState::new(
        [place % 100.0, place / 100.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [3.0, 0.0, 0.0],
        [0.4, 1.0, 0.2],
    )
    .expect("these numbers are finite")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_are_as_long_when_they_are_encoded_anew() {
        let load = PacketLoad::new(300);
        let bytes: usize = load.packets.iter().map(Bytes::len).sum();
        assert!(
            load.updates() > 300,
            "each body reverses three times a second"
        );
        assert_eq!(load.encode(), bytes);
    }
}
