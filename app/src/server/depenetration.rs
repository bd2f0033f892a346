//! Keeps moving bodies above ground that changed.
//!
//! Ground is a surface: a body below a new one would fall for ever. Regions set their ground two or three times while
//! bodies already rest on it. A body below the ground is placed above it by its own size.

use glam::{DQuat, DVec3, Quat, Vec3};
use rhumb_protocol::scene::{BodyKind, Command, Heights, Shape};
use rhumb_reckoning::BodyId;

use super::host::AppScene;
use super::world_mirror::WorldMirror;

/// Raises the bodies below a body's height field.
pub(super) fn depenetrate(mirror: &WorldMirror, ground: BodyId, scene: &mut dyn AppScene) {
    let shape_of = |scene: &dyn AppScene, id| scene.shape(scene.body(id)?.shape).cloned();
    let (Some(Shape::Heights(field)), Some(at)) =
        (shape_of(scene, ground), scene.observation(ground))
    else {
        return;
    };
    let (origin, turned) = pose(&at.motion.parts());
    let moving = mirror
        .actors
        .values()
        .filter(|a| a.kind == BodyKind::Dynamic);
    let bodies: Vec<BodyId> = moving.filter_map(|a| a.body).map(|body| body.id).collect();
    for id in bodies {
        let Some(observation) = scene.observation(id) else {
            continue;
        };
        let parts = observation.motion.parts();
        let (position, _) = pose(&parts);
        let mut local = turned.conjugate() * (position - origin);
        let surface = highest_near(&field, local);
        if surface.is_none_or(|surface| local.y >= surface) {
            continue;
        }
        let radius = shape_of(scene, id).map_or(0.0, |shape| shape.bounding_radius().metres());
        local.y = surface.unwrap_or(local.y) + radius;
        let raised = Command::SetPose {
            id,
            position: (origin + turned * local).as_vec3(),
            rotation: Quat::from_xyzw(parts[3], parts[4], parts[5], parts[6]),
        };
        if let Err(error) = scene.command(&raised) {
            tracing::warn!(%id, %error, "a body stays under the ground");
        }
    }
}

fn pose(parts: &[f32; 13]) -> (DVec3, DQuat) {
    let position = Vec3::new(parts[0], parts[1], parts[2]);
    let rotation = Quat::from_xyzw(parts[3], parts[4], parts[5], parts[6]);
    (position.as_dvec3(), rotation.as_dquat().normalize())
}

/// The highest corner of the cell at a point; `None` beside the field.
fn highest_near(field: &Heights, at: DVec3) -> Option<f64> {
    let cell = |along: f64, spacing: f32, count: u32| {
        let place = (along / f64::from(spacing)).floor();
        (place >= 0.0 && place < f64::from(count - 1)).then_some(place as usize)
    };
    let row = cell(at.x, field.row_spacing(), field.rows())?;
    let column = cell(at.z, field.column_spacing(), field.columns())?;
    let columns = field.columns() as usize;
    let here = row * columns + column;
    let corners = [here, here + 1, here + columns, here + columns + 1];
    let heights = corners.map(|corner| f64::from(field.heights()[corner]));
    Some(heights.into_iter().fold(f64::MIN, f64::max))
}
