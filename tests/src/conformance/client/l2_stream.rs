//! L2.51: gaps: what is asked for, and what is known meanwhile.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::time::Duration;

use rhumb_protocol::limits::REPAIR_SYMBOLS_KEPT;
use rhumb_protocol::message::{ClientMessage, ServerMessage};
use rhumb_protocol::packet::{Head, Low16, PacketKind, UpdatePacket, UpdatePayload};
use rhumb_protocol::wire::Wire;
use rhumb_protocol::wire::bytes::Reader;
use rhumb_protocol::{Instant, Span};
use rhumb_reckoning::{Predictor, Tick};

use super::{hand, table};
use crate::conformance::case::{Case, CaseRow};
use crate::conformance::outcome::{CaseResult, Stop, ensure, should};
use crate::conformance::peer::{Host, Interceptor, Setting, datagram};
use crate::conformance::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = table("L2.51", ASKINGS);
    cases.extend(table("L2.51", KNOWINGS));
    cases
}

/// What a client asks for, and when.
const ASKINGS: &[CaseRow] = &[
    (
        20,
        "a lost packet is asked for by its number, and soon",
        "PROTOCOL 5.7-1, 5.13-1, 6.6-1, 6.6-5, 6.7-1",
        asks_for_it,
    ),
    (
        21,
        "what is not refreshed is asked for again and again, each half second at least",
        "PROTOCOL 6.7-1",
        asks_again,
    ),
    (
        22,
        "no more than 64 packets are asked for at once, the oldest first",
        "PROTOCOL 5.13-1, 7-1",
        asks_for_many,
    ),
    (
        23,
        "numbers are reported from their low 16 bits across the turn",
        "PROTOCOL 5.7-1",
        across_the_turn,
    ),
    (
        24,
        "what is lost beyond all memory is not asked for: the scene is sent anew",
        "PROTOCOL 4.8-5, 6.7-9, 6.7-10, 6.8-6",
        loses_touch,
    ),
    (
        25,
        "a tick too far ahead is no tick to follow to: the scene is sent anew",
        "PROTOCOL 6.7-9, 6.7-10",
        jumps,
    ),
    (
        28,
        "who lacks more packets than it could rebuild wants refreshes, and no repair_symbols",
        "PROTOCOL 5.13-1, 6.15-14, 7-1",
        wants_no_repair_symbols,
    ),
    (
        26,
        "a tick that was asked for and does not come is asked after",
        "PROTOCOL 4.9-2, 6.7-2",
        misses_the_answer,
    ),
    (
        27,
        "a client that asks for each tick gets each, to the bit",
        "PROTOCOL 4.9-1, 4.9-2, 6.4-1, 6.4-4",
        |trial| {
            let setting = Setting::of("ball-pit", 20).wishing("subscribe 10000 advance 60");
            let mut feed = trial.feed(setting)?;
            feed.enter()?;
            feed.until("sixty ticks", |feed| {
                feed.mirror()
                    .is_ok_and(|copy| copy.stream().complete().value() >= 60)
            })?;
            feed.must_follow()?;
            let reported = feed.ticks_told();
            ensure(
                reported >= 40,
                format!("it tells of each tick, and not of {reported} of 40"),
            )
        },
    ),
];

/// What a client may say of its copy, and what not.
const KNOWINGS: &[CaseRow] = &[
    (
        40,
        "no tick is complete while a packet before it is missing",
        "PROTOCOL 6.6-14, 6.8-1, 6.8-2, 6.8-5",
        |trial| no_promise_over_a_gap(trial, 1),
    ),
    (
        41,
        "a stale packet changes nothing",
        "PROTOCOL 6.2-2, 6.6-4",
        stale_packets,
    ),
    (
        42,
        "a rest that was lost is refreshed like any other word",
        "PROTOCOL 5.6-11, 6.3-9, 6.7-3; RECKONING 4.7-1",
        rests,
    ),
    (
        43,
        "a correction of a revision that is not there waits, and harms nothing",
        "PROTOCOL 6.2-1, 6.2-2, 6.6-6, 6.6-9",
        |trial| no_promise_over_a_gap(trial, 4),
    ),
    (
        44,
        "datagrams beyond those that may be held do no lasting harm",
        "PROTOCOL 6.5-2, 7-1",
        too_many_held,
    ),
];

/// A drum in which much goes on at each tick.
pub(super) fn busy() -> Setting {
    Setting::of("tumbler", 20).after(60)
}

/// Loses so many packets, and whatever would make them good; returns the tick of the first.
fn lose(feed: &mut Interceptor, packets: usize) -> Result<u64, Stop> {
    let lost = Rc::new(RefCell::new(Vec::new()));
    let ticks = Rc::clone(&lost);
    feed.sift(move |bytes| {
        let mut ticks = ticks.borrow_mut();
        if datagram::is_packet(&bytes) && ticks.len() < packets {
            // The low bits are all of it here.
            ticks.extend(datagram::tick_of(&bytes).map(u64::from));
            return vec![];
        }
        if matches!(
            datagram::kind(&bytes),
            Some(PacketKind::Refresh | PacketKind::RepairSymbol)
        ) {
            vec![]
        } else {
            vec![bytes]
        }
    });
    for _ in 0..60 {
        if lost.borrow().len() == packets {
            break;
        }
        feed.step(1)?;
    }
    let first = lost.borrow().first().copied();
    first.ok_or_else(|| Stop::Inconclusive("nothing was sent".into()))
}

fn asks_for_it(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    hand::watermark(
        &mut host,
        hand::NEXT + 3,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )?;
    let loss_report = hand::loss_report(&mut host)?;
    let lost: Vec<_> = (hand::NEXT..hand::NEXT + 3).map(Low16::of).collect();
    ensure(
        loss_report.lost == lost,
        format!("it asks for {lost:?}, and not for {:?}", loss_report.lost),
    )?;
    ensure(
        loss_report.next == Low16::of(hand::NEXT + 3),
        "`next` is one more than the newest",
    )?;
    ensure(
        loss_report.gone == Low16::of(3),
        format!("three are gone, and not {}", loss_report.gone.0),
    )
}

/// Half a second, and what a busy machine adds.
const OFTEN_ENOUGH: Span = Span::from_millis(900);
/// How many stretches of 2.6 s a client is watched for: one that is late in each of them is not late by chance.
const STRETCHES: usize = 4;

fn asks_again(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    lose(&mut feed, 2)?;
    feed.step(6)?;
    let mut often = asks_often(&mut feed);
    for _ in 1..STRETCHES {
        if !matches!(often, Err(Stop::Lax(_))) {
            break;
        }
        often = asks_often(&mut feed);
    }
    often?;
    feed.mend();
    feed.step(2)?;
    feed.must_follow()
}

/// Whether it asks each half second for a while, by the clock.
fn asks_often(feed: &mut Interceptor) -> CaseResult {
    let begin = feed.host.now();
    feed.run(Duration::from_millis(2_600))?;
    let times: Vec<Instant> = (feed.loss_reports.iter().map(|(at, _)| *at))
        .filter(|at| *at >= begin)
        .collect();
    let asked = format!("it asks on, and not {} times in 2.6 s", times.len());
    ensure(!times.is_empty(), "it asks for what it misses")?;
    should(times.len() >= 4, asked)?;
    let longest = times.windows(2).map(|pair| pair[1].since(pair[0])).max();
    should(
        longest <= Some(OFTEN_ENOUGH),
        format!("it asks each half second, and not after {longest:?}"),
    )
}

fn asks_for_many(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    hand::watermark(
        &mut host,
        hand::NEXT + 500,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )?;
    let loss_report = hand::loss_report(&mut host)?;
    let oldest: Vec<_> = (hand::NEXT..hand::NEXT + 64).map(Low16::of).collect();
    ensure(
        loss_report.lost == oldest,
        format!(
            "it asks for the 64 oldest, and not for {:?}",
            loss_report.lost
        ),
    )
}

/// A listener that lacks less may want repair_symbols or not: nothing is lost by not understanding them (6.15-2).
fn wants_no_repair_symbols(trial: &mut Trial<'_>) -> CaseResult {
    let lacking = REPAIR_SYMBOLS_KEPT as u64 + 1;
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    let next = hand::NEXT + lacking;
    hand::watermark(&mut host, next, hand::TICK + 1, hand::SCENE_EVENTS)?;
    let loss_report = hand::loss_report(&mut host)?;
    ensure(
        loss_report.repair_symbols == 0,
        format!(
            "it wants refreshes, and not {} repair_symbols",
            loss_report.repair_symbols
        ),
    )?;
    let lost: Vec<_> = (hand::NEXT..next).map(Low16::of).collect();
    ensure(
        loss_report.lost == lost,
        format!("it names all that it lacks, and not {:?}", loss_report.lost),
    )
}

fn across_the_turn(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::wants_in(&mut host)?;
    let mut joined = hand::joined();
    joined.start.next = 0x1_fffe;
    joined.start.tick = Tick::new(0x2_ffff);
    joined.start.scene_events = 0xffff;
    host.say(&ServerMessage::Joined(joined));
    host.say(&ServerMessage::SceneEvent(hand::shape()));
    host.say(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Rest,
    )));
    host.say(&ServerMessage::SnapshotEnd);
    hand::reported(&mut host, "joined")?;
    hand::watermark(&mut host, 0x1_fffe, 0x3_0004, 0xffff)?;
    loop {
        let reported = hand::reported(&mut host, "tick")?;
        if reported["tick"] == 0x3_0004 {
            break;
        }
        ensure(
            reported["tick"] == 0x2_ffff,
            format!("the tick is 196612, and not {}", reported["tick"]),
        )?;
    }
    host.utter(&[2, 11, 0x8a]);
    hand::watermark(&mut host, 0x2_0002, 0x3_0005, 0x1_0000)?;
    let loss_report = hand::loss_report(&mut host)?;
    let lost: Vec<_> = (0x1_fffe..0x2_0002).map(Low16::of).collect();
    ensure(
        loss_report.lost == lost,
        format!("it misses {lost:?}, and not {:?}", loss_report.lost),
    )
}

fn resyncs(host: &mut Host) -> CaseResult {
    host.await_message("resync", |message| {
        matches!(message, ClientMessage::Resync(_)).then_some(())
    })
}

fn loses_touch(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    hand::watermark(
        &mut host,
        hand::NEXT + 1_025,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )?;
    resyncs(&mut host)?;
    let mut joined = hand::joined();
    joined.start.next = hand::NEXT + 1_025;
    joined.start.tick = Tick::new(hand::TICK + 1);
    host.say(&ServerMessage::Joined(joined));
    host.say(&ServerMessage::SceneEvent(hand::shape()));
    host.say(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Ballistic,
    )));
    host.say(&ServerMessage::SnapshotEnd);
    // Before the snapshot is whole the client need not hear its stream.
    hand::told_tick(&mut host, hand::TICK + 1)?;
    hand::watermark(
        &mut host,
        hand::NEXT + 1_025,
        hand::TICK + 2,
        hand::SCENE_EVENTS,
    )?;
    hand::told_tick(&mut host, hand::TICK + 2).map(drop)
}

fn jumps(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    hand::watermark(
        &mut host,
        hand::NEXT,
        hand::TICK + 3_601,
        hand::SCENE_EVENTS,
    )?;
    resyncs(&mut host)
}

fn misses_the_answer(trial: &mut Trial<'_>) -> CaseResult {
    let setting = Setting::of("ball-pit", 20).wishing("subscribe 10000 advance 60");
    let mut feed = trial.feed(setting)?;
    let mut count = 0;
    feed.sift(move |bytes| {
        count += 1;
        if count % 10 == 9 { vec![] } else { vec![bytes] }
    });
    feed.enter()?;
    feed.until_for(Duration::from_secs(8), "sixty ticks", |feed| {
        feed.mirror()
            .is_ok_and(|copy| copy.stream().complete().value() >= 60)
    })?;
    feed.mend();
    feed.step(2)?;
    feed.must_follow()
}

fn no_promise_over_a_gap(trial: &mut Trial<'_>, packets: usize) -> CaseResult {
    let mut feed = trial.feed(busy())?;
    feed.enter()?;
    feed.step(3)?;
    feed.must_follow()?;
    let before = feed.reported.len();
    let gap = lose(&mut feed, packets)?;
    feed.step(25)?;
    for reported in &feed.reported[before..] {
        let tick = reported["tick"].as_u64().unwrap_or_default();
        ensure(
            tick < gap,
            format!("{tick} is not complete: a packet of {gap} is missing"),
        )?;
    }
    feed.mend();
    feed.step(2)?;
    feed.must_follow()
}

/// Each packet again a while later, whole or with the number of one that is missing.
fn stale_packets(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(Setting::of("ball-pit", 30).wishing("subscribe full"))?;
    let mut old: VecDeque<Vec<u8>> = VecDeque::new();
    feed.enter()?;
    let mut count = 0;
    feed.sift(move |bytes| {
        count += 1;
        if datagram::is_packet(&bytes) {
            old.push_back(bytes.clone());
        }
        // One in seven comes only when six others have.
        let mut sent = if datagram::is_packet(&bytes) && count % 7 == 3 {
            vec![]
        } else {
            vec![bytes]
        };
        if old.len() > 6 {
            sent.extend(old.pop_front());
        }
        sent
    });
    feed.step(60)?;
    feed.mend();
    feed.step(2)?;
    feed.must_follow()
}

/// Packets by which bodies are put to rest are lost.
fn rests(trial: &mut Trial<'_>) -> CaseResult {
    let mut feed = trial.feed(Setting::of("dominoes", 12).after(2))?;
    feed.enter()?;
    let lost = Rc::new(RefCell::new(0));
    let counted = Rc::clone(&lost);
    feed.sift(move |bytes| {
        if says_rest(&bytes) && *counted.borrow() % 3 < 2 {
            *counted.borrow_mut() += 1;
            return vec![];
        }
        vec![bytes]
    });
    for _ in 0..12 {
        feed.step_fast(40)?;
        if *lost.borrow() > 2 {
            break;
        }
    }
    feed.mend();
    feed.step(3)?;
    feed.must_follow()?;
    if *lost.borrow() == 0 {
        return Err(Stop::Inconclusive("nothing came to rest".into()));
    }
    Ok(())
}

/// Whether a packet puts a body to a body_state rest.
fn says_rest(bytes: &[u8]) -> bool {
    let mut reader = Reader::new(bytes);
    let mut updates = Vec::new();
    Head::decode(&mut reader)
        .is_ok_and(|head| matches!(head.kind, PacketKind::Updates | PacketKind::UpdatesEnd))
        && UpdatePacket::decode(true, reader)
            .and_then(|packet| packet.updates(&mut updates))
            .is_ok()
        && updates
            .iter()
            .any(|update| matches!(update.payload, UpdatePayload::Resting { .. }))
}

fn too_many_held(trial: &mut Trial<'_>) -> CaseResult {
    let mut host = trial.host()?;
    hand::let_in(&mut host)?;
    for tick in 1..=600 {
        hand::watermark(
            &mut host,
            hand::NEXT,
            hand::TICK + tick,
            hand::SCENE_EVENTS + 1,
        )?;
        if tick % 50 == 0 {
            host.listen(Duration::from_millis(5))?;
        }
    }
    host.utter(&[2, 11, 0x8a]);
    hand::must_go_on(
        &mut host,
        hand::NEXT + 1,
        hand::TICK + 700,
        hand::SCENE_EVENTS + 1,
    )
}
