//! L2.51: gaps in a stream: loss reports, and conclusions meanwhile.

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

use super::hand;
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure, should};
use crate::peer::{Interceptor, RawServer, Setting, datagram};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    let mut cases = table("L2.51", LOSS_REPORTS);
    cases.extend(table("L2.51", CONCLUSIONS));
    cases
}

/// Cases about a client's loss reports and their times.
const LOSS_REPORTS: &[CaseRow] = &[
    (
        20,
        "a lost packet is soon reported by its number",
        "PROTOCOL 5.7-1, 5.13-1, 5.13-2, 6.6-1, 6.6-5, 6.7-1",
        asks_for_it,
    ),
    (
        21,
        "a packet that is not refreshed is reported again at least every half second",
        "PROTOCOL 6.7-1",
        asks_again,
    ),
    (
        22,
        "a loss report names at most 64 packets, the oldest first",
        "PROTOCOL 5.13-1, 7-1",
        asks_for_many,
    ),
    (
        23,
        "packet numbers are extended correctly when their low 16 bits wrap around",
        "PROTOCOL 5.7-1",
        across_the_wraparound,
    ),
    (
        24,
        "a client that lost more packets than it can track requests a new snapshot",
        "PROTOCOL 4.8-5, 6.7-9, 6.7-10, 6.8-6",
        lost_too_many,
    ),
    (
        25,
        "a client requests a new snapshot when a tick is too far ahead",
        "PROTOCOL 6.7-9, 6.7-10",
        jumps,
    ),
    (
        28,
        "a client that lacks more packets than it can rebuild requests refreshes, not repair symbols",
        "PROTOCOL 5.13-1, 6.15-10, 7-1",
        wants_no_repair_symbols,
    ),
    (
        26,
        "a client asks again for a requested tick that does not come",
        "PROTOCOL 4.9-2, 6.7-2",
        misses_the_answer,
    ),
    (
        27,
        "a client that advances the scene tick by tick follows bit-exactly",
        "PROTOCOL 4.9-1, 4.9-2, 6.4-1, 6.4-4",
        |trial| {
            let setting = Setting::of("ball-pit", 20).with_task("subscribe 10000 advance 60");
            let mut interceptor = trial.interceptor(setting)?;
            interceptor.enter()?;
            interceptor.raw_server.wait_longer(trial.round_trips(60));
            interceptor.until("sixty ticks", |interceptor| {
                interceptor
                    .mirror()
                    .is_ok_and(|copy| copy.stream().complete().value() >= 60)
            })?;
            interceptor.must_follow()?;
            let reported = interceptor.ticks_reported();
            ensure(
                reported >= 40,
                format!("it reports each tick, not {reported} of 40"),
            )
        },
    ),
];

/// Cases about a client's reports of its copy.
const CONCLUSIONS: &[CaseRow] = &[
    (
        40,
        "no tick is complete while a packet before it is missing",
        "PROTOCOL 6.6-13, 6.8-1, 6.8-2, 6.8-5",
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
        "a lost rest update is refreshed like any other update",
        "PROTOCOL 5.6-12, 6.3-9, 6.7-3; RECKONING 4.7-1",
        rests,
    ),
    (
        43,
        "a correction of a missing revision waits, and does no harm",
        "PROTOCOL 6.2-1, 6.2-2, 6.6-6, 6.6-9",
        |trial| no_promise_over_a_gap(trial, 4),
    ),
    (
        44,
        "datagrams beyond the limit of kept ones do no lasting harm",
        "PROTOCOL 6.5-2, 7-1",
        too_many_held,
    ),
];

/// A rotating drum, in which many bodies change at each tick.
pub(super) fn busy() -> Setting {
    Setting::of("tumbler", 20).after(60)
}

/// Drops this number of packets, and their refreshes and repair symbols; returns the tick of the first one.
fn lose(interceptor: &mut Interceptor, packets: usize) -> Result<u64, Stop> {
    let lost = Rc::new(RefCell::new(Vec::new()));
    let ticks = Rc::clone(&lost);
    interceptor.filter_datagrams(move |bytes| {
        let mut ticks = ticks.borrow_mut();
        if datagram::is_packet(&bytes) && ticks.len() < packets {
            // In this scene the tick fits into its low bits.
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
        interceptor.step(1)?;
    }
    let first = lost.borrow().first().copied();
    first.ok_or_else(|| Stop::Inconclusive("nothing was sent".into()))
}

fn asks_for_it(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    hand::watermark(
        &mut server,
        hand::NEXT + 3,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )?;
    let loss_report = hand::loss_report(&mut server)?;
    let lost: Vec<_> = (hand::NEXT..hand::NEXT + 3).map(Low16::of).collect();
    ensure(
        loss_report.lost == lost,
        format!("it reports {lost:?}, not {:?}", loss_report.lost),
    )?;
    ensure(
        loss_report.next == Low16::of(hand::NEXT + 3),
        "`next` is one more than the newest",
    )?;
    ensure(
        loss_report.abandoned == Low16::of(3),
        format!(
            "three packets are counted as lost, not {}",
            loss_report.abandoned.0
        ),
    )
}

/// Half a second, plus the delay of a busy machine.
const OFTEN_ENOUGH: Span = Span::from_millis(900);
/// Number of observation periods of 2.6 s: a client that is late in each of them is not late by chance.
const STRETCHES: usize = 4;

fn asks_again(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    interceptor.enter()?;
    lose(&mut interceptor, 2)?;
    interceptor.step(6)?;
    let mut often = asks_often(&mut interceptor);
    for _ in 1..STRETCHES {
        if !matches!(often, Err(Stop::Lax(_))) {
            break;
        }
        often = asks_often(&mut interceptor);
    }
    often?;
    interceptor.stop_tampering();
    interceptor.step(2)?;
    interceptor.must_follow()
}

/// The client sends a loss report every half second during one period.
fn asks_often(interceptor: &mut Interceptor) -> CaseResult {
    let begin = interceptor.raw_server.now();
    interceptor.run(Duration::from_millis(2_600))?;
    let times: Vec<Instant> = (interceptor.loss_reports.iter().map(|(at, _)| *at))
        .filter(|at| *at >= begin)
        .collect();
    let asked = format!(
        "it sends reports all the time, not {} in 2.6 s",
        times.len()
    );
    ensure(!times.is_empty(), "it reports what it misses")?;
    should(times.len() >= 4, asked)?;
    let longest = times.windows(2).map(|pair| pair[1].since(pair[0])).max();
    should(
        longest <= Some(OFTEN_ENOUGH),
        format!("it reports every half second, not after {longest:?}"),
    )
}

fn asks_for_many(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    hand::watermark(
        &mut server,
        hand::NEXT + 500,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )?;
    let loss_report = hand::loss_report(&mut server)?;
    let oldest: Vec<_> = (hand::NEXT..hand::NEXT + 64).map(Low16::of).collect();
    ensure(
        loss_report.lost == oldest,
        format!("it reports the 64 oldest, not {:?}", loss_report.lost),
    )
}

/// A client that lacks fewer packets may request repair symbols or not: ignoring them is allowed (6.15-2).
fn wants_no_repair_symbols(trial: &mut Trial<'_>) -> CaseResult {
    let lacking = REPAIR_SYMBOLS_KEPT as u64 + 1;
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    let next = hand::NEXT + lacking;
    hand::watermark(&mut server, next, hand::TICK + 1, hand::SCENE_EVENTS)?;
    let loss_report = hand::loss_report(&mut server)?;
    ensure(
        loss_report.repair_symbols == 0,
        format!(
            "it requests refreshes, not {} repair symbols",
            loss_report.repair_symbols
        ),
    )?;
    let lost: Vec<_> = (hand::NEXT..next).map(Low16::of).collect();
    ensure(
        loss_report.lost == lost,
        format!(
            "it names all packets that it lacks, not {:?}",
            loss_report.lost
        ),
    )
}

fn across_the_wraparound(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::awaits_join(&mut server)?;
    let mut joined = hand::joined();
    joined.start.next = 0x1_fffe;
    joined.start.tick = Tick::new(0x2_ffff);
    joined.start.scene_events = 0xffff;
    server.send(&ServerMessage::Joined(joined));
    server.send(&ServerMessage::SceneEvent(hand::shape()));
    server.send(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Rest,
    )));
    server.send(&ServerMessage::SnapshotEnd);
    hand::reported(&mut server, "joined")?;
    hand::watermark(&mut server, 0x1_fffe, 0x3_0004, 0xffff)?;
    loop {
        let reported = hand::reported(&mut server, "tick")?;
        if reported["tick"] == 0x3_0004 {
            break;
        }
        ensure(
            reported["tick"] == 0x2_ffff,
            format!("the tick is 196612, not {}", reported["tick"]),
        )?;
    }
    server.send_bytes(&[2, 11, 0x8a]);
    hand::watermark(&mut server, 0x2_0002, 0x3_0005, 0x1_0000)?;
    let loss_report = hand::loss_report(&mut server)?;
    let lost: Vec<_> = (0x1_fffe..0x2_0002).map(Low16::of).collect();
    ensure(
        loss_report.lost == lost,
        format!("it reports {lost:?}, not {:?}", loss_report.lost),
    )
}

fn resyncs(server: &mut RawServer) -> CaseResult {
    server.await_message("resync", |message| {
        matches!(message, ClientMessage::Resync(_)).then_some(())
    })
}

fn lost_too_many(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    hand::watermark(
        &mut server,
        hand::NEXT + 1_025,
        hand::TICK + 1,
        hand::SCENE_EVENTS,
    )?;
    resyncs(&mut server)?;
    let mut joined = hand::joined();
    joined.start.next = hand::NEXT + 1_025;
    joined.start.tick = Tick::new(hand::TICK + 1);
    server.send(&ServerMessage::Joined(joined));
    server.send(&ServerMessage::SceneEvent(hand::shape()));
    server.send(&ServerMessage::SceneEvent(hand::ball(
        hand::BALL,
        Predictor::Ballistic,
    )));
    server.send(&ServerMessage::SnapshotEnd);
    // Before the snapshot is complete, the client may ignore packets of its stream.
    hand::reported_tick(&mut server, hand::TICK + 1)?;
    hand::watermark(
        &mut server,
        hand::NEXT + 1_025,
        hand::TICK + 2,
        hand::SCENE_EVENTS,
    )?;
    hand::reported_tick(&mut server, hand::TICK + 2).map(drop)
}

fn jumps(trial: &mut Trial<'_>) -> CaseResult {
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    hand::watermark(
        &mut server,
        hand::NEXT,
        hand::TICK + 3_601,
        hand::SCENE_EVENTS,
    )?;
    resyncs(&mut server)
}

fn misses_the_answer(trial: &mut Trial<'_>) -> CaseResult {
    let setting = Setting::of("ball-pit", 20).with_task("subscribe 10000 advance 60");
    let mut interceptor = trial.interceptor(setting)?;
    let mut count = 0;
    interceptor.filter_datagrams(move |bytes| {
        count += 1;
        if count % 10 == 9 { vec![] } else { vec![bytes] }
    });
    interceptor.enter()?;
    let longer = Duration::from_secs(8) + trial.round_trips(60);
    interceptor.until_for(longer, "sixty ticks", |interceptor| {
        interceptor
            .mirror()
            .is_ok_and(|copy| copy.stream().complete().value() >= 60)
    })?;
    interceptor.stop_tampering();
    interceptor.step(2)?;
    interceptor.must_follow()
}

fn no_promise_over_a_gap(trial: &mut Trial<'_>, packets: usize) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    interceptor.enter()?;
    interceptor.step(3)?;
    interceptor.must_follow()?;
    let before = interceptor.reported.len();
    let gap = lose(&mut interceptor, packets)?;
    interceptor.step(25)?;
    for reported in &interceptor.reported[before..] {
        let tick = reported["tick"].as_u64().unwrap_or_default();
        ensure(
            tick < gap,
            format!("{tick} must not be complete: a packet of {gap} is missing"),
        )?;
    }
    interceptor.stop_tampering();
    interceptor.step(2)?;
    interceptor.must_follow()
}

/// Each packet comes again later, either unchanged or with the number of a missing packet.
fn stale_packets(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor =
        trial.interceptor(Setting::of("ball-pit", 30).with_task("subscribe full"))?;
    let mut old: VecDeque<Vec<u8>> = VecDeque::new();
    interceptor.enter()?;
    let mut count = 0;
    interceptor.filter_datagrams(move |bytes| {
        count += 1;
        if datagram::is_packet(&bytes) {
            old.push_back(bytes.clone());
        }
        // One packet in seven comes only after six others.
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
    interceptor.step(60)?;
    interceptor.stop_tampering();
    interceptor.step(2)?;
    interceptor.must_follow()
}

/// The packets that put bodies to rest are lost.
fn rests(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("dominoes", 12).after(2))?;
    interceptor.enter()?;
    let lost = Rc::new(RefCell::new(0));
    let counted = Rc::clone(&lost);
    interceptor.filter_datagrams(move |bytes| {
        if contains_rest(&bytes) && *counted.borrow() % 3 < 2 {
            *counted.borrow_mut() += 1;
            return vec![];
        }
        vec![bytes]
    });
    for _ in 0..12 {
        interceptor.step_fast(40)?;
        if *lost.borrow() > 2 {
            break;
        }
    }
    interceptor.stop_tampering();
    interceptor.step(3)?;
    interceptor.must_follow()?;
    if *lost.borrow() == 0 {
        return Err(Stop::Inconclusive("no body came to rest".into()));
    }
    Ok(())
}

/// True if a packet contains a rest update with an exact pose.
fn contains_rest(bytes: &[u8]) -> bool {
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
    let mut server = trial.raw_server()?;
    hand::admit(&mut server)?;
    for tick in 1..=600 {
        hand::watermark(
            &mut server,
            hand::NEXT,
            hand::TICK + tick,
            hand::SCENE_EVENTS + 1,
        )?;
        if tick % 50 == 0 {
            server.listen(Duration::from_millis(5))?;
        }
    }
    server.send_bytes(&[2, 11, 0x8a]);
    hand::must_go_on(
        &mut server,
        hand::NEXT + 1,
        hand::TICK + 700,
        hand::SCENE_EVENTS + 1,
    )
}
