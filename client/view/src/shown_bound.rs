//! The bound on the error of a pose that is shown.
//!
//! A stream bounds the error of its tracks. What is shown may be another pose: one that glides, one of an earlier
//! refresh. Invariant: the bound is never too small; where nothing finite is certain it is unknown.

use glam::{DQuat, Quat, Vec3};
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_reckoning::{BodyId, Divergence, Metres, Motion, Pose, Seconds, Ticks};

use crate::moment::{MomentMotion, is_orphaned};
use crate::render_time::RenderTime;

/// A pose as a view has it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ShownPose {
    pub(crate) position: Vec3,
    pub(crate) rotation: Quat,
}

impl ShownPose {
    /// Differs from every pose, itself included.
    #[cfg(feature = "queries")]
    pub(crate) const NOWHERE: Self = Self {
        position: Vec3::NAN,
        rotation: Quat::IDENTITY,
    };

    fn of(motion: &Motion) -> Self {
        let pose = motion.pose();
        Self {
            position: pose.position.as_vec3(),
            rotation: pose.rotation.as_quat(),
        }
    }

    fn exactly(&self) -> Pose {
        Pose {
            position: self.position.as_dvec3(),
            rotation: self.rotation.as_dquat(),
        }
    }
}

/// The bound on the error of a body that is shown with this pose at this moment.
///
/// The truth between two ticks lies between those of the ticks: its position on the straight line, its rotation on the
/// shortest turn. A body that jumps at the next tick is at its first place until then. The rounding of poses to 32 bits does
/// not count. `step`: the time between two ticks.
pub(crate) fn shown_bound(
    stream: &Subscriber,
    id: BodyId,
    shown: &ShownPose,
    (at, step): (RenderTime, Seconds),
) -> ErrorBound {
    let bound = finite_bound(stream, id, shown, (at, step));
    let bound = bound.filter(|bound| bound.metres().is_finite());
    bound.map_or_else(
        || ErrorBound::Unknown {
            since: stream.complete(),
        },
        ErrorBound::Within,
    )
}

fn finite_bound(
    stream: &Subscriber,
    id: BodyId,
    shown: &ShownPose,
    (at, step): (RenderTime, Seconds),
) -> Option<Metres> {
    let bound_at = |tick| match stream.bound_at(id, tick)? {
        ErrorBound::Within(bound) => Some(bound.metres()),
        ErrorBound::Unknown { .. } => None,
    };
    let first_bound = bound_at(at.tick)?;
    if is_orphaned(stream, id, at) {
        return None;
    }
    let radius = stream.radius_at(id, at.tick)?;
    let motion = MomentMotion::of(stream, id, at, step)?;
    let off = distance(shown, &motion.motion(at)?, radius);
    let bound = match motion {
        MomentMotion::At(_) => first_bound,
        MomentMotion::Between(first, second) => {
            let ends = first_bound.max(bound_at(at.tick + Ticks::new(1))?);
            widened(
                ends,
                &first.pose().rotation,
                &second.pose().rotation,
                radius,
            )
        }
        MomentMotion::Before(first, second) => {
            // Nothing tells a jump from a push that is as fast: the body may be on its way.
            let way = Divergence::between(&first.pose(), &second.pose()).surface_error(radius);
            let ends = first_bound.max(bound_at(at.tick + Ticks::new(1))?);
            ends + way.metres() * at.fraction
        }
    };
    Some(Metres::new(bound + off))
}

/// How far any point of a body at the shown pose is from where the stream has it.
fn distance(shown: &ShownPose, known: &Motion, radius: Metres) -> f64 {
    if *shown == ShownPose::of(known) {
        return 0.0;
    }
    let apart = Divergence::between(&shown.exactly(), &known.pose());
    apart.surface_error(radius).metres()
}

/// The bound between two ticks whose greater bound is `ends`.
///
/// Two rotations that turn for a tick may be farther apart between than at its ends: by 1 / cos(L / 2) at most, where
/// the longer of the two turns is 2 L. Source: law of sines on the unit sphere of quaternions, whose triangles with two
/// sides L have a middle line of half the base over cos(L / 2). Beyond a turn of 3 rad in a tick, nothing tells which
/// way round is the shorter one, so that the body may have any rotation.
fn widened(ends: f64, first: &DQuat, second: &DQuat, radius: Metres) -> f64 {
    let whole_turn = 2.0 * radius.metres();
    if whole_turn == 0.0 {
        return ends;
    }
    // The true turn differs from the predicted one by the bound at each end. A quarter of it is the sum of two angles:
    // half of the one whose cosine is `dot`, and the one whose sine is `half_chord`.
    let half_chord = (ends / whole_turn).min(1.0);
    let dot = first.dot(*second).abs().min(1.0);
    let quarter_cosine = ((1.0 + dot) / 2.0).sqrt() * (1.0 - half_chord * half_chord).sqrt()
        - ((1.0 - dot) / 2.0).sqrt() * half_chord;
    if quarter_cosine < LEAST_COSINE {
        return ends + whole_turn;
    }
    // The bound is a sum of a distance and a chord; only the chord widens, and no chord exceeds the diameter.
    let chord = ends.min(whole_turn);
    ends + chord * (1.0 / quarter_cosine - 1.0)
}

/// Cosine of a quarter of 3 rad, the longest turn in a tick whose shorter way round is certain: a little less than half
/// a turn.
const LEAST_COSINE: f64 = 0.731_688_868_873_820_9;
