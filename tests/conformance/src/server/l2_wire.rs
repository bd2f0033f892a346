//! L2.2: the datagrams that answer a member's messages, bit by bit.
//!
//! No session is in between: a raw member sends loss reports and decodes the answers.

use glam::Vec3;
use rhumb_protocol::limits::DATAGRAM_BYTES_MAX;
use rhumb_protocol::message::{ClientMessage, ResyncCause, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{
    Checksums, Head, Low16, PacketKind, Refresh, RepairSymbol, Watermark,
};
use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Tick;

use super::raw_member::RawMember;
use super::scenery::{EXACT, NORMAL, ball, ball_shape, body, lockstep};
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::feature::Feature;
use crate::outcome::{CaseResult, Stop, ensure, should};
use crate::peer::{RawClient, datagram};
use crate::trial::Trial;

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a loss report is answered by a watermark",
        "PROTOCOL 6.4-3, 5.13-1, 5.10-1, 5.10-2",
        loss_report_answered,
    ),
    (
        2,
        "each requested tick is completed, by its last packet or by a watermark",
        "PROTOCOL 6.4-1, 6.3-12, 6.3-4, 5.9-1",
        each_tick,
    ),
    (
        3,
        "packet numbers rise by one, starting with the number in the snapshot",
        "PROTOCOL 5.9-1, 6.11-2, 6.3-12, 5.7-1",
        numbers,
    ),
    (
        4,
        "no datagram is longer than 1150 bytes",
        "PROTOCOL 5.8-5",
        short,
    ),
    (
        5,
        "a lost packet is refreshed with the present tracks of its bodies",
        "PROTOCOL 6.7-3, 6.7-4, 5.11-1, 5.11-2",
        refreshed,
    ),
    (
        6,
        "a refresh leaves out removed bodies",
        "PROTOCOL 6.7-4, 5.11-4",
        refresh_without_removed,
    ),
    (
        7,
        "a loss report for a packet that was never sent is ignored",
        "PROTOCOL 6.7-6, 5.7-1",
        never_sent,
    ),
    (
        8,
        "a member that requests repair symbols for lost packets receives some",
        "PROTOCOL 6.15-8, 5.16-3, 5.16-4",
        repair_symbols,
    ),
    (
        11,
        "a sleeping body needs no updates, and its ticks are completed by watermarks",
        "PROTOCOL 6.3-9, 6.4-1, 6.13-3",
        asleep,
    ),
    (
        12,
        "a resync is answered by a full snapshot, and command numbers continue",
        "PROTOCOL 4.8-5, 4.8-6, 4.8-3",
        resync,
    ),
    (
        13,
        "a member that changes its choice receives both streams until it confirms the new one",
        "PROTOCOL 4.8-8, 4.8-10, 4.8-11, 4.8-12",
        follows,
    ),
    (
        14,
        "of several simultaneous subscribe messages only the last is answered",
        "PROTOCOL 4.8-9, 4.8-13",
        only_the_last,
    ),
    (
        15,
        "a datagram counts the scene events that were sent before it",
        "PROTOCOL 4.6-5, 4.6-6, 6.3-3",
        scene_events_counted,
    ),
    (
        16,
        "a snapshot contains shapes, bodies in order and joints, and nothing else",
        "PROTOCOL 4.8-1, 4.8-2, 4.8-4, 6.13-5",
        snapshot,
    ),
    (
        17,
        "the checksum over all tracks is sent while bodies move",
        "PROTOCOL 6.12-3, 6.12-4",
        checksum_packets,
    ),
];

pub(super) fn cases() -> Vec<Case> {
    table("L2.2", &[Feature::Lockstep], CASES).collect()
}

fn loss_report_answered(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, NORMAL, 1)?;
    let next = member.joined.start.next;
    member.loss_report(next, 0, &[])?;
    let watermark = member.watermark()?;
    ensure(watermark.next == Low16::of(next), "it has the same number")?;
    ensure(watermark.tick == Low16::of(0), "it has the newest tick")
}

fn each_tick(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 8)?;
    member
        .client
        .send(&ClientMessage::Advance { to: Tick::new(40) });
    let mut expected = 1;
    while expected <= 40 {
        let (kind, bytes) = member.next()?;
        if let Some(tick) = datagram::completed_tick(kind, &bytes)? {
            // The watermark that answers a loss report, and a checksum packet, may repeat a tick.
            let again = tick == Low16::of(expected - 1);
            ensure(
                again || tick == Low16::of(expected),
                format!("tick {expected} is next, not {tick:?}"),
            )?;
            expected += u64::from(!again);
        }
    }
    Ok(())
}

fn numbers(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 30)?;
    let numbers = member.numbers_to(30)?;
    let first = member.joined.start.next;
    let wanted: Vec<u64> = (first..first + numbers.len() as u64).collect();
    ensure(!numbers.is_empty(), "moving bodies are published")?;
    ensure(
        numbers == wanted,
        format!("consecutive from {first} on, not {numbers:?}"),
    )
}

fn short(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, StreamChoice::Full, 60)?;
    member
        .client
        .send(&ClientMessage::Advance { to: Tick::new(5) });
    let mut count = 0;
    while count < 15 {
        let (_, bytes) = member.next()?;
        ensure(
            bytes.len() <= DATAGRAM_BYTES_MAX,
            format!("the datagram has {} bytes", bytes.len()),
        )?;
        count += 1;
    }
    Ok(())
}

fn refreshed(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 8)?;
    let numbers = member.numbers_to(20)?;
    let [lost, .., last] = numbers[..] else {
        return Stop::fail("pushed bodies are published");
    };
    member.loss_report(last + 1, 0, &[lost])?;
    loop {
        let (kind, bytes) = member.next()?;
        if kind != PacketKind::Refresh {
            continue;
        }
        let refresh = datagram::body(&bytes, Refresh::decode)?;
        ensure(refresh.lost == Low16::of(lost), "it names the lost packet")?;
        ensure(refresh.tick == Low16::of(20), "it has the newest tick")?;
        return ensure(!refresh.records.is_empty(), "it contains tracks");
    }
}

fn refresh_without_removed(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 1)?;
    let numbers = member.numbers_to(20)?;
    let [lost, .., last] = numbers[..] else {
        return Stop::fail("a pushed body is published");
    };
    let id = body(member.client.granted, 0)?;
    member.client.must(Command::RemoveBody { id })?;
    member.loss_report(last + 1, 0, &[lost])?;
    loop {
        let (kind, bytes) = member.next()?;
        if kind == PacketKind::Refresh {
            let refresh = datagram::body(&bytes, Refresh::decode)?;
            return ensure(refresh.records.is_empty(), "no track is left");
        }
    }
}

fn never_sent(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 2)?;
    let next = member.numbers_to(10)?.last().map_or(0, |last| last + 1);
    member.loss_report(next, 0, &[next + 500])?;
    let (kind, _) = member.next()?;
    ensure(
        kind == PacketKind::Watermark,
        format!("the answer is a watermark, not {kind:?}"),
    )?;
    // Later requests are still answered.
    member.step(11).map(drop)
}

fn repair_symbols(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 8)?;
    let packets = member.packets_to(20)?;
    let [.., (first, _), (second, _), (third, _)] = packets[..] else {
        return Stop::fail("pushed bodies are published");
    };
    let lost = [first, second];
    member.loss_report(third + 1, 2, &lost)?;
    let mut covered = 0;
    loop {
        let (kind, bytes) = member.next()?;
        match kind {
            PacketKind::RepairSymbol => {
                let repair_symbol = datagram::body(&bytes, RepairSymbol::decode)?;
                ensure(
                    sums_of(&repair_symbol, &packets, third) == Some(repair_symbol.sums),
                    "its symbols are computed from the sent packets",
                )?;
                covered += 1;
                if covered == lost.len() {
                    return Ok(());
                }
            }
            // A refresh instead of repair symbols violates a SHOULD only.
            PacketKind::Refresh => {
                return should(false, "lost packets are restored by repair symbols");
            }
            _ => {}
        }
    }
}

/// The symbols that a repair symbol packet must have; `None` where it covers packets that were not received.
fn sums_of(
    repair_symbol: &RepairSymbol,
    packets: &[(u64, Vec<u8>)],
    newest: u64,
) -> Option<Vec<u8>> {
    let packet_of = |number| packets.iter().find(|(other, _)| *other == number);
    let covered: Option<Vec<_>> = repair_symbol
        .numbers(repair_symbol.last.expand(newest))
        .map(|number| packet_of(number).map(|(number, bytes)| (*number, &bytes[..])))
        .collect();
    let mut covered = covered?;
    covered.reverse();
    RepairSymbol::of(repair_symbol.row, &covered).map(|repair_symbol| repair_symbol.sums)
}

fn asleep(trial: &mut Trial<'_>) -> CaseResult {
    let mut client = trial.client()?;
    let config = super::scenery::weightless(lockstep());
    let joined = client.enter(config, EXACT)?;
    client.must(ball_shape())?;
    let id = body(client.granted, 0)?;
    client.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    let mut member = RawMember {
        client,
        joined,
        scene_events: 2,
        balls: 1,
    };
    for to in 1..=600 {
        member.step(to)?;
    }
    // After ten seconds the body sleeps, so only watermarks and checksums are left.
    for to in 601..=660 {
        for (kind, _) in member.step(to)? {
            ensure(
                matches!(kind, PacketKind::Watermark | PacketKind::Checksums),
                format!("at {to} the server sends {kind:?}"),
            )?;
        }
    }
    Ok(())
}

fn resync(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, NORMAL, 3)?;
    member.step(10)?;
    let commands = member.client.commands;
    member
        .client
        .send(&ClientMessage::Resync(ResyncCause::LostSync));
    let (joined, scene_events) = member.client.snapshot()?;
    ensure(
        joined.start.tick == Tick::new(10),
        "the snapshot has the newest tick",
    )?;
    ensure(
        joined.granted == member.joined.granted,
        "the granted range is the original one",
    )?;
    ensure(
        joined.start.scene_events == member.scene_events,
        format!("the count of scene events is {}", member.scene_events),
    )?;
    ensure(
        scene_events.len() == 4,
        format!("a shape and three bodies, not {scene_events:?}"),
    )?;
    let id = body(member.client.granted, 0)?;
    member.client.must(Command::RemoveBody { id })?;
    ensure(
        member.client.commands == commands + 1,
        "command numbers continue",
    )
}

fn follows(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, NORMAL, 3)?;
    let before = member.joined.start.stream;
    member
        .client
        .send(&ClientMessage::Subscribe(StreamChoice::Full));
    let (joined, _) = member.client.snapshot()?;
    let after = joined.start.stream;
    ensure(
        joined.choice == StreamChoice::Full && after != before,
        "it is another stream",
    )?;
    let received = |client: &mut RawClient| -> Result<Vec<rhumb_protocol::packet::StreamId>, Stop> {
        client.barrier()?;
        let mut streams = Vec::new();
        while let Some(bytes) = client.next_datagram()? {
            let head = Head::decode(&mut Reader::new(&bytes));
            streams.extend(head.ok().map(|head| head.stream));
            if streams.contains(&after) && (streams.contains(&before) || streams.len() > 3) {
                break;
            }
        }
        Ok(streams)
    };
    member
        .client
        .send(&ClientMessage::Advance { to: Tick::new(2) });
    let both = received(&mut member.client)?;
    ensure(
        both.contains(&before) && both.contains(&after),
        format!("both streams are sent, not {both:?}"),
    )?;
    member.client.send(&ClientMessage::Subscribed(after));
    member.client.barrier()?;
    member.client.datagrams.clear();
    member
        .client
        .send(&ClientMessage::Advance { to: Tick::new(8) });
    let one = received(&mut member.client)?;
    ensure(
        one.iter().all(|stream| *stream == after),
        format!("then only the new stream is sent, not {one:?}"),
    )
}

fn only_the_last(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, NORMAL, 1)?;
    let full = ClientMessage::Subscribe(StreamChoice::Full);
    member.client.send_together(&[
        ClientMessage::Resync(ResyncCause::LostSync),
        ClientMessage::Resync(ResyncCause::LostSync),
        full,
    ]);
    let received = member.client.barrier()?;
    let joined: Vec<_> = received
        .iter()
        .filter_map(|message| match message {
            ServerMessage::Joined(joined) => Some(joined.choice),
            _ => None,
        })
        .collect();
    ensure(
        joined == [StreamChoice::Full],
        format!("one answer, to the last message, not {joined:?}"),
    )
}

fn scene_events_counted(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 3)?;
    for (kind, bytes) in member.step(1)? {
        let scene_events = match kind {
            PacketKind::Watermark => datagram::body(&bytes, Watermark::decode)?.scene_events,
            PacketKind::Checksums => datagram::body(&bytes, Checksums::decode)?.scene_events,
            _ => match datagram::state_packet(kind, &bytes)? {
                Some(packet) => packet.scene_events,
                None => continue,
            },
        };
        let wanted = Low16::of(member.scene_events);
        ensure(
            scene_events == wanted,
            format!("the counts are {wanted:?}, not {scene_events:?}"),
        )?;
    }
    Ok(())
}

fn snapshot(trial: &mut Trial<'_>) -> CaseResult {
    use rhumb_protocol::message::SceneEvent;

    let mut member = RawMember::begin(trial, NORMAL, 5)?;
    member.step(7)?;
    let mut late = trial.client_of(&member.client.scene.clone())?;
    late.hello()?;
    let (joined, scene_events) = late.join(NORMAL)?;
    ensure(
        joined.start.stream == member.joined.start.stream,
        "it is the existing stream",
    )?;
    ensure(
        joined.start.tick == Tick::new(7),
        "the snapshot has the newest tick",
    )?;
    let ranks: Vec<u32> = scene_events
        .iter()
        .map(|scene_event| match scene_event {
            SceneEvent::ShapeAdded { .. } => 0,
            SceneEvent::GravityChanged { .. } => 1,
            SceneEvent::BodyPlaced { desc, .. } => 2 + desc.id.index(),
            SceneEvent::JointAdded { .. } => u32::MAX - 1,
            _ => u32::MAX,
        })
        .collect();
    ensure(
        ranks.is_sorted(),
        "the order is shapes, gravities, bodies by index, joints",
    )?;
    ensure(
        !ranks.contains(&u32::MAX),
        "the snapshot contains nothing else",
    )?;
    let bodies = scene_events
        .iter()
        .filter(|scene_event| matches!(scene_event, SceneEvent::BodyPlaced { .. }));
    ensure(bodies.count() == 5, "it contains all five bodies")
}

fn checksum_packets(trial: &mut Trial<'_>) -> CaseResult {
    let mut member = RawMember::begin(trial, EXACT, 6)?;
    let mut sums = Vec::new();
    for to in 1..=150 {
        member.push_balls()?;
        for (kind, bytes) in member.step(to)? {
            if kind == PacketKind::Checksums {
                let checksums = datagram::body(&bytes, Checksums::decode)?;
                sums.push(checksums.sum);
            }
        }
    }
    ensure(
        !sums.is_empty(),
        "a checksum is sent at least once in two seconds",
    )
}
