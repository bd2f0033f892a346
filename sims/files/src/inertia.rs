//! Poses, and the mass of solids with its centre and tensor.
//!
//! All in f64, metres and kilograms. Invariant: a tensor is symmetric, and about the centre of its mass.

use glam::{DMat3, DQuat, DVec3};

/// A pose: rotation, then displacement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Pose {
    pub(crate) position: DVec3,
    pub(crate) rotation: DQuat,
}

impl Pose {
    pub(crate) const IDENTITY: Self = Self {
        position: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };

    pub(crate) const fn new(position: DVec3, rotation: DQuat) -> Self {
        Self { position, rotation }
    }

    /// A displacement alone.
    pub(crate) const fn at(position: DVec3) -> Self {
        Self::new(position, DQuat::IDENTITY)
    }

    /// The pose of what has this pose in the axes of `self`.
    pub(crate) fn of(&self, inner: &Self) -> Self {
        Self {
            position: self.point(inner.position),
            rotation: (self.rotation * inner.rotation).normalize(),
        }
    }

    /// A point of its axes, in the axes of the frame around it.
    pub(crate) fn point(&self, point: DVec3) -> DVec3 {
        self.position + self.rotation * point
    }

    pub(crate) fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            position: rotation * -self.position,
            rotation,
        }
    }
}

/// A rotation that turns x to a direction of unit length.
pub(crate) fn along_x(along: DVec3) -> DQuat {
    match along.x < -0.999_999 {
        true => DQuat::from_rotation_y(std::f64::consts::PI),
        false => DQuat::from_rotation_arc(DVec3::X, along).normalize(),
    }
}

/// Mass, its centre, and the tensor about the centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inertia {
    pub(crate) mass: f64,
    pub(crate) centre: DVec3,
    pub(crate) tensor: DMat3,
}

impl Inertia {
    pub(crate) const NONE: Self = Self {
        mass: 0.0,
        centre: DVec3::ZERO,
        tensor: DMat3::ZERO,
    };

    /// Moments about the axes through the origin.
    pub(crate) fn diagonal(mass: f64, moments: DVec3) -> Self {
        Self {
            mass,
            centre: DVec3::ZERO,
            tensor: DMat3::from_diagonal(moments),
        }
    }

    /// The same in axes in which its own have this pose.
    pub(crate) fn moved(&self, pose: &Pose) -> Self {
        let turn = DMat3::from_quat(pose.rotation);
        Self {
            mass: self.mass,
            centre: pose.point(self.centre),
            tensor: turn * self.tensor * turn.transpose(),
        }
    }

    /// Both together.
    pub(crate) fn plus(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        if mass <= 0.0 {
            let tensor = self.tensor + other.tensor;
            return Self { tensor, ..*self };
        }
        let centre = (self.centre * self.mass + other.centre * other.mass) / mass;
        Self {
            mass,
            centre,
            tensor: self.about(centre) + other.about(centre),
        }
    }

    /// A multiple of it.
    pub(crate) fn times(&self, factor: f64) -> Self {
        Self {
            mass: self.mass * factor,
            centre: self.centre,
            tensor: self.tensor * factor,
        }
    }

    /// The tensor about another point (Steiner).
    pub(crate) fn about(&self, point: DVec3) -> DMat3 {
        let arm = self.centre - point;
        let outer = DMat3::from_cols(arm * arm.x, arm * arm.y, arm * arm.z);
        let squared = DMat3::from_diagonal(DVec3::splat(arm.length_squared()));
        self.tensor + (squared - outer) * self.mass
    }

    /// The moment about an axis of unit length through a point.
    pub(crate) fn about_axis(&self, point: DVec3, axis: DVec3) -> f64 {
        axis.dot(self.about(point) * axis)
    }

    /// Moments about the principal axes, and these axes: principal → own. The axes are the own ones, as near as may be.
    pub(crate) fn principal(&self) -> (DVec3, DQuat) {
        let (moments, axes) = eigen(self.tensor);
        if axes == DMat3::IDENTITY {
            return (moments, DQuat::IDENTITY);
        }
        let (moments, axes) = nearest_order(moments, axes);
        (moments, DQuat::from_mat3(&axes).normalize())
    }
}

/// Products of inertia below this share of the largest moment are rounding of the file.
const PRODUCT_MIN: f64 = 1e-9;

/// Eigenvalues and vectors of a symmetric matrix, by Jacobi's rotations.
fn eigen(mut matrix: DMat3) -> (DVec3, DMat3) {
    let scale = matrix
        .to_cols_array()
        .iter()
        .fold(0.0_f64, |most, one| most.max(one.abs()));
    let mut vectors = DMat3::IDENTITY;
    // Each sweep squares what is left; ten are far more than f64 needs.
    for _ in 0..10 {
        let mut is_done = true;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = matrix.col(q)[p];
            if off.abs() <= scale * PRODUCT_MIN {
                continue;
            }
            is_done = false;
            let theta = (matrix.col(q)[q] - matrix.col(p)[p]) / (2.0 * off);
            let t = theta.signum() / (theta.abs() + libm::sqrt(theta * theta + 1.0));
            let c = 1.0 / libm::sqrt(t * t + 1.0);
            let s = t * c;
            let mut turn = DMat3::IDENTITY;
            turn.col_mut(p)[p] = c;
            turn.col_mut(q)[q] = c;
            turn.col_mut(q)[p] = s;
            turn.col_mut(p)[q] = -s;
            matrix = turn.transpose() * matrix * turn;
            vectors *= turn;
        }
        if is_done {
            break;
        }
    }
    let moments = DVec3::new(matrix.x_axis.x, matrix.y_axis.y, matrix.z_axis.z);
    (moments, vectors)
}

/// The order and signs of the axes for which they turn least.
fn nearest_order(moments: DVec3, axes: DMat3) -> (DVec3, DMat3) {
    let orders = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    let fit = |order: &[usize; 3]| (0..3).map(|to| axes.col(order[to])[to].abs()).sum::<f64>();
    let best = orders.iter().max_by(|a, b| fit(a).total_cmp(&fit(b)));
    let order = best.copied().unwrap_or([0, 1, 2]);
    let upright = |to: usize| {
        let axis = axes.col(order[to]);
        if axis[to] < 0.0 { -axis } else { axis }
    };
    let (x, y) = (upright(0), upright(1));
    // The third follows from the others, so that the axes are right-handed.
    let turned = DMat3::from_cols(x, y, x.cross(y));
    (
        DVec3::new(moments[order[0]], moments[order[1]], moments[order[2]]),
        turned,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn principal_axes_give_the_tensor_back() {
        let turn = DQuat::from_scaled_axis(DVec3::new(0.4, -1.1, 2.0));
        let own = Inertia::diagonal(3.0, DVec3::new(0.1, 0.7, 0.75));
        let turned = own.moved(&Pose::new(DVec3::ZERO, turn));
        let (moments, axes) = turned.principal();
        let back = Inertia::diagonal(3.0, moments).moved(&Pose::new(DVec3::ZERO, axes));
        let largest = (back.tensor - turned.tensor).to_cols_array();
        assert!(largest.iter().all(|one| one.abs() < 1e-9), "{largest:?}");
        assert!((DMat3::from_quat(axes).determinant() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_diagonal_tensor_keeps_its_axes() {
        let own = Inertia::diagonal(1.0, DVec3::new(3.0, 1.0, 2.0));
        assert_eq!(
            own.principal(),
            (DVec3::new(3.0, 1.0, 2.0), DQuat::IDENTITY)
        );
    }

    #[test]
    fn two_halves_of_a_box_weigh_as_the_box() {
        let cube = |half: DVec3| {
            let mass = 8.0 * half.element_product();
            let squared = half * half;
            let sum = DVec3::splat(squared.element_sum()) - squared;
            Inertia::diagonal(mass, sum * (mass / 3.0))
        };
        let half = cube(DVec3::new(0.5, 1.0, 2.0));
        let left = half.moved(&Pose::at(DVec3::new(-0.5, 0.0, 0.0)));
        let right = half.moved(&Pose::at(DVec3::new(0.5, 0.0, 0.0)));
        let whole = cube(DVec3::new(1.0, 1.0, 2.0));
        let sum = left.plus(&right);
        assert!((sum.mass - whole.mass).abs() < 1e-12 && sum.centre.length() < 1e-12);
        let off = (sum.tensor - whole.tensor).to_cols_array();
        assert!(off.iter().all(|one| one.abs() < 1e-9));
    }
}
