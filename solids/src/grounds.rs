//! Height fields along a way, without gaps between their cells.
//!
//! The library's own casts may pass between two cells, and end after a few cells if the way is level. Here no triangle
//! that the way meets is left out.

use core::ops::RangeInclusive;

use glam::Vec3;
use parry3d::bounding_volume::BoundingVolume;
use parry3d::math::Pose;
use parry3d::query::details::ShapeCastOptions;
use parry3d::query::{
    ClosestPoints, Contact, DefaultQueryDispatcher, NonlinearRigidMotion, QueryDispatcher,
    QueryDispatcherChain, Ray, ShapeCastHit, Unsupported,
};
use parry3d::shape::{HeightField, Shape, Triangle};

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
        first: &dyn Shape,
        second: &dyn Shape,
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
        _: &dyn Shape,
        _: &dyn Shape,
    ) -> Result<parry3d::query::ShapeIntersection, Unsupported> {
        Err(Unsupported)
    }

    fn distance(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
    ) -> Result<parry3d::query::ShapeDistance, Unsupported> {
        Err(Unsupported)
    }

    fn contact(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
        _: f32,
    ) -> Result<Option<Contact>, Unsupported> {
        Err(Unsupported)
    }

    fn closest_points(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
        _: f32,
    ) -> Result<ClosestPoints, Unsupported> {
        Err(Unsupported)
    }

    fn cast_shapes_nonlinear(
        &self,
        _: &NonlinearRigidMotion,
        _: &dyn Shape,
        _: &NonlinearRigidMotion,
        _: &dyn Shape,
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
    solid: &dyn Shape,
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
