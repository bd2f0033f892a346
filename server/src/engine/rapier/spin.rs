//! Gyroscopic forces of the bodies of a Rapier world, and the greatest spin.
//!
//! Rapier's own gyroscopic step drives a spin towards the axis of the middle moment and changes its energy, so it stays
//! off; predictors take the same steps as this file (RECKONING 3.7). A free body gets half of its precession before a
//! step and half behind it. One that touches something or has a joint gets all of it before: the solver has the last word.

use rapier3d::prelude::{PhysicsWorld, RigidBody, RigidBodyHandle};
use rhumb_reckoning::{Inertia, Integrator, precessed};

use super::body as translate;
use super::reports;
use crate::engine::interface::SPIN_MAX;

/// Change of the spin in a step that a body with contacts or joints does not need, rad/s: the solver changes it by more.
const NEGLIGIBLE: f32 = 1e-6;

/// The bodies that get the other half of their precession behind the step.
#[derive(Debug, Default)]
pub(super) struct RapierSpin {
    free: Vec<(RigidBodyHandle, Inertia)>,
}

impl RapierSpin {
    /// Bounds the spin of an awake body, and precesses it, before a step.
    pub(super) fn before(
        &mut self,
        world: &mut PhysicsWorld,
        handle: RigidBodyHandle,
        integrator: &Integrator,
    ) {
        let Some(body) = world.bodies.get(handle) else {
            return;
        };
        let spin = body.angvel();
        let speed2 = spin.length_squared();
        if speed2 == 0.0 || !body.is_dynamic() {
            return;
        }
        if speed2 > SPIN_MAX * SPIN_MAX {
            let share = translate::share_within(spin, SPIN_MAX);
            world.bodies[handle].set_angvel(spin * share, false);
        }
        let body = &world.bodies[handle];
        if !translate::precesses(body) {
            return;
        }
        let Some(inertia) = translate::inertia(body) else {
            return;
        };
        if reports::is_bound(world, handle, body) {
            if speed2 * world.integration_parameters.dt > NEGLIGIBLE {
                precess(&mut world.bodies[handle], &inertia, integrator, 2);
            }
        } else {
            precess(&mut world.bodies[handle], &inertia, integrator, 1);
            self.free.push((handle, inertia));
        }
    }

    /// Precesses the free bodies for the other half of the step.
    pub(super) fn after(&mut self, world: &mut PhysicsWorld, integrator: &Integrator) {
        for (handle, inertia) in self.free.drain(..) {
            if let Some(body) = world.bodies.get_mut(handle)
                && body.is_dynamic()
                && !body.is_sleeping()
            {
                precess(body, &inertia, integrator, 1);
            }
        }
    }
}

fn precess(body: &mut RigidBody, inertia: &Inertia, integrator: &Integrator, half_ticks: u32) {
    let rotation = translate::widen(body.translation(), *body.rotation()).rotation;
    let angular = body.angvel().as_dvec3();
    let angular = precessed(rotation, angular, inertia, integrator, half_ticks);
    body.set_angvel(angular.as_vec3(), false);
}
