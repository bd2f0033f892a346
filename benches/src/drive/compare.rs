//! Errors of a client's copy against the truth at the tick it shows.

use std::collections::VecDeque;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{
    BodyId, BodyState, Divergence, Metres, Motion, Pose, Tick, Tolerance, ToleranceScale,
};

use crate::record::{Breach, Cause};

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
pub(crate) fn breach_share(
    tolerance: Tolerance,
    divergence: Divergence,
    radius: Metres,
) -> Option<f64> {
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
