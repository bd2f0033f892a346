//! The prediction modes of a body in the world.
//!
//! They are rest, uniform, falling and accelerated. Each mode has a number. The attached mode has one too, but is described in `attached`.

use glam::DVec3;
use rhumb_reckoning::{ConstantAcceleration, Motion, Pose, Predictor, attached_motion};

use super::acceleration::{ACCELERATIONS, accelerations};
use super::errors::Units;
use super::subject::{Context, Parent, Subject};
use crate::packet::{Age, PredictionMode};

/// Number of modes: rest, uniform, falling, attached, accelerated.
pub(super) const MODES: usize = 4 + ACCELERATIONS;
/// Mode number of rest.
pub(super) const REST: usize = 0;
/// Mode number of uniform motion.
pub(super) const FLOATING: usize = 1;
/// Mode number of falling.
pub(super) const FALLING: usize = 2;
/// Mode number of attached.
pub(super) const ATTACHED: usize = 3;
/// Mode number of the track's own acceleration. The observed one has the next.
pub(super) const ACCELERATED: usize = 4;

/// Greatest expected duration of an acceleration, in ticks.
const ACCELERATION_LASTS: f64 = 16.0;

/// A prediction mode and the prediction that it corrects.
#[derive(Clone, Copy, Debug)]
pub(super) struct Prediction<'a> {
    pub(super) mode: PredictionMode,
    pub(super) predictor: Predictor,
    /// The body that defines the frame of reference; `None` for the world.
    pub(super) parent: Option<&'a Parent<'a>>,
    /// The predicted motion in this frame.
    pub(super) motion: &'a Motion,
}

impl Prediction<'_> {
    pub(super) fn moves(&self) -> bool {
        self.predictor != Predictor::Rest
    }

    /// A pose of the frame in the world, as a subscriber computes it.
    pub(super) fn in_world(&self, pose: &Pose) -> Pose {
        match self.parent {
            None => *pose,
            Some(parent) => attached_motion(parent.predicted_motion, pose).pose(),
        }
    }
}

/// The prediction modes of one body in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct WorldModes<'a> {
    subject: &'a Subject<'a>,
    /// Age of the track of the present parent.
    parent_age: Option<Age>,
    /// True if the parent is removed; the body then needs a keyframe.
    pub(super) orphaned: bool,
    pub(super) floating: Predictor,
    falling: Predictor,
    gravity: Option<DVec3>,
    accelerations: [Option<ConstantAcceleration>; ACCELERATIONS],
}

impl<'a> WorldModes<'a> {
    pub(super) fn new(context: &Context<'_>, subject: &'a Subject<'a>, units: &Units) -> Self {
        let now = subject.track;
        let above = context.tracks.parent(now);
        let is_torque_free = subject.slot.is_torque_free() && context.features.torque_free;
        let (floating, falling) = if is_torque_free {
            (Predictor::TorqueFree, Predictor::BallisticTorqueFree)
        } else {
            (Predictor::Uniform, Predictor::Ballistic)
        };
        let gravity = context.tracks.gravity(subject.slot, subject.tick);
        let reach = 1.0 / units.still.to_array()[0];
        Self {
            subject,
            parent_age: above.and_then(|(_, slot)| context.tracks.age(&slot.track(), subject.tick)),
            orphaned: now.parent.is_some() && above.is_none(),
            floating,
            falling,
            gravity: Some(gravity).filter(|by| context.features.ballistic && *by != DVec3::ZERO),
            accelerations: accelerations(context, subject, reach, gravity),
        }
    }

    /// The moving mode that is the track's own.
    pub(super) fn own_moving(&self) -> Option<usize> {
        let now = self.subject.track;
        match now.predictor {
            _ if now.parent.is_some() => None,
            predictor if predictor == self.floating => Some(FLOATING),
            predictor if predictor == self.falling => Some(FALLING),
            Predictor::Accelerated(_) => Some(ACCELERATED),
            _ => None,
        }
    }

    /// The acceleration of a moving mode, m/s², and its greatest expected duration in ticks. `None` if the mode does not
    /// apply.
    pub(super) fn acceleration(&self, number: usize) -> Option<(DVec3, f64)> {
        match number {
            FLOATING => Some((DVec3::ZERO, f64::INFINITY)),
            FALLING => Some((self.gravity?, f64::INFINITY)),
            _ => {
                let acceleration = self.accelerations[number - ACCELERATED]?;
                Some((acceleration.acceleration(), ACCELERATION_LASTS))
            }
        }
    }

    /// The prediction of a mode in the world; `None` if the mode does not apply.
    pub(super) fn prediction(&self, number: usize) -> Option<Prediction<'a>> {
        let predictor = match number {
            REST => Predictor::Rest,
            FLOATING => self.floating,
            FALLING => self.falling,
            _ => Predictor::Accelerated(self.accelerations[number - ACCELERATED]?),
        };
        let now = self.subject.track;
        let same = now.parent.is_none() && now.predictor == predictor;
        Some(Prediction {
            mode: if same {
                PredictionMode::Same
            } else {
                PredictionMode::World {
                    predictor,
                    parent_age: self.parent_age,
                }
            },
            predictor,
            parent: None,
            motion: self.subject.predicted_motion,
        })
    }
}
