//! L2.52: checksums, repair_symbols, and streams that change.

use std::cell::{Cell, RefCell};
use std::rc::Rc;
use std::time::Duration;

use rhumb_protocol::message::{
    ClientMessage, Frames, ResyncCause, SceneEvent, ServerMessage, StreamChoice, TierChangeCause,
    frame,
};
use rhumb_protocol::packet::{LossReport, Low16, PacketKind, RepairSymbol};
use rhumb_reckoning::{Anchor, LengthBound, Tolerance, Track};

use super::l2_stream::busy;
use super::table;
use crate::conformance::case::{Case, CaseRow};
use crate::conformance::outcome::{CaseResult, Stop, ensure, should};
use crate::conformance::peer::{Delivery, Interceptor, Setting, datagram};
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    table("L2.52", CASES)
}

/// What each case of the group promises, cites and does.
const CASES: &[CaseRow] = &[
    (
        1,
        "a copy that is other than the stream is asked for anew",
        "PROTOCOL 5.14-1, 5.14-2, 6.12-1, 6.12-2, 6.12-5, 6.12-6, 6.7-10",
        asks_anew,
    ),
    (
        2,
        "a copy that is as the stream is kept",
        "PROTOCOL 6.12-4, 6.12-5",
        trusts,
    ),
    (
        3,
        "a checksums watermarks for its tick",
        "PROTOCOL 6.12-4, 6.4-4",
        digests_vouch,
    ),
    (
        10,
        "a lost packet is rebuilt from a repair_symbol, without a refresh",
        "PROTOCOL 5.16-1, 5.16-2, 5.16-3, 5.16-4, 6.15-3, 6.15-4, 6.15-5",
        rebuilds,
    ),
    (
        11,
        "two lost packets are rebuilt from repair_symbols of two rows",
        "PROTOCOL 5.16-3, 6.15-3, 6.15-4",
        rebuilds_two,
    ),
    (
        12,
        "a repair_symbol that is wrong does no harm: what was lost is refreshed",
        "PROTOCOL 6.15-6, 6.15-9",
        wrong_repair_symbol,
    ),
    (
        13,
        "repair_symbols of what cannot be received, and of nothing, are dropped",
        "PROTOCOL 6.15-2, 6.15-7",
        useless_repair_symbols,
    ),
    (
        14,
        "what came back by repair_symbols is reported as gone",
        "PROTOCOL 5.13-1, 6.15-5, 6.15-13",
        tells_of_loss,
    ),
    (
        15,
        "a repair_symbol that gives back only what is too old by now is dropped",
        "PROTOCOL 6.15-3",
        late_repair_symbol,
    ),
    (
        20,
        "a client that changes its stream follows the new one to the bit",
        "PROTOCOL 4.8-8, 4.8-10, 4.8-12, 4.8-14",
        changes,
    ),
    (
        21,
        "a client that is moved follows the new stream, and says so",
        "PROTOCOL 4.12-5, 4.8-12",
        |trial| moved(trial, TierChangeCause::LinkRecovered),
    ),
    (
        22,
        "a client that is moved off a stream that goes on no more follows the new one",
        "PROTOCOL 4.12-5, 4.12-6",
        |trial| moved(trial, TierChangeCause::LinkCongested),
    ),
    (
        23,
        "a full stream is followed to the bit",
        "PROTOCOL 5.12-1, 6.10-1, 6.10-3, 6.10-4; RECKONING 1.6-1",
        |trial| {
            let mut feed = trial.feed(Setting::of("ball-pit", 30).wishing("subscribe full"))?;
            feed.enter()?;
            let mut count = 0;
            feed.sift(move |bytes| {
                count += 1;
                if count % 6 == 5 { vec![] } else { vec![bytes] }
            });
            feed.step(60)?;
            feed.mend();
            feed.step(2)?;
            feed.must_follow()
        },
    ),
    (
        24,
        "a stream within a budget is followed to the bit",
        "PROTOCOL 5.17-1, 5.17-2, 6.16-8, 6.16-9",
        |trial| {
            let task = "subscribe 1000 budget 2000";
            let mut feed = trial.feed(Setting::of("ball-pit", 60).wishing(task))?;
            feed.enter()?;
            let mut count = 0;
            feed.sift(move |bytes| {
                count += 1;
                if count % 9 == 8 { vec![] } else { vec![bytes] }
            });
            feed.step(90)?;
            feed.mend();
            feed.step(2)?;
            feed.must_follow()
        },
    ),
];

/// Ticks in a second, and one.
const SECOND: u64 = 61;

/// The client is reported of one body that it is a metre higher than it is.
fn lie_of_one(feed: &mut Interceptor) -> Rc<RefCell<bool>> {
    let mut frames = Frames::new();
    let done = Rc::new(RefCell::new(false));
    let lied = Rc::clone(&done);
    feed.tamper(move |word| {
        let Delivery::Control(bytes) = word else {
            return vec![word];
        };
        frames.push(&bytes);
        let mut sent = Vec::new();
        while let Ok(Some(framed)) = frames.next_frame() {
            let message = ServerMessage::decode(&framed);
            match message {
                Ok(Some(ServerMessage::SceneEvent(SceneEvent::BodyPlaced {
                    desc,
                    inertia,
                    track,
                    alias,
                }))) if !*lied.borrow() && matches!(track.anchor, Anchor::Quantised(_)) => {
                    *lied.borrow_mut() = true;
                    let track = match track.anchor {
                        Anchor::Exact(_) => track,
                        Anchor::Quantised(mut quantised) => {
                            quantised.position[1] += 100;
                            Track {
                                anchor: Anchor::Quantised(quantised),
                                ..track
                            }
                        }
                    };
                    let scene_event = SceneEvent::BodyPlaced {
                        desc,
                        inertia,
                        track,
                        alias,
                    };
                    ServerMessage::SceneEvent(scene_event).encode(&mut sent);
                }
                _ => frame(framed.kind, &framed.body, &mut sent),
            }
        }
        vec![Delivery::Control(sent)]
    });
    done
}

/// Whether the client asked for a snapshot because a checksum differs.
fn is_anew(feed: &Interceptor) -> bool {
    let anew = ClientMessage::Resync(ResyncCause::ChecksumMismatch);
    feed.said.contains(&anew)
}

fn asks_anew(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    let lied = lie_of_one(&mut feed);
    feed.enter_unjudged()?;
    feed.mend();
    // A sum is due once it is a second old.
    for _ in 0..3 {
        feed.step_unjudged(SECOND)?;
        feed.run(Duration::from_millis(60))?;
    }
    if !*lied.borrow() {
        return Err(Stop::Inconclusive("there was nothing to lie of".into()));
    }
    should(is_anew(&feed), "it asks for a snapshot")?;
    feed.must_end_alike()
}

fn trusts(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 20).after(60))?;
    feed.enter()?;
    feed.step(2 * SECOND)?;
    feed.must_follow()?;
    ensure(!is_anew(&feed), "nothing is to be asked for")
}

fn digests_vouch(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    let checksum_packets = Rc::new(RefCell::new(0));
    let counted = Rc::clone(&checksum_packets);
    feed.sift(move |bytes| {
        *counted.borrow_mut() += u32::from(datagram::kind(&bytes) == Some(PacketKind::Checksums));
        vec![bytes]
    });
    feed.step(2 * SECOND)?;
    feed.must_follow()?;
    if *checksum_packets.borrow() == 0 {
        return Err(Stop::Inconclusive("the suite sent no checksums".into()));
    }
    Ok(())
}

/// Packets since the last repair_symbol, with their numbers, as a case says repair_symbols of.
#[derive(Debug, Default)]
struct SentPackets {
    number: u64,
    packets: Vec<(u64, Vec<u8>)>,
}

/// Loses the first of some packets in a row and says repair_symbols of them in their place; no refresh comes.
fn with_repair_symbols(
    feed: &mut Interceptor,
    lost: usize,
    spoil: fn(&mut RepairSymbol),
) -> Result<(), Stop> {
    let stream = feed.mirror()?.stream().stream();
    let next = feed.next_number();
    let mut sent = SentPackets {
        number: next,
        packets: Vec::new(),
    };
    feed.sift(move |bytes| {
        if matches!(
            datagram::kind(&bytes),
            Some(PacketKind::Refresh | PacketKind::RepairSymbol)
        ) {
            return vec![];
        }
        if !datagram::is_packet(&bytes) {
            return vec![bytes];
        }
        let number = sent.number;
        sent.number += 1;
        let place = sent.packets.len();
        // A packet without updates has no column: it is never covered.
        if RepairSymbol::of(0, &[(number, &bytes)]).is_none() {
            return vec![bytes];
        }
        sent.packets.push((number, bytes.clone()));
        let mut words = if place < lost { vec![] } else { vec![bytes] };
        if sent.packets.len() == 6 {
            let covered: Vec<_> = sent
                .packets
                .iter()
                .map(|(number, bytes)| (*number, &bytes[..]))
                .collect();
            for row in 0..lost {
                let repair_symbol = RepairSymbol::of(7 + row as u8, &covered);
                words.extend(repair_symbol.map(|mut repair_symbol| {
                    spoil(&mut repair_symbol);
                    repair_symbol.encode(stream)
                }));
            }
            sent.packets.clear();
        }
        words
    });
    Ok(())
}

fn rebuilds(trial: &mut Trial<'_>) -> CaseResult {
    repair_symbols(trial, 1)
}

fn rebuilds_two(trial: &mut Trial<'_>) -> CaseResult {
    repair_symbols(trial, 2)
}

fn repair_symbols(trial: &mut Trial<'_>, lost: usize) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    with_repair_symbols(&mut feed, lost, |_| {})?;
    feed.step_until_repair_symbol(60)?;
    // No refresh came: what is complete was rebuilt.
    feed.must_follow()
}

fn wrong_repair_symbol(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    with_repair_symbols(&mut feed, 1, |repair_symbol| {
        // The kind of the packet: what is rebuilt is none.
        if let Some(first) = repair_symbol.sums.first_mut() {
            *first ^= 0x40;
        }
    })?;
    feed.step(30)?;
    feed.mend();
    feed.step(3)?;
    feed.run(Duration::from_millis(300))?;
    feed.must_follow()
}

fn useless_repair_symbols(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 30))?;
    feed.enter()?;
    let stream = feed.mirror()?.stream().stream();
    let next = feed.next_number();
    let far = RepairSymbol {
        last: Low16::of(next + 5_000),
        covered: 0x7fff_ffff,
        row: 3,
        sums: vec![1, 2, 3],
    };
    let long_ago = RepairSymbol {
        last: Low16::of(next.saturating_sub(40)),
        ..far.clone()
    };
    let empty = RepairSymbol {
        last: Low16::of(next),
        covered: 0,
        row: 0,
        sums: Vec::new(),
    };
    for repair_symbol in [&far, &long_ago, &empty] {
        feed.host.throw(&repair_symbol.encode(stream))?;
    }
    feed.step(40)?;
    feed.must_follow()
}

/// Of ten packets under one repair_symbol two are lost, and one of these comes when the other is older than all that is kept.
fn late_repair_symbol(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    let stream = feed.mirror()?.stream().stream();
    let mut number = feed.next_number();
    let mut sent: Vec<(u64, Vec<u8>)> = Vec::new();
    let (tried, is_tried) = (Rc::new(Cell::new(0)), 2);
    let noted = Rc::clone(&tried);
    feed.sift(move |bytes| {
        if !datagram::is_packet(&bytes) {
            return vec![];
        }
        sent.push((number, bytes.clone()));
        number += 1;
        match sent.len() {
            1 => vec![],
            10 => {
                let covered: Vec<_> = sent.iter().map(|(of, bytes)| (*of, &bytes[..])).collect();
                let repair_symbol = RepairSymbol::of(5, &covered);
                noted.set(noted.get() + u32::from(repair_symbol.is_some()));
                repair_symbol
                    .iter()
                    .map(|repair_symbol| repair_symbol.encode(stream))
                    .collect()
            }
            40 => {
                noted.set(noted.get() + 1);
                vec![sent[9].1.clone(), bytes]
            }
            _ => vec![bytes],
        }
    });
    feed.step(60)?;
    if tried.get() != is_tried {
        return Err(Stop::Inconclusive("the suite sent too few packets".into()));
    }
    feed.mend();
    feed.step(3)?;
    feed.must_follow()
}

fn tells_of_loss(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    with_repair_symbols(&mut feed, 1, |_| {})?;
    feed.step_until_repair_symbol(60)?;
    feed.run(Duration::from_millis(700))?;
    let gone = feed
        .loss_reports
        .iter()
        .map(|(_, loss_report): &(_, LossReport)| loss_report.gone.0)
        .max();
    should(
        gone >= Some(1),
        format!("it tells of what is gone, and not {gone:?}"),
    )?;
    feed.must_follow()
}

fn changes(trial: &mut Trial<'_>) -> CaseResult {
    let setting = Setting::of("ball-pit", 30).wishing("subscribe 10000 change 50000");
    let mut feed = trial.feed(setting)?;
    feed.change_mirror_to(within(50_000)?);
    feed.enter()?;
    feed.follow_unjudged(20)?;
    let follows = |feed: &mut Interceptor| {
        feed.reported
            .iter()
            .any(|reported| reported["is"] == "following")
    };
    // Of a scene that stands still nothing more is sent.
    let (mut tries, mut stopped) = (0, Ok(()));
    feed.until("change to the new stream", |feed| {
        tries += 1;
        if tries % 10 == 0 {
            stopped = feed.step_unjudged(2);
        }
        stopped.is_err() || follows(feed)
    })?;
    stopped?;
    feed.must_end_alike()
}

fn within(micrometres: u32) -> Result<StreamChoice, Stop> {
    let length = LengthBound::from_micrometres(micrometres);
    let errs = |_| Stop::Inconclusive("the suite errs".into());
    length
        .map(|length| StreamChoice::Within(Tolerance::Surface(length)))
        .map_err(errs)
}

/// The server follows a task that the client has not sent, and calls it a move.
fn moved(trial: &mut Trial<'_>, cause: TierChangeCause) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 30))?;
    feed.enter()?;
    feed.step(10)?;
    feed.must_follow()?;
    let to = within(50_000)?;
    let old = feed.mirror()?.stream().stream();
    let mut first = true;
    feed.tamper(move |word| match word {
        Delivery::Control(bytes) if std::mem::take(&mut first) => {
            let mut sent = Vec::new();
            ServerMessage::TierChanged { to, cause }.encode(&mut sent);
            sent.extend(bytes);
            vec![Delivery::Control(sent)]
        }
        // What the link did not carry is sent no more.
        Delivery::State(bytes)
            if cause == TierChangeCause::LinkCongested
                && datagram::head(&bytes).is_some_and(|head| head.stream == old) =>
        {
            vec![]
        }
        word => vec![word],
    });
    feed.change_mirror_to(to);
    let mut bytes = Vec::new();
    ClientMessage::Subscribe(to).encode(&mut bytes);
    feed.speak_for_client(&bytes)?;
    feed.follow_unjudged(20)?;
    feed.must_end_alike()?;
    let followed = feed
        .said
        .iter()
        .any(|message| matches!(message, ClientMessage::Subscribed(stream) if *stream != old));
    ensure(followed, "it says that it follows the new stream")
}
