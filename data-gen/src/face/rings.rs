//! Coordinates round an opening of the face: rings and the angle along them.

/// A family of concentric ellipses: ring `r` has the half axes `a + alpha r` and `b + r + opening exp(-r / fade)`, `b` upper
/// and lower half apart. `r` is close to the distance from the opening's edge, ring 0, in millimetres; inside it is negative.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rings {
    pub half_width: f64,
    /// Half heights of ring 0 above and below the axis.
    pub half_heights: [f64; 2],
    /// Growth of the half width with `r`.
    pub alpha: f64,
    /// By how much the inner rings are held open, and over which distance that fades.
    pub opening: f64,
    pub fade: f64,
    /// The innermost ring, where the surface ends.
    pub innermost: f64,
}

/// Where a point lies round an opening: ring, and angle from the corner on the subject's left, up positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Around {
    pub r: f64,
    pub eta: f64,
}

impl Rings {
    fn half_axes(&self, r: f64, upper: bool) -> [f64; 2] {
        let height = self.half_heights[usize::from(!upper)] + r + self.opening * (-r / self.fade).exp();
        [self.half_width + self.alpha * r, height.max(0.0)]
    }

    /// The point, relative to the centre of the opening.
    pub fn point(&self, at: Around) -> [f64; 2] {
        let (sin, cos) = at.eta.sin_cos();
        // Exactly on the axis at right angles, so that what is on the symmetry plane stays there.
        let cos = if cos.abs() < 1e-15 { 0.0 } else { cos };
        let [a, b] = self.half_axes(at.r, sin >= 0.0);
        [a * cos, b * sin]
    }

    /// Ring and angle of a point; what lies inside the innermost ring counts to it.
    pub fn around(&self, x: f64, y: f64) -> Around {
        // How far outside ring r, and by how much that falls with r.
        let outside = |r: f64| {
            let [a, b] = self.half_axes(r, y >= 0.0);
            let b = b.max(1e-12);
            let growth = 1.0 - self.opening / self.fade * (-r / self.fade).exp();
            let distance = (x / a).hypot(y / b);
            let fall = ((x / a).powi(2) * self.alpha / a + (y / b).powi(2) * growth / b) / distance.max(1e-12);
            (distance - 1.0, fall)
        };
        // Newton's method, kept inside a shrinking interval.
        let (mut low, mut high) = (self.innermost, y.abs() + x.abs() / self.alpha + 1.0);
        let mut r = if outside(low).0 <= 0.0 {
            high = low;
            low
        } else {
            0.5 * (low + high)
        };
        for _ in 0..100 {
            let (over, fall) = outside(r);
            if over > 0.0 {
                low = r
            } else {
                high = r
            }
            let newton = r + over / fall;
            let next = if newton > low && newton < high { newton } else { 0.5 * (low + high) };
            if (next - r).abs() <= 1e-13 * r.abs().max(1.0) {
                break;
            }
            r = next;
        }
        let [a, b] = self.half_axes(r, y >= 0.0);
        Around { r, eta: (y / b.max(1e-12)).atan2(x / a) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rings_and_points_are_each_others_inverse() {
        let eye =
            Rings { half_width: 15.0, half_heights: [5.5, 4.5], alpha: 0.6, opening: 0.0, fade: 1.0, innermost: -2.0 };
        let mouth =
            Rings { half_width: 25.0, half_heights: [0.0; 2], alpha: 0.4, opening: 4.0, fade: 12.0, innermost: -4.0 };
        for rings in [eye, mouth] {
            for r in [-1.9, 0.0, 3.0, 40.0] {
                for k in 0..40 {
                    let eta = -3.1 + 0.155 * f64::from(k);
                    let [x, y] = rings.point(Around { r, eta });
                    let back = rings.around(x, y);
                    assert!((back.r - r).abs() < 1e-8 && (back.eta - eta).abs() < 1e-8, "{r} {eta} {back:?}");
                }
            }
        }
    }
}
