//! A moment of a scene, and the motions of bodies at a moment.
//!
//! Between two ticks a motion is interpolated, but for a jump: a body that a command places elsewhere is shown at one of
//! its two places, never on a way between them.

use glam::{DQuat, DVec3};
use rhumb_protocol::stream::Subscriber;
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

/// The expected motion of a body, and its actual one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Leap<'a> {
    /// The motion without the newer track.
    pub(crate) before: &'a Motion,
    /// The motion with it.
    pub(crate) after: &'a Motion,
    /// Time in which the two may have parted.
    pub(crate) within: Seconds,
}

/// Tolerances within which two motions of one body are never a jump: each is off by one at most, and a correction may
/// begin on the glide of the last one.
const TOLERANCES: f64 = 3.0;

impl Leap<'_> {
    /// True if no motion leads from one to the other: they are farther apart than the velocities of both explain.
    ///
    /// `tick`: one at which the newer track is in force.
    pub(crate) fn is_jump(&self, stream: &Subscriber, id: BodyId, tick: Tick) -> bool {
        let Some(radius) = stream.radius_at(id, tick) else {
            return false;
        };
        let tolerance = stream.tolerance_of(id).unwrap_or(stream.tolerance());
        let reach = tolerance.reach(radius).metres();
        let speeds = speed(self.before, radius) + speed(self.after, radius);
        let apart = Divergence::between(&self.before.pose(), &self.after.pose());
        let apart = apart.surface_error(radius).metres();
        apart > TOLERANCES * reach + speeds * self.within.seconds()
    }
}

/// Speed of the fastest point of a body at most, m/s.
fn speed(motion: &Motion, radius: Metres) -> f64 {
    let twist = motion.twist();
    twist.linear.length() + twist.angular.length() * radius.metres()
}
