//! Natural cubic splines through a few knots: profiles of the face.

/// A twice continuously differentiable curve through knots of rising abscissa; straight beyond its ends.
#[derive(Debug, Clone)]
pub(crate) struct Spline {
    x: Vec<f64>,
    y: Vec<f64>,
    /// Second derivatives at the knots.
    curvature: Vec<f64>,
}

impl Spline {
    /// Through `(x, y)`, at least two, `x` rising.
    pub fn new(knots: &[(f64, f64)]) -> Self {
        let (x, y): (Vec<f64>, Vec<f64>) = knots.iter().copied().unzip();
        let n = x.len();
        assert!(n >= 2 && x.windows(2).all(|w| w[0] < w[1]), "a spline needs rising knots");
        // Thomas' algorithm for the tridiagonal system of the inner second derivatives.
        let (mut upper, mut right) = (vec![0.0; n], vec![0.0; n]);
        for i in 1..n - 1 {
            let (before, after) = (x[i] - x[i - 1], x[i + 1] - x[i]);
            let slope = 6.0 * ((y[i + 1] - y[i]) / after - (y[i] - y[i - 1]) / before);
            let pivot = 2.0 * (before + after) - before * upper[i - 1];
            upper[i] = after / pivot;
            right[i] = (slope - before * right[i - 1]) / pivot;
        }
        let mut curvature = vec![0.0; n];
        for i in (1..n - 1).rev() {
            curvature[i] = right[i] - upper[i] * curvature[i + 1];
        }
        Self { x, y, curvature }
    }

    pub fn at(&self, x: f64) -> f64 {
        let last = self.x.len() - 1;
        let i = self.x.partition_point(|k| *k <= x).clamp(1, last) - 1;
        let h = self.x[i + 1] - self.x[i];
        let slope = (self.y[i + 1] - self.y[i]) / h;
        let (ci, cj) = (self.curvature[i], self.curvature[i + 1]);
        if x < self.x[0] {
            return self.y[0] + (x - self.x[0]) * (slope - h * (2.0 * ci + cj) / 6.0);
        }
        if x > self.x[last] {
            return self.y[last] + (x - self.x[last]) * (slope + h * (ci + 2.0 * cj) / 6.0);
        }
        let (b, a) = ((x - self.x[i]) / h, (self.x[i + 1] - x) / h);
        a * self.y[i] + b * self.y[i + 1] + ((a * a * a - a) * ci + (b * b * b - b) * cj) * h * h / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_through_its_knots_smoothly_and_reproduces_lines() {
        let knots = [(-2.0, 1.0), (0.0, 3.0), (1.0, -1.0), (4.0, 0.0)];
        let spline = Spline::new(&knots);
        for (x, y) in knots {
            assert!((spline.at(x) - y).abs() < 1e-12);
            let slope = |x: f64| (spline.at(x + 1e-6) - spline.at(x - 1e-6)) / 2e-6;
            assert!((slope(x + 1e-5) - slope(x - 1e-5)).abs() < 1e-3);
        }
        let line = Spline::new(&[(0.0, 1.0), (1.0, 3.0), (5.0, 11.0)]);
        assert!([-3.0, 0.3, 2.0, 9.0].iter().all(|x| (line.at(*x) - (1.0 + 2.0 * x)).abs() < 1e-12));
    }
}
