//! Queries over a set of bodies at their poses.
//!
//! The library finds parts and a query finds bodies: a body counts once, by its nearest part. Reads the set only.
//! Engines without such queries of their own use a set that is made anew when bodies have moved; it does not follow
//! them.

use glam::{Quat, Vec3};
use parry3d::bounding_volume::BoundingVolume;
use parry3d::math::Pose;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode};
use parry3d::query;
use parry3d::query::details::{NormalConstraints, ShapeCastOptions};
use parry3d::query::{Ray, RayIntersection};
use parry3d::shape::{CompositeShape, CompositeShapeRef, Shape, SharedShape, TypedCompositeShape};
use rhumb_protocol::scene::{Answer, Hit, Query, QueryCandidate, QueryFilter, QueryKind};
use rhumb_reckoning::BodyId;

use crate::solid::{Grounds, SolidPart, cast_ray, pose, simple_part};

/// Bodies that queries may find.
pub trait SearchedBodies {
    /// Calls `find` once with the parts of the bodies that a filter takes, less those of `before`.
    fn search(
        &self,
        filter: &QueryFilter,
        before: &[BodyId],
        find: &mut dyn FnMut(&dyn CompositeShape),
    );

    /// The body of a part that was found.
    fn body_of(&self, part: u32) -> Option<BodyId>;

    /// The parts of a body at their poses in the world; they share the geometry of the set.
    fn parts_of(&self, body: BodyId) -> Vec<SolidPart>;
}

/// The answer to a query.
#[must_use]
pub fn answer(bodies: &dyn SearchedBodies, query: &Query) -> Answer {
    let search = Search { bodies, query };
    match query.kind {
        QueryKind::Ray {
            origin,
            translation,
        } => search.nearest(|parts| ray(parts, origin, translation)),
        QueryKind::ShapeCast {
            ref shape,
            position,
            rotation,
            translation,
        } => match simple_part(shape, pose(position, rotation)) {
            Some(cast) => search.nearest(|parts| shape_cast(parts, &cast, translation)),
            None => Answer::Hits(Vec::new()),
        },
        QueryKind::Projection { point, distance } => {
            search.nearest(|parts| projection(parts, point, distance))
        }
        QueryKind::Overlap {
            ref shape,
            position,
            rotation,
        } => {
            let part = simple_part(shape, pose(position, rotation));
            let overlapped = part.map(|part| search.overlapped(&part));
            let mut ids = overlapped.unwrap_or_default();
            ids.sort_unstable();
            Answer::Bodies(ids)
        }
        QueryKind::Contacts { body } => search.touching(body),
    }
}

/// Parts in the form that the library searches.
struct Parts<'a>(&'a dyn CompositeShape);

impl CompositeShape for Parts<'_> {
    fn map_part_at(
        &self,
        part: u32,
        find: &mut dyn FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>),
    ) {
        self.0.map_part_at(part, find);
    }

    fn bvh(&self) -> &Bvh {
        self.0.bvh()
    }
}

impl TypedCompositeShape for Parts<'_> {
    type PartShape = dyn Shape;
    type PartNormalConstraints = dyn NormalConstraints;

    fn map_typed_part_at<T>(
        &self,
        part: u32,
        find: impl FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>) -> T,
    ) -> Option<T> {
        self.0.map_untyped_part_at(part, find)
    }

    fn map_untyped_part_at<T>(
        &self,
        part: u32,
        find: impl FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>) -> T,
    ) -> Option<T> {
        self.0.map_untyped_part_at(part, find)
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

/// The nearest part that a ray hits, and where: less than `most` lengths of its direction away.
#[must_use]
pub fn nearest_hit(
    parts: &dyn CompositeShape,
    ray: &Ray,
    most: f32,
) -> Option<(u32, RayIntersection)> {
    let reach = |node: &BvhNode, best: f32| node.cast_ray(ray, best);
    let hit = |part: u32, best: f32| {
        let mut hit = None;
        parts.map_part_at(part, &mut |at, solid, _| {
            let at = at.copied().unwrap_or_default();
            let local = cast_ray(solid, &ray.inverse_transform_by(&at), best);
            hit = local.map(|local| local.transform_by(&at));
        });
        hit
    };
    parts.bvh().find_best(most, reach, hit)
}

fn ray(parts: &Parts<'_>, origin: Vec3, translation: Vec3) -> Option<(u32, Hit)> {
    let (direction, length) = way(translation);
    let (part, hit) = nearest_hit(parts.0, &Ray::new(origin, direction), length)?;
    let distance = hit.time_of_impact;
    let normal = if distance > 0.0 {
        hit.normal
    } else {
        Vec3::ZERO
    };
    let point = origin + direction * distance;
    Some((part, found(distance, point, normal)))
}

fn shape_cast(parts: &Parts<'_>, cast: &SolidPart, translation: Vec3) -> Option<(u32, Hit)> {
    let (way, length) = way(translation);
    let options = ShapeCastOptions {
        max_time_of_impact: length,
        target_distance: 0.0,
        stop_at_penetration: true,
        compute_impact_geometry_on_penetration: true,
    };
    let parts = CompositeShapeRef(parts);
    let (at, shape) = (&cast.at, &*cast.shape.0);
    let (part, hit) = parts.cast_shape(&Grounds::dispatcher(), at, way, shape, options)?;
    let distance = hit.time_of_impact;
    Some((part, found(distance, hit.witness1, hit.normal1)))
}

fn projection(parts: &Parts<'_>, point: Vec3, most: f32) -> Option<(u32, Hit)> {
    // The search finds what is nearer than its limit: without this, nothing would contain a point at distance zero.
    let limit = most.max(f32::EPSILON);
    let (nearest, _) = CompositeShapeRef(parts).project_local_point(point, limit, true)?;
    let mut surface = None;
    parts.map_part_at(nearest, &mut |at, shape, _| {
        let at = at.copied().unwrap_or_default();
        let mut projected = shape.project_point(&at, point, false);
        if !projected.point.is_finite() {
            // Every point of a ball's surface is nearest to its centre; the library finds none.
            let beside = at.inverse_transform_point(point) + Vec3::Y * BESIDE_CENTRE;
            projected = shape.project_local_point(beside, false).transform_by(&at);
        }
        surface = Some(projected);
    });
    let surface = surface?;
    let away = point - surface.point;
    let distance = away.length();
    let (distance, outward) = if surface.is_inside {
        (-distance, -away)
    } else {
        (distance, away)
    };
    (distance <= most).then(|| (nearest, found(distance, surface.point, outward)))
}

/// The deepest contact of each body, the deepest first, as many as a query finds.
#[must_use]
pub fn deepest(mut hits: Vec<Hit>, most: u8) -> Vec<Hit> {
    let finite =
        |hit: &Hit| hit.distance.is_finite() && hit.point.is_finite() && hit.normal.is_finite();
    hits.retain(finite);
    hits.sort_by(|a, b| (a.body.cmp(&b.body)).then(a.distance.total_cmp(&b.distance)));
    hits.dedup_by_key(|hit| hit.body);
    hits.sort_by(|a, b| (a.distance.total_cmp(&b.distance)).then(a.body.cmp(&b.body)));
    hits.truncate(usize::from(most));
    hits
}

/// One query over a set of bodies.
struct Search<'a> {
    bodies: &'a dyn SearchedBodies,
    query: &'a Query,
}

impl Search<'_> {
    /// The nearest bodies, nearest first: each search leaves out the bodies that were found before.
    fn nearest(&self, find: impl Fn(&Parts<'_>) -> Option<(u32, Hit)>) -> Answer {
        let (mut before, mut hits) = (Vec::new(), Vec::new());
        while hits.len() < usize::from(self.query.hits) {
            let mut nearest = None;
            let filter = &self.query.filter;
            (self.bodies).search(filter, &before, &mut |parts| nearest = find(&Parts(parts)));
            let Some((part, hit)) = nearest else { break };
            let Some(body) = self.bodies.body_of(part) else {
                break;
            };
            before.push(body);
            if hit.distance.is_finite() && hit.point.is_finite() && hit.normal.is_finite() {
                hits.push(Hit { body, ..hit });
            }
        }
        Answer::Hits(hits)
    }

    /// The bodies whose parts overlap those of a body, each at its deepest contact, the deepest first.
    fn touching(&self, body: BodyId) -> Answer {
        let own = self.bodies.parts_of(body);
        let mut hits: Vec<Hit> = Vec::new();
        let filter = &self.query.filter;
        (self.bodies).search(filter, &[body], &mut |parts| {
            for SolidPart { at, shape } in &own {
                let around = shape.compute_aabb(at);
                let near = parts
                    .bvh()
                    .leaves(|node| node.aabb().intersects(&around))
                    .collect::<Vec<_>>();
                for part in near {
                    parts.map_part_at(part, &mut |other_at, other, _| {
                        let other_at = other_at.copied().unwrap_or_default();
                        let contact = query::contact(at, &*shape.0, &other_at, other, 0.0);
                        let body = self.bodies.body_of(part);
                        if let (Ok(Some(contact)), Some(body)) = (contact, body) {
                            let hit = found(contact.dist, contact.point1, contact.normal2);
                            hits.push(Hit { body, ..hit });
                        }
                    });
                }
            }
        });
        Answer::Hits(deepest(hits, self.query.hits))
    }

    /// Bodies that a shape overlaps, each once.
    fn overlapped(&self, part: &SolidPart) -> Vec<BodyId> {
        let SolidPart { at, shape } = part;
        let around = shape.compute_aabb(at);
        let mut bodies = Vec::new();
        self.bodies.search(&self.query.filter, &[], &mut |parts| {
            let near = parts
                .bvh()
                .leaves(|node| node.aabb().intersects(&around))
                .collect::<Vec<_>>();
            for part in near {
                let mut overlaps = false;
                parts.map_part_at(part, &mut |other_at, other, _| {
                    let other_at = other_at.copied().unwrap_or_default();
                    let test = query::intersection_test(at, &*shape.0, &other_at, other);
                    overlaps = test.is_ok_and(|test| test.intersecting);
                });
                let Some(body) = self.bodies.body_of(part).filter(|_| overlaps) else {
                    continue;
                };
                if !bodies.contains(&body) {
                    bodies.push(body);
                    if bodies.len() == usize::from(self.query.hits) {
                        break;
                    }
                }
            }
        });
        bodies
    }
}

/// Bodies at their poses.
#[derive(Default)]
pub struct PlacedBodies {
    /// The parts, by the number of a leaf of the tree.
    parts: Vec<PlacedPart>,
    tree: Bvh,
}

struct PlacedPart {
    body: QueryCandidate,
    at: Pose,
    solid: SharedShape,
}

impl PlacedBodies {
    /// The set of these bodies: what a filter reads of each, its pose in the world, and its parts.
    pub fn new<'a>(
        bodies: impl IntoIterator<Item = (QueryCandidate, (Vec3, Quat), &'a [SolidPart])>,
    ) -> Self {
        let mut parts = Vec::new();
        for (body, (position, rotation), of_body) in bodies {
            let at = pose(position, rotation);
            parts.extend(of_body.iter().map(|part| PlacedPart {
                body,
                at: at * part.at,
                solid: part.shape.clone(),
            }));
        }
        let around = |part: &PlacedPart| part.solid.compute_aabb(&part.at);
        let boxes: Vec<_> = parts.iter().map(around).collect();
        let tree = Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes);
        Self { parts, tree }
    }
}

/// The parts that one query considers.
struct Considered<'a> {
    placed: &'a PlacedBodies,
    filter: &'a QueryFilter,
    before: &'a [BodyId],
}

impl CompositeShape for Considered<'_> {
    fn map_part_at(
        &self,
        part: u32,
        find: &mut dyn FnMut(Option<&Pose>, &dyn Shape, Option<&dyn NormalConstraints>),
    ) {
        let Some(part) = self.placed.parts.get(part as usize) else {
            return;
        };
        if self.filter.takes(&part.body) && !self.before.contains(&part.body.id) {
            find(Some(&part.at), &*part.solid.0, None);
        }
    }

    fn bvh(&self) -> &Bvh {
        &self.placed.tree
    }
}

impl SearchedBodies for PlacedBodies {
    fn search(
        &self,
        filter: &QueryFilter,
        before: &[BodyId],
        find: &mut dyn FnMut(&dyn CompositeShape),
    ) {
        find(&Considered {
            placed: self,
            filter,
            before,
        });
    }

    fn body_of(&self, part: u32) -> Option<BodyId> {
        let part = self.parts.get(part as usize)?;
        Some(part.body.id)
    }

    fn parts_of(&self, body: BodyId) -> Vec<SolidPart> {
        let is_own =
            |part: &&PlacedPart| part.body.id == body && QueryFilter::ALL.takes(&part.body);
        let own = self.parts.iter().filter(is_own);
        let parts = own.map(|part| SolidPart {
            at: part.at,
            shape: part.solid.clone(),
        });
        parts.collect()
    }
}

#[cfg(test)]
mod tests {
    use rhumb_protocol::scene::{BodyKind, Mesh, Shape};

    use super::*;
    use crate::solid::parts;

    #[test]
    fn the_contacts_of_a_mesh_copy_none_of_its_triangles() {
        let points = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let mesh = Mesh::new(&points, &triangles).expect("the test makes it valid");
        let mesh = parts(&Shape::Mesh(mesh)).expect("the mesh has faces");
        let ball = parts(&Shape::ball(0.5)).expect("a ball is solid");
        let candidate = |index: u32| QueryCandidate {
            id: BodyId::new(index, 0),
            kind: BodyKind::Dynamic,
            is_sensor: false,
            members: 1,
        };
        let at = (Vec3::ZERO, Quat::IDENTITY);
        let bodies = [(candidate(0), at, &*mesh), (candidate(1), at, &*ball)];
        let placed = PlacedBodies::new(bodies);
        let own = placed.parts_of(BodyId::new(0, 0));
        assert_eq!(own.len(), mesh.len());
        for (one, other) in own.iter().zip(&mesh) {
            assert!(std::sync::Arc::ptr_eq(&one.shape.0, &other.shape.0));
        }
        let query = Query {
            kind: QueryKind::Contacts {
                body: BodyId::new(0, 0),
            },
            filter: QueryFilter::ALL,
            hits: 4,
        };
        let Answer::Hits(hits) = answer(&placed, &query) else {
            panic!("contacts are hits");
        };
        let found: Vec<_> = hits.iter().map(|hit| hit.body).collect();
        assert_eq!(found, [BodyId::new(1, 0)]);
    }
}
