//! The table of tracks: the publisher's predictions and their replica.
//!
//! Publisher and subscriber both use this type and change it by the same calls, so their tables stay equal to the bit.
//! A slot of few bytes for each body; each distinct set of prediction parameters is kept once. Rotation cursors are
//! kept beside the table, because most scenes have no torque-free body: they change the cost of a prediction, never
//! its bits. A track keeps the gravity of its origin tick: both ends look it up by that tick.

mod applying;

use alloc::vec::Vec;
use core::cell::Cell;
use core::fmt;
use core::num::NonZeroU32;

use glam::{DVec3, Vec3};
use rhumb_reckoning::{
    BodyId, Conditions, Damping, DenseTrack, ErrorPrefilter, Grid, Inertia, Integrator, Metres,
    Motion, PredictionX4, Predictor, PrefilterBody, PrefilterTrack, RotationCursor,
    StepCoefficientTable, TRACK_AGE_MAX, Tick, Ticks, Tolerance, ToleranceScale, Track,
    UnforcedMotion, UnpackedStart, attached_motion,
};

use super::state_checksum::StateChecksum;
use crate::interner::{Internable, Interner, grow_to};
use crate::limits::{DAMPINGS_MAX, INDICES_MAX};
use crate::packet::Age;
use crate::scene::{BodyDesc, BodyKind, Shape};

pub(crate) use applying::{CorrectionsX4, Unreadable};

/// The constants of a body that predictors need, sent once with the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictionParameters {
    /// The radius of the smallest sphere around the centre of mass that contains the body.
    pub radius: Metres,
    /// The damping of the body or its scene.
    pub damping: Damping,
    /// A factor on the scene's gravity.
    pub gravity_scale: f32,
    /// The inertia, if the body rotates torque-free; None for constant angular velocity.
    pub inertia: Option<Inertia>,
    /// The factor between the body's and the stream's tolerance.
    pub tolerance_scale: ToleranceScale,
}

impl PredictionParameters {
    /// Parameters of an undamped body with full gravity, equal moments of inertia and the usual tolerance scale.
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

    /// The parameters of a body with this descriptor, shape and inertia, in a scene with this damping.
    ///
    /// A kinematic body keeps the velocity that it is given, without damping or gravity. A body whose rotation cannot
    /// be torque-free has no inertia, whatever the engine reports, because subscribers do not receive it.
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
            BodyKind::Fixed | BodyKind::Kinematic => Self {
                radius,
                damping: Damping::default(),
                gravity_scale: 0.0,
                inertia: None,
                tolerance_scale,
            },
        }
    }
}

/// The table of a damping.
#[derive(Clone, Debug)]
struct Flow {
    damping: Damping,
    table: StepCoefficientTable,
    /// Number of bodies with the damping. Without any, another damping may take the place.
    users: u32,
}

/// The tracks of one stream's bodies, by index.
#[derive(Clone, Debug)]
pub(crate) struct Tracks {
    tolerance: Tolerance,
    integrator: Integrator,
    /// The stream publishes at ticks that are multiples of this number.
    publish_interval: NonZeroU32,
    gravity_history: GravityHistory,
    flows: Vec<Flow>,
    interned_parameters: InternedParameterTable,
    slots: Vec<Option<Slot>>,
    /// The state of torque-free rotation, by index, up to the last body that needs it.
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

    /// The number of ticks from one published tick to the next.
    pub(crate) const fn publish_interval(&self) -> NonZeroU32 {
        self.publish_interval
    }

    /// The age of a track at a tick; `None` if its origin is later.
    pub(crate) fn age(&self, track: &Track, tick: Tick) -> Option<Age> {
        Age::of(track.origin, tick, self.publish_interval)
    }

    /// Places a body in the table; a body with the same index is removed.
    ///
    /// `label`: see [`Self::label`]. Returns `false`, without any change, if there are too many bodies or damping
    /// factors.
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
        let replaced = self.slot(id.index());
        let replaced = replaced.map(|slot| self.interned_parameters.get(slot.interned).flow);
        let Some(flow) = self.flow_of(parameters.damping, replaced) else {
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
        self.note_change(id.index());
        if let Some(removed) = self.slots[index].replace(slot) {
            self.release(&removed);
        }
        true
    }

    /// The label of a body, given when it was placed. It takes no memory where many bodies share one.
    pub(crate) fn label(&self, slot: &Slot) -> Option<u32> {
        self.interned_parameters.get(slot.interned).label
    }

    /// A copy of a body's slot, which keeps the parameters of the body in use until [`Self::release`].
    pub(crate) fn retained(&mut self, index: u32) -> Option<Slot> {
        let slot = self.slot(index)?.clone();
        let interned = self.interned_parameters.get(slot.interned).clone();
        self.flows[usize::from(interned.flow)].users += 1;
        self.interned_parameters.join(interned);
        Some(slot)
    }

    /// Releases the parameters of a removed body.
    pub(crate) fn release(&mut self, removed: &Slot) {
        let flow = self.interned_parameters.get(removed.interned).flow;
        self.flows[usize::from(flow)].users -= 1;
        self.interned_parameters.leave(removed.interned);
    }

    /// The index in the table of dampings, with one user more; it is added if it is new. None if the table is full.
    ///
    /// `replaced`: the index of the body that is about to be replaced.
    fn flow_of(&mut self, damping: Damping, replaced: Option<u16>) -> Option<u16> {
        let found = self.flows.iter().position(|flow| flow.damping == damping);
        let number = match found {
            Some(number) => number,
            None => {
                let mut table = StepCoefficientTable::new(self.integrator, damping);
                table.extend_to(TRACK_AGE_MAX);
                let users = 0;
                let flow = Flow {
                    damping,
                    table,
                    users,
                };
                self.add_flow(flow, replaced.map(usize::from))?
            }
        };
        self.flows[number].users += 1;
        Some(number as u16)
    }

    /// Adds a damping, in place of an unused one if the table is full.
    fn add_flow(&mut self, flow: Flow, replaced: Option<usize>) -> Option<usize> {
        if self.flows.len() < DAMPINGS_MAX {
            self.flows.push(flow);
            return Some(self.flows.len() - 1);
        }
        let mut flows = self.flows.iter().enumerate();
        let unused =
            |(number, flow): (usize, &Flow)| flow.users == u32::from(replaced == Some(number));
        let number = flows.position(unused)?;
        let users = self.flows[number].users;
        self.flows[number] = Flow { users, ..flow };
        Some(number)
    }

    /// Removes a body; `false` if there is no such body.
    pub(crate) fn remove(&mut self, id: BodyId) -> bool {
        let found = self
            .slot(id.index())
            .is_some_and(|slot| slot.id(id.index()) == id);
        if !found {
            return false;
        }
        self.note_change(id.index());
        if let Some(removed) = self.slots[id.index() as usize].take() {
            self.release(&removed);
        }
        true
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

    /// Sets the track of a body; `false` if no body has the index.
    pub(crate) fn set_track(&mut self, index: u32, track: Track) -> bool {
        let Some(Some(slot)) = self.slots.get_mut(index as usize) else {
            return false;
        };
        self.state_checksum
            .change(index, || Some((slot.id(index), slot.track())));
        slot.set_track(&track);
        true
    }

    /// Replaces the track of a body and returns the one before; `None` if no body has the index.
    fn replace_track(&mut self, index: u32, track: DenseTrack) -> Option<DenseTrack> {
        let slot = self.slots.get_mut(index as usize)?.as_mut()?;
        self.state_checksum
            .change(index, || Some((slot.id(index), slot.track())));
        Some(core::mem::replace(&mut slot.track, track))
    }

    /// Notes in the checksum that the track of an index is about to change.
    fn note_change(&mut self, index: u32) {
        let before = track_at(&self.slots, index);
        self.state_checksum.change(index, || before);
    }

    /// The checksum over all tracks.
    pub(crate) fn state_checksum(&self) -> u64 {
        self.state_checksum
            .value(|index| track_at(&self.slots, index))
    }

    /// The same, by hashing only the tracks that changed since the last call.
    pub(crate) fn settle_checksum(&mut self) -> u64 {
        let slots = &self.slots;
        self.state_checksum.settle(|index| track_at(slots, index))
    }

    /// The slots of all bodies with their indices, in order.
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

    /// The tolerance of a body: the stream's tolerance times the body's tolerance scale.
    pub(crate) fn tolerance_of(&self, slot: &Slot) -> Tolerance {
        self.interned_parameters.get(slot.interned).tolerance
    }

    /// The radius of the smallest sphere around a body's centre of mass that contains it.
    pub(crate) fn radius(&self, slot: &Slot) -> Metres {
        self.interned_parameters.get(slot.interned).radius
    }

    /// The same for bodies with these parameters; see [`Slot::interned`].
    pub(crate) fn radius_of(&self, interned: u32) -> Metres {
        self.interned_parameters.get(interned).radius
    }

    pub(crate) fn grid(&self, slot: &Slot) -> &Grid {
        &self.interned_parameters.get(slot.interned).grid
    }

    /// The gravity of a body for a track with this origin, m/s² (RECKONING 2.5).
    pub(crate) fn gravity(&self, slot: &Slot, origin: Tick) -> DVec3 {
        let scale = f64::from(self.interned_parameters.get(slot.interned).gravity_scale);
        let DVec3 { x, y, z } = self.gravity_history.at(origin);
        DVec3::new(x * scale, y * scale, z * scale)
    }

    /// The predicted motion of a body in the world frame at a tick.
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

    /// The parent of a body by its track, if it still exists.
    pub(crate) fn parent(&self, track: &Track) -> Option<(u32, &Slot)> {
        let id = track.parent?;
        let slot = self.slot(id.index())?;
        (slot.id(id.index()) == id).then_some((id.index(), slot))
    }

    /// The motion at a tick by a track of a body, its present or previous one, in the track's frame.
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

    /// As [`Self::framed`], without cached rotation states, for candidate tracks.
    pub(crate) fn framed_fresh(&self, slot: &Slot, track: &Track, tick: Tick) -> Motion {
        self.with_conditions(slot, track.predictor, track.origin, |conditions| {
            track.at(tick, self.grid(slot), conditions)
        })
    }

    /// The motion after some ticks under a predictor without gravity.
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

    /// The displacement of a body after some ticks.
    pub(crate) fn unforced(&self, slot: &Slot, ticks: Ticks) -> UnforcedMotion {
        self.with_conditions(slot, Predictor::Uniform, Tick::ZERO, |conditions| {
            conditions.unforced(ticks)
        })
    }

    /// The acceleration that changes a body's velocity from one value to another in a tick, m/s².
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
        then(&Conditions {
            gravity,
            flow: &self.flows[usize::from(interned.flow)].table,
            inertia: interned.inertia.as_ref(),
        })
    }

    /// A body's track as the prefilter tests it, and the number of its table of damping; see [`ErrorPrefilter::track`].
    pub(crate) fn prefilter_track(
        &self,
        slot: &Slot,
        prefilter: &ErrorPrefilter,
    ) -> (Option<PrefilterTrack>, u16) {
        let interned = self.interned_parameters.get(slot.interned);
        let track = slot.dense();
        let tested = self.with_conditions(slot, track.predictor(), track.origin(), |conditions| {
            let body = PrefilterBody {
                tolerance: interned.tolerance,
                grid: &interned.grid,
                radius: interned.radius,
                conditions,
            };
            prefilter.track(track, &body)
        });
        (tested, interned.flow)
    }

    /// The table of a damping by its number.
    pub(crate) fn flow(&self, number: u16) -> &StepCoefficientTable {
        &self.flows[usize::from(number)].table
    }

    /// The start of a body's own track, unpacked, and the number of its table of damping; `None` if it is predicted alone.
    pub(crate) fn unpacked(&self, slot: &Slot) -> Option<(UnpackedStart, u16)> {
        let interned = self.interned_parameters.get(slot.interned);
        let track = slot.dense();
        let start = self.with_conditions(slot, track.predictor(), track.origin(), |conditions| {
            UnpackedStart::of(track, &interned.grid, conditions)
        });
        Some((start?, interned.flow))
    }

    /// Adds a body's own track to a batch; returns whether the batch takes such tracks.
    #[must_use]
    pub(crate) fn take(&self, batch: &mut PredictionX4, key: u32, slot: &Slot, tick: Tick) -> bool {
        let track = slot.dense();
        let grid = &self.interned_parameters.get(slot.interned).grid;
        self.with_conditions(slot, track.predictor(), track.origin(), |conditions| {
            batch.take(key, track, tick, grid, conditions)
        })
    }
}

/// The body and track of an index.
fn track_at(slots: &[Option<Slot>], index: u32) -> Option<(BodyId, Track)> {
    let slot = slots.get(index as usize)?.as_ref()?;
    Some((slot.id(index), slot.track()))
}

/// The slot of one body in the table.
#[derive(Clone)]
pub(crate) struct Slot {
    track: DenseTrack,
    is_torque_free: bool,
    generation: u16,
    /// The number of its parameters in the table's interner.
    interned: u32,
}

impl fmt::Debug for Slot {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Slot")
            .field("track", &self.track())
            .field("generation", &self.generation)
            .finish_non_exhaustive()
    }
}

impl Slot {
    fn new(id: BodyId, track: &Track, interned: u32, is_torque_free: bool) -> Self {
        Self {
            track: DenseTrack::new(track),
            is_torque_free,
            generation: id.generation(),
            interned,
        }
    }

    fn set_track(&mut self, track: &Track) {
        self.track = DenseTrack::new(track);
    }

    pub(crate) const fn id(&self, index: u32) -> BodyId {
        BodyId::new(index, self.generation)
    }

    /// The number of its prediction parameters: bodies that share them have one number.
    pub(crate) const fn interned(&self) -> u32 {
        self.interned
    }

    /// True if the body rotates torque-free.
    pub(crate) const fn is_torque_free(&self) -> bool {
        self.is_torque_free
    }

    /// The body's track.
    #[inline]
    pub(crate) fn track(&self) -> Track {
        self.track.track()
    }

    /// The track in its compact form.
    pub(crate) const fn dense(&self) -> &DenseTrack {
        &self.track
    }

    /// The tick of the track's motion.
    pub(crate) const fn origin(&self) -> Tick {
        self.track.origin()
    }

    /// The predictor of the track.
    pub(crate) const fn predictor(&self) -> Predictor {
        self.track.predictor()
    }

    /// The parent of the body, if it is attached.
    pub(crate) const fn parent(&self) -> Option<BodyId> {
        self.track.parent()
    }

    /// See [`Track::is_exact_rest`].
    pub(crate) const fn is_exact_rest(&self) -> bool {
        self.track.is_exact_rest()
    }
}

/// By index, up to the last body with torque-free rotation.
#[derive(Default)]
struct RotationCursors(Vec<Cell<RotationCursor>>);

impl Clone for RotationCursors {
    fn clone(&self) -> Self {
        Self::default()
    }
}

impl fmt::Debug for RotationCursors {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("RotationCursors")
            .field(&self.0.len())
            .finish()
    }
}

impl RotationCursors {
    /// Makes a cursor for a body with torque-free rotation.
    fn reach(&mut self, index: u32) {
        grow_to(&mut self.0, index as usize + 1, Cell::default);
    }

    /// Calls `work` with the cursor of a body, or with a new one if none is cached.
    fn with<T>(&self, index: u32, work: impl FnOnce(&mut RotationCursor) -> T) -> T {
        let place = self.0.get(index as usize);
        let mut cursor = place.map(Cell::take).unwrap_or_default();
        let done = work(&mut cursor);
        if let Some(place) = place {
            place.set(cursor);
        }
        done
    }
}

/// One distinct set of parameters in a stream.
#[derive(Clone, Debug)]
struct InternedParameters {
    radius: Metres,
    gravity_scale: f32,
    inertia: Option<Inertia>,
    /// The index in the table of damping factors.
    flow: u16,
    tolerance_scale: ToleranceScale,
    /// A number that the subscriber's owner keeps with such bodies; see `Tracks::label`.
    label: Option<u32>,
    /// The stream's tolerance, scaled for these bodies.
    tolerance: Tolerance,
    grid: Grid,
}

/// The values that distinguish two sets, bit for bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct ParameterKey {
    radius: u64,
    gravity_scale: u32,
    inertia: Option<[u32; 7]>,
    flow: u16,
    tolerance_scale: ToleranceScale,
    label: Option<u32>,
}

impl Internable for InternedParameters {
    type Key = ParameterKey;

    fn key(&self) -> ParameterKey {
        let inertia = self.inertia.map(|inertia| {
            let ([a, b, c], [x, y, z, w]) = (inertia.moments(), inertia.frame());
            [a, b, c, x, y, z, w].map(f32::to_bits)
        });
        ParameterKey {
            radius: self.radius.metres().to_bits(),
            gravity_scale: self.gravity_scale.to_bits(),
            inertia,
            flow: self.flow,
            tolerance_scale: self.tolerance_scale,
            label: self.label,
        }
    }
}

/// All parameter sets of one stream, by number.
type InternedParameterTable = Interner<InternedParameters>;

/// Gravity by the tick from which on it acts.
#[derive(Clone, Debug)]
struct GravityHistory {
    /// Rising ticks; never empty.
    changes: Vec<(Tick, DVec3)>,
}

impl GravityHistory {
    fn new(gravity: Vec3) -> Self {
        Self {
            changes: alloc::vec![(Tick::ZERO, gravity.as_dvec3())],
        }
    }

    /// The gravity of tracks with this origin, m/s², world frame.
    #[inline]
    fn at(&self, origin: Tick) -> DVec3 {
        // Most scenes never change their gravity.
        if let [(_, gravity)] = self.changes[..] {
            return gravity;
        }
        self.changes
            .iter()
            .rev()
            .find(|(since, _)| *since <= origin)
            .map_or(self.changes[0].1, |(_, gravity)| *gravity)
    }

    /// The gravity and the first tick of each change, oldest first. The first entry also holds for all earlier ticks.
    fn changes(&self) -> impl Iterator<Item = (Tick, Vec3)> {
        let since = |place: usize, tick: Tick| if place == 0 { Tick::ZERO } else { tick };
        self.changes
            .iter()
            .enumerate()
            .map(move |(place, (tick, gravity))| (since(place, *tick), gravity.as_vec3()))
    }

    /// Changes the gravity from `since` on and drops entries that no track can refer to.
    fn change(&mut self, since: Tick, gravity: Vec3) {
        self.changes.retain(|(earlier, _)| *earlier < since);
        let oldest_needed = since.before(TRACK_AGE_MAX).unwrap_or_default();
        let still_needed = self
            .changes
            .iter()
            .rposition(|(earlier, _)| *earlier <= oldest_needed)
            .unwrap_or(0);
        self.changes.drain(..still_needed);
        self.changes.push((since, gravity.as_dvec3()));
    }
}

#[cfg(test)]
mod tests;
