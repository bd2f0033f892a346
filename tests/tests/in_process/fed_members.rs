//! Members of fed scenes in virtual time: silent owners, refusals, sessions.

use glam::Vec3;
use rhumb_client::{BodyId, BodyState, Event, FedVelocities, StreamChoice, Tick, Tolerance};
use rhumb_protocol::message::{AuthorityError, Denial, QueryError, SessionKey};
use rhumb_protocol::scene::{
    BodyDesc, Command, CommandError, IdRange, Query, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::{ClientSession, Misuse};
use rhumb_protocol::stream::ErrorBound;
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::{Damping, Seconds};
use rhumb_scene::Feed;
use rhumb_tests::Table;
use rhumb_view::{RenderParams, RenderTime, View};

const NAME: &str = "fed";

/// A free-running fed scene in virtual time: its owner and a follower.
struct Fed {
    table: Table,
    feed: Feed,
    owner: Peer,
    follower: Peer,
    body: BodyId,
}

impl Fed {
    fn new() -> Self {
        let mut table = Table::default();
        // The table's first connection.
        let owner = Peer(0);
        let feed = table.feeds().open(&NAME.parse().expect("a name"), owner);
        let feed = feed.expect("no other feed");
        let config = SceneConfig {
            stepping: Stepping::FreeRunning,
            ..SceneConfig::default()
        };
        assert_eq!(
            table.create(NAME, config, StreamChoice::Within(Tolerance::NORMAL)),
            owner
        );
        let body = add(table.session(owner));
        table.run_until_idle();
        let follower = join(&mut table);
        Self {
            table,
            feed,
            owner,
            follower,
            body,
        }
    }

    fn feed(&mut self, tick: u64) {
        let x = tick as f32 / 60.0;
        let state = BodyState::new(
            [x, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [1.0, 0.0, 0.0],
            [0.0; 3],
        );
        let states = [(self.body, state.expect("finite"))];
        let commands = 2;
        (self.feed).push(Tick::new(tick), &states, FedVelocities::Given, commands);
        self.table.pass(Span::from_nanos(16_666_667));
    }

    fn bound(&mut self, peer: Peer, tick: u64) -> ErrorBound {
        let replica = self.table.session(peer).replica().expect("a member");
        replica
            .stream()
            .bound_at(self.body, Tick::new(tick))
            .expect("a body")
    }

    /// Shows the newest complete tick of the follower.
    fn look(&mut self, view: &mut View) {
        let session = self.table.session(self.follower);
        while session.poll_event().is_some() {}
        let replica = session.replica_mut().expect("a member");
        let stream = replica.stream_mut();
        let params = RenderParams {
            at: RenderTime::at(stream.complete()),
            now: Seconds::new(0.0),
            smooth: false,
            step: Seconds::new(1.0 / 60.0),
        };
        view.refresh(stream, &params);
    }

    /// The newest complete tick of a member.
    fn newest(&mut self, peer: Peer) -> u64 {
        let replica = self.table.session(peer).replica().expect("a member");
        replica.stream().complete().value()
    }

    fn events(&mut self, peer: Peer) -> Vec<Event> {
        let session = self.table.session(peer);
        std::iter::from_fn(|| session.poll_event()).collect()
    }
}

fn add(session: &mut ClientSession) -> BodyId {
    let granted: IdRange = std::iter::from_fn(|| session.poll_event())
        .find_map(|event| match event {
            Event::Joined(range) => Some(range),
            _ => None,
        })
        .expect("a member has ids");
    let id = BodyId::new(granted.first(), 0);
    let body = BodyDesc::dynamic(Shape::ball(0.5));
    let shape = ShapeId(0);
    let added = [
        Command::AddShape {
            id: shape,
            shape: body.shape().clone(),
        },
        Command::AddBody {
            desc: body.desc(id, shape),
            motion: body.state().expect("finite"),
        },
    ];
    for command in added {
        session.command(command).expect("a member");
    }
    id
}

fn join(table: &mut Table) -> Peer {
    let peer = table.connect(NAME);
    let session = table.session(peer);
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    session.join(choice).expect("the scene is there");
    table.run_until_idle();
    peer
}

#[test]
fn members_learn_of_a_silent_owner_and_have_no_bound_until_it_is_back() {
    let mut fed = Fed::new();
    for tick in 1..=30 {
        fed.feed(tick);
    }
    let (follower, body) = (fed.follower, fed.body);
    let newest = fed.newest(follower);
    assert!(newest > 10 && fed.bound(follower, newest).metres() <= 0.05);
    fed.events(follower);
    fed.table.pass(Span::from_millis(500));
    let silent = Event::PublisherSilent {
        id: body,
        since: Tick::new(31),
    };
    assert!(fed.events(follower).contains(&silent));
    assert!(fed.bound(follower, newest).metres() <= 0.05);
    assert_eq!(fed.bound(follower, 31).metres(), f64::INFINITY);
    // One that joins during the silence learns of it.
    let late = join(&mut fed.table);
    assert_eq!(fed.bound(late, 31).metres(), f64::INFINITY);
    fed.table.pass(Span::from_millis(3_000));
    let again = fed.events(follower);
    assert!(!again.contains(&silent), "once: {again:?}");
    for tick in 31..=100 {
        fed.feed(tick);
    }
    for peer in [follower, late] {
        let is_back = fed
            .events(peer)
            .into_iter()
            .any(|event| matches!(event, Event::PublisherActive { id, .. } if id == body));
        assert!(is_back);
    }
    let newest = fed.newest(follower);
    assert!(newest > 31 && fed.bound(follower, newest).metres() <= 0.05);
}

#[test]
fn a_query_for_contacts_is_refused() {
    let mut fed = Fed::new();
    fed.feed(1);
    let (follower, body) = (fed.follower, fed.body);
    fed.events(follower);
    let asked = fed
        .table
        .session(follower)
        .query(vec![Query::contacts(body)]);
    asked.expect("a member may");
    fed.table.run_until_idle();
    let answers = fed
        .events(follower)
        .into_iter()
        .find_map(|event| match event {
            Event::QueryResult(result) => Some(result.answers),
            _ => None,
        });
    assert_eq!(answers, Some(Err(QueryError::Unanswerable)));
}

#[test]
fn a_member_that_was_away_learns_of_the_refusal_of_its_request() {
    let mut fed = Fed::new();
    fed.feed(1);
    let away = fed.table.connect(NAME);
    let session = fed.table.session(away);
    session
        .begin_session(SessionKey([7; 16]))
        .expect("in the lobby");
    let choice = StreamChoice::Within(Tolerance::NORMAL);
    session.join(choice).expect("the scene is there");
    fed.table.run_until_idle();
    let gravity = Command::SetGravity {
        gravity: Vec3::ZERO,
    };
    let number = fed.table.session(away).command(gravity).expect("a member");
    fed.table.run_until_idle();
    let request = fed.feed.poll_request().expect("for the owner");
    fed.table.end_connection(away);
    fed.events(away);
    let error = CommandError::NotAllowed;
    fed.feed.refuse(request, error).expect("the first answer");
    fed.feed(2);
    let back = fed.table.reconnect(away);
    let events = fed.events(back);
    let refused = Event::Refused { number, error };
    assert_eq!(
        events.iter().filter(|event| **event == refused).count(),
        1,
        "{events:?}"
    );
}

#[test]
fn a_step_waits_for_the_commands_before_it() {
    let mut fed = Fed::new();
    let commands = 3;
    (fed.feed).push(Tick::new(1), &[], FedVelocities::Given, commands);
    fed.table.pass(Span::from_millis(200));
    assert!(!fed.feed.is_taken());
    let gravity = Vec3::ZERO;
    let session = fed.table.session(fed.owner);
    session
        .command(Command::SetGravity { gravity })
        .expect("a member");
    fed.table.run_until_idle();
    assert!(fed.feed.is_taken());
}

#[test]
fn members_take_no_authority_and_advance_nothing_in_a_fed_scene() {
    let mut fed = Fed::new();
    fed.feed(1);
    let (follower, body) = (fed.follower, fed.body);
    fed.events(follower);
    let session = fed.table.session(follower);
    let asked: Result<(), Misuse> = session.take_authority(Tolerance::FINE, &[body]);
    asked.expect("a member asks");
    fed.table.run_until_idle();
    let denied = fed.events(follower).into_iter().any(|event| {
        matches!(
            event,
            Event::AuthorityDenied(AuthorityError::NotKinematic(_) | AuthorityError::NotAllowed)
        )
    });
    assert!(denied);
    let now = fed.table.now();
    let session = fed.table.session(follower);
    session.advance(now, Tick::new(5)).expect("a member asks");
    fed.table.run_until_idle();
    assert!(
        fed.events(follower)
            .contains(&Event::Denied(Denial::NotLockstep))
    );
}

#[test]
fn an_owner_that_never_feeds_is_silent_and_so_are_bodies_that_it_adds() {
    let mut fed = Fed::new();
    fed.table.pass(Span::from_millis(400));
    let silent = |id| Event::PublisherSilent {
        id,
        since: Tick::new(1),
    };
    let (follower, first) = (fed.follower, fed.body);
    assert!(fed.events(follower).contains(&silent(first)));
    let second = BodyId::new(first.index() + 1, 0);
    let shape = ShapeId(0);
    let body = BodyDesc::dynamic(Shape::ball(0.5)).at(9.0, 9.0, 9.0);
    let added = fed.table.session(fed.owner).command(Command::AddBody {
        desc: body.desc(second, shape),
        motion: body.state().expect("finite"),
    });
    added.expect("a member");
    fed.table.pass(Span::from_millis(400));
    assert!(fed.events(follower).contains(&silent(second)));
    let replica = fed.table.session(follower).replica().expect("a member");
    let bound = replica.stream().bound_at(second, Tick::new(30));
    assert_eq!(bound.expect("a body").metres(), f64::INFINITY);
}

#[test]
fn many_bodies_that_an_owner_adds_come_before_its_next_states() {
    let mut fed = Fed::new();
    fed.table.pace(fed.owner);
    fed.feed(1);
    let body = BodyDesc::dynamic(Shape::ball(0.5));
    let added = 2_000;
    for place in 1..=added {
        let id = BodyId::new(fed.body.index() + place, 0);
        let added = fed.table.session(fed.owner).command(Command::AddBody {
            desc: body.desc(id, ShapeId(0)),
            motion: body.state().expect("finite"),
        });
        added.expect("a member");
    }
    let state = BodyState::new([1.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    let states: Vec<_> = (0..=added)
        .map(|place| BodyId::new(fed.body.index() + place, 0))
        .map(|id| (id, state.expect("finite")))
        .collect();
    let commands = 2 + u64::from(added);
    (fed.feed).push(Tick::new(2), &states, FedVelocities::Given, commands);
    // Well before its owner counts as silent.
    fed.table.pass(Span::from_millis(100));
    let follower = fed.follower;
    assert!(fed.newest(follower) >= 2);
    let is_silent = |event: &Event| matches!(event, Event::PublisherSilent { .. });
    assert!(!fed.events(follower).iter().any(is_silent));
    let replica = fed.table.session(follower).replica().expect("a member");
    let shown = replica.stream();
    let is_there = |(id, _): &(BodyId, BodyState)| shown.body(id.index()) == Some(*id);
    assert!(states.iter().all(is_there));
}

#[test]
fn a_body_that_is_removed_while_a_stream_gives_way_to_the_next_leaves_every_view() {
    for switches in [1, 2, 3] {
        let mut fed = Fed::new();
        let (owner, follower, first) = (fed.owner, fed.follower, fed.body);
        let second = BodyId::new(first.index() + 1, 0);
        let body = BodyDesc::dynamic(Shape::ball(0.5)).at(9.0, 9.0, 9.0);
        let mut desc = body.desc(second, ShapeId(0));
        // A damping of its own, whose table goes with the body.
        desc.damping = Some(Damping {
            linear: 0.1,
            angular: 0.2,
        });
        let motion = body.state().expect("finite");
        let added = fed.table.session(owner);
        let added = added.command(Command::AddBody { desc, motion });
        added.expect("a member");
        for tick in 1..=5 {
            fed.feed(tick);
        }
        let mut view = View::default();
        fed.look(&mut view);
        assert_eq!(view.ids(), [first, second]);
        let removed = fed.table.session(owner);
        let removed = removed.command(Command::RemoveBody { id: second });
        removed.expect("a member");
        let mut tick = 5;
        let tolerances = [Tolerance::FINE, Tolerance::EXACT, Tolerance::NORMAL];
        for tolerance in tolerances.into_iter().take(switches) {
            let session = fed.table.session(follower);
            let choice = StreamChoice::Within(tolerance);
            session.subscribe(choice).expect("a member");
            for _ in 0..3 {
                tick += 1;
                fed.feed(tick);
                fed.table.pass(Span::from_millis(150));
            }
        }
        fed.look(&mut view);
        assert_eq!(
            view.ids(),
            [first],
            "{switches} streams since the last view"
        );
    }
}
