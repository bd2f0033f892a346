//! Lower bound of decoding and rendering: predictions and corrections.
//!
//! Every subscriber must compute these bit-exactly, four lanes at a time for speed. The measurement reads, looks up,
//! stores and renders nothing, so no decoder and no view of such bodies can be faster.

use std::hint::black_box;
use std::time::Duration;

use glam::DVec3;
use rhumb_reckoning::{
    Conditions, Damping, DenseTrack, Grid, Integrator, LaneCorrection, PredictionX4, Residual,
    Seconds, StepCoefficientTable, TRACK_AGE_MAX, Tick, Track, VelocityResidual,
};

use super::median::median;
use crate::processor::time_of;

/// Tick at which the tracks are evaluated.
const AGE: Tick = Tick::new(20);

/// Tracks of bodies without gravity.
pub(super) struct PredictionFloor {
    tracks: Vec<DenseTrack>,
    flow: StepCoefficientTable,
    grid: Grid,
}

impl PredictionFloor {
    /// Builds the tracks on the grid of the measured stream.
    pub(super) fn of(
        tracks: impl Iterator<Item = Track>,
        integrator: Integrator,
        grid: Grid,
    ) -> Self {
        let mut flow = StepCoefficientTable::new(integrator, Damping::default());
        flow.extend_to(TRACK_AGE_MAX);
        Self {
            tracks: tracks.map(|track| DenseTrack::new(&track)).collect(),
            flow,
            grid,
        }
    }

    /// Time to predict all tracks; the median of `repeats`.
    pub(super) fn predicting(&self, repeats: u32) -> Duration {
        self.measure(repeats, |batch| {
            batch.predict(|_, motion| {
                black_box(motion);
            });
        })
    }

    /// Time to predict and correct one track with its velocities, nanoseconds.
    pub(super) fn correcting(&self, repeats: u32) -> f64 {
        let residual = Residual {
            position: [2, -1, 1],
            turn: [1, 0, -1],
            velocity: Some(VelocityResidual {
                velocity_exponent: 3,
                linear: [9, -2, 1],
                angular: [0, 1, 0],
            }),
        };
        let correction = LaneCorrection {
            residual: &residual,
            over: Seconds::new(1.0 / 3.0),
            grid: &self.grid,
        };
        let took = self.measure(repeats, |batch| {
            batch.correct([Some(correction); PredictionX4::LANES], |_, quantised| {
                black_box(quantised);
            });
        });
        took.as_nanos() as f64 / self.tracks.len().max(1) as f64
    }

    fn measure(&self, repeats: u32, mut each: impl FnMut(&mut PredictionX4)) -> Duration {
        let conditions = Conditions {
            gravity: DVec3::ZERO,
            flow: &self.flow,
            inertia: None,
        };
        let mut once = || {
            let mut batch = PredictionX4::default();
            for (key, track) in (0..).zip(&self.tracks) {
                let accepted = batch.take(key, track, AGE, &self.grid, &conditions);
                debug_assert!(accepted, "the track neither rests nor rotates freely");
                if batch.is_full() {
                    each(&mut batch);
                }
            }
            each(&mut batch);
        };
        median((0..repeats).map(|_| time_of(&mut once).0))
    }
}
