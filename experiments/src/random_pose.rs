//! Random rigid motions from a seed.

use nonrigid::mesh::{Pose, Vec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A turn by `degrees` about a random axis through the origin and a shift by `millimetres` in a random direction. `stream`
/// tells apart the poses drawn from one seed.
#[must_use]
pub fn random_pose(degrees: f64, millimetres: f64, seed: u64, stream: u64) -> Pose {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    let turn = direction(&mut rng) * degrees.to_radians();
    Pose::rigid(turn, direction(&mut rng) * millimetres)
}

/// A finite number of the command line, as turns and shifts are.
///
/// # Errors
/// What is wrong with it.
pub fn finite(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| "not a finite number".to_owned())
}

/// Uniform on the unit sphere.
pub fn direction(rng: &mut ChaCha8Rng) -> Vec3 {
    loop {
        let v = Vec3::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if (0.1..1.0).contains(&v.norm()) {
            return v.normalize();
        }
    }
}

/// Any rotation, all alike, and a shift by `millimetres` in a random direction.
pub fn any_pose(millimetres: f64, rng: &mut ChaCha8Rng) -> Pose {
    // Uniform on the unit sphere of quaternions.
    let q = loop {
        let q = nalgebra::Vector4::from_fn(|_, _| rng.random_range(-1.0..1.0));
        if (0.1..1.0).contains(&q.norm()) {
            break nalgebra::UnitQuaternion::new_normalize(nalgebra::Quaternion::from(q));
        }
    };
    Pose { rotation: q.to_rotation_matrix().into_inner(), ..Pose::rigid(Vec3::zeros(), direction(rng) * millimetres) }
}
