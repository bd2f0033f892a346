//! Seeded random numbers for the cases, and motions as lists.

use glam::{DQuat, DVec3};
use rhumb_reckoning::{Motion, Pose, Twist};

/// SplitMix64: one seed gives the same cases everywhere.
pub(super) struct VectorRng(pub(super) u64);

impl VectorRng {
    pub(super) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// In [-limit, limit).
    pub(super) fn within(&mut self, limit: f64) -> f64 {
        let unit = (self.bits() >> 11) as f64 / (1_u64 << 53) as f64;
        (unit * 2.0 - 1.0) * limit
    }

    pub(super) fn steps(&mut self, limit: i32) -> i32 {
        (self.bits() % (2 * limit as u64 + 1)) as i32 - limit
    }

    pub(super) fn vector(&mut self, limit: f64) -> DVec3 {
        DVec3::from_array(core::array::from_fn(|_| self.within(limit)))
    }

    pub(super) fn rotation(&mut self) -> DQuat {
        let q = DQuat::from_array(core::array::from_fn(|_| self.within(1.0)));
        unit(q)
    }

    pub(super) fn motion(&mut self) -> Motion {
        let pose = Pose {
            position: self.vector(2_000.0),
            rotation: self.rotation(),
        };
        let twist = Twist {
            linear: self.vector(30.0),
            angular: self.vector(20.0),
        };
        motion(pose, twist)
    }
}

pub(super) fn unit(q: DQuat) -> DQuat {
    let [x, y, z, w] = q.to_array();
    let n = libm::sqrt(x * x + y * y + z * z + w * w);
    DQuat::from_xyzw(x / n, y / n, z / n, w / n)
}

pub(super) fn motion(pose: Pose, twist: Twist) -> Motion {
    Motion::new(pose, twist).expect("the cases are finite and of unit length")
}

/// Position, quaternion x, y, z, w, linear and angular velocity.
pub(super) fn thirteen(motion: &Motion) -> [f64; 13] {
    let (p, q) = (
        motion.pose().position.to_array(),
        motion.pose().rotation.to_array(),
    );
    let (v, w) = (
        motion.twist().linear.to_array(),
        motion.twist().angular.to_array(),
    );
    let mut all = [0.0; 13];
    let parts = p.iter().chain(&q).chain(&v).chain(&w);
    for (slot, part) in all.iter_mut().zip(parts) {
        *slot = *part;
    }
    all
}
