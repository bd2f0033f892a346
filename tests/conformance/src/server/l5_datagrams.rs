//! L5.2: every malformed datagram of the vectors is ignored.
//!
//! Publisher packets are sent for an upstream, subscriber packets for the stream. None moves a body, is answered, or
//! ends a connection.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, ResyncCause, SceneEvent, ServerMessage, TakeAuthority,
};
use rhumb_protocol::packet::{LargestPacket, LossReport, Low16, PacketKind, StreamId};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Stepping};
use rhumb_reckoning::{Anchor, BodyId, BodyState, Tolerance};

use super::scenery::{BALL, NORMAL, ball_shape, body, lockstep, moving};
use crate::case::Case;
use crate::feature::Feature;
use crate::grammar::unhex;
use crate::outcome::{CaseResult, Stop, ensure};
use crate::peer::{RawClient, datagram};
use crate::trial::Trial;
use crate::vectors::golden;

pub(super) fn cases() -> Vec<Case> {
    let table = golden("packets.json");
    let refused = table["refused"].as_array().expect("a section is a list");
    let mut seen = std::collections::BTreeSet::new();
    let cases = refused.iter().filter_map(|line| {
        let bytes = unhex(line["bytes"].as_str().unwrap_or_default());
        if !seen.insert(bytes.clone()) {
            return None;
        }
        let name = line["name"].as_str().unwrap_or_default();
        let case = Case::server("L5.2", &format!("malformed and dropped: {name}"));
        let case = case.keyed(&bytes).cites("PROTOCOL 2.5-4, 6.14-6");
        let case = case.needs(&[Feature::FreeRunning, Feature::Authority]);
        Some(case.play(move |trial| dropped(trial, &bytes)))
    });
    cases.collect()
}

fn dropped(trial: &mut Trial<'_>, bytes: &[u8]) -> CaseResult {
    let mut client = trial.client()?;
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..lockstep()
    };
    let joined = client.enter(config, NORMAL)?;
    let id = body(client.granted, 0)?;
    let upstream = take_authority(&mut client, id)?;
    for stream in [joined.start.stream, upstream] {
        client.send_datagram(&datagram::of_stream(bytes, stream))?;
        client.send_datagram(bytes)?;
    }
    // The loss report is well-formed, so its answer proves that all datagrams before it were processed.
    let loss_report = LossReport {
        next: Low16::of(joined.start.next),
        abandoned: Low16::of(0),
        repair_symbols: 0,
        lost: Vec::new(),
    };
    client.send_datagram(&loss_report.encode(joined.start.stream))?;
    loop {
        let datagram = client.next_datagram()?;
        let datagram =
            datagram.ok_or_else(|| Stop::Fail("a loss report is not answered".into()))?;
        match datagram::kind(&datagram) {
            Some(PacketKind::Refresh | PacketKind::RepairSymbol) => {
                return Stop::fail("a malformed datagram is answered");
            }
            Some(PacketKind::Watermark) => break,
            _ => {}
        }
    }
    let received = client.barrier()?;
    ensure(
        received.is_empty(),
        format!("no answer is sent, not {received:?}"),
    )?;
    let bodies = again(&mut client)?;
    ensure(
        bodies == [moving(PLACE, Vec3::ZERO)],
        format!("its body has not moved, not {bodies:?}"),
    )
}

const PLACE: Vec3 = Vec3::new(1.0, 2.0, 3.0);

/// Takes authority over a new kinematic body, and sends no packet for it.
fn take_authority(client: &mut RawClient, id: BodyId) -> Result<StreamId, Stop> {
    client.must(ball_shape())?;
    client.must(Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Kinematic, BALL),
        motion: moving(PLACE, Vec3::ZERO),
    })?;
    client.send(&ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: Tolerance::NORMAL,
        largest_packet: LargestPacket::DEFAULT,
        bodies: vec![id],
    }));
    client.await_message(
        "answer to the request for authority",
        |message| match message {
            ServerMessage::AuthorityGrant(grant) => Some(Ok(grant.stream)),
            ServerMessage::AuthorityDenied(error) => Some(Stop::fail(format!("{error}"))),
            _ => None,
        },
    )?
}

/// The states of all bodies, from a new snapshot.
fn again(client: &mut RawClient) -> Result<Vec<BodyState>, Stop> {
    client.send(&ClientMessage::Resync(ResyncCause::LostSync));
    let (_, scene_events) = client.snapshot()?;
    let tracks = scene_events
        .into_iter()
        .filter_map(|scene_event| match scene_event {
            SceneEvent::BodyPlaced { track, .. } => match track.anchor {
                Anchor::Exact(motion) => Some(motion),
                Anchor::Quantised(_) => None,
            },
            _ => None,
        });
    Ok(tracks.collect())
}
