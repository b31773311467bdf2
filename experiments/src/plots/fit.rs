//! Laws fitted to points (x, y): [`PowerLaw`], [`LinearFit`] and whether a straight line is enough, [`Curvature`].

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
    /// Fits points (x, y). `None` without two different x, or where a number is not positive and finite.
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
        let exponent = (to > from).then_some(product / square)?;
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
    /// How far a parabola does better; needs four points with three different x.
    pub curvature: Option<Curvature>,
    /// Least x that it was fitted to.
    pub from: f64,
    /// Greatest x that it was fitted to.
    pub to: f64,
}

/// The quadratic term that a straight line lacks. With `u = (x - mean x) / h`, h half the range of x, and `q = u^2` less its own
/// straight fit, the term's coefficient beside a straight line is `c = sum q y / sum q^2`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Curvature {
    /// c, in units of y: how far the parabola passes below its chord in the middle of the range of x. Against the rise over that
    /// range it says whether the bend matters, which t does not.
    pub sag: f64,
    /// c over its standard error, `c / sqrt(sum (r - c q)^2 / (n - 3) / sum q^2)`. Residuals are taken as no smaller than rounding
    /// of the largest y, so that points on a line give a small t.
    pub t: f64,
    /// Chance of so large a |t| with errors that are normal and points on a line: two-sided, Student's distribution with n - 3
    /// degrees of freedom. Correct to 1e-15, not to its own digits where smaller.
    pub p: f64,
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
        let slope = per_half / half;
        let fit = Self {
            slope,
            intercept: y - slope * x,
            slope_error: (left / (n - 2.0) / square).sqrt() / half,
            r_squared: if all > 0.0 { 1.0 - left / all } else { 0.0 },
            curvature: Curvature::of(&u, &residuals, points.iter().fold(0.0, |most, p| p[1].abs().max(most))),
            residuals,
            from,
            to,
        };
        [fit.slope, fit.intercept, fit.slope_error, fit.r_squared].iter().all(|v| v.is_finite()).then_some(fit)
    }
}

impl Curvature {
    /// Of a straight line's `residuals` at `u`, which has mean 0; `most` is the largest |y|.
    fn of(u: &[f64], residuals: &[f64], most: f64) -> Option<Self> {
        let freedom = u.len().checked_sub(3).filter(|f| *f > 0)?;
        let squares: Vec<f64> = u.iter().map(|u| u * u).collect();
        let (mean, skew) = (squares.iter().sum::<f64>() / u.len() as f64, dot(&squares, u) / dot(u, u));
        let q: Vec<f64> = u.iter().zip(&squares).map(|(u, square)| square - mean - skew * u).collect();
        let size = dot(&q, &q);
        // Two different x leave nothing but rounding.
        if size <= 1e-24 * u.len() as f64 {
            return None;
        }
        let sag = dot(&q, residuals) / size;
        let left: f64 = residuals.iter().zip(&q).map(|(r, q)| (r - sag * q).powi(2)).sum();
        let deviation = (left / freedom as f64).sqrt().max(f64::EPSILON * most).max(f64::MIN_POSITIVE);
        let t = sag / (deviation / size.sqrt());
        Some(Self { sag, t, p: two_sided(t, freedom) })
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

    #[test]
    fn a_power_law_is_found_exactly() {
        let points: Vec<[f64; 2]> = [3.0f64, 10.0, 47.0, 1000.0].iter().map(|x| [*x, 0.25 * x.powf(1.5)]).collect();
        let law = PowerLaw::fit(&points).unwrap();
        assert!((law.exponent - 1.5).abs() < 1e-13 && (law.factor - 0.25).abs() < 1e-13, "{law:?}");
        assert_eq!((law.from, law.to), (3.0, 1000.0));
        for none in [&points[..1], &[[2.0, 1.0], [2.0, 3.0]], &[[1.0, 0.0], [2.0, 3.0]], &[[1.0, f64::NAN], [2.0, 3.0]]]
        {
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

    /// Expected: the quadratic term of numpy 2's `linalg.lstsq` and scipy's `stats.t`.
    #[test]
    fn curvature_is_the_quadratic_term_of_a_parabola() {
        let straight = LinearFit::fit(&NORRIS).unwrap().curvature.unwrap();
        close(straight.sag, -0.5146205576890832, 1e-9);
        close(straight.t, -1.3154808500805841, 1e-9);
        close(straight.p, 0.1974152687564973, 1e-9);
        let points = [[1.0, 2.1], [2.0, 3.9], [3.0, 6.3], [5.0, 10.6], [8.0, 17.9], [13.0, 31.5]];
        let bent = LinearFit::fit(&points).unwrap().curvature.unwrap();
        close(bent.sag, 1.3750194105931144, 1e-12);
        close(bent.t, 10.273118577660583, 1e-11);
        close(bent.p, 0.0019667286768739276, 1e-11);

        // On a line of rounded numbers there is none, whatever the units; on a parabola there is, down to its last digit.
        for unit in [1e-9, 1.0, 1e12] {
            let line = |bend: f64| {
                let points: Vec<[f64; 2]> =
                    (0..9).map(|k| f64::from(k) * 0.1).map(|x| [x, unit * (3.0 + 0.7 * x + bend * x * x)]).collect();
                LinearFit::fit(&points).unwrap()
            };
            let (straight, bent) = (line(0.0), line(0.5));
            assert!(straight.curvature.unwrap().t.abs() < 5.0, "{straight:?}");
            assert!((straight.slope / unit - 0.7).abs() < 1e-14 && straight.r_squared > 1.0 - 1e-14, "{straight:?}");
            let curvature = bent.curvature.unwrap();
            close(curvature.sag, unit * 0.5 * 0.16, 1e-12);
            assert!(curvature.t > 1e10 && curvature.p < 1e-14, "{curvature:?}");
        }
    }

    #[test]
    fn too_few_points_have_no_fit() {
        let nan = [[0.0, 1.0], [1.0, f64::NAN], [2.0, 3.0]];
        for none in [&[][..], &[[0.0, 1.0], [1.0, 2.0]], &[[1.0, 1.0], [1.0, 2.0], [1.0, 3.0]], &nan] {
            assert_eq!(LinearFit::fit(none), None);
        }
        let three = LinearFit::fit(&[[0.0, 1.0], [1.0, 2.0], [2.0, 4.0]]).unwrap();
        let two_x = LinearFit::fit(&[[0.1, 1.0], [0.7, 2.0], [0.1, 1.5], [0.7, 2.5], [0.7, 2.2]]).unwrap();
        assert!(three.curvature.is_none() && two_x.curvature.is_none());
        let level = LinearFit::fit(&[[0.0, 5.0], [1.0, 5.0], [2.0, 5.0], [4.0, 5.0]]).unwrap();
        assert_eq!((level.slope, level.intercept, level.r_squared), (0.0, 5.0, 0.0));
        assert_eq!(level.curvature.map(|c| (c.t, c.p)), Some((0.0, 1.0)));
    }

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
            close(two_sided(t, freedom), p, 1e-12);
        }
    }
}
