//! Four corrected predictions side by side, to the bits of one by one.
//!
//! Each lane does what [`Residual::onto`] does, operation by operation.

use wide::f64x4;

use super::{LANES, Quartet, arrays, choose, floor, lanes, lanes3, normalised, product, sin_cos};
use crate::lattice::{Grid, POSITION_LIMIT, Residual, Snapped, VELOCITY_LIMIT, whole};
use crate::packed::{PACKED_STEPS, PackedRotation};
use crate::units::Seconds;

/// What is said of a body's prediction.
#[derive(Clone, Copy, Debug)]
pub struct Correcting<'a> {
    /// The correction.
    pub residual: &'a Residual,
    /// The time in which the prediction went astray, more than nothing.
    pub over: Seconds,
    /// Of the body.
    pub grid: &'a Grid,
}

impl Quartet {
    /// Predicts all that it took, hands out what corrections make of them, and is empty.
    ///
    /// `corrections`: of the bodies in the order in which they were taken; of one without, nothing is handed out.
    pub fn correct<'a>(
        &mut self,
        corrections: impl IntoIterator<Item = Option<Correcting<'a>>>,
        mut out: impl FnMut(u32, Snapped),
    ) {
        let Some(terms) = self.terms.take() else {
            return;
        };
        let mut said: [Option<&Residual>; LANES] = [None; LANES];
        // By quantity, and by lane.
        let (mut apart, mut turns) = ([[0.0; LANES]; 3], [[0.0; LANES]; 3]);
        let (mut steps, mut over) = ([[1.0; LANES]; 5], [1.0; LANES]);
        for (lane, correction) in corrections.into_iter().take(self.len).enumerate() {
            let Some(Correcting {
                residual,
                over: time,
                grid,
            }) = correction
            else {
                continue;
            };
            for axis in 0..3 {
                apart[axis][lane] = f64::from(residual.position[axis]);
                turns[axis][lane] = f64::from(residual.turn[axis]);
            }
            let of_grid = [
                grid.position(),
                grid.fine(),
                grid.turn(),
                grid.linear(),
                grid.angular(),
            ];
            for (steps, step) in steps.iter_mut().zip(of_grid) {
                steps[lane] = step;
            }
            over[lane] = time.seconds();
            said[lane] = Some(residual);
        }
        let predicted = self.predicted(&terms);
        let [position, fine, turn, linear, angular] = [
            lanes(&steps[0]),
            lanes(&steps[1]),
            lanes(&steps[2]),
            lanes(&steps[3]),
            lanes(&steps[4]),
        ];
        let rate = f64x4::splat(1.0) / lanes(&over);
        let [x, y, z] = lanes3(&turns);
        let turned = [x * turn, y * turn, z * turn];
        let rotation = if turns == [[0.0; LANES]; 3] {
            predicted.rotation
        } else {
            turned_by(turned, predicted.rotation)
        };
        let [x, y, z] = lanes3(&apart);
        let moved = [
            (x * position) * rate,
            (y * position) * rate,
            (z * position) * rate,
        ];
        let [x, y, z] = turned;
        let spun = [x * rate, y * rate, z * rate];
        let on = |value: f64x4, step: f64x4| floor(value / step + 0.5);
        let three = |value: [f64x4; 3], by: [f64x4; 3], step: f64x4| {
            let one = |axis: usize| on(value[axis] + by[axis], step);
            arrays([one(0), one(1), one(2)])
        };
        let [x, y, z] = predicted.position;
        let position = arrays([on(x, fine), on(y, fine), on(z, fine)]);
        let linear = three(predicted.linear, moved, linear);
        let angular = three(predicted.angular, spun, angular);
        let part = |part: f64x4| floor(part * PACKED_STEPS + 0.5).to_array();
        let rotation = [
            part(rotation[0]),
            part(rotation[1]),
            part(rotation[2]),
            part(rotation[3]),
        ];
        for (lane, residual) in said.into_iter().enumerate() {
            let Some(residual) = residual else { continue };
            let at = |of: &[[f64; LANES]; 3], limit: i32| {
                [
                    whole(of[0][lane], limit),
                    whole(of[1][lane], limit),
                    whole(of[2][lane], limit),
                ]
            };
            let [x, y, z, w] = &rotation;
            let from = Snapped {
                position: at(&position, POSITION_LIMIT),
                rotation: PackedRotation::of_whole([x[lane], y[lane], z[lane], w[lane]]),
                linear: at(&linear, VELOCITY_LIMIT),
                angular: at(&angular, VELOCITY_LIMIT),
            };
            out(self.keys[lane], residual.onto_implied(from));
        }
        self.len = 0;
    }
}

/// Rotations, each turned by a rotation vector; one of nothing leaves its rotation as it is.
fn turned_by([x, y, z]: [f64x4; 3], rotation: [f64x4; 4]) -> [f64x4; 4] {
    let nothing = f64x4::splat(0.0);
    let angle = (x * x + y * y + z * z).sqrt();
    let (sine, cosine) = sin_cos(angle * 0.5);
    // An angle so small that it is none has a vector that is none to multiply by.
    let none = angle.simd_eq(nothing);
    let k = choose(none, nothing, sine / angle);
    let turned = normalised(product([x * k, y * k, z * k, cosine], rotation));
    let still = x.simd_eq(nothing) & y.simd_eq(nothing) & z.simd_eq(nothing);
    let kept = |place: usize| choose(still, rotation[place], turned[place]);
    [kept(0), kept(1), kept(2), kept(3)]
}
