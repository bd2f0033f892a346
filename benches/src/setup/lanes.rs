//! Setup of the least work of decoding and rendering.
//!
//! Every subscriber must compute these bit-exactly, four lanes at a time for speed. The work reads, looks up, stores and
//! renders nothing, so no decoder and no view of such bodies can be faster.

use std::hint::black_box;

use glam::DVec3;
use rhumb_reckoning::{
    Conditions, Damping, DenseTrack, Grid, Integrator, LaneCorrection, PredictionX4, Residual,
    Seconds, StepCoefficientTable, TRACK_AGE_MAX, Tick, Track, VelocityResidual,
};

/// Tick at which the tracks are evaluated.
const AGE: Tick = Tick::new(20);

/// Tracks of bodies without gravity.
#[derive(Clone, Debug)]
pub struct Lanes {
    tracks: Vec<DenseTrack>,
    flow: StepCoefficientTable,
    grid: Grid,
}

impl Lanes {
    /// Builds the tracks on the grid of a stream.
    #[must_use]
    pub fn of(tracks: impl Iterator<Item = Track>, integrator: Integrator, grid: Grid) -> Self {
        let mut flow = StepCoefficientTable::new(integrator, Damping::default());
        flow.extend_to(TRACK_AGE_MAX);
        Self {
            tracks: tracks.map(|track| DenseTrack::new(&track)).collect(),
            flow,
            grid,
        }
    }

    /// Predicts all tracks.
    pub fn predict(&self) {
        self.each_batch(|batch| {
            batch.predict(|_, motion| {
                black_box(motion);
            });
        });
    }

    /// Predicts all tracks, and corrects each with its velocities.
    pub fn correct(&self) {
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
        self.each_batch(|batch| {
            batch.correct([Some(correction); PredictionX4::LANES], |_, quantised| {
                black_box(quantised);
            });
        });
    }

    fn each_batch(&self, mut each: impl FnMut(&mut PredictionX4)) {
        let conditions = Conditions {
            gravity: DVec3::ZERO,
            flow: &self.flow,
            inertia: None,
        };
        let mut batch = PredictionX4::default();
        for (key, track) in (0..).zip(&self.tracks) {
            let accepted = batch.take(key, track, AGE, &self.grid, &conditions);
            debug_assert!(accepted, "the track neither rests nor rotates freely");
            if batch.is_full() {
                each(&mut batch);
            }
        }
        each(&mut batch);
    }
}
