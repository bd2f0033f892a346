//! A listener that loses packets of a stream, and what parities make of that.
//!
//! Scripts of single losses: a publisher says how some bodies bounce about, and the listener hears what the script lets
//! pass. Track must equal track, to the bit, as soon as enough was heard.

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::limits::PARITIES_KEPT;
use rhumb_protocol::packet::{Head, Kind, Low16, Parity, StreamId};
use rhumb_protocol::scene::Cadence;
use rhumb_protocol::stream::{
    Activity, Features, Manner, Observation, Publisher, Redundancy, StreamTerms, Subscriber,
    Witness,
};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{
    Anchor, BodyId, Integrator, Metres, Predictor, Rate, Tick, Tolerance, Track, Verbatim,
};

const STREAM: StreamId = StreamId(3);
const BODIES: u32 = 12;

struct Stage {
    publisher: Publisher,
    subscriber: Subscriber,
    witness: Witness,
    tick: u64,
}

/// Where a body is at a tick: it hops, each at its own time.
fn motion(body: u32, tick: u64) -> Verbatim {
    let phase = ((tick + u64::from(body) * 3) % 16) as f32 / 16.0;
    let height = 4.0 * phase * (1.0 - phase);
    let along = tick as f32 * 0.02;
    Verbatim::new(
        [body as f32 * 3.0, height, along],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.2],
        [0.0; 3],
    )
    .expect("a hop is finite")
}

impl Stage {
    fn new(features: Features) -> Self {
        let tolerance = Tolerance::from_metres(Metres::new(0.02)).expect("two centimetres");
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: std::num::NonZeroU32::MIN,
        };
        let gravity = Vec3::new(0.0, -9.8, 0.0);
        let terms = StreamTerms {
            tolerance,
            integrator,
            every: Cadence::EACH_TICK.every,
            gravity,
            features,
        };
        let mut publisher = Publisher::new(STREAM, &terms, Tick::ZERO);
        let mut subscriber = Subscriber::new(&terms.start(STREAM, Tick::ZERO));
        let manner = Manner::plain(Metres::new(0.5));
        for body in 0..BODIES {
            let track = Track {
                origin: Tick::ZERO,
                predictor: Predictor::Ballistic,
                anchor: Anchor::Verbatim(motion(body, 0)),
                carrier: None,
            };
            assert!(publisher.place(BodyId::new(body, 0), &manner, track));
            assert!(subscriber.place(BodyId::new(body, 0), &manner, track));
        }
        subscriber.handle_snapshot_end();
        Self {
            publisher,
            subscriber,
            witness: Witness::new(Cadence::EACH_TICK),
            tick: 0,
        }
    }

    /// One tick: its packet, and the parities that go with it.
    fn say(&mut self, redundancy: Redundancy) -> (Bytes, Vec<Bytes>) {
        self.tick += 1;
        let seen: Vec<_> = (0..BODIES)
            .map(|body| Observation {
                id: BodyId::new(body, 0),
                motion: motion(body, self.tick),
                activity: Activity::Awake,
            })
            .collect();
        self.witness.observe(Tick::new(self.tick), &seen);
        let (mut packets, mut parities) = (Vec::new(), Vec::new());
        self.publisher.publish(&self.witness, 0, &mut packets);
        self.publisher.say_parities(redundancy, &mut parities);
        assert_eq!(
            packets.len(),
            1,
            "bodies that hop are spoken of in each tick"
        );
        (packets.remove(0), parities)
    }

    /// A tick of which everything arrives.
    fn pass(&mut self, redundancy: Redundancy) {
        let (packet, parities) = self.say(redundancy);
        for datagram in [packet].iter().chain(&parities) {
            self.subscriber.handle_datagram(datagram);
        }
    }

    /// Tells the publisher what is lost; what it says to that arrives. Returns the kinds of that.
    fn ask(&mut self) -> Vec<Kind> {
        let echo = self.subscriber.echo();
        let mut answers = Vec::new();
        for number in self.publisher.answer(&echo, &mut answers) {
            let repair = self.publisher.repair(number, 0);
            answers.extend(repair.expect("it is remembered"));
        }
        let kind = |datagram: &Bytes| {
            Head::decode(&mut Reader::new(datagram))
                .expect("a head")
                .kind
        };
        let kinds = answers.iter().map(kind).collect();
        for datagram in answers {
            self.subscriber.handle_datagram(&datagram);
        }
        kinds
    }

    fn agrees(&self) -> bool {
        self.subscriber.is_settled()
            && self
                .publisher
                .tracks()
                .all(|(id, track)| self.subscriber.track(id) == Some(track))
    }
}

#[test]
fn a_lost_packet_is_had_back_from_the_next_parity_and_what_builds_on_it_is_read() {
    let mut stage = Stage::new(Features::ALL);
    for _ in 0..10 {
        stage.pass(Redundancy::Plain);
    }
    let (_, parities) = stage.say(Redundancy::Plain);
    assert!(parities.is_empty(), "after every other tick");
    let (packet, parities) = stage.say(Redundancy::Plain);
    stage.subscriber.handle_datagram(&packet);
    assert!(!stage.agrees());
    stage.subscriber.handle_datagram(&parities[0]);
    assert!(stage.agrees());
    let statistics = stage.subscriber.statistics();
    assert_eq!((statistics.rebuilt, statistics.repairs), (1, 0));
    assert_eq!(
        (stage.subscriber.lost(), stage.subscriber.complete()),
        (1, Tick::new(stage.tick))
    );
}

#[test]
fn who_lost_more_packets_than_it_keeps_parities_is_given_repairs() {
    let mut stage = Stage::new(Features::ALL);
    for _ in 0..10 {
        stage.pass(Redundancy::Off);
    }
    for _ in 0..=PARITIES_KEPT {
        stage.say(Redundancy::Off);
    }
    stage.pass(Redundancy::Off);
    assert_eq!(stage.subscriber.missing(), PARITIES_KEPT + 1);
    assert_eq!(stage.ask(), [Kind::Repair; PARITIES_KEPT + 1]);
    assert!(stage.agrees());
}

#[test]
fn two_lost_packets_and_a_lost_parity_are_had_back_from_the_parities_after() {
    let mut stage = Stage::new(Features::ALL);
    for _ in 0..10 {
        stage.pass(Redundancy::Plain);
    }
    stage.say(Redundancy::Plain);
    stage.say(Redundancy::Plain);
    for _ in 0..2 {
        assert!(!stage.agrees() || stage.subscriber.missing() == 0);
        stage.pass(Redundancy::Plain);
        stage.pass(Redundancy::Plain);
    }
    assert!(stage.agrees());
    assert_eq!(stage.subscriber.statistics().rebuilt, 2);
}

#[test]
fn what_is_lost_now_and_then_is_had_back_from_a_parity_that_was_asked_for() {
    let mut stage = Stage::new(Features::ALL);
    for _ in 0..5 {
        stage.pass(Redundancy::Off);
    }
    stage.say(Redundancy::Off);
    stage.say(Redundancy::Off);
    stage.pass(Redundancy::Off);
    assert_eq!(stage.subscriber.echo().parities, 2);
    // One of them may be lost.
    assert_eq!(stage.ask(), [Kind::Parity; 3]);
    assert!(stage.agrees());
}

#[test]
fn what_was_lost_long_ago_is_repaired() {
    let mut stage = Stage::new(Features::ALL);
    stage.pass(Redundancy::Off);
    stage.say(Redundancy::Off);
    for _ in 0..40 {
        stage.pass(Redundancy::Off);
    }
    assert!(stage.ask().contains(&Kind::Repair));
    assert!(stage.agrees());
}

#[test]
fn without_redundancy_what_is_lost_is_repaired() {
    let mut features = Features::ALL;
    features.redundancy = false;
    let mut stage = Stage::new(features);
    stage.pass(Redundancy::Plain);
    stage.say(Redundancy::Plain);
    stage.pass(Redundancy::Plain);
    assert_eq!(stage.ask(), [Kind::Repair]);
    assert!(stage.agrees());
}

#[test]
fn a_wrong_parity_is_not_believed_and_repairs_are_asked_for() {
    let mut stage = Stage::new(Features::ALL);
    for _ in 0..5 {
        stage.pass(Redundancy::Off);
    }
    stage.say(Redundancy::Off);
    stage.pass(Redundancy::Off);
    let before: Vec<_> = (0..BODIES)
        .map(|body| stage.subscriber.track(BodyId::new(body, 0)))
        .collect();
    let lie = Parity {
        last: Low16(5),
        covered: 0,
        row: 9,
        sums: vec![3, 1, 4, 1, 5],
    };
    stage.subscriber.handle_datagram(&lie.encode(STREAM));
    let after: Vec<_> = (0..BODIES)
        .map(|body| stage.subscriber.track(BodyId::new(body, 0)))
        .collect();
    assert_eq!(before, after);
    assert_eq!(stage.subscriber.statistics().malformed, 1);
    assert_eq!(stage.subscriber.echo().parities, 0);
    assert!(stage.ask().contains(&Kind::Repair));
    assert!(stage.agrees());
}

#[test]
fn a_rest_record_is_said_once_and_made_good_by_its_gap() {
    let mut stage = Stage::new(Features::ALL);
    for _ in 0..5 {
        stage.pass(Redundancy::Off);
    }
    stage.tick += 1;
    let seen: Vec<_> = (0..BODIES)
        .map(|body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, stage.tick).stilled(),
            activity: Activity::Asleep,
        })
        .collect();
    stage.witness.observe(Tick::new(stage.tick), &seen);
    let mut lost = Vec::new();
    stage.publisher.publish(&stage.witness, 0, &mut lost);
    assert!(!lost.is_empty());
    // Nothing is ever said of these bodies again; that silence is vouched for is enough to find the gap.
    stage.tick += 1;
    stage.witness.observe(Tick::new(stage.tick), &[]);
    let mut more = Vec::new();
    stage.publisher.publish(&stage.witness, 0, &mut more);
    assert!(more.is_empty());
    stage.subscriber.handle_datagram(&stage.publisher.vouch(0));
    assert!(!stage.agrees() && stage.subscriber.missing() == lost.len());
    stage.ask();
    assert!(stage.agrees());
    assert!(
        stage
            .publisher
            .tracks()
            .all(|(_, track)| track.is_resting())
    );
}
