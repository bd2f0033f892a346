//! Estimates from recorded motion: moments of velocities, inertia of bodies.
//!
//! This project's step moves a body and damps it afterwards, and its velocities hold at the moment of their pose. Other
//! engines damp first, or report the angular velocity that turned the body in the last step: that of half a step before.
//! How poses follow from velocities tells both, and then the velocities of this project's step follow from theirs.
//!
//! A free body keeps its angular momentum, or the share of it that damping leaves. Its moments of inertia are those whose
//! momentum changes least. A spin about a principal axis is that of any moments.
//!
//! The linear algebra that the fits of recordings share is here too: medians, lines, equations, eigenvectors.

use glam::{DMat3, DQuat, DVec3};
use rhumb_reckoning::BodyState;

use super::recorded::{BodyPath, FREE_MIN};

/// The first act of an engine on a body in a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum First {
    /// It is moved by the velocity of the last tick.
    #[default]
    Moved,
    /// Its velocity is damped.
    Damped,
}

/// The moments of a recording's velocities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Instants {
    pub(crate) first: First,
    /// Ticks from the moment of an angular velocity to that of its pose.
    pub(crate) behind: f64,
}

/// Shares of the velocities that stay after a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Kept {
    pub(crate) linear: f64,
    pub(crate) angular: f64,
}

/// Principal moments, and the rotation principal axes → body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Moments {
    pub(crate) moments: [f64; 3],
    pub(crate) axes: DQuat,
}

/// Ticks from a velocity to its pose that say something: from less than half of a substep of eight to half a tick.
const BEHIND: std::ops::RangeInclusive<f64> = 0.04..=0.6;

impl Instants {
    /// True for what this project's step does.
    pub(crate) fn is_own(&self) -> bool {
        *self == Self::default()
    }

    /// Takes the shares of all ticks: of the spin's change up to the mean spin of a tick, (n + 1) / 2n after n substeps.
    pub(crate) fn new(first: First, turns: Vec<f64>) -> Self {
        let behind = median(turns).map_or(0.0, |share| share - 0.5);
        // NaN is in no range.
        let says = BEHIND.contains(&behind.abs());
        Self {
            first,
            behind: if says { behind } else { 0.0 },
        }
    }

    /// The state that this project's step would have.
    pub(crate) fn own(
        &self,
        state: &BodyState,
        kept: Kept,
        moments: Option<Moments>,
        step_s: f64,
    ) -> BodyState {
        let motion = state.motion();
        let (mut linear, mut angular) = (motion.twist().linear, motion.twist().angular);
        if let Some(Moments { moments, axes }) = moments.filter(|_| self.behind != 0.0) {
            let turn = motion.pose().rotation * axes;
            let spin = later(turn.conjugate() * angular, moments, self.behind * step_s);
            angular = turn * spin;
        }
        if self.first == First::Damped {
            linear *= kept.linear.min(1.0);
            angular *= kept.angular.min(1.0);
        }
        let [px, py, pz, x, y, z, w, ..] = state.parts();
        let [linear, angular] = [linear, angular].map(|of| of.as_vec3().to_array());
        BodyState::new([px, py, pz], [x, y, z, w], linear, angular).unwrap_or(*state)
    }
}

/// A spin about principal axes after some time without torque: one step of Runge and Kutta's method.
fn later(spin: DVec3, moments: [f64; 3], time_s: f64) -> DVec3 {
    let moments = DVec3::from_array(moments);
    let change = |spin: DVec3| (moments * spin).cross(spin) / moments;
    let one = change(spin);
    let two = change(spin + one * (time_s / 2.0));
    let three = change(spin + two * (time_s / 2.0));
    let four = change(spin + three * time_s);
    spin + (one + 2.0 * (two + three) + four) * (time_s / 6.0)
}

/// The fall of a body in a tick beside its velocity, as a share of g·t², and the way at the velocity before in the same unit.
pub(crate) struct Fall {
    pub(crate) beside: f64,
    pub(crate) way: f64,
}

/// The share of its way that damping gives a body in a tick, as its falls say: below zero, as it takes it.
pub(crate) fn given(falls: &[Fall]) -> f64 {
    let pairs: Vec<(f64, f64)> = falls.iter().map(|fall| (fall.beside, fall.way)).collect();
    slope(&pairs)
}

/// Damping or the way: which comes first in a tick in which damping takes the share `lost` of the velocity. Of n substeps it takes (n + 1) / 2n of
/// that from the way if it comes first, and (n - 1) / 2n if the way does.
pub(crate) fn first(given: f64, lost: f64) -> First {
    if (given + lost).abs() < given.abs() {
        First::Damped
    } else {
        First::Moved
    }
}

/// Change of a spin in a tick, as a share of it, from which on it tells the moment of the mean one.
const CHANGE_MIN: f64 = 1e-3;

/// The part of a tick's change of spin, damping apart, up to the mean spin by which the body turned in it.
pub(crate) fn turn_share(
    pair: [&BodyState; 2],
    kept: f64,
    first: First,
    step_s: f64,
) -> Option<f64> {
    let [before, after] = pair.map(BodyState::motion);
    let turn = after.pose().rotation * before.pose().rotation.conjugate();
    let mean = turn.to_scaled_axis_short() / step_s;
    let (from, to) = match first {
        First::Moved => (before.twist().angular, after.twist().angular / kept),
        First::Damped => (before.twist().angular * kept, after.twist().angular),
    };
    let change = to - from;
    let tells = change.length() > CHANGE_MIN * from.length();
    tells.then(|| (mean - from).dot(change) / change.length_squared())
}

/// Shares of its angular momentum that a body keeps, by the moments that fit it without damping.
pub(super) fn kept_spins(path: &BodyPath, pairs: &[usize]) -> Vec<f64> {
    // The first moments tell the damping of the spin, and that tells the moments.
    let tensor = moments(path, pairs, 1.0).and_then(SpinMoments::tensor);
    let pairs = pairs.iter();
    pairs
        .filter_map(|frame| kept_momentum(path, *frame, tensor))
        .collect()
}

/// The moments of a body, as far as its spin shows them.
pub(super) enum SpinMoments {
    Equal,
    Unequal([f64; 3], DQuat),
    /// The spin changes as that of no free body does.
    Unexplained,
}

impl SpinMoments {
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
const UNEXPLAINED_MIN: f64 = 1e-8;

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
pub(super) fn moments(path: &BodyPath, pairs: &[usize], kept: f64) -> Option<SpinMoments> {
    let sums = SpinSums::new(path, pairs, kept);
    if pairs.len() < FREE_MIN || sums.spins / (pairs.len() as f64) < 1e-4 {
        return None;
    }
    if keeps_spin(path, pairs) {
        return Some(SpinMoments::Equal);
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
    if of_equal > UNEXPLAINED_MIN && !is_explained {
        return Some(SpinMoments::Unexplained);
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
        return Some(SpinMoments::Equal);
    }
    // No body has a moment beyond the sum of the others.
    (least > 0.0 && 2.0 * greatest <= 1.1).then_some(SpinMoments::Unequal(moments, axes))
}

/// How much worse than equal moments those explain a spin that it contradicts.
const CONTRADICTED: f64 = 10.0;

/// True if a body spins as one of equal moments does, and not as one of these would. A spin about one of their axes is as both.
pub(super) fn contradicts(path: &BodyPath, pairs: &[usize], kept: f64, stated: &Moments) -> bool {
    let axes = DMat3::from_quat(stated.axes);
    let tensor = axes * DMat3::from_diagonal(DVec3::from_array(stated.moments)) * axes.transpose();
    let [x, y, z] = [tensor.x_axis, tensor.y_axis, tensor.z_axis];
    let sums = SpinSums::new(path, pairs, kept);
    let of_stated = sums.share(&[x.x, y.y, z.z, x.y, x.z, y.z]);
    of_stated > UNEXPLAINED_MIN && of_stated > CONTRADICTED * sums.share(&OF_BALL)
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

/// The middle value; of an even number, the upper one of the two.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// The axis times the angle of the shorter way.
pub(crate) trait ShortTurn {
    fn to_scaled_axis_short(self) -> DVec3;
}

impl ShortTurn for DQuat {
    fn to_scaled_axis_short(self) -> DVec3 {
        if self.w < 0.0 { -self } else { self }.to_scaled_axis()
    }
}

/// The slope of the line that fits these values over the second numbers best; zero where those are all one.
pub(crate) fn slope(values: &[(f64, f64)]) -> f64 {
    let count = values.len() as f64;
    let sums = values
        .iter()
        .fold((0.0, 0.0), |(a, b), (x, y)| (a + x, b + y));
    let (mean, middle) = (sums.0 / count, sums.1 / count);
    let spread: f64 = values.iter().map(|(_, at)| (at - middle).powi(2)).sum();
    let product: f64 = values
        .iter()
        .map(|(x, at)| (x - mean) * (at - middle))
        .sum();
    if spread > 0.0 { product / spread } else { 0.0 }
}

/// Solves equations by elimination; `None` if they have no single solution.
pub(crate) fn solve<const N: usize>(
    mut matrix: [[f64; N]; N],
    mut right: [f64; N],
) -> Option<[f64; N]> {
    for column in 0..N {
        let pivot = (column..N).max_by(|a, b| {
            matrix[*a][column]
                .abs()
                .total_cmp(&matrix[*b][column].abs())
        })?;
        if matrix[pivot][column].abs() < 1e-300 {
            return None;
        }
        matrix.swap(column, pivot);
        right.swap(column, pivot);
        for row in column + 1..N {
            let factor = matrix[row][column] / matrix[column][column];
            let above = matrix[column];
            for (cell, above) in matrix[row].iter_mut().zip(above) {
                *cell -= factor * above;
            }
            right[row] -= factor * right[column];
        }
    }
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N)
            .map(|column| matrix[row][column] * right[column])
            .sum();
        right[row] = (right[row] - known) / matrix[row][row];
    }
    right.iter().all(|x| x.is_finite()).then_some(right)
}

/// Sweeps of rotations; symmetric matrices of six rows need some ten.
const SWEEPS: usize = 32;

/// Eigenvalues of a symmetric matrix, and their vectors as columns, by Jacobi's rotations.
fn eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut vectors = [[0.0; N]; N];
    for (place, row) in vectors.iter_mut().enumerate() {
        row[place] = 1.0;
    }
    for _ in 0..SWEEPS {
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let t = if theta == 0.0 { 1.0 } else { t };
                let cos = 1.0 / t.hypot(1.0);
                let sin = t * cos;
                for row in &mut a {
                    (row[p], row[q]) = (cos * row[p] - sin * row[q], sin * row[p] + cos * row[q]);
                }
                let (x, y) = (a[p], a[q]);
                a[p] = std::array::from_fn(|column| cos * x[column] - sin * y[column]);
                a[q] = std::array::from_fn(|column| sin * x[column] + cos * y[column]);
                for row in &mut vectors {
                    (row[p], row[q]) = (cos * row[p] - sin * row[q], sin * row[p] + cos * row[q]);
                }
            }
        }
    }
    (std::array::from_fn(|place| a[place][place]), vectors)
}

/// The eigenvector of the least eigenvalue of a symmetric matrix.
pub(crate) fn least_eigenvector<const N: usize>(matrix: [[f64; N]; N]) -> [f64; N] {
    let (values, vectors) = eigen(matrix);
    let least = (0..N).min_by(|a, b| values[*a].total_cmp(&values[*b]));
    let least = least.unwrap_or_default();
    vectors.map(|row| row[least])
}

/// Principal moments of a tensor, and the rotation principal axes → body.
pub(crate) fn principal_axes(tensor: [[f64; 3]; 3]) -> ([f64; 3], DQuat) {
    let (moments, vectors) = eigen(tensor);
    let column = |place: usize| DVec3::from_array(vectors.map(|row| row[place]));
    let (x, y) = (column(0).normalize(), column(1).normalize());
    let axes = DMat3::from_cols(x, y, x.cross(y));
    (moments, DQuat::from_mat3(&axes).normalize())
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOMENTS: [f64; 3] = [1.0, 2.0, 2.4];

    #[test]
    fn a_spin_later_has_the_same_energy_and_momentum() {
        let spin = DVec3::new(2.0, 3.0, -1.0);
        let of = |spin: DVec3| {
            let momentum = DVec3::from_array(MOMENTS) * spin;
            (momentum.length_squared(), momentum.dot(spin))
        };
        let (a, b) = (of(spin), of(later(spin, MOMENTS, 0.01)));
        assert!(
            (a.0 - b.0).abs() < 1e-7 && (a.1 - b.1).abs() < 1e-7,
            "{a:?} {b:?}"
        );
        let back = later(later(spin, MOMENTS, 0.01), MOMENTS, -0.01);
        assert!((back - spin).length() < 1e-8, "{back}");
    }

    #[test]
    fn a_share_far_from_any_step_and_one_near_the_middle_say_nothing() {
        for share in [0.51, 1.3, -0.3, f64::NAN] {
            assert!(Instants::new(First::Moved, vec![share]).is_own(), "{share}");
        }
        assert_eq!(Instants::new(First::Moved, vec![1.0]).behind, 0.5);
        assert_eq!(Instants::new(First::Moved, vec![0.625]).behind, 0.125);
        assert!(Instants::new(First::Moved, Vec::new()).is_own());
    }

    #[test]
    fn equations_are_solved_and_singular_ones_are_not() {
        let x = solve([[0.0, 2.0], [4.0, 1.0]], [6.0, 7.0]).expect("one solution");
        assert!((x[0] - 1.0).abs() < 1e-12 && (x[1] - 3.0).abs() < 1e-12);
        assert_eq!(solve([[1.0, 2.0], [2.0, 4.0]], [1.0, 2.0]), None);
    }

    #[test]
    fn principal_axes_give_the_tensor_back() {
        let turn = DMat3::from_quat(DQuat::from_rotation_y(0.4) * DQuat::from_rotation_x(1.1));
        let tensor = turn * DMat3::from_diagonal(DVec3::new(1.0, 2.0, 2.5)) * turn.transpose();
        let rows = [0, 1, 2].map(|row| tensor.row(row).to_array());
        let (moments, axes) = principal_axes(rows);
        let axes = DMat3::from_quat(axes);
        let again = axes * DMat3::from_diagonal(DVec3::from_array(moments)) * axes.transpose();
        assert!(again.abs_diff_eq(tensor, 1e-12), "{again}");
        assert_eq!(
            least_eigenvector([[3.0, 0.0], [0.0, 1.0]]).map(f64::abs),
            [0.0, 1.0]
        );
    }
}
