//! The bodies of a view at a moment, and those that move freely side by side.
//!
//! Between two ticks a motion is interpolated, but for a jump: a body that a command places elsewhere is shown at one of
//! its two places, never on a way between them.
//!
//! A stream bounds the error of its tracks. A view may show another pose: one that glides, one of an earlier
//! refresh. Invariant: the bound is never too small; where nothing finite is certain it is unknown.
//!
//! A track is unpacked once, when it comes into force; each refresh then predicts four bodies at a time. Invariants: a
//! body that is kept has its newest track, in force since the last refresh or before; lanes have no gap.

use std::f64::consts::PI;
use std::num::NonZeroU32;

use glam::{DQuat, DVec3, Quat, Vec3};
use rhumb_protocol::stream::{ErrorBound, FreeTrack, FreeTracksX4, Replacement, Subscriber};
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
pub(crate) fn between(first: &Motion, second: &Motion, fraction: f64) -> Option<Motion> {
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
/// shortest turn. A body that jumps at the next tick is at its first place until then. The rounding of the shown pose to 32
/// bits counts from [`COUNTED_ROUNDING`] on. `step`: the time between two ticks.
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
    let bound_at = |tick| match stream.bound_between(id, tick)? {
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
    let next = at.tick + Ticks::new(1);
    let ends = match motion {
        MomentMotion::At(_) if at.fraction == 0.0 || stream.has_left(id, next) => first_bound,
        _ => first_bound.max(bound_at(next)?),
    };
    let bound = bound_at_moment(&motion, ends, radius, at.fraction);
    Some(Metres::new(bound + off))
}

/// A body that one stream has until a tick, and another one from it on: it has crossed between two cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crossing<'s> {
    pub(crate) from: (&'s Subscriber, BodyId),
    pub(crate) to: (&'s Subscriber, BodyId),
}

impl Crossing<'_> {
    /// The motion of the body at a moment before the tick at which it crosses; `None` if it does not cross then.
    pub(crate) fn motion(&self, at: RenderTime, step: Seconds) -> Option<MomentMotion> {
        let ((from, local), (to, there)) = (self.from, self.to);
        let next = at.tick + Ticks::new(1);
        let first = from.predicted_motion(local, at.tick)?;
        let second = to.predicted_motion(there, next)?;
        let twist = first.twist();
        let led = Pose {
            position: first.pose().position + twist.linear * step.seconds(),
            rotation: (twist.turn_over(step) * first.pose().rotation).normalize(),
        };
        let leap = Leap {
            before: &Motion::new(led, twist).ok()?,
            after: &second,
            within: step,
        };
        Some(match leap.is_jump(to, there, next) {
            true => MomentMotion::Before(first, second),
            false => MomentMotion::Between(first, second),
        })
    }

    /// The bound on the error of the shown pose.
    pub(crate) fn bound(&self, shown: &ShownPose, at: RenderTime, step: Seconds) -> ErrorBound {
        let finite =
            |(stream, id): (&Subscriber, BodyId), tick| match stream.bound_between(id, tick) {
                Some(ErrorBound::Within(bound)) => Some(bound.metres()),
                _ => None,
            };
        let bound = || {
            let next = at.tick + Ticks::new(1);
            let ends = finite(self.from, at.tick)?.max(finite(self.to, next)?);
            let radius = self.to.0.radius_at(self.to.1, next)?;
            let motion = self.motion(at, step)?;
            let off = distance(shown, &motion.motion(at)?, radius);
            Some(bound_at_moment(&motion, ends, radius, at.fraction) + off)
        };
        bound().filter(|bound| bound.is_finite()).map_or_else(
            || ErrorBound::Unknown {
                since: self.from.0.complete(),
            },
            |bound| ErrorBound::Within(Metres::new(bound)),
        )
    }
}

/// The distance of any point of a body at the shown pose from where the stream has it, at most.
fn distance(shown: &ShownPose, known: &Motion, radius: Metres) -> f64 {
    let apart = Divergence::between(&shown.exactly(), &known.pose());
    let off = apart.surface_error(radius).metres();
    let is_rounded = *shown == ShownPose::of(known);
    if is_rounded && off < COUNTED_ROUNDING {
        return 0.0;
    }
    off
}

/// Rounding of a shown pose that is in its bound, metres: the unit of tolerances on the wire. Within some metres of the
/// origin rounding is less, and a bound is that of the stream.
const COUNTED_ROUNDING: f64 = 1e-6;

/// The bound at a moment of a motion, in metres; `ends`: the greater bound of its ticks.
fn bound_at_moment(motion: &MomentMotion, ends: f64, radius: Metres, fraction: f64) -> f64 {
    match motion {
        MomentMotion::At(_) => ends,
        MomentMotion::Between(first, second) => {
            let (first, second) = (first.pose(), second.pose());
            widened(ends, &first.rotation, &second.rotation, radius)
        }
        MomentMotion::Before(first, second) => {
            let apart = Divergence::between(&first.pose(), &second.pose());
            ends + way(&apart, ends, radius, fraction)
        }
    }
}

/// How far a body may have come at a fraction of a tick, at whose end it is `apart` from where it began, in metres.
///
/// Nothing tells a jump from a push that is as fast: the body may be on its way. It turns evenly, and no chord is longer than
/// its arc. The true turn exceeds the predicted one by the turns of both bounds at most.
fn way(apart: &Divergence, ends: f64, radius: Metres, fraction: f64) -> f64 {
    let straight = apart.position.metres() * fraction;
    let whole_turn = 2.0 * radius.metres();
    if whole_turn == 0.0 {
        return straight;
    }
    let of_bound = Divergence {
        half_chord: (ends / whole_turn).min(1.0),
        ..Divergence::default()
    };
    let turn = apart.turn().radians() + 2.0 * of_bound.turn().radians();
    let arc = radius.metres() * turn.min(PI) * fraction;
    straight + arc.min(whole_turn)
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

/// Freely moving bodies, by lane.
#[derive(Debug, Default)]
pub(crate) struct Movers {
    tracks: Vec<FreeTracksX4>,
    /// By lane: the place of the body in the view.
    places: Vec<u32>,
    /// By place: the lane plus one.
    lanes: Vec<Option<NonZeroU32>>,
}

impl Movers {
    /// Forgets all bodies.
    pub(crate) fn clear(&mut self) {
        self.tracks.clear();
        self.places.clear();
        self.lanes.clear();
    }

    /// True if the body of a place is kept.
    #[inline]
    pub(crate) fn has(&self, place: usize) -> bool {
        self.lanes.get(place).is_some_and(Option::is_some)
    }

    /// Keeps the body of a place, which is not kept yet.
    pub(crate) fn add(&mut self, place: usize, track: &FreeTrack) {
        let lane = self.places.len();
        if lane.is_multiple_of(FreeTracksX4::LANES) {
            reserve(&mut self.tracks, 1);
            self.tracks.push(FreeTracksX4::default());
        }
        self.put(lane, track);
        reserve(&mut self.places, 1);
        self.places.push(place as u32);
        if place >= self.lanes.len() {
            let missing = place + 1 - self.lanes.len();
            reserve(&mut self.lanes, missing);
            self.lanes.resize(place + 1, None);
        }
        self.lanes[place] = NonZeroU32::new(lane as u32 + 1);
    }

    /// Forgets the body of a place: the last lane moves to its lane.
    pub(crate) fn forget(&mut self, place: usize) {
        let Some(lane) = self.lanes.get_mut(place).and_then(Option::take) else {
            return;
        };
        let (lane, last) = (lane.get() as usize - 1, self.places.len() - 1);
        let track = self.tracks[last / FreeTracksX4::LANES].get(last);
        self.put(lane, &track);
        self.places.swap_remove(lane);
        self.tracks.truncate(last.div_ceil(FreeTracksX4::LANES));
        if let Some(moved) = self.places.get(lane) {
            self.lanes[*moved as usize] = NonZeroU32::new(lane as u32 + 1);
        }
    }

    /// Forgets the body of a place, to which the body of the last place moves.
    pub(crate) fn swap_remove(&mut self, place: usize, last: usize) {
        self.forget(place);
        let lane = self.lanes.get_mut(last).and_then(Option::take);
        if let Some(lane) = lane {
            self.places[lane.get() as usize - 1] = place as u32;
            // The last place had a lane, so that this one is in the list.
            self.lanes[place] = Some(lane);
        }
    }

    fn put(&mut self, lane: usize, track: &FreeTrack) {
        self.tracks[lane / FreeTracksX4::LANES].put(lane, track);
    }

    /// Passes the motions of all bodies at a moment to the callback, with their places.
    pub(crate) fn predict(
        &self,
        stream: &Subscriber,
        at: RenderTime,
        mut out: impl FnMut(usize, Motion),
    ) {
        let places = self.places.chunks(FreeTracksX4::LANES);
        for (tracks, places) in self.tracks.iter().zip(places) {
            let lanes = places.len();
            if at.fraction == 0.0 {
                stream.predict_free(tracks, lanes, at.tick, |lane, motion| {
                    out(places[lane] as usize, motion);
                });
                continue;
            }
            // No newer track comes into force at the next tick, so that no body jumps there.
            let mut first = [Motion::IDENTITY; FreeTracksX4::LANES];
            stream.predict_free(tracks, lanes, at.tick, |lane, motion| first[lane] = motion);
            stream.predict_free(tracks, lanes, at.tick + Ticks::new(1), |lane, second| {
                if let Some(motion) = between(&first[lane], &second, at.fraction) {
                    out(places[lane] as usize, motion);
                }
            });
        }
    }
}

/// Makes room for more. The capacity grows by an eighth, since doubling leaves half of it empty.
fn reserve<T>(list: &mut Vec<T>, more: usize) {
    if list.len() + more > list.capacity() {
        list.reserve_exact(more.max(list.len() / 8).max(LEAST_GROWTH));
    }
}

/// Least growth of a list.
const LEAST_GROWTH: usize = 16;

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use proptest::prelude::*;
    use rhumb_reckoning::Twist;

    use super::*;

    /// Metres that rounding may cost.
    const ROUNDING: f64 = 1e-9;

    fn any_vector() -> impl Strategy<Value = DVec3> {
        [-1.0..1.0, -1.0..1.0, -1.0..1.0].prop_map(DVec3::from_array)
    }

    fn any_turn(most: f64) -> impl Strategy<Value = DQuat> {
        let axis = any_vector().prop_filter("an axis", |axis| axis.length() > 0.1);
        (axis, 0.0..most).prop_map(|(axis, turn)| DQuat::from_axis_angle(axis.normalize(), turn))
    }

    fn any_motion() -> impl Strategy<Value = Motion> {
        (any_vector(), any_turn(PI)).prop_map(|(position, rotation)| {
            let pose = Pose { position, rotation };
            Motion::new(pose, Twist::ZERO).expect("a finite motion")
        })
    }

    /// The error of a true pose: metres and a turn.
    fn any_error() -> impl Strategy<Value = (DVec3, DQuat)> {
        (0.0..1.0, any_vector(), any_turn(1.0))
            .prop_map(|(scale, vector, turn)| (vector * scale, DQuat::IDENTITY.slerp(turn, scale)))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        #[test]
        fn no_point_is_beyond_the_bound_between_two_ticks(
            ticks in [any_motion(), any_motion()],
            errors in [any_error(), any_error()],
            point in any_vector().prop_filter("a side", |side| side.length() > 0.1),
            radius in 0.0..2.0,
            fraction in 0.0..1.0,
            jumps: bool,
        ) {
            let [first, second] = ticks;
            let truth = [0, 1].map(|at| {
                let (pose, (off, turn)) = (ticks[at].pose(), errors[at]);
                Pose { position: pose.position + off, rotation: turn * pose.rotation }
            });
            let radius = Metres::new(radius);
            let end = |at: usize| {
                let apart = Divergence::between(&truth[at], &ticks[at].pose());
                apart.surface_error(radius).metres()
            };
            let ends = end(0).max(end(1));
            let motion = match jumps {
                true => MomentMotion::Before(first, second),
                false => MomentMotion::Between(first, second),
            };
            let at = RenderTime { tick: Tick::ZERO, fraction };
            let shown = motion.motion(at).expect("a finite motion").pose();
            let true_pose = Pose {
                position: truth[0].position.lerp(truth[1].position, fraction),
                rotation: truth[0].rotation.slerp(truth[1].rotation, fraction),
            };
            let point = point.normalize() * radius.metres();
            let place = |pose: &Pose| pose.position + pose.rotation * point;
            let error = place(&shown).distance(place(&true_pose));
            let bound = bound_at_moment(&motion, ends, radius, fraction);
            prop_assert!(error <= bound + ROUNDING, "{error} m off, bound {bound} m");
        }
    }
}
