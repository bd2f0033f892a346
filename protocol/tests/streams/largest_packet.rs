//! No datagram of a stream exceeds the largest packet that the stream states.
//!
//! Many bodies jump at every tick, so that packets are full. A subscriber loses every packet and asks for refreshes and
//! repair symbols.

use bytes::Bytes;
use rhumb_protocol::limits::LOST_NUMBERS_MAX;
use rhumb_protocol::packet::{Datagram, LargestPacket, LossReport, Low16, PacketKind, StreamId};
use rhumb_protocol::scene::PublishSchedule;
use rhumb_protocol::stream::{
    ObservationHistory, PredictionParameters, Recipient, RestingBodies, StreamConfig, StreamSender,
    WatermarkPolicy,
};
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{BodyId, BodyState, Metres, Tick, Track};

use crate::terms::{TERMS, awake};

const STREAM: StreamId = StreamId(70_000);
const BODIES: u32 = 300;
const TICKS: u64 = 40;

/// A different state for each tick.
fn motion(body: u32, tick: u64) -> BodyState {
    let hop = ((tick * 7 + u64::from(body) * 13) % 31) as f32 / 5.0;
    let speed = [hop, -hop, 0.5];
    BodyState::new(
        [body as f32 * 3.0, hop, tick as f32],
        [0.0, 0.0, 0.0, 1.0],
        speed,
        speed,
    )
    .expect("a finite state")
}

/// The sizes of all datagrams that a sender makes, by kind.
fn sizes(mut sender: StreamSender) -> Vec<(PacketKind, usize)> {
    let parameters = PredictionParameters::plain(Metres::new(0.5));
    for body in 0..BODIES {
        let state = motion(body, 0);
        let track = Track::resting(Tick::ZERO, state);
        assert!(sender.place(BodyId::new(body, 0), &parameters, track, state));
    }
    let mut observation_history = ObservationHistory::new(PublishSchedule::EACH_TICK);
    let mut datagrams: Vec<Bytes> = Vec::new();
    for tick in 1..=TICKS {
        let observations = awake(BODIES, |body| motion(body, tick));
        observation_history.observe(Tick::new(tick), &observations);
        let before = sender.next_number();
        assert!(sender.publish(&observation_history, 0));
        datagrams.extend(sender.datagrams(1).cloned());
        let next = sender.next_number();
        let lost: Vec<_> = (before..next)
            .take(LOST_NUMBERS_MAX)
            .map(Low16::of)
            .collect();
        let report = LossReport {
            next: Low16::of(next),
            abandoned: Low16::of(next),
            repair_symbols: (tick % 3) as u8,
            lost,
        };
        let from = Recipient {
            id: 1,
            round_trip: Span::ZERO,
        };
        let now = Instant::from_nanos(tick * 16_000_000);
        let report = report.encode(STREAM);
        let report = Datagram::open(&report).expect("a loss report");
        sender.handle_datagram(now, from, &report, 0, &mut datagrams);
    }
    let sized = |datagram: &Bytes| {
        let head = Datagram::open(datagram).expect("a datagram").head();
        (head.kind, datagram.len())
    };
    datagrams.iter().map(sized).collect()
}

fn reckoned(largest_packet: LargestPacket) -> StreamSender {
    let config = StreamConfig {
        largest_packet,
        ..TERMS
    };
    StreamSender::reckoned(STREAM, &config, None, WatermarkPolicy::LOCKSTEP, Tick::ZERO)
}

#[test]
fn no_datagram_is_larger_than_the_stream_states() {
    for largest_packet in [
        LargestPacket::LEAST,
        LargestPacket::DEFAULT,
        LargestPacket::GREATEST,
    ] {
        let full = StreamSender::full(
            STREAM,
            largest_packet,
            (WatermarkPolicy::LOCKSTEP, RestingBodies::Sent),
            Tick::ZERO,
        );
        let sizes = [sizes(reckoned(largest_packet)), sizes(full)].concat();
        for kind in [
            PacketKind::Updates,
            PacketKind::UpdatesEnd,
            PacketKind::Full,
            PacketKind::FullEnd,
            PacketKind::Refresh,
            PacketKind::RepairSymbol,
        ] {
            let of_kind = sizes.iter().filter(|(other, _)| *other == kind);
            let largest = of_kind.map(|(_, size)| *size).max();
            assert!(
                largest.is_some_and(|size| size <= largest_packet.bytes()),
                "{kind:?}: {largest:?} of {largest_packet}"
            );
        }
        let largest = sizes.iter().map(|(_, size)| *size).max();
        assert!(
            largest.is_some_and(|size| size + 60 > largest_packet.bytes()),
            "packets are filled: {largest:?} of {largest_packet}"
        );
    }
}
