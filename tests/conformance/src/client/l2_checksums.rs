//! L2.52: checksums, repair symbols, and streams that change.

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
use super::table::table;
use crate::case::{Case, CaseRow};
use crate::outcome::{CaseResult, Stop, ensure, should};
use crate::peer::{Delivery, Interceptor, Setting, datagram};
use crate::trial::Trial;

pub(super) fn cases() -> Vec<Case> {
    table("L2.52", CASES)
}

/// The cases of the group: promise, citations, test function.
const CASES: &[CaseRow] = &[
    (
        1,
        "a client whose copy differs from the stream requests a new snapshot",
        "PROTOCOL 5.14-1, 5.14-2, 6.12-1, 6.12-2, 6.12-5, 6.12-6, 6.7-10",
        mismatch,
    ),
    (
        2,
        "a client requests no snapshot while its copy equals the stream",
        "PROTOCOL 6.12-4, 6.12-5",
        no_mismatch,
    ),
    (
        3,
        "a checksum packet completes its tick",
        "PROTOCOL 6.12-4, 6.4-4",
        checksums_complete_ticks,
    ),
    (
        10,
        "a lost packet is rebuilt from a repair symbol, without a refresh",
        "PROTOCOL 5.16-1, 5.16-2, 5.16-3, 5.16-4, 6.15-3, 6.15-4, 6.15-5",
        rebuilds,
    ),
    (
        11,
        "two lost packets are rebuilt from repair symbols of two rows",
        "PROTOCOL 5.16-3, 6.15-3, 6.15-4",
        rebuilds_two,
    ),
    (
        12,
        "a wrong repair symbol does no harm: the lost packet is refreshed",
        "PROTOCOL 6.15-6, 6.15-9",
        wrong_repair_symbol,
    ),
    (
        13,
        "repair symbols of impossible packets, and of no packet, are dropped",
        "PROTOCOL 6.15-2, 6.15-7",
        useless_repair_symbols,
    ),
    (
        14,
        "packets rebuilt from repair symbols are reported as lost on the link",
        "PROTOCOL 5.13-1, 5.13-2, 6.15-5, 6.15-14",
        reports_loss,
    ),
    (
        15,
        "a repair symbol that restores only packets that are too old is dropped",
        "PROTOCOL 6.15-3",
        late_repair_symbol,
    ),
    (
        20,
        "a client that changes its stream follows the new one bit-exactly",
        "PROTOCOL 4.8-8, 4.8-10, 4.8-12, 4.8-14",
        changes,
    ),
    (
        21,
        "a client whose tier changes follows the new stream, and confirms it",
        "PROTOCOL 4.12-5, 4.8-12",
        |trial| moved(trial, TierChangeCause::LinkRecovered),
    ),
    (
        22,
        "a client whose tier changes follows the new stream although the old one has stopped",
        "PROTOCOL 4.12-5, 4.12-6",
        |trial| moved(trial, TierChangeCause::LinkCongested),
    ),
    (
        23,
        "a client follows a full stream bit-exactly",
        "PROTOCOL 5.12-1, 6.10-1, 6.10-3, 6.10-4; RECKONING 1.6-1",
        |trial| {
            let mut interceptor =
                trial.interceptor(Setting::of("ball-pit", 30).with_task("subscribe full"))?;
            interceptor.enter()?;
            let mut count = 0;
            interceptor.filter_datagrams(move |bytes| {
                count += 1;
                if count % 6 == 5 { vec![] } else { vec![bytes] }
            });
            interceptor.step(60)?;
            interceptor.stop_tampering();
            interceptor.step(2)?;
            interceptor.must_follow()
        },
    ),
    (
        24,
        "a client follows a stream with a budget bit-exactly",
        "PROTOCOL 5.17-1, 5.17-2, 6.16-9, 6.16-10",
        |trial| {
            let task = "subscribe 1000 budget 2000";
            let mut interceptor = trial.interceptor(Setting::of("ball-pit", 60).with_task(task))?;
            interceptor.enter()?;
            let mut count = 0;
            interceptor.filter_datagrams(move |bytes| {
                count += 1;
                if count % 9 == 8 { vec![] } else { vec![bytes] }
            });
            interceptor.step(90)?;
            interceptor.stop_tampering();
            interceptor.step(2)?;
            interceptor.must_follow()
        },
    ),
];

/// Ticks per second, plus one.
const SECOND: u64 = 61;

/// Tampers with one track, so that one body of the client's copy is a metre too high.
fn tamper_one_track(interceptor: &mut Interceptor) -> Rc<RefCell<bool>> {
    let mut frames = Frames::new();
    let done = Rc::new(RefCell::new(false));
    let tampered = Rc::clone(&done);
    interceptor.tamper(move |delivery| {
        let Delivery::Control(bytes) = delivery else {
            return vec![delivery];
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
                }))) if !*tampered.borrow() && matches!(track.anchor, Anchor::Quantised(_)) => {
                    *tampered.borrow_mut() = true;
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

/// True if the client requested a snapshot because of a checksum mismatch.
fn has_reported_mismatch(interceptor: &Interceptor) -> bool {
    let resync = ClientMessage::Resync(ResyncCause::ChecksumMismatch);
    interceptor.messages.contains(&resync)
}

fn mismatch(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    let tampered = tamper_one_track(&mut interceptor);
    interceptor.enter_unjudged()?;
    interceptor.stop_tampering();
    // A checksum is due once the last one is a second old.
    for _ in 0..3 {
        interceptor.step_unjudged(SECOND)?;
        interceptor.run(Duration::from_millis(60) + trial.round_trips(3))?;
    }
    if !*tampered.borrow() {
        return Err(Stop::Inconclusive("no track could be altered".into()));
    }
    should(
        has_reported_mismatch(&interceptor),
        "it requests a new snapshot",
    )?;
    interceptor.must_end_alike()
}

fn no_mismatch(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 20).after(60))?;
    interceptor.enter()?;
    interceptor.step(2 * SECOND)?;
    interceptor.must_follow()?;
    ensure(
        !has_reported_mismatch(&interceptor),
        "it requests no new snapshot",
    )
}

fn checksums_complete_ticks(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    interceptor.enter()?;
    let checksum_packets = Rc::new(RefCell::new(0));
    let counted = Rc::clone(&checksum_packets);
    interceptor.filter_datagrams(move |bytes| {
        *counted.borrow_mut() += u32::from(datagram::kind(&bytes) == Some(PacketKind::Checksums));
        vec![bytes]
    });
    interceptor.step(2 * SECOND)?;
    interceptor.must_follow()?;
    if *checksum_packets.borrow() == 0 {
        return Err(Stop::Inconclusive("the server sent no checksums".into()));
    }
    Ok(())
}

/// Packets since the last repair symbol, with their numbers, from which a case makes repair symbols.
#[derive(Debug, Default)]
struct SentPackets {
    number: u64,
    packets: Vec<(u64, Vec<u8>)>,
}

/// Drops the first packets of a run and sends repair symbols of the run in their place; refreshes are dropped.
fn with_repair_symbols(
    interceptor: &mut Interceptor,
    lost: usize,
    disturb: fn(&mut RepairSymbol),
) -> Result<(), Stop> {
    let stream = interceptor.mirror()?.stream().stream();
    let next = interceptor.next_number();
    let mut sent = SentPackets {
        number: next,
        packets: Vec::new(),
    };
    interceptor.filter_datagrams(move |bytes| {
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
        // A packet without updates is not a source symbol: repair symbols never cover it.
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
                    disturb(&mut repair_symbol);
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
    let mut interceptor = trial.lossless_interceptor(busy())?;
    interceptor.enter()?;
    with_repair_symbols(&mut interceptor, lost, |_| {})?;
    interceptor.step_until_repair_symbol(60)?;
    // No refresh was delivered, so a complete copy proves that the packets were rebuilt.
    interceptor.must_follow()
}

fn wrong_repair_symbol(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    interceptor.enter()?;
    with_repair_symbols(&mut interceptor, 1, |repair_symbol| {
        // The first symbol covers the kind of the packet, so the rebuilt packet is malformed.
        if let Some(first) = repair_symbol.sums.first_mut() {
            *first ^= 0x40;
        }
    })?;
    interceptor.step(30)?;
    interceptor.stop_tampering();
    interceptor.step(3)?;
    interceptor.run(Duration::from_millis(300))?;
    interceptor.must_follow()
}

fn useless_repair_symbols(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 30))?;
    interceptor.enter()?;
    let stream = interceptor.mirror()?.stream().stream();
    let next = interceptor.next_number();
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
        interceptor
            .raw_server
            .send_datagram(&repair_symbol.encode(stream))?;
    }
    interceptor.step(40)?;
    interceptor.must_follow()
}

/// Of ten packets under one repair symbol two are lost. One of these comes only when the other is older than all
/// packets that a client keeps.
fn late_repair_symbol(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.interceptor(busy())?;
    interceptor.enter()?;
    let stream = interceptor.mirror()?.stream().stream();
    let mut number = interceptor.next_number();
    let mut sent: Vec<(u64, Vec<u8>)> = Vec::new();
    let (tried, is_tried) = (Rc::new(Cell::new(0)), 2);
    let noted = Rc::clone(&tried);
    interceptor.filter_datagrams(move |bytes| {
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
    interceptor.step(60)?;
    if tried.get() != is_tried {
        return Err(Stop::Inconclusive("the server sent too few packets".into()));
    }
    interceptor.stop_tampering();
    interceptor.step(3)?;
    interceptor.must_follow()
}

fn reports_loss(trial: &mut Trial<'_>) -> CaseResult {
    let mut interceptor = trial.lossless_interceptor(busy())?;
    interceptor.enter()?;
    with_repair_symbols(&mut interceptor, 1, |_| {})?;
    interceptor.step_until_repair_symbol(60)?;
    interceptor.run(Duration::from_millis(700))?;
    let abandoned = interceptor
        .loss_reports
        .iter()
        .map(|(_, loss_report): &(_, LossReport)| loss_report.abandoned.0)
        .max();
    should(
        abandoned >= Some(1),
        format!("it reports the packets lost on the link, not {abandoned:?}"),
    )?;
    interceptor.must_follow()
}

fn changes(trial: &mut Trial<'_>) -> CaseResult {
    let setting = Setting::of("ball-pit", 30).with_task("subscribe 10000 change 50000");
    let mut interceptor = trial.interceptor(setting)?;
    interceptor.change_mirror_to(within(50_000)?);
    interceptor.enter()?;
    interceptor.follow_unjudged(20)?;
    let follows = |interceptor: &mut Interceptor| {
        interceptor
            .reported
            .iter()
            .any(|reported| reported["is"] == "following")
    };
    // A scene that does not step sends nothing more.
    let (mut tries, mut stopped) = (0, Ok(()));
    interceptor.until("change to the new stream", |interceptor| {
        tries += 1;
        if tries % 10 == 0 {
            stopped = interceptor.step_unjudged(2);
        }
        stopped.is_err() || follows(interceptor)
    })?;
    stopped?;
    interceptor.must_end_alike()
}

fn within(micrometres: u32) -> Result<StreamChoice, Stop> {
    let length = LengthBound::from_micrometres(micrometres);
    let errs = |_| Stop::Inconclusive("error of the suite".into());
    length
        .map(|length| StreamChoice::Within(Tolerance::Surface(length)))
        .map_err(errs)
}

/// The server changes the tier of the client by a choice that the client did not make.
fn moved(trial: &mut Trial<'_>, cause: TierChangeCause) -> CaseResult {
    let mut interceptor = trial.interceptor(Setting::of("ball-pit", 30))?;
    interceptor.enter()?;
    interceptor.step(10)?;
    interceptor.must_follow()?;
    let to = within(50_000)?;
    let old = interceptor.mirror()?.stream().stream();
    let mut first = true;
    interceptor.tamper(move |delivery| match delivery {
        Delivery::Control(bytes) if std::mem::take(&mut first) => {
            let mut sent = Vec::new();
            ServerMessage::TierChanged { to, cause }.encode(&mut sent);
            sent.extend(bytes);
            vec![Delivery::Control(sent)]
        }
        // Packets lost on the link are not sent again.
        Delivery::State(bytes)
            if cause == TierChangeCause::LinkCongested
                && datagram::head(&bytes).is_some_and(|head| head.stream == old) =>
        {
            vec![]
        }
        delivery => vec![delivery],
    });
    interceptor.change_mirror_to(to);
    let mut bytes = Vec::new();
    ClientMessage::Subscribe(to).encode(&mut bytes);
    interceptor.speak_for_client(&bytes)?;
    interceptor.follow_unjudged(20)?;
    interceptor.must_end_alike()?;
    // On a link that loses, the message may come after the reports.
    interceptor.until("confirmation of the new stream", |interceptor| {
        interceptor
            .messages
            .iter()
            .any(|message| matches!(message, ClientMessage::Subscribed(stream) if *stream != old))
    })
}
