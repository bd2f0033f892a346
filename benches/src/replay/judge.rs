//! Compares a copy with the recording at each watermarked tick.
//!
//! Each tick is compared once, at the moment when the stream's watermark reaches it, with the recording of that tick.
//! So delay of the link and lookahead cause no error, but a missing update at or before the watermark does.

use glam::{Quat, Vec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_reckoning::{BodyId, BodyState, Metres, Predictor, Tick, Tolerance, ToleranceScale};

use crate::drive::compare::{breach_share, divergence};
use crate::record::{Breach, Cause, CopiedPose, Frame, Truth};

/// A body of the recording at the current tick.
#[derive(Clone, Copy, Debug)]
struct RecordedBody {
    id: BodyId,
    motion: BodyState,
    radius: Metres,
    tolerance_scale: ToleranceScale,
    is_static: bool,
    /// The last tick with a record of it.
    recorded: Tick,
    /// Pose that the copy showed last.
    shown: ([f32; 3], [f32; 4]),
}

/// The recording next to the copy.
#[derive(Debug)]
pub(super) struct ReplayJudge<'a> {
    truth: &'a Truth,
    tick: Tick,
    bodies: Vec<Option<RecordedBody>>,
    placed: usize,
    removed: usize,
    removed_now: Vec<BodyId>,
    pub(super) breaches: Vec<Breach>,
}

impl<'a> ReplayJudge<'a> {
    pub(super) fn new(truth: &'a Truth) -> Self {
        let mut judge = Self {
            truth,
            tick: Tick::ZERO,
            bodies: Vec::new(),
            placed: 0,
            removed: 0,
            removed_now: Vec::new(),
            breaches: Vec::new(),
        };
        judge.apply_changes();
        judge
    }

    /// The last compared tick.
    pub(super) const fn tick(&self) -> Tick {
        self.tick
    }

    /// Advances to the next tick of the recording; returns false at its end.
    pub(super) fn step(&mut self) -> bool {
        let Some(row) = self.truth.ticks.get(self.tick.value() as usize) else {
            return false;
        };
        self.apply_changes();
        self.tick = self.tick.next();
        for observation in row {
            let place = self.bodies.get_mut(observation.id.index() as usize);
            if let Some(Some(known)) = place {
                known.motion = observation.motion;
                known.recorded = self.tick;
            }
        }
        true
    }

    /// Applies placements and removals since the current tick.
    fn apply_changes(&mut self) {
        let truth = self.truth;
        while let Some((when, id)) = truth.removed.get(self.removed)
            && *when <= self.tick
        {
            self.removed += 1;
            self.bodies[id.index() as usize] = None;
            self.removed_now.push(*id);
        }
        while let Some(placed) = truth.placed.get(self.placed)
            && placed.tick <= self.tick
        {
            self.placed += 1;
            let index = placed.desc.id.index() as usize;
            if index >= self.bodies.len() {
                self.bodies.resize(index + 1, None);
            }
            let motion = placed.observation.motion;
            self.bodies[index] = Some(RecordedBody {
                id: placed.desc.id,
                motion,
                radius: placed.shape.bounding_radius(),
                tolerance_scale: placed.desc.tolerance_scale,
                is_static: placed.desc.kind == BodyKind::Fixed,
                recorded: Tick::ZERO,
                shown: (motion.position(), motion.rotation()),
            });
        }
    }

    /// Compares the copy at the current tick.
    pub(super) fn frame(&mut self, copy: &Subscriber, tolerance: Tolerance) -> Frame {
        let tick = self.tick;
        let mut frame = Frame {
            tick,
            removed: std::mem::take(&mut self.removed_now),
            ..Frame::default()
        };
        let known = self.bodies.iter_mut().flatten();
        for known in known.filter(|known| !known.is_static) {
            let Some(predicted_motion) = copy.predicted_motion(known.id, tick) else {
                continue;
            };
            let pose = predicted_motion.pose();
            let (position, rotation) = (pose.position.as_vec3(), pose.rotation.as_quat());
            let shown = (position.to_array(), rotation.to_array());
            if shown != known.shown {
                known.shown = shown;
                frame.changed.push(copied_pose(known.id, shown, copy));
            }
            let error_m = error_m(known, position, rotation);
            if shown == (known.motion.position(), known.motion.rotation()) {
                frame.exact += 1;
            } else {
                frame.errors_m.push(error_m as f32);
            }
            if known.recorded == tick {
                frame.moving_errors_m.push(error_m as f32);
            }
            let off = divergence(&known.motion, position, rotation);
            let tolerance = tolerance.scaled(known.tolerance_scale);
            if let Some(share) = breach_share(tolerance, off, known.radius) {
                self.breaches.push(Breach {
                    tick,
                    id: known.id,
                    error_m,
                    tolerance_m: tolerance.reach(known.radius).metres(),
                    cause: cause(copy, known.id, tick, share),
                });
            }
        }
        frame.errors_m.sort_unstable_by(f32::total_cmp);
        frame
    }
}

fn error_m(known: &RecordedBody, position: Vec3, rotation: Quat) -> f64 {
    let off = divergence(&known.motion, position, rotation);
    off.surface_error(known.radius).metres()
}

fn copied_pose(
    id: BodyId,
    (position, rotation): ([f32; 3], [f32; 4]),
    copy: &Subscriber,
) -> CopiedPose {
    let track = copy.track(id);
    CopiedPose {
        id,
        position,
        rotation,
        resting: track.is_some_and(|track| track.predictor == Predictor::Rest),
    }
}

/// Cause of an error of `share` times the tolerance at a watermarked tick.
fn cause(copy: &Subscriber, id: BodyId, tick: Tick, share: f64) -> Cause {
    let owned = copy
        .error_scale_at(tick)
        .is_some_and(|error_scale| share <= error_scale);
    match copy.bound_at(id, tick) {
        Some(ErrorBound::Within(_)) if owned => Cause::Budget,
        Some(ErrorBound::Within(_)) | None => Cause::Fault,
        Some(ErrorBound::Unknown { .. }) if copy.missing() > 0 => Cause::Loss,
        Some(ErrorBound::Unknown { .. }) => Cause::Late,
    }
}
