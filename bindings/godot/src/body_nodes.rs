//! Adds the bodies of nodes to a scene, and gives bodies their nodes.

use godot::classes::Engine;
use godot::classes::node::PhysicsInterpolationMode;
use godot::prelude::*;
use rhumb_bindings::StateRecord;
use rhumb_client::scene::Stepping;

use crate::body::{BodyNode, SharedMembership};
use crate::membership::outcome;

/// Sets the node of a body that is shown from now on.
pub(crate) fn set_node(membership: &SharedMembership, state: &StateRecord, body: &Gd<BodyNode>) {
    let is_free_running = {
        let follower = &mut membership.borrow_mut().follower;
        follower.set_object(state.body, body.clone());
        follower.stepping() == Stepping::FreeRunning
    };
    if is_free_running {
        // It is moved in each frame, not in each physics frame.
        let mut body = body.clone();
        body.set_physics_interpolation_mode(PhysicsInterpolationMode::OFF);
    }
}

/// Queues the bodies of nodes. A node without a good description is left out, and an error says why.
pub(crate) fn add(membership: &SharedMembership, nodes: Vec<Gd<BodyNode>>) {
    let material = membership.borrow().client.config().material;
    let (mut builders, mut described) = (Vec::new(), Vec::new());
    for node in nodes {
        let description = node.bind().builder(material);
        match description {
            Ok((builder, origin)) => {
                builders.push(builder);
                described.push((node, origin));
            }
            Err(error) => godot_error!("{}: {error}", node.get_name()),
        }
    }
    let added = membership.borrow_mut().client.add_bodies(builders);
    match added {
        Ok(ids) => {
            for (id, (mut node, origin)) in ids.into_iter().zip(described) {
                node.bind_mut().stand_for(membership, id, origin);
                membership.borrow_mut().follower.reserve(id, node);
            }
        }
        Err(error) => {
            outcome("the bodies of the children were not added", Err(error));
        }
    }
}

/// A lockstep scene and Godot's physics frames should take the same time.
pub(crate) fn warn_of_other_rate(membership: &SharedMembership) {
    let (stepping, step) = {
        let membership = membership.borrow();
        (
            membership.follower.stepping(),
            membership.follower.fixed_step(),
        )
    };
    let own = 1.0 / f64::from(Engine::singleton().get_physics_ticks_per_second());
    if stepping == Stepping::Lockstep && (step.as_secs_f64() - own).abs() > 1e-6 {
        godot_warn!(
            "a tick of the scene takes {} s and a physics frame {own} s: set physics/common/physics_ticks_per_second",
            step.as_secs_f64()
        );
    }
}
