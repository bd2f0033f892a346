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

/// Bodies and tick of the scene, as another member learns them.
fn inspect(links: &mut Links) -> (u32, u64) {
    links.send(OTHER, &[ClientMessage::Inspect]);
    links.take(OTHER, usize::MAX);
    let inspected = links.counts(OTHER).inspected;
    let (tick, bodies) = inspected.expect("an answer");
    (bodies, tick.value())
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
    let mut bodies = Vec::new();
    for _ in 0..3 {
        links.take(ADDER, usize::MAX);
        bodies.push(inspect(&mut links).0);
        links.pass(TICK);
    }
    assert_eq!(bodies, [512, 1_536, 3_000]);
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
    let (_, tick) = inspect(&mut links);
    let impulse = ClientMessage::Command(Command::Impulse {
        id: BodyId::new(0, 0),
        impulse: Vec3::Y,
    });
    links.send(ADDER, &vec![impulse; 20_000]);
    // A tick takes 60 ms or more of that clock, and its period is 17 ms.
    for _ in 0..3 {
        links.pass(TICK);
        links.take(ADDER, usize::MAX);
    }
    assert_eq!(links.unsent(ADDER), 0, "all commands were handled");
    assert_eq!(inspect(&mut links).1, tick, "and no step was taken");
    links.pass(Span::from_millis(200));
    assert!(inspect(&mut links).1 > tick, "they have no more time");
}
