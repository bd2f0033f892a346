//! The predictors that a body may follow, and for how long each holds.
//!
//! Every judgement here is by the normative prediction against the recording.

use std::num::NonZeroU32;

use glam::DVec3;
use rhumb_reckoning::{
    Conditions, ConstantAcceleration, Divergence, Integrator, Metres, Motion, Pose, Predictor,
    Rate, RotationCursor, StepCoefficientTable, TRACK_AGE_MAX, Ticks, Tolerance, Twist,
    attached_motion, relative_to,
};

use super::path::Path;

/// A predictor of the closed list, in the world or in the frame of a body that holds. Bodies that tumble do so by either of the
/// moving ones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum PredictorKind {
    Rest,
    Attached,
    Uniform,
    Ballistic,
    ConstantAcceleration,
}

impl PredictorKind {
    /// Cheapest first: where two hold equally long, the first is taken.
    pub(super) const ALL: [Self; 5] = [
        Self::Rest,
        Self::Attached,
        Self::Uniform,
        Self::Ballistic,
        Self::ConstantAcceleration,
    ];

    pub(super) const fn name(self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Attached => "attached",
            Self::Uniform => "uniform",
            Self::Ballistic => "ballistic",
            Self::ConstantAcceleration => "constant-acceleration",
        }
    }

    /// As it is for a body that is_torque_free, or does not, and is pushed so, if it is.
    const fn predictor(
        self,
        is_torque_free: bool,
        push: Option<ConstantAcceleration>,
    ) -> Predictor {
        if let Some(push) = push {
            return Predictor::Accelerated(push);
        }
        match self {
            Self::Rest | Self::Attached => Predictor::Rest,
            Self::Uniform | Self::ConstantAcceleration if is_torque_free => Predictor::TorqueFree,
            Self::Uniform | Self::ConstantAcceleration => Predictor::Uniform,
            Self::Ballistic if is_torque_free => Predictor::BallisticTorqueFree,
            Self::Ballistic => Predictor::Ballistic,
        }
    }

    pub(super) const fn moves(self) -> bool {
        matches!(
            self,
            Self::Uniform | Self::Ballistic | Self::ConstantAcceleration
        )
    }
}

/// A body that may hold others, and where it is predicted_motion to be at each frame of its own.
#[derive(Clone, Debug)]
pub(super) struct ParentPath {
    pub(super) radius: Metres,
    pub(super) first: usize,
    pub(super) predicted_in_world: Vec<Motion>,
}

impl ParentPath {
    pub(super) fn at(&self, frame: usize) -> Option<&Motion> {
        self.predicted_in_world.get(frame.checked_sub(self.first)?)
    }
}

/// A motion from which a body goes on by a predictor.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentStart {
    pub(super) predictor: PredictorKind,
    /// The frame at which the motion holds.
    pub(super) frame: usize,
    /// In the world, or as the parent_candidate sees it.
    pub(super) motion: Motion,
    /// Place of the parent_candidate.
    pub(super) parent: Option<usize>,
    /// What pushes it, by that predictor and no other.
    pub(super) push: Option<ConstantAcceleration>,
}

/// What motions of one kind of damping become, by ticks: `p = p₀ + reach·v₀ + fall·g`, or `p₀ + reach·v₀ + pushed·a` for a push of
/// the acceleration a, and the angle for each rad/s.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    pub(super) flow: StepCoefficientTable,
    pub(super) reach: Vec<f64>,
    pub(super) fall: Vec<f64>,
    pub(super) pushed: Vec<f64>,
    pub(super) turn: Vec<f64>,
}

/// A spin so slow that the angle is as good as proportional to it, rad/s.
const SLOW: f64 = 1e-3;

impl Basis {
    /// Read off the normative prediction itself.
    pub(super) fn new(integrator: Integrator, path: &Path) -> Self {
        let mut flow = StepCoefficientTable::new(integrator, path.damping);
        flow.extend_to(TRACK_AGE_MAX);
        let start = Motion::new(
            Pose::IDENTITY,
            Twist {
                linear: DVec3::X,
                angular: DVec3::Z * SLOW,
            },
        )
        .expect("these numbers are finite");
        let conditions = Conditions {
            gravity: DVec3::Y,
            flow: &flow,
            inertia: None,
        };
        let after = |predictor: Predictor| {
            let ticks = 0..=TRACK_AGE_MAX.count();
            let ends = ticks.map(|ticks| predictor.predict(&start, Ticks::new(ticks), &conditions));
            ends.collect::<Vec<_>>()
        };
        let ends = after(Predictor::Ballistic);
        let position = |end: &Motion| end.pose().position;
        let by = ConstantAcceleration::SAMPLE.acceleration().y;
        let pushed = after(Predictor::Accelerated(ConstantAcceleration::SAMPLE));
        Self {
            reach: ends.iter().map(|end| position(end).x).collect(),
            fall: ends.iter().map(|end| position(end).y).collect(),
            pushed: pushed.iter().map(|end| position(end).y / by).collect(),
            turn: ends
                .iter()
                .map(|end| 2.0 * end.pose().rotation.z.asin() / SLOW)
                .collect(),
            flow,
        }
    }
}

/// One body's way, and what may be said of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentContext<'a> {
    pub(super) path: &'a Path,
    pub(super) basis: &'a Basis,
    pub(super) parents: &'a [ParentPath],
    pub(super) tolerance: Tolerance,
    pub(super) rate: Rate,
    pub(super) publish_interval: NonZeroU32,
}

impl SegmentContext<'_> {
    /// Ticks from one frame to a later one, as far as a prediction reaches.
    pub(super) fn ticks(&self, from: usize, to: usize) -> Ticks {
        let ticks = (to - from) as u64 * u64::from(self.publish_interval.get());
        Ticks::new(ticks.min(u64::from(TRACK_AGE_MAX.count())) as u32)
    }

    /// The frame after the last at which a predictor that is said now may still hold.
    pub(super) fn horizon(&self, predictor: PredictorKind, from: usize) -> usize {
        if predictor.moves() {
            let frames = TRACK_AGE_MAX.count() / self.publish_interval.get();
            self.path.end().min(from + frames as usize + 1)
        } else {
            self.path.end()
        }
    }

    /// Where the body is, as the parent_candidate sees it if there is one; none when the parent_candidate is gone.
    pub(super) fn target(&self, frame: usize, parent: Option<usize>) -> Option<Motion> {
        let truth = self.path.at(frame);
        let Some(parent) = parent else {
            return Some(*truth);
        };
        let by = self.parents[parent].at(frame)?;
        Some(relative_to(&by.pose(), &truth.pose()))
    }

    /// How a payload goes on for this body.
    pub(super) const fn predictor(&self, segment: &SegmentStart) -> Predictor {
        segment
            .predictor
            .predictor(self.path.inertia.is_some(), segment.push)
    }

    /// What a payload makes of a frame, in its own frame of reference.
    pub(super) fn predicted(
        &self,
        segment: &SegmentStart,
        frame: usize,
        cursor: &mut RotationCursor,
    ) -> Motion {
        let conditions = Conditions {
            gravity: self.path.gravity,
            flow: &self.basis.flow,
            inertia: self.path.inertia.as_ref(),
        };
        let ticks = self.ticks(segment.frame, frame);
        let predictor = self.predictor(segment);
        predictor.predict_with(&segment.motion, ticks, &conditions, cursor)
    }

    /// The same in the world; none when the parent_candidate is gone.
    pub(super) fn predicted_in_world(
        &self,
        segment: &SegmentStart,
        frame: usize,
        cursor: &mut RotationCursor,
    ) -> Option<Motion> {
        let predicted = self.predicted(segment, frame, cursor);
        match segment.parent {
            None => Some(predicted),
            Some(parent) => {
                let by = self.parents[parent].at(frame)?;
                Some(attached_motion(by, &predicted.pose()))
            }
        }
    }

    /// How far off a payload is at a frame.
    pub(super) fn apart(
        &self,
        segment: &SegmentStart,
        frame: usize,
        cursor: &mut RotationCursor,
    ) -> Option<Divergence> {
        let predicted_in_world = self.predicted_in_world(segment, frame, cursor)?;
        Some(Divergence::between(
            &self.path.at(frame).pose(),
            &predicted_in_world.pose(),
        ))
    }

    /// The frame after the last to which a payload keeps the promise without a gap.
    pub(super) fn holds_until(&self, segment: &SegmentStart) -> usize {
        let end = self.horizon(segment.predictor, segment.frame);
        let mut cursor = RotationCursor::default();
        for frame in segment.frame..end {
            // What lies still in truth and belief is no farther off than before.
            let still = segment.predictor == PredictorKind::Rest
                && frame > segment.frame
                && self.path.is_same(frame);
            if still {
                continue;
            }
            let within = self
                .apart(segment, frame, &mut cursor)
                .is_some_and(|apart| self.tolerance.share(&apart, self.path.radius) <= 1.0);
            if !within {
                return frame;
            }
        }
        end
    }
}
