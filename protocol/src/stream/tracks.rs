//! The table of tracks: the publisher's belief, and its copy.
//!
//! One belief, two homes: both ends hold this type and change it by the same calls, so that they stay equal to the bit.

use alloc::vec::Vec;

use glam::{DVec3, Vec3};
use rhumb_reckoning::{
    Anchor, BodyId, Damping, FlowTable, Grid, HORIZON, Integrator, Metres, Motion, Predictor, Tick,
    Tolerance, Track,
};

use super::field::Field;
use crate::limits::{DAMPINGS_MAX, INDICES_MAX};
use crate::packet::Saying;
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
}

impl Manner {
    /// Of a body with these terms and this shape, in a scene whose bodies are damped like this.
    ///
    /// A body that no engine moves keeps the velocity it is given: nothing damps it and nothing pulls at it.
    #[must_use]
    pub fn of(terms: &BodyTerms, shape: &Shape, damping: Damping) -> Self {
        let radius = shape.bounding_radius();
        match terms.kind {
            BodyKind::Dynamic => Self {
                radius,
                damping: terms.damping.unwrap_or(damping),
                gravity_scale: terms.gravity_scale,
            },
            BodyKind::Static | BodyKind::Kinematic => Self {
                radius,
                damping: Damping::default(),
                gravity_scale: 0.0,
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
    generation: u16,
    flow: u16,
}

impl Slot {
    pub(crate) const fn id(&self, index: u32) -> BodyId {
        BodyId::new(index, self.generation)
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
        self.slots[index] = Some(Slot {
            track,
            radius: manner.radius,
            gravity_scale: manner.gravity_scale,
            generation: id.generation(),
            flow,
        });
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
        if found {
            *place = None;
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

    pub(crate) fn slot_mut(&mut self, index: u32) -> Option<&mut Slot> {
        self.slots.get_mut(index as usize)?.as_mut()
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

    pub(crate) fn grid(&self, slot: &Slot) -> Grid {
        Grid::new(self.tolerance, slot.radius)
    }

    /// What pulls at a body by a law said at `origin`, m/s² (RECKONING 2.5).
    pub(crate) fn gravity(&self, slot: &Slot, origin: Tick) -> DVec3 {
        let scale = f64::from(slot.gravity_scale);
        let DVec3 { x, y, z } = self.field.at(origin);
        DVec3::new(x * scale, y * scale, z * scale)
    }

    /// What is believed of a body at a tick.
    pub(crate) fn believed(&self, slot: &Slot, tick: Tick) -> Motion {
        self.predicted(slot, &slot.track, tick)
    }

    /// What a track of a body, this one or one that it had, says of a tick.
    pub(crate) fn predicted(&self, slot: &Slot, track: &Track, tick: Tick) -> Motion {
        let gravity = match track.predictor {
            Predictor::Ballistic => self.gravity(slot, track.origin),
            Predictor::Rest | Predictor::Uniform => DVec3::ZERO,
        };
        let (_, flow) = &self.flows[usize::from(slot.flow)];
        track.at(tick, &self.grid(slot), gravity, flow)
    }

    /// The track that a saying at `tick` gives a body of which `believed` was believed at that tick.
    pub(crate) fn said(saying: &Saying, tick: Tick, believed: &Motion, grid: &Grid) -> Track {
        match saying {
            Saying::Whole(whole) => whole.track(tick),
            Saying::Residual {
                predictor,
                residual,
                ..
            } => {
                let snapped = residual.onto(believed, grid);
                let resting = *predictor == Predictor::Rest;
                Track {
                    origin: tick,
                    predictor: *predictor,
                    anchor: Anchor::Snapped(if resting { snapped.stilled() } else { snapped }),
                }
            }
        }
    }

    /// Takes in what was said of a body at a tick.
    pub(crate) fn hear(
        &mut self,
        index: u32,
        tick: Tick,
        saying: &Saying,
    ) -> Result<(), Unreadable> {
        let slot = self.slot(index).ok_or(Unreadable::NoBody)?;
        if tick <= slot.track.origin {
            return Err(Unreadable::Superseded);
        }
        let track = match saying {
            Saying::Whole(whole) => whole.track(tick),
            Saying::Residual { age, .. } => {
                if slot.track.origin + *age != tick {
                    return Err(Unreadable::OtherRevision);
                }
                Self::said(saying, tick, &self.believed(slot, tick), &self.grid(slot))
            }
        };
        self.slot_mut(index).ok_or(Unreadable::NoBody)?.track = track;
        Ok(())
    }
}
