//! Small linear algebra: medians, lines, equations, eigenvectors.
//!
//! The fits of recordings share it. Nothing here knows a body.

use glam::{DMat3, DQuat, DVec3};

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
