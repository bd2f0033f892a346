//! Which payload will serve a body best: for how long, and for how many bits.
//!
//! Only the publisher chooses, so that nothing here is normative: any choice keeps the promise, a good one keeps it
//! with fewer bytes. How long a payload holds is judged by what the same predictor would have made of what the body did last, or,
//! with lookahead, by what it will do.

mod acceleration;
mod allowance;
mod lifetime;
mod mode_candidates;
mod prediction_error;
mod shares;
mod trial;

use glam::DVec3;
use rhumb_reckoning::{
    Divergence, Metres, Motion, Pose, Predictor, TRACK_AGE_MAX, Tick, Ticks, Tolerance, Track,
    attached_motion, relative_to,
};

use super::features::Features;
use super::tracks::{Slot, Tracks};
use crate::packet::{Age, UpdatePayload};
pub(super) use allowance::ToleranceAllowance;
pub(super) use lifetime::error_growth;
pub(super) use mode_candidates::{ModeCandidate, ReferenceFrame};
use trial::{BestCorrection, Trial};

/// What is known of a body that is to be spoken of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Subject<'a> {
    /// Its index.
    pub(crate) index: u32,
    /// Its place in the table, and what was said of it last.
    pub(crate) slot: &'a Slot,
    pub(crate) track: &'a Track,
    /// The tick that is spoken of.
    pub(crate) tick: Tick,
    /// What it does then, and what is predicted_motion of it.
    pub(crate) truth: Motion,
    pub(crate) predicted_motion: Motion,
    /// What it did one and two ticks before.
    pub(crate) last: [Option<Motion>; 2],
    /// What it did one and two strides before.
    pub(crate) past: [Option<Motion>; 2],
    /// Ticks between two looks at what it did.
    pub(crate) stride: Ticks,
    /// What it will do, as far as lookahead knows.
    pub(crate) ahead: &'a [Motion],
    /// Whether it is known that nothing is seen of it after that.
    pub(crate) ends: bool,
    /// What could hold it.
    pub(crate) parent_candidate: Option<ParentCandidate<'a>>,
}

/// A body that another may be attached by.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ParentCandidate<'a> {
    /// Its index.
    pub(crate) index: u32,
    /// Its place in the table.
    pub(crate) slot: &'a Slot,
    /// What it does at the tick that is spoken of.
    pub(crate) truth: Motion,
    /// What it did one and two strides of the attached body before.
    pub(crate) past: [Option<Motion>; 2],
    /// What it will do.
    pub(crate) ahead: &'a [Motion],
}

/// Places that a still body is put on: where it is, and the middle of its mode_candidate in one, two, four and six ticks.
const AIMS: usize = AHEAD.len() + 1;
const AHEAD: [usize; 4] = [1, 2, 4, 6];
/// What an update costs beside its payload: its place in the packet, in 1/256 bits.
pub(super) const OVERHEAD: u32 = 4 * 256;
/// How far a still body is put ahead of its mode, as a share of the tolerance.
const AIM_MAX: f64 = 0.5;

/// A payload that keeps the promise, the track it leads to, and what it is units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChosenUpdate {
    pub(crate) payload: UpdatePayload,
    pub(crate) track: Track,
}

/// Chooses.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Chooser<'a> {
    pub(crate) tracks: &'a Tracks,
    pub(crate) features: Features,
    /// Factor on the tolerances by which lives are judged: more than one where a budget does not suffice, less for
    /// bodies that hold others.
    pub(crate) slack: f64,
}

/// Where to put a body.
#[derive(Clone, Copy, Debug)]
enum Aim {
    /// Where it is.
    Truth,
    /// So far from there: metres, and a rotation vector in radians.
    Beside([DVec3; 2]),
}

impl Chooser<'_> {
    /// The best payload among those that keep the promise, or `None` when no correction does.
    pub(crate) fn choose(&self, subject: &Subject<'_>) -> Option<ChosenUpdate> {
        let track = subject.track;
        let ticks = subject.tick.since(track.origin)?;
        let aged = ticks > TRACK_AGE_MAX && track.predictor != Predictor::Rest;
        let age = self.tracks.age(track, subject.tick)?;
        if age == Age::new(0) || aged || !self.features.residuals {
            return None;
        }
        let frames = self.frames(subject);
        let mode_candidates = self.mode_candidates(subject, &frames);
        let trial = Trial::new(self, subject, age, ticks);
        // Free bodies are put on the same place whatever their predictor.
        let free = trial.correction_base(&frames.free);
        let attached = frames
            .attached
            .as_ref()
            .map(|attached| trial.correction_base(&attached.frame));
        let correction_base = |mode_candidate: &ModeCandidate<'_>| match &attached {
            Some(attached) if mode_candidate.is_held() => attached,
            _ => &free,
        };
        let mut nearest = [None; 2];
        let mut best: Option<BestCorrection> = None;
        for number in mode_candidates.numbers() {
            let Some(mode_candidate) = mode_candidates.mode_candidate(number) else {
                continue;
            };
            let (of, correction_base) = (
                usize::from(mode_candidate.is_held()),
                correction_base(&mode_candidate),
            );
            let aims = (0..AIMS).map_while(|aim| self.aim(subject, &mode_candidate, aim));
            for aim in aims {
                let place = if let Aim::Truth = aim {
                    let nearest = &mut nearest[of];
                    nearest.get_or_insert_with(|| trial.place(correction_base, aim))
                } else {
                    &mut trial.place(correction_base, aim)
                };
                if let Some(place) = place {
                    trial.try_all((number, &mode_candidate), aim, place, &mut best);
                }
            }
        }
        let mut best = best?;
        let mode_candidate = mode_candidates.mode_candidate(best.mode_candidate)?;
        let (of, correction_base) = (
            usize::from(mode_candidate.is_held()),
            correction_base(&mode_candidate),
        );
        let nearest = &mut nearest[of];
        let place = if let Aim::Truth = best.aim {
            nearest.as_mut()
        } else {
            Some(nearest.insert(trial.place(correction_base, best.aim)))
        };
        let place = place?.as_mut()?;
        if self.features.sparse {
            trial.make_sparser(&mode_candidate, correction_base, place, &mut best);
        }
        Some(best.choice(&mode_candidate, place, &trial))
    }

    /// Where to aim: at the truth first; with lookahead, a still body may be put in the middle of what it will do.
    fn aim(
        &self,
        subject: &Subject<'_>,
        mode_candidate: &ModeCandidate<'_>,
        aim: usize,
    ) -> Option<Aim> {
        let Some(middle) = aim.checked_sub(1) else {
            return Some(Aim::Truth);
        };
        if mode_candidate.predictor != Predictor::Rest {
            return None;
        }
        let ticks = AHEAD[middle];
        let then = subject.ahead.get(ticks - 1)?;
        let [p, q] = match mode_candidate.frame.parent_candidate {
            None => apart(&then.pose(), &subject.truth.pose()),
            Some(parent_candidate) => {
                let by = parent_candidate.ahead.get(ticks - 1)?;
                let now = relative_to(&parent_candidate.truth.pose(), &subject.truth.pose());
                apart(&relative_to(&by.pose(), &then.pose()).pose(), &now.pose())
            }
        };
        let share = self
            .allowance(subject)
            .share(p.length() * 0.5, q.length() * 0.5);
        let scale = 0.5 * (AIM_MAX / share).min(1.0);
        Some(Aim::Beside([p * scale, q * scale]))
    }

    /// How much of the tolerance the beginning of a track uses, as a listener would measure it.
    pub(super) fn exact_share(
        &self,
        subject: &Subject<'_>,
        frame: &ReferenceFrame<'_>,
        begun: &Pose,
    ) -> f64 {
        let truth = subject.truth.pose();
        let (tolerance, radius) = (
            self.tracks.tolerance_of(subject.slot),
            self.tracks.radius(subject.slot),
        );
        match frame.parent_candidate {
            None => share(&truth, begun, tolerance, radius),
            Some(ParentCandidate { index, slot, .. }) => {
                let by = self
                    .tracks
                    .framed((*index, slot), &slot.track(), subject.tick);
                share(
                    &truth,
                    &attached_motion(&by, begun).pose(),
                    tolerance,
                    radius,
                )
            }
        }
    }

    /// What may be expected of a body.
    pub(super) fn allowance(&self, subject: &Subject<'_>) -> ToleranceAllowance {
        let tolerance = self.tracks.tolerance_of(subject.slot);
        ToleranceAllowance::of(tolerance, self.tracks.radius(subject.slot)).loosened(self.slack)
    }
}

/// How much of the tolerance lies between two poses of a body.
pub(crate) fn share(
    truth: &Pose,
    predicted_motion: &Pose,
    tolerance: Tolerance,
    radius: Metres,
) -> f64 {
    tolerance.share(&Divergence::between(truth, predicted_motion), radius)
}

/// How far one pose is from another, metres, and turned from it, as a rotation vector in radians.
pub(super) fn apart(to: &Pose, from: &Pose) -> [DVec3; 2] {
    let turn = to.rotation * from.rotation.conjugate();
    let sign = if turn.w < 0.0 { -2.0 } else { 2.0 };
    // Twice the sine of half the angle: near enough to the angle for what is within tolerance.
    let turn = DVec3::new(turn.x, turn.y, turn.z) * sign;
    [to.position - from.position, turn]
}
