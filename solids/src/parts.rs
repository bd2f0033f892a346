//! Conversion of shapes to solids of the collision library; their mass.
//!
//! Code that may panic in the library runs under `catch_unwind`, and nothing of it is kept. Mass and moments of
//! inertia are those at density one, around the body's origin, which the protocol places at the centre of mass.
//! Invariant: all numbers are normal.

use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Quat, Vec3};
use parry3d::mass_properties::MassProperties;
use parry3d::math::Pose;
use parry3d::shape::{
    HeightField, HeightFieldCellStatus, HeightFieldFlags, SharedShape, TriMeshFlags,
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
