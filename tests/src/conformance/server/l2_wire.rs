//! L2.2: what comes on a stream for what is said about it, bit by bit.
//!
//! No session stands between: a member of bytes says an loss_report or a mismatch, and reads what comes.

use glam::Vec3;
use rhumb_protocol::limits::DATAGRAM_BYTES_MAX;
use rhumb_protocol::message::{ClientMessage, Joined, ResyncCause, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{
    Checksums, Head, LossReport, Low16, PacketKind, Refresh, RepairSymbol, UpdatePacket, Watermark,
};
use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Tick;

use super::scenery::{EXACT, NORMAL, ball, ball_shape, body, lockstep};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure, should};
use crate::conformance::peer::RawClient;
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let case = |id: &str, name: &str, cites: &str| {
        Case::server(id, name)
            .cites(cites)
            .needs(&[Feature::Lockstep])
    };
    vec![
        case("L2.2.1", "an loss_report is answered by a watermark", "PROTOCOL 6.4-3, 5.13-1, 5.10-1, 5.10-2")
            .play(|trial| {
                let mut member_link = RawMember::begin(trial, NORMAL, 1)?;
                let next = member_link.joined.start.next;
                member_link.loss_report(next, 0, &[])?;
                let watermark = member_link.watermark()?;
                ensure(watermark.next == Low16::of(next), "of the same number")?;
                ensure(watermark.tick == Low16::of(0), "and the newest tick")
            }),
        case("L2.2.2", "each tick that was asked for is watermark_tick for, by a packet that ends it or by a watermark", "PROTOCOL 6.4-1, 6.3-12, 6.3-4, 5.9-1")
            .play(each_tick),
        case("L2.2.3", "numbers rise by one from the snapshot's on", "PROTOCOL 5.9-1, 6.11-2, 6.3-12, 5.7-1")
            .play(numbers),
        case("L2.2.4", "no datagram is longer than 1150 bytes", "PROTOCOL 5.8-3").play(short),
        case("L2.2.5", "a packet said to be lost is refreshed by what its bodies do now", "PROTOCOL 6.7-3, 6.7-4, 5.11-1, 5.11-2")
            .play(refreshed),
        case("L2.2.6", "a refresh leaves out bodies that are gone", "PROTOCOL 6.7-4, 5.11-4").play(refreshed_gone),
        case("L2.2.7", "nothing comes for a packet that was never sent", "PROTOCOL 6.7-7, 5.7-1")
            .play(never_sent),
        case("L2.2.8", "who wants repair_symbols for lost packets gets some", "PROTOCOL 6.15-8, 5.16-3, 5.16-4")
            .play(repair_symbols),
        case("L2.2.11", "a body that sleeps is silent, and its ticks are watermark_tick for", "PROTOCOL 6.3-9, 6.4-1, 6.13-3")
            .play(asleep),
        case("L2.2.12", "a resync is answered by a whole snapshot, and commands go on in number", "PROTOCOL 4.8-5, 4.8-6, 4.8-3")
            .play(resync),
        case("L2.2.13", "who follows another choice is reported its stream, and hears the one before until it says so", "PROTOCOL 4.8-8, 4.8-10, 4.8-11, 4.8-12")
            .play(follows),
        case("L2.2.14", "of several tasks that come together only the last is answered", "PROTOCOL 4.8-9, 4.8-13")
            .play(only_the_last),
        case("L2.2.15", "a datagram tells how many scene_events were given before it", "PROTOCOL 4.6-5, 4.6-6, 6.3-3")
            .play(notices_counted),
        case("L2.2.16", "a snapshot tells shapes, bodies in order and joints, and nothing else", "PROTOCOL 4.8-1, 4.8-2, 4.8-4, 6.13-5")
            .play(snapshot),
        case("L2.2.17", "the sum over all tracks is said while bodies move", "PROTOCOL 6.12-3, 6.12-4")
            .play(checksum_packets),
    ]
}

/// A member of bytes, and what it knows of its stream.
struct RawMember {
    guest: RawClient,
    joined: Joined,
    /// SceneEvents given outside of snapshots.
    scene_events: u64,
    balls: u32,
}

impl RawMember {
    /// A scene of so many balls that fall side by side.
    fn begin(trial: &mut Trial<'_>, choice: StreamChoice, balls: u32) -> Result<Self, Stop> {
        let mut guest = trial.guest()?;
        let joined = guest.enter(lockstep(), choice)?;
        guest.must(ball_shape())?;
        for place in 0..balls {
            let at = Vec3::new((3 * place) as f32, 100.0, 0.0);
            let id = body(guest.granted, place)?;
            guest.must(ball(id, at, Vec3::new(0.0, place as f32 / 7.0, 1.0)))?;
        }
        let scene_events = joined.start.scene_events + u64::from(balls) + 1;
        Ok(Self {
            guest,
            joined,
            scene_events,
            balls,
        })
    }

    fn loss_report(&mut self, next: u64, repair_symbols: u8, lost: &[u64]) -> CaseResult {
        let loss_report = LossReport {
            next: Low16::of(next),
            gone: Low16::of(lost.len() as u64),
            repair_symbols,
            lost: lost.iter().map(|number| Low16::of(*number)).collect(),
        };
        self.guest
            .throw(&loss_report.encode(self.joined.start.stream))
    }

    /// The next datagram: its kind, and all of it.
    fn next(&mut self) -> Result<(PacketKind, Vec<u8>), Stop> {
        let datagram = self.guest.next_datagram()?;
        let datagram = datagram.ok_or_else(|| Stop::Fail("no datagram comes".into()))?;
        let head = Head::decode(&mut Reader::new(&datagram));
        let head = head.map_err(|why| Stop::Fail(format!("a datagram is malformed: {why:?}")))?;
        ensure(
            head.stream == self.joined.start.stream,
            "it is of the member's stream",
        )?;
        Ok((head.kind, datagram.to_vec()))
    }

    fn watermark(&mut self) -> Result<Watermark, Stop> {
        loop {
            let (kind, bytes) = self.next()?;
            if kind == PacketKind::Watermark {
                return read(&bytes, Watermark::decode);
            }
        }
    }

    /// Pushes each ball its own way, so that each needs words of its own.
    fn stir(&mut self) -> CaseResult {
        for place in 0..self.balls {
            let way = Vec3::new(place as f32 / 7.0 - 1.0, 1.0, 1.0);
            let impulse = way
                * if self.guest.commands.is_multiple_of(2) {
                    300.0
                } else {
                    -200.0
                };
            let id = body(self.guest.granted, place)?;
            self.guest
                .say(&ClientMessage::Command(Command::Impulse { id, impulse }));
        }
        Ok(())
    }

    /// Steps to a tick and returns all datagrams up to its end, each with its kind.
    fn step(&mut self, to: u64) -> Result<Vec<(PacketKind, Vec<u8>)>, Stop> {
        self.guest
            .say(&ClientMessage::Advance { to: Tick::new(to) });
        let mut all = Vec::new();
        loop {
            let (kind, bytes) = self.next()?;
            let ended = tick_that_ends(kind, &bytes)?;
            all.push((kind, bytes));
            if ended == Some(Low16::of(to)) {
                return Ok(all);
            }
        }
    }

    /// Numbers of state packets up to a tick.
    fn numbers_to(&mut self, tick: u64) -> Result<Vec<u64>, Stop> {
        let packets = self.packets_to(tick)?;
        Ok(packets.into_iter().map(|(number, _)| number).collect())
    }

    /// State packets up to a tick, by number.
    fn packets_to(&mut self, tick: u64) -> Result<Vec<(u64, Vec<u8>)>, Stop> {
        let mut expected = self.joined.start.next;
        let mut packets = Vec::new();
        for to in 1..=tick {
            self.stir()?;
            for (kind, bytes) in self.step(to)? {
                if let Some(packet) = state(kind, &bytes)? {
                    expected = packet.number.expand(expected);
                    packets.push((expected, bytes));
                }
            }
        }
        Ok(packets)
    }
}

/// Reads what follows a head.
fn read<'a, T>(
    bytes: &'a [u8],
    decode: impl FnOnce(Reader<'a>) -> Result<T, rhumb_protocol::wire::Malformed>,
) -> Result<T, Stop> {
    let mut reader = Reader::new(bytes);
    let read = Head::decode(&mut reader).and_then(|_| decode(reader));
    read.map_err(|why| Stop::Fail(format!("a datagram is malformed: {why:?}")))
}

/// A state packet, if it is one; its updates are read too.
fn state(kind: PacketKind, bytes: &[u8]) -> Result<Option<UpdatePacket<'_>>, Stop> {
    if !matches!(kind, PacketKind::Updates | PacketKind::UpdatesEnd) {
        return Ok(None);
    }
    let packet = read(bytes, |reader| {
        UpdatePacket::decode(kind == PacketKind::UpdatesEnd, reader)
    })?;
    let again = read(bytes, |reader| {
        UpdatePacket::decode(kind == PacketKind::UpdatesEnd, reader)
    })?;
    let mut updates = Vec::new();
    again
        .updates(&mut updates)
        .map_err(|why| Stop::Fail(format!("updates are malformed: {why:?}")))?;
    let rise = updates.windows(2).all(|pair| pair[0].alias < pair[1].alias);
    ensure(rise, "updates come in rising order of alias")?;
    Ok(Some(packet))
}

/// The tick of which nothing more comes.
fn tick_that_ends(kind: PacketKind, bytes: &[u8]) -> Result<Option<Low16>, Stop> {
    Ok(match kind {
        PacketKind::UpdatesEnd => state(kind, bytes)?.map(|packet| packet.tick),
        PacketKind::Watermark => Some(read(bytes, Watermark::decode)?.tick),
        PacketKind::Checksums => Some(read(bytes, Checksums::decode)?.tick),
        _ => None,
    })
}

fn each_tick(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 8)?;
    member_link
        .guest
        .say(&ClientMessage::Advance { to: Tick::new(40) });
    let mut expected = 1;
    while expected <= 40 {
        let (kind, bytes) = member_link.next()?;
        if let Some(tick) = tick_that_ends(kind, &bytes)? {
            // An loss_report's watermark and a checksums may say a tick again.
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
    let mut member_link = RawMember::begin(trial, EXACT, 30)?;
    let numbers = member_link.numbers_to(30)?;
    let first = member_link.joined.start.next;
    let wanted: Vec<u64> = (first..first + numbers.len() as u64).collect();
    ensure(!numbers.is_empty(), "bodies that move are spoken of")?;
    ensure(
        numbers == wanted,
        format!("from {first} on, not {numbers:?}"),
    )
}

fn short(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, StreamChoice::Full, 60)?;
    member_link
        .guest
        .say(&ClientMessage::Advance { to: Tick::new(5) });
    let mut count = 0;
    while count < 15 {
        let (_, bytes) = member_link.next()?;
        ensure(
            bytes.len() <= DATAGRAM_BYTES_MAX,
            format!("{} bytes", bytes.len()),
        )?;
        count += 1;
    }
    Ok(())
}

fn refreshed(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 8)?;
    let numbers = member_link.numbers_to(20)?;
    let [lost, .., last] = numbers[..] else {
        return Stop::fail("bodies that are pushed are spoken of");
    };
    member_link.loss_report(last + 1, 0, &[lost])?;
    loop {
        let (kind, bytes) = member_link.next()?;
        if kind != PacketKind::Refresh {
            continue;
        }
        let refresh = read(&bytes, Refresh::decode)?;
        ensure(refresh.lost == Low16::of(lost), "it names the packet")?;
        ensure(refresh.tick == Low16::of(20), "it is of now, not of then")?;
        return ensure(!refresh.records.is_empty(), "it tells tracks");
    }
}

fn refreshed_gone(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 1)?;
    let numbers = member_link.numbers_to(20)?;
    let [lost, .., last] = numbers[..] else {
        return Stop::fail("a body that is pushed is spoken of");
    };
    let id = body(member_link.guest.granted, 0)?;
    member_link.guest.must(Command::RemoveBody { id })?;
    member_link.loss_report(last + 1, 0, &[lost])?;
    loop {
        let (kind, bytes) = member_link.next()?;
        if kind == PacketKind::Refresh {
            let refresh = read(&bytes, Refresh::decode)?;
            return ensure(refresh.records.is_empty(), "nothing is left to tell");
        }
    }
}

fn never_sent(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 2)?;
    let next = member_link
        .numbers_to(10)?
        .last()
        .map_or(0, |last| last + 1);
    member_link.loss_report(next, 0, &[next + 500])?;
    let (kind, _) = member_link.next()?;
    ensure(
        kind == PacketKind::Watermark,
        format!("a watermark, and no {kind:?}"),
    )?;
    // What it is asked next it answers as ever.
    member_link.step(11).map(drop)
}

fn repair_symbols(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 8)?;
    let packets = member_link.packets_to(20)?;
    let [.., (first, _), (second, _), (third, _)] = packets[..] else {
        return Stop::fail("bodies that are pushed are spoken of");
    };
    let lost = [first, second];
    member_link.loss_report(third + 1, 2, &lost)?;
    let mut covered = 0;
    loop {
        let (kind, bytes) = member_link.next()?;
        match kind {
            PacketKind::RepairSymbol => {
                let repair_symbol = read(&bytes, RepairSymbol::decode)?;
                ensure(
                    sums_of(&repair_symbol, &packets, third) == Some(repair_symbol.sums),
                    "its sums are those of what was said",
                )?;
                covered += 1;
                if covered == lost.len() {
                    return Ok(());
                }
            }
            // It answers by refreshes instead, as it MAY not: SHOULD.
            PacketKind::Refresh => {
                return should(false, "lost packets come back by repair_symbols");
            }
            _ => {}
        }
    }
}

/// The sums that a repair_symbol must have; none where it covers what was not said.
fn sums_of(
    repair_symbol: &RepairSymbol,
    packets: &[(u64, Vec<u8>)],
    newest: u64,
) -> Option<Vec<u8>> {
    let said = |number| packets.iter().find(|(other, _)| *other == number);
    let covered: Option<Vec<_>> = repair_symbol
        .numbers(repair_symbol.last.expand(newest))
        .map(|number| said(number).map(|(number, bytes)| (*number, &bytes[..])))
        .collect();
    let mut covered = covered?;
    covered.reverse();
    RepairSymbol::of(repair_symbol.row, &covered).map(|repair_symbol| repair_symbol.sums)
}

fn asleep(trial: &mut Trial<'_>) -> CaseResult {
    let mut guest = trial.guest()?;
    let config = super::scenery::weightless(lockstep());
    let joined = guest.enter(config, EXACT)?;
    guest.must(ball_shape())?;
    let id = body(guest.granted, 0)?;
    guest.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    let mut member_link = RawMember {
        guest,
        joined,
        scene_events: 2,
        balls: 1,
    };
    for to in 1..=600 {
        member_link.step(to)?;
    }
    // Ten seconds later nothing is left to say but that nothing is.
    for to in 601..=660 {
        for (kind, _) in member_link.step(to)? {
            ensure(
                matches!(kind, PacketKind::Watermark | PacketKind::Checksums),
                format!("at {to} it says {kind:?}"),
            )?;
        }
    }
    Ok(())
}

fn resync(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, NORMAL, 3)?;
    member_link.step(10)?;
    let commands = member_link.guest.commands;
    member_link
        .guest
        .say(&ClientMessage::Resync(ResyncCause::LostSync));
    let (joined, scene_events) = member_link.guest.snapshot()?;
    ensure(joined.start.tick == Tick::new(10), "of the newest tick")?;
    ensure(
        joined.granted == member_link.joined.granted,
        "granted is what was granted first",
    )?;
    ensure(
        joined.start.scene_events == member_link.scene_events,
        format!("after {} scene_events", member_link.scene_events),
    )?;
    ensure(
        scene_events.len() == 4,
        format!("a shape and three bodies, not {scene_events:?}"),
    )?;
    let id = body(member_link.guest.granted, 0)?;
    member_link.guest.must(Command::RemoveBody { id })?;
    ensure(member_link.guest.commands == commands + 1, "numbers go on")
}

fn follows(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, NORMAL, 3)?;
    let before = member_link.joined.start.stream;
    member_link
        .guest
        .say(&ClientMessage::Subscribe(StreamChoice::Full));
    let (joined, _) = member_link.guest.snapshot()?;
    let after = joined.start.stream;
    ensure(
        joined.choice == StreamChoice::Full && after != before,
        "another stream",
    )?;
    let received = |guest: &mut RawClient| -> Result<Vec<rhumb_protocol::packet::StreamId>, Stop> {
        guest.barrier()?;
        let mut streams = Vec::new();
        while let Some(bytes) = guest.next_datagram()? {
            let head = Head::decode(&mut Reader::new(&bytes));
            streams.extend(head.ok().map(|head| head.stream));
            if streams.contains(&after) && (streams.contains(&before) || streams.len() > 3) {
                break;
            }
        }
        Ok(streams)
    };
    member_link
        .guest
        .say(&ClientMessage::Advance { to: Tick::new(2) });
    let both = received(&mut member_link.guest)?;
    ensure(
        both.contains(&before) && both.contains(&after),
        format!("it hears both, not {both:?}"),
    )?;
    member_link.guest.say(&ClientMessage::Subscribed(after));
    member_link.guest.barrier()?;
    member_link.guest.datagrams.clear();
    member_link
        .guest
        .say(&ClientMessage::Advance { to: Tick::new(8) });
    let one = received(&mut member_link.guest)?;
    ensure(
        one.iter().all(|stream| *stream == after),
        format!("then the new one alone, not {one:?}"),
    )
}

fn only_the_last(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, NORMAL, 1)?;
    let full = ClientMessage::Subscribe(StreamChoice::Full);
    member_link.guest.say_together(&[
        ClientMessage::Resync(ResyncCause::LostSync),
        ClientMessage::Resync(ResyncCause::LostSync),
        full,
    ]);
    let received = member_link.guest.barrier()?;
    let joined: Vec<_> = received
        .iter()
        .filter_map(|message| match message {
            ServerMessage::Joined(joined) => Some(joined.choice),
            _ => None,
        })
        .collect();
    ensure(
        joined == [StreamChoice::Full],
        format!("one answer, to the last, not {joined:?}"),
    )
}

fn notices_counted(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 3)?;
    for (kind, bytes) in member_link.step(1)? {
        let scene_events = match kind {
            PacketKind::Watermark => read(&bytes, Watermark::decode)?.scene_events,
            PacketKind::Checksums => read(&bytes, Checksums::decode)?.scene_events,
            _ => match state(kind, &bytes)? {
                Some(packet) => packet.scene_events,
                None => continue,
            },
        };
        let wanted = Low16::of(member_link.scene_events);
        ensure(
            scene_events == wanted,
            format!("{wanted:?} were given, not {scene_events:?}"),
        )?;
    }
    Ok(())
}

fn snapshot(trial: &mut Trial<'_>) -> CaseResult {
    use rhumb_protocol::message::SceneEvent;

    let mut member_link = RawMember::begin(trial, NORMAL, 5)?;
    member_link.step(7)?;
    let mut late = trial.guest_of(&member_link.guest.scene.clone())?;
    late.hello()?;
    let (joined, scene_events) = late.join(NORMAL)?;
    ensure(
        joined.start.stream == member_link.joined.start.stream,
        "the stream that runs",
    )?;
    ensure(joined.start.tick == Tick::new(7), "as of the newest tick")?;
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
        "shapes, gravities, bodies by index, joints",
    )?;
    ensure(!ranks.contains(&u32::MAX), "and nothing else")?;
    let bodies = scene_events
        .iter()
        .filter(|scene_event| matches!(scene_event, SceneEvent::BodyPlaced { .. }));
    ensure(bodies.count() == 5, "all five bodies")
}

fn checksum_packets(trial: &mut Trial<'_>) -> CaseResult {
    let mut member_link = RawMember::begin(trial, EXACT, 6)?;
    let mut sums = Vec::new();
    for to in 1..=150 {
        member_link.stir()?;
        for (kind, bytes) in member_link.step(to)? {
            if kind == PacketKind::Checksums {
                let checksums = read(&bytes, Checksums::decode)?;
                sums.push(checksums.sum);
            }
        }
    }
    ensure(!sums.is_empty(), "in two seconds it is said once at least")
}
