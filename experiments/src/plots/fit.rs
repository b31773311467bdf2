//! Laws fitted to points (x, y): [`PowerLaw`], and [`LinearFit`], which says how straight they lie.

use serde::Serialize;

/// `y = factor x^exponent`, by least squares of the logarithms.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PowerLaw {
    /// The slope in a plot with logarithmic axes.
    pub exponent: f64,
    /// y at x = 1.
    pub factor: f64,
    /// Least x that it was fitted to.
    pub from: f64,
    /// Greatest x that it was fitted to.
    pub to: f64,
}

impl PowerLaw {
    /// Fits points (x, y). `None` without three different x, as any law goes through two; or where a number is not positive and
    /// finite.
    #[must_use]
    pub fn fit(points: &[[f64; 2]]) -> Option<Self> {
        if points.iter().flatten().any(|v| !(v.is_finite() && *v > 0.0)) {
            return None;
        }
        let logarithms: Vec<[f64; 2]> = points.iter().map(|p| p.map(f64::ln)).collect();
        let mean = |k: usize| logarithms.iter().map(|p| p[k]).sum::<f64>() / logarithms.len() as f64;
        let (x, y) = (mean(0), mean(1));
        let square: f64 = logarithms.iter().map(|p| (p[0] - x).powi(2)).sum();
        let product: f64 = logarithms.iter().map(|p| (p[0] - x) * (p[1] - y)).sum();
        let [from, to] = extent(points)?;
        let exponent = points.iter().any(|p| from < p[0] && p[0] < to).then_some(product / square)?;
        Some(Self { exponent, factor: (y - exponent * x).exp(), from, to })
    }
}

/// `y = intercept + slope x`, by least squares, with what tells whether y is linear in x.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LinearFit {
    /// `sum (x - mean x)(y - mean y) / Sxx` with `Sxx = sum (x - mean x)^2`; units of y over units of x.
    pub slope: f64,
    /// y at x = 0.
    pub intercept: f64,
    /// The slope's standard error, `sqrt(SSR / (n - 2) / Sxx)` with `SSR = sum r^2`.
    pub slope_error: f64,
    /// Share of the variance that the line explains, `1 - SSR / sum (y - mean y)^2`; 0 where all y are equal.
    pub r_squared: f64,
    /// `r = y - intercept - slope x` of each point, in their order.
    pub residuals: Vec<f64>,
    /// `max |r| / (|slope| (to - from))`: the largest departure from the line against what the line rises by over its range. An effect's
    /// size: more points make it no smaller. Infinite for a level line that does not hit all.
    pub departure: f64,
    /// Least x that it was fitted to.
    pub from: f64,
    /// Greatest x that it was fitted to.
    pub to: f64,
}

impl LinearFit {
    /// Fits points (x, y). `None` without three points, two different x, or where a number is not finite.
    #[must_use]
    pub fn fit(points: &[[f64; 2]]) -> Option<Self> {
        if points.len() < 3 || points.iter().flatten().any(|v| !v.is_finite()) {
            return None;
        }
        let [from, to] = extent(points)?;
        let (n, half) = (points.len() as f64, to / 2.0 - from / 2.0);
        let mean = |k: usize| points.iter().map(|p| p[k] / n).sum::<f64>();
        let (x, y) = (mean(0), mean(1));
        if half <= 0.0 {
            return None;
        }
        let u: Vec<f64> = points.iter().map(|p| (p[0] - x) / half).collect();
        let rises: Vec<f64> = points.iter().map(|p| p[1] - y).collect();
        let square = dot(&u, &u);
        let per_half = dot(&u, &rises) / square;
        let residuals: Vec<f64> = u.iter().zip(&rises).map(|(u, rise)| rise - per_half * u).collect();
        let (left, all) = (dot(&residuals, &residuals), dot(&rises, &rises));
        let largest = residuals.iter().fold(0.0, |most: f64, r| most.max(r.abs()));
        let slope = per_half / half;
        let fit = Self {
            slope,
            intercept: y - slope * x,
            slope_error: (left / (n - 2.0) / square).sqrt() / half,
            r_squared: if all > 0.0 { 1.0 - left / all } else { 0.0 },
            departure: if largest > 0.0 { largest / (2.0 * per_half).abs() } else { 0.0 },
            residuals,
            from,
            to,
        };
        [fit.slope, fit.intercept, fit.slope_error, fit.r_squared].iter().all(|v| v.is_finite()).then_some(fit)
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Least and greatest x.
fn extent(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    let xs = || points.iter().map(|p| p[0]);
    Some([xs().reduce(f64::min)?, xs().reduce(f64::max)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_exactly() {
        let points: Vec<[f64; 2]> = [3.0f64, 10.0, 47.0, 1000.0].iter().map(|x| [*x, 0.25 * x.powf(1.5)]).collect();
        let law = PowerLaw::fit(&points).unwrap();
        assert!((law.exponent - 1.5).abs() < 1e-13 && (law.factor - 0.25).abs() < 1e-13, "{law:?}");
        assert_eq!((law.from, law.to), (3.0, 1000.0));
        for none in [
            &points[..2],
            &[[2.0, 1.0], [2.0, 3.0], [3.0, 4.0]],
            &[[1.0, 0.0], [2.0, 3.0]],
            &[[1.0, f64::NAN], [2.0, 3.0]],
        ] {
            assert_eq!(PowerLaw::fit(none), None);
        }
    }

    /// Norris, (x, y), and its certified values: NIST Statistical Reference Datasets, linear regression.
    #[rustfmt::skip]
    const NORRIS: [[f64; 2]; 36] = [
        [0.2, 0.1], [337.4, 338.8], [118.2, 118.1], [884.6, 888.0], [10.1, 9.2], [226.5, 228.1], [666.3, 668.5], [996.3, 998.5], [448.6, 449.1],
        [777.0, 778.9], [558.2, 559.2], [0.4, 0.3], [0.6, 0.1], [775.5, 778.1], [666.9, 668.8], [338.0, 339.3], [447.5, 448.9], [11.6, 10.8],
        [556.0, 557.7], [228.1, 228.3], [995.8, 998.0], [887.6, 888.8], [120.2, 119.6], [0.3, 0.3], [0.3, 0.6], [556.8, 557.6], [339.1, 339.3],
        [887.2, 888.0], [999.0, 998.5], [779.0, 778.9], [11.1, 10.2], [118.3, 117.6], [229.2, 228.9], [669.1, 668.4], [448.9, 449.2], [0.5, 0.2],
    ];

    fn close(a: f64, b: f64, digits: f64) {
        assert!((a - b).abs() <= digits * b.abs(), "{a} instead of {b}");
    }

    #[test]
    fn a_straight_line_has_its_certified_values() {
        let fit = LinearFit::fit(&NORRIS).unwrap();
        close(fit.slope, 1.00211681802045, 1e-13);
        close(fit.intercept, -0.262323073774029, 1e-10);
        close(fit.slope_error, 0.429796848199937E-03, 1e-11);
        close(fit.r_squared, 0.999993745883712, 1e-14);
        assert_eq!((fit.from, fit.to, fit.residuals.len()), (0.2, 999.0, 36));
        close((fit.residuals.iter().map(|r| r * r).sum::<f64>() / 34.0).sqrt(), 0.884796396144373, 1e-11);
    }

    #[test]
    fn departure_is_the_largest_residual_against_the_rise() {
        let fit = |bend: f64, unit: f64| {
            let at = |k: i32| unit * (3.0 + 0.7 * f64::from(k) + bend * f64::from(k * k));
            LinearFit::fit(&(0..9).map(|k| [f64::from(k), at(k)]).collect::<Vec<_>>()).unwrap()
        };
        for unit in [1e-9, 1.0, 1e12] {
            assert!(fit(0.0, unit).departure < 1e-14);
            // x^2 less its own straight fit on 0 to 8 is 28/3 at the ends, and the line rises by 8 (0.7 + 8 bend).
            close(fit(0.1, unit).departure, 2.8 / 3.0 / 12.0, 1e-12);
        }
    }

    #[test]
    fn too_few_points_have_no_fit() {
        let nan = [[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0]];
        for none in [&[][..], &[[0.0, 1.0], [1.0, 2.0]], &[[1.0, 1.0], [1.0, 2.0], [1.0, 3.0]], &nan] {
            assert_eq!(LinearFit::fit(none), None);
        }
        let level = LinearFit::fit(&[[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [4.0, 5.0]]).unwrap();
        assert_eq!((level.slope, level.intercept, level.r_squared, level.departure), (0.0, 5.0, 0.0, 0.0));
    }
}
