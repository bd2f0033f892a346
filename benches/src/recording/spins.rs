//! Moments of inertia of a free body, from its spin.
//!
//! A free body keeps its angular momentum, or the share of it that damping leaves. The moments are those whose momentum changes
//! least. A spin about a principal axis is that of any moments.

use glam::{DMat3, DQuat, DVec3};
use rhumb_reckoning::BodyState;

use super::algebra::{least_eigenvector, principal_axes};
use super::instants::Moments as Stated;
use super::recorded::{BodyPath, FREE_MIN};

/// Shares of its angular momentum that a body keeps, by the moments that fit it without damping.
pub(super) fn kept_spins(path: &BodyPath, pairs: &[usize]) -> Vec<f64> {
    // The first moments tell the damping of the spin, and that tells the moments.
    let tensor = moments(path, pairs, 1.0).and_then(Moments::tensor);
    let pairs = pairs.iter();
    pairs
        .filter_map(|frame| kept_momentum(path, *frame, tensor))
        .collect()
}

/// The moments of a body, as far as its spin shows them.
pub(super) enum Moments {
    Equal,
    Unequal([f64; 3], DQuat),
    /// The spin changes as that of no free body does.
    Unexplained,
}

impl Moments {
    pub(super) const fn tensor(self) -> Option<([f64; 3], DQuat)> {
        match self {
            Self::Equal | Self::Unexplained => None,
            Self::Unequal(moments, axes) => Some((moments, axes)),
        }
    }
}

/// Moments that differ by less than this share count as equal.
const EQUAL_SHARE: f64 = 0.01;

/// Change of a spin in a frame, as a share of it, that is the rounding of an engine in single precision.
const KEPT_SPIN: f64 = 1e-5;

/// Square of the change of a spin in a frame, as a share of it, that moments need not explain.
const CHANGE_MIN: f64 = 1e-8;

/// Part of that change that moments may leave unexplained: integrators keep momentum within far less.
const UNEXPLAINED_MOST: f64 = 0.1;

/// Adds the products of each two numbers of a row.
fn add_products(to: &mut [[f64; 6]; 6], row: &[f64; 6]) {
    for (line, of) in to.iter_mut().zip(row) {
        for (cell, with) in line.iter_mut().zip(row) {
            *cell += of * with;
        }
    }
}

/// The square of a tensor's momentum, or of its change, by the sums of their products.
fn quadratic(matrix: &[[f64; 6]; 6], tensor: &[f64; 6]) -> f64 {
    let rows = matrix.iter().zip(tensor);
    rows.map(|(row, of)| of * row.iter().zip(tensor).map(|(a, b)| a * b).sum::<f64>())
        .sum()
}

/// Sums over the frames of a body's spin, by the parts of a tensor: xx, yy, zz, xy, xz, yz.
struct SpinSums {
    /// Of the change of momentum in a frame.
    change: [[f64; 6]; 6],
    /// Of the momentum.
    whole: [[f64; 6]; 6],
    /// Of the squares of spins.
    spins: f64,
}

impl SpinSums {
    /// Takes frames in each of which a body keeps this share of its angular momentum.
    fn new(path: &BodyPath, pairs: &[usize], kept: f64) -> Self {
        let mut sums = Self {
            change: [[0.0; 6]; 6],
            whole: [[0.0; 6]; 6],
            spins: 0.0,
        };
        for frame in pairs {
            let [a, b] = [*frame, frame + 1].map(|frame| momentum_rows(&path.states[frame]));
            for axis in 0..3 {
                let before = a.map(|part| part[axis]);
                let row: [f64; 6] = std::array::from_fn(|part| b[part][axis] - kept * before[part]);
                add_products(&mut sums.change, &row);
                add_products(&mut sums.whole, &before);
            }
            let spin = path.states[*frame].motion().twist().angular;
            sums.spins += spin.length_squared();
        }
        sums
    }

    /// The square of the change of a tensor's momentum, as a share of its own.
    fn share(&self, tensor: &[f64; 6]) -> f64 {
        quadratic(&self.change, tensor) / quadratic(&self.whole, tensor)
    }
}

/// The tensor of a ball.
const OF_BALL: [f64; 6] = [1.0, 1.0, 1.0, 0.0, 0.0, 0.0];

/// The moments of inertia with which a body keeps this share of its angular momentum in a frame.
pub(super) fn moments(path: &BodyPath, pairs: &[usize], kept: f64) -> Option<Moments> {
    let sums = SpinSums::new(path, pairs, kept);
    if pairs.len() < FREE_MIN || sums.spins / (pairs.len() as f64) < 1e-4 {
        return None;
    }
    if keeps_spin(path, pairs) {
        return Some(Moments::Equal);
    }
    let of_equal = sums.share(&OF_BALL);
    // Moments that the spin does not tell are taken as equal.
    let pull = 1e-9 * sums.spins;
    let mut matrix = sums.change;
    for (i, line) in matrix.iter_mut().enumerate() {
        for (j, cell) in line.iter_mut().enumerate() {
            let same = f64::from(u8::from(i == j));
            let mean = if i < 3 && j < 3 { 1.0 / 3.0 } else { 0.0 };
            *cell += pull * (same - mean);
        }
    }
    let tensor = least_eigenvector(matrix);
    // A spin along one axis says nothing of the others: its tensor has no momentum, and NaN explains nothing.
    let is_explained = sums.share(&tensor) <= UNEXPLAINED_MOST * of_equal;
    if of_equal > CHANGE_MIN && !is_explained {
        return Some(Moments::Unexplained);
    }
    let [xx, yy, zz, xy, xz, yz] = tensor;
    let trace = xx + yy + zz;
    if trace.abs() < 1e-9 {
        return None;
    }
    let tensor = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]].map(|row| row.map(|part| part / trace));
    let (moments, axes) = principal_axes(tensor);
    let greatest = moments.into_iter().fold(f64::MIN, f64::max);
    let least = moments.into_iter().fold(f64::MAX, f64::min);
    if greatest - least <= EQUAL_SHARE * greatest {
        return Some(Moments::Equal);
    }
    // No body has a moment beyond the sum of the others.
    (least > 0.0 && 2.0 * greatest <= 1.1).then_some(Moments::Unequal(moments, axes))
}

/// How much worse than equal moments those explain a spin that it contradicts.
const CONTRADICTED: f64 = 10.0;

/// True if a body spins as one of equal moments does, and not as one of these would. A spin about one of their axes is as both.
pub(super) fn contradicts(path: &BodyPath, pairs: &[usize], kept: f64, stated: &Stated) -> bool {
    let axes = DMat3::from_quat(stated.axes);
    let tensor = axes * DMat3::from_diagonal(DVec3::from_array(stated.moments)) * axes.transpose();
    let [x, y, z] = [tensor.x_axis, tensor.y_axis, tensor.z_axis];
    let sums = SpinSums::new(path, pairs, kept);
    let of_stated = sums.share(&[x.x, y.y, z.z, x.y, x.z, y.z]);
    of_stated > CHANGE_MIN && of_stated > CONTRADICTED * sums.share(&OF_BALL)
}

/// True for a spin about one axis of the world, but for rounding: any moments would do.
fn keeps_spin(path: &BodyPath, pairs: &[usize]) -> bool {
    let spin = |frame: usize| path.states[frame].motion().twist().angular;
    let (mut before, mut both, mut after) = (0.0, 0.0, 0.0);
    for frame in pairs {
        let [a, b] = [spin(*frame), spin(frame + 1)];
        before += a.length_squared();
        both += a.dot(b);
        after += b.length_squared();
    }
    // The second spins without their best share of the first ones.
    after - both * both / before <= KEPT_SPIN * KEPT_SPIN * before
}

/// Angular momentum in the world for each part of a tensor: xx, yy, zz, xy, xz, yz.
fn momentum_rows(state: &BodyState) -> [DVec3; 6] {
    let turn = state.motion().pose().rotation;
    let w = turn.conjugate() * state.motion().twist().angular;
    let parts = [
        DVec3::new(w.x, 0.0, 0.0),
        DVec3::new(0.0, w.y, 0.0),
        DVec3::new(0.0, 0.0, w.z),
        DVec3::new(w.y, w.x, 0.0),
        DVec3::new(w.z, 0.0, w.x),
        DVec3::new(0.0, w.z, w.y),
    ];
    parts.map(|part| turn * part)
}

/// The share of its angular momentum that a body keeps in a frame.
pub(super) fn kept_momentum(
    path: &BodyPath,
    frame: usize,
    tensor: Option<([f64; 3], DQuat)>,
) -> Option<f64> {
    let momentum = |frame: usize| {
        let state = &path.states[frame];
        let (moments, axes) = tensor.unwrap_or(([1.0; 3], DQuat::IDENTITY));
        let turn = state.motion().pose().rotation * axes;
        let spin = turn.conjugate() * state.motion().twist().angular;
        (spin * DVec3::from_array(moments)).length()
    };
    let before = momentum(frame);
    (before > 1e-3).then(|| momentum(frame + 1) / before)
}
