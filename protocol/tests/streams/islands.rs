//! Touching bodies arrive together: a stack moves as one under loss.
//!
//! Stacks are shaken without end, and the aliases of their bodies are shuffled among each other. Proved by the
//! listener's tracks after each tick: those of one stack are all of that tick or none.

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::packet::{LargestPacket, StreamId};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    StreamStart, StreamTerms, Subscriber,
};
use rhumb_reckoning::{
    Anchor, BodyId, BodyState, Integrator, Metres, Predictor, Rate, Tick, Tolerance, Track,
};

const STREAM: StreamId = StreamId(3);
const STACKS: u32 = 60;
const HEIGHT: u32 = 8;
const RADIUS: f64 = 0.5;

/// Bodies of one level have consecutive indices, so those of one stack do not.
const fn body(stack: u32, level: u32) -> BodyId {
    BodyId::new(level * STACKS + stack, 0)
}

/// The state of a body in a stack at a tick: shaken by some decimetres.
fn motion(stack: u32, level: u32, tick: u64) -> BodyState {
    let shaken = |axis: u64| {
        let seed = (u64::from(stack) << 40 | u64::from(level) << 32 | axis << 30 | tick) + 1;
        let mixed = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        ((mixed >> 40) as f32 / (1 << 24) as f32 - 0.5) * 0.4
    };
    let at = Vec3::new(
        (stack % 8) as f32 * 4.0 + shaken(0),
        level as f32 * 0.5 + shaken(1),
        (stack / 8) as f32 * 4.0 + shaken(2),
    );
    BodyState::new(at.to_array(), [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("it is finite")
}

struct StackLink {
    publisher: Publisher,
    observation_history: ObservationHistory,
    tick: u64,
    start: StreamStart,
    parameters: PredictionParameters,
}

impl StackLink {
    fn new() -> Self {
        let tolerance = Tolerance::from_metres(Metres::new(0.01)).expect("a centimetre");
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: std::num::NonZeroU32::MIN,
        };
        let publish_interval = PublishSchedule::EACH_TICK.publish_interval;
        let config = StreamTerms {
            tolerance,
            integrator,
            publish_interval,
            largest_packet: LargestPacket::DEFAULT,
            gravity: Vec3::ZERO,
            features: Features::ALL,
        };
        let mut link = Self {
            publisher: Publisher::new(STREAM, &config, Tick::ZERO),
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            tick: 0,
            start: config.start(STREAM, Tick::ZERO),
            parameters: PredictionParameters::plain(Metres::new(RADIUS)),
        };
        for (id, track) in firsts() {
            assert!(link.publisher.place(id, &link.parameters, track));
        }
        link
    }

    fn listener(&self) -> Subscriber {
        let mut subscriber = Subscriber::new(&self.start);
        for (id, track) in firsts() {
            assert!(subscriber.place(id, &self.parameters, track));
        }
        subscriber.handle_snapshot_end();
        subscriber
    }

    fn publish_tick(&mut self) -> Vec<Bytes> {
        self.tick += 1;
        let all = (0..HEIGHT).flat_map(|level| (0..STACKS).map(move |stack| (stack, level)));
        let observations: Vec<_> = all
            .map(|(stack, level)| Observation {
                id: body(stack, level),
                motion: motion(stack, level, self.tick),
                activity: Activity::Awake,
            })
            .collect();
        self.observation_history
            .observe(Tick::new(self.tick), &observations);
        let mut packets = Vec::new();
        self.publisher
            .publish(&self.observation_history, 0, &mut packets);
        packets
    }
}

/// The first track of every body.
fn firsts() -> impl Iterator<Item = (BodyId, Track)> {
    let all = (0..HEIGHT).flat_map(|level| (0..STACKS).map(move |stack| (stack, level)));
    all.map(|(stack, level)| {
        let anchor = Anchor::Exact(motion(stack, level, 0));
        let track = Track {
            origin: Tick::ZERO,
            predictor: Predictor::Uniform,
            anchor,
            parent: None,
        };
        (body(stack, level), track)
    })
}

/// The number of a stack's bodies that a listener received at a tick.
fn received_count(listener: &Subscriber, stack: u32, tick: u64) -> usize {
    let of_tick = |level: &u32| {
        let track = listener.track(body(stack, *level));
        track.is_some_and(|track| track.origin == Tick::new(tick))
    };
    (0..HEIGHT).filter(of_tick).count()
}

#[test]
fn a_stack_moves_as_one_whichever_packet_is_lost() {
    let mut link = StackLink::new();
    let packets = link.publish_tick();
    assert!(packets.len() > 3, "{} packets", packets.len());
    let mut missed = 0;
    for lost in 0..packets.len() {
        let mut listener = link.listener();
        for (_, packet) in (0..).zip(&packets).filter(|(place, _)| *place != lost) {
            listener.handle_datagram(packet);
        }
        for stack in 0..STACKS {
            let received = received_count(&listener, stack, link.tick);
            assert!(
                received == 0 || received == HEIGHT as usize,
                "{received} of {stack}"
            );
            missed += usize::from(received == 0);
        }
    }
    assert_eq!(missed, STACKS as usize, "each is in one packet");
}

#[test]
fn without_loss_everything_arrives() {
    let mut link = StackLink::new();
    let mut listener = link.listener();
    for _ in 0..5 {
        for packet in link.publish_tick() {
            listener.handle_datagram(&packet);
        }
        assert!(listener.is_converged());
        for (id, track) in link.publisher.tracks() {
            assert_eq!(listener.track(id), Some(track));
        }
    }
}
