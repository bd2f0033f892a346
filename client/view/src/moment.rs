//! The motion of a body at a moment, which may lie between two ticks.

use glam::{DQuat, DVec3};
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Motion, Pose, Ticks, Twist};

use crate::render_time::RenderTime;

/// True if a body's motion in the world is not known at a moment, because its parent was removed.
pub(crate) fn is_orphaned(stream: &Subscriber, id: BodyId, at: RenderTime) -> bool {
    let next = || stream.is_orphaned_at(id, at.tick + Ticks::new(1));
    stream.is_orphaned_at(id, at.tick) || (at.fraction > 0.0 && next())
}

/// The predicted motion at a moment, interpolated linearly between two ticks.
pub(crate) fn predicted(stream: &Subscriber, id: BodyId, at: RenderTime) -> Option<Motion> {
    let first = stream.predicted_motion(id, at.tick)?;
    if at.fraction == 0.0 {
        return Some(first);
    }
    let second = stream.predicted_motion(id, at.tick + Ticks::new(1))?;
    between(&first, &second, at.fraction)
}

/// The motion between those of two ticks.
pub(crate) fn between(first: &Motion, second: &Motion, fraction: f64) -> Option<Motion> {
    let (a, b) = (first.pose(), second.pose());
    let pose = Pose {
        position: DVec3::lerp(a.position, b.position, fraction),
        rotation: DQuat::slerp(a.rotation, b.rotation, fraction),
    };
    let twist = Twist {
        linear: DVec3::lerp(first.twist().linear, second.twist().linear, fraction),
        angular: DVec3::lerp(first.twist().angular, second.twist().angular, fraction),
    };
    Motion::new(pose, twist).ok()
}
