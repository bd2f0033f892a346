//! L5.2: every malformed datagram of the vectors, which nobody minds.
//!
//! What a source says is ballistic_torque_free at an upstream, what a listener says at the stream. Neither moves a body, is answered, or
//! ends a connection.

use glam::Vec3;
use rhumb_protocol::message::{
    ClientMessage, ResyncCause, SceneEvent, ServerMessage, TakeAuthority,
};
use rhumb_protocol::packet::{LossReport, Low16, PacketKind, StreamId};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Stepping};
use rhumb_reckoning::{Anchor, BodyId, BodyState, Tolerance};

use super::scenery::{BALL, NORMAL, ball_shape, body, lockstep, moving};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{CaseResult, Stop, ensure};
use crate::conformance::peer::{RawClient, datagram};
use crate::conformance::trial::Trial;
use crate::grammar::unhex;
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
        let case = case.needs(&[Feature::FreeRunning, Feature::AuthorityGrant]);
        Some(case.play(move |trial| dropped(trial, &bytes)))
    });
    cases.collect()
}

fn dropped(trial: &mut Trial<'_>, bytes: &[u8]) -> CaseResult {
    let mut guest = trial.guest()?;
    let config = SceneConfig {
        stepping: Stepping::FreeRunning,
        ..lockstep()
    };
    let joined = guest.enter(config, NORMAL)?;
    let id = body(guest.granted, 0)?;
    let upstream = take_authority(&mut guest, id)?;
    for stream in [joined.start.stream, upstream] {
        guest.throw(&datagram::of_stream(bytes, stream))?;
        guest.throw(bytes)?;
    }
    // A watermark is the answer to an loss_report that is well sent; so those before it were read.
    let loss_report = LossReport {
        next: Low16::of(joined.start.next),
        gone: Low16::of(0),
        repair_symbols: 0,
        lost: Vec::new(),
    };
    guest.throw(&loss_report.encode(joined.start.stream))?;
    loop {
        let datagram = guest.next_datagram()?;
        let datagram =
            datagram.ok_or_else(|| Stop::Fail("an loss_report is not answered".into()))?;
        match datagram::kind(&datagram) {
            Some(PacketKind::Refresh | PacketKind::RepairSymbol) => {
                return Stop::fail("it is answered");
            }
            Some(PacketKind::Watermark) => break,
            _ => {}
        }
    }
    let received = guest.barrier()?;
    ensure(
        received.is_empty(),
        format!("nothing is sent of it, not {received:?}"),
    )?;
    let bodies = again(&mut guest)?;
    ensure(
        bodies == [moving(PLACE, Vec3::ZERO)],
        format!("its body stands where it stood, not {bodies:?}"),
    )
}

const PLACE: Vec3 = Vec3::new(1.0, 2.0, 3.0);

/// AuthorityTable a kinematic body of one's own, and says nothing of it.
fn take_authority(guest: &mut RawClient, id: BodyId) -> Result<StreamId, Stop> {
    guest.must(ball_shape())?;
    guest.must(Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Kinematic, BALL),
        motion: moving(PLACE, Vec3::ZERO),
    })?;
    guest.say(&ClientMessage::TakeAuthority(TakeAuthority {
        tolerance: Tolerance::NORMAL,
        bodies: vec![id],
    }));
    guest.await_message("answer to drive", |message| match message {
        ServerMessage::AuthorityGrant(driving) => Some(Ok(driving.stream)),
        ServerMessage::AuthorityDenied(error) => Some(Stop::fail(format!("{error}"))),
        _ => None,
    })?
}

/// Where the bodies are, by a snapshot.
fn again(guest: &mut RawClient) -> Result<Vec<BodyState>, Stop> {
    guest.say(&ClientMessage::Resync(ResyncCause::LostSync));
    let (_, scene_events) = guest.snapshot()?;
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
