//! Setups of predictions and of the prefilter, over many bodies at one tick.
//!
//! Each predictor predicts the same bodies one by one, as a judgement does; `lanes` has the predictions of views. The
//! prefilter tests bodies that are within their tolerance, which is what it finds nearly always.

use std::hint::black_box;

use glam::DVec3;
use rhumb_reckoning::{
    Anchor, BodyState, Conditions, Damping, DenseTrack, ErrorPrefilter, Grid, Inertia, Metres,
    Motion, Predictor, PrefilterInput, QuantisedState, StepCoefficientTable, TRACK_AGE_MAX, Tick,
    Tolerance, Track,
};

use super::decoding::{config, impulse_state, track};

/// Radius of the bodies.
const RADIUS: Metres = Metres::new(0.5);
/// Tick at which the tracks are evaluated.
const AGE: Tick = Tick::new(10);
/// Moments of inertia of a brick, kg m²: its torque-free rotation takes a step for each tick.
const MOMENTS: [f32; 3] = [1.0, 2.0, 2.5];

/// Tracks of one predictor.
#[derive(Clone, Debug)]
pub struct PredictorLoad {
    tracks: Vec<Track>,
    grid: Grid,
    flow: StepCoefficientTable,
    inertia: Inertia,
}

impl PredictorLoad {
    /// Tracks of `bodies` bodies that spin and move.
    #[must_use]
    pub fn new(bodies: u32, predictor: Predictor) -> Self {
        let grid = Grid::new(Tolerance::NORMAL, RADIUS);
        let quantised = |index| {
            let quantised = QuantisedState::of(&spinning_state(index).motion(), &grid);
            let rests = predictor == Predictor::Rest;
            if rests {
                quantised.stilled()
            } else {
                quantised
            }
        };
        let tracks = (0..bodies).map(|index| Track {
            predictor,
            anchor: Anchor::Quantised(quantised(index)),
            ..track(index)
        });
        Self {
            tracks: tracks.collect(),
            grid,
            flow: flow(),
            inertia: Inertia::new(MOMENTS, [0.0, 0.0, 0.0, 1.0])
                .expect("a brick has these moments of inertia"),
        }
    }

    /// Predicts all bodies.
    pub fn predict(&self) {
        let conditions = Conditions {
            gravity: DVec3::NEG_Y * 9.806_65,
            flow: &self.flow,
            inertia: Some(&self.inertia),
        };
        for track in &self.tracks {
            black_box(track.at(AGE, &self.grid, &conditions));
        }
    }
}

/// Tracks and truths of bodies within their tolerance.
#[derive(Clone, Debug)]
pub struct PrefilterLoad {
    bodies: Vec<(DenseTrack, BodyState)>,
    prefilter: ErrorPrefilter,
    grid: Grid,
    flow: StepCoefficientTable,
    undecided: Vec<u32>,
}

impl PrefilterLoad {
    /// Bodies that move.
    #[must_use]
    pub fn moving(bodies: u32) -> Self {
        Self::of(bodies, Predictor::Uniform)
    }

    /// Bodies that rest.
    #[must_use]
    pub fn resting(bodies: u32) -> Self {
        Self::of(bodies, Predictor::Rest)
    }

    fn of(bodies: u32, predictor: Predictor) -> Self {
        let grid = Grid::new(Tolerance::NORMAL, RADIUS);
        let (integrator, flow) = (config().integrator, flow());
        let body = |index| {
            let start = impulse_state(index, 0);
            let rests = predictor == Predictor::Rest;
            let start = if rests { start.stilled() } else { start };
            let track = Track {
                predictor,
                anchor: Anchor::Exact(start),
                ..track(index)
            };
            let conditions = conditions(&flow);
            let truth = rounded(&track.at(AGE, &grid, &conditions));
            (DenseTrack::new(&track), truth)
        };
        Self {
            bodies: (0..bodies).map(body).collect(),
            prefilter: ErrorPrefilter::new(Tolerance::NORMAL, integrator),
            grid,
            flow,
            undecided: Vec::new(),
        }
    }

    /// Tests all bodies; returns the number that the prefilter leaves undecided.
    pub fn test(&mut self) -> usize {
        self.undecided.clear();
        let conditions = conditions(&self.flow);
        let mut at_once = 0;
        for (place, (track, truth)) in (0..).zip(&self.bodies) {
            let input = PrefilterInput {
                truth,
                track,
                tick: AGE,
                grid: &self.grid,
                radius: RADIUS,
                conditions: &conditions,
            };
            at_once += usize::from(self.prefilter.test(place, &input, &mut self.undecided));
        }
        self.prefilter.finish(&mut self.undecided);
        at_once + self.undecided.len()
    }
}

/// A motion in the engine's precision.
fn rounded(motion: &Motion) -> BodyState {
    let p = motion.parts().map(|part| part as f32);
    BodyState::new(
        [p[0], p[1], p[2]],
        [p[3], p[4], p[5], p[6]],
        [p[7], p[8], p[9]],
        [p[10], p[11], p[12]],
    )
    .expect("a predicted motion is finite")
}

/// Conditions without gravity and inertia.
const fn conditions(flow: &StepCoefficientTable) -> Conditions<'_> {
    Conditions {
        gravity: DVec3::ZERO,
        flow,
        inertia: None,
    }
}

fn flow() -> StepCoefficientTable {
    let mut flow = StepCoefficientTable::new(config().integrator, Damping::default());
    flow.extend_to(TRACK_AGE_MAX);
    flow
}

/// State of a body that spins about no axis of its own.
fn spinning_state(index: u32) -> BodyState {
    let place = index as f32;
    BodyState::new(
        [place % 100.0, place / 100.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [3.0, 0.0, 0.0],
        [0.4, 1.0, 0.2],
    )
    .expect("these numbers are finite")
}
