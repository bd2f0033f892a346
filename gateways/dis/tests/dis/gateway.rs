//! A gateway between a real scene and real UDP sockets on loopback.
//!
//! The scene's server is in this process and steps in lockstep, so that time is the test's own.

use std::collections::BTreeMap;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};
use std::time::Duration;

use glam::{DQuat, DVec3, Vec3};
use rhumb_client::scene::{BodyDesc, Command, Shape};
use rhumb_client::{
    BodyId, Client, JoinMode, JoinOptions, LocalServer, PipelineDepth, Refusals, StreamChoice,
    Tolerance,
};
use rhumb_dis::entity::{EntityState, EntityType};
use rhumb_dis::foreign::{ForeignConfig, ForeignEntities};
use rhumb_dis::gateway::{Gateway, GatewayConfig};
use rhumb_dis::geodesy::{Geodetic, SceneAxes, TangentFrame};
use rhumb_dis::pdu::{Body, Bundle, TimeBase};
use rhumb_dis::published::{Kind, Observed, Publisher, PublisherConfig, predicted};
use rhumb_dis::rules::Rules;
use rhumb_dis::socket::{DisSocket, PortUse, SocketOptions};
use rhumb_protocol::Instant;
use rhumb_scene::{Limits, SceneRouter, SceneSettings};

const AXES: SceneAxes = SceneAxes::YUp;
/// Eleven seconds before the full hour, which the tests pass.
const START: Duration = Duration::from_secs(3589);
const STEP: f64 = 1.0 / 60.0;

fn frame() -> TangentFrame {
    let place = Geodetic::from_degrees(48.1, 11.6, 520.0).expect("in range");
    TangentFrame::new(place, AXES)
}

fn publisher(application: u16) -> PublisherConfig {
    PublisherConfig {
        exercise: 1,
        site: 7,
        application,
        frame: frame(),
        axes: AXES,
        base: TimeBase::Absolute,
        datagram_bytes: 1400,
        states_per_second: 1000,
    }
}

fn foreign(application: u16) -> ForeignConfig {
    ForeignConfig {
        exercise: 1,
        site: 7,
        application,
        frame: frame(),
        axes: AXES,
        timeout: ForeignConfig::TIMEOUT,
        entities_max: 256,
        reach: 5_000.0,
        pdus_per_second: 1000,
    }
}

fn moment(step: u32) -> Duration {
    START + Duration::from_secs_f64(f64::from(step) * STEP)
}

/// A socket on loopback that sends to this port.
fn socket(to: Option<u16>) -> (DisSocket, u16) {
    let loopback = |port| SocketAddrV4::new(Ipv4Addr::LOCALHOST, port);
    let options = SocketOptions {
        listen: loopback(0),
        targets: to.map(loopback).into_iter().collect(),
        groups: Vec::new(),
        interface: Ipv4Addr::UNSPECIFIED,
        hops: 1,
        port: PortUse::Own,
    };
    let socket = DisSocket::open(&options).expect("loopback has a free port");
    let port = socket
        .local_addr()
        .map(|address: SocketAddr| address.port());
    (socket, port.expect("it has one"))
}

/// A scene with its leader, who steps it, and a gateway's member.
fn scene() -> (Client, Client) {
    scene_of(&LocalServer::new())
}

fn scene_of(server: &LocalServer) -> (Client, Client) {
    let leader = server.connect().join("field").expect("it is created");
    (leader, member_within(server, Tolerance::NORMAL))
}

fn member_within(server: &LocalServer, tolerance: Tolerance) -> Client {
    let options = JoinOptions {
        mode: JoinMode::Join,
        stream: StreamChoice::Within(tolerance),
        smooth: false,
        refusals: Refusals::Events,
        ..JoinOptions::default()
    };
    let member = server.connect().join_with("field", options);
    member.expect("it is there")
}

fn gateway(client: Client, application: u16) -> Gateway {
    gateway_of(client, publisher(application))
}

fn gateway_of(client: Client, publisher: PublisherConfig) -> Gateway {
    let application = publisher.application;
    let mut rules = Rules::new(Kind::default(), Shape::ball(0.5));
    let text = "[[entity]]\nentity-type = \"1.1.*.*\"\nshape = \"cuboid:1,0.5,0.5\"";
    rules.add(text).expect("sound rules");
    let config = GatewayConfig {
        publisher: Some(publisher),
        foreign: Some(foreign(application)),
        rules,
        tolerance: Tolerance::FINE,
    };
    Gateway::new(client, config)
}

/// Sends what a gateway has, and receives as many datagrams at the other socket.
fn carry(gateway: &mut Gateway, from: &DisSocket, to: &DisSocket) -> Vec<Vec<u8>> {
    let mut buffer = [0; 2_000];
    let mut sent = 0;
    while let Some(bytes) = gateway.poll_datagram(&mut buffer) {
        from.send(&buffer[..bytes]).expect("loopback takes it");
        sent += 1;
    }
    receive(to, sent)
}

fn receive(socket: &DisSocket, count: usize) -> Vec<Vec<u8>> {
    let mut buffer = [0; 2_000];
    let mut one = |_| {
        let received = socket.receive(&mut buffer, Duration::from_secs(20));
        let bytes = received.expect("the socket works").expect("it arrives");
        buffer[..bytes].to_vec()
    };
    (0..count).map(&mut one).collect()
}

fn pose(client: &Client, id: BodyId) -> (DVec3, DQuat) {
    let view = client.view();
    let position = view.position(id).expect("the body is there");
    let rotation = view.rotation(id).expect("the body is there");
    (position.as_dvec3(), rotation.as_dquat())
}

#[test]
fn receivers_of_a_scenes_states_are_within_the_thresholds_of_its_bodies() {
    // A length of 1 cm leaves the box a turn of 1.5 degrees.
    for (tolerance, coarse) in [("0.05:0.0175", 0), ("0.01", 0), ("0.05", 1)] {
        let server = LocalServer::new();
        let exact = JoinOptions {
            stream: StreamChoice::Full,
            ..JoinOptions::default()
        };
        let leader = server.connect().join_with("field", exact);
        let member = member_within(&server, tolerance.parse().expect("a tolerance"));
        throw_a_box((leader.expect("it is created"), member), coarse);
    }
}

/// Throws a box, and compares what receivers of its states see with the truth. `coarse`: 1 if the turn of the copy may be
/// beyond the threshold.
fn throw_a_box((mut leader, member): (Client, Client), coarse: usize) {
    let (receiver, port) = socket(None);
    let (sender, _) = socket(Some(port));
    let floor = BodyDesc::fixed(Shape::cuboid(30.0, 0.5, 30.0)).at(0.0, -0.5, 0.0);
    leader.add_body(floor).expect("a floor");
    let thrown = BodyDesc::dynamic(Shape::cuboid(0.3, 0.2, 0.1))
        .at(-5.0, 3.0, 0.0)
        .linear_velocity(Vec3::new(4.0, 6.0, 1.0))
        .angular_velocity(Vec3::new(1.0, 2.0, 3.0));
    let thrown = leader.add_body(thrown).expect("a box");
    let mut gateway = gateway(member, 1);
    let mut known: Option<(EntityState<'static>, Duration)> = None;
    let (mut count, mut flight) = (0, 0);
    for step in 0..420 {
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        let now = moment(step);
        gateway.handle_time(now).expect("the scene is there");
        for datagram in carry(&mut gateway, &sender, &receiver) {
            for pdu in Bundle::new(&datagram) {
                let (_, pdu) = pdu.expect("a sound pdu");
                let Body::EntityState(state) = pdu.body else {
                    panic!("a state")
                };
                assert_eq!(state.id.entity, 1, "the floor is not sent");
                let parameters = &[];
                known = Some((
                    EntityState {
                        parameters,
                        ..state
                    },
                    now,
                ));
                count += 1;
            }
        }
        let (state, at) = known.as_ref().expect("the first state leaves at once");
        let receivers = predicted(state, (now - *at).as_secs_f64());
        let (position, rotation) = pose(&leader, thrown);
        let off = frame()
            .point_to_scene(receivers.location)
            .distance(position);
        assert!(off <= 1.0, "{off} m off at step {step}");
        let there = frame().rotation() * rotation * AXES.entity_in_body();
        let cosine = receivers.orientation.dot(there).abs().min(1.0);
        let turn = (2.0 * cosine.acos()).to_degrees();
        // A copy within 5 cm may turn by 7.7 degrees at 0.37 m: half of the threshold is for the receivers.
        let most = if coarse == 0 { 3.0 } else { 1.5 + 7.7 };
        assert!(turn <= most, "{turn} degrees off at step {step}");
        flight = if step == 60 { count } else { flight };
    }
    assert!(flight <= 12, "{flight} states in a second of flight");
    assert!((2..60).contains(&count), "{count} states");
    assert_eq!(gateway.statistics().bodies, 1);
    assert_eq!(gateway.statistics().coarse, coarse);
    gateway.leave(moment(420)).expect("the scene is there");
    let last = carry(&mut gateway, &sender, &receiver).concat();
    let mut entities = ForeignEntities::new(foreign(9));
    assert_eq!(entities.handle_datagram(moment(420), &last), Ok(()));
    assert_eq!(entities.poses(moment(420)).count(), 0, "it left");
}

/// A vehicle of another simulator that drives along x at 3 m/s, 0.5 m above the ground.
fn vehicle(step: u32) -> Observed {
    let entity_type: EntityType = "1.1.225.1".parse().expect("a type");
    let x = -6.0 + 3.0 * f64::from(step) * STEP;
    Observed {
        key: 1,
        kind: Kind {
            entity_type,
            ..Kind::default()
        },
        position: DVec3::new(x, 0.5, 0.0),
        rotation: DQuat::IDENTITY,
        velocity: DVec3::X * 3.0,
        acceleration: DVec3::ZERO,
        spin: DVec3::ZERO,
    }
}

#[test]
fn an_entity_is_a_body_that_pushes_others_until_it_leaves() {
    let (mut leader, member) = scene();
    let (ear, port) = socket(None);
    let (tool, _) = socket(Some(port));
    let floor = BodyDesc::fixed(Shape::cuboid(30.0, 0.5, 30.0)).at(0.0, -0.5, 0.0);
    let floor = leader.add_body(floor).expect("a floor");
    let crate_body = BodyDesc::dynamic(Shape::cuboid(0.4, 0.4, 0.4)).at(0.0, 0.4, 0.0);
    let crate_body = leader.add_body(crate_body).expect("a crate");
    let mut gateway = gateway(member, 1);
    let mut other = Publisher::new(publisher(2));
    let mut buffer = [0; 2_000];
    let mut guest = None;
    for step in 0..300 {
        let now = moment(step);
        let gone = [];
        let there = [vehicle(step)];
        other.handle_bodies(now, if step < 240 { &there } else { &gone });
        while let Some(bytes) = other.poll_datagram(&mut buffer) {
            tool.send(&buffer[..bytes]).expect("loopback takes it");
            let datagram = receive(&ear, 1).concat();
            assert_eq!(gateway.handle_datagram(now, &datagram), Ok(()));
        }
        gateway.handle_time(now).expect("the scene is there");
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        let mut ids = leader.view().ids().iter().copied();
        let new = ids.find(|id| ![floor, crate_body].contains(id));
        guest = guest.or(new);
        let shape = guest.and_then(|id| leader.replica()?.body(id));
        let shape = shape.and_then(|body| leader.replica()?.shape(body.shape).cloned());
        if (30..240).contains(&step) {
            assert_eq!(shape, Some(Shape::cuboid(1.0, 0.5, 0.5)));
            let (position, _) = pose(&leader, guest.expect("it has a body"));
            let off = position.distance(vehicle(step).position);
            assert!(off < 0.2, "{off} m off at step {step}");
        }
    }
    let (pushed, _) = pose(&leader, crate_body);
    assert!(pushed.x > 3.0, "the vehicle pushed the crate to {pushed}");
    let guest = guest.expect("it had a body");
    assert_eq!(
        leader.view().place(guest),
        None,
        "the body left with its entity"
    );
    let statistics = gateway.statistics();
    assert_eq!(
        (statistics.entities, statistics.denied, statistics.refused),
        (0, 0, 0)
    );
    // The crate alone is sent: an entity that came in does not leave again.
    assert_eq!(statistics.bodies, 1);
}

#[test]
fn two_scenes_are_joined_by_two_gateways() {
    let (mut leader, member) = scene();
    let (mut far_leader, far_member) = scene();
    let (ear, port) = socket(None);
    let (mouth, _) = socket(Some(port));
    let bodies = [-4.0, 0.0, 4.0].map(|x| {
        let ball = BodyDesc::dynamic(Shape::ball(0.3)).at(x, 8.0, 0.0);
        leader
            .add_body(ball.linear_velocity(Vec3::new(0.0, 5.0, x)))
            .expect("a ball")
    });
    let (mut near, mut far) = (gateway(member, 1), gateway(far_member, 2));
    for step in 0..90 {
        let now = moment(step);
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        near.handle_time(now).expect("the scene is there");
        for datagram in carry(&mut near, &mouth, &ear) {
            assert_eq!(far.handle_datagram(now, &datagram), Ok(()));
        }
        far.handle_time(now).expect("the scene is there");
        far_leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    }
    let view = far_leader.view();
    let copies: BTreeMap<i32, DVec3> = (view.positions().iter())
        .map(|at| ((at.z / 3.0).round() as i32, at.as_dvec3()))
        .collect();
    assert_eq!(copies.len(), 3);
    for (id, place) in bodies.into_iter().zip([-2, 0, 2]) {
        let (position, _) = pose(&leader, id);
        let copy = copies.get(&place).expect("it came over");
        let off = copy.distance(position);
        assert!(off < 1.1, "{off} m off");
    }
    assert_eq!(near.statistics().entities, 0);
    assert_eq!((far.statistics().entities, far.statistics().bodies), (3, 0));
}

#[test]
fn an_entity_beyond_reach_has_no_body() {
    let (mut leader, member) = scene();
    let mut gateway = gateway(member, 1);
    let mut other = Publisher::new(publisher(2));
    let far = Observed {
        position: DVec3::new(6_000.0, 0.5, 0.0),
        ..vehicle(0)
    };
    other.handle_bodies(START, &[far]);
    let mut buffer = [0; 2_000];
    let bytes = other.poll_datagram(&mut buffer).expect("a state");
    assert_eq!(gateway.handle_datagram(START, &buffer[..bytes]), Ok(()));
    for step in 0..3 {
        gateway
            .handle_time(moment(step))
            .expect("the scene is there");
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    }
    assert_eq!(
        (gateway.statistics().beyond, leader.view().ids().len()),
        (1, 0)
    );
}

/// Hands the states of a publisher to a gateway.
fn hand(from: &mut Publisher, bodies: &[Observed], to: &mut Gateway, now: Duration) {
    let mut buffer = [0; 2_000];
    from.handle_bodies(now, bodies);
    while let Some(bytes) = from.poll_datagram(&mut buffer) {
        assert_eq!(to.handle_datagram(now, &buffer[..bytes]), Ok(()));
    }
}

/// Two vehicles side by side.
fn column(step: u32) -> [Observed; 2] {
    let one = vehicle(step);
    let beside = DVec3::new(0.0, 0.0, 8.0);
    let other = Observed {
        key: 2,
        position: one.position + beside,
        ..one
    };
    [one, other]
}

/// The bodies of the scene on either side of the line between the two of a column.
fn lanes(leader: &Client) -> [Option<BodyId>; 2] {
    let view = leader.view();
    let places = view.ids().iter().zip(view.positions());
    let mut lanes = [None; 2];
    for (id, at) in places {
        lanes[usize::from(at.z > 4.0)] = Some(*id);
    }
    lanes
}

#[test]
fn a_body_that_another_member_removes_comes_back_and_the_others_go_on() {
    let (mut leader, member) = scene();
    let mut gateway = gateway(member, 1);
    let mut other = Publisher::new(publisher(2));
    let mut removed = None;
    for step in 0..240 {
        let now = moment(step);
        hand(&mut other, &column(step), &mut gateway, now);
        gateway.handle_time(now).expect("the scene is there");
        if step == 60 {
            let [_, id] = lanes(&leader);
            removed = id;
            let id = id.expect("the vehicle has a body");
            let remove = Command::RemoveBody { id };
            leader.command(remove).expect("it is queued");
        }
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        let [first, second] = lanes(&leader);
        if step > 30 {
            let (at, _) = pose(&leader, first.expect("it is never touched"));
            let off = at.distance(column(step)[0].position);
            assert!(off < 0.2, "{off} m off at step {step}");
        }
        if (70..110).contains(&step) {
            assert_eq!(second, None, "it comes back a second later");
        }
    }
    let [_, second] = lanes(&leader);
    assert!(second != removed, "it is another body");
    let (at, _) = pose(&leader, second.expect("it came back"));
    let off = at.distance(column(239)[1].position);
    assert!(off < 0.2, "{off} m off");
    assert_eq!(gateway.statistics().entities, 2);
}

#[test]
fn a_body_that_the_server_refuses_takes_the_authority_over_no_other() {
    let settings = SceneSettings {
        limits: Limits {
            bodies_per_scene: 1,
            ..Limits::default()
        },
        ..SceneSettings::new(|| Instant::ZERO)
    };
    let (mut leader, member) = scene_of(&LocalServer::of(SceneRouter::new(settings)));
    let mut gateway = gateway(member, 1);
    let mut other = Publisher::new(publisher(2));
    for step in 0..240 {
        let now = moment(step);
        hand(&mut other, &column(step), &mut gateway, now);
        gateway.handle_time(now).expect("the scene is there");
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        if step > 90 {
            let [first, second] = lanes(&leader);
            assert_eq!(second, None, "the scene has room for one");
            let (at, _) = pose(&leader, first.expect("it has a body"));
            let off = at.distance(column(step)[0].position);
            assert!(off < 0.2, "{off} m off at step {step}");
        }
    }
    let statistics = gateway.statistics();
    assert_eq!(statistics.entities, 1);
    // It is tried again each second, not each tick.
    let refused = statistics.refused;
    assert!((2..=5).contains(&refused), "{refused} refusals in 4 s");
}

#[test]
fn an_entity_that_no_body_can_follow_is_counted_and_ends_nothing() {
    let (mut leader, member) = scene();
    let mut gateway = gateway(member, 1);
    let mut other = Publisher::new(publisher(2));
    for step in 0..120 {
        let now = moment(step);
        let mut bodies = column(step);
        // Three times the speed of sound, and more than a scene's bodies have.
        let is_fast = (40..80).contains(&step);
        if is_fast {
            bodies[1].velocity.x = 1_100.0;
            bodies[1].position.y += 2.0;
        }
        hand(&mut other, &bodies, &mut gateway, now);
        gateway.handle_time(now).expect("the scene is there");
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        let unfit = gateway.statistics().unfit;
        if (60..80).contains(&step) {
            assert_eq!(unfit, 1, "step {step}");
        }
        if step > 110 {
            assert_eq!(unfit, 0, "step {step}");
            let (at, _) = pose(&leader, lanes(&leader)[1].expect("it has a body"));
            let off = at.distance(column(step)[1].position);
            assert!(off < 0.2, "{off} m off at step {step}");
        }
    }
}

/// A scene of five balls, and a gateway that sends five states a second.
fn five_balls_and_a_slow_gateway() -> (Client, Gateway) {
    let (mut leader, member) = scene();
    for place in 0..5 {
        let ball = BodyDesc::dynamic(Shape::ball(0.3)).at(2.0 * place as f32, 8.0, 0.0);
        leader.add_body(ball).expect("a ball");
    }
    let slow = PublisherConfig {
        states_per_second: 5,
        ..publisher(1)
    };
    (leader, gateway_of(member, slow))
}

#[test]
fn leaving_removes_the_bodies_and_says_how_many_last_states_wait() {
    let (mut leader, mut slow) = five_balls_and_a_slow_gateway();
    let mut buffer = [0; 2_000];
    let mut count = 0;
    leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    slow.handle_time(moment(0)).expect("the scene is there");
    while slow.poll_datagram(&mut buffer).is_some() {
        count += 1;
    }
    assert_eq!(count, 1, "five states fit a datagram");
    let mut other = Publisher::new(publisher(2));
    for step in 0..20 {
        hand(&mut other, &[vehicle(0)], &mut slow, moment(0));
        slow.handle_time(moment(0)).expect("the scene is there");
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
        assert!(slow.poll_datagram(&mut buffer).is_none(), "step {step}");
    }
    assert_eq!(leader.view().ids().len(), 6, "the vehicle has a body");
    assert_eq!(slow.leave(moment(0)).expect("the scene is there"), 5);
    assert_eq!(slow.leave(moment(30)).expect("the scene is there"), 3);
    assert_eq!(slow.leave(moment(120)).expect("the scene is there"), 0);
    leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    assert_eq!(leader.view().ids().len(), 5, "its body left");
}

#[test]
fn last_states_leave_also_when_the_scene_ends_before_the_bodies_of_entities_do() {
    let (mut leader, mut slow) = five_balls_and_a_slow_gateway();
    let mut other = Publisher::new(publisher(2));
    for _ in 0..20 {
        hand(&mut other, &column(0), &mut slow, moment(0));
        slow.handle_time(moment(0)).expect("the scene is there");
        leader.advance(PipelineDepth::LOCKSTEP).expect("a tick");
    }
    assert_eq!(slow.statistics().entities, 2);
    leader.delete().expect("it is there");
    assert!(slow.handle_time(moment(0)).is_err(), "the scene is over");
    let mut buffer = [0; 2_000];
    while slow.poll_datagram(&mut buffer).is_some() {}
    assert!(slow.leave(moment(0)).is_err(), "no body can be removed");
    assert_eq!(slow.leave(moment(30)).expect("no body is left"), 3);
    assert_eq!(slow.leave(moment(120)).expect("no body is left"), 0);
    let mut entities = ForeignEntities::new(foreign(9));
    let mut count = 0;
    while let Some(bytes) = slow.poll_datagram(&mut buffer) {
        for pdu in Bundle::new(&buffer[..bytes]) {
            let (_, pdu) = pdu.expect("a sound pdu");
            count += usize::from(matches!(pdu.body, Body::EntityState(_)));
        }
        assert_eq!(
            entities.handle_datagram(moment(120), &buffer[..bytes]),
            Ok(())
        );
    }
    assert_eq!((count, entities.poses(moment(120)).count()), (5, 0));
}
