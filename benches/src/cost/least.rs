//! What a listener's arithmetic alone takes: predictions and corrections
//!
//! Every listener must reckon these to the bit, four side by side as they are fastest here. Nothing is read, looked up,
//! kept or shown meanwhile, so that no hearing and no view of such bodies can take less.

use std::hint::black_box;
use std::num::NonZeroU32;
use std::time::{Duration, Instant};

use glam::DVec3;
use rhumb_reckoning::{
    Anchor, Conditions, Correcting, Damping, DenseTrack, FlowTable, Grid, HORIZON, Integrator,
    Metres, Predictor, Quartet, Rate, Residual, Seconds, Snapped, Tick, Tolerance, Track,
    VelocityResidual, Verbatim,
};

use super::median;

/// How old the tracks are.
const AGE: Tick = Tick::new(20);

/// Bodies that fly and spin, as many as there are tracks.
pub(super) struct Least {
    tracks: Vec<DenseTrack>,
    flow: FlowTable,
    grid: Grid,
}

impl Least {
    pub(super) fn of(bodies: u32) -> Self {
        let integrator = Integrator {
            rate: Rate::HZ_60,
            substeps: NonZeroU32::new(4).expect("four is not zero"),
        };
        let mut flow = FlowTable::new(integrator, Damping::default());
        flow.extend_to(HORIZON);
        let grid = Grid::new(Tolerance::NORMAL, Metres::new(0.5));
        let track = |index: u32| {
            let place = index as f32;
            let begun = Verbatim::new(
                [place % 100.0, place / 100.0, 0.0],
                [0.0, 0.0, 0.0, 1.0],
                [3.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
            );
            let begun = begun.expect("these numbers are finite").motion();
            DenseTrack::new(&Track {
                origin: Tick::ZERO,
                predictor: Predictor::Ballistic,
                anchor: Anchor::Snapped(Snapped::of(&begun, &grid)),
                carrier: None,
            })
        };
        Self {
            tracks: (0..bodies).map(track).collect(),
            flow,
            grid,
        }
    }

    /// All of them predicted: the median of so many repeats.
    pub(super) fn predicting(&self, repeats: u32) -> Duration {
        self.measure(repeats, |quartet| {
            quartet.predict(|_, motion| {
                black_box(motion);
            });
        })
    }

    /// All of them predicted and corrected, their velocities too.
    pub(super) fn correcting(&self, repeats: u32) -> Duration {
        let residual = Residual {
            position: [2, -1, 1],
            turn: [1, 0, -1],
            velocity: Some(VelocityResidual {
                coarseness: 3,
                linear: [9, -2, 1],
                angular: [0, 1, 0],
            }),
        };
        let said = Correcting {
            residual: &residual,
            over: Seconds::new(1.0 / 3.0),
            grid: &self.grid,
        };
        self.measure(repeats, |quartet| {
            quartet.correct([Some(said); Quartet::LANES], |_, snapped| {
                black_box(snapped);
            });
        })
    }

    fn measure(&self, repeats: u32, mut each: impl FnMut(&mut Quartet)) -> Duration {
        let conditions = Conditions {
            gravity: DVec3::ZERO,
            flow: &self.flow,
            inertia: None,
        };
        let mut once = || {
            let begun = Instant::now();
            let mut quartet = Quartet::default();
            for (key, track) in (0..).zip(&self.tracks) {
                let taken = quartet.take(key, track, AGE, &self.grid, &conditions);
                debug_assert!(taken, "it neither rests nor tumbles");
                if quartet.is_full() {
                    each(&mut quartet);
                }
            }
            each(&mut quartet);
            begun.elapsed()
        };
        median((0..repeats).map(|_| once()))
    }
}
