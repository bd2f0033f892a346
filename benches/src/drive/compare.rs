//! How far each copied body is from the truth of the tick that the copy shows.

use std::collections::VecDeque;

use glam::{Quat, Vec3};
use rhumb_protocol::scene::BodyKind;
use rhumb_reckoning::{
    BodyId, BodyState, Divergence, Metres, Motion, Pose, Tick, Tolerance, ToleranceScale,
};

use crate::record::{Breach, Cause};

/// The states of all bodies at the last few ticks: a pipelined copy is a tick or two behind.
#[derive(Debug, Default)]
pub(super) struct RecentTruth {
    ticks: VecDeque<(Tick, Vec<Option<TrueBody>>)>,
}

/// What a body was at a tick, and how it is judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrueBody {
    pub(super) id: BodyId,
    pub(super) motion: BodyState,
    pub(super) radius: Metres,
    pub(super) kind: BodyKind,
    pub(super) tolerance_scale: ToleranceScale,
}

/// Ticks that are kept.
const KEPT: usize = 64;

impl RecentTruth {
    pub(super) fn push(&mut self, tick: Tick, states: impl Iterator<Item = Option<TrueBody>>) {
        let mut row = if self.ticks.len() == KEPT {
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

    /// Whether a tick has come, so that its truth is known now or never.
    pub(super) fn has_come(&self, tick: Tick) -> bool {
        self.ticks.back().is_some_and(|(newest, _)| tick <= *newest)
    }

    fn at(&self, tick: Tick) -> Option<&[Option<TrueBody>]> {
        let (_, row) = self.ticks.iter().rev().find(|(kept, _)| *kept == tick)?;
        Some(row)
    }
}

/// The errors of one view.
#[derive(Debug, Default)]
pub(super) struct ViewErrors {
    /// Metres, sorted.
    pub(super) errors_m: Vec<f32>,
    pub(super) exact: u32,
    /// Bodies of the truth that the copy does not have.
    pub(super) missing: u32,
    pub(super) breaches: Vec<Breach>,
}

/// Compares what a copy shows of each body with the truth of `tick`; `None` when that truth is no longer, or not yet,
/// known. `cause` is told by what share of its tolerance a body is off.
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
        if known.kind == BodyKind::Static {
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
        let apart = apart(&known.motion, position, rotation);
        let error = apart.surface_error(known.radius);
        errors.errors_m.push(error.metres() as f32);
        let tolerance = tolerance.map(|tolerance| tolerance.scaled(known.tolerance_scale));
        if let Some(tolerance) = tolerance
            && let Some(share) = over(tolerance, apart, known.radius)
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

/// How far a pose that is shown lies from the truth.
pub(crate) fn apart(truth: &BodyState, position: Vec3, rotation: Quat) -> Divergence {
    let shown = Pose {
        position: position.as_dvec3(),
        rotation: rotation.as_dquat(),
    };
    let shown =
        Motion::new(shown, rhumb_reckoning::Twist::ZERO).map_or(shown, |motion| motion.pose());
    Divergence::between(&truth.motion().pose(), &shown)
}

/// The share of its tolerance by which a body is off, measured in a view, if that breaks the promise.
pub(crate) fn over(tolerance: Tolerance, apart: Divergence, radius: Metres) -> Option<f64> {
    let share = tolerance.share(&less_rounding(apart), radius);
    (share > 1.0).then_some(share)
}

/// A distance without what a view adds to it, which holds f32.
fn less_rounding(apart: Divergence) -> Divergence {
    Divergence {
        position: Metres::new((apart.position.metres() - POSITION_ROUNDING).max(0.0)),
        half_chord: (apart.half_chord - TURN_ROUNDING).max(0.0),
    }
}

/// At 128 m a coordinate is rounded by up to 4 µm, in metres.
const POSITION_ROUNDING: f64 = 2e-5;
/// Each component of a rotation is rounded by up to 3e-8.
const TURN_ROUNDING: f64 = 1e-7;
