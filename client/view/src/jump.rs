//! Tells a jump of a body from a motion that the stream has corrected.
//!
//! A body that a command places elsewhere is shown at one of its two places, never on a way between them.

use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Divergence, Metres, Motion, Seconds, Tick};

/// What a body was expected to do, and what it did.
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
