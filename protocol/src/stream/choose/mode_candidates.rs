//! The courses that a body may take.
//!
//! In the world, or attached by another body. Which of them serves best is not decided here.

use core::ops::Range;

use glam::DVec3;
use rhumb_reckoning::{ConstantAcceleration, Motion, Predictor, relative_to};

use super::acceleration::ACCELERATIONS;
use super::prediction_error::{PredictionError, UnforcedMotion};
use super::{Chooser, ParentCandidate, Subject, apart};
use crate::packet::{Age, PredictionMode};

/// Courses that are tried: rest, a predictor that falls, one that does not, being attached, and being accelerated.
const MODE_CANDIDATES: usize = 4 + ACCELERATIONS;
/// How many ticks more a push is expected to last.
const ACCELERATION_LIFETIME: f64 = 16.0;

/// What courses in one frame have to bring together.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReferenceFrame<'a> {
    /// Whose frame it is; none for the world.
    pub(crate) parent_candidate: Option<&'a ParentCandidate<'a>>,
    /// Where the body is, and where it was predicted.
    pub(crate) truth: Motion,
    pub(crate) predicted: Motion,
}

/// The frames of a body's courses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ReferenceFrames<'a> {
    pub(super) free: ReferenceFrame<'a>,
    pub(super) attached: Option<AttachedMode<'a>>,
}

/// How a body may be attached.
#[derive(Clone, Copy, Debug)]
pub(super) struct AttachedMode<'a> {
    pub(super) frame: ReferenceFrame<'a>,
    mode: PredictionMode,
    prediction_error: PredictionError,
}

/// A mode, and what is expected of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ModeCandidate<'a> {
    pub(crate) mode: PredictionMode,
    pub(crate) predictor: Predictor,
    pub(crate) frame: &'a ReferenceFrame<'a>,
    pub(super) prediction_error: PredictionError,
    /// For how many ticks it may go on at most, beyond those that are known.
    pub(crate) lasts: f64,
}

/// The courses that a body may take, each made when it is asked for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ModeCandidates<'f> {
    chooser: &'f Chooser<'f>,
    subject: &'f Subject<'f>,
    frames: &'f ReferenceFrames<'f>,
    /// Of the body that holds it now.
    parent_age: Option<Age>,
    /// A body whose parent is gone can only be said anew.
    orphaned: bool,
    floating: Predictor,
    falling: Predictor,
    unforced: UnforcedMotion,
    /// What it may fall by, m/s².
    gravity: Option<DVec3>,
    accelerations: [Option<ConstantAcceleration>; ACCELERATIONS],
}

impl<'f> ModeCandidates<'f> {
    /// The numbers that there may be courses of.
    pub(crate) const fn numbers(&self) -> Range<usize> {
        0..if self.orphaned { 0 } else { MODE_CANDIDATES }
    }

    /// One of them, if there is such a one.
    #[inline]
    pub(crate) fn mode_candidate(&self, number: usize) -> Option<ModeCandidate<'f>> {
        let (unforced, endless) = (&self.unforced, f64::INFINITY);
        let mode_candidate = match number {
            0 => {
                if !self.chooser.features.resting {
                    return None;
                }
                let prediction_error = self.chooser.rest_prediction_error(self.subject);
                self.free(Predictor::Rest, prediction_error, endless)
            }
            1 => self.free(self.floating, unforced.prediction_error(None), endless),
            2 => self.free(
                self.falling,
                unforced.prediction_error(Some(self.gravity?)),
                endless,
            ),
            3 => {
                let attached = self.frames.attached.as_ref()?;
                ModeCandidate {
                    mode: attached.mode,
                    predictor: Predictor::Rest,
                    frame: &attached.frame,
                    prediction_error: attached.prediction_error,
                    lasts: endless,
                }
            }
            _ => {
                let push = (*self.accelerations.get(number - 4)?)?;
                let prediction_error = unforced.prediction_error(Some(push.acceleration()));
                self.free(
                    Predictor::Accelerated(push),
                    prediction_error,
                    ACCELERATION_LIFETIME,
                )
            }
        };
        Some(mode_candidate)
    }

    /// A mode in the world.
    #[inline]
    fn free(
        &self,
        predictor: Predictor,
        prediction_error: PredictionError,
        lasts: f64,
    ) -> ModeCandidate<'f> {
        let now = self.subject.track;
        ModeCandidate {
            mode: if now.parent.is_none() && now.predictor == predictor {
                PredictionMode::Same
            } else {
                PredictionMode::World {
                    predictor,
                    parent_age: self.parent_age,
                }
            },
            predictor,
            frame: &self.frames.free,
            prediction_error,
            lasts,
        }
    }
}

impl ModeCandidate<'_> {
    /// Whether another body holds the body.
    pub(super) const fn is_held(&self) -> bool {
        self.frame.parent_candidate.is_some()
    }
}

impl Chooser<'_> {
    /// The frames of the courses that a body may take.
    pub(crate) fn frames<'s>(&self, subject: &'s Subject<'_>) -> ReferenceFrames<'s> {
        let parent_candidate = subject
            .parent_candidate
            .as_ref()
            .filter(|_| self.features.attached);
        ReferenceFrames {
            free: ReferenceFrame {
                parent_candidate: None,
                truth: subject.truth,
                predicted: subject.predicted_motion,
            },
            attached: parent_candidate
                .and_then(|parent_candidate| self.attached(subject, parent_candidate)),
        }
    }

    /// The courses that a body may take.
    pub(crate) fn mode_candidates<'f>(
        &'f self,
        subject: &'f Subject<'_>,
        frames: &'f ReferenceFrames<'_>,
    ) -> ModeCandidates<'f> {
        let now = subject.track;
        let parent = self.tracks.parent(now);
        let parent_age = parent.and_then(|(_, slot)| self.tracks.age(&slot.track(), subject.tick));
        let is_torque_free = subject.slot.is_torque_free() && self.features.torque_free;
        let (floating, falling) = if is_torque_free {
            (Predictor::TorqueFree, Predictor::BallisticTorqueFree)
        } else {
            (Predictor::Uniform, Predictor::Ballistic)
        };
        let gravity = self.tracks.gravity(subject.slot, subject.tick);
        ModeCandidates {
            chooser: self,
            subject,
            frames,
            parent_age,
            orphaned: now.parent.is_some() && parent.is_none(),
            floating,
            falling,
            unforced: self.unforced(subject, floating),
            gravity: Some(gravity).filter(|by| self.features.ballistic && *by != DVec3::ZERO),
            accelerations: self.accelerations(subject),
        }
    }

    /// The mode of being attached by another body.
    fn attached<'s>(
        &self,
        subject: &Subject<'_>,
        parent_candidate: &'s ParentCandidate<'s>,
    ) -> Option<AttachedMode<'s>> {
        let track = subject.track;
        let holding = parent_candidate.slot.track();
        let predicted_motion = self.tracks.framed(
            (parent_candidate.index, parent_candidate.slot),
            &holding,
            subject.tick,
        );
        let attached_already =
            track.parent == Some(parent_candidate.slot.id(parent_candidate.index));
        let mode = if attached_already {
            PredictionMode::Same
        } else if track.parent.is_none()
            && holding.parent.is_none()
            && parent_candidate.index != subject.index
        {
            PredictionMode::Attached {
                parent: parent_candidate.index,
                parent_age: self.tracks.age(&holding, subject.tick)?,
            }
        } else {
            return None;
        };
        let predicted = if attached_already {
            self.tracks
                .framed((subject.index, subject.slot), track, subject.tick)
        } else {
            relative_to(&predicted_motion.pose(), &subject.predicted_motion.pose())
        };
        let seen =
            |of: Option<Motion>, by: Option<Motion>| Some(relative_to(&by?.pose(), &of?.pose()));
        let now = relative_to(&parent_candidate.truth.pose(), &subject.truth.pose());
        let [one, two] = [0, 1].map(|i| {
            seen(subject.past[i], parent_candidate.past[i])
                .map(|then| apart(&now.pose(), &then.pose()))
        });
        // Of a body that was not seen before nothing says that it is attached.
        let one = one?;
        let two = two.unwrap_or([one[0] * 2.0, one[1] * 2.0]);
        Some(AttachedMode {
            mode,
            frame: ReferenceFrame {
                parent_candidate: Some(parent_candidate),
                truth: relative_to(&predicted_motion.pose(), &subject.truth.pose()),
                predicted,
            },
            prediction_error: PredictionError::still(one, two).by_ticks(subject.stride),
        })
    }
}
