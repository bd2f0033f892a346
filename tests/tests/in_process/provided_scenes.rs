//! A provided scene begins when a client names it.
//!
//! Its script commands it as a member would. There is no network, and the script counts ticks.

use glam::Vec3;
use rhumb_protocol::message::{Denial, StreamChoice};
use rhumb_protocol::scene::{BodyDesc, BodyKind, Command, SceneConfig, Shape, ShapeId, Stepping};
use rhumb_protocol::session::Event;
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::{BodyId, BodyState};
use rhumb_scene::{ProvidedScene, ProvidedScenes, Scene, SceneScript};
use rhumb_tests::Table;

const BALL: ShapeId = ShapeId(0);
const FIRST: BodyId = BodyId::new(0, 0);
const LATER: BodyId = BodyId::new(1, 0);

fn add(id: BodyId, height: f32) -> Command {
    let still = [0.0; 3];
    let motion = BodyState::new([0.0, height, 0.0], [0.0, 0.0, 0.0, 1.0], still, still);
    Command::AddBody {
        desc: BodyDesc::plain(id, BodyKind::Dynamic, BALL),
        motion: motion.expect("a finite state"),
    }
}

/// Two balls, of which the second goes at tick 3 and comes back at tick 6; and a refused command at tick 4.
fn script() -> SceneScript {
    let shape = Shape::Ball { radius: 0.5 };
    SceneScript::new(
        move |scene: &Scene, out: &mut Vec<Command>| match scene.tick().value() {
            0 if scene.body(FIRST).is_none() => {
                let shape = shape.clone();
                out.extend([
                    Command::AddShape { id: BALL, shape },
                    add(FIRST, 5.0),
                    add(LATER, 9.0),
                ]);
            }
            3 => out.push(Command::RemoveBody { id: LATER }),
            4 => out.push(Command::RemoveBody { id: LATER }),
            6 => out.push(add(BodyId::new(1, 1), 9.0)),
            _ => {}
        },
    )
}

fn table() -> Table {
    Table::with_provided(ProvidedScenes::new(|name| {
        (name.as_str() == "shown").then(|| ProvidedScene {
            config: SceneConfig {
                stepping: Stepping::FreeRunning,
                ..SceneConfig::default()
            },
            script: script(),
        })
    }))
}

/// A client that has asked to join the scene of that name, and what is due since is done.
fn joining(name: &str) -> (Table, Peer) {
    let mut table = table();
    let peer = table.connect(name);
    table
        .session(peer)
        .join(StreamChoice::Full)
        .expect("the session is in the lobby");
    table.run_until_idle();
    (table, peer)
}

fn events(table: &mut Table, peer: Peer) -> Vec<Event> {
    let session = table.session(peer);
    std::iter::from_fn(|| session.poll_event()).collect()
}

#[test]
fn a_provided_scene_has_its_bodies_before_its_first_member_joins() {
    let (mut table, peer) = joining("shown");
    let session = table.session(peer);
    assert_eq!(
        session.config().map(|config| config.stepping),
        Some(Stepping::FreeRunning)
    );
    let replica = session.replica().expect("it has joined");
    assert!(replica.body(FIRST).is_some() && replica.body(LATER).is_some());
}

#[test]
fn its_script_adds_and_removes_bodies_and_a_refused_command_ends_nothing() {
    let (mut table, peer) = joining("shown");
    events(&mut table, peer);
    table.pass(Span::from_millis(200));
    let removed = events(&mut table, peer)
        .iter()
        .any(|event| matches!(event, Event::BodyRemoved { id, .. } if *id == LATER));
    assert!(removed);
    let replica = table.session(peer).replica().expect("a member");
    assert!(replica.body(BodyId::new(1, 1)).is_some() && replica.body(LATER).is_none());
}

/// True if the events since the last call say that a command was refused.
fn is_refused(table: &mut Table, peer: Peer) -> bool {
    let events = events(table, peer);
    events
        .iter()
        .any(|event| matches!(event, Event::Refused { .. }))
}

#[test]
fn members_get_ids_beside_those_of_the_script() {
    let (mut table, peer) = joining("shown");
    let joined = events(&mut table, peer)
        .into_iter()
        .find_map(|event| match event {
            Event::Joined(range) => Some(range),
            _ => None,
        });
    let range = joined.expect("a member has ids");
    assert!(range.first() >= 2, "{range:?}");
    let own = add(BodyId::new(range.first(), 0), 20.0);
    table.session(peer).command(own).expect("a member");
    table.pass(Span::from_millis(50));
    assert!(!is_refused(&mut table, peer));
    let impulse = Command::Impulse {
        id: FIRST,
        impulse: Vec3::Y,
    };
    table.session(peer).command(impulse).expect("a member");
    table.pass(Span::from_millis(50));
    assert!(!is_refused(&mut table, peer));
}

#[test]
fn other_names_are_no_scenes() {
    let (mut table, peer) = joining("hidden");
    let denied = events(&mut table, peer)
        .iter()
        .any(|event| matches!(event, Event::Denied(Denial::NoSuchScene)));
    assert!(denied);
}
