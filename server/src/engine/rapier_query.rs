//! Queries in a Rapier world.
//!
//! Reads the world only. Rapier finds colliders and a query finds bodies: a body counts once, by its nearest collider.
//! The tree of colliders is that of the last step.

use glam::Vec3;
use rapier3d::parry::query::details::ShapeCastOptions;
use rapier3d::prelude::{
    Collider, ColliderHandle, PhysicsWorld, QueryFilter as RapierFilter, QueryFilterFlags,
    QueryPipeline, Ray, RigidBodyHandle, SharedShape,
};
use rhumb_protocol::scene::{Answer, Hit, Query, QueryFilter, QueryKind};
use rhumb_reckoning::BodyId;

use super::rapier_body::{id, pose};
use super::rapier_solid::simple;

/// The answer to a query; `except` is the excluded body.
pub(super) fn answer(
    world: &PhysicsWorld,
    except: Option<RigidBodyHandle>,
    query: &Query,
) -> Answer {
    let bodies = |found: &[RigidBodyHandle]| {
        let of = |handle| world.bodies.get(handle).map(id);
        found.iter().copied().filter_map(of).collect::<Vec<_>>()
    };
    let search = Search {
        world,
        except,
        filter: &query.filter,
    };
    let most = usize::from(query.hits);
    match query.kind {
        QueryKind::Ray {
            origin,
            translation,
        } => search.nearest(most, |pipeline| ray(pipeline, origin, translation)),
        QueryKind::ShapeCast {
            ref shape,
            position,
            rotation,
            translation,
        } => match simple(shape, pose(position, rotation)) {
            Some((at, shape)) => {
                let (way, length) = way(translation);
                let options = ShapeCastOptions {
                    max_time_of_impact: length,
                    target_distance: 0.0,
                    stop_at_penetration: true,
                    compute_impact_geometry_on_penetration: true,
                };
                search.nearest(most, |pipeline| {
                    let (collider, hit) = pipeline.cast_shape(&at, way, &*shape.0, options)?;
                    let distance = hit.time_of_impact;
                    Some((collider, found(distance, hit.witness1, hit.normal1)))
                })
            }
            None => Answer::Hits(Vec::new()),
        },
        QueryKind::Projection { point, distance } => {
            search.nearest(most, |pipeline| projection(pipeline, point, distance))
        }
        QueryKind::Overlap {
            ref shape,
            position,
            rotation,
        } => {
            let overlapped = simple(shape, pose(position, rotation))
                .map(|(at, shape)| search.overlapped(most, &shape, at));
            let mut ids = bodies(&overlapped.unwrap_or_default());
            ids.sort_unstable();
            Answer::Bodies(ids)
        }
    }
}

/// Distance from the centre of a ball at which the nearest point of its surface is one point, metres.
const BESIDE_CENTRE: f32 = 1e-6;

/// Direction and length of a way; a way of no length has any direction.
fn way(translation: Vec3) -> (Vec3, f32) {
    let length = translation.length();
    (translation.normalize_or(Vec3::Y), length)
}

/// A hit whose body is not known yet.
fn found(distance: f32, point: Vec3, normal: Vec3) -> Hit {
    Hit {
        body: BodyId::new(0, 0),
        distance,
        point,
        normal: normal.normalize_or_zero(),
    }
}

fn ray(
    pipeline: &QueryPipeline<'_>,
    origin: Vec3,
    translation: Vec3,
) -> Option<(ColliderHandle, Hit)> {
    let (direction, length) = way(translation);
    let ray = Ray::new(origin, direction);
    let (collider, hit) = pipeline.cast_ray_and_get_normal(&ray, length, true)?;
    let distance = hit.time_of_impact;
    let normal = if distance > 0.0 {
        hit.normal
    } else {
        Vec3::ZERO
    };
    Some((
        collider,
        found(distance, origin + direction * distance, normal),
    ))
}

fn projection(
    pipeline: &QueryPipeline<'_>,
    point: Vec3,
    most: f32,
) -> Option<(ColliderHandle, Hit)> {
    // The search finds what is nearer than its limit: without this, nothing would contain a point at distance zero.
    let (handle, _) = pipeline.project_point(point, most.max(f32::EPSILON), true)?;
    let collider = pipeline.colliders.get(handle)?;
    let (shape, at) = (collider.shape(), collider.position());
    let mut surface = shape.project_point(at, point, false);
    if !surface.point.is_finite() {
        // Every point of a ball's surface is nearest to its centre; the engine finds none.
        let beside = at.inverse_transform_point(point) + Vec3::Y * BESIDE_CENTRE;
        surface = shape.project_local_point(beside, false).transform_by(at);
    }
    let away = point - surface.point;
    let distance = away.length();
    let (distance, outward) = if surface.is_inside {
        (-distance, -away)
    } else {
        (distance, away)
    };
    (distance <= most).then(|| (handle, found(distance, surface.point, outward)))
}

/// The bodies that a query considers.
struct Search<'a> {
    world: &'a PhysicsWorld,
    except: Option<RigidBodyHandle>,
    filter: &'a QueryFilter,
}

impl Search<'_> {
    /// Rapier's filter, less what the predicate decides.
    fn rapier<'a>(
        &self,
        predicate: &'a dyn Fn(ColliderHandle, &Collider) -> bool,
    ) -> RapierFilter<'a> {
        let mut flags = QueryFilterFlags::empty();
        for (without, flag) in [
            (!self.filter.with_static, QueryFilterFlags::EXCLUDE_FIXED),
            (!self.filter.with_dynamic, QueryFilterFlags::EXCLUDE_DYNAMIC),
            (
                !self.filter.with_kinematic,
                QueryFilterFlags::EXCLUDE_KINEMATIC,
            ),
            (!self.filter.with_sensors, QueryFilterFlags::EXCLUDE_SENSORS),
        ] {
            flags.set(flag, without);
        }
        RapierFilter {
            flags,
            exclude_rigid_body: self.except,
            predicate: Some(predicate),
            ..RapierFilter::default()
        }
    }

    fn is_in_groups(&self, collider: &Collider) -> bool {
        let memberships = collider.collision_groups().memberships;
        memberships.bits() & self.filter.groups != 0
    }

    /// The nearest bodies, nearest first: each search leaves out the bodies that were found before.
    fn nearest(
        &self,
        most: usize,
        find: impl Fn(&QueryPipeline<'_>) -> Option<(ColliderHandle, Hit)>,
    ) -> Answer {
        let (mut before, mut hits) = (Vec::new(), Vec::new());
        while hits.len() < most {
            let counts = |_: ColliderHandle, collider: &Collider| {
                let parent = collider.parent();
                self.is_in_groups(collider) && parent.is_some_and(|body| !before.contains(&body))
            };
            let pipeline = self.world.query_pipeline_with_filter(self.rapier(&counts));
            let Some((collider, hit)) = find(&pipeline) else {
                break;
            };
            let parent = self
                .world
                .colliders
                .get(collider)
                .and_then(Collider::parent);
            let Some(handle) = parent else { break };
            let Some(body) = self.world.bodies.get(handle).map(id) else {
                break;
            };
            before.push(handle);
            if hit.distance.is_finite() && hit.point.is_finite() && hit.normal.is_finite() {
                hits.push(Hit { body, ..hit });
            }
        }
        Answer::Hits(hits)
    }

    /// Bodies that a shape overlaps, each once.
    fn overlapped(
        &self,
        most: usize,
        shape: &SharedShape,
        at: rapier3d::math::Pose,
    ) -> Vec<RigidBodyHandle> {
        let counts = |_: ColliderHandle, collider: &Collider| self.is_in_groups(collider);
        let pipeline = self.world.query_pipeline_with_filter(self.rapier(&counts));
        let mut bodies = Vec::new();
        for (_, collider) in pipeline.intersect_shape(at, &*shape.0) {
            let Some(body) = collider.parent() else {
                continue;
            };
            if !bodies.contains(&body) {
                bodies.push(body);
                if bodies.len() == most {
                    break;
                }
            }
        }
        bodies
    }
}
