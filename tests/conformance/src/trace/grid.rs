//! Reads poses on the grid of a trace: second differences of whole steps.

use std::collections::BTreeMap;

use super::messages::{Columns, Steps, pose, steps};

/// A body, by index and generation.
pub(super) type Body = (u32, u32);
/// Position, then rotation.
pub(super) type Pose = [f32; 7];

/// Steps of the grid in a metre, and in a unit of a quaternion's components.
const STEPS: f64 = 1_048_576.0;

/// The last two poses of each body on a topic, in steps.
#[derive(Debug, Default)]
pub(super) struct GridReader(BTreeMap<Body, [[i64; 7]; 2]>);

impl GridReader {
    /// The pose at an index of a message: exact, or by its residual. `None` if the columns have none there.
    pub(super) fn pose(
        &mut self,
        body: Body,
        exact: &Columns<'_>,
        residuals: &Steps<'_>,
        place: usize,
    ) -> Option<Pose> {
        if let Some(pose) = pose(exact, place) {
            self.0.remove(&body);
            return Some(pose);
        }
        let residual = steps(residuals, place)?;
        let predicted = match self.0.get(&body) {
            Some([last, before]) => sum(*last, sum(*last, before.map(i64::wrapping_neg))),
            None => [0; 7],
        };
        let now = sum(residual, predicted);
        let last = self.0.get(&body).map_or(now, |[last, _]| *last);
        self.0.insert(body, [now, last]);
        Some(now.map(metres))
    }
}

/// The pose of a copy whose residual is a difference from the truth.
pub(super) fn beside(truth: &Pose, residuals: &Steps<'_>, place: usize) -> Option<Pose> {
    let residual = steps(residuals, place)?;
    if residual == [0; 7] {
        return Some(*truth);
    }
    let real = truth.map(|part| (f64::from(part) * STEPS + 0.5).floor() as i64);
    Some(sum(real, residual).map(metres))
}

fn sum(a: [i64; 7], b: [i64; 7]) -> [i64; 7] {
    std::array::from_fn(|part| a[part].wrapping_add(b[part]))
}

fn metres(steps: i64) -> f32 {
    (steps as f64 / STEPS) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_EXACT: Columns<'static> = [&[]; 7];

    #[test]
    fn residuals_are_second_differences() {
        let mut reader = GridReader::default();
        let mut read = |x: &[i64]| {
            let residuals: Steps<'_> = [x, &[0], &[0], &[0], &[0], &[0], &[0]];
            reader
                .pose((1, 0), &NO_EXACT, &residuals, 0)
                .map(|pose| pose[0])
        };
        assert_eq!(read(&[1 << 20]), Some(1.0));
        assert_eq!(read(&[1 << 20]), Some(2.0));
        assert_eq!(read(&[0]), Some(3.0), "it continues");
        assert!(read(&[i64::MIN]).is_some());
        assert_eq!(read(&[]), None);
    }

    #[test]
    fn an_exact_pose_begins_anew() {
        let mut reader = GridReader::default();
        let one: Steps<'_> = [&[1 << 20]; 7];
        reader.pose((1, 0), &NO_EXACT, &one, 0);
        let exact: Columns<'_> = [&[5.0]; 7];
        assert_eq!(reader.pose((1, 0), &exact, &[&[]; 7], 0), Some([5.0; 7]));
        let pose = reader.pose((1, 0), &NO_EXACT, &one, 0);
        assert_eq!(pose, Some([1.0; 7]), "the history was removed");
    }

    #[test]
    fn no_difference_is_the_truth_itself() {
        let truth = [0.1, 1e-9, 7.0, 0.0, 0.0, 0.0, 1.0];
        assert_eq!(beside(&truth, &[&[0]; 7], 0), Some(truth));
        let moved = beside(&truth, &[&[1 << 20]; 7], 0).unwrap();
        assert!((moved[2] - 8.0).abs() < 1e-6);
    }
}
