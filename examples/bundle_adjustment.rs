//! Bundle adjustment: cameras and points from where the points are seen in pictures, in the file format of "Bundle Adjustment in the
//! Large" (S. Agarwal, N. Snavely, S. Seitz, R. Szeliski, 2010; <https://grail.cs.washington.edu/projects/bal/>).
//!
//! ```text
//!     P = R X + t        p = -P_xy / P_z        picture = f (1 + k1 |p|^2 + k2 |p|^4) p        camera = (r, t, f, k1, k2), R = exp(r^)
//! ```
//!
//! Points are the sparse blocks, which do not meet each other; cameras are the border, which all of them meet. Eliminating the
//! first is the Schur complement that bundle adjusters are known for.
//!
//! `cargo run --release --example bundle_adjustment [FILE]`; without a file, on a scene of its own.

use std::error::Error;
use std::str::FromStr;

use nonrigid::nlls::{Euclidean, Family, Minimizer, Options, Residual, ResidualProblem, Scalar, Summary, so3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// What a file holds.
pub struct Scene {
    /// `r` (3), `t` (3), `f`, `k1`, `k2`.
    pub cameras: Vec<[f64; 9]>,
    /// `X`.
    pub points: Vec<[f64; 3]>,
    /// What the pictures show.
    pub sightings: Vec<Sighting>,
}

/// One point in one picture.
#[derive(Clone, Copy)]
pub struct Sighting {
    /// Whose picture.
    pub camera: usize,
    /// What is seen.
    pub point: usize,
    /// Pixels from the picture's centre.
    pub at: [f64; 2],
}

/// Where a camera sees a point.
fn project<D: Scalar>(camera: &[D; 9], point: &[D; 3]) -> [D; 2] {
    let [r0, r1, r2, t0, t1, t2, f, k1, k2] = *camera;
    let rotation = so3::exp([r0, r1, r2]);
    let t = [t0, t1, t2];
    let [x, y, z]: [D; 3] = std::array::from_fn(|i| (0..3).fold(t[i], |sum, k| sum + rotation[i][k] * point[k]));
    let p = [-x / z, -y / z];
    let square = p[0] * p[0] + p[1] * p[1];
    let scale = f * (square * (square * k2 + k1) + 1.0);
    p.map(|p| scale * p)
}

impl Residual<2, 12> for Sighting {
    type Blocks = (Euclidean<9>, Euclidean<3>);

    fn evaluate<D: Scalar>(&self, (camera, point): &([D; 9], [D; 3])) -> [D; 2] {
        let [x, y] = project(camera, point);
        [x - self.at[0], y - self.at[1]]
    }
}

impl FromStr for Scene {
    type Err = Box<dyn Error>;

    /// Counts, sightings, cameras, points.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut words = text.split_whitespace();
        let mut number = || -> Result<f64, Box<dyn Error>> { Ok(words.next().ok_or("the file ends early")?.parse()?) };
        let counts = [number()?, number()?, number()?].map(|n| n as usize);
        let sighting =
            |_| Ok(Sighting { camera: number()? as usize, point: number()? as usize, at: [number()?, number()?] });
        let sightings = (0..counts[2]).map(sighting).collect::<Result<Vec<_>, Box<dyn Error>>>()?;
        let mut scene = Self { cameras: vec![[0.0; 9]; counts[0]], points: vec![[0.0; 3]; counts[1]], sightings };
        for value in scene.cameras.as_flattened_mut().iter_mut().chain(scene.points.as_flattened_mut()) {
            *value = number()?;
        }
        if scene.sightings.iter().any(|s| s.camera >= counts[0] || s.point >= counts[1]) {
            return Err("a sighting names a camera or a point that is not there".into());
        }
        Ok(scene)
    }
}

impl Scene {
    /// Six cameras in an arc before 60 points, half a pixel of noise in the pictures, and a start that is off.
    pub fn generate() -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let points: Vec<[f64; 3]> = (0..60).map(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))).collect();
        let camera = |k: usize| [0.05, 0.2 * (k as f64 - 2.5), 0.02, 0.1, -0.1, -5.0, 800.0, -0.05, 0.01];
        let cameras: Vec<[f64; 9]> = (0..6).map(camera).collect();
        let mut sightings = Vec::new();
        for (c, camera) in cameras.iter().enumerate() {
            for (p, point) in points.iter().enumerate() {
                let at = project(camera, point).map(|v| v + rng.random_range(-0.5..0.5));
                if rng.random_range(0.0..1.0) < 0.7 {
                    sightings.push(Sighting { camera: c, point: p, at });
                }
            }
        }
        let off = [0.02, 0.02, 0.02, 0.1, 0.1, 0.1, 20.0, 0.02, 0.01];
        let mut scene = Self { cameras, points, sightings };
        for camera in &mut scene.cameras {
            camera.iter_mut().zip(off).for_each(|(v, off)| *v += rng.random_range(-off..off));
        }
        scene.points.as_flattened_mut().iter_mut().for_each(|v| *v += rng.random_range(-0.05..0.05));
        scene
    }

    /// Moves cameras and points to the minimum of the squared distances in the pictures, square pixels.
    pub fn adjust(&mut self) -> Result<Summary, Box<dyn Error>> {
        let mut builder = ResidualProblem::builder();
        let points: Vec<_> = self.points.iter().map(|p| builder.add_block::<Euclidean<3>>(p)).collect();
        let cameras: Vec<_> = self.cameras.iter().map(|c| builder.add_border_block::<Euclidean<9>>(c)).collect();
        let blocks: Vec<_> = self.sightings.iter().map(|s| [cameras[s.camera], points[s.point]]).collect();
        builder.add_family(Family::new(self.sightings.clone(), &blocks));
        let mut problem = builder.build()?;
        let mut x = problem.initial();
        let options = Options::levenberg_marquardt().with_max_iterations(200).with_energy_tolerance(1e-12);
        let summary = Minimizer::new(options)?.minimize(&mut problem, &mut x);
        for (camera, id) in self.cameras.iter_mut().zip(&cameras) {
            camera.copy_from_slice(problem.block(&x, *id));
        }
        for (point, id) in self.points.iter_mut().zip(&points) {
            point.copy_from_slice(problem.block(&x, *id));
        }
        Ok(summary)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut scene = match std::env::args().nth(1) {
        Some(file) => std::fs::read_to_string(file)?.parse()?,
        None => Scene::generate(),
    };
    println!("{}", scene.adjust()?);
    Ok(())
}
