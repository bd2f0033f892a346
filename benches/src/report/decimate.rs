//! Reduces a curve to about as many points as a screen has columns.
//!
//! Keeps the minimum and maximum of each column, so no peak is lost.

/// Largest number of points of a curve.
pub(super) const POINTS_MAX: usize = 900;

/// A short curve unchanged; otherwise the lowest and highest point of each column, in order.
pub(super) fn decimate(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    if points.len() <= POINTS_MAX {
        return points;
    }
    let columns = POINTS_MAX / 2;
    let mut kept = Vec::with_capacity(POINTS_MAX);
    for column in 0..columns {
        let (from, to) = (
            column * points.len() / columns,
            (column + 1) * points.len() / columns,
        );
        let part = &points[from..to];
        let by_height = |a: &&(f64, f64), b: &&(f64, f64)| a.1.total_cmp(&b.1);
        let ends = part
            .iter()
            .min_by(by_height)
            .zip(part.iter().max_by(by_height));
        if let Some((low, high)) = ends {
            let (first, second) = if low.0 <= high.0 {
                (low, high)
            } else {
                (high, low)
            };
            kept.push(*first);
            if first != second {
                kept.push(*second);
            }
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimation_keeps_every_peak() {
        let flat = (0..100_000).map(|x| (f64::from(x), f64::from(x % 3)));
        let mut points: Vec<_> = flat.collect();
        points[54_321].1 = 99.0;
        points[12_345].1 = -99.0;
        let kept = decimate(points.clone());
        assert!(kept.len() <= POINTS_MAX);
        assert!(kept.contains(&points[54_321]) && kept.contains(&points[12_345]));
        assert!(kept.windows(2).all(|pair| pair[0].0 < pair[1].0));
    }

    #[test]
    fn a_short_curve_is_unchanged() {
        let points = vec![(0.0, 1.0), (1.0, 0.0)];
        assert_eq!(decimate(points.clone()), points);
    }
}
