//! Cases of packed rotations: ties, halves, and what is refused.

use glam::DQuat;
use rhumb_reckoning::PackedRotation;

use super::rng::{VectorRng, unit};
use crate::document::CaseJson;

pub(super) fn packings(rng: &mut VectorRng) -> Vec<CaseJson> {
    let (half, root) = (0.5, libm::sqrt(0.5));
    let half_step = 0.5 / 524_288.0;
    let rest = libm::sqrt(1.0 - half_step * half_step);
    let mut given: Vec<DQuat> = [
        [0.0, 0.0, 0.0, 1.0],
        [0.0, 0.0, 0.0, -1.0],
        [-0.0, 1.0, 0.0, -0.0],
        [half, half, half, half],
        [-half, half, -half, half],
        [half, -half, -half, -half],
        [root, root, 0.0, 0.0],
        [root, 0.0, 0.0, -root],
        [0.0, -root, 0.0, root],
        // Halves round upward, on either side of zero, and so does the double just below a half.
        [half_step, 0.0, 0.0, rest],
        [-half_step, 0.0, 0.0, rest],
        [half_step.next_down(), 0.0, 0.0, rest],
        [3.0 * half_step, -3.0 * half_step, 0.0, rest],
        [half_step, 0.0, 0.0, -rest],
    ]
    .map(DQuat::from_array)
    .to_vec();
    given.extend((0..20).map(|_| rng.rotation()));
    // Near ties, until a dozen have changed their largest component on the way to a stable form.
    let (mut plain, mut changed) = (0, 0);
    while changed < 12 {
        let q = near_tie(rng);
        let moved = first_largest(q) != PackedRotation::of(q).parts().0;
        if moved || plain < 20 {
            given.push(q);
        }
        changed += u32::from(moved);
        plain += u32::from(!moved);
    }
    given.into_iter().map(packing).collect()
}

/// Two, three or four parts within three steps of each other.
fn near_tie(rng: &mut VectorRng) -> DQuat {
    let alike = 2 + rng.bits() % 3;
    let offset = rng.bits() % 4;
    let parts = core::array::from_fn(|i| {
        let near = if (i as u64 + offset) % 4 < alike {
            1.0
        } else {
            0.3
        };
        let sign = if rng.bits().is_multiple_of(2) {
            1.0
        } else {
            -1.0
        };
        sign * (near + rng.within(3.0 / 524_288.0))
    });
    unit(DQuat::from_array(parts))
}

fn first_largest(q: DQuat) -> u8 {
    let steps = q
        .to_array()
        .map(|part| libm::floor(part * 524_288.0 + 0.5).abs());
    let mut largest = 0;
    for i in 1..4 {
        if steps[i] > steps[largest] {
            largest = i;
        }
    }
    largest as u8
}

fn packing(q: DQuat) -> CaseJson {
    let packed = PackedRotation::of(q);
    let (largest, others) = packed.parts();
    CaseJson::new()
        .doubles("rotation", &q.to_array())
        .integer("largest", largest)
        .integers("others", &others)
        .doubles("value", &packed.value().to_array())
}

/// Parts as a decoder reads them: accepted, or refused because they are not the one encoding of a rotation.
pub(super) fn unpackings(rng: &mut VectorRng) -> Vec<CaseJson> {
    let limit = PackedRotation::LIMIT;
    let mut given = vec![
        (3, [0, 0, 0]),
        (4, [0, 0, 0]),
        (255, [0, 0, 0]),
        (0, [limit, limit, limit]),
        (0, [limit + 1, 0, 0]),
        (0, [0, -limit - 1, 0]),
        (0, [i32::MIN, 0, 0]),
        (0, [i32::MAX, 0, 0]),
        // One over the root of two: of tied components the first one is the largest.
        (0, [limit, 0, 0]),
        (1, [limit, 0, 0]),
        (0, [limit - 1, 0, 0]),
        (1, [limit - 1, 0, 0]),
        (0, [-limit, 0, 0]),
        (1, [-limit, 0, 0]),
        (3, [0, 0, limit]),
        // Four equal parts.
        (0, [262_144, 262_144, 262_144]),
        (1, [262_144, 262_144, 262_144]),
        (3, [-262_144, 262_144, -262_144]),
        (0, [262_145, 262_144, 262_144]),
        (1, [262_144, 262_143, 262_144]),
    ];
    given.extend((0..20).map(|_| {
        let largest = (rng.bits() % 4) as u8;
        (largest, core::array::from_fn(|_| rng.steps(limit * 3 / 4)))
    }));
    let case = |(largest, others): (u8, [i32; 3])| {
        let case = CaseJson::new()
            .integer("largest", largest)
            .integers("others", &others);
        match PackedRotation::from_parts(largest, others) {
            Some(packed) => case.doubles("value", &packed.value().to_array()),
            None => case.nothing("value"),
        }
    };
    given.into_iter().map(case).collect()
}
