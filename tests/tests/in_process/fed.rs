//! Scenes whose owner feeds the states of their bodies.
//!
//! The poses of a follower are compared with those that were fed, at every fed tick. The feeds are random: bodies come
//! and go, teleport, rest, are left out, and have velocities that contradict their poses; ticks are left out.

use std::collections::BTreeMap;

use glam::{Quat, Vec3};
use rhumb_client::{
    BodyId, BodyState, CheckpointError, Client, ClientError, Event, FedRequest, FedVelocities,
    FeedError, JoinMode, JoinOptions, LocalServer, Metres, OpenError, RefusalReason, Refusals,
    StreamChoice, Tick, Tolerance,
};
use rhumb_protocol::message::Denial;
use rhumb_protocol::scene::{
    BodyDesc, BodyKind, Command, CommandError, SceneConfig, Shape, ShapeId, Stepping,
};
use rhumb_reckoning::{Divergence, Pose};
use rhumb_tests::{Dice, seed};

const NAME: &str = "fed";
const RADIUS: f64 = 0.9;

/// A number from −1 to 1.
fn signed(dice: &mut Dice) -> f32 {
    dice.below(20_001) as f32 / 10_000.0 - 1.0
}

fn vector(dice: &mut Dice, most: f32) -> Vec3 {
    Vec3::new(signed(dice), signed(dice), signed(dice)) * most
}

/// A body of the engine that feeds, and how faithful its velocities are.
struct Flight {
    /// The middle of the places that it teleports to.
    around: Vec3,
    position: Vec3,
    rotation: Quat,
    linear: Vec3,
    angular: Vec3,
    lies: bool,
    /// Ticks for which it stands still from now on.
    stands: usize,
}

impl Flight {
    fn new(dice: &mut Dice, around: Vec3) -> Self {
        Self {
            around,
            position: around + vector(dice, 20.0),
            rotation: Quat::from_scaled_axis(vector(dice, 1.5)),
            linear: vector(dice, 8.0),
            angular: vector(dice, 6.0),
            lies: dice.below(3) == 0,
            stands: 0,
        }
    }

    fn step(&mut self, dice: &mut Dice) {
        const DT: f32 = 1.0 / 60.0;
        if self.stands > 0 {
            self.stands -= 1;
            return;
        }
        match dice.below(100) {
            0 => self.position = self.around + vector(dice, 40.0),
            1 => self.rotation = Quat::from_scaled_axis(vector(dice, 3.0)),
            2 => self.linear = vector(dice, 15.0),
            3 => self.stands = dice.below(40),
            4 => self.lies = !self.lies,
            _ => {}
        }
        self.linear.y -= 9.81 * DT;
        self.position += self.linear * DT;
        self.rotation = (Quat::from_scaled_axis(self.angular * DT) * self.rotation).normalize();
    }

    fn state(&self, dice: &mut Dice) -> BodyState {
        let (linear, angular) = match (self.lies, self.stands > 0) {
            (_, true) => (Vec3::ZERO, Vec3::ZERO),
            (true, _) => (vector(dice, 30.0), vector(dice, 20.0)),
            (false, _) => (self.linear, self.angular),
        };
        BodyState::new(
            self.position.to_array(),
            self.rotation.to_array(),
            linear.to_array(),
            angular.to_array(),
        )
        .expect("a finite state")
    }
}

fn pose(state: &BodyState) -> Pose {
    state.motion().pose()
}

/// An owner, its engine, and what it has fed.
struct Owner {
    client: Client,
    tick: u64,
    flights: BTreeMap<BodyId, Flight>,
    fed: BTreeMap<BodyId, BodyState>,
}

impl Owner {
    fn new(server: &LocalServer, stepping: Stepping) -> Self {
        let config = SceneConfig {
            stepping,
            ..SceneConfig::default()
        };
        let options = JoinOptions {
            mode: JoinMode::Create(config),
            ..JoinOptions::default()
        };
        let connection = server.feed(NAME).expect("no other feed");
        let client = connection.join_with(NAME, options).expect("a new scene");
        Self {
            client,
            tick: 0,
            flights: BTreeMap::new(),
            fed: BTreeMap::new(),
        }
    }

    fn add(&mut self, dice: &mut Dice) {
        self.add_around(dice, Vec3::ZERO);
    }

    fn add_around(&mut self, dice: &mut Dice, around: Vec3) {
        let flight = Flight::new(dice, around);
        let [x, y, z] = flight.position.to_array();
        let body = BodyDesc::dynamic(Shape::cuboid(0.8, 0.4, 0.1)).at(x, y, z);
        let body = body.rotation(flight.rotation);
        let state = body.state().expect("a finite state");
        let id = self.client.add_body(body).expect("an id is left");
        self.flights.insert(id, flight);
        self.fed.insert(id, state);
    }

    fn remove(&mut self, dice: &mut Dice) {
        let place = dice.below(self.flights.len());
        let id = *self.flights.keys().nth(place).expect("one is there");
        self.flights.remove(&id);
        self.fed.remove(&id);
        let removed = self.client.command(Command::RemoveBody { id });
        removed.expect("the client is open");
    }

    /// Steps the engine, and feeds what it has; some bodies are left out.
    fn feed(&mut self, dice: &mut Dice, velocities: FedVelocities) {
        let apart = if dice.below(8) == 0 {
            1 + dice.below(5)
        } else {
            1
        };
        self.tick += apart as u64;
        let mut states = Vec::new();
        for (id, flight) in &mut self.flights {
            for _ in 0..apart {
                flight.step(dice);
            }
            if dice.below(50) > 0 {
                let state = flight.state(dice);
                states.push((*id, state));
                self.fed.insert(*id, state);
            }
        }
        if dice.below(3) == 0 {
            states.reverse();
        }
        let fed = self.client.feed(Tick::new(self.tick), &states, velocities);
        fed.expect("the states are sound");
    }
}

fn follow(server: &LocalServer, tolerance: Tolerance) -> Client {
    let options = JoinOptions {
        stream: StreamChoice::Within(tolerance),
        ..JoinOptions::default()
    };
    let joined = server.connect().join_with(NAME, options);
    joined.expect("the scene is there")
}

/// Compares what a follower shows with what was fed.
fn compare(follower: &mut Client, owner: &Owner, seed: u64) {
    follower.poll().expect("the connection is open");
    let time = follower.view().time().expect("a view");
    assert_eq!(time.tick.value(), owner.tick, "seed {seed}");
    let mut ids: Vec<_> = follower.view().ids().to_vec();
    ids.sort_unstable();
    let expected: Vec<_> = owner.fed.keys().copied().collect();
    assert_eq!(ids, expected, "seed {seed}");
    for (id, truth) in &owner.fed {
        let (position, rotation) = (follower.view().position(*id), follower.view().rotation(*id));
        let shown = Pose {
            position: position.expect("in the view").as_dvec3(),
            rotation: rotation.expect("in the view").as_dquat().normalize(),
        };
        let off = Divergence::between(&pose(truth), &shown).surface_error(Metres::new(RADIUS));
        let bound = follower.error_bound(*id).expect("in the view").metres();
        // Rounding of the shown pose to 32 bits counts from a micrometre on.
        assert!(
            off.metres() <= bound + 1.1e-6,
            "seed {seed}, tick {}, {id}: {} > {bound}",
            owner.tick,
            off.metres()
        );
    }
}

#[test]
fn what_is_shown_is_within_the_bound_of_what_is_fed_whatever_is_fed() {
    for (case, velocities) in [
        (0, FedVelocities::Given),
        (1, FedVelocities::FromPoses),
        (2, FedVelocities::Given),
    ] {
        let seed = seed(31) + case;
        let mut dice = Dice::new(seed);
        let server = LocalServer::new();
        let mut owner = Owner::new(&server, Stepping::Lockstep);
        let mut followers = vec![follow(&server, Tolerance::NORMAL)];
        for _ in 0..12 {
            owner.add(&mut dice);
        }
        for turn in 0..400 {
            match dice.below(40) {
                0 => owner.add(&mut dice),
                1 if owner.flights.len() > 3 => owner.remove(&mut dice),
                _ => {}
            }
            owner.feed(&mut dice, velocities);
            if turn == 150 {
                // One joins late, and one with a stream of its own.
                followers.push(follow(&server, Tolerance::NORMAL));
                followers.push(follow(&server, Tolerance::FINE));
            }
            for follower in &mut followers {
                compare(follower, &owner, seed);
            }
        }
    }
}

#[test]
fn the_bound_counts_the_rounding_of_a_pose_that_is_shown_far_from_the_origin() {
    for (metres, tolerance_mm) in [(8_200.0, 1.0), (90_000.0, 10.0)] {
        let tolerance = Tolerance::from_metres(Metres::new(tolerance_mm / 1e3));
        let tolerance = tolerance.expect("within the limits");
        let seed = seed(31);
        let mut dice = Dice::new(seed);
        let server = LocalServer::new();
        let mut owner = Owner::new(&server, Stepping::Lockstep);
        let mut follower = follow(&server, tolerance);
        for _ in 0..12 {
            owner.add_around(&mut dice, Vec3::new(metres, 0.0, -metres));
        }
        for _ in 0..200 {
            owner.feed(&mut dice, FedVelocities::Given);
            compare(&mut follower, &owner, seed);
        }
    }
}

#[test]
fn a_body_that_stands_still_costs_nothing() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    let mut follower = follow(&server, Tolerance::NORMAL);
    let mut dice = Dice::new(5);
    for _ in 0..50 {
        owner.add(&mut dice);
    }
    let states: Vec<_> = owner.fed.iter().map(|(id, state)| (*id, *state)).collect();
    let mut feed = |ticks: core::ops::RangeInclusive<u64>, follower: &mut Client| {
        for tick in ticks {
            let fed = owner
                .client
                .feed(Tick::new(tick), &states, FedVelocities::Given);
            fed.expect("the states are sound");
            follower.poll().expect("open");
        }
        follower.statistics().stream.updates
    };
    let settled = feed(1..=10, &mut follower);
    assert_eq!(feed(11..=200, &mut follower), settled);
    assert!(follower.view().resting().iter().all(|resting| *resting));
}

#[test]
fn a_server_on_a_thread_of_its_own_takes_everything_that_is_fed() {
    let server = LocalServer::spawn().expect("a thread can start");
    let mut owner = Owner::new(&server, Stepping::FreeRunning);
    let mut dice = Dice::new(8);
    let states: Vec<_> = (0..200)
        .map(|_| BodyDesc::dynamic(Shape::ball(0.5)))
        .collect();
    let ids = owner.client.add_bodies(states).expect("ids are left");
    for tick in 1..=100 {
        let states = ids
            .iter()
            .map(|id| (*id, Flight::new(&mut dice, Vec3::ZERO).state(&mut dice)));
        let states: Vec<_> = states.collect();
        let fed = owner
            .client
            .feed(Tick::new(tick), &states, FedVelocities::Given);
        fed.expect("the scene has room in time");
    }
    let inspection = owner.client.inspect().expect("an answer");
    // At most those wait that the scene has not taken yet.
    assert!(inspection.tick.value() >= 96, "{inspection:?}");
    assert_eq!(inspection.bodies, 200);
}

#[test]
fn states_that_are_wrong_are_refused_by_name_and_the_next_ones_are_taken() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    let mut follower = follow(&server, Tolerance::NORMAL);
    owner.add(&mut Dice::new(1));
    let (id, state) = owner
        .fed
        .iter()
        .next()
        .map(|(id, state)| (*id, *state))
        .expect("one");
    let client = &mut owner.client;
    let mut refused = |tick: u64, states: &[(BodyId, BodyState)]| match client.feed(
        Tick::new(tick),
        states,
        FedVelocities::Given,
    ) {
        Err(ClientError::Feed(error)) => error,
        other => panic!("{other:?}"),
    };
    let unknown = BodyId::new(id.index(), 7);
    assert!(matches!(
        refused(1, &[(unknown, state)]),
        FeedError::UnknownBody { place: 0, body } if body == unknown
    ));
    assert_eq!(
        refused(1, &[(id, state), (id, state)]),
        FeedError::Twice(id)
    );
    let (tick, newest) = (Tick::ZERO, Tick::ZERO);
    assert_eq!(refused(0, &[]), FeedError::TickNotLater { tick, newest });
    client
        .feed(Tick::new(3), &[(id, state)], FedVelocities::Given)
        .expect("the first states");
    let advanced = client.advance(rhumb_client::PipelineDepth::LOCKSTEP);
    assert!(matches!(
        advanced,
        Err(ClientError::Feed(FeedError::StepsByFeed))
    ));
    let not_owner = follower.feed(Tick::new(4), &[], FedVelocities::Given);
    assert!(matches!(
        not_owner,
        Err(ClientError::Feed(FeedError::NotOwner))
    ));
    let removed = client.command(Command::RemoveBody { id });
    removed.expect("open");
    let gone = client.feed(Tick::new(4), &[(id, state)], FedVelocities::Given);
    assert!(matches!(
        gone,
        Err(ClientError::Feed(FeedError::UnknownBody { .. }))
    ));
    follower.poll().expect("open");
    assert_eq!(follower.view().time().expect("a view").tick, Tick::new(3));
}

#[test]
fn commands_of_followers_come_to_the_owner_who_accepts_or_refuses_them() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    owner.add(&mut Dice::new(1));
    let known = *owner.fed.keys().next().expect("one");
    let fed = owner.client.feed(Tick::new(1), &[], FedVelocities::Given);
    fed.expect("no states rest everything");
    let options = JoinOptions {
        refusals: Refusals::Errors,
        ..JoinOptions::default()
    };
    let mut follower = server.connect().join_with(NAME, options).expect("joined");
    let impulse = Command::Impulse {
        id: known,
        impulse: Vec3::X,
    };
    follower.poll().expect("open");
    follower.command(impulse.clone()).expect("open");
    let wanted = follower
        .add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(1.0, 2.0, 3.0))
        .expect("an id");
    let denied = follower
        .add_body(BodyDesc::dynamic(Shape::ball(0.5)).at(4.0, 2.0, 3.0))
        .expect("an id");
    follower.poll().expect("nothing is refused yet");
    let request = owner.client.poll_request().expect("the impulse");
    assert_eq!(request.command, impulse);
    owner.client.accept_request(request).expect("open");
    let request = owner.client.poll_request().expect("a body");
    assert_eq!(request.command.body(), Some(wanted));
    owner.client.accept_request(request).expect("open");
    let request = owner.client.poll_request().expect("another body");
    assert_eq!(request.command.body(), Some(denied));
    let reason = CommandError::NotAllowed;
    owner.client.refuse_request(request, reason).expect("open");
    assert!(owner.client.poll_request().is_none());
    let there = BodyState::new([5.0, 5.0, 5.0], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    let states = [(wanted, there.expect("finite"))];
    let fed = owner
        .client
        .feed(Tick::new(2), &states, FedVelocities::Given);
    fed.expect("an accepted body is fed");
    let refused = match follower.poll() {
        Err(ClientError::Refused(refused)) => refused,
        other => panic!("{other:?}"),
    };
    let [refusal] = refused.refusals() else {
        panic!("{refused:?}");
    };
    assert_eq!(refusal.reason, RefusalReason::Command(reason));
    let shown = follower.view().position(wanted).expect("accepted");
    assert!(shown.distance(Vec3::splat(5.0)) < 0.05);
    assert!(follower.view().position(denied).is_none());
}

/// A ball that a follower asks for, and the request.
fn ask(owner: &mut Owner, follower: &mut Client) -> (BodyId, FedRequest) {
    let ball = BodyDesc::dynamic(Shape::ball(0.5)).at(1.0, 2.0, 3.0);
    let wanted = follower.add_body(ball).expect("an id");
    follower.poll().expect("nothing is refused yet");
    let request = owner.client.poll_request().expect("a body is asked for");
    assert_eq!(request.command.body(), Some(wanted));
    (wanted, request)
}

/// Hands the states of a tick over.
fn hand(owner: &mut Owner, tick: u64, states: &[(BodyId, BodyState)]) -> Result<(), ClientError> {
    let tick = Tick::new(tick);
    owner.client.feed(tick, states, FedVelocities::Given)
}

fn at_five(body: BodyId) -> [(BodyId, BodyState); 1] {
    let state = BodyState::new([5.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]);
    [(body, state.expect("finite"))]
}

#[test]
fn a_request_has_one_answer() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    let mut follower = server.connect().join(NAME).expect("joined");
    let (wanted, request) = ask(&mut owner, &mut follower);
    let client = &mut owner.client;
    client.accept_request(request.clone()).expect("the first");
    let answered = |result| matches!(result, Err(ClientError::Feed(FeedError::Answered)));
    assert!(answered(client.accept_request(request.clone())));
    let reason = CommandError::NotAllowed;
    assert!(answered(client.refuse_request(request, reason)));
    let fed = hand(&mut owner, 1, &at_five(wanted));
    fed.expect("the body is there");
    follower.poll().expect("nothing was refused");
    assert!(follower.view().position(wanted).is_some());
}

#[test]
fn an_accepted_request_whose_member_has_left_is_refused_to_the_owner_and_harms_no_other() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    let mut gone = server.connect().join(NAME).expect("joined");
    let (unborn, request) = ask(&mut owner, &mut gone);
    drop(gone);
    let mut follower = server.connect().join(NAME).expect("joined");
    owner.client.accept_request(request).expect("open");
    let fed = hand(&mut owner, 1, &[]);
    let Err(ClientError::Refused(refused)) = fed else {
        panic!("{fed:?}");
    };
    assert_eq!(refused.first().body, Some(unborn));
    let states = at_five(unborn);
    let unknown = hand(&mut owner, 2, &states);
    assert!(matches!(
        unknown,
        Err(ClientError::Feed(FeedError::UnknownBody { .. }))
    ));
    let (wanted, request) = ask(&mut owner, &mut follower);
    assert_eq!(wanted, unborn, "the index is free again");
    owner.client.accept_request(request).expect("open");
    let fed = hand(&mut owner, 2, &at_five(wanted));
    fed.expect("the body is there");
    follower.poll().expect("it did nothing wrong");
    assert!(follower.view().position(wanted).is_some());
}

#[test]
fn a_removal_that_the_scene_refuses_after_all_leaves_a_body_that_is_fed() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    let mut gone = server.connect().join(NAME).expect("joined");
    let (body, request) = ask(&mut owner, &mut gone);
    owner.client.accept_request(request).expect("open");
    hand(&mut owner, 1, &at_five(body)).expect("the body is there");
    let removal = Command::RemoveBody { id: body };
    gone.command(removal).expect("a sound command");
    gone.poll().expect("open");
    let request = owner.client.poll_request().expect("a request");
    drop(gone);
    owner.client.accept_request(request).expect("open");
    let Err(ClientError::Refused(refused)) = hand(&mut owner, 2, &at_five(body)) else {
        panic!("the scene refuses what a member that has left asked for");
    };
    let first = refused.first();
    assert_eq!((first.number, first.body), (None, Some(body)));
    let reason = RefusalReason::Request(CommandError::NotAllowed);
    assert_eq!(first.reason, reason);
    assert!(first.to_string().contains("the member has left"), "{first}");
    hand(&mut owner, 3, &at_five(body)).expect("the body is there still");
    assert_eq!(owner.client.fed_tick(), Some(Tick::new(3)));
}

#[test]
fn a_body_of_the_owner_that_the_scene_refuses_is_an_error_and_is_fed_no_more() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    let desc = BodyDesc::plain(BodyId::new(40_000, 0), BodyKind::Dynamic, ShapeId(9));
    let motion = at_five(desc.id)[0].1;
    let added = owner.client.command(Command::AddBody { desc, motion });
    added.expect("a sound command");
    let fed = hand(&mut owner, 1, &[]);
    assert!(matches!(fed, Err(ClientError::Refused(_))), "{fed:?}");
    let states = at_five(desc.id);
    let fed = hand(&mut owner, 2, &states);
    assert!(matches!(
        fed,
        Err(ClientError::Feed(FeedError::UnknownBody { .. }))
    ));
}

#[test]
fn the_client_that_feeds_a_scene_joins_none_that_is_there() {
    let server = LocalServer::new();
    let there = server.connect().join(NAME).expect("a new scene");
    let connection = server.feed(NAME).expect("no feed");
    let options = JoinOptions {
        mode: JoinMode::Join,
        ..JoinOptions::default()
    };
    let joined = connection.join_with(NAME, options).err();
    assert!(matches!(joined, Some(OpenError::Feed(FeedError::Joins))));
    drop(there);
}

#[test]
fn a_fed_scene_is_not_saved_and_says_where_its_state_is() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    owner.add(&mut Dice::new(1));
    owner.feed(&mut Dice::new(2), FedVelocities::Given);
    assert_eq!(server.save(NAME).err(), Some(CheckpointError::Fed));
}

#[test]
fn the_owner_feeds_its_bodies_and_pushes_none() {
    let server = LocalServer::new();
    let mut owner = Owner::new(&server, Stepping::Lockstep);
    owner.add(&mut Dice::new(1));
    let id = *owner.fed.keys().next().expect("one");
    let pushed = owner.client.command(Command::Wake { id });
    let number = pushed.expect("open");
    let fed = hand(&mut owner, 1, &[]);
    assert!(matches!(fed, Err(ClientError::Refused(_))), "{fed:?}");
    let refused = std::iter::from_fn(|| owner.client.poll_event()).any(|(_, event)| {
        event
            == Event::Refused {
                number,
                error: CommandError::Unsupported,
            }
    });
    assert!(refused);
}

#[test]
fn a_name_has_one_owner_and_the_scene_ends_with_it() {
    let server = LocalServer::new();
    let waiting = server.feed(NAME).expect("no other feed");
    assert!(server.feed(NAME).is_err());
    let early = server.connect().join(NAME).err();
    let denied = matches!(
        &early,
        Some(OpenError::Denied {
            denial: Denial::NoSuchScene,
            ..
        })
    );
    assert!(denied, "it is the owner's to make: {early:?}");
    let owner = waiting.join(NAME).expect("a new scene");
    let mut follower = server.connect().join(NAME).expect("the scene is there");
    drop(owner);
    assert!(matches!(
        follower.idle(core::time::Duration::ZERO),
        Err(ClientError::SceneDeleted)
    ));
    let mut another = server
        .feed(NAME)
        .expect("the feed is free")
        .join(NAME)
        .expect("new");
    assert!(
        another
            .feed(Tick::new(1), &[], FedVelocities::Given)
            .is_ok()
    );
}
