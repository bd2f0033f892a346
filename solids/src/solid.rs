//! Shapes as solids of the collision library: conversion, mass, rays.
//!
//! Code that may panic in the library runs under `catch_unwind`, and nothing of it is kept. Mass and moments of
//! inertia are those at density one, around the body's origin, which the protocol places at the centre of mass.
//! Invariant: all numbers are normal.
//!
//! The library's own rays may pass between two cells of a height field or two triangles of a mesh. Here a ray that
//! meets an edge or a post meets the surface. Other solids are left to the library. On height fields, the library's own casts
//! may pass between two cells, and end after a few cells if the way is level. Here no triangle that the way meets is left out.

use core::ops::RangeInclusive;
use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{DVec3, Quat, Vec3};
use parry3d::bounding_volume::BoundingVolume;
use parry3d::mass_properties::MassProperties;
use parry3d::math::Pose;
use parry3d::partitioning::BvhNode;
use parry3d::query::details::ShapeCastOptions;
use parry3d::query::{
    ClosestPoints, Contact, DefaultQueryDispatcher, NonlinearRigidMotion, QueryDispatcher,
    QueryDispatcherChain, Ray, RayCast, RayIntersection, ShapeCastHit, Unsupported,
};
use parry3d::shape::{
    self, FeatureId, HeightField, HeightFieldCellStatus, HeightFieldFlags, SharedShape, TriMesh,
    TriMeshFlags, Triangle, TypedShape,
};
use parry3d::utils::Array2;
use rhumb_protocol::scene::{Edges, Heights, Mesh, Shape};

/// A convex part, a sheet or a half-space.
#[derive(Clone)]
pub struct SolidPart {
    /// Its pose; for a body's part relative to the body's centre of mass.
    pub at: Pose,
    /// Its geometry.
    pub shape: SharedShape,
}

/// A pose of the library.
#[must_use]
pub fn pose(position: Vec3, rotation: Quat) -> Pose {
    Pose::from_parts(position, rotation)
}

/// The parts of a shape; `None` for a shape without faces. A compound without parts has none.
#[must_use]
pub fn parts(shape: &Shape) -> Option<Vec<SolidPart>> {
    let mut parts = Vec::new();
    add_parts(shape, Pose::IDENTITY, &mut parts)?;
    Some(parts)
}

/// Adds the parts of a shape that is at this pose of its body; `None` for a shape without faces.
pub fn add_parts(shape: &Shape, at: Pose, parts: &mut Vec<SolidPart>) -> Option<()> {
    let solid = match *shape {
        Shape::Ball { radius } => SharedShape::ball(radius),
        Shape::Cuboid { half_extents } => {
            SharedShape::cuboid(half_extents.x, half_extents.y, half_extents.z)
        }
        Shape::Capsule {
            half_height,
            radius,
        } => SharedShape::capsule_y(half_height, radius),
        Shape::Cylinder {
            half_height,
            radius,
        } => SharedShape::cylinder(half_height, radius),
        Shape::RoundedCuboid {
            half_extents: half,
            radius,
        } => SharedShape::round_cuboid(half.x, half.y, half.z, radius),
        Shape::Cone {
            half_height,
            radius,
        } => {
            // The library's origin is in the middle of the height, a quarter of it above the centre of mass.
            let middle = Vec3::new(0.0, half_height * 0.5, 0.0);
            let cone = SharedShape::cone(half_height, radius);
            parts.push(SolidPart {
                at: at * pose(middle, Quat::IDENTITY),
                shape: cone,
            });
            return Some(());
        }
        Shape::HalfSpace { normal } => SharedShape::halfspace(normal.normalize()),
        Shape::Hull(ref hull) => {
            // The search for faces may panic on points that contradict each other by rounding.
            let made = catch_unwind(|| SharedShape::convex_hull(hull.points()));
            made.ok().flatten()?
        }
        Shape::Heights(ref heights) => {
            parts.push(SolidPart {
                at: at * middle(heights),
                shape: ground(heights)?,
            });
            return Some(());
        }
        Shape::Mesh(ref mesh) => triangles(mesh)?,
        Shape::Compound(ref compound) => {
            for part in compound.parts() {
                add_parts(&part.shape, at * pose(part.position, part.rotation), parts)?;
            }
            return Some(());
        }
    };
    parts.push(SolidPart { at, shape: solid });
    Some(())
}

/// The part of a shape that queries may have, and its pose where the shape's is this one.
#[must_use]
pub fn simple_part(shape: &Shape, at: Pose) -> Option<SolidPart> {
    let mut parts = Vec::new();
    add_parts(shape, at, &mut parts)?;
    parts.pop()
}

/// Cells of a height field along one axis, as the library has them: it counts posts in shares of the whole field, which are
/// exact for a power of two alone. By others a body that falls exactly onto a line of posts finds neither of the triangles
/// there, if the edges are smooth (parry3d 0.31.1).
const fn whole_cells(posts: u32, edges: Edges) -> u32 {
    match edges {
        Edges::Plain => posts - 1,
        Edges::Smooth => (posts - 1).next_power_of_two(),
    }
}

/// Centre of a height field and of the cells beyond it: the origin of the library's coordinates.
fn middle(heights: &Heights) -> Pose {
    let half = |posts, spacing| whole_cells(posts, heights.edges()) as f32 * spacing * 0.5;
    let x = half(heights.rows(), heights.row_spacing());
    let z = half(heights.columns(), heights.column_spacing());
    pose(Vec3::new(x, 0.0, z), Quat::IDENTITY)
}

fn ground(heights: &Heights) -> Option<SharedShape> {
    let (rows, columns) = (heights.rows() as usize, heights.columns() as usize);
    let cells =
        [heights.rows(), heights.columns()].map(|posts| whole_cells(posts, heights.edges()));
    let scale = Vec3::new(
        cells[0] as f32 * heights.row_spacing(),
        1.0,
        cells[1] as f32 * heights.column_spacing(),
    );
    let flags = match heights.edges() {
        Edges::Plain => HeightFieldFlags::empty(),
        Edges::Smooth => HeightFieldFlags::FIX_INTERNAL_EDGES,
    };
    let [all_rows, all_columns] = cells.map(|cells| cells as usize + 1);
    // The library's rows go along z, which are the columns here, and it stores column by column: the row-by-row order
    // here fits. The cells beyond the field are removed, whatever their height.
    let own = heights.heights();
    let posts = (0..all_rows).flat_map(|row| {
        let row = row.min(rows - 1) * columns;
        (0..all_columns).map(move |column| own[row + column.min(columns - 1)])
    });
    let posts = Array2::new(all_columns, all_rows, posts.collect());
    let build = || {
        let mut ground = HeightField::with_flags(posts, scale, flags);
        for row in 0..all_rows - 1 {
            for column in 0..all_columns - 1 {
                if row >= rows - 1 || column >= columns - 1 {
                    ground.set_cell_status(column, row, HeightFieldCellStatus::CELL_REMOVED);
                }
            }
        }
        SharedShape::new(ground)
    };
    catch_unwind(build).ok()
}

fn triangles(mesh: &Mesh) -> Option<SharedShape> {
    let (points, triangles) = (mesh.points().to_vec(), mesh.triangles().to_vec());
    let flags = match mesh.edges() {
        Edges::Plain => TriMeshFlags::empty(),
        // The winding of its triangles is the application's, so neither side is the back.
        Edges::Smooth => TriMeshFlags::FIX_INTERNAL_EDGES_TWO_SIDED,
    };
    let made = catch_unwind(|| SharedShape::trimesh_with_flags(points, triangles, flags));
    made.ok().and_then(Result::ok)
}

/// Mass and moments of a solid of one kilogram per cubic metre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitMass {
    /// Centre of mass, metres, in the solid's coordinates.
    pub centre: Vec3,
    /// Kilograms: its volume.
    pub mass: f32,
    /// About its principal axes, kg·m².
    pub moments: Vec3,
    /// Principal axes → body.
    pub frame: Quat,
}

impl UnitMass {
    /// The mass of a shape, of a mesh that of the enclosed volume; `None` for a shape without a solid or without volume.
    #[must_use]
    pub fn of_shape(shape: &Shape) -> Option<Self> {
        let parts = parts(shape)?;
        // The library has asserts of its own.
        let made = catch_unwind(AssertUnwindSafe(|| Self::of(&parts)));
        made.ok().flatten()
    }

    /// The mass of all parts together; `None` for parts without volume, and where a number is too small or too large
    /// for f32.
    #[must_use]
    pub fn of(parts: &[SolidPart]) -> Option<Self> {
        let own = |part: &SolidPart| part.shape.mass_properties(1.0).transform_by(&part.at);
        let total: MassProperties = parts.iter().map(own).sum();
        let (mass, moments) = (total.mass(), total.principal_inertia());
        let sound = |value: f32| value.is_normal() && value > 0.0;
        let is_sound = sound(mass) && sound(moments.min_element()) && moments.is_finite();
        let is_sound = is_sound && total.local_com.is_finite();
        is_sound.then_some(Self {
            centre: total.local_com,
            mass,
            moments,
            frame: total.principal_inertia_local_frame,
        })
    }
}

/// The nearest hit of a ray on a solid, in the solid's axes. Distances are in lengths of the ray's direction.
#[must_use]
pub fn cast_ray(solid: &dyn shape::Shape, ray: &Ray, most: f32) -> Option<RayIntersection> {
    match solid.as_typed_shape() {
        TypedShape::HeightField(ground) => on_ground(ground, ray, most),
        TypedShape::TriMesh(mesh) => on_mesh(mesh, ray, most),
        _ => solid.cast_local_ray_and_get_normal(ray, most, true),
    }
}

fn on_mesh(mesh: &TriMesh, ray: &Ray, most: f32) -> Option<RayIntersection> {
    let lane = Lane::new(ray)?;
    // A box that is a little wider does not lose an edge on it by rounding.
    const ROUNDINGS: f32 = 16.0;
    let reach = |node: &BvhNode, best: f32| {
        let around = node.aabb();
        let sizes = around.mins.abs().max(around.maxs.abs());
        let slack = sizes.max(ray.origin.abs()).max_element() * f32::EPSILON * ROUNDINGS;
        let reached = around.loosened(slack).cast_local_ray(ray, best, true);
        reached.unwrap_or(f32::MAX)
    };
    let hit = |triangle: u32, best: f32| lane.hit(&mesh.triangle(triangle), best);
    // The search finds what is nearer than its limit.
    let (_, found) = mesh.bvh().find_best(most.next_up(), reach, hit)?;
    Some(found)
}

fn on_ground(ground: &HeightField, ray: &Ray, most: f32) -> Option<RayIntersection> {
    let (lane, mut nearest) = (Lane::new(ray)?, None);
    along(ground, ray, most, Vec3::ZERO, &mut |triangle, best| {
        let hit = lane.hit(triangle, best)?;
        nearest = Some(hit);
        Some(hit.time_of_impact)
    });
    nearest
}

/// A ray as the axis of coordinates in which triangles are tested.
///
/// Two triangles with a common edge compute the same number for it, but for its sign, so that no ray passes between
/// them. Source: Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013.
struct Lane {
    origin: DVec3,
    direction: DVec3,
    /// Largest component of the direction, and the two others.
    axes: [usize; 3],
    shear: [f64; 3],
}

impl Lane {
    /// `None` for a ray without direction.
    fn new(ray: &Ray) -> Option<Self> {
        let direction = ray.dir.as_dvec3();
        let sizes = direction.abs();
        let along = match sizes.max_position() {
            0 => 0,
            1 => 1,
            _ => 2,
        };
        let (mut x, mut y) = ((along + 1) % 3, (along + 2) % 3);
        if direction[along] < 0.0 {
            (x, y) = (y, x);
        }
        let length = direction[along];
        (length != 0.0).then_some(Self {
            origin: ray.origin.as_dvec3(),
            direction,
            axes: [along, x, y],
            shear: [1.0 / length, direction[x] / length, direction[y] / length],
        })
    }

    /// The hit on a triangle, edges and corners included, at `most` at the farthest.
    fn hit(&self, triangle: &Triangle, most: f32) -> Option<RayIntersection> {
        let [along, x, y] = self.axes;
        let [per_length, shear_x, shear_y] = self.shear;
        let from_origin = |point: Vec3| point.as_dvec3() - self.origin;
        let corners = [triangle.a, triangle.b, triangle.c].map(from_origin);
        let [a, b, c] = corners.map(|corner| {
            let depth = corner[along];
            [corner[x] - shear_x * depth, corner[y] - shear_y * depth]
        });
        let side = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
        let shares = [side(c, b), side(a, c), side(b, a)];
        let has = |sign: f64| shares.iter().any(|share| share * sign > 0.0);
        let total: f64 = shares.iter().sum();
        if (has(1.0) && has(-1.0)) || total == 0.0 {
            return None;
        }
        let depths = corners.map(|corner| corner[along] * per_length);
        let weighted: f64 = shares
            .iter()
            .zip(depths)
            .map(|(share, at)| share * at)
            .sum();
        let at = weighted / total;
        if !(at >= 0.0 && at <= f64::from(most)) {
            return None;
        }
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let facing = normal.dot(self.direction) <= 0.0;
        let (normal, side) = if facing { (normal, 0) } else { (-normal, 1) };
        let normal = normal.normalize_or_zero().as_vec3();
        Some(RayIntersection::new(
            at as f32,
            normal,
            FeatureId::Face(side),
        ))
    }
}

/// The library's tests of two solids, with casts against height fields that leave nothing out.
pub type Dispatcher = QueryDispatcherChain<Grounds, DefaultQueryDispatcher>;

/// The tests of two solids that this crate makes instead of the library.
#[derive(Clone, Copy, Debug)]
pub struct Grounds;

impl Grounds {
    /// These tests, and the library's where there are none.
    #[must_use]
    pub fn dispatcher() -> Dispatcher {
        Self.chain(DefaultQueryDispatcher)
    }
}

impl QueryDispatcher for Grounds {
    fn cast_shapes(
        &self,
        pose12: &Pose,
        velocity12: Vec3,
        first: &dyn shape::Shape,
        second: &dyn shape::Shape,
        options: ShapeCastOptions,
    ) -> Result<Option<ShapeCastHit>, Unsupported> {
        if let Some(ground) = first.as_heightfield() {
            return cast_shape(ground, (pose12, velocity12), second, options);
        }
        let Some(ground) = second.as_heightfield() else {
            return Err(Unsupported);
        };
        let velocity = -(pose12.rotation.inverse() * velocity12);
        let hit = cast_shape(ground, (&pose12.inverse(), velocity), first, options)?;
        Ok(hit.map(ShapeCastHit::swapped))
    }

    fn intersection_test(
        &self,
        _: &Pose,
        _: &dyn shape::Shape,
        _: &dyn shape::Shape,
    ) -> Result<parry3d::query::ShapeIntersection, Unsupported> {
        Err(Unsupported)
    }

    fn distance(
        &self,
        _: &Pose,
        _: &dyn shape::Shape,
        _: &dyn shape::Shape,
    ) -> Result<parry3d::query::ShapeDistance, Unsupported> {
        Err(Unsupported)
    }

    fn contact(
        &self,
        _: &Pose,
        _: &dyn shape::Shape,
        _: &dyn shape::Shape,
        _: f32,
    ) -> Result<Option<Contact>, Unsupported> {
        Err(Unsupported)
    }

    fn closest_points(
        &self,
        _: &Pose,
        _: &dyn shape::Shape,
        _: &dyn shape::Shape,
        _: f32,
    ) -> Result<ClosestPoints, Unsupported> {
        Err(Unsupported)
    }

    fn cast_shapes_nonlinear(
        &self,
        _: &NonlinearRigidMotion,
        _: &dyn shape::Shape,
        _: &NonlinearRigidMotion,
        _: &dyn shape::Shape,
        _: f32,
        _: f32,
        _: bool,
    ) -> Result<Option<ShapeCastHit>, Unsupported> {
        Err(Unsupported)
    }
}

/// The first triangle of a height field that a moving solid meets.
fn cast_shape(
    ground: &HeightField,
    (pose, velocity): (&Pose, Vec3),
    solid: &dyn shape::Shape,
    options: ShapeCastOptions,
) -> Result<Option<ShapeCastHit>, Unsupported> {
    let around = solid.compute_aabb(pose).loosened(options.target_distance);
    let way = Ray::new(around.center(), velocity);
    let (most, mut first, mut fault) = (options.max_time_of_impact, None, Ok(()));
    along(
        ground,
        &way,
        most,
        around.half_extents(),
        &mut |triangle, best| {
            let limited = ShapeCastOptions {
                max_time_of_impact: best,
                ..options
            };
            let hit = DefaultQueryDispatcher.cast_shapes(pose, velocity, triangle, solid, limited);
            match hit {
                Ok(hit) => {
                    let sooner = |hit: &ShapeCastHit| first.is_none() || hit.time_of_impact < best;
                    let hit = hit.filter(sooner)?;
                    first = Some(hit);
                    Some(hit.time_of_impact)
                }
                Err(unsupported) => {
                    fault = Err(unsupported);
                    None
                }
            }
        },
    );
    fault.map(|()| first)
}

/// Calls `find` with the triangles that a box meets on its way, row by row, and with the farthest distance that is still
/// of interest. `find` returns the distance of a nearer hit.
///
/// `half`: half the edges of the box, whose centre goes along `way`. Distances are in lengths of the way's direction.
pub(crate) fn along(
    ground: &HeightField,
    way: &Ray,
    most: f32,
    half: Vec3,
    find: &mut dyn FnMut(&Triangle, f32) -> Option<f32>,
) {
    let half = half + Vec3::splat(slack(ground, way.origin));
    let around = ground.root_aabb();
    let sides = |axis: usize| {
        [
            around.mins[axis] - half[axis],
            around.maxs[axis] + half[axis],
        ]
    };
    let span = (0..3).try_fold([0.0, most], |span, axis| {
        within(way.origin[axis], way.dir[axis], sides(axis), span)
    });
    let Some(span) = span else { return };
    let rows = cells(
        span.map(|at| way.point_at(at).z),
        half.z,
        ground.nrows(),
        |row| ground.z_at(row),
    );
    let (first, last) = (*rows.start(), *rows.end());
    let mut best = most;
    for step in 0..(last + 1).saturating_sub(first) {
        let row = if way.dir.z < 0.0 {
            last - step
        } else {
            first + step
        };
        let sides = [ground.z_at(row) - half.z, ground.z_at(row + 1) + half.z];
        let Some(span) = within(way.origin.z, way.dir.z, sides, span) else {
            continue;
        };
        if span[0] > best {
            break;
        }
        let columns = cells(
            span.map(|at| way.point_at(at).x),
            half.x,
            ground.ncols(),
            |column| ground.x_at(column),
        );
        for column in columns {
            let (left, right) = ground.triangles_at(row, column);
            for triangle in [left, right].into_iter().flatten() {
                if let Some(nearer) = find(&triangle, best) {
                    best = best.min(nearer);
                }
            }
        }
    }
}

/// Metres by which rounding may displace a point of a height field, or of a way from this origin.
fn slack(ground: &HeightField, origin: Vec3) -> f32 {
    const ROUNDINGS: f32 = 16.0;
    let around = ground.root_aabb();
    let sizes = around.mins.abs().max(around.maxs.abs()).max(origin.abs());
    (sizes.max_element() * f32::EPSILON * ROUNDINGS).max(f32::MIN_POSITIVE)
}

/// The part of a way that lies within two sides across it; `None` for none.
fn within(origin: f32, speed: f32, sides: [f32; 2], [begin, end]: [f32; 2]) -> Option<[f32; 2]> {
    let (enter, leave) = if speed == 0.0 {
        let inside = (sides[0]..=sides[1]).contains(&origin);
        inside.then_some((begin, end))?
    } else {
        let [one, other] = sides.map(|side| (side - origin) / speed);
        (one.min(other).max(begin), one.max(other).min(end))
    };
    (enter <= leave).then_some([enter, leave])
}

/// The cells that a piece of a way meets, from one coordinate to another, for a box of this half edge.
fn cells(
    [from, to]: [f32; 2],
    half: f32,
    count: usize,
    side: impl Fn(usize) -> f32,
) -> RangeInclusive<usize> {
    let width = (side(count) - side(0)) / count as f32;
    let cell = |at: f32| {
        let cell = ((at - side(0)) / width).floor();
        (cell.max(0.0) as usize).min(count - 1)
    };
    let (least, most) = (from.min(to) - half, from.max(to) + half);
    // One more on either side covers the rounding of the division.
    cell(least).saturating_sub(1)..=(cell(most) + 1).min(count - 1)
}

#[cfg(test)]
mod tests {
    use parry3d::math::Pose;
    use parry3d::query::QueryDispatcher;
    use parry3d::query::details::ShapeCastOptions;
    use parry3d::shape::SharedShape;
    use parry3d::utils::Array2;

    use super::*;

    /// Posts `spacing` apart, on a plane or on slopes.
    fn ground(count: usize, spacing: f32, height: impl Fn(usize, usize) -> f32) -> SharedShape {
        let posts = Array2::new(
            count,
            count,
            (0..count * count)
                .map(|place| height(place % count, place / count))
                .collect(),
        );
        let scale = (count - 1) as f32 * spacing;
        SharedShape::heightfield(posts, Vec3::new(scale, 1.0, scale))
    }

    /// Grid of triangles with a corner at each whole multiple of the spacing.
    fn mesh(count: u32, spacing: f32) -> SharedShape {
        let half = (count - 1) as f32 * 0.5;
        let at = |place: u32| (place as f32 - half) * spacing;
        let points = (0..count * count)
            .map(|place| Vec3::new(at(place % count), 0.0, at(place / count)))
            .collect();
        let corner = |row: u32, column: u32| row * count + column;
        let cells = (0..count - 1).flat_map(|row| (0..count - 1).map(move |column| (row, column)));
        let triangles = cells.flat_map(|(row, column)| {
            let [a, b] = [corner(row, column), corner(row, column + 1)];
            let [c, d] = [corner(row + 1, column), corner(row + 1, column + 1)];
            [[a, c, b], [b, c, d]]
        });
        SharedShape::trimesh(points, triangles.collect()).expect("it has triangles")
    }

    /// Directions down and askew, of several lengths.
    const WAYS: [Vec3; 6] = [
        Vec3::new(0.0, -1.0, 0.0),
        Vec3::new(0.0, -60.0, 0.0),
        Vec3::new(0.5, -1.0, 0.0),
        Vec3::new(0.0, -1.0, -0.5),
        Vec3::new(0.25, -1.0, 0.25),
        Vec3::new(-0.3, -0.9, 0.7),
    ];

    #[test]
    fn a_ray_to_a_post_a_line_or_an_edge_hits() {
        for spacing in [1.0, 0.1, 0.3, 7.0 / 3.0] {
            let solids = [ground(41, spacing, |_, _| 0.0), mesh(41, spacing)];
            for (solid, way, place) in solids.iter().flat_map(|solid| {
                WAYS.iter()
                    .flat_map(move |way| (0..38 * 38).map(move |place| (solid, way, place)))
            }) {
                let cell = |number: i32| (number - 18) as f32;
                let (row, column) = (place / 38, place % 38);
                let halves = [[0.0, 0.0], [0.5, 0.0], [0.0, 0.5], [0.5, 0.5]][place as usize % 4];
                let x = (cell(column) + halves[0]) * spacing;
                let z = (cell(row) + halves[1]) * spacing;
                let target = Vec3::new(x, 0.0, z);
                let ray = Ray::new(target - *way * 2.0, *way);
                let hit = cast_ray(&*solid.0, &ray, 4.0);
                let hit = hit.unwrap_or_else(|| panic!("{spacing} {way} misses {target}"));
                assert!((hit.time_of_impact - 2.0).abs() < 1e-4, "{hit:?}");
                assert!((hit.normal.y.abs() - 1.0).abs() < 1e-5, "{hit:?}");
                assert!(cast_ray(&*solid.0, &ray, 1.9).is_none(), "it ends above");
            }
        }
    }

    #[test]
    fn a_ray_beside_a_surface_or_away_from_it_misses() {
        let spacing = 0.5;
        for solid in [ground(9, spacing, |_, _| 0.0), mesh(9, spacing)] {
            let cast = |from: Vec3, way: Vec3| cast_ray(&*solid.0, &Ray::new(from, way), 100.0);
            assert!(cast(Vec3::new(2.001, 1.0, 0.0), Vec3::NEG_Y).is_none());
            assert!(cast(Vec3::new(0.0, 1.0, -2.001), Vec3::NEG_Y).is_none());
            assert!(cast(Vec3::new(0.0, 1.0, 0.0), Vec3::Y).is_none());
            assert!(cast(Vec3::new(-5.0, 0.01, 0.0), Vec3::X).is_none());
            assert!(cast(Vec3::ZERO, Vec3::ZERO).is_none());
            assert!(
                cast(Vec3::new(2.0, 1.0, 2.0), Vec3::NEG_Y).is_some(),
                "a corner"
            );
        }
    }

    #[test]
    fn on_slopes_a_hit_is_where_the_library_finds_one() {
        let height = |row: usize, column: usize| ((row * 7 + column * 13) % 10) as f32 * 0.3;
        let solid = ground(17, 0.7, height);
        let (mut same, mut missed) = (0, 0);
        for number in 0..4_000_u32 {
            let part = |prime: u32| (number.wrapping_mul(prime) % 1_000) as f32 / 1_000.0 - 0.5;
            let from = Vec3::new(part(7_919) * 12.0, 4.0, part(104_729) * 12.0);
            let way = Vec3::new(part(1_299_709), -0.7, part(15_485_863));
            let ray = Ray::new(from, way);
            let ours = cast_ray(&*solid.0, &ray, 50.0);
            let Some(theirs) = solid.cast_local_ray_and_get_normal(&ray, 50.0, true) else {
                missed += usize::from(ours.is_some());
                continue;
            };
            let ours = ours.unwrap_or_else(|| panic!("{ray:?} misses"));
            // The library may look past an edge into a later cell.
            assert!(
                ours.time_of_impact < theirs.time_of_impact + 1e-3,
                "{ray:?}"
            );
            same += usize::from((ours.time_of_impact - theirs.time_of_impact).abs() < 1e-3);
        }
        assert!(
            same > 3_000 && missed < 20,
            "{same} the same, {missed} more"
        );
    }

    #[test]
    fn a_shape_cast_along_a_level_way_finds_a_far_hill() {
        let solid = ground(41, 1.0, |_, column| if column == 35 { 2.0 } else { 0.0 });
        let ball = SharedShape::ball(0.25);
        for z in [0.0, 0.5, 3.0, -7.3] {
            let at = Pose::translation(-15.0, 1.0, z);
            let cast = Grounds::dispatcher().cast_shapes(
                &at,
                Vec3::X,
                &*solid.0,
                &*ball.0,
                ShapeCastOptions::with_max_time_of_impact(60.0),
            );
            let hit = cast
                .expect("both are supported")
                .expect("the ray hits the hill");
            // The slope rises from 14 to 15 m by 2 m, and the ball lies a quarter of a metre off it.
            let expected = 29.5 - 0.25 * 5.0_f32.sqrt() / 2.0;
            assert!((hit.time_of_impact - expected).abs() < 1e-2, "{hit:?}");
        }
    }

    #[test]
    fn a_small_shape_cast_to_a_post_or_a_line_hits() {
        let (solid, ball) = (ground(41, 0.3, |_, _| 0.0), SharedShape::ball(0.01));
        for place in 0..36 * 36 {
            let at = |number: i32| (number - 18) as f32 * 0.3;
            let way = WAYS[place as usize % WAYS.len()].normalize();
            let target = Vec3::new(at(place % 36), 0.0, at(place / 36));
            let pose = Pose::from_translation(target - way * 2.0);
            for (first, second, pose, way) in [
                (&solid, &ball, pose, way),
                (&ball, &solid, pose.inverse(), -way),
            ] {
                let options = ShapeCastOptions::with_max_time_of_impact(4.0);
                let cast =
                    Grounds::dispatcher().cast_shapes(&pose, way, &*first.0, &*second.0, options);
                let hit = cast.expect("both are supported").expect("it is hit");
                let expected = 2.0 - 0.01 / way.y.abs();
                assert!((hit.time_of_impact - expected).abs() < 1e-3, "{hit:?}");
            }
        }
    }
}
