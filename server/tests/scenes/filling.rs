//! Commands beside the steps of a scene that runs by the clock.
//!
//! Proved on a router of scenes without sockets, whose driver reports what the links take. The time of a tick is that of a
//! clock that advances each time it is read.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3;
use rhumb_protocol::message::ClientMessage;
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, Shape, ShapeId, Stepping};
use rhumb_protocol::{Instant, Peer, Span};
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_scene::SceneSettings;

use crate::links::{Links, join};

const ADDER: Peer = Peer(1);
const OTHER: Peer = Peer(2);
const TICK: Span = Span::from_millis(17);

fn shape() -> ClientMessage {
    let (id, shape) = (ShapeId(0), Shape::ball(0.5));
    ClientMessage::Command(Command::AddShape { id, shape })
}

fn body(index: u32) -> ClientMessage {
    let at = [index as f32 * 2.0, 0.0, 0.0];
    let motion = BodyState::new(at, [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    ClientMessage::Command(Command::AddBody {
        desc: BodyDesc::plain(BodyId::new(index, 0), BodyKind::Dynamic, ShapeId(0)),
        motion: motion.expect("finite"),
    })
}

/// Bodies of the scene, as another member learns them at once.
fn bodies(links: &mut Links) -> u32 {
    links.send(OTHER, &[ClientMessage::Inspect]);
    links.take(OTHER, usize::MAX);
    links.counts(OTHER).inspected.expect("an answer").1
}

#[test]
fn bodies_are_spread_over_steps_and_others_do_not_wait() {
    let mut links = Links::new();
    links.begin(ADDER, Stepping::FreeRunning);
    links.connect(OTHER);
    links.send(OTHER, &[join()]);
    links.send(ADDER, &[shape()]);
    let commands: Vec<_> = (0..3_000).map(body).collect();
    links.send(ADDER, &commands);
    let mut seen = Vec::new();
    for _ in 0..3 {
        links.take(ADDER, usize::MAX);
        seen.push(bodies(&mut links));
        links.pass(TICK);
    }
    assert_eq!(seen, [512, 1_536, 3_000]);
    assert_eq!(links.counts(ADDER).refused, None);
}

#[test]
fn commands_of_a_late_scene_have_as_much_time_as_its_ticks() {
    let clock = Arc::new(AtomicU64::new(0));
    let read = Arc::clone(&clock);
    let settings = SceneSettings::new(move || {
        Instant::from_nanos(read.fetch_add(10_000_000, Ordering::Relaxed))
    });
    let mut links = Links::with(settings);
    links.begin(ADDER, Stepping::FreeRunning);
    links.connect(OTHER);
    links.send(OTHER, &[join()]);
    links.send(ADDER, &[shape(), body(0)]);
    links.pass(TICK);
    // The messages of others may have had the time up to the next call for ticks.
    let tick = |links: &mut Links| {
        links.send(OTHER, &[ClientMessage::Inspect]);
        links.pass(Span::ZERO);
        links.take(OTHER, usize::MAX);
        links.counts(OTHER).inspected.expect("an answer").0
    };
    let before = tick(&mut links);
    let impulse = ClientMessage::Command(Command::Impulse {
        id: BodyId::new(0, 0),
        impulse: Vec3::Y,
    });
    links.send(ADDER, &vec![impulse; 2_000]);
    // A tick takes 60 ms or more of that clock, and its period is 17 ms.
    for _ in 0..3 {
        links.pass(TICK);
        links.take(ADDER, usize::MAX);
    }
    assert_eq!(links.unsent(ADDER), 0, "all commands were handled");
    assert_eq!(tick(&mut links), before, "and no step was taken");
    links.pass(Span::from_millis(200));
    assert!(tick(&mut links) > before, "they have no more time");
}
