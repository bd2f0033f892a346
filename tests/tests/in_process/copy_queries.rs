//! Queries on a client's copy find what the server finds.
//!
//! A scene of random bodies follows a full stream in lockstep, so that both have equal poses at each tick. Each query is
//! sent, and asked of the copy at the tick of the answer. At a tolerance, what was found is within the bounds.

use glam::{Quat, Vec3};
use proptest::prelude::*;
use rhumb_client::{CopyAnswer, CopyQueries, ErrorBound, RenderTime};
use rhumb_protocol::Peer;
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyKind, CollisionGroups, Command, Compound, Heights, Hit, Hull, Mesh, Part,
    Query, QueryFilter, SceneConfig, Shape, ShapeId,
};
use rhumb_protocol::session::Event;
use rhumb_reckoning::{BodyId, BodyState, Tick, Tolerance};
use rhumb_tests::Table;
use rhumb_view::{LiveView, ViewOptions};

/// Metres: what the copy's poses differ by, since a pose passes through f64.
const ROUNDING: f32 = 1e-3;

/// A shape of each kind; the last three cannot be dynamic.
fn shapes() -> Vec<Shape> {
    let corner = |bits: u32| {
        let side = |bit: u32| if bits >> bit & 1 == 0 { -0.6 } else { 0.6 };
        Vec3::new(side(0), side(1), side(2))
    };
    let corners: Vec<_> = (0..8).map(corner).collect();
    let hull = Hull::new(&corners).expect("a cube");
    let part = |x: f32, shape| Part {
        shape,
        position: Vec3::X * x,
        rotation: Quat::from_rotation_z(x),
    };
    let parts = vec![
        part(-0.7, Shape::ball(0.4)),
        part(0.7, Shape::cone(0.5, 0.4)),
    ];
    let posts: Vec<_> = (0..64).map(|post| (post % 5) as f32 * 0.2).collect();
    let triangles = [[0, 1, 2], [1, 3, 2], [4, 5, 6], [0, 4, 1], [2, 3, 7]];
    vec![
        Shape::ball(0.5),
        Shape::cuboid(0.4, 0.7, 0.5),
        Shape::capsule(0.5, 0.3),
        Shape::cylinder(0.5, 0.4),
        Shape::cone(0.6, 0.5),
        Shape::RoundedCuboid {
            half_extents: Vec3::splat(0.4),
            radius: 0.1,
        },
        Shape::Hull(hull),
        Shape::Compound(Compound::new(parts).expect("two parts")),
        Shape::Heights(Heights::new(8, 1.0, 1.0, &posts).expect("a field")),
        Shape::Mesh(Mesh::new(&corners, &triangles).expect("a sheet")),
        Shape::HalfSpace { normal: Vec3::Y },
    ]
}

/// A body: shape, kind, place, turn, velocity, and whether it is a sensor and in the second group.
type Body = (u32, u8, [f32; 3], [f32; 3], [f32; 3], (bool, bool));

fn vector(most: f32) -> impl Strategy<Value = [f32; 3]> {
    proptest::array::uniform3(-most..most)
}

fn body() -> impl Strategy<Value = Body> {
    let flags = (prop::bool::weighted(0.1), any::<bool>());
    let turn = vector(3.0);
    (0_u32..11, 0_u8..4, vector(5.0), turn, vector(3.0), flags)
}

fn add(index: u32, (shape, kind, at, turn, linear, (sensor, second)): Body) -> Command {
    let kind = match kind {
        _ if shape >= 8 => BodyKind::Fixed,
        0 => BodyKind::Fixed,
        1 => BodyKind::Kinematic,
        _ => BodyKind::Dynamic,
    };
    let mut desc = BodyDesc::plain(BodyId::new(index, 0), kind, ShapeId(shape));
    desc.sensor = sensor;
    desc.groups = CollisionGroups {
        members: 1 << u32::from(second),
        ..CollisionGroups::ALL
    };
    let moves = kind != BodyKind::Fixed;
    // A half-space far below, so that not everything is inside it.
    let at = if shape == 10 { [0.0, -20.0, 0.0] } else { at };
    let turn = if shape == 10 { [0.0; 3] } else { turn };
    let rotation = Quat::from_scaled_axis(Vec3::from_array(turn)).to_array();
    let linear = if moves { linear } else { [0.0; 3] };
    let motion = BodyState::new(at, rotation, linear, [0.0; 3]).expect("finite");
    Command::AddBody { desc, motion }
}

fn query() -> impl Strategy<Value = Query> {
    let simple = (0_usize..6).prop_map(|shape| shapes()[shape].clone());
    let turn = vector(3.0).prop_map(|turn| Quat::from_scaled_axis(Vec3::from_array(turn)));
    let kind = (0_u8..4, vector(6.0), vector(12.0), simple, turn);
    let filter = (prop::array::uniform4(prop::bool::weighted(0.8)), 0_u32..4);
    let except = prop::option::of(0_u32..20);
    (kind, filter, except, 1_u8..65).prop_map(|(kind, (takes, groups), except, hits)| {
        let (kind, at, way, shape, turn) = kind;
        let (at, way) = (Vec3::from_array(at), Vec3::from_array(way));
        let query = match kind {
            0 => Query::ray(at, way),
            1 => Query::shape_cast(shape, at, turn, way),
            2 => Query::projection(at, way.length()),
            _ => return Query::overlap(shape, at, turn).among(filter_of(takes, groups, except)),
        };
        let filter = filter_of(takes, groups, except);
        query.among(filter).finding(hits)
    })
}

fn filter_of(takes: [bool; 4], groups: u32, except: Option<u32>) -> QueryFilter {
    QueryFilter {
        with_fixed: takes[0],
        with_dynamic: takes[1],
        with_kinematic: takes[2],
        with_sensors: !takes[3],
        except: except.map(|index| BodyId::new(index, 0)),
        groups: if groups == 0 { u32::MAX } else { groups },
    }
}

/// A member of a scene with these bodies, some steps later, and what its copy shows at that tick.
fn scene(bodies: &[Body], choice: StreamChoice, steps: u64) -> (Table, Peer, LiveView) {
    let mut table = Table::default();
    let peer = table.create("hall", SceneConfig::default(), choice);
    let now = table.now();
    let session = table.session(peer);
    let shapes = (0..).zip(shapes()).map(|(id, shape)| Command::AddShape {
        id: ShapeId(id),
        shape,
    });
    let bodies = (0..).zip(bodies).map(|(index, body)| add(index, *body));
    for command in shapes.chain(bodies) {
        session.command(command).expect("a valid command");
    }
    session.advance(now, Tick::new(steps)).expect("a member");
    table.run_until_idle();
    let options = ViewOptions {
        delay_ticks: 0.0,
        whole_ticks: false,
        smooth: false,
    };
    let mut view = LiveView::new(SceneConfig::default(), options);
    let session = table.session(peer);
    while let Some(event) = session.poll_event() {
        assert!(!matches!(event, Event::Refused { .. }), "{event:?}");
    }
    view.show(session, now, RenderTime::at(Tick::new(steps)), false);
    (table, peer, view)
}

/// Answers of the server, and of the copy.
fn both(
    (mut table, peer, view): (Table, Peer, LiveView),
    queries: &[Query],
) -> (Vec<Answer>, Vec<CopyAnswer>) {
    let session = table.session(peer);
    let number = session.query(queries.to_vec()).expect("valid queries");
    table.run_until_idle();
    let session = table.session(peer);
    let result = std::iter::from_fn(|| session.poll_event()).find_map(|event| match event {
        Event::QueryResult(result) if result.number == number => Some(result),
        _ => None,
    });
    let result = result.expect("it is answered");
    let mut copy = CopyQueries::default();
    assert_eq!(Some(result.tick), view.view().time().map(|at| at.tick));
    copy.refresh(&view, session);
    let answers = copy.answer(queries, &view, session);
    let answers = answers.expect("valid queries");
    (result.answers.expect("the scene has time"), answers)
}

fn assert_alike(remote: &Answer, copied: &CopyAnswer, query: &Query) {
    match (remote, &copied.answer) {
        (Answer::Bodies(remote), Answer::Bodies(copied)) => assert_eq!(remote, copied, "{query:?}"),
        (Answer::Hits(remote), Answer::Hits(found)) => {
            assert_eq!(remote.len(), found.len(), "{query:?} {remote:?} {found:?}");
            assert_eq!(copied.bounds.len(), found.len());
            for (place, (a, b)) in remote.iter().zip(found).enumerate() {
                let context = format!("{query:?} {a:?} {b:?}");
                assert!((a.distance - b.distance).abs() < ROUNDING, "{context}");
                // Bodies at one distance may come in either order.
                let tied = |hits: &[Hit]| {
                    let near = |other: &Hit| (other.distance - a.distance).abs() < ROUNDING;
                    hits.iter().filter(|hit| near(hit)).count() > 1
                };
                assert!(a.body == b.body || tied(remote), "{place}: {context}");
            }
        }
        _ => panic!("another kind of answer: {remote:?} {copied:?}"),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_copy_of_equal_poses_answers_as_the_server_does(
        bodies in prop::collection::vec(body(), 1..20),
        queries in prop::collection::vec(query(), 1..6),
        steps in 1_u64..40,
    ) {
        let (remote, copied) = both(scene(&bodies, StreamChoice::Full, steps), &queries);
        for ((remote, copied), query) in remote.iter().zip(&copied).zip(&queries) {
            assert_alike(remote, copied, query);
        }
    }

    #[test]
    fn the_distance_to_a_copied_body_is_within_its_bound(
        bodies in prop::collection::vec(body(), 1..12),
        point in vector(6.0),
        steps in 1_u64..40,
    ) {
        let query = Query::projection(Vec3::from_array(point), 50.0).finding(64);
        let choice = StreamChoice::Within(Tolerance::NORMAL);
        let queries = [query];
        let (remote, copied) = both(scene(&bodies, choice, steps), &queries);
        let (Answer::Hits(remote), Answer::Hits(found)) = (&remote[0], &copied[0].answer) else {
            panic!("not the answers to a projection");
        };
        for (hit, bound) in found.iter().zip(&copied[0].bounds) {
            let ErrorBound::Within(bound) = bound else {
                panic!("nothing was lost: {bound:?}");
            };
            let true_hit = remote.iter().find(|other| other.body == hit.body);
            let distance = true_hit.expect("all bodies are found").distance;
            let off = f64::from((hit.distance - distance).abs());
            // Outside a body its distance moves no more than the body; inside, the nearest face may be another one.
            if hit.distance > 0.0 && distance > 0.0 {
                prop_assert!(off <= bound.metres() + f64::from(ROUNDING), "{hit:?} {distance}");
            }
        }
    }
}

#[test]
fn a_copy_follows_its_bodies() {
    let above = |x: f32| Query::ray(Vec3::new(x, 10.0, 0.0), Vec3::new(0.0, -20.0, 0.0));
    let ball = |x: f32| (0, 0, [x, 0.0, 0.0], [0.0; 3], [0.0; 3], (false, false));
    let (mut table, peer, mut view) = scene(&[ball(0.0), ball(3.0)], StreamChoice::Full, 1);
    let mut copy = CopyQueries::default();
    let mut find = |table: &mut Table, view: &LiveView, x: f32| {
        let session = table.session(peer);
        copy.refresh(view, session);
        let answers = copy.answer(&[above(x)], view, session).expect("valid");
        match &answers[0].answer {
            Answer::Hits(hits) => hits.first().map(|hit| hit.body.index()),
            Answer::Bodies(_) => None,
        }
    };
    assert_eq!(find(&mut table, &view, 0.0), Some(0));
    let step = |table: &mut Table, view: &mut LiveView, tick: u64, command: Command| {
        let now = table.now();
        let session = table.session(peer);
        session.command(command).expect("a valid command");
        session.advance(now, Tick::new(tick)).expect("a member");
        table.run_until_idle();
        let session = table.session(peer);
        while session.poll_event().is_some() {}
        view.show(session, now, RenderTime::at(Tick::new(tick)), false);
    };
    let first = BodyId::new(0, 0);
    let position = Vec3::X * 6.0;
    let rotation = Quat::IDENTITY;
    let id = first;
    step(
        &mut table,
        &mut view,
        2,
        Command::SetPose {
            id,
            position,
            rotation,
        },
    );
    assert_eq!(find(&mut table, &view, 0.0), None);
    assert_eq!(find(&mut table, &view, 6.0), Some(0));
    let mut desc = BodyDesc::plain(first, BodyKind::Fixed, ShapeId(1));
    desc.enabled = false;
    step(&mut table, &mut view, 3, Command::ChangeBody { desc });
    assert_eq!(find(&mut table, &view, 6.0), None, "disabled");
    step(
        &mut table,
        &mut view,
        4,
        Command::RemoveBody {
            id: BodyId::new(1, 0),
        },
    );
    assert_eq!(find(&mut table, &view, 3.0), None, "removed");
    let wrong = [above(f32::NAN)];
    let session = table.session(peer);
    assert!(copy.answer(&wrong, &view, session).is_err());
}
