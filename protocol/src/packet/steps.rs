//! The steps of a settling, in the order in which they are said.
//!
//! One order for who writes, who reads and who counts the cost (PROTOCOL 5.6).

use rhumb_reckoning::Settling;

use super::tables::contexts;

/// Steps of a settling: three of position, three of the smaller parts of a quaternion, one of its greatest.
pub(super) const SETTLED_STEPS: usize = 7;
/// What lengths the first steps of position and of rotation are measured against, and the last: about those of a
/// body of half a metre at 5 cm.
const LENGTHS: [u32; 3] = [14, 19, 1];

/// The steps of a settling in the order in which they are said, each with its context and with the length that its own
/// is measured against: that of the step before, or a fixed one.
pub(super) fn settled(settling: &Settling) -> [(usize, i32, u32); SETTLED_STEPS] {
    let ([x, y, z], [a, b, c]) = (settling.position, settling.others);
    let [first, turned, last] = LENGTHS;
    [
        (contexts::settled(0), x, first),
        (contexts::settled(1), y, length(x)),
        (contexts::settled(1), z, length(y)),
        (contexts::settled(2), a, turned),
        (contexts::settled(3), b, length(a)),
        (contexts::settled(3), c, length(b)),
        (contexts::settled(4), settling.largest, last),
    ]
}

/// Bits of a step, its sign aside.
pub(super) const fn length(step: i32) -> u32 {
    32 - step.unsigned_abs().leading_zeros()
}

pub(super) const fn settled_step(settling: &mut Settling, place: usize) -> &mut i32 {
    match place {
        0..3 => &mut settling.position[place],
        3..6 => &mut settling.others[place - 3],
        _ => &mut settling.largest,
    }
}
