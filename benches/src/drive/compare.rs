//! Errors of a copy against the truth: a client's, or a replay's.
//!
//! A client's copy is compared at the tick that it shows.
//!
//! A replay's copy is compared with the recording of a tick once, at the moment when the stream's watermark reaches it. So
//! delay of the link and lookahead cause no error, but a missing update at or before the watermark does.

use std::collections::VecDeque;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_protocol::stream::{ErrorBound, Subscriber};
use rhumb_reckoning::{
    BodyId, BodyState, Divergence, Metres, Motion, Pose, Predictor, Tick, Tolerance, ToleranceScale,
};

use crate::record::{Breach, Cause, Change, Changes, CopiedPose, Frame, Truth};

/// Body states of the last few ticks; a pipelined copy lags by a tick or two.
#[derive(Debug, Default)]
pub(super) struct RecentTruth {
    ticks: VecDeque<(Tick, Vec<Option<TrueBody>>)>,
}

/// A body's true state at one tick, and the parameters of its tolerance.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrueBody {
    pub(super) id: BodyId,
    pub(super) motion: BodyState,
    pub(super) radius: Metres,
    pub(super) kind: BodyKind,
    pub(super) tolerance_scale: ToleranceScale,
}

/// Number of ticks kept.
const KEPT_TICKS: usize = 64;

impl RecentTruth {
    pub(super) fn push(&mut self, tick: Tick, states: impl Iterator<Item = Option<TrueBody>>) {
        let mut row = if self.ticks.len() == KEPT_TICKS {
            self.ticks
                .pop_front()
                .map(|(_, row)| row)
                .unwrap_or_default()
        } else {
            Vec::new()
        };
        row.clear();
        row.extend(states);
        self.ticks.push_back((tick, row));
    }

    /// True if the newest known tick is at or after `tick`. If its truth is still missing, it stays missing.
    pub(super) fn has_reached(&self, tick: Tick) -> bool {
        self.ticks.back().is_some_and(|(newest, _)| tick <= *newest)
    }

    fn at(&self, tick: Tick) -> Option<&[Option<TrueBody>]> {
        let (_, row) = self.ticks.iter().rev().find(|(kept, _)| *kept == tick)?;
        Some(row)
    }
}

/// Errors of one view.
#[derive(Debug, Default)]
pub(super) struct ViewErrors {
    /// Surface errors in metres, sorted.
    pub(super) errors_m: Vec<f32>,
    pub(super) exact: u32,
    /// Bodies of the truth that the copy lacks.
    pub(super) missing: u32,
    pub(super) breaches: Vec<Breach>,
}

/// Compares each body's shown pose with the truth at `tick`; `None` if that truth is unknown. `cause` maps a body and
/// its error, as a share of its tolerance, to the cause of the breach.
pub(super) fn compare(
    recent: &RecentTruth,
    tick: Tick,
    shown: impl Fn(BodyId) -> Option<(Vec3, Quat)>,
    tolerance: Option<Tolerance>,
    cause: impl Fn(BodyId, f64) -> Cause,
) -> Option<ViewErrors> {
    let truth = recent.at(tick)?;
    let mut errors = ViewErrors::default();
    for known in truth.iter().flatten() {
        if known.kind == BodyKind::Fixed {
            continue;
        }
        let Some((position, rotation)) = shown(known.id) else {
            errors.missing += 1;
            continue;
        };
        if known.motion.position() == position.to_array()
            && known.motion.rotation() == rotation.to_array()
        {
            errors.exact += 1;
            continue;
        }
        let divergence = divergence(&known.motion, position, rotation);
        let error = divergence.surface_error(known.radius);
        errors.errors_m.push(error.metres() as f32);
        let tolerance = tolerance.map(|tolerance| tolerance.scaled(known.tolerance_scale));
        if let Some(tolerance) = tolerance
            && let Some(share) = breach_share(tolerance, divergence, known.radius)
        {
            errors.breaches.push(Breach {
                tick,
                id: known.id,
                error_m: error.metres(),
                tolerance_m: tolerance.reach(known.radius).metres(),
                cause: cause(known.id, share),
            });
        }
    }
    errors.errors_m.sort_unstable_by(f32::total_cmp);
    Some(errors)
}

/// Distance between a shown pose and the truth.
pub(crate) fn divergence(truth: &BodyState, position: Vec3, rotation: Quat) -> Divergence {
    let shown = Pose {
        position: position.as_dvec3(),
        rotation: rotation.as_dquat(),
    };
    let shown =
        Motion::new(shown, rhumb_reckoning::Twist::ZERO).map_or(shown, |motion| motion.pose());
    Divergence::between(&truth.motion().pose(), &shown)
}

/// The error as a share of the tolerance, if it exceeds the tolerance; f32 rounding of the view is subtracted first.
fn breach_share(tolerance: Tolerance, divergence: Divergence, radius: Metres) -> Option<f64> {
    let share = tolerance.share(&without_rounding(divergence), radius);
    (share > 1.0).then_some(share)
}

/// Subtracts the rounding error that the view's f32 numbers add.
fn without_rounding(divergence: Divergence) -> Divergence {
    Divergence {
        position: Metres::new((divergence.position.metres() - POSITION_ROUNDING).max(0.0)),
        half_chord: (divergence.half_chord - TURN_ROUNDING).max(0.0),
    }
}

/// f32 rounding at 128 m is up to 4 µm per coordinate; this leaves a margin. Metres.
const POSITION_ROUNDING: f64 = 2e-5;
/// f32 rounding of a quaternion component is up to 3e-8; this leaves a margin.
const TURN_ROUNDING: f64 = 1e-7;

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
pub(crate) struct ReplayJudge<'a> {
    truth: &'a Truth,
    tick: Tick,
    bodies: Vec<Option<RecordedBody>>,
    changes: Changes<'a>,
    removed_now: Vec<BodyId>,
    pub(crate) breaches: Vec<Breach>,
}

impl<'a> ReplayJudge<'a> {
    pub(crate) fn new(truth: &'a Truth) -> Self {
        let mut judge = Self {
            truth,
            tick: Tick::ZERO,
            bodies: Vec::new(),
            changes: truth.changes(),
            removed_now: Vec::new(),
            breaches: Vec::new(),
        };
        judge.apply_changes();
        judge
    }

    /// The last compared tick.
    pub(crate) const fn tick(&self) -> Tick {
        self.tick
    }

    /// Advances to the next tick of the recording; returns false at its end.
    pub(crate) fn step(&mut self) -> bool {
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
        while let Some(change) = self.changes.until(self.tick) {
            let placed = match change {
                Change::Placed(_, placed) => placed,
                Change::Removed(id) => {
                    if let Some(known) = self.bodies.get_mut(id.index() as usize) {
                        *known = None;
                    }
                    self.removed_now.push(id);
                    continue;
                }
            };
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
    pub(crate) fn frame(&mut self, copy: &Subscriber, tolerance: Tolerance) -> Frame {
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
