//! The table of tracks: the publisher's belief, and its copy.
//!
//! One belief, two homes: both ends hold this type and change it by the same calls, so that they stay equal to the bit.

mod applying;
mod rotation_cursors;
mod slot;

use alloc::vec::Vec;
use core::num::NonZeroU32;

use glam::{DVec3, Vec3};
use rhumb_reckoning::{
    BodyId, BodyState, Conditions, Damping, ErrorPrefilter, Grid, Inertia, Integrator, Metres,
    Motion, PredictionX4, Predictor, PrefilterInput, StepCoefficientTable, TRACK_AGE_MAX, Tick,
    Ticks, Tolerance, ToleranceScale, Track, UnforcedMotion, attached_motion,
};

use super::gravity_history::GravityHistory;
use super::interned_parameters::{InternedParameterTable, InternedParameters};
use super::state_checksum::StateChecksum;
use crate::capacity::grow_to;
use crate::limits::{DAMPINGS_MAX, INDICES_MAX};
use crate::packet::Age;
use crate::scene::{BodyDesc, BodyKind, Shape};

pub(crate) use applying::{CorrectionsX4, Unreadable};
use rotation_cursors::RotationCursors;
pub(crate) use slot::Slot;

/// What a predictor needs to know of a body, told once with it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictionParameters {
    /// Of the least ball around its centre of mass that holds it.
    pub radius: Metres,
    /// Its own or its scene's.
    pub damping: Damping,
    /// Factor on the scene's gravity.
    pub gravity_scale: f32,
    /// How it resists being turned, if it is_torque_free when it is free.
    pub inertia: Option<Inertia>,
    /// By which its tolerance differs from its stream's.
    pub tolerance_scale: ToleranceScale,
}

impl PredictionParameters {
    /// Of a body that nothing sets apart: undamped, pulled in full, equally hard to turn about each axis, of the usual tolerance_scale.
    #[must_use]
    pub fn plain(radius: Metres) -> Self {
        Self {
            radius,
            damping: Damping::default(),
            gravity_scale: 1.0,
            inertia: None,
            tolerance_scale: ToleranceScale::USUAL,
        }
    }

    /// Of a body with these config, this shape and this inertia, in a scene whose bodies are damped like this.
    ///
    /// A body that no engine moves keeps the velocity it is given: nothing damps it and nothing pulls at it. One that cannot
    /// tumble has no inertia, whatever its engine says: listeners are not told of it.
    #[must_use]
    pub fn of(desc: &BodyDesc, shape: &Shape, damping: Damping, inertia: Option<Inertia>) -> Self {
        let radius = shape.bounding_radius();
        let tolerance_scale = desc.tolerance_scale;
        match desc.kind {
            BodyKind::Dynamic => Self {
                radius,
                damping: desc.damping.unwrap_or(damping),
                gravity_scale: desc.gravity_scale,
                inertia: inertia.filter(|_| desc.can_tumble()),
                tolerance_scale,
            },
            BodyKind::Static | BodyKind::Kinematic => Self {
                radius,
                damping: Damping::default(),
                gravity_scale: 0.0,
                inertia: None,
                tolerance_scale,
            },
        }
    }
}

/// The tracks of one stream's bodies, by index.
#[derive(Clone, Debug)]
pub(crate) struct Tracks {
    tolerance: Tolerance,
    integrator: Integrator,
    /// It is said of the multiples of this number.
    publish_interval: NonZeroU32,
    gravity_history: GravityHistory,
    flows: Vec<(Damping, StepCoefficientTable)>,
    interned_parameters: InternedParameterTable,
    slots: Vec<Option<Slot>>,
    /// How far torque_free_rotations were computed, by index, as far as any body is_torque_free.
    cursors: RotationCursors,
    state_checksum: StateChecksum,
}

impl Tracks {
    pub(crate) fn new(
        tolerance: Tolerance,
        integrator: Integrator,
        publish_interval: NonZeroU32,
        gravity: Vec3,
    ) -> Self {
        Self {
            tolerance,
            integrator,
            publish_interval,
            gravity_history: GravityHistory::new(gravity),
            flows: Vec::new(),
            interned_parameters: InternedParameterTable::default(),
            slots: Vec::new(),
            cursors: RotationCursors::default(),
            state_checksum: StateChecksum::default(),
        }
    }

    pub(crate) const fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    pub(crate) const fn integrator(&self) -> Integrator {
        self.integrator
    }

    /// Ticks from one that is spoken of to the next.
    pub(crate) const fn publish_interval(&self) -> NonZeroU32 {
        self.publish_interval
    }

    /// How old a track is at a tick; `None` if its origin is later.
    pub(crate) fn age(&self, track: &Track, tick: Tick) -> Option<Age> {
        Age::of(track.origin, tick, self.publish_interval)
    }

    /// Puts a body into the table; one that had its index is gone.
    ///
    /// `label`: see [`Self::label`]. Returns `false`, and changes nothing, when there are too many bodies or dampings.
    #[must_use]
    pub(crate) fn place(
        &mut self,
        id: BodyId,
        parameters: &PredictionParameters,
        track: Track,
        label: Option<u32>,
    ) -> bool {
        if id.index() >= INDICES_MAX {
            return false;
        }
        let Some(flow) = self.flow_of(parameters.damping) else {
            return false;
        };
        let index = id.index() as usize;
        grow_to(&mut self.slots, index + 1, || None);
        let tolerance = self.tolerance.scaled(parameters.tolerance_scale);
        let interned = self.interned_parameters.join(InternedParameters {
            radius: parameters.radius,
            gravity_scale: parameters.gravity_scale,
            inertia: parameters.inertia,
            flow,
            tolerance_scale: parameters.tolerance_scale,
            label,
            tolerance,
            grid: Grid::new(tolerance, parameters.radius),
        });
        let slot = Slot::new(id, &track, interned, parameters.inertia.is_some());
        if parameters.inertia.is_some() {
            self.cursors.reach(id.index());
        }
        self.state_checksum.add(id, &track);
        if let Some(gone) = self.slots[index].replace(slot) {
            self.let_go(id.index(), &gone);
        }
        true
    }

    /// A number that was given with the body; it costs nothing where many have the same.
    pub(crate) fn label(&self, slot: &Slot) -> Option<u32> {
        self.interned_parameters.get(slot.interned).label
    }

    /// A body is no longer in its place.
    fn let_go(&mut self, index: u32, gone: &Slot) {
        self.state_checksum.take(gone.id(index), &gone.track());
        self.interned_parameters.leave(gone.interned);
    }

    /// The number of the table of this damping, made when it is the first of its kind.
    fn flow_of(&mut self, damping: Damping) -> Option<u16> {
        let known = self.flows.iter().position(|(other, _)| *other == damping);
        let number = match known {
            Some(number) => number,
            None if self.flows.len() < DAMPINGS_MAX => {
                let mut table = StepCoefficientTable::new(self.integrator, damping);
                table.extend_to(TRACK_AGE_MAX);
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
        let found = place.as_ref().is_some_and(|slot| slot.id(id.index()) == id);
        if let Some(gone) = place.take_if(|_| found) {
            self.let_go(id.index(), &gone);
        }
        found
    }

    pub(crate) fn change_gravity(&mut self, since: Tick, gravity: Vec3) {
        self.gravity_history.change(since, gravity);
    }

    /// See [`GravityHistory::changes`].
    pub(crate) fn gravity_changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        self.gravity_history.changes()
    }

    pub(crate) fn slot(&self, index: u32) -> Option<&Slot> {
        self.slots.get(index as usize)?.as_ref()
    }

    /// Gives a body another track; `false` when no body has the index.
    pub(crate) fn set_track(&mut self, index: u32, track: Track) -> bool {
        let Some(Some(slot)) = self.slots.get_mut(index as usize) else {
            return false;
        };
        let id = slot.id(index);
        self.state_checksum.take(id, &slot.track());
        slot.set_track(&track);
        self.state_checksum.add(id, &track);
        true
    }

    /// The sum over all tracks.
    pub(crate) const fn state_checksum(&self) -> StateChecksum {
        self.state_checksum
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

    /// How far off the copy of a body may be: the stream's tolerance, by the body's tolerance_scale.
    pub(crate) fn tolerance_of(&self, slot: &Slot) -> Tolerance {
        self.interned_parameters.get(slot.interned).tolerance
    }

    /// Of the least ball around a body's centre of mass that holds it.
    pub(crate) fn radius(&self, slot: &Slot) -> Metres {
        self.interned_parameters.get(slot.interned).radius
    }

    pub(crate) fn grid(&self, slot: &Slot) -> &Grid {
        &self.interned_parameters.get(slot.interned).grid
    }

    /// What pulls at a body by a predictor said at `origin`, m/s² (RECKONING 2.5).
    pub(crate) fn gravity(&self, slot: &Slot, origin: Tick) -> DVec3 {
        let scale = f64::from(self.interned_parameters.get(slot.interned).gravity_scale);
        let DVec3 { x, y, z } = self.gravity_history.at(origin);
        DVec3::new(x * scale, y * scale, z * scale)
    }

    /// What is predicted_motion of a body in the world at a tick.
    pub(crate) fn predicted_motion(&self, body: (u32, &Slot), tick: Tick) -> Motion {
        let track = body.1.track();
        let motion = self.framed(body, &track, tick);
        match self.parent(&track) {
            Some((index, parent)) => {
                let parent = self.framed((index, parent), &parent.track(), tick);
                attached_motion(&parent, &motion.pose())
            }
            None => motion,
        }
    }

    /// The body that carries another along by its track, while it is there.
    pub(crate) fn parent(&self, track: &Track) -> Option<(u32, &Slot)> {
        let id = track.parent?;
        let slot = self.slot(id.index())?;
        (slot.id(id.index()) == id).then_some((id.index(), slot))
    }

    /// What a track of a body, this one or one that it had, says of a tick in its own frame.
    pub(crate) fn framed(&self, (index, slot): (u32, &Slot), track: &Track, tick: Tick) -> Motion {
        self.with_conditions(slot, track.predictor, track.origin, |conditions| {
            let grid = &self.interned_parameters.get(slot.interned).grid;
            if !track.predictor.is_torque_free() {
                return track.at(tick, grid, conditions);
            }
            self.cursors.with(index, |cursor| {
                track.at_with(tick, grid, conditions, cursor)
            })
        })
    }

    /// The same without regard to what was computed before, for tracks that may never be said.
    pub(crate) fn framed_fresh(&self, slot: &Slot, track: &Track, tick: Tick) -> Motion {
        self.with_conditions(slot, track.predictor, track.origin, |conditions| {
            track.at(tick, self.grid(slot), conditions)
        })
    }

    /// What a predictor that does not fall makes of a motion in some ticks.
    pub(crate) fn continued(
        &self,
        slot: &Slot,
        predictor: Predictor,
        start: &Motion,
        ticks: Ticks,
    ) -> Motion {
        self.with_conditions(slot, predictor, Tick::ZERO, |conditions| {
            predictor.predict(start, ticks, conditions)
        })
    }

    /// How far a body gets in some ticks.
    pub(crate) fn unforced(&self, slot: &Slot, ticks: Ticks) -> UnforcedMotion {
        self.with_conditions(slot, Predictor::Uniform, Tick::ZERO, |conditions| {
            conditions.unforced(ticks)
        })
    }

    /// The acceleration that brings a body from one velocity to another in a tick, m/s².
    pub(crate) fn acceleration(&self, slot: &Slot, before: DVec3, after: DVec3) -> DVec3 {
        self.with_conditions(slot, Predictor::Uniform, Tick::ZERO, |conditions| {
            conditions.acceleration(before, after)
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
        let interned = self.interned_parameters.get(slot.interned);
        let (_, flow) = &self.flows[usize::from(interned.flow)];
        then(&Conditions {
            gravity,
            flow,
            inertia: interned.inertia.as_ref(),
        })
    }

    /// Has a prefilter look at a body's track.
    pub(crate) fn look(
        &self,
        slot: &Slot,
        tick: Tick,
        seen: (u32, &BodyState),
        prefilter: &mut ErrorPrefilter,
        undecided: &mut Vec<u32>,
    ) {
        let (place, truth) = seen;
        let interned = self.interned_parameters.get(slot.interned);
        // A prefilter is of one tolerance.
        if interned.tolerance_scale != ToleranceScale::USUAL {
            return undecided.push(place);
        }
        let track = slot.dense();
        self.with_conditions(slot, track.predictor(), track.origin(), |conditions| {
            let case = PrefilterInput {
                truth,
                track,
                tick,
                grid: &interned.grid,
                radius: interned.radius,
                conditions,
            };
            prefilter.look(place, &case, undecided);
        });
    }

    /// Has a batch predict a body's own track, if it takes such tracks.
    #[must_use]
    pub(crate) fn take(&self, batch: &mut PredictionX4, key: u32, slot: &Slot, tick: Tick) -> bool {
        let track = slot.dense();
        let grid = &self.interned_parameters.get(slot.interned).grid;
        self.with_conditions(slot, track.predictor(), track.origin(), |conditions| {
            batch.take(key, track, tick, grid, conditions)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ShapeId;

    #[test]
    fn unknown_inertia_is_not_used() {
        let id = BodyId::new(0, 0);
        let plain = BodyDesc::plain(id, BodyKind::Dynamic, ShapeId(0));
        let shape = Shape::Ball { radius: 0.5 };
        let inertia = Inertia::new([1.0, 2.0, 2.5], [0.0, 0.0, 0.0, 1.0]).unwrap();
        for (gyroscopic, turns) in [(true, true), (true, false), (false, true), (false, false)] {
            let desc = BodyDesc {
                gyroscopic,
                turns,
                ..plain
            };
            let parameters =
                PredictionParameters::of(&desc, &shape, Damping::default(), Some(inertia));
            assert_eq!(parameters.inertia.is_some(), desc.can_tumble());
        }
    }
}
