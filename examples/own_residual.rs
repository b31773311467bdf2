//! A residual and a manifold of one's own: a sphere through scattered points, a fifth of which lie anywhere.
//!
//! `cargo run --release --example own_residual`

use std::error::Error;

use nonrigid::nlls::{
    Euclidean, Family, GradientCheck, Kernel, Manifold, Minimizer, Options, Residual, ResidualProblem, Scalar,
    check_gradient, check_manifold,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Positive numbers: a step multiplies, so no step leads to zero or below.
struct Positive;

impl Manifold for Positive {
    const AMBIENT: usize = 1;
    const TANGENT: usize = 1;
    type Point<D: Scalar> = [D; 1];

    fn plus<D: Scalar>(x: &[f64], delta: &[D], out: &mut [D]) {
        out[0] = delta[0].exp() * x[0];
    }
}

/// A point on a sphere of unknown centre and radius: r = |p - c| - radius.
struct OnSphere {
    p: [f64; 3],
}

/// One entry; three tangent coordinates of the centre and one of the radius.
impl Residual<1, 4> for OnSphere {
    type Blocks = (Euclidean<3>, Positive);

    fn evaluate<D: Scalar>(&self, (centre, radius): &([D; 3], [D; 1])) -> [D; 1] {
        let [x, y, z] = std::array::from_fn(|i| centre[i] - self.p[i]);
        [(x * x + y * y + z * z).sqrt() - radius[0]]
    }
}

const CENTRE: [f64; 3] = [30.0, -12.0, 55.0];
const RADIUS: f64 = 20.0;

/// Half a sphere with 0.1 mm of noise, and outliers in the box round it.
fn points() -> Vec<[f64; 3]> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut points = Vec::new();
    while points.len() < 500 {
        let v: [f64; 3] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let factor = if points.len() % 5 == 0 {
            2.0 * RADIUS
        } else if norm < 1.0 && norm > 0.1 && v[2] > 0.0 {
            (RADIUS + rng.random_range(-0.1..0.1)) / norm
        } else {
            continue;
        };
        points.push(std::array::from_fn(|i| CENTRE[i] + factor * v[i]));
    }
    points
}

/// Fits from `start`, centre and radius, and returns both.
fn fit(points: &[[f64; 3]], start: &[f64], kernel: Kernel) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut builder = ResidualProblem::builder();
    let centre = builder.add_block::<Euclidean<3>>(&start[..3]);
    let radius = builder.add_block::<Positive>(&start[3..]);
    let residuals = points.iter().map(|&p| OnSphere { p }).collect();
    builder.add_family(Family::new(residuals, &vec![[centre, radius]; points.len()]).with_kernel(kernel));
    let mut problem = builder.build()?;

    let mut x = problem.initial();
    println!("{kernel:?}\n{}", check_gradient(&mut problem, &x, GradientCheck::default()));
    let summary = Minimizer::new(Options::levenberg_marquardt())?.minimize(&mut problem, &mut x);
    println!("{summary}\ncentre {:.3?}, radius {:.3}\n", &x[..3], x[3]);
    Ok(x)
}

fn main() -> Result<(), Box<dyn Error>> {
    check_manifold::<Positive>(&[3.0])?;
    let points = points();
    let mean: [f64; 3] = std::array::from_fn(|i| points.iter().map(|p| p[i]).sum::<f64>() / points.len() as f64);
    // A kernel that forgets outliers needs a start that tells them apart: the fit without one.
    let plain = fit(&points, &[mean[0], mean[1], mean[2], 1.0], Kernel::None)?;
    fit(&points, &plain, Kernel::Cauchy { delta: 0.2 })?;
    println!("true: centre {CENTRE:?}, radius {RADIUS}");
    Ok(())
}
