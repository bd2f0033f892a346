//! Recovery of lost packets from repair symbols and refreshes.
//!
//! Scripts of single losses: a publisher sends updates of some bouncing bodies, and the subscriber receives those that
//! the script delivers. As soon as enough is received, all tracks are equal to the bit.

use bytes::Bytes;
use glam::Vec3;
use rhumb_protocol::limits::REPAIR_SYMBOLS_KEPT;
use rhumb_protocol::packet::{Head, Low16, PacketKind, RepairSymbol, StreamId};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    Activity, Features, Observation, ObservationHistory, PredictionParameters, Publisher,
    Redundancy, StreamConfig, Subscriber,
};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::{BodyId, BodyState, Integrator, Metres, Rate, Tick, Tolerance};

use crate::terms::{TERMS, awake, place_falling};

const STREAM: StreamId = StreamId(3);
const BODIES: u32 = 12;

struct FecLink {
    publisher: Publisher,
    subscriber: Subscriber,
    observation_history: ObservationHistory,
    tick: u64,
}

/// The state of a body at a tick: it hops, each body at its own time.
fn motion(body: u32, tick: u64) -> BodyState {
    let phase = ((tick + u64::from(body) * 3) % 16) as f32 / 16.0;
    let height = 4.0 * phase * (1.0 - phase);
    let along = tick as f32 * 0.02;
    BodyState::new(
        [body as f32 * 3.0, height, along],
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 1.2],
        [0.0; 3],
    )
    .expect("a hop is finite")
}

impl FecLink {
    fn new(features: Features) -> Self {
        let tolerance = Tolerance::from_metres(Metres::new(0.02)).expect("two centimetres");
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: std::num::NonZeroU32::MIN,
        };
        let gravity = Vec3::new(0.0, -9.8, 0.0);
        let config = StreamConfig {
            tolerance,
            integrator,
            gravity,
            features,
            ..TERMS
        };
        let mut publisher = Publisher::new(STREAM, &config, Tick::ZERO);
        let mut subscriber = Subscriber::new(&config.start(STREAM, Tick::ZERO));
        let parameters = PredictionParameters::plain(Metres::new(0.5));
        for body in 0..BODIES {
            place_falling(
                (&mut publisher, &mut subscriber),
                body,
                &parameters,
                motion(body, 0),
            );
        }
        subscriber.handle_snapshot_end();
        Self {
            publisher,
            subscriber,
            observation_history: ObservationHistory::new(PublishSchedule::EACH_TICK),
            tick: 0,
        }
    }

    /// Publishes one tick: its packet, and the repair symbols after it.
    fn publish_tick(&mut self, redundancy: Redundancy) -> (Bytes, Vec<Bytes>) {
        self.tick += 1;
        let observations = awake(BODIES, |body| motion(body, self.tick));
        self.observation_history
            .observe(Tick::new(self.tick), &observations);
        let (mut packets, mut repair_symbols) = (Vec::new(), Vec::new());
        self.publisher
            .publish(&self.observation_history, 0, &mut packets);
        self.publisher
            .encode_repair_symbols(redundancy, &mut repair_symbols);
        assert_eq!(packets.len(), 1, "hopping bodies are updated in each tick");
        (packets.remove(0), repair_symbols)
    }

    /// Publishes a tick and delivers everything.
    fn pass(&mut self, redundancy: Redundancy) {
        let (packet, repair_symbols) = self.publish_tick(redundancy);
        for datagram in [packet].iter().chain(&repair_symbols) {
            self.subscriber.handle_datagram(datagram);
        }
    }

    /// Reports the losses to the publisher and delivers its answer. Returns the kinds of the datagrams in it.
    fn report_losses(&mut self) -> Vec<PacketKind> {
        let loss_report = self.subscriber.loss_report();
        let mut answers = Vec::new();
        for number in self.publisher.answer(&loss_report, &mut answers) {
            let refresh = self.publisher.refresh(number, 0);
            answers.extend(refresh.expect("the packet is kept"));
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
        self.subscriber.is_converged()
            && self
                .publisher
                .tracks()
                .all(|(id, track)| self.subscriber.track(id) == Some(track))
    }
}

#[test]
fn a_lost_packet_is_recovered_from_the_next_repair_symbol_and_its_dependents_are_read() {
    let mut link = FecLink::new(Features::ALL);
    for _ in 0..10 {
        link.pass(Redundancy::Plain);
    }
    let (_, repair_symbols) = link.publish_tick(Redundancy::Plain);
    assert!(
        repair_symbols.is_empty(),
        "repair symbols follow every second tick"
    );
    let (packet, repair_symbols) = link.publish_tick(Redundancy::Plain);
    link.subscriber.handle_datagram(&packet);
    assert!(!link.agrees());
    link.subscriber.handle_datagram(&repair_symbols[0]);
    assert!(link.agrees());
    let statistics = link.subscriber.statistics();
    assert_eq!((statistics.rebuilt, statistics.refreshes), (1, 0));
    assert_eq!(
        (link.subscriber.lost(), link.subscriber.complete()),
        (1, Tick::new(link.tick))
    );
}

#[test]
fn losses_beyond_fec_are_refreshed() {
    let mut link = FecLink::new(Features::ALL);
    for _ in 0..10 {
        link.pass(Redundancy::Off);
    }
    for _ in 0..=REPAIR_SYMBOLS_KEPT {
        link.publish_tick(Redundancy::Off);
    }
    link.pass(Redundancy::Off);
    assert_eq!(link.subscriber.missing(), REPAIR_SYMBOLS_KEPT + 1);
    assert_eq!(
        link.report_losses(),
        [PacketKind::Refresh; REPAIR_SYMBOLS_KEPT + 1]
    );
    assert!(link.agrees());
}

#[test]
fn two_lost_packets_and_a_lost_repair_symbol_are_recovered_from_later_repair_symbols() {
    let mut link = FecLink::new(Features::ALL);
    for _ in 0..10 {
        link.pass(Redundancy::Plain);
    }
    link.publish_tick(Redundancy::Plain);
    link.publish_tick(Redundancy::Plain);
    for _ in 0..2 {
        assert!(!link.agrees() || link.subscriber.missing() == 0);
        link.pass(Redundancy::Plain);
        link.pass(Redundancy::Plain);
    }
    assert!(link.agrees());
    assert_eq!(link.subscriber.statistics().rebuilt, 2);
}

#[test]
fn sporadic_loss_is_recovered_by_requested_repair_symbols() {
    let mut link = FecLink::new(Features::ALL);
    for _ in 0..5 {
        link.pass(Redundancy::Off);
    }
    link.publish_tick(Redundancy::Off);
    link.publish_tick(Redundancy::Off);
    link.pass(Redundancy::Off);
    assert_eq!(link.subscriber.loss_report().repair_symbols, 2);
    // One more than needed, because one may be lost.
    assert_eq!(link.report_losses(), [PacketKind::RepairSymbol; 3]);
    assert!(link.agrees());
}

#[test]
fn old_losses_are_refreshed() {
    let mut link = FecLink::new(Features::ALL);
    link.pass(Redundancy::Off);
    link.publish_tick(Redundancy::Off);
    for _ in 0..40 {
        link.pass(Redundancy::Off);
    }
    assert!(link.report_losses().contains(&PacketKind::Refresh));
    // The lost packet assigned the alias of body 8. Each packet with an update of that body names an unknown alias, so
    // it is missing at once (PROTOCOL 6.6-10) and was reported. Packets 22 and 38 have none: they were unread, and
    // covered by the refresh to come. That refresh assigns the aliases at its own tick, so no older packet can be read
    // again (S61). Each of these readings counts as a late arrival (S101, S97), which makes both packets missing only now.
    let missing: Vec<_> = link.subscriber.missing_packets().collect();
    assert_eq!(missing, [22, 38]);
    link.report_losses();
    assert!(link.agrees());
}

#[test]
fn without_redundancy_losses_are_refreshed() {
    let mut features = Features::ALL;
    features.redundancy = false;
    let mut link = FecLink::new(features);
    link.pass(Redundancy::Plain);
    link.publish_tick(Redundancy::Plain);
    link.pass(Redundancy::Plain);
    assert_eq!(link.report_losses(), [PacketKind::Refresh]);
    assert!(link.agrees());
}

#[test]
fn wrong_repair_symbol_is_rejected_and_refresh_requested() {
    let mut link = FecLink::new(Features::ALL);
    for _ in 0..5 {
        link.pass(Redundancy::Off);
    }
    link.publish_tick(Redundancy::Off);
    link.pass(Redundancy::Off);
    let before: Vec<_> = (0..BODIES)
        .map(|body| link.subscriber.track(BodyId::new(body, 0)))
        .collect();
    let lie = RepairSymbol {
        last: Low16(5),
        covered: 0,
        row: 9,
        sums: vec![3, 1, 4, 1, 5],
    };
    link.subscriber.handle_datagram(&lie.encode(STREAM));
    let after: Vec<_> = (0..BODIES)
        .map(|body| link.subscriber.track(BodyId::new(body, 0)))
        .collect();
    assert_eq!(before, after);
    assert_eq!(link.subscriber.statistics().malformed, 1);
    assert_eq!(link.subscriber.loss_report().repair_symbols, 0);
    assert!(link.report_losses().contains(&PacketKind::Refresh));
    assert!(link.agrees());
}

#[test]
fn a_lost_rest_update_is_found_by_its_gap_and_refreshed() {
    let mut link = FecLink::new(Features::ALL);
    for _ in 0..5 {
        link.pass(Redundancy::Off);
    }
    link.tick += 1;
    let observations: Vec<_> = (0..BODIES)
        .map(|body| Observation {
            id: BodyId::new(body, 0),
            motion: motion(body, link.tick).stilled(),
            activity: Activity::Asleep,
        })
        .collect();
    link.observation_history
        .observe(Tick::new(link.tick), &observations);
    let mut lost = Vec::new();
    link.publisher
        .publish(&link.observation_history, 0, &mut lost);
    assert!(!lost.is_empty());
    // These bodies need no further update. The watermark of their silence is enough to find the gap.
    link.tick += 1;
    link.observation_history.observe(Tick::new(link.tick), &[]);
    let mut more = Vec::new();
    link.publisher
        .publish(&link.observation_history, 0, &mut more);
    assert!(more.is_empty());
    link.subscriber
        .handle_datagram(&link.publisher.watermark(0));
    assert!(!link.agrees() && link.subscriber.missing() == lost.len());
    link.report_losses();
    assert!(link.agrees());
    assert!(link.publisher.tracks().all(|(_, track)| track.is_resting()));
}
