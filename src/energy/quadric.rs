//! What data terms hand to a deformation model: per sample, a quadratic model of the data energy in the sample's position.

/// Gauss-Newton quadric of the data terms at one sample, for half the energy:
/// `g = sum alpha rho' a' r` (3) and `M = sum alpha rho' a' a` (3 x 3), kept as one to three rows `A` and residuals `e` with
/// `A' A = M` and `A' e = g`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Quadric {
    rows: [[f64; 3]; 3],
    residuals: [f64; 3],
    count: u8,
}

impl Quadric {
    /// The rows `A` (at most three) with `A' A = M`.
    #[inline(always)]
    #[must_use]
    pub fn rows(&self) -> &[[f64; 3]] {
        &self.rows[..self.count as usize]
    }

    /// The residuals `e`, one for each row, with `A' e = g`.
    #[inline(always)]
    #[must_use]
    pub fn residuals(&self) -> &[f64] {
        &self.residuals[..self.count as usize]
    }

    /// `g`, the gradient of half the data energy in the sample's position.
    #[must_use]
    pub fn gradient(&self) -> [f64; 3] {
        let mut g = [0.0; 3];
        for (row, e) in self.rows().iter().zip(self.residuals()) {
            for a in 0..3 {
                g[a] += row[a] * e;
            }
        }
        g
    }

    /// `M`, row-major.
    #[must_use]
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        let mut m = [[0.0; 3]; 3];
        for row in self.rows() {
            for a in 0..3 {
                for b in 0..3 {
                    m[a][b] += row[a] * row[b];
                }
            }
        }
        m
    }

    /// `alpha` if `M` is `alpha` times the identity, as where all that pulls at a sample pulls it to points; known where the rows lie
    /// along the axes, in their order.
    #[must_use]
    pub fn isotropic(&self) -> Option<f64> {
        let ([a, b, c], alpha) = match self.rows() {
            [] => return Some(0.0),
            [a, b, c] => ([a, b, c], a[0] * a[0]),
            _ => return None,
        };
        let alike = b[1] * b[1] == alpha && c[2] * c[2] == alpha;
        (alike && [a[1], a[2], b[0], b[2], c[0], c[1]] == [0.0; 6]).then_some(alpha)
    }

    /// Adds the residual `r` with derivative `a` and weight `alpha rho'`.
    #[inline]
    pub fn add(&mut self, weight: f64, a: [f64; 3], r: f64) {
        if weight == 0.0 {
            return;
        }
        let root = weight.sqrt();
        let (row, residual) = (a.map(|a| root * a), root * r);
        if self.count < 3 {
            self.rows[self.count as usize] = row;
            self.residuals[self.count as usize] = residual;
            self.count += 1;
        } else {
            // Rotations keep A'A and A'e: four rows become the three of a triangle and one of zeros.
            let mut triangle = Self { count: 3, ..Self::default() };
            for k in 0..3 {
                triangle.rotate_in(self.rows[k], self.residuals[k]);
            }
            triangle.rotate_in(row, residual);
            *self = triangle;
        }
    }

    /// Adds a row to an upper triangle by Givens rotations.
    fn rotate_in(&mut self, mut row: [f64; 3], mut residual: f64) {
        for i in 0..3 {
            let (top, below) = (self.rows[i][i], row[i]);
            if below == 0.0 {
                continue;
            }
            let length = (top * top + below * below).sqrt();
            let (c, s) = if length > 0.0 { (top / length, below / length) } else { (1.0, 0.0) };
            for j in i..3 {
                let (u, v) = (self.rows[i][j], row[j]);
                (self.rows[i][j], row[j]) = (c * u + s * v, c * v - s * u);
            }
            let (u, v) = (self.residuals[i], residual);
            (self.residuals[i], residual) = (c * u + s * v, c * v - s * u);
        }
    }
}

/// One quadric per sample.
#[derive(Debug, Clone, Default)]
pub struct QuadricField {
    quadrics: Vec<Quadric>,
}

impl QuadricField {
    /// Sets all of `samples` quadrics to zero.
    pub fn reset(&mut self, samples: usize) {
        self.quadrics.clear();
        self.quadrics.resize(samples, Quadric::default());
    }

    /// The quadrics, in sample order.
    #[must_use]
    pub fn quadrics(&self) -> &[Quadric] {
        &self.quadrics
    }

    /// The quadric of one sample, for terms to add to.
    pub fn at_mut(&mut self, sample: usize) -> &mut Quadric {
        &mut self.quadrics[sample]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_reproduce_the_sum_of_any_number_of_residuals() {
        let residuals = [
            (0.5, [1.0, 2.0, -1.0], 0.3),
            (2.0, [0.1, -0.4, 1.0], -1.0),
            (0.0, [9.0, 9.0, 9.0], 5.0),
            (1.5, [0.7, 0.7, 0.2], 0.9),
            (0.25, [1.0, 2.0, -1.0], 2.0),
            (3.0, [-1.0, 0.3, 0.6], 0.1),
        ];
        let (mut quadric, mut m, mut g) = (Quadric::default(), [[0.0; 3]; 3], [0.0; 3]);
        for (w, a, r) in residuals {
            quadric.add(w, a, r);
            for i in 0..3 {
                g[i] += w * a[i] * r;
                for j in 0..3 {
                    m[i][j] += w * a[i] * a[j];
                }
            }
            for i in 0..3 {
                approx::assert_abs_diff_eq!(quadric.gradient()[i], g[i], epsilon = 1e-13);
                for j in 0..3 {
                    approx::assert_abs_diff_eq!(quadric.matrix()[i][j], m[i][j], epsilon = 1e-12);
                }
            }
        }
    }

    #[test]
    fn what_pulls_to_points_is_isotropic_and_nothing_else_is() {
        let mut quadric = Quadric::default();
        assert_eq!(quadric.isotropic(), Some(0.0));
        let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for (round, weight) in [4.0, 9.0].into_iter().enumerate() {
            for axis in axes {
                quadric.add(weight, axis, 0.3);
                let whole = axis[2] == 1.0;
                assert_eq!(quadric.isotropic().is_some(), whole, "round {round}");
            }
        }
        approx::assert_relative_eq!(quadric.isotropic().unwrap(), 13.0, max_relative = 1e-15);
        quadric.add(0.1, [0.6, 0.8, 0.0], 0.0);
        assert_eq!(quadric.isotropic(), None);
        let mut plane = Quadric::default();
        plane.add(1.0, [0.0, 0.0, 1.0], 0.0);
        assert_eq!(plane.isotropic(), None);
    }

    #[test]
    fn coplanar_residuals_keep_the_free_direction_free() {
        let mut quadric = Quadric::default();
        for _ in 0..5 {
            quadric.add(1.0, [1.0, 0.0, 0.0], 0.0);
            quadric.add(1.0, [0.0, 1.0, 0.0], 0.0);
        }
        assert_eq!(quadric.matrix()[2][2], 0.0);
        approx::assert_abs_diff_eq!(quadric.matrix()[0][0], 5.0, epsilon = 1e-13);
    }
}
