//! The client gives out ids, sends none that no scene has, and removes shapes.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_client::scene::{
    BodyDesc, Command, IdOutOfRange, Joint, JointFrame, JointId, JointKind, Query, QueryFilter,
    Shape, ShapeId,
};
use rhumb_client::{BodyId, Client, ClientError, Event, PipelineDepth, Tolerance, Trust};
use rhumb_protocol::limits::{INDICES_MAX, JOINTS_MAX, SHAPES_MAX};
use rhumb_reckoning::Tick;
use rhumb_tests::ServerProcess;

use crate::SERVER;

fn join(server: &ServerProcess) -> Client {
    let trust = Trust::Fingerprint(server.fingerprint);
    let connection =
        Client::connect(&server.address.to_string(), trust).expect("the server is there");
    connection.join("pit").expect("the scene is made")
}

fn is_refused(client: &mut Client) -> bool {
    std::iter::from_fn(|| client.poll_event())
        .any(|(_, event)| matches!(event, Event::Refused { .. }))
}

#[test]
fn two_clients_that_add_equal_bodies_at_once_share_the_shapes_and_no_ids() {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut one, mut other) = (join(&server), join(&server));
    let ball = BodyDesc::dynamic(Shape::ball(0.5));
    let mut ids = one
        .add_bodies((0..2).map(|x| ball.clone().at(x as f32 * 2.0, 5.0, 0.0)))
        .unwrap();
    ids.push(other.add_body(ball.at(8.0, 5.0, 0.0)).unwrap());
    one.flush();
    other.flush();
    // For each body the last view without it and the first one with it.
    let mut first_views = BTreeMap::new();
    let mut last = Tick::ZERO;
    while first_views.len() < ids.len() {
        let shown = one.advance(PipelineDepth::LOCKSTEP).unwrap();
        for id in one.view().ids() {
            first_views.entry(*id).or_insert((last, shown));
        }
        last = shown;
    }
    let copy = one.replica().unwrap();
    let shapes = ids.iter().map(|id| copy.body(*id).unwrap().shape);
    assert_eq!(shapes.collect::<BTreeSet<_>>().len(), 1);
    let placed: Vec<BodyId> = std::iter::from_fn(|| one.poll_event())
        .filter_map(|(after, event)| match event {
            Event::BodyPlaced(id) => {
                // The event of the other client's body may arrive together with the datagram that completes the
                // shown tick: then the view of that same tick has the body.
                let (before, shown) = first_views[&id];
                assert!(
                    before <= after && after <= shown,
                    "{id} came after {after}, shown at {shown} and not at {before}"
                );
                Some(id)
            }
            Event::Refused { error, .. } => panic!("{error}"),
            _ => None,
        })
        .collect();
    assert_eq!(placed.len(), ids.len());
    // An index whose body is gone is given out again, under another generation.
    one.command(Command::RemoveBody { id: ids[0] }).unwrap();
    one.advance(PipelineDepth::LOCKSTEP).unwrap();
    assert_eq!(one.view().position(ids[0]), None);
    let given = one.new_ids(4_096).unwrap();
    assert!(given.iter().all(|id| !ids.contains(id)));
    other.wait(PipelineDepth::LOCKSTEP).unwrap();
    assert!(!is_refused(&mut other), "an equal shape is no fault");
}

#[test]
fn a_shape_leaves_with_its_last_body_unless_another_client_uses_it() {
    let server = SERVER.serve("127.0.0.1:0");
    let (mut one, mut other) = (join(&server), join(&server));
    let (ball, stone) = (Shape::ball(0.5), Shape::cuboid(1.0, 2.0, 3.0));
    let fixed = |shape: &Shape| BodyDesc::fixed(shape.clone());
    let bodies = one.add_bodies([fixed(&ball), fixed(&stone)]).unwrap();
    assert_eq!(
        one.remove_unused_shapes().unwrap(),
        0,
        "bodies on their way have them"
    );
    one.advance(PipelineDepth::LOCKSTEP).unwrap();
    other.wait(PipelineDepth::LOCKSTEP).unwrap();
    let shapes = bodies
        .iter()
        .map(|id| one.replica().unwrap().body(*id).unwrap().shape);
    let [ball_id, stone_id] = shapes.collect::<Vec<_>>()[..] else {
        panic!("two bodies have two shapes");
    };
    // The other client's ball is placed before the first one knows of it.
    other.add_body(fixed(&ball)).unwrap();
    other.inspect().unwrap();
    for id in &bodies {
        one.command(Command::RemoveBody { id: *id }).unwrap();
    }
    assert_eq!(
        other.remove_unused_shapes().unwrap(),
        0,
        "it did not add the shapes"
    );
    assert_eq!(one.remove_unused_shapes().unwrap(), 2);
    one.advance(PipelineDepth::LOCKSTEP).unwrap();
    let copy = one.replica().unwrap();
    assert_eq!(copy.shape(ball_id), Some(&ball));
    assert_eq!(copy.shape(stone_id), None);
    // Removed and added again in one breath.
    let again = one.add_body(fixed(&stone)).unwrap();
    one.advance(PipelineDepth::LOCKSTEP).unwrap();
    one.command(Command::RemoveBody { id: again }).unwrap();
    assert_eq!(one.remove_unused_shapes().unwrap(), 1);
    let last = one.add_body(fixed(&stone)).unwrap();
    one.advance(PipelineDepth::LOCKSTEP).unwrap();
    let copy = one.replica().unwrap();
    assert_eq!(copy.body(last).map(|desc| desc.shape), Some(stone_id));
    assert_eq!(copy.shape(stone_id), Some(&stone));
    assert!(!is_refused(&mut one), "a shape that is in use is no fault");
}

#[test]
fn an_id_that_no_scene_can_have_is_an_error_and_the_connection_continues() {
    let server = SERVER.serve("127.0.0.1:0");
    let mut client = join(&server);
    let ball = client
        .add_body(BodyDesc::dynamic(Shape::ball(0.5)))
        .unwrap();
    let body = BodyId::new(INDICES_MAX, 0);
    let (shape, joint) = (ShapeId(SHAPES_MAX), JointId(JOINTS_MAX));
    let fixed = |bodies| {
        let frames = [JointFrame::at(glam::Vec3::ZERO); 2];
        Box::new(Joint::plain(JointKind::Fixed, bodies, frames))
    };
    let wrong = [
        (Command::RemoveBody { id: body }, IdOutOfRange::Body(body)),
        (
            Command::RemoveShape { id: shape },
            IdOutOfRange::Shape(shape),
        ),
        (
            Command::RemoveJoint { id: joint },
            IdOutOfRange::Joint(joint),
        ),
        (
            Command::AddJoint {
                id: JointId(0),
                joint: fixed([ball, body]),
            },
            IdOutOfRange::Body(body),
        ),
    ];
    for (command, expected) in wrong {
        let error = client.command(command).unwrap_err();
        assert!(
            matches!(error, ClientError::Id(id) if id == expected),
            "{error}"
        );
    }
    let filter = QueryFilter {
        except: Some(body),
        ..QueryFilter::DEFAULT
    };
    let ray = Query::ray(glam::Vec3::ZERO, glam::Vec3::Y).among(filter);
    let error = client.query(vec![ray]).unwrap_err();
    assert!(matches!(error, ClientError::Id(_)), "{error}");
    let taken = client.take_authority(&[ball, body], Tolerance::NORMAL);
    let error = taken.unwrap_err();
    assert!(matches!(error, ClientError::Id(_)), "{error}");
    client.advance(PipelineDepth::LOCKSTEP).unwrap();
    assert!(client.view().position(ball).is_some());
    assert!(!is_refused(&mut client), "nothing of them was sent");
}
