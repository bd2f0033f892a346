//! Sessions of clients that went away.

use std::collections::BTreeSet;

use glam::Vec3;
use rhumb_netsim::LinkConfig;
use rhumb_protocol::limits::{GRANT, INDICES_MAX};
use rhumb_protocol::message::{Denial, SessionKey, StreamChoice};
use rhumb_protocol::scene::{Command, Query, SceneConfig, Stepping};
use rhumb_protocol::session::{CloseCode, Event};
use rhumb_protocol::{Ending, Peer, Span};
use rhumb_reckoning::Tolerance;
use rhumb_scene::Limits;
use rhumb_sims::by_name;
use rhumb_tests::{Stage, Table};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);

/// Each crashed client leaves a session that keeps its indices, for a client that may come back.
#[test]
fn clients_that_are_away_do_not_keep_others_out() {
    let script = by_name("free-fall", 1, 1).expect("an existing script");
    let mut stage = Stage::new(script, Stepping::Lockstep, NORMAL, LinkConfig::PERFECT, 1);
    for number in 0..INDICES_MAX / GRANT {
        let away = stage.connect();
        let key = SessionKey(u128::from(number).to_le_bytes());
        let session = stage.network.client_mut(away);
        session.begin_session(key).expect("it is in the lobby");
        stage.join(away, NORMAL);
        stage.network.sever(away, Ending::TimedOut);
        stage.tick();
    }
    let here = stage.enter(NORMAL);
    stage.tick();
    assert!(stage.copy(here).stream().is_converged());
}

/// The events of a session since the last call.
fn events(table: &mut Table, peer: Peer) -> Vec<Event> {
    let session = table.session(peer);
    std::iter::from_fn(|| session.poll_event()).collect()
}

/// A table with a scene of two places, and a member of it with a session and a command.
fn scene_of_two() -> (Table, Peer) {
    let limits = Limits {
        members_per_scene: 2,
        ..Limits::default()
    };
    let mut table = Table::with_limits(limits);
    let anna = table.connect("small");
    let session = table.session(anna);
    let config = SceneConfig::default();
    session.create(config).expect("it is in the lobby");
    session.begin_session(SessionKey([1; 16])).expect("also");
    session.join(NORMAL).expect("also");
    table.run_until_idle();
    let gravity = Command::SetGravity {
        gravity: Default::default(),
    };
    table.session(anna).command(gravity).expect("a member may");
    table.run_until_idle();
    (table, anna)
}

fn join(table: &mut Table) -> Peer {
    let peer = table.connect("small");
    table.session(peer).join(NORMAL).expect("in the lobby");
    table.run_until_idle();
    peer
}

#[test]
fn a_session_whose_place_is_taken_is_kept_until_there_is_one() {
    let (mut table, mut anna) = scene_of_two();
    join(&mut table);
    let own = anna;
    // Another client comes before the first one comes back.
    table.end_connection(own);
    let third = join(&mut table);
    events(&mut table, own);
    for _ in 0..3 {
        anna = table.reconnect(anna);
        let busy = Event::Ended(Ending::Closed(CloseCode::BUSY.0));
        assert_eq!(events(&mut table, anna), [busy]);
        table.pass(Span::from_millis(1_000));
    }
    table.end(third);
    anna = table.reconnect(anna);
    let events = events(&mut table, anna);
    let resumed = events.iter().find_map(|event| match event {
        Event::Resumed(state) => Some(state.commands),
        _ => None,
    });
    assert_eq!(resumed, Some(1), "{events:?}");
}

/// The number of a query, and those of the answers that have come.
fn ask(table: &mut Table, peer: Peer) -> (u64, Vec<u64>) {
    let ray = Query::ray(Vec3::ZERO, Vec3::Y);
    let asked = table.session(peer).query(vec![ray]).expect("a member may");
    table.run_until_idle();
    let answered = events(table, peer)
        .into_iter()
        .filter_map(|event| match event {
            Event::QueryResult(result) => Some(result.number),
            _ => None,
        });
    (asked, answered.collect())
}

/// An answer that the application has not read yet would be taken for that of a later question.
#[test]
fn no_two_queries_of_a_session_have_one_number() {
    let (mut table, mut anna) = scene_of_two();
    let mut numbers = BTreeSet::new();
    for _ in 0..3 {
        for _ in 0..2 {
            let (asked, answered) = ask(&mut table, anna);
            assert_eq!(answered, [asked]);
            assert!(numbers.insert(asked), "{asked} was given before");
        }
        table.end_connection(anna);
        anna = table.reconnect(anna);
    }
}

#[test]
fn a_session_of_a_scene_that_is_gone_ends() {
    let (mut table, mut anna) = scene_of_two();
    let other = join(&mut table);
    table.end_connection(anna);
    table.session(other).delete().expect("a member may");
    table.run_until_idle();
    events(&mut table, anna);
    anna = table.reconnect(anna);
    let done = Event::Ended(Ending::Closed(CloseCode::DONE.0));
    let denied = Event::Denied(Denial::NoSuchScene);
    assert_eq!(events(&mut table, anna), [denied, done]);
}
