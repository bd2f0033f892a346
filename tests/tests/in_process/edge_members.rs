//! Crowds at edges, members behind a fan-out, and publishers whose edge ends.
//!
//! A crowd speaks to an edge without a network: what counts is which connections the edge asks its driver for. All else
//! runs in virtual time.

use std::collections::BTreeSet;
use std::sync::Arc;

use rhumb_edge::{Edge, EdgeSettings, MIRRORS_MAX};
use rhumb_netsim::LinkConfig;
use rhumb_protocol::message::{
    AuthorityError, Extensions, Role, ServerMessage, SessionKey, StreamChoice, VERSIONS, Welcome,
};
use rhumb_protocol::scene::{Command, CommandError, Stepping};
use rhumb_protocol::session::{ClientSession, CloseCode};
use rhumb_protocol::{Ending, Endpoint, Instant, Peer, Span, Transmit};
use rhumb_reckoning::{BodyId, Divergence, Tick, Ticks, Tolerance, ToleranceScale};
use rhumb_scene::{Limits, Permit};
use rhumb_sims::by_name;
use rhumb_tests::{Avatars, EdgeStage, Place, TICK, assert_same_copy};

const NORMAL: StreamChoice = StreamChoice::Within(Tolerance::NORMAL);
/// The tolerance of an upstream.
const CLOSE: Tolerance = Tolerance::FINE;

/// Of the tokens of its observers.
const TOKEN_LIFE: Span = Span::from_millis(42_000);

/// An edge of observers, and the connections that it has to its owner.
struct Crowded {
    edge: Edge,
    now: Instant,
    links: BTreeSet<Peer>,
    most_links: usize,
    refused: usize,
}

impl Crowded {
    fn new() -> Self {
        Self::with(Permit {
            role: Role::Observer,
            ..Permit::OPEN
        })
    }

    fn with(permit: Permit) -> Self {
        Self {
            edge: Edge::new(EdgeSettings {
                limits: Limits::default(),
                token: None,
                permit: Arc::new(permit),
                asks_tokens: false,
                token_life: |_| Some(TOKEN_LIFE),
            }),
            now: Instant::ZERO,
            links: BTreeSet::new(),
            most_links: 0,
            refused: 0,
        }
    }

    /// A client comes and names a scene of its own.
    fn enter(&mut self, number: u64) {
        let name = format!("crowd/{number}");
        let mut session = ClientSession::new(name.parse().expect("a valid scene name"));
        self.admit(number, &mut session);
    }

    fn admit(&mut self, number: u64, session: &mut ClientSession) {
        session.handle_opened(self.now, Peer(0));
        self.edge.handle_opened(self.now, Peer(number));
        while let Some(transmit) = session.poll_transmit() {
            if let Transmit::Control { bytes, .. } = transmit {
                self.edge.handle_control(self.now, Peer(number), &bytes);
            }
        }
        self.drive();
    }

    fn leave(&mut self, number: u64) {
        let left = Ending::Closed(CloseCode::DONE.0);
        self.edge.handle_ended(self.now, Peer(number), left);
        self.drive();
    }

    /// The owner is there, and silent.
    fn drive(&mut self) {
        while let Some(dial) = self.edge.poll_dial() {
            self.links.insert(dial.link);
            self.edge.owner().handle_opened(self.now, dial.link);
        }
        while let Some(transmit) = self.edge.owner().poll_transmit() {
            if let Transmit::Close { to, .. } = transmit {
                self.links.remove(&to);
                let ending = Ending::Closed(CloseCode::DONE.0);
                self.edge.owner().handle_ended(self.now, to, ending);
            }
        }
        self.most_links = self.most_links.max(self.links.len());
        while let Some(transmit) = self.edge.poll_transmit() {
            if let Transmit::Close { code, .. } = transmit {
                assert_eq!(code, CloseCode::BUSY.0);
                self.refused += 1;
            }
        }
        self.now = self.now + Span::from_millis(1);
    }
}

#[test]
fn clients_that_name_many_scenes_have_few_connections_opened() {
    let mut crowd = Crowded::new();
    let clients = 3 * MIRRORS_MAX as u64;
    for number in 0..clients {
        crowd.enter(number);
    }
    assert_eq!(crowd.links.len(), MIRRORS_MAX);
    assert_eq!(crowd.refused, 2 * MIRRORS_MAX);
    for number in 0..clients {
        crowd.leave(number);
    }
    crowd.enter(clients);
    assert_eq!(crowd.refused, 2 * MIRRORS_MAX, "there is room again");
    assert_eq!(crowd.most_links, MIRRORS_MAX);
}

#[test]
fn clients_that_come_and_go_leave_few_connections_behind() {
    let mut crowd = Crowded::new();
    for number in 0..3 * MIRRORS_MAX as u64 {
        crowd.enter(number);
        crowd.leave(number);
    }
    assert_eq!(crowd.refused, 0);
    assert_eq!(crowd.most_links, MIRRORS_MAX);
}

/// The codes with which an edge closes its clients now.
fn closed(edge: &mut Edge, now: Instant) -> Vec<u32> {
    edge.handle_timeout(now);
    let sent = std::iter::from_fn(|| edge.poll_transmit());
    let codes = sent.filter_map(|transmit| match transmit {
        Transmit::Close { code, .. } => Some(code),
        _ => None,
    });
    codes.collect()
}

#[test]
fn a_client_that_says_no_hello_is_closed() {
    let mut crowd = Crowded::new();
    let silent = Peer(1);
    crowd.edge.handle_opened(crowd.now, silent);
    let mut session = ClientSession::new("crowd/1".parse().expect("a valid scene name"));
    session.handle_opened(crowd.now, Peer(0));
    let sent = std::iter::from_fn(|| session.poll_transmit());
    let hello = sent.filter_map(|transmit| match transmit {
        Transmit::Control { bytes, .. } => Some(bytes),
        _ => None,
    });
    let begun = hello.collect::<Vec<_>>().concat();
    crowd.edge.handle_control(crowd.now, silent, &begun[..1]);
    let late = crowd.now + Span::from_millis(1_000 * Limits::default().hello_seconds);
    let at = crowd.edge.poll_timeout().map(|wake| wake.at);
    assert_eq!(at, Some(late));
    assert!(closed(&mut crowd.edge, crowd.now).is_empty());
    assert_eq!(closed(&mut crowd.edge, late), [CloseCode::HELLO_LATE.0]);
    crowd.enter(2);
    let later = late + Span::from_millis(60_000);
    assert!(
        closed(&mut crowd.edge, later).is_empty(),
        "it has said its own"
    );
}

#[test]
fn an_observer_is_closed_when_its_token_ends() {
    let mut crowd = Crowded::with(Permit::OPEN);
    let mut session = ClientSession::new("crowd/1".parse().expect("a valid scene name"));
    session.set_token("v4.public.any".parse().expect("printable"));
    crowd.admit(1, &mut session);
    let link = crowd.links.first().copied().expect("the owner is asked");
    let mut extensions = Extensions::NONE;
    assert!(extensions.insert(Role::Observer.extension()));
    let mut welcome = Vec::new();
    ServerMessage::Welcome(Welcome {
        version: VERSIONS[0],
        scene: None,
        extensions,
    })
    .encode(&mut welcome);
    let now = crowd.now;
    crowd.edge.owner().handle_control(now, link, &welcome);
    crowd.drive();
    assert!(
        crowd.links.is_empty(),
        "an observer no longer needs the owner"
    );
    let before = now + Span::from_millis(40_000);
    assert!(closed(&mut crowd.edge, before).is_empty());
    let ended = now + TOKEN_LIFE;
    assert_eq!(closed(&mut crowd.edge, ended), [CloseCode::TOKEN_EXPIRED.0]);
}

/// A commander and an observer of an edge whose packets come by a fan-out, and a member of the owner.
fn fanned_out(stepping: Stepping, loss: usize, seed: u64) -> (EdgeStage, usize, usize) {
    let links: LinkConfig = "rtt=20ms".parse().expect("a valid link configuration");
    let script = by_name("ball-pit", 60, 1).expect("an existing script");
    let mut stage = EdgeStage::new(script, stepping, 1, links, seed);
    stage.fan_out_loss = loss;
    let behind = [(); 2].map(|()| stage.add_edge_behind(0, Permit::OPEN, links));
    stage.commander(Place::Edge(behind[0]), NORMAL, Some(SessionKey([4; 16])));
    let observer = stage.enter(Place::Edge(behind[1]), NORMAL);
    let direct = stage.enter(Place::Owner, NORMAL);
    (stage, observer, direct)
}

#[test]
fn members_behind_a_fan_out_have_the_server_s_copy_to_the_bit() {
    let (mut stage, observer, direct) = fanned_out(Stepping::Lockstep, 0, 1);
    for _ in 0..200 {
        stage.tick();
        assert_same_copy(stage.copy(direct), stage.copy(observer));
        assert_same_copy(stage.copy(direct), stage.copy(0));
    }
}

#[test]
fn whatever_a_fan_out_drops_every_claim_holds_and_all_converge() {
    for (seed, loss) in [(1, 5), (2, 20), (3, 90)] {
        let (mut stage, observer, direct) = fanned_out(Stepping::FreeRunning, loss, seed);
        stage.run_script(Span::from_millis(3_000));
        // A router that is gone for good.
        stage.fan_out_loss = 100;
        stage.run_script(Span::from_millis(2_000));
        stage.fan_out_loss = 0;
        stage.run(Span::from_millis(6_000));
        let newest = stage.copy(direct).stream().complete();
        for member in [0, observer] {
            let stream = stage.copy(member).stream();
            assert!(stream.is_converged(), "{loss} %, member {member}");
            let behind = newest.value() - stream.complete().value();
            assert!(behind < 60, "{loss} %, member {member}: {behind} ticks");
        }
        let truth = stage.truth();
        for (member, history) in stage.histories.iter().enumerate() {
            history.judge(&truth, &format!("{loss} %, member {member}"));
        }
    }
}

/// A commander of the owner, and an observer of an edge behind another edge. Neither edge has a connection of its own for
/// the observer.
fn behind_two(stepping: Stepping, commander: StreamChoice, seed: u64) -> (EdgeStage, usize) {
    let links: LinkConfig = "rtt=20ms".parse().expect("a valid link configuration");
    let script = by_name("ball-pit", 60, 1).expect("an existing script");
    let observers = Permit {
        role: Role::Observer,
        ..Permit::OPEN
    };
    let mut stage = EdgeStage::new(script, stepping, 0, links, seed);
    let first = stage.add_edge(observers.clone(), links);
    let second = stage.add_edge_behind(first, observers, links);
    stage.commander(Place::Owner, commander, None);
    let observer = stage.enter(Place::Edge(second), NORMAL);
    (stage, observer)
}

/// If no member of the owner receives the observer's stream, it has another name when the first edge comes back.
#[test]
fn an_observer_behind_two_edges_stays_when_the_first_one_comes_back_to_the_owner() {
    for (seed, commander) in [(1, NORMAL), (2, StreamChoice::Within(CLOSE))] {
        let (mut stage, observer) = behind_two(Stepping::FreeRunning, commander, seed);
        for cut in 0..3 {
            stage.run_script(Span::from_millis(500));
            stage.cut_off(0);
            stage.run(Span::from_millis(3_000));
            let newest = stage.copy(0).stream().complete();
            let stream = stage.copy(observer).stream();
            assert!(stream.is_converged(), "seed {seed}, cut {cut}");
            let behind = newest.value() - stream.complete().value();
            assert!(behind < 60, "seed {seed}, cut {cut}: {behind} ticks");
        }
        stage.run_script(Span::from_millis(500));
        let truth = stage.truth();
        for (member, history) in stage.histories.iter().enumerate() {
            history.judge(&truth, &format!("seed {seed}, member {member}"));
        }
    }
}

#[test]
fn an_observer_behind_two_edges_has_the_server_s_copy_to_the_bit_again() {
    let (mut stage, observer) = behind_two(Stepping::Lockstep, NORMAL, 1);
    for _ in 0..3 {
        for _ in 0..20 {
            stage.tick();
            assert_same_copy(stage.copy(0), stage.copy(observer));
        }
        stage.cut_off(0);
    }
}

#[test]
fn a_session_goes_on_through_two_edges_when_the_first_one_comes_back_to_the_owner() {
    for seed in 1..=4 {
        let links: LinkConfig = "rtt=20ms".parse().expect("a valid link configuration");
        let script = by_name("ball-pit", 60, 1).expect("an existing script");
        let mut stage = EdgeStage::new(script, Stepping::FreeRunning, 1, links, seed);
        let second = stage.add_edge_behind(0, Permit::OPEN, links);
        stage.commander(Place::Edge(second), NORMAL, Some(SessionKey([4; 16])));
        for _ in 0..3 {
            stage.run_script(Span::from_millis(500));
            stage.cut_off(0);
            // Commands that are sent meanwhile go over the next connection.
            stage.run_script(Span::from_millis(100 * seed));
            stage.resume(0, Place::Edge(second));
            stage.run_script(Span::from_millis(1_000));
        }
        stage.run_until("a copy", |stage| stage.copy(0).stream().is_converged());
        let truth = stage.truth();
        stage.histories[0].judge(&truth, &format!("seed {seed}"));
    }
}

/// An avatar that a member of an edge publishes, and the member of the owner that sees the server's states.
struct Published {
    stage: EdgeStage,
    watcher: usize,
}

impl Published {
    const AVATAR: BodyId = Avatars::id(0);

    fn new(seed: u64) -> Self {
        let (script, links) = (Box::new(Avatars(1)), LinkConfig::PERFECT);
        let mut stage = EdgeStage::new(script, Stepping::FreeRunning, 2, links, seed);
        stage.commander(Place::Edge(0), NORMAL, Some(SessionKey([3; 16])));
        stage.command();
        let watcher = stage.enter(Place::Owner, StreamChoice::Full);
        let mut published = Self { stage, watcher };
        assert_eq!(published.take(0), Ok(vec![Self::AVATAR]));
        published
    }

    fn take(&mut self, member: usize) -> Result<Vec<BodyId>, AuthorityError> {
        let before = self.stage.histories[member].authority_answers.len();
        let asked = self.stage.session(member);
        let asked = asked.take_authority(CLOSE, &[Self::AVATAR]);
        asked.expect("a member may ask");
        self.stage.run_until("an answer", |stage| {
            stage.histories[member].authority_answers.len() > before
        });
        self.stage.histories[member].authority_answers[before].clone()
    }

    fn newest(&self) -> Tick {
        self.stage.copy(self.watcher).stream().complete()
    }

    /// Publishes two ticks ahead for so many ticks; returns how many the session took.
    fn walk(&mut self, ticks: u32) -> u32 {
        let mut taken = 0;
        for _ in 0..ticks {
            let tick = self.newest() + Ticks::new(2);
            let state = Avatars::walk(0, tick);
            let session = self.stage.session(0);
            let published = session.publish(tick, &[(Self::AVATAR, state)]);
            taken += u32::from(published.expect("its session continues"));
            self.stage.run(TICK);
        }
        taken
    }

    /// Distance of the server's state from the published one, in tolerances of the upstream.
    fn off(&self) -> f64 {
        let newest = self.newest();
        let stream = self.stage.copy(self.watcher).stream();
        let had = stream.predicted_motion(Self::AVATAR, newest);
        let walked = Avatars::walk(0, newest);
        let apart = Divergence::between(&walked.motion().pose(), &had.expect("a body").pose());
        let tolerance = CLOSE.scaled(ToleranceScale::AVATAR);
        tolerance.share(&apart, rhumb_reckoning::Metres::new(0.8))
    }
}

/// Its session is unknown at the edge to which it comes, and holds nothing that could be lost.
#[test]
fn an_observer_goes_on_at_another_edge_when_its_edge_is_killed() {
    let script = by_name("ball-pit", 60, 1).expect("an existing script");
    let links = LinkConfig::PERFECT;
    let mut stage = EdgeStage::new(script, Stepping::FreeRunning, 0, links, 1);
    let observers = Permit {
        role: Role::Observer,
        ..Permit::OPEN
    };
    let [first, second] = [(); 2].map(|()| stage.add_edge(observers.clone(), links));
    stage.commander(Place::Owner, NORMAL, None);
    let observer = stage.connect(Place::Edge(first));
    let begun = stage.session(observer).begin_session(SessionKey([6; 16]));
    begun.expect("it is in the lobby");
    stage.join(observer, NORMAL);
    let gravity = Command::SetGravity {
        gravity: glam::Vec3::X,
    };
    for (at, next) in [(first, second), (second, first)] {
        let sent = stage.session(observer).command(gravity.clone());
        let number = sent.expect("a member");
        stage.run_script(Span::from_millis(1_000));
        let refused = stage.histories[observer].refused.last();
        assert_eq!(refused, Some(&(number, CommandError::NotAllowed)));
        if at == second {
            break;
        }
        stage.kill(at);
        stage.resume(observer, Place::Edge(next));
        stage.run_until("a copy", |stage| {
            let copy = stage.client(observer).replica();
            copy.is_some_and(|copy| copy.stream().is_converged())
        });
    }
}

#[test]
fn a_member_publishes_on_at_another_edge_when_its_edge_is_killed() {
    for seed in 1..=4 {
        let mut published = Published::new(seed);
        assert_eq!(published.walk(120), 120);
        assert!(published.off() <= 1.001, "{} tolerances", published.off());
        published.stage.kill(0);
        published.stage.run(Span::from_millis(100 * seed));
        published.stage.resume(0, Place::Edge(1));
        published.stage.run_until("its authority", |stage| {
            stage.histories[0].authority_answers.len() == 2
        });
        // No one else has got it meanwhile, and no one gets it now.
        let again = published.stage.histories[0].authority_answers[1].clone();
        assert_eq!(again, Ok(vec![Published::AVATAR]));
        let held = AuthorityError::NotYours(Published::AVATAR);
        assert_eq!(published.take(published.watcher), Err(held));
        assert_eq!(published.walk(120), 120);
        assert!(published.off() <= 1.001, "{} tolerances", published.off());
    }
}
