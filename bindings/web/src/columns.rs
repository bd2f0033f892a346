//! Columns beside those of the view, and the digest of a copy.
//!
//! Columns are numbers that JavaScript reads in place. Invariant: after an update, each column has one entry per body of the
//! view, in its order. The words of a digest are those of `spec/vectors/README.md`.

use glam::{Quat, Vec3};
use rhumb_protocol::message::StreamChoice;
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::session::Replica;
use rhumb_protocol::stream::Subscriber;
use rhumb_reckoning::{BodyId, Tick, Tolerance};
use rhumb_view::{BodyCentres, View};
use serde_json::{Value, json};

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

    pub(crate) fn compute_update_ticks(&mut self, replica: Option<&Replica>) {
        self.update_ticks.clear();
        self.update_ticks.extend(self.known.iter().map(|id| {
            let track = replica.and_then(|replica| replica.stream().track(*id));
            track.map_or(0.0, |track| track.origin.value() as f64)
        }));
    }

    pub(crate) fn compute_error_bounds(&mut self, replica: Option<&Replica>, view: &View) {
        self.error_bounds.clear();
        let bounds = view.error_bounds(replica.map(Replica::stream));
        self.error_bounds
            .extend(bounds.map(|bound| bound.metres() as f32));
    }

    pub(crate) fn compute_tolerances(&mut self, replica: Option<&Replica>) {
        // A choice that is exact has none.
        let stream = replica
            .filter(|replica| !replica.choice().is_exact())
            .map(Replica::stream);
        self.tolerances.clear();
        self.tolerances.extend(self.known.iter().map(|id| {
            let metres = match stream.and_then(|stream| stream.tolerance_of(*id)) {
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

/// The state of a copy: equal for every implementation that has read the same bytes.
pub(crate) fn digest(replica: &Replica) -> Value {
    let stream = replica.stream();
    let watermark = stream.watermark_tick();
    let mut json = json!({
        "watermark": watermark.value(),
        "complete": stream.complete().value(),
        "converged": stream.is_converged(),
        "next": stream.loss_report().next.0,
        "missing": stream.missing(),
        "checksum": format!("{:016x}", stream.state_checksum()),
    });
    // The prediction of a body is not specified while something is missing (PROTOCOL 6.8). Before the origin of a body's
    // newest track, and while bodies come and go between two ticks of a view, it depends on what a view needs, so that
    // clients differ.
    let is_begun = |id| {
        let track = stream.track(id);
        track.is_some_and(|track| track.origin <= watermark)
    };
    if stream.is_converged()
        && !stream.is_changing()
        && replica.bodies().all(|desc| is_begun(desc.id))
    {
        json["poses"] = json!(format!("{:016x}", poses(replica)));
    }
    if matches!(replica.choice(), StreamChoice::Capped { .. }) {
        // Error scales are multiples of one eighth.
        let scale = stream.error_scale_at(watermark);
        json["error_scale_eighths"] = json!(scale.map(|factor| (factor * 8.0) as u64));
    }
    json
}

/// FNV-1a over the doubles of each body's predicted motion at the watermark, in order of index.
fn poses(replica: &Replica) -> u64 {
    let stream = replica.stream();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for desc in replica.bodies() {
        let Some(motion) = stream.predicted_motion(desc.id, stream.watermark_tick()) else {
            continue;
        };
        for byte in motion.parts().into_iter().flat_map(f64::to_le_bytes) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    }
    hash
}
