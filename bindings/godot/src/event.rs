//! Events of a scene, as dictionaries of Godot.

use godot::builtin::{VarDictionary, Variant, vdict};
use godot::meta::ToGodot as _;
use godot::obj::Gd;
use rhumb_bindings::{EventKind, EventRecord, packed_id};
use rhumb_client::scene::Answer;
use rhumb_client::{BodyId, QueryError, QueryResult};

use crate::axes::{AXES, vector};
use crate::body::BodyNode;
use crate::membership::SceneMembership;

/// The fields of an event. `body` and `other` are nodes, or null; `body_id` and `other_id` are numbers, or zero.
pub(crate) fn details(
    membership: &SceneMembership<Gd<BodyNode>>,
    record: &EventRecord,
) -> VarDictionary {
    let node = |id: Option<BodyId>| {
        let node = id.and_then(|id| membership.follower.object(id));
        let node = node.filter(|node| node.is_instance_valid());
        node.map_or_else(Variant::nil, Gd::to_variant)
    };
    let word = |id: Option<BodyId>| id.map_or(0, |id| packed_id(id) as i64);
    vdict! {
        "tick" => record.tick.value() as i64,
        "number" => record.number as i64,
        "body" => &node(record.body),
        "body_id" => word(record.body),
        "other" => &node(record.other),
        "other_id" => word(record.other),
        "point" => vector(record.point),
        "normal" => vector(record.normal),
        "separation" => record.separation,
        "force" => record.force,
        "text" => record.text.as_str(),
    }
}

/// The nearest body of the answer to a ray, as in an event, and its `distance`; empty if there is none.
pub(crate) fn ray_hit(
    membership: &SceneMembership<Gd<BodyNode>>,
    result: QueryResult,
) -> Result<VarDictionary, QueryError> {
    let Some(Answer::Hits(hits)) = result.answers?.pop() else {
        return Ok(VarDictionary::new());
    };
    let Some(found) = hits.into_iter().next().map(|hit| AXES.hit_out(hit)) else {
        return Ok(VarDictionary::new());
    };
    let record = EventRecord {
        body: Some(found.body),
        point: found.point,
        normal: found.normal,
        ..EventRecord::plain(EventKind::Other, result.tick)
    };
    let mut hit = details(membership, &record);
    hit.set("distance", found.distance);
    Ok(hit)
}
