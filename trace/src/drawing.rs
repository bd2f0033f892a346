//! Draws bodies as Foxglove's primitives, on topics `moving` and `resting`.
//!
//! After a seek, a viewer shows only the last message of each topic. So each message is complete: every body is in
//! exactly one of the two last messages, in its current pose. A body moves to `resting` only after it lies still for a
//! while: a body that wakes often must not cause all resting bodies to be rewritten. When a resting body moves, both
//! are written.
//!
//! The engine's y axis points up, Foxglove's z axis does. Poses are turned by a quarter about x: (x, y, z) is drawn at
//! (x, -z, y) in the frame `map`. Only drawings are turned; the data topics keep the engine's frame.

use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, Point3, Pose, PosesInFrame, Quaternion, SceneEntity,
    SceneUpdate, SpherePrimitive, Timestamp, TriangleListPrimitive, Vector3,
};
use glam::{DQuat, DVec3, Vec3};
use rhumb_protocol::scene::{BodyDesc, Compound, Shape};
use rhumb_protocol::stream::Observation;
use rhumb_reckoning::{BodyId, Inertia, Tick};

/// The content of the last messages of both topics.
#[derive(Debug)]
pub struct DrawnScene {
    /// Indexed by body index.
    rests: Vec<Option<RestingBody>>,
    at_rest: usize,
    written: Option<WrittenEntities>,
    rest_delay_ticks: u64,
}

/// A still body and the tick since which it is still.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RestingBody {
    generation: u16,
    position: [f32; 3],
    rotation: [f32; 4],
    since: u64,
    /// True if the last message of `resting` contains it.
    at_rest: bool,
}

#[derive(Clone, Copy, Debug)]
struct WrittenEntities {
    resting: u64,
    moving_was_empty: bool,
}

/// A body and its colour.
pub type Painted<'a> = (DrawnBody<'a>, Color);

/// The messages of a drawing: those whose content changed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// Bodies that move.
    pub moving: Option<SceneUpdate>,
    /// Bodies that rest.
    pub resting: Option<SceneUpdate>,
}

impl DrawnScene {
    /// Nothing is drawn yet; a body moves to `resting` after `rest_delay_ticks` of stillness.
    #[must_use]
    pub const fn new(rest_delay_ticks: u64) -> Self {
        Self {
            rests: Vec::new(),
            at_rest: 0,
            written: None,
            rest_delay_ticks,
        }
    }

    /// Makes both messages at the next drawing.
    pub fn redraw(&mut self) {
        self.written = None;
    }

    /// Draws the bodies of a tick.
    pub fn draw(&mut self, (tick, at_ns): (u64, u64), bodies: &[Painted<'_>]) -> Drawing {
        let mut drawing = Drawing::default();
        let (mut kept, mut eligible) = (0, 0);
        for (body, _) in bodies {
            match self.update_rest(tick, body) {
                DrawState::Resting => kept += 1,
                DrawState::Waiting => eligible += 1,
                DrawState::Moving => {}
            }
        }
        let last = self.written.map(|written| written.resting);
        let waited = last.is_none_or(|last| last + self.rest_delay_ticks <= tick);
        let woke = kept < self.at_rest;
        if last.is_none() || woke || (waited && eligible > 0) {
            self.at_rest = kept + eligible;
            self.mark_resting(tick);
            drawing.resting = Some(self.update("resting", at_ns, bodies, true));
            self.written = Some(WrittenEntities {
                resting: tick,
                moving_was_empty: self.written.is_some_and(|written| written.moving_was_empty),
            });
        }
        let empty = self.at_rest == bodies.len();
        if let Some(written) = &mut self.written
            && !(empty && written.moving_was_empty)
        {
            written.moving_was_empty = empty;
            drawing.moving = Some(self.update("moving", at_ns, bodies, false));
        }
        drawing
    }

    /// Updates the stillness record of a body.
    fn update_rest(&mut self, tick: u64, body: &DrawnBody<'_>) -> DrawState {
        let index = body.id.index() as usize;
        if index >= self.rests.len() {
            self.rests.resize(index + 1, None);
        }
        let fresh = RestingBody {
            generation: body.id.generation(),
            position: body.position,
            rotation: body.rotation,
            since: tick,
            at_rest: false,
        };
        let slot = &mut self.rests[index];
        if !body.still {
            *slot = None;
            return DrawState::Moving;
        }
        let rest = slot.insert(match *slot {
            Some(rest)
                if rest
                    == (RestingBody {
                        since: rest.since,
                        at_rest: rest.at_rest,
                        ..fresh
                    }) =>
            {
                rest
            }
            _ => fresh,
        });
        if rest.at_rest {
            DrawState::Resting
        } else if rest.since + self.rest_delay_ticks <= tick {
            DrawState::Waiting
        } else {
            DrawState::Moving
        }
    }

    fn mark_resting(&mut self, tick: u64) {
        for rest in self.rests.iter_mut().flatten() {
            rest.at_rest |= rest.since + self.rest_delay_ticks <= tick;
        }
    }

    fn update(&self, id: &str, at_ns: u64, bodies: &[Painted<'_>], at_rest: bool) -> SceneUpdate {
        let mut entity = entity(id, at_ns);
        for (body, color) in bodies {
            let rest = self.rests.get(body.id.index() as usize).copied().flatten();
            if rest.is_some_and(|rest| rest.at_rest) == at_rest {
                add(
                    &mut entity,
                    body.shape,
                    body.position,
                    body.rotation,
                    *color,
                );
            }
        }
        SceneUpdate {
            deletions: Vec::new(),
            entities: vec![entity],
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DrawState {
    Moving,
    /// Still for long enough to move to `resting`.
    Waiting,
    Resting,
}

fn timestamp(at_ns: u64) -> Timestamp {
    let seconds = u32::try_from(at_ns / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new(seconds, (at_ns % 1_000_000_000) as u32)
}

/// The poses of all bodies as drawn, in their order.
pub(crate) fn draw_poses(at_ns: u64, bodies: &[Painted<'_>]) -> PosesInFrame {
    let poses = bodies.iter();
    PosesInFrame {
        timestamp: Some(timestamp(at_ns)),
        frame_id: FRAME.to_owned(),
        poses: poses.map(|(body, _)| pose(body)).collect(),
    }
}

/// An empty entity; it replaces the entity of the same id.
fn entity(id: &str, at_ns: u64) -> SceneEntity {
    SceneEntity {
        timestamp: Some(timestamp(at_ns)),
        frame_id: FRAME.to_owned(),
        id: id.to_owned(),
        ..SceneEntity::default()
    }
}

/// Draws static bodies.
#[must_use]
pub fn draw_statics<'a>(at_ns: u64, bodies: impl Iterator<Item = DrawnBody<'a>>) -> SceneUpdate {
    let mut entity = entity("static", at_ns);
    for body in bodies {
        add(
            &mut entity,
            body.shape,
            body.position,
            body.rotation,
            STATIC,
        );
    }
    SceneUpdate {
        deletions: Vec::new(),
        entities: vec![entity],
    }
}

/// The colour of an engine's awake body.
pub const AWAKE: Color = grey(0.80, 1.0);
/// The colour of an engine's sleeping body.
pub const ASLEEP: Color = grey(0.50, 1.0);
/// Translucent, because walls stand in front of the bodies they contain.
const STATIC: Color = grey(0.60, 0.25);

const fn grey(share: f64, a: f64) -> Color {
    Color {
        r: share,
        g: share,
        b: share,
        a,
    }
}

/// The name of the frame of all drawings.
pub const FRAME: &str = "map";

/// Turns y up to z up: a quarter turn about x.
const UP: DQuat = DQuat::from_xyzw(
    std::f64::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f64::consts::FRAC_1_SQRT_2,
);

/// The place and colour of a body's primitives.
struct Brush {
    centre: DVec3,
    rotation: DQuat,
    color: Color,
}

impl Brush {
    /// An ellipsoid with these half extents.
    fn ellipsoid(&self, centre: DVec3, half: Vec3) -> SpherePrimitive {
        SpherePrimitive {
            pose: Some(drawn(centre, self.rotation)),
            size: size(half),
            color: Some(self.color),
        }
    }

    /// A ball looks the same in every orientation.
    fn sphere(&self, centre: DVec3, radius: f32) -> SpherePrimitive {
        SpherePrimitive {
            pose: Some(drawn(centre, UP.conjugate())),
            size: size(Vec3::splat(radius)),
            color: Some(self.color),
        }
    }

    /// Foxglove's cylinders stand along z, the engine's along y.
    fn cylinder(&self, centre: DVec3, half_height: f32, radius: f32) -> CylinderPrimitive {
        CylinderPrimitive {
            pose: Some(drawn(centre, self.rotation * UP.conjugate())),
            size: size(Vec3::new(radius, radius, half_height)),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: Some(self.color),
        }
    }

    fn cube(&self, half: Vec3, at: DVec3) -> CubePrimitive {
        CubePrimitive {
            pose: Some(drawn(self.centre + self.rotation * at, self.rotation)),
            size: size(half),
            color: Some(self.color),
        }
    }

    /// A slab under the plane, about its body.
    fn half_space(&self, normal: Vec3) -> CubePrimitive {
        let turned = DQuat::from_rotation_arc(DVec3::Y, normal.as_dvec3().normalize());
        let slab = self.cube(Vec3::new(50.0, 0.5, 50.0), turned * DVec3::NEG_Y * 0.5);
        let pose = slab.pose.map(|pose| Pose {
            orientation: drawn(self.centre, self.rotation * turned).orientation,
            ..pose
        });
        CubePrimitive { pose, ..slab }
    }
}

/// A primitive's size from its half extents.
fn size(half: Vec3) -> Option<Vector3> {
    let [x, y, z] = half.to_array().map(|half| 2.0 * f64::from(half));
    Some(Vector3 { x, y, z })
}

/// A body's pose as it is drawn; a ball, which looks the same in every orientation, is unturned.
pub(crate) fn pose(body: &DrawnBody<'_>) -> Pose {
    let rotation = match body.shape {
        Shape::Ball { .. } => UP.conjugate(),
        _ => DQuat::from_array(body.rotation.map(f64::from)),
    };
    drawn(DVec3::from_array(body.position.map(f64::from)), rotation)
}

/// Adds a body's primitives to an entity.
fn add(
    entity: &mut SceneEntity,
    shape: &Shape,
    position: [f32; 3],
    rotation: [f32; 4],
    color: Color,
) {
    let centre = DVec3::from_array(position.map(f64::from));
    let rotation = DQuat::from_array(rotation.map(f64::from));
    let brush = Brush {
        centre,
        rotation,
        color,
    };
    match *shape {
        Shape::Ball { radius } => entity.spheres.push(brush.sphere(centre, radius)),
        // A hull is drawn as an ellipsoid with its half extents; only the engine knows its faces.
        Shape::Hull(ref hull) => {
            let ellipsoid = brush.ellipsoid(centre, hull.half_extents());
            entity.spheres.push(ellipsoid);
        }
        Shape::Heights(_) | Shape::Mesh(_) => {
            let triangles = sheet(shape, drawn(centre, rotation));
            entity.triangles.push(TriangleListPrimitive {
                color: Some(color),
                ..triangles
            });
        }
        Shape::Compound(ref parts) => add_parts(entity, parts, centre, rotation, color),
        Shape::Cuboid { half_extents } => {
            entity.cubes.push(brush.cube(half_extents, DVec3::ZERO));
        }
        Shape::RoundedCuboid {
            half_extents,
            radius,
        } => {
            let half = half_extents + radius;
            entity.cubes.push(brush.cube(half, DVec3::ZERO));
        }
        Shape::HalfSpace { normal } => entity.cubes.push(brush.half_space(normal)),
        Shape::Cone {
            half_height,
            radius,
        } => {
            let middle = centre + rotation * DVec3::Y * f64::from(half_height) * 0.5;
            entity.cylinders.push(CylinderPrimitive {
                top_scale: 0.0,
                ..brush.cylinder(middle, half_height, radius)
            });
        }
        Shape::Cylinder {
            half_height,
            radius,
        } => {
            let cylinder = brush.cylinder(centre, half_height, radius);
            entity.cylinders.push(cylinder);
        }
        Shape::Capsule {
            half_height,
            radius,
        } => {
            let cylinder = brush.cylinder(centre, half_height, radius);
            entity.cylinders.push(cylinder);
            let end = rotation * DVec3::Y * f64::from(half_height);
            entity.spheres.push(brush.sphere(centre + end, radius));
            entity.spheres.push(brush.sphere(centre - end, radius));
        }
    }
}

/// Adds the primitives of each part of a compound.
fn add_parts(
    entity: &mut SceneEntity,
    compound: &Compound,
    centre: DVec3,
    rotation: DQuat,
    color: Color,
) {
    for part in compound.parts() {
        let at = (centre + rotation * part.position.as_dvec3()).as_vec3();
        let turned = (rotation * part.rotation.as_dquat()).as_quat();
        let (at, turned) = (at.to_array(), turned.to_array());
        add(entity, &part.shape, at, turned, color);
    }
}

/// Triangles of a height field or mesh, without colour; empty for any other shape.
fn sheet(shape: &Shape, pose: Pose) -> TriangleListPrimitive {
    let point = |DVec3 { x, y, z }| Point3 { x, y, z };
    let (points, indices) = match shape {
        Shape::Heights(heights) => {
            let posts = heights.posts().map(point).collect();
            (posts, cells(heights.rows(), heights.columns()))
        }
        Shape::Mesh(mesh) => {
            let points = mesh.points().iter().map(|at| point(at.as_dvec3()));
            (points.collect(), mesh.triangles().as_flattened().to_vec())
        }
        _ => (Vec::new(), Vec::new()),
    };
    TriangleListPrimitive {
        pose: Some(pose),
        points,
        indices,
        ..TriangleListPrimitive::default()
    }
}

/// Two triangles for each cell of a grid.
fn cells(rows: u32, columns: u32) -> Vec<u32> {
    let corners = |row, column| {
        let here: u32 = row * columns + column;
        let next = here + columns;
        [here, here + 1, next, next, here + 1, next + 1]
    };
    let cell = |row| (0..columns - 1).flat_map(move |column| corners(row, column));
    (0..rows - 1).flat_map(cell).collect()
}

/// Drawn positions are multiples of this, metres: a millimetre cannot be seen, and rounded numbers take half the bytes.
const POSITION_STEP: f64 = 1.0 / 1_024.0;
/// The same of a quaternion's components: a turn of 0.03 degrees.
const ROTATION_STEP: f64 = 1.0 / 4_096.0;

fn drawn(position: DVec3, rotation: DQuat) -> Pose {
    let turned = UP * rotation;
    let at = |metres: f64| (metres / POSITION_STEP).round() * POSITION_STEP;
    let part = |part: f64| (part / ROTATION_STEP).round() * ROTATION_STEP;
    Pose {
        position: Some(Vector3 {
            x: at(position.x),
            y: at(-position.z),
            z: at(position.y),
        }),
        orientation: Some(Quaternion {
            x: part(turned.x),
            y: part(turned.y),
            z: part(turned.z),
            w: part(turned.w),
        }),
    }
}

/// A body and its initial state.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The body is placed before the step that follows this tick.
    pub tick: Tick,
    /// Its descriptor.
    pub desc: BodyDesc,
    /// Its shape.
    pub shape: Shape,
    /// Its initial state.
    pub observation: Observation,
    /// Its inertia, if it rotates freely and the inertia is known.
    pub inertia: Option<Inertia>,
}

/// A body as it is drawn.
#[derive(Clone, Copy, Debug)]
pub struct DrawnBody<'a> {
    /// The body.
    pub id: BodyId,
    /// Its shape.
    pub shape: &'a Shape,
    /// Centre of mass, world frame, metres.
    pub position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// True if the body is at rest.
    pub still: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    const GREY: Color = Color {
        r: 0.5,
        g: 0.5,
        b: 0.5,
        a: 1.0,
    };

    fn turned(pose: &Pose, vector: DVec3) -> DVec3 {
        let q = pose.orientation.unwrap();
        DQuat::from_xyzw(q.x, q.y, q.z, q.w) * vector
    }

    #[test]
    fn y_up_is_drawn_as_z_up() {
        let mut entity = SceneEntity::default();
        let shape = Shape::Cylinder {
            half_height: 2.0,
            radius: 0.5,
        };
        add(
            &mut entity,
            &shape,
            [1.0, 3.0, 5.0],
            [0.0, 0.0, 0.0, 1.0],
            GREY,
        );
        let cylinder = &entity.cylinders[0];
        let pose = cylinder.pose.unwrap();
        assert_eq!(
            pose.position.unwrap(),
            Vector3 {
                x: 1.0,
                y: -5.0,
                z: 3.0
            }
        );
        // The cylinder's axis, z in Foxglove, is vertical, and its length lies along it.
        assert!((turned(&pose, DVec3::Z) - DVec3::Z).length() < 1e-12);
        assert_eq!(
            cylinder.size.unwrap(),
            Vector3 {
                x: 1.0,
                y: 1.0,
                z: 4.0
            }
        );
    }

    #[test]
    fn a_capsule_is_drawn_as_a_cylinder_and_two_balls() {
        let mut entity = SceneEntity::default();
        let shape = Shape::Capsule {
            half_height: 2.0,
            radius: 0.5,
        };
        // Lying along x: y turned to -x by a quarter turn about z.
        let lying = [0.0, 0.0, 0.5_f32.sqrt(), 0.5_f32.sqrt()];
        add(&mut entity, &shape, [0.0; 3], lying, GREY);
        assert_eq!((entity.cylinders.len(), entity.spheres.len()), (1, 2));
        let end = entity.spheres[0].pose.unwrap().position.unwrap();
        assert!((end.x + 2.0).abs() < 1e-6 && end.y.abs() < 1e-6 && end.z.abs() < 1e-6);
        let axis = turned(&entity.cylinders[0].pose.unwrap(), DVec3::Z);
        assert!((axis + DVec3::X).length() < 1e-3);
    }
}
