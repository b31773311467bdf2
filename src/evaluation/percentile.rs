//! Percentiles with linear interpolation between order statistics, as numpy's default.

/// Percentile `percent` (0 to 100, clamped) of `values`: with the values sorted, the one at position
/// `percent / 100 (n - 1)`, interpolated linearly between its neighbours (Hyndman & Fan 1996, type 7). `None` without values
/// or when any value or `percent` is NaN.
#[must_use]
pub fn percentile(values: &[f64], percent: f64) -> Option<f64> {
    if percent.is_nan() || values.iter().any(|v| v.is_nan()) {
        return None;
    }
    let mut sorted = values.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    of_sorted(&sorted, percent)
}

/// The same for values sorted in ascending order without NaN.
pub(super) fn of_sorted(sorted: &[f64], percent: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    let position = (percent / 100.0).clamp(0.0, 1.0) * last as f64;
    let below = (position.floor() as usize).min(last);
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    let fraction = position - below as f64;
    Some(if fraction == 0.0 || low == high { low } else { low + (high - low) * fraction })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_numpy() {
        // numpy.percentile([15, 20, 35, 40, 50], q)
        let values = [40.0, 15.0, 50.0, 20.0, 35.0];
        for (q, expected) in [(0.0, 15.0), (5.0, 16.0), (40.0, 29.0), (50.0, 35.0), (95.0, 48.0), (100.0, 50.0)] {
            assert!((percentile(&values, q).unwrap() - expected).abs() < 1e-12, "{q}");
        }
        assert_eq!(percentile(&[7.0], 95.0), Some(7.0));
        assert_eq!(percentile(&[1.0, f64::INFINITY], 0.0), Some(1.0));
        assert_eq!(percentile(&[], 50.0), None);
        assert_eq!(percentile(&[1.0, f64::NAN], 50.0), None);
    }
}
