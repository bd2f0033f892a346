//! The client gives out ids of bodies and shapes, and never one twice.
//!
//! Proved with two clients that add bodies of equal shapes to one scene of a server process at the same time.

use std::collections::{BTreeMap, BTreeSet};

use rhumb_client::scene::{BodyDesc, Command, Shape};
use rhumb_client::{BodyId, Client, Event, PipelineDepth, Trust};
use rhumb_reckoning::Tick;

use crate::SERVER;

#[test]
fn two_clients_that_add_equal_bodies_at_once_share_the_shapes_and_no_ids() {
    let server = SERVER.serve("127.0.0.1:0");
    let join = || {
        let trust = Trust::Fingerprint(server.fingerprint);
        let connection = Client::connect(&server.address.to_string(), trust).unwrap();
        connection.join("pit").unwrap()
    };
    let (mut one, mut other) = (join(), join());
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
    let refused = std::iter::from_fn(|| other.poll_event())
        .any(|(_, event)| matches!(event, Event::Refused { .. }));
    assert!(!refused, "an equal shape is no fault");
}
