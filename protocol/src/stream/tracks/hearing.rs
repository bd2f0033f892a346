//! What a saying makes of a track: at both ends the same.

use rhumb_reckoning::{
    Anchor, BodyId, Correcting, DenseTrack, Grid, HORIZON, Motion, Predictor, Quartet, Residual,
    Seconds, Settling, Snapped, Tick, Track, carried, seen_from,
};

use super::{Slot, Tracks};
use crate::packet::{Age, Course, Saying};
use crate::stream::before::Before;

/// Why a saying could not be taken in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unreadable {
    /// No body has this index now.
    NoBody,
    /// The track is as new as the saying, or newer.
    Superseded,
    /// The saying builds on a track that is not here.
    OtherRevision,
}

impl Tracks {
    /// The frame that a body is or will be in, and what is predicted of it there, for what a saying corrects.
    ///
    /// Errors when the saying builds on other tracks than these.
    fn footing(
        &self,
        index: u32,
        course: &Course,
        age: Age,
        tick: Tick,
        former: Former<'_>,
    ) -> Result<Footing, Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        let track = &slot.track();
        if !self.is_of_age(track, age, tick) {
            return Err(Unreadable::OtherRevision);
        }
        let over = tick.since(track.origin).unwrap_or(HORIZON);
        let free = track.carrier.is_none();
        let (predictor, carrier, predicted) = match *course {
            Course::Same => (
                track.predictor,
                track.carrier,
                self.framed((index, slot), track, tick),
            ),
            Course::World {
                predictor,
                carrier_age,
            } => {
                let believed = match (self.carrier(track), carrier_age) {
                    (None, None) if free => self.framed((index, slot), track, tick),
                    (Some(holder), Some(age)) => {
                        let revision = self.of_age(former, holder, age, tick);
                        let revision = revision.ok_or(Unreadable::OtherRevision)?;
                        let motion = self.framed((index, slot), track, tick);
                        let holder = self.framed(holder, &revision, tick);
                        carried(&holder, &motion.pose())
                    }
                    _ => return Err(Unreadable::OtherRevision),
                };
                (predictor, None, believed)
            }
            Course::Held {
                carrier,
                carrier_age,
            } => {
                let holder = self.slot(carrier).ok_or(Unreadable::NoBody)?;
                let revision = self.of_age(former, (carrier, holder), carrier_age, tick);
                let revision = revision.ok_or(Unreadable::OtherRevision)?;
                let free = revision.carrier.is_none() && track.carrier.is_none();
                if carrier == index || !free {
                    return Err(Unreadable::OtherRevision);
                }
                let holds = self.framed((carrier, holder), &revision, tick);
                let believed = self.believed((index, slot), tick);
                let seen = seen_from(&holds.pose(), &believed.pose());
                (Predictor::Rest, Some(holder.id(carrier)), seen)
            }
        };
        Ok(Footing {
            predictor,
            carrier,
            predicted,
            over: track.predictor.astray(over, self.integrator.rate),
        })
    }

    /// Whether a track has this age, as a saying names it.
    fn is_of_age(&self, track: &Track, age: Age, tick: Tick) -> bool {
        self.age(track, tick) == Some(age)
    }

    /// The revision of a body's track that has an age, if that is known.
    fn of_age(
        &self,
        former: Former<'_>,
        (index, slot): (u32, &Slot),
        age: Age,
        tick: Tick,
    ) -> Option<Track> {
        let before = former.before.and_then(|before| before.get(index));
        let older = former.older.iter().filter(|(of, _)| *of == index);
        let all = core::iter::once(slot.track()).chain(before);
        let mut all = all.chain(older.map(|(_, track)| track.track()));
        all.find(|track| self.is_of_age(track, age, tick))
    }

    /// The track that a saying at `tick` gives a body.
    pub(crate) fn said(
        &self,
        index: u32,
        tick: Tick,
        saying: &Saying,
        former: Former<'_>,
    ) -> Result<Track, Unreadable> {
        let (course, age, residual) = match saying {
            Saying::Whole(whole) => return Ok(whole.track(tick)),
            Saying::Settled { age, settling } => return self.settled(index, tick, *age, settling),
            Saying::Residual {
                course,
                age,
                residual,
            } => (course, *age, residual),
        };
        let footing = self.footing(index, course, age, tick, former)?;
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        Ok(footing.track(tick, residual, self.grid(slot)))
    }

    /// The track of a body that comes to rest.
    fn settled(
        &self,
        index: u32,
        tick: Tick,
        age: Age,
        settling: &Settling,
    ) -> Result<Track, Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        let track = slot.track();
        let free = track.carrier.is_none();
        if !free || !self.is_of_age(&track, age, tick) {
            return Err(Unreadable::OtherRevision);
        }
        let predicted = self.framed((index, slot), &track, tick);
        settling
            .onto(&predicted.pose())
            .map(|verbatim| Track::resting(tick, verbatim))
            .map_err(|_| Unreadable::OtherRevision)
    }

    /// Takes in what was said of a body at a tick.
    pub(crate) fn hear(
        &mut self,
        index: u32,
        tick: Tick,
        saying: &Saying,
        former: Former<'_>,
    ) -> Result<(), Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        if tick <= slot.origin() {
            return Err(Unreadable::Superseded);
        }
        let track = self.said(index, tick, saying, former)?;
        self.set_track(index, track);
        Ok(())
    }
}

/// Corrections of bodies that nothing holds, whose predictions are reckoned side by side.
#[derive(Debug, Default)]
pub(crate) struct Abreast<'a> {
    quartet: Quartet,
    /// As the quartet keys them, those behind its bodies of no meaning.
    waiting: [Waiting<'a>; Quartet::LANES],
    len: usize,
}

/// A correction that waits for what was predicted.
#[derive(Clone, Copy, Debug, Default)]
struct Waiting<'a> {
    index: u32,
    correction: Option<(Predictor, Seconds, &'a Residual)>,
}

impl<'a> Abreast<'a> {
    /// Whether a body waits here.
    pub(crate) fn has(&self, index: u32) -> bool {
        let waiting = &self.waiting[..self.len];
        waiting.iter().any(|waiting| waiting.index == index)
    }

    /// Whether [`Tracks::hear_abreast`] is due.
    pub(crate) const fn is_full(&self) -> bool {
        self.quartet.is_full()
    }
}

impl Tracks {
    /// Takes in what was said of a body at a tick, once all of `abreast` is heard; `false`, and no change, for what is to be
    /// heard by itself. One `abreast` is of one tick, and of each body once.
    #[must_use]
    pub(crate) fn await_abreast<'a>(
        &self,
        abreast: &mut Abreast<'a>,
        index: u32,
        tick: Tick,
        saying: &'a Saying,
    ) -> bool {
        let Saying::Residual {
            course,
            age,
            residual,
        } = saying
        else {
            return false;
        };
        let Some(slot) = self.slot(index) else {
            return false;
        };
        let (origin, was) = (slot.origin(), slot.predictor());
        let of_age = Age::of(origin, tick, self.every) == Some(*age);
        let predictor = match *course {
            Course::Same => was,
            Course::World {
                predictor,
                carrier_age: None,
            } => predictor,
            _ => return false,
        };
        let free = slot.carrier().is_none();
        if tick <= origin || !of_age || !free {
            return false;
        }
        let key = abreast.len as u32;
        if !self.take(&mut abreast.quartet, key, slot, tick) {
            return false;
        }
        let over = tick.since(origin).unwrap_or(HORIZON);
        let over = was.astray(over, self.integrator.rate);
        let correction = Some((predictor, over, residual));
        abreast.waiting[abreast.len] = Waiting { index, correction };
        abreast.len += 1;
        true
    }

    /// Gives bodies the tracks that their corrections make; hands out which had which before.
    pub(crate) fn hear_abreast(
        &mut self,
        abreast: &mut Abreast<'_>,
        tick: Tick,
        mut out: impl FnMut(u32, DenseTrack),
    ) {
        let Abreast {
            quartet,
            waiting,
            len,
        } = abreast;
        let corrections = waiting[..*len].iter().map(|waiting| {
            let (_, over, residual) = waiting.correction?;
            let slot = self.slot(waiting.index)?;
            let grid = &self.natures.get(slot.nature).grid;
            Some(Correcting {
                residual,
                over,
                grid,
            })
        });
        let mut corrected = [None; Quartet::LANES];
        quartet.correct(corrections, |key, snapped| {
            corrected[key as usize] = Some(snapped);
        });
        for (waiting, corrected) in waiting[..*len].iter().zip(corrected) {
            let (Some(snapped), Some((predictor, ..))) = (corrected, waiting.correction) else {
                continue;
            };
            if let Some(before) = self.slot(waiting.index).map(|slot| *slot.dense()) {
                self.set_track(waiting.index, on_grid(tick, predictor, None, snapped));
                out(waiting.index, before);
            }
        }
        *len = 0;
    }
}

/// Tracks that bodies have left: what is heard late may name a carrier's.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Former<'a> {
    /// Those just before the present ones.
    pub(crate) before: Option<&'a Before>,
    /// Those before these, with the indices of their bodies.
    pub(crate) older: &'a [(u32, DenseTrack)],
}

/// What a correction is added to.
#[derive(Clone, Copy, Debug)]
struct Footing {
    /// How the body goes on.
    predictor: Predictor,
    /// In whose frame.
    carrier: Option<BodyId>,
    /// What was predicted of it there.
    predicted: Motion,
    /// In what time that went astray (RECKONING 4.4).
    over: Seconds,
}

impl Footing {
    fn track(&self, tick: Tick, residual: &Residual, grid: &Grid) -> Track {
        let snapped = residual.onto(&self.predicted, self.over, grid);
        on_grid(tick, self.predictor, self.carrier, snapped)
    }
}

/// The track of a body that goes on so from a motion on its grid.
fn on_grid(tick: Tick, predictor: Predictor, carrier: Option<BodyId>, snapped: Snapped) -> Track {
    let resting = predictor == Predictor::Rest;
    Track {
        origin: tick,
        predictor,
        anchor: Anchor::Snapped(if resting { snapped.stilled() } else { snapped }),
        carrier,
    }
}
