//! Target of a kinematic body for the next step.
//!
//! No engine here. Poses are kept in f64, so that a velocity kept for hours ends at the right place. A turn is the
//! normalised linear substep of free bodies (RECKONING 2.4), so that predictors of free spin predict it.

use glam::{DQuat, DVec3};
use rhumb_protocol::wire::bytes::{Reader, Writer};
use rhumb_protocol::wire::{Malformed, Wire};
use rhumb_reckoning::{Integrator, Pose, Twist};

/// Commanded motion of one kinematic body.
#[derive(Clone, Copy, Debug)]
pub(super) struct KinematicTarget {
    /// Present pose.
    pose: Pose,
    /// Pose before the last step.
    last: Pose,
    /// Velocities that it keeps.
    twist: Twist,
    /// Pose that it goes to.
    target: Option<Target>,
    /// Velocities after the last step, unless those of its way continue.
    kept: Option<Twist>,
    /// Steps since the last command of a pose; more than the rhythm counts if there is none.
    since: u32,
    /// Steps between the last commands of poses, the newest first.
    intervals: [u32; RHYTHM],
}

/// The end of a way.
#[derive(Clone, Copy, Debug)]
struct Target {
    pose: Pose,
    /// Steps until it is there, at least one.
    steps: u32,
    /// True if a velocity was set after it: the caller says how it moves.
    is_timed: bool,
    /// True if no pose came shortly before it: nothing tells that others follow.
    is_first: bool,
}

/// The way of one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum KinematicStep {
    /// It moves there and carries what lies on it.
    Move(Pose),
    /// It is put there without a motion: the place is too far away for one.
    Jump(Pose),
}

/// Intervals between poses that count for the time to the next one. The longest one counts, so that a body does not wait
/// for a late pose.
const RHYTHM: usize = 8;

/// Longest interval between two poses of one motion, seconds.
const INTERVAL_SECONDS_MAX: f64 = 0.25;

/// Speed beyond which a pose is a jump, m/s: nothing that is carried or pushed can follow. It is relative to the velocity
/// that is set with the pose, and to the last step: a body that moves that fast does not jump.
const JUMP_SPEED: f64 = 100.0;

/// Turn in a step beyond which a pose is a jump, relative to the same two: a quarter of a turn, as the cosine of its half.
const JUMP_TURN: f64 = core::f64::consts::FRAC_1_SQRT_2;

/// Change of velocity in a step that always continues a motion, m/s and rad/s: a platform that starts or turns back.
const SMALL_CHANGE: f64 = 1.0;

impl KinematicStep {
    /// The end.
    pub(super) const fn pose(self) -> Pose {
        match self {
            Self::Move(pose) | Self::Jump(pose) => pose,
        }
    }
}

impl KinematicTarget {
    /// A body that stands still.
    pub(super) const fn at(pose: Pose) -> Self {
        Self {
            pose,
            last: pose,
            twist: Twist::ZERO,
            target: None,
            kept: None,
            since: u32::MAX,
            intervals: [1; RHYTHM],
        }
    }

    /// Sets a pose to go to; the body stands still there.
    ///
    /// It is there after the next step. If poses come at every second step, or more seldom, it is there when the next one is
    /// due, and moves evenly until then.
    pub(super) fn go_to(&mut self, pose: Pose, integrator: Integrator) {
        let longest = INTERVAL_SECONDS_MAX / integrator.rate.step().seconds();
        let is_first = f64::from(self.since) > longest;
        if is_first {
            self.intervals = [1; RHYTHM];
        } else if self.since > 0 {
            self.intervals.rotate_right(1);
            self.intervals[0] = self.since;
        }
        self.since = 0;
        self.target = Some(Target {
            pose,
            steps: self.intervals.into_iter().max().unwrap_or(1),
            is_timed: false,
            is_first,
        });
        self.twist = Twist::ZERO;
    }

    /// Keeps velocities from the next step on, or from the target on if one is set: it is there after the next step. A pose
    /// that follows is the first of a motion, however soon it comes: the caller says how the body moves.
    pub(super) const fn keep(&mut self, twist: Twist) {
        self.twist = twist;
        self.since = u32::MAX;
        if let Some(target) = &mut self.target {
            target.steps = 1;
            target.is_timed = true;
        }
    }

    /// Present pose.
    #[cfg(feature = "box3d")]
    pub(super) const fn pose(&self) -> Pose {
        self.pose
    }

    /// True if it moves in the next step.
    pub(super) fn is_moving(&self) -> bool {
        self.target.is_some() || self.twist != Twist::ZERO
    }

    /// True if it moves, or the time of its last pose counts for the next one.
    pub(super) fn is_needed(&self, integrator: Integrator) -> bool {
        let past = f64::from(self.since) * integrator.rate.step().seconds();
        self.is_moving() || past <= INTERVAL_SECONDS_MAX
    }

    /// Its velocities after the last step, unless those of its way continue: then the engine has them.
    pub(super) const fn kept(&self) -> Option<Twist> {
        self.kept
    }

    /// The velocities that it keeps, unless its next step goes to a target.
    pub(super) const fn keeps(&self) -> Option<Twist> {
        match self.target {
            Some(_) => None,
            None => Some(self.twist),
        }
    }

    /// The rotation at the end of a step at the velocities that it keeps.
    pub(super) fn turned(&self, integrator: Integrator) -> DQuat {
        carried(self.pose, self.twist, integrator).rotation
    }

    /// Ends a step at another pose than its velocities lead to; the engine has its velocities of that step.
    pub(super) const fn arrive(&mut self, pose: Pose) {
        self.since = self.since.saturating_add(1);
        (self.last, self.pose, self.kept) = (self.pose, pose, None);
    }

    /// The pose to which the next step puts it without a motion; `None` if it does not.
    pub(super) fn jump(&self, integrator: Integrator) -> Option<Pose> {
        self.target?;
        let mut ahead = *self;
        match ahead.advance(integrator) {
            KinematicStep::Jump(pose) => Some(pose),
            KinematicStep::Move(_) => None,
        }
    }

    /// The pose at the end of the next step.
    pub(super) fn advance(&mut self, integrator: Integrator) -> KinematicStep {
        self.since = self.since.saturating_add(1);
        let Some(mut target) = self.target.take() else {
            self.last = self.pose;
            self.pose = carried(self.pose, self.twist, integrator);
            self.kept = Some(self.twist);
            return KinematicStep::Move(self.pose);
        };
        let next = match target.steps {
            0 | 1 => target.pose,
            steps => {
                let share = 1.0 / f64::from(steps);
                target.steps -= 1;
                self.target = Some(target);
                Pose {
                    position: self.pose.position.lerp(target.pose.position, share),
                    rotation: self.pose.rotation.lerp(target.pose.rotation, share),
                }
            }
        };
        let is_jump = self.is_far(next, integrator);
        // A jump is not made in parts.
        let next = if is_jump { target.pose } else { next };
        if is_jump {
            self.target = None;
            // A pose that follows is no part of a motion with it.
            self.since = u32::MAX;
        }
        // From there it has the velocity that was set. Without one, only a way that continues the last one is kept.
        let continues = !is_jump
            && (target.is_timed || !target.is_first)
            && self.twist == Twist::ZERO
            && self.continues(next, integrator);
        self.kept = (!continues).then_some(self.twist);
        (self.last, self.pose) = (self.pose, next);
        if is_jump {
            KinematicStep::Jump(next)
        } else {
            KinematicStep::Move(next)
        }
    }

    /// True if no motion leads to a pose in one step: it is far from where its velocity would have it, and from where it
    /// would be as in the last step.
    fn is_far(&self, next: Pose, integrator: Integrator) -> bool {
        let most = JUMP_SPEED * integrator.rate.step().seconds();
        let is_far_from = |expected: Pose| {
            next.position.distance_squared(expected.position) > most * most
                || expected.rotation.dot(next.rotation).abs() < JUMP_TURN
        };
        is_far_from(carried(self.pose, self.twist, integrator)) && is_far_from(self.as_before())
    }

    /// The pose to which the way of the last step would lead in another one.
    fn as_before(&self) -> Pose {
        let turn = self.pose.rotation * self.last.rotation.conjugate();
        Pose {
            position: self.pose.position + (self.pose.position - self.last.position),
            rotation: (turn * self.pose.rotation).normalize(),
        }
    }

    /// True if a step to a pose continues the last one, but for half of the greater of the two, or for a small change.
    fn continues(&self, next: Pose, integrator: Integrator) -> bool {
        let small = SMALL_CHANGE * integrator.rate.step().seconds();
        let within = |off: f64, ways: [f64; 2]| off <= (ways[0].max(ways[1]) * 0.5).max(small);
        let expected = self.as_before();
        let places = [self.last, self.pose, next].map(|pose| pose.position);
        let ways = [0, 1].map(|step| places[step].distance(places[step + 1]));
        let turns = [(self.last, self.pose), (self.pose, next)].map(|(from, to)| turn(from, to));
        within(next.position.distance(expected.position), ways)
            && within(turn(expected, next), turns)
    }
}

/// The angle between two rotations, as far as the half of it is its sine: in radians, at most 2.
fn turn(from: Pose, to: Pose) -> f64 {
    let between = to.rotation * from.rotation.conjugate();
    2.0 * between.xyz().length()
}

impl Wire for KinematicTarget {
    fn encode(&self, to: &mut Writer) {
        encode_pose(self.pose, to);
        encode_pose(self.last, to);
        encode_twist(self.twist, to);
        to.u8(u8::from(self.target.is_some()) | u8::from(self.kept.is_some()) << 1);
        to.varint(u64::from(self.since));
        for interval in self.intervals {
            to.varint(u64::from(interval));
        }
        if let Some(target) = self.target {
            encode_pose(target.pose, to);
            to.varint(u64::from(target.steps));
            to.u8(u8::from(target.is_timed) | u8::from(target.is_first) << 1);
        }
        if let Some(kept) = self.kept {
            encode_twist(kept, to);
        }
    }

    fn decode(from: &mut Reader<'_>) -> Result<Self, Malformed> {
        let (pose, last, twist) = (decode_pose(from)?, decode_pose(from)?, decode_twist(from)?);
        let present = from.u8()?;
        let since = from.varint32()?;
        let mut intervals = [1; RHYTHM];
        for interval in &mut intervals {
            *interval = from.varint32()?;
        }
        let mut target = None;
        if present & 1 != 0 {
            let (pose, steps, flags) = (decode_pose(from)?, from.varint32()?, from.u8()?);
            target = Some(Target {
                pose,
                steps,
                is_timed: flags & 1 != 0,
                is_first: flags & 2 != 0,
            });
        }
        let mut kept = None;
        if present & 2 != 0 {
            kept = Some(decode_twist(from)?);
        }
        Ok(Self {
            pose,
            last,
            twist,
            target,
            kept,
            since,
            intervals,
        })
    }
}

fn encode_f64s(values: &[f64], to: &mut Writer) {
    for value in values {
        to.raw(&value.to_le_bytes());
    }
}

fn decode_f64s<const N: usize>(from: &mut Reader<'_>) -> Result<[f64; N], Malformed> {
    let mut values = [0.0; N];
    for value in &mut values {
        let bytes = from.raw(8)?.try_into().map_err(|_| Malformed::Truncated)?;
        *value = f64::from_le_bytes(bytes);
    }
    Ok(values)
}

fn encode_pose(pose: Pose, to: &mut Writer) {
    encode_f64s(&pose.position.to_array(), to);
    encode_f64s(&pose.rotation.to_array(), to);
}

fn decode_pose(from: &mut Reader<'_>) -> Result<Pose, Malformed> {
    Ok(Pose {
        position: DVec3::from_array(decode_f64s(from)?),
        rotation: DQuat::from_array(decode_f64s(from)?),
    })
}

fn encode_twist(twist: Twist, to: &mut Writer) {
    encode_f64s(&twist.linear.to_array(), to);
    encode_f64s(&twist.angular.to_array(), to);
}

fn decode_twist(from: &mut Reader<'_>) -> Result<Twist, Malformed> {
    Ok(Twist {
        linear: DVec3::from_array(decode_f64s(from)?),
        angular: DVec3::from_array(decode_f64s(from)?),
    })
}

/// A pose after one tick at constant velocities.
fn carried(pose: Pose, twist: Twist, integrator: Integrator) -> Pose {
    let dt = integrator.rate.step().seconds();
    let substeps = integrator.substeps.get();
    let half = dt / f64::from(substeps) * 0.5;
    let spin = twist.angular * half;
    let mut rotation = pose.rotation;
    if spin != DVec3::ZERO {
        for _ in 0..substeps {
            let turn = DQuat::from_xyzw(spin.x, spin.y, spin.z, 0.0) * rotation;
            rotation = (rotation + turn).normalize();
        }
    }
    Pose {
        position: pose.position + twist.linear * dt,
        rotation,
    }
}

#[cfg(test)]
mod tests {
    use core::num::NonZeroU32;

    use rhumb_reckoning::Rate;

    use super::*;

    const INTEGRATOR: Integrator = Integrator {
        rate: Rate::HZ_60,
        substeps: NonZeroU32::new(4).unwrap(),
    };

    #[test]
    fn sixty_steps_move_a_body_by_one_second_of_its_velocity() {
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        kinematic_target.keep(Twist {
            linear: DVec3::new(3.0, 0.0, 0.0),
            angular: DVec3::new(0.0, 1.0, 0.0),
        });
        let mut pose = Pose::IDENTITY;
        for _ in 0..60 {
            pose = kinematic_target.advance(INTEGRATOR).pose();
        }
        assert!((pose.position - DVec3::new(3.0, 0.0, 0.0)).length() < 1e-12);
        let turned = 2.0 * pose.rotation.y.atan2(pose.rotation.w);
        assert!((turned - 1.0).abs() < 1e-5, "{turned}");
    }

    #[test]
    fn a_pose_replaces_earlier_velocities_and_precedes_later_ones() {
        let target = Pose {
            position: DVec3::new(0.0, 0.5, 0.0),
            ..Pose::IDENTITY
        };
        let twist = Twist {
            linear: DVec3::X,
            ..Twist::ZERO
        };
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        kinematic_target.keep(twist);
        kinematic_target.go_to(target, INTEGRATOR);
        assert_eq!(
            kinematic_target.advance(INTEGRATOR),
            KinematicStep::Move(target)
        );
        assert_eq!(kinematic_target.kept(), Some(Twist::ZERO));
        assert!(!kinematic_target.is_moving());
        kinematic_target.go_to(target, INTEGRATOR);
        kinematic_target.keep(twist);
        kinematic_target.advance(INTEGRATOR);
        assert!(kinematic_target.advance(INTEGRATOR).pose().position.x > 0.0);
        assert_eq!(kinematic_target.kept(), Some(twist));
    }

    #[test]
    fn a_single_pose_says_nothing_of_a_way_beyond_it() {
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        let mut velocities_after = |x| {
            kinematic_target.go_to(at(x), INTEGRATOR);
            assert_eq!(kinematic_target.advance(INTEGRATOR).pose(), at(x));
            let kept = kinematic_target.kept();
            // Nothing for a second, or another pose at once.
            (kept, kinematic_target)
        };
        assert_eq!(velocities_after(0.5).0, Some(Twist::ZERO));
        let (second, mut kinematic_target) = velocities_after(1.0);
        assert_eq!(second, None, "a motion continues");
        for _ in 0..60 {
            kinematic_target.advance(INTEGRATOR);
        }
        kinematic_target.go_to(at(2.0), INTEGRATOR);
        kinematic_target.advance(INTEGRATOR);
        assert_eq!(kinematic_target.kept(), Some(Twist::ZERO));
    }

    fn at(x: f64) -> Pose {
        Pose {
            position: DVec3::new(x, 0.0, 0.0),
            ..Pose::IDENTITY
        }
    }

    /// Its places after each of 60 steps, if it is sent along x at one metre a second before these steps.
    fn ways(commands: impl Fn(u32) -> bool) -> Vec<f64> {
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        let mut ways = Vec::new();
        for step in 0..60 {
            if commands(step) {
                kinematic_target.go_to(at(f64::from(step + 1) / 60.0), INTEGRATOR);
            }
            let next = kinematic_target.advance(INTEGRATOR);
            assert!(matches!(next, KinematicStep::Move(_)));
            ways.push(next.pose().position.x);
        }
        ways
    }

    #[test]
    fn a_pose_at_each_step_is_reached_in_it() {
        for (step, x) in ways(|_| true).into_iter().enumerate() {
            assert!((x - (step as f64 + 1.0) / 60.0).abs() < 1e-12);
        }
    }

    #[test]
    fn poses_that_come_more_seldom_than_steps_make_an_even_motion() {
        for every in 2..=15 {
            let ways = ways(|step| step % every == 0);
            let speeds: Vec<_> = ways
                .windows(2)
                .map(|pair| (pair[1] - pair[0]) * 60.0)
                .collect();
            // The first interval is known with the second pose; the way that it makes up for is over with the third.
            for speed in &speeds[3 * every as usize..] {
                assert!((speed - 1.0).abs() < 1e-9, "{every}: {speeds:?}");
            }
        }
    }

    #[test]
    fn in_an_uneven_rhythm_it_seldom_waits_and_never_goes_back() {
        for seed in 1..50_u32 {
            let (mut state, mut next) = (seed, 0);
            let mut commands = Vec::new();
            for step in 0..60 {
                commands.push(step == next);
                if step == next {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    next += 1 + (state >> 16) % 4;
                }
            }
            let ways = ways(|step| commands[step as usize]);
            let speeds = ways[15..].windows(2).map(|pair| (pair[1] - pair[0]) * 60.0);
            let speeds: Vec<_> = speeds.collect();
            assert!(speeds.iter().all(|speed| *speed >= 0.0 && *speed < 2.5));
            let waits = speeds.iter().filter(|speed| **speed == 0.0).count();
            assert!(waits <= 3, "seed {seed}: {speeds:?}");
        }
    }

    #[test]
    fn when_poses_stop_it_ends_at_the_last_one() {
        for (every, last) in [(1, 30), (3, 30), (7, 28)] {
            let ways = ways(|step| step % every == 0 && step <= last);
            let end = f64::from(last + 1) / 60.0;
            assert!(ways.iter().all(|x| *x <= end + 1e-12));
            let there = last as usize + every as usize - 1;
            assert!(ways[there..].iter().all(|x| *x == end), "{every}");
        }
    }

    #[test]
    fn a_pose_after_a_pause_is_reached_in_the_next_step() {
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        for x in [0.1, 0.2, 0.3] {
            kinematic_target.go_to(at(x), INTEGRATOR);
            assert_eq!(
                kinematic_target.advance(INTEGRATOR),
                KinematicStep::Move(at(x))
            );
            for _ in 0..16 {
                assert_eq!(kinematic_target.advance(INTEGRATOR).pose(), at(x));
            }
        }
    }

    #[test]
    fn a_pose_after_a_velocity_is_reached_in_the_next_step() {
        // Commands that were on their way for unequal times: some come together, and none in a rhythm.
        for (kept_after, next_after) in [(0, 1), (0, 8), (4, 4), (4, 9), (9, 9)] {
            let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
            for x in [0.8, 0.0, 0.8, 0.0] {
                kinematic_target.go_to(at(x), INTEGRATOR);
                for step in 0..next_after {
                    if step == kept_after {
                        kinematic_target.keep(Twist::ZERO);
                    }
                    assert_eq!(kinematic_target.advance(INTEGRATOR).pose(), at(x));
                }
                if kept_after == next_after {
                    kinematic_target.keep(Twist::ZERO);
                }
            }
        }
    }

    #[test]
    fn a_pose_far_away_is_a_jump_whatever_the_velocities_that_follow() {
        let quarter = Pose {
            rotation: DQuat::from_rotation_y(2.0),
            ..Pose::IDENTITY
        };
        let moving = Twist {
            linear: DVec3::X * 6.0,
            angular: DVec3::Y * 9.0,
        };
        for far in [at(1.9), quarter] {
            for follows in [None, Some(Twist::ZERO), Some(moving)] {
                let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
                kinematic_target.keep(moving);
                kinematic_target.go_to(far, INTEGRATOR);
                if let Some(twist) = follows {
                    kinematic_target.keep(twist);
                }
                let after = follows.unwrap_or_default();
                let step = kinematic_target.advance(INTEGRATOR);
                assert_eq!(step, KinematicStep::Jump(far));
                assert_eq!(kinematic_target.kept(), Some(after));
                assert_eq!(kinematic_target.is_moving(), after != Twist::ZERO);
            }
        }
    }

    #[test]
    fn a_pose_soon_after_a_jump_is_reached_in_the_next_step() {
        for every in [1, 2, 3, 9] {
            let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
            for x in [50.0, 20.0, 0.0, 3.0, 1.9, 50.0, 49.0] {
                kinematic_target.go_to(at(x), INTEGRATOR);
                for _ in 0..every {
                    assert_eq!(kinematic_target.advance(INTEGRATOR).pose(), at(x));
                    assert_eq!(kinematic_target.kept(), Some(Twist::ZERO), "{every}: {x}");
                }
            }
        }
    }

    #[test]
    fn a_pose_where_its_velocity_leads_is_no_jump_however_fast() {
        for (speed, spin) in [(300.0, 0.0), (0.0, 110.0), (300.0, 110.0)] {
            let twist = Twist {
                linear: DVec3::X * speed,
                angular: DVec3::Y * spin,
            };
            let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
            let mut pose = Pose::IDENTITY;
            for _ in 0..5 {
                pose = carried(pose, twist, INTEGRATOR);
                kinematic_target.go_to(pose, INTEGRATOR);
                kinematic_target.keep(twist);
                let step = kinematic_target.advance(INTEGRATOR);
                assert_eq!(step, KinematicStep::Move(pose));
                assert_eq!(kinematic_target.kept(), Some(twist));
            }
        }
    }

    #[test]
    fn a_motion_of_poses_faster_than_a_jump_continues_once_it_has_begun() {
        // A copy under authority: a velocity of zero after each pose has it there in that step.
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        for step in 1..6 {
            let next = at(f64::from(step) * 4.0);
            kinematic_target.go_to(next, INTEGRATOR);
            kinematic_target.keep(Twist::ZERO);
            let expected = match step {
                1 => (KinematicStep::Jump(next), Some(Twist::ZERO)),
                _ => (KinematicStep::Move(next), None),
            };
            let step = kinematic_target.advance(INTEGRATOR);
            assert_eq!((step, kinematic_target.kept()), expected);
        }
    }

    #[test]
    fn poses_back_and_forth_are_no_motion_that_continues() {
        for follows in [None, Some(Twist::ZERO)] {
            let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
            for x in [0.8, 0.0, 1.2, 0.4, 0.4, -0.4] {
                kinematic_target.go_to(at(x), INTEGRATOR);
                if let Some(twist) = follows {
                    kinematic_target.keep(twist);
                }
                assert_eq!(kinematic_target.advance(INTEGRATOR).pose(), at(x));
                assert_eq!(kinematic_target.kept(), Some(Twist::ZERO), "at {x}");
            }
        }
    }

    #[test]
    fn after_a_pose_it_has_the_velocity_that_follows_not_that_of_its_way() {
        let twist = Twist {
            linear: DVec3::Z * 3.0,
            ..Twist::ZERO
        };
        let mut kinematic_target = KinematicTarget::at(Pose::IDENTITY);
        for x in [0.8, 0.0, 0.8] {
            for twist in [twist, Twist::ZERO] {
                kinematic_target.go_to(at(x), INTEGRATOR);
                kinematic_target.keep(twist);
                let step = kinematic_target.advance(INTEGRATOR);
                assert_eq!(step, KinematicStep::Move(at(x)));
                assert_eq!(kinematic_target.kept(), Some(twist));
            }
        }
    }
}
