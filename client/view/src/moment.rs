//! The motion of a body at a moment, which may lie between two ticks.
//!
//! Between two ticks it is interpolated, but for a jump: a body that is placed elsewhere is at one place or at the other.

use glam::{DQuat, DVec3};
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Motion, Pose, Seconds, Ticks, Twist};

use crate::jump::Leap;
use crate::render_time::RenderTime;

/// True if a body's motion in the world is not known at a moment, because its parent was removed.
pub(crate) fn is_orphaned(stream: &Subscriber, id: BodyId, at: RenderTime) -> bool {
    let next = || stream.is_orphaned_at(id, at.tick + Ticks::new(1));
    stream.is_orphaned_at(id, at.tick) || (at.fraction > 0.0 && next())
}

/// The predicted motion of a body at a moment.
#[derive(Clone, Copy, Debug)]
pub(crate) enum MomentMotion {
    /// That of a tick: at the tick, or because the body is gone at the next one.
    At(Motion),
    /// Between the motions of two ticks.
    Between(Motion, Motion),
    /// The first motion, until the body jumps to the second one at the next tick.
    Before(Motion, Motion),
}

impl MomentMotion {
    /// The motion of a body at a moment; `None` for a body that does not exist then. `step`: the time between two ticks.
    pub(crate) fn of(
        stream: &Subscriber,
        id: BodyId,
        at: RenderTime,
        step: Seconds,
    ) -> Option<Self> {
        let first = stream.predicted_motion(id, at.tick)?;
        if at.fraction == 0.0 {
            return Some(Self::At(first));
        }
        let next = at.tick + Ticks::new(1);
        let Some(second) = stream.predicted_motion(id, next) else {
            return Some(Self::At(first));
        };
        let jumps = stream.continued_motion(id, at.tick).is_some_and(|before| {
            let leap = Leap {
                before: &before,
                after: &second,
                within: step,
            };
            leap.is_jump(stream, id, next)
        });
        Some(match jumps {
            true => Self::Before(first, second),
            false => Self::Between(first, second),
        })
    }

    /// The motion itself.
    pub(crate) fn motion(&self, at: RenderTime) -> Option<Motion> {
        match self {
            Self::At(motion) | Self::Before(motion, _) => Some(*motion),
            Self::Between(first, second) => between(first, second, at.fraction),
        }
    }
}

/// The motion between those of two ticks, interpolated linearly.
fn between(first: &Motion, second: &Motion, fraction: f64) -> Option<Motion> {
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
