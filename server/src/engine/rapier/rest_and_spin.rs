//! Bodies of a Rapier world between its steps: rest that is no rest, and spin.
//!
//! Rapier lets a body sleep once no point of it has been faster than 0.1 m/s for half a second, whatever moves it. By the
//! rule `Settled` that is not enough: its time begins anew while it moves without support, while a motor drives it, and
//! while it gains speed. Nothing here makes a body sleep.
//!
//! Rapier's own gyroscopic step drives a spin towards the axis of the middle moment and changes its energy, so it stays
//! off; predictors take the same steps as this file (RECKONING 3.7). A free body gets half of its precession before a
//! step and half behind it. One that touches something or has a joint gets all of it before: the solver has the last word.

use glam::{Quat, Vec3};
use rapier3d::prelude::{PhysicsWorld, RigidBody, RigidBodyHandle};
use rhumb_protocol::limits::INDICES_MAX;
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{Inertia, Integrator, precessed};

use super::locomotion::RapierVehicles;
use super::{body as translate, reports};
use crate::engine::interface::SPIN_MAX;

/// A body without a contact or a joint, and one whose motor holds a position, moves above this: m/s and rad/s.
const FREE: f32 = 1e-4;
/// A body that hangs on joints, or touches others where no gravity presses it on them, moves above this.
const HUNG: f32 = 1e-3;
/// A supported body that gains speed must have this much, m/s: piles that settle tremble below it.
const GAINING: f32 = 2e-3;
/// Time for which a supported body must gain speed in each step, seconds. Shorter than Rapier's half second.
const GAINING_SECONDS: f32 = 0.35;
/// Least gain of speed in a step, and greatest loss of a body that sinks steadily, as a share.
const STEADY: f32 = 1e-4;
/// Speed at which a body sinks that gravity moves, m/s.
const SINKING: f32 = 2e-4;

/// The rule, and what it remembers of each body.
#[derive(Clone, Debug, Default)]
pub(super) struct RapierRest {
    /// Steps for which a slow body has gained speed, by its index.
    gaining: Vec<u16>,
    /// The slow bodies of this step.
    slow: Vec<SlowBody>,
}

/// A slow body before a step.
#[derive(Clone, Copy, Debug)]
struct SlowBody {
    index: usize,
    handle: RigidBodyHandle,
    position: Vec3,
    rotation: Quat,
    speed: f32,
}

impl RapierRest {
    /// Notes an awake body if it is slow, before a step.
    pub(super) fn before(&mut self, index: u32, handle: RigidBodyHandle, body: &RigidBody) {
        let index = index as usize;
        if body.is_dynamic() && body.activation().time_since_can_sleep > 0.0 {
            self.slow.push(SlowBody {
                index,
                handle,
                position: body.translation(),
                rotation: *body.rotation(),
                speed: body.linvel().length(),
            });
        } else if let Some(gaining) = self.gaining.get_mut(index) {
            *gaining = 0;
        }
    }

    /// Restarts the sleep timer of slow bodies that something still moves, after a step.
    pub(super) fn after(&mut self, world: &mut PhysicsWorld, vehicles: &RapierVehicles) {
        for slow in self.slow.drain(..) {
            let Some(body) = world.bodies.get(slow.handle) else {
                continue;
            };
            if body.is_sleeping() || !body.is_dynamic() {
                continue;
            }
            let is_moved = if translate::sleeps_settled(body) {
                is_moved(world, vehicles, &slow, body, &mut self.gaining)
            } else {
                body.angvel().length() > body.activation().angular_threshold.abs()
            };
            if is_moved {
                world.bodies[slow.handle]
                    .activation_mut()
                    .time_since_can_sleep = 0.0;
            }
        }
    }
}

fn is_moved(
    world: &PhysicsWorld,
    vehicles: &RapierVehicles,
    slow: &SlowBody,
    body: &RigidBody,
    gaining: &mut Vec<u16>,
) -> bool {
    let dt = world.integration_parameters.dt;
    let pull = translate::pull(body, world.gravity);
    let id = translate::id(body);
    let drives = vehicles.drives(id);
    let has_joints = reports::has_joints(world, slow.handle);
    if !has_joints && drives.is_none() && !reports::is_touched(world, body) {
        return pull != Vec3::ZERO || fastest(body) > FREE;
    }
    // A body that is held in place may have a velocity that the solver takes back, and a place that trembles.
    let moves = fastest(body).min(drift(slow, body) / dt);
    if has_joints {
        let motor = reports::motor(world, slow.handle);
        if motor == Some(reports::Drive::Velocity) || motor.is_some() && moves > FREE {
            return true;
        }
    }
    let is_supported = drives.is_some() || reports::is_supported(world, slow.handle, body);
    if !is_supported || pull == Vec3::ZERO {
        return moves > HUNG;
    }
    if drives == Some(true) && moves > HUNG {
        return true;
    }
    let (before, now) = (slow.speed, body.linvel().length());
    let sinks = body.linvel().dot(pull.normalize_or_zero()) > SINKING;
    let gains = now > before * (1.0 + STEADY) || sinks && now > before * (1.0 - STEADY);
    if gaining.len() <= slow.index {
        gaining.resize(slow.index + 1, 0);
    }
    let steps = &mut gaining[slow.index];
    *steps = match gains && moves > GAINING {
        true => steps.saturating_add(1),
        false => 0,
    };
    f32::from(*steps) * dt > GAINING_SECONDS
}

/// The greater of the linear speed, m/s, and the angular one, rad/s.
fn fastest(body: &RigidBody) -> f32 {
    body.linvel().length().max(body.angvel().length())
}

/// The greater of the distance, metres, and the turn, radians, in a step.
fn drift(slow: &SlowBody, body: &RigidBody) -> f32 {
    let turned = *body.rotation();
    let chord = |other: Quat| (turned - other).length();
    let turn = 2.0 * chord(slow.rotation).min(chord(-slow.rotation));
    body.translation().distance(slow.position).max(turn)
}

impl Wire for RapierRest {
    fn encode(&self, to: &mut Writer) {
        let gaining = || {
            self.gaining
                .iter()
                .enumerate()
                .filter(|(_, steps)| **steps > 0)
        };
        to.varint(gaining().count() as u64);
        for (index, steps) in gaining() {
            to.varint(index as u64);
            to.varint(u64::from(*steps));
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let mut rest = Self::default();
        for _ in 0..from.varint()? {
            let (index, steps) = (from.varint32()?, from.varint32()?);
            if index >= INDICES_MAX {
                return Err(Malformed::OutOfRange);
            }
            let steps = u16::try_from(steps).map_err(|_| Malformed::OutOfRange)?;
            let index = index as usize;
            if rest.gaining.len() <= index {
                rest.gaining.resize(index + 1, 0);
            }
            rest.gaining[index] = steps;
        }
        Ok(rest)
    }
}

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
