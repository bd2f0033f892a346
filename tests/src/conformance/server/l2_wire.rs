//! L2.2: what comes on a stream for what is said about it, bit by bit.
//!
//! No session stands between: a member of bytes says an echo or a doubt, and reads what comes.

use glam::Vec3;
use rhumb_protocol::limits::{DATAGRAM_BYTES_MAX, INDICES_MAX};
use rhumb_protocol::message::{ClientMessage, Joined, ServerMessage, StreamChoice};
use rhumb_protocol::packet::{
    Digest, Doubt, Echo, Head, Kind, Low16, Parity, Ranges, Repair, StatePacket, Vouch,
};
use rhumb_protocol::scene::Command;
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_reckoning::Tick;

use super::scenery::{EXACT, NORMAL, ball, ball_shape, body, lockstep};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{Play, Stop, ensure, should};
use crate::conformance::peer::Guest;
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let case = |id: &str, name: &str, cites: &str| {
        Case::server(id, name)
            .cites(cites)
            .needs(&[Feature::Lockstep])
    };
    vec![
        case("L2.2.1", "an echo is answered by a vouch", "PROTOCOL 6.4-3, 5.13-1, 5.10-1, 5.10-2")
            .play(|trial| {
                let mut talk = Talk::begin(trial, NORMAL, 1)?;
                let next = talk.joined.start.next;
                talk.echo(next, 0, &[])?;
                let vouch = talk.vouch()?;
                ensure(vouch.next == Low16::of(next), "of the same number")?;
                ensure(vouch.tick == Low16::of(0), "and the newest tick")
            }),
        case("L2.2.2", "each tick that was asked for is vouched for, by a packet that ends it or by a vouch", "PROTOCOL 6.4-1, 6.3-12, 6.3-4, 5.9-1")
            .play(each_tick),
        case("L2.2.3", "numbers rise by one from the snapshot's on", "PROTOCOL 5.9-1, 6.11-2, 6.3-12, 5.7-1")
            .play(numbers),
        case("L2.2.4", "no datagram is longer than 1150 bytes", "PROTOCOL 5.8-3").play(short),
        case("L2.2.5", "a packet said to be lost is repaired by what its bodies do now", "PROTOCOL 6.7-3, 6.7-4, 5.11-1, 5.11-2")
            .play(repaired),
        case("L2.2.6", "a repair leaves out bodies that are gone", "PROTOCOL 6.7-4, 5.11-4").play(repaired_gone),
        case("L2.2.7", "nothing comes for a packet that was never sent", "PROTOCOL 6.7-7, 5.7-1")
            .play(never_sent),
        case("L2.2.8", "who wants parities for lost packets gets some", "PROTOCOL 6.15-8, 5.16-3, 5.16-4")
            .play(parities),
        case("L2.2.9", "a doubt of all is answered by sums of parts", "PROTOCOL 6.12-7, 5.14-1, 5.14-2, 5.15-1")
            .play(doubted),
        case("L2.2.10", "a doubt of one index is answered by its track", "PROTOCOL 6.12-7")
            .play(doubted_one),
        case("L2.2.11", "a body that sleeps is silent, and its ticks are vouched for", "PROTOCOL 6.3-9, 6.4-1, 6.13-3")
            .play(asleep),
        case("L2.2.12", "a resync is answered by a whole snapshot, and commands go on in number", "PROTOCOL 4.8-5, 4.8-6, 4.8-3")
            .play(resync),
        case("L2.2.13", "who follows another choice is told its stream, and hears the one before until it says so", "PROTOCOL 4.8-8, 4.8-10, 4.8-11, 4.8-12")
            .play(follows),
        case("L2.2.14", "of several wishes that come together only the last is answered", "PROTOCOL 4.8-9, 4.8-13")
            .play(only_the_last),
        case("L2.2.15", "a datagram tells how many notices were given before it", "PROTOCOL 4.6-5, 4.6-6, 6.3-3")
            .play(notices_counted),
        case("L2.2.16", "a snapshot tells shapes, bodies in order and joints, and nothing else", "PROTOCOL 4.8-1, 4.8-2, 4.8-4, 6.13-5")
            .play(snapshot),
        case("L2.2.17", "the sum over all tracks is said while bodies move", "PROTOCOL 6.12-3, 6.12-4")
            .play(digests),
    ]
}

/// A member of bytes, and what it knows of its stream.
struct Talk {
    guest: Guest,
    joined: Joined,
    /// Notices given outside of snapshots.
    notices: u64,
    balls: u32,
}

impl Talk {
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
        let notices = joined.start.notices + u64::from(balls) + 1;
        Ok(Self {
            guest,
            joined,
            notices,
            balls,
        })
    }

    fn echo(&mut self, next: u64, parities: u8, lost: &[u64]) -> Play {
        let echo = Echo {
            next: Low16::of(next),
            gone: Low16::of(lost.len() as u64),
            parities,
            lost: lost.iter().map(|number| Low16::of(*number)).collect(),
        };
        self.guest.throw(&echo.encode(self.joined.start.stream))
    }

    /// The next datagram: its kind, and all of it.
    fn next(&mut self) -> Result<(Kind, Vec<u8>), Stop> {
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

    fn vouch(&mut self) -> Result<Vouch, Stop> {
        loop {
            let (kind, bytes) = self.next()?;
            if kind == Kind::Vouch {
                return read(&bytes, Vouch::decode);
            }
        }
    }

    /// Pushes each ball its own way, so that each needs words of its own.
    fn stir(&mut self) -> Play {
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
    fn step(&mut self, to: u64) -> Result<Vec<(Kind, Vec<u8>)>, Stop> {
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
fn state(kind: Kind, bytes: &[u8]) -> Result<Option<StatePacket<'_>>, Stop> {
    if !matches!(kind, Kind::State | Kind::StateEnd) {
        return Ok(None);
    }
    let packet = read(bytes, |reader| {
        StatePacket::decode(kind == Kind::StateEnd, reader)
    })?;
    let again = read(bytes, |reader| {
        StatePacket::decode(kind == Kind::StateEnd, reader)
    })?;
    let mut updates = Vec::new();
    again
        .updates(&mut updates)
        .map_err(|why| Stop::Fail(format!("updates are malformed: {why:?}")))?;
    let rise = updates.windows(2).all(|pair| pair[0].seat < pair[1].seat);
    ensure(rise, "updates come in rising order of seat")?;
    Ok(Some(packet))
}

/// The tick of which nothing more comes.
fn tick_that_ends(kind: Kind, bytes: &[u8]) -> Result<Option<Low16>, Stop> {
    Ok(match kind {
        Kind::StateEnd => state(kind, bytes)?.map(|packet| packet.tick),
        Kind::Vouch => Some(read(bytes, Vouch::decode)?.tick),
        Kind::Digest => Some(read(bytes, Digest::decode)?.tick),
        _ => None,
    })
}

fn each_tick(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 8)?;
    talk.guest
        .say(&ClientMessage::Advance { to: Tick::new(40) });
    let mut expected = 1;
    while expected <= 40 {
        let (kind, bytes) = talk.next()?;
        if let Some(tick) = tick_that_ends(kind, &bytes)? {
            // An echo's vouch and a digest may say a tick again.
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

fn numbers(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 30)?;
    let numbers = talk.numbers_to(30)?;
    let first = talk.joined.start.next;
    let wanted: Vec<u64> = (first..first + numbers.len() as u64).collect();
    ensure(!numbers.is_empty(), "bodies that move are spoken of")?;
    ensure(
        numbers == wanted,
        format!("from {first} on, not {numbers:?}"),
    )
}

fn short(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, StreamChoice::Full, 60)?;
    talk.guest.say(&ClientMessage::Advance { to: Tick::new(5) });
    let mut count = 0;
    while count < 15 {
        let (_, bytes) = talk.next()?;
        ensure(
            bytes.len() <= DATAGRAM_BYTES_MAX,
            format!("{} bytes", bytes.len()),
        )?;
        count += 1;
    }
    Ok(())
}

fn repaired(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 8)?;
    let numbers = talk.numbers_to(20)?;
    let [lost, .., last] = numbers[..] else {
        return Stop::fail("bodies that are pushed are spoken of");
    };
    talk.echo(last + 1, 0, &[lost])?;
    loop {
        let (kind, bytes) = talk.next()?;
        if kind != Kind::Repair {
            continue;
        }
        let repair = read(&bytes, Repair::decode)?;
        ensure(repair.lost == Low16::of(lost), "it names the packet")?;
        ensure(repair.tick == Low16::of(20), "it is of now, not of then")?;
        return ensure(!repair.records.is_empty(), "it tells tracks");
    }
}

fn repaired_gone(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 1)?;
    let numbers = talk.numbers_to(20)?;
    let [lost, .., last] = numbers[..] else {
        return Stop::fail("a body that is pushed is spoken of");
    };
    let id = body(talk.guest.granted, 0)?;
    talk.guest.must(Command::RemoveBody { id })?;
    talk.echo(last + 1, 0, &[lost])?;
    loop {
        let (kind, bytes) = talk.next()?;
        if kind == Kind::Repair {
            let repair = read(&bytes, Repair::decode)?;
            return ensure(repair.records.is_empty(), "nothing is left to tell");
        }
    }
}

fn never_sent(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 2)?;
    let next = talk.numbers_to(10)?.last().map_or(0, |last| last + 1);
    talk.echo(next, 0, &[next + 500])?;
    let (kind, _) = talk.next()?;
    ensure(kind == Kind::Vouch, format!("a vouch, and no {kind:?}"))?;
    // What it is asked next it answers as ever.
    talk.step(11).map(drop)
}

fn parities(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 8)?;
    let packets = talk.packets_to(20)?;
    let [.., (first, _), (second, _), (third, _)] = packets[..] else {
        return Stop::fail("bodies that are pushed are spoken of");
    };
    let lost = [first, second];
    talk.echo(third + 1, 2, &lost)?;
    let mut covered = 0;
    loop {
        let (kind, bytes) = talk.next()?;
        match kind {
            Kind::Parity => {
                let parity = read(&bytes, Parity::decode)?;
                ensure(
                    sums_of(&parity, &packets, third) == Some(parity.sums),
                    "its sums are those of what was said",
                )?;
                covered += 1;
                if covered == lost.len() {
                    return Ok(());
                }
            }
            // It answers by repairs instead, as it MAY not: SHOULD.
            Kind::Repair => return should(false, "lost packets come back by parities"),
            _ => {}
        }
    }
}

/// The sums that a parity must have; none where it covers what was not said.
fn sums_of(parity: &Parity, packets: &[(u64, Vec<u8>)], newest: u64) -> Option<Vec<u8>> {
    let said = |number| packets.iter().find(|(other, _)| *other == number);
    let covered: Option<Vec<_>> = parity
        .numbers(parity.last.expand(newest))
        .map(|number| said(number).map(|(number, bytes)| (*number, &bytes[..])))
        .collect();
    let mut covered = covered?;
    covered.reverse();
    Parity::of(parity.row, &covered).map(|parity| parity.sums)
}

fn doubted(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, NORMAL, 3)?;
    talk.step(5)?;
    let range = Ranges::ALL;
    talk.guest
        .throw(&Doubt { range }.encode(talk.joined.start.stream))?;
    loop {
        let (kind, bytes) = talk.next()?;
        if kind != Kind::Digest {
            continue;
        }
        let digest = read(&bytes, Digest::decode)?;
        if digest.ranges.stride == INDICES_MAX {
            continue;
        }
        ensure(digest.ranges.first == 0, "from the first index on")?;
        ensure(
            digest.ranges.stride == INDICES_MAX.div_ceil(128),
            "of a 128th each",
        )?;
        return ensure(digest.sums.len() <= 128, "up to 128 parts");
    }
}

fn doubted_one(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, NORMAL, 3)?;
    talk.step(5)?;
    let index = body(talk.guest.granted, 1)?.index();
    let range = Ranges {
        first: index,
        stride: 1,
    };
    talk.guest
        .throw(&Doubt { range }.encode(talk.joined.start.stream))?;
    loop {
        let (kind, bytes) = talk.next()?;
        if kind == Kind::Repair {
            let repair = read(&bytes, Repair::decode)?;
            let indices: Vec<u32> = repair.records.iter().map(|record| record.index).collect();
            return ensure(
                indices == [index],
                format!("its track alone, not {indices:?}"),
            );
        }
    }
}

fn asleep(trial: &mut Trial<'_>) -> Play {
    let mut guest = trial.guest()?;
    let terms = super::scenery::weightless(lockstep());
    let joined = guest.enter(terms, EXACT)?;
    guest.must(ball_shape())?;
    let id = body(guest.granted, 0)?;
    guest.must(ball(id, Vec3::ZERO, Vec3::ZERO))?;
    let mut talk = Talk {
        guest,
        joined,
        notices: 2,
        balls: 1,
    };
    for to in 1..=600 {
        talk.step(to)?;
    }
    // Ten seconds later nothing is left to say but that nothing is.
    for to in 601..=660 {
        for (kind, _) in talk.step(to)? {
            ensure(
                matches!(kind, Kind::Vouch | Kind::Digest),
                format!("at {to} it says {kind:?}"),
            )?;
        }
    }
    Ok(())
}

fn resync(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, NORMAL, 3)?;
    talk.step(10)?;
    let commands = talk.guest.commands;
    talk.guest.say(&ClientMessage::Resync);
    let (joined, notices) = talk.guest.snapshot()?;
    ensure(joined.start.tick == Tick::new(10), "of the newest tick")?;
    ensure(
        joined.granted == talk.joined.granted,
        "granted is what was granted first",
    )?;
    ensure(
        joined.start.notices == talk.notices,
        format!("after {} notices", talk.notices),
    )?;
    ensure(
        notices.len() == 4,
        format!("a shape and three bodies, not {notices:?}"),
    )?;
    let id = body(talk.guest.granted, 0)?;
    talk.guest.must(Command::RemoveBody { id })?;
    ensure(talk.guest.commands == commands + 1, "numbers go on")
}

fn follows(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, NORMAL, 3)?;
    let before = talk.joined.start.stream;
    talk.guest.say(&ClientMessage::Follow(StreamChoice::Full));
    let (joined, _) = talk.guest.snapshot()?;
    let after = joined.start.stream;
    ensure(
        joined.choice == StreamChoice::Full && after != before,
        "another stream",
    )?;
    let heard = |guest: &mut Guest| -> Result<Vec<rhumb_protocol::packet::StreamId>, Stop> {
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
    talk.guest.say(&ClientMessage::Advance { to: Tick::new(2) });
    let both = heard(&mut talk.guest)?;
    ensure(
        both.contains(&before) && both.contains(&after),
        format!("it hears both, not {both:?}"),
    )?;
    talk.guest.say(&ClientMessage::Followed(after));
    talk.guest.barrier()?;
    talk.guest.datagrams.clear();
    talk.guest.say(&ClientMessage::Advance { to: Tick::new(8) });
    let one = heard(&mut talk.guest)?;
    ensure(
        one.iter().all(|stream| *stream == after),
        format!("then the new one alone, not {one:?}"),
    )
}

fn only_the_last(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, NORMAL, 1)?;
    let full = ClientMessage::Follow(StreamChoice::Full);
    talk.guest
        .say_together(&[ClientMessage::Resync, ClientMessage::Resync, full]);
    let heard = talk.guest.barrier()?;
    let joined: Vec<_> = heard
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

fn notices_counted(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 3)?;
    for (kind, bytes) in talk.step(1)? {
        let notices = match kind {
            Kind::Vouch => read(&bytes, Vouch::decode)?.notices,
            Kind::Digest => read(&bytes, Digest::decode)?.notices,
            _ => match state(kind, &bytes)? {
                Some(packet) => packet.notices,
                None => continue,
            },
        };
        let wanted = Low16::of(talk.notices);
        ensure(
            notices == wanted,
            format!("{wanted:?} were given, not {notices:?}"),
        )?;
    }
    Ok(())
}

fn snapshot(trial: &mut Trial<'_>) -> Play {
    use rhumb_protocol::message::Notice;

    let mut talk = Talk::begin(trial, NORMAL, 5)?;
    talk.step(7)?;
    let mut late = trial.guest_of(&talk.guest.scene.clone())?;
    late.hello()?;
    let (joined, notices) = late.join(NORMAL)?;
    ensure(
        joined.start.stream == talk.joined.start.stream,
        "the stream that runs",
    )?;
    ensure(joined.start.tick == Tick::new(7), "as of the newest tick")?;
    let ranks: Vec<u32> = notices
        .iter()
        .map(|notice| match notice {
            Notice::ShapeAdded { .. } => 0,
            Notice::GravityChanged { .. } => 1,
            Notice::BodyPlaced { terms, .. } => 2 + terms.id.index(),
            Notice::JointAdded { .. } => u32::MAX - 1,
            _ => u32::MAX,
        })
        .collect();
    ensure(
        ranks.is_sorted(),
        "shapes, gravities, bodies by index, joints",
    )?;
    ensure(!ranks.contains(&u32::MAX), "and nothing else")?;
    let bodies = notices
        .iter()
        .filter(|notice| matches!(notice, Notice::BodyPlaced { .. }));
    ensure(bodies.count() == 5, "all five bodies")
}

fn digests(trial: &mut Trial<'_>) -> Play {
    let mut talk = Talk::begin(trial, EXACT, 6)?;
    let mut sums = Vec::new();
    for to in 1..=150 {
        talk.stir()?;
        for (kind, bytes) in talk.step(to)? {
            if kind == Kind::Digest {
                let digest = read(&bytes, Digest::decode)?;
                ensure(
                    digest.ranges == Ranges::ALL && digest.sums.len() == 1,
                    "over all indices",
                )?;
                sums.extend(digest.sums);
            }
        }
    }
    ensure(!sums.is_empty(), "in two seconds it is said once at least")
}
