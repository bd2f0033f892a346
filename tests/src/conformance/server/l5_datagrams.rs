//! L5.2: every malformed datagram of the vectors, which nobody minds.
//!
//! What a source says is thrown at an upstream, what a listener says at the stream. Neither moves a body, is answered, or
//! ends a connection.

use glam::Vec3;
use rhumb_protocol::message::{ClientMessage, Drive, Notice, ServerMessage};
use rhumb_protocol::packet::{Echo, Kind, Low16, StreamId};
use rhumb_protocol::scene::{BodyKind, BodyTerms, Command, Pace, SceneTerms};
use rhumb_reckoning::{Anchor, BodyId, Tolerance, Verbatim};

use super::scenery::{BALL, NORMAL, ball_shape, body, lockstep, moving};
use crate::conformance::case::{Case, Feature};
use crate::conformance::outcome::{Play, Stop, ensure};
use crate::conformance::peer::{Guest, datagram};
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
        let case = case.needs(&[Feature::FreeRunning, Feature::Driving]);
        Some(case.play(move |trial| dropped(trial, &bytes)))
    });
    cases.collect()
}

fn dropped(trial: &mut Trial<'_>, bytes: &[u8]) -> Play {
    let mut guest = trial.guest()?;
    let terms = SceneTerms {
        pace: Pace::FreeRunning,
        ..lockstep()
    };
    let joined = guest.enter(terms, NORMAL)?;
    let id = body(guest.granted, 0)?;
    let upstream = drive(&mut guest, id)?;
    for stream in [joined.start.stream, upstream] {
        guest.throw(&datagram::of_stream(bytes, stream))?;
        guest.throw(bytes)?;
    }
    // A vouch is the answer to an echo that is well said; so those before it were read.
    let echo = Echo {
        next: Low16::of(joined.start.next),
        gone: Low16::of(0),
        parities: 0,
        lost: Vec::new(),
    };
    guest.throw(&echo.encode(joined.start.stream))?;
    loop {
        let datagram = guest.next_datagram()?;
        let datagram = datagram.ok_or_else(|| Stop::Fail("an echo is not answered".into()))?;
        match datagram::kind(&datagram) {
            Some(Kind::Repair | Kind::Parity) => return Stop::fail("it is answered"),
            Some(Kind::Vouch) => break,
            _ => {}
        }
    }
    let heard = guest.barrier()?;
    ensure(
        heard.is_empty(),
        format!("nothing is said of it, not {heard:?}"),
    )?;
    let bodies = again(&mut guest)?;
    ensure(
        bodies == [moving(PLACE, Vec3::ZERO)],
        format!("its body stands where it stood, not {bodies:?}"),
    )
}

const PLACE: Vec3 = Vec3::new(1.0, 2.0, 3.0);

/// Drives a kinematic body of one's own, and says nothing of it.
fn drive(guest: &mut Guest, id: BodyId) -> Result<StreamId, Stop> {
    guest.must(ball_shape())?;
    guest.must(Command::AddBody {
        terms: BodyTerms::plain(id, BodyKind::Kinematic, BALL),
        motion: moving(PLACE, Vec3::ZERO),
    })?;
    guest.say(&ClientMessage::Drive(Drive {
        tolerance: Tolerance::NORMAL,
        bodies: vec![id],
    }));
    guest.await_message("answer to drive", |message| match message {
        ServerMessage::Driving(driving) => Some(Ok(driving.stream)),
        ServerMessage::NotDriving(error) => Some(Stop::fail(format!("{error}"))),
        _ => None,
    })?
}

/// Where the bodies are, by a snapshot.
fn again(guest: &mut Guest) -> Result<Vec<Verbatim>, Stop> {
    guest.say(&ClientMessage::Resync);
    let (_, notices) = guest.snapshot()?;
    let tracks = notices.into_iter().filter_map(|notice| match notice {
        Notice::BodyPlaced { track, .. } => match track.anchor {
            Anchor::Verbatim(motion) => Some(motion),
            Anchor::Snapped(_) => None,
        },
        _ => None,
    });
    Ok(tracks.collect())
}
