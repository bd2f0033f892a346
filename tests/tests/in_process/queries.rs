//! Queries over the wire: what they find, and who may ask how much.
//!
//! The scene is a floor, a ball that stands on it, a lift, and a row of posts. Expected answers are computed by hand.

use glam::{Quat, Vec3};
use rhumb_protocol::message::{QueryError, QueryResult, StreamChoice};
use rhumb_protocol::scene::{
    Answer, BodyDesc, BodyKind, Command, Hit, Invalid, Quantity, Query, QueryFilter, SceneConfig,
    Shape, ShapeId, Stepping,
};
use rhumb_protocol::session::{Event, Misuse};
use rhumb_protocol::{Peer, Span};
use rhumb_reckoning::{BodyId, BodyState, Tick};
use rhumb_tests::Table;

const FLOOR: BodyId = BodyId::new(0, 0);
const BALL: BodyId = BodyId::new(1, 0);
const LIFT: BodyId = BodyId::new(2, 0);
const FIRST_POST: u32 = 10;
const POSTS: u32 = 100;

/// Metres: what an engine's geometry may be off.
const SLACK: f32 = 2e-3;

fn post(number: u32) -> BodyId {
    BodyId::new(FIRST_POST + number, 0)
}

fn state(x: f32, y: f32, z: f32) -> BodyState {
    BodyState::new([x, y, z], [0.0, 0.0, 0.0, 1.0], [0.0; 3], [0.0; 3]).expect("finite")
}

/// The commands that add the scene's bodies.
fn scenery() -> Vec<Command> {
    let shapes = [
        Shape::cuboid(50.0, 0.5, 50.0),
        Shape::ball(0.5),
        Shape::cuboid(1.0, 0.1, 1.0),
        Shape::cuboid(0.1, 1.0, 0.1),
    ];
    let shapes = (0..).zip(shapes).map(|(id, shape)| Command::AddShape {
        id: ShapeId(id),
        shape,
    });
    let add = |id, kind, shape, motion| Command::AddBody {
        desc: BodyDesc::plain(id, kind, ShapeId(shape)),
        motion,
    };
    let bodies = [
        add(FLOOR, BodyKind::Fixed, 0, state(0.0, -0.5, 0.0)),
        add(BALL, BodyKind::Dynamic, 1, state(0.0, 0.5, 0.0)),
        add(LIFT, BodyKind::Kinematic, 2, state(5.0, 3.0, 0.0)),
    ];
    let posts = (0..POSTS).map(|number| {
        let at = state(number as f32, 1.0, 20.0);
        add(post(number), BodyKind::Fixed, 3, at)
    });
    shapes.chain(bodies).chain(posts).collect()
}

/// A member of a new scene with the scenery, after its first step.
fn member(table: &mut Table, stepping: Stepping) -> Peer {
    let peer = table.connect("hall");
    let config = SceneConfig {
        stepping,
        ..SceneConfig::default()
    };
    let session = table.session(peer);
    session.create(config).expect("in the lobby");
    session.join(StreamChoice::Full).expect("in the lobby");
    table.run_until_idle();
    let now = table.now();
    let session = table.session(peer);
    for command in scenery() {
        session.command(command).expect("a valid command");
    }
    if stepping == Stepping::Lockstep {
        session.advance(now, Tick::new(1)).expect("a member");
        table.run_until_idle();
    } else {
        table.run_until_idle();
        table.pass(Span::from_millis(17));
    }
    peer
}

/// Sends queries in one message, and returns their result.
fn asked(table: &mut Table, peer: Peer, queries: Vec<Query>) -> QueryResult {
    let number = table.session(peer).query(queries).expect("valid queries");
    table.run_until_idle();
    let session = table.session(peer);
    let mut events = std::iter::from_fn(|| session.poll_event());
    let result = events.find_map(|event| match event {
        Event::QueryResult(result) if result.number == number => Some(result),
        _ => None,
    });
    result.expect("each message of queries is answered")
}

/// The answers to queries that are answered.
fn answers(table: &mut Table, peer: Peer, queries: Vec<Query>) -> Vec<Answer> {
    asked(table, peer, queries)
        .answers
        .expect("the scene has time")
}

fn hits(answer: &Answer) -> &[Hit] {
    match answer {
        Answer::Hits(hits) => hits,
        Answer::Bodies(_) => panic!("not the answer to an overlap"),
    }
}

fn found(answer: &Answer) -> Vec<BodyId> {
    match answer {
        Answer::Hits(hits) => hits.iter().map(|hit| hit.body).collect(),
        Answer::Bodies(bodies) => bodies.clone(),
    }
}

fn is_near(hit: &Hit, distance: f32, point: Vec3, normal: Vec3) {
    assert!((hit.distance - distance).abs() < SLACK, "{hit:?}");
    assert!(hit.point.distance(point) < SLACK, "{hit:?}");
    assert!(hit.normal.distance(normal) < SLACK, "{hit:?}");
}

#[test]
fn a_ray_finds_the_nearest_bodies_on_its_way() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let (above, down) = (Vec3::new(0.0, 10.0, 0.0), Vec3::new(0.0, -20.0, 0.0));
    let down_to = |metres: f32| Vec3::new(0.0, -metres, 0.0);
    let inside = Vec3::new(5.0, 3.0, 0.0);
    let queries = vec![
        Query::ray(above, down).finding(64),
        Query::ray(above, down),
        Query::ray(above, down_to(8.9)),
        Query::ray(above, down_to(9.1)),
        Query::ray(inside, down),
    ];
    let answers = answers(&mut table, peer, queries);
    assert_eq!(found(&answers[0]), [BALL, FLOOR]);
    let [ball, floor] = hits(&answers[0]) else {
        panic!("two hits");
    };
    is_near(ball, 9.0, Vec3::Y, Vec3::Y);
    is_near(floor, 10.0, Vec3::ZERO, Vec3::Y);
    assert_eq!(found(&answers[1]), [BALL]);
    assert_eq!(found(&answers[2]), []);
    assert_eq!(found(&answers[3]), [BALL]);
    is_near(&hits(&answers[4])[0], 0.0, inside, Vec3::ZERO);
}

#[test]
fn a_ray_that_leads_nowhere_is_refused_before_it_is_sent() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let nowhere = Query::ray(Vec3::Y, Vec3::ZERO);
    let refused = table.session(peer).query(vec![nowhere]);
    let reason = refused.expect_err("it leads nowhere").to_string();
    assert!(
        reason.contains("the translation of a ray is zero"),
        "{reason}"
    );
}

#[test]
fn a_shape_cast_finds_what_the_shape_touches() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let cast = |x: f32, shape| {
        let (from, way) = (Vec3::new(x, 10.0, 0.0), Vec3::new(0.0, -20.0, 0.0));
        Query::shape_cast(shape, from, Quat::IDENTITY, way)
    };
    let queries = vec![
        cast(0.0, Shape::ball(0.25)),
        cast(0.7, Shape::ball(0.25)),
        cast(2.9, Shape::cuboid(1.0, 0.5, 1.0)).finding(3),
        cast(3.5, Shape::cuboid(1.0, 0.5, 1.0)).finding(3),
    ];
    let answers = answers(&mut table, peer, queries);
    is_near(&hits(&answers[0])[0], 8.75, Vec3::Y, Vec3::Y);
    // Beside the ball's highest point: the ball is touched at a slope.
    let beside = hits(&answers[1])[0];
    assert_eq!(beside.body, BALL);
    let height = (0.75_f32 * 0.75 - 0.7 * 0.7).sqrt();
    assert!(
        (beside.distance - (9.5 - height)).abs() < SLACK,
        "{beside:?}"
    );
    assert_eq!(found(&answers[2]), [FLOOR]);
    assert_eq!(found(&answers[3]), [LIFT, FLOOR]);
}

#[test]
fn contacts_are_those_of_the_step_from_the_side_of_the_body() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let no_fixed = QueryFilter {
        with_fixed: false,
        ..QueryFilter::DEFAULT
    };
    let asked = vec![
        Query::contacts(BALL),
        Query::contacts(FLOOR),
        Query::contacts(LIFT),
        Query::contacts(BALL).among(no_fixed),
    ];
    let found = answers(&mut table, peer, asked);
    let [of_ball, of_floor, of_lift, among] = &found[..] else {
        panic!("an answer for each query, not {found:?}");
    };
    let [on_floor] = hits(of_ball) else {
        panic!("the ball touches the floor alone, not {of_ball:?}");
    };
    assert_eq!(on_floor.body, FLOOR);
    assert!(on_floor.normal.distance(Vec3::Y) < SLACK, "{on_floor:?}");
    assert!(on_floor.point.length() < 0.02, "{on_floor:?}");
    let of_the_ball = hits(of_floor).iter().find(|hit| hit.body == BALL);
    let normal = of_the_ball.expect("the floor touches the ball").normal;
    assert!(normal.distance(Vec3::NEG_Y) < SLACK, "{normal}");
    assert!(hits(of_lift).is_empty() && hits(among).is_empty());
}

#[test]
fn a_projection_finds_the_nearest_surface() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let queries = vec![
        Query::projection(Vec3::new(0.0, 1.5, 0.0), 2.0).finding(2),
        Query::projection(Vec3::new(0.0, 1.5, 0.0), 0.4),
        Query::projection(Vec3::new(0.0, 0.8, 0.0), 0.0),
        Query::projection(Vec3::new(0.0, 0.5, 0.0), 100.0),
    ];
    let answers = answers(&mut table, peer, queries);
    assert_eq!(found(&answers[0]), [BALL, FLOOR]);
    is_near(&hits(&answers[0])[0], 0.5, Vec3::Y, Vec3::Y);
    is_near(&hits(&answers[0])[1], 1.5, Vec3::ZERO, Vec3::Y);
    assert_eq!(found(&answers[1]), []);
    // Inside the ball: the distance is negative, and the normal points outward.
    is_near(&hits(&answers[2])[0], -0.2, Vec3::Y, Vec3::Y);
    // The centre of the ball, to which all its surface is equally near.
    let centre = &hits(&answers[3])[0];
    assert_eq!(found(&answers[3]), [BALL]);
    is_near(centre, -0.5, Vec3::Y, Vec3::Y);
}

#[test]
fn an_overlap_finds_bodies_in_the_order_of_ids() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let around = |x: f32, size: f32| {
        let shape = Shape::cuboid(size, 1.0, 1.0);
        Query::overlap(shape, Vec3::new(x, 1.5, 20.0), Quat::IDENTITY)
    };
    let queries = vec![
        around(5.0, 1.2),
        around(50.0, 60.0),
        around(5.0, 1.2).finding(2),
    ];
    let answers = answers(&mut table, peer, queries);
    assert_eq!(found(&answers[0]), [post(4), post(5), post(6)]);
    // As many as were asked for: there may be more.
    assert_eq!(found(&answers[1]).len(), 64);
    assert_eq!(found(&answers[2]).len(), 2);
}

#[test]
fn a_filter_leaves_bodies_out() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let all = QueryFilter::DEFAULT;
    let down = |x: f32, filter| {
        let (above, down) = (Vec3::new(x, 10.0, 0.0), Vec3::new(0.0, -20.0, 0.0));
        Query::ray(above, down).among(filter).finding(5)
    };
    let without = |with_fixed, with_dynamic, with_kinematic| QueryFilter {
        with_fixed,
        with_dynamic,
        with_kinematic,
        ..all
    };
    let except = QueryFilter {
        except: Some(BALL),
        ..all
    };
    let queries = vec![
        down(0.0, without(false, true, true)),
        down(0.0, without(true, false, true)),
        down(5.0, without(true, true, false)),
        down(5.0, all),
        down(0.0, except),
        down(0.0, QueryFilter { groups: 0, ..all }),
    ];
    let answers = answers(&mut table, peer, queries);
    let found: Vec<_> = answers.iter().map(found).collect();
    assert_eq!(
        found,
        [
            vec![BALL],
            vec![FLOOR],
            vec![FLOOR],
            vec![LIFT, FLOOR],
            vec![FLOOR],
            vec![]
        ]
    );
}

/// The answer belongs to the newest tick at its place among commands and advances.
#[test]
fn an_answer_names_the_tick_whose_poses_it_has() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let now = table.now();
    let ray = || {
        let (from, way) = (Vec3::new(-3.0, 0.5, 0.0), Vec3::new(20.0, 0.0, 0.0));
        vec![Query::ray(from, way)]
    };
    let session = table.session(peer);
    let velocity = Command::SetVelocity {
        id: BALL,
        linear: Vec3::new(6.0, 0.0, 0.0),
        angular: Vec3::ZERO,
    };
    session.command(velocity).expect("a valid command");
    let before = session.query(ray()).expect("valid queries");
    session.advance(now, Tick::new(11)).expect("a member");
    let after = session.query(ray()).expect("valid queries");
    session
        .command(Command::RemoveBody { id: BALL })
        .expect("a valid command");
    let removed = session.query(ray()).expect("valid queries");
    table.run_until_idle();
    let session = table.session(peer);
    let results: Vec<_> = std::iter::from_fn(|| session.poll_event())
        .filter_map(|event| match event {
            Event::QueryResult(result) => Some(result),
            _ => None,
        })
        .collect();
    let numbers: Vec<_> = results.iter().map(|result| result.number).collect();
    assert_eq!(numbers, [before, after, removed]);
    let ticks: Vec<_> = results.iter().map(|result| result.tick.value()).collect();
    assert_eq!(ticks, [1, 11, 11]);
    let distance = |result: &QueryResult| {
        let answers = result.answers.as_ref().expect("a lockstep scene has time");
        hits(&answers[0]).first().map(|hit| hit.distance)
    };
    assert!(distance(&results[0]).is_some_and(|metres| (metres - 2.5).abs() < SLACK));
    assert!(distance(&results[1]).is_some_and(|metres| metres > 3.0));
    assert_eq!(distance(&results[2]), None);
}

#[test]
fn invalid_queries_are_not_sent() {
    let mut table = Table::default();
    let peer = member(&mut table, Stepping::Lockstep);
    let ray = Query::ray(Vec3::ZERO, Vec3::X);
    let session = table.session(peer);
    let nowhere = Query::ray(Vec3::new(f32::NAN, 0.0, 0.0), Vec3::X);
    let far = Query::projection(Vec3::ZERO, -1.0);
    let position = Quantity::Position;
    for (queries, misuse) in [
        (vec![], Misuse::QueryCost(0)),
        (vec![ray.clone().finding(0)], Misuse::Hits(0)),
        (vec![ray.clone().finding(65)], Misuse::Hits(65)),
        (vec![ray; 4_097], Misuse::QueryCost(4_097)),
        (
            vec![nowhere],
            Misuse::Invalid(Invalid::not_finite(position)),
        ),
        (vec![far], Misuse::Invalid(Invalid::out_of_range(position))),
    ] {
        assert_eq!(session.query(queries), Err(misuse));
    }
}

/// A free-running scene answers what a member's share allows and sheds the rest by name; a lockstep scene answers all.
#[test]
fn a_query_beyond_a_members_share_is_refused_by_name() {
    for stepping in [Stepping::FreeRunning, Stepping::Lockstep] {
        let mut table = Table::default();
        let peer = member(&mut table, stepping);
        let other = table.connect("hall");
        let session = table.session(other);
        session.join(StreamChoice::Full).expect("in the lobby");
        table.run_until_idle();
        let flood = vec![Query::ray(Vec3::Y, Vec3::X); 4_096];
        let mut shed = 0;
        for _ in 0..10 {
            let result = asked(&mut table, peer, flood.clone());
            match result.answers {
                Ok(answers) => assert_eq!(answers.len(), flood.len()),
                Err(error) => {
                    assert_eq!(error, QueryError::Overloaded);
                    shed += 1;
                }
            }
        }
        let is_free = stepping == Stepping::FreeRunning;
        assert_eq!(shed, if is_free { 8 } else { 0 });
        // The other member's share is untouched.
        let one = vec![Query::ray(Vec3::Y, Vec3::X)];
        assert_eq!(answers(&mut table, other, one).len(), 1);
        table.pass(Span::from_millis(100));
        let again = asked(&mut table, peer, flood);
        assert!(again.answers.is_ok(), "the share is earned again");
    }
}
