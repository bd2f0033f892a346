//! Setups of decoding and rendering.
//!
//! Bodies fly and each is struck at intervals; the tier is 5 cm. A new subscriber decodes updates of a tenth of the
//! bodies, all with velocities. In mid-run, each body reverses three times a second and a subscriber decodes twenty
//! ticks. A view renders all bodies; none of them rests.

use std::num::NonZeroU32;

use bytes::Bytes;
use glam::Vec3;
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
    Anchor, BodyId, BodyState, Integrator, Metres, Predictor, Rate, Seconds, Tick, Tolerance, Track,
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
