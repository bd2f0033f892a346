//! The table of tracks: the publisher's belief, and its copy.
//!
//! One belief, two homes: both ends hold this type and change it by the same calls, so that they stay equal to the bit.

use alloc::vec::Vec;
use core::cell::RefCell;

use glam::{DVec3, Vec3};
use rhumb_reckoning::{
    Anchor, BodyId, Class, Conditions, Cursor, Damping, FlowTable, Grid, HORIZON, Inertia,
    Integrator, Metres, Motion, Predictor, Residual, Seconds, Settling, Tick, Ticks, Tolerance,
    Track, carried, seen_from,
};

use super::agreement::Agreement;
use super::field::Field;
use crate::limits::{DAMPINGS_MAX, INDICES_MAX};
use crate::packet::{Course, Saying};
use crate::scene::{BodyKind, BodyTerms, Shape};

/// What a predictor needs to know of a body, told once with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Manner {
    /// Of the least ball around its centre of mass that holds it.
    pub radius: Metres,
    /// Its own or its scene's.
    pub damping: Damping,
    /// Factor on the scene's gravity.
    pub gravity_scale: f32,
    /// How it resists being turned, if it tumbles when it is free.
    pub inertia: Option<Inertia>,
    /// By which its tolerance differs from its stream's.
    pub class: Class,
}

impl Manner {
    /// Of a body with these terms, this shape and this inertia, in a scene whose bodies are damped like this.
    ///
    /// A body that no engine moves keeps the velocity it is given: nothing damps it and nothing pulls at it.
    #[must_use]
    pub fn of(
        terms: &BodyTerms,
        shape: &Shape,
        damping: Damping,
        inertia: Option<Inertia>,
    ) -> Self {
        let radius = shape.bounding_radius();
        let class = terms.class;
        match terms.kind {
            BodyKind::Dynamic => Self {
                radius,
                damping: terms.damping.unwrap_or(damping),
                gravity_scale: terms.gravity_scale,
                inertia: inertia.filter(|_| terms.gyroscopic),
                class,
            },
            BodyKind::Static | BodyKind::Kinematic => Self {
                radius,
                damping: Damping::default(),
                gravity_scale: 0.0,
                inertia: None,
                class,
            },
        }
    }
}

/// One body's place in the table.
#[derive(Clone, Debug)]
pub(crate) struct Slot {
    pub(crate) track: Track,
    pub(crate) radius: Metres,
    gravity_scale: f32,
    inertia: Option<Inertia>,
    /// How far its tumbling was computed.
    cursor: RefCell<Cursor>,
    generation: u16,
    flow: u16,
    class: Class,
}

impl Slot {
    pub(crate) const fn id(&self, index: u32) -> BodyId {
        BodyId::new(index, self.generation)
    }

    /// Whether it turns otherwise than at a constant spin when it is free.
    pub(crate) const fn tumbles(&self) -> bool {
        self.inertia.is_some()
    }
}

/// The tracks of one stream's bodies, by index.
#[derive(Clone, Debug)]
pub(crate) struct Tracks {
    tolerance: Tolerance,
    integrator: Integrator,
    field: Field,
    flows: Vec<(Damping, FlowTable)>,
    slots: Vec<Option<Slot>>,
    agreement: Agreement,
}

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
    pub(crate) fn new(tolerance: Tolerance, integrator: Integrator, gravity: Vec3) -> Self {
        Self {
            tolerance,
            integrator,
            field: Field::new(gravity),
            flows: Vec::new(),
            slots: Vec::new(),
            agreement: Agreement::default(),
        }
    }

    pub(crate) const fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    pub(crate) const fn integrator(&self) -> Integrator {
        self.integrator
    }

    /// Puts a body into the table; one that had its index is gone.
    ///
    /// Returns `false`, and changes nothing, when there are too many bodies or dampings.
    #[must_use]
    pub(crate) fn place(&mut self, id: BodyId, manner: &Manner, track: Track) -> bool {
        if id.index() >= INDICES_MAX {
            return false;
        }
        let Some(flow) = self.flow_of(manner.damping) else {
            return false;
        };
        let index = id.index() as usize;
        if index >= self.slots.len() {
            self.slots.resize_with(index + 1, || None);
        }
        let slot = Slot {
            track,
            radius: manner.radius,
            gravity_scale: manner.gravity_scale,
            inertia: manner.inertia,
            cursor: RefCell::default(),
            generation: id.generation(),
            flow,
            class: manner.class,
        };
        self.agreement.add(id.index(), &slot);
        if let Some(gone) = self.slots[index].replace(slot) {
            self.agreement.take(id.index(), &gone);
        }
        true
    }

    /// The number of the table of this damping, made when it is the first of its kind.
    fn flow_of(&mut self, damping: Damping) -> Option<u16> {
        let known = self.flows.iter().position(|(other, _)| *other == damping);
        let number = match known {
            Some(number) => number,
            None if self.flows.len() < DAMPINGS_MAX => {
                let mut table = FlowTable::new(self.integrator, damping);
                table.extend_to(HORIZON);
                self.flows.push((damping, table));
                self.flows.len() - 1
            }
            None => return None,
        };
        Some(number as u16)
    }

    /// Takes a body out; `false` when it is not there.
    pub(crate) fn remove(&mut self, id: BodyId) -> bool {
        let Some(place) = self.slots.get_mut(id.index() as usize) else {
            return false;
        };
        let found = place
            .as_ref()
            .is_some_and(|slot| slot.generation == id.generation());
        if let Some(gone) = place.take_if(|_| found) {
            self.agreement.take(id.index(), &gone);
        }
        found
    }

    pub(crate) fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.field.change(since, gravity);
    }

    /// See [`Field::changes`].
    pub(crate) fn gravity_changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        self.field.changes()
    }

    pub(crate) fn slot(&self, index: u32) -> Option<&Slot> {
        self.slots.get(index as usize)?.as_ref()
    }

    /// Gives a body another track; `false` when no body has the index.
    pub(crate) fn set_track(&mut self, index: u32, track: Track) -> bool {
        let Some(Some(slot)) = self.slots.get_mut(index as usize) else {
            return false;
        };
        self.agreement.take(index, slot);
        slot.track = track;
        self.agreement.add(index, slot);
        true
    }

    /// The sum over all tracks.
    pub(crate) const fn agreement(&self) -> Agreement {
        self.agreement
    }

    /// The sum over the tracks of a range of indices.
    pub(crate) fn agreement_of(&self, range: core::ops::Range<usize>) -> Agreement {
        let mut sum = Agreement::default();
        let end = range.end.min(self.slots.len());
        for index in range.start.min(end)..end {
            if let Some(slot) = &self.slots[index] {
                sum.add(index as u32, slot);
            }
        }
        sum
    }

    /// Every body's index and place, in order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (u32, &Slot)> {
        self.slots
            .iter()
            .enumerate()
            .filter_map(|(index, slot)| slot.as_ref().map(|slot| (index as u32, slot)))
    }

    /// One more than the highest index that any body had.
    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }

    /// How far off the copy of a body may be: the stream's tolerance, by the body's class.
    pub(crate) fn tolerance_of(&self, slot: &Slot) -> Tolerance {
        self.tolerance.of_class(slot.class)
    }

    pub(crate) fn grid(&self, slot: &Slot) -> Grid {
        Grid::new(self.tolerance_of(slot), slot.radius)
    }

    /// What pulls at a body by a law said at `origin`, m/s² (RECKONING 2.5).
    pub(crate) fn gravity(&self, slot: &Slot, origin: Tick) -> DVec3 {
        let scale = f64::from(slot.gravity_scale);
        let DVec3 { x, y, z } = self.field.at(origin);
        DVec3::new(x * scale, y * scale, z * scale)
    }

    /// What is believed of a body in the world at a tick.
    pub(crate) fn believed(&self, slot: &Slot, tick: Tick) -> Motion {
        let motion = self.framed(slot, &slot.track, tick);
        match self.carrier(&slot.track) {
            Some((_, carrier)) => {
                let carrier = self.framed(carrier, &carrier.track, tick);
                carried(&carrier, &motion.pose())
            }
            None => motion,
        }
    }

    /// The body that carries another along by its track, while it is there.
    pub(crate) fn carrier(&self, track: &Track) -> Option<(u32, &Slot)> {
        let id = track.carrier?;
        let slot = self.slot(id.index())?;
        (slot.generation == id.generation()).then_some((id.index(), slot))
    }

    /// What a track of a body, this one or one that it had, says of a tick in its own frame.
    pub(crate) fn framed(&self, slot: &Slot, track: &Track, tick: Tick) -> Motion {
        self.with_conditions(slot, track.predictor, track.origin, |conditions| {
            let mut cursor = slot.cursor.borrow_mut();
            track.at_with(tick, &self.grid(slot), conditions, &mut cursor)
        })
    }

    /// The same without regard to what was computed before, for tracks that may never be said.
    pub(crate) fn framed_fresh(&self, slot: &Slot, track: &Track, tick: Tick) -> Motion {
        self.with_conditions(slot, track.predictor, track.origin, |conditions| {
            track.at(tick, &self.grid(slot), conditions)
        })
    }

    /// What a law would make of a motion of some ticks ago, under what pulls at a tick.
    pub(crate) fn continued(
        &self,
        slot: &Slot,
        predictor: Predictor,
        start: &Motion,
        tick: Tick,
        ticks: Ticks,
    ) -> Motion {
        self.with_conditions(slot, predictor, tick, |conditions| {
            predictor.predict(start, ticks, conditions)
        })
    }

    fn with_conditions<T>(
        &self,
        slot: &Slot,
        predictor: Predictor,
        origin: Tick,
        then: impl FnOnce(&Conditions<'_>) -> T,
    ) -> T {
        let gravity = if predictor.falls() {
            self.gravity(slot, origin)
        } else {
            DVec3::ZERO
        };
        let (_, flow) = &self.flows[usize::from(slot.flow)];
        then(&Conditions {
            gravity,
            flow,
            inertia: slot.inertia.as_ref(),
        })
    }

    /// The frame that a body is or will be in, and what is predicted of it there, for what a saying corrects.
    ///
    /// Errors when the saying builds on other tracks than these.
    fn footing(
        &self,
        index: u32,
        course: &Course,
        age: Ticks,
        tick: Tick,
        former: Former<'_>,
    ) -> Result<Footing, Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        let track = &slot.track;
        if !is_of_age(track, age, tick) {
            return Err(Unreadable::OtherRevision);
        }
        let (predictor, carrier, predicted) = match *course {
            Course::Same => (
                track.predictor,
                track.carrier,
                self.framed(slot, track, tick),
            ),
            Course::World {
                predictor,
                carrier_age,
            } => {
                let motion = self.framed(slot, track, tick);
                let believed = match (self.carrier(track), carrier_age) {
                    (None, None) if track.carrier.is_none() => motion,
                    (Some((index, holder)), Some(age)) => {
                        let revision = former.of_age(index, holder, age, tick);
                        let revision = revision.ok_or(Unreadable::OtherRevision)?;
                        carried(&self.framed(holder, revision, tick), &motion.pose())
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
                let revision = former.of_age(carrier, holder, carrier_age, tick);
                let revision = revision.ok_or(Unreadable::OtherRevision)?;
                let free = revision.carrier.is_none() && track.carrier.is_none();
                if carrier == index || !free {
                    return Err(Unreadable::OtherRevision);
                }
                let holds = self.framed(holder, revision, tick);
                let seen = seen_from(&holds.pose(), &self.believed(slot, tick).pose());
                (Predictor::Rest, Some(holder.id(carrier)), seen)
            }
        };
        Ok(Footing {
            predictor,
            carrier,
            predicted,
            over: track.predictor.astray(age, self.integrator.rate),
        })
    }

    /// The track that a saying at `tick` gives a body.
    pub(crate) fn said(
        &self,
        index: u32,
        tick: Tick,
        saying: &Saying,
    ) -> Result<Track, Unreadable> {
        self.said_of(index, tick, saying, Former::default())
    }

    fn said_of(
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
        Ok(footing.track(tick, residual, &self.grid(slot)))
    }

    /// The track of a body that comes to rest.
    fn settled(
        &self,
        index: u32,
        tick: Tick,
        age: Ticks,
        settling: &Settling,
    ) -> Result<Track, Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        let free = slot.track.carrier.is_none();
        if !free || !is_of_age(&slot.track, age, tick) {
            return Err(Unreadable::OtherRevision);
        }
        let predicted = self.framed(slot, &slot.track, tick);
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
        if tick <= slot.track.origin {
            return Err(Unreadable::Superseded);
        }
        let track = self.said_of(index, tick, saying, former)?;
        self.set_track(index, track);
        Ok(())
    }
}

/// Whether a track has this age, as a saying names it.
fn is_of_age(track: &Track, age: Ticks, tick: Tick) -> bool {
    tick.since(track.origin) == Some(age)
}

/// By index, the tracks before the present ones: what is heard late may name a carrier's.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Former<'a>(pub(crate) &'a [Option<Track>]);

impl<'a> Former<'a> {
    /// The revision of a body's track that has an age, if that is known.
    fn of_age<'t>(self, index: u32, slot: &'t Slot, age: Ticks, tick: Tick) -> Option<&'t Track>
    where
        'a: 't,
    {
        let before = || self.0.get(index as usize).and_then(Option::as_ref);
        let all = core::iter::once(&slot.track).chain(core::iter::once_with(before).flatten());
        let mut all = all.filter(|track| is_of_age(track, age, tick));
        all.next()
    }
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
        let resting = self.predictor == Predictor::Rest;
        Track {
            origin: tick,
            predictor: self.predictor,
            anchor: Anchor::Snapped(if resting { snapped.stilled() } else { snapped }),
            carrier: self.carrier,
        }
    }
}
