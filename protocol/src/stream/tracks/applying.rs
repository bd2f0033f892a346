//! Applies a payload to a track, at publisher and subscriber alike.

use rhumb_reckoning::{
    Anchor, BodyId, CorrectedX4, DenseTrack, Grid, LaneCorrection, Motion, PredictionX4, Predictor,
    QuantisedState, Residual, RestCorrection, Seconds, TRACK_AGE_MAX, Tick, Track, attached_motion,
    relative_to,
};

use super::{Slot, Tracks};
use crate::packet::{Age, PredictionMode, UpdatePayload};

/// The reason why a payload was not applied.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unreadable {
    /// No body has this index.
    NoBody,
    /// The track is at least as new as the payload.
    Superseded,
    /// The payload builds on another track of its body.
    OtherRevision,
    /// The payload builds on another track of the parent.
    OtherParentRevision,
}

impl Tracks {
    /// The frame of the new track, and the prediction in it that a payload corrects.
    ///
    /// Fails if the payload builds on other tracks than these.
    fn prediction_base(
        &self,
        index: u32,
        mode: &PredictionMode,
        age: Age,
        tick: Tick,
    ) -> Result<PredictionBase, Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        let track = &slot.track();
        if !self.is_of_age(track, age, tick) {
            return Err(Unreadable::OtherRevision);
        }
        let over = tick.since(track.origin).unwrap_or(TRACK_AGE_MAX);
        let free = track.parent.is_none();
        let (predictor, parent, predicted) = match *mode {
            PredictionMode::Same => (
                track.predictor,
                track.parent,
                self.framed((index, slot), track, tick),
            ),
            PredictionMode::World {
                predictor,
                parent_age,
            } => {
                let predicted_motion = match (self.parent(track), parent_age) {
                    (None, None) if free => self.framed((index, slot), track, tick),
                    (Some(parent_candidate), Some(age)) => {
                        let revision = self.of_age(parent_candidate, age, tick)?;
                        let motion = self.framed((index, slot), track, tick);
                        let parent_candidate = self.framed(parent_candidate, &revision, tick);
                        attached_motion(&parent_candidate, &motion.pose())
                    }
                    _ => return Err(Unreadable::OtherRevision),
                };
                (predictor, None, predicted_motion)
            }
            PredictionMode::Attached { parent, parent_age } => {
                let parent_candidate = self.slot(parent).ok_or(Unreadable::NoBody)?;
                let revision = self.of_age((parent, parent_candidate), parent_age, tick)?;
                let free = revision.parent.is_none() && track.parent.is_none();
                if parent == index || !free {
                    return Err(Unreadable::OtherRevision);
                }
                let holds = self.framed((parent, parent_candidate), &revision, tick);
                let predicted_motion = self.predicted_motion((index, slot), tick);
                let relative_pose = relative_to(&holds.pose(), &predicted_motion.pose());
                (
                    Predictor::Rest,
                    Some(parent_candidate.id(parent)),
                    relative_pose,
                )
            }
        };
        Ok(PredictionBase {
            predictor,
            parent,
            predicted,
            over: track.predictor.divergence_time(over, self.integrator.rate),
        })
    }

    /// True if a track has the age that a payload gives.
    fn is_of_age(&self, track: &Track, age: Age, tick: Tick) -> bool {
        self.age(track, tick) == Some(age)
    }

    /// The track of a parent if it has this age.
    fn of_age(&self, (_, slot): (u32, &Slot), age: Age, tick: Tick) -> Result<Track, Unreadable> {
        let track = slot.track();
        let matching = self.is_of_age(&track, age, tick).then_some(track);
        matching.ok_or(Unreadable::OtherParentRevision)
    }

    /// The track of a body after a payload at `tick`.
    fn corrected_track(
        &self,
        index: u32,
        tick: Tick,
        payload: &UpdatePayload,
    ) -> Result<Track, Unreadable> {
        let (mode, age, residual) = match payload {
            UpdatePayload::Keyframe(keyframe) => return Ok(keyframe.track(tick)),
            UpdatePayload::Resting {
                age,
                rest_correction,
            } => return self.resting(index, tick, *age, rest_correction),
            UpdatePayload::Residual {
                mode,
                age,
                residual,
            } => (mode, *age, residual),
        };
        let prediction_base = self.prediction_base(index, mode, age, tick)?;
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        Ok(prediction_base.track(tick, residual, self.grid(slot)))
    }

    /// The track of a body that comes to rest.
    fn resting(
        &self,
        index: u32,
        tick: Tick,
        age: Age,
        rest_correction: &RestCorrection,
    ) -> Result<Track, Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        let track = slot.track();
        let free = track.parent.is_none();
        if !free || !self.is_of_age(&track, age, tick) {
            return Err(Unreadable::OtherRevision);
        }
        let predicted = self.framed((index, slot), &track, tick);
        rest_correction
            .onto(&predicted.pose())
            .map(|body_state| Track::resting(tick, body_state))
            .map_err(|_| Unreadable::OtherRevision)
    }

    /// Applies a payload to a body at a tick.
    pub(crate) fn apply(
        &mut self,
        index: u32,
        tick: Tick,
        payload: &UpdatePayload,
    ) -> Result<(), Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        if tick <= slot.origin() {
            return Err(Unreadable::Superseded);
        }
        let track = self.corrected_track(index, tick, payload)?;
        self.set_track(index, track);
        Ok(())
    }
}

/// Corrections of bodies without a parent, whose predictions are computed four at a time.
#[derive(Debug, Default)]
pub(crate) struct CorrectionsX4<'a> {
    batch: PredictionX4,
    /// In the order of the batch. Entries after the batch's bodies have no meaning.
    queued: [QueuedCorrection<'a>; PredictionX4::LANES],
    len: usize,
}

/// A correction that waits for its prediction.
#[derive(Clone, Copy, Debug, Default)]
struct QueuedCorrection<'a> {
    index: u32,
    /// The number of the body's parameters.
    interned: u32,
    /// The new predictor, the divergence time and the correction.
    correction: Option<(Predictor, Seconds, &'a Residual)>,
}

impl CorrectionsX4<'_> {
    /// True if the correction of a body is queued.
    #[inline]
    pub(crate) fn has(&self, index: u32) -> bool {
        let queued = &self.queued[..self.len];
        queued.iter().any(|queued| queued.index == index)
    }

    /// True if the corrections are due.
    pub(crate) const fn is_full(&self) -> bool {
        self.batch.is_full()
    }

    /// Empties the queue.
    pub(crate) const fn clear(&mut self) {
        self.len = 0;
    }
}

impl Tracks {
    /// Queues the correction of a body at a tick for `batch`. Returns `false`, without any change, for a payload that
    /// must be applied alone. A batch belongs to one tick and contains each body once.
    #[must_use]
    pub(crate) fn enqueue_x4<'a>(
        &self,
        batch: &mut CorrectionsX4<'a>,
        index: u32,
        tick: Tick,
        payload: &'a UpdatePayload,
    ) -> bool {
        let UpdatePayload::Residual {
            mode,
            age,
            residual,
        } = payload
        else {
            return false;
        };
        let Some(slot) = self.slot(index) else {
            return false;
        };
        let (origin, was) = (slot.origin(), slot.predictor());
        let of_age = Age::of(origin, tick, self.publish_interval) == Some(*age);
        let predictor = match *mode {
            PredictionMode::Same => was,
            PredictionMode::World {
                predictor,
                parent_age: None,
            } => predictor,
            _ => return false,
        };
        let free = slot.parent().is_none();
        if tick <= origin || !of_age || !free {
            return false;
        }
        let Some(place) = batch.queued.get_mut(batch.len) else {
            return false;
        };
        if !self.take(&mut batch.batch, index, slot, tick) {
            return false;
        }
        let over = tick.since(origin).unwrap_or(TRACK_AGE_MAX);
        let over = was.divergence_time(over, self.integrator.rate);
        *place = QueuedCorrection {
            index,
            interned: slot.interned,
            correction: Some((predictor, over, residual)),
        };
        batch.len += 1;
        true
    }

    /// Computes the queued corrections, which stay queued until [`CorrectionsX4::clear`].
    pub(crate) fn correct(&self, batch: &mut CorrectionsX4<'_>) -> Option<CorrectedX4> {
        let CorrectionsX4 { batch, queued, len } = batch;
        let corrections = queued[..*len].iter().filter_map(|queued| {
            let (_, over, residual) = queued.correction?;
            let grid = &self.interned_parameters.get(queued.interned).grid;
            Some(LaneCorrection {
                residual,
                over,
                grid,
            })
        });
        batch.correct(corrections)
    }

    /// Applies one of the corrections; returns the body and its earlier track.
    #[inline]
    pub(crate) fn apply_corrected(
        &mut self,
        batch: &CorrectionsX4<'_>,
        corrected: &CorrectedX4,
        lane: usize,
        tick: Tick,
    ) -> Option<(u32, DenseTrack)> {
        let queued = batch.queued.get(lane)?;
        let (predictor, ..) = queued.correction?;
        let quantised = corrected.at(lane);
        let quantised = match predictor {
            Predictor::Rest => quantised.stilled(),
            _ => quantised,
        };
        let track = DenseTrack::on_grid(tick, predictor, &quantised);
        Some((queued.index, self.replace_track(queued.index, track)?))
    }
}

/// The prediction that a correction is added to.
#[derive(Clone, Copy, Debug)]
struct PredictionBase {
    /// The predictor of the new track.
    predictor: Predictor,
    /// The body whose frame the new track is in; None for the world frame.
    parent: Option<BodyId>,
    /// The predicted motion in that frame.
    predicted: Motion,
    /// The divergence time of the prediction (RECKONING 4.4).
    over: Seconds,
}

impl PredictionBase {
    fn track(&self, tick: Tick, residual: &Residual, grid: &Grid) -> Track {
        let quantised = residual.onto(&self.predicted, self.over, grid);
        on_grid(tick, self.predictor, self.parent, quantised)
    }
}

/// The track that starts from a motion on its grid.
fn on_grid(
    tick: Tick,
    predictor: Predictor,
    parent: Option<BodyId>,
    quantised: QuantisedState,
) -> Track {
    let resting = predictor == Predictor::Rest;
    Track {
        origin: tick,
        predictor,
        anchor: Anchor::Quantised(if resting {
            quantised.stilled()
        } else {
            quantised
        }),
        parent,
    }
}
