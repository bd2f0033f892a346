//! Percentiles by nearest rank.
//!
//! Never interpolated: every quantile is a measured value, so all readers compute the same one.

/// Index of a percentile among `count` sorted values, counted from 0: the least whose share reaches it.
pub fn rank(percent: u32, count: usize) -> Option<usize> {
    let place = (count as u64 * u64::from(percent)).div_ceil(100).max(1);
    (count > 0).then(|| place as usize - 1)
}

/// A percentile of unsorted values; reorders them.
pub fn of_nanoseconds(values: &mut [u64], percent: u32) -> Option<u64> {
    let place = rank(percent, values.len())?;
    Some(*values.select_nth_unstable(place).1)
}

/// Values of at least zero; zeros are only counted, not stored.
#[derive(Debug, Default)]
pub struct WithZeros {
    values: Vec<f32>,
    zeros: u64,
}

impl WithZeros {
    /// Adds values and a count of zeros.
    pub fn extend(&mut self, values: &[f32], zeros: u32) {
        self.values.extend_from_slice(values);
        self.zeros += u64::from(zeros);
    }

    /// Number of values, zeros included.
    pub fn count(&self) -> u64 {
        self.values.len() as u64 + self.zeros
    }

    /// A percentile, or `None` without values.
    pub fn percentile(&mut self, percent: u32) -> Option<f64> {
        let place = rank(percent, self.count() as usize)? as u64;
        let Some(place) = place.checked_sub(self.zeros) else {
            return Some(0.0);
        };
        let (_, value, _) = self
            .values
            .select_nth_unstable_by(place as usize, f32::total_cmp);
        Some(f64::from(*value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_percentile_is_one_of_the_values() {
        let mut hundred: Vec<u64> = (1..=100).rev().collect();
        for (percent, value) in [(0, 1), (50, 50), (99, 99), (100, 100)] {
            assert_eq!(of_nanoseconds(&mut hundred, percent), Some(value));
        }
        assert_eq!(of_nanoseconds(&mut [7], 99), Some(7));
        assert_eq!(of_nanoseconds(&mut [], 50), None);
    }

    #[test]
    fn zeros_count_without_being_stored() {
        let mut errors = WithZeros::default();
        assert_eq!(errors.percentile(50), None);
        errors.extend(&[0.5, 0.25], 2);
        assert_eq!(errors.count(), 4);
        assert_eq!(errors.percentile(50), Some(0.0));
        assert_eq!(errors.percentile(75), Some(0.25));
        assert_eq!(errors.percentile(100), Some(0.5));
    }
}
