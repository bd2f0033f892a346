//! A moment of a scene, and the motions of bodies at a moment.
//!
//! Between two ticks a motion is interpolated, but for a jump: a body that a command places elsewhere is shown at one of
//! its two places, never on a way between them.

use glam::DVec3;
use rhumb_protocol::stream::{Replacement, Subscriber};
use rhumb_reckoning::{BodyId, Divergence, Metres, Motion, Pose, Seconds, Tick, Ticks, Twist};

/// A moment of the scene between two ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderTime {
    /// The tick at or before the moment.
    pub tick: Tick,
    /// Fraction of the step to the next tick, in [0, 1).
    pub fraction: f64,
}

impl RenderTime {
    /// The moment of a tick.
    #[must_use]
    pub const fn at(tick: Tick) -> Self {
        Self {
            tick,
            fraction: 0.0,
        }
    }

    pub(crate) fn from_ticks(ticks: f64) -> Self {
        let whole = ticks.max(0.0).floor();
        Self {
            tick: Tick::new(whole as u64),
            fraction: ticks.max(0.0) - whole,
        }
    }

    /// The moment in ticks since tick zero.
    #[must_use]
    pub fn ticks(&self) -> f64 {
        self.tick.value() as f64 + self.fraction
    }
}

/// True if a body's motion in the world is not known at a moment, because its parent was removed.
pub(crate) fn is_orphaned(stream: &Subscriber, id: BodyId, at: RenderTime) -> bool {
    let next = || stream.is_orphaned_at(id, at.tick + Ticks::new(1));
    stream.is_orphaned_at(id, at.tick) || (at.fraction > 0.0 && next())
}

/// The predicted motion of a body at a moment.
#[derive(Clone, Copy, Debug)]
pub(crate) enum MomentMotion {
    /// The motion of a tick: at the tick, or because the body is gone at the next one.
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
        let replaced = stream.replacement(id, next).filter(|of| of.at == next);
        let jumps = replaced.is_some_and(|of| Leap::at(&of, step).is_jump(stream, id, next));
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
    let turn = b.rotation * a.rotation.conjugate();
    // Of the two ways round, the shorter one.
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let way = Twist {
        angular: turn.to_scaled_axis(),
        ..Twist::ZERO
    };
    let pose = Pose {
        position: DVec3::lerp(a.position, b.position, fraction),
        rotation: way.turn_over(Seconds::new(fraction)) * a.rotation,
    };
    let twist = Twist {
        linear: DVec3::lerp(first.twist().linear, second.twist().linear, fraction),
        angular: DVec3::lerp(first.twist().angular, second.twist().angular, fraction),
    };
    Motion::new(pose, twist).ok()
}

/// The expected motion of a body, and its actual one, at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leap<'a> {
    /// The motion without the newer track.
    pub(crate) before: &'a Motion,
    /// The motion with it.
    pub(crate) after: &'a Motion,
    /// Longest time for which it may have moved as the newer track has it.
    pub(crate) within: Seconds,
}

/// Tolerances within which two motions of one body are never a jump: the older one was off by one before the tick, and
/// drifted in it; the newer one is off by one.
const TOLERANCES: f64 = 3.0;

impl<'a> Leap<'a> {
    /// From the older to the newer track, at the first tick of that one.
    pub(crate) fn at(replacement: &'a Replacement, step: Seconds) -> Self {
        Self {
            before: &replacement.before,
            after: &replacement.after,
            within: Seconds::new(f64::from(replacement.open.count()) * step.seconds()),
        }
    }

    /// True if no push leads from one to the other.
    ///
    /// A push changes the velocity at some moment of the time, and from then on the body moves as the newer track has it. So
    /// it is apart by a part of the way that the change of its velocity makes in the time, in that direction. A command
    /// that places a body leaves its velocity as it is. `tick`: one at which the newer track is in force.
    pub(crate) fn is_jump(&self, stream: &Subscriber, id: BodyId, tick: Tick) -> bool {
        let Some(radius) = stream.radius_at(id, tick) else {
            return false;
        };
        let tolerance = stream.tolerance_of(id).unwrap_or(stream.tolerance());
        let reach = tolerance.reach(radius).metres();
        self.unexplained(radius) > TOLERANCES * reach
    }

    /// The distance of the body's fastest point from where a push may have brought it, metres.
    fn unexplained(&self, radius: Metres) -> f64 {
        let (before, after) = (self.before, self.after);
        let apart = after.pose().position - before.pose().position;
        let way = (after.twist().linear - before.twist().linear) * self.within.seconds();
        let share = match way.length_squared() {
            0.0 => 0.0,
            length => (apart.dot(way) / length).clamp(0.0, 1.0),
        };
        let moved = (apart - way * share).length();
        let half_chord = Divergence::between(&before.pose(), &after.pose()).half_chord;
        let spin = (after.twist().angular - before.twist().angular).length();
        let turned = (2.0 * half_chord - spin * self.within.seconds()).max(0.0);
        moved + turned * radius.metres()
    }
}
