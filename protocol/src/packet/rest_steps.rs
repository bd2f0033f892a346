//! The steps of a rest correction, in the order on the wire.
//!
//! Writer, reader and cost model share this one order (PROTOCOL 5.6).

use rhumb_reckoning::RestCorrection;

use super::tables::contexts;

/// Steps of a rest correction: three of position, three of the smaller parts of a quaternion, one of its greatest.
pub(super) const REST_STEPS: usize = 7;
/// Expected bit lengths of the first position step, the first rotation step and the last step: about those of a body of
/// half a metre at 5 cm.
const LENGTHS: [u32; 3] = [14, 19, 1];

/// The steps of a rest correction in the order on the wire, each with its context and its expected bit length: that of
/// the step before, or a fixed one.
pub(super) fn resting(rest_correction: &RestCorrection) -> [(usize, i32, u32); REST_STEPS] {
    let ([x, y, z], [a, b, c]) = (rest_correction.position, rest_correction.others);
    let [first, turned, last] = LENGTHS;
    [
        (contexts::resting(0), x, first),
        (contexts::resting(1), y, length(x)),
        (contexts::resting(1), z, length(y)),
        (contexts::resting(2), a, turned),
        (contexts::resting(3), b, length(a)),
        (contexts::resting(3), c, length(b)),
        (contexts::resting(4), rest_correction.largest, last),
    ]
}

/// The bit length of a step without its sign.
pub(super) const fn length(step: i32) -> u32 {
    32 - step.unsigned_abs().leading_zeros()
}

pub(super) const fn rest_step(rest_correction: &mut RestCorrection, place: usize) -> &mut i32 {
    match place {
        0..3 => &mut rest_correction.position[place],
        3..6 => &mut rest_correction.others[place - 3],
        _ => &mut rest_correction.largest,
    }
}
