//! Poses on a grid, as second differences of whole numbers.
//!
//! A moving body goes on nearly as before, so its second difference is a small number, which takes a byte or two where
//! an exact pose takes 28. Whole numbers give the same result in every language.

use std::collections::BTreeMap;

use rhumb_reckoning::BodyId;

/// Steps of the grid in a metre, and in a unit of a quaternion's components.
pub const STEPS: f64 = 1_048_576.0;
/// Poses further out are not on the grid: whole numbers stay exact in every language's floating-point numbers.
const LIMIT_M: f64 = (1_u64 << 31) as f64;

/// Position and quaternion in steps of the grid.
pub type GridPose = [i64; 7];

/// The last two poses of each body on one topic.
#[derive(Clone, Debug, Default)]
pub struct GridHistory(BTreeMap<BodyId, [GridPose; 2]>);

impl GridHistory {
    /// The point of the grid nearest to a pose; `None` for one that is too far out.
    #[must_use]
    pub fn quantise(position: [f32; 3], rotation: [f32; 4]) -> Option<GridPose> {
        let [px, py, pz] = position.map(f64::from);
        let [qx, qy, qz, qw] = rotation.map(f64::from);
        let parts = [px, py, pz, qx, qy, qz, qw];
        let fits = parts.iter().all(|part| part.abs() < LIMIT_M);
        fits.then(|| parts.map(|part| (part * STEPS + 0.5).floor() as i64))
    }

    /// The residual of a pose: its second difference, which becomes part of the history.
    pub fn encode(&mut self, id: BodyId, pose: GridPose) -> GridPose {
        let predicted = self.predict(id);
        self.note(id, pose);
        std::array::from_fn(|part| pose[part].wrapping_sub(predicted[part]))
    }

    /// The pose of a residual, which becomes part of the history.
    pub fn decode(&mut self, id: BodyId, residual: GridPose) -> GridPose {
        let predicted = self.predict(id);
        let pose = std::array::from_fn(|part| residual[part].wrapping_add(predicted[part]));
        self.note(id, pose);
        pose
    }

    /// Forgets a body, whose next pose is written whole.
    pub fn forget(&mut self, id: BodyId) {
        self.0.remove(&id);
    }

    fn predict(&self, id: BodyId) -> GridPose {
        let Some([last, before]) = self.0.get(&id) else {
            return [0; 7];
        };
        std::array::from_fn(|part| {
            let step = last[part].wrapping_sub(before[part]);
            last[part].wrapping_add(step)
        })
    }

    fn note(&mut self, id: BodyId, pose: GridPose) {
        let last = self.0.get(&id).map_or(pose, |[last, _]| *last);
        self.0.insert(id, [pose, last]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded(
            poses in prop::collection::vec((0_u32..3, prop::array::uniform7(any::<i64>())), 0..40),
        ) {
            let (mut from, mut to) = (GridHistory::default(), GridHistory::default());
            for (index, pose) in poses {
                let id = BodyId::new(index, 0);
                let residual = from.encode(id, pose);
                prop_assert_eq!(to.decode(id, residual), pose);
            }
        }

        #[test]
        fn a_pose_on_the_grid_is_within_half_a_step(
            position in prop::array::uniform3(-1e6_f32..1e6),
        ) {
            let pose = GridHistory::quantise(position, [0.0, 0.0, 0.0, 1.0]).unwrap();
            for (part, exact) in pose.iter().zip(position) {
                let error = *part as f64 / STEPS - f64::from(exact);
                prop_assert!(error.abs() <= 0.5 / STEPS, "{error}");
            }
        }
    }

    #[test]
    fn steady_motion_takes_small_residuals() {
        let (mut history, id) = (GridHistory::default(), BodyId::new(1, 0));
        let pose = |tick: i64| [tick * 1_000, -7 * tick, 0, 0, 0, 0, 1 << 20];
        assert_eq!(history.encode(id, pose(5)), pose(5), "the first is whole");
        history.encode(id, pose(6));
        assert_eq!(history.encode(id, pose(7)), [0; 7]);
    }

    #[test]
    fn a_pose_too_far_out_is_not_on_the_grid() {
        let rotation = [0.0, 0.0, 0.0, 1.0];
        assert!(GridHistory::quantise([3e9, 0.0, 0.0], rotation).is_none());
        assert!(GridHistory::quantise([f32::MAX; 3], rotation).is_none());
        assert!(GridHistory::quantise([2e9, 0.0, 0.0], rotation).is_some());
    }
}
