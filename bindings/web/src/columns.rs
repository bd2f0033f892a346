//! Columns beside those of the view: numbers that JavaScript reads in place.
//!
//! Invariant: after an update, each column has one entry per body of the view, in its order.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::session::Replica;
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Tick, Tolerance};
use rhumb_view::{BodyCentres, View};

use crate::argument::id_number;

/// Columns of one view.
#[derive(Debug, Default)]
pub(crate) struct Columns {
    known: Vec<BodyId>,
    pub(crate) ids: Vec<f64>,
    pub(crate) shapes: Vec<u32>,
    pub(crate) kinds: Vec<u8>,
    pub(crate) resting: Vec<u8>,
    pub(crate) changed: Vec<u32>,
    pub(crate) removed: Vec<f64>,
    pub(crate) update_ticks: Vec<f64>,
    pub(crate) error_bounds: Vec<f32>,
    pub(crate) tolerances: Vec<f32>,
    /// Origins of the bodies, if one of them is not its centre of mass; otherwise empty.
    pub(crate) origins: Vec<Vec3>,
    /// Of the bodies that this page added from elsewhere than their centres of mass.
    pub(crate) centres: BodyCentres,
    pub(crate) generation: u32,
    /// True if the description of a body may have changed since the last update.
    pub(crate) described_anew: bool,
    /// True if the view has not come to a known change of a body.
    changing: bool,
}

impl Columns {
    fn put_origins(&mut self, view: &View) {
        self.centres.forget(view.removed());
        self.origins.clear();
        if !self.centres.is_empty() {
            let bodies = view
                .ids()
                .iter()
                .zip(view.positions())
                .zip(view.rotations());
            let origin = |((id, position), rotation): ((&BodyId, &Vec3), &Quat)| {
                self.centres.position_out(*id, *position, *rotation)
            };
            self.origins.extend(bodies.map(origin));
        }
    }

    /// Follows the view; costs little unless bodies came or went.
    pub(crate) fn update(&mut self, view: &View, replica: Option<&Replica>) {
        self.resting.clear();
        self.resting
            .extend(view.resting().iter().map(|rests| u8::from(*rests)));
        self.changed.clear();
        self.changed
            .extend(view.changed().map(|place| place as u32));
        self.removed.clear();
        self.removed
            .extend(view.removed().iter().map(|id| id_number(*id)));
        self.put_origins(view);
        // A delayed view comes to a change of a body later than its description.
        let stream = replica.map(Replica::stream);
        let was_changing = std::mem::replace(
            &mut self.changing,
            stream.is_some_and(Subscriber::is_changing),
        );
        let same = self.known == view.ids() && !was_changing && !self.changing;
        if same && !std::mem::take(&mut self.described_anew) {
            return;
        }
        self.generation = self.generation.wrapping_add(1);
        self.known.clear();
        self.known.extend_from_slice(view.ids());
        self.ids.clear();
        self.ids.extend(self.known.iter().map(|id| id_number(*id)));
        self.described_anew = false;
        self.shapes.clear();
        self.kinds.clear();
        let tick = view.time().map_or(Tick::ZERO, |at| at.tick);
        for id in &self.known {
            let desc = replica.and_then(|replica| replica.body_at(*id, tick));
            self.shapes.push(desc.map_or(u32::MAX, |desc| desc.shape.0));
            self.kinds.push(match desc.map(|desc| desc.kind) {
                Some(BodyKind::Dynamic) => 1,
                Some(BodyKind::Kinematic) => 2,
                Some(BodyKind::Fixed) | None => 0,
            });
        }
    }

    pub(crate) fn compute_update_ticks(&mut self, replica: &Replica) {
        let stream = replica.stream();
        self.update_ticks.clear();
        self.update_ticks.extend(self.known.iter().map(|id| {
            let track = stream.track(*id);
            track.map_or(0.0, |track| track.origin.value() as f64)
        }));
    }

    pub(crate) fn compute_error_bounds(&mut self, replica: &Replica, view: &View) {
        self.error_bounds.clear();
        let bounds = view.error_bounds(replica.stream());
        self.error_bounds
            .extend(bounds.map(|bound| bound.metres() as f32));
    }

    pub(crate) fn compute_tolerances(&mut self, replica: &Replica) {
        let stream = replica.stream();
        let is_full = matches!(
            replica.choice(),
            rhumb_protocol::message::StreamChoice::Full
        );
        self.tolerances.clear();
        self.tolerances.extend(self.known.iter().map(|id| {
            let metres = match stream.tolerance_of(*id).filter(|_| !is_full) {
                Some(
                    Tolerance::Surface(length)
                    | Tolerance::Parts {
                        position: length, ..
                    },
                ) => length.metres().metres(),
                None => 0.0,
            };
            metres as f32
        }));
    }
}
