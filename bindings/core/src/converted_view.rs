//! Arrays of a view in the coordinates of an application.
//!
//! In Rhumb's own coordinates, nothing is copied. In others, an array is converted when it is first read in a frame.

use glam::{Quat, Vec3};
use rhumb_client::{BodyCentres, View};

use crate::coordinates::Coordinates;
use crate::packed_id::packed_id;

/// An array that is computed once in a frame, when it is first read.
#[derive(Debug)]
struct Lazy<T> {
    values: Vec<T>,
    is_current: bool,
}

impl<T> Default for Lazy<T> {
    fn default() -> Self {
        Self {
            values: Vec::new(),
            is_current: false,
        }
    }
}

impl<T> Lazy<T> {
    fn get(&mut self, values: impl Iterator<Item = T>) -> &[T] {
        if !self.is_current {
            self.values.clear();
            self.values.extend(values);
            self.is_current = true;
        }
        &self.values
    }
}

/// The arrays of the last view.
#[derive(Debug, Default)]
pub(crate) struct ConvertedView {
    coordinates: Coordinates,
    bodies: Lazy<u64>,
    changed: Lazy<u32>,
    removed: Lazy<u64>,
    positions: Lazy<Vec3>,
    rotations: Lazy<Quat>,
    linear: Lazy<Vec3>,
    angular: Lazy<Vec3>,
}

impl ConvertedView {
    pub(crate) fn new(coordinates: Coordinates) -> Self {
        Self {
            coordinates,
            ..Self::default()
        }
    }

    pub(crate) const fn coordinates(&self) -> Coordinates {
        self.coordinates
    }

    /// Tells that the view was computed anew.
    pub(crate) const fn expire(&mut self) {
        self.bodies.is_current = false;
        self.changed.is_current = false;
        self.removed.is_current = false;
        self.positions.is_current = false;
        self.rotations.is_current = false;
        self.linear.is_current = false;
        self.angular.is_current = false;
    }

    pub(crate) fn bodies(&mut self, view: &View) -> &[u64] {
        self.bodies.get(view.ids().iter().map(|id| packed_id(*id)))
    }

    pub(crate) fn changed(&mut self, view: &View) -> &[u32] {
        self.changed.get(view.changed().map(|place| place as u32))
    }

    pub(crate) fn removed(&mut self, view: &View) -> &[u64] {
        self.removed
            .get(view.removed().iter().map(|id| packed_id(*id)))
    }

    pub(crate) fn positions<'a>(&'a mut self, view: &'a View, centres: &BodyCentres) -> &'a [Vec3] {
        let coordinates = self.coordinates;
        let values = view.positions();
        if centres.is_empty() {
            return match coordinates {
                Coordinates::Rhumb => values,
                _ => (self.positions).get(values.iter().map(|v| coordinates.vector_out(*v))),
            };
        }
        let bodies = view.ids().iter().zip(values).zip(view.rotations());
        let origins = bodies.map(|((id, position), rotation)| {
            coordinates.vector_out(centres.position_out(*id, *position, *rotation))
        });
        self.positions.get(origins)
    }

    pub(crate) fn rotations<'a>(&'a mut self, view: &'a View) -> &'a [Quat] {
        let coordinates = self.coordinates;
        let values = view.rotations();
        match coordinates {
            Coordinates::Rhumb => values,
            _ => (self.rotations).get(values.iter().map(|q| coordinates.rotation_out(*q))),
        }
    }

    pub(crate) fn linear<'a>(&'a mut self, view: &'a View) -> &'a [Vec3] {
        let coordinates = self.coordinates;
        let values = view.linear_velocities();
        match coordinates {
            Coordinates::Rhumb => values,
            _ => (self.linear).get(values.iter().map(|v| coordinates.vector_out(*v))),
        }
    }

    pub(crate) fn angular<'a>(&'a mut self, view: &'a View) -> &'a [Vec3] {
        let coordinates = self.coordinates;
        let values = view.angular_velocities();
        match coordinates {
            Coordinates::Rhumb => values,
            _ => (self.angular).get(values.iter().map(|v| coordinates.angular_out(*v))),
        }
    }
}
