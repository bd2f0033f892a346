//! The path of each body, and how long each predictor holds on it.
//!
//! A frame is a published tick: every tick, or every n-th. A path starts at the body's placement and ends at its
//! removal or the end of the recording. Every check compares the normative prediction with the recording.

use std::collections::BTreeMap;
use std::num::NonZeroU32;

use glam::DVec3;
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{
    BodyId, BodyState, Conditions, ConstantAcceleration, Damping, Divergence, Inertia, Integrator,
    Metres, Motion, Pose, Predictor, Rate, RotationCursor, StepCoefficientTable, TRACK_AGE_MAX,
    Tick, Ticks, Tolerance, ToleranceScale, Track, Twist, attached_motion, relative_to,
};

use crate::record::Placed;
use crate::recording::{Recording, first_track};

/// Path of one body.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) radius: Metres,
    pub(super) tolerance_scale: ToleranceScale,
    pub(super) damping: Damping,
    /// Gravity acting on it, m/s².
    pub(super) gravity: DVec3,
    /// Its inertia, if it rotates freely.
    pub(super) inertia: Option<Inertia>,
    /// The track that both ends know before the first update.
    pub(super) known: Track,
    /// Its first frame.
    pub(super) first: usize,
    /// Motion at its first frame and each one after.
    pub(super) motions: Vec<Motion>,
    /// True at each frame whose pose equals that of the frame before.
    pub(super) same: Vec<bool>,
}

impl Path {
    /// End of its frames.
    pub(super) const fn end(&self) -> usize {
        self.first + self.motions.len()
    }

    pub(super) fn at(&self, frame: usize) -> &Motion {
        &self.motions[frame - self.first]
    }

    pub(super) fn is_same(&self, frame: usize) -> bool {
        self.same[frame - self.first]
    }
}

/// The paths of a recording, built one at a time to bound memory.
#[derive(Debug)]
pub(super) struct Paths<'a> {
    recording: &'a Recording,
    publish_interval: NonZeroU32,
    removed: BTreeMap<BodyId, Tick>,
    rows: BTreeMap<BodyId, Vec<(u64, BodyState)>>,
    /// Non-static bodies, in order of placing.
    placed: Vec<&'a Placed>,
}

impl<'a> Paths<'a> {
    pub(super) fn new(recording: &'a Recording, publish_interval: NonZeroU32) -> Self {
        let truth = &recording.truth;
        let mut rows: BTreeMap<BodyId, Vec<_>> = BTreeMap::new();
        for (row, tick) in truth.ticks.iter().zip(1..) {
            for observation in row {
                let of_body = rows.entry(observation.id).or_default();
                of_body.push((tick, observation.motion));
            }
        }
        let can_move = |placed: &&Placed| placed.desc.kind != BodyKind::Fixed;
        Self {
            recording,
            publish_interval,
            removed: truth
                .removed
                .iter()
                .map(|(tick, id)| (*id, *tick))
                .collect(),
            rows,
            placed: truth.placed.iter().filter(can_move).collect(),
        }
    }

    /// Number of non-static bodies.
    pub(super) const fn len(&self) -> usize {
        self.placed.len()
    }

    /// Bounding radius of a body, metres.
    pub(super) fn radius(&self, place: usize) -> f64 {
        self.placed[place].shape.bounding_radius().metres()
    }

    /// Path of a body; `None` if it is present at no frame.
    pub(super) fn get(&self, place: usize) -> Option<Path> {
        let placed = self.placed[place];
        let id = placed.desc.id;
        let last = u64::from(self.recording.ticks());
        let end = self.removed.get(&id).map_or(last, |tick| tick.value());
        let observed = self.rows.get(&id).map_or(&[][..], Vec::as_slice);
        let path = path(self.recording, placed, observed, end, self.publish_interval);
        (!path.motions.is_empty()).then_some(path)
    }
}

/// Path of one body from its placement to `end`.
fn path(
    recording: &Recording,
    placed: &Placed,
    observed: &[(u64, BodyState)],
    end: u64,
    publish_interval: NonZeroU32,
) -> Path {
    let parameters = recording.parameters(placed);
    let publish_interval = u64::from(publish_interval.get());
    let first = placed.tick.value().div_ceil(publish_interval);
    let mut motion = placed.observation.motion.motion();
    let (mut motions, mut same) = (Vec::new(), Vec::new());
    let mut observed = observed.iter().peekable();
    for frame in first..=end / publish_interval {
        let before = motion;
        while let Some((tick, newer)) = observed.peek()
            && *tick <= frame * publish_interval
        {
            motion = newer.motion();
            observed.next();
        }
        same.push(frame > first && before.pose() == motion.pose());
        motions.push(motion);
    }
    Path {
        radius: parameters.radius,
        tolerance_scale: parameters.tolerance_scale,
        damping: parameters.damping,
        gravity: recording.gravity.as_dvec3() * f64::from(parameters.gravity_scale),
        known: first_track(placed, &parameters),
        inertia: parameters.inertia,
        first: first as usize,
        motions,
        same,
    }
}

/// A predictor, in the world frame or in the frame of a parent. Bodies with inertia rotate freely under either of the
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
    /// Cheapest first: where two hold equally long, the first is chosen.
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

    /// The protocol's predictor for a body with or without free rotation and with or without constant acceleration.
    const fn predictor(
        self,
        rotates_freely: bool,
        constant_acceleration: Option<ConstantAcceleration>,
    ) -> Predictor {
        if let Some(constant_acceleration) = constant_acceleration {
            return Predictor::Accelerated(constant_acceleration);
        }
        match self {
            Self::Rest | Self::Attached => Predictor::Rest,
            Self::Uniform | Self::ConstantAcceleration if rotates_freely => Predictor::TorqueFree,
            Self::Uniform | Self::ConstantAcceleration => Predictor::Uniform,
            Self::Ballistic if rotates_freely => Predictor::BallisticTorqueFree,
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

/// Path of a possible parent, and its predicted motion at each of its frames.
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

/// A motion from which a body continues by a predictor.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentStart {
    pub(super) predictor: PredictorKind,
    /// The frame at which the motion holds.
    pub(super) frame: usize,
    /// The motion in the world frame, or in the parent's frame.
    pub(super) motion: Motion,
    /// Index of the parent.
    pub(super) parent: Option<usize>,
    /// Acceleration, for that predictor only.
    pub(super) constant_acceleration: Option<ConstantAcceleration>,
}

/// Coefficients of motion after a number of ticks, for one damping: `p = p₀ + reach·v₀ + fall·g`, or `p₀ + reach·v₀ +
/// acceleration_gain·a` under a constant acceleration a; and the angle per rad/s.
#[derive(Clone, Debug)]
pub(super) struct Basis {
    pub(super) flow: StepCoefficientTable,
    pub(super) reach: Vec<f64>,
    pub(super) fall: Vec<f64>,
    pub(super) acceleration_gain: Vec<f64>,
    pub(super) turn: Vec<f64>,
}

/// A spin slow enough for the angle to be proportional to it, rad/s.
const SLOW: f64 = 1e-3;

impl Basis {
    /// Sampled from the normative prediction.
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
        let acceleration_gain = after(Predictor::Accelerated(ConstantAcceleration::SAMPLE));
        Self {
            reach: ends.iter().map(|end| position(end).x).collect(),
            fall: ends.iter().map(|end| position(end).y).collect(),
            acceleration_gain: acceleration_gain
                .iter()
                .map(|end| position(end).y / by)
                .collect(),
            turn: ends
                .iter()
                .map(|end| 2.0 * end.pose().rotation.z.asin() / SLOW)
                .collect(),
            flow,
        }
    }
}

/// One body's path, and the parameters of its search.
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
    /// Ticks from one frame to a later one, up to the longest track age.
    pub(super) fn ticks(&self, from: usize, to: usize) -> Ticks {
        let ticks = (to - from) as u64 * u64::from(self.publish_interval.get());
        Ticks::new(ticks.min(u64::from(TRACK_AGE_MAX.count())) as u32)
    }

    /// End of the frames for which a predictor started at `from` may hold.
    pub(super) fn horizon(&self, predictor: PredictorKind, from: usize) -> usize {
        if predictor.moves() {
            let frames = TRACK_AGE_MAX.count() / self.publish_interval.get();
            self.path.end().min(from + frames as usize + 1)
        } else {
            self.path.end()
        }
    }

    /// Motion of the body, in the parent's frame if given; `None` once the parent is removed.
    pub(super) fn target(&self, frame: usize, parent: Option<usize>) -> Option<Motion> {
        let truth = self.path.at(frame);
        let Some(parent) = parent else {
            return Some(*truth);
        };
        let by = self.parents[parent].at(frame)?;
        Some(relative_to(&by.pose(), &truth.pose()))
    }

    /// The predictor of a segment of this body.
    pub(super) const fn predictor(&self, segment: &SegmentStart) -> Predictor {
        segment
            .predictor
            .predictor(self.path.inertia.is_some(), segment.constant_acceleration)
    }

    /// Predicted motion of a segment at a frame, in the segment's frame of reference.
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

    /// The same in the world frame; `None` once the parent is removed.
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

    /// Distance between the prediction of a segment and the truth at a frame.
    pub(super) fn divergence(
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

    /// End of the contiguous frames in which a segment stays within tolerance.
    pub(super) fn holds_until(&self, segment: &SegmentStart) -> usize {
        let end = self.horizon(segment.predictor, segment.frame);
        let mut cursor = RotationCursor::default();
        for frame in segment.frame..end {
            // If neither the body nor the prediction moves, the error does not change.
            let still = segment.predictor == PredictorKind::Rest
                && frame > segment.frame
                && self.path.is_same(frame);
            if still {
                continue;
            }
            let within = self
                .divergence(segment, frame, &mut cursor)
                .is_some_and(|divergence| {
                    self.tolerance.share(&divergence, self.path.radius) <= 1.0
                });
            if !within {
                return frame;
            }
        }
        end
    }
}
