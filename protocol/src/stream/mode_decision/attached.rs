//! The mode of a body that is attached to another one.

use rhumb_reckoning::{Motion, Pose, Predictor, Ticks, relative_to};

use super::errors::{Errors, Units, apart, observed_pose};
use super::modes::Prediction;
use super::recent::{Growth, growth_of_moves};
use super::subject::{Context, Parent, Subject, share};
use crate::packet::PredictionMode;

/// Share of the parent's tolerance up to which its prediction stands for its pose. Beyond, an update of it is due soon.
const PARENT_SHARE: f64 = 0.6;

/// The attached mode of one body. Errors are in metres and radians, in the frame of the parent.
#[derive(Debug)]
pub(super) struct Attached<'a> {
    context: &'a Context<'a>,
    subject: &'a Subject<'a>,
    mode: PredictionMode,
    parent: &'a Parent<'a>,
    /// True if the body is attached to this parent already.
    is_attached: bool,
    /// The predicted motion in the frame of the parent.
    predicted: Motion,
    /// The error of the uncorrected prediction.
    pub(super) now: Errors,
    /// Its growth, from past observations.
    pub(super) growth: Growth,
}

impl<'a> Attached<'a> {
    /// `None` if the mode does not apply.
    pub(super) fn new(context: &'a Context<'a>, subject: &'a Subject<'a>) -> Option<Self> {
        let parent = subject.parent.as_ref()?;
        let (track, tracks) = (subject.track, context.tracks);
        let above = parent.slot.track();
        let is_attached = track.parent == Some(parent.slot.id(parent.index));
        let may_be =
            track.parent.is_none() && above.parent.is_none() && parent.index != subject.index;
        if !context.features.attached || !is_attached && !may_be {
            return None;
        }
        // A body without past observations has no evidence of being attached.
        let past = parent.past?;
        let now = relative_to(&parent.truth.pose(), &subject.truth.pose());
        let moved = |stride: usize| {
            let (own, of) = (subject.past[stride]?, past[stride].as_ref()?);
            let past = relative_to(&observed_pose(of), &observed_pose(own));
            Some(apart(&now.pose(), &past.pose()))
        };
        let one = moved(0)?;
        let two = moved(1).unwrap_or(one * 2.0);
        let by = parent.predicted_motion.pose();
        let truth = relative_to(&by, &subject.truth.pose());
        let predicted = if is_attached {
            *subject.framed
        } else {
            relative_to(&by, &subject.predicted_motion.pose())
        };
        Some(Self {
            context,
            subject,
            mode: if is_attached {
                PredictionMode::Same
            } else {
                PredictionMode::Attached {
                    parent: parent.index,
                    parent_age: tracks.age(&above, subject.tick)?,
                }
            },
            parent,
            is_attached,
            predicted,
            now: apart(&truth.pose(), &predicted.pose()),
            growth: growth_of_moves([one, two], subject.stride),
        })
    }

    /// True if the body is attached, or moves with the parent by its velocities: apart by less than the tolerance in a
    /// tick.
    pub(super) fn moves_along(&self, units: &Units) -> bool {
        let (subject, parent) = (self.subject, self.parent);
        let (own, other) = (subject.truth.twist(), parent.truth.twist());
        let arm = subject.truth.pose().position - parent.truth.pose().position;
        let drift = own.linear - other.linear - other.angular.cross(arm);
        self.is_attached || units.share(&Errors::of_position(drift, units.moving)) <= 1.0
    }

    pub(super) fn prediction(&self) -> Prediction<'_> {
        Prediction {
            mode: self.mode,
            predictor: Predictor::Rest,
            parent: Some(self.parent),
            motion: &self.predicted,
        }
    }

    /// The error of the uncorrected prediction at a tick within the lookahead, where `truth` is the body's motion.
    pub(super) fn error(&self, tick: usize, truth: &Motion) -> Option<Errors> {
        let by = self.expected_parent_pose(tick)?;
        let relative = relative_to(&by, &truth.pose());
        Some(apart(&relative.pose(), &self.predicted.pose()))
    }

    /// Expected pose of the parent after `ticks`: the predicted one, or the true one if an update of it is due before.
    fn expected_parent_pose(&self, ticks: usize) -> Option<Pose> {
        let truth = self.parent.ahead.get(ticks - 1)?.pose();
        let (tracks, slot) = (self.context.tracks, self.parent.slot);
        let tick = self.subject.tick + Ticks::new(ticks as u32);
        let predicted_motion = tracks.framed((self.parent.index, slot), &slot.track(), tick);
        let used = share(
            &truth,
            &predicted_motion.pose(),
            tracks.tolerance_of(slot),
            tracks.radius(slot),
        );
        Some(if used <= PARENT_SHARE {
            predicted_motion.pose()
        } else {
            truth
        })
    }
}
