//! Smoothing in time. With `x_t` the frames and `c_t` 1 where one is trusted and 0 where it is not, the smoothed frames `s_t` minimise
//!
//! ```text
//! sum_t c_t |s_t - x_t|^2  +  lambda sum_t |s_t - 3 s_(t+1) + 3 s_(t+2) - s_(t+3)|^2
//! ```
//!
//! so that each frame has as its prior the motion of constant acceleration through the frames before and after it (Whittaker 1923,
//! "On a new method of graduation"; Eilers 2003, "A perfect smoother"). Motion of up to constant acceleration is left as it is, and
//! nothing lags, which a pull towards the frame before does. One banded system for all coordinates of all vertices.

use crate::mesh::Vec3;

/// The `lambda` that halves what changes `cutoff` times a frame, less than a half: the smoother's response is
/// `1 / (1 + lambda (2 sin(pi f))^6)`.
#[must_use]
pub fn strength(cutoff: f64) -> f64 {
    (2.0 * (std::f64::consts::PI * cutoff.clamp(1e-4, 0.5)).sin()).powi(-6)
}

/// Differences `s_t - s_(t+1)`, and so on, of first, second and third order.
const DIFFERENCES: [&[f64]; 3] = [&[1.0, -1.0], &[1.0, -2.0, 1.0], &[1.0, -3.0, 3.0, -1.0]];

/// The minimiser for frames of one size, at least one of which is trusted. Before the first trusted frame and after the last one
/// it stands still. With fewer than three trusted frames the differences are of as low an order as they determine.
#[must_use]
pub fn smoothed(mut frames: Vec<Vec<Vec3>>, trusted: &[bool], lambda: f64) -> Vec<Vec<Vec3>> {
    let good: Vec<usize> = (0..frames.len()).filter(|&k| trusted[k]).collect();
    let (Some(&first), Some(&last)) = (good.first(), good.last()) else { return frames };
    let difference = DIFFERENCES[good.len().min(3) - 1];
    let factors = Factors::new(&trusted[first..=last], lambda, difference);
    factors.solve(&mut frames[first..=last], &trusted[first..=last]);
    for k in (0..first).chain(last + 1..frames.len()) {
        frames[k] = frames[k.clamp(first, last)].clone();
    }
    frames
}

/// `A = L D L'` of the system, whose rows reach three to the left at most.
struct Factors {
    /// `lower[t][k]` is L at row t, column t - 1 - k.
    lower: Vec<[f64; 3]>,
    diagonal: Vec<f64>,
}

impl Factors {
    fn new(trusted: &[bool], lambda: f64, difference: &[f64]) -> Self {
        let count = trusted.len();
        // A at row t, column t - k
        let mut a: Vec<[f64; 4]> = trusted.iter().map(|&c| [f64::from(u8::from(c)), 0.0, 0.0, 0.0]).collect();
        for start in 0..(count + 1).saturating_sub(difference.len()) {
            for (i, p) in difference.iter().enumerate() {
                for (j, q) in difference[..=i].iter().enumerate() {
                    a[start + i][i - j] += lambda * p * q;
                }
            }
        }
        let mut factors = Self { lower: vec![[0.0; 3]; count], diagonal: vec![0.0; count] };
        for t in 0..count {
            for k in (1..=t.min(3)).rev() {
                let shared = (k + 1..=t.min(3))
                    .map(|m| factors.lower[t][m - 1] * factors.diagonal[t - m] * factors.lower[t - k][m - k - 1]);
                factors.lower[t][k - 1] = (a[t][k] - shared.sum::<f64>()) / factors.diagonal[t - k];
            }
            let removed = (1..=t.min(3)).map(|k| factors.lower[t][k - 1].powi(2) * factors.diagonal[t - k]);
            factors.diagonal[t] = a[t][0] - removed.sum::<f64>();
        }
        factors
    }

    /// Frames become the solution; those that are not trusted count as 0.
    fn solve(&self, frames: &mut [Vec<Vec3>], trusted: &[bool]) {
        let count = frames.len();
        for t in 0..count {
            if !trusted[t] {
                frames[t].fill(Vec3::zeros());
            }
            for k in 1..=t.min(3) {
                let (before, after) = frames.split_at_mut(t);
                subtract(&mut after[0], self.lower[t][k - 1], &before[t - k]);
            }
        }
        for t in (0..count).rev() {
            frames[t].iter_mut().for_each(|p| *p /= self.diagonal[t]);
            for k in 1..=(count - 1 - t).min(3) {
                let (before, after) = frames.split_at_mut(t + 1);
                subtract(&mut before[t], self.lower[t + k][k - 1], &after[k - 1]);
            }
        }
    }
}

fn subtract(from: &mut [Vec3], factor: f64, what: &[Vec3]) {
    from.iter_mut().zip(what).for_each(|(a, b)| *a -= b * factor);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::testing::noise;

    #[test]
    fn constant_acceleration_is_left_as_it_is_and_the_minimum_is_one() {
        let parabola = |t: f64| vec![Vec3::new(1.0 + t, 2.0 - t * t, 0.3 * t * t + t)];
        let given: Vec<Vec<Vec3>> = (0..12).map(|t| parabola(f64::from(t))).collect();
        let mut trusted = [true; 12];
        trusted[4] = false;
        trusted[5] = false;
        for lambda in [1e-6, 1.0, 1e4] {
            let found = smoothed(given.clone(), &trusted, lambda);
            let far = found.iter().zip(&given).map(|(a, b)| (a[0] - b[0]).norm()).fold(0.0, f64::max);
            assert!(far < 1e-6, "{lambda}: {far}");
        }
        // whatever it is moved by, the sum grows
        let noisy: Vec<Vec<Vec3>> = (0..12).map(|t| vec![Vec3::from_fn(|a, _| noise(31 * t + a))]).collect();
        let energy = |s: &[Vec<Vec3>]| {
            let data: f64 = (0..12).filter(|&t| trusted[t]).map(|t| (s[t][0] - noisy[t][0]).norm_squared()).sum();
            let third = |w: &[Vec<Vec3>]| (w[0][0] - w[1][0] * 3.0 + w[2][0] * 3.0 - w[3][0]).norm_squared();
            data + 5.0 * s.windows(4).map(third).sum::<f64>()
        };
        let found = smoothed(noisy.clone(), &trusted, 5.0);
        for k in 0..12 {
            for by in [-1e-3, 1e-3] {
                let mut moved = found.clone();
                moved[k][0].x += by;
                assert!(energy(&moved) > energy(&found), "frame {k}");
            }
        }
    }

    #[test]
    fn the_cutoff_is_halved() {
        let wave = |t: usize| vec![Vec3::x() * (std::f64::consts::TAU * 0.1 * t as f64).sin()];
        let found = smoothed((0..400).map(wave).collect(), &[true; 400], strength(0.1));
        let height = found[150..250].iter().map(|f| f[0].x).fold(0.0, f64::max);
        assert!((height - 0.5 * wave(12)[0].x.max(wave(2)[0].x)).abs() < 0.01, "{height}");
    }
}
