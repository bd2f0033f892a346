//! Four corrected predictions side by side, equal to scalar ones to the bit.
//!
//! Each lane repeats [`Residual::onto`] operation by operation.

use wide::f64x4;

use super::{
    LANES, MotionX4, PredictionX4, arrays, choose, floor, lanes, lanes3, normalised, product,
    sin_cos,
};
use crate::packed::{PACKED_STEPS, PackedRotation};
use crate::quantiser::{Grid, POSITION_LIMIT, QuantisedState, Residual, VELOCITY_LIMIT, whole};
use crate::units::Seconds;

/// The correction of one body's prediction.
#[derive(Clone, Copy, Debug)]
pub struct LaneCorrection<'a> {
    /// The correction.
    pub residual: &'a Residual,
    /// Divergence time of the prediction, above zero.
    pub over: Seconds,
    /// Grid of the body.
    pub grid: &'a Grid,
}

/// Corrections, as arrays by quantity and then by lane.
struct LaneCorrections<'a> {
    residuals: [Option<&'a Residual>; LANES],
    apart: [[f64; LANES]; 3],
    turns: [[f64; LANES]; 3],
    /// Of the grids: `position`, `fine`, `turn`, `linear`, `angular`.
    steps: [[f64; LANES]; 5],
    over: [f64; LANES],
}

/// Steps rounded to whole numbers, as arrays by quantity and then by lane.
struct WholeSteps {
    position: [[f64; LANES]; 3],
    rotation: [[f64; LANES]; 4],
    linear: [[f64; LANES]; 3],
    angular: [[f64; LANES]; 3],
}

impl PredictionX4 {
    /// Predicts all bodies of the batch, hands out the corrected ones, and empties the batch.
    ///
    /// `corrections`: one for each body, in the order of [`Self::take`]; bodies without one are not handed out.
    pub fn correct<'a>(
        &mut self,
        corrections: impl IntoIterator<Item = Option<LaneCorrection<'a>>>,
        mut out: impl FnMut(u32, QuantisedState),
    ) {
        let Some(config) = self.config.take() else {
            return;
        };
        let laid = LaneCorrections::of(corrections.into_iter().take(self.len));
        let whole = laid.onto(&self.predicted(&config));
        for (lane, residual) in laid.residuals.into_iter().enumerate() {
            if let Some(residual) = residual {
                out(self.keys[lane], residual.onto_implied(whole.at(lane)));
            }
        }
        self.len = 0;
    }
}

impl<'a> LaneCorrections<'a> {
    #[inline]
    fn of(corrections: impl Iterator<Item = Option<LaneCorrection<'a>>>) -> Self {
        let mut laid = Self {
            residuals: [None; LANES],
            apart: [[0.0; LANES]; 3],
            turns: [[0.0; LANES]; 3],
            steps: [[1.0; LANES]; 5],
            over: [1.0; LANES],
        };
        for (lane, correction) in corrections.take(LANES).enumerate() {
            let Some(LaneCorrection {
                residual,
                over,
                grid,
            }) = correction
            else {
                continue;
            };
            for axis in 0..3 {
                laid.apart[axis][lane] = f64::from(residual.position[axis]);
                laid.turns[axis][lane] = f64::from(residual.turn[axis]);
            }
            laid.steps[0][lane] = grid.position();
            laid.steps[1][lane] = grid.fine();
            laid.steps[2][lane] = grid.turn();
            laid.steps[3][lane] = grid.linear();
            laid.steps[4][lane] = grid.angular();
            laid.over[lane] = over.seconds();
            laid.residuals[lane] = Some(residual);
        }
        laid
    }

    /// The corrected motions, except that positions are the predicted ones.
    #[inline]
    fn onto(&self, predicted: &MotionX4) -> WholeSteps {
        let step = |quantity: usize| lanes(&self.steps[quantity]);
        let rate = f64x4::splat(1.0) / lanes(&self.over);
        let times = |[x, y, z]: [f64x4; 3], by: f64x4| [x * by, y * by, z * by];
        let turned = times(lanes3(&self.turns), step(2));
        let [x, y, z, w] = if self.turns == [[0.0; LANES]; 3] {
            predicted.rotation
        } else {
            turned_by(turned, predicted.rotation)
        };
        let moved = times(times(lanes3(&self.apart), step(0)), rate);
        let spun = times(turned, rate);
        let on = |value: f64x4, step: f64x4| floor(value / step + 0.5);
        let three = |[x, y, z]: [f64x4; 3], [u, v, w]: [f64x4; 3], step: f64x4| {
            arrays([on(x + u, step), on(y + v, step), on(z + w, step)])
        };
        let [px, py, pz] = predicted.position;
        let part = |part: f64x4| floor(part * PACKED_STEPS + 0.5).to_array();
        WholeSteps {
            position: arrays([on(px, step(1)), on(py, step(1)), on(pz, step(1))]),
            rotation: [part(x), part(y), part(z), part(w)],
            linear: three(predicted.linear, moved, step(3)),
            angular: three(predicted.angular, spun, step(4)),
        }
    }
}

impl WholeSteps {
    #[inline]
    fn at(&self, lane: usize) -> QuantisedState {
        let three = |[x, y, z]: &[[f64; LANES]; 3], limit: i32| {
            let one = |steps: &[f64; LANES]| whole(steps[lane], limit);
            [one(x), one(y), one(z)]
        };
        let [x, y, z, w] = &self.rotation;
        QuantisedState {
            position: three(&self.position, POSITION_LIMIT),
            rotation: PackedRotation::of_whole([x[lane], y[lane], z[lane], w[lane]]),
            linear: three(&self.linear, VELOCITY_LIMIT),
            angular: three(&self.angular, VELOCITY_LIMIT),
        }
    }
}

/// Rotations, each turned by a rotation vector; a zero vector leaves its rotation as it is.
fn turned_by([x, y, z]: [f64x4; 3], rotation: [f64x4; 4]) -> [f64x4; 4] {
    let nothing = f64x4::splat(0.0);
    let angle = (x * x + y * y + z * z).sqrt();
    let (sine, cosine) = sin_cos(angle * 0.5);
    // For an angle of zero the vector is zero too, and is not normalised.
    let none = angle.simd_eq(nothing);
    let k = choose(none, nothing, sine / angle);
    let turned = normalised(product([x * k, y * k, z * k, cosine], rotation));
    let still = x.simd_eq(nothing) & y.simd_eq(nothing) & z.simd_eq(nothing);
    let kept = |place: usize| choose(still, rotation[place], turned[place]);
    [kept(0), kept(1), kept(2), kept(3)]
}
