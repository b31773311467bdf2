//! How sure a number is that was computed from a few scans, people or repetitions: the jackknife, and Student's distribution.

/// 95 % interval of a statistic by the jackknife (J. W. Tukey, 1958; B. Efron, C. Stein, "The jackknife estimate of variance", 1981):
/// `whole +- t sqrt((n - 1) / n sum_u (s_u - mean s)^2)`. `s_u` is the statistic without unit u of n, `t` Student's with n - 1
/// degrees of freedom. Of a mean it is the usual interval. `None` with fewer than two units, or where a number is not finite.
#[must_use]
pub fn jackknife(whole: f64, without: &[f64]) -> Option<[f64; 2]> {
    let n = without.len();
    if n < 2 || !without.iter().chain([&whole]).all(|v| v.is_finite()) {
        return None;
    }
    let mean = without.iter().sum::<f64>() / n as f64;
    let square: f64 = without.iter().map(|s| (s - mean).powi(2)).sum();
    let half = student_95(n - 1) * (square * (n - 1) as f64 / n as f64).sqrt();
    Some([whole - half, whole + half])
}

/// The t that 95 % of Student's distribution lie within, to 1e-9 of itself; `freedom` is at least 1.
fn student_95(freedom: usize) -> f64 {
    let (mut low, mut high) = (1.0, 13.0);
    while high - low > 1e-9 * low {
        let middle = (low + high) / 2.0;
        if two_sided(middle, freedom) > 0.05 { low = middle } else { high = middle }
    }
    high
}

/// `P(|T| > |t|)` of Student's distribution, by its finite sums for whole degrees of freedom (M. Abramowitz, I. Stegun, "Handbook of
/// Mathematical Functions", 26.7.3 and 26.7.4).
fn two_sided(t: f64, freedom: usize) -> f64 {
    let angle = (t.abs() / (freedom as f64).sqrt()).atan();
    let (sine, cosine) = angle.sin_cos();
    let odd = freedom % 2 == 1;
    // cos + 2/3 cos^3 + ..., or 1 + 1/2 cos^2 + ...
    let (mut term, mut sum) = (if odd { cosine } else { 1.0 }, 0.0);
    for k in (if odd { 3 } else { 2 }..=freedom).step_by(2) {
        sum += term;
        term *= cosine * cosine * (k - 1) as f64 / k as f64;
    }
    let within = if odd { std::f64::consts::FRAC_2_PI * (angle + sine * sum) } else { sine * sum };
    (1.0 - within).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Expected: `2 scipy.stats.t.sf(t, freedom)`.
    #[test]
    fn students_tails() {
        for (t, freedom, p) in [
            (1.0, 1, 0.5),
            (2.0, 2, 0.18350341907227397),
            (-2.5, 3, 0.08770664700806556),
            (3.2, 4, 0.032900810600938975),
            (0.7, 7, 0.5065175521956),
            (2.1, 30, 0.04424247126232353),
        ] {
            assert!((two_sided(t, freedom) - p).abs() < 1e-12 * p);
        }
    }

    /// Expected: `scipy.stats.t.ppf(0.975, freedom)`.
    #[test]
    fn students_quantiles() {
        for (freedom, t) in [(1, 12.706204736432095), (2, 4.302652729696142), (5, 2.5705818366147395)] {
            assert!((student_95(freedom) / t - 1.0).abs() < 1e-8, "{}", student_95(freedom));
        }
    }

    #[test]
    fn the_jackknife_of_a_mean_is_students_interval() {
        let values = [1.0, 2.0, 4.0];
        let without = [3.0, 2.5, 1.5];
        let [low, high] = jackknife(7.0 / 3.0, &without).unwrap();
        let variance = values.iter().map(|v| (v - 7.0_f64 / 3.0).powi(2)).sum::<f64>() / 2.0;
        let half = 4.302652729696142 * (variance / 3.0).sqrt();
        assert!((low - (7.0 / 3.0 - half)).abs() < 1e-7 && (high - (7.0 / 3.0 + half)).abs() < 1e-7, "{low} {high}");
        assert_eq!(jackknife(1.0, &[1.0]), None);
        assert_eq!(jackknife(f64::INFINITY, &[1.0, 2.0]), None);
    }
}
