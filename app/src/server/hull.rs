//! The hull of any number of points.

use glam::Vec3;
use rhumb_protocol::limits::HULL_POINTS_MAX;
use rhumb_protocol::scene::{Hull, Invalid};

/// A hull of any number of points, reduced to the allowed number: the farthest points in directions all around.
///
/// # Errors
///
/// [`Invalid`] for a point that is not finite or too far out, and for points that make no hull.
pub(super) fn hull_of(points: &[Vec3]) -> Result<Hull, Invalid> {
    if points.len() <= HULL_POINTS_MAX {
        return Hull::new(points);
    }
    let mut chosen = Vec::new();
    for direction in directions(HULL_POINTS_MAX) {
        let reach = |point: &Vec3| point.dot(direction);
        let farthest = points.iter().max_by(|a, b| reach(a).total_cmp(&reach(b)));
        chosen.extend(farthest.filter(|point| !chosen.contains(*point)).copied());
    }
    Hull::new(&chosen)
}

/// Unit vectors spread over a sphere, by the golden angle.
fn directions(count: usize) -> impl Iterator<Item = Vec3> {
    let golden = core::f32::consts::PI * (3.0 - 5.0_f32.sqrt());
    (0..count).map(move |place| {
        let y = 1.0 - 2.0 * (place as f32 + 0.5) / count as f32;
        let across = (1.0 - y * y).max(0.0).sqrt();
        let angle = golden * place as f32;
        Vec3::new(across * angle.cos(), y, across * angle.sin())
    })
}
