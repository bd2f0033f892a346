//! Events of a scene, as dictionaries of Godot.

use godot::builtin::{VarDictionary, Variant, vdict};
use godot::meta::ToGodot as _;
use godot::obj::Gd;
use rhumb_bindings::{EventRecord, body_word};
use rhumb_client::BodyId;

use crate::axes::vector;
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
    let word = |id: Option<BodyId>| id.map_or(0, |id| body_word(id) as i64);
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
